"""Event log of a device, for counters and recordings: in order, and bounded if the caller never takes the events.

Belongs here: the list and shortcuts for its events. Not: when a family logs one.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable

from protocols.session import (
    MAX_EVENTS,
    Address,
    CommandHandled,
    Dropped,
    DropReason,
    Event,
    ModeChanged,
    Restarted,
    dropped_scans,
)


class EventLog:
    """Events not yet taken, the oldest first; beyond `most` the oldest are discarded."""

    def __init__(self, most: int = MAX_EVENTS) -> None:
        self._kept: deque[Event] = deque(maxlen=most)

    def __len__(self) -> int:
        return len(self._kept)

    def add(self, event: Event) -> None:
        """Append one event."""
        self._kept.append(event)

    def extend(self, events: Iterable[Event]) -> None:
        """Append several events."""
        self._kept.extend(events)

    def take(self) -> list[Event]:
        """All since the last call."""
        if not self._kept:
            return []
        events = list(self._kept)
        self._kept.clear()
        return events

    def drop(self, at_ns: int, reason: DropReason, detail: str = "", count: int = 1) -> None:
        """Input that was dropped; `count`: number of bytes or frames."""
        self._kept.append(Dropped(at_ns, reason, detail, count))

    def unsent(
        self,
        at_ns: int,
        reason: DropReason,
        sweeps: range | int,
        detail: str = "",
        stream: int | None = None,
        address: Address | None = None,
    ) -> None:
        """Scans that hosts do not get, by their numbers; without `address`: no host. Nothing for an empty range."""
        sweeps = range(sweeps, sweeps + 1) if isinstance(sweeps, int) else sweeps
        self._kept.extend(dropped_scans(at_ns, reason, sweeps, detail, stream, address))

    def handled(self, at_ns: int, command: str, outcome: str = "done") -> None:
        """A host's command was answered."""
        self._kept.append(CommandHandled(at_ns, command, outcome))

    def mode(self, at_ns: int, mode: str) -> None:
        """The device is in another mode."""
        self._kept.append(ModeChanged(at_ns, mode))

    def restarted(self, at_ns: int) -> None:
        """The device was switched on, or has reset itself."""
        self._kept.append(Restarted(at_ns))
