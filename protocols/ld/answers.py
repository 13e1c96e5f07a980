"""What becomes of a request: the answer that a service's handler gives. No service, no device's inside."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from protocols.ld.device import Device
from protocols.ld.routing import Routed
from protocols.session import DropReason


@dataclass(frozen=True)
class StartProfiles:
    """A host wants profiles."""

    number: int
    "0: until cancelled."
    form: int


@dataclass(frozen=True)
class Answer:
    """What becomes of a request."""

    words: tuple[int, ...] | None = ()
    "Data of the reply; None: no reply of its own, profiles follow."
    refused: DropReason | None = None
    failure: bool = False
    "Answered by SERVICE_FAILURE instead of its own reply."
    detail: str = ""
    when_at_speed: Handler | None = None
    "The reply to send instead, once the head is at speed or has a new command."
    start: StartProfiles | None = None
    stops_profiles: bool = False
    "The caller's own profiles end. Those of all hosts end whenever MEASURE is left."
    boots_ns: int | None = None
    "The device restarts after the reply, and takes this long."
    line_speed: int | None = None
    routed: tuple[Routed, ...] = ()
    "Bytes that leave on interfaces that the caller has attached."


Words = tuple[int, ...]
Handler = Callable[[Device, Words, int], Answer]


def fails(reason: DropReason, detail: str) -> Answer:
    """Answered by SERVICE_FAILURE."""
    return Answer(refused=reason, failure=True, detail=detail)


def refuses(words: Words, detail: str) -> Answer:
    """Answered by the service's own code of refusal."""
    return Answer(words, refused=DropReason.BAD_ARGUMENT, detail=detail)
