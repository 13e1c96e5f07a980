"""Order on the line, power, reset, pipelined requests, bad input: the device as a host sees it."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from protocols.lms2xx import FAMILY
from protocols.lms2xx.telegrams import frame, open_frame, read_values, request
from protocols.scan import DAZZLED, Scan, ScanPlan
from protocols.session import (
    Address,
    CommandHandled,
    CutShort,
    DropReason,
    LinkKind,
    ModeChanged,
    Restarted,
)
from protocols.skeleton.serial_lines import line_ns
from tests.protocols.lms2xx.rig import MS, SECOND, Rig, new_session, wall

A0 = bytes.fromhex("06 A0 00 10")
STOP, ALL = request(b"\x20\x25"), request(b"\x20\x24")


def at_500k(**device: object) -> Rig:
    """A device whose line and host are at 500 kBd."""
    rig = Rig.on(baud=500_000, **device)  # type: ignore[arg-type]
    rig.host_baud = 500_000
    return rig


# --- section 1.3: good and bad requests ---


def test_ack_comes_first_and_the_reply_behind_it() -> None:
    rig = Rig.on()
    end_ns = rig.ask("31")
    rig.run(end_ns + 50 * MS)
    ack, status = rig.emissions[1:]
    assert (ack.payload, ack.label) == (b"\x06", "ACK")
    assert 0 < ack.due_ns - end_ns < 5 * MS
    assert 5 * MS <= status.due_ns - ack.due_ns <= 20 * MS
    assert len(status.payload) == 160
    assert status.sweep is None


def test_a_wrong_crc_is_answered_with_nak_and_nothing_else() -> None:
    rig = Rig.on()
    rig.write(bytes.fromhex("02 00 01 00 31 15 13"))
    assert rig.read(10, 1.0) == b"\x15"
    assert rig.dropped() == [DropReason.BAD_CHECKSUM]
    assert rig.reply_to("31")[:2] == b"\x06\xb1"


def test_an_unknown_command_is_acknowledged_and_refused() -> None:
    rig = Rig.on()
    rig.ask("99")
    assert rig.read(20, 1.0) == bytes.fromhex("06 02 80 02 00 92 10 7F 33")
    assert rig.dropped() == [DropReason.UNKNOWN_COMMAND]


@pytest.mark.parametrize(
    ("asked", "answered", "reason"),
    [
        ("77 00", "92 10", DropReason.WRONG_MODE),
        ("31 00", "92 10", DropReason.BAD_LENGTH),
        ("20 26 01", "92 10", DropReason.BAD_ARGUMENT),
        ("40 00", "92 10", DropReason.WRONG_MODE),
        ("20 2E", "92 10", DropReason.REFUSED),
        ("20 00 41 41 41 41 41 41 41 41", "A0 01 10", DropReason.BAD_ARGUMENT),
        ("3B B4 00 19 00", "BB 00 B4 00 32 00 10", DropReason.BAD_ARGUMENT),
    ],
)
def test_each_mistake_has_its_own_answer_and_is_recorded(asked: str, answered: str, reason: DropReason) -> None:
    rig = Rig.on()
    assert rig.reply_to(asked) == b"\x06" + bytes.fromhex(answered)
    assert rig.dropped() == [reason]
    handled = [event for event in rig.events if isinstance(event, CommandHandled)]
    assert [event.outcome for event in handled] == [reason.value]


def test_a_refused_block_comes_back_as_it_was() -> None:
    rig = Rig.on()
    rig.reply_to("20 00 53 49 43 4B 5F 4C 4D 53")
    block = rig.reply_to("74")[2:-1]
    assert rig.reply_to("77 00 00 46 00 00 99") == b"\x06\xf7\x00" + block + b"\x10"


def test_a_telegram_for_another_address_is_met_with_silence() -> None:
    rig = Rig.on(address=3)
    rig.write(request(b"\x31", 4))
    rig.wait(1.0)
    assert rig.emissions[1:] == []
    assert rig.dropped() == [DropReason.OTHER_ADDRESS]


@pytest.mark.parametrize("called", [0, 3])
def test_a_device_replies_with_its_own_address(called: int) -> None:
    rig = Rig.on(address=3)
    rig.write(request(b"\x20\x25", called))
    assert rig.read(10, 1.0) == b"\x06" + frame(0x83, b"\xa0\x00\x10")


def test_half_a_telegram_is_dropped_in_silence_and_the_next_is_answered() -> None:
    rig = Rig.on()
    rig.write(request(b"\x31")[:5])
    rig.wait(0.3)
    assert rig.emissions[1:] == []
    assert rig.dropped() == [DropReason.TIMEOUT]
    assert rig.reply_to("31")[:2] == b"\x06\xb1"


def test_with_the_device_s_own_rule_a_pause_of_7_ms_is_too_long() -> None:
    rig = Rig.on(strict_gap=True)
    for half in (request(b"\x31")[:3], request(b"\x31")[3:]):
        rig.write(half)
        rig.wait(0.016)
    rig.wait(0.5)
    assert rig.emissions[1:] == []
    assert rig.reply_to("31")[:2] == b"\x06\xb1"


def test_bytes_at_another_speed_are_silence() -> None:
    rig = Rig.on()
    rig.set_speed(38400)
    assert rig.reply_to("31", 0.5) == b""


def test_the_status_byte_is_in_every_reply_and_every_scan() -> None:
    rig = Rig.on(restart_input=True, pollution=True)
    assert rig.reply_to("31")[-1] == 0xB0
    assert rig.reply_to("30 01")[-1] == 0xB0
    assert rig.reply_to("99")[-1] == 0xB0


# --- order on the line ---


def test_a_stop_lets_the_running_telegram_end_when_told_so_then_ack_then_a0_then_nothing() -> None:
    rig = Rig.on(interrupt="finish")
    rig.reply_to("20 40")
    rig.set_speed(38400)
    rig.ask("20 24")
    rig.wait(1.0)
    last = rig.scans()[-1]
    begin = len(rig.emissions)
    rig.run(last.due_ns + 20 * MS)
    rig.ask("20 25")
    rig.wait(2.0)
    behind = rig.emissions[begin:]
    assert [emission.label for emission in behind] == ["ACK", "A0"]
    end_ns = last.due_ns + line_ns(len(last.payload), 38400)
    assert behind[0].due_ns == end_ns


def test_a_request_while_streaming_is_answered_before_the_next_scan() -> None:
    rig = Rig.on()
    rig.reply_to("20 40")
    rig.set_speed(38400)
    rig.ask("20 24")
    rig.wait(1.0)
    begin = len(rig.emissions)
    rig.ask("31")
    rig.wait(1.5)
    labels = [emission.label for emission in rig.emissions[begin:]]
    assert labels[:3] == ["cut", "ACK", "B1"]
    assert set(labels[3:]) == {"B0"}


@pytest.mark.parametrize("delays", ["fast", "real"])
@pytest.mark.parametrize("baud", [9600, 19200, 38400, 500_000])
def test_a_request_is_acknowledged_within_60_ms_also_while_a_telegram_leaves(baud: int, delays: str) -> None:
    rig = Rig.on(baud=baud, delays=delays)
    rig.set_speed(baud)
    rig.ask("20 24")
    assert rig.await_reply(0xB0, 4.0) is not None
    for share in (0.01, 0.3, 0.7, 0.99):
        sent = len(rig.scans())
        while len(rig.scans()) == sent:
            rig.wait(0.001)
        scan = rig.scans()[-1]
        rig.run(scan.due_ns + round(share * line_ns(len(scan.payload), baud)))
        rig.flush_input()
        begin = len(rig.emissions)
        end_ns = rig.ask("31")
        rig.run(end_ns + 3 * SECOND)
        ack = next(emission for emission in rig.emissions[begin:] if emission.label == "ACK")
        assert ack.due_ns + line_ns(1, baud) - end_ns <= 60 * MS
        assert bytes((0x06, 0x02, 0x80)) in bytes(byte for _, byte in rig.arrivals)


def test_a_telegram_is_cut_behind_the_byte_that_is_leaving() -> None:
    rig = Rig.on()
    rig.ask("20 24")
    assert rig.await_reply(0xB0, 2.0) is not None
    sent = len(rig.scans())
    while len(rig.scans()) == sent:
        rig.wait(0.01)
    scan = rig.scans()[-1]
    rig.flush_input()
    end_ns = rig.ask("20 25")
    rig.wait(2.0)
    left = bytes(byte for _, byte in rig.arrivals)
    whole = (end_ns - scan.due_ns) * 960 // SECOND + 1
    cut = next(event for event in rig.events if isinstance(event, CutShort))
    assert (cut.label, cut.left, cut.of) == ("B0", whole, 732)
    assert left == scan.payload[whole - len(left) + 10 : whole] + b"\x06" + left[-9:]
    assert open_frame(left[-9:]) is not None


def test_a_reply_that_has_begun_is_never_cut() -> None:
    rig = Rig.on()
    rig.ask("31")
    rig.wait(0.02)
    rig.ask("3A")
    rig.wait(1.0)
    assert [emission.label for emission in rig.emissions[1:]] == ["ACK", "B1", "ACK", "BA"]


def test_at_500k_no_more_than_508_bytes_leave_in_one_turn() -> None:
    rig = at_500k()
    rig.ask("20 24")
    rig.wait(0.1)
    rig.run(rig.scans()[-1].due_ns - 1)
    rig.flush_input()
    rig.wait(0.025)
    times = [at_ns for at_ns, _ in rig.arrivals]
    gaps = [after - before for before, after in pairwise(times)]
    assert len(times) == 732
    assert gaps.index(max(gaps)) == 507
    assert times[-1] - (times[0] - 20_000) == pytest.approx(40 / 3 * MS + 224 * 20_000, abs=2)
    assert max(gaps) < 14 * MS


def test_an_s14_sends_its_559_bytes_in_one_go() -> None:
    rig = at_500k(model="sick-lms291-s14")
    rig.ask("20 50 01 00 B5 00")
    rig.wait(0.2)
    assert rig.scans()
    assert {(len(scan.payload), scan.pause) for scan in rig.scans()} == {(559, None)}


def test_a_telegram_in_its_pause_at_500k_is_cut_there() -> None:
    rig = at_500k()
    rig.ask("20 24")
    rig.wait(0.1)
    scan = rig.scans()[-1]
    assert scan.pause is not None
    while rig.scans()[-1] is scan:
        rig.wait(0.001)
    scan = rig.scans()[-1]
    rig.run(scan.due_ns + 11 * MS)
    rig.ask("31")
    rig.wait(0.2)
    cut = next(event for event in rig.events if isinstance(event, CutShort))
    assert (cut.left, cut.of) == (508, 732)


def test_at_500k_a_status_request_costs_no_scan() -> None:
    rig = at_500k()
    rig.ask("20 24")
    rig.wait(1.0)
    begin = len(rig.scans())
    slot_ns = rig.scans()[-1].due_ns
    rig.run(slot_ns + 1 * MS)
    rig.ask("31")
    rig.wait(1.0)
    sweeps = [scan.sweep for scan in rig.scans()[begin:]]
    assert sweeps == list(range(sweeps[0], sweeps[0] + 2 * len(sweeps), 2))  # type: ignore[arg-type, operator]


def test_no_byte_of_a_reply_overlaps_another_however_requests_come() -> None:
    rig = at_500k()
    rig.ask("20 24")
    for pause_ms in range(1, 60):
        rig.wait(pause_ms / 1000)
        rig.write(request(b"\x31") if pause_ms % 3 else request(b"\x3a") + request(b"\x32"))
    rig.wait(0.5)
    end_ns = 0
    for emission in rig.emissions[1:]:
        if emission.cuts:
            end_ns = min(end_ns, emission.due_ns + line_ns(1, 500_000))
            continue
        assert emission.due_ns >= end_ns
        count, start_ns = emission.pause or (0, emission.due_ns)
        end_ns = start_ns + line_ns(len(emission.payload) - count, 500_000)


def test_a_mode_asked_for_again_is_answered_and_goes_on() -> None:
    rig = at_500k()
    for _ in range(3):
        rig.flush_input()  # as every driver does: else it would read A0 as the end of the telegram that was cut
        rig.ask("20 24")
        telegram = rig.await_reply(0xA0, 0.2)
        assert telegram is not None
        assert telegram.data == b"\x00\x10"
        rig.wait(0.3)
    assert len(rig.scans()) > 20


def test_a_refused_mode_lets_the_stream_go_on() -> None:
    rig = at_500k()
    rig.ask("20 24")
    rig.wait(0.5)
    begin = len(rig.scans())
    rig.ask("20 2E")
    rig.wait(1.0)
    assert len(rig.scans()) - begin >= 36
    assert rig.session.device.mode == 0x24


def test_a_rate_change_while_streaming_keeps_the_mode_and_moves_the_slots() -> None:
    rig = Rig.on()
    rig.ask("20 24")
    rig.wait(2.0)
    rig.ask("20 48")
    rig.wait(2.0)
    rig.host_baud = 500_000
    begin = len(rig.scans())
    rig.wait(2.0)
    assert len(rig.scans()) - begin == 75
    assert rig.session.device.mode == 0x24


def test_values_once_come_in_every_mode_with_the_scan_that_ends_next() -> None:
    rig = Rig.on()
    for mode in ("20 25", "20 10", "20 00 53 49 43 4B 5F 4C 4D 53"):
        rig.reply_to(mode)
        end_ns = rig.ask("30 01")
        telegram = rig.await_reply(0xB0, 2.0)
        assert telegram is not None
        scan = rig.scans()[-1]
        assert scan.due_ns - end_ns < 45 * MS
        assert scan.due_ns == (scan.sweep + 2) * 40_000_000 // 3  # type: ignore[operator]


def test_values_once_while_streaming_are_one_more_telegram() -> None:
    rig = at_500k()
    rig.ask("20 24")
    rig.wait(0.5)
    begin = len(rig.emissions)
    rig.ask("37 01 00 05 00")
    rig.wait(0.5)
    labels = [emission.label for emission in rig.emissions[begin:]]
    assert labels.count("B7") == 1
    assert labels[labels.index("ACK") + 1] == "B7"
    assert labels[-1] == "B0"


def test_requests_during_a_long_mean_are_answered_at_once_and_a_stop_withdraws_it() -> None:
    rig = at_500k()
    rig.ask("36 FA")
    rig.wait(1.0)
    assert rig.read(1, 0.1) == b"\x06"
    assert rig.reply_to("31", 0.1)[:2] == b"\x06\xb1"
    assert rig.reply_to("20 25") == A0
    rig.wait(10.0)
    assert rig.scans() == []
    assert DropReason.STALE in rig.dropped()


def test_a_long_mean_comes_when_its_scans_are_there_though_the_line_was_used() -> None:
    rig = at_500k()
    rig.ask("36 32")
    rig.wait(0.5)
    rig.reply_to("31")
    rig.wait(2.0)
    assert len(rig.scans()) == 1
    telegram = open_frame(rig.scans()[0].payload)
    assert telegram is not None
    values = read_values(telegram)
    assert values is not None
    assert values.scans == 50


def test_a_stream_of_means_goes_on_with_its_scans_after_a_request() -> None:
    rig = at_500k()
    rig.ask("20 26 0A")
    for _ in range(20):
        rig.wait(0.1)
        rig.ask("31")
    rig.wait(1.0)
    sweeps = [scan.sweep for scan in rig.scans()]
    assert len(sweeps) >= 10
    assert all(b - a == 20 for a, b in pairwise(sweeps))  # type: ignore[operator]


def test_the_bytes_on_the_line_are_those_that_were_measured() -> None:
    def measure(plan: ScanPlan) -> Scan:
        n = len(plan)
        range_m = np.linspace(1.0, 100.0, n)[:, None]
        range_m[5] = np.nan
        flags = np.zeros(n, np.uint8)
        flags[7] = DAZZLED
        return Scan(plan, range_m, np.ones((n, 1)), flags, np.zeros((n, 1), np.int32))

    rig = Rig.on(measure=measure)
    rig.ask("30 01")
    telegram = rig.await_reply(0xB0, 2.0)
    assert telegram is not None
    values = read_values(telegram)
    assert values is not None
    words = values.values.tolist()
    assert words[0] == 100
    assert words[5] == 0x1FF7
    assert words[7] == 0x9FFE
    assert words[-1] == 0x1FF7
    assert words[4] == int(np.floor((1.0 + 4 * 99 / 360) * 100 + 0.5))


# --- line speed ---


@pytest.mark.parametrize(("sub", "baud"), [("48", 500_000), ("40", 38_400), ("41", 19_200), ("42", 9600)])
def test_a0_leaves_at_the_old_rate_and_carries_the_new_one(sub: str, baud: int) -> None:
    rig = Rig.on()
    assert rig.reply_to(f"20 {sub}") == A0
    a0 = rig.emissions[-1]
    assert (a0.label, a0.line_speed) == ("A0", baud)
    assert rig.session.line_speed == baud
    rig.set_speed(baud)
    assert rig.reply_to("31")[:2] == b"\x06\xb1"


def test_requests_in_a_row_around_a_rate_change_are_answered_in_order_at_the_new_rate() -> None:
    rig = Rig.on()
    rig.write(request(b"\x20\x40") + request(b"\x31") + STOP)
    rig.wait(0.021)
    rig.read_telegram(0.1)
    rig.set_speed(38400)
    rig.wait(1.0)
    labels = [emission.label for emission in rig.emissions[1:]]
    assert labels == ["ACK", "A0", "ACK", "B1", "ACK", "A0"]
    b1 = rig.await_reply(0xB1, 1.0)
    assert b1 is not None
    assert b1.data[115:117] == bytes.fromhex("19 80")


def test_more_requests_than_the_device_can_hold_are_lost_and_no_reply_is() -> None:
    rig = Rig.on(delays={"data_s": 1.0})
    rig.write(request(b"\x31") * 30)
    rig.wait(60.0)
    labels = [emission.label for emission in rig.emissions[1:]]
    assert labels.count("B1") == labels.count("ACK")
    assert labels.count("B1") + rig.dropped().count(DropReason.BUSY) == 30
    assert 8 <= labels.count("B1") < 30
    assert rig.reply_to("31", 3.0)[:2] == b"\x06\xb1"


# --- power and reset ---


def test_a_running_device_is_silent_and_answers() -> None:
    rig = Rig.on()
    rig.wait(5.0)
    assert [emission.payload for emission in rig.emissions] == [b""]
    assert rig.emissions[0].line_speed == 9600
    assert rig.reply_to("31")[:2] == b"\x06\xb1"


POWER_ON = {
    "sick-lms291-s05": "02 80 17 00 90 4C 4D 53 32 39 31 3B 53 30 35 20 20 20 3B 58 30 31 2E 32 37 20 10 F5 49",
    "sick-lms200-30106": "02 80 17 00 90 4C 4D 53 32 30 30 3B 33 30 31 30 36 33 3B 56 30 32 2E 31 30 20 10 63 5E",
}


@pytest.mark.parametrize("model", POWER_ON)
def test_a_cold_device_boots_in_silence_and_sends_its_power_on_telegram_once(model: str) -> None:
    rig = Rig.on(model, start="cold", boot_s=3)
    rig.ask("31")
    rig.wait(2.9)
    assert len(rig.emissions) == 1
    assert set(rig.dropped()) == {DropReason.BOOTING}
    rig.wait(10.0)
    assert [emission.payload for emission in rig.emissions[1:]] == [bytes.fromhex(POWER_ON[model])]
    assert rig.emissions[1].due_ns == 3 * SECOND
    rig.flush_input()
    assert rig.reply_to("31")[:2] == b"\x06\xb1"


@pytest.mark.parametrize(("delays", "boot_s"), [("fast", 2), ("real", 25)])
def test_boot_time_is_that_of_the_profile(delays: str, boot_s: int) -> None:
    rig = Rig.on(start="cold", delays=delays)
    rig.wait(60.0)
    assert rig.emissions[1].due_ns == boot_s * SECOND


def test_switching_off_and_on_loses_mode_speed_and_variant_and_keeps_the_configuration() -> None:
    rig = Rig.on(field_deg=100, resolution_deg=1)
    for text in ("20 00 53 49 43 4B 5F 4C 4D 53", "77 00 00 46 00 00 06 01", "3B B4 00 32 00", "20 48"):
        rig.reply_to(text)
    rig.set_speed(500_000)
    rig.reply_to("20 24")
    rig.wait(0.5)
    rig.session.power_on(rig.now_ns)
    rig.host_baud = 9600
    rig.wait(5.0)
    device = rig.session.device
    assert (device.mode, device.baud, device.variant.points) == (0x25, 9600, 101)
    assert device.configuration[5:7] == bytes((6, 1))
    assert device.switch_ons == 2
    assert rig.emissions[-1].label == "90"
    restarts = [event for event in rig.events if isinstance(event, Restarted)]
    assert len(restarts) == 2


def test_switching_on_again_forgets_replies_and_scans_that_were_on_their_way() -> None:
    rig = at_500k()
    rig.ask("20 24")
    rig.wait(0.5)
    rig.ask("31")
    rig.run(rig.now_ns + 1 * MS)
    plan = rig.session.next_plan()
    rig.session.power_on(rig.now_ns)
    begin = len(rig.emissions)
    rig.wait(10.0)
    assert [emission.label for emission in rig.emissions[begin:]] == ["power-on", "90"]
    assert plan is None or rig.session.next_plan() is None


def test_reset_is_answered_then_the_device_boots_at_its_start_up_rate() -> None:
    rig = Rig.on()
    rig.reply_to("20 40")
    rig.set_speed(38400)
    assert rig.reply_to("10") == bytes.fromhex("06 91 10")
    assert rig.emissions[-1].line_speed == 9600
    end_ns = rig.now_ns
    rig.write(request(b"\x31"))
    rig.set_speed(9600)
    telegram = rig.await_reply(0x90, 5.0)
    assert telegram is not None
    assert rig.now_ns - end_ns == pytest.approx(2 * SECOND + line_ns(29, 9600), abs=MS)
    assert rig.reply_to("31")[:2] == b"\x06\xb1"


def test_requests_behind_a_reset_in_one_breath_are_lost() -> None:
    rig = Rig.on()
    rig.write(request(b"\x10") + request(b"\x31"))
    rig.wait(5.0)
    assert [emission.label for emission in rig.emissions[1:]] == ["ACK", "91", "90"]
    assert DropReason.BOOTING in rig.dropped()


def test_a_reset_ends_a_stream() -> None:
    rig = at_500k()
    rig.ask("20 24")
    rig.wait(0.5)
    begin = len(rig.emissions)
    rig.ask("10")
    rig.wait(5.0)
    labels = [emission.label for emission in rig.emissions[begin:]]
    assert labels[labels.index("91") :] == ["91", "90"]
    assert DropReason.STALE in rig.dropped()


def test_a_permanent_rate_is_the_rate_after_a_reset() -> None:
    rig = Rig.on()
    rig.reply_to("20 40")
    rig.set_speed(38400)
    rig.reply_to("20 00 53 49 43 4B 5F 4C 4D 53")
    assert rig.reply_to("66 01") == bytes.fromhex("06 E6 01 01 10")
    rig.ask("10")
    assert rig.await_reply(0x90, 5.0) is not None
    assert rig.reply_to("31")[1 + 1 + 118] == 1


def test_indices_begin_again_after_power_on() -> None:
    rig = at_500k(real_time_indices=True)
    for _ in range(2):
        rig.ask("20 24")
        rig.wait(0.5)
        first = next(scan for scan in rig.scans() if scan.due_ns > rig.now_ns - SECOND)
        telegram = open_frame(first.payload)
        assert telegram is not None
        assert telegram.data[-2] == 0
        rig.session.power_on(rig.now_ns)
        rig.wait(3.0)


def test_an_unpowered_device_says_and_wants_nothing() -> None:
    session = new_session()
    session.receive(request(b"\x31"), 5)
    session.advance(10**12)
    assert session.take_emissions(10**12) == []
    assert session.next_deadline() is None
    assert session.next_plan() is None


# --- links and events ---


def test_connections_do_not_mix_their_bytes() -> None:
    session = new_session()
    session.power_on(0)
    one, two = Address(0, 1), Address(0, 2)
    for address in (one, two):
        session.connected(0, address, LinkKind.STREAM)
    half, rest = request(b"\x31")[:4], request(b"\x31")[4:]
    session.receive(half, 1, one)
    session.receive(request(b"\x3a"), 2, two)
    session.receive(rest, 3, one)
    labels = [emission.label for emission in session.take_emissions(SECOND)]
    assert labels == ["power-on", "ACK", "BA", "ACK", "B1"]


def test_a_host_that_goes_takes_its_half_telegram_with_it() -> None:
    session = new_session()
    session.power_on(0)
    address = Address(0, 1)
    session.connected(0, address, LinkKind.STREAM)
    session.receive(request(b"\x31")[:4], 1, address)
    session.disconnected(2, address)
    session.connected(3, address, LinkKind.STREAM)
    session.receive(request(b"\x31"), 4, address)
    assert [emission.label for emission in session.take_emissions(SECOND)] == ["power-on", "ACK", "B1"]


def test_any_number_of_connections_is_borne() -> None:
    session = new_session()
    session.power_on(0)
    for peer in range(1000):
        session.connected(0, Address(0, peer), LinkKind.STREAM)
        session.receive(b"\x02\x00", peer, Address(0, peer))
    assert len(session._receivers) <= 64


def test_modes_and_commands_are_told_as_events() -> None:
    rig = Rig.on()
    rig.reply_to("20 24")
    rig.reply_to("20 25")
    modes = [event.mode for event in rig.events if isinstance(event, ModeChanged)]
    assert modes == ["25", "24", "25"]
    commands = [event.command for event in rig.events if isinstance(event, CommandHandled)]
    assert commands == ["20 24", "20 25"]


def test_events_that_nobody_takes_do_not_fill_the_memory() -> None:
    session = new_session()
    session.power_on(0)
    for now_ns in range(200):
        session.receive(b"\x02\x00\x00\x00" * 200, now_ns)
    assert len(session.take_events()) == 10_000
    assert session.take_events() == []


def test_what_the_caller_sees_does_not_depend_on_when_it_looks() -> None:
    """Stepping finely or coarsely gives the same bytes at the same instants."""

    def talk(step_ns: int) -> list[tuple[int, bytes]]:
        session, sent, measure = new_session(baud=500_000), [], wall()
        session.power_on(0)
        for now_ns in range(0, SECOND, step_ns):
            if now_ns == 20 * MS:
                session.receive(ALL, now_ns)
            if now_ns == 700 * MS:
                session.receive(STOP, now_ns)
            session.advance(now_ns)
            while (plan := session.next_plan()) is not None:
                session.submit(measure(plan))
            sent += [(emission.due_ns, emission.payload) for emission in session.take_emissions(now_ns)]
        return sent

    assert talk(1 * MS) == talk(5 * MS)


def test_tcp_is_a_serial_line_behind_a_device_server() -> None:
    assert FAMILY.tcp_is_line
    assert FAMILY.name == "lms2xx"
