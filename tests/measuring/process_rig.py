"""A daemon on a clock that the test moves, with measuring processes that are played: killed, stopped, slowed at will.

Everything but the processes is the real thing: sessions, instruments, `Daemon`, `Workers`, links in memory. Nothing
waits and nothing forks.
"""

from __future__ import annotations

import socket
from collections import deque
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from emulator.hosts.scripted import LdScript, Lms2xxScript
from emulator.instrument.observer import Observer, Payload
from emulator.measuring.measuring import Measures
from emulator.measuring.parts import part_of_scan
from emulator.measuring.supervision import Workers
from emulator.measuring.worker import Pipe
from emulator.process.clock import ManualClock
from emulator.runtime import assembly
from emulator.runtime.daemon import Daemon
from emulator.scenario import scenario
from emulator.transports.loopback import Loops
from protocols.scan import Scan, ScanPlan

MS, SECOND = 1_000_000, 1_000_000_000
RATE_HZ = 37.5
"Of an LMS291 of the rig."
SLICE_NS = 8 * MS
"How long each step takes; where a test says so, half of it."

LMS = '  - {{id: {0}, model: sick-lms291-s05, links: ["loop:{0}"], device: {{delays: fast, start: running}}}}'
LD = '  - {{id: {0}, model: sick-ld-lrs1000, links: ["loop:{0}"], device: {{delays: fast, step_deg: 4, motor_hz: 10}}}}'
LISTS = '  - {{id: {0}, model: can-ars408, from: [{1}], links: ["can:virtual:{2}"]}}'
WORLD = "schema: 1\nworld:\n  - {box: {size_m: [0.3, 50, 4]}, at_m: [10, 0, 0], material: concrete}\nsensors:\n"


class Played:
    """A process: builds for a while, measures for a while, and does what the test says."""

    pid = 4711

    def __init__(self, rig: Rig, builds_ns: int, loops: bool | None = None) -> None:
        self.loops = loops
        self.form = "loops" if loops else "arrays"
        self.takes_ns: int | None = None
        "A sweep; None: as all of the rig."
        self.takes_of: dict[str, int] = {}
        "The same by sensor."
        self.state: object = {}
        "What it has been told to go on from."
        self.pipe, theirs = socket.socketpair()
        self.pipe.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 4096)
        self._end = Pipe(theirs)
        self._rig = rig
        self._ready_ns = rig.clock.now_ns() + builds_ns
        self.is_ready = False
        self.stopped = False
        self.code: int | None = None
        self.jobs: deque[tuple[Any, ...]] = deque()
        "Sensor, plan, conditions; of a part of a sweep its number, and of how many."
        self._done_ns = 0
        self.measured: list[tuple[str, int]] = []
        self.cpu = 0
        self.refuses = ""
        self.dies_at: Callable[[str, ScanPlan], bool] = lambda sensor, plan: False
        self.sends: Callable[[Scan], Any] = lambda scan: scan
        self.divides = True
        "It can measure parts of sweeps."

    def exit_code(self) -> int | None:
        return self.code

    def ask_to_end(self) -> None:
        if not self.stopped:
            self.end(-15)

    def kill(self) -> None:
        self.end(-9)

    def cpu_ns(self) -> int | None:
        return self.cpu

    def end(self, code: int) -> None:
        """It is gone."""
        if self.code is None:
            self.code = code
            self._end.close()

    def die_in_a_message(self) -> None:
        """Killed while it sends: half a scan is in the pipe."""
        from emulator.measuring.worker import _encoded

        sensor, plan, *_ = self.jobs[0]
        self._end._end.send(_encoded(("scan", sensor, Scan.empty(plan)))[:200])
        self.end(-9)

    @property
    def busy(self) -> bool:
        return bool(self.jobs)

    def step(self, now_ns: int) -> None:
        """Go on to this instant."""
        if self.stopped or self.code is not None:
            return
        self.cpu += self._rig.cpu_ns
        if not self.is_ready:
            if now_ns >= self._ready_ns:
                if self.refuses:
                    from emulator.errors import SceneError

                    self._end.put(("refused", SceneError, (self.refuses,)))
                    return
                self.is_ready = True
                self._end.put(("ready", self.form, []))
            return
        try:
            for message in self._end.take():
                if message[0] is None:
                    self._hand_over(message[2])
                    continue
                self.jobs.append(message)
                if len(self.jobs) == 1:
                    self._done_ns = now_ns + self._takes_ns
        except EOFError:
            self.end(0)
            return
        self._end.flush()
        while self.jobs and now_ns >= self._done_ns:
            sensor, plan, _, *part = self.jobs.popleft()
            if self.dies_at(sensor, plan):
                self.end(-11)
                return
            if plan is None:
                self._end.put(("judged", None, {}))
                continue
            self.measured.append((sensor, plan.sweep))
            found = self.sends(self._rig.scan_of(plan))
            if isinstance(found, Exception):
                self._end.put(("failed", sensor, f"{type(found).__name__}: {found}"))
            else:
                if part and found is not None and self.divides:
                    found = part_of_scan(found, *part[0])
                elif part and part[0][0]:
                    found = None
                self._end.put(("scan", sensor, found))
            self._done_ns = now_ns + self._takes_ns

    @property
    def _takes_ns(self) -> int:
        if self.jobs and self.jobs[0][0] in self.takes_of:
            return self.takes_of[self.jobs[0][0]]
        return self._rig.takes_ns if self.takes_ns is None else self.takes_ns

    def _hand_over(self, state: object) -> None:
        if state is None:
            self._end.put(("state", None, {"of": self._rig.processes.index(self)}))
        else:
            self.state = state


class PlayedBuilding:
    """Loops that are built when the test says so."""

    def __init__(self) -> None:
        self.done: bool | None = None
        self.closed = False

    def poll(self) -> bool | None:
        return self.done

    def why(self) -> str:
        return "signal 9"

    def close(self) -> None:
        self.closed = True


class Sent(Observer):
    """When scans left, by sensor."""

    def __init__(self) -> None:
        self.at_ns: dict[str, list[int]] = {}
        self.sweeps: dict[str, list[int]] = {}

    def payload(self, payload: Payload) -> None:
        if payload.sent and payload.sweep is not None:
            self.at_ns.setdefault(payload.sensor, []).append(payload.start_ns)
            self.sweeps.setdefault(payload.sensor, []).append(payload.sweep)


class Rig:
    """Sensors on links in memory, with hosts that stream, and one played process or more."""

    def __init__(
        self,
        *sensors: str,
        workers: int = 1,
        text: str = "",
        builds_ns: int = 300 * MS,
        build_loops: Callable[[], Any] | None = None,
        slice_ns: int = SLICE_NS,
        shared: Sequence[str] = (),
    ) -> None:
        """`sensors`: ids of LMS291 at 37.5 scans a second. `text`: rows of other sensors. `shared`: as of `Workers`."""
        rows = [LMS.format(name) for name in sensors] + ([text] if text else [])
        loaded = scenario.loads(WORLD + "\n".join(rows) + "\n", Path("rig.yaml"))
        self.clock, self.slice_ns = ManualClock(), slice_ns
        self.takes_ns, self.cpu_ns = 2 * MS, MS
        self.builds_ns = 0
        self.launch_error: OSError | None = None
        self.on_launch: Callable[[Played], None] = lambda made: None
        self.processes: list[Played] = []
        self.reported: list[str] = []
        names = [one.id for one in loaded.sensors]
        self.workers = Workers(Measures, names, workers, self.clock, _Stepping(self), self._launch, build_loops, shared)
        self.builds_ns = builds_ns
        loops = Loops()
        self.sessions = assembly.new_sessions(loaded)
        self.instruments = assembly.open_instruments(loaded, self.sessions, self.workers, loops)
        self.by_name = {one.sensor: one for one in self.instruments}
        self.daemon = Daemon(self.instruments, self.clock, self.workers, self.reported.append)
        self.sent = Sent()
        self.ends: list[Any] = []
        self.hosts: dict[str, Any] = {}
        for one in self.instruments:
            one.watch(self.sent)
            if one.links[0].url.startswith("loop:"):
                end = loops[one.sensor].connect()
                self.ends.append(end)
                script = LdScript if one.family is not None and one.family.name == "ld" else Lms2xxScript
                self.hosts[one.sensor] = script(end, lambda now_ns, scan: None)
        self.daemon.power_on()

    def _launch(self, loops: bool | None) -> Played:
        if self.launch_error is not None:
            raise self.launch_error
        made = Played(self, self.builds_ns, loops)
        self.processes.append(made)
        self.on_launch(made)
        return made

    @staticmethod
    def scan_of(plan: ScanPlan) -> Scan:
        scan = Scan.empty(plan)
        scan.range_m[:] = 5.0
        scan.intensity[:] = 10.0
        return scan

    @property
    def process(self) -> Played:
        """The newest one."""
        return self.processes[-1]

    def played(self) -> None:
        """Processes go on."""
        for one in self.processes:
            one.step(self.clock.now_ns())

    def advance(self, seconds: float, until: Callable[[], bool] = lambda: False) -> bool:
        """Serve for so long, or until something holds; whether it does."""
        end_ns = self.clock.now_ns() + round(seconds * SECOND)
        while self.clock.now_ns() < end_ns and not until():
            self.clock.set(min(end_ns, self.clock.now_ns() + self.slice_ns))
            self.played()
            self.serve()
        return until()

    def serve(self) -> None:
        """One round of the sender."""
        now_ns = self.clock.now_ns()
        if now_ns >= self.daemon._look_ns:
            self.daemon._look_around(now_ns)
        self.daemon._take_results()
        self.daemon._step_due(now_ns)
        for name, host in list(self.hosts.items()):
            if len(self.sent.at_ns.get(name, ())) < 5:
                host.step(now_ns)
            for link in self.by_name[name].links:
                link.flush(now_ns)
                self.daemon._wake[self.instruments.index(self.by_name[name])] = now_ns
        for end in self.ends:
            end.read()

    def sleep(self, seconds: float) -> None:
        """The sender is stopped; the processes go on."""
        end_ns = self.clock.now_ns() + round(seconds * SECOND)
        while self.clock.now_ns() < end_ns:
            self.clock.set(min(end_ns, self.clock.now_ns() + self.slice_ns))
            self.played()

    def stream(self, *sensors: str) -> None:
        """Go on until each has sent five scans."""
        names = sensors or tuple(self.hosts)
        assert self.advance(30.0, lambda: all(len(self.sent.at_ns.get(name, ())) >= 5 for name in names)), (
            self.sent.at_ns
        )
        self.advance(0.5)

    def rate_hz(self, sensor: str, seconds: float) -> float:
        """Scans a second that it sends from now on."""
        before = len(self.sent.at_ns[sensor])
        self.advance(seconds)
        return (len(self.sent.at_ns[sensor]) - before) / seconds

    def kinds(self) -> list[str]:
        """Incidents so far."""
        return [str(row["kind"]) for row in self.daemon.incidents.rows()]

    def texts(self) -> list[str]:
        return [str(row["text"]) for row in self.daemon.incidents.rows()]

    def late(self, sensor: str) -> int:
        return self.by_name[sensor].stats.scans_dropped["measured too late"]

    def oldest_s(self, sensor: str, since_ns: int) -> float:
        """How old the oldest scan was that left after an instant, at the instant it was handed over."""
        return max((self.clock.now_ns() - at) * 1e-9 for at in self.sent.at_ns[sensor] if at >= since_ns)

    def close(self) -> None:
        self.daemon.close()


Make = Callable[..., Rig]
"`rig` of the tests: it is closed at their end."


class _Stepping:
    """The clock of the supervision: while the first processes build, each look at it lets them go on."""

    def __init__(self, rig: Rig) -> None:
        self._rig = rig

    def now_ns(self) -> int:
        if not hasattr(self._rig, "daemon"):
            self._rig.played()
        return self._rig.clock.now_ns()
