"""One sensor on its links: one session, the links its hosts use, and its measuring process.

Nothing here knows a protocol, a mesh or a clock: `step(now_ns)` moves bytes and scans, and says when to call again.
What it counts is in `stats`, what observers see in `observers`.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Protocol

from emulator.faults.events import FaultEvent
from emulator.instrument.ahead import Ahead, Several
from emulator.instrument.input_budget import InputBudget
from emulator.instrument.observer import Observer
from emulator.instrument.observers import Observers
from emulator.instrument.outlet import Outlet
from emulator.instrument.slices import InSlices, Slices, SlicesFeed
from emulator.instrument.stats import InstrumentStats
from emulator.measuring.conditions import NORMAL, Conditions
from emulator.measuring.measuring import NotMeasured
from emulator.transports.link import Link, Received
from protocols.errors import ScanRefused
from protocols.framing import Frames, Framing
from protocols.scan import Scan, ScanPlan
from protocols.session import Address, Emission, Event, LinkKind, Restarted, Session
from protocols.timebase import inside

if TYPE_CHECKING:
    from emulator.instrument.fault_hooks import FaultHooks
    from protocols.session import Family

LOOK_AHEAD_NS = 250_000_000
"A sweep is measured at most this long before it begins, so that a changed setting wastes little."

EVENTS_KEPT = 1024
"Events that wait for `take_events`, the oldest forgotten: they are counted in any case, and a run lasts for weeks."

SWITCHED_OFF = "switched off"
"Why scans and input are dropped that a device without power forgets, or does not hear."

FOREVER_NS = 2**62
"The session waits for a host alone."

MAX_ROUNDS = 64
"A step that does not come to rest ends after this many rounds and is called again: one sensor cannot starve others."


class Measuring(Protocol):
    """Whoever turns plans into scans: in place, or in worker processes."""

    def request(self, sensor: str, plan: ScanPlan, conditions: Conditions = NORMAL) -> None: ...

    def collect(self, sensor: str) -> list[Scan]:
        """Scans of this sensor that have been finished since the last call."""


class WorldFeed(SlicesFeed, Protocol):
    """Whoever knows where actors are that somebody else moves."""

    def ask_ns(self, sensor: str, plan: ScanPlan, earliest_ns: int) -> int:
        """When that sweep is to be measured: as late as its device allows, unless all is known before."""

    def knows(self, plan: ScanPlan) -> bool:
        """Whether nothing newer will be known of what its beams need."""

    def came(self, sensor: str, plan: ScanPlan, now_ns: int) -> None:
        """Its scan has come."""


class Instrument:
    """One sensor: asks its session what is wanted, has it measured, and sends what is due."""

    def __init__(
        self,
        sensor: str,
        session: Session,
        links: Sequence[Link],
        measuring: Measuring,
        look_ahead_ns: int = LOOK_AHEAD_NS,
    ) -> None:
        self.sensor = sensor
        self.session = session
        self.links = tuple(links)
        self._links_tell = all(link.reports_input for link in self.links)
        self.input_budget = InputBudget(self.links)
        self.stats = InstrumentStats()
        self.conditions = NORMAL
        "Go with every sweep asked for from now on; what was asked for before, at most the look-ahead, keeps its own."
        self.asked_ns = -1
        "First firing of the newest sweep that has been asked for: it and those before it keep their conditions."
        self.wanted_ns = -1
        "When a sweep was asked for last, and when the device took one: for the check whether it has fallen silent."
        self.lived_ns = -1
        self._measuring = measuring
        self._look_ahead_ns = look_ahead_ns
        self._asked: tuple[int, int] | None = None
        self._ahead = Ahead(sensor, measuring) if isinstance(measuring, Several) else None
        "Sweeps begun while earlier ones are under way; None: one at a time."
        self._slices = Slices(sensor, measuring) if isinstance(measuring, InSlices) else None
        "A sweep that is measured in slices; None: nobody does."
        self._further_ns: int | None = None
        "When the next of them may be begun."
        self.connections_seen = 0
        "Connections opened and closed so far: a descriptor's number may have a new owner when this has moved."
        self._events: deque[Event] = deque(maxlen=EVENTS_KEPT)
        if session.minds_delivery:
            for index, link in enumerate(self.links):
                link.tell_undelivered(partial(self._undelivered, Address(index, 0)))
        self.observers = Observers(sensor, self.links)
        self._outlet = Outlet(self.links, self.stats, self.observers)
        self.family: Family | None = None
        "Whose protocol it speaks; for faults that change telegrams."
        self.faults: FaultHooks | None = None
        "Injected faults; None: nothing, at no cost."
        self.feed: WorldFeed | None = None
        "Who moves the world; None: its file alone, and sweeps are measured ahead."
        self.poked = False
        "It wants to be stepped now, whatever it said: something outside has changed."
        self.driven = False
        "Its session is also changed from outside, by a replay: it is asked at every step."
        self._due_ns = 0
        "Until then the session has nothing to do without input: a step before lets only bytes leave. 0: not known."
        self._wants_plan = False
        "The session wants a sweep measured."
        self.impairments: dict[str, dict[int, float]] = {}
        "Impairments of the device, and how much by the number of each fault."
        self._switched_ns = 0
        "When it was switched on last."
        self._cuts = 0
        "Power cuts that have not ended."
        self._lives = 0
        "Power cuts so far: what was taken from the session before one does not leave any more."
        self._peers: set[Address] = set()
        "Hosts of streams that the session knows."
        self._under_way: list[tuple[int, int, int]] = []
        "Sweeps asked for that have not come back: epoch, number, beginning."
        self._discarded: list[tuple[int, int, int]] = []
        "Those of a life of the device that has ended."
        self.ledger = self.stats.ledger
        "The account of its scans."
        self.owed = self.stats.owed
        "When hosts are owed scans."

    def watch(self, watcher: Observer) -> None:
        """Tell `watcher` of every payload, scan and event from now on.

        Instants on a line are exact when it is called before the device is switched on, else from the line's first
        pause on.
        """
        self.observers.add(watcher)

    def unwatch(self, watcher: Observer) -> None:
        """Tell it no more; also from within what it is reported."""
        self.observers.remove(watcher)

    def power_on(self, now_ns: int) -> None:
        """Tell the session of its fixed links and switch the device on."""
        for index, link in enumerate(self.links):
            if link.kind is not LinkKind.STREAM:
                if (place := link.place) is not None:
                    self.session.placed(Address(index, 0), *place)
                self.session.connected(now_ns, Address(index, 0), link.kind)
        self._switched_ns = now_ns
        self.session.power_on(now_ns)
        self._due_ns = 0

    def step(self, now_ns: int) -> int | None:
        """Do all that can be done by `now_ns`; the instant of the next step, None while only a host can wake it."""
        asked = bool(self._under_way) or self._asked is not None or self.poked or self.driven or self.feed is not None
        idle = now_ns < self._due_ns and not asked and self._faults_wait(now_ns)
        self.poked = False
        self.ledger.now_ns = now_ns
        if self.faults is not None and not idle:
            self.faults.advance(now_ns)
        wake_ns = self._next_step(now_ns) if idle and self._links_tell else now_ns
        heard = wake_ns is not None and wake_ns <= now_ns and self._take_input(now_ns)
        if self._cuts:
            return self._rest_without_power(now_ns)
        reported = self.session.take_events()
        if idle and not heard and not reported:
            if self._wants_plan:
                self.owed.wait(now_ns)
            return wake_ns if self._links_tell else self._next_step(now_ns)
        return self._step_session(now_ns, reported)

    def _step_session(self, now_ns: int, reported: list[Event]) -> int | None:
        """The same where the session has something to do; `told`: events that have not been noted."""
        self._due_ns = 0
        self.session.advance(now_ns)
        events = reported + self.session.take_events()
        if any(isinstance(event, Restarted) for event in events):
            self.ledger.restart()  # before sweeps of the device's new life are asked for
        for _ in range(MAX_ROUNDS):
            moved = self._take_scans(now_ns)
            moved = self._ask_for_scan(now_ns) or moved
            moved = self._send_due(now_ns) or moved
            if not moved:
                break
        else:
            self.input_budget.settle(now_ns)
            return now_ns
        if self.faults is not None:
            self._release(now_ns)
        self._note_events(events)
        if any(isinstance(event, Restarted) and event.at_ns > self._switched_ns for event in events):
            for link in self.links:
                link.flush(now_ns)  # the reply leaves first
            self._hang_up(now_ns)
        deadline_ns = self.session.next_deadline()
        self._due_ns = FOREVER_NS if deadline_ns is None else deadline_ns
        plan = self.session.next_plan()
        self._wants_plan = plan is not None
        self.ledger.wants(plan)
        if events:
            self.owed.reported(now_ns, events)
        if plan is not None:
            self.owed.wait(now_ns)
        if plan is not None and self._key(plan) != self._asked:
            self._due_ns = min(self._due_ns, self._ask_ns(plan))
        elif plan is not None and self._further_ns is not None:
            self._due_ns = min(self._due_ns, self._further_ns)
        if self._slices is not None and (slice_ns := self._slices.begin_due(now_ns)) is not None:
            self._due_ns = min(self._due_ns, slice_ns)
        return self._next_step(now_ns)

    def _rest_without_power(self, now_ns: int) -> int | None:
        """A device that is switched off hears, measures and says nothing."""
        self._due_ns = FOREVER_NS
        self._take_scans(now_ns)
        self._note_events()
        wake_ns = self._next_step(now_ns)
        self._due_ns = 0
        return wake_ns

    def _next_step(self, now_ns: int) -> int | None:
        """Let bytes leave; when the links, the session or a fault want to go on."""
        wakes = [link.flush(now_ns) for link in self.links]
        if self.input_budget.limited:
            self.input_budget.settle(now_ns)
            if self.input_budget.rests(now_ns):  # a link whose input waits for us wants to be asked now; it has to wait
                wakes = [wake for wake in wakes if wake is not None and wake > now_ns]
            wakes.append(self.input_budget.wake_ns(now_ns))
        if self.faults is not None:
            wakes.append(self.faults.next_ns())
        due_ns = self._due_ns
        for wake in wakes:
            if wake is not None and wake < due_ns:
                due_ns = wake
        return None if due_ns == FOREVER_NS else due_ns

    def _faults_wait(self, now_ns: int) -> bool:
        """Whether no fault has something to do by now."""
        if self.faults is None:
            return True
        due_ns = self.faults.next_ns()
        return due_ns is None or due_ns > now_ns

    @property
    def powered(self) -> bool:
        """Whether the device is switched on."""
        return not self._cuts

    def _hang_up(self, now_ns: int) -> None:
        """The device has restarted by itself: its reply has left, its connections are no more, if it has a network."""
        if inside(self.session, 0)[0].restart_hangs_up and sum([link.reset_hosts() for link in self.links]) > 0:
            self.connections_seen += 1
            self.poked = True

    def power_off(self, now_ns: int) -> int:
        """Cut the power: what has not left is gone, in the middle of a byte if need be; how many bytes those were."""
        self._cuts += 1
        if self._cuts > 1:
            return 0
        self._lives += 1
        self._asked = None
        self._due_ns = 0
        self.owed.stop(now_ns)
        self._discarded += self._under_way
        self._under_way.clear()
        if self._ahead is not None:
            self._ahead.drop()
        if self._slices is not None:
            self._slices.finish(now_ns)
        self._note_events()  # what it has reported already
        self.ledger.now_ns = now_ns
        self.ledger.cut(SWITCHED_OFF)
        lost = sum(link.clear() for link in self.links)
        if unheard := self.input_budget.forget():
            self.stats.input_dropped[SWITCHED_OFF] += unheard
        self.observers.clear(now_ns)
        return lost + (0 if self.faults is None else self.faults.cut())

    def power_back(self, now_ns: int) -> None:
        """Switch the device on again: connections that it had are not its own any more."""
        self._cuts -= 1
        if self._cuts:
            return  # another one holds
        for address in sorted(self._peers):
            self.session.disconnected(now_ns, address)
        self._peers.clear()
        self.stats.last_scan_due_ns = None
        self._switched_ns = now_ns
        self.session.power_on(now_ns)
        self._due_ns = 0

    def set_line_speed(self, index: int, now_ns: int, baud: int | None) -> None:
        """Another speed of a line at once, whatever the device says."""
        self.links[index].set_speed(baud)
        self.observers.set_speed(index, now_ns, baud)

    def framing(self, kind: LinkKind) -> Framing | None:
        """How its telegrams are framed on such a link; None where its family does not tell."""
        frames = self.family if self.family is not None else self.session
        return frames.framing(self.session, kind) if isinstance(frames, Frames) else None

    def tell_fault(self, event: FaultEvent) -> None:
        """Something a fault did, for observers."""
        self.observers.event(event)

    @property
    def measuring(self) -> Measuring:
        """Who makes scans of its plans."""
        return self._measuring

    def torn_off(self, now_ns: int) -> None:
        """A fault has taken its hosts away: none of them has ended its stream."""
        self.owed.tear(now_ns)

    def take_events(self) -> list[Event]:
        """Events of the session since the last call, already counted in `stats`."""
        events = list(self._events)
        self._events.clear()
        return events

    def close(self) -> None:
        """Close every link."""
        for link in self.links:
            link.close()

    def _take_input(self, now_ns: int) -> bool:
        """Hear what hosts have sent; whether there was anything."""
        heard = False
        for index, received in self.input_budget.take(now_ns):
            heard = True
            if received.opened or received.closed:
                self.connections_seen += 1
            if self.faults is None:
                self._take(received, index, now_ns)
                continue
            for part in self.faults.incoming(received, index, now_ns):
                self._take_or_miss(part, index, now_ns)
        return heard

    def _take(self, received: Received, index: int, now_ns: int) -> None:
        link = self.links[index]
        address = Address(index, received.peer)
        if received.opened or received.data:
            self.owed.heard(now_ns)
        if received.opened:
            self._peers.add(address)
            if received.host is not None:
                self.session.placed(address, *received.host)
            self.session.connected(now_ns, address, link.kind)
        if received.lines is not None:
            self.session.modem_lines(*received.lines, now_ns, address)
        if received.data:
            self.observers.heard(index, received, now_ns)
            self.session.receive(received.data, now_ns, address)
        if received.data and received.foreign is not None:
            self.session.other_speed(*received.foreign, now_ns, address)
        if received.closed:
            self._peers.discard(address)
            self.session.disconnected(now_ns, address)

    def _take_or_miss(self, received: Received, index: int, now_ns: int) -> None:
        """The same where faults are: a device without power hears nothing."""
        if not self.powered:
            if received.data:
                self.stats.input_dropped[SWITCHED_OFF] += len(received.data)
            return
        self._take(received, index, now_ns)

    def _take_scans(self, now_ns: int) -> bool:
        moved = False
        for scan in self._measuring.collect(self.sensor):
            self.stats.scans_measured += not isinstance(scan, NotMeasured)
            if self.feed is not None and not isinstance(scan, NotMeasured):
                self.feed.came(self.sensor, scan.plan, now_ns)
            if self._slices is not None:
                self._slices.came(scan.plan)
            moved = True
            if self._is_of_before(scan.plan):
                continue  # on account since the cut
            if self._key(scan.plan) == self._asked:
                self._asked = None
            try:
                if isinstance(scan, NotMeasured):
                    self.session.missed(scan.plan, now_ns)
                    self.ledger.missed(scan.plan)
                    continue
                self.session.submit(scan)
            except ScanRefused:
                self.ledger.refuse(scan.plan)
            else:
                self.lived_ns = now_ns
                self.ledger.take(scan.plan)
                self.observers.scan(scan)
                self.stats.note_taken(scan)
        return moved

    def _is_of_before(self, plan: ScanPlan) -> bool:
        """Whether a scan that has come was asked for by a life of the device that has ended."""
        name = (*self._key(plan), plan.start_ns)
        mine = self._discarded if name in self._discarded else self._under_way
        if name in mine:
            mine.remove(name)
        return mine is self._discarded

    def _ask_for_scan(self, now_ns: int) -> bool:
        plan = self.session.next_plan()
        if plan is None or self._key(plan) == self._asked:
            self._further_ns = None if plan is None else self._begin_early(plan, now_ns)
            return False
        if self._ask_ns(plan) > now_ns:
            return False
        self._asked = self._key(plan)
        self.wanted_ns = now_ns
        first_ns = plan.start_ns + (math.ceil(1e9 * plan.fire_offset_s[0]) if len(plan) else 0)
        self.asked_ns = max(self.asked_ns, first_ns)
        if self.faults is not None:
            self.faults.asked(plan)
        self._under_way.append((*self._asked, plan.start_ns))
        self.ledger.ask(plan)
        self.owed.ask(now_ns, plan)
        if self._ahead is None or not self._ahead.claim(plan, self.conditions):
            if (
                self.feed is None
                or self._slices is None
                or not self._slices.open(plan, self.conditions, self.feed, now_ns)
            ):
                self._measuring.request(self.sensor, plan, self._conditions_of(plan, now_ns))
        return True

    def _conditions_of(self, plan: ScanPlan, now_ns: int) -> Conditions:
        if self.feed is None:
            return self.conditions
        return replace(self.conditions, world=self.feed.world(self.sensor, plan, now_ns))

    def _begin_early(self, asked: ScanPlan, now_ns: int) -> int | None:
        """Begin sweeps behind the one that is under way, where processes are free."""
        if self._ahead is None or (self._slices is not None and self._slices.are_left):
            return None
        held = partial(self._conditions_of, now_ns=now_ns)
        may_wait = self.feed is None
        return self._ahead.begin(self.session, asked, now_ns, self._ask_ns, held, may_wait, self._may_queue)

    def _may_queue(self, plan: ScanPlan) -> bool:
        """Whether all is known that its beams need: nothing newer comes while it waits for a process."""
        return self.feed is None or self.feed.knows(plan)

    def _ask_ns(self, plan: ScanPlan) -> int:
        """When that sweep is asked for."""
        ahead_ns = plan.start_ns - self._look_ahead_ns
        return ahead_ns if self.feed is None else self.feed.ask_ns(self.sensor, plan, ahead_ns)

    def _send_due(self, now_ns: int) -> bool:
        emissions = self.session.take_emissions(now_ns)
        life = self._lives
        for emission in emissions:
            if self.faults is None:
                self._outlet.take(emission)
            else:
                self._send_through_faults(emission, now_ns, life)
        return bool(emissions)

    def _send_through_faults(self, emission: Emission, now_ns: int, life: int) -> None:
        assert self.faults is not None
        passed = self.faults.passed(emission, now_ns) if life == self._lives else None
        if passed is None or life != self._lives:  # one has begun a power cut: neither it nor those behind it leave
            self.faults.cut()
            if emission.sweep is not None:
                self.ledger.send(emission, SWITCHED_OFF)
            return
        self._outlet.leave(passed)

    def _release(self, now_ns: int) -> None:
        """Send what faults have held back."""
        assert self.faults is not None
        life = self._lives
        released = self.faults.released(now_ns)
        if life != self._lives:  # one of them has begun a power cut
            self.faults.cut()
            for one in released:
                if one.emission is not None and one.emission.sweep is not None and not one.counted:
                    self.ledger.send(one.emission, SWITCHED_OFF)
            return
        for one in released:
            self._outlet.leave(one)

    def _undelivered(self, address: Address, refused: bool) -> None:
        self.session.undelivered(self.ledger.now_ns, address, refused)

    def _note_events(self, earlier: Sequence[Event] = ()) -> None:
        for event in (*earlier, *self.session.take_events()):
            self._events.append(event)
            if self.faults is not None:
                self.faults.noted(event)
            self.observers.event(event)
            self.stats.note_event(event)

    @staticmethod
    def _key(plan: ScanPlan) -> tuple[int, int]:
        return plan.epoch, plan.sweep
