"""Inputs for fuzzing: seeded edits of good examples, and the smallest form of an input that still fails."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

LONGEST = 65_536
"Bytes of one input."
MOST_EDITS = 8
MINIMISE_TRIES = 400
ODD_BYTES = b"\x00\x01\x02\x06\x7f\x80\xff\r\n<>\"'{}[]:#*&!%"
ODD_NUMBERS = (
    b"\x00\x00\x00\x00", b"\xff\xff\xff\xff", b"\x7f\xff\xff\xff", b"\xff\xff\xff\x7f", b"\x80\x00\x00\x00",
    b"\x00\x00\x00\x80", b"-1", b"0", b"1e999", b"-0.0", b"nan", b"9" * 30, b"99999999999", b"4294967295",
)  # fmt: skip


def mutated(seeds: Sequence[bytes], words: Sequence[bytes], rng: np.random.Generator) -> bytes:
    """One of `seeds` after a few edits; `words` of the language are put in now and then. Sometimes plain noise."""
    if rng.random() < 0.03:
        return rng.bytes(int(rng.integers(0, 200)))
    data = bytearray(seeds[int(rng.integers(len(seeds)))])
    for _ in range(int(rng.integers(1, MOST_EDITS + 1))):
        _edit(data, seeds, words, rng)
    return bytes(data[:LONGEST])


def _edit(data: bytearray, seeds: Sequence[bytes], words: Sequence[bytes], rng: np.random.Generator) -> None:
    size = len(data)
    at = int(rng.integers(size + 1))
    some = min(size - at, int(rng.geometric(0.1)))
    kind = int(rng.integers(10))
    if kind == 0 and size:
        data[at % size] ^= 1 << int(rng.integers(8))
    elif kind == 1 and size:
        data[at % size] = int(rng.integers(256))
    elif kind == 2 and size:
        data[at % size] = ODD_BYTES[int(rng.integers(len(ODD_BYTES)))]
    elif kind == 3:
        del data[at : at + some]
    elif kind == 4:
        data[at:at] = rng.bytes(int(rng.geometric(0.2)))
    elif kind == 5:
        data[at:at] = data[at : at + some] * int(rng.integers(1, 20))
    elif kind == 6:
        other = seeds[int(rng.integers(len(seeds)))]
        cut = int(rng.integers(len(other) + 1))
        data[at:] = other[cut:]
    elif kind == 7:
        number = ODD_NUMBERS[int(rng.integers(len(ODD_NUMBERS)))]
        data[at : at + len(number)] = number
    elif kind == 8 and words:
        data[at : at + (some if rng.random() < 0.5 else 0)] = words[int(rng.integers(len(words)))]
    else:
        del data[at:]


def minimised(data: bytes, fails: Callable[[bytes], bool]) -> bytes:
    """A shorter input that still fails, found by leaving out pieces."""
    tries, piece = 0, max(1, len(data) // 2)
    while piece >= 1 and tries < MINIMISE_TRIES:
        at, shorter = 0, False
        while at < len(data) and tries < MINIMISE_TRIES:
            candidate = data[:at] + data[at + piece :]
            tries += 1
            if fails(candidate):
                data, shorter = candidate, True
            else:
                at += piece
        if not shorter:
            piece //= 2
    return data
