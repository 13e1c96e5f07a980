"""Alerts of an Ouster: what is active, the log, and the byte in packets that mirrors it.

Belongs here: events and cursors. Not: what causes one (device).
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from typing import Any

KEPT = 32
"Events of the log."
KNOWN: Mapping[int, tuple[str, str, str]] = {
    0x01000015: (
        "UDP_TRANSMISSION",
        "WARNING",
        "A lidar packet could not be delivered: the port is closed at the host.",
    ),
    0x01000018: (
        "UDP_TRANSMISSION",
        "WARNING",
        "An IMU packet could not be delivered: the port is closed at the host.",
    ),
    0x01000017: ("UDP_TRANSMISSION", "WARNING", "A lidar packet could not be sent."),
    0x0100001A: ("UDP_TRANSMISSION", "WARNING", "An IMU packet could not be sent."),
    0x01000033: ("UDP_CONNECT", "WARNING", "The name of the destination cannot be resolved."),
    0x01000050: ("MOTOR_CONTROL", "WARNING", "Phase lock is off by more than the threshold."),
    0x01000051: ("MOTOR_CONTROL", "ERROR", "Phase lock has failed repeatedly."),
    0x0100000E: ("SHOT_LIMITING", "WARNING", "The sensor is hot; its laser power is reduced."),
    0x01000006: ("OVERTEMP", "ERROR", "The sensor is too hot and has shut down."),
}
"Number -> category, level, message. The numbers of the last two are ours."
UNDELIVERED = {
    (True, True): 0x01000015,
    (False, True): 0x01000018,
    (True, False): 0x01000017,
    (False, False): 0x0100001A,
}
"Of lidar or IMU packets, refused by the host or not sent."
NO_NAME, PHASE, PHASE_FAILED, HOT, TOO_HOT = 0x01000033, 0x01000050, 0x01000051, 0x0100000E, 0x01000006


class Alerts:
    """Events since power-on."""

    def __init__(self) -> None:
        self._active: dict[int, dict[str, Any]] = {}
        self._log: deque[dict[str, Any]] = deque(maxlen=KEPT)
        self._cursor = 0

    def is_active(self, number: int) -> bool:
        """Whether it is."""
        return number in self._active

    def set(self, number: int, active: bool, realtime_ns: int, verbose: str = "") -> None:
        """An alert is triggered, or cleared; no effect if it is so already."""
        if active == (number in self._active):
            return
        category, level, text = KNOWN[number]
        event = {
            "active": active, "category": category, "cursor": self._cursor, "id": f"0x{number:08X}", "level": level,
            "msg": text, "msg_verbose": verbose, "realtime": str(realtime_ns),
        }  # fmt: skip
        self._cursor = (self._cursor + 1) % (1 << 32)
        self._log.append(event)
        if active:
            self._active[number] = event
        else:
            del self._active[number]

    @property
    def flags(self) -> int:
        """As in packets: bits 0-5 cursor of the newest, bit 6 its overflow, bit 7 some are active."""
        if not self._cursor:
            return 0
        newest = self._cursor - 1
        return newest & 0x3F | (newest > 0x3F) << 6 | bool(self._active) << 7

    def reported(self, since: int = 0, summary: bool = False) -> dict[str, Any]:
        """The object of the HTTP interface, with events from a cursor on."""
        log = [one for one in self._log if one["cursor"] >= since]
        active = [one for one in self._active.values() if one["cursor"] >= since]
        if summary:
            keep = ("active", "cursor", "id", "level")
            log, active = ([{key: one[key] for key in keep} for one in some] for some in (log, active))
        return {"active": active, "log": log, "next_cursor": self._cursor}
