"""A recording at any of its instants: what had been sent and measured by then."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from emulator.process.clock import ManualClock
from emulator.recording.layout import RecordedScan
from emulator.recording.reader import RecordedRun, WireOf, WirePayload
from emulator.scenario import scenario
from emulator.view import recorded
from emulator.view.frames import ShownScan, ViewError

SECOND = 10**9


def scan(start_ns: int, sweep: int) -> RecordedScan:
    one = np.ones((2, 1))
    return RecordedScan(start_ns, sweep, 0, np.zeros(2), one, one, np.zeros((2, 1), np.int32), ())


LASERS = 16


def cut(number: int, turn: int, firings: int = 8, echoes: int = 1) -> RecordedScan:
    """A slice of 5 ms, of `turn` slices a turn; the range tells the number."""
    n = LASERS * firings
    azimuth = np.full(n, np.remainder(-2.0 * np.pi * number / turn + np.pi, 2.0 * np.pi) - np.pi)
    elevation = np.tile(np.radians(np.arange(-15.0, 17.0, 2.0)), firings)
    range_m = np.full((n, echoes), 1.0 + number)
    actor = np.zeros((n, echoes), np.int32)
    return RecordedScan(number * 5_000_000, number, 0, azimuth, range_m, range_m, actor, (), elevation_rad=elevation)


def recorded_slices(slices: list[RecordedScan], clock: ManualClock, patch: pytest.MonkeyPatch) -> ShownScan:
    run = RecordedRun(Path("somewhere/run.mcap"), scenario.dump(scenario.load("crossing_car")))
    run.scans["front"] = slices
    patch.setattr(recorded, "read_run", lambda path: run)
    source = recorded.RecordedSource(Path("somewhere"), clock)
    source.order("seek", {"to_s": 0.301})
    return source.frame().scans["front"]


@pytest.mark.parametrize(("turn", "shown"), [(20, 20), (10, 10), (40, 20)])
def test_slices_are_shown_as_the_turn_that_ends_with_the_newest(
    turn: int, shown: int, clock: ManualClock, monkeypatch: pytest.MonkeyPatch
) -> None:
    slices = [cut(number, turn, echoes=1 + (number == 50)) for number in range(80)]
    found = recorded_slices(slices, clock, monkeypatch)
    numbers = list(range(61 - shown, 61))
    assert sorted(set(found.range_m[:, 0] - 1.0)) == numbers
    assert found.start_s == pytest.approx(0.005 * numbers[0])
    assert found.every == 1
    assert len(found.azimuth_rad) == shown * 128
    assert found.range_m.shape[1] == 1 + (50 in numbers)


def test_a_turn_of_many_points_is_thinned_out_and_scans_of_one_layer_stay_apart(
    clock: ManualClock, monkeypatch: pytest.MonkeyPatch
) -> None:
    found = recorded_slices([cut(number, 20, 400) for number in range(80)], clock, monkeypatch)
    assert found.range_m.size <= recorded.MOST_POINTS < found.range_m.size * 1.5
    assert len(np.unique(np.round(np.degrees(found.elevation_rad)))) == LASERS
    flat = [cut(number, 20) for number in range(80)]
    level = [RecordedScan(**vars(one) | {"elevation_rad": np.zeros(128)}) for one in flat]
    assert set(recorded_slices(level, clock, monkeypatch).range_m[:, 0]) == {61.0}


@pytest.fixture
def clock() -> ManualClock:
    return ManualClock()


@pytest.fixture
def source(clock: ManualClock, monkeypatch: pytest.MonkeyPatch) -> recorded.RecordedSource:
    """Ten seconds: a scan each half second from 1 s to 5 s, its telegram 20 ms later; a command at 0.5 s."""
    run = RecordedRun(Path("somewhere/run.mcap"), scenario.dump(scenario.load("crossing_car")))
    starts = [SECOND + place * SECOND // 2 for place in range(9)]
    run.scans["front"] = [scan(start, place) for place, start in enumerate(starts)]
    sent = [WirePayload(start + 20_000_000, start + 30_000_000, b"abc", sweep=one) for one, start in enumerate(starts)]
    sent.append(WirePayload(10 * SECOND, 10 * SECOND, b"end"))
    run.sent["front", 0] = WireOf("front", 0, "serial", "pty:./lms", sent)
    run.received["front", 0] = WireOf("front", 0, "serial", "pty:./lms", [WirePayload(SECOND // 2, SECOND // 2, b"xy")])
    run.events.append((SECOND // 2, "front", {"event": "CommandHandled", "command": "20 24"}))
    monkeypatch.setattr(recorded, "read_run", lambda path: run)
    return recorded.RecordedSource(Path("somewhere"), clock)


def test_it_plays_at_its_own_pace_and_stands_at_its_end(source: recorded.RecordedSource, clock: ManualClock) -> None:
    assert (source.length_s, source.title) == (10.0, "somewhere")
    clock.set(SECOND * 21 // 10)
    frame = source.frame()
    assert (frame.now_s, frame.paused) == (2.1, False)
    assert frame.scans["front"].sweep == 2
    assert frame.sensors["front"].scans_sent == 3
    assert frame.sensors["front"].rate_hz == pytest.approx(2.0)
    assert (frame.sensors["front"].links[0].bytes_out, frame.sensors["front"].links[0].bytes_in) == (9, 2)
    assert [row.data for row in frame.telegrams["front"]] == [b"xy", b"abc", b"abc", b"abc"]
    assert frame.notes == ("0.500 s front: CommandHandled 20 24",)
    clock.set(50 * SECOND)
    frame = source.frame()
    assert (frame.now_s, frame.paused, dict(frame.scans)) == (10.0, True, {})
    source.order("seek", {"to_s": 3.0})
    clock.set(51 * SECOND)
    assert (source.frame().now_s, source.frame().paused) == (3.0, True)
    source.order("seek", {"to_s": 10.0})
    source.order("resume", {})
    assert (source.frame().now_s, source.frame().paused) == (0.0, False)


def test_its_time_is_moved_by_orders(source: recorded.RecordedSource, clock: ManualClock) -> None:
    source.order("pause", {})
    clock.set(5 * SECOND)
    assert source.frame().now_s == 0.0
    assert source.order("step", {"scans": 1}) == {"now_s": 1.0}
    assert source.frame().scans["front"].sweep == 0
    assert source.order("step", {"scans": 1}) == {"now_s": 1.5}
    assert source.order("step", {"seconds": 1.25}) == {"now_s": 2.75}
    assert source.order("seek", {"to_s": 99.0}) == {"now_s": 10.0}
    assert source.order("seek", {"to_s": -1.0}) == {"now_s": 0.0}
    source.order("speed", {"x": 4})
    source.order("resume", {})
    clock.set(6 * SECOND)
    assert source.frame().now_s == 4.0


def test_it_begins_again_when_told_to(source: recorded.RecordedSource, clock: ManualClock) -> None:
    assert source.length_s is not None
    source.order("seek", {"to_s": source.length_s})
    assert source.frame().paused
    assert source.can_restart
    source.order("restart", {})
    assert not source.frame().paused
    assert source.frame().now_s == 0.0
    clock.set(clock.now_ns() + 100_000_000)
    assert source.frame().now_s == pytest.approx(0.1)


def test_what_would_change_it_is_refused(source: recorded.RecordedSource) -> None:
    with pytest.raises(ViewError, match="a recording cannot be changed"):
        source.order("weather", {"fog": None})


def test_one_cut_before_its_scenario_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(recorded, "read_run", lambda path: RecordedRun(Path("run.mcap")))
    with pytest.raises(ViewError, match="truncated within its first bytes"):
        recorded.RecordedSource(Path("run.mcap"))
