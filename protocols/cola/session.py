"""One CoLa device: measuring, scans to subscribers and polls, events.

Belongs here: what happens when, and to whom it goes. Not: requests (asking), layouts (scandata), beams (shapes).
"""

from __future__ import annotations

from collections import deque
from typing import Any

from protocols.cola import filters
from protocols.cola.answers import refusal
from protocols.cola.asking import ColaAsking
from protocols.cola.commands import EVENTS
from protocols.cola.layouts import Header
from protocols.cola.scandata import Body
from protocols.cola.settings import RUN
from protocols.cola.shapes import TICK_NS, Shape
from protocols.cola.state import POLL, SCANS, WATCH, Held, Host
from protocols.device_clock import DeviceStamp
from protocols.scan import Scan
from protocols.session import Address, DropReason, Emission, LinkKind
from protocols.skeleton.cola_frames import telegram
from protocols.skeleton.cola_values import ASCII, Code, encode
from protocols.skeleton.instants import SECOND_NS, Raster, earliest
from protocols.skeleton.outbox import Outgoing
from protocols.skeleton.requests import Answer, Refused, Request
from protocols.skeleton.sweeps import Sweep

POLLED_NS = 2 * SECOND_NS
"So long after a poll the device goes on measuring for the next one."
IMU_NS = 10_000_000


class ColaSession(ColaAsking):
    """One device."""

    FORESEES = True

    # measuring

    def _start(self, now_ns: int) -> None:
        self._raster = Raster(self.up_ns, self._raster.period_ns)
        self._watch_or_not(now_ns)
        self._events.mode(now_ns, "measuring")

    def next_plan(self) -> Any:
        """The sweep wanted next; None while it does not measure."""
        return None if self._running and self._still else super().next_plan()

    def _shape(self, number: int) -> Shape:
        place = self._setup.place(number)
        if place not in self._shapes:
            self._shapes[place] = self._setup.shape(*place, whole=self.watching.active)
        return self._shapes[place]

    def _sweep(self, number: int) -> Sweep:
        return self._shape(number).sweep

    def _passed_over(self, number: int) -> int:
        return 0 if self.watching.active else self._setup.skipped(number)

    def _telegrams(self, scan: Scan) -> list[Any]:
        raise AssertionError("dialects differ from host to host: see submit")

    def submit(self, scan: Scan) -> None:
        """Take the scan of `next_plan`; `ScanRefused` for any other."""
        hosts = [one for one in self._accepted(scan) if one not in (POLL, WATCH)]
        plan = scan.plan
        model, setup, shape = self.settings.model, self._setup, self._shape(plan.sweep)
        end_ns = plan.start_ns + round(1e9 * plan.duration_s)
        turn_ns = plan.start_ns + round(model.turn_ns(self.pair) * self._slowed)
        sent_ns = model.transmission_ns + (turn_ns if model.sends_after_turn else end_ns)
        self.watching.see(scan, end_ns)
        found = self._chain.add(scan, shape.sent, setup.filters(), setup.place(plan.sweep))
        if found is None or setup.kept_back(plan.sweep):
            self._events.unsent(self._now_ns, DropReason.KEPT, plan.sweep, "", plan.stream)
            return
        reported = self.clock.reported(end_ns if model.stamps_end else plan.start_ns, TICK_NS, 32)
        body = self._body(plan.sweep, found, shape, reported, sent_ns)
        held = Held(plan, sent_ns, body, reported)
        self._let_go(self._now_ns)
        self._held.append(held)
        for address in hosts:
            self._send_scan(held, address)

    def _send_scan(self, held: Held, address: Host) -> None:
        """To one subscriber, if its line is free."""
        said = held.telegram(b"sSN", self._dialects.get(address, ASCII))
        held.sent, plan = True, held.plan
        if self._line_takes(address, len(said), held.due_ns):
            one = Emission(held.due_ns, said, address, plan.sweep, None, SCANS, held.reported)
            self._outbox.put(Outgoing(address, deque([one]), is_scan=True))
        else:
            self._events.unsent(self._now_ns, DropReason.LINE_BUSY, plan.sweep, "", plan.stream, address)

    def _line_takes(self, address: Host, size: int, due_ns: int) -> bool:
        """Whether a serial line has sent what came before."""
        if address is None or self._connections.kind(address) is not LinkKind.SERIAL:
            return True
        return self._lines.takes(address.link, due_ns, size, self.settings.serial_baud)

    def _body(self, number: int, found: filters.Filtered, shape: Shape, reported: DeviceStamp, sent_ns: int) -> Body:
        settings, setup = self.settings, self._setup
        content = setup.content
        model = settings.model
        frequency, shots = model.frequencies(self.pair)
        header = Header(
            version=model.version,
            device=model.device_number,
            serial=settings.serial,
            status=1 if "motor status" in self.faults else model.window_status[sum(self.contamination())],
            telegrams=self.first_count + self._telegrams_made & 0xFFFF,
            scans=self.first_count + (self._telegrams_made if model.layers > 1 else number) & 0xFFFF,
            scan_us=reported.ticks,
            sent_us=self.ticks(sent_ns),
            outputs=model.ready_output | self.watching.bits(),
            layer_cdeg=model.layers_cdeg[number % model.layers],
            frequency=frequency,
            shots=shots,
        )
        self._telegrams_made += 1
        return Body(
            header, found.range_m, found.intensity, found.flags, shape.start, shape.step, setup.scale,
            model.nearest_raw, content, setup.echoes(),
            encoders=setup.encoders(reported.true_ns - self._powered_ns),
            name=self.values["LocationName"][0],
            date=self.date(reported.true_ns) if content.time and model.sends_time else None,
        )  # fmt: skip

    def _poll(self, request: Request) -> Answer | Refused:
        if self._still or request.now_ns < self.up_ns:
            return refusal(Code.CONDITION_FAILED, DropReason.WRONG_MODE)
        self._poll_until_ns = max(self._poll_until_ns, request.now_ns + POLLED_NS)
        self._subscribe(request.now_ns, POLL)
        self._asking[request.address] = request.data[:1]
        self._let_go(request.now_ns)
        if self._held and self._held[0].due_ns <= request.now_ns:
            self._serve_polls(request.now_ns + self.REPLY_NS)
        return Answer(None)

    def _let_go(self, now_ns: int) -> None:
        """Of the scans that have ended keep the last."""
        while len(self._held) > 1 and self._held[1].due_ns <= now_ns:
            self._note_unsent(self._held.popleft(), now_ns)

    def _serve_polls(self, due_ns: int) -> None:
        held = self._held[0]
        for address, dialect in self._asking.items():
            sweep, reported = (None, None) if held.sent else (held.plan.sweep, held.reported)
            said = held.telegram(b"sRA", dialect)
            self._outbox.send(Emission(due_ns, said, address, sweep, None, SCANS, reported))
            held.sent = True
        self._asking.clear()

    def _next_instant(self) -> int | None:
        own = [super()._next_instant()]
        if self._running:
            own += [self._held[0].due_ns if self._asking and self._held else None, self.watching.next_ns()]
            own += [self._poll_until_ns if POLL in self._hosts and not self._asking else None]
        return earliest(own)

    def _happen(self, now_ns: int) -> None:
        due_ns = super()._next_instant()
        if due_ns is not None and due_ns <= now_ns:
            super()._happen(now_ns)
        if not self._running:
            return
        self._let_go(now_ns)
        if self._asking and self._held and self._held[0].due_ns <= now_ns:
            self._serve_polls(now_ns)
        if self._poll_until_ns <= now_ns and not self._asking:
            self._unsubscribe(now_ns, POLL)
        if self.watching.due(now_ns):
            self._tell("LFErec", now_ns)
            self._tell("LIDoutputstate", now_ns)

    def _tell(self, name: str, now_ns: int) -> None:
        """An event to its subscribers, each in its dialect, where it has that."""
        event = EVENTS[name]
        assert event.says is not None
        assert event.says.live is not None
        text, values = event.says.layout_of(self.settings.model), event.says.live(self, now_ns)
        for address in sorted(self._listeners[name], key=str):
            dialect = self._dialects.get(address, ASCII)
            if dialect in event.dialects:
                said = telegram(dialect, b"sSN", name.encode(), encode(text, dialect, values))
                self._outbox.send(Emission(now_ns, said, address, label=name))

    def _unsubscribe(self, now_ns: int, address: Host) -> None:
        super()._unsubscribe(now_ns, address)
        if not self._hosts:
            self._give_up_held(now_ns)

    def disconnected(self, now_ns: int, address: Address) -> None:
        """A stream's host has gone: its subscriptions, polls and user level with it."""
        super().disconnected(now_ns, address)
        for one in (self._dialects, self._asking, self.asked):
            one.pop(address, None)
        for listeners in self._listeners.values():
            listeners.discard(address)
        self.set_level(address, RUN, now_ns)

    def _listen(self, name: str, on: int, request: Request) -> bytes | Refused:
        address, now_ns = request.address, request.now_ns
        if not EVENTS[name].on(self.settings.model):
            return refusal(Code.EVENT_UNKNOWN, DropReason.UNKNOWN_COMMAND)
        if on > 1:
            return refusal(Code.CONDITION_FAILED)
        (self._listeners[name].add if on else self._listeners[name].discard)(address)
        if name == SCANS and on:
            if address not in self._hosts:
                for held in self._held if self._hosts else ():
                    if held.plan.start_ns >= now_ns:
                        self._send_scan(held, address)
            self._subscribe(now_ns, address)
        elif name == SCANS:
            self._unsubscribe(now_ns, address)
        elif name == "InertialMeasurementUnit" and on and not self._imu_goes:
            self._imu_goes = True
            self._timers.add(now_ns + IMU_NS, IMU_NS, lambda at_ns: self._tell(name, at_ns))
        return encode("u8", request.data[:1], [on])
