"""A session made of the parts: what it says of what happened, and time that goes on in order.

Belongs here: what no device does otherwise. Not: sweeps (sweeps.py) and commands (requests.py).
"""

from __future__ import annotations

from abc import abstractmethod

from protocols.session import Emission, Event, Session
from protocols.skeleton.events import EventLog
from protocols.skeleton.instants import earliest, run_until
from protocols.skeleton.outbox import Outbox


class EventSession(Session):
    """A session that keeps its events; for families with a schedule of their own."""

    def __init__(self) -> None:
        self._events = EventLog()
        self._now_ns = 0
        "Until when time has come."

    def take_events(self) -> list[Event]:
        """What happened since the last call."""
        return self._events.take()


class TimedSession(EventSession):
    """A session in which whatever is due happens at its own instant, however far a caller jumps."""

    def __init__(self, burst: int = 1) -> None:
        super().__init__()
        self._outbox = Outbox(burst)

    @abstractmethod
    def _next_instant(self) -> int | None:
        """The next instant at which the device does something by itself, sending apart; None: it waits for a host."""

    @abstractmethod
    def _happen(self, now_ns: int) -> None:
        """Do what is due; `_next_instant` must have moved on then."""

    def advance(self, now_ns: int) -> None:
        """Let everything that is due by `now_ns` happen, each at its own instant."""
        self._now_ns = run_until(now_ns, self._now_ns, self._next_instant, self._at)

    def _at(self, now_ns: int) -> None:
        self._now_ns = now_ns
        self._happen(now_ns)

    def next_deadline(self) -> int | None:
        """The next instant, or the next telegram."""
        return earliest((self._next_instant(), self._outbox.next_ns()))

    def take_emissions(self, now_ns: int) -> list[Emission]:
        """What is due by `now_ns`, in the order it leaves."""
        self.advance(now_ns)
        return self._outbox.take(now_ns)
