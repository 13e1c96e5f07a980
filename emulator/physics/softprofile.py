"""Fog, rain or dust of one scan as tables: what a medium adds to the waveform of every beam.

Here: the running integrals of a homogeneous medium's backscatter, made once for a weather and a receiver. Not here: the
closed form of one beam (softtarget) and the sum with surfaces (waveform).

With the pulse (1 + cos k(x - r))/2 around its centre, the waveform of a medium between r = x - h and x + h is
``[A]/2 + Re(exp(ikx) [B])/2`` with the running integrals A of its density g and B of g exp(-ikr). A surface at R stops
the share of the beam that it blocks: the integrals of that share end at R.
"""

from __future__ import annotations

from bisect import bisect_right
from dataclasses import dataclass
from functools import cached_property
from typing import TypeAlias

import numpy as np
from scipy import special

from emulator.physics.arrays import (
    Complexes,
    Floats,
    Ints,
    Values,
    clamped,
    exp_or_zero,
    floats,
    indexes,
    ramp,
    require_positive,
)
from emulator.physics.pulse import Pulse
from emulator.physics.radiometry import overlap

INVISIBLE = 1e-3
"Amplitude in noise units below which the medium is left out."
PIECES = 4
"Of a bin, where the waveform of a Gaussian pulse is summed from even pieces of the medium."
MARK = 1e-9
"Amplitude of the markers that make the waveform be sampled where the medium has its maximum."
FINEST_PIECE = 1.0 / 32.0
"Of a pulse's FWHM: knots are this close whatever the bins, for running integrals that turn with the pulse."
STRAIGHT_M = 1e-5
"A line between two points of the rise to the maximum is right to this, in range."
MOST_ROUNDS = 16
"Of halving what is not straight."

Flat: TypeAlias = tuple[Floats, int, float, float, Floats, Floats, Floats, Ints, float]
"A medium for compiled loops: tables with an edge, first bin, bin, wave number, ends, knots, cubics, cells, cell."
NO_MEDIUM: Flat = (
    np.zeros((2, 1)), 0, 1.0, 1.0, np.zeros(3), np.zeros(2), np.zeros((1, 12)), np.zeros(1, np.int64), 1.0
)  # fmt: skip


@dataclass(frozen=True, eq=False)
class SoftProfile:
    """Tables of one medium on the global grid of bins j * bin_m; amplitudes in noise units."""

    pulse: Pulse
    bin_m: float
    start_m: float
    "Range at which the overlap starts to rise."
    full_m: float
    end_m: float
    "Range behind which the medium adds less than `INVISIBLE`."
    peak_m: float
    "Apparent range of the largest return, counted like a surface's range (centre of the pulse)."
    peak: float
    "Largest return of a beam that nothing blocks."
    density_scale: float
    alpha: float
    upper: Floats
    "A + Re(exp(ikx) B) at the far end x + h of the pulse, by j - first."
    lower: Floats
    "The same at its near end x - h."
    free: Floats
    "Return of a beam that nothing blocks, on the same bins."
    first: int
    knots: Floats
    "Ranges at which A and B are known."
    a: Floats
    b: Complexes
    slope_a: Floats
    slope_b: Complexes
    until_m: float = float("inf")
    "Apparent range behind which it shifts no other echo."
    shows: bool = True
    "It may make an echo of its own."
    high_m: float = float("inf")
    "Apparent range behind which it is faint beside the threshold."

    @classmethod
    def of_medium(
        cls,
        pulse: Pulse,
        bin_m: float,
        scale: float,
        alpha: float,
        backscatter: float,
        start_m: float,
        full_m: float,
        max_range_m: float,
    ) -> SoftProfile | None:
        """Tables of a homogeneous medium; None when its largest return is invisible.

        Parameters
        ----------
        pulse, bin_m : pulse, and step of the sampled waveform in range. [m]
        scale : pi K of the receiver: amplitude in noise units is scale backscatter int profile ov T^2/r^2 dr. [m^2]
        alpha : total extinction of the air. [1/m]
        backscatter : sum over the media of extinction over lidar ratio. [1/(m sr)]
        start_m, full_m : overlap of beam and field of view; start > 0
        max_range_m : end of the gate
        """
        require_positive("start_m", start_m)
        density = scale * backscatter
        if density <= 0.0:
            return None
        full = max(full_m, start_m)
        half = pulse.half_support_m
        end = _end_of_sight(density, alpha, half, full, max_range_m)
        first = int(np.floor((start_m - half) / bin_m)) - 1
        last = int(np.ceil((end + half) / bin_m)) + 2
        x = bin_m * np.arange(first, last + 1, dtype=np.float64)
        fine_m = bin_m if pulse.shape != "sin2" else min(bin_m, 2.0 * FINEST_PIECE * pulse.fwhm_m)
        knots = np.unique(np.concatenate([_near(start_m, end, fine_m), [full], x + half, x - half]))
        knots = knots[(knots >= start_m) & (knots <= end)]
        knots = knots[np.diff(knots, prepend=-np.inf) > 1e-9]  # x + half and x' - half may be one but for rounding
        if knots.size < 2:
            return None
        k = pulse.wave_number
        a, b = _running(knots, density, alpha, start_m, full, k)
        turn = np.exp(1j * k * x)
        g = _density(knots, density, alpha, start_m, full)
        reach_hi = clamped(knots.searchsorted(x + half, side="right") - 1, 0, knots.size - 1)
        reach_lo = clamped(knots.searchsorted(x - half, side="right") - 1, 0, knots.size - 1)
        upper = a[reach_hi] + np.real(turn * b[reach_hi])
        lower = a[reach_lo] + np.real(turn * b[reach_lo])
        if pulse.shape == "sin2":
            wave = 0.5 * (upper - lower)
        else:
            wave = _gauss_wave(pulse, x, bin_m, knots, a, g)
        top = int(np.argmax(wave))
        if wave[top] < INVISIBLE:
            return None
        return cls(
            pulse,
            bin_m,
            start_m,
            full,
            end,
            float(x[top]),
            float(wave[top]),
            density,
            alpha,
            upper,
            lower,
            np.maximum(wave, 0.0),
            first,
            knots,
            a,
            b,
            g,
            np.asarray(g * np.exp(-1j * k * knots), np.complex128),
        )

    def wave(self, x_m: Values) -> Floats:
        """Return of a beam that nothing blocks at apparent range x, linear between the bins. [noise units]"""
        x = floats(x_m)
        return floats(np.interp(x, self.grid, self.free, left=0.0, right=0.0))

    def exact(self, x_m: Values) -> Floats:
        """The same between the bins, from the running integrals under a sin^2 pulse; linear for another one."""
        x = floats(x_m)
        if self.pulse.shape != "sin2":
            return self.wave(x)
        a, real, imaginary = self._under_pulse(x)
        turn = self.pulse.wave_number * x
        return floats(np.maximum(0.5 * (a + np.cos(turn) * real - np.sin(turn) * imaginary), 0.0))

    def _under_pulse(self, x: Floats) -> Floats:
        half = self.pulse.half_support_m
        return self.integrals(x + half) - self.integrals(x - half)

    def _phase_under_pulse(self, x: float) -> tuple[float, float]:
        """Both parts of B in `_under_pulse` of one place, to the bit, without arrays: it is asked a hundred times."""
        half = self.pulse.half_support_m
        real, imaginary = self._phase(x + half)
        real_lower, imaginary_lower = self._phase(x - half)
        return real - real_lower, imaginary - imaginary_lower

    def _phase(self, range_m: float) -> tuple[float, float]:
        knots = self._knots
        r = min(max(range_m, knots[0]), knots[-1])
        i = min(bisect_right(knots, r) - 1, len(knots) - 2)
        t = r - knots[i]
        _, constant, offset, _, linear, slope, _, square, bend, _, cube, twist = self._cubics[:, i].tolist()
        return ((cube * t + square) * t + linear) * t + constant, ((twist * t + bend) * t + slope) * t + offset

    @cached_property
    def _knots(self) -> list[float]:
        found: list[float] = self.knots.tolist()
        return found

    @cached_property
    def top(self) -> tuple[float, float]:
        """Place and height of the largest return, between the bins."""
        at = int(np.argmax(self.free))
        grid = self.grid
        if self.pulse.shape != "sin2":  # a parabola through three bins, as the maxima of samples are found
            left, middle, right = np.concatenate([np.zeros(1), self.free, np.zeros(1)])[at : at + 3].tolist()
            curve = left - 2.0 * middle + right
            shift = min(max(0.5 * (left - right) / curve, -0.5), 0.5) if curve < 0.0 else 0.0
            return float(grid[at]) + shift * self.bin_m, middle - 0.25 * (left - right) * shift
        k, low, high = self.pulse.wave_number, float(grid[at]) - self.bin_m, float(grid[at]) + self.bin_m
        for _ in range(50):  # the pulse is 0 at both ends, so only its phase has a derivative
            middle = 0.5 * (low + high)
            real, imaginary = self._phase_under_pulse(middle)
            rises = np.sin(k * middle) * real + np.cos(k * middle) * imaginary < 0.0
            low, high = (middle, high) if rises else (low, middle)
        place = 0.5 * (low + high)
        return place, float(self.exact(np.array([place]))[0])

    @cached_property
    def rise(self) -> tuple[Floats, Floats]:
        """Apparent ranges up to the largest return, and the returns there, ascending; so close that lines between them
        are right to `STRAIGHT_M`, at the foot too, where a bin holds most of the rise."""
        place, height = self.top
        foot = self.start_m - self.pulse.half_support_m
        x = np.unique(np.concatenate([[foot], self.grid[(self.grid > foot) & (self.grid < place)], [place]]))
        value = self.exact(x)
        value[-1] = height
        looked_at = np.ones(len(x) - 1, bool) if self.pulse.shape == "sin2" else np.zeros(len(x) - 1, bool)
        for _ in range(MOST_ROUNDS):
            at = indexes(looked_at & (value[1:] > max(value[0], 0.1 * INVISIBLE)))
            if not len(at):
                break
            middle = 0.5 * (x[at] + x[at + 1])
            now = self.exact(middle)
            rises = np.maximum(value[at + 1] - value[at], 1e-300)
            line = x[at] + clamped((now - value[at]) / rises, 0.0, 1.0) * (x[at + 1] - x[at])
            bent = np.abs(line - middle) > STRAIGHT_M
            looked_at[:] = False
            looked_at[at] = bent
            more = np.zeros(len(x), np.int64)
            more[at + 1] = 1
            place_of = np.arange(len(x)) + more.cumsum()
            wider, taller = np.zeros(len(x) + len(at)), np.zeros(len(x) + len(at))
            wider[place_of], taller[place_of] = x, value
            wider[place_of[at + 1] - 1], taller[place_of[at + 1] - 1] = middle, now
            again = np.zeros(len(wider) - 1, bool)
            some = indexes(looked_at)
            again[place_of[some]] = again[place_of[some] + 1] = True
            x, value, looked_at = wider, taller, again
        return x, np.maximum.accumulate(value)

    @cached_property
    def grid(self) -> Floats:
        """Apparent ranges of the bins."""
        return self.bin_m * np.arange(self.first, self.first + len(self.upper), dtype=np.float64)

    def tables(self, j: Ints) -> tuple[Floats, Floats]:
        """`upper` and `lower` at bins j; beyond the end both are the whole integrals, so that nothing is left."""
        upper, lower = self._edged.take(j - (self.first - 1), axis=1, mode="clip")
        beyond = j >= self.first + len(self.upper)
        if bool(beyond.any()):
            # a surface there stops shares whose integrals end at the table's end: they must find them here again
            turn = np.exp(1j * self.pulse.wave_number * self.bin_m * j[beyond].astype(np.float64))
            upper[beyond] = lower[beyond] = self.a[-1] + np.real(turn * self.b[-1])
        return upper, lower

    @cached_property
    def flat(self) -> Flat:
        """All of this as compiled loops want it."""
        cell, at_edge = self._cells
        ends = np.array([self.a[-1], self.b[-1].real, self.b[-1].imag])
        return (
            self._edged, self.first, self.bin_m, self.pulse.wave_number, ends, self.knots,
            np.ascontiguousarray(self._cubics.T), at_edge, cell,
        )  # fmt: skip

    @cached_property
    def _edged(self) -> Floats:
        """(2, bins + 1) `upper` and `lower` behind a bin of nothing."""
        return np.concatenate([np.zeros((2, 1)), np.array([self.upper, self.lower])], axis=1)

    def integrals(self, range_m: Floats) -> Floats:
        """(3, m) up to the ranges (m,): A and both parts of B, cubic between the knots, from values and slopes."""
        knots = self.knots
        r = clamped(floats(range_m), knots[0], knots[-1])
        # from the cell to the knot; the search of numpy takes three times as long
        cell, at_edge = self._cells
        i = at_edge.take(((r - knots[0]) * (1.0 / cell)).astype(np.int64), mode="clip")
        passed = knots.take(i + 1) <= r
        while bool(passed.any()):
            i += passed
            np.minimum(i, knots.size - 2, out=i)
            passed = (knots.take(i + 1) <= r) & (i < knots.size - 2)
        t = r - knots.take(i)
        constant, linear, square, cube = self._cubics.take(i, axis=1).reshape(4, 3, -1)
        cube *= t
        cube += square
        cube *= t
        cube += linear
        cube *= t
        cube += constant
        return floats(cube)

    @cached_property
    def _cells(self) -> tuple[float, Ints]:
        """Width of cells, and of each the last knot before its begin but one step of rounding."""
        cell = 0.5 * self.bin_m
        edges = self.knots[0] + cell * np.arange(int((self.knots[-1] - self.knots[0]) / cell) + 1)
        at = self.knots.searchsorted(edges * (1.0 - 1e-12), side="right") - 1
        return cell, clamped(at, 0, self.knots.size - 2)

    @cached_property
    def _cubics(self) -> Floats:
        """(12, knots - 1) coefficients of the distance from the knot before: of A and both parts of B, by order."""
        each = (
            _cubic(self.knots, self.a, self.slope_a),
            _cubic(self.knots, self.b.real, self.slope_b.real),
            _cubic(self.knots, self.b.imag, self.slope_b.imag),
        )
        return np.array([column for order in zip(*each, strict=True) for column in order])

    def nodes(self) -> tuple[Floats, Floats]:
        """The medium as point scatterers: ranges and amplitudes, a fifth of the pulse's FWHM apart or closer."""
        edges = np.linspace(self.start_m, self.end_m, 2 + int(5.0 * (self.end_m - self.start_m) / self.pulse.fwhm_m))
        near = self.start_m * 1.25 ** np.arange(24)
        edges = np.unique(np.concatenate([edges, near[near < self.end_m]]))
        a = self.integrals(edges)[0]
        return np.sqrt(edges[1:] * edges[:-1]), np.maximum(np.diff(a), 0.0)  # the mean place under 1/r^2


def _density(r: Floats, scale: float, alpha: float, start: float, full: float) -> Floats:
    return scale * overlap(r, start, full) / (r * r) * exp_or_zero(-2.0 * alpha * r)


def _end_of_sight(density: float, alpha: float, half: float, full: float, max_range_m: float) -> float:
    """Range where the medium becomes invisible, between full overlap and the end of the gate."""
    lo, hi = full, max(max_range_m, full)
    for _ in range(50):
        mid = 0.5 * (lo + hi)
        visible = np.log(density * half / INVISIBLE) - 2.0 * alpha * mid - 2.0 * np.log(mid) > 0.0
        lo, hi = (mid, hi) if visible else (lo, mid)
    return hi


def _running(
    knots: Floats, density: float, alpha: float, start: float, full: float, k: float
) -> tuple[Floats, Complexes]:
    """Running integrals of the density, and of the density times exp(-ikr), by Gauss nodes between two knots.

    Six of them; three between knots a fiftieth of the range and a fifth of a radian apart at most: to 1e-11.
    """
    step = np.diff(knots)
    steep = (step > 0.02 * knots[:-1]) | (max(k, 2.0 * alpha) * step > 0.2)
    # the overlap has a corner at `full`, which is a knot
    steep |= (knots[:-1] < full) & (step > 0.02 * (knots[:-1] - start))
    a, b = np.zeros(knots.size), np.zeros(knots.size, np.complex128)
    for nodes, pieces in ((6, indexes(steep)), (3, indexes(~steep))):
        t, weight = special.roots_legendre(nodes)
        for begin in range(0, pieces.size, 65536):  # keeps the nodes in the cache
            at = pieces[begin : begin + 65536]
            half = 0.5 * step[at]
            for place, share in zip(t + 1.0, weight, strict=True):
                r = knots[at] + half * place
                g = _density(r, density, alpha, start, full) * half * share
                a[at + 1] += g
                b[at + 1] += g * np.exp(-1j * k * r)
    return a.cumsum(), b.cumsum()


def _cubic(knots: Floats, value: Floats, slope: Floats) -> tuple[Floats, Floats, Floats, Floats]:
    """Coefficients (knots - 1,) of the distance from the knot before, of the cubic with these values and slopes."""
    step = np.diff(knots)
    chord = np.diff(value) / step
    bend = slope[:-1] + slope[1:] - 2.0 * chord
    return value[:-1], slope[:-1], (chord - slope[:-1] - bend) / step, bend / (step * step)


def _near(start: float, end: float, bin_m: float) -> Floats:
    """Ranges from the start to behind the end: each a twentieth farther than the one before, half a bin at the most."""
    near = [start]
    while near[-1] < end and 0.05 * near[-1] < 0.5 * bin_m:
        near.append(1.05 * near[-1])
    rest = np.arange(1.0, max(np.ceil((end - near[-1]) / (0.5 * bin_m)), 0.0) + 1.0)
    return np.concatenate([near, near[-1] + 0.5 * bin_m * rest])


def _gauss_wave(pulse: Pulse, x: Floats, bin_m: float, knots: Floats, a: Floats, slope: Floats) -> Floats:
    """Medium under the Gaussian pulse at the ranges x, a bin apart."""
    if 0.5 * bin_m <= 0.05 * knots[0]:  # knots are nowhere much closer than half a bin
        return _even_wave(pulse, x, bin_m, knots, a, slope)
    middle, piece = 0.5 * (knots[1:] + knots[:-1]), np.diff(a)
    wave = np.zeros(x.shape)
    reach = pulse.half_support_m
    for start in range(0, x.size, 4096):  # keeps the table of pairs small; only pieces under the pulse are paired
        part = x[start : start + 4096]
        low = middle.searchsorted(part - reach)
        count = middle.searchsorted(part + reach, side="right") - low
        owner, at = np.arange(part.size).repeat(count), low.repeat(count) + ramp(count)
        wave[start : start + 4096] = np.bincount(owner, pulse.profile(part[owner] - middle[at]) * piece[at], part.size)
    return wave


def _even_wave(pulse: Pulse, x: Floats, bin_m: float, knots: Floats, a: Floats, slope: Floats) -> Floats:
    """The same of even pieces, each in its middle: the pulse at a piece is one number for all x."""
    reach = int(np.ceil(pulse.half_support_m / bin_m))
    edges = x[0] + bin_m / PIECES * np.arange(-PIECES * reach, PIECES * (x.size + reach) + 1, dtype=np.float64)
    r = clamped(edges, knots[0], knots[-1])
    i = clamped(knots.searchsorted(r, side="right") - 1, 0, knots.size - 2)
    constant, linear, square, cube = (column.take(i) for column in _cubic(knots, a, slope))
    t = r - knots.take(i)
    piece = np.diff(constant + t * (linear + t * (square + t * cube)))
    wave = np.zeros(x.shape)
    for phase in range(PIECES):
        at = bin_m * (np.arange(2 * reach, dtype=np.float64) - reach + (phase + 0.5) / PIECES)
        wave += np.correlate(floats(piece[phase::PIECES]), pulse.profile(at), mode="valid")[: x.size]
    return wave
