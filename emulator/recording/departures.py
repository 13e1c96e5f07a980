"""When payloads of one link had left indeed, beside when they were due: for runs in real time.

Belongs here: which payload it was that a link says has left. Not: who reports (transports, daemon), files (writer).

A payload is recorded when it is handed to its link, which reports later when its last bit was due and had left. A
payload
that the link gives up is never reported: those behind it show that.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import islice

import numpy as np
from numpy.typing import NDArray

from emulator.instrument.observer import Payload
from emulator.recording.layout import LEFT

MOST_WAITING = 4096
"Payloads of a link that have not left; the oldest of more is taken as given up."


@dataclass
class _Handed:
    number: int
    end_ns: int
    payload: Payload | None


class Departures:
    """What one link has been handed and what of it has left."""

    def __init__(self) -> None:
        self._count = 0
        self._waiting: deque[_Handed] = deque()
        self._rows: list[tuple[int, int, int]] = []
        self._left_ns = 0
        "When the last one had left: none begins before."

    def hand(self, end_ns: int, payload: Payload | None) -> Iterator[tuple[Payload, int]]:
        """The link's next payload, due to have left by `end_ns`; `payload`: given back with its instant as it leaves.

        Gives what must not wait any longer, with the instant at which it was due.
        """
        self._waiting.append(_Handed(self._count, end_ns, payload))
        self._count += 1
        if len(self._waiting) > MOST_WAITING:
            yield from self._pass(1)

    def cut(self, end_ns: int) -> None:
        """What is leaving does so no further than this; what waits behind it never does."""
        leaving = next((one for one in self._waiting if one.end_ns > end_ns), None)
        if leaving is not None:
            leaving.end_ns = end_ns

    def leave(self, due_ns: int, actual_ns: int) -> list[tuple[Payload, int]]:
        """What was due by `due_ns` had left by `actual_ns`. Gives payloads with the instants of their first bits."""
        place = next((at for at, one in enumerate(self._waiting) if one.end_ns == due_ns), None)
        if place is None:  # a part of a telegram with a pause in it, or one whose line was slowed on its way
            return []
        found = list(self._pass(place))
        one = self._waiting.popleft()
        self._rows.append((one.number, due_ns, actual_ns))
        if one.payload is not None:
            found.append((one.payload, max(one.payload.start_ns + actual_ns - due_ns, self._left_ns)))
        self._left_ns = max(self._left_ns, actual_ns)
        return found

    def end(self) -> list[tuple[Payload, int]]:
        """What waits at the end of the recording."""
        return list(self._pass(len(self._waiting)))

    def take(self) -> NDArray[np.void] | None:
        """Number, due and actual instant of what has left since this was asked last; None: nothing."""
        if not self._rows:
            return None
        rows, self._rows = np.array(self._rows, dtype=LEFT), []
        return rows

    def _pass(self, count: int) -> Iterator[tuple[Payload, int]]:
        for one in list(islice(self._waiting, count)):
            self._waiting.popleft()
            if one.payload is not None:
                yield one.payload, max(one.payload.start_ns, self._left_ns)
