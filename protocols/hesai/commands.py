"""Commands of PTC 1.0, and the pages of its HTTP interface: what each reads, changes and answers.

Belongs here: payloads, big-endian, and limits. Not: framing (session), and what a setting does (device).
"""

from __future__ import annotations

import json
import struct
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

from protocols.hesai import calibration
from protocols.hesai.device import HesaiDevice
from protocols.hesai.models import Model
from protocols.hesai.motor import LOCKED, TRACKING
from protocols.hesai.settings import WHOLE, Settings, ptp_length
from protocols.session import CommandRow, DropReason
from protocols.skeleton import http
from protocols.skeleton.requests import Answer, Command, Refused, Request

MAC = bytes.fromhex("ec9f0d010203")
MASTER = bytes.fromhex("0050c2fffe010203")
"Identity of the grandmaster."
VERSIONS = ("2024-01-15", "2.10.11", "1.0.0", "3.1.0", "3.2.0")
"Date of manufacture, software, hardware, control firmware, sensor firmware."
MOST_SECTIONS = 10
TEMPERATURE, HOT = 4500, 9800
"0.01 degrees Celsius."
Act = Callable[[HesaiDevice, Request], bytes | Answer | Refused]
BAD = Refused(DropReason.BAD_ARGUMENT, "out of range")


def _sized(size: int, act: Act) -> Act:
    """A command with so many bytes of payload."""

    def found(device: HesaiDevice, request: Request) -> bytes | Answer | Refused:
        if len(request.data) != size:
            return Refused(DropReason.BAD_LENGTH, f"{len(request.data)} bytes; want {size}")
        return act(device, request)

    return found


def _get(make: Callable[[HesaiDevice, int], bytes]) -> Act:
    """A command without a payload, answered from the state at an instant."""
    return _sized(0, lambda device, request: make(device, request.now_ns))


def _set(change: Callable[[Model, Settings, bytes], Settings | None]) -> Act:
    """A command that changes settings; None of `change`: refused."""

    def act(device: HesaiDevice, request: Request) -> bytes | Refused:
        found = change(device.model, device.settings, request.data)
        if found is None:
            return BAD
        if found != device.settings:
            device.change(request.now_ns, found)
        return b""

    return act


def _only(has: Callable[[Model], bool], act: Act) -> Act:
    """Of models that have it; others do not know the command."""

    def found(device: HesaiDevice, request: Request) -> bytes | Answer | Refused:
        return act(device, request) if has(device.model) else Refused(DropReason.UNKNOWN_COMMAND, device.model.title)

    return found


def _switch(field: str, most: int = 1) -> Act:
    """A setting of one byte, 0 to `most`."""

    def change(model: Model, old: Settings, data: bytes) -> Settings | None:
        kind = type(getattr(old, field))
        return replace(old, **{field: kind(data[0])}) if data[0] <= most else None

    return _sized(1, _set(change))


def _calibration(device: HesaiDevice, request: Request) -> bytes | Refused:
    if device.calibration == 1:
        return Refused(DropReason.REFUSED, "fault")
    made = calibration.served(device.model, device.wrong_deg)
    return calibration.damaged(made) if device.calibration else made


def _inventory(device: HesaiDevice, now_ns: int) -> bytes:
    model = device.model
    date, *versions = (text.encode().ljust(16, b"\0") for text in VERSIONS)
    data = device.build.serial.encode().ljust(18, b"\0") + date + MAC + b"".join(versions)
    short = struct.pack(">hBBB", 0, model.number, int(_turns_back(model)), model.lasers)
    if model.inventory == 184:
        data += b"1.0".ljust(16, b"\0") * 2 + bytes(32) + short + b"\1\1"
    else:
        data += short
    if model.inventory == 162:
        data += model.title.encode().ljust(32, b"\0")
    return data.ljust(model.inventory, b"\0")


def _turns_back(model: Model) -> bool:
    return model.number not in (0, 48)


def _config(device: HesaiDevice, now_ns: int) -> bytes:
    one = device.settings
    address, port, gps_port = one.destination or device.build.said_to
    first, last = one.range_ddeg[0]
    return (
        one.network[:12]
        + bytes(map(int, address.split(".")))
        + struct.pack(">HHHBHHH", port, gps_port, one.rpm, one.sync, 100 * one.sync_deg, first // 10, last // 10)
        + bytes((one.by_ptp, 1, one.trigger, one.mode, one.standby, _turns_back(device.model) << 4 | one.backwards))
        + one.network[12:15]
        + bytes((device.build.gpgga,))
        + bytes(8)
    )


def _status(device: HesaiDevice, now_ns: int) -> bytes:
    model, source = device.model, device.source
    up_s = (now_ns - device.on_ns) // 10**9
    hot = HOT if device.hot else TEMPERATURE
    at = range(model.temperatures)
    gps = not source.by_ptp and source.pps, not source.by_ptp and source.nmea
    data = struct.pack(">IH", up_s, abs(device.speed_rpm(now_ns)) & 0xFFFF)
    data += struct.pack(f">{len(at)}i", *(hot + 100 * place for place in at))
    data += struct.pack(">BBIIB", *gps, device.power_ons, up_s // 60, source.ptp_state(now_ns))
    return data + struct.pack(">IB", 300 if model.number == 42 else 0, 0)


def _diagnostics(device: HesaiDevice, request: Request) -> bytes | Refused:
    now_ns, query, source = request.now_ns, request.data[0], device.source
    state = source.ptp_state(now_ns)
    hears = state in (TRACKING, LOCKED)
    offset = device.source.shown_ns(device.clock, now_ns)[0] - source.utc(now_ns) if state else 0
    since_ms = 0 if hears else min((now_ns - source.since_ns) // 10**6, 0x7FFFFFFF)
    if query == 1:
        return struct.pack(">qii", offset, state, since_ms)
    if query == 2:
        identity = MAC[:3] + b"\xff\xfe" + MAC[3:]
        log_sync = struct.unpack(">b", device.settings.ptp[4:5])[0] if len(device.settings.ptp) > 4 else -3
        return struct.pack(
            ">8sHBbqbBbBbB", identity, 1, 9 if hears else 4, 0, 0, 1, 3, log_sync, 1 + _p2p(device), 0, 2
        )
    if query == 3:
        gm = MASTER if hears else bytes(8)
        return struct.pack(">qqiiHHQHi8s", offset, source.utc(now_ns) if hears else 0, 0, 0, 0, 0, 0, 0, hears, gm)
    if query == 4:
        return struct.pack(">Ihbb", 0x06_21_4E_5D if hears else 0, 37, 0x3C, 0x20)
    return Refused(DropReason.BAD_ARGUMENT, f"query {query}; want 1 to 4")


def _p2p(device: HesaiDevice) -> int:
    return int(device.settings.ptp[0] != 0)


def _monitor(device: HesaiDevice, now_ns: int) -> bytes:
    return struct.pack(">iiii", *_powers(device), 0).ljust(64, b"\0")


def _powers(device: HesaiDevice) -> tuple[int, int, int]:
    """Current 0.01 mA, voltage 0.01 V, power 0.01 W."""
    watt = 10 if device.model.lasers <= 40 else 25
    watt = watt if device.fires else watt // 2
    return watt * 100_000 // 12, 1200, watt * 100


def _rpm(model: Model, old: Settings, data: bytes) -> Settings | None:
    rpm = int.from_bytes(data, "big")
    return replace(old, rpm=rpm) if rpm in model.rpm else None


def _sync(model: Model, old: Settings, data: bytes) -> Settings | None:
    enable, angle = struct.unpack(">BH", data)
    return replace(old, sync=bool(enable), sync_deg=angle % 360) if enable <= 1 and angle <= 360 else None


def _mode(model: Model, old: Settings, data: bytes) -> Settings | None:
    return replace(old, mode=data[0]) if data[0] in model.modes else None


def _destination(model: Model, old: Settings, data: bytes) -> Settings | None:
    port, gps_port = struct.unpack(">HH", data[4:])
    if not (port and gps_port and any(data[:4])):
        return None
    return replace(old, destination=(".".join(map(str, data[:4])), port, gps_port))


def _network(model: Model, old: Settings, data: bytes) -> Settings | None:
    return replace(old, network=data) if data[12] <= 1 else None


def _range(model: Model, old: Settings, data: bytes) -> Settings | None:
    if data[:1] == b"\0" and len(data) == 5:
        count, rest = 1, data[1:]
    elif data[:1] in (b"\2", b"\3") and len(data) > 1 and 0 < data[1] <= MOST_SECTIONS:
        count, rest = data[1], data[2:]
    else:
        return None
    if len(rest) != 4 * count:
        return None
    words = struct.unpack(f">{2 * count}H", rest)
    if max(words) > WHOLE[1]:
        return None
    return replace(old, range_ddeg=tuple(zip(words[::2], words[1::2], strict=True)), range_said=data)


def _ptp(model: Model, old: Settings, data: bytes) -> Settings | None:
    good = data and ptp_length(model, data[0]) == len(data) and data[2] <= 1
    return replace(old, ptp=data) if good else None


def _reset(device: HesaiDevice, request: Request) -> Answer:
    if request.code == b"25":
        device.quick_restart()
    return Answer(b"", restarts=True)


# HTTP


def page(error: int, body: Mapping[str, Any] | None = None) -> bytes:
    """A page of JSON; drivers want a length."""
    head = {"ErrorCode": str(error), "Message": "Success" if error == 0 else "Failed"}
    data = json.dumps({"Head": head, "Body": dict(body or {})}, separators=(",", ":")).encode()
    return http.page(200, data, "application/json")


def _pandar(device: HesaiDevice, request: Request) -> bytes:
    try:
        fields = http.fields_of(request.data)
    except ValueError:
        return page(1)
    what = fields.get("action"), fields.get("object"), fields.get("key")
    if what == ("get", "lidar_monitor", None):
        current, volt, watt = _powers(device)
        texts = (f"{current / 100:.1f} mA", f"{volt / 100:.1f} V", f"{watt / 100:.1f} W")
        return page(0, dict(zip(("lidarInCur", "lidarInVol", "lidarInPower"), texts, strict=True)))
    try:
        found = _asked(device, what, fields.get("value", ""))
    except (ValueError, TypeError, KeyError, struct.error, RecursionError):
        found = None
    if found is None:
        return page(1)
    if found != device.settings:
        device.change(request.now_ns, found)
    return page(0)


def _asked(device: HesaiDevice, what: tuple[str | None, ...], value: str) -> Settings | None:
    model, old = device.model, device.settings
    if what == ("set", "lidar", "spin_speed"):
        return _rpm(model, old, {"1": 300, "2": 600, "3": 1200}[value].to_bytes(2, "big"))
    if what == ("set", "lidar_sync", "sync_angle"):
        table = json.loads(value)
        return _sync(model, old, struct.pack(">BH", table["sync"], table["syncAngle"]))
    if what == ("set", "lidar", "ptp_configuration"):
        table = json.loads(value)
        data = bytes((table["Profile"], table["Domain"], table["Network"]))
        if data[0] == 0:
            names = ("LogAnnounceInterval", "LogSyncInterval", "LogMinDelayReqInterval")
            data += struct.pack(">bbb", *(table[name] for name in names))
            data += bytes((ptp_length(model, 0) or 0) - len(data))
        elif data[0] in (2, 3):
            data += bytes((table["tsn_switch"],))
        return _ptp(model, old, data)
    return None


def _packets(device: HesaiDevice, request: Request) -> bytes:
    if request.address is not None:
        device.listen(request.now_ns, request.address)
    return b"HTTP/1.1 200 OK\r\nContent-Type: application/octet-stream\r\n\r\n"


def _high(model: Model) -> bool:
    return bool(model.high_ns)


def _is_ot(model: Model) -> bool:
    return model.number == 42


def _has_range(model: Model) -> bool:
    return model.number != 48


PTC_2, PTC_TLS = b"PTC 2.0", b"PTC in TLS"
SDK, NEBULA, BOTH = "SDK 2.0.11", "nebula", "SDK 2.0.11, nebula"
COMMANDS: Mapping[bytes, Command] = {
    b"05": Command("get calibration", _sized(0, _calibration), BOTH, "CSV; of an AT128 binary with SHA-256"),
    b"06": Command("PTP diagnostics", _sized(1, _diagnostics), BOTH, "queries 1 to 4"),
    b"07": Command("get inventory", _get(_inventory), NEBULA),
    b"08": Command("get configuration", _get(_config), NEBULA),
    b"09": Command("get status", _get(_status), BOTH),
    b"0C": Command("read register", None, SDK),
    b"0D": Command("write register", None, SDK),
    b"10": Command("reboot", _sized(0, _reset), SDK),
    b"17": Command("set spin rate", _sized(2, _set(_rpm)), BOTH, "the motor ramps at once"),
    b"18": Command("set sync angle", _sized(3, _set(_sync)), BOTH, "whole degrees"),
    b"1B": Command("set trigger", _switch("trigger"), NEBULA, "0 angle, 1 time"),
    b"1C": Command("set standby", _switch("standby"), BOTH),
    b"1E": Command("set return mode", _sized(1, _set(_mode)), BOTH, "takes effect with the next slice"),
    b"1F": Command("set clock source", _switch("by_ptp"), NEBULA, "0 GPS, 1 PTP"),
    b"20": Command("set destination", _sized(8, _set(_destination)), BOTH, "UDP links are redirected"),
    b"21": Command("set network", _sized(15, _set(_network)), BOTH, "stored, not used"),
    b"22": Command("set range", _only(_has_range, _set(_range)), BOTH, "all channels or sections; not per channel"),
    b"23": Command("get range", _only(_has_range, _get(lambda device, _: device.settings.range_said)), BOTH),
    b"24": Command("set PTP configuration", _set(_ptp), NEBULA),
    b"25": Command("reset", _sized(0, _reset), NEBULA),
    b"26": Command("get PTP configuration", _get(lambda device, _: b"\1" + device.settings.ptp), NEBULA),
    b"27": Command("monitor", _get(_monitor), NEBULA, "current, voltage and power are fixed"),
    b"28": Command("get high resolution", _only(_high, _get(lambda one, _: bytes((one.settings.high,)))), NEBULA),
    b"29": Command("set high resolution", _only(_high, _switch("high")), NEBULA),
    b"2A": Command("set rotation direction", _only(_turns_back, _switch("backwards")), NEBULA),
    b"30": Command("get freeze frames", None, SDK),
    b"38": Command("get operation log", None, SDK),
    b"39": Command("set PTP lock offset", _switch("ptp_offset_us", 255), BOTH),
    b"3A": Command("get PTP lock offset", _get(lambda one, _: bytes((one.settings.ptp_offset_us,))), BOTH),
    b"58": Command("set blockage detection", _only(_is_ot, _switch("blockage")), NEBULA, "OT128"),
    b"59": Command(
        "get blockage detection", _only(_is_ot, _get(lambda one, _: bytes((one.settings.blockage,)))), NEBULA
    ),
    b"83": Command("firmware upgrade", None, SDK),
    b"87": Command("firmware upgrade", None, SDK),
    b"A8": Command("get channel configuration", None, SDK, "other models have it"),
    b"A9": Command("get fire times", None, SDK, "other models have it"),
    b"FF": Command("firmware upgrade", None, SDK),
    PTC_2: Command("any command", None, SDK, "the maker's drivers do not use it"),
    PTC_TLS: Command("handshake", None, SDK, "a fatal alert; PTC is plain"),
    b"GET /pandar.cgi": Command("HTTP: spin rate, sync angle, PTP, monitor", _pandar, NEBULA),
    b"GET /point_cloud": Command("point cloud on this connection", _packets, "ours", "no real device has it"),
}
"Two hexadecimal digits: commands of PTC."
NOT_BUILT = (CommandRow("TCP 5120", "point cloud by TCP", "refused", SDK, "newest models; no link listens"),)
