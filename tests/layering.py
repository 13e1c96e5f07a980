"""The rooms of the house, floor by floor, and the figures of its imports: python -m tests.layering [CHECKOUT].

Belongs here: the one table of rooms, and the reading of imports: at the head of a module, in functions, under
`TYPE_CHECKING`. Not: what is asked of them (test_layering).
"""

from __future__ import annotations

import ast
import sys
from collections.abc import Iterable, Mapping
from functools import cache
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent

FLOORS: tuple[tuple[str, ...], ...] = (
    ("protocols", "emulator/errors.py"),
    ("emulator/process", "emulator/output", "emulator/config", "emulator/compiled"),
    ("emulator/transports", "emulator/physics", "emulator/sensors"),
    ("emulator/hosts", "emulator/faults", "emulator/live"),
    ("emulator/scenario",),
    ("emulator/measuring", "emulator/world"),
    ("emulator/casting",),
    ("emulator/sensing",),
    ("emulator/objects",),
    ("emulator/instrument",),
    ("emulator/injection", "emulator/recording"),
    ("emulator/runtime",),
    ("emulator/judging",),
    ("emulator/studies", "emulator/endurance"),
    ("emulator/run_report", "emulator/looking"),
    ("emulator/view", "emulator/campaigns"),
    ("emulator/commands",),
    ("emulator/__main__.py",),
)
"""The ground floor first. A room imports from itself and from the floors below it; rooms of one floor do not know each
other. Of `emulator/__init__.py` every room may have the version."""

OUTSIDE = ("__init__.py", "__main__.py", "errors.py", "py.typed")
"All that lies in emulator/ beside its rooms."


def modules(root: Path = ROOT) -> dict[str, Path]:
    """Dotted name of every module of the product -> its file."""
    found = {}
    for path in sorted((*root.glob("emulator/**/*.py"), *root.glob("protocols/**/*.py"))):
        name = ".".join(path.relative_to(root).with_suffix("").parts)
        found[name.removesuffix(".__init__")] = path
    return found


@cache
def statements(path: Path) -> tuple[tuple[str, tuple[str, ...], int, bool], ...]:
    """Every import of a file: module, names taken from it, line, and whether at its head."""
    found = []
    waiting: list[tuple[ast.AST, bool]] = [(ast.parse(path.read_text(encoding="utf-8")), True)]
    while waiting:
        above, head = waiting.pop()
        for node in ast.iter_child_nodes(above):
            if isinstance(node, ast.expr):
                continue  # nothing is imported within one
            late = isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda)
            late = late or (isinstance(node, ast.If) and "TYPE_CHECKING" in ast.dump(node.test))
            if isinstance(node, ast.Import):
                found += [(alias.name, (), node.lineno, head) for alias in node.names]
            elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
                found.append((node.module, tuple(alias.name for alias in node.names), node.lineno, head))
            else:
                waiting.append((node, head and not late))
    return tuple(found)


def imported(path: Path, known: Mapping[str, Path]) -> Iterable[tuple[str, int, bool]]:
    """Modules of the product that a file imports: name, line, and whether at its head, where loading it loads them."""
    for module, names, line, head in statements(path):
        inner = [f"{module}.{name}" for name in names]
        for name in [one if one in known else module for one in inner] or [module]:
            if name in known:
                yield name, line, head


def graph(root: Path = ROOT, at_head: bool = False) -> dict[str, set[str]]:
    """Module -> the modules that it imports, anywhere or at its head alone; a package's own name counts for nothing."""
    known = modules(root)
    return {
        name: {one for one, _, head in imported(path, known) if one != name and (head or not at_head)} - {"emulator"}
        for name, path in known.items()
    }


def circles(edges: Mapping[str, set[str]]) -> list[list[str]]:
    """Groups of more than one that reach each other (Tarjan's strongly connected components)."""
    number: dict[str, int] = {}
    low: dict[str, int] = {}
    path: list[str] = []
    found: list[list[str]] = []

    def visit(name: str) -> None:
        number[name] = low[name] = len(number)
        path.append(name)
        for one in sorted(edges.get(name, ())):
            if one not in number:
                visit(one)
            if one in path:
                low[name] = min(low[name], low[one])
        if low[name] == number[name]:
            group = path[path.index(name) :]
            del path[path.index(name) :]
            found.append(sorted(group))

    for name in sorted(edges):
        if name not in number:
            visit(name)
    return [group for group in found if len(group) > 1]


def chain(edges: Mapping[str, set[str]]) -> list[str]:
    """The longest way down, a circle counted as one."""
    of = {name: group[0] for group in circles(edges) for name in group}
    merged: dict[str, set[str]] = {}
    for name, others in edges.items():
        mine = of.get(name, name)
        merged.setdefault(mine, set()).update({of.get(one, one) for one in others} - {mine})
    longest: dict[str, list[str]] = {}

    def below(name: str) -> list[str]:
        if name not in longest:
            ways = [below(one) for one in sorted(merged.get(name, ()))]
            longest[name] = [name, *max(ways, key=len, default=[])]
        return longest[name]

    return max((below(name) for name in sorted(merged)), key=len)


def room_of(name: str, known: Mapping[str, Path], root: Path = ROOT) -> str:
    """The folder of emulator/ that a module lies in, or its own file; `protocols` is one room."""
    parts = known[name].relative_to(root).parts
    return parts[0] if parts[0] == "protocols" else "/".join(parts[:2])


def rooms(root: Path = ROOT) -> dict[str, set[str]]:
    """Room -> the rooms that it imports from."""
    known = modules(root)
    found: dict[str, set[str]] = {}
    for name, others in graph(root).items():
        mine = room_of(name, known, root)
        found.setdefault(mine, set()).update({room_of(one, known, root) for one in others} - {mine})
    found.pop("emulator/__init__.py", None)
    return found


def figures(root: Path = ROOT) -> dict[str, object]:
    """What the house looks like."""
    sys.setrecursionlimit(10_000)
    inside = [path for path in (root / "emulator").iterdir() if path.is_dir() and any(path.glob("*.py"))]
    loose = [path.name for path in (root / "emulator").glob("*.py") if path.name not in OUTSIDE]
    edges, head = graph(root), graph(root, at_head=True)
    house, rounds, way = rooms(root), circles(edges), chain(edges)
    return {
        "loose files": len(loose),
        "folders": len(inside),
        "rooms (folders, loose files)": len(house),
        "floors (longest chain of rooms)": len(chain(house)),
        "circles of rooms": circles(house),
        "circles of files": rounds,
        "files in circles": sum(map(len, rounds)),
        "longest chain of imports at the head of files": len(chain(head)),
        "longest chain of all imports": len(way),
        "that chain": " > ".join(way),
    }


def main() -> None:
    """Print them."""
    for name, value in figures(Path(sys.argv[1]).resolve() if len(sys.argv) > 1 else ROOT).items():
        sys.stdout.write(f"{name}: {value}\n")


if __name__ == "__main__":
    main()
