"""The conversation of the maker's SDK with a Vu8 and an M16, byte by byte: connect, constants, configuration, changes.

Source: leddartech/LeddarSDK, src/Leddar: LdProtocolCan.cpp (what it sends, which answers it takes), LdSensorVu8Can.cpp
and LdSensorM16Can.cpp (GetConstants, GetConfig, SetConfig, GetEchoes), LtComVuCanbus.h, LtComM16Canbus.h.
`Sdk` reads as LdProtocolCan does and raises where it throws.
"""

from __future__ import annotations

import itertools
import math
import struct
from collections.abc import Sequence
from typing import Any

import pytest

from protocols.session import Dropped, DropReason
from tests.protocols.can_objects.rig import Rig, line, start, thing

FAILED = b"\xff" * 6


class Sdk:
    """`LdProtocolCan` on a bus with one sensor."""

    def __init__(self, rig: Rig, m16: bool, tx: int = 0x750, rx: int = 0x740) -> None:
        self.rig, self.m16, self.tx, self.rx = rig, m16, tx, rx
        rig.run(0.1)
        # the constructor: EnableStreamingDetections( false )
        self.send(3 if m16 else 1, 0)
        if not m16:
            assert self.receive()[0][:2] == b"\x01\x00"
        self.rig.run(0.02)

    def send(self, command: int, argument: int, rest: bytes = b"") -> None:
        data = bytes((command, argument)) + rest.ljust(6, b"\0")
        self.rig.hear(f"{self.rx:X} {data.hex(' ')}")

    def receive(self, seconds: float = 1.0) -> list[bytes]:
        """Frames of the configuration buffer; LdInterfaceCan throws at an identifier that is not the sensor's."""
        found = []
        for one in self.rig.run(seconds):
            assert one.address is not None
            assert self.tx <= one.address.peer <= self.tx + 97
            answers = one.address.peer == self.tx + 1 and one.payload[0] >= 128 if self.m16 else None
            if answers if self.m16 else one.address.peer == self.tx:
                found.append(one.payload)
        return found

    def value(self, command: int, argument: int, rest: bytes = b"") -> bytes:
        """GetValue and SetValue: the six bytes behind the two that must be echoed."""
        self.send(command, argument, rest)
        (answer,) = self.receive(0.05)
        if answer[2:] == FAILED:
            raise RuntimeError(f"Sensor failed to process command: {command}")
        assert answer[:2] == bytes((command + 128 * self.m16, argument))
        return answer[2:]

    def text(self, command: int, first: int, size: int) -> bytes:
        return b"".join(self.value(command, first + k) for k in range(-(-size // 6)))[:size]


def said(rig: Rig, asked: Sequence[str]) -> list[str]:
    """What the device says to each frame, at once."""
    found = []
    for frame in asked:
        rig.hear(frame)
        found += [line(one) for one in rig.run(0.01)]
    return found


VU8_CONNECT = """
740 01 00 00 00 00 00 00 00  750 01 00 00 00 00 00 00 00  stop streaming
740 04 00 00 00 00 00 00 00  750 04 00 08 00 00 00 00 00  eight segments
740 04 01 00 00 00 00 00 00  750 04 01 0D 00 00 00 00 00  13: LeddarVu8
740 04 02 00 00 00 00 00 00  750 04 02 03 00 00 00 00 00  firmware 3.0.0.
740 04 03 00 00 00 00 00 00  750 04 03 01 00 00 00 00 00  1
740 04 04 00 00 00 00 00 00  750 04 04 01 00 00 00 00 00  boot loader 1.0.0.
740 04 05 00 00 00 00 00 00  750 04 05 01 00 00 00 00 00  1
740 04 06 00 00 00 00 00 00  750 04 06 01 00 00 00 FF 00  FPGA 1, running
740 04 07 00 00 00 00 00 00  750 04 07 41 45 30 30 30 30  AE0000
740 04 08 00 00 00 00 00 00  750 04 08 31 00 00 00 00 00  1
740 04 0D 00 00 00 00 00 00  750 04 0D 4C 65 64 64 61 72  Leddar
740 04 0E 00 00 00 00 00 00  750 04 0E 56 75 38 00 00 00  Vu8
740 04 13 00 00 00 00 00 00  750 04 13 37 35 48 30 30 30  75H000
740 04 19 00 00 00 00 00 00  750 04 19 36 30 44 30 30 30  60D000
740 05 00 00 00 00 00 00 00  750 05 00 05 01 20 00 00 00  2^5, 2^1, 32 points
740 05 01 00 00 00 00 00 00  750 05 01 00 00 00 00 00 00  smoothing 0, threshold 0
740 05 02 00 00 00 00 00 00  750 05 02 64 01 01 00 00 00  100 %, 1 echo, 1 frame
740 05 03 00 00 00 00 00 00  750 05 03 64 00 09 00 00 00  cm; automatic power, smoothing
740 05 04 00 00 00 00 00 00  750 05 04 00 00 50 07 00 00  1000 kbit/s, 11 bits, Tx 750
740 05 05 00 00 00 00 00 00  750 05 05 00 00 40 07 00 00  Rx 740
740 05 06 00 00 00 00 00 00  750 05 06 00 60 00 00 00 00  96 detections, no delays
740 05 08 00 00 00 00 00 00  750 05 08 00 00 00 00 00 00  every segment measures
740 06 00 06 02 14 00 00 00  750 06 00 06 02 14 00 00 00  SetConfig: echoed
740 05 00 00 00 00 00 00 00  750 05 00 06 02 14 00 00 00
740 06 01 FC 00 40 01 00 00  750 06 01 FC 00 40 01 00 00  smoothing -4, threshold 5
740 05 01 00 00 00 00 00 00  750 05 01 FC 00 40 01 00 00
740 06 02 1E 02 0A 00 00 00  750 06 02 1E 02 0A 00 00 00  30 % asked for,
740 05 02 00 00 00 00 00 00  750 05 02 1C 02 0A 00 00 00  28 % is the closest
740 06 03 E8 03 00 00 00 00  750 06 03 E8 03 00 00 00 00  mm, manual power
740 05 03 00 00 00 00 00 00  750 05 03 E8 03 00 00 00 00
740 06 06 00 10 02 00 05 00  750 06 06 00 10 02 00 05 00  16 detections, 2 ms, 5 ms
740 05 06 00 00 00 00 00 00  750 05 06 00 10 02 00 05 00
740 06 08 00 00 03 00 00 00  750 06 08 00 00 03 00 00 00  segments 0 and 1 off
740 05 08 00 00 00 00 00 00  750 05 08 00 00 03 00 00 00
"""

M16_CONNECT = """
740 03 00 00 00 00 00 00 00                                stop streaming: no answer
740 06 01 00 00 00 00 00 00  751 86 01 09 00 00 00 00 00  9: M16
740 06 02 00 00 00 00 00 00  751 86 02 01 00 00 00 00 00  firmware
740 06 03 00 00 00 00 00 00  751 86 03 01 00 00 00 FF 00  FPGA, running
740 06 04 00 00 00 00 00 00  751 86 04 41 45 30 30 30 30  AE0000
740 06 0A 00 00 00 00 00 00  751 86 0A 4D 00 31 00 36 00  M16 in UTF-16
740 06 15 00 00 00 00 00 00  751 86 15 36 30 44 30 30 30  60D000
740 06 18 00 00 00 00 00 00  751 86 18 37 35 48 30 30 30  75H000
740 07 03 00 00 00 00 00 00  751 87 03 64 00 00 00 00 00  100 %
740 07 04 00 00 00 00 00 00  751 87 04 01 00 00 00 00 00  automatic
740 07 05 00 00 00 00 00 00  751 87 05 01 00 00 00 00 00
740 07 06 00 00 00 00 00 00  751 87 06 00 00 00 00 00 00
740 07 07 00 00 00 00 00 00  751 87 07 64 00 00 00 00 00  cm
740 07 08 00 00 00 00 00 00  751 87 08 FF FF 00 00 00 00  all are told
740 07 0E 00 00 00 00 00 00  751 87 0E 00 00 00 00 00 00  all measure
740 07 00 00 00 00 00 00 00  751 87 00 07 03 20 00 00 00  2^7, 2^3, 32
740 07 02 00 00 00 00 00 00  751 87 02 00 00 00 00 00 00
740 07 09 00 00 00 00 00 00  751 87 09 00 00 50 07 00 00
740 07 0A 00 00 00 00 00 00  751 87 0A 00 00 40 07 00 00
740 07 0B 00 00 00 00 00 00  751 87 0B 00 60 00 00 00 00
740 06 00 00 00 00 00 00 00  751 86 00 00 00 00 00 1E 00  GetStates: 30 degrees
740 08 03 5A 00 00 00 00 00  751 88 03 5A 00 00 00 00 00  90 %
740 07 03 00 00 00 00 00 00  751 87 03 5A 00 00 00 00 00
740 08 0B 08 10 00 00 00 00  751 88 0B 08 10 00 00 00 00  with flags, 16 detections
740 07 0B 00 00 00 00 00 00  751 87 0B 08 10 00 00 00 00
"""


@pytest.mark.parametrize(("name", "conversation"), [("leddar_vu8", VU8_CONNECT), ("leddar_m16", M16_CONNECT)])
def test_the_conversation_of_the_sdk_byte_by_byte(name: str, conversation: str) -> None:
    rig = start({"format": name})
    rig.run(0.1)
    for row in conversation.strip().splitlines():
        asked, answer = row[:27], row[29:56].strip()
        assert said(rig, [asked]) == ([answer] if answer else []), row
    assert rig.dropped() == []


def test_the_vu8_is_connected_to_with_all_its_constants() -> None:
    texts = {"serial_number": "S" * 32, "device_name": "front left", "hardware_part": "75H0026-1"}
    rig = start({"format": "leddar_vu8", **texts, "firmware": [1, 2, 3, 4], "fpga": 7, "streaming": "start"})
    sdk = Sdk(rig, m16=False)
    assert struct.unpack("<4H", sdk.text(4, 2, 12)[:8]) == (1, 2, 3, 4)
    assert sdk.value(4, 6) == b"\x07\0\0\0\xff\0"
    assert sdk.text(4, 7, 32) == b"S" * 32
    assert sdk.text(4, 13, 32).rstrip(b"\0") == b"front left"
    assert sdk.text(4, 19, 32).rstrip(b"\0") == b"75H0026-1"


@pytest.mark.parametrize(("kind", "number"), [("m16", 9), ("m16_laser", 14), ("is16", 8)])
def test_the_m16_is_connected_to_with_its_kind(kind: str, number: int) -> None:
    sdk = Sdk(start({"format": "leddar_m16", "kind": kind, "device_name": "x" * 32}), m16=True)
    assert sdk.value(6, 1)[:2] == bytes((number, 0))
    assert sdk.text(6, 10, 64).decode("utf-16-le") == "x" * 32
    assert len(sdk.text(6, 21, 16) + sdk.text(6, 24, 16)) == 32
    has, has_not = (1, 0) if kind == "is16" else (0, 1)
    sdk.value(7, has)
    with pytest.raises(RuntimeError, match="failed to process"):
        sdk.value(7, has_not)


def echoes(sdk: Sdk, once: bytes) -> list[tuple[float, float, int]]:
    """GetEchoes without a stream: counts and detections, in metres (at cm) and counts."""
    sdk.send(once[0], once[1])
    frames = [one for one in sdk.rig.run(0.3) if one.address]
    if not sdk.m16:
        assert frames.pop(0).payload[:2] == once
    head = frames.pop(0)
    assert head.address is not None
    assert head.address.peer == sdk.tx + 1
    found: list[tuple[float, float, int]] = []
    for one in frames:
        assert one.address is not None
        if not sdk.m16:
            assert one.address.peer >= sdk.tx + 2
            far, high, _, segment = struct.unpack("<4H", one.payload)
            found.append((far / 100, high / 64, segment))
        elif once[1] & 8:
            far, high, _, segment = struct.unpack("<HHBBxx", one.payload)
            found.append((far / 100, high / 64, segment))
        else:
            assert one.address.peer == sdk.tx or one.address.peer >= sdk.tx + 2
            for far, both in struct.iter_unpack("<HH", one.payload):
                found.append((far / 100, (both & 0xFFF) / 4, both >> 12))
    count = head.payload[0]
    assert count <= len(found) <= count + 1
    return found[:count]


WALL = [thing(1, 20.0, 0.0, size_m=(2.0, 60.0, 2.0), reflectance=0.5)]


@pytest.mark.parametrize("mode", [0, 1, 8, 9])
def test_echoes_of_an_m16_are_the_same_in_every_mode(mode: int) -> None:
    rig = start({"format": "leddar_m16"}, WALL)
    found = echoes(Sdk(rig, m16=True), bytes((4, mode)))
    assert [segment for _, _, segment in found] == list(range(15, -1, -1))
    assert found[7][0] == pytest.approx(19.0, abs=0.02)
    assert found[7][1] == pytest.approx(20 * 0.5 * (10 / 19.0) ** 2, abs=0.25)
    peers = [e.address.peer for e in rig.sent if e.address and e.label in ("Detections", "FlaggedDetection")]
    assert len(peers) == (16 if mode & 8 else 8)
    assert peers == [0x752 + k if mode & 1 else 0x750 for k in range(len(peers))]


def test_an_odd_number_of_detections_ends_with_half_a_frame() -> None:
    rig = start({"format": "leddar_m16"}, WALL)
    sdk = Sdk(rig, m16=True)
    sdk.value(8, 8, b"\x07\0")  # three segments are told
    assert [segment for _, _, segment in echoes(sdk, b"\x04\0")] == [2, 1, 0]
    assert [e.payload[4:] for e in rig.sent if e.label == "Detections"][1] == bytes(4)
    for either in (b"\x01\0", b"\x02\0", b"\x03\0"):
        sdk.value(8, 14, either)  # a pair is switched off by either of its bits
        assert [segment for _, _, segment in echoes(sdk, b"\x04\0")] == [2]


def test_a_ros_driver_asks_an_m16_by_the_legacy_requests_in_one_byte() -> None:
    """CentralIllinoisRoboticsClub/leddar_can: 740#01 for a list, 740#02 and 740#03 for a stream and its end."""
    rig = start({"format": "leddar_m16"}, WALL)
    rig.run(0.1)
    rig.hear("740 01")
    assert [e.address.peer for e in rig.run(0.3) if e.address] == [0x751, *[0x750] * 8]
    rig.hear("740 02")
    assert len([e for e in rig.run(0.5) if e.label == "DetectionCount"]) == 7  # 12.5 a second
    rig.hear("740 03")
    rig.run(0.01)
    assert rig.run(0.5) == []
    extended = start({"format": "leddar_m16", "extended_ids": True}, WALL)
    extended.run(0.1)
    extended.hear("80000740 01")
    assert {e.address.peer for e in extended.run(0.3) if e.address} == {0x80000751, 0x80000750}


@pytest.mark.parametrize(
    ("m16", "code", "data"),
    [
        (False, 0, "0B 01 20"),  # accumulation exponent 11; want 0 to 10
        (False, 0, "05 06 20"),
        (False, 0, "05 01 01"),
        (False, 1, "11 00 00 00 00 00"),  # smoothing 17
        (False, 1, "00 00 01 19 00 00"),  # threshold 100 and 1/64
        (False, 2, "65 00 01 00"),  # 101 %
        (False, 2, "64 09 01 00"),
        (False, 2, "64 00 00 00"),
        (False, 3, "02 00 00 00"),  # 2 to a metre
        (False, 3, "64 00 00 02"),
        (False, 4, "08 00 50 07 00 00"),
        (False, 4, "00 02 50 07 00 00"),
        (False, 4, "00 00 9F 07 00 00"),  # 0x752 + 95 beyond 0x7FF
        (False, 4, "00 00 20 07 00 00"),  # its own identifiers would take in 0x740
        (False, 5, "00 00 51 07 00 00"),
        (False, 5, "00 00 00 08 00 00"),
        (False, 6, "00 00 00 00 00 00"),
        (False, 6, "00 61 00 00 00 00"),
        (False, 7, "00"),
        (False, 8, "00 00 00 02 00 00"),
        (False, 9, "00"),
        (True, 0, "0C 03 20"),  # 2^15
        (True, 1, "0A"),  # an IS16's
        (True, 3, "65"),
        (True, 5, "00 00"),
        (True, 6, "EE"),  # -18
        (True, 7, "05 00"),
        (True, 11, "10 60"),
        (True, 12, "00"),
    ],
)
def test_a_value_out_of_range_is_refused_and_nothing_of_its_frame_is_taken(m16: bool, code: int, data: str) -> None:
    rig = start({"format": "leddar_m16" if m16 else "leddar_vu8"})
    sdk = Sdk(rig, m16)
    get, put = (7, 8) if m16 else (5, 6)
    known = code not in (7, 9, 12) and not (m16 and code == 1)
    before = sdk.value(get, code) if known else None
    with pytest.raises(RuntimeError, match="failed to process"):
        sdk.value(put, code, bytes.fromhex(data))
    assert rig.dropped() == [DropReason.BAD_ARGUMENT]
    if known:
        assert sdk.value(get, code) == before


@pytest.mark.parametrize(
    ("frame", "reported"),
    [
        ("740 06 02 65 00 01 00 00 00", "light_power 101; want 0 to 100"),
        ("740 06 03 02 00 00 00 00 00", "units_per_m 2; want 1, 10, 100, 1000"),
        ("740 06 01 11 00 00 00 00 00", "smoothing 17; want -16 to 16"),
        ("740 06 07 00 00 00 00 00 00", "no holding data 7"),
        ("740 04 1F 00 00 00 00 00 00", "no input data 31"),
    ],
)
def test_a_refusal_is_told_with_what_is_wanted(frame: str, reported: str) -> None:
    rig = start({"format": "leddar_vu8"})
    rig.run(0.1)
    rig.hear(frame)
    (drop,) = [event for event in rig.events if isinstance(event, Dropped)]
    assert reported in drop.detail


def test_a_new_rate_holds_at_once_in_a_stream() -> None:
    rig, _ = streamed({}, "00 0A 05 20")  # 2^9 slower: a list each 20 s
    rig.hear("740 06 00 05 01 20 00 00 00")
    assert counts(rig.run(0.5)) >= 12


def test_a_set_that_is_cut_is_refused() -> None:
    rig = start({"format": "leddar_vu8"})
    rig.run(0.1)
    assert rig.ask("740 06 00 06 02 14", 0.05) == ["750 06 00 FF FF FF FF FF FF"]
    assert rig.ask("740 05 00", 0.05) == ["750 05 00 05 01 20 00 00 00"]


def streamed(device: dict[str, Any], *sets: str, seconds: float = 1.0) -> tuple[Rig, list[Any]]:
    """What a Vu8 streams after these settings."""
    rig = start({"format": "leddar_vu8", **device}, WALL)
    sdk = Sdk(rig, m16=False)
    for text in sets:
        data = bytes.fromhex(text)
        sdk.value(6, data[0], data[1:])
    sdk.send(3, 0)
    return rig, [one for one in rig.run(seconds) if one.label != "Answer"]


def counts(sent: list[Any]) -> int:
    return sum(one.label == "DetectionCount" for one in sent)


def test_accumulations_and_segments_change_the_rate_as_the_guide_says() -> None:
    """Measurement rate = base rate / (segments enabled + 1) / accumulations / oversamplings."""
    assert counts(streamed({})[1]) == 25
    assert counts(streamed({}, "00 04 01 20")[1]) == 50
    assert counts(streamed({}, "00 06 02 20", seconds=1.6)[1]) == 10
    assert counts(streamed({}, "08 00 00 E0 00 00 00")[1]) == round(25 * 9 / 6)


def test_units_power_threshold_and_segments_act_on_what_is_told() -> None:
    _, sent = streamed({}, "03 E8 03 00 00", "02 1C 01 01 00")  # mm, manual power of 28 %
    first = next(one.payload for one in sent if one.label == "Detection")
    head = next(one.payload for one in sent if one.label == "DetectionCount")
    assert head[1] == 28
    assert int.from_bytes(first[:2], "little") / 1000 == pytest.approx(19.0 / math.cos(math.radians(18.375)), abs=0.001)
    assert int.from_bytes(first[2:4], "little") / 64 == pytest.approx(0.28 * 20 * 0.5 * (10 / 20.021) ** 2, abs=0.02)
    _, sent = streamed({}, "03 01 00 01 00")
    assert {int.from_bytes(one.payload[:2], "little") for one in sent if one.label == "Detection"} == {19, 20}
    _, sent = streamed({}, "08 00 00 0F 00 00 00")
    assert {one.payload[6] for one in sent if one.label == "Detection"} == {4, 5, 6, 7}
    _, sent = streamed({}, "01 00 00 C0 00 00 00")  # 3 counts: more than any has
    assert {one.payload[0] for one in sent if one.label == "DetectionCount"} == {0}
    _, sent = streamed({}, "06 00 03 00 00 00 00")
    assert [one.payload[6] for one in sent if one.label == "Detection"][:4] == [7, 6, 5, 7]


def test_delays_stand_between_messages_and_between_lists_and_hold_up_no_answer() -> None:
    rig, sent = streamed({}, "06 00 60 02 00 00 00")
    dues = [one.due_ns for one in sent if one.label in ("DetectionCount", "Detection")][:9]
    gaps = {b - a for a, b in itertools.pairwise(dues)}
    assert all(2_000_000 < gap < 2_200_000 for gap in gaps)
    _, sent = streamed({}, "06 00 60 00 00 64 00")  # 100 ms
    heads = [one.due_ns for one in sent if one.label == "DetectionCount"]
    assert all(b - a >= 100_000_000 for a, b in itertools.pairwise(heads))
    rig, _ = streamed({}, "06 00 60 E8 03 00 00")  # a second between messages
    asked_ns = rig.now_ns
    rig.hear("740 05 00")
    (answer,) = [one for one in rig.run(0.05) if one.label == "Answer"]
    assert answer.due_ns - asked_ns < 1_000_000


def test_a_new_port_holds_from_the_next_start_on_and_is_kept() -> None:
    """SetConfig goes on to talk on the identifiers of the connection: LdProtocolCan takes them from there alone."""
    rig = start({"format": "leddar_vu8"}, WALL)
    sdk = Sdk(rig, m16=False)
    sdk.value(6, 4, bytes.fromhex("01 00 60 06 00 00"))
    sdk.value(6, 5, bytes.fromhex("00 00 50 06 00 00"))
    assert sdk.value(5, 4) == bytes.fromhex("01 00 60 06 00 00")
    assert sdk.value(10, 0, bytes.fromhex("99 00"))[0] == 0x99  # software reset: answered, then silence
    rig.run(1.0)
    rig.hear("740 05 05")
    assert rig.run(0.05) == []
    moved = Sdk(rig, m16=False, tx=0x660, rx=0x650)
    assert moved.value(5, 5) == bytes.fromhex("00 00 50 06 00 00")
    assert len(echoes(moved, b"\x02\0")) == 8
    moved.value(6, 4, bytes.fromhex("00 01 00 00 FF 18"))
    rig.session.power_on(rig.now_ns)
    rig.run(0.6)
    rig.hear("80000650 05 04")
    assert [line(one) for one in rig.run(0.05)] == ["98FF0000 05 04 00 01 00 00 FF 18"]


def test_opcodes_switch_the_protection_and_bring_the_defaults_back() -> None:
    rig = start({"format": "leddar_vu8"})
    sdk = Sdk(rig, m16=False)
    sdk.value(6, 0, b"\x06\x02\x14")
    assert sdk.value(10, 0, b"\x05\0")[2] == 0  # status: protected
    with pytest.raises(RuntimeError):
        sdk.value(10, 0, b"\xc7\0")
    for opcode, argument in ((0x06, 1), (0x0B, 0), (0x57, 0)):
        with pytest.raises(RuntimeError):
            sdk.value(10, 0, bytes((opcode, argument)))
    sdk.value(10, 0, b"\x06\0")
    assert sdk.value(10, 0, b"\x05\0")[2] == 0x02  # bit 1: writing is enabled
    assert sdk.value(10, 0, b"\xc7\0")[:2] == b"\xc7\0"
    assert sdk.value(5, 0) == b"\x05\x01\x20\0\0\0"
    sdk.value(10, 0, b"\x04\0")
    assert sdk.value(10, 0, b"\x05\0")[2] == 0


def module(sdk: Sdk, address: int, size: int) -> int:
    """Set base address, read module data."""
    sdk.value(7, 0, b"\0\0" + (address & ~0xFFFF).to_bytes(4, "little"))
    offset = (address & 0xFFFF).to_bytes(2, "little")
    answer = sdk.value(8, size, offset)
    assert answer[:2] == offset
    return int.from_bytes(answer[2 : 2 + size], "little")


def test_module_data_are_those_of_the_makers_register_map() -> None:
    rig = start({"format": "leddar_vu8", "device_name": "front"}, WALL)
    sdk = Sdk(rig, m16=False)
    assert module(sdk, 0x000000, 4) == int.from_bytes(b"fron", "little")
    assert [module(sdk, address, 1) for address in (0x20, 0x21, 0x22, 0x4C, 0x44, 0x50)] == [5, 1, 32, 1, 1, 0]
    assert module(sdk, 0x400140, 2) == 13
    assert [module(sdk, 0x400146 + k, 1) for k in range(6)] == [0, 10, 0, 5, 2, 128]
    assert module(sdk, 0x40014E, 2) == 8
    assert module(sdk, 0x400162, 4) == 65536
    echoes(sdk, b"\x02\0")
    assert module(sdk, 0x500004, 2) == 8
    assert module(sdk, 0x50000C, 4) / 65536 == pytest.approx(20.5, abs=0.5)
    assert module(sdk, 0x50000C + 8, 2) == 7
    for address in (0x100000, 0x52, 0xFFFFFF):
        with pytest.raises(RuntimeError):
            module(sdk, address, 4)
    assert module(sdk, 0xFFFB04, 2) == 0x02  # the last one: invalid address


def test_module_data_that_are_written_are_the_holding_data() -> None:
    rig = start({"format": "leddar_vu8"})
    sdk = Sdk(rig, m16=False)

    def put(offset: int, size: int, number: int) -> None:
        sdk.value(9, size, offset.to_bytes(2, "little") + number.to_bytes(4, "little"))

    with pytest.raises(RuntimeError):
        put(0x20, 1, 6)
    assert module(sdk, 0xFFFB04, 2) == 0x08  # write disabled
    sdk.value(7, 0)
    sdk.value(10, 0, b"\x06\0")
    put(0x20, 1, 6)
    put(0x47, 4, 5 * 64 * 8192)
    put(0x4C, 1, 0)
    assert sdk.value(5, 0)[:3] == b"\x06\x01\x20"
    assert sdk.value(5, 1)[2:] == (5 * 64).to_bytes(4, "little")
    assert sdk.value(5, 3)[2:4] == b"\x08\0"
    put(0x00, 4, int.from_bytes(b"Rear", "little"))
    assert sdk.text(4, 13, 32).rstrip(b"\0") == b"ReararVu8"
    for offset, size, number in ((0x20, 1, 11), (0x4C, 1, 2), (0x20, 3, 1), (0x52, 1, 0)):
        with pytest.raises(RuntimeError):
            put(offset, size, number)
    sdk.value(7, 0, b"\0\0" + (0x400000).to_bytes(4, "little"))
    with pytest.raises(RuntimeError):
        put(0x140, 1, 9)
    with pytest.raises(RuntimeError):
        sdk.value(7, 0, b"\0\0" + (0x1000000).to_bytes(4, "little"))
