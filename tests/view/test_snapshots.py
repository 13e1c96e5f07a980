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
