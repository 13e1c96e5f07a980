"""Slices of random scans, packed as arrays, against packets that are written here beam by beam, in whole numbers."""

from __future__ import annotations

import math
import struct
from typing import Any

import numpy as np
import pytest

from protocols.checksums import crc64_xz
from protocols.ouster import FAMILY, codec, slices
from protocols.ouster.codec import COLUMNS, PROFILES, Head, Profile
from protocols.scan import Scan, ScanPlan
from tests.protocols.ouster.rig import QUICK

ROWS, PACKETS, TURN, SERIAL, STAMP_NS = 32, 2, 1024, 122_322_000_614, 10**18
ORDERS = "STRONGEST_TO_WEAKEST", "NEAREST_TO_FARTHEST", "FARTHEST_TO_NEAREST"
NAN = float("nan")


def chosen(echoes: list[tuple[float, float]], count: int, order: str) -> list[tuple[float, float]]:
    """Ranges and intensities of a beam's returns."""
    found = sorted(echoes, key=lambda one: -one[1])
    if order == ORDERS[0]:
        return found[:count]
    return sorted(found[:count] if count > 1 else found, key=lambda one: one[0], reverse=order == ORDERS[2])[:count]


def pixel(returns: list[tuple[float, float]], light_w: float, profile: Profile, unit: Any, gain: float) -> bytes:
    """Of a beam."""
    fields = {"window": slices.CLEAR if profile.unit_mm == 1 else 0}
    share = slices.AMBIENT_PHOTONS / slices.PHOTON_J / (TURN * 10)
    near_ir = round(min(light_w * share, 65_535))
    fields["near_ir"] = near_ir if profile.near_ir_unit == 1 else min(near_ir // 16, 255)
    for number in range(profile.returns):
        fields[f"signal{number}"] = 0 if profile.legacy else slices.NOISE_PHOTONS
    for number, (range_m, intensity) in enumerate(returns):
        word = round((range_m + unit.origin_m) * (1000.0 / profile.unit_mm))
        fields[f"range{number}"] = word if word * profile.unit_mm <= profile.longest_mm else 0
        bright = 100.0 / unit.model.white_m2 * (intensity / gain) * range_m * range_m
        if bright > 100.0:
            bright = min(max(100.0 + 155.0 * math.log(bright / 100.0) / math.log(1000.0), 101.0), 255.0)
        fields[f"reflectivity{number}"] = round(bright)
        fields[f"signal{number}"] = max(round(min(intensity * slices.PHOTONS, 65_535)), fields[f"signal{number}"])
    bits = sum(value << profile.fields[name][0] for name, value in fields.items() if name in profile.fields)
    return bits.to_bytes(profile.size_bits // 8, "little")


def random_scan(rng: np.random.Generator, beams: int, echoes: int, several: float, gain: float) -> Scan:
    """Some beams without an echo, of the others a share with several; near, far, dark, bright, and over the top."""
    angles = np.zeros(beams)
    scan = Scan.empty(ScanPlan(0, 0, 0, angles, angles, angles, gain=gain), max(echoes, 1))
    range_m = np.sort(np.exp(rng.uniform(math.log(0.2), math.log(600.0), (beams, echoes))), axis=1)
    there = rng.random((beams, echoes)) < 0.7
    there[:, 1:] &= rng.random((beams, 1)) < several
    scan.range_m[:, :echoes] = np.where(there, range_m, NAN)
    scan.intensity[:, :echoes] = np.where(there, np.exp(rng.uniform(0.0, 12.0, (beams, echoes))), NAN)
    light_w = np.exp(rng.uniform(-30.0, -14.0, beams))
    return Scan(scan.plan, scan.range_m, scan.intensity, scan.flags, scan.actor, ambient_w=light_w)


@pytest.mark.parametrize("name", PROFILES)
@pytest.mark.parametrize("echoes", range(6))
def test_packets_are_those_of_each_beam_alone(name: str, echoes: int) -> None:
    profile, rng = PROFILES[name], np.random.default_rng(echoes)
    session = FAMILY.new_session(QUICK, {"model": "ouster-os1-32"})
    unit, room = session.unit, codec.Room(profile, ROWS, PACKETS, TURN)
    number, head = np.arange(COLUMNS * PACKETS) + 64, Head(SERIAL, 5, (3, 2), profile.fusa)
    cases = [(order, 1.0, several, [0, 360_000], 0.0) for order in ORDERS for several in (0.0, 0.05)]
    cases += [(ORDERS[0], 2.0, 1.0, [330_000, 335_000], 0.0), (ORDERS[1], 0.7, 0.3, [0, 360_000], 0.4)]
    for order, gain, several, window, share in [*cases, cases[0]]:
        used = session.active | {
            "udp_profile_lidar": name, "lidar_mode": "1024x10", "return_order": order, "azimuth_window": window,
        }  # fmt: skip
        piece = slices.slice_of(unit, used, 3, number, 1e-4, gain)
        beams = ROWS * int(piece.valid.sum())
        assert len(piece.sweep.azimuth_rad) == beams
        seen = piece.valid & ~slices.lost(piece, share, SERIAL)
        scan = random_scan(rng, beams, echoes, several, gain)
        said = slices.columns_of(scan, piece, seen, STAMP_NS + 1000 * number, unit, profile, used, True)
        made = codec.encode(room, head, 3, said)
        assert scan.ambient_w is not None
        rest = iter(zip(scan.range_m.tolist(), scan.intensity.tolist(), scan.ambient_w.tolist(), strict=True))
        expected, near_m = b"", 0.01 * used.get("min_range_threshold_cm", 50)
        for column, (valid, good) in enumerate(zip(piece.valid.tolist(), seen.tolist(), strict=True)):
            at, pixels = int(number[column]), b""
            for _ in range(ROWS):
                ranges_m, strengths, light_w = next(rest) if valid else ([], [], 0.0)
                every = [one for one in zip(ranges_m, strengths, strict=True) if one[0] >= near_m]
                found = chosen(every, profile.returns, order)
                pixels += pixel(found, light_w, profile, unit, gain) if good else bytes(profile.size_bits // 8)
            if column % COLUMNS == 0:
                expected += b"" if profile.legacy else head.header(1, 3)
            if profile.legacy:
                begin = struct.pack("<QHHI", STAMP_NS + 1000 * at, at, 3, at * 90_112 // TURN)
                expected += begin + pixels + struct.pack("<I", 0xFFFFFFFF if good else 0)
            else:
                expected += struct.pack("<QHH", STAMP_NS + 1000 * at, at, good) + pixels
            if column % COLUMNS == COLUMNS - 1 and not profile.legacy:
                before = expected[-(profile.size(ROWS) - 32) :] + bytes(24)
                expected += bytes(24) + (bytes(8) if profile.fusa else crc64_xz(before).to_bytes(8, "little"))
        assert b"".join(made) == expected
