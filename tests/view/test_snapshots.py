"""What the daemon shows to who asks: latest scans, last telegrams, links, the scenario; and nothing for nobody."""

from __future__ import annotations

import json
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from emulator.process.clock import ManualClock
from emulator.runtime.control import MOST_UNREAD, Later, OrderError
from emulator.runtime.snapshots import KEEP_S, MOST_PAYLOADS, MOST_POINTS, PIECE, Snapshots
from emulator.scenario import scenario
from emulator.view.live import scan_of, telegram_of
from protocols.scan import DetectedObject, Scan, ScanPlan
from protocols.session import LinkKind
from tests.instrument.test_instrument import Rig


class Shown:
    """A scripted sensor with the methods that show it, in real time's manner."""

    def __init__(self, *kinds: LinkKind) -> None:
        self.rig = Rig(*(kinds or (LinkKind.STREAM,)))
        self.clock = ManualClock()
        self.scenario = scenario.load("crossing_car")
        daemon: Any = SimpleNamespace()
        self.snapshots = Snapshots(daemon, [self.rig.instrument], self.clock, self.scenario)
        self.methods = self.snapshots.methods()

    def __call__(self, method: str, **params: object) -> Any:
        found = self.methods[method](params)
        return json.loads(json.dumps(found.make() if isinstance(found, Later) else found))

    @property
    def watched(self) -> bool:
        return self.snapshots._keeper in self.rig.instrument.observers  # a virtual run has a watcher of its own

    def run(self, until_ns: int) -> None:
        self.rig.run.advance(until_ns)
        self.clock.set(until_ns)


def test_nothing_is_watched_before_somebody_asks_and_after_the_last_time() -> None:
    shown = Shown()
    shown.rig.hear(b"G")
    shown("glance")
    shown("scene")
    assert not shown.watched
    assert shown("scans") == {"now_s": 0.0, "keeper": 1, "scans": {}}
    assert shown.watched
    shown.run(round(KEEP_S * 1e9) - 1)
    assert shown.watched
    shown.run(round(KEEP_S * 1e9) + 100_000_000)
    shown.run(round(KEEP_S * 1e9) + 200_000_000)
    assert not shown.watched
    assert shown("scans")["keeper"] == 2


def test_the_latest_scan_comes_once_and_says_how_many_went_by() -> None:
    shown = Shown()
    shown("scans")
    shown.rig.hear(b"G")
    shown.run(1_000_000)
    first = shown("scans")["scans"]["front"]
    assert first["missed"] == 0
    assert shown("scans", since={"front": first["number"]})["scans"] == {}
    shown.run(400_000_000)
    later = shown("scans", since={"front": first["number"]})["scans"]["front"]
    assert later["missed"] == later["number"] - first["number"] - 1 > 0
    assert later["sweep"] == max(shown.rig.plans)


def test_payloads_are_numbered_and_bounded() -> None:
    shown = Shown()
    shown("telegrams")
    for place in range(100):
        shown.rig.hear(bytes([100 + place]))
        shown.run(1_000_000 * (place + 1))
    found = shown("telegrams", count=MOST_PAYLOADS)["telegrams"]["front"]
    assert found["number"] == 200  # heard and echoed
    assert [row["number"] for row in found["payloads"]] == list(range(201 - MOST_PAYLOADS, 201))
    last = telegram_of(found["payloads"][-1])
    assert (last.data, last.sent, last.label, last.at_s) == (b"\xc7", True, "echo", pytest.approx(0.099))
    assert [row["number"] for row in shown("telegrams", since={"front": 197})["telegrams"]["front"]["payloads"]] == [
        198,
        199,
        200,
    ]


def long_scan(n: int, k: int, begins: bool = False) -> Scan:
    draws = np.random.default_rng(3)
    plan = ScanPlan(0, 7, 5_000_000, *(draws.normal(size=n) for _ in range(3)))
    plan = replace(plan, origin_m=draws.normal(size=(n, 3)) if begins else None)
    shape = (n, k)
    objects = tuple(
        DetectedObject(one, (1.0, 2.0, 3.0), (0.0, 0.0, 0.0), (4.0, 2.0, 1.0), 0.5, "car", actor="car")
        for one in range(400)
    )
    intensity, actor = draws.uniform(1, 9, shape), draws.integers(-1, 300, shape).astype(np.int32)
    return Scan(plan, draws.uniform(1, 99, shape), intensity, np.zeros(n, np.uint8), actor, objects)


@pytest.mark.parametrize(("n", "k", "every"), [(1, 1, 1), (361, 1, 1), (2880, 2, 1), (2880, 3, 2), (30_000, 5, 25)])
def test_a_scan_arrives_whole_or_says_how_it_was_thinned_out(n: int, k: int, every: int) -> None:
    shown, made = Shown(), long_scan(n, k)
    shown("scans")
    shown.snapshots._keeper.scan("front", made)  # type: ignore[union-attr]
    answer = shown("scans")
    assert len(json.dumps({"jsonrpc": "2.0", "id": 1, "result": answer})) < MOST_UNREAD
    found = scan_of(answer["scans"]["front"])
    assert found.every == every
    assert found.range_m.size <= MOST_POINTS
    np.testing.assert_array_equal(found.range_m, made.range_m[::every].astype(np.float32))
    np.testing.assert_array_equal(found.azimuth_rad, made.plan.azimuth_rad[::every].astype(np.float32))
    np.testing.assert_array_equal(found.actor, made.actor[::every])
    assert found.objects[0]["size_m"] == [4.0, 2.0, 1.0]


LASERS, SLICES, SLICE_NS = 16, 20, 5_000_000


def cut(number: int, firings: int = 8, echoes: int = 1) -> Scan:
    """A slice of a turn of `SLICES`: each firing 16 lasers; the range tells the number."""
    n = LASERS * firings
    azimuth = np.full(n, 2.0 * np.pi * (number % SLICES) / SLICES)
    elevation = np.tile(np.radians(np.arange(-15.0, 17.0, 2.0)), firings)
    start_ns, fire_s = number * SLICE_NS, np.linspace(0.0, 0.004, n)
    plan = ScanPlan(number, number, start_ns, azimuth, elevation, fire_s, turn=number // SLICES)
    scan = Scan.empty(plan, echoes)
    scan.range_m[:, 0] = 1.0 + number
    return scan


def feed(shown: Shown, numbers: range, **how: int) -> None:
    for number in numbers:
        shown.snapshots._keeper.scan("front", cut(number, **how))  # type: ignore[union-attr]


def test_slices_are_shown_as_the_turn_that_ends_with_the_newest() -> None:
    shown = Shown()
    shown("scans")
    feed(shown, range(7))
    row = shown("scans")["scans"]["front"]
    assert (row["beams"], row["sweep"], row["missed"]) == (7 * 128, 6, 0)  # of the first turn what there is
    feed(shown, range(7, 53))
    later = shown("scans", since={"front": row["number"]})["scans"]["front"]
    found = scan_of(later)
    assert (later["beams"], later["missed"], later["sweep"]) == (SLICES * 128, 53 - 7 - SLICES, 52)
    assert found.start_s == pytest.approx(33 * 0.005)
    assert sorted(set(found.range_m[:, 0])) == [1.0 + number for number in range(33, 53)]
    assert found.fire_s[-1] == pytest.approx(19 * 0.005 + 0.004, abs=1e-6)
    assert (np.diff(found.fire_s) >= 0.0).all()
    feed(shown, range(53, 56))
    assert shown("scans", since={"front": later["number"]})["scans"]["front"]["missed"] == 0
    feed(shown, range(2))  # another life
    assert shown("scans")["scans"]["front"]["beams"] == 2 * 128


def test_a_turn_of_many_beams_is_thinned_out_over_all_its_lasers() -> None:
    shown = Shown()
    shown("scans")
    feed(shown, range(2), firings=4)
    feed(shown, range(2, 30), firings=400, echoes=3)
    shown.snapshots._keeper.of["front"].parts[4].range_m[0::17, 1] = 90.0  # type: ignore[union-attr]
    answer = shown("scans")
    assert len(json.dumps(answer)) < MOST_UNREAD
    found = scan_of(answer["scans"]["front"])
    assert found.range_m.shape[1] == 2  # of the third nothing came
    assert MOST_POINTS * 0.6 < len(found.range_m) < MOST_POINTS * 0.7
    assert set(found.range_m[:, 1][np.isfinite(found.range_m[:, 1])]) == {90.0}
    lasers, counts = np.unique(np.round(np.degrees(found.elevation_rad)), return_counts=True)
    assert (len(lasers), counts.max() - counts.min() <= 1) == (LASERS, True)
    assert len(np.unique(found.range_m[:, 0])) == SLICES


def test_where_beams_of_slices_begin_arrives_with_them() -> None:
    shown = Shown()
    shown("scans")
    made = [cut(number, firings=100) for number in range(12)]
    for one in made:
        origin_m = np.repeat([[one.plan.sweep, 0.028, 0.0]], len(one.plan), axis=0)
        shown.snapshots._keeper.scan("front", replace(one, plan=replace(one.plan, origin_m=origin_m)))  # type: ignore[union-attr]
    answer = shown("scans")
    assert len(json.dumps(answer)) < MOST_UNREAD
    found = scan_of(answer["scans"]["front"])
    assert found.origin_m is not None
    np.testing.assert_array_equal(found.origin_m[:, 0], found.range_m[:, 0] - 1.0)


def test_a_sensor_that_does_not_come_round_keeps_a_limited_number_of_beams(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("emulator.runtime.snapshots.MOST_BEAMS", 300)
    shown = Shown()
    shown("scans")
    feed(shown, range(10))
    assert shown("scans")["scans"]["front"]["beams"] == 256
    feed(shown, range(10, 11), firings=40)
    assert shown("scans")["scans"]["front"]["beams"] == 640  # one is shown


@pytest.mark.parametrize(("n", "every"), [(1, 1), (3000, 1), (30_000, 10)])
def test_where_beams_begin_arrives_with_them(n: int, every: int) -> None:
    shown, made = Shown(), long_scan(n, 1, begins=True)
    shown("scans")
    shown.snapshots._keeper.scan("front", made)  # type: ignore[union-attr]
    answer = shown("scans")
    assert len(json.dumps({"jsonrpc": "2.0", "id": 1, "result": answer})) < MOST_UNREAD
    found = scan_of(answer["scans"]["front"])
    assert found.every == every
    assert made.plan.origin_m is not None
    np.testing.assert_array_equal(found.origin_m, made.plan.origin_m[::every].astype(np.float32))
    assert scan_of({**answer["scans"]["front"], "origin_m": None}).origin_m is None, "a daemon from before has none"


def test_the_scenario_comes_in_pieces_that_are_the_whole() -> None:
    shown = Shown()
    whole = scenario.dump(shown.scenario)
    shown.snapshots._text = whole + "#" * (2 * PIECE)
    parts, at = [], 0
    while at is not None:
        piece = shown("scene", at=at)
        parts.append(piece["yaml"])
        at = piece["next"]
    assert len(parts) >= 3
    assert "".join(parts) == whole + "#" * (2 * PIECE)


@pytest.mark.parametrize(
    ("method", "params"),
    [
        ("glance", {"x": 1}),
        ("scans", {"sensor": "none"}),
        ("scans", {"since": 3}),
        ("scans", {"since": {"front": "a"}}),
        ("telegrams", {"count": 0}),
        ("telegrams", {"count": 1.5}),
        ("scene", {"at": -1}),
        ("scene", {"at": True}),
    ],
)
def test_what_is_asked_wrongly_is_refused(method: str, params: dict[str, object]) -> None:
    with pytest.raises(OrderError, match="want"):
        Shown()(method, **params)


def test_a_glance_tells_links_and_counts() -> None:
    shown = Shown()
    shown.rig.hear(b"G")
    shown.run(1_000_000_000)
    found = shown("glance")
    assert found["clock"] == "real"
    assert found["sensors"]["front"]["scans_sent"] > 10
    assert found["sensors"]["front"]["scans_per_s"] == pytest.approx(25.0)
    assert found["sensors"]["front"]["links"][0]["url"] == "list:"
