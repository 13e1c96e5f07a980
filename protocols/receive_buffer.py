"""A growing buffer of what a host has sent: take a frame, search for the next start, bounded.

It handles bytes only. The family defines the start bytes and the length of a frame.
"""

from __future__ import annotations


class ReceiveBuffer:
    """Bytes in arrival order, at most `limit` of them."""

    def __init__(self, limit: int) -> None:
        """`limit` must hold the longest frame of the protocol, or that frame can never be completed."""
        if limit < 1:
            raise ValueError(f"limit {limit}; want > 0")
        self._limit = limit
        self._bytes = bytearray()

    def __len__(self) -> int:
        return len(self._bytes)

    @property
    def room(self) -> int:
        """How many bytes may still be added."""
        return self._limit - len(self._bytes)

    def add(self, data: bytes | bytearray | memoryview) -> int:
        """Append as much of `data` as there is room for; how many bytes that was. The caller adds the rest later."""
        taken = min(len(data), self.room)
        self._bytes += data[:taken]
        return taken

    def skip_to(self, start: bytes) -> int:
        """Discard the bytes before the first `start`; the number of bytes.

        Where `start` has several bytes, the beginning of one at the very end is kept.
        """
        at = self._bytes.find(start)
        if at < 0:
            at = len(self._bytes)
            for kept in range(min(len(start) - 1, at), 0, -1):
                if self._bytes.endswith(start[:kept]):
                    at -= kept
                    break
        del self._bytes[:at]
        return at

    def peek(self, count: int) -> bytes | None:
        """The first `count` bytes, left in place; None while there are fewer."""
        return bytes(self._bytes[:count]) if count <= len(self._bytes) else None

    def take(self, count: int) -> bytes:
        """Remove and return the first `count` bytes, or all there are."""
        taken = bytes(self._bytes[:count])
        del self._bytes[:count]
        return taken

    def clear(self) -> int:
        """Discard everything; the number of bytes."""
        count = len(self._bytes)
        self._bytes.clear()
        return count
