"""Printed values beside ours: what each comparison proves, and the verdict.

Belongs here: the form of one value. Not: the values (further, measured).
"""

from __future__ import annotations

from dataclasses import dataclass

from emulator.studies.report import percent

KINDS = {
    "computed": "from first principles or from other sources than the printed value: agreement is evidence",
    "follows": "what the product makes of another printed value: agreement shows that the prints fit together",
    "calibrated": "the product's constant was set from this print: agreement only shows that the path keeps it",
    "differs": "known disagreement, on purpose",
    "limit": "the print is a limit, or rounded to one: ours has to stay within it",
}
SPREAD_PERCENT = 10.0


@dataclass(frozen=True)
class Fact:
    """One printed value."""

    quantity: str
    unit: str
    source: str
    seen: str
    "How we know the print: `read` in the source or its abstract, `quoted` by another, `memory`."
    printed: float
    ours: float
    kind: str
    "What agreement proves, see `KINDS`."
    note: str = ""
    spread_percent: float = SPREAD_PERCENT
    "How far ours may be from the print: the print's own spread where it has one."
    why: str = ""
    "Why the two differ, as far as we know."

    @property
    def off_percent(self) -> float:
        """Deviation from the print."""
        return percent(self.ours, self.printed)

    @property
    def agrees(self) -> bool:
        """Within the spread, or within the limit."""
        if self.kind == "limit":
            return self.ours <= self.printed
        return abs(self.off_percent) <= self.spread_percent

    @property
    def verdict(self) -> str:
        """In words."""
        if self.agrees:
            return "agrees"
        return f"differs: {self.why or self.note or 'why is not known'}"
