"""What one sensor did: scans, replies, gaps, what was given up or not taken, and how late.

Belongs here: the counters and which of the session's events moves which. Not: when things happen (`instrument`), how
counters are shown (`metrics`, `run_report/`).
"""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass, field

from emulator.instrument.ledger import Ledger
from emulator.instrument.owed import Owed
from emulator.objects.metrics import ListedScan, ObjectScore
from emulator.process.lateness import LatenessLog
from protocols.scan import Scan
from protocols.session import CommandHandled, Dropped, DropReason, Emission, Event, ModeChanged, Restarted

SCAN_REASONS = frozenset(reason.value for reason in DropReason if reason.of_scans)
"`DropReason` values that count scans rather than input bytes."


@dataclass
class InstrumentStats:
    """What one sensor did, for the report at the end of a run."""

    scans_measured: int = 0
    scans_sent: int = 0
    replies_sent: int = 0
    last_scan_due_ns: int | None = None
    "None before the first scan, and again when the device's mode has changed: pauses between streams are no gaps."
    gaps: int = 0
    "Gaps between scans of one stream, and how long they were in all."
    gaps_ns: int = 0
    ledger: Ledger = field(default_factory=Ledger)
    "Every scan that hosts are entitled to."
    owed: Owed = field(default_factory=Owed)
    "When they are entitled to some."
    input_dropped: Counter[str] = field(default_factory=Counter)
    commands: Counter[str] = field(default_factory=Counter)
    restarts: int = 0
    lateness: LatenessLog = field(default_factory=LatenessLog)
    "Actual minus scheduled instant of the last byte of each payload."
    objects: ObjectScore | None = None
    "How well the lists of a sensor that lists objects fit the truth."

    @property
    def rate_hz(self) -> float:
        """Scans per second while they were streamed, a silence that lasts included; NaN before a stream's second
        scan."""
        silent_ns = self.owed.silent_ns(self.ledger.now_ns)
        return self.gaps * 1e9 / (self.gaps_ns + silent_ns) if self.gaps_ns > 0 else math.nan

    @property
    def silent_s(self) -> float:
        """For how long no scan has left although hosts are owed some; 0 where it is not silent."""
        return self.owed.silent_ns(self.ledger.now_ns) * 1e-9

    @property
    def scans_dropped(self) -> Counter[str]:
        """Scans that hosts did not get, by reason, as they stand on account; those withdrawn are among them."""
        return self.ledger.scans_dropped()

    def note_telegram(self, emission: Emission) -> None:
        """One more telegram has left, or will."""
        if emission.sweep is None:
            self.replies_sent += bool(emission.payload)  # an empty one only sets the line's speed
            return
        self.scans_sent += 1
        self.ledger.send(emission)
        if self.last_scan_due_ns is not None:
            self.gaps += 1
            self.gaps_ns += emission.due_ns - self.last_scan_due_ns
        self.last_scan_due_ns = emission.due_ns

    def note_lost(self, emission: Emission, reason: str) -> None:
        """A scan that was sent has got lost behind the device: held back by a fault, or given up by its link."""
        if emission.sweep is not None and self.ledger.take_back(emission, reason):
            self.scans_sent -= 1

    def note_taken(self, scan: Scan) -> None:
        """The device has taken a scan: a list of objects is judged."""
        if isinstance(scan, ListedScan):
            self.objects = self.objects or ObjectScore()
            self.objects.add(scan.objects, scan.truth)

    def note_event(self, event: Event) -> None:
        """Something the session reported."""
        if isinstance(event, Dropped):
            if event.reason.of_scans:
                self.ledger.tell(event)
            else:
                self.input_dropped[event.reason.value] += event.count
        elif isinstance(event, CommandHandled):
            self.commands[f"{event.command}: {event.outcome}"] += 1
        elif isinstance(event, ModeChanged | Restarted):
            self.last_scan_due_ns = None
            self.restarts += isinstance(event, Restarted)
