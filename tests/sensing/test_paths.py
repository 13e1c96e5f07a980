"""Mirrors, glass, windscreens, sheeting, wet surfaces: where light goes after the first surface."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from emulator.compiled import switch
from emulator.physics import brdf, radiometry
from emulator.physics.materials import SurfaceTable
from emulator.sensing.order import _order, in_order
from protocols.scan import SATURATED
from tests.draws import cases
from tests.sensing.rig import QUIET, build, grey, plan, plate

AXIS = {**QUIET, "rule": "axis", "echoes": "all", "max_echoes": 8}
CLEAR: dict[str, Any] = {"visibility_m": 1e9}
MATERIALS: dict[str, Any] = {
    "mirror": {"rho": 0.0, "model": "mirror", "specular": 0.8},
    "pane": {"rho": 0.0, "model": "glass", "index": 1.5},
    "tinted": {"rho": 0.02, "model": "glass", "index": 1.5, "internal": 0.5},
    "sheeting": {"rho": 0.1, "model": "retro", "retro_cd_lx_m2": 70.0},
}


def turned_mirror(x_m: float, yaw_deg: float) -> dict[str, Any]:
    return {**plate(x_m, "mirror", 4.0), "yaw_deg": yaw_deg}


def test_a_mirror_shows_what_stands_beside_as_a_ghost_straight_ahead(tmp_path: Path) -> None:
    """Mirror at 10 m under 45 degrees, wall 5 m to its side: a point at 15 m on the line of the beam."""
    side = {"plane": {"size_m": [50.0, 50.0]}, "at_m": [10.0, 5.0, 0.0], "material": "half", "roll_deg": 90.0}
    measure = build(tmp_path, [turned_mirror(10.0, -45.0), side], materials=MATERIALS, weather=CLEAR, physics=AXIS)
    scan = measure(plan())
    assert np.count_nonzero(np.isfinite(scan.range_m)) == 1
    assert scan.range_m[0, 0] == pytest.approx(15.0, abs=1e-6)
    model = measure.model
    expected = model.k_m2 * 0.8**2 * 0.5 / (15.0**2 + model.aperture_radius_m**2)
    assert scan.intensity[0, 0] * model.threshold == pytest.approx(expected, rel=1e-6)


def test_a_ghost_in_fog_is_dimmed_over_its_whole_way(tmp_path: Path) -> None:
    side = {"plane": {"size_m": [50.0, 50.0]}, "at_m": [10.0, 5.0, 0.0], "material": "half", "roll_deg": 90.0}
    fog = {"fog": {"visibility_m": 400.0}}
    echo = [
        build(tmp_path, [turned_mirror(10.0, -45.0), side], materials=MATERIALS, weather=weather, physics=AXIS)
        .view(plan())
        .echoes.amplitude.sum()
        for weather in (CLEAR, fog)
    ]
    assert np.log(echo[0] / echo[1]) == pytest.approx(2 * 0.00978005751357 * 15.0, rel=1e-5)


ROOM = """v 5 -2 -2
v 9 -2 -2
v 9 2 -2
v 5 2 -2
v 5 -2 2
v 9 -2 2
v 9 2 2
v 5 2 2
usemtl wall
f 1 4 3 2
f 5 6 7 8
f 1 2 6 5
f 2 3 7 6
f 3 4 8 7
usemtl window
f 4 1 5 8
"""


@pytest.mark.parametrize("wall", ["half", "mirror"])
@pytest.mark.parametrize("loops", [False, True])
def test_rays_in_a_room_behind_its_window_are_cast_once(tmp_path: Path, loops: bool, wall: str) -> None:
    """To the window, from there to the back wall, and if that is a mirror on: in the room they meet its inside."""
    if loops:
        pytest.importorskip("numba")
    (tmp_path / "room.obj").write_text(ROOM, encoding="utf-8")
    room = {"mesh": "room.obj", "materials": {"wall": wall, "window": "pane"}}
    turn_deg = np.linspace(-8.0, 8.0, 9)
    with switch.switched(loops):
        world, physics = [room, plate(30.0, "white")], {**AXIS, "bounces": 2}  # nothing white is in sight
        measure = build(tmp_path, world, materials=MATERIALS, weather=CLEAR, physics=physics)
        counters = measure._caster.counters  # type: ignore[attr-defined]
        far = measure.view(plan(turn_deg)).echoes.range_m
    assert counters.rays == 9 * (3 if wall == "half" else 4)  # window; its mirror image and the wall; behind a mirror
    assert (counters.cast, counters.leaks) == (counters.rays, 0)
    if wall == "half":
        np.testing.assert_allclose(far[far > 8.0], 9.0 / np.cos(np.radians(turn_deg)), atol=1e-3)


@pytest.mark.parametrize("bounces", [1, 2])
def test_what_the_last_bounce_would_send_on_is_not_computed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, bounces: int
) -> None:
    asked, shares = [], SurfaceTable.sent_on
    monkeypatch.setattr(SurfaceTable, "sent_on", lambda *given: asked.append(1) or shares(*given))  # type: ignore[func-returns-value]
    world = [plate(x_m, "tinted") for x_m in (5.0, 6.0, 7.0, 8.0)] + [plate(9.0, "white")]
    measure = build(tmp_path, world, materials=MATERIALS, weather=CLEAR, physics={**AXIS, "bounces": bounces})
    found = measure.view(plan()).echoes.range_m
    assert len(asked) == bounces
    assert np.round(found.max()) == 5 + bounces


def test_without_bounces_the_ghost_is_gone(tmp_path: Path) -> None:
    side = {"plane": {"size_m": [50.0, 50.0]}, "at_m": [10.0, 5.0, 0.0], "material": "half", "roll_deg": 90.0}
    physics = {**AXIS, "bounces": 0}
    measure = build(tmp_path, [turned_mirror(10.0, -45.0), side], materials=MATERIALS, weather=CLEAR, physics=physics)
    assert np.isnan(measure(plan()).range_m).all()


def test_two_mirrors_send_the_beam_around_two_corners_but_not_three(tmp_path: Path) -> None:
    """Mirrors at (10, 0) and (10, 5): the beam goes on along x, to a wall at x = 30: 10 + 5 + 20 m."""
    second = {**turned_mirror(10.0, -45.0), "at_m": [10.0, 5.0, 0.0]}
    world = [turned_mirror(10.0, -45.0), second, plate(30.0, "white")]
    measure = build(tmp_path, world, materials=MATERIALS, weather=CLEAR, physics=AXIS)
    scan = measure(plan())
    assert scan.range_m[0, 0] == pytest.approx(35.0, abs=1e-6)
    physics = {**AXIS, "bounces": 1}
    measure = build(tmp_path, world, materials=MATERIALS, weather=CLEAR, physics=physics)
    assert np.isnan(measure(plan()).range_m).all()


def test_a_mirror_face_on_sends_the_beam_back_into_the_lens(tmp_path: Path) -> None:
    measure = build(tmp_path, [plate(10.0, "mirror")], materials=MATERIALS, weather=CLEAR, physics=AXIS)
    model = measure.model
    view = measure.view(plan())
    width = float(np.tan(model.beam.half_angle_x_rad) * 20.0)
    share = float(radiometry.fill_disc_offset(model.aperture_radius_m, width, 0.0))
    expected = model.k_m2 / model.aperture_radius_m**2 * 0.8 * share
    assert view.echoes.amplitude.sum() == pytest.approx(expected, rel=1e-6)


def test_a_mirror_turned_by_a_degree_sends_nothing_back(tmp_path: Path) -> None:
    measure = build(tmp_path, [turned_mirror(10.0, 1.0)], materials=MATERIALS, weather=CLEAR, physics=AXIS)
    assert np.isnan(measure(plan()).range_m).all()


@pytest.mark.parametrize(("material", "internal"), [("pane", 1.0), ("tinted", 0.5)])
@pytest.mark.parametrize("turn_deg", [20.0, 60.0])
def test_behind_glass_an_object_is_dimmed_twice(
    tmp_path: Path, material: str, internal: float, turn_deg: float
) -> None:
    pane = {**plate(10.0, material, 20.0), "yaw_deg": turn_deg}
    measure = build(tmp_path, [pane, plate(20.0, "half")], materials=MATERIALS, weather=CLEAR, physics=AXIS)
    found = measure.view(plan()).echoes
    through = float(brdf.pane_internal_transmission_cos(1.5, np.cos(np.radians(turn_deg)), internal))
    model = measure.model
    expected = model.k_m2 * 0.5 * through**2 / (20.0**2 + model.aperture_radius_m**2)
    behind = found.amplitude[np.abs(found.range_m - 20.0) < 1e-3]
    assert behind.sum() == pytest.approx(expected, rel=1e-6)


def test_dirt_on_a_pane_is_an_echo_before_the_object_behind_it(tmp_path: Path) -> None:
    pane = {**plate(10.0, "tinted", 20.0), "yaw_deg": 20.0}
    measure = build(tmp_path, [pane, plate(20.0, "half")], materials=MATERIALS, weather=CLEAR, physics=AXIS)
    assert measure(plan()).range_m[0, :2] == pytest.approx([10.0, 20.0], abs=1e-3)


def test_a_sensor_behind_a_windscreen_loses_light_both_ways(tmp_path: Path) -> None:
    bare = build(tmp_path, [plate(20.0, "half")], weather=CLEAR, physics=AXIS)
    screen = {"rake_deg": 60.0, "internal_transmission": 0.3}
    behind = build(tmp_path, [plate(20.0, "half")], weather=CLEAR, physics={**AXIS, "windscreen": screen})
    through = float(brdf.pane_internal_transmission_cos(1.5, np.cos(np.radians(60.0)), 0.3))
    ratio = behind.view(plan()).echoes.amplitude.sum() / bare.view(plan()).echoes.amplitude.sum()
    assert ratio == pytest.approx(through**2, rel=1e-9)


def test_sheeting_is_785_times_a_white_plate_and_saturates(tmp_path: Path) -> None:
    world = [plate(20.0, "sheeting")]
    measure = build(tmp_path, world, materials=MATERIALS, weather=CLEAR, physics={**AXIS, "full_scale_snr": 1e4})
    scan = measure(plan())
    assert scan.flags[0] & SATURATED
    assert scan.range_m[0, 0] == pytest.approx(20.0, abs=0.05)
    assert scan.intensity[0, 0] * measure.model.threshold == pytest.approx(1e4)
    strong = measure.view(plan()).echoes.amplitude.sum()
    white = measure.model.k_m2 / 400.0
    assert strong / white == pytest.approx(np.pi * 70.0 + 0.1, rel=1e-4)


def test_rain_that_wets_darkens_a_rough_surface_and_the_rain_alone_does_not(tmp_path: Path) -> None:
    materials = {"third": grey(0.3)}
    amplitudes = {}
    for name, rain in (("dry", {}), ("wet", {"wets": True})):
        weather = {"rain": {"rate_mm_h": 5.0, "echoes": "off", **rain}}
        measure = build(tmp_path, [plate(20.0, "third")], materials=materials, weather=weather, physics=AXIS)
        amplitudes[name] = float(measure.view(plan()).echoes.amplitude.sum())
    assert amplitudes["wet"] / amplitudes["dry"] == pytest.approx(0.196 / 0.3, rel=2e-3)


def test_three_surfaces_at_the_same_range_add_up(tmp_path: Path) -> None:
    """Three sub-beams on one plate are three equal reflections; none replaces another."""
    measure = build(tmp_path, [plate(20.0, "half")], weather=CLEAR, physics={**AXIS, "rule": "spiral", "sub_beams": 3})
    one = build(tmp_path, [plate(20.0, "half")], weather=CLEAR, physics=AXIS)
    assert measure.view(plan()).echoes.amplitude.sum() == pytest.approx(
        one.view(plan()).echoes.amplitude.sum(), rel=1e-5
    )
    assert len(measure.view(plan()).echoes) == 3


def test_no_more_light_comes_back_than_went_out(tmp_path: Path) -> None:
    """A mirror box around the sensor's beam, touching the lens: amplitude of all the light is K / a^2."""
    for world in ([plate(0.0011, "mirror")], [plate(0.0011, "white")], [plate(0.05, "mirror"), plate(0.02, "pane")]):
        physics = {**AXIS, "near_gate_m": 0.0}
        measure = build(tmp_path, world, materials=MATERIALS, weather=CLEAR, physics=physics)
        model = measure.model
        assert measure.view(plan()).echoes.amplitude.sum() <= model.k_m2 / model.aperture_radius_m**2 * (1 + 1e-9)


# ---------------------------------------------------------------- order


@given(seed=st.integers(0, 10**6))
@settings(max_examples=cases(60), deadline=None)
def test_sub_echoes_of_several_parts_come_by_beam_and_range(seed: int) -> None:
    rng = np.random.default_rng(seed)
    beams = int(rng.choice([1, 3, 40]))
    parts = [np.sort(rng.integers(0, beams, int(rng.integers(1, 200)))) for _ in range(int(rng.choice([1, 2, 3, 12])))]
    if rng.random() < 0.2:
        parts[0] = rng.permutation(parts[0])
    beam = np.concatenate(parts)
    range_m = rng.permutation(len(beam)) * 0.01  # no two are equal
    np.testing.assert_array_equal(_order(beam, range_m), np.lexsort((range_m, beam)))


@pytest.mark.parametrize("compiled_loops", [False, True])
@pytest.mark.parametrize("beams", [2, 9, 40])
def test_few_sub_echoes_are_in_order_too(beams: int, compiled_loops: bool) -> None:
    """The farthest of all, in an odd beam, came first where index and beam left the range more bits than it has."""
    beam = np.array([0, beams - 1, beams - 1]) if beams % 2 == 0 else np.array([0, beams - 2, beams - 2])
    range_m, same, actor = np.array([7.5, 78.0498, 60.8912]), np.zeros(3), np.zeros(3, np.int32)
    with switch.switched(compiled_loops):
        found = in_order(beam, range_m, same, same, actor)
    assert found.range_m.tolist() == [7.5, 60.8912, 78.0498]
