"""`run --restart`: a process that starts the daemon again, with the same links, when it dies before its end.

Belongs here: when it is started again, after how long, and that neither outlives the other. Not: what a daemon does.

The daemon holds the other end of a pipe as its standard input (`run --until-eof`): a guardian that is killed takes it
along. The next daemon takes over the paths of one that was killed (stable_path).
"""

from __future__ import annotations

import contextlib
import os
import select
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from emulator.process.clock import Clock
from emulator.runtime.own_daemon import ending_signals

FIRST_S, LONGEST_S = 0.5, 30.0
"Before the first new start, and at most: each is twice the one before."
STEADY_NS = 60_000_000_000
"A daemon that has run so long begins the row again."
TRACEBACK = 1
"Exit code of a Python program that ends by an uncaught error; a run without a COMMAND has no other use for it."


def died(code: int) -> bool:
    """Whether a daemon ended by no end of its own: killed, or by an error that nobody caught."""
    return code < 0 or code == TRACEBACK


def guard(
    serve: Callable[[int], int], pause: Callable[[float], bool], tell: Callable[[str], None], clock: Clock
) -> int:
    """Have daemons served until one ends in order; its exit code.

    `serve`: runs the daemon of that number, from 0, to its end and gives its exit code. `pause`: waits; false: the
    guardian was ordered to end meanwhile.
    """
    wait_s, number = FIRST_S, 0
    while True:
        began_ns = clock.now_ns()
        code = serve(number)
        if not died(code):
            return code
        ran_ns = clock.now_ns() - began_ns
        wait_s = FIRST_S if ran_ns >= STEADY_NS else wait_s
        how = f"was ended by signal {-code}" if code < 0 else f"ended with exit code {code}"
        number += 1
        tell(f"the daemon {how} after {ran_ns * 1e-9:.1f} s; start {number + 1} in {wait_s:g} s, with the same links")
        if not pause(wait_s):
            return 0
        wait_s = min(LONGEST_S, 2.0 * wait_s)


def arguments_of(words: Sequence[str], record: Path | None, number: int) -> list[str]:
    """What the daemon of that number is called with; a recording of its own each, since none is written over."""
    kept = [word for word in words if word != "--restart"]
    again = [] if record is None or not number else ["--record", f"{record}-{number + 1}"]
    return [*kept, "--until-eof", *again]


class Keeper:
    """Starts daemons as child processes and passes signals on to them."""

    def __init__(self, words: Sequence[str], record: Path | None) -> None:
        """`words`: of the command line, `run` and what follows."""
        self._words, self._record = words, record
        self._daemon: subprocess.Popen[bytes] | None = None
        self._ended, self._ring = os.pipe()

    @contextmanager
    def signals(self) -> Iterator[None]:
        """Signals that end a run end the daemon, and with it the guardian, while this lasts."""

        def handler(number: int, _frame: object) -> None:
            with contextlib.suppress(OSError):
                os.write(self._ring, b".")
            if self._daemon is not None and self._daemon.poll() is None:
                self._daemon.send_signal(number)

        before = {number: signal.signal(number, handler) for number in ending_signals()}
        try:
            yield
        finally:
            for number, action in before.items():
                signal.signal(number, action)

    def serve(self, number: int) -> int:
        """One daemon, to its end."""
        if self._asked_to_end(0.0):
            return 0
        command = [sys.executable, "-m", "emulator", *arguments_of(self._words, self._record, number)]
        # a session of its own: Ctrl-C of the terminal reaches it through us alone, once
        self._daemon = subprocess.Popen(command, stdin=subprocess.PIPE, start_new_session=True)
        try:
            code = self._daemon.wait()
        finally:
            assert self._daemon.stdin is not None
            self._daemon.stdin.close()
        return 0 if self._asked_to_end(0.0) and died(code) else code

    def pause(self, seconds: float) -> bool:
        """Wait; false: somebody wants the end."""
        return not self._asked_to_end(seconds)

    def _asked_to_end(self, seconds: float) -> bool:
        return bool(select.select([self._ended], [], [], seconds)[0])

    def close(self) -> None:
        """Nothing is left open."""
        for number in (self._ended, self._ring):
            os.close(number)
