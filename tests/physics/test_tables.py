"""Tables of the physics specification, sections 1, 3 and 5: the numbers printed there, from the functions here.

The digits are those of the specification (12 where it prints 12); what was taken from the base paper, Hadj-Bachir and
de Souza 2019, says so.
"""

from __future__ import annotations

import math

import numpy as np
import pytest

from emulator.physics import atmosphere as air
from emulator.physics import background, brdf, counting, noise, precipitation, pulse, radiometry, softtarget
from emulator.physics.beams import BeamShape

HALF = 6.1086523819801535e-4
CLEAR = 8.90229347919e-5
K = 75_000.0

FOG = """
1       3.91202300543     16989.7000434   3.79969445894     3.91202300543
10      0.391202300543    1698.97000434   0.367402351311    0.391202300543
40      0.0978005751357   424.742501084   0.0885257672526   0.0978005751357
50      0.0782404601086   339.794000867   0.0702778327247   0.0782404601086
100     0.0391202300543   169.897000434   0.0341721776224   0.0391202300543
400     0.00978005751357  42.4742501084   0.00789069645940  0.00978005751357
500     0.00782404601086  33.9794000867   0.00620878547533  0.00782404601086
1000    0.00304970937792  13.2447195424   0.00292330516970  0.00233032715372
4000    0.000600317822168 2.60714717556   0.000615874079492 0.000354300512257
5000    0.000443471261709 1.92597121843   0.000475414966252 0.000240141227289
10000   0.000204752750021 0.889229894888  0.000204752750021 0.000101728277001
23000   8.90229347919e-5  0.386621693430  8.90229347919e-5  4.42296856527e-5
50000   4.09505500043e-5  0.177845978978  4.09505500043e-5  2.03456554002e-5
100000  1.76337214637e-5  0.0765822792708 1.76337214637e-5  7.45505730656e-6
"""
FOG_2 = """
1    3.94057590000     4.02272292150     3.84764852427     3.46466168203
15   0.262705060000    0.268181528100    0.256509901618    0.230977445469
40   0.0985143975000   0.100568073037    0.0961912131067   0.0866165420507
50   0.0788115180000   0.0804544584300   0.0769529704854   0.0692932336406
100  0.0394057590000   0.0402272292150   0.0384764852427   0.0346466168203
400  0.00985143975000  0.0100568073037   0.00961912131067  0.00866165420507
1000 0.00394057590000  0.00402272292150  0.00384764852427  0.00346466168203
4000 0.000985143975000 0.00100568073037  0.000961912131067 0.000866165420507
"""
RAIN = """
0   0.0               0.0               0.0               0.0
0.1 5.29697544906e-5  6.76102649811e-5  8.54846798455e-5  1.48249896459e-6
1   0.000247758156006 0.000297586097419 0.000364660135934 1.48249896459e-5
5   0.000728346207063 0.000838435643724 0.00100516970830  7.41249482297e-5
10  0.00115885196105  0.00130982307792  0.00155556545313  0.000148249896459
25  0.00214115331618  0.00236225527592  0.00277070631779  0.000370624741148
35  0.00268258535762  0.00293342393596  0.00342492572428  0.000518874637608
50  0.00340673116067  0.00369036848506  0.00428784810479  0.000741249482297
70  0.00426818904555  0.00458266105146  0.00530029515638  0.00103774927522
100 0.00542035785731  0.00576517690291  0.00663572362460  0.00148249896459
150 0.00711228422130  0.00748419289578  0.00856694113375  0.00222374844689
200 0.00862418486099  0.00900648942143  0.0102692135883   0.00296499792919
300 0.0113161631618   0.0116919749869   0.0132578982003   0.00444749689378
"""
SNOW = """
0.5 0.000542121014227 0.000490557876191
1   0.000892971995178 0.00127676699361
3   0.00196954152820  0.00581485619043
5   0.00284509152624  0.0117676638209
10  0.00468638364864  0.0306275069418
"""
DUST = """
50   0.278163746943   0.0782404601086
100  0.134344234281   0.0391202300543
500  0.0247913700417  0.00782404601086
1000 0.0119734424836  0.00391202300543
5000 0.00220953318073 0.000782404601086
"""


def rows(table: str) -> list[list[float]]:
    return [[float(word) for word in line.split()] for line in table.strip().splitlines()]


@pytest.mark.parametrize("row", rows(FOG), ids=lambda row: f"{row[0]:g}m")
def test_extinction_of_fog_by_kim_and_kruse(row: list[float]) -> None:
    v = row[0]
    found = [
        air.fog_kim(v, 905e-9),
        air.db_per_km(air.fog_kim(v, 905e-9)),
        air.fog_kruse(v, 905e-9),
        air.fog_kim(v, 1550e-9),
    ]
    assert found == pytest.approx(row[1:], rel=1e-11)


@pytest.mark.parametrize("row", rows(FOG_2), ids=lambda row: f"{row[0]:g}m")
def test_extinction_of_fog_and_smoke_by_naboulsi_and_ijaz(row: list[float]) -> None:
    v = row[0]
    laws = (air.fog_naboulsi_advection, air.fog_naboulsi_radiation, air.fog_ijaz, air.smoke_ijaz)
    assert [float(law(v, 905e-9)) for law in laws] == pytest.approx(row[1:], rel=1e-11)


@pytest.mark.parametrize("row", rows(RAIN), ids=lambda row: f"{row[0]:g}mmh")
def test_extinction_of_rain(row: list[float]) -> None:
    rate = row[0]
    found = [
        air.rain_carbonneau(rate),
        air.rain_itu_mu0(rate),
        air.rain_marshall_palmer(rate, 2.0),
        air.rain_one_size(rate, 3e-3, 2.0),
    ]
    assert found == pytest.approx(row[1:], rel=1e-11)


@pytest.mark.parametrize("row", rows(SNOW), ids=lambda row: f"{row[0]:g}mmh")
def test_extinction_of_snow(row: list[float]) -> None:
    assert [air.snow_wet(row[0], 905e-9), air.snow_dry(row[0], 905e-9)] == pytest.approx(row[1:], rel=1e-11)


@pytest.mark.parametrize("row", rows(DUST), ids=lambda row: f"{row[0]:g}m")
def test_extinction_of_dust(row: list[float]) -> None:
    assert [air.dust_esmail(row[0]), air.fog_koschmieder(row[0])] == pytest.approx(row[1:], rel=1e-11)


def test_the_documented_jumps_and_no_others() -> None:
    def factor(law: object, v: float) -> float:
        assert callable(law)
        return float(law(v * (1.0 + 1e-12), 905e-9) / law(v, 905e-9))

    assert factor(air.fog_kruse, 6000.0) == pytest.approx(0.8887, abs=1e-4)
    for law in (air.fog_kim, air.fog_kruse):
        assert factor(law, 50_000.0) == pytest.approx(0.8612, abs=1e-4)
    for v in (500.0, 1000.0, 6000.0):
        assert factor(air.fog_kim, v) == pytest.approx(1.0, abs=1e-9)


def test_light_diffracted_forward_lowers_the_extinction_of_rain_as_tabled() -> None:
    # Marshall-Palmer averages for the paper's beam: 0.70, 0.66, 0.63 at 10, 35, 70 mm/h (two digits)
    factors = [air.forward_scatter_factor(rate, 905e-9, HALF) for rate in (10.0, 35.0, 70.0)]
    assert factors == pytest.approx([0.70, 0.66, 0.63], abs=0.01)
    assert air.forward_scatter_factor(35.0, 905e-9, 6.4565e-3) == pytest.approx(0.52, abs=0.01)
    assert air.forward_scatter_factor(0.0, 905e-9, HALF) == 1.0


@pytest.mark.parametrize(
    ("visibility_m", "place_m", "power_w", "over_noise", "bound_w", "over_wall"),
    [
        (1000.0, 4.022997226, 1.64302664852e-6, 24.645, 6.077810056e-6, 0.1620396422),
        (400.0, 4.016565334, 5.15791923368e-6, 77.369, 1.925611901e-5, 0.6225006326),
        (40.0, 3.942615263, 3.92992923497e-5, 589.49, 0.0001643465063, 66.50506816),
        (10.0, 3.781951769, 6.78731931343e-5, 1018.1, 0.0003876676102, 763573.4228),
        (1.0, 3.443971829, 2.27824710783e-7, 3.4174, 6.856904644e-6, 1.909604666e49),
    ],
)
def test_fog_peaks_of_the_reference_receiver(
    visibility_m: float, place_m: float, power_w: float, over_noise: float, bound_w: float, over_wall: float
) -> None:
    alpha = float(air.fog_kim(visibility_m, 905e-9))
    optics = (1.6e-6, math.pi * 1e-4, 0.5)
    assert float(softtarget.fog_peak_range(alpha, 0.9, 1.0, 250.0, 16e-9)) == pytest.approx(place_m, rel=1e-7)
    peak = float(softtarget.fog_peak_power(alpha, 18.8, 0.9, 1.0, 250.0, 16e-9, *optics))
    assert peak == pytest.approx(power_w, rel=1e-10)
    assert peak / 6.6666666666666667e-8 == pytest.approx(over_noise, rel=1e-4)
    assert float(softtarget.fog_bound(alpha, 18.8, 0.9, 1.0, *optics)) == pytest.approx(bound_w, rel=1e-9)
    ratio = float(softtarget.fog_to_wall_ratio(alpha, 18.8, 0.9, 1.0, 15.0, 0.5, 16e-9))
    assert ratio == pytest.approx(over_wall, rel=1e-9)


def test_drops_are_few_and_false_echoes_fewer() -> None:
    means = [
        float(precipitation.rain_false_echo_mean(r, HALF, 1.0, 30.0, 0.00584, 100.0, math.pi * 1e-4, 0.5, 3.35e-7))
        for r in (10.0, 35.0, 70.0, 300.0)
    ]
    assert means == pytest.approx([0.023, 0.046, 0.066, 0.143], abs=6e-4)
    rain = precipitation.rain_spectrum(10.0)
    assert float(rain.number_above(0.5)) == pytest.approx(900.0, rel=0.02)
    assert float(precipitation.particles_per_cell(rain, 0.5, HALF * 10.0, 16e-9)) == pytest.approx(0.25, abs=0.01)
    assert float(precipitation.rain_drops_in_beam(10.0, 0.05, HALF, 1.0, 100.0)) == pytest.approx(1090.0, rel=0.01)


def test_the_lidar_ratio_of_rain_follows_from_one_drop() -> None:
    kappa = float(precipitation.drop_backscatter(1.327))
    assert kappa == pytest.approx(0.005845, abs=1e-6)
    assert float(air.rain_lidar_ratio(kappa)) == pytest.approx(269.0, abs=0.5)
    rain = precipitation.rain_spectrum(10.0)
    continuum = float(air.rain_marshall_palmer(10.0, 2.0)) / rain.backscatter
    assert continuum == pytest.approx(math.pi / (2.0 * kappa), rel=1e-9)


# ------------------------------------------------------------------------------- 5: the base paper
@pytest.mark.parametrize(
    ("printed_m", "model_m", "reach"),
    [
        (237.0, 239.77581, ("plate", 0.80)),  # container truck
        (232.0, 232.31616, ("plate", 0.75)),  # car body
        (142.0, 148.03618, ("plate", 0.30)),  # road sign
        (22.0, 22.523752, ("round", 0.05, 0.003)),  # bicycle front and back
        (45.0, 45.882009, ("round", 0.05, 0.0286)),  # bicycle side
        (58.0, 60.906111, ("plate", 0.05)),  # pedestrian front and back
        (59.0, 60.906111, ("plate", 0.05)),  # pedestrian side
    ],
)
def test_table_2_of_the_paper_within_ten_per_cent(
    printed_m: float, model_m: float, reach: tuple[str, float] | tuple[str, float, float]
) -> None:
    if reach[0] == "plate":
        found = float(radiometry.max_range_extended(K, reach[1], CLEAR, 1.0))
    else:
        found = float(radiometry.max_range_cylinder(K, reach[1], CLEAR, 1.0, HALF, reach[2]))  # type: ignore[misc]
    assert found == pytest.approx(model_m, rel=1e-7)
    assert abs(found / printed_m - 1.0) < 0.10


def test_signal_over_distance_of_the_car_body() -> None:
    distance = np.array([5.0, 10.0, 20.0, 50.0, 100.0, 150.0, 190.0, 200.0, 232.0])
    snr = np.exp(radiometry.log_snr(K, 0.75, CLEAR, distance))
    assert snr == pytest.approx([2248.0, 561.0, 140.0, 22.3, 5.53, 2.43, 1.51, 1.36, 1.00], rel=5e-3)
    reach = [float(radiometry.max_range_extended(K, rho, CLEAR, 1.0)) for rho in (0.20, 0.03, 0.498)]
    assert reach == pytest.approx([121.0, 47.0, 190.0], abs=0.6)


@pytest.mark.parametrize(
    ("alpha", "range_m"),
    [
        (air.fog_kim(5000.0, 905e-9), 215.5),
        (air.fog_kim(4000.0, 905e-9), 209.2),
        (air.fog_kim(400.0, 905e-9), 94.30),
        (air.fog_kim(40.0, 905e-9), 23.60),
        (air.rain_carbonneau(10.0) + CLEAR, 187.7),
        (air.rain_carbonneau(35.0) + CLEAR, 154.5),
        (air.rain_carbonneau(70.0) + CLEAR, 132.9),
        (air.rain_marshall_palmer(10.0) + CLEAR, 177.2),
        (air.rain_marshall_palmer(35.0) + CLEAR, 143.3),
        (air.rain_marshall_palmer(70.0) + CLEAR, 122.5),
        (air.rain_one_size(10.0, 3e-3) + CLEAR, 224.8),
        (air.rain_one_size(35.0, 3e-3) + CLEAR, 208.9),
        (air.rain_one_size(70.0, 3e-3) + CLEAR, 191.2),
    ],
)
def test_range_of_the_car_in_each_weather(alpha: float, range_m: float) -> None:
    assert float(radiometry.max_range_extended(K, 0.75, float(alpha), 1.0)) == pytest.approx(range_m, abs=0.06)


def test_the_stokes_form_of_one_drop_size_is_not_usable_and_kept_to_show_it() -> None:
    reach = float(radiometry.max_range_extended(K, 0.75, float(air.rain_stokes(70.0, 3e-3, 2.0)) + CLEAR, 1.0))
    assert reach == pytest.approx(231.8, abs=0.1)


@pytest.mark.parametrize(
    ("range_m", "plain", "rho_03", "rho_06"),
    [
        (5.0, 39.70, 41.4, 41.6),
        (10.0, 20.00, 21.3, 21.5),
        (20.0, 10.02, 10.8, 11.1),
        (30.0, 6.68, 7.0, 7.4),
        (40.0, 5.01, 4.8, 5.4),
        (50.0, 4.01, 2.9, 4.1),
        (60.0, 3.34, 0.0, 3.0),
        (80.0, 2.51, 0.0, 0.0),
    ],
)
def test_points_of_an_lms291_on_a_car(range_m: float, plain: float, rho_03: float, rho_06: float) -> None:
    step = math.radians(0.5)
    assert float(counting.beams_on_target(1.75, 0.0, range_m, step)) == pytest.approx(plain, abs=0.006)
    for rho, expected in ((0.3, rho_03), (0.6, rho_06)):
        full = float(radiometry.max_range_extended(9000.0, rho, CLEAR, 1.0))
        share = float(counting.needed_share(range_m, full, CLEAR))
        with np.errstate(all="ignore"):
            edge = float(counting.edge_extension(math.tan(6.4565e-3) * range_m, share))
        found = float(counting.beams_on_target(1.75, edge, range_m, step)) if share < 1.0 else 0.0
        assert found == pytest.approx(expected, abs=0.06)


# ------------------------------------------------------------------------------- 1 and 2: numbers in the text
def test_numbers_of_the_text_on_beam_pulse_and_timing() -> None:
    beam = BeamShape.round(math.radians(0.07))
    widths = [2e3 * float(beam.radius_m(r)[0]) for r in (22.0, 45.0, 58.0, 100.0, 142.0, 232.0)]
    assert widths == pytest.approx([27.0, 55.0, 71.0, 122.0, 173.0, 283.0], abs=0.6)
    assert float(pulse.peak_power_sin2(1.6e-6, 16e-9)) == pytest.approx(100.0, rel=1e-15)
    assert float(pulse.peak_power_gauss(1.6e-6, 16e-9)) == pytest.approx(93.94, abs=0.005)
    assert pulse.walk_sin2(16e-9, np.array([1.0, 10.0, 100.0])) == pytest.approx([2.398, 0.491, 0.153], abs=6e-4)
    assert float(pulse.two_echo_limit_gauss(16e-9)) == pytest.approx(2.037, abs=5e-4)
    assert pulse.two_echo_peak(16e-9, 3.0, 1.0) == pytest.approx(0.044, abs=5e-4)
    assert pulse.crlb_sin2(16e-9, np.array([100.0, 5.0]), 31.25e6) == pytest.approx([0.0153, 0.305], rel=5e-3)


def test_numbers_of_the_text_on_surfaces() -> None:
    assert float(brdf.ggx_back(0.04, 0.1, 0.0)) == pytest.approx(1.0, rel=1e-12)
    assert float(brdf.ggx_back(0.04, 0.1, math.radians(30.0))) == pytest.approx(0.0017, abs=5e-5)
    assert float(brdf.pane_transmission(1.5, 0.0)) == pytest.approx(0.923, abs=5e-4)
    assert float(brdf.pane_transmission(1.5, math.radians(60.0))) == pytest.approx(0.848, abs=5e-4)
    assert float(brdf.retro_equivalent(70.0)) == pytest.approx(220.0, abs=0.2)
    assert float(brdf.wet_reflectance(0.30, 1.327)) == pytest.approx(0.196, abs=5e-4)
    assert float(brdf.fresnel_unpolarised(1.327, 0.0)) == pytest.approx(0.0197, abs=5e-5)


def test_numbers_of_the_text_on_the_reference_receiver() -> None:
    receiver = (0.55, 1.0, 0.0, 0.0, 1e-9, 6.56e-12, 1e9, 300.0, 31.25e6)
    night = float(noise.noise_current(0.0, 0.0, *receiver))
    assert night == pytest.approx(36.67e-9, rel=2e-4)
    nep = float(noise.noise_equivalent_power(night, 0.55, 1.0))
    assert nep == pytest.approx(66.7e-9, rel=1e-3)
    assert float(radiometry.system_constant(100.0, 0.01, 0.5, nep)) == pytest.approx(75_000.0, rel=1e-3)
    field = math.radians(0.07)
    direct = background.solar_ground(905e-9, 1370.0, direct=True)
    assert background.solar_ground(905e-9) * 1e-9 == pytest.approx(0.751, abs=5e-4)
    sun = float(background.background_sun(direct, 40e-9, 0.01, field, 0.5, 0.0))
    assert float(background.sun_share(field, 4.652e-3, 0.0)) == pytest.approx(0.0690, abs=1e-4)
    assert sun == pytest.approx(0.304e-3, rel=5e-3)
    blinded = float(noise.noise_current(0.0, sun, *receiver))
    assert blinded == pytest.approx(54.95e-9, rel=2e-3)
    assert night / blinded == pytest.approx(0.667, abs=2e-3)
    wall = float(background.background_surface(0.751e9, 40e-9, 1.0, 0.0, 0.01, field, 0.5))
    assert wall == pytest.approx(7.04e-9, rel=2e-3)
    lit = float(noise.noise_current(0.0, wall, *receiver))
    assert lit / night - 1.0 == pytest.approx(1.4e-5, rel=0.05)
    assert float(noise.tnr_for_false_alarms(1e-4, 31.25e6, 250.0)) == pytest.approx(5.02, abs=5e-3)
    assert float(noise.false_alarm_rice(1.0, 31.25e6, 250.0)) == pytest.approx(18.25, abs=5e-3)
    assert not bool(background.dazzled(sun, 0.55, 1.0))
    assert bool(background.dazzled(2.0 * sun, 0.55, 1.0))


def test_numbers_of_the_text_on_filter_and_speed() -> None:
    assert float(background.filter_line_share(5e-9, 40e-9, 20e-9)) == pytest.approx(0.5, rel=1e-9)
    shift = float(background.filter_angle_shift(905e-9, 2.0, math.radians(20.0))) - 905e-9
    assert shift == pytest.approx(-13.3e-9, abs=0.05e-9)
    assert float(noise.speed_noise(0.01, 1.0 / 75.0)) == pytest.approx(1.06, abs=5e-3)
