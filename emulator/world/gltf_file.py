"""The triangles of a judged glTF: accessors to arrays, nodes to places, primitives to parts.

Belongs here: numbers, matrices, names of parts. Not: what a file may ask for, and where its bytes are (gltf_guard).
Names of parts and the order of triangles are those of trimesh, which read these files before; skins, morph targets and
cameras are not looked at.
"""

from __future__ import annotations

from collections.abc import Container
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from emulator.config.budgets import MESH, MeshBudget
from emulator.world.gltf_guard import (
    COMPONENTS,
    FAN,
    LINES,
    POINTS,
    STRIP,
    TRIANGLES,
    Judged,
    drawn,
    judged,
    number_of,
    primitives_of,
    width_of,
)
from emulator.world.mesh_maps import MeshMaps, PartMaps, Textures, Wanted

KINDS = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
WHOLE = {5120: 127.0, 5121: 255.0, 5122: 32767.0, 5123: 65535.0}
"What stands for 1 where an accessor is `normalized` (glTF 2.0, 3.11)."

Floats = NDArray[np.float64]
Span = tuple[str, dict[str, Any], int, int]
"Part, table of the primitive, first vertex and number of vertices."
Raw = tuple[Floats, NDArray[np.int64], NDArray[np.int32], tuple[str, ...]]


def load_gltf(path: Path, budget: MeshBudget = MESH) -> Raw:
    """Vertices (v, 3), triangles (f, 3), part of each, names of the parts; `ValueError` for what cannot be read."""
    with ExitStack() as files:
        found = judged(path, budget, files)
        return _triangles(found)[0]


def load_with_maps(path: Path, budget: MeshBudget, wanted: Wanted) -> tuple[Raw, MeshMaps]:
    """The same with colours and normals of some parts."""
    with ExitStack() as files:
        found = judged(path, budget, files)
        raw, spans = _triangles(found, apart=True)
        budget.need("vertices", len(raw[0]), "vertices, those of each primitive counted by themselves")
        return raw, _maps(found, Textures(found, path, budget, files), raw, spans, wanted)


def _maps(found: Judged, textures: Textures, raw: Raw, spans: list[Span], wanted: Wanted) -> MeshMaps:
    uv, normal_uv, colour = (np.full((len(raw[0]), width), np.nan) for width in (2, 2, 3))
    parts: dict[str, tuple[PartMaps, int | None]] = {}
    for name, primitive, first, count in spans:
        if not wanted.has(name):
            continue
        number = number_of(primitive, "material") if "material" in primitive else None
        maps, which, other = textures.of(number)
        if parts.setdefault(name, (maps, number))[0] != maps:
            raise ValueError(f"part {name!r}: materials of one name with different pictures; want names of their own")
        here = slice(first, first + count)
        for target, key, on in ((uv, which, maps.colour), (normal_uv, other, maps.normal)):
            if on.picture >= 0 and f"TEXCOORD_{key}" in primitive["attributes"]:
                target[here] = _attribute(found, primitive, f"TEXCOORD_{key}", ("VEC2",), count)
        if "COLOR_0" in primitive["attributes"]:
            colour[here] = _attribute(found, primitive, "COLOR_0", ("VEC3", "VEC4"), count)[:, :3]
    reported = tuple(parts[name][0] if name in parts else PartMaps() for name in raw[3])
    return MeshMaps(uv, normal_uv, colour, tuple(textures.pictures), reported)


def _attribute(found: Judged, primitive: dict[str, Any], key: str, kinds: tuple[str, ...], count: int) -> Floats:
    """Values of a vertex attribute; whole numbers are shares of their largest."""
    number = number_of(primitive["attributes"], key)
    accessors = found.tree["accessors"]
    if number >= len(accessors) or accessors[number].get("type") not in kinds or accessors[number]["count"] != count:
        raise ValueError(f"{key} is accessor {number}; want one of {' or '.join(kinds)} with {count} elements")
    if "bufferView" not in accessors[number]:
        raise ValueError(f"{key}: accessor {number} without data")
    values = _array(found, number).astype(np.float64) / WHOLE.get(accessors[number]["componentType"], 1.0)
    if not np.isfinite(values).all():
        raise ValueError(f"{key}: numbers that are not finite")
    return values


def _triangles(found: Judged, apart: bool = False) -> tuple[Raw, list[Span]]:
    """Every mesh where its nodes place it: by primitives, then by the names of nodes.

    `apart`: each primitive has its own vertices. And the vertices of every primitive that is drawn.
    """
    tree = found.tree
    places = _places(found)
    names = _names(tree)
    order = {key: number for number, key in enumerate(names)}
    shown = []
    for number in found.nodes:
        node = tree["nodes"][number]
        if "mesh" in node:
            mesh = node["mesh"]
            for item in drawn(tree, mesh):
                shown.append((order[mesh, item[0]], str(node.get("name", number)), number, mesh, item))
    count = {
        (number, item[3], item[0] if apart else 0): tree["accessors"][item[3]]["count"]
        for _, _, number, _, item in shown
    }
    spans: list[Span] = []
    points = np.zeros((sum(count.values()), 3))
    faces = np.zeros((sum(item[4] for *_, item in shown), 3), np.int64)
    part = np.zeros(len(faces), np.int32)
    numbers: dict[str, int] = {}
    arrays: dict[int, NDArray[Any]] = {}
    offsets: dict[tuple[int, int, int], int] = {}
    lists: dict[tuple[int, int], NDArray[np.int64]] = {}
    total = first = 0
    for _, _, number, mesh, (which, primitive, mode, corners, _) in sorted(shown, key=lambda one: one[:3]):
        if corners not in arrays:
            arrays[corners] = _positions(found, corners)
        own = number, corners, which if apart else 0
        if own not in offsets:  # several primitives of a mesh share their vertices
            offsets[own] = total
            points[total : total + len(arrays[corners])] = _placed(arrays[corners], places[number])
            total += len(arrays[corners])
        if (mesh, which) not in lists:
            lists[mesh, which] = _faces(found, primitive, mode, len(arrays[corners]))
        indices = lists[mesh, which]
        name = _material(tree, primitive) or names[mesh, which]
        faces[first : first + len(indices)] = indices + offsets[own]
        part[first : first + len(indices)] = numbers.setdefault(name, len(numbers))
        first += len(indices)
        spans.append((name, primitive, offsets[own], len(arrays[corners])))
    return (points, faces, part, tuple(numbers)), spans


# ---------------------------------------------------------------- numbers


def _array(found: Judged, number: int) -> NDArray[Any]:
    """Elements of an accessor: (n, components)."""
    accessor = found.tree["accessors"][number]
    count, width = accessor["count"], width_of(accessor)
    kind, shape = np.dtype(KINDS[accessor["componentType"]]), COMPONENTS[accessor["type"]]
    data = _bytes(found, accessor, count, width).view(kind).reshape(count, shape)
    sparse = accessor.get("sparse")
    if sparse is None or not sparse["count"]:
        return data
    whole = np.dtype(KINDS[sparse["indices"]["componentType"]])
    at = _bytes(found, sparse["indices"], sparse["count"], whole.itemsize).view(whole).ravel().astype(np.int64)
    if at.max() >= count:
        raise ValueError(f"accessor {number}: sparse element {at.max()}; want one of {count}")
    data = data.copy()
    data[at] = _bytes(found, sparse["values"], sparse["count"], width).view(kind).reshape(-1, shape)
    return data


def _bytes(found: Judged, table: dict[str, Any], count: int, width: int) -> NDArray[np.uint8]:
    """(count, width) bytes of what stands in a bufferView."""
    view = found.tree["bufferViews"][table["bufferView"]]
    stride = max(view.get("byteStride", 0), width)
    start = view.get("byteOffset", 0) + table.get("byteOffset", 0)
    length = (count - 1) * stride + width if count else 0
    data = np.frombuffer(found.buffers[view["buffer"]][1](start, length), np.uint8)
    if len(data) != length:
        raise ValueError("the file became shorter while it was read")
    if stride == width:
        return data.reshape(count, width)
    rows = np.lib.stride_tricks.as_strided(data, (count, width), (stride, 1), writeable=False)
    return np.ascontiguousarray(rows)


def _positions(found: Judged, number: int) -> Floats:
    accessor = found.tree["accessors"][number]
    values = _array(found, number).astype(np.float64)
    kind = accessor["componentType"]
    if accessor.get("normalized") is True and kind in WHOLE:  # KHR_mesh_quantization
        values = np.maximum(values / WHOLE[kind], -1.0)
    return values


def _faces(found: Judged, primitive: dict[str, Any], mode: int, vertices: int) -> NDArray[np.int64]:
    if "indices" in primitive:
        corners = _array(found, primitive["indices"]).ravel().astype(np.int64)
        if len(corners) and (corners.max() >= vertices or corners.min() < 0):
            raise ValueError(f"index {corners.max()}; want one of {vertices} vertices")
    else:
        corners = np.arange(vertices)
    if mode == TRIANGLES:
        return corners.reshape(-1, 3)
    if mode == FAN:
        first = np.full(len(corners) - 2, corners[0])
        return np.column_stack([first, corners[1:-1], corners[2:]])
    strip = np.column_stack([corners[:-2], corners[1:-1], corners[2:]])
    strip[1::2] = strip[1::2, ::-1]
    return strip


# ---------------------------------------------------------------- places


def _placed(points: Floats, place: Floats | None) -> Floats:
    return points if place is None else points @ place[:3, :3].T + place[:3, 3]


@np.errstate(all="ignore")  # what is not finite is refused with the triangle that has it
def _places(found: Judged) -> dict[int, Floats | None]:
    """Matrix (4, 4) of each node; None for one that changes nothing."""
    places: dict[int, Floats | None] = {}
    for number in found.nodes:
        own = _matrix(found.tree["nodes"][number], number)
        above = places[found.parents[number]] if number in found.parents else None
        places[number] = own if above is None else above if own is None else above @ own
    return places


def _matrix(node: dict[str, Any], number: int) -> Floats | None:
    """A node's own matrix, then its translation, rotation and scale (glTF 2.0, 3.5.3)."""
    place = None
    if "matrix" in node:
        place = np.array(_vector(node, "matrix", 16, number)).reshape(4, 4).T.copy()
    if "translation" in node:
        place = _EYE.copy() if place is None else place
        place[:, 3] += place[:, :3] @ _vector(node, "translation", 3, number)
    if "rotation" in node:
        place = _EYE.copy() if place is None else place
        place[:, :3] = place[:, :3] @ _rotation(np.array(_vector(node, "rotation", 4, number)))
    if "scale" in node:
        place = _EYE.copy() if place is None else place
        place[:, :3] *= _vector(node, "scale", 3, number)
    return None if place is None or (place == _EYE).all() else place


_EYE = np.eye(4)


def _vector(node: dict[str, Any], key: str, length: int, number: int) -> list[float]:
    value = node[key]
    if type(value) is not list or len(value) != length or not {type(one) for one in value} <= {int, float}:
        raise ValueError(f"node {number}: {key}; want {length} numbers")
    return [float(one) for one in value]


def _rotation(quaternion: Floats) -> Floats:
    """Of a quaternion x, y, z, w of any length."""
    size = float(quaternion @ quaternion)
    if size < 1e-15:
        return np.eye(3)
    x, y, z, w = quaternion * np.sqrt(2.0 / size)
    return np.array(
        [
            [1.0 - y * y - z * z, x * y - z * w, x * z + y * w],
            [x * y + z * w, 1.0 - x * x - z * z, y * z - x * w],
            [x * z - y * w, y * z + x * w, 1.0 - x * x - y * y],
        ]
    )


# ---------------------------------------------------------------- names


def _material(tree: dict[str, Any], primitive: dict[str, Any]) -> str:
    if "material" not in primitive:
        return ""
    number = number_of(primitive, "material")
    if number >= len(tree["materials"]):
        raise ValueError(f"material {number}; want one of {len(tree['materials'])}")
    name = tree["materials"][number].get("name")
    return "" if name is None else str(name)


def _names(tree: dict[str, Any]) -> dict[tuple[int, int], str]:
    """A name of its own for each primitive that anybody draws: that of its mesh, numbered."""
    found: dict[tuple[int, int], str] = {}
    taken: set[str] = set()
    counts: dict[str, int] = {}
    for mesh, table in enumerate(tree["meshes"]):
        for number, primitive in enumerate(primitives_of(tree, mesh)):
            if primitive.get("mode", TRIANGLES) in (POINTS, LINES, TRIANGLES, STRIP, FAN):
                name = unique_name(str(table.get("name", "GLTF")), taken, counts)
                found[mesh, number] = name
                taken.add(name)
    return found


def unique_name(start: str, taken: Container[str], counts: dict[str, int]) -> str:
    """`start`, or with a number behind it; one that ends in a number counts on."""
    if start and start not in taken:
        return start
    head, _, tail = start.rpartition("_")
    counts_on = bool(head) and tail.isdecimal() and len(tail) < 10
    stem = f"{head}_" if counts_on else f"{start or 'geometry'}_"
    number = max(counts.get(stem, 0), int(tail) if counts_on else 0)
    while f"{stem}{number + 1}" in taken:
        number += 1
    counts[stem] = number + 1
    return f"{stem}{number + 1}"
