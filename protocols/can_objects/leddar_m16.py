"""LeddarTech M16 and IS16: distances of sixteen segments, two in a frame, on identifiers 0x740 and 0x750 and up.

Belongs here: its requests, its detections. Source: the maker's SDK (`LtComM16Canbus.h`, `LdProtocolCan.cpp`,
`LdSensorM16Can.cpp`), whose conversation is a test, and `leddar_can` (legacy requests 1 and 2, a dlc of one).
Unlike the Vu8 it stops at 3 and starts at 5, answers on the identifier of the counts with the request + 128, and
detections have the base identifier; requests that start and stop are not answered.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from protocols.can_objects.leddar import RUNNING, Command, Detections, LeddarSession, LeddarSettings
from protocols.can_objects.leddar_holding import (
    M16_HOLDING,
    M16_INPUT,
    M16_SEGMENTS,
    THRESHOLD_SCALE,
    Holding,
    input_frames,
)
from protocols.can_objects.session import Frame, HostMessage
from protocols.skeleton.instants import SECOND_NS
from protocols.skeleton.keys import DeviceKeys

ANSWER = 128
MULTI_ID, FLAGGED = 1 << 0, 1 << 3
"Of the operation mode: one identifier for each message; one detection with its flags in a message."
KINDS = {"m16": 9, "m16_laser": 14, "is16": 8}
"Device type by kind (LtComLeddarTechPublic.h)."
OF_KIND = {"m16": 1, "m16_laser": 1, "is16": 0}
"Holding data that a kind does not have: the refresh rate, or the acquisition configuration."
BASE_RATE_HZ = 12_800
"Measurements a second are this over 2^n (LdSensorM16Can.cpp)."
PART_BYTES = 16
"Longest part number (LtComM16Canbus.h)."
SLOWEST, FASTEST = 13, 7
"Of n: 1.5625 to 100 measurements a second."


@dataclass(frozen=True)
class Settings(LeddarSettings):
    """The scenario's `device:` table."""

    kind: str
    temperature_c: float
    firmware: int

    @classmethod
    def read(cls, keys: DeviceKeys) -> Settings:
        """Check a table; raises `DeviceSettingError`."""
        common = cls.common_of(keys, 45.0, 50.0, "M16", PART_BYTES)
        settings = cls(
            **common,
            kind=keys.choice("kind", "which of the modules with sixteen segments", "m16", tuple(KINDS)),
            temperature_c=keys.number("temperature_c", "in input data", 30.0, -100.0, 150.0),
            firmware=keys.integer("firmware", "version in input data", 1, 0, 0xFFFF),
        )
        keys.finish()
        return settings

    def contents(self) -> dict[str, bytes]:
        """Input data by their names in `M16_INPUT`; the SDK reads the temperature from byte 4 on."""
        temperature = round(self.temperature_c * 65536)
        return {
            "temperature": b"\0\0" + temperature.to_bytes(4, "little", signed=True),
            "device identification and options": KINDS[self.kind].to_bytes(2, "little"),
            "firmware version": self.firmware.to_bytes(2, "little"),
            "FPGA version and run status": self.fpga.to_bytes(2, "little") + RUNNING,
            "serial number": self.serial_number.encode("ascii"),
            "device name": self.device_name.encode("utf-16-le"),
            "software part number": self.software_part.encode("ascii"),
            "hardware part number": self.hardware_part.encode("ascii"),
        }


class LeddarM16Session(LeddarSession):
    """One M16, M16 laser or IS16."""

    LAYOUT_FILE: ClassVar[str] = "leddar_m16.dbc"
    SEGMENTS: ClassVar[int] = M16_SEGMENTS
    THRESHOLD_SCALE: ClassVar[int] = THRESHOLD_SCALE["m16"]

    def __init__(self, settings: Settings) -> None:
        self._settings = settings
        groups = {code: group for code, group in M16_HOLDING.items() if code != OF_KIND[settings.kind]}
        super().__init__(settings, Holding(groups, settings.port), input_frames(M16_INPUT, settings.contents()))

    def _reset(self, now_ns: int) -> None:
        super()._reset(now_ns)
        self._mode_bits = self._holding["port_options"]

    def _rate_exponent(self, values: Mapping[str, int]) -> int:
        names = ("refresh_code",) if self._settings.kind == "is16" else ("accumulation_exp", "oversampling_exp")
        return sum(values[name] for name in names)

    def _measuring_ns(self) -> int:
        return round(SECOND_NS * 2.0 ** self._rate_exponent(self._holding.values) / BASE_RATE_HZ)

    def _unfit(self, values: Mapping[str, int]) -> str | None:
        exponent = self._rate_exponent(values)
        if FASTEST <= exponent <= SLOWEST:
            return None
        return f"accumulation and oversampling exponents {exponent} together; want {FASTEST} to {SLOWEST}"

    def _enabled(self) -> NDArray[np.bool_]:
        off = self._holding["segments_off"]
        pairs = off | (off & 0xAAAA) >> 1 | (off & 0x5555) << 1
        return np.asarray((pairs >> np.arange(M16_SEGMENTS)) & 1 == 0)

    def _sent_segments(self) -> NDArray[np.bool_]:
        on = (self._holding["segments_on"] >> np.arange(M16_SEGMENTS)) & 1 == 1
        return np.asarray(self._enabled() & on)

    def _detection_frames(self, found: Detections) -> list[Frame]:
        count = len(found.segment)
        if self._mode_bits & FLAGGED:
            name, message = "FlaggedDetection", self._layout["FlaggedDetection"]
            top = message.signals["Amplitude"]
            saturated = found.amplitude >= top.raw_max * top.scale
            raw: dict[str, NDArray[np.int64] | int] = {
                "Distance": found.distance_raw,
                "FlagValid": 1,
                "FlagSaturated": saturated.astype(np.int64),
                "Segment": found.segment,
            }
            payloads = message.frames(count, raw, Amplitude=found.amplitude)
        else:
            name, message = "Detections", self._layout["Detections"]
            first, second = slice(0, None, 2), slice(1, None, 2)
            pairs = -(-count // 2)
            rest = np.zeros(pairs - count // 2, dtype=np.int64)  # the last frame's second half, where there is none
            payloads = message.frames(
                pairs,
                {
                    "Distance1": found.distance_raw[first],
                    "Segment1": found.segment[first],
                    "Distance2": np.append(found.distance_raw[second], rest),
                    "Segment2": np.append(found.segment[second], rest),
                },
                Amplitude1=found.amplitude[first],
                Amplitude2=np.append(found.amplitude[second], rest),
            )
        multi = self._mode_bits & MULTI_ID
        return [Frame(self._identifier(2 + k if multi else 0), payload, name) for k, payload in enumerate(payloads)]

    def _answer(self, request: bytes, rest: bytes) -> Frame:
        return Frame(self._identifier(1), bytes((request[0] | ANSWER,)) + rest, "Answer")

    # Requests: those that start and stop have no answer

    def _halt(self, request: bytes, now_ns: int) -> None:
        self._stop(request, now_ns)

    def _send_once(self, request: bytes, now_ns: int) -> None:
        self._mode_bits = request[1]
        self._begin(True, now_ns)

    def _stream(self, request: bytes, now_ns: int) -> None:
        self._mode_bits = request[1]
        self._begin(False, now_ns)

    def _send_once_legacy(self, request: bytes, now_ns: int) -> None:
        self._mode_bits = self._holding["port_options"]
        self._begin(True, now_ns)

    def _stream_legacy(self, request: bytes, now_ns: int) -> None:
        self._mode_bits = self._holding["port_options"]
        self._begin(False, now_ns)

    HOST_MESSAGES: ClassVar[tuple[HostMessage, ...]] = (
        HostMessage("Request", LeddarSession._request, 1, "leddartech/LeddarSDK", note="each request below"),
    )
    COMMANDS: ClassVar[Mapping[int, Command]] = {
        1: Command("send once, legacy", _send_once_legacy, note="no answer; in the mode of port configuration 3"),
        2: Command("stream, legacy", _stream_legacy, note="no answer; in the mode of port configuration 3"),
        3: Command("stop stream", _halt, note="no answer"),
        4: Command("send once", _send_once, note="no answer; argument: operation mode"),
        5: Command("stream", _stream, note="no answer; argument: operation mode"),
        6: Command("get input data", LeddarSession._get_input),
        7: Command("get holding data", LeddarSession._get_holding),
        8: Command("set holding data", LeddarSession._set_holding, True, "all values of a frame or none; kept"),
    }


SENT = (
    ("Detections", "leddartech/LeddarSDK", "two in a frame, on the base identifier, or one identifier for each frame"),
    ("DetectionCount", "leddartech/LeddarSDK", "opens a list; with byte 0 from 128 on it is an answer"),
    ("FlaggedDetection", "leddartech/LeddarSDK", "in the mode with flags, on the identifiers of `Detections`"),
)
"Messages of the device: name in the DBC, source, note."


SESSION = LeddarM16Session
