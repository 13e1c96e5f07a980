"""The sending process: waits for hosts and deadlines, steps the instruments, and accounts for every scan.

Deadlines are absolute on the monotonic clock: a late wake-up is caught up, never added to the next one.
"""

from __future__ import annotations

import contextlib
import gc
import selectors
import signal
import socket
import sys
from collections import Counter, deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future
from dataclasses import dataclass
from types import FrameType

import numpy as np

from emulator.errors import LinkError
from emulator.injection.run import FaultRun
from emulator.instrument.instrument import Instrument
from emulator.measuring.supervision import Workers
from emulator.process.clock import Clock, ThreadClock
from emulator.process.incidents import Incidents
from emulator.process.sd_notify import Notifier
from emulator.process.time_limits import TICK_NS, RunningTime
from emulator.process.waiting import Waiter, sharpen_timers, shorten_slices
from emulator.runtime.feeding import Feeding
from emulator.runtime.liveness import Liveness, report_workers
from emulator.runtime.own_daemon import ending_signals
from emulator.runtime.path_guard import PathGuard
from emulator.transports.announcing import Announcer
from emulator.transports.turns import Turn

SWITCH_S = 0.0005
"Another thread (control, a browser's page) that computes gives way to the sender after this; Python's own is 5 ms."
DURATION_OVER, COMMAND_ENDED = "its duration is over", "its command has ended"
LONG_STEP_NS = 200_000
"After a step of so long, what others have to send by now leaves before the next one."


class Daemon:
    """Runs instruments on a real clock until asked to stop."""

    def __init__(
        self,
        instruments: Sequence[Instrument],
        clock: Clock,
        workers: Workers | None = None,
        on_failure: Callable[[str], None] = lambda text: None,
    ) -> None:
        self._instruments = list(instruments)
        self._turns = turns_of(self._instruments)
        for turn in self._turns:
            turn.clock_ns, turn.wall_ns = ThreadClock().now_ns, clock.now_ns
        self._clock = clock
        self._workers = workers
        self.on_failure = on_failure
        self._stop = False
        self.why = ""
        "Why the run has ended, in words; empty: it has not."
        self._selector = selectors.EpollSelector()
        self.waiter = Waiter(clock, self._selector.fileno())
        self._watched: dict[int, tuple[int, ...]] = {}
        self._watch_state: dict[int, tuple[int, tuple[int, ...]]] = {}
        self._wake: dict[int, int | None] = {}
        self._orders: deque[tuple[Callable[[], object], Future[object]]] = deque()
        self._bell, self._ring = socket.socketpair()
        self._bell.setblocking(False)
        self._ring.setblocking(False)
        self._selector.register(self._bell, selectors.EVENT_READ, "orders")
        self._lost: set[int] = set()
        self.lost_links: list[str] = []
        self.faults: FaultRun | None = None
        "Injected faults in this run."
        self.feeding: Feeding | None = None
        "Who moves the world from outside."
        self.announcer: Announcer | None = None
        "Who announces devices by mDNS."
        self.failures: Counter[str] = Counter()
        "Scans that could not be measured, by cause."
        self.incidents = Incidents()
        "Incidents of the run's processes, files and links."
        self.notifier = Notifier()
        "Who started us, if it wants to know."
        self._ran = RunningTime()
        self._look_ns = 0
        "When processes and sensors are looked at next."
        takes_ns = {} if workers is None else {"takes_ns": workers.takes_ns}
        self.liveness = Liveness(self._instruments, self.incidents, **takes_ns)
        for number in () if workers is None else workers.filenos():
            self._selector.register(number, selectors.EVENT_READ, "workers")
        self._path_guard = PathGuard(self._instruments, self.incidents)
        if self._path_guard.fileno() >= 0:
            self._selector.register(self._path_guard.fileno(), selectors.EVENT_READ, "places")

    def stop(self, why: str = "stopped") -> None:
        """End the run after the present step, for that reason; safe in a signal handler."""
        self.why = self.why or why
        self._stop = True

    def call(self, action: Callable[[], object]) -> Future[object]:
        """Have something done between two steps, in this run's own thread; called from other threads."""
        done: Future[object] = Future()
        self._orders.append((action, done))
        with contextlib.suppress(OSError):  # rung already, or all is over
            self._ring.send(b".")
        return done

    def _take_orders(self) -> None:
        with contextlib.suppress(OSError):
            self._bell.recv(4096)
        while self._orders:
            action, done = self._orders.popleft()
            try:
                done.set_result(action())
            except Exception as error:
                done.set_exception(error)

    @contextlib.contextmanager
    def signals(self) -> Iterator[None]:
        """SIGINT, SIGTERM and a closed terminal stop the run while this lasts."""
        reader, writer = socket.socketpair()
        reader.setblocking(False)
        writer.setblocking(False)
        old_fd = signal.set_wakeup_fd(writer.fileno(), warn_on_full_buffer=False)

        def handler(number: int, _frame: FrameType | None) -> None:
            self.stop(f"signal {signal.Signals(number).name}")

        old = {number: signal.signal(number, handler) for number in ending_signals()}
        self._selector.register(reader, selectors.EVENT_READ)
        try:
            yield
        finally:
            self._selector.unregister(reader)
            for number, action in old.items():
                signal.signal(number, action)
            signal.set_wakeup_fd(old_fd)
            reader.close()
            writer.close()

    def power_on(self) -> None:
        """Switch every device on."""
        self._tell_warnings()
        now_ns = self._clock.now_ns()
        for index, instrument in enumerate(self._instruments):
            instrument.power_on(now_ns)
            self._wake[index] = now_ns

    def run(self, until_ns: int | None = None, while_true: Callable[[], bool] | None = None) -> None:
        """Serve until `stop`, until `until_ns`, or until `while_true` says no (asked about ten times per second)."""
        sharpen_timers()
        shorten_slices()
        sys.setswitchinterval(SWITCH_S)
        gc.collect()
        gc.freeze()  # what lives as long as the run is not walked again by the collector
        self.notifier.ready()
        try:
            self._serve(until_ns, while_true)
        finally:
            self._tell_warnings()  # what came with the last step

    def _serve(self, until_ns: int | None, while_true: Callable[[], bool] | None) -> None:
        while not self._stop:
            now_ns = self._clock.now_ns()
            if now_ns >= self._look_ns:
                self._look_around(now_ns)
            if until_ns is not None and now_ns >= until_ns:
                self.why = self.why or DURATION_OVER
                return
            if while_true is not None and not while_true():
                self.why = self.why or COMMAND_ENDED
                return
            self._step_due(now_ns)
            self._path_guard.look(now_ns)
            if any(one.poked for index, one in enumerate(self._instruments) if index not in self._lost):
                continue  # one sensor's scan has begun a fault of another
            self._wait(until_ns, 100_000_000 if while_true is not None else None)

    def _step_due(self, now_ns: int) -> None:
        self._send_due(now_ns)
        for index, instrument in enumerate(self._instruments):
            wake = now_ns if instrument.poked else self._wake.get(index)
            if wake is not None and wake <= now_ns and index not in self._lost:
                self._step(index, instrument)
                late_ns = self._clock.now_ns()
                if late_ns - now_ns > LONG_STEP_NS:  # others' instants may have come in the meantime
                    self._send_due(late_ns)
                    self._step_measured()
                    now_ns = self._clock.now_ns()

    def _step_measured(self) -> None:
        """Sensors whose scans have come are served between long steps of others: a worker waits for its next plan."""
        if self._workers is None:
            return
        before = dict(self._wake)
        self._take_results()
        for index, instrument in enumerate(self._instruments):
            if self._wake.get(index) != before.get(index) and index not in self._lost:
                self._step(index, instrument)

    def _send_due(self, now_ns: int) -> None:
        """What waits in links for this instant leaves before anything else is done."""
        for index, instrument in enumerate(self._instruments):
            wake = self._wake.get(index)
            if wake is None or wake > now_ns or index in self._lost:
                continue
            for link in instrument.links:
                began_ns = self._clock.now_ns()
                link.flush(began_ns)
                if link.stats.lateness_ns:
                    self._note_lateness(instrument, self._clock.now_ns() - began_ns)

    def _rehearse(self, now_ns: int, deadline_ns: int | None) -> None:
        """Everything that `_send_due` will do at the deadline, a moment before: nothing of it is due yet."""
        for index, instrument in enumerate(self._instruments):
            if self._wake.get(index) == deadline_ns and index not in self._lost:
                for link in instrument.links:
                    link.flush(now_ns)

    def _step(self, index: int, instrument: Instrument) -> None:
        now_ns = self._clock.now_ns()
        crowd = sum(turn.crowds(now_ns) for turn in self._turns)
        for turn in self._turns:
            turn.resting = crowd + (not turn.crowds(now_ns))
        try:
            self._wake[index] = instrument.step(now_ns)
        except LinkError as error:
            self._lost.add(index)
            self.lost_links.append(str(error))
            self.on_failure(str(error))
            self._unwatch(index)
            return
        self._note_lateness(instrument, self._clock.now_ns() - now_ns)
        self._watch(index, instrument)

    def _note_lateness(self, instrument: Instrument, step_ns: int) -> None:
        kept = instrument.stats.lateness
        for index, link in enumerate(instrument.links):
            if link.stats.lateness_ns:
                # the link knows when it was called; what it took until the bytes were handed over is added at most
                kept.extend(late + step_ns for late in link.stats.lateness_ns)
                link.stats.lateness_ns.clear()
                if link.stats.departures:
                    instrument.observers.departed(index, link.stats.departures, step_ns)
                    link.stats.departures.clear()

    def _watch(self, index: int, instrument: Instrument) -> None:
        resting = instrument.input_budget.rests(self._clock.now_ns())
        wanted = () if resting else tuple(number for link in instrument.links for number in link.filenos())
        state = (instrument.connections_seen, wanted)
        if state == self._watch_state.get(index):
            return
        self._watch_state[index] = state
        self._unwatch(index)
        for number in wanted:
            self._selector.register(number, selectors.EVENT_READ, index)
        self._watched[index] = wanted

    def _unwatch(self, index: int) -> None:
        for number in self._watched.pop(index, ()):
            # a descriptor that its link has closed in the meantime has left the kernel's set by itself
            with contextlib.suppress(KeyError, ValueError, OSError):
                self._selector.unregister(number)

    def _wait(self, until_ns: int | None, at_most_ns: int | None) -> None:
        wakes = [wake for index, wake in self._wake.items() if wake is not None and index not in self._lost]
        if until_ns is not None:
            wakes.append(until_ns)
        if (look_ns := self._path_guard.next_ns()) is not None:
            wakes.append(look_ns)
        if at_most_ns is not None:
            wakes.append(self._clock.now_ns() + at_most_ns)
        deadline_ns = min(wakes) if wakes else None
        if deadline_ns is None or deadline_ns > self._look_ns:
            ready = self.waiter.doze(self._look_ns)
        else:
            ready = self.waiter.until(deadline_ns, lambda now_ns: self._rehearse(now_ns, deadline_ns))
        if not ready:
            return
        for key, _ in self._selector.select(0):
            if key.data == "workers":
                self._take_results()
            elif key.data == "orders":
                self._take_orders()
            elif key.data == "places":
                self._path_guard.changed(self._clock.now_ns())
            elif isinstance(key.data, int):
                self._wake[key.data] = self._clock.now_ns()

    def _take_results(self) -> None:
        if self._workers is not None:
            self._tell_of(self._workers.poll())

    def _tell_of(self, fresh: set[str]) -> None:
        """Pass on what workers have reported; step the sensors that have something new."""
        assert self._workers is not None
        now_ns = self._clock.now_ns()
        workers = self._workers
        if workers.failures or workers.incidents or workers.warnings or workers.notes:
            report_workers(workers, self.incidents, self.failures, now_ns)
            self._tell_warnings()
        for index, instrument in enumerate(self._instruments if fresh else ()):
            if instrument.sensor in fresh:
                self._wake[index] = now_ns

    def _tell_warnings(self) -> None:
        while self._workers is not None and self._workers.warnings:
            self.on_failure(f"warning: {self._workers.warnings.pop(0)}")
        while self._workers is not None and self._workers.notes:
            self.on_failure(self._workers.notes.pop(0))

    def _look_around(self, now_ns: int) -> None:
        """Some ten times per second: do our processes, our sensors and we ourselves live?"""
        wait_ns = TICK_NS
        if self._workers is not None:
            self._tell_of(self._workers.check())
            wait_ns = self._workers.check_ns
        self.liveness.look(now_ns, self._ran.pass_to(now_ns), {self._instruments[index].sensor for index in self._lost})
        if self.feeding is not None and (why := self.feeding.look(now_ns)):
            self.incidents.note("feed silent", now_ns, "feed", why)
            self.stop(why)
        if self.announcer is not None and (why := self.announcer.look()):
            self.incidents.note("helper ended", now_ns, "mdns", why)
        self.notifier.alive(now_ns, status_text(self._instruments, self.liveness))
        self._look_ns = now_ns + min(wait_ns, self.notifier.wake_ns or wait_ns)

    def worker_rows(self) -> list[dict[str, object]]:
        """The measuring processes, for whoever asks."""
        return [] if self._workers is None else self._workers.rows()

    def close(self) -> None:
        """Close every link and end the workers."""
        self.notifier.stopping()
        if self.feeding is not None:
            self.feeding.close()
        if self.announcer is not None:
            self.announcer.close()
        self._path_guard.close()
        for instrument in self._instruments:
            instrument.close()
        if self._workers is not None:
            self._workers.close()
        self._selector.close()
        self._bell.close()
        self._ring.close()
        self.notifier.close()


def turns_of(instruments: Sequence[Instrument]) -> list[Turn]:
    """Of all sensors and of the links that have their own; sensors on one bus have one together."""
    found = [one.input_budget.turn for one in instruments]
    found += [link.turn for one in instruments for link in one.links if link.turn is not None]
    return list({id(turn): turn for turn in found}.values())


@dataclass(frozen=True)
class Lateness:
    """How late payloads left, against the schedule."""

    count: int
    median_us: float
    p99_us: float
    worst_us: float

    @classmethod
    def of(cls, lateness_ns: Sequence[int]) -> Lateness:
        """Of a list of nanoseconds; NaN when it is empty."""
        if not lateness_ns:
            return cls(0, float("nan"), float("nan"), float("nan"))
        median, p99, worst = np.percentile(np.asarray(lateness_ns) * 1e-3, [50, 99, 100])
        return cls(len(lateness_ns), float(median), float(p99), float(worst))


def status_text(instruments: Sequence[Instrument], liveness: Liveness) -> str:
    """One line for `systemctl status`."""
    silent = liveness.silent
    return f"{len(instruments)} sensors" + (f"; silent: {', '.join(silent)}" if silent else "")
