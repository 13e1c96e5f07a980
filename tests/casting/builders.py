"""Scenes made in a line, without files, and answers found another way than by the caster."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from emulator.world.motion import Motion, Steady
from emulator.world.scene import Body, Scene
from emulator.world.triangles import Geometry

Floats = NDArray[np.float64]


def scene_of(*shapes: tuple[Geometry, Motion]) -> Scene:
    """One actor a shape, all of one material a part."""
    materials: dict[str, int] = {}
    bodies = []
    for number, (geometry, motion) in enumerate(shapes):
        index = [materials.setdefault(part, len(materials)) for part in geometry.parts]
        bodies.append(Body(number + 1, geometry, np.array(index, np.int32), motion))
    names = ("world", *(f"actor{number}" for number in range(len(shapes))))
    motions = (Steady(), *(motion for _, motion in shapes))
    return Scene(names, ("unknown",) * len(names), motions, tuple(materials), tuple(bodies))


def fan(count: int, field_deg: float = 180.0, elevation_deg: float = 0.0) -> Floats:
    """Directions of a planar scan, right to left."""
    azimuth = np.radians(np.linspace(-field_deg / 2.0, field_deg / 2.0, count))
    up = np.full(count, np.radians(elevation_deg))
    return np.column_stack([np.cos(azimuth) * np.cos(up), np.sin(azimuth) * np.cos(up), np.sin(up)])


def random_rays(count: int, seed: int, spread_m: float = 1.0) -> tuple[Floats, Floats]:
    """Origins about the origin and directions all around."""
    rng = np.random.default_rng(seed)
    direction = rng.normal(size=(count, 3))
    return rng.normal(size=(count, 3)) * spread_m, direction / np.linalg.norm(direction, axis=1)[:, None]


def brute_force(corners: Floats, origin: Floats, direction: Floats) -> tuple[Floats, NDArray[np.int64]]:
    """Nearest hit of every ray among triangles (f, 3, 3), in float64: distance (inf: none) and triangle."""
    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
    e1, e2 = b - a, c - a
    p = np.cross(direction[:, None], e2[None])
    det = np.einsum("fj,mfj->mf", e1, p)
    t = origin[:, None] - a[None]
    q = np.cross(t, e1[None])
    with np.errstate(divide="ignore", invalid="ignore"):
        u = np.einsum("mfj,mfj->mf", t, p) / det
        v = np.einsum("mj,mfj->mf", direction, q) / det
        distance = np.einsum("fj,mfj->mf", e2, q) / det
        good = (u >= 0) & (v >= 0) & (u + v <= 1) & (distance > 0)
    distance = np.where(good, distance, np.inf)
    nearest = distance.argmin(axis=1)
    return distance[np.arange(len(origin)), nearest], nearest


def bumpy_wall(seed: int, cells: int = 12, size_m: float = 6.0) -> tuple[Floats, NDArray[np.int64]]:
    """An uneven wall across x, coordinates multiples of 2^-12 m, so that large offsets add exactly."""
    rng = np.random.default_rng(seed)
    side = np.linspace(-size_m, size_m, cells + 1)
    y, z = np.meshgrid(side, side, indexing="ij")
    points = np.column_stack([rng.uniform(-0.4, 0.4, y.size), y.ravel(), z.ravel()])
    points[:, 1:] += rng.uniform(-0.2, 0.2, (y.size, 2))
    points = np.round(points * 4096.0) / 4096.0
    faces = []
    for i in range(cells):
        for j in range(cells):
            a = i * (cells + 1) + j
            faces += [(a, a + 1, a + cells + 2), (a, a + cells + 2, a + cells + 1)]
    return points, np.array(faces)


def joined(parts: Sequence[tuple[Floats, NDArray[np.int64]]]) -> tuple[Floats, NDArray[np.int64]]:
    """Several meshes as one."""
    offsets = np.cumsum([0, *(len(points) for points, _ in parts)])
    faces = [faces + offset for (_, faces), offset in zip(parts, offsets, strict=False)]
    return np.concatenate([points for points, _ in parts]), np.concatenate(faces)
