"""LeddarTech Vu8 / M16: distances by segment, asked for or streamed, on identifiers 0x740 to 0x752 and up.

Belongs here: the whole format. Bits from `leddar_vu8.dbc`, requests from LeddarTech's user documentation.
Detections are made of the objects seen: one for every segment that an object's box reaches into.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from fractions import Fraction
from typing import ClassVar

import numpy as np

from protocols.can_objects.session import CanObjectSession, Frame, HostMessage
from protocols.can_objects.settings import CommonSettings
from protocols.can_objects.table import Floats, ObjectTable
from protocols.session import DropReason
from protocols.skeleton.keys import DeviceKeys

STOP, ONCE, STREAM = 1, 2, 3
FUNCTIONS = {
    4: "get input data",
    5: "get holding data",
    6: "set holding data",
    7: "set base ids",
    8: "read module",
    9: "write module",
    10: "opcode",
}
"Known requests whose fields no public source has: answered with the device's refusal."

MULTI_ID = 1
MAX_DETECTIONS = 96
AMPLITUDE_AT_10_M = 20.0
"Counts that a white surface gives at 10 m; ours: it follows reflectance over distance squared."
LINES_PER_SEGMENT = 8
"Directions in which each segment is looked along."
TICK_NS = Fraction(1_000_000)
"Of the time in 0x751."
REFUSAL = b"\xff" * 6


@dataclass(frozen=True)
class Settings:
    """The scenario's `device:` table."""

    common: CommonSettings
    cycle_ns: int
    segments: int
    view_rad: float
    max_range_m: float
    light_power_percent: int
    streams: bool
    multi_id: bool

    @classmethod
    def read(cls, keys: DeviceKeys) -> Settings:
        """Check a table; raises `DeviceSettingError`."""
        rates = (1_000_000, 500_000, 250_000, 125_000, 100_000, 50_000, 20_000, 10_000)
        settings = cls(
            common=CommonSettings.read(keys, 1_000_000, rates),
            cycle_ns=round(keys.number("cycle_ms", "from frame to frame of a stream", 40.0, 5.0, 10_000.0) * 1e6),
            segments=round(keys.number_of("segments", "segments of the field", 8, (8, 16))),
            view_rad=math.radians(keys.number("field_deg", "horizontal field of view", 48.0, 1.0, 100.0)),
            max_range_m=keys.number("max_range_m", "farther objects give no detection", 215.0, 0.0, 655.35),
            light_power_percent=keys.integer("light_power_percent", "in 0x751", 100, 0, 100),
            streams=keys.choice(
                "streaming", "whether it streams at power-on or when asked", "request", ("request", "start")
            )
            == "start",
            multi_id=keys.flag("multi_id", "one identifier for each detection at power-on", False),
        )
        keys.finish()
        return settings


class LeddarVu8Session(CanObjectSession):
    """One Vu8 or M16."""

    LAYOUT_FILE: ClassVar[str] = "leddar_vu8.dbc"
    clock_tick_ns = TICK_NS
    clock_bits = 32

    def __init__(self, settings: Settings) -> None:
        self._settings = settings
        super().__init__(settings.common)
        self._reset(0)

    def _shift(self) -> int:
        return 0

    def _reset(self, now_ns: int) -> None:
        self._streaming = self._settings.streams
        self._multi_id = self._settings.multi_id
        self._once = False
        self.clock = self.clock.powered_on(now_ns)

    def _start(self, now_ns: int) -> None:
        """Nothing leaves unasked."""

    def _cycle_ns(self) -> int:
        return self._settings.cycle_ns

    def _lists_wanted(self) -> bool:
        return self._streaming or self._once

    def _encode_list(self, table: ObjectTable, now_ns: int, measured_ns: int) -> list[Frame]:
        if self._once and not self._streaming:
            self._restart_raster(now_ns)
        self._once = False
        seen = table.take(table.coasting_s <= 0.0)
        distance, reflectance = self._segments(seen)
        segments = np.flatnonzero(np.isfinite(distance))[::-1][:MAX_DETECTIONS]  # highest first
        amplitude = AMPLITUDE_AT_10_M * reflectance[segments] * (10.0 / np.maximum(distance[segments], 0.1)) ** 2
        message = self._layout["Detection"]
        top = message.signals["Amplitude"]
        saturated = amplitude >= top.raw_max * top.scale
        payloads = message.frames(
            len(segments),
            {"FlagValid": 1, "FlagSaturated": saturated.astype(np.int64), "Segment": segments},
            Distance=distance[segments],
            Amplitude=amplitude,
        )
        self._told = self.clock.told(measured_ns, TICK_NS, 32)
        head = self._frame(
            "DetectionCount",
            {
                "NumDetections": len(segments),
                "LightPower": self._settings.light_power_percent,
                "Timestamp": self._told.ticks,
            },
        )
        step = int(self._multi_id)
        return [
            head,
            *(Frame(message.identifier + step * k, payload, "Detection") for k, payload in enumerate(payloads)),
        ]

    def _segments(self, table: ObjectTable) -> tuple[Floats, Floats]:
        """Distance and reflectance of the nearest box in each segment, NaN where there is none.

        Segment 0 is the leftmost one.
        """
        count, view = self._settings.segments, self._settings.view_rad
        lines = count * LINES_PER_SEGMENT
        azimuth = view * (0.5 - (np.arange(lines) + 0.5) / lines)
        cosine, sine = np.cos(table.yaw_rad), np.sin(table.yaw_rad)
        # the sensor and the lines in each box's own frame
        origin = np.stack([-(table.x_m * cosine + table.y_m * sine), table.x_m * sine - table.y_m * cosine], axis=-1)
        turned = azimuth[None, :] - table.yaw_rad[:, None]
        direction = np.stack([np.cos(turned), np.sin(turned)], axis=-1)
        half = 0.5 * np.stack([table.length_m, table.width_m], axis=-1)
        with np.errstate(divide="ignore", invalid="ignore"):
            near = (-half[:, None, :] - origin[:, None, :]) / direction
            far = (half[:, None, :] - origin[:, None, :]) / direction
        entry = np.fmax.reduce(np.fmin(near, far), axis=-1)
        leave = np.fmin.reduce(np.fmax(near, far), axis=-1)
        hit = (entry <= leave) & (entry > 0.0) & (entry <= self._settings.max_range_m)
        distance = np.where(hit, entry, np.inf)
        if not len(table):
            return np.full(count, np.nan), np.zeros(count)
        by_segment = distance.reshape(len(table), count, LINES_PER_SEGMENT).min(axis=2)
        nearest = by_segment.argmin(axis=0)
        best = by_segment[nearest, np.arange(count)]
        return np.where(np.isfinite(best), best, np.nan), table.reflectance[nearest]

    def _request(self, data: bytes, now_ns: int, link: int) -> None:
        padded = data.ljust(8, b"\0")
        values = self._layout.decode("Request", padded)
        function = int(values["Function"])
        if function in (ONCE, STREAM):
            self._multi_id = int(values["Argument"]) == MULTI_ID
            if not self._lists_wanted():
                self._restart_raster(now_ns)
            self._once, self._streaming = function == ONCE, self._streaming or function == STREAM
            self._handled(now_ns, "stream" if function == STREAM else "send once")
        elif function == STOP:
            self._streaming = self._once = False
            self._handled(now_ns, "stop stream")
        else:
            name = FUNCTIONS.get(function)
            reason = DropReason.UNKNOWN_COMMAND if name is None else DropReason.REFUSED
            self._drop(now_ns, reason, name or f"request {function}")
            if name is not None:
                self._handled(now_ns, name, "refused")
            padded = padded[:2] + REFUSAL
        identifier = self._layout.identifier("Answer")
        self._send_reply([Frame(identifier, padded, "Answer")], now_ns, link)

    HOST_MESSAGES: ClassVar[tuple[HostMessage, ...]] = (
        HostMessage(
            "Request", _request, 1, "LeddarTech Vu8 user guide", note="1 stop, 2 send once, 3 stream; 4 to 10 refused"
        ),
    )


SENT = (
    ("Answer", "LeddarTech Vu8 user guide", "the request again; bytes 2 to 7 are 0xFF when it is refused"),
    ("DetectionCount", "LeddarTech Vu8 user guide", "opens a list"),
    ("Detection", "LeddarTech Vu8 user guide", "one identifier, or one each with multi-id"),
)
"Messages of the device: name in the DBC, source, note."


SESSION = LeddarVu8Session
