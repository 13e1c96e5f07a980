"""A second opinion on drops before fog: every drop alone, the fog as a sum over range, plain formulas, numpy alone.

Nothing of the product is imported. Beam by beam the pulses of all drops, of one surface and of the fog up to it are
summed on a fine grid; maxima that a valley of one noise unit separates, or that reach the threshold one by one, are
echoes; the noise shifts the level of each, the i-th highest by the i-th number of its beam; an echo is where its rise
crosses its level, brought back by what a single echo of its height is early.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from tests.sensing.one_particle_at_a_time import Rig, drops

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Receiver:
    """What the rig does not say."""

    backscatter: float
    "Of the medium without the drops. [1/(m sr)]"
    shot: float
    "Square of the shot noise of a signal of one noise unit."
    walk: bool
    "Ranges are corrected for the height of an echo; else all pulses count from their begin."


def echoes(
    rig: Rig, receiver: Receiver, surface_m: Floats, surface: Floats, to_m: float, seed: int
) -> tuple[NDArray[np.int64], Floats, Floats]:
    """Beam, range and amplitude of all echoes.

    `surface_m`, `surface` : (n,) range (inf: none) and amplitude of what ends each beam; `to_m`: end of the drops.
    """
    rng = np.random.default_rng(seed)
    beams, half = len(surface_m), 0.5 * rig.pulse_m
    beam, r, light = drops(rig, beams, to_m, rng)
    shown = (light > 1e-5 * rig.thr) & (r < surface_m[beam])
    beam, r, light = beam[shown], r[shown], light[shown]
    x = np.arange(rig.r1 - half, to_m + half, rig.pulse_m / 256.0)
    cells = 0.5 * half / 100.0
    edge = np.arange(rig.r1, to_m + 2.0 * half, cells)
    middle = edge + 0.5 * cells
    seen = np.clip((middle - rig.r1) / (rig.r2 - rig.r1), 0.0, 1.0) * np.exp(-2.0 * rig.alpha * middle) / middle**2
    fog = np.pi * rig.k * receiver.backscatter * seen * cells

    def pulse(off: Floats) -> Floats:
        return np.where(np.abs(off) < half, np.cos(np.pi * off / rig.pulse_m) ** 2, 0.0)

    def fog_before(until_m: float) -> Floats:
        lit = fog * (middle <= until_m)
        return np.array([float(lit @ pulse(place - middle)) for place in x])

    fogs = {float(until): fog_before(float(until)) for until in np.unique(surface_m)}
    found: list[tuple[int, float, float]] = []
    for one in range(beams):
        wave = fogs[float(surface_m[one])].copy()
        if np.isfinite(surface_m[one]):
            wave += surface[one] * pulse(x - surface_m[one])
        for place, height in zip(r[beam == one], light[beam == one], strict=True):
            low, high = np.searchsorted(x, (place - half, place + half))
            wave[low:high] += height * pulse(x[low:high] - place)
        found += [(one, *echo) for echo in _found(rig, receiver, x, wave, rng.normal(size=64))]
    if not found:
        return np.zeros(0, np.int64), np.zeros(0), np.zeros(0)
    of, range_m, amplitude = (np.array(column) for column in zip(*found, strict=True))
    return of, range_m, amplitude


def _found(rig: Rig, receiver: Receiver, x: Floats, wave: Floats, normal: Floats) -> list[tuple[float, float]]:
    tops = [int(k) for k in np.flatnonzero((wave[1:-1] > wave[:-2]) & (wave[1:-1] >= wave[2:])) + 1]
    tops = [k for k in tops if wave[k] >= max(rig.thr - 6.0, 0.02 * rig.thr)]
    while True:
        lost = None
        for a, b in pairwise(tops):
            valley, lower = wave[a:b].min(), min(wave[a], wave[b])
            if not (lower - valley >= 1.0 or (lower >= rig.thr > valley)):
                lost = b if wave[b] <= wave[a] else a
                break
        if lost is None:
            break
        tops.remove(lost)
    by_height = sorted(tops, key=lambda k: -wave[k])
    found = []
    for number, top in enumerate(tops):
        z, height = float(normal[by_height.index(top)]), float(wave[top])
        noise = np.sqrt(1.0 + receiver.shot * height)
        if height < rig.thr - z * noise or height < rig.level(x[top : top + 1])[0] * (rig.floor > 0.0):
            continue
        level = rig.thr - z * np.sqrt(1.0 + receiver.shot * min(height, rig.thr))
        level = min(max(level, 0.02 * rig.thr), height)
        begin = 0 if number == 0 else tops[number - 1] + int(wave[tops[number - 1] : top].argmin())
        over = begin + int((wave[begin : top + 1] >= level).argmax())
        crossing = x[over]
        if over > begin:
            crossing -= (x[1] - x[0]) * (wave[over] - level) / (wave[over] - wave[over - 1])
        elif over == begin and number:  # from a valley over its level: where a single echo would cross it
            above = min(max(float(wave[begin]) - level, 0.0), 1.0)
            crossing = x[begin] + above * (x[top] - _lead(rig, height / level) - x[begin])
        early = _lead(rig, height / rig.thr) if receiver.walk else 0.5 * rig.pulse_m
        range_m = max(crossing + early, 0.0)
        if range_m >= rig.near:
            found.append((range_m, max(height + z * noise, rig.thr)))
    return found


def _lead(rig: Rig, ratio: float) -> float:
    """How far before its middle a pulse crosses a level that it exceeds so many times."""
    return float(rig.pulse_m / np.pi * np.arccos(np.sqrt(1.0 / max(ratio, 1.0))))
