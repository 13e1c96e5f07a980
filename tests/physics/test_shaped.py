"""Receivers with electronics: shaped pulses against integrals, noise against Rice, what follows a clipped echo.

`data/joins_receiver.json` has the cases `recovery` and `spad` of the specification physics_joins, sections 11 and 12.
"""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy import integrate, special

from emulator.physics import response
from emulator.physics.constants import SPEED_OF_LIGHT_M_S
from emulator.physics.detector import Detector, Echoes, Method
from emulator.physics.pulse import Pulse, centroid_sigma, crlb_gauss, crlb_sin2
from emulator.physics.response import Response, ResponseShape, ShapedPulse
from emulator.physics.shaped import Shaped
from emulator.physics.subechoes import SubEchoes

CASES = json.loads((Path(__file__).parent / "data" / "joins_receiver.json").read_text(encoding="utf-8"))
RECOVERY = [case for case in CASES if case["kind"] == "recovery"]
TAU = 4e-9
FAST = 125e6


def received(
    ranges_m: list[float], amplitudes: list[float], filter_: Response, *, beams: int = 1, noisy: bool = False,
    sweep: int = 0, **detector: Any,
) -> Echoes:  # fmt: skip
    """Echoes of the same points in every beam."""
    keys = {"pulse": Pulse(TAU), "threshold": 5.0, "keep": "all", "max_echoes": 4, "bin_s": 0.1e-9, "far_gate_m": 80.0}
    one = Detector(**{**keys, "resolution_m": 0.001, **detector})
    beam = np.arange(beams).repeat(len(ranges_m))
    source = np.tile([7, 8][: len(ranges_m)], beams)
    echoes = SubEchoes.of(beam, np.tile(ranges_m, beams), np.tile(amplitudes, beams), None, source)
    return Shaped(one, filter_, 99).detect(
        echoes, beams, one, sweep=sweep, noisy=noisy, noise=None, soft=None, dazzled=None, noise_echoes=None
    )


# ------------------------------------------------------------------------------- shaped pulses
@pytest.mark.parametrize("case", RECOVERY, ids=lambda case: case["name"])
def test_a_pole_does_what_the_specification_says(case: dict[str, Any]) -> None:
    given, expected = case["setup"], case["expected"]
    pole_s = Response("single_pole", given["corner_hz"]).pole_s
    assert pole_s == pytest.approx(expected["time_constant_s"], rel=1e-8)
    left = float(response.pole_on_sin2_end(given["fwhm_s"], pole_s))
    assert left == pytest.approx(expected["value_at_pulse_end_over_input"], rel=1e-8)
    late = float(response.blind_after_sin2(given["amplitude"], given["threshold"], given["fwhm_s"], pole_s))
    assert late == pytest.approx(expected["below_threshold_s"], rel=1e-8)
    at = expected["peak_time_s"]
    peak = float(response.pole_on_sin2(at, given["fwhm_s"], pole_s))
    assert peak == pytest.approx(expected["peak_over_input"], rel=1e-8)
    shaped = ShapedPulse(Pulse(given["fwhm_s"]), Response("single_pole", given["corner_hz"], rated_at="input"), 500.0)
    place = float(shaped.x_m[np.argmax(shaped.value)]) + shaped.pulse.fwhm_m
    assert shaped.peak == pytest.approx(expected["peak_over_input"], rel=1e-5)
    assert place == pytest.approx(0.5 * SPEED_OF_LIGHT_M_S * at, abs=2.0 * shaped.step_m)


@pytest.mark.parametrize("corner_hz", [30e6, 125e6, 600e6])
@pytest.mark.parametrize("shape", ["single_pole", "gauss"])
@pytest.mark.parametrize("pulse", [Pulse(TAU), Pulse(TAU, "gauss")], ids=["sin2", "gauss"])
def test_a_shaped_pulse_is_the_integral_of_pulse_and_impulse_response(
    pulse: Pulse, shape: ResponseShape, corner_hz: float
) -> None:
    filter_ = Response(shape, corner_hz, rated_at="input")
    shaped = ShapedPulse(pulse, filter_, 200.0)
    half = pulse.half_support_m * 2.0 / SPEED_OF_LIGHT_M_S
    ns = 1e9 * half
    for t in np.linspace(-0.9 * ns, 2.5 * ns, 9):

        def under(u: float, t: float = float(t)) -> float:
            lag = 1e-9 * (t - u)
            if shape == "single_pole":
                weight = math.exp(-lag / filter_.pole_s) / filter_.pole_s if lag >= 0.0 else 0.0
            else:
                weight = math.exp(-0.5 * (lag / filter_.sigma_s) ** 2) / (filter_.sigma_s * math.sqrt(2.0 * math.pi))
            return 1e-9 * weight * float(pulse.profile(0.5e-9 * SPEED_OF_LIGHT_M_S * u))

        knots = [x for x in (t, t - 2e9 * filter_.sigma_s, t + 2e9 * filter_.sigma_s) if -ns < x < ns]
        end = min(ns, t) if shape == "single_pole" else ns
        exact = integrate.quad(under, -ns, end, points=[x for x in knots if x < end] or None, limit=400)[0]
        assert float(shaped.at(np.array(0.5e-9 * SPEED_OF_LIGHT_M_S * t))) == pytest.approx(exact, abs=3e-6)


def test_late_charge_and_ac_coupling_are_what_an_independent_sum_of_exponentials_gives() -> None:
    """Euler's steps of the three differential equations, a thousand to a nanosecond."""
    filter_ = Response("single_pole", FAST, rated_at="input", coupling_s=60e-9, tail_share=0.1, tail_s=15e-9)
    shaped = ShapedPulse(Pulse(TAU), filter_, 80.0)
    h = 1e-12
    t = h * np.arange(100_000)
    y = a = late = base = 0.0
    made = np.zeros(len(t))
    for k, light in enumerate(np.where(t < 2 * TAU, np.sin(0.5 * np.pi * t / TAU) ** 2, 0.0).tolist()):
        y += h / filter_.pole_s * (light - y)
        late += h / 15e-9 * (y - late)
        a = 0.9 * y + 0.1 * late
        base += h / 60e-9 * (a - base)
        made[k] = a - base
    found = shaped.at(0.5 * SPEED_OF_LIGHT_M_S * t - shaped.pulse.fwhm_m)
    assert np.abs(found - made).max() < 4e-4
    assert found.min() < -0.04, "an undershoot"


def test_behind_an_ac_coupling_as_much_is_missing_as_was_there_before() -> None:
    shaped = ShapedPulse(Pulse(TAU), Response("gauss", FAST, coupling_s=40e-9), 1e4)
    whole, up = shaped.value.sum(), np.maximum(shaped.value, 0.0).sum()
    assert abs(whole) < 1e-4 * up


# ------------------------------------------------------------------------------- noise
@pytest.mark.parametrize("shape", ["single_pole", "gauss"])
def test_noise_has_rms_one_is_correlated_by_the_filter_and_crosses_as_often_as_its_law_says(
    shape: ResponseShape,
) -> None:
    filter_, step_s = Response(shape, 31.25e6), 0.5e-9
    one = Shaped(Detector(Pulse(16e-9), 3.0, bin_s=step_s, far_gate_m=250.0), filter_, 4)
    n, rows = 10_000, 300
    x = one._noise(np.arange(rows), np.zeros(rows, np.int64), n, 3)
    assert x.std() == pytest.approx(1.0, abs=0.005)
    for lag in (1, 7, 20):
        found = float((x[:, :-lag] * x[:, lag:]).mean() / x.var())
        assert found == pytest.approx(float(filter_.correlation(lag * step_s)), abs=0.005)
    for level in (2.0, 3.0):
        rate = float(np.count_nonzero((x[:, :-1] < level) & (x[:, 1:] >= level))) / (rows * n * step_s)
        assert rate == pytest.approx(float(filter_.crossings_hz(level, step_s)), rel=0.05)


def test_for_fine_steps_the_rate_of_crossings_is_rices() -> None:
    """Rms frequency of |H|^2 by an integral; the ideal low-pass of the same rms frequency has B = sqrt(3) of it."""
    filter_ = Response("gauss", 50e6)

    def power(f: float) -> float:
        return math.exp(-math.log(2.0) * (f / 50e6) ** 2)

    area = integrate.quad(power, 0.0, 1e9, points=[50e6])[0]
    rms_hz = math.sqrt(integrate.quad(lambda f: f * f * power(f), 0.0, 1e9, points=[50e6])[0] / area)
    assert filter_.noise_bandwidth_hz == pytest.approx(area, rel=1e-9)
    for tnr in (0.0, 3.0, 5.0):
        assert float(filter_.crossings_hz(tnr, 1e-13)) == pytest.approx(rms_hz * math.exp(-0.5 * tnr * tnr), rel=1e-5)


def test_the_noise_of_a_beam_is_the_same_whatever_else_is_looked_at() -> None:
    one = Shaped(Detector(Pulse(TAU), 5.0, bin_s=0.25e-9, far_gate_m=80.0), Response("gauss", FAST), 4)
    many = one._noise(np.arange(5), np.full(5, 100), 400, 8)
    few = one._noise(np.array([3]), np.array([250]), 100, 8)
    assert few[0] == pytest.approx(many[3, 150:250], abs=1e-12)
    assert np.abs(one._noise(np.array([3]), np.array([250]), 100, 9)[0] - few[0]).max() > 0.5


@pytest.mark.parametrize("snr", [3.5, 5.0, 6.0])
def test_an_echo_is_seen_as_often_as_a_monte_carlo_of_correlated_noise_says(snr: float) -> None:
    """Gaussian pulse and filter, drawn here by a covariance matrix: a maximum has several chances to pass."""
    filter_, step_s = Response("gauss", FAST), 0.25e-9
    beams = 6000
    found = received([20.0], [snr], filter_, beams=beams, noisy=True, bin_s=step_s, pulse=Pulse(TAU, "gauss"))
    near = np.abs(found.range_m - 20.0) < 1.2
    seen = float(np.any(near, axis=1).mean())
    t = step_s * np.arange(-32, 33)
    wide = math.hypot(TAU / 2.3548200450309493, filter_.sigma_s)
    lag = t[:, None] - t
    chol = np.linalg.cholesky(np.exp(-((lag / (2.0 * filter_.sigma_s)) ** 2)) + 1e-9 * np.eye(len(t)))
    y = snr * np.exp(-0.5 * (t / wide) ** 2) + np.random.default_rng(5).normal(size=(20_000, len(t))) @ chol.T
    expected = float((y.max(axis=1) >= 5.0).mean())
    spread = math.sqrt(expected * (1 - expected) * (1 / beams + 1 / 20_000))
    assert seen == pytest.approx(expected, abs=4.0 * spread + 0.005)
    assert seen > float(special.ndtr(snr - 5.0)) - 0.02


# ------------------------------------------------------------------------------- ranges
@pytest.mark.parametrize("clips", ["before", "after"])
@pytest.mark.parametrize("method", ["leading_edge", "peak", "centroid", "constant_fraction"])
@pytest.mark.parametrize("shape", ["single_pole", "gauss"])
def test_a_lone_echo_is_where_it_is_at_any_height(shape: ResponseShape, method: Method, clips: Any) -> None:
    for amplitude in (5.5, 30.0, 3000.0):
        for place in (20.0, 20.0123):
            found = received([place], [amplitude], Response(shape, FAST, clips), method=method)
            assert found.count[0] == 1
            assert found.range_m[0, 0] == pytest.approx(place, abs=3e-3)
            assert found.amplitude[0, 0] == pytest.approx(amplitude, rel=2e-3)
            assert found.source[0, 0] == 7


@pytest.mark.parametrize("snr", [15.0, 40.0])
def test_the_maximum_behind_the_fitting_filter_scatters_by_the_cramer_rao_bound(snr: float) -> None:
    """A filter as wide as the Gaussian pulse is the matched one: what passes it of N0 = rms^2 / B has the bound.

    Light of peak A in white noise of density N0; matched output: peak A/sqrt 2, rms^2 = N0 / (4 sqrt(pi) sigma).
    """
    pulse = Pulse(TAU, "gauss")
    sigma_s = TAU / 2.3548200450309493
    filter_ = Response("gauss", math.sqrt(math.log(2.0)) / (2.0 * math.pi * sigma_s))
    found = received([20.0], [snr], filter_, beams=4000, noisy=True, bin_s=0.1e-9, pulse=pulse, method="peak")
    ranges = found.range_m[:, 0]
    # the same light before the filter, in the noise of an ideal low-pass of bandwidth B
    b = 1e9
    before = snr * math.sqrt(2.0) / math.sqrt(b * 4.0 * math.sqrt(math.pi) * sigma_s)
    bound = float(crlb_gauss(TAU, before, b))
    assert np.nanstd(ranges) == pytest.approx(bound, rel=0.06)
    assert np.nanmean(ranges) == pytest.approx(20.0, abs=4.0 * bound / math.sqrt(4000) + 1e-3)


@pytest.mark.parametrize("method", ["peak", "centroid"])
@pytest.mark.parametrize("shape", ["sin2", "gauss"])
def test_the_closed_forms_of_range_noise_hold_for_estimates_in_white_noise(shape: Any, method: Method) -> None:
    """Monte Carlo: white noise on a fine grid; the maximum by the matched filter, the centroid as it is weighted."""
    pulse, snr, b, rng = Pulse(TAU, shape), 600.0, 0.5 / TAU, np.random.default_rng(2)
    reach, step = pulse.half_support_m, pulse.fwhm_m / 40.0
    x = np.arange(-2.0 * reach, 2.0 * reach, step)
    density = 1.0 / (snr * snr * b)  # one-sided, of a peak of 1
    noise = rng.normal(size=(4000, len(x))) * math.sqrt(0.5 * density / (2.0 * step / SPEED_OF_LIGHT_M_S))
    spectrum = np.fft.rfft(noise, axis=1)
    spectrum[:, np.fft.rfftfreq(len(x), 2.0 * step / SPEED_OF_LIGHT_M_S) > 4.0 / TAU] = 0.0  # beyond the pulse's
    noise = np.fft.irfft(spectrum, len(x), axis=1)
    y = pulse.profile(x) + noise
    if method == "peak":
        # the estimate of maximum likelihood by one step of Newton from the truth
        slope, bend = np.gradient(pulse.profile(x), step), np.gradient(np.gradient(pulse.profile(x), step), step)
        estimate = (y @ -slope) / (-y @ bend)
    else:
        inside = np.abs(x) <= reach
        base, v = 0.05, y[:, inside]
        weight = v * (v / np.hypot(v, base)) ** 4
        estimate = (weight @ x[inside]) / weight.sum(axis=1)
    if method == "centroid":
        found = centroid_sigma(pulse, 0.05, snr, b)
    else:
        found = Detector(pulse, 6.0, method).sigma_m(snr)
    assert float(estimate.std()) == pytest.approx(float(found), rel=0.05)
    bound = crlb_gauss if shape == "gauss" else crlb_sin2
    assert float(found) >= 0.999 * float(bound(TAU, snr, b))


# ------------------------------------------------------------------------------- after a bright echo
@pytest.mark.parametrize(("amplitude", "blind_m"), [(1e5, 2.82435183), (1e7, 3.70326609)])
def test_a_bright_echo_hides_what_follows_until_its_tail_is_under_the_threshold(
    amplitude: float, blind_m: float
) -> None:
    """Case `recovery`: LMS291. The echo behind is told apart when the tail of the first falls under the threshold."""
    filter_ = Response("single_pole", FAST, rated_at="input")
    start = 20.0 - Pulse(TAU).fwhm_m
    for behind, echoes in ((-0.9, 1), (0.35, 2)):
        place = start + blind_m + Pulse(TAU).fwhm_m + behind
        found = received([20.0, place], [amplitude, 100.0], filter_, full_scale=20_000.0)
        assert found.count[0] == echoes, behind
        assert found.saturated[0, 0]
        if echoes == 2:
            assert found.range_m[0, 1] == pytest.approx(place, abs=0.02)
            assert not found.saturated[0, 1]
    close = received([20.0, 22.0], [1e5, 100.0], filter_, full_scale=20_000.0)
    assert -0.08 < close.range_m[0, 1] - 22.0 < -0.02, "on the tail its edge comes early"


def test_a_current_that_clips_before_the_filter_leaves_a_shorter_tail() -> None:
    places = [20.0, 22.3]
    after, before = (
        received(places, [1e7, 100.0], Response("single_pole", FAST, clips, "input"), full_scale=20_000.0)
        for clips in ("after", "before")
    )
    assert (after.count[0], before.count[0]) == (1, 2)


def test_a_clipped_pulse_is_as_long_as_its_shape_says() -> None:
    """Width over the threshold of `pole_on_sin2`: it grows by the logarithm of the amplitude."""
    filter_ = Response("single_pole", FAST, rated_at="input")
    widths = []
    for amplitude in (1e5, 1e6, 1e7):
        late = float(response.blind_after_sin2(amplitude, 5.0, TAU, filter_.pole_s))
        t = np.linspace(0.0, 10 * TAU, 400_001)
        over = t[amplitude * response.pole_on_sin2(t, TAU, filter_.pole_s) >= 5.0]
        assert over[-1] == pytest.approx(late, abs=2e-13)
        widths.append(late)
    assert np.diff(widths) == pytest.approx(math.log(10.0) * filter_.pole_s, rel=1e-9)


def test_the_undershoot_of_an_ac_coupling_hides_a_faint_echo_and_shifts_a_stronger_one() -> None:
    coupled = Response("gauss", FAST, coupling_s=100e-9)
    direct = Response("gauss", FAST)
    for amplitude, seen in ((30.0, False), (400.0, True)):
        plain = received([20.0, 24.0], [3000.0, amplitude], direct, full_scale=2000.0, walk_table=False)
        under = received([20.0, 24.0], [3000.0, amplitude], coupled, full_scale=2000.0, walk_table=False)
        assert plain.count[0] == 2
        assert (under.count[0] == 2) == seen
        if seen:
            assert 0.01 < under.range_m[0, 1] - plain.range_m[0, 1] < 0.5, "its edge comes late"
            assert under.amplitude[0, 1] < plain.amplitude[0, 1] - 50.0


def test_late_charge_blinds_for_longer() -> None:
    slow = Response("single_pole", FAST, tail_share=0.02, tail_s=30e-9)
    for filter_, echoes in ((Response("single_pole", FAST), 2), (slow, 1)):
        found = received([20.0, 26.0], [1e6, 60.0], filter_, full_scale=20_000.0)
        assert found.count[0] == echoes
