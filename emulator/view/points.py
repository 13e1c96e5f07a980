"""Echoes, beams and objects of a scan as points in the world, and their colours. Arrays only."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from emulator.scenario.tables import Mount
from emulator.view.frames import Floats, Ints, ShownScan
from emulator.world.motion import quaternion_of
from emulator.world.scene import Scene
from protocols.scan import points_of

Colours = NDArray[np.uint8]
COLOURINGS = ("intensity", "actor", "range")
MOST_BEAMS = 91
"Drawn of one sensor; more are thinned out."

# From faint to strong: the hues of viridis, its dark end lifted, as the page is dark.
_RAMP = np.array(
    [
        (112, 88, 214),
        (84, 112, 222),
        (56, 140, 220),
        (38, 166, 204),
        (36, 190, 172),
        (64, 208, 128),
        (124, 222, 84),
        (192, 232, 52),
        (253, 231, 37),
    ],
    np.float64,
)
_ACTORS = np.array(
    [
        (150, 170, 190),
        (239, 83, 80),
        (66, 165, 245),
        (255, 202, 40),
        (102, 187, 106),
        (171, 71, 188),
        (255, 138, 101),
        (38, 198, 218),
        (236, 64, 122),
        (156, 204, 101),
        (141, 110, 99),
    ],
    np.uint8,
)
_WEATHER = np.array((255, 255, 255), np.uint8)
"Echoes of fog, rain and false alarms: of no actor."
WEAKEST, STRONGEST = 1.0, 3000.0
"Peak over detection threshold, ends of the ramp; in the logarithm between."


class Cloud(NamedTuple):
    """Echoes of one scan."""

    points_m: Floats
    "(e, 3) in the world."
    origins_m: Floats
    "(e, 3) where each of their beams began."
    colours: Colours
    "(e, 3)"


def cloud(scene: Scene, mount: Mount, scan: ShownScan, colouring: str) -> Cloud:
    """All echoes of a scan where they were measured: each beam at its own instant, so that a sensor may move."""
    beam, echo = np.nonzero(np.isfinite(scan.range_m))
    if not len(beam):
        return Cloud(np.zeros((0, 3)), np.zeros((0, 3)), np.zeros((0, 3), np.uint8))
    range_m = scan.range_m[beam, echo]
    origin = None if scan.origin_m is None else scan.origin_m[beam]
    own = points_of(scan.azimuth_rad[beam], scan.elevation_rad[beam], range_m, origin)
    pose = scene.sensor_pose(mount, scene.local_s(scan.start_s) + scan.fire_s[beam])
    points = pose.to_world(own)
    origins = np.broadcast_to(pose.position_m, points.shape) if origin is None else pose.to_world(origin)
    colours = colours_of(colouring, range_m, scan.intensity[beam, echo], scan.actor[beam, echo])
    return Cloud(points, origins, colours)


def colours_of(colouring: str, range_m: Floats, intensity: Floats, actor: Ints) -> Colours:
    """(n, 3) by one of `COLOURINGS`."""
    if colouring == "actor":
        return np.where((actor < 0)[:, None], _WEATHER, _ACTORS[colour_index(actor)]).astype(np.uint8)
    if colouring == "range":
        share = 1.0 - range_m / max(1.0, float(range_m.max(initial=1.0)))
    else:
        strength = np.clip(np.nan_to_num(intensity, nan=WEAKEST), WEAKEST, STRONGEST)
        share = np.log(strength / WEAKEST) / math.log(STRONGEST / WEAKEST)
    place = np.linspace(0.0, 1.0, len(_RAMP))
    return np.stack([np.interp(share, place, _RAMP[:, one]) for one in range(3)], axis=-1).astype(np.uint8)


def colour_index(actor: Ints) -> Ints:
    """Row of the palette: the world's own for 0, the others in turn."""
    return np.where(actor <= 0, 0, 1 + (np.maximum(actor, 1) - 1) % (len(_ACTORS) - 1)).astype(np.int32)


def actor_colour(actor: int) -> tuple[int, int, int]:
    """Of one actor, as its echoes have it."""
    red, green, blue = _ACTORS[int(colour_index(np.array(actor)))]
    return int(red), int(green), int(blue)


def beams(found: Cloud) -> Floats:
    """(b, 2, 3) lines from where beams begin to echoes, thinned out to `MOST_BEAMS`."""
    step = max(1, -(-len(found.points_m) // MOST_BEAMS))
    return np.stack([found.origins_m[::step], found.points_m[::step]], axis=1)


def boxes(scene: Scene, mount: Mount, scan: ShownScan) -> Floats:
    """(12 edges of each object, 2, 3) of an object list, in the world."""
    corners = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])
    edges = [(a, b) for a in range(8) for b in range(a + 1, 8) if (a ^ b).bit_count() == 1]
    pose = scene.sensor_pose(mount, np.array([scene.local_s(scan.start_s)]))
    found = []
    for item in scan.objects:
        placed = pose.to_world(_corners(item, corners))
        found.append(placed[np.array(edges)])
    return np.concatenate(found) if found else np.zeros((0, 2, 3))


def _corners(item: Mapping[str, Any], corners: Floats) -> Floats:
    cos, sin = math.cos(item["yaw_rad"]), math.sin(item["yaw_rad"])
    turned = (corners * np.maximum(item["size_m"], 0.05)) @ np.array(
        [[cos, sin, 0.0], [-sin, cos, 0.0], [0.0, 0.0, 1.0]]
    )
    return np.asarray(turned + np.asarray(item["position_m"]))


def quaternion(rotation: Floats) -> tuple[float, float, float, float]:
    """w, x, y, z of one (3, 3) matrix."""
    w, x, y, z = (float(part) for part in quaternion_of(rotation))
    return w, x, y, z
