"""LMDscandata: what a scan looks like on the wire, by every switch of LMDscandatacfg, in either dialect.

Belongs here: layout, channels, the device's rounding and special values. Not: when it leaves, and to whom.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from protocols.cola.layouts import LAYOUT, Content, Header
from protocols.scan import DAZZLED, Floats
from protocols.skeleton.cola_values import encode

FULL_SCALE = 4000.0
"""Peak over threshold at which RSSI has its highest value below `dazzled`. The scale is logarithmic and its unit the
maker's own ([M], LMS5xx and MRS1000); this end of it is ours."""
DAZZLED_MM = 1
"Distance value of a beam whose receiver is dazzled; RSSI has all bits set (LMS4000 [M], here [I])."


def distances(range_m: Floats, dazzled: NDArray[np.bool_], scale: float, nearest: int) -> NDArray[np.uint16]:
    """Values of one DIST channel: 0 without an echo, or farther than the scale reaches."""
    counts = np.nan_to_num(np.round(range_m * (1000.0 / scale)), nan=0.0, posinf=0.0, neginf=0.0)
    counts[(counts < nearest) | (counts > 65_535.0)] = 0.0
    counts[dazzled] = DAZZLED_MM
    return counts.astype(np.uint16)


def remissions(intensity: Floats, counts: NDArray[np.uint16], dazzled: NDArray[np.bool_], fine: bool) -> NDArray[Any]:
    """Values of one RSSI channel: from 1, the weakest echo, to 254; the same in finer steps in 16 bit."""
    top = 65_534.0 if fine else 254.0
    strength = np.log(np.clip(np.nan_to_num(intensity, nan=1.0), 1.0, FULL_SCALE)) / math.log(FULL_SCALE)
    words = np.round(1.0 + (top - 1.0) * strength)
    words[counts == 0] = 0.0
    words[dazzled] = top + 1.0
    return words.astype(np.uint16 if fine else np.uint8)


@dataclass(frozen=True)
class Body:
    """What a telegram says of a scan, before it is put into a dialect."""

    header: Header
    range_m: Floats
    "(n, k), of the points that are sent."
    intensity: Floats
    flags: NDArray[np.uint8]
    start: int
    step: int
    "Of the points that are sent, 1/10000 deg."
    scale: float
    nearest: int
    content: Content
    channels: tuple[int, ...]
    "Echoes that are sent, the first is 0."
    encoders: tuple[tuple[int, int], ...] = ()
    name: str = ""
    comment: str = ""
    date: tuple[int, ...] | None = None
    "Year to second, and microseconds; None: not sent."

    def values(self) -> list[Any]:
        """The values of `LAYOUT`."""
        dazzled = (self.flags & DAZZLED) != 0
        coarse: list[list[Any]] = []
        rssi: list[list[Any]] = []
        for echo in self.channels:
            has = echo < self.range_m.shape[1]
            ranges = self.range_m[:, echo] if has else np.full(len(self.range_m), np.nan)
            peaks = self.intensity[:, echo] if has else ranges
            counts = distances(ranges, dazzled, self.scale, self.nearest)
            coarse.append(self._channel(f"DIST{echo + 1}", self.scale, counts))
            if self.content.remission & 1:
                words = remissions(peaks, counts, dazzled, bool(self.content.fine))
                rssi.append(self._channel(f"RSSI{echo + 1}", 1.0, words))
        if self.content.fine:
            coarse += rssi
        if self.content.remission & 2:
            straight = np.full(len(self.range_m), 32_768, np.uint16)
            coarse.append(["ANGL1", 1.0, -32_768.0, self.start, self.step, straight])
        position = [[0.0] * 6 + [0]] if self.content.position else []
        return [
            *self.header, [list(one) for one in self.encoders], coarse, [] if self.content.fine else rssi,
            position, [[self.name]] if self.content.name else [], [[self.comment]] if self.content.comment else [],
            [list(self.date)] if self.date is not None else [], 0,
        ]  # fmt: skip

    def _channel(self, name: str, scale: float, words: NDArray[Any]) -> list[Any]:
        return [name, scale, 0.0, self.start, self.step, words]

    def encoded(self, dialect: bytes) -> bytes:
        """The arguments of sSN or sRA LMDscandata."""
        return encode(LAYOUT, dialect, self.values())
