"""Point packets: published bytes, any chunking, damage, faults of the framing.

The digests are those of a description of the protocol that was checked against Livox-SDK2 1.4.3.
"""

from __future__ import annotations

import hashlib

import numpy as np
import pytest

from protocols.livox.codec import WHITE, Packets, decode, encode, size_of
from protocols.livox.framing import PointFraming
from protocols.session import Emission
from protocols.skeleton.reflectivity import calibrated

AT = np.arange(96.0)
XYZ = np.stack([1.0 + AT / 1000, -2.0 + AT / 1000, AT / 1000], axis=1)


def packet(count: int = 7) -> bytes:
    return encode(1_234_567_890_123, count, 0, 475_000.0, XYZ, AT)


def test_a_packet_has_the_published_bytes() -> None:
    data = packet()
    assert len(data) == 1380
    assert data[:24].hex() == "0064058e12600007000001" + "00" * 13
    assert data[24:50].hex() == "257e884acb04fb711f010000e803000030f8ffff000000000000"
    assert hashlib.sha256(data).hexdigest() == "84b5a9aac92392a69dd7fb1a519f4b6d7105a6a696417638b5fa6a9a24130501"


def test_a_packet_is_read_as_it_was_written() -> None:
    read = decode(packet())
    assert read is not None
    assert (read.count, read.frame, read.stamp_ns, read.interval_ns) == (7, 0, 1_234_567_890_123, 475_000)
    np.testing.assert_allclose(read.xyz_m, XYZ, atol=1e-12)
    np.testing.assert_array_equal(read.reflectivity, AT)


def test_a_beam_without_an_echo_keeps_its_place_as_zeros() -> None:
    xyz = XYZ.copy()
    xyz[5] = np.nan
    read = decode(encode(0, 0, 0, 0.0, xyz, np.full(96, 9.0)))
    assert read is not None
    assert not read.xyz_m[5].any()
    assert read.reflectivity[5] == 0
    assert (read.reflectivity[6:] == 9).all()


@pytest.mark.parametrize("step", [1, 13, 1380, 5000])
def test_packets_are_found_in_any_chunking_and_between_rubbish(step: int) -> None:
    data = b"\x00\x64rubbish" + packet(1) + packet(2) + b"\x00" * 50 + packet(3)
    reader = Packets()
    found = [one.count for at in range(0, len(data), step) for one in reader.feed(data[at : at + step])]
    assert found == [1, 2, 3]
    assert reader.errors == 2


def test_a_damaged_packet_is_counted_and_the_next_one_read() -> None:
    broken = bytearray(packet(1))
    broken[700] ^= 1
    reader = Packets()
    assert [one.count for one in reader.feed(bytes(broken) + packet(2))] == [2]
    assert reader.errors == 1


@pytest.mark.parametrize(("at", "value"), [(0, 1), (1, 0x65), (5, 0), (5, 97), (10, 0), (10, 3), (15, 1)])
def test_another_head_is_no_packet(at: int, value: int) -> None:
    data = bytearray(packet())
    data[at] = value
    assert size_of(bytes(data)) is None


def test_a_white_plate_is_150_at_any_distance_and_a_retro_reflector_more() -> None:
    range_m = np.array([1.0, 10.0, 20.0, 10.0, 5.0, np.nan])
    share = np.array([1.0, 1.0, 0.5, 30.0, 1e6, 1.0])
    found = calibrated(range_m, share * 2500.0 / range_m**2, 2500.0, WHITE)
    assert found.tolist() == [150, 150, 75, 150 + round(105 * np.log(30) / np.log(1000)), 255, 0]


def test_faults_change_one_field_and_nothing_else() -> None:
    framing, one = PointFraming(), Emission(0, packet(7))
    other = encode(5, 8, 0, 475_000.0, 2.0 * XYZ, AT)
    assert decode(framing.bad_check(one) or b"") is None
    counted = decode(framing.with_counter(one, 3) or b"")
    assert counted is not None
    assert (counted.count, counted.stamp_ns) == (10, 1_234_567_890_123)
    long = framing.with_length(one, 1) or b""
    assert long[1:3] == (1381).to_bytes(2, "little")
    typed = framing.with_type(one, 3) or b""
    assert (typed[10], typed[:10], typed[11:]) == (3, packet()[:10], packet()[11:])
    stale = decode(framing.stale(one, Emission(0, other)) or b"")
    assert stale is not None
    assert (stale.count, stale.stamp_ns) == (8, 5)
    np.testing.assert_allclose(stale.xyz_m, XYZ, atol=1e-12)
    assert framing.bad_check(Emission(0, b"x")) is None
