"""OSI GroundTruth and SensorView, read from their bytes: the fields that move actors, everything else is passed over.

Belongs here: protocol-buffer wire format as far as these messages need it. Not: datagrams (esmini), files (osi_files).

Source: open-simulation-interface 3.8.0 (groundtruth, object, common, sensorview); protobuf encoding:
protobuf.dev/programming-guides/encoding. Every field is optional, unknown ones are skipped.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Iterator

from emulator.live.rotations import Vector, from_angles
from emulator.live.samples import ActorSample, BadSample, Update, checked

VARINT, FIXED64, BYTES, FIXED32 = 0, 1, 2, 5
MOST_OBJECTS = 10_000
MOST_FIELDS = 500_000
"Of one message at one level."
NS = 1_000_000_000
MAJOR = 3

VEHICLES = {
    1: "car", 2: "car", 3: "car", 4: "car", 5: "car", 6: "van", 7: "truck", 8: "trailer", 9: "trailer",
    10: "motorcycle", 11: "bicycle", 12: "bus", 13: "tram", 14: "train", 15: "wheelchair", 16: "truck",
    17: "scooter", 18: "micromobility", 19: "work_machine", 20: "watercraft", 21: "aircraft", 22: "car",
}  # fmt: skip
KINDS = {1: "other", 2: "vehicle", 3: "pedestrian", 4: "animal"}
SIZES: dict[str, Vector] = {
    "pedestrian": (0.5, 0.6, 1.75),
    "truck": (10.0, 2.5, 3.2),
    "bus": (12.0, 2.5, 3.2),
    "bicycle": (1.8, 0.6, 1.7),
    "motorcycle": (2.2, 0.8, 1.6),
}
"Of moving objects whose dimensions are 0 or missing."
STATIONARY = {
    2: "bridge", 3: "building", 4: "pole", 5: "pylon", 6: "delineator", 7: "tree", 8: "barrier", 9: "vegetation",
    10: "curb", 11: "wall", 15: "reflective_structure", 16: "construction_element", 17: "speed_bump",
}  # fmt: skip
THIN_M = 0.1
"Sides of stationary objects that are 0 or missing: esmini sends posts so."
CAR: Vector = (4.5, 1.8, 1.5)

Field = tuple[int, int, "int | bytes"]


def fields(data: bytes) -> Iterator[Field]:
    """Number, wire type and value of each field; `BadSample` where the bytes are no message."""
    at, end, count = 0, len(data), 0
    while at < end:
        count += 1
        if count > MOST_FIELDS:
            raise BadSample(f"message: over {MOST_FIELDS} fields; want fewer")
        key, at = _varint(data, at, end)
        number, kind = key >> 3, key & 7
        if not number:
            raise BadSample("message: field 0; want 1 or more")
        if kind == VARINT:
            value, at = _varint(data, at, end)
            yield number, kind, value
            continue
        if kind == BYTES:
            size, at = _varint(data, at, end)
        elif kind in (FIXED64, FIXED32):
            size = 8 if kind == FIXED64 else 4
        else:
            raise BadSample(f"message: wire type {kind}; want 0, 1, 2 or 5")
        if size > end - at:
            raise BadSample(f"message: a field of {size} bytes with {end - at} left; want a whole message")
        yield number, kind, data[at : at + size]
        at += size


def _varint(data: bytes, at: int, end: int) -> tuple[int, int]:
    value = shift = 0
    while True:
        if at >= end or shift > 63:
            raise BadSample("message: a number without its end; want a whole message")
        byte = data[at]
        value |= (byte & 0x7F) << shift
        at += 1
        if byte < 0x80:
            return value & (2**64 - 1), at
        shift += 7


def _text(data: bytes) -> str:
    return data.decode("utf-8", "replace")[:1000]


def _id(data: bytes) -> int | None:
    found = None
    for number, kind, value in fields(data):
        if number == 1 and kind == VARINT:
            found = value
    return found  # type: ignore[return-value]


def _vector(data: int | bytes) -> Vector:
    found = [0.0, 0.0, 0.0]
    assert isinstance(data, bytes)
    for number, kind, value in fields(data):
        if number in (1, 2, 3) and kind == FIXED64:
            found[number - 1] = struct.unpack("<d", value)[0]  # type: ignore[arg-type]
    return (found[0], found[1], found[2])


def _signed(value: int) -> int:
    return value - 2**64 if value >= 2**63 else value


def ground_truth(data: bytes, stamp_ns: int | None = None, host: str | None = None) -> Update:
    """One GroundTruth as an update; a snapshot of all moving objects. `BadSample` where it cannot be used.

    `stamp_ns`, `host` : where the message itself has none
    """
    actors: list[ActorSample] = []
    for number, kind, value in fields(data):
        if kind != BYTES:
            continue
        assert isinstance(value, bytes)
        if number == 1:
            _check_version(value)
        elif number == 2:
            stamp_ns = _stamp(value)
        elif number == 3:
            found = _id(value)
            host = None if found is None else str(found)
        elif number in (4, 5):
            if len(actors) >= MOST_OBJECTS:
                raise BadSample(f"moving_object: over {MOST_OBJECTS}; want fewer")
            actors.append(_moving(value, len(actors)) if number == 5 else _stationary(value, len(actors)))
    if stamp_ns is None:
        raise BadSample("timestamp: none; want a GroundTruth with its time")
    return checked(Update(stamp_ns, tuple(actors), snapshot=True, host=host))


def sensor_view(data: bytes) -> Update:
    """The GroundTruth inside a SensorView, at the view's time where it has none."""
    inner, stamp_ns, host = None, None, None
    for number, kind, value in fields(data):
        if kind == BYTES and isinstance(value, bytes):
            if number == 7:
                inner = value
            elif number == 2:
                stamp_ns = _stamp(value)
            elif number == 8:
                host = _id(value)
    if inner is None:
        raise BadSample("global_ground_truth: none; want a SensorView with one")
    return ground_truth(inner, stamp_ns, None if host is None else str(host))


def _check_version(data: bytes) -> None:
    for number, kind, value in fields(data):
        if number == 1 and kind == VARINT and value != MAJOR:
            raise BadSample(f"version: {value!r}; want OSI {MAJOR}")


def _stamp(data: bytes) -> int:
    seconds = nanos = 0
    for number, kind, value in fields(data):
        if kind == VARINT and isinstance(value, int):
            seconds, nanos = (_signed(value), nanos) if number == 1 else (seconds, value if number == 2 else nanos)
    return seconds * NS + nanos


def _moving(data: bytes, place: int) -> ActorSample:
    found: int | None = None
    base: dict[int, Vector] = {}
    kind_of = vehicle = 0
    rear: Vector | None = None
    model = name = None
    for number, kind, value in fields(data):
        if kind == VARINT:
            kind_of = int(value) if number == 3 else kind_of
            continue
        if kind != BYTES:
            continue
        assert isinstance(value, bytes)
        if number == 1:
            found = _id(value)
        elif number == 2:
            base = {one: _vector(inner) for one, how, inner in fields(value) if how == BYTES and one in BASE}
        elif number == 5:
            rear = next((_vector(inner) for one, how, inner in fields(value) if one == 4 and how == BYTES), rear)
        elif number == 6:
            vehicle = next((int(inner) for one, how, inner in fields(value) if one == 1 and how == VARINT), vehicle)
        elif number == 7:
            model = _text(value)
        elif number == 10:
            name = _entity(value) or name
    if found is None:
        raise BadSample(f"moving_object.{place}.id: none; want one")
    if 2 not in base:
        raise BadSample(f"moving_object.{place}.base.position: none; want one")
    class_ = KINDS.get(kind_of, "unknown")
    class_ = VEHICLES.get(vehicle, "car") if class_ == "vehicle" else class_
    length, width, height = base.get(1, (0.0, 0.0, 0.0))
    usual = SIZES.get(class_, CAR)
    # OSI calls width what is along y and length what is along x; 0 means that it is not known
    size = (length or usual[0], width or usual[1], height or usual[2])
    roll, pitch, yaw = base.get(3, (0.0, 0.0, 0.0))
    angles = (yaw, pitch, roll)
    if not all(math.isfinite(angle) for angle in angles):
        raise BadSample(f"moving_object.{place}.base.orientation: {angles}; want numbers")
    return ActorSample(
        str(found), base[2], from_angles(yaw, pitch, roll), base.get(4), _spin(base), size, class_, name, model,
        "box_centre", rear,
    )  # fmt: skip


def _stationary(data: bytes, place: int) -> ActorSample:
    found: int | None = None
    base: dict[int, Vector] = {}
    class_, model = "unknown", None
    for number, kind, value in fields(data):
        if kind != BYTES:
            continue
        assert isinstance(value, bytes)
        if number == 1:
            found = _id(value)
        elif number == 2:
            base = {one: _vector(inner) for one, how, inner in fields(value) if how == BYTES and one in BASE}
        elif number == 3:
            what = next((int(inner) for one, how, inner in fields(value) if one == 1 and how == VARINT), 0)
            class_ = STATIONARY.get(what, "unknown")
        elif number == 4:
            model = _text(value)
    if found is None or 2 not in base:
        raise BadSample(f"stationary_object.{place}: without id or position; want both")
    roll, pitch, yaw = base.get(3, (0.0, 0.0, 0.0))
    if not all(math.isfinite(angle) for angle in (yaw, pitch, roll)):
        raise BadSample(f"stationary_object.{place}.base.orientation: {(yaw, pitch, roll)}; want numbers")
    length, width, height = (side or THIN_M for side in base.get(1, (0.0, 0.0, 0.0)))
    nothing = (0.0, 0.0, 0.0)
    return ActorSample(
        str(found), base[2], from_angles(yaw, pitch, roll), nothing, nothing, (length, width, height), class_,
        model=model, static=True,
    )  # fmt: skip


BASE = (1, 2, 3, 4, 6)
"dimension, position, orientation, velocity, orientation_rate"


def _spin(base: dict[int, Vector]) -> Vector | None:
    """Angular velocity from the rates of roll, pitch and yaw: omega = T(angles) rates, in the world's axes."""
    if 6 not in base:
        return None
    roll_rate, pitch_rate, yaw_rate = base[6]
    _, pitch, yaw = base.get(3, (0.0, 0.0, 0.0))
    cy, sy, cp, sp = math.cos(yaw), math.sin(yaw), math.cos(pitch), math.sin(pitch)
    return (cy * cp * roll_rate - sy * pitch_rate, sy * cp * roll_rate + cy * pitch_rate, yaw_rate - sp * roll_rate)


def _entity(data: bytes) -> str | None:
    """`entity_name:NAME` of an ExternalReference: identifiers are its field 3."""
    for number, kind, value in fields(data):
        if number == 3 and kind == BYTES and isinstance(value, bytes) and value.startswith(b"entity_name:"):
            return _text(value[len(b"entity_name:") :])
    return None
