"""Rated ranges of the models that speak CoLa, met through the whole path: world, light, receiver, detection."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.sensing.rig import build, grey, plan, plate

BEAMS = np.linspace(-1.0, 1.0, 200)

RATED = {  # range at 10 %, range at 90 %, largest range (SICK manuals and data sheets: see the models' spec files)
    "sick-lms100": (18.0, 20.0, 20.0),
    "sick-lms111": (18.0, 20.0, 20.0),
    "sick-lms151": (18.0, 50.0, 50.0),
    "sick-lms500": (26.0, 80.0, 80.0),
    "sick-lms511": (26.0, 80.0, 80.0),
    "sick-tim551": (8.0, 10.0, 10.0),
    "sick-tim561": (8.0, 10.0, 10.0),
    "sick-tim571": (8.0, 25.0, 25.0),
    "sick-tim781": (8.0, 25.0, 25.0),
    "sick-mrs1104": (16.0, 30.0, 64.0),
}
"The range up to which half of the beams see a target, as for the LMS291 (emulator.studies)."


def share_seen(folder: Path, model: str, rho: float, range_m: float) -> float:
    """Of the beams that look at a plate there, those that have its echo."""
    measure = build(folder, [plate(range_m, "target")], materials={"target": grey(rho)}, model=model)
    scan = measure(plan(BEAMS))
    near = np.abs(scan.range_m - range_m / np.cos(np.radians(BEAMS))[:, None]) < 0.5
    return float(near.any(axis=1).mean())


@pytest.mark.parametrize("model", RATED)
def test_rated_ranges_are_met_through_the_path(tmp_path: Path, model: str) -> None:
    dark_m, bright_m, largest_m = RATED[model]
    assert share_seen(tmp_path, model, 0.1, 0.97 * dark_m) > 0.5
    assert share_seen(tmp_path, model, 0.1, min(1.12 * dark_m, 1.02 * largest_m)) < 0.5
    assert share_seen(tmp_path, model, 0.9, 0.97 * bright_m) > 0.5
    assert share_seen(tmp_path, model, 0.9, 1.02 * largest_m) == 0.0
