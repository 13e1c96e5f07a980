"""A device that only sends and ignores input: datagrams of sweeps, and periodic ones.

Belongs here: what rotating scanners on UDP have in common. Not: the layout of a packet.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

from protocols.scan import Floats
from protocols.session import Address, DropReason
from protocols.skeleton.sweeps import SweepSession


class OneWaySession(SweepSession):
    """Streams to every link after the boot."""

    def _start(self, now_ns: int) -> None:
        self._subscribe(now_ns, None)

    def receive(self, data: bytes, now_ns: int, address: Address | None = None) -> None:
        """Input is ignored and reported as dropped."""
        self.advance(now_ns)
        if data:
            self._events.drop(now_ns, DropReason.UNKNOWN_COMMAND, "it takes no commands", len(data))


def packets(fire_offset_s: Floats, beams: int) -> Iterator[tuple[slice, int]]:
    """Slices of `beams` beams for each packet, and the firing time of its last beam after the sweep's beginning. [ns]

    fire_offset_s (n,) in the order of the packets. The last packet may have fewer.
    """
    for first in range(0, len(fire_offset_s), beams):
        part = slice(first, min(first + beams, len(fire_offset_s)))
        yield part, math.ceil(1e9 * float(fire_offset_s[part].max()))
