"""A recorded run of sensors with a scan pattern, on a car that moves while a frame is drawn."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from emulator.judging.trial import Trial, Verdict
from emulator.recording import clouds
from emulator.recording.layout import RecordedScan
from emulator.recording.reader import RecordedRun, read_run
from emulator.scenario import scenario

SPEED_M_S, WALL_M = 20.0, 30.0
SENSORS = ("raster", "rosette", "lissajous")
CASE = """\
schema: 1
seed: 1
duration_s: 0.55
world:
  - {plane: {size_m: [60, 60]}, at_m: [30, 0, 0], pitch_deg: -90, material: white_plaster}
actors:
  - {id: cart, motion: {at_m: [0, 0, 0], velocity_m_s: [20, 0, 0]}}
  - {id: post, shape: {box: {size_m: [0.5, 1, 1]}}, material: white_plaster, motion: {at_m: [25, 0, 0]}}
sensors:
""" + "".join(
    f"""\
  - {{id: {name}, model: solid-state-{name}, mount: {{actor: cart, at_m: [0, 0, 0]}}, device: {{boot_s: 0}},
     physics: {{noise: false, rule: axis, sub_beams: 1}}}}
"""
    for name in SENSORS
) + """\
expect:
""" + "".join(
    f"""\
  - {{that: {name}.range_error_m, within: [0, 0.0009]}}
  - {{that: count({name}.range_error_m), at_least: 3}}
  - {{that: {name}.points_on(post), at_least: 20}}
  - {{that: {name}.coverage, equals: 1}}
  - {{that: 'min({name}.nearest_in(":, -0.5:0.5, 0:0.5"))', within: [12.75, 23]}}
  - {{that: {name}.turns_per_s, within: [9.99, 10.01]}}
  - {{that: {name}.input_dropped + {name}.scans_dropped, equals: 0}}
"""
    for name in SENSORS
)  # fmt: skip


@pytest.fixture(scope="module")
def reported(tmp_path_factory: pytest.TempPathFactory) -> tuple[Verdict, RecordedRun]:
    folder = tmp_path_factory.mktemp("patterns") / "run"
    trial = Trial(scenario.loads(CASE, Path("case.yaml")), record=folder)
    verdict = trial.finish()
    trial.close()
    return verdict, read_run(folder)


def test_expectations_look_at_whole_frames(reported: tuple[Verdict, RecordedRun]) -> None:
    verdict = reported[0]
    assert len(verdict.judgements) == 7 * len(SENSORS)
    assert [one for one in verdict.judgements if not one.held] == []


@pytest.mark.parametrize("name", SENSORS)
def test_each_point_is_measured_at_its_own_instant_and_pose(reported: tuple[Verdict, RecordedRun], name: str) -> None:
    run = reported[1]
    points = clouds.points_of(run, name, 0, clouds.where_of(run), 0.1, 0.3, True)
    wall = points[points["actor"] == 0]
    assert len(wall) > 10_000
    assert np.abs(wall["x"] - WALL_M).max() < 2e-4
    own = clouds.points_of(run, name, 0, None, 0.1, 0.3, True)
    own = own[own["actor"] == 0]
    np.testing.assert_allclose(own["x"], WALL_M - SPEED_M_S * own["time"], atol=2e-4)
    assert np.ptp(own["x"]) > 3.0
    assert len(np.unique(wall["time"])) > 0.99 * len(wall), "one instant each"


def test_rows_of_a_raster_are_layers_and_a_rosette_has_none(reported: tuple[Verdict, RecordedRun]) -> None:
    rings = {name: np.unique(clouds.points_of(reported[1], name, 0, None, 0.0, 0.3, True)["ring"]) for name in SENSORS}
    assert rings["raster"].tolist() == list(range(64))
    assert rings["rosette"].tolist() == rings["lissajous"].tolist() == [0]


def test_layers_are_no_longer_sought_where_there_are_none() -> None:
    some = [
        RecordedScan(0, k, 0, np.zeros(2000), np.zeros((2000, 1)), np.zeros((2000, 1)), np.zeros((2000, 1), np.int32),
                     (), (), np.linspace(-0.2, 0.2, 2000) + 1e-4 * k)
        for k in range(3)
    ]  # fmt: skip
    assert len(clouds.layers(some)) == 0
    assert len(clouds.layers([])) == 0
