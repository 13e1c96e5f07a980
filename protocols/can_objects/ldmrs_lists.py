"""SICK LD-MRS S01 / Ibeo LUX: frames of an object list.

Belongs here: base+0 to base+8 from columns of objects, contours included. Not: which objects, parameters, replies.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import repeat

import numpy as np
from numpy.typing import NDArray

from protocols.can_objects.layout import Layout
from protocols.can_objects.session import Frame
from protocols.can_objects.table import CATEGORIES, Floats, ObjectTable

VELOCITY_NOT_VALID = -2048
CONTOUR_NOT_USABLE = 0xFF
POINTS_PER_FRAME = 3
STEP_M = 0.04
STEP_LIMITS = (-128, 127)
LOW_DENSITY_POINTS = 4
"Points of a contour at density 1; ours, the source says `low`."

CLASS_CODES = {
    "unknown": 0, "point": 1, "wide": 2, "pedestrian": 3, "bicycle": 4, "motorcycle": 4, "car": 5, "truck": 6,
}  # fmt: skip
"As in the Ethernet object 0x2221."


def object_frames(
    layout: Layout,
    shift: int,
    table: ObjectTable,
    ids: NDArray[np.int64],
    velocities_m_s: tuple[Floats, Floats] | None,
    *,
    age_scans: NDArray[np.int64],
    prediction_scans: NDArray[np.int64],
    axis_aligned: bool,
    density: int,
    class_in_reserved: bool,
) -> list[list[Frame]]:
    """Frames of each object, in order: track 1, track 2, class and box 1, box 2, contour header, contour points."""
    n = len(table)
    velocity: dict[str, Floats] = {}
    raw_velocity: dict[str, int] = {}
    if velocities_m_s is None:
        raw_velocity = {"VelX": VELOCITY_NOT_VALID, "VelY": VELOCITY_NOT_VALID}
    else:
        # the lowest raw value means "not valid", so the slowest valid one is a step above it
        lowest = (VELOCITY_NOT_VALID + 1) * layout["ObjTrack1"].signals["VelX"].scale
        velocity = {
            name: np.maximum(value, lowest) for name, value in zip(("VelX", "VelY"), velocities_m_s, strict=True)
        }
    length, width, yaw = table.length_m, table.width_m, np.angle(np.exp(1j * table.yaw_rad))
    if axis_aligned:
        cosine, sine = np.abs(np.cos(yaw)), np.abs(np.sin(yaw))
        length, width, yaw = length * cosine + width * sine, length * sine + width * cosine, np.zeros(n)
    classes = {}
    if class_in_reserved:
        codes = np.array([CLASS_CODES[name] for name in CATEGORIES], dtype=np.int64)[table.category]
        certainty = np.rint(np.clip(table.existence, 0.0, 1.0) * 100.0).astype(np.int64)
        classes = {"Reserved1": codes, "Reserved2": certainty, "Reserved3": np.minimum(age_scans, 255)}
    columns = [
        (
            "ObjTrack1",
            layout["ObjTrack1"].frames(n, {"ObjId": ids, **raw_velocity}, PosX=table.x_m, PosY=table.y_m, **velocity),
        ),
        (
            "ObjTrack2",
            layout["ObjTrack2"].frames(
                n,
                {"ObjId": ids, "Age": np.minimum(age_scans, 255), "PredictionAge": np.minimum(prediction_scans, 255)},
                PosXSigma=table.x_std_m,
                PosYSigma=table.y_std_m,
                VelXSigma=table.vx_std_m_s,
                VelYSigma=table.vy_std_m_s,
            ),
        ),
        (
            "ObjClassBox1",
            layout["ObjClassBox1"].frames(n, {"ObjId": ids, **classes}, BoxCenterX=table.x_m, BoxCenterY=table.y_m),
        ),
        (
            "ObjBox2",
            layout["ObjBox2"].frames(n, {"ObjId": ids}, BoxSizeX=length, BoxSizeY=width, BoxYaw=np.degrees(yaw)),
        ),
    ]
    contours = _contour_frames(layout, shift, table, ids, density)
    made = [map(Frame, repeat(layout[name].identifier + shift), payloads, repeat(name)) for name, payloads in columns]
    return [[*frames, *contour] for frames, contour in zip(zip(*made, strict=True), contours, strict=True)]


def _contour_frames(
    layout: Layout, shift: int, table: ObjectTable, ids: NDArray[np.int64], density: int
) -> list[list[Frame]]:
    """Contour header of every object and its point frames, each point a step from the one before."""
    closest = table.closest_points_m()
    # one point, the nearest of the box, where there is no outline or none is wanted
    starts = closest.copy()
    counts, nearest = np.ones(len(table), dtype=np.int64), np.zeros(len(table), dtype=np.int64)
    none = np.zeros((0, 2), dtype=np.int64)
    steps: list[NDArray[np.int64]] = [none] * len(table)
    for row, outline in enumerate(table.contours if density else ()):
        if not outline:
            continue
        points = _thinned(outline, density)
        distances = np.hypot(points[:, 0], points[:, 1])
        walk = _steps(points)
        if walk is None or len(points) >= CONTOUR_NOT_USABLE:
            counts[row], starts[row] = CONTOUR_NOT_USABLE, points[int(distances.argmin())]
        else:
            counts[row], nearest[row], starts[row] = len(points), int(distances.argmin()), points[0]
            steps[row] = walk
    headers = layout["ContourHeader"].frames(
        len(table),
        {"ObjId": ids, "NumPoints": counts, "ClosestIndex": nearest},
        StartX=starts[:, 0],
        StartY=starts[:, 1],
    )
    message = layout["ContourPoints"]
    parts = [-(-len(walk) // POINTS_PER_FRAME) for walk in steps]
    packed = np.zeros((sum(parts), POINTS_PER_FRAME, 2), dtype=np.int64)
    row_of = np.repeat(np.arange(len(table)), parts)
    index = np.concatenate([np.arange(count) for count in parts]) if parts else np.zeros(0, dtype=np.int64)
    first = 0
    for walk, count in zip(steps, parts, strict=True):
        packed[first : first + count].reshape(-1, 2)[: len(walk)] = walk
        first += count
    raw = {"ObjId": ids[row_of], "MessageIndex": index}
    for k in range(POINTS_PER_FRAME):
        raw |= {f"Dx{k + 1}": packed[:, k, 0], f"Dy{k + 1}": packed[:, k, 1]}
    points_frames = message.frames(len(packed), raw)
    out: list[list[Frame]] = [
        [Frame(layout["ContourHeader"].identifier + shift, header, "ContourHeader")] for header in headers
    ]
    for row, payload in zip(row_of.tolist(), points_frames, strict=True):
        out[row].append(Frame(message.identifier + shift, payload, "ContourPoints"))
    return out


def _thinned(outline: Sequence[tuple[float, float]], density: int) -> Floats:
    """All points at density 2, evenly chosen ones at density 1."""
    points = np.asarray(outline, dtype=np.float64)
    if density == 1 and len(points) > LOW_DENSITY_POINTS:
        points = points[np.linspace(0, len(points) - 1, LOW_DENSITY_POINTS).round().astype(np.int64)]
    return points


def _steps(points: Floats) -> NDArray[np.int64] | None:
    """Raw steps whose running sum stays nearest to the points (no drift); None when one does not fit its byte."""
    from_start = np.rint((points - points[0]) / STEP_M)
    walk = np.diff(from_start, axis=0)
    if walk.size and (walk.min() < STEP_LIMITS[0] or walk.max() > STEP_LIMITS[1]):
        return None
    return np.asarray(walk, dtype=np.int64)
