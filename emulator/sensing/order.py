"""Sub-echoes of several parts in order: by beam, then range.

Belongs here: putting parts together and sorting them. Not: where they come from (paths).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from emulator.physics.arrays import Floats, Ints, indexes, ramp
from emulator.physics.subechoes import SubEchoes

MOST_EMPTY = 4
"Rows of sub-echoes are sorted one by one up to so many places an echo."
MOST_RUNS = 8
"Parts of sub-echoes, each in the order of the beams, that are put into such rows one after another."

Part = tuple[Ints, Floats, Floats, Floats, NDArray[np.int32]]
"Beam, range, amplitude, blocked share, actor."


def joined(parts: list[Part]) -> Part:
    """All of them as one."""
    if not parts:
        return np.zeros(0, np.int64), np.zeros(0), np.zeros(0), np.zeros(0), np.zeros(0, np.int32)
    if len(parts) == 1:
        return parts[0]
    beam, range_m, amplitude, blocked, actor = (np.concatenate(column) for column in zip(*parts, strict=True))
    return beam, range_m, amplitude, blocked, actor


def in_order(beam: Ints, range_m: Floats, amplitude: Floats, blocked: Floats, actor: NDArray[np.int32]) -> SubEchoes:
    """Sorted by beam, then range."""
    source = actor.astype(np.int64)
    if len(beam) < 2 or bool((beam[1:] > beam[:-1]).all()):
        return SubEchoes(beam, range_m, amplitude, blocked, source)
    order = _order(beam, range_m)
    return SubEchoes(beam[order], range_m[order], amplitude[order], blocked[order], source[order])


def _order(beam: Ints, range_m: Floats) -> Ints:
    """Indexes by beam, then range, by sorting numbers that hold beam, range and index in 63 bits.

    That is four times as fast as sorting indexes. Ranges are distinguished to 2^-24 of the largest at the least,
    5e-6 m at
    82 m; what is nearer together than that is one for every receiver.
    """
    index_bits, beam_bits = len(beam).bit_length(), max(int(beam.max()), 1).bit_length()
    range_bits = 63 - index_bits - beam_bits
    if range_bits < 24:
        return np.lexsort((range_m, beam))
    # with more than 50 bits the largest would round into those of the beam
    scale = (2.0 ** min(range_bits, 50) - 1.0) / max(float(range_m.max()), 1e-9)
    key = (range_m * scale).astype(np.int64) << index_bits
    key |= np.arange(len(beam))
    size = np.bincount(beam)
    most = int(size.max())
    falls = indexes(beam[1:] < beam[:-1]) + 1
    if len(falls) < MOST_RUNS and len(size) * most <= MOST_EMPTY * len(beam):
        # runs sorted by beam already: short rows are sorted ten times as fast as all numbers together
        rows = np.full(len(size) * most, np.iinfo(np.int64).max)
        begins = np.arange(len(size)) * most
        free = begins
        for begin, end in zip((0, *falls), (*falls, len(beam)), strict=True):
            count = np.bincount(beam[begin:end], minlength=len(size)) if len(falls) else size
            rows[_places(free, count)] = key[begin:end]
            free = free + count
        rows.reshape(len(size), most).sort(axis=1)
        key = rows.take(_places(begins, size))
    else:
        key |= beam << (63 - beam_bits)
        key.sort()
    key &= (1 << index_bits) - 1
    return key


def _places(begins: Ints, counts: Ints) -> Ints:
    """`counts` whole numbers from each of `begins` on, one after another."""
    return np.asarray(begins.repeat(counts) + ramp(counts))
