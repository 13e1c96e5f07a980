"""Ranges by triangulation: where the spot is on the imager, and what its errors there are as ranges.

Belongs here: formulas on arrays. Not: whether there is light enough (detection), which sensors have such optics.
A target at the distance d from the line of lens and laser is at p = f b / d pixels from the vanishing point, so the
same error of p is an error of the range that grows with the square of it: dd = d^2 dp / (f b).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from emulator.physics.arrays import Floats, Values, floats


@dataclass(frozen=True)
class Triangulation:
    """Optics of one sensor. Lengths in m, places on the imager in pixels."""

    baseline_m: float
    "Between laser and lens."
    focal_px: float
    "Of the lens, in pixels of the imager."
    subpixel_px: float
    "Standard deviation of the place that is found for a bright spot."
    spot_px: float = 0.0
    "Width of the spot: over the echo's signal to noise it adds to that, so that faint targets scatter more; 0: none."
    step_px: float = 0.0
    "Quantisation of the place; 0: none."
    imager_px: float = np.inf
    "Where the imager ends: nearer targets are beside it."

    @property
    def scale_m_px(self) -> float:
        """f b: distance times place."""
        return self.baseline_m * self.focal_px

    @property
    def nearest_m(self) -> float:
        """Least distance whose spot is on the imager."""
        return self.scale_m_px / self.imager_px

    def place_px(self, range_m: Values) -> Floats:
        """Place of the spot of a target. [px]"""
        return self.scale_m_px / floats(range_m)

    def spread_px(self, snr: Values) -> Floats:
        """Standard deviation of the place that is found, by peak signal over rms noise. [px]"""
        return np.hypot(self.subpixel_px, self.spot_px / floats(snr))

    def spread_m(self, range_m: Values, snr: Values = np.inf) -> Floats:
        """The same as a range, to first order: with the square of the distance. [m]"""
        return floats(range_m) ** 2 * self.spread_px(snr) / self.scale_m_px

    def step_m(self, range_m: Values) -> Floats:
        """Step of the reported range at a distance, to first order. [m]"""
        return floats(range_m) ** 2 * self.step_px / self.scale_m_px

    def measured(self, range_m: Floats, snr: Floats, normals: Values = 0.0) -> Floats:
        """What is reported of true ranges (any shape, NaN: no echo), `normals` standard normal numbers.

        NaN where the spot is beside the imager, or found at the vanishing point or behind it.
        """
        with np.errstate(divide="ignore", invalid="ignore"):
            place = self.place_px(range_m) + self.spread_px(snr) * normals
            if self.step_px > 0.0:
                place = np.rint(place / self.step_px) * self.step_px
            good = (place > 0.0) & (self.place_px(range_m) <= self.imager_px)  # false for NaN
            return np.where(good, self.scale_m_px / place, np.nan)
