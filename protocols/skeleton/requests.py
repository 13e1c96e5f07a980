"""A device with a command table: requests in, replies in the same order, scans to subscribers.

Belongs here: the path from bytes to a row of the table and back. Not: the action of a row, and the framing of a reply.
"""

from __future__ import annotations

from abc import abstractmethod
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from fractions import Fraction
from typing import Any, ClassVar

from protocols.session import Address, CommandRow, DropReason, Emission, LinkKind
from protocols.skeleton.instants import earliest
from protocols.skeleton.receiving import Connections, Fault, Receiver, Splitter
from protocols.skeleton.sweeps import SweepSession

MAX_WAITING = 64
"Queued replies of one host; further requests are dropped."


@dataclass(frozen=True)
class Request:
    """One request, the argument of a row's method."""

    code: bytes
    data: bytes
    now_ns: int
    address: Address | None


@dataclass(frozen=True)
class Answer:
    """The reply of a row with further effects."""

    payload: bytes | None
    "None: no reply."
    line_speed: int | None = None
    "New speed of the line after the reply."
    restarts: bool = False
    "The device restarts when the reply begins."


@dataclass(frozen=True)
class Refused:
    """A request that the device refuses."""

    reason: DropReason
    detail: str = ""


@dataclass(frozen=True)
class Command:
    """One row of the command table and of the coverage table."""

    name: str
    act: Callable[[Any, Request], bytes | Answer | Refused] | None
    "(session, request); None: known and refused."
    source: str
    note: str = ""


def coverage(commands: Mapping[bytes, Command]) -> tuple[CommandRow, ...]:
    """The coverage table, made from the command table."""
    return tuple(
        CommandRow(
            code.decode() if code.isascii() and code.decode().isprintable() else code.hex(" ").upper(),
            row.name,
            "refused" if row.act is None else "done",
            row.source,
            row.note,
        )
        for code, row in commands.items()
    )


@dataclass(eq=False)
class Host:
    """One connection: its receiver and its queued replies."""

    receiver: Receiver[bytes]
    address: Address | None = None
    due_ns: deque[int] = field(default_factory=deque)
    "Due times of its queued replies."
    leaves: bool = False
    "The connection ends with the reply to what it asks now."

    def deadline(self) -> int | None:
        """When the inter-byte time-out ends."""
        return self.receiver.deadline()

    def clear(self) -> None:
        """Discard the buffer and the replies."""
        self.receiver.clear()
        self.due_ns.clear()


class RequestSession(SweepSession):
    """Base class of a device with a command table."""

    COMMANDS: ClassVar[Mapping[bytes, Command]]
    REPLY_NS: ClassVar[int] = 1_000_000
    "Delay from a request to its reply."
    INTER_BYTE_NS: ClassVar[int] = 1_000_000_000
    "Inter-byte time-out."

    def __init__(self, boot_ns: int, period_ns: Fraction) -> None:
        super().__init__(boot_ns, period_ns)
        self._connections: Connections[Host] = Connections(
            lambda kind: Host(Receiver(self._splitter(kind), self.INTER_BYTE_NS))
        )

    # what a family fills in

    @abstractmethod
    def _splitter(self, kind: LinkKind | None) -> Splitter[bytes]:
        """The splitter for a kind of link; None: unknown."""

    @abstractmethod
    def _parse(self, request: bytes) -> tuple[bytes, bytes]:
        """Code of a request, as in the table, and its data; an empty code is ignored."""

    @abstractmethod
    def _reply(self, request: Request, payload: bytes) -> bytes:
        """The reply's bytes on the wire."""

    def _ends(self, request: bytes) -> bool:
        """Whether the connection ends with the reply to it."""
        return False

    def _last(self, reply: bytes) -> bytes:
        """That reply, when the connection ends with it."""
        return reply

    def _not_now(self, request: Request) -> Refused | None:
        """Why the device refuses a request, known or not, in its present state."""
        return None

    def _refusal(self, request: Request, refused: Refused) -> bytes | None:
        """The framed reply to a refused request; None: no reply."""
        return None

    def _complaint(self, fault: Fault) -> bytes | None:
        """The framed reply to bytes that are not a request; None: no reply."""
        return None

    # hosts

    def connected(self, now_ns: int, address: Address, kind: LinkKind) -> None:
        """Note the kind of the link; a new connection has an empty buffer."""
        self.advance(now_ns)
        self._connections.connected(address, kind)

    def disconnected(self, now_ns: int, address: Address) -> None:
        """A TCP client has disconnected: withdraw its scans and replies."""
        self.advance(now_ns)
        self._connections.disconnected(address)
        self._unsubscribe(now_ns, address)
        self._outbox.withdraw(lambda sent: sent.to == address)

    def _boot(self, now_ns: int) -> None:
        self._connections.clear()
        super()._boot(now_ns)

    def _next_instant(self) -> int | None:
        own_ns = super()._next_instant()
        return earliest((own_ns, self._connections.deadline())) if self._running and len(self._connections) else own_ns

    def _happen(self, now_ns: int) -> None:
        if (due_ns := super()._next_instant()) is not None and due_ns <= now_ns:
            super()._happen(now_ns)
        for host in self._connections.values():
            for item in host.receiver.expire(now_ns):
                self._take(item, host, now_ns)

    def receive(self, data: bytes, now_ns: int, address: Address | None = None) -> None:
        """Bytes of a host, in any chunking. Never raises."""
        self.advance(now_ns)
        if not data:
            return
        if not self._running:
            self._events.drop(now_ns, DropReason.BOOTING, "", len(data))
            return
        host = self._connections.of(address)
        host.address = address
        found = host.receiver.feed(data, now_ns)
        if self._connections.kind(address) is LinkKind.DATAGRAM:
            found += host.receiver.end()
        for item in found:
            self._take(item, host, now_ns)

    def _take(self, item: bytes | Fault, host: Host, now_ns: int) -> None:
        host.leaves = not isinstance(item, Fault) and self._ends(item)
        if isinstance(item, Fault):
            self._events.drop(now_ns, item.reason, item.detail, item.count)
            if (said := self._complaint(item)) is not None:
                self._say(said, "", host, now_ns)
            return
        code, data = self._parse(item)
        if not code:
            return
        while host.due_ns and host.due_ns[0] <= now_ns:
            host.due_ns.popleft()
        if len(host.due_ns) >= MAX_WAITING:
            self._events.drop(now_ns, DropReason.BUSY, f"{MAX_WAITING} replies wait", len(item))
            return
        self._carry_out(Request(code, data, now_ns, host.address), len(item), host)

    def _carry_out(self, request: Request, size: int, host: Host) -> None:
        now_ns, row = request.now_ns, self.COMMANDS.get(request.code)
        label = coverage({request.code: row})[0].code if row is not None else "?"
        answer: bytes | Answer | Refused
        if (refused := self._not_now(request)) is not None:
            answer = refused
        elif row is None:
            answer = Refused(DropReason.UNKNOWN_COMMAND, repr(request.code))
        else:
            answer = Refused(DropReason.REFUSED, row.name) if row.act is None else row.act(self, request)
        if isinstance(answer, Refused):
            self._events.drop(now_ns, answer.reason, answer.detail, size)
            if row is not None:
                self._events.handled(now_ns, label, answer.reason.value)
            if (said := self._refusal(request, answer)) is not None:
                self._say(said, label, host, now_ns)
            return
        answer = Answer(answer) if isinstance(answer, bytes) else answer
        due_ns = now_ns + self.REPLY_NS
        if answer.payload is not None:
            framed = self._reply(request, answer.payload)
            due_ns = self._say(framed, label, host, now_ns, answer.line_speed)
        if answer.restarts:
            self._restart(due_ns)
        self._events.handled(now_ns, label)

    def _say(self, data: bytes, label: str, host: Host, now_ns: int, line_speed: int | None = None) -> int:
        """Queue a reply; its due time."""
        due_ns = now_ns + self.REPLY_NS
        data = self._last(data) if host.leaves else data
        host.due_ns.append(due_ns)
        self._outbox.send(
            Emission(due_ns, data, host.address, line_speed=line_speed, label=label, hangs_up=host.leaves)
        )
        return due_ns
