"""Sends a recording again: a session that has nothing to decide. What hosts say is counted and not answered."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from emulator.instrument.instrument import Instrument
from emulator.instrument.observer import Observer, Payload
from emulator.measuring.measuring import InPlace
from emulator.recording.reader import WireOf, WirePayload
from emulator.runtime.virtual_daemon import VirtualDaemon
from emulator.transports.can_link import CanPorts
from emulator.transports.link import Link
from emulator.transports.schemes import open_link
from protocols.scan import Scan, ScanPlan
from protocols.session import Address, Dropped, DropReason, Emission, Event, LinkKind, Session


@dataclass(frozen=True)
class Timed:
    """One payload of a sensor, for one of its links."""

    at_ns: int
    link: int
    payload: WirePayload


class ReplaySession(Session):
    """Emits payloads at their recorded instants, counted from `start`."""

    def __init__(self, wires: Sequence[WireOf], kinds: Sequence[LinkKind], gap_ns: int = 0) -> None:
        """One wire a link. `gap_ns`: between two rounds of a loop."""
        self._entries = sorted(
            (Timed(one.start_ns, link, one) for link, wire in enumerate(wires) for one in wire.payloads),
            key=lambda entry: entry.at_ns,
        )
        self._kinds = tuple(kinds)
        self._bauds: dict[int, int] = {}
        self._start_ns: int | None = None
        self._at = 0
        self._gap_ns = gap_ns
        self.rounds = 0
        self.loops = 1
        "Rounds to be sent; 0: without end."
        self.allowed: int | None = None
        "Payloads that may still be sent; None: all."
        self._events: list[Event] = []
        self._first_ns, self._last_ns = self.span() or (0, 0)

    def span(self) -> tuple[int, int] | None:
        """First and last instant of its payloads; None without any."""
        if not self._entries:
            return None
        return self._entries[0].at_ns, max(entry.payload.end_ns for entry in self._entries)

    def share(self, first_ns: int, last_ns: int) -> None:
        """Begin, and end a round, with the recording and not with the first and last payload of this link."""
        self._first_ns, self._last_ns = first_ns, last_ns

    def give_up(self) -> None:
        """Send no more: its link is lost."""
        self._entries = []

    @property
    def finished(self) -> bool:
        """Everything has been handed over."""
        return not self._entries or (self.loops > 0 and self.rounds >= self.loops)

    @property
    def progress(self) -> float:
        """Share of its payloads that have been handed over; without end, of this round."""
        within = self._at / max(1, len(self._entries))
        return 1.0 if self.finished else (self.rounds + within) / self.loops if self.loops else within

    def start(self, now_ns: int) -> None:
        """The recording's first payload is due at this instant."""
        self._start_ns = now_ns

    def power_on(self, now_ns: int) -> None:
        pass

    def receive(self, data: bytes, now_ns: int, address: Address | None = None) -> None:
        self._events.append(Dropped(now_ns, DropReason.REFUSED, "a recording does not answer", len(data)))

    def advance(self, now_ns: int) -> None:
        pass

    def next_deadline(self) -> int | None:
        return None if self.allowed == 0 else self.next_ns()

    def next_ns(self) -> int | None:
        """When the next payload is due, allowed or not; None: there is none."""
        if self._start_ns is None or self.finished:
            return None
        return self._start_ns + self._entries[self._at].at_ns - self._first_ns

    def next_plan(self) -> ScanPlan | None:
        return None

    def submit(self, scan: Scan) -> None:
        pass

    def take_emissions(self, now_ns: int) -> list[Emission]:
        due: list[Emission] = []
        while (at_ns := self.next_deadline()) is not None and at_ns <= now_ns:
            due += self._emissions(self._entries[self._at], at_ns)
            self._at += 1
            self.allowed = None if self.allowed is None else self.allowed - 1
            if self._at == len(self._entries):
                self._at = 0
                self.rounds += 1
                assert self._start_ns is not None
                self._start_ns += self._last_ns - self._first_ns + self._gap_ns
        return due

    def _emissions(self, entry: Timed, at_ns: int) -> list[Emission]:
        # everybody on a stream hears it: the connections of the recording are long gone
        can = self._kinds[entry.link] is LinkKind.CAN
        everybody = Address(entry.link, entry.payload.peer) if can else None
        found = []
        baud = entry.payload.baud
        if baud and self._kinds[entry.link] is LinkKind.SERIAL and self._bauds.get(entry.link) != baud:
            self._bauds[entry.link] = baud
            found.append(Emission(at_ns, b"", everybody, line_speed=baud))
        found.append(Emission(at_ns, entry.payload.data, everybody, sweep=entry.payload.sweep, label="replay"))
        return found

    def take_events(self) -> list[Event]:
        events, self._events = self._events, []
        return events


class GapErrors(Observer):
    """How late each payload was begun, in real time."""

    def __init__(self, daemon: VirtualDaemon) -> None:
        self._daemon = daemon
        self.late_ns: list[int] = []
        self.end_ns = 0
        "When the last bit has left of all that was handed over, in the time of the run."

    def payload(self, payload: Payload) -> None:
        if payload.sent:
            self.late_ns.append(max(0, self._daemon.late_ns(payload.start_ns)))
            self.end_ns = max(self.end_ns, payload.end_ns)


def step(daemon: VirtualDaemon, sessions: Sequence[ReplaySession], sent: GapErrors) -> None:
    """Let time go until the next payload has left to its last bit; `sessions` are allowed nothing before."""
    waiting = [(due_ns, index) for index, one in enumerate(sessions) if (due_ns := one.next_ns()) is not None]
    if waiting:
        due_ns, index = min(waiting)
        sessions[index].allowed = 1
        daemon.advance(due_ns)
        daemon.run_of.advance(daemon.now_ns)  # due at this very instant
        daemon.advance(sent.end_ns)


def open_players(wires: Sequence[WireOf], links: Mapping[str, str], gap_ns: int = 0) -> list[Instrument]:
    """An instrument for each recorded link, named after sensor and link; opens what they are sent on.

    They keep the recorded time between each other, from round to round of a loop too.

    `links`: sensor -> link instead of the recorded one. Raises `LinkError`.
    """
    ports = CanPorts()
    opened: list[Link] = []
    players = []
    sessions: list[ReplaySession] = []
    try:
        for wire in wires:
            url = links.get(wire.sensor, wire.url)
            opened.append(open_link(url, wire.kind == "serial", can_ports=ports))
            session = ReplaySession([wire], [opened[-1].kind], gap_ns)
            name = wire.sensor if wire.link == 0 else f"{wire.sensor}/{wire.link}"
            sessions.append(session)
            players.append(Instrument(name, session, opened[-1:], InPlace({})))
            players[-1].ledger.plans = False
            players[-1].driven = True
    except BaseException:
        for link in opened:
            link.close()
        raise
    spans = [span for one in sessions if (span := one.span()) is not None]
    for session in sessions if spans else ():
        session.share(min(first for first, _ in spans), max(last for _, last in spans))
    return players
