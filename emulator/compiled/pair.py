"""A step of a sweep in two forms, with numpy arrays and by compiled loops, behind one function that chooses.

Belongs here: the choice, the same for all steps. The array form carries it: `by_loops` above an array form names the
function that does the same with loops, which stands beside it, and the loops that this takes. Not: the loops.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from typing import Any, Never, ParamSpec, TypeVar

from emulator.compiled.switch import kernels

Given = ParamSpec("Given")
Made = TypeVar("Made")
OTHERWISE: Never = object()  # type: ignore[assignment]
"What the form by loops gives where it does not do for what it was given: arrays do it."


class Pair:
    """Both forms of a step."""

    def __init__(self, array: Callable[..., Any], loop: Callable[..., Any], names: tuple[str, ...]) -> None:
        self.array, self.loop, self.names = array, loop, names
        self.on = True
        "False leaves the loops of this step alone out, for comparisons."

    @property
    def step(self) -> str:
        """Module and function."""
        return f"{self.array.__module__}.{self.array.__qualname__}"


def by_loops(loop: Callable[..., Any], *names: str) -> Callable[[Callable[Given, Made]], Callable[Given, Made]]:
    """Have a step done by `loop`, which gets `compiled.loops` first, where loops are used; `names`: those it takes."""

    def of(array: Callable[Given, Made]) -> Callable[Given, Made]:
        pair = Pair(array, loop, names)

        @wraps(array)
        def step(*args: Given.args, **words: Given.kwargs) -> Made:
            loops = kernels() if pair.on else None
            if loops is None:
                return array(*args, **words)
            made: Made = pair.loop(loops, *args, **words)
            return array(*args, **words) if made is OTHERWISE else made

        step.pair = pair  # type: ignore[attr-defined]
        return step

    return of


def array_form(step: Callable[Given, Any]) -> Callable[Given, Any]:
    """The form with numpy arrays of a step."""
    return step.pair.array  # type: ignore[attr-defined, no-any-return]
