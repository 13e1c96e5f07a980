"""A daemon that another command starts for itself (`view`, `demo`): it ends with that command in every case.

The command holds the other end of the daemon's standard input. When it goes, killed or not, the kernel closes that end;
the daemon reads the end of its input, stops, and removes the folder that the command had made for it. Where a daemon
does not stop within `PATIENCE_S` it ends itself. Where both are killed at once, the next such command clears up.

Belongs here: both sides, the command's (`own_daemon`) and the daemon's (`leashed`); which signals end either. Not: what
the daemon does (cli).
"""

from __future__ import annotations

import contextlib
import json
import os
import re
import select
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any

from emulator.errors import EmulatorError

TIME_LIMIT_S = 10.0
"For a daemon whose command has gone."
STOP_S = 60.0
"For a daemon that its command has asked to end: killed, it would not say its last event."
FOLDER = re.compile(r"lidaremu-own-(\d+)-\w+")
"Name of a command's folder: its process is in it."


class DaemonError(EmulatorError):
    """It did not start."""


class OwnDaemon:
    """The command's side: a running daemon."""

    def __init__(self, process: subprocess.Popen[str], ready: Mapping[str, Any], heard: Callable[[Any], None]) -> None:
        """`heard` is called with each event after `ready`, in a thread of its own."""
        self.process = process
        self.ready = ready
        self.last: Mapping[str, Any] = {}
        "The event `stopped`, once it has come."
        self._heard = heard
        self._reader = threading.Thread(target=self._read, name="lidaremu-daemon", daemon=True)
        self._reader.start()

    @property
    def control(self) -> Path:
        """Its control socket."""
        return Path(self.ready["control"].removeprefix("unix:"))

    def code(self, time_limit_s: float = 0.0) -> int | None:
        """Its exit code, negative for a signal; None while it runs, for `patience_s` more at least."""
        with contextlib.suppress(subprocess.TimeoutExpired):
            return self.process.wait(time_limit_s)
        return None

    @property
    def how(self) -> str:
        """How it ended, in words."""
        code = self.process.returncode
        return f"the daemon was ended by signal {-code}" if code < 0 else f"the daemon ended with exit code {code}"

    def _read(self) -> None:
        """All that it says: a pipe that nobody empties would stop it."""
        assert self.process.stdout is not None
        for line in self.process.stdout:
            with contextlib.suppress(ValueError):  # cut by its end
                event = json.loads(line)
                if event.get("event") == "stopped":
                    self.last = event
                else:
                    self._heard(event)

    def stop(self) -> None:
        """End it; what it says at its end is in `last`."""
        if self.process.poll() is None:
            self.process.terminate()
        try:
            self.process.wait(STOP_S)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.wait()
        self._reader.join(STOP_S)
        for end in (self.process.stdin, self.process.stdout):
            if end is not None:
                with contextlib.suppress(OSError):
                    end.close()


@contextmanager
def own_daemon(
    scenario: str,
    options: Sequence[str],
    links: Callable[[Path], Sequence[str]],
    heard: Callable[[Any], None] = lambda event: None,
    errors: IO[bytes] | None = None,
) -> Iterator[OwnDaemon]:
    """A daemon on a scenario while this lasts. `links`: SENSOR=URL each, in a folder of ours that goes with it.

    `errors`: a file for what it logs; None: our own standard error. Raises `DaemonError` when it does not start.
    """
    clear_up()
    folder = Path(tempfile.mkdtemp(prefix=f"lidaremu-own-{os.getpid()}-"))
    try:
        command = [sys.executable, "-m", "emulator", "run", scenario, "--json", "--until-eof", f"--own-folder={folder}"]
        command += [*options, *(f"--link={text}" for text in links(folder))]
        process = subprocess.Popen(
            command,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=errors,
            text=True,
            start_new_session=True,  # Ctrl-C and a closed terminal are for us; we end it in order
        )
        daemon = None
        try:
            assert process.stdout is not None
            first = process.stdout.readline()
            if not first:
                raise DaemonError(f"the daemon did not start (exit code {process.wait()})")
            daemon = OwnDaemon(process, json.loads(first), heard)
            yield daemon
        finally:
            (daemon or OwnDaemon(process, {}, heard)).stop()
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def ending_signals() -> tuple[signal.Signals, ...]:
    """Signals that ask a command to end in order: a closed terminal too, unless it was started to outlive that."""
    hangup = () if signal.getsignal(signal.SIGHUP) == signal.SIG_IGN else (signal.SIGHUP,)
    return (signal.SIGINT, signal.SIGTERM, *hangup)


def clear_up() -> None:
    """Remove folders of commands of this user that were killed together with their daemons."""
    for folder in Path(tempfile.gettempdir()).glob("lidaremu-own-*"):
        found = FOLDER.fullmatch(folder.name)
        with contextlib.suppress(OSError):
            if found and not folder.is_symlink() and folder.stat().st_uid == os.getuid() and not _runs(int(found[1])):
                shutil.rmtree(folder, ignore_errors=True)


def _runs(number: int) -> bool:
    try:
        os.kill(number, 0)
    except ProcessLookupError:
        return False
    except (OSError, OverflowError):
        return True
    return True


# ---------------------------------------------------------------- the daemon's side


def end_hard() -> None:
    """End this process; its workers are ended by the kernel with it."""
    os.kill(os.getpid(), signal.SIGKILL)


class Leash:
    """The daemon's side: its standard input, whose end is to end it."""

    def __init__(self, descriptor: int, folder: Path | None, time_limit_s: float = TIME_LIMIT_S) -> None:
        self._descriptor = descriptor
        self._folder = folder
        self._time_limit_s = time_limit_s
        self._over = threading.Event()

    def ended(self) -> bool:
        """Whether the input has ended by now."""
        return bool(select.select([self._descriptor], [], [], 0.0)[0]) and not self._read()

    def _read(self) -> bytes:
        try:
            return os.read(self._descriptor, 4096)
        except OSError:  # a terminal that has gone
            return b""

    def watch(
        self,
        stop: Callable[[], object],
        call: Callable[[Callable[[], object]], object],
        kill: Callable[[], object] = end_hard,
    ) -> None:
        """Call `stop` when the input ends, and wake the run up by `call`; `kill` when that has not helped."""
        threading.Thread(target=self._wait, args=(stop, call, kill), name="lidaremu-leash", daemon=True).start()

    def _wait(
        self, stop: Callable[[], object], call: Callable[[Callable[[], object]], object], kill: Callable[[], object]
    ) -> None:
        while self._read():
            pass
        if self._over.is_set():
            return
        stop()
        call(lambda: None)
        if not self._over.wait(self._time_limit_s):
            self.remove()
            kill()

    def remove(self) -> None:
        """The folder, with what is left in it."""
        if self._folder is not None and FOLDER.fullmatch(self._folder.name):
            shutil.rmtree(self._folder, ignore_errors=True)

    def close(self) -> None:
        """The run is over in order."""
        self._over.set()


@contextmanager
def leashed(wanted: bool, folder: Path | None) -> Iterator[Leash | None]:
    """The leash of a run that ends with its standard input; None where it does not."""
    if not wanted:
        yield None
        return
    leash = Leash(sys.stdin.fileno(), folder)
    try:
        yield leash
    finally:
        leash.close()
        with contextlib.suppress(OSError, ValueError):
            if leash.ended():  # nobody is left who would
                leash.remove()
