"""The same computed by arrays and by compiled loops."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

import numpy as np

from emulator.compiled import switch
from protocols.scan import Scan

Made = TypeVar("Made")

RANGE_M = 1e-7
"What rounding may do to a range: crossings are found to this."


def both(make: Callable[[], Made]) -> tuple[Made, Made]:
    """What `make` gives by arrays, and by compiled loops."""
    with switch.switched(False):
        arrays = make()
    with switch.switched(True):
        assert switch.kernels() is not None  # else arrays would be compared with themselves
        return arrays, make()


def called(loop: Any) -> Callable[..., Any]:
    """A loop that loops alone call, called from Python."""
    import numba

    @numba.njit  # type: ignore[untyped-decorator]
    def call(*given):  # type: ignore[no-untyped-def]
        return loop(*given)

    return call  # type: ignore[no-any-return]


def differing(one: Scan, other: Scan) -> np.ndarray:
    """Beams (k,) whose readings differ by more than rounding."""
    with np.errstate(invalid="ignore"):
        near = np.abs(one.range_m - other.range_m) <= RANGE_M
        bright = np.abs(one.intensity - other.intensity) <= 1e-6 * np.maximum(1.0, np.abs(one.intensity))
    same = (np.isnan(one.range_m) & np.isnan(other.range_m)) | (near & bright & (one.actor == other.actor))
    return np.flatnonzero(~same.all(axis=1) | (one.flags != other.flags))
