"""When scans of a sensor are owed to hosts, and whether it has fallen silent while they were.

Belongs here: who is to blame for a stream's end, and what counts as silence. Not: the account of single scans (ledger),
whether sweeps are still measured (`runtime.liveness`), names and texts of expectations (series, expectations).

Scans are owed from the instant at which a session wants the first sweep until its host ends the stream: by a command,
by hanging up, or because what it asked for is complete: then the session wants no more. A power cut, a pulled plug, a
restart or a change of mode that no host has asked for end nothing: what they stop is owed until scans are wanted again.
"""

from __future__ import annotations

import statistics
from collections import deque
from collections.abc import Collection, Iterable

from protocols.scan import ScanPlan
from protocols.session import Event, ModeChanged, Restarted

SILENT_GAPS = 3.0
"Times the usual gap without a scan: less is a late one."
FIRST_NS = 2_000_000_000
"Without a usual gap yet: so long after the first sweep's end, as slow a line as there is has carried its scan."
GAPS_KEPT = 31
SPANS_KEPT = 1024
"Times in which scans were owed; of hosts that ask for single scans there may be many."
HOST_NS = 5_000_000_000
"What changes so long after a host has spoken may be what it has asked for: an LMS2xx takes three seconds."


class Span:
    """A time in which scans are owed."""

    def __init__(self, from_ns: int, first_ns: int) -> None:
        self.from_ns = from_ns
        self.first_ns = first_ns
        "When the first sweep is over."
        self.to_ns: int | None = None
        "None: it goes on."


def silence_ns(sent_ns: int | None, first_ns: int, usual_ns: float | None, now_ns: int) -> int:
    """For how long a sensor that owes scans has been silent; 0: it is not, as far as its usual gap shows."""
    since_ns = first_ns if sent_ns is None else max(sent_ns, first_ns)
    limit_ns = FIRST_NS if usual_ns is None else SILENT_GAPS * usual_ns
    quiet_ns = now_ns - since_ns
    return quiet_ns if quiet_ns > limit_ns else 0


def usual_gap(gaps: Collection[float]) -> float | None:
    """The gap that a stream usually has, outages notwithstanding; None: it has none yet."""
    return statistics.median(gaps) if gaps else None


class Owed:
    """Of one sensor."""

    def __init__(self) -> None:
        self.spans: deque[Span] = deque(maxlen=SPANS_KEPT)
        self.sent_ns: int | None = None
        "When a scan was handed to links last, whether or not a host reads there."
        self._sweep: int | None = None
        self._heard_ns: int | None = None
        "When a host was heard last."
        self._asked_ns = 0
        self._scan_ns = 0
        "How long the sweep takes that was asked for last; 0: no other follows it by itself."
        self._gaps_ns: deque[int] = deque(maxlen=GAPS_KEPT)
        self._asks_ns: deque[int] = deque(maxlen=GAPS_KEPT)
        "From scan to scan, and from one that is asked for to the next."
        self._died = False
        "What is owed was stopped by no host."
        self._torn = False
        "Hosts that went did not go by themselves, and none has come since."

    def heard(self, now_ns: int) -> None:
        """A host has spoken, or come."""
        self._heard_ns = now_ns
        self._torn = False

    def ask(self, now_ns: int, plan: ScanPlan) -> None:
        """The session wants that sweep measured."""
        if self.spans and self._goes_on(now_ns):
            self._asks_ns.append(now_ns - self._asked_ns)
        else:
            if self.spans:
                self.spans[-1].to_ns = self._asked_ns
            self._asks_ns.clear()
            self.spans.append(Span(now_ns, max(now_ns, plan.start_ns + round(1e9 * plan.duration_s))))
        self._asked_ns, self._died = now_ns, False
        self._scan_ns = 0 if plan.period_ns == 0 else round(1e9 * plan.duration_s)

    def wait(self, now_ns: int) -> None:
        """It still wants the sweep that it has asked for, or will."""
        if self.spans and self._goes_on(now_ns):
            self._asked_ns = now_ns

    def sent(self, due_ns: int, sweep: int) -> None:
        """A scan leaves, for one of its hosts or all."""
        if sweep == self._sweep:
            return
        self._sweep = sweep
        if self.sent_ns is not None and self.spans and self.sent_ns >= self.spans[-1].from_ns:
            self._gaps_ns.append(due_ns - self.sent_ns)
        self.sent_ns = due_ns

    def stop(self, now_ns: int) -> None:
        """The power is cut: no host has asked for that."""
        self._died = bool(self.spans) and self._goes_on(now_ns)

    def tear(self, now_ns: int) -> None:
        """A plug is pulled, or connections are reset."""
        self._torn = bool(self.spans) and self._goes_on(now_ns)

    def reported(self, now_ns: int, events: Iterable[Event]) -> None:
        """What the session has reported: it may have ended a stream by itself."""
        if any(isinstance(event, ModeChanged | Restarted) for event in events):
            if self._heard_ns is None or now_ns - self._heard_ns > HOST_NS:
                self.stop(now_ns)

    def _goes_on(self, now_ns: int) -> bool:
        """Whether the newest span lasts until now at least."""
        if self._died or self._torn or now_ns <= self._asked_ns:
            return True
        if not self._scan_ns and not self._asks_ns:
            return False
        # at least: this is asked at every step of a sensor, the usual gaps are looked at when it does not do
        if now_ns - self._asked_ns <= (SILENT_GAPS * self._scan_ns if self._asks_ns else FIRST_NS):
            return True
        usual_ns = max(usual_gap(self._asks_ns) or 0, usual_gap(self._gaps_ns) or 0, self._scan_ns)
        limit_ns = SILENT_GAPS * usual_ns if self._asks_ns else FIRST_NS
        return now_ns - self._asked_ns <= limit_ns

    def at(self, at_ns: int) -> Span | None:
        """The time in which that instant lies and scans are owed."""
        for span in reversed(self.spans):
            if span.from_ns <= at_ns:
                lasts = self._goes_on(at_ns) if span.to_ns is None else at_ns < span.to_ns
                return span if lasts else None
        return None

    def silent_ns(self, now_ns: int) -> int:
        """For how long no scan has left although some are owed; 0: none are, or it is not silent."""
        span = self.at(now_ns)
        return 0 if span is None else silence_ns(self.sent_ns, span.first_ns, usual_gap(self._gaps_ns), now_ns)
