"""What an instrument asks of the faults on it; the fault injection implements this contract.

Belongs here: the contract alone. Not: faults, when they begin (injection), when an instrument asks (instrument).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from emulator.transports.link import Received
from protocols.scan import ScanPlan
from protocols.session import Emission, Event

Piece = tuple[Emission, int | None]
"A telegram, and the only link that it is for; None: as its address says."
Made = tuple[Emission, int | None, int]
"A telegram, its only link or None, and the fault that has made it late or 0."


@dataclass(frozen=True)
class Passed:
    """A telegram behind all faults."""

    emission: Emission | None
    "As the device sent it; None: it, or what it was a piece of, has been counted."
    made: list[Made]
    "What has become of it."
    leaving: list[Piece]
    "What of that leaves now; the rest waits."
    taker: str | None
    "Name of the fault that took its scan."
    counted: bool
    "It has been counted as sent: a fault holds it back."


class FaultHooks(Protocol):
    """The faults of one sensor. Times are those of the run, in nanoseconds."""

    taker: str | None
    "Name of the fault that took the scan of the telegram looked at last."
    counted: bool
    "The telegram looked at last has been counted as sent."
    sweep: int | None
    "The scan that it carried when the device sent it."
    own_speeds: dict[int, list[int | None]]
    "Of lines with a wrong speed: their own, and once more for each fault that holds."

    def advance(self, now_ns: int) -> None:
        """Begin and end what is due."""

    def next_ns(self) -> int | None:
        """When `advance` or `released` has something to do."""

    def incoming(self, received: Received, index: int, now_ns: int) -> list[Received]:
        """What the device gets instead of what came in on a link."""

    def asked(self, plan: ScanPlan) -> None:
        """A sweep is asked for: the faults that will show in it have hit."""

    def passed(self, emission: Emission, now_ns: int) -> Passed:
        """What becomes of a telegram."""

    def released(self, now_ns: int) -> list[Passed]:
        """What was held back and goes on now."""

    def noted(self, event: Event) -> None:
        """Something that the session reported."""

    def cut(self) -> int:
        """The power is away: bytes that were held back and are gone."""

    def counts(self) -> dict[str, dict[str, int]]:
        """By name: how often begun, how many hits."""

    def hits_of(self, name: str) -> int:
        """How often faults of that name have hit."""
