"""Which scans are measured, and when their telegrams begin: mirror and line brought together.

A telegram of measured values begins where a scan ends (a slot). While one is sent, further scans pass unsent; the next
slot is the end of the first scan for which the line is free again, from which the known rates follow. A slot is known
as soon as the telegram before it has its own, so its scan can be measured ahead.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import NamedTuple

from protocols.errors import EncodeError
from protocols.lms2xx.device import Device
from protocols.lms2xx.outputs import LEVELS, Format, Mean, Measured, Output, nearest
from protocols.lms2xx.timing import TURN_DENOMINATOR, TURN_NUMERATOR_NS, Mirror
from protocols.lms2xx.variants import PARTIAL_SETS, Comb, comb
from protocols.scan import Scan, ScanPlan
from protocols.session import DropReason
from protocols.skeleton.serial_lines import BITS, line_ns
from protocols.skeleton.wanted import Wanted

TURN_NS = TURN_NUMERATOR_NS // TURN_DENOMINATOR
AHEAD_SCANS = 2
"A plan is given out this many scan times before its scan begins (at least `AHEAD_TURNS`): time to measure it."
AHEAD_TURNS = 3
"40 ms."
MOST_A_TURN, FASTEST_BAUD = 508, 500_000
"Listing, p. 22 and 126-129."


class Line:
    """The device's end of the line: its speed, and until when bytes already promised keep it busy."""

    def __init__(self) -> None:
        self.baud = 9600
        self.free_ns = 0
        self.mirror = Mirror(0)
        self.a_turn: int | None = MOST_A_TURN
        "Bytes that leave in one turn of the mirror at the highest speed; None: as many as will."

    def promise(self, start_ns: int, count: int) -> int:
        """Let `count` bytes begin at `start_ns`; when they will have left."""
        end_ns = self.end_ns(start_ns, count)
        self.free_ns = max(self.free_ns, end_ns)
        return end_ns

    def pause(self, start_ns: int, count: int) -> tuple[int, int] | None:
        """How many bytes leave before the telegram waits for the next turn, and when that begins; None: all do."""
        if self.a_turn is None or self.baud < FASTEST_BAUD or count <= self.a_turn:
            return None
        turn = self.mirror.first_turn_from(start_ns + line_ns(self.a_turn, self.baud))
        return self.a_turn, self.mirror.turn_ns(turn)

    def end_ns(self, start_ns: int, count: int) -> int:
        """When `count` bytes that begin at `start_ns` will have left."""
        pause = self.pause(start_ns, count)
        if pause is None:
            return start_ns + line_ns(count, self.baud)
        return pause[1] + line_ns(count - pause[0], self.baud)

    def begun(self, start_ns: int, count: int, now_ns: int) -> tuple[int, int]:
        """How many of `count` bytes have begun by `now_ns`, and when the last of them will have left."""
        pause = self.pause(start_ns, count)
        if pause is not None and now_ns >= start_ns + line_ns(pause[0], self.baud):
            more, end_ns = (0, now_ns) if now_ns < pause[1] else self._whole(pause[1], now_ns)
            return min(pause[0] + more, count), end_ns
        done, end_ns = self._whole(start_ns, now_ns)
        return min(done, count), end_ns

    def _whole(self, start_ns: int, now_ns: int) -> tuple[int, int]:
        count = (now_ns - start_ns) * self.baud // (BITS * 1_000_000_000) + 1
        return count, start_ns + line_ns(count, self.baud)


@dataclass(eq=False)
class Slot:
    """One telegram of measured values that is to be sent."""

    output: Output
    comb: Comb
    part: int | None
    form: Format
    gain: float
    first_turn: int
    send_ns: int
    size: int
    once: bool
    "Asked for, and not part of the mode's stream."
    reserved: bool
    "The line is already promised to it."
    stream: int
    "Number of the stream it belongs to; what is asked for is one of its own."
    measured: int = 0
    mean: Mean | None = None
    result: Measured | None = None
    infringed: tuple[bool, bool, bool] | None = None
    "Fields with an object in each of the scans, where that is asked."
    given_out: tuple[int, Mirror | None, int] = (-1, None, 0)
    "Turn of the scan wanted next, the mirror, and when its plan is given out by them."

    @property
    def is_silent(self) -> bool:
        """Nothing of it leaves."""
        return self.output.is_kept or (self.output.on_object and self.result is not None and not self._found())

    def _found(self) -> bool:
        return self.infringed is not None and any(self.infringed)

    @property
    def end_turn(self) -> int:
        return self.first_turn + self.output.scans * self.comb.turns

    @property
    def scan_ns(self) -> int:
        return self.comb.turns * TURN_NS

    @property
    def next_turn(self) -> int:
        """First turn of the scan to be measured next."""
        return self.first_turn + self.measured * self.comb.turns

    def take(self, scan: Measured) -> None:
        """Take the next scan."""
        self.measured += 1
        levels, fields = self.output.command == LEVELS, self.form.fields
        if fields is not None and (levels or self.output.on_object):
            a, b, c = fields.infringed(scan.range_m, scan.flags, self.comb.grid)
            if self.infringed is not None:
                a, b, c = a and self.infringed[0], b and self.infringed[1], c and self.infringed[2]
            self.infringed = (a, b, c)
        if self.output.scans == 1 or levels:
            self.result = scan if self.measured == self.output.scans else None
            self.size = 0 if self.is_silent else self.size
            return
        if self.mean is None:
            self.mean = Mean(self.comb.points, self.form.farthest_m)
        self.mean.add(scan)
        if self.measured == self.output.scans:
            self.result = self.mean.result()


class Unsent(NamedTuple):
    """Scans that hosts do not get: why, the first turns of each, and of which stream."""

    reason: DropReason
    turns: range
    stream: int


class Schedule:
    """The slots of one device, nearest first."""

    def __init__(self, line: Line) -> None:
        self._line = line
        self._mirror = Mirror(0)
        self._device: Device | None = None
        self._stream: Output | None = None
        self._stream_from_ns = 0
        self._stream_turn = 0
        "End of the last scan of the stream that has a slot."
        self._sent_turn: int | None = None
        "Beginning of the first scan of the stream that was neither sent nor reported; None: none was searched for yet."
        self._number = 0
        "Of streams, and of scans that were asked for."
        self._stream_number = 0
        self._slots: deque[Slot] = deque()
        self._late = False
        "Scans pass unsent because one was not measured in time."
        self.passed: list[Unsent] = []
        "Scans that ended unsent before the next slot of the stream, since last asked."
        self._begun: ScanPlan | None = None
        "Measured before it is wanted."
        self._telegrams = 0
        "Telegrams of this stream so far, including pending ones: determines the next partial scan."
        self._wanted: Wanted[Slot] = Wanted()
        "The scan that was asked for, and the slot that it is for."

    def restart(self, mirror: Mirror) -> None:
        """The mirror starts to turn; no scan is requested."""
        self._keep([])
        self._wanted.epoch += 1
        self._mirror = self._line.mirror = mirror
        self._stream = None

    def withdraw(self, now_ns: int) -> list[Unsent]:
        """Forget every slot that the line is not promised to; the scans that hosts do not get.

        A scan that was asked for before stays: its telegram comes before the ACK of whatever withdraws the others.
        """
        unsent = self._passed_unsent(now_ns)
        for slot in self._slots:
            if not slot.reserved and slot.measured:
                numbers = range(slot.first_turn, slot.next_turn, slot.comb.turns)
                unsent.append(Unsent(DropReason.STALE, numbers, slot.stream))
        self._keep([slot for slot in self._slots if slot.reserved])
        self._wanted.epoch += 1
        self._stream = None
        return unsent

    def _passed_unsent(self, now_ns: int) -> list[Unsent]:
        """Scans of the stream that have ended since the last telegram; those before a slot whose scan is asked for."""
        if self._stream is None or self._device is None or self._sent_turn is None:
            return []
        slot = next((slot for slot in self._slots if not slot.once), None)
        made = comb(self._device.variant, None) if slot is None else slot.comb
        ended = self._ended_by(now_ns, made.turns)
        if slot is None:
            size = self._stream.telegram_bytes(made.points, self._device.format.indices)
            return self._by_cause(ended, made.turns, size, self._stream.scans)
        passed = self._by_cause(min(ended, slot.first_turn), made.turns, slot.size, slot.output.scans)
        begun = max(self._sent_turn, ended)
        if slot is self._wanted.what or slot.measured:  # all scans before it are on account
            passed.append(Unsent(DropReason.STALE, range(begun, slot.first_turn, made.turns), slot.stream))
        return passed

    def stream(self, device: Device, from_ns: int, now_ns: int) -> list[Unsent]:
        """Send what the device's mode sends from now on; scans begin at `from_ns` or later. Returns as `withdraw`."""
        unsent = self.withdraw(now_ns)
        self._device = device
        self._stream = device.stream
        self._stream_from_ns = from_ns
        self._stream_turn = 0
        self._sent_turn = None
        self._number += 1
        self._stream_number = self._number
        self._late = False
        self._telegrams = 0
        return unsent

    def speed_changed(self, device: Device) -> None:
        """The line has another speed: the stream goes on, in other slots."""
        self._device = device
        self._drop_stream_slots()

    def motor_changed(self, mirror: Mirror) -> None:
        """The mirror turns at another speed: the stream goes on, in other slots."""
        self._drop_stream_slots()
        self._mirror = self._line.mirror = mirror

    def once(self, device: Device, output: Output, ready_ns: int) -> None:
        """Send one telegram that was asked for: the scan that ends at `ready_ns` or next.

        Scans of a mean begin at `ready_ns`; requests that come while they are measured are answered before it is sent.
        """
        self._device = device
        self._drop_stream_slots()
        if output.direct:
            self._once_direct(device, output, ready_ns)
            return
        made = comb(device.variant, 0 if output.partial else None)
        free_ns = max(ready_ns, self._line.free_ns)
        single = output.scans == 1
        scan = self._scan_from(free_ns if single else ready_ns, made.turns) + (0 if single else output.scans)
        scan = max(scan, output.scans)
        send_ns = self._mirror.turn_ns(scan * made.turns)
        first = (scan - output.scans) * made.turns
        part = first % PARTIAL_SETS if output.partial else None
        made = comb(device.variant, part)
        size = output.telegram_bytes(made.points, device.format.indices)
        self._number += 1
        slot = Slot(output, made, part, device.format, device.gain, first, send_ns, size, True, single, self._number)
        place = sum(other.reserved for other in self._slots) if single else len(self._slots)
        self._slots.insert(place, slot)
        if single:
            self._line.promise(send_ns, size)

    def _once_direct(self, device: Device, output: Output, ready_ns: int) -> None:
        """A telegram for each turn of the next scan, straight after it."""
        turns, points = device.variant.turns, device.variant.points
        place = sum(other.reserved for other in self._slots)
        turn = max(0, self._mirror.first_turn_from(max(ready_ns, self._line.free_ns)) - 1)
        first = -(-turn // turns) * turns
        for index in range(turns):
            part = index * PARTIAL_SETS // turns
            made = comb(device.variant, part, direct=True)
            size = output.telegram_bytes(points, device.format.indices, part, turns)
            send_ns = max(self._mirror.turn_ns(first + index + 1), self._line.free_ns)
            self._number += 1
            slot = Slot(
                output, made, part, device.format, device.gain, first + index, send_ns, size, True, True, self._number
            )
            self._slots.insert(place + index, slot)
            self._line.promise(send_ns, size)

    def line_moved(self) -> None:
        """The line was promised to something else: slots that it took away move on."""
        for slot in self._slots:
            if slot.once or slot.send_ns >= self._line.free_ns:
                continue
            if slot.output.scans == 1 or not slot.measured:
                self._drop_stream_slots()
            else:
                kept = list(self._slots)
                self._keep(kept[: kept.index(slot) + 1])
                slot.send_ns = self._mirror.turn_ns(self._mirror.first_turn_from(self._line.free_ns))
                self._note_stream_end()
            return

    def next_plan(self, now_ns: int) -> ScanPlan | None:
        """The scan wanted next, from `AHEAD_SCANS` before it begins."""
        if self._wanted.plan is None:
            slot = self._open_slot(now_ns)
            if slot is not None and self._given_out_ns(slot) <= now_ns:
                self._wanted.ask(self._make_plan(slot), slot)
        return self._wanted.plan

    def plan_after(self, plan: ScanPlan, now_ns: int) -> ScanPlan | None:
        """The stream's scan after the one of `next_plan`, if nothing changes; forgets what was `begun` before it."""
        slot, stream, device = self._wanted.what, self._stream, self._device
        if slot is None or slot.once or slot.output.scans > 1 or stream is None or device is None:
            return None
        if plan.sweep != slot.first_turn or slot is not self._slots[-1] or slot.size == 0:
            return None
        kept = self._late, self._sent_turn
        self._begun = None
        following = self._next_of_stream(stream, device, now_ns)
        self._late, self._sent_turn = kept
        return self._make_plan(following)

    def begun(self, plan: ScanPlan) -> None:
        """A scan of `plan_after` is being measured: the program was not held up for it."""
        self._begun = plan

    def submit(self, scan: Scan) -> None:
        """Take the scan of `next_plan`. Raises `ScanRefused` for any other."""
        slot = self._wanted.expect(scan.plan)
        if len(scan.range_m) != len(scan.plan):
            raise EncodeError(f"{len(scan.range_m)} beams; the plan has {len(scan.plan)}")
        self._wanted.forget()
        slot.take(nearest(scan))

    def give_up(self, plan: ScanPlan, now_ns: int) -> list[Unsent]:
        """The scan of `next_plan` will not be measured. Raises `ScanRefused` for any other.

        The stream goes on in a later slot: the scans that this costs, as `passed_over`. What a host has asked for by
        name is measured later, under a new number.
        """
        slot = self._wanted.expect(plan)
        self._wanted.renew()
        if not slot.once:
            self._slots.remove(slot)
            self._telegrams -= 1
            unsent = self.passed_over(slot)
            self._late = True
            given_up = range(slot.first_turn, slot.end_turn, slot.comb.turns)
            return [*unsent, Unsent(DropReason.LATE, given_up, slot.stream)]
        unsent = [Unsent(DropReason.LATE, range(slot.first_turn, slot.end_turn, slot.comb.turns), slot.stream)]
        self._number += 1
        slot.stream = self._number
        begin = self._scan_from(now_ns, slot.comb.turns) * slot.comb.turns
        slot.first_turn = max(begin, slot.first_turn)
        slot.measured, slot.mean = 0, None
        slot.send_ns = self._mirror.turn_ns(slot.end_turn)
        if slot.reserved:
            self._line.promise(slot.send_ns, slot.size)
        return unsent

    def take_due(self, now_ns: int) -> Slot | None:
        """The next slot whose time has come and whose scans are there, removed; call until None."""
        if not self._slots or self._slots[0].result is None or self._slots[0].send_ns > now_ns:
            return None
        return self._slots.popleft()

    def deadline(self, now_ns: int) -> int | None:
        """When `take_due` or `next_plan` will have something without further input."""
        times = []
        if self._slots and self._slots[0].result is not None:
            times.append(self._slots[0].send_ns)
        if self._wanted.plan is None:
            slot = self._open_slot(now_ns)
            if slot is not None:
                times.append(self._given_out_ns(slot))
        return min(times, default=None)

    def note_late(self) -> None:
        """A scan came so late that the next ones pass unsent for that reason, beside those that the line costs."""
        self._late = True

    def passed_over(self, slot: Slot) -> list[Unsent]:
        """Scans that ended unsent between the stream's telegram before this one and this one, by cause."""
        if slot.once:
            return []
        passed = self._by_cause(slot.first_turn, slot.comb.turns, slot.size, slot.output.scans)
        self._sent_turn = slot.end_turn
        return passed

    def _by_cause(self, until_turn: int, turns: int, size: int, scans: int, later: int = 0) -> list[Unsent]:
        """Why the scans from the last telegram on were not sent: as many as a telegram takes, others were late.

        `later`: how many more will pass before the next telegram.
        """
        numbers = range(until_turn if self._sent_turn is None else self._sent_turn, until_turn, turns)
        line_scans = self._line_scans(size, turns, until_turn) - scans
        by_line = max(0, line_scans - later) if self._late else len(numbers)
        self._late = False
        causes = ((DropReason.LINE_BUSY, numbers[:by_line]), (DropReason.LATE, numbers[by_line:]))
        return [Unsent(reason, found, self._stream_number) for reason, found in causes if found]

    def _pass_ended(self, slot: Slot, now_ns: int) -> None:
        """Report scans before a slot that have ended immediately, if one was late or replies have occupied the line."""
        turns = slot.comb.turns
        until = min(slot.first_turn, self._ended_by(now_ns, turns))
        passed = 0 if self._sent_turn is None else (until - self._sent_turn) // turns
        if passed > (0 if self._late else self._line_scans(slot.size, turns, until)):
            later, late = (slot.first_turn - until) // turns, self._late
            self.passed += self._by_cause(until, turns, slot.size, slot.output.scans, later)
            self._sent_turn, self._late = until, late  # what passes until the slot has the same cause

    def _line_scans(self, size: int, turns: int, from_turn: int) -> int:
        """Scans that end while a telegram that begins with a turn is on the line, itself among them."""
        begin_ns = self._mirror.turn_ns(from_turn)
        return -(-(self._line.end_ns(begin_ns, size) - begin_ns) // (turns * TURN_NS))

    def _ended_by(self, now_ns: int, turns: int) -> int:
        """End of the last scan that has ended."""
        return max(0, self._mirror.first_turn_from(now_ns + 1) - 1) // turns * turns

    def _scan_from(self, time_ns: int, turns: int) -> int:
        """Number of the first scan of so many turns that begins at `time_ns` or later."""
        return -(-self._mirror.first_turn_from(time_ns) // turns)

    def _given_out_ns(self, slot: Slot) -> int:
        turn, mirror, given_ns = slot.given_out
        if turn != slot.next_turn or mirror is not self._mirror:
            turn, mirror = slot.next_turn, self._mirror
            # with a turn, as slots are: both are one thing to do
            given_ns = mirror.turn_ns(turn - max(AHEAD_SCANS * slot.comb.turns, AHEAD_TURNS))
            slot.given_out = turn, mirror, given_ns
        return given_ns

    def _open_slot(self, now_ns: int) -> Slot | None:
        """The first slot that still wants scans; the stream's next one is made when there is none."""
        for slot in self._slots:
            if slot.result is None:
                return slot
        if self._stream is None or self._device is None:
            return None
        slot = self._next_of_stream(self._stream, self._device, now_ns)
        self._pass_ended(slot, now_ns)
        self._slots.append(slot)
        self._note_stream_end()
        self._telegrams += 1
        return slot

    def _next_of_stream(self, output: Output, device: Device, now_ns: int) -> Slot:
        part, turns = None, device.variant.turns
        if output.partial:
            part = self._telegrams % PARTIAL_SETS
        elif output.direct:
            part = self._telegrams % turns * PARTIAL_SETS // turns
        made = comb(device.variant, part, output.direct)
        points = device.variant.points if output.direct else made.points
        size = output.telegram_bytes(points, device.format.indices, part, turns)
        free_ns = self._line.free_ns
        if self._slots:
            last = self._slots[-1]
            free_ns = max(free_ns, self._line.end_ns(last.send_ns, last.size))
        first = self._scan_from(self._stream_from_ns, made.turns)
        if self._sent_turn is None:
            self._sent_turn = first * made.turns
        # A program that was held up does not make good more than the last scan.
        held_ns = now_ns - made.turns * TURN_NS
        if self._begun is not None and self._begun.epoch == self._wanted.epoch:
            held_ns = min(held_ns, self._mirror.turn_ns(self._begun.sweep + made.turns))
        if held_ns > free_ns:
            free_ns = held_ns
            self._late = True
        end = max(
            self._scan_from(free_ns, made.turns),
            first + output.scans,
            -(-self._stream_turn // made.turns) + output.scans,
        )
        if output.direct:  # the next turn that measures this part of the scan
            end += (self._telegrams + 1 - end) % turns
        first_turn = (end - output.scans) * made.turns
        send_ns = self._mirror.turn_ns(end * made.turns)
        number = self._stream_number
        return Slot(output, made, part, device.format, device.gain, first_turn, send_ns, size, False, False, number)

    def _note_stream_end(self) -> None:
        self._stream_turn = max((slot.end_turn for slot in self._slots if not slot.once), default=self._stream_turn)

    def _drop_stream_slots(self) -> None:
        """Withdraw the part of the stream that has not been sent; its slot is determined again."""
        kept = [slot for slot in self._slots if slot.once]
        self._telegrams -= len(self._slots) - len(kept)
        self._stream_turn = self._sent_turn or 0
        self._keep(kept)

    def _keep(self, kept: list[Slot]) -> None:
        """Let go of all other slots, and of the plan made for one of them: its scan may still be on its way."""
        self._slots = deque(kept)
        if self._wanted.what is not None and self._wanted.what not in kept:
            self._wanted.renew()

    def _make_plan(self, slot: Slot) -> ScanPlan:
        start_ns = self._mirror.turn_ns(slot.next_turn)
        slowed = self._mirror.slowed(start_ns)
        offsets_s = slot.comb.fire_offset_s
        return ScanPlan(
            epoch=self._wanted.epoch,
            sweep=slot.next_turn,
            start_ns=start_ns,
            azimuth_rad=slot.comb.azimuth_rad,
            elevation_rad=slot.comb.elevation_rad,
            fire_offset_s=offsets_s if slowed == 1.0 else offsets_s * slowed,
            duration_s=slot.comb.turns * TURN_NUMERATOR_NS / TURN_DENOMINATOR / 1e9 * slowed,
            max_range_m=slot.form.farthest_m,
            gain=slot.gain,
            wants_intensity=slot.form.wants_intensity(slot.output),
            stream=slot.stream,
            stride=slot.comb.turns,
            period_ns=0 if slot.once else round(slot.scan_ns * slowed),
        )
