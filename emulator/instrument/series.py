"""What is recorded of a run for its expectations: numbers a scan, with the time of each.

Belongs here: the values. Not: the names and what they want in parentheses (quantities), the language itself
(expressions), the verdict (expectations).
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from emulator.config.expressions import Name, Value
from emulator.faults.events import FaultEvent
from emulator.hosts.scans import HostScan
from emulator.instrument.cloud_errors import largest
from emulator.instrument.instrument import Instrument
from emulator.instrument.observer import Observer, Payload
from emulator.instrument.owed import GAPS_KEPT, silence_ns, usual_gap
from emulator.objects.metrics import ListedScan, ObjectScore, Score, TruthObject
from emulator.scenario.quantities import box_of
from protocols.device_clock import DeviceStamp
from protocols.scan import DAZZLED, DetectedObject, Floats, Ints, Scan, points_of
from protocols.session import Dropped, Event, Restarted

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
    dazzled: int = 0
    "Beams that light from outside blinds."
    elevation_rad: Floats | None = None
    "(n,); None: all 0"
    turn: int | None = None
    "Of a slice: the turn in which it begins."
    all_m: Floats | None = None
    "(n, k) all echoes"
    origin_m: Floats | None = None
    "(n, 3) where beams begin; None: in the sensor's origin"

    @classmethod
    def joined(cls, slices: Sequence[Measured]) -> Measured:
        """A turn out of its slices."""
        first = slices[0]
        begun = [one.origin_m for one in slices if one.origin_m is not None]
        return cls(
            first.at_ns,
            np.concatenate([one.azimuth_rad for one in slices]),
            np.concatenate([one.range_m for one in slices]),
            np.concatenate([one.actor for one in slices]),
            first.objects,
            first.truth,
            first.sweep,
            sum(one.dazzled for one in slices),
            np.concatenate([one.heights for one in slices]),
            first.turn,
            origin_m=np.concatenate(begun) if len(begun) == len(slices) else None,
        )

    @property
    def heights(self) -> Floats:
        """(n,) elevations. [rad]"""
        return np.zeros(len(self.azimuth_rad)) if self.elevation_rad is None else self.elevation_rad

    @property
    def echoes(self) -> Floats:
        """(n, k) ranges. [m]"""
        return self.range_m[:, None] if self.all_m is None else self.all_m

    def object_of(self, actor: str) -> DetectedObject | None:
        """The object that is that actor; the one seen last when there are several."""
        mine = [item for item in self.objects if item.actor == actor]
        return min(mine, key=lambda item: (item.coasting_s, item.track)) if mine else None


@dataclass
class FaultSpan:
    """A fault of the run, on one sensor."""

    name: str
    begun_ns: int
    ended_ns: int | None = None


@dataclass
class SensorSeries:
    """One sensor's run."""

    measured: dict[int, Measured] = field(default_factory=dict)
    "By the instant at which the sweep began: a device counts its sweeps again after a power cut."
    sent_ns: list[int] = field(default_factory=list)
    "First bit of each scan on the first link that carried it."
    read: list[tuple[int, int | None, HostScan]] = field(default_factory=list)
    "By our host: when, the beginning of the sweep it carried, the scan as decoded."
    cloud_errors: dict[int, float] = field(default_factory=dict)
    "Largest difference of the ranges of each cloud that our host read, by its place in `read`. [m]"
    reported: dict[int, DeviceStamp] = field(default_factory=dict)
    "What scans' telegrams reported of the device's time, by the instant of the run that they reported of."
    bytes_out: int = 0
    bytes_in: int = 0
    faults: dict[int, FaultSpan] = field(default_factory=dict)
    "By their numbers; one that begins again is the newest time."
    hits: deque[tuple[int, int]] = field(default_factory=lambda: deque(maxlen=MOST_UNSENT))
    "Instants at which a fault has hit, and its number."
    events: deque[Event] = field(default_factory=lambda: deque(maxlen=MOST_UNSENT))
    "Drops and restarts."

    def sweeps(self) -> list[Measured]:
        """Sweeps; of a sensor that measures in slices the whole turns, those with slices of the turns around them."""
        groups: list[list[Measured]] = []
        for one in self.measured.values():
            if one.turn is not None and groups and groups[-1][0].turn == one.turn:
                groups[-1].append(one)
            else:
                groups.append([one])
        turns = [group[0].turn for group in groups]
        if None in turns:
            return [one for group in groups for one in group]
        numbers = np.array(turns, dtype=np.int64)
        whole = np.flatnonzero((np.diff(numbers[:-1]) == 1) & (np.diff(numbers[1:]) == 1)) + 1
        return [Measured.joined(groups[index]) for index in whole]


class SeriesWatcher(Observer):
    """Collects the series of all sensors of a run."""

    def __init__(self, sensors: Sequence[str], by_turns: bool = True) -> None:
        """`by_turns`: slices are joined to turns."""
        self._by_turns = by_turns
        self.sensors = {sensor: SensorSeries() for sensor in sensors}
        self._sweeps: dict[str, deque[tuple[int, int]]] = {sensor: deque() for sensor in sensors}
        "End and beginning of the sweep of scans that the host has not read yet."
        self._arrived: dict[str, list[int]] = {}
        "Beginnings of slices that a turn read by the host may be made of."
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
            int(np.count_nonzero(scan.flags & DAZZLED)),
            scan.plan.elevation_rad,
            scan.plan.turn if self._by_turns else None,
            scan.range_m,
            scan.plan.origin_m,
        )

    def reported(self, sensor: str, sweep: int, reported: DeviceStamp) -> None:
        self.sensors[sensor].reported[reported.true_ns] = reported

    def event(self, sensor: str, event: Event | FaultEvent) -> None:
        mine = self.sensors[sensor]
        if isinstance(event, Dropped | Restarted):
            mine.events.append(event)
        elif isinstance(event, FaultEvent):
            if event.what == "begin":
                mine.faults[event.number] = FaultSpan(event.name, event.at_ns)
            elif event.what == "end" and event.number in mine.faults:
                mine.faults[event.number].ended_ns = event.at_ns
            else:
                mine.hits.append((event.at_ns, event.number))

    def host_read(self, sensor: str, at_ns: int, scan: HostScan) -> None:
        """Our host has decoded a scan: the newest one that has wholly arrived, whatever was lost before it."""
        sweeps = self._sweeps[sensor]
        began_ns = None
        mine = self.sensors[sensor]
        arrived = self._arrived.setdefault(sensor, [])
        del arrived[:-2]  # a turn may begin within the newest slice of the one before
        while sweeps and sweeps[0][0] <= at_ns:
            began_ns = sweeps.popleft()[1]
            arrived.append(began_ns)
        if scan.cloud is not None:  # it is compared now: all of them are too many to keep
            slices = [mine.measured[one] for one in arrived if one in mine.measured]
            mine.cloud_errors[len(mine.read)] = largest(scan.cloud, slices, MATCH_RAD)
            scan = replace(scan, cloud=None)
        mine.read.append((at_ns, began_ns, scan))


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
        """Sweeps or turns that began in the window."""
        return [item for item in self.series.sweeps() if self.holds(item.at_ns)]

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


def _inside(item: Measured, window: Window) -> Floats:
    """Ranges of the first echoes in the box."""
    inside = np.full(len(item.range_m), True)
    points = points_of(item.azimuth_rad, item.heights, item.range_m, item.origin_m)
    for place_m, (low, high) in zip(points.T, box_of(str(window.argument)), strict=True):
        with np.errstate(invalid="ignore"):
            inside &= (place_m >= low) & (place_m <= high)
    return np.asarray(item.range_m[inside])


def _nearest_in(item: Measured, window: Window) -> float:
    known = _inside(item, window)
    return float(known.min()) if len(known) else float("nan")


def _layers_on(item: Measured, window: Window) -> float:
    mine = item.actor == window.actors.index(str(window.argument))
    return float(len(np.unique(item.heights[mine])))


def _coverage(item: Measured, window: Window) -> float:
    return float(np.mean(~np.isnan(item.range_m))) if len(item.range_m) else float("nan")


def _turns(window: Window) -> Value:
    begun = [item.at_ns for item in window.measured]
    return (len(begun) - 1) * 1e9 / (begun[-1] - begun[0]) if len(begun) > 1 else float("nan")


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
    errors: list[float] = []
    if window.series.cloud_errors:
        rows = enumerate(window.series.read)
        errors = [window.series.cloud_errors.get(place, math.nan) for place, row in rows if window.holds(row[0])]
        return np.array(errors, dtype=np.float64)
    for _, began_ns, scan in window.read:
        truth = None if began_ns is None else window.series.measured.get(began_ns)
        if truth is not None and _is_matched((0, began_ns, scan), window):
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


def _silence(window: Window) -> tuple[float, float] | None:
    """Beginning and end of the silence of a sensor that owes scans at the window's end; None: it is not silent."""
    span = window.instrument.owed.at(window.to_ns)
    if span is None:
        return None
    before = [at_ns for at_ns in window.series.sent_ns if at_ns <= window.to_ns]
    usual_ns = usual_gap(np.diff(before[-GAPS_KEPT:]).tolist())
    quiet_ns = silence_ns(before[-1] if before else None, span.first_ns, usual_ns, window.to_ns)
    return ((window.to_ns - quiet_ns) * 1e-9, window.to_ns * 1e-9) if quiet_ns else None


def gaps(window: Window) -> tuple[Floats, Floats]:
    """Beginning and length of every gap of a window, a silence at its end the last of them. [s]"""
    sent, silence = _sent(window), _silence(window)
    begins, lengths = sent[:-1], np.diff(sent)
    if silence is None:
        return begins, lengths
    return np.append(begins, silence[0]), np.append(lengths, silence[1] - silence[0])


def _silent(window: Window) -> Value:
    silence = _silence(window)
    return 0.0 if silence is None else silence[1] - silence[0]


def _rate(window: Window) -> Value:
    sent, silence = _sent(window), _silence(window)
    if silence is not None:  # of a sensor that has been silent all the time, none
        first_s = sent[0] if len(sent) else max(silence[0], window.from_ns * 1e-9)
        return max(0, len(sent) - 1) / float(silence[1] - first_s) if silence[1] > first_s else float("nan")
    return float((len(sent) - 1) / (sent[-1] - sent[0])) if len(sent) > 1 and sent[-1] > sent[0] else float("nan")


def _total(count: Callable[[Instrument], int]) -> Callable[[Window], Value]:
    return lambda window: float(count(window.instrument))


def _clock(number: Callable[[DeviceStamp], float]) -> Callable[[Window], Value]:
    def value(window: Window) -> Value:
        reported = [one for one in window.series.reported.values() if window.holds(one.true_ns)]
        return np.array([number(one) for one in reported], dtype=np.float64)

    return value


def _faults(window: Window) -> Value:
    running = window.instrument.faults
    return 0.0 if running is None else float(running.hits_of(str(window.argument)))


VALUES: Mapping[str, Callable[[Window], Value]] = {
    "scans_per_s": _rate,
    "scans_sent": lambda window: float(len(_sent(window))),
    "scans_read": lambda window: float(len(window.read)),
    "scans_measured": lambda window: float(sum(map(window.holds, window.series.measured))),
    "scans_dropped": _total(lambda one: one.stats.scans_dropped.total()),
    "input_dropped": _total(lambda one: one.stats.input_dropped.total()),
    "replies_sent": _total(lambda one: one.stats.replies_sent),
    "restarts": _total(lambda one: one.stats.restarts),
    "faults": _faults,
    "bytes_out": lambda window: float(window.series.bytes_out),
    "bytes_in": lambda window: float(window.series.bytes_in),
    "lateness_us": lambda window: window.instrument.stats.lateness.latest_ns().astype(np.float64) * 1e-3,
    "gap_s": lambda window: gaps(window)[1],
    "silent_s": _silent,
    "first_scan_s": lambda window: float(sent[0]) if len(sent := _sent(window)) else float("nan"),
    "points": _of_measured(_points),
    "points_on": _of_measured(_points_on),
    "points_in": _of_measured(lambda item, window: float(len(_inside(item, window)))),
    "layers_on": _of_measured(_layers_on),
    "coverage": _of_measured(_coverage),
    "dazzled": _of_measured(lambda item, _: float(item.dazzled)),
    "nearest_m": _of_measured(_nearest),
    "nearest_on": _of_measured(_nearest_on),
    "nearest_in": _of_measured(_nearest_in),
    "turns_per_s": _turns,
    "clock_error_s": _clock(lambda one: (one.device_ns - one.true_ns) * 1e-9),
    "clock_ticks": _clock(lambda one: float(one.ticks)),
    "objects": _of_measured(lambda item, _: float(len(item.objects))),
    "object": _of_measured(_object),
    "object_range_m": _of_object(lambda one: math.hypot(one.position_m[0], one.position_m[1])),
    "object_speed_m_s": _of_object(lambda one: math.hypot(one.velocity_m_s[0], one.velocity_m_s[1])),
    "object_existence": _of_object(lambda one: one.existence),
    "object_coasting_s": _of_object(lambda one: one.coasting_s),
    "object_from_s": _when(0, _listed),
    "object_until_s": _when(-1, _listed),
    "visible_share": _of_measured(_share),
    "visible_until_s": _when(-1, lambda item, window: _share(item, window) > 0.0),
    "object_precision": _scored(lambda score: score.precision),
    "object_recall": _scored(lambda score: score.recall),
    "object_position_error_m": _scored(lambda score: score.position_m),
    "object_size_error_m": _scored(lambda score: score.size_m),
    "object_speed_error_m_s": _scored(lambda score: score.speed_m_s),
    "range_at": _range_at,
    "range_error_m": _range_errors,
}
"What each of `quantities.QUANTITIES` is in a window of time."


def _events(window: Window, wanted: Callable[[Event], bool]) -> tuple[int, int] | None:
    found = next((event.at_ns for event in window.series.events if wanted(event)), None)
    return None if found is None else (found, found)


def _gap_span(window: Window, place: Callable[[Floats], int]) -> tuple[int, int] | None:
    begins, lengths = gaps(window)
    if not len(lengths):
        return None
    at = place(lengths)
    return round(begins[at] * 1e9), round((begins[at] + lengths[at]) * 1e9)


def _span(quantity: str, window: Window, index: int | None, lean: int) -> tuple[int, int] | None:
    """When a value was: between which instants, the same for one; None: that cannot be reported."""
    if index is None:
        if quantity in ("scans_per_s", "scans_sent", "scans_read", "scans_measured"):
            return _gap_span(window, lambda lengths: int(np.argmin(lengths) if lean > 0 else np.argmax(lengths)))
        if quantity == "silent_s" and (silence := _silence(window)) is not None:
            return round(silence[0] * 1e9), round(silence[1] * 1e9)
        if quantity == "restarts":
            found = [event.at_ns for event in window.series.events if isinstance(event, Restarted)]
            return (found[-1], found[-1]) if found and lean > 0 else None
        if quantity == "scans_dropped":
            return _events(window, lambda event: isinstance(event, Dropped) and event.reason.of_scans)
        if quantity == "input_dropped":
            return _events(window, lambda event: isinstance(event, Dropped) and not event.reason.of_scans)
        if quantity == "faults":
            named = [one.begun_ns for one in window.series.faults.values() if one.name == window.argument]
            return (named[0], named[0]) if named else None
        if quantity in ("first_scan_s", "object_from_s", "object_until_s", "visible_until_s"):
            at_s = float(np.asarray(VALUES[quantity](window)))
            return None if math.isnan(at_s) else (round(at_s * 1e9), round(at_s * 1e9))
        return None
    if quantity == "gap_s":
        return _gap_span(window, lambda lengths: index)
    if quantity in ("range_at", "range_error_m"):
        every = quantity == "range_at" or bool(window.series.cloud_errors)
        read = [one for one in window.read if every or _is_matched(one, window)]
        instants = [at_ns for at_ns, _, _ in read]
    elif quantity in ("clock_error_s", "clock_ticks"):
        instants = [one.true_ns for one in window.series.reported.values() if window.holds(one.true_ns)]
    elif quantity == "lateness_us":
        return None
    else:
        instants = [one.at_ns for one in window.measured]
    return (instants[index], instants[index]) if index < len(instants) else None


def _is_matched(one: tuple[int, int | None, HostScan], window: Window) -> bool:
    _, began_ns, scan = one
    truth = None if began_ns is None else window.series.measured.get(began_ns)
    return truth is not None and len(scan.azimuth_rad) > 0 and len(truth.azimuth_rad) > 0


def spans(
    watcher: SeriesWatcher,
    instruments: Mapping[str, Instrument],
    actors: tuple[str, ...],
    from_ns: int,
    to_ns: int,
) -> Callable[[Name, int | None, int], tuple[int, int] | None]:
    """Reports when a value of a name was, within a window of time: (name, place in its series or None, lean)."""

    def span(name: Name, index: int | None, lean: int) -> tuple[int, int] | None:
        if len(name.parts) != 2:
            return None
        sensor, quantity = name.parts
        window = Window(watcher.sensors[sensor], instruments[sensor], actors, from_ns, to_ns, name.argument)
        return _span(quantity, window, index, lean)

    return span


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
        return VALUES[quantity](window)

    return value
