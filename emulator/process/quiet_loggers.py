"""Libraries that log what is wrong with a file, with whole tracebacks: silenced; we report it ourselves."""

from __future__ import annotations

import contextlib
import logging
from collections.abc import Iterator


@contextlib.contextmanager
def muted(library: str) -> Iterator[None]:
    """Nothing of this library's logger while this lasts."""
    logger = logging.getLogger(library)
    propagated = logger.propagate
    handler = logging.NullHandler()
    logger.addHandler(handler)
    logger.propagate = False
    try:
        yield
    finally:
        logger.propagate = propagated
        logger.removeHandler(handler)
