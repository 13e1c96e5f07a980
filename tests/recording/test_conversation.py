"""`lidaremu transcript`: the conversation of a recording, in order and decoded."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from emulator.commands.cli import main

CASE = """\
schema: 1
duration_s: 1
world:
  - {plane: {size_m: [6, 60]}, at_m: [8, 0, 1], pitch_deg: -90, material: white_plaster}
sensors:
  - {id: front, model: sick-lms291-s05, links: ["loop:front"], device: {resolution_deg: 1}}
"""


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("said")
    (folder / "case.yaml").write_text(CASE, encoding="utf-8")
    assert main(["test", str(folder / "case.yaml"), "--record", str(folder / "rec")]) == 0
    return next(path.parent for path in folder.rglob("run.mcap"))


def test_host_and_device_are_told_in_turn_with_times_bytes_and_meaning(
    recording: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["transcript", str(recording), "--no-scans"]) == 0
    lines = capsys.readouterr().out.splitlines()
    times = [float(line.split()[0]) for line in lines]
    assert times == sorted(times)
    assert {line.split()[1] for line in lines} == {"host", "device"}
    at = next(index for index, line in enumerate(lines) if "02 00 02 00 20 24 34 08" in line)
    assert lines[at].split()[1] == "host"
    assert any(line.split()[1:3] == ["device", "06"] for line in lines[at:])


def test_scans_are_told_and_a_part_can_be_had(recording: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["transcript", str(recording), "--json", "--sensor", "front"]) == 0
    rows = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    scans = [row for row in rows if row["sweep"] is not None]
    assert scans
    assert any("measured values" in str(field) for field in scans[0]["fields"])
    middle_s = scans[len(scans) // 2]["at_s"]
    assert main(["transcript", str(recording), "--json", "--from", str(middle_s), "--to", str(middle_s)]) == 0
    part = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert part
    assert {row["at_s"] for row in part} == {middle_s}


def test_an_unknown_sensor_or_file_is_refused(recording: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["transcript", str(recording), "--sensor", "rear"]) == 2
    assert "want one of front" in capsys.readouterr().err
    assert main(["transcript", "/no/such"]) == 2
