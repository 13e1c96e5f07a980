"""Packets of Ouster byte by byte. Lengths and digests of worked packets: decoded by ouster-sdk to these values."""

from __future__ import annotations

from hashlib import sha256

import numpy as np
import pytest

from protocols import checksums
from protocols.ouster import codec
from protocols.ouster.codec import PROFILES, Columns, Head
from protocols.scan import Scan, ScanPlan
from protocols.skeleton.reflectivity import calibrated
from protocols.skeleton.returns import FEW, returns

SERIAL, INIT_ID = 122322000614, 0x05F3BC
WORKED = [
    ("LEGACY", 6464, "4d824a8462a4bccf682be19b5c90509b5f284ad589187c465b0c122aaa803b1a"),
    ("RNG19_RFL8_SIG16_NIR16", 6400, "e10f0aa099a7d2380a3d77e69426eb509a4e05e6be33cf752a404fa67c4b0a45"),
    ("RNG19_RFL8_SIG16_NIR16_DUAL", 8448, "c007c57130ddd1ed82d11c8822b6357c26d98fe3bbe46952deba019c94066853"),
    ("RNG15_RFL8_NIR8", 2304, "1e174a18ccca8e1b3cb4c8a97e8565245c98c9186de7d2449bb69b39c4bf65a0"),
    ("RNG15_RFL8_NIR8_DUAL", 4352, "9f0c855563c3d9e049ef77cd3bc23c5522366ada968cc45d6c243b71f60fb2aa"),
    ("FUSA_RNG15_RFL8_NIR8_DUAL", 4352, "8e88bca591b044223a6f07209fc0fcb44fb012b9467e077d4ca1a8467430781d"),
]


def worked() -> Columns:
    m, r = np.arange(16)[:, None], np.arange(32)
    first = 1000 + 16 * r + 8 * m
    shape = (2, 16, 32)
    return Columns(
        np.arange(16),
        1_000_000_000 + 97_656 * np.arange(16),
        np.full(16, True),
        np.stack((first, first + 2000)),
        np.stack((r + m, r + m + 100)),
        np.stack(np.broadcast_arrays(100 + r + 0 * m, 50 + r + 0 * m)).reshape(shape),
        np.broadcast_to(160 + 16 * m, (16, 32)),
    )


@pytest.mark.parametrize(("name", "size", "digest"), WORKED)
def test_the_worked_packets(name: str, size: int, digest: str) -> None:
    profile = PROFILES[name]
    head = Head(SERIAL, INIT_ID, (3, 1), profile.fusa)
    (data,) = codec.encode(codec.Room(profile, 32, 1, 1024), head, 7, worked())
    assert (len(data), profile.size(32)) == (size, size)
    assert sha256(data).hexdigest() == digest


def test_the_worked_imu_packets() -> None:
    values = (0.01, -0.02, 1.0, 0.1, -0.2, 0.3)
    data = codec.IMU_LEGACY.pack(10**9, 10**9 + 214_400, 10**9 + 436_800, *values)
    assert sha256(data).hexdigest() == "9da39d67456b9ee0ac44e743ab1954b53e23d70aa0366765908276e37035abb7"
    records = np.zeros(8, codec.IMU_RECORD)
    k = np.arange(8)
    records["stamp"], records["number"], records["status"] = 10**9 + 1_562_500 * k, 16 * (k + 1) - 1, 1
    records["force"], records["rate"] = (0.5, -0.25, 9.75), (0.125, -0.0625, 0.03125)
    sentence = b"$GPRMC,123519,A,4807.038,N,01131.000,E,022.4,084.4,230394,003.1,W*6A"
    data = codec.encode_imu(Head(SERIAL, INIT_ID), 7, 999_000_000, sentence, records)
    assert (len(data), sha256(data).hexdigest()) == (
        452, "646319cc8d101057e92d192409d8ea819329b083b209696a69da32be92dd9f45",
    )  # fmt: skip


@pytest.mark.parametrize("name", PROFILES)
def test_what_is_encoded_is_decoded(name: str) -> None:
    profile, columns = PROFILES[name], worked()
    columns.valid[3] = False
    (data,) = codec.encode(codec.Room(profile, 32, 1, 1024), Head(SERIAL, INIT_ID, (3, 1), profile.fusa), 7, columns)
    said = codec.decode(profile, 32, data)
    assert said.frame.tolist() == [7]
    np.testing.assert_array_equal(said.columns.number, columns.number)
    np.testing.assert_array_equal(said.columns.valid, columns.valid)
    for e in range(profile.returns):
        truth = np.where(columns.valid[:, None], columns.range_mm[e], 0)
        np.testing.assert_array_equal(said.columns.range_mm[e], np.rint(truth / profile.unit_mm) * profile.unit_mm)
        assert not said.columns.range_mm[e, 3].any()
        assert not said.columns.reflectivity[e, 3].any()
    assert not said.columns.near_ir[3].any()
    if not profile.legacy:
        assert (said.serial, said.init_id) == (SERIAL, INIT_ID)


@pytest.mark.parametrize(
    ("firmware", "end"),
    [((2, 2), bytes(8)), ((2, 3), codec.PLACEHOLDER), ((3, 0), codec.PLACEHOLDER)],
)
def test_older_firmware_has_no_checksum(firmware: tuple[int, int], end: bytes) -> None:
    profile = PROFILES["RNG15_RFL8_NIR8"]
    (data,) = codec.encode(codec.Room(profile, 32, 1, 1024), Head(SERIAL, INIT_ID, firmware), 7, worked())
    assert data[-8:] == end
    assert data[-32:-8] == bytes(24)


def test_headers_of_warnings() -> None:
    head = Head(SERIAL, INIT_ID, (3, 1), alert_flags=0x90, shutdown_s=30, limiting_s=12, shutdown=1, limiting=5)
    assert head.header(1, 65_536 + 3)[:4] == bytes((1, 0, 3, 0))
    assert head.header(1, 3)[12:20] == bytes((0x90, 0, 0, 0, 30, 12, 1, 5))
    assert Head(SERIAL, INIT_ID, (2, 4), alert_flags=0x90, limiting=5).header(1, 3)[12:] == bytes(20)
    safe = Head(SERIAL, INIT_ID, (3, 2), fusa=True, alert_flags=0x8C, limiting=5).header(1, 65_536 + 3)
    assert safe[:9] == bytes((1, 0xBC, 0xF3, 0x05, 3, 0, 1, 0, 0x8C))
    assert (safe[11:16], safe[19]) == (SERIAL.to_bytes(5, "little"), 5)


def test_the_checksum_without_the_library(monkeypatch: pytest.MonkeyPatch) -> None:
    assert checksums.crc64_xz(b"123456789") == 0x995DC9BBDF1939FA
    monkeypatch.setattr(checksums, "calculate_crc64", None)
    assert checksums.crc64_xz(b"123456789") == 0x995DC9BBDF1939FA


def scan_of(range_m: list[float], intensity: list[float]) -> Scan:
    angles = np.zeros(1)
    scan = Scan.empty(ScanPlan(0, 0, 0, angles, angles, angles), len(range_m))
    scan.range_m[0], scan.intensity[0] = range_m, intensity
    return scan


NAN = float("nan")


@pytest.mark.parametrize(
    ("order", "count", "said"),
    [
        ("STRONGEST_TO_WEAKEST", 1, [20.0]),
        ("NEAREST_TO_FARTHEST", 1, [5.0]),
        ("FARTHEST_TO_NEAREST", 1, [30.0]),
        ("STRONGEST_TO_WEAKEST", 2, [20.0, 30.0]),
        ("NEAREST_TO_FARTHEST", 2, [20.0, 30.0]),
        ("FARTHEST_TO_NEAREST", 2, [30.0, 20.0]),
    ],
)
def test_which_returns_are_reported_in_which_order(order: str, count: int, said: list[float]) -> None:
    scan = scan_of([5.0, 20.0, 30.0, NAN], [2.0, 9.0, 5.0, NAN])
    found = returns(scan, count, order, 0.0)
    assert (found.range_m.tolist(), found.beam.tolist()) == (said, [0] * (count - 1))
    assert found.strength.tolist() == [{5.0: 2.0, 20.0: 9.0, 30.0: 5.0}[one] for one in said]
    near = returns(scan, 2, order, 25.0)
    assert (near.range_m.tolist(), near.beam.tolist()) == ([30.0], [])


def test_a_beam_without_a_return_has_none() -> None:
    scan = scan_of([5.0, NAN], [2.0, NAN])
    for near_m, said in ((0.5, (5.0, 2.0)), (5.0, (5.0, 2.0)), (6.0, (NAN, NAN))):
        found = returns(scan, 1, "STRONGEST_TO_WEAKEST", near_m)
        np.testing.assert_array_equal((found.range_m[0], found.strength[0]), said)
    assert scan.range_m[0, 0] == 5.0


@pytest.mark.parametrize("echoes", [1, 2, 3, 4, 5])
def test_returns_of_many_beams_are_those_of_each_alone(echoes: int) -> None:
    rng = np.random.default_rng(5)
    near_m = 2.0
    ranges = np.where(rng.random((300, echoes)) < 0.4, np.nan, np.sort(rng.uniform(0.5, 90.0, (300, echoes)), axis=1))
    strengths = np.where(np.isnan(ranges), np.nan, rng.uniform(1.0, 50.0, ranges.shape))
    scan = Scan.empty(ScanPlan(0, 0, 0, *(np.zeros(300),) * 3), echoes)
    scan.range_m[:], scan.intensity[:] = ranges, strengths
    for order in ("STRONGEST_TO_WEAKEST", "NEAREST_TO_FARTHEST", "FARTHEST_TO_NEAREST"):
        for count in (1, 2):
            found = returns(scan, count, order, near_m)
            places = [*range(300), *(300 + found.beam)]
            every = zip(places, found.range_m, found.strength, strict=True)
            said = {int(one): (r, s) for one, r, s in every if not np.isnan(s)}
            for beam in range(300):
                own = [(s, r) for s, r in zip(strengths[beam], ranges[beam], strict=True) if r >= near_m]
                own.sort(key=lambda one: -one[0])
                if order != "STRONGEST_TO_WEAKEST":
                    own = sorted(own[:count] if count > 1 else own, key=lambda one: one[1], reverse=order[0] == "F")
                assert [said.get(e * 300 + beam) for e in range(count)] == [
                    (own[e][1], own[e][0]) if e < len(own) else None for e in range(count)
                ]


@pytest.mark.parametrize("order", ["STRONGEST_TO_WEAKEST", "NEAREST_TO_FARTHEST", "FARTHEST_TO_NEAREST"])
def test_a_handful_of_beams_is_taken_as_many_are(order: str, monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(6)
    for beams in range(1, FEW + 1):
        scan = Scan.empty(ScanPlan(0, 0, 0, *(np.zeros(beams),) * 3), 4)
        scan.range_m[:] = np.where(rng.random((beams, 4)) < 0.3, np.nan, np.sort(rng.uniform(0.5, 90.0, (beams, 4))))
        scan.intensity[:] = np.where(np.isnan(scan.range_m), np.nan, np.rint(rng.uniform(1.0, 4.0, (beams, 4))))
        for count in (1, 2):
            few = returns(scan, count, order, 10.0)
            with monkeypatch.context() as patch:
                patch.setattr("protocols.skeleton.returns.FEW", 0)
                many = returns(scan, count, order, 10.0)
            for one, other in zip(
                (few.range_m, few.strength, few.beam), (many.range_m, many.strength, many.beam), strict=True
            ):
                np.testing.assert_array_equal(one, other)


def test_what_a_range_is_on_the_wire() -> None:
    wide, low = PROFILES["RNG19_RFL8_SIG16_NIR16"], PROFILES["RNG15_RFL8_NIR8"]
    ranges = np.array([9.9728, 524.25, 524.3, 262.13])
    assert codec.distances(ranges, 0.0276, wide).tolist() == [10_000, 524_278, 0, 262_158]
    assert codec.distances(ranges, 0.0, low).tolist()[1:] == [0, 0, 262_128]
    plate = calibrated(np.full(3, 10.0), np.array([180.6, 36.1, 361e3]), 36_125.0, codec.WHITE)
    assert plate.tolist() == [50, 10, 255]
