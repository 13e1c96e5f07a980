"""Receivers that count photons, against the closed forms of section 2.6 (physics.photons)."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from emulator.physics import photons
from emulator.sensing.daylight import NIGHT
from emulator.sensing.photon_receiver import LONG_PULSE, PhotonReceiver, _correlated
from tests.sensing.rig import build, plan, plate

CLEAR: dict[str, Any] = {"visibility_m": 1e9}
ONE_BEAM = {"rule": "axis", "gate_m": 60.0}


def receiver(measure: Any) -> PhotonReceiver:
    assert isinstance(measure._receiver, PhotonReceiver)
    return measure._receiver


def faint(folder: Path, **options: Any) -> Any:
    """A plate at 30 m and a laser so weak that few pulses bring a photon back."""
    physics = {**ONE_BEAM, "system_constant_m2": 0.1, "photons": {"shots": 2000, **options}}
    return build(folder, [plate(30.0, "half")], weather=CLEAR, physics=physics)


def test_an_echo_brings_the_photons_of_its_energy(tmp_path: Path) -> None:
    measure = faint(tmp_path)
    model = measure.model
    view = measure.view(plan())
    signal, hertz = receiver(measure).mean_counts(view.echoes, 0, 1, None, NIGHT)
    lens = model.aperture_radius_m**2 / (900.0 + model.aperture_radius_m**2)
    energy_j = model.pulse_energy_j * model.efficiency * 0.5 * lens
    assert signal.sum() == pytest.approx(float(photons.photoelectrons(energy_j, 905e-9, 0.3)), rel=1e-6)
    assert hertz[0] == pytest.approx(1000.0)


def test_the_range_comes_out_of_the_histogram(tmp_path: Path) -> None:
    scan = faint(tmp_path)(plan(np.zeros(200)))
    assert np.isfinite(scan.range_m).all()
    assert np.median(scan.range_m) == pytest.approx(30.0, abs=0.1)
    assert (scan.actor == 0).all()


def test_first_photons_pile_up_before_the_middle_of_a_strong_echo(tmp_path: Path) -> None:
    physics = {**ONE_BEAM, "system_constant_m2": 75000.0, "photons": {"shots": 1000}}
    scan = build(tmp_path, [plate(30.0, "half")], weather=CLEAR, physics=physics)(plan(np.zeros(50)))
    early = 30.0 - np.median(scan.range_m)
    assert 0.5 < early <= 2.4, "within the rise of a 16 ns pulse"


def test_more_shots_give_more_signal_by_their_root(tmp_path: Path) -> None:
    """`correlation_snr`: n_s K / sqrt(K (n_s + n_b))."""
    snr = []
    for shots in (1000, 4000):
        measure = faint(tmp_path, shots=shots, dark_count_hz=1e5)
        scan = measure(plan(np.zeros(400)))
        snr.append(float(np.nanmean(scan.intensity)) * measure.model.threshold)
    assert snr[1] / snr[0] == pytest.approx(2.0, rel=0.1)


def test_daylight_hides_a_faint_echo(tmp_path: Path) -> None:
    """Dark counts as background: from 1 kHz to 1 GHz a faint echo is lost."""
    seen = []
    for hertz in (1e3, 1e6, 1e9):
        physics = {**ONE_BEAM, "system_constant_m2": 4e-3, "photons": {"shots": 20000, "dark_count_hz": hertz}}
        measure = build(tmp_path, [plate(30.0, "half")], weather=CLEAR, physics=physics)
        scan = measure(plan(np.zeros(100)))
        seen.append(int((np.abs(scan.range_m[:, 0] - 30.0) < 2.0).sum()))
    assert seen[0] > 90
    assert seen[2] < 10
    assert seen[0] >= seen[1] >= seen[2]


def test_a_bright_background_fills_the_first_bins_and_does_not_pull_the_range(tmp_path: Path) -> None:
    """First photons of 10 MHz of background fall off over the gate; only what exceeds them counts."""
    measure = faint(tmp_path, shots=100_000, dark_count_hz=1e7)
    scan = measure(plan(np.zeros(50)))
    assert np.median(scan.range_m) == pytest.approx(30.0, abs=0.2)


def test_pairs_have_the_ratio_of_coincidences_to_accidentals(tmp_path: Path) -> None:
    pairs = {
        "pair_rate_hz": 1e7,
        "idler_efficiency": 0.5,
        "integration_ms": 1000.0,
        "bin_ns": 1.0,
        "dark_count_hz": 1e6,
    }
    physics = {**ONE_BEAM, "noise": False, "photons": pairs}
    measure = build(tmp_path, [plate(30.0, "half")], weather=CLEAR, physics=physics)
    view = measure.view(plan())
    counts, alone = receiver(measure)._histogram(view.echoes, 0, 1, None, NIGHT, np.random.default_rng(1))
    chance = (counts - alone).sum() / (1e7 * 0.5)
    expected = float(photons.coincidence_ratio(1e7, chance, 0.5, 1e7 * chance + 1e6, 1e7 * 0.5, 1e-9))
    # the range lies between two bins, which share the coincidences
    assert (counts - alone).sum() / alone.mean() == pytest.approx(expected, rel=1e-9)


def test_counting_is_the_same_whenever_it_is_done(tmp_path: Path) -> None:
    one, two = faint(tmp_path), faint(tmp_path)
    late = one(replace(plan(np.zeros(20)), sweep=5))
    two(plan(np.zeros(20)))
    assert np.array_equal(late.range_m, two(replace(plan(np.zeros(20)), sweep=5)).range_m, equal_nan=True)
    assert not np.array_equal(late.range_m, two(replace(plan(np.zeros(20)), sweep=6)).range_m, equal_nan=True)


def test_an_empty_scene_in_the_dark_is_empty(tmp_path: Path) -> None:
    scan = build(tmp_path, physics={**ONE_BEAM, "photons": {"dark_count_hz": 0.0}})(plan(np.zeros(20)))
    assert np.isnan(scan.range_m).all()


@pytest.mark.parametrize("range_m", [0.5, 2.0, 3.7, 11.5])
@pytest.mark.parametrize("fwhm_ns", [1.0, 4.0])
def test_a_strong_echo_is_counted_though_the_chances_of_its_bins_round_to_more_than_one(
    tmp_path: Path, range_m: float, fwhm_ns: float
) -> None:
    physics = {"pulse_fwhm_ns": fwhm_ns, "photons": {}}
    measure = build(tmp_path, [plate(range_m, "white")], model="sick-lms291-s05", physics=physics)
    scan = measure(plan(np.linspace(-5.0, 5.0, 21)))
    assert np.isfinite(scan.range_m).all()
    early = range_m - np.median(scan.range_m)
    assert -0.5 * measure.model.pulse.fwhm_m < early < measure.model.pulse.fwhm_m + 0.15


@pytest.mark.parametrize("bins", [1, 2, 5, 16])
def test_drawn_first_photons_follow_their_distribution(bins: int) -> None:
    """Counts of bins are binomial: within five sigma of their mean, and of two bins with the right covariance."""
    mean = np.geomspace(1e-3, 2.0, bins)
    shots, beams = 1000, 4000
    drawn = photons.first_photon_counts(np.tile(mean, (beams, 1)), shots, np.random.default_rng(5))
    p = photons.first_photon_distribution(mean)
    assert drawn.shape == (beams, bins)
    sigma = np.sqrt(shots * p * (1.0 - p))
    assert np.all(np.abs(drawn.mean(axis=0) - shots * p) < 5.0 * sigma / np.sqrt(beams))
    assert drawn.std(axis=0) == pytest.approx(sigma, rel=0.06)
    if bins > 1:
        together = np.cov(drawn[:, -2], drawn[:, -1])[0, 1]
        assert together == pytest.approx(-shots * p[-2] * p[-1], abs=5.0 * sigma[-1] * sigma[-2] / np.sqrt(beams))


def test_first_photons_of_no_light_and_of_too_much_are_all_told() -> None:
    mean = np.array([[0.0, 0.0, 0.0], [0.0, 1e30, 1e30], [1e-320, 0.0, 1e5], [50.0, 1e-17, 0.0]])
    drawn = photons.first_photon_counts(mean, 7, np.random.default_rng(1))
    assert drawn.tolist() == [[0, 0, 0], [0, 7, 0], [0, 0, 7], [7, 0, 0]]


@pytest.mark.parametrize("shape", ["sin2", "gauss"])
def test_bins_far_shorter_than_the_pulse_count_as_others_do(tmp_path: Path, shape: str) -> None:
    """A sum under the pulse by a Fourier transform, against one by numpy's definition."""
    physics = {**ONE_BEAM, "pulse": shape, "photons": {"bin_ns": 0.03}}
    counter = receiver(build(tmp_path, [plate(30.0, "half")], weather=CLEAR, physics=physics))
    weight = counter._pulse
    assert len(weight) > LONG_PULSE
    counts = np.zeros((2, 9000))
    counts[0, [0, 3000, 8990]] = 1e12, 5.0, 2.0
    summed = _correlated(counts, weight)
    exact = np.convolve(counts[0], weight, mode="same")
    assert summed[0] == pytest.approx(exact, abs=1e-12 * float(exact.max()))
    assert summed[0, 5500] == 0.0
    assert not summed[1].any()
    wide = np.convolve(np.ones(11), weight)
    assert _correlated(np.ones((1, 11)), weight)[0] == pytest.approx(wide[len(weight) // 2 :][:11], rel=1e-12)


def test_the_range_does_not_depend_on_how_short_the_bins_are(tmp_path: Path) -> None:
    scan = faint(tmp_path, bin_ns=0.02)(plan(np.zeros(20)))
    assert np.median(scan.range_m) == pytest.approx(30.0, abs=0.1)
