"""What all formats share: power, boot, list raster, frames one after the other at the bit rate, host frames by table.

Belongs here: when a frame leaves. Not: what is in it (the formats), and who else is on the bus (the link).
"""

from __future__ import annotations

from abc import abstractmethod
from collections import Counter, deque
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from typing import ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray

from protocols.can_frame import frame_bits, frames_bits
from protocols.can_objects.e2e import Protection
from protocols.can_objects.framing import CanFraming
from protocols.can_objects.layout import Layout, load
from protocols.can_objects.settings import CommonSettings
from protocols.can_objects.table import ObjectTable
from protocols.device_clock import DeviceStamp
from protocols.scan import Scan, ScanPlan
from protocols.session import Address, DropReason, Emission, LinkKind
from protocols.skeleton.instants import SECOND_NS, Timers, earliest
from protocols.skeleton.session import EventSession
from protocols.skeleton.wanted import Wanted

MOST_REPLIES = 512
"Frames of replies that wait for the bus; a host that asks faster than the bus carries gets no more. Ours."


class Frame(NamedTuple):
    """One frame to be sent."""

    identifier: int
    payload: bytes
    label: str
    "Name of the message in the DBC."


@dataclass(frozen=True)
class HostMessage:
    """One message that hosts send: the row that dispatches it and that the coverage table shows."""

    name: str
    "Name in the DBC."
    handler: Callable[..., None]
    "(session, data, now_ns, link)"
    min_bytes: int
    source: str
    shifted: bool = True
    "The identifier moves with the sensor id or base id."
    note: str = ""


@dataclass
class _Bus:
    """Frames that wait, and when the device's own frames leave the bus free."""

    free_ns: int = 0
    replies: deque[tuple[int, int | None, Frame]] = field(default_factory=deque)
    "(not before, link or all, frame): between any two frames."
    cyclic: deque[tuple[int, Frame]] = field(default_factory=deque)
    "(not before, frame): between lists."
    gap_ns: int = 0
    "Pause that the device makes between the frames of the list in progress."
    hold_ns: int = 0
    "Before it, with that pause, no frame of the list leaves."
    current: deque[tuple[Frame, int]] = field(default_factory=deque)
    "Rest of the list that is being sent, with the time each frame takes; check headers are in."
    sweep: int | None = None
    "Sweep of the list whose first frame has not left yet."
    reported: DeviceStamp | None = None
    "Time stamp of that list."


class CanObjectSession(EventSession):
    """A device that sends object lists; the formats derive from it."""

    LAYOUT_FILE: ClassVar[str]
    HOST_MESSAGES: ClassVar[tuple[HostMessage, ...]]

    def __init__(self, common: CommonSettings) -> None:
        super().__init__()
        self._common = common
        self._layout: Layout = load(self.LAYOUT_FILE)
        self._protection = Protection(common.e2e, self._layout) if common.e2e is not None else None
        self._bit_ns = SECOND_NS / common.bitrate
        self.can_bitrate = common.bitrate
        self._links: list[int] = []
        self._foreign: Counter[int] = Counter()
        self._seen_foreign: set[int] = set()
        self._dispatch: dict[int, HostMessage] = {}
        self._ready_ns: int | None = None
        "When the boot ends; None while switched off."
        self._bus = _Bus()
        self._pending: deque[tuple[int, Scan]] = deque()
        self._timers = Timers()
        self._running = False
        self._wanted: Wanted[ScanPlan] = Wanted()
        self._sweep = 0
        self._next_start_ns = 0
        self._list_duration_ns = 0
        self._list_end_ns = 0
        "When the list that began last will have left a bus that carries nothing else."
        self._reported: DeviceStamp | None = None
        "Time stamp of the latest list; set by its format."
        self._addresses: dict[tuple[int, int], Address] = {}

    # What a format fills in

    @abstractmethod
    def _shift(self) -> int:
        """Added to the DBC's identifiers at present."""

    @abstractmethod
    def _reset(self, now_ns: int) -> None:
        """Volatile state as after power-on."""

    @abstractmethod
    def _start(self, now_ns: int) -> None:
        """Boot is over: first frames and timers."""

    @abstractmethod
    def _cycle_ns(self) -> int:
        """Time from list to list."""

    @abstractmethod
    def _lists_wanted(self) -> bool:
        """Whether the device measures at present."""

    @abstractmethod
    def _encode_list(self, table: ObjectTable, now_ns: int, measured_ns: int) -> list[Frame]:
        """The frames of one list, in order, that begins to leave at `now_ns`."""

    def _gap_ns(self) -> int:
        """Pause that the device makes between the frames of a list."""
        return 0

    # Session

    def power_on(self, now_ns: int) -> None:
        self._clear(now_ns)
        self._reset(now_ns)
        self._ready_ns = now_ns + self._common.boot_ns
        self._rebuild_dispatch()
        if self._protection is not None:
            self._protection.reset()
        self._events.restarted(now_ns)

    def connected(self, now_ns: int, address: Address, kind: LinkKind) -> None:
        if kind is LinkKind.CAN and address.link not in self._links:
            self._links.append(address.link)

    def receive(self, data: bytes, now_ns: int, address: Address | None = None) -> None:
        self.advance(now_ns)
        if self._ready_ns is None:
            return
        if address is None or len(data) > 8:
            self._drop(now_ns, DropReason.BAD_LENGTH, f"{len(data)} bytes are no CAN frame with an identifier")
            return
        if not self._running:
            self._drop(now_ns, DropReason.BOOTING, f"frame 0x{address.peer:X}")
            return
        message = self._dispatch.get(address.peer)
        if message is None:
            self._note_foreign(address.peer, now_ns)
        elif len(data) < message.min_bytes:
            self._drop(
                now_ns,
                DropReason.BAD_LENGTH,
                f"{message.name} has {len(data)} bytes; want {message.min_bytes}",
            )
        else:
            message.handler(self, data, now_ns, address.link)

    def advance(self, now_ns: int) -> None:
        self._now_ns = max(self._now_ns, now_ns)
        if self._ready_ns is None or now_ns < self._ready_ns:
            return
        if not self._running:
            self._running = True
            self._timers.add(self._ready_ns + SECOND_NS, SECOND_NS, self._report_foreign)
            self._restart_raster(self._ready_ns)
            self._start(self._ready_ns)
        self._timers.run(now_ns)

    def next_deadline(self) -> int | None:
        if self._ready_ns is None:
            return None
        if not self._running:
            return self._ready_ns
        candidate = self._next_frame()
        return earliest((self._timers.next_ns(), None if candidate is None else candidate[0]))

    def next_plan(self) -> ScanPlan | None:
        if not self._running or not self._lists_wanted():
            return None
        if self._wanted.plan is None:
            self._pass_over()
            nothing, epoch = np.zeros(0), self._wanted.epoch
            plan = ScanPlan(
                epoch=epoch,
                sweep=self._sweep,
                start_ns=self._next_start_ns,
                azimuth_rad=nothing,
                elevation_rad=nothing,
                fire_offset_s=nothing,
                duration_s=self._common.evaluation_ns * 1e-9,
                wants_objects=True,
                stream=epoch,
                period_ns=max(self._cycle_ns(), self._list_duration_ns),
            )
            self._wanted.ask(plan, plan)
        return self._wanted.plan

    def _pass_over(self) -> None:
        """Lists that should have begun to leave already are not measured: who cannot keep up skips, it does not lag."""
        late_ns = self._now_ns - self._next_start_ns - self._common.evaluation_ns
        if late_ns <= 0:
            return
        step_ns = max(self._cycle_ns(), self._list_duration_ns)
        lists = -(-late_ns // step_ns)
        self._next_start_ns += lists * step_ns
        passed = range(self._sweep, self._sweep + lists)
        self._sweep += lists
        self._events.unsent(self._now_ns, DropReason.LATE, passed, "not measured in time", self._wanted.epoch)

    def submit(self, scan: Scan) -> None:
        plan = self._wanted.expect(scan.plan)
        self._pending.append((plan.start_ns + self._common.evaluation_ns, scan))
        # a list that takes longer than the cycle lengthens the cycle: no list begins before the last one has left.
        # Other frames do not: a list that was measured late would take those of the meantime for one of its own.
        self._next_start_ns = max(
            plan.start_ns + max(self._cycle_ns(), self._list_duration_ns),
            self._list_end_ns - self._common.evaluation_ns,
        )
        self._sweep += 1
        self._wanted.forget()

    def missed(self, plan: ScanPlan, now_ns: int) -> bool:
        self.advance(now_ns)
        self._wanted.expect(plan)
        self._wanted.forget()  # the next one passes over what is late by now, and counts it
        return True

    def take_emissions(self, now_ns: int) -> list[Emission]:
        self.advance(now_ns)
        out: list[Emission] = []
        while (candidate := self._next_frame()) is not None and candidate[0] <= now_ns:
            at_ns, kind = candidate
            bus = self._bus
            if kind == 0:
                _, link, frame = bus.replies.popleft()
                self._emit(out, frame, at_ns, [link] if link is not None else None)
            elif kind == 1:
                self._emit(out, bus.cyclic.popleft()[1], at_ns)
            elif bus.current:
                self._continue_list(out, now_ns)
            else:
                self._begin_list(at_ns)
        return out

    def framing(self) -> CanFraming:
        """How its frames are changed on their way."""
        return CanFraming(self._layout, self._protection)

    # For the formats

    def _send_cyclic(self, frames: Iterable[Frame], now_ns: int) -> None:
        """Queue frames that go between lists."""
        self._bus.cyclic.extend((now_ns, frame) for frame in frames)

    def _send_reply(self, frames: Iterable[Frame], now_ns: int, link: int | None = None) -> None:
        """Queue frames that go at once, between any two frames."""
        waiting = [(now_ns, link, frame) for frame in frames]
        if len(self._bus.replies) + len(waiting) > MOST_REPLIES:
            self._drop(now_ns, DropReason.BUSY, f"{MOST_REPLIES} frames of replies wait for the bus")
            return
        self._bus.replies.extend(waiting)

    def _restart_raster(self, now_ns: int) -> None:
        """The next list is measured at `now_ns`; what was measured for the old raster is withdrawn."""
        self._wanted.renew()
        self._next_start_ns = now_ns
        for _, scan in self._pending:
            self._unsent(now_ns, DropReason.STALE, "list raster changed", scan)
        self._pending.clear()

    def _frame(self, name: str, raw: Mapping[str, int] | None = None, **physical: float) -> Frame:
        """One frame of a message, at its present identifier."""
        message = self._layout[name]
        return Frame(message.identifier + self._shift(), message.frame(raw, **physical), name)

    def _drop(self, now_ns: int, reason: DropReason, detail: str, count: int = 1) -> None:
        self._events.drop(now_ns, reason, detail, count)

    def _unsent(self, now_ns: int, reason: DropReason, detail: str, scan: Scan) -> None:
        sweep = scan.plan.sweep
        self._events.unsent(now_ns, reason, range(sweep, sweep + 1), detail, scan.plan.stream)

    def _handled(self, now_ns: int, command: str, outcome: str = "done") -> None:
        self._events.handled(now_ns, command, outcome)

    def _mode(self, now_ns: int, mode: str) -> None:
        self._events.mode(now_ns, mode)

    def _rebuild_dispatch(self) -> None:
        """Host messages by identifier; call after every change of the shift."""
        self._dispatch = {
            self._layout.identifier(message.name) + (self._shift() if message.shifted else 0): message
            for message in self.HOST_MESSAGES
        }

    # Own

    def _clear(self, now_ns: int) -> None:
        self._bus = _Bus(free_ns=now_ns)
        self._pending.clear()
        self._timers.clear()
        self._running = False
        self._wanted.forget()
        self._sweep = 0
        self._next_start_ns = now_ns
        self._list_duration_ns = 0
        self._foreign.clear()
        self._seen_foreign.clear()

    def _next_frame(self) -> tuple[int, int] | None:
        """Instant and kind (0 reply, 1 cyclic, 2 list) of the frame that leaves next."""
        bus = self._bus
        found: list[tuple[int, int]] = []
        if bus.replies:
            found.append((max(bus.free_ns, bus.replies[0][0]), 0))
        if bus.current:
            found.append((max(bus.free_ns, bus.hold_ns), 2))
        else:
            if bus.cyclic:
                found.append((max(bus.free_ns, bus.cyclic[0][0]), 1))
            if self._pending:
                found.append((max(bus.free_ns, self._pending[0][0]), 2))
        return min(found) if found else None

    def _list_bits(self, frames: list[Frame]) -> NDArray[np.int64]:
        """Length of each frame of a list on the bus."""
        return frames_bits([frame.identifier for frame in frames], [frame.payload for frame in frames])

    def _begin_list(self, at_ns: int) -> None:
        due_ns, scan = self._pending.popleft()
        if not self._lists_wanted():
            self._unsent(at_ns, DropReason.STALE, "output switched off", scan)
            return
        if at_ns - due_ns > self._cycle_ns():
            self._unsent(at_ns, DropReason.LINE_BUSY, "bus still full of the lists before", scan)
            return
        frames = self._encode_list(ObjectTable.of(scan.objects), at_ns, scan.plan.start_ns)
        if self._protection is not None:
            frames = [frame._replace(payload=self._protection.protect(frame.label, frame.payload)) for frame in frames]
        lengths_ns = np.rint(self._list_bits(frames) * self._bit_ns).astype(np.int64).tolist()
        gap_ns = self._gap_ns()
        self._list_duration_ns = sum(lengths_ns) + gap_ns * (len(lengths_ns) - 1)
        self._list_end_ns = at_ns + self._list_duration_ns
        self._bus.current.extend(zip(frames, lengths_ns, strict=True))
        self._bus.sweep, self._bus.reported = scan.plan.sweep, self._reported
        self._bus.free_ns = self._bus.hold_ns = max(self._bus.free_ns, at_ns)
        self._bus.gap_ns = gap_ns

    def _continue_list(self, out: list[Emission], now_ns: int) -> None:
        """Send frames of the list in progress up to `now_ns`, or until a reply comes between."""
        bus = self._bus
        current, links, sweep, gap_ns = bus.current, self._links or [0], bus.sweep, bus.gap_ns
        next_ns = max(bus.free_ns, bus.hold_ns)
        end_ns = min(now_ns, bus.replies[0][0] - 1) if bus.replies else now_ns
        while current and next_ns <= end_ns:
            frame, length_ns = current.popleft()
            self._put(out, frame, next_ns, links, sweep, bus.reported, scans=int(sweep is not None))
            sweep = None
            bus.free_ns = next_ns + length_ns
            bus.hold_ns = next_ns = bus.free_ns + gap_ns
        bus.sweep = sweep

    def _emit(self, out: list[Emission], frame: Frame, at_ns: int, links: list[int] | None = None) -> None:
        if self._protection is not None:
            frame = frame._replace(payload=self._protection.protect(frame.label, frame.payload))
        self._put(out, frame, at_ns, links if links is not None else (self._links or [0]), None)
        self._bus.free_ns = at_ns + round(frame_bits(frame.identifier, frame.payload) * self._bit_ns)

    def _put(
        self,
        out: list[Emission],
        frame: Frame,
        at_ns: int,
        links: list[int],
        sweep: int | None,
        reported: DeviceStamp | None = None,
        scans: int = 1,
    ) -> None:
        """One emission a link; the first one of a list carries the sweep, the others (`scans` 0) are its rest."""
        identifier, payload, label = frame
        for link in links:
            key = (link, identifier)
            address = self._addresses.get(key)
            if address is None:
                address = self._addresses[key] = Address(*key)
            out.append(
                Emission(at_ns, payload, address, sweep, None, label, None if sweep is None else reported, scans)
            )
            if sweep is not None:
                sweep, scans = None, 0

    def _note_foreign(self, identifier: int, now_ns: int) -> None:
        if identifier in self._seen_foreign or len(self._seen_foreign) >= 4096:
            self._foreign[identifier] += 1
            return
        self._seen_foreign.add(identifier)
        self._drop(now_ns, DropReason.OTHER_ADDRESS, f"frame 0x{identifier & 0x1FFFFFFF:X} is not for this device")

    def _report_foreign(self, now_ns: int) -> None:
        if self._foreign:
            count = self._foreign.total()
            self._drop(now_ns, DropReason.OTHER_ADDRESS, f"frames of {len(self._foreign)} other identifiers", count)
            self._foreign.clear()
