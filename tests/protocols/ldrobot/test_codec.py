"""Packets of LDROBOT: printed ones exactly, and every packet read by a decoder of its own."""

from __future__ import annotations

import hashlib
import struct

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from lds2d.crc import crc8 as their_crc8

from emulator.hosts.ldrobot import PacketReader, decode_packet
from protocols.ldrobot.codec import crc8, encode_packets

VENDOR = bytes.fromhex(
    "54 2C 68 08 AB 7E E0 00 E4 DC 00 E2 D9 00 E5 D5 00 E3 D3 00 E4 D0 00 E9 CD 00 E4 CA 00 E2"
    "C7 00 E9 C5 00 E5 C2 00 E5 C0 00 E5 BE 82 3A 1A 50"
)
"Printed in the maker's manual of the LD06."


def worked(index: int = 0) -> bytes:
    angle = 100.0 + 0.8 * np.arange(12 * (index + 1))
    return encode_packets(
        3600, angle, (1000.0 + 10.0 * angle) / 1000.0, np.floor(40.0 + angle / 2), np.arange(index + 1) + 12_345, 12.0
    )[index]


def test_the_worked_packet_of_the_specification() -> None:
    assert worked().hex(" ").upper().startswith("54 2C 10 0E 10 27 D0 07 5A D8 07 5A E0 07 5A E8 07 5B")
    assert hashlib.sha256(worked()).hexdigest() == "eb2e412be14517d64ef4bf8239b2d4d42b9ea9a2a4886bfb94071b24bfdd14cc"


def test_the_maker_s_packet() -> None:
    found = decode_packet(VENDOR)
    assert found is not None
    assert (found.speed_dps, found.stamp_ms, found.range_m[0], found.intensity[0]) == (2152, 6714, 0.224, 228)
    assert (found.angle_deg[0], found.angle_deg[-1]) == pytest.approx((324.27, 334.70))
    angle = np.linspace(324.27, 334.70, 12)
    assert encode_packets(2152, angle, found.range_m, found.intensity, np.array([6714]), 12.0) == [VENDOR]


@given(st.lists(st.binary(min_size=46, max_size=46), min_size=1, max_size=4))
def test_the_crc_of_many_packets_is_that_of_each_by_a_stranger(packets: list[bytes]) -> None:
    found = crc8(np.frombuffer(b"".join(packets), np.uint8).reshape(-1, 46))
    assert found.tolist() == [their_crc8(one) for one in packets]


def test_no_echo_too_far_and_the_turn_of_angles_and_stamps() -> None:
    range_m = np.array([np.nan, 12.001, 12.0, 0.0, 0.0004, *[1.0] * 7])
    angle = 359.0 + 0.2 * np.arange(12)
    (data,) = encode_packets(3600, angle, range_m, np.full(12, 200.0), np.array([59_999]), 12.0)
    fields = struct.unpack("<BBHH" + "HB" * 12 + "HHB", data)
    assert fields[4:14] == (0, 0, 0, 0, 12_000, 200, 0, 0, 1, 200)
    assert (fields[3], fields[-3], fields[-2]) == (35_900, 120, 29_999)


@pytest.mark.parametrize("chunk", [1, 5, 46, 47, 1000])
def test_packets_are_found_in_any_chunking_and_damage_is_counted(chunk: int) -> None:
    damaged = VENDOR[:20] + b"\xff" + VENDOR[21:]
    data = b"\x54\x2c\x54" + VENDOR + damaged + VENDOR[30:] + b"\x54" + VENDOR
    reader, found = PacketReader(), []
    for at in range(0, len(data), chunk):
        found += list(reader.feed(data[at : at + chunk]))
    assert [one.stamp_ms for one in found] == [6714, 6714]
    assert reader.errors == 2
    assert worked(3)[-3:-1] == (12_348).to_bytes(2, "little")
