"""Our host for Velodyne: turns out of packets in any chunking, and the fields of a packet."""

from __future__ import annotations

import numpy as np
import pytest

from emulator.hosts.describe import Speaker, describe
from emulator.hosts.velodyne import ASK, TurnReader, VelodyneScript
from protocols.scan import Scan, ScanPlan
from protocols.velodyne.models import MODELS, MODES
from tests.protocols.velodyne.rig import POSITION, WEB, Rig, packets


def round_room(plan: ScanPlan) -> Scan:
    """The range tells the azimuth: 10 m + 1 m a radian to the left."""
    scan = Scan.empty(plan)
    scan.range_m[:, 0] = 10.0 + np.angle(np.exp(1j * plan.azimuth_rad))
    scan.intensity[:, 0] = 20.0
    return scan


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("name", MODELS)
def test_a_turn_is_the_layer_nearest_to_the_horizon_where_it_was(name: str, mode: str) -> None:
    rig = Rig({"returns": mode}, name)
    rig.world = round_room
    data = b"".join(one.payload for one in packets(rig.run(0.35)))
    reader = TurnReader()
    found = [scan for at in range(0, len(data), 1000) for scan in reader.feed(data[at : at + 1000])]
    assert reader.errors == 0
    assert reader.title == f"Velodyne {MODELS[name].title}"
    assert [scan.number for scan in found] == [0, 1, 2]
    scan = found[1]
    assert len(scan.range_m) == pytest.approx(0.1 / (MODELS[name].cycle_ns * 1e-9), rel=0.01)
    turn = np.angle(np.exp(1j * (scan.azimuth_rad - (scan.range_m - 10.0))))
    assert np.abs(turn).max() < np.radians(0.15)


def test_what_is_no_packet_is_counted_and_the_next_one_is_found() -> None:
    data = b"".join(one.payload for one in packets(Rig().run(0.35)))
    reader = TurnReader()
    found = list(reader.feed(b"HTTP/1.1 200 OK\r\n\r\n" + data[: 1206 * 3 + 700] + data[1206 * 4 :]))
    assert len(found) >= 2
    assert reader.errors >= 1
    assert list(TurnReader().feed(bytes(5000))) == []


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


def test_the_host_asks_until_packets_come_and_again_when_they_end() -> None:
    line, turns = _Line(), []
    script = VelodyneScript(line, lambda at_ns, scan: turns.append(scan))
    assert script.step(0) == 1_000_000_000
    assert script.step(500_000_000) == 1_000_000_000
    script.step(1_000_000_000)
    line.heard = b"".join(one.payload for one in packets(Rig().run(0.35)))
    again_ns = script.step(1_500_000_000)
    assert len(turns) == 3
    assert again_ns == 3_500_000_000
    script.step(again_ns)
    assert line.said == [(0, ASK), (1_000_000_000, ASK), (3_500_000_000, ASK)]


def test_packets_are_taken_apart() -> None:
    rig = Rig({"nmea": True})
    rig.run(0.1)
    fields = {one.name: one.value for one in describe(Speaker("velodyne"), packets(rig.sent)[0].payload, "datagram")}
    assert fields["model"] == "VLP-16"
    assert fields["returns"] == "strongest"
    assert fields["distances"].startswith("10.000 10.000")
    position = next(one for one in rig.sent if one.address == POSITION)
    fields = {one.name: one.value for one in describe(Speaker("velodyne"), position.payload, "datagram")}
    assert fields["PPS"] == "absent"
    assert fields["NMEA"].startswith("$GPRMC")
    assert describe(Speaker("velodyne"), b"GET / HTTP/1.1\r\n\r\n", sent=False)[0].value == "GET / HTTP/1.1"
    assert rig.ask(b"GET / HTTP/1.1\r\n\r\n").startswith(b"HTTP/1.1 200")
    assert WEB in {one.address for one in rig.sent}
    for damaged in (b"", bytes(1206), bytes(512), b"\xff" * 1206):
        assert describe(Speaker("velodyne"), damaged)
