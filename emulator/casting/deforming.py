"""What rays meet of meshes that change their shape, between two frames.

Belongs here: which triangles a handful of rays can meet, their cast. Not: vertices at an instant (mesh_frames), where
the body is and which rays come near it (raycast), reading the frames (scene).

Vertices go in straight lines from frame to frame. No structure of the whole mesh is ever built: of each instant the
triangles are taken that overlap the box, along the rays' own axes, around the stretches of the rays within the body's
sphere - of a planar scan a slice as thin as its footprints - and only these go into a small structure. A ray that
meets anything meets one of them, so that hits and misses are those of the whole mesh.

Rays are gathered by instants a step apart, so short that no vertex moves farther than a millimetre off in half of it;
the distance to the triangle that is met is then that of the ray's own instant.
"""

from __future__ import annotations

import numpy as np
from embreex.mesh_construction import TriangleMesh
from embreex.rtcore_scene import EmbreeScene
from numpy.typing import NDArray

from emulator.world.mesh_frames import Frames
from emulator.world.triangles import Floats, Ints

Longs = NDArray[np.int64]

BLOCK = 32
"Neighbouring triangles that are looked at together."
ROUNDING = 1e-5
"Share of the size, and metres, by which boxes are enlarged: the caster works in float32."
SUSPICIOUS = 1e-3
"Refined and float32 distance differ by more than this times (1 + distance): a plane seen from its edge."


class Slices:
    """Casts rays on frames, about a centre of the body's."""

    def __init__(self, frames: Frames, centre: Floats) -> None:
        self.frames = frames
        self._centre = centre
        corners = frames.vertices[0][frames.faces].mean(axis=1)
        self._order = _along_a_curve(corners)
        faces = frames.faces[self._order]
        self._faces = faces
        low, high = np.full((len(faces), 3), np.inf), np.full((len(faces), 3), -np.inf)
        for vertices in frames.vertices:
            local = vertices - centre
            for column in faces.T:
                np.minimum(low, local[column], out=low)
                np.maximum(high, local[column], out=high)
        begin = np.arange(0, len(faces), BLOCK)
        low, high = np.minimum.reduceat(low, begin), np.maximum.reduceat(high, begin)
        self._middle, self._half = 0.5 * (low + high), 0.5 * (high - low)
        size = float(np.abs([low, high]).max())
        self._room = ROUNDING * (1.0 + size)
        self.handed_over = 0
        "Triangles put into structures so far."

    def meet(
        self, origin: Floats, ray: Floats, enter: Floats, leave: Floats, t_s: Floats
    ) -> tuple[Longs, Floats, Floats, Floats]:
        """Face (k,) that rays meet between `enter` and `leave`, -1: none; distance; normal (3, k), and its . ray.

        `origin`, `ray` : (3, k) in the body's frame, origins about the centre. Normals by the winding.
        """
        face = np.full(len(t_s), -1, np.int64)
        distance = np.zeros(len(t_s))
        steps = np.rint(t_s / self.frames.step_s)
        for step in np.unique(steps):
            rays = np.flatnonzero(steps == step)
            first, after, share = (one[0] for one in self.frames.between(np.array([step * self.frames.step_s])))
            mine = origin[:, rays], ray[:, rays], enter[rays], leave[rays]
            number, points, corners = self._reached(*mine, int(first), int(after), float(share))
            if not len(number):
                continue
            self.handed_over += len(number)
            structure = EmbreeScene(robust=True)
            TriangleMesh(structure, points.astype(np.float32), np.ascontiguousarray(corners))
            start = (origin[:, rays] + enter[rays] * ray[:, rays]).T.astype(np.float32, order="C")
            along = ray[:, rays].T.astype(np.float32, order="C")
            until = (leave[rays] - enter[rays]).astype(np.float32)
            answer = structure.run(start, along, dists=until, output=1)
            met = np.flatnonzero(answer["primID"] >= 0)
            face[rays[met]] = number[answer["primID"][met]]
            distance[rays[met]] = answer["tfar"][met] + enter[rays[met]]
        normal, facing = np.zeros((3, len(t_s))), np.zeros(len(t_s))
        hit = np.flatnonzero(face >= 0)
        if len(hit):
            got = self._refined(face[hit], origin[:, hit], ray[:, hit], distance[hit], t_s[hit])
            distance[hit], normal[:, hit], facing[hit] = got
        return face, distance, normal, facing

    def _reached(
        self, origin: Floats, ray: Floats, enter: Floats, leave: Floats, first: int, after: int, share: float
    ) -> tuple[Longs, Floats, Ints]:
        """Numbers (s,) of the triangles that overlap the box around the rays' stretches, points, and corners (s, 3)."""
        ends = np.concatenate([origin + enter * ray, origin + leave * ray], axis=1)
        middle = ends.mean(axis=1)
        off = ends - middle[:, None]
        axes = np.linalg.eigh(np.einsum("ik,jk->ij", off, off))[1].T
        span = axes @ ends
        low, high = span.min(axis=1) - self._room, span.max(axis=1) + self._room
        place, room = self._middle @ axes.T, self._half @ np.abs(axes).T
        blocks = np.flatnonzero(np.all((place - room <= high) & (place + room >= low), axis=1))
        rows = (blocks[:, None] * BLOCK + np.arange(BLOCK)).ravel()
        rows = rows[rows < len(self._faces)]
        faces = self._faces[rows]
        mark = np.zeros(self.frames.vertices.shape[1], bool)
        mark[faces] = True
        used = np.flatnonzero(mark)
        begin = self.frames.vertices[first].take(used, axis=0)
        points = begin + share * (self.frames.vertices[after].take(used, axis=0) - begin) - self._centre
        number = np.zeros(len(mark), np.int32)
        number[used] = np.arange(len(used), dtype=np.int32)
        index = number[faces]
        kept = np.ones(len(rows), bool)
        for axis, bottom, top in zip(axes, low, high, strict=True):
            along = points @ axis
            under, over = along < bottom, along > top
            for side in (under, over):
                kept &= ~(side[index[:, 0]] & side[index[:, 1]] & side[index[:, 2]])
        index = index[kept]
        mark = np.zeros(len(points), bool)
        mark[index] = True
        number = np.cumsum(mark, dtype=np.int32) - np.int32(1)
        return self._order[rows[kept]], points[mark], number[index]

    def _refined(
        self, face: Longs, origin: Floats, ray: Floats, distance: Floats, t_s: Floats
    ) -> tuple[Floats, Floats, Floats]:
        """Distance to each triangle's plane at the ray's own instant, its normal, and normal . ray, in float64."""
        first, after, share = self.frames.between(t_s)
        index = self.frames.faces[face]
        begin = self.frames.vertices[first[:, None], index]
        corners = begin + share[:, None, None] * (self.frames.vertices[after[:, None], index] - begin) - self._centre
        normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]).T
        length = np.sqrt(np.einsum("ik,ik->k", normal, normal))
        flat = length == 0.0  # between two frames a triangle may pass through a line
        normal = np.where(flat, -ray, normal / np.where(flat, 1.0, length))
        facing = np.einsum("ik,ik->k", normal, ray)
        with np.errstate(divide="ignore", invalid="ignore"):
            refined = np.einsum("ik,ik->k", normal, corners[:, 0].T - origin) / facing
            good = np.abs(refined - distance) <= SUSPICIOUS * (1.0 + distance)
        return np.maximum(np.where(good & ~flat, refined, distance), 0.0), normal, facing


def _along_a_curve(points: Floats) -> Longs:
    """Order in which neighbours in space are neighbours: by the interleaved bits of their coordinates."""
    low, high = points.min(axis=0), points.max(axis=0)
    cells = ((points - low) / np.maximum(high - low, 1e-12) * 1023.0).astype(np.int64)
    code = np.zeros(len(points), np.int64)
    for bit in range(10):
        for axis in range(3):
            code |= ((cells[:, axis] >> bit) & 1) << (3 * bit + axis)
    return np.argsort(code, kind="stable")
