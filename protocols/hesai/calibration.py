"""Calibration files as the device serves them: CSV of spinning models, the binary one of an AT128; and its mirror.

Belongs here: files, and what an angle of the AT128's encoder means. Not: the angles themselves (tables, models).
"""

from __future__ import annotations

import hashlib

import numpy as np

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
ADJUSTED = 128 * 180


def served(model: Model) -> bytes:
    """The file that command 05 has."""
    return at128(model) if model.calibrated == "at128" else csv(model)


def csv(model: Model) -> bytes:
    """Channel, elevation, azimuth offset clockwise. [deg]"""
    rows = [
        f"{at},{elevation:g},{offset:g}"
        for at, (elevation, offset) in enumerate(zip(model.elevation_deg, model.offset_deg, strict=True), 1)
    ]
    return "\r\n".join(("Channel,Elevation,Azimuth", *rows)).encode() + b"\r\n"


def at128(model: Model) -> bytes:
    """Version 1.5; adjustments are zero, as the mirrors here are flat."""

    def words(values: tuple[float, ...], kind: str) -> bytes:
        return np.rint(np.array(values) * SCALE).astype(kind).tobytes()

    data = bytes((0xEE, 0xFF, 1, 5, model.lasers, 3, 3, 1, 2, 4, 0, 0, 0, 0, 0, RESOLUTION))
    data += words(STARTS_DEG, "<u4") + words((*STARTS_DEG[1:], STARTS_DEG[0]), "<u4")
    data += words(model.offset_deg, "<i4") + words(model.elevation_deg, "<i4") + bytes(2 * ADJUSTED)
    return data + hashlib.sha256(data).digest()


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
        azimuth = np.radians(AHEAD_DEG - (model.encoder * since - offset))
    else:
        azimuth = -np.radians(offset) - 2.0 * np.pi * turns
    return azimuth, np.broadcast_to(np.radians(np.asarray(model.elevation_deg)), azimuth.shape)
