"""`lidaremu report`: its numbers against closed forms and against `test --json`; its page; cut and old recordings."""

from __future__ import annotations

import csv
import json
import math
import shutil
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from emulator.commands.cli import main
from emulator.judging.trial import Trial, run_trial
from emulator.recording.chunks import McapFile
from emulator.recording.reader import read_run
from emulator.recording.streaming import Progress, items
from emulator.recording.writer import Recorder
from emulator.run_report import figures
from emulator.run_report.gather import Gathered, Happening, gather
from emulator.run_report.page import report_of
from emulator.run_report.sight import points_of
from emulator.run_report.weather import steps
from emulator.scenario import scenario as scenario_file
from emulator.studies.report import page
from tests.recording.older import write_older

EDGE_RAD = math.atan(30.0 / 8.0)
"The wall is 60 m long and 8 m away."
VOID = {"meta", "img", "br", "hr", "link", "input"}


class Checker(HTMLParser):
    """Tags that do not fit, and everything that would be loaded or followed."""

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.wrong: list[str] = []
        self.links: list[str] = []
        self.ids: list[str] = []
        self.tags: set[str] = set()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.add(tag)
        if tag not in VOID:
            self.open.append(tag)
        self.links += [value or "" for name, value in attrs if name in ("src", "href", "srcset", "action", "data")]
        self.ids += [value or "" for name, value in attrs if name == "id"]

    def handle_endtag(self, tag: str) -> None:
        if not self.open or self.open.pop() != tag:
            self.wrong.append(tag)


def checked(text: str) -> Checker:
    checker = Checker()
    checker.feed(text)
    checker.close()
    assert checker.open == []
    assert checker.wrong == []
    assert len(set(checker.ids)) == len(checker.ids)
    for link in checker.links:
        assert link.startswith("data:image/png;base64,") or link.removeprefix("#") in checker.ids
    assert "@import" not in text
    assert "url(" not in text
    assert not {"script", "link", "iframe", "object"} & checker.tags
    return checker


def report(capsys: pytest.CaptureFixture[str], *arguments: str) -> dict[str, Any]:
    assert main(["report", *arguments, "--json"]) == 0
    found: dict[str, Any] = json.loads(capsys.readouterr().out)
    return found


@pytest.mark.usefixtures("undrawn")
def test_a_wall_has_its_rate_and_the_errors_of_the_closed_form(
    wall: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    found = report(capsys, str(wall), "--out", str(tmp_path / "wall.html"))
    (front,) = found["sensors"]
    assert front["scans_per_s"] == pytest.approx(37.5, rel=1e-9)
    assert front["gap_s"]["median"] == pytest.approx(1.0 / 37.5, rel=1e-6)
    scans = read_run(wall).scans["front"]
    errors = []
    for scan in scans:
        on_it = np.abs(scan.azimuth_rad) < EDGE_RAD
        errors.append(scan.range_m[on_it, 0] - 8.0 / np.cos(scan.azimuth_rad[on_it]))
    error = np.concatenate(errors)
    seen = error[np.isfinite(error)]
    (world,) = front["ranges"]["actors"]
    assert (world["actor"], world["beams"]) == ("world", len(error))
    assert world["seen"] + world["air"] + world["other"] + world["missed"] == len(error)
    assert world["seen"] == pytest.approx(len(seen), abs=2)
    assert world["mean_m"] == pytest.approx(seen.mean(), abs=2e-5)
    assert world["sigma_m"] == pytest.approx(seen.std(ddof=1), rel=2e-3)
    assert front["ranges"]["sweeps"] == len(scans)
    assert found["files"] == [str(tmp_path / "wall.html")]


def test_the_page_stands_alone_and_is_valid_and_its_figures_and_numbers_lie_beside_it_on_demand(
    wall: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["report", str(wall), "--figures", "figures"]) == 0
    said = capsys.readouterr().out
    assert "2.0" in said
    assert "wall.html" in said
    text = (tmp_path / "wall.html").read_text(encoding="utf-8")
    checker = checked(text)
    assert text.startswith("<!DOCTYPE html>")
    assert sum(link.startswith("data:") for link in checker.links) >= 5
    for chapter in ("Rates and jitter", "Lateness and drops", "ranges against truth", "detection range", "Weather"):
        assert chapter in text
    for name in ("rates.png", "gaps.png", "front_errors.png", "front_detection.png", "time_line.png"):
        assert (tmp_path / "figures" / name).read_bytes()[:8] == b"\x89PNG\r\n\x1a\n"
    with (tmp_path / "figures" / "overview.csv").open(encoding="utf-8") as file:
        (row,) = csv.DictReader(file)
    with (tmp_path / "figures" / "front_error_histograms.csv").open(encoding="utf-8") as file:
        counts = [int(line["count"]) for line in csv.DictReader(file)]
    with (tmp_path / "figures" / "front_ranges.csv").open(encoding="utf-8") as file:
        assert sum(counts) == sum(int(line["seen"]) for line in csv.DictReader(file))
    assert row["sensor"] == "front"
    assert float(row["scans_per_s"]) == pytest.approx(37.5)


@pytest.mark.usefixtures("undrawn")
@pytest.mark.usefixtures("undrawn")
def test_object_lists_are_judged_as_by_the_trial(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    record = str(tmp_path / "rec")
    main(["test", "fog_objects", "--duration", "0.5", "--record", record, "--json"])
    verdict = json.loads(capsys.readouterr().out)
    found = report(capsys, f"{record}/fog_objects", "--out", str(tmp_path / "fog.html"))
    wanted = next(one["objects"] for one in verdict["sensors"] if one["id"] == "radar")
    mine = next(one["objects"] for one in found["sensors"] if one["id"] == "radar")
    assert mine == wanted
    assert mine["total"]["precision"] == 1.0
    text = (tmp_path / "fog.html").read_text(encoding="utf-8")
    checked(text)
    assert "radar: objects against truth" in text
    assert [step["fog_visibility_m"] for step in found["weather"]] == [None]


def test_ranges_of_things_that_move_are_taken_at_each_beams_instant(tmp_path: Path) -> None:
    """A wall that comes at 20 m/s: within a sweep of 27 ms it moves half a metre."""
    text = """
schema: 1
duration_s: 1
actors:
  - id: wall
    shape: {box: {size_m: [1, 40, 4]}}
    material: white_plaster
    motion: {at_m: [40, 0, -1], velocity_m_s: [-20, 0, 0]}
sensors:
  - id: front
    model: sick-lms291-s05
    mount: {at_m: [0, 0, 1]}
    links: ["pty:./front"]
"""
    loaded = scenario_file.loads(text, tmp_path / "moving.yaml")
    run_trial(loaded, record=tmp_path / "rec")
    tally = gather(tmp_path / "rec").sensors["front"].truth
    assert tally is not None
    assert tally.without_offsets == 0
    errors = tally.tally.by_actor[1]
    assert errors.count > 3_000
    assert abs(errors.percentile_m(0.5)) < 0.02
    assert errors.percentile_m(0.84) - errors.percentile_m(0.16) < 0.12


@pytest.mark.usefixtures("undrawn")
@pytest.mark.parametrize("share", [0.02, 0.9])
def test_a_cut_recording_is_reported_as_far_as_it_goes(wall: Path, tmp_path: Path, share: float) -> None:
    whole = (wall / "run.mcap").read_bytes()
    cut = tmp_path / "run.mcap"
    cut.write_bytes(whole[: int(share * len(whole))])
    run = gather(cut)
    assert run.cut
    assert any(remark.startswith("The recording is cut") for remark in run.remarks)
    checked(page(report_of(run)))


def test_what_is_no_recording_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "run.mcap").write_bytes(b"\x89MCAP0\r\n")
    (tmp_path / "x.txt").write_text("hello")
    for path in (tmp_path, tmp_path / "x.txt", tmp_path / "nothing"):
        assert main(["report", str(path), "--out", str(tmp_path / "x.html")]) == 2
        assert str(path) in capsys.readouterr().err
    assert main(["report", str(tmp_path), "--out", str(tmp_path / "no" / "x.html")]) == 2
    assert not (tmp_path / "x.html").exists()


@pytest.mark.usefixtures("undrawn")
def test_an_old_recording_without_beams_and_end_says_so(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Recorder, "_note_beams", lambda self, sensor, plan: None)
    add = McapFile.metadata
    monkeypatch.setattr(
        McapFile, "metadata", lambda self, name, table: add(self, name, table) if name == "lidaremu" else None
    )
    run_trial(scenario_file.load("flat_wall", ["duration_s=0.6"]), record=tmp_path / "rec")
    run = gather(tmp_path / "rec")
    reported = " ".join(run.remarks)
    assert "no counters of its end" in reported
    assert "front: instants of beams are not recorded for" in reported
    text = page(report_of(run))
    assert "Lateness is not in this recording." in text
    checked(text)


@pytest.mark.usefixtures("undrawn")
def test_a_recording_without_truth_says_so(tmp_path: Path) -> None:
    trial = Trial(scenario_file.load("flat_wall", ["duration_s=0.6"]))
    recorder = Recorder(tmp_path / "rec", trial.scenario, trial.instruments, truth=False)
    trial.finish()
    recorder.note(500_000_000, {"event": "Order", "order": "<script>alert(1)</script>", "x": '"><img src=x>'})
    recorder.note(
        500_000_001, {"event": "Order", "order": "weather", "change": {"t_s": 0.5, "rain": {"rate_mm_h": 12.0}}}
    )
    recorder.close()
    trial.close()
    run = gather(tmp_path / "rec")
    assert "No scans are recorded (recorded without truth): nothing is said of ranges and objects." in run.remarks
    text = page(report_of(run))
    checked(text)
    assert "&lt;script&gt;alert(1)&lt;/script&gt;" in text
    assert "<script" not in text
    assert "<img src=x" not in text
    assert run.scenario is not None
    found = steps(run.scenario, run.orders, run.duration_s)
    assert [(step.t_s, step.ordered, step.values["rain_mm_h"]) for step in found] == [
        (0.0, False, None),
        (0.5, True, 12.0),
    ]


@pytest.mark.usefixtures("undrawn")
def test_a_scene_that_cannot_be_built_again_leaves_the_rest(wall: Path, tmp_path: Path) -> None:
    copy = tmp_path / "rec"
    shutil.copytree(wall, copy)
    write_older(wall / "run.mcap", copy / "run.mcap", lambda text: text.replace(b"white_plaster", b"white_plastic"))
    run = gather(copy)
    assert run.sensors["front"].truth is None
    assert any(remark.startswith("The recorded sc") for remark in run.remarks)
    assert run.sensors["front"].rate_hz == pytest.approx(37.5)
    checked(page(report_of(run)))


def test_weather_follows_the_scenario_and_orders() -> None:
    loaded = scenario_file.load("fog_objects")
    orders = [Happening(14_500_000_000, "run", "order", "weather", {"change": {"t_s": 14.5, "fog": None}})]
    found = steps(loaded, orders, 15.5)
    fog = [(step.t_s, step.values["fog_visibility_m"]) for step in found]
    assert [(round(t_s, 9), value) for t_s, value in fog] == [
        (0.0, None),
        (10.0, 150.0),
        (11.0, 100.0),
        (12.0, 70.0),
        (13.0, 50.0),
        (14.0, 36.0),
        (14.5, None),
        (15.0, 25.0),
    ]
    assert [round(step.t_s, 9) for step in found if step.ordered] == [14.5]


def test_volumes_sun_and_the_air_itself_are_weather_too() -> None:
    weather = "{visibility_m: 800, sun: {elevation_deg: 30}, layers: [{top_m: 2, fog: {visibility_m: 40}}]}"
    (found,) = steps(scenario_file.load("flat_wall", [f"weather={weather}"]), [], 1.0)
    shown = {head: value for head, value in found.values.items() if value is not None}
    assert shown == {"sun_w_m2": 1370.0, "sun_elevation_deg": 30.0, "air_visibility_m": 800.0, "layers": 1.0}


def test_faults_are_spans_on_the_time_line(tmp_path: Path) -> None:
    def fault(at_ns: int, number: int, what: str) -> Happening:
        return Happening(at_ns, "front", "fault", f"fog {what}", {"number": number, "what": what})

    happenings = [fault(1_000_000_000, 0, "begin"), fault(2_000_000_000, 1, "begin"), fault(3_000_000_000, 0, "end")]
    assert figures.fault_spans(happenings, "front", 9.0) == [(1.0, 3.0), (2.0, 9.0)]
    run = Gathered(tmp_path, last_ns=9_000_000_000)
    assert figures.time_line(run, happenings)[:4] == b"\x89PNG"


@pytest.mark.usefixtures("undrawn")
def test_faults_of_a_run_are_counted_and_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    faults = (
        "[{at_s: 0.5, on: front, do: drop_telegram, for_s: 0.2}, {at_s: 0.8, on: front, do: power_cycle, off_s: 1}]"
    )
    loaded = scenario_file.load("flat_wall", ["duration_s=1", f"faults={faults}"])
    run_trial(loaded, record=tmp_path / "rec")
    found = report(capsys, str(tmp_path / "rec"), "--out", str(tmp_path / "x.html"), "--no-truth")
    (front,) = found["sensors"]
    dropped, cycled = front["faults"]
    assert dropped["name"] == "drop_telegram"
    assert dropped["hits"] in (7, 8)  # of 37.5 a second for 0.2 s
    assert (cycled["name"], cycled["hits"]) == ("power_cycle", 1)
    assert front["scans_dropped"]["fault drop_telegram"] == dropped["hits"]
    assert "fault drop_telegram" in (tmp_path / "x.html").read_text(encoding="utf-8")
    assert "ranges" not in front
    reported = [row["what"] for row in found["time_line"] if row["kind"] == "fault"]
    assert reported[:2] == ["drop_telegram begin", f"drop_telegram end {dropped['hits']} hits"]
    checked((tmp_path / "x.html").read_text(encoding="utf-8"))


def test_reading_tells_how_far_it_has_come(wall: Path) -> None:
    progress = Progress()
    count = sum(1 for _ in items(wall, progress))
    assert count > 100
    assert 0.9 * progress.total < progress.done <= progress.total


def test_the_page_begins_with_the_scene_and_the_sensors_points_in_light_and_dark(wall: Path, tmp_path: Path) -> None:
    run = gather(wall, with_truth=False)
    made = report_of(run)
    (scene,) = made.lead
    assert scene.png[:8] == b"\x89PNG\r\n\x1a\n"
    assert run.scene is not None
    assert run.scenario is not None
    points = points_of(run.scene, run.scenario, "front", *run.sight.shown["front"])
    forward = points[np.abs(points[:, 1]) < 5.0]
    assert len(forward) > 50
    assert np.ptp(forward[:, 0]) < 0.3  # the wall
    text = page(made)
    assert text.index('class="lead"') < text.index("<section>")
    assert "prefers-color-scheme: dark" in text
    assert {"scans sent", "scans dropped"} <= {fact.label for fact in made.facts}
    assert checked(text)
