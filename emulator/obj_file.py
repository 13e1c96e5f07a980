"""OBJ files: vertices, faces and the part each face belongs to.

Belongs here: the text format, as far as shapes and names go. Not: other formats and axes (mesh_files), checks of the
triangles (triangles). trimesh is not used for these: it drops the names of groups, and of materials whose library is
missing, and does not keep the order of the file.
"""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray


def load_obj(
    path: Path, most_triangles: int
) -> tuple[NDArray[np.float64], NDArray[np.int64], NDArray[np.int32], tuple[str, ...]]:
    """Vertices (v, 3), triangles (f, 3), part of each triangle, names of the parts in the order of the file.

    A part is a material (`usemtl`) when the file names any, else an object (`o`) or group (`g`). Polygons become fans.
    `ValueError` names the line of what cannot be read.
    """
    vertices: list[tuple[float, float, float]] = []
    faces: list[tuple[int, int, int]] = []
    by_material: list[str] = []
    by_object: list[str] = []
    material, thing = "", path.stem
    text = path.read_text(encoding="utf-8", errors="replace").replace("\\\n", " ")
    for number, line in enumerate(text.splitlines(), 1):
        words = line.split("#", 1)[0].split()
        if not words:
            continue
        try:
            if words[0] == "v":
                vertices.append((float(words[1]), float(words[2]), float(words[3])))
            elif words[0] == "f":
                if len(faces) + len(words) - 3 > most_triangles:  # a short file may have one face of many corners
                    raise ValueError(f"more than {most_triangles} triangles")
                corners = [_index(word, len(vertices)) for word in words[1:]]
                if len(corners) < 3:
                    raise ValueError("a face of fewer than three corners")
                for second, third in pairwise(corners[1:]):
                    faces.append((corners[0], second, third))
                    by_material.append(material)
                    by_object.append(thing)
            elif words[0] == "usemtl":
                material = " ".join(words[1:])
            elif words[0] in ("o", "g"):
                thing = " ".join(words[1:]) or path.stem
        except (ValueError, IndexError) as exc:
            raise ValueError(f"line {number}: {line.strip()[:60]!r}: {exc}") from None
    names = by_material if any(by_material) else by_object
    names = [name or path.stem for name in names]
    order = {name: number for number, name in enumerate(dict.fromkeys(names))}
    return (
        np.array(vertices, np.float64).reshape(-1, 3),
        np.array(faces, np.int64).reshape(-1, 3),
        np.array([order[name] for name in names], np.int32),
        tuple(order),
    )


def _index(word: str, count: int) -> int:
    """Vertex of a corner like `7`, `7/1`, `7//2`, `-1` (the last so far), from 0."""
    number = int(word.split("/", 1)[0])
    index = number - 1 if number > 0 else count + number
    if number == 0 or index < 0:
        raise ValueError(f"no vertex {number}")
    return index
