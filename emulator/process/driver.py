"""The driver under test as a child process of `lidaremu run`: started, and ended with all that it has started.

Belongs here: processes, and where a driver learns of its sensors. Not: when one is started (cli, recordings).
"""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

from emulator.errors import EmulatorError

TIME_LIMIT_S = 5.0
"For a driver that has been asked to end."


class Process(NamedTuple):
    """One process; its number alone may have a new owner later."""

    number: int
    began: str
    "In the kernel's ticks since the machine was started."


def start_driver(command: Sequence[str], environment: dict[str, str], as_json: bool) -> subprocess.Popen[bytes]:
    """The driver as a child process; what it prints must not come between our JSON objects."""
    try:
        return subprocess.Popen(list(command), env=environment, stdout=sys.stderr.fileno() if as_json else None)
    except OSError as error:
        raise EmulatorError(f"cannot start {command[0]}: {error.strerror}") from None


FEED = "LIDAREMU_FEED"
"Variable that shows a driver where a feed of a `live` scenario is taken."


def driver_environment(before: Mapping[str, str], links: Sequence[tuple[str, str]]) -> dict[str, str]:
    """Variables for a driver: LIDAREMU_<SENSOR> is the path or address of that sensor's link, its id and URL given."""
    return dict(before) | {variable_of(sensor): place_of(url) for sensor, url in links}


def variable_of(sensor: str) -> str:
    """Name of the environment variable that shows a driver where a sensor is."""
    return "LIDAREMU_" + "".join(letter if letter.isalnum() else "_" for letter in sensor.upper())


def place_of(url: str) -> str:
    """The path or address in a link's URL."""
    return url.partition(":")[2].partition("?")[0]


def how_it_ended(code: int) -> str:
    """A process's exit code in words."""
    return f"exit code {code}" if code >= 0 else f"signal {-code}"


def end_driver(driver: subprocess.Popen[bytes]) -> int:
    """Its exit code; 0 of one that still ran: it is asked to end, then made to, with all that it has started.

    A shell that is ended would leave the driver that it runs.
    """
    if driver.poll() is not None:
        return driver.returncode
    family = list(family_of(driver.pid))
    for one in family:
        _send(one, signal.SIGTERM)
    with contextlib.suppress(subprocess.TimeoutExpired):
        driver.wait(TIME_LIMIT_S)
    for one in family:
        _send(one, signal.SIGKILL)
    driver.wait()
    return 0


def family_of(number: int) -> Iterator[Process]:
    """A process and all that it, and those, have started and that still run."""
    parents: dict[int, list[Process]] = {}
    for folder in Path("/proc").iterdir():
        if folder.name.isdecimal() and (found := _parent_of(int(folder.name))) is not None:
            parent, process = found
            parents.setdefault(parent, []).append(process)
            if process.number == number:
                yield process
    waiting = [number]
    while waiting:
        children = parents.get(waiting.pop(), [])
        yield from children
        waiting += [child.number for child in children]


def _parent_of(number: int) -> tuple[int, Process] | None:
    """Its parent, and the process; None when it has ended. proc(5): fields 4 and 22 of `stat`, the name in brackets."""
    try:
        fields = Path(f"/proc/{number}/stat").read_text("utf-8", "replace").rpartition(")")[2].split()
    except OSError:
        return None
    return int(fields[1]), Process(number, fields[19])


def _send(process: Process, number: signal.Signals) -> None:
    """A signal, to nobody else who has the number by now."""
    found = _parent_of(process.number)
    if found is not None and found[1] == process:
        with contextlib.suppress(OSError):
            os.kill(process.number, number)
