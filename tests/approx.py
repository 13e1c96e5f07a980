"""`pytest.approx` for arrays in one step: what is within the tolerance is found by numpy, all else is left to pytest.

pytest compares element by element, some microseconds each: clouds and plans have tens of thousands. Only "equal" is
decided here, by pytest's own rule; what is not equal, or not plain real numbers, goes pytest's way with its message.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

ABSOLUTE, RELATIVE = 1e-12, 1e-6
"Tolerances where none is given, as in pytest.approx."
EXACT = 2**53
"Whole numbers below it are exact as float64."


def install() -> None:
    """For this process."""
    for example in (np.zeros(1), 0.0):
        kind = type(pytest.approx(example))
        if not hasattr(kind, "by_elements"):
            kind.by_elements = kind.__eq__
            kind.__eq__ = _equal


def _equal(self: Any, actual: Any) -> bool:
    return within(self, actual) or bool(self.by_elements(actual))


def within(approx: Any, actual: Any) -> bool:
    """Whether all of `actual`, an array, is surely what `approx` stands for; False says nothing."""
    if not isinstance(actual, np.ndarray) or actual.size == 0:
        return False
    is_array = isinstance(approx.expected, np.ndarray)
    if is_array and approx.expected.shape != actual.shape:
        return False
    if not is_array and (not isinstance(approx.expected, int | float) or actual.dtype not in (np.float64, np.int64)):
        return False  # pytest takes a number out of a narrow array as it is, in its own precision
    expected = np.asarray(approx.expected)
    absolute = ABSOLUTE if approx.abs is None else approx.abs
    relative = (RELATIVE if approx.abs is None else 0.0) if approx.rel is None else approx.rel
    if not (_plain(expected) and _plain(actual) and _tolerance(absolute) and _tolerance(relative)):
        return False
    there, wanted = actual.astype(np.float64), expected.astype(np.float64)
    with np.errstate(all="ignore"):
        close = np.abs(wanted - there) <= np.maximum(relative * np.abs(wanted), absolute)
        return bool(((there == wanted) | (close & np.isfinite(wanted))).all())


def _plain(values: np.ndarray) -> bool:
    """Real numbers that float64 holds exactly."""
    if values.dtype.kind == "f":
        return values.dtype.itemsize <= 8
    return values.dtype.kind in "iu" and -EXACT < values.min() and values.max() < EXACT


def _tolerance(value: Any) -> bool:
    return isinstance(value, int | float) and 0 <= value < np.inf
