"""SICK LD-MRS S01 / Ibeo LUX: frames of an object list.

Belongs here: base+0 to base+8 from columns of objects, contours included. Not: which objects, parameters, replies.
"""

from __future__ import annotations

from itertools import chain, repeat
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from protocols.can_objects.layout import Layout
from protocols.can_objects.session import Frame
from protocols.can_objects.table import CATEGORIES, Floats, ObjectTable

Codes = NDArray[np.int64]

VELOCITY_NOT_VALID = -2048
CONTOUR_NOT_USABLE = 0xFF
POINTS_PER_FRAME = 3
STEP_M = 0.04
STEP_LIMITS = (-128, 127)
LOW_DENSITY_POINTS = 4
"Points of a contour at density 1; chosen here, the source has only `low`."

CLASS_CODES = {
    "unknown": 0, "point": 1, "wide": 2, "pedestrian": 3, "bicycle": 4, "motorcycle": 4, "car": 5, "truck": 6,
}  # fmt: skip
"As in the Ethernet object 0x2221."


def object_frames(
    layout: Layout,
    shift: int,
    table: ObjectTable,
    ids: Codes,
    velocities_m_s: tuple[Floats, Floats] | None,
    *,
    age_scans: Codes,
    prediction_scans: Codes,
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


def _contour_frames(layout: Layout, shift: int, table: ObjectTable, ids: Codes, density: int) -> list[list[Frame]]:
    """Contour header of every object and its point frames, each point a step from the one before."""
    contours = _contours(table, density)
    headers = layout["ContourHeader"].frames(
        len(table),
        {"ObjId": ids, "NumPoints": contours.counts, "ClosestIndex": contours.nearest},
        StartX=contours.starts_m[:, 0],
        StartY=contours.starts_m[:, 1],
    )
    identifier = layout["ContourHeader"].identifier + shift
    out = [[Frame(identifier, header, "ContourHeader")] for header in headers]
    if not len(contours.steps):
        return out
    # the steps of each object in its own frames, the last one filled with zeros
    frames_of = -(-np.bincount(contours.step_row, minlength=len(table)) // POINTS_PER_FRAME)
    row = np.repeat(np.arange(len(table)), frames_of)
    packed = np.zeros((len(row) * POINTS_PER_FRAME, 2), dtype=np.int64)
    first = np.cumsum(frames_of) - frames_of
    packed[first[contours.step_row] * POINTS_PER_FRAME + contours.step_place] = contours.steps
    raw = {"ObjId": ids[row], "MessageIndex": np.arange(len(row)) - first[row]}
    for k in range(POINTS_PER_FRAME):
        raw |= {f"Dx{k + 1}": packed[k::POINTS_PER_FRAME, 0], f"Dy{k + 1}": packed[k::POINTS_PER_FRAME, 1]}
    message = layout["ContourPoints"]
    for at, payload in zip(row.tolist(), message.frames(len(row), raw), strict=True):
        out[at].append(Frame(message.identifier + shift, payload, "ContourPoints"))
    return out


class _Contours(NamedTuple):
    """Outlines of n objects as the format has them, and the s steps of all that are usable."""

    counts: Codes
    "(n,) points, or `CONTOUR_NOT_USABLE`."
    nearest: Codes
    "(n,) which point is nearest to the sensor; 0 where the contour is not usable."
    starts_m: Floats
    "(n, 2) first point; the nearest one where the contour is not usable."
    steps: Codes
    "(s, 2) raw, from each point to the next one of the same object."
    step_row: Codes
    "(s,) whose step it is."
    step_place: Codes
    "(s,) which step of that object, from 0."


def _contours(table: ObjectTable, density: int) -> _Contours:
    """One point, the nearest of the box, where there is no outline or none is wanted."""
    n = len(table)
    counts, nearest, starts = np.ones(n, dtype=np.int64), np.zeros(n, dtype=np.int64), table.closest_points_m()
    sizes = np.array([len(outline) for outline in table.contours], dtype=np.int64)
    if not density or not sizes.any():
        nothing = np.zeros(0, dtype=np.int64)
        return _Contours(counts, nearest, starts, nothing.reshape(0, 2), nothing, nothing)
    points, sizes = _points(table, sizes, density)
    row, place = _places(sizes)
    drawn = np.flatnonzero(sizes)
    first = (np.cumsum(sizes) - sizes)[drawn]
    distances = np.hypot(points[:, 0], points[:, 1])
    is_nearest = distances == np.repeat(np.minimum.reduceat(distances, first), sizes[drawn])
    nearest[drawn] = np.minimum.reduceat(np.where(is_nearest, place, len(place)), first)
    # raw steps whose running sum stays nearest to the points: no drift
    from_start = np.rint((points - np.repeat(points[first], sizes[drawn], axis=0)) / STEP_M)
    steps = np.diff(from_start, axis=0)
    within = place[1:] > 0
    too_long = within & ((steps < STEP_LIMITS[0]) | (steps > STEP_LIMITS[1])).any(axis=1)
    usable = sizes < CONTOUR_NOT_USABLE
    usable[row[1:][too_long]] = False
    counts[drawn] = np.where(usable, sizes, CONTOUR_NOT_USABLE)[drawn]
    starts[drawn] = points[first + np.where(usable, 0, nearest)[drawn]]
    nearest[~usable] = 0
    sent = within & usable[row[1:]]
    return _Contours(counts, nearest, starts, steps[sent].astype(np.int64), row[1:][sent], place[:-1][sent])


def _points(table: ObjectTable, sizes: Codes, density: int) -> tuple[Floats, Codes]:
    """Points of all outlines one after the other and how many each has: all, or at density 1 evenly chosen ones."""
    points = np.array(list(chain.from_iterable(table.contours)), dtype=np.float64)
    if density != 1:
        return points, sizes
    kept = np.minimum(sizes, LOW_DENSITY_POINTS)
    row, place = _places(kept)
    even = np.rint(np.linspace(0, sizes - 1, LOW_DENSITY_POINTS)).astype(np.int64)
    chosen = np.where(sizes[row] > LOW_DENSITY_POINTS, even[place, row], place)
    return points[(np.cumsum(sizes) - sizes)[row] + chosen], kept


def _places(sizes: Codes) -> tuple[Codes, Codes]:
    """Of parts that lie one after the other: of every item, its part and its place in it."""
    part = np.repeat(np.arange(len(sizes)), sizes)
    return part, np.arange(len(part)) - (np.cumsum(sizes) - sizes)[part]
