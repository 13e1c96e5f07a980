"""Hosts of a soak on the CAN bus: one that listens and judges the lists, one that floods with frames of no meaning."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from emulator.endurance.guests import Guestbook, noise
from emulator.transports.can_link import CanPort, LoopOutlet
from emulator.transports.can_wire import Carried

LIST_HEADER = 0x60A
"Obj_0_Status of an ARS408 with sensor id 0: the first frame of each list."
CYCLE_NS = 75_000_000
FLOOD_NS = 500_000
"Between two frames of the flood: about half of a bus of 500 kbit/s."
HOST_IDS = 0x600
"The flood stays below: 0x200, 0x202 and their like would be commands, which a device obeys."


class GuestBus(LoopOutlet):
    """The way out of the bus: every host there is."""

    def __init__(self, rng: np.random.Generator, book: Guestbook) -> None:
        super().__init__()
        self._rng = rng
        self._book = book
        self._port: CanPort | None = None
        self._last_ns: int | None = None
        self._left = 0
        "Objects of the present list still to come."
        self._flood_until_ns = 0
        self._quiet_until_ns = 0
        self._next_ns = 0

    def attached(self, port: CanPort) -> None:
        self._port = port
        self._node = port.wire.join("hosts")

    def poll(self, now_ns: int) -> None:
        if self._port is None or now_ns < self._quiet_until_ns:
            return
        if now_ns >= self._flood_until_ns:
            self._quiet_until_ns = now_ns + round(self._rng.uniform(5.0, 60.0) * 1e9)
            self._flood_until_ns = self._quiet_until_ns + round(self._rng.uniform(0.05, 0.5) * 1e9)
            self._next_ns = self._quiet_until_ns
            self._book.visits["flood of frames"] += 1
            return
        while self._next_ns <= now_ns:
            peer = int(self._rng.integers(0x300, HOST_IDS))
            self._port.wire.put(self._node, peer, noise(self._rng, int(self._rng.integers(0, 9))), self._next_ns)
            self._next_ns += FLOOD_NS

    def next_ns(self) -> int | None:
        return max(self._next_ns, self._quiet_until_ns)

    def deliver(self, carried: Sequence[Carried], now_ns: int) -> bool:
        for frame in carried:
            if frame.peer == LIST_HEADER:
                self._begin(frame)
            elif frame.peer == LIST_HEADER + 1:
                self._left -= 1
        return True

    def _begin(self, frame: Carried) -> None:
        if self._left:
            self._book.faults["objects missing in a list"] += 1
        self._left = frame.data[0]
        gap_ns = CYCLE_NS if self._last_ns is None else frame.start_ns - self._last_ns
        # a frame on the bus may be in the way: a quarter of a cycle covers a bus half full
        if abs(gap_ns - CYCLE_NS) > CYCLE_NS // 4:
            self._book.faults["gap between lists"] += 1
        self._last_ns = frame.start_ns
        self._book.clean_scans += 1
