"""One conversation with one host: how its bytes become messages, how ours become emissions, and when the line is free.

A channel is a TCP connection, a serial line, a sender of datagrams, or a host's identifier on CAN. Lines are modelled
here only as far as the device itself must know them: a profile that finds its line busy is dropped as a whole.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass, field

from protocols.ld import config as cfg
from protocols.ld.answers import Handler
from protocols.ld.cola import ColaSplitter
from protocols.ld.device import Device
from protocols.ld.head import MS
from protocols.ld.packages import NAK, Package, PackageJoiner, PackageReader, encode_packages, swapped
from protocols.ld.segments import SegmentJoiner, encode_segments, worst_case_bits
from protocols.ld.usp import UspReader, encode_frame
from protocols.session import Address, DropReason, Emission, LinkKind
from protocols.skeleton.cola_frames import frame
from protocols.skeleton.cola_values import BINARY
from protocols.skeleton.outbox import Outgoing
from protocols.skeleton.receiving import Fault
from protocols.skeleton.serial_lines import line_ns

INTER_BYTE_NS = 1000 * MS
"Inter-byte time-out of an incomplete request. Chosen here: no source has the device's value."

MAX_INBOX = 64
"Requests of one host that wait for their turn; further ones are dropped."

"Of a byte: parity, stop and data bits of item 0001 are stored, the line stays at 8N1 (UPS p. 19)."

GAP_NS = 1 * MS
"Between two telegrams on one channel: sicktoolbox holds one, and looks every millisecond."
PROFILE_GAP_NS = 5 * MS
"From a reply to a profile, which would overwrite it in sicktoolbox."


@dataclass(frozen=True)
class Request:
    """One message of a host."""

    payload: bytes
    route: int
    "What its reply needs beside the channel: address word of the package (serial), ID word (CAN)."
    is_cola: bool = False
    "The payload of a CoLa frame, and its reply is one too."


@dataclass
class Profiles:
    """Profiles that a host has asked for."""

    form: int
    left: int | None
    "None: until cancelled."
    first_ns: int
    "Only revolutions that begin at or after this instant count."
    route: int
    sent: int = 0


@dataclass
class Line:
    """One link of the sensor, shared by all channels on it."""

    kind: LinkKind
    free_ns: int = 0
    "When what was sent so far has left."


@dataclass(eq=False)
class Channel:
    """One host."""

    address: Address
    line: Line
    reader: UspReader | PackageReader | None = None
    joiner: PackageJoiner | SegmentJoiner | None = None
    inbox: deque[Request] = field(default_factory=deque)
    profiles: Profiles | None = None
    busy_until_ns: int = 0
    "Until its last reply has left, the next request waits."
    waiting: tuple[Request, Handler] | None = None
    "A request that is answered when the head is at speed."
    cola: ColaSplitter = field(default_factory=ColaSplitter)
    heard_ns: int = 0
    "When the last byte of a half request came."
    last_reply_ns: int = -PROFILE_GAP_NS
    last_sent_ns: int = -PROFILE_GAP_NS

    @property
    def kind(self) -> LinkKind:
        return self.line.kind

    @property
    def is_paced(self) -> bool:
        """Whether its line takes its time."""
        return self.kind in (LinkKind.SERIAL, LinkKind.CAN)

    def clear(self) -> None:
        """Discard all but the connection itself, as at a restart."""
        self.reader, self.joiner = _readers(self.kind)
        self.cola = ColaSplitter()
        self.inbox.clear()
        self.profiles = self.waiting = None
        self.busy_until_ns = 0

    # from the host

    def read(self, data: bytes, now_ns: int, device: Device) -> list[Request | Fault]:
        """Requests and faults in what has come."""
        if isinstance(self.joiner, SegmentJoiner):
            item = self.joiner.add(data)
            self.heard_ns = now_ns
            return [] if item is None else [self._from_can(item, device)]
        if self.reader is None:
            return []
        frames: list[bytes] = []
        if device.model.speaks_cola:
            data, frames = self.cola.feed(data)
        found = self._understood(self.reader.feed(data), device)
        found += [Request(payload, 0, is_cola=True) for payload in frames]
        if self.reader or self.cola:
            self.heard_ns = now_ns
        return found

    def half_until_ns(self) -> int | None:
        """When a half request is given up; None when there is none."""
        held = self.joiner if isinstance(self.joiner, SegmentJoiner) else self.reader
        return self.heard_ns + INTER_BYTE_NS if held or self.cola else None

    def expire(self, device: Device) -> list[Request | Fault]:
        """Give up a half request."""
        if isinstance(self.joiner, SegmentJoiner):
            return [*self.joiner.expire()]
        if self.reader is None:
            return []
        found = self._understood(self.reader.feed(self.cola.expire()), device)
        return found + self._understood(self.reader.expire(), device)

    def _understood(self, items: Iterable[bytes | Package | Fault], device: Device) -> list[Request | Fault]:
        found: list[Request | Fault] = []
        for item in items:
            if isinstance(item, bytes):
                found.append(Request(item, 0))
            elif isinstance(item, Package):
                found.extend(self._from_package(item, device))
            else:
                found.append(item)
        return found

    def _from_package(self, package: Package, device: Device) -> list[Request | Fault]:
        if package.address & 0xFF != device.sensor_id:
            return [Fault(DropReason.OTHER_ADDRESS, len(package.body), f"address {package.address:04X}")]
        if not isinstance(self.joiner, PackageJoiner):
            return []
        message = self.joiner.add(package)
        if message is None:
            return []
        return [message if isinstance(message, Fault) else Request(message, swapped(package.address))]

    def _from_can(self, item: tuple[int, bytes] | Fault, device: Device) -> Request | Fault:
        if isinstance(item, Fault):
            return item
        identity, payload = item
        if identity != device.sensor_id:
            return Fault(DropReason.OTHER_ADDRESS, len(payload), f"ID {identity:04X}")
        # The host's ID word in a reply: its identifier cut to the mask, 3 in Fawkes (inferred)
        return Request(payload, self.address.peer & device.config[cfg.CAN][2])

    # to the host

    def telegram(
        self,
        payload: bytes,
        route: int,
        due_ns: int,
        device: Device,
        *,
        sweep: int | None = None,
        label: str = "",
        line_speed: int | None = None,
        is_cola: bool = False,
    ) -> Outgoing:
        """Frame a message and give it its place on the line, not before `due_ns`."""
        is_profile = sweep is not None
        earliest_ns = self.last_reply_ns + PROFILE_GAP_NS if is_profile else self.last_sent_ns + GAP_NS
        due_ns = max(due_ns, earliest_ns)
        before_ns = self.line.free_ns
        if self.kind is LinkKind.CAN:
            emissions = self._can_frames(payload, route, due_ns, device, sweep, label)
        else:
            if self.kind is LinkKind.SERIAL:
                data = frame(BINARY, payload) if is_cola else encode_packages(payload, route)
                due_ns = max(due_ns, before_ns)
                self.line.free_ns = due_ns + line_ns(len(data), device.baud)
            else:
                data = frame(BINARY, payload) if is_cola else encode_frame(payload)
            emissions = deque([Emission(due_ns, data, self.address, sweep, line_speed, label)])
        self.last_sent_ns = self.line.free_ns if self.is_paced else due_ns
        if not is_profile:
            self.last_reply_ns = self.last_sent_ns
        return Outgoing(self.address, emissions, is_profile, before_ns, self.line.free_ns)

    def withdrawn(self, sent: Outgoing) -> None:
        """The line is as if a telegram that had not begun had never been."""
        if self.is_paced and self.line.free_ns == sent.free_after_ns:
            self.line.free_ns = sent.free_before_ns
        self.last_sent_ns = max(self.last_reply_ns, self.line.free_ns if self.is_paced else 0)

    def nak(self, now_ns: int, device: Device) -> Outgoing:
        """The single byte that answers a package which cannot be accepted."""
        due_ns = max(now_ns + device.delays.response_ns, self.line.free_ns)
        before_ns, self.line.free_ns = self.line.free_ns, due_ns + line_ns(1, device.baud)
        self.last_sent_ns = self.last_reply_ns = self.line.free_ns
        emission = Emission(due_ns, bytes((NAK,)), self.address, label="NAK")
        return Outgoing(self.address, deque([emission]), False, before_ns, self.line.free_ns)

    def _can_frames(
        self, payload: bytes, route: int, due_ns: int, device: Device, sweep: int | None, label: str
    ) -> deque[Emission]:
        rate = device.can_bitrate
        to = Address(self.address.link, device.config[cfg.CAN][3] + device.sensor_id)
        start_ns = max(due_ns, self.line.free_ns)
        frames: deque[Emission] = deque()
        bits = 0
        for data in encode_segments(payload, route):
            first = sweep if not frames else None  # a profile is counted once
            scans = int(sweep is None or not frames)
            frames.append(Emission(start_ns + bits * 1_000_000_000 // rate, data, to, first, None, label, scans=scans))
            bits += worst_case_bits(len(data))
        self.line.free_ns = start_ns + bits * 1_000_000_000 // rate
        return frames


def _readers(kind: LinkKind) -> tuple[UspReader | PackageReader | None, PackageJoiner | SegmentJoiner | None]:
    if kind is LinkKind.SERIAL:
        return PackageReader(), PackageJoiner()
    return (None, SegmentJoiner()) if kind is LinkKind.CAN else (UspReader(), None)


def new_channel(address: Address, line: Line) -> Channel:
    """A channel without input so far."""
    reader, joiner = _readers(line.kind)
    return Channel(address, line, reader, joiner)
