"""Continental ARS408-21: codes and frames of object and cluster lists.

Belongs here: how objects become the codes of 0x60A to 0x60E, 0x600, 0x701 and 0x702. Not: which objects are listed.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from protocols.can_objects.layout import Layout
from protocols.can_objects.session import Frame
from protocols.can_objects.table import CATEGORIES, Floats, ObjectTable

Codes = NDArray[np.int64]

LINEAR_RMS = (
    0.005, 0.006, 0.008, 0.011, 0.014, 0.018, 0.023, 0.029, 0.038, 0.049, 0.063, 0.081, 0.105, 0.135, 0.174, 0.224,
    0.288, 0.371, 0.478, 0.616, 0.794, 1.023, 1.317, 1.697, 2.187, 2.817, 3.63, 4.676, 6.025, 7.762, 10.0,
)  # fmt: skip
"Upper bounds of the codes 0 to 30 in m, m/s and m/s2 (the DBC's value names); 31 is `not valid`."

ANGLE_RMS_DEG = (
    0.005, 0.007, 0.01, 0.014, 0.02, 0.029, 0.041, 0.058, 0.082, 0.116, 0.165, 0.234, 0.332, 0.471, 0.669, 0.949,
    1.346, 1.909, 2.709, 3.843, 5.451, 7.734, 10.971, 15.565, 22.061, 31.325, 44.439, 63.044, 89.437, 126.881, 180.0,
)  # fmt: skip
"The same for the orientation, in degrees."

PROBABILITIES = (0.25, 0.5, 0.75, 0.9, 0.99, 0.999)
"Upper bounds of ProbExist codes 1 to 6; 7 is up to 100 %."

MOVING, STATIONARY, ONCOMING, STATIONARY_CANDIDATE, UNKNOWN, CROSSING_STATIONARY, CROSSING_MOVING, STOPPED = range(8)

NEW, MEASURED, PREDICTED = 1, 2, 3

CLASS_CODES = {
    "unknown": 0, "point": 0, "car": 1, "truck": 2, "pedestrian": 3, "motorcycle": 4, "bicycle": 5, "wide": 6,
}  # fmt: skip

NEAR_SCAN_M = 70.0
"Range of the near scan by the data sheet; clusters beyond it are counted to the far scan."

MAX_CLUSTERS = 255
UNAMBIGUOUS = 3


def rms_codes(deviation: Floats, bounds: Sequence[float] = LINEAR_RMS) -> Codes:
    """Smallest code whose bound is not exceeded, 31 beyond the last bound and for NaN."""
    return np.searchsorted(np.asarray(bounds), deviation, side="left").astype(np.int64)


def probability_codes(probability: Floats) -> Codes:
    """Codes 1 to 7 of a probability from 0 to 1."""
    return 1 + np.searchsorted(np.asarray(PROBABILITIES), probability, side="right").astype(np.int64)


def class_codes(table: ObjectTable) -> Codes:
    """ObjClass of every object."""
    return np.array([CLASS_CODES[name] for name in CATEGORIES], dtype=np.int64)[table.category]


class MotionHistory:
    """Earlier motion of objects: distinguishes `stopped` from `stationary`."""

    CANDIDATE_S = 0.3
    "Younger objects that stand are only candidates; ours, the source gives no time."

    def __init__(self, standing_m_s: float) -> None:
        self._standing_m_s = standing_m_s
        self._last: dict[int, int] = {}
        "Track -> last code while it moved."

    def codes(self, table: ObjectTable, speed_m_s: float | None, yaw_rate_rad_s: float | None) -> Codes:
        """DynProp of every object; `unknown` while the host's ego motion is missing."""
        if speed_m_s is None or yaw_rate_rad_s is None:
            return np.full(len(table), UNKNOWN, dtype=np.int64)
        vx = table.vx_m_s + speed_m_s - yaw_rate_rad_s * table.y_m
        vy = table.vy_m_s + yaw_rate_rad_s * table.x_m
        moving = np.hypot(vx, vy) >= self._standing_m_s
        direction = np.where(np.abs(vy) > np.abs(vx), CROSSING_MOVING, np.where(vx < 0.0, ONCOMING, MOVING))
        codes = np.where(moving, direction, STATIONARY).astype(np.int64)
        present: dict[int, int] = {}
        for row, track in enumerate(table.track.tolist()):
            if moving[row]:
                present[track] = int(codes[row])
            elif (last := self._last.get(track)) is not None:
                present[track] = last
                codes[row] = CROSSING_STATIONARY if last == CROSSING_MOVING else STOPPED
            elif table.age_s[row] < self.CANDIDATE_S:
                codes[row] = STATIONARY_CANDIDATE
        self._last = present
        return codes

    def clear(self) -> None:
        """Forget every object."""
        self._last = {}


def object_list(
    layout: Layout,
    shift: int,
    table: ObjectTable,
    ids: Codes,
    new: NDArray[np.bool_],
    dynamics: Codes,
    *,
    counter: int,
    interface_version: int,
    rcs_dbm2: float,
    quality: bool,
    extended: bool,
    region_bits: Codes | None,
) -> list[Frame]:
    """Header, then all general, all quality, all extended, all warning frames, each in the order of `table`."""
    n = len(table)

    def frames(name: str, payloads: list[bytes]) -> list[Frame]:
        identifier = layout[name].identifier + shift
        return [Frame(identifier, payload, name) for payload in payloads]

    header = layout["ObjListHeader"].frame(
        raw={"NumObjects": n, "MeasCounter": counter, "InterfaceVersion": interface_version}
    )
    out = frames("ObjListHeader", [header])
    out += frames(
        "ObjGeneral",
        layout["ObjGeneral"].frames(
            n,
            raw={"ObjId": ids, "DynProp": dynamics},
            DistLong=table.x_m,
            DistLat=table.y_m,
            VrelLong=table.vx_m_s,
            VrelLat=table.vy_m_s,
            Rcs=rcs_dbm2,
        ),
    )
    if quality:
        state = np.where(new, NEW, np.where(table.coasting_s > 0.0, PREDICTED, MEASURED))
        out += frames(
            "ObjQuality",
            layout["ObjQuality"].frames(
                n,
                raw={
                    "ObjId": ids,
                    "DistLongRms": rms_codes(table.x_std_m),
                    "DistLatRms": rms_codes(table.y_std_m),
                    "VrelLongRms": rms_codes(table.vx_std_m_s),
                    "VrelLatRms": rms_codes(table.vy_std_m_s),
                    "ArelLongRms": rms_codes(table.ax_std_m_s2),
                    "ArelLatRms": rms_codes(table.ay_std_m_s2),
                    "OrientRms": rms_codes(np.degrees(table.yaw_std_rad), ANGLE_RMS_DEG),
                    "MeasState": state,
                    "ProbExist": probability_codes(table.existence),
                },
            ),
        )
    if extended:
        out += frames(
            "ObjExtended",
            layout["ObjExtended"].frames(
                n,
                raw={"ObjId": ids, "ObjClass": class_codes(table)},
                ArelLong=table.ax_m_s2,
                ArelLat=table.ay_m_s2,
                Orientation=np.degrees(np.angle(np.exp(1j * table.yaw_rad))),
                Length=table.length_m,
                Width=table.width_m,
            ),
        )
    if region_bits is not None:
        out += frames("ObjWarning", layout["ObjWarning"].frames(n, raw={"ObjId": ids, "RegionBits": region_bits}))
    return out


def cluster_list(
    layout: Layout,
    shift: int,
    table: ObjectTable,
    dynamics: Codes,
    *,
    counter: int,
    interface_version: int,
    rcs_dbm2: float,
    quality: bool,
) -> list[Frame]:
    """Header, general and quality frames: near scan first. One cluster an object, at its nearest point."""
    points = table.closest_points_m()
    near = np.hypot(points[:, 0], points[:, 1]) <= NEAR_SCAN_M
    order = np.argsort(~near, kind="stable")
    table, dynamics, points = table.take(order), dynamics[order], points[order]
    n = len(table)
    ids = np.arange(n)
    header = layout["ClusterListHeader"].frame(
        raw={
            "NumNear": int(near.sum()),
            "NumFar": int(n - near.sum()),
            "MeasCounter": counter,
            "InterfaceVersion": interface_version,
        }
    )
    general = layout["ClusterGeneral"].frames(
        n,
        raw={"ClusterId": ids, "DynProp": dynamics},
        DistLong=points[:, 0],
        DistLat=points[:, 1],
        VrelLong=table.vx_m_s,
        VrelLat=table.vy_m_s,
        Rcs=rcs_dbm2,
    )
    out = [Frame(layout["ClusterListHeader"].identifier + shift, header, "ClusterListHeader")]
    out += [Frame(layout["ClusterGeneral"].identifier + shift, payload, "ClusterGeneral") for payload in general]
    if quality:
        qualities = layout["ClusterQuality"].frames(
            n,
            raw={
                "ClusterId": ids,
                "DistLongRms": rms_codes(table.x_std_m),
                "DistLatRms": rms_codes(table.y_std_m),
                "VrelLongRms": rms_codes(table.vx_std_m_s),
                "VrelLatRms": rms_codes(table.vy_std_m_s),
                "FalseAlarmProb": probability_codes(1.0 - table.existence),
                "AmbigState": UNAMBIGUOUS,
            },
        )
        identifier = layout["ClusterQuality"].identifier + shift
        out += [Frame(identifier, payload, "ClusterQuality") for payload in qualities]
    return out
