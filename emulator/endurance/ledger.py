"""Every scan of a run on account: asked for, measured, refused, sent, dropped with a reason, still waiting.

A `LedgerSession` stands between an instrument and its session and writes down what passes; it changes nothing.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from emulator.conditions import NORMAL, Conditions
from emulator.instrument import Measuring
from protocols.errors import ScanRefused
from protocols.scan import Scan, ScanPlan
from protocols.session import Address, Emission, Event, LinkKind, Session

MOST_WAITING = 16
"Scans that a session may hold; an older one that was not sent is missing, and must have been told."


@dataclass
class Ledger:
    """Of one sensor."""

    asked: int = 0
    measured: int = 0
    refused: int = 0
    "Came back for settings that have changed since."
    accepted: int = 0
    again: int = 0
    "Accepted a second time, since the first was withdrawn before it was sent: the same sweep of the mirror."
    sent: int = 0
    missing: int = 0
    "Accepted, not sent and not waiting: each must stand among the dropped ones."
    waiting: OrderedDict[int, None] = field(default_factory=OrderedDict)

    def account(self, dropped: Mapping[str, int]) -> dict[str, Any]:
        """The sums, given what the instrument counted by reason; `unaccounted` must be 0."""
        told = sum(dropped.values()) - self.refused
        under_way = self.asked - self.measured
        lost = max(0, under_way - 1) + max(0, self.missing - told)
        return {
            "asked": self.asked,
            "sent": self.sent,
            "dropped": dict(dropped),
            "measured_again": self.again,
            "dropped_after_measuring": self.refused + self.missing,
            "waiting": under_way + len(self.waiting),
            "unaccounted": lost,
        }


class LedgerMeasuring:
    """Counts what is asked for and what comes back."""

    def __init__(self, inner: Measuring, ledgers: Mapping[str, Ledger]) -> None:
        self._inner = inner
        self._ledgers = ledgers

    def request(self, sensor: str, plan: ScanPlan, conditions: Conditions = NORMAL) -> None:
        self._ledgers[sensor].asked += 1
        self._inner.request(sensor, plan, conditions)

    def collect(self, sensor: str) -> list[Scan]:
        scans = self._inner.collect(sensor)
        self._ledgers[sensor].measured += len(scans)
        return scans


class LedgerSession(Session):
    """Writes down which scans a session takes and which it sends."""

    def __init__(self, inner: Session, ledger: Ledger) -> None:
        self._inner = inner
        self._ledger = ledger
        self.can_bitrate = inner.can_bitrate

    def power_on(self, now_ns: int) -> None:
        self._inner.power_on(now_ns)

    def connected(self, now_ns: int, address: Address, kind: LinkKind) -> None:
        self._inner.connected(now_ns, address, kind)

    def disconnected(self, now_ns: int, address: Address) -> None:
        self._inner.disconnected(now_ns, address)

    def receive(self, data: bytes, now_ns: int, address: Address | None = None) -> None:
        self._inner.receive(data, now_ns, address)

    def advance(self, now_ns: int) -> None:
        self._inner.advance(now_ns)

    def next_deadline(self) -> int | None:
        return self._inner.next_deadline()

    def next_plan(self) -> ScanPlan | None:
        return self._inner.next_plan()

    def submit(self, scan: Scan) -> None:
        ledger = self._ledger
        try:
            self._inner.submit(scan)
        except ScanRefused:
            ledger.refused += 1
            raise
        ledger.accepted += 1
        ledger.again += scan.plan.sweep in ledger.waiting
        ledger.waiting[scan.plan.sweep] = None
        ledger.waiting.move_to_end(scan.plan.sweep)
        while len(ledger.waiting) > MOST_WAITING:
            ledger.waiting.popitem(last=False)
            ledger.missing += 1

    def missed(self, plan: ScanPlan, now_ns: int) -> bool:
        return self._inner.missed(plan, now_ns)

    def take_emissions(self, now_ns: int) -> list[Emission]:
        emissions = self._inner.take_emissions(now_ns)
        for emission in emissions:
            if emission.sweep is not None and emission.sweep in self._ledger.waiting:
                ledger = self._ledger  # the same scan to a second host counts once
                ledger.sent += 1
                while ledger.waiting and next(iter(ledger.waiting)) < emission.sweep:
                    ledger.waiting.popitem(last=False)  # passed over: the session must have told
                    ledger.missing += 1
                ledger.waiting.pop(emission.sweep, None)
        return emissions

    def take_events(self) -> list[Event]:
        return self._inner.take_events()
