"""Mesh files (glTF, GLB, OBJ, STL, PLY) to triangles with named parts, in this project's axes.

Belongs here: reading through trimesh, node transforms, part names, axes. Not: checks of the triangles (triangles).

Axes: x forward, y left, z up, metres. glTF is defined with +y up and +z forward (so +x is left): its (x, y, z) becomes
(z, x, y). OBJ, STL and PLY define no axes and are taken as they are, z up; `up="y"` turns them like glTF, `up="z"`
takes a glTF as it is.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, Literal

import numpy as np
import trimesh

from emulator.errors import SceneError
from emulator.triangles import Geometry, checked

FORMATS = {".glb": "y", ".gltf": "y", ".obj": "z", ".stl": "z", ".ply": "z"}
"Suffix -> the axis that points up in that format unless the scenario says otherwise."
MOST_TRIANGLES = 20_000_000
"Per file: 1e7 triangles build in about a minute and 2 GB."


def load(path: Path, up: Literal["y", "z"] | None, scale: float, where: str) -> Geometry:
    """Triangles of a mesh file; a `SceneError` beginning with `where` for what cannot be used."""
    suffix = path.suffix.lower()
    if suffix not in FORMATS:
        raise SceneError(f"{where}: {path.name}; want a mesh file ending in {', '.join(sorted(FORMATS))}")
    if not path.is_file():
        raise SceneError(f"{where}: {path}: no such file; want a mesh file")
    try:
        loaded = trimesh.load_scene(path, process=False, maintain_order=True)
    except MemoryError:
        raise SceneError(f"{where}: {path.name}: does not fit in memory; want a smaller mesh") from None
    except Exception as exc:  # readers of broken files fail in every way there is
        reason = str(exc).splitlines()[0] if str(exc) else type(exc).__name__
        raise SceneError(
            f"{where}: {path.name}: cannot be read ({reason}); want a mesh in {suffix[1:]} format"
        ) from exc
    vertices, faces, face_part = [], [], []
    parts: dict[str, int] = {}
    offset = 0
    for node in loaded.graph.nodes_geometry:
        transform, name = loaded.graph[node]
        mesh = loaded.geometry[name]
        if not isinstance(mesh, trimesh.Trimesh) or len(mesh.faces) == 0:
            continue
        part = parts.setdefault(_part_name(mesh, str(name)), len(parts))
        points = np.asarray(mesh.vertices, dtype=np.float64)
        if not np.array_equal(transform, np.eye(4)):
            points = points @ np.asarray(transform)[:3, :3].T + np.asarray(transform)[:3, 3]
        indices = np.asarray(mesh.faces, dtype=np.int64)
        if np.linalg.det(np.asarray(transform)[:3, :3]) < 0:
            indices = indices[:, ::-1]  # a mirrored node turns the winding
        vertices.append(points)
        faces.append(indices + offset)
        face_part.append(np.full(len(indices), part, np.int32))
        offset += len(points)
    total = sum(len(one) for one in faces)
    if total == 0:
        raise SceneError(f"{where}: {path.name}: no triangles; want a mesh with at least one")
    if total > MOST_TRIANGLES:
        raise SceneError(f"{where}: {path.name}: {total} triangles; want at most {MOST_TRIANGLES}")
    points = np.concatenate(vertices)
    if (up or FORMATS[suffix]) == "y":
        points = points[:, [2, 0, 1]]
    if scale != 1.0:
        points = points * scale
    return checked(points, np.concatenate(faces), np.concatenate(face_part), tuple(parts), f"{where}: {path.name}")


def _part_name(mesh: Any, name: str) -> str:
    material = getattr(getattr(mesh, "visual", None), "material", None)
    return str(getattr(material, "name", None) or name)
