"""Narrow beams in one compiled pass, against arrays: random scenes, what moves, insides, several structures."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from emulator.compiled import switch
from emulator.sensing import narrow
from emulator.sensing.measure import Measure
from emulator.sensing.narrow import LEFT, Settled
from emulator.sensing.probing import CLOSED
from emulator.sensing.view import View
from emulator.world import triangles
from emulator.world.motion import Steady
from protocols.scan import Scan, ScanPlan
from tests.compiled.both import differing
from tests.sensing.error_budget.scenes import PUCK, body, measure_of, random_scene, random_weather
from tests.sensing.test_probing import layers, of_bodies

pytest.importorskip("numba")


@contextmanager
def by_pass(on: bool) -> Iterator[None]:
    """With the pass or with arrays."""
    pair = narrow.settled.pair  # type: ignore[attr-defined]
    before, pair.on = pair.on, on
    try:
        yield
    finally:
        pair.on = before


@pytest.fixture(autouse=True)
def _loops() -> Iterator[None]:
    """All other steps by loops, from the scene's structures on."""
    with switch.switched(True):
        assert switch.kernels() is not None  # else arrays would be compared with themselves
        yield


def forms(measure: Measure, plan: ScanPlan) -> tuple[tuple[Scan, View], tuple[Scan, View]]:
    """A sweep by arrays and by the pass."""
    made = []
    for on in (False, True):
        with by_pass(on):
            made.append((measure(plan), measure.view(plan)))
    return made[0], made[1]


@pytest.fixture
def passed(monkeypatch: pytest.MonkeyPatch) -> list[Settled]:
    """What the pass gave in every sweep."""
    found: list[Settled] = []
    step: Any = narrow.settled

    def noted(*given: Any) -> Settled:
        made: Settled = step(*given)
        found.append(replace(made, kinds=made.kinds.copy()))  # what is left is filled in
        return made

    monkeypatch.setattr("emulator.sensing.probing.settled", noted)
    return found


@pytest.mark.parametrize("seed", range(12))
def test_random_scenes_are_the_same_by_either_form(seed: int, passed: list[Settled]) -> None:
    measure, plan = measure_of(random_scene(seed), PUCK, random_weather(seed)), layers()
    (arrays, before), (loops, after) = forms(measure, plan)
    assert len(differing(arrays, loops)) == 0
    assert before.plain is not None
    np.testing.assert_array_equal(before.plain, after.plain)
    np.testing.assert_array_equal(before.seen.axis_material, after.seen.axis_material)
    np.testing.assert_allclose(before.seen.axis_normal, after.seen.axis_normal, atol=1e-12)
    np.testing.assert_allclose(before.seen.nearest_m, after.seen.nearest_m, rtol=1e-9)
    # without the pass all beams are left; with it those are settled that are at rest in the scene's middle
    assert (passed[0].kinds == LEFT).all()
    assert np.count_nonzero(passed[-1].kinds != LEFT) > 0.3 * len(plan)


def wall() -> Any:
    """Ahead, as large as the view."""
    return body(0, triangles.box(0.1, 90.0, 90.0), 0, Steady(at_m=(20.0, 0.0, -45.0)))


def test_what_moves_before_a_wall_is_met_in_the_pass(passed: list[Settled]) -> None:
    """It crosses the view at 30 m/s, and another before it, which is aslant: no beam is left."""
    fast = {"velocity_m_s": (0.0, 30.0, 0.0)}
    car = body(0, triangles.box(4.0, 2.0, 1.5), 0, Steady(at_m=(10.0, -3.0, -0.7), **fast))
    van = body(0, triangles.box(2.0, 1.0, 1.0), 2, Steady(at_m=(7.0, 1.0, -0.2), yaw_deg=35.0, **fast))
    scene = of_bodies(wall(), car, van, materials=("asphalt", "retro_sheeting", "car_paint_silver"))
    (arrays, before), (loops, after) = forms(measure_of(scene, PUCK), layers())
    assert len(differing(arrays, loops)) == 0
    assert before.plain is not None
    np.testing.assert_array_equal(before.plain, after.plain)
    np.testing.assert_array_equal(before.seen.axis_material, after.seen.axis_material)
    np.testing.assert_allclose(before.seen.axis_normal, after.seen.axis_normal, atol=1e-12)
    np.testing.assert_allclose(before.seen.nearest_m, after.seen.nearest_m, rtol=1e-9)
    for far_m in (7.5, 12.0):
        near = (loops.range_m[:, 0] < far_m) & (loops.range_m[:, 0] > far_m - 4.0)
        assert np.count_nonzero(near & (passed[-1].kinds == CLOSED)) > 3
    assert not (passed[-1].kinds == LEFT).any()


def test_what_turns_is_left_to_arrays_where_a_beam_may_meet_it(passed: list[Settled]) -> None:
    gate = body(0, triangles.box(0.1, 4.0, 2.0), 0, Steady(at_m=(10.0, -3.0, -0.7), yaw_rate_deg_s=40.0))
    (arrays, _), (loops, _) = forms(measure_of(of_bodies(wall(), gate), PUCK), layers())
    assert len(differing(arrays, loops)) == 0
    near = loops.range_m[:, 0] < 12.0
    assert np.count_nonzero(near) > 3
    left = passed[-1].kinds == LEFT
    assert left[near].all()
    assert np.count_nonzero(left) < 0.5 * len(left)


def test_what_moves_behind_a_wall_leaves_no_beam(passed: list[Settled]) -> None:
    car = body(0, triangles.box(4.0, 2.0, 1.5), 0, Steady(at_m=(30.0, -3.0, -0.7), velocity_m_s=(0.0, 30.0, 0.0)))
    forms(measure_of(of_bodies(wall(), car), PUCK), layers())
    assert not (passed[-1].kinds == LEFT).any()


def test_a_bright_patch_between_the_probes_has_its_bundle_in_both_forms() -> None:
    patch = body(0, triangles.box(0.01, 0.004, 0.004), 1, Steady(at_m=(19.9, 0.018, 0.005)))
    measure = measure_of(of_bodies(wall(), patch), PUCK)
    (arrays, _), (loops, after) = forms(measure, layers(16, 0.0, 0.0, 0.0))
    assert after.plain is not None
    assert not after.plain.any()
    assert len(differing(arrays, loops)) == 0


def test_inside_of_a_shell_beams_are_left(passed: list[Settled]) -> None:
    """Whether a ray slipped between two triangles is found out with arrays."""
    room = body(0, triangles.box(30.0, 30.0, 30.0), 0, Steady(at_m=(0.0, 0.0, -15.0)))
    (arrays, _), (loops, _) = forms(measure_of(of_bodies(room), PUCK), layers())
    assert (passed[-1].kinds == LEFT).all()
    assert len(differing(arrays, loops)) == 0
    assert np.isfinite(loops.range_m[:, 0]).all()


def test_bodies_in_two_structures_are_left_to_arrays(passed: list[Settled]) -> None:
    far = body(0, triangles.box(0.1, 90.0, 90.0), 0, Steady(at_m=(3000.0, 0.0, -45.0)))
    (arrays, _), (loops, _) = forms(measure_of(of_bodies(wall(), far), PUCK), layers())
    assert (passed[-1].kinds == LEFT).all()
    np.testing.assert_array_equal(arrays.range_m, loops.range_m)


def test_nine_rays_a_settled_beam_and_no_more() -> None:
    measure, plan = measure_of(of_bodies(wall()), PUCK), layers(160, -10.0, 10.0, 20.0)
    counters = measure._caster.bare.counters  # type: ignore[attr-defined]
    before = counters.rays
    measure(plan)
    assert counters.rays - before == 9 * 160
