"""A device on a virtual line with a host on its other end, in virtual time.

Bytes take ten bit times each way. A byte reaches the other side only where both sides have the same speed; else it is
lost, as framing garbage is. Nothing sleeps: waiting moves the clock to the next instant at which something happens.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from protocols.lms2xx import FAMILY
from protocols.lms2xx.session import Lms2xxSession
from protocols.lms2xx.telegrams import Telegram, open_frame, request
from protocols.scan import Scan, ScanPlan
from protocols.session import Dropped, DropReason, Emission, Event

MS = 1_000_000
SECOND = 1_000_000_000

Measure = Callable[[ScanPlan], Scan]


def wall(range_m: float = 12.34, intensity: float = 5.0) -> Measure:
    """Every beam sees the same."""

    def measure(plan: ScanPlan) -> Scan:
        n = len(plan)
        return Scan(
            plan,
            np.full((n, 1), range_m),
            np.full((n, 1), intensity),
            np.zeros(n, np.uint8),
            np.zeros((n, 1), np.int32),
        )

    return measure


def new_session(model: str = "sick-lms291-s05", **device: Any) -> Lms2xxSession:
    return FAMILY.new_session(device, {"model": model})


def hex_bytes(text: str) -> bytes:
    return bytes.fromhex(text)


@dataclass
class Rig:
    """The session, its line, and what the host has read."""

    session: Lms2xxSession
    measure: Measure = field(default_factory=wall)
    host_baud: int = 9600
    now_ns: int = 0
    device_baud: int = 9600
    measuring_ns: int = 0
    "How long a scan takes to be measured once its plan is given out."
    emissions: list[Emission] = field(default_factory=list)
    events: list[Event] = field(default_factory=list)
    plans: list[ScanPlan] = field(default_factory=list)
    arrivals: deque[tuple[int, int]] = field(default_factory=deque)
    "Bytes for the host that it has not read: when the last bit was there, and the byte."
    _to_host: deque[tuple[int, int, int]] = field(default_factory=deque)
    "Bytes on the line: end, byte, speed while it was sent."
    _to_device: deque[tuple[int, int, int]] = field(default_factory=deque)
    _line_end_ns: int = 0
    _speeds: deque[tuple[int, int]] = field(default_factory=deque)
    _work: deque[tuple[int, ScanPlan]] = field(default_factory=deque)
    _asked: ScanPlan | None = None

    @classmethod
    def on(cls, model: str = "sick-lms291-s05", measure: Measure | None = None, **device: Any) -> Rig:
        """A device that was switched on at 0."""
        rig = cls(new_session(model, **device), measure or wall())
        rig.session.power_on(0)
        rig.run(0)
        return rig

    # what the host does

    def write(self, data: bytes) -> int:
        """Send bytes at the host's speed, behind what it is sending; when the last one will be there."""
        at_ns = max(self.now_ns, self._to_device[-1][0] if self._to_device else 0)
        for index, byte in enumerate(data, 1):
            self._to_device.append((at_ns + -(-index * 10 * SECOND // self.host_baud), byte, self.host_baud))
        return self._to_device[-1][0] if data else at_ns

    def ask(self, text: str) -> int:
        """Send the request with this payload, in hex; when its last byte will be there."""
        return self.write(request(hex_bytes(text)))

    def wait(self, duration_s: float) -> None:
        self.run(self.now_ns + round(duration_s * SECOND))

    def flush_input(self) -> None:
        """Forget what has arrived and was not read."""
        self.arrivals.clear()

    def read(self, count: int, timeout_s: float) -> bytes:
        """`count` bytes, or what has come by the time-out; the clock stands where the last of them came."""
        until_ns = self.now_ns + round(timeout_s * SECOND)
        while len(self.arrivals) < count and self._step(until_ns, count - len(self.arrivals)):
            pass
        return bytes(self.arrivals.popleft()[1] for _ in range(min(count, len(self.arrivals))))

    def read_telegram(self, timeout_s: float, start: bytes = b"\x02\x80") -> Telegram | None:
        """Skip to `start`, read one telegram with a right CRC; None at the time-out."""
        until_ns = self.now_ns + round(timeout_s * SECOND)
        seen = b""
        while not seen.endswith(start):
            byte = self.read(1, (until_ns - self.now_ns) / SECOND)
            if not byte:
                return None
            seen += byte
        length = self.read(2, (until_ns - self.now_ns) / SECOND)
        rest = int.from_bytes(length, "little") + 2
        body = self.read(rest, (until_ns - self.now_ns) / SECOND) if len(length) == 2 else b""
        return open_frame(start + length + body) if len(body) == rest else None

    def await_reply(self, command: int, timeout_s: float) -> Telegram | None:
        """The next telegram with that command; others are skipped."""
        until_ns = self.now_ns + round(timeout_s * SECOND)
        while (telegram := self.read_telegram((until_ns - self.now_ns) / SECOND)) is not None:
            if telegram.command == command:
                return telegram
        return None

    def reply_to(self, text: str, timeout_s: float = 2.0) -> bytes:
        """Payload and status byte that answer this request, ACK included: `06` first."""
        self.ask(text)
        ack = self.read(1, timeout_s)
        if ack != b"\x06":
            return ack
        telegram = self.read_telegram(timeout_s)
        return ack + (bytes((telegram.command,)) + telegram.data if telegram else b"")

    def set_speed(self, baud: int) -> None:
        """Change the host's own speed; the bytes it is still sending leave first."""
        if self._to_device:
            self.run(self._to_device[-1][0])
        self.host_baud = baud

    # the line and the device

    def run(self, until_ns: int) -> None:
        """Let everything up to `until_ns` happen."""
        while self._step(until_ns):
            pass
        self.now_ns = max(self.now_ns, until_ns)

    def _step(self, until_ns: int, awaited: int = 0) -> bool:
        """Go to the next instant at which something happens; False when that is after `until_ns`.

        `awaited`: bytes that the host waits for; without them their arrival is nothing that happens.
        """
        self._turn_crank()
        times = [self.session.next_deadline()]
        times += [queue[0][0] for queue in (self._to_device, self._work) if queue]
        if awaited and self._to_host:
            times.append(self._to_host[min(awaited, len(self._to_host)) - 1][0])
        coming = [time for time in times if time is not None]
        if not coming or min(coming) > until_ns:
            self.now_ns = max(self.now_ns, until_ns)
            self._turn_crank()
            return False
        self.now_ns = max(self.now_ns, min(coming))
        self._turn_crank()
        return True

    def _turn_crank(self) -> None:
        now_ns = self.now_ns
        while self._to_device and self._to_device[0][0] <= now_ns:
            end_ns, byte, baud = self._to_device.popleft()
            if baud == self._speed_at(end_ns):
                self.session.receive(bytes((byte,)), now_ns)
        self.session.advance(now_ns)
        moved = True
        while moved:
            moved = self._measure()
            for emission in self.session.take_emissions(now_ns):
                self.emissions.append(emission)
                self._put(emission)
                moved = True
        while self._to_host and self._to_host[0][0] <= now_ns:
            end_ns, byte, baud = self._to_host.popleft()
            if baud == self.host_baud:
                self.arrivals.append((end_ns, byte))
        self.events += self.session.take_events()

    def _measure(self) -> bool:
        moved = False
        plan = self.session.next_plan()
        if plan is not None and plan is not self._asked:
            self._asked = plan
            self.plans.append(plan)
            self._work.append((self.now_ns + self.measuring_ns, plan))
        while self._work and self._work[0][0] <= self.now_ns:
            _, done = self._work.popleft()
            if done is self._asked and done is self.session.next_plan():
                self.session.submit(self.measure(done))
                moved = True
        return moved

    def _put(self, emission: Emission) -> None:
        if emission.cuts:
            self._cut(emission.due_ns)
        count, resume_ns = emission.pause or (len(emission.payload), 0)
        self._put_part(emission.payload[:count], emission.due_ns)
        self._put_part(emission.payload[count:], resume_ns)
        if emission.line_speed is not None:
            self._speeds.append((self._line_end_ns, emission.line_speed))
            self.device_baud = emission.line_speed

    def _cut(self, now_ns: int) -> None:
        """The byte that has begun is the last one."""
        byte_ns = 10 * SECOND // self.device_baud
        while self._to_host and self._to_host[-1][0] - byte_ns > now_ns:
            self._to_host.pop()
        self._line_end_ns = max(now_ns, self._to_host[-1][0] if self._to_host else 0)

    def _put_part(self, data: bytes, due_ns: int) -> None:
        if not data:
            return
        start_ns = max(due_ns, self._line_end_ns)
        for index, byte in enumerate(data, 1):
            end_ns = start_ns + -(-index * 10 * SECOND // self.device_baud)
            self._to_host.append((end_ns, byte, self.device_baud))
        self._line_end_ns = start_ns + -(-len(data) * 10 * SECOND // self.device_baud)

    def _speed_at(self, time_ns: int) -> int:
        """Speed at which the device listens at that time."""
        speed = 9600
        for since_ns, baud in self._speeds:
            if since_ns <= time_ns:
                speed = baud
        return speed

    def scans(self) -> list[Emission]:
        """Telegrams of measured values that were sent so far."""
        return [emission for emission in self.emissions if emission.sweep is not None]

    def dropped(self) -> list[DropReason]:
        return [event.reason for event in self.events if isinstance(event, Dropped)]


def rate_hz(scans: list[Emission]) -> float:
    """Telegrams a second, from first to last."""
    return (len(scans) - 1) * SECOND / (scans[-1].due_ns - scans[0].due_ns)
