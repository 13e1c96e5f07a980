"""The faults that act on one sweep: which, with what keys, since when; and by what name their draws are keyed.

Belongs here: what all of them share. Not: what each does (light, aims, readings, lists), when they begin (run).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

from emulator.measuring.conditions import ActiveFault, Setting
from emulator.physics.arrays import Floats
from emulator.physics.random_streams import RandomStreams
from protocols.scan import ScanPlan


@dataclass(frozen=True, eq=False)
class Held:
    """One fault at work on a sweep."""

    name: str
    number: int
    keys: Any
    from_ns: int
    at_ns: int
    "Beginning of the sweep."

    @property
    def since_s(self) -> float:
        """How long it has been there when the sweep begins."""
        return (self.at_ns - self.from_ns) * 1e-9

    def term(self, what: str) -> str:
        """Key of its draws."""
        return f"fault {self.number} {self.name} {what}"

    def uniform(self, draws: RandomStreams, what: str, sweep: int, beams: int, columns: int = 1) -> Floats:
        """(beams, columns) numbers in (0, 1): by seed, sensor, fault and sweep alone."""
        return draws.uniform(self.term(what), sweep, beams, columns)


@lru_cache(maxsize=256)
def _keys(name: str, settings: tuple[tuple[str, Setting], ...]) -> Any:
    from emulator.faults.catalogue import kinds

    return kinds()[name].keys.model_validate(dict(settings))


def held(faults: Sequence[ActiveFault], plan: ScanPlan) -> tuple[Held, ...]:
    """The faults of a sweep with their keys."""
    return tuple(
        Held(one.name, one.number, _keys(one.name, one.settings), one.from_ns, plan.start_ns) for one in faults
    )
