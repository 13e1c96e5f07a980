"""Beams that do not begin in the sensor's origin, recorded: points, what the report compares, and the page."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from emulator.judging.trial import Trial
from emulator.recording import clouds, streaming
from emulator.recording.reader import RecordedRun, read_run
from emulator.run_report.truth import truth_of
from emulator.scenario import scenario
from emulator.view.points import cloud
from emulator.view.recorded import _shown

WALL_M = 2.0
CASE = """\
schema: 1
seed: 1
duration_s: 0.35
world:
  - {box: {size_m: [0.5, 40, 40]}, at_m: [2.25, 0, -20], material: white_plaster}
sensors:
  - id: roof
    model: ouster-os0-32
    physics: {noise: false, rule: axis}
    device: {boot_s: 0, init_s: 0, spin_up_s: 0, config: {lidar_mode: 512x10, min_range_threshold_cm: 0}}
expect:
  - {that: 'max(roof.points_in("1.9:1.9999, :, :"))', equals: 0}
  - {that: 'min(roof.points_in("1.9999:2.0001, :, :"))', at_least: 1000}
"""


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> RecordedRun:
    folder = tmp_path_factory.mktemp("origins") / "run"
    trial = Trial(scenario.loads(CASE, Path("case.yaml")), record=folder)
    verdict = trial.finish()
    assert all(one.held for one in verdict.judgements), verdict.judgements
    trial.close()
    return read_run(folder)


@pytest.mark.parametrize("frame", ["world", "sensor"])
def test_exported_points_are_on_the_wall(run: RecordedRun, frame: str) -> None:
    where = clouds.where_of(run) if frame == "world" else None
    points = clouds.points_of(run, "roof", 0, where, 0.0, 1.0, False)
    assert len(points) > 5000
    assert np.abs(points["x"] - WALL_M).max() < 1e-4


def test_truth_of_a_report_begins_where_the_beams_do(run: RecordedRun) -> None:
    _, truth = truth_of(run.scenario, run.path, print)
    assert truth is not None
    tally = truth.tally_of("roof")
    tally.offsets_s = np.zeros(len(run.scans["roof"][0].azimuth_rad))
    for item in streaming.items(run.path, streaming.Progress()):
        if isinstance(item, streaming.Measured):
            tally.add(item.scan)
    tally.flush()
    errors = tally.tally.by_actor[0]
    assert errors.count > 5000
    assert max(-errors.least_m, errors.most_m) < 1e-4


def test_the_page_shows_them_there(run: RecordedRun) -> None:
    where = clouds.where_of(run)
    found = [cloud(where.scene, where.mount("roof"), _shown(run, "roof", at), "actor") for at in range(16)]
    assert np.abs(np.concatenate([one.points_m for one in found])[:, 0] - WALL_M).max() < 1e-4
    begun = np.concatenate([one.origins_m for one in found])
    np.testing.assert_allclose(np.hypot(begun[:, 0], begun[:, 1]), 0.027116, atol=1e-6)
