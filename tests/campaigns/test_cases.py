"""Cases really run: the same bytes by every way, recordings of the failed, a driver, the worst case again."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from emulator.campaigns.campaign import Runner, load, write_scenario
from emulator.campaigns.engines import InPlace
from emulator.campaigns.store import Row, Store
from emulator.commands.cli import main
from emulator.errors import ScenarioError
from emulator.judging.trial import run_trial
from emulator.recording.writer import Recorder
from emulator.runtime.assembly import SameScene
from emulator.runtime.virtual_daemon import VirtualDaemon
from emulator.scenario.scenario import load as load_scenario
from emulator.world import scene

VISIBILITY = "weather.fog.visibility_m"
TEXT = """\
scenario: flat_wall
set: {duration_s: 0.3, "sensors.front.device": {resolution_deg: 1, field_deg: 100}}
factors:
  weather.fog.visibility_m: {values: [8, 400]}
design: grid
expect: [{that: min(front.points), at_least: 60, name: sees the wall}]
quantities: {near: min(front.nearest_m), scans: front.scans_sent}
"""
HOST = """\
import os, sys, time
place = os.environ["LIDAREMU_FRONT"]
file = os.open(place, os.O_RDWR | os.O_NOCTTY)
os.write(file, bytes.fromhex("0200020020243408"))  # published: start the stream
got = b""
while len(got) < 10:
    got += os.read(file, 4096)
sys.exit(int(sys.argv[1]))
"""


def rows_of(tmp_path: Path, text: str, name: str = "out", driver: tuple[str, ...] = ()) -> dict[float, Row]:
    path = tmp_path / "c.yaml"
    path.write_text(text, encoding="utf-8")
    campaign = load(path, tmp_path / name, driver)
    store = Store(campaign.job.out)
    store.make()
    runner = Runner(campaign, store, InPlace())
    runner.run()
    return {row["factors"]["weather.fog.visibility_m"]: row for row in store.rows(runner.names())}


def test_a_case_is_what_test_runs_and_its_scenario_reproduces_it(tmp_path: Path) -> None:
    rows = rows_of(tmp_path, TEXT)
    assert {key: row["verdict"] for key, row in rows.items()} == {8: "failed", 400: "passed"}
    assert rows[400]["quantities"]["near"] == pytest.approx(8.0, abs=0.1)
    assert rows[8]["fault"].startswith("sees the wall: ")
    assert rows[8]["expect"] == {"sees the wall": False}
    campaign = load(tmp_path / "c.yaml", tmp_path / "out")
    for row in rows.values():
        path = write_scenario(campaign, Store(campaign.job.out), row["name"], tmp_path / "again.yaml")
        verdict = run_trial(load_scenario(str(path)))
        assert verdict.sha256 == row["sha256"]
        assert verdict.held is (row["verdict"] == "passed")


KEPT = [("failed", [True, False]), ("all", [True, True]), ("none", [False, False])]


@pytest.mark.parametrize(("record", "kept"), KEPT)
def test_recordings_are_kept_as_asked_for(tmp_path: Path, record: str, kept: list[bool]) -> None:
    rows = rows_of(tmp_path, TEXT + f"record: {record}\n")
    store = Store(tmp_path / "out")
    assert [(store.recording(rows[key]["name"]) / "run.mcap").is_file() for key in (8, 400)] == kept
    assert [rows[key]["recording_bytes"] > 0 for key in (8, 400)] == kept
    assert [row["sha256"] for row in rows_of(tmp_path, TEXT, "other").values()] == [
        row["sha256"] for row in rows.values()
    ]


def test_a_recording_that_could_not_be_finished_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    close = Recorder.close

    def full(self: Recorder) -> None:
        self.failure = "No space left on device"
        close(self)

    monkeypatch.setattr(Recorder, "close", full)
    rows = rows_of(tmp_path, TEXT)
    assert {key: row["warnings"] for key, row in rows.items()} == {8: ["recording: No space left on device"], 400: []}


def test_recordings_end_at_their_limit_and_cases_do_not(tmp_path: Path) -> None:
    rows = rows_of(tmp_path, TEXT + "record: all\nlimits: {disk_mb: 0.001}\n")
    assert sorted(row["recording_bytes"] > 0 for row in rows.values()) == [False, True]


def test_a_case_that_cannot_run_is_an_error_and_the_rest_goes_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from emulator.campaigns import case as cases

    once = cases._once

    def broken(job: object, case: object, loaded: object, record: object) -> object:
        if loaded.weather.fog.visibility_m == 8:  # type: ignore[attr-defined]
            raise ZeroDivisionError("of ours")
        return once(job, case, loaded, record)  # type: ignore[arg-type]

    monkeypatch.setattr(cases, "_once", broken)
    rows = rows_of(tmp_path, TEXT)
    assert rows[8]["fault"] == "ZeroDivisionError: of ours"
    assert {key: row["verdict"] for key, row in rows.items()} == {8: "error", 400: "passed"}


def test_the_scene_is_built_again_for_a_case_with_another_one(monkeypatch: pytest.MonkeyPatch) -> None:
    built: list[str] = []
    build = scene.build
    monkeypatch.setattr(scene, "build", lambda loaded: built.append("") or build(loaded))
    measures = SameScene()
    near, changes = "world.0.at_m=[7, 0, 1]", ("", "weather.fog.visibility_m=50", "seed=4", "duration_s=2")
    counts = []
    for words in (*changes, near, near, "", "materials.white_plaster.rho=0.3"):
        measures(load_scenario("flat_wall", [words] if words else []))
        counts.append(len(built))
    assert counts == [1, 1, 1, 1, 2, 2, 3, 4]
    fed = load_scenario("flat_wall", ["live.feed=lockstep://127.0.0.1:0"])
    assert [len(built) for _ in (0, 1) if measures(fed)] == [5, 6], "a world that somebody moves is nobody else's"


def test_a_quantity_that_is_a_series_is_told(tmp_path: Path) -> None:
    rows = rows_of(tmp_path, TEXT.replace("min(front.nearest_m)", "front.nearest_m"))
    assert "want one number" in rows[400]["fault"]


@pytest.mark.parametrize(("code", "verdict"), [(0, "passed"), (3, "failed")])
def test_a_driver_runs_against_each_case_on_a_port_of_its_own(tmp_path: Path, code: int, verdict: str) -> None:
    (tmp_path / "host.py").write_text(HOST, encoding="utf-8")
    text = TEXT.replace("expect: [{that: min(front.points), at_least: 60, name: sees the wall}]", "expect: []")
    text = text.replace("{near: min(front.nearest_m), scans: front.scans_sent}", "{replies: front.replies_sent}")
    driver = (sys.executable, str(tmp_path / "host.py"), str(code))
    rows = rows_of(tmp_path, text.replace("duration_s: 0.3", "duration_s: 5"), driver=driver)
    assert {row["verdict"] for row in rows.values()} == {verdict}
    assert all(row["quantities"]["replies"] >= 1 for row in rows.values())
    assert all(("exit code 3" in row["fault"]) is bool(code) for row in rows.values())


NUMBERS = """\
import json, os, pathlib
found = json.loads(os.environ["LIDAREMU_FACTORS"])
pathlib.Path(os.environ["LIDAREMU_RESULT"]).write_text({text!r} or json.dumps({{"twice": 2 * found["{key}"]}}))
"""


def numbers(tmp_path: Path, text: str) -> dict[float, Row]:
    (tmp_path / "host.py").write_text(NUMBERS.format(text=text, key=VISIBILITY), encoding="utf-8")
    changed = TEXT.replace(
        "{near: min(front.nearest_m), scans: front.scans_sent}", "{twice: driver.twice, no: driver.no}"
    )
    changed = changed.replace("expect: [{that: min(front.points), at_least: 60, name: sees the wall}]", "expect: []")
    return rows_of(tmp_path, changed, driver=(sys.executable, str(tmp_path / "host.py")))


def test_a_driver_that_answered_late_is_a_warning_of_its_case(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(VirtualDaemon, "late_text", "sha256 may differ in another run")
    (tmp_path / "host.py").write_text(HOST, encoding="utf-8")
    rows = rows_of(tmp_path, TEXT, driver=(sys.executable, str(tmp_path / "host.py"), "0"))
    assert all("sha256 may differ in another run" in row["warnings"] for row in rows.values())


def test_a_driver_gets_its_factors_and_leaves_numbers_of_its_own(tmp_path: Path) -> None:
    rows = numbers(tmp_path, "")
    assert rows
    assert all(row["quantities"] == {"twice": 2 * value, "no": None} for value, row in rows.items())


@pytest.mark.parametrize(
    ("text", "reported"),
    [
        ("[1]", "want one JSON object"),
        ("{", "want one JSON object"),
        ('{"twice": true}', "twice: True; want a number"),
        ('{"twice": "1"}', "want a number"),
        (" " * 70_000, "want one JSON object of at most 65536"),
    ],
)
def test_a_result_that_is_none_is_an_error(text: str, reported: str, tmp_path: Path) -> None:
    rows = numbers(tmp_path, text)
    assert all(row["verdict"] == "error" and reported in row["fault"] for row in rows.values())


def test_numbers_of_a_driver_want_a_driver(tmp_path: Path) -> None:
    text = TEXT.replace("{near: min(front.nearest_m), scans: front.scans_sent}", "{twice: driver.twice}")
    with pytest.raises(ScenarioError, match=r"c\.yaml:\d+: quantities.twice: 'driver.twice' without a driver"):
        rows_of(tmp_path, text)


def test_a_driver_that_hangs_is_counted(tmp_path: Path) -> None:
    text = TEXT.replace("[8, 400]", "[400]") + "limits: {seconds: 1}\n"
    rows = rows_of(tmp_path, text, driver=(sys.executable, "-c", "import signal; signal.pause()"))
    assert rows[400]["verdict"] == "hung"


def test_a_slurm_script_runs_every_shard(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "c.yaml").write_text(TEXT, encoding="utf-8")
    words = ["campaign", str(tmp_path / "c.yaml"), "--out", str(tmp_path / "out")]
    assert main([*words, "--slurm", "3"]) == 0
    script = (tmp_path / "out" / "campaign.sbatch").read_text(encoding="utf-8")
    assert "#SBATCH --array=1-3" in script
    assert script.rstrip().endswith('--shard "$SLURM_ARRAY_TASK_ID/3"')


@pytest.mark.parametrize(
    ("words", "reported"),
    [
        (["--shard", "4/3"], "want I/N"), (["--resume"], "no campaign was begun"), (["--status"], "no campaign"),
        (["--driver", "'"], "want a command"),
        (["--case", "abcd"], "no campaign"), (["--points", "4"], "has no number"),
    ],
)  # fmt: skip
def test_words_that_make_no_sense_are_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], words: list[str], reported: str
) -> None:
    (tmp_path / "c.yaml").write_text(TEXT, encoding="utf-8")
    assert main(["campaign", str(tmp_path / "c.yaml"), "--out", str(tmp_path / "out"), *words]) == 2
    assert reported in capsys.readouterr().err
