"""Array types of the physics library and the few guards every formula needs.

Here: type aliases, the exponential that never warns, sums and ramps over ragged groups. Not here: any physics.
All values are float64. A function of the library takes scalars or arrays of any shape that broadcast and returns what
numpy returns for them.
"""

from __future__ import annotations

import math
from typing import TypeAlias, TypeVar

import numpy as np
from numpy.typing import NDArray

Floats: TypeAlias = NDArray[np.float64]
Ints: TypeAlias = NDArray[np.int64]
Complexes: TypeAlias = NDArray[np.complex128]
Bools: TypeAlias = NDArray[np.bool_]
Values: TypeAlias = float | NDArray[np.float64]
"What a formula accepts: one number or an array of them."

LOG_NOTHING = -575.0
"Natural logarithm of 1e-250: a factor below it is nothing at any receiver, and products of it cannot underflow."


def floats(values: Values) -> Floats:
    """The values as a float64 array."""
    return np.asarray(values, dtype=np.float64)


def exp_or_zero(exponent: Values) -> Floats:
    """exp(exponent), exactly 0 below `LOG_NOTHING` so that neither it nor its products underflow."""
    x = floats(exponent)
    return np.where(x < LOG_NOTHING, 0.0, np.exp(np.maximum(x, LOG_NOTHING)))


def indexes(wanted: Bools) -> Ints:
    """Where a flat array is true; `flatnonzero` takes longer to say so than to find out."""
    return wanted.nonzero()[0]


def cos_sin(angle: Floats) -> tuple[Floats, Floats]:
    """Cosine and sine, wrong by 2e-15 and by the rounding of the angle.

    Series about half the angle, over whole arrays: numpy's own take twice as long where a processor has no AVX-512.
    """
    with np.errstate(under="ignore"):
        half = angle * (0.5 / np.pi)
        half -= np.rint(half)
        half *= np.pi
        square = half * half
        cosine, sine = _series(_COS, square), _series(_SIN, square)
        sine *= half
        cosine *= sine
        cosine *= 2.0  # sin 2x = 2 sin x cos x
        sine *= sine
        sine *= -2.0
        sine += 1.0  # cos 2x = 1 - 2 sin^2 x
    return sine, cosine


_COS = tuple((-1.0) ** n / math.factorial(2 * n) for n in range(11))
_SIN = tuple((-1.0) ** n / math.factorial(2 * n + 1) for n in range(11))


def _series(factors: tuple[float, ...], x: Floats) -> Floats:
    total = factors[-1] * x
    for factor in factors[-2:0:-1]:
        total += factor
        total *= x
    total += factors[0]
    return total


Numbers = TypeVar("Numbers", Floats, Ints)


def clamped(values: Numbers, least: Values, most: Values) -> Numbers:
    """The values within bounds, as `clip`, at a quarter of its cost for short arrays."""
    return np.minimum(np.maximum(values, least), most)


def group_starts(groups: Ints) -> Ints:
    """First index of every run of equal numbers in a sorted array; empty for an empty one."""
    if groups.size == 0:
        return np.zeros(0, np.int64)
    return indexes(np.concatenate(([True], groups[1:] != groups[:-1])))


def ramp(counts: Ints) -> Ints:
    """0..c-1 for every count c, one after another: position within its group of each element of a ragged array."""
    total = int(counts.sum())
    ends = counts.cumsum()
    return np.arange(total) - (ends - counts).repeat(counts)


def require_positive(name: str, values: Values) -> None:
    """Refuse values that are not finite and above zero, by name."""
    x = floats(values)
    if not bool(np.all(np.isfinite(x) & (x > 0.0))):
        raise ValueError(f"{name}: {_first(x, ~(np.isfinite(x) & (x > 0.0)))}; want a number > 0")


def require_not_negative(name: str, values: Values) -> None:
    """Refuse values that are not finite or below zero, by name."""
    x = floats(values)
    if not bool(np.all(np.isfinite(x) & (x >= 0.0))):
        raise ValueError(f"{name}: {_first(x, ~(np.isfinite(x) & (x >= 0.0)))}; want a number >= 0")


def require_share(name: str, values: Values) -> None:
    """Refuse values outside 0..1, by name."""
    x = floats(values)
    if not bool(np.all((x >= 0.0) & (x <= 1.0))):
        raise ValueError(f"{name}: {_first(x, ~((x >= 0.0) & (x <= 1.0)))}; want a number from 0 to 1")


def _first(values: Floats, wrong: Bools) -> float:
    return float(np.atleast_1d(values)[np.atleast_1d(wrong)][0])
