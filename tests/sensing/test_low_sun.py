"""A low sun in beams: noise of those that look at it, what hides it, its aureole, twilight; the shipped scenarios."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from emulator.errors import ScenarioError
from emulator.judging.trial import Trial
from emulator.physics import sunlight
from emulator.physics.arrays import Floats
from emulator.scenario import scenario
from emulator.scenario.weather import WeatherConfig
from emulator.sensing import daylight
from emulator.sensing.error_budget import explained
from emulator.sensing.measure import Measure
from protocols.scan import DAZZLED
from tests.sensing import joins
from tests.sensing.rig import QUIET, build, plan, plate

PHYSICS: dict[str, Any] = {**QUIET, "rule": "axis"}
LMS = "sick-lms291-s05"


def towards(elevation_deg: float, **keys: Any) -> dict[str, Any]:
    return {"sun": {"azimuth_deg": 0.0, "elevation_deg": elevation_deg, **keys}}


def background_w(measure: Measure, azimuth_deg: Any = (0.0,), elevation_deg: float = 0.0, t_s: float = 0.0) -> Floats:
    view = measure.view(plan(azimuth_deg, elevation_deg=elevation_deg, start_s=t_s))
    light = daylight.daylight(view.air.sun, view.rays, view.seen, view.surfaces, measure._caster, measure.model)
    return np.zeros(len(view.rays.axis)) if light.power_w is None else light.power_w


@pytest.mark.parametrize("case", [one for one in joins.cases("low_sun")], ids=lambda case: case["name"])
def test_a_beam_into_the_sun_has_the_noise_of_the_outside_case(tmp_path: Path, case: dict[str, Any]) -> None:
    """The paper's receiver looks at the middle of the disc: its share of it, times the light of the case."""
    h, beta = case["setup"]["elevation_deg"], case["setup"]["turbidity_beta"]
    measure = build(tmp_path, weather=towards(h, turbidity_beta=beta), physics=PHYSICS)
    model = measure.model
    half = 0.5 * model.receiver.field_of_view_rad
    light = 1e9 * case["expected"]["dni_anchored_w_m2_nm"] * 1e-9 * model.receiver.filter_nm
    wanted = light * math.pi * model.aperture_radius_m**2 * model.efficiency * (half / 4.652e-3) ** 2
    found = background_w(measure, elevation_deg=h)[0]
    noise = [model.receiver.noise_a(power) for power in (found, wanted)]
    assert noise[0] == pytest.approx(noise[1], rel=0.01)
    assert found == pytest.approx(wanted, rel=0.01, abs=2e-9)


def test_nothing_jumps_while_the_sun_sets(tmp_path: Path) -> None:
    """A level wide receiver that looks at the place where it sets, from half a degree to three below."""
    measure = build(
        tmp_path, weather=towards(1.0), model=LMS, physics={**PHYSICS, "leave_out": {"background_light": False}}
    )
    power = []
    for h in np.linspace(0.5, -3.0, 701):
        measure._change_air(WeatherConfig.model_validate(towards(float(h))))
        power.append(background_w(measure)[0])
    steps = np.diff(power)
    assert np.abs(steps).max() < 0.04 * max(power), "a disc is a hundred steps wide"
    assert power[0] > 1e3 * power[-1] > 0.0
    assert (steps[60:] <= 1e-9 * power[0]).all()


@pytest.mark.parametrize(("edge_m", "share"), [(-1.0, 1.0), (-0.1, 0.93), (0.0, 0.5), (0.1, 0.07), (1.0, 0.0)])
def test_a_wall_cuts_the_disc(tmp_path: Path, edge_m: float, share: float) -> None:
    """A wall 20 m away whose edge is so far right or left of the disc's middle; the disc is 0.186 m wide there."""
    wall = plate(20.0, "dark", 30.0, edge_m - 15.0)  # it stands on the right
    elevation = 3.0
    light = [
        background_w(
            build(tmp_path, world, weather=towards(elevation), model=LMS, physics=PHYSICS), elevation_deg=elevation
        )[0]
        for world in ([], [wall])
    ]
    above = math.acos(max(-1.0, min(1.0, edge_m / 0.09304)))
    exact = (above - math.sin(above) * math.cos(above)) / math.pi
    assert exact == pytest.approx(share, abs=0.1)
    assert light[1] / light[0] == pytest.approx(exact, abs=0.05)


def test_the_aureole_is_seen_beside_the_disc_and_behind_no_wall(tmp_path: Path) -> None:
    """Two degrees beside the sun a field of view has its radiance there; a wall hides it, out of reach as well."""
    keys: dict[str, Any] = {"model": LMS, "physics": PHYSICS}
    found = []
    for world, ratio in (
        ([], 0.2),
        ([], 0.0),
        ([plate(20.0, "dark", 1.0, 0.9)], 0.2),
        ([plate(200.0, "dark", 8.0, 7.0)], 0.2),
    ):
        measure = build(tmp_path, world, weather=towards(3.0, circumsolar_ratio=ratio), **keys)
        found.append(background_w(measure, [2.0], elevation_deg=3.0)[0])
    model = measure.model
    angle = 2.0 * math.cos(math.radians(3.0)) * math.pi / 180.0
    direct = float(sunlight.direct_normal(3.0, sunlight.CLEAR_BETA, model.wavelength_m, 1370.0))
    radiance = float(sunlight.aureole_radiance(angle, 0.2, direct)) * 1e-9 * model.receiver.filter_nm
    half = 0.5 * model.receiver.field_of_view_rad
    wanted = radiance * math.pi * half**2 * math.pi * model.aperture_radius_m**2 * model.efficiency
    assert found[0] - found[1] == pytest.approx(wanted, rel=0.1)
    assert found[2] < found[1] + 0.05 * wanted
    assert found[3] < found[1] + 0.05 * wanted


@pytest.mark.parametrize("aside_deg", [5.0, 40.0, 170.0])
def test_light_that_strays_into_far_beams_is_left_out_below_the_limit_alone(tmp_path: Path, aside_deg: float) -> None:
    """1e-4 (1 deg/angle)^2 of the direct light, in the nearest of beams that all look elsewhere."""
    measure = build(tmp_path, [], weather=towards(0.5), physics=PHYSICS)
    model, sun = measure.model, measure.air.at(0.0).sun
    assert sun is not None
    view = measure.view(plan([aside_deg, aside_deg + 7.0], elevation_deg=0.5))
    within = daylight._SunInView(sun, view.rays, model)
    angle_deg = math.degrees(2.0 * math.asin(math.sin(math.radians(0.5 * aside_deg)) * math.cos(math.radians(0.5))))
    direct = float(sunlight.direct_normal(0.5, sunlight.CLEAR_BETA, model.wavelength_m, 1370.0))
    light = direct * float(sunlight.disc_share(0.5)) * 1e-9 * model.receiver.filter_nm
    wanted = 1e-4 / angle_deg**2 * light * math.pi * model.aperture_radius_m**2 * model.efficiency
    below, above = (within.power_w(view.seen, measure._caster, share * wanted) for share in (0.99, 1.01))
    assert below[0] == pytest.approx(wanted, rel=1e-3)
    assert not above.any()


@pytest.mark.parametrize("where", ["before the aureole", "beside it"])
def test_a_wall_out_of_reach_hides_the_aureole_where_no_surface_shows(tmp_path: Path, where: str) -> None:
    """A thin sun: no ray is cast for the light of surfaces, but one for what stands before the aureole."""
    power = []
    for world in ([], [plate(300.0, "dark", 8.0, 5.2 if where == "before the aureole" else 25.2)]):
        weather = towards(3.0, circumsolar_ratio=0.5, total_w_m2=100.0)
        measure = build(tmp_path, world, weather=weather, physics=PHYSICS)
        assert not daylight.surfaces_show(measure.air.at(0.0).sun, measure.model)
        power.append(background_w(measure, [1.0], elevation_deg=3.0)[0])
    assert power[0] > 0.0
    assert power[1] == (pytest.approx(power[0]) if where == "beside it" else pytest.approx(0.0, abs=0.1 * power[0]))


def test_a_sensor_that_drives_into_a_shadow_is_dazzled_no_more_within_the_sweep(tmp_path: Path) -> None:
    """Beams at the sun, one a millisecond, from behind a wall's edge that the sensor passes at 0.5 s."""
    actor = {"id": "ego", "motion": {"at_m": [0.0, 1.0, 0.0], "velocity_m_s": [0.0, -2.0, 0.0]}}
    wall = plate(5.0, "dark", 30.0, -15.0)
    measure = build(tmp_path, [wall], actors=[actor], weather=towards(1.0), model=LMS, physics=PHYSICS,
                    mount={"actor": "ego", "pitch_deg": -1.0})  # fmt: skip
    scan = measure(plan(np.zeros(1000), fire_s=1e-3 * np.arange(1000)))
    dazzled = (scan.flags & DAZZLED) > 0
    assert dazzled[:480].all()
    assert not dazzled[520:].any()


def test_a_sun_that_reaches_no_beam_costs_no_ray(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    measure = build(tmp_path, [plate(10.0, "half")], weather=towards(-19.0), model=LMS, physics=PHYSICS)
    monkeypatch.setattr(daylight, "_SunInView", None)  # may not be asked
    assert np.isfinite(measure(plan()).range_m).any()
    monkeypatch.undo()
    high = build(tmp_path, [plate(10.0, "half")], weather=towards(80.0), physics=PHYSICS)
    rows = {row["term"]: row for row in explained(high, plan())}
    assert rows["sun in view"]["left_out"]
    assert not rows["sun in view"]["idle"]
    low = build(tmp_path, weather=towards(0.5), model=LMS, physics=PHYSICS)
    assert not {row["term"]: row for row in explained(low, plan())}["sun in view"]["left_out"]


@pytest.mark.parametrize(("keys", "reported"), [
    ("turbidity: 1.5", "turbidity 1.5; want at least 2.19"),
    ("turbidity: 3, turbidity_beta: 0.1", "turbidity and turbidity_beta; want one of them"),
    ("turbidity_beta: -0.1", "turbidity_beta: -0.1; want a number >= 0"),
    ("circumsolar_ratio: 0.9", "circumsolar_ratio: 0.9; want a number <= 0.8"),
])  # fmt: skip
def test_a_wrong_haze_is_refused_with_its_place(keys: str, reported: str) -> None:
    with pytest.raises(ScenarioError) as raised:
        scenario.loads(f"schema: 1\nweather:\n  sun: {{{keys}}}\n", Path("case.yaml"))
    assert str(raised.value).startswith("case.yaml:3: weather.sun")
    assert reported in str(raised.value)


@pytest.mark.parametrize("name", ["low_sun", "two_lidars"])
def test_the_shipped_scenarios_end_as_they_say(name: str) -> None:
    trial = Trial(scenario.load(name))
    verdict = trial.finish()
    trial.close()
    assert verdict.held, str(verdict)


# ------------------------------------------------------------------------------- shadows on what beams look at
ROOF = {"plane": {"size_m": [4.0, 60.0]}, "at_m": [8.0, 0.0, 5.0], "material": "white"}
BEHIND: dict[str, Any] = {"sun": {"azimuth_deg": 180.0, "elevation_deg": 45.0}}
"Behind the sensor: it shines on a wall 10 m ahead, and past a roof from 6 to 10 m at a height of 5 m."


def shaded(tmp_path: Path, *more: dict[str, Any], **physics: Any) -> Measure:
    world = [plate(10.0, "white", 60.0, 0.0, 60.0), *more]
    return build(tmp_path, world, weather=BEHIND, model=LMS, physics={**PHYSICS, **physics})


def test_a_surface_in_the_shadow_of_another_body_has_the_light_of_the_sky_alone(tmp_path: Path) -> None:
    """The roof shades the wall from 1 to 5 m of height; both sides of the edge are the closed forms."""
    open_, under = shaded(tmp_path), shaded(tmp_path, ROOF)
    model, sky = open_.model, daylight._clear_sky(open_.air.at(0.0).sun, open_.model.wavelength_m)
    direct = sky.direct * math.cos(math.radians(45.0)) / math.pi
    for height_m, part in ((0.5, 1.0), (0.95, 1.0), (1.05, 0.0), (2.0, 0.0), (4.5, 0.0)):
        up = math.degrees(math.atan2(height_m, 10.0))
        wanted = daylight._filling_w(part * direct + 0.5 * sky.radiance, model)
        assert background_w(under, elevation_deg=up)[0] == pytest.approx(wanted, rel=1e-9)
        assert background_w(open_, elevation_deg=up)[0] == pytest.approx(background_w(under)[0], rel=1e-9)


def test_a_pane_before_the_sun_takes_its_share_of_the_light(tmp_path: Path) -> None:
    glass = {**ROOF, "material": "window_glass"}
    lit, behind, dark = (background_w(shaded(tmp_path, *one), elevation_deg=11.0)[0] for one in ((), (glass,), (ROOF,)))
    assert 0.75 < (behind - dark) / (lit - dark) < 0.92


def test_a_shadow_costs_one_ray_for_each_lit_beam_once_where_nothing_moves(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    cast: list[int] = []

    def counted(self: Any, origin_m: Floats, *rest: Any, **keys: Any) -> Any:
        cast.append(len(origin_m))
        return first_hits(self, origin_m, *rest, **keys)

    measure = shaded(tmp_path, ROOF)
    first_hits = type(measure._caster).first_hits
    monkeypatch.setattr(type(measure._caster), "first_hits", counted)
    sweep = plan(np.linspace(-30.0, 30.0, 61))
    one = measure(sweep)
    at_first = sum(cast)
    cast.clear()
    two = measure(plan(np.linspace(-30.0, 30.0, 61), sweep=1))
    assert at_first <= 2 * 61 + 1
    assert sum(cast) <= 1
    assert np.array_equal(one.range_m, two.range_m)


def test_no_ray_looks_for_shadows_where_the_sun_does_not_show_or_the_surface_turns_away(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def never(*_: Any) -> Any:
        raise AssertionError("a ray to the sun")

    monkeypatch.setattr(daylight.Shadows, "share", never)
    black = build(tmp_path, [plate(10.0, "white")], weather=towards(45.0), model=LMS, physics=PHYSICS)
    assert background_w(black)[0] > 0.0  # the sun is behind the wall: light of the sky alone
    night = build(tmp_path, [plate(10.0, "white")], weather=towards(-20.0), model=LMS, physics=PHYSICS)
    assert background_w(night)[0] == 0.0


def test_a_car_that_drives_by_casts_its_shadow_when_it_is_there(tmp_path: Path) -> None:
    truck = {
        "id": "truck", "shape": {"box": {"size_m": [2.0, 6.0, 8.0]}}, "material": "white",
        "motion": {"at_m": [-4.0, -13.0, 0.0], "velocity_m_s": [0.0, 10.0, 0.0]},
    }  # fmt: skip
    weather = {"sun": {"azimuth_deg": 180.0, "elevation_deg": 20.0}}
    world = [plate(10.0, "white", 60.0, 0.0, 60.0)]
    measure = build(tmp_path, world, actors=[truck], weather=weather, model=LMS, physics=PHYSICS)
    power = [background_w(measure, elevation_deg=1.0, t_s=t)[0] for t in (0.0, 1.0, 1.3, 2.5)]
    assert power[1] == power[2] < 0.5 * power[0]
    assert power[3] == power[0]
