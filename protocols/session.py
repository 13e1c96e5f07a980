"""The contract of a session, the protocol side of one device: bytes and times in, bytes and times out.

A session has no clock, no port and no random numbers. The caller drives it: feed `receive`, call `advance` at
`next_deadline`, measure `next_plan`, pass the scan to `submit`, send what `take_emissions` returns.
Times are integer nanoseconds since the run began.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import Enum
from fractions import Fraction
from typing import Any, NamedTuple, Protocol

from protocols.device_clock import DeviceClock, DeviceStamp
from protocols.scan import Floats, Scan, ScanPlan

MAX_EVENTS = 10_000
"Events that a session keeps for a caller that never takes them; the oldest are discarded first."


class Address(NamedTuple):
    """The host that bytes come from or go to."""

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


@dataclass(frozen=True, init=False)
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
    reported: DeviceStamp | None = None
    "Time stamp in the first telegram of a scan; for recordings and reports."
    scans: int = 1
    "Scans that it carries, numbered from `sweep` on; of a mean all its scans; 0: a further part of a scan."
    pause: tuple[int, int] | None = None
    "Number of bytes to send first, and the earliest instant of the others; serial lines only."
    cuts: bool = False
    "The telegram being sent on the line ends with the byte in transmission at `due_ns`; the payload is empty."
    place: tuple[str, int] | None = None
    "Datagrams: sent to this address and port; None: where the link says."
    hangs_up: bool = False
    "Streams: the device ends the connection behind these bytes."

    def __init__(
        self,
        due_ns: int,
        payload: bytes,
        address: Address | None = None,
        sweep: int | None = None,
        line_speed: int | None = None,
        label: str = "",
        reported: DeviceStamp | None = None,
        scans: int = 1,
        pause: tuple[int, int] | None = None,
        cuts: bool = False,
        place: tuple[str, int] | None = None,
        hangs_up: bool = False,
    ) -> None:
        # of each packet; what the decorator makes for a frozen class takes three times as long
        self.__dict__.update(
            due_ns=due_ns, payload=payload, address=address, sweep=sweep, line_speed=line_speed, label=label,
            reported=reported, scans=scans, pause=pause, cuts=cuts, place=place, hangs_up=hangs_up,
        )  # fmt: skip


class DropReason(Enum):
    """Why input or a scan was dropped."""

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
    "For the device itself, or without an object where only objects are reported."
    LINE_BUSY = "line slower than the scan rate"
    LATE = "measured too late"
    "Caused by the emulator: the previous scan was not measured in time, or the process did not run."
    STALE = "withdrawn by a changed setting"
    HOST_SLOW = "host reads too slowly"

    @property
    def of_scans(self) -> bool:
        """Whether scans were dropped, not input of a host."""
        kinds = (DropReason.LINE_BUSY, DropReason.LATE, DropReason.STALE, DropReason.HOST_SLOW, DropReason.KEPT)
        return self in kinds


@dataclass(frozen=True)
class Dropped:
    """Input or scans that were dropped."""

    at_ns: int
    reason: DropReason
    detail: str = ""
    count: int = 1
    "Number of bytes of input, scans or frames."
    sweeps: range | None = None
    "Numbers of the scans, for the scan accounting; None: the oldest missing ones."
    stream: int | None = None
    "Stream of those numbers (`ScanPlan.stream`); None: the newest that has them."
    address: Address | None = None
    "The host that did not get them, if hosts are distinguished; None: no host got them."


def dropped_scans(
    at_ns: int,
    reason: DropReason,
    sweeps: range,
    detail: str = "",
    stream: int | None = None,
    address: Address | None = None,
) -> list[Dropped]:
    """The event for scans that hosts do not get, by their numbers; empty for an empty range."""
    return [Dropped(at_ns, reason, detail, len(sweeps), sweeps, stream, address)] if sweeps else []


@dataclass(frozen=True)
class CutShort:
    """A request ended a telegram that was being sent."""

    at_ns: int
    label: str
    left: int
    "Bytes that were sent, including the one in transmission."
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


@dataclass(frozen=True)
class Announcement:
    """What a device announces by mDNS of its TCP link."""

    kind: str
    "Type of the service: `_name._tcp`."
    name: str
    host: str
    "Without `.local`."
    port: int
    text: Mapping[str, str]
    "TXT record."


class Session(ABC):
    """The protocol side of one device."""

    announced: Announcement | None = None
    "What it announces by mDNS; None: nothing."

    can_bitrate: int | None = None
    "Speed at which the device was set up for its CAN bus, in bit/s; None: it has none."
    clock: DeviceClock = DeviceClock()
    "The device's clock. Starts at power-on; may be replaced at any instant."
    clock_tick_ns: Fraction | None = None
    "Resolution of time stamps on the wire; None: there are none."
    clock_bits: int = 0
    "Width of that time within the device; on the wire it may be less."
    first_count: int = 0
    "Where the device's counter of scans or telegrams begins at power-on."
    count_bits: int = 0
    "Width of that counter; 0: the wire has none."
    minds_delivery: bool = False
    "Whether `undelivered` means something to it."
    restart_hangs_up: bool = False
    "Whether its TCP connections end when it restarts at a host's request."

    @abstractmethod
    def power_on(self, now_ns: int) -> None:
        """Switch the device on (again): volatile settings are lost, boot time and boot text follow."""

    def connected(self, now_ns: int, address: Address, kind: LinkKind) -> None:
        """A link is open (serial, CAN, datagram: once, at start) or a TCP client has connected."""

    def disconnected(self, now_ns: int, address: Address) -> None:
        """A TCP client has disconnected."""

    def placed(self, address: Address, host: str, port: int) -> None:
        """Before `connected`: where a datagram link sends, or from where a TCP client connects; not by all links."""

    def undelivered(self, now_ns: int, address: Address, refused: bool) -> None:
        """A datagram of a link has met a closed port (`refused`), or could not be sent; real links alone tell it."""

    def feel(self, motion: Callable[[int], tuple[Floats, Floats]]) -> None:
        """For devices with an inertial unit: specific force and rate (3,) in the sensor's frame at an instant.
        [m/s^2, rad/s]"""

    def keep_time(self, true_ns: Callable[[int], int], own_ns: Callable[[int], int]) -> None:
        """It has a quartz of its own from now on: from its instants to the run's, and back; for what it hears of true
        time, as the pulses of a GPS."""

    @abstractmethod
    def receive(self, data: bytes, now_ns: int, address: Address | None = None) -> None:
        """Bytes of a host, in any chunking. Never raises, whatever they are."""

    def modem_lines(self, dtr: bool, rts: bool, now_ns: int, address: Address) -> None:
        """A host has set DTR and RTS of a serial line; ignored by devices without such inputs."""

    def other_speed(self, baud: int, sent: bytes, now_ns: int, address: Address) -> None:
        """A host sent these bytes at another speed than the line's; `receive` has had what became of them.

        For devices that measure a host's speed, or give up a line with framing errors; ignored by all others.
        """

    @abstractmethod
    def advance(self, now_ns: int) -> None:
        """Let time-outs, warm-up and modes that end by themselves take effect up to `now_ns`."""

    @abstractmethod
    def next_deadline(self) -> int | None:
        """When `advance` or `take_emissions` must be called even without input; None: never."""

    @abstractmethod
    def next_plan(self) -> ScanPlan | None:
        """The next sweep to measure, the same until submitted or withdrawn; None: nothing to measure now."""

    @abstractmethod
    def submit(self, scan: Scan) -> None:
        """Take the sweep of `next_plan`. Raises `ScanRefused` when the settings have changed since."""

    def plan_after(self, plan: ScanPlan) -> ScanPlan | None:
        """The sweep that will be wanted after that one if nothing changes; None: not foreseen.

        Changes nothing. It may be measured beside the one before, and holds once `next_plan` is the same sweep.
        """
        return None

    def begun(self, plan: ScanPlan) -> None:
        """A sweep of `plan_after` is being measured: it is not skipped for being late, as the one of `next_plan`."""

    def missed(self, plan: ScanPlan, now_ns: int) -> bool:
        """The sweep of `next_plan` will not be measured: it is too late for it.

        True: the session has chosen another sweep and reported the skipped ones as `DropReason.LATE`. False: there is
        no other, and it still wants this one. Raises `ScanRefused` if it does not want it any more.
        """
        return False

    @abstractmethod
    def take_emissions(self, now_ns: int) -> list[Emission]:
        """What is due by `now_ns`, in the order it leaves. What is not yet due can still be withdrawn."""

    def impair(self, now_ns: int, what: str, degree: float) -> bool:
        """Impair a part of the device; whether it has that part, or reports it.

        `window`: transmission of its front window. `motor speed`: factor on the nominal speed. `motor status`: its
        monitoring reports the motor right (0), too fast (1) or too slow (-1). `motor stopped`: (1), or turns again (0).
        `busy`: it refuses every request (1). `login`: it refuses every login (1).
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

        `device` is the scenario's table of the settings that a real one retains over power cycles, `facts` the `device`
        table of the model's spec. Raises `DeviceSettingError` for a key or value that this model does not have.
        """

    def commands(self) -> tuple[CommandRow, ...]:
        """The coverage table."""
