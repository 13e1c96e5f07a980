"""The configuration blocks of commands 74, 77, 7B and 7C: where their bytes lie, how they start, what is refused.

Bytes that no effect is known of are stored and returned as the host wrote them.
"""

from __future__ import annotations

from protocols.lms2xx.values import MEASURING_MODES

BLANKING = 0
STOP_THRESHOLD = 2
SENSITIVITY = 3
"Peak threshold on LMS200/220."
AVAILABILITY = 4
MEASURING_MODE = 5
UNIT = 6
SUBTRACTIVE = 8
MULTIPLE_EVALUATION = 9
RESTART_MODE = 10
RESTART_TIME = 11

INDICES = 0x02
"Bit of AVAILABILITY: value telegrams end in the real-time scan index and the telegram index."

HIGHEST_LEVEL, DAZZLE_IGNORED = 0x01, 0x04
"Bits of AVAILABILITY."

DEFAULT = bytes.fromhex(
    "0000 4600 00 00 00 00 00 02 02 02 00"  # A, B, C, D, E, F, G, H, I, J, K
    "000A0A5064 000A0A5064 000A0A5064"  # contours A, B, C
    "00 00 0000 0200"  # A1, A2, A3, A4
)
"Factory block of the outdoor models, 34 bytes (listing, p. 31 and 96-101)."


def default_block(indoor: bool) -> bytes:
    """As delivered: LMS200 and LMS220 count in mm, the others in cm (listing, p. 31)."""
    return DEFAULT[:UNIT] + bytes((MILLIMETRE if indoor else CENTIMETRE,)) + DEFAULT[UNIT + 1 :]


CENTIMETRE, MILLIMETRE, DECIMETRE = 0, 1, 2
UNITS = {"cm": CENTIMETRE, "mm": MILLIMETRE, "dm": DECIMETRE}
"Byte E. dm is reserved in the listing of 2006; Player, ARIA and CARMEN have it."

SENSITIVITY_RANGE_M = {0: 30.0, 1: 25.0, 2: 20.0, 3: 42.0}
"Range at 10 % reflectivity of standard, medium, low, high (sicktoolbox, GearBox)."
SENSITIVITIES = {"standard": 0, "medium": 1, "low": 2, "high": 3}


def write(block: bytes, data: bytes, has_sensitivity: bool) -> bytes | None:
    """The block after a write: the front is replaced, the rest kept, surplus ignored; None when the device refuses.

    Hosts send 7 (Player), 32 (CARMEN, ARIA), 33 (Robotics Library) or 34 bytes (sicktoolbox, MRPT, GearBox).
    """
    new = data[: len(block)] + block[len(data) :]
    if new[MEASURING_MODE] not in MEASURING_MODES or new[UNIT] not in UNITS.values():
        return None
    if has_sensitivity and new[SENSITIVITY] not in SENSITIVITY_RANGE_M:
        return None
    return new


def receiver_gain(block: bytes, has_sensitivity: bool) -> float:
    """Sensitivity against the standard setting: received power at equal signal goes with the square of the range."""
    if not has_sensitivity:
        return 1.0
    reach_m = SENSITIVITY_RANGE_M[block[SENSITIVITY]]
    return (reach_m / SENSITIVITY_RANGE_M[0]) ** 2


# --- block 2 (7B, 7C) ---

SECOND_BYTES = 84
SECOND_DEFAULT = bytes(SECOND_BYTES)
ON_PLANE, PITCHES, SET_2_OFFSET, POLLUTION_OUTPUT = 0, slice(1, 4), 4, 5
STEEPEST_DEG = 90
EVALUATIONS = range(1, 126)


def signed(byte: int) -> int:
    """A byte as a number of -128..127."""
    return byte - 256 if byte > 127 else byte


def write_second(second: bytes, data: bytes, first: bytes, indoor: bool) -> bytes | None:
    """Block 2 after a write, its front replaced; None when the device refuses (listing 7.51).

    Refused are pitches beyond 90 deg, an offset that takes the evaluations of set 2 out of 1..125, and on LMS200 and
    LMS220 any contour on a plane and any pitch. Reserved bytes are stored.
    """
    new = data[:SECOND_BYTES] + second[len(data) :]
    pitches = [abs(signed(byte)) for byte in new[PITCHES]]
    if max(pitches) > STEEPEST_DEG or new[POLLUTION_OUTPUT] > 2:
        return None
    if indoor and (new[ON_PLANE] & 1 or any(pitches)):
        return None
    return new if first[MULTIPLE_EVALUATION] + signed(new[SET_2_OFFSET]) in EVALUATIONS else None
