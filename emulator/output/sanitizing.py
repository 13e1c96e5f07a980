"""Output to a terminal: the one place through which every text goes, and where untrusted characters are escaped.

Names of files, bytes of wires, words of devices and keys of untrusted files come into our lines. A character that is
no letter, digit, sign or blank is shown as a text of its own (`\\x1b`, `\\u202e`): it neither moves the cursor, nor
colours, nor turns the order of letters, nor ends a line. `lines` end where we end them. A letter that the stream cannot
hold is shown the same way.

`guard` puts the same before the standard streams themselves, for whatever writes there without asking: warnings,
tracebacks, libraries. Rich draws on the streams behind it (`raw`): bars and pages are its own, their texts are tamed
before. What a driver started by `run -- COMMAND` prints goes past us: it is its user's program.
"""

from __future__ import annotations

import errno
import sys
from collections.abc import Iterable
from html import escape
from typing import Any, TextIO

from emulator.errors import EmulatorError


def visible(text: str, keep: str = "") -> str:
    """The text with everything that is no printable character shown as an escape; of these, `keep` stays as it is.

    Below U+0020 it is `\\x1b`, beyond U+007E `\\u007f`, `\\U000e0041`: within JSON they stay what JSON means by them.
    """
    if text.isprintable():
        return text
    return "".join(one if one.isprintable() or one in keep else _shown(ord(one)) for one in text)


def _shown(code: int) -> str:
    return f"\\x{code:02x}" if code < 0x20 else f"\\u{code:04x}" if code < 0x10000 else f"\\U{code:08x}"


def html(text: str) -> str:
    """The text for a place in HTML, within an element or an attribute's quotes."""
    return escape(visible(text, "\n"))


def put(stream: TextIO | None, lines: Iterable[str]) -> None:
    """Write lines, each ended by us. Raises `BrokenPipeError` when nobody reads, `EmulatorError` for all else."""
    if stream is None:  # closed by whoever started us
        return
    try:
        stream.write("".join(fitting(visible(line), stream) + "\n" for line in lines))
        stream.flush()
    except OSError as error:
        if error.errno in (errno.EPIPE, errno.EIO):  # the reader of the pipe, or the terminal, has gone
            raise BrokenPipeError("the reader has closed the pipe") from None  # with a number click would end us itself
        raise EmulatorError(f"cannot write to the standard output: {error.strerror}") from None


def fitting(text: str, stream: Any) -> str:
    """The text with what the stream's encoding does not have as escapes."""
    encoding = getattr(stream, "encoding", None) or "utf-8"
    return text if text.isascii() else text.encode(encoding, "backslashreplace").decode(encoding)


class Guarded:
    """A text stream to which nothing is written but printable characters, ends of lines and tabs."""

    def __init__(self, stream: TextIO) -> None:
        self.behind = stream

    def write(self, text: str) -> int:
        """Write a text, tamed."""
        self.behind.write(fitting(visible(text, "\n\t"), self.behind))
        return len(text)

    def writelines(self, lines: Iterable[str]) -> None:
        """Write several."""
        for line in lines:
            self.write(line)

    def __getattr__(self, name: str) -> Any:
        return getattr(self.behind, name)


def guard() -> None:
    """Put the guard before the standard streams of this process."""
    for name in ("stdout", "stderr"):
        stream = getattr(sys, name)
        if stream is not None and not isinstance(stream, Guarded):
            setattr(sys, name, Guarded(stream))


def raw(stream: TextIO) -> TextIO:
    """The stream behind the guard: for Rich alone."""
    return stream.behind if isinstance(stream, Guarded) else stream
