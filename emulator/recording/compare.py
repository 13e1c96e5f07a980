"""Two runs side by side: the first byte, instant, beam or object in which they differ."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from emulator.recording.layout import RecordedScan
from emulator.recording.reader import RecordedRun, WireOf


@dataclass(frozen=True)
class Difference:
    """Where two runs part."""

    at_ns: int
    where: str
    what: str

    def __str__(self) -> str:
        return f"{self.at_ns * 1e-9:.9f} s: {self.where}: {self.what}"


def differences(first: RecordedRun, second: RecordedRun) -> list[Difference]:
    """The first difference on each link and in each sensor's scans, in order of time; empty: the runs are the same."""
    found: list[Difference] = []
    for one, other, direction in ((first.sent, second.sent, "tx"), (first.received, second.received, "rx")):
        for key in sorted(set(one) | set(other)):
            nothing = WireOf(*key, "", "")
            found += _first(_on_wire(one.get(key, nothing), other.get(key, nothing), direction))
    for sensor in sorted(set(first.scans) | set(second.scans)):
        found += _first(_in_scans(sensor, first.scans.get(sensor, []), second.scans.get(sensor, [])))
    return sorted(found, key=lambda item: item.at_ns)


def _first(found: Iterator[Difference]) -> list[Difference]:
    item = next(found, None)
    return [] if item is None else [item]


def _on_wire(one: WireOf, other: WireOf, direction: str) -> Iterator[Difference]:
    where = f"{one.sensor}, link {one.link}, {direction}"
    for number, (a, b) in enumerate(zip(one.payloads, other.payloads, strict=False)):
        if a.data != b.data:
            size = min(len(a.data), len(b.data))
            left, right = np.frombuffer(a.data[:size], np.uint8), np.frombuffer(b.data[:size], np.uint8)
            unequal = np.flatnonzero(left != right)
            if len(unequal):
                at = int(unequal[0])
                what = f"payload {number}, byte {at}: {a.data[at]:02X} and {b.data[at]:02X}"
            else:
                what = f"payload {number}: {len(a.data)} and {len(b.data)} bytes"
            yield Difference(min(a.start_ns, b.start_ns), where, what)
        if (a.peer, a.baud) != (b.peer, b.baud):
            what = f"payload {number}: to {a.peer:X} at {a.baud} baud and to {b.peer:X} at {b.baud}"
            yield Difference(min(a.start_ns, b.start_ns), where, what)
        if (a.start_ns, a.end_ns) != (b.start_ns, b.end_ns):
            away = b.start_ns - a.start_ns, b.end_ns - a.end_ns
            what = f"payload {number}: {away[0]:+d} ns at its first bit, {away[1]:+d} at its last"
            yield Difference(min(a.start_ns, b.start_ns), where, what)
    counts = len(one.payloads), len(other.payloads)
    if counts[0] != counts[1]:
        longer = one.payloads if counts[0] > counts[1] else other.payloads
        yield Difference(longer[min(counts)].start_ns, where, f"{counts[0]} and {counts[1]} payloads")


def _in_scans(sensor: str, one: list[RecordedScan], other: list[RecordedScan]) -> Iterator[Difference]:
    for number, (a, b) in enumerate(zip(one, other, strict=False)):
        at_ns, where = min(a.start_ns, b.start_ns), f"{sensor}, scan {number}"
        if (a.start_ns, a.sweep) != (b.start_ns, b.sweep):
            yield Difference(at_ns, where, f"sweep {a.sweep} at {a.start_ns} ns and {b.sweep} at {b.start_ns} ns")
        if a.range_m.shape != b.range_m.shape:
            yield Difference(at_ns, where, f"{a.range_m.shape} and {b.range_m.shape} beams and echoes")
            continue
        for name in ("range_m", "intensity", "actor"):
            left, right = getattr(a, name), getattr(b, name)
            unequal = np.argwhere(~((left == right) | ((left != left) & (right != right))))
            if len(unequal):
                beam, echo = (int(index) for index in unequal[0])
                azimuth = np.degrees(a.azimuth_rad[beam])
                place = f"beam {beam} ({azimuth:.3f} deg), echo {echo}, {name}"
                yield Difference(at_ns, where, f"{place}: {left[beam, echo]} and {right[beam, echo]}")
        for index, (mine, theirs) in enumerate(zip(a.objects, b.objects, strict=False)):
            for key in mine:
                if mine[key] != theirs.get(key):
                    yield Difference(at_ns, where, f"object {index}, {key}: {mine[key]} and {theirs.get(key)}")
        if len(a.objects) != len(b.objects):
            yield Difference(at_ns, where, f"{len(a.objects)} and {len(b.objects)} objects")
    if len(one) != len(other):
        longer = one if len(one) > len(other) else other
        yield Difference(longer[min(len(one), len(other))].start_ns, sensor, f"{len(one)} and {len(other)} scans")
