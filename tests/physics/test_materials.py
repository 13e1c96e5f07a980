"""The material table and what surfaces send back."""

from __future__ import annotations

import math
import pickle
from importlib import resources
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from ruamel.yaml import YAML

from emulator.physics import brdf
from emulator.physics.materials import (
    MODELS,
    MaterialError,
    SurfaceTable,
    builtin_materials,
    known_materials,
    material,
    material_from_mapping,
)


def test_every_material_of_the_table_has_both_wavelengths_a_range_and_a_source() -> None:
    assert len(known_materials()) >= 38
    for name, entry in builtin_materials().items():
        assert entry.name == name
        assert entry.model in MODELS
        assert [nm for nm, _ in entry.rho] == [650.0, 785.0, 850.0, 905.0, 1550.0]
        assert entry.source, name
        assert entry.evidence in ("read", "mem", "choice", "calc"), name
        assert entry.range_905 is not None
        low, high = entry.range_905
        assert low <= entry.reflectance(905) <= high, name


def test_an_entry_that_is_read_alone_is_that_of_the_whole_table() -> None:
    text = resources.files("emulator.physics").joinpath("materials.yaml").read_text(encoding="utf-8")
    entries = YAML(typ="safe", pure=True).load(text)
    assert tuple(entries) == known_materials()
    for name, entry in entries.items():
        assert material(name) == material_from_mapping(name, entry)


@pytest.mark.parametrize(
    ("name", "rho_905", "rho_1550"),
    [
        ("asphalt", 0.28, 0.36),
        ("concrete", 0.32, 0.38),
        ("grass", 0.51, 0.24),
        ("white_plaster", 0.95, 0.90),
        ("black_foam_rubber", 0.024, 0.03),
        ("car_paint_white", 0.75, 0.55),
        ("car_paint_grey", 0.20, 0.20),
        ("bumper_plastic", 0.06, 0.06),
        ("tyre_rubber", 0.05, 0.05),
        ("window_glass", 0.02, 0.02),
        ("fresh_snow", 0.90, 0.10),
        ("skin", 0.55, 0.10),
    ],
)
def test_reflectances_are_those_of_the_specification_s_table(name: str, rho_905: float, rho_1550: float) -> None:
    assert material(name).reflectance(905) == rho_905
    assert material(name).reflectance(1550) == rho_1550


def test_a_sensor_near_a_given_wavelength_takes_its_value_and_another_is_refused() -> None:
    assert material("asphalt").reflectance(903) == material("asphalt").reflectance(905)
    with pytest.raises(MaterialError, match=r"materials.asphalt.rho: no value for 532 nm.*650, 785, 850, 905, 1550"):
        material("asphalt").reflectance(532)
    own = material_from_mapping("mine", {"rho": 0.4})
    assert own.reflectance(532) == 0.4
    own = material_from_mapping("mine", {"rho": {532: 0.1, 905: 0.4}})
    assert own.reflectance(532) == 0.1


def test_an_unknown_material_is_refused_with_the_nearest_known_one() -> None:
    with pytest.raises(MaterialError, match="did you mean asphalt"):
        material("asphallt")
    own = material_from_mapping("curb", {"rho": 0.4})
    assert material("curb", {"curb": own}) is own


def test_a_material_may_start_from_another() -> None:
    rusty = material_from_mapping("rusty", {"like": "car_paint_red", "rho": 0.2, "wet": True})
    assert rusty.model == "coated"
    assert rusty.f0 == material("car_paint_red").f0
    assert rusty.reflectance(905) == pytest.approx(float(brdf.wet_reflectance(0.2, 1.327)))
    assert rusty.evidence == "user"


def test_pigments_are_given_by_their_absorption_over_scattering() -> None:
    layer = material_from_mapping("layer", {"k_over_s": 0.5})
    assert layer.reflectance(905) == pytest.approx(float(brdf.kubelka_munk(0.5)))
    coated = material_from_mapping("paint", {"k_over_s": {905: 0.5, 1550: 2.0}, "model": "coated"})
    expected = float(brdf.saunderson(brdf.kubelka_munk(0.5))) - brdf.COAT_OUTSIDE
    assert coated.reflectance(905) == pytest.approx(expected)


@pytest.mark.parametrize(
    ("entry", "key", "allowed"),
    [
        ({"rho": 1.2}, "materials.m.rho", "from 0 to 1"),
        ({"rho": -0.1}, "materials.m.rho", "from 0 to 1"),
        ({"rho": math.nan}, "materials.m.rho", "from 0 to 1"),
        ({"rho": "bright"}, "materials.m.rho", "from 0 to 1"),
        ({"rho": True}, "materials.m.rho", "from 0 to 1"),
        ({"rho": {}}, "materials.m.rho", "wavelength"),
        ({"rho": {"red": 0.5}}, "materials.m.rho.red", "300 to 3000 nm"),
        ({"rho": {905: 1.5}}, "materials.m.rho.905", "from 0 to 1"),
        ({}, "materials.m.rho", "wavelength"),
        ({"rho": 0.5, "model": "shiny"}, "materials.m.model", "lambert, oren_nayar"),
        ({"rho": 0.5, "rhoo": 1}, "materials.m.rhoo", "rho"),
        ({"rho": 0.5, "roughness": 0.001}, "materials.m.roughness", "mirror"),
        ({"rho": 0.5, "model": "mirror"}, "materials.m.specular", "0 to 1"),
        ({"rho": 0.5, "model": "retro"}, "materials.m.retro_cd_lx_m2", "> 0"),
        ({"rho": 0.5, "k_over_s": 1.0}, "materials.m.k_over_s", "one of the two"),
        ({"rho": 0.5, "wet": "yes"}, "materials.m.wet", "true or false"),
        ({"rho": 0.5, "range": [0.1]}, "materials.m.range", "two numbers"),
        ({"like": "asphallt"}, "materials.m.like", "asphalt"),
        ([0.5], "materials.m", "a mapping"),
    ],
)
def test_a_wrong_entry_is_refused_by_key_with_what_is_allowed(entry: Any, key: str, allowed: str) -> None:
    with pytest.raises(MaterialError) as refused:
        material_from_mapping("m", entry)
    assert refused.value.key == key
    assert allowed in refused.value.allowed
    assert str(refused.value).startswith(f"{key}: ")


def test_a_table_evaluates_mixed_hits_as_the_single_formulas_do() -> None:
    names = ["white_plaster", "asphalt", "car_paint_black", "retro_sheeting", "window_glass", "bumper_plastic"]
    own = material_from_mapping("phong", {"rho": 0.3, "model": "phong", "rho_specular": 0.2, "exponent": 20})
    table = SurfaceTable.of([*(material(n) for n in names), own], 905.0)
    theta = np.radians(np.array([0.0, 20.0, 60.0]))
    index = np.repeat(np.arange(7), 3)
    found = table.back(index, np.tile(np.cos(theta), 7)).reshape(7, 3)
    assert found[0] == pytest.approx(0.95 * np.cos(theta))
    assert found[1] == pytest.approx(brdf.oren_nayar_back(0.28, 0.4, theta))
    assert found[2] == pytest.approx(0.045 * np.cos(theta) + brdf.ggx_back(0.04, 0.1, theta))
    assert found[3] == pytest.approx(0.3 * np.cos(theta) + 70.0 * math.pi)
    assert found[4] == pytest.approx(0.02 * np.cos(theta))
    assert found[5] == pytest.approx(0.06 * np.cos(theta) + brdf.ggx_back(0.04, 0.3, theta))
    assert found[6] == pytest.approx(brdf.phong_back(0.3, 0.2, 20.0, theta))
    assert np.all(found <= table.largest[:, None] * (1.0 + 1e-12))


def test_glass_passes_and_mirrors_what_fresnel_says_and_loses_the_rest() -> None:
    clear = material_from_mapping("clear", {"rho": 0.0, "model": "glass", "index": 1.5})
    table = SurfaceTable.of([clear, material("windscreen"), material("mirror"), material("water")], 905.0)
    cosine = np.cos(np.radians(np.array([0.0, 60.0, 89.9])))
    zero = np.zeros(3, np.int64)
    assert table.transmission(zero, cosine) == pytest.approx(
        brdf.pane_transmission(1.5, np.radians(np.array([0.0, 60.0, 89.9]))), rel=1e-9
    )
    assert table.transmission(zero, cosine) + table.sent_on(zero, cosine)[0] == pytest.approx(np.ones(3), rel=1e-12)
    tinted = table.transmission(zero + 1, cosine)
    assert np.all(tinted + table.sent_on(zero + 1, cosine)[0] < 1.0)
    assert tinted[0] == pytest.approx(0.8 * 0.92, rel=0.01)
    assert np.all(table.sent_on(zero + 2, cosine)[0] == 0.9)
    assert np.all(table.transmission(zero + 2, cosine) == 0.0)
    assert float(table.sent_on(zero + 3, cosine)[0][0]) == pytest.approx(0.0197, abs=5e-5)
    # of hits on all of them in one call, and on what sends on nothing
    table = SurfaceTable.of([*table.materials, material("asphalt")], 905.0)
    kinds, cosines = np.arange(5).repeat(3), np.tile(cosine, 5)
    alone = [table.sent_on(kinds[kinds == one], cosine) for one in range(5)]
    np.testing.assert_array_equal(table.sent_on(kinds, cosines), np.concatenate(alone, axis=1))
    assert not np.any(alone[4])
    assert table.sends_on
    assert not SurfaceTable.of([material("asphalt")], 905.0).sends_on


def test_rain_darkens_rough_surfaces_and_leaves_glass() -> None:
    names = ["asphalt", "window_glass"]
    dry = SurfaceTable.of([material(n) for n in names], 905.0)
    wet = SurfaceTable.of([material(n) for n in names], 905.0, wet=True)
    assert wet.rho[0] == pytest.approx(float(brdf.wet_reflectance(0.28, 1.327)))
    assert wet.rho[1] == dry.rho[1]


def from_zero(largest: float) -> st.SearchStrategy[float]:
    return st.just(0.0) | st.floats(1e-6 * largest, largest)


@given(from_zero(1.0), from_zero(1.5), st.floats(0.02, 1.0), from_zero(1000.0))
def test_no_surface_sends_back_more_than_it_gets(rho: float, slope: float, roughness: float, exponent: float) -> None:
    theta = np.radians(np.linspace(0.0, 90.0, 91))
    assert np.all(brdf.lambert_back(rho, theta) <= 1.0)
    assert np.all(brdf.oren_nayar_back(rho, slope, theta) <= 1.0)
    # a lobe may outshine an ideal plate in one direction; over plates of all orientations its mean may not
    fine = np.linspace(0.0, np.pi / 2.0, 20_001)
    for lobe in (brdf.ggx_back(1.0, roughness, fine), brdf.phong_back(0.0, 1.0, exponent, fine)):
        assert float(np.trapezoid(lobe * np.sin(fine), fine)) <= 1.0 + 1e-6
    assert 0.0 <= float(brdf.saunderson(brdf.kubelka_munk(exponent))) <= 1.0


def test_materials_travel_to_worker_processes() -> None:
    table = SurfaceTable.of([material(name) for name in known_materials()], 905.0)
    again = pickle.loads(pickle.dumps(table))
    assert again.materials == table.materials
