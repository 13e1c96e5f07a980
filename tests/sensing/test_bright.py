"""Edges of retroreflectors: the tail of a beam that a bundle of equal shares does not reach."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from emulator.physics.sheeting import classes
from emulator.sensing.error_budget import explained
from tests.sensing import joins
from tests.sensing.rig import build, grey, plan, plate

SILENT = {"noise": False, "false_alarms": False, "range_noise_mm": 0.0}


def _phi(x: float) -> float:
    return 0.5 * math.erfc(-x / math.sqrt(2.0))


def _sheet(coefficient: float) -> dict[str, Any]:
    return {"sheet": {"rho": 0.0, "model": "retro", "retro_cd_lx_m2": coefficient}}


def _optics(parameters: dict[str, Any]) -> dict[str, Any]:
    """The case's own beam: a device's data sheet may be read better one day."""
    return {
        **SILENT, "divergence_deg": math.degrees(2.0 * parameters["theta"]), "exit_diameter_mm": 2e3 * parameters["w0"],
        "system_constant_m2": parameters["k"], "threshold_to_noise": parameters["thr"],
        "floor_reflectance": parameters["floor"] or "off",
    }  # fmt: skip


def _half_plane(x_m: float, edge_m: float) -> dict[str, Any]:
    return plate(x_m, "sheet", 60.0, edge_m + 30.0, 60.0)


@pytest.mark.parametrize("case", joins.cases("retro_edge"), ids=lambda case: case["name"])
def test_a_sheet_beside_the_axis_answers_as_its_share_of_the_beam_says(tmp_path: Path, case: dict[str, Any]) -> None:
    setup, expected = case["setup"], case["expected"]
    parameters, range_m = setup["parameters"], setup["range_m"]
    edge_m = setup["offset_w"] * (math.tan(parameters["theta"]) * range_m + parameters["w0"])
    measure = build(
        tmp_path, [_half_plane(range_m, edge_m)], model=setup["sensor"]["model"], physics=_optics(parameters),
        materials=_sheet(setup["retro_cd_lx_m2"]),
    )  # fmt: skip
    got = float(measure.view(plan()).echoes.amplitude.sum())
    if expected["share"] > 1e-6:
        assert got == pytest.approx(expected["snr"], rel=0.03)
    assert bool(np.isfinite(measure(plan()).range_m[0, 0])) == expected["answers"]


@pytest.mark.parametrize("full", [False, True])
def test_full_sees_the_edge_as_well(tmp_path: Path, full: bool) -> None:
    """1.5 radii off the axis at 20 m, R_A 250: a signal of 119 noise rms, which was not there at all."""
    width_m = math.tan(0.0064565) * 20.0 + 0.005
    measure = build(
        tmp_path, [_half_plane(20.0, 1.5 * width_m)], model="sick-lms291-s05", materials=_sheet(250.0),
        physics={**SILENT, "divergence_deg": math.degrees(0.012913), "full": full},
    )  # fmt: skip
    assert measure.view(plan()).echoes.amplitude.sum() == pytest.approx(119.0, rel=0.01)
    row = next(one for one in explained(measure, plan()) if one["term"] == "tail of the beam")
    assert "sheet in 1 of 1 beams" in row["saves"]
    assert not row["left_out"]


@pytest.mark.parametrize("case", joins.cases("retro_count"), ids=lambda case: case["name"])
def test_a_plate_answers_to_as_many_beams_as_the_closed_form_says(tmp_path: Path, case: dict[str, Any]) -> None:
    setup = case["setup"]
    range_m, step = setup["range_m"], setup["step_deg"]
    measure = build(
        tmp_path, [plate(range_m, "sheet", setup["size_m"][0], 0.0, setup["size_m"][1])],
        model=setup["sensor"]["model"], physics=_optics(setup["parameters"]),
        materials=_sheet(setup["retro_cd_lx_m2"]),
    )  # fmt: skip
    half = math.degrees(0.6 / range_m) + 4.0 * step
    phases = np.arange(25) / 25.0
    grids = [np.arange(-half, half, step) + phase * step for phase in phases]
    answered = np.count_nonzero(np.isfinite(measure(plan(np.concatenate(grids))).range_m[:, 0]))
    assert answered / len(grids) == pytest.approx(case["expected"]["mean_beams"], abs=0.06)


@pytest.mark.parametrize("edge", [0.5, 1.0])
@pytest.mark.parametrize("cover", [1.3, 2.0])
@pytest.mark.parametrize("range_m", [3.0, 10.0])
def test_what_stands_before_the_sheet_takes_its_light(
    tmp_path: Path, edge: float, cover: float, range_m: float
) -> None:
    """A dark plate covers all of it but what lies beyond so many radii."""
    tangent = math.tan(0.0064565)
    edge_m, cover_m = edge * (tangent * 20.0 + 0.005), cover * (tangent * range_m + 0.005)
    physics = {**SILENT, "divergence_deg": math.degrees(0.012913)}
    world = [_half_plane(20.0, edge_m), plate(range_m, "black", 60.0, cover_m - 30.0, 60.0)]
    materials = {**_sheet(250.0), "black": grey(0.0)}
    measure = build(tmp_path, world, model="sick-lms291-s05", materials=materials, physics=physics)
    expected = 45_000.0 * math.pi * 250.0 * _phi(-2.0 * cover) * math.exp(-2.0 * 8.9023e-5 * 20.0) / 400.0
    assert measure.view(plan()).echoes.amplitude.sum() == pytest.approx(expected, rel=0.1)


def test_a_sheet_behind_a_plate_is_not_seen(tmp_path: Path) -> None:
    world = [_half_plane(20.0, 0.1), plate(10.0, "black", 60.0, 0.0, 60.0)]
    materials = {**_sheet(250.0), "black": grey(0.0)}
    measure = build(tmp_path, world, model="sick-lms291-s05", materials=materials, physics=SILENT)
    assert measure.view(plan()).echoes.amplitude.sum() == 0.0


def test_a_sheet_that_moves_is_where_it_is_when_the_beam_fires(tmp_path: Path) -> None:
    width_m = math.tan(0.0064565) * 20.0 + 0.005
    moving = {
        "id": "sign", "shape": {"box": {"size_m": [0.01, 4.0, 4.0]}}, "material": "sheet",
        "motion": {"waypoints": [{"t_s": 0.0, "at_m": [20.0, 2.0, -2.0]}, {"t_s": 10.0, "at_m": [20.0, 12.0, -2.0]}]},
    }  # fmt: skip
    physics = {**SILENT, "divergence_deg": math.degrees(0.012913)}
    measure = build(tmp_path, actors=[moving], model="sick-lms291-s05", materials=_sheet(250.0), physics=physics)
    at_s = np.array([0.0, 0.5, 1.5]) * width_m
    for t_s, offset in zip(at_s, (0.0, 0.5, 1.5), strict=True):
        got = measure.view(plan(start_s=float(t_s))).echoes.amplitude.sum()
        clear = math.exp(-2.0 * 8.9023e-5 * 20.0)
        expected = 45_000.0 * math.pi * 250.0 * _phi(-2.0 * offset) * clear / 19.995**2
        assert got == pytest.approx(expected, rel=0.02)


def test_a_sheet_that_crosses_within_a_sweep_is_found_in_all_its_beams(tmp_path: Path) -> None:
    """It is beside the axis when the first beam fires, and 10 m farther at the last."""
    width_m = math.tan(0.0064565) * 20.0 + 0.005
    moving = {
        "id": "sign", "shape": {"box": {"size_m": [0.01, 4.0, 4.0]}}, "material": "sheet",
        "motion": {"at_m": [20.0, 2.0, -2.0], "velocity_m_s": [0.0, 1.0, 0.0]},
    }  # fmt: skip
    physics = {**SILENT, "divergence_deg": math.degrees(0.012913)}
    measure = build(tmp_path, actors=[moving], model="sick-lms291-s05", materials=_sheet(250.0), physics=physics)
    echoes = measure.view(plan((0.0, 0.0), fire_s=np.array([1.5 * width_m, 10.0]))).echoes
    expected = 45_000.0 * math.pi * 250.0 * _phi(-3.0) * math.exp(-2.0 * 8.9023e-5 * 20.0) / 19.995**2
    assert np.bincount(echoes.beam, echoes.amplitude) == pytest.approx([expected], rel=0.02)


def test_ordinary_edges_cost_no_ray_and_change_no_bit(tmp_path: Path) -> None:
    world = [plate(10.0, "white", 2.0, 1.0, 2.0), plate(14.0, "half")]
    ordinary = build(tmp_path, world, model="sick-lms291-s05")
    grid = plan(np.arange(-20.0, 20.0, 0.5))
    assert ordinary._bright is None
    beside = plate(10.0, "sheet", 1.0, 60.0, 1.0)
    near_one = build(tmp_path, [*world, beside], model="sick-lms291-s05", materials=_sheet(70.0))
    one, other = ordinary.view(grid), near_one.view(grid)
    assert other.tails is not None
    assert other.tails.rays == 0
    for name in ("beam", "range_m", "amplitude"):
        assert np.array_equal(getattr(one.echoes, name), getattr(other.echoes, name))


def test_a_sheet_that_fills_the_beam_is_its_bundles(tmp_path: Path) -> None:
    measure = build(tmp_path, [plate(10.0, "sheet")], model="sick-lms291-s05", materials=_sheet(70.0))
    view = measure.view(plan(np.arange(-3.0, 3.5, 0.5)))
    assert view.tails is not None
    assert not len(view.tails.beams)


def test_two_sweeps_at_rest_are_the_same(tmp_path: Path) -> None:
    measure = build(
        tmp_path, [_half_plane(20.0, 0.1)], model="sick-lms291-s05", materials=_sheet(70.0), physics=SILENT
    )  # fmt: skip
    grid = plan(np.arange(-3.0, 3.5, 0.5))
    one, two = measure(grid), measure(replace(grid, sweep=1, start_ns=10**9))
    assert np.array_equal(one.range_m, two.range_m, equal_nan=True)


@pytest.mark.parametrize("degrees", [0.0, 20.0, 40.0, 55.0])
def test_a_turned_sheet_sends_back_the_integral_over_its_area(tmp_path: Path, degrees: float) -> None:
    """R_A by its definition: intensity over illuminance across the light and over area of the sheet, summed over it."""
    half_rad, range_m, turn = 0.0064565, 15.0, math.radians(degrees)
    sheet = {"sheet": {"rho": 0.0, "model": "retro", "retro_class": "ra2"}}
    turned = {**plate(range_m, "sheet"), "yaw_deg": degrees}
    physics = {**SILENT, "divergence_deg": math.degrees(2.0 * half_rad), "exit_diameter_mm": 0.0, "baseline_mm": 0.0}
    measure = build(tmp_path, [turned], model="sick-lms291-s05", materials=sheet, physics=physics)
    found = float(measure.view(plan()).echoes.amplitude.sum())

    side = np.linspace(-1.0, 1.0, 1201)
    along, up = np.meshgrid(side, side)
    place = np.array([range_m - along * math.sin(turn), along * math.cos(turn), up])
    far = np.sqrt((place**2).sum(axis=0))
    off = np.arctan2(np.hypot(place[1], place[2]), place[0])
    across_w_m2 = 2.0 / (math.pi * half_rad**2) * np.exp(-2.0 * off**2 / half_rad**2) / far**2
    cosine = (place[0] * math.cos(turn) + place[1] * math.sin(turn)) / far
    ra = classes()["ra2"].coefficient(0.0, np.degrees(np.arccos(np.minimum(cosine, 1.0))))
    if degrees > 40.0:  # beyond the table what is sent back goes on to fall, as R_A does
        ra = ra * cosine / math.cos(math.radians(40.0))
    intensity = ra * across_w_m2 * np.exp(-2.0 * 8.9023e-5 * far) / far**2 * (side[1] - side[0]) ** 2
    assert found == pytest.approx(45_000.0 * math.pi * float(intensity.sum()), rel=0.004)
