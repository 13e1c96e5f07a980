"""Serial lines slower than what is to be sent on them: how long bytes take, and until when a line is busy.

Belongs here: 8N1, ten bits a byte. Not: what a device does when its line is busy (families).
"""

from __future__ import annotations

from collections.abc import Hashable

from protocols.skeleton.instants import SECOND_NS

BITS = 10
"Of a byte: start, eight of data, stop."


def line_ns(size: int, baud: int) -> int:
    """How long so many bytes take, rounded up. [ns]"""
    return -(-size * BITS * SECOND_NS // baud)


class SerialLines:
    """Until when each line of a device is busy with what was sent."""

    def __init__(self) -> None:
        self._free_ns: dict[Hashable, int] = {}

    def is_free(self, line: Hashable, at_ns: int) -> bool:
        """Whether everything sent before has left by then."""
        return self._free_ns.get(line, 0) <= at_ns

    def occupy(self, line: Hashable, due_ns: int, size: int, baud: int) -> None:
        """So many bytes follow what was sent before, `due_ns` at the earliest."""
        self._free_ns[line] = max(due_ns, self._free_ns.get(line, 0)) + line_ns(size, baud)

    def takes(self, line: Hashable, due_ns: int, size: int, baud: int) -> bool:
        """Occupy a line that is free then; False: it is busy, and stays as it is."""
        free = self.is_free(line, due_ns)
        if free:
            self.occupy(line, due_ns, size, baud)
        return free
