"""The language of expectations: evaluators of Python's syntax, of arrays, and of CEL, each with the least glue."""

from __future__ import annotations

import ast
import re
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

import numpy as np

from emulator.config import expressions
from emulator.config.expressions import FUNCTIONS, Name
from tests.benchmarks.libraries.measure import Row, added, bounded, import_cost, lines, per_s, version_of
from tests.config import test_expressions as tests

Lookup = Callable[[Name], Any]
Parsed = Callable[[Lookup], Any]

TYPICAL = "max(a.s) - mean(a.s) < 3 and a.x > 1"
SERIES_CASES = [
    ("a.s > 0 and a.x > 1", False),
    ("not a.s > 9", True),
    ("a.s > 9 or a.x > 1", True),
    ("a.s > a.s", None),
]
"What scenarios say of series with `and`, `or`, `not`; a missing value is in it. None: a series."
HOSTILE = {
    "9**9**9": "'9**9**9'",
    "1e5 parentheses": "'(' * 100000 + '1' + ')' * 100000",
    "1e5 minus signs": "'-' * 100000 + '1'",
    "1e5 sums": "'1+' * 100000 + '1'",
    "list of 1e9": "'[0] * 10**9'",
    "lambda": "'(lambda: 1)()'",
    "class of": "'a.__class__.__mro__'",
}


class Sensor:
    """`a` of `a.range_at(0)`, for evaluators that ask objects for attributes."""

    def __init__(self, name: str, lookup: Lookup) -> None:
        self._name, self._lookup = name, lookup

    def __getattr__(self, quantity: str) -> Any:
        try:
            return self._lookup(Name((self._name, quantity)))
        except KeyError:
            return lambda argument: self._lookup(
                Name((self._name, quantity), argument if isinstance(argument, str) else float(argument))
            )


class Names(dict[str, Any]):
    """Every word is a sensor, but actors, which are their own names."""

    def __init__(self, lookup: Lookup) -> None:
        super().__init__()
        self._lookup = lookup

    def __missing__(self, word: str) -> Any:
        return "car" if word == "car" else Sensor(word, self._lookup)


CALLS = {name: function for name, (_, function, _) in FUNCTIONS.items()}


def ours(text: str) -> Parsed:
    tree = expressions.parse(text)
    return lambda lookup: expressions.evaluate(tree, lookup)


def by_simpleeval(text: str) -> Parsed:
    import simpleeval

    tree = simpleeval.SimpleEval.parse(text)

    def run(lookup: Lookup) -> Any:
        allowed = {ast.Add: np.add, ast.Sub: np.subtract, ast.Mult: np.multiply, ast.Div: np.divide}
        return simpleeval.SimpleEval(
            operators=simpleeval.DEFAULT_OPERATORS | allowed, functions=CALLS, names=Names(lookup)
        ).eval(text, tree)

    return run


def by_asteval(text: str) -> Parsed:
    import asteval

    evaluator = asteval.Interpreter(minimal=True, user_symbols=CALLS | {"car": "car"})
    tree = evaluator.parse(text)
    if evaluator.error:
        raise ValueError(evaluator.error[0].get_error()[1])

    def run(lookup: Lookup) -> Any:
        evaluator.symtable.update({word: Sensor(word, lookup) for word in "ab"})
        found = evaluator.run(tree, with_raise=True)
        if evaluator.error:
            raise ValueError(evaluator.error[0].get_error()[1])
        return found

    return run


def by_numexpr(text: str) -> Parsed:
    import numexpr

    found: list[str] = []
    flat = re.sub(
        r'"?[a-z][-\w]*"?\.[a-z]+(\([^)]*\))?', lambda one: f"n{found.append(one[0]) or len(found) - 1}", text
    )
    flat = re.sub(r"\band\b", "&", re.sub(r"\bor\b", "|", re.sub(r"\bnot\b", "~", flat)))

    def run(lookup: Lookup) -> Any:
        values = {f"n{number}": lookup(expressions.parse(one)) for number, one in enumerate(found)}  # type: ignore
        return numexpr.evaluate(flat, local_dict=values, global_dict={})

    return run


def by_restricted_python(text: str) -> Parsed:
    import RestrictedPython

    code = RestrictedPython.compile_restricted(text, "<expect>", "eval")

    def run(lookup: Lookup) -> Any:
        names = Names(lookup)
        names.update(CALLS, __builtins__={}, _getattr_=getattr)
        return eval(code, {"__builtins__": {}, "_getattr_": getattr, **CALLS}, names)

    return run


def _in_cel(text: str) -> str:
    for word, sign in (("and", "&&"), ("or", "||"), ("not", "!")):
        text = re.sub(rf"\b{word}\b", sign, text)
    return re.sub(r"(?<![\w.])(\d+)(?![\w.])", r"\1.0", text)


QUANTITIES = ("s", "x", "at", "on")


def _scene(lookup: Lookup) -> Mapping[str, Any]:
    found: dict[str, Any] = {}
    for quantity in QUANTITIES:
        try:
            value = lookup(Name(("a", quantity)))
        except KeyError:
            continue
        found[quantity] = np.asarray(value, np.float64).tolist()
    return found


def _for_cel(kind: Callable[[float], Any], call: Callable[..., Any], *values: Any) -> Any:
    return kind(float(call(*map(np.asarray, values))))


def by_cel_python(text: str) -> Parsed:
    import celpy
    from celpy.adapter import json_to_cel

    made = celpy.Environment()
    functions = {name: partial(_for_cel, celpy.celtypes.DoubleType, call) for name, call in CALLS.items()}
    program = made.program(made.compile(_in_cel(text)), functions=functions)
    return lambda lookup: program.evaluate({"a": json_to_cel(_scene(lookup)), "car": celpy.celtypes.StringType("car")})


def by_cel(text: str) -> Parsed:
    import cel

    program = cel.compile(_in_cel(text))

    def run(lookup: Lookup) -> Any:
        context = cel.Context({"a": dict(_scene(lookup)), "car": "car"})
        for name, call in CALLS.items():
            context.add_function(name, partial(_for_cel, float, call))
        return program.execute(context)

    return run


LIBRARIES: dict[str, tuple[str, str, Callable[[str], Parsed]]] = {
    "simpleeval": ("simpleeval", "simpleeval", by_simpleeval),
    "asteval": ("asteval", "asteval", by_asteval),
    "numexpr": ("numexpr", "numexpr", by_numexpr),
    "RestrictedPython": ("RestrictedPython", "RestrictedPython", by_restricted_python),
    "cel-python": ("cel-python", "celpy", by_cel_python),
    "common-expression-language": ("common-expression-language", "cel", by_cel),
}


def _cases(test: Callable[..., object]) -> list[Any]:
    """The cases of a test of ours."""
    return list(test.pytestmark[0].args[1])  # type: ignore[attr-defined]


def right(parse: Callable[[str], Parsed]) -> str:
    """How many of our tests' values come out, those about series and missing values among them."""
    cases = [*_cases(tests.test_an_expression_has_the_value_that_pencil_and_paper_give), *SERIES_CASES]
    cases += [(text, False) for text in _cases(tests.test_what_arithmetic_cannot_tell_compares_false)]
    good = 0
    for text, wanted in cases:
        try:
            value = np.asarray(parse(text)(tests.lookup))
            good += bool(value.ndim) if wanted is None else bool(np.all(np.isclose(value.astype(float), float(wanted))))
        except Exception:
            continue
    return f"{good} of {len(cases)}"


def refused(parse: Callable[[str], Parsed]) -> str:
    """How many of the texts that our tests refuse are refused before a run."""
    cases = _cases(tests.test_what_is_no_expression_is_refused_with_what_is_wanted)
    cases += [text for text, _ in _cases(tests.test_numbers_that_are_none_are_told_before_a_run)]
    count = 0
    for text in cases:
        try:
            parse(text)
        except Exception:
            count += 1
    return f"{count} of {len(cases)}"


def hostile(name: str) -> Any:
    """For `bounded`: parse and evaluate by name."""
    parse = ours if name == "ours" else LIBRARIES[name][2]
    return lambda text: parse(text)(tests.lookup)


def _measured(name: str, parse: Callable[[str], Parsed]) -> dict[str, str]:
    found = {"values right": right(parse), "refused before a run": refused(parse)}
    try:
        tree = parse(TYPICAL)
        assert bool(np.all(tree(tests.lookup)))
        found["s per 100 000 evaluations"] = f"{1e5 / per_s(lambda: tree(tests.lookup)):.1f}"
    except Exception as error:
        found["s per 100 000 evaluations"] = f"cannot ({type(error).__name__})"
    for label, text in HOSTILE.items():
        found[label] = bounded(f"tests.benchmarks.libraries.expressions:hostile({name!r})({text})")
    return found


PARSING = (expressions._Parser, expressions._tokens, expressions._finite, expressions.Unary, expressions.Binary)
"What of ours a library would replace; names, functions and what a series means stay in any case."


def rows() -> list[Row]:
    """Ours, then every library."""
    found = [Row("ours", {"lines to replace": str(lines(*PARSING, expressions.evaluate))} | _measured("ours", ours))]
    for name, (distribution, module, parse) in LIBRARIES.items():
        version = version_of(distribution)
        if version is None:
            found.append(Row(name))
            continue
        cost = {"install": added(distribution), "import": import_cost(module, "import emulator.config.expressions")}
        glue = lines(parse, *((_scene, _in_cel, _for_cel) if "cel" in name else (Sensor, Names)))
        found.append(Row(f"{name} {version}", cost | {"lines of glue": str(glue)} | _measured(name, parse)))
    return found
