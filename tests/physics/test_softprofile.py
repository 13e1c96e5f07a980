"""Fog in a whole scan: the tables against the closed form, partly blocked beams, what the receiver then reports."""

from __future__ import annotations

import math
import sys
from dataclasses import replace

import numpy as np
import pytest

from emulator.physics import atmosphere, cosines, softtarget
from emulator.physics.arrays import Floats, Values
from emulator.physics.detection import detect
from emulator.physics.detector import Detector
from emulator.physics.ownecho import OwnEchoes
from emulator.physics.pulse import Pulse
from emulator.physics.softprofile import MARK, SoftProfile
from emulator.physics.subechoes import SubEchoes, cluster
from emulator.physics.waveform import Waveform, sample

PULSE = Pulse(16e-9)
DETECTOR = Detector(PULSE, 5.0, keep="all", max_echoes=4)
NEP = 6.6666666666666667e-8
OPTICS = (16e-9, 1.6e-6, math.pi * 1e-4, 0.5)


def alpha_of(visibility_m: float) -> float:
    return float(atmosphere.fog_kim(visibility_m, 905e-9))


def profile_of(visibility_m: float, pulse: Pulse = PULSE) -> SoftProfile:
    """Reference receiver, overlap from 0.9 to 1.0 m."""
    alpha = alpha_of(visibility_m)
    bin_m = Detector(pulse, 5.0).bin_m
    made = SoftProfile.of_medium(pulse, bin_m, math.pi * 75_000.0, alpha, alpha / 18.8, 0.9, 1.0, 250.0)
    assert made is not None
    return made


def closed(x_centre: Floats, visibility_m: float, end_m: float) -> Floats:
    power = softtarget.fog_return(x_centre + PULSE.fwhm_m, alpha_of(visibility_m), 18.8, 0.9, 1.0, end_m, *OPTICS)
    return power / NEP


def wall(visibility_m: float, range_m: float, rho: float, share: float) -> SubEchoes:
    amplitude = 75_000.0 * rho * share / range_m**2 * math.exp(-2.0 * alpha_of(visibility_m) * range_m)
    return SubEchoes.of(
        np.zeros(1, np.int64), np.array([range_m]), np.array([amplitude]), np.array([share]), np.array([3])
    )


def sampled(echoes: SubEchoes, soft: SoftProfile) -> tuple[Waveform, Floats]:
    mark = SubEchoes.of(np.zeros(2, np.int64), np.array([0.9, soft.peak_m]), np.full(2, MARK))
    clusters = cluster(SubEchoes.joined(echoes, mark), 2.0 * PULSE.half_support_m, 0.01)
    before = np.cumsum(clusters.blocked) - clusters.blocked
    wave = sample(clusters, np.ones(len(clusters), np.bool_), PULSE, soft.bin_m, soft, 1.0 - before[clusters.first])
    return wave, wave.position(np.arange(wave.value.size), wave.window)


@pytest.mark.parametrize("visibility_m", [10.0, 40.0, 400.0, 1000.0])
def test_the_table_of_a_free_beam_is_the_closed_form_to_1e_10(visibility_m: float) -> None:
    soft = profile_of(visibility_m)
    x = soft.bin_m * np.arange(soft.first, soft.first + soft.free.size)
    exact = closed(x, visibility_m, 250.0)
    kept = (x < soft.end_m - PULSE.fwhm_m) & (exact > 1e-5 * exact.max())
    assert np.max(np.abs(soft.free[kept] / exact[kept] - 1.0)) < 1e-10
    assert np.max(np.abs(soft.free - exact)) < 1e-3  # noise units: behind the end nothing visible is left out
    assert soft.peak == pytest.approx(float(exact.max()), rel=1e-9)


@pytest.mark.parametrize("range_m", [1.5, 3.0, 10.0, 14.0])
@pytest.mark.parametrize("visibility_m", [40.0, 400.0])
def test_fog_in_front_of_a_wall_is_the_closed_form(visibility_m: float, range_m: float) -> None:
    soft = profile_of(visibility_m)
    wave, x = sampled(wall(visibility_m, range_m, 0.1, 1.0), soft)
    exact = softtarget.fog_plus_wall(x + PULSE.fwhm_m, alpha_of(visibility_m), 18.8, 0.9, 1.0, range_m, 0.1, *OPTICS)
    assert np.max(np.abs(wave.value - exact / NEP)) < 1e-6 * float(exact.max() / NEP)


def test_a_half_blocked_beam_lights_half_of_the_fog_behind() -> None:
    soft = profile_of(40.0)
    wave, x = sampled(wall(40.0, 6.0, 0.1, 0.5), soft)
    exact = 0.5 * closed(x, 40.0, 6.0) + 0.5 * closed(x, 40.0, 250.0)
    surface = 0.5 * 75_000.0 * 0.1 / 36.0 * math.exp(-12.0 * alpha_of(40.0)) * PULSE.profile(x - 6.0)
    assert np.max(np.abs(wave.value - exact - surface)) < 1e-7 * float(exact.max())


def test_fog_between_two_clusters_of_a_beam_is_shared_as_they_block() -> None:
    soft = profile_of(40.0)
    near, far = wall(40.0, 3.0, 0.1, 0.25), wall(40.0, 16.0, 0.9, 0.5)
    wave, x = sampled(SubEchoes.joined(near, far), soft)
    exact = 0.25 * closed(x, 40.0, 3.0) + 0.5 * closed(x, 40.0, 16.0) + 0.25 * closed(x, 40.0, 250.0)
    assert np.max(np.abs(wave.soft - exact)) < 1e-7 * float(exact.max())


@pytest.mark.parametrize("shape", ["sin2", "gauss"])
def test_first_echo_sensors_report_the_fog_and_last_echo_sensors_the_wall(shape: str) -> None:
    pulse = Pulse(16e-9, shape)  # type: ignore[arg-type]
    soft = profile_of(200.0, pulse)
    echoes = wall(200.0, 15.0, 0.5, 1.0)
    first = detect(echoes, 1, Detector(pulse, 5.0, keep="first"), soft=soft)
    last = detect(echoes, 1, Detector(pulse, 5.0, keep="last"), soft=soft)
    gated = detect(echoes, 1, Detector(pulse, 5.0, keep="first", near_gate_m=5.0), soft=soft)
    assert float(first.range_m[0, 0]) < 2.0
    assert int(first.source[0, 0]) == -1
    assert float(last.range_m[0, 0]) == pytest.approx(15.0, abs=0.6)  # the pedestal of fog pulls the edge
    assert int(last.source[0, 0]) == 3
    assert float(gated.range_m[0, 0]) == float(last.range_m[0, 0])


def test_the_fog_echo_is_the_same_in_every_free_beam_and_in_one_of_many() -> None:
    soft = profile_of(200.0)
    nothing = SubEchoes.of(np.zeros(0, np.int64), np.zeros(0), np.zeros(0))
    alone = detect(nothing, 1, DETECTOR, soft=soft)
    many = detect(nothing, 7, DETECTOR, soft=soft)
    assert np.all(many.range_m[:, 0] == alone.range_m[0, 0])
    assert float(alone.amplitude[0, 0]) == pytest.approx(soft.peak, rel=1e-3)


def test_a_wall_nearer_than_the_overlap_hides_all_fog() -> None:
    soft = profile_of(40.0)
    found = detect(wall(40.0, 0.5, 0.5, 1.0), 1, DETECTOR, soft=soft)
    assert found.count.tolist() == [1]
    assert float(found.range_m[0, 0]) == pytest.approx(0.5, abs=1e-6)


def test_clear_air_has_no_profile_and_a_start_at_zero_is_refused() -> None:
    alpha = alpha_of(1e6)
    assert SoftProfile.of_medium(PULSE, 0.15, math.pi * 10.0, alpha, alpha / 70.0, 0.9, 1.0, 250.0) is None
    assert SoftProfile.of_medium(PULSE, 0.15, math.pi * 10.0, alpha, 0.0, 0.9, 1.0, 250.0) is None
    with pytest.raises(ValueError, match="start_m"):
        SoftProfile.of_medium(PULSE, 0.15, 1e5, alpha, alpha / 18.8, 0.0, 1.0, 250.0)


def test_fog_of_a_gaussian_pulse_is_its_convolution() -> None:
    pulse = Pulse(16e-9, "gauss")
    soft = profile_of(200.0, pulse)
    r = np.linspace(0.9, 60.0, 400_001)
    density = math.pi * 75_000.0 * alpha_of(200.0) / 18.8 * np.clip((r - 0.9) / 0.1, 0.0, 1.0) / r**2
    density = density * np.exp(-2.0 * alpha_of(200.0) * r)
    for x in (0.5, soft.peak_m, 4.0, 9.0):
        exact = float(np.trapezoid(density * pulse.profile(x - r), r))
        assert float(soft.wave(x)) == pytest.approx(exact, rel=3e-3)
    node, piece = soft.nodes()
    exact = float(np.trapezoid(density * pulse.profile(3.0 - r), r))
    assert float(np.sum(piece * pulse.profile(3.0 - node))) == pytest.approx(exact, rel=3e-3)


# ------------------------------------------------------------------------------- its own echo, and faint under others
@pytest.mark.parametrize("floor_noise", [1.0, 3.0])
@pytest.mark.parametrize("size", [2e2, 2e3, 2e4])
def test_a_medium_beside_short_clusters_is_as_if_all_were_sampled(size: float, floor_noise: float) -> None:
    """Beams with nothing, with surfaces behind the medium's echo, at its edge, in it, and spread ones."""
    pulse = Pulse(4e-9)
    soft = SoftProfile.of_medium(pulse, pulse.fwhm_m / 16.0, size, 0.01, 1e-3, 0.3, 1.0, 80.0)
    assert soft is not None
    rng = np.random.default_rng(7)
    beams, members = 60, 8
    start = np.linspace(0.5, 40.0, beams)[:, None]
    spread = np.where(np.arange(beams) % 3 == 0, 3.0, 0.3)[:, None]
    range_m = np.sort(start + spread * rng.random((beams, members)), axis=1)
    amplitude = 10.0 ** rng.uniform(0.0, 2.5, (beams, 1)) * rng.random((beams, members))
    amplitude[::7] = 0.0
    echoes = SubEchoes.from_grid(range_m, amplitude, np.full((beams, members), 0.9 / members) * (amplitude > 0.0))
    normals = rng.standard_normal((beams, 4))
    closed, sampled = (
        detect(
            echoes, beams,
            Detector(pulse, 5.0, keep="all", max_echoes=4, resolution_m=1e-3, sampled=every, follows_noise=True),
            normals=normals, noise=floor_noise, soft=soft,
        )
        for every in (False, True)
    )  # fmt: skip
    assert int(closed.count.sum()) > beams / 2
    np.testing.assert_array_equal(closed.count, sampled.count)
    np.testing.assert_allclose(closed.range_m, sampled.range_m, rtol=0.0, atol=1e-3)
    np.testing.assert_allclose(closed.amplitude, sampled.amplitude, rtol=2e-3, atol=1e-2)


@pytest.mark.parametrize("stopped", [0.0, 0.4])
def test_a_surface_behind_what_is_sampled_is_as_if_it_were_sampled_too(stopped: float) -> None:
    """Drops in the echo of the medium, or a twig that stops some of the light, and a wall far behind them."""
    pulse, beams = Pulse(4e-9), 40
    soft = SoftProfile.of_medium(pulse, pulse.fwhm_m / 16.0, 2e3, 0.01, 1e-3, 0.3, 1.0, 80.0)
    assert soft is not None
    rng = np.random.default_rng(11)
    near, far = np.linspace(0.4, 2.0, beams), np.linspace(14.0, 60.0, beams)
    range_m = np.stack([near, near + 0.2, far, far + 0.05], axis=1)
    amplitude = np.stack([*(10.0 ** rng.uniform(-0.5, 2.0, (2, beams))), *np.full((2, beams), 12.0)], axis=1)
    share = np.tile([stopped, 0.0, 0.3, 0.3], (beams, 1))
    echoes = SubEchoes.from_grid(range_m, amplitude, share)
    detector = Detector(pulse, 5.0, keep="all", max_echoes=4, resolution_m=1e-3, follows_noise=True)
    found, rest = cosines.split_cosines(echoes, detector, soft)
    behind = np.bincount(found.beam, minlength=beams) == 1
    assert np.count_nonzero(behind & (np.bincount(rest.beam, minlength=beams) == 2)) > 25
    normals = rng.standard_normal((beams, 4))
    closed, sampled = (
        detect(echoes, beams, replace(detector, sampled=every), normals=normals, soft=soft) for every in (False, True)
    )
    np.testing.assert_array_equal(closed.count, sampled.count)
    np.testing.assert_allclose(closed.range_m, sampled.range_m, rtol=0.0, atol=1e-4)
    np.testing.assert_allclose(closed.amplitude, sampled.amplitude, rtol=2e-4, atol=1e-3)


def test_what_stands_before_something_sampled_is_sampled() -> None:
    """What it stops lights no medium behind it."""
    pulse = Pulse(4e-9)
    soft = SoftProfile.of_medium(pulse, pulse.fwhm_m / 16.0, 2e3, 0.01, 1e-3, 0.3, 1.0, 80.0)
    assert soft is not None
    wide = 20.0 + pulse.half_support_m * np.array([0.0, 0.8, 1.6])
    range_m = np.stack([np.array([0.6, 14.0, *wide]), np.array([0.6, 14.0, *(wide + 30.0)])])
    echoes = SubEchoes.from_grid(range_m, np.full((2, 5), 12.0), np.full((2, 5), 0.15))
    found, rest = cosines.split_cosines(echoes, Detector(pulse, 5.0), replace(soft, until_m=16.0))
    assert (len(found), len(rest)) == (0, 10)


def clear_air(pulse: Pulse) -> SoftProfile:
    soft = SoftProfile.of_medium(pulse, pulse.fwhm_m / 512.0, 150.0, 1e-4, 1e-3, 0.3, 1.0, 80.0)
    assert soft is not None
    assert 0.05 < soft.peak < 0.5
    return replace(soft, until_m=12.0, shows=False)


@pytest.mark.parametrize(
    ("range_m", "amplitude", "computed"),
    [
        ([3.0, 3.02], [2e4, 2e4], 0),  # rises too steeply for the air to move it by an eighth of a step
        ([3.0, 3.02], [6.0, 6.0], 1),  # faint: the air is a part of its height
        ([3.0, 3.0 + 0.95 * PULSE.half_support_m], [5.06, 2e4], 1),  # crossed near the maximum of what is faint
        ([3.0, 3.0 + 0.95 * PULSE.half_support_m], [8.0, 2e4], 1),  # moved by a step and a half
        ([9.0, 9.4], [2e4, 2e4], 0),
    ],
)
def test_clear_air_is_computed_where_a_crossing_depends_on_it(
    monkeypatch: pytest.MonkeyPatch, range_m: list[float], amplitude: list[float], computed: int
) -> None:
    soft, calls = clear_air(PULSE), []
    real = cosines._air
    monkeypatch.setattr(cosines, "_air", lambda *rest: calls.append(len(rest[2])) or real(*rest))
    # the cluster in question in the second of three beams, of which all others are far away
    far = np.array([50.0, 50.0])
    echoes = SubEchoes.of(
        np.array([0, 1, 1, 2]), np.array([far[0], *range_m, far[1]]), np.array([50.0, *amplitude, 50.0]),
        np.array([0.5, 0.3, 0.3, 0.5]),
    )  # fmt: skip
    detector = Detector(PULSE, 5.0, walk_table=False, resolution_m=1e-2, follows_noise=True, bin_s=PULSE.fwhm_s / 512.0)
    found = detect(echoes, 3, detector, soft=soft)
    assert sum(calls) == computed
    everything = detect(echoes, 3, replace(detector, sampled=True), soft=replace(soft, until_m=np.inf, shows=True))
    assert found.range_m[:, 0] == pytest.approx(everything.range_m[:, 0], abs=0.126 * 1e-2)
    assert found.amplitude[:, 0] == pytest.approx(everything.amplitude[:, 0], rel=2e-4)


def test_some_clusters_are_crossed_as_among_all() -> None:
    """Far away, faint, and strong ones that the air moves and does not move."""
    late = 0.95 * PULSE.half_support_m
    range_m = np.array([[50.0, 50.1], [3.0, 3.1], [4.0, 4.0 + late], [3.0, 3.1], [3.0, 3.0 + late]])
    amplitude = np.array([[50.0, 50.0], [6.0, 6.0], [8.0, 2e4], [2e4, 2e4], [8.0, 2e4]])
    echoes = SubEchoes.from_grid(range_m, amplitude, np.full((5, 2), 0.3))
    found, rest = cosines.split_cosines(echoes, replace(DETECTOR, resolution_m=1e-2), clear_air(PULSE))
    assert (len(found), len(rest)) == (5, 0)
    assert found.air is not None
    assert found.doubted is not None
    assert (found.air.cluster.tolist(), found.doubted.cluster.tolist()) == ([1], [2, 3, 4])
    level = np.array([5.0, 4.5, 5.2, 5.0, 4.8])
    everywhere = found.crossing(level)
    for wanted in ([0, 1, 2, 3], [1, 4], [3, 4], [0], [2, 4]):
        of = np.isin(np.arange(5), wanted)
        assert found.chosen(of).crossing(level[of]).tolist() == everywhere[of].tolist()


def test_the_echo_of_a_medium_alone_rises_as_its_integral_does() -> None:
    pulse = Pulse(4e-9)
    soft = SoftProfile.of_medium(pulse, pulse.fwhm_m / 16.0, 1e4, 0.01, 1e-3, 0.3, 1.0, 80.0)
    assert soft is not None
    own = OwnEchoes.of(soft, np.array([False, True, True, True]))
    level = np.array([0.3, 0.9, 1.1]) * own.height
    found = own.crossing(level)
    assert own.beam.tolist() == [1, 2, 3]
    half = pulse.half_support_m
    exact = softtarget.fog_shape(found[:2] + half, 0.01, 0.3, 1.0, 1e9, pulse.fwhm_s) * pulse.fwhm_s * 1e4 * 1e-3
    assert exact == pytest.approx(level[:2], rel=2e-4)  # a hundredth of a millimetre of its rise
    assert found[2] == own.centre_m


def test_a_gaussian_pulse_over_fine_bins_is_its_convolution(monkeypatch: pytest.MonkeyPatch) -> None:
    """Even pieces of a quarter of a bin, where bins are short against the nearest range: one pulse for all of them."""
    pulse, asked, real = Pulse(1e-9, "gauss"), [0], Pulse.profile

    def counted(self: Pulse, x_m: Values) -> Floats:
        asked[0] += np.size(x_m)
        return real(self, x_m)

    monkeypatch.setattr(Pulse, "profile", counted)
    soft = SoftProfile.of_medium(pulse, 0.01, 1e20, 0.01, 1e-3, 5.0, 6.0, 50.0)
    assert soft is not None
    assert asked[0] < soft.free.size
    x = soft.bin_m * np.arange(soft.first, soft.first + soft.free.size)
    t, weight = np.polynomial.legendre.leggauss(40)
    for j in np.linspace(20, soft.free.size - 100, 40).astype(int):
        cuts = np.unique(np.clip([5.0, 6.0, *np.linspace(x[j] - 1.0, x[j] + 1.0, 30)], 5.0, 50.0))
        half = 0.5 * np.diff(cuts)[:, None]
        r = cuts[:-1, None] + half * (t + 1.0)
        density = 1e17 * np.clip(r - 5.0, 0.0, 1.0) / r**2 * np.exp(-0.02 * r)
        exact = float((half * weight * density * pulse.profile(x[j] - r)).sum())
        assert soft.free[j] == pytest.approx(exact, rel=1e-6, abs=4e-6 * soft.peak)


def test_a_gate_of_millions_of_bins_is_tabulated_by_whole_arrays() -> None:
    """Python's own loops counted, not the clock: two knots a bin were made one by one."""
    pulse = Pulse(0.1e-9)
    events = 0

    def count(*_: object) -> None:
        nonlocal events
        events += 1

    bins = 200_000
    sys.setprofile(count)
    try:
        soft = SoftProfile.of_medium(pulse, pulse.fwhm_m / 16.0, 1e15, 4e-5, 1e-6, 0.3, 1.0, bins * pulse.fwhm_m / 16.0)
    finally:
        sys.setprofile(None)
    assert soft is not None
    assert soft.free.size > 0.99 * bins
    assert events < bins / 10
    # two knots a bin and more: half a bin apart at the most, so that cubics hold
    assert np.max(np.diff(soft.knots)) < 0.5001 * soft.bin_m


@pytest.mark.parametrize("visibility_m", [12.0, 60.0, 900.0])
def test_the_pulse_over_one_place_is_to_the_bit_what_it_is_over_many(visibility_m: float) -> None:
    soft = profile_of(visibility_m)
    x = np.concatenate([soft.grid[:: 1 + len(soft.grid) // 500] + 0.01, soft.knots[:3] + PULSE.half_support_m])
    _, real, imaginary = soft._under_pulse(x)
    assert [soft._phase_under_pulse(one) for one in x.tolist()] == list(
        zip(real.tolist(), imaginary.tolist(), strict=True)
    )
