"""Point clouds as files of other tools: PCD (pypcd4), PLY (trimesh), LAS (laspy).

Belongs here: what a column is called in each format. Not: the points (clouds).
"""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from emulator.recording.clouds import Points
from emulator.recording.folder import RecordingError

LAS_STEP_M = 1e-4
"Coordinates of LAS are integers of so much: 429 km at most."
LAS_SPAN_M = LAS_STEP_M * (2.0**32 - 2.0)


def _missing(error: ImportError) -> RecordingError:
    return RecordingError(f"{error.name} is missing; this format needs the extra: pip install 'lidaremu[clouds]'")


def _pcd(path: Path, points: Points, title: str) -> None:
    try:
        from pypcd4.pypcd4 import Encoding, PointCloud
    except ImportError as error:
        raise _missing(error) from None
    columns, kinds = [], []
    for name in points.dtype.names or ():
        narrow = np.float32 if name in "xyz" else points[name].dtype.type  # PCL reads x, y, z as float32 alone
        columns.append(points[name].astype(narrow))
        kinds.append(narrow)
    cloud = PointCloud.from_points(columns, tuple(points.dtype.names or ()), tuple(kinds))
    cloud.save(path, encoding=Encoding.BINARY)


def _ply(path: Path, points: Points, title: str) -> None:
    from trimesh import Trimesh
    from trimesh.exchange.ply import export_ply

    at_m = np.stack([points["x"], points["y"], points["z"]], axis=1)
    rest: dict[str, Any] = {name: _plain(points[name]) for name in (points.dtype.names or ()) if name not in "xyz"}
    nothing = np.zeros((0, 3), np.int64)
    cloud = Trimesh(at_m, nothing, process=False, validate=False, vertex_attributes=rest)
    path.write_bytes(export_ply(cloud, include_attributes=True))


def _plain(column: NDArray[Any]) -> NDArray[Any]:
    """As readers of PLY know it: Open3D passes over `ushort`."""
    return column.astype(np.int32) if column.dtype == np.uint16 else column


def _las(path: Path, points: Points, title: str) -> None:
    try:
        import laspy
    except ImportError as error:
        raise _missing(error) from None
    at_m = np.stack([points["x"], points["y"], points["z"]], axis=1)
    low = np.floor(at_m.min(axis=0)) if len(at_m) else np.zeros(3)
    span_m = float(np.max(at_m.max(axis=0) - low)) if len(at_m) else 0.0
    if span_m > LAS_SPAN_M:
        raise RecordingError(f"{path}: points {span_m:g} m apart; want at most {LAS_SPAN_M:.0f} m, or PLY or PCD")
    header = laspy.LasHeader(version="1.4", point_format=6)
    header.scales, header.offsets = np.full(3, LAS_STEP_M), low + LAS_STEP_M * 2.0**31
    header.generating_software = title[:32]
    for name, kind, what in (
        ("signal", "f4", "peak over threshold"),
        ("actor", "i4", "0 world, -1 none"),
        ("sensor", "u2", "number in the scenario"),
        ("ring", "u2", "layer, 0 the lowest"),
    ):
        header.add_extra_dim(laspy.ExtraBytesParams(name=name, type=kind, description=what))
    cloud = laspy.LasData(header)
    cloud.x, cloud.y, cloud.z = at_m.T
    cloud.gps_time = points["time"]
    cloud.intensity = np.clip(np.rint(np.nan_to_num(points["intensity"])), 0, 0xFFFF).astype(np.uint16)
    cloud.return_number = np.minimum(points["echo"] + 1, 15)
    cloud.number_of_returns = _returns(points)
    cloud.signal, cloud.actor = points["intensity"], points["actor"]
    cloud.sensor, cloud.ring = points["sensor"], points["ring"]
    cloud.write(str(path))


def _returns(points: Points) -> Any:
    """Echoes of the beam that each point belongs to: rows of a beam follow each other."""
    first = np.flatnonzero(np.concatenate(([True], np.diff(points["echo"].astype(np.int64)) <= 0)))[: len(points)]
    counts = np.diff(np.append(first, len(points)))
    return np.minimum(np.repeat(counts, counts), 15).astype(np.uint8)


WRITERS: Mapping[str, Callable[[Path, Points, str], None]] = {".pcd": _pcd, ".ply": _ply, ".las": _las}
"Suffix -> who writes it."


def write(path: Path, points: Points, title: str) -> None:
    """A file of points, whole or not at all; raises `RecordingError`."""
    part = path.with_name(f".{path.stem}.part{path.suffix}")
    try:
        WRITERS[path.suffix.lower()](part, points, title)
        os.replace(part, path)
    except OSError as error:
        raise RecordingError(f"{path}: cannot be written: {error.strerror or error}") from None
    finally:
        part.unlink(missing_ok=True)
