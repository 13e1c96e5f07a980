"""Mie series against printed cases: Bohren and Huffman 1983, appendix A; Wiscombe 1980, MIEV0 test cases."""

from __future__ import annotations

import numpy as np
import pytest

from emulator.studies import mie


@pytest.mark.parametrize(
    ("x", "index", "extinction", "tolerance"),
    [
        (2.0 * np.pi * 0.525 / 0.6328, 1.55, 3.10543, 5e-6),  # Bohren and Huffman, sample output of BHMIE
        (10.0, 1.5, 2.881999, 5e-7),  # Wiscombe
        (100.0, 1.5, 2.094388, 5e-7),
        (1000.0, 1.5, 2.013945, 5e-7),
    ],
)
def test_extinction_meets_printed_cases(x: float, index: float, extinction: float, tolerance: float) -> None:
    assert mie.efficiencies(np.array([x]), index)[0][0] == pytest.approx(extinction, abs=tolerance)


def test_backscatter_meets_the_printed_case() -> None:
    """Bohren and Huffman, sample output of BHMIE: 2.92534."""
    assert mie.efficiencies(np.array([2.0 * np.pi * 0.525 / 0.6328]), 1.55)[1][0] == pytest.approx(2.92534, abs=5e-6)


def test_spheres_of_all_sizes_at_once_give_what_each_gives_alone() -> None:
    x = np.array([300.0, 0.5, 40.0, 3.0])
    together = mie.efficiencies(x, 1.327)
    for n, size in enumerate(x):
        alone = mie.efficiencies(np.array([size]), 1.327)
        assert [together[0][n], together[1][n]] == pytest.approx([alone[0][0], alone[1][0]], rel=1e-9)


def test_large_spheres_take_away_twice_their_shadow_and_small_ones_follow_rayleigh() -> None:
    assert mie.efficiencies(np.array([2000.0]), 1.327)[0][0] == pytest.approx(2.0, rel=0.01)
    polarisability = (1.327**2 - 1.0) / (1.327**2 + 2.0)
    rayleigh = 8.0 / 3.0 * 0.01**4 * polarisability**2
    assert mie.efficiencies(np.array([0.01]), 1.327)[0][0] == pytest.approx(rayleigh, rel=1e-3)


@pytest.mark.parametrize(
    ("droplets", "extinction_per_m"),
    [(mie.STRONG_FOG, 0.02908), (mie.MODERATE_FOG, 0.01873), (mie.STRONG_SPRAY, 0.01706), (mie.CHU_HOGG, 0.001635)],
)
def test_spectra_have_the_extinction_of_an_independent_mie_code(
    droplets: mie.Droplets, extinction_per_m: float
) -> None:
    assert droplets.optics(905)[0] == pytest.approx(extinction_per_m, rel=1e-3)


def test_a_spectrum_holds_as_many_droplets_as_it_says() -> None:
    radius = np.linspace(0.01, 200.0, 20_000)
    for droplets in (mie.STRONG_FOG, mie.STRONG_SPRAY, mie.CHU_HOGG):
        total = float(np.sum(droplets.density(radius)) * (radius[1] - radius[0]))
        assert total == pytest.approx(1e6 * droplets.number_cm3, rel=1e-3)
