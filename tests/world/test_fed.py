"""What a feed moves is met where the same thing of a scenario's own file is met."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from emulator.live.book import Book
from emulator.live.json_lines import update_of
from emulator.live.tracks import NOTHING, World
from emulator.measuring.conditions import Conditions
from emulator.runtime.assembly import build_measures
from emulator.scenario.scenario import Scenario, loads
from protocols.scan import ScanPlan

WORLD = """
schema: 1
world:
  - {plane: {size_m: [300, 300]}, material: asphalt}
  - {box: {size_m: [1, 60, 3]}, at_m: [40, 0, 0], material: asphalt}
sensors:
  - {id: front, model: sick-lms291-s05, mode: seed, mount: {actor: ego, at_m: [0, 0, 0.6]}}
"""
BEAMS = 361


def scene(actors: str, live: str = "", sensor: str = "") -> Scenario:
    return loads(WORLD.replace("mode: seed,", sensor) + f"actors: [{{id: ego}}, {actors}]\n" + live, Path("x.yaml"))


def plan(at_s: float, sweep_s: float = 0.0133) -> ScanPlan:
    nothing, fire = np.zeros(BEAMS), np.linspace(0.0, sweep_s, BEAMS)
    return ScanPlan(0, 7, round(at_s * 1e9), np.radians(np.linspace(-90, 90, BEAMS)), nothing, fire, sweep_s)


def ranges(scenario: Scenario, at_s: float, world: World = NOTHING) -> np.ndarray:
    found = build_measures(scenario)["front"](plan(at_s), Conditions(world=world))
    return np.asarray(found.range_m).reshape(BEAMS, -1)[:, 0]


def reported(times: list[float], make: object, names: tuple[str, ...] = ("ego", "car"), spawns: bool = False) -> Book:
    slots = ("live_000", "live_001") if spawns else ()
    book = Book(names=names, slots=slots)
    for t in times:
        book.take(update_of({"actors": make(t)}), round(t * 1e9))  # type: ignore[operator]
    return book


CAR = "{id: car, shape: {box: {size_m: [4.5, 1.8, 1.5]}}, material: asphalt, motion: MOTION}"


@pytest.mark.parametrize("rule", ["", "physics: {rule: axis}, "])
def test_beams_use_the_pose_at_their_own_instant(rule: str) -> None:
    """A car of the file at 30 m/s, and the same one fed at 20 Hz, are the same ranges, beam by beam."""
    own = scene(CAR.replace("MOTION", "{at_m: [8, -6, 0], velocity_m_s: [0, 30, 0], yaw_deg: 20}"), "", rule)
    fed = scene(CAR.replace("MOTION", "{at_m: [99, 0, 0]}"), "live: {feed: control}\n", rule)
    book = reported(
        [0.0, 0.05, 0.1, 0.15, 0.2, 0.25],
        lambda t: [
            {"id": "car", "at_m": [8, -6 + 30 * t, 0.75], "yaw_deg": 20, "velocity_m_s": [0, 30, 0]},
        ],
    )
    for at_s in (0.03, 0.1, 0.19):
        want = ranges(own, at_s)
        got = ranges(fed, at_s, book.world(at_s - 0.005, at_s + 0.02))
        assert (want < 12).sum() > 20
        assert got == pytest.approx(want, abs=1e-6, nan_ok=True)


def test_a_sensor_on_a_fed_ego_moves_while_it_sweeps() -> None:
    own = loads(
        WORLD.replace("mode: seed,", "") + "actors: [{id: ego, motion: {velocity_m_s: [20, 0, 0]}}]\n", Path("x")
    )
    fed = loads(WORLD.replace("mode: seed,", "") + "actors: [{id: ego}]\nlive: {feed: control}\n", Path("x"))
    book = reported(
        [0.0, 0.1, 0.2],
        lambda t: [{"id": "ego", "at_m": [20 * t, 0, 0], "velocity_m_s": [20, 0, 0], "reference": "origin"}],
    )
    assert ranges(fed, 0.1, book.world(0.095, 0.12)) == pytest.approx(ranges(own, 0.1), abs=1e-6, nan_ok=True)


@pytest.mark.parametrize("size", [(4.5, 1.8, 1.5), (0.5, 0.6, 1.8), (12.0, 2.5, 3.0)])
def test_what_comes_is_a_box_of_its_size(size: tuple[float, float, float]) -> None:
    shape = CAR.replace("[4.5, 1.8, 1.5]", str(list(size)))
    own = scene(shape.replace("MOTION", "{at_m: [12, 1, 0], yaw_deg: 35}"))
    fed = scene("{id: other}", "live: {feed: control, actors: {spawn: true, pool: 2, material: asphalt}}\n")
    book = reported(
        [0.0, 0.1],
        lambda t: [{"id": "77", "at_m": [12, 1, size[2] / 2], "yaw_deg": 35, "size_m": list(size), "class": "van"}],
        spawns=True,
    )
    want, got = ranges(own, 0.05), ranges(fed, 0.05, book.world(0.04, 0.08))
    assert got == pytest.approx(want, abs=1e-5, nan_ok=True)
    assert (want < 35).sum() > 2


def test_what_is_gone_is_not_there_and_what_is_not_fed_keeps_its_own_motion() -> None:
    own = CAR.replace("MOTION", "{at_m: [8, 0, 0]}")
    fed = scene(own, "live: {feed: control}\n")
    assert ranges(fed, 0.5)[180] == pytest.approx(5.75, abs=0.1)
    book = Book(names=("ego", "car"))
    book.take(update_of({"actors": [{"id": "car", "at_m": [20, 0, 0.75]}]}), 100_000_000)
    book.take(update_of({"actors": [], "snapshot": True}), 300_000_000)
    assert ranges(fed, 0.05, book.world(0.04, 0.08))[180] == pytest.approx(5.75, abs=0.1), "before its first pose"
    assert ranges(fed, 0.2, book.world(0.19, 0.23))[180] == pytest.approx(17.75, abs=0.1)
    assert ranges(fed, 0.5, book.world(0.49, 0.53))[180] == pytest.approx(39.5, abs=0.1), "the wall"


def test_osi_mounts_stand_on_the_rear_axle() -> None:
    """The specification's worked message: a sensor at (0, 0, 0) of object 1 stands at (-1.4, 0, 0.4)."""
    from emulator.live.samples import ActorSample, Update
    from emulator.world import scene as scenes

    built = scenes.build(scene("{id: other}", "live: {feed: control, ego: ego}\n"))
    book = Book(names=("ego",), bind={"host": "ego"})
    sample = ActorSample("1", (0.0, 0.0, 0.75), size_m=(4.5, 1.8, 1.5), rear_m=(-1.4, 0.0, -0.35))
    book.take(Update(None, (sample,), host="1"), 0)
    assert built.fed is not None
    built.fed.use(book.world(0.0, 0.1))
    assert built.pose(1, np.array([0.05])).position_m[0] == pytest.approx([-1.4, 0.0, 0.4])
