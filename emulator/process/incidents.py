"""Incidents of processes, files and links in a run: reported once, counted, shown in every report of a run.

Belongs here: what may happen, by name, and what each says about the run's exit code. Not: faults on purpose
(`faults/`), mistakes of hosts (`DropReason`), and who notices (each part notes its own incident).
"""

from __future__ import annotations

import threading
from collections import Counter, deque
from collections.abc import Callable
from dataclasses import dataclass

FEED_ENDED = 3
"As of a link that is lost."
SILENT = 5
"Exit code: a sensor fell silent, or scans of a run do not add up."
RECORDING_CUT = 4
"Exit code: the run went on, but its recording ended early."

KEPT = 64
"Incidents kept of the beginning of a run, and as many of its end; all are counted."


@dataclass(frozen=True)
class IncidentKind:
    """Something that can happen to a run."""

    meaning: str
    exit_code: int = 0
    "Of a run in which it happened; 0: the run went on as it should."


KINDS = {
    "worker replaced": IncidentKind("a measuring process ended or hung; a new one continues its work"),
    "worker lost": IncidentKind("no measuring process could be started", SILENT),
    "worker back": IncidentKind("a measuring process was started again"),
    "sweep unmeasured": IncidentKind("a sweep could not be measured and came back without echoes; once per cause"),
    "sensor silent": IncidentKind("a sensor sent nothing for many scan periods although a host requests scans", SILENT),
    "sensor back": IncidentKind("a silent sensor sends again"),
    "scans unaccounted": IncidentKind("requested is not sent + dropped + withdrawn + in flight", SILENT),
    "recording ended": IncidentKind("a recording could not be continued", RECORDING_CUT),
    "recording moved": IncidentKind("a folder or file of a recording was moved; it continues in the new place"),
    "link restored": IncidentKind("the path of a link was removed or replaced, and has been restored"),
    "link path taken": IncidentKind("another program has taken the path of a link; it is left alone"),
    "link path gone": IncidentKind(
        "the path of a link is gone and cannot be restored: its folder is missing or not writable"
    ),
    "feed silent": IncidentKind("no poses came for longer than live.silent.after_s, which ends this run", FEED_ENDED),
    "signal limited": IncidentKind("a value of the vehicle bus was beyond its signal's limits; once per signal"),
    "helper ended": IncidentKind(
        "the process that announces devices by mDNS ended or hangs; it is started again, three times at most"
    ),
}
"Name -> what it means; docs/endurance.md has the same table from here."


@dataclass(frozen=True)
class Incident:
    """One of them."""

    kind: str
    at_ns: int
    "On the run's clock."
    on: str
    "Sensor, link, worker or file."
    text: str

    def as_json(self) -> dict[str, object]:
        """For events, `status` and the last line of a run."""
        return {"kind": self.kind, "at_s": self.at_ns * 1e-9, "on": self.on, "text": self.text}


class Incidents:
    """All of one run; parts may note from any thread."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._first: list[Incident] = []
        self._last: deque[Incident] = deque(maxlen=KEPT)
        self.counts: Counter[tuple[str, str]] = Counter()
        "By kind, and what it was on."
        self.listeners: list[Callable[[Incident], None]] = []
        "Called with each, in the thread that noted it."

    def note(self, kind: str, at_ns: int, on: str, text: str) -> None:
        """Something happened; `kind` is one of `KINDS`."""
        incident = Incident(kind, at_ns, on, text)
        with self._lock:
            assert kind in KINDS, kind
            self.counts[kind, on] += 1
            (self._first if len(self._first) < KEPT else self._last).append(incident)
        for listener in list(self.listeners):
            listener(incident)

    @property
    def exit_code(self) -> int:
        """What the run ends with because of them; the lowest where several ask, 0 where none does."""
        with self._lock:
            return min((code for kind, _ in self.counts if (code := KINDS[kind].exit_code)), default=0)

    def rows(self) -> list[dict[str, object]]:
        """Those that are kept, in order, ready for JSON."""
        with self._lock:
            return [one.as_json() for one in (*self._first, *self._last)]

    def totals(self) -> dict[str, int]:
        """How many of each kind."""
        with self._lock:
            found: Counter[str] = Counter()
            for (kind, _), count in self.counts.items():
                found[kind] += count
            return dict(found)
