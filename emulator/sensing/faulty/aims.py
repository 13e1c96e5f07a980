"""Where the beams of a sweep really go under faults of mirror, encoder and mount.

Not: keys and kinds (mechanics), the motor's speed (the device's own session follows it).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np

from emulator.physics.arrays import Floats
from emulator.physics.beams import axis_directions
from emulator.physics.random_streams import RandomStreams
from emulator.sensing.faulty.held import Held
from protocols.scan import ScanPlan

Aim = tuple[Floats, Floats]
"Azimuths and elevations."


def _times_s(one: Held, plan: ScanPlan) -> Floats:
    """(n,) since the fault began, of every beam."""
    return np.asarray(one.since_s + plan.fire_offset_s)


def _wobble(one: Held, plan: ScanPlan, draws: RandomStreams, aim: Aim) -> Aim:
    wave = np.sin(2.0 * np.pi * one.keys.hz * _times_s(one, plan))
    return aim[0] + math.radians(one.keys.azimuth_deg) * wave, aim[1] + math.radians(one.keys.elevation_deg) * wave


def _stuck(one: Held, plan: ScanPlan, draws: RandomStreams, aim: Aim) -> Aim:
    at_rad = math.radians(one.keys.at_deg) if one.keys.at_deg is not None else None
    if at_rad is None:
        chosen = int(one.uniform(draws, "stands", 0, 1)[0, 0] * len(plan))
        at_rad = float(np.sort(plan.azimuth_rad)[chosen])
    return np.full(len(plan), at_rad), aim[1]


def _offset(one: Held, plan: ScanPlan, draws: RandomStreams, aim: Aim) -> Aim:
    return aim[0] + math.radians(one.keys.azimuth_deg), aim[1]


def _layer_offset(one: Held, plan: ScanPlan, draws: RandomStreams, aim: Aim) -> Aim:
    mine = one.keys.holds(plan.elevation_rad)  # a layer is what the device believes it is
    return aim[0] + np.radians(one.keys.azimuth_deg) * mine, aim[1] + np.radians(one.keys.up_deg) * mine


MOST_SLIPS = 4096


def _slip(one: Held, plan: ScanPlan, draws: RandomStreams, aim: Aim) -> Aim:
    pauses = -np.log(one.uniform(draws, "pauses", 0, MOST_SLIPS)[:, 0]) * one.keys.every_s
    slips = np.searchsorted(np.cumsum(pauses), _times_s(one, plan), side="right")
    return aim[0] + math.radians(one.keys.jump_deg) * slips, aim[1]


def _turned(aim: Aim, yaw: Floats, pitch: Floats, roll: Floats) -> Aim:
    """Directions after the sensor has turned by (n,) angles about its own axes: yaw, then pitch, then roll. [rad]"""
    x, y, z = axis_directions(*aim).T
    y, z = y * np.cos(roll) - z * np.sin(roll), y * np.sin(roll) + z * np.cos(roll)
    x, z = x * np.cos(pitch) + z * np.sin(pitch), z * np.cos(pitch) - x * np.sin(pitch)
    x, y = x * np.cos(yaw) - y * np.sin(yaw), x * np.sin(yaw) + y * np.cos(yaw)
    return np.arctan2(y, x), np.arctan2(z, np.hypot(x, y))


def _tilt(one: Held, plan: ScanPlan, draws: RandomStreams, aim: Aim) -> Aim:
    keys, t = one.keys, _times_s(one, plan)
    swing = np.ones(len(plan))
    if keys.settles_s is not None:
        swing += np.exp(-np.maximum(t, 0.0) / keys.settles_s) * np.cos(2.0 * np.pi * keys.swings_hz * t)
    angles = [math.radians(value) * swing for value in (keys.yaw_deg, keys.pitch_deg, keys.roll_deg)]
    return _turned(aim, *angles)


def _vibration(one: Held, plan: ScanPlan, draws: RandomStreams, aim: Aim) -> Aim:
    phase = 2.0 * np.pi * one.uniform(draws, "phases", 0, 3)[:, 0]
    wave = 2.0 * np.pi * one.keys.hz * _times_s(one, plan)
    amplitudes = (one.keys.yaw_deg, one.keys.pitch_deg, one.keys.roll_deg)
    return _turned(aim, *(math.radians(a) * np.sin(wave + p) for a, p in zip(amplitudes, phase, strict=True)))


AIMS: Mapping[str, Callable[[Held, ScanPlan, RandomStreams, Aim], Aim]] = {
    "mirror_wobble": _wobble,
    "mirror_stuck": _stuck,
    "layer_offset": _layer_offset,
    "encoder_offset": _offset,
    "encoder_slip": _slip,
    "mount_tilt": _tilt,
    "vibration": _vibration,
}
"Name -> where the beams go instead. Mirror and encoder first, then the mount that carries them."


def aimed(plan: ScanPlan, faults: tuple[Held, ...], draws: RandomStreams) -> ScanPlan:
    """The sweep as the beams really go."""
    aim = plan.azimuth_rad, plan.elevation_rad
    for name, effect in AIMS.items():
        for one in faults:
            if one.name == name:
                aim = effect(one, plan, draws, aim)
    if aim[0] is plan.azimuth_rad and aim[1] is plan.elevation_rad:
        return plan
    return replace(plan, azimuth_rad=aim[0], elevation_rad=aim[1])


def shift_m(faults: tuple[Held, ...]) -> Floats | None:
    """How far the sensor is from where it should be, in its own frame; None: not at all."""
    moved = [(one.keys.x_m, one.keys.y_m, one.keys.z_m) for one in faults if one.name == "mount_shift"]
    return np.sum(moved, axis=0) if moved else None
