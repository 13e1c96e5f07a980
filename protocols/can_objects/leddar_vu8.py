"""LeddarTech Vu8: distances of eight segments, asked for or streamed, on identifiers 0x740 to 0x752 and up.

Belongs here: its requests, its detections. Bits from `leddar_vu8.dbc`; requests from LeddarTech's user guide 54A0028,
section 5.5, and from the maker's SDK (`LdProtocolCan.cpp`, `LdSensorVu8Can.cpp`), whose conversation is a test.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from protocols.can_objects.leddar import RUNNING, Command, Detections, LeddarSession, LeddarSettings
from protocols.can_objects.leddar_holding import (
    THRESHOLD_SCALE,
    VU8_HOLDING,
    VU8_INPUT,
    VU8_SEGMENTS,
    Holding,
    input_frames,
)
from protocols.can_objects.leddar_memory import Memory
from protocols.can_objects.session import Frame, HostMessage
from protocols.skeleton.keys import DeviceKeys

MULTI_ID = 1
DEVICE_TYPE = 13
"LeddarVu8 (user guide, table 64)."
WRITE_DISABLE, READ_STATUS, WRITE_ENABLE, SOFTWARE_RESET, RESET_CONFIGURATION = 0x04, 0x05, 0x06, 0x99, 0xC7
"Opcodes (user guide, table 15); reading and writing have requests of their own."
WRITE_ENABLED = 1 << 1
"Of the status; bit 0 is `busy` (the maker's registerMap.h)."


@dataclass(frozen=True)
class Settings(LeddarSettings):
    """The scenario's `device:` table."""

    cycle_ns: int
    multi_id: bool
    firmware: tuple[int, ...]
    bootloader: tuple[int, ...]

    @classmethod
    def read(cls, keys: DeviceKeys) -> Settings:
        """Check a table; raises `DeviceSettingError`."""
        common = cls.common_of(keys, 48.0, 215.0, "LeddarVu8")
        settings = cls(
            **common,
            cycle_ns=round(
                keys.number("cycle_ms", "from list to list with the accumulations it is made with", 40.0, 5.0, 10_000.0)
                * 1e6
            ),
            multi_id=keys.flag("multi_id", "one identifier for each detection at power-on", False),
            firmware=keys.integers("firmware", "version A, B, C, D in input data", (3, 0, 0, 1), 0, 0xFFFF),
            bootloader=keys.integers("bootloader", "version A, B, C, D in input data", (1, 0, 0, 1), 0, 0xFFFF),
        )
        keys.finish()
        return settings

    def contents(self) -> dict[str, bytes]:
        """Input data by their names in `VU8_INPUT`."""
        return {
            "number of segments": VU8_SEGMENTS.to_bytes(2, "little"),
            "device identification and options": DEVICE_TYPE.to_bytes(2, "little"),
            "firmware version": np.array(self.firmware, "<u2").tobytes(),
            "bootloader version": np.array(self.bootloader, "<u2").tobytes(),
            "FPGA version and run status": self.fpga.to_bytes(2, "little") + RUNNING,
            "serial number": self.serial_number.encode("ascii"),
            "device name": self.device_name.encode("ascii"),
            "hardware part number": self.hardware_part.encode("ascii"),
            "software part number": self.software_part.encode("ascii"),
        }


class LeddarVu8Session(LeddarSession):
    """One Vu8."""

    LAYOUT_FILE: ClassVar[str] = "leddar_vu8.dbc"
    SEGMENTS: ClassVar[int] = VU8_SEGMENTS
    THRESHOLD_SCALE: ClassVar[int] = THRESHOLD_SCALE["vu8"]

    def __init__(self, settings: Settings) -> None:
        self._settings = settings
        holding = Holding(VU8_HOLDING, settings.port)
        self._memory = Memory(holding, settings)
        self._start_exponent = holding["accumulation_exp"] + holding["oversampling_exp"]
        super().__init__(settings, holding, input_frames(VU8_INPUT, settings.contents()))

    def _reset(self, now_ns: int) -> None:
        super()._reset(now_ns)
        self._multi_id = self._settings.multi_id
        self._base = 0
        self._write_enabled = False
        self._memory.clear()

    def _measuring_ns(self) -> int:
        # base rate / (segments enabled + 1) / accumulations / oversamplings (user guide, section 4.4)
        exponent = self._holding["accumulation_exp"] + self._holding["oversampling_exp"] - self._start_exponent
        measured = int(self._enabled().sum()) + 1
        return round(self._settings.cycle_ns * 2.0**exponent * measured / (VU8_SEGMENTS + 1))

    def _detection_frames(self, found: Detections) -> list[Frame]:
        message = self._layout["Detection"]
        top = message.signals["Amplitude"]
        saturated = found.amplitude >= top.raw_max * top.scale
        payloads = message.frames(
            len(found.segment),
            {
                "Distance": found.distance_raw,
                "FlagValid": 1,
                "FlagSaturated": saturated.astype(np.int64),
                "Segment": found.segment,
            },
            Amplitude=found.amplitude,
        )
        rows = zip(found.segment.tolist(), found.distance_raw.tolist(), found.amplitude.tolist(), strict=True)
        self._memory.listed(rows, self._reported.ticks if self._reported is not None else 0, self._light_power())
        step = int(self._multi_id)
        return [Frame(self._identifier(2 + step * k), payload, "Detection") for k, payload in enumerate(payloads)]

    def _answer(self, request: bytes, rest: bytes) -> Frame:
        return Frame(self._identifier(0), request[:1] + rest, "Answer")

    # Requests

    def _send_once(self, request: bytes, now_ns: int) -> bytes:
        self._multi_id = bool(request[1] & MULTI_ID)
        self._begin(True, now_ns)
        return request[1:]

    def _stream(self, request: bytes, now_ns: int) -> bytes:
        self._multi_id = bool(request[1] & MULTI_ID)
        self._begin(False, now_ns)
        return request[1:]

    def _get_input(self, request: bytes, now_ns: int) -> bytes | str:
        name = self._memory.device_name  # a host may have written another
        self._inputs = input_frames(VU8_INPUT, self._settings.contents() | {"device name": name})
        return super()._get_input(request, now_ns)

    def _set_base(self, request: bytes, now_ns: int) -> bytes | str:
        base = int.from_bytes(request[4:8], "little")
        if base > 0xFFFFFF:
            return f"base address {base:#x}; want 0 to 0xffffff"
        self._base = base
        return request[1:]

    def _read_module(self, request: bytes, now_ns: int) -> bytes | str:
        size, offset = request[1], request[2:4]
        found = self._memory.read(self._base + int.from_bytes(offset, "little"), size)
        return found if isinstance(found, str) else bytes((size,)) + offset + found.ljust(4, b"\0")

    def _write_module(self, request: bytes, now_ns: int) -> bytes | str:
        size, address = request[1], self._base + int.from_bytes(request[2:4], "little")
        asked = self._memory.write(address, size, request[4:8], self._write_enabled)
        if isinstance(asked, dict):
            asked = self._take(asked, now_ns)
        return asked if isinstance(asked, str) else request[1:]

    def _opcode(self, request: bytes, now_ns: int) -> bytes | str:
        opcode, argument = request[2], request[3]
        if argument:
            return f"argument {argument}; want 0"
        value = 0
        if opcode in (WRITE_ENABLE, WRITE_DISABLE):
            self._write_enabled = opcode == WRITE_ENABLE
        elif opcode == READ_STATUS:
            value = WRITE_ENABLED * self._write_enabled
        elif opcode == SOFTWARE_RESET:
            self._restart(now_ns)
        elif opcode == RESET_CONFIGURATION:
            if not self._write_enabled:
                return "reset configuration: writing is not enabled"
            self._holding.reset()
            self._memory.reset()
            self._restart_raster(now_ns)
        else:
            return f"opcode {opcode:#04x}"
        return bytes((request[1], opcode, 0, value, 0, 0, 0))

    HOST_MESSAGES: ClassVar[tuple[HostMessage, ...]] = (
        HostMessage("Request", LeddarSession._request, 1, "LeddarTech user guide 54A0028", note="each request below"),
    )
    COMMANDS: ClassVar[Mapping[int, Command]] = {
        1: Command("stop stream", LeddarSession._stop),
        2: Command("send once", _send_once, note="argument 1: one identifier each"),
        3: Command("stream", _stream, note="argument 1: one identifier each"),
        4: Command("get input data", _get_input),
        5: Command("get holding data", LeddarSession._get_holding),
        6: Command("set holding data", LeddarSession._set_holding, True, "all values of a frame or none; kept"),
        7: Command("set base address", _set_base, True),
        8: Command("read module data", _read_module, True, "the banks that are open to the public"),
        9: Command("write module data", _write_module, True, "configuration banks, while writing is enabled"),
        10: Command("send module opcode", _opcode, True, "04, 05, 06, 99, C7"),
    }


SENT = (
    ("Answer", "LeddarTech user guide 54A0028", "the request again, with data; bytes 2 to 7 are 0xFF when refused"),
    ("DetectionCount", "LeddarTech user guide 54A0028", "opens a list"),
    ("Detection", "LeddarTech user guide 54A0028", "one identifier, or one each with multi-id"),
)
"Messages of the device: name in the DBC, source, note."


SESSION = LeddarVu8Session
