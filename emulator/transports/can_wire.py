"""One CAN bus in time: who sends next, when its last bit has left, who has to stop. Nothing here reads a clock.

Belongs here: arbitration between nodes, the bit rate, queues that overflow, the error counters of ISO 11898-1 with bus
off and recovery, and how full the bus is. Not: who the nodes are, and how hosts are reached.

A node sends its frames in the order in which it queued them. When several nodes have a frame due, the one with the
lower identifier goes first; a frame that has begun is finished. Exact bit lengths come from `protocols.can_frame`.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field
from heapq import heapify, heappop, heappush
from typing import NamedTuple

from protocols.can_frame import MAX_DATA_BYTES, arbitration_key, frame_bits, is_identifier

SECOND_NS = 1_000_000_000
QUEUE_FRAMES = 1024
"Frames that may wait at one node: three of the longest lists."
HOST_FRAMES = 64
"At the controller of a host that waits for room by itself; what it has not handed over stays in the kernel."
STALE = 64
"First frames that are kept though their nodes have gone, beyond as many as there are nodes."
RECOVERY_BITS = 128 * 11
"ISO 11898-1: a controller that is off the bus comes back after 128 times 11 recessive bits."
ERROR_PASSIVE, BUS_OFF = 128, 256
ERROR_FRAME_BITS = 20
"Error flags of both sides, delimiter and pause, as they follow a disturbed frame."
TRANSMIT_ERROR = 8
"Added to the transmit error counter by each disturbed frame; a good one takes 1 away."
LOAD_WINDOW_NS = SECOND_NS


@dataclass(eq=False)
class Node:
    """One controller on the bus."""

    name: str
    queue_frames: int = QUEUE_FRAMES
    "Frames that may wait."
    place: int = 0
    "Of nodes that send the same identifier at once the first goes first."
    waiting: deque[_Waiting] = field(default_factory=deque)
    error_counter: int = 0
    recovery_ns: int = 0
    "How long it stays off the bus at least: firmware that waits before it starts its controller again."
    disturbed: int = 0
    "Frames of this node that will still be destroyed."
    off_until_ns: int | None = None
    "Off the bus until then."
    sent: int = 0
    dropped: int = 0
    "Frames refused because the queue was full, or lost because the node was off the bus."
    bus_offs: int = 0


class _Waiting(NamedTuple):
    due_ns: int
    peer: int
    data: bytes


@dataclass(frozen=True)
class Carried:
    """A frame that everybody on the bus has received."""

    node: Node
    peer: int
    data: bytes
    due_ns: int
    "When its sender wanted it to start."
    start_ns: int
    end_ns: int


@dataclass(frozen=True)
class Notice:
    """A change of a node's error state."""

    at_ns: int
    node: Node
    state: str
    "error passive | active (error passive no more) | bus off | recovered (from it)"


class CanWire:
    """The bus: `put` frames, `take` those that have been carried."""

    def __init__(self, bitrate: int, queue_frames: int = QUEUE_FRAMES) -> None:
        if bitrate < 1:
            raise ValueError(f"bit rate {bitrate}; want bit/s > 0")
        self.bitrate = bitrate
        self._queue_frames = queue_frames
        self._nodes: dict[int, Node] = {}
        self._joined = 0
        self._later: list[tuple[int, int, _Waiting]] = []
        "First frames of nodes by when they want to go: (due, place, frame). What is stale is passed over."
        self._ready: list[tuple[tuple[int, int, int], int, _Waiting]] = []
        "Those that wanted to go before now, by arbitration: (key, place, frame)."
        self._free_ns = 0
        self._on_wire: tuple[Node, _Waiting, int, int] | None = None
        self._busy: deque[tuple[int, int]] = deque()
        "(end, length) of the frames of the last second."
        self._busy_ns = 0
        self.notices: list[Notice] = []
        "Changes of error states, for the caller to take away."

    def join(self, name: str, queue_frames: int | None = None) -> Node:
        """A new controller on the bus; `queue_frames`: it holds so many, not what is usual on this bus."""
        self._joined += 1
        node = Node(name, self._queue_frames if queue_frames is None else queue_frames, self._joined)
        self._nodes[node.place] = node
        return node

    def leave(self, node: Node) -> None:
        """A controller goes; a frame that it has begun is finished."""
        self._nodes.pop(node.place, None)
        self._sweep()

    def _sweep(self) -> None:
        """Forget what is stale, once it is more than what is not: hosts that come, send and go must not pile up."""
        if len(self._later) + len(self._ready) > 2 * len(self._nodes) + STALE:
            self._later = [one for one in self._later if self._owner(*one[1:]) is not None]
            self._ready = [one for one in self._ready if self._owner(*one[1:]) is not None]
            heapify(self._later)
            heapify(self._ready)

    def has_room(self, node: Node) -> bool:
        """Whether `put` would take one more frame."""
        return len(node.waiting) < node.queue_frames

    def is_busy(self, node: Node) -> bool:
        """Whether a frame of the node waits, or is on the bus."""
        return bool(node.waiting) or (self._on_wire is not None and self._on_wire[0] is node)

    def put(self, node: Node, peer: int, data: bytes, due_ns: int) -> bool:
        """Queue a frame to start not before `due_ns`; False, and counted, when it is none, or there is no room."""
        if not is_identifier(peer) or len(data) > MAX_DATA_BYTES or not self.has_room(node):
            node.dropped += 1
            return False
        if node.off_until_ns is not None:
            if due_ns < node.off_until_ns:
                node.dropped += 1
                return False
            self._recover(node)
        node.waiting.append(_Waiting(due_ns, peer, data))
        if len(node.waiting) == 1:
            self._queue(node)
        return True

    def _queue(self, node: Node) -> None:
        """The node's first frame takes part in what follows."""
        heappush(self._later, (node.waiting[0].due_ns, node.place, node.waiting[0]))

    def _owner(self, place: int, frame: _Waiting) -> Node | None:
        """The node whose first frame this still is."""
        node = self._nodes.get(place)
        return node if node is not None and node.waiting and node.waiting[0] is frame else None

    def take(self, now_ns: int, at_most: int | None = None) -> list[Carried]:
        """Frames whose last bit has left by `now_ns` and that were not taken before, in order; the first `at_most`."""
        carried: list[Carried] = []
        while at_most is None or len(carried) < at_most:
            if self._on_wire is None and not self._begin(now_ns):
                break
            if self._on_wire is None:
                continue
            node, frame, start_ns, end_ns = self._on_wire
            if end_ns > now_ns:
                break
            self._on_wire = None
            node.sent += 1
            if node.error_counter == ERROR_PASSIVE:
                self.notices.append(Notice(end_ns, node, "active"))
            node.error_counter = max(0, node.error_counter - 1)
            carried.append(Carried(node, frame.peer, frame.data, frame.due_ns, start_ns, end_ns))
        for node in self._off_the_bus():
            if node.off_until_ns is not None and node.off_until_ns <= now_ns:
                self._recover(node)
        return carried

    def _off_the_bus(self) -> list[Node]:
        return [node for node in self._nodes.values() if node.off_until_ns is not None]

    def next_ns(self) -> int | None:
        """When `take` should be called again, None when nothing waits."""
        if self._on_wire is not None:
            return self._on_wire[3]
        # when the next frame will have left, as far as can be said before the arbitration
        firsts = [frame for _, place, frame in (*self._later, *self._ready) if self._owner(place, frame) is not None]
        ends = [max(self._free_ns, frame.due_ns) + self._frame_ns(frame) for frame in firsts]
        ends += [node.off_until_ns for node in self._off_the_bus() if node.off_until_ns is not None]
        return min(ends) if ends else None

    def stall(self, now_ns: int) -> None:
        """The bus has stood until now: no frame that has not begun begins before."""
        self._free_ns = max(self._free_ns, now_ns)

    def clear(self, node: Node) -> int:
        """Forget what a node has not begun to send; how many bytes of data those were."""
        forgotten = sum(len(frame.data) for frame in node.waiting)
        node.waiting.clear()
        self._sweep()
        return forgotten

    def disturb(self, node: Node, frames: int) -> None:
        """Let the next `frames` frames of a node be destroyed on the bus: each is sent again, its errors count."""
        node.disturbed += frames

    def restart(self, node: Node, now_ns: int) -> None:
        """No frame of a node is destroyed any more; if it is off the bus, it is back as soon as the bus lets it."""
        node.disturbed = node.recovery_ns = 0
        if node.off_until_ns is not None:
            node.off_until_ns = min(node.off_until_ns, now_ns + self._duration_ns(RECOVERY_BITS))

    def load(self, now_ns: int) -> float:
        """Share of the last second in which the bus was taken, 0 to 1."""
        while self._busy and self._busy[0][0] <= now_ns - LOAD_WINDOW_NS:
            self._busy_ns -= self._busy.popleft()[1]
        return min(1.0, self._busy_ns / LOAD_WINDOW_NS)

    def _duration_ns(self, bits: int) -> int:
        return (bits * SECOND_NS + self.bitrate // 2) // self.bitrate

    def _frame_ns(self, frame: _Waiting) -> int:
        return self._duration_ns(frame_bits(frame.peer, frame.data))

    def _begin(self, now_ns: int) -> bool:
        """Let the winner of the next arbitration begin, when that is by `now_ns`."""
        while self._later and self._owner(*self._later[0][1:]) is None:
            heappop(self._later)
        while self._ready and self._owner(*self._ready[0][1:]) is None:
            heappop(self._ready)
        if not self._later and not self._ready:
            return False
        due_ns = min([frame.due_ns for _, _, frame in self._ready[:1]] + [due for due, _, _ in self._later[:1]])
        start_ns = max(self._free_ns, due_ns)
        if start_ns > now_ns:
            return False
        while self._later and self._later[0][0] <= start_ns:
            _, place, frame = heappop(self._later)
            heappush(self._ready, (arbitration_key(frame.peer), place, frame))
        _, place, frame = heappop(self._ready)
        while (winner := self._owner(place, frame)) is None:
            _, place, frame = heappop(self._ready)
        end_ns = start_ns + self._frame_ns(frame)
        if winner.disturbed:
            self._destroy(winner, start_ns, end_ns)
            if winner.waiting:
                self._queue(winner)
            return True
        winner.waiting.popleft()
        if winner.waiting:
            self._queue(winner)
        self._occupy(start_ns, end_ns)
        self._on_wire = (winner, frame, start_ns, end_ns)
        return True

    def _destroy(self, node: Node, start_ns: int, end_ns: int) -> None:
        """A frame that nobody received: the sender counts the error and tries again, or leaves the bus."""
        node.disturbed -= 1
        before = node.error_counter
        node.error_counter += TRANSMIT_ERROR
        end_ns += self._duration_ns(ERROR_FRAME_BITS)
        self._occupy(start_ns, end_ns)
        if before < ERROR_PASSIVE <= node.error_counter:
            self.notices.append(Notice(end_ns, node, "error passive"))
        if node.error_counter >= BUS_OFF:
            node.bus_offs += 1
            node.dropped += len(node.waiting)
            node.waiting.clear()
            node.disturbed = 0
            node.off_until_ns = end_ns + max(self._duration_ns(RECOVERY_BITS), node.recovery_ns)
            self.notices.append(Notice(end_ns, node, "bus off"))

    def _recover(self, node: Node) -> None:
        if node.off_until_ns is not None:
            self.notices.append(Notice(node.off_until_ns, node, "recovered"))
        node.off_until_ns = None
        node.error_counter = 0

    def _occupy(self, start_ns: int, end_ns: int) -> None:
        self._free_ns = end_ns
        self._busy.append((end_ns, end_ns - start_ns))
        self._busy_ns += end_ns - start_ns
        self.load(end_ns)
