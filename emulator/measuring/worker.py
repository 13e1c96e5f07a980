"""One measuring process: what runs in it, the pipe to it, and the few words with which it is started and ended.

Belongs here: the child's body, messages in both directions, the process as the sender sees it. Not: when it is
started, judged and replaced (supervision). Messages are whole or not there: the sender's end never waits, neither for a
process that was killed in the middle of a scan nor for one that has stopped reading.
"""

from __future__ import annotations

import contextlib
import ctypes
import multiprocessing
import os
import signal
import socket
from collections.abc import Mapping
from dataclasses import replace
from multiprocessing.reduction import ForkingPickler  # as multiprocessing's own pipes: between our own processes alone
from typing import Any, Protocol

import numpy as np

from emulator.compiled import switch
from emulator.errors import EmulatorError
from emulator.measuring.measuring import (
    BuildMeasures,
    Measure,
    Reported,
    measured,
    part_measured,
    refusals,
    restore,
    states,
    warnings_of,
)
from protocols.scan import Scan, ScanPlan

PR_SET_PDEATHSIG = 1
"linux/prctl.h."
NICENESS = 5
"Where there is one core: workers yield to the sender."
ARRAYS, LOOPS = "arrays", "loops"
"Form of a sweep's steps in a process, as reported when it is ready."
LENGTH_BYTES = 8
PICKLE = 5
"Protocol with the fewest copies of arrays."
SENT_BYTES = 1 << 20
"Room asked for in a worker's pipe: a process that has done a sweep goes on to the next before the sender has read it."
READ_AT_ONCE = 1 << 20


NO_PLAN = ScanPlan(-1, -1, 0, np.zeros(0), np.zeros(0), np.zeros(0))
"Stands for the plan of a scan on its way."


class Handle(Protocol):
    """A process as its supervisor sees it; tests put something else in its place."""

    pipe: socket.socket
    "The sender's end, which does not block."
    pid: int

    def exit_code(self) -> int | None:
        """None while it runs; negative: the signal that ended it. Never waits."""

    def ask_to_end(self) -> None: ...

    def kill(self) -> None: ...

    def cpu_ns(self) -> int | None:
        """Processor time that it has used; None where that cannot be known."""


class Pipe:
    """The sender's end of a worker's pipe: whole messages, and no call that waits."""

    def __init__(self, end: socket.socket) -> None:
        end.setblocking(False)
        self._end = end
        self._in = bytearray()
        self._out = memoryview(b"")

    @property
    def is_full(self) -> bool:
        """Something is still to be written, as soon as the other end reads."""
        return len(self._out) > 0

    def put(self, message: object) -> None:
        """Send it, as far as there is room now; `flush` sends the rest."""
        encoded = _encoded(message)
        self._out = memoryview(bytes(self._out) + encoded if self._out else encoded)
        self.flush()

    def flush(self) -> None:
        """Send what there is room for. A pipe that is broken is found by `take`."""
        with contextlib.suppress(OSError):
            while self._out:
                self._out = self._out[self._end.send(self._out) :]

    def take(self) -> list[Any]:
        """Whole messages that have come; `EOFError` once, instead, when there are none and none can come any more."""
        ended = False
        try:
            while data := self._end.recv(READ_AT_ONCE):
                self._in += data
            ended = True
        except BlockingIOError:
            pass
        except OSError:
            ended = True
        found = []
        while len(self._in) >= LENGTH_BYTES:
            end = LENGTH_BYTES + int.from_bytes(self._in[:LENGTH_BYTES], "big")
            if len(self._in) < end:
                break
            with memoryview(self._in)[LENGTH_BYTES:end] as message:
                found.append(ForkingPickler.loads(message))
            del self._in[:end]
        if ended and not found:
            raise EOFError
        return found

    def close(self) -> None:
        """Give it up, with what had not been read or written."""
        self._end.close()


def _encoded(message: object) -> bytes:
    data = ForkingPickler.dumps(message, protocol=PICKLE)
    return b"".join((len(data).to_bytes(LENGTH_BYTES, "big"), data))


class WorkerEnd:
    """The worker's own end, which waits."""

    def __init__(self, end: socket.socket) -> None:
        end.setblocking(True)
        with contextlib.suppress(OSError):
            end.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, SENT_BYTES)
        self._end = end

    def send(self, *message: object) -> None:
        """Send it whole."""
        self._end.sendall(_encoded(message))

    def receive(self) -> Any:
        """The next message; `EOFError` when the sender has gone."""
        return ForkingPickler.loads(self._exactly(int.from_bytes(self._exactly(LENGTH_BYTES), "big")))

    def _exactly(self, count: int) -> bytes:
        found = bytearray()
        while len(found) < count:
            data = self._end.recv(min(READ_AT_ONCE, count - len(found)))
            if not data:
                raise EOFError
            found += data
        return bytes(found)


def _close_inherited(keep: int) -> None:
    """Close what fork handed down: another worker's pipe, or a host's connection, must not be held open here."""
    for name in os.listdir("/proc/self/fd") if os.path.isdir("/proc/self/fd") else map(str, range(3, 1024)):
        number = int(name)
        if number > 2 and number != keep:
            with contextlib.suppress(OSError):
                os.close(number)


def _die_with(parent: int) -> None:
    """Let the kernel end this process with its parent, however that ends: a long scan must not outlive a `kill -9`."""
    with contextlib.suppress(OSError, AttributeError):
        ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, int(signal.SIGKILL), 0, 0, 0)
    if os.getppid() != parent:  # it has ended meanwhile
        os._exit(1)


def yield_to_sender() -> None:
    """Never take a core from the sender; but from other programs what is this process's share.

    A nice value would do the first at the price of the second: under a flood from programs on the same cores scans
    are then measured too late by whole seconds.
    """
    with contextlib.suppress(OSError, AttributeError):
        if len(os.sched_getaffinity(0)) < 2:
            os.nice(NICENESS)
        else:
            os.sched_setscheduler(0, os.SCHED_BATCH, os.sched_param(0))


def _body(end: socket.socket, build: BuildMeasures, parent: int, loops: bool | None) -> None:
    """Of the process: it is the sender's own from here on."""
    for ending in (signal.SIGINT, signal.SIGHUP):  # of the whole terminal: the daemon ends its workers
        signal.signal(ending, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    signal.set_wakeup_fd(-1)
    _die_with(parent)
    _close_inherited(end.fileno())
    yield_to_sender()
    if loops is not None:
        switch.choose(loops)
    if loops:
        switch.kernels()
    with contextlib.suppress(EOFError, OSError):
        serve(WorkerEnd(end), build)


def serve(pipe: WorkerEnd, build: BuildMeasures) -> None:
    """Build once, then answer plans with scans until the pipe closes."""
    try:
        measures = build()
    except EmulatorError as error:
        pipe.send("refused", type(error), error.lines)
        return
    except MemoryError:
        pipe.send("refused", EmulatorError, ("the scene does not fit into memory",))
        return
    reported = Reported()
    pipe.send("ready", LOOPS if switch.in_use() else ARRAYS, reported.new(warnings_of(measures)))
    while True:
        sensor, plan, conditions, *part = pipe.receive()
        if sensor is None and conditions is None:
            pipe.send("state", None, states(measures))
        elif sensor is None:
            restore(measures, conditions)
        elif plan is None:
            pipe.send("judged", None, refusals(measures, sensor, conditions))
        else:
            _measure(pipe, measures, reported, sensor, plan, conditions, *part)


def _measure(
    pipe: WorkerEnd, measures: Mapping[str, Measure], reported: Reported, sensor: str, plan: Any, conditions: Any,
    part: tuple[int, int, bool] | None = None,
) -> None:  # fmt: skip
    try:
        measure = measures[sensor]
        if part is None:
            scan: object = measured(measure, plan, conditions)
        else:
            scan = part_measured(measure, plan, conditions, *part)
        if isinstance(scan, Scan):  # who has asked has the plan
            scan = replace(scan, plan=NO_PLAN)
        for text in reported.new(warnings_of({sensor: measures[sensor]})):
            pipe.send("warning", sensor, text)
        pipe.send("scan", sensor, scan)
    except (ArithmeticError, ValueError, LookupError, TypeError, RuntimeError, MemoryError) as error:
        pipe.send("failed", sensor, f"{type(error).__name__}: {error}")


class Forked:
    """A worker as a child process. `OSError` where the machine has none to give."""

    def __init__(self, build: BuildMeasures, loops: bool | None = None) -> None:
        """`loops`: with compiled loops or without; None: as they are switched in this process."""
        self.pipe, theirs = socket.socketpair()
        self._code: int | None = None
        try:
            context = multiprocessing.get_context("fork")
            self._process = context.Process(
                target=_body, args=(theirs, build, os.getpid(), loops), daemon=True, name="lidaremu-measure"
            )
            self._process.start()
        except OSError:
            self.pipe.close()
            raise
        finally:
            theirs.close()
        assert self._process.pid is not None
        self.pid = self._process.pid

    def exit_code(self) -> int | None:
        """None while it runs. Once it has ended, nothing of it is left here: neither a zombie nor a descriptor."""
        if self._code is None and (code := self._process.exitcode) is not None:
            self._code = code
            self._process.join()
            self._process.close()
        return self._code

    def ask_to_end(self) -> None:
        """It ends at once unless it stands still."""
        if self.exit_code() is None:
            self._process.terminate()

    def kill(self) -> None:
        """It ends, standing still or not."""
        if self.exit_code() is None:
            self._process.kill()

    def cpu_ns(self) -> int | None:
        """proc(5): fields 14 and 15 of `stat`, in ticks."""
        try:
            with open(f"/proc/{self.pid}/stat", "rb") as file:
                fields = file.read().rpartition(b")")[2].split()
        except OSError:
            return None
        return (int(fields[11]) + int(fields[12])) * 1_000_000_000 // os.sysconf("SC_CLK_TCK")
