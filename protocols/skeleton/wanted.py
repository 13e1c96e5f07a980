"""The one sweep that a session wants measured next, and the epoch by which a scan of old settings is refused.

Belongs here: whether a scan is the one that was asked for. Not: which sweep that is (the families' schedules).
"""

from __future__ import annotations

from typing import Generic, TypeVar

from protocols.errors import ScanRefused
from protocols.scan import ScanPlan

What = TypeVar("What")


class Wanted(Generic[What]):
    """At most one plan, the same until its scan comes or it is wanted no more."""

    def __init__(self) -> None:
        self.epoch = 0
        "Number of the settings; plans are made with it."
        self.plan: ScanPlan | None = None
        self.what: What | None = None
        "What the family keeps beside the plan, as the slot that it is for."

    def ask(self, plan: ScanPlan, what: What) -> ScanPlan:
        """This one is wanted next."""
        self.plan, self.what = plan, what
        return plan

    def expect(self, plan: ScanPlan, beams: int | None = None) -> What:
        """What was kept beside the plan asked for; it stays wanted until `forget`.

        Raises `ScanRefused` when `plan` is not the one asked for, or so many `beams` are not those of the plan.
        """
        if self.plan is None or (plan.epoch, plan.sweep) != (self.plan.epoch, self.plan.sweep):
            raise ScanRefused(f"sweep {plan.sweep} of epoch {plan.epoch} is not wanted any more")
        if beams is not None and beams != len(self.plan):
            raise ScanRefused(f"{beams} beams; the plan has {len(self.plan)}")
        what = self.what
        assert what is not None
        return what

    def forget(self) -> None:
        """It has come, or will not: nothing is asked for until the next `ask`."""
        self.plan = self.what = None

    def renew(self) -> None:
        """Settings have changed: whatever was asked for until now is refused when it comes."""
        self.forget()
        self.epoch += 1
