"""An RPLIDAR's bytes as a host reads them: replies, groups of samples by form, whole turns; damage is counted.

Belongs here: taking apart. Not: what a host asks (rplidar).
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from emulator.hosts.scans import HostScan
from protocols.rplidar import codec
from protocols.rplidar.codec import FORMS, Floats, Form
from protocols.skeleton.descriptors import DESCRIPTOR, MULTIPLE, REPLY_SYNC, SYNC

LONGEST = 1 << 16
"Of a reply."
MOST_HELD = 200_000
"Samples of a turn; more is a motor that stands."


@dataclass(frozen=True)
class Reply:
    """One reply of one piece."""

    kind: int
    data: bytes


@dataclass(frozen=True, eq=False)
class Turn:
    """The samples of one turn, in their order."""

    angle_deg: Floats
    mm: Floats
    "0: no return."

    def scan(self, number: int) -> HostScan:
        """As viewers take it, ordered to the left."""
        azimuth = math.pi - np.radians(self.angle_deg + 180.0) % (2.0 * math.pi)
        order = np.argsort(azimuth, kind="stable")
        found = np.where(self.mm > 0.0, self.mm / 1000.0, np.nan)
        return HostScan(number, azimuth[order], found[order], f"{len(order)} samples")


def _words(rows: codec.Bytes, first: int, end: int) -> codec.Words:
    return np.ascontiguousarray(rows[:, first:end]).view("<u2").astype(np.int64)


def distances(form: Form, rows: codec.Bytes, further: codec.Bytes) -> Floats:
    """(c, samples) in mm of whole groups (c, size); `further`: the group behind the last one, (1, size)."""
    count = len(rows)
    if form.kind == codec.EXPRESS:
        cabins = np.ascontiguousarray(rows[:, 4:84].reshape(-1, 5)[:, :4]).view("<u2")
        return (cabins >> 2).astype(np.float64).reshape(count, 32)
    if form.kind == codec.DENSE:
        return _words(rows, 4, 84).astype(np.float64)
    if form.kind == codec.ULTRA_DENSE:
        part = rows[:, 10:170].reshape(-1, 5)
        low = np.ascontiguousarray(part[:, :4]).view("<u2").astype(np.int64)
        value = low | np.stack([part[:, 4] & 0x0F, part[:, 4] >> 4], axis=1).astype(np.int64) << 16
        known = [start + (value >> 2 & (1 << bits) - 1) * step for start, step, _, bits, _ in codec.SCALES]
        return np.choose(value & 3, known).astype(np.float64).reshape(count, 64)
    every = np.concatenate([rows, further])
    word = np.ascontiguousarray(every[:, 4:132]).view("<u4").astype(np.int64).ravel()
    word = word[: 32 * count + 1]
    base, level = codec.distance_of(word & 0xFFF)
    this, nxt, word = slice(None, -1), slice(1, None), word[:-1]
    lacks = (base[this] == 0) & (base[nxt] > 0)
    found = [base[this]]
    for shift, b, by in (
        (12, np.where(lacks, base[nxt], base[this]), np.where(lacks, level[nxt], level[this])),
        (22, base[nxt], level[nxt]),
    ):
        guess = (word >> shift & 0x3FF ^ 0x200) - 0x200
        found.append(np.where((guess == codec.NONE_OF_ULTRA) | (guess == 511), 0, b + guess * (1 << by)))
    return np.stack(found, axis=1).astype(np.float64).reshape(count, 96)


class Reader:
    """Replies and turns out of bytes in any chunking."""

    def __init__(self) -> None:
        self._held = b""
        self._form: Form | None = None
        self._before: codec.Bytes | None = None
        "The last capsule: its angles are known with the next one."
        self._turn: list[tuple[Floats, Floats]] = []
        self._entire = False
        "Samples since the first begin of a turn: what came before is not a whole one."
        self.errors = 0
        "Groups or bytes that were not what they should be."

    def feed(self, data: bytes) -> Iterator[Reply | Turn]:
        """What is whole by now."""
        self._held += data
        while self._form is None:
            at = self._held.find(REPLY_SYNC)
            if at < 0:
                self._held = self._held[-1:]
                return
            head = self._held[at : at + DESCRIPTOR]
            if len(head) < DESCRIPTOR:
                return
            word, kind = int.from_bytes(head[2:6], "little"), head[6]
            size = word & (MULTIPLE - 1)
            if word & MULTIPLE and kind in FORMS and size == FORMS[kind].size:
                self._form, self._held = FORMS[kind], self._held[at + DESCRIPTOR :]
            elif size > LONGEST:
                self.errors, self._held = self.errors + 1, self._held[at + 2 :]
            elif len(self._held) < at + DESCRIPTOR + size:
                return
            else:
                whole = self._held[at + DESCRIPTOR : at + DESCRIPTOR + size]
                self._held = self._held[at + DESCRIPTOR + size :]
                yield Reply(kind, whole)
        for angle, mm in self._groups(self._form):
            yield from self._take(angle, mm)

    def feed_nodes(self, data: bytes) -> Iterator[tuple[Floats, Floats]]:
        """Angles and distances of standard nodes without a descriptor; nothing if they are none."""
        rows = np.frombuffer(data, np.uint8).reshape(-1, 5)
        if len(rows) and self._good(FORMS[codec.STANDARD], rows).all():
            yield from self._samples(FORMS[codec.STANDARD], rows)

    def _groups(self, form: Form) -> Iterator[tuple[Floats, Floats]]:
        while len(self._held) >= form.size:
            count = len(self._held) // form.size
            rows = np.frombuffer(self._held, np.uint8, count * form.size).reshape(count, form.size)
            good = self._good(form, rows)
            run = count if good.all() else int(good.argmin())
            if run:
                yield from self._samples(form, rows[:run])
                self._held = self._held[run * form.size :]
            if run < count:  # a byte more or less on the way: the next group is looked for
                self.errors += 1
                self._held, self._before = self._held[1:], None

    def _good(self, form: Form, rows: codec.Bytes) -> np.ndarray:
        if form.kind == codec.STANDARD:
            return np.asarray(((rows[:, 0] ^ rows[:, 0] >> 1) & 1 == 1) & (rows[:, 1] & 1 == 1))
        if form.kind == codec.HQ:
            return np.asarray(rows[:, 0] == SYNC)
        total = np.bitwise_xor.reduce(rows[:, 2:], axis=1)
        return np.asarray((rows[:, 0] == 0xA0 | total & 0x0F) & (rows[:, 1] == 0x50 | total >> 4))

    def _samples(self, form: Form, rows: codec.Bytes) -> Iterator[tuple[Floats, Floats]]:
        if form.kind == codec.STANDARD:
            word = _words(rows, 1, 5)
            yield (word[:, 0] >> 1) / 64.0, word[:, 1] / 4.0
            return
        if form.kind == codec.HQ:
            node = np.ascontiguousarray(rows[:, 9:777]).reshape(-1).view(codec.HQ_NODE)
            yield node["angle"] * (90.0 / 16384.0), node["quarter"] / 4.0
            return
        if self._before is not None:
            rows = np.concatenate([self._before, rows])
        self._before = rows[-1:].copy()
        if len(rows) < 2:
            return
        place = 8 if form.kind == codec.ULTRA_DENSE else 2
        start = (_words(rows, place, place + 2)[:, 0] & 0x7FFF) / 64.0
        swept = np.diff(start) % 360.0
        mm = distances(form, rows[:-1], rows[-1:])
        angle = start[:-1, None] + np.arange(form.samples) * (swept / form.samples)[:, None]
        if form.turned:
            angle = angle - codec.line_of_sight_deg(mm)
        yield angle.ravel() % 360.0, mm.ravel()

    def _take(self, angle: Floats, mm: Floats) -> Iterator[Turn]:
        last = self._turn[-1][0][-1] if self._turn else angle[0]
        cuts = np.flatnonzero(np.diff(angle, prepend=last) < -180.0)
        for cut in (*cuts.tolist(), len(angle)):
            begin = 0 if not len(cuts) or cut == cuts[0] else int(cuts[np.searchsorted(cuts, cut) - 1])
            if cut > begin:
                self._turn.append((angle[begin:cut], mm[begin:cut]))
            if cut < len(angle) and self._turn:
                if self._entire:
                    yield Turn(*(np.concatenate(column) for column in zip(*self._turn, strict=True)))
                self._turn, self._entire = [], True
        if sum(len(part) for part, _ in self._turn) > MOST_HELD:
            self._turn = []
