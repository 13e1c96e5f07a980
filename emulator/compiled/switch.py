"""What is compiled where numba is installed: `pip install 'lidaremu[fast]'`.

Belongs here: whether compiled functions are used. The functions themselves are loops over rays, one file for each step
of a sweep; each does what arrays do where numba is not there, to the rounding of float64, and a test compares the two.
`LIDAREMU_COMPILED=0` switches them off.

Functions are compiled once for a machine, before the first sweep, and kept beside their files, or in the user's cache
where that is not allowed.
"""

from __future__ import annotations

import importlib
import importlib.util
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from types import ModuleType

from emulator.compiled import build

SWITCH = "LIDAREMU_COMPILED"
"Environment: 0 leaves compiled functions out."
MESSAGE = "lidaremu: loops are being compiled for this machine, once\n"

_wanted = os.environ.get(SWITCH, "1") != "0"


def kernels() -> ModuleType | None:
    """The compiled functions, see `loops`; None: they are not to be used, or numba is not there."""
    return _loops()[0] if _wanted else None


def why() -> tuple[bool, str]:
    """Whether they are used, and what that means or what is missing."""
    if not _wanted:
        return False, f"{SWITCH}=0 switches them off"
    loops, wrong = _loops()
    if loops is None:
        return False, wrong
    found = loops.library()
    if found is None:
        return True, "numba; the installed embreex has no library for ray packets"
    return True, f"numba; rays are cast in packets of {found.width}"


def wanted() -> bool:
    """Whether they are to be used where they can be."""
    return _wanted


def in_use() -> bool:
    """Whether this process has them and uses them; loads nothing."""
    return _wanted and _loops.cache_info().currsize > 0 and _loops()[0] is not None


def choose(on: bool) -> None:
    """With or without them from here on, in a process that has built nothing yet."""
    global _wanted
    _wanted = on


@cache
def _loops() -> tuple[ModuleType | None, str]:
    """The functions, or why there are none."""
    if not importlib.util.find_spec("numba"):
        return None, "numba is not installed; with 'lidaremu[fast]' a sweep takes a half or a third of its time"
    try:
        with importlib.import_module("emulator.compiled.jit").reported_once(sys.stderr.write, MESSAGE):
            loops = importlib.import_module("emulator.compiled.loops")
        if not build.built():
            build.note_built(importlib.import_module("emulator.compiled.jit").KEPT_IN)
        return loops, ""
    except ImportError as error:  # a numba that does not go with this numpy says so when it is imported
        sys.stderr.write(f"lidaremu: loops are not compiled: {error}\n")
        return None, str(error)


@contextmanager
def switched(on: bool) -> Iterator[None]:
    """With or without them, for comparisons; what was built before stays what it is."""
    global _wanted
    before, _wanted = _wanted, on
    try:
        yield
    finally:
        _wanted = before
