"""BCM mode of socketcand: what the broadcast manager of Linux does for one client. Nothing here reads a clock.

Belongs here: subscriptions and content filters with their throttle, cyclic send jobs, and the reading of the commands
for them. Not: connections, modes and the bus (`socketcand`).
Source: linux-can/socketcand (doc/protocol.md, state_bcm.c) and the kernel's net/can/bcm.c.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from protocols.can_frame import EXTENDED, MAX_DATA_BYTES, MAX_EXTENDED_ID, MAX_STANDARD_ID, split_identifier

MOST_ENTRIES = 256
"Subscriptions of one client, and its send jobs."
LEAST_INTERVAL_NS = 50_000
"Of a send job: about the shortest frame at 1 Mbit/s. A bus carries no more; what does not fit is dropped, as there."
AT_ONCE = 64
"Frames of one job that are caught up after a late look."
LONGEST_S = 1_000_000_000


@dataclass
class Heard:
    """A frame for the client."""

    peer: int
    data: bytes
    at_ns: int


@dataclass
class Subscription:
    """What it wants of one identifier."""

    mask: int | None
    "Bits of the 64 whose change it wants to see; None: every frame."
    throttle_ns: int
    seen: int | None = None
    "Masked data of the frame that it got last, or will get."
    reported_ns: int | None = None
    "Time of the frame from which the throttle counts."
    flush_ns: int | None = None
    "When what was held back is reported."
    held: Heard | None = None


@dataclass
class Job:
    """A frame that is sent again and again."""

    data: bytes
    interval_ns: int
    due_ns: int | None


class BroadcastManager:
    """Subscriptions and send jobs of one client."""

    def __init__(self) -> None:
        self.subscriptions: dict[int, Subscription] = {}
        self.jobs: dict[int, Job] = {}

    def subscribe(self, peer: int, throttle_ns: int, mask: bytes | None = None) -> bool:
        """`subscribe`, and with a mask `filter`; a later one replaces the earlier. False: there is no room."""
        if peer not in self.subscriptions and len(self.subscriptions) >= MOST_ENTRIES:
            return False
        bits = None if mask is None else int.from_bytes(mask.ljust(8, b"\0"), "big")
        self.subscriptions[peer] = Subscription(bits, throttle_ns)
        return True

    def add(self, peer: int, interval_ns: int, data: bytes, now_ns: int) -> bool:
        """`add`: the frame is sent at once and, unless the interval is 0, again and again. False: there is no room."""
        if peer not in self.jobs and len(self.jobs) >= MOST_ENTRIES:
            return False
        self.jobs[peer] = Job(data, max(LEAST_INTERVAL_NS, interval_ns) if interval_ns else 0, now_ns)
        return True

    def update(self, peer: int, data: bytes) -> bool:
        """`update`: new content, the timer is not touched. A job that is not there is made, without a timer."""
        if peer in self.jobs:
            self.jobs[peer].data = data
            return True
        if len(self.jobs) >= MOST_ENTRIES:
            return False
        self.jobs[peer] = Job(data, 0, None)
        return True

    def hear(self, heard: Heard) -> list[Heard]:
        """What the client gets at once of a frame on the bus."""
        wants = self.subscriptions.get(heard.peer)
        if wants is None:
            return []
        if wants.mask is not None:
            bits = int.from_bytes(heard.data.ljust(8, b"\0"), "big") & wants.mask
            if bits == wants.seen:
                return []
            wants.seen = bits
        if not wants.throttle_ns:
            return [heard]
        if (
            wants.flush_ns is None
            and wants.reported_ns is not None
            and heard.at_ns - wants.reported_ns < wants.throttle_ns
        ):
            wants.flush_ns = wants.reported_ns + wants.throttle_ns
        if wants.flush_ns is not None:
            wants.held = heard
            return []
        wants.reported_ns = heard.at_ns
        return [heard]

    def flush(self, now_ns: int) -> list[Heard]:
        """What was held back and is due by now, in order of time."""
        reported = []
        for wants in self.subscriptions.values():
            if wants.flush_ns is None or wants.flush_ns > now_ns:
                continue
            if wants.held is None:
                wants.flush_ns = wants.reported_ns = None
                continue
            reported.append(wants.held)
            wants.held = None
            wants.reported_ns, wants.flush_ns = wants.flush_ns, wants.flush_ns + wants.throttle_ns
        return sorted(reported, key=lambda one: one.at_ns)

    def send(self, now_ns: int) -> list[Heard]:
        """Frames of the jobs that go to the bus by now, each with the time when it was due."""
        sent = []
        for peer, job in self.jobs.items():
            for _ in range(AT_ONCE):
                if job.due_ns is None or job.due_ns > now_ns:
                    break
                sent.append(Heard(peer, job.data, job.due_ns))
                job.due_ns = job.due_ns + job.interval_ns if job.interval_ns else None
            if job.due_ns is not None and job.due_ns <= now_ns:
                job.due_ns += -(-(now_ns + 1 - job.due_ns) // job.interval_ns) * job.interval_ns
        return sorted(sent, key=lambda one: one.at_ns)

    def next_ns(self) -> int | None:
        """When `flush` or `send` has something to do."""
        times = [one.flush_ns for one in self.subscriptions.values() if one.flush_ns is not None]
        times += [job.due_ns for job in self.jobs.values() if job.due_ns is not None]
        return min(times, default=None)


def bcm_text(peer: int, data: bytes, at_ns: int) -> bytes:
    """A frame as BCM mode writes it: `< frame 123 23.424242 11 22 33 44  >`, a blank behind each byte."""
    identifier, extended = split_identifier(peer)
    seconds, rest_ns = divmod(at_ns, 1_000_000_000)
    name = f"{identifier:08X}" if extended else f"{identifier:03X}"
    return f"< frame {name} {seconds}.{rest_ns // 1000:06d} {''.join(f'{one:02X} ' for one in data)} >".encode()


def parse_identifier(word: bytes) -> int | None:
    """An identifier, bit 31: extended; None when it is none. Eight digits are extended, up to three standard."""
    if not word.isalnum():
        return None
    try:
        identifier = int(word, 16)
    except ValueError:
        return None
    if len(word) == 8:
        return identifier | EXTENDED if identifier <= MAX_EXTENDED_ID else None
    return identifier if len(word) <= 3 and identifier <= MAX_STANDARD_ID else None


def parse_frame(arguments: Sequence[bytes]) -> tuple[int, bytes] | None:
    """Identifier and data of `ID LENGTH BYTE...`, None when it is no frame."""
    if len(arguments) < 2 or any(not word.isalnum() for word in arguments):
        return None
    peer = parse_identifier(arguments[0])
    try:
        length = int(arguments[1], 16)
        data = bytes(int(word, 16) for word in arguments[2:])
    except ValueError:
        return None
    return (peer, data) if peer is not None and length <= MAX_DATA_BYTES and len(data) == length else None


def parse_time(arguments: Sequence[bytes]) -> int | None:
    """Nanoseconds of `SECONDS MICROSECONDS`, None when it is no time."""
    if len(arguments) < 2 or not all(word.isdigit() and len(word) <= 18 for word in arguments[:2]):
        return None
    seconds, microseconds = int(arguments[0]), int(arguments[1])
    return (seconds * 1_000_000 + microseconds) * 1000 if seconds + microseconds // 1_000_000 <= LONGEST_S else None
