"""The device in conversation: hosts come and go on its links, ask, and get replies and profiles in their order.

Framing is in `channels`, meaning in `services`, measuring in `revolutions`; here is what happens when.
Whatever `now_ns` a caller jumps to, everything in between happens in the order of its own instants.
"""

from __future__ import annotations

from collections import deque
from dataclasses import replace

from protocols.device_clock import DeviceClock
from protocols.errors import ScanRefused
from protocols.ld import cola, routing
from protocols.ld.answers import Answer
from protocols.ld.channels import MAX_INBOX, Channel, Line, Profiles, Request, new_channel
from protocols.ld.device import CLOCK_TICK_NS, Caller, Device, Geometry
from protocols.ld.models import Model
from protocols.ld.profiles import SICKTOOLBOX_BYTES, encode_profile
from protocols.ld.revolutions import Measured, Need, Revolutions, revolution_of, wants_echoes
from protocols.ld.routing import Attached
from protocols.ld.services import serve, title
from protocols.ld.settings import Settings
from protocols.ld.telegrams import (
    GET_PROFILE_REPLY,
    REPLY_BIT,
    SERVICE_FAILURE,
    Motor,
    payload_of,
    words_of,
)
from protocols.scan import Scan, ScanPlan
from protocols.session import Address, DropReason, Emission, LinkKind
from protocols.skeleton.instants import earliest
from protocols.skeleton.outbox import Outgoing
from protocols.skeleton.receiving import Fault
from protocols.skeleton.session import TimedSession

MAX_CHANNELS = 256
"Hosts kept apart at once; TCP links bound theirs themselves, senders of datagrams and CAN frames could be endless."

INTERFACES = {LinkKind.SERIAL: routing.SERIAL, LinkKind.CAN: routing.CAN}
"Kinds of links that services 0601 to 0605 can attach."

CAN_BURST = 16
"Frames handed over together, each with its own instant: about two milliseconds of a bus of 1 Mbit/s."

WORKING_SERVICES = 4
"High byte of the services that change the mode."


class LdSession(TimedSession):
    """One LD-LRS or LD-OEM."""

    clock_tick_ns = CLOCK_TICK_NS
    clock_bits = 32
    count_bits = 16

    def __init__(self, model: Model, settings: Settings) -> None:
        super().__init__(CAN_BURST)
        self.device = Device(model, settings)
        self.can_bitrate = self.device.can_bitrate
        self._lines: dict[int, Line] = {}
        self._channels: dict[Address, Channel] = {}
        self._revolutions = Revolutions()
        self._reported_mode = ""
        self._will_start_itself = True
        "It has been switched on, and not yet entered its first mode."
        self._will_measure = False
        "It measures once the head is at speed, unless a host takes over before."
        self._geometry: Geometry | None = None
        "What the plans given out so far were made for."

    @property
    def clock(self) -> DeviceClock:
        """The device's own."""
        return self.device.clock

    @clock.setter
    def clock(self, clock: DeviceClock) -> None:
        self.device.clock = clock

    # power

    def power_on(self, now_ns: int) -> None:
        self._now_ns = max(self._now_ns, now_ns)
        at_once = self.device.settings.starts_running and self.device.restarts == 0
        self._outbox.clear()
        for line in self._lines.values():
            line.free_ns = now_ns
        self._boot(now_ns, now_ns, 0 if at_once else self.device.delays.boot_ns)
        self._set_line_speed(now_ns)
        if at_once:
            self._start_itself(now_ns, already=True)

    def _boot(self, now_ns: int, from_ns: int, boot_ns: int) -> None:
        """Lose everything volatile; the device listens again `boot_ns` after `from_ns`."""
        self._outbox.withdraw(lambda sent: not sent.begun and sent.emissions[0].due_ns > from_ns)
        for channel in self._channels.values():
            channel.clear()
        held = self.device.attached.get(routing.SERIAL)
        self.device.boot(from_ns, boot_ns)
        if held is not None and held.baud != self.device.baud:
            self._set_line_speed(from_ns)
        self._revolutions.begin()
        self._geometry = None
        self._will_start_itself, self._will_measure = True, False
        self._events.restarted(now_ns)
        self._tell_mode(now_ns)

    def _start_itself(self, now_ns: int, already: bool = False) -> None:
        """Enter the mode that the scenario asks for, or measure for a link that can only listen."""
        self._will_start_itself = False
        device = self.device
        listeners = any(line.kind is LinkKind.DATAGRAM for line in self._lines.values())
        mode = device.settings.mode or ("measure" if listeners else "idle")
        if device.motor is Motor.STOPPED:
            mode = "idle"  # it wants to, and cannot
        if mode != "idle":
            device.rotate(now_ns, device.configured_hz)
            if already:
                device.skip_spin_up(now_ns)
        self._will_measure = mode == "measure"
        self._settle(now_ns)

    def _set_line_speed(self, now_ns: int, but: Line | None = None) -> None:
        """Set the speed of every serial line; the payload is empty."""
        for index, line in self._lines.items():
            if line.kind is LinkKind.SERIAL and line is not but:
                address = Address(index, 0)
                held = self.device.attached.get(routing.SERIAL)
                baud = self.device.baud if held is None else held.baud
                speed = Emission(now_ns, b"", address, line_speed=baud, label="line speed")
                self._outbox.put(Outgoing(None, deque([speed])))

    # hosts

    def connected(self, now_ns: int, address: Address, kind: LinkKind) -> None:
        line = self._lines.setdefault(address.link, Line(kind, now_ns))
        if kind is not LinkKind.CAN:  # a host on CAN is known by its identifier, when it speaks
            self._channels[address] = new_channel(address, line)
        if kind is LinkKind.DATAGRAM:
            self._serve_listeners(now_ns)

    def disconnected(self, now_ns: int, address: Address) -> None:
        self.advance(now_ns)
        self._channels.pop(address, None)
        gone = self._outbox.withdraw(lambda sent: sent.to == address)
        self._tell_withdrawn(now_ns, gone, address)
        self._release(address, now_ns)

    def _channel(self, address: Address) -> Channel | None:
        """The channel of an address; senders of datagrams and CAN frames get one with their first message."""
        line = self._lines.setdefault(address.link, Line(LinkKind.STREAM))
        if line.kind is LinkKind.CAN and not self._is_host(address.peer):
            return None
        known = self._channels.get(address)
        if known is not None:
            return known
        if len(self._channels) >= MAX_CHANNELS and not self._forget_one():
            return None
        self._channels[address] = new_channel(address, line)
        return self._channels[address]

    def _is_host(self, identifier: int) -> bool:
        _, base, mask, _, broadcast = self.device.can
        return identifier == broadcast or (identifier <= 0x7FF and identifier & ~mask == base & ~mask)

    def _forget_one(self) -> bool:
        """Make room: forget a sender of datagrams or CAN frames that wants nothing."""
        for address, channel in self._channels.items():
            wants = channel.profiles or channel.inbox or channel.waiting
            if not wants and address.peer and channel.kind in (LinkKind.DATAGRAM, LinkKind.CAN):
                del self._channels[address]
                return True
        return False

    # interfaces in a host's hands

    def _take_routed(self, data: bytes, now_ns: int, address: Address) -> bool:
        """Whether input came on an attached interface: it goes to the host that holds it."""
        line = self._lines.get(address.link)
        held = None if line is None else self.device.attached.get(INTERFACES.get(line.kind, 0))
        if line is None or held is None or self.device.is_booting(now_ns):
            return False
        if line.kind is LinkKind.SERIAL:
            held.received += data
            held.heard_ns = now_ns
            while len(held.received) >= routing.SERIAL_BUFFER:
                self._tell_received(held, now_ns)
        elif held.accepts(address.peer):
            self._tell(held, routing.can_data(self.device.clock_ms(now_ns), address.peer, data), now_ns)
        return True

    def _tell_received(self, held: Attached, now_ns: int) -> None:
        characters = bytes(held.received[: routing.SERIAL_BUFFER])
        del held.received[: routing.SERIAL_BUFFER]
        self._tell(held, routing.serial_data(self.device.clock_ms(held.heard_ns), characters), now_ns)

    def _tell(self, held: Attached, words: tuple[int, ...], now_ns: int) -> None:
        channel = self._channels.get(held.holder)
        if channel is not None:
            label = f"{routing.COM_DATA:04X}"
            self._outbox.put(channel.telegram(payload_of(*words), held.route, now_ns, self.device, label=label))

    def _put_routed(self, routed: tuple[routing.Routed, ...], now_ns: int) -> None:
        """Send what a host gave to an attached interface, on every link that it has."""
        for index, line in self._lines.items():
            mine = [one for one in routed if INTERFACES.get(line.kind) == one.interface]
            if mine:
                to = [Emission(now_ns, one.data, Address(index, one.peer), label="0604") for one in mine]
                self._outbox.put(Outgoing(None, deque(to)))

    def _release(self, address: Address, now_ns: int) -> None:
        """A host has gone: what it held serves the protocol again."""
        device = self.device
        for interface in [number for number, held in device.attached.items() if held.holder == address]:
            changed = device.attached.pop(interface).baud != device.baud
            if interface == routing.SERIAL and changed:
                self._set_line_speed(now_ns)
        if device.monitor is not None and device.monitor.address == address:
            device.monitor = None

    # requests

    def receive(self, data: bytes, now_ns: int, address: Address | None = None) -> None:
        self.advance(now_ns)
        if self._take_routed(data, now_ns, address or Address(0, 0)):
            return
        channel = self._channel(address or Address(0, 0))
        if channel is None:
            self._drop(now_ns, DropReason.OTHER_ADDRESS, len(data))
        elif self.device.is_booting(now_ns):
            self._drop(now_ns, DropReason.BOOTING, len(data))
        else:
            self._take(channel, channel.read(data, now_ns, self.device), now_ns)

    def _take(self, channel: Channel, items: list[Request | Fault], now_ns: int) -> None:
        for item in items:
            if isinstance(item, Fault):
                self._drop(now_ns, item.reason, item.count, item.detail)
                if item.whole and channel.kind is LinkKind.SERIAL:
                    self._outbox.put(channel.nak(now_ns, self.device))
            elif self.device.is_booting(now_ns):  # a reset came before it in the same bytes
                self._drop(now_ns, DropReason.BOOTING, len(item.payload))
            elif len(channel.inbox) >= MAX_INBOX:
                self._drop(now_ns, DropReason.OVERLONG, len(item.payload), f"{MAX_INBOX} requests wait already")
            else:
                channel.inbox.append(item)
                self._work(channel, now_ns)

    def _work(self, channel: Channel, now_ns: int) -> None:
        """Carry out what waits, one request after the other: the next one when the last reply has left."""
        while channel.inbox and channel.waiting is None and channel.busy_until_ns <= now_ns:
            request = channel.inbox.popleft()
            if request.is_cola:
                self._answer_cola(channel, request.payload, now_ns)
                continue
            words = words_of(request.payload)
            if not words:
                nothing = Answer(refused=DropReason.BAD_LENGTH, failure=True, detail="no service word")
                self._answer(channel, request, nothing, now_ns)
            elif words[0] == SERVICE_FAILURE:
                # a failure is never answered by a failure: with an echoing host it would go on for ever
                self._drop(now_ns, DropReason.UNKNOWN_COMMAND, len(request.payload), title(words[0]))
            else:
                self._will_measure = self._will_measure and words[0] >> 8 != WORKING_SERVICES
                self.device.caller = Caller(channel.address, request.route, INTERFACES.get(channel.kind, 0))
                self._answer(channel, request, serve(self.device, words[0], words[1:], now_ns), now_ns)

    def _answer(self, channel: Channel, request: Request, answer: Answer, now_ns: int) -> None:
        if answer.when_at_speed is not None:
            channel.waiting = (request, answer.when_at_speed)
            self._settle(now_ns)
            return
        service = int.from_bytes(request.payload[:2], "big")
        if answer.stops_profiles:
            self._stop(channel, now_ns)
        self._settle(now_ns)
        what = title(service)
        if answer.refused is not None:
            self._drop(now_ns, answer.refused, 1, f"{what}: {answer.detail}")
        if answer.start is not None:
            profiles = Profiles(answer.start.form, answer.start.number or None, now_ns, request.route)
            what += self._start(channel, profiles, now_ns)
        self._events.handled(now_ns, what, answer.refused.value if answer.refused else "done")
        if answer.failure:
            self._reply(channel, request, (SERVICE_FAILURE, 0, 0, *self.device.status), answer, now_ns)
        elif answer.words is not None:
            self._reply(channel, request, (service | REPLY_BIT, *answer.words), answer, now_ns)

    def _answer_cola(self, channel: Channel, payload: bytes, now_ns: int) -> None:
        """CoLa telegrams log in and ask who the device is; nothing else of them is known."""
        reply, done = cola.answer(payload, self.device.identity.__getitem__)
        what = "CoLa " + payload[:24].partition(b"\0")[0].decode("ascii", "replace").strip()
        if not done:
            self._drop(now_ns, DropReason.REFUSED, 1, what)
        outcome = "done" if done else DropReason.REFUSED.value
        self._events.handled(now_ns, what, outcome)
        due_ns = now_ns + self.device.delays.response_ns
        sent = channel.telegram(reply, 0, due_ns, self.device, label="CoLa", is_cola=True)
        channel.busy_until_ns = channel.last_sent_ns
        self._outbox.put(sent)

    def _reply(self, channel: Channel, request: Request, words: tuple[int, ...], answer: Answer, now_ns: int) -> None:
        sent = channel.telegram(
            payload_of(*words),
            request.route,
            now_ns + self.device.delays.response_ns,
            self.device,
            label=f"{words[0]:04X}",
            line_speed=answer.line_speed if channel.kind is LinkKind.SERIAL else None,
        )
        channel.busy_until_ns = channel.last_sent_ns
        self._outbox.put(sent)
        if answer.line_speed is not None:
            self._set_line_speed(channel.last_sent_ns, but=channel.line)
        self._put_routed(answer.routed, now_ns)
        if answer.boots_ns is not None:
            self._boot(now_ns, channel.last_sent_ns, answer.boots_ns)

    # profiles

    def _start(self, channel: Channel, profiles: Profiles, now_ns: int) -> str:
        """Give a host profiles from the next revolution on; a remark for the trace."""
        channel.profiles = profiles
        if wants_echoes(profiles.form) and self._revolutions.lacks_echoes():
            self._revolutions.rethink(now_ns)
        if self._geometry is None or channel.kind is not LinkKind.STREAM:
            return ""
        size = self._revolutions.layout(profiles.form, self._geometry).size
        return f" ({size} bytes, sicktoolbox has room for {SICKTOOLBOX_BYTES})" if size > SICKTOOLBOX_BYTES else ""

    def _stop(self, channel: Channel, now_ns: int) -> None:
        """End a host's profiles, and those on their way to it that have not begun."""
        channel.profiles = None
        address = channel.address
        gone = self._outbox.withdraw(lambda sent: sent.to == address and sent.is_scan and not sent.begun)
        for sent in gone:
            channel.withdrawn(sent)
        self._tell_withdrawn(now_ns, gone, address)

    def _tell_withdrawn(self, now_ns: int, gone: list[Outgoing], address: Address) -> None:
        for sweep in sorted(one.emissions[0].sweep or 0 for one in gone if one.is_scan and not one.begun):
            self._unsent(now_ns, DropReason.STALE, sweep, "on its way", address)

    def _unsent(
        self, now_ns: int, reason: DropReason, sweep: int, detail: str = "", address: Address | None = None
    ) -> None:
        """A revolution that a host does not get; of all hosts without `address`."""
        self._events.unsent(now_ns, reason, range(sweep, sweep + 1), detail, None, address)

    def _settle(self, now_ns: int) -> None:
        """After anything that may have changed mode or speed: end what can no longer be, answer who waited for it."""
        device = self.device
        if self._will_measure and device.rotation and not device.spin_up:
            self._will_measure = False
            device.measure()
        if device.geometry is not self._geometry:
            self._geometry = device.geometry
            for sweep in self._revolutions.begin():
                self._unsent(now_ns, DropReason.STALE, sweep)
            for channel in self._channels.values():
                self._stop(channel, now_ns)
            self._serve_listeners(now_ns)
        self._tell_mode(now_ns)
        if device.spin_up is None:
            for channel in list(self._channels.values()):
                if channel.waiting is not None:
                    (request, handler), channel.waiting = channel.waiting, None
                    words = words_of(request.payload)
                    self._answer(channel, request, handler(device, words[1:], now_ns), now_ns)

    def _serve_listeners(self, now_ns: int) -> None:
        """Where datagrams go by themselves, profiles go whenever there are any."""
        if self._geometry is None:
            return
        for address, channel in self._channels.items():
            if channel.kind is LinkKind.DATAGRAM and not address.peer and channel.profiles is None:
                self._start(channel, Profiles(self.device.settings.udp_format, None, now_ns, 0), now_ns)

    def _deliver(self, item: Measured, now_ns: int) -> None:
        """A revolution has ended: its profile goes to everybody who wants it."""
        geometry, rotation = self._geometry, self.device.rotation
        if geometry is None or rotation is None:
            self._unsent(now_ns, DropReason.STALE, item.sweep)
            return
        revolution = revolution_of(item, self.device, geometry, rotation, self.first_count)
        reported = self.clock.reported(item.start_ns, CLOCK_TICK_NS, 16)
        wanted = False
        for channel in self._channels.values():
            profiles = channel.profiles
            if profiles is None or item.start_ns < profiles.first_ns:
                continue
            wanted = True
            if channel.is_paced and channel.line.free_ns > now_ns:
                self._unsent(now_ns, DropReason.LINE_BUSY, item.sweep, "", channel.address)
                continue
            profiles.sent += 1
            payload = encode_profile(self._revolutions.layout(profiles.form, geometry), profiles.sent, revolution)
            sent = channel.telegram(
                payload, profiles.route, item.end_ns, self.device, sweep=item.sweep, label=f"{GET_PROFILE_REPLY:04X}"
            )
            sent.emissions[0] = replace(sent.emissions[0], reported=reported)
            self._outbox.put(sent)
            self._copy_to_monitor(channel, payload, item)
            if profiles.left is not None:
                profiles.left -= 1
                if not profiles.left:
                    channel.profiles = None
        if not wanted:  # measured ahead for a host that has gone, or has had enough
            self._unsent(now_ns, DropReason.STALE, item.sweep)

    def _copy_to_monitor(self, channel: Channel, payload: bytes, item: Measured) -> None:
        """The monitor gets what a host gets, when its line is free."""
        monitor = self.device.monitor if self.device.monitors_profiles else None
        watching = None if monitor is None else self._channels.get(monitor.address)
        if monitor is None or watching is None or watching is channel:
            return
        if watching.is_paced and watching.line.free_ns > item.end_ns:
            return
        label = f"{GET_PROFILE_REPLY:04X}"
        self._outbox.put(
            watching.telegram(payload, monitor.route, item.end_ns, self.device, sweep=item.sweep, label=label)
        )

    # time

    def _next_instant(self) -> int | None:
        """The next instant at which the device does something by itself, sending apart."""
        device = self.device
        if device.booted_ns is None or self._will_start_itself:
            return device.booted_ns
        instants = [device.next_deadline(), self._revolutions.next_end_ns()]
        for channel in self._channels.values():
            if channel.inbox and channel.waiting is None:
                instants.append(channel.busy_until_ns)
            instants.append(channel.half_until_ns())
        instants += [held.due_ns() for held in device.attached.values()]
        return earliest(instants)

    def _happen(self, now_ns: int) -> None:
        if self._will_start_itself:
            self._start_itself(now_ns)
            return
        if self.device.advance(now_ns):
            self._settle(now_ns)
        for held in list(self.device.attached.values()):
            if (due_ns := held.due_ns()) is not None and due_ns <= now_ns:
                self._tell_received(held, now_ns)
        for item in self._revolutions.ended(now_ns):
            self._deliver(item, now_ns)
        for channel in list(self._channels.values()):
            half_ns = channel.half_until_ns()
            if half_ns is not None and half_ns <= now_ns:
                self._take(channel, channel.expire(self.device), now_ns)
            self._work(channel, now_ns)

    # measuring and sending

    def next_plan(self) -> ScanPlan | None:
        wanting = [channel.profiles for channel in self._channels.values() if channel.profiles is not None]
        needs = [Need(profiles.first_ns, profiles.left, wants_echoes(profiles.form)) for profiles in wanting]
        plan = self._revolutions.plan(self.device, needs, self._now_ns)
        if self._revolutions.late:
            self._tell_late()
        return plan

    def _tell_late(self) -> None:
        """Revolutions that passed unmeasured, for each host that had asked for them by then."""
        late, self._revolutions.late = self._revolutions.late, range(0)
        geometry, rotation = self._geometry, self.device.rotation
        assert geometry is not None
        assert rotation is not None
        for channel in self._channels.values():
            if channel.profiles is not None:
                first = max(late.start, rotation.first_from(channel.profiles.first_ns, geometry.first))
                sweeps = range(rotation.first_sweep + first, rotation.first_sweep + late.stop)
                stream = self._revolutions.stream
                self._events.unsent(
                    self._now_ns, DropReason.LATE, sweeps, "not measured in time", stream, channel.address
                )

    def submit(self, scan: Scan) -> None:
        if all(channel.profiles is None for channel in self._channels.values()):
            raise ScanRefused("no host wants a profile any more")
        self._revolutions.submit(scan, self._geometry, self.device.model.max_range_m)

    def missed(self, plan: ScanPlan, now_ns: int) -> bool:
        self.advance(now_ns)
        self._revolutions.give_up(plan)
        return True

    def fail_motor(self, now_ns: int, motor: Motor) -> None:
        """Impair the motor (reported in the status), stop it (state ERROR), or restore it (OK)."""
        self.advance(now_ns)
        self.device.fail_motor(now_ns, motor)
        self._settle(now_ns)

    def impair(self, now_ns: int, what: str, degree: float) -> bool:
        """The motor of the head."""
        self.advance(now_ns)
        if what == "motor speed":
            self.device.turn_at(now_ns, degree)
            self._revolutions.rethink(now_ns)
        elif what == "motor status":
            self.device.find_motor(Motor.TOO_FAST if degree > 0 else Motor.TOO_SLOW if degree < 0 else Motor.OK)
        elif what == "motor stopped":
            self.device.found = Motor.STOPPED if degree else Motor.OK
            self.fail_motor(now_ns, self.device.found)
        else:
            return False
        return True

    # events

    def _drop(self, now_ns: int, reason: DropReason, number: int, detail: str = "") -> None:
        self._events.drop(now_ns, reason, detail, number)

    def _tell_mode(self, now_ns: int) -> None:
        device = self.device
        mode = "booting" if device.is_booting(now_ns) else "spinning up" if device.spin_up else device.mode.name.lower()
        if mode != self._reported_mode:
            self._reported_mode = mode
            self._events.mode(now_ns, mode)
