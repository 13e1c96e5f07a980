"""The scene's meshes as the page draws them: one piece for each part of a body, with a colour for its material."""

from __future__ import annotations

import colorsys
import zlib
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from emulator.errors import EmulatorError
from emulator.physics.materials import material
from emulator.view.frames import Floats, Ints
from emulator.world import triangles
from emulator.world.scene import Scene

MOST_TRIANGLES = 400_000
"Of one body; a larger one is shown as its box."
HUES = {
    "grass": 0.28,
    "foliage": 0.30,
    "leaf": 0.30,
    "leaves": 0.30,
    "needles": 0.34,
    "bark": 0.07,
    "timber": 0.09,
    "olive": 0.17,
    "brick": 0.03,
    "roof": 0.02,
    "wood": 0.08,
    "skin": 0.06,
    "water": 0.57,
    "_red": 0.0,
    "_green": 0.33,
    "_blue": 0.61,
    "asphalt": 0.60,
    "concrete": 0.10,
    "glass": 0.55,
    "windscreen": 0.55,
    "soil": 0.07,
}
"Where people expect a colour."
GREY = ("asphalt", "concrete", "sheet", "aluminium", "steel", "tyre", "grey", "plaster", "white", "black", "silver")


@dataclass(frozen=True, eq=False)
class Piece:
    """One mesh of one colour."""

    name: str
    "Unique; path below its actor."
    actor: int
    body: int
    vertices_m: Floats
    faces: Ints
    colour: tuple[int, int, int]
    see_through: bool
    used: Ints | None = None
    "Rows of the body's vertices, for shapes that change; None: not its own vertices."


def pieces(scene: Scene) -> Iterator[Piece]:
    """Every body of the scene, part by part."""
    for number, body in enumerate(scene.bodies):
        if len(body.faces) > MOST_TRIANGLES:
            low, high = body.vertices.min(axis=0), body.vertices.max(axis=0)
            made = triangles.box(*(high - low))
            vertices = made.vertices - made.vertices.min(axis=0) + low
            yield Piece(f"{number}/box", body.actor, number, vertices, made.faces, (120, 120, 120), True)
            continue
        for part in np.unique(body.face_material):
            chosen = body.faces[body.face_material == part]
            used, places = np.unique(chosen, return_inverse=True)
            name = scene.materials[int(part)]
            faces = places.reshape(-1, 3).astype(np.int32)
            yield Piece(
                f"{number}/{part}",
                body.actor,
                number,
                body.vertices[used],
                faces,
                colour_of(name),
                "glass" in name or "windscreen" in name,
                used.astype(np.int32),
            )


def colour_of(name: str) -> tuple[int, int, int]:
    """Lightness from what it reflects at 905 nm, hue from its name; the scenario's own materials are of middle grey."""
    try:
        rho = material(name).reflectance(905)
    except (EmulatorError, ValueError, KeyError, TypeError):
        rho = 0.4
    hue = next((one for word, one in HUES.items() if word in name), zlib.crc32(name.encode()) % 360 / 360.0)
    saturation = 0.04 if any(word in name for word in GREY) else 0.22
    lightness = 0.22 + 0.5 * min(1.0, max(0.0, float(rho)))
    red, green, blue = colorsys.hls_to_rgb(hue, lightness, saturation)
    return round(255 * red), round(255 * green), round(255 * blue)
