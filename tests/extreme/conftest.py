"""Every test of this folder runs with all floating-point errors of numpy raised; warnings are errors everywhere."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest


@pytest.fixture(autouse=True)
def _floating_point_errors_are_raised() -> Iterator[None]:
    with np.errstate(all="raise"):
        yield
