"""Statistical errors of today's scanners through the whole path: receiver and detection together meet the rating."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.sensing.rig import build, grey, plan, plate

BEAMS = np.linspace(-1.0, 1.0, 3200)
NOISE_ECHO_M = 0.6
"Farther from the target it is an echo of noise."


def sigma_mm(folder: Path, model: str, range_m: float) -> float:
    """One sigma of what is reported of a white plate there."""
    measure = build(folder, [plate(range_m, "target")], materials={"target": grey(0.9)}, model=model)
    error = measure(plan(BEAMS)).range_m[:, 0] - range_m / np.cos(np.radians(BEAMS))
    seen = np.abs(error) < NOISE_ECHO_M
    assert seen.mean() > 0.97
    return 1000.0 * float(error[seen].std())


@pytest.mark.parametrize(("model", "range_m", "rated_mm"), [
    ("hokuyo-utm-30lx", 10.0, 10.0), ("hokuyo-utm-30lx-ew", 10.0, 10.0), ("hokuyo-urg-04lx", 1.0, 5.0),
    ("hokuyo-ubg-04lx-f01", 1.0, 5.0), ("hokuyo-uhg-08lx", 1.0, 10.0), ("rplidar-s1m1", 20.0, 15.0),
    ("rplidar-s2m1", 15.0, 10.0), ("rplidar-s3m1", 20.0, 10.0), ("rplidar-c1m1", 8.0, 10.0),
    ("ldrobot-ld06", 6.0, 10.0), ("ldrobot-ld19", 6.0, 10.0), ("ldrobot-stl-27l", 12.0, 10.0),
    ("ydlidar-t-mini", 6.0, 6.7), ("ydlidar-tg15", 7.5, 13.3), ("sick-lms500", 10.0, 6.0), ("sick-lms511", 10.0, 6.0),
    ("sick-lms511", 20.0, 8.0), ("sick-tim551", 5.0, 20.0), ("sick-tim561", 5.0, 20.0), ("sick-tim571", 5.0, 20.0),
    ("sick-mrs1104", 15.0, 30.0),
])  # fmt: skip
def test_the_statistical_error_is_the_rated_one(tmp_path: Path, model: str, range_m: float, rated_mm: float) -> None:
    """At the end of the interval that the rating names; where it names none, at half the rated range."""
    assert sigma_mm(tmp_path, model, range_m) == pytest.approx(rated_mm, rel=0.07)


@pytest.mark.parametrize(("model", "range_m", "most_mm"), [
    ("hokuyo-utm-30lx", 25.0, 30.0), ("hokuyo-ust-10lx", 9.5, 30.0), ("hokuyo-ust-20lx", 19.0, 30.0),
    ("hokuyo-urg-04lx", 2.0, 10.0), ("hokuyo-urg-04lx", 3.4, 17.0), ("hokuyo-uhg-08lx", 4.0, 40.0),
    ("sick-lms511", 30.0, 14.0), ("sick-lms111", 4.0, 12.0), ("sick-lms111", 18.0, 20.0),
])  # fmt: skip
def test_farther_out_it_stays_within_the_rating(tmp_path: Path, model: str, range_m: float, most_mm: float) -> None:
    assert sigma_mm(tmp_path, model, range_m) <= most_mm
