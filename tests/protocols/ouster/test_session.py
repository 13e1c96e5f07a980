"""States, configuration and interfaces of an Ouster in virtual time."""

from __future__ import annotations

import io
import json
from http.client import HTTPResponse
from types import SimpleNamespace

import numpy as np
import pytest

from protocols import family
from protocols.errors import DeviceSettingError
from protocols.ouster import FAMILY, codec
from protocols.ouster.settings import SERIAL
from protocols.quartz import Quartz
from protocols.session import Address, LinkKind
from protocols.timebase import Timebase
from tests.protocols.ouster.rig import API, IMU, LIDAR, LINE, MS, QUICK, SECOND, WEB, Rig, lidar, points, said

STATUS = "sensor/metadata/sensor_info"


def test_from_power_on_to_running() -> None:
    rig = Rig({"boot_s": 0.5, "init_s": 1.0, "spin_up_s": 2.0, "warm_up_s": 1.5})
    assert rig.ask(b"GET / HTTP/1.1\r\n\r\n").startswith(b"HTTP/1.1 503 Service Unavailable\r\n")
    assert rig.ask(b"get_sensor_info\n", LINE) == b""
    seen = []
    for _ in range(12):
        sent = rig.run(0.5)
        status = rig.get(STATUS)["status"]
        seen.append((status, bool(lidar(sent))))
    assert (
        seen == [("INITIALIZING", False)] * 6 + [("WARMUP", False)] * 3 + [("RUNNING", False)] + [("RUNNING", True)] * 2
        or seen == [("INITIALIZING", False)] * 6 + [("WARMUP", False)] * 3 + [("RUNNING", True)] * 3
    )


@pytest.mark.parametrize(("mode", "period_us"), [("512x10", 3125.0), ("2048x10", 781.25), ("4096x5", 781.25)])
def test_packets_leave_at_their_rate_when_their_last_column_has_fired(mode: str, period_us: float) -> None:
    rig = Rig({"config": {"lidar_mode": mode}, "latency_ms": 1.0})
    sent = [one for one in rig.run(0.3) if one.label == "lidar"]
    steps = np.diff([one.due_ns for one in sent])
    assert np.abs(steps - 1000.0 * period_us).max() <= 1.0
    first = said(rig, sent).columns
    assert sent[0].due_ns - int(first.stamp_ns[0]) == pytest.approx(1e3 * period_us + MS, abs=20)
    assert first.number[:18].tolist() == list(range(18))
    assert all(one.reported is not None for one in sent)
    assert {plan.turn for plan in rig.plans} >= {0, 1}


def test_ranges_are_distance_and_offset_and_points_are_where_beams_end() -> None:
    rig = Rig({"own_calibration": True})
    sent = rig.run(0.2)
    columns = said(rig, sent).columns
    assert (columns.range_mm == 10_000 + round(1000 * rig.session.unit.origin_m)).all()
    assert (columns.reflectivity == 50).all()
    plan = rig.plans[0]
    az, el = plan.azimuth_rad, plan.elevation_rad
    d = np.stack((np.cos(az) * np.cos(el), np.sin(az) * np.cos(el), np.sin(el)), axis=1)
    assert plan.origin_m is not None
    truth = plan.origin_m + 10.0 * d
    found = points(rig, columns).reshape(-1, 3)[: len(truth)] * (-1.0, -1.0, 1.0)  # half a turn to the sensor's axes
    assert np.abs(found - truth).max() < 1e-3
    other = Rig({"own_calibration": True, "serial_number": 7}).session.unit
    assert (other.elevation_deg != rig.session.unit.elevation_deg).any()
    assert (np.diff(other.elevation_deg) < 0.0).all()


def test_the_conversation_of_a_driver_changes_mode_and_profile_and_ends_with_new_metadata() -> None:
    rig = Rig()
    rig.run(0.3)
    before = rig.get(STATUS)["initialization_id"]
    config = rig.get("sensor/config")
    assert (config["udp_dest"], config["udp_port_lidar"], config["udp_port_imu"]) == ("127.0.0.1", 7502, 7503)
    assert rig.call("POST", "sensor/config?reinit=False&persist=False", '{"udp_dest":"@auto"}')[0] == 204
    assert rig.get("sensor/config?staging=true")["udp_dest"] == "127.0.0.5"
    assert rig.get("sensor/config?staging=False")["udp_dest"] == "127.0.0.1"
    wanted = config | {
        "udp_profile_lidar": "RNG15_RFL8_NIR8",
        "lidar_mode": "2048x10",
        "udp_port_lidar": 7777,
        "new": 1,
    }
    assert rig.call("POST", "sensor/config?staging=true&reinit=false&persist=false", json.dumps(wanted))[0] == 204
    assert rig.get("sensor/config") == config
    assert rig.call("POST", "sensor/config?staging=true&reinit=true&persist=false", "{}")[0] == 204
    rig.run(0.1)
    info = rig.get(STATUS)
    assert (info["status"], info["initialization_id"] != before) == ("RUNNING", True)
    sent = rig.run(0.2)
    read = said(rig, sent)
    assert (read.init_id, read.serial) == (info["initialization_id"], SERIAL)
    assert {one.place for one in sent if one.label == "lidar"} == {("127.0.0.1", 7777)}
    assert {one.place for one in sent if one.label == "imu"} == {None}
    metadata = rig.get("sensor/metadata")
    parts = "sensor_info beam_intrinsics imu_intrinsics lidar_intrinsics lidar_data_format calibration_status"
    assert set(metadata) == {*parts.split(), "config_params"}
    assert metadata["config_params"] == {name: one for name, one in wanted.items() if name != "new"}
    assert metadata["lidar_data_format"]["columns_per_frame"] == 2048


def test_streams_stop_at_once_and_nothing_old_is_sent_while_it_initialises() -> None:
    rig = Rig({"init_s": 1.0, "spin_up_s": 2.0, "latency_ms": 20.0})
    rig.run(3.5)
    old = rig.session.init_id
    rig.call("POST", "sensor/config?persist=false", '{"return_order":"NEAREST_TO_FARTHEST"}')
    assert rig.get(STATUS)["status"] == "INITIALIZING"
    assert rig.call("GET", "sensor/metadata")[0] == 503
    assert not [one for one in rig.run(0.9) if one.label]
    assert {codec.decode(rig.session.profile, 32, one).init_id for one in lidar(rig.run(0.5))} == {rig.session.init_id}
    assert rig.session.init_id != old
    rig.call("POST", "sensor/config?persist=false", '{"lidar_mode":"512x10"}')  # the motor takes longer
    rig.run(2.0)
    assert rig.session.status == "INITIALIZING"
    rig.run(1.2)
    assert rig.session.status == "RUNNING"


def test_what_is_persisted_survives_a_restart_and_nothing_else() -> None:
    rig = Rig()
    rig.run(0.1)
    rig.call("POST", "sensor/config?persist=false", '{"lidar_mode":"2048x10"}')
    rig.call("POST", "sensor/config?persist=true&reinit=false", '{"gyro_fsr":"EXTENDED"}')
    assert rig.session.persisted["lidar_mode"] == "2048x10"  # of the active set
    rig.call("POST", "sensor/config?persist=false", '{"signal_multiplier":3,"azimuth_window":[0,120000]}')
    assert rig.call("POST", "system/restart", "")[0] == 204
    rig.run(0.1)
    config = rig.get("sensor/config")
    assert (config["gyro_fsr"], config["signal_multiplier"], config["lidar_mode"]) == ("EXTENDED", 1, "2048x10")
    assert rig.call("DELETE", "sensor/config")[0] == 204
    assert rig.get("sensor/config")["lidar_mode"] == "1024x10"


@pytest.mark.parametrize(
    ("body", "name"),
    [
        ('{"azimuth_window":[1,1]}', "azimuth_window"),
        ('{"azimuth_window":[1,2]}', "azimuth_window"),
        ('{"azimuth_window":[180001,180002]}', "azimuth_window"),
        ('{"azimuth_window":[0,360001]}', "azimuth_window"),
        ('{"azimuth_window":[0,1.5]}', "azimuth_window"),
        ('{"lidar_mode":"1024x30","udp_port_lidar":9}', "lidar_mode"),
        ('{"udp_port_lidar":65536}', "udp_port_lidar"),
        ('{"udp_port_lidar":true}', "udp_port_lidar"),
        ('{"signal_multiplier":1.0}', "signal_multiplier"),
        ('{"signal_multiplier":2}', "azimuth_window"),
        ('{"phase_lock_enable":1}', "phase_lock_enable"),
        ('{"udp_profile_lidar":"RNG20"}', "udp_profile_lidar"),
        ('{"udp_profile_imu":"ACCEL32_GYRO32_NMEA"}', "udp_profile_imu"),
        ('{"columns_per_packet":8}', "columns_per_packet"),
        ("[1]", None),
        ("{", None),
        ("[" * 4000, None),
    ],
)
def test_a_wrong_value_is_refused_and_nothing_changes(body: str, name: str | None) -> None:
    rig = Rig()
    rig.run(0.1)
    before = rig.get("sensor/config"), rig.get("sensor/config?staging=true"), rig.session.init_id
    status, found = rig.call("POST", "sensor/config", body)
    assert (status, found["error"].get("param")) == (400, name)
    assert (rig.get("sensor/config"), rig.get("sensor/config?staging=true"), rig.session.init_id) == before


def test_requests_of_other_forms() -> None:
    rig = Rig()
    rig.run(0.1)
    assert rig.call("GET", "no/such")[0] == 404
    assert rig.call("POST", STATUS, "{}")[0] == 405
    for path, status in ((STATUS, 405), ("nothing", 404)):  # RFC 9110, 9.3.2
        head, _, body = rig.ask(f"HEAD {API}{path} HTTP/1.1\r\nHost: x\r\n\r\n".encode()).partition(b"\r\n\r\n")
        assert (int(head.split()[1]), body) == (status, b"")
    assert rig.call("GET", "zone_monitor/active/zip")[0] == 404
    newer = Rig({"firmware": "3.2.0"})
    newer.run(0.1)
    for path in ("staged/zip", "live_ids"):  # two methods have rows that are refused
        found = [newer.call(method, f"zone_monitor/{path}", "{}")[0] for method in ("GET", "POST", "PUT")]
        assert found == [404, 404, 405]
    assert rig.call("POST", "sensor/config?reinit=perhaps", "{}")[0] == 400
    assert rig.ask(b"GET / HTTP/1.1\r\n\r\n").startswith(b"HTTP/1.1 200 OK\r\n")
    both = b"GET /api/v1/sensor/telemetry HTTP/1.1\r\nHost: x\r\n\r\n" * 2
    assert rig.ask(both).count(b"HTTP/1.1 200 OK") == 2
    for at in range(0, len(both), 7):
        rig.session.receive(both[at : at + 7], rig.now_ns, WEB)
    replies = [one.payload for one in rig.run(0.01) if one.address == WEB]
    assert len(replies) == 2
    for reply in replies:  # the standard library reads them
        stream = io.BytesIO(reply)
        answer = HTTPResponse(SimpleNamespace(makefile=lambda *_, stream=stream: stream))  # type: ignore[arg-type]
        answer.begin()
        assert json.loads(answer.read())["internal_temperature_deg_c"] == 48
    put = b"PUT /api/v1/user/data HTTP/1.1\r\nTransfer-Encoding: chunked\r\n\r\n"
    assert rig.ask(put + b'3\r\n"ab\r\n2\r\nc"\r\n0\r\n\r\n').startswith(b"HTTP/1.1 204")
    assert rig.get("user/data") == "abc"
    assert rig.ask(put + b"x\r\n\r\n").startswith(b"HTTP/1.1 400")


@pytest.mark.parametrize(
    ("link", "refused", "number"),
    [(LIDAR, True, "15"), (IMU, True, "18"), (LIDAR, False, "17"), (IMU, False, "1A")],
)
def test_packets_that_do_not_arrive_are_an_alert_until_they_do(link: Address, refused: bool, number: str) -> None:
    rig = Rig({"config": {"azimuth_window": [0, 45_000]}})
    rig.run(0.1)
    assert rig.session.minds_delivery
    for _ in range(3):
        rig.session.undelivered(rig.now_ns, link, refused)
        rig.run(1.0)
    (active,) = rig.get("sensor/alerts")["active"]
    assert (active["id"], active["category"]) == (f"0x010000{number}", "UDP_TRANSMISSION")
    assert active["msg_verbose"].endswith(":7502" if link == LIDAR else ":7503")
    assert lidar(rig.run(0.1))[-1][12] == 0x80
    rig.run(3.0)
    found = rig.get("sensor/alerts")
    assert (found["active"], [one["active"] for one in found["log"]]) == ([], [True, False])
    assert lidar(rig.run(0.1))[-1][12] == 1


def test_user_data_network_profile_and_alerts() -> None:
    rig = Rig()
    rig.run(0.1)
    assert rig.get("user/data") == ""
    assert rig.call("PUT", "user/data?policy=keep_on_config_delete", '"left rear"')[0] == 204
    assert rig.get("user/data?include_metadata=true") == {"policy": "keep_on_config_delete", "value": "left rear"}
    assert rig.call("PUT", "user/data", "7")[0] == 400
    rig.call("DELETE", "sensor/config")
    assert rig.get("user/data") == "left rear"
    rig.call("DELETE", "user/data")
    assert rig.get("user/data") == ""
    assert rig.get("system/network")["ipv4"]["override"] is None
    for wrong in ('"x"', '"10.0.0.5"', '"10.0.0.5/33"', '"/24"', "7", "null", '{"gateway": "10.0.0.1"}'):
        status, said_so = rig.call("PUT", "system/network/ipv4/override", wrong)
        assert (status, said_so["error"]["param"]) == (400, "addr")
    assert rig.get("system/network/ipv4/override") is None
    assert rig.call("PUT", "system/network/ipv4/override", '"10.0.0.5/24"') == (200, "10.0.0.5/24")
    assert rig.get("system/network")["ipv4"]["addr"] == "10.0.0.5/24"
    assert rig.get("time/system")["tracking"].keys() == {
        "frequency", "last_offset", "leap_status", "ref_time_utc", "reference_id", "remote_host", "residual_frequency",
        "rms_offset", "root_delay", "root_dispersion", "skew", "stratum", "system_time_offset", "update_interval",
    }  # fmt: skip
    assert rig.call("PUT", "time/ptp/profile", '"gptp"') == (200, "gptp")
    assert rig.call("PUT", "time/ptp/profile", '"x"')[0] == 400
    rig.call("POST", "sensor/config?persist=false", '{"udp_dest":"nowhere.example"}')
    assert not lidar(rig.run(0.2))
    alerts = rig.get("sensor/alerts")
    assert [one["id"] for one in alerts["active"]] == ["0x01000033"]
    assert alerts["next_cursor"] == 1
    rig.call("POST", "sensor/config?persist=false", '{"udp_dest":"127.0.0.1"}')
    sent = lidar(rig.run(0.2))
    assert sent[0][12] == 1  # the newest alert has cursor 1, none is active
    alerts = rig.get("sensor/alerts?cursor=1")
    assert ([one["active"] for one in alerts["log"]], alerts["active"]) == ([False], [])
    assert rig.call("GET", "sensor/alerts?cursor=-1")[0] == 400


def test_nothing_is_sent_without_a_destination_or_a_port_or_with_the_imu_off() -> None:
    rig = Rig({"firmware": "3.2.0"})
    rig.run(0.1)
    for body, labels in (
        ('{"udp_dest":""}', set()),
        ('{"udp_dest":"127.0.0.1","udp_port_lidar":0}', {"imu"}),
        ('{"udp_port_lidar":7502,"udp_profile_imu":"OFF"}', {"lidar"}),
    ):
        rig.call("POST", "sensor/config?persist=false", body)
        rig.run(0.01)
        assert {one.label for one in rig.run(0.2) if one.address in (LIDAR, IMU)} == labels


def test_standby_and_back() -> None:
    rig = Rig()
    rig.run(0.1)
    rig.call("POST", "sensor/config?persist=false", '{"operating_mode":"STANDBY"}')
    rig.run(0.1)
    assert rig.get(STATUS)["status"] == "STANDBY"
    assert rig.call("GET", "sensor/metadata")[0] == 404
    assert rig.call("GET", "sensor/metadata/beam_intrinsics")[0] == 200
    assert not [one for one in rig.run(0.3) if one.address in (LIDAR, IMU)]
    rig.call("POST", "sensor/config?persist=false", '{"operating_mode":"NORMAL"}')
    assert lidar(rig.run(0.3))


def test_firmware_2_0_is_driven_by_lines() -> None:
    rig = Rig({"firmware": "2.0.0"})
    rig.run(0.1)
    config = json.loads(rig.line("get_config_param active"))
    assert config["udp_ip"] == config["udp_dest"] == "127.0.0.1"
    assert "udp_profile_lidar" not in config
    assert rig.line("set_udp_dest_auto ") == "set_udp_dest_auto"
    assert rig.line("get_config_param staged udp_ip") == "127.0.0.5"
    assert rig.line("set_config_param udp_port_lidar 7510 ") == "set_config_param"
    assert rig.line("get_config_param staged udp_port_lidar") == "7510"
    assert rig.line("set_config_param lidar_mode 9x9").startswith("error: ")
    assert rig.line("set_config_param auto_start_flag 0") == "set_config_param"
    assert json.loads(rig.line("get_config_param staged"))["operating_mode"] == "STANDBY"
    assert rig.line('set_config_param . {"auto_start_flag": 1}') == "set_config_param"
    assert rig.line("write_config_txt") == "write_config_txt"
    assert rig.line("reinitialize") == "reinitialize"
    rig.run(0.1)
    sent = lidar(rig.run(0.1))
    assert {len(one) for one in sent} == {6464}
    assert "initialization_id" not in json.loads(rig.line("get_sensor_info"))
    assert json.loads(rig.line("get_lidar_data_format"))["pixel_shift_by_row"][0] == 24
    assert json.loads(rig.line("get_telemetry"))["phase_lock_status"] == "DISABLED"
    assert rig.line("nonsense") == rig.line("nonsense of words") == "error: unknown command"
    assert rig.line("get_config_param now") == "error: want active or staged"
    assert rig.call("GET", STATUS)[0] == 404
    assert rig.get("system/firmware")["fw"].startswith("ousteros-image-prod-ares-v2.0.0")


def test_firmware_2_5_is_driven_by_commands_over_http() -> None:
    rig = Rig({"firmware": "2.5.3"})
    rig.run(0.1)
    assert rig.call("GET", "sensor/cmd/set_udp_dest_auto") == (200, {})
    assert rig.get("sensor/cmd/get_config_param?args=staged")["udp_dest"] == "127.0.0.5"
    text = "%7B%22lidar_mode%22%3A%20%22512x20%22%7D"
    assert rig.call("GET", f"sensor/cmd/set_config_param?args=.+{text}") == (200, "set_config_param")
    assert rig.call("GET", "sensor/cmd/reinitialize") == (200, {})
    rig.run(0.1)
    assert rig.get("sensor/config")["lidar_mode"] == "512x20"
    assert rig.call("GET", "sensor/cmd/save_config_params") == (200, {})
    assert rig.session.persisted["lidar_mode"] == "512x20"
    assert rig.call("POST", "system/restart", "")[0] == 404
    assert rig.call("POST", "sensor/config", '{"gyro_fsr":"EXTENDED","signal_multiplier":0.25}')[0] == 204
    assert Rig({"firmware": "3.1.0"}).line("get_sensor_info").startswith("error: ")


@pytest.mark.parametrize("firmware", ["3.0.1", "2.4.0"])
def test_older_firmware_has_no_user_data(firmware: str) -> None:
    rig = Rig({"firmware": firmware})
    rig.run(0.1)
    assert rig.call("GET", "user/data")[0] == 404
    assert rig.get("sensor/config")["udp_profile_lidar"] == ("LEGACY" if firmware < "2.5" else "RNG19_RFL8_SIG16_NIR16")


def test_time_follows_the_chosen_source() -> None:
    device = {"ptp": True, "ptp_lock_s": 2.0, "pps": True, "nmea": True, "utc": "2026-01-01T12:00:00",
              "config": {"timestamp_mode": "TIME_FROM_PTP_1588", "lidar_mode": "512x10"}}  # fmt: skip
    rig = Rig(device)
    utc_ns = 1_767_268_800 * SECOND
    early = said(rig, rig.run(0.2)).columns.stamp_ns[0]
    assert early < SECOND
    assert rig.get("time/ptp")["port_data_set"]["port_state"] == "LISTENING"
    rig.run(2.2)
    assert rig.get("time/ptp")["port_data_set"]["port_state"] == "SLAVE"
    sent = rig.run(0.1)
    late = said(rig, sent).columns.stamp_ns[0]
    assert late == pytest.approx(utc_ns + 37 * SECOND + rig.now_ns - 100 * MS, abs=10 * MS)
    assert rig.session.impair(rig.now_ns, "no ptp", 1.0)
    assert rig.get("time/ptp")["port_data_set"]["port_state"] == "LISTENING"
    sent = rig.run(0.3)
    assert said(rig, sent).columns.stamp_ns[-1] == pytest.approx(utc_ns + 37 * SECOND + rig.now_ns, abs=20 * MS)
    rig.call("POST", "sensor/config?persist=false", '{"timestamp_mode":"TIME_FROM_SYNC_PULSE_IN"}')
    rig.run(0.1)
    assert rig.get("time/sensor")["sync_pulse_in"]["locked"] == 1
    assert rig.get("time/sensor")["timestamp"]["time"] == pytest.approx(rig.now_ns / 1e9, abs=0.01)
    body = '{"multipurpose_io_mode":"INPUT_NMEA_UART","nmea_leap_seconds":37}'
    rig.call("POST", "sensor/config?persist=false", body)
    rig.run(0.1)
    assert rig.get("time/sensor")["timestamp"]["time"] == pytest.approx((utc_ns + rig.now_ns) / 1e9 + 37.0, abs=0.01)
    assert rig.get("time/sensor")["multipurpose_io"]["nmea"]["diagnostics"]["decoding"]["last_read_message"].startswith(
        "$GPRMC,1200"
    )
    assert rig.get("time")["system"]["realtime"] == pytest.approx((utc_ns + rig.now_ns) / 1e9, abs=0.01)


def test_the_phase_lock_holds_column_0_in_spite_of_a_drifting_quartz() -> None:
    config = {"timestamp_mode": "TIME_FROM_PTP_1588", "phase_lock_enable": True, "phase_lock_offset": 90_000,
              "lidar_mode": "512x10"}  # fmt: skip
    inner = FAMILY.new_session(QUICK | {"ptp": True, "ptp_lock_s": 0.0, "config": config}, {"model": "ouster-os1-32"})
    rig = Rig(session=Timebase(inner, Quartz().at_rate(0, 100_000)))  # 100 ppm
    rig.run(4.0)
    columns = said(rig, rig.run(0.5)).columns
    first = columns.stamp_ns[columns.number == 0]
    late = (first + 50 * MS - 25 * MS) % (100 * MS) - 50 * MS
    assert np.abs(late).max() < 0.15 * MS
    assert inner.phase_status(rig.now_ns) == "LOCKED"


def unheard(rig: Rig, seconds: float) -> None:
    """The head turns and nobody listens but at the end: sweeps that nobody looks at take the time of a test."""
    rig.session._unsubscribe(rig.now_ns, LIDAR)
    rig.run(0.1)  # packets under way
    assert not lidar(rig.run(seconds - 0.6))
    rig.session._subscribe(rig.now_ns, LIDAR)
    assert lidar(rig.run(0.5))


def test_faults_of_its_own() -> None:
    rig = Rig({"config": {"lidar_mode": "512x10"}})
    rig.run(0.5)
    session = rig.session
    assert not session.impair(rig.now_ns, "nonsense", 1.0)
    assert session.impair(rig.now_ns, "lost columns", 0.2)
    rig.run(0.3)
    columns = said(rig, rig.run(1.0)).columns
    assert 0.15 < 1.0 - columns.valid.mean() < 0.25
    assert not columns.range_mm[:, ~columns.valid].any()
    session.impair(rig.now_ns, "lost columns", 0.0)
    session.impair(rig.now_ns, "unavailable", 1.0)
    assert rig.call("GET", STATUS)[0] == 503
    session.impair(rig.now_ns, "unavailable", 0.0)
    truth = rig.get("sensor/metadata/beam_intrinsics")["beam_altitude_angles"]
    session.impair(rig.now_ns, "wrong calibration served", 0.5)
    wrong = rig.get("sensor/metadata/beam_intrinsics")["beam_altitude_angles"]
    assert np.array(wrong) - truth == pytest.approx(0.5)
    session.impair(rig.now_ns, "shot limiting", 0.35)
    rig.run(0.3)
    head = lidar(rig.run(0.2))[-1][:32]
    assert (head[17], head[19]) in ((30, 1), (29, 1))
    unheard(rig, 31.0)
    assert lidar(rig.run(0.1))[-1][19] == 5
    assert rig.plans[-1].gain / rig.plans[0].gain == pytest.approx(0.65)
    session.impair(rig.now_ns, "shot limiting", 0.0)
    session.impair(rig.now_ns, "thermal shutdown", 1.0)
    unheard(rig, 29.0)
    assert lidar(rig.run(0.2))[-1][18] == 1
    rig.run(2.5)
    assert rig.get(STATUS)["status"] == "ERROR"
    assert not lidar(rig.run(0.5))
    session.impair(rig.now_ns, "thermal shutdown", 0.0)
    rig.call("POST", "sensor/config?persist=false", "{}")
    rig.run(0.1)
    assert rig.get(STATUS)["status"] == "RUNNING"


def test_a_host_that_asks_for_packets_on_its_connection_gets_them_behind_the_metadata() -> None:
    rig = Rig({"config": {"udp_dest": ""}})
    rig.run(0.1)
    reply = rig.ask(b"GET /packets HTTP/1.1\r\n\r\n")
    head, _, _ = reply.partition(b"\r\n\r\n")
    assert json.loads(head.partition(b"X-Metadata: ")[2])["sensor_info"]["prod_line"] == "OS-1-32"
    sent = lidar(rig.run(0.2), WEB)
    assert len(sent) > 100
    assert not [one for one in rig.sent if one.address == LIDAR]
    rig.session.disconnected(rig.now_ns, WEB)
    assert not lidar(rig.run(0.2), WEB)


def test_every_slice_is_sent_or_accounted_for_with_a_window() -> None:
    rig = Rig({"config": {"azimuth_window": [90_000, 120_000], "lidar_mode": "1024x10"}})
    sent = rig.run(1.0)
    numbers = [one.sweep for one in sent if one.sweep is not None]
    kept = [n for one in rig.dropped if one.sweeps is not None for n in one.sweeps]
    assert not set(numbers) & set(kept)
    found = sorted(one for one in {*numbers, *kept} if one <= max(numbers))  # later ones are on their way
    assert found == list(range(found[0], found[-1] + 1))
    assert {one.reason.name for one in rig.dropped} == {"KEPT"}


@pytest.mark.parametrize(
    ("device", "key"),
    [
        ({"firmware": "4.0"}, "firmware"),
        ({"serial_number": 1 << 40}, "serial_number"),
        ({"beams": "G"}, "beams"),
        ({"config": {"lidar_mode": "x"}}, "config.lidar_mode"),
        ({"config": {"nonsense": 1}}, "config.nonsense"),
        ({"firmware": "2.0.0", "config": {"header_type": "FUSA"}}, "config.header_type"),
        ({"utc": "noon"}, "utc"),
    ],
)
def test_a_wrong_device_table_is_refused_with_its_key(device: dict[str, object], key: str) -> None:
    with pytest.raises(DeviceSettingError) as caught:
        FAMILY.new_session(device, {"model": "ouster-os0-128"})
    assert caught.value.key == key
    with pytest.raises(DeviceSettingError):
        FAMILY.new_session({}, {"model": "ouster-os3-128"})
    assert family("ouster") is FAMILY


def test_datagrams_of_hosts_are_ignored() -> None:
    rig = Rig()
    rig.session.connected(0, Address(0, 0), LinkKind.DATAGRAM)
    rig.session.receive(b"\xff" * 100, rig.now_ns, LIDAR)
    rig.session.receive(b"\xff" * 10_000, rig.now_ns, LINE)
    assert rig.run(0.1)


def test_the_imu_feels_where_it_is_when_the_mount_turns_ever_faster() -> None:
    exact = dict.fromkeys(("accel_noise_mg_rthz", "accel_bias_mg", "gyro_noise_deg_s_rthz", "gyro_bias_deg_s"), 0.0)
    rig = Rig(exact | {"imu_scale_share": 0.0})
    gravity, faster = np.array((0.0, 0.0, 9.80665)), np.array((3.0, 12.0, -5.0))
    rig.session.feel(lambda at_ns: (gravity, 1e-9 * at_ns * faster))  # about the mount, which stays where it is
    arm_m = np.array((-2.441, -9.725, 7.533 - 38.195)) / 1000.0
    packets = [one.payload for one in rig.run(0.3) if one.label == "imu"][5:]
    assert len(packets) > 20
    for number, packet in enumerate(packets, 5):
        *stamps, x, y, z, _, _, turned = codec.IMU_LEGACY.unpack(packet)
        rate = (0.01 * number) * faster
        force = gravity + np.cross(rate, np.cross(rate, arm_m)) + np.cross(faster, arm_m)
        assert stamps[0] == 10_000_000 * number
        assert np.array((x, y, z)) * 9.80665 == pytest.approx(force, abs=4e-4)  # half a step is 0.3 mm/s^2
        assert turned == pytest.approx(np.degrees(rate[2]), abs=4e-3)


@pytest.mark.parametrize("boot_s", [0.0, 9.0])
@pytest.mark.parametrize(("fields", "ends"), [("", False), ("Connection: close\r\n", True)])
def test_a_connection_ends_with_the_reply_where_its_client_says_so(boot_s: float, fields: str, ends: bool) -> None:
    rig = Rig({"boot_s": boot_s})
    for path in ("sensor/metadata/sensor_info", "nothing"):
        rig.session.receive(f"GET {API}{path} HTTP/1.1\r\nHost: x\r\n{fields}\r\n".encode(), rig.now_ns, WEB)
        (sent,) = (one for one in rig.run(0.002) if one.address == WEB)
        assert sent.hangs_up == ends
        assert (b"\r\nConnection: close\r\n" in sent.payload, b"keep-alive" in sent.payload) == (ends, not ends)
