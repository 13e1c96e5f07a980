"""Echoes behind the one of fog: in closed form, also from a valley that is over their level.

Here: the closed form beside the sampled waveform. Not here: media much fainter than the threshold (test_closed_forms).
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from emulator.physics.cosines import TALL, split_cosines
from emulator.physics.detection import detect
from emulator.physics.detector import Detector
from emulator.physics.softprofile import SoftProfile
from emulator.physics.subechoes import SubEchoes
from tests.sensing.rig import build


def fog_of(folder: Path, model: str, visibility_m: float) -> tuple[SoftProfile, Detector]:
    measure = build(folder, weather={"fog": {"visibility_m": visibility_m}}, model=model)
    soft = measure._soft.everywhere(measure.air.at(0.0))
    assert soft is not None
    return soft, measure._receiver.detector


@pytest.mark.parametrize("deviations", [0.0, 2.5, 3.6, 3.8, 4.0, 4.4, 5.5])
@pytest.mark.parametrize("spread_m", [0.0, 0.1])
def test_a_strong_echo_in_fog_is_crossed_where_its_sampled_waveform_is(
    tmp_path: Path, deviations: float, spread_m: float
) -> None:
    soft, detector = fog_of(tmp_path, "velodyne-vlp-16", 500.0)
    n = 60
    range_m, height = np.linspace(7.0, 12.0, n), np.tile([60.0, 400.0, 1e4], n // 3)
    places = (range_m[:, None] + spread_m * np.array([0.0, 1.0])).ravel()
    share = np.full(2 * n, 0.5)
    given = SubEchoes.of(np.arange(n).repeat(2), places, height.repeat(2) * share, share, np.zeros(2 * n, np.int64))
    closed, _ = split_cosines(given, detector, soft)
    under = soft.wave(range_m - detector.pulse.half_support_m) / detector.threshold
    assert len(closed) == n
    assert (np.abs(under - 0.2) < 0.1).sum() > 10
    normals = np.tile([0.0, deviations, 0.0, 0.0], (n, 1))  # the medium's own echo is higher, or is the second
    normals[height > soft.peak] = [deviations, 0.0, 0.0, 0.0]
    fast, whole = (
        detect(given, n, one, normals=normals, soft=soft) for one in (detector, replace(detector, sampled=True))
    )
    np.testing.assert_array_equal(np.isfinite(fast.range_m), np.isfinite(whole.range_m))
    assert np.isfinite(fast.range_m).sum() >= n
    np.testing.assert_allclose(fast.range_m, whole.range_m, atol=4e-3)
    np.testing.assert_allclose(fast.amplitude, whole.amplitude, rtol=2e-4, atol=2e-3)


@pytest.mark.parametrize("deviations", [0.0, 3.8, 5.5])
@pytest.mark.parametrize("little", [0.0, 1e-6, 1e-2])
def test_what_sends_little_back_before_an_echo_leaves_its_place(
    tmp_path: Path, little: float, deviations: float
) -> None:
    """Its pulse never rises as steeply as the fog before it falls."""
    soft, detector = fog_of(tmp_path, "velodyne-vlp-16", 500.0)
    n = 60
    range_m, height = np.linspace(6.0, 12.0, n), np.tile([60.0, 400.0, 1e4], n // 3)
    places = (range_m[:, None] + np.array([0.0, 0.02])).ravel()
    both = np.stack([np.full(n, little), height], axis=1).ravel()
    given = SubEchoes.of(np.arange(n).repeat(2), places, both, np.full(2 * n, 0.5), np.zeros(2 * n, np.int64))
    normals = np.zeros((n, 4))
    normals[np.arange(n), (height <= soft.peak).astype(int)] = deviations
    fast, whole = (
        detect(given, n, one, normals=normals, soft=soft) for one in (detector, replace(detector, sampled=True))
    )
    np.testing.assert_array_equal(np.isfinite(fast.range_m), np.isfinite(whole.range_m))
    assert np.isfinite(fast.range_m).sum() >= n
    np.testing.assert_allclose(fast.range_m, whole.range_m, atol=4e-3)


@pytest.mark.parametrize("model", ["velodyne-vlp-16", "velodyne-vlp-32c", "ouster-os1-128", "sick-lms291-s05"])
@pytest.mark.parametrize("visibility_m", [60.0, 500.0])
@pytest.mark.parametrize("sun", [1.0, 1.7])
def test_an_echo_higher_than_the_fog_under_it_is_as_if_it_were_sampled(
    tmp_path: Path, model: str, visibility_m: float, sun: float
) -> None:
    """Fog from a tenth of the threshold to many times it, pulses of eight times the fog and more."""
    soft, detector = fog_of(tmp_path, model, visibility_m)
    detector = replace(detector, floor_m2=0.0, keep="all", max_echoes=4, near_gate_m=0.0, resolution_m=1e-3)
    n, half = 4000, detector.pulse.half_support_m
    rng = np.random.default_rng(3)
    first = soft.peak_m + 2.0 * soft.bin_m + half + rng.uniform(0.0, 25.0, n)
    fog, dark = soft.wave(first - half), np.full(n, sun)
    count, spread = rng.integers(1, 4, n), half * rng.uniform(0.0, 0.98, (n, 3))
    spread[:, 0] = 0.0
    part = 10.0 ** rng.uniform(-2.0, 0.0, (n, 3)) * (np.arange(3) < count[:, None])
    part *= 1.01 * (np.where(count > 1, 2.0, 1.0) * np.maximum(TALL * fog, fog + sun))[:, None] / part.sum(1)[:, None]
    part *= 10.0 ** (rng.uniform(0.0, 2.0, n) * (rng.random(n) < 0.7))[:, None]
    part *= np.where(part.sum(1) < detector.full_scale, 1.0, 0.0)[:, None]
    blocked = rng.uniform(0.0, 0.3, (n, 3)) * (part > 0.0)
    given = SubEchoes.from_grid(np.where(part > 0.0, first[:, None] + spread, np.nan), part, blocked)
    closed, _ = split_cosines(given, detector, soft, dark)
    high = fog > 0.1 * detector.threshold
    assert (high & np.isin(np.arange(n), closed.beam)).sum() > 150
    normals = rng.standard_normal((n, 4)) * rng.choice([0.0, 1.0, 3.0], (n, 1))
    fast, whole = (
        detect(given, n, one, normals=normals, noise=dark, soft=soft)
        for one in (detector, replace(detector, sampled=True))
    )
    np.testing.assert_array_equal(fast.count, whole.count)
    np.testing.assert_array_equal(fast.source, whole.source)
    np.testing.assert_allclose(fast.amplitude, whole.amplitude, rtol=1e-3, atol=2e-3)
    off = np.abs(fast.range_m - whole.range_m)[np.isfinite(fast.range_m)]
    assert float(off.max()) < 6e-3  # in a noise unit of the valley a place goes from it to the single echo's
    assert np.count_nonzero(off > 1e-3) <= 3
    assert np.count_nonzero(off > 2e-4) <= 0.01 * n
