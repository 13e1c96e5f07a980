"""Measured alike for every library: what it adds to an install and a process, and what a hostile input does to it.

Belongs here: versions, sizes, import, a child with bounds. Not: any one job.
"""

from __future__ import annotations

import ast
import importlib.metadata
import inspect
import os
import re
import subprocess
import sys
import time
import tomllib
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from pathlib import Path
from types import ModuleType
from typing import Any

ROOT = Path(__file__).parents[3]
MEMORY_BYTES, TIME_LIMIT_S = 2 << 30, 20.0
"What a trial in a process of its own may take."


@dataclass(frozen=True)
class Row:
    """One library, or ours, at one job."""

    name: str
    found: dict[str, str] = field(default_factory=dict)
    "What was measured -> figure and unit. Empty: not installed."


def version_of(distribution: str) -> str | None:
    """Of an installed distribution; None: not installed."""
    try:
        return importlib.metadata.version(distribution)
    except importlib.metadata.PackageNotFoundError:
        return None


def _needed(distribution: str, seen: set[str]) -> set[str]:
    """The distribution and what it requires here, without extras."""
    name = re.sub(r"[-_.]+", "-", distribution).lower()
    if name not in seen:
        try:
            wanted = importlib.metadata.requires(name) or []
        except importlib.metadata.PackageNotFoundError:
            return seen
        seen.add(name)
        for line in wanted:
            if "extra ==" not in line and not re.search(r"(sys_)?platform\w* *== *.(win32|Windows|Darwin)", line):
                _needed(re.split(r"[ <>=!~;\[(]", line, maxsplit=1)[0], seen)
    return seen


def added(distribution: str) -> str:
    """What a base install would have to take besides: packages and their size."""
    base: set[str] = set()
    for line in tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["dependencies"]:
        _needed(re.split(r"[ <>=!~;\[(]", line, maxsplit=1)[0], base)
    more = _needed(distribution, set()) - base
    size = sum(file.size or 0 for name in more for file in importlib.metadata.files(name) or ())
    return f"{len(more)} packages, {size / 1e6:.2f} MB" if more else "nothing"


_IMPORT = """
import resource, sys, time
{before}
def used(): return int(open('/proc/self/statm').read().split()[1]) * resource.getpagesize()
modules, memory, start = len(sys.modules), used(), time.thread_time()
import {module}
print(1e3 * (time.thread_time() - start), (used() - memory) / 1e6, len(sys.modules) - modules)
"""


def import_cost(module: str, before: str) -> str:
    """Least of five: processor time, memory and modules that importing adds after the statement `before`."""
    costs = []
    for _ in range(5):
        reported = subprocess.run(
            [sys.executable, "-c", _IMPORT.format(module=module, before=before)],
            capture_output=True, text=True, check=True, cwd=ROOT,
        ).stdout  # fmt: skip
        costs.append(tuple(map(float, reported.split())))
    ms, megabytes, modules = min(costs)
    return f"{ms:.1f} ms, {megabytes:.1f} MB, {modules:.0f} modules"


def lines(*parts: Callable[..., Any] | type | ModuleType) -> int:
    """Lines of code of functions and classes, without blank ones, docstrings and comments."""
    return sum(_code_lines(inspect.getsource(part)) for part in parts)


def _code_lines(source: str) -> int:
    tree = ast.parse(inspect.cleandoc("\n" + source) if source[:1] == " " else source)
    texts: set[int] = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str):
            texts |= set(range(node.lineno, (node.end_lineno or node.lineno) + 1))
    rows = enumerate(source.splitlines(), 1)
    return sum(1 for at, text in rows if text.strip() and text.strip()[0] != "#" and at not in texts)


def per_s(action: Callable[[], object], seconds: float = 0.5) -> float:
    """How often a second of processor time."""
    action()
    count, start = 0, time.process_time()
    while (took := time.process_time() - start) < seconds:
        action()
        count += 1
    return count / took


_BOUNDED = """
import resource
resource.setrlimit(resource.RLIMIT_AS, ({memory}, {memory}))
resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
import warnings
warnings.simplefilter("ignore")
try:
    print("answers", str({call})[:40])
except Exception as error:
    print(type(error).__name__)
"""


def bounded(call: str) -> str:
    """What `module:function(arguments)` does in a process with bounds: `answers ...`, an exception, or its end."""
    module, rest = call.split(":", 1)
    text = _BOUNDED.format(memory=MEMORY_BYTES, call=f"__import__({module!r}, fromlist=['x']).{rest}")
    try:
        done = subprocess.run(
            [sys.executable, "-c", text], capture_output=True, text=True, timeout=TIME_LIMIT_S, cwd=ROOT, check=False
        )
    except subprocess.TimeoutExpired:
        return f"not done in {TIME_LIMIT_S:g} s"
    if done.returncode:
        return f"ended by signal {-done.returncode}" if done.returncode < 0 else "ended"
    return done.stdout.strip()


def failing(tests: Iterable[str], instead: str) -> str:
    """How many of our tests fail with a library instead of our own part (`instead`: job:library)."""
    done = subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "-n0", "--tb=no", "-p", "tests.benchmarks.libraries.instead", *tests],
        capture_output=True, text=True, cwd=ROOT, check=False, env=os.environ | {"LIDAREMU_INSTEAD": instead},
    )  # fmt: skip
    counts = {word: int(count) for count, word in re.findall(r"(\d+) (passed|failed|error)", done.stdout)}
    if not counts:
        return "none could be run"
    bad = counts.get("failed", 0) + counts.get("error", 0)
    return f"{bad} of {bad + counts.get('passed', 0)}"
