"""`lidaremu test`: verdicts, exit codes, JSON and JUnit."""

from __future__ import annotations

import errno
import json
import os
import xml.etree.ElementTree as Tree
from pathlib import Path

import pytest

from emulator.commands.cli import main
from emulator.recording.chunks import McapFile

CASE = """\
schema: 1
duration_s: 0.6
world:
  - {plane: {size_m: [6, 60]}, at_m: [8, 0, 1], pitch_deg: -90, material: white_plaster}
sensors:
  - {id: front, model: sick-lms291-s05, mount: {at_m: [0, 0, 1]}, device: {resolution_deg: 1, field_deg: 100}}
expect:
  - {that: front.range_at(0), within: [7.9, 8.1]}
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "good.yaml").write_text(CASE, encoding="utf-8")
    (tmp_path / "bad.yaml").write_text(CASE.replace("7.9, 8.1", "1, 2"), encoding="utf-8")
    (tmp_path / "wrong.yaml").write_text(CASE.replace("front.range_at", "front.rnge_at"), encoding="utf-8")
    return tmp_path


@pytest.mark.parametrize(
    ("names", "code"), [(["good"], 0), (["good", "bad"], 1), (["good", "wrong"], 2), (["bad", "wrong"], 2)]
)
def test_the_exit_code_is_the_worst_verdicts(folder: Path, names: list[str], code: int) -> None:
    assert main(["test", *(str(folder / f"{name}.yaml") for name in names), "--jobs", "1"]) == code


def test_several_at_once_tell_the_same_as_one_after_the_other(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    reported = []
    for jobs in ("1", "2"):
        assert main(["test", str(folder), "--json", "--jobs", jobs]) == 2
        rows = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
        reported.append([{key: row[key] for key in row if key != "real_s"} for row in rows])
    assert reported[0] == reported[1]
    assert [row["verdict"] for row in reported[0]] == ["failed", "passed", "error"]
    assert len(reported[0][1]["sha256"]) == 64
    assert reported[0][0]["sha256"] == reported[0][1]["sha256"]
    assert "range_at" in reported[0][2]["faults"][0]
    assert reported[0][0]["expect"][0]["held"] is False


def test_a_recording_that_ends_early_is_exit_code_4_unless_something_graver_was(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def full(*_: object) -> int:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    def outcome(number: int, *names: str) -> int:
        record = ["--record", str(tmp_path / f"runs{number}"), "--junitxml", str(tmp_path / "r.xml")]
        return main(["test", *(str(folder / f"{name}.yaml") for name in names), "--jobs", "1", *record, *extra])

    monkeypatch.setattr(McapFile, "chunk", full)
    extra = ["--json"]
    assert outcome(1, "good") == 4
    row = json.loads(capsys.readouterr().out)
    assert (row["verdict"], row["recording"]["state"]) == ("passed", "ended")
    assert [one["kind"] for one in row["incidents"]] == ["recording ended"]
    assert outcome(2, "good", "bad") == 1
    assert outcome(3, "good", "wrong") == 2
    capsys.readouterr()
    extra = []
    assert outcome(4, "good") == 4
    reported = capsys.readouterr().out
    assert "recording ended: No space left on device" in reported
    assert reported.endswith("1 passed, 1 recording ended early\n")
    suite = Tree.parse(tmp_path / "r.xml").getroot().find("testsuite")
    assert suite is not None
    assert (suite.get("tests"), suite.get("errors")) == ("2", "1")
    assert "No space left" in str(suite.findall("testcase/error")[0].get("message"))


def test_scenarios_of_one_name_are_recorded_side_by_side(folder: Path, tmp_path: Path) -> None:
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "Good.yaml").write_text(CASE, encoding="utf-8")
    names = [str(folder / "good.yaml"), str(tmp_path / "other" / "Good.yaml")]
    assert main(["test", *names, "--jobs", "1", "--record", str(tmp_path / "runs")]) == 0
    assert sorted(path.name for path in (tmp_path / "runs").iterdir()) == ["Good-2", "good"]


def test_the_junit_report_has_a_case_an_expectation(folder: Path) -> None:
    report = folder / "out" / "report.xml"
    main(["test", str(folder), "--jobs", "1", "--junitxml", str(report)])
    suites = Tree.parse(report).getroot().findall("testsuite")
    assert [(s.get("tests"), s.get("failures"), s.get("errors")) for s in suites] == [
        ("1", "1", "0"),
        ("1", "0", "0"),
        ("1", "0", "1"),
    ]
    case = suites[0].find("testcase")
    assert case is not None
    failure = case.find("failure")
    assert failure is not None
    assert "expected 1 to 2" in str(failure.get("message"))
    assert suites[1].find("testcase/failure") is None


def test_a_folder_without_scenarios_and_a_missing_file_are_told(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["test", str(tmp_path)]) == 2
    assert "no .yaml file" in capsys.readouterr().err
    assert main(["test", str(tmp_path / "nothing.yaml")]) == 2
