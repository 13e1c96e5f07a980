"""Clusters shorter than half a pulse under a leading edge: crossed exactly, without a sample.

Here: which clusters of a sin^2 pulse are such, their height and place, and where they cross a level. Not here: clusters
that are spread farther, and other ways of timing (waveform, timing).

With s(x) = (1 + cos kx)/2, the sum of the pulses that are under way is ``A/2 + |C|/2 cos(k(x - r))``: A the sum of
their amplitudes a_i, C that of a_i exp(i k r_i), k r its angle. While the pulses of a short cluster begin, none has
passed its maximum, so the sum rises; running sums at the beginnings tell between which two of them a level is crossed.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from emulator.physics.arrays import Floats, Ints
from emulator.physics.detector import Detector
from emulator.physics.subechoes import SubEchoes


@dataclass(frozen=True, eq=False)
class Cosines:
    """Short clusters; c of them, s sub-echoes in all clusters of the scan."""

    beam: Ints
    "(c,)"
    centre_m: Floats
    "(c,) place of the maximum"
    height: Floats
    "(c,)"
    source: Ints
    "(c,) of the strongest sub-echo"
    first_m: Floats
    "(c,) range to which phases refer"
    start: Ints
    "(c,) index of the first sub-echo in the arrays below"
    size: Ints
    "(c,)"
    begun: Floats
    "(s,) signal at the instant at which each sub-echo's pulse begins"
    total: Floats
    "(s,) A of the pulses begun by then, its own included"
    real: Floats
    imaginary: Floats
    half_m: float
    wave_number: float

    def __len__(self) -> int:
        return len(self.beam)

    def crossing(self, level: Floats) -> Floats:
        """Where each first reaches a level > 0, its maximum where it never does. (c,) [m]"""
        if len(self) == 0:
            return np.zeros(0)
        member = np.repeat(self.start - (np.cumsum(self.size) - self.size), self.size) + np.arange(self.size.sum())
        below = self.begun[member] < np.repeat(level, self.size)
        passed = np.add.reduceat(below.astype(np.int64), np.cumsum(self.size) - self.size)
        last = self.start + np.maximum(passed, 1) - 1
        total, real, imaginary = self.total[last], self.real[last], self.imaginary[last]
        swing = np.hypot(real, imaginary)
        centre = self.first_m + np.arctan2(imaginary, real) / self.wave_number
        # the angle from the trough, which keeps its digits for a level far below the maximum
        share = (2.0 * level - total + swing) / (2.0 * swing)
        rise = 2.0 * np.arcsin(np.sqrt(np.clip(share, 0.0, 1.0)))
        return np.asarray(centre - self.half_m + rise / self.wave_number)

    @classmethod
    def none(cls) -> Cosines:
        """No cluster."""
        n, i = np.zeros(0), np.zeros(0, np.int64)
        return cls(i, n, n, i, n, i, i, n, n, n, n, 1.0, 1.0)


def split_cosines(echoes: SubEchoes, detector: Detector) -> tuple[Cosines, SubEchoes]:
    """Short clusters, and the sub-echoes of all others, without a medium between them."""
    pulse, n = detector.pulse, len(echoes)
    if n == 0 or pulse.shape != "sin2" or detector.method != "leading_edge" or echoes.spread_m is not None:
        return Cosines.none(), echoes
    half, k = pulse.half_support_m, pulse.wave_number
    beam, r, a = echoes.beam, echoes.range_m, echoes.amplitude
    cut = (beam[1:] != beam[:-1]) | (r[1:] - r[:-1] > 2.0 * half)
    start = np.concatenate(([0], np.flatnonzero(cut) + 1))
    size = np.diff(np.append(start, n))
    first, end = r[start], start + size - 1
    total = _running(a, start, size)
    short = (r[end] - first < half) & (total[end] > 0.0)
    if not bool(np.any(short)):
        return Cosines.none(), echoes
    phase = k * (r - np.repeat(first, size))
    cosine, sine = np.cos(phase), np.sin(phase)
    real, imaginary = _running(a * cosine, start, size), _running(a * sine, start, size)
    # a pulse begins half a turn of the cosine before its centre
    begun = 0.5 * (total - cosine * real - sine * imaginary)
    top = np.maximum.reduceat(a, start)
    strongest = np.flatnonzero(a == np.repeat(top, size))
    source = np.zeros(len(start), np.int64)
    owner = np.repeat(np.arange(len(start)), size)[strongest[::-1]]
    source[owner] = echoes.source[strongest[::-1]]  # the first of equals wins
    last = end[short]
    found = Cosines(
        beam[start][short],
        first[short] + np.arctan2(imaginary[last], real[last]) / k,
        0.5 * (total[last] + np.hypot(real[last], imaginary[last])),
        source[short],
        first[short],
        start[short],
        size[short],
        begun,
        total,
        real,
        imaginary,
        half,
        k,
    )
    if bool(np.all(short)):
        none = np.zeros(0, np.int64)
        return found, SubEchoes(none, np.zeros(0), np.zeros(0), np.zeros(0), none)
    rest = np.flatnonzero(np.repeat(~short, size))
    return found, SubEchoes(beam[rest], r[rest], a[rest], echoes.blocked[rest], echoes.source[rest])


def _running(values: Floats, start: Ints, size: Ints) -> Floats:
    """Running sums that begin anew in every cluster."""
    sums = np.cumsum(values)
    return np.asarray(sums - np.repeat(sums[start] - values[start], size))
