"""Expressions over the last scan of each sensor: the trigger `when`.

Belongs here: which names of `series.QUANTITIES` are known while a run goes on. Not: the language (expressions).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from emulator.expressions import ExpressionError, Name, Value, evaluate, names, parse, truth
from emulator.instrument import Instrument
from emulator.series import SeriesWatcher, check_name, lookup
from emulator.watching import FOREVER_NS, Watcher
from protocols.scan import Scan

LIVE = (
    "points",
    "points_on",
    "nearest_m",
    "nearest_on",
    "objects",
    "object",
    "object_range_m",
    "object_speed_m_s",
    "object_existence",
    "object_coasting_s",
    "visible_share",
    "scans_dropped",
    "input_dropped",
    "replies_sent",
    "restarts",
    "faults",
)
"Quantities with a value for one scan, and counters of the run so far."


def check_expression(text: str, sensors: Sequence[str], actors: Sequence[str]) -> None:
    """`ExpressionError` for a `when` that means nothing in this scenario."""
    tree = parse(text)
    found = list(names(tree))
    for name in found:
        check_name(name, sensors, actors)
        if name.parts[-1] not in LIVE:
            raise ExpressionError(f"{name}: known at the end of a run alone; want one of {', '.join(LIVE)}")
    if not found:
        raise ExpressionError("no sensor in it; want something like front.nearest_m < 10")
    truth(evaluate(tree, lambda name: np.zeros(1)))


class LastScans(Watcher):
    """The last scan of each sensor that an expression names."""

    def __init__(
        self,
        instruments: Mapping[str, Instrument],
        actors: tuple[str, ...],
        on_scan: Callable[[str, int], None],
    ) -> None:
        """`on_scan` is called with the sensor and the end of each of its sweeps."""
        self._instruments, self._actors, self._on_scan = instruments, actors, on_scan
        self._series = SeriesWatcher(list(instruments))
        self._watched: set[str] = set()

    def watch(self, sensor: str) -> None:
        """Look at that sensor's scans from now on."""
        if sensor not in self._watched:
            self._watched.add(sensor)
            self._instruments[sensor].watch(self)

    def scan(self, sensor: str, scan: Scan) -> None:
        self._series.sensors[sensor].measured.clear()
        self._series.scan(sensor, scan)
        self._on_scan(sensor, scan.plan.start_ns + round(scan.plan.duration_s * 1e9))

    def value(self, name: Name) -> Value:
        """What a name stands for now; a sensor without a scan yet has no values."""
        return lookup(self._series, self._instruments, self._actors, 0, FOREVER_NS, 0)(name)
