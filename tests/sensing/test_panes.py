"""Panes that are closed bodies: one pane each, bent and delayed as Snell has it; absorption grows with the slant."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from emulator.physics import brdf
from emulator.sensing.measure import Measure
from tests.draws import cases
from tests.sensing import joins
from tests.sensing.rig import QUIET, Floats, build, plan, plate

AXIS = {**QUIET, "rule": "axis", "echoes": "all", "max_echoes": 8}
CLEAR: dict[str, Any] = {"visibility_m": 1e9}


def _glass(internal: float, index: float = 1.5) -> dict[str, Any]:
    return {"glass": {"rho": 0.0, "model": "glass", "index": index, "internal": internal}}


def _box(x_m: float, thick_m: float, yaw_deg: float = 0.0, material: str = "glass") -> dict[str, Any]:
    shape = {"size_m": [thick_m, 40.0, 6.0]}
    return {"box": shape, "at_m": [x_m, 0.0, -3.0], "yaw_deg": yaw_deg, "material": material}


def _behind(measure: Measure, beyond_m: float) -> tuple[float, float]:
    """Range and amplitude of what comes from farther than that, once: not between wall and pane and back."""
    found = measure.view(plan()).echoes
    far = (found.range_m > beyond_m) & (found.range_m < beyond_m + 6.0)
    amplitude = found.amplitude[far]
    return float((found.range_m[far] * amplitude).sum() / amplitude.sum()), float(amplitude.sum())


@pytest.mark.parametrize("case", joins.cases("panes"), ids=lambda case: case["name"])
@pytest.mark.parametrize("physics", [AXIS, {**AXIS, "rule": "spiral"}, {**AXIS, "rule": "adaptive"}])
def test_a_closed_box_is_one_pane(tmp_path: Path, case: dict[str, Any], physics: dict[str, Any]) -> None:
    setup = case["setup"]
    world = [_box(6.0 + 2.0 * k, 0.006, setup["incidence_deg"]) for k in range(setup["closed_boxes"])]
    materials = _glass(setup["internal"])
    alone = build(tmp_path, [plate(20.0, "white")], weather=CLEAR, physics=physics)
    behind = build(tmp_path, [*world, plate(20.0, "white")], weather=CLEAR, physics=physics, materials=materials)
    share = _behind(behind, 19.5)[1] / _behind(alone, 19.5)[1]
    # the reference takes the absorption of a ray straight through, whatever the slant
    inside = math.sqrt(1.0 - (math.sin(math.radians(setup["incidence_deg"])) / setup["index"]) ** 2)
    slant = setup["internal"] ** (2.0 * setup["closed_boxes"] * (1.0 / inside - 1.0))
    assert share == pytest.approx(case["expected"]["two_way"] * slant, rel=0.01)


@pytest.mark.parametrize("rule", ["axis", "spiral"])
@pytest.mark.parametrize(
    ("bodies", "glass_m"),
    [([(6.0, 0.01), (6.005, 0.01)], 0.015), ([(6.0, 0.1), (6.0, 0.02)], 0.1),
     ([(6.0, 0.1), (6.0, 0.08), (6.0, 0.02)], 0.1)],
    ids=["overlapping", "one in the other", "three"],
)  # fmt: skip
def test_bodies_of_glass_that_lie_one_in_the_other_are_one_pane(
    tmp_path: Path, rule: str, bodies: list[tuple[float, float]], glass_m: float
) -> None:
    """All light behind them was lost: their faces were more than a ray is continued at."""
    physics = {**AXIS, "rule": rule}
    alone = build(tmp_path, [plate(20.0, "white")], weather=CLEAR, physics=physics)
    world = [*(_box(*one) for one in bodies), plate(20.0, "white")]
    behind = build(tmp_path, world, weather=CLEAR, physics=physics, materials=_glass(1.0))
    range_m, light = _behind(behind, 19.5)
    assert light / _behind(alone, 19.5)[1] == pytest.approx(0.852 * (20.0 / (20.0 + 0.5 * glass_m)) ** 2, abs=0.002)
    assert range_m == pytest.approx(_behind(alone, 19.5)[0] + 0.5 * glass_m, abs=1e-3)


@pytest.mark.parametrize("sheet", [True, False])
def test_the_way_in_the_glass_is_longer_at_a_slant(tmp_path: Path, sheet: bool) -> None:
    """Index 1.5, 0.8 straight through, 60 degrees: 0.412 there and back; 0.456 if the slant were left out."""
    pane = {**plate(6.0, "glass", 40.0, 0.0, 6.0), "yaw_deg": 60.0} if sheet else _box(6.0, 0.006, 60.0)
    alone = build(tmp_path, [plate(20.0, "white")], weather=CLEAR, physics=AXIS)
    behind = build(tmp_path, [pane, plate(20.0, "white")], weather=CLEAR, physics=AXIS, materials=_glass(0.8))
    assert _behind(behind, 19.5)[1] / _behind(alone, 19.5)[1] == pytest.approx(0.412, abs=0.002)


@pytest.mark.parametrize("turn_deg", [0.0, 30.0, 60.0])
@pytest.mark.parametrize("thick_m", [0.006, 0.01, 0.5])
def test_a_slab_delays_and_shifts_the_beam(tmp_path: Path, thick_m: float, turn_deg: float) -> None:
    """t (sqrt(n^2 - sin^2 i) - cos i) longer to a wall across; beside by t sin i (1 - cos i / sqrt(n^2 - sin^2 i))."""
    i, n = math.radians(turn_deg), 1.5
    root = math.sqrt(n * n - math.sin(i) ** 2)
    longer_m = thick_m * (root - math.cos(i))
    measure = build(
        tmp_path, [_box(6.0, thick_m, turn_deg), plate(20.0, "white")], weather=CLEAR, physics=AXIS,
        materials=_glass(1.0),
    )  # fmt: skip
    assert _behind(measure, 19.5)[0] == pytest.approx(20.0 + longer_m, abs=3e-5)
    # a wall that leans tells where across the beam meets it: 1 m farther for each metre to the side
    lean = {**plate(20.0, "white"), "yaw_deg": 45.0}
    leaning = build(
        tmp_path, [_box(6.0, thick_m, turn_deg), lean], weather=CLEAR, physics=AXIS, materials=_glass(1.0)
    )  # fmt: skip
    beside_m = thick_m * math.sin(i) * (1.0 - math.cos(i) / root)
    assert abs(_behind(leaning, 15.0)[0] - 20.0 - longer_m) == pytest.approx(beside_m, abs=5e-5)


def _snell(start: Floats, ray: Floats, radius: float, centre: Floats, n: float) -> tuple[float, Floats, Floats]:
    """A ray through a ball of glass: optical length to where it comes out, that place, the direction there."""

    def bend(ray: Floats, normal: Floats, ratio: float) -> Floats:
        across = ray - (ray @ normal) * normal
        sine = ratio * np.linalg.norm(across)
        side = across / max(np.linalg.norm(across), 1e-300)
        return np.asarray(sine * side + math.copysign(math.sqrt(1.0 - sine * sine), ray @ normal) * normal)

    to = centre - start
    along = to @ ray
    near = along - math.sqrt(radius**2 - (to @ to - along**2))
    first = start + near * ray
    inside = bend(ray, (first - centre) / radius, 1.0 / n)
    chord = -2.0 * ((first - centre) @ inside)
    last = first + chord * inside
    return near + n * chord, last, bend(inside, (last - centre) / radius, n)


@pytest.mark.parametrize("offset_m", [0.0, 0.2, 0.4])
def test_a_ball_of_glass_is_a_lens(tmp_path: Path, offset_m: float) -> None:
    """Against Snell's law on a true sphere; the product's has facets."""
    ball = {"sphere": {"radius_m": 1.0, "segments": 512}, "at_m": [6.0, offset_m, -1.0], "material": "glass"}
    measure = build(tmp_path, [ball, plate(9.0, "white")], weather=CLEAR, physics=AXIS, materials=_glass(1.0))
    way, place, ray = _snell(np.zeros(3), np.array([1.0, 0.0, 0.0]), 1.0, np.array([6.0, offset_m, 0.0]), 1.5)
    expected = way + (9.0 - place[0]) / ray[0]
    assert _behind(measure, 8.0)[0] == pytest.approx(expected, abs=0.01)


def test_a_hollow_box_is_two_panes(tmp_path: Path) -> None:
    """A show case of sheets: light goes in by one and out by the other."""
    sheets = [{**plate(x, "glass", 2.0, 0.0, 2.0)} for x in (6.0, 7.0)]
    alone = build(tmp_path, [plate(20.0, "white")], weather=CLEAR, physics=AXIS)
    behind = build(tmp_path, [*sheets, plate(20.0, "white")], weather=CLEAR, physics=AXIS, materials=_glass(1.0))
    share = _behind(behind, 19.5)[1] / _behind(alone, 19.5)[1]
    assert share == pytest.approx((1.0 / 1.08333333) ** 4 * 1.0, rel=0.01)


def test_what_stands_in_the_glass_is_seen(tmp_path: Path) -> None:
    inset = plate(6.2, "white", 1.0, 0.0, 1.0)
    measure = build(tmp_path, [_box(6.0, 1.0), inset], weather=CLEAR, physics=AXIS, materials=_glass(1.0))
    assert _behind(measure, 6.0)[0] == pytest.approx(6.2, abs=1e-3)


def test_a_sensor_in_a_dome_looks_through_one_pane(tmp_path: Path) -> None:
    dome = {"box": {"size_m": [1.0, 1.0, 1.0]}, "at_m": [0.0, 0.0, -0.5], "material": "glass"}
    alone = build(tmp_path, [plate(20.0, "white")], weather=CLEAR, physics=AXIS)
    behind = build(tmp_path, [dome, plate(20.0, "white")], weather=CLEAR, physics=AXIS, materials=_glass(1.0))
    assert _behind(behind, 19.5)[1] / _behind(alone, 19.5)[1] == pytest.approx(0.852071, rel=1e-4)


@settings(max_examples=cases(60), deadline=None)
@given(st.floats(0.0, 1.0), st.floats(1.0, 3.0), st.floats(0.0, 1.55))
def test_a_pane_by_its_series_of_bounces(internal: float, index: float, incidence: float) -> None:
    """Against the sum over the bounces between the faces, one after another."""
    inner = math.asin(math.sin(incidence) / index)
    t = internal ** (1.0 / math.cos(inner)) if internal else 0.0
    through = mirrored = 0.0
    rs, rp = (float(one) for one in brdf.fresnel(index, incidence))
    for r in (rs, rp):
        light = 1.0 - r
        mirrored += 0.5 * r
        for bounce in range(400):
            light *= t
            if bounce % 2 == 0:
                through += 0.5 * light * (1.0 - r)
            else:
                mirrored += 0.5 * light * (1.0 - r)
            light *= r
    cosine = math.cos(incidence)
    assert float(brdf.pane_internal_transmission_cos(index, cosine, internal)) == pytest.approx(through, abs=1e-6)
    assert float(brdf.pane_reflection_cos(index, cosine, internal)) == pytest.approx(mirrored, abs=1e-6)
