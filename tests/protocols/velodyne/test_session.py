"""A Velodyne in virtual time: what fires when, settings, the clock, position packets, the web interface."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from protocols.quartz import Quartz
from protocols.scan import Scan, ScanPlan
from protocols.session import Address, DropReason, LinkKind
from protocols.timebase import Timebase
from protocols.velodyne import FAMILY, codec
from protocols.velodyne.models import MODELS, MODES, Mode
from tests.protocols.velodyne.rig import DATA, POSITION, SECOND, WEB, Rig, firings, packets, stamps


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("name", MODELS)
def test_packets_leave_at_the_rate_of_the_model_when_their_last_laser_has_fired(name: str, mode: Mode) -> None:
    model = MODELS[name]
    rig = Rig({"returns": mode}, name)
    sent = packets(rig.run(0.2))
    packet_ns = model.packet_ns(mode)
    assert len(sent) == 200_000_000 // packet_ns
    assert [one.due_ns for one in sent] == [(at + 1) * packet_ns for at in range(len(sent))]
    assert [abs(stamp - (at * packet_ns + model.stamp_ns) / 1000) < 1.0 for at, stamp in enumerate(stamps(sent))]
    assert sum(one.scans for one in sent if one.sweep is not None) == len({one.sweep for one in sent} - {None})


@pytest.mark.parametrize("name", MODELS)
def test_every_laser_is_asked_for_at_its_own_instant_azimuth_and_elevation(name: str) -> None:
    model = MODELS[name]
    rig = Rig({"rpm": 1200}, name)
    rig.run(0.05)
    for plan in rig.plans:
        at_ns = plan.start_ns + 1e9 * plan.fire_offset_s.reshape(-1, model.lasers)
        assert at_ns[0] - plan.start_ns == pytest.approx(model.laser_ns)
        head_deg = 1200 / 60 * 360 * 1e-9 * at_ns
        azimuth_deg = np.asarray(model.offset_deg) - head_deg
        away = np.degrees(plan.azimuth_rad.reshape(at_ns.shape)) - azimuth_deg
        assert np.abs((away + 180.0) % 360.0 - 180.0).max() < 1e-6
        assert np.degrees(plan.elevation_rad.reshape(at_ns.shape)) == pytest.approx(
            np.tile(model.elevation_deg, (len(at_ns), 1))
        )


def test_a_turn_is_asked_for_in_slices_without_gaps() -> None:
    rig = Rig({"slice_packets": 3}, "velodyne-hdl-32e")
    rig.run(0.1)
    starts = [plan.start_ns for plan in rig.plans]
    assert set(np.diff(starts)) == {3 * 552_960}
    assert [plan.sweep for plan in rig.plans] == list(range(len(starts)))
    assert {len(plan) for plan in rig.plans} == {3 * 12 * 32}


@pytest.mark.parametrize(("rpm", "step_cdeg"), [(300, 19.9), (600, 39.8), (1200, 79.6), (617, 40.9)])
def test_the_rate_of_rotation_sets_the_step_between_blocks(rpm: int, step_cdeg: float) -> None:
    heads = firings(Rig({"rpm": rpm}).run(0.5)).azimuth_cdeg[:, ::2]
    steps = np.diff(heads.ravel()) % 36_000
    assert steps.mean() == pytest.approx(step_cdeg, abs=0.05)
    assert steps.max() - steps.min() <= 1


def test_it_sends_dark_packets_until_the_motor_is_fast_enough() -> None:
    rig = Rig({"boot_s": 0.5, "spin_up_s": 2.0})
    assert packets(rig.run(0.5)) == []
    said = firings(rig.run(2.5))
    lit = said.distance[0].any(axis=(1, 2))
    first = int(np.argmax(lit))
    assert 0.5 + first * 1.327104e-3 == pytest.approx(2.0 * 4.5 / 10.0, abs=0.01)  # 270 of 600 a minute
    assert lit[first:].all()
    assert np.diff(said.stamp_us).max() <= 1328  # no gap
    steps = np.diff(said.azimuth_cdeg[:, 0]) % 36_000
    assert (np.diff(steps[: first + 100]) >= -1).all()  # ever faster


def test_the_world_is_as_bright_as_it_is_and_as_far() -> None:
    rig = Rig()
    said = firings(rig.run(0.1))
    assert set(said.distance.ravel()) == {5000}
    assert set(said.reflectivity.ravel()) == {50}  # 62.5 times the threshold at 10 m; white would be 125


def test_dual_mode_sends_last_and_strongest() -> None:
    def two(plan: ScanPlan) -> Scan:
        scan = Scan.empty(plan, 3)
        scan.range_m[:, 0], scan.intensity[:, 0] = 4.0, 9.0
        scan.range_m[:, 1], scan.intensity[:, 1] = 6.0, 2.0
        return scan

    rig = Rig({"returns": "dual"})
    rig.world = two
    said = firings(rig.run(0.1))
    assert set(said.distance[0].ravel()) == {3000}
    assert set(said.distance[1].ravel()) == {2000}


@pytest.mark.parametrize(("fov", "kept"), [((10, 40), 30), ((350, 9), 19), ((0, 359), 360), ((90, 89), 360)])
def test_only_the_field_of_view_is_measured_and_sent(fov: tuple[int, int], kept: int) -> None:
    rig = Rig({"fov_deg": list(fov)})
    said = firings(rig.run(1.0))
    heads = said.azimuth_cdeg[said.distance[0].any(axis=2)]
    deg = (heads - 100 * fov[0]) % 36_000 / 100.0
    assert deg.max() <= (fov[1] - fov[0]) % 360 + 1.0
    assert len(heads) / (1.0 / 55.296e-6) == pytest.approx(kept / 360.0, rel=0.06)
    assert len(said.stamp_us) <= 754 * (kept + 12) / 360
    assert sum(len(plan) for plan in rig.plans) == pytest.approx(1.25 * 16 * len(heads), rel=0.1)  # with the look-ahead
    assert {one.reason for one in rig.dropped} <= {DropReason.KEPT}
    numbers = [plan.sweep for plan in rig.plans] + [n for one in rig.dropped for n in one.sweeps or ()]
    assert sorted(numbers) == list(range(len(numbers)))


# ------------------------------------------------------------ the clock


def test_without_pulses_the_clock_counts_from_power_on_and_wraps_at_the_hour() -> None:
    rig = Rig()
    rig.session.clock = rig.session.clock.set_to(0, 3_600 * SECOND - 50_000_000)
    said = stamps(rig.run(0.1))
    assert max(said) < codec.HOUR_US
    assert sum(b < a for a, b in pairwise(said)) == 1
    assert set(np.diff(said) % codec.HOUR_US) == {1327, 1328}


def test_pulses_with_sentences_lock_the_clock_to_utc() -> None:
    rig = Rig({"pps": True, "nmea": True, "utc": "2026-03-01T10:20:30.250000"})
    rig.session.clock = rig.session.clock.at_rate(0, 100_000)  # 100 ppm fast
    rig.run(5.0)
    true_us = (20 * 60 + 30.25) * 1e6
    sent = packets(rig.sent)
    for one, stamp in list(zip(sent, stamps(sent), strict=True))[-700:]:
        begun_ns = one.due_ns - 1_327_104
        assert abs(stamp - (true_us + begun_ns / 1000)) <= 100 + 1  # what 100 ppm gain in a second
    assert stamps(sent)[100] < 1_000_000  # before: since power-on
    states = [one.payload[202] for one in rig.sent if one.address == POSITION]
    assert [a for a, b in zip(states, [*states[1:], None], strict=True) if a != b] == [0, 1, 2]


def test_pulses_alone_do_not_lock_and_sentences_alone_are_passed_on() -> None:
    alone = Rig({"pps": True})
    alone.run(6.0)
    assert alone.get("/cgi/status.json")["gps"] == {"pps_state": "Synchronizing", "position": ""}
    assert max(stamps(alone.sent)) < 7_000_000
    spoken = Rig({"nmea": True})
    spoken.run(6.0)
    assert spoken.get("/cgi/status.json")["gps"]["pps_state"] == "Absent"
    assert spoken.get("/cgi/status.json")["gps"]["position"].startswith("$GPRMC,120006.00,A")


def test_a_clock_that_loses_the_pulses_goes_on_from_the_last_one() -> None:
    rig = Rig({"pps": True, "nmea": True, "utc": "2026-03-01T10:00:00"})
    rig.session.clock = rig.session.clock.at_rate(0, 100_000)
    rig.run(5.5)
    assert rig.session.impair(rig.now_ns, "no pps", 1.0)
    assert rig.get("/cgi/status.json")["gps"]["pps_state"] == "Absent"
    rig.run(10.0)
    last = packets(rig.sent)[-1]
    drift_us = stamps([last])[0] - (last.due_ns - 1_327_104) / 1000
    assert drift_us == pytest.approx(100e-6 * 10.5e6, abs=3)  # since the pulse at 5 s
    assert rig.session.impair(rig.now_ns, "no pps", 0.0)
    rig.run(4.0)
    last = packets(rig.sent)[-1]
    assert abs(stamps([last])[0] - (last.due_ns - 1_327_104) / 1000) <= 101


def test_pulses_come_at_true_seconds_whatever_the_quartz_does() -> None:
    inner = FAMILY.new_session(
        {"boot_s": 0.0, "spin_up_s": 0.0, "pps": True, "nmea": True, "utc": "2026-03-01T10:00:00"}, {}
    )
    rig = Rig(session=Timebase(inner, Quartz().at_rate(0, 2_000_000)))  # 0.2 per cent
    rig.run(8.0)
    for one, stamp in list(zip(packets(rig.sent), stamps(rig.sent), strict=True))[-300:]:
        begun_us = (one.due_ns - 1_327_104) / 1000
        assert -5 <= stamp - begun_us <= 2_005  # at most what it gains in a second


def test_the_phase_lock_brings_the_head_to_its_angle_at_every_pulse() -> None:
    rig = Rig(
        {"pps": True, "nmea": True, "phase_lock": True, "phase_deg": 90.0, "rpm": 600, "utc": "2026-03-01T10:00:00.4"}
    )
    rig.run(12.0)
    for second in (8.6, 9.6, 10.6):
        turns = rig.session.motor.turns(np.array([round(second * 1e9)]))
        assert float(turns[0]) % 1.0 == pytest.approx(0.25, abs=1e-6)
    heads = firings(rig.run(0.5)).azimuth_cdeg[:, ::2]
    steps = np.diff(heads.ravel()) % 36_000
    assert steps.max() - steps.min() <= 1
    assert rig.get("/cgi/status.json")["motor"]["lock"] == "On"
    rig.post("/cgi/setting", "rpm=333")  # a fraction of a turn each second, more than the lock can make up for
    rig.run(8.0)
    assert rig.get("/cgi/status.json")["motor"]["lock"] == "Off"
    rig.post("/cgi/setting", "rpm=1200")
    rig.run(1.0)
    rig.post("/cgi/setting/phaselock", "offset=27000")
    rig.run(0.05)
    assert rig.get("/cgi/status.json")["motor"]["lock"] == "Off"
    rig.run(12.0)
    assert rig.get("/cgi/status.json")["motor"]["lock"] == "On"
    free = Rig({"pps": True, "nmea": True, "rpm": 600, "utc": "2026-03-01T10:00:00.4"})
    free.run(12.0)
    assert abs(float(free.session.motor.turns(np.array([round(10.6e9)]))[0]) % 1.0 - 0.25) > 0.1


def test_position_packets_come_at_their_rate_with_the_sentence_of_the_second() -> None:
    rig = Rig({"nmea": True, "utc": "2016-01-21T08:18:02", "latitude_deg": 36.829131, "longitude_deg": -2.407572})
    sent = [one for one in rig.run(2.0) if one.address == POSITION]
    assert len(sent) == 2 * SECOND // 6_821_780 + 1
    assert {len(one.payload) for one in sent} == {512}
    reported = {one.payload[206:249] for one in sent}
    assert reported == {f"$GPRMC,08180{second}.00,A,3649.7479,N,00224.4543,W".encode() for second in (2, 3)}
    for one in sent:
        assert int.from_bytes(one.payload[198:202], "little") == one.due_ns // 1000


# ------------------------------------------------------------ the web interface


def test_settings_take_effect_with_the_next_slice_and_last_until_power_off() -> None:
    rig = Rig()
    rig.run(0.5)
    assert rig.post("/cgi/setting", "returns=Dual").startswith(b"HTTP/1.1 200 OK\r\n")
    rig.post("/cgi/setting", "rpm=1200")
    rig.run(0.6)
    said = packets(rig.run(0.1))
    assert {one.payload[1204] for one in said} == {0x39}
    assert np.median(np.diff(firings(said).azimuth_cdeg[-1, ::2])) == pytest.approx(79.6, abs=1.0)
    assert rig.get("/cgi/settings.json")["returns"] == "Dual"
    gaps = np.diff([one.due_ns for one in packets(rig.sent)])
    assert gaps.max() <= 1_327_104  # nothing is missing between
    rig.session.power_on(rig.now_ns)
    rig.session.connected(rig.now_ns, WEB, LinkKind.STREAM)
    assert rig.get("/cgi/settings.json")["rpm"] == 600
    rig.post("/cgi/setting", "rpm=900")
    assert rig.post("/cgi/save", "submit").startswith(b"HTTP/1.1 200")
    rig.session.power_on(rig.now_ns)
    assert rig.get("/cgi/settings.json")["rpm"] == 900


def test_the_laser_goes_off_and_on() -> None:
    rig = Rig()
    rig.run(0.5)
    rig.post("/cgi/setting", "laser=off")
    rig.run(0.05)
    assert not firings(rig.run(0.2)).distance.any()
    assert rig.session.next_plan() is None  # nothing is measured
    rig.post("/cgi/setting", "laser=on")
    rig.run(0.05)
    assert firings(rig.run(0.2)).distance.all()
    assert np.diff(stamps(rig.sent)).max() <= 1328


@pytest.mark.parametrize(
    ("path", "form"),
    [
        ("setting", "rpm=299"), ("setting", "rpm=1201"), ("setting", "rpm=6e2"), ("setting", "returns=Both"),
        ("setting", ""), ("setting", "laser=maybe"), ("setting", "volume=3"), ("setting", "rpm=900&laser=2"),
        ("setting/fov", "start=360"), ("setting/phaselock", "offset=36000"), ("setting/host", "port=3"),
        ("setting/net", "addr=" + 50 * "1"), ("setting", "rpm=%FF"),
    ],
)  # fmt: skip
def test_a_wrong_form_changes_nothing_and_is_on_record(path: str, form: str) -> None:
    rig = Rig()
    rig.run(0.1)
    before = rig.session.settings
    assert rig.post(f"/cgi/{path}", form).startswith(b"HTTP/1.1 200")  # as the device
    assert rig.session.settings == before
    assert [one.reason for one in rig.dropped if not one.reason.of_scans] == [DropReason.BAD_ARGUMENT]


def test_forms_of_drivers_are_understood() -> None:
    rig = Rig()
    rig.run(0.1)
    rig.post("/cgi/setting/fov", "start=290&end=70")
    rig.post("/cgi/setting/phaselock", "enabled=on&offset=9000")
    rig.post("/cgi/setting/host", "addr=10.0.0.2&dport=2369&tport=8309")
    rig.post("/cgi/setting/net", "dhcp=on")
    reported = rig.get("/cgi/snapshot.hdl")
    assert reported["config"]["fov"] == {"start": 290, "end": 70}
    assert reported["config"]["phaselock"] == {"enabled": "On", "offset": 9000}
    assert reported["config"]["host"] == {"addr": "10.0.0.2", "dport": "2369", "tport": "8309"}
    assert reported["config"]["net"]["dhcp"] == "on"
    assert reported["info"]["model"] == "VLP-16"
    counts = reported["diag"]["volt_temp"]["bot"]
    assert -1481.96 + np.sqrt(2.1962e6 + (1.8639 - counts["lm20_temp"] * 5 / 4096) / 3.88e-6) == pytest.approx(
        45.0, abs=0.2
    )
    assert 11.0 * counts["pwr_v_in"] * 5 / 4096 == pytest.approx(12.0, abs=0.01)


def test_a_reset_restarts_it_with_what_was_saved() -> None:
    rig = Rig({"boot_s": 0.3})
    rig.run(1.0)
    rig.post("/cgi/setting", "rpm=900")
    assert rig.post("/cgi/reset", "reset_system=reset_system").startswith(b"HTTP/1.1 200")
    assert packets(rig.run(0.2)) == []
    rig.run(0.3)
    assert rig.get("/cgi/settings.json")["rpm"] == 600
    assert min(stamps(rig.run(0.2))) < 1_000_000


def test_requests_in_any_chunking_and_what_is_none() -> None:
    rig = Rig()
    rig.run(0.1)
    whole = b"POST /cgi/setting HTTP/1.1\r\nhost: x\r\nCONTENT-length:  7 \r\n\r\nrpm=900"
    whole += b"GET /cgi/settings.json HTTP/1.0\r\n\r\n"
    for at in range(len(whole)):
        rig.session.receive(whole[at : at + 1], rig.now_ns, WEB)
    replies = [one.payload for one in rig.run(0.01) if one.address == WEB]
    assert [one.split(b" ")[1] for one in replies] == [b"200", b"200"]
    assert b'"rpm": 900' in replies[1]
    for request, status in (
        (b"GET /nothing HTTP/1.1\r\n\r\n", b"404"), (b"GET /cgi/setting HTTP/1.1\r\n\r\n", b"405"),
        (b"POST /cgi/setting HTTP/1.1\r\nContent-Length: -4\r\n\r\n", b"400"), (b"\x00\xff\r\n\r\n", b"400"),
        (b"POST /cgi/setting HTTP/1.1\r\nTransfer-Encoding: gzip\r\n\r\n", b"400"),
        (b"x" * 9000 + b"\r\n\r\n", b"400"),
    ):  # fmt: skip
        assert rig.ask(request).split(b" ")[1] == status, request
    assert rig.ask(b"GET /cgi/info.json HTTP/1.1\r\n\r\n").startswith(b"HTTP/1.1 200")  # and goes on


def test_datagrams_are_ignored() -> None:
    rig = Rig()
    rig.run(0.1)
    rig.session.receive(b"GET / HTTP/1.1\r\n\r\n", rig.now_ns, DATA)
    rig.run(0.01)
    assert [one.reason for one in rig.dropped] == [DropReason.UNKNOWN_COMMAND]


def test_packets_on_a_connection_are_those_of_the_datagrams() -> None:
    rig = Rig()
    rig.run(0.5)
    assert rig.ask(b"GET /packets HTTP/1.1\r\n\r\n").startswith(b"HTTP/1.1 200")
    rig.run(0.3)
    rig.sent.clear()
    rig.run(0.2)
    assert [one.payload for one in packets(rig.sent, WEB)] == [one.payload for one in packets(rig.sent)]
    rig.session.disconnected(rig.now_ns, WEB)
    assert packets(rig.run(0.2), WEB) == []


def test_a_second_pair_of_links_gets_the_same() -> None:
    session = FAMILY.new_session({"boot_s": 0.0, "spin_up_s": 0.0, "nmea": True}, {})
    for link in range(4):
        session.connected(0, Address(link, 0), LinkKind.DATAGRAM)
    rig = Rig(session=session)
    sent = rig.run(0.1)
    by_link = [[one.payload for one in sent if one.address == Address(link, 0)] for link in range(4)]
    assert by_link[0] == by_link[2]
    assert by_link[1] == by_link[3]
    assert {len(one) for one in by_link[1]} == {512}


def test_a_motor_that_is_wrong_or_stands() -> None:
    rig = Rig()
    rig.run(0.5)
    assert rig.session.impair(rig.now_ns, "motor speed", 0.9)
    rig.run(0.3)
    steps = np.diff(firings(rig.run(0.3)).azimuth_cdeg[:, ::2].ravel()) % 36_000
    assert steps.mean() == pytest.approx(0.9 * 39.8131, abs=0.05)
    assert rig.session.impair(rig.now_ns, "motor stopped", 1.0)
    rig.run(0.3)
    said = firings(rig.run(0.2))
    assert not said.distance.any()
    assert len(set(said.azimuth_cdeg.ravel())) == 1
    assert rig.session.impair(rig.now_ns, "motor stopped", 0.0)
    rig.run(0.3)
    assert firings(rig.run(0.2)).distance.all()
    assert not rig.session.impair(rig.now_ns, "window", 0.5)


@pytest.mark.parametrize(("fields", "ends"), [("", False), ("Connection: close\r\n", True)])
def test_a_connection_ends_with_the_reply_where_its_client_says_so(fields: str, ends: bool) -> None:
    rig = Rig()
    rig.session.receive(f"GET /cgi/status.json HTTP/1.1\r\n{fields}\r\n".encode(), rig.now_ns, WEB)
    (sent,) = (one for one in rig.run(0.002) if one.address == WEB)
    assert (sent.hangs_up, b"\r\nConnection: close\r\n" in sent.payload) == (ends, ends)
