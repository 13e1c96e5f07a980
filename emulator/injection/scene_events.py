"""Expressions over the last scan of each sensor: the trigger `when`.

Belongs here: their values while a run goes on. Not: the language (expressions), which names are known then
(quantities).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

from emulator.config.expressions import Name, Value
from emulator.instrument.instrument import Instrument
from emulator.instrument.observer import FOREVER_NS, Observer
from emulator.instrument.series import SeriesWatcher, lookup
from protocols.scan import Scan


class LastScans(Observer):
    """The last scan of each sensor that an expression names."""

    def __init__(
        self,
        instruments: Mapping[str, Instrument],
        actors: tuple[str, ...],
        on_scan: Callable[[str, int], None],
    ) -> None:
        """`on_scan` is called with the sensor and the end of each of its sweeps."""
        self._instruments, self._actors, self._on_scan = instruments, actors, on_scan
        self._series = SeriesWatcher(list(instruments), by_turns=False)
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
