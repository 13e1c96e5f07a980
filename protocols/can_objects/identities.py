"""Numbers that a device gives to its tracks: bytes that are few, freed and given again.

Belongs here: which number a track has. Not: how a track comes to be.
"""

from __future__ import annotations

from collections.abc import Iterable
from heapq import heapify, heappop, heappush


class Identities:
    """Lowest free number to each new track, kept while the track is listed, freed when it is missing."""

    def __init__(self, count: int, first: int = 0) -> None:
        self._free = list(range(first, first + count))
        heapify(self._free)
        self._of_track: dict[int, int] = {}

    def assign(self, tracks: Iterable[int]) -> tuple[list[int | None], list[bool]]:
        """Number of each track of a list (None: all are taken) and whether it is new. Other tracks lose theirs.

        A number freed by this list is given again at the earliest in the next one, so that no receiver sees one
        number change its object without a list in between.
        """
        wanted = list(tracks)
        present = set(wanted)
        new = [track not in self._of_track for track in wanted]
        for track, fresh in zip(wanted, new, strict=True):
            if fresh and self._free and track not in self._of_track:
                self._of_track[track] = heappop(self._free)
        numbers = [self._of_track.get(track) for track in wanted]
        for track in [track for track in self._of_track if track not in present]:
            heappush(self._free, self._of_track.pop(track))
        return numbers, new

    def clear(self) -> None:
        """Forget every track."""
        for number in self._of_track.values():
            heappush(self._free, number)
        self._of_track.clear()
