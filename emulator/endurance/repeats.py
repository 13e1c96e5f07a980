"""A share of the sweeps of a long run is measured, the rest repeats what was measured last.

Scene and sensors of a soak stand still: a sweep brings the same again but for noise, and a day would spend most of its
hours on rays. What happens to scans on their way is the same for a repeated one. Belongs here: only that.
"""

from __future__ import annotations

from collections import OrderedDict, deque
from collections.abc import Container, Mapping
from dataclasses import replace

from emulator.measuring.conditions import NORMAL, Conditions
from emulator.measuring.measuring import Measure
from protocols.scan import Scan, ScanPlan

FRESH, CYCLE = 40, 2000
"Of so many sweeps of one kind in a row the first so many are measured: long enough for a tracker to know its objects."
KINDS_KEPT, SCANS_KEPT = 8, 8
"Kinds of sweeps kept apart, and scans of each that are repeated in turn."
ROUGH_KEPT = 2
"Scans measured and kept of turns that are taken for alike: no tracker looks at them."


class Repeated:
    """A measuring function that is asked for a share of the sweeps, in runs."""

    def __init__(self, inner: Measure, rough: bool = False) -> None:
        """`rough`: turns of a free rotor, no two alike: those with as many beams are taken for alike."""
        self._inner = inner
        self._rough = rough
        self._fresh, self._most = (ROUGH_KEPT, ROUGH_KEPT) if rough else (FRESH, SCANS_KEPT)
        self._kept: OrderedDict[tuple[object, ...], deque[Scan]] = OrderedDict()
        self._turn: dict[tuple[object, ...], int] = {}
        self.measured = self.repeated = 0

    def __call__(self, plan: ScanPlan, conditions: Conditions = NORMAL) -> Scan:
        """The sweep, measured or repeated under its own plan; a soak changes no conditions."""
        directions: tuple[object, ...] = (plan.azimuth_rad.tobytes(), plan.fire_offset_s.tobytes())
        if self._rough:
            directions = (len(plan),)
        kind = (
            *directions, plan.max_echoes, plan.max_range_m, plan.gain,
            plan.wants_intensity, plan.wants_objects,
        )  # fmt: skip
        kept = self._kept.setdefault(kind, deque(maxlen=self._most))
        self._kept.move_to_end(kind)
        turn = self._turn.get(kind, 0)
        self._turn[kind] = (turn + 1) % CYCLE
        if len(self._kept) > KINDS_KEPT:
            forgotten, _ = self._kept.popitem(last=False)
            del self._turn[forgotten]
        if turn >= self._fresh:
            self.repeated += 1
            return replace(kept[turn % len(kept)], plan=plan)
        self.measured += 1
        scan = self._inner(plan, conditions)
        kept.append(scan)
        return scan

    def afresh(self) -> None:
        """Begin a cycle: the next sweeps of every kind are measured."""
        self._turn = dict.fromkeys(self._turn, 0)


def repeating(measures: Mapping[str, Measure], rough: Container[str] = ()) -> dict[str, Repeated]:
    """The same for every sensor; a list of objects that must be made again measures its sources itself.

    `rough`: sensors whose rotor turns freely.
    """
    return {name: Repeated(measure, name in rough) for name, measure in measures.items()}
