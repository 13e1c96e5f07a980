"""The requested sweep of a session, and the epoch by which a scan of old settings is refused.

Belongs here: whether a scan is the requested one. Not: which sweep that is (the families' schedules).
"""

from __future__ import annotations

from typing import Generic, TypeVar

from protocols.errors import ScanRefused
from protocols.scan import ScanPlan

What = TypeVar("What")


class Wanted(Generic[What]):
    """At most one plan, the same until its scan is submitted or the request is withdrawn."""

    def __init__(self) -> None:
        self.epoch = 0
        "Number of the settings; plans are made with it."
        self.plan: ScanPlan | None = None
        self.what: What | None = None
        "Data of the family for the plan, such as its slot."

    def ask(self, plan: ScanPlan, what: What) -> ScanPlan:
        """Request this plan."""
        self.plan, self.what = plan, what
        return plan

    def expect(self, plan: ScanPlan, beams: int | None = None) -> What:
        """The family's data for the requested plan; it stays requested until `forget`.

        Raises `ScanRefused` if `plan` is not the requested one, or `beams` differs from its number of beams.
        """
        if self.plan is None or (plan.epoch, plan.sweep) != (self.plan.epoch, self.plan.sweep):
            raise ScanRefused(f"sweep {plan.sweep} of epoch {plan.epoch} is not requested any more")
        if beams is not None and beams != len(self.plan):
            raise ScanRefused(f"{beams} beams; the plan has {len(self.plan)}")
        what = self.what
        assert what is not None
        return what

    def forget(self) -> None:
        """Submitted or withdrawn: nothing is requested until the next `ask`."""
        self.plan = self.what = None

    def renew(self) -> None:
        """Settings have changed: a scan requested earlier will be refused."""
        self.forget()
        self.epoch += 1
