"""An FMU whose run does not begin, or ends too early: why is said, and nothing is left of it."""

from __future__ import annotations

import json
import os
import shlex
import socket
import tempfile
from pathlib import Path

import pytest

pytest.importorskip("pythonfmu")

from emulator.live import fmu_slave
from emulator.live.fmu_slave import CONFIG, Lidaremu

ENDS = "echo no place for the link >&2; exit 3"
KILLED = "kill -9 $$"
SPEAKS = """echo '{"event": "ready", "sensors": []}'; """


@pytest.fixture
def made(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Where runs of an FMU put their folders."""
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "temporary"))
    (tmp_path / "temporary").mkdir()
    return tmp_path / "temporary"


def slave(folder: Path, command: str) -> Lidaremu:
    config = {"name": "one", "description": "", "scenario": "scenario.yaml", "command": ["sh", "-c", command, "run"]}
    config |= {"sensors": ["eye"], "actors": {"car": {}}, "longest_s": 1.0}
    (folder / CONFIG).write_text(json.dumps(config), encoding="utf-8")
    return Lidaremu(instance_name="one", resources=str(folder))


def descriptors() -> set[str]:
    return set(os.listdir("/proc/self/fd"))


@pytest.mark.parametrize(
    ("command", "said"),
    [
        (ENDS, "the run ended with exit code 3 before it was ready: no place for the link"),
        ("echo Traceback; exit 1", "the run ended with exit code 1 before it was ready: Traceback"),
        (KILLED, "the run was ended by SIGKILL before it was ready: it said nothing; the command was sh -c"),
        (
            SPEAKS + "exit 2",
            "the run cannot be driven: [Errno 2] No such file or directory; it ended with exit code 2: ",
        ),
    ],
)
def test_why_a_run_does_not_begin_goes_to_standard_error_once_and_to_the_master(
    command: str, said: str, tmp_path: Path, made: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    one = slave(tmp_path, command)
    before = descriptors()
    for _ in range(2):
        with pytest.raises(RuntimeError, match=r"^the run ") as raised:
            one.exit_initialization_mode()
        assert said in str(raised.value)
    assert capsys.readouterr().err.splitlines() == [f"lidaremu: FMU one: {raised.value}"]
    assert descriptors() == before
    assert list(made.iterdir()) == []


def test_a_command_that_is_not_there_leaves_nothing_open(
    tmp_path: Path, made: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    one = slave(tmp_path, "")
    one._given["lidaremu"] = shlex.join([str(tmp_path / "none")])
    before = descriptors()
    with pytest.raises(RuntimeError, match="none: No such file or directory; want lidaremu installed"):
        one.exit_initialization_mode()
    assert "want lidaremu installed" in capsys.readouterr().err
    assert descriptors() == before
    assert list(made.iterdir()) == []


def test_a_run_that_ends_between_steps_is_an_error_of_the_step_with_its_exit_code(
    tmp_path: Path, made: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    place = made / "lidaremu-fmu-here"

    def folder(prefix: str) -> str:
        place.mkdir()
        return str(place)

    monkeypatch.setattr(fmu_slave.tempfile, "mkdtemp", folder)
    with socket.socket(socket.AF_UNIX) as listener:
        bound = made / "listener"
        listener.bind(str(bound))
        listener.listen(1)
        link = f"ln {shlex.quote(str(bound))} {shlex.quote(str(place / 'lockstep'))}; "
        one = slave(tmp_path, f"{link}{SPEAKS} read nothing; echo out of memory >&2; exit 7")
        before = descriptors()
        answered: list[socket.socket] = []
        ask = fmu_slave._Run.ask

        def answering(self: fmu_slave._Run, request: dict[str, object], more: bytes = b"") -> object:
            if request["op"] == "hello":
                answered.append(listener.accept()[0])
                answered[0].sendall(b'{"op": "hello"}\n')
                return ask(self, request, more)
            if request["op"] == "step":
                answered[0].close()
                assert self._process is not None
                assert self._process.stdin is not None
                self._process.stdin.close()
            return ask(self, request, more)

        monkeypatch.setattr(fmu_slave._Run, "ask", answering)
        one.exit_initialization_mode()
        assert not one.do_step(0.0, 0.1)
        assert not one.do_step(0.0, 0.1)
        one.terminate()
        assert descriptors() == before
    error = capsys.readouterr().err
    assert error.startswith("lidaremu: FMU one: ")
    assert "the run ended with exit code 7: out of memory" in error
    logged = [(one.status.name, one.msg) for one in one.log_queue]
    assert [status for status, _ in logged] == ["error", "error"]
    assert all("the run ended with exit code 7: out of memory" in text for _, text in logged)
    assert not place.exists()
