"""A list of objects as columns, so that filters, sorting and packing are array operations.

Belongs here: what can be said of an object without knowing a format. Not: codes, units of a wire, rules of a device.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from protocols.scan import DetectedObject

Floats = NDArray[np.float64]
Index = NDArray[np.intp] | NDArray[np.bool_]

CATEGORIES = ("unknown", "point", "car", "truck", "motorcycle", "bicycle", "pedestrian", "wide")
"Known categories; any other text counts as unknown."


@dataclass(frozen=True, eq=False)
class ObjectTable:
    """n objects in the frame of the sensor that lists them; SI units, angles in radians."""

    track: NDArray[np.int64]
    x_m: Floats
    y_m: Floats
    vx_m_s: Floats
    vy_m_s: Floats
    ax_m_s2: Floats
    ay_m_s2: Floats
    length_m: Floats
    width_m: Floats
    yaw_rad: Floats
    age_s: Floats
    coasting_s: Floats
    existence: Floats
    x_std_m: Floats
    y_std_m: Floats
    vx_std_m_s: Floats
    vy_std_m_s: Floats
    ax_std_m_s2: Floats
    "NaN: not known; so are the next two."
    ay_std_m_s2: Floats
    yaw_std_rad: Floats
    reflectance: Floats
    category: NDArray[np.int64]
    "Index into `CATEGORIES`."
    contours: tuple[tuple[tuple[float, float], ...], ...]

    def __len__(self) -> int:
        return len(self.track)

    @property
    def range_m(self) -> Floats:
        """Horizontal distance of the box's centre."""
        return np.hypot(self.x_m, self.y_m)

    @property
    def azimuth_rad(self) -> Floats:
        """Direction of the box's centre, positive to the left."""
        return np.arctan2(self.y_m, self.x_m)

    @property
    def range_rate_m_s(self) -> Floats:
        """Radial speed, negative when the object comes nearer; at range 0 the speed along x."""
        azimuth = self.azimuth_rad
        return np.asarray(self.vx_m_s * np.cos(azimuth) + self.vy_m_s * np.sin(azimuth))

    def take(self, index: Index) -> ObjectTable:
        """The objects at `index` (mask or positions), in that order."""
        positions = np.flatnonzero(index) if index.dtype == np.bool_ else np.asarray(index, dtype=np.intp)
        columns = {f.name: getattr(self, f.name)[positions] for f in fields(self) if f.name != "contours"}
        return ObjectTable(**columns, contours=tuple(self.contours[position] for position in positions))

    def box_corners_m(self) -> Floats:
        """(n, 4, 2) corners of the boxes: front left, rear left, rear right, front right."""
        along = np.stack([np.cos(self.yaw_rad), np.sin(self.yaw_rad)], axis=-1) * (0.5 * self.length_m)[:, None]
        across = np.stack([-np.sin(self.yaw_rad), np.cos(self.yaw_rad)], axis=-1) * (0.5 * self.width_m)[:, None]
        centre = np.stack([self.x_m, self.y_m], axis=-1)
        corners = np.stack([along + across, across - along, -along - across, along - across], axis=1)
        return np.asarray(centre[:, None, :] + corners)

    def closest_points_m(self) -> Floats:
        """(n, 2) point of each box that is nearest to the sensor."""
        cosine, sine = np.cos(self.yaw_rad), np.sin(self.yaw_rad)
        # the sensor in the box's own frame, moved to the box's edge
        along = np.clip(-(self.x_m * cosine + self.y_m * sine), -0.5 * self.length_m, 0.5 * self.length_m)
        across = np.clip(self.x_m * sine - self.y_m * cosine, -0.5 * self.width_m, 0.5 * self.width_m)
        x = self.x_m + along * cosine - across * sine
        y = self.y_m + along * sine + across * cosine
        return np.stack([x, y], axis=-1)

    @classmethod
    def of(cls, objects: Sequence[DetectedObject]) -> ObjectTable:
        """Columns of a list; an object whose position or size is not finite is left out."""
        unknown = (float("nan"), float("nan"))
        rows = np.array(
            [
                (
                    o.position_m[0],
                    o.position_m[1],
                    o.velocity_m_s[0],
                    o.velocity_m_s[1],
                    *o.acceleration_m_s2,
                    o.size_m[0],
                    o.size_m[1],
                    o.yaw_rad,
                    o.age_s,
                    o.coasting_s,
                    o.existence,
                    *o.position_std_m,
                    *o.velocity_std_m_s,
                    *(o.acceleration_std_m_s2 or unknown),
                    float("nan") if o.yaw_std_rad is None else o.yaw_std_rad,
                    o.reflectance,
                )
                for o in objects
            ],
            dtype=np.float64,
        ).reshape(len(objects), len(_COLUMNS))
        codes = {name: code for code, name in enumerate(CATEGORIES)}
        table = cls(
            track=np.array([o.track for o in objects], dtype=np.int64),
            category=np.array([codes.get(o.category, 0) for o in objects], dtype=np.int64),
            contours=tuple(o.contour_m for o in objects),
            **dict(zip(_COLUMNS, rows.T, strict=True)),
        )
        finite = np.asarray(np.isfinite(rows[:, :9]).all(axis=1))
        return table if finite.all() else table.take(finite)


_COLUMNS = tuple(f.name for f in fields(ObjectTable) if f.name not in ("track", "category", "contours"))
"Fields in the order in which `ObjectTable.of` reads them from an object."
