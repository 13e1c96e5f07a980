"""OBJ files: vertices, faces and the part each face belongs to.

Belongs here: the text format, as far as shapes and names go. Not: other formats and axes (mesh_files), checks of the
triangles (triangles). trimesh is not used for these: it drops the names of groups, and of materials whose library is
missing, and does not keep the order of the file.

The text is read in pieces of some megabytes, the numbers of each with numpy arrays. What a piece has that arrays
cannot read,
a word that is no number for one, is looked for line by line, to be reported by its number.
"""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np
from numpy.typing import NDArray

from emulator.config.budgets import MESH, MOST_DIGITS, MOST_FLOAT_CHARACTERS, MeshBudget, TooMuch, raised

PIECE = 4_000_000
"Bytes read at a time; about twenty times as much is needed for it."
MOST_LINE = 1_000_000
"Bytes of one line: a face of a hundred thousand corners."
NEWLINE, HASH, SLASH, SPACE = b"\n#/ "

Ints = NDArray[np.int64]


def load_obj(
    text: bytes, name: str, budget: MeshBudget = MESH
) -> tuple[NDArray[np.float64], Ints, NDArray[np.int32], tuple[str, ...]]:
    """Vertices (v, 3), triangles (f, 3), part of each triangle, names of the parts in the order of the file.

    A part is a material (`usemtl`) when the file names any, else an object (`o`) or group (`g`), else `name`. Polygons
    become fans. `ValueError` names the line of what cannot be read, `TooMuch` what is beyond the budget.
    """
    if b"\r" in text:
        text = text.replace(b"\r\n", b"\n").replace(b"\r", b"\n")
    if b"\\\n" in text:
        text = text.replace(b"\\\n", b" ")
    reader = _Reader(name, budget)
    at = 0
    while at < len(text):
        end = text.find(b"\n", min(at + PIECE, len(text))) + 1 or len(text)
        reader.take(text[at:end])
        at = end
    return reader.result()


class _Reader:
    """Takes pieces of whole lines, one after the other."""

    def __init__(self, name: str, budget: MeshBudget) -> None:
        self._name, self._budget = name, budget
        self._line = 0
        self._vertices = self._triangles = 0
        self._points: list[NDArray[np.float64]] = [np.zeros((0, 3))]
        self._faces: list[Ints] = [np.zeros((0, 3), np.int64)]
        self._states: list[NDArray[np.int32]] = [np.zeros(0, np.int32)]
        self._known: dict[tuple[str, str], int] = {("", name): 0}
        self._state = ("", name)

    def take(self, piece: bytes) -> None:
        """Vertices, faces and names of some whole lines."""
        data = np.frombuffer(piece if piece.endswith(b"\n") else piece + b"\n", np.uint8)
        ends = np.flatnonzero(data == NEWLINE)
        starts = np.concatenate([[0], ends[:-1] + 1])
        if (ends - starts).max() > MOST_LINE:
            line, found = int(np.argmax(ends - starts)), int((ends - starts).max())
            raise TooMuch(f"line {self._line + line + 1}: of {found} bytes; want at most {MOST_LINE}")
        blank = _BLANK[data]
        hidden = _after(data == HASH, starts, ends)
        words = ~(blank | hidden)
        begins = words.copy()
        begins[1:] &= ~words[:-1]
        first = np.flatnonzero(begins)
        line_of = np.searchsorted(ends, first)
        counts = np.bincount(line_of, minlength=len(ends))
        leads = np.zeros(len(ends), np.int64)  # of each line, where its first word begins
        leads[line_of[::-1]] = first[::-1]
        one = np.concatenate([blank[1:], [True]]) | np.concatenate([hidden[1:], [True]])
        kind = np.where((counts > 0) & one[leads], data[leads], 0)
        vertex, face = kind == ord("v"), kind == ord("f")
        self._need("vertices", self._vertices + int(vertex.sum()), vertex, np.ones(len(ends), np.int64))
        self._need("triangles", self._triangles + int((counts[face] - 3).clip(0).sum()), face, counts - 3)
        self._refuse_long(np.flatnonzero(words[:-1] & ~words[1:]) - first, line_of, vertex | face)
        before = self._vertices + np.cumsum(vertex) - vertex
        try:
            points = _points(_text_of(data, words, vertex, starts, ends), counts[vertex] - 1)
            text = _text_of(data, words & ~_in_word(data, words, begins), face, starts, ends)
            corners = _corners(text, int((counts[face] - 1).sum()))
            faces = _fans(corners, counts[face] - 1, before[face])
        except (ValueError, OverflowError):
            self._explain(piece, before)
            raise
        self._points.append(points)
        self._faces.append(faces)
        self._states.append(np.repeat(self._name_states(piece, data, kind, counts, leads, starts, ends)[face],
                                      (counts[face] - 3).clip(0)))  # fmt: skip
        self._vertices += len(points)
        self._triangles += len(faces)
        self._line += len(ends)

    def _need(self, name: str, found: int, chosen: NDArray[np.bool_], each: Ints) -> None:
        """`TooMuch` with the line that passes the limit."""
        most = getattr(self._budget, name)
        if found > most:
            before = self._vertices if name == "vertices" else self._triangles
            total = before + np.cumsum(np.where(chosen, each.clip(0), 0))
            line = self._line + int(np.argmax(total > most)) + 1
            raise TooMuch(f"line {line}: more than {most} {name} {raised(name)}")

    def _refuse_long(self, length: Ints, line_of: Ints, chosen: NDArray[np.bool_]) -> None:
        far = np.flatnonzero((length >= MOST_FLOAT_CHARACTERS) & chosen[line_of])
        if len(far):
            line, found = self._line + int(line_of[far[0]]) + 1, int(length[far[0]]) + 1
            raise TooMuch(f"line {line}: a number of {found} characters; want at most {MOST_FLOAT_CHARACTERS}")

    def _name_states(
        self, piece: bytes, data: NDArray[np.uint8], kind: Ints, counts: Ints, leads: Ints, starts: Ints, ends: Ints
    ) -> NDArray[np.int32]:
        """Of each line, which pair of material and group holds there."""
        named = (kind == ord("o")) | (kind == ord("g"))
        long = np.flatnonzero((counts > 0) & ~named & (data[leads] == ord("u")))
        lines = np.union1d(np.flatnonzero(named), long)
        states = np.full(len(starts), -1, np.int32)
        states[0] = self._known.setdefault(self._state, len(self._known))
        for number in lines:
            words = piece[starts[number] : ends[number]].split(b"#", 1)[0].split()
            rest = b" ".join(words[1:]).decode("utf-8", "replace")
            material, thing = self._state
            if words[0] == b"usemtl":
                self._state = (rest, thing)
            elif words[0] in (b"o", b"g"):
                self._state = (material, rest or self._name)
            else:
                continue
            states[number] = self._known.setdefault(self._state, len(self._known))
            if len(self._known) > self._budget.items:
                raise TooMuch(f"line {self._line + number + 1}: more than {self._budget.items} names of parts")
        last = np.maximum.accumulate(np.where(states >= 0, np.arange(len(states)), 0))
        held: NDArray[np.int32] = states[last]
        return held

    def _explain(self, piece: bytes, before: Ints) -> None:
        """`ValueError` with the line that cannot be read."""
        for number, line in enumerate(piece.split(b"\n")):
            words = line.split(b"#", 1)[0].split()
            try:
                if words[:1] == [b"v"]:
                    if len(words) < 4:
                        raise ValueError("a vertex of fewer than three numbers")
                    [float(word) for word in words[1:4]]
                elif words[:1] == [b"f"]:
                    if len(words) < 4:
                        raise ValueError("a face of fewer than three corners")
                    for word in words[1:]:
                        _index(word, int(before[number]))
            except ValueError as error:
                shown = line.strip().decode("utf-8", "replace")[:60]
                reason = " ".join(str(error).split())[:100]
                raise ValueError(f"line {self._line + number + 1}: {shown!r}: {reason}") from None

    def result(self) -> tuple[NDArray[np.float64], Ints, NDArray[np.int32], tuple[str, ...]]:
        """All of it."""
        states = np.concatenate(self._states)
        pairs = list(self._known)
        used, begins = np.unique(states, return_index=True)
        used = used[np.argsort(begins)]
        by_material = any(pairs[state][0] for state in used)
        order: dict[str, int] = {}
        numbers = np.zeros(len(pairs), np.int32)
        for state in used:
            name = (pairs[state][0] if by_material else pairs[state][1]) or self._name
            numbers[state] = order.setdefault(name, len(order))
        return np.concatenate(self._points), np.concatenate(self._faces), numbers[states], tuple(order)


_BLANK = np.zeros(256, bool)
_BLANK[list(b" \t\n\r\v\f")] = True


def _after(marks: NDArray[np.bool_], starts: Ints, ends: Ints) -> NDArray[np.bool_]:
    """Which bytes stand at or behind a mark of their own line."""
    if not marks.any():
        return marks
    seen = np.cumsum(marks, dtype=np.int32)
    before = np.where(starts > 0, seen[starts - 1], 0)
    found: NDArray[np.bool_] = seen > np.repeat(before, ends - starts + 1)
    return found


def _in_word(data: NDArray[np.uint8], words: NDArray[np.bool_], begins: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Which bytes stand at or behind a slash of their own word."""
    marks: NDArray[np.bool_] = words & (data == SLASH)
    if not marks.any():
        return marks
    seen = np.cumsum(marks, dtype=np.int32)
    before = np.maximum.accumulate(np.where(begins, seen - marks, 0))
    found: NDArray[np.bool_] = words & (seen > before)
    return found


def _text_of(
    data: NDArray[np.uint8], words: NDArray[np.bool_], chosen: NDArray[np.bool_], starts: Ints, ends: Ints
) -> bytes:
    """The words of the chosen lines, the letter that begins each line left out."""
    kept = np.repeat(chosen, ends - starts + 1)
    letters = np.flatnonzero(kept & words)
    text = np.where(words, data, np.uint8(SPACE))
    if len(letters):
        text[letters[np.searchsorted(letters, starts[chosen])]] = SPACE
    return text[kept].tobytes()


def _points(text: bytes, counts: Ints) -> NDArray[np.float64]:
    """The first three numbers of each line of which `counts` says how many words it has."""
    if not len(counts):
        return np.zeros((0, 3))
    if counts.min() < 3:
        raise ValueError("a vertex of fewer than three numbers")
    wanted = (np.cumsum(counts) - counts)[:, None] + np.arange(3)
    found = _numbers(text, np.float64, int(counts.sum()))
    if found is None:
        words = text.split()  # what else stands there, weights and colours, need not be numbers
        return np.array([float(words[number]) for number in wanted.ravel().tolist()]).reshape(-1, 3)
    return np.asarray(found[wanted], np.float64)


def _corners(text: bytes, count: int) -> Ints:
    found = _numbers(text, np.int64, count)
    return np.array([int(word) for word in text.split()], np.int64) if found is None else found.astype(np.int64)


def _numbers(text: bytes, kind: type, count: int) -> NDArray[Any] | None:
    """`count` numbers by numpy's reader, a third of the time of Python's; None where it stumbles."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        try:
            found: NDArray[Any] = np.fromstring(text, kind, sep=" ")
        except (DeprecationWarning, ValueError):
            return None
    at_end = kind is np.int64 and len(found) and np.abs(found).max() >= 1 << 60  # it stops at the largest it has
    return None if at_end or len(found) != count else found


def _fans(corners: Ints, counts: Ints, before: Ints) -> Ints:
    """Triangles (f, 3) of polygons of `counts` corners each, of which `before` vertices stand in front."""
    if not len(counts):
        return np.zeros((0, 3), np.int64)
    if counts.min() < 3:
        raise ValueError("a face of fewer than three corners")
    index = np.where(corners > 0, corners - 1, np.repeat(before, counts) + corners)
    if (corners == 0).any() or (index < 0).any():
        raise ValueError("no such vertex")
    if (counts == 3).all():
        return index.reshape(-1, 3)
    each = counts - 2
    first = np.repeat(np.cumsum(counts) - counts, each)
    step = np.arange(len(first)) - np.repeat(np.cumsum(each) - each, each) + 1
    return np.column_stack([index[first], index[first + step], index[first + step + 1]])


def _index(word: bytes, count: int) -> int:
    """Vertex of a corner like `7`, `7/1`, `7//2`, `-1` (the last so far), from 0."""
    digits = word.split(b"/", 1)[0]
    if len(digits) > MOST_DIGITS:
        raise TooMuch(f"a number of {len(digits)} digits; want at most {MOST_DIGITS}")
    number = int(digits)
    index = number - 1 if number > 0 else count + number
    if number == 0 or index < 0:
        raise ValueError(f"no vertex {number}")
    if index >= 1 << 62:
        raise ValueError("no such vertex")
    return index
