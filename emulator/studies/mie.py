"""Scattering of light by water spheres (Mie) from first principles, to judge the laws that the product takes.

Belongs here: efficiencies of one sphere, sums over droplet spectra. The product's sensing does not use it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy import special

from emulator.physics.arrays import Floats

WATER_INDEX = {550: 1.333, 785: 1.329, 905: 1.327, 1550: 1.318}
"Real part at 25 C by wavelength in nm; absorption does not matter for droplets of these sizes."
RADII = 12_000
"Backscatter swings within a thousandth of the radius; a spectrum averages it."


def efficiencies(x: Floats, index: complex) -> tuple[Floats, Floats]:
    """Extinction and backscatter efficiency of spheres.

    Parameters
    ----------
    x : (n,) size parameters 2 pi r / lambda, > 0
    index : refractive index of the sphere

    Returns
    -------
    extinction : (n,) cross-section over pi r^2
    backscatter : (n,) 4 pi times the cross-section per solid angle straight back, over pi r^2

    Notes
    -----
    Series of a_n and b_n; logarithmic derivative by downward, Riccati-Bessel functions by upward recurrence, up to
    x + 4 x^(1/3) + 2 terms.

    References
    ----------
    .. [1] Bohren and Huffman, Absorption and Scattering of Light by Small Particles (1983), ch. 4 and appendix A.
    """
    order = np.argsort(x)
    size = np.asarray(x, dtype=np.float64)[order]
    terms = np.ceil(size + 4.0 * np.cbrt(size) + 2.0).astype(np.int64)
    most = int(terms[-1])
    z = index * size
    largest = float(np.max(np.abs(z)))
    top = int(max(most, largest) + 12.0 * largest ** (1.0 / 3.0)) + 16  # a start at 0 is forgotten to 1e-16 on the way
    derivative = np.zeros((most + 1, len(size)), np.complex128)
    below = np.zeros(len(size)) + 0j
    for n in range(top, 0, -1):
        below = np.asarray(n / z - 1.0 / (below + n / z))
        if n - 1 <= most:
            derivative[n - 1] = below
    psi_before, psi = np.cos(size), np.sin(size)
    chi_before, chi = -np.sin(size), np.cos(size)
    forward, back = np.zeros(len(size)), np.zeros(len(size), np.complex128)
    for n in range(1, most + 1):
        on = slice(int(np.searchsorted(terms, n)), None)  # beyond its own last term a small sphere would overflow
        s = size[on]
        psi_next, chi_next = psi.copy(), chi.copy()
        psi_next[on] = (2 * n - 1) / s * psi[on] - psi_before[on]
        chi_next[on] = (2 * n - 1) / s * chi[on] - chi_before[on]
        psi_before, psi, chi_before, chi = psi, psi_next, chi, chi_next
        xi, xi_before = psi[on] - 1j * chi[on], psi_before[on] - 1j * chi_before[on]
        d = derivative[n][on]
        electric, magnetic = d / index + n / s, d * index + n / s
        a = (electric * psi[on] - psi_before[on]) / (electric * xi - xi_before)
        b = (magnetic * psi[on] - psi_before[on]) / (magnetic * xi - xi_before)
        forward[on] += (2 * n + 1) * (a + b).real
        back[on] += (2 * n + 1) * (-1) ** n * (a - b)
    extinction, backscatter = np.zeros(len(size)), np.zeros(len(size))
    extinction[order] = 2.0 / size**2 * forward
    backscatter[order] = np.abs(back) ** 2 / size**2
    return extinction, backscatter


@dataclass(frozen=True)
class Droplets:
    """A modified gamma spectrum of droplets, as Rasshofer et al. 2011 tabulate them."""

    name: str
    number_cm3: float
    alpha: float
    gamma: float
    mode_um: float

    def density(self, radius_um: Floats) -> Floats:
        """Droplets per m^3 and um of radius."""
        b = self.alpha / (self.gamma * self.mode_um**self.gamma)
        order = (self.alpha + 1.0) / self.gamma
        scale = 1e6 * self.number_cm3 * self.gamma * b**order / float(special.gamma(order))
        return np.asarray(scale * radius_um**self.alpha * np.exp(-b * radius_um**self.gamma))

    def optics(self, wavelength_nm: int) -> tuple[float, float]:
        """Extinction [1/m] and lidar ratio [sr]."""
        far = self.mode_um * (30.0 * self.gamma / self.alpha) ** (1.0 / self.gamma)  # exp(-30) is left beyond
        radius = np.linspace(far / RADII, far, RADII)
        extinction, backscatter = efficiencies(2000.0 * math.pi * radius / wavelength_nm, WATER_INDEX[wavelength_nm])
        area = math.pi * 1e-12 * radius**2 * self.density(radius) * (radius[1] - radius[0])
        alpha = float(np.sum(extinction * area))
        return alpha, 4.0 * math.pi * alpha / float(np.sum(backscatter * area))


STRONG_FOG = Droplets("strong advection fog", 20.0, 3.0, 1.0, 10.0)
MODERATE_FOG = Droplets("moderate advection fog", 20.0, 3.0, 1.0, 8.0)
STRONG_SPRAY = Droplets("strong spray", 100.0, 6.0, 1.0, 4.0)
CHU_HOGG = Droplets("Chu-Hogg fog", 20.0, 2.0, 0.5, 1.0)
