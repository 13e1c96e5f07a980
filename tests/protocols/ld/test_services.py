"""What each service answers: published bytes, refusals, and that a refusal leaves the device as it was."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from protocols import family
from protocols.errors import ProtocolError
from protocols.ld import FAMILY, services
from protocols.ld.models import IDENTITIES
from protocols.ld.services import COMMANDS, Command, check_table
from protocols.ld.telegrams import Mode, Motor
from protocols.session import DropReason
from tests.protocols.ld.reader import read_frames, request, words
from tests.protocols.ld.rig import FACTS, MS, SECOND, Rig, measuring


def ask(rig: Rig, *message: int) -> list[int]:
    return words(rig.ask(*message))


# published bytes: request, reply (recomputed in the protocol's description; many seen by running sicktoolbox)

QUARTER = {"step_deg": 0.25, "sectors": [{"from_deg": 0, "to_deg": 180}]}
PUBLISHED = [
    ({}, "02 55 53 50 00 00 00 02 01 02 03", "02 55 53 50 00 00 00 06 81 02 00 00 00 01 82"),
    ({"mode": "measure"}, "02 55 53 50 00 00 00 02 01 02 03", "02 55 53 50 00 00 00 06 81 02 00 00 00 03 80"),
    (
        {}, "02 55 53 50 00 00 00 04 01 01 00 01 01",
        "02 55 53 50 00 00 00 12 81 01 4c 44 2d 4c 52 53 31 30 30 30 00 00 00 00 00 01 e8",
    ),
    (
        {}, "02 55 53 50 00 00 00 04 02 02 00 05 05",
        "02 55 53 50 00 00 00 20 82 02 00 05 00 c0 00 a8 00 01 00 0a 00 ff 00 ff 00 ff"
        "00 00 00 00 00 00 00 00 00 00 00 01 c0 00 d8",
    ),
    (QUARTER, "02 55 53 50 00 00 00 04 02 02 00 10 10", "02 55 53 50 00 00 00 0a 82 02 00 10 00 10 00 0a 00 04 8e"),
    ({}, "02 55 53 50 00 00 00 0a 02 01 00 10 00 10 00 0a 00 08 01", "02 55 53 50 00 00 00 04 82 01 00 00 83"),
    ({}, "02 55 53 50 00 00 00 0a 02 01 00 10 00 10 00 0a 00 07 0e", "02 55 53 50 00 00 00 04 82 01 ff ff 83"),
    (
        {}, "02 55 53 50 00 00 00 0a 02 0a 00 00 00 03 10 00 00 00 1b",
        "02 55 53 50 00 00 00 08 82 0a 00 00 00 03 10 00 9b",
    ),
    ({}, "02 55 53 50 00 00 00 04 02 0b 00 00 09", "02 55 53 50 00 00 00 08 82 0b 00 00 00 03 16 78 e4"),
    ({}, "02 55 53 50 00 00 00 04 04 03 00 00 07", "02 55 53 50 00 00 00 06 84 03 00 00 00 02 85"),
    ({"mode": "rotate"}, "02 55 53 50 00 00 00 02 04 04 00", "02 55 53 50 00 00 00 08 84 04 00 00 00 03 00 00 83"),
    (
        {"mode": "rotate", "step_deg": 0.25}, "02 55 53 50 00 00 00 02 04 04 00",
        "02 55 53 50 00 00 00 08 84 04 00 00 00 02 00 02 80",
    ),
    ({"mode": "rotate"}, "02 55 53 50 00 00 00 02 04 02 06", "02 55 53 50 00 00 00 06 84 02 00 00 00 01 87"),
    ({}, "02 55 53 50 00 00 00 04 01 05 00 00 04", "02 55 53 50 00 00 00 04 81 05 00 00 84"),
    ({"mode": "measure"}, "02 55 53 50 00 00 00 02 03 02 01", "02 55 53 50 00 00 00 06 83 02 00 00 00 03 82"),
    ({}, "02 55 53 50 00 00 00 04 04 01 00 02 07", "02 55 53 50 00 00 00 04 84 01 00 02 87"),
    ({"clock_ms": 0x1234}, "02 55 53 50 00 00 00 02 02 05 07", "02 55 53 50 00 00 00 04 82 05 12 34 a1"),
    ({}, "02 55 53 50 00 00 00 04 02 03 05 dc d8", "02 55 53 50 00 00 00 04 82 03 05 dc 58"),
    ({}, request(0x0103).hex(), "02 55 53 50 00 00 00 0a ff 00 00 00 00 00 00 00 00 01 fe"),
]  # fmt: skip


@pytest.mark.parametrize(("device", "asked", "reported"), PUBLISHED)
def test_a_published_request_gets_its_published_reply(device: dict, asked: str, reported: str) -> None:
    data = bytes.fromhex(asked)
    for chunks in ([data], [bytes([byte]) for byte in data], [b"USP\x02" + data + b"\xff"]):
        rig = Rig({**device})
        for chunk in chunks:
            rig.put(chunk)
        rig.run(4 * SECOND)
        assert b"".join(emission.payload for emission in rig.take()) == bytes.fromhex(reported)


def test_signals_set_are_read_back() -> None:
    rig = Rig()
    assert ask(rig, 0x0105, 0x0031) == [0x8105, 0x0031]
    assert rig.ask(0x0104) == bytes.fromhex("81 04 00 31")


def test_leds_of_the_device_cannot_be_set_and_show_its_error() -> None:
    rig = Rig()
    assert ask(rig, 0x0105, 0x00FF) == [0x8105, 0x00F3]
    rig.session.fail_motor(rig.now_ns, Motor.STOPPED)
    assert ask(rig, 0x0104) == [0x8104, 0x00FB]
    assert ask(rig, 0x0102) == [0x8102, 0, 0xB4]


def test_all_identities_have_twelve_characters_and_the_status() -> None:
    rig = Rig({"identity": {"sensor_serial_number": "123456789012", "edm_serial_number": ""}})
    for item, name in IDENTITIES.items():
        payload = rig.ask(0x0101, item)
        assert len(payload) == 18
        assert payload[14:] == bytes([0, 0, 0, 1])
        text = payload[2:].split(b"\0")[0].decode()
        expected = {"sensor_name": "LD-LRS1000", "sensor_serial_number": "123456789012", "edm_serial_number": ""}
        assert text == expected.get(name, text)


def test_configuration_blocks_are_kept_over_power_off() -> None:
    rig = Rig({"delays": "fast"})
    blocks = {
        0x0001: [3, 1, 2, 7],
        0x0002: [5, 0x300, 0x0F, 0x600, 0x100],
        0x0004: [1, 2],
        0x0005: [10, 0, 0, 7, 255, 0, 0, 0, 10, 0, 0, 1, 3, 50000],
        0x0010: [200, 10, 16],
    }
    for item, block in blocks.items():
        assert ask(rig, 0x0201, item, *block) == [0x8201, 0]
    rig.session.power_on(rig.now_ns)
    rig.run(SECOND)
    for item, block in blocks.items():
        assert ask(rig, 0x0202, item) == [0x8202, item, *block]


BAD_BLOCKS = [
    [0x0001, 0, 0, 1, 8], [0x0001, 7, 0, 1, 8], [0x0001, 6, 3, 1, 8], [0x0001, 6, 0, 3, 8], [0x0001, 6, 0, 1, 9],
    [0x0001, 6, 0, 1, 0], [0x0001, 6, 0, 1], [0x0002, 7, 0, 0, 0, 0xFFFF], [0x0002, 6, 0x800, 0, 0, 0xFFFF],
    [0x0002, 6, 0, 0, 0x7FF, 0xFFFF], [0x0002, 6, 0, 0, 0, 0x800], [0x0000], [0x0003, 1], [0x0004, 1],
    [0x0005, 256, *[0] * 13], [0x0005, *[0] * 13], [0x0010, 0, 10, 8], [0x0010, 255, 10, 8], [0x0010, 16, 4, 8],
    [0x0010, 16, 21, 8], [0x0010, 16, 10, 1], [0x0010, 16, 10, 7], [0x0010, 16, 10, 0], [0x0010, 16, 10],
    [0x0011, 1], [0x0012, 1, 2, 3],
]  # fmt: skip


@pytest.mark.parametrize("block", BAD_BLOCKS)
def test_a_block_that_the_device_does_not_take_is_refused_and_nothing_changes(block: list[int]) -> None:
    rig = Rig()
    before = rig.session.device.config
    assert ask(rig, 0x0201, *block) == [0x8201, 0xFFFF]
    assert rig.session.device.config == before
    assert rig.dropped() == [DropReason.BAD_ARGUMENT]


def test_only_the_model_that_has_it_knows_interlace() -> None:
    rig = Rig(facts={"model": "sick-ld-lrs3611"})
    assert ask(rig, 0x0201, 0x0011, 1) == [0x8201, 0]
    assert ask(rig, 0x0202, 0x0011) == [0x8202, 0x0011, 1]
    assert ask(rig, 0x0201, 0x0011, 2) == [0x8201, 0xFFFF]
    assert ask(Rig(), 0x0202, 0x0011) == [0x8202, 0xFFFF]


def test_a_surplus_word_is_left_out() -> None:
    rig = Rig()
    assert ask(rig, 0x0201, 0x0010, 16, 10, 16, 0) == [0x8201, 0]  # Miro
    assert ask(rig, 0x0202, 0x0010) == [0x8202, 0x0010, 16, 10, 16]


def test_the_clock_counts_milliseconds_is_set_and_shifted_and_wraps() -> None:
    rig = Rig()
    assert ask(rig, 0x0203, 65000) == [0x8203, 65000]
    rig.run(1500 * MS - rig.now_ns)
    now = ask(rig, 0x0205)[1]
    assert now == (65000 + 1500) % 65536
    assert ask(rig, 0x0204, 65536 - 200)[1] == pytest.approx(now - 200, abs=6)
    assert ask(rig, 0x0204, 1000)[1] == pytest.approx(now + 800, abs=12)


def test_a_clock_that_runs_too_fast_does_so_in_whole_milliseconds() -> None:
    rig = Rig({"clock_ppm": 100_000})
    rig.run(10 * SECOND)
    assert ask(rig, 0x0205) == [0x8205, 11_000]


def test_the_filter_answers_with_its_number() -> None:
    rig = Rig()
    assert ask(rig, 0x0209, 1, 1) == [0x8209, 1, 1]
    assert rig.session.device.near_field
    assert ask(rig, 0x0209, 1, 0) == [0x8209, 1, 0]
    assert not rig.session.device.near_field
    assert ask(rig, 0x0209, 1, 1) == [0x8209, 1, 1]
    rig.session.power_on(rig.now_ns)
    rig.run(4 * SECOND)
    assert rig.session.device.near_field  # written to flash, as sicktoolbox says
    assert ask(rig, 0x0209, 2, 0) == [0x8209, 0xFFFF]
    assert ask(rig, 0x0209, 1, 2) == [0x8209, 0xFFFF]


def test_sectors_are_set_told_and_cleared() -> None:
    rig = Rig()
    assert ask(rig, 0x020A, 0, 3, 0x12C0, 0) == [0x820A, 0, 3, 0x12C0]
    assert ask(rig, 0x020A, 1, 1, 0x1678, 0) == [0x820A, 1, 1, 0x1678]
    assert ask(rig, 0x020A, 2, 4, 0x1678, 0) == [0x820A, 2, 4, 0x1678]
    assert ask(rig, 0x020B, 1) == [0x820B, 1, 1, 0x1678]
    assert ask(rig, 0x020A, 1, 0, 0xFFF0, 1) == [0x820A, 1, 0, 2160]  # Miro clears with a stop beyond the circle
    assert ask(rig, 0x020B, 1) == [0x820B, 1, 0, 2160]
    assert ask(rig, 0x020B, 2) == [0x820B, 2, 0, 0]


@pytest.mark.parametrize(
    ("sector", "stored"),
    [
        ([8, 3, 16, 0], [7, 3, 16]),
        ([0xFFFF, 1, 32, 0], [7, 1, 32]),
        ([0, 2, 16, 0], [0, 0, 16]),
        ([0, 5, 16, 0], [0, 0, 16]),
        ([0, 3, 5760, 0], [0, 3, 0]),
        ([0, 3, 5768, 2], [0, 3, 8]),
    ],
)
def test_a_sector_out_of_range_is_brought_into_it_and_told_as_it_is_stored(
    sector: list[int], stored: list[int]
) -> None:
    rig = Rig()
    flash = rig.session.device.flash_sectors
    assert ask(rig, 0x020A, *sector) == [0x820A, *stored]
    assert ask(rig, 0x020B, stored[0]) == [0x820B, *stored]
    assert rig.session.device.flash_sectors == flash, "only flag 1 writes to flash"


def test_an_unknown_sector_is_told_as_ffff() -> None:
    assert ask(Rig(), 0x020B, 8) == [0x820B, 0xFFFF, 0xFFFF, 0xFFFF]


def test_only_sectors_in_flash_outlast_power_off() -> None:
    rig = Rig({"delays": "fast"})
    ask(rig, 0x020A, 0, 3, 800, 1)
    ask(rig, 0x020A, 1, 1, 5752, 1)
    ask(rig, 0x020A, 0, 3, 1600, 0)
    rig.session.power_on(rig.now_ns)
    rig.run(SECOND)
    assert ask(rig, 0x020B, 0) == [0x820B, 0, 3, 800]
    assert ask(rig, 0x020B, 1) == [0x820B, 1, 1, 5752]


def test_speeds_the_motor_has_are_reached_and_others_refused() -> None:
    for model, fastest in (("sick-ld-lrs1000", 10), ("sick-ld-oem1000", 20), ("sick-ld-lrs3100", 10)):
        rig = Rig({"delays": "fast"}, facts={"model": model})
        for hz in (5, fastest, 0):
            assert ask(rig, 0x0403, hz) == [0x8403, 0, 2]
        assert rig.session.device.rotation is not None
        assert rig.session.device.rotation.hz == 10
        for hz in (1, 4, fastest + 1, 0xFFFF):
            assert ask(rig, 0x0403, hz) == [0x8403, 0, 1], "a wrong speed leads to IDLE"
            assert rig.session.device.mode is Mode.IDLE
            assert ask(rig, 0x0403, 0) == [0x8403, 0, 2]
        assert ask(rig, 0x0403) == [0x8403, 0, 1], "so does none"
        refused = ask(rig, 0x0201, 0x0010, 16, 11, 16)
        assert refused == [0x8201, 0 if fastest == 20 else 0xFFFF]


@pytest.mark.parametrize(
    ("config", "sectors", "error"),
    [
        ([16, 20, 4], [(0, 3, 5756)], 1),
        ([16, 10, 4], [(0, 3, 5756)], 2),
        ([16, 10, 8], [(0, 3, 1600), (1, 1, 800), (2, 3, 3200)], 3),
        ([16, 10, 8], [(0, 1, 5752)], 3),
        ([16, 10, 8], [(0, 3, 1604), (1, 1, 5752)], 4),
    ],
)
def test_what_cannot_be_measured_is_refused_by_its_error(config: list[int], sectors: list, error: int) -> None:
    rig = Rig({"delays": "fast"}, facts={"model": "sick-ld-oem1000"})
    ask(rig, 0x0201, 0x0010, *config)
    ask(rig, 0x020A, 0, 0, 0, 0)
    for sector in sectors:
        ask(rig, 0x020A, *sector, 0)
    ask(rig, 0x0403, 0)
    assert ask(rig, 0x0404) == [0x8404, 0, 2, error]
    assert rig.modes()[-1] == "rotate"


def test_a_refused_measure_while_measuring_leaves_the_old_geometry() -> None:
    rig = measuring({"services": "liberal"})
    geometry = rig.session.device.geometry
    ask(rig, 0x0201, 0x0010, 16, 10, 4)
    assert ask(rig, 0x0404) == [0x8404, 0, 3, 2]
    assert rig.session.device.geometry is geometry


@pytest.mark.parametrize("level", [0, 1])
def test_a_reset_answers_first_then_starts_anew(level: int) -> None:
    rig = Rig({"delays": "fast", "mode": "rotate"})
    ask(rig, 0x020A, 0, 3, 2880, 0)
    ask(rig, 0x0404)
    ask(rig, 0x0105, 0x10)
    restarts = rig.session.device.restarts
    assert ask(rig, 0x0401, level) == [0x8401, level]
    rig.put(request(0x0102))
    rig.run(20 * MS)
    assert rig.take() == []
    assert rig.dropped() == [DropReason.BOOTING]
    rig.run(SECOND)
    assert rig.session.device.restarts == restarts + 1
    assert ask(rig, 0x020B, 0) == [0x820B, 0, 3, 5752]
    assert ask(rig, 0x0104) == [0x8104, 0]
    assert ask(rig, 0x0205)[1] < 1100


def test_a_soft_reset_stops_all_and_keeps_the_sectors() -> None:
    rig = Rig({"delays": "fast", "mode": "rotate"})
    ask(rig, 0x020A, 0, 3, 2880, 0)
    ask(rig, 0x0404)
    assert ask(rig, 0x0401, 2) == [0x8401, 2]
    assert ask(rig, 0x0102) == [0x8102, 0, 1]
    assert ask(rig, 0x020B, 0) == [0x820B, 0, 3, 2880]
    assert ask(rig, 0x0401, 0x10) == [0x8401, 0x10]
    assert ask(rig, 0x0401, 3) == [0xFF00, 0, 0, 0, 1]


@pytest.mark.parametrize(("start", "wait"), [("real", (1400 * MS, 4500 * MS)), ("fast", (10 * MS, 100 * MS))])
def test_the_head_takes_its_time_to_speed_and_answers_then(start: str, wait: tuple[int, int]) -> None:
    rig = Rig({"delays": start})
    rig.put(request(0x0403, 10))
    _, due_ns = rig.next_telegram(5 * SECOND)
    assert wait[0] <= due_ns <= wait[1]
    begun_ns = rig.now_ns
    rig.put(request(0x0403, 10))
    _, due_ns = rig.next_telegram(5 * SECOND)
    assert due_ns - begun_ns <= 10 * MS  # it turns so fast already


def test_while_it_spins_up_others_see_a_motor_too_slow() -> None:
    rig = Rig({"spin_up_s": 4.5})
    other = rig.address._replace(peer=2)
    rig.session.connected(0, other, rig.kind)
    rig.put(request(0x0403, 0))
    rig.run(SECOND)
    assert words(rig.ask(0x0102, address=other)) == [0x8102, 0, 0x42]
    assert words(rig.next_payload(5 * SECOND)) == [0x8403, 0, 2]
    assert rig.now_ns == 4505 * MS


def test_a_host_that_stops_the_motor_lets_another_hosts_wait_end() -> None:
    rig = Rig()
    other = rig.address._replace(peer=2)
    rig.session.connected(0, other, rig.kind)
    rig.put(request(0x0403, 0))
    rig.put(request(0x0404), other)
    rig.run(100 * MS)
    third = rig.address._replace(peer=3)
    rig.session.connected(0, third, rig.kind)
    assert words(rig.ask(0x0402, address=third)) == [0x8402, 0, 1]
    assert words(rig.next_payload(SECOND)) == [0x8403, 0, 1]
    assert words(rig.next_payload(SECOND, other)) == [0xFF00, 0, 0, 0, 1]


# every mode x every service

MODES: dict[str, Callable[[], Rig]] = {
    "idle": lambda: Rig(),
    "spinning up": lambda: _spinning(),
    "rotate": lambda: Rig({"mode": "rotate"}),
    "measure": lambda: Rig({"mode": "measure"}),
    "error": lambda: _broken(),
}


def _spinning() -> Rig:
    rig = Rig()
    other = rig.address._replace(peer=9)
    rig.session.connected(0, other, rig.kind)
    rig.put(request(0x0403, 0), other)
    return rig


def _broken() -> Rig:
    rig = Rig({"mode": "rotate"})
    rig.session.fail_motor(0, Motor.STOPPED)
    return rig


def state(rig: Rig) -> tuple[object, ...]:
    device = rig.session.device
    motion = (device.mode, device.rotation, device.spin_up)
    stored = (device.config, device.sectors, device.files, device.identity, device.attached, device.monitor)
    return (*motion, *stored, device.signals, device.near_field)


GOOD = {0x0209: [1, 1], 0x020A: [0, 3, 800, 0], 0x0201: [0x0010, 16, 12, 16], 0x0301: [1, 0x0100], 0x0401: [2]}


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("service", [*COMMANDS, 0x1000, 0x3F00, 0x7E01, 0x0107, 0x8102, 0x0000])
def test_every_service_in_every_mode_gets_a_reply_or_a_named_refusal(mode: str, service: int) -> None:
    for data in (GOOD.get(service, [0, 0, 0, 0]), [], [0xFFFF, 0xFFFF, 0xFFFF, 0xFFFF]):
        rig = MODES[mode]()
        rig.run(0)
        before = state(rig)
        reply = ask(rig, service, *data)
        assert reply[0] in (service | 0x8000, 0xFF00)
        command, outcome = rig.handled()[-1]
        assert command.startswith(f"{service:04X}")
        if outcome != "done":
            reasons = {reason.value for reason in rig.dropped()}
            assert outcome in reasons
            wrong_speed = service == 0x0403  # leads to IDLE
            if mode != "spinning up" and not wrong_speed:  # there, time alone changes speed
                assert state(rig) == before
        else:
            assert reply[0] == service | 0x8000


def test_too_few_words_are_refused_before_anything_is_done() -> None:
    rig = Rig()
    for code, command in COMMANDS.items():
        if command.handler and command.words:
            before = state(rig)
            reply = ask(rig, code, *[0] * (command.words - 1))
            reported = (code | 0x8000, *command.too_short) if command.too_short else (0xFF00, 0, 0, 0, 1)
            assert reply == [*reported], f"{code:04X}"
            assert state(rig) == before
            assert rig.dropped() == [DropReason.BAD_LENGTH]


def test_a_telegram_without_a_service_is_a_failure_and_a_failure_is_not_answered() -> None:
    rig = Rig()
    rig.put(request())
    rig.put(request(0xFF00, 0, 1))
    rig.run(100 * MS)
    (emission,) = rig.take()
    assert read_frames(emission.payload) == [bytes.fromhex("ff 00 00 00 00 00 00 00 00 01")]
    assert rig.dropped() == [DropReason.BAD_LENGTH, DropReason.UNKNOWN_COMMAND]


# the table


def test_the_coverage_table_has_every_row_of_the_dispatcher_once() -> None:
    rows = FAMILY.commands()
    assert family("ld") is FAMILY
    codes = [row.code for row in rows if len(row.code) == 4 and row.code != "CoLa"]
    assert codes == [f"{code:04X}" for code in sorted(COMMANDS)]
    assert {row.status for row in rows} == {"done", "refused", "absent"}
    assert all(row.source for row in rows)
    assert all(row.note for row in rows if row.status != "done")


@pytest.mark.parametrize(
    ("code", "row"),
    [
        (0x8101, Command("X", 0, services._get_status, "TBX")),
        (0x0107, Command("GET_STATUS", 0, services._get_status, "TBX")),
        (0x0107, Command("X", 0, services._get_status, "")),
        (0x0107, Command("X", 0, None, "TBX")),
    ],
)
def test_a_row_that_cannot_be_dispatched_is_found_at_start(
    code: int, row: Command, monkeypatch: pytest.MonkeyPatch
) -> None:
    check_table()
    monkeypatch.setitem(COMMANDS, code, row)
    with pytest.raises(ProtocolError):
        FAMILY.new_session({}, FACTS)
