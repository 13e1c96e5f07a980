"""The requests of RPLIDARs: each row dispatches, and is a line of the coverage page.

Belongs here: what a request does and says. Not: sweeps and groups (device), framing (session).

Sources: `protocol` the maker's LR001 interface protocol, `sdk` rplidar_sdk 2.1.0 (sl_lidar_driver.cpp).
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Mapping
from functools import partial

from protocols.rplidar.codec import HQ, STANDARD
from protocols.rplidar.device import ERROR, RplidarDevice
from protocols.session import DropReason
from protocols.skeleton.descriptors import reply
from protocols.skeleton.requests import Answer, Command, Refused, Request

Reply = bytes | Answer | Refused
STATIC_IP = 0x0001CCC0
CONFIRM = 0x5F5F
RPM_PER_HZ = 60.0
USUAL_PWM = 660.0
SILENT = Answer(None)


def short(request: Request, want: int) -> Refused | None:
    """A payload of another length is no request that a device knows."""
    if len(request.data) == want:
        return None
    return Refused(DropReason.BAD_LENGTH, f"{len(request.data)} bytes; want {want}")


def _info(device: RplidarDevice, request: Request) -> Reply:
    model = device.model
    major, minor = model.firmware
    return reply(0x04, bytes((model.byte, minor, major, model.hardware)) + device.settings.serial)


def _health(device: RplidarDevice, request: Request) -> Reply:
    return reply(0x06, struct.pack("<BH", device.health, device.error_code))


def _rates(device: RplidarDevice, request: Request) -> Reply:
    modes = device.model.modes
    express = modes[min(1, len(modes) - 1)]
    return reply(0x15, struct.pack("<HH", round(modes[0].us), round(express.us)))


def _stop(device: RplidarDevice, request: Request) -> Reply:
    device.stop(request.now_ns)
    return SILENT


def _reset(device: RplidarDevice, request: Request) -> Reply:
    device.stop(request.now_ns)
    device.reset()
    return Answer(None, restarts=True)


def _protected(device: RplidarDevice) -> Refused | None:
    return Refused(DropReason.WRONG_MODE, "protection stop") if device.health == ERROR else None


def _scan(device: RplidarDevice, request: Request, forced: bool = False) -> Reply:
    if not forced and (stopped := _protected(device)):
        return stopped
    return device.begin(request, device.model.modes[0], STANDARD, forced)


def _express(device: RplidarDevice, request: Request) -> Reply:
    if refused := short(request, 5) or _protected(device):
        return refused
    modes, number = device.model.modes, request.data[0]
    if device.model.triangulates and device.model.firmware < (1, 17):
        return Refused(DropReason.REFUSED, "firmware before 1.17")
    if number >= len(modes):
        return Refused(DropReason.BAD_ARGUMENT, f"mode {number}; want 0 to {len(modes) - 1}")
    if number == 0:  # the legacy request: the first mode with capsules
        number = next((at for at, mode in enumerate(modes) if mode.kind != STANDARD), 0)
    return device.begin(request, modes[number], modes[number].kind)


def _hq(device: RplidarDevice, request: Request) -> Reply:
    if refused := short(request, 33) or _protected(device):
        return refused
    if not device.model.has_conf:
        return Refused(DropReason.REFUSED, "firmware before 1.24")
    return device.begin(request, device.model.modes[0], HQ)


def _pwm(device: RplidarDevice, request: Request) -> Reply:
    if refused := short(request, 2):
        return refused
    (pwm,) = struct.unpack("<H", request.data)
    if device.model.motor != "pwm" or pwm > 1023:
        return Refused(DropReason.BAD_ARGUMENT, f"PWM {pwm} of a motor by {device.model.motor}; want 0 to 1023 by pwm")
    device.turn_at(request.now_ns, device.settings.turn_hz * pwm / USUAL_PWM)
    return SILENT


def _rpm(device: RplidarDevice, request: Request) -> Reply:
    if refused := short(request, 2):
        return refused
    if device.model.motor != "rpm":
        return Refused(DropReason.REFUSED, f"a motor by {device.model.motor}; want rpm")
    device.turn_at(request.now_ns, struct.unpack("<H", request.data)[0] / RPM_PER_HZ)
    return SILENT


def _board(device: RplidarDevice, request: Request) -> Reply:
    if refused := short(request, 4):
        return refused
    if device.model.motor == "dtr":
        return Refused(DropReason.REFUSED, "this board has no such flag")
    return reply(0xFF, struct.pack("<I", device.model.motor == "pwm"))


def _baud(device: RplidarDevice, request: Request) -> Reply:
    if refused := short(request, 8):
        return refused
    mark, bps, _ = struct.unpack("<HIH", request.data)
    if mark != CONFIRM or not device.detected or not 9600 <= bps <= 2_000_000:
        return Refused(DropReason.BAD_ARGUMENT, f"mark {mark:04X}, {bps} bit/s; want 5F5F behind a detected speed")
    device.change_speed(request.now_ns, bps)
    return SILENT


# configuration entries

Entry = Callable[[RplidarDevice, bytes], bytes | None]


def _of_mode(device: RplidarDevice, data: bytes, value: Callable[[int], bytes]) -> bytes | None:
    number = int.from_bytes(data[:2], "little")
    return value(number) if len(data) >= 2 and number < len(device.model.modes) else None


def _mode_us(device: RplidarDevice, data: bytes) -> bytes | None:
    return _of_mode(device, data, lambda at: struct.pack("<I", round(256 * device.model.modes[at].us)))


def _mode_most(device: RplidarDevice, data: bytes) -> bytes | None:
    return _of_mode(device, data, lambda at: struct.pack("<I", 256 * device.model.modes[at].most_m))


def _mode_kind(device: RplidarDevice, data: bytes) -> bytes | None:
    return _of_mode(device, data, lambda at: bytes((device.model.modes[at].kind,)))


def _mode_name(device: RplidarDevice, data: bytes) -> bytes | None:
    return _of_mode(device, data, lambda at: device.model.modes[at].name.encode() + b"\0")


def _rpm_of(hz: float) -> bytes:
    return struct.pack("<H", round(RPM_PER_HZ * hz))


CONF: Mapping[int, Entry] = {
    0x01: lambda device, data: _rpm_of(device.settings.turn_hz) + struct.pack("<H", round(USUAL_PWM)),
    0x04: lambda device, data: _rpm_of(device.model.least_hz),
    0x05: lambda device, data: _rpm_of(device.model.most_hz),
    0x60: lambda device, data: struct.pack("<I", 256 * max(mode.most_m for mode in device.model.modes)),
    0x70: lambda device, data: struct.pack("<H", len(device.model.modes)),
    0x71: _mode_us,
    0x74: _mode_most,
    0x75: _mode_kind,
    0x79: lambda device, data: b"",
    0x7C: lambda device, data: struct.pack("<H", device.model.typical),
    0x7F: _mode_name,
    0x81: lambda device, data: (device.model.model.partition("-")[2].upper() + "\0").encode(),
    0xA1: lambda device, data: struct.pack("<I", device.baud),
    STATIC_IP: lambda device, data: device.ip,
}
"Entries of GET_LIDAR_CONF; of any other the reply has no value."


def _get_conf(device: RplidarDevice, request: Request) -> Reply:
    if not device.model.has_conf or len(request.data) < 4:
        return Refused(DropReason.REFUSED, "firmware before 1.24, or no entry")
    entry = CONF.get(int.from_bytes(request.data[:4], "little"))
    value = None if entry is None else entry(device, request.data[4:])
    return reply(0x20, request.data[:4] + (value or b""))


def _set_conf(device: RplidarDevice, request: Request) -> Reply:
    if not device.model.has_conf or len(request.data) < 4:
        return Refused(DropReason.REFUSED, "firmware before 1.24, or no entry")
    known = int.from_bytes(request.data[:4], "little") == STATIC_IP and len(request.data) == 16
    if known:
        device.ip = request.data[4:]
    return reply(0x21, request.data[:4] + struct.pack("<I", 0 if known else 0x80008002))


COMMANDS: Mapping[bytes, Command] = {
    b"\x20": Command("SCAN", _scan, "protocol"),
    b"\x21": Command("FORCE_SCAN", partial(_scan, forced=True), "protocol", "also in protection stop, motor or not"),
    b"\x25": Command("STOP", _stop, "protocol"),
    b"\x40": Command("RESET", _reset, "protocol"),
    b"\x50": Command("GET_INFO", _info, "protocol"),
    b"\x52": Command("GET_HEALTH", _health, "protocol"),
    b"\x59": Command("GET_SAMPLERATE", _rates, "protocol"),
    b"\x82": Command("EXPRESS_SCAN", _express, "protocol", "forms 82, 84, 85, 86 by mode"),
    b"\x83": Command("HQ_SCAN", _hq, "sdk", "form 83; the request is not documented"),
    b"\x84": Command("GET_LIDAR_CONF", _get_conf, "sdk", "14 entries, others without value"),
    b"\x85": Command("SET_LIDAR_CONF", _set_conf, "sdk", "static address alone"),
    b"\x90": Command("NEW_BAUDRATE_CONFIRM", _baud, "sdk", "behind blocks of 41"),
    b"\xa8": Command("HQ_MOTOR_SPEED_CTRL", _rpm, "sdk", "S and C models"),
    b"\xf0": Command("SET_MOTOR_PWM", _pwm, "protocol", "A2, A3"),
    b"\xff": Command("GET_ACC_BOARD_FLAG", _board, "protocol"),
}
"Code -> row."
DURING_SCAN = (b"\xa8", b"\xf0")
"Requests that do not end a scan."
