"""Start-up traces of the drivers, with their time limits, against a device in virtual time."""

from __future__ import annotations

from itertools import pairwise

import pytest

from tests.protocols.lms2xx import hosts
from tests.protocols.lms2xx.hosts import HostFailure
from tests.protocols.lms2xx.rig import SECOND, Rig, rate_hz, wall


def distances(values: object) -> set[int]:
    return set(values.values.tolist())  # type: ignore[attr-defined]


# --- sicktoolbox ---


@pytest.mark.parametrize(("baud", "hz"), [(9600, 1.293), (19200, 2.5), (38400, 4.6875), (500_000, 37.5)])
def test_sicktoolbox_connects_and_streams_at_the_rate_of_the_line(baud: int, hz: float) -> None:
    host = hosts.Sicktoolbox(Rig.on())
    host.connect(baud)
    assert host.rig.now_ns < SECOND
    assert b"LMS291;S05" in host.type_text
    scans = host.stream("20 24", 0xB0, 6)
    assert all(scan.header.count == 361 and distances(scan) == {1234} for scan in scans)
    assert rate_hz(host.rig.scans()) == pytest.approx(hz, abs=5e-4)
    host.leave()
    assert host.rig.session.line_speed == 9600


@pytest.mark.parametrize(("left_at", "seconds"), [(19200, 4.5), (38400, 7.5), (500_000, 10.5)])
def test_sicktoolbox_finds_a_device_left_at_another_rate(left_at: int, seconds: float) -> None:
    first = hosts.Sicktoolbox(Rig.on())
    first.connect(left_at)
    first.rig.set_speed(9600)
    begin_ns = first.rig.now_ns
    first.connect(38400 if left_at != 38400 else 19200)
    assert (first.rig.now_ns - begin_ns) / SECOND < seconds


def test_sicktoolbox_finds_a_device_that_streams_at_38400() -> None:
    host = hosts.Sicktoolbox(Rig.on())
    host.connect()
    host.stream("20 24", 0xB0, 2)
    host.rig.set_speed(9600)
    host.connect()
    assert host.rig.session.device.mode == 0x25


def test_sicktoolbox_sub_ranges_means_and_partial_scans() -> None:
    host = hosts.Sicktoolbox(Rig.on())
    host.connect(500_000)
    assert [s.header.count for s in host.stream("20 27 0A 00 14 00", 0xB7, 2)] == [11, 11]
    means = host.stream("20 26 05", 0xB6, 3, 15.0)
    assert all(scan.scans == 5 and scan.header.count == 361 for scan in means)
    assert all(s.first == 3 and s.scans == 2 for s in host.stream("20 28 02 03 00 09 00", 0xBF, 2, 15.0))
    host.set_variant(100, 25)
    assert [s.header.count for s in host.stream("20 24", 0xB0, 1)] == [401]
    partial = host.stream("20 2A", 0xB0, 8)
    assert [s.header.partial for s in partial] == [0, 1, 2, 3, 0, 1, 2, 3]
    assert [s.header.count for s in partial[:4]] == [181, 180, 180, 180]


def test_sicktoolbox_writes_its_configuration_and_the_device_measures_with_it() -> None:
    host = hosts.Sicktoolbox(Rig.on())
    host.connect()
    block = bytearray(host.block)
    block[3], block[4], block[5], block[6] = 3, 2, 6, 1
    host.write_block(bytes(block))
    scan = host.stream("20 24", 0xB0, 1)[0]
    assert scan.header.unit == 1
    assert distances(scan) == {12340}
    assert scan.indices is not None
    assert host.rig.plans[-1].gain == pytest.approx((42 / 30) ** 2)


@pytest.mark.parametrize("boot_s", [2.0, 20.0])
def test_sicktoolbox_resets_the_device_and_waits_for_its_power_on_telegram(boot_s: float) -> None:
    host = hosts.Sicktoolbox(Rig.on(boot_s=boot_s))
    host.connect()
    host.reset()
    assert host.stream("20 24", 0xB0, 1)


def test_sicktoolbox_gives_up_when_the_power_on_telegram_takes_longer_than_its_30_s() -> None:
    host = hosts.Sicktoolbox(Rig.on(boot_s=35.0))
    host.connect()
    with pytest.raises(HostFailure, match="30 s"):
        host.reset()


def test_sicktoolbox_streams_range_and_reflectivity_of_an_s14() -> None:
    host = hosts.Sicktoolbox(Rig.on("sick-lms291-s14"))
    host.connect()
    scans = host.stream("20 50 01 00 B5 00", 0xC4, 4)
    assert all(s.header.count == 181 and len(s.extra) == 181 and s.status == 0x18 for s in scans)
    assert rate_hz(host.rig.scans()) == pytest.approx(6.818, abs=1e-3)


def test_sicktoolbox_fails_with_a_device_of_address_1_as_it_does_in_reality() -> None:
    host = hosts.Sicktoolbox(Rig.on(address=1))
    with pytest.raises(HostFailure):
        host.connect()


# --- MRPT ---


@pytest.mark.parametrize(
    ("baud", "unit", "variant", "count", "hz"),
    [
        (9600, "cm", "3B B4 00 32 00", 361, 1.293),
        (38400, "cm", "3B B4 00 32 00", 361, 4.6875),
        (38400, "cm", "3B 64 00 32 00", 201, 7.5),
        (38400, "cm", "3B 64 00 64 00", 101, 15.0),
        (500_000, "cm", "3B B4 00 32 00", 361, 37.5),
        (500_000, "mm", "3B B4 00 64 00", 181, 75.0),
    ],
)
def test_mrpt_connects_and_streams(baud: int, unit: str, variant: str, count: int, hz: float) -> None:
    host = hosts.Mrpt(Rig.on())
    host.connect(baud, unit, variant)
    scans = host.scans(5, 0xB0, 2.0)
    assert all(s.header.count == count for s in scans)
    assert distances(scans[0]) == {12340 if unit == "mm" else 1234}
    assert rate_hz(host.rig.scans()) == pytest.approx(hz, abs=5e-4)


def test_mrpt_says_at_an_equal_rate_what_was_captured() -> None:
    host = hosts.Mrpt(Rig.on())
    host.connect(9600)
    said = [event.command for event in host.rig.events if hasattr(event, "command")]
    assert said == ["20 25", "31", "20 00", "74", "77", "20 25", "3B", "20 24"]


def test_mrpt_finds_a_device_left_streaming_at_500000() -> None:
    host = hosts.Mrpt(Rig.on())
    host.connect(500_000)
    host.scans(3, 0xB0, 1.0)
    begin_ns = host.rig.now_ns
    host.connect(38400)
    assert host.scans(2, 0xB0, 2.0)[0].header.count == 361
    assert (host.rig.now_ns - begin_ns) / SECOND < 8


def test_mrpt_never_tries_19200() -> None:
    rig = Rig.on()
    hosts.Sicktoolbox(rig).connect(19200)
    with pytest.raises(HostFailure, match="no device"):
        hosts.Mrpt(rig).connect(38400)


def test_mrpt_refuses_a_rate_change_of_a_special_device_as_it_does_in_reality() -> None:
    with pytest.raises(HostFailure, match="exactly 10"):
        hosts.Mrpt(Rig.on("sick-lms291-s14")).connect(38400)


@pytest.mark.parametrize(("write_s", "passes"), [(0.55, True), (0.65, False)])
def test_mrpt_gives_the_configuration_600_ms(write_s: float, passes: bool) -> None:
    host = hosts.Mrpt(Rig.on(delays={"write_s": write_s, "same_write_s": write_s}))
    if passes:
        host.connect(9600, "mm")
    else:
        with pytest.raises(HostFailure):
            host.connect(9600, "mm")


@pytest.mark.parametrize(("ack_s", "passes"), [(0.005, True), (0.045, True), (0.1, False)])
def test_mrpt_needs_its_ack_early(ack_s: float, passes: bool) -> None:
    host = hosts.Mrpt(Rig.on(delays={"ack_s": ack_s}))
    if passes:
        host.connect(9600)
    else:
        with pytest.raises(HostFailure):
            host.connect(9600)


# --- Player ---


def test_player_connects_by_default_in_mm_with_reflectivity() -> None:
    host = hosts.Player(Rig.on())
    host.connect()
    scans = host.stream(4)
    assert rate_hz(host.rig.scans()) == pytest.approx(4.6875, abs=5e-4)
    assert distances(scans[0]) == {0x1FF7}, "12.34 m is beyond 8.182 m"
    assert host.rig.session.device.configuration[2:4] == b"\x46\x00", "seven bytes were written, the rest kept"


def test_player_takes_a_quarter_degree_as_a_sub_range_of_401_points() -> None:
    host = hosts.Player(Rig.on())
    host.connect(38400, "00 00 00", (100, 25))
    scans = host.stream(4, 1, 401)
    assert all(s.header.count == 401 for s in scans)
    assert rate_hz(host.rig.scans()) == pytest.approx(4.6875, abs=5e-4), "816 bytes fit in 213.3 ms"


def test_player_restarts_while_the_device_still_streams() -> None:
    host = hosts.Player(Rig.on())
    host.connect(38400, "00 00 00", (180, 100))
    host.stream(2, 1, 181)
    host.connect(38400, "00 00 00", (180, 100))
    assert host.stream(2, 1, 181)[0].header.count == 181


@pytest.mark.parametrize("model", ["sick-lms200-30106", "sick-lms221-30206", "sick-lms211-s14"])
def test_player_makes_its_password_from_the_type_text_of_every_model(model: str) -> None:
    rig = Rig.on(model)
    hosts.Player(rig).connect(38400, "00 00 00", (90, 50) if "s14" in model else (180, 50))
    assert rig.session.device.mode == 0x00


# --- ARIA ---


@pytest.mark.parametrize(
    ("unit", "mode", "variant", "hz"),
    [
        ("01", "01", "3B B4 00 64 00", 9.375),
        ("00", "03", "3B B4 00 32 00", 4.6875),
        ("02", "05", "3B 64 00 32 00", 7.5),
    ],
)
def test_aria_streams_directly_from_installation_mode(unit: str, mode: str, variant: str, hz: float) -> None:
    host = hosts.Aria(Rig.on())
    host.connect(38400, unit, mode, variant)
    scans = host.scans(4, 0xB0, 1.0)
    assert rate_hz(host.rig.scans()) == pytest.approx(hz, abs=5e-4)
    assert scans[0].header.unit == int(unit)
    host.leave()
    assert host.rig.session.line_speed == 9600


def test_aria_works_with_a_device_that_streams_at_38400_already() -> None:
    host = hosts.Aria(Rig.on())
    host.connect()
    host.scans(2, 0xB0, 1.0)
    host.rig.set_speed(9600)
    host.connect()
    assert host.scans(1, 0xB0, 1.0)


def test_aria_waits_out_a_configuration_of_seven_seconds() -> None:
    host = hosts.Aria(Rig.on("sick-lms200-30106", delays={"write_s": 7.0}))
    host.connect()
    assert host.scans(1, 0xB0, 1.0)


# --- CARMEN ---


@pytest.mark.parametrize(("baud", "hz"), [(38400, 4.6875), (500_000, 37.5)])
def test_carmen_sends_three_requests_in_a_row_around_the_rate_change(baud: int, hz: float) -> None:
    host = hosts.Carmen(Rig.on())
    host.connect(baud)
    host.stream(5)
    assert rate_hz(host.rig.scans()) == pytest.approx(hz, abs=5e-4)


def test_carmen_streams_interlaced_and_in_range_and_intensity() -> None:
    host = hosts.Carmen(Rig.on())
    host.connect(38400, "3B 64 00 19 00")
    assert [s.header.partial for s in host.stream(4, "20 2A")] == [0, 1, 2, 3]
    host.connect(38400)
    scans = host.stream(3, "20 2B 01 00 01 00 B5 00", 0xF5)
    assert all(s.header.count == 181 and len(s.extra) == 181 for s in scans)


def test_carmen_gives_up_on_a_configuration_of_300_ms() -> None:
    with pytest.raises(HostFailure, match="250 ms"):
        hosts.Carmen(Rig.on(delays={"write_s": 0.3})).connect()


# --- Robotics Library ---


@pytest.mark.parametrize(("baud", "poll_hz"), [(9600, 1.2), (38400, 3.5)])
def test_robotics_library_polls(baud: int, poll_hz: float) -> None:
    host = hosts.RoboticsLibrary(Rig.on("sick-lms200-30106", firmware="V02.09"))
    host.connect(baud)
    scans = host.poll(4)
    assert distances(scans[0]) == {0x1FF7}
    assert rate_hz(host.rig.scans()) > poll_hz


def test_robotics_library_streams_skips_scans_while_it_waits_and_leaves() -> None:
    host = hosts.RoboticsLibrary(Rig.on("sick-lms200-30106", firmware="V02.09"))
    host.connect(500_000)
    host.require(host.acknowledged("20 24", 0.06), "ACK")
    host.scans(10, 0xB0, 1.0)
    host.leave()
    assert host.rig.session.line_speed == 9600


@pytest.mark.parametrize(("ack_s", "passes"), [(0.055, True), (0.065, False)])
def test_robotics_library_gives_the_ack_60_ms(ack_s: float, passes: bool) -> None:
    host = hosts.RoboticsLibrary(Rig.on("sick-lms200-30106", delays={"ack_s": ack_s}, firmware="V02.09"))
    if passes:
        host.connect(9600)
    else:
        with pytest.raises(HostFailure):
            host.connect(9600)


def test_robotics_library_fails_with_the_34_byte_block_as_it_does_in_reality() -> None:
    with pytest.raises(HostFailure, match="exactly 34"):
        hosts.RoboticsLibrary(Rig.on("sick-lms291-s05")).connect()


# --- the others ---


def test_gearbox_connects_and_its_block_comes_back_unchanged() -> None:
    host = hosts.GearBox(Rig.on())
    host.connect()
    assert host.scans(2, 0xB0, 1.0)[0].indices is None


def test_gearbox_takes_pollution_for_an_error() -> None:
    with pytest.raises(HostFailure, match="status byte"):
        hosts.GearBox(Rig.on(pollution=True)).connect()


def test_dgc_streams_an_s14_at_75_hz() -> None:
    host = hosts.Dgc(Rig.on("sick-lms291-s14"))
    host.connect()
    host.stream(20)
    assert rate_hz(host.rig.scans()) == pytest.approx(75.0, abs=1e-6)


def test_mit_reads_indices_that_count_mirror_turns() -> None:
    host = hosts.Mit(Rig.on(baud=500_000))
    host.connect()
    scans = host.stream("20 2A", 0xB0, 20)
    indices = [s.indices for s in scans if s.indices is not None]
    assert all((b[0] - a[0]) % 256 == 1 for a, b in pairwise(indices))
    assert all((b[1] - a[1]) % 256 == 1 for a, b in pairwise(indices))


def test_mit_reads_intensities_of_a_hundred_beams() -> None:
    host = hosts.Mit(Rig.on(baud=500_000))
    host.connect(intensities=True)
    scans = host.stream("20 2B 01 00 96 00 FA 00", 0xF5, 3)
    assert all(s.header.count == 101 and s.first == 150 for s in scans)
    assert set(scans[0].extra.tolist()) == {9322}, "7000 + 1000 log2(5)"


def test_rack_gets_its_printed_a0() -> None:
    hosts.Rack(Rig.on()).connect()


def test_rack_bears_the_mode_changes_of_the_real_profile() -> None:
    hosts.Rack(Rig.on(delays="real")).connect()


def test_epfl_reads_the_ack_before_the_header() -> None:
    hosts.Epfl(Rig.on("sick-lms200-30106")).connect()


def test_manorajesh_configures_mm_and_the_type_text_tells_it() -> None:
    host = hosts.Manorajesh(Rig.on("sick-lms200-30106", wall(3.0)))
    host.connect()
    assert host.type_text == b"LMS200;301063;V02.10 "
    assert host.transact("3A", 0xBA, 1.0).data[:-1] == b"LMS200;301063;V02.10 "
    host.transact("20 24", 0xA0, 3.5)
    assert distances(host.scans(1, 0xB0, 1.0)[0]) == {3000}


def test_orca_gets_its_ack_within_6_ms_and_a_reply() -> None:
    assert hosts.Orca(Rig.on()).probe() == 0xB0


@pytest.mark.parametrize("host", [hosts.Sicktoolbox, hosts.Aria, hosts.Manorajesh])
def test_drivers_with_long_time_outs_bear_the_real_delays(host: type[hosts.Host]) -> None:
    rig = Rig.on(delays="real")
    made = host(rig)
    made.connect()  # type: ignore[attr-defined]
    assert rig.session.device.settings.delays.boot_s == 25.0
