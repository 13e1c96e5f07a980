"""Bright faces beside beams, by arrays and by loops."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from emulator.compiled.pair import OTHERWISE
from emulator.compiled.sheets import holds
from emulator.physics import polygons
from emulator.sensing import sheets, tails
from emulator.sensing.bright import BrightEdges
from emulator.sensing.measure import Measure
from emulator.sensing.rays import Bundles
from emulator.sensing.sheets import Faced, Frames
from tests.compiled.both import both, called
from tests.draws import cases
from tests.sensing.rig import build, plan

pytest.importorskip("numba")

SHEET = {"sheet": {"rho": 0.0, "model": "retro", "retro_cd_lx_m2": 250.0}}
SHAPES: tuple[dict[str, Any], ...] = (
    {"plane": {"size_m": [0.5, 0.3]}},
    {"box": {"size_m": [0.4, 0.3, 0.6]}},
    {"sphere": {"radius_m": 0.2}},
)


def faced(folder: Path, actors: list[dict[str, Any]], **sensor: Any) -> Faced:
    """What comes near the beams of a sweep of a driven scanner."""
    ego = {"id": "ego", "motion": {"at_m": [0.0, 0.0, 0.0], "velocity_m_s": [8.0, 1.0, 0.0]}}
    measure = build(
        folder, actors=[ego, *actors], model="sick-lms291-s05", materials=SHEET, mount={"actor": "ego"}, **sensor
    )
    return near_beams(measure)[0]


def near_beams(measure: Measure) -> tuple[Faced, Frames, Bundles]:
    """Bright faces near the beams of a sweep, these, and their bundles."""
    assert isinstance(measure._bright, BrightEdges)
    sweep = plan(np.arange(-90.0, 91.0, 1.0), fire_s=np.linspace(0.0, 0.013, 181))
    t_s = 1e-9 * sweep.start_ns + sweep.fire_offset_s
    pose, bundles = measure._pose(t_s), measure._bundles.of(sweep)
    axis = np.einsum("nij,nj->ni", pose.rotation, bundles.axis)
    frames = Frames(pose, bundles.axis, axis, t_s, measure.model.beam)
    return measure._bright._sheets.near(frames, measure._bright._radii(1.0), 90.0), frames, bundles


def same(one: Faced, other: Faced) -> None:
    for name, column in vars(one).items():
        np.testing.assert_allclose(getattr(other, name), column, rtol=1e-9, atol=1e-11, err_msg=name)


@given(seed=st.integers(0, 100_000))
@settings(max_examples=cases(25), deadline=None)
def test_the_same_faces_come_near_the_same_beams(seed: int, tmp_path_factory: pytest.TempPathFactory) -> None:
    rng = np.random.default_rng(seed)
    actors = []
    for k in range(int(rng.integers(1, 12))):
        angle, away = rng.uniform(-1.7, 1.7), rng.uniform(0.3, 40.0)
        motion = {
            "at_m": [away * np.cos(angle), away * np.sin(angle), rng.uniform(-0.3, 0.3)],
            "yaw_deg": rng.uniform(-180, 180),
            "pitch_deg": rng.uniform(-90, 90),
            "velocity_m_s": (rng.normal(size=3) * rng.choice([0.0, 10.0])).tolist(),
            "yaw_rate_deg_s": float(rng.choice([0.0, 300.0])),
        }
        shape = SHAPES[int(rng.integers(len(SHAPES)))]
        actors.append({"id": f"a{k}", "shape": shape, "material": "sheet", "motion": motion})
    folder = tmp_path_factory.mktemp("scene")
    one, other = both(lambda: faced(folder, actors))
    same(one, other)


def test_a_row_of_plates_is_found_by_loops_and_one_that_reaches_behind_a_pupil_by_arrays(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The second by a wide plate through the scanner's own place: its faces are cut, and have six corners."""
    row = [
        {"id": f"a{k}", "shape": SHAPES[0], "material": "sheet", "motion": {"at_m": [9.0, k, 0.0], "pitch_deg": -90.0}}
        for k in range(-5, 6)
    ]
    made: list[bool] = []
    loop = sheets.Sheets.near.pair.loop  # type: ignore[attr-defined]

    def noted(*given: Any) -> Any:
        found = loop(*given)
        made.append(found is not OTHERWISE)
        return found

    monkeypatch.setattr(sheets.Sheets.near.pair, "loop", noted)  # type: ignore[attr-defined]
    one, other = both(lambda: faced(tmp_path, row, physics={"roll_deg": 20.0}))
    same(one, other)
    assert len(one) > 20
    assert made == [True]
    wide = {"plane": {"size_m": [3.0, 30.0]}}
    motion = {"at_m": [0.5, 0.0, 0.0], "pitch_deg": -90.0, "yaw_deg": 80.0}
    one, other = both(lambda: faced(tmp_path, [{"id": "wide", "shape": wide, "material": "sheet", "motion": motion}]))
    same(one, other)
    assert one.corner.shape[1] == 6
    assert made == [True, False]


@given(seed=st.integers(0, 100_000), edges=st.sampled_from([3, 6]), shared=st.booleans())
@settings(max_examples=cases(40), deadline=None)
def test_the_same_places_lie_in_polygons(seed: int, edges: int, shared: bool) -> None:
    rng = np.random.default_rng(seed)
    corner = rng.normal(size=(int(rng.integers(0, 40)), 3, 2)).repeat(edges // 3, axis=1)
    corner[::2] = corner[::2, ::-1]  # the other way around
    place = rng.normal(size=(1 if shared else len(corner), int(rng.integers(0, 60)), 2))
    place[:, :1] = corner[:1, :1] if len(corner) else 0.0  # a corner itself
    one, row = polygons.within(corner, place), [0] * len(corner) if shared else range(len(corner))
    inside = called(holds)
    other = [[inside(corner, k, u, v) for u, v in place[row[k]]] for k in range(len(corner))]
    np.testing.assert_array_equal(np.reshape(other, one.shape), one)


def test_what_both_must_know_stands_twice_alike() -> None:
    from emulator.compiled import sheets as loops

    assert loops.NEAR == polygons.NEAR


@given(seed=st.integers(0, 100_000), edges=st.sampled_from([3, 6]))
@settings(max_examples=cases(40), deadline=None)
def test_polygons_get_the_same_light(seed: int, edges: int) -> None:
    """Also those that have an edge in common, and those far from the axis."""
    rng = np.random.default_rng(seed)
    corner = rng.normal(size=(int(rng.integers(0, 30)), edges // 3, 3, 2)) * float(rng.choice([0.1, 1.0, 3.0]))
    corner = np.sort(corner.reshape(-1, edges, 2), axis=1) if edges == 6 else corner.reshape(-1, 3, 2)
    corner[1::2, :2] = corner[: len(corner) // 2 * 2 : 2, 1::-1]
    for one, other in zip(*both(lambda: polygons.gaussian_share(corner)), strict=True):
        np.testing.assert_allclose(other, one, rtol=1e-7, atol=1e-13)


def rays_to(folder: Path, actors: list[dict[str, Any]], **sensor: Any) -> tuple[tails.Ways, ...]:
    """Rays to what comes near, on rings with and without the middles, and of the bundles."""
    ego = {"id": "ego", "motion": {"at_m": [0.0, 0.0, 0.0], "velocity_m_s": [8.0, 1.0, 0.0]}}
    measure = build(folder, actors=[ego, *actors], materials=SHEET, mount={"actor": "ego"}, **sensor)
    near, frames, bundles = near_beams(measure)
    outer = np.maximum(1.0 + np.arange(len(near)) % 3, near.offset + 0.3)
    every, middle = np.arange(len(near)), near.corner.mean(axis=1)
    return (
        tails.on_rings(near, frames, 0.35, 9, outer, every, middle),
        tails.on_rings(near, frames, 0.08, 48, outer, every[::2], None),
        tails.of_bundles(near, bundles, every % 5 > 0, frames),
    )


@pytest.mark.parametrize("physics", [{}, {"roll_deg": 20.0}, {"divergence_deg": 0.0, "exit_diameter_mm": 60.0}])
@pytest.mark.parametrize("seed", range(4))
def test_the_same_rays_go_to_faces(seed: int, physics: dict[str, Any], tmp_path: Path) -> None:
    """Of beams that open, of turned ones, and of one that stays as wide as its pupil."""
    rng, actors = np.random.default_rng(seed), []
    for k in range(8):
        angle, away = rng.uniform(-1.5, 1.5), rng.uniform(0.5, 30.0)
        motion = {"at_m": [away * np.cos(angle), away * np.sin(angle), 0.0], "yaw_deg": rng.uniform(-180, 180)}
        actors.append({"id": f"a{k}", "shape": SHAPES[k % 3], "material": "sheet", "motion": motion})
    made = both(lambda: rays_to(tmp_path, actors, model="sick-lms291-s05", physics=physics))
    assert all(len(one) > 10 for one in made[0])
    for one, other in zip(*made, strict=True):
        for name, column in vars(one).items():
            np.testing.assert_allclose(getattr(other, name), column, rtol=1e-9, atol=1e-11, err_msg=name)
