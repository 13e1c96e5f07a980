"""Retroreflective sheeting against the angles of the standards."""

from __future__ import annotations

import math

import numpy as np
import pytest

from emulator.physics.materials import MaterialError, SurfaceTable, material, material_from_mapping
from emulator.physics.sheeting import classes


@pytest.mark.parametrize("name", list(classes()))
def test_a_class_has_its_tables_values_and_falls_between_and_beyond_them(name: str) -> None:
    one = classes()[name]
    for i, observed in enumerate(one.observation_deg):
        for k, entered in enumerate(one.entrance_deg):
            assert float(one.coefficient(observed, entered)) == pytest.approx(one.cd_lx_m2[i, k], rel=1e-12)
    for fixed in one.entrance_deg:
        assert np.all(np.diff(one.coefficient(np.linspace(0.0, 4.0, 200), fixed)) <= 1e-12)
    assert np.all(np.diff(one.coefficient(one.observation_deg[0], np.linspace(0.0, 89.9, 300))) <= 1e-12)
    assert float(one.coefficient(0.2, 90.0)) == 0.0
    assert one.source
    slant = math.cos(math.radians(one.reference[1]))
    assert float(one.share(math.radians(one.reference[0]), slant)) == pytest.approx(1.0 / slant)
    widest = np.radians(np.linspace(one.entrance_deg[-1], 90.0, 100))
    assert np.all(np.diff(one.share(0.0, np.cos(widest))) <= 1e-12)


def test_en_12899_ra1_and_ra2() -> None:
    """EN 12899-1: 12' and 20' of observation, 5, 30 and 40 degrees of entrance, white."""
    for name, head_on, slanted in (("ra1", 70.0, 9.0 / 50.0), ("ra2", 250.0, 95.0 / 180.0)):
        one = classes()[name]
        assert one.reference_cd_lx_m2 == head_on
        assert float(one.coefficient(0.33, 40.0) / one.coefficient(0.33, 5.0)) == pytest.approx(slanted, rel=1e-12)


def test_a_surface_of_a_class_sends_back_its_share_and_one_without_keeps_its_value() -> None:
    table = SurfaceTable.of([material("sheeting_ra2"), material("number_plate")], 905.0, baseline_m=0.02)
    ra2, kinds = classes()["ra2"], np.array([0, 1])
    near, far = 0.02 / math.tan(math.radians(0.33)), 1000.0
    for degrees in (5.0, 30.0, 40.0):
        c = math.cos(math.radians(degrees))
        for range_m, observed in ((near, 0.33), (far, 0.2)):
            back = table.back(kinds, np.full(2, c), np.full(2, range_m))
            expected = math.pi * float(ra2.coefficient(observed, degrees)) / c
            assert back[0] == pytest.approx(expected + 0.3 * c, rel=1e-9)
            assert back[1] == pytest.approx(math.pi * 70.0 + 0.3 * c, rel=1e-12)
    assert table.largest[0] == pytest.approx(math.pi * 250.0 / math.cos(math.radians(5.0)) + 0.3, rel=1e-3)
    fine = np.cos(np.radians(np.linspace(0.0, 90.0, 4001)))
    assert table.back(np.zeros(4001, np.int64), fine).max() <= table.largest[0] * (1.0 + 1e-12)
    assert table.apart.tolist() == [True, False]
    assert table.factors[2].tolist() == [0.0, pytest.approx(math.pi * 70.0)]


def test_a_users_sheeting_takes_its_size_from_its_class_or_its_own_number() -> None:
    assert material_from_mapping("a", {"rho": 0.3, "model": "retro", "retro_class": "ra1"}).retro_cd_lx_m2 == 70.0
    own = {"rho": 0.3, "model": "retro", "retro_class": "ra1", "retro_cd_lx_m2": 90}
    table = SurfaceTable.of([material_from_mapping("a", own)], 905.0)
    back = table.back(np.zeros(1, np.int64), np.array([math.cos(math.radians(30.0))]))
    c = math.cos(math.radians(30.0))
    assert back[0] == pytest.approx(math.pi * 90.0 * 30.0 / 70.0 / c + 0.3 * c, rel=1e-9)
    with pytest.raises(MaterialError, match=r"materials\.a\.retro_class: 'ra9'; want one of ra1, ra2"):
        material_from_mapping("a", {"rho": 0.3, "model": "retro", "retro_class": "ra9"})
    with pytest.raises(MaterialError, match="want none, or model retro"):
        material_from_mapping("a", {"rho": 0.3, "retro_class": "ra1"})
