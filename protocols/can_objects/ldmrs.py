"""SICK LD-MRS S01 and Ibeo LUX: a laser scanner's object list on CAN, sixteen identifiers from a base id.

Belongs here: measuring, commands and replies, ego motion, warnings, how many objects fit. Which objects a list holds is
in `ldmrs_choice`, their frames in `ldmrs_lists`, parameters in `ldmrs_parameters`, the scenario's keys in
`ldmrs_settings`. Source: SICK document 8014493, see the head of `ldmrs.dbc`.
"""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from protocols.can_frame import LONGEST_FRAME_BITS, frame_bits
from protocols.can_objects import ldmrs_parameters as p
from protocols.can_objects.ldmrs_choice import ObjectChoice
from protocols.can_objects.ldmrs_lists import object_frames
from protocols.can_objects.ldmrs_settings import Settings
from protocols.can_objects.session import CanObjectSession, Frame, HostMessage
from protocols.can_objects.table import Floats, ObjectTable
from protocols.device_clock import DeviceClock
from protocols.session import DropReason
from protocols.skeleton.instants import SECOND_NS

FORMAT_VERSION = 1
EGO_FORMAT_VERSION = 2
REFUSED = 0x8000
LOW_TEMPERATURE_C, HIGH_TEMPERATURE_C = -30, 115

WARN1_LOW_TEMPERATURE, WARN1_HIGH_TEMPERATURE = 1 << 3, 1 << 4
WARN2_COMMAND, WARN2_EGO_MOTION, WARN2_NO_NTP = 1 << 5, 1 << 8, 1 << 11

NTP_TICK_NS = Fraction(SECOND_NS, 1 << 32)
"Of the fraction: seconds and fraction are one number of 64 bits."


class LdmrsSession(CanObjectSession):
    """One LD-MRS S01."""

    LAYOUT_FILE: ClassVar[str] = "ldmrs.dbc"
    clock_tick_ns = NTP_TICK_NS
    clock_bits = 64
    count_bits = 8

    def __init__(self, settings: Settings) -> None:
        self._settings = settings
        self._parameters = p.ParameterBank(settings.parameters)
        super().__init__(settings.common)
        self._choice = ObjectChoice()
        self._object_bits = np.zeros(0, dtype=np.int64)
        self.clock = DeviceClock((settings.ntp_start or 0) * SECOND_NS)
        self._reset(0)

    def _shift(self) -> int:
        return self._base_id - self._layout.identifier("ListHeader")

    def _reset(self, now_ns: int) -> None:
        self._parameters.restore()
        self._base_id = self._parameters[p.BASE_ID]
        self._measuring = self._settings.starts_measuring
        self._list_counter = self.first_count
        self._choice.clear()
        self._speed: tuple[int, float] | None = None
        self._yaw_rate: tuple[int, float] | None = None
        self._bad_command = False
        self._ntp_seconds_asked: int | None = None
        # without a host's clock the time counts from power-on
        self._knows_time = self._settings.ntp_start is not None or self.clock.begin_ns != 0 or self._keeps_time()
        self.clock = self.clock.powered_on(now_ns)

    def _keeps_time(self) -> bool:
        """A time set by a host is kept over a power cycle."""
        return self.clock.runs_on and getattr(self, "_knows_time", False)

    def _start(self, now_ns: int) -> None:
        self._timers.add(now_ns + SECOND_NS, SECOND_NS, self._report)
        self._mode(now_ns, "measuring" if self._measuring else "idle")

    def _cycle_ns(self) -> int:
        return SECOND_NS * p.FREQUENCY_UNITS // self._parameters[p.SCAN_FREQUENCY]

    def _lists_wanted(self) -> bool:
        return self._measuring and not self._parameters[p.OUTPUT_DISABLE] & p.DISABLE_OBJECTS

    # Lists

    def _encode_list(self, table: ObjectTable, now_ns: int, measured_ns: int) -> list[Frame]:
        parameters, settings = self._parameters, self._settings
        table, ids, age, prediction = self._choice.choose(table, parameters)
        relative = bool(parameters[p.OPTIONS] & p.RELATIVE_VELOCITIES)
        axis_aligned = bool(parameters[p.OPTIONS] & p.AXIS_ALIGNED_BOXES)
        ego = self._ego(now_ns)
        if ego is None and settings.without_ego == "relative":
            relative = True
        velocities: tuple[Floats, Floats] | None = (table.vx_m_s, table.vy_m_s)
        if not relative:
            velocities = None
            if ego is not None:
                speed, yaw_rate = ego
                velocities = (table.vx_m_s + speed - yaw_rate * table.y_m, table.vy_m_s + yaw_rate * table.x_m)
        per_object = object_frames(
            self._layout,
            self._shift(),
            table,
            ids,
            velocities,
            age_scans=age,
            prediction_scans=prediction,
            axis_aligned=axis_aligned,
            density=parameters[p.CONTOUR_DENSITY],
            class_in_reserved=settings.class_in_reserved,
        )
        listed = self._fitting(per_object)
        counter = self._list_counter
        self._list_counter = (counter + 1) & 0xFF
        header = self._frame(
            "ListHeader",
            {
                "FormatVersion": FORMAT_VERSION,
                "NumObjects": len(listed),
                "ViewRange": settings.view_percent,
                "Temperature": settings.temperature_c,
                "VelocitiesRelative": int(relative),
                "BoxesAxisAligned": int(axis_aligned),
                "ListCounter": counter,
                "Blind": settings.blind,
            },
        )
        self._reported = self.clock.reported(measured_ns, NTP_TICK_NS, 64)
        ntp = {"NtpSeconds": self._reported.ticks >> 32, "NtpFraction": self._reported.ticks & 0xFFFFFFFF}
        frames = [header, self._frame("ListTime", ntp)]
        frames += [frame for group in listed for frame in group]
        count = len(frames) - (2 if settings.counts_objects_only else 0)
        warnings = sum(register.bit_count() for register in self._warning_registers(now_ns))
        frames.append(
            self._frame("ListTrailer", {"NumMessages": count, "NumWarnings": warnings, "ListCounter": counter})
        )
        return frames

    def _fitting(self, per_object: list[list[Frame]]) -> list[list[Frame]]:
        """As many objects, best first, as the bus carries in one cycle beside header, time, trailer and a warning."""
        bits = super()._list_bits([frame for group in per_object for frame in group])
        ends = np.cumsum([len(group) for group in per_object], dtype=np.int64)
        through = np.concatenate([[0], np.cumsum(bits)])[ends]
        budget = self._cycle_ns() / self._bit_ns - 4 * LONGEST_FRAME_BITS
        listed = int(np.searchsorted(through, budget, side="right"))
        self._object_bits = bits[: ends[listed - 1] if listed else 0]
        return per_object[:listed]

    def _list_bits(self, frames: list[Frame]) -> NDArray[np.int64]:
        """Those of the objects are known since it was seen how many of them fit."""
        if self._protection is not None:
            return super()._list_bits(frames)
        head, time, tail = (frame_bits(frame.identifier, frame.payload) for frame in (*frames[:2], frames[-1]))
        return np.concatenate([[head, time], self._object_bits, [tail]])

    def _ego(self, now_ns: int) -> tuple[float, float] | None:
        """Speed and yaw rate while both are fresh."""
        fresh = now_ns - self._settings.ego_timeout_ns
        if self._speed is None or self._yaw_rate is None or min(self._speed[0], self._yaw_rate[0]) < fresh:
            return None
        return self._speed[1], self._yaw_rate[1]

    # Warnings

    def _warning_registers(self, now_ns: int) -> tuple[int, int]:
        first, second = self._settings.warnings
        if self._settings.temperature_c < LOW_TEMPERATURE_C:
            first |= WARN1_LOW_TEMPERATURE
        if self._settings.temperature_c > HIGH_TEMPERATURE_C:
            first |= WARN1_HIGH_TEMPERATURE
        if self._ego(now_ns) is None:
            second |= WARN2_EGO_MOTION
        if not self._knows_time:
            second |= WARN2_NO_NTP
        if self._bad_command:
            second |= WARN2_COMMAND
        return first, second

    def _report(self, now_ns: int) -> None:
        """0x50F once per second while a register is set; registers clear after sending."""
        errors, warnings = self._settings.errors, self._warning_registers(now_ns)
        self._bad_command = False
        if self._parameters[p.OUTPUT_DISABLE] & p.DISABLE_ERRORS or not any(errors + warnings):
            return
        raw = dict(zip(("ErrorReg1", "ErrorReg2", "WarnReg1", "WarnReg2"), errors + warnings, strict=True))
        self._send_cyclic([self._frame("ErrorsWarnings", raw)], now_ns)

    # Host messages

    def _command(self, data: bytes, now_ns: int, link: int) -> None:
        values = self._layout.decode("Command", data)
        code, index, value = int(values["CommandId"]), int(values["ParameterIndex"]), int(values["Value"])
        command = COMMANDS.get(code)
        if command is None:
            self._refuse(code, now_ns, link, DropReason.UNKNOWN_COMMAND, f"command {code:#06x}")
        elif len(data) != command.length:
            detail = f"{command.name} has {len(data)} bytes; want {command.length}"
            self._refuse(code, now_ns, link, DropReason.BAD_LENGTH, detail)
        else:
            command.handler(self, index, value, now_ns, link)

    def _refuse(self, code: int, now_ns: int, link: int, reason: DropReason, detail: str) -> None:
        self._bad_command = True
        self._drop(now_ns, reason, detail)
        self._reply(code | REFUSED, now_ns, link)

    def _reply(self, code: int, now_ns: int, link: int, index: int = 0, value: int = 0) -> None:
        raw = {"CommandId": code, "ParameterIndex": index, "Value": value}
        self._send_reply([self._frame("Reply", raw)], now_ns, link)

    def _do_reset(self, index: int, value: int, now_ns: int, link: int) -> None:
        self._handled(now_ns, "reset")
        self.power_on(now_ns)

    def _do_save(self, index: int, value: int, now_ns: int, link: int) -> None:
        self._parameters.save()
        self._handled(now_ns, "save config")
        self._reply(0x0004, now_ns, link)

    def _do_factory(self, index: int, value: int, now_ns: int, link: int) -> None:
        self._parameters.factory()
        self._restart_raster(now_ns)
        self._handled(now_ns, "factory defaults")
        self._reply(0x001A, now_ns, link)

    def _do_set(self, index: int, value: int, now_ns: int, link: int) -> None:
        refusal = self._parameters.set(index, value)
        if refusal is not None:
            self._refuse(0x0010, now_ns, link, DropReason.BAD_ARGUMENT, refusal)
            return
        self._handled(now_ns, f"set {p.PARAMETERS[index].name}")
        self._reply(0x0010, now_ns, link)
        if index in (p.SCAN_FREQUENCY, p.OUTPUT_DISABLE):
            self._restart_raster(now_ns)
        elif index == p.BASE_ID:
            # the reply still leaves on the old identifier
            self._base_id = self._parameters[p.BASE_ID]
            self._rebuild_dispatch()

    def _do_get(self, index: int, value: int, now_ns: int, link: int) -> None:
        found = self._parameters.get(index)
        if found is None:
            self._refuse(0x0011, now_ns, link, DropReason.BAD_ARGUMENT, f"unknown parameter {index:#06x}")
            return
        self._handled(now_ns, f"get {p.PARAMETERS[index].name}")
        self._reply(0x0011, now_ns, link, index, found)

    def _do_start(self, index: int, value: int, now_ns: int, link: int) -> None:
        self._handled(now_ns, "start measure")
        self._reply(0x0020, now_ns, link)
        self._set_measuring(True, now_ns)

    def _do_stop(self, index: int, value: int, now_ns: int, link: int) -> None:
        self._handled(now_ns, "stop measure")
        self._reply(0x0021, now_ns, link)
        self._set_measuring(False, now_ns)

    def _set_measuring(self, measuring: bool, now_ns: int) -> None:
        if measuring == self._measuring:
            return
        self._measuring = measuring
        self._restart_raster(now_ns)
        self._choice.clear()
        self._mode(now_ns, "measuring" if measuring else "idle")

    def _do_ntp_seconds(self, index: int, value: int, now_ns: int, link: int) -> None:
        self._ntp_seconds_asked = value
        self._handled(now_ns, "set NTP seconds")
        self._reply(0x0030, now_ns, link)

    def _do_ntp_fraction(self, index: int, value: int, now_ns: int, link: int) -> None:
        if self._ntp_seconds_asked is not None:  # the seconds take effect together with the fraction
            self.clock = self.clock.set_to(now_ns, self._ntp_seconds_asked * SECOND_NS + (value * SECOND_NS >> 32))
            self._knows_time = True
            self._ntp_seconds_asked = None
        self._handled(now_ns, "set NTP fraction")
        self._reply(0x0031, now_ns, link)

    def _take_speed(self, data: bytes, now_ns: int, link: int) -> None:
        self._speed = self._ego_value("EgoSpeed", "Speed", data, now_ns, self._speed)

    def _take_yaw_rate(self, data: bytes, now_ns: int, link: int) -> None:
        self._yaw_rate = self._ego_value("EgoYawRate", "YawRate", data, now_ns, self._yaw_rate)

    def _take_unused(self, data: bytes, now_ns: int, link: int) -> None:
        """Cross acceleration and steering wheel: only their version is looked at."""
        self._ego_value("EgoCrossAccel", "CrossAccel", data, now_ns, None)

    def _ego_value(
        self, name: str, signal: str, data: bytes, now_ns: int, before: tuple[int, float] | None
    ) -> tuple[int, float] | None:
        values = self._layout.decode(name, data)
        if values["FormatVersion"] != EGO_FORMAT_VERSION:
            self._drop(now_ns, DropReason.BAD_ARGUMENT, f"{name}: format version {values['FormatVersion']:g}; want 2")
            return before
        return now_ns, values[signal]

    HOST_MESSAGES: ClassVar[tuple[HostMessage, ...]] = (
        HostMessage("Command", _command, 2, "SICK 8014493"),
        HostMessage("EgoSpeed", _take_speed, 3, "SICK 8014493, RACK", shifted=False),
        HostMessage("EgoYawRate", _take_yaw_rate, 3, "SICK 8014493, RACK", shifted=False),
        HostMessage("EgoCrossAccel", _take_unused, 3, "SICK 8014493, RACK", shifted=False, note="read, not used"),
        HostMessage("EgoSteeringWheel", _take_unused, 3, "SICK 8014493, RACK", shifted=False, note="read, not used"),
    )


@dataclass(frozen=True)
class Command:
    """One command of base+0xA."""

    name: str
    length: int
    handler: Any
    note: str = ""


COMMANDS: dict[int, Command] = {
    0x0000: Command("reset", 2, LdmrsSession._do_reset, "no reply"),
    0x0004: Command("save config", 2, LdmrsSession._do_save),
    0x0010: Command("set parameter", 8, LdmrsSession._do_set, "a new bit rate is kept; the bus has the link's"),
    0x0011: Command("get parameter", 4, LdmrsSession._do_get),
    0x001A: Command("factory defaults", 2, LdmrsSession._do_factory, "base id and bit rate stay"),
    0x0020: Command("start measure", 2, LdmrsSession._do_start),
    0x0021: Command("stop measure", 2, LdmrsSession._do_stop),
    0x0030: Command("set NTP seconds", 8, LdmrsSession._do_ntp_seconds),
    0x0031: Command("set NTP fraction", 8, LdmrsSession._do_ntp_fraction),
}

SENT = (
    ("ListHeader", "SICK 8014493", "opens every list"),
    ("ListTime", "SICK 8014493", ""),
    ("ObjTrack1", "SICK 8014493", "position of the box's centre"),
    ("ObjTrack2", "SICK 8014493", "time offset 0: all objects refer to the list's instant"),
    ("ObjClassBox1", "SICK 8014493", "bytes 1 to 3 reserved; class in them with `class_in_reserved`"),
    ("ObjBox2", "SICK 8014493", ""),
    ("ContourHeader", "SICK 8014493", ""),
    ("ContourPoints", "SICK 8014493", ""),
    ("ListTrailer", "SICK 8014493", "counts every frame before it; only objects' with `count_messages: objects`"),
    ("Reply", "SICK 8014493", "id + 0x8000 refuses, as on Ethernet"),
    ("ErrorsWarnings", "SICK 8014493", "once per second while a register is set"),
)
"Messages of the device: name in the DBC, source, note."


SESSION = LdmrsSession
