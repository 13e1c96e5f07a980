"""Impairments of the device, passed to its session: faults of one kind that overlap act together.

Belongs here: how they add up. Not: what the device makes of it (`Session.impair` of its family).
"""

from __future__ import annotations

import math

from emulator.faults.acts import Gear

FACTORS = ("window", "motor speed")
"What multiplies; of everything else the strongest counts."


def impair(gear: Gear, now_ns: int, what: str, degree: float | None) -> None:
    """This fault makes the device impair so much, or (None) no more."""
    mine = gear.instrument.impairments.setdefault(what, {})
    if degree is None:
        mine.pop(gear.number, None)
    else:
        mine[gear.number] = degree
    if what in FACTORS:
        reported = math.prod(mine.values())
    else:
        reported = max(mine.values(), key=abs, default=0.0)
    gear.session.impair(now_ns, what, reported)
