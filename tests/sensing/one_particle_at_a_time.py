"""A second opinion on particles in a beam: places in space, one at a time, plain formulas, numpy alone.

Nothing of the product is imported here, and nothing is drawn cleverly: drops and flakes of all sizes stand anywhere in
a cylinder that is three beam radii wide, each sends back what the range equation says, the pulses are summed on a grid,
and a beam answers where a local maximum of the sum reaches the level.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
RADII = 3.0
LARGEST_MM = 6.0


@dataclass(frozen=True)
class Rig:
    """Sensor and weather by their numbers alone, see the cases."""

    k: float
    theta: float
    w0: float
    gauss: bool
    thr: float
    floor: float
    r1: float
    r2: float
    near: float
    pulse_m: float
    "c tau: twice the FWHM in range."
    n0: float
    lam: float
    kappa: float
    alpha: float

    @classmethod
    def of(cls, setup: dict[str, Any]) -> Rig:
        """From the setup of a case."""
        p = setup["parameters"]
        return cls(
            p["k"], p["theta"], p["w0"], p["profile"] == "gauss", p["thr"], p["floor"], p["r1"], p["r2"], p["near"],
            299792458.0 * p["tau"], setup["n0_m3_mm"], setup["slope_mm"], setup["kappa_sr"],
            setup["extinction_per_m"],
        )  # fmt: skip

    def width(self, r: Floats) -> Floats:
        return self.theta * r + self.w0

    def level(self, r: Floats) -> Floats:
        return np.maximum(self.thr, self.floor * self.k / np.maximum(r, 1e-3) ** 2)

    def light(self, r: Floats, rho: Floats, size_mm: Floats) -> Floats:
        """Amplitude of one particle."""
        w, ov = self.width(r), np.clip((r - self.r1) / (self.r2 - self.r1), 0.0, 1.0)
        axis = self.k * self.kappa * (1e-3 * size_mm) ** 2 * ov * np.exp(-2.0 * self.alpha * r) / (w * r) ** 2
        return axis * (2.0 * np.exp(-2.0 * (rho / w) ** 2) if self.gauss else np.where(rho < w, 1.0, 0.0))


def drops(rig: Rig, beams: int, to_m: float, rng: np.random.Generator) -> tuple[NDArray[np.int64], Floats, Floats]:
    """Beam, range and amplitude of all particles."""
    # in pieces of 0.1 m, so that the cylinder may widen
    edges = np.arange(rig.r1, to_m, 0.1)
    volume = np.pi * (RADII * rig.width(edges + 0.1)) ** 2 * 0.1
    count = rng.poisson(rig.n0 / rig.lam * volume, (beams, len(edges)))
    beam, piece = (
        np.arange(beams).repeat(count.sum(axis=1)),
        np.tile(np.arange(len(edges)), beams).repeat(count.ravel()),
    )
    r = edges[piece] + 0.1 * rng.random(len(beam))
    rho = RADII * rig.width(edges[piece] + 0.1) * np.sqrt(rng.random(len(beam)))
    size = np.minimum(rng.exponential(1.0 / rig.lam, len(beam)), LARGEST_MM)
    return beam, r, rig.light(r, rho, size)


def first_echoes(rig: Rig, beams: int, to_m: float, seed: int, alone: bool = False, noise: float = 0.0) -> Floats:
    """Range of the first echo of each beam, NaN where there is none.

    `alone`: particles do not add. `noise`: rms of one number that is added to each maximum of at least 0.2 of the
    level; the particles are the same for every `noise`.
    """
    rng = np.random.default_rng(seed)
    beam, r, light = drops(rig, beams, to_m, rng)
    begin = max(rig.r1, rig.near)
    if alone:
        seen = (light >= rig.level(r)) & (r >= begin)
        found = np.full(beams, np.inf)
        np.minimum.at(found, beam[seen], r[seen])
        return np.where(np.isfinite(found), found, np.nan)
    bright = light >= 1e-3 * rig.level(r)
    beam, r, light = beam[bright], r[bright], light[bright]
    step, half = rig.pulse_m / 64.0, 0.5 * rig.pulse_m
    x = np.arange(rig.r1 - half, to_m + half, step)
    wave = np.zeros((beams, len(x)))
    first = np.ceil((r - half - x[0]) / step).astype(np.int64)
    for k in range(65):
        at = np.clip(first + k, 0, len(x) - 1)
        off = x[at] - r
        np.add.at(wave, (beam, at), light * np.where(np.abs(off) < half, np.cos(np.pi * off / rig.pulse_m) ** 2, 0.0))
    top = (wave[:, 1:-1] >= wave[:, :-2]) & (wave[:, 1:-1] > wave[:, 2:])
    signal, level = wave[:, 1:-1], rig.level(x[1:-1])
    top &= (signal >= 0.2 * level) & (signal + noise * rng.normal(size=signal.shape) >= level) & (x[1:-1] >= begin)
    return np.where(top.any(axis=1), x[1:-1][top.argmax(axis=1)], np.nan)
