"""Telegrams of the maker's listing (8007954/Q501/2006-08-01), as printed or computed from its tables, on the wire.

`P`: printed there with this CRC. `C`: computed from its tables with its CRC. A conversation is what the host sends and
what the device answers behind its ACK, on an LMS291-S05 unless another model is named.
"""

from __future__ import annotations

import pytest

from protocols.lms2xx.telegrams import open_frame, read_values, request
from protocols.session import DropReason
from tests.protocols.lms2xx.rig import MS, Rig, wall

INSTALL = "02 00 0A 00 20 00 53 49 43 4B 5F 4C 4D 53 BE C5"
FACTORY_RADII = "32 00 " * 11

REQUESTS = {
    "30 02": "02 00 02 00 30 02 32 18",
    "30 03": "02 00 02 00 30 03 33 18",
    "30 06": "02 00 02 00 30 06 36 18",
    "30 07": "02 00 02 00 30 07 37 18",
    "30 08": "02 00 02 00 30 08 38 18",
    "20 02": "02 00 02 00 20 02 12 08",
    "20 10": "02 00 02 00 20 10 00 08",
    "20 20": "02 00 02 00 20 20 30 08",
    "20 21": "02 00 02 00 20 21 31 08",
    "20 22": "02 00 02 00 20 22 32 08",
    "20 23": "02 00 02 00 20 23 33 08",
    "20 2E": "02 00 02 00 20 2E 3E 08",
    "20 27 1B 00 2B 01": "02 00 06 00 20 27 1B 00 2B 01 FF FE",
    "20 27 01 80 B5 00": "02 00 06 00 20 27 01 80 B5 00 17 8B",
    "20 28 02 01 00 2A 01": "02 00 07 00 20 28 02 01 00 2A 01 78 BC",
    "20 29 01 00 0A 00": "02 00 06 00 20 29 01 00 0A 00 8C C7",
    "20 2C 02 01 00 B5 00 B6 00 69 01": "02 00 0B 00 20 2C 02 01 00 B5 00 B6 00 69 01 48 D9",
    "35": "02 00 01 00 35 11 12",
    "35 00 00": "02 00 03 00 35 00 00 64 32",
    "37 01 80 69 01": "02 00 05 00 37 01 80 69 01 EE F7",
    "3E 01 00 01 00": "02 00 05 00 3E 01 00 01 00 AA 55",
    "41 00": "02 00 02 00 41 00 D2 69",
    "45 01 00": "02 00 03 00 45 01 00 A6 D2",
    "4A": "02 00 01 00 4A 6E 12",
    "69": "02 00 0F 00 69 64 01 02 00 05 00 0A 00 14 00 19 00 2D 00 20 76",
    "76": "02 00 05 00 76 01 00 03 00 21 93",
    "7B": "02 00 01 00 7B 5F 12",
}

ANSWERS = [
    # counter: P
    ("02 00 01 00 35 11 12", "02 80 06 00 B5 00 00 01 00 10 04 42"),
    # active set: P, C
    ("02 00 02 00 41 00 D2 69", "02 80 03 00 C1 01 10 90 C8"),
    ("02 00 02 00 41 02 D0 69", "02 80 03 00 C1 02 10 96 CB"),
    # factory field 1 A: C
    (
        "02 00 03 00 45 01 00 A6 D2",
        "02 80 21 00 C5 01 42 00 B4 00 32 00 00 0A " + FACTORY_RADII + "10 D5 E4",
    ),
    # outputs, all free: P
    ("02 00 01 00 4A 6E 12", "02 80 05 00 CA 01 01 01 10 2C B8"),
    # positioning aid: P, C
    (
        "02 00 0F 00 69 64 01 02 00 05 00 0A 00 14 00 19 00 2D 00 20 76",
        "02 80 08 00 E9 01 64 02 00 05 00 10 E0 44",
    ),
    # block 2: P
    ("02 00 01 00 7B 5F 12", "02 80 56 00 FB " + "00 " * 84 + "10 AE F0"),
    # no errors: P
    ("02 00 01 00 32 16 12", "02 80 02 00 B2 10 3F 13"),
]

INSTALLED = [
    # rectangle, radius and segments: C
    (
        "02 00 0F 00 40 01 40 B4 00 32 00 00 00 D0 07 D0 07 B8 0B E8 8C",
        "02 80 11 00 C0 01 01 40 B4 00 32 00 00 00 D0 07 D0 07 B8 0B 10 57 96",
    ),
    (
        "02 00 0B 00 40 01 41 B4 00 32 00 01 00 B8 0B 47 31",
        "02 80 0D 00 C0 01 01 41 B4 00 32 00 01 00 B8 0B 10 44 91",
    ),
    (
        "02 00 20 00 40 01 40 B4 00 32 00 02 00 0A " + FACTORY_RADII + "A9 D2",
        "02 80 22 00 C0 01 01 40 B4 00 32 00 02 00 0A " + FACTORY_RADII + "10 76 ED",
    ),
    # permanent rate off, on, variant: P, C
    ("02 00 02 00 66 00 9C 4E", "02 80 04 00 E6 01 00 10 CD FC"),
    ("02 00 02 00 66 01 9D 4E", "02 80 04 00 E6 01 01 10 CF FD"),
    # teaching begins: P; its answer: C
    ("02 00 0E 00 46 01 40 B4 00 32 00 00 05 00 00 00 00 00 CF FF", "02 80 03 00 C6 03 10 88 C4"),
    # first step of a new password: C
    ("02 00 0B 00 42 00 00 53 49 43 4B 5F 4C 4D 32 62 2E", "02 80 04 00 C2 02 00 10 E1 6B"),
    # block 2, defaults, short form, offset of set 2: P, P, C
    ("02 00 55 00 7C " + "00 " * 84 + "0E 9E", "02 80 57 00 FC 01 " + "00 " * 84 + "10 CA 83"),
    ("02 00 05 00 7C 00 00 00 00 8F C4", "02 80 57 00 FC 01 " + "00 " * 84 + "10 CA 83"),
    # the block of the listing's example: P
    (
        "02 00 23 00 77 00 00 70 00 00 00 01 00 00 02 02 " + "00 " * 21 + "02 00 11 88",
        "02 80 25 00 F7 01 00 00 70 00 00 00 01 00 00 02 02 " + "00 " * 21 + "02 00 10 C5 7A",
    ),
]


def answer_to(rig: Rig, text: str, timeout_s: float = 3.0) -> bytes:
    """The telegram behind the ACK, whole."""
    begin = len(rig.emissions)
    rig.write(bytes.fromhex(text))
    rig.wait(timeout_s)
    replies = [one for one in rig.emissions[begin:] if one.payload]
    assert replies[0].payload == b"\x06"
    rig.flush_input()
    return replies[1].payload


@pytest.mark.parametrize("payload", REQUESTS)
def test_requests_are_the_listing_s(payload: str) -> None:
    data = bytes.fromhex(REQUESTS[payload])
    telegram = open_frame(data)
    assert telegram is not None
    assert request(bytes((telegram.command,)) + telegram.data) == data
    assert data[4:-2].startswith(bytes.fromhex(payload))


@pytest.mark.parametrize(("asked", "answered"), ANSWERS)
def test_answers_are_the_listing_s(asked: str, answered: str) -> None:
    assert answer_to(Rig.on(), asked) == bytes.fromhex(answered)


@pytest.mark.parametrize(("asked", "answered"), INSTALLED)
def test_what_is_written_in_installation_mode_is_answered_as_printed(asked: str, answered: str) -> None:
    rig = Rig.on()
    assert answer_to(rig, INSTALL)[4] == 0xA0
    assert answer_to(rig, asked) == bytes.fromhex(answered)


@pytest.mark.parametrize("asked", [asked for asked, _ in INSTALLED])
def test_the_same_outside_installation_mode_is_answered_with_92_and_changes_nothing(asked: str) -> None:
    rig = Rig.on()
    before = rig.session.device
    assert answer_to(rig, asked) == bytes.fromhex("02 80 02 00 92 10 5F 12") or answer_to(rig, asked)[4] == 0x92
    assert rig.session.device == before
    assert rig.dropped()[0] is DropReason.WRONG_MODE


def test_a_field_that_the_listing_s_own_example_misprints_is_refused_with_c0_00() -> None:
    rig = Rig.on()
    answer_to(rig, INSTALL)
    asked = "02 00 14 00 40 01 40 34 00 32 00 02 00 05 E8 03 D0 07 B8 0B A0 0F 88 13 EC 72"
    found = answer_to(rig, asked)
    assert found[4:6] == b"\xc0\x00"
    assert found[6:-3] == bytes.fromhex(asked)[5:-2]


def test_a_new_password_counts_after_its_confirmation_and_goes_back_from_diagnosis() -> None:
    rig = Rig.on()
    answer_to(rig, INSTALL)
    answer_to(rig, "02 00 0B 00 42 00 00 53 49 43 4B 5F 4C 4D 32 62 2E")
    found = answer_to(rig, "02 00 0B 00 42 01 00 53 49 43 4B 5F 4C 4D 32 67 AC")
    assert found == bytes.fromhex("02 80 04 00 C2 01 00 10 ED 6D")
    assert rig.session.device.password == b"SICK_LM2"
    assert answer_to(rig, INSTALL)[5] == 1, "the old one is wrong now"
    assert answer_to(rig, "02 00 02 00 20 02 12 08")[4] == 0x92, "diagnosis first"
    assert answer_to(rig, "02 00 02 00 20 10 00 08")[4:6] == b"\xa0\x00"
    assert answer_to(rig, "02 00 02 00 20 02 12 08")[4:6] == b"\xa0\x00"
    assert answer_to(rig, INSTALL)[5] == 0


@pytest.mark.parametrize("second", ["42 01 00 53 49 43 4B 5F 4C 4D 33", "42 01 01 53 49 43 4B 5F 4C 4D 32"])
def test_another_confirmation_leaves_the_old_password(second: str) -> None:
    rig = Rig.on()
    answer_to(rig, INSTALL)
    assert rig.reply_to(second)[1:3] == b"\xc2\x00", "without a first step"
    rig.reply_to("42 00 00 53 49 43 4B 5F 4C 4D 32")
    assert rig.reply_to(second)[1:3] == b"\xc2\x00"
    assert rig.reply_to("42 01 00 53 49 43 4B 5F 4C 4D 32")[1:3] == b"\xc2\x00", "the first step is forgotten"
    assert rig.session.device.password == b"SICK_LMS"


def test_the_variant_made_permanent_is_there_after_a_reset() -> None:
    rig = Rig.on()
    rig.reply_to("3B 64 00 19 00")
    answer_to(rig, INSTALL)
    assert answer_to(rig, "02 00 02 00 66 02 9E 4E")[4:7] == b"\xe6\x01\x02"
    rig.ask("10")
    assert rig.await_reply(0x90, 5.0) is not None
    assert rig.reply_to("31")[1 + 1 + 106 : 1 + 1 + 110] == bytes.fromhex("64 00 19 00")


def test_a_reset_clears_the_stored_errors() -> None:
    rig = Rig.on(errors=[{"code": 49, "severity": 1, "present": False}, {"code": 18, "severity": 2}])
    assert answer_to(rig, "02 00 01 00 32 16 12") == bytes.fromhex("02 80 06 00 B2 81 31 02 12 10 4F 63")
    rig.ask("10")
    assert rig.await_reply(0x90, 5.0) is not None
    assert rig.reply_to("32") == bytes.fromhex("06 B2 10")


@pytest.mark.parametrize("model", ["sick-lms200-30106", "sick-lms220-30106"])
def test_indoor_models_have_no_counter(model: str) -> None:
    assert Rig.on(model).reply_to("35") == bytes.fromhex("06 92 10")


def test_the_default_block_of_an_lms200_is_the_listing_s() -> None:
    block = (
        "00 00 46 00 00 00 01 00 00 02 02 02 00 00 0A 0A 50 64 00 0A 0A 50 64 00 0A 0A 50 64 00 00 00 00 02 00 10 0A 2F"
    )
    found = answer_to(Rig.on("sick-lms200-30106"), "02 00 01 00 74 50 12")
    assert found == bytes.fromhex("02 80 24 00 F4 " + block)


def test_status_data_of_a_healthy_device_are_the_listing_s() -> None:
    data = Rig.on("sick-lms211-s19").reply_to("31")[2:]
    assert data[66:68] == bytes((148, 0)), "microseconds of 1/90 turn"
    assert (data[82], data[122], data[17], data[120]) == (100, 1, 1, 1)
    assert Rig.on("sick-lms291-s14").reply_to("31")[2 + 17] == 0


@pytest.mark.parametrize("text", ["3E 01 00 02 00", "41 00", "45 01 00", "75 01 00 01 00 02 00", "76 01 00 02 00"])
@pytest.mark.parametrize("stream", ["20 24", "20 25"])
def test_an_s14_has_nothing_that_needs_fields(text: str, stream: str) -> None:
    rig = Rig.on("sick-lms291-s14")
    rig.reply_to(stream)
    before = rig.session.device
    rig.flush_input()
    assert rig.reply_to(text, 4.0)[-2:] == b"\x92\x18"
    assert rig.session.device == before


# --- values ---


def values_of(rig: Rig, text: str, command: int = 0xB0) -> list[int]:
    rig.ask(text)
    telegram = rig.await_reply(command, 3.0)
    assert telegram is not None
    values = read_values(telegram)
    assert values is not None
    return values.values.tolist()


@pytest.mark.parametrize(("variant", "every", "count"), [("64 00 19 00", 6, 201), ("B4 00 32 00", 7, 19)])
def test_every_second_and_every_twentieth_value(variant: str, every: int, count: int) -> None:
    rig = Rig.on()
    rig.reply_to(f"3B {variant}")
    assert values_of(rig, f"30 {every:02X}") == [1234] * count


def test_a_partial_scan_once_is_that_of_its_turn() -> None:
    rig = Rig.on(baud=500_000)
    rig.set_speed(500_000)
    seen = set()
    for _ in range(12):
        rig.ask("30 08")
        telegram = rig.await_reply(0xB0, 1.0)
        assert telegram is not None
        values = read_values(telegram)
        assert values is not None
        assert values.header.partial == rig.scans()[-1].sweep % 4  # type: ignore[operator]
        assert values.header.count == (181 if values.header.partial == 0 else 180)
        seen.add(values.header.partial)
        rig.wait(0.013)
    assert len(seen) > 1


def test_a_single_direct_sub_range_comes_in_one_telegram_a_turn() -> None:
    rig = Rig.on(baud=500_000, unit="mm", measure=wall(2.0))
    rig.set_speed(500_000)
    rig.reply_to("3B 64 00 19 00")
    rig.ask("37 03 80 0C 00")
    rig.wait(0.5)
    found = [read_values(open_frame(scan.payload)) for scan in rig.scans()]  # type: ignore[arg-type]
    assert [(one.first, one.header.partial, one.header.count) for one in found if one] == [
        (3, 0, 2),
        (3, 1, 2),
        (3, 2, 3),
        (3, 3, 3),
    ]
    gaps = [b.due_ns - a.due_ns for a, b in zip(rig.scans(), rig.scans()[1:], strict=False)]
    assert gaps == pytest.approx([40 / 3 * MS] * 3, abs=1)
    words = open_frame(rig.scans()[0].payload)
    assert words is not None
    assert words.data[4:6] == bytes((0x02, 0x60)), "count 2, bit 13, x.00, mm"


def test_a_direct_stream_goes_through_the_turns_of_a_scan_at_any_line_speed() -> None:
    rig = Rig.on(baud=38400)
    rig.set_speed(38400)
    rig.ask("20 27 01 80 69 01")
    rig.wait(2.0)
    found = [read_values(open_frame(scan.payload)) for scan in rig.scans()]  # type: ignore[arg-type]
    assert [(one.header.partial, one.header.count) for one in found[:4] if one] == [(0, 181), (2, 180)] * 2
    assert [scan.sweep % 2 for scan in rig.scans()[:4]] == [0, 1, 0, 1], "measured in the turn that has these beams"  # type: ignore[operator]
