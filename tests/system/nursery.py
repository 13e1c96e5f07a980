"""`lidaremu` as a process of its own that costs no start: forked from one that has imported it once.

Belongs here: that process (`python -m tests.system.nursery DESCRIPTOR`) and the `Popen` that asks it. What is started
has its own number, folder, environment, streams and signals, and ends as it would end after `python -m emulator`. Only
the import is saved, which takes longer than most tests; that the import works is seen wherever a test starts the
command itself (wheel, pages, examples, terminals). Without `os.fork`, and where the environment asks for another form
of the loops than the process has, it is started as usual.
"""

from __future__ import annotations

import contextlib
import gc
import json
import os
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Mapping, Sequence
from importlib import import_module
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[2]
SWITCH = "LIDAREMU_COMPILED"
PARTS = (
    "commands.cli", "hosts.ld", "hosts.lms2xx", "injection.run", "judging.trial", "looking.demo", "looking.look",
    "looking.screen", "objects.measure", "recording.writer", "runtime.assembly", "runtime.control", "runtime.daemon",
    "runtime.playback", "runtime.virtual_daemon", "scenario.scenario", "sensing.measure", "world.scene",
)  # fmt: skip
"What most commands import; a command imports by itself what is missing."
Streams = tuple[int, int, int]


# ---------------------------------------------------------------- the process that is forked
def serve(asked: socket.socket) -> Sequence[str] | None:
    """Answers until the tests have ended; returns in each forked process, with its command line."""
    while True:
        line, streams, *_ = socket.recv_fds(asked, 1 << 20, 3)
        if not line:
            return None
        order = json.loads(line)
        if "number" in order:
            found, status = os.waitpid(order["number"], os.WNOHANG)
            answer: object = status if found else None
        else:
            answer = os.fork()
            if not answer:
                asked.close()
                become(order, (streams[0], streams[1], streams[2]))
                return list(order["words"])
            for one in streams:
                os.close(one)
        asked.sendall(json.dumps(answer).encode())


def become(order: Mapping[str, Any], streams: Streams) -> None:
    """Take over what is a process's own."""
    for number, stream in enumerate(streams):
        os.dup2(stream, number)
    for stream in streams:
        os.close(stream)
    sys.stdin, sys.stdout = open(0), open(1, "w")
    sys.stderr = open(2, "w", buffering=1, errors="backslashreplace")
    tempfile.tempdir = None  # as the environment says
    os.environ.clear()
    os.environ.update(order["environment"])
    os.chdir(order["folder"])
    with contextlib.suppress(PermissionError):
        os.nice(order["nicer"])


def main() -> None:
    for name in PARTS:
        import_module(f"emulator.{name}")
    from emulator.commands.cli import entry

    gc.collect()
    gc.freeze()
    asked = socket.socket(fileno=int(sys.argv[1]))
    words = serve(asked)
    if words is not None:
        sys.argv = ["lidaremu", *words]
        entry()


# ---------------------------------------------------------------- the tests' end
class Nursery:
    """The process, started by the first who asks."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._socket: socket.socket | None = None
        self._process: subprocess.Popen[bytes] | None = None

    def ask(self, order: Mapping[str, object], streams: Sequence[int] = ()) -> Any:
        with self._lock:
            if self._socket is None:
                self._socket, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
                with theirs:
                    self._process = subprocess.Popen(
                        [sys.executable, "-m", "tests.system.nursery", str(theirs.fileno())],
                        cwd=ROOT, env=os.environ | {"PYTHONPATH": str(ROOT)}, pass_fds=[theirs.fileno()],
                        stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL,
                    )  # fmt: skip
            socket.send_fds(self._socket, [json.dumps(order).encode()], list(streams))
            return json.loads(self._socket.recv(1 << 16))

    def close(self) -> None:
        if self._socket is not None and self._process is not None:
            self._socket.close()
            self._process.wait()
            self._socket = self._process = None


NURSERY = Nursery()


class Forked(subprocess.Popen[str]):
    """A process of which the nursery is the parent, used like any other."""

    def _execute_child(self, args: Any, *more: Any) -> None:
        cwd, env, pipes = more[4], more[5], more[9:15]
        theirs = (pipes[0], pipes[3], pipes[5])
        streams = [own if given == -1 else given for own, given in enumerate(theirs)]
        order = {"words": args, "folder": str(cwd), "environment": dict(env), "nicer": self.nicer}
        try:
            self.pid = NURSERY.ask(order, streams)
            self._child_created = True
        finally:
            self._close_pipe_fds(*pipes)

    def __init__(self, *given: Any, nicer: int = 0, **named: Any) -> None:
        self.nicer = nicer
        super().__init__(*given, **named)

    def _internal_poll(self, *_: Any, **__: Any) -> int | None:
        if self.returncode is None:
            status = NURSERY.ask({"number": self.pid})
            if status is not None:
                self.returncode = os.waitstatus_to_exitcode(status)
        return self.returncode

    def _try_wait(self, wait_flags: int) -> tuple[int, int]:
        while (status := NURSERY.ask({"number": self.pid})) is None:
            if wait_flags & os.WNOHANG:
                return 0, 0
            time.sleep(0.01)
        return self.pid, status


def begun(
    *words: str, cwd: Path, more: Mapping[str, str] | None = None, nicer: int = 0, forked: bool = True, **streams: Any
) -> subprocess.Popen[str]:
    """`lidaremu WORDS` in that folder; `more` of the environment, `streams` as of `Popen` (both outputs are pipes).

    `forked` : False: the command as a user starts it, whose own processes import what they need
    """
    environment = os.environ | {"PYTHONPATH": str(ROOT)} | (more or {})
    streams = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE} | streams
    if forked and hasattr(os, "fork") and environment.get(SWITCH) == os.environ.get(SWITCH):
        return Forked(list(words), cwd=cwd, env=environment, text=True, nicer=nicer, **streams)
    first = ["nice", "-n", str(nicer)] if nicer else []
    command = [*first, sys.executable, "-m", "emulator", *words]
    return subprocess.Popen(command, cwd=cwd, env=environment, text=True, **streams)


def ran(*words: str, cwd: Path, seconds: float = 240.0, **more: Any) -> subprocess.CompletedProcess[str]:
    """The same to its end."""
    with begun(*words, cwd=cwd, **more) as process:
        try:
            out, errors = process.communicate(timeout=seconds)
        finally:
            process.kill()
    return subprocess.CompletedProcess(list(words), process.returncode, out, errors)


if __name__ == "__main__":
    main()
