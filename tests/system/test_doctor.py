"""`lidaremu doctor` on whatever machine this is."""

from __future__ import annotations

import json

import pytest

from emulator.commands.cli import main


def test_every_question_has_an_answer(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["doctor", "--seconds", "0.3", "--json"]) == 0
    rows = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    names = [row["name"] for row in rows]
    assert {"processor cores", "pseudo-terminals", "multicast on 127.0.0.1", "SocketCAN", "timers"} <= set(names)
    assert all(row["detail"] for row in rows)
    reported = {row["name"]: row["detail"] for row in rows}
    assert "fast" in reported["compiled loops"] or "LIDAREMU_COMPILED" in reported["compiled loops"]
    assert "asyncio.sleep" in reported["timers"]
    assert "of a core spent awake" in reported["timers"]
    assert "--realtime" in reported["real-time scheduling"] or "want CAP_SYS_NICE" in reported["real-time scheduling"]
