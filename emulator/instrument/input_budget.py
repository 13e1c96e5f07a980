"""How long a sensor listens at once, so that a flood on its links does not make other sensors late.

Belongs here: what waits, and for how long. Not: how many bytes a link takes, and how long who has worked rests
(transports).

In virtual time input_budget takes no time and has no limit: the same run gives the same bytes.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import replace

from emulator.transports.link import Link, Received
from emulator.transports.turns import Turn
from protocols.session import LinkKind

PIECE = 256
"Bytes of a line or a stream that are heard before it is looked how long that took: the worst we know take 0.7 ms."


class InputBudget:
    """What comes in on the links of one sensor, a little at a time."""

    def __init__(self, links: Sequence[Link]) -> None:
        self._links = links
        self._waiting: deque[tuple[int, Received]] = deque()
        self.turn = Turn()
        "Of all that the sensor does in a step in which it hears something: reading is the least of it."
        self._began_ns: int | None = None

    @property
    def limited(self) -> bool:
        """Whether there is a limit; without one nothing rests, and nothing waits behind a `take`."""
        return self.turn.clock_ns is not None

    def take(self, now_ns: int) -> Iterator[tuple[int, Received]]:
        """Number of the link and what came in there; whoever asks has to hear it before the next, and to `settle`."""
        if self.turn.rests(now_ns):
            return
        if not self._waiting:
            for index, link in enumerate(self._links):
                self._waiting.extend((index, received) for received in link.receive(now_ns))
        if not self._waiting:
            return  # as nearly always: to ask for processor time takes longer than this
        began_ns = self.turn.begin()
        self._began_ns = None if self.turn.clock_ns is None else began_ns
        while self._waiting:
            yield self._next()
            if self.turn.over(began_ns):
                break

    def _next(self) -> tuple[int, Received]:
        """What is heard at once: all that came at once, or a piece of it where it has no borders."""
        index, received = self._waiting.popleft()
        flows = self._links[index].kind in (LinkKind.SERIAL, LinkKind.STREAM)
        if self.turn.clock_ns is None or not flows or len(received.data) <= PIECE:
            return index, received
        self._waiting.appendleft((index, replace(received, data=received.data[PIECE:], opened=False, foreign=None)))
        return index, replace(received, data=received.data[:PIECE], closed=False)

    def settle(self, now_ns: int) -> None:
        """The step in which something was heard is at its end."""
        if self._began_ns is not None:
            self.turn.end(self._began_ns, now_ns)
            self._began_ns = None

    def forget(self) -> int:
        """Nothing that waits is heard any more: its device has lost its power. How many bytes that were."""
        lost = sum(len(received.data) for _, received in self._waiting)
        self._waiting.clear()
        return lost

    def rests(self, now_ns: int) -> bool:
        """Nothing is heard now."""
        return self.turn.rests(now_ns)

    def wake_ns(self, now_ns: int) -> int | None:
        """When it wants to hear on; None: whenever something comes."""
        wake_ns = self.turn.wake_ns(now_ns)
        return now_ns if wake_ns is None and self._waiting else wake_ns
