"""A device that sends what it measures as datagrams, slice by slice, and on connections of hosts that ask for them.

Belongs here: links and listeners, slices made once, those in which nothing is seen. Not: what fires when (families).
"""

from __future__ import annotations

from abc import abstractmethod
from fractions import Fraction
from typing import Generic, Protocol, TypeVar

from protocols.session import Address, DropReason, LinkKind
from protocols.skeleton.requests import RequestSession
from protocols.skeleton.sweeps import SLICES_KEPT, Sweep

MOST_ECHOES = 4
"Of a beam, out of which families choose the returns that they report."
MOST_KEPT = 1000
"Slices outside of the field of view that are skipped at once; a turn of the slowest motor has less."


class Measurable(Protocol):
    """A slice: what it measures, and what a family has to know of it to make packets."""

    @property
    def sweep(self) -> Sweep:
        """Without beams: nothing is in the field of view."""


Slice = TypeVar("Slice", bound=Measurable)


class PacketSession(RequestSession, Generic[Slice]):
    """Base class of lidars that send packets."""

    def __init__(self, boot_ns: int, period_ns: Fraction) -> None:
        super().__init__(boot_ns, period_ns)
        self._links: list[Address] = []
        "Datagram links, in the order of the scenario."
        self._listeners: list[Address] = []
        "Where packets go besides: hosts that asked on a connection."
        self._made: dict[tuple[int, int, int], Slice] = {}
        "The latest slices, by stream, number and instant."

    # what a family fills in

    @abstractmethod
    def _make(self, number: int) -> Slice:
        """The slice of that number, at the present settings."""

    @abstractmethod
    def _sending(self) -> bool:
        """Whether it sends measurements to those who listen."""

    # hosts

    def connected(self, now_ns: int, address: Address, kind: LinkKind) -> None:
        """A link is open, or a client has connected."""
        super().connected(now_ns, address, kind)
        if kind is LinkKind.DATAGRAM and address not in self._links:
            self._links.append(address)

    def disconnected(self, now_ns: int, address: Address) -> None:
        """A client has disconnected."""
        super().disconnected(now_ns, address)
        self._listeners = [one for one in self._listeners if one != address]

    def listen(self, now_ns: int, address: Address) -> None:
        """Send measurements on a connection too."""
        if address not in self._listeners:
            self._listeners.append(address)
            if self._sending():
                self._subscribe(now_ns, address)

    def receive(self, data: bytes, now_ns: int, address: Address | None = None) -> None:
        """Requests come on connections; datagrams are ignored. Never raises."""
        if data and self._connections.kind(address) is LinkKind.DATAGRAM:
            self.advance(now_ns)
            self._events.drop(now_ns, DropReason.UNKNOWN_COMMAND, "it takes no datagrams", len(data))
            return
        super().receive(data, now_ns, address)

    def _reset(self, now_ns: int) -> None:
        super()._reset(now_ns)
        self._listeners = []
        self._made.clear()

    # slices

    def _slice(self, number: int) -> Slice:
        key = self._stream, number, self._raster.at(number)
        if (made := self._made.get(key)) is None:
            while len(self._made) >= SLICES_KEPT:
                self._made.pop(next(iter(self._made)))
            made = self._made[key] = self._make(number)
        return made

    def _sweep(self, number: int) -> Sweep:
        return self._slice(number).sweep

    def _passed_over(self, number: int) -> int:
        passed = 0
        while passed < MOST_KEPT and not len(self._sweep(number + passed).azimuth_rad):
            passed += 1
        return passed
