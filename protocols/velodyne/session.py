"""The web interface of a Velodyne: HTTP requests in, pages and JSON out.

Belongs here: the form of requests and replies, what each page contains. Not: limits of settings (settings), and what
they do (device). Sources: MRPT and Nebula (paths and fields that drivers use), the maker's scripts around the manual.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from typing import Any, ClassVar

import numpy as np

from protocols.session import DropReason, LinkKind
from protocols.skeleton import http
from protocols.skeleton.http import LONGEST, HttpRequests, fields_of, page, read
from protocols.skeleton.receiving import Fault
from protocols.skeleton.requests import Answer, Command, Refused, Request
from protocols.velodyne.codec import TURN_CDEG
from protocols.velodyne.device import VelodyneDevice
from protocols.velodyne.own import reported
from protocols.velodyne.settings import changed

PPS = ("Absent", "Synchronizing", "Locked", "Error")
RESET_NS = 100_000_000
VOLT = 4096 / 5.0
"Counts; the scale of the maker's own page."


def _info(device: VelodyneDevice) -> dict[str, Any]:
    return {"model": device.model.title, "serial": device.build.serial, "mac_addr": "60-76-88-00-00-00"}


def _config(device: VelodyneDevice) -> dict[str, Any]:
    one = device.settings
    return {
        "rpm": one.rpm,
        "returns": one.mode.capitalize(),
        "laser": _switch(one.laser),
        "fov": {"start": one.fov[0], "end": one.fov[1]},
        "phaselock": {"enabled": _switch(one.phase_lock), "offset": one.phase_cdeg},
        "host": dict(one.host),
        "net": dict(one.net),
    }


def _status(device: VelodyneDevice, now_ns: int) -> dict[str, Any]:
    hz = device.motor.speed_hz(now_ns)
    phase = int(device.motor.turns(np.array(now_ns)) % 1.0 * TURN_CDEG)
    lock = _switch(device.phase_locked(now_ns))
    return {
        "gps": {"pps_state": PPS[device.gps.state(now_ns)], "position": device.sentence(now_ns).decode().strip()},
        "motor": {"state": _switch(hz > 0.0), "rpm": round(60.0 * hz), "lock": lock, "phase": phase},
        "laser": {"state": _switch(device.fires)},
    }


def _diag(device: VelodyneDevice, now_ns: int) -> dict[str, Any]:
    """Counts of the converters at 45 degrees and 12 V; the conversions are the maker's, the values ours."""
    lm20 = 1.8639 - 3.88e-6 * ((45.0 + 1481.96) ** 2 - 2.1962e6)
    top = {"hv": 3.63, "ad_temp": 0.0, "lm20_temp": lm20, "pwr_5v": 2.5, "pwr_2_5v": 2.5, "pwr_3_3v": 3.3}
    top |= {"pwr_5v_raw": 2.6, "pwr_vccint": 1.2}
    bottom = {"i_out": 2.5 + 0.07, "pwr_1_2v": 1.2, "lm20_temp": lm20, "pwr_5v": 2.5, "pwr_2_5v": 2.5}
    bottom |= {"pwr_3_3v": 3.3, "pwr_v_in": 12.0 / 11.0, "pwr_1_25v": 1.25}
    parts = {"top": top, "bot": bottom}
    return {
        "volt_temp": {name: {key: round(VOLT * volt) for key, volt in part.items()} for name, part in parts.items()}
    }


def _switch(on: bool) -> str:
    return "On" if on else "Off"


def _reported(what: Callable[[VelodyneDevice, int], Any]) -> Callable[[VelodyneDevice, Request], bytes]:
    return lambda device, request: page(200, json.dumps(what(device, request.now_ns)).encode(), "application/json")


def _snapshot(device: VelodyneDevice, now_ns: int) -> dict[str, Any]:
    parts = {"info": _info(device), "config": _config(device)}
    return parts | {"status": _status(device, now_ns), "diag": _diag(device, now_ns)}


def _form(path: str) -> Callable[[VelodyneDevice, Request], bytes | Refused]:
    def act(device: VelodyneDevice, request: Request) -> bytes | Refused:
        try:
            fields = fields_of(request.data)
        except ValueError:
            return Refused(DropReason.BAD_ARGUMENT, "no form")
        found = changed(device.settings, path, fields)
        if isinstance(found, str) or not fields:
            return Refused(DropReason.BAD_ARGUMENT, found if isinstance(found, str) else "empty form")
        device.change(request.now_ns, found)
        return page(200, b"OK")

    return act


def _save(device: VelodyneDevice, request: Request) -> bytes:
    device.saved = device.settings
    return page(200, b"OK")


def _packets(device: VelodyneDevice, request: Request) -> bytes:
    if request.address is not None:
        device.listen(request.now_ns, request.address)
    return b"HTTP/1.1 200 OK\r\nContent-Type: application/octet-stream\r\n" + reported(device.model) + b"\r\n"


def _front(device: VelodyneDevice, request: Request) -> bytes:
    return page(200, f"<html><title>{device.model.title}</title>{device.model.title}</html>".encode())


DRIVERS, MANUAL = "Nebula, MRPT", "the maker's scripts (curl examples)"
COMMANDS: Mapping[bytes, Command] = {
    b"GET /": Command("page with the model's name", _front, MANUAL),
    b"GET /cgi/info.json": Command(
        "model, serial number", _reported(lambda device, _: _info(device)), "public clients"
    ),
    b"GET /cgi/status.json": Command("GPS, motor, laser", _reported(_status), MANUAL),
    b"GET /cgi/diag.json": Command("voltages and temperatures", _reported(_diag), MANUAL, "values are fixed"),
    b"GET /cgi/settings.json": Command("settings", _reported(lambda device, _: _config(device)), "public clients"),
    b"GET /cgi/snapshot.hdl": Command("all of it", _reported(_snapshot), DRIVERS),
    b"POST /cgi/setting": Command("rpm, returns, laser", _form("setting"), DRIVERS, "takes effect with the next slice"),
    b"POST /cgi/setting/fov": Command("field of view", _form("fov"), DRIVERS, "start, end"),
    b"POST /cgi/setting/phaselock": Command("phase lock", _form("phaselock"), "public clients", "enabled, offset"),
    b"POST /cgi/setting/host": Command("where it sends", _form("host"), DRIVERS, "stored, not used: the link decides"),
    b"POST /cgi/setting/net": Command("its address", _form("net"), DRIVERS, "stored, not used"),
    b"POST /cgi/save": Command("keep settings over power-off", _save, DRIVERS),
    b"POST /cgi/reset": Command("restart", lambda *_: Answer(page(200, b"OK"), restarts=True), DRIVERS),
    b"GET /packets": Command("data packets on this connection", _packets, "ours", "no real device has it"),
}


class VelodyneSession(http.HttpSession, VelodyneDevice):
    """With its web interface."""

    COMMANDS: ClassVar[Mapping[bytes, Command]] = COMMANDS
    restart_hangs_up = True

    def _splitter(self, kind: LinkKind | None) -> HttpRequests:
        return HttpRequests(LONGEST)

    def _parse(self, request: bytes) -> tuple[bytes, bytes]:
        asked = read(request)
        return asked.code, asked.body

    def _reply(self, request: Request, payload: bytes) -> bytes:
        return payload

    def _refusal(self, request: Request, refused: Refused) -> bytes:
        if refused.reason is DropReason.BAD_ARGUMENT:  # it says 200 and changes nothing (public clients read back)
            return page(200, b"OK")
        path = request.code.partition(b" ")[2]
        known = any(code.endswith(b" " + path) for code in self.COMMANDS)
        return page(405, b"405") if known else page(404, b"404")

    def _complaint(self, fault: Fault) -> bytes | None:
        return page(400, b"400") if fault.reason is not DropReason.TIMEOUT else None
