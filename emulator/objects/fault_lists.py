"""What faults make of an object list, behind the tracker and before the wire.

Not: keys and kinds (measurement).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import replace

from emulator.sensing.faulty.held import Held
from protocols.scan import DetectedObject, Scan

GHOST_TRACK = 60_000
"Track of a ghost, plus the fault's number."

Objects = tuple[DetectedObject, ...]
Memory = dict[int, Objects]
"Of one sensor: number of a fault -> the list that it froze."


def _ghost_object(one: Held, objects: Objects, memory: Memory) -> Objects:
    keys, t = one.keys, one.since_s
    ghost = DetectedObject(
        track=GHOST_TRACK + one.number,
        position_m=(keys.x_m + keys.vx_m_s * t, keys.y_m + keys.vy_m_s * t, 0.0),
        velocity_m_s=(keys.vx_m_s, keys.vy_m_s, 0.0),
        size_m=(keys.length_m, keys.width_m, 1.5),
        yaw_rad=0.0,
        category=keys.category,
        age_s=t,
        reflectance=0.3,
    )
    return (*objects, ghost)


def _far(item: DetectedObject) -> float:
    return math.hypot(item.position_m[0], item.position_m[1])


def _lost_object(one: Held, objects: Objects, memory: Memory) -> Objects:
    if one.keys.actor is not None:
        return tuple(item for item in objects if item.actor != one.keys.actor)
    nearest = min(objects, key=_far, default=None)
    return tuple(item for item in objects if item is not nearest)


def _swapped_ids(one: Held, objects: Objects, memory: Memory) -> Objects:
    if one.keys.each_s is not None and int(one.since_s / one.keys.each_s) % 2:
        return objects
    pair = sorted(objects, key=_far)[:2]
    if len(pair) < 2:
        return objects
    other = {id(pair[0]): pair[1].track, id(pair[1]): pair[0].track}
    return tuple(replace(item, track=other.get(id(item), item.track)) for item in objects)


def _frozen_list(one: Held, objects: Objects, memory: Memory) -> Objects:
    return memory.setdefault(one.number, objects)


LISTS: Mapping[str, Callable[[Held, Objects, Memory], Objects]] = {
    "frozen_list": _frozen_list,
    "lost_object": _lost_object,
    "swapped_ids": _swapped_ids,
    "ghost_object": _ghost_object,
}
"Name -> what becomes of a list, in this order."


def listed(scan: Scan, faults: tuple[Held, ...], memory: Memory) -> Scan:
    """A list as the device gives it out."""
    objects = scan.objects
    for name, effect in LISTS.items():
        for one in faults:
            if one.name == name:
                objects = effect(one, objects, memory)
    return scan if objects is scan.objects else replace(scan, objects=objects)
