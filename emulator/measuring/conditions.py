"""What differs from the scenario's file while a run lives: other weather, faults of what is measured.

Belongs here: the values that go with a plan to whoever measures it. Each plan carries all of them, so that a sweep
depends on nothing but its plan and its conditions, whichever process measures it and whenever that process began.
Not: who decides them (faults, orders), what they do (sensing, faults).
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass

from emulator.live.tracks import World
from emulator.scenario.weather import WeatherConfig

Setting = float | int | str | bool | tuple[float, ...]


@dataclass(frozen=True)
class ActiveFault:
    """One fault of what is measured, from when until when."""

    sensor: str
    name: str
    "As in the catalogue of faults."
    number: int
    "Of the fault within the run: keys its random draws."
    from_ns: int
    until_ns: int | None = None
    "None: not known yet, or for ever."
    settings: tuple[tuple[str, Setting], ...] = ()
    probability: float = 1.0
    "Of acting on a sweep; whether it does depends on the seed, the sensor, the number and the sweep's beginning alone."
    seed: int = 0

    def holds(self, at_ns: int) -> bool:
        """Whether it acts at that instant."""
        inside = self.from_ns <= at_ns and (self.until_ns is None or at_ns < self.until_ns)
        return inside and (self.probability >= 1.0 or self._chance(at_ns) < self.probability)

    def _chance(self, at_ns: int) -> float:
        text = f"{self.seed}\0{self.sensor}\0{self.number}\0{at_ns}".encode()
        return int.from_bytes(hashlib.blake2b(text, digest_size=7).digest(), "little") / 2.0**56


@dataclass(frozen=True)
class Conditions:
    """What holds for a sweep beside the scenario's file."""

    weather: WeatherConfig | None = None
    "Instead of the scenario's, its `changes` in the run's time; None: the scenario's."
    faults: tuple[ActiveFault, ...] = ()
    "Of all sensors: one that lists objects measures with its sources'."
    world: World | None = None
    "Where actors are that somebody else moves; None: nobody does."

    def of(self, sensor: str, at_ns: int) -> tuple[ActiveFault, ...]:
        """Faults that act on that sensor at that instant, in the order of their numbers."""
        return tuple(fault for fault in self.faults if fault.sensor == sensor and fault.holds(at_ns))


NORMAL = Conditions()
