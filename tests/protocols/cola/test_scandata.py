"""LMDscandata against bytes of the specification and of recorded devices, and a decoder of our own."""

from __future__ import annotations

import hashlib
from dataclasses import replace

import numpy as np
import pytest

from protocols.cola.layouts import LAYOUT, Content, Header
from protocols.cola.scandata import Body, distances, remissions
from protocols.scan import DAZZLED
from protocols.skeleton.cola_frames import frame
from protocols.skeleton.cola_values import ASCII, BINARY, encode
from tests.protocols.cola.reader import frames, read
from tests.protocols.cola.rig import Rig

EXAMPLE_B = bytes.fromhex(
    "02 02 02 02 00 00 00 82 73 53 4e 20 4c 4d 44 73 63 61 6e 64 61 74 61 20 00 01 00 01 00 a1 b2 c3 00 00 03 43 03 47"
    "27 47 7b a9 27 47 81 3b 00 00 00 07 00 00 00 00 13 88 00 00 01 68 00 00 00 01 44 49 53 54 31 3f 80 00 00 00 00 00"
    "00 ff f9 22 30 13 88 00 03 08 a1 08 a5 08 ab 00 01 52 53 53 49 31 3f 80 00 00 00 00 00 00 ff f9 22 30 13 88 00 03"
    "64 65 66 00 00 00 00 00 00 00 01 07 e4 03 18 09 0d 1c 00 07 a1 20 00 00 db"
)
EXAMPLE_A = (
    b"sSN LMDscandata 1 1 A1B2C3 0 0 343 347 27477BA9 2747813B 0 0 0 7 0 1388 168 0 1 DIST1 3F800000 00000000 FFF92230 "
    b"1388 3 8A1 8A5 8AB 1 RSSI1 3F800000 00000000 FFF92230 1388 3 64 65 66 0 0 0 1 7E4 3 18 9 D 1C 7A120 0"
)
"Section 3.2 of the specification: three points, DIST1 of 16 and RSSI1 of 8 bit, time on."

CONTENT = Content(1, 0, 1, 0, 0, 0, 0, 0, 0, 0, 1, 1)
HEADER = Header(1, 1, 0xA1B2C3, 0, 0, 0x343, 0x347, 0x27477BA9, 0x2747813B, outputs=7, frequency=5000, shots=360)


def body(ranges_mm: list[list[int]], **more: object) -> Body:
    ranges = np.array(ranges_mm, float).T / 1000.0
    ranges[ranges == 0.0] = np.nan
    made = Body(
        HEADER, ranges, np.full(ranges.shape, 100.0), np.zeros(len(ranges), np.uint8), -450_000, 5000, 1.0, 16,
        CONTENT, tuple(range(len(ranges_mm))), date=(2020, 3, 24, 9, 13, 28, 500_000),
    )  # fmt: skip
    return replace(made, **more)  # type: ignore[arg-type]


def with_rssi(made: Body, words: list[list[int]], dialect: bytes) -> bytes:
    """The telegram with RSSI of the example in place of ours, whose scale is our own choice."""
    values = made.values()
    for channel, reported in zip([*values[17], *values[18]][len(made.channels) :], words, strict=False):
        channel[5] = np.array(reported)
    return frame(dialect, b"sSN LMDscandata " + encode(LAYOUT, dialect, values))


def test_the_worked_example_comes_out_byte_for_byte() -> None:
    made = body([[0x8A1, 0x8A5, 0x8AB]])
    assert with_rssi(made, [[0x64, 0x65, 0x66]], BINARY) == EXAMPLE_B
    assert with_rssi(made, [[0x64, 0x65, 0x66]], ASCII) == b"\x02" + EXAMPLE_A + b"\x03"


def test_a_tim_sends_both_channels_in_16_bits() -> None:
    """TiM781 with three points, the third without an echo; SHA-256 of the specification, section 8."""
    header = Header(1, 1, 0x0119FD06, 0, 0, 0xAFB1, 0xAFB1, 0xB3A805E3, 0xB3A81E29, frequency=1500, shots=162)
    made = body([[1500, 1503, 0]], header=header, start=-450_000, step=3333, content=CONTENT._replace(fine=1),
                date=(2026, 11, 22, 18, 9, 28, 500_000))  # fmt: skip
    telegram = with_rssi(made, [[0x2328, 0x2332, 0]], BINARY)
    assert hashlib.sha256(telegram).hexdigest() == "2aa19eedffac346a57a6c8ce06313824890e9db1a96dd8fcd6cb6afb8c803e73"


def test_a_layer_of_an_mrs1000_has_three_echoes_and_its_angle() -> None:
    """Second telegram of the manual's example, two points; SHA-256 of the specification, section 8."""
    header = Header(
        1, 0, 0x01053B01, 0, 0, 0x8532, 0x8532, 0x2998A3BB, 0x2A60C6C8, layer_cdeg=-250, frequency=5000, shots=180
    )
    made = body([[2000, 2010], [2500, 0], [0, 0]], header=header, start=-475_000, step=2500,
                date=(2026, 11, 22, 18, 9, 28, 500_000))  # fmt: skip
    telegram = with_rssi(made, [[0x78, 0x76], [0x28, 0], [0, 0]], BINARY)
    assert hashlib.sha256(telegram).hexdigest() == "a65fcddb67b006a546d533eba25d2e6fbd9f7436a5d95da8bc6107a724b76e3a"


def test_an_encoder_stands_before_the_channels() -> None:
    """LMS511, 1234 ticks at 250; SHA-256 of the specification, section 8."""
    header = Header(0, 1, 0x01145856, 0, 0, 100, 100, 1_000_000, 0x000FE204, frequency=2500, shots=540)
    made = body([[800, 801]], header=header, start=-50_000, step=1667, encoders=((1234, 250),),
                date=(2026, 11, 22, 18, 9, 28, 500_000))  # fmt: skip
    telegram = with_rssi(made, [[0x5A, 0x5B]], BINARY)
    assert hashlib.sha256(telegram).hexdigest() == "15342b26472cefba7d43fceece0cb3aed949c6a7a8617036141d98626a81e41e"


def test_no_echo_too_near_too_far_and_dazzled_have_their_words() -> None:
    ranges = np.array([np.nan, 0.010, 1.2344, 65.536, np.inf, 3.0])
    dazzled = np.array([False, False, False, False, False, True])
    counts = distances(ranges, dazzled, 1.0, 16)
    assert counts.tolist() == [0, 0, 1234, 0, 0, 1]
    assert distances(ranges, dazzled, 2.0, 16).tolist() == [0, 0, 617, 32_768, 0, 1]
    assert remissions(np.full(6, 1.0), counts, dazzled, False).tolist() == [0, 0, 1, 0, 0, 255]
    assert remissions(np.full(6, 1e9), counts, dazzled, True).tolist() == [0, 0, 65_534, 0, 0, 65_535]
    strengths = remissions(np.linspace(1, 4000, 50), np.full(50, 100, np.uint16), np.zeros(50, bool), False)
    assert np.all(np.diff(strengths.astype(int)) >= 0)
    assert DAZZLED == 1


SWITCHES = [
    ("01 00 0 0 0 00 00 0 0 0 0 +1", {"DIST1"}, [], None, None, False),
    ("01 00 1 0 0 00 00 0 0 0 0 +1", {"DIST1", "RSSI1"}, [], None, None, False),
    ("01 00 1 1 0 00 00 0 0 0 0 +1", {"DIST1", "RSSI1"}, ["RSSI1"], None, None, False),
    ("03 00 1 0 0 00 00 0 0 0 0 +1", {"DIST1", "DIST2", "RSSI1", "RSSI2"}, ["DIST2"], None, None, False),
    ("01 00 0 0 0 00 00 0 1 0 0 +1", {"DIST1"}, [], "not defined", None, False),
    ("01 00 0 0 0 00 00 1 1 1 1 +1", {"DIST1"}, [], "not defined", "", True),
    ("01 00 0 0 0 00 00 0 0 0 1 +1", {"DIST1"}, [], None, None, True),
]


@pytest.mark.parametrize("dialect", ["A", "B"])
@pytest.mark.parametrize(("reported", "channels", "wide", "name", "comment", "time"), SWITCHES)
def test_every_switch_of_the_content_changes_the_telegram(
    reported: str, channels: set[str], wide: list[str], name: str | None, comment: str | None, time: bool, dialect: str
) -> None:
    rig = Rig()
    rig.log_in()
    assert rig.a(f"sWN LMDscandatacfg {reported}") == "sWA LMDscandatacfg"
    rig.put(b"\x02sEN LMDscandata 1\x03" if dialect == "A" else frame(BINARY, b"sEN LMDscandata \x01"))
    rig.next()
    found = rig.next()
    assert found[0] == dialect
    scan = read(*found)
    assert set(scan.channels) == channels
    assert set(wide) <= set(scan.wide)
    assert (scan.name, scan.comment, scan.time is not None) == (name, comment, time)
    assert scan.mm() == [10_000.0] * 541
    assert scan.channels["DIST1"][:4] == (1.0, 0.0, -450_000, 5000)


def test_both_dialects_say_the_same() -> None:
    made = body([[1000, 2000, 0], [1500, 0, 0]], encoders=((7, 9),), name="a b", content=CONTENT._replace(name=1))
    reported = [read(*frames(frame(one, b"sSN LMDscandata " + made.encoded(one)))[0]) for one in (ASCII, BINARY)]
    assert reported[0] == reported[1]
