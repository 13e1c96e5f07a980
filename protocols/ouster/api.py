"""The HTTP interface of an Ouster, and its older command interface of lines on TCP.

Belongs here: the form of requests and replies, what each resource contains. Not: limits of parameters (config), and
what they do (device). Drivers are ouster-sdk and ouster-ros; what they ask for is in their sources.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from ipaddress import IPv4Interface, ip_address
from typing import Any, ClassVar

from protocols.ouster.config import Firmware, changed
from protocols.ouster.device import OusterDevice
from protocols.ouster.metadata import image
from protocols.ouster.reports import TIMES, network, telemetry, time_sensor
from protocols.session import Address, Announcement, DropReason, Emission, LinkKind
from protocols.skeleton import http
from protocols.skeleton.http import LONGEST, HttpRequests, answered, fields_of, page, read
from protocols.skeleton.receiving import Fault
from protocols.skeleton.requests import Answer, Command, Host, Refused, Request

API = b"/api/v1/"
METHODS = (b"GET ", b"PUT ", b"POST ", b"DELETE ", b"HEAD ", b"PATCH ", b"OPTIONS ")
FIELDS = (("Server", "nginx"), ("Connection", "keep-alive"))
EMPTY = page(204, fields=FIELDS)
LONGEST_USER_DATA = 4096
PROFILES = ("default", "default-relaxed", "gptp", "gptp-relaxed", "automotive-slave")
"Of PTP."
METADATA = b"X-Metadata"
"Header of `GET /packets`, ours."
Act = Callable[[Any, Request], bytes | Answer | Refused]


class Requests(HttpRequests):
    """HTTP requests, or lines of the command interface."""

    def _next(self) -> bytes | Fault | None:
        held = self._buffer.peek(len(self._buffer)) or b""
        if any(held.startswith(one[: len(held)]) for one in METHODS):
            return super()._next()
        end = held.find(b"\n")
        return None if end < 0 else self._buffer.take(end + 1)


class Wrong(Exception):
    """A request with a value that is none."""

    def __init__(self, message: str, parameter: str = "") -> None:
        super().__init__(message)
        self.parameter = parameter


def reply(found: Any, status: int = 200) -> bytes:
    """JSON."""
    body = json.dumps(found, separators=(",", ":")).encode()
    return page(status, body, "application/json", FIELDS)


def _error(status: int, code: str, message: str, parameter: str = "") -> bytes:
    what = {"code": code, "message": message} | ({"param": parameter} if parameter else {})
    return reply({"error": what}, status)


STARTING = _error(503, "UNAVAILABLE", "the sensor is starting")


# sets of the configuration


def _json(data: bytes) -> Any:
    try:
        return json.loads(data)
    except (ValueError, RecursionError):
        raise Wrong("not a JSON value") from None


def _flag(query: Mapping[str, str], name: str, default: bool) -> bool:
    text = query.get(name, str(default)).lower()
    if text not in ("true", "false"):
        raise Wrong("want true or false", name)
    return text == "true"


def write(device: OusterDevice, now_ns: int, request: Request, changes: Any, base: Mapping[str, Any]) -> None:
    """Changes over a set become the staged one; all of them, or `Wrong`."""
    if not isinstance(changes, Mapping):
        raise Wrong("want an object of parameters")
    changes = dict(changes)
    for name in ("udp_dest", "udp_ip", "udp_dest_zm"):
        if changes.get(name) == "@auto":
            peer = device.peers.get(request.address) if request.address is not None else None
            changes[name] = "127.0.0.1" if peer is None else peer
    found = changed(base, changes, device.firmware)
    if isinstance(found, tuple):
        raise Wrong(f"want {found[1]}", found[0])
    device.staged = found


def _of_this_firmware(query: Mapping[str, str]) -> None:
    """Refuse what a newer one would do: ignored, a write would go elsewhere than its host means."""
    for name in ("source", "target"):
        if name in query:
            raise Wrong("of firmware 4; want staging", name)


def _post_config(device: OusterDevice, request: Request) -> bytes | Refused:
    query, body = _parts(request)
    _of_this_firmware(query)
    staging = device.firmware >= (3, 1) and _flag(query, "staging", False)
    reinit, persist = _flag(query, "reinit", True), _flag(query, "persist", True)
    write(device, request.now_ns, request, _json(body or b"{}"), device.staged if staging else device.active)
    if persist:
        device.persisted = dict(device.staged)
    if reinit:
        device.reinitialise(request.now_ns)
    return EMPTY


def _get_config(device: OusterDevice, request: Request) -> bytes:
    query, _ = _parts(request)
    _of_this_firmware(query)
    staged = device.firmware >= (3, 1) and _flag(query, "staging", False)
    return reply(device.staged if staged else device.active)


def _delete_config(device: OusterDevice, request: Request) -> bytes:
    device.staged, device.persisted = dict(device.factory), dict(device.factory)
    if not device.user_data[1]:
        device.user_data = ("", False)
    device.reinitialise(request.now_ns)
    return EMPTY


def get_parameter(device: OusterDevice, words: list[str]) -> Any:
    """Of `active NAME` or `staged`."""
    if not words or words[0] not in ("active", "staged"):
        raise Wrong("want active or staged")
    found = device.active if words[0] == "active" else device.staged
    if len(words) == 1:
        return found
    if words[1] not in found:
        raise Wrong("no such parameter", words[1])
    return found[words[1]]


def set_parameter(device: OusterDevice, request: Request, text: str) -> None:
    """`NAME VALUE`, or `.` and an object."""
    name, _, value = text.strip().partition(" ")
    if name == ".":
        changes = _json(value.encode())
    elif name in device.staged:
        try:
            changes = {name: _json(value.encode())}
        except Wrong:
            changes = {name: value}
        if isinstance(device.staged[name], str):
            changes = {name: value.strip('"')}
        elif isinstance(device.staged[name], bool) and changes[name] in (0, 1):
            changes = {name: bool(changes[name])}
    else:
        raise Wrong("no such parameter", name)
    write(device, request.now_ns, request, changes, device.staged)


# resources


def _parts(request: Request) -> tuple[dict[str, str], bytes]:
    """Query and body."""
    query, _, body = request.data.partition(b"\0")
    try:
        return fields_of(query), body
    except ValueError:
        raise Wrong("no query") from None


def _metadata(name: str) -> Act:
    def act(device: OusterDevice, request: Request) -> bytes:
        if name in ("", "lidar_data_format", "imu_data_format") and device.status != "RUNNING":
            status = 503 if device.status == "INITIALIZING" else 404
            return _error(status, "UNAVAILABLE", f"not available while {device.status}")
        found = device.parts()
        return reply(found[name] if name else found)

    return act


def _get(what: Callable[[Any, int], Any]) -> Act:
    return lambda device, request: reply(what(device, request.now_ns))


def _cursor(text: str) -> int:
    if not (text.isascii() and text.isdecimal() and len(text) <= 10):
        raise Wrong("want a number", "cursor")
    return int(text)


def _alerts(device: OusterDevice, request: Request) -> bytes:
    query, _ = _parts(request)
    return reply(device.alerts.reported(_cursor(query.get("cursor", "0")), query.get("mode") == "summary"))


def _get_user_data(device: OusterDevice, request: Request) -> bytes:
    text, keeps = device.user_data
    if not _flag(_parts(request)[0], "include_metadata", False):
        return reply(text)
    return reply({"policy": f"{'keep_on' if keeps else 'clear_on'}_config_delete", "value": text})


def _put_user_data(device: OusterDevice, request: Request) -> bytes:
    query, body = _parts(request)
    text, policy = _json(body), query.get("policy", "clear_on_config_delete")
    if not isinstance(text, str) or len(text) > LONGEST_USER_DATA:
        raise Wrong(f"want a string of at most {LONGEST_USER_DATA} characters")
    if policy not in ("clear_on_config_delete", "keep_on_config_delete"):
        raise Wrong("want clear_on_config_delete or keep_on_config_delete", "policy")
    device.user_data = text, policy.startswith("keep")
    return EMPTY


def _delete_user_data(device: OusterDevice, request: Request) -> bytes:
    device.user_data = ("", False)
    return EMPTY


def _put_profile(device: OusterDevice, request: Request) -> bytes:
    found = _json(_parts(request)[1])
    if found not in PROFILES:
        raise Wrong(f"want {' | '.join(PROFILES)}", "profile")
    device.ptp_profile = found
    return reply(found)


def _override(device: OusterDevice, request: Request) -> bytes:
    found = _json(_parts(request)[1])
    address = found.get("addr") if isinstance(found, dict) and device.firmware >= (3, 2) else found
    try:
        IPv4Interface(address if isinstance(address, str) and "/" in address else "")
    except ValueError:
        raise Wrong("want an IPv4 address with the length of its prefix, as 10.0.0.5/24", "addr") from None
    device.override = address
    return reply(found)


def _no_override(device: OusterDevice, request: Request) -> bytes:
    device.override = None
    return EMPTY


def _packets(device: OusterDevice, request: Request) -> bytes:
    if request.address is not None:
        device.listen(request.now_ns, request.address)
    found = json.dumps(dict(device.parts()), separators=(",", ":")).encode()
    head = b"HTTP/1.1 200 OK\r\nContent-Type: application/octet-stream\r\n"
    return head + METADATA + b": " + found + b"\r\n\r\n"


def _front(device: OusterDevice, request: Request) -> bytes:
    return page(200, f"<html><title>Ouster</title>Ouster {device.unit.model.title}</html>".encode())


def _by_argument(act: Callable[[Any, Request, str], Any]) -> Act:
    """A row of the command interface over HTTP, `?args=`; what it gives is JSON."""
    return lambda device, request: reply(act(device, request, _parts(request)[0].get("args", "")))


def _line(act: Callable[[Any, Request, str], Any]) -> Act:
    """The same as a line."""

    def told(device: OusterDevice, request: Request) -> bytes:
        found = act(device, request, request.data.decode("ascii", "replace"))
        return (found if isinstance(found, str) else json.dumps(found)).encode()

    return told


def _auto(device: OusterDevice, request: Request, text: str) -> Any:
    write(device, request.now_ns, request, {"udp_dest": "@auto"}, device.staged)
    return {} if device.firmware >= (2, 3) else "set_config_param"


def _set(device: OusterDevice, request: Request, text: str) -> Any:
    set_parameter(device, request, text)
    return "set_config_param"


def _reinitialise(device: OusterDevice, request: Request, text: str) -> Any:
    device.reinitialise(request.now_ns)
    return {}


def _save(device: OusterDevice, request: Request, text: str) -> Any:
    device.persisted = dict(device.active)
    return {}


def _echo(act: Callable[[Any, Request, str], Any], word: str) -> Act:
    """A line whose reply is its own word."""
    return _line(lambda device, request, text: (act(device, request, text), word)[1])


def _told(what: Callable[[Any, int], Any]) -> Act:
    return _line(lambda device, request, text: what(device, request.now_ns))


def _checked(act: Act) -> Act:
    def done(device: OusterDevice, request: Request) -> bytes | Answer | Refused:
        try:
            return act(device, request)
        except Wrong as error:
            return Refused(DropReason.BAD_ARGUMENT, f"{error.parameter}: {error}")

    return done


def _part(name: str) -> Callable[[Any, int], Any]:
    return lambda device, _: device.parts()[name]


SDK, MANUAL = "ouster-sdk", "maker's manual of the HTTP interface"
TCP = "ouster-sdk 0.9, TCP manual"
OLD: tuple[Firmware, Firmware] = ((2, 0), (3, 0))
BOTH: tuple[Firmware, Firmware] = ((2, 1), (3, 0))
NEWEST: Firmware = (9, 9)
OBJECTS = (
    "sensor_info", "lidar_data_format", "beam_intrinsics", "imu_intrinsics", "lidar_intrinsics", "calibration_status",
)  # fmt: skip
ZONES = "no zones are emulated: 404"

_HTTP: Mapping[str, tuple[str, Act | None, str, str, tuple[Firmware, Firmware]]] = {
    "GET system/firmware": (
        "firmware", _get(lambda device, _: {"fw": image(device.build.version)}), SDK, "", ((2, 0), NEWEST)),
    "GET sensor/metadata": ("all of it", _metadata(""), SDK, "503 or 404 unless RUNNING", ((2, 2), NEWEST)),
    **{f"GET sensor/metadata/{name}": (name, _metadata(name), SDK, "", ((2, 2), NEWEST)) for name in OBJECTS},
    **{f"GET sensor/cmd/get_{name}": (name, _metadata(name), SDK, "firmware 2.1 to 3.0", BOTH) for name in OBJECTS},
    "GET sensor/metadata/imu_data_format": (
        "imu_data_format", _metadata("imu_data_format"), MANUAL, "firmware 3.2", ((3, 2), NEWEST)),
    "GET sensor/config": ("configuration", _get_config, SDK, "?staging from 3.1 on", ((2, 3), NEWEST)),
    "POST sensor/config": ("configuration", _post_config, SDK, "?staging, reinit, persist", ((2, 1), NEWEST)),
    "DELETE sensor/config": ("as delivered", _delete_config, "no source has its reply", "", ((2, 4), NEWEST)),
    "GET sensor/cmd/get_config_param": (
        "configuration", _by_argument(lambda device, _, text: get_parameter(device, text.split())), SDK, "", BOTH),
    "GET sensor/cmd/set_config_param": ("one parameter, or all", _by_argument(_set), SDK, "", BOTH),
    "GET sensor/cmd/set_udp_dest_auto": ("destination is who asks", _by_argument(_auto), SDK, "", BOTH),
    "GET sensor/cmd/reinitialize": ("staged becomes active", _by_argument(_reinitialise), SDK, "", BOTH),
    "GET sensor/cmd/save_config_params": ("persist", _by_argument(_save), SDK, "", BOTH),
    "POST system/restart": ("restart", lambda *_: Answer(EMPTY, restarts=True), SDK, "", ((3, 1), NEWEST)),
    "POST system/cmd/reboot": ("restart", lambda *_: Answer(EMPTY, restarts=True), SDK, "to 3.0", OLD),
    "GET sensor/alerts": ("alerts", _alerts, MANUAL, "?cursor, mode=summary", ((2, 3), NEWEST)),
    "GET sensor/telemetry": ("telemetry", _get(telemetry), MANUAL, "currents are fixed", ((2, 3), NEWEST)),
    "GET user/data": ("user data", _get_user_data, SDK, "", ((2, 5), NEWEST)),
    "PUT user/data": ("user data", _put_user_data, SDK, f"{LONGEST_USER_DATA} characters", ((2, 5), NEWEST)),
    "DELETE user/data": ("user data", _delete_user_data, SDK, "", ((2, 5), NEWEST)),
    "GET system/network": ("network", _get(lambda device, _: network(device)), SDK, "", ((2, 0), NEWEST)),
    "GET system/network/ipv4/override": (
        "static address", _get(lambda device, _: device.override), MANUAL, "", ((2, 0), NEWEST)),
    "PUT system/network/ipv4/override": (
        "static address", _override, MANUAL, "stored; the link has the address", ((2, 0), NEWEST)),
    "DELETE system/network/ipv4/override": ("static address", _no_override, MANUAL, "", ((2, 0), NEWEST)),
    "PUT system/network/speed_override": ("link speed", None, MANUAL, "automotive Ethernet", ((2, 0), NEWEST)),
    "GET time": (
        "times", _get(lambda device, now_ns: {name: one(device, now_ns) for name, one in TIMES.items()}), MANUAL, "",
        ((2, 0), NEWEST)),
    **{f"GET time/{name}": (f"time of {name}", _get(one), MANUAL, "", ((2, 0), NEWEST)) for name, one in TIMES.items()},
    "GET time/ptp/profile": ("PTP profile", _get(lambda device, _: device.ptp_profile), MANUAL, "", ((2, 0), NEWEST)),
    "PUT time/ptp/profile": ("PTP profile", _put_profile, MANUAL, "stored", ((2, 0), NEWEST)),
    "GET zone_monitor/active/zip": ("zones", None, SDK, ZONES, ((3, 2), NEWEST)),
    "GET zone_monitor/staged/zip": ("zones", None, SDK, ZONES, ((3, 2), NEWEST)),
    "POST zone_monitor/staged/zip": ("zones", None, SDK, ZONES, ((3, 2), NEWEST)),
    "POST zone_monitor/apply": ("zones", None, SDK, ZONES, ((3, 2), NEWEST)),
    "DELETE zone_monitor/staged": ("zones", None, SDK, ZONES, ((3, 2), NEWEST)),
    "GET zone_monitor/live_ids": ("zones", None, SDK, ZONES, ((3, 2), NEWEST)),
    "POST zone_monitor/live_ids": ("zones", None, SDK, ZONES, ((3, 2), NEWEST)),
    "GET diagnostics/dump": ("archive for the maker", None, SDK, "its contents are the maker's", ((2, 0), NEWEST)),
    "GET openapi.yaml": ("description of the interface", None, MANUAL, "of firmware 4", ((2, 0), NEWEST)),
}  # fmt: skip
_LINES: Mapping[str, tuple[str, Act]] = {
    **{f"get_{name}": (name, _told(_part(name))) for name in OBJECTS},
    "get_metadata": ("all of it", _told(lambda device, _: device.parts())),
    "get_config_param": ("configuration", _line(lambda device, _, text: get_parameter(device, text.split()))),
    "get_config_txt": ("configuration", _told(lambda device, _: device.active)),
    "set_config_param": ("one parameter, or all", _echo(_set, "set_config_param")),
    "set_udp_dest_auto": ("destination is who asks", _echo(_auto, "set_udp_dest_auto")),
    "reinitialize": ("staged becomes active", _echo(_reinitialise, "reinitialize")),
    "write_config_txt": ("persist", _echo(_save, "write_config_txt")),
    "save_config_params": ("persist", _echo(_save, "save_config_params")),
    "get_time_info": ("time of sensor", _told(time_sensor)),
    "get_alerts": ("alerts", _line(lambda device, _, text: device.alerts.reported(_cursor(text.strip() or "0")))),
    "get_telemetry": ("telemetry", _told(telemetry)),
}
COMMANDS: Mapping[bytes, Command] = {
    b"GET /": Command("page with the model's name", _front, MANUAL),
    **{
        code.replace(" ", f" {API.decode()}", 1).encode(): Command(name, act and _checked(act), source, note)
        for code, (name, act, source, note, _) in _HTTP.items()
    },
    **{code.encode(): Command(name, _checked(act), TCP, "TCP, to 3.0") for code, (name, act) in _LINES.items()},
    b"GET /packets": Command("lidar packets on this connection", _packets, "ours", "no real device has it"),
}
SPANS: Mapping[bytes, tuple[Firmware, Firmware]] = {
    code.replace(" ", f" {API.decode()}", 1).encode(): row[-1] for code, row in _HTTP.items()
} | {code.encode(): OLD for code in _LINES}
"First and last firmware that has a row; of others all have it."


def _called(host: str) -> str:
    """Address that a request calls, without a port: that of the device; empty: none."""
    try:
        return str(ip_address(host.rpartition(":")[0] if host.count(":") == 1 else host.strip("[]")))
    except ValueError:
        return ""


class OusterSession(http.HttpSession, OusterDevice):
    """With its interfaces."""

    COMMANDS: ClassVar[Mapping[bytes, Command]] = COMMANDS
    WEB = METHODS
    restart_hangs_up = True

    @property
    def announced(self) -> Announcement | None:  # type: ignore[override]
        """Its service: name and text are ours."""
        if not self.build.mdns:
            return None
        new, serial = self.firmware >= (3, 1), str(self.unit.serial)
        about = {"fw": image(self.build.version), "pn": self.unit.model.part, "sn": serial}
        kind, text = ("_ouster-lidar._tcp", {"path": "/api/v1"} | about) if new else ("_roger._tcp", about)
        return Announcement(kind, f"Ouster Sensor {serial}", f"os-{serial}", 80 if new else 7501, text)

    def _splitter(self, kind: LinkKind | None) -> Requests:
        return Requests(LONGEST)

    def receive(self, data: bytes, now_ns: int, address: Address | None = None) -> None:
        """Requests come on connections; while the device boots, the web server answers each piece with 503."""
        super().receive(data, now_ns, address)
        if not self._running and data.startswith(METHODS) and self._connections.kind(address) is LinkKind.STREAM:
            leaves, reply = b"\nconnection: close" in data.lower(), answered(data, STARTING)
            said = self._last(reply) if leaves else reply
            self._outbox.send(Emission(now_ns + self.REPLY_NS, said, address, label="503", hangs_up=leaves))

    def _parse(self, request: bytes) -> tuple[bytes, bytes]:
        if not request.startswith(METHODS):
            word, _, rest = request.strip().partition(b" ")
            return word, rest
        asked = read(request)
        self.called = _called(asked.host)
        return asked.code.rstrip(b"/") if len(asked.code) > 5 else asked.code, asked.query + b"\0" + asked.body

    def _carry_out(self, request: Request, size: int, host: Host) -> None:
        first, last = SPANS.get(request.code, ((0, 0), NEWEST))
        web = b" " in request.code
        if web and "unavailable" in self.impaired:
            self._events.drop(request.now_ns, DropReason.BUSY, "503", size)
            self._say(answered(request.code, STARTING), "503", host, request.now_ns)
        elif not first <= self.firmware <= last or (b"user/data" in request.code and self.firmware == (3, 0)):
            self._events.drop(request.now_ns, DropReason.UNKNOWN_COMMAND, "not in this firmware", size)
            unknown = _error(404, "NOT_FOUND", "not in this firmware") if web else b"error: unknown command\n"
            self._say(answered(request.code, unknown) if web else unknown, "?", host, request.now_ns)
        else:
            super()._carry_out(request, size, host)

    def _reply(self, request: Request, payload: bytes) -> bytes:
        return payload if b" " in request.code else payload + b"\n"

    def _refusal(self, request: Request, refused: Refused) -> bytes:
        if b" " not in request.code:
            known = refused.reason is not DropReason.UNKNOWN_COMMAND
            said = refused.detail.removeprefix(": ") if known else "unknown command"
            return f"error: {said}\n".encode("ascii", "replace")
        if refused.reason is DropReason.BAD_ARGUMENT:
            name, _, message = refused.detail.partition(": ")
            return _error(400, "CONFIG_INVALID", message, name)
        path = request.code.partition(b" ")[2]
        others = request.code not in self.COMMANDS and any(code.endswith(b" " + path) for code in self.COMMANDS)
        wrong = (405, "METHOD", "not for this resource") if others else (404, "NOT_FOUND", "no such resource")
        return answered(request.code, _error(*wrong))

    def _complaint(self, fault: Fault) -> bytes | None:
        return _error(400, "REQUEST", "no request") if fault.reason is not DropReason.TIMEOUT else None
