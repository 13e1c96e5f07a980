"""Cost of a cast beside the plain embreex cast of the same rays; prints, never fails.

    python -m tests.benchmarks.bench_raycast [--many | --deforming]

The plain cast has every body as it stands at that moment in one structure, built beforehand: what motion, float64 and
truth cost on top of it is the difference. `--many` adds scenes with up to 10 000 far actors; `--deforming` prints what
a mesh that changes its shape costs by slices, beside building the whole mesh anew.
"""

from __future__ import annotations

import dataclasses
import sys
import time
from collections.abc import Callable

import numpy as np
from embreex.mesh_construction import TriangleMesh
from embreex.rtcore_scene import EmbreeScene

from emulator.casting.raycast import Caster
from emulator.scenario import scenario
from emulator.world import scene, triangles
from emulator.world.mesh_frames import Frames
from emulator.world.motion import Steady
from emulator.world.scene import Body, Scene


def median_us(call: Callable[[], object], repeats: int = 60) -> float:
    """Median time of a call."""
    call()
    times = []
    for _ in range(repeats):
        begin = time.perf_counter()
        call()
        times.append(time.perf_counter() - begin)
    return float(np.median(times)) * 1e6


def fan(beams: int, sub_beams: int) -> np.ndarray:
    """A planar half turn, each beam spread over 10 mrad of elevation."""
    azimuth = np.repeat(np.radians(np.linspace(-90.0, 90.0, beams)), sub_beams)
    up = np.tile(np.linspace(-0.005, 0.005, sub_beams) if sub_beams > 1 else [0.0], beams)
    return np.column_stack([np.cos(azimuth) * np.cos(up), np.sin(azimuth) * np.cos(up), np.sin(up)])


def plain(world: Scene, t_s: float) -> EmbreeScene:
    """All bodies as they stand at `t_s`, in one structure."""
    structure = EmbreeScene(robust=True)
    vertices, faces, count = [], [], 0
    for body in world.bodies:
        pose = body.motion.pose(np.array([t_s]))
        vertices.append(body.vertices @ pose.rotation[0].T + pose.position_m[0])
        faces.append(body.faces + count)
        count += len(body.vertices)
    TriangleMesh(structure, np.concatenate(vertices).astype(np.float32), np.concatenate(faces).astype(np.int32))
    return structure


def shipped() -> None:
    """The scenarios that come with the package, from their first sensor."""
    print(
        f"{'scenario':14s} {'triangles':>9s} {'moving':>6s} {'rays':>6s} {'plain us':>9s} {'cast us':>9s} {'ratio':>6s}"
    )
    for name in scenario.builtin_names():
        config = scenario.load(name)
        world = scene.build(config)
        caster = Caster(world)
        for beams, sub_beams in ((361, 1), (361, 61)):
            direction = fan(beams, sub_beams)
            times = np.repeat(2.0 + np.arange(beams) * 0.01333 / 720.0, sub_beams)
            pose = world.sensor_pose(config.sensors[0].mount, times)
            direction = np.einsum("nij,nj->ni", pose.rotation, direction)
            structure = plain(world, 2.0)
            origin32, direction32 = pose.position_m.astype(np.float32), direction.astype(np.float32)
            raw = median_us(lambda s=structure, o=origin32, d=direction32: s.run(o, d, output=1))
            own = median_us(lambda c=caster, p=pose.position_m, d=direction, t=times: c.first_hits(p, d, t))
            triangles_in_all = sum(len(body.faces) for body in world.bodies)
            moving = sum(not body.motion.still for body in world.bodies)
            row = f"{name:14s} {triangles_in_all:9d} {moving:6d} {len(direction):6d} {raw:9.0f} {own:9.0f}"
            print(f"{row} {own / raw:6.1f}")


def many_actors() -> None:
    """Far actors, resting and moving, around a near scene: build time and cost of a scan that cannot see them."""
    ball = triangles.sphere(1.0, 32)
    wall = Body(0, triangles.plane(6.0, 60.0), np.zeros(1, np.int32), Steady((8.0, 0.0, 0.0), pitch_deg=-90.0))
    direction = fan(361, 1)
    print(f"\n{'far actors':>10s} {'moving':>6s} {'build s':>8s} {'cast us':>8s} {'within 80 m us':>15s}")
    for count in (0, 10, 100, 1000, 10_000):
        for moving in (False, True):
            rng = np.random.default_rng(1)
            bodies = [wall]
            for number in range(count):
                angle, away = rng.uniform(0.0, 2.0 * np.pi), rng.uniform(150.0, 900.0)
                at = (float(away * np.cos(angle)), float(away * np.sin(angle)), 0.0)
                velocity = (float(moving), 0.0, 0.0)
                bodies.append(Body(number + 1, ball, np.zeros(1, np.int32), Steady(at, velocity_m_s=velocity)))
            names = ("world", *(str(number) for number in range(count)))
            world = Scene(names, names, tuple(body.motion for body in bodies), ("m",), tuple(bodies))
            begin = time.perf_counter()
            caster = Caster(world)
            build = time.perf_counter() - begin
            times = 1.0 + np.arange(361) * 0.01333 / 720.0
            own = median_us(lambda c=caster, t=times: c.first_hits(np.zeros(3), direction, t), 20)
            near = median_us(lambda c=caster, t=times: c.first_hits(np.zeros(3), direction, t, max_range_m=80.0), 20)
            print(f"{count:10d} {moving!s:>6s} {build:8.2f} {own:8.0f} {near:15.0f}")


def deforming() -> None:
    """A ball of so many triangles, 2 m across and 5 m away, that becomes an egg: one sweep at one instant."""
    print(f"{'triangles':>9s} {'rays':>6s} {'handed over':>11s} {'slice ms':>9s} {'rebuild ms':>10s} {'ratio':>6s}")
    for segments in (32, 100, 316):
        ball = triangles.sphere(1.0, segments)
        shapes = np.stack([ball.vertices, ball.vertices * [1.2, 0.9, 1.0]])
        frames = Frames(shapes, ball.faces, 1.0, 0.0, True)
        body = Body(1, dataclasses.replace(ball, radius=1.3), np.zeros(1, np.int32), Steady((5.0, 0.0, -1.0)), frames)
        world = Scene(("world", "it"), ("unknown",) * 2, (Steady(), body.motion), ("m",), (body,))
        caster = Caster(world)
        for sub_beams in (1, 61):
            direction = fan(361, sub_beams)
            number = iter(range(1_000_000))
            before = caster._moving._slices[0].handed_over
            caster.first_hits(np.zeros(3), direction, 0.2)
            handed_over = caster._moving._slices[0].handed_over - before
            own = cpu_us(lambda c=caster, d=direction, n=number: c.first_hits(np.zeros(3), d, 0.01 * next(n)))
            whole = cpu_us(lambda f=frames, d=direction: rebuilt(f, d), 7)
            row = f"{len(ball.faces):9d} {len(direction):6d} {handed_over:11d} {own / 1e3:9.2f} {whole / 1e3:10.2f}"
            print(f"{row} {whole / own:6.1f}")


def rebuilt(frames: Frames, direction: np.ndarray) -> None:
    """embreex alone: vertices at an instant, a structure of all triangles, the cast."""
    structure = EmbreeScene(robust=True)
    points = (frames.at(0.2) + np.array([5.0, 0.0, -1.0])).astype(np.float32)
    TriangleMesh(structure, points, frames.faces.astype(np.int32))
    structure.run(np.zeros_like(direction, np.float32), direction.astype(np.float32), output=1)


def cpu_us(call: Callable[[], object], repeats: int = 40) -> float:
    """Median CPU time of a call."""
    call()
    times = []
    for _ in range(repeats):
        begin = time.process_time()
        call()
        times.append(time.process_time() - begin)
    return float(np.median(times)) * 1e6


if __name__ == "__main__":
    if "--deforming" in sys.argv:
        deforming()
        sys.exit()
    shipped()
    if "--many" in sys.argv:
        many_actors()
