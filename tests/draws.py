"""How many cases a property test draws: a quarter of its number, and all of it with `LIDAREMU_TESTS_DEEP=1`.

The cases of the quarter are the same ones every time. What has ever caught a fault stands beside the property as an
`@example`, or as a test of its own, and is not among those that are left out.
"""

from __future__ import annotations

import os

DEEP = os.environ.get("LIDAREMU_TESTS_DEEP") == "1"


def cases(number: int) -> int:
    """How many cases of `number` this run draws, three at least."""
    return number if DEEP else max(number // 4, min(number, 3))
