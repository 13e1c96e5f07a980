"""A run in virtual time: instruments step from deadline to deadline as fast as they can be computed.

Time moves only in `advance` and the steps; what hosts write between two calls is taken at the present instant.
Measuring takes no virtual time, in however many processes it is done: time stands until all scans have come back.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Protocol

from emulator.errors import EmulatorError, LinkError
from emulator.instrument.instrument import Instrument
from emulator.instrument.observer import Observer, Payload
from emulator.process.clock import ManualClock
from protocols.session import LinkKind

MAX_STEPS_AT_ONCE = 10_000
"""Steps without time moving and without a new look at what hosts have written; more means that somebody never comes to
rest. Looks are not counted: a host that leaves its bytes unread, or none at all, holds time for ever."""


LOOK_NS = 500_000_000
"Between two looks whether sensors live."
LIST_GAP_NS = 1_000_000
"Frames of a list follow each other sooner than this; a list is one scan."


class VirtualHost(Protocol):
    """A host that lives in virtual time."""

    def step(self, now_ns: int) -> int | None:
        """Read what has arrived, write what is wanted; when to be called again even if nothing arrives."""


def nothing_owed() -> set[str]:
    """Of measuring in place: every scan is there when it has been asked for."""
    return set()


class VirtualRun:
    """Steps instruments, and hosts of its own, on a clock of its own."""

    def __init__(
        self,
        instruments: Sequence[Instrument],
        hosts: Sequence[VirtualHost] = (),
        settle: Callable[[], set[str]] = nothing_owed,
        on_lost: Callable[[str, LinkError], None] | None = None,
    ) -> None:
        """`settle` waits for the scans that other processes still owe and names their sensors.

        `on_lost` is informed of a sensor that has lost a link: it is not stepped again, the others go on. None:
        that ends
        the run.
        """
        self.clock = ManualClock()
        self.instruments = tuple(instruments)
        self.hosts = tuple(hosts)
        self._settle = settle
        self._on_lost = on_lost
        self.lost: set[str] = set()
        "Sensors that have lost a link."
        self._wakes: list[int | None] = [None] * len(self.instruments)
        self._host_wakes: list[int | None] = [0] * len(self.hosts)
        self._still = 0
        self.on_look: Callable[[int], None] = lambda now_ns: None
        "Called every `LOOK_NS` of virtual time, between two steps, and at the end of an `advance`."
        self._look_ns = LOOK_NS
        self._ends = LastBits()
        for instrument in self.instruments:
            instrument.watch(self._ends)

    def power_on(self) -> None:
        """Switch every device on at the present instant."""
        for index, instrument in enumerate(self.instruments):
            instrument.power_on(self.clock.now_ns())
            self._wakes[index] = self.clock.now_ns()

    def touch(self) -> None:
        """Look at every instrument at the present instant: hosts may have written meanwhile."""
        self._still = 0
        now_ns = self.clock.now_ns()
        self._wakes = [None if one.sensor in self.lost else now_ns for one in self.instruments]

    def next_wake(self) -> int | None:
        """When something happens next, without input; None: never."""
        first_ns: int | None = None
        for wake in (*self._wakes, *self._host_wakes):
            if wake is not None and (first_ns is None or wake < first_ns):
                first_ns = wake
        return None if first_ns is None else max(first_ns, self.clock.now_ns())

    def advance(self, until_ns: int) -> None:
        """Move to `until_ns`, doing on the way all that is due, in order of time, then of the sensors."""
        self.touch()
        while self.step(until_ns):
            pass
        self.clock.set(until_ns)
        self._maybe_look(until_ns)

    def _maybe_look(self, now_ns: int) -> None:
        if now_ns >= self._look_ns:
            self._look_ns = now_ns + LOOK_NS
            self.on_look(now_ns)

    def step(self, until_ns: int) -> bool:
        """Do what is due at the next instant, if that is not after `until_ns`; whether there was something."""
        wake = self.next_wake()
        if wake is None or wake > until_ns:
            return False
        self._still = self._still + 1 if wake == self.clock.now_ns() else 0
        if self._still > MAX_STEPS_AT_ONCE:
            raise EmulatorError(f"{self._restless(wake)}: does not come to rest at {wake} ns of virtual time")
        if wake >= self._look_ns:
            self._maybe_look(wake)
        self.clock.set(wake)
        for index, instrument in enumerate(self.instruments):
            mine = self._wakes[index]
            if mine is not None and mine <= wake:
                self._wakes[index] = self._step_one(instrument, wake)
        fresh = self._settle()
        for index, instrument in enumerate(self.instruments):
            if (instrument.poked or instrument.sensor in fresh) and instrument.sensor not in self.lost:
                self._wakes[index] = wake
        if self.hosts:
            self._step_hosts(wake)
        return True

    def _step_one(self, instrument: Instrument, now_ns: int) -> int | None:
        try:
            return instrument.step(now_ns)
        except LinkError as error:
            if self._on_lost is None:
                raise
            self.lost.add(instrument.sensor)
            self._on_lost(instrument.sensor, error)
            return None

    def _restless(self, now_ns: int) -> str:
        """Who wants to be called at this instant again and again."""
        pairs = zip(self.instruments, self._wakes, strict=True)
        found = [one.sensor for one, wake in pairs if wake is not None and wake <= now_ns]
        hosts = sum(wake is not None and wake <= now_ns for wake in self._host_wakes)
        return ", ".join([*found, *(["a built-in host"] if hosts else [])])

    def _step_hosts(self, now_ns: int) -> None:
        for index, host in enumerate(self.hosts):
            wake = self._host_wakes[index]
            if wake is not None and wake <= now_ns:  # it acts on what it has heard to this instant
                for instrument in self.instruments:
                    for link in instrument.links:
                        link.flush(now_ns)
            self._host_wakes[index] = host.step(now_ns)
        for index, instrument in enumerate(self.instruments):
            for link in instrument.links:
                heard_ns = link.flush(now_ns)  # what hosts wrote wakes the instrument
                own_ns = self._wakes[index]
                if heard_ns is not None and (own_ns is None or heard_ns < own_ns):
                    self._wakes[index] = heard_ns

    def step_scans(self, count: int, until_ns: int, sensor: str | None = None) -> int:
        """Move until `count` more scans have been handed to the links (of `sensor`, or any) and have left to their last
        bit; how many it were."""
        watched = [one for one in self.instruments if sensor in (None, one.sensor)]
        before = sum(one.stats.scans_sent for one in watched)
        self.touch()
        while (sent := sum(one.stats.scans_sent for one in watched) - before) < count and self.step(until_ns):
            pass
        if sent < count:
            self.clock.set(until_ns)
            return sent
        self.advance(max(self.clock.now_ns(), min(until_ns, self._ends.of_scans(watched))))
        handed_ns = self.clock.now_ns()
        buses = [one for one in watched if any(link.kind is LinkKind.CAN for link in one.links)]
        while buses and self.step(min(until_ns, max(handed_ns, self._ends.of_all(buses)) + LIST_GAP_NS)):
            pass
        return sent


class LastBits(Observer):
    """When the newest payload of each sensor leaves to its last bit."""

    def __init__(self) -> None:
        self._scans: dict[str, int] = {}
        self._all: dict[str, int] = {}

    def payload(self, payload: Payload) -> None:
        if payload.sent:
            self._all[payload.sensor] = payload.end_ns
            if payload.sweep is not None:
                self._scans[payload.sensor] = payload.end_ns

    def of_scans(self, instruments: Sequence[Instrument]) -> int:
        """Of scans; on CAN of the frame that begins one."""
        return max((self._scans.get(one.sensor, 0) for one in instruments), default=0)

    def of_all(self, instruments: Sequence[Instrument]) -> int:
        """Of anything that these have sent."""
        return max((self._all.get(one.sensor, 0) for one in instruments), default=0)


class ByteSteps(Observer):
    """When each byte of one link leaves, to step a run by bytes; must watch from before power-on.

    What is not paced, and a CAN frame, leaves in one piece and counts whole.
    """

    def __init__(self, run: VirtualRun, sensor: str, link: int = 0) -> None:
        self._run = run
        self._sensor, self._link = sensor, link
        self._ahead: deque[Payload] = deque()
        "Of which bytes are still to leave; reported when the link got them."
        self._gone = 0
        "Bytes of the first of them that have left."
        self._at_once = 0
        "Bytes that had left when they were reported, since the last look."

    def payload(self, payload: Payload) -> None:
        if not payload.sent or (payload.sensor, payload.link) != (self._sensor, self._link):
            return
        now_ns = self._run.clock.now_ns()
        if payload.end_ns <= now_ns:
            self._at_once += len(payload.data)
            return
        while self._ahead and self._ahead[0].end_ns <= now_ns:  # nobody steps by bytes: nothing is kept
            self._ahead.popleft()
            self._gone = 0
        self._ahead.append(payload)

    def cut(self, sensor: str, link: int, end_ns: int) -> None:
        if (sensor, link) != (self._sensor, self._link):
            return
        while self._ahead and self._ahead[-1].start_ns >= end_ns:
            self._ahead.pop()
        if self._ahead and self._ahead[-1].end_ns > end_ns:
            last = self._ahead[-1]
            kept = sum(last.leaves_ns(place) <= end_ns for place in range(len(last.data)))
            self._ahead[-1] = replace(last, data=last.data[:kept], end_ns=end_ns)

    def step(self, count: int, until_ns: int) -> int:
        """Move until `count` more bytes have left, no further than `until_ns`; how many it were."""
        done = self._at_once = 0
        while done < count:
            self._run.touch()
            leave = self._next_leave()
            wake = self._run.next_wake()
            while wake is not None and (leave is None or wake < leave) and not self._at_once:
                if not self._run.step(until_ns):
                    break
                wake, leave = self._run.next_wake(), self._next_leave()
            if self._at_once:
                done += self._at_once
                self._at_once = 0
                continue
            if leave is None or leave > until_ns:
                self._run.advance(until_ns)
                return done + self._at_once
            head = self._ahead[0]
            self._run.advance(leave)
            self._run.touch()
            self._run.step(leave)
            done += 1 if head.pace is not None else len(head.data)
        return done

    def _next_leave(self) -> int | None:
        """When the first byte leaves that has not yet."""
        now_ns = self._run.clock.now_ns()
        while self._ahead and self._ahead[0].end_ns <= now_ns:
            self._ahead.popleft()
            self._gone = 0
        if not self._ahead:
            return None
        head = self._ahead[0]
        while head.leaves_ns(self._gone) <= now_ns:
            self._gone += 1
        return head.leaves_ns(self._gone)
