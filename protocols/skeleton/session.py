"""Base classes of sessions: event log, outbox, and execution in order of time.

Belongs here: what all devices do in the same way. Not: sweeps (sweeps.py) and commands (requests.py).
"""

from __future__ import annotations

from abc import abstractmethod

from protocols.session import Emission, Event, Session
from protocols.skeleton.events import EventLog
from protocols.skeleton.instants import earliest, run_until
from protocols.skeleton.outbox import Outbox


class EventSession(Session):
    """A session with an event log; for families with their own schedule."""

    def __init__(self) -> None:
        self._events = EventLog()
        self._now_ns = 0
        "Time reached."

    def take_events(self) -> list[Event]:
        """What happened since the last call."""
        return self._events.take()


class TimedSession(EventSession):
    """A session that executes everything at its own instant, however large the steps of its caller."""

    def __init__(self, burst: int = 1) -> None:
        super().__init__()
        self._outbox = Outbox(burst)

    @abstractmethod
    def _next_instant(self) -> int | None:
        """The next instant at which the device acts by itself, except for sending; None: it waits for a host."""

    @abstractmethod
    def _happen(self, now_ns: int) -> None:
        """Execute what is due; afterwards `_next_instant` must be later."""

    def advance(self, now_ns: int) -> None:
        """Execute everything that is due by `now_ns`, each at its own instant."""
        self._now_ns = run_until(now_ns, self._now_ns, self._next_instant, self._at)

    def _at(self, now_ns: int) -> None:
        self._now_ns = now_ns
        self._happen(now_ns)

    def next_deadline(self) -> int | None:
        """The next instant, or the next telegram."""
        return earliest((self._next_instant(), self._outbox.next_ns()))

    def take_emissions(self, now_ns: int) -> list[Emission]:
        """The emissions due by `now_ns`, in order."""
        self.advance(now_ns)
        return self._outbox.take(now_ns)
