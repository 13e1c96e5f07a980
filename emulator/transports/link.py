"""The contract of a link: bytes and times, nothing else.

Input comes with the connection it came on. Output is handed over with the instant its first byte is due and leaves at
the pace of the line: each byte takes ten bit times after the later of `due_ns` and the end of what was queued before,
whenever `flush` is called (late calls catch up, they never shift the schedule).
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field

from emulator.transports.turns import Turn
from protocols.session import LinkKind

LATENESS_KEPT = 65_536
"Figures of lateness a link keeps when nobody drains them."


@dataclass(frozen=True)
class Received:
    """Something that came in on a link."""

    peer: int
    "Number of the connection, remote port, or CAN identifier (bit 31: extended)."
    data: bytes = b""
    opened: bool = False
    "A stream's host has connected."
    closed: bool = False
    "A stream's host has gone."
    host: tuple[str, int] | None = field(default=None, compare=False)
    "With `opened`: address and port of the host, where the link knows it."
    lines: tuple[bool, bool] | None = None
    "DTR and RTS of a serial line have changed to this; the device sees them where it has such inputs."
    foreign: tuple[int, bytes] | None = None
    "Speed of a host that is not the line's, and what it sent; `data` is what the device's receiver makes of that."


@dataclass(frozen=True)
class LinkIncident:
    """Something that somebody else did to a link's place in the file system."""

    kind: str
    "Of `emulator.process.incidents.KINDS`."
    text: str


@dataclass
class LinkStats:
    """Counters of a link since it was opened."""

    bytes_in: int = 0
    bytes_out: int = 0
    "Bytes handed to the operating system."
    bytes_lost: int = 0
    "Bytes that left on the line and that nobody read: no host, or a host that does not read."
    payloads_dropped: int = 0
    "Whole payloads given up before their first byte left, because a host reads too slowly."
    bytes_garbled: int = 0
    "Bytes sent or received while host and device were set to different line speeds."
    hosts_refused: int = 0
    "Connections turned away, or closed while silent, because all places were taken."
    lateness_ns: deque[int] = field(default_factory=lambda: deque(maxlen=LATENESS_KEPT))
    """Actual minus scheduled instant at which each payload had wholly left (unpaced: was handed over); never negative.
    The daemon drains it. The last byte, because the first ones of a paced payload wait for their group on purpose."""
    departures: deque[tuple[int, int]] | None = None
    "Scheduled and actual instant of the same, while somebody records them; the daemon drains it. None: nobody does."

    def note_left(self, due_ns: int, now_ns: int) -> None:
        """A payload that should have left by `due_ns` has left by `now_ns`."""
        self.lateness_ns.append(max(0, now_ns - due_ns))
        if self.departures is not None:
            self.departures.append((due_ns, max(due_ns, now_ns)))


class Link(ABC):
    """One outlet of a sensor. Never blocks; a host's behaviour never raises.

    Only `receive` may raise, `LinkError`, once, when what carries the link is gone for good (an adapter pulled out).
    """

    kind: LinkKind
    hold = False
    """Under a virtual clock: what a host has no room for is kept instead of lost. Time waits for `held` to go down."""
    reports_input = False
    "`flush` wants to be called at once, or when it comes, where `receive` has something: it need not be asked too."

    def __init__(self) -> None:
        self.stats = LinkStats()
        self.on_given_up: Callable[[bytes], None] = lambda payload: None
        "Informed of each payload that `send` has taken and that is given up whole after all: no host gets it."

    def tell_undelivered(self, to: Callable[[bool], None]) -> None:
        """Inform of datagrams that met a closed port (True), or could not be sent; other links know of none."""

    @property
    @abstractmethod
    def url(self) -> str:
        """What a host needs to connect, with the real path or port."""

    @abstractmethod
    def filenos(self) -> tuple[int, ...]:
        """Descriptors that become readable when `receive` has something; may change from call to call."""

    @abstractmethod
    def receive(self, now_ns: int) -> list[Received]:
        """Everything that came in, in order."""

    @abstractmethod
    def send(self, payload: bytes, due_ns: int, peer: int | None = None, line_speed: int | None = None) -> None:
        """Queue a payload for `peer` (None: all). `line_speed`: the speed of the line once it has left."""

    def send_to(self, payload: bytes, due_ns: int, place: tuple[str, int]) -> None:
        """Queue a datagram for an address and port; links without addresses send it where they always do."""
        self.send(payload, due_ns)

    @property
    def place(self) -> tuple[str, int] | None:
        """Address and port that datagrams are sent to; None: it has none."""
        return None

    def hang_up(self, due_ns: int, peer: int | None = None) -> None:
        """End a connection (None: all) behind what was queued for it; links without connections know of none."""

    def cut(self, now_ns: int) -> None:
        """End what is leaving on a line with the byte that is on its way."""

    @abstractmethod
    def flush(self, now_ns: int) -> int | None:
        """Move what is due by `now_ns`; when to be called again, None when nothing is queued."""

    def set_speed(self, baud: int | None) -> None:
        """Set the line's speed at once (power-on); None: not paced. Links without a speed ignore it."""

    @property
    def speed(self) -> int | None:
        """Baud of the line now; None: it has no speed, or is not paced."""
        return None

    @property
    def turn(self) -> Turn | None:
        """Limits what its hosts cost, where that can be much though no sensor hears them; else None."""
        return None

    @property
    def path(self) -> str | None:
        """The path in the file system by which hosts find it, and which others might take away; None: there is none."""
        return None

    def tend(self, now_ns: int) -> list[LinkIncident]:
        """Look whether that path still leads here and put it back; incidents since then.

        `now_ns`: of a clock that never stands. Called when the path's folder has changed, and once a second.
        """
        return []

    # for faults; links that know no such thing leave it as it is. What is done twice must be undone twice

    def unplug(self) -> None:
        """Pull the plug: what connects hosts is gone, path and port too, until `plug`. Input and output go nowhere."""

    def plug(self) -> None:
        """Put it in again: hosts find the link where it was. `LinkError` when the place has been taken meanwhile."""

    def reset_hosts(self) -> int:
        """Hang up on all hosts at once, as by a reset; how many it were."""
        return 0

    def refuse_hosts(self, refuse: bool) -> None:
        """Let nobody connect any more, or again."""

    def abandon_hosts(self) -> int:
        """The device's own network stack has died: connections stay open on the hosts' side and say nothing, nobody can
        connect; until `revive`. How many connections it were."""
        return 0

    def revive(self) -> None:
        """The stack is there again and knows nothing of what was: what a host sends on an old connection is answered by
        a reset."""

    def clear(self) -> int:
        """Forget what has not left yet (power cut); how many bytes those were."""
        return 0

    def held(self) -> int:
        """Bytes handed over that hosts have not read, as far as that can be known."""
        return 0

    def has_host(self) -> bool:
        """Whether a host is there; True where that cannot be known."""
        return True

    @abstractmethod
    def close(self) -> None:
        """Release everything, remove what was made in the file system. May be called twice."""
