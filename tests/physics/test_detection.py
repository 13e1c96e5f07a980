"""From sub-echoes to reported echoes: timing by every method, mixed pixels, saturation, noise, choice of echoes."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from emulator.physics import beams, noise, pulse, radiometry, tilted
from emulator.physics.arrays import Floats
from emulator.physics.constants import SPEED_OF_LIGHT_M_S
from emulator.physics.detection import detect
from emulator.physics.detector import Detector, Echoes, Method
from emulator.physics.pulse import Pulse, PulseShape
from emulator.physics.softprofile import SoftProfile
from emulator.physics.subechoes import SubEchoes, cluster
from tests.draws import cases

PULSE = Pulse(16e-9)
METHODS: tuple[Method, ...] = ("leading_edge", "constant_fraction", "peak", "centroid")


def one_beam(*pairs: tuple[float, float]) -> SubEchoes:
    """Sub-echoes (range, amplitude) of a single beam."""
    r, a = (np.array(values, np.float64) for values in zip(*pairs, strict=True))
    return SubEchoes.of(np.zeros(len(pairs), np.int64), r, a)


def ranges(found: Echoes) -> list[float]:
    row = found.range_m[0]
    return [float(r) for r in row[np.isfinite(row)]]


# ------------------------------------------------------------------------------- single echoes
@pytest.mark.parametrize("shape", ["sin2", "gauss"])
@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("amplitude", [5.0, 5.01, 20.0, 1e4, 1e9])
def test_every_method_puts_a_single_echo_where_it_is(method: Method, shape: PulseShape, amplitude: float) -> None:
    detector = Detector(Pulse(16e-9, shape), 5.0, method)
    found = detect(one_beam((20.0, amplitude)), 1, detector)
    assert ranges(found) == pytest.approx([20.0], abs=1e-9)
    assert float(found.amplitude[0, 0]) == pytest.approx(amplitude, rel=1e-12)


@pytest.mark.parametrize("shape", ["sin2", "gauss"])
@pytest.mark.parametrize("method", METHODS)
def test_the_sampled_waveform_gives_the_same_as_the_closed_form(method: Method, shape: PulseShape) -> None:
    # two halves 2 mm apart are too wide for the shortcut at this resolution, and one echo for any method
    detector = Detector(Pulse(16e-9, shape), 5.0, method, resolution_m=1e-6)
    for shift in np.linspace(0.0, 0.15, 7):
        found = detect(one_beam((20.0 + shift - 1e-3, 25.0), (20.0 + shift + 1e-3, 25.0)), 1, detector)
        assert ranges(found) == pytest.approx([20.0 + shift], abs=2.5e-4)


@pytest.mark.parametrize("shape", ["sin2", "gauss"])
@pytest.mark.parametrize(("fraction", "delay_ns"), [(0.3, 4.0), (0.5, 4.0), (0.7, 12.0)])
def test_constant_fraction_takes_off_the_place_of_its_own_zero(
    shape: PulseShape, fraction: float, delay_ns: float
) -> None:
    detector = Detector(
        Pulse(16e-9, shape), 5.0, "constant_fraction", fraction=fraction, delay_s=delay_ns * 1e-9, resolution_m=1e-6
    )
    assert ranges(detect(one_beam((20.0, 40.0)), 1, detector)) == [20.0]
    assert ranges(detect(one_beam((19.999, 20.0), (20.001, 20.0)), 1, detector)) == pytest.approx([20.0], abs=5e-6)
    if (fraction, shape) == (0.3, "sin2"):
        assert abs(detector.cfd_lead_m) > 0.1
        zero_s = float(pulse.cfd_sin2(16e-9, 0.3, 4e-9))
        assert detector.cfd_lead_m == pytest.approx(0.5 * SPEED_OF_LIGHT_M_S * (zero_s - 16e-9))


def test_a_leading_edge_without_table_walks_by_the_closed_form() -> None:
    detector = Detector(PULSE, 5.0, walk_table=False)
    for ratio in (1.0, 10.0, 100.0):
        found = detect(one_beam((20.0, 5.0 * ratio)), 1, detector)
        # counted from the start of the pulse
        assert ranges(found) == pytest.approx([20.0 + float(pulse.walk_sin2(16e-9, ratio))], abs=1e-9)
    calibrated = Detector(PULSE, 5.0, walk_table=False, offset_m=float(pulse.walk_sin2(16e-9, 10.0)))
    assert ranges(detect(one_beam((20.0, 50.0)), 1, calibrated)) == pytest.approx([20.0], abs=1e-9)


def test_an_echo_just_below_the_threshold_is_none_and_one_at_it_is() -> None:
    detector = Detector(PULSE, 5.0)
    assert ranges(detect(one_beam((20.0, 4.999999)), 1, detector)) == []
    assert ranges(detect(one_beam((20.0, 5.0)), 1, detector)) == [20.0]
    assert math.isnan(detect(one_beam((20.0, 4.9)), 1, detector).amplitude[0, 0])


def test_beams_without_sub_echoes_and_scans_without_any_are_empty() -> None:
    empty = SubEchoes.of(np.zeros(0, np.int64), np.zeros(0), np.zeros(0))
    found = detect(empty, 5, Detector(PULSE, 5.0, max_echoes=2))
    assert found.range_m.shape == (5, 2)
    assert not np.any(np.isfinite(found.range_m))
    assert np.all(found.source == -1)
    some = SubEchoes.of(np.array([3]), np.array([7.0]), np.array([50.0]))
    assert detect(some, 5, Detector(PULSE, 5.0)).count.tolist() == [0, 0, 0, 1, 0]


# ------------------------------------------------------------------------------- mixed echoes
@pytest.mark.parametrize(
    ("separation_m", "ratio", "place"), [(1.0, 1.0, 0.5), (2.0, 1.0, 1.0), (2.0, 0.5, None), (3.0, 1.0, None)]
)
def test_a_post_and_a_wall_make_the_phantom_of_the_closed_form(
    separation_m: float, ratio: float, place: float | None
) -> None:
    detector = Detector(Pulse(16e-9, "gauss"), 5.0, "peak", bin_s=0.25e-9)
    found = ranges(detect(one_beam((20.0, 50.0), (20.0 + separation_m, 50.0 * ratio)), 1, detector))
    expected = pulse.two_echo_peak(16e-9, separation_m, ratio) if place is None else place
    assert found[0] - 20.0 == pytest.approx(expected, abs=2e-3)


def test_two_gaussian_echoes_part_at_sparrow_s_limit() -> None:
    limit = float(pulse.two_echo_limit_gauss(16e-9))
    detector = Detector(Pulse(16e-9, "gauss"), 5.0, "peak", keep="all", max_echoes=3, bin_s=0.25e-9)
    amplitude = 1e6  # the valley of one noise rms is then nothing
    near = detect(one_beam((20.0, amplitude), (20.0 + 0.98 * limit, amplitude)), 1, detector)
    far = detect(one_beam((20.0, amplitude), (20.0 + 1.1 * limit, amplitude)), 1, detector)
    assert (len(ranges(near)), len(ranges(far))) == (1, 2)


@pytest.mark.parametrize("method", METHODS)
def test_sin2_echoes_farther_apart_than_the_pulse_never_interact(method: Method) -> None:
    detector = Detector(PULSE, 5.0, method, keep="all", max_echoes=3)
    found = detect(one_beam((20.0, 50.0), (24.8, 30.0)), 1, detector)
    assert ranges(found) == pytest.approx([20.0, 24.8], abs=1e-9)
    close = detect(one_beam((20.0, 50.0), (24.0, 30.0)), 1, detector)
    assert ranges(close)[0] == pytest.approx(20.0, abs=0.15 if method == "centroid" else 5e-3)
    assert ranges(close)[1] == pytest.approx(24.0, abs=0.4)


def test_a_valley_of_less_than_the_noise_does_not_make_two_echoes() -> None:
    detector = Detector(PULSE, 5.0, keep="all", max_echoes=3)
    shallow = detect(one_beam((20.0, 20.0), (22.45, 20.0)), 1, detector)
    deep = detect(one_beam((20.0, 2000.0), (22.45, 2000.0)), 1, detector)
    assert (len(ranges(shallow)), len(ranges(deep))) == (1, 2)
    two_deep = detect(one_beam((20.0, 20.0), (22.55, 20.0)), 1, detector)  # a valley of 2.0 noise rms
    assert len(ranges(two_deep)) == 2


def test_energies_of_echoes_at_the_same_range_add() -> None:
    detector = Detector(PULSE, 5.0)
    three = detect(one_beam((20.0, 10.0), (20.0, 10.0), (20.0, 10.0)), 1, detector)
    single = detect(one_beam((20.0, 30.0)), 1, detector)
    assert three.range_m == pytest.approx(single.range_m, abs=1e-12)
    assert three.amplitude == pytest.approx(single.amplitude, rel=1e-15)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("shape", ["sin2", "gauss"])
def test_the_order_of_sub_beams_changes_nothing(method: Method, shape: PulseShape) -> None:
    rng = np.random.default_rng(5)
    r = 20.0 + rng.choice([0.0, 0.7, 3.0, 9.0], (12, 61)) + rng.uniform(0.0, 0.05, (12, 61))
    a = rng.uniform(0.1, 9.0, (12, 61))
    detector = Detector(Pulse(16e-9, shape), 5.0, method, keep="all", max_echoes=4)
    first = detect(SubEchoes.from_grid(r, a), 12, detector)
    order = np.stack([rng.permutation(61) for _ in range(12)])
    second = detect(SubEchoes.from_grid(np.take_along_axis(r, order, 1), np.take_along_axis(a, order, 1)), 12, detector)
    assert np.array_equal(np.isnan(first.range_m), np.isnan(second.range_m))
    assert np.nanmax(np.abs(first.range_m - second.range_m)) < 1e-9
    flat = rng.permutation(r.size)
    beam = np.repeat(np.arange(12), 61)
    third = detect(SubEchoes.of(beam[flat], r.ravel()[flat], a.ravel()[flat]), 12, detector)
    assert np.nanmax(np.abs(first.range_m - third.range_m)) < 1e-9


@given(seed=st.integers(0, 10**6))
@settings(max_examples=cases(40), deadline=None)
def test_joined_parts_are_as_if_all_had_come_together(seed: int) -> None:
    rng = np.random.default_rng(seed)
    parts = []
    for tag in range(int(rng.integers(2, 5))):
        n = int(rng.integers(0, 30))
        columns = rng.integers(0, 6, n), np.round(rng.uniform(-0.5, 9.0, n), 1), rng.uniform(0.1, 9.0, n), rng.random(n)
        parts.append(SubEchoes.of(*columns, np.full(n, tag)))
    found = SubEchoes.joined(*parts)
    wanted = SubEchoes.of(
        *(np.concatenate([getattr(one, name) for one in parts]) for name in
          ("beam", "range_m", "amplitude", "blocked", "source"))
    )  # fmt: skip
    for name in ("beam", "range_m", "amplitude", "blocked", "source"):
        np.testing.assert_array_equal(getattr(found, name), getattr(wanted, name), err_msg=name)


@given(seed=st.integers(0, 10**6))
@settings(max_examples=cases(40), deadline=None)
def test_what_beams_have_is_replaced_as_if_they_had_had_nothing(seed: int) -> None:
    rng = np.random.default_rng(seed)
    own, others = [], []
    for tag, part in enumerate((own, others)):
        n = int(rng.integers(0, 40))
        columns = rng.integers(0, 8, n), np.round(rng.uniform(0.0, 9.0, n), 1), rng.uniform(0.1, 9.0, n), rng.random(n)
        spread = rng.random(n) if rng.random() < 0.5 else None
        part.append(SubEchoes.of(*columns, np.full(n, tag), spread))
    beams = rng.random(8) < 0.5
    whole = own[0].replaced(beams, others[0].of_beams(beams))
    wanted = SubEchoes.joined(own[0].of_beams(~beams), others[0].of_beams(beams))
    for name in ("beam", "range_m", "amplitude", "blocked", "source"):
        np.testing.assert_array_equal(getattr(whole, name), getattr(wanted, name), err_msg=name)
    none = np.zeros(len(whole))
    np.testing.assert_array_equal(
        *(none if one.spread_m is None else one.spread_m for one in (whole, wanted)), err_msg="spread_m"
    )


def test_joined_planes_keep_their_spread_and_points_have_none() -> None:
    plane = SubEchoes.of(np.array([1]), np.array([5.0]), np.array([3.0]), spread_m=np.array([0.2]))
    point = SubEchoes.of(np.array([0, 2]), np.array([4.0, 6.0]), np.array([1.0, 1.0]))
    for joined in (SubEchoes.joined(plane, point), SubEchoes.joined(point, plane)):
        assert joined.spread_m is not None
        assert joined.spread_m.tolist() == [0.0, 0.2, 0.0]


def test_the_joined_cluster_keeps_energy_and_mean_range() -> None:
    rng = np.random.default_rng(2)
    r, a = 20.0 + rng.uniform(0.0, 0.5, 200), rng.uniform(0.0, 1.0, 200)
    joined = cluster(SubEchoes.of(np.zeros(200, np.int64), r, a), 4.8, 0.01)
    assert len(joined) == 1
    assert len(joined.range_m) < 200
    assert joined.amplitude.sum() == pytest.approx(a.sum(), rel=1e-13)
    assert np.sum(joined.amplitude * joined.range_m) == pytest.approx(np.sum(a * r), rel=1e-13)


def test_joined_sub_echoes_are_of_the_strongest_s_source() -> None:
    r = np.array([20.0, 20.0001, 20.0002, 20.5, 20.5001, 30.0])
    a = np.array([1.0, 4.0, 3.0, 2.0, 2.0, 1.0])
    joined = cluster(SubEchoes.of(np.zeros(6, np.int64), r, a, None, np.array([7, 8, 9, 5, 6, 3])), 4.8, 0.01)
    assert joined.source.tolist() == [8, 5, 3]  # of equals the first


@pytest.mark.parametrize("sampled", [False, True])
def test_an_echo_of_several_sources_is_of_the_one_that_stands_highest_under_it(sampled: bool) -> None:
    echoes = SubEchoes.of(
        np.array([0, 0, 0, 1, 1]), np.array([20.0, 20.3, 20.4, 20.0, 20.2]), np.array([20.0, 90.0, 30.0, 50.0, 40.0]),
        None, np.array([1, 2, 3, 4, 4]),
    )  # fmt: skip
    found = detect(echoes, 2, Detector(PULSE, 5.0, sampled=sampled))
    assert found.source[:, 0].tolist() == [2, 4]


def test_joining_sub_echoes_within_a_quarter_of_the_resolution_moves_nothing() -> None:
    rng = np.random.default_rng(6)
    r = 20.0 + rng.choice([0.0, 1.5], (40, 61)) + rng.uniform(0.0, 0.2, (40, 61))
    a = rng.uniform(0.1, 3.0, (40, 61))
    coarse = detect(SubEchoes.from_grid(r, a), 40, Detector(PULSE, 5.0, resolution_m=0.01))
    fine = detect(SubEchoes.from_grid(r, a), 40, Detector(PULSE, 5.0, resolution_m=0.0))
    assert np.max(np.abs(coarse.range_m - fine.range_m)) < 1e-4


def test_a_beam_cut_by_an_edge_gives_the_energies_of_the_closed_form() -> None:
    nodes = beams.spiral(4096)
    near = nodes.u < 0.25
    amplitude = nodes.share * np.where(near, 1.0 / 20.0**2, 1.0 / 40.0**2) * 1e6
    grid = np.where(near, 20.0, 40.0)[None, :]
    found = detect(SubEchoes.from_grid(grid, amplitude[None, :]), 1, Detector(PULSE, 5.0, keep="all", max_echoes=2))
    assert ranges(found) == pytest.approx([20.0, 40.0], abs=1e-9)
    ratio = float(found.amplitude[0, 1] / found.amplitude[0, 0])
    exact = float(radiometry.edge_energy_ratio(0.25, 1.0, 0.5, 20.0, 0.5, 40.0))
    assert ratio == pytest.approx(exact, rel=5e-3)


def test_the_source_of_an_echo_is_what_it_is_mostly_made_of() -> None:
    r = np.array([20.0, 20.001, 30.0, 30.5, 31.0])
    a = np.array([5.0, 50.0, 10.0, 40.0, 10.0])
    echoes = SubEchoes.of(np.zeros(5, np.int64), r, a, source=np.array([4, 7, 1, 2, 3]))
    found = detect(echoes, 1, Detector(PULSE, 5.0, keep="all", max_echoes=3))
    assert found.source[0].tolist() == [7, 2, -1]


# ------------------------------------------------------------------------------- sampling
@pytest.mark.parametrize(("bin_ns", "limit_m"), [(0.5, 2e-4), (1.0, 2e-4), (2.0, 8e-4), (4.0, 7e-3)])
def test_the_peak_of_a_sampled_pulse_is_as_exact_as_tabled(bin_ns: float, limit_m: float) -> None:
    detector = Detector(PULSE, 5.0, "peak", bin_s=bin_ns * 1e-9, resolution_m=1e-9)
    worst = 0.0
    for phase in np.linspace(0.0, 0.5 * SPEED_OF_LIGHT_M_S * bin_ns * 1e-9, 23):
        r = 20.0 + phase
        found = ranges(detect(one_beam((r - 1e-8, 50.0), (r + 1e-8, 50.0)), 1, detector))
        worst = max(worst, abs(found[0] - r))
    assert worst <= limit_m


@pytest.mark.parametrize("bin_ns", [0.5, 1.0, 4.0])
@pytest.mark.parametrize("ratio", [1.5, 10.0, 1e3, 1e7])
def test_the_leading_edge_does_not_depend_on_the_bins(bin_ns: float, ratio: float) -> None:
    detector = Detector(PULSE, 5.0, walk_table=False, bin_s=bin_ns * 1e-9, resolution_m=1e-9)
    for phase in (0.0, 0.03, 0.1):
        r = 20.0 + phase
        found = ranges(detect(one_beam((r - 1e-8, 2.5 * ratio), (r + 1e-8, 2.5 * ratio)), 1, detector))
        assert found == pytest.approx([r + float(pulse.walk_sin2(16e-9, ratio))], abs=1e-8)


def test_a_short_pulse_in_a_long_gate_costs_no_memory() -> None:
    import tracemalloc

    detector = Detector(Pulse(0.1e-9), 5.0, keep="all", max_echoes=8, resolution_m=1e-4)
    echoes = one_beam((1.0, 50.0), (1.01, 30.0), (120.0, 40.0), (249.0, 30.0), (249.008, 30.0))
    detect(echoes, 1, detector)
    tracemalloc.start()
    found = detect(echoes, 1, detector)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert len(ranges(found)) == 3  # the pairs are closer than the pulse
    assert peak < 1_000_000


def test_a_pulse_of_a_microsecond_finds_its_single_echo() -> None:
    found = detect(one_beam((100.0, 50.0), (101.0, 50.0)), 1, Detector(Pulse(1e-6), 5.0, keep="all", max_echoes=3))
    assert ranges(found) == pytest.approx([100.5], abs=0.05)


# ------------------------------------------------------------------------------- tilted planes
@pytest.mark.parametrize("tilt_deg", [0.0, 40.0, 70.0, 80.0])
def test_a_plane_in_closed_form_is_measured_as_its_bundle(tilt_deg: float) -> None:
    half, tilt, distance = 6.4565e-3, math.radians(tilt_deg), 20.0
    nodes = beams.spiral(20_000)
    u = nodes.u * math.tan(half)
    v = nodes.v * math.tan(half)
    cosine = np.sqrt(1.0 + u * u + v * v)
    r = distance * cosine / (1.0 - math.tan(tilt) * u)
    incidence = (1.0 - math.tan(tilt) * u) / cosine  # over cos(tilt)
    amplitude = 200.0 * nodes.share * incidence * (distance / r) ** 2
    full = SubEchoes.from_grid(r[None, :], amplitude[None, :])
    energy, mean, spread = tilted.tilted_plane_expansion(half, math.tan(tilt))
    flat = SubEchoes.of(
        np.zeros(1, np.int64),
        np.atleast_1d(distance * mean),
        np.atleast_1d(200.0 * energy),
        spread_m=np.atleast_1d(distance * spread),
    )
    for method in METHODS:
        detector = Detector(Pulse(4e-9), 5.0, method, resolution_m=0.01)
        a, b = detect(full, 1, detector), detect(flat, 1, detector)
        assert float(a.range_m[0, 0]) == pytest.approx(float(b.range_m[0, 0]), abs=1e-2)
        assert float(a.amplitude[0, 0]) == pytest.approx(float(b.amplitude[0, 0]), rel=5e-3)


@pytest.mark.parametrize(("tilt_deg", "half"), [(0.0, 6.1e-4), (60.0, 6.4565e-3), (85.0, 6.4565e-3)])
def test_the_expansion_of_the_tilted_plane_is_as_exact_as_stated(tilt_deg: float, half: float) -> None:
    tilt = math.radians(tilt_deg)
    energy, mean, spread = tilted.tilted_plane_moments(half, tilt)
    approx = tilted.tilted_plane_expansion(half, math.tan(tilt))
    tight = half < 1e-3
    assert float(approx[0]) == pytest.approx(float(energy), rel=2e-11 if tight else 4e-7)
    assert float(approx[1]) == pytest.approx(float(mean), rel=2e-11 if tight else 4e-7)
    if tilt_deg > 0.0:
        assert float(approx[2]) == pytest.approx(float(spread), rel=6e-3)


def test_the_peak_of_a_spread_echo_falls_by_the_closed_form() -> None:
    for shape, law in (("sin2", pulse.stretch_peak_sin2), ("gauss", pulse.stretch_peak_gauss)):
        for sigma in (0.02, 0.3, 1.2):
            flat = SubEchoes.of(np.zeros(1, np.int64), np.array([3e3]), np.array([1e4]), spread_m=np.array([sigma]))
            found = detect(flat, 1, Detector(Pulse(16e-9, shape), 5.0, "peak"))  # type: ignore[arg-type]
            assert float(found.amplitude[0, 0]) == pytest.approx(1e4 * float(law(16e-9, sigma)), rel=2e-3)
            assert ranges(found) == pytest.approx([3e3], abs=2e-3)  # far off, the echo is not skew


# ------------------------------------------------------------------------------- light outside
@settings(max_examples=cases(60), derandomize=True, deadline=None)
@given(
    method=st.sampled_from(METHODS),
    rms=st.lists(st.floats(1.0, 30.0), min_size=1, max_size=4),
    seed=st.integers(0, 2**32 - 1),
    shot=st.sampled_from([0.0, 0.4]),
    scale=st.sampled_from([0.0, 3e3, 3e5]),
)
def test_a_threshold_that_follows_the_noise_is_all_light_over_that_noise(
    method: Method, rms: list[float], seed: int, shot: float, scale: float
) -> None:
    """Twice the noise is half of everything else: surfaces, medium, clipping, floor and shot noise.

    Of a medium, what is under a thousandth of the nominal noise is left out: up to 0.2 mm on the slope of an echo, more
    where the top is flat or a whole pulse is weighed.
    """
    exact = 2e-3 if scale else 2e-6
    rng = np.random.default_rng(seed)
    n, m = len(rms), 9
    r = np.sort(10.0 + rng.choice([1.0, 8.0, 40.0]) * rng.random((n, m)), axis=1)
    a = 10.0 ** rng.uniform(-1.0, 3.0, (n, m))
    normals = rng.standard_normal((n, 4))
    made = SubEchoes.from_grid(r, a, np.full((n, m), 1.0 / m))

    def fog(size: float) -> SoftProfile | None:
        step = 0.5 * SPEED_OF_LIGHT_M_S * 1e-9
        return SoftProfile.of_medium(PULSE, step, size, 0.02, 1e-3, 0.5, 3.0, 80.0) if size else None

    def detector(over: float, *, follows: bool) -> Detector:
        return Detector(
            PULSE, 5.0, method, keep="all", max_echoes=4, bin_s=1e-9, full_scale=800.0 / over,
            shot_factor=shot / over, floor_m2=90.0 / over, follows_noise=follows,
        )  # fmt: skip

    found = detect(made, n, detector(1.0, follows=True), normals=normals, noise=np.array(rms), soft=fog(scale))
    for beam, over in enumerate(rms):
        own = SubEchoes.from_grid(r[beam : beam + 1], a[beam : beam + 1] / over, np.full((1, m), 1.0 / m))
        alone = detect(own, 1, detector(over, follows=False), normals=normals[beam : beam + 1], soft=fog(scale / over))
        assert found.range_m[beam] == pytest.approx(alone.range_m[0], abs=exact, nan_ok=True)
        assert found.amplitude[beam] == pytest.approx(over * alone.amplitude[0], rel=exact, nan_ok=True)
        assert found.saturated[beam].tolist() == alone.saturated[0].tolist()


# ------------------------------------------------------------------------------- saturation, recovery, gates
@pytest.mark.parametrize("method", METHODS)
def test_a_huge_echo_is_clipped_marked_and_keeps_its_range(method: Method) -> None:
    detector = Detector(PULSE, 5.0, method, full_scale=1e6, walk_table=False)
    found = detect(one_beam((20.0, 1e9)), 1, detector)
    assert bool(found.saturated[0, 0])
    assert float(found.amplitude[0, 0]) == 1e6
    expected = 20.0 + (float(pulse.walk_sin2(16e-9, 2e8)) if method == "leading_edge" else 0.0)
    # the constant fraction of a clipped pulse is a leading edge at the fraction of full scale
    limit = 2.5 if method == "constant_fraction" else 2e-2
    assert ranges(found) == pytest.approx([expected], abs=limit)
    assert not bool(detect(one_beam((20.0, 1e5)), 1, detector).saturated[0, 0])


def test_the_middle_of_the_clipped_run_is_the_place_of_a_mixed_saturated_echo() -> None:
    detector = Detector(PULSE, 5.0, "peak", full_scale=100.0)
    found = detect(one_beam((20.0, 1e4), (20.2, 1e4)), 1, detector)
    assert bool(found.saturated[0, 0])
    assert ranges(found) == pytest.approx([20.1], abs=0.01)


def test_a_clipped_echo_blinds_the_receiver_while_it_recovers() -> None:
    echoes = SubEchoes.of(
        np.array([0, 0, 0, 1, 1]), np.array([5.0, 12.0, 30.0, 5.0, 12.0]), np.array([1e5, 50.0, 50.0, 50.0, 50.0])
    )
    detector = Detector(PULSE, 5.0, keep="all", max_echoes=3, full_scale=1e3, recovery_s=100e-9)  # 15 m
    found = detect(echoes, 2, detector)
    assert found.range_m[0, :2] == pytest.approx([5.0, 30.0], abs=0.2)
    assert found.range_m[1, :2] == pytest.approx([5.0, 12.0], abs=1e-9)
    assert found.count.tolist() == [2, 2]


def test_gates_and_the_fog_correction_drop_echoes() -> None:
    echoes = one_beam((0.5, 1e3), (10.0, 50.0), (90.0, 60.0))
    everything = Detector(PULSE, 5.0, keep="all", max_echoes=3)
    gated = Detector(PULSE, 5.0, keep="all", max_echoes=3, near_gate_m=1.0, far_gate_m=80.0)
    corrected = Detector(PULSE, 5.0, keep="all", max_echoes=3, floor_m2=6000.0)  # 60 at 10 m
    assert len(ranges(detect(echoes, 1, everything))) == 3
    assert ranges(detect(echoes, 1, gated)) == pytest.approx([10.0])
    assert ranges(detect(echoes, 1, corrected)) == pytest.approx([90.0])


@pytest.mark.parametrize(
    ("keep", "count", "expected"),
    [
        ("first", 1, [10.0]),
        ("first", 2, [10.0, 20.0]),
        ("last", 1, [40.0]),
        ("last", 2, [30.0, 40.0]),
        ("strongest", 1, [30.0]),
        ("strongest", 2, [20.0, 30.0]),
        ("all", 4, [10.0, 20.0, 30.0, 40.0]),
        ("all", 6, [10.0, 20.0, 30.0, 40.0]),
    ],
)
def test_first_strongest_last_or_all_echoes_are_kept_nearest_first(
    keep: str, count: int, expected: list[float]
) -> None:
    echoes = one_beam((10.0, 20.0), (20.0, 50.0), (30.0, 90.0), (40.0, 10.0))
    detector = Detector(PULSE, 5.0, keep=keep, max_echoes=count)  # type: ignore[arg-type]
    assert ranges(detect(echoes, 1, detector)) == pytest.approx(expected, abs=1e-9)


def test_a_dazzled_beam_reports_nothing_and_the_others_do() -> None:
    echoes = SubEchoes.of(np.array([0, 1]), np.array([10.0, 10.0]), np.array([50.0, 50.0]))
    found = detect(echoes, 2, Detector(PULSE, 5.0), dazzled=np.array([True, False]))
    assert found.count.tolist() == [0, 1]


def test_noise_echoes_take_part_in_the_choice() -> None:
    echoes = one_beam((10.0, 20.0))
    false = (np.array([0, 1]), np.array([4.0, 6.0]), np.array([5.2, 5.3]))
    found = detect(echoes, 2, Detector(PULSE, 5.0), noise_echoes=false)
    assert found.range_m[:, 0] == pytest.approx([4.0, 6.0])
    assert np.all(found.source == -1)
    strongest = detect(echoes, 2, Detector(PULSE, 5.0, keep="strongest"), noise_echoes=false)
    assert strongest.range_m[:, 0] == pytest.approx([10.0, 6.0])


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"threshold": 0.0}, "threshold: 0.0; want a number > 0"),
        ({"threshold": math.nan}, "threshold"),
        ({"method": "edge"}, "want leading_edge, constant_fraction, peak or centroid"),
        ({"keep": "best"}, "want first, strongest, last or all"),
        ({"max_echoes": 0}, "at least 1"),
        ({"full_scale": 4.0}, "more than the threshold"),
        ({"fraction": 1.0}, "between 0 and 1"),
        ({"delay_s": 1.0}, "delay_s"),
    ],
)
def test_a_detector_that_cannot_be_is_refused(change: dict[str, object], text: str) -> None:
    with pytest.raises(ValueError, match=text):
        Detector(PULSE, **{"threshold": 5.0, **change})  # type: ignore[arg-type]


# ------------------------------------------------------------------------------- noise
def many(amplitude: float, count: int, **settings_: object) -> tuple[Echoes, Floats]:
    rng = np.random.default_rng(11)
    echoes = SubEchoes.of(np.arange(count), np.full(count, 30.0), np.full(count, amplitude))
    detector = Detector(PULSE, 5.0, **settings_)  # type: ignore[arg-type]
    return detect(echoes, count, detector, normals=rng.normal(size=(count, 4))), np.arange(count)


@pytest.mark.parametrize("snr", [3.0, 4.5, 5.0, 5.5, 7.0])
def test_an_echo_is_seen_with_the_probability_of_the_normal_law(snr: float) -> None:
    count = 40_000
    seen = float(np.mean(many(snr, count)[0].count))
    exact = float(noise.detection_probability(5.0, snr))
    assert seen == pytest.approx(exact, abs=4.0 * math.sqrt(exact * (1.0 - exact) / count) + 1e-4)


def test_a_mixed_echo_is_seen_with_the_probability_of_its_height() -> None:
    rng = np.random.default_rng(11)
    count = 20_000
    beam = np.repeat(np.arange(count), 2)
    echoes = SubEchoes.of(beam, np.tile([30.0, 30.4], count), np.full(2 * count, 2.75))
    found = detect(echoes, count, Detector(PULSE, 5.0), normals=rng.normal(size=(count, 1)))
    height = 5.5 * math.cos(0.5 * math.pi * 0.2 / PULSE.fwhm_m) ** 2
    exact = float(noise.detection_probability(5.0, height))
    assert float(np.mean(found.count)) == pytest.approx(exact, abs=0.015)


@pytest.mark.parametrize("snr", [20.0, 100.0])
def test_the_range_of_a_leading_edge_scatters_by_the_slope_of_the_edge(snr: float) -> None:
    found = many(snr, 20_000)[0].range_m[:, 0]
    expected = float(pulse.edge_range_sigma_sin2(16e-9, 5.0, snr))
    assert float(np.nanstd(found)) == pytest.approx(expected, rel=0.05)
    assert float(np.nanmean(found)) == pytest.approx(30.0, abs=0.05)


@pytest.mark.parametrize("method", ["peak", "centroid", "constant_fraction"])
def test_the_other_methods_scatter_by_their_bound(method: Method) -> None:
    found = many(50.0, 20_000, method=method)[0].range_m[:, 0]
    expected = float(Detector(PULSE, 5.0, method).sigma_m(50.0))
    bound = float(pulse.crlb_sin2(16e-9, 50.0, 31.25e6))
    assert float(np.nanstd(found)) == pytest.approx(expected, rel=0.05)
    assert expected >= 0.999 * bound
    if method == "peak":
        assert expected == pytest.approx(bound, rel=1e-9)


def test_ranges_stay_within_the_pulse_at_the_threshold_where_the_formula_has_its_pole() -> None:
    found = many(5.0, 20_000)[0].range_m[:, 0]
    assert np.nanmax(np.abs(found - 30.0)) <= PULSE.fwhm_m


def test_shot_noise_of_the_signal_and_the_sun_widen_the_scatter() -> None:
    calm = np.nanstd(many(100.0, 5000)[0].range_m)
    shot = np.nanstd(many(100.0, 5000, shot_factor=0.6)[0].range_m)  # at the crossing 1 + 0.6 * 5
    assert shot / calm == pytest.approx(2.0, rel=0.1)  # the edge is not straight over two noise rms
    tall = np.nanstd(many(1000.0, 5000, shot_factor=0.6)[0].range_m)
    assert tall / np.nanstd(many(1000.0, 5000)[0].range_m) == pytest.approx(2.0, rel=0.1)  # not of the peak behind it
    rng = np.random.default_rng(11)
    echoes = SubEchoes.of(np.arange(5000), np.full(5000, 30.0), np.full(5000, 100.0))
    sun = detect(echoes, 5000, Detector(PULSE, 5.0), normals=rng.normal(size=(5000, 4)), noise=2.0)
    assert np.nanstd(sun.range_m) / calm == pytest.approx(2.0, rel=0.1)


def test_noise_of_one_beam_does_not_depend_on_the_others() -> None:
    normals = np.random.default_rng(3).normal(size=(4, 2))
    echoes = SubEchoes.of(np.array([0, 1, 2, 3]), np.full(4, 30.0), np.full(4, 8.0))
    everything = detect(echoes, 4, Detector(PULSE, 5.0), normals=normals)
    alone = SubEchoes.of(np.array([2]), np.full(1, 30.0), np.full(1, 8.0))
    assert detect(alone, 4, Detector(PULSE, 5.0), normals=normals).range_m[2, 0] == everything.range_m[2, 0]


def test_a_scan_without_noise_is_the_same_twice_to_the_last_bit() -> None:
    rng = np.random.default_rng(8)
    echoes = SubEchoes.from_grid(20.0 + rng.uniform(0.0, 9.0, (30, 61)), rng.uniform(0.0, 3.0, (30, 61)))
    detector = Detector(PULSE, 5.0, keep="all", max_echoes=4)
    first, second = detect(echoes, 30, detector), detect(echoes, 30, detector)
    assert first.range_m.tobytes() == second.range_m.tobytes()


# ------------------------------------------------------------------------------- any input
amplitudes = st.floats(1e-6, 1e9)
distances = st.floats(0.0, 300.0)


@settings(deadline=None, max_examples=cases(80))
@given(
    st.lists(st.tuples(st.integers(0, 4), distances, amplitudes), max_size=40),
    st.sampled_from(METHODS),
    st.sampled_from(["sin2", "gauss"]),
    st.sampled_from([0.5e-9, 4e-9, 16e-9]),
    st.booleans(),
)
def test_any_sub_echoes_give_finite_sorted_echoes_over_the_threshold(
    entries: list[tuple[int, float, float]], method: Method, shape: PulseShape, fwhm_s: float, clip: bool
) -> None:
    beam = np.array([e[0] for e in entries], np.int64)
    r = np.array([e[1] for e in entries], np.float64)
    a = np.array([e[2] for e in entries], np.float64)
    detector = Detector(
        Pulse(fwhm_s, shape), 5.0, method, keep="all", max_echoes=40, full_scale=1e4 if clip else math.inf
    )
    normals = np.random.default_rng(1).normal(size=(5, 4))
    for drawn in (None, normals):
        found = detect(SubEchoes.of(beam, r, a), 5, detector, normals=drawn)
        some = np.isfinite(found.range_m)
        assert np.array_equal(some, np.isfinite(found.amplitude))
        assert np.all(found.amplitude[some] >= 5.0)
        assert np.all(found.range_m[some] >= 0.0)
        assert np.all(np.diff(np.where(some, found.range_m, 1e9), axis=1) >= 0.0)
        # energy is never created: no echo is higher than all that a beam got
        total = np.bincount(beam, a, 5)
        reach = 5.0 if drawn is None else 12.0
        assert np.all(np.where(some, found.amplitude, 0.0) <= total[:, None] * (1.0 + 1e-9) + reach)
        if drawn is None:
            strong = np.zeros(5, np.bool_)
            strong[beam[a >= 5.0]] = True
            assert np.all(found.count[strong] >= 1)
            assert np.all(found.count[total < 5.0 * (1.0 - 1e-12)] == 0)
