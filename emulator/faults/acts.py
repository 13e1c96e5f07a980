"""What carries out a fault where bytes are sent and received, and all that it can reach.

Belongs here: the contracts between a fault, its run and the device that it is on. Not: single faults (the layers), when
they begin (run).
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Protocol

import numpy as np
from numpy.typing import NDArray

from emulator.transports.link import Link, Received
from protocols.session import Address, Emission, LinkKind, Session

if TYPE_CHECKING:
    from emulator.physics.random_streams import RandomStreams
    from protocols.framing import Framing

BLOCK = 256
"Throws of a trigger that are drawn at once."


class Account(Protocol):
    """Where a fault shows what it did."""

    def hit(self, now_ns: int, detail: str = "") -> None:
        """It has hit one thing more."""

    def took(self, what: str, count: int = 1) -> None:
        """So much of `what` (`telegrams`, `replies`, `bytes`, `input bytes`, ...) went no further because of it."""


class Marks(Protocol):
    """What faults leave with a device about the telegram looked at last, and about its lines."""

    taker: str | None
    "Name of the fault that took its scan."
    counted: bool
    "It has been counted as sent."
    sweep: int | None
    "The scan that it carried when the device sent it."
    own_speeds: dict[int, list[int | None]]
    "Of lines with a wrong speed: their own, and once more for each fault that holds."


class Counts(Protocol):
    """Counters of a device."""

    input_dropped: Counter[str]

    def note_telegram(self, emission: Emission) -> None:
        """One more telegram has left, or will."""


class Device(Protocol):
    """The device that a fault is on, on its links. Times are those of the run, in nanoseconds."""

    session: Session
    connections_seen: int
    poked: bool
    impairments: dict[str, dict[int, float]]

    @property
    def sensor(self) -> str:
        """Its name in the scenario."""

    @property
    def links(self) -> tuple[Link, ...]:
        """All of its links."""

    @property
    def stats(self) -> Counts:
        """What it counts."""

    @property
    def faults(self) -> Marks | None:
        """What its faults leave with it."""

    def framing(self, kind: LinkKind) -> Framing | None:
        """How its telegrams are framed on such a link; None where its family does not tell."""

    def torn_off(self, now_ns: int) -> None:
        """Its hosts are gone, and none of them has ended its stream."""

    def power_off(self, now_ns: int) -> int:
        """Cut the power; how many bytes are gone with it."""

    def power_back(self, now_ns: int) -> None:
        """Switch it on again."""

    def set_line_speed(self, index: int, now_ns: int, baud: int | None) -> None:
        """Another speed of a line at once, whatever the device says."""


class Gear:
    """What a fault can reach: its sensor, its links, its random draws, its account."""

    def __init__(
        self, instrument: Device, links: Sequence[int], seed: int, number: int, name: str, account: Account
    ) -> None:
        self.instrument = instrument
        self.indices = tuple(links)
        "Numbers of the links that it is on."
        self.name = name
        self.number = number
        self._seed = seed
        self._account = account
        self._drawn = 0
        self._blocks = 0
        self._chances: list[float] = []
        "Of the trigger, drawn ahead."
        self.direction = "to_host"

    @property
    def session(self) -> Session:
        """The device's conversation."""
        return self.instrument.session

    @property
    def links(self) -> tuple[Link, ...]:
        """The links that it is on."""
        return tuple(self.instrument.links[index] for index in self.indices)

    def framing(self, address: Address | None) -> Framing | None:
        """How telegrams to that address are framed; None where the family does not tell."""
        index = self.indices[0] if address is None else address.link
        return self.instrument.framing(self.instrument.links[index].kind)

    def kind(self, address: Address | None) -> LinkKind:
        """Kind of the link of an address."""
        return self.instrument.links[self.indices[0] if address is None else address.link].kind

    def uniform(self, count: int, what: str = "") -> NDArray[np.float64]:
        """So many numbers in (0, 1): by the scenario's seed, the sensor, the fault and how often it has drawn."""
        self._drawn += 1
        return self._draws().uniform(f"fault {self.number} {self.name} {what}", self._drawn, count)[:, 0]

    def _draws(self) -> RandomStreams:
        from emulator.physics.random_streams import RandomStreams

        return RandomStreams(self._seed, self.instrument.sensor)

    def integer(self, below: int, what: str = "") -> int:
        """A whole number from 0 to `below` - 1."""
        return min(int(self.uniform(1, what)[0] * below), below - 1)

    def happens(self, probability: float) -> bool:
        """One throw of the trigger: it is asked with each telegram, so numbers are drawn in blocks."""
        if not self._chances:
            self._blocks += 1
            what = f"fault {self.number} {self.name} begins"
            self._chances = self._draws().uniform(what, self._blocks, BLOCK)[::-1, 0].tolist()
        return self._chances.pop() < probability

    def hit(self, now_ns: int, detail: str = "") -> None:
        """Tell that something was hit."""
        self._account.hit(now_ns, detail)

    def lost(self, emission: Emission, whole: bool = True) -> list[Emission]:
        """A telegram that does not arrive: counted; what it says about the line's speed stays true."""
        self.damaged(emission)
        self._account.took("scans" if emission.sweep is not None else "replies")
        self._account.took("bytes", len(emission.payload))
        return [] if emission.line_speed is None else [replace(emission, payload=b"", sweep=None)]

    def held(self, emission: Emission) -> None:
        """A telegram that leaves later, in pieces: sent as far as counters go, once for all its links."""
        faults = self.instrument.faults
        if faults is not None and emission.sweep != faults.sweep:
            return  # taken by another fault, which counts it, or held back before and counted then
        if faults is None or not faults.counted:
            self.instrument.stats.note_telegram(emission)
        if faults is not None:
            faults.counted = True

    def damaged(self, emission: Emission) -> None:
        """A scan that no host will read out of this telegram: counted under the fault's name."""
        if emission.sweep is not None and self.instrument.faults is not None:
            self.instrument.faults.taker = self.name

    def spoilt(self, emission: Emission, payload: bytes) -> Emission:
        """The telegram with other bytes, out of which no host reads the scan."""
        self.damaged(emission)
        return replace(emission, payload=payload, sweep=None)

    def took(self, what: str, count: int = 1) -> None:
        """Count something that went no further."""
        if count:
            self._account.took(what, count)

    def swallowed(self, count: int) -> None:
        """Bytes of hosts that the device never gets."""
        if count:
            self._account.took("input bytes", count)
            self.instrument.stats.input_dropped[f"fault {self.name}"] += count


class Act:
    """One fault at work; every method may be left as it is. Times are those of the run, in nanoseconds."""

    counts_itself = False
    "Telegrams that it holds back are counted as sent when it takes them: what it releases is pieces of them."

    def __init__(self, gear: Gear) -> None:
        self.gear = gear

    def begin(self, now_ns: int) -> None:
        """It begins, or begins again."""

    def end(self, now_ns: int) -> None:
        """It ends: everything is as it would be without it."""

    def send(self, emission: Emission, now_ns: int) -> list[Emission] | None:
        """What leaves instead of a telegram; None: it was not hit. Called while the fault holds, link by link if it is
        not on all of them."""
        return None

    def hear(self, received: Received, link: int, now_ns: int) -> list[Received] | None:
        """What the device gets instead of what came in; None: not hit."""
        return None

    def seen(self, emission: Emission) -> None:
        """A telegram that it counts has passed while the fault did not hold."""

    @property
    def busy(self) -> bool:
        """Whether `send` has something to do after the end: a telegram is held back."""
        return False

    def release(self, now_ns: int) -> list[Emission]:
        """Telegrams that were held back and leave now; called also after the end."""
        return []

    def next_ns(self) -> int | None:
        """When `release` has something."""
        return None

    def cut(self) -> list[Emission]:
        """The power is away: what was held back is gone."""
        return []
