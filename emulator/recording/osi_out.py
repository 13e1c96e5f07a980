"""OSI `SensorData` of every scan: a detection an echo, a moving object a listed one; by UDP, or a trace.

Belongs here: fields of OSI 3.8 that are filled, and where they go. Not: poses (whereabouts), what comes in (live).
Numbers of fields: osi_sensordata.proto, osi_featuredata.proto, osi_detectedobject.proto, osi_common.proto of 3.8.0.
"""

from __future__ import annotations

import contextlib
import math
import socket
import struct
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol

import numpy as np

from emulator.errors import LinkError
from emulator.instrument.observer import Observer
from emulator.live.esmini import datagrams
from emulator.recording import protowire as wire
from emulator.recording.whereabouts import Whereabouts
from emulator.scenario.tables import Mount
from emulator.world.motion import Pose
from protocols.scan import DetectedObject, Scan

VERSION = wire.whole(1, 3) + wire.whole(2, 8) + wire.whole(3, 0)
DEFAULT_PORT = 48_199
OTHER, VEHICLE, PEDESTRIAN = 1, 2, 3
CLASSES = {"car": (VEHICLE, 4), "truck": (VEHICLE, 7), "motorcycle": (VEHICLE, 10), "bicycle": (VEHICLE, 11),
           "pedestrian": (PEDESTRIAN, None)}  # fmt: skip
"Category -> MovingObject.Type, VehicleClassification.Type: medium car, heavy truck, motorbike, bicycle; else: other."

ROW = np.dtype([
    ("head", "u1", 2), ("exists_key", "u1"), ("exists", "<f8"), ("object", "u1", 8), ("position", "u1", 2),
    ("range_key", "u1"), ("range", "<f8"), ("azimuth_key", "u1"), ("azimuth", "<f8"),
    ("elevation_key", "u1"), ("elevation", "<f8"), ("intensity_key", "u1"), ("intensity", "<f8"), ("beam", "u1", 6),
])  # fmt: skip
"A `LidarDetection` of a moving object as a field 2 of LidarDetectionData; without its `object` of one of the world."
OBJECT = slice(ROW.fields["object"][1], ROW.fields["object"][1] + 8)  # type: ignore[index]


class Out(Protocol):
    """Where messages go."""

    def send(self, message: bytes) -> None: ...
    def close(self) -> None: ...


class _Datagrams:
    def __init__(self, host: str, port: int) -> None:
        self._socket = socket.socket(socket.AF_INET6 if ":" in host else socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.connect((host, port))
        self._socket.setblocking(False)

    def send(self, message: bytes) -> None:
        for one in datagrams(message):
            try:
                self._socket.send(one)
            except (ConnectionRefusedError, BlockingIOError):
                return  # nobody listens, or not so fast: what is UDP's

    def close(self) -> None:
        self._socket.close()


class _Trace:
    def __init__(self, path: Path) -> None:
        self._file = path.open("wb")

    def send(self, message: bytes) -> None:
        self._file.write(struct.pack("<I", len(message)) + message)

    def close(self) -> None:
        self._file.close()


class _Mcap:
    """By the extra `osi`, which has the descriptors of OSI's messages."""

    def __init__(self, path: Path) -> None:
        try:
            import betterosi
        except ImportError:
            raise LinkError(f"record.osi: {path}: MCAP wants betterosi: pip install 'lidaremu[osi]'") from None
        if path.suffix != ".mcap":
            raise LinkError(f"record.osi: {path}; want a name that ends in .mcap")
        self._message, self._open = betterosi.SensorData, contextlib.ExitStack()
        self._writer = self._open.enter_context(betterosi.Writer(path, topic="sensor_data"))

    def send(self, message: bytes) -> None:
        self._writer.add(self._message.from_binary(message))

    def close(self) -> None:
        self._open.close()


KINDS = "osi-udp://HOST:PORT, osi-trace:FILE.osi or osi-mcap:FILE.mcap"


def opened(url: str) -> Out:
    """`osi-udp://HOST:PORT`, `osi-trace:FILE`, `osi-mcap:FILE`; `LinkError` where that cannot be had."""
    kind, _, rest = url.partition(":")
    try:
        if kind == "osi-trace" and rest:
            return _Trace(Path(rest))
        if kind == "osi-mcap" and rest:
            return _Mcap(Path(rest))
        host, colon, port = rest.removeprefix("//").rpartition(":")
        if kind == "osi-udp" and colon and port.isdecimal() and 0 < int(port) < 65_536:
            return _Datagrams(host.strip("[]"), int(port))
    except OSError as error:
        raise LinkError(f"record.osi: {url}: {error.strerror or error}") from None
    raise LinkError(f"record.osi: {url}; want {KINDS}")


# ---------------------------------------------------------------- messages


def detections(scan: Scan) -> bytes:
    """`LidarDetection`s of all echoes. Intensity: 100 (1 - 1/i) per cent, i the peak over the detection threshold."""
    beam, place = np.nonzero(np.isfinite(scan.range_m))
    actor = scan.actor[beam, place]
    moves = actor > 0
    rows: np.ndarray = np.zeros(len(beam), ROW)
    size = np.where(moves, ROW.itemsize - 2, ROW.itemsize - 2 - 8)
    rows["head"][:, 0], rows["head"][:, 1] = wire.key(2, wire.BYTES)[0], size
    rows["exists_key"], rows["exists"] = wire.key(1, wire.FIXED64)[0], 1.0
    number = np.maximum(actor, 0).astype(np.int64)
    rows["object"][:, :3] = (wire.key(2, wire.BYTES)[0], 6, wire.key(1, wire.VARINT)[0])
    for at in range(5):  # in all five bytes that a number of 32 bits may take
        rows["object"][:, 3 + at] = (number >> 7 * at) & 0x7F | (0x80 if at < 4 else 0)
    rows["position"][:, :2] = (wire.key(3, wire.BYTES)[0], 27)
    return b"" if not len(rows) else _filled(rows, scan, beam, place, moves)


def _filled(rows: np.ndarray, scan: Scan, beam: np.ndarray, place: np.ndarray, moves: np.ndarray) -> bytes:
    strength = np.maximum(np.nan_to_num(scan.intensity[beam, place], nan=1.0), 1.0)
    rows["range_key"], rows["range"] = wire.key(1, wire.FIXED64)[0], scan.range_m[beam, place]
    rows["azimuth_key"], rows["azimuth"] = wire.key(2, wire.FIXED64)[0], scan.plan.azimuth_rad[beam]
    rows["elevation_key"], rows["elevation"] = wire.key(3, wire.FIXED64)[0], scan.plan.elevation_rad[beam]
    rows["intensity_key"], rows["intensity"] = wire.key(7, wire.FIXED64)[0], 100.0 * (1.0 - 1.0 / strength)
    rows["beam"][:, :3] = (wire.key(13, wire.BYTES)[0], 4, wire.key(1, wire.VARINT)[0])
    for at in range(3):
        rows["beam"][:, 3 + at] = (beam >> 7 * at) & 0x7F | (0x80 if at < 2 else 0)
    data = rows.tobytes()
    size, skip = ROW.itemsize, OBJECT
    parts = []
    for number, one in enumerate(moves):
        row = data[number * size : (number + 1) * size]
        parts.append(row if one else row[: skip.start] + row[skip.stop :])
    return b"".join(parts)


def angles(rotation: np.ndarray) -> tuple[float, float, float]:
    """Roll, pitch, yaw of a body, ISO 8855. [rad]"""
    pitch = math.asin(max(-1.0, min(1.0, -float(rotation[2, 0]))))
    roll = math.atan2(float(rotation[2, 1]), float(rotation[2, 2]))
    return roll, pitch, math.atan2(float(rotation[1, 0]), float(rotation[0, 0]))


def moving_object(one: DetectedObject, ids: dict[str, int], sensor_id: int) -> bytes:
    """`DetectedMovingObject`, in the sensor's frame as it is listed."""
    head = wire.piece(1, wire.whole(1, one.track)) + wire.double(3, one.existence)
    if one.actor in ids:
        head += wire.piece(2, wire.whole(1, ids[one.actor]))
    head += wire.piece(4, wire.instant(round(one.age_s * 1e9))) + wire.piece(6, wire.whole(1, sensor_id))
    base = wire.piece(1, wire.doubles(one.size_m)) + wire.piece(2, wire.doubles(one.position_m))
    base += wire.piece(3, wire.doubles((0.0, 0.0, one.yaw_rad))) + wire.piece(4, wire.doubles(one.velocity_m_s))
    kind, vehicle = CLASSES.get(one.category, (OTHER, None))
    guess = wire.double(1, one.existence) + wire.whole(2, kind)
    guess += b"" if vehicle is None else wire.piece(3, wire.whole(1, vehicle))
    return wire.piece(1, head) + wire.piece(2, base) + wire.piece(8, guess)


def sensor_data(scan: Scan, sensor_id: int, mount: Mount, ego: Pose | None, ids: dict[str, int]) -> bytes:
    """One scan. Times are those of its end; `ego`: what carries the sensor, then. `ids`: actor -> its number."""
    plan = scan.plan
    end_ns = plan.start_ns + round(plan.duration_s * 1e9)
    place = wire.piece(1, wire.doubles(mount.at_m))
    place += wire.piece(2, wire.doubles(math.radians(one) for one in (mount.roll_deg, mount.pitch_deg, mount.yaw_deg)))
    number, at = wire.whole(1, sensor_id), wire.instant(end_ns)
    out = wire.piece(1, VERSION) + wire.piece(2, at)
    if ego is not None:
        pose = wire.piece(2, wire.doubles(ego.position_m[0].tolist())) + wire.piece(
            3, wire.doubles(angles(ego.rotation[0]))
        )
        out += wire.piece(3, pose)
    out += wire.piece(5, number) + wire.piece(6, place) + wire.piece(9, at)
    if plan.wants_objects:
        counter = wire.piece(1, at) + wire.whole(2, max(0, plan.sweep))
        out += wire.piece(12, counter)
        return out + b"".join(wire.piece(13, moving_object(one, ids, sensor_id)) for one in scan.objects)
    echoes = detections(scan)
    count = int(np.isfinite(scan.range_m).sum())
    head = wire.piece(1, at) + wire.whole(2, max(0, plan.sweep)) + wire.piece(3, place)
    head += wire.whole(6, count) + wire.piece(7, number)
    return out + wire.piece(26, wire.piece(1, VERSION) + wire.piece(3, wire.piece(1, head) + echoes))


@dataclass
class Newest:
    """The newest message of each sensor, for a feeder that takes them out."""

    is_wanted: bool = False
    "Nobody has asked: none are made."
    messages: dict[str, bytes] = field(default_factory=dict)


class OsiOut(Observer):
    """Sends every scan of a run."""

    def __init__(self, where: Whereabouts, outs: list[Out], failed: Callable[[str], None]) -> None:
        """`failed` is reported once of a place that takes no more."""
        self._where, self._outs, self._failed = where, outs, failed
        self.newest = Newest()
        self._ids = where.scene.index

    def scan(self, sensor: str, scan: Scan) -> None:
        if not self._outs and not self.newest.is_wanted:
            return
        mount = self._where.mount(sensor)
        end_s = scan.plan.start_ns * 1e-9 + scan.plan.duration_s
        ego = None if mount.actor is None else self._where.actor(mount.actor, end_s)
        message = sensor_data(scan, self._where.sensors.index(sensor) + 1, mount, ego, self._ids)
        if self.newest.is_wanted:
            self.newest.messages[sensor] = message
        for one in tuple(self._outs):
            try:
                one.send(message)
            except OSError as error:
                self._outs.remove(one)
                self._failed(f"record.osi: {error.strerror or error}; sends no more")

    def close(self) -> None:
        """Close files and sockets."""
        for one in self._outs:
            one.close()
        self._outs.clear()
