"""One update from a feeder: the poses of some actors at one instant of the feeder's clock.

Belongs here: the form that all formats are decoded to, and what a number in it may be. Not: formats (json_lines, osi),
how samples are kept (book).
"""

from __future__ import annotations

from dataclasses import dataclass, field

from emulator.live.rotations import Quaternion, Vector

MOST_M = 1e7
"Of a coordinate; beyond it an update is dropped."
MOST_M_S = 1e5
MOST_RAD_S = 1e4
MOST_SIZE_M = 1e4
MOST_ID = 128
"Characters of an id."
NS_MOST = 2**62
REFERENCES = ("box_centre", "origin", "rear_axle", "ground")
"""What a position is of: the centre of the box of the actor's shape, the shape's own origin, the middle of the rear
axle, or the point of the ground below the centre of the box."""


class BadSample(ValueError):
    """An update that is not used, and why: `key: found; want allowed`."""


@dataclass(slots=True)
class ActorSample:
    """One actor at the instant of its update; nobody changes one: frozen, it takes three times as long to make."""

    id: str
    at_m: Vector
    "Of the point that `reference` names, in the world."
    quaternion: Quaternion = (1.0, 0.0, 0.0, 0.0)
    "w x y z, body to world, of unit length."
    velocity_m_s: Vector | None = None
    "In the world's axes."
    spin_rad_s: Vector | None = None
    "Angular velocity, in the world's axes."
    size_m: Vector | None = None
    "Length, width, height of its box; 0: unknown."
    class_: str | None = None
    name: str | None = None
    "As the feeder calls it, beside its id."
    model: str | None = None
    "Whatever the feeder says of its mesh."
    reference: str = "box_centre"
    rear_m: Vector | None = None
    "From the centre of the box to the middle of the rear axle, in the body's axes."
    host: bool = False
    jump: bool = False
    "Not to be interpolated from the sample before."
    static: bool = False
    "It stands there until another update has such ones, whatever `snapshot` says."


@dataclass(frozen=True)
class Update:
    """All of one message."""

    t_ns: int | None
    "On the feeder's clock; None: when it has come."
    actors: tuple[ActorSample, ...] = ()
    removed: tuple[str, ...] = ()
    snapshot: bool = False
    "Actors that are not in it are gone."
    seq: int | None = None
    host: str | None = None
    "Id of the feeder's host vehicle."
    unknown: tuple[str, ...] = ()
    "Keys that nobody reads."
    sound: bool = field(default=False, compare=False)
    "`checked` has found nothing wrong."


def finite(where: str, values: tuple[float, ...], most: float) -> None:
    """`BadSample` unless all are numbers of at most that size."""
    for value in values:
        if not -most <= value <= most:
            raise BadSample(f"{where}: {value!r}; want numbers from {-most:g} to {most:g}")


def _small(values: tuple[float, ...] | None, most: float) -> bool:
    """What `finite` asks for, of most samples."""
    # NaN is not <= anything, and the sum is at least the largest of them
    return values is None or sum(map(abs, values)) <= most


def _is_turn(quaternion: Quaternion) -> bool:
    """The same of an orientation."""
    w, x, y, z = quaternion
    return w * w + x * x + y * y + z * z <= 1.0 + 1e-9


def checked(update: Update) -> Update:
    """The same update; `BadSample` when a number in it cannot be."""
    if update.sound:
        return update
    if update.t_ns is not None and abs(update.t_ns) > NS_MOST:
        raise BadSample(f"t_s: {update.t_ns * 1e-9:g}; want a time within 146 years of 0")
    seen: set[str] = set()
    for number, one in enumerate(update.actors):
        if not one.id or len(one.id) > MOST_ID:
            raise BadSample(f"actors.{number}.id: {len(one.id)} characters; want 1 to {MOST_ID}")
        if one.id in seen:
            raise BadSample(f"actors.{number}.id: {one.id!r} for a second time; want each actor once")
        seen.add(one.id)
        if (
            _small(one.at_m, MOST_M)
            and _is_turn(one.quaternion)
            and _small(one.velocity_m_s, MOST_M_S)
            and one.spin_rad_s is None
            and one.size_m is None
            and one.rear_m is None
            and one.reference in REFERENCES
        ):
            continue
        where = f"actors.{number}"
        finite(f"{where}.at_m", one.at_m, MOST_M)
        finite(f"{where}.quaternion_xyzw", one.quaternion, 1.0 + 1e-9)
        finite(f"{where}.velocity_m_s", one.velocity_m_s or (), MOST_M_S)
        finite(f"{where}.turn_rate_deg_s", one.spin_rad_s or (), MOST_RAD_S)
        finite(f"{where}.size_m", one.size_m or (), MOST_SIZE_M)
        finite(f"{where}.rear", one.rear_m or (), MOST_SIZE_M)
        if one.size_m is not None and min(one.size_m) < 0.0:
            raise BadSample(f"{where}.size_m: {min(one.size_m):g}; want numbers >= 0")
        if one.reference not in REFERENCES:
            raise BadSample(f"{where}.reference: {one.reference!r}; want one of {', '.join(REFERENCES)}")
    object.__setattr__(update, "sound", True)
    return update
