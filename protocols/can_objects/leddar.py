"""What the Vu8 and the M16 of LeddarTech share: requests by table, detections by segment, ports, streams.

Belongs here: which boxes a segment sees, when lists leave, how a request is taken or refused. Not: the bytes of a
detection and which request is which (leddar_vu8, leddar_m16), and numbers with their limits (leddar_holding).
Detections are made of the objects seen: one for every segment that an object's box reaches into.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from fractions import Fraction
from typing import Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray

from protocols.can_frame import EXTENDED, MAX_EXTENDED_ID, MAX_STANDARD_ID
from protocols.can_objects.leddar_holding import KBIT, RX_ID, TX_ID, Holding
from protocols.can_objects.session import CanObjectSession, Frame
from protocols.can_objects.settings import CommonSettings
from protocols.can_objects.table import Floats, ObjectTable
from protocols.errors import DeviceSettingError
from protocols.session import DropReason
from protocols.skeleton.instants import SECOND_NS
from protocols.skeleton.keys import DeviceKeys

MS = 1_000_000
RATES = tuple(1000 * kbit for kbit in KBIT)
MOST_DETECTIONS = 96
LAST_ID = 1 + MOST_DETECTIONS
"A module sends on its base identifier and on so many after it."
AMPLITUDE_AT_10_M = 20.0
"Counts that a white surface gives at 10 m; ours: it follows reflectance over distance squared."
LINES_PER_SEGMENT = 8
"Directions in which each segment is looked along."
TICK_NS = Fraction(MS)
"Of the time that opens a list."
REFUSAL = b"\xff" * 6
"Bytes 2 to 7 of an answer that refuses."
AUTOMATIC_POWER = 1 << 0
"Of the acquisition options."
RUNNING = b"\0\0\xff\0"
"After the FPGA version: run status 0xFF; hosts take anything else for a broken module."
RESTART_NS = 5 * MS
"From a software reset to the silence of the boot, so that its answer leaves; ours."
TEXT_BYTES = 32


@dataclass(frozen=True)
class LeddarSettings:
    """Keys of the scenario's `device:` table that both have."""

    common: CommonSettings
    view_rad: float
    max_range_m: float
    light_power_percent: int
    streams: bool
    serial_number: str
    device_name: str
    hardware_part: str
    software_part: str
    fpga: int
    port: Mapping[str, int]

    @classmethod
    def common_of(
        cls, keys: DeviceKeys, field_deg: float, range_m: float, name: str, part_bytes: int = TEXT_BYTES
    ) -> dict[str, Any]:
        """Take the common keys; raises `DeviceSettingError`."""
        common = CommonSettings.read(keys, 1_000_000, RATES)
        port = {
            "tx_id": keys.integer(
                "tx_base_id", "first identifier that it sends on, until a host sets another", TX_ID, 0, 0x79E
            ),
            "rx_id": keys.integer(
                "rx_base_id", "identifier of requests, until a host sets another", RX_ID, 0, MAX_STANDARD_ID
            ),
            "extended": int(keys.flag("extended_ids", "identifiers have 29 bits", False)),
            "baud_code": RATES.index(common.bitrate),
        }
        if Port.refusal(port) is not None:
            last = port["tx_id"] + LAST_ID
            raise DeviceSettingError("rx_base_id", port["rx_id"], f"an identifier outside of {port['tx_id']} to {last}")
        return {
            "common": common,
            "view_rad": np.radians(keys.number("field_deg", "horizontal field of view", field_deg, 1.0, 100.0)),
            "max_range_m": keys.number("max_range_m", "farther objects give no detection", range_m, 0.0, 655.35),
            "light_power_percent": keys.integer(
                "light_power_percent", "reported while the power is automatic", 100, 0, 100
            ),
            "streams": keys.choice(
                "streaming", "whether it streams at power-on or when asked", "request", ("request", "start")
            )
            == "start",
            "serial_number": keys.text("serial_number", "in input data", "AE00001", TEXT_BYTES),
            "device_name": keys.text("device_name", "in input data", name, TEXT_BYTES),
            "hardware_part": keys.text("hardware_part", "in input data", "75H0004", part_bytes),
            "software_part": keys.text("software_part", "in input data", "60D0001", part_bytes),
            "fpga": keys.integer("fpga", "version in input data", 1, 0, 0xFFFF),
            "port": port,
        }


@dataclass(frozen=True)
class Command:
    """One request: the row that dispatches it and that the coverage table shows."""

    name: str
    handler: Any
    "(session, eight bytes, now_ns) -> the answer's bytes 1 to 7, a text why it is refused, or None for no answer."
    whole: bool = False
    "Shorter frames are refused: what is missing would be taken for zeros."
    note: str = ""


class Port(NamedTuple):
    """Identifiers that a module speaks on, as they were when it started."""

    extended: bool
    tx_id: int
    rx_id: int

    @classmethod
    def of(cls, holding: Holding) -> Port:
        return cls(bool(holding["extended"]), holding["tx_id"], holding["rx_id"])

    @staticmethod
    def refusal(values: Mapping[str, int]) -> str | None:
        """Why these values name no port: identifiers fit the frame format, and the request is none of the answers."""
        most = MAX_EXTENDED_ID if values["extended"] else MAX_STANDARD_ID
        if values["tx_id"] + LAST_ID > most or values["rx_id"] > most:
            return f"identifiers {values['tx_id']:#x} and {values['rx_id']:#x} do not fit the frame format"
        if values["tx_id"] <= values["rx_id"] <= values["tx_id"] + LAST_ID:
            return f"request identifier {values['rx_id']:#x} is one of its own"
        return None


class Detections(NamedTuple):
    """Detections of a list, highest segment first."""

    segment: NDArray[np.int64]
    distance_raw: NDArray[np.int64]
    "In the unit that the holding data name."
    amplitude: Floats


class LeddarSession(CanObjectSession):
    """A module that measures a distance for each segment."""

    COMMANDS: ClassVar[Mapping[int, Command]]
    SEGMENTS: ClassVar[int]
    THRESHOLD_SCALE: ClassVar[int]
    clock_tick_ns = TICK_NS
    clock_bits = 32

    def __init__(self, settings: LeddarSettings, holding: Holding, inputs: Mapping[int, bytes]) -> None:
        self._leddar = settings
        self._holding = holding
        self._inputs = inputs
        self._port = Port.of(holding)
        super().__init__(settings.common)
        self._reset(0)

    def _shift(self) -> int:
        return 0

    def _reset(self, now_ns: int) -> None:
        self._streaming = self._leddar.streams
        self._once = False
        self._port = Port.of(self._holding)
        self.clock = self.clock.powered_on(now_ns)

    def _start(self, now_ns: int) -> None:
        """Nothing leaves unasked."""

    def _lists_wanted(self) -> bool:
        return self._streaming or self._once

    def _rebuild_dispatch(self) -> None:
        flag = EXTENDED if self._port.extended else 0
        self._dispatch = {self._port.rx_id | flag: self.HOST_MESSAGES[0]}

    def _identifier(self, offset: int) -> int:
        return (self._port.tx_id + offset) | (EXTENDED if self._port.extended else 0)

    # Lists

    @abstractmethod
    def _measuring_ns(self) -> int:
        """Time of one measurement of all segments, by the configuration."""

    @abstractmethod
    def _detection_frames(self, found: Detections) -> list[Frame]:
        """The detections of a list, as its frames behind the first."""

    def _cycle_ns(self) -> int:
        delay_ns = self._holding["cycle_delay_ms"] * MS
        measuring_ns = self._measuring_ns()
        return max(measuring_ns, self._list_duration_ns + delay_ns) if delay_ns else measuring_ns

    def _gap_ns(self) -> int:
        return self._holding["message_delay_ms"] * MS

    def _light_power(self) -> int:
        automatic = self._holding["acquisition_options"] & AUTOMATIC_POWER
        return self._leddar.light_power_percent if automatic else self._holding["light_power"]

    def _enabled(self) -> NDArray[np.bool_]:
        """Segments that measure."""
        return np.asarray((self._holding["segments_off"] >> np.arange(self.SEGMENTS)) & 1 == 0)

    def _sent_segments(self) -> NDArray[np.bool_]:
        """Segments whose detections are sent."""
        return self._enabled()

    def _encode_list(self, table: ObjectTable, now_ns: int, measured_ns: int) -> list[Frame]:
        if self._once and not self._streaming:
            self._restart_raster(now_ns)
        self._once = False
        found = self._detections(table.take(table.coasting_s <= 0.0))
        self._reported = self.clock.reported(measured_ns, TICK_NS, 32)
        payload = self._layout["DetectionCount"].frame(
            {
                "NumDetections": len(found.segment),
                "LightPower": self._light_power(),
                "Timestamp": self._reported.ticks,
            }
        )
        return [Frame(self._identifier(1), payload, "DetectionCount"), *self._detection_frames(found)]

    def _detections(self, seen: ObjectTable) -> Detections:
        distance, reflectance = self._segments(seen)
        amplitude = AMPLITUDE_AT_10_M * reflectance * (10.0 / np.maximum(distance, 0.1)) ** 2
        amplitude *= self._light_power() / 100.0
        threshold = self._holding["threshold"] / self.THRESHOLD_SCALE
        reported = np.isfinite(distance) & self._sent_segments() & (amplitude >= threshold)
        segments = np.flatnonzero(reported)[::-1][: self._holding["max_detections"]]
        raw = np.rint(distance[segments] * self._holding["units_per_m"]).clip(0, 0xFFFF).astype(np.int64)
        return Detections(segments.astype(np.int64), raw, amplitude[segments])

    def _segments(self, table: ObjectTable) -> tuple[Floats, Floats]:
        """Distance and reflectance of the nearest box in each segment, NaN where there is none.

        Segment 0 is the leftmost one.
        """
        count, view = self.SEGMENTS, self._leddar.view_rad
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
        hit = (entry <= leave) & (entry > 0.0) & (entry <= self._leddar.max_range_m)
        distance = np.where(hit, entry, np.inf)
        if not len(table):
            return np.full(count, np.nan), np.zeros(count)
        by_segment = distance.reshape(len(table), count, LINES_PER_SEGMENT).min(axis=2)
        nearest = by_segment.argmin(axis=0)
        best = by_segment[nearest, np.arange(count)]
        return np.where(np.isfinite(best), best, np.nan), table.reflectance[nearest]

    # Requests

    @abstractmethod
    def _answer(self, request: bytes, rest: bytes) -> Frame:
        """The frame that answers a request with these bytes 1 to 7."""

    def _request(self, data: bytes, now_ns: int, link: int) -> None:
        request = data.ljust(8, b"\0")
        command = self.COMMANDS.get(request[0])
        if command is None:
            self._drop(now_ns, DropReason.UNKNOWN_COMMAND, f"request {request[0]}")
            self._send_reply([self._answer(request, request[1:2] + REFUSAL)], now_ns, link)
            return
        if command.whole and len(data) < 8:
            outcome: bytes | str | None = f"{len(data)} bytes; want 8"
        else:
            outcome = command.handler(self, request, now_ns)
        if isinstance(outcome, str):
            self._drop(now_ns, DropReason.BAD_ARGUMENT, f"{command.name}: {outcome}")
            self._handled(now_ns, command.name, "refused")
            outcome = request[1:2] + REFUSAL
        else:
            self._handled(now_ns, command.name)
        if outcome is not None:
            self._send_reply([self._answer(request, outcome)], now_ns, link)

    def _begin(self, once: bool, now_ns: int) -> None:
        """Lists are wanted: one, or one after the other."""
        if not self._lists_wanted():
            self._restart_raster(now_ns)
        self._once, self._streaming = once, self._streaming or not once

    def _stop(self, request: bytes, now_ns: int) -> bytes | None:
        self._streaming = self._once = False
        return request[1:]

    def _get_input(self, request: bytes, now_ns: int) -> bytes | str:
        found = self._inputs.get(request[1])
        return f"no input data {request[1]}" if found is None else request[1:2] + found

    def _get_holding(self, request: bytes, now_ns: int) -> bytes | str:
        found = self._holding.get(request[1])
        return f"no holding data {request[1]}" if found is None else request[1:2] + found

    def _set_holding(self, request: bytes, now_ns: int) -> bytes | str:
        asked = self._holding.asked(request[1], request[2:])
        if isinstance(asked, dict):
            asked = self._take(asked, now_ns)
        return asked if isinstance(asked, str) else request[1:]

    def _take(self, asked: dict[str, int], now_ns: int) -> dict[str, int] | str:
        """Values that were checked one by one come into force; a text says why they do not go together."""
        values = self._holding.values | asked
        refusal = Port.refusal(values) or self._unfit(values)
        if refusal is not None:
            return refusal
        before, self._holding.values = self._measuring_ns(), values
        if self._measuring_ns() != before:
            self._restart_raster(now_ns)
        return asked

    def _unfit(self, values: Mapping[str, int]) -> str | None:
        """Why values do not go together, beside those of the port."""
        return None

    def _restart(self, now_ns: int) -> None:
        """Restart once the answer has left."""
        self._timers.add(now_ns + RESTART_NS, SECOND_NS, self.power_on)
