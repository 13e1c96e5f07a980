"""Configuration of an Ouster: every parameter with its check, and the columns that an azimuth window leaves.

Belongs here: names, limits, defaults by firmware. Not: active, staged and persisted sets (device), how they are written
(api).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from ipaddress import ip_address
from typing import Any

import numpy as np

from protocols.ouster.codec import PROFILES, Bools

Firmware = tuple[int, int]
TURN_MDEG = 360_000
MODES: Mapping[str, tuple[int, int]] = {
    "512x10": (512, 10), "512x20": (512, 20), "1024x10": (1024, 10), "1024x20": (1024, 20), "2048x10": (2048, 10),
    "4096x5": (4096, 5),
}  # fmt: skip
"Columns of a frame, frames per second."
IMU_LEGACY, IMU_NEW, OFF = "LEGACY", "ACCEL32_GYRO32_NMEA", "OFF"
OSCILLATOR, PULSE, PTP = "TIME_FROM_INTERNAL_OSC", "TIME_FROM_SYNC_PULSE_IN", "TIME_FROM_PTP_1588"
RATE_HZ = 640
"Measurements of the new IMU packets a second."
WIDEST_MDEG = {2: 180_000, 3: 120_000}
"Window at a signal multiplier; no source states the limits, twice the light is half the turn."
POLARITY = ("ACTIVE_HIGH", "ACTIVE_LOW")


@dataclass(frozen=True)
class Parameter:
    """One parameter."""

    default: Any
    fits: Callable[[Any], bool]
    allowed: str
    since: Firmware = (2, 0)


def _whole(low: int, high: int) -> Callable[[Any], bool]:
    return lambda value: type(value) is int and low <= value <= high


def _one_of(*values: Any) -> tuple[Callable[[Any], bool], str]:
    kinds = {(type(one), one) for one in values}
    return (lambda value: isinstance(value, str | int | float) and (type(value), value) in kinds), " | ".join(
        map(str, values)
    )


def _choice(*values: Any, since: Firmware = (2, 0)) -> Parameter:
    """The first is the default."""
    return Parameter(values[0], *_one_of(*values), since)


def _number(default: int, low: int, high: int, since: Firmware = (2, 0)) -> Parameter:
    return Parameter(default, _whole(low, high), f"{low}..{high}", since)


def _window(value: Any) -> bool:
    whole = _whole(0, TURN_MDEG)
    return isinstance(value, list) and len(value) == 2 and all(whole(one) for one in value)


def _place(value: Any) -> bool:
    return isinstance(value, str) and len(value) <= 253 and value.isascii() and (value == "" or value.isprintable())


_FLAG = (lambda value: isinstance(value, bool)), "true | false"
PARAMETERS: Mapping[str, Parameter] = {
    "udp_dest": Parameter("", _place, "an address, a name, @auto or nothing"),
    "udp_port_lidar": _number(7502, 0, 65_535),
    "udp_port_imu": _number(7503, 0, 65_535),
    "lidar_mode": Parameter("1024x10", *_one_of(*MODES)),
    "timestamp_mode": _choice(OSCILLATOR, PULSE, PTP),
    "operating_mode": _choice("NORMAL", "STANDBY"),
    "udp_profile_lidar": Parameter("RNG19_RFL8_SIG16_NIR16", *_one_of(*PROFILES), since=(2, 2)),
    "udp_profile_imu": Parameter(IMU_LEGACY, *_one_of(IMU_LEGACY, IMU_NEW, OFF), since=(2, 2)),
    "columns_per_packet": Parameter(16, *_one_of(16)),
    "azimuth_window": Parameter([0, TURN_MDEG], _window, "[min, max], each 0..360000"),
    "signal_multiplier": Parameter(1, *_one_of(1, 2, 3, 0.25, 0.5), since=(2, 1)),
    "phase_lock_enable": Parameter(False, *_FLAG),
    "phase_lock_offset": _number(0, 0, TURN_MDEG),
    "multipurpose_io_mode": _choice(
        "OFF", "INPUT_NMEA_UART", "OUTPUT_FROM_INTERNAL_OSC", "OUTPUT_FROM_SYNC_PULSE_IN", "OUTPUT_FROM_PTP_1588",
        "OUTPUT_FROM_ENCODER_ANGLE",
    ),
    "sync_pulse_in_polarity": _choice(*POLARITY),
    "nmea_in_polarity": _choice(*POLARITY),
    "sync_pulse_out_polarity": _choice(*POLARITY),
    "sync_pulse_out_angle": _number(360, 0, 360),
    "sync_pulse_out_frequency": _number(1, 1, 10_000),
    "sync_pulse_out_pulse_width": _number(10, 0, 10_000),
    "nmea_baud_rate": _choice("BAUD_9600", "BAUD_115200"),
    "nmea_ignore_valid_char": _number(0, 0, 1),
    "nmea_leap_seconds": _number(0, 0, 1000),
    "gyro_fsr": _choice("NORMAL", "EXTENDED", since=(3, 1)),
    "accel_fsr": _choice("NORMAL", "EXTENDED", since=(3, 1)),
    "return_order": _choice(
        "STRONGEST_TO_WEAKEST", "NEAREST_TO_FARTHEST", "FARTHEST_TO_NEAREST", since=(3, 1)
    ),
    "min_range_threshold_cm": Parameter(50, *_one_of(0, 30, 50), since=(3, 1)),
    "header_type": _choice("STANDARD", "FUSA", since=(3, 2)),
    "lidar_frame_azimuth_offset": _number(0, 0, TURN_MDEG - 1, (3, 2)),
    "bloom_reduction_optimization": _choice("BALANCED", "MINIMIZE_FALSE_POSITIVES", since=(3, 2)),
    "imu_packets_per_frame": Parameter(8, *_one_of(1, 2, 4, 8), since=(3, 2)),
    "udp_dest_zm": Parameter("", _place, "an address, a name or nothing", (3, 2)),
    "udp_port_zm": _number(7504, 0, 65_535, (3, 2)),
    "udp_multicast_ttl": _number(1, 0, 255, (3, 2)),
    "udp_multicast_ttl_zm": _number(1, 0, 255, (3, 2)),
}  # fmt: skip
MOTOR = ("lidar_mode", "operating_mode")
"Parameters whose change takes the motor's time."

Values = Mapping[str, Any]


def defaults(firmware: Firmware) -> dict[str, Any]:
    """All parameters of a firmware as delivered."""
    found = {name: one.default for name, one in PARAMETERS.items() if one.since <= firmware}
    if firmware < (2, 5) and "udp_profile_lidar" in found:
        found["udp_profile_lidar"] = "LEGACY"
    if firmware < (2, 2):
        found |= {"udp_ip": "", "auto_start_flag": 1}
    return found


def changed(old: Values, changes: Values, firmware: Firmware) -> dict[str, Any] | tuple[str, str]:
    """The set after changes; else the parameter that is wrong, and what is allowed. Unknown names are ignored."""
    found = dict(old)
    for name, value in changes.items():
        if firmware < (2, 2) and name == "udp_ip":
            if not _place(value):
                return name, PARAMETERS["udp_dest"].allowed
            found["udp_ip"] = found["udp_dest"] = value
        elif firmware < (2, 2) and name == "auto_start_flag":
            if not _whole(0, 1)(value):
                return name, "0 | 1"
            found["auto_start_flag"], found["operating_mode"] = value, "NORMAL" if value else "STANDBY"
        elif name in found:
            parameter = PARAMETERS[name]
            if not parameter.fits(value) or not _has(name, value, firmware):
                return name, parameter.allowed
            found[name] = value
            if firmware < (2, 2) and name == "udp_dest":
                found["udp_ip"] = value
            if firmware < (2, 2) and name == "operating_mode":
                found["auto_start_flag"] = int(value == "NORMAL")
    return _together(found) or found


def _has(name: str, value: Any, firmware: Firmware) -> bool:
    """Whether a firmware has a value that newer ones have."""
    if name == "lidar_mode":
        return value != "4096x5" or firmware >= (2, 4)
    if name == "udp_profile_lidar":
        return PROFILES[value].since <= firmware
    if name == "udp_profile_imu":
        return value == IMU_LEGACY or firmware >= (3, 2)
    if name == "signal_multiplier":
        return value >= 1 or firmware >= (2, 5)
    return True


def _together(found: Values) -> tuple[str, str] | None:
    """What does not go with the rest."""
    if found.get("udp_profile_imu") == IMU_NEW and profile_of(found) == "LEGACY":
        return "udp_profile_imu", "LEGACY with udp_profile_lidar LEGACY"
    mode, pulse_ms = found["multipurpose_io_mode"], found["sync_pulse_out_pulse_width"]
    if mode == "OUTPUT_FROM_ENCODER_ANGLE":
        period_ms = found["sync_pulse_out_angle"] / 360.0 * 1000.0 / MODES[found["lidar_mode"]][1]
    else:
        period_ms = 1000.0 / found["sync_pulse_out_frequency"]
    if mode.startswith("OUTPUT") and pulse_ms >= period_ms > 0.0:
        return "sync_pulse_out_pulse_width", f"less than the {period_ms:g} ms from pulse to pulse"
    low, high = found["azimuth_window"]
    if not columns_in(found).any():
        return "azimuth_window", "a window with a column in it"
    widest = WIDEST_MDEG.get(found.get("signal_multiplier", 1), TURN_MDEG)
    if (high - low) % TURN_MDEG > widest or (high - low == TURN_MDEG > widest):
        return "azimuth_window", f"a window of at most {widest} at this signal_multiplier"
    return None


def profile_of(values: Values) -> str:
    """Name of the lidar profile; older firmware has one."""
    return str(values.get("udp_profile_lidar", "LEGACY"))


def columns_in(values: Values) -> Bools:
    """(W,) which columns of a frame are in the azimuth window, both ends inclusive."""
    count = MODES[values["lidar_mode"]][0]
    low, high = values["azimuth_window"]
    if [low, high] == [0, TURN_MDEG]:
        return np.full(count, True)
    azimuth = (TURN_MDEG - np.arange(count) * (TURN_MDEG / count)) % TURN_MDEG
    inside = (azimuth >= low) & (azimuth <= high) if low <= high else (azimuth >= low) | (azimuth <= high)
    return np.asarray(inside)


def column_window(values: Values) -> list[int]:
    """First and last column inside, in the order of firing; may wrap."""
    inside = columns_in(values)
    if inside.all():
        return [0, len(inside) - 1]
    first = np.flatnonzero(inside & ~np.roll(inside, 1))
    last = np.flatnonzero(inside & ~np.roll(inside, -1))
    return [int(first[0]), int(last[0])]


def is_group(place: str) -> bool:
    """Whether it is a multicast group."""
    try:
        return ip_address(place).is_multicast
    except ValueError:
        return False
