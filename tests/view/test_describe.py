"""Telegrams field by field: published bytes, and bytes that are none."""

from __future__ import annotations

import cantools
import numpy as np
import pytest

from emulator.hosts.describe import Described, Speaker, describe
from protocols.ld.telegrams import payload_of
from protocols.ld.usp import encode_frame
from protocols.lms2xx.telegrams import Header, all_values, reply

LMS, LD = Speaker("lms2xx"), Speaker("ld")
ARS408 = Speaker("can_objects", {"format": "ars408"}, {"sensor_id": 1})


def reported(found: list[Described]) -> dict[str, tuple[str, str]]:
    return {one.name: (one.value, one.unit) for one in found}


# SICK listing 8007954: start of the stream, its answer, installation mode with its password
@pytest.mark.parametrize(
    ("data", "sent", "expected"),
    [
        (
            "02 00 02 00 20 24 34 08",
            False,
            {"command": ("20 24", "all values, continuously"), "CRC": ("0834", "right")},
        ),
        ("02 80 03 00 A0 00 10 16 0A", True, {"result": ("0", "done"), "status": ("10", "no fault")}),
        (
            "02 00 0A 00 20 00 53 49 43 4B 5F 4C 4D 53 BE C5",
            False,
            {"command": ("20 00", "installation mode, with password"), "data": ("53 49 43 4b 5f 4c 4d 53", "")},
        ),
        ("02 00 01 00 31 15 12", False, {"command": ("31", "status"), "length": ("1", "bytes")}),
        ("06", True, {"acknowledge": ("06", "ACK")}),
    ],
)
def test_published_telegrams_of_the_lms2xx(data: str, sent: bool, expected: dict[str, tuple[str, str]]) -> None:
    found = reported(describe(LMS, bytes.fromhex(data), sent=sent))
    for name, value in expected.items():
        if name == "command" and value[0] == "31":
            assert found[name][0] == "31"
            assert "status" in found[name][1]
        else:
            assert found[name] == value


def test_measured_values_are_told_with_unit_and_what_gave_none() -> None:
    values = np.array([100, 250, 8191, 3000], np.uint16)
    found = reported(describe(LMS, reply(all_values(values, Header(4, unit=0)), 0x10)))
    assert found["response"] == ("B0", "measured values")
    assert found["distances"][0] == "100 250 8191 3000"
    assert found["nearest, farthest"] == ("1.00, 30.00", "m")
    assert found["no distance"][0] == "1"


def test_the_answer_about_the_variant_is_told_in_degrees() -> None:
    found = reported(describe(LMS, reply(bytes.fromhex("BB 01 B4 00 32 00"), 0x10)))
    assert (found["result"], found["field"], found["step"]) == (("1", "set"), ("180", "deg"), ("0.5", "deg"))


def test_an_ack_and_its_answer_in_one_piece_are_both_told() -> None:
    both = reply(b"\xa0\x00", 0x10) + reply(b"\xba" + b"LMS291", 0x90)
    found = describe(LMS, both)
    assert [one.value for one in found if one.name == "response"] == ["A0", "BA"]
    assert reported(found)["text"] == ("LMS291", "")
    assert reported(found)["status"] == ("90", "no fault, window polluted")


@pytest.mark.parametrize(
    ("data", "reason"),
    [
        ("02 00 02 00 20 24 34 09", "wrong checksum"),
        ("02 00 02 00 20", "no start of a telegram"),
        ("02 00 20 00 20 24 34 08", "8 bytes; the length field says 38"),
        ("AA BB", "no start of a telegram"),
    ],
)
def test_what_is_none_is_shown_as_hex_with_the_reason(data: str, reason: str) -> None:
    rows = [one for one in describe(LMS, bytes.fromhex(data)) if one.name == "bytes"]
    assert rows[0].unit == reason
    assert bytes.fromhex(rows[0].value.replace("…", "")) in bytes.fromhex(data)


def test_the_vendors_package_of_the_ld_is_told() -> None:
    # COMTEST: GET_CONFIG of the global settings
    found = reported(describe(LD, b"\x021410000400000202" + b"00012BBC\x03", "serial", sent=False))
    assert found["address"][0] == "1410"
    assert found["service"] == ("0202", "GET_CONFIG")
    assert found["data"][0] == "0001"


def test_a_profile_of_the_ld_is_told_in_metres_and_degrees() -> None:
    words = (0x8301, 0x21B0, 1, 8, 3, 5752, 2560, 0, 512, 0, 3)
    found = reported(describe(LD, encode_frame(payload_of(*words)), "stream"))
    assert found["service"] == ("8301", "GET_PROFILE, reply")
    assert found["step"] == ("0.5", "deg")
    assert found["first direction"] == ("359.5", "deg")
    assert found["distances"] == ("10.00 0.00 2.00", "m")
    assert found["sensor status"] == ("0003", "measure, motor ok")
    cut = reported(describe(LD, encode_frame(payload_of(*words[:8])), "stream"))
    assert "cut" in cut


def test_a_frame_is_told_signal_by_signal_as_cantools_reads_it() -> None:
    from importlib.resources import files

    database = cantools.database.load_string(files("protocols.can_objects").joinpath("ars408.dbc").read_text(), "dbc")
    message = database.get_message_by_name("ObjGeneral")
    data = message.encode({signal.name: signal.minimum or 0 for signal in message.signals}, strict=False)
    found = describe(ARS408, data, "can", peer=message.frame_id + 0x10)  # sensor id 1
    assert found[0] == Described("identifier", f"{message.frame_id + 0x10:03X}", "ObjGeneral")
    assert [one.name for one in found[1:]] == [signal.name for signal in message.signals]
    assert {one.unit for one in found[1:]} >= {"m", "m/s"}
    assert describe(ARS408, b"\1\2", "can", peer=0x7FF)[1].unit == "not in the format's DBC"
    assert "short" in describe(ARS408, data[:3], "can", peer=message.frame_id)[-1].unit


@pytest.mark.parametrize("speaker", [LMS, LD, ARS408, Speaker("nobody"), Speaker("can_objects", {"format": "none"})])
@pytest.mark.parametrize("kind", ["serial", "stream", "can"])
def test_no_bytes_whatever_make_it_fail(speaker: Speaker, kind: str) -> None:
    draws = np.random.default_rng(5)
    for size in (0, 1, 2, 5, 8, 40, 300):
        for start in (b"", b"\x02\x80\x24\x00", b"\x02USP\x00\x00\x00\x02", b"\x021410"):
            data = start + draws.bytes(size)
            for sent in (True, False):
                assert describe(speaker, data, kind, int(draws.integers(0, 0x800)), sent)


def test_a_leddars_detections_are_named_wherever_its_identifiers_are() -> None:
    moved = Speaker("can_objects", {"format": "leddar_vu8"}, {"tx_base_id": 0x660})
    for peer in (0x662, 0x663, 0x662 + 95):
        assert describe(moved, bytes(8), "can", peer=peer)[0].unit == "Detection"
    assert describe(moved, bytes(8), "can", peer=0x661)[0].unit == "DetectionCount"
    assert (
        describe(Speaker("can_objects", {"format": "leddar_m16"}), bytes(8), "can", peer=0x753)[0].unit == "Detections"
    )


def test_replies_of_scip_are_taken_apart() -> None:
    scan = b"ME0000000101000\n99b\n030il\n0?X0O@0?]0OAB\n\n"
    found = {one.name: (one.value, one.unit) for one in describe(Speaker("scip"), scan)}
    assert found["time stamp"] == ("12345", "ms")
    assert found["distances"] == ("1.000 1.005", "m")
    assert found["intensities"][0] == "2000 2001"
    (command,) = describe(Speaker("scip"), b"BM\n", sent=False)
    assert command.value == "BM\\n"
    for damaged in (b"ME0000000101000\n99b\n030ix\n0?X\n\n", b"\xff\n", b"MD\n00P\n\n"):
        assert describe(Speaker("scip"), damaged)


def test_replies_and_capsules_of_an_rplidar_are_taken_apart() -> None:
    (request,) = describe(Speaker("rplidar"), b"\xa5\xf0\x02\x94\x02\xc1", sent=False)
    assert (request.name, request.value) == ("SET_MOTOR_PWM", "94 02")
    reply = {one.name: one.value for one in describe(Speaker("rplidar"), bytes.fromhex("A55A030000000601 0203"))}
    assert reply == {"type": "06", "data": "01 02 03"}
    capsule = bytes.fromhex("A9590099") + bytes.fromhex("D007") * 40
    found = {one.name: (one.value, one.unit) for one in describe(Speaker("rplidar"), capsule)}
    assert found["start angle"] == ("100.000", "deg")
    assert found["distances"][0].startswith("2000 2000")
    nodes = {one.name: one.value for one in describe(Speaker("rplidar"), bytes.fromhex("5A0132401F") * 2)}
    assert nodes == {"angles": "100.00 100.00", "distances": "2000 2000"}
    for damaged in (b"", b"\xa5", b"\xff" * 5, bytes(84)):
        assert describe(Speaker("rplidar"), damaged)
