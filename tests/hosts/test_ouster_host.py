"""Our host for Ouster: frames out of packets in any chunking, its conversation, and the fields of a packet."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from emulator.hosts.describe import Speaker, describe
from emulator.hosts.ouster import ASK, FrameReader, OusterScript
from emulator.judging.trial import Trial
from emulator.scenario import scenario
from protocols.ouster.codec import PROFILES
from protocols.scan import Scan, ScanPlan
from tests.protocols.ouster.rig import WEB, Rig, lidar

ASKS = b"GET /packets HTTP/1.1\r\n\r\n"


def round_room(plan: ScanPlan) -> Scan:
    """The range tells the azimuth: 10 m + 1 m a radian to the left; below the horizon 20 m more."""
    scan = Scan.empty(plan)
    scan.range_m[:, 0] = 10.0 + np.angle(np.exp(1j * plan.azimuth_rad)) + 20.0 * (plan.elevation_rad < 0.0)
    scan.intensity[:, 0] = 20.0
    return scan


def stream(rig: Rig, seconds: float) -> bytes:
    """What a host on a connection hears."""
    rig.session.receive(ASKS, rig.now_ns, WEB)
    return b"".join(one.payload for one in rig.run(seconds) if one.address == WEB)


@pytest.mark.parametrize("name", PROFILES)
def test_a_frame_is_the_layer_nearest_to_the_horizon_where_it_was(name: str) -> None:
    model = "ouster-os2-32" if "DUAL" in name else "ouster-os0-64"
    rig = Rig({"own_calibration": True, "config": {"udp_profile_lidar": name, "lidar_mode": "512x10"}}, model)
    rig.world = round_room
    data = stream(rig, 0.45)
    reader = FrameReader()
    found = [scan for at in range(0, len(data), 1000) for scan in reader.feed(data[at : at + 1000])]
    assert reader.errors == 0
    assert reader.title == f"Ouster {rig.session.unit.model.product('U')}"
    assert [scan.number for scan in found] == [0, 1, 2, 3]
    scan = found[1]
    assert len(scan.range_m) == 512
    elevation = rig.session.unit.elevation_deg
    base = 30.0 if elevation[np.argmin(np.abs(elevation))] < 0.0 else 10.0
    turn = np.angle(np.exp(1j * (scan.azimuth_rad - (scan.range_m - base))))
    assert np.abs(turn).max() < 0.0045
    assert scan.cloud is not None
    assert len(scan.cloud.range_m) == 512 * rig.session.unit.rows
    below = scan.cloud.elevation_rad < 0.0
    assert (scan.cloud.range_m[below] > 25.0).all()


def test_what_is_no_packet_is_counted_and_the_next_one_is_found() -> None:
    rig = Rig({"config": {"lidar_mode": "512x10"}})
    data = stream(rig, 0.55)
    size = len(lidar(rig.sent)[0])
    reader = FrameReader()
    found = list(reader.feed(data[: size * 9 + 700] + data[size * 10 :]))
    assert reader.errors >= 1
    assert len(found) >= 3
    assert list(FrameReader().feed(bytes(5000))) == []
    assert list(FrameReader().feed(b"HTTP/1.1 200 OK\r\nX-Metadata: {\r\n\r\n" + bytes(5000))) == []


def test_datagrams_without_metadata_are_known_by_their_length() -> None:
    rig = Rig({"config": {"lidar_mode": "1024x10"}})
    packets = lidar(rig.run(0.35))
    reader = FrameReader()
    found = [scan for data in packets for scan in reader.feed(data)]
    assert len(found) >= 2
    assert np.nanmedian(found[0].range_m) == pytest.approx(10.0, abs=1e-3)
    fields = {one.name: one.value for one in describe(Speaker("ouster"), packets[0], "datagram")}
    assert fields["frame"] == "0"


class _Line:
    def __init__(self) -> None:
        self.baud: int | None = None
        self.heard = b""
        self.said: list[tuple[int, bytes]] = []

    def read(self) -> bytes:
        data, self.heard = self.heard, b""
        return data

    def write(self, data: bytes, at_ns: int) -> int:
        self.said.append((at_ns, data))
        return at_ns


def test_the_host_asks_until_packets_come_and_again_when_another_configuration_comes() -> None:
    line, frames, rig = _Line(), [], Rig({"config": {"lidar_mode": "512x10"}})
    script = OusterScript(line, lambda at_ns, scan: frames.append(scan))
    assert script.step(0) == 1_000_000_000
    assert script.step(500_000_000) == 1_000_000_000
    script.step(1_000_000_000)
    line.heard = stream(rig, 0.35)
    script.step(1_100_000_000)
    assert len(frames) >= 2
    assert line.said == [(0, ASK), (1_000_000_000, ASK)]
    rig.call("POST", "sensor/config?persist=false", '{"udp_profile_lidar":"RNG15_RFL8_NIR8"}')
    line.heard = b"".join(lidar(rig.run(0.3), WEB))
    script.step(1_400_000_000)
    assert line.said[2:] == [(1_400_000_000, ASK)]


TEXT = """\
schema: 1
seed: 1
duration_s: 2.0
world:
  - {box: {size_m: [0.5, 40, 40]}, at_m: [6.25, 0, -20], material: concrete}
weather: {sun: {total_w_m2: 1370, azimuth_deg: 180, elevation_deg: 30}}
sensors:
  - id: one
    model: ouster-os1-32
    physics: {noise: false, rule: axis}
    device: {boot_s: 0, init_s: 0, spin_up_s: 0, config: {lidar_mode: 512x10, azimuth_window: [170000, 190000]}}
expect:
  - {that: one.range_error_m, within: [-0.003, 0.003]}
  - {that: one.turns_per_s, within: [9, 11]}
"""


def test_ranges_of_a_whole_run_are_those_of_the_scene() -> None:
    made = Trial(scenario.loads(TEXT, Path("ouster.yaml")))
    verdict = made.finish()
    assert verdict.held, verdict
    made.close()
