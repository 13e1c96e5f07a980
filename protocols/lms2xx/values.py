"""From metres to value words: rounding, largest distances, special words, flag bits, reflectivity.

Nothing here knows a telegram. All functions take whole scans; n is the number of beams.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from protocols.scan import DAZZLED, Floats

Words = NDArray[np.uint16]

NOT_VALID, DAZZLE, OVERFLOW, LOW_SIGNAL, READ_ERROR, TOO_FAR = 0, 1, 2, 4, 5, 8
"""Special words, counted down from the value mask (8191 - 1 = 1FFE: dazzled, and so on; sicktoolbox, Robotics Library).
We send DAZZLE, and TOO_FAR for a beam without an echo or beyond the format."""

COUNTS_PER_METRE = {0: 100, 1: 1000, 2: 10}
"By configuration byte E: cm, mm, dm."
BEYOND_M = 1e5
"Farther than any format holds."


@dataclass(frozen=True)
class MeasuringMode:
    """How configuration byte D splits the 16 bits of a value."""

    name: str
    bits: int
    "Of the distance."
    reflectivity_bits: int = 0
    "Above the distance: level of a reflector, 0 none."
    dazzle_flag: int = 0
    "Set beside the special word when the beam is dazzled."
    only_reflectivity: bool = False
    raw_intensity: bool = False
    "Intensity words of F5 are raw amplitudes instead of normalised ones."
    field_flags: tuple[int, ...] = ()
    "Bits of a value in field A, B, C, as far as the mode has them."

    @property
    def mask(self) -> int:
        return (1 << self.bits) - 1

    @property
    def largest(self) -> int:
        """Largest distance count, below the special words: 8182, 16374, 32758 (Robotics Library)."""
        return self.mask - TOO_FAR - 1


MEASURING_MODES = {
    0x00: MeasuringMode("8m-fields-a-b-dazzle", 13, dazzle_flag=0x8000, field_flags=(0x2000, 0x4000)),
    0x01: MeasuringMode("8m-reflector-8", 13, reflectivity_bits=3),
    0x02: MeasuringMode("8m-fields-a-b-c", 13, field_flags=(0x2000, 0x4000, 0x8000)),
    0x03: MeasuringMode("16m-reflector-4", 14, reflectivity_bits=2),
    0x04: MeasuringMode("16m-fields-a-b", 14, field_flags=(0x4000, 0x8000)),
    0x05: MeasuringMode("32m-reflector-2", 15, reflectivity_bits=1),
    0x06: MeasuringMode("32m-field-a", 15, field_flags=(0x8000,)),
    0x0D: MeasuringMode("intensity-normalised", 13),
    0x0E: MeasuringMode("intensity-raw", 13, raw_intensity=True),
    0x0F: MeasuringMode("32m-immediate", 15),
    0x3F: MeasuringMode("reflectivity", 16, only_reflectivity=True),
}
"""By configuration byte D (sicktoolbox, GearBox, listing via Gepruft_Lidar; 0D and 0E: MIT driver, libFAIR). Names
have the range in mm. 05 has one reflectivity bit (sicktoolbox, ARIA); 0F has 16 bits, of which 15 are used."""

REFLECTOR_THRESHOLDS = {
    3: np.array([2.0, 4.0, 8.0, 16.0, 32.0, 64.0, 128.0]),
    2: np.array([2.0, 8.0, 32.0]),
    1: np.array([2.0]),
}
"""Reflectance relative to a white Lambert target from which each reflector level begins, by number of bits. No source
has SICK's values; these start at twice white, so that only retro-reflectors get a level (listing: 0, no reflector)."""

DAZZLED_REFLECTIVITY = 255


def max_range_m(mode: MeasuringMode, unit: int) -> float:
    """Farthest range that still has a distance word of its own, after rounding half up."""
    if mode.only_reflectivity:
        return math.inf
    return (mode.largest + 0.5) / COUNTS_PER_METRE[unit]


def reflectance(range_m: Floats, intensity: Floats, k_m2: float) -> Floats:
    """Reflectance of the Lambert target that would give this echo, (n,); NaN where there is none.

    `intensity` is the echo's peak over the detection threshold; a target of reflectance rho at range R reaches
    ``rho k / R^2`` times the threshold. The loss of the air is not made good. Our reading of what the device reports.
    """
    estimate: Floats = intensity * range_m * range_m / k_m2
    return estimate


def value_words(
    range_m: Floats, flags: NDArray[np.uint8], mode: MeasuringMode, unit: int, rho: Floats | None = None
) -> Words:
    """Value words of one scan, (n,).

    Distances are rounded half up to the unit, once, from the unrounded range; what has no word becomes TOO_FAR and
    never wraps. `rho`: reflectance, wanted by modes that report it.
    """
    if mode.only_reflectivity:
        return reflectivity_words(rho, flags)
    within_m = np.minimum(np.maximum(range_m, 0.0), BEYOND_M)
    counts = np.floor(within_m * COUNTS_PER_METRE[unit] + 0.5)
    far = mode.mask - TOO_FAR
    words = np.where(counts <= mode.largest, counts, far).astype(np.uint16)  # NaN compares false
    if mode.reflectivity_bits and rho is not None:
        level = np.searchsorted(REFLECTOR_THRESHOLDS[mode.reflectivity_bits], rho, side="right").astype(np.uint16)
        level[words >= far] = 0  # NaN sorts above every threshold
        words |= level << np.uint16(mode.bits)
    if flags.any():
        words[(flags & DAZZLED) != 0] = mode.mask - DAZZLE | mode.dazzle_flag
    return words


def reflectivity_words(rho: Floats | None, flags: NDArray[np.uint8]) -> Words:
    """Reflectivity in per cent of white, (n,), at most 65535; 0 without an echo, 255 when dazzled. Our scale."""
    if rho is None:
        return np.zeros(len(flags), dtype=np.uint16)
    percent = np.minimum(np.floor(np.nan_to_num(rho, nan=0.0, posinf=1e3) * 100.0 + 0.5), 65535.0).astype(np.uint16)
    percent[(flags & DAZZLED) != 0] = DAZZLED_REFLECTIVITY
    return percent


def reflectivity_bytes(rho: Floats, flags: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Reflectivity bytes of C4, (n,): per cent of white up to 254, 255 when dazzled."""
    percent = np.minimum(reflectivity_words(rho, flags), DAZZLED_REFLECTIVITY - 1).astype(np.uint8)
    percent[(flags & DAZZLED) != 0] = DAZZLED_REFLECTIVITY
    return percent


def intensity_words(intensity: Floats, rho: Floats, mode: MeasuringMode) -> Words:
    """Intensity words of F5, (n,); 0 without an echo.

    Raw (mode 0E): 7000 at the detection threshold, 1000 more with each doubling, at most 13000, the span that the MIT
    driver notes. Normalised: reflectance in thousandths of white. Both scales are chosen here; no source has SICK's.
    """
    if mode.raw_intensity:
        signal = np.maximum(np.nan_to_num(intensity, nan=0.0, posinf=64.0), 0.0)
        raw = np.minimum(np.floor(7000.0 + 1000.0 * np.log2(np.maximum(signal, 1.0)) + 0.5), 13000.0)
        return np.where(np.isnan(intensity), 0.0, raw).astype(np.uint16)
    milli = np.floor(np.nan_to_num(rho, nan=0.0, posinf=65.0) * 1000.0 + 0.5)
    return np.minimum(milli, 65535.0).astype(np.uint16)
