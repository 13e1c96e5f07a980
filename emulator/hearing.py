"""How long a sensor listens at one go, so that a flood on its links does not make other sensors late.

Belongs here: the time that hearing takes, and the rest after it. Not: how many bytes a link takes (transports).

In virtual time hearing takes no time and has no limit: the same run gives the same bytes.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator, Sequence

from emulator.transports.link import Link, Received

AT_ONCE_NS = 1_000_000
"Longest hearing at one go; what has been read by then and is not yet heard waits."
REST = 3
"So many times as long nothing is heard then, and as many times more as sensors rest: a third of one core for all."


class Hearing:
    """What comes in on the links of one sensor, a little at a time."""

    def __init__(self, links: Sequence[Link]) -> None:
        self._links = links
        self._waiting: deque[tuple[int, Received]] = deque()
        self._rests_until_ns = 0
        self.clock_ns: Callable[[], int] | None = None
        "Tells the processor time that hearing takes; None: there is no limit."
        self.resting = 1
        "Sensors that rest now, this one included."

    def take(self, now_ns: int) -> Iterator[tuple[int, Received]]:
        """Number of the link and what came in there; whoever asks has to hear it before the next."""
        if self.rests(now_ns):
            return
        began_ns = self.clock_ns() if self.clock_ns is not None else 0
        if not self._waiting:
            for index, link in enumerate(self._links):
                self._waiting.extend((index, received) for received in link.receive(now_ns))
        while self._waiting:
            yield self._waiting.popleft()
            if self.clock_ns is not None and self.clock_ns() - began_ns > AT_ONCE_NS:
                break
        if self.clock_ns is not None and (took_ns := self.clock_ns() - began_ns) > AT_ONCE_NS:
            self._rests_until_ns = now_ns + took_ns * (1 + REST * max(self.resting, 1))

    def forget(self) -> int:
        """Nothing that waits is heard any more: its device has lost its power. How many bytes that were."""
        lost = sum(len(received.data) for _, received in self._waiting)
        self._waiting.clear()
        return lost

    def rests(self, now_ns: int) -> bool:
        """Nothing is heard now."""
        return now_ns < self._rests_until_ns

    def wake_ns(self, now_ns: int) -> int | None:
        """When it wants to hear on; None: whenever something comes."""
        return self._rests_until_ns if self.rests(now_ns) else None
