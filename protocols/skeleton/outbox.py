"""Telegrams to be sent: in the order of their due times; they can be withdrawn as the device would.

Belongs here: telegrams not sent yet. Not: when a telegram is due, and how busy its line is.
"""

from __future__ import annotations

import heapq
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from itertools import count

from protocols.session import Address, Emission


@dataclass(eq=False)
class Outgoing:
    """One telegram: its emissions in order, passed on in bursts."""

    to: Address | None
    "Address of the host it belongs to; None: no host's own."
    emissions: deque[Emission]
    is_scan: bool = False
    free_before_ns: int = 0
    "When its line would be free without it."
    free_after_ns: int = 0
    begun: bool = False


class Outbox:
    """All telegrams of the device not sent yet; those due together are sent in the order of insertion."""

    def __init__(self, burst: int = 1) -> None:
        """`burst`: number of emissions of one telegram that are passed on together when the first is due."""
        self._heap: list[tuple[int, int, Outgoing]] = []
        self._number = count()
        self._burst = burst

    def __len__(self) -> int:
        return len(self._heap)

    def put(self, sent: Outgoing) -> None:
        """Add a telegram, or the rest of one."""
        heapq.heappush(self._heap, (sent.emissions[0].due_ns, next(self._number), sent))

    def send(self, emission: Emission) -> Outgoing:
        """Add a telegram of one emission."""
        sent = Outgoing(emission.address, deque([emission]))
        self.put(sent)
        return sent

    def next_ns(self) -> int | None:
        """When the next telegram is due."""
        return self._heap[0][0] if self._heap else None

    def take(self, now_ns: int) -> list[Emission]:
        """The emissions that are due."""
        taken: list[Emission] = []
        heap = self._heap
        while heap and heap[0][0] <= now_ns:
            sent = heapq.heappop(heap)[2]
            sent.begun, emissions = True, sent.emissions
            before_ns = min(heap[0][0], now_ns + 1) if heap else now_ns + 1
            while emissions:
                for _ in range(min(self._burst, len(emissions))):
                    taken.append(emissions.popleft())
                if emissions and emissions[0].due_ns >= before_ns:  # another telegram's turn, or not yet due
                    self.put(sent)
                    break
        return taken

    def withdraw(self, wanted: Callable[[Outgoing], bool]) -> list[Outgoing]:
        """Remove the telegrams for which `wanted` is true and return them, the last due first."""
        gone = [sent for _, _, sent in sorted(self._heap, reverse=True) if wanted(sent)]
        if gone:
            self._heap = [entry for entry in self._heap if entry[2] not in gone]
            heapq.heapify(self._heap)
        return gone

    def clear(self) -> None:
        """Remove everything."""
        self._heap.clear()
