"""Packets and replies of YDLIDAR: the worked ones of the specification exactly, the geometry of the slanted line."""

from __future__ import annotations

import hashlib
import math
import struct

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from emulator.hosts.ydlidar import StreamReader, range_mm
from protocols.skeleton.descriptors import descriptor, reply
from protocols.ydlidar.codec import (
    FAR_DEG,
    MOST_SAMPLES,
    WIDTHS,
    Rows,
    correction_deg,
    encode_packets,
    encode_samples,
    seen_from,
)

NAN = math.nan


def packed(text: str) -> bytes:
    return bytes.fromhex(text)


def rows_of(data: str, width: int) -> Rows:
    """Samples given as bytes; the words of the checksum by the letter of the specification."""
    raw = np.frombuffer(packed(data), np.uint8).reshape(-1, width)
    wide = raw.astype(np.uint16)
    check = wide[:, -2] | wide[:, -1] << 8
    if width == 3:
        check = check ^ wide[:, 0]
    if width == 4:
        check = check ^ (wide[:, 0] | wide[:, 1] << 8)
    return Rows(raw, check)


ANGLES = np.array([100.0, 101.0, 102.0, 103.0])
MM = np.array([1000.0, 1011.0, 2072.25, NAN])


def test_worked_packets() -> None:
    two = packed("AA 55 00 04 01 32 81 33 FF 4F A0 0F CC 0F B9 1F 00 00")
    words = np.array([4000, 4044, 8121, 0]) / 4.0
    rows = encode_samples(np.where(words > 0, words, NAN), np.zeros(4), 0, 0.25)
    assert encode_packets(0, ANGLES, rows) == [two]
    assert hashlib.sha256(two).hexdigest().startswith("b453ae349520ec3b")
    three = packed("AA 55 00 04 01 32 81 33 E1 4F 64 A0 0F 5A CC 0F 21 B8 1F 00 00 00")
    mm = np.array([1000.0, 1011.0, 2030.0, NAN])
    rows = encode_samples(mm, np.array([100, 90, 33, 0]) / 255.0, 8, 0.25)
    assert encode_packets(0, ANGLES, rows) == [three]
    ten = packed("AA 55 00 02 01 32 81 33 8D 56 90 A1 0F 5A CC 0F")
    rows = encode_samples(mm[:2], np.array([400, 90]) / 1023.0, 10, 0.25)
    assert encode_packets(0, np.array([100.0, 103.0]), rows) == [ten]
    four = packed("AA 55 00 04 01 32 81 33 27 57 20 03 E8 03 D0 02 F3 03 08 01 EE 07 00 00 00 00")
    rows = encode_samples(mm, np.array([800, 720, 264, 0]) / 65_535.0, 16, 1.0)
    assert encode_packets(0, ANGLES, rows) == [four]
    assert hashlib.sha256(four).hexdigest().startswith("cfe4242a8aead1d4")


def test_worked_zero_packets() -> None:
    rows = encode_samples(np.array([1000.0]), np.zeros(1), 0, 0.25)
    assert encode_packets(1 | 70 << 1, np.array([0.5]), rows) == [packed("AA 55 8D 01 41 00 41 00 87 5B A0 0F")]
    printed = packed("AA 55 01 01 53 AE 53 AE AB 54 00 00")
    assert encode_packets(1, np.array([0x5729 / 64.0]), rows_of("00 00", 2)) == [printed]


def test_worked_replies() -> None:
    assert descriptor(0x81, 5, multiple=True) == packed("A5 5A 05 00 00 40 81")
    assert reply(0x06, bytes(3)) == packed("A5 5A 03 00 00 00 06 00 00 00")
    assert reply(0x04, (700).to_bytes(4, "little")) == packed("A5 5A 04 00 00 00 04 BC 02 00 00")


@pytest.mark.parametrize(("bits", "unit"), [(0, 0.25), (8, 0.25), (10, 0.25), (16, 1.0), (0, 1.0)])
@given(st.lists(st.one_of(st.just(NAN), st.floats(1.0, 16_000.0)), min_size=1, max_size=200), st.booleans())
def test_every_sample_of_a_turn_arrives(bits: int, unit: float, found: list[float], whole: bool) -> None:
    mm, level = np.array(found), np.linspace(0.0, 1.0, len(found))
    angle = np.linspace(0.1, 359.6, len(found)) if len(found) > 1 else np.array([0.1])
    data = encode_packets(141 if whole else 0, angle, encode_samples(mm, level, bits, unit))
    read = [one for one in StreamReader(WIDTHS[bits]).feed(b"".join(data)) if not isinstance(one, bytes)]
    assert len(read) == len(data)
    sizes = [len(one.words) for one in read]
    assert sizes[0] == (1 if whole else min(len(found), MOST_SAMPLES))
    assert all(size == MOST_SAMPLES for size in sizes[whole:-1])
    assert [one.kind & 1 for one in read] == [int(whole), *[0] * (len(read) - 1)]
    back = np.concatenate([range_mm(one, unit) for one in read])
    np.testing.assert_allclose(back, np.where(mm >= 0.125, mm, NAN), atol=0.501 if bits in (8, 10) else 0.501 * unit)
    np.testing.assert_allclose(np.concatenate([one.angle_deg for one in read]), angle, atol=0.02)
    for one in data:
        check = 0
        head = struct.unpack("<5H", one[:10])
        width, body = WIDTHS[bits], one[10:]
        for at in range(0, len(body), width):
            part = body[at : at + width]
            check ^= int.from_bytes(part[-2:], "little")
            check ^= int.from_bytes(part[:-2], "little")
        assert head[4] == head[0] ^ head[1] ^ head[2] ^ head[3] ^ check
        assert (head[0], head[2] & 1, head[3] & 1) == (0x55AA, 1, 1)


def test_ranges_that_do_not_fit_are_none() -> None:
    rows = encode_samples(np.array([16_383.75, 16_384.0, 1e6]), np.ones(3), 0, 0.25)
    assert rows.check.tolist() == [65_535, 0, 0]
    rows = encode_samples(np.array([16_383.0, 16_384.0]), np.ones(2), 8, 0.25)
    assert rows.data.tolist() == [[255, 252, 255], [0, 0, 0]]


@pytest.mark.parametrize(("mm", "degrees"), [(1000.0, -6.7622), (8000.0, -7.8374), (100.0, 4.4388), (0.0, 0.0)])
def test_worked_corrections(mm: float, degrees: float) -> None:
    assert float(correction_deg(np.array(mm))) == pytest.approx(degrees, abs=1e-4)
    assert pytest.approx(-7.99, abs=0.01) == FAR_DEG


def test_the_corrected_points_lie_on_the_line_that_passes_beside_the_axis() -> None:
    mm = np.geomspace(60.0, 20_000.0, 50)
    seen = np.radians(correction_deg(mm))
    # of the specification: through the reference direction 155.3 mm out, inclination atan(21.8 / 155.3)
    slope = 21.8 / 155.3
    x, y = mm * np.cos(seen), mm * np.sin(seen)
    flat = mm / np.sqrt(1.0 + np.tan(seen) ** 2)
    np.testing.assert_allclose(x, flat)
    np.testing.assert_allclose(np.tan(seen), y / x)
    np.testing.assert_allclose(np.tan(seen) * mm, 21.8 - slope * mm, atol=1e-9)


def test_a_line_meets_the_nearer_of_two_and_looks_past_the_edge_of_a_near_one() -> None:
    angle = 90.0 + 0.5 * np.arange(100)
    cast = angle + FAR_DEG
    mm = np.where((cast > 100.0) & (cast < 110.0), 300.0, 4000.0)
    chosen = seen_from(angle, cast, mm)
    seen = mm[chosen]
    true = angle + correction_deg(seen)
    near = seen == 300.0
    # the near plate is met at all angles whose line points at it, and there alone
    np.testing.assert_allclose([true[near].min(), true[near].max()], [100.25, 109.75], atol=0.5)
    assert np.diff(np.flatnonzero(near)).max() == 1
    lines = angle + float(correction_deg(np.array(300.0)))
    inside = (lines > 100.5) & (lines < 109.5)
    outside = (lines < 99.5) | (lines > 110.5)
    assert near[inside].all()
    assert not near[outside].any()
    # behind its far edge the line sees the wall where the axis does not: 4.3 degrees beside the plate, not a hole
    assert np.isfinite(seen).all()


def test_no_echo_stays_where_it_is() -> None:
    angle = np.arange(0.0, 50.0)
    mm = np.where((angle >= 20.0) & (angle < 30.0), NAN, 2000.0)
    cast = angle + correction_deg(np.full(50, 2000.0))
    np.testing.assert_array_equal(seen_from(angle, cast, mm), np.arange(50))
    assert seen_from(np.array([5.0]), np.array([5.0 + FAR_DEG]), np.array([NAN])).tolist() == [0]


@pytest.mark.parametrize(("bits", "unit"), [(0, 0.25), (8, 0.25), (16, 1.0)])
def test_the_width_of_samples_is_found_where_zeros_end_a_packet(bits: int, unit: float) -> None:
    mm = np.where(np.arange(400) % 40 < 20, 1500.0, NAN)
    data = b"".join(encode_packets(141, 0.9 * np.arange(400), encode_samples(mm, np.ones(400), bits, unit)))
    reader = StreamReader()
    read = [one for one in reader.feed(data[7:] + data) if not isinstance(one, bytes)]
    assert {one.intensity is None for one in read} == {bits == 0}
    assert sum(len(one.words) for one in read) >= 780
    assert reader.errors == 0


@pytest.mark.parametrize("chunk", [1, 3, 17, 1000])
def test_a_stream_is_read_in_any_chunking(chunk: int) -> None:
    one = packed("AA 55 00 04 01 32 81 33 FF 4F A0 0F CC 0F B9 1F 00 00")
    info = packed("A5 5A 14 00 00 00 04 06 05 01 03 02 00 02 04 00 01 01 05 00 00 00 00 00 01 02 03")
    data = b"\x55\xaa" + one + info + one[:-1] + b"\x77" + one + packed("A5 5A 05 00 00 40 81") + one
    data += bytes(200)
    reader, found = StreamReader(), []
    for at in range(0, len(data), chunk):
        found += list(reader.feed(data[at : at + chunk]))
    assert [one if isinstance(one, bytes) else len(one.words) for one in found] == [
        4, info, 4, packed("A5 5A 05 00 00 40 81"), 4,
    ]  # fmt: skip
    assert reader.errors == 1
