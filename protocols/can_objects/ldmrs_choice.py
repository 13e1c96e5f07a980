"""SICK LD-MRS S01 / Ibeo LUX: which objects a list holds, in which order, with which number and ages.

Belongs here: the mounting that turns objects into the vehicle's frame, ages in scans, what the parameters on order and
age leave of a list. Not: how many of them the bus carries (the session), their frames (`ldmrs_lists`).
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from protocols.can_objects import ldmrs_parameters as p
from protocols.can_objects.identities import Identities
from protocols.can_objects.table import Floats, ObjectTable


class Listed(NamedTuple):
    """The n objects of a list, in order of priority."""

    table: ObjectTable
    "In the vehicle's frame."
    ids: NDArray[np.int64]
    age_scans: NDArray[np.int64]
    "(n,) lists since it was first seen, this one included."
    prediction_scans: NDArray[np.int64]
    "(n,) lists since it was last measured."


class ObjectChoice:
    """Chooses the objects of each list; remembers the numbers and ages of tracks from list to list."""

    def __init__(self) -> None:
        self._ids = Identities(256)
        self._scans_of: dict[int, tuple[int, int]] = {}
        "Track -> age and prediction age, in scans."

    def clear(self) -> None:
        """Forget every track."""
        self._ids.clear()
        self._scans_of = {}

    def choose(self, table: ObjectTable, parameters: p.ParameterBank) -> Listed:
        """Objects of the next list from those in the sensor's frame; every call counts as a scan."""
        table = _mounted(table, parameters)
        # the nearest get a number when they run out
        table = table.take(np.argsort(table.range_m, kind="stable"))
        age, prediction = self._scan_ages(table)
        numbers, _ = self._ids.assign(table.track.tolist())
        ids = np.array([-1 if number is None else number for number in numbers], dtype=np.int64)
        keep = (age >= parameters[p.MIN_AGE]) & (prediction <= parameters[p.MAX_PREDICTION_AGE]) & (ids >= 0)
        if parameters[p.PRIORITY] == p.LOOK_AHEAD:
            # nearest along the driving direction; what lies behind comes last
            order = np.lexsort((np.abs(table.y_m), np.abs(table.x_m), table.x_m < 0.0))
        else:
            order = np.arange(len(table))
        chosen = order[keep[order]][: parameters[p.MAX_OBJECTS]]
        return Listed(table.take(chosen), ids[chosen], age[chosen], prediction[chosen])

    def _scan_ages(self, table: ObjectTable) -> NDArray[np.int64]:
        """(2, n) age and prediction age of every object."""
        seen: dict[int, tuple[int, int]] = {}
        tracks = table.track.tolist()
        for track, coasting_s in zip(tracks, table.coasting_s.tolist(), strict=True):
            age, predicted = self._scans_of.get(track, (0, 0))
            seen[track] = (age + 1, predicted + 1 if coasting_s > 0.0 else 0)
        self._scans_of = seen
        return np.array([seen[track] for track in tracks], dtype=np.int64).reshape(-1, 2).T


def _mounted(table: ObjectTable, parameters: p.ParameterBank) -> ObjectTable:
    """Objects in the vehicle's frame, by the mounting parameters (yaw, x and y)."""
    x, y, yaw = (parameters[index] for index in (p.MOUNT_X, p.MOUNT_Y, p.MOUNT_YAW))
    if not (x or y or yaw):
        return table
    angle = math.radians(yaw / p.TICKS_PER_DEG)
    cosine, sine = math.cos(angle), math.sin(angle)

    def turned(a: Floats, b: Floats) -> tuple[Floats, Floats]:
        return a * cosine - b * sine, a * sine + b * cosine

    x_m, y_m = turned(table.x_m, table.y_m)
    vx, vy = turned(table.vx_m_s, table.vy_m_s)
    contours = tuple(
        tuple((px * cosine - py * sine + x / 100, px * sine + py * cosine + y / 100) for px, py in outline)
        for outline in table.contours
    )
    return replace(
        table,
        x_m=x_m + x / 100,
        y_m=y_m + y / 100,
        vx_m_s=vx,
        vy_m_s=vy,
        yaw_rad=table.yaw_rad + angle,
        contours=contours,
    )
