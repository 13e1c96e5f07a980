"""Bytes of the specification, and each form decoded again by the letter of the maker's SDK."""

from __future__ import annotations

import hashlib
import struct

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from protocols.rplidar import codec
from protocols.rplidar.codec import Samples
from tests.protocols.rplidar.rig import points_of

ANGLE = 100.0 + 0.36 * np.arange(97)
TRUE = 1000.0 + 10.0 * ANGLE


def samples(mm: np.ndarray, angle: np.ndarray = ANGLE) -> Samples:
    """The worked scene of the specification: quality floor(40 + a / 2), stamp 123456789 us."""
    quality = np.floor(40.0 + angle / 2.0).astype(np.int64)
    return Samples(angle, mm, quality, np.zeros(len(mm), np.bool_), np.full(len(mm), 123456789.0))


WHOLE, QUARTERS = samples(np.floor(TRUE)), samples(np.floor(4.0 * TRUE) / 4.0)


@pytest.mark.parametrize(("kind", "given_", "restart", "first", "digest"), [
    (0x81, QUARTERS, False, "5A 01 32 40 1F", "4acdebdd2f98899b0b8ca6b727b2b18e8a1a08b0d43a6f1e21b7180cc4981a7d"),
    (0x82, WHOLE, True, "AD 59 00 99 40 1F 4C 1F 00 5C 1F 68 1F 00",
     "9a2fd1942f7cef930bb4d2e55aefdbfcad3a10070f7468cd3b8a74f013e9727e"),
    (0x85, WHOLE, True, "A9 59 00 99 D0 07 D3 07 D7 07 DA 07",
     "f3e9503e727e2b40ef3152ecfc31032a3da34f8aa392a494beabc778e6294508"),
    (0x86, WHOLE, True, "AC 59 15 CD 5B 07 00 00 00 99 A0 AF A4 AF 55",
     "d289f77459600ae6b3ad66e36489095d44e105a13f8b7d396e11769341d109af"),
    (0x83, QUARTERS, True, "A5 15 CD 5B 07 00 00 00 00 1C 47 40 1F 00 00 5A 02",
     "0e00f8048f16262c5921e7675e70822416bef75afbc32b1c193e532a43e01472"),
])  # fmt: skip
def test_worked_groups_of_the_specification(kind: int, given_: Samples, restart: bool, first: str, digest: str) -> None:
    form = codec.FORMS[kind]
    found = form.encode(given_.part(0, form.samples), restart).tobytes()
    assert len(found) == form.size
    assert found.startswith(bytes.fromhex(first))
    assert hashlib.sha256(found).hexdigest() == digest


WORDS = np.full(32, 0x4E8)
WORDS[5:8] = 0x80200000, 0xFEC05000, 0x192004E8


def test_the_worked_ultra_capsule_of_the_specification() -> None:
    found = codec.ultra_capsules(np.array([100.0]), WORDS, True).tobytes()
    assert found.startswith(bytes.fromhex("AE 56 00 99 E8 04 00 00"))
    assert hashlib.sha256(found).hexdigest() == "d413808b4dceb46f58fdf5949a30ee5cd2721816c177e2912b39cc6fa29d7727"


def test_its_distances_make_its_words() -> None:
    """Sample 14 alone has no base behind it in the worked capsule: it cannot be told, and is written as no return."""
    mm = np.full(97, 2000.0)
    mm[14:18], mm[18:24] = 0.0, [0.0, 2010.0, 1990.0, 2000.0, 0.0, 2200.0]
    found = codec.ultra(samples(mm), True)
    words = np.frombuffer(found.tobytes()[4:], "<u4").astype(np.int64)
    expected = WORDS.copy()
    expected[4] = 0x4E8 | 0x200 << 22
    np.testing.assert_array_equal(words, expected)


@pytest.mark.parametrize(("mm", "code", "read"), [(2047, 1279, 2046), (4095, 1791, 4092), (20000, 3554, 20000),
                                                  (0, 0, 0), (28656, 4095, 28656), (28672, 0, 0)])  # fmt: skip
def test_majors_of_the_specification(mm: int, code: int, read: int) -> None:
    found = codec.major_of(np.array([mm]))
    assert found.tolist() == [code]
    assert codec.distance_of(found)[0].tolist() == [read]


@pytest.mark.parametrize("kind", sorted(codec.FORMS))
def test_descriptors_of_the_specification(kind: int) -> None:
    sizes = {0x81: "05 00 00 40 81", 0x82: "54 00 00 40 82", 0x83: "0D 03 00 40 83", 0x84: "84 00 00 40 84",
             0x85: "54 00 00 40 85", 0x86: "AA 00 00 40 86"}  # fmt: skip
    assert codec.FORMS[kind].descriptor == bytes.fromhex("A5 5A" + sizes[kind])


MOST_ERROR = {0x81: 0.126, 0x82: 0.5, 0x83: 0.126, 0x85: 0.5, 0x86: 5.0}
FARTHEST = {0x81: 16383.0, 0x82: 16383.0, 0x83: 40000.0, 0x85: 65535.0, 0x86: 65000.0}


@pytest.mark.parametrize("kind", sorted(MOST_ERROR))
@given(data=st.data())
def test_each_form_keeps_distances_to_its_step(kind: int, data: st.DataObject) -> None:
    form = codec.FORMS[kind]
    one = st.one_of(st.just(0.0), st.floats(20.0, FARTHEST[kind]))
    mm = np.array(data.draw(st.lists(one, min_size=2 * form.samples, max_size=2 * form.samples)))
    angle = (350.0 + 0.25 * np.arange(len(mm))) % 360.0
    found = points_of(kind, form.encode(samples(mm, angle), True).tobytes())
    for point, true, at in zip(found, mm, angle, strict=False):
        assert (point.mm == 0.0) == (true == 0.0)
        assert abs(point.mm - true) <= MOST_ERROR[kind]
        assert abs((point.angle - at + 180.0) % 360.0 - 180.0) < 0.02


@given(st.lists(st.one_of(st.just(0.0), st.floats(150.0, 28000.0)), min_size=193, max_size=193))
def test_an_ultra_sample_is_right_or_none_and_never_a_phantom(mm: list[float]) -> None:
    form = codec.FORMS[codec.ULTRA]
    true = np.array(mm)
    found = form.encode(samples(true, 0.2 * np.arange(193)), True).tobytes()
    for point, was in zip(points_of(codec.ULTRA, found), true, strict=False):
        assert point.mm == 0.0 or abs(point.mm - was) <= 16.5


def test_smooth_walls_lose_nothing_in_ultra_capsules() -> None:
    true = 3000.0 + 40.0 * np.arange(193)
    found = codec.ultra(samples(true, 0.2 * np.arange(193)), True).tobytes()
    points = points_of(codec.ULTRA, found)
    assert all(point.mm > 0.0 for point in points)


@pytest.mark.parametrize(("code", "payload", "bytes_"), [
    (0x25, b"", "A5 25"),
    (0x82, bytes(5), "A5 82 05 00 00 00 00 00 22"),
    (0x82, b"\x03" + bytes(4), "A5 82 05 03 00 00 00 00 21"),
    (0xF0, struct.pack("<H", 660), "A5 F0 02 94 02 C1"),
    (0xF0, bytes(2), "A5 F0 02 00 00 57"),
    (0xA8, struct.pack("<H", 600), "A5 A8 02 58 02 55"),
    (0xFF, bytes(4), "A5 FF 04 00 00 00 00 5E"),
    (0x84, struct.pack("<I", 0x7C), "A5 84 04 7C 00 00 00 59"),
    (0x84, struct.pack("<IH", 0x71, 3), "A5 84 06 71 00 00 00 03 00 55"),
    (0x90, struct.pack("<HIH", 0x5F5F, 512000, 0), "A5 90 08 5F 5F 00 D0 07 00 00 00 EA"),
])  # fmt: skip
def test_requests_of_the_specification(code: int, payload: bytes, bytes_: str) -> None:
    assert codec.request(code, payload) == bytes.fromhex(bytes_)


def test_the_line_of_sight_is_that_of_the_sdk() -> None:
    found = codec.line_of_sight_deg(np.array([10.0, 1000.0, 1e9]))
    x = 24.01 / 1000.0
    assert found == pytest.approx([7.5, 8.0 - np.degrees(x + x**3 / 6.0), 8.0], abs=1e-5)
