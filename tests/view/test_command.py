"""`lidaremu view` given what it cannot show."""

from __future__ import annotations

import socket
from pathlib import Path

import pytest

pytest.importorskip("viser", reason="extra `view` is not installed")
from emulator.commands.cli import main


@pytest.mark.parametrize(
    ("arguments", "code", "reported"),
    [
        (["no/such.sock"], 3, "no daemon answers"),
        (["unix:/no/such"], 3, "no daemon answers"),
        (["no_such_scenario"], 2, "no_such_scenario"),
        (["."], 2, "run.mcap"),
        (["crossing_car", "--token", "short"], 2, "8 or more letters"),
        (["crossing_car", "--token", "with blanks and &"], 2, "8 or more letters"),
        (["crossing_car", "--host", "203.0.113.9"], 3, "cannot listen on 203.0.113.9"),
    ],
)
def test_what_cannot_be_shown_is_told(
    arguments: list[str],
    code: int,
    reported: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["view", *arguments, "--no-browser"]) == code
    assert reported in capsys.readouterr().err


def test_a_port_that_is_taken_is_told(capsys: pytest.CaptureFixture[str]) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        assert main(["view", "crossing_car", "--port", str(port), "--no-browser"]) == 3
    assert f"cannot listen on 127.0.0.1:{port}" in capsys.readouterr().err
