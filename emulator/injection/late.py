"""Telegrams that faults have made late, link by link, and all that waits behind them.

A link keeps its order, a line, a connection and a CAN controller's queue alike: what follows a late telegram is late
too, and is reported so. Belongs here: only that, not why they are late (telegram, octets).
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, replace

from emulator.instrument.fault_hooks import Piece
from protocols.session import Emission


@dataclass(eq=False)
class _Waiting:
    emission: Emission
    only: int | None
    by: int
    "Number of the fault that made it late; 0: it waits behind others alone."


class LateTelegrams:
    """Of one sensor."""

    def __init__(self, links: int) -> None:
        """`links`: how many it has."""
        self._queues: list[deque[_Waiting]] = [deque() for _ in range(links)]

    def put(self, emission: Emission, only: int | None, by: int, now_ns: int) -> list[Piece]:
        """What of a telegram leaves now; the rest waits. `by`: the fault that has made it late, or 0."""
        late = by > 0 and emission.due_ns > now_ns
        if not late and not any(self._queues):
            return [(emission, only)]
        found: list[Piece] = []
        for index, part in self._parts(emission, only):
            queue = self._queues[index]
            if late or queue:
                queue.append(_Waiting(emission, part, by if late else 0))
            else:
                found.append((emission, part))
        return found

    def _parts(self, emission: Emission, only: int | None) -> list[tuple[int, int | None]]:
        """Links that it goes to, and how it is distinguished there."""
        if emission.address is not None:
            index = emission.address.link
            return [(index, only)] if index < len(self._queues) else []
        return [(index, index) for index in (range(len(self._queues)) if only is None else (only,))]

    def next_ns(self) -> int | None:
        """When something leaves."""
        first_ns: int | None = None
        for queue in self._queues:
            if queue and (first_ns is None or queue[0].emission.due_ns < first_ns):
                first_ns = queue[0].emission.due_ns
        return first_ns

    def release(self, now_ns: int) -> list[Piece]:
        """What leaves now."""
        found: list[Piece] = []
        for queue in self._queues:
            before_ns = 0
            while queue and queue[0].emission.due_ns <= now_ns:
                one = queue.popleft()
                before_ns = max(before_ns, one.emission.due_ns)
                found.append((replace(one.emission, due_ns=before_ns), one.only))
        return found

    def let_go(self, number: int, now_ns: int) -> None:
        """That fault makes nothing late any more: what waits because of it leaves now."""
        for queue in self._queues:
            for one in queue:
                if one.by == number:
                    one.emission = replace(one.emission, due_ns=min(one.emission.due_ns, now_ns))
                    one.by = 0

    def clear(self) -> list[Emission]:
        """The power is away: what waited is gone."""
        lost = [one.emission for queue in self._queues for one in queue]
        for queue in self._queues:
            queue.clear()
        return lost
