"""Ray casters of others on the triangles of a scene, as they stand at one instant: embreex, Open3D, MuJoCo.

Belongs here: how each is given triangles and rays. Not: which rays, and what is printed (bench_layers). Open3D and
MuJoCo are no part of any extra: `python -m pip install open3d mujoco` into an environment of its own.
"""

from __future__ import annotations

import importlib
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any, TypeAlias

import numpy as np

from emulator.world.scene import Body, Scene
from emulator.world.triangles import Floats, Geometry

Cast: TypeAlias = Callable[[], Any]
"Casts all rays once; what it answers is for `Other.ranges_m`."
Ready: TypeAlias = tuple[Cast, Callable[[Any], Floats]]
"A cast, and distances (n,) out of what it answers, not finite: nothing."
NEAR_M = 1e-3
"Casters agree on a ray where their distances differ by so much at the most, or both meet nothing."


def finer(world: Scene, triangles: int) -> Scene:
    """The same surfaces of so many triangles or more: each is cut into four, until there are."""
    while sum(len(body.faces) for body in world.bodies) < triangles:
        cut = {id(shape): _quartered(shape) for body in world.bodies for shape in (body.geometry,)}
        world = replace(world, bodies=tuple(replace(one, geometry=cut[id(one.geometry)]) for one in world.bodies))
    return world


def _quartered(shape: Geometry) -> Geometry:
    corners = shape.vertices[shape.faces]
    middles = (corners + np.roll(corners, -1, axis=1)) / 2.0  # the same bits on both sides of an edge
    (a, b, c), (ab, bc, ca) = corners.transpose(1, 0, 2), middles.transpose(1, 0, 2)
    vertices = np.stack([a, ab, ca, ab, b, bc, ca, bc, c, ab, bc, ca], axis=1).reshape(-1, 3)
    columns = {name: np.repeat(getattr(shape, name), 4, axis=0) for name in ("face_part", "normals", "closed")}
    faces = np.arange(len(vertices), dtype=np.int32).reshape(-1, 3)
    return replace(shape, vertices=vertices, faces=faces, **columns)


def posed(body: Body, t_s: float) -> Floats:
    """(v, 3) vertices of a body in the world at an instant."""
    pose = body.motion.pose(np.array([t_s]))
    vertices = body.vertices if body.frames is None else body.frames.at(t_s)
    return np.asarray(vertices @ pose.rotation[0].T + pose.position_m[0])


def joined(world: Scene, t_s: float) -> tuple[Floats, Any]:
    """Vertices (v, 3) and triangles (f, 3) of all bodies together."""
    vertices = [posed(body, t_s) for body in world.bodies]
    before = np.cumsum([0, *map(len, vertices)])
    faces = [body.faces + first for body, first in zip(world.bodies, before[:-1], strict=True)]
    return np.concatenate(vertices), np.concatenate(faces)


def _embreex(world: Scene, t_s: float, origin_m: Floats, direction: Floats) -> Ready:
    from embreex.mesh_construction import TriangleMesh
    from embreex.rtcore_scene import EmbreeScene

    made = EmbreeScene(robust=True)
    vertices, faces = joined(world, t_s)
    TriangleMesh(made, vertices.astype(np.float32), faces.astype(np.int32))
    rays = np.broadcast_to(origin_m, direction.shape).astype(np.float32), direction.astype(np.float32)
    return (
        lambda: made.run(*rays, output=1),
        lambda found: np.where(found["primID"] >= 0, found["tfar"], np.inf).astype(np.float64),
    )


def _open3d(world: Scene, t_s: float, origin_m: Floats, direction: Floats) -> Ready:
    o3d = importlib.import_module("open3d")
    made, (vertices, faces) = o3d.t.geometry.RaycastingScene(nthreads=1), joined(world, t_s)
    made.add_triangles(o3d.core.Tensor(vertices.astype(np.float32)), o3d.core.Tensor(faces.astype(np.uint32)))
    rays = o3d.core.Tensor(np.hstack([np.broadcast_to(origin_m, direction.shape), direction]).astype(np.float32))
    return lambda: made.cast_rays(rays, nthreads=1), lambda found: found["t_hit"].numpy().astype(np.float64)


def _mujoco(world: Scene, t_s: float, origin_m: Floats, direction: Floats) -> Ready:
    """A geom a body, without collisions: MuJoCo has a bounding volume hierarchy for each mesh."""
    mujoco = importlib.import_module("mujoco")
    spec = mujoco.MjSpec()
    for number, body in enumerate(world.bodies):
        vertices = posed(body, t_s).astype(np.float32)
        spec.add_mesh(
            name=f"m{number}", uservert=vertices.ravel(), userface=body.faces.astype(np.int32).ravel(),
            inertia=mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL,
        )  # fmt: skip
        spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_MESH, meshname=f"m{number}", contype=0, conaffinity=0)
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    count = len(direction)
    rays, geoms, ranges_m = direction.astype(np.float64).ravel(), np.zeros(count, np.int32), np.zeros(count)

    def cast() -> Floats:
        mujoco.mj_multiRay(model, data, origin_m, rays, None, 1, -1, geoms, ranges_m, None, count, mujoco.mjMAXVAL)
        return ranges_m

    return cast, lambda found: np.where(found < 0.0, np.inf, found)


OTHERS: Mapping[str, Callable[[Scene, float, Floats, Floats], Ready]] = {
    "embreex": _embreex,
    "open3d": _open3d,
    "mujoco": _mujoco,
}
"Package -> how it is made ready for rays (n, 3) from one origin (3,); raises `ImportError` where it is not installed."


def agreeing(one_m: Floats, other_m: Floats) -> float:
    """Share of rays of which two casters say the same."""
    with np.errstate(invalid="ignore"):
        near = np.abs(one_m - other_m) <= NEAR_M
    return float(np.mean(near | ~(np.isfinite(one_m) | np.isfinite(other_m))))
