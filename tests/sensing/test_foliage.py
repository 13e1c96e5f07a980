"""Hedges before walls through whole scans: energy, gaps, the same leaves for all who look, refusals."""

from __future__ import annotations

import dataclasses
import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from emulator.casting import raycast
from emulator.casting.detail import DetailedCaster
from emulator.compiled import switch
from emulator.errors import ScenarioError, SceneError
from emulator.scenario import scenario
from emulator.world import scene
from tests.sensing.rig import QUIET, build, plan, plate

AZIMUTH = np.linspace(-30.0, 30.0, 241)
ONE_BEAM = {**QUIET, "overlap": None}


def leaves(density: float = 2.0, **more: Any) -> dict[str, Any]:
    return {"foliage": {"leaf_area_density_m2_m3": density, "leaf_reflectance": 0.5, **more}}


def hedge(thick_m: float = 0.5, x_m: float = 5.0, material: str = "hedge") -> dict[str, Any]:
    return {"box": {"size_m": [thick_m, 40.0, 20.0]}, "at_m": [x_m, 0.0, -10.0], "material": material}


def measure(folder: Path, world: list[dict[str, Any]], density: float = 2.0, **more: Any) -> Any:
    physics = {**QUIET, **more.pop("physics", {})}
    return build(
        folder, world, materials={"hedge": leaves(density), **more.pop("materials", {})}, physics=physics, **more
    )


def test_what_passes_and_what_comes_back_is_that_of_the_gap_probability(tmp_path: Path) -> None:
    """Sums over beams far apart. Share behind: exp(-G L s); leaves: rho 2/3 of their cosines, where they stand."""
    model = measure(tmp_path, [hedge(), plate(9.0, "white")], model="sick-lms291-s05")
    azimuth = np.radians(AZIMUTH)
    slant = 1.0 / np.cos(azimuth)
    behind, light = [], []
    for height in np.linspace(-12.0, 12.0, 13):
        found = model.view(plan(AZIMUTH, elevation_deg=height)).echoes
        far = found.range_m > 7.0
        slants = slant / math.cos(math.radians(height))
        behind.append(found.blocked[far].sum() / np.exp(-0.5 * slants).sum())
        path = (np.arange(200) + 0.5) / 200 * 0.5
        where = slants[:, None] * (4.75 + path)
        a = model.model.aperture_radius_m
        k = model.model.k_m2 / (where**2 + a * a)
        law = (k * 0.5 * 2.0 / 3.0 * np.exp(-slants[:, None] * path)).mean(axis=1) * 0.5 * slants
        light.append(found.amplitude[~far].sum() / law.sum())
    assert np.mean(behind) == pytest.approx(1.0, abs=0.01)
    assert np.mean(light) == pytest.approx(1.0, abs=0.015)
    # and no more light is lost on the way back: it comes through the gap by which it went
    found = model.view(plan(AZIMUTH)).echoes
    bare = measure(tmp_path, [plate(9.0, "white")], model="sick-lms291-s05").view(plan(AZIMUTH)).echoes
    far = found.range_m > 7.0
    assert found.amplitude[far].sum() / bare.amplitude.sum() == pytest.approx(math.exp(-0.53), abs=0.05)


@pytest.mark.parametrize("law", ["planophile", "erectophile"])
def test_lying_leaves_let_level_beams_through_and_stop_falling_ones(tmp_path: Path, law: str) -> None:
    crown = {"box": {"size_m": [60.0, 60.0, 0.6]}, "at_m": [0.0, 0.0, -2.0], "material": "crown"}
    ground = {"plane": {"size_m": [200.0, 200.0]}, "at_m": [0.0, 0.0, -8.0], "material": "white"}
    model = build(tmp_path, [crown, ground], materials={"crown": leaves(2.0, leaf_angle=law)}, physics=QUIET)
    g = {"planophile": 8.0, "erectophile": 4.0}[law] / (3.0 * math.pi)
    known = model._caster
    down = np.tile([0.0, 0.0, -1.0], (900, 1))
    start = np.random.default_rng(1).uniform(-25.0, 25.0, (900, 3)) * [1.0, 1.0, 0.0]
    passed = known.first_hits(start, down, np.zeros(900)).range_m > 3.0
    assert passed.mean() == pytest.approx(math.exp(-g * 1.2), abs=0.06)
    assert len(model.view(plan((0.0,))).echoes) == 0


def test_a_scan_is_the_same_in_any_order_and_by_any_rule(tmp_path: Path) -> None:
    world = [hedge(), plate(9.0, "white", 5.0, 1.0, 5.0)]
    sweeps = [plan(AZIMUTH, sweep=k, start_s=0.1 * k) for k in range(3)]
    kept = measure(tmp_path, world)
    made = [kept(one).range_m for one in sweeps]
    again = measure(tmp_path, world, physics={"full": True})
    for number in (2, 0, 1):
        np.testing.assert_allclose(again(sweeps[number]).range_m, made[number], atol=1e-4)
    np.testing.assert_array_equal(made[0], made[2])  # leaves hang where they hung
    other = measure(tmp_path, world, seed=2)(sweeps[0]).range_m
    assert np.nanmean(np.abs(other - made[0]) > 0.01) > 0.3
    for rule in ("adaptive", "laguerre", "axis"):
        measure(tmp_path, world, physics={"rule": rule})(sweeps[0])


def test_neighbouring_beams_and_other_sensors_meet_the_same_leaves(tmp_path: Path) -> None:
    """Thin beams 0.5 mm apart at the hedge end at one leaf; 20 cm apart at independent ones."""
    model = measure(tmp_path, [hedge()], physics={"rule": "axis"})
    near = np.degrees(np.arange(600) * 1e-4 - 0.03)
    first = model(plan(near)).range_m[:, 0]
    both = np.isfinite(first[1:]) & np.isfinite(first[:-1])
    same = np.abs(np.diff(first))[both] < 0.002
    assert same.mean() > 0.95
    far = model(plan(np.degrees(np.arange(101) * 0.02 - 1.0))).range_m[:, 0]
    both = np.isfinite(far[1:]) & np.isfinite(far[:-1])
    assert (np.abs(np.diff(far))[both] < 0.002).mean() < 0.05
    # another sensor 3 cm to the side looks at the same leaf in the middle of the hedge's front
    aside = measure(tmp_path, [hedge()], physics={"rule": "axis"}, mount={"at_m": [0.0, 0.003, 0.0]})
    other = aside(plan(near - math.degrees(0.003 / 4.75))).range_m[:, 0]
    both = np.isfinite(first) & np.isfinite(other)
    assert (np.abs(first - other)[both] < 0.01).mean() > 0.85


def test_a_hedge_takes_its_leaves_along(tmp_path: Path) -> None:
    """One that drives 1 m/s towards the sensor shows the same leaves, a metre nearer after a second."""
    there = {"shape": {"box": {"size_m": [0.5, 40.0, 20.0]}}, "material": "hedge", "class": "unknown"}
    moving = {"id": "cart", **there, "motion": {"at_m": [5.0, 0.0, -10.0], "velocity_m_s": [-1.0, 0.0, 0.0]}}
    model = measure(tmp_path, [plate(9.0, "white")], actors=[moving], physics={"rule": "axis"})
    first, later = model(plan((0.0, 10.0))), model(plan((0.0, 10.0), start_s=1.0))
    assert first.range_m[0, 0] - later.range_m[0, 0] == pytest.approx(
        1.0 if first.range_m[0, 0] < 7.0 else 0.0, abs=1e-3
    )


def behind_a_hedge(folder: Path, full: bool) -> Any:
    """A sensor at rest, a hedge, and a car that passes behind it."""
    car = {"shape": {"box": {"size_m": [1.0, 2.0, 4.0]}}, "material": "white", "class": "car", "id": "car"}
    car |= {"motion": {"at_m": [8.0, -6.0, -2.0], "velocity_m_s": [0.0, 10.0, 0.0]}}
    return measure(folder, [hedge(), plate(12.0, "dark")], actors=[car], physics={"full": full})


PASSING = [plan(AZIMUTH, sweep=number, start_s=0.25 * number) for number in range(5)]


@pytest.fixture(scope="module")
def by_fresh_sensors(tmp_path_factory: pytest.TempPathFactory) -> list[Any]:
    """Each sweep with every term, by a sensor that has seen none before."""
    return [behind_a_hedge(tmp_path_factory.mktemp("fresh"), True)(at) for at in PASSING]


@pytest.mark.parametrize("full", [False, True])
def test_a_car_behind_the_hedge_is_seen_where_it_is_by_a_sensor_at_rest(
    tmp_path: Path, full: bool, by_fresh_sensors: list[Any]
) -> None:
    """What is kept of rays that come again forgets nothing that moves behind leaves."""
    kept = behind_a_hedge(tmp_path, full)
    for number, (at, fresh) in enumerate(zip(PASSING, by_fresh_sensors, strict=True)):
        found = kept(at)
        np.testing.assert_allclose(found.range_m, fresh.range_m, atol=1e-4)
        if full:  # else the source of two echoes within a pulse may be told otherwise
            np.testing.assert_array_equal(found.actor, fresh.actor)
        assert (found.actor == 1).any() or number != 2


def test_a_trunk_in_a_crown_and_crowns_in_each_other(tmp_path: Path) -> None:
    """Leaves before the trunk count, those behind it do not; two overlapping shells of one body are one crown."""
    crown = {"sphere": {"radius_m": 2.0}, "at_m": [6.0, 0.0, -2.0], "material": "hedge"}
    trunk = {"box": {"size_m": [0.2, 0.4, 4.0]}, "at_m": [6.0, 0.0, -2.0], "material": "white"}
    model = measure(tmp_path, [crown, trunk, plate(12.0, "white")], 0.8)
    range_m = ranges(model, np.linspace(-1.5, 1.5, 101))
    assert (np.abs(range_m - 5.9) < 0.01).mean() == pytest.approx(math.exp(-0.5 * 0.8 * 1.9), abs=0.03)
    assert range_m.max() < 6.0


def ranges(model: Any, azimuth_deg: np.ndarray, seeds: int = 150) -> np.ndarray:
    """(seeds, n) where axes end, of leaves that hang elsewhere each time."""
    azimuth = np.radians(azimuth_deg)
    ray = np.stack([np.cos(azimuth), np.sin(azimuth), np.zeros(len(azimuth))], axis=1)
    known = model._caster
    other = [DetailedCaster(known.bare, model._scene, known.materials, seed) for seed in range(seeds)]
    return np.stack([one.first_hits(np.zeros((len(ray), 3)), ray, np.zeros(len(ray))).range_m for one in other])


def test_overlapping_hulls_of_one_body_hold_the_leaves_of_one(tmp_path: Path) -> None:
    lines = []
    for number, x in enumerate((4.0, 4.5)):  # two boxes, 1 m thick, half a metre within each other
        corners = [(x + i, 20.0 * j - 10.0, 20.0 * k - 10.0) for k in (0, 1) for j in (0, 1) for i in (0, 1)]
        lines += ["v {} {} {}".format(*one) for one in corners]
        quads = ((1, 3, 4, 2), (5, 6, 8, 7), (1, 2, 6, 5), (3, 7, 8, 4), (1, 5, 7, 3), (2, 4, 8, 6))
        lines += ["f " + " ".join(str(c + 8 * number) for c in quad) for quad in quads]
    (tmp_path / "two.obj").write_text("\n".join(lines), encoding="utf-8")
    model = measure(tmp_path, [{"mesh": "two.obj", "material": "hedge"}, plate(9.0, "white")], 1.0)
    behind = ranges(model, np.linspace(-20.0, 20.0, 101)) > 7.0
    law = np.exp(-0.75 / np.cos(np.radians(np.linspace(-20.0, 20.0, 101)))).mean()
    assert behind.mean() == pytest.approx(law, abs=0.015)


def test_a_sensor_in_a_crown_looks_out_through_its_leaves(tmp_path: Path) -> None:
    world = [{"sphere": {"radius_m": 1.0}, "at_m": [0.0, 0.0, -1.0], "material": "hedge"}, plate(6.0, "white")]
    behind = ranges(measure(tmp_path, world, 2.0), np.linspace(-60.0, 60.0, 61)) > 4.0
    assert behind.mean() == pytest.approx(math.exp(-1.0), abs=0.03)


@pytest.mark.parametrize("model", ["paper-905nm", "sick-lms291-s05"])
def test_arrays_and_loops_measure_alike(tmp_path: Path, model: str) -> None:
    pytest.importorskip("numba")
    car = {"shape": {"box": {"size_m": [1.0, 2.0, 4.0]}}, "material": "white", "class": "car", "id": "car"}
    car |= {"motion": {"at_m": [8.0, -3.0, -2.0], "velocity_m_s": [0.0, 10.0, 0.0]}}
    made = []
    for on in (False, True):
        with switch.switched(on):
            one = measure(tmp_path, [hedge(), plate(9.0, "white")], actors=[car], model=model, mount={"actor": "car"}
                          if model == "none" else {})  # fmt: skip
            made.append([one(plan(AZIMUTH, sweep=k, start_s=0.1 * k)) for k in range(2)])
    for one, other in zip(*made, strict=True):
        np.testing.assert_allclose(one.range_m, other.range_m, atol=1e-7)
        np.testing.assert_array_equal(one.actor, other.actor)


def test_a_scene_without_leaves_is_cast_by_the_caster_itself(tmp_path: Path) -> None:
    assert type(measure(tmp_path, [plate(9.0, "white")])._caster) is raycast.Caster
    assert type(measure(tmp_path, [hedge()])._caster) is DetailedCaster


def test_leaves_of_no_density_are_air(tmp_path: Path) -> None:
    clear = measure(tmp_path, [plate(9.0, "white")], physics={"full": True})(plan(AZIMUTH))
    found = measure(tmp_path, [hedge(), plate(9.0, "white")], 0.0, physics={"full": True})(plan(AZIMUTH))
    np.testing.assert_allclose(found.range_m, clear.range_m, rtol=1e-12)


BAD = {
    "leaf_area_density_m2_m3: -1.0; want a number from 0 to 1000": {"leaf_area_density_m2_m3": -1.0},
    "leaf_area_density_m2_m3: missing": {"leaf_area_density_m2_m3": None},
    "leaf_angle: 'erectofile'; want erectophile": {"leaf_angle": "erectofile"},
    "leaf_angle.ellipsoidal: 0; want a number from 0.01 to 100": {"leaf_angle": {"ellipsoidal": 0}},
    "leaf_reflectance: 1.5; want a number from 0 to 1": {"leaf_reflectance": 1.5},
    "leaf_reflectance: missing": {"leaf_reflectance": None},
    "leaf_size_m: 5; want a number from 0.001 to 2 m": {"leaf_size_m": 5},
    "densty: unknown key": {"densty": 1},
}


@pytest.mark.parametrize("reported", BAD)
def test_bad_leaves_are_refused_with_their_place(tmp_path: Path, reported: str) -> None:
    entry = {"leaf_area_density_m2_m3": 2.0, "leaf_reflectance": 0.5, **BAD[reported]}
    entry = {key: value for key, value in entry.items() if value is not None}
    with pytest.raises(ScenarioError, match=r"scene.yaml:\d+: materials.hedge.foliage.") as caught:
        build(tmp_path, [hedge()], materials={"hedge": {"foliage": entry}})
    assert reported in str(caught.value)


def test_leaves_beside_a_surface_and_in_no_body_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ScenarioError, match=r"materials.hedge.rho: given beside foliage; want"):
        build(tmp_path, [hedge()], materials={"hedge": {**leaves(), "rho": 0.5}})
    with pytest.raises(SceneError, match=r"world.0..plane: .* enclose nothing for the leaves of hedge; want a closed"):
        build(tmp_path, [plate(5.0, "hedge")], materials={"hedge": leaves()})
    with pytest.raises(SceneError, match=r"beside each other; want foliage.leaf_size_m of at least"):
        build(tmp_path, [hedge(500.0)], materials={"hedge": leaves(leaf_size_m=0.001)})


def test_like_changes_single_keys_of_leaves(tmp_path: Path) -> None:
    text = {"schema": 1, "materials": {"a": leaves(3.0)}, "world": [hedge(material="a")], "sensors": []}
    path = tmp_path / "scene.yaml"
    path.write_text(json.dumps(text | {"sensors": [{"id": "f", "model": "paper-905nm"}]}), encoding="utf-8")
    world = scene.build(scenario.load(str(path)))
    assert world.materials == ("a",)
    assert dataclasses.is_dataclass(world.bodies[0])
