"""What is told of a recorded run that somebody else moved: truth, classes, sizes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from emulator.judging.trial import Trial
from emulator.live.json_lines import update_of
from emulator.objects.truth import Witness
from emulator.recording.reader import read_run
from emulator.run_report.truth import truth_of
from emulator.scenario.scenario import load
from emulator.view.recorded import RecordedSource
from emulator.world import scene
from emulator.world.feed_record import Played

SCENE = """
schema: 1
seed: 3
duration_s: 0.6
actors:
  - {id: ego}
  - {id: car, shape: {box: {size_m: [4, 30, 3]}}, material: white_plaster, motion: {at_m: [20, 0, 0]}}
sensors:
  - {id: front, model: sick-lms291-s05, mount: {actor: ego, at_m: [0, 0, 0.6]}, links: ["pty:./front"]}
live:
  feed: control
  ego: ego
  actors: {spawn: true, pool: 4, classes: {van: {class: truck}, thing: {}}}
"""


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("fed")
    (folder / "scene.yaml").write_text(SCENE)
    trial = Trial(load(str(folder / "scene.yaml")), record=folder / "run")
    assert trial.feeding is not None
    try:
        for k in range(1, 61):
            t = 0.01 * k
            actors = [
                {"id": "ego", "at_m": [3 * t, 0, 0], "reference": "origin"},
                {"id": "car", "at_m": [20 - 10 * t, 0, 0], "reference": "origin", "velocity_m_s": [-10, 0, 0]},
                {"id": "1", "at_m": [8, 9, 1], "class": "van", "size_m": [5, 2, 2]},
                {"id": "2", "at_m": [8, -9, 1], "class": "pedestrian", "size_m": [0.5, 0.5, 1.8]},
                {"id": "3", "at_m": [4, -9, 1], "class": "thing", "size_m": [0.5, 0.5, 1.8]},
            ]
            trial.feeding.take(update_of({"t_s": t, "actors": actors}), trial.run.clock.now_ns(), again=True)
            trial.run.advance(round(t * 1e9))
        trial.finish()
    finally:
        trial.close()
    return folder / "run"


def test_truth_of_a_recording_has_fed_actors_where_they_were(recording: Path) -> None:
    run = read_run(recording)
    _, truth = truth_of(run.scenario, recording / "scenario.yaml", pytest.fail)
    assert truth is not None
    tally = truth.tally_of("front")
    scans = run.scans["front"]
    assert len(scans) > 10
    middle = len(scans[0].azimuth_rad) // 2
    for scan in scans[2:]:
        t_s = scan.start_ns * 1e-9 + np.array([0.5 * 0.0133, 0.5 * 0.0133])
        truth.place(float(t_s[0]), float(t_s[-1]))
        true_m, _ = truth.ranges("front", t_s, scan.azimuth_rad[middle : middle + 2], np.zeros(2))
        assert scan.range_m[middle, 0] == pytest.approx(true_m[0], abs=0.15)
    assert tally.offsets_s is None


def test_the_page_shows_them_there_too(recording: Path) -> None:
    source = RecordedSource(recording / "run.mcap")
    world = scene.build(source.scenario)
    assert world.fed is not None
    assert source.played is not None
    world.fed.use(source.played.world(0.3, 0.3))
    car = world.motions[world.index["car"]].position(np.array([0.3]))
    assert car[0] == pytest.approx([17.0, 0.0, 0.0], abs=1e-6)


def test_actors_that_come_have_their_class_and_size(recording: Path) -> None:
    scenario = load(str(recording / "scenario.yaml"))
    world = scene.build(scenario)
    assert world.fed is not None
    assert world.class_of("live_000") == "unknown", "it is not there"
    world.fed.use(Played(scenario, recording).world(0.3, 0.4))
    assert [world.class_of(f"live_{k:03d}") for k in range(4)] == ["truck", "pedestrian", "unknown", "unknown"]
    found = Witness(world, scenario.sensors[0].mount).objects(0.3)
    named = {one.actor: one for one in found.values()}
    assert set(named) == {"car", "live_000", "live_001", "live_002"}, "one of the pool is not there"
    assert named["live_000"].size_m == pytest.approx((5.0, 2.0, 2.0))
    assert named["live_000"].position_m[:2] == pytest.approx((8.0 - 0.9, 9.0), abs=1e-3)
