"""How fast a link takes in what hosts write: a bucket that fills with time. What is over it stays in the kernel.

A real line has a speed, and a device's controller is slow; a host that writes faster than both waits, as it would on a
real port. It also bounds what a flood on one link costs the other sensors: no step takes in more than the bucket holds.
"""

from __future__ import annotations

LINE_BYTES_S, LINE_BURST = 100_000, 2_048
"Of a serial line: twice the fastest; the longest request of any device fits in at once."
STREAM_BYTES_S, STREAM_BURST = 500_000, 8_192
"Of all hosts on a socket, and of a CAN adapter: more than the text of every frame of a full bus of 1 Mbit/s."
CAN_BURST = 2_048
"Of hosts that write frames as text: each of its 70 frames costs more than a few bytes of another link."
SECOND_NS = 1_000_000_000


class Intake:
    """Bytes that may be taken in at an instant."""

    def __init__(self, bytes_s: int, burst: int) -> None:
        self._bytes_s = bytes_s
        self._burst = burst
        self._left = burst
        self._at_ns = 0
        self._closed = False

    def room(self, now_ns: int) -> int:
        """Bytes that may be taken now; 0 from when the bucket is empty until a quarter of it is full."""
        gained = max(0, now_ns - self._at_ns) * self._bytes_s // SECOND_NS
        if gained:
            self._left = min(self._burst, self._left + gained)
            self._at_ns = now_ns
        if self._closed and self._left >= self._burst // 4:
            self._closed = False
        return 0 if self._closed else self._left

    def take(self, count: int) -> None:
        """So many were taken."""
        self._left -= count
        self._closed = self._left <= 0

    @property
    def closed(self) -> bool:
        """Whether nothing is taken at present."""
        return self._closed

    def next_ns(self) -> int | None:
        """When there is room again; None while there is some."""
        if not self._closed:
            return None
        missing = self._burst // 4 - self._left
        return self._at_ns + max(1, -(-missing * SECOND_NS // self._bytes_s))
