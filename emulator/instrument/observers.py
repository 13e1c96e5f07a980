"""The observers of one sensor: each gets what its links carry, with the instants of first and last bit.

Belongs here: observers, and what must be kept of lines and buses to say when bytes leave and whose scan they are.
Not: the contract of a watcher (`watching`), what is sent (`instrument`).
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Sequence
from functools import partial

from emulator.faults.events import FaultEvent
from emulator.instrument.observer import LineTimes, Observer, Payload
from emulator.transports.can_link import CanLink
from emulator.transports.can_wire import Carried
from emulator.transports.link import Link, Received
from protocols.scan import Scan
from protocols.session import Emission, Event, LinkKind

FRAMES_KEPT = 1024
"Frames of a bus that begin a scan and have not been carried yet, the oldest forgotten."


class Observers:
    """Observers while one sensor works; all calls are cheap while nobody does."""

    def __init__(self, sensor: str, links: Sequence[Link]) -> None:
        self._sensor = sensor
        self._links = links
        self._watchers: list[Observer] = []
        self._times: dict[int, LineTimes] = {}
        self._speeds: dict[int, int] = {}
        "Of serial links, as last reported; for watchers that come later."
        self._on_bus: dict[int, deque[tuple[int, bytes, int]]] = {}
        "CAN link -> identifier, bytes and sweep of frames that begin a scan and have not been carried yet."

    def __contains__(self, watcher: Observer) -> bool:
        return watcher in self._watchers

    def add(self, watcher: Observer) -> None:
        """Tell it of everything from now on."""
        self._watchers = [*self._watchers, watcher]
        for index, link in enumerate(self._links):
            if link.kind is LinkKind.SERIAL:
                self._times.setdefault(index, LineTimes(self._speeds.get(index)))
            elif isinstance(link, CanLink):
                self._on_bus.setdefault(index, deque(maxlen=FRAMES_KEPT))
                link.on_carried = partial(self._carried, index)

    def remove(self, watcher: Observer) -> None:
        """Tell it no more; also from within what it is reported."""
        self._watchers = [one for one in self._watchers if one is not watcher]
        if self._watchers:
            return
        self._times.clear()
        self._on_bus.clear()
        for link in self._links:
            if isinstance(link, CanLink):
                link.on_carried = None

    def set_speed(self, index: int, now_ns: int, baud: int | None) -> None:
        """A line has another speed at once, whatever the device says."""
        if index in self._times:
            self._times[index].set_speed(now_ns, baud)

    def clear(self, now_ns: int) -> None:
        """What has not left the links by now never does."""
        for times in self._times.values():
            times.clear(now_ns)
        for waiting in self._on_bus.values():
            waiting.clear()

    def heard(self, index: int, received: Received, now_ns: int) -> None:
        """Bytes came in on a link; frames of a bus are reported as the bus carries them."""
        if self._watchers and self._links[index].kind is not LinkKind.CAN:
            self._tell(Payload(self._sensor, index, received.peer, received.data, now_ns, now_ns, False))

    def reported(self, emission: Emission) -> None:
        """What a scan's telegram reports of the device's time."""
        if emission.reported is not None and emission.sweep is not None:
            for watcher in self._watchers:
                watcher.reported(self._sensor, emission.sweep, emission.reported)

    def leaving(self, index: int, peer: int | None, emission: Emission) -> None:
        """A telegram is about to be handed to a link."""
        if emission.line_speed is not None:
            self._speeds[index] = emission.line_speed
        if emission.sweep is not None and index in self._on_bus:
            self._on_bus[index].append((peer or 0, emission.payload, emission.sweep))

    def left(self, index: int, peer: int | None, emission: Emission) -> None:
        """The link has taken it; frames of a bus are reported as the bus carries them."""
        if not self._watchers or self._links[index].kind is LinkKind.CAN:
            return
        start_ns = end_ns = emission.due_ns
        pace = None
        if index in self._times:
            if emission.cuts:
                end_ns = self._times[index].cut(emission.due_ns)
                for watcher in self._watchers:
                    watcher.cut(self._sensor, index, end_ns)
                return
            start_ns, end_ns, pace = self._times[index].of_emission(emission)
        if emission.payload:
            data, label, sweep = emission.payload, emission.label, emission.sweep
            self._tell(Payload(self._sensor, index, peer or 0, data, start_ns, end_ns, True, label, sweep, pace))

    def departed(self, index: int, departures: Iterable[tuple[int, int]], took_ns: int) -> None:
        """Payloads have left a link, scheduled and actual instant of each; handing them over took that long at most."""
        for due_ns, actual_ns in departures:
            for watcher in self._watchers:
                watcher.departed(self._sensor, index, due_ns, actual_ns + took_ns)

    def scan(self, scan: Scan) -> None:
        """The device has taken a sweep."""
        for watcher in self._watchers:
            watcher.scan(self._sensor, scan)

    def event(self, event: Event | FaultEvent) -> None:
        """The session reported something, or a fault did."""
        for watcher in self._watchers:
            watcher.event(self._sensor, event)

    def _carried(self, index: int, frame: Carried, own: bool) -> None:
        start_ns = frame.start_ns if own else frame.end_ns
        sweep = self._sweep_of(index, frame) if own else None
        self._tell(Payload(self._sensor, index, frame.peer, frame.data, start_ns, frame.end_ns, own, sweep=sweep))

    def _sweep_of(self, index: int, frame: Carried) -> int | None:
        """The scan that a carried frame begins; frames that the bus has lost are forgotten with it."""
        waiting = self._on_bus[index]
        for place, (peer, data, sweep) in enumerate(waiting):
            if (peer, data) == (frame.peer, frame.data):
                for _ in range(place + 1):
                    waiting.popleft()
                return sweep
        return None

    def _tell(self, payload: Payload) -> None:
        for watcher in self._watchers:
            watcher.payload(payload)
