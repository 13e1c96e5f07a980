"""Observer of an instrument: every payload with the instants of its first and last bit, scans, events.

Belongs here: the contract, and when bytes leave a line whatever the clock of the run. Not: what is done with it
(transcript, series, recording).
"""

from __future__ import annotations

from copy import deepcopy
from dataclasses import dataclass

from emulator.faults.events import FaultEvent
from emulator.transports.pacing import PacedLine, leave_ns
from protocols.device_clock import DeviceStamp
from protocols.scan import Scan
from protocols.session import Emission, Event

FOREVER_NS = 2**62
MOST_SINCE = 32


@dataclass(frozen=True)
class Payload:
    """Bytes on one link, in one piece."""

    sensor: str
    link: int
    "Index into the sensor's links."
    peer: int
    "Connection, remote port or CAN identifier; 0 on a line and for everybody."
    data: bytes
    start_ns: int
    "Sent: when its first bit begins. Received: when it was taken in."
    end_ns: int
    "Sent: when its last bit has left. Received: the same as the start."
    sent: bool
    "By the device; False: by a host."
    label: str = ""
    sweep: int | None = None
    "Whose scan it carries, on CAN the first frame of it; None for a reply and for what hosts send."
    pace: tuple[int, int, int] | None = None
    "Of a paced line: when the run of bytes began, how many of it came before these, baud."

    def leaves_ns(self, index: int) -> int:
        """When that byte has left."""
        return self.end_ns if self.pace is None else leave_ns(self.pace[0], self.pace[1] + index + 1, self.pace[2])


class Observer:
    """Observes; every method may be left as it is."""

    def payload(self, payload: Payload) -> None:
        """Bytes that will leave, or came in."""

    def departed(self, sensor: str, link: int, due_ns: int, actual_ns: int) -> None:
        """What should have left by `due_ns`, its last bit, had left by `actual_ns`. In real time alone."""

    def cut(self, sensor: str, link: int, end_ns: int) -> None:
        """What was ordered to leave on a line does so no further than this."""

    def scan(self, sensor: str, scan: Scan) -> None:
        """A sweep that the device has taken."""

    def reported(self, sensor: str, sweep: int, reported: DeviceStamp) -> None:
        """What a scan's telegram reports of the device's time; once for each host and link that gets it."""

    def event(self, sensor: str, event: Event | FaultEvent) -> None:
        """Something the session reported, or that a fault did."""


class LineTimes:
    """When payloads leave a line that is paced: the link's own arithmetic, ahead of its clock."""

    def __init__(self, speed: int | None = None) -> None:
        self._line = PacedLine(speed)
        "With all that was handed over gone."
        self._present = PacedLine(speed)
        "As it was when something was handed over last: what has not left yet can still be slowed or forgotten."
        self._since: list[tuple[int, bytes, int, int | None]] = []
        "Handed over, but not given to it yet: most runs never look at it."

    def set_speed(self, now_ns: int, baud: int | None) -> None:
        """The line has another speed from now on, whatever is on it."""
        self._catch_up()
        self._present.take(now_ns)
        self._present.set_speed(baud)
        self._foresee()

    def clear(self, now_ns: int) -> None:
        """What has not left by now never does."""
        self._catch_up()
        self._present.take(now_ns)
        self._present.clear()
        self._foresee()

    def cut(self, now_ns: int) -> int:
        """What is leaving ends with the byte that is on its way; when that has left."""
        self._catch_up()
        self._present.take(now_ns)
        self._present.cut(now_ns)
        self._foresee()
        return self._line.busy_until_ns

    def _catch_up(self) -> None:
        for seen_ns, data, due_ns, line_speed in self._since:
            self._present.take(seen_ns)
            self._present.put(data, due_ns, line_speed)
        self._since.clear()

    def _foresee(self) -> None:
        self._line = deepcopy(self._present)
        self._line.take(FOREVER_NS)

    def of_emission(self, emission: Emission) -> tuple[int, int, tuple[int, int, int] | None]:
        """First and last instant of a telegram and its pace; with a pause in it, the pace is that of its end."""
        data, pause = emission.payload, emission.pause
        if pause is None:
            return self.of(data, emission.due_ns, emission.line_speed)
        start_ns, _, _ = self.of(data[: pause[0]], emission.due_ns, None)
        _, end_ns, pace = self.of(data[pause[0] :], pause[1], emission.line_speed, emission.due_ns)
        return start_ns, end_ns, None if pace is None else (pace[0], pace[1] - pause[0], pace[2])

    def of(
        self, data: bytes, due_ns: int, line_speed: int | None, seen_ns: int | None = None
    ) -> tuple[int, int, tuple[int, int, int] | None]:
        """First and last bit, and pace, of a payload handed over with these arguments, in the order of handing over.

        `seen_ns`: until when the line is known to have gone on; None: until the payload is due.
        """
        self._since.append((due_ns if seen_ns is None else seen_ns, data, due_ns, line_speed))
        if len(self._since) >= MOST_SINCE:
            self._catch_up()
        self._line.put(data, due_ns, line_speed)
        for left in self._line.take(FOREVER_NS):
            start_ns = leave_ns(left.run_ns, left.run_index, left.speed)
            return start_ns, left.last_ns, None if left.speed is None else (left.run_ns, left.run_index, left.speed)
        return due_ns, due_ns, None
