"""Calibration files as the device serves them: CSV of spinning models, the binary one of an AT128; and its mirror.

Belongs here: files, and what an angle of the AT128's encoder means. Not: the angles themselves (tables, models).
"""

from __future__ import annotations

import hashlib
from dataclasses import replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from protocols.hesai.models import Model
from protocols.scan import Floats

RESOLUTION = 2
"Unit of angles: so many times 0.01/256 deg."
SCALE = 25_600.0 / RESOLUTION
STARTS_DEG = (20.0, 140.0, 260.0)
"Where the field of each of the three mirrors begins, of the encoder; each ends where the next begins."
WINDOW_DEG = (13.75, 76.25)
"Of the encoder after that: where it fires."
AHEAD_DEG = 90.0
"Azimuth of the middle of its field."
ADJUST_STEP_DEG = 2.0
"Of the encoder, from value to value of the adjustments; between them drivers interpolate."
ADJUST_DEG = 0.01 * RESOLUTION
"Their unit."


def served(model: Model, wrong_deg: float = 0.0) -> bytes:
    """The file that command 05 has; `wrong_deg` is added to all elevations in it."""
    told = replace(model, elevation_deg=tuple(one + wrong_deg for one in model.elevation_deg))
    return at128(told, *adjustments(model)) if model.calibrated == "at128" else csv(told)


def csv(model: Model) -> bytes:
    """Channel, elevation, azimuth offset clockwise. [deg]"""
    rows = [
        f"{at},{elevation:g},{offset:g}"
        for at, (elevation, offset) in enumerate(zip(model.elevation_deg, model.offset_deg, strict=True), 1)
    ]
    return "\r\n".join(("Channel,Elevation,Azimuth", *rows)).encode() + b"\r\n"


def at128(model: Model, azimuth: NDArray[np.int8], elevation: NDArray[np.int8]) -> bytes:
    """Version 1.5, with adjustments (128, 180)."""

    def words(values: tuple[float, ...], kind: str) -> bytes:
        return np.rint(np.array(values) * SCALE).astype(kind).tobytes()

    data = bytes((0xEE, 0xFF, 1, 5, model.lasers, 3, 3, 1, 2, 4, 0, 0, 0, 0, 0, RESOLUTION))
    data += words(STARTS_DEG, "<u4") + words((*STARTS_DEG[1:], STARTS_DEG[0]), "<u4")
    data += words(model.offset_deg, "<i4") + words(model.elevation_deg, "<i4")
    data += azimuth.tobytes() + elevation.tobytes()
    return data + hashlib.sha256(data).digest()


@lru_cache(maxsize=1)
def adjustments(model: Model) -> tuple[NDArray[np.int8], NDArray[np.int8]]:
    """Of azimuth and elevation by an AT128's mirrors, (128, 180) by channel and encoder, in `ADJUST_DEG`.

    Along the sweep as one published unit has them for its uppermost channel: +0.52 to -0.94 deg, and 0.04 deg in the
    middle to 0.12 at the ends; zero outside of 11 to 79 deg. For other channels, and from mirror to mirror: ours.
    """
    encoder = np.asarray(ADJUST_STEP_DEG * np.arange(180), np.float64)
    since, mirror = after_start(encoder), ((encoder - STARTS_DEG[0]) % 360.0 // 120.0).astype(int)
    along = (since - 45.0) / 34.0
    height = np.asarray(model.elevation_deg)[:, None] / model.elevation_deg[0]
    azimuth = -along * (0.73 + 0.21 * along) * (0.5 + 0.5 * height**2)
    elevation = (0.04 + 0.08 * along**2) * height + np.array((0.0, 0.02, -0.02))[mirror]
    used = (since >= 11.0) & (since <= 79.0)
    return tuple(np.rint(one / ADJUST_DEG * used).astype(np.int8) for one in (azimuth, elevation))  # type: ignore[return-value]


def damaged(data: bytes) -> bytes:
    """The file without its end: a CSV has no channels of the second half, the hash of a binary one is wrong."""
    if data.startswith(b"\xee\xff"):
        return data[:-1] + bytes((data[-1] ^ 1,))
    return data[: data.rfind(b"\n", 0, len(data) // 2) + 1]


def after_start(encoder_deg: Floats) -> Floats:
    """Degrees of an AT128's encoder after the start of the field that it is in."""
    return np.asarray((encoder_deg - STARTS_DEG[0]) % 120.0, np.float64)


def directions(model: Model, turns: Floats, block_turns: Floats) -> tuple[Floats, Floats]:
    """Azimuth and elevation (F, L) of beams, ISO 8855. [rad]

    turns (F, L): where the rotor or the mirror's encoder is when each laser fires, clockwise; block_turns (F, 1): when
    the block begins, which decides the field of an AT128.
    """
    offset = np.asarray(model.offset_deg)
    if model.calibrated == "at128":
        since = after_start(360.0 * block_turns) + 360.0 * (turns - block_turns)
        place = 360.0 / ADJUST_STEP_DEG * (turns % 1.0)
        before = place.astype(np.int64)
        share, channel = place - before, np.arange(model.lasers)
        more, up = (
            ADJUST_DEG * ((1.0 - share) * one[channel, before % 180] + share * one[channel, (before + 1) % 180])
            for one in adjustments(model)
        )
        azimuth = np.radians(AHEAD_DEG - (model.encoder * since - offset + more))
        return azimuth, np.radians(np.asarray(model.elevation_deg) + up)
    azimuth = -np.radians(offset) - 2.0 * np.pi * turns
    return azimuth, np.broadcast_to(np.radians(np.asarray(model.elevation_deg)), azimuth.shape)


def origins(model: Model, turns: Floats) -> Floats | None:
    """(shape of turns, 3) where beams begin, ISO 8855: it turns with the head; None: on the axis. [m]"""
    if not any(model.centre_m):
        return None
    right, ahead = model.centre_m
    head = 2.0 * np.pi * turns
    across, along = np.cos(head), np.sin(head)
    return np.stack((ahead * across - right * along, -ahead * along - right * across, np.zeros(turns.shape)), axis=-1)


def leads(model: Model) -> tuple[Floats, float]:
    """(L,) how far along its beam each laser begins, and the square of how far from the axis. [m, m^2]"""
    right, ahead = model.centre_m
    offset, elevation = np.radians(np.asarray(model.offset_deg)), np.radians(np.asarray(model.elevation_deg))
    return np.cos(elevation) * (ahead * np.cos(offset) + right * np.sin(offset)), right * right + ahead * ahead


def from_axis(range_m: Floats, lead_m: Floats | float, apart_m2: float) -> Floats:
    """Distances of points from the axis, as on the wire, from ranges along their beams; see `leads`."""
    return np.asarray(np.sqrt(range_m * (range_m + 2.0 * lead_m) + apart_m2))


def along_beam(distance_m: Floats, lead_m: Floats | float, apart_m2: float) -> Floats:
    """The inverse of `from_axis`."""
    return np.asarray(np.sqrt(np.maximum(distance_m * distance_m + lead_m * lead_m - apart_m2, 0.0)) - lead_m)
