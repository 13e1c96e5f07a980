"""The result of a command's handler, and the row of the command table. No commands, no layout of data."""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import dataclass

from protocols.lms2xx.device import Device
from protocols.lms2xx.outputs import Output
from protocols.session import DropReason

INCORRECT = b"\x92"
"Reply to a good telegram that the device cannot follow."


@dataclass(frozen=True)
class Answer:
    """What follows the ACK."""

    payload: bytes = b""
    "Reply without status byte; empty when measured values are the reply."
    delay: str = "data_s"
    "Which of the `Delays` it takes."
    refusal: DropReason | None = None
    "Set if the device refuses the request; the payload has the device's refusal."
    detail: str = ""
    new_baud: int | None = None
    "The line's speed behind the reply."
    resets: bool = False
    once: Output | None = None
    "Measured values that are the reply."


Result = tuple[Device, Answer]
Handler = Callable[[Device, bytes], Result]


@dataclass(frozen=True)
class Command:
    """One row: the handler, and the source."""

    name: str
    source: str
    handler: Handler | None = None
    "None: known by name, layout or effect not settled by any source; answered with 92."
    sizes: Collection[int] = (0,)
    "Lengths of data (behind command and sub-code) that are taken."
    modes: Collection[int] | None = None
    "Operating modes in which it is allowed; None: all."
    absent: bool = False
    "Not a command of this family, though listings of relatives have it."
    note: str = ""
    lacked_by: Callable[[Device], bool] | None = None
    "Models that do not have it answer 92; None: all have it."

    @property
    def coverage(self) -> str:
        """`done`, `refused` or `absent`."""
        return "absent" if self.absent else "done" if self.handler else "refused"


def refused(device: Device, reason: DropReason, detail: str) -> Result:
    """The device as it was, and 92."""
    return device, Answer(INCORRECT, refusal=reason, detail=detail)


def declined(device: Device, payload: bytes, detail: str, delay: str = "data_s") -> Result:
    """The device as it was, and the command's own word of refusal."""
    return device, Answer(payload, delay, DropReason.BAD_ARGUMENT, detail)


def fast(device: Device) -> bool:
    """The S14 models lack what needs monitoring fields."""
    return device.model.fast


def uncounted(device: Device) -> bool:
    """LMS200 and LMS220 have no operating data counter."""
    return device.model.indoor
