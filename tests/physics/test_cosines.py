"""Short clusters crossed in closed form, against bisection on the sum of pulses itself."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from emulator.physics.cosines import split_cosines
from emulator.physics.detection import detect
from emulator.physics.detector import Detector
from emulator.physics.pulse import Pulse
from emulator.physics.subechoes import SubEchoes
from tests.draws import cases

PULSE = Pulse(4e-9)
DETECTOR = Detector(PULSE, threshold=5.0)
HALF_M = PULSE.half_support_m


def signal(x_m: float, range_m: np.ndarray, amplitude: np.ndarray) -> float:  # type: ignore[type-arg]
    return float(np.sum(amplitude * PULSE.profile(x_m - range_m)))


def signals(x_m: np.ndarray, range_m: np.ndarray, amplitude: np.ndarray) -> np.ndarray:  # type: ignore[type-arg]
    return np.asarray((amplitude * PULSE.profile(x_m[:, None] - range_m)).sum(axis=1))


def first_crossing(level: float, range_m: np.ndarray, amplitude: np.ndarray) -> float:  # type: ignore[type-arg]
    """By a fine grid and bisection."""
    grid = np.linspace(range_m[0] - HALF_M, range_m[-1] + HALF_M, 4001)
    above = signals(grid, range_m, amplitude) >= level
    if not above.any():
        return float("nan")
    first = int(np.argmax(above))
    hi, lo = grid[first], grid[first - 1]
    for _ in range(60):
        mid = 0.5 * (lo + hi)
        lo, hi = (mid, hi) if signal(mid, range_m, amplitude) < level else (lo, mid)
    return float(hi)


@settings(max_examples=cases(60), deadline=None)
@given(
    spread=st.lists(st.integers(0, 990).map(lambda thousandth: 1e-3 * thousandth), min_size=1, max_size=8),
    weight=st.lists(st.floats(0.01, 1.0), min_size=8, max_size=8),
    strength=st.floats(6.0, 1e4),
    share=st.floats(0.001, 0.98),
)
def test_a_short_cluster_is_crossed_where_its_pulses_say(
    spread: list[float], weight: list[float], strength: float, share: float
) -> None:
    range_m = 20.0 + HALF_M * np.sort(np.asarray(spread))
    amplitude = strength * np.asarray(weight[: len(spread)])
    found, rest = split_cosines(SubEchoes.of(np.zeros(len(spread), np.int64), range_m, amplitude), DETECTOR)
    assert (len(found), len(rest)) == (1, 0)
    level = share * float(found.height[0])
    assert signal(float(found.centre_m[0]), range_m, amplitude) == pytest.approx(float(found.height[0]), rel=1e-9)
    assert found.crossing(np.array([level]))[0] == pytest.approx(first_crossing(level, range_m, amplitude), abs=1e-6)


@settings(max_examples=cases(60), deadline=None)
@given(
    spread=st.lists(
        st.integers(0, 4000).map(lambda thousandth: 1e-3 * thousandth), min_size=2, max_size=9, unique=True
    ),
    weight=st.lists(st.floats(0.01, 1.0), min_size=9, max_size=9),
    share=st.floats(0.001, 0.9999),
)
def test_a_sampled_cluster_is_crossed_where_its_pulses_say(
    spread: list[float], weight: list[float], share: float
) -> None:
    range_m = 20.0 + HALF_M * np.sort(np.asarray(spread))
    amplitude = np.asarray(weight[: len(spread)])
    grid = np.linspace(range_m[0] - HALF_M, range_m[-1] + HALF_M, 4001)
    amplitude *= 5.0 / (share * signals(grid, range_m, amplitude).max())
    wanted = first_crossing(5.0, range_m, amplitude)
    beams = 3  # what other beams have changes nothing
    echoes = SubEchoes.of(np.arange(beams).repeat(len(spread)), np.tile(range_m, beams), np.tile(amplitude, beams))
    detector = Detector(PULSE, threshold=5.0, walk_table=False, sampled=True, resolution_m=1e-9)
    found = detect(echoes, beams, detector)
    found_m = found.range_m[:, 0] - PULSE.start_lead_m + detector.offset_m
    assert found_m == pytest.approx(wanted, abs=2e-7) or (
        # what crosses between two samples and falls again before the second is seen by a parabola through three
        share > 0.98 and found_m == pytest.approx(wanted, abs=1.5 * detector.bin_m)
    )


def test_a_single_echo_is_crossed_as_its_pulse_alone() -> None:
    found, _ = split_cosines(SubEchoes.of(np.arange(3), np.full(3, 20.0), np.array([5.0001, 50.0, 1e9])), DETECTOR)
    expected = 20.0 - PULSE.lead(np.array([5.0001, 50.0, 1e9]) / 5.0)
    assert found.crossing(np.full(3, 5.0)) == pytest.approx(expected, abs=1e-9)


def test_wide_clusters_and_other_ways_of_timing_are_left_to_the_waveform() -> None:
    wide = SubEchoes.of(np.array([0, 0, 1]), np.array([20.0, 20.0 + 1.01 * HALF_M, 20.0]), np.full(3, 10.0))
    found, rest = split_cosines(wide, DETECTOR)
    assert found.beam.tolist() == [1]
    assert rest.beam.tolist() == [0, 0]
    for other in (Detector(PULSE, 5.0, "peak"), Detector(Pulse(4e-9, "gauss"), 5.0)):
        found, rest = split_cosines(wide, other)
        assert (len(found), len(rest)) == (0, 3)


def test_the_source_is_that_of_the_strongest_sub_echo() -> None:
    echoes = SubEchoes.of(
        np.zeros(3, np.int64), np.array([20.0, 20.01, 20.02]), np.array([10.0, 30.0, 20.0]), source=np.array([7, 8, 9])
    )
    assert split_cosines(echoes, DETECTOR)[0].source.tolist() == [8]
