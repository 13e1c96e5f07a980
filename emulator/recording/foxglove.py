"""Foxglove's messages of a run: point clouds, laser scans, boxes; viewers show them without code of ours.

Belongs here: messages of the published schemas foxglove.PointCloud, LaserScan, SceneUpdate (foxglove/foxglove-sdk,
MIT; `schemas/` has their descriptors). Not: the file (writer), poses (whereabouts).
"""

from __future__ import annotations

from importlib import resources
from typing import Protocol

import numpy as np

from emulator.instrument.observer import Observer
from emulator.recording import protowire as wire
from emulator.recording.whereabouts import Whereabouts
from emulator.world.motion import quaternion_of
from protocols.scan import DetectedObject, Floats, Scan

FRAME = "world"
FLOAT32, INT32 = 7, 6
POINT = np.dtype([("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("intensity", "<f4"), ("actor", "<i4"), ("beam", "<i4")])
SCENE_NS = 50_000_000
"Between two messages with the boxes of actors."
ACTOR, EGO, OBJECT = (0.55, 0.6, 0.65, 0.35), (0.1, 0.5, 0.9, 0.35), (0.9, 0.5, 0.1, 0.5)
"Red, green, blue, opacity."


class Channels(Protocol):
    """Takes messages for a file."""

    def foreign(self, topic: str, schema: str, descriptors: bytes, at_ns: int, data: bytes) -> None:
        """One message of a published schema in protocol buffers."""


def descriptors(name: str) -> bytes:
    """Serialised `FileDescriptorSet` of `foxglove.NAME`."""
    return (resources.files("emulator.recording") / "schemas" / f"foxglove.{name}.binpb").read_bytes()


def _pose(at_m: Floats, rotation: Floats) -> bytes:
    w, x, y, z = (float(part) for part in quaternion_of(rotation))
    return wire.piece(1, wire.doubles(at_m.tolist())) + wire.piece(2, wire.doubles((x, y, z, w)))


def point_cloud(at_ns: int, points: np.ndarray) -> bytes:
    """Of rows of `POINT` in the world."""
    fields = b""
    for name in POINT.names or ():
        kind, offset = POINT.fields[name][:2]  # type: ignore[index]
        number = FLOAT32 if kind.kind == "f" else INT32
        fields += wire.piece(5, wire.piece(1, name) + wire.fixed32(2, offset) + wire.whole(3, number))
    head = wire.piece(1, wire.instant(at_ns)) + wire.piece(2, FRAME)
    head += wire.piece(3, _pose(np.zeros(3), np.eye(3))) + wire.fixed32(4, POINT.itemsize)
    return head + fields + wire.piece(6, points.tobytes())


def laser_scan(at_ns: int, at_m: Floats, rotation: Floats, scan: Scan) -> bytes:
    """First echoes of a scan whose beams are evenly apart in one plane; infinity where there is none."""
    azimuth = scan.plan.azimuth_rad
    first = np.where(np.isfinite(scan.range_m[:, 0]), scan.range_m[:, 0], np.inf)
    strength = np.nan_to_num(scan.intensity[:, 0])
    head = wire.piece(1, wire.instant(at_ns)) + wire.piece(2, FRAME) + wire.piece(3, _pose(at_m, rotation))
    head += wire.double(4, float(azimuth[0])) + wire.double(5, float(azimuth[-1]))
    return head + wire.piece(6, first.astype("<f8").tobytes()) + wire.piece(7, strength.astype("<f8").tobytes())


def is_even(scan: Scan) -> bool:
    """Whether a `LaserScan` can tell it."""
    azimuth = scan.plan.azimuth_rad
    if len(azimuth) < 2 or np.any(scan.plan.elevation_rad):
        return False
    even = np.linspace(azimuth[0], azimuth[-1], len(azimuth))
    return bool(np.abs(azimuth - even).max() < 1e-6)


def entity(
    at_ns: int, name: str, at_m: Floats, rotation: Floats, size_m: Floats, colour: tuple[float, ...], about: str
) -> bytes:
    """A box with its name."""
    pose = _pose(at_m, rotation)
    cube = wire.piece(1, pose) + wire.piece(2, wire.doubles(size_m.tolist())) + wire.piece(3, wire.doubles(colour))
    pair = wire.piece(1, "class") + wire.piece(2, about)
    head = wire.piece(1, wire.instant(at_ns)) + wire.piece(2, FRAME) + wire.piece(3, name)
    return head + wire.piece(6, pair) + wire.piece(8, cube)


def scene_update(at_ns: int, entities: list[bytes]) -> bytes:
    """All boxes of a topic; those before are gone."""
    gone = wire.piece(1, wire.instant(at_ns)) + wire.whole(2, 1)
    return wire.piece(1, gone) + b"".join(wire.piece(2, one) for one in entities)


class FoxgloveChannels(Observer):
    """Writes /SENSOR/points, /SENSOR/laser, /SENSOR/boxes and /world/boxes beside what a recording has."""

    def __init__(self, channels: Channels, where: Whereabouts) -> None:
        self._out, self._where = channels, where
        self._schemas = {name: descriptors(name) for name in ("PointCloud", "LaserScan", "SceneUpdate")}
        self._next_ns = -SCENE_NS

    def _put(self, topic: str, schema: str, at_ns: int, data: bytes) -> None:
        self._out.foreign(topic, f"foxglove.{schema}", self._schemas[schema], at_ns, data)

    def scan(self, sensor: str, scan: Scan) -> None:
        at_ns = scan.plan.start_ns
        if at_ns >= self._next_ns:
            self._next_ns = at_ns + SCENE_NS
            self._actors(at_ns)
        if len(scan.plan):
            at_m, intensity, actor, beam = self._where.points(sensor, scan)
            points: np.ndarray = np.zeros(len(at_m), POINT)
            points["x"], points["y"], points["z"] = at_m.T
            points["intensity"], points["actor"], points["beam"] = intensity, actor, beam
            self._put(f"/{sensor}/points", "PointCloud", at_ns, point_cloud(at_ns, points))
            if is_even(scan):
                pose = self._where.sensor(sensor, np.array([at_ns * 1e-9]))
                data = laser_scan(at_ns, pose.position_m[0], pose.rotation[0], scan)
                self._put(f"/{sensor}/laser", "LaserScan", at_ns, data)
        if scan.plan.wants_objects:
            self._objects(sensor, at_ns, scan.objects)

    def _actors(self, at_ns: int) -> None:
        where = self._where
        rows = [
            entity(at_ns, one.name, one.centre_m, one.rotation, one.size_m, EGO if one.name == where.ego else ACTOR,
                   where.scene.classes[one.index])
            for one in where.boxes(at_ns * 1e-9)
        ]  # fmt: skip
        self._put("/world/boxes", "SceneUpdate", at_ns, scene_update(at_ns, rows))

    def _objects(self, sensor: str, at_ns: int, objects: tuple[DetectedObject, ...]) -> None:
        pose = self._where.sensor(sensor, np.array([at_ns * 1e-9]))
        rows = []
        for one in objects:
            cos, sin = np.cos(one.yaw_rad), np.sin(one.yaw_rad)
            turned = pose.rotation[0] @ np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
            at_m = pose.to_world(np.asarray(one.position_m))[0]
            size = np.maximum(one.size_m, 0.05)
            rows.append(entity(at_ns, str(one.track), at_m, turned, size, OBJECT, one.category))
        self._put(f"/{sensor}/boxes", "SceneUpdate", at_ns, scene_update(at_ns, rows))
