"""What is recorded of a run for its expectations: numbers a scan, with the time of each.

`QUANTITIES` is the only list of the names: it checks, computes and is shown to users. Not here: the language itself
(expressions), the verdict (expectations).
"""

from __future__ import annotations

import difflib
import math
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from emulator.expressions import ExpressionError, Name, Value
from emulator.hosts.scans import HostScan
from emulator.instrument import Instrument
from emulator.object_metrics import ListedScan, ObjectScore, Score, TruthObject
from emulator.watching import Payload, Watcher
from protocols.device_clock import Told
from protocols.scan import DetectedObject, Floats, Ints, Scan

MATCH_RAD = np.radians(0.02)
"A host's beam and a measured one are the same when their azimuths differ by less."
MOST_UNSENT = 4096
"Sweeps that may be on their way from measurement to telegram."


@dataclass(frozen=True, eq=False)
class Measured:
    """What a sweep brought back, as far as expectations ask."""

    at_ns: int
    azimuth_rad: Floats
    range_m: Floats
    "(n,) nearest echo"
    actor: Ints
    "(n,)"
    objects: tuple[DetectedObject, ...]
    truth: tuple[TruthObject, ...]
    "Of a sensor that lists objects."
    sweep: int = 0
    "Its number, in the device's life that it belongs to."

    def object_of(self, actor: str) -> DetectedObject | None:
        """The object that is that actor; the one seen last when there are several."""
        mine = [item for item in self.objects if item.actor == actor]
        return min(mine, key=lambda item: (item.coasting_s, item.track)) if mine else None


@dataclass
class SensorSeries:
    """One sensor's run."""

    measured: dict[int, Measured] = field(default_factory=dict)
    "By the instant at which the sweep began: a device counts its sweeps anew after a power cut."
    sent_ns: list[int] = field(default_factory=list)
    "First bit of each scan on the first link that carried it."
    read: list[tuple[int, int | None, HostScan]] = field(default_factory=list)
    "By our host: when, the beginning of the sweep it carried, the scan as decoded."
    told: dict[int, Told] = field(default_factory=dict)
    "What scans' telegrams told of the device's time, by the instant of the run that they told of."
    bytes_out: int = 0
    bytes_in: int = 0


class SeriesWatcher(Watcher):
    """Collects the series of all sensors of a run."""

    def __init__(self, sensors: Sequence[str]) -> None:
        self.sensors = {sensor: SensorSeries() for sensor in sensors}
        self._sweeps: dict[str, deque[tuple[int, int]]] = {sensor: deque() for sensor in sensors}
        "End and beginning of the sweep of scans that the host has not read yet."
        self._begun: dict[str, dict[int, int]] = {sensor: {} for sensor in sensors}
        "Sweep -> its beginning, of the device's present life."

    def payload(self, payload: Payload) -> None:
        mine = self.sensors[payload.sensor]
        if not payload.sent:
            mine.bytes_in += len(payload.data)
            return
        mine.bytes_out += len(payload.data)
        if payload.sweep is not None and payload.link == 0:
            mine.sent_ns.append(payload.start_ns)
            began_ns = self._begun[payload.sensor].get(payload.sweep)
            if began_ns is not None:
                self._sweeps[payload.sensor].append((payload.end_ns, began_ns))

    def scan(self, sensor: str, scan: Scan) -> None:
        begun = self._begun[sensor]
        begun[scan.plan.sweep] = scan.plan.start_ns
        while len(begun) > MOST_UNSENT:
            begun.pop(next(iter(begun)))
        self.sensors[sensor].measured[scan.plan.start_ns] = Measured(
            scan.plan.start_ns,
            scan.plan.azimuth_rad,
            scan.range_m[:, 0],
            scan.actor[:, 0],
            scan.objects,
            scan.truth if isinstance(scan, ListedScan) else (),
            scan.plan.sweep,
        )

    def told(self, sensor: str, sweep: int, told: Told) -> None:
        self.sensors[sensor].told[told.true_ns] = told

    def host_read(self, sensor: str, at_ns: int, scan: HostScan) -> None:
        """Our host has decoded a scan: the newest one that has wholly arrived, whatever was lost before it."""
        sweeps = self._sweeps[sensor]
        began_ns = None
        while sweeps and sweeps[0][0] <= at_ns:
            began_ns = sweeps.popleft()[1]
        self.sensors[sensor].read.append((at_ns, began_ns, scan))


@dataclass(frozen=True)
class Window:
    """What an expectation looks at."""

    series: SensorSeries
    instrument: Instrument
    actors: tuple[str, ...]
    from_ns: int
    to_ns: int
    argument: str | float | None

    def holds(self, at_ns: int) -> bool:
        """Whether an instant lies in it."""
        return self.from_ns <= at_ns <= self.to_ns

    @property
    def measured(self) -> list[Measured]:
        """Sweeps that began in the window."""
        return [item for item in self.series.measured.values() if self.holds(item.at_ns)]

    @property
    def read(self) -> list[tuple[int, int | None, HostScan]]:
        """Scans that our host read in it."""
        return [item for item in self.series.read if self.holds(item[0])]


def _of_measured(number: Callable[[Measured, Window], float]) -> Callable[[Window], Value]:
    return lambda window: np.array([number(item, window) for item in window.measured], dtype=np.float64)


def _points(item: Measured, window: Window) -> float:
    return float(np.count_nonzero(~np.isnan(item.range_m)))


def _points_on(item: Measured, window: Window) -> float:
    return float(np.count_nonzero(item.actor == window.actors.index(str(window.argument))))


def _nearest(item: Measured, window: Window) -> float:
    known = item.range_m[~np.isnan(item.range_m)]
    return float(known.min()) if len(known) else float("nan")


def _nearest_on(item: Measured, window: Window) -> float:
    known = item.range_m[item.actor == window.actors.index(str(window.argument))]
    return float(np.nanmin(known)) if np.any(~np.isnan(known)) else float("nan")


def _object(item: Measured, window: Window) -> float:
    return float(sum(one.actor == window.argument for one in item.objects))


def _of_object(number: Callable[[DetectedObject], float]) -> Callable[[Window], Value]:
    """A number of the object that is the actor in parentheses; missing in lists without it."""

    def value(item: Measured, window: Window) -> float:
        found = item.object_of(str(window.argument))
        return float("nan") if found is None else number(found)

    return _of_measured(value)


def _share(item: Measured, window: Window) -> float:
    return next((one.visible_share for one in item.truth if one.actor == window.argument), float("nan"))


def _when(end: int, holds: Callable[[Measured, Window], bool]) -> Callable[[Window], Value]:
    """Instant of the first (0) or last (-1) list for which that holds."""

    def value(window: Window) -> Value:
        instants = sorted(item.at_ns for item in window.measured if holds(item, window))
        return instants[end] * 1e-9 if instants else float("nan")

    return value


def _listed(item: Measured, window: Window) -> bool:
    return item.object_of(str(window.argument)) is not None


def _scored(figure: Callable[[Score], float]) -> Callable[[Window], Value]:
    """A figure of the lists against the truth."""

    def value(window: Window) -> Value:
        score = ObjectScore()
        for item in window.measured:
            if item.truth or item.objects:
                score.add(item.objects, item.truth)
        return figure(score.total)

    return value


def _range_at(window: Window) -> Value:
    wanted = np.radians(float(window.argument or 0.0))

    def at(scan: HostScan) -> float:
        if not len(scan.azimuth_rad):
            return float("nan")
        away = np.abs(np.angle(np.exp(1j * (scan.azimuth_rad - wanted))))
        nearest = int(np.argmin(away))
        return float(scan.range_m[nearest]) if away[nearest] < np.radians(1.0) else float("nan")

    return np.array([at(scan) for _, _, scan in window.read], dtype=np.float64)


def _range_errors(window: Window) -> Value:
    errors = []
    for _, began_ns, scan in window.read:
        truth = None if began_ns is None else window.series.measured.get(began_ns)
        if truth is not None and len(scan.azimuth_rad) and len(truth.azimuth_rad):
            order = np.argsort(truth.azimuth_rad, kind="stable")
            azimuths = truth.azimuth_rad[order]
            right = np.clip(np.searchsorted(azimuths, scan.azimuth_rad), 1, len(azimuths) - 1) if len(order) > 1 else 0
            left = np.maximum(right - 1, 0)
            closer = np.abs(azimuths[left] - scan.azimuth_rad) < np.abs(azimuths[right] - scan.azimuth_rad)
            nearest = np.where(closer, left, right)
            error = np.abs(scan.range_m - truth.range_m[order][nearest])
            error = error[(np.abs(azimuths[nearest] - scan.azimuth_rad) < MATCH_RAD) & ~np.isnan(error)]
            errors.append(float(error.max()) if len(error) else float("nan"))
    return np.array(errors, dtype=np.float64)


def _sent(window: Window) -> Floats:
    return np.array([at_ns for at_ns in window.series.sent_ns if window.holds(at_ns)], dtype=np.float64) * 1e-9


def _rate(window: Window) -> Value:
    sent = _sent(window)
    return float((len(sent) - 1) / (sent[-1] - sent[0])) if len(sent) > 1 and sent[-1] > sent[0] else float("nan")


def _total(count: Callable[[Instrument], int]) -> Callable[[Window], Value]:
    return lambda window: float(count(window.instrument))


@dataclass(frozen=True)
class Quantity:
    """One name behind `SENSOR.`."""

    value: Callable[[Window], Value]
    help: str
    wants: str = ""
    "`actor`, `angle` or `fault` in parentheses."


def _clock(number: Callable[[Told], float]) -> Callable[[Window], Value]:
    def value(window: Window) -> Value:
        told = [one for one in window.series.told.values() if window.holds(one.true_ns)]
        return np.array([number(one) for one in told], dtype=np.float64)

    return value


def _faults(window: Window) -> Value:
    running = window.instrument.faults
    return 0.0 if running is None else float(running.hits_of(str(window.argument)))


QUANTITIES: Mapping[str, Quantity] = {
    "scans_per_s": Quantity(_rate, "scans sent a second, from the first to the last"),
    "scans_sent": Quantity(lambda window: float(len(_sent(window))), "scans handed to the first link"),
    "scans_read": Quantity(lambda window: float(len(window.read)), "scans that the built-in host decoded"),
    "scans_measured": Quantity(lambda window: float(len(window.measured)), "sweeps measured and taken"),
    "scans_dropped": Quantity(_total(lambda one: one.stats.scans_dropped.total()), "scans given up; whole run"),
    "input_dropped": Quantity(_total(lambda one: one.stats.input_dropped.total()), "input not taken; whole run"),
    "replies_sent": Quantity(_total(lambda one: one.stats.replies_sent), "replies; whole run"),
    "restarts": Quantity(_total(lambda one: one.stats.restarts), "power-ons and resets; whole run"),
    "faults": Quantity(_faults, "hits of the faults of that name; whole run", "fault"),
    "bytes_out": Quantity(lambda window: float(window.series.bytes_out), "bytes sent; whole run"),
    "bytes_in": Quantity(lambda window: float(window.series.bytes_in), "bytes received; whole run"),
    "lateness_us": Quantity(
        lambda window: window.instrument.stats.lateness.latest_ns().astype(np.float64) * 1e-3,
        "series: actual minus scheduled instant of each send; under a virtual clock the grouping of bytes alone",
    ),
    "gap_s": Quantity(lambda window: np.diff(_sent(window)), "series: time from scan to scan; its max is the recovery"),
    "first_scan_s": Quantity(
        lambda window: float(sent[0]) if len(sent := _sent(window)) else float("nan"), "when the first scan left"
    ),
    "points": Quantity(_of_measured(_points), "series: beams with an echo"),
    "points_on": Quantity(_of_measured(_points_on), "series: beams whose first echo is that actor's", "actor"),
    "nearest_m": Quantity(_of_measured(_nearest), "series: shortest range"),
    "nearest_on": Quantity(_of_measured(_nearest_on), "series: shortest range to that actor [m]", "actor"),
    "clock_error_s": Quantity(
        _clock(lambda one: (one.device_ns - one.true_ns) * 1e-9),
        "series: time that the device's telegrams tell, not wrapped, minus the run's",
    ),
    "clock_ticks": Quantity(_clock(lambda one: float(one.ticks)), "series: the same time in ticks, as on the wire"),
    "objects": Quantity(_of_measured(lambda item, _: float(len(item.objects))), "series: objects in the list"),
    "object": Quantity(_of_measured(_object), "series: objects that are that actor", "actor"),
    "object_range_m": Quantity(
        _of_object(lambda one: math.hypot(one.position_m[0], one.position_m[1])),
        "series: distance of the object that is that actor; missing in lists without it",
        "actor",
    ),
    "object_speed_m_s": Quantity(
        _of_object(lambda one: math.hypot(one.velocity_m_s[0], one.velocity_m_s[1])),
        "series: its speed against the sensor",
        "actor",
    ),
    "object_existence": Quantity(
        _of_object(lambda one: one.existence), "series: its probability of existence", "actor"
    ),
    "object_coasting_s": Quantity(_of_object(lambda one: one.coasting_s), "series: time since its last echo", "actor"),
    "object_from_s": Quantity(_when(0, _listed), "instant of the first list that has that actor", "actor"),
    "object_until_s": Quantity(_when(-1, _listed), "instant of the last list that has that actor", "actor"),
    "visible_share": Quantity(
        _of_measured(_share), "series: share of the beams towards that actor that reach it, beside a list", "actor"
    ),
    "visible_until_s": Quantity(
        _when(-1, lambda item, window: _share(item, window) > 0.0),
        "instant of the last list for which a beam saw that actor",
        "actor",
    ),
    "object_precision": Quantity(_scored(lambda score: score.precision), "share of listed objects that are real"),
    "object_recall": Quantity(_scored(lambda score: score.recall), "share of the actors to be seen that are listed"),
    "object_position_error_m": Quantity(
        _scored(lambda score: score.position_m), "root mean square, of matched objects"
    ),
    "object_size_error_m": Quantity(
        _scored(lambda score: score.size_m), "mean of length and width, of matched objects"
    ),
    "object_speed_error_m_s": Quantity(_scored(lambda score: score.speed_m_s), "root mean square, of matched objects"),
    "range_at": Quantity(_range_at, "series: range that the host read nearest to that azimuth [deg]", "angle"),
    "range_error_m": Quantity(_range_errors, "series: largest difference of what the host read and what was measured"),
}


def check_name(name: Name, sensors: Sequence[str], actors: Sequence[str]) -> None:
    """`ExpressionError` for a name that means nothing in this scenario."""
    if name.parts == ("duration_s",) and name.argument is None:
        return
    if len(name.parts) != 2:
        near = _one_of(name.parts[0], sensors)
        raise ExpressionError(f"{name}; want SENSOR.QUANTITY or duration_s, SENSOR being {near}")
    sensor, quantity = name.parts
    if sensor not in sensors:
        raise ExpressionError(f"sensor {sensor!r}; want {_one_of(sensor, sensors)}")
    known = QUANTITIES.get(quantity)
    if known is None:
        raise ExpressionError(f"{sensor}.{quantity}; want {_one_of(quantity, tuple(QUANTITIES))}")
    if known.wants == "actor" and name.argument not in actors:
        raise ExpressionError(f"{name}: actor {name.argument!r}; want {_one_of(str(name.argument), actors)}")
    if known.wants == "fault":
        from emulator.faults.catalogue import kinds

        if name.argument not in kinds():
            raise ExpressionError(
                f"{name}: fault {name.argument!r}; want {_one_of(str(name.argument), tuple(kinds()))}"
            )
    if known.wants == "angle" and not isinstance(name.argument, float):
        raise ExpressionError(f"{name}: {name.argument!r}; want an azimuth in degrees, as {quantity}(0)")
    if not known.wants and name.argument is not None:
        raise ExpressionError(f"{name}: {quantity} takes nothing in parentheses")


def _one_of(found: str, known: Sequence[str]) -> str:
    near = difflib.get_close_matches(found, known, n=1)
    return (f"{near[0]} or another of " if near else "one of ") + (", ".join(known) or "none: there are none")


def lookup(
    watcher: SeriesWatcher,
    instruments: Mapping[str, Instrument],
    actors: tuple[str, ...],
    from_ns: int,
    to_ns: int,
    end_ns: int,
) -> Callable[[Name], Value]:
    """Gives names their values within a window of time; names are checked before."""

    def value(name: Name) -> Value:
        if name.parts == ("duration_s",):
            return end_ns * 1e-9
        sensor, quantity = name.parts
        window = Window(watcher.sensors[sensor], instruments[sensor], actors, from_ns, to_ns, name.argument)
        return QUANTITIES[quantity].value(window)

    return value
