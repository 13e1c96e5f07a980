"""Every mode x every command gives a reply, or a named refusal and an unchanged device."""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import pytest

from protocols.lms2xx import FAMILY
from protocols.lms2xx.commands import COMMANDS, SWITCHES, Answer, answer, coverage_rows
from protocols.lms2xx.device import INSTALLATION, ON_REQUEST, Device
from protocols.session import DropReason

PASSWORD = b"SICK_LMS"


def device(model: str = "sick-lms291-s05", **table: object) -> Device:
    return FAMILY.new_session(table, {"model": model}).device


def ask(of: Device, text: str) -> tuple[Device, Answer]:
    data = bytes.fromhex(text)
    return answer(of, data[0], data[1:])


def after(of: Device, *texts: str) -> Device:
    for text in texts:
        of, reply = ask(of, text)
        assert reply.refusal is None, text
    return of


INSTALL = "20 00" + PASSWORD.hex()
MODES = {
    "on request": "20 25",
    "installation": INSTALL,
    "diagnosis": "20 10",
    "all values": "20 24",
    "means": "20 26 05",
    "sub-range": "20 27 01 00 05 00",
    "mean sub-range": "20 28 02 01 00 05 00",
    "partial": "20 2A",
    "intensity": "20 2B 01 00 01 00 05 00",
    "segments": "20 20",
    "segments with an object": "20 21",
    "vertical": "20 22",
    "vertical with an object": "20 23",
    "direct": "20 27 01 80 05 00",
    "field values": "20 29 01 00 05 00",
    "minima": "20 2C 01 01 00 05 00",
}
GOOD = {
    "10": ("91", 1),
    "20 00 53 49 43 4B 5F 4C 4D 53": ("A0 00", 2),
    "20 10": ("A0 00", 2),
    "20 24": ("A0 00", 2),
    "20 25": ("A0 00", 2),
    "20 26 FA": ("A0 00", 2),
    "20 27 01 00 69 01": ("A0 00", 2),
    "20 28 02 01 00 69 01": ("A0 00", 2),
    "20 2A": ("A0 00", 2),
    "20 2B 02 00 01 00 05 00 0A 00 14 00": ("A0 00", 2),
    "20 30 53 49 43 4B 5F 4C 4D 53": ("A0 00", 2),
    "20 40": ("A0 00", 2),
    "20 41": ("A0 00", 2),
    "20 42": ("A0 00", 2),
    "20 48": ("A0 00", 2),
    "31": ("B1", 153),
    "32": ("B2", 1),
    "35": ("B5", 5),
    "35 00 00": ("B5", 5),
    "3A": ("BA", 22),
    "3B B4 00 64 00": ("BB 01 B4 00 64 00", 6),
    "3B 64 00 19 00": ("BB 01 64 00 19 00", 6),
    "74": ("F4", 35),
    "20 20": ("A0 00", 2),
    "20 21": ("A0 00", 2),
    "20 22": ("A0 00", 2),
    "20 23": ("A0 00", 2),
    "20 27 01 80 69 01": ("A0 00", 2),
    "20 28 02 00 01 00 69 01": ("A0 00", 2),
    "20 29 01 00 64 00": ("A0 00", 2),
    "20 2C 02 01 00 69 01 05 00 05 00": ("A0 00", 2),
    "41 00": ("C1 01", 2),
    "41 02": ("C1 02", 2),
    "45 00": ("C5 01 42 00", 32),
    "45 02 02": ("C5 02 4E 00", 32),
    "69 32 01 00 00 B4 00": ("E9 01 32 00 00 B4 00", 7),
    "7B": ("FB", 85),
}
ONCE = (
    *("30 01", "30 02", "30 05 B4", "30 06", "30 07", "30 08", "36 05", "37 01 00 16 00", "37 01 80 16 00"),
    *("3E 01 00 16 00", "3F 05 01 00 16 00", "3F 05 00 01 00 16 00", "75 01 00 01 00 05 00", "76 01 00 16 00"),
)
INSTALLED = {
    "77 00 00": "F7 01",
    "66 01": "E6 01 01",
    "66 02": "E6 01 02",
    "7C 00": "FC 01",
    "40 01 01 B4 00 32 00 01 00 05 00": "C0 01 01 01",
    "42 00 00 53 49 43 4B 5F 4C 4D 32": "C2 02 00",
    "46 01 40 B4 00 32 00 00 05 00 00 00 00 00": "C6 03",
}


@pytest.mark.parametrize("mode", MODES)
def test_every_request_is_answered_in_every_mode(mode: str) -> None:
    before = after(device(), MODES[mode])
    for request_text, (start, length) in GOOD.items():
        _, reply = ask(before, request_text)
        assert reply.refusal is None, request_text
        assert reply.payload.startswith(bytes.fromhex(start)), request_text
        assert len(reply.payload) == length, request_text


@pytest.mark.parametrize("mode", MODES)
def test_values_are_given_once_in_every_mode_and_leave_it_as_it_is(mode: str) -> None:
    before = after(device(), MODES[mode])
    for request_text in ONCE:
        same, reply = ask(before, request_text)
        assert same == before, request_text
        assert reply.once is not None, request_text
        assert reply.once.command == int(request_text[:2], 16) | 0x80, request_text


@pytest.mark.parametrize("mode", MODES)
def test_writing_needs_installation_mode(mode: str) -> None:
    before = after(device(), MODES[mode])
    for text, start in INSTALLED.items():
        same, reply = ask(before, text)
        if mode == "installation":
            assert reply.refusal is None
            assert reply.payload.startswith(bytes.fromhex(start))
        else:
            assert (same, reply.payload, reply.refusal) == (before, b"\x92", DropReason.WRONG_MODE)


@pytest.mark.parametrize("mode", MODES)
def test_any_command_in_any_mode_is_answered_and_a_refusal_changes_nothing(mode: str) -> None:
    before = after(device(), MODES[mode])
    lengths = (b"\xff" * count for count in (4, 5, 6, 9, 10, 13, 14, 84, 807))
    for code, data in product(range(256), (b"", b"\x00", b"\x00\x00", *lengths)):
        same, reply = answer(before, code, data)
        assert reply.payload or reply.once
        if reply.payload[:1] == b"\x92":
            assert same == before
            assert reply.refusal is not None
            assert reply.detail
        else:
            assert code in COMMANDS


def test_any_sub_code_of_20_is_answered_and_a_refusal_keeps_the_mode() -> None:
    before = after(device(), "20 24")
    for sub, data in product(range(256), (b"", b"\x01", b"\x00" * 4, PASSWORD)):
        same, reply = answer(before, 0x20, bytes((sub,)) + data)
        assert reply.payload[:1] in (b"\x92", b"\xa0")
        if reply.refusal is not None:
            assert same == before


def test_what_the_listing_only_names_is_refused_by_name() -> None:
    assert not [code for code, row in COMMANDS.items() if row.coverage == "refused"]
    assert [code for code, row in SWITCHES.items() if row.coverage == "refused"] == [0x01, 0x2E]
    for sub in (0x01, 0x2E):
        _, reply = answer(device(), 0x20, bytes((sub,)))
        assert (reply.payload, reply.refusal) == (b"\x92", DropReason.REFUSED)
        assert SWITCHES[sub].name in reply.detail


@pytest.mark.parametrize("code", [0x33, 0x34, 0x3C, 0x3D, 0x00, 0xFF, 0x90])
def test_what_the_family_does_not_have_is_unknown(code: int) -> None:
    assert answer(device(), code, b"")[1].refusal is DropReason.UNKNOWN_COMMAND


@pytest.mark.parametrize(
    "text", ["31 00", "32 00", "35 00", "36", "37 01", "3A 01", "3B 64 00", "3F 01", "74 00", "10 00"]
)
def test_a_wrong_length_of_data_is_refused(text: str) -> None:
    assert ask(device(), text)[1].refusal is DropReason.BAD_LENGTH


@pytest.mark.parametrize(
    "text",
    [
        "20 26 01",
        "20 26 FB",
        "20 27 00 00 05 00",
        "20 27 05 00 04 00",
        "20 27 01 00 6A 01",
        "20 28 01 01 00 05 00",
        "20 28 05 00 00 05 00",
        "20 2B 00 00",
        "20 2B 06 00 01 00 02 00",
        "20 2B 02 00 01 00 02 00",
        "20 2B 01 00 01 00 69 01",
        "20 50 01 00 B5 00",
        "36 00",
        "37 01 00 70 01",
        "44 01 00 B5 00",
        "75 01 00 01 00 69 01",
    ],
)
def test_parameters_out_of_range_are_refused_and_the_mode_stays(text: str) -> None:
    before = after(device(), "20 24")
    same, reply = ask(before, text)
    assert (same, reply.refusal) == (before, DropReason.BAD_ARGUMENT)


def test_the_largest_group_of_ranges_and_intensities_fills_812_bytes() -> None:
    assert ask(device(), "20 2B 01 00 01 00 C7 00")[1].refusal is None
    assert ask(device(), "20 2B 01 00 01 00 C8 00")[1].refusal is DropReason.BAD_ARGUMENT


@pytest.mark.parametrize("password", [b"sick_lms", b"SICK_LM", b"SICK_LMS ", b"", b"SICK_LMS\x00"])
@pytest.mark.parametrize("sub", [b"\x00", b"\x30"])
def test_a_wrong_password_is_answered_with_01_and_changes_nothing(sub: bytes, password: bytes) -> None:
    before = after(device(), "20 24")
    same, reply = answer(before, 0x20, sub + password)
    assert (same, reply.payload) == (before, b"\xa0\x01")


def test_another_password_may_be_stored() -> None:
    made = device(password="ABCDEFGH")
    assert ask(made, INSTALL)[1].payload == b"\xa0\x01"
    assert ask(made, "20 00" + b"ABCDEFGH".hex())[1].payload == b"\xa0\x00"


@pytest.mark.parametrize("words", ["B4 00 19 00", "B4 00 00 00", "5A 00 32 00", "64 00 0A 00", "00 00 00 00"])
def test_a_variant_the_device_does_not_have_is_refused_with_the_one_it_keeps(words: str) -> None:
    before = after(device(), "3B 64 00 64 00")
    same, reply = ask(before, "3B " + words)
    assert (same, reply.payload) == (before, bytes.fromhex("BB 00 64 00 64 00"))


def test_an_s14_has_one_variant_and_tells_it() -> None:
    _, reply = ask(device("sick-lms221-s14"), "3B B4 00 32 00")
    assert reply.payload == bytes.fromhex("BB 00 5A 00 32 00")


def test_a_variant_taken_while_streaming_ends_the_stream() -> None:
    changed = after(device(), "20 24", "3B B4 00 64 00")
    assert (changed.mode, changed.stream) == (ON_REQUEST, None)


def test_a_variant_taken_in_installation_mode_leaves_that_mode() -> None:
    assert after(device(), INSTALL, "3B B4 00 64 00").mode == INSTALLATION


@pytest.mark.parametrize("count", [1, 2, 7, 32, 33, 34, 40])
@pytest.mark.parametrize("model", ["sick-lms291-s05", "sick-lms200-30106"])
def test_a_write_of_any_length_replaces_the_front_of_the_block(model: str, count: int) -> None:
    before = after(device(model), INSTALL)
    written = bytes.fromhex("01 00 70 00 06 01 01") + bytes(range(100, 133))
    changed, reply = answer(before, 0x77, written[:count])
    kept = len(before.configuration)
    assert changed.configuration == (written[:count] + before.configuration[count:])[:kept]
    assert reply.payload == b"\xf7\x01" + changed.configuration
    assert ask(changed, "74")[1].payload == b"\xf4" + changed.configuration


@pytest.mark.parametrize("block", ["00 00 46 00 00 07", "00 00 46 00 00 00 03", "00 00 46 04"])
def test_a_block_out_of_range_is_refused_with_the_one_it_keeps(block: str) -> None:
    before = after(device(), INSTALL)
    same, reply = ask(before, "77 " + block)
    assert (same, reply.payload) == (before, b"\xf7\x00" + before.configuration)


def test_the_peak_threshold_of_an_lms200_takes_any_value() -> None:
    assert after(device("sick-lms200-30106"), INSTALL, "77 00 00 46 C8").configuration[3] == 0xC8


def test_a_reserved_mode_is_not_rewritten_and_a_stored_byte_comes_back() -> None:
    changed = after(device(), INSTALL, "77 00 00 70 00 07 0D 02 01 01 7D 42")
    assert changed.configuration[:11].hex(" ") == "00 00 70 00 07 0d 02 01 01 7d 42"


def test_the_status_telegram_tells_the_present_state() -> None:
    made = device(unit="mm", measuring_mode=3, baud=38400, address=5, serial_number="87654321")
    made = after(made, "3B 64 00 19 00", "20 24")
    data = ask(made, "31")[1].payload[1:]
    assert len(data) == 152
    assert data[0:7] == b"X01.27 "
    assert data[7] == 0x24
    assert data[9:17] == b"87654321"
    assert data[101] == 3
    assert data[106:110] == bytes.fromhex("64 00 19 00")
    assert data[115:117] == bytes.fromhex("19 80")
    assert data[118:122] == bytes((1, 5, 1, 1))
    assert data[123:130] == b"X01.03 "


@pytest.mark.parametrize(("sub", "word"), [("48", "01 80"), ("40", "19 80"), ("41", "33 80"), ("42", "67 80")])
def test_the_status_telegram_has_the_listings_word_for_each_rate(sub: str, word: str) -> None:
    assert ask(after(device(), "20 " + sub), "31")[1].payload[116:118] == bytes.fromhex(word)


def test_a_rate_made_permanent_survives_and_can_be_taken_back() -> None:
    made = after(device(), "20 48", INSTALL, "66 01")
    assert (made.startup_baud, made.permanent_baud) == (500_000, True)
    assert ask(made, "31")[1].payload[119] == 1
    made = after(made, "66 00")
    assert (made.startup_baud, made.permanent_baud, made.baud) == (9600, False, 500_000)
    assert ask(made, "66 03")[1].payload == bytes.fromhex("E6 00 03")


def test_errors_and_counter_are_those_of_the_table() -> None:
    made = device(errors=[{"code": 18, "severity": 2}], operating_hours=2469, switch_ons=77)
    assert ask(made, "32")[1].payload == bytes.fromhex("B2 02 12")
    assert ask(made, "35 00 00")[1].payload == bytes.fromhex("B5 D2 04 4D 00")


def test_an_s14_sends_reflectivity_and_has_no_partial_scans() -> None:
    made = device("sick-lms291-s14")
    for text in ("20 50 01 00 B5 00", "44 0A 00 14 00"):
        assert ask(made, text)[1].refusal is None
    assert ask(made, "20 2A")[1].refusal is DropReason.REFUSED


def test_entering_a_mode_again_is_a_new_start() -> None:
    once = after(device(), "20 24")
    assert after(once, "20 24").stream_number == once.stream_number + 1


def test_the_coverage_table_has_every_command_once_with_a_source() -> None:
    rows = coverage_rows()
    assert len({row.code for row in rows}) == len(rows) == len(COMMANDS) + len(SWITCHES)
    for row in rows:
        assert row.status in ("done", "refused", "absent")
        assert row.source
        assert row.note or row.status != "refused"
    listed = {row.code for row in rows}
    for code in "10 30 31 32 35 36 37 3A 3B 3E 3F 40 41 42 44 45 46 4A 66 69 74 75 76 77 7B 7C".split():
        assert code in listed
    for sub in "00 01 02 10 20 21 22 23 24 25 26 27 28 29 2A 2B 2C 2E 30 40 41 42 48 50".split():
        assert f"20 {sub}" in listed


def test_a_status_byte_joins_the_model_s_bits_and_the_table_s() -> None:
    assert device().status == 0x10
    assert device("sick-lms291-s14").status == 0x18
    assert device(restart_input=True).status == 0x30
    assert device(pollution=True, implausible=True, severity=2).status == 0xD2
    assert replace(device(), mode=0).status == 0x10
