"""Strong echoes not far behind the one of fog: in closed form, also from a valley that noise puts over their level.

Here: the closed form beside the sampled waveform. Not here: media much fainter than the threshold (test_closed_forms).
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from emulator.physics.cosines import split_cosines
from emulator.physics.detection import detect
from emulator.physics.subechoes import SubEchoes
from tests.sensing.rig import build


@pytest.mark.parametrize("deviations", [0.0, 2.5, 3.6, 3.8, 4.0, 4.4, 5.5])
@pytest.mark.parametrize("spread_m", [0.0, 0.1])
def test_a_strong_echo_in_fog_is_crossed_where_its_sampled_waveform_is(
    tmp_path: Path, deviations: float, spread_m: float
) -> None:
    measure = build(tmp_path, weather={"fog": {"visibility_m": 500.0}}, model="velodyne-vlp-16")
    soft, detector = measure._soft.everywhere(measure.air.at(0.0)), measure._receiver.detector
    assert soft is not None
    n = 60
    range_m, height = np.linspace(7.0, 12.0, n), np.tile([60.0, 400.0, 1e4], n // 3)
    places = (range_m[:, None] + spread_m * np.array([0.0, 1.0])).ravel()
    share = np.full(2 * n, 0.5)
    given = SubEchoes.of(np.arange(n).repeat(2), places, height.repeat(2) * share, share, np.zeros(2 * n, np.int64))
    closed, _ = split_cosines(given, detector, soft)
    under = soft.wave(range_m - detector.pulse.half_support_m) / detector.threshold
    assert np.isin(np.arange(n), closed.beam).tolist() == (under < 0.3).tolist()
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
