"""One sweep of a sensor in slices of time: each is asked for when its own beams are due.

Belongs here: which slice is begun next, and that none is left out. Not: whether a sweep has slices and when each is
begun (the feed), who measures them and puts them together (measuring).

A sweep in a world that somebody else moves waits for poses until it must be begun. Whole, all its beams wait for one
instant; in slices those that fire first are measured while the others still wait for newer poses.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Protocol, runtime_checkable

from emulator.measuring.conditions import Conditions
from protocols.scan import ScanPlan

if TYPE_CHECKING:
    from emulator.live.tracks import World


@runtime_checkable
class InSlices(Protocol):
    """Whoever may measure a sweep in slices."""

    def request_slice(self, sensor: str, plan: ScanPlan, conditions: Conditions, number: int, of: int) -> None: ...


class SlicesFeed(Protocol):
    """Whoever knows when poses of a slice are known."""

    def slices(self, sensor: str, plan: ScanPlan) -> int:
        """In how many slices that sweep is to be measured; 1: whole."""

    def slice_ns(self, sensor: str, plan: ScanPlan, number: int, of: int) -> int:
        """When that slice is to be begun."""

    def world(self, sensor: str, plan: ScanPlan, now_ns: int, number: int = 0, of: int = 1) -> World:
        """What its beams need, as it is known now."""


class Slices:
    """Of one sensor: the sweep of which slices are still to be begun."""

    def __init__(self, sensor: str, measuring: InSlices) -> None:
        self._sensor, self._measuring = sensor, measuring
        self._feed: SlicesFeed | None = None
        self._plan: ScanPlan | None = None
        self._conditions = Conditions()
        "Of all slices, but for the poses."
        self._next, self._of = 0, 1

    @property
    def are_left(self) -> bool:
        """Some of a sweep are still to be begun."""
        return self._plan is not None

    def open(self, plan: ScanPlan, conditions: Conditions, feed: SlicesFeed, now_ns: int) -> bool:
        """Begin a sweep's first slice; False: it is measured whole."""
        self.finish(now_ns)  # of one that never came
        of = feed.slices(self._sensor, plan)
        if of < 2:
            return False
        self._feed, self._plan, self._conditions, self._next, self._of = feed, plan, conditions, 0, of
        self._begin(now_ns)
        return True

    def begin_due(self, now_ns: int) -> int | None:
        """Begin the slices that are due; when the next one is. None: none is left."""
        while self._plan is not None and self._feed is not None:
            due_ns = self._feed.slice_ns(self._sensor, self._plan, self._next, self._of)
            if due_ns > now_ns:
                return due_ns
            self._begin(now_ns)
        return None

    def came(self, plan: ScanPlan) -> None:
        """A scan has come: if it is of this sweep, nothing more of it is wanted."""
        if self._plan is not None and (plan.epoch, plan.sweep) == (self._plan.epoch, self._plan.sweep):
            self._plan = None

    def finish(self, now_ns: int) -> None:
        """Begin all that is left, whatever is known: what has been asked for always comes."""
        while self._plan is not None:
            self._begin(now_ns)

    def _begin(self, now_ns: int) -> None:
        assert self._plan is not None
        assert self._feed is not None
        number, plan = self._next, self._plan
        self._next += 1
        if self._next == self._of:
            self._plan = None
        world = self._feed.world(self._sensor, plan, now_ns, number, self._of)
        held = replace(self._conditions, world=world)
        self._measuring.request_slice(self._sensor, plan, held, number, self._of)
