"""The meshes that come with the package, made by code: road users and what stands beside a road.

Belongs here: sizes and outlines, all our own choice after common objects. Not: how solids are made (solids).
Every mesh stands on z = 0 with its origin in the middle of its base and looks along +x. The files in `scenarios/meshes`
are `write_all`'s; a test compares them.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from pathlib import Path
from types import MappingProxyType

import numpy as np

from emulator.world.solids import Node, Solid, blob, block, glb, hoop, joined, loft, tube, wheel

# ---------------------------------------------------------------- car

_X = (2.25, 2.2, 2.05, 1.8, 0.95, 0.55, 0.2, -0.4, -1.1, -1.45, -1.75, -2.05, -2.2, -2.25)
_BELT = (0.60, 0.68, 0.74, 0.80, 0.92, 0.93, 0.94, 0.95, 0.97, 0.98, 0.98, 0.96, 0.90, 0.80)
_ROOF = (0.62, 0.70, 0.76, 0.82, 0.95, 1.20, 1.39, 1.45, 1.40, 1.22, 1.00, 0.98, 0.92, 0.82)
_HALF = (0.62, 0.74, 0.83, 0.87, 0.88, 0.88, 0.88, 0.88, 0.88, 0.88, 0.87, 0.83, 0.74, 0.64)
_ROOF_HALF = (0.50, 0.60, 0.70, 0.74, 0.76, 0.68, 0.60, 0.58, 0.60, 0.66, 0.72, 0.68, 0.60, 0.52)
"Outline of the car at `_X`: shoulder height, roof or bonnet height, half width there. [m]"
_FLOOR = 0.18
_PILLARS = ((0.62, 0.48), (-0.42, -0.56), (-1.32, -1.5))
"Side windows end where these stretches of x begin."


def car() -> Solid:
    """A saloon, 4.5 x 1.8 x 1.45 m: parts body, glass, bumper, tyre, plate."""
    stations = np.concatenate([np.linspace(-2.25, 2.25, 41), _X, [p for pair in _PILLARS for p in pair]])
    x = np.unique(np.round(stations, 6))
    belt, roof, half, top = (np.interp(x, _X[::-1], values[::-1]) for values in (_BELT, _ROOF, _HALF, _ROOF_HALF))
    floor = _FLOOR + 0.10 * np.clip((np.abs(x) - 1.9) / 0.35, 0.0, 1.0)
    low = np.minimum(0.42, floor + 0.6 * (belt - floor))
    side = [
        (np.zeros_like(x), floor),
        (0.80 * half, floor),
        (0.97 * half, floor + 0.06),
        (half, low),
        (half, 0.5 * (low + belt)),
        (0.99 * half, belt - 0.05),
        (0.5 * (0.97 * half + top) + 0.02, belt),
        (top, np.maximum(belt + 0.005, roof - 0.05)),
        (0.9 * top, np.maximum(belt + 0.01, roof - 0.01)),
        (np.zeros_like(x), np.maximum(belt + 0.015, roof)),
    ]
    ring = side + [(-y, z) for y, z in side[-2:0:-1]]
    rings = np.stack([np.stack([x, y, z], axis=-1) for y, z in ring], axis=1)[:, ::-1]
    size = len(ring)

    def part(i: int, j: int) -> str:
        strip = size - 2 - j if j < size - 1 else size - 1  # rings were turned round: strip between points and the next
        strip = min(strip, size - 1 - strip)
        if i in (-1, len(x) - 1):
            return "bumper"
        middle = 0.5 * (x[i] + x[i + 1])
        if abs(middle) > 1.95 and strip <= 3:
            return "bumper"
        if strip == 6 and 0.92 > middle > -1.72 and roof[i] - belt[i] > 0.04:
            return "body" if any(a > middle > b for a, b in _PILLARS) else "glass"
        if strip >= 8 and (0.94 > middle > 0.2 or -1.1 > middle > -1.74):
            return "glass"
        return "body"

    wheels = [wheel("tyre", (front * 1.32, left * 0.81, 0.32), 0.32, 0.19, 20) for front in (1, -1) for left in (1, -1)]
    plates = [
        block("plate", (2.245, -0.26, 0.38), (2.262, 0.26, 0.49)),
        block("plate", (-2.262, -0.26, 0.55), (-2.245, 0.26, 0.66)),
    ]
    return joined([loft(rings, part), *wheels, *plates])


# ---------------------------------------------------------------- other road users


def truck() -> Solid:
    """A rigid lorry, 8.2 x 2.5 x 3.6 m: parts cab, glass, box, chassis, tyre, plate."""
    cab = np.array([(1.0, 0.55), (1.0, 3.0), (0.55, 3.15), (-1.0, 3.15), (-1.0, 0.55)])
    rings = np.stack([np.column_stack([cab[:, 0] + 3.1, np.full(len(cab), y), cab[:, 1]]) for y in (-1.22, 1.22)])
    pieces = [
        loft(rings, lambda i, j: "cab"),
        block("glass", (4.09, -1.05, 1.75), (4.12, 1.05, 2.65)),
        block("glass", (3.0, 1.21, 1.85), (3.8, 1.235, 2.6)),
        block("glass", (3.0, -1.235, 1.85), (3.8, -1.21, 2.6)),
        block("box", (-4.1, -1.25, 1.05), (1.95, 1.25, 3.6)),
        block("chassis", (-4.05, -0.5, 0.65), (2.2, 0.5, 1.06)),
        block("chassis", (-4.1, -1.18, 0.45), (-3.95, 1.18, 0.62)),
        block("chassis", (-2.0, 1.1, 0.4), (1.6, 1.2, 0.95)),
        block("chassis", (-2.0, -1.2, 0.4), (1.6, -1.1, 0.95)),
        block("plate", (4.09, -0.26, 0.6), (4.11, 0.26, 0.71)),
        block("plate", (-4.12, -0.26, 0.65), (-4.09, 0.26, 0.76)),
    ]
    pieces += [wheel("tyre", (x, y, 0.5), 0.5, 0.3, 20) for x in (3.0, -2.6, -3.7) for y in (1.05, -1.05)]
    return joined(pieces)


_TRUNK = ((0.84, 0.16, 0.10), (1.0, 0.15, 0.10), (1.25, 0.19, 0.12), (1.46, 0.15, 0.08))
"Height, half width and half depth of someone's trunk. [m]"


def _person(stride: float, lean: float) -> list[Solid]:
    """Someone of 1.75 m; `stride` parts the feet, `lean` moves the shoulders forward."""
    hip, shoulder = 0.92, 1.43
    angle = 2.0 * math.pi * np.arange(14) / 14
    trunk = np.zeros((len(_TRUNK), 14, 3))
    for ring, (z, width, depth) in zip(trunk, reversed(_TRUNK), strict=True):
        ring[:, 0] = depth * np.cos(angle) + lean * (z - hip) / (shoulder - hip)
        ring[:, 1] = -width * np.sin(angle)
        ring[:, 2] = z
    pieces = [
        blob("skin", (lean + 0.02, 0.0, 1.63), (0.10, 0.08, 0.12), 14),
        tube("skin", [(lean, 0, 1.42), (lean + 0.01, 0, 1.56)], [0.055, 0.05], 8),
        loft(trunk, lambda i, j: "top"),
    ]
    for left in (1, -1):
        step, side = left * stride, left * 0.09
        hand = (lean - 0.8 * step, left * 0.26, 0.86)
        arm = [(lean, left * 0.19, 1.42), (lean - 0.2 * step, left * 0.24, 1.14), hand]
        leg = [(0.0, side, 0.90), (0.5 * step + 0.05, side, 0.50), (step, side, 0.09)]
        pieces += [
            tube("trousers", leg, [0.085, 0.06, 0.045], 10),
            block("shoes", (step - 0.08, side - 0.045, 0.0), (step + 0.18, side + 0.045, 0.09)),
            tube("top", arm, [0.06, 0.05, 0.04], 8),
            blob("skin", (hand[0], hand[1], hand[2] - 0.05), (0.04, 0.03, 0.07), 8),
        ]
    return pieces


def pedestrian() -> Solid:
    """Someone walking, 1.75 m tall: parts skin, top, trousers, shoes."""
    return joined(_person(0.22, 0.03))


def walking(stride: float) -> Solid:
    """The same walker in the middle of a step: two of them with opposite strides are the frames of a walk."""
    return joined(_person(stride, 0.03))


def bicycle() -> Solid:
    """A bicycle with its rider, 1.75 m long: parts tyre, frame, skin, top, trousers, shoes."""
    rear, front, crank = (-0.52, 0, 0.34), (0.53, 0, 0.34), (-0.08, 0, 0.29)
    saddle, bar = (-0.2, 0, 0.92), (0.38, 0, 0.98)
    pieces = [hoop("tyre", wheel_at, 0.34, 0.022, 28) for wheel_at in (rear, front)]
    pieces += [
        tube("frame", path, [0.018] * len(path), 6)
        for path in (
            (crank, saddle),
            (crank, (0.34, 0, 0.72)),
            (saddle, (0.34, 0, 0.78)),
            (rear, crank),
            (rear, saddle),
            (front, (0.36, 0, 0.72), bar),
            ((0.38, -0.28, 1.0), (0.38, 0.28, 1.0)),
        )
    ]
    pieces += [
        block("frame", (-0.33, -0.07, 0.92), (-0.07, 0.07, 0.96)),
        blob("skin", (0.22, 0.0, 1.66), (0.10, 0.08, 0.12), 14),
        tube("top", [(-0.2, 0, 0.95), (-0.08, 0, 1.2), (0.12, 0, 1.48), (0.18, 0, 1.56)], [0.15, 0.16, 0.15, 0.05], 12),
    ]
    for left in (1, -1):
        side = left * 0.1
        foot = (-0.08 + left * 0.12, side, 0.29 - left * 0.12)
        arm = [(0.1, 1.7 * side, 1.46), (0.2, 2.4 * side, 1.2), (0.36, 2.5 * side, 1.03)]
        knee = (0.22 - left * 0.04, left * 0.1, 0.70 - left * 0.1)
        pieces += [
            tube("trousers", [(-0.2, left * 0.09, 0.96), knee, foot], [0.085, 0.06, 0.045], 8),
            block("shoes", (foot[0] - 0.08, side - 0.04, foot[2] - 0.09), (foot[0] + 0.17, side + 0.04, foot[2])),
            tube("top", arm, [0.06, 0.05, 0.04], 8),
            blob("skin", (0.38, 2.5 * side, 1.01), (0.05, 0.035, 0.04), 8),
        ]
    return joined(pieces)


# ---------------------------------------------------------------- street furniture


def tree() -> Solid:
    """A deciduous tree, 8 m tall: parts bark, leaves."""
    return joined(
        [
            tube("bark", [(0, 0, 0), (0.03, 0, 1.5), (0, 0.05, 3.0), (0, 0, 5.0)], [0.22, 0.17, 0.14, 0.07], 12),
            blob("leaves", (0, 0, 5.3), (1.9, 1.9, 2.7), 20, 0.10),
            blob("leaves", (0.9, 0.7, 4.4), (1.3, 1.2, 1.3), 16, 0.12),
            blob("leaves", (-0.8, -0.9, 4.6), (1.4, 1.2, 1.4), 16, 0.12),
        ]
    )


def lamp_post() -> Solid:
    """A street lamp, 6 m: parts pole, lamp."""
    return joined(
        [
            tube("pole", [(0, 0, 0), (0, 0, 0.9), (0, 0, 1.0), (0, 0, 6.0)], [0.09, 0.09, 0.06, 0.045], 16),
            tube("pole", [(0, 0, 5.95), (0.7, 0, 6.05), (1.1, 0, 6.05)], [0.035, 0.03, 0.03], 8),
            block("lamp", (1.0, -0.12, 5.96), (1.6, 0.12, 6.06)),
        ]
    )


def traffic_sign() -> Solid:
    """A round sign of 0.6 m on a post, facing +x: parts face, back, pole."""
    angle = -2.0 * math.pi * np.arange(32) / 32
    rings = np.stack(
        [np.column_stack([np.full(32, x), 0.3 * np.cos(angle), 2.3 + 0.3 * np.sin(angle)]) for x in (0.045, 0.048)]
    )[:, ::-1]
    plate = loft(rings[:, ::-1], lambda i, j: "face" if i == 1 else "back")
    return joined([plate, tube("pole", [(0, 0, 0), (0, 0, 2.65)], [0.038, 0.038], 14)])


def house() -> Solid:
    """A house, 12 x 9 x 8.5 m with a gable roof; its front looks along +x: parts wall, roof, window, door."""
    gable = np.array([(-4.9, 5.8), (4.9, 5.8), (0.0, 8.5)])
    rings = np.stack([np.column_stack([gable[:, 0], np.full(3, y), gable[:, 1]]) for y in (6.2, -6.2)])
    pieces = [block("wall", (-4.5, -6.0, 0.0), (4.5, 6.0, 5.8)), loft(rings, lambda i, j: "roof")]
    for front in (1, -1):
        for storey in (0, 1):
            for y in (-4.5, -1.5, 1.5, 4.5):
                if front == 1 and storey == 0 and y == 1.5:
                    continue
                x = sorted((front * 4.49, front * 4.52))
                pieces.append(block("window", (x[0], y - 0.6, 1.0 + 2.8 * storey), (x[1], y + 0.6, 2.4 + 2.8 * storey)))
    pieces.append(block("door", (4.49, 0.95, 0.1), (4.53, 2.05, 2.2)))
    return joined(pieces)


# ---------------------------------------------------------------- the yard of gltf_yard


def _container() -> Solid:
    """A sea container of 20 feet with corrugated sides, one part `steel`."""
    steps = np.linspace(-1.0, 1.0, 23)
    rings = []
    for number, share in enumerate(steps):
        half = 1.22 if number % 2 else 1.185
        outline = [(-half, 0.0), (half, 0.0), (half, 2.59), (-half, 2.59)]
        rings.append([(3.03 * share, y, z) for y, z in outline])
    return loft(np.array(rings)[:, ::-1], lambda i, j: "steel")


def _yard_files() -> bytes:
    """Floor, walls, containers and pallets, each mesh once, placed by nodes; parts bear names of materials."""
    renamed = {
        "container": Solid((c := _container()).vertices, c.faces, ("olive_paint",) * len(c.faces)),
        "floor": block("concrete", (-20.0, -15.0, -0.2), (20.0, 15.0, 0.0)),
        "wall": block("brick", (-0.15, -15.0, 0.0), (0.15, 15.0, 3.0)),
        "pallet": joined(
            [block("pine_timber", (-0.6, y - 0.05, 0.0), (0.6, y + 0.05, 0.12)) for y in (-0.35, 0.0, 0.35)]
            + [block("pine_timber", (-0.6, -0.4, 0.12), (0.6, 0.4, 0.144))]
        ),
        "crate": block("expanded_polystyrene", (-0.5, -0.35, 0.0), (0.5, 0.35, 0.8)),
    }
    nodes = [
        Node("floor", "floor"),
        Node("wall east", "wall", (20.0, 0.0, 0.0)),
        Node("wall west", "wall", (-20.0, 0.0, 0.0)),
        Node("wall north", "wall", (0.0, 15.0, 0.0), 90.0, 1.0),
        Node("container 1", "container", (8.0, 6.0, 0.0), 0.0),
        Node("container 2", "container", (8.0, 6.0, 2.59), 2.0),
        Node("container 3", "container", (12.0, -3.0, 0.0), 90.0),
        Node("container 4", "container", (-9.0, 4.0, 0.0), 35.0),
        Node("pallet 1", "pallet", (5.0, -4.0, 0.0), 10.0),
        Node("crate 1", "crate", (5.0, -4.0, 0.144), 10.0),
        Node("pallet 2", "pallet", (6.5, -6.0, 0.0), -25.0),
        Node("crate 2", "crate", (6.5, -6.0, 0.144), -25.0, 1.2),
        Node("crate 3", "crate", (-3.0, -5.0, 0.0), 60.0, 0.8),
    ]
    return glb(renamed, nodes)


# ---------------------------------------------------------------- files

MODELS: Mapping[str, Callable[[], Solid]] = MappingProxyType(
    {
        "car": car,
        "truck": truck,
        "pedestrian": pedestrian,
        "walk_left": lambda: walking(0.21),
        "walk_right": lambda: walking(-0.21),
        "bicycle": bicycle,
        "tree": tree,
        "lamp_post": lamp_post,
        "traffic_sign": traffic_sign,
        "house": house,
    }
)
"Name of a file in `scenarios/meshes` -> what makes it; `yard` has nodes of its own."


def file_bytes(name: str) -> bytes:
    """The GLB file of that name."""
    return _yard_files() if name == "yard" else glb({name: MODELS[name]()})


def write_all(folder: Path) -> None:
    """Write every file again: after a change of this module."""
    for name in (*MODELS, "yard"):
        (folder / f"{name}.glb").write_bytes(file_bytes(name))
