"""Frames and tables of the maker's listing (SICK 8011576, 2006; page numbers in brackets), word by word.

Frames are those of its layouts with their XOR computed; packages and CAN frames are printed there.
"""

from __future__ import annotations

import pytest

from protocols.ld import FAMILY
from protocols.ld.routing import SERIAL_BUFFER
from protocols.ld.telegrams import Motor
from protocols.session import Address, DropReason, LinkKind
from tests.protocols.ld.reader import package, read_frames, read_packages, request, words
from tests.protocols.ld.rig import MS, SECOND, Rig, measuring

TCP, OTHER, LINE, BUS = Address(0, 1), Address(0, 2), Address(1, 0), Address(2, 0)


def frame(text: str) -> bytes:
    return bytes.fromhex("02 55 53 50 00 00 00 " + text)


def wide(**device: object) -> Rig:
    """A device with a TCP host, a serial line and a bus."""
    rig = Rig({"delays": "fast", **device})
    rig.session.connected(0, OTHER, LinkKind.STREAM)
    rig.session.connected(0, LINE, LinkKind.SERIAL)
    rig.session.connected(0, BUS, LinkKind.CAN)
    rig.run(0)
    rig.take()
    return rig


FRAMES = [
    # [44], [21], [23], [24], [28], [31], [17], [34]
    ("idle", "02 01 03 02", "0a ff 00 00 00 00 00 00 00 00 01 fe"),
    ("measure", "02 04 02 06", "0a ff 00 00 00 00 00 00 00 00 03 fc"),
    ("idle", "04 02 02 00 12 12", "04 82 02 ff ff 80"),
    ("idle", "06 02 09 00 01 00 01 0b", "06 82 09 00 01 00 01 8b"),
    ("idle", "06 02 09 00 02 00 01 08", "04 82 09 ff ff 8b"),
    ("idle", "04 02 0a 00 01 09", "08 82 0a ff ff ff ff ff ff 88"),
    ("idle", "04 02 0b 00 08 01", "08 82 0b ff ff ff ff ff ff 89"),
    ("measure", "06 03 01 00 01 00 00 03", "02 83 01 82"),
    ("measure", "02 03 01 02", "02 83 01 82"),
    ("idle", "04 01 05 01 00 05", "04 81 05 ff ff 84"),
    ("rotate", "04 04 03 00 03 04", "06 84 03 00 00 00 01 86"),
    # COM_ATTACH, COM_DETACH, COM_INIT, COM_OUTPUT [35-39]
    ("idle", "04 06 01 00 01 06", "06 86 01 00 01 00 00 86"),
    ("idle", "04 06 01 00 03 04", "06 86 01 00 03 ff ff 84"),
    # DIR, LOAD, DELETE [41, 42], MONITOR [43]
    ("idle", "04 07 03 01 00 05", "06 87 03 01 00 00 01 84"),
    ("idle", "04 07 04 01 00 02", "04 87 04 00 01 82"),
    ("idle", "04 08 01 00 01 08", "04 88 01 00 00 89"),
    ("idle", "04 08 02 00 01 0b", "04 88 02 00 00 8a"),
]


@pytest.mark.parametrize(("mode", "asked", "reported"), FRAMES)
def test_a_frame_of_the_listing_gets_the_listing_s_reply(mode: str, asked: str, reported: str) -> None:
    rig = Rig({"mode": mode, "delays": "fast"})
    rig.put(frame(asked))
    rig.run(SECOND)
    assert b"".join(emission.payload for emission in rig.take()) == frame(reported)


CONVERSATIONS = [
    [  # serial line taken over [35-39]
        ("04 06 01 00 01 06", "06 86 01 00 01 00 00 86"),
        ("0c 06 03 00 01 00 02 00 00 00 01 00 08 0f", "06 86 03 00 01 00 00 84"),
        ("08 06 04 00 01 00 48 00 69 22", "06 86 04 00 01 00 00 83"),
        ("04 06 02 00 01 05", "06 86 02 00 01 00 00 85"),
        ("04 06 02 00 01 05", "06 86 02 00 01 ff ff 85"),
    ],
    [  # CAN taken over
        ("04 06 01 00 02 05", "06 86 01 00 02 00 00 85"),
        ("0e 06 03 00 02 00 06 00 00 00 00 00 00 07 ff f9", "06 86 03 00 02 00 00 87"),
        ("10 06 04 00 02 00 01 00 00 01 23 00 03 11 22 33 00 20", "06 86 04 00 02 00 00 80"),
    ],
    [  # files [41-42]
        ("02 07 01 06", "04 87 01 80 00 06"),
        ("08 07 02 01 00 12 34 56 78 0c", "06 87 02 01 00 00 00 84"),
        ("08 07 02 01 00 12 34 56 78 0c", "06 87 02 01 00 00 02 86"),
        ("02 07 01 06", "06 87 01 7f fc 01 00 04"),
        ("04 07 03 01 00 05", "0a 87 03 01 00 00 00 12 34 56 78 8d"),
        ("04 07 04 01 00 02", "04 87 04 00 00 83"),
        ("04 07 04 01 00 02", "04 87 04 00 01 82"),
    ],
]


@pytest.mark.parametrize("talk", CONVERSATIONS)
def test_a_conversation_of_the_listing_runs_as_printed(talk: list[tuple[str, str]]) -> None:
    rig = wide()
    for asked, reported in talk:
        rig.put(frame(asked))
        rig.run(20 * MS)
        assert b"".join(emission.payload for emission in rig.take(TCP)) == frame(reported)


# --- services by state [46-47] ---

EVERYWHERE = {0x0101, 0x0102, 0x0104, 0x0105, 0x0205, 0x0209, 0x0401, 0x0403, 0x0604, 0x0801, 0x0802}
IDLE_ONLY = {0x0106, 0x0201, 0x0202, 0x0601, 0x0602, 0x0603, 0x0701, 0x0702, 0x0703, 0x0704}
NOT_MEASURING = {0x0203, 0x0204, 0x020A, 0x020B, 0x0402}
SERVED = {
    "idle": EVERYWHERE | IDLE_ONLY | NOT_MEASURING,
    "rotate": EVERYWHERE | NOT_MEASURING | {0x0404},
    "measure": EVERYWHERE | {0x0301, 0x0302, 0x0404},
}
SERVICES = [group << 8 | number for group in range(1, 9) for number in range(1, 12)]
DATA = {0x0401: [2], 0x0301: [1, 0x0100]}


@pytest.mark.parametrize("mode", SERVED)
def test_each_service_is_served_in_the_states_that_the_listing_gives_it(mode: str) -> None:
    for service in SERVICES:
        rig, which = Rig({"mode": mode, "delays": "fast"}), f"{service:04X}"
        rig.run(0)
        before = (rig.session.device.mode, rig.session.device.config, rig.session.device.sectors)
        reply = words(rig.ask(service, *DATA.get(service, [0, 0, 0, 0])))
        if service in SERVED[mode]:
            assert reply[0] == service | 0x8000, which
        else:
            assert reply == [0xFF00, 0, 0, 0, {"idle": 1, "rotate": 2, "measure": 3}[mode]], which
            assert (rig.session.device.mode, rig.session.device.config, rig.session.device.sectors) == before, which
            assert rig.dropped(), which


def test_a_liberal_device_serves_what_makes_sense_in_any_state() -> None:
    rig = measuring({"services": "liberal"})
    assert words(rig.ask(0x0202, 0x0001))[:2] == [0x8202, 1]
    assert words(rig.ask(0x0402)) == [0x8402, 0, 1]
    assert words(rig.ask(0x0302)) == [0x8302, 0, 1]


def test_a_device_in_error_still_tells_and_can_be_set_up() -> None:
    rig = Rig({"mode": "rotate"})
    rig.session.fail_motor(0, Motor.STOPPED)
    assert words(rig.ask(0x0202, 0x0010))[0] == 0x8202
    assert words(rig.ask(0x0301, 0, 0x0100))[0] == 0xFF00


# --- identification and application [16, 18] ---


def test_an_unknown_item_of_identification_is_told_as_item_0() -> None:
    rig = Rig({"identity": {"sensor_part_number": "1018028"}})
    assert rig.ask(0x0101, 0x0777) == rig.ask(0x0101, 0)
    assert rig.ask(0x0101) == rig.ask(0x0101, 0)


def test_an_application_that_registers_is_told_until_the_next_start() -> None:
    rig = Rig({"delays": "fast"})
    texts = ("12345678", "ANTENNA", "V9.99")
    data = [word for text in texts for word in words(text.encode().ljust(12, b"\0"))]
    assert words(rig.ask(0x0106, *data)) == [0x8106, 0]
    for item, text in zip((0x20, 0x21, 0x22), texts, strict=True):
        assert rig.ask(0x0101, item)[2:14].rstrip(b"\0").decode() == text
    assert words(rig.ask(0x0106, *data[:-1])) == [0x8106, 0xFFFF]
    assert words(rig.ask(0x0106, *[0xFFFF] * 18)) == [0x8106, 0xFFFF]
    rig.session.power_on(rig.now_ns)
    rig.run(SECOND)
    assert rig.ask(0x0101, 0x21)[2:14].rstrip(b"\0") == b"LD-APP"


# --- files ---


def test_files_outlast_power_off_and_are_listed_by_number() -> None:
    rig = Rig({"delays": "fast"})
    for number in (0x0300, 0x0101, 0xFFFF):
        assert words(rig.ask(0x0702, number, 1, 2, 3)) == [0x8702, number, 0]
    rig.session.power_on(rig.now_ns)
    rig.run(SECOND)
    assert words(rig.ask(0x0701)) == [0x8701, 32768 - 15, 0x0101, 0x0300, 0xFFFF]
    assert words(rig.ask(0x0703, 0xFFFF)) == [0x8703, 0xFFFF, 0, 1, 2, 3]


def test_files_that_cannot_be_are_refused_by_their_status() -> None:
    rig = Rig({"delays": "fast"})
    assert words(rig.ask(0x0702, 0x00FF, 1)) == [0x8702, 0x00FF, 4]
    assert words(rig.ask(0x0702, 0x0100)) == [0x8702, 0x0100, 4]
    assert words(rig.ask(0x0702)) == [0x8702, 0, 4]
    assert words(rig.ask(0x0703, 0x00FF)) == [0x8703, 0x00FF, 2]
    assert words(rig.ask(0x0703)) == [0x8703, 0, 2]
    assert words(rig.ask(0x0704, 0x00FF)) == [0x8704, 3]
    assert words(rig.ask(0x0704)) == [0x8704, 3]


def test_flash_is_full_at_32768_words() -> None:
    rig = Rig({"delays": "fast"})
    for number in range(16):
        assert words(rig.ask(0x0702, 0x0100 + number, *[7] * 2000)) == [0x8702, 0x0100 + number, 0]
    assert words(rig.ask(0x0701))[1] == 32768 - 16 * 2002
    assert words(rig.ask(0x0702, 0x0200, *[7] * 735)) == [0x8702, 0x0200, 1]
    assert words(rig.ask(0x0702, 0x0200, *[7] * 734)) == [0x8702, 0x0200, 0]
    assert words(rig.ask(0x0701))[1] == 0


# --- routing ---


def test_a_line_that_is_attached_carries_characters_both_ways_and_no_services() -> None:
    rig = wide()
    rig.ask(0x0601, 1)
    rig.put(frame("08 06 04 00 01 00 48 00 69 22"))
    rig.run(5 * MS)
    assert [emission.payload for emission in rig.take(LINE)] == [b"Hi"]
    assert rig.take(TCP)
    rig.put(b"Hi", LINE)
    sent_ns = rig.now_ns
    rig.run(SECOND)
    (reported,) = rig.take(TCP)
    (payload,) = read_frames(reported.payload)
    assert words(payload) == [0x0605, 1, sent_ns // MS & 0xFFFF, 0x48, 0x69]
    rig.put(package(0x1410, 3, 0, 0x0102), LINE)
    rig.run(SECOND)
    assert not rig.take(LINE), "it serves the protocol no more"
    rig.take(TCP)
    rig.ask(0x0602, 1)
    rig.put(package(0x1410, 3, 0, 0x0102), LINE)
    rig.run(SECOND)
    assert [read_packages(emission.payload) for emission in rig.take(LINE)] == [[(0x1014, [0x8102, 0, 1])]]


def test_a_full_buffer_of_characters_is_sent_at_once() -> None:
    rig = wide()
    rig.ask(0x0601, 1)
    rig.put(b"x" * (SERIAL_BUFFER + 3), LINE)
    rig.run(SECOND)
    first, rest = rig.take(TCP)
    assert len(words(read_frames(first.payload)[0])) == 3 + SERIAL_BUFFER
    assert words(read_frames(rest.payload)[0])[3:] == [ord("x")] * 3


def test_com_init_sets_the_line_and_detaching_sets_it_back() -> None:
    rig = wide()
    rig.ask(0x0601, 1)
    for asked, reported in (
        ([1, 2, 0, 1, 8], 0),
        ([1, 0, 0, 1, 8], 0xFFFF),
        ([1, 2, 3, 1, 8], 0xFFFF),
        ([1, 2], 0xFFFF),
    ):
        assert words(rig.ask(0x0603, *asked)) == [0x8603, 1, reported]
    assert [emission.line_speed for emission in rig.take(LINE)] == [9600]
    rig.ask(0x0602, 1)
    rig.run(0)
    assert [emission.line_speed for emission in rig.take(LINE)] == [115200]


def test_an_interface_has_one_holder_who_is_not_itself() -> None:
    rig = wide()
    assert words(rig.ask(0x0604, 1, 0x48)) == [0x8604, 1, 0xFFFF], "not attached"
    rig.ask(0x0601, 1)
    assert words(rig.ask(0x0601, 1)) == [0x8601, 1, 0], "once more by the same"
    assert words(rig.ask(0x0601, 1, address=OTHER)) == [0x8601, 1, 0xFFFF]
    assert words(rig.ask(0x0604, 1, 0x48, address=OTHER)) == [0x8604, 1, 0xFFFF]
    assert words(rig.ask(0x0602, 1, address=OTHER)) == [0x8602, 1, 0xFFFF]
    rig.session.disconnected(rig.now_ns, TCP)
    assert words(rig.ask(0x0601, 1, address=OTHER)) == [0x8601, 1, 0], "a host that has gone holds nothing"
    alone = Rig({"delays": "fast"}, kind=LinkKind.SERIAL, address=Address(0, 0))
    alone.put(package(0x1410, 4, 0, 0x0601, 1))
    alone.run(SECOND)
    assert read_packages(alone.take()[-1].payload) == [(0x1014, [0x8601, 1, 0xFFFF])]


def test_messages_of_an_attached_bus_pass_the_filter_both_ways() -> None:
    rig = wide()
    rig.ask(0x0601, 2)
    rig.ask(0x0604, 2, 2, 0, 0x123, 3, 0x1122, 0x3300, 0x8ABC, 0xDEF0, 0)
    rig.run(0)
    sent = [(emission.address.peer, emission.payload.hex()) for emission in rig.take() if emission.address]
    assert sent == [(0x123, "112233"), (0x8ABCDEF0 & 0x1FFFFFFF | 1 << 31, "")]
    rig.put(bytes.fromhex("112233"), Address(2, 0x123))
    rig.run(0)
    assert words(rig.next_payload(SECOND))[:2] == [0x0605, 2]
    rig.ask(0x0603, 2, 6, 0, 0x120, 0, 0x00F)
    rig.put(bytes.fromhex("112233"), Address(2, 0x12A))
    assert words(rig.next_payload(SECOND))[3:] == [0, 0x12A, 3, 0x1122, 0x3300]
    for peer in (0x130, 0x120 | 1 << 31):
        rig.put(b"", Address(2, peer))
    rig.run(SECOND)
    assert not rig.take(TCP)
    rig.ask(0x0603, 2, 6, 0x8ABC, 0, 0x1FFF, 0xFFFF)
    rig.put(b"\x01", Address(2, 0x1FFFFFFF | 1 << 31))
    assert words(rig.next_payload(SECOND))[3:] == [0x9FFF, 0xFFFF, 1, 0x0100]


@pytest.mark.parametrize("output", [[], [0], [129], [1], [1, 0, 1, 9, 0, 0, 0, 0, 0], [2, 0, 1, 0], [1, 0, 1, 4, 0]])
def test_an_output_of_messages_that_is_none_is_refused(output: list[int]) -> None:
    rig = wide()
    rig.ask(0x0601, 2)
    assert words(rig.ask(0x0604, 2, *output)) == [0x8604, 2, 0xFFFF]
    assert rig.dropped() == [DropReason.BAD_ARGUMENT]


def test_a_restart_gives_every_interface_back() -> None:
    rig = wide()
    rig.ask(0x0601, 1)
    rig.ask(0x0603, 1, 2, 0, 1, 8)
    rig.ask(0x0401, 1)
    rig.run(SECOND)
    assert not rig.session.device.attached
    assert [emission.line_speed for emission in rig.take(LINE)] == [9600, 115200]


# --- monitor ---


def test_a_monitor_gets_a_copy_of_each_profile_in_the_host_s_format() -> None:
    rig = measuring()
    rig.session.connected(0, LINE, LinkKind.SERIAL)
    rig.put(package(0x1410, 4, 0, 0x0801, 1) + package(0x1410, 4, 0, 0x0802, 1), LINE)
    rig.run(50 * MS)
    rig.take()
    assert words(rig.ask(0x0801, 1)) == [0x8801, 0xFFFF], "another interface has it"
    assert words(rig.ask(0x0802, 0)) == [0x8802, 0xFFFF]
    rig.put(request(0x0301, 3, 0x0002))
    rig.run(450 * MS)
    mine = [words(read_frames(emission.payload)[0]) for emission in rig.take(TCP)]
    copies = [read_packages(emission.payload)[0][1] for emission in rig.take(LINE)]
    assert len(mine) == 3
    assert copies == mine
    rig.put(package(0x1410, 4, 0, 0x0801, 0), LINE)
    rig.run(50 * MS)
    rig.take()
    rig.put(request(0x0301, 1, 0x0002))
    rig.run(450 * MS)
    assert not rig.take(LINE)
    rig.take()
    assert words(rig.ask(0x0801, 1)) == [0x8801, 0], "free again"


# --- models (supplement 9106698, p. 5, 22) ---


@pytest.mark.parametrize(
    ("model", "arc", "points"),
    [("sick-ld-lrs1000", 360, 720), ("sick-ld-lrs2100", 300, 601), ("sick-ld-lrs3100", 300, 601)],
)
def test_each_model_names_itself_and_measures_its_own_arc(model: str, arc: int, points: int) -> None:
    rig = measuring(facts={"model": model})
    assert rig.ask(0x0101, 1)[2:14].rstrip(b"\0").decode() == model.removeprefix("sick-").upper()
    rig.put(request(0x0301, 1, 0x0100))
    rig.run(250 * MS)
    assert len(rig.plans[-1]) == points
    assert FAMILY.new_session({"motor_hz": 10}, {"model": model}).device.model.useful_deg == arc
