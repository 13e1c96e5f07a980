"""Limits for untrusted files: bytes, triangles, nodes, memory, seconds. The only place with such numbers.

Belongs here: the limits, how a user raises those of meshes, and opening a file that is a plain file. Not: the reading
(mesh_files, recording), and the process that holds memory and time (reading_apart).

A scenario cannot raise a limit, for an untrusted party may have written it as well; the environment of whoever runs
it can:

    LIDAREMU_MESH_LIMITS=triangles=5e7,memory_bytes=3e10,cpu_s=900 lidaremu run town.yaml
"""

from __future__ import annotations

import errno
import json
import os
import stat
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

from emulator.errors import SceneError

MESH_LIMITS = "LIDAREMU_MESH_LIMITS"
"Environment variable: `name=number`, several joined by commas."
MOST_LIMIT = 1e15
"Of a number in that variable."


class TooMuch(ValueError):
    """A limit was passed; the text names what was found and what is allowed."""


@dataclass(frozen=True)
class MeshBudget:
    """What one mesh file may ask for; every number is judged before anything of its size is made."""

    bytes: int = 1_000_000_000
    "Of the file and of what it points to."
    text_bytes: int = 200_000_000
    "Of a format that is text: OBJ, and PLY and STL in their readable form."
    json_bytes: int = 64_000_000
    "Of the JSON of a glTF, pictures and buffers within it included."
    json_values: int = 2_000_000
    "Of the same, counted by what separates values: each takes some hundred bytes when it is read."
    items: int = 100_000
    "Nodes, meshes, accessors or buffers of a glTF, of each; primitives in all; parts of a mesh."
    draws: int = 300_000
    "Primitives of a glTF that its nodes draw, in all."
    vertices: int = 30_000_000
    "After every node has drawn its mesh, as is said of triangles."
    triangles: int = 10_000_000
    "After every node has drawn its mesh: a short file may draw a large mesh often."
    pixels: int = 70_000_000
    "Of all pictures of a glTF, where a material asks for them: four of 4096 x 4096."
    memory_bytes: int = 5_000_000_000
    "Of the process that reads, above what it began with: 1e7 triangles that share no vertex need nine tenths of it."
    cpu_s: int = 120
    "Of the process that reads, for one file: 1e7 triangles need about a minute."

    def need(self, name: str, found: int, what: str) -> None:
        """`TooMuch` when `found` is beyond the limit of that name; `what` is counted."""
        most = getattr(self, name)
        if found > most:
            raise TooMuch(f"{found} {what}; want at most {most} {raised(name)}")


def raised(name: str) -> str:
    """How a user of a file of his own allows it more."""
    return f"({MESH_LIMITS}={name}=N allows more)"


MESH = MeshBudget()


def mesh_budget(environment: Mapping[str, str] | None = None) -> MeshBudget:
    """The limits of mesh files, those that the environment names raised or lowered; `SceneError` for what is none."""
    text = (os.environ if environment is None else environment).get(MESH_LIMITS, "")
    known = [one.name for one in fields(MeshBudget)]
    found: dict[str, int] = {}
    for part in filter(None, (part.strip() for part in text.split(","))):
        name, _, number = (word.strip() for word in part.partition("="))
        try:
            value = float(number)
        except ValueError:
            value = 0.0
        if name not in known or not 1.0 <= value <= MOST_LIMIT:
            shown = part if len(part) <= 60 else part[:57] + "..."
            want = f"NAME=NUMBER, joined by commas, of {', '.join(known)}, numbers from 1 to {MOST_LIMIT:g}"
            raise SceneError(f"{MESH_LIMITS}: {shown!r}; want {want}")
        found[name] = int(value)
    return replace(MESH, **found)


# ---------------------------------------------------------------- recordings


@dataclass(frozen=True)
class RecordingBudget:
    """What one recording may ask for."""

    bytes: int = 1 << 30
    "Of the file: all of it is kept in memory."
    records: int = 4_000_000
    "Of an MCAP file: what is made of them takes about 300 bytes each."
    record_bytes: int = 1 << 28
    "Of one record."
    unpacked_bytes: int = 1 << 26
    "Of one chunk or container when unpacked; tools write some MB at a time."


RECORDING = RecordingBudget()

# ---------------------------------------------------------------- texts


@dataclass(frozen=True)
class TextBudget:
    """What a scenario or a sensor's spec may ask for."""

    bytes: int = 4_000_000
    "Of the file; 10 000 actors written out need about 1.5 MB."
    values: int = 400_000
    "As written, and after aliases are followed."
    separators: int = 500_000
    "What separates values: the text alone shows it, long before the values could be counted."
    depth: int = 32
    "A scenario needs about 8."


TEXT = TextBudget()
MOST_DIGITS = 40
"Of a whole number, wherever a text has one: float64 holds it, and nothing here counts as far."
MOST_FLOAT_CHARACTERS = 400
"Of any other number: the largest that float64 holds, written out, has 309 digits."


def loads_json(text: str | bytes) -> Any:
    """JSON whose numbers are as long as numbers are; `ValueError` for others, and for what is no JSON or too deep."""
    try:
        return json.loads(text, parse_int=_whole, parse_float=_other)
    except RecursionError:
        raise ValueError("JSON that is nested too deep") from None


def _whole(digits: str) -> int:
    if len(digits) > MOST_DIGITS:
        raise TooMuch(f"a number of {len(digits)} digits; want at most {MOST_DIGITS}")
    return int(digits)


def _other(text: str) -> float:
    if len(text) > MOST_FLOAT_CHARACTERS:
        raise TooMuch(f"a number of {len(text)} characters; want at most {MOST_FLOAT_CHARACTERS}")
    return float(text)


# ---------------------------------------------------------------- files


class PlainFile:
    """A regular file, opened once: what is judged is what is read, and a pipe or device keeps nobody waiting.

    Raises `OSError` where nothing can be opened and `TooMuch` for what is not a regular file.
    """

    def __init__(self, path: Path) -> None:
        try:
            self._number = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
        except ValueError:  # a byte 0 within the name
            raise FileNotFoundError(errno.ENOENT, os.strerror(errno.ENOENT)) from None
        found = os.fstat(self._number)
        if not stat.S_ISREG(found.st_mode):
            os.close(self._number)
            if stat.S_ISDIR(found.st_mode):
                raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR))
            raise TooMuch("not a regular file; want one")
        self.size = found.st_size
        "Bytes when it was opened; what is written later is not read."

    def __enter__(self) -> PlainFile:
        return self

    def __exit__(self, *_: object) -> None:
        os.close(self._number)

    def read(self, start: int = 0, count: int | None = None) -> bytes:
        """`count` bytes from `start`, or as many as there were; `OSError` when the file has become shorter."""
        wanted = self.size - start if count is None else min(count, self.size - start)
        parts = []
        while wanted > 0:
            part = os.pread(self._number, min(wanted, 1 << 26), start)
            if not part:
                raise OSError("became shorter while it was read")
            parts.append(part)
            start, wanted = start + len(part), wanted - len(part)
        return parts[0] if len(parts) == 1 else b"".join(parts)
