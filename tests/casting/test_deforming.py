"""Meshes that change their shape: closed forms, the whole mesh built anew, and what a slice hands over."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from emulator.casting.raycast import Caster
from emulator.errors import ScenarioError, SceneError
from emulator.scenario import scenario
from emulator.world import scene, triangles
from emulator.world.mesh_frames import MOST_OFF_M, Frames
from emulator.world.motion import Motion, Steady
from emulator.world.scene import Body, Scene
from emulator.world.triangles import Geometry, checked
from tests.casting.builders import fan, scene_of

QUAD = (np.array([[0, 1, 2], [0, 2, 3]]), ("surface",))


def changing(geometry: Geometry, shapes: np.ndarray, motion: Motion, period_s: float = 1.0, loop: bool = True) -> Scene:
    """A scene with one body whose vertices go through `shapes` (n, v, 3)."""
    frames = Frames(shapes, geometry.faces, period_s, 0.0, loop)
    low, high = frames.box
    centre = 0.5 * (low + high)
    radius = float(np.linalg.norm(shapes - centre, axis=2).max())
    body = Body(1, replace(geometry, centre=centre, radius=radius), np.zeros(1, np.int32), motion, frames)
    return Scene(("world", "it"), ("unknown",) * 2, (Steady(), motion), ("m",), (body,))


def plate(x_m: float, side_m: float = 4.0, y_m: float = 0.0) -> np.ndarray:
    """Corners of a plate across x."""
    h = side_m / 2.0
    return np.array([[x_m, y_m - h, -h], [x_m, y_m + h, -h], [x_m, y_m + h, h], [x_m, y_m - h, h]])


def plate_scene(one: np.ndarray, other: np.ndarray, period_s: float = 1.0, loop: bool = False) -> Scene:
    geometry = checked(one, QUAD[0], np.zeros(2, int), QUAD[1], "plate")
    return changing(geometry, np.stack([one, other]), Steady(), period_s, loop)


def breathing_ball(segments: int) -> tuple[Geometry, np.ndarray]:
    """A ball that becomes an egg and leans over."""
    ball = triangles.sphere(1.0, segments)
    v = ball.vertices
    egg = v * [1.3, 0.8, 1.1] + np.column_stack([0.2 * v[:, 2], 0.1 * np.sin(5.0 * v[:, 2]), 0.0 * v[:, 2]])
    return ball, np.stack([v, egg, v * [0.9, 1.2, 0.9]])


def test_vertices_go_in_straight_lines_and_loop_or_hold() -> None:
    shapes = np.arange(3.0)[:, None, None] * np.ones((3, 4, 3))
    looped = Frames(shapes, QUAD[0], 3.0, 10.0, True)
    for t_s, want in ((10.0, 0.0), (10.5, 0.5), (12.0, 2.0), (12.5, 1.0), (13.0, 0.0), (7.25, 0.25), (310.5, 0.5)):
        np.testing.assert_allclose(looped.at(t_s), want, atol=1e-12)
    held = Frames(shapes, QUAD[0], 3.0, 10.0, False)
    for t_s, want in ((0.0, 0.0), (10.0, 0.0), (11.5, 1.0), (12.25, 1.5), (13.0, 2.0), (99.0, 2.0)):
        np.testing.assert_allclose(held.at(t_s), want, atol=1e-12)
    assert looped.speed_m_s == pytest.approx(2.0 * np.sqrt(3.0))  # back from the last to the first
    assert held.speed_m_s == pytest.approx(np.sqrt(3.0) / 1.5)


def test_every_beam_meets_the_mesh_where_it_is_at_its_own_instant() -> None:
    caster = Caster(plate_scene(plate(5.0), plate(8.0)))  # 3 m/s
    direction = np.broadcast_to([1.0, 0.0, 0.0], (500, 3))
    times = np.linspace(0.1, 0.9, 500)
    hits = caster.first_hits(np.array([0.0, 0.3, 0.2]), direction, times)
    np.testing.assert_allclose(hits.range_m, 5.0 + 3.0 * times, rtol=0.0, atol=1e-12)
    np.testing.assert_allclose(hits.normal, np.broadcast_to([-1.0, 0.0, 0.0], (500, 3)), atol=1e-12)


def test_what_is_met_is_decided_to_a_millimetre_of_an_edge() -> None:
    caster = Caster(plate_scene(plate(5.0, y_m=2.0), plate(5.0, y_m=-1.0)))  # its lower edge from 0 to -3 m, 3 m/s
    direction = np.broadcast_to([1.0, 0.0, 0.0], (4000, 3))
    times = np.linspace(0.2, 0.3, 4000)
    eye = np.column_stack([np.zeros(4000), np.full(4000, -0.75), np.zeros(4000)])
    seen = np.isfinite(caster.first_hits(eye, direction, times).range_m)
    edge = -3.0 * times
    assert seen[edge < -0.75 - MOST_OFF_M].all()
    assert not seen[edge > -0.75 + MOST_OFF_M].any()


@pytest.mark.parametrize("sub_beams", [1, 40])
def test_slices_meet_what_the_whole_mesh_meets_built_anew(sub_beams: int) -> None:
    ball, shapes = breathing_ball(80)
    motion = Steady((4.0, 0.3, -1.2), 20.0, 5.0, 10.0, (3.0, 1.0, 0.0), 40.0)
    world = changing(ball, shapes, motion)
    frames = world.bodies[0].frames
    assert frames is not None
    caster = Caster(world)
    up = np.linspace(-0.4, 0.4, sub_beams) if sub_beams > 1 else np.zeros(1)
    direction = np.concatenate([fan(361, 90.0, angle) for angle in up])
    origin = np.zeros(3)
    for step in (0, 317, 1000):
        t_s = step * frames.step_s  # an instant at which vertices are taken: nothing else differs
        pose = motion.pose(np.array([t_s]))
        vertices = frames.at(t_s) @ pose.rotation[0].T + pose.position_m[0]
        still = replace(checked(vertices, ball.faces, np.zeros(len(ball.faces), int), ("m",), "ball"))
        whole = Caster(scene_of((still, Steady()))).first_hits(origin, direction, t_s)
        hits = caster.first_hits(origin, direction, t_s)
        np.testing.assert_array_equal(np.isnan(hits.range_m), np.isnan(whole.range_m))
        assert np.isfinite(hits.range_m).sum() > 50 * sub_beams
        np.testing.assert_allclose(hits.range_m, whole.range_m, rtol=0.0, atol=5e-5)
        assert (hits.face == whole.face).mean() > 0.99


def test_a_slice_hands_over_a_few_triangles_of_a_hundred_thousand() -> None:
    ball, shapes = breathing_ball(316)
    caster = Caster(changing(ball, shapes, Steady((4.0, 0.0, -1.0))))
    assert len(ball.faces) > 99_000
    caster.first_hits(np.zeros(3), fan(361, 90.0), 0.0)
    handed_over = caster._moving._slices[0].handed_over
    assert 0 < handed_over <= len(ball.faces) / 50
    caster.first_hits(np.zeros(3), -fan(361, 90.0), 0.0)  # away from it
    assert caster._moving._slices[0].handed_over == handed_over


def test_rays_that_come_again_and_the_order_of_sweeps_change_nothing() -> None:
    ball, shapes = breathing_ball(24)
    world = changing(ball, shapes, Steady((4.0, 0.0, -1.0)))
    caster, fresh = Caster(world), Caster(world)
    direction, origin = fan(361, 90.0), np.zeros((361, 3))
    for t_s in (0.7, 0.1, 0.7):
        times = t_s + np.linspace(0.0, 0.013, 361)
        got = caster.first_hits(origin, direction, times, again=True)
        want = fresh.first_hits(origin, direction, times)
        np.testing.assert_array_equal(got.range_m, want.range_m)
        np.testing.assert_array_equal(got.normal, want.normal)
        part = fresh.first_hits(origin[100:200], direction[100:200], times[100:200])
        np.testing.assert_allclose(part.range_m, want.range_m[100:200], rtol=0.0, atol=1e-12)


def test_a_triangle_that_passes_through_a_line_breaks_nothing() -> None:
    one = plate(5.0)
    caster = Caster(plate_scene(one, one * [1.0, -1.0, 1.0]))  # a line in the middle
    direction = np.broadcast_to([1.0, 0.0, 0.0], (11, 3))
    hits = caster.first_hits(np.zeros(3), direction, np.linspace(0.49, 0.51, 11))
    met = np.isfinite(hits.range_m)
    np.testing.assert_allclose(hits.range_m[met], 5.0)
    assert np.isfinite(hits.normal).all()


# ---------------------------------------------------------------- scenario files


def obj(points: np.ndarray, faces: str = "f 1 2 3\nf 1 3 4\n") -> str:
    return "".join(f"v {x} {y} {z}\n" for x, y, z in points) + faces


def loaded(folder: Path, frames: dict[str, object], **files: str) -> scenario.Scenario:
    for name, text in files.items():
        (folder / f"{name}.obj").write_text(text, encoding="utf-8")
    actor = {"id": "it", "shape": {"frames": frames}, "material": "asphalt"}
    path = folder / "test.yaml"
    path.write_text(json.dumps({"schema": 1, "actors": [actor]}), encoding="utf-8")
    return scenario.load(str(path))


def test_frames_of_a_scenario_are_seen(tmp_path: Path) -> None:
    frames = {"meshes": ["a.obj", "b.obj"], "period_s": 2.0, "at_s": 1.0, "loop": False}
    world = scene.build(loaded(tmp_path, frames, a=obj(plate(5.0)), b=obj(plate(7.0))))
    hits = Caster(world).first_hits(np.zeros(3), np.broadcast_to([1.0, 0.0, 0.0], (4, 3)), np.array([0, 1, 2, 9.0]))
    np.testing.assert_allclose(hits.range_m, [5.0, 5.0, 6.0, 7.0], atol=1e-9)
    assert world.bodies[0].radius_m > 1.0
    assert not world.bodies[0].still


@pytest.mark.parametrize(
    ("other", "found"),
    [
        (obj(plate(7.0), "f 1 2 3\n"), "1 triangles on 4 vertices; want 2 on 4 as in the first frame"),
        (obj(plate(7.0), "f 1 2 4\nf 2 3 4\n"), "other triangles; want those of the first frame"),
        (obj(plate(7.0), "usemtl skin\nf 1 2 3\nusemtl top\nf 1 3 4\n"), "other triangles; want"),
    ],
)
def test_frames_of_another_mesh_are_refused(tmp_path: Path, other: str, found: str) -> None:
    frames = {"meshes": ["a.obj", "b.obj"], "period_s": 2.0}
    with pytest.raises(SceneError, match=r"test.yaml:1: actors.it.shape.frames.meshes.1: b.obj") as caught:
        scene.build(loaded(tmp_path, frames, a=obj(plate(5.0)), b=other))
    assert found in str(caught.value)


def test_frames_that_cannot_be_are_refused_with_their_key(tmp_path: Path) -> None:
    with pytest.raises(ScenarioError, match=r"frames.meshes\[1\]: .*no such file"):
        loaded(tmp_path, {"meshes": ["a.obj", "none.obj"], "period_s": 2.0}, a=obj(plate(5.0)))
    with pytest.raises(ScenarioError, match=r"frames.period_s"):
        loaded(tmp_path, {"meshes": ["a.obj", "a.obj"], "period_s": 0.0}, a=obj(plate(5.0)))
    with pytest.raises(ScenarioError, match=r"frames.meshes"):
        loaded(tmp_path, {"meshes": ["a.obj"], "period_s": 1.0}, a=obj(plate(5.0)))
