"""Slices of a Hesai's turn: which lasers fire when and whereto, and the words that packets have of what they measured.

A slice is a few packets. Belongs here: a steady or ramping rotor, triggers, ranges of azimuth, optical centres. Not:
when a slice is sent, faults (device), bytes (codec).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from protocols.hesai import calibration, codec
from protocols.hesai.models import Model
from protocols.hesai.motor import NEAR, Rotor
from protocols.hesai.settings import Settings
from protocols.scan import Floats, Scan
from protocols.skeleton.instants import Raster
from protocols.skeleton.packets import MOST_ECHOES, MOST_KEPT
from protocols.skeleton.sweeps import Sweep

NEXT_STEP = 0.8
"Of a step: so far the grid may be from where it would be nearest."


@dataclass(frozen=True, eq=False)
class Slice:
    """What a slice measures; P packets of F firings of L lasers."""

    block_ns: NDArray[np.int64]
    "(P, F) instant of each firing's block."
    angle: codec.Words
    "(P, F) of the rotor or the encoder then, 1/256 of 0.01 deg."
    sees: NDArray[np.bool_]
    "(P, F) whether it is in the range."
    fires: NDArray[np.bool_]
    "(P F, L)"
    states: codec.Words
    "(P, F)"
    sweep: Sweep


class Slices:
    """Makes those of one device at its present settings."""

    def __init__(self, model: Model) -> None:
        self._model = model
        self._grid: dict[int, int] = {}
        "Step of the first firing of slices, where the angle triggers."

    def clear(self) -> None:
        """The settings are others."""
        self._grid.clear()

    def make(self, number: int, raster: Raster, packets: int, used: Settings, rotor: Rotor) -> Slice:
        """The slice of that number, of so many packets."""
        model, start_ns, period_ns = self._model, raster.at(number), float(self._model.firing_ns(used.high))
        count, lead_ns = packets * model.firings(used.mode), model.lead_ns + int(period_ns / 2) + 1
        block_ns = start_ns + lead_ns + np.rint(np.arange(count) * period_ns).astype(np.int64)
        block_ns, turns = self._triggered(number, block_ns, period_ns, used, rotor)
        angle = np.rint(codec.FINE * codec.TURN_CDEG * turns).astype(np.int64) % (codec.FINE * codec.TURN_CDEG)
        states = model.states(number * count + np.arange(count), used.high)
        laser_ns = model.instants(used.high)[states]
        sees = _seen(model, used, angle)
        fires = sees[:, None] & ~np.isnan(laser_ns)
        fired, laser_ns = fires[sees], laser_ns[sees]
        fire_ns = block_ns[sees, None] + np.rint(np.nan_to_num(laser_ns)).astype(np.int64)
        at_turns = rotor.turns(fire_ns) if fire_ns.size else np.zeros(fire_ns.shape)
        azimuth, elevation = calibration.directions(model, at_turns, turns[sees, None])
        sweep = Sweep(
            azimuth[fired],
            elevation[fired],
            np.asarray(1e-9 * (fire_ns[fired] - start_ns), np.float64),
            1e-9 * (int(raster.period_ns) + 2 * lead_ns),
            max_range_m=0xFFFF * model.unit_mm / 1000.0,
            max_echoes=MOST_ECHOES,
            wants_intensity=True,
            turn=rotor.turn(start_ns),
            origin_m=calibration.origins(model, at_turns[fired]),
        )
        shape = packets, -1
        return Slice(
            block_ns.reshape(shape), angle.reshape(shape), sees.reshape(shape), fires, states.reshape(shape), sweep
        )

    def _triggered(
        self, number: int, block_ns: NDArray[np.int64], period_ns: float, used: Settings, rotor: Rotor
    ) -> tuple[NDArray[np.int64], Floats]:
        """Instants of blocks, and turns of the rotor then: triggered by the angle, on a grid of whole steps."""
        turns, count = rotor.turns(block_ns), len(block_ns)
        first_ns, last_ns = int(block_ns[0]), int(block_ns[-1])
        hz = rotor.speed_hz(first_ns)
        if used.trigger or not hz or not (rotor.is_steady(first_ns) and rotor.is_steady(last_ns)):
            return block_ns, turns
        nominal = math.copysign(used.rpm / 60.0, hz)
        step = (nominal if abs(hz / nominal - 1.0) < NEAR else hz) * 1e-9 * period_ns
        at = float(turns[0]) / step
        # on from the slice before, as long as that is near: no doubt where half a step has passed
        place = self._grid[number - 1] + count if number - 1 in self._grid else round(at)
        place = place if abs(at - place) < NEXT_STEP else round(at)
        while len(self._grid) >= MOST_KEPT:
            self._grid.pop(next(iter(self._grid)))
        self._grid[number] = place
        on_grid = (place + np.arange(count)) * step
        behind = (on_grid - turns + 0.5) % 1.0 - 0.5  # a knot in the slice: turns are counted anew
        return block_ns + np.rint(1e9 * behind / hz).astype(np.int64), np.asarray(on_grid, np.float64)


def _seen(model: Model, used: Settings, angle: codec.Words) -> NDArray[np.bool_]:
    """Firings of the range; of an AT128 those within a mirror's window."""
    degrees = angle / (100.0 * codec.FINE)
    if model.calibrated == "at128":
        since = np.asarray(calibration.after_start(degrees + 1e-9))
        low, high = calibration.WINDOW_DEG
        return np.asarray((since >= low) & (since < high))
    seen = np.full(len(angle), used.sees_all)
    for first, last in used.range_ddeg:
        seen |= (degrees * 10.0 - first) % 3600.0 <= (last - first) % 3600
    return seen


def words(scan: Scan, piece: Slice, model: Model, mode: int) -> tuple[codec.Words, codec.Words]:
    """Distances and reflectivities (P, B, L) of a slice's packets; of lasers that did not fire 0."""
    range_m, intensity = codec.returns(scan, model.picks(mode))
    lead_m, apart_m2 = calibration.leads(model)
    away_m = calibration.from_axis(range_m, np.broadcast_to(lead_m, piece.fires.shape)[piece.fires], apart_m2)

    def placed(values: codec.Words) -> codec.Words:
        whole = np.zeros((len(values), *piece.fires.shape), np.int64)
        whole[:, piece.fires] = values
        return np.moveaxis(whole, 0, 1).reshape(len(piece.block_ns), model.layout.blocks, model.lasers)

    reflectivity = codec.reflectivities(range_m, intensity, model.white_m2)
    return placed(codec.distances(away_m, model.unit_mm)), placed(reflectivity)
