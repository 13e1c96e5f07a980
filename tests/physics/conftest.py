"""Every test of the physics runs with numpy's floating-point errors raised: no overflow or underflow is ignored."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest


@pytest.fixture(autouse=True)
def _floating_point_errors_are_raised() -> Iterator[None]:
    with np.errstate(all="raise"):
        yield
