"""A SCIP device's bytes as a host reads them: numbers, lines with their sums, the values of a scan.

Belongs here: taking apart, the inverse of `protocols.scip.codec`. Not: what a host asks (scip).
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np

from protocols.scan import Floats
from protocols.scip.codec import BLOCK, SIX_BITS, ZERO, Form, line_sum


def decode_number(text: bytes) -> int:
    """A number in groups of six bits; ValueError for a character that is no group of six bits."""
    value = 0
    for char in text:
        if not ZERO <= char <= ZERO + SIX_BITS:
            raise ValueError(f"character {char:#04x}; want 0x30..0x6f")
        value = value << 6 | char - ZERO
    return value


def joined(lines: Iterable[bytes]) -> bytes:
    """The data of lines without LF; ValueError for a wrong sum or length."""
    return b"".join(_checked(lines))


def _checked(lines: Iterable[bytes]) -> Iterator[bytes]:
    for line in lines:
        text, found = line[:-1], line[-1:]
        if not text or len(text) > BLOCK or line_sum(text) != found:
            raise ValueError(f"line {line!r}; want at most {BLOCK} characters and their sum")
        yield text


def decode_values(text: bytes, form: Form) -> tuple[Floats, Floats]:
    """Distances in m and intensities, (n, k), NaN where an echo is absent. ValueError if it is not whole.

    Distances are as written: a device's words for "no echo" are still among them.
    """
    values = 2 if form.intensity else 1
    steps: list[list[int]] = []
    at = 0
    while at < len(text):
        further = form.echoes > 1 and text[at : at + 1] == b"&"
        at += further
        numbers = [decode_number(text[at + form.width * k : at + form.width * (k + 1)]) for k in range(values)]
        at += form.width * values
        if at > len(text) or (further and not steps):
            raise ValueError(f"{len(text)} characters; want whole steps")
        if further:
            steps[-1] += numbers
        else:
            steps.append(numbers)
    most = max((len(step) for step in steps), default=values)
    table = np.full((len(steps), most), np.nan)
    for row, step in zip(table, steps, strict=True):
        row[: len(step)] = step
    strength = table[:, 1::2] if form.intensity else np.full_like(table, np.nan)
    return table[:, ::values] / 1000.0, strength
