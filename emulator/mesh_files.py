"""Mesh files (glTF, GLB, OBJ, STL, PLY) to triangles with named parts, in this project's axes.

Belongs here: reading files, node transforms, part names, axes. Not: checks of the triangles (triangles).

Axes: x forward, y left, z up, metres. glTF is defined with +y up, +z forward and -x right (glTF 2.0, 3.4): its
(x, y, z) becomes (z, x, y). OBJ, STL and PLY define no axes and are taken as they are, z up; `up="y"` turns them like
glTF, `up="z"` takes a glTF as it is.
"""

from __future__ import annotations

from io import BytesIO
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from emulator.errors import SceneError
from emulator.gltf_guard import read_gltf
from emulator.muting import muted
from emulator.obj_file import load_obj
from emulator.triangles import Geometry, checked

UP = {".glb": "y", ".gltf": "y", ".obj": "z", ".stl": "z", ".ply": "z"}
"Suffix -> the axis that points up in that format unless the scenario says otherwise."
MOST_BYTES = 1_000_000_000
"Of one file: 1e7 triangles build in about a minute and 2 GB of memory."
MOST_TEXT_BYTES = 200_000_000
"Of an OBJ file: its lines take about twelve times as much while they are read."
MOST_TRIANGLES = 20_000_000
"After every node has drawn its mesh: a short file may draw a large mesh often."
STL_HEAD, STL_TRIANGLE = 84, 50
"Bytes of a binary STL: free text with the number of triangles at its end, then each triangle."

Raw = tuple[NDArray[np.float64], NDArray[np.int64], NDArray[np.int32], tuple[str, ...]]


def load(path: Path, up: Literal["y", "z"] | None, scale: float, where: str) -> Geometry:
    """Triangles of a mesh file; a `SceneError` beginning with `where` for what cannot be used."""
    suffix = path.suffix.lower()
    if suffix not in UP:
        raise SceneError(f"{where}: {path.name}; want a mesh file ending in {', '.join(sorted(UP))}")
    if not path.is_file():
        raise SceneError(f"{where}: {path}: no such file; want a mesh file")
    most = MOST_TEXT_BYTES if suffix == ".obj" else MOST_BYTES
    if path.stat().st_size > most:
        raise SceneError(f"{where}: {path.name}: {path.stat().st_size} bytes; want at most {most}")
    try:
        with muted("trimesh"):
            points, faces, part, names = load_obj(path, MOST_TRIANGLES) if suffix == ".obj" else _load_scene(path)
    except MemoryError:
        raise SceneError(f"{where}: {path.name}: does not fit in memory; want a smaller mesh") from None
    except Exception as exc:  # readers of broken files fail in every way there is
        reason = " ".join(str(exc).split()) or type(exc).__name__
        told = f"{where}: {path.name}: cannot be read ({reason[:200]})"
        raise SceneError(f"{told}; want a mesh in {suffix[1:]} format") from exc
    if len(faces) == 0:
        raise SceneError(f"{where}: {path.name}: no triangles; want a mesh with at least one")
    if (up or UP[suffix]) == "y":
        points = points[:, [2, 0, 1]]
    if scale != 1.0:
        points = points * scale
    return checked(points, faces, part, names, f"{where}: {path.name}")


def _load_scene(path: Path) -> Raw:
    """Every mesh of a file where its nodes place it, in an order that does not depend on the run."""
    import trimesh  # a third of the time that a scenario without files takes to start

    if path.suffix.lower() in (".glb", ".gltf"):
        text, buffers = read_gltf(path, MOST_BYTES)
        resolver: Any = buffers  # looked up by name only
        loaded = trimesh.load_scene(
            BytesIO(text), file_type="gltf", resolver=resolver, process=False, maintain_order=True
        )
    else:
        if path.suffix.lower() == ".stl":
            _refuse_odd_stl(path)
        loaded = trimesh.load_scene(path, process=False, maintain_order=True)
    order = {name: number for number, name in enumerate(loaded.geometry)}
    placed = [(order[loaded.graph[node][1]], str(node), node) for node in loaded.graph.nodes_geometry]
    points, faces, part = [np.zeros((0, 3))], [np.zeros((0, 3), np.int64)], [np.zeros(0, np.int32)]
    names: dict[str, int] = {}
    offset = 0
    count = sum(len(getattr(loaded.geometry[loaded.graph[node][1]], "faces", ())) for _, _, node in placed)
    if count > MOST_TRIANGLES:
        raise ValueError(f"{count} triangles; want at most {MOST_TRIANGLES}")
    for _, _, node in sorted(placed, key=lambda one: one[:2]):
        transform, name = loaded.graph[node]
        mesh = loaded.geometry[name]
        if not isinstance(mesh, trimesh.Trimesh) or len(mesh.faces) == 0:
            continue
        matrix = np.asarray(transform, dtype=np.float64)
        corners = np.asarray(mesh.vertices, dtype=np.float64)
        if not np.array_equal(matrix, np.eye(4)):
            corners = corners @ matrix[:3, :3].T + matrix[:3, 3]
        indices = np.asarray(mesh.faces, dtype=np.int64)  # a mirrored node turns the winding; `checked` turns it back
        number = names.setdefault(_part_name(mesh, str(name)), len(names))
        points.append(corners)
        faces.append(indices + offset)
        part.append(np.full(len(indices), number, np.int32))
        offset += len(corners)
    return np.concatenate(points), np.concatenate(faces), np.concatenate(part), tuple(names)


def _refuse_odd_stl(path: Path) -> None:
    """`ValueError` for neither form of STL: trimesh would guess an encoding, if a library for that is there."""
    with path.open("rb") as file:
        head = file.read(STL_HEAD)
        told_bytes = STL_HEAD + STL_TRIANGLE * int.from_bytes(head[80:], "little")
        if len(head) == STL_HEAD and path.stat().st_size == told_bytes:
            return
        try:
            (head + file.read()).decode()
        except UnicodeDecodeError:
            raise ValueError("neither binary nor text in UTF-8") from None


def _part_name(mesh: Any, name: str) -> str:
    material = getattr(getattr(mesh, "visual", None), "material", None)
    return str(getattr(material, "name", None) or name)
