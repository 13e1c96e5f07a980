"""Faults by name: kinds of injected faults, their keys, their duration and recovery.

Belongs here: kinds, their keys, what judges an entry of `faults:`, and what acts on bytes and links by the contracts of
`acts`. Not: when they begin (emulator.injection), what they do to a sweep (emulator.sensing.faulty) or to a list
(emulator.objects.fault_lists).

May import: `config`, `sensors` (specs), `transports`, `physics` (draws), `protocols`.

How a fault is added:

1. Choose the module of its layer: `photon`, `mechanics`, `measurement` (what is measured), `clocks`, `telegram`,
   `octets` (bytes), `plug` (links, power), `can`. Each has a tuple `KINDS`; `catalogue.LAYERS` names the modules.
2. Write its own keys as a frozen pydantic model that derives from `kinds.Keys`: units in the names, bounds in the
   annotations, a string under each field. What every fault has (`on`, `do`, triggers, durations) is `config.Common`.
3. Add a `kinds.Kind(name, layer, summary, ends, keys=..., ...)`:
   - what is measured: `measured=True`. The run puts `conditions.ActiveFault(sensor, name, number, from_ns, until_ns,
     settings, ...)` into `Instrument.conditions`; `settings` are the fault's keys that are not None, as (name, value).
     Whoever measures asks `conditions.of(sensor, plan.start_ns)`. A fault of the clock is judged at the plan's own
     start; one that is begun otherwise (live, by a command, a telegram, an expression) holds from the next sweep asked
     for, at most the look-ahead (0.25 s) later. Draw with `RandomStreams(seed, sensor)`, the fault's number in the
     term's name.
     What it does goes into `sensing.faulty`: `light` (what reaches the receiver), `aims` (where beams go), `readings`
     (scans), or into `objects.fault_lists`: loaded where sweeps are measured, and not by whoever judges a scenario.
     Under measurement without a plan (sessions): `act` as well or instead, see `gear.session`.
   - what is sent, received, plugged in or powered: `act=SomeAct`, a class that derives from `acts.Act` and overrides
     `begin`, `end`, `send`, `hear`, `release` or `next_ns` as needed. `acts.Gear` is all that it can reach.
   `lasts`: `telegrams` (hits single ones), `state` (holds until its end), `own` (its keys say how long: `own_s`).
   `families`, `links`, `models`: for whom it exists; `check`: what else cannot be, as a text `found; want allowed`.
4. One test in tests/faults that shows it on the wire, and its end; `docs/faults.md` is refreshed by
   `python -m emulator.faults.page` (a test compares).

Reading order: `config` (keys of all), `kinds` (what a kind is), `catalogue` (all of them), `reading` (an entry judged),
`acts` (what an act can do), then the layers; `emulator.injection`: `running` (when one begins and ends, what it hit),
`run` (all of them).
"""
