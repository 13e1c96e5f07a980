"""Slices of a frame: what one measures, and from its scan what its columns say.

Belongs here: directions and instants of a slice, photons, near-infrared, lost columns. Not: rules of a single value
(codec), when slices begin (device).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from protocols.ouster import codec, config
from protocols.ouster.models import Unit
from protocols.scan import Floats, Scan
from protocols.skeleton.packets import MOST_ECHOES
from protocols.skeleton.reflectivity import calibrated, whole
from protocols.skeleton.returns import returns
from protocols.skeleton.sweeps import Sweep

PHOTONS = 15.0
"Of an echo at the detection threshold; no source."
CLEAR = 255
"Of a clean window: so in the recording of firmware 3.2 that has it."
NOISE_PHOTONS = 3
"Where there is no return; recordings have 0 to 8."
AMBIENT_PHOTONS = 3e-3
"Reported of those that ambient light sends to the detector in a column: its share of time, filter and efficiency."
PHOTON_J = 6.62607015e-34 * 299_792_458.0 / 865e-9


@dataclass(frozen=True, eq=False)
class Slice:
    """What a slice measures."""

    frame: int
    number: codec.Words
    "(C,) columns of the frame."
    valid: codec.Bools
    "(C,) inside of the azimuth window."
    sweep: Sweep

    @cached_property
    def whole(self) -> bool:
        """It is inside of the window as a whole."""
        return bool(self.valid.all())


def slice_of(
    unit: Unit,
    used: Mapping[str, Any],
    frame: int,
    number: codec.Words,
    column_s: float,
    gain: float,
) -> Slice:
    """Columns `number` of a frame. `used`: the configuration; [s] from column to column; light over the nominal."""
    valid = config.columns_in(used)[number]
    turn = used.get("lidar_frame_azimuth_offset", 0) / config.TURN_MDEG + 0.5
    encoder = 2.0 * np.pi * (turn + 1.0 - number[valid] / config.MODES[used["lidar_mode"]][0])
    azimuth, elevation, origin = unit.directions(encoder)
    sweep = Sweep(
        azimuth,
        elevation,
        np.repeat(column_s * np.flatnonzero(valid), unit.rows),
        column_s * len(number),
        max_range_m=codec.PROFILES[config.profile_of(used)].longest_mm / 1000.0 - unit.origin_m,
        max_echoes=MOST_ECHOES,
        gain=gain,
        wants_intensity=True,
        turn=frame,
        origin_m=origin,
        wants_ambient=True,
    )
    return Slice(frame, number, valid, sweep)


def lost(piece: Slice, share: float, serial: int) -> codec.Bools:
    """(C,) columns that a fault loses, a share of them: of each frame others."""
    if not share:
        return np.zeros(len(piece.number), bool)
    spread = (piece.number * 2_654_435_761 + piece.frame * 40_503 + serial) % (1 << 32)
    return np.asarray((spread * 2_246_822_519 >> 7) % 10_007 < share * 10_007)


def columns_of(
    scan: Scan,
    piece: Slice,
    seen: codec.Bools,
    stamps: codec.Words,
    unit: Unit,
    profile: codec.Profile,
    used: Mapping[str, Any],
    has_window: bool = False,
) -> codec.Columns:
    """Columns of a slice. `seen` (C,): valid ones, `used`: the configuration; `has_window`: its clearness is said."""
    near_m = 0.01 * used.get("min_range_threshold_cm", 50)
    order = used.get("return_order", "STRONGEST_TO_WEAKEST")
    found = returns(scan, profile.returns, order, near_m)
    light = found.strength if scan.plan.gain == 1.0 else found.strength / scan.plan.gain
    dark = 0 if profile.legacy else NOISE_PHOTONS
    beams, near_ir, others = len(scan.range_m), codec.ZERO, None
    range_mm = codec.in_steps(found.range_m, unit.origin_m, profile)
    bright = calibrated(found.range_m, light, unit.model.white_m2, codec.WHITE)
    first_signal = second_signal = codec.ZERO
    if profile.has_signal:
        signal = _photons(found.strength, PHOTONS, dark)
        first_signal, second_signal = _placed(signal[:beams], piece, unit.rows)[None], signal[beams:]
    if profile.returns == 2:
        pixel = found.beam if piece.whole else np.flatnonzero(np.repeat(piece.valid, unit.rows))[found.beam]
        others = codec.Others(pixel, range_mm[beams:], bright[beams:], second_signal, dark)
    if scan.ambient_w is not None:
        turn, hz = config.MODES[used["lidar_mode"]]
        near_ir = _placed(_photons(scan.ambient_w, AMBIENT_PHOTONS / PHOTON_J / (turn * hz)), piece, unit.rows)
    window = CLEAR if has_window and profile.unit_mm == 1 else 0
    return codec.Columns(
        piece.number, stamps, seen, _placed(range_mm[:beams], piece, unit.rows)[None],
        _placed(bright[:beams], piece, unit.rows)[None], first_signal, near_ir, None, window, others,
        profile.unit_mm,
    )  # fmt: skip


def _photons(light: Floats, share: float, least: int = 0) -> codec.Words:
    """As a word of 16 bits says them; at least so many."""
    counted = light * share
    np.minimum(counted, 0xFFFF, out=counted)
    return whole(counted) if not least else whole(np.fmax(counted, float(least), out=counted))


def _placed(words: codec.Words, piece: Slice, rows: int) -> codec.Words:
    """(C, H) of the columns in the window; the others 0."""
    if words.size == len(piece.valid) * rows:
        return words.reshape(-1, rows)
    grid = np.zeros((len(piece.valid), rows), np.uint32)
    grid[piece.valid] = words.reshape(-1, rows)
    return grid
