"""Noise, background, photons, directions: limits, symmetries and draws."""

from __future__ import annotations

import math

import numpy as np
import pytest

from emulator.physics import background, brdf, counting, geometry, noise, photons, radiometry


def test_a_diode_without_gain_has_no_excess_noise() -> None:
    assert float(noise.excess_noise(1.0, 0.5)) == 1.0
    assert np.all(np.diff(noise.excess_noise(np.linspace(1.0, 300.0, 50), 0.02)) > 0.0)


def test_the_shot_noise_of_the_signal_is_what_the_noise_current_gains() -> None:
    receiver = (0.5, 100.0, 0.02, 1e-10, 5e-9, 2e-12, 1e4, 300.0, 31.25e6)
    quiet = float(noise.noise_current(0.0, 0.0, *receiver))
    factor = float(noise.signal_shot_factor(100.0, 0.02, 31.25e6, quiet))
    for snr in (1.0, 30.0, 1e4):
        signal_w = snr * quiet / (0.5 * 100.0)
        loud = float(noise.noise_current(signal_w, 0.0, *receiver))
        assert (loud / quiet) ** 2 == pytest.approx(1.0 + factor * snr, rel=1e-9)


def test_the_converter_adds_its_noise_in_squares() -> None:
    receiver = (0.55, 1.0, 0.0, 0.0, 1e-9, 6.56e-12, 1e9, 300.0, 31.25e6)
    plain = float(noise.noise_current(0.0, 0.0, *receiver))
    coarse = float(noise.adc_noise(1e-4, 8))
    assert float(noise.noise_current(0.0, 0.0, *receiver, coarse)) == pytest.approx(math.hypot(plain, coarse))


def test_thresholds_and_false_alarms_invert_each_other() -> None:
    for mean in (1e-8, 1e-4, 0.3):
        tnr = float(noise.tnr_for_false_alarms(mean, 125e6, 80.0))
        assert float(noise.false_alarm_rice(tnr, 125e6, 80.0)) == pytest.approx(mean, rel=1e-12)
    assert float(noise.tnr_for_false_alarms(1e9, 125e6, 80.0)) == 0.0
    assert float(noise.false_alarm_rice(8.0, 31.25e6, 250.0)) * 1e5 < 0.1  # none in 1e5 beams at TNR 8


def test_noise_maxima_over_the_threshold_follow_rayleigh() -> None:
    uniform = (np.arange(100_000) + 0.5) / 100_000
    height = noise.noise_echo_amplitude(5.0, uniform)
    assert height.min() >= 5.0
    assert float(np.mean(height > 5.5)) == pytest.approx(math.exp(-(5.5**2 - 25.0) / 2.0), rel=1e-3)


def test_the_sun_is_seen_whole_in_part_or_not_at_all() -> None:
    sun = 4.652e-3
    assert float(background.sun_share(0.02, sun, 0.0)) == 1.0
    assert float(background.sun_share(0.02, sun, 0.0246521)) == 0.0
    assert float(background.sun_share(sun, sun, 0.0)) == 1.0
    # centre of a large field's rim on the disc's centre: nearly half
    assert float(background.sun_share(1.0, sun, 1.0)) == pytest.approx(0.5, abs=2e-3)
    separation = np.linspace(0.0, 0.03, 400)
    share = background.sun_share(1.2e-3, sun, separation)
    assert np.all(np.diff(share) <= 1e-15)
    assert np.all((share >= 0.0) & (share <= 1.0))
    assert float(background.sun_share(0.0, sun, 0.0)) == 0.0


def test_stray_light_falls_with_the_angle_and_the_sun_in_view_is_no_stray_light() -> None:
    field = math.radians(0.07)
    angle = np.radians(np.array([0.0, 0.05, 1.0, 10.0]))
    stray = background.stray_light(angle, field)
    assert stray == pytest.approx([0.0, 0.0, 1e-4, 1e-6])
    power = background.background_sun(0.7e9, 40e-9, 0.01, field, 0.5, angle)
    assert np.all(np.diff(power) <= 0.0)
    assert float(background.background_sun(0.0, 40e-9, 0.01, field, 0.5, 0.0)) == 0.0  # night


def test_a_surface_lit_from_behind_sends_no_sunlight() -> None:
    assert float(background.background_surface(0.75e9, 40e-9, 1.0, math.radians(100.0), 0.01, 1e-3, 0.5)) == 0.0


def test_the_sun_at_the_ground_follows_table_total_and_colour() -> None:
    assert background.solar_ground(905e-9, 1366.1) == pytest.approx(0.749e9)
    assert background.solar_ground(903e-9, 1366.1) == pytest.approx(0.749e9)
    assert background.solar_ground(1550e-9, 1366.1, direct=True) == pytest.approx(0.260e9)
    assert background.solar_ground(905e-9, 0.0) == 0.0
    assert background.solar_ground(532e-9) > background.solar_ground(905e-9)


def test_a_filter_passes_a_line_in_its_middle_and_none_far_off() -> None:
    assert float(background.filter_line_share(1e-9, 40e-9, 0.0)) == pytest.approx(1.0)
    assert float(background.filter_line_share(1e-9, 40e-9, 80e-9)) == 0.0
    assert float(background.filter_line_share(0.0, 40e-9, 19.9e-9)) == 1.0
    assert float(background.filter_line_share(5e-9, 40e-9, 25e-9)) == float(
        background.filter_line_share(5e-9, 40e-9, -25e-9)
    )


# ------------------------------------------------------------------------------- photons
def test_first_photons_of_all_bins_and_none_sum_to_one() -> None:
    counts = np.concatenate([np.full(100, 0.01), [0.4, 0.7, 0.3], np.full(100, 0.01)])
    share = photons.first_photon_distribution(counts)
    assert float(share.sum()) + math.exp(-float(counts.sum())) == pytest.approx(1.0, rel=1e-14)
    assert float(share[100]) == pytest.approx(math.exp(-1.0) * -math.expm1(-0.4), rel=1e-12)
    single = np.concatenate([np.full(7, 1e-3), [1e-3 + 0.5]])
    assert float(photons.first_photon_distribution(single)[7]) == pytest.approx(
        float(photons.first_photon_bin(1e-3, 0.5, 7)), rel=1e-14
    )


def test_drawn_first_photons_follow_their_distribution_and_pile_up_early() -> None:
    counts = np.concatenate([np.full(50, 0.02), [0.5, 0.8, 0.5], np.full(50, 0.02)])
    uniform = (np.arange(200_000) + 0.5) / 200_000
    drawn = photons.first_photon_draw(counts, uniform)
    share = photons.first_photon_distribution(counts)
    found = np.bincount(drawn[drawn >= 0], minlength=counts.size) / uniform.size
    assert np.abs(found - share).max() < 1e-4
    assert float(np.mean(drawn < 0)) == pytest.approx(math.exp(-float(counts.sum())), abs=1e-4)
    assert counts[50:53].argmax() == 1
    assert found[50:53].argmax() == 0  # the pulse's rise shadows its top
    assert found[52] < 0.5 * found[50]


def test_the_histogram_s_correlation_finds_the_pulse_and_its_strength() -> None:
    shape = np.array([0.1, 0.5, 1.0, 0.5, 0.1])
    histogram = np.full(200, 2.0)
    histogram[77:82] += 40.0 * shape
    assert photons.correlation_range(histogram, shape, 0.15) == pytest.approx(0.15 * 77.0, abs=1e-9)
    assert float(photons.correlation_snr(0.1, 0.3, 100.0)) == pytest.approx(0.1 * 100.0 / math.sqrt(100.0 * 0.4))
    assert float(photons.correlation_snr(0.0, 0.0, 100.0)) == 0.0


# ------------------------------------------------------------------------------- directions, panes
def test_a_mirrored_ray_leaves_under_the_angle_at_which_it_came() -> None:
    rng = np.random.default_rng(0)
    direction, normal = (v / np.linalg.norm(v, axis=1, keepdims=True) for v in rng.normal(size=(2, 50, 3)))
    out = geometry.mirrored(direction, normal)
    assert np.abs(np.linalg.norm(out, axis=1) - 1.0).max() < 1e-15
    assert np.abs(np.sum(out * normal, axis=1) + np.sum(direction * normal, axis=1)).max() < 1e-14
    assert np.abs(geometry.mirrored(out, normal) - direction).max() < 1e-14
    assert np.all(geometry.incidence_cosine(direction, normal) >= 0.0)


def test_a_mirror_square_to_the_beam_returns_what_its_spot_leaves_in_the_aperture() -> None:
    straight = float(geometry.mirror_direct_share(0.01, 1e-3, 10.0, 0.0))
    assert straight == pytest.approx(float(radiometry.fill_disc(0.01, 2.0 * 10.0 * math.tan(1e-3))), rel=1e-9)
    tilt = np.linspace(0.0, math.radians(3.0), 40)
    assert np.all(np.diff(geometry.mirror_direct_share(0.01, 1e-3, 10.0, tilt)) <= 1e-15)


def test_a_pane_keeps_all_light_unless_its_glass_absorbs() -> None:
    cosine = np.cos(np.radians(np.linspace(0.0, 89.0, 30)))
    clear = brdf.pane_reflection_cos(1.5, cosine) + brdf.pane_internal_transmission_cos(1.5, cosine, 1.0)
    assert clear == pytest.approx(np.ones(30), rel=1e-12)
    tinted = brdf.pane_internal_transmission_cos(1.5, cosine, 0.3)
    assert np.all(tinted < 0.31)


def test_points_on_a_target_end_at_the_largest_range() -> None:
    share = counting.needed_share(np.array([10.0, 50.0, 60.0, 1e4]), 50.0, 4.0)
    assert share[1] == 1.0
    assert share[2] > 1.0
    assert np.all(np.isfinite(share))
