"""Mesh files (glTF, GLB, OBJ, STL, PLY) to triangles with named parts, in this project's axes.

Belongs here: which reader reads what, what a header promises, axes. Not: glTF (gltf_guard, gltf_file), OBJ (obj_file),
checks of the triangles (triangles), the process in which untrusted files are read (reading_apart).

Axes: x forward, y left, z up, metres. glTF is defined with +y up, +z forward and -x right (glTF 2.0, 3.4): its
(x, y, z) becomes (z, x, y). OBJ, STL and PLY define no axes and are taken as they are, z up; `up="y"` turns them like
glTF, `up="z"` takes a glTF as it is.
"""

from __future__ import annotations

import re
from dataclasses import replace
from io import BytesIO
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from emulator.config.budgets import MESH, MOST_FLOAT_CHARACTERS, MeshBudget, PlainFile, TooMuch, raised
from emulator.errors import SceneError
from emulator.process.quiet_loggers import muted
from emulator.world.gltf_file import Raw, load_gltf, load_with_maps, unique_name
from emulator.world.mesh_maps import Wanted, of_colours
from emulator.world.obj_file import load_obj
from emulator.world.triangles import Geometry, checked

UP = {".glb": "y", ".gltf": "y", ".obj": "z", ".stl": "z", ".ply": "z"}
"Suffix -> the axis that points up in that format unless the scenario says otherwise."
STL_HEAD, STL_TRIANGLE = 84, 50
"Bytes of a binary STL: free text with the number of triangles at its end, then each triangle."
STL_SLICE = 1 << 18
"Triangles of one that are read at a time."
PLY_HEAD = 65_536
"Bytes of a PLY's header that are looked at."
PLY_BYTES = dict.fromkeys(("char", "uchar", "int8", "uint8"), 1) | dict.fromkeys(("short", "ushort"), 2)
PLY_BYTES |= dict.fromkeys(("int16", "uint16"), 2) | dict.fromkeys(("int", "uint", "int32", "uint32"), 4)
PLY_BYTES |= dict.fromkeys(("float", "float32"), 4) | dict.fromkeys(("double", "float64"), 8)


def load(
    path: Path, up: Literal["y", "z"] | None, scale: float, where: str, budget: MeshBudget = MESH,
    wanted: Wanted | None = None,
) -> Geometry:  # fmt: skip
    """Triangles of a mesh file, read here and now; a `SceneError` beginning with `where` for what cannot be used.

    `wanted`: parts of which colours and normals are read too; None: of none.

    Files that an untrusted party may have made are read by `reading_apart`, in a process of its own.
    """
    suffix = path.suffix.lower()
    if suffix not in UP:
        raise SceneError(f"{where}: {path.name}; want a mesh file ending in {', '.join(sorted(UP))}")
    try:
        with muted("trimesh"):
            maps = None
            if wanted is not None and suffix in (".glb", ".gltf"):
                (points, faces, part, names), maps = load_with_maps(path, budget, wanted)
            else:
                points, faces, part, names = READERS[suffix](path, budget)
                colour = None if wanted is None else _vertex_colours(path, suffix, len(points))
                if colour is not None and len(colour) == len(points):
                    maps = of_colours(colour, len(names))
        budget.need("vertices", len(points), "vertices")
        budget.need("triangles", len(faces), "triangles")
        budget.need("items", len(names), "parts")
        if len(faces) == 0:
            raise SceneError(f"{where}: {path.name}: no triangles; want a mesh with at least one")
        if (up or UP[suffix]) == "y":
            points[:] = points[:, [2, 0, 1]]  # in place: a large mesh is not kept twice
        if scale != 1.0:
            points *= scale
        made = checked(points, faces, part, names, f"{where}: {path.name}")
        return made if maps is None else replace(made, maps=maps)
    except SceneError:
        raise
    except FileNotFoundError:
        raise SceneError(f"{where}: {path}: no such file; want a mesh file") from None
    except MemoryError:
        most = f"{budget.memory_bytes} bytes of memory {raised('memory_bytes')}"
        raise SceneError(
            f"{where}: {path.name}: does not fit in memory; want a mesh that needs at most {most}"
        ) from None
    except TooMuch as error:
        raise SceneError(f"{where}: {path.name}: {error}") from None
    except Exception as error:  # readers of broken files fail in every way there is
        reason = " ".join((getattr(error, "strerror", None) or str(error)).split()) or type(error).__name__
        reported = f"{where}: {path.name}: cannot be read ({reason[:200]})"
        raise SceneError(f"{reported}; want a mesh in {suffix[1:]} format") from error


def _vertex_colours(path: Path, suffix: str, count: int) -> NDArray[np.float64] | None:
    """(count, 3) from 0 to 1 as they stand in the file, or None where there are none for every vertex."""
    with PlainFile(path) as file:
        data = file.read()
    if suffix == ".obj":  # behind the place of a vertex, as several programs write them
        rows = [words[4:7] for line in data.splitlines() if len(words := line.split()) >= 7 and words[0] == b"v"]
        return np.array(rows, np.float64) if len(rows) == count else None
    if suffix != ".ply":
        return None
    import trimesh

    wanted: dict[str, Any] = {"skip_materials": True, "fix_texture": False}
    loaded = trimesh.load_scene(BytesIO(data), file_type="ply", process=False, maintain_order=True, **wanted)
    meshes = [one for one in loaded.geometry.values() if isinstance(one, trimesh.Trimesh) and len(one.faces)]
    visuals: list[Any] = [one.visual for one in meshes]
    if not visuals or any(one.kind != "vertex" for one in visuals):
        return None
    return np.concatenate([np.asarray(one.vertex_colors, np.float64)[:, :3] / 255.0 for one in visuals])


def _obj(path: Path, budget: MeshBudget) -> Raw:
    with PlainFile(path) as file:
        budget.need("text_bytes", file.size, "bytes")
        return load_obj(file.read(), path.stem, budget)


# ---------------------------------------------------------------- STL


def _stl(path: Path, budget: MeshBudget) -> Raw:
    with PlainFile(path) as file:
        budget.need("bytes", file.size, "bytes")
        head = file.read(0, STL_HEAD)
        count = int.from_bytes(head[80:], "little")
        if len(head) == STL_HEAD and file.size == STL_HEAD + STL_TRIANGLE * count:
            budget.need("triangles", count, "triangles")
            points = np.zeros((3 * count, 3))
            for first in range(0, count, STL_SLICE):
                data = file.read(STL_HEAD + STL_TRIANGLE * first, STL_TRIANGLE * min(STL_SLICE, count - first))
                rows = np.ascontiguousarray(np.frombuffer(data, np.uint8).reshape(-1, STL_TRIANGLE)[:, 12:48])
                points[3 * first : 3 * (first + len(rows))] = rows.view("<f4").reshape(-1, 3)
            return points, np.arange(3 * count).reshape(-1, 3), np.zeros(count, np.int32), (path.name,)
        budget.need("text_bytes", file.size, "bytes")
        text = file.read()
    try:
        text.decode()
    except UnicodeDecodeError:
        raise ValueError("neither binary nor text in UTF-8") from None
    return _stl_text(text, budget)


def _stl_text(text: bytes, budget: MeshBudget) -> Raw:
    """Solids of a readable STL, each a part; what stands behind the last `endsolid` is not looked at."""
    pieces = re.split(rb"endsolid[^\n]*", text, flags=re.IGNORECASE)[:-1]
    budget.need("items", len(pieces), "solids")
    points, part = [np.zeros((0, 3))], [np.zeros(0, np.int32)]
    names: dict[str, int] = {}
    counts: dict[str, int] = {}
    total = 0
    for piece in pieces:
        head = re.search(rb"solid([^\n]*)", piece, re.IGNORECASE)
        if head is None:
            raise ValueError("an `endsolid` without its `solid`")
        rows = re.findall(rb"vertex([^\n]*)", piece[head.end() :], re.IGNORECASE)
        total += len(rows)
        budget.need("vertices", total, "vertices")
        if not rows:
            continue
        words = b" ".join(rows).split()
        if len(rows) % 3 or len(words) != 3 * len(rows):
            raise ValueError(f"{len(rows)} vertices of {len(words)} numbers; want three of three for each triangle")
        if max(map(len, words)) > MOST_FLOAT_CHARACTERS:
            raise TooMuch(f"a number of {max(map(len, words))} characters; want at most {MOST_FLOAT_CHARACTERS}")
        points.append(np.array(list(map(float, words))).reshape(-1, 3))
        name = unique_name(head.group(1).strip().decode("utf-8", "replace"), names, counts)
        part.append(np.full(len(rows) // 3, names.setdefault(name, len(names)), np.int32))
    every = np.concatenate(points)
    return every, np.arange(len(every)).reshape(-1, 3), np.concatenate(part), tuple(names)


# ---------------------------------------------------------------- PLY


def _ply(path: Path, budget: MeshBudget) -> Raw:
    with PlainFile(path) as file:
        budget.need("bytes", file.size, "bytes")
        _judge_ply(file.read(0, PLY_HEAD), file.size, budget)
        text = file.read()
    return _ply_by_trimesh(text, path.name)


def _judge_ply(start: bytes, size: int, budget: MeshBudget) -> None:
    """What the header promises can stand in the rest of the file, and keeps the budget."""
    head, end, _ = start.partition(b"end_header")
    lines = [line.split() for line in head.decode("ascii", "replace").splitlines()]
    if not end or not lines or lines[0] != ["ply"]:
        raise ValueError(f"no header of a PLY within {PLY_HEAD} bytes")
    text = any(line[:2] == ["format", "ascii"] for line in lines)
    if text:
        budget.need("text_bytes", size, "bytes")
    need = 0
    name, count = "", 0
    for line in lines:
        if line[:1] == ["element"]:
            if len(line) != 3 or not line[2].isdecimal() or len(line[2]) > 18:
                raise ValueError(f"{' '.join(line)[:60]!r}; want a name and a number")
            name, count = line[1], int(line[2])
            limit = {"vertex": "vertices", "face": "triangles"}.get(name, "vertices")
            budget.need(limit, count, {"vertex": "vertices", "face": "faces"}.get(name, f"times {name[:40]}"))
        elif line[:1] == ["property"]:
            kind = line[2] if line[1:2] == ["list"] and len(line) == 5 else line[1] if len(line) == 3 else ""
            if kind not in PLY_BYTES:
                raise ValueError(f"{' '.join(line)[:60]!r}; want a type and a name")
            need += count * (2 if text else PLY_BYTES[kind])  # a digit and what separates it
    room = size - len(head) - len(end)
    if need > room + 1:
        raise ValueError(f"elements of at least {need} bytes; behind its header are {room}")


def _ply_by_trimesh(data: bytes, name: str) -> Raw:
    """Its triangles as one part; pictures are not looked for."""
    import trimesh  # a third of the time that a scenario without files takes to start

    wanted: dict[str, Any] = {"skip_materials": True, "fix_texture": False}
    loaded = trimesh.load_scene(BytesIO(data), file_type="ply", process=False, maintain_order=True, **wanted)
    points, faces = [np.zeros((0, 3))], [np.zeros((0, 3), np.int64)]
    for mesh in loaded.geometry.values():
        if isinstance(mesh, trimesh.Trimesh) and len(mesh.faces):
            faces.append(np.asarray(mesh.faces, dtype=np.int64) + sum(map(len, points)))
            points.append(np.asarray(mesh.vertices, dtype=np.float64))
    every = np.concatenate(faces)
    return np.concatenate(points), every, np.zeros(len(every), np.int32), (name,)


READERS = {".glb": load_gltf, ".gltf": load_gltf, ".obj": _obj, ".stl": _stl, ".ply": _ply}
