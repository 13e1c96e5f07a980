"""Readings of the beams of a sweep in two passes: those that need no more than short clusters, and those that are left.

Belongs here: what these passes are given, and what they give. Not: the passes (compiled.receiving, .remaining).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from types import ModuleType

import numpy as np
from numpy.typing import NDArray

from emulator.compiled.pair import OTHERWISE, by_loops
from emulator.physics import candidates, timing
from emulator.physics.arrays import Bools, Floats, Ints
from emulator.physics.constants import SPEED_OF_LIGHT_M_S
from emulator.physics.cosines import (
    EXACT_M,
    FAINT,
    LEAST,
    MOST_PASSES,
    NEAR_TOP,
    SHIFT,
    SHORT,
    SLIGHT,
    TALL,
    VALLEY_PASSES,
)  # fmt: skip
from emulator.physics.detection import SIGMAS
from emulator.physics.detector import Detector
from emulator.physics.random_streams import Normals
from emulator.physics.softprofile import MARK, STRAIGHT_M, SoftProfile
from emulator.physics.subechoes import SubEchoes

NO_WORDS = np.zeros((0, 0), np.uint64)
NO_FLAGS = np.zeros(0, np.bool_)
NO_TABLE = np.zeros(1)
CLOSER = np.array(candidates.CLOSER)
NO_MEDIUM = (
    np.zeros((2, 1)), 0, 1.0, 1.0, np.zeros(3), np.zeros(2), np.zeros((1, 12)), np.zeros(1, np.int64), 1.0,
)  # fmt: skip
KEEPS = {"first": 0, "all": 0, "strongest": 1, "last": 2}
"See `compiled.receiving`."
NoiseEchoes = tuple[Ints, Floats, Floats]
"Beams, ascending, ranges and amplitudes."
Look = Callable[[], SubEchoes]
NO_ALARMS: NoiseEchoes = np.zeros(0, np.int64), np.zeros(0), np.zeros(0)


@dataclass(frozen=True, eq=False)
class Readings:
    """What n beams report."""

    range_m: Floats
    "(n, k)"
    intensity: Floats
    actor: NDArray[np.int32]
    flags: NDArray[np.uint8]
    "(n,)"

    def replaced(self, beams: Bools, other: Readings) -> Readings:
        """With what `other` has of some beams (n,)."""
        rows = beams[:, None]
        return Readings(
            np.where(rows, other.range_m, self.range_m),
            np.where(rows, other.intensity, self.intensity),
            np.where(rows, other.actor, self.actor),
            np.where(beams, other.flags, self.flags),
        )


def _readings_by_loops(
    loops: ModuleType, look: Look, beams: int, detector: Detector, soft: SoftProfile | None, rms: Floats | None,
    dazzled: Bools | None, normals: Normals | None, spreads: Normals | None,
    noise_echoes: NoiseEchoes | None, systematic_m: float, noise_m: float, without: Bools | None = None,
) -> Readings | None:  # fmt: skip
    """On a leading edge of sin^2 pulses that follows the noise."""
    pulse = detector.pulse
    if not detector.closed_form or detector.sampled or not detector.follows_noise:
        return OTHERWISE
    until_m = alone_m = -np.inf
    own_m = own = peak_m = 0.0
    peak, stands, behind_m, closes = -np.inf, np.inf, -np.inf, True
    free, medium, rise = NO_TABLE, NO_MEDIUM, (NO_TABLE, NO_TABLE)
    hazy = [0.0, -np.inf, 0.0, 0.0, 0.0]
    if soft is not None:
        closes, behind_m = soft.peak < detector.full_scale, soft.peak_m + 2.0 * soft.bin_m
        free, medium, until_m, peak_m = soft.free, soft.flat, soft.until_m, soft.peak_m
        if soft.shows:
            alone_m, peak, (own_m, own), rise = behind_m, soft.peak, soft.top, soft.rise
            stands = peak
        hazy = [float(soft.shows), soft.high_m, soft.end_m, min(soft.start_m, peak_m), peak_m]
    found = look()
    law = np.array([
        SHORT * pulse.half_support_m, pulse.half_support_m, pulse.wave_number, detector.threshold, detector.full_scale,
        detector.shot_factor, detector.floor_m2, pulse.fwhm_m, detector.walk_table, detector.offset_m,
        detector.near_gate_m, detector.far_gate_m, systematic_m, noise_m, SHIFT * detector.resolution_m,
        0.0 if normals is None else SIGMAS, LEAST, FAINT, SLIGHT, until_m, alone_m, peak_m, peak, own_m, own, EXACT_M,
        NEAR_TOP, MOST_PASSES, 0.5 * SPEED_OF_LIGHT_M_S * detector.recovery_s,
        TALL, behind_m, stands, VALLEY_PASSES,
    ])  # fmt: skip
    given = (
        NO_FLAGS if dazzled is None else dazzled, np.ones(1) if rms is None else rms,
        NO_WORDS if normals is None else normals.words, NO_WORDS if spreads is None else spreads.words,
        detector.max_echoes, *(NO_ALARMS if noise_echoes is None else noise_echoes), free, rise[1], rise[0],
        KEEPS[detector.keep], law,
    )  # fmt: skip
    left = np.full(beams, not closes) if without is None or not closes else without.copy()
    range_m, intensity, actor, flags = loops.received(
        found.beam, found.range_m, found.amplitude, found.source, left, *given, found.blocked, *medium
    )
    if without is not None:
        left &= ~without
    if bool(left.any()):
        more = np.array([
            *hazy, detector.bin_m, detector.resolution_m, closes, candidates.FAINT, timing.EXACT_M,
            timing.MOST_STEPS, STRAIGHT_M, timing.GOLDEN, timing.VALLEY_STEPS, MARK,
        ])  # fmt: skip
        loops.remaining(
            found.beam, found.range_m, found.amplitude, found.source, found.blocked, left, *given, more, CLOSER,
            soft is not None, *medium, range_m, intensity, actor, flags,
        )  # fmt: skip
    return Readings(range_m, intensity, actor, flags)


@by_loops(_readings_by_loops, "received", "remaining")
def readings(
    look: Look, beams: int, detector: Detector, soft: SoftProfile | None, rms: Floats | None,
    dazzled: Bools | None, normals: Normals | None, spreads: Normals | None,
    noise_echoes: NoiseEchoes | None, systematic_m: float, noise_m: float, without: Bools | None = None,
) -> Readings | None:  # fmt: skip
    """What the beams report; None, as with arrays: it is to be found step by step.

    `look` : what is looked at, without spreads, asked for once if at all; `rms` : (n,) noise over the nominal one;
    `normals`, `spreads` : (n, .) numbers for the noise at echoes and of ranges; None: none; `noise_echoes` : false
    alarms; `systematic_m`, `noise_m` : what ranges are off by, and the deviation of `spreads`; `without` : (n,) beams
    that are left out, and report nothing.
    """
    return None
