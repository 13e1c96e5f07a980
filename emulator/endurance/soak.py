"""A day in virtual time: four sensors, hosts that come, go and misbehave, and the account at the end.

Belongs here: putting the run together, sampling, the verdict. Not: the hosts (guests), the real-time soak (real_soak).
"""

from __future__ import annotations

import gc
import tracemalloc
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from emulator.endurance.bus_guests import GuestBus
from emulator.endurance.growth import Growth, look
from emulator.endurance.guests import COLA_TONGUE, DESK_TONGUES, STREET_TONGUES, Guestbook, LineGuests, StreamGuests
from emulator.endurance.repeats import repeating
from emulator.endurance.scene import DESK, STREET, soak_scenario
from emulator.hosts.families import is_on_can
from emulator.instrument.instrument import Instrument
from emulator.measuring.measuring import InPlace
from emulator.process.clock import SystemClock
from emulator.runtime import assembly
from emulator.runtime.virtual import VirtualHost, VirtualRun
from emulator.transports.can_link import BITRATE, CanPorts
from emulator.transports.can_wire import CanWire
from emulator.transports.link import Link
from emulator.transports.loopback import LoopLink, Loops

GROUP_NS = 20_000_000
"Bytes of a line reach a host in groups of this duration, or at the end of a telegram: ten times those of real links."
LEAST_SAMPLES, MOST_SAMPLES, SAMPLE_S = 40, 400, 30.0
RISE_MB, RISE_BLOCKS, RISE_TRACED_KB = 4.0, 12_000, 256.0
"""What the second half of a run may add before it counts as a leak. Tables of the last thousand events fill slowly,
with 3000 blocks a sensor; a leak of one object per scan would be 67 500 in the second half of an hour. What
tracemalloc sees is, for minutes, rows of those tables that replace rows made before it looked: 25 kB in a quarter of a
virtual hour, nearly all of it events of sessions; a leak of 200 bytes per scan would add 256 kB in half a minute."""
TRACED_SHARE = 0.05
"Share of the run at its end that is watched by tracemalloc, which makes everything several times slower."
TRACED_MOST_S = 300.0


@dataclass(frozen=True)
class Soaked:
    """What a soak has shown."""

    kind: str
    "virtual | real"
    simulated_s: float
    wall_s: float
    seed: int
    sensors: dict[str, dict[str, Any]]
    hosts: dict[str, dict[str, Any]]
    memory: dict[str, Any]
    faults: tuple[str, ...]
    "What must not be; empty when the soak has held."

    @property
    def held(self) -> bool:
        """Nothing leaked, nothing was lost, hosts got clean data."""
        return not self.faults

    def as_json(self) -> dict[str, Any]:
        """Everything, ready for a file."""
        return {
            "study": "soak",
            "kind": self.kind,
            "held": self.held,
            "faults": list(self.faults),
            "seed": self.seed,
            "simulated_s": round(self.simulated_s, 3),
            "wall_s": round(self.wall_s, 1),
            "times_real": round(self.simulated_s / max(self.wall_s, 1e-9), 2),
            "sensors": self.sensors,
            "hosts": self.hosts,
            "memory": self.memory,
        }


class Soak:
    """The run: `advance` it, then `verdict`."""

    def __init__(self, seed: int, stay_s: tuple[float, float] = (20.0, 600.0), sensors: str = "") -> None:
        """`sensors`: see `run_virtual`."""
        scenario = soak_scenario(seed, sensors)
        names = [sensor.id for sensor in scenario.sensors]
        self.books = {name: Guestbook() for name in names}
        draws = {name: np.random.default_rng((seed, number)) for number, name in enumerate(names)}
        self.measures = repeating(assembly.build_measures(scenario), rough={*DESK, *STREET})
        measuring = InPlace(self.measures)
        loops, buses = Loops(), CanPorts()
        self.instruments: list[Instrument] = []
        for index, session in enumerate(assembly.new_sessions(scenario)):
            name = names[index]
            link: Link
            if is_on_can(assembly.family_of(scenario, index).name):
                bus = GuestBus(draws[name], self.books[name])
                link = buses.link(f"can:{name}", lambda bus=bus: (CanWire(BITRATE), bus))  # type: ignore[misc]
            else:
                on_line = name in DESK or assembly.family_of(scenario, index).tcp_is_line
                link = LoopLink(name, on_line, group_ns=GROUP_NS)
                loops.add(link)
            self.instruments.append(Instrument(name, session, [link], measuring))
        hosts: list[VirtualHost]
        if sensors == "desk":
            hosts = [
                LineGuests(loops[name], draws[name], self.books[name], stay_s, tongue=tongue)
                for name, tongue in DESK_TONGUES.items()
            ]
        elif sensors == "street":
            hosts = [
                StreamGuests(loops[name], draws[name], self.books[name], tongue=tongue)
                for name, tongue in STREET_TONGUES.items()
            ]
        else:
            hosts = [
                LineGuests(loops["front"], draws["front"], self.books["front"], stay_s),
                StreamGuests(loops["top"], draws["top"], self.books["top"]),
                StreamGuests(loops["gate"], draws["gate"], self.books["gate"], tongue=COLA_TONGUE),
            ]
        self._run = VirtualRun(self.instruments, hosts)
        self._run.power_on()
        self.now_ns = 0

    def advance(self, until_ns: int) -> None:
        """Go on to that virtual instant."""
        self._run.advance(until_ns)
        self.now_ns = until_ns
        for instrument in self.instruments:  # as the daemon does, which keeps what its report needs
            for link in instrument.links:
                link.stats.lateness_ns.clear()

    def close(self) -> None:
        """Release everything."""
        for instrument in self.instruments:
            instrument.close()

    def accounts(self) -> dict[str, dict[str, Any]]:
        """Of every sensor: its scans, and what it refused to hear."""
        found = {}
        for instrument in self.instruments:
            found[instrument.sensor] = instrument.ledger.account() | {
                "measured_again": instrument.ledger.again,
                "scans_per_s": round(instrument.stats.rate_hz, 4),
                "replies": instrument.stats.replies_sent,
                "bytes_in": sum(link.stats.bytes_in for link in instrument.links),
                "bytes_out": sum(link.stats.bytes_out for link in instrument.links),
                "input_dropped": dict(instrument.stats.input_dropped),
                "restarts": instrument.stats.restarts,
            }
        return found

    def reported(self) -> dict[str, dict[str, Any]]:
        """Of every sensor's hosts: who came, and what the well-behaved ones got."""
        return {
            name: {
                "visits": dict(book.visits),
                "clean_scans": book.clean_scans,
                "slowest_first_scan_s": round(book.slowest_first_scan_s, 2),
                "faults": dict(book.faults),
            }
            for name, book in self.books.items()
        }


def run_virtual(
    hours: float, seed: int, progress: Callable[[float], None] = lambda share: None, sensors: str = ""
) -> Soaked:
    """A soak of that many virtual hours; `progress` hears the share that is done. `sensors`: "", desk, street."""
    clock = SystemClock()
    total_s = hours * 3600.0
    soak = Soak(seed, (20.0, min(600.0, max(30.0, total_s / 10.0))), sensors)
    growth, traced = Growth(), [0, 0]
    samples = round(min(MOST_SAMPLES, max(LEAST_SAMPLES, total_s / SAMPLE_S)))
    traced_from = samples - max(4, round(samples * min(TRACED_SHARE, TRACED_MOST_S / total_s)))
    try:
        for number in range(1, samples + 1):
            soak.advance(round(total_s * number / samples * 1e9))
            gc.collect()
            if number < traced_from:  # tracemalloc's own tables are no growth of ours
                growth.samples.append(look(soak.now_ns * 1e-9))
            elif number == traced_from:
                growth.samples.append(look(soak.now_ns * 1e-9))
                tracemalloc.start()
                for measure in soak.measures.values():  # else its next cycle would replace what was not traced: a rise
                    measure.afresh()
            else:
                traced.append(tracemalloc.get_traced_memory()[0])
            progress(number / samples)
    finally:
        tracemalloc.stop()
        soak.close()
    memory = growth.reported()
    # what is made again and replaces something older counts as growth until it is settled: the last half is judged
    memory["traced_kb_rise"] = round((traced[-1] - traced[2 + (len(traced) - 2) // 2]) / 1024, 1)
    accounts, hosts = soak.accounts(), soak.reported()
    faults = judged(accounts, hosts, memory)
    return Soaked("virtual", total_s, clock.now_ns() * 1e-9, seed, accounts, hosts, memory, faults)


def judged(sensors: dict[str, Any], hosts: dict[str, Any], memory: dict[str, Any]) -> tuple[str, ...]:
    """Everything that must not be, in words."""
    faults = []
    for name, account in sensors.items():
        if account["unaccounted"]:
            faults.append(f"{name}: {account['unaccounted']} scans unaccounted")
        if not account["sent"]:
            faults.append(f"{name}: no scan sent")
    for name, one in hosts.items():
        faults += [f"{name}: a well-behaved host: {what}: {count} times" for what, count in one["faults"].items()]
        if not one["clean_scans"]:
            faults.append(f"{name}: no clean scan")
    for key, limit in (
        ("rss_mb_rise_second_half", RISE_MB),
        ("blocks_rise_second_half", RISE_BLOCKS),
        ("traced_kb_rise", RISE_TRACED_KB),
    ):
        if memory.get(key, 0) > limit:
            faults.append(f"memory: {key} {memory[key]}; want at most {limit}")
    first, last = memory["descriptors_most_first_quarter"], memory["descriptors_least_last_quarter"]
    if "descriptors_left" in memory:
        if memory["descriptors_left"] > 0:
            faults.append(f"descriptors: {memory['descriptors_left']} left open by hosts that have gone")
    elif last > first:  # hosts come and go: their connections are no leak as long as they end
        faults.append(f"descriptors: never below {last} in the last quarter, never over {first} in the first")
    return tuple(faults)
