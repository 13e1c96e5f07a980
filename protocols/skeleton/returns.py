"""Which echoes of a beam a device reports, where it has a word for one or two returns and an order of them.

Belongs here: the choice, of many beams at once. Not: words of what is chosen (families); pairs in which the same echo
may stand twice (those of Velodyne and Hesai).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from protocols.scan import Floats, Scan

Words = NDArray[Any]
"Whole numbers."
FEW = 8
"Beams with several echoes that are taken one by one."
WIDE: Mapping[int, np.dtype[Any]] = {2: np.dtype("<u2"), 4: np.dtype("<u4"), 8: np.dtype("<u8")}
"Words of so many flags, the first one in the lowest bit."


@dataclass(eq=False, slots=True)
class Returns:
    """What a profile reports of n beams: the first return of each, and the second one of m of them."""

    range_m: Floats
    "(n + m,) first those of all beams; NaN: none."
    strength: Floats
    "(n + m,) over the threshold."
    beam: Words
    "(m,) beams with a second one."


def returns(scan: Scan, count: int, order: str, near_m: float) -> Returns:
    """The returns that a profile reports of each beam, in their order.

    Of more echoes than `count` the strongest; of one return that which `order` puts first. Nearer than `near_m`: none.
    """
    there = scan.range_m >= near_m
    beams, width = there.shape
    several: Any = there.view(WIDE[width])[:, 0] > 1 if width in WIDE else there[:, 1:].any(axis=1)
    beam = several.nonzero()[0]
    room = np.zeros(len(beam))
    range_m, strength = (np.concatenate((one[:, 0], room)) for one in (scan.range_m, scan.intensity))
    near = range_m[:beams] < near_m
    if np.count_nonzero(near):
        range_m[:beams][near] = strength[:beams][near] = np.nan
    if not len(beam):
        return Returns(range_m, strength, beam)
    several_m, strengths = scan.range_m.take(beam, axis=0), scan.intensity.take(beam, axis=0)
    first, second = (_of_few if len(beam) <= FEW else _of_many)(several_m, strengths, count, order, near_m)
    range_m[beam], strength[beam] = several_m.take(first), strengths.take(first)
    if count == 1:
        return Returns(range_m[:beams], strength[:beams], beam[:0])
    two = second >= 0
    second = second[two]
    end = beams + len(second)
    range_m[beams:end], strength[beams:end] = several_m.take(second), strengths.take(second)
    return Returns(range_m[:end], strength[:end], beam[two])


def _of_few(several_m: Floats, strengths: Floats, count: int, order: str, near_m: float) -> tuple[Words, Words]:
    """As `_of_many`, beam by beam: arrays take longer for a handful."""
    first, second, width = [], [], several_m.shape[1]
    backwards = order == "FARTHEST_TO_NEAREST"
    for at, (ranges_m, lights) in enumerate(zip(several_m.tolist(), strengths.tolist(), strict=True)):
        every = zip(ranges_m, lights, range(width), strict=True)
        found = [(-light, echo, one_m) for one_m, light, echo in every if one_m >= near_m]
        if order == "STRONGEST_TO_WEAKEST" or count > 1:
            found = sorted(found)[:count]
        if order != "STRONGEST_TO_WEAKEST":
            found.sort(key=lambda one: one[2], reverse=backwards)
        first.append(at * width + found[0][1])
        second.append(at * width + found[1][1] if len(found) > 1 and count > 1 else -1)
    return np.array(first), np.array(second)


def _of_many(several_m: Floats, strengths: Floats, count: int, order: str, near_m: float) -> tuple[Words, Words]:
    """Places (m,) of the first and the second return of m beams in their (m, k) echoes; -1: none."""
    sign = {"NEAREST_TO_FARTHEST": -1.0, "FARTHEST_TO_NEAREST": 1.0}.get(order)
    better = strengths if sign is None or count > 1 else sign * several_m
    rank, row = np.where(several_m >= near_m, better, -np.inf), np.arange(0, several_m.size, several_m.shape[1])
    first = rank.argmax(axis=1) + row
    if count == 1:
        return first, first
    rank.put(first, -np.inf)
    second = rank.argmax(axis=1) + row
    two = rank.take(second) > -np.inf
    if sign is not None:
        swapped = two & (sign * several_m.take(first) < sign * several_m.take(second))
        first, second = np.where(swapped, second, first), np.where(swapped, first, second)
    return first, np.where(two, second, -1)
