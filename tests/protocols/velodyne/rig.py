"""A Velodyne in virtual time: two datagram links, a web interface, and a world that answers its plans."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from protocols.scan import Scan, ScanPlan
from protocols.session import Address, Dropped, Emission, LinkKind
from protocols.velodyne import FAMILY, codec
from protocols.velodyne.session import VelodyneSession

MS, SECOND = 1_000_000, 1_000_000_000
LOOK_AHEAD_NS = 250 * MS
DATA, POSITION, WEB = Address(0, 0), Address(1, 0), Address(2, 7)


def wall(plan: ScanPlan) -> Scan:
    """Ten metres everywhere, half as bright as white; nothing else."""
    scan = Scan.empty(plan, 2)
    scan.range_m[:, 0], scan.intensity[:, 0] = 10.0, 62.5
    return scan


class Rig:
    """Drives the session as an instrument does."""

    def __init__(
        self, device: Mapping[str, Any] | None = None, model: str = "velodyne-vlp-16", session: Any = None
    ) -> None:
        quick = {"boot_s": 0.0, "spin_up_s": 0.0, "slice_packets": 16}
        made = session or FAMILY.new_session(quick | dict(device or {}), {"model": model})
        self.session: VelodyneSession = made
        self.world: Callable[[ScanPlan], Scan] = wall
        self.now_ns = 0
        self.sent: list[Emission] = []
        self.dropped: list[Dropped] = []
        self.plans: list[ScanPlan] = []
        for address, kind in ((DATA, LinkKind.DATAGRAM), (POSITION, LinkKind.DATAGRAM)):
            self.session.connected(0, address, kind)
        self.session.power_on(0)
        self.session.connected(0, WEB, LinkKind.STREAM)

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

    def ask(self, request: bytes) -> bytes:
        """A request and its reply."""
        self.session.receive(request, self.now_ns, WEB)
        return b"".join(one.payload for one in self.run(0.002) if one.address == WEB)

    def get(self, path: str) -> Any:
        head, _, body = self.ask(f"GET {path} HTTP/1.1\r\nHost: x\r\n\r\n".encode()).partition(b"\r\n\r\n")
        assert head.startswith(b"HTTP/1.1 200 OK\r\n")
        assert f"Content-Length: {len(body)}".encode() in head
        return json.loads(body)

    def post(self, path: str, body: str) -> bytes:
        return self.ask(f"POST {path} HTTP/1.1\r\nContent-Length: {len(body)}\r\n\r\n{body}".encode())


def packets(sent: list[Emission], address: Address = DATA) -> list[Emission]:
    """Data packets to an address."""
    return [one for one in sent if one.address == address and len(one.payload) == codec.DATA_BYTES]


def firings(sent: list[Emission]) -> codec.Firings:
    """What data packets say."""
    read = codec.decode(np.frombuffer(b"".join(one.payload for one in packets(sent)), codec.PACKET))
    assert read is not None
    return read[2]


def stamps(sent: list[Emission]) -> list[int]:
    """Of data packets."""
    return [int.from_bytes(one.payload[1200:1204], "little") for one in packets(sent)]
