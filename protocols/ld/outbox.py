"""Telegrams on their way: in the order in which they are due, and withdrawn where the device would."""

from __future__ import annotations

import heapq
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from itertools import count

from protocols.session import Address, Emission

CAN_BURST = 16
"Frames handed over together, each with its own instant: about two milliseconds of a bus of 1 Mbit/s."


@dataclass(eq=False)
class Outgoing:
    """One telegram: its emissions in order, handed over burst by burst."""

    to: Address | None
    "Address of the channel it belongs to; None: no host's."
    emissions: deque[Emission]
    is_profile: bool = False
    free_before_ns: int = 0
    "When its line was free without it."
    free_after_ns: int = 0
    begun: bool = False


class Outbox:
    """All telegrams of the device that have not left."""

    def __init__(self) -> None:
        self._heap: list[tuple[int, int, Outgoing]] = []
        self._number = count()

    def put(self, sent: Outgoing) -> None:
        """Add a telegram, or the rest of one."""
        heapq.heappush(self._heap, (sent.emissions[0].due_ns, next(self._number), sent))

    def next_ns(self) -> int | None:
        """When `take` has something."""
        return self._heap[0][0] if self._heap else None

    def take(self, now_ns: int) -> list[Emission]:
        """What is due."""
        taken: list[Emission] = []
        while self._heap and self._heap[0][0] <= now_ns:
            _, _, sent = heapq.heappop(self._heap)
            sent.begun = True
            taken.extend(sent.emissions.popleft() for _ in range(min(CAN_BURST, len(sent.emissions))))
            if sent.emissions:
                self.put(sent)
        return taken

    def withdraw(self, wanted: Callable[[Outgoing], bool]) -> list[Outgoing]:
        """Take back the telegrams of which `wanted` is true, and tell which they were, the last due first."""
        gone = [sent for _, _, sent in sorted(self._heap, reverse=True) if wanted(sent)]
        if gone:
            self._heap = [entry for entry in self._heap if entry[2] not in gone]
            heapq.heapify(self._heap)
        return gone
