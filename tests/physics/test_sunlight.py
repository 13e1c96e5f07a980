"""Sunlight at any height of the sun: published tables, closed forms, and integrals made apart from the product."""

from __future__ import annotations

import math

import numpy as np
import pytest

from emulator.physics import sunlight
from emulator.physics.constants import SUN_HALF_ANGLE_RAD
from tests.sensing import joins

BEMPORAD = {60.0: 1.154, 30.0: 1.995, 15.0: 3.816, 10.0: 5.60, 5.0: 10.39, 3.0: 15.36, 2.0: 19.79, 1.0: 26.96}
"Air mass of the visual zone, Bemporad 1904, as printed in Allen's Astrophysical Quantities."


@pytest.mark.parametrize("case", joins.cases("low_sun"), ids=lambda case: case["name"])
def test_direct_light_of_a_low_sun_is_that_of_the_outside_case(case: dict) -> None:
    h, beta, wanted = case["setup"]["elevation_deg"], case["setup"]["turbidity_beta"], case["expected"]
    assert float(sunlight.air_mass(h)) == pytest.approx(wanted["air_mass"], rel=1e-6)
    assert sunlight.rayleigh_depth(905e-9) == pytest.approx(wanted["rayleigh"], rel=1e-6)
    assert sunlight.aerosol_depth(905e-9, beta) == pytest.approx(wanted["aerosol"], rel=1e-6)
    direct = 1e-9 * float(sunlight.direct_normal(h, beta, 905e-9, 1370.0))
    assert direct == pytest.approx(wanted["dni_anchored_w_m2_nm"], rel=1e-6)
    level = direct * math.sin(math.radians(h))
    assert level == pytest.approx(wanted["on_the_ground_anchored_w_m2_nm"], rel=1e-6)


@pytest.mark.parametrize("case", joins.cases("sun_disc"), ids=lambda case: case["name"])
def test_the_horizon_cuts_the_disc(case: dict) -> None:
    share = float(sunlight.disc_share(case["setup"]["elevation_deg"]))
    assert share == pytest.approx(case["expected"]["share"], abs=1e-9)


@pytest.mark.parametrize(("elevation_deg", "printed"), BEMPORAD.items())
def test_air_mass_is_that_of_the_older_table_to_three_per_cent(elevation_deg: float, printed: float) -> None:
    assert float(sunlight.air_mass(elevation_deg)) == pytest.approx(printed, rel=0.03)


def test_light_is_continuous_from_noon_to_night_and_never_grows() -> None:
    h = np.concatenate([np.linspace(90.0, 1.0, 500), np.linspace(1.0, -1.0, 4001), np.linspace(-1.0, -19.0, 4000)])
    direct = sunlight.disc_share(h) * sunlight.direct_normal(h, 0.035, 905e-9, 1370.0)
    sky = np.array([sunlight.sky_radiance(one, 0.035, 905e-9, 1370.0) for one in h])
    for light in (direct, sky):
        assert (np.diff(light) <= 0.011 * light[:-1]).all(), "the published pieces of twilight meet to a hundredth"
        fine = h < 1.0
        assert np.abs(np.diff(light[fine])).max() < 3e-3 * light[fine][0], "no step at the horizon"
    assert direct[h < -0.27].max() == 0.0
    assert sky[h > -17.9].min() > 0.0
    assert sky[-1] == 0.0


@pytest.mark.parametrize(
    ("elevation_deg", "printed_lx"), [(0.0, 759.0), (-6.0, 3.4), (-12.0, 0.0080), (-18.0, 6.5e-4), (60.0, 1.0e5)]
)
def test_twilight_has_the_published_illuminance(elevation_deg: float, printed_lx: float) -> None:
    assert sunlight.illuminance_lx(elevation_deg) == pytest.approx(printed_lx, rel=0.06)


@pytest.mark.parametrize("border_deg", [-12.0, -5.0, -0.8, 5.0, 20.0])
def test_pieces_of_the_twilight_curve_meet(border_deg: float) -> None:
    below, above = sunlight.illuminance_lx(border_deg - 1e-9), sunlight.illuminance_lx(border_deg)
    assert above == pytest.approx(below, rel=0.02)


def test_linke_turbidity_and_angstroms_coefficient_are_inverse_and_a_clear_sky_has_3() -> None:
    for beta in (0.0, 0.035, 0.2):
        assert sunlight.beta_of_linke(sunlight.linke_of_beta(beta)) == pytest.approx(beta, abs=1e-12)
    assert sunlight.linke_of_beta(sunlight.CLEAR_BETA) == pytest.approx(2.90, abs=0.01)
    with pytest.raises(ValueError, match=r"want at least 2\.19"):
        sunlight.beta_of_linke(2.0)


def test_a_plane_that_faces_the_table_gets_the_tables_sun_and_sky() -> None:
    """ASTM G173-03: 0.749 W/m2/nm on a plane tilted by 37 degrees towards a sun at air mass 1.5, 0.1 for the ground."""
    h = 41.8
    direct = float(sunlight.direct_normal(h, sunlight.TABLE_BETA, 905e-9, 1366.1))
    sky = sunlight.sky_radiance(h, sunlight.TABLE_BETA, 905e-9, 1366.1)
    cosine = math.cos(math.radians(90.0 - h - 37.0))
    lit = math.pi * float(sunlight.lit_radiance(direct, sky, 1.0, cosine, math.cos(math.radians(37.0))))
    assert 1e-9 * direct == pytest.approx(0.700, rel=2e-3)
    assert 1e-9 * lit == pytest.approx(0.749, rel=0.03)


# ------------------------------------------------------------------------------- aureole
@pytest.mark.parametrize("ratio", [0.01, 0.05, 0.2, 0.5])
def test_the_aureole_holds_its_share_of_the_light(ratio: float) -> None:
    theta = np.geomspace(SUN_HALF_ANGLE_RAD * (1 + 1e-12), sunlight.AUREOLE_RAD, 20_001)
    ring = 2.0 * np.pi * theta * sunlight.aureole_radiance(theta, ratio, 1.0)
    light = float(np.sum(0.5 * (ring[1:] + ring[:-1]) * np.diff(theta)))
    assert light / (1.0 + light) == pytest.approx(ratio, rel=1e-5)


def test_the_aureole_grows_with_haze_and_towards_the_horizon() -> None:
    of = [sunlight.circumsolar_ratio(h, beta, 905e-9) for h, beta in ((60, 0.035), (60, 0.2), (5, 0.2), (1, 0.2))]
    assert of == sorted(of)
    assert sunlight.circumsolar_ratio(30.0, 0.1, 905e-9) == pytest.approx(0.05, abs=0.01)


@pytest.mark.parametrize("half_mrad", [0.6, 2.0, 7.5, 30.0, 60.0])
@pytest.mark.parametrize("apart_mrad", [0.0, 1.0, 5.0, 9.0, 25.0, 50.0])
def test_what_a_field_of_view_sees_of_the_aureole_is_the_integral_over_it(half_mrad: float, apart_mrad: float) -> None:
    """Points spread evenly over the field of view, each with the radiance there."""
    half, apart, n = 1e-3 * half_mrad, 1e-3 * apart_mrad, 400_000
    number = np.arange(n)
    radius, turn = half * np.sqrt((number + 0.5) / n), number * math.pi * (3.0 - math.sqrt(5.0))
    theta = np.hypot(apart + radius * np.cos(turn), radius * np.sin(turn))
    wanted = math.pi * half**2 * float(np.mean(sunlight.aureole_radiance(theta, 0.1, 1.0)))
    found = float(sunlight.aureole_seen(half, np.array([apart]), 0.1)[0])
    assert found == pytest.approx(wanted, rel=5e-3, abs=1e-6)


@pytest.mark.parametrize("half_mrad", [0.6, 7.5])
@pytest.mark.parametrize("axis_mrad", [-3.0, 0.0, 2.0, 6.0])
@pytest.mark.parametrize("sun_mrad", [-3.0, 0.0, 3.0, 20.0])
def test_field_disc_and_horizon_cut_each_other(half_mrad: float, axis_mrad: float, sun_mrad: float) -> None:
    """Random points of the disc, counted in the field of view and above the horizon."""
    rng = np.random.default_rng(5)
    side = 1.5e-3
    radius = SUN_HALF_ANGLE_RAD * np.sqrt(rng.random(1_000_000))
    turn = 2.0 * np.pi * rng.random(1_000_000)
    x, y = radius * np.cos(turn), 1e-3 * sun_mrad + radius * np.sin(turn)
    inside = (np.hypot(x - side, y - 1e-3 * axis_mrad) < 1e-3 * half_mrad) & (y > 0.0)
    apart = math.hypot(side, 1e-3 * (axis_mrad - sun_mrad))
    found = sunlight.disc_seen(1e-3 * half_mrad, np.array([1e-3 * axis_mrad]), 1e-3 * sun_mrad, np.array([apart]))
    assert float(found[0]) == pytest.approx(float(inside.mean()), abs=2.5e-3)
