"""Composed scenes through the whole path (file, mesh, embreex, sub-beams, receiver) against closed forms.

Shares and ratios are those of the oracles `edge ...`, `cylinder ...`, `sphere ...`, `half beam on a post 20 m, wall 25
m` and their kin, whose formulas are `physics.radiometry` and `physics.tilted`.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from emulator.physics import radiometry, softtarget, tilted
from emulator.sensing.measure import Measure
from tests.sensing.rig import QUIET, build, grey, plan, plate

DIVERGENCE_RAD = np.radians(0.07)
R_M = 20.0
W_M = float(np.tan(0.5 * DIVERGENCE_RAD) * R_M)
"Radius of the paper's beam at 20 m."


def amplitude(measure: Measure, beams: int = 1) -> float:
    """Sum of all single reflections of a beam along x, in rms noise."""
    return float(measure.view(plan([0.0] * beams)).echoes.amplitude.sum()) / beams


def plain(measure: Measure, rho: float = 1.0, range_m: float = R_M) -> float:
    """The point formula for a plate that fills the beam."""
    model = measure.model
    alpha = measure.air.at(0.0).everywhere.extinction_per_m
    return float(model.k_m2 * rho * np.exp(-2 * alpha * range_m) / (range_m**2 + model.aperture_radius_m**2))


def bundle(rule: str, sub_beams: int = 1, **more: Any) -> dict[str, Any]:
    return {**QUIET, "rule": rule, "sub_beams": sub_beams, "echoes": "all", "max_echoes": 8, **more}


@pytest.mark.parametrize("x0", [-0.5, -0.25, 0.0, 0.25, 0.5])
@pytest.mark.parametrize(("physics", "allowed"), [(bundle("adaptive", depth=5), 2e-3), (bundle("spiral", 4096), 2e-3)])
def test_an_edge_leaves_its_share_of_the_beam(
    tmp_path: Path, x0: float, physics: dict[str, Any], allowed: float
) -> None:
    measure = build(tmp_path, [plate(R_M, "white", 100.0, x0 * W_M - 50.0)], physics=physics)
    share = amplitude(measure) / plain(measure)
    assert share == pytest.approx(float(radiometry.fill_edge(x0, 1.0)), abs=allowed)


def test_half_a_beam_on_a_post_and_half_on_a_wall_give_two_echoes_with_the_ratio_of_the_ranges(tmp_path: Path) -> None:
    post, wall = plate(20.0, "half", 100.0, 50.0), plate(25.0, "half")
    measure = build(tmp_path, [post, wall], physics=bundle("adaptive", depth=6))
    scan = measure(plan())
    assert scan.range_m[0, :2] == pytest.approx([20.0, 25.0], abs=1e-3)
    assert np.isnan(scan.range_m[0, 2:]).all()
    alpha = measure.air.at(0.0).everywhere.extinction_per_m
    expected = 0.64 * np.exp(-2 * alpha * 5.0)
    assert scan.intensity[0, 1] / scan.intensity[0, 0] == pytest.approx(expected, rel=2e-3)


def test_an_edge_between_two_materials_gives_the_ratio_of_shares_times_reflectances(tmp_path: Path) -> None:
    near = plate(20.0, "bright", 100.0, -50.0 - 0.338 * W_M)
    physics = bundle("adaptive", depth=6, pulse_fwhm_ns=1.0, system_constant_m2=75000.0)
    measure = build(tmp_path, [near, plate(21.0, "dark")], physics=physics, materials={"bright": grey(0.8)})
    scan = measure(plan())
    alpha = measure.air.at(0.0).everywhere.extinction_per_m
    assert scan.range_m[0, :2] == pytest.approx([20.0, 21.0], abs=1e-3)
    expected = 0.340666908160 * np.exp(-2 * alpha)
    assert scan.intensity[0, 1] / scan.intensity[0, 0] == pytest.approx(expected, rel=1e-2)


@pytest.mark.parametrize(("radius_w", "sub_beams", "allowed"), [(1.0, 1024, 3e-3), (0.1, 16384, 2e-2)])
def test_a_cylinder_across_the_beam_returns_its_closed_form(
    tmp_path: Path, radius_w: float, sub_beams: int, allowed: float
) -> None:
    shape = {"cylinder": {"radius_m": radius_w * W_M, "height_m": 10.0, "segments": 1024}}
    post = {**shape, "at_m": [R_M + radius_w * W_M, 0.0, -5.0], "material": "white"}
    measure = build(tmp_path, [post], physics=bundle("spiral", sub_beams))
    expected = float(radiometry.fill_cylinder(radius_w, 1.0))
    # the sides lie up to a radius farther than the front: 1e-3 of the range at most
    assert amplitude(measure, 4) / plain(measure) == pytest.approx(expected, rel=allowed + 2 * radius_w * W_M / R_M)


@pytest.mark.parametrize(("radius_w", "sub_beams", "allowed"), [(1.0, 1024, 1e-2), (0.1, 16384, 4e-2)])
def test_a_sphere_on_the_axis_returns_its_closed_form(
    tmp_path: Path, radius_w: float, sub_beams: int, allowed: float
) -> None:
    radius = radius_w * W_M
    ball = {"sphere": {"radius_m": radius, "segments": 256}, "at_m": [R_M + radius, 0.0, -radius], "material": "white"}
    measure = build(tmp_path, [ball], physics=bundle("spiral", sub_beams))
    expected = float(radiometry.fill_sphere(radius_w, 1.0))
    assert amplitude(measure, 4) / plain(measure) == pytest.approx(expected, rel=allowed)


@pytest.mark.parametrize("tilt_deg", [0.0, 60.0, 85.0])
@pytest.mark.parametrize("divergence_rad", [DIVERGENCE_RAD, 12.913e-3])
def test_a_tilted_plane_returns_energy_mean_and_spread_of_its_closed_form(
    tmp_path: Path, tilt_deg: float, divergence_rad: float
) -> None:
    plane = {**plate(R_M, "white", 4000.0, 0.0, 100.0), "yaw_deg": tilt_deg}
    physics = bundle("laguerre", 64, divergence_deg=float(np.degrees(divergence_rad)), gate_m=2000.0)
    measure = build(tmp_path, [plane], weather={"visibility_m": 1e9}, physics=physics)
    found = measure.view(plan()).echoes
    weight = found.amplitude * (found.range_m**2 + measure.model.aperture_radius_m**2) / found.range_m**2
    energy = weight.sum() / (measure.model.k_m2 * np.cos(np.radians(tilt_deg)) / R_M**2)
    mean = np.average(found.range_m, weights=weight)
    spread = np.sqrt(np.average((found.range_m - mean) ** 2, weights=weight))
    want = tilted.tilted_plane_moments(0.5 * divergence_rad, np.radians(tilt_deg))
    assert energy == pytest.approx(float(want[0]), rel=1e-6)
    assert mean / R_M == pytest.approx(float(want[1]), rel=1e-8)
    assert spread / R_M == pytest.approx(float(want[2]), rel=1e-4)


@pytest.mark.parametrize(
    ("half_width_m", "power"), [((1e3, 1e3), 2.0), ((1e3, 1e-5), 3.0), ((1e-5, 1e-5), 4.0)],
    ids=["wall", "wire", "point"],
)  # fmt: skip
def test_the_laws_of_distance_follow_from_the_geometry(
    tmp_path: Path, half_width_m: tuple[float, float], power: float
) -> None:
    """Thin targets as the expectation over many sub-beams would need millions; here 1 mm targets under a wide beam."""
    size = [2e3 if h == 1e3 else 0.06 for h in half_width_m]
    echo = []
    for range_m in (20.0, 40.0):
        target = {"plane": {"size_m": size}, "at_m": [range_m, 0.0, 0.0], "material": "white", "pitch_deg": -90.0}
        physics = bundle("spiral", 16384, divergence_deg=2.0)
        measure = build(tmp_path, [target], weather={"visibility_m": 1e9}, physics=physics)
        echo.append(amplitude(measure))
    assert np.log2(echo[0] / echo[1]) == pytest.approx(power, abs=0.12 if power > 2 else 1e-3)


def test_a_wall_in_fog_gives_the_sum_of_wall_and_fog(tmp_path: Path) -> None:
    """Oracle `fog V 40 m and wall 10 m`: the same receiver, its maxima instead of one instant."""
    visibility_m, wall_m = 40.0, 10.0
    physics = bundle("axis", threshold_to_noise=2.0, detection="peak")
    measure = build(tmp_path, [plate(wall_m, "dark")], weather={"fog": {"visibility_m": visibility_m}}, physics=physics)
    scan = measure(plan())
    model = measure.model
    alpha = measure.air.at(0.0).everywhere.extinction_per_m
    x = np.arange(1.0, 16.0, 1e-3)
    nep_w = model.peak_w * model.aperture_radius_m**2 * model.efficiency / model.k_m2
    power = softtarget.fog_plus_wall(
        x, alpha, 18.8, model.overlap_start_m, model.overlap_full_m, wall_m, 0.1, model.pulse.fwhm_s,
        model.pulse_energy_j, np.pi * model.aperture_radius_m**2, model.efficiency,
    ) / nep_w  # fmt: skip
    top = np.flatnonzero((power[1:-1] > power[:-2]) & (power[1:-1] >= power[2:])) + 1
    assert len(top) == 2
    assert np.count_nonzero(np.isfinite(scan.range_m)) == 2
    assert scan.intensity[0, :2] * model.threshold == pytest.approx(power[top], rel=2e-3)
    assert scan.actor[0, :2].tolist() == [-1, 0]
    # apparent ranges count from the pulse's start, those of a scan from its centre
    assert scan.range_m[0, :2] == pytest.approx(x[top] - model.pulse.start_lead_m, abs=5e-3)


def test_fog_echoes_come_before_a_wall_that_only_the_last_echo_shows(tmp_path: Path) -> None:
    world, weather = [plate(15.0, "half")], {"fog": {"visibility_m": 60.0}}
    ranges = {}
    for echoes in ("first", "strongest", "last"):
        measure = build(
            tmp_path, world, weather=weather, physics={**QUIET, "rule": "axis", "echoes": echoes, "max_echoes": 1}
        )
        ranges[echoes] = float(measure(plan()).range_m[0, 0])
    assert ranges["first"] < 3.0
    assert ranges["strongest"] < 3.0
    # the wall's edge rises from the fog's tail, so it is crossed early
    assert ranges["last"] == pytest.approx(15.0, abs=0.3)


def test_a_post_and_a_wall_two_metres_apart_give_one_phantom_point_midway(tmp_path: Path) -> None:
    """Sparrow: two equal Gaussian echoes up to 2.037 m apart have one maximum; the mixed pixel of 16 ns."""
    post = plate(20.0, "half", 100.0, 50.0)
    wall = plate(22.0, "bright", 200.0)
    physics = bundle("adaptive", depth=6, pulse="gauss", detection="peak")
    rho = 0.5 * (22.0 / 20.0) ** 2
    measure = build(
        tmp_path, [post, wall], physics=physics, materials={"bright": grey(rho)}, weather={"visibility_m": 1e9}
    )
    scan = measure(plan())
    assert np.count_nonzero(np.isfinite(scan.range_m)) == 1
    assert scan.range_m[0, 0] == pytest.approx(21.0, abs=0.1)


def test_at_three_metres_the_two_echoes_part_and_the_first_is_pulled_by_44_mm(tmp_path: Path) -> None:
    post, wall = plate(20.0, "half", 100.0, 50.0), plate(23.0, "bright")
    physics = bundle("adaptive", depth=6, pulse="gauss", detection="peak")
    rho = 0.5 * (23.0 / 20.0) ** 2
    measure = build(
        tmp_path, [post, wall], physics=physics, materials={"bright": grey(rho)}, weather={"visibility_m": 1e9}
    )
    scan = measure(plan())
    assert scan.range_m[0, :2] == pytest.approx([20.0438261730272, 23.0 - 0.0438261730272], abs=2e-3)
