"""YDLIDAR's packets: samples of 2, 3 or 4 bytes, the XOR over words, angles before their correction.

Belongs here: bytes, numbers, the geometry of the slanted line of triangulation. Not: when something is sent; reading it
(`emulator.hosts.ydlidar`).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from protocols.scan import Floats

HEAD = b"\xaa\x55"
HEAD_WORD = 0x55AA
HEAD_BYTES = 10
MOST_SAMPLES = 40
"Of a packet; the maker's own lidars send up to 80, lds2d takes no more."
OFFSET_MM, CROSSING_MM = 21.8, 155.3
"The line passes so far beside the axis, and crosses the reference direction so far out (spec 3.3)."
WIDTHS = {0: 2, 8: 3, 10: 3, 16: 4}
"Bits of intensity -> bytes of a sample."
NEAR_STEPS = 0.75
"Within so many steps of the rotor a measured sample counts as seen from there."

Words = NDArray[np.int64]


def correction_deg(range_mm: Floats) -> Floats:
    """What a host adds to the angle of a triangulation scanner; infinity is allowed, 0 where there is no range."""
    with np.errstate(divide="ignore", invalid="ignore"):
        found = np.degrees(np.arctan(OFFSET_MM * (1.0 / range_mm - 1.0 / CROSSING_MM)))
    return np.where(range_mm > 0.0, found, 0.0)


FAR_DEG = float(correction_deg(np.array(np.inf)))


def seen_from(angle_deg: Floats, cast_deg: Floats, range_mm: Floats) -> NDArray[np.intp]:
    """For each angle of the rotor which of the samples, measured from the axis, its slanted line meets.

    angle_deg (n,) ascending; cast_deg (n,) directions in which range_mm (n,) were measured, NaN without an echo. Where
    two surfaces lie behind each other it meets the nearer; past the edge of a near one it sees the farther.
    """
    n = len(angle_deg)
    step = float(angle_deg[-1] - angle_deg[0]) / (n - 1) if n > 1 else 1.0
    blind = np.isnan(range_mm)
    apparent = np.where(blind, angle_deg, cast_deg - correction_deg(np.where(blind, np.inf, range_mm)))
    order = np.argsort(apparent, kind="stable")
    behind = np.searchsorted(apparent[order], angle_deg)
    right, left = order[np.minimum(behind, n - 1)], order[np.maximum(behind - 1, 0)]
    near_left = np.abs(angle_deg - apparent[left]) <= NEAR_STEPS * step
    near_right = np.abs(angle_deg - apparent[right]) <= NEAR_STEPS * step
    far = np.where(blind, np.inf, range_mm)
    takes_left = np.where(near_left == near_right, (far[left] < far[right]) == near_left, near_left)
    return np.where(takes_left, left, right)


class Rows(NamedTuple):
    """Samples as they are sent."""

    data: NDArray[np.uint8]
    "(n, 2 to 4)"
    check: NDArray[np.uint16]
    "(n,) what each adds to the checksum."


def encode_samples(range_mm: Floats, intensity: Floats, bits: int, unit_mm: float) -> Rows:
    """Distances (NaN: no return) and intensities (0 to 1 of full scale), (n,) each; `bits` of intensity."""
    packed = bits in (8, 10)  # the two lowest bits of the distance belong to something else
    step_mm = 1.0 if packed else unit_mm
    word = np.nan_to_num(np.rint(range_mm / step_mm)).astype(np.int64) * (4 if packed else 1)
    word = np.where((word < 0) | (word > 0xFFFF), 0, word)
    level = np.where(word > 0, np.rint(np.nan_to_num(intensity) * ((1 << bits) - 1)), 0).astype(np.int64)
    if bits == 10:
        word = word | level >> 8
    parts = [word & 0xFF, word >> 8]
    if bits:
        parts = [level & 0xFF, *([level >> 8] if bits == 16 else []), *parts]
    mask = 0xFF if packed else 0xFFFF
    check = word ^ (level & mask if bits else 0)
    return Rows(np.stack(parts, axis=1).astype(np.uint8), check.astype(np.uint16))


def encode_packets(first_type: int, angle_deg: Floats, rows: Rows, most: int = MOST_SAMPLES) -> list[bytes]:
    """The packets of one turn, or of a part of it: `most` samples each, the last one has what is left.

    `first_type`: CT of a zero packet, which has the first sample alone; 0: the stream begins within a turn.
    """
    q6 = np.minimum(np.rint(64.0 * angle_deg).astype(np.int64), 23_039)
    lone = 1 if first_type else 0
    whole = (len(q6) - lone) // most
    found: list[bytes] = []
    for part, size, kind in (
        (slice(0, lone), 1, first_type),
        (slice(lone, lone + whole * most), most, 0),
        (slice(lone + whole * most, len(q6)), len(q6) - lone - whole * most, 0),
    ):
        if size and len(q6[part]):
            found += _of_size(kind, q6[part].reshape(-1, size), rows.data[part], rows.check[part])
    return found


def _of_size(kind: int, q6: Words, data: NDArray[np.uint8], check: NDArray[np.uint16]) -> list[bytes]:
    count, size = q6.shape
    head = np.zeros((count, HEAD_BYTES // 2), "<u2")
    head[:, 0], head[:, 1] = HEAD_WORD, kind | size << 8
    head[:, 2], head[:, 3] = q6[:, 0] << 1 | 1, q6[:, -1] << 1 | 1
    head[:, 4] = np.bitwise_xor.reduce(head[:, :4], axis=1) ^ np.bitwise_xor.reduce(check.reshape(count, size), axis=1)
    packets = np.concatenate([head.view(np.uint8), data.reshape(count, -1)], axis=1)
    return [row.tobytes() for row in packets]
