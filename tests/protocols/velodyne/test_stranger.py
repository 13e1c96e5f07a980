"""The same packets read by velodyne_decoder (PyPI, BSD-3): the decoder and the calibration files of another author."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import velodyne_decoder as stranger

from protocols.scan import Floats, Scan, ScanPlan
from protocols.skeleton.nmea import gprmc
from protocols.velodyne import codec
from protocols.velodyne.models import MODELS, MODES, Mode, Model
from tests.protocols.velodyne.rig import Rig, packets

FILES = {
    "velodyne-vlp-16": "VLP-16", "velodyne-puck-hi-res": "Puck Hi-Res", "velodyne-hdl-32e": "HDL-32E",
    "velodyne-vlp-32c": "VLP-32C", "velodyne-vls-128": "Alpha Prime",
}  # fmt: skip
"Names of its calibrations."


def calibration(name: str) -> Path:
    return Path(stranger.__file__).parent / "calibrations" / f"{FILES[name]}.yml"


@pytest.mark.parametrize("name", MODELS)
def test_the_tables_are_those_of_its_calibration_files(name: str) -> None:
    import ruamel.yaml

    rows = ruamel.yaml.YAML(typ="safe").load(calibration(name).read_text())
    lasers = sorted(rows["lasers"], key=lambda row: row["laser_id"])
    model = MODELS[name]
    assert rows["distance_resolution"] == model.unit_mm / 1000.0
    assert np.degrees([row["vert_correction"] for row in lasers]) == pytest.approx(model.elevation_deg, abs=1e-4)
    assert np.degrees([row["rot_correction"] for row in lasers]) == pytest.approx(model.offset_deg, abs=1e-4)


def truth(model: Model, mode: Mode, rpm: float, packets: int) -> tuple[bytes, Floats, Floats]:
    """Packets; direction (firings, lasers, xyz) and ranges (E, firings, lasers) of each beam."""
    firings = model.firings(mode)
    times = (np.arange(packets * firings)[:, None] * model.cycle_ns + np.asarray(model.laser_ns)) * 1e-9
    turns = 0.3 + rpm / 60.0 * times
    azimuth, elevation = model.directions(turns)
    range_m = np.stack([20.0 + 7.0 * np.sin(3.0 * azimuth) + 2.0 * np.cos(9.0 * elevation) + k for k in (3.0, 0.0)])
    range_m = range_m if mode == "dual" else range_m[1:]
    shape = (len(range_m), packets, firings, model.lasers)
    words = codec.distances(range_m, model.unit_mm).reshape(shape)
    heads = np.rint(36_000 * turns[:, 0].reshape(packets, firings)).astype(np.int64)
    stamps = np.arange(packets) * model.packet_ns(mode) + model.stamp_ns
    data = codec.encode(model, mode, codec.Firings(heads, stamps // 1000, words, np.full(shape, 50)))
    way = np.stack(
        (np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)), axis=-1
    )
    return data.tobytes(), way, range_m


@pytest.mark.parametrize("rpm", [300, 600, 1200])
@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("name", MODELS)
def test_it_finds_every_beam_within_two_millimetres_where_it_was(name: str, mode: Mode, rpm: int) -> None:
    model = MODELS[name]
    data, way, range_m = truth(model, mode, rpm, 40)
    decoder = stranger.ScanDecoder(stranger.Config(calibration=stranger.Calibration.read(str(calibration(name)))))
    packets = stranger.PacketVector()
    for number in range(len(data) // codec.DATA_BYTES):
        packet = data[number * codec.DATA_BYTES : (number + 1) * codec.DATA_BYTES]
        packets.append(stranger.VelodynePacket(1e-9 * number * model.packet_ns(mode), packet))
    _, points = decoder.decode(packets, as_pcl_structs=True)
    assert len(points) == range_m.size
    assert decoder.return_mode.name == {"strongest": "STRONGEST", "last": "LAST", "dual": "BOTH"}[mode]
    # its rings go by elevation; within a ring it keeps the order of firing, and of a pair of returns
    ring = np.argsort(np.argsort(model.elevation_deg, kind="stable"), kind="stable")
    order = np.argsort(points["ring"], kind="stable").reshape(model.lasers, -1, len(range_m))[ring]
    at = np.stack([points[axis][order].astype(np.float64) for axis in "xyz"], axis=-1)
    found = np.linalg.norm(at, axis=-1)
    assert np.abs(np.sort(found, axis=-1) - np.sort(range_m, axis=0).T).max() < 0.00201
    # it has the middle of a VLS-128's firing two slots long, ROS and Nebula one; azimuths are to 0.01 degrees
    slack_deg = 0.016 + 2.665e-6 * 6.0 * rpm * (model.lasers == 128)
    away = np.linalg.norm(at / found[..., None] - way.swapaxes(0, 1)[:, :, None], axis=-1)
    # and knows the firmware of a VLS-128, slots of 2.67 or 2.89 us, from the second packet on
    assert np.degrees(away[:, 2 * model.firings(mode) :]).max() < slack_deg


def hills(plan: ScanPlan) -> Scan:
    """Two surfaces of the same shape, the nearer one brighter."""
    scan = Scan.empty(plan, 2)
    near_m = 20.0 + 7.0 * np.sin(3.0 * plan.azimuth_rad) + 2.0 * np.cos(9.0 * plan.elevation_rad)
    scan.range_m[:], scan.intensity[:] = np.stack([near_m, near_m + 4.0], axis=1), (62.5, 30.0)
    return scan


@pytest.mark.parametrize(
    ("mode", "rpm", "fov"), [("dual", 777, (0, 359)), ("strongest", 600, (300, 60)), ("last", 350, (90, 100))]
)
@pytest.mark.parametrize("name", MODELS)
def test_a_stream_of_a_device_has_whole_turns_of_its_field_of_view(
    name: str, mode: Mode, rpm: int, fov: tuple[int, int]
) -> None:
    model = MODELS[name]
    rig = Rig({"returns": mode, "rpm": rpm, "fov_deg": list(fov)}, name)
    rig.world = hills
    decoder = stranger.StreamDecoder(stranger.Config(calibration=stranger.Calibration.read(str(calibration(name)))))
    sent = packets(rig.run(3.2 * 60.0 / rpm))
    scans = [scan for one in sent if (scan := decoder.decode(1e-9 * one.due_ns, one.payload, True)) is not None]
    points = scans[-1][1]
    width = (fov[1] - fov[0]) % 360 + 1
    if width > 180:  # of a narrow field of view it cuts turns where it has enough packets
        firings = 60.0 / rpm / (1e-9 * model.cycle_ns) * model.lasers * (1 + (mode == "dual"))
        assert len(points) == pytest.approx(firings, rel=0.02)
    assert len(np.unique(points["ring"])) == model.lasers
    at = np.stack([points[axis].astype(np.float64) for axis in "xyz"])
    found = np.linalg.norm(at, axis=0)
    azimuth, elevation = np.arctan2(at[1], at[0]), np.arcsin(at[2] / found)
    surface = 20.0 + 7.0 * np.sin(3.0 * azimuth) + 2.0 * np.cos(9.0 * elevation)
    layers = {"strongest": (0.0,), "last": (4.0,), "dual": (0.0, 4.0)}[mode]
    wrong = np.min([np.abs(found - surface - more) for more in layers], axis=0)
    # 21 m for a radian: azimuths to 0.01 degrees; over a VLS-128's packet a rate of rotation to as much
    assert wrong.max() < (0.025 if model.lasers == 128 else 0.007)
    middle = np.radians((fov[0] + (width - 1) / 2.0) % 360.0)
    seen = np.abs(np.angle(np.exp(1j * (-azimuth - middle))))
    assert np.degrees(seen.max()) < width / 2.0 + 0.4 + max(map(abs, model.offset_deg))


def test_it_reads_the_position_packet() -> None:
    sentence = gprmc(1_453_364_282_000_000_000, 36.829131, -2.407572)
    said = stranger.TelemetryPacket(codec.encode_position(123_456_789, 2, sentence, 41, 39))
    assert said.usec_since_toh == 123_456_789
    assert said.pps_status.name == "LOCKED"
    assert said.nmea_sentence.strip() == sentence.decode().strip()
    assert said.gps_position is not None
