"""How loops are compiled: for these types of arguments, when they are first imported. Nothing else belongs here."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import wraps
from pathlib import Path
from typing import Any

import numpy as np
from numba import boolean, float32, float64, int32, int64, njit, uint8, uint64
from numba.core import event
from numba.types import Array


def _columns(kind: Any) -> tuple[Any, Any, Any]:
    """Arrays of one, two and three dimensions, in rows, that are only read."""
    return Array(kind, 1, "C", readonly=True), Array(kind, 2, "C", readonly=True), Array(kind, 3, "C", readonly=True)


FLOAT, INT, FLAG = float64, int64, boolean
FLOATS, ROWS, TURNS = _columns(float64)
INTS, INT_ROWS, _ = _columns(int64)
WORDS, _, _ = _columns(int32)
FLAGS, _, _ = _columns(boolean)
_, SINGLE_ROWS, _ = _columns(float32)
_, LONG_ROWS, _ = _columns(uint64)
OUT_FLOATS, OUT_LOOSE = float64[::1], float64[:, :]
OUT_INTS, OUT_WORDS, OUT_FLAGS, OUT_SINGLES = int64[::1], int32[::1], boolean[::1], float32[::1]
"Written to; loose: in rows or not."
OUT_ROWS, OUT_WORD_ROWS, OUT_BYTES = float64[:, ::1], int32[:, ::1], uint8[::1]
EMBREE = (INT, INT, INT, INT)
"`Packets.how`."
KEPT_IN: set[str] = set()
"Folders in which numba keeps what it compiled."


def forget_older(folder: Path) -> None:
    """Remove what was compiled before the latest change of any file there.

    numba itself looks only at the file of a function, not at those of the functions that it calls.
    """
    with suppress(OSError):  # another process does the same, or the folder may not be written to
        latest = max((path.stat().st_mtime for path in folder.glob("*.py")), default=0.0)
        for index in (folder / "__pycache__").glob("*.nbi"):
            if index.stat().st_mtime < latest:
                index.unlink()


forget_older(Path(__file__).parent)


class _OnStart(event.Listener):  # type: ignore[misc]
    """Calls back when the first compilation begins; what is loaded from disk is not compiled."""

    def __init__(self, action: Callable[[], object]) -> None:
        self._action: Callable[[], object] | None = action

    def on_start(self, _event: event.Event) -> None:
        if self._action is not None:
            self._action()
            self._action = None

    def on_end(self, _event: event.Event) -> None:
        pass


@contextmanager
def reported_once(tell: Callable[[str], object], text: str) -> Iterator[None]:
    """Says so when the compiler begins to run, and only then."""
    with event.install_listener("numba:compile", _OnStart(lambda: tell(text))):
        yield


def compiled(*arguments: Any) -> Callable[[Callable[..., Any]], Any]:
    """Compile for arguments of these types; none: for whatever calls it, from compiled loops alone (else `TypeError`).

    Kept on disk, where that is allowed. Other threads run meanwhile. A division by zero gives what numpy gives. Arrays
    that are only read are put in rows where they are not. Other loops call `made` of it.
    """
    if not arguments:
        return _compile
    read = [number for number, kind in enumerate(arguments) if isinstance(kind, Array) and not kind.mutable]
    tables = [number for number in read if arguments[number].ndim > 1]

    def compiling(function: Callable[..., Any]) -> Callable[..., Any]:
        made = _compile(function, arguments)

        @wraps(function)
        def called(*given: Any) -> Any:
            if all([given[at].flags.c_contiguous for at in tables]):
                try:
                    return made(*given)
                except TypeError:  # rare; to look at every column takes longer than all else around a call
                    pass
            return made(*(np.ascontiguousarray(one) if at in read else one for at, one in enumerate(given)))

        called.made = made  # type: ignore[attr-defined]
        return called

    return compiling


def inlined(function: Callable[..., Any]) -> Any:
    """Compile as a part of every loop that calls it: a call of its own hands over seven numbers for each array."""
    return _compile(function, None, forceinline=True)


def _compile(function: Callable[..., Any], arguments: tuple[Any, ...] | None = None, **more: bool) -> Any:
    """What nobody calls is not compiled: callers in C of all, and callers in Python of what loops alone call."""
    inner = arguments is None
    options = {"nogil": True, "error_model": "numpy", "no_cfunc_wrapper": True, "no_cpython_wrapper": inner} | more
    try:
        made = njit(arguments, cache=True, **options)(function)
        KEPT_IN.add(made._cache.cache_path)
    except RuntimeError:  # no folder that may be written to
        made = njit(arguments, **options)(function)
    if inner:  # numba itself would call an address that is not there
        made._insert = _nothing
        made._compile_for_args = _refused
    return made


def _nothing(*_: Any, **__: Any) -> None:
    """No compiled form is known to callers in Python."""


def _refused(*_: Any, **__: Any) -> Any:
    raise TypeError("a loop that compiled loops alone call; want it called by one of them, or its `py_func`")
