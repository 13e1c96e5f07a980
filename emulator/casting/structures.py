"""What lies in each structure of the ray caster, and what is known of its triangles.

Belongs here: which bodies are merged, where shapes lie in slots, planes of triangles by global number. Not: rays
(raycast). Nothing here depends on time.

Bodies that never move are merged into a few groups, by place. All others get a slot for their shape: each shape once,
far enough from its neighbours that a ray which begins and ends at the slot's bounding sphere cannot meet another.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from emulator.world.batched_poses import BatchedPoses, Flags, Longs
from emulator.world.mesh_frames import Frames
from emulator.world.scene import Body
from emulator.world.triangles import Floats, Geometry, Ints

CELL_M = 1000.0
"Side of the cells by which resting bodies are merged: 500 m off the origin costs float32 3e-5 m."
MOST_MERGED = 500_000
"Triangles of resting bodies beyond which shapes that occur more than once are stored once instead of merged."
SLOTS = 64
"Shapes a structure: 4 x 4 x 4 keep the slots within a few radii of the origin."
SLOT_PITCH = 2.25
"Distance of neighbouring slots over the largest bounding radius in the structure; > 2."
SPHERE_MARGIN = 1e-4
"Share, and metres, by which bounding spheres are enlarged against rounding."


@dataclass(frozen=True, eq=False)
class Table:
    """Facts of triangles by their global number."""

    plane: Floats
    "(F, 4) unit normal n and n . v of the triangle's plane, in the frame of its structure (merged) or shape (slots)."
    body: Longs
    "(F,) -1 where a shape belongs to several bodies."
    face: Longs
    "(F,) number within the body."
    part: Longs
    closed: Flags

    def __len__(self) -> int:
        return len(self.body)


@dataclass(frozen=True, eq=False)
class Content:
    """Vertices and triangles of one structure, about its own origin."""

    vertices: NDArray[np.float32]
    faces: Ints


@dataclass(frozen=True, eq=False)
class Group:
    """Merged resting bodies; axes as the world's."""

    centre: Floats
    "(3, 1)"
    radius: float
    offset: int
    "Global number of its first triangle."
    content: Content


APART = ("batched", "scale", "shape_reach")
"Of `Movers`, what is not a column of it in every scene."


@dataclass(frozen=True, eq=False)
class Movers:
    """Bodies that are not merged: one column each."""

    body: Longs
    "(b,)"
    structure: Longs
    "(b,) number of the structure; -1 - k: frames number k."
    cell: Floats
    "(3, b) origin of the slot in its structure."
    shift: Longs
    "(b,) from a triangle's number within the structure to its global one."
    centre: Floats
    "(3, b) of the bounding sphere about the body's origin."
    reach: Floats
    "(b,) radius of that sphere, a little enlarged."
    half: Floats
    "(3, b) of the box about that centre along the body's axes, enlarged as much."
    arm: Floats
    "(b,) distance of its centre from the body's origin."
    speed: Floats
    "(b,) bound of the origin's speed; infinite where it jumps."
    batched: BatchedPoses
    scale: Floats | None = None
    "(3, b) of the shape along the body's axes, where `centre` and `reach` are of the scaled one; None: none is scaled."
    shape_reach: Floats | None = None
    "(b,) `reach` of the shapes themselves."

    def chosen(self, which: Longs) -> Movers:
        """Some of them."""
        columns = {name: column.take(which, axis=-1) for name, column in vars(self).items() if name not in APART}
        return Movers(**columns, batched=BatchedPoses([self.batched.motions[mover] for mover in which]))


@dataclass(frozen=True, eq=False)
class Layout:
    """All structures of a scene."""

    groups: tuple[Group, ...]
    slots: tuple[Content, ...]
    movers: Movers
    table: Table
    frames: tuple[tuple[Frames, Floats], ...] = ()
    "Of shapes that change, with the centres of their spheres."


def lay_out(bodies: Sequence[Body], chosen: Sequence[int]) -> Layout:
    """Structures of the `chosen` bodies."""
    merged, single = _divide(bodies, chosen)
    tables: list[Table] = []
    with np.errstate(under="ignore"):  # components below 1e-38 are nothing in float32, products below 1e-308 no length
        groups = [_merged(bodies, members, tables) for members in _cells(bodies, merged)]
        slots, movers, frames = _placed(bodies, single, tables)
    return Layout(tuple(groups), tuple(slots), movers, _joined(tables), tuple(frames))


def _divide(bodies: Sequence[Body], chosen: Sequence[int]) -> tuple[list[int], list[int]]:
    """Indexes of the bodies to merge, and of those that get a slot for their shape."""
    still = [index for index in chosen if bodies[index].still]
    moving = [index for index in chosen if not bodies[index].still]
    if sum(len(bodies[index].faces) for index in still) > MOST_MERGED:
        uses = Counter(id(bodies[index].geometry) for index in chosen)
        repeated = [index for index in still if uses[id(bodies[index].geometry)] > 1]
        once = [index for index in still if uses[id(bodies[index].geometry)] == 1]
        return once, sorted(moving + repeated)
    return still, moving


def _cells(bodies: Sequence[Body], members: Sequence[int]) -> list[list[int]]:
    """Groups of resting bodies that lie near each other."""
    zero = np.zeros(1)
    cells: dict[tuple[int, ...], list[int]] = {}
    for index in members:
        place = bodies[index].motion.pose(zero).to_world(bodies[index].centre_m)[0]
        cells.setdefault(tuple(np.floor(place / CELL_M + 0.5).astype(int).tolist()), []).append(index)
    return list(cells.values())


def _merged(bodies: Sequence[Body], members: Sequence[int], tables: list[Table]) -> Group:
    zero = np.zeros(1)
    poses = [bodies[index].motion.pose(zero) for index in members]
    places = np.array([pose.to_world(bodies[index].centre_m)[0] for pose, index in zip(poses, members, strict=True)])
    radii = np.array([bodies[index].radius_m for index in members])
    low, high = (places - radii[:, None]).min(axis=0), (places + radii[:, None]).max(axis=0)
    centre = np.round(low + (high - low) / 2.0)
    vertices, faces, own, count = [], [], [], 0
    for index, pose in zip(members, poses, strict=True):
        shape, rotation = bodies[index].geometry, pose.rotation[0]
        # about the sphere's centre first: a mesh with UTM coordinates keeps its digits
        place = (pose.position_m[0] - centre) + rotation @ shape.centre
        local = (shape.vertices - shape.centre) @ rotation.T + place
        vertices.append(local)
        faces.append(shape.faces + count)
        own.append(_table_of(shape, shape.normals @ rotation.T, local, index))
        count += len(local)
    radius = float((np.linalg.norm(places - centre, axis=1) + radii).max())
    offset = sum(len(table) for table in tables)
    tables += own
    return Group(centre[:, None], radius + SPHERE_MARGIN * (1.0 + radius), offset, _content(vertices, faces))


def _placed(
    bodies: Sequence[Body], single: Sequence[int], tables: list[Table]
) -> tuple[list[Content], Movers, list[tuple[Frames, Floats]]]:
    rigid = [bodies[index] for index in single if bodies[index].frames is None]
    shapes = sorted({id(body.geometry): body.geometry for body in rigid}.values(), key=_radius)
    offset = sum(len(table) for table in tables)
    contents: list[Content] = []
    home: dict[int, tuple[int, Floats, int]] = {}
    for begin in range(0, len(shapes), SLOTS):
        batch = shapes[begin : begin + SLOTS]
        side = int(np.ceil(len(batch) ** (1 / 3) - 1e-9))
        pitch = SLOT_PITCH * max(shape.radius for shape in batch) * (1.0 + SPHERE_MARGIN) + 4.0 * SPHERE_MARGIN
        vertices, faces = [], []
        points = triangles = 0
        for number, shape in enumerate(batch):
            cell = (np.array([number % side, number // side % side, number // side**2]) - (side - 1) / 2) * pitch
            local = shape.vertices - shape.centre
            home[id(shape)] = (len(contents), cell, offset - triangles)
            tables.append(_table_of(shape, shape.normals, local, -1))
            vertices.append(local + cell)
            faces.append(shape.faces + points)
            points += len(local)
            triangles += len(shape.faces)
            offset += len(shape.faces)
        contents.append(_content(vertices, faces))
    frames: list[tuple[Frames, Floats]] = []
    halves = {id(shape): np.abs(shape.vertices - shape.centre).max(axis=0, initial=0.0) for shape in shapes}
    for body in (bodies[index] for index in single):
        shape = body.geometry
        if body.frames is not None and id(shape) not in home:
            home[id(shape)] = (-1 - len(frames), np.zeros(3), offset)
            low, high = body.frames.box
            halves[id(shape)] = np.maximum(high - shape.centre, shape.centre - low)
            tables.append(_table_of(shape, shape.normals, shape.vertices - shape.centre, -1))
            frames.append((body.frames, shape.centre))
            offset += len(shape.faces)
    homes = [home[id(bodies[index].geometry)] for index in single]
    centre = np.array([bodies[index].centre_m for index in single], np.float64).reshape(-1, 3).T
    reach = np.array([bodies[index].radius_m for index in single], np.float64)
    half = np.array([halves[id(bodies[index].geometry)] for index in single], np.float64).reshape(-1, 3).T.copy()
    movers = Movers(
        np.array(single, np.int64),
        np.array([one[0] for one in homes], np.int64),
        np.ascontiguousarray(np.array([one[1] for one in homes], np.float64).reshape(-1, 3).T),
        np.array([one[2] for one in homes], np.int64),
        np.ascontiguousarray(centre),
        reach * (1.0 + SPHERE_MARGIN) + SPHERE_MARGIN,
        half + SPHERE_MARGIN * (1.0 + reach),
        np.linalg.norm(centre, axis=0),
        np.array([bodies[index].motion.speed_bound_m_s for index in single], np.float64),
        BatchedPoses([bodies[index].motion for index in single]),
    )
    return contents, movers, frames


def _radius(shape: Geometry) -> float:
    return shape.radius


def _content(vertices: Sequence[Floats], faces: Sequence[Ints]) -> Content:
    return Content(
        np.concatenate(vertices).astype(np.float32), np.ascontiguousarray(np.concatenate(faces), dtype=np.int32)
    )


def _table_of(shape: Geometry, normals: Floats, local: Floats, body: int) -> Table:
    points = local[shape.faces[:, 0]]
    plane = np.concatenate([normals, np.einsum("ij,ij->i", normals, points)[:, None]], axis=1)
    count = len(shape.faces)
    return Table(
        plane,
        np.full(count, body, np.int64),
        np.arange(count, dtype=np.int64),
        shape.face_part.astype(np.int64),
        shape.closed,
    )


def _joined(tables: Sequence[Table]) -> Table:
    return Table(
        np.concatenate([np.zeros((0, 4)), *(table.plane for table in tables)]),
        np.concatenate([np.zeros(0, np.int64), *(table.body for table in tables)]),
        np.concatenate([np.zeros(0, np.int64), *(table.face for table in tables)]),
        np.concatenate([np.zeros(0, np.int64), *(table.part for table in tables)]),
        np.concatenate([np.zeros(0, bool), *(table.closed for table in tables)]),
    )
