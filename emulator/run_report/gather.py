"""One pass over a recording: what each sensor and the run did, in sums and short series.

Belongs here: counting. Not: true ranges (truth), error sums (errors), the page (page).
"""

from __future__ import annotations

import math
from array import array
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from emulator.instrument.stats import SCAN_REASONS
from emulator.objects.metrics import ObjectScore, TruthObject
from emulator.recording.layout import RecordedScan
from emulator.recording.streaming import Beams, Cut, End, Head, Left, Measured, Progress, Reported, Wire, items
from emulator.run_report.sight import Sight
from emulator.run_report.truth import SensorTruth, Truth, truth_of
from emulator.scenario.scenario import Scenario
from protocols.scan import DetectedObject, Floats

MOST_HAPPENINGS = 5_000
"Happenings of a run that are kept for its time line; later ones are counted."


@dataclass(frozen=True)
class Happening:
    """One thing on the time line."""

    at_ns: int
    sensor: str
    "`run`: of the whole run."
    kind: str
    "restart | mode | fault | order | event"
    text: str
    row: Mapping[str, Any] = field(default_factory=dict, compare=False)


@dataclass
class LinkTally:
    """One link of a sensor."""

    url: str = ""
    kind: str = ""
    sent: int = 0
    "Payloads: telegrams, datagrams, frames."
    bytes_out: int = 0
    received: int = 0
    bytes_in: int = 0
    replies: int = 0
    peers: set[int] = field(default_factory=set)
    due_ns: array[int] = field(default_factory=lambda: array("q"))
    "Last bit of each payload whose departure is recorded: of runs in real time."
    late_ns: array[int] = field(default_factory=lambda: array("q"))
    "By how much later it had left."

    def left(self, item: Left) -> None:
        """Some payloads have left."""
        self.due_ns.extend(item.due_ns.tolist())
        self.late_ns.extend(np.maximum(0, item.actual_ns - item.due_ns).tolist())


def late_us(link: LinkTally) -> tuple[int, float, float, float]:
    """How many payloads' departures are recorded; median, 99 % and worst of how late they were. [us]"""
    values = np.array(link.late_ns, dtype=np.int64) * 1e-3
    median, p99, worst = np.percentile(values, (50.0, 99.0, 100.0))
    return len(values), float(median), float(p99), float(worst)


@dataclass
class CommandTally:
    """One command with one outcome."""

    count: int = 0
    first_ns: int = 0
    last_ns: int = 0


@dataclass
class FaultTally:
    """One fault of the run, on one sensor."""

    name: str
    begun_ns: int | None = None
    ended_ns: int | None = None
    "None: not within the recording."
    hits: int = 0


class ObjectTally:
    """Lists of objects against the truth beside them."""

    def __init__(self) -> None:
        self.score = ObjectScore()
        self.lists = 0
        self.at_ns, self.error_m = array("q"), array("d")
        self.listed, self.false, self.missed = array("i"), array("i"), array("i")
        self.judged = 0
        "Lists with truth beside them."

    def add(self, scan: RecordedScan) -> None:
        """One list."""
        self.lists += 1
        found = [_object(row) for row in scan.objects]
        truth = [_truth(row) for row in scan.truth]
        if not truth and not found:
            return
        self.judged += bool(truth)
        judged = self.score.add(found, truth)
        squares = [
            (one.position_m[0] - true.position_m[0]) ** 2 + (one.position_m[1] - true.position_m[1]) ** 2
            for one, true in judged.matched
        ]
        self.at_ns.append(scan.start_ns)
        self.error_m.append(math.sqrt(sum(squares) / len(squares)) if squares else math.nan)
        self.listed.append(len(found))
        self.false.append(len(judged.false))
        self.missed.append(len(judged.missed))


def _three(values: Any) -> tuple[float, float, float]:
    x, y, z = map(float, values)
    return x, y, z


def _object(row: Mapping[str, Any]) -> DetectedObject:
    return DetectedObject(
        int(row["track"]), _three(row["position_m"]), _three(row["velocity_m_s"]), _three(row["size_m"]),
        float(row["yaw_rad"]), str(row["category"]), existence=float(row.get("existence", 1.0)),
        actor=None if row.get("actor") is None else str(row["actor"]), coasting_s=float(row.get("coasting_s", 0.0)),
    )  # fmt: skip


def _truth(row: Mapping[str, Any]) -> TruthObject:
    return TruthObject(
        str(row["actor"]), _three(row["position_m"]), _three(row["velocity_m_s"]), _three(row["size_m"]),
        float(row.get("yaw_rad", 0.0)), float(row.get("visible_share", 1.0)),
    )  # fmt: skip


class SensorTally:
    """One sensor's run."""

    def __init__(self, sensor: str) -> None:
        self.sensor = sensor
        self.model = ""
        self.sent_ns = array("q")
        "First bit of each scan on the first link."
        self.first_link: int | None = None
        self.links: dict[int, LinkTally] = {}
        self.measured = 0
        self.sweep_ns, self.points = array("q"), array("i")
        self.scans_dropped: Counter[str] = Counter()
        self.input_dropped: Counter[str] = Counter()
        self.drop_details: Counter[tuple[str, str]] = Counter()
        self.commands: dict[tuple[str, str], CommandTally] = {}
        self.restarts = 0
        self.faults: dict[int, FaultTally] = {}
        "By the fault's number within the run."
        self.truth: SensorTruth | None = None
        self.objects: ObjectTally | None = None
        self.end: Mapping[str, Any] = {}

    @property
    def rate_hz(self) -> float:
        """Scans sent a second from the first to the last, a silence at the end included; NaN below two."""
        count = len(self.sent_ns)
        span_ns = self.sent_ns[-1] - self.sent_ns[0] + self.silent_s * 1e9 if count > 1 else 0
        return (count - 1) * 1e9 / span_ns if span_ns > 0 else math.nan

    @property
    def gaps_s(self) -> Floats:
        """From scan to scan, and a silence at the end, (n,)."""
        found = np.diff(np.array(self.sent_ns, dtype=np.int64)).astype(np.float64) * 1e-9
        return np.append(found, self.silent_s) if self.silent_s else found

    @property
    def silent_s(self) -> float:
        """For how long no scan had left at the end although hosts were owed some; 0: it was not silent."""
        value = self.end.get("silent_s")
        return float(value) if isinstance(value, int | float) and math.isfinite(value) and value > 0 else 0.0

    def wire(self, item: Wire) -> None:
        """A payload."""
        link = self.links.setdefault(item.link, LinkTally(item.url, item.kind))
        link.peers.add(item.payload.peer)
        if not item.sent:
            link.received += 1
            link.bytes_in += len(item.payload.data)
            return
        link.sent += 1
        link.bytes_out += len(item.payload.data)
        if item.payload.sweep is None:
            link.replies += 1
            return
        if self.first_link is None:
            self.first_link = item.link
        if item.link == self.first_link:
            self.sent_ns.append(item.payload.start_ns)

    def scan(self, scan: RecordedScan) -> None:
        """A sweep, or a list."""
        self.measured += 1
        if len(scan.azimuth_rad):
            self.sweep_ns.append(scan.start_ns)
            self.points.append(int(np.count_nonzero(np.isfinite(scan.range_m).any(axis=1))))
            if self.truth is not None:
                self.truth.add(scan)
        else:
            if self.objects is None:
                self.objects = ObjectTally()
            self.objects.add(scan)

    def finish(self, row: Mapping[str, Any]) -> None:
        """The counters of the end: they hold what no event reports, scans that faults took or that were switched
        off."""
        self.end = row
        for counts, key in ((self.scans_dropped, "scans_dropped"), (self.input_dropped, "input_dropped")):
            found = row.get(key)
            for reason, count in found.items() if isinstance(found, Mapping) else ():
                if isinstance(count, int):
                    counts[str(reason)] = max(counts[str(reason)], count)

    def happened(self, at_ns: int, row: Mapping[str, Any]) -> Happening | None:
        """An event of the sensor, counted; what belongs on the time line."""
        kind = str(row.get("event", ""))
        if kind == "Dropped":
            reason, count = str(row.get("reason", "")), int(row.get("count", 1))
            (self.scans_dropped if reason in SCAN_REASONS else self.input_dropped)[reason] += count
            if len(self.drop_details) < MOST_HAPPENINGS:
                self.drop_details[reason, str(row.get("detail", ""))] += count
            return None
        if kind == "CommandHandled":
            key = str(row.get("command", "")), str(row.get("outcome", ""))
            if len(self.commands) < MOST_HAPPENINGS or key in self.commands:
                tally = self.commands.setdefault(key, CommandTally(0, at_ns, at_ns))
                tally.count += 1
                tally.last_ns = at_ns
            return None
        if kind == "Restarted":
            self.restarts += 1
            return Happening(at_ns, self.sensor, "restart", "restarted")
        if kind == "ModeChanged":
            return Happening(at_ns, self.sensor, "mode", str(row.get("mode", "")))
        if kind.startswith("Fault"):
            return self._fault(at_ns, row)
        return Happening(at_ns, self.sensor, "event", _reported(row), row)

    def _fault(self, at_ns: int, row: Mapping[str, Any]) -> Happening | None:
        """Each hit is counted; begin and end go on the time line."""
        what = str(row.get("what", ""))
        number = int(row.get("number", 0))
        fault = self.faults.setdefault(number, FaultTally(str(row.get("name", ""))))
        if what == "hit":
            fault.hits += 1
            return None
        if what == "begin":
            fault.begun_ns = at_ns
        elif what == "end":
            fault.ended_ns = at_ns
        reported = " ".join(str(row[key]) for key in ("name", "what", "detail") if row.get(key))
        return Happening(at_ns, self.sensor, "fault", reported, row)


def _reported(row: Mapping[str, Any]) -> str:
    rest = ", ".join(_pairs({key: value for key, value in row.items() if key not in ("event", "at_ns")}))
    return f"{row.get('event', '')} {rest}".strip()


def _pairs(row: Mapping[str, Any], inside: str = "") -> Iterator[str]:
    """Keys with their values, tables within as `table.key value`."""
    for key, value in row.items():
        if isinstance(value, Mapping):
            yield from _pairs(value, f"{inside}{key}.")
        elif isinstance(value, float):
            yield f"{inside}{key} {value:.9g}"
        elif value != "":
            yield f"{inside}{key} {'none' if value is None else value}"


@dataclass
class Gathered:
    """Everything of a recording that a report shows."""

    path: Path
    version: str = ""
    scenario_text: str = ""
    scenario: Scenario | None = None
    truth: Truth | None = None
    scene: Truth | None = None
    "The same, for pictures, also where ranges are not compared."
    sight: Sight = field(default_factory=Sight)
    sensors: dict[str, SensorTally] = field(default_factory=dict)
    happenings: list[Happening] = field(default_factory=list)
    happenings_left_out: int = 0
    orders: list[Happening] = field(default_factory=list)
    remarks: list[str] = field(default_factory=list)
    "What a reader must know to trust the figures."
    cut: str = ""
    ended: bool = False
    "The counters of the run's end are there."
    last_ns: int = 0
    verdict: Mapping[str, Any] = field(default_factory=dict)
    "What was expected and found, as the last one to judge the run has reported."
    judged_ns: int = 0

    @property
    def end_s(self) -> float:
        """Up to the last thing recorded, or to when the run was judged."""
        return max(self.last_ns, self.judged_ns) * 1e-9

    @property
    def duration_s(self) -> float:
        """Up to the last thing recorded."""
        return self.last_ns * 1e-9

    def sensor(self, name: str) -> SensorTally:
        """That sensor's tally."""
        if name not in self.sensors:
            tally = self.sensors[name] = SensorTally(name)
            if self.truth is not None and self.scenario is not None:
                if any(one.id == name for one in self.scenario.sensors):
                    tally.truth = self.truth.tally_of(name)
        return self.sensors[name]


def gather(path: Path, with_truth: bool = True, tell: Callable[[Progress], None] = lambda progress: None) -> Gathered:
    """Read a recording once; `tell` is called now and then. Raises `RecordingError` when it is none."""
    progress = Progress()
    run = Gathered(path)
    offsets_s: dict[str, Floats] = {}
    for number, item in enumerate(items(path, progress)):
        if number % 256 == 0:
            tell(progress)
        if isinstance(item, Wire):
            run.last_ns = max(run.last_ns, item.payload.end_ns)
            run.sensor(item.sensor).wire(item)
        elif isinstance(item, Left):
            if (link := run.sensor(item.sensor).links.get(item.link)) is not None:
                link.left(item)
        elif isinstance(item, Measured):
            run.last_ns = max(run.last_ns, item.scan.start_ns)
            run.sight.add(item.sensor, item.scan, offsets_s.get(item.sensor))
            _scan(run, item)
        elif isinstance(item, Beams):
            offsets_s[item.sensor] = item.fire_offset_s
            tally = run.sensor(item.sensor)
            if tally.truth is not None:
                tally.truth.offsets_s = item.fire_offset_s
        elif isinstance(item, Reported) and item.sensor == "run" and item.row.get("event") == "Verdict":
            run.verdict, run.judged_ns = item.row, item.at_ns
        elif isinstance(item, Reported):
            run.last_ns = max(run.last_ns, item.at_ns)
            _happened(run, item)
        elif isinstance(item, Head):
            _begin(run, item, with_truth)
        elif isinstance(item, End):
            run.ended = True
            for name, row in item.sensors.items():
                run.sensor(name).finish(row)
        elif isinstance(item, Cut):
            run.cut = item.reason
    for tally in run.sensors.values():
        if tally.truth is not None:
            tally.truth.flush()
    tell(progress)
    _remark(run)
    return run


def _scan(run: Gathered, item: Measured) -> None:
    try:
        run.sensor(item.sensor).scan(item.scan)
    except (KeyError, TypeError, ValueError) as error:  # an object or truth of another form
        reported = f"{item.sensor}: lists of objects are not read: {type(error).__name__}: {error}"
        if reported not in run.remarks:
            run.remarks.append(reported)


def _begin(run: Gathered, head: Head, with_truth: bool) -> None:
    run.version, run.scenario_text = head.version, head.scenario
    folder = run.path if run.path.is_dir() else run.path.parent
    run.scenario, truth = truth_of(head.scenario, folder / "scenario.yaml", run.remarks.append)
    run.scene, run.truth = truth, truth if with_truth else None
    for sensor in () if run.scenario is None else run.scenario.sensors:
        run.sensor(sensor.id).model = sensor.model


def _happened(run: Gathered, item: Reported) -> None:
    if item.sensor == "run":
        order = str(item.row.get("event", "")) == "Order"
        rest = {key: value for key, value in item.row.items() if key not in ("event", "order")}
        text = f"{item.row.get('order', '')} {_reported(rest)}".strip() if order else _reported(item.row)
        found: Happening | None = Happening(item.at_ns, "run", "order" if order else "event", text, item.row)
    else:
        found = run.sensor(item.sensor).happened(item.at_ns, item.row)
    if found is None:
        return
    if found.kind in ("order", "event") and found.sensor == "run" and len(run.orders) < MOST_HAPPENINGS:
        run.orders.append(found)
    if len(run.happenings) < MOST_HAPPENINGS:
        run.happenings.append(found)
    else:
        run.happenings_left_out += 1


def _remark(run: Gathered) -> None:
    """What the figures cannot tell."""
    if run.cut:
        run.remarks.append(f"The recording is cut ({run.cut}); everything up to there is counted.")
    elif not run.ended:
        run.remarks.append(
            "The recording has no counters of its end: the run was ended by force, or the recording is of an older"
            " version. Lateness is not known, nor how many scans faults took away."
        )
    reported = run.verdict.get("warnings", ())
    run.remarks += (
        [f"Warning: {text}" for text in reported if isinstance(text, str)] if isinstance(reported, list) else []
    )
    for one in run.sensors.values():
        if one.silent_s and not any(text.startswith(f"Warning: {one.sensor}: silent") for text in run.remarks):
            run.remarks.append(f"Warning: {one.sensor}: silent at the end, no scan for {one.silent_s:.3f} s.")
    seeing = [one for one in run.sensors.values() if one.measured]
    if not seeing:
        run.remarks.append("No scans are recorded (recorded without truth): nothing is said of ranges and objects.")
    for one in seeing:
        if one.truth is not None and one.truth.without_offsets:
            run.remarks.append(
                f"{one.sensor}: instants of beams are not recorded for {one.truth.without_offsets} sweeps; true ranges"
                " are those at the sweep's start, so errors on moving things hold their way within a sweep."
            )
        if one.objects is not None and one.objects.lists and not one.objects.judged:
            run.remarks.append(f"{one.sensor}: no truth stands beside its lists of objects.")
