"""An Ouster in virtual time: two datagram links, its interfaces, and a world that answers its plans."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from protocols.ouster import FAMILY, codec
from protocols.ouster.api import OusterSession
from protocols.scan import Scan, ScanPlan
from protocols.session import Address, Dropped, Emission, LinkKind

MS, SECOND = 1_000_000, 1_000_000_000
LOOK_AHEAD_NS = 250 * MS
LIDAR, IMU, WEB, LINE = Address(0, 0), Address(1, 0), Address(2, 7), Address(3, 9)
API = "/api/v1/"
QUICK = {"boot_s": 0.0, "init_s": 0.0, "spin_up_s": 0.0, "own_calibration": False, "latency_ms": 0.0}


def wall(plan: ScanPlan) -> Scan:
    """Ten metres everywhere, half as bright as white for an OS1; nothing else."""
    scan = Scan.empty(plan, 2)
    scan.range_m[:, 0], scan.intensity[:, 0] = 10.0, 0.5 * 36_125.0 / 100.0 * plan.gain
    return scan


class Rig:
    """Drives the session as an instrument does."""

    def __init__(
        self, device: Mapping[str, Any] | None = None, model: str = "ouster-os1-32", session: Any = None
    ) -> None:
        self.session: OusterSession = session or FAMILY.new_session(QUICK | dict(device or {}), {"model": model})
        self.world: Callable[[ScanPlan], Scan] = wall
        self.now_ns = 0
        self.sent: list[Emission] = []
        self.dropped: list[Dropped] = []
        self.plans: list[ScanPlan] = []
        for address, port in ((LIDAR, 7502), (IMU, 7503)):
            self.session.placed(address, "127.0.0.1", port)
            self.session.connected(0, address, LinkKind.DATAGRAM)
        self.session.power_on(0)
        for address in (WEB, LINE):
            self.session.placed(address, "127.0.0.5", 40_000)
            self.session.connected(0, address, LinkKind.STREAM)

    def run(self, seconds: float) -> list[Emission]:
        """So much time passes; what was sent meanwhile."""
        end_ns, before = self.now_ns + round(1e9 * seconds), len(self.sent)
        while True:
            self._serve()
            wake = self.session.next_deadline()
            plan = self.session.next_plan()
            ahead = None if plan is None else plan.start_ns - LOOK_AHEAD_NS
            later = [one for one in (wake, ahead) if one is not None and one > self.now_ns]
            if not later or min(later) > end_ns:
                break
            self.now_ns = min(later)
        self.now_ns = end_ns
        self._serve()
        return self.sent[before:]

    def _serve(self) -> None:
        self.session.advance(self.now_ns)
        while (plan := self.session.next_plan()) is not None and plan.start_ns - LOOK_AHEAD_NS <= self.now_ns:
            self.plans.append(plan)
            self.session.submit(self.world(plan))
        self.sent += self.session.take_emissions(self.now_ns)
        self.dropped += [one for one in self.session.take_events() if isinstance(one, Dropped)]

    def ask(self, request: bytes, address: Address = WEB) -> bytes:
        """A request and its reply."""
        self.session.receive(request, self.now_ns, address)
        return b"".join(one.payload for one in self.run(0.002) if one.address == address)

    def call(self, method: str, path: str, body: str | None = None) -> tuple[int, Any]:
        """Status and body of a reply, taken apart as a client does."""
        text = "" if body is None else f"Content-Type: application/json\r\nContent-Length: {len(body)}\r\n"
        reply = self.ask(f"{method} {API}{path} HTTP/1.1\r\nHost: x\r\nAccept: */*\r\n{text}\r\n{body or ''}".encode())
        head, _, said = reply.partition(b"\r\n\r\n")
        status = int(head.split(b" ")[1])
        if status == 204:
            assert head == b"HTTP/1.1 204 No Content\r\nServer: nginx\r\nConnection: keep-alive"
            assert said == b""
            return status, None
        assert f"Content-Length: {len(said)}".encode() in head
        return status, json.loads(said)

    def get(self, path: str) -> Any:
        status, said = self.call("GET", path)
        assert status == 200, said
        return said

    def line(self, text: str) -> str:
        """A line of the command interface, and its reply."""
        reply = self.ask(text.encode() + b"\n", LINE)
        assert reply.endswith(b"\n")
        return reply.decode().rstrip()


def lidar(sent: list[Emission], address: Address = LIDAR) -> list[bytes]:
    """Lidar packets."""
    return [one.payload for one in sent if one.address == address and one.label == "lidar"]


def said(rig: Rig, sent: list[Emission]) -> codec.Said:
    """What they say."""
    session = rig.session
    return codec.decode(session.profile, session.unit.rows, b"".join(lidar(sent)), session.fusa)


def points(rig: Rig, columns: codec.Columns, e: int = 0) -> np.ndarray:
    """Points (C, H, 3) in the lidar's frame by the formula of the specification. [m]"""
    unit, turn = rig.session.unit, rig.session.mode[0]
    angle = 2.0 * np.pi * (1.0 - columns.number / turn)[:, None]
    phi, beta = np.radians(unit.elevation_deg), np.radians(unit.azimuth_deg)
    d = np.stack(np.broadcast_arrays(np.cos(angle - beta) * np.cos(phi), np.sin(angle - beta) * np.cos(phi),
                                     np.sin(phi)), axis=2)  # fmt: skip
    n = unit.model.offset_mm / 1000.0
    origin = np.concatenate((n * np.cos(angle), n * np.sin(angle), 0.0 * angle), axis=1)
    return np.asarray(origin[:, None] + (columns.range_mm[e][..., None] / 1000.0 - n) * d)
