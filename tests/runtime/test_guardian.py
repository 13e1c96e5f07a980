"""`run --restart`: when a daemon is started again and after how long. Daemons are played, time is counted."""

from __future__ import annotations

import signal
from pathlib import Path

import pytest

from emulator.commands.cli import main
from emulator.process.clock import ManualClock
from emulator.runtime.guardian import arguments_of, died, guard


class Play:
    """Daemons that run so long and end with such codes."""

    def __init__(self, *lives: tuple[float, int], ends_in_pause: int | None = None) -> None:
        self.clock = ManualClock()
        self._lives = lives
        self._ends_in_pause = ends_in_pause
        self.started: list[int] = []
        self.waited: list[float] = []
        self.reported: list[str] = []

    def serve(self, number: int) -> int:
        self.started.append(number)
        lives_s, code = self._lives[number]
        self.clock.set(self.clock.now_ns() + round(lives_s * 1e9))
        return code

    def pause(self, seconds: float) -> bool:
        self.waited.append(seconds)
        return self._ends_in_pause != len(self.waited)

    def run(self) -> int:
        return guard(self.serve, self.pause, self.reported.append, self.clock)


@pytest.mark.parametrize("code", [0, 2, 3, 4, 5])
def test_a_daemon_that_ends_in_order_is_not_started_again(code: int) -> None:
    play = Play((3.0, code))
    assert play.run() == code
    assert (play.started, play.waited) == ([0], [])


@pytest.mark.parametrize("code", [-signal.SIGKILL, -signal.SIGSEGV, 1])
def test_one_that_dies_is_and_it_is_told(code: int) -> None:
    play = Play((3.0, code), (1.0, 0))
    assert play.run() == 0
    assert play.started == [0, 1]
    assert died(code)
    assert "after 3.0 s; start 2 in 0.5 s, with the same links" in play.reported[0]


def test_starts_come_ever_later_and_soon_again_after_a_steady_run() -> None:
    play = Play(*[(0.1, -9)] * 8, (61.0, -9), (0.1, -9), (5.0, 0))
    assert play.run() == 0
    assert play.waited == [0.5, 1.0, 2.0, 4.0, 8.0, 16.0, 30.0, 30.0, 0.5, 1.0]


def test_whoever_ends_the_guardian_while_it_waits_ends_it() -> None:
    play = Play((0.1, -9), (0.1, -9), (0.1, -9), ends_in_pause=2)
    assert play.run() == 0
    assert play.started == [0, 1]


def test_the_same_words_start_each_daemon_and_recordings_are_not_written_over() -> None:
    words = ("run", "street", "--restart", "--record", "rec")
    assert arguments_of(words, Path("rec"), 0) == ["run", "street", "--record", "rec", "--until-eof"]
    assert arguments_of(words, Path("rec"), 2)[-2:] == ["--record", "rec-3"]
    assert arguments_of(("run", "street", "--restart"), None, 2) == ["run", "street", "--until-eof"]


def test_a_command_or_a_leash_beside_it_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["run", "flat_wall", "--restart", "--", "true"]) == 2
    assert "--restart cannot be combined" in capsys.readouterr().err
