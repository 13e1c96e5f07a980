"""Every parameter of the configuration over the wire: what is accepted is read back as sent, what is not is refused."""

from __future__ import annotations

import json
from typing import Any
from urllib.parse import quote

import pytest

from protocols.ouster.config import PARAMETERS, defaults
from tests.protocols.ouster.rig import SECOND, Rig

VERSIONS = ("2.0.0", "2.1.2", "2.2.1", "2.3.1", "2.4.0", "2.5.3", "3.0.1", "3.1.0", "3.2.0")
ADDRESS = (["", "127.0.0.9", "fe80::1", "239.1.2.3", "host.example"], [7, None, "a\nb", "x" * 300, "\u00e9"])
PORT = ([0, 1, 65_535], [-1, 65_536, 7502.0, "7502", True])
POLARITY = (["ACTIVE_LOW", "ACTIVE_HIGH"], ["active_low", 0])
FSR = (["EXTENDED", "NORMAL"], ["4G"])
VALUES: dict[str, tuple[list[Any], list[Any]]] = {
    "udp_dest": ADDRESS, "udp_dest_zm": ADDRESS, "udp_port_lidar": PORT, "udp_port_imu": PORT, "udp_port_zm": PORT,
    "lidar_mode": (["512x20", "2048x10", "1024x10"], ["2048x20", "1024X10", 1024, None]),
    "timestamp_mode": (["TIME_FROM_PTP_1588", "TIME_FROM_SYNC_PULSE_IN"], ["TIME_FROM_UNSPEC", 1]),
    "operating_mode": (["STANDBY", "NORMAL"], ["OFF", True]),
    "udp_profile_lidar": (["LEGACY", "RNG15_RFL8_NIR8", "RNG19_RFL8_SIG16_NIR16_DUAL"], ["FIVE_WORD_PIXEL", "OFF", []]),
    "udp_profile_imu": (["LEGACY"], ["RAW", None]),
    "columns_per_packet": ([16], [8, 64, "16", 16.0]),
    "azimuth_window": ([[583, 39_402], [300_000, 100_000], [0, 0], [0, 360_000]],
                       [[1, 1], [1, 2], [180_001, 180_002], [0], [0, 360_001], [-1, 9], [0.5, 9], "0,1", {}]),
    "signal_multiplier": ([1], [4, 0, 2.5, "1", True]),
    "phase_lock_enable": ([True, False], [1, "true", None]),
    "phase_lock_offset": ([0, 359_999, 360_000], [-1, 360_001, 1.5]),
    "multipurpose_io_mode": (["INPUT_NMEA_UART", "OUTPUT_FROM_ENCODER_ANGLE", "OFF"], ["INPUT", 0]),
    "sync_pulse_in_polarity": POLARITY, "nmea_in_polarity": POLARITY, "sync_pulse_out_polarity": POLARITY,
    "sync_pulse_out_angle": ([0, 180, 360], [361, -1]),
    "sync_pulse_out_frequency": ([1, 20], [0, -1, "1"]),
    "sync_pulse_out_pulse_width": ([0, 5], [-1, 0.5]),
    "nmea_baud_rate": (["BAUD_115200", "BAUD_9600"], [9600, "BAUD_19200"]),
    "nmea_ignore_valid_char": ([1, 0], [2, True]),
    "nmea_leap_seconds": ([0, 37], [-1]),
    "gyro_fsr": FSR, "accel_fsr": FSR,
    "return_order": (["NEAREST_TO_FARTHEST", "FARTHEST_TO_NEAREST"], ["STRONGEST", 0]),
    "min_range_threshold_cm": ([0, 30, 50], [10, 50.0, "50"]),
    "header_type": (["FUSA", "STANDARD"], ["fusa"]),
    "lidar_frame_azimuth_offset": ([0, 90_000, 359_999], [360_000, -1]),
    "bloom_reduction_optimization": (["MINIMIZE_FALSE_POSITIVES", "BALANCED"], ["OFF"]),
    "imu_packets_per_frame": ([1, 2, 4, 8], [3, 16, "8"]),
    "udp_multicast_ttl": ([0, 1, 255], [256, -1]), "udp_multicast_ttl_zm": ([0, 1, 255], [256, -1]),
}  # fmt: skip
"Key -> accepted, refused."


def test_all_parameters_are_here() -> None:
    assert set(VALUES) == set(PARAMETERS)


def written(rig: Rig, name: str, value: Any) -> bool:
    """By the interface of its firmware; whether it was accepted, and is reported as sent."""
    firmware, text = rig.session.firmware, json.dumps(value)
    if firmware < (2, 1):
        accepted = rig.line(f"set_config_param . {json.dumps({name: value})}") == "set_config_param"
        found = json.loads(rig.line("get_config_param staged"))
    elif firmware < (3, 1):
        path = f"sensor/cmd/set_config_param?args=.+{quote(json.dumps({name: value}))}"
        status, said = rig.call("GET", path)
        accepted = status == 200
        assert said == "set_config_param" if accepted else said["error"]["param"] == name, (name, value, said)
        found = rig.get("sensor/cmd/get_config_param?args=staged")
    else:
        query = "?staging=true&reinit=false&persist=false"
        status, said = rig.call("POST", f"sensor/config{query}", json.dumps({name: value}))
        accepted = status == 204
        if not accepted:
            assert (status, said["error"]["code"], said["error"]["param"]) == (400, "CONFIG_INVALID", name)
            assert said["error"]["message"].startswith("want ")
        found = rig.get("sensor/config?staging=true")
    if accepted:
        assert json.dumps(found[name]) == text  # 1 stays 1, false stays false
    return accepted


@pytest.mark.parametrize("version", VERSIONS)
def test_each_value_of_each_parameter(version: str) -> None:
    rig = Rig({"firmware": version, "config": {"azimuth_window": [0, 20_000]}})
    active = dict(rig.session.active)
    for name in defaults(rig.session.firmware):
        if name not in VALUES:
            continue
        good, bad = VALUES[name]
        for value in good:
            assert written(rig, name, value), (name, value)
            for other in bad:
                assert not written(rig, name, other), (name, other)
                assert rig.session.staged[name] == value
        rig.session.staged = dict(rig.session.active)
    assert rig.session.active == active


@pytest.mark.parametrize("version", VERSIONS)
def test_a_parameter_of_newer_firmware_is_ignored(version: str) -> None:
    rig = Rig({"firmware": version})
    before = dict(rig.session.staged)
    newer = {name: VALUES[name][0][0] for name in PARAMETERS if name not in before} | {"of_firmware_9": 1}
    if rig.session.firmware < (2, 1):
        assert rig.line(f"set_config_param . {json.dumps(newer)}") == "set_config_param"
    else:
        assert rig.call("POST", "sensor/config?reinit=false&persist=false", json.dumps(newer))[0] == 204
    assert rig.session.staged == before


WIDTH = "sync_pulse_out_pulse_width"


@pytest.mark.parametrize(
    ("changes", "name"),
    [
        ({"multipurpose_io_mode": "OUTPUT_FROM_PTP_1588", "sync_pulse_out_frequency": 100}, WIDTH),
        ({"multipurpose_io_mode": "OUTPUT_FROM_ENCODER_ANGLE", "sync_pulse_out_angle": 36}, WIDTH),
        ({"signal_multiplier": 2}, "azimuth_window"),
        ({"udp_profile_imu": "ACCEL32_GYRO32_NMEA", "udp_profile_lidar": "LEGACY"}, "udp_profile_imu"),
    ],
)  # fmt: skip
def test_values_that_do_not_go_together_are_refused(changes: dict[str, Any], name: str) -> None:
    rig = Rig({"firmware": "3.2.0"})
    before = dict(rig.session.active)
    status, said = rig.call("POST", "sensor/config", json.dumps({"phase_lock_offset": 7} | changes))
    assert (status, said["error"]["param"]) == (400, name)
    assert (rig.session.active, rig.session.staged, rig.session.persisted) == (before, before, before)
    width = {WIDTH: 9, "azimuth_window": [0, 180_000], "udp_profile_imu": "LEGACY"}
    assert rig.call("POST", "sensor/config?persist=false", json.dumps(changes | {name: width[name]}))[0] == 204


def test_the_way_of_addressing_sets_of_firmware_4_is_refused_by_name() -> None:
    rig = Rig()
    for method, query, body in (("GET", "source=persisted", None), ("POST", "target=active", '{"udp_port_imu": 1}')):
        status, said = rig.call(method, f"sensor/config?{query}", body)
        assert (status, said["error"]["param"], said["error"]["message"]) == (
            400, query.partition("=")[0], "of firmware 4; want staging",
        )  # fmt: skip
    assert rig.session.active["udp_port_imu"] == 7503


def test_the_persisted_set_and_it_alone_is_there_after_a_restart_of_the_device() -> None:
    rig = Rig()
    rig.run(0.1)
    assert rig.call("POST", "sensor/config?persist=true&reinit=false", '{"lidar_mode": "512x20"}')[0] == 204
    assert rig.call("POST", "sensor/config?persist=false&reinit=true", '{"udp_port_imu": 9000}')[0] == 204
    assert rig.get("sensor/config")["udp_port_imu"] == 9000
    assert rig.call("PUT", "user/data", '"kept"')[0] == 204
    assert rig.call("POST", "system/restart", "")[0] == 204
    rig.run(0.5)
    found = rig.get("sensor/config")
    assert (found["lidar_mode"], found["udp_port_imu"]) == ("512x20", 7503)
    assert rig.get("user/data") == "kept"
    rig.session.power_on(rig.now_ns + SECOND)
    rig.now_ns += SECOND
    rig.run(0.5)
    assert rig.get("sensor/config")["lidar_mode"] == "512x20"


def test_the_line_of_alerts_takes_a_cursor_and_the_network_has_the_address_that_was_called() -> None:
    rig = Rig({"firmware": "2.0.0"})
    rig.session.impair(0, "shot limiting", 0.3)
    assert len(json.loads(rig.line("get_alerts"))["log"]) == 1
    assert json.loads(rig.line("get_alerts 1")) == {"active": [], "log": [], "next_cursor": 1}
    assert rig.line("get_alerts x").startswith("error: ")
    for host, own in ((b"127.0.0.72", "127.0.0.72/8"), (b"10.0.0.5:80", "10.0.0.5/24"), (b"os.local", "127.0.0.1/8")):
        said = rig.ask(b"GET /api/v1/system/network HTTP/1.1\r\nhost: " + host + b"\r\n\r\n")
        assert json.loads(said.partition(b"\r\n\r\n")[2])["ipv4"]["addr"] == own


def test_a_phase_lock_that_stays_lost_has_failed() -> None:
    rig = Rig({"ptp": True, "ptp_lock_s": 0.1, "config": {"phase_lock_enable": True, "lidar_mode": "512x10",
               "timestamp_mode": "TIME_FROM_PTP_1588", "azimuth_window": [0, 9000]}})  # fmt: skip
    rig.run(3.0)
    rig.session.impair(rig.now_ns, "no ptp", 1.0)
    rig.run(5.0)
    active = [one["id"] for one in rig.get("sensor/alerts")["active"]]
    assert active == ["0x01000050"]
    rig.run(30.0)
    assert [one["id"] for one in rig.get("sensor/alerts")["active"]] == ["0x01000050", "0x01000051"]
    rig.session.impair(rig.now_ns, "no ptp", 0.0)
    rig.run(10.0)
    assert rig.get("sensor/alerts")["active"] == []
