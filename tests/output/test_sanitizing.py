"""Foreign characters in what we print: shown, never sent; one place prints."""

from __future__ import annotations

import ast
import io
import json
import os
import re
import sys
import unicodedata
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from emulator.commands import common
from emulator.commands.cli import main
from emulator.errors import EmulatorError, ScenarioError
from emulator.output import lines, sanitizing
from emulator.output.sanitizing import Guarded, html, put, visible

ROOT = Path(__file__).resolve().parent.parent.parent
EVIL = "a\x1b[2J\x07\r\x7f\x9b31m\u202e\u2066\u200b\ufeff\udcff\n\U000e0041z"
SHOWN = r"a\x1b[2J\x07\x0d\u007f\u009b31m\u202e\u2066\u200b\ufeff\udcff\x0a\U000e0041z"

PRINTS = {
    "emulator/commands/common.py": "complain through sanitizing.put; a bar of Rich on raw(stderr)",
    "emulator/output/lines.py": "say, note through sanitizing.put",
    "emulator/commands/study.py": "a bar of Rich on raw(stderr)",
    "emulator/live/fmu_slave.py": "imports nothing of the project: why a run ended, with what is not printable shown",
    "emulator/looking/screen.py": "pages of Rich on raw(stdout)",
    "emulator/commands/cli.py": "gives up standard output when its reader has gone",
    "emulator/compiled/switch.py": "imports nothing of the project: a fixed line and a library's, guarded",
    "emulator/process/driver.py": "a driver's standard output goes to standard error",
    "emulator/commands/look.py": "asks whether it is a terminal",
    "emulator/commands/ctl.py": "asks whether it is a terminal",
    "emulator/commands/probe.py": "asks whether it is a terminal",
    "emulator/view/local_server.py": "swallows what viser prints",
}
"Files that name the standard output or error, print, or draw with Rich; and why."


def names_a_stream(tree: ast.AST) -> set[str]:
    found = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name):
            if (node.value.id, node.attr) in {("sys", "stdout"), ("sys", "stderr")}:
                found.add(f"sys.{node.attr}")
            if node.value.id == "click" and node.attr in {"echo", "secho", "echo_via_pager", "confirm", "prompt"}:
                found.add(f"click.{node.attr}")
            if node.value.id == "os" and node.attr == "write":
                found.add("os.write")
        elif isinstance(node, ast.Name) and node.id in {"print", "Console", "redirect_stdout"}:
            found.add(node.id)
        elif isinstance(node, ast.ImportFrom) and node.module in {"rich", "warnings"}:
            found.add(node.module)
    return found


NAMES = re.compile(r"stdout|stderr|click|print|Console|\brich\b|\bwarnings\b")
"Without one of these words no file names a stream: it need not be parsed."


def test_nothing_prints_but_the_one_place() -> None:
    found = {}
    for path in (ROOT / "emulator").rglob("*.py"):
        source = path.read_text(encoding="utf-8")
        named = names_a_stream(ast.parse(source)) - {"os.write"} if NAMES.search(source) else set()
        if named:
            found[path.relative_to(ROOT).as_posix()] = named
    assert found.keys() == PRINTS.keys(), found


def test_everything_that_is_not_printable_is_shown() -> None:
    assert visible(EVIL) == SHOWN
    for code in range(0x110000):
        letter = chr(code)
        if unicodedata.category(letter) in {"Cc", "Cf", "Cs", "Zl", "Zp"}:
            assert visible(letter).isascii(), hex(code)
            assert visible(letter).isprintable(), hex(code)


@pytest.mark.parametrize("text", ["", "front: 37.5/s", "Größe µm ⠿ − 你好 🚗", "a\\x1b"])
def test_what_is_printable_stays(text: str) -> None:
    assert visible(text) == text


def test_json_stays_json() -> None:
    line = visible(json.dumps({"a": EVIL}))
    assert json.loads(line) == {"a": EVIL}
    assert "\x7f" not in line


@pytest.mark.parametrize("encoding", ["ascii", "latin-1", "utf-8"])
def test_letters_that_a_stream_has_not_are_shown(encoding: str) -> None:
    bytes_ = io.BytesIO()
    stream = io.TextIOWrapper(bytes_, encoding=encoding)
    put(stream, ["5 µm \u4f60 \x1b"])
    assert (
        bytes_.getvalue().decode(encoding)
        == {
            "ascii": "5 \\xb5m \\u4f60 \\x1b\n",
            "latin-1": "5 µm \\u4f60 \\x1b\n",
            "utf-8": "5 µm 你 \\x1b\n",
        }[encoding]
    )


def test_lines_end_where_we_end_them(capsys: pytest.CaptureFixture[str]) -> None:
    lines.say(f"ready: {EVIL}")
    lines.note(EVIL)
    common.complain(ScenarioError.of([f"{EVIL}:1: x", f"{EVIL}:2: y"]))
    common.complain(EmulatorError("a\nready: forged"))
    seen = capsys.readouterr()
    assert seen.out == f"ready: {SHOWN}\n"
    assert seen.err.split("\n") == [
        f"lidaremu: {SHOWN}",
        f"lidaremu: {SHOWN}:1: x",
        f"lidaremu: {SHOWN}:2: y",
        r"lidaremu: a\x0aready: forged",
        "",
    ]


class Broken(io.StringIO):
    """A stream that cannot be written."""

    def __init__(self, number: int) -> None:
        super().__init__()
        self.number = number

    def write(self, text: str) -> int:
        raise OSError(self.number, os.strerror(self.number))


@pytest.mark.parametrize("number", [5, 28, 32])
def test_a_log_that_nobody_can_read_stops_nothing(number: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "stderr", Broken(number))
    lines.note("x")
    common.complain(EmulatorError("x"))


def test_an_output_that_has_gone_ends_the_command_in_order(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "stdout", Broken(5))
    assert main(["list", "links"]) == 0
    sys.stdout.close()


def test_an_output_that_cannot_be_written_is_told(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "stdout", Broken(28))
    assert main(["list", "links"]) == 2
    assert "cannot write to the standard output: No space left" in capsys.readouterr().err


def test_an_output_that_is_closed_is_none(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "stdout", None)
    assert main(["list", "links"]) == 0


def test_the_guard_tames_whoever_writes_without_asking(monkeypatch: pytest.MonkeyPatch) -> None:
    behind = io.StringIO()
    streams: Any = SimpleNamespace(stdout=behind, stderr=None)
    monkeypatch.setattr(sanitizing, "sys", streams)
    sanitizing.guard()
    sanitizing.guard()
    assert isinstance(streams.stdout, Guarded)
    assert sanitizing.raw(streams.stdout) is behind
    assert streams.stderr is None
    print("a\tb\n" + EVIL, file=streams.stdout)
    streams.stdout.writelines(["\x1b[1m"])
    assert behind.getvalue() == "a\tb\n" + SHOWN.replace(r"\x0a", "\n") + "\n" + r"\x1b[1m"
    assert not streams.stdout.isatty()


# ---------------------------------------------------------------- as its user meets it


@pytest.mark.parametrize(
    ("arguments", "code"),
    [
        (["check", EVIL.replace("\udcff", "")], 2),
        (["check", "crossing_car", EVIL], 2),
        ([EVIL], 2),
        (["check", f"--{EVIL}"], 2),
        (["list", EVIL], 2),
        (["list", "faults", EVIL], 2),
        (["list", "faults", "x", EVIL], 2),
        (["check", "crossing_car", "--set", f"{EVIL}=1"], 2),
        (["check", "crossing_car", "--set", f"weather.fog={EVIL}"], 2),
        (["check", "crossing_car", "--link", EVIL], 2),
        (["check", "crossing_car", "--link", f"front={EVIL}"], 2),
        (["check", "crossing_car", "--seed", EVIL], 2),
        (["look", f"pty:/no/{EVIL}"], 3),
        (["look", "pty:/no/such", "--family", EVIL], 2),
        (["ctl", "status", "--socket", f"/no/{EVIL}"], 3),
        (["ctl", "fault", EVIL], 2),
        (["replay", f"/no/{EVIL}"], 2),
        (["diff", f"/no/{EVIL}", f"/no/{EVIL}"], 2),
        (["report", f"/no/{EVIL}"], 2),
        (["test", f"/no/{EVIL}"], 2),
        (["explain", f"/no/{EVIL}"], 2),
        (["view", EVIL, "--no-browser"], 2),
        (["view", "crossing_car", "--token", EVIL], 2),
        (["view", "crossing_car", "--allow-host", EVIL], 2),
        (["run", f"/no/{EVIL}"], 2),
    ],
)
def test_no_argument_reaches_the_terminal_raw(
    arguments: list[str], code: int, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(arguments) == code
    seen = "".join(capsys.readouterr())
    assert all(line.isprintable() for line in seen.split("\n")), seen
    assert "x1b[2J" in seen
    assert not any(line.startswith(r"\U000e0041z") for line in seen.split("\n"))


def test_a_file_of_a_hostile_name_and_content_is_told_in_one_line_a_fault(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / f"{EVIL.replace('/', '')}.yaml"
    path.write_text(
        'schema: 1\nsensors:\n  - {id: "a\\e[1mb", model: "x\\e]0;t\\a", links: ["pty:./f\\e[2J"]}\n'
        'actors: [{id: b, shape: {mesh: "a\\nb\\e.glb"}}]\n"k\\e[2J": 1\n',
        encoding="utf-8",
    )
    for arguments in (["check", str(path)], ["check", "--json", str(path)], ["test", str(tmp_path)]):
        assert main(arguments) == 2
        seen = "".join(capsys.readouterr())
        assert all(line.isprintable() for line in seen.split("\n")), seen
    assert main(["check", str(path)]) == 2
    lines = capsys.readouterr().err.rstrip("\n").split("\n")
    assert len(lines) >= 3
    assert all(line.startswith(str(tmp_path)) for line in lines)


def test_a_text_for_the_page_is_no_element_of_it() -> None:
    assert html("<img src=x onerror='a'>\x1b&\"") == r"&lt;img src=x onerror=&#x27;a&#x27;&gt;\x1b&amp;&quot;"
