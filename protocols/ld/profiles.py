"""Measured profiles: what each bit of the format adds, and a revolution's values as the words of one telegram.

Sources: sicktoolbox `SickLD::_parseScanProfile`, which cites the vendor's listing p. 32; Fawkes, Miro, COMTEST.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntFlag

import numpy as np
from numpy.typing import NDArray

from protocols.ld.sectors import TICKS, Span
from protocols.ld.telegrams import GET_PROFILE_REPLY
from protocols.scan import Floats

Words = NDArray[np.uint16]


class Field(IntFlag):
    """Bits of PROFILEFORMAT, in the order in which their fields are sent."""

    PROFILESENT = 0x0001
    PROFILECOUNT = 0x0002
    LAYERNUM = 0x0004
    SECTORNUM = 0x0008
    DIRSTEP = 0x0010
    POINTNUM = 0x0020
    TSTART = 0x0040
    STARTDIR = 0x0080
    DISTANCE = 0x0100
    DIRECTION = 0x0200
    ECHO = 0x0400
    TEND = 0x0800
    ENDDIR = 0x1000
    SENSTAT = 0x2000


ALL_FIELDS = 0x3FFF

ONE_LAYER = 0x0100
"High byte of PROFILEINFO (UPS p. 32); hosts read the sectors in the low one."

RANGE_LSB_PER_M = 256
LARGEST_WIRE_M = 65535 / 256

ECHO_UNITS = 16.0
"""Amplitude word of an echo whose peak is just at the detection threshold; the word grows in proportion to the received
peak power. Calibration is ours: no source gives the device's unit, only that more is stronger."""

SICKTOOLBOX_BYTES = 5816
"sicktoolbox copies a payload into a buffer of this size without a check; a longer profile destroys its memory."


def distance_words(range_m: Floats, largest_m: float = LARGEST_WIRE_M) -> Words:
    """Ranges as words of 1/256 m, rounded half up; 0 where there is no echo, or one beyond `largest_m`.

    0 is the device's own word for no echo (UPS p. 32).
    """
    scaled = range_m * RANGE_LSB_PER_M + 0.5
    reported = (scaled >= 1.0) & (scaled < 65536.0) & (range_m <= largest_m)
    return np.where(reported, scaled, 0.0).astype(np.uint16)


def echo_words(intensity: Floats, distances: Words) -> Words:
    """Amplitudes (peak over detection threshold) as words, at least 1 and at most 65535 for an echo, 0 for none."""
    scaled = np.minimum(intensity * ECHO_UNITS + 0.5, 65535.0)
    heard = (distances > 0) & (scaled == scaled)
    return np.where(heard, np.fmax(scaled, 1.0), 0.0).astype(np.uint16)


@dataclass(frozen=True, eq=False)
class Layout:
    """Where each value of a profile of one format and geometry goes, with all constant words in place."""

    template: Words
    sent: int | None
    count: int | None
    starts: tuple[int, ...]
    "Word of TSTART of each sector; empty when not in the format."
    ends: tuple[int, ...]
    status: int | None
    points: tuple[tuple[int, int, int], ...]
    "For each measuring sector: first word, one behind the last, points."
    columns: int
    "Words a point."
    distance: int | None
    "Column of the distance among a point's words."
    echo: int | None

    @property
    def size(self) -> int:
        """Bytes of the payload."""
        return 2 * len(self.template)


def _put(kind: Field, form: int, value: int, words: list[int]) -> int | None:
    """Append a field's word when the format has it; its place."""
    if not form & kind:
        return None
    words.append(value)
    return len(words) - 1


def layout(form: int, sectors: Sequence[Span], step: int) -> Layout:
    """The layout of `form` (0..3FFF) for these sectors at this angle step."""
    words = [GET_PROFILE_REPLY, form, ONE_LAYER | len(sectors)]
    sent = _put(Field.PROFILESENT, form, 0, words)
    count = _put(Field.PROFILECOUNT, form, 0, words)
    _put(Field.LAYERNUM, form, 0, words)
    kinds = [kind for kind in (Field.DISTANCE, Field.DIRECTION, Field.ECHO) if form & kind]
    starts: list[int] = []
    ends: list[int] = []
    places = []
    for span in sectors:
        _put(Field.SECTORNUM, form, span.number, words)
        _put(Field.DIRSTEP, form, step, words)
        _put(Field.POINTNUM, form, span.points, words)
        start = _put(Field.TSTART, form, 0, words)
        _put(Field.STARTDIR, form, span.start, words)
        if span.points and kinds:
            block = np.zeros((span.points, len(kinds)), np.int64)
            if Field.DIRECTION in kinds:
                block[:, kinds.index(Field.DIRECTION)] = (span.start + step * np.arange(span.points)) % TICKS
            places.append((len(words), len(words) + block.size, span.points))
            words.extend(block.ravel().tolist())
        end = _put(Field.TEND, form, 0, words)
        _put(Field.ENDDIR, form, span.stop, words)
        starts += [] if start is None else [start]
        ends += [] if end is None else [end]
    status = _put(Field.SENSTAT, form, 0, words)
    _put(Field.SENSTAT, form, 0, words)
    columns = {kind: index for index, kind in enumerate(kinds)}
    return Layout(
        template=np.array(words, ">u2"),
        sent=sent,
        count=count,
        starts=tuple(starts),
        ends=tuple(ends),
        status=status,
        points=tuple(places),
        columns=len(kinds),
        distance=columns.get(Field.DISTANCE),
        echo=columns.get(Field.ECHO),
    )


@dataclass(frozen=True, eq=False)
class Revolution:
    """The values of the telegram of one revolution, beside its layout."""

    count: int
    "PROFILECOUNT, already cut to 16 bits."
    distances: Words
    "(n,) all measured directions of all sectors, in order."
    echoes: Words | None
    "(n,); None when no format asked for them."
    start_ms: Sequence[int]
    "Clock at the first direction of each sector."
    end_ms: Sequence[int]
    status: tuple[int, int]


def encode_profile(form: Layout, sent: int, revolution: Revolution) -> bytes:
    """The payload of one profile."""
    words = form.template.copy()
    if form.sent is not None:
        words[form.sent] = sent & 0xFFFF
    if form.count is not None:
        words[form.count] = revolution.count
    for place, value in zip(form.starts, revolution.start_ms, strict=False):
        words[place] = value
    for place, value in zip(form.ends, revolution.end_ms, strict=False):
        words[place] = value
    if form.status is not None:
        words[form.status : form.status + 2] = revolution.status
    first = 0
    for begin, end, points in form.points:
        block = words[begin:end].reshape(points, form.columns)
        if form.distance is not None:
            block[:, form.distance] = revolution.distances[first : first + points]
        if form.echo is not None and revolution.echoes is not None:
            block[:, form.echo] = revolution.echoes[first : first + points]
        first += points
    return words.tobytes()
