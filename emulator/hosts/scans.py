"""What a host of ours gives its viewer, whatever protocol it came by."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Protocol

from protocols.scan import Floats


@dataclass(frozen=True, eq=False)
class HostScan:
    """One scan as a host has decoded it."""

    number: int
    "Counts the scans received, from 0."
    azimuth_rad: Floats
    "(n,) ISO 8855: 0 ahead, positive to the left."
    range_m: Floats
    "(n,) NaN where the device reports no distance."
    detail: str = ""
    "What the telegram said beside the distances, for a status line."


class Host(Protocol):
    """A connected host."""

    @property
    def title(self) -> str:
        """The device's own name for itself."""

    def scans(self, timeout_s: float) -> Iterator[HostScan | None]:
        """Scans as they arrive; None when none came for `timeout_s`."""

    def close(self) -> None:
        """Stop the stream and hang up."""
