"""A session with a free rotor in virtual time; a world that answers its plans by the true direction of each beam."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from protocols import family
from protocols.scan import Scan, ScanPlan
from protocols.session import Address, Dropped, DropReason, Emission, LinkKind

MS, SECOND = 1_000_000, 1_000_000_000
LOOK_AHEAD_NS = 250 * MS
LINE = Address(0, 0)
RangeAt = Callable[[np.ndarray], np.ndarray]


def slope(angle_deg: np.ndarray) -> np.ndarray:
    """1 m ahead, 10 mm more for each degree clockwise; nothing from 350 degrees on. [m]"""
    return np.where(angle_deg < 350.0, 1.0 + 0.01 * angle_deg, np.nan)


class Rig:
    """One session, switched on at 0."""

    def __init__(
        self, name: str, model: str, device: Mapping[str, Any] | None = None, range_at: RangeAt = slope
    ) -> None:
        self.session: Any = family(name).new_session(device or {}, {"model": model})
        self.range_at, self.now_ns = range_at, 0
        self.plans: list[ScanPlan] = []
        self.sent: list[Emission] = []
        self.events: list[Any] = []
        self.measures = True
        self.session.connected(0, LINE, LinkKind.SERIAL)
        self.session.power_on(0)

    def world(self, plan: ScanPlan) -> Scan:
        scan = Scan.empty(plan)
        angle_deg = np.degrees(-plan.azimuth_rad) % 360.0
        scan.range_m[:, 0] = self.range_at(angle_deg)
        scan.intensity[:, 0] = np.where(np.isnan(scan.range_m[:, 0]), np.nan, 16.0)
        return scan

    def step(self) -> int | None:
        session = self.session
        session.advance(self.now_ns)
        while self.measures and (plan := session.next_plan()) is not None:
            if plan.start_ns > self.now_ns + LOOK_AHEAD_NS:
                break
            self.plans.append(plan)
            session.submit(self.world(plan))
        self.sent += session.take_emissions(self.now_ns)
        self.events += session.take_events()
        plan = session.next_plan() if self.measures else None
        wakes = [session.next_deadline(), None if plan is None else plan.start_ns - LOOK_AHEAD_NS]
        return min((wake for wake in wakes if wake is not None), default=None)

    def run(self, duration_ns: int) -> None:
        until_ns = self.now_ns + duration_ns
        while (wake_ns := self.step()) is not None and wake_ns <= until_ns:
            self.now_ns = max(self.now_ns, wake_ns)
        self.now_ns = until_ns

    def take(self) -> list[Emission]:
        """What was sent since the last call, without changes of speed."""
        found, self.sent = [one for one in self.sent if one.payload], []
        return found

    def raw(self) -> bytes:
        return b"".join(one.payload for one in self.take())

    def put(self, data: bytes) -> None:
        self.session.receive(data, self.now_ns, LINE)

    def ask(self, command: int, within_ns: int = 2 * MS) -> bytes:
        """The reply to `A5 command`."""
        self.put(bytes((0xA5, command)))
        self.run(within_ns)
        return self.raw()

    def dropped(self) -> list[DropReason]:
        found = [one.reason for one in self.events if isinstance(one, Dropped)]
        self.events = []
        return found
