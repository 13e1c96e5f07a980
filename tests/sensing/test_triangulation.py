"""RPLIDARs and YDLIDARs through the whole path: rated ranges and accuracy, near limit, dark targets, sunlight."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from protocols.scan import DAZZLED
from tests.sensing.rig import build, grey, plan, plate
from tests.sensing.test_cola_ranges import share_seen

BEAMS = np.linspace(-1.0, 1.0, 400)
SUN = {"sun": {"total_w_m2": 1370.0, "azimuth_deg": 180.0, "elevation_deg": 30.0}}


def ranges(folder: Path, model: str, range_m: float, rho: float = 0.9) -> np.ndarray:
    """What is reported of a plate there, less the true range."""
    measure = build(folder, [plate(range_m, "target")], materials={"target": grey(rho)}, model=model)
    found = measure(plan(BEAMS)).range_m[:, 0] - range_m / np.cos(np.radians(BEAMS))
    return np.asarray(found[~np.isnan(found)])


@pytest.mark.parametrize(("model", "dark_m", "bright_m", "largest_m"), [
    ("rplidar-a1m8", 4.0, 12.0, 12.0), ("rplidar-a3m1", 10.0, 25.0, 25.0), ("rplidar-s1m1", 13.3, 40.0, 40.0),
    ("rplidar-s2m1", 10.0, 30.0, 30.0), ("rplidar-s3m1", 15.0, 40.0, 40.0), ("rplidar-c1m1", 6.0, 16.0, 16.0),
    ("ydlidar-x2", 2.83, 8.0, 8.0), ("ydlidar-x4", 3.53, 10.0, 10.0), ("ydlidar-g4", 5.65, 16.0, 16.0),
    ("ydlidar-tg15", 5.3, 15.0, 15.0), ("ydlidar-t-mini", 4.24, 12.0, 12.0), ("ldrobot-ld19", 4.53, 12.0, 12.0),
    ("ldrobot-stl-27l", 9.45, 25.0, 25.0),
])  # fmt: skip
def test_rated_ranges_are_met_through_the_path(
    tmp_path: Path, model: str, dark_m: float, bright_m: float, largest_m: float
) -> None:
    assert share_seen(tmp_path, model, 0.1, 0.97 * dark_m) > 0.5
    assert share_seen(tmp_path, model, 0.1, 1.12 * dark_m) < 0.5
    assert share_seen(tmp_path, model, 0.9, 0.95 * bright_m) > 0.5
    assert share_seen(tmp_path, model, 0.9, 1.03 * largest_m) == 0.0


@pytest.mark.parametrize(("model", "range_m", "share"), [
    ("rplidar-a1m8", 1.0, 0.01), ("rplidar-a1m8", 6.0, 0.01), ("rplidar-a1m8", 11.5, 0.01),
    ("rplidar-a3m1", 3.0, 0.01), ("rplidar-a3m1", 5.0, 0.02), ("rplidar-a3m1", 24.0, 0.025),
    ("ydlidar-x2", 1.0, 0.02), ("ydlidar-x2", 7.6, 0.02), ("ydlidar-x4", 1.0, 0.02), ("ydlidar-x4", 9.5, 0.02),
    ("ydlidar-g4", 1.0, 0.02), ("ydlidar-g4", 15.2, 0.02),
])  # fmt: skip
def test_rated_accuracy_of_triangulation_is_met_at_two_sigma(
    tmp_path: Path, model: str, range_m: float, share: float
) -> None:
    error = ranges(tmp_path, model, range_m)
    assert 2.0 * error.std() < share * range_m
    if range_m > 7.0 and "ydlidar" in model:
        assert 2.0 * error.std() > 0.6 * share * range_m, "at the end of the range it is what the rating says"
    assert abs(error.mean()) < 0.2 * share * range_m


@pytest.mark.parametrize("model", ["rplidar-a1m8", "ydlidar-x4", "ydlidar-g4"])
def test_the_error_grows_with_the_square_of_the_distance(tmp_path: Path, model: str) -> None:
    near, far = (ranges(tmp_path, model, range_m).std() for range_m in (0.75, 3.0))
    assert far / near == pytest.approx(16.0, rel=0.35)
    if model != "rplidar-a1m8":
        return
    near, far = (ranges(tmp_path, model, range_m).std() for range_m in (1.5, 6.0))
    assert near == pytest.approx(0.5e-3, rel=0.3), "resolution of the data sheet"
    assert far / near == pytest.approx(16.0, rel=0.3)


def test_a_dark_target_scatters_more_than_a_bright_one(tmp_path: Path) -> None:
    dark, bright = (ranges(tmp_path, "rplidar-a1m8", 3.8, rho).std() for rho in (0.1, 0.9))
    assert dark > 1.2 * bright


def test_a_glossy_target_throws_the_light_away_unless_it_is_met_straight_on(tmp_path: Path) -> None:
    lacquer = {"rho": 0.02, "model": "ggx", "f0": 0.05, "roughness": 0.05, "lobe_share": 1.0}
    for turned, seen in ((0.0, True), (20.0, False)):
        measure = build(tmp_path, [{**plate(4.0, "lacquer"), "yaw_deg": turned}], materials={"lacquer": lacquer},
                        model="rplidar-a1m8")  # fmt: skip
        assert bool((~np.isnan(measure(plan([0.0])).range_m)).any()) == seen


def test_nearer_than_the_imager_reaches_there_is_no_echo(tmp_path: Path) -> None:
    assert len(ranges(tmp_path, "rplidar-a1m8", 0.14)) == 0
    assert len(ranges(tmp_path, "rplidar-a1m8", 0.16)) == len(BEAMS)
    for model, near_m in (("ydlidar-x2", 0.10), ("ydlidar-x4", 0.12), ("ydlidar-g4", 0.10)):
        assert len(ranges(tmp_path, model, near_m - 0.01)) == 0
        assert len(ranges(tmp_path, model, near_m + 0.01)) == len(BEAMS)


def test_a_sunlit_wall_blinds_an_a1_and_not_an_a3_nor_an_s2(tmp_path: Path) -> None:
    for model, blind in (("rplidar-a1m8", True), ("ydlidar-x2", True), ("ydlidar-g4", True), ("ydlidar-tg15", False),
                         ("rplidar-a3m1", False), ("rplidar-s2m1", False)):  # fmt: skip
        measure = build(tmp_path, [plate(3.0, "white")], weather=SUN, model=model)
        scan = measure(plan(BEAMS))
        assert bool((scan.flags & DAZZLED).all()) == blind, model
        assert bool(np.isnan(scan.range_m).all()) == blind, model
