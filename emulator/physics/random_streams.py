"""Random numbers keyed by what they are for: scenario seed, sensor, term, sweep, beam.

A draw depends on nothing else: not on the order in which sweeps are computed, nor on the terms left out, nor on
the number of beams. Each number is one word of a counter-based generator, turned into its law by the inverse of the
distribution function, so element j of a draw belongs to beam j whatever the others are.
"""

from __future__ import annotations

import hashlib
import threading
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import special

from emulator.physics.arrays import exp_or_zero

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Words = NDArray[np.uint64]

_TO_UNIT = 2.0**-53
MANY = 1000.0
"Mean count from which a Poisson law is drawn as a normal one."


class Normals:
    """Standard normal numbers, made of random words where they are asked for."""

    def __init__(self, words: Words) -> None:
        self.words = words
        self.shape = words.shape

    def __getitem__(self, at: Any) -> Floats:
        return np.asarray(special.ndtri(_unit(self.words[at])), dtype=np.float64)

    def of_beams(self, at: Ints) -> Normals:
        """Those of some beams."""
        return Normals(self.words[at])


@dataclass(frozen=True)
class RandomStreams:
    """All random numbers of one sensor in one scenario."""

    seed: int
    sensor: str

    def uniform(self, term: str, sweep: int, beams: int, columns: int = 1) -> Floats:
        """Uniform numbers in (0, 1), shape (beams, columns); row j is the same for every `beams` > j."""
        return _unit(self.words(term, sweep, beams, columns))

    def words(self, term: str, sweep: int, beams: int, columns: int = 1) -> Words:
        """Random words of 64 bits, shape (beams, columns); row j is the same for every `beams` > j."""
        raw = _set(_own_philox(), _key(self.seed, self.sensor, term), sweep).random_raw(beams * columns)
        return np.asarray(raw, np.uint64).reshape(beams, columns)

    def normal(self, term: str, sweep: int, beams: int, columns: int = 1) -> Floats:
        """Standard normal numbers, shape (beams, columns)."""
        return self.normals(term, sweep, beams, columns)[:]

    def normals(self, term: str, sweep: int, beams: int, columns: int = 1) -> Normals:
        """The same numbers as `normal`, of which only some are wanted."""
        return Normals(self.words(term, sweep, beams, columns))

    def poisson(self, term: str, sweep: int, mean: Floats) -> Ints:
        """Counts with the given means (beams,); above a mean of `MANY` by the normal law."""
        mean = np.asarray(mean, dtype=np.float64)
        count = np.zeros(mean.shape, dtype=np.int64)
        words = self.words(term, sweep, mean.size)[:, 0]
        largest = float(mean.max(initial=0.0))
        if largest == 0.0 or (largest <= MANY and _unit(words.max(keepdims=True))[0] <= exp_or_zero(-largest)):
            return count
        chance = _unit(words)
        if largest > MANY:
            many = mean > MANY
            centre = np.rint(mean[many] + np.sqrt(mean[many]) * special.ndtri(chance[many]))
            count[many] = np.maximum(centre, 0.0).astype(np.int64)
            left = np.flatnonzero(~many & (chance > exp_or_zero(-mean)))
        else:  # of few chances it must be looked at whether they are above their own
            left = np.flatnonzero(chance > exp_or_zero(-largest))
            left = left[chance[left] > exp_or_zero(-mean[left])]
        limit = int(min(largest, MANY) + 60.0 * np.sqrt(MANY) + 60.0)
        for step in range(1, limit):
            if left.size == 0:
                break
            count[left] = step
            left = left[chance[left] > special.pdtr(step, mean[left])]
        return count

    def word(self, term: str) -> int:
        """A number of 64 bits for whoever makes random numbers of its own keys."""
        return int(_key(self.seed, self.sensor, term)[0])

    def generator(self, term: str, sweep: int) -> np.random.Generator:
        """A stream of its own, for laws that need more than one word a number; depends on the order of its use."""
        return np.random.Generator(_set(np.random.Philox(0), _key(self.seed, self.sensor, term), sweep))


def _unit(words: Words) -> Floats:
    return ((words >> np.uint64(11)).astype(np.float64) + 0.5) * _TO_UNIT


@lru_cache(maxsize=1024)
def _key(seed: int, sensor: str, term: str) -> NDArray[np.uint64]:
    digest = hashlib.blake2b(f"{seed}\0{sensor}\0{term}".encode(), digest_size=16).digest()
    return np.frombuffer(digest, dtype="<u8")


_threads = threading.local()
_EMPTY = np.zeros(4, np.uint64)


def _own_philox() -> np.random.Philox:
    """This thread's generator, to be set before each use: a new one asks the system for entropy that nobody wants."""
    if not hasattr(_threads, "philox"):
        _threads.philox = np.random.Philox(0)
    found: np.random.Philox = _threads.philox
    return found


def _set(philox: np.random.Philox, key: NDArray[np.uint64], sweep: int) -> np.random.Philox:
    """At the beginning of the numbers of a sweep."""
    counter = np.array([0, 0, sweep & (2**64 - 1), 0], np.uint64)
    philox.state = {
        "bit_generator": "Philox", "state": {"counter": counter, "key": key}, "buffer": _EMPTY, "buffer_pos": 4,
        "has_uint32": 0, "uinteger": 0,
    }  # fmt: skip
    return philox
