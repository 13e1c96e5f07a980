"""`lidaremu test`: verdicts, exit codes, JSON and JUnit."""

from __future__ import annotations

import json
import xml.etree.ElementTree as Tree
from pathlib import Path

import pytest

from emulator.cli import main

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
    told = []
    for jobs in ("1", "2"):
        assert main(["test", str(folder), "--json", "--jobs", jobs]) == 2
        rows = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
        told.append([{key: row[key] for key in row if key != "real_s"} for row in rows])
    assert told[0] == told[1]
    assert [row["verdict"] for row in told[0]] == ["failed", "passed", "error"]
    assert len(told[0][1]["sha256"]) == 64
    assert told[0][0]["sha256"] == told[0][1]["sha256"]
    assert "range_at" in told[0][2]["faults"][0]
    assert told[0][0]["expect"][0]["held"] is False


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
