"""The JSON pose feed: one datagram, or one line, is one update. docs/live_world.md has the schema.

Belongs here: text to updates and back. Not: sockets (receivers), what is done with an update (book).
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from typing import Any

from emulator.live.rotations import Quaternion, Vector, from_angles
from emulator.live.samples import REFERENCES, ActorSample, BadSample, Update, checked

MOST_BYTES = 4_000_000
"Of one line; a datagram has at most 65 507."
MOST_ACTORS = 10_000
MOST_UNKNOWN = 20
KEYS = ("t_s", "t_ns", "seq", "snapshot", "removed", "actors", "weather")
ACTOR_KEYS = (
    "id", "at_m", "yaw_deg", "pitch_deg", "roll_deg", "quaternion_xyzw", "velocity_m_s", "turn_rate_deg_s",
    "angular_velocity_deg_s", "size_m", "class", "model", "host", "reference", "jump", "static", "material", "shape",
)  # fmt: skip
UNUSED = ("weather", "material", "shape")
"Keys of the schema that are read and not used yet; reported like those that are not known."
USED = frozenset(KEYS) - frozenset(UNUSED)
ACTOR_USED = frozenset(ACTOR_KEYS) - frozenset(UNUSED)


def decoded(text: bytes | str) -> Update:
    """One update; `BadSample` names the key, what was found, and what is allowed."""
    if len(text) > MOST_BYTES:
        raise BadSample(f"line: {len(text)} bytes; want at most {MOST_BYTES}")
    try:
        data = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise BadSample(f"line: no JSON ({error}); want one object") from None
    return update_of(data)


def update_of(data: object) -> Update:
    """The same of a table that has been read already."""
    if not isinstance(data, Mapping):
        raise BadSample(f"line: {type(data).__name__}; want an object")
    actors = data.get("actors", ())
    if not isinstance(actors, list | tuple) or len(actors) > MOST_ACTORS:
        many = len(actors) if isinstance(actors, list | tuple) else type(actors).__name__
        raise BadSample(f"actors: {many}; want a list of at most {MOST_ACTORS}")
    removed = data.get("removed", ())
    if not isinstance(removed, list | tuple) or len(removed) > MOST_ACTORS:
        raise BadSample(f"removed: {removed!r:.60}; want a list of ids")
    unknown = [str(key)[:60] for key in data if key not in USED]
    samples = []
    for number, entry in enumerate(actors):
        if (plain := _plain(entry)) is not None:
            samples.append(plain)
            continue
        samples.append(_actor(entry, f"actors.{number}"))
        if not ACTOR_USED.issuperset(entry):
            unknown += [f"actors.{str(key)[:60]}" for key in entry if key not in ACTOR_USED]
    return checked(
        Update(
            _time(data),
            tuple(samples),
            tuple(_id(one, "removed") for one in removed),
            _flag(data, "snapshot", ""),
            _whole(data["seq"], "seq") if data.get("seq") is not None else None,
            unknown=tuple(dict.fromkeys(unknown))[:MOST_UNKNOWN],
        )
    )


PLAIN = frozenset(("id", "at_m", "yaw_deg", "velocity_m_s", "reference"))
"Keys of an actor that has nothing but a place, a heading and a velocity."


def _time(data: Mapping[str, Any]) -> int | None:
    if data.get("t_ns") is not None:
        return _whole(data["t_ns"], "t_ns")
    if data.get("t_s") is None:
        return None
    return round(_number(data["t_s"], "t_s", 4e9) * 1e9)


def _number(value: object, where: str, most: float = 1e300) -> float:
    if type(value) is float and -most <= value <= most:
        return value
    if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) <= most:
        raise BadSample(f"{where}: {value!r:.60}; want a number")
    return float(value)


def _whole(value: object, where: str) -> int:
    if isinstance(value, bool) or not isinstance(value, int) or abs(value) >= 2**63:
        raise BadSample(f"{where}: {value!r:.60}; want a whole number of 64 bits")
    return value


def _flag(data: Mapping[str, Any], key: str, where: str) -> bool:
    value = data.get(key, False)
    if not isinstance(value, bool):
        raise BadSample(f"{where}{key}: {value!r:.60}; want true or false")
    return value


def _id(value: object, where: str) -> str:
    if isinstance(value, str):
        return value
    return str(_whole(value, where))


def _text(entry: Mapping[str, Any], key: str, where: str) -> str | None:
    value = entry.get(key)
    if value is not None and (not isinstance(value, str) or len(value) > 1000):
        raise BadSample(f"{where}.{key}: {value!r:.60}; want a text")
    return value


def _vector(entry: Mapping[str, Any], key: str, where: str, least: int = 3) -> Vector | None:
    value = entry.get(key)
    if value is None:
        return None
    if not isinstance(value, list | tuple) or not least <= len(value) <= 3:
        raise BadSample(f"{where}.{key}: {value!r:.60}; want a list of 3 numbers")
    if len(value) == 3:
        x, y, z = value
        if type(x) is type(y) is type(z) is float and abs(x) + abs(y) + abs(z) <= 1e300:
            return (x, y, z)
    x, y, z = [*(_number(one, f"{where}.{key}") for one in value), 0.0][:3]
    return (x, y, z)


def _plain(entry: object) -> ActorSample | None:
    """What `_actor` makes of by far the most; None: there is more to it, or something is wrong with it."""
    if type(entry) is not dict or not PLAIN.issuperset(entry):
        return None
    id_, at_m, velocity, yaw = entry.get("id"), entry.get("at_m"), entry.get("velocity_m_s"), entry.get("yaw_deg")
    reference = entry.get("reference", "box_centre")
    if type(id_) is not str or type(at_m) is not list or type(velocity) is not list or type(yaw) is not float:
        return None
    if len(at_m) != 3 or len(velocity) != 3 or not -1e6 <= yaw <= 1e6 or type(reference) is not str:
        return None
    x, y, z = at_m
    u, v, w = velocity
    if not type(x) is type(y) is type(z) is type(u) is type(v) is type(w) is float or reference not in REFERENCES:
        return None
    if not (abs(x) + abs(y) + abs(z) <= 1e300 and abs(u) + abs(v) + abs(w) <= 1e300):
        return None
    half = math.radians(yaw) / 2.0
    # `from_angles` of a heading alone
    return ActorSample(id_, (x, y, z), (math.cos(half), 0.0, 0.0, math.sin(half)), (u, v, w), reference=reference)


def _actor(entry: object, where: str) -> ActorSample:
    if not isinstance(entry, Mapping):
        raise BadSample(f"{where}: {type(entry).__name__}; want an object")
    if "id" not in entry:
        raise BadSample(f"{where}.id: none; want a text or a whole number")
    at_m = _vector(entry, "at_m", where, 2)
    if at_m is None:
        raise BadSample(f"{where}.at_m: none; want [x, y, z]")
    id_ = _id(entry["id"], f"{where}.id")
    reference = _text(entry, "reference", where) or "box_centre"
    if reference not in REFERENCES:
        raise BadSample(f"{where}.reference: {reference!r:.60}; want one of {', '.join(REFERENCES)}")
    quaternion, velocity = _orientation(entry, where), _vector(entry, "velocity_m_s", where)
    spin = _vector(entry, "angular_velocity_deg_s", where)
    if spin is None and entry.get("turn_rate_deg_s") is not None:
        spin = (0.0, 0.0, _number(entry["turn_rate_deg_s"], f"{where}.turn_rate_deg_s"))
    return ActorSample(
        id=id_,
        at_m=at_m,
        quaternion=quaternion,
        velocity_m_s=velocity,
        spin_rad_s=None if spin is None else (math.radians(spin[0]), math.radians(spin[1]), math.radians(spin[2])),
        size_m=_vector(entry, "size_m", where),
        class_=_text(entry, "class", where),
        model=_text(entry, "model", where),
        reference=reference,
        host=_flag(entry, "host", f"{where}."),
        jump=_flag(entry, "jump", f"{where}."),
        static=_flag(entry, "static", f"{where}."),
    )


def _orientation(entry: Mapping[str, Any], where: str) -> Quaternion:
    value = entry.get("quaternion_xyzw")
    yaw, pitch, roll = entry.get("yaw_deg"), entry.get("pitch_deg"), entry.get("roll_deg")
    if value is None:
        return from_angles(
            math.radians(_number(yaw or 0.0, f"{where}.yaw_deg", 1e6)),
            math.radians(_number(pitch or 0.0, f"{where}.pitch_deg", 1e6)) if pitch else 0.0,
            math.radians(_number(roll or 0.0, f"{where}.roll_deg", 1e6)) if roll else 0.0,
        )
    if not yaw is pitch is roll is None:
        raise BadSample(f"{where}: quaternion_xyzw and angles; want one of both")
    if not isinstance(value, list | tuple) or len(value) != 4:
        raise BadSample(f"{where}.quaternion_xyzw: {value!r:.60}; want a list of 4 numbers")
    x, y, z, w = (_number(one, f"{where}.quaternion_xyzw") for one in value)
    norm = math.sqrt(x * x + y * y + z * z + w * w)
    if not 1e-6 < norm < 1e6:
        raise BadSample(f"{where}.quaternion_xyzw: of length {norm:g}; want one of length 1")
    return (w / norm, x / norm, y / norm, z / norm)


def as_json(update: Update) -> dict[str, object]:
    """An update as the schema has it, exactly: for recordings."""
    actors = []
    for one in update.actors:
        w, x, y, z = one.quaternion
        entry: dict[str, object] = {"id": one.id, "at_m": list(one.at_m), "quaternion_wxyz": [w, x, y, z]}
        more = {
            "velocity_m_s": one.velocity_m_s,
            "spin_rad_s": one.spin_rad_s,
            "size_m": one.size_m,
            "class": one.class_,
            "name": one.name,
            "model": one.model,
            "rear_m": one.rear_m,
        }
        entry |= {key: value for key, value in more.items() if value is not None}
        entry |= {"reference": one.reference} if one.reference != "box_centre" else {}
        entry |= {key: True for key in ("host", "jump", "static") if getattr(one, key)}
        actors.append(entry)
    reported: dict[str, object] = {"t_ns": update.t_ns, "actors": actors}
    reported |= {"removed": list(update.removed)} if update.removed else {}
    reported |= {"snapshot": True} if update.snapshot else {}
    reported |= {"host": update.host} if update.host is not None else {}
    return reported if update.seq is None else reported | {"seq": update.seq}


def of_json(data: Mapping[str, Any]) -> Update:
    """The inverse of `as_json`."""

    def vector(entry: Mapping[str, Any], key: str) -> Vector | None:
        return tuple(entry[key]) if key in entry else None

    actors = tuple(
        ActorSample(
            entry["id"], tuple(entry["at_m"]), tuple(entry["quaternion_wxyz"]), vector(entry, "velocity_m_s"),
            vector(entry, "spin_rad_s"), vector(entry, "size_m"), entry.get("class"), entry.get("name"),
            entry.get("model"), entry.get("reference", "box_centre"), vector(entry, "rear_m"),
            entry.get("host", False), entry.get("jump", False), entry.get("static", False),
        )
        for entry in data["actors"]
    )  # fmt: skip
    return checked(
        Update(
            data["t_ns"], actors, tuple(data.get("removed", ())), data.get("snapshot", False), data.get("seq"),
            data.get("host"),
        )
    )  # fmt: skip
