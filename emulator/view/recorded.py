"""A recording of lidaremu, shown at any of its instants; its clock is the page's."""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from emulator.process.clock import Clock, SystemClock
from emulator.recording.layout import RecordedScan
from emulator.recording.reader import RecordedRun, WireOf, read_run
from emulator.runtime.snapshots import spacing
from emulator.scenario import scenario as scenario_file
from emulator.scenario.scenario import Scenario
from emulator.view.frames import Frame, ShownLink, ShownScan, ShownSensor, ShownTelegram, ViewError
from emulator.world.feed_record import Played

LAST = 32
"Telegrams shown of each sensor."
STALE_S = 2.0
"A scan older than this is shown no more."
TURN_S = 0.1
"Slices of so long at the most are shown together."
SLICED_S = 0.03
"Scans of several layers that follow each other so fast are slices."
MOST_POINTS = 20_000
"Beams times echoes shown of a turn."


@dataclass(frozen=True, eq=False)
class _Wire:
    """What went one way on a link, ready to be looked up."""

    wire: WireOf
    sent: bool
    starts: list[int]
    total: NDArray[np.int64]
    "(payloads + 1,) bytes of those before."
    carried: list[int]
    "First bits of payloads that begin a scan."

    @classmethod
    def of(cls, wire: WireOf, sent: bool) -> _Wire:
        """In the order of time."""
        wire.payloads.sort(key=lambda one: one.start_ns)
        total = np.cumsum([0, *(len(one.data) for one in wire.payloads)], dtype=np.int64)
        carried = [one.start_ns for one in wire.payloads if sent and one.sweep is not None]
        return cls(wire, sent, [one.start_ns for one in wire.payloads], total, carried)


class RecordedSource:
    """One `run.mcap`, whole in memory. Orders pause, resume, step, speed and `seek` move its time."""

    can_restart = True

    def __init__(self, path: Path, clock: Clock | None = None) -> None:
        """Raises `RecordingError`, `ScenarioError`; `ViewError` when nothing is in it."""
        self._run: RecordedRun = read_run(path)
        if not self._run.scenario:
            raise ViewError(f"{self._run.path}: no scenario in it; it is truncated within its first bytes")
        self.scenario: Scenario = scenario_file.loads(self._run.scenario, self._run.path.parent / "scenario.yaml")
        self.played = None if self.scenario.live is None else Played(self.scenario, self._run.path)
        self.title = self._run.path.parent.name or self._run.path.stem
        self.cut = self._run.cut
        self._clock = clock or SystemClock()
        self._sliced = {name for name, scans in self._run.scans.items() if _is_sliced(scans)}
        self._starts = {name: [scan.start_ns for scan in scans] for name, scans in self._run.scans.items()}
        self._wires: dict[str, list[_Wire]] = {}
        for table, sent in ((self._run.sent, True), (self._run.received, False)):
            for (sensor, _), wire in table.items():
                self._wires.setdefault(sensor, []).append(_Wire.of(wire, sent))
        ends = [starts[-1] for starts in self._starts.values() if starts]
        ends += [one.wire.payloads[-1].end_ns for wires in self._wires.values() for one in wires if one.starts]
        self._end_ns = max(ends, default=0)
        self.length_s: float | None = self._end_ns * 1e-9
        self._events = sorted(self._run.events, key=lambda row: row[0])
        self._at_ns, self._since_ns = 0, self._clock.now_ns()
        self._paused, self._speed = False, 1.0

    def _now_ns(self) -> int:
        moved = 0 if self._paused else int((self._clock.now_ns() - self._since_ns) * self._speed)
        return min(self._at_ns + moved, self._end_ns)

    def order(self, method: str, params: Mapping[str, Any]) -> Any:
        """Move the recording's own time: seek {"to_s"}, pause, resume, step {"scans" | "seconds"}, speed {"x"}."""
        now_ns = self._now_ns()
        self._paused |= now_ns >= self._end_ns  # it stands at its end, and wherever it is moved to from there
        if method == "restart":
            now_ns, self._paused = 0, False
        elif method == "seek":
            now_ns = round(float(params["to_s"]) * 1e9)
        elif method == "step":
            now_ns = self._stepped(now_ns, params)
            self._paused = True
        elif method == "speed":
            self._speed = float(params["x"]) or 1.0
        elif method in ("pause", "resume"):
            self._paused = method == "pause"
            if method == "resume" and now_ns >= self._end_ns:
                now_ns = 0
        else:
            raise ViewError(f"{method}: a recording cannot be changed; want seek, restart, pause, resume, step, speed")
        self._at_ns = min(max(0, now_ns), self._end_ns)
        self._since_ns = self._clock.now_ns()
        return {"now_s": self._at_ns * 1e-9}

    def _stepped(self, now_ns: int, params: Mapping[str, Any]) -> int:
        if "seconds" in params:
            return now_ns + round(float(params["seconds"]) * 1e9)
        coming = [starts[at] for starts in self._starts.values() if (at := bisect_right(starts, now_ns)) < len(starts)]
        return min(coming, default=now_ns)

    def frame(self) -> Frame:
        """What had been sent by the present instant."""
        now_ns = self._now_ns()
        scans, sensors, telegrams = {}, {}, {}
        for sensor in self.scenario.sensors:
            starts = self._starts.get(sensor.id, [])
            count = bisect_right(starts, now_ns)
            if count and now_ns - starts[count - 1] < STALE_S * 1e9:
                scans[sensor.id] = self._scan(sensor.id, count - 1)
            rows, links, sent, rate = self._wire(sensor.id, now_ns)
            telegrams[sensor.id] = rows
            sensors[sensor.id] = ShownSensor(scans_sent=sent, rate_hz=rate, links=links)
        count = bisect_right(self._events, now_ns, key=lambda row: row[0])
        notes = tuple(_note(*row) for row in self._events[max(0, count - 12) : count])
        stands = self._paused or now_ns >= self._end_ns
        return Frame(now_ns * 1e-9, True, stands, self._speed, scans, sensors, telegrams, notes=notes)

    def _scan(self, sensor: str, place: int) -> ShownScan:
        """The scan at a place; of slices those since the sensor came round."""
        newest = _shown(self._run, sensor, place)
        if sensor not in self._sliced:
            return newest
        parts, turned_rad = [newest], 0.0
        while place and len(newest.azimuth_rad):
            place -= 1
            one = _shown(self._run, sensor, place)
            if not len(one.azimuth_rad) or newest.start_s - one.start_s > TURN_S - 1e-6:
                break
            turned_rad += abs(math.remainder(parts[-1].azimuth_rad[0] - one.azimuth_rad[0], 2.0 * math.pi))
            if turned_rad > 2.0 * math.pi - 1e-6:
                break
            parts.append(one)
        return _joined(parts[::-1])

    def _wire(
        self, sensor: str, now_ns: int
    ) -> tuple[tuple[ShownTelegram, ...], tuple[ShownLink, ...], int, float | None]:
        found: list[tuple[int, ShownTelegram]] = []
        links: dict[int, dict[str, Any]] = {}
        sent, last = 0, []
        for one in self._wires.get(sensor, ()):
            wire = one.wire
            count = bisect_right(one.starts, now_ns)
            link = links.setdefault(wire.link, {"url": wire.url, "kind": wire.kind, "bytes_in": 0, "bytes_out": 0})
            link["bytes_out" if one.sent else "bytes_in"] += int(one.total[count])
            for place in range(max(0, count - LAST), count):
                item = wire.payloads[place]
                shown = ShownTelegram(place + 1, wire.link, item.peer, one.sent, item.start_ns * 1e-9, item.data)
                found.append((item.start_ns, shown))
            carried = bisect_right(one.carried, now_ns)
            sent += carried
            last += [at_ns for at_ns in one.carried[max(0, carried - 64) : carried] if now_ns - at_ns < STALE_S * 1e9]
        found.sort(key=lambda row: row[0])
        last.sort()
        rate = (len(last) - 1) * 1e9 / (last[-1] - last[0]) if len(last) > 1 and last[-1] > last[0] else None
        shown_links = tuple(ShownLink(host=None, **link) for _, link in sorted(links.items()))
        return tuple(row for _, row in found[-LAST:]), shown_links, sent, rate

    def close(self) -> None:
        """The file is closed already."""


def _is_sliced(scans: Sequence[RecordedScan]) -> bool:
    """Whether scans are slices of turns, or of frames."""
    if len(scans) < 2 or scans[0].elevation_rad is None:
        return False
    gap_s = 1e-9 * float(np.median(np.diff([scan.start_ns for scan in scans])))
    return gap_s <= SLICED_S and len(np.unique(scans[0].elevation_rad[:128])) > 1


def _joined(parts: Sequence[ShownScan]) -> ShownScan:
    """Slices as one scan that begins with the first; of many points every n-th beam."""
    width = max(one.range_m.shape[1] for one in parts)
    every = spacing(sum(len(one.azimuth_rad) for one in parts) * width, MOST_POINTS)

    def all_of(name: str, nothing: float | None = None) -> NDArray[Any]:
        rows = [getattr(one, name) for one in parts]
        if nothing is not None:
            rows = [
                np.pad(row, ((0, 0), (0, width - row.shape[1])), constant_values=np.asarray(nothing, row.dtype))
                for row in rows
            ]
        return np.concatenate(rows)[::every]

    fires = [one.fire_s + one.start_s - parts[0].start_s for one in parts]
    return replace(
        parts[-1],
        start_s=parts[0].start_s,
        azimuth_rad=all_of("azimuth_rad"),
        elevation_rad=all_of("elevation_rad"),
        fire_s=np.concatenate(fires)[::every],
        range_m=all_of("range_m", np.nan),
        intensity=all_of("intensity", np.nan),
        actor=all_of("actor", -1),
        every=every,
        origin_m=None if any(one.origin_m is None for one in parts) else all_of("origin_m"),
    )


def _shown(run: RecordedRun, sensor: str, place: int) -> ShownScan:
    scan = run.scans[sensor][place]
    offsets = run.offsets.get(sensor, [])
    fire_s = offsets[place] if place < len(offsets) else None
    n = len(scan.azimuth_rad)
    elevation = getattr(scan, "elevation_rad", None)
    return ShownScan(
        start_s=scan.start_ns * 1e-9,
        sweep=scan.sweep,
        azimuth_rad=scan.azimuth_rad,
        elevation_rad=np.zeros(n) if elevation is None else elevation,
        fire_s=np.zeros(n) if fire_s is None else fire_s,  # older recordings have the scan's instant alone
        range_m=scan.range_m,
        intensity=scan.intensity,
        actor=scan.actor,
        objects=scan.objects,
        origin_m=scan.origin_m,
    )


def _note(at_ns: int, sensor: str, row: Mapping[str, object]) -> str:
    rest = ", ".join(f"{value}" for key, value in row.items() if key not in ("event", "at_ns") and value not in ("", 1))
    return f"{at_ns * 1e-9:.3f} s {sensor}: {row.get('event', '')} {rest}".rstrip()
