"""Cuts the raw bytes of a serial line into the telegrams of SICK's devices, so that they can be sent one by one.

Belongs here: where one ends. Not: whether it is any good: every byte is sent again, damaged or not.
"""

from __future__ import annotations

import re
from itertools import pairwise

from protocols.lms2xx.telegrams import OVERHEAD_BYTES, REPLY

LONGEST_PAYLOAD = 1024
"Of an LMS2xx telegram; the largest is one of 812 bytes in all."
_PACKAGE = re.compile(rb"\x02[0-9A-Fa-f]+\x03")
_STARTS = re.compile(rb"[\x02\x06\x15]")
"Of an LMS2xx telegram or an LD package; an LMS2xx's yes and no, which stand alone."


def telegrams_of(data: bytes) -> list[bytes]:
    """The pieces, in order; together they are `data`."""
    ends = [0]
    at = 0
    while (start := _STARTS.search(data, at)) is not None:
        at = start.start()
        end = _end_of(data, at)
        if end is None:
            at += 1
            continue
        ends += [at, end] if at > ends[-1] else [end]
        at = end
    ends += [len(data)] if len(data) > ends[-1] else []
    return [data[first:last] for first, last in pairwise(ends)]


def _end_of(data: bytes, at: int) -> int | None:
    """Where the telegram ends that begins there; None: none does, as far as can be seen without its check."""
    if data[at] != 0x02:
        alone = at + 1 == len(data) or _STARTS.match(data, at + 1)
        return at + 1 if alone else None
    package = _PACKAGE.match(data, at)
    if package is not None:
        return package.end()
    if at + OVERHEAD_BYTES >= len(data) or data[at + 1] < REPLY:
        return None
    length = int.from_bytes(data[at + 2 : at + 4], "little")
    end = at + OVERHEAD_BYTES + length
    if not 1 <= length <= LONGEST_PAYLOAD or end > len(data):
        return None
    return end if end == len(data) or _STARTS.match(data, end) else None
