"""The contract of a device's conversation: bytes and times in, bytes and times out.

A session owns no clock, no port and no randomness. It is asked, never ticks: feed `receive`, call `advance` at
`next_deadline`, measure `next_plan`, hand the scan to `submit`, send what `take_emissions` gives when it is due.
Times are integer nanoseconds since the run began.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum
from fractions import Fraction
from typing import Any, NamedTuple, Protocol

from protocols.device_clock import DeviceClock, Told
from protocols.scan import Scan, ScanPlan

MAX_EVENTS = 10_000
"Events that a session keeps for a caller that never takes them; the oldest go first."


class Address(NamedTuple):
    """Whom bytes came from or go to."""

    link: int
    "Index into the sensor's list of links."
    peer: int
    "Number of the connection on a stream, remote port of a datagram, identifier of a CAN frame (bit 31: extended)."


class LinkKind(Enum):
    """How a link carries a telegram; a family may frame differently on each."""

    SERIAL = "serial"
    "A line with a speed and no connections: pty, serial port, a serial device server's TCP port, loop."
    STREAM = "stream"
    "TCP connections."
    DATAGRAM = "datagram"
    CAN = "can"


@dataclass(frozen=True)
class Emission:
    """Bytes that leave together: one telegram, one datagram, one CAN frame, one ACK."""

    due_ns: int
    "When the first byte should leave."
    payload: bytes
    address: Address | None = None
    "None: every link of the sensor."
    sweep: int | None = None
    "Sweep whose scan it carries (its first one); None for a reply."
    line_speed: int | None = None
    "The line changes to this many baud as soon as the last bit of this payload has left."
    label: str = ""
    "What it is, for traces: `B0`, `ACK`, `A0`."
    told: Told | None = None
    "What it tells of the device's time, of the first telegram of a scan; for recordings and reports."
    scans: int = 1
    "Scans that it carries, numbered from `sweep` on: of a mean all that it was made of; 0: the rest of one begun."
    pause: tuple[int, int] | None = None
    "So many bytes leave first, the others not before that instant; serial lines only."
    cuts: bool = False
    "What is leaving on the line ends with the byte that is on its way at `due_ns`; the payload is empty."


class DropReason(Enum):
    """Why something that arrived, or was measured, went no further."""

    NO_START_BYTE = "no start byte"
    BAD_CHECKSUM = "bad checksum"
    BAD_LENGTH = "bad length"
    OVERLONG = "overlong"
    TIMEOUT = "inter-byte time-out"
    OTHER_ADDRESS = "for another address"
    UNKNOWN_COMMAND = "unknown command"
    WRONG_MODE = "not allowed in this mode"
    BAD_ARGUMENT = "bad argument"
    REFUSED = "known command that no source settles; refused"
    BOOTING = "device is starting"
    BUSY = "device busy with earlier requests"
    KEPT = "measured, nothing of it to be sent"
    "For the device itself, or without an object where only objects are told."
    LINE_BUSY = "line slower than the scan rate"
    LATE = "measured too late"
    "Our own doing: the scan before it was not measured in time, or the program did not run."
    STALE = "withdrawn by a changed setting"
    HOST_SLOW = "host reads too slowly"

    @property
    def of_scans(self) -> bool:
        """Whether scans went no further, not input of a host."""
        kinds = (DropReason.LINE_BUSY, DropReason.LATE, DropReason.STALE, DropReason.HOST_SLOW, DropReason.KEPT)
        return self in kinds


@dataclass(frozen=True)
class Dropped:
    """Bytes or a scan that went no further."""

    at_ns: int
    reason: DropReason
    detail: str = ""
    count: int = 1
    "Bytes of input, or scans, or frames: whatever was dropped."
    sweeps: range | None = None
    "Numbers of the scans, by which an account of them is kept; None: the oldest that are missing."
    stream: int | None = None
    "Stream of those numbers (`ScanPlan.stream`); None: the newest that has them."
    address: Address | None = None
    "For whom they were, where hosts are told apart and others may have got them; None: everybody."


def dropped_scans(
    at_ns: int,
    reason: DropReason,
    sweeps: range,
    detail: str = "",
    stream: int | None = None,
    address: Address | None = None,
) -> list[Dropped]:
    """What a session tells of scans that hosts do not get, by their numbers; nothing when there are none."""
    return [Dropped(at_ns, reason, detail, len(sweeps), sweeps, stream, address)] if sweeps else []


@dataclass(frozen=True)
class CutShort:
    """A request ended a telegram that was being sent."""

    at_ns: int
    label: str
    left: int
    "Bytes of it that have left, the last of them still on its way."
    of: int


@dataclass(frozen=True)
class CommandHandled:
    """A host's command was understood and answered."""

    at_ns: int
    command: str
    outcome: str
    "`done` or the name of the refusal."


@dataclass(frozen=True)
class ModeChanged:
    """The device entered another mode."""

    at_ns: int
    mode: str


@dataclass(frozen=True)
class Restarted:
    """The device reset itself or was switched on; its sweep counter begins again."""

    at_ns: int


Event = Dropped | CutShort | CommandHandled | ModeChanged | Restarted


class Session(ABC):
    """One device talking to its hosts."""

    can_bitrate: int | None = None
    "Speed at which the device was set up for its CAN bus, in bit/s; None: it has none."
    clock: DeviceClock = DeviceClock()
    "The time that the device tells. Begins at power-on; another one may be put in its place at any instant."
    clock_tick_ns: Fraction | None = None
    "Step of the time that the wire tells; None: it tells none."
    clock_bits: int = 0
    "Width of that time within the device; on the wire it may be less."
    first_count: int = 0
    "Where the device's counter of scans or telegrams begins at power-on."
    count_bits: int = 0
    "Width of that counter; 0: the wire has none."

    @abstractmethod
    def power_on(self, now_ns: int) -> None:
        """Switch the device on (again): volatile settings are lost, boot time and boot text follow."""

    def connected(self, now_ns: int, address: Address, kind: LinkKind) -> None:
        """A link is there (serial, CAN, datagram: once, at start) or a stream's host has connected."""

    def disconnected(self, now_ns: int, address: Address) -> None:
        """A stream's host has gone."""

    @abstractmethod
    def receive(self, data: bytes, now_ns: int, address: Address | None = None) -> None:
        """Bytes of a host, in any chunking. Never raises, whatever they are."""

    def modem_lines(self, dtr: bool, rts: bool, now_ns: int, address: Address) -> None:
        """A host has set DTR and RTS of a serial line; a device without such inputs, as all here, does not see it."""

    @abstractmethod
    def advance(self, now_ns: int) -> None:
        """Let time-outs, warm-up and modes that end by themselves take effect up to `now_ns`."""

    @abstractmethod
    def next_deadline(self) -> int | None:
        """When `advance` or `take_emissions` has something to do even without input; None: never."""

    @abstractmethod
    def next_plan(self) -> ScanPlan | None:
        """The sweep wanted next, the same until submitted or withdrawn; None: nothing to measure now."""

    @abstractmethod
    def submit(self, scan: Scan) -> None:
        """Take the sweep of `next_plan`. Raises `ScanRefused` when the settings have changed since."""

    def missed(self, plan: ScanPlan, now_ns: int) -> bool:
        """The sweep of `next_plan` was asked for and will not be measured: whoever measures could not in time.

        Whether what is wanted next has been chosen anew by `now_ns`, sweeps passed over told as `DropReason.LATE`;
        False: the device knows no other, and wants that one still. Raises `ScanRefused` when it wants it no more.
        """
        return False

    @abstractmethod
    def take_emissions(self, now_ns: int) -> list[Emission]:
        """What is due by `now_ns`, in the order it leaves. What is not yet due can still be withdrawn."""

    def impair(self, now_ns: int, what: str, degree: float) -> bool:
        """Something has befallen the device; whether it has that part, or words for it.

        `window`: its front window passes that share of light. `motor speed`: times the nominal one. `motor told`: its
        supervision finds the motor right (0), too fast (1) or too slow (-1). `motor stopped`: (1), or turns again (0).
        """
        return False

    @abstractmethod
    def take_events(self) -> list[Event]:
        """What happened since the last call."""


@dataclass(frozen=True)
class CommandRow:
    """One line of a family's coverage table, derived from the table that dispatches its commands."""

    code: str
    name: str
    status: str
    "`done`, `refused` (named, answered as the device refuses) or `absent`."
    source: str
    note: str = ""


@dataclass(frozen=True)
class DeviceKey:
    """One key of a scenario's `device:` table, as `lidaremu list device MODEL` shows it."""

    name: str
    allowed: str
    default: str
    meaning: str


class Family(Protocol):
    """What a module of `protocols` offers as `FAMILY`."""

    @property
    def name(self) -> str: ...

    @property
    def tcp_is_line(self) -> bool:
        """Whether a TCP link is a serial line behind a device server (paced, no connections), or the device's own."""

    def new_session(self, device: Mapping[str, Any], facts: Mapping[str, Any]) -> Session:
        """A session of one device, switched off.

        `device` is the scenario's table of what a real one keeps over power-off, `facts` the spec's `device` table
        of the model. Raises `DeviceSettingError` for a key or value that this model does not have.
        """

    def commands(self) -> tuple[CommandRow, ...]:
        """The coverage table."""
