"""Real hosts on virtual time: serves their links, and moves time as far as computing and their reading allow.

Time stands while no host is there, unless asked not to wait for one, and while one holds more than `MOST_HELD` bytes
unread; it moves while at least one has read everything, from one thing due to the next. With nothing due at all it goes
on with the real clock, so that a run ends; but not at once, so that an answer comes at the same instant in every run.
With a speed it is held back to that many virtual seconds a real one, and hosts need not read.
"""

from __future__ import annotations

import contextlib
import os
import signal
import threading
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future
from dataclasses import dataclass
from types import FrameType

from emulator.errors import EmulatorError, LinkError
from emulator.injection.run import FaultRun
from emulator.instrument.instrument import Instrument
from emulator.measuring.supervision import Workers
from emulator.process.clock import SystemClock
from emulator.process.incidents import Incidents
from emulator.process.sd_notify import Notifier
from emulator.process.time_limits import TICK_NS
from emulator.process.waiting import Poller
from emulator.runtime.daemon import COMMAND_ENDED, DURATION_OVER, status_text
from emulator.runtime.feeding import Feeding
from emulator.runtime.liveness import Liveness, report_workers
from emulator.runtime.own_daemon import ending_signals
from emulator.runtime.path_guard import PathGuard
from emulator.runtime.virtual import VirtualRun
from emulator.transports.link import Link

MOST_HELD = 49_152
"Bytes that one host may leave unread before time stands still for it."
LOOK_S = 0.0005
"How often it is seen whether a host has read."
IDLE_S = 0.05
ALONE_NS = 2_000_000_000
ANSWER_NS = 100_000_000
"""Real time for which virtual time stands when nothing is due, or a host has just come: what a host says by then it
says at this very instant, in every run."""
LEFT_NS = 2_000_000_000
"Real time for which the end of a run waits on a host that reads none of what was sent to it."
SLICE_NS = 20_000_000
"Virtual time given to others before hosts are looked at again, while time is held back or pushed on."


@dataclass
class _Order:
    """Something that another thread wants done between two steps."""

    action: Callable[[], object]
    done: Future[object]


class VirtualDaemon:
    """Runs instruments on a virtual clock until asked to stop; other threads speak to it through `call`."""

    def __init__(
        self,
        instruments: Sequence[Instrument],
        workers: Workers | None = None,
        speed: float | None = None,
        on_failure: Callable[[str], None] = lambda text: None,
        warnings: list[str] | None = None,
    ) -> None:
        """`speed`: virtual seconds a real one; None: as fast as possible. `workers`: None when measuring in place.

        `warnings`: where whoever measures leaves them; each is taken out and reported.
        """
        self._warnings = [] if warnings is None else warnings
        self._workers = workers
        self.run_of = VirtualRun(instruments, settle=self._settle, on_lost=self._lose)
        self.instruments = tuple(instruments)
        self.links: tuple[Link, ...] = tuple(link for one in instruments for link in one.links)
        self._served = self.links
        "Those of sensors that have lost none."
        for link in self.links:
            link.hold = speed is None
        self._speed = speed
        self._real = SystemClock()
        self._anchor = (0, 0)
        "Real and virtual instant from which speed counts."
        self._orders: list[_Order] = []
        self._lock = threading.Lock()
        self._bell, self._ring = os.pipe2(os.O_NONBLOCK | os.O_CLOEXEC)
        self._poller = Poller([self._bell])
        self._stop = False
        self.why = ""
        "Why the run has ended, in words; empty: it has not."
        self.paused = False
        self.pause_at_ns: int | None = None
        "Virtual instant at which time will stand; None: it goes on."
        self.idles = True
        "With nothing due, time goes on with the real clock; otherwise it stands."
        self.waits_for_hosts = True
        "Time stands while no host is there; otherwise it moves as fast as can be computed."
        self._present: frozenset[int] = frozenset()
        "Links with a host at the last look."
        self.answer_ns = ANSWER_NS
        "Real time that a host has for an answer when nothing is due."
        self._came_ns, self._heard = -self.answer_ns, 0
        "When a host came last, in real time, and what all had said by then."
        self._gone_on: int | None = None
        "What all had said when time went on without an answer; None: it has not, or one has come since."
        self.late_answers = 0
        """Times that a host came or spoke after virtual time had gone on without it: as that instant depends on its
        pace, another run may send other bytes."""
        self._alone_since_ns: int | None = None
        self._reported_alone = False
        self.reports_alone = False
        "Say once that time stands because no host is there."
        self.failures: Counter[str] = Counter()
        "Scans that could not be measured, by cause."
        self.on_failure = on_failure
        self.lost_links: list[str] = []
        self.faults: FaultRun | None = None
        "Injected faults in this run."
        self.feeding: Feeding | None = None
        "Who moves the world from outside."
        self.incidents = Incidents()
        "Incidents of the run's processes, files and links."
        self.notifier = Notifier()
        "Who started us, if it wants to know."
        self._look_ns = 0
        "When it is reported next that we live, in real time."
        self.liveness = Liveness(self.instruments, self.incidents)
        self.run_of.on_look = lambda now_ns: self.liveness.look(now_ns, now_ns, self.run_of.lost)
        self._path_guard = PathGuard(instruments, self.incidents)

    @property
    def now_ns(self) -> int:
        """Virtual time."""
        return self.run_of.clock.now_ns()

    def power_on(self) -> None:
        """Switch every device on; speed counts from here."""
        self._tell_warnings()
        self.run_of.power_on()
        self.rebase(self._speed)

    def _tell_warnings(self) -> None:
        while self._warnings:
            self.on_failure(f"warning: {self._warnings.pop(0)}")

    def _settle(self) -> set[str]:
        self._tell_warnings()
        if self._workers is None:
            return set()
        try:
            fresh = self._workers.settle(self._go_on)
        except EmulatorError as error:  # time would stand for ever
            self.on_failure(str(error))
            self.stop(str(error))
            fresh = set()
        report_workers(self._workers, self.incidents, self.failures, self.now_ns)
        return fresh

    def _go_on(self) -> bool:
        """Asked while time stands for what workers owe."""
        self._look_around()
        return not self._stop

    def _look_around(self) -> None:
        """Tell who started us that we live."""
        now_ns = self._real.now_ns()
        if now_ns >= self._look_ns:
            self._look_ns = now_ns + min(TICK_NS, self.notifier.wake_ns or TICK_NS)
            self.notifier.alive(now_ns, status_text(self.instruments, self.liveness))

    def worker_rows(self) -> list[dict[str, object]]:
        """The measuring processes, for whoever asks."""
        return [] if self._workers is None else self._workers.rows()

    def _lose(self, sensor: str, error: LinkError) -> None:
        """The others go on; without any, time would stand for ever."""
        self.lost_links.append(str(error))
        self.on_failure(str(error))
        self._served = tuple(
            link for one in self.instruments if one.sensor not in self.run_of.lost for link in one.links
        )
        if not self._served:
            self.stop("every sensor has lost a link")

    @contextlib.contextmanager
    def signals(self) -> Iterator[None]:
        """SIGINT, SIGTERM and a closed terminal stop the run while this lasts."""

        def handler(number: int, _frame: FrameType | None) -> None:
            self.stop(f"signal {signal.Signals(number).name}")

        old = {number: signal.signal(number, handler) for number in ending_signals()}
        try:
            yield
        finally:
            for number, action in old.items():
                signal.signal(number, action)

    @property
    def speed(self) -> float | None:
        """Virtual seconds a real one; None: as fast as hosts read."""
        return self._speed

    def rebase(self, speed: float | None) -> None:
        """Another speed from now on."""
        self._speed = speed
        for link in self.links:
            link.hold = speed is None
        self._anchor = (self._real.now_ns(), self.now_ns)

    def late_ns(self, virtual_ns: int) -> int:
        """Real time since a virtual instant was due at the present speed; 0 without one."""
        if not self._speed:
            return 0
        return round(self._real.now_ns() - self._anchor[0] - (virtual_ns - self._anchor[1]) / self._speed)

    def stop(self, why: str = "stopped") -> None:
        """End the run after the present step, for that reason; safe in a signal handler and from other threads."""
        self.why = self.why or why
        self._stop = True
        self._wake()

    def _wake(self) -> None:
        try:
            os.write(self._ring, b".")
        except (BlockingIOError, OSError):
            pass  # it has been rung already, or all is over

    def call(self, action: Callable[[], object]) -> Future[object]:
        """Have something done between two steps, in this run's own thread."""
        order = _Order(action, Future())
        with self._lock:
            self._orders.append(order)
        self._wake()
        return order.done

    def advance(self, until_ns: int) -> None:
        """Move to an instant whatever hosts have read; what they have not is kept for them."""
        while self.now_ns < until_ns and not self._stop:
            self.run_of.advance(min(until_ns, self.now_ns + SLICE_NS))

    def run(self, until_ns: int | None = None, while_true: Callable[[], bool] | None = None) -> None:
        """Serve until `stop`, until that virtual instant, or until `while_true` says no.

        As fast as hosts read, the end waits for what they have not read yet. A sensor that has lost a link is
        reported and
        served no more, the others go on; with the last of them the run ends.
        """
        self.notifier.ready()
        self._serve(until_ns, while_true)
        if self._speed is None:
            self.drain()
        self._refuse_orders()

    def _serve(self, until_ns: int | None, while_true: Callable[[], bool] | None) -> None:
        while not self._stop:
            self._look_around()
            if until_ns is not None and self.now_ns >= until_ns:
                self.why = self.why or DURATION_OVER
                return
            if while_true is not None and not while_true():
                self.why = self.why or COMMAND_ENDED
                return
            self._path_guard.look(self._real.now_ns(), self.now_ns)
            self._wait(self._once(until_ns))

    def drain(self) -> None:
        """Let hosts read what was sent to them while time stands; closing a link takes the rest away."""
        least, since_ns = None, self._real.now_ns()
        while not self._stop:
            self._look_around()
            for link in self._served:
                link.flush(self.now_ns)
            held = sum(link.held() for link in self._served if link.has_host())
            if least is None or held < least:
                least, since_ns = held, self._real.now_ns()
            if not held or self._real.now_ns() - since_ns > LEFT_NS:
                return
            self._wait(LOOK_S)

    def _once(self, until_ns: int | None) -> float:
        """Everything that can be done now; how long to wait for hosts before the next look."""
        for order in self._take_orders():
            try:
                order.done.set_result(order.action())
            except Exception as error:
                order.done.set_exception(error)
        self.run_of.touch()
        self._here()
        if self._gone_on is not None and self._bytes_in() != self._gone_on:
            self._answered_late()
        if self.pause_at_ns is not None and self.now_ns >= self.pause_at_ns:
            self.paused, self.pause_at_ns = True, None
        elif self.pause_at_ns is not None:
            until_ns = self.pause_at_ns if until_ns is None else min(until_ns, self.pause_at_ns)
        if self.paused:
            return IDLE_S
        if self._speed is not None:
            return self._paced(until_ns)
        return self._pulled(until_ns)

    def _here(self) -> None:
        """What can be done without time moving: input, replies, and what hosts now have room for."""
        while (wake := self.run_of.next_wake()) is not None and wake <= self.now_ns:
            if not self.run_of.step(self.now_ns):
                break

    def _paced(self, until_ns: int | None) -> float:
        assert self._speed is not None
        real_ns, virtual_ns = self._anchor
        target_ns = virtual_ns + int((self._real.now_ns() - real_ns) * self._speed)
        if until_ns is not None:
            target_ns = min(target_ns, until_ns)
        if target_ns > self.now_ns:
            self._go_on_without()
            self.run_of.advance(min(target_ns, self.now_ns + SLICE_NS))
        behind_ns = target_ns - self.now_ns
        wake = self.run_of.next_wake()
        if behind_ns > 0:
            return 0.0
        waits = [one for one in (wake, until_ns) if one is not None]
        return min(IDLE_S, (min(waits) - self.now_ns) * 1e-9 / self._speed) if waits else IDLE_S

    def _pulled(self, until_ns: int | None) -> float:
        present = [link for link in self._served if link.has_host()]
        if not present and self.waits_for_hosts:
            self._tell_alone()
            self.rebase(None)
            return IDLE_S
        self._alone_since_ns = None
        if not present:
            self._go_on_without()
        if self._just_came(present):
            self.rebase(None)
            return LOOK_S
        held = [link.held() for link in present]
        if present and (min(held) > 0 or max(held) > MOST_HELD):
            self.rebase(None)
            return LOOK_S
        wake = self.run_of.next_wake()
        if wake is None or (until_ns is not None and wake > until_ns):
            if not (present or self.waits_for_hosts or until_ns is None):
                self.run_of.advance(until_ns)  # nothing is due to the end, and nobody there who could ask for more
                return 0.0
            return self._idle(until_ns) if self.idles else IDLE_S
        self.run_of.step(wake)
        self.rebase(None)
        return 0.0

    @property
    def late_text(self) -> str:
        """What whoever compares digests has to know; empty: nothing."""
        times = "once" if self.late_answers == 1 else f"{self.late_answers} times"
        text = f"virtual time had gone on {times} before a host came or answered: sha256 may differ in another run"
        return text if self.late_answers else ""

    def _just_came(self, present: Sequence[Link]) -> bool:
        """Whether a host has come that may still begin to speak: what it says first, it says at that instant."""
        found = frozenset(id(link) for link in present)
        if found - self._present:
            if self._gone_on is not None:
                self._answered_late()
            self._came_ns, self._heard = self._real.now_ns(), self._bytes_in()
        self._present = found
        if self._bytes_in() != self._heard:
            return False
        if self._real.now_ns() - self._came_ns < self.answer_ns:
            return True
        if found:
            self._go_on_without()
        return False

    def _go_on_without(self) -> None:
        """Time no longer waits for what a host may say."""
        if self._gone_on is None:
            self._gone_on = self._bytes_in()

    def _answered_late(self) -> None:
        self.late_answers += 1
        self._gone_on = None

    def _bytes_in(self) -> int:
        return sum(link.stats.bytes_in for link in self.links)

    def _tell_alone(self) -> None:
        """Once, when time has stood for a while because nobody is there to read: it may not be what was meant."""
        now_ns = self._real.now_ns()
        if self._alone_since_ns is None:
            self._alone_since_ns = now_ns
        if not self._reported_alone and now_ns - self._alone_since_ns > ALONE_NS and self.reports_alone:
            self._reported_alone = True
            self.on_failure("no host is connected: virtual time is stopped; --no-wait lets it advance")

    def _idle(self, until_ns: int | None) -> float:
        """Nothing is due: time goes on with the real clock, to the end at most."""
        real_ns, virtual_ns = self._anchor
        target_ns = virtual_ns + max(0, self._real.now_ns() - real_ns - self.answer_ns)
        target_ns = max(self.now_ns, target_ns if until_ns is None else min(target_ns, until_ns))
        if target_ns > self.now_ns:
            self._go_on_without()
        self.run_of.advance(target_ns)
        return 0.001

    def _wait(self, timeout_s: float) -> None:
        numbers = (self._bell, *(number for link in self._served for number in link.filenos()))
        if numbers != self._poller.numbers:
            self._poller = Poller(numbers)
        self._poller.wait(round(timeout_s * 1e9))
        with contextlib.suppress(BlockingIOError):
            os.read(self._bell, 4096)

    def _take_orders(self) -> list[_Order]:
        with self._lock:
            orders, self._orders = self._orders, []
        return orders

    def _refuse_orders(self) -> None:
        for order in self._take_orders():
            order.done.set_exception(RuntimeError("the run has ended"))

    def close(self) -> None:
        """Close every link and end the workers."""
        self.notifier.stopping()
        if self.feeding is not None:
            self.feeding.close()
        self._path_guard.close()
        for instrument in self.instruments:
            instrument.close()
        if self._workers is not None:
            self._workers.close()
        for number in (self._bell, self._ring):
            os.close(number)
        self.notifier.close()
