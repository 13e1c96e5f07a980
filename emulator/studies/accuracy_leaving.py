"""What leaving out saves and what it changes: whole scenarios with every term and without, and each rule alone.

Belongs here: these two tables. Not: the rules (error_budget), timing of a sensor with other rules (cost).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from emulator.casting import raycast
from emulator.judging.plans import plans_of
from emulator.physics.arrays import Floats
from emulator.process.clock import SystemClock
from emulator.scenario import scenario
from emulator.scenario.scenario import Scenario
from emulator.sensing.cost import Bench, rules_alone
from emulator.studies.accuracy_knobs import built, sweep_of
from emulator.studies.report import Column, Table, Value
from emulator.world import scene

REFERENCE_SUB_BEAMS = 4096
OFF, ALL = "every rule off", "all as they come"


def each_rule(names: Sequence[str], repeats: int) -> Table:
    """Rays and time of every sensor's own sweep: every rule off, each alone, all as they come."""
    rows: list[tuple[Value, ...]] = []
    for name in names:
        loaded = scenario.load(name)
        world = scene.build(loaded)
        caster, plans = raycast.Caster(world), plans_of(loaded)
        for sensor in loaded.sensors:
            if sensor.id not in plans:
                continue
            bench = Bench(loaded, world, caster, sensor.id, plans[sensor.id])
            full = bench.measure(full=True)
            for rule, measure in {OFF: full, **rules_alone(bench), ALL: bench.measure()}.items():
                whole, cost = bench.costs(full, measure, repeats=repeats)  # in turns: both see the same machine
                shares = (100.0 * cost.rays / whole.rays, 100.0 * cost.ms / whole.ms)
                rows.append((name, sensor.id, sensor.model, rule, cost.rays, cost.ms, *shares))
    return Table(
        "accuracy_leaving",
        "What each rule of leaving out saves",
        (
            Column("scenario", "scenario"),
            Column("sensor", "sensor"),
            Column("model", "model"),
            Column("rule", "rule"),
            Column("rays", "rays/beam", ".2f"),
            Column("ms", "ms/sweep", ".2f"),
            Column("rays_percent", "of the rays (%)", ".0f"),
            Column("time_percent", "of the time (%)", ".0f"),
        ),
        tuple(rows),
        "Each sensor's own sweep, CPU time of one core, medians of sweeps that take turns with those of every rule "
        "off. A rule alone: every other one is off. Over 100 %: alone it costs more than it saves; `closed_form`, "
        "here forced by `always`, is left out by `auto` where it does.",
    )


def pruning(names: Sequence[str], sweeps: int) -> Table:
    """Shipped scenarios with every term, and with what nobody can see left out."""
    rows: list[tuple[Value, ...]] = []
    for name in names:
        loaded = scenario.load(name)
        for config in loaded.sensors:
            if config.model.startswith("can-"):
                continue
            fine, _, _ = _measured(loaded, config.id, {"full": True, "sub_beams": REFERENCE_SUB_BEAMS}, 1)
            full, rays_full, ms_full = _measured(loaded, config.id, {"full": True}, sweeps)
            lean, rays, ms = _measured(loaded, config.id, {"full": False}, sweeps)
            lsb_m = built(loaded, config.id)[0].model.lsb_m
            off = [_within(one[: len(fine)], fine, lsb_m) for one in (full, lean)]
            miss = 1e3 * np.abs(lean[: len(fine)] - fine)
            off += [float(np.nanmedian(miss)), float(np.nanmax(miss))]
            rows.append((name, config.id, rays_full, rays, ms_full, ms, *off))
    return Table(
        "accuracy_pruning",
        "Leaving out: sweeps of 361 beams over 180 degrees",
        (
            Column("scenario", "scenario"),
            Column("sensor", "sensor"),
            Column("rays_full", "rays/beam, all", ".1f"),
            Column("rays", "rays/beam", ".1f"),
            Column("ms_full", "ms/sweep, all", ".1f"),
            Column("ms", "ms/sweep", ".1f"),
            Column("within_full_percent", "right within one step, all (%)", ".1f"),
            Column("within_percent", "right within one step (%)", ".1f"),
            Column("median_mm", "median error (mm)", ".2f"),
            Column("largest_mm", "largest (mm)", ".1f"),
        ),
        tuple(rows),
        f"All: `full: true` in the sensor's `physics:` table. Right: as {REFERENCE_SUB_BEAMS} sub-beams and every term "
        "find it, to one step of the reported range. Without noise, so that scans can be compared. Errors: of "
        "ranges with terms left out, against the same. Large ones stand at grazing incidence, "
        "where a footprint is metres "
        "long, and at edges.",
    )


def _measured(loaded: Scenario, sensor: str, physics: dict[str, object], sweeps: int) -> tuple[Floats, float, float]:
    """Ranges of all sweeps, rays per beam, median milliseconds a sweep."""
    measure, caster = built(loaded, sensor, physics)
    sweep_of(measure, 0)
    caster.rays = 0
    seconds, scans = [], []
    for sweep in range(1, sweeps + 1):
        clock = SystemClock()
        scans.append(sweep_of(measure, sweep).range_m[:, 0])
        seconds.append(1e-9 * clock.now_ns())
    return np.concatenate(scans), caster.rays / sweeps / len(scans[0]), 1e3 * float(np.median(seconds))


def _within(found: Floats, wanted: Floats, lsb_m: float) -> float:
    """Share of beams that agree to one step. [%]"""
    both = np.isfinite(found) & np.isfinite(wanted)
    near = both & (np.abs(np.where(both, found - wanted, 0.0)) <= lsb_m)
    return 100.0 * float(np.mean(near | (np.isnan(found) & np.isnan(wanted))))
