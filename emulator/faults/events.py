"""Events of a fault: beginning, hits, end."""

from __future__ import annotations

from dataclasses import dataclass

MOST_HITS_REPORTED = 1000
"Of one fault: the first ones. All are counted."


@dataclass(frozen=True)
class FaultEvent:
    """One thing that happened to a fault of the run."""

    at_ns: int
    number: int
    name: str
    what: str
    "begin | hit | end"
    detail: str = ""
