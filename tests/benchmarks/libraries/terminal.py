"""A terminal: foreign characters tamed, and single keys without Enter. Screen and colours are rich's already."""

from __future__ import annotations

import functools
import os
import pty
import sys
import time
import tty
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from emulator.looking import screen
from emulator.output import sanitizing
from tests.benchmarks.libraries.measure import Row, added, bounded, import_cost, lines, per_s, version_of

FOREIGN = [chr(code) for code in range(0x110000) if not chr(code).isprintable() and not 0xD800 <= code <= 0xDFFF]
"Whatever is no letter, digit, sign or blank: control, format, private, unassigned, and line separators."
TURNING = "\u2028\u2029\u200e\u200f\u061c\u202a\u202b\u202c\u202d\u202e\u2066\u2067\u2068\u2069"
MOVING = [one for one in FOREIGN if ord(one) < 0x20 or 0x7F <= ord(one) < 0xA0 or one in TURNING]
"Of these: what moves the cursor, colours, ends a line or turns the order of letters."


def by_rich(text: str) -> str:
    from rich.control import escape_control_codes

    return escape_control_codes(text)


def by_prompt_toolkit(text: str) -> str:
    from prompt_toolkit.layout.screen import Char

    return "".join(Char.display_mappings.get(one, one) for one in text)


def by_blessed(text: str) -> str:
    import blessed

    return str(_terminal(blessed).strip_seqs(text))


@functools.cache
def _terminal(blessed: Any) -> Any:
    return blessed.Terminal(kind="xterm-256color", force_styling=True)


def by_textual(text: str) -> str:
    from textual.content import Content

    return Content(text).plain


TAMERS: dict[str, Callable[[str], str]] = {
    "rich": by_rich, "prompt_toolkit": by_prompt_toolkit, "blessed": by_blessed, "textual": by_textual,
}  # fmt: skip
Read = Callable[[], str]


@contextmanager
def keys_ours() -> Iterator[Read]:
    with screen.single_keys() as keys:
        yield keys.read


@contextmanager
def keys_by_blessed() -> Iterator[Read]:
    from blessed import Terminal

    terminal = Terminal(kind="xterm-256color", force_styling=True)
    with terminal.cbreak():
        yield lambda: str(terminal.inkey(timeout=0))


@contextmanager
def keys_by_prompt_toolkit() -> Iterator[Read]:
    from prompt_toolkit.input import create_input

    source = create_input()
    with source.raw_mode():
        yield lambda: "".join(press.data for press in source.read_keys())


READERS = {"ours": keys_ours, "blessed": keys_by_blessed, "prompt_toolkit": keys_by_prompt_toolkit}
MODULES = {"rich": "rich.control", "blessed": "blessed", "prompt_toolkit": "prompt_toolkit", "textual": "textual.app"}


def on_a_terminal(name: str, what: str) -> str:
    """For `bounded`: keys read, after a terminal's end, or how often a second none is there."""
    master, slave = pty.openpty()
    ours = os.dup(1)
    for number in (0, 1):
        os.dup2(slave, number)
    sys.stdin = os.fdopen(0, closefd=False)
    tty.setcbreak(slave)
    if what != "start":
        os.environ["BLESSED_QUERY_TIMEOUT_SECONDS"] = "0.1"  # it asks the terminal what it can, twice
    found, began = "nothing read", time.perf_counter()
    try:
        with READERS[name]() as read:
            if what == "start":
                return f"{time.perf_counter() - began:.1f} s"
            if what == "keys":
                os.write(master, "q\x1b[Aä".encode() + b"\xff+")
            if what == "rate":
                return f"{1e6 / per_s(read):.1f} us"
            if what == "gone":
                os.close(master)
            found = repr("".join(read() for _ in range(20)))
    except Exception as error:
        found += f", {type(error).__name__}: {error}"
    finally:
        os.dup2(ours, 1)
    return found


def _keys(name: str) -> dict[str, str]:
    call = "tests.benchmarks.libraries.terminal:on_a_terminal"
    return {
        label: bounded(f"{call}({name!r}, {what!r})").removeprefix("answers ")
        for label, what in (
            ("start, a terminal that is mute", "start"),
            ("keys q, up, ä, 0xff, +", "keys"),
            ("a look for keys", "rate"),
            ("terminal gone", "gone"),
        )
    }


def _tamed(tame: Callable[[str], str]) -> dict[str, str]:
    left = set(tame(" ".join(FOREIGN))) & set(FOREIGN)
    found = {"foreign characters tamed": f"{len(FOREIGN) - len(left)} of {len(FOREIGN)}"}
    return found | {"of them that move or turn": f"{len(set(MOVING) - left)} of {len(MOVING)}"}


def rows() -> list[Row]:
    """Ours, then every library."""
    taming = lines(sanitizing.visible, sanitizing._shown, sanitizing.fitting)
    keys = lines(screen.Keys, screen.single_keys)
    ours = {"lines to replace": f"{taming} of taming, {keys} of keys"} | _tamed(sanitizing.visible) | _keys("ours")
    found = [Row("ours", ours)]
    for name, tame in TAMERS.items():
        version = version_of(name)
        if version is None:
            found.append(Row(name))
            continue
        cost = {"install": added(name), "import": import_cost(MODULES[name], "import emulator.looking.look")}
        found.append(Row(f"{name} {version}", cost | _tamed(tame) | (_keys(name) if name in READERS else {})))
    return found
