"""What faults behind the receiver make of a scan.

Not: keys and kinds (measurement), object lists (lists).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np

from emulator.physics.arrays import Bools
from emulator.physics.random_streams import RandomStreams
from emulator.sensing.faulty.held import Held
from protocols.scan import Scan, ScanPlan

FROZEN_SWEEP = -(2**40)
"The sweep whose draws a frozen picture has, minus the fault's number."

Reading = Callable[[Held, Scan, RandomStreams], Scan]


def _inside(one: Held, scan: Scan) -> Bools:
    """(n, 1) beams of the fault's sector."""
    return np.asarray(one.keys.holds(scan.plan.azimuth_rad)[:, None], bool)


def _stuck_beams(one: Held, scan: Scan, draws: RandomStreams) -> Scan:
    inside = _inside(one, scan)
    first = np.arange(scan.range_m.shape[1]) == 0
    range_m = np.where(inside, np.where(first, one.keys.range_m, np.nan), scan.range_m)
    known = np.where(np.isnan(scan.intensity), 1.0, scan.intensity)
    intensity = np.where(inside, np.where(first, known, np.nan), scan.intensity)
    flags = np.where(inside[:, 0], 0, scan.flags).astype(np.uint8)
    actor = np.where(inside, np.int32(-1), scan.actor).astype(np.int32)
    return replace(scan, range_m=range_m, intensity=intensity, flags=flags, actor=actor)


def _dead_beams(one: Held, scan: Scan, draws: RandomStreams) -> Scan:
    n = len(scan.plan)
    dead = _inside(one, scan) & (one.uniform(draws, "beams", 0, n) < one.keys.share)
    return replace(
        scan,
        range_m=np.where(dead, np.nan, scan.range_m),
        intensity=np.where(dead, np.nan, scan.intensity),
        flags=np.where(dead[:, 0], 0, scan.flags).astype(np.uint8),
        actor=np.where(dead, np.int32(-1), scan.actor).astype(np.int32),
    )


def _dead_layers(one: Held, scan: Scan, draws: RandomStreams) -> Scan:
    dead = one.keys.holds(scan.plan.elevation_rad)[:, None]
    return replace(
        scan,
        range_m=np.where(dead, np.nan, scan.range_m),
        intensity=np.where(dead, np.nan, scan.intensity),
        flags=np.where(dead[:, 0], 0, scan.flags).astype(np.uint8),
        actor=np.where(dead, np.int32(-1), scan.actor).astype(np.int32),
    )


def _wrong_calibration(one: Held, scan: Scan, draws: RandomStreams) -> Scan:
    _, which = np.unique(np.round(scan.plan.elevation_rad, 6), return_inverse=True)
    which = which.reshape(-1)
    errors = draws.normal(one.term("layers"), 0, int(which.max(initial=0)) + 1, 1)[:, 0] * one.keys.sigma_m
    return replace(scan, range_m=np.maximum(scan.range_m + errors[which][:, None], 0.0))


def _range_offset(one: Held, scan: Scan, draws: RandomStreams) -> Scan:
    shifted = np.maximum(scan.range_m + one.keys.offset_m, 0.0)
    return replace(scan, range_m=np.where(_inside(one, scan), shifted, scan.range_m))


def _range_scale(one: Held, scan: Scan, draws: RandomStreams) -> Scan:
    return replace(scan, range_m=np.where(_inside(one, scan), scan.range_m * one.keys.factor, scan.range_m))


def _noise_burst(one: Held, scan: Scan, draws: RandomStreams) -> Scan:
    n, k = scan.range_m.shape
    sweep = scan.plan.sweep
    hit = _inside(one, scan) & (one.uniform(draws, "beams", sweep, n) < one.keys.share)
    noise = draws.normal(one.term("ranges"), sweep, n, k) * one.keys.sigma_m
    return replace(scan, range_m=np.where(hit, np.maximum(scan.range_m + noise, 0.0), scan.range_m))


def _stuck_bits(one: Held, scan: Scan, draws: RandomStreams) -> Scan:
    step = one.keys.step_m
    known = np.nan_to_num(scan.range_m, nan=0.0, posinf=0.0)
    word = np.minimum(np.rint(known / step), 2.0**40).astype(np.int64)
    bit = np.int64(1 << one.keys.bit)
    word = word | bit if one.keys.level else word & ~bit
    return replace(scan, range_m=np.where(_inside(one, scan) & ~np.isnan(scan.range_m), word * step, scan.range_m))


def _quantised(one: Held, scan: Scan, draws: RandomStreams) -> Scan:
    coarse = np.rint(scan.range_m / one.keys.step_m) * one.keys.step_m
    return replace(scan, range_m=np.where(_inside(one, scan), coarse, scan.range_m))


def _range_drift(one: Held, scan: Scan, draws: RandomStreams) -> Scan:
    keys = one.keys
    warm_k = keys.warms_k * -math.expm1(-one.since_s / keys.time_constant_s)
    return replace(scan, range_m=np.maximum(scan.range_m + keys.m_per_k * warm_k, 0.0))


def _wrong_intensity(one: Held, scan: Scan, draws: RandomStreams) -> Scan:
    wrong = np.maximum(scan.intensity * one.keys.factor, 1.0)  # an echo is above the threshold
    return replace(scan, intensity=np.where(_inside(one, scan), wrong, scan.intensity))


READINGS: Mapping[str, Reading] = {
    "stuck_beams": _stuck_beams,
    "dead_beams": _dead_beams,
    "dead_layers": _dead_layers,
    "wrong_calibration": _wrong_calibration,
    "range_offset": _range_offset,
    "range_scale": _range_scale,
    "noise_burst": _noise_burst,
    "stuck_bits": _stuck_bits,
    "quantised": _quantised,
    "range_drift": _range_drift,
    "wrong_intensity": _wrong_intensity,
}
"Name -> what becomes of a scan."


def frozen(plan: ScanPlan, faults: tuple[Held, ...]) -> ScanPlan | None:
    """The sweep that is reported instead of this one: at the instant when the picture froze; None: this one."""
    one = next((one for one in faults if one.name == "frozen_scan"), None)
    if one is None:
        return None
    start_ns = max(0, one.from_ns - round(1e9 * plan.duration_s))
    return replace(plan, start_ns=start_ns, sweep=FROZEN_SWEEP - one.number)
