"""From bytes of hosts to requests: any chunking, bounded, inter-byte time-out, one receiver per host.

Belongs here: the search for frames and lines, by host. Not: the meaning of a request.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import ClassVar, Generic, Protocol, TypeVar

from protocols.receive_buffer import ReceiveBuffer
from protocols.session import Address, DropReason, LinkKind
from protocols.skeleton.instants import earliest

MAX_CONNECTIONS = 64
"Connections whose incomplete requests are kept; beyond that the oldest is discarded."

Item = TypeVar("Item")
Refusal = tuple[DropReason, str]
"Why bytes are not a frame, and a detail for the trace."


@dataclass(frozen=True)
class Fault:
    """Input that is not a request to this device."""

    reason: DropReason
    count: int
    "Bytes discarded."
    detail: str = ""
    whole: bool = False
    "It is complete but not acceptable; a device may answer that."


class Splitter(ABC, Generic[Item]):
    """Finds items in a stream of bytes that may begin, end and break off anywhere. Holds at most `longest` bytes."""

    def __init__(self, longest: int) -> None:
        self._buffer = ReceiveBuffer(longest)

    def __bool__(self) -> bool:
        """Whether something incomplete is held."""
        return len(self._buffer) > 0

    @abstractmethod
    def _next(self) -> Item | Fault | None:
        """Remove the first item or fault from the buffer; None: more bytes are needed."""

    def feed(self, data: bytes) -> list[Item | Fault]:
        """Items and faults in the order of the stream."""
        found: list[Item | Fault] = []
        rest = memoryview(data)
        while True:
            rest = rest[self._buffer.add(rest) :]
            while (item := self._next()) is not None:
                found.append(item)
            if not rest:
                return found
            if not self._buffer.room:
                found.append(Fault(DropReason.OVERLONG, self._buffer.clear()))

    def expire(self) -> list[Item | Fault]:
        """Discard an incomplete item."""
        gone = self._buffer.clear()
        return [Fault(DropReason.TIMEOUT, gone)] if gone else []

    def clear(self) -> int:
        """Discard the buffer; the number of bytes."""
        return self._buffer.clear()


class LineSplitter(Splitter[bytes]):
    """Lines of text, including their line end: whichever of `ends` comes first."""

    def __init__(self, longest: int, *ends: bytes) -> None:
        super().__init__(longest)
        self._ends = ends or (b"\n",)

    def _next(self) -> bytes | None:
        held = self._buffer.peek(len(self._buffer)) or b""
        found = [at + len(end) for end in self._ends if (at := held.find(end)) >= 0]
        return self._buffer.take(min(found)) if found else None


class FrameSplitter(Splitter[bytes]):
    """Frames that begin with `START` and have their length within the first `HEAD_BYTES`.

    After an invalid frame the search continues right after its `START`, because its length field may be damaged.
    """

    START: ClassVar[bytes]
    HEAD_BYTES: ClassVar[int]

    @abstractmethod
    def _size(self, head: bytes) -> int | Refusal:
        """Bytes of the whole frame; at least `HEAD_BYTES`, at most what the buffer holds."""

    @abstractmethod
    def _open(self, frame: bytes) -> bytes | Refusal:
        """The contents of a frame, or why it is refused."""

    def expire(self) -> list[bytes | Fault]:
        """Discard the start of an incomplete frame; the bytes after a false start are parsed again."""
        gone = len(self._buffer.take(len(self.START)))
        return [Fault(DropReason.TIMEOUT, gone), *self.feed(b"")] if gone else []

    def _next(self) -> bytes | Fault | None:
        buffer = self._buffer
        skipped = buffer.skip_to(self.START)
        if skipped:
            return Fault(DropReason.NO_START_BYTE, skipped)
        head = buffer.peek(self.HEAD_BYTES)
        if head is None:
            return None
        size = self._size(head)
        if not isinstance(size, int):
            return self._resume(*size)
        frame = buffer.peek(size)
        if frame is None:
            return None
        found = self._open(frame)
        if not isinstance(found, bytes):
            return self._resume(*found)
        buffer.take(size)
        return found

    def _resume(self, reason: DropReason, detail: str) -> Fault:
        self._buffer.take(len(self.START))
        return Fault(reason, len(self.START), detail)


class Receiver(Generic[Item]):
    """A splitter with an inter-byte time-out."""

    def __init__(self, splitter: Splitter[Item], gap_ns: int) -> None:
        self._splitter = splitter
        self._gap_ns = gap_ns
        self._last_ns = 0

    def deadline(self) -> int | None:
        """When the inter-byte time-out of an incomplete request ends; None: there is none."""
        return self._last_ns + self._gap_ns if self._splitter else None

    def feed(self, data: bytes, now_ns: int) -> list[Item | Fault]:
        """Add bytes; the items that they complete, in order."""
        found = self.expire(now_ns)
        found += self._splitter.feed(data)
        self._last_ns = now_ns
        return found

    def expire(self, now_ns: int) -> list[Item | Fault]:
        """Apply the inter-byte time-out."""
        found: list[Item | Fault] = []
        # after a false start is discarded, the bytes after it may be an incomplete request too, of the same age
        while (deadline := self.deadline()) is not None and deadline <= now_ns:
            found += self._splitter.expire()
        return found

    def end(self) -> list[Item | Fault]:
        """End of input, as after a datagram: discard what is incomplete."""
        found: list[Item | Fault] = []
        while self._splitter:
            found += self._splitter.expire()
        return found

    def clear(self) -> None:
        """Discard the input so far."""
        self._splitter.clear()


class HasDeadline(Protocol):
    """State of a connection."""

    def deadline(self) -> int | None: ...

    def clear(self) -> object: ...


Kept = TypeVar("Kept", bound=HasDeadline)


class Connections(Generic[Kept]):
    """One receiver per TCP connection, and per other link; created with the first bytes."""

    def __init__(self, new: Callable[[LinkKind | None], Kept], most: int = MAX_CONNECTIONS) -> None:
        self._new = new
        self._most = most
        self._kinds: dict[int, LinkKind] = {}
        self._kept: dict[tuple[int, int], Kept] = {}

    def __len__(self) -> int:
        return len(self._kept)

    def values(self) -> Iterable[Kept]:
        """The states of all connections."""
        return list(self._kept.values()) if self._kept else ()

    def kind(self, address: Address | None) -> LinkKind | None:
        """Kind of the link of an address; None: unknown."""
        return None if address is None else self._kinds.get(address.link)

    def connected(self, address: Address, kind: LinkKind) -> None:
        """A link is open, or a TCP client has connected: it starts with an empty buffer."""
        self._kinds[address.link] = kind
        self._kept.pop(self._key(address), None)

    def disconnected(self, address: Address) -> None:
        """A TCP client has disconnected: discard its buffer."""
        self._kept.pop(self._key(address), None)

    def of(self, address: Address | None) -> Kept:
        """State of the connection that bytes came from."""
        key = self._key(address)
        if key not in self._kept:
            if len(self._kept) >= self._most:
                self._kept.pop(next(iter(self._kept)))
            self._kept[key] = self._new(self.kind(address))
        return self._kept[key]

    def clear(self) -> None:
        """Discard all buffers, as at a restart of the device."""
        for one in self._kept.values():
            one.clear()

    def deadline(self) -> int | None:
        """When the first inter-byte time-out ends."""
        return earliest(one.deadline() for one in self._kept.values()) if self._kept else None

    def _key(self, address: Address | None) -> tuple[int, int]:
        if address is None:
            return -1, 0
        return address.link, address.peer if self._kinds.get(address.link) is LinkKind.STREAM else 0
