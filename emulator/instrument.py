"""One sensor on its links: one session, the links its hosts use, and whoever measures for it.

Nothing here knows a protocol, a mesh or a clock: `step(now_ns)` moves bytes and scans, and says when to call again.
"""

from __future__ import annotations

import math
from collections import Counter, deque
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Protocol

from emulator.object_metrics import ListedScan, ObjectScore
from emulator.transports.can_link import CanLink
from emulator.transports.can_wire import Carried
from emulator.transports.link import Link
from emulator.watching import LineTimes, Payload, Watcher
from protocols.errors import ScanRefused
from protocols.scan import Scan, ScanPlan
from protocols.session import (
    Address,
    CommandHandled,
    Dropped,
    DropReason,
    Emission,
    Event,
    LinkKind,
    ModeChanged,
    Restarted,
    Session,
)

LOOK_AHEAD_NS = 250_000_000
"A sweep is measured at most this long before it begins, so that a changed setting wastes little."

MAX_ROUNDS = 64
"A step that does not come to rest ends after this many rounds and is called again: one sensor cannot starve others."


class Measuring(Protocol):
    """Whoever turns plans into scans: in place, or in worker processes."""

    def request(self, sensor: str, plan: ScanPlan) -> None: ...

    def collect(self, sensor: str) -> list[Scan]:
        """Scans of this sensor that have been finished since the last call."""


@dataclass
class InstrumentStats:
    """What one sensor did, for the report at the end of a run."""

    scans_measured: int = 0
    scans_sent: int = 0
    replies_sent: int = 0
    last_scan_due_ns: int | None = None
    "None before the first scan, and again when the device's mode has changed: pauses between streams are no gaps."
    gaps: int = 0
    "Gaps between scans of one stream, and how long they were in all."
    gaps_ns: int = 0
    scans_dropped: Counter[str] = field(default_factory=Counter)
    input_dropped: Counter[str] = field(default_factory=Counter)
    commands: Counter[str] = field(default_factory=Counter)
    restarts: int = 0
    lateness_ns: list[int] = field(default_factory=list)
    "Actual minus scheduled instant of the first byte of each payload, newest last; bounded by the daemon."
    objects: ObjectScore | None = None
    "How well the lists of a sensor that lists objects fit the truth."

    @property
    def rate_hz(self) -> float:
        """Scans a second while they were streamed; NaN before the second scan of a stream."""
        return self.gaps * 1e9 / self.gaps_ns if self.gaps_ns > 0 else math.nan

    def note_scan(self, due_ns: int) -> None:
        """One more scan was sent."""
        self.scans_sent += 1
        if self.last_scan_due_ns is not None:
            self.gaps += 1
            self.gaps_ns += due_ns - self.last_scan_due_ns
        self.last_scan_due_ns = due_ns


SCAN_REASONS = frozenset(
    reason.value for reason in (DropReason.LINE_BUSY, DropReason.LATE, DropReason.STALE, DropReason.HOST_SLOW)
)
"`DropReason` values that count scans rather than input bytes."


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
        self.stats = InstrumentStats()
        self._measuring = measuring
        self._look_ahead_ns = look_ahead_ns
        self._asked: tuple[int, int] | None = None
        self.connections_seen = 0
        "Connections opened and closed so far: a descriptor's number may have a new owner when this has moved."
        self._events: list[Event] = []
        self._watchers: list[Watcher] = []
        self._times: dict[int, LineTimes] = {}
        self._on_bus: dict[int, deque[tuple[int, bytes, int]]] = {}
        "CAN link -> identifier, bytes and sweep of frames that begin a scan and have not been carried yet."

    def watch(self, watcher: Watcher) -> None:
        """Tell `watcher` of every payload, scan and event from now on; before the device is switched on."""
        self._watchers.append(watcher)
        for index, link in enumerate(self.links):
            if link.kind is LinkKind.SERIAL:
                self._times.setdefault(index, LineTimes())
            elif isinstance(link, CanLink):
                self._on_bus.setdefault(index, deque(maxlen=1024))
                link.on_carried = partial(self._carried, index)

    def power_on(self, now_ns: int) -> None:
        """Tell the session of its fixed links and switch the device on."""
        for index, link in enumerate(self.links):
            if link.kind is not LinkKind.STREAM:
                self.session.connected(now_ns, Address(index, 0), link.kind)
        self.session.power_on(now_ns)

    def step(self, now_ns: int) -> int | None:
        """Do all that can be done by `now_ns`; the instant of the next step, None while only a host can wake it."""
        self._take_input(now_ns)
        self.session.advance(now_ns)
        for _ in range(MAX_ROUNDS):
            moved = self._take_scans(now_ns)
            moved = self._ask_for_scan(now_ns) or moved
            moved = self._send_due(now_ns) or moved
            if not moved:
                break
        else:
            return now_ns
        self._note_events()
        wakes = [link.flush(now_ns) for link in self.links]
        wakes.append(self.session.next_deadline())
        plan = self.session.next_plan()
        if plan is not None and self._key(plan) != self._asked:
            wakes.append(plan.start_ns - self._look_ahead_ns)
        due = [wake for wake in wakes if wake is not None]
        return min(due) if due else None

    def take_events(self) -> list[Event]:
        """Events of the session since the last call, already counted in `stats`."""
        events, self._events = self._events, []
        return events

    def close(self) -> None:
        """Close every link."""
        for link in self.links:
            link.close()

    def _take_input(self, now_ns: int) -> None:
        for index, link in enumerate(self.links):
            for received in link.receive(now_ns):
                address = Address(index, received.peer)
                if received.opened or received.closed:
                    self.connections_seen += 1
                if received.opened:
                    self.session.connected(now_ns, address, link.kind)
                if received.data:
                    if self._watchers and link.kind is not LinkKind.CAN:
                        self._tell(Payload(self.sensor, index, received.peer, received.data, now_ns, now_ns, False))
                    self.session.receive(received.data, now_ns, address)
                if received.closed:
                    self.session.disconnected(now_ns, address)

    def _take_scans(self, now_ns: int) -> bool:
        moved = False
        for scan in self._measuring.collect(self.sensor):
            self.stats.scans_measured += 1
            if self._key(scan.plan) == self._asked:
                self._asked = None
            try:
                self.session.submit(scan)
            except ScanRefused:
                self.stats.scans_dropped["withdrawn by a changed setting"] += 1
            else:
                for watcher in self._watchers:
                    watcher.scan(self.sensor, scan)
                if isinstance(scan, ListedScan):
                    self.stats.objects = self.stats.objects or ObjectScore()
                    self.stats.objects.add(scan.objects, scan.truth)
            moved = True
        return moved

    def _ask_for_scan(self, now_ns: int) -> bool:
        plan = self.session.next_plan()
        if plan is None or self._key(plan) == self._asked or plan.start_ns > now_ns + self._look_ahead_ns:
            return False
        self._asked = self._key(plan)
        self._measuring.request(self.sensor, plan)
        return True

    def _send_due(self, now_ns: int) -> bool:
        emissions = self.session.take_emissions(now_ns)
        for emission in emissions:
            self._send(emission)
        return bool(emissions)

    def _send(self, emission: Emission) -> None:
        address = emission.address
        targets = range(len(self.links)) if address is None else range(len(self.links))[address.link : address.link + 1]
        peer = None if address is None else address.peer
        for index in targets:
            link = self.links[index]
            refused = link.stats.payloads_dropped
            if emission.sweep is not None and index in self._on_bus:
                self._on_bus[index].append((peer or 0, emission.payload, emission.sweep))
            link.send(emission.payload, emission.due_ns, peer, emission.line_speed)
            if self._watchers and link.stats.payloads_dropped == refused and link.kind is not LinkKind.CAN:
                self._tell_sent(index, peer, emission)
        if emission.sweep is None:
            self.stats.replies_sent += bool(emission.payload)  # an empty one only sets the line's speed
            return
        self.stats.note_scan(emission.due_ns)

    def _tell_sent(self, index: int, peer: int | None, emission: Emission) -> None:
        start_ns = end_ns = emission.due_ns
        pace = None
        if index in self._times:
            start_ns, end_ns, pace = self._times[index].of(emission.payload, emission.due_ns, emission.line_speed)
        if emission.payload:
            data, label, sweep = emission.payload, emission.label, emission.sweep
            self._tell(Payload(self.sensor, index, peer or 0, data, start_ns, end_ns, True, label, sweep, pace))

    def _carried(self, index: int, frame: Carried, own: bool) -> None:
        start_ns = frame.start_ns if own else frame.end_ns
        sweep = self._sweep_of(index, frame) if own else None
        self._tell(Payload(self.sensor, index, frame.peer, frame.data, start_ns, frame.end_ns, own, sweep=sweep))

    def _sweep_of(self, index: int, frame: Carried) -> int | None:
        """The scan that a carried frame begins; frames that the bus has lost are forgotten with it."""
        waiting = self._on_bus[index]
        for place, (peer, data, sweep) in enumerate(waiting):
            if (peer, data) == (frame.peer, frame.data):
                for _ in range(place + 1):
                    waiting.popleft()
                return sweep
        return None

    def _tell(self, payload: Payload) -> None:
        for watcher in self._watchers:
            watcher.payload(payload)

    def _note_events(self) -> None:
        for event in self.session.take_events():
            self._events.append(event)
            for watcher in self._watchers:
                watcher.event(self.sensor, event)
            if isinstance(event, Dropped):
                reason = event.reason.value
                kind = self.stats.scans_dropped if reason in SCAN_REASONS else self.stats.input_dropped
                kind[reason] += event.count
            elif isinstance(event, CommandHandled):
                self.stats.commands[f"{event.command}: {event.outcome}"] += 1
            elif isinstance(event, ModeChanged | Restarted):
                self.stats.last_scan_due_ns = None
                self.stats.restarts += isinstance(event, Restarted)

    @staticmethod
    def _key(plan: ScanPlan) -> tuple[int, int]:
        return plan.epoch, plan.sweep
