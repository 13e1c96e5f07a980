"""The conversation of one LMS2xx: requests in, ACK and replies out, streams between them; power, boot and reset.

Order on the line: a request ends the telegram of values that is being sent (or waits for its end: `interrupt:
finish`); then the ACK, then the reply, nothing of a stream between them; then the stream goes on in its next slot.
Requests are answered one after the other, as they came; a reply that has begun is never cut.
"""

from __future__ import annotations

from collections import deque
from dataclasses import replace
from enum import Enum
from fractions import Fraction

from protocols.device_clock import DeviceStamp
from protocols.lms2xx import telegrams as wire
from protocols.lms2xx.commands import KNOWN, Answer, answer, describe
from protocols.lms2xx.device import Device, new_device, restarted
from protocols.lms2xx.field_commands import taught_by
from protocols.lms2xx.models import Model
from protocols.lms2xx.outputs import LEVELS, Measured, encode, levels
from protocols.lms2xx.receiver import Receiver
from protocols.lms2xx.schedule import Line, Schedule, Slot, Unsent
from protocols.lms2xx.settings import Settings
from protocols.lms2xx.timing import TURN_DENOMINATOR, TURN_NUMERATOR_NS, Mirror
from protocols.quartz import TRUE, Quartz
from protocols.scan import Scan, ScanPlan
from protocols.session import Address, CutShort, DropReason, Emission, LinkKind
from protocols.skeleton.instants import earliest
from protocols.skeleton.outbox import Outbox
from protocols.skeleton.receiving import Connections, Fault
from protocols.skeleton.session import EventSession

MAX_WAITING = 8
"Requests that may wait for their reply; more are lost, as in a device whose input buffer is full."


class Phase(Enum):
    """Whether the device listens."""

    OFF = "off"
    BOOTING = "booting"
    READY = "ready"
    RESETTING = "resetting"
    "The reply to a reset is on its way."


INDEX_TICK_NS = Fraction(TURN_NUMERATOR_NS, TURN_DENOMINATOR)
"The real-time scan index counts turns of the mirror: 13.33 ms, if nothing is wrong with it."
UP = (Phase.READY, Phase.RESETTING)
"Phases in which what was promised is still measured and sent."


class Lms2xxSession(EventSession):
    """One device. Give it time and bytes; it owns neither."""

    clock_tick_ns = INDEX_TICK_NS
    clock_bits = 8
    count_bits = 8

    def __init__(self, model: Model, settings: Settings) -> None:
        super().__init__()
        self._settings = settings
        self._device = new_device(model, settings)
        self._line = Line()
        self._line.a_turn = None if model.fast else self._line.a_turn
        self._values: Emission | None = None
        "The telegram of measured values sent last: it can be cut off."
        self._schedule = Schedule(self._line)
        self._mirror = Mirror(0)
        self._motor: Quartz = TRUE
        self._phase = Phase.OFF
        self._phase_end_ns = 0
        self._was_on = False
        self._replies = Outbox()
        self._reply_ends_ns: deque[int] = deque()
        self._handed_out_ns = 0
        "When the last emission handed out was due: nothing can be put before it."
        self._telegram_index = 0
        self._receivers = Connections(lambda kind: Receiver(KNOWN, settings.gap_ns, settings.strict_gap))

    @property
    def device(self) -> Device:
        """State of the device, for displays and tests."""
        return self._device

    @property
    def line_speed(self) -> int:
        """Baud of the line behind everything promised so far."""
        return self._line.baud

    # --- power ---

    def power_on(self, now_ns: int) -> None:
        """Switch on; with `start: running` the first time comes up at once and without a word."""
        self._now_ns = now_ns
        self._replies.clear()
        self._reply_ends_ns.clear()
        self._line.free_ns = self._handed_out_ns = now_ns
        self._device = restarted(self._device, switched_on=True)
        cold = self._was_on or not self._settings.starts_running
        self._was_on = True
        # An empty payload sets the links to the start-up rate.
        self._replies.send(Emission(now_ns, b"", line_speed=self._device.baud, label="power-on"))
        self._begin_boot(now_ns)
        if not cold:
            self._come_up(now_ns)

    def _begin_boot(self, at_ns: int) -> None:
        self._line.baud = self._device.baud
        self._schedule.restart(self._mirror_from(at_ns))
        self._receivers.clear()
        self._telegram_index = self.first_count
        self._events.restarted(at_ns)
        self._phase = Phase.BOOTING
        self._phase_end_ns = at_ns + _ns(self._settings.delays.boot_s)

    def _come_up(self, at_ns: int) -> None:
        self._phase = Phase.READY
        self._mirror = self._mirror_from(at_ns)
        self.clock = self.clock.powered_on(at_ns)
        self._schedule.restart(self._mirror)
        self._events.mode(at_ns, f"{self._device.mode:02X}")

    def _mirror_from(self, at_ns: int) -> Mirror:
        return Mirror(self._motor.own_ns(at_ns), self._motor)

    def impair(self, now_ns: int, what: str, degree: float) -> bool:
        """The window, and the motor of the mirror."""
        self.advance(now_ns)
        if what == "window":
            self._device = replace(self._device, window=degree)
        elif what == "motor speed":
            self._motor = self._motor.at_rate(now_ns, round(1e9 * (degree - 1.0)))
            self._device = replace(self._device, motor=degree)
            self._mirror = replace(self._mirror, motor=self._motor)
            self._schedule.motor_changed(self._mirror)
        elif what == "motor status":
            self._device = replace(self._device, motor_wrong=degree != 0.0)
        elif what == "motor stopped":
            self._device = replace(self._device, motor=1.0 - degree, motor_wrong=degree != 0.0)
        else:
            return False
        return True

    def _run_phases(self, now_ns: int) -> None:
        if self._phase is Phase.RESETTING and now_ns >= self._phase_end_ns:
            self._device = restarted(self._device, switched_on=False)
            self._begin_boot(self._phase_end_ns)
        if self._phase is Phase.BOOTING and now_ns >= self._phase_end_ns:
            at_ns = self._phase_end_ns
            self._come_up(at_ns)
            self._reply(at_ns, b"\x90" + self._device.type_text, "90")

    # --- links ---

    def connected(self, now_ns: int, address: Address, kind: LinkKind) -> None:
        """Remember how the link carries bytes; a new connection begins with an empty receiver."""
        self._receivers.connected(address, kind)

    def disconnected(self, now_ns: int, address: Address) -> None:
        """A TCP client has disconnected: discard its buffer."""
        self._receivers.disconnected(address)

    # --- input ---

    def receive(self, data: bytes, now_ns: int, address: Address | None = None) -> None:
        """Bytes of a host, in any chunking. Never raises."""
        self.advance(now_ns)
        if not data:
            return
        if self._phase is not Phase.READY:
            self._drop(DropReason.BOOTING, self._phase.value, len(data))
            return
        for found in self._receivers.of(address).feed(data, now_ns, self._settings.address):
            self._take(found)

    def advance(self, now_ns: int) -> None:
        """Let boot, time-outs and slots up to `now_ns` take effect."""
        if now_ns > self._now_ns or self._phase is not Phase.READY:  # else no time-out has passed since the last call
            self._now_ns = max(self._now_ns, now_ns)
            self._run_phases(self._now_ns)
            for receiver in self._receivers.values():
                for found in receiver.expire(self._now_ns, self._settings.address):
                    self._take(found)
        self._send_due_values()

    def _send_due_values(self) -> None:
        if self._phase in UP:
            while slot := self._schedule.take_due(self._now_ns):
                self._send_values(slot)

    def _take(self, found: wire.Telegram | Fault) -> None:
        if self._phase is not Phase.READY:
            self._drop(DropReason.BOOTING, self._phase.value)
            return
        if isinstance(found, Fault) and found.reason is not DropReason.BAD_CHECKSUM:
            self._drop(found.reason, found.detail, found.count)
            return
        while self._reply_ends_ns and self._reply_ends_ns[0] <= self._now_ns:
            self._reply_ends_ns.popleft()
        if len(self._reply_ends_ns) >= MAX_WAITING:
            self._drop(DropReason.BUSY, f"{MAX_WAITING} requests wait for their replies")
        elif isinstance(found, Fault):
            self._drop(found.reason, found.detail, found.count)
            self._interrupt()
            self._say(wire.NAK, "NAK")
            self._reply_ends_ns.append(self._line.free_ns)
        else:
            self._handle(found)
            self._reply_ends_ns.append(self._line.free_ns)
        self._schedule.line_moved()

    def _handle(self, request: wire.Telegram) -> None:
        self._interrupt()
        before = self._device
        self._device, reply = answer(before, request.command, request.data)
        self._say(wire.ACK, "ACK")
        if reply.once is not None:
            self._schedule.once(self._device, reply.once, self._line.free_ns + _ns(self._settings.delays.scan_s))
        else:
            due_ns = self._line.free_ns + _ns(getattr(self._settings.delays, reply.delay))
            label = f"{reply.payload[0]:02X}"
            self._reply(due_ns, reply.payload, label, self._speed_after(reply))
        self._note(request, reply)
        if reply.resets:
            self._phase, self._phase_end_ns = Phase.RESETTING, self._line.free_ns
            self._tell_unsent(self._schedule.withdraw(self._now_ns), "measured, not sent")
        elif self._changed(before):
            unsent = self._schedule.stream(self._device, self._line.free_ns, self._now_ns)
            self._tell_unsent(unsent, "measured, not sent")
        elif reply.new_baud is not None:
            self._schedule.speed_changed(self._device)

    def _speed_after(self, reply: Answer) -> int | None:
        return self._device.startup_baud if reply.resets else reply.new_baud

    def _changed(self, before: Device) -> bool:
        """Whether scans measured until now are no longer what the device wants."""
        after = self._device
        return after.stream_number != before.stream_number or after.configuration != before.configuration

    def _note(self, request: wire.Telegram, reply: Answer) -> None:
        outcome = "done" if reply.refusal is None else reply.refusal.value
        self._events.handled(self._now_ns, describe(request.command, request.data), outcome)
        if reply.refusal is not None:
            self._drop(reply.refusal, reply.detail)
        elif request.command in (0x20, 0x3B) and reply.new_baud is None:
            self._events.mode(self._now_ns, f"{self._device.mode:02X}")

    # --- output ---

    def _interrupt(self) -> None:
        """End the telegram of values on the line behind the byte that is leaving (listing, p. 24)."""
        sent, self._values = self._values, None
        if sent is None or not self._settings.aborts or not sent.due_ns <= self._now_ns < self._line.free_ns:
            return
        size = len(sent.payload)
        if self._line.free_ns != self._line.end_ns(sent.due_ns, size):
            return  # something waits behind it
        left, self._line.free_ns = self._line.begun(sent.due_ns, size, self._now_ns)
        if left < size:
            # what was put in before it and is due by now has begun before it: nothing waits behind it on the line
            self._replies.send(Emission(self._now_ns, b"", label="cut", cuts=True))
            self._events.add(CutShort(self._now_ns, sent.label, left, size))

    def _say(self, byte: bytes, label: str) -> None:
        """ACK or NAK, when the line is free and the device has understood."""
        due_ns = max(self._now_ns + _ns(self._settings.delays.ack_s), self._line.free_ns)
        self._replies.send(Emission(due_ns, byte, label=label))
        self._line.promise(due_ns, len(byte))

    def _reply(self, due_ns: int, payload: bytes, label: str, speed_after: int | None = None) -> None:
        telegram = wire.reply(payload, self._device.status, self._settings.address)
        self._replies.send(Emission(due_ns, telegram, line_speed=speed_after, label=label))
        self._line.promise(due_ns, len(telegram))
        if speed_after is not None:
            self._line.baud = speed_after

    def _send_values(self, slot: Slot) -> None:
        """Begin a telegram of measured values.

        A scan that came after its slot goes out at once. Less than a scan time late, it keeps its place in the schedule
        (`due_ns` lies in the past and the line catches up); later than that, the line is busy from now on.
        """
        late = self._now_ns - slot.send_ns >= slot.scan_ns
        due_ns = max(self._now_ns if late else slot.send_ns, self._handed_out_ns)
        if not slot.reserved:
            due_ns = max(due_ns, self._line.free_ns)
        measured = slot.result
        assert measured is not None
        if slot.is_silent:
            self._keep(slot, measured)
            return
        if slot.output.command == LEVELS:
            payload = levels(slot.infringed)
        else:
            payload = encode(slot.output, measured, slot.form, slot.part, slot.comb.grid)
        reported = None
        if slot.form.indices and slot.output.command != LEVELS:
            reported = self._scan_index(slot)
            payload += bytes((reported.ticks, self._telegram_index & 0xFF))
        self._telegram_index += 1
        telegram = wire.reply(payload, self._device.status, self._settings.address)
        label = f"{slot.output.command:02X}"
        self._values = Emission(
            due_ns,
            telegram,
            sweep=slot.first_turn,
            label=label,
            reported=reported,
            scans=slot.output.scans,
            pause=self._line.pause(due_ns, len(telegram)),
        )
        self._replies.send(self._values)
        self._line.promise(due_ns, len(telegram))
        self._tell_unsent(self._schedule.passed_over(slot), f"{slot.output.command:02X}")
        if late:
            self._schedule.note_late()
        self._schedule.line_moved()

    def _keep(self, slot: Slot, measured: Measured) -> None:
        """A scan for the device itself, or one without an object: nothing leaves."""
        if slot.output.is_kept:
            self._device = taught_by(self._device, slot.comb.grid, measured.range_m, slot.form.farthest_m)
        kept = Unsent(DropReason.KEPT, range(slot.first_turn, slot.end_turn, slot.comb.turns), slot.stream)
        self._tell_unsent([*self._schedule.passed_over(slot), kept], f"{slot.output.command:02X}")

    def _scan_index(self, slot: Slot) -> DeviceStamp:
        """The real-time scan index at the end of a slot's scan: turns so far, and what the clock is off by."""
        end_ns = self._mirror.turn_ns(slot.end_turn)
        turns = slot.end_turn + _turns(self.clock.shown_ns(end_ns)) - _turns(end_ns - self._mirror.began_ns)
        device_ns = round(turns * INDEX_TICK_NS)
        return DeviceStamp(end_ns, device_ns, turns & 0xFF, float(INDEX_TICK_NS), 8)

    def next_deadline(self) -> int | None:
        """When `advance` or `take_emissions` has something to do even without input."""
        times = [self._receivers.deadline(), self._replies.next_ns()]
        if self._phase in (Phase.BOOTING, Phase.RESETTING):
            times.append(self._phase_end_ns)
        if self._phase in UP:
            times.append(self._schedule.deadline(self._now_ns))
        return earliest(times)

    def next_plan(self) -> ScanPlan | None:
        """The scan wanted next, known some scan times before it begins."""
        if self._phase not in UP:
            return None
        plan = self._schedule.next_plan(self._now_ns)
        if self._schedule.passed:
            passed, self._schedule.passed = self._schedule.passed, []
            self._tell_unsent(passed, "ended before the next slot")
        return plan

    def plan_after(self, plan: ScanPlan) -> ScanPlan | None:
        """One ahead, of a stream."""
        return self._schedule.plan_after(plan, self._now_ns) if self._phase in UP else None

    def begun(self, plan: ScanPlan) -> None:
        """It keeps its slot though it may be late."""
        self._schedule.begun(plan)

    def submit(self, scan: Scan) -> None:
        """Take the scan of `next_plan`; `ScanRefused` when it is not wanted any more."""
        self._schedule.submit(scan)
        # A late scan moves the line and with it the next slot: before `next_plan` gives that one out.
        self._send_due_values()

    def missed(self, plan: ScanPlan, now_ns: int) -> bool:
        """The stream goes on with a later scan; one asked for comes later."""
        self.advance(now_ns)
        self._tell_unsent(self._schedule.give_up(plan, self._now_ns), "not measured in time")
        return True

    def take_emissions(self, now_ns: int) -> list[Emission]:
        """What is due by `now_ns`, in the order it leaves."""
        self.advance(now_ns)
        taken = self._replies.take(now_ns)
        if taken:
            self._handed_out_ns = taken[-1].due_ns
        return taken

    def _drop(self, reason: DropReason, detail: str, count: int = 1) -> None:
        self._events.drop(self._now_ns, reason, detail, count)

    def _tell_unsent(self, unsent: list[Unsent], detail: str) -> None:
        for reason, turns, stream in unsent:
            self._events.unsent(self._now_ns, reason, turns, detail, stream)


def _turns(span_ns: int) -> int:
    """Whole turns in a time that was rounded down to nanoseconds."""
    return (span_ns + 1) * TURN_DENOMINATOR // TURN_NUMERATOR_NS


def _ns(seconds: float) -> int:
    return round(seconds * 1e9)
