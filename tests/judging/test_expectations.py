"""Verdicts on values made by hand, and the series behind them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from emulator.config.expressions import Value
from emulator.hosts.scans import HostScan
from emulator.instrument.instrument import Instrument
from emulator.instrument.observer import Payload
from emulator.instrument.series import VALUES, SeriesWatcher, lookup
from emulator.judging.expectations import judge, understand
from emulator.measuring.measuring import InPlace
from emulator.scenario import scenario
from emulator.scenario.quantities import LIVE, QUANTITIES
from protocols.scan import Scan, ScanPlan
from protocols.session import LinkKind
from tests.instrument.test_instrument import ListLink, ScriptedSession

CASE = """\
schema: 1
actors: [{id: car}]
sensors: [{id: front, model: sick-lms291-s05}]
expect: [%s]
"""


def verdict(line: str, value: Value) -> bool:
    expected = understand(scenario.loads(CASE % line, Path("case.yaml")))
    return judge(expected[0], lambda name: value).held


@pytest.mark.parametrize(
    ("line", "value", "held"),
    [
        ("{that: front.points, within: [1, 3]}", np.array([1.0, 2.0, 3.0]), True),
        ("{that: front.points, within: [1, 3]}", np.array([1.0, 3.1]), False),
        ("{that: front.points, within: [1, 3]}", np.array([1.0, np.nan]), False),
        ("{that: front.points, within: [1, 3]}", np.zeros(0), False),
        ("{that: front.points, at_most: 3}", np.nan, False),
        ("{that: front.points, equals: 2}", 2.0, True),
        ("{that: front.points, at_least: 2, at_most: 4}", 5.0, False),
        ("{that: front.points > 2}", np.array([3.0, 4.0]), True),
        ("{that: front.points > 2}", np.array([3.0, 1.0]), False),
        ("{that: front.points > 2}", np.zeros(0), False),
        ("{that: front.points}", 1.0, False),
    ],
)
def test_a_verdict_is_that_of_every_value(line: str, value: Value, held: bool) -> None:
    assert verdict(line, value) is held


def ask(watcher: SeriesWatcher, text: str) -> np.ndarray:
    instrument = Instrument("front", ScriptedSession(), [ListLink(LinkKind.SERIAL)], InPlace({}))
    expected = understand(scenario.loads(CASE % f"{{that: {text}, at_most: 9}}", Path("case.yaml")))[0]
    from emulator.config.expressions import evaluate

    find = lookup(watcher, {"front": instrument}, ("world", "car"), 0, 10**10, 10**10)
    return np.asarray(evaluate(expected.tree, find))


def test_series_tell_what_was_measured_and_what_the_host_made_of_it() -> None:
    watcher = SeriesWatcher(["front"])
    azimuth = np.radians([10.0, 0.0, -10.0])
    for sweep, at_ns in ((4, 0), (5, 40_000_000)):
        plan = ScanPlan(0, sweep, at_ns, azimuth, np.zeros(3), np.zeros(3))
        measured = np.array([[5.0], [6.0], [np.nan]])
        actor = np.array([[0], [1], [-1]], np.int32)
        watcher.scan("front", Scan(plan, measured, np.ones((3, 1)), np.zeros(3, np.uint8), actor))
        start_ns = at_ns + 13_000_000
        watcher.payload(Payload("front", 0, 0, b"scan", start_ns, start_ns, True, sweep=sweep))
    ahead_last = azimuth[::-1]
    watcher.host_read("front", 20_000_000, HostScan(0, ahead_last, np.array([np.nan, 6.0, 5.0])))
    watcher.host_read("front", 60_000_000, HostScan(1, ahead_last, np.array([np.nan, 6.25, 5.0])))
    assert ask(watcher, "front.range_error_m") == pytest.approx([0.0, 0.25])
    assert ask(watcher, "front.range_at(0)") == pytest.approx([6.0, 6.25])
    assert np.isnan(ask(watcher, "front.range_at(40)")).all()
    assert ask(watcher, "front.points").tolist() == [2, 2]
    assert ask(watcher, "front.points_on(car)").tolist() == [1, 1]
    assert ask(watcher, "front.nearest_on(car)") == pytest.approx([6.0, 6.0])
    assert ask(watcher, "front.nearest_m") == pytest.approx([5.0, 5.0])
    assert ask(watcher, "front.gap_s") == pytest.approx([0.04])
    assert ask(watcher, "front.scans_per_s") == pytest.approx(25.0)
    assert ask(watcher, "front.first_scan_s") == pytest.approx(0.013)
    assert ask(watcher, "front.bytes_out") == 8


def test_scans_of_before_a_power_cut_stay_when_the_device_counts_its_sweeps_anew() -> None:
    watcher = SeriesWatcher(["front"])
    for at_ns, range_m in ((0, 5.0), (40_000_000, 5.0), (3_000_000_000, 7.0)):
        plan = ScanPlan(0, 0 if at_ns != 40_000_000 else 1, at_ns, np.zeros(1), np.zeros(1), np.zeros(1))
        one = np.ones((1, 1))
        watcher.scan("front", Scan(plan, range_m * one, one, np.zeros(1, np.uint8), np.zeros((1, 1), np.int32)))
        watcher.payload(Payload("front", 0, 0, b"scan", at_ns + 9, at_ns + 9, True, sweep=plan.sweep))
        watcher.host_read("front", at_ns + 10, HostScan(0, np.zeros(1), np.array([range_m])))
    assert ask(watcher, "front.nearest_m") == pytest.approx([5.0, 5.0, 7.0])
    assert ask(watcher, "front.scans_measured") == 3
    assert ask(watcher, "front.range_error_m") == pytest.approx([0.0, 0.0, 0.0])


def test_every_name_that_is_known_has_a_value_and_the_other_way_round() -> None:
    assert list(QUANTITIES) == list(VALUES)
    assert set(LIVE) <= set(QUANTITIES)
