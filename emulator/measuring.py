"""Who turns plans into scans: in place (virtual time, tests), or worker processes ahead of the sender.

A worker builds the scene for itself and keeps it; plans go in and scans come out over a pipe. The sending process
imports neither embreex nor trimesh, and a slow scan costs it nothing but the scan.
"""

from __future__ import annotations

import contextlib
import ctypes
import multiprocessing
import multiprocessing.connection
import os
import signal
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Future
from dataclasses import dataclass, field
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from typing import Protocol, runtime_checkable

from emulator.conditions import NORMAL, Conditions
from emulator.errors import EmulatorError, SceneError
from emulator.weather import WeatherConfig
from protocols.scan import Scan, ScanPlan

Measure = Callable[..., Scan]
"Of a plan, and of the conditions where they are not `NORMAL`."
BuildMeasures = Callable[[], Mapping[str, Measure]]
"Builds the measuring function of every sensor; must be picklable or inherited by fork."


class Measures(dict[str, Measure]):
    """Measuring functions by sensor, and what their scene warns of."""

    def __init__(self, functions: Mapping[str, Measure], warnings: Sequence[str] = ()) -> None:
        super().__init__(functions)
        self.warnings = tuple(warnings)


def warnings_of(measures: Mapping[str, Measure]) -> tuple[str, ...]:
    """What is computed all the same but outside the range where it is known to hold, one line each, by sensor."""
    found = dict.fromkeys(getattr(measures, "warnings", ()))
    for sensor, measure in measures.items():
        found |= dict.fromkeys(f"{sensor}: {text}" for text in getattr(measure, "warnings", ()))
    return tuple(found)


class _Told:
    """Passes on every warning once."""

    def __init__(self) -> None:
        self._known: set[str] = set()

    def new(self, texts: Sequence[str]) -> list[str]:
        fresh = [text for text in texts if text not in self._known]
        self._known.update(fresh)
        return fresh


PR_SET_PDEATHSIG = 1
"linux/prctl.h."
NICENESS = 5
"Where there is one core: workers yield to the sender."


def measured(measure: Measure, plan: ScanPlan, conditions: Conditions) -> Scan:
    """One sweep under its conditions."""
    return measure(plan) if conditions is NORMAL or conditions == NORMAL else measure(plan, conditions)


def refusals(measures: Mapping[str, Measure], sensors: Sequence[str], weather: WeatherConfig) -> dict[str, str]:
    """Which of these sensors cannot compute such weather, and why; one that lists objects is as its sources."""
    found = {name: getattr(measures[name], "refuses", lambda _: "")(weather) for name in sensors}
    return {name: why for name, why in found.items() if why}


@runtime_checkable
class Judges(Protocol):
    """Who measures and can say what it cannot."""

    def judge(self, weather: WeatherConfig) -> Sequence[Future[dict[str, str]]]:
        """`refusals` of all sensors, in parts that come when whoever measures gets round to it."""


class InPlace:
    """Measures when asked, in the caller's own time."""

    def __init__(self, measures: Mapping[str, Measure]) -> None:
        self._measures = measures
        self._done: dict[str, list[Scan]] = {}
        self._told = _Told()
        self.warnings: list[str] = self._told.new(warnings_of(measures))
        "What is not yet passed on; whoever does empties it."

    def request(self, sensor: str, plan: ScanPlan, conditions: Conditions = NORMAL) -> None:
        self._done.setdefault(sensor, []).append(measured(self._measures[sensor], plan, conditions))
        self.warnings += self._told.new(warnings_of({sensor: self._measures[sensor]}))

    def collect(self, sensor: str) -> list[Scan]:
        return self._done.pop(sensor, [])

    def judge(self, weather: WeatherConfig) -> list[Future[dict[str, str]]]:
        found: Future[dict[str, str]] = Future()
        found.set_result(refusals(self._measures, list(self._measures), weather))
        return [found]


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


def _serve(connection: Connection, build: BuildMeasures, parent: int) -> None:
    """Body of a worker: build once, then answer plans with scans until the pipe closes."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    _die_with(parent)
    _close_inherited(connection.fileno())
    yield_to_sender()
    try:
        measures = build()
    except EmulatorError as error:
        connection.send(("refused", type(error), str(error)))
        return
    told = _Told()
    connection.send(("ready", None, told.new(warnings_of(measures))))
    with contextlib.suppress(EOFError, OSError, BrokenPipeError):
        while True:
            sensor, plan, conditions = connection.recv()
            if plan is None:
                connection.send(("judged", None, refusals(measures, sensor, conditions)))
                continue
            try:
                scan = measured(measures[sensor], plan, conditions)
                for text in told.new(warnings_of({sensor: measures[sensor]})):
                    connection.send(("warning", sensor, text))
                connection.send(("scan", sensor, scan))
            except (ArithmeticError, ValueError, LookupError, TypeError, RuntimeError, MemoryError) as error:
                connection.send(("failed", sensor, (plan, f"{type(error).__name__}: {error}")))


@dataclass
class _Question:
    """Whether some sensors can compute such weather; stands among the sweeps that a worker owes."""

    sensors: tuple[str, ...]
    weather: WeatherConfig
    answer: Future[dict[str, str]] = field(default_factory=Future)

    def as_sent(self) -> tuple[tuple[str, ...], None, WeatherConfig]:
        return self.sensors, None, self.weather


class Workers:
    """Worker processes, each serving a fixed share of the sensors. Must be made before any link is opened.

    A worker that dies is started again and given the plans it still owed. A sweep that cannot be measured, or that ends
    its worker twice, is reported in `failures` and comes back without echoes: one sensor's fault stops no other.
    """

    def __init__(self, build: BuildMeasures, sensors: Sequence[str], count: int) -> None:
        self._build = build
        self._context = multiprocessing.get_context("fork")
        self._workers: list[tuple[BaseProcess, Connection]] = []
        self._home = {sensor: index % max(1, count) for index, sensor in enumerate(sensors)}
        self._owed: list[deque[tuple[str, ScanPlan, Conditions] | _Question]] = []
        self._done: dict[str, list[Scan]] = {}
        self._suspect: dict[int, ScanPlan] = {}
        self.failures: list[str] = []
        self._told = _Told()
        self.warnings: list[str] = []
        "What is not yet passed on; whoever does empties it."
        for _ in range(max(1, min(count, len(sensors)))):
            self._workers.append(self._start())
            self._owed.append(deque())
        try:
            for _, connection in self._workers:
                self._await_ready(connection)
        except BaseException:
            self.close()
            raise

    def _start(self) -> tuple[BaseProcess, Connection]:
        ours, theirs = self._context.Pipe()
        work = (theirs, self._build, os.getpid())
        process = self._context.Process(target=_serve, args=work, daemon=True, name="lidaremu-measure")
        process.start()
        theirs.close()
        return process, ours

    def _await_ready(self, connection: Connection) -> None:
        try:
            word, kind, detail = connection.recv()
        except EOFError:
            raise SceneError("the measuring process ended while it built the scene (out of memory?)") from None
        if word == "refused":
            raise kind(detail)
        self.warnings += self._told.new(detail)

    def filenos(self) -> tuple[int, ...]:
        """Descriptors that become readable when a scan is ready."""
        return tuple(connection.fileno() for _, connection in self._workers)

    def request(self, sensor: str, plan: ScanPlan, conditions: Conditions = NORMAL) -> None:
        self._owe(self._home[sensor], (sensor, plan, conditions))

    def judge(self, weather: WeatherConfig) -> list[Future[dict[str, str]]]:
        questions = []
        for home in range(len(self._workers)):
            sensors = tuple(name for name, place in self._home.items() if place == home)
            questions.append(_Question(sensors, weather))
            self._owe(home, questions[-1])
        return [one.answer for one in questions]

    def _owe(self, home: int, work: tuple[str, ScanPlan, Conditions] | _Question) -> None:
        self._owed[home].append(work)
        if len(self._owed[home]) == 1:
            self._hand_over(home)

    def _hand_over(self, home: int) -> None:
        # One plan at a time: an idle worker reads at once, so that a plan larger than the pipe cannot block the sender.
        if self._owed[home]:
            with contextlib.suppress(OSError):  # a dead worker is replaced by `poll`
                work = self._owed[home][0]
                self._workers[home][1].send(work.as_sent() if isinstance(work, _Question) else work)

    def poll(self) -> set[str]:
        """Take in finished scans; the sensors that have some."""
        fresh: set[str] = set()
        for home, (_, connection) in enumerate(self._workers):
            try:
                while connection.poll():
                    word, sensor, result = connection.recv()
                    if word == "warning":
                        self.warnings += self._told.new([result])
                        continue
                    done = self._owed[home].popleft()
                    self._hand_over(home)
                    if isinstance(done, _Question):
                        done.answer.set_result(result)
                        continue
                    if word == "failed":
                        plan, why = result
                        self.failures.append(f"{sensor}: sweep {plan.sweep}: {why}")
                        result = Scan.empty(plan)
                    self._done.setdefault(sensor, []).append(result)
                    fresh.add(sensor)
            except (EOFError, OSError):
                given_up = self._replace(home)
                if given_up is not None:
                    fresh.add(given_up)
        return fresh

    def _replace(self, home: int) -> str | None:
        """Start a dead worker again; the sensor whose sweep has now killed it twice and is given up."""
        process, connection = self._workers[home]
        connection.close()
        process.join(timeout=1.0)
        self.failures.append(f"measuring process {home}: ended with code {process.exitcode}, started again")
        given_up = None
        work = self._owed[home][0] if self._owed[home] else None
        if isinstance(work, _Question):
            self._owed[home].popleft()
            work.answer.set_result({})
        elif work is not None:
            sensor, plan, _ = work
            if self._suspect.get(home) is plan:
                self._owed[home].popleft()
                self.failures.append(f"{sensor}: sweep {plan.sweep}: ended the measuring process twice")
                self._done.setdefault(sensor, []).append(Scan.empty(plan))
                given_up = sensor
            else:
                self._suspect[home] = plan
        self._workers[home] = self._start()
        self._await_ready(self._workers[home][1])
        self._hand_over(home)
        return given_up

    def settle(self) -> set[str]:
        """Wait until nothing is owed; the sensors that have fresh scans. Virtual time stands still meanwhile."""
        fresh: set[str] = set()
        while any(self._owed):
            owing = [self._workers[home][1] for home, owed in enumerate(self._owed) if owed]
            multiprocessing.connection.wait(owing)
            fresh |= self.poll()
        return fresh

    def collect(self, sensor: str) -> list[Scan]:
        return self._done.pop(sensor, [])

    def close(self) -> None:
        """End the workers."""
        for process, connection in self._workers:
            connection.close()
            process.terminate()
        for process, _ in self._workers:
            process.join(timeout=2.0)
