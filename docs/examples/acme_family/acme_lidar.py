"""ACME X2, an invented scanner on a serial line: the device's side of its lines of text. A whole family in one module.

Belongs here: what goes over the wire and when. Not: what the device sees (acme-x2.yaml, and the emulator).

    host    START            device  OK START, then ten times a second  S 17 800 800 0 812 ... *5A
    host    STOP             device  OK STOP
    host    ID               device  OK ID ACME X2
    host    anything else    device  ERR

Lines end with LF. A scan is its number, 91 ranges in centimetres from right to left (0: no echo), and the XOR of all
bytes before the `*` in two hexadecimal digits.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from protocols.checksums import xor8
from protocols.errors import DeviceSettingError, ScanRefused
from protocols.receive_buffer import ReceiveBuffer
from protocols.scan import Floats, Scan, ScanPlan
from protocols.session import (
    Address,
    CommandHandled,
    CommandRow,
    DeviceKey,
    Dropped,
    DropReason,
    Emission,
    Event,
    Restarted,
    Session,
    dropped_scans,
)

BAUD = 115_200
BEAMS = 91
AZIMUTH_RAD = np.radians(np.arange(BEAMS) - 45.0)
PERIOD_NS = 100_000_000
SWEEP_NS = 50_000_000
"The mirror looks forward in one half of each turn; a scan leaves at its end."
BOOT_NS = 500_000_000
REPLY_NS = 1_000_000
LONGEST_LINE = 64
SOURCE = "this page"


KEYS = (DeviceKey("serial_number", "text", "0001", "sent behind ID"),)


def encode_scan(number: int, range_m: Floats) -> bytes:
    """One line; range_m (n,) in metres, NaN where there is no echo. Farther than 655.35 m is no echo either."""
    centimetres = np.nan_to_num(np.round(100.0 * range_m), nan=0.0)
    words = np.where(centimetres <= 65_535, centimetres, 0).astype(int)
    body = f"S {number} {' '.join(map(str, words))} ".encode()
    return body + f"*{xor8(body):02X}\n".encode()


def decode_scan(line: bytes) -> tuple[int, Floats] | None:
    """Number and ranges in metres, NaN where there is no echo; None: damaged, or no scan."""
    body, star, check = line.strip().rpartition(b"*")
    words = body.split()
    if not star or check != f"{xor8(body):02X}".encode() or len(words) != BEAMS + 2 or words[0] != b"S":
        return None
    ranges = np.array([float(word) for word in words[2:]]) / 100.0
    return int(words[1]), np.where(ranges > 0.0, ranges, np.nan)


class AcmeSession(Session):
    """One ACME X2 talking to its host."""

    def __init__(self, serial_number: str) -> None:
        self._serial_number = serial_number
        self._buffer = ReceiveBuffer(LONGEST_LINE)
        self._replies: deque[Emission] = deque()
        self._scans: deque[Emission] = deque()
        self._events: list[Event] = []
        self._ready_ns: int | None = None
        self._now_ns = 0
        self._streaming = False
        self._epoch = self._sweep = 0

    # power

    def power_on(self, now_ns: int) -> None:
        self._buffer.clear()
        self._replies.clear()
        self._stop(now_ns)
        self._now_ns, self._ready_ns = now_ns, now_ns + BOOT_NS
        self._replies.append(Emission(now_ns, b"", line_speed=BAUD, label="power-on"))  # the line's speed, no bytes
        self._events.append(Restarted(now_ns))

    # what hosts send

    def receive(self, data: bytes, now_ns: int, address: Address | None = None) -> None:
        self.advance(now_ns)
        if self._ready_ns is None or now_ns < self._ready_ns:
            self._events.append(Dropped(now_ns, DropReason.BOOTING, count=len(data)))
            return
        while data:
            data = data[self._buffer.add(data) :]
            while (line := self._take_line()) is not None:
                self._answer(line, now_ns)
            if not self._buffer.room:
                self._events.append(Dropped(now_ns, DropReason.OVERLONG, count=self._buffer.clear()))

    def _take_line(self) -> bytes | None:
        held = self._buffer.peek(len(self._buffer)) or b""
        end = held.find(b"\n")
        return None if end < 0 else self._buffer.take(end + 1).strip()

    def _answer(self, line: bytes, now_ns: int) -> None:
        if not line:
            return
        command = COMMANDS.get(line)
        if command is None:
            self._reply(b"ERR", now_ns)
            self._events.append(Dropped(now_ns, DropReason.UNKNOWN_COMMAND, repr(line), len(line) + 1))
            return
        self._reply(b"OK " + line + command.act(self, now_ns), now_ns)
        self._events.append(CommandHandled(now_ns, line.decode(), "done"))

    def _reply(self, text: bytes, now_ns: int) -> None:
        self._replies.append(Emission(now_ns + REPLY_NS, text + b"\n", label=text.split()[0].decode()))

    def _start(self, now_ns: int) -> bytes:
        if not self._streaming:
            self._streaming = True
            self._epoch += 1
            self._sweep = self._first_sweep_from(now_ns)
        return b""

    def _stop(self, now_ns: int = 0) -> bytes:
        self._streaming = False
        self._epoch += 1
        waiting = [scan.sweep for scan in self._scans if scan.sweep is not None]
        self._scans.clear()  # what has not left is withdrawn, and told by its numbers
        if waiting:
            self._events += dropped_scans(now_ns, DropReason.STALE, range(waiting[0], waiting[-1] + 1))
        return b""

    def _identify(self, now_ns: int) -> bytes:
        return f" ACME X2 {self._serial_number}".encode()

    # time

    def _start_of(self, sweep: int) -> int:
        """Instants come from the number, never from a running sum."""
        assert self._ready_ns is not None
        return self._ready_ns + sweep * PERIOD_NS

    def _first_sweep_from(self, now_ns: int) -> int:
        assert self._ready_ns is not None
        return -((self._ready_ns - now_ns) // PERIOD_NS)  # rounded up

    def advance(self, now_ns: int) -> None:
        self._now_ns = max(self._now_ns, now_ns)

    def next_deadline(self) -> int | None:
        waiting = [queue[0].due_ns for queue in (self._replies, self._scans) if queue]
        return min(waiting, default=None)

    # scans

    def next_plan(self) -> ScanPlan | None:
        if not self._streaming:
            return None
        return ScanPlan(
            epoch=self._epoch,
            sweep=self._sweep,
            start_ns=self._start_of(self._sweep),
            azimuth_rad=AZIMUTH_RAD,
            elevation_rad=np.zeros(BEAMS),
            fire_offset_s=np.arange(BEAMS) * (1e-9 * SWEEP_NS / BEAMS),
            duration_s=1e-9 * SWEEP_NS,
            max_range_m=655.35,
        )

    def submit(self, scan: Scan) -> None:
        plan = scan.plan
        if not self._streaming or (plan.epoch, plan.sweep) != (self._epoch, self._sweep):
            raise ScanRefused(f"sweep {plan.sweep} is not wanted any more")
        line = encode_scan(plan.sweep, scan.range_m[:, 0])
        self._scans.append(Emission(plan.start_ns + SWEEP_NS, line, sweep=plan.sweep, label="S"))
        self._sweep += 1
        missed = self._first_sweep_from(self._now_ns - SWEEP_NS) - self._sweep
        if missed > 0:  # they ended while this one was measured: never silently
            self._events += dropped_scans(self._now_ns, DropReason.LATE, range(self._sweep, self._sweep + missed))
            self._sweep += missed

    def take_emissions(self, now_ns: int) -> list[Emission]:
        due = [queue.popleft() for queue in (self._replies, self._scans) for _ in range(_count_due(queue, now_ns))]
        return sorted(due, key=lambda one: one.due_ns)

    def take_events(self) -> list[Event]:
        events, self._events = self._events, []
        return events


def _count_due(queue: deque[Emission], now_ns: int) -> int:
    return sum(one.due_ns <= now_ns for one in queue)


@dataclass(frozen=True)
class Command:
    """One row of the table that dispatches commands, and that `lidaremu list commands acme` shows."""

    name: str
    act: Callable[[AcmeSession, int], bytes]


COMMANDS = {
    b"START": Command("stream scans", AcmeSession._start),
    b"STOP": Command("stop the stream", AcmeSession._stop),
    b"ID": Command("name and serial number", AcmeSession._identify),
}


class AcmeFamily:
    """The family as `protocols.family("acme")` gives it."""

    name = "acme"
    tcp_is_line = True
    "TCP reaches it through a serial device server."

    def new_session(self, device: Mapping[str, Any], facts: Mapping[str, Any]) -> AcmeSession:
        """A device that is switched off. Raises `DeviceSettingError`."""
        for key in device:
            if key not in {known.name for known in KEYS}:
                raise DeviceSettingError(key, device[key], ", ".join(known.name for known in KEYS))
        return AcmeSession(str(device.get("serial_number", "0001")))

    def commands(self) -> tuple[CommandRow, ...]:
        """The coverage table."""
        return tuple(CommandRow(code.decode(), row.name, "done", SOURCE) for code, row in COMMANDS.items())

    def device_keys(self) -> tuple[DeviceKey, ...]:
        """For `lidaremu list device`."""
        return KEYS

    def host(self, line: Any, baud: int) -> Any:
        """For `lidaremu look`: a host on an open line."""
        from acme_host import AcmeHost

        return AcmeHost(line)

    def script(self, line: Any, on_scan: Callable[[int, Any], None]) -> Any:
        """For `lidaremu test`: a host in virtual time."""
        from acme_host import AcmeScript

        return AcmeScript(line, on_scan)


FAMILY = AcmeFamily()
