"""Whether every sensor that a host has subscribed to still sends: a silent one is reported, and its return.

Belongs here: what counts as silence, and passing on what workers report. Not: why it is silent (supervision reports of
processes, `Instrument` of drops).

A sensor is subscribed to while its session wants sweeps measured: nobody streams, no power, booting, spinning up, a
motor that stands: it wants none. It lives as long as it takes scans that have been measured; what faults on purpose or
a slow line do to telegrams after that is asked for, and counted elsewhere.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass

from emulator.instrument.instrument import Instrument
from emulator.measuring.supervision import Workers
from emulator.process.incidents import Incidents

SILENT_SCANS = 20
"Scan times without a scan,"
SILENT_NS = 2_000_000_000
"and at least this long: a measuring process that was killed is there again sooner."
TAKES_TIMES = 3
"And so many times the longest of the last sweeps, where they take longer than the device's own scan time."
FIRST_NS = 10_000_000_000
"Added before a sensor's first sweep in a process is measured: it fills tables, or compiles."


@dataclass
class _Watch:
    """What is known of one sensor."""

    since_ns: int | None = None
    "From when on a scan is missed, in time of the one who looks; None: none is."
    seen_ns: int = 0
    "When sweeps were wanted last."
    lived_ns: int = -1
    wanted_ns: int = -1
    is_silent: bool = False


class Liveness:
    """All sensors of a run."""

    def __init__(
        self,
        instruments: Sequence[Instrument],
        incidents: Incidents,
        takes_ns: Callable[[str], int | None] = lambda sensor: 0,
    ) -> None:
        """`takes_ns`: how long a sweep of that sensor takes, None while that is not known."""
        self._instruments = tuple(instruments)
        self._incidents = incidents
        self._takes_ns = takes_ns
        self._watches = {one.sensor: _Watch() for one in self._instruments}
        self._ran_ns = 0

    def look(self, now_ns: int, ran_ns: int, without: Collection[str] = ()) -> None:
        """Look at all of them. `now_ns`: the run's clock; `ran_ns`: time in which the run was served, which counts.
        `without`: sensors that have lost their links, reported already."""
        self._ran_ns = ran_ns
        for instrument in self._instruments:
            watch = self._watches[instrument.sensor]
            if instrument.sensor in without or not instrument.powered:
                watch.since_ns = None
                continue
            self._look_at(instrument, watch, now_ns, ran_ns)

    def _look_at(self, instrument: Instrument, watch: _Watch, now_ns: int, ran_ns: int) -> None:
        plan = instrument.session.next_plan()
        is_wanted = plan is not None or instrument.wanted_ns != watch.wanted_ns
        watch.wanted_ns = instrument.wanted_ns
        lives = instrument.lived_ns != watch.lived_ns
        watch.lived_ns = instrument.lived_ns
        if lives:
            watch.since_ns = None
            if watch.is_silent:
                self._back(instrument.sensor, watch, now_ns)
        limit_ns = self._limit_ns(instrument.sensor, 0.0 if plan is None else plan.duration_s)
        if is_wanted:
            watch.seen_ns = ran_ns
            ahead_ns = 0 if plan is None else max(0, plan.start_ns + round(plan.duration_s * 1e9) - now_ns)
            if watch.since_ns is None:
                watch.since_ns = ran_ns + ahead_ns
            elif plan is not None and ahead_ns > limit_ns:  # a device that waits by itself
                watch.since_ns = ran_ns + ahead_ns
        elif watch.since_ns is not None and ran_ns - watch.seen_ns > limit_ns:
            watch.since_ns = None
            watch.is_silent = False  # nobody waits for it any more
        if watch.since_ns is None or not is_wanted or watch.is_silent or ran_ns - watch.since_ns <= limit_ns:
            return
        watch.is_silent = True
        text = f"no scan for {(ran_ns - watch.since_ns) * 1e-9:.1f} s; a host is waiting"
        self._incidents.note("sensor silent", now_ns, instrument.sensor, text)

    def _limit_ns(self, sensor: str, scan_s: float) -> int:
        takes_ns = self._takes_ns(sensor)
        usual_ns = max(SILENT_NS, round(SILENT_SCANS * scan_s * 1e9))
        return usual_ns + FIRST_NS if takes_ns is None else max(usual_ns, TAKES_TIMES * takes_ns)

    def _back(self, sensor: str, watch: _Watch, now_ns: int) -> None:
        watch.is_silent = False
        self._incidents.note("sensor back", now_ns, sensor, "sends again")

    def silent_s(self, sensor: str) -> float:
        """For how long scans of it have been missed; 0 where none are, or nobody waits for any."""
        since_ns = self._watches[sensor].since_ns
        return 0.0 if since_ns is None else round(max(0, self._ran_ns - since_ns) * 1e-9, 3)

    @property
    def silent(self) -> tuple[str, ...]:
        """Sensors that are silent at present."""
        return tuple(name for name, watch in self._watches.items() if watch.is_silent)


def report_workers(workers: Workers, incidents: Incidents, failures: Counter[str], now_ns: int) -> None:
    """Pass on what happened to measuring processes and sweeps since the last call.

    Sweeps that could not be measured are counted in `failures` by cause; the first of a cause is an incident: one with
    every sweep would bury the log.
    """
    for kind, worker, text in workers.incidents:
        incidents.note(kind, now_ns, worker, text)
    workers.incidents.clear()
    for text in workers.failures:
        sensor, _, what = text.partition(": ")
        cause = text.rpartition(": ")[2]
        failures[cause] += 1
        if failures[cause] == 1:
            incidents.note("sweep unmeasured", now_ns, sensor, what)
    workers.failures.clear()
