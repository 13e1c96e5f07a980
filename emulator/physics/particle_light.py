"""The light of single drops and flakes in a beam with a profile: which of them are to be drawn, where, how bright.

Here: the law of particles in one beam (`s` is the effective size: that of a particle on the axis which sends back as
much), its tables over range, drawing from it, the mean light of those too small to be drawn, the light that they keep
from what stands behind. Not here: size spectra (precipitation), particles as places in the world (world_particles).

A particle of diameter D at range r and distance rho from the axis of a Gaussian beam sends back

    g K kappa D^2 ov(r) exp(-2 alpha r) / (w^2 r^2) exp(-2 rho^2 / w^2),    g = 2,  w = theta r + w0,

so s = D exp(-rho^2/w^2), and pi w^2 G(s)/s particles per metre and unit of s, G(s) being the number per m^3 larger than
s. Top-hat: g = 1, s = D inside of the radius. Elliptical beams: w^2 is the product of both radii. Sizes in mm.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import special

from emulator.physics import radiometry
from emulator.physics.arrays import Floats, exp_or_zero, floats
from emulator.physics.hidden import Hidden
from emulator.physics.precipitation import LARGEST_DROP_MM, Spectrum
from emulator.physics.pulse import Pulse

NODES = 1024
"Of the tables over range and over size: integrals and inverses to 1e-5."
NONE_PER_M = 1e-100
"Fewer drawn particles per metre are none: sums of such numbers would underflow."
SMALLEST_MM = 1e-4
"Effective sizes below are not distinguished."
MOST_SHADOW = 0.99
"Share of a beam that one particle stops at the most."
MOST_LIFT = 0.9
"Share of the level that the mean light of the small ones is let take over."


@dataclass(frozen=True)
class Sizes:
    """How many particles per m^3 are larger than a size: of an exponential spectrum, or all of one size."""

    number_m3: float
    slope_mm: float
    "Of the spectrum; 0: all have the largest size."
    largest_mm: float
    "Larger ones count as this one."
    kappa_sr: float

    @classmethod
    def of_spectrum(cls, spectrum: Spectrum) -> Sizes:
        """Those of a spectrum, up to the largest drop that does not break up."""
        return cls(spectrum.density_m3_mm / spectrum.slope_mm, spectrum.slope_mm, LARGEST_DROP_MM, spectrum.kappa_sr)

    def larger(self, size_mm: Floats) -> Floats:
        """Particles per m^3 larger than that."""
        return np.where(size_mm < self.largest_mm, self.number_m3 * exp_or_zero(-self.slope_mm * size_mm), 0.0)

    def gauss_above(self, size_mm: Floats) -> Floats:
        """int_s^largest G(t)/t dt. [1/m^3]"""
        s = np.clip(size_mm, SMALLEST_MM, self.largest_mm)
        if self.slope_mm == 0.0:
            return np.asarray(self.number_m3 * np.log(self.largest_mm / s))
        with np.errstate(under="ignore"):  # none so large
            top = float(special.exp1(self.slope_mm * self.largest_mm))
            return np.asarray(self.number_m3 * np.maximum(special.exp1(self.slope_mm * s) - top, 0.0))

    def squares_below(self, size_mm: Floats, gaussian: bool) -> Floats:
        """Sum of s^2 of the effective sizes below a size, per m^3 of pi w^2 dr. [mm^2/m^3]"""
        s, a = np.minimum(size_mm, self.largest_mm), self.slope_mm
        whole = size_mm >= self.largest_mm
        if a == 0.0:
            square = 0.5 * s * s if gaussian else np.where(whole, s * s, 0.0)
            return np.asarray(self.number_m3 * square)
        if gaussian:
            return np.asarray(self.number_m3 * special.gammainc(2.0, a * s) / a**2)
        cut = np.where(whole, exp_or_zero(-a * s) * s * s, 0.0)
        return np.asarray(self.number_m3 * (2.0 * special.gammainc(3.0, a * s) / a**2 + cut))


@dataclass(frozen=True)
class Optics:
    """What a sensor's beam and receiver make of a particle."""

    gaussian: bool
    tan_x: float
    tan_y: float
    exit_radius_m: float
    k_m2: float
    "Amplitude of a white plate at 1 m, gains included."
    overlap_start_m: float
    overlap_full_m: float
    threshold: float
    floor_m2: float
    end_m: float
    "Of the gate."
    pulse: Pulse
    hidden: Hidden | None = None
    "What a medium's own return hides."

    def area_m2(self, range_m: Floats) -> Floats:
        """Product of the two radii of the beam."""
        return (self.tan_x * range_m + self.exit_radius_m) * (self.tan_y * range_m + self.exit_radius_m)

    def level(self, range_m: Floats) -> Floats:
        """Amplitude that an echo from there must reach."""
        level = np.maximum(self.threshold, self.floor_m2 / np.maximum(range_m, 1e-3) ** 2)
        return level if self.hidden is None else np.maximum(level, self.hidden.level(range_m))

    @property
    def peak(self) -> float:
        """g: intensity on the axis over the mean one inside of the radius."""
        return 2.0 if self.gaussian else 1.0


@dataclass(frozen=True, eq=False)
class ParticleLight:
    """The law of the particles in one beam of a sensor, in one state of the air."""

    sizes: Sizes
    optics: Optics
    extinction_per_m: float
    share: float
    "Of the level: what sends back less is not drawn, it enters as its mean."

    def unit(self, range_m: Floats) -> Floats:
        """Amplitude of a particle of 1 mm on the axis."""
        optics = self.optics
        r = np.maximum(range_m, 1e-6)
        seen = radiometry.overlap(r, optics.overlap_start_m, optics.overlap_full_m) * exp_or_zero(
            -2.0 * self.extinction_per_m * r
        )
        area = np.maximum(optics.area_m2(r), 1e-300)
        return np.asarray(1e-6 * optics.peak * optics.k_m2 * self.sizes.kappa_sr * seen / (area * r * r))

    def least_mm(self, range_m: Floats) -> Floats:
        """Effective size from which a particle there is drawn."""
        with np.errstate(divide="ignore", over="ignore"):
            return np.asarray(np.sqrt(self.share * self.optics.level(range_m) / self.unit(range_m)))

    def density(self, range_m: Floats) -> Floats:
        """Mean number of drawn particles per metre of a beam."""
        least = self.least_mm(range_m)
        number = self.sizes.gauss_above(least) if self.optics.gaussian else self.sizes.larger(least)
        with np.errstate(under="ignore"):
            rate = math.pi * self.optics.area_m2(range_m) * number
        return np.where((least < self.sizes.largest_mm) & (rate > NONE_PER_M), rate, 0.0)

    @cached_property
    def end_m(self) -> float:
        """Range beyond which none is drawn, however large; the start of the overlap where there is none at all."""
        start, far = self.optics.overlap_start_m, max(self.optics.end_m, self.optics.overlap_start_m)
        if far <= start:
            return start
        r = start + np.geomspace(1e-6 * (far - start), far - start, 4 * NODES)
        seen = np.flatnonzero(self.least_mm(r) < self.sizes.largest_mm)
        return float(r[min(seen[-1] + 1, len(r) - 1)]) if len(seen) else start

    @cached_property
    def least_table(self) -> tuple[Floats, float, float]:
        """A little below `least_mm` in equal steps of range, where they begin, how long they are."""
        start = self.optics.overlap_start_m
        step = max(self.end_m - start, 1e-9) / (4 * NODES)
        least = self.least_mm(floats(start + step * np.arange(4 * NODES + 1, dtype=np.float64)))
        return 0.98 * np.minimum(least[1:], least[:-1]), start, step

    def reach(self, largest_mm: float) -> tuple[Floats, Floats]:
        """Ranges, and how far from the axis a particle of this size is still drawn there; empty: nowhere."""
        if largest_mm not in self._reaches:
            self._reaches[largest_mm] = self._reach(largest_mm)
        return self._reaches[largest_mm]

    @cached_property
    def _reaches(self) -> dict[float, tuple[Floats, Floats]]:
        return {}

    def _reach(self, largest_mm: float) -> tuple[Floats, Floats]:
        start, length = self.optics.overlap_start_m, self.end_m - self.optics.overlap_start_m
        if length <= 0.0:
            return np.zeros(0), np.zeros(0)
        r = floats(start + np.concatenate([[0.0], np.geomspace(1e-3 * length, length, NODES // 4)]))
        ratio = largest_mm / self.least_mm(r)
        seen = np.flatnonzero(ratio > 1.0)
        if not len(seen):
            return np.zeros(0), np.zeros(0)
        part = slice(max(seen[0] - 1, 0), seen[-1] + 2)
        wide = np.maximum(self.optics.tan_x * r, self.optics.tan_y * r) + self.optics.exit_radius_m
        if self.optics.gaussian:
            wide = wide * np.sqrt(np.log(np.maximum(ratio, 1.0)))
        return r[part], wide[part]

    @cached_property
    def _table(self) -> tuple[Floats, Floats]:
        """Ranges, and mean numbers drawn up to them."""
        start, length = self.optics.overlap_start_m, self.end_m - self.optics.overlap_start_m
        if length <= 0.0:
            return np.array([start, start + 1e-9]), np.zeros(2)
        r = start + np.concatenate([[0.0], np.geomspace(1e-4 * length, length, NODES)])
        rate = self.density(r)
        rate[0] = 0.0 if self.optics.overlap_full_m > start else rate[1]
        return r, np.concatenate([[0.0], np.cumsum(0.5 * (rate[1:] + rate[:-1]) * np.diff(r))])

    def mean(self, far_m: Floats) -> Floats:
        """Mean number drawn in a beam that a surface ends at `far_m`."""
        return np.interp(far_m, *self._table)

    def ranges(self, far_m: Floats, uniform: Floats) -> Floats:
        """Where they are, by uniform numbers."""
        r, number = self._table
        return np.interp(uniform * self.mean(far_m), number, r)

    def drawn_sizes(self, range_m: Floats, uniform: Floats) -> Floats:
        """Their effective sizes, by uniform numbers. [mm]"""
        least = np.minimum(self.least_mm(range_m), self.sizes.largest_mm)
        if not self.optics.gaussian:
            if self.sizes.slope_mm == 0.0:
                return np.full(len(least), self.sizes.largest_mm)
            return np.minimum(least - np.log(uniform) / self.sizes.slope_mm, self.sizes.largest_mm)
        log_size, above = self._sizes
        wanted = uniform * self.sizes.gauss_above(least)
        found = np.exp(np.interp(wanted, above, log_size))
        return np.asarray(np.clip(found, least, self.sizes.largest_mm))

    @cached_property
    def _sizes(self) -> tuple[Floats, Floats]:
        """Logarithms of sizes, falling, and `gauss_above` of them."""
        s = np.geomspace(self.sizes.largest_mm, SMALLEST_MM, 4 * NODES)
        return np.log(s), self.sizes.gauss_above(s)

    def rest_density(self, range_m: Floats) -> Floats:
        """Mean amplitude of those that are not drawn, per metre of range."""
        squares = self.sizes.squares_below(self.least_mm(range_m), self.optics.gaussian)
        return math.pi * self.optics.area_m2(range_m) * squares * self.unit(range_m)

    @cached_property
    def _rest(self) -> tuple[Floats, Floats]:
        """Ranges, and the mean signal of those that are not drawn, peak of the pulse there."""
        pulse, start = self.optics.pulse, self.optics.overlap_start_m
        x = start + np.concatenate([[0.0], np.geomspace(1e-3, max(self.end_m - start, 1.0), NODES // 4)])
        node, weight = np.polynomial.legendre.leggauss(48)
        half = pulse.half_support_m
        low = np.maximum(x - half, start)
        around = low[:, None] + 0.5 * (node + 1.0) * (x + half - low)[:, None]
        seen = self.rest_density(around) * pulse.profile(around - x[:, None])
        return x, 0.5 * (x + half - low) * (seen @ weight)

    def rest(self, range_m: Floats) -> Floats:
        """Mean signal of those that are not drawn, at these apparent ranges."""
        return np.interp(range_m, *self._rest)

    @property
    def backscatter_hidden(self) -> float:
        """Mean backscatter of those that are not drawn where a medium hides them. [1/(m sr)]"""
        optics = self.optics
        if optics.hidden is None:
            return 0.0
        r = optics.hidden.range_m
        r = r[(r > optics.overlap_start_m) & (optics.hidden.amplitude > optics.threshold)]
        if not len(r):
            return 0.0
        seen = radiometry.overlap(r, optics.overlap_start_m, optics.overlap_full_m)
        whole = math.pi * optics.k_m2 * seen * exp_or_zero(-2.0 * self.extinction_per_m * r) / (r * r)
        return float(self.rest_density(r).sum() / max(float(whole.sum()), 1e-300))

    @property
    def flicker_hidden(self) -> tuple[float, float]:
        """Up to which range a medium hides particles, and `flicker_at` there, at the most."""
        optics = self.optics
        r = np.zeros(0) if optics.hidden is None else optics.hidden.range_m
        r = r[(r > optics.overlap_start_m) & (optics.level(r) > optics.threshold)]
        return (float(r[-1]), float(np.max(self.flicker_at(r)))) if len(r) else (0.0, 0.0)

    def flicker_at(self, range_m: Floats) -> Floats:
        """rms of the light of those that are not drawn, over what must be reached there: points, each under a pulse."""
        node, weight = np.polynomial.legendre.leggauss(32)
        least = np.minimum(self.least_mm(range_m), self.sizes.largest_mm)[:, None]
        s = 0.5 * (node + 1.0) * least * (1.0 - 1e-12)
        per_size = self.sizes.larger(s) * (1.0 / s if self.optics.gaussian else self.sizes.slope_mm)
        fourth = 0.5 * least[:, 0] * ((per_size * s**4) @ weight)
        # the square of a pulse is as wide as 3/4 of its FWHM
        squares = math.pi * self.optics.area_m2(range_m) * fourth * 0.75 * self.optics.pulse.fwhm_m
        return np.asarray(np.sqrt(squares) * self.unit(range_m) / self.optics.level(range_m))

    def lift(self, range_m: Floats) -> Floats:
        """Factor on the light of the drawn ones: the mean light of the others lowers the level that they must reach.

        Where a medium hides some of them, all that are not drawn are part of it.
        """
        if self.optics.hidden is not None:
            return np.ones(len(range_m))
        return np.asarray(1.0 / (1.0 - np.minimum(self.rest(range_m) / self.optics.level(range_m), MOST_LIFT)))

    def kept_out(self, range_m: Floats, size_mm: Floats) -> Floats:
        """Share of the beam's light that a particle of this effective size stops on its way out: its shadow."""
        area = np.maximum(self.optics.area_m2(range_m), 1e-300)
        return np.minimum(0.25e-6 * self.optics.peak * size_mm * size_mm / area, MOST_SHADOW)

    @cached_property
    def _shadows(self) -> tuple[Floats, Floats]:
        """Ranges, and the mean loss there and back by the drawn particles up to them."""
        start, length = self.optics.overlap_start_m, self.end_m - self.optics.overlap_start_m
        if length <= 0.0:
            return np.array([start, start + 1e-9]), np.zeros(2)
        r = start + np.concatenate([[0.0], np.geomspace(1e-4 * length, length, NODES // 4)])
        low = np.clip(self.least_mm(r), SMALLEST_MM, self.sizes.largest_mm)[:, None]
        node, weight = np.polynomial.legendre.leggauss(32)
        log_s = np.log(low) + 0.5 * (node + 1.0) * (math.log(self.sizes.largest_mm) - np.log(low))
        s = np.minimum(np.exp(log_s), self.sizes.largest_mm * (1.0 - 1e-12))
        lost = 1.0 - (1.0 - self.kept_out(r[:, None], s)) ** 2
        spread = 0.5 * (math.log(self.sizes.largest_mm) - np.log(low[:, 0]))
        if self.optics.gaussian:
            mean = spread * ((self.sizes.larger(s) * lost) @ weight)
        else:  # particles per unit of size, and those that count as the largest
            mean = spread * ((self.sizes.larger(s) * self.sizes.slope_mm * s * lost) @ weight)
            top = np.full(len(r), self.sizes.largest_mm)
            atom = self.sizes.larger(top * (1.0 - 1e-12)) * (1.0 - (1.0 - self.kept_out(r, top)) ** 2)
            mean = mean + np.where(low[:, 0] < self.sizes.largest_mm, atom, 0.0)
        rate = math.pi * self.optics.area_m2(r) * mean
        return r, np.concatenate([[0.0], np.cumsum(0.5 * (rate[1:] + rate[:-1]) * np.diff(r))])

    def mean_shadow(self, range_m: Floats) -> Floats:
        """Mean loss there and back by the drawn particles up to a range: what the extinction has already taken."""
        return np.interp(range_m, *self._shadows)

    def shadow_left_out(self, range_m: float) -> float:
        """Spread of the light that passes once, over its mean, that the particles not drawn would add: their discs.

        Small discs, each of one place: the sum of the squares of their shadows.
        """
        r = floats(range_m * (np.arange(NODES, dtype=np.float64) + 0.5) / NODES)
        node, weight = np.polynomial.legendre.leggauss(48)
        least = np.minimum(self.least_mm(r), self.sizes.largest_mm)[:, None]
        s = 0.5 * (node + 1.0) * least * (1.0 - 1e-12)
        per_size = self.sizes.larger(s) / np.maximum(s, 1e-300)
        if not self.optics.gaussian:
            per_size = self.sizes.larger(s) * self.sizes.slope_mm
        squares = 0.5 * least[:, 0] * ((per_size * self.kept_out(r[:, None], s) ** 2) @ weight)
        return float(np.sqrt(math.pi * np.sum(self.optics.area_m2(r) * squares) * range_m / NODES))
