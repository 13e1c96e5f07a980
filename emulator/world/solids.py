"""Building blocks of the meshes that come with the package: closed solids from few numbers, and the GLB file of them.

Belongs here: boxes, lofts, tubes, blobs, putting them together by part, writing. Not: what a car looks like (meshes),
reading mesh files (mesh_files). Axes as everywhere: x forward, y left, z up, metres.
"""

from __future__ import annotations

import json
import math
import struct
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Longs = NDArray[np.int64]

DECIMALS = 4
"Coordinates are rounded to 0.1 mm, so that the same code writes the same file on every machine."


@dataclass(frozen=True, eq=False)
class Solid:
    """Triangles, each with the name of its part."""

    vertices: Floats
    "(v, 3)"
    faces: Longs
    "(f, 3) counter-clockwise seen from outside."
    part: tuple[str, ...]
    "(f,)"

    def moved(self, at: Sequence[float], yaw_deg: float = 0.0, pitch_deg: float = 0.0) -> Solid:
        """Turned by pitch about y, then by yaw about z, then shifted."""
        cp, sp = math.cos(math.radians(pitch_deg)), math.sin(math.radians(pitch_deg))
        cy, sy = math.cos(math.radians(yaw_deg)), math.sin(math.radians(yaw_deg))
        about_y = np.array([[cp, 0.0, sp], [0.0, 1.0, 0.0], [-sp, 0.0, cp]])
        about_z = np.array([[cy, -sy, 0.0], [sy, cy, 0.0], [0.0, 0.0, 1.0]])
        return Solid(self.vertices @ (about_z @ about_y).T + np.asarray(at), self.faces, self.part)


def joined(solids: Sequence[Solid]) -> Solid:
    """Several solids as one."""
    offsets = np.cumsum([0, *(len(solid.vertices) for solid in solids)])
    return Solid(
        np.concatenate([solid.vertices for solid in solids]),
        np.concatenate([solid.faces + offset for solid, offset in zip(solids, offsets, strict=False)]),
        tuple(name for solid in solids for name in solid.part),
    )


def block(part: str, low: Sequence[float], high: Sequence[float]) -> Solid:
    """A box between two corners."""
    x, y, z = zip(low, high, strict=True)
    corners = np.array([[x[i], y[j], z[k]] for k in (0, 1) for j in (0, 1) for i in (0, 1)], dtype=np.float64)
    quads = [(0, 2, 3, 1), (4, 5, 7, 6), (0, 1, 5, 4), (2, 6, 7, 3), (0, 4, 6, 2), (1, 3, 7, 5)]
    faces = np.array([face for p, q, r, s in quads for face in ((p, q, r), (p, r, s))])
    return Solid(corners, faces, (part,) * len(faces))


def loft(rings: Floats, part: Callable[[int, int], str]) -> Solid:
    """A closed skin over rings (n, k, 3) one behind the other, flat at both ends.

    Seen along the direction from the first ring to the last, rings run clockwise. `part` names the strip between ring i
    and the next, point j and the next; the ends are strips -1 and n - 1.
    """
    count, size = rings.shape[:2]
    vertices = np.concatenate([rings.reshape(-1, 3), rings[[0, -1]].mean(axis=1)])
    faces, parts = [], []
    for j in range(size):
        k = (j + 1) % size
        for i in range(count - 1):
            a, b, c, d = i * size + j, i * size + k, (i + 1) * size + k, (i + 1) * size + j
            faces += [(a, b, c), (a, c, d)]
            parts += [part(i, j)] * 2
        faces.append((count * size, k, j))
        parts.append(part(-1, j))
        last = (count - 1) * size
        faces.append((count * size + 1, last + j, last + k))
        parts.append(part(count - 1, j))
    return Solid(vertices, np.array(faces), tuple(parts))


def tube(part: str, path: Sequence[Sequence[float]], radii: Sequence[float], segments: int = 10) -> Solid:
    """A closed tube along a path of points, each with its radius."""
    points = np.asarray(path, dtype=np.float64)
    along = np.gradient(points, axis=0)
    along /= np.linalg.norm(along, axis=1)[:, None]
    helper = np.where(np.abs(along[:, [2]]) > 0.9, [[1.0, 0.0, 0.0]], [[0.0, 0.0, 1.0]])
    across = np.cross(helper, along)
    across /= np.linalg.norm(across, axis=1)[:, None]
    other = np.cross(along, across)
    angle = 2.0 * math.pi * np.arange(segments) / segments
    spokes = np.cos(angle)[None, :, None] * across[:, None] - np.sin(angle)[None, :, None] * other[:, None]
    rings = points[:, None] + np.asarray(radii, dtype=np.float64)[:, None, None] * spokes
    return loft(rings[::-1], lambda i, j: part)


def blob(part: str, centre: Sequence[float], radii: Sequence[float], segments: int, bumps: float = 0.0) -> Solid:
    """An ellipsoid; `bumps` (share of the radius) makes it uneven like a crown of leaves."""
    rings = segments // 2
    polar = math.pi * np.arange(1, rings) / rings
    around = 2.0 * math.pi * np.arange(segments) / segments
    theta, phi = np.meshgrid(polar, around, indexing="ij")
    swell = 1.0 + bumps * np.sin(5.0 * phi + 3.0 * theta) * np.sin(4.0 * theta)
    unit = (
        np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), -np.cos(theta)], axis=-1) * swell[..., None]
    )
    size = np.asarray(radii, dtype=np.float64)
    grid = unit.reshape(-1, 3) * size
    vertices = np.concatenate([[[0.0, 0.0, -size[2]]], grid, [[0.0, 0.0, size[2]]]]) + np.asarray(centre)
    faces = []
    top = len(vertices) - 1
    for i in range(segments):
        j = (i + 1) % segments
        faces += [(0, 1 + j, 1 + i), (top - segments + i, top - segments + j, top)]
        for ring in range(rings - 2):
            a, b = 1 + ring * segments, 1 + (ring + 1) * segments
            faces += [(a + i, a + j, b + j), (a + i, b + j, b + i)]
    return Solid(vertices, np.array(faces), (part,) * len(faces))


def wheel(part: str, centre: Sequence[float], radius: float, width: float, segments: int = 24) -> Solid:
    """A disc with its axis along y and rounded shoulders."""
    steps = np.array([[-0.5, 0.88], [-0.42, 1.0], [0.42, 1.0], [0.5, 0.88]]) * [width, radius]
    angle = 2.0 * math.pi * np.arange(segments) / segments
    rings = np.zeros((len(steps), segments, 3))
    for ring, (y, r) in zip(rings, steps, strict=True):
        ring[:, 0], ring[:, 1], ring[:, 2] = r * np.cos(angle), y, r * np.sin(angle)
    rings += np.asarray(centre)
    return loft(rings[::-1], lambda i, j: part)


def hoop(part: str, centre: Sequence[float], radius: float, thickness: float, segments: int = 24) -> Solid:
    """A ring in the x-z plane, as a bicycle's tyre."""
    around = 2.0 * math.pi * np.arange(segments) / segments
    across = 2.0 * math.pi * np.arange(6) / 6
    reach = radius - thickness + thickness * np.cos(across)
    vertices = np.stack(
        [
            np.outer(np.cos(around), reach),
            np.tile(thickness * np.sin(across), (segments, 1)),
            np.outer(np.sin(around), reach),
        ],
        axis=-1,
    ).reshape(-1, 3) + np.asarray(centre)
    faces = []
    for i in range(segments):
        for j in range(6):
            a, b = i * 6 + j, i * 6 + (j + 1) % 6
            c, d = (i + 1) % segments * 6 + (j + 1) % 6, (i + 1) % segments * 6 + j
            faces += [(a, c, b), (a, d, c)]
    return Solid(vertices, np.array(faces), (part,) * len(faces))


# ---------------------------------------------------------------- files


@dataclass(frozen=True)
class Node:
    """A mesh placed in a file."""

    name: str
    mesh: str
    at: tuple[float, float, float] = (0.0, 0.0, 0.0)
    yaw_deg: float = 0.0
    scale: float = 1.0


def glb(meshes: Mapping[str, Solid], nodes: Sequence[Node] | None = None) -> bytes:
    """A binary glTF 2.0 file: one mesh a solid, one primitive and material a part.

    Without `nodes` each mesh stands once where it is. glTF's axes are x left, y up, z forward.
    """
    names: dict[str, int] = {}
    binary = bytearray()
    views: list[dict[str, Any]] = []
    accessors: list[dict[str, Any]] = []

    def stored(data: NDArray[Any], kind: str, component: int, target: int) -> int:
        views.append({"buffer": 0, "byteOffset": len(binary), "byteLength": data.nbytes, "target": target})
        accessor = {"bufferView": len(views) - 1, "componentType": component, "count": len(data), "type": kind}
        if kind == "VEC3":
            accessor |= {"min": data.min(axis=0).tolist(), "max": data.max(axis=0).tolist()}
        accessors.append(accessor)
        binary.extend(data.tobytes())
        binary.extend(bytes(-len(binary) % 4))
        return len(accessors) - 1

    entries = []
    for name, solid in meshes.items():
        points = np.round(solid.vertices, DECIMALS)[:, [1, 2, 0]].astype("<f4") + np.float32(0.0)
        primitives = []
        for part in dict.fromkeys(solid.part):
            faces = solid.faces[[one == part for one in solid.part]]
            used, index = np.unique(faces, return_inverse=True)
            material = names.setdefault(part, len(names))
            wide = len(used) > 65535
            positions = stored(points[used], "VEC3", 5126, 34962)
            indices = stored(index.ravel().astype("<u4" if wide else "<u2"), "SCALAR", 5125 if wide else 5123, 34963)
            primitives.append({"attributes": {"POSITION": positions}, "indices": indices, "material": material})
        entries.append({"name": name, "primitives": primitives})
    order = list(meshes)
    placed = [_node(node, order) for node in (nodes or [Node(name, name) for name in order])]
    document = {
        "asset": {"version": "2.0", "generator": "lidaremu"},
        "scene": 0,
        "scenes": [{"nodes": list(range(len(placed)))}],
        "nodes": placed,
        "meshes": entries,
        "materials": [{"name": name} for name in names],
        "accessors": accessors,
        "bufferViews": views,
        "buffers": [{"byteLength": len(binary)}],
    }
    text = json.dumps(document, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 4)
    chunks = struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(binary), b"BIN\0") + binary
    return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks


def _node(node: Node, order: Sequence[str]) -> dict[str, Any]:
    half = math.radians(node.yaw_deg) / 2.0
    return {
        "name": node.name,
        "mesh": order.index(node.mesh),
        "translation": [node.at[1], node.at[2], node.at[0]],
        "rotation": [0.0, round(math.sin(half), 9), 0.0, round(math.cos(half), 9)],
        "scale": [node.scale] * 3,
    }
