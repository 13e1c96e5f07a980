"""From what hosts send to requests: any chunking, bounded, half requests given up after a pause, hosts kept apart.

Belongs here: the search for frames and lines, and who said them. Not: what a request means.
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
"Connections whose half requests are remembered; of more the oldest is forgotten."

Item = TypeVar("Item")
Refusal = tuple[DropReason, str]
"Why something is no frame, and a detail for the trace."


@dataclass(frozen=True)
class Fault:
    """Input that is no request for this device."""

    reason: DropReason
    count: int
    "Bytes given up."
    detail: str = ""
    whole: bool = False
    "It came to its end but cannot be accepted; a device may answer that."


class Splitter(ABC, Generic[Item]):
    """Finds items in a stream of bytes that may begin, end and break off anywhere. Holds at most `longest` bytes."""

    def __init__(self, longest: int) -> None:
        self._buffer = ReceiveBuffer(longest)

    def __bool__(self) -> bool:
        """Whether something incomplete is held."""
        return len(self._buffer) > 0

    @abstractmethod
    def _next(self) -> Item | Fault | None:
        """Take the first item or fault out of the buffer; None: more bytes are needed."""

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
        """Give up what stopped half-way."""
        gone = self._buffer.clear()
        return [Fault(DropReason.TIMEOUT, gone)] if gone else []

    def clear(self) -> int:
        """Forget what is held; how many bytes that was."""
        return self._buffer.clear()


class LineSplitter(Splitter[bytes]):
    """Lines of text, with what ends them."""

    def __init__(self, longest: int, end: bytes = b"\n") -> None:
        super().__init__(longest)
        self._end = end

    def _next(self) -> bytes | None:
        held = self._buffer.peek(len(self._buffer)) or b""
        at = held.find(self._end)
        return None if at < 0 else self._buffer.take(at + len(self._end))


class FrameSplitter(Splitter[bytes]):
    """Frames that begin with `START` and whose first `HEAD_BYTES` tell their length.

    Behind a frame that is none the next one is looked for right after its `START`: its length may be what was damaged.
    """

    START: ClassVar[bytes]
    HEAD_BYTES: ClassVar[int]

    @abstractmethod
    def _size(self, head: bytes) -> int | Refusal:
        """Bytes of the whole frame; at least `HEAD_BYTES`, at most what the buffer holds."""

    @abstractmethod
    def _open(self, frame: bytes) -> bytes | Refusal:
        """What is in a frame."""

    def expire(self) -> list[bytes | Fault]:
        """Give up the frame that stopped half-way; what a false start swallowed is read again."""
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
    """A splitter, and the longest pause inside a request."""

    def __init__(self, splitter: Splitter[Item], gap_ns: int) -> None:
        self._splitter = splitter
        self._gap_ns = gap_ns
        self._last_ns = 0

    def deadline(self) -> int | None:
        """When half a request will have waited too long; None while nothing waits."""
        return self._last_ns + self._gap_ns if self._splitter else None

    def feed(self, data: bytes, now_ns: int) -> list[Item | Fault]:
        """Take bytes; what they complete, in order."""
        found = self.expire(now_ns)
        found += self._splitter.feed(data)
        self._last_ns = now_ns
        return found

    def expire(self, now_ns: int) -> list[Item | Fault]:
        """What the pause since the last byte decides."""
        found: list[Item | Fault] = []
        # where a false start is given up, what it swallowed may be half a request too, and as old
        while (deadline := self.deadline()) is not None and deadline <= now_ns:
            found += self._splitter.expire()
        return found

    def end(self) -> list[Item | Fault]:
        """Nothing follows, as behind a datagram: what is not whole is given up."""
        found: list[Item | Fault] = []
        while self._splitter:
            found += self._splitter.expire()
        return found

    def clear(self) -> None:
        """Forget what has come."""
        self._splitter.clear()


class HasDeadline(Protocol):
    """What is kept for a connection."""

    def deadline(self) -> int | None: ...

    def clear(self) -> object: ...


Kept = TypeVar("Kept", bound=HasDeadline)


class Connections(Generic[Kept]):
    """One receiver for each connection of a stream, one for each other link; made when bytes first come."""

    def __init__(self, new: Callable[[LinkKind | None], Kept], most: int = MAX_CONNECTIONS) -> None:
        self._new = new
        self._most = most
        self._kinds: dict[int, LinkKind] = {}
        self._kept: dict[tuple[int, int], Kept] = {}

    def __len__(self) -> int:
        return len(self._kept)

    def values(self) -> Iterable[Kept]:
        """All that are kept."""
        return list(self._kept.values())

    def kind(self, address: Address | None) -> LinkKind | None:
        """How the link of an address carries bytes; None: nobody said."""
        return None if address is None else self._kinds.get(address.link)

    def connected(self, address: Address, kind: LinkKind) -> None:
        """A link is there, or a stream's host has connected: it begins with nothing said."""
        self._kinds[address.link] = kind
        self._kept.pop(self._key(address), None)

    def disconnected(self, address: Address) -> None:
        """A stream's host has gone, with what it had begun to say."""
        self._kept.pop(self._key(address), None)

    def of(self, address: Address | None) -> Kept:
        """What is kept for whom bytes came from."""
        key = self._key(address)
        if key not in self._kept:
            if len(self._kept) >= self._most:
                self._kept.pop(next(iter(self._kept)))
            self._kept[key] = self._new(self.kind(address))
        return self._kept[key]

    def clear(self) -> None:
        """Forget what all have begun to say, as a device that starts anew."""
        for one in self._kept.values():
            one.clear()

    def deadline(self) -> int | None:
        """When the first half request will have waited too long."""
        return earliest(one.deadline() for one in self._kept.values())

    def _key(self, address: Address | None) -> tuple[int, int]:
        if address is None:
            return -1, 0
        return address.link, address.peer if self._kinds.get(address.link) is LinkKind.STREAM else 0
