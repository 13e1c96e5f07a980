"""Runs in virtual time with one fault, decoded by hosts; beside each the same run without it."""

from __future__ import annotations

import functools
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from emulator.hosts.scans import HostScan
from emulator.instrument.observer import Observer, Payload
from emulator.judging.trial import Trial
from emulator.physics.arrays import Floats
from emulator.scenario import scenario
from tests.protocols.ld.reader import read_frames, read_profile

BEGIN_S, END_S = 0.5, 0.8
HEAD = "schema: 1\nseed: 3\nduration_s: 1.1\n"
WALL = "  - {plane: {size_m: [6, 60]}, at_m: [5, 0, 1], pitch_deg: -90, material: white_plaster}\n"
GROUND = "  - {plane: {size_m: [200, 200]}, at_m: [0, 0, 0], material: white_plaster}\n"
POST = """\
actors:
  - {id: post, shape: {box: {size_m: [0.2, 0.4, 2]}}, material: white_plaster, motion: {at_m: [3, 0, 0]}}
"""
QUIET = "physics: {noise: false, rule: axis}, "
FRONT = (
    "  - {id: front, model: sick-lms291-s05, mount: {at_m: [0, 0, 1], pitch_deg: PITCH}, PHYSICS"
    "device: {resolution_deg: 1, field_deg: 100, unit: mm, real_time_indices: true}}\n"
)
TOP = (
    "  - {id: top, model: sick-ld-oem1000, mount: {at_m: [0, 0, 1], pitch_deg: PITCH}, PHYSICS"
    "device: {delays: fast, step_deg: 2.0, motor_hz: 20}}\n"
)
SENSORS = {"front": FRONT, "top": TOP}


class Sent(Observer):
    """Every payload of a run that carried a scan."""

    def __init__(self) -> None:
        self.payloads: list[Payload] = []

    def payload(self, payload: Payload) -> None:
        if payload.sent:
            self.payloads.append(payload)


@dataclass(frozen=True, eq=False)
class Run:
    """What hosts have read of one sensor."""

    scans: dict[int, tuple[int, HostScan]]
    "By sweep: beginning of the sweep, and the scan as read."
    payloads: tuple[Payload, ...]
    sha256: str
    hits: tuple[int, ...] = ()
    "Of each fault, as the run counts them."

    def echoes(self) -> dict[int, Floats]:
        """Amplitude words of an LD's profiles, by sweep."""
        found = {}
        for one in self.payloads:
            if one.sweep is not None:
                (payload,) = read_frames(one.data)
                words = [word for sector in read_profile(payload).sectors for word in sector.echoes]
                found[one.sweep] = np.array(words, dtype=np.float64)
        return found

    def part(self, from_s: float, to_s: float) -> list[HostScan]:
        """Scans whose sweep began within that time."""
        return [scan for at_ns, scan in self.scans.values() if from_s <= at_ns * 1e-9 < to_s]

    def pairs(self, other: Run, from_s: float = BEGIN_S, to_s: float = END_S) -> list[tuple[HostScan, HostScan]]:
        """Scans of both runs of the same sweep, begun within that time."""
        kept = [sweep for sweep, (at_ns, _) in self.scans.items() if from_s <= at_ns * 1e-9 < to_s]
        return [(self.scans[sweep][1], other.scans[sweep][1]) for sweep in kept if sweep in other.scans]


def text_of(on: str, world: str, quiet: bool, pitch_deg: float, more: str) -> str:
    sensor = SENSORS[on].replace("PHYSICS", QUIET if quiet else "").replace("PITCH", f"{pitch_deg}")
    return HEAD + "world:\n" + world + POST + more + "sensors:\n" + sensor


@functools.lru_cache(maxsize=64)
def run(
    fault: str = "",
    on: str = "front",
    world: str = WALL,
    quiet: bool = True,
    pitch_deg: float = 0.0,
    more: str = "",
    until_s: float = END_S,
) -> Run:
    """A run in which a fault, `do: ...`, holds from 0.5 to 0.8 s; without a text: the run without it."""
    text = text_of(on, world, quiet, pitch_deg, more)
    if fault:
        text += f"faults:\n  - {{on: {on}, at_s: {BEGIN_S}, for_s: {until_s - BEGIN_S:.3f}, {fault}}}\n"
    watcher = Sent()
    trial = Trial(scenario.loads(text, Path("case.yaml")), watchers=[watcher])
    verdict = trial.finish()
    trial.close()
    series = trial.series.sensors[on]
    scans = {series.measured[at_ns].sweep: (at_ns, scan) for _, at_ns, scan in series.read if at_ns is not None}
    hits = tuple(int(str(row["hits"])) for row in trial.faults.rows())
    return Run(scans, tuple(watcher.payloads), verdict.sha256, hits)


def same(one: HostScan, other: HostScan) -> bool:
    """Two scans that a host cannot tell apart."""
    if not np.array_equal(one.range_m, other.range_m, equal_nan=True):
        return False
    if one.intensity is None or other.intensity is None:
        return one.intensity is other.intensity
    return np.array_equal(one.intensity, other.intensity, equal_nan=True)


def heals(faulty: Run, healthy: Run) -> bool:
    """Before it begins and after its end hosts read what they would have read without it."""
    before = faulty.pairs(healthy, 0.0, BEGIN_S)
    after = faulty.pairs(healthy, END_S, 2.0)
    return len(before) > 3 and len(after) > 3 and all(same(a, b) for a, b in before + after)


def at(scan: HostScan, azimuth_deg: float) -> int:
    """Beam of an azimuth."""
    return int(np.argmin(np.abs(np.degrees(scan.azimuth_rad) - azimuth_deg)))


def ranges(scans: list[HostScan], azimuth_deg: float) -> Floats:
    """Range of one beam, scan by scan."""
    return np.array([scan.range_m[at(scan, azimuth_deg)] for scan in scans])
