"""SCIP on the wire: numbers in groups of six bits, sums of lines, blocks of 64 characters, the texts of a scan.

Belongs here: bytes and numbers. Not: what a command means (commands), when a block is sent (session), reading it
(`emulator.hosts.scip_reading`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from protocols.scan import DAZZLED, Scan

ZERO, SIX_BITS = 0x30, 0x3F
BLOCK = 64
"Characters of data per line; the sum of the line follows."
STAMP_CHARS = 4
WIDTHS = (2, 3, 4)

Words = NDArray[np.int64]
Chars = NDArray[np.uint8]


def encode_number(value: int, width: int) -> bytes:
    """A number in groups of six bits, most significant first; bits beyond 6 `width` are lost."""
    return bytes((value >> 6 * place & SIX_BITS) + ZERO for place in reversed(range(width)))


def line_sum(line: bytes) -> bytes:
    """The sum of a line, one character: the lowest six bits of the sum of its characters."""
    return bytes(((sum(line) & SIX_BITS) + ZERO,))


def summed(line: bytes) -> bytes:
    """A line of a reply with its sum and LF."""
    return line + line_sum(line) + b"\n"


def key_line(key: str, value: str) -> bytes:
    """A line of VV, PP and II: the sum is taken without the `;` and follows it."""
    line = f"{key}:{value}".encode()
    return line + b";" + line_sum(line) + b"\n"


def encode_words(words: Words, width: int) -> Chars:
    """Numbers of any shape as characters; the last axis is `width` long."""
    shifts = 6 * np.arange(width - 1, -1, -1)
    return ((words[..., None] >> shifts & SIX_BITS) + ZERO).astype(np.uint8)


def blocks(text: bytes, sums: bool = True) -> bytes:
    """Data cut into lines of 64 characters, each with its own sum unless SCIP 1.1 has none."""
    if not sums:
        return b"".join(text[at : at + BLOCK] + b"\n" for at in range(0, len(text), BLOCK))
    return b"".join(summed(text[at : at + BLOCK]) for at in range(0, len(text), BLOCK))


@dataclass(frozen=True)
class Form:
    """How the values of a measuring command are written."""

    width: int = 3
    "Characters of a distance."
    intensity: bool = False
    echoes: int = 1
    "More than 1: further echoes follow, each after `&`."


@dataclass(frozen=True)
class Limits:
    """Distances that a device reports, and its words for others. [mm]"""

    least_mm: int
    most_mm: int
    no_echo: int
    dazzled: int
    most_intensity: int
    intensity_scale: float
    "Counts of intensity at the detection threshold."


def words_of(scan: Scan, limits: Limits) -> tuple[Words, Words]:
    """Distances in mm and intensities, (n, k) each; -1 where a further echo is absent."""
    found = np.rint(1000.0 * scan.range_m)
    good = (found >= limits.least_mm) & (found <= limits.most_mm)  # false for NaN
    distance = np.where(good, np.nan_to_num(found), -1).astype(np.int64)
    strength = np.clip(np.rint(limits.intensity_scale * np.nan_to_num(scan.intensity)), 0, limits.most_intensity)
    strength = np.where(good, strength, -1).astype(np.int64)
    order = np.argsort(np.where(good, distance, np.iinfo(np.int64).max), axis=1, kind="stable")
    distance, strength = np.take_along_axis(distance, order, 1), np.take_along_axis(strength, order, 1)
    word = np.where(scan.flags & DAZZLED, limits.dazzled, limits.no_echo)
    absent = distance[:, 0] < 0
    distance[absent, 0], strength[absent, 0] = word[absent], 0
    return distance, strength


def merged(distance: Words, strength: Words, cluster: int, least_mm: int) -> tuple[Words, Words]:
    """One beam for each `cluster` neighbours: that of the least distance; words for "no echo" count as farthest.

    distance, strength (n, k) -> (ceil(n / cluster), k).
    """
    if cluster <= 1:
        return distance, strength
    first = distance[:, 0]
    far = np.where(first >= least_mm, first, first + (1 << 32))
    starts = np.arange(0, len(first), cluster)
    padded = np.full(len(starts) * cluster, np.iinfo(np.int64).max)
    padded[: len(first)] = far
    chosen = starts + padded.reshape(len(starts), cluster).argmin(axis=1)
    return distance[chosen], strength[chosen]


def encode_values(distance: Words, strength: Words, form: Form) -> bytes:
    """The data of all steps as one string. distance, strength (n, k) as `words_of` gives them."""
    most = (1 << 6 * form.width) - 1
    distance, strength = distance[:, : form.echoes], strength[:, : form.echoes]
    parts = [encode_words(np.minimum(distance, most), form.width)]
    if form.intensity:
        parts.append(encode_words(np.minimum(strength, most), form.width))
    if form.echoes == 1:
        return np.concatenate([part[:, 0] for part in parts], axis=1).tobytes()
    mark = np.full((*distance.shape, 1), ord("&"), np.uint8)
    chars = np.concatenate([mark, *parts], axis=2)
    wanted = np.broadcast_to((distance >= 0)[..., None], chars.shape).copy()
    wanted[:, 0, 0] = False  # no mark before the first echo
    return chars[wanted].tobytes()
