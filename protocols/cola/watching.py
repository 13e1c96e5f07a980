"""The fields that a device evaluates: results scan by scan, changes at the instants at which they become known.

Belongs here: state of the evaluation. Not: geometry and records (fields), telegrams (session).
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from typing import Any

import numpy as np

from protocols.cola import fields
from protocols.cola.fields import FREE, INFRINGED, INVALID, Watch
from protocols.scan import Scan

UNUSED = 2
"State of an output that is not there: of extension modules."
OWN_OUTPUTS = 6


class Watching:
    """Of one device."""

    def __init__(self, count: int) -> None:
        self._count = count
        self._records: list[tuple[int, Any]] = []
        self._watches = [Watch() for _ in range(fields.SET)]
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
        first = (values["ActiveFieldSet"][0] - 1) * fields.SET if self._count else 0
        places = range(min(fields.SET, max(0, self._count - first)))
        numbered = [(place, values[f"field{first + place:03d}"]) for place in places]
        self._records = [(place, record) for place, record in numbered if fields.is_set(record)]

    def see(self, scan: Scan, end_ns: int) -> None:
        """Evaluate a scan of the whole field; its result counts when the scan has ended."""
        if not self._records:
            return
        azimuth_deg = np.degrees(scan.plan.azimuth_rad) + 90.0
        found = [INVALID] * fields.SET
        for place, record in self._records:
            found[place] = INFRINGED if fields.contains(record, azimuth_deg, scan.range_m).any() else FREE
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
