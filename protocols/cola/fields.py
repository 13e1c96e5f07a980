"""Field evaluation: fields as hosts write them, whether something stands in them, and what is reported of it.

Belongs here: geometry of fields, results scan by scan. Not: records on the wire (layouts), who subscribed (session).
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from protocols.cola.layouts import Field
from protocols.scan import Floats, Scan

INVALID, FREE, INFRINGED = 0, 1, 2
SET = 3
"Fields that are evaluated at a time: those of the active set."
SAMPLES = 2
"Scans in a row that must agree before a result changes; the tool's own default, from memory."
WHOLE = 0xFFFF
"Start distance of a segment that begins at the device, as recorded."
UNUSED = 2
"State of an output that is not there: of extension modules."
OWN_OUTPUTS = 6


def contains(record: Field, azimuth_deg: Floats, range_m: Floats) -> np.ndarray:
    """Which points, (n,) and (n,) or (n, k), lie in a field; directions in the device's own frame, 0 to the right."""
    scale, offset = record.scale, record.offset
    azimuth_deg = azimuth_deg.reshape(-1, *(1,) * (range_m.ndim - 1))
    range_mm = 1000.0 * range_m
    inside = np.zeros(range_m.shape, bool)
    for (points,) in record.segmented:
        if points:
            index, near, far = np.array(points, np.float64).T
            near = np.where(near == WHOLE, 0.0, near * scale + offset)
            corners = (record.start + index * record.step) / 1e4
            within = (azimuth_deg >= corners[0]) & (azimuth_deg <= corners[-1])
            low, high = np.interp(azimuth_deg, corners, near), np.interp(azimuth_deg, corners, far * scale + offset)
            inside |= within & (range_mm >= low) & (range_mm <= high)
    for at, distance, rotation, width, length, *_ in [*record.rectangular, *record.dynamic]:
        # the reference point is taken as the middle of the rectangle; no source says which point it is
        turned, away = np.radians(azimuth_deg), distance * scale + offset
        x = range_mm * np.cos(turned) - away * np.cos(np.radians(at / 1e4))
        y = range_mm * np.sin(turned) - away * np.sin(np.radians(at / 1e4))
        cos, sin = np.cos(np.radians(rotation / 1e4)), np.sin(np.radians(rotation / 1e4))
        inside |= (np.abs(x * cos + y * sin) <= width / 2) & (np.abs(y * cos - x * sin) <= length / 2)
    return inside


@dataclass
class Watch:
    """One evaluated field: its result, and for how many scans another one has been seen."""

    result: int = INVALID
    against: int = 0
    changes: int = 0

    def see(self, result: int) -> bool:
        """Take the result of one scan; whether the result has changed."""
        self.against = 0 if result == self.result else self.against + 1
        if self.against < (1 if self.result == INVALID else SAMPLES):
            return False
        self.result, self.against = result, 0
        self.changes += 1
        return True


class Watching:
    """The fields that one device evaluates; changes count at the instants at which they become known."""

    def __init__(self, count: int) -> None:
        self._count = count
        self._records: list[tuple[int, Field]] = []
        self._watches = [Watch() for _ in range(SET)]
        self._seen: deque[tuple[int, list[int]]] = deque()
        "Results of scans that have not ended: (when they have, result of each field)."

    @property
    def active(self) -> bool:
        """Whether any field of the active set is configured."""
        return bool(self._records)

    def clear(self) -> None:
        """Scans and settings are others from now on."""
        self._seen.clear()
        for watch in self._watches:
            watch.result, watch.against = INVALID, 0

    def use(self, values: Mapping[str, Any]) -> None:
        """The fields that are configured, of the active set; a model without fields has none."""
        first = (values["ActiveFieldSet"][0] - 1) * SET if self._count else 0
        places = range(min(SET, max(0, self._count - first)))
        numbered = [(place, Field(*values[f"field{first + place:03d}"])) for place in places]
        self._records = [(place, record) for place, record in numbered if record.is_set]

    def see(self, scan: Scan, end_ns: int) -> None:
        """Evaluate a scan of the whole field; its result counts when the scan has ended."""
        if not self._records:
            return
        azimuth_deg = np.degrees(scan.plan.azimuth_rad) + 90.0
        found = [INVALID] * SET
        for place, record in self._records:
            found[place] = INFRINGED if contains(record, azimuth_deg, scan.range_m).any() else FREE
        self._seen.append((end_ns, found))

    def next_ns(self) -> int | None:
        """When a result counts."""
        return self._seen[0][0] if self._seen else None

    def due(self, now_ns: int) -> bool:
        """Let what has ended count; whether anything that is reported has changed."""
        changed = False
        while self._seen and self._seen[0][0] <= now_ns:
            _, found = self._seen.popleft()
            changed |= any([watch.see(result) for watch, result in zip(self._watches, found, strict=True)])
        return changed

    def bits(self) -> int:
        """Outputs as bits: that of an infringed field is active."""
        return sum((watch.result == INFRINGED) << place for place, watch in enumerate(self._watches))

    def outputs(self, count: int) -> list[tuple[int, int]]:
        """State and number of changes of each output."""
        own = [(int(watch.result == INFRINGED), watch.changes) for watch in self._watches]
        return [*own, *[(0, 0)] * (OWN_OUTPUTS - len(own)), *[(UNUSED, 0)] * count][:count]

    def results(self, micro: int, date: list[int]) -> list[Any]:
        """LFErec: a block for each configured field."""
        return [
            [
                [1, place + 1, micro, *record[:4], self._watches[place].result, 0, 0, 0, [date]]
                for place, record in self._records
            ]
        ]
