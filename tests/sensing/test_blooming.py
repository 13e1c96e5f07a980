"""Sidelobes of the beam and blooming of the receiver, against their closed forms."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.special import ndtr

from emulator.errors import ScenarioError
from tests.sensing.rig import QUIET, build, plan, plate

CLEAR: dict[str, Any] = {"visibility_m": 1e9}
WIDE = {"sidelobe_share": 0.01, "sidelobe_mrad": 60.0}


def test_sidelobes_see_a_half_plane_as_the_integral_of_both_gaussians_says(tmp_path: Path) -> None:
    """The plate's edge is `off` beside the axis: share Phi(-2 off/w) of each Gaussian."""
    physics = {**QUIET, "rule": "grid", "sub_beams": 1024, "full_scale_snr": "off", "exit_diameter_mm": 0.0}
    for off in (0.1, 0.2):
        world = [plate(10.0, "retro_sheeting", 100.0, 50.0 + off)]
        kind: dict[str, Any] = {"model": "sick-lms291-s05", "weather": CLEAR}
        assert np.isnan(build(tmp_path, world, physics=physics, **kind)(plan()).range_m[0, 0]) == (off > 0.15)
        scan = build(tmp_path, world, physics={**physics, **WIDE}, **kind)(plan())
        assert scan.range_m[0, 0] == pytest.approx(10.0, abs=0.03)
        share = 0.01 * ndtr(-2.0 * off / 0.3) + 0.99 * ndtr(-2.0 * off / 0.0645)
        snr = 45000.0 / 100.0 * (np.pi * 70.0 + 0.3) * share
        assert scan.intensity[0, 0] == pytest.approx(snr / 5.0, rel=0.05)


def test_all_light_is_still_there(tmp_path: Path) -> None:
    physics = {**QUIET, "full_scale_snr": "off"}
    one, other = (
        build(tmp_path, [plate(20.0, "half")], weather=CLEAR, physics={**physics, **more})(plan()).intensity[0, 0]
        for more in ({}, WIDE)
    )
    assert other == pytest.approx(one, rel=3e-3)


def test_a_saturating_echo_blooms_into_beams_that_listen_and_no_others(tmp_path: Path) -> None:
    azimuth = np.array([-4.0, -2.0, -1.0, 0.0, 1.0, 2.0, 4.0])
    physics = {**QUIET, "rule": "axis", "full_scale_snr": 20000}
    world = [plate(5.0, "retro_sheeting", 0.1)]
    for more, seen in (({}, 1), ({"bloom_share": 1e-3, "bloom_mrad": 35.0}, 5)):
        measure = build(tmp_path, world, weather=CLEAR, physics={**physics, **more})
        scan = measure(plan(azimuth))
        assert np.count_nonzero(np.isfinite(scan.range_m[:, 0])) == seen
        if more:
            full = 75000.0 / 25.0 * np.pi * 70.0
            for beam in (1, 2):
                expected = 1e-3 * full * np.exp(-2.0 * (np.radians(azimuth[beam]) / 0.035) ** 2)
                assert scan.intensity[beam, 0] * measure.model.threshold == pytest.approx(expected, rel=0.01)
                assert scan.range_m[beam, 0] == pytest.approx(5.0, abs=0.05)
    # fired 20 ns later each: the light comes 3 m nearer in each
    staggered = measure(plan(azimuth, fire_s=20e-9 * np.arange(7)))
    assert staggered.range_m[2, 0] == pytest.approx(8.0, abs=0.05)
    assert staggered.range_m[4, 0] == pytest.approx(2.0, abs=0.05)
    late = measure(plan(azimuth, fire_s=1e-4 * np.arange(7)))
    assert np.count_nonzero(np.isfinite(late.range_m)) == 1


@pytest.mark.parametrize(
    ("physics", "message"),
    [
        ({"sidelobe_share": 0.01}, "sidelobe_share without sidelobe_mrad"),
        ({**WIDE, "rule": "adaptive"}, "sidelobe_share with rule adaptive"),
        ({"bloom_share": 0.01, "bloom_mrad": 10, "full_scale_snr": "off"}, "bloom_share without full_scale_snr"),
    ],
)
def test_keys_that_do_not_fit_are_refused(tmp_path: Path, physics: dict[str, Any], message: str) -> None:
    with pytest.raises(ScenarioError, match=message):
        build(tmp_path, physics=physics)
