"""Switching on and off, and what is particular to each kind of link."""

from __future__ import annotations

from protocols.ld.telegrams import Motor
from protocols.session import Address, DropReason, LinkKind
from tests.protocols.ld.reader import can_frames, package, read_packages, request, words
from tests.protocols.ld.rig import MS, SECOND, TCP, Rig, measuring, profiles, ten_metres

# datagrams: ours, not in the real device


def test_a_link_that_only_listens_gets_profiles_by_itself() -> None:
    rig = Rig({"delays": "fast", "udp_format": 0x39FF}, ten_metres, LinkKind.DATAGRAM, Address(0, 0))
    rig.run(SECOND)
    found = profiles(rig, Address(0, 0))
    assert [profile.form for profile in found] == [0x39FF] * 10
    assert [profile.counter for profile in found] == list(range(10))


def test_a_sender_of_datagrams_is_answered_at_its_own_port() -> None:
    rig = Rig({"mode": "idle"}, ten_metres, LinkKind.DATAGRAM, Address(0, 0))
    rig.put(request(0x0102) + request(0x0205), Address(0, 40000))
    rig.run(SECOND)
    assert [emission.address for emission in rig.sent] == [Address(0, 40000)] * 2
    assert [emission.label for emission in rig.take()] == ["8102", "8205"]


def test_what_cannot_be_measured_is_not_begun_for_a_listener() -> None:
    rig = Rig({"delays": "fast", "step_deg": 0.25}, ten_metres, LinkKind.DATAGRAM, Address(0, 0))
    rig.run(SECOND)
    assert rig.take() == []
    assert rig.modes()[-1] == "rotate"


# switching on


def test_a_cold_device_boots_spins_up_and_measures_by_itself_when_told_to() -> None:
    rig = Rig({"start": "cold", "mode": "measure"})
    rig.put(request(0x0102))
    rig.run(10 * SECOND)
    assert rig.modes() == ["booting", "spinning up", "measure"]
    assert rig.dropped() == [DropReason.BOOTING]
    times = [event.at_ns for event in rig.events if type(event).__name__ == "ModeChanged"]
    assert times == [0, 3000 * MS, 4500 * MS]


def test_a_host_that_takes_over_ends_what_the_device_would_do_by_itself() -> None:
    rig = Rig({"start": "cold", "mode": "measure"})
    rig.run(3500 * MS)
    assert words(rig.ask(0x0402)) == [0x8402, 0, 1]
    rig.run(10 * SECOND)
    assert rig.modes()[-1] == "idle"


def test_a_power_cycle_forgets_hosts_requests_and_begins_to_count_anew() -> None:
    rig = measuring()
    rig.put(request(0x0301, 0, 0x0002))
    rig.run(SECOND)
    rig.put(request(0x0102)[:5])
    rig.session.power_on(rig.now_ns)
    rig.take()
    rig.run(SECOND)
    assert rig.take() == []
    rig.put(request(0x0301, 1, 0x0002))
    rig.run(SECOND)
    (profile,) = profiles(rig)
    assert profile.counter is not None
    assert profile.counter < 20
    epochs = [plan.epoch for plan in rig.plans]
    assert epochs == sorted(epochs)
    assert len({(plan.epoch, plan.sweep) for plan in rig.plans}) == len(rig.plans)


def test_the_serial_line_is_set_to_the_configured_speed_and_changes_behind_the_reply() -> None:
    rig = Rig({"baud": 9600}, ten_metres, LinkKind.SERIAL, Address(0, 0))
    rig.run(0)
    (speed,) = rig.take()
    assert (speed.payload, speed.line_speed, speed.address) == (b"", 9600, Address(0, 0))
    rig.put(package(0x1410, 8, 0, 0x0201, 1, 5, 0, 1, 8))
    rig.run(SECOND)
    (reply,) = rig.take()
    assert reply.line_speed == 57600
    assert read_packages(reply.payload) == [(0x1014, [0x8201, 0])]
    rig.put(package(0x1410, 8, 0, 0x0201, 1, 5, 0, 1, 8))
    rig.run(SECOND)
    (reply,) = rig.take()
    assert reply.line_speed is None  # nothing has changed


def test_a_host_on_tcp_can_change_the_speed_of_the_serial_line() -> None:
    rig = Rig()
    rig.session.connected(0, Address(3, 0), LinkKind.SERIAL)
    rig.ask(0x0201, 1, 2, 0, 1, 8)
    rig.run(SECOND)
    (speed,) = rig.take(Address(3, 0))
    assert (speed.payload, speed.line_speed) == (b"", 9600)


def test_a_new_sensor_id_moves_the_device_on_can() -> None:
    rig = Rig({}, ten_metres, LinkKind.CAN, Address(0, 0))

    def ask(identity: int, *message: int) -> list[str]:
        for data in can_frames(identity, *message):
            rig.put(data, Address(0, 0x2AB))
        rig.run(SECOND)
        return [f"{emission.address.peer:03X} {emission.payload.hex()}" for emission in rig.take() if emission.address]

    assert ask(0x10, 0x0102) == ["710 ffff000200038102", "710 000100000001"]
    ask(0x10, 0x0201, 0x0010, 0x20, 10, 8)
    assert ask(0x10, 0x0102) == []
    assert ask(0x20, 0x0102) == ["720 ffff000200038102", "720 000100000001"]
    assert DropReason.OTHER_ADDRESS in rig.dropped()


def test_the_bus_runs_at_the_speed_the_device_was_set_up_for() -> None:
    assert Rig({}).session.can_bitrate == 1_000_000
    assert Rig({"can_kbit_s": 250}).session.can_bitrate == 250_000


def test_a_bus_speed_that_a_host_stores_is_told_again_and_does_not_move_the_bus() -> None:
    host = Address(0, 0x2AB)
    rig = Rig({"mode": "measure", "delays": "fast", "step_deg": 1}, ten_metres, LinkKind.CAN, Address(0, 0))
    for message in ((0x0201, 0x0002, 3, 0x2A8, 7, 0x700, 0xFFFF), (0x0202, 0x0002), (0x0301, 1, 0x0100)):
        for data in can_frames(0x10, *message):
            rig.put(data, host)
        rig.run(SECOND)
    sent = [emission for emission in rig.take() if emission.label == "8301"]
    assert len(sent) == 122
    assert sent[-1].due_ns - sent[0].due_ns < 17 * MS  # 121 frames of at most 135 bits at 1 Mbit/s, not at 125 kbit/s
    assert rig.session.can_bitrate == 1_000_000


def test_frames_of_others_on_the_bus_are_left_alone() -> None:
    rig = Rig({}, ten_metres, LinkKind.CAN, Address(0, 0))
    for identifier in (0x100, 0x2B0, 0x710, 0x2AB | 1 << 31):
        rig.put(bytes.fromhex("0000 0010 0102"), Address(0, identifier))
    rig.run(SECOND)
    assert rig.take() == []
    assert rig.dropped() == [DropReason.OTHER_ADDRESS] * 4
    rig.put(bytes.fromhex("0000 0010 0102"), Address(0, 0x2A9))
    rig.run(SECOND)
    assert [emission.payload.hex() for emission in rig.take()] == ["ffff000200018102", "000100000001"]


def test_a_broadcast_identifier_is_heard_when_one_is_set() -> None:
    rig = Rig({}, ten_metres, LinkKind.CAN, Address(0, 0))
    rig.session.connected(0, TCP._replace(link=1), LinkKind.STREAM)
    rig.ask(0x0201, 2, 6, 0x2A8, 7, 0x700, 0x100, address=TCP._replace(link=1))
    rig.put(bytes.fromhex("0000 0010 0102"), Address(0, 0x100))
    rig.run(SECOND)
    assert [emission.label for emission in rig.take()] == ["8102", "8102"]


# what breaks, and what is asked while it starts anew


def test_what_follows_a_reset_in_the_same_bytes_is_lost() -> None:
    rig = Rig({"delays": "fast"})
    rig.put(request(0x0401, 1) + request(0x0102))
    rig.run(SECOND)
    assert [emission.label for emission in rig.take()] == ["8401"]
    assert rig.dropped() == [DropReason.BOOTING]


def test_a_motor_that_runs_wrong_is_told_in_every_status_and_heals() -> None:
    rig = measuring()
    rig.put(request(0x0301, 0, 0x2000))
    rig.run(150 * MS)
    rig.session.fail_motor(rig.now_ns, Motor.TOO_FAST)
    rig.run(100 * MS)
    rig.session.fail_motor(rig.now_ns, Motor.STOPPED)
    rig.run(SECOND)
    assert [profile.status for profile in profiles(rig)] == [0x03, 0x93]
    assert words(rig.ask(0x0403, 0)) == [0x8403, 0, 0xB4]
    assert words(rig.ask(0x0404)) == [0xFF00, 0, 0, 0, 0xB4]
    rig.session.fail_motor(rig.now_ns, Motor.OK)
    assert words(rig.ask(0x0102)) == [0x8102, 0, 1]
    assert words(rig.ask(0x0403, 0)) == [0x8403, 0, 2]


def test_a_host_may_ask_for_one_format_after_the_other() -> None:
    rig = measuring({"step_deg": 90})
    for form in range(0, 0x3FFF, 0x0101):
        rig.put(request(0x0301, 1, form | 0x0020))
        rig.run(250 * MS)
    forms = [profile.form for profile in profiles(rig)]
    assert forms == [form | 0x0020 for form in range(0, 0x3FFF, 0x0101)]
