"""Narrow beams: probes where a beam sees one smooth surface, its bundle elsewhere, against the full computation."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from emulator.physics import beams
from emulator.sensing import probing
from emulator.sensing.measure import Measure
from emulator.sensors.physics_options import LeaveOut
from emulator.world import triangles
from emulator.world.motion import Steady
from emulator.world.scene import Scene
from protocols.scan import ScanPlan
from tests.compiled.both import both, differing
from tests.sensing.error_budget.scenes import PUCK, body, measure_of, random_scene, random_weather

STRONG, WIDE = "velodyne-vls-128", "ouster-os1-128"
ONLY = LeaveOut.nothing().model_copy(update={"narrow_beams": True})


def layers(beams_: int = 320, low_deg: float = -15.0, high_deg: float = 15.0, half_deg: float = 55.0) -> ScanPlan:
    """Sixteen layers of what lies ahead."""
    each = beams_ // 16
    azimuth = np.radians(np.tile(np.linspace(-half_deg, half_deg, each), 16))
    elevation = np.radians(np.repeat(np.linspace(low_deg, high_deg, 16), each))
    fired = np.linspace(0.0, 0.02, len(azimuth))
    return ScanPlan(0, 0, 0, azimuth, elevation, fired, 0.02, max_range_m=131.0, max_echoes=4, wants_intensity=True)


def pair(scene: Scene, model: str = PUCK, weather: Any = None, **options: Any) -> tuple[Measure, Measure]:
    """With this rule alone, and in full."""
    given = {"noise": False, "weather_echoes": False, **options}
    return measure_of(scene, model, weather, leave_out=ONLY, **given), in_full(scene, model, weather, **given)


def in_full(scene: Scene, model: str, weather: Any = None, **options: Any) -> Measure:
    """Every beam with its bundle."""
    return measure_of(scene, model, weather, **{"noise": False, "weather_echoes": False, "full": True, **options})


def of_bodies(*bodies: Any, materials: tuple[str, ...] = ("asphalt", "retro_sheeting")) -> Scene:
    return Scene(("world",), ("unknown",), (Steady(),), materials, bodies)


@pytest.mark.parametrize("probes", [4, 8, 10, 12, 16, 24])
def test_shares_of_probes_give_the_moments_of_the_disc(probes: int) -> None:
    nodes = probing.probe_nodes(probes)
    assert math.fsum(nodes.share) == pytest.approx(1.0, rel=1e-14)
    assert nodes.share.min() > 0.0
    for value in (nodes.u, nodes.v, nodes.u * nodes.v, nodes.u**3):
        assert math.fsum(nodes.share * value) == pytest.approx(0.0, abs=1e-15)
    assert math.fsum(nodes.share * nodes.u**2) == pytest.approx(0.25, rel=1e-12)  # of a disc of radius 1
    if probes > probing.ONE_RING:
        assert math.fsum(nodes.share * (nodes.u**2 + nodes.v**2) ** 2) == pytest.approx(1.0 / 3.0, rel=1e-12)


def test_what_may_slip_between_probes_is_the_segment_beside_the_ring() -> None:
    for probes in (4, 8):
        half = math.pi / probes
        edge, strip = probing.most_missed(probes)
        assert edge == pytest.approx((half - math.sin(half) * math.cos(half)) / math.pi, abs=1e-9)
        assert edge <= probing.MOST_BEHIND
        assert edge < strip <= 0.5


@pytest.mark.parametrize("model", [PUCK, STRONG, WIDE])
@pytest.mark.parametrize("seed", range(6))
def test_random_scenes_are_measured_as_in_full(seed: int, model: str) -> None:
    """Echoes as many; where one surface is seen, ranges within a step and strengths within 0.2 % of 3001 rays."""
    rays_saved, whole = pair(random_scene(seed), model, random_weather(seed))
    dense = in_full(random_scene(seed), model, random_weather(seed), sub_beams=3001)
    plan = layers()
    one, other, plain = rays_saved(plan), whole(replace(plan)), rays_saved.view(plan).plain
    assert plain is not None
    assert np.count_nonzero(plain) > 0.1 * len(plan)
    np.testing.assert_array_equal(np.isnan(one.range_m), np.isnan(other.range_m))
    np.testing.assert_allclose(one.range_m[~plain], other.range_m[~plain], rtol=1e-10)
    exact = dense(replace(plan))
    seen = plain & np.isfinite(one.range_m[:, 0])
    np.testing.assert_allclose(one.range_m[seen, 0], exact.range_m[seen, 0], atol=rays_saved.model.lsb_m, rtol=0.0)
    np.testing.assert_allclose(one.intensity[seen, 0], exact.intensity[seen, 0], rtol=2e-3)


def test_bundles_are_the_same() -> None:
    rays_saved, whole = pair(random_scene(1))
    plan = layers()
    left = ~rays_saved.view(plan).plain  # type: ignore[operator]
    one, other = rays_saved(plan).range_m[left], whole(replace(plan)).range_m[left]
    np.testing.assert_allclose(one, other, rtol=1e-12)  # light may be summed in another order


def test_a_small_reflector_between_the_probes_is_seen() -> None:
    """It has a hundredth of the footprint, between the axis and the rim."""
    wall = body(0, triangles.box(0.1, 60.0, 60.0), 0, Steady(at_m=(20.0, 0.0, -30.0)))
    patch = body(0, triangles.box(0.01, 0.004, 0.004), 1, Steady(at_m=(19.9, 0.018, 0.005)))
    rays_saved, whole = pair(of_bodies(wall, patch))
    plan = layers(16, 0.0, 0.0, 0.0)
    assert not rays_saved.view(plan).plain.any()  # type: ignore[union-attr]
    np.testing.assert_allclose(rays_saved(plan).range_m, whole(replace(plan)).range_m, rtol=1e-12)


def through_a_pane(*more: Any) -> tuple[Measure, Measure]:
    """A pane before a wall, with the rule, and 1001 rays."""
    pane = body(0, triangles.box(0.004, 40.0, 40.0), 1, Steady(at_m=(10.0, 0.0, -20.0), yaw_deg=20.0))
    wall = body(0, triangles.box(0.1, 900.0, 90.0), 0, Steady(at_m=(20.0, 0.0, -45.0)))
    scene = of_bodies(pane, wall, *more, materials=("asphalt", "window_glass"))
    return pair(scene)[0], in_full(scene, PUCK, sub_beams=1001)


def test_a_wall_behind_a_pane_needs_no_bundle() -> None:
    rays_saved, dense = through_a_pane()
    plan = layers(320, -8.0, 8.0, 8.0)
    view, one, other = rays_saved.view(plan), rays_saved(plan), dense(replace(plan))
    assert view.plain is not None
    assert view.plain.all()
    np.testing.assert_array_equal(np.isnan(one.range_m), np.isnan(other.range_m))
    assert np.isfinite(one.range_m).any(axis=1).all()
    np.testing.assert_allclose(one.range_m, other.range_m, atol=0.5 * rays_saved.model.lsb_m)
    np.testing.assert_allclose(one.intensity, other.intensity, rtol=2e-3)


def test_an_edge_behind_a_pane_has_its_bundle() -> None:
    post = body(0, triangles.box(0.02, 0.222, 60.0), 0, Steady(at_m=(15.0, 0.0, -30.0)))
    rays_saved, _ = through_a_pane(post)
    view = rays_saved.view(layers(320, -8.0, 8.0, 8.0))
    assert view.plain is not None
    assert 0 < np.count_nonzero(~view.plain) < 160


def test_few_panes_have_their_bundles_at_once() -> None:
    rays_saved, _ = through_a_pane()
    view = rays_saved.view(layers(32, -2.0, 2.0, 2.0))
    assert view.plain is not None
    assert not view.plain.any()


def test_other_sensors_and_full_have_no_probes() -> None:
    scene = random_scene(2)
    assert measure_of(scene, PUCK)._probing is not None
    assert measure_of(scene, PUCK, full=True)._probing is None
    assert measure_of(scene, PUCK, probes=0)._probing is None
    assert measure_of(scene, PUCK, rule="axis")._probing is None
    assert measure_of(scene, "sick-lms291-s05")._probing is None


def test_a_beam_costs_nine_rays_where_it_sees_one_plane() -> None:
    wall = body(0, triangles.box(0.1, 90.0, 90.0), 0, Steady(at_m=(20.0, 0.0, -45.0)))
    view = measure_of(of_bodies(wall), PUCK).view(layers(160, -10.0, 10.0, 20.0))
    assert view.cast == 9 * 160


@pytest.mark.parametrize("seed", range(4))
def test_arrays_and_loops_agree(seed: int) -> None:
    pytest.importorskip("numba")
    scene, weather, plan = random_scene(seed), random_weather(seed), layers()
    arrays, loops = both(lambda: measure_of(scene, PUCK, weather)(plan))
    assert len(differing(arrays, loops)) == 0


def test_spread_gives_the_vectors_of_its_formula() -> None:
    """Each coordinate in one long row, whatever the order of the work."""
    shape = beams.BeamShape(1.5e-3, 0.75e-3, "tophat", 0.3, 5e-3)
    nodes, azimuth = beams.bundle("spiral", 7, "tophat"), np.array([0.3, -2.0])
    direction, start = beams.spread(nodes, shape, azimuth, np.array([0.1, -0.2]))
    np.testing.assert_allclose(np.linalg.norm(direction, axis=2), 1.0, rtol=1e-14)
    axis = beams.axis_directions(azimuth, np.array([0.1, -0.2]))
    np.testing.assert_allclose(np.einsum("nmi,ni->nm", start, axis), 0.0, atol=1e-16)
