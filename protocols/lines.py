"""Number of lines of each family, by kind: the size of a new family.

    python -m protocols.lines [FILE or FOLDER of a family of your own ...]

Belongs here: counting and the table. A shipped family says of each module what kind it is (`KINDS`); in one that is a
single module the statements do: sessions, what their `COMMANDS` name, codecs, constants.
"""

from __future__ import annotations

import ast
import io
import sys
import tokenize
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path

HERE = Path(__file__).parent
PAGE, EXAMPLES = HERE.parent / "docs/family.md", HERE.parent / "docs/examples/acme_family"
BEGIN, END = "<!-- made by python -m protocols.lines --page -->", "<!-- end of what is made -->"

COLUMNS = ("codec", "commands", "session", "settings", "other")
TABLES = ("commands", "settings")
NO_CODE = (tokenize.COMMENT, tokenize.NL, tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT, tokenize.ENDMARKER)
KINDS: Mapping[str, Mapping[str, str]] = {
    "lms2xx": {
        "codec": "telegrams values receiver framing outputs",
        "commands": "commands answers asking field_commands",
        "session": "session schedule device timing fields evaluation",
        "settings": "settings models variants configuration",
        "other": "__init__",
    },
    "ld": {
        "codec": "telegrams usp packages segments cola framing profiles",
        "commands": "services com_services files answers routing",
        "session": "session channels revolutions device head sectors",
        "settings": "settings config models",
        "other": "__init__",
    },
    "cola": {
        "codec": "framing scandata",
        "commands": "commands answers asking layouts",
        "session": "session state shapes filters fields",
        "settings": "settings models",
        "other": "__init__",
    },
    "can_objects": {
        "codec": "layout e2e framing ars408_lists ldmrs_lists table",
        "commands": "coverage ldmrs_parameters leddar_holding leddar_memory",
        "session": "session ars408 ars408_collision ars408_filters esr ldmrs ldmrs_choice identities leddar leddar_m16"
        " leddar_vu8",
        "settings": "settings ldmrs_settings",
        "other": "__init__",
    },
    "scip": {
        "codec": "codec framing",
        "commands": "commands",
        "session": "session device",
        "settings": "settings models",
        "other": "__init__",
    },
    "velodyne": {
        "codec": "codec framing",
        "commands": "session",
        "session": "device motor",
        "settings": "settings models tables own",
        "other": "__init__",
    },
    "ouster": {
        "codec": "codec framing",
        "commands": "api reports metadata alerts",
        "session": "device slices clocks imu",
        "settings": "settings models tables config",
        "other": "__init__",
    },
    "hesai": {
        "codec": "codec framing calibration",
        "commands": "commands session",
        "session": "device slices motor",
        "settings": "settings models tables",
        "other": "__init__",
    },
    "livox": {
        "codec": "codec framing",
        "session": "device patterns",
        "settings": "settings",
        "other": "__init__",
    },
    "rplidar": {
        "codec": "codec framing",
        "commands": "commands",
        "session": "session device",
        "settings": "settings models",
        "other": "__init__",
    },
    "ldrobot": {"codec": "codec", "session": "__init__"},
    "ydlidar": {"codec": "codec", "session": "session", "settings": "models", "other": "__init__"},
}
"Family -> kind -> its modules."

CODEC_METHODS = {"_telegrams", "_splitter", "_parse", "_reply", "_refusal", "_complaint", "_encode_list"}
"Of a session in a single module: they make bytes, or take them apart."


def kind_of(family: str, module: str) -> str | None:
    """Kind of a module of a shipped family; None: not listed."""
    return next((kind for kind, names in KINDS.get(family, {}).items() if module in names.split()), None)


def package_lines(folder: Path) -> Counter[str]:
    """Lines of a family that is a package: a module is of one kind, by default that of the session."""
    found: Counter[str] = Counter()
    for path in sorted(folder.glob("*.py")):
        found[kind_of(folder.name, path.stem) or "session"] += len(path.read_text(encoding="utf-8").splitlines())
    return found


def module_lines(path: Path) -> Counter[str]:
    """Lines of a family that is one module; blank lines and comments belong to the statement behind them."""
    text = path.read_text(encoding="utf-8")
    found: Counter[str] = Counter()
    last = 0
    for kind, end in _statements(ast.parse(text)):
        found[kind] += end - last
        last = end
    found["other"] += len(text.splitlines()) - last
    return found


def _statements(tree: ast.Module) -> Iterator[tuple[str, int]]:
    for node in tree.body:
        bases = [ast.unparse(base) for base in node.bases] if isinstance(node, ast.ClassDef) else []
        if isinstance(node, ast.ClassDef) and any(base.endswith("Session") for base in bases):
            yield from _methods(node)
        else:
            yield _kind(node, bases), node.end_lineno or 0


def _kind(node: ast.stmt, bases: list[str]) -> str:
    if any(base.endswith("Splitter") for base in bases):
        return "codec"
    if isinstance(node, ast.FunctionDef) and node.name.startswith(("encode_", "decode_")):
        return "codec"
    if isinstance(node, ast.Assign | ast.AnnAssign):
        value = ast.unparse(node.value) if node.value is not None else ""
        return "codec" if "dtype" in value else "other" if "Family(" in value else "settings"
    return "settings" if isinstance(node, ast.FunctionDef) and "DeviceKeys" in ast.unparse(node.args) else "other"


def _methods(session: ast.ClassDef) -> Iterator[tuple[str, int]]:
    """The rows of `COMMANDS` and what they name are commands."""
    named = {
        one.id
        for node in session.body
        if isinstance(node, ast.Assign | ast.AnnAssign)
        and node.value is not None
        and "Command(" in ast.unparse(node.value)
        for one in ast.walk(node.value)
        if isinstance(one, ast.Name)
    }
    for node in session.body:
        kind = "session"
        if isinstance(node, ast.FunctionDef):
            kind = "codec" if node.name in CODEC_METHODS else "commands" if node.name in named else "session"
        elif isinstance(node, ast.Assign | ast.AnnAssign) and node.value is not None:
            kind = "commands" if "Command(" in ast.unparse(node.value) else "session"
        yield kind, node.end_lineno or 0


def code_of(path: Path) -> int:
    """Lines of code of a family beside its tables: without commands, settings, docstrings, comments and blank lines."""
    found = 0
    for file in sorted(path.glob("*.py")) if path.is_dir() else [path]:
        if kind_of(path.name, file.stem) not in TABLES:
            text = file.read_text(encoding="utf-8")
            found += len(_code(text) - (set() if path.is_dir() else _table_lines(text)))
    return found


def _code(text: str) -> set[int]:
    """Numbers of the lines with code."""
    found: set[int] = set()
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.type not in NO_CODE:
            found.update(range(token.start[0], token.end[0] + 1))
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str):
            found.difference_update(range(node.lineno, (node.end_lineno or 0) + 1))
    return found


def _table_lines(text: str) -> set[int]:
    """Numbers of the lines of a single module that are commands or settings."""
    found: set[int] = set()
    last = 0
    for kind, end in _statements(ast.parse(text)):
        if kind in TABLES:
            found.update(range(last + 1, end + 1))
        last = end
    return found


def lines_of(path: Path) -> Counter[str]:
    """Lines of a family by kind: a folder, or one module. OSError, SyntaxError when it is neither."""
    return package_lines(path) if path.is_dir() else module_lines(path)


def table(paths: Iterable[Path]) -> str:
    """A Markdown table, a family a row; what all share in the last one. `code`: `code_of`."""
    rows = ["| family | " + " | ".join(COLUMNS) + " | all | code |", "|---|" + "---:|" * (len(COLUMNS) + 2)]
    for path in paths:
        found = lines_of(path)
        cells = [str(found[kind]) for kind in COLUMNS]
        rows.append(f"| {path.stem} | {' | '.join(cells)} | {found.total()} | {code_of(path)} |")
    shared = sum(len(one.read_text(encoding="utf-8").splitlines()) for one in (HERE / "skeleton").glob("*.py"))
    rows.append(f"| shared by all: `skeleton/` |{' |' * len(COLUMNS)} {shared} | |")
    return "\n".join(rows)


def written(text: str) -> str:
    """The page with its table replaced; ValueError if the page has no place for it."""
    head, begin, rest = text.partition(BEGIN)
    _, end, tail = rest.partition(END)
    if not begin or not end:
        raise ValueError(f"no place for the table; want {BEGIN} ... {END}")
    return f"{head}{BEGIN}\n{table([*shipped(), *sorted(EXAMPLES.glob('acme_[ls]*.py'))])}\n{END}{tail}"


def shipped() -> list[Path]:
    """Families of this package."""
    return [HERE / name for name in KINDS]


def main(arguments: list[str]) -> int:
    """Print the table, or write the page; the exit code."""
    if arguments == ["--page"]:
        PAGE.write_text(written(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
        return 0
    try:
        reported = table([*shipped(), *map(Path, arguments)])
    except (OSError, SyntaxError, UnicodeDecodeError) as error:
        sys.stderr.write(f"{error}; want the file or folder of a family\n")
        return 2
    sys.stdout.write(f"{reported}\n")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
