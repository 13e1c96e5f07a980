"""A number of 100 000 digits is refused by a line wherever a text has numbers: Python itself refuses to read one."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from emulator.commands.cli import main
from emulator.config.yaml_lines import parse_value
from emulator.errors import ScenarioError
from emulator.process.clock import ThreadClock
from emulator.recording.can_logs import read_candump
from emulator.runtime.control import BAD_PARAMS, PARSE, REFUSED, ControlServer
from emulator.runtime.order_words import parameters_of
from emulator.scenario.scenario import loads
from emulator.transports.urls import option_value, parse_url
from protocols.ld.settings import _ip

LONG = "9" * 100_000


def reported(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> str:
    """What a command says that cannot run."""
    assert main(arguments) == 2
    out, err = capsys.readouterr()
    assert not out
    assert "Traceback" not in err
    return err


@pytest.mark.parametrize(
    ("change", "want"),
    [
        (f"seed={LONG}", "a number of 100000 digits; want at most 40"),
        (f"seed=0x{LONG}", "a number of 100002 digits; want at most 40"),
        (f"duration_s={LONG}.5", "a number of 100002 characters; want at most 400"),
        ("duration_s=1e999999999", "duration_s: inf; want a finite number"),
        (f"sensors.{LONG}.mode=x", "sensors has no 999"),
        (f"world[{LONG}].at_m=1", "world has no 999"),
        (f'seed="{LONG}"', "want a whole number"),
    ],
)
def test_a_change_of_a_scenario(change: str, want: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert want in reported(["check", "flat_wall", "--set", change], capsys)


@pytest.mark.parametrize("url", [f"tcp:127.0.0.1:{LONG}", f"udp:[::1]:{LONG}", f"udp:127.0.0.1:{LONG}"])
def test_a_link(url: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert "want a whole number" in reported(["check", "flat_wall", "--link", f"front={url}"], capsys)


@pytest.mark.parametrize("number", ["inf", "nan", "1e999", LONG, "-1", "2e9"])
@pytest.mark.parametrize("command", [["run", "flat_wall", "--duration"], ["test", "flat_wall", "--duration"],
                                     ["run", "flat_wall", "--speed"], ["look", "pty:./a", "--duration"]])  # fmt: skip
def test_an_option(command: list[str], number: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert "Invalid value for '--" in reported([*command, number], capsys)


def test_parameters_of_an_order(capsys: pytest.CaptureFixture[str]) -> None:
    assert "seconds: a number of 100000 digits; want at most 40" in reported(["ctl", "step", f"seconds={LONG}"], capsys)
    assert parameters_of(["a=" + "[" * 100_000, "b=12"]) == {"a": "[" * 100_000, "b": 12}


def answers(line: bytes) -> tuple[int, str]:
    """Code and text of the refusal of a request; the method takes its number to nanoseconds."""
    server = ControlServer.__new__(ControlServer)
    server.methods = {"step": lambda params: int(float(params["seconds"]) * 1e9)}

    class Now:
        def call(self, act):  # type: ignore[no-untyped-def]
            from concurrent.futures import Future

            done = Future()  # type: ignore[var-annotated]
            try:
                done.set_result(act())
            except Exception as error:
                done.set_exception(error)
            return done

    server.run = Now()  # type: ignore[assignment]
    server._processor = ThreadClock()
    answer = server.answer(line)
    assert answer is not None
    assert json.dumps(answer)
    return answer["error"]["code"], answer["error"]["message"]


@pytest.mark.parametrize(
    ("number", "code", "want"),
    [
        (LONG, PARSE, "a number of 100000 digits; want at most 40"),
        ("0." + LONG, PARSE, "a number of 100002 characters; want at most 400"),
        ("9" * 4000, PARSE, "a number of 4000 digits"),
        ("1e999", REFUSED, "infinity"),
        ("[" * 10_000, PARSE, "not JSON"),
    ],
)
def test_a_request_on_the_control_socket(number: str, code: int, want: str) -> None:
    found, text = answers(f'{{"method": "step", "id": 1, "params": {{"seconds": {number}}}}}'.encode())
    assert (found, want in text) == (code, True)
    assert BAD_PARAMS != PARSE


def test_an_option_of_an_adapter_stays_a_text() -> None:
    assert option_value(LONG) == LONG
    assert option_value("0x10") == 16
    with pytest.raises(ValueError, match="want a whole number"):
        parse_url(f"pty:./a?baud={LONG}").number("baud", 1, 1, 9)


def test_an_address_of_a_device_and_a_log_of_frames() -> None:
    assert not _ip(f"1.2.3.{LONG}")
    assert _ip("192.168.1.10")
    line = f"({LONG}.000000) can0 123#00"
    (frame,) = read_candump([line, "(1.5) can0 123#00"])
    assert frame.at_ns == 1_500_000_000


def test_a_text_of_a_scenario_that_names_a_long_line(tmp_path: Path) -> None:
    with pytest.raises(ScenarioError) as caught:
        loads(
            f"schema: 1\nsensors: [{{id: a, model: sick-lms291-s05, links: ['tcp:x:{LONG}']}}]\n", tmp_path / "a.yaml"
        )
    assert "want" in str(caught.value)
    with pytest.raises(ScenarioError, match="100000 digits"):
        parse_value(f"[1, {LONG}]", "--set a", ScenarioError)
