"""Edges and panes of narrow beams in one pass, against the arrays that do the same, and what is left to these."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from emulator.compiled import switch
from emulator.sensing import probing, traced
from emulator.sensing.measure import Measure
from emulator.sensing.traced import DONE, LEFT, UNEVEN, Traced
from emulator.world import triangles
from emulator.world.motion import Steady
from emulator.world.scene import Body, Scene
from protocols.scan import ScanPlan
from tests.compiled.both import differing
from tests.sensing.error_budget.scenes import PUCK, body, measure_of, random_scene, random_weather
from tests.sensing.test_probing import WIDE, layers, of_bodies

pytest.importorskip("numba")

MATERIALS = "asphalt", "window_glass", "mirror", "retro_sheeting", "car_paint_silver", "sheeting_xi"
WALL, GLASS, MIRROR, RETRO, PAINT, SHEETING = range(6)
ACROSS = {"pitch_deg": 90.0}


@pytest.fixture(autouse=True)
def _loops() -> Iterator[None]:
    """All other steps by loops, from the scene's structures on."""
    with switch.switched(True):
        assert switch.kernels() is not None  # else arrays would be compared with themselves
        yield


@contextmanager
def by_pass(on: bool) -> Iterator[None]:
    """With the pass or with arrays."""
    pair = traced.traced.pair  # type: ignore[attr-defined]
    before, pair.on = pair.on, on
    try:
        yield
    finally:
        pair.on = before


@pytest.fixture
def verdicts(monkeypatch: pytest.MonkeyPatch) -> list[Traced]:
    """What the pass gave, of probes and of bundles."""
    found: list[Traced] = []
    step: Any = traced.traced

    def noted(*given: Any) -> Traced:
        made: Traced = step(*given)
        if step.pair.on:
            found.append(made)
        return made

    monkeypatch.setattr(probing, "traced", noted)
    return found


def compare(measure: Measure, plan: ScanPlan) -> None:
    """Every sub-echo, what the axes meet and what is reported are the same by either form."""
    with by_pass(False):
        scan, arrays = measure(plan), measure.view(plan)
    with by_pass(True):
        assert len(differing(scan, measure(plan))) == 0
        loops = measure.view(plan)
    one, other = arrays.echoes, loops.echoes
    np.testing.assert_array_equal(one.beam, other.beam)
    np.testing.assert_allclose(one.range_m, other.range_m, rtol=1e-9, atol=1e-9)
    for name in ("amplitude", "blocked"):  # two at one range may come in either order: by what lies around it
        sums = [np.add.reduceat(getattr(part, name), _cells(part)) for part in (one, other)]
        np.testing.assert_allclose(*sums, rtol=1e-7, atol=1e-9)
    np.testing.assert_array_equal(np.sort(one.source), np.sort(other.source))
    assert arrays.plain is not None
    np.testing.assert_array_equal(arrays.plain, loops.plain)
    np.testing.assert_allclose(arrays.seen.nearest_m, loops.seen.nearest_m, rtol=1e-9)
    np.testing.assert_array_equal(arrays.seen.axis_material, loops.seen.axis_material)
    np.testing.assert_allclose(arrays.seen.axis_normal, loops.seen.axis_normal, atol=1e-9)
    assert arrays.cast == loops.cast


def _cells(echoes: Any) -> Any:
    new = (echoes.beam[1:] != echoes.beam[:-1]) | (echoes.range_m[1:] - echoes.range_m[:-1] > 1e-6)
    return np.flatnonzero(np.concatenate([[True], new]))


def count(found: list[Traced], verdict: int) -> int:
    return sum(int(np.count_nonzero(one.verdict == verdict)) for one in found)


@pytest.mark.parametrize("model", [PUCK, WIDE])
@pytest.mark.parametrize("seed", range(10))
def test_random_scenes_are_the_same_by_either_form(seed: int, model: str, verdicts: list[Traced]) -> None:
    plan = layers()
    measure = measure_of(random_scene(seed), model, random_weather(seed), noise=False)
    compare(measure, plan if model == PUCK else replace(plan, sweep=3))
    if verdicts:  # else the sensor is not among what rests
        assert count(verdicts, DONE) > 0


def street(*more: Body, windows: tuple[float, float] = (0.0, 20.0)) -> Scene:
    """A wall behind panes, one of them leaning, a pole between, a mirror aside; `windows`: how they are turned."""
    sheet, room = triangles.plane(14.0, 9.0), triangles.box(0.3, 40.0, 30.0)
    bodies = [
        body(0, room, WALL, Steady(at_m=(25.0, 0.0, -15.0))),
        body(0, sheet, GLASS, Steady(at_m=(9.0, -4.6, 0.0), yaw_deg=windows[0], **ACROSS)),
        body(0, sheet, GLASS, Steady(at_m=(9.5, 4.6, 0.0), yaw_deg=windows[1], **ACROSS)),
        body(0, triangles.box(0.05, 0.05, 20.0), PAINT, Steady(at_m=(14.0, -2.0, -10.0))),
        body(0, triangles.box(0.02, 0.4, 20.0), PAINT, Steady(at_m=(16.0, 5.0, -10.0))),
        body(0, sheet, MIRROR, Steady(at_m=(5.0, 7.0, 0.0), yaw_deg=50.0, **ACROSS)),
        body(0, triangles.plane(200.0, 200.0), WALL, Steady(at_m=(0.0, 0.0, -1.8))),
    ]
    return of_bodies(*bodies, *more, materials=MATERIALS)


@pytest.mark.parametrize("options", [
    {}, {"bounces": 0}, {"bounces": 1}, {"leave_out": {"second_rays": False, "clear_air": False}},
], ids=str)  # fmt: skip
def test_what_is_seen_through_panes_and_in_mirrors_is_the_same(options: Any, verdicts: list[Traced]) -> None:
    plan = layers(1280)
    compare(measure_of(street(), PUCK, noise=False, **options), replace(plan, gain=0.5))
    assert count(verdicts, DONE) > (50 if options.get("bounces") == 0 else 200)
    assert count(verdicts, LEFT) < 0.1 * count(verdicts, DONE)
    if options.get("bounces") != 0:
        probes = [one for one in verdicts if (one.verdict == UNEVEN).any()]
        assert probes
        assert (probes[0].verdict == DONE).any()  # through some panes the wall is all that is seen


@pytest.mark.parametrize("gain", [1e-3, 2e-4, 4e-5])
def test_the_same_rays_are_too_faint_to_be_followed(gain: float, verdicts: list[Traced]) -> None:
    compare(measure_of(street(), PUCK, noise=False), replace(layers(1280), gain=gain))
    assert count(verdicts, DONE) > 100


@pytest.mark.parametrize("sub_beams", [61, 301])
def test_sub_echoes_of_a_beam_come_by_range_whether_they_are_counted_or_sorted(
    sub_beams: int, verdicts: list[Traced]
) -> None:
    compare(measure_of(street(), PUCK, noise=False, sub_beams=sub_beams, bounces=1), layers(1280))
    from emulator.compiled.tracing import MOST_COUNTED

    found = verdicts[-1].found  # of bundles, which come last
    counts = np.bincount(found.beam)
    assert counts.max() > 100
    assert (counts.max() > MOST_COUNTED) == (sub_beams > MOST_COUNTED)
    assert bool((np.diff(found.beam) >= 0).all())
    assert bool((np.diff(found.range_m)[np.diff(found.beam) == 0] >= -1e-6).all())


def test_panes_that_face_the_sensor_send_light_back_and_are_left(verdicts: list[Traced]) -> None:
    compare(measure_of(street(windows=(0.0, 0.0)), PUCK, noise=False), layers(1280, -5.0, 5.0))
    assert 0 < count(verdicts, LEFT) < 0.2 * count(verdicts, DONE)


def test_bodies_that_move_straight_are_met_in_the_pass(verdicts: list[Traced]) -> None:
    """Before the panes, behind them, and in the mirror alone."""
    car, van = triangles.box(4.0, 1.8, 1.5), triangles.box(5.0, 2.0, 2.2)
    cars = (
        body(0, car, PAINT, Steady(at_m=(6.0, -3.0, -1.7), velocity_m_s=(0.0, 25.0, 0.0))),
        body(0, car, PAINT, Steady(at_m=(18.0, 3.0, -1.7), yaw_deg=70.0, velocity_m_s=(3.0, -20.0, 0.0))),
        body(0, van, GLASS, Steady(at_m=(15.0, -6.0, -1.7), velocity_m_s=(-12.0, 0.0, 0.0))),
        body(0, van, WALL, Steady(at_m=(-6.0, 3.0, -1.7), velocity_m_s=(5.0, 0.0, 0.0))),
    )
    compare(measure_of(street(*cars), PUCK, noise=False), layers(1280))
    assert count(verdicts, LEFT) < 0.1 * count(verdicts, DONE)


def test_beams_that_a_turning_body_may_meet_are_left(verdicts: list[Traced]) -> None:
    """Before the panes, or through one of them."""
    shape, turning = triangles.box(0.1, 4.0, 2.0), 40.0
    gates = [body(0, shape, PAINT, Steady(at_m=at, yaw_rate_deg_s=turning)) for at in ((7, 2, -1), (15, 5, -1))]
    compare(measure_of(street(*gates), PUCK, noise=False), layers(1280))
    assert count(verdicts, DONE) > 100
    assert count(verdicts, LEFT) > 10


@pytest.mark.parametrize("kind", [SHEETING, RETRO])
def test_sheeting_is_the_same_by_either_form(kind: int) -> None:
    """That of a class has a law of its own, and is left."""
    sign = body(0, triangles.box(0.01, 0.8, 0.8), kind, Steady(at_m=(20.0, 1.0, 0.2)))
    compare(measure_of(street(sign), PUCK, noise=False), layers(1280))


def test_bodies_of_glass_that_bend_the_light_are_left(verdicts: list[Traced]) -> None:
    block = body(0, triangles.box(0.5, 6.0, 8.0), GLASS, Steady(at_m=(6.0, 0.0, -4.0)))
    measure = measure_of(of_bodies(street().bodies[0], block, materials=MATERIALS), PUCK, noise=False)
    solid = np.array([False, True])
    measure._dry, measure._wet = replace(measure._dry, solid=solid), replace(measure._wet, solid=solid)
    compare(measure, layers(1280))
    assert count(verdicts, LEFT) > 100


def test_inside_of_a_closed_shell_rays_are_not_taken_for_those_that_slipped(verdicts: list[Traced]) -> None:
    """Through a sheet of glass into a box, and from its inside on."""
    room = body(0, triangles.box(4.0, 3.0, 3.0), GLASS, Steady(at_m=(9.0, 0.0, -1.5), yaw_deg=10.0))
    box = body(0, triangles.box(1.0, 1.0, 1.0), PAINT, Steady(at_m=(9.0, 0.3, -1.0), yaw_deg=30.0))
    compare(measure_of(of_bodies(street().bodies[0], room, box, materials=MATERIALS), PUCK, noise=False), layers(1280))
    assert count(verdicts, LEFT) < 0.1 * count(verdicts, DONE)


def test_with_arrays_every_beam_is_left() -> None:
    with switch.switched(False):
        measure = measure_of(street(), PUCK, noise=False)
        plan = layers()
        beams = measure._probing._beams(plan, measure._pose(np.zeros(len(plan))), np.zeros(len(plan)))  # type: ignore[union-attr]
        bundle = traced.Bundle(measure._probing.nodes, np.zeros(2), judged=True)  # type: ignore[union-attr]
        air = measure.air.at(0.0)
        made = traced.traced(
            beams, np.array([3, 5]), bundle, None, 100.0, 100.0, np.ones(len(plan)), measure._dry, air,
            traced.Sensor(measure.model, 1e-3),
        )  # fmt: skip
    assert (made.verdict == LEFT).all()
    assert len(made.found) == 0
