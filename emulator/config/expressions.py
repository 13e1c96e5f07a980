"""The small language of expectations: numbers, names, functions, comparisons. Nothing of Python is run.

    max(front.points_on(car)) > 20 and median(front.range_at(0)) - 8 < 0.05

Belongs here: text -> tree, tree -> value. Not: what the names mean (series). A value is a number, a truth value, or a
series: an array with one number a scan. Arithmetic and comparisons work on whole series; `and`, `or` and `not` want
truth values, and a series of them counts as true when all of it is.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Union

import numpy as np

from protocols.scan import Floats

Value = Union[float, bool, Floats, "np.ndarray[tuple[int, ...], np.dtype[np.bool_]]"]
Node = Union["Number", "Name", "Call", "Unary", "Binary"]

MAX_CHARACTERS = 2000
MAX_DEPTH = 50
MAX_OPERATORS = 200

_TOKEN = re.compile(
    r"\s*(?:(?P<number>[0-9]+\.?[0-9]*(?:[eE][+-]?[0-9]+)?|\.[0-9]+)|(?P<name>[A-Za-z_]\w*)|\"(?P<quoted>[^\"]*)\""
    r"|(?P<sign><=|>=|==|!=|[-+*/()<>,.]))"
)


class ExpressionError(ValueError):
    """What is wrong with an expression, and what is allowed."""


@dataclass(frozen=True)
class Number:
    """A literal."""

    value: float


@dataclass(frozen=True)
class Name:
    """`sensor.quantity` or `sensor.quantity(argument)`; or a single word."""

    parts: tuple[str, ...]
    argument: str | float | None = None

    def __str__(self) -> str:
        return ".".join(self.parts) + ("" if self.argument is None else f"({self.argument})")


@dataclass(frozen=True)
class Call:
    """A function of `FUNCTIONS`."""

    function: str
    arguments: tuple[Node, ...]


@dataclass(frozen=True)
class Unary:
    """`-x` or `not x`."""

    sign: str
    operand: Node


@dataclass(frozen=True)
class Binary:
    """Two operands."""

    sign: str
    left: Node
    right: Node


def _series(value: Value) -> Floats:
    return np.atleast_1d(np.asarray(value, dtype=np.float64))


def _reduce(function: Callable[[Floats], float]) -> Callable[..., Value]:
    def apply(value: Value) -> Value:
        known = _series(value)
        known = known[~np.isnan(known)]
        return float(function(known)) if len(known) else float("nan")

    return apply


def _percentile(value: Value, share: float) -> Value:
    return _reduce(lambda known: np.percentile(known, share))(value)


def _count(value: Value) -> Value:
    known = _series(value)
    return float(np.count_nonzero(known)) if np.asarray(value).dtype == bool else float(np.sum(~np.isnan(known)))


FUNCTIONS: Mapping[str, tuple[int, Callable[..., Value], str]] = {
    "min": (1, _reduce(np.min), "smallest value"),
    "max": (1, _reduce(np.max), "largest value"),
    "mean": (1, _reduce(np.mean), "arithmetic mean"),
    "median": (1, _reduce(np.median), "median"),
    "std": (1, _reduce(np.std), "standard deviation"),
    "sum": (1, lambda value: float(np.nansum(_series(value))), "sum"),
    "count": (1, _count, "number of values, or of true values"),
    "first": (1, _reduce(lambda known: known[0]), "first value"),
    "last": (1, _reduce(lambda known: known[-1]), "last value"),
    "p": (2, _percentile, "p(series, 99): percentile"),
    "abs": (1, np.abs, "without sign"),
    "any": (1, lambda value: bool(np.any(value)), "whether one value is true"),
    "all": (1, lambda value: bool(np.all(value)), "whether all are"),
}
"Name -> number of arguments, what it does, its help. Values that are missing (NaN) are left out."

_BINDING = {"or": 1, "and": 2, "<": 4, "<=": 4, ">": 4, ">=": 4, "==": 4, "!=": 4, "+": 5, "-": 5, "*": 6, "/": 6}
_NOT, _MINUS = 3, 7


def parse(text: str) -> Node:
    """The tree of an expression; `ExpressionError` says what was found where."""
    if len(text) > MAX_CHARACTERS:
        raise ExpressionError(f"{len(text)} characters; want at most {MAX_CHARACTERS}")
    return _Parser(text).whole()


class _Parser:
    def __init__(self, text: str) -> None:
        self._tokens = list(_tokens(text))
        self._at = 0
        self._depth = 0
        self._operators = 0

    def whole(self) -> Node:
        node = self._expression(0)
        kind, word, place = self._tokens[self._at]
        if kind != "end":
            raise ExpressionError(f"{word!r} at character {place}; want an operator or the end")
        return node

    def _take(self) -> tuple[str, str, int]:
        token = self._tokens[self._at]
        self._at += token[0] != "end"
        return token

    def _is(self, sign: str) -> bool:
        kind, word, _ = self._tokens[self._at]
        return kind in ("sign", "name") and word == sign

    def _want(self, sign: str) -> None:
        kind, word, place = self._take()
        if kind != "sign" or word != sign:
            raise ExpressionError(f"{word or 'the end'!r} at character {place}; want {sign!r}")

    def _expression(self, binding: int) -> Node:
        self._depth += 1
        if self._depth > MAX_DEPTH:
            raise ExpressionError(f"nested deeper than {MAX_DEPTH}")
        left = self._operand()
        while True:
            kind, word, _ = self._tokens[self._at]
            strength = _BINDING.get(word, 0) if kind in ("sign", "name") else 0
            if strength <= binding:
                self._depth -= 1
                return left
            self._at += 1
            self._operators += 1
            if self._operators > MAX_OPERATORS:
                raise ExpressionError(f"more than {MAX_OPERATORS} operators; want several expectations")
            left = Binary(word, left, self._expression(strength))

    def _operand(self) -> Node:
        kind, word, place = self._take()
        if kind == "number":
            return Number(_finite(word, place))
        if kind == "sign" and word == "-":
            return Unary("-", self._expression(_MINUS))
        if kind == "sign" and word == "(":
            inner = self._expression(0)
            self._want(")")
            return inner
        if kind == "name" and word == "not":
            return Unary("not", self._expression(_NOT))
        if kind == "quoted" or (kind == "name" and word not in _BINDING):
            return self._named(kind, word)
        raise ExpressionError(f"{word or 'the end'!r} at character {place}; want a number, a name or '('")

    def _named(self, kind: str, word: str) -> Node:
        if kind == "name" and self._is("("):
            return self._call(word)
        parts = [word]
        while self._is("."):
            self._at += 1
            kind, word, place = self._take()
            if kind not in ("name", "quoted"):
                raise ExpressionError(f"{word or 'the end'!r} at character {place}; want a name after '.'")
            parts.append(word)
        if not self._is("("):
            return Name(tuple(parts))
        self._at += 1
        sign = -1.0 if self._is("-") else 1.0
        self._at += sign < 0
        kind, word, place = self._take()
        if kind not in ("name", "quoted", "number") or (sign < 0 and kind != "number"):
            raise ExpressionError(f"{word or 'the end'!r} at character {place}; want a name or a number")
        self._want(")")
        return Name(tuple(parts), sign * _finite(word, place) if kind == "number" else word)

    def _call(self, function: str) -> Node:
        if function not in FUNCTIONS:
            raise ExpressionError(f"function {function!r}; want one of {', '.join(FUNCTIONS)}")
        self._want("(")
        arguments = [self._expression(0)]
        while self._is(","):
            self._at += 1
            arguments.append(self._expression(0))
        self._want(")")
        if len(arguments) != FUNCTIONS[function][0]:
            raise ExpressionError(f"{function} with {len(arguments)} arguments; want {FUNCTIONS[function][0]}")
        if function == "p" and not (isinstance(arguments[1], Number) and arguments[1].value <= 100):
            raise ExpressionError("p(series, share): want a number of 0..100 as share")
        return Call(function, tuple(arguments))


def _finite(word: str, place: int) -> float:
    value = float(word)
    if value == np.inf:
        raise ExpressionError(f"{word!r} at character {place}; want a number below 1.8e308")
    return value


def _tokens(text: str) -> Iterator[tuple[str, str, int]]:
    at = 0
    while at < len(text.rstrip()):
        match = _TOKEN.match(text, at)
        if match is None:
            raise ExpressionError(f"{text[at:].strip()[:1]!r} at character {at + 1}; want numbers, names and operators")
        kind = str(match.lastgroup)
        yield kind, match.group(kind), match.start(kind) + 1
        at = match.end()
    yield "end", "", len(text) + 1


def names(node: Node) -> Iterator[Name]:
    """Every name that an expression uses."""
    if isinstance(node, Name):
        yield node
    elif isinstance(node, Call):
        for argument in node.arguments:
            yield from names(argument)
    elif isinstance(node, Unary):
        yield from names(node.operand)
    elif isinstance(node, Binary):
        yield from names(node.left)
        yield from names(node.right)


_ARITHMETIC: Mapping[str, Callable[[Floats, Floats], Floats]] = {
    "+": np.add,
    "-": np.subtract,
    "*": np.multiply,
    "/": np.divide,
}
_COMPARISONS: Mapping[str, Callable[[Floats, Floats], np.ndarray[tuple[int, ...], np.dtype[np.bool_]]]] = {
    "<": np.less,
    "<=": np.less_equal,
    ">": np.greater,
    ">=": np.greater_equal,
    "==": np.equal,
    "!=": np.not_equal,
}


def evaluate(node: Node, lookup: Callable[[Name], Value]) -> Value:
    """The value of an expression; `lookup` gives that of each name.

    What arithmetic cannot tell, by division by zero or beyond the largest number, is missing; so is what is made of a
    missing value, and a comparison with one is false.
    """
    if isinstance(node, Number):
        return node.value
    if isinstance(node, Name):
        return lookup(node)
    if isinstance(node, Call):
        return FUNCTIONS[node.function][1](*(evaluate(argument, lookup) for argument in node.arguments))
    if isinstance(node, Unary):
        value = evaluate(node.operand, lookup)
        return not truth(value) if node.sign == "not" else np.negative(np.asarray(value, dtype=np.float64))
    if node.sign in ("and", "or"):
        first = truth(evaluate(node.left, lookup))
        if first is (node.sign == "or"):
            return first
        return truth(evaluate(node.right, lookup))
    left, right = (np.asarray(evaluate(side, lookup), dtype=np.float64) for side in (node.left, node.right))
    if left.ndim and right.ndim and left.shape != right.shape:
        raise ExpressionError(f"{node.sign} of {len(left)} and {len(right)} values; reduce one, as by mean()")
    result: np.ndarray[tuple[int, ...], np.dtype[Any]]
    if node.sign in _COMPARISONS:
        result = _COMPARISONS[node.sign](left, right) & ~(np.isnan(left) | np.isnan(right))
    else:
        with np.errstate(all="ignore"):
            made = np.asarray(_ARITHMETIC[node.sign](left, right))
        result = np.where(np.isfinite(made), made, np.nan)
    result = np.asarray(result)
    return result if result.ndim else result.item()


def truth(value: Value) -> bool:
    """Of a truth value, or of a series of them (all, and not empty); `ExpressionError` for numbers."""
    array = np.asarray(value)
    if array.dtype != bool:
        raise ExpressionError("a number where true or false is required; want a comparison")
    return bool(array.size) and bool(array.all())
