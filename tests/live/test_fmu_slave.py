"""An FMU whose run does not begin, or ends too early: why is said, and nothing is left of it."""

from __future__ import annotations

import json
import os
import shlex
import socket
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

pytest.importorskip("pythonfmu")

from emulator.live import fmu_slave
from emulator.live.fmu_slave import CONFIG, Lidaremu

ENDS = "echo no place for the link >&2; exit 3"
KILLED = "kill -9 $$"
SPEAKS = """echo '{"event": "ready", "sensors": []}'; """


@pytest.fixture
def made(monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """Where runs of an FMU put their folders."""
    with tempfile.TemporaryDirectory() as short:
        monkeypatch.setattr(tempfile, "tempdir", short)
        yield Path(short)


def slave(folder: Path, command: str) -> Lidaremu:
    config = {"name": "one", "description": "", "scenario": "scenario.yaml", "command": ["sh", "-c", command, "run"]}
    config |= {"sensors": ["eye"], "actors": {"car": {}}, "longest_s": 1.0}
    (folder / CONFIG).write_text(json.dumps(config), encoding="utf-8")
    return Lidaremu(instance_name="one", resources=str(folder))


def test_a_temporary_folder_too_long_for_a_socket_is_not_taken(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    far = tmp_path / ("a" * 100)
    far.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(far))
    with pytest.raises(RuntimeError, match="No such file"):  # nobody listens, but it could be asked
        slave(tmp_path, SPEAKS + "exit 2").exit_initialization_mode()
    assert "too long" not in capsys.readouterr().err


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


@contextmanager
def listening(
    monkeypatch: pytest.MonkeyPatch, made: Path, folder: Path, body: str, answers: bytes
) -> Iterator[tuple[Lidaremu, list[socket.socket]]]:
    """An FMU whose run is a shell that says `ready`, with the line to it; nothing is left of it at the end."""
    place = made / "lidaremu-fmu-here"

    def new_folder(prefix: str, dir: str | None) -> str:  # noqa: A002
        place.mkdir()
        return str(place)

    ask = fmu_slave._Run.ask
    line: list[socket.socket] = []

    def answering(self: fmu_slave._Run, request: dict[str, object], more: bytes = b"") -> object:
        if request["op"] == "hello":
            line.append(listener.accept()[0])
            line[0].sendall(answers)
        if request["op"] == "step":
            line[0].close()
            assert self._process is not None
            assert self._process.stdin is not None
            self._process.stdin.close()
        return ask(self, request, more)

    monkeypatch.setattr(fmu_slave._Run, "ask", answering)
    monkeypatch.setattr(fmu_slave.tempfile, "mkdtemp", new_folder)
    with socket.socket(socket.AF_UNIX) as listener:
        listener.bind(str(made / "listener"))
        listener.listen(1)
        link = f"ln {shlex.quote(str(made / 'listener'))} {shlex.quote(str(place / 'lockstep'))}; "
        one = slave(folder, link + body)
        before = descriptors()
        one.exit_initialization_mode()
        yield one, line
        one.terminate()
        line[0].close()
        assert descriptors() == before
    assert not place.exists()


def test_a_run_that_ends_between_steps_is_an_error_of_the_step_with_its_exit_code(
    tmp_path: Path, made: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    body = SPEAKS + "read nothing; echo out of memory >&2; exit 7"
    with listening(monkeypatch, made, tmp_path, body, b'{"op": "hello"}\n') as (one, _):
        assert not one.do_step(0.0, 0.1)
        assert not one.do_step(0.0, 0.1)
    error = capsys.readouterr().err
    assert error.startswith("lidaremu: FMU one: ")
    assert "the run ended with exit code 7: out of memory" in error
    logged = [(found.status.name, found.msg) for found in one.log_queue]
    assert [status for status, _ in logged] == ["error", "error"]
    assert all("the run ended with exit code 7: out of memory" in text for _, text in logged)


def test_a_run_is_asked_to_end_by_a_signal_and_its_last_event_is_read(
    tmp_path: Path, made: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The end of its input would leave it ten seconds for a recording."""
    body = """trap 'echo "{\\"event\\": \\"stopped\\", \\"sha256\\": \\"whole\\"}"; exit 0' TERM; """
    with listening(
        monkeypatch, made, tmp_path, f"{body}{SPEAKS}read nothing; exit 9", b'{"op": "hello"}\n{"op": "bye"}\n'
    ) as (one, _):
        pass
    assert one._sha256 == "whole"
