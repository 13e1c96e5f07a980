"""ouster-sdk 0.16 decodes our packets with our metadata: points, words and header fields of every profile."""

from __future__ import annotations

import json
from importlib import import_module
from typing import Any

import numpy as np
import pytest

from protocols.ouster import codec
from protocols.scan import Scan, ScanPlan
from tests.protocols.ouster.rig import MS, Rig, lidar

core: Any = import_module("ouster.sdk.core")  # the test command installs it


def room(plan: ScanPlan) -> Scan:
    """A sphere of 7 m around a point beside the sensor; behind half of it a second echo, weaker, 4 m farther."""
    assert plan.origin_m is not None
    scan = Scan.empty(plan, 2)
    az, el = plan.azimuth_rad, plan.elevation_rad
    d = np.stack((np.cos(az) * np.cos(el), np.sin(az) * np.cos(el), np.sin(el)), axis=1)
    off = plan.origin_m - CENTRE
    b = np.einsum("ij,ij->i", off, d)
    scan.range_m[:, 0] = -b + np.sqrt(b * b - np.einsum("ij,ij->i", off, off) + RADIUS_M**2)
    scan.intensity[:, 0] = 30.0
    far = el > 0.0
    scan.range_m[far, 1], scan.intensity[far, 1] = scan.range_m[far, 0] + 4.0, 12.0
    object.__setattr__(scan, "ambient_w", np.full(len(plan), 1e-9))
    return scan


CENTRE, RADIUS_M = np.array([1.0, -0.5, 0.2]), 7.0


def batched(rig: Rig) -> tuple[Any, Any, list[Any]]:
    """Metadata, packet format and whole frames, as the SDK sees them."""
    rig.world = room
    sent = lidar(rig.run(0.45))
    info = core.SensorInfo(json.dumps(dict(rig.session.parts())))
    form = core.PacketFormat(info)
    batcher, scan, frames = core.ScanBatcher(info), core.LidarScan(info), []
    for data in sent:
        assert len(data) == form.lidar_packet_size
        packet = core.LidarPacket(len(data))
        packet.buf[:] = np.frombuffer(data, np.uint8)
        packet.host_timestamp = 1
        assert packet.validate(info, form) == core.PacketValidationFailure.NONE
        if batcher(packet, scan):
            frames.append(scan)
            scan = core.LidarScan(info)
    return info, form, frames


@pytest.mark.parametrize("name", codec.PROFILES)
@pytest.mark.parametrize("model", ["ouster-os0-32", "ouster-os1-64", "ouster-os2-128"])
def test_points_are_within_3_mm_of_the_truth(model: str, name: str) -> None:
    device = {"own_calibration": True, "config": {"udp_profile_lidar": name, "lidar_mode": "512x10"}}
    rig = Rig(device, model=model)
    _, _, frames = batched(rig)
    whole = [one for one in frames if one.complete()]
    assert len(whole) >= 3
    scan = whole[1]
    lut = core.XYZLut(scan.sensor_info)
    unit = 8 if "RNG15" in name else 1
    points = lut(scan)
    points[..., 2] -= 0.038195  # from the sensor's frame to the lidar's, which has the mount's axes
    off = np.linalg.norm(points - CENTRE, axis=2) - RADIUS_M
    assert (scan.field(core.ChanField.RANGE) > 0).all()
    assert np.abs(off).max() < 0.0005 * unit + 1e-4  # half a unit: below 3 mm but for the low rate
    if "DUAL" in name:
        second = scan.field(core.ChanField.RANGE2).astype(int) - scan.field(core.ChanField.RANGE)
        up = rig.session.unit.elevation_deg > 0.0
        assert np.abs(second[up] - 4000).max() <= unit
        assert not scan.field(core.ChanField.RANGE2)[~up].any()
    if unit == 1:
        assert (scan.field(core.ChanField.SIGNAL) == 450).all()
        nir = scan.field(core.ChanField.NEAR_IR)
        assert nir.min() == nir.max() > 100
    step = np.diff(scan.timestamp.astype(np.int64))
    assert abs(step - 195_312.5).max() < 10


@pytest.mark.parametrize("mode", ["512x20", "1024x10", "1024x20", "2048x10", "4096x5"])
def test_frames_are_whole_in_every_mode(mode: str) -> None:
    rig = Rig({"config": {"lidar_mode": mode}})
    info, _, frames = batched(rig)
    columns, fps = (int(one) for one in mode.split("x"))
    assert info.format.columns_per_frame == columns
    assert info.format.fps == fps
    assert [one.frame_id for one in frames] == list(range(len(frames)))
    assert sum(one.complete() for one in frames) >= len(frames) - 1 >= 0.4 * fps - 1
    assert (frames[0].measurement_id == np.arange(columns)).all()


@pytest.mark.parametrize(
    ("window", "said"),
    [
        ([0, 360_000], [0, 511]),
        ([300_000, 100_000], [370, 85]),
        ([180_000, 360_000], [1, 256]),
        ([0, 0], [0, 0]),
        ([360_000, 0], [0, 0]),
    ],
)
def test_frames_of_an_azimuth_window_are_whole(window: list[int], said: list[int]) -> None:
    rig = Rig({"config": {"lidar_mode": "512x10", "azimuth_window": window}})
    info, _, frames = batched(rig)
    assert list(info.format.column_window) == said
    assert rig.get("sensor/metadata/lidar_data_format")["column_window"] == said
    assert len(frames) >= 3
    scan = frames[1]
    assert scan.complete()
    valid = np.flatnonzero(scan.status & 1)
    first, last = said
    inside = np.arange(512)
    wanted = (inside >= first) & (inside <= last) if first <= last else (inside >= first) | (inside <= last)
    np.testing.assert_array_equal(valid, np.flatnonzero(wanted))
    assert not scan.field(core.ChanField.RANGE)[:, ~wanted].any()


@pytest.mark.parametrize("firmware", ["2.4.0", "2.5.3", "3.0.1", "3.1.0", "3.2.0"])
def test_metadata_of_each_firmware_is_accepted_with_its_checksum(firmware: str) -> None:
    rig = Rig({"firmware": firmware, "config": {"udp_profile_lidar": "RNG19_RFL8_SIG16_NIR16"}})
    info, form, frames = batched(rig)
    assert info.sn == 122322000614
    assert frames
    data = lidar(rig.sent)[0]
    packet = core.LidarPacket(len(data))
    packet.buf[:] = np.frombuffer(data, np.uint8)
    has = tuple(map(int, firmware.split(".")[:2])) >= (3, 1)
    assert (form.crc(packet.buf) == form.calculate_crc(packet.buf)) is has
    assert info.init_id == rig.session.init_id


@pytest.mark.parametrize("header", ["STANDARD", "FUSA"])
@pytest.mark.parametrize("name", codec.PROFILES)
def test_either_header_is_read_with_every_profile_of_firmware_3_2(name: str, header: str) -> None:
    rig = Rig(
        {"firmware": "3.2.0", "config": {"udp_profile_lidar": name, "header_type": header, "lidar_mode": "512x20"}}
    )
    _, _, frames = batched(rig)
    assert sum(one.complete() for one in frames) >= len(frames) - 1 >= 5
    if name in ("RNG19_RFL8_SIG16_NIR16", "RNG19_RFL8_SIG16_NIR16_DUAL"):
        assert set(np.unique(frames[1].field("WINDOW"))) == {255}


def test_headers_with_functional_safety_and_the_new_imu_packets_are_read() -> None:
    config = {"header_type": "FUSA", "udp_profile_imu": "ACCEL32_GYRO32_NMEA", "lidar_mode": "2048x10",
              "multipurpose_io_mode": "INPUT_NMEA_UART"}  # fmt: skip
    rig = Rig({"firmware": "3.2.0", "config": config, "nmea": True, "pps": True, "accel_noise_mg_rthz": 0.0,
               "accel_bias_mg": 0.0, "imu_scale_share": 0.0})  # fmt: skip
    info, form, frames = batched(rig)
    assert [one.frame_id for one in frames] == list(range(len(frames)))
    packets = [one.payload for one in rig.sent if one.label == "imu"]
    assert {len(one) for one in packets} == {form.imu_packet_size} == {452}
    packet = core.ImuPacket(452)
    packet.buf[:] = np.frombuffer(packets[0], np.uint8)
    packet.format = form
    assert packet.nmea_sentence().startswith("$GPRMC,")
    assert np.abs(np.diff(packet.timestamp().astype(np.int64)) - 1_562_500).max() <= 8  # its timer
    assert packet.measurement_id().tolist() == [31 + 32 * k for k in range(8)]
    assert packet.accel()[:, 2] == pytest.approx([9.80665] * 8, abs=1e-3)
    assert packet.init_id() == info.init_id


def test_the_legacy_imu_packet_is_read() -> None:
    rig = Rig({"accel_noise_mg_rthz": 0.0, "accel_bias_mg": 0.0, "imu_scale_share": 0.0, "gyro_noise_deg_s_rthz": 0.0,
               "gyro_bias_deg_s": 0.0})  # fmt: skip
    rig.session.feel(lambda now_ns: (np.array([9.80665, 0.0, 0.0]), np.radians([0.0, 0.0, 30.0])))
    _, form, _ = batched(rig)
    packets = [one.payload for one in rig.sent if one.label == "imu"]
    data = np.frombuffer(packets[3], np.uint8)
    assert form.imu_la_x(data) == pytest.approx(1.0, abs=1e-4)
    assert form.imu_la_z(data) == pytest.approx(0.0, abs=1e-4)
    assert form.imu_av_z(data) == pytest.approx(30.0, abs=250 / 32768)
    ticks = [form.imu_sys_ts(np.frombuffer(one, np.uint8)) for one in packets]
    assert set(np.diff(ticks).tolist()) == {10 * MS}
