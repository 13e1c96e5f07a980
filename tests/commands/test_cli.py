"""The command line in process: what it prints, and its exit codes. Processes and ports are in tests/system."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import pytest

from emulator.commands.cli import CANNOT_RUN, OK, lateness_of, main
from emulator.commands.common import LINK_LOST
from emulator.process.driver import place_of, variable_of
from emulator.process.lateness import LatenessLog

SCENARIO = """\
schema: 1
world:
  - {plane: {size_m: [6, 60]}, at_m: [8, 0, 1], pitch_deg: -90, material: white_plaster}
sensors:
  - id: front
    model: sick-lms291-s05
    device: {resolution_deg: 0.5}
    links: ["pty:./front"]
"""


def write(folder: Path, text: str) -> str:
    path = folder / "case.yaml"
    path.write_text(text, encoding="utf-8")
    return str(path)


@pytest.mark.parametrize(("late", "told"), [(2, ""), (3, "; 3 of them later than 1 ms")])
def test_the_end_of_a_run_tells_how_many_sends_were_late_if_more_than_one_in_a_hundred(late: int, told: str) -> None:
    log = LatenessLog()
    log.extend([50_000] * (200 - late) + [1_000_001] * (late - 1) + [2_000_000_000])
    row = {"sends": 200, "median": 50.0, "p99": 50.0, "worst": 2e6, "histogram": log.histogram()}
    assert lateness_of(row) == f"lateness of 200 sends: median 50 us, p99 50 us, worst 2000000 us{told}"


def test_every_shipped_scenario_is_good(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["list", "scenarios", "--json"]) == OK
    names = [json.loads(line)["scenario"] for line in capsys.readouterr().out.splitlines()]
    assert {"flat_wall", "crossing_car", "street"} <= set(names)
    assert main(["check", *names]) == OK
    assert len(capsys.readouterr().out.splitlines()) == len(names)


BAD = [
    ("schema: 1", "schem: 1", ["case.yaml:1", "schem", "schema"]),
    ("resolution_deg: 0.5", "resolution_deg: 0.3", ["case.yaml:7", "resolution_deg", "0.3"]),
    ("resolution_deg: 0.5", "resolutoin_deg: 0.5", ["case.yaml:7", "resolutoin_deg", "resolution_deg"]),
    ("white_plaster", "white_plastr", ["case.yaml:3", "white_plastr", "white_plaster"]),
    ("sick-lms291-s05", "sick-lms291-s5", ["case.yaml:6", "sick-lms291-s5", "sick-lms291-s05"]),
    ("pty:./front", "pyt:./front", ["case.yaml:8", "pyt:./front"]),
    ("{plane: {size_m: [6, 60]}", "{mesh: no/such.glb", ["case.yaml:3", "no/such.glb"]),
    ("[8, 0, 1]", "[.nan, 0, 1]", ["case.yaml:3", "nan"]),
]


@pytest.mark.parametrize(("found", "put", "said"), BAD)
def test_a_fault_is_told_by_file_line_and_key_with_exit_code_2(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], found: str, put: str, said: list[str]
) -> None:
    path = write(tmp_path, SCENARIO.replace(found, put))
    for command in (["check", path], ["run", path, "--duration", "0"]):
        assert main(command) == CANNOT_RUN
        text = capsys.readouterr().err
        for part in said:
            assert part in text
        assert "Traceback" not in text


def test_a_near_gate_beyond_the_models_own_gate_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["check", "flat_wall", "--set", "sensors.front.physics.near_gate_m=100000"]) == CANNOT_RUN
    assert "near_gate_m 100000 not before gate_m" in capsys.readouterr().err


def test_check_in_json_has_every_fault(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = write(tmp_path, SCENARIO.replace("white_plaster", "chalkk").replace("[8, 0, 1]", "[.inf, 0, 1]"))
    assert main(["check", "--json", path]) == CANNOT_RUN
    answer = json.loads(capsys.readouterr().out)
    assert answer["ok"] is False
    assert len(answer["faults"]) == 2


@pytest.mark.parametrize(
    "arguments",
    [
        [],
        ["nonsense"],
        ["run"],
        ["run", "no_such_scenario"],
        ["run", "flat_wall", "--link", "front"],
        ["run", "flat_wall", "--link", "nobody=pty:./x"],
        ["run", "flat_wall", "--set", "sensors.front.colour=red"],
        ["run", "flat_wall", "--shim"],
        ["list", "colours"],
        ["list", "commands"],
        ["list", "commands", "nope"],
        ["list", "device"],
        ["list", "device", "nope"],
        ["look", "pty:./nobody", "--family", "nope"],
        ["run", "flat_wall", "--link", "front=tcp:127.0.0.1:²"],
        ["run", "flat_wall", "--set", "sensors.².model=x"],
        ["look", "nobody"],
        ["look", "tcp:127.0.0.1"],
        ["look", "tcp:127.0.0.1:99999"],
        ["look", "tcp:127.0.0.1:0"],
        ["demo", "--sensor", "nobody"],
    ],
)
def test_bad_arguments_give_a_message_and_exit_code_2(
    arguments: list[str], capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    code = main(arguments)
    said = capsys.readouterr()
    assert code == CANNOT_RUN
    assert said.err or said.out
    assert "Traceback" not in said.err


@pytest.mark.parametrize("what", ["sensors", "scenarios", "materials", "links"])
def test_lists_are_not_empty_and_are_json_when_asked(what: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["list", what]) == OK
    plain = capsys.readouterr().out.splitlines()
    assert main(["list", what, "--json"]) == OK
    rows = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert len(plain) == len(rows) > 3


@pytest.mark.parametrize("family", ["lms2xx", "ld", "can_objects"])
def test_every_command_of_a_family_is_listed_with_its_state_and_source(
    family: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["list", "commands", family, "--json"]) == OK
    rows = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert {row["status"] for row in rows} <= {"done", "refused", "absent"}
    assert all(row["source"] for row in rows)


@pytest.mark.parametrize("model", ["sick-lms291-s05", "sick-lms200-30106", "sick-ld-lrs1000"])
def test_every_key_of_a_models_device_table_is_listed_with_what_it_takes(
    model: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["list", "device", model, "--json"]) == OK
    rows = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert len(rows) > 10
    assert all(row["key"] and row["allowed"] and row["meaning"] for row in rows)


def test_a_host_whose_name_cannot_be_is_told(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["look", f"tcp:{'a' * 300}:80"]) == LINK_LOST
    assert "not a host's name" in capsys.readouterr().err


def test_a_picture_without_matplotlib_is_refused_before_the_device_is_asked(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    assert main(["look", f"pty:{tmp_path / 'nobody'}", "--png", str(tmp_path / "scan.png")]) == CANNOT_RUN
    assert "lidaremu[report]" in capsys.readouterr().err


def test_a_driver_finds_its_sensor_in_the_environment() -> None:
    assert variable_of("front-left") == "LIDAREMU_FRONT_LEFT"
    assert place_of("pty:/run/x?speed=ignore") == "/run/x"
    assert place_of("tcp:127.0.0.1:4001") == "127.0.0.1:4001"


def test_a_run_says_when_it_will_end_and_at_its_end_why_it_did(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = write(tmp_path, SCENARIO.replace("pty:./front", "tcp:127.0.0.1:0") + "duration_s: 0.5\n")
    assert main(["run", path, "--clock", "virtual", "--json", "--no-wait"]) == OK
    rows = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert (rows[0]["ends_at_s"], rows[0]["ends_by"], rows[0]["round_s"]) == (0.5, "duration_s of the scenario", None)
    assert (rows[-1]["why"], rows[-1]["ended_s"]) == ("its duration is over", 0.5)
    assert rows[-1]["late_answers"] == 0
    assert main(["run", path, "--clock", "virtual", "--no-wait", "--loop", "--duration", "1.25"]) == OK
    reported = capsys.readouterr().out.splitlines()
    assert reported[1] == "ends after 1.25 s (--duration); the world begins again every 0.5 s"
    assert reported[2] == "ended after 1.250 s: its duration is over"


ASKS = """
import os, socket
host, _, port = os.environ["LIDAREMU_FRONT"].rpartition(":")
with socket.create_connection((host, int(port))) as line:
    line.sendall(bytes.fromhex("0200010031151200"))
    line.recv(1)
"""


def test_a_run_whose_host_spoke_after_time_had_gone_on_says_so_at_its_end(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    path = write(tmp_path, SCENARIO.replace("pty:./front", "tcp:127.0.0.1:0"))
    driver = ["--", sys.executable, "-c", ASKS]
    assert main(["run", path, "--speed", "20", "--answer-wait", "0.2", *driver]) == OK
    assert "virtual time had gone on once before a host came or answered: sha256 may" in capfd.readouterr().out
    assert main(["run", path, "--speed", "20", "--json", *driver]) == OK
    assert json.loads(capfd.readouterr().out.splitlines()[-1])["late_answers"] == 1


def test_a_group_without_a_command_shows_its_help_in_lines(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["study"]) == 2
    text = capsys.readouterr().err
    assert text.startswith("Usage: lidaremu study")
    assert "\n  soak " in text
    assert "\\x0a" not in text


def test_a_missing_argument_names_the_choices_on_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["list"]) == 2
    last = capsys.readouterr().err.splitlines()[-1]
    assert last.startswith("Error: Missing argument")
    assert last.endswith("Choose from: sensors, scenarios, materials, links, faults, commands, device")


def test_ctl_without_a_daemon_says_what_to_start(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    from emulator.runtime import control

    monkeypatch.setattr(control, "running", lambda: [])
    assert main(["ctl", "status"]) == 3
    err = capsys.readouterr().err
    assert "no daemon of this user is running at the usual place; want lidaremu run SCENARIO first" in err
    assert "or --socket PATH of one with --control PATH" in err
