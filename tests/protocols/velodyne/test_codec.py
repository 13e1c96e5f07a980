"""Packets of Velodyne byte by byte. Worked packets: from public drivers and captures, read by unmodified drivers."""

from __future__ import annotations

import zlib

import numpy as np
import pytest

from protocols.scan import Scan, ScanPlan
from protocols.skeleton.nmea import gprmc
from protocols.skeleton.reflectivity import calibrated
from protocols.velodyne import codec
from protocols.velodyne.models import MODELS, MODES, Mode, Model


def worked(model: Model, mode: Mode, first_deg: float, block_deg: float, stamp_us: int, nearer_m: float = 0.0) -> bytes:
    """Range = 5 m + 0.01 m per degree at each laser's own azimuth; the second echo is nearer."""
    firings, lasers = model.firings(mode), model.lasers
    rate = block_deg / (model.cycle_ns * max(1, 32 // lasers))
    times = np.arange(firings)[:, None] * model.cycle_ns + np.asarray(model.laser_ns)
    azimuth = first_deg + rate * times
    range_m = 5.0 + 0.01 * (azimuth % 360.0)
    echoes = np.stack((range_m, range_m - nearer_m)) if mode == "dual" else range_m[None]
    pattern = np.broadcast_to(np.arange(lasers), times.shape)
    if lasers == 16:
        pattern = 10 * pattern + np.arange(firings)[:, None] % 2  # the second firing of a block has one more
    said = codec.Firings(
        np.rint(azimuth[None, :, 0] * 100).astype(np.int64),
        np.array([stamp_us]),
        codec.distances(echoes, model.unit_mm)[:, None],
        np.broadcast_to(pattern % 256, echoes.shape)[:, None],
    )
    return codec.encode(model, mode, said).tobytes()


def test_the_worked_packet_of_a_vlp_16() -> None:
    data = worked(MODELS["velodyne-vlp-16"], "strongest", 0.0, 0.398131, 1000)
    assert data[:16] == bytes.fromhex("ff ee 00 00 c4 09 00 c4 09 0a c4 09 14 c4 09 1e")
    assert data[48:64] == bytes.fromhex("8c c5 09 96 c5 09 01 c5 09 0b c5 09 15 c5 09 1f")
    assert data[100:110] == bytes.fromhex("ff ee 28 00 c6 09 00 c6 09 0a")
    assert data[1196:] == bytes.fromhex("8d dc 09 97 e8 03 00 00 37 22")
    assert zlib.crc32(data) == 0x700498B0


def test_the_worked_packet_of_a_vlp_16_in_dual_mode() -> None:
    data = worked(MODELS["velodyne-vlp-16"], "dual", 359.90, 0.398131, 3_599_999_000, nearer_m=1.0)
    assert data[:10] == bytes.fromhex("ff ee 96 8c cc 10 00 cc 10 0a")
    assert data[100:110] == bytes.fromhex("ff ee 96 8c d8 0e 00 d8 0e 0a")
    assert data[1196:] == bytes.fromhex("8d db 07 97 18 a0 93 d6 39 22")
    assert zlib.crc32(data) == 0xFF1EB026


def test_the_worked_packet_of_an_hdl_32e() -> None:
    data = worked(MODELS["velodyne-hdl-32e"], "strongest", 90.0, 0.165888, 553)
    assert data[:16] == bytes.fromhex("ff ee 28 23 86 0b 00 86 0b 01 86 0b 02 86 0b 03")
    assert data[1196:] == bytes.fromhex("1e 90 0b 1f 29 02 00 00 37 21")
    assert zlib.crc32(data) == 0x2FA530BE


def test_the_worked_packet_of_a_vls_128() -> None:
    data = worked(MODELS["velodyne-vls-128"], "strongest", 10.0, 0.19188, 53)
    assert data[:16] == bytes.fromhex("ff ee e8 03 fb 04 00 fb 04 01 fb 04 02 fb 04 03")
    assert data[1200:] == bytes.fromhex("35 00 00 00 37 a1")
    flags = [data[at : at + 2].hex() for at in range(0, 1200, 100)]
    assert flags == ["ffee", "ffdd", "ffcc", "ffbb"] * 3


def test_a_vls_128_in_dual_mode_fills_eight_blocks_and_repeats_the_azimuth_in_the_others() -> None:
    data = worked(MODELS["velodyne-vls-128"], "dual", 10.0, 0.19188, 53, nearer_m=1.0)
    flags = [data[at : at + 2].hex() for at in range(0, 1200, 100)]
    assert flags == ["ffee", "ffee", "ffdd", "ffdd", "ffcc", "ffcc", "ffbb", "ffbb", *["0000"] * 4]
    assert {data[at + 2 : at + 4] for at in range(0, 1200, 100)} == {b"\xe8\x03"}
    assert not any(data[804:900])
    assert not any(data[1104:1200])


def test_the_worked_position_packet() -> None:
    sentence = b"$GPRMC,081802.00,A,3649.7478558,N,00224.4542928,W,0.034,212.5,210116,0.0,E,A*2E\r\n"
    data = codec.encode_position(123_456_789, 2, sentence)
    assert data[198:212] == bytes.fromhex("15 cd 5b 07 02 00 00 00 24 47 50 52 4d 43")
    assert not any(data[:198])
    assert zlib.crc32(data) == 0x2749439F


def test_a_sentence_has_the_time_the_place_and_its_sum() -> None:
    text = gprmc(1_453_364_282_000_000_000, 36.829131, -2.407572)
    assert text == b"$GPRMC,081802.00,A,3649.7479,N,00224.4543,W,0.000,0.0,210116,0.0,E,A*26\r\n"
    assert b"5959.9999" not in gprmc(0, 59.99999999, 0.0)  # carried, no 60.0000 minutes


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("name", MODELS)
def test_packets_are_read_back(name: str, mode: Mode) -> None:
    model = MODELS[name]
    firings = model.firings(mode)
    shape = (1 + (mode == "dual"), 3, firings, model.lasers)
    rng = np.random.default_rng(5)
    azimuth = (35_900 + 20 * np.arange(3 * firings)).reshape(3, firings) % 36_000
    said = codec.Firings(
        azimuth, np.array([5, 700, 3_599_999_999]), rng.integers(0, 65_536, shape), rng.integers(0, 256, shape)
    )
    read = codec.decode(codec.encode(model, mode, said))
    assert read is not None
    assert (read[0].model, read[1]) == (name, mode)
    for field in ("azimuth_cdeg", "stamp_us", "distance", "reflectivity"):
        assert (getattr(read[2], field) == getattr(said, field)).all(), field


def scan_of(range_m: list[list[float]], intensity: list[list[float]]) -> Scan:
    none = np.zeros(len(range_m))
    plan = ScanPlan(0, 0, 0, none, none, none)
    found = Scan.empty(plan, len(range_m[0]))
    found.range_m[:], found.intensity[:] = range_m, intensity
    return found


def test_each_mode_reports_its_returns() -> None:
    nan = np.nan
    scan = scan_of(
        [[2, 5, 9], [2, 5, nan], [2, nan, nan], [nan, nan, nan], [2, 5, 9]],
        [[3, 8, 4], [9, 3, nan], [7, nan, nan], [nan, nan, nan], [1, 2, 6]],
    )
    strongest = codec.returns(scan, "strongest")
    assert np.array_equal(strongest[0], [[5, 2, 2, nan, 9]], equal_nan=True)
    assert np.array_equal(strongest[1], [[8, 9, 7, nan, 6]], equal_nan=True)
    assert np.array_equal(codec.returns(scan, "last")[0], [[9, 5, 2, nan, 9]], equal_nan=True)
    # last, strongest; the second strongest where both are one; the only echo twice
    assert np.array_equal(codec.returns(scan, "dual")[0], [[9, 5, 2, nan, 9], [5, 2, 2, nan, 5]], equal_nan=True)


def test_what_no_word_can_say_is_no_return() -> None:
    assert codec.distances(np.array([np.nan, 0.0009, 0.0011, 131.07, 131.08, 500.0]), 2).tolist() == [
        0,
        0,
        1,
        65535,
        0,
        0,
    ]


def test_reflectivity_does_not_depend_on_the_range_and_retro_reflectors_are_beyond_100() -> None:
    range_m = np.array([2.0, 10.0, 40.0])
    for reflectance in (0.1, 0.5, 1.0):
        found = calibrated(range_m, reflectance * 1000.0 / range_m**2, 1000.0, codec.WHITE)
        assert found.tolist() == [round(100 * reflectance)] * 3
    over = calibrated(np.ones(4), 1000.0 * np.array([1.01, 10.0, 1000.0, 1e9]), 1000.0, codec.WHITE)
    assert over[0] == 101
    assert 101 < over[1] < 255
    assert over[2:].tolist() == [255, 255]
    assert calibrated(np.array([np.nan]), np.array([np.nan]), 1000.0, codec.WHITE).tolist() == [0]
