"""Formats of the field, read by the packages that publish them: Foxglove's channels and OSI's SensorData."""

from __future__ import annotations

import importlib
import math
import socket
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from foxglove_schemas_protobuf import LaserScan_pb2, PointCloud_pb2, SceneUpdate_pb2
from google.protobuf.descriptor_pb2 import FileDescriptorSet
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

from emulator.commands.recordings import field_formats
from emulator.judging.trial import Trial
from emulator.live.esmini import Assembly
from emulator.recording import foxglove, osi_out
from emulator.recording.reader import read_run
from emulator.scenario.scenario import load
from emulator.scenario.tables import Mount
from protocols.scan import DetectedObject, Scan, ScanPlan


def betterosi() -> Any:
    """The reader of OSI, which takes seconds to load: not before a test wants it."""
    return importlib.import_module("betterosi")


SCENE = """
schema: 1
seed: 3
duration_s: 2
world:
  - {plane: {size_m: [300, 30]}, at_m: [50, 0, 0], material: asphalt}
actors:
  - {id: ego, class: car, motion: {at_m: [3, 0, 0], velocity_m_s: [4, 0, 0]}}
  - {id: car, shape: {box: {size_m: [4, 2, 1.5]}}, material: car_paint_grey, class: car, motion: {at_m: [20, 0, 0]}}
sensors:
  - {id: front, model: sick-lms291-s05, mount: {actor: ego, at_m: [1, 0, 0.6], yaw_deg: 5},
     links: ["loop:front"]}
  - {id: radar, model: can-ars408, from: [front], mount: {actor: ego, at_m: [1, 0, 0.6]}, links: ["can:virtual:w"]}
live: {feed: control, ego: ego}
record: {foxglove: true}
"""


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("formats")
    (folder / "scene.yaml").write_text(SCENE)
    scenario = load(str(folder / "scene.yaml"), [f"record.osi=[osi-trace:{folder / 'out.osi'}]"])
    trial = Trial(scenario, record=folder / "run")
    try:
        osi = field_formats(scenario, trial.instruments, trial.recorder, trial.feeding, print)
        trial.finish()
        assert osi is not None
        osi.close()
    finally:
        trial.close()
    return folder


@pytest.mark.parametrize("module", [PointCloud_pb2, LaserScan_pb2, SceneUpdate_pb2])
def test_the_schemas_are_the_published_ones(module: Any) -> None:
    name = module.DESCRIPTOR.name.removeprefix("foxglove/").removesuffix(".proto")
    ours = FileDescriptorSet.FromString(foxglove.descriptors(name))
    published = FileDescriptorSet().file.add()
    module.DESCRIPTOR.CopyToProto(published)
    assert ours.file[-1] == published


def test_foxglove_shows_the_run_without_our_code(recorded: Path) -> None:
    with (recorded / "run/run.mcap").open("rb") as file:
        decoded: dict[str, list[Any]] = {}
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        for _, channel, message, shown in reader.iter_decoded_messages(
            topics=["/front/points", "/front/laser", "/world/boxes", "/radar/boxes"]
        ):
            decoded.setdefault(channel.topic, []).append((message, shown))
    message, cloud = decoded["/front/points"][-1]
    assert cloud.timestamp.seconds * 10**9 + cloud.timestamp.nanos == message.log_time
    assert [one.name for one in cloud.fields] == ["x", "y", "z", "intensity", "actor", "beam"]
    points = np.frombuffer(cloud.data, foxglove.POINT)
    assert cloud.point_stride == foxglove.POINT.itemsize
    on_car = points[points["actor"] == 2]
    assert len(on_car) > 5
    assert np.abs(on_car["x"] - 18.0).max() < 0.1
    many = np.concatenate([np.frombuffer(one.data, foxglove.POINT) for _, one in decoded["/front/points"]])
    assert many["x"][many["actor"] == 2].mean() == pytest.approx(18.0, abs=0.012), "each beam from its own instant"
    _, laser = decoded["/front/laser"][-1]
    assert (len(laser.ranges), math.degrees(laser.start_angle)) == (361, -90)
    assert laser.pose.position.x == pytest.approx(4 + 4 * message.log_time * 1e-9, abs=1e-6)
    assert 2 * math.degrees(math.atan2(laser.pose.orientation.z, laser.pose.orientation.w)) == pytest.approx(5)
    assert laser.ranges[170] * math.cos(math.radians(0)) == pytest.approx(18 - laser.pose.position.x, abs=0.2)
    boxes = decoded["/world/boxes"]
    (box,) = boxes[-1][1].entities
    assert (box.id, box.cubes[0].size.x, box.cubes[0].pose.position.x) == ("car", 4.0, 20.0)
    assert box.cubes[0].pose.position.z == pytest.approx(0.75)
    assert boxes[-1][1].deletions[0].type == 1
    assert boxes[1][0].log_time - boxes[0][0].log_time >= foxglove.SCENE_NS
    listed = [shown for _, shown in decoded["/radar/boxes"] if shown.entities]
    assert listed
    assert listed[-1].entities[0].cubes[0].pose.position.x == pytest.approx(20, abs=2.5)


def test_our_own_readers_pass_over_them(recorded: Path) -> None:
    assert len(read_run(recorded / "run").scans["front"]) > 10


def read_osi(path: Path) -> list[Any]:
    data, found = path.read_bytes(), []
    while data:
        size = int.from_bytes(data[:4], "little")
        found.append(betterosi().SensorData.from_binary(data[4 : 4 + size]))
        data = data[4 + size :]
    return found


def test_osi_has_a_detection_an_echo_and_an_object_a_listed_one(recorded: Path) -> None:
    found = read_osi(recorded / "out.osi")
    scans = [one for one in found if one.sensor_id.value == 1]
    lists = [one for one in found if one.sensor_id.value == 2]
    truth = read_run(recorded / "run").scans["front"]
    assert len(scans) == len(truth)
    for one, scan in zip(scans, truth, strict=True):
        lidar = one.feature_data.lidar_sensor[0]
        beam, place = np.nonzero(np.isfinite(scan.range_m))
        assert lidar.header.number_of_valid_detections == len(lidar.detection) == len(beam)
        at = one.last_measurement_time
        assert at.seconds * 10**9 + at.nanos > scan.start_ns
        for echo, i, k in zip(lidar.detection, beam, place, strict=True):
            assert echo.position.distance == pytest.approx(scan.range_m[i, k], rel=1e-6)
            assert echo.position.azimuth == pytest.approx(scan.azimuth_rad[i], abs=1e-6)
            assert echo.intensity == pytest.approx(100 - 100 / max(1.0, scan.intensity[i, k]), abs=1e-3)
            assert echo.beam_id.value == i
            actor = scan.actor[i, k]
            assert (echo.object_id.value == actor) if actor > 0 else echo.object_id is None
    last = scans[-1]
    at_s = last.timestamp.seconds + 1e-9 * last.timestamp.nanos
    assert last.host_vehicle_location.position.x == pytest.approx(3 + 4 * at_s, abs=1e-6)
    assert last.mounting_position.orientation.yaw == pytest.approx(math.radians(5))
    objects = [one for message in lists for one in message.moving_object]
    assert {one.header.ground_truth_id[0].value for one in objects} == {2}
    assert objects[-1].candidate[0].vehicle_classification.type == 4
    assert objects[-1].base.position.x == pytest.approx(20 - 4 - 4 * at_s, abs=2.5)


def test_no_echo_is_no_detection_and_a_pedestrian_is_one() -> None:
    plan = ScanPlan(0, 7, 10**9, np.zeros(300), np.zeros(300), np.zeros(300))
    assert osi_out.detections(Scan.empty(plan)) == b""
    scan = Scan.empty(plan)
    scan.range_m[299, 0], scan.intensity[299, 0], scan.actor[299, 0] = 5.0, 4.0, 70_000
    (one,) = betterosi().LidarDetectionData.from_binary(osi_out.detections(scan)).detection
    assert (one.object_id.value, one.beam_id.value, one.position.distance, one.intensity) == (70_000, 299, 5.0, 75.0)
    listed = DetectedObject(4, (1, 2, 0.5), (0, 1, 0), (0.5, 0.5, 1.8), 0.1, "pedestrian", actor="walker")
    back = betterosi().DetectedMovingObject.from_binary(osi_out.moving_object(listed, {"walker": 3}, 1))
    assert (back.candidate[0].type, back.header.tracking_id.value) == (3, 4)
    assert back.base.dimension.height == 1.8


def test_osi_goes_by_udp_as_esmini_sends_and_into_mcap(tmp_path: Path) -> None:
    plan = ScanPlan(0, 7, 10**9, np.linspace(-1, 1, 300), np.zeros(300), np.zeros(300), 0.013)
    scan = Scan.empty(plan)
    scan.range_m[:, 0], scan.intensity[:, 0] = 5.0, 4.0
    message = osi_out.sensor_data(scan, 1, Mount(), None, {})
    assert len(message) > 8192, "more than a datagram of esmini's"
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as listener:
        listener.bind(("127.0.0.1", 0))
        listener.settimeout(5)
        out = osi_out.opened(f"osi-udp://127.0.0.1:{listener.getsockname()[1]}")
        out.send(message)
        assembly, whole = Assembly(Counter()), None
        while whole is None:
            whole = assembly.take(*listener.recvfrom(65_536), 0)
        assert whole == message
        out.close()
    file = osi_out.opened(f"osi-mcap:{tmp_path / 'out.mcap'}")
    file.send(message)
    file.close()
    with (tmp_path / "out.mcap").open("rb") as back:
        ((schema, _, reported),) = make_reader(back).iter_messages()
    assert (schema.name, reported.log_time) == ("osi3.SensorData", 1_013_000_000)
    parse = betterosi().SensorData.from_binary
    assert parse(reported.data) == parse(message)


@pytest.mark.parametrize("url", ["udp://127.0.0.1:1", "osi-udp://127.0.0.1", "osi-trace:", "osi-trace:/no/such/x.osi"])
def test_a_place_that_cannot_be_is_told(url: str) -> None:
    with pytest.raises(Exception, match=r"record\.osi"):
        osi_out.opened(url)
