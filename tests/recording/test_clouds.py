"""A recorded run of a Velodyne as point clouds: what is expected of it, and what other tools read of its files."""

from __future__ import annotations

import io
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from emulator.commands.cli import main
from emulator.judging.trial import Trial, Verdict
from emulator.recording import clouds, pcap
from emulator.recording.reader import RecordedRun, WireOf, read_run
from emulator.scenario import scenario
from protocols.velodyne.codec import PACKET

CASE = """\
schema: 1
seed: 1
duration_s: 0.55
world:
  - {plane: {size_m: [60, 60]}, at_m: [0, 0, 0], material: asphalt}
actors:
  - {id: cart, motion: {at_m: [0, 0, 0], velocity_m_s: [2, 0, 0]}}
  - {id: post, shape: {box: {size_m: [0.5, 2, 2]}}, material: white_plaster, motion: {at_m: [6, 0, 0]}}
sensors:
  - id: roof
    model: velodyne-vlp-16
    mount: {actor: cart, at_m: [0, 0, 1.5]}
    physics: {noise: false, rule: axis, sub_beams: 1}
    device: {boot_s: 0, spin_up_s: 0}
expect:
  - {that: roof.range_error_m, within: [0, 0.0011]}
  - {that: count(roof.range_error_m), at_least: 3}
  - {that: roof.points_on(post), within: [300, 2500]}
  - {that: roof.layers_on(post), within: [10, 11]}
  - {that: roof.coverage, within: [0.4, 0.7]}
  - {that: 'roof.nearest_in("2:10, -1:1, -1:1")', within: [4.4, 5.8]}
  - {that: 'min(roof.nearest_in(":, :, :-1"))', at_least: 1}
  - {that: 'roof.points_in("20:, :, :")', at_least: 1}
  - {that: 'roof.points_in("2:3, 10:11, 5:6")', equals: 0}
  - {that: roof.turns_per_s, within: [9.9, 10.1]}
  - {that: count(roof.points), within: [3, 5]}
"""


@pytest.fixture(scope="module")
def reported(tmp_path_factory: pytest.TempPathFactory) -> tuple[Verdict, Path, RecordedRun]:
    folder = tmp_path_factory.mktemp("clouds") / "run"
    trial = Trial(scenario.loads(CASE, Path("case.yaml")), record=folder)
    verdict = trial.finish()
    trial.close()
    return verdict, folder, read_run(folder)


def test_expectations_hold_for_whole_turns_and_all_layers(reported: tuple[Verdict, Path, RecordedRun]) -> None:
    verdict = reported[0]
    assert len(verdict.judgements) == 11
    assert [str(one) for one in verdict.judgements if not one.held] == []


Export = Callable[..., str]


@pytest.fixture
def export(capsys: pytest.CaptureFixture[str]) -> Export:
    """Runs the command; what it says."""

    def run(folder: Path, out: Path, *more: str) -> str:
        assert main(["export", str(folder), "--to", str(out), *more]) == 0
        return capsys.readouterr().out

    return run


def table(reported: tuple[Verdict, Path, RecordedRun], in_world: bool = True) -> clouds.Points:
    run = reported[2]
    where = clouds.where_of(run)
    return clouds.points_of(run, "roof", 0, where if in_world else None, 0.0, 1e9, False)


def test_points_are_where_the_world_is_at_their_own_instants(reported: tuple[Verdict, Path, RecordedRun]) -> None:
    points = table(reported)
    post = points[points["actor"] == 2]
    ground = points[points["actor"] == 0]
    assert np.abs(ground["z"]).max() < 1e-3
    front = post[np.abs(post["y"]) < 0.9]
    assert front["x"] == pytest.approx(5.75, abs=2e-3)  # although the cart has gone a metre
    own = table(reported, in_world=False)
    moved = points["x"] - own["x"]
    assert moved == pytest.approx(2.0 * points["time"], abs=1e-6)
    assert sorted(np.unique(points["ring"])) == list(range(len(np.unique(points["ring"]))))
    assert points["ring"].max() in (10, 11)  # nothing is above the post
    high = np.degrees(np.arctan2(own["z"], np.hypot(own["x"], own["y"])))
    assert high == pytest.approx(-15.0 + 2.0 * own["ring"], abs=1e-3)


@pytest.mark.parametrize("kind", ["las", "pcd", "ply"])
def test_other_tools_read_all_columns(
    kind: str, reported: tuple[Verdict, Path, RecordedRun], tmp_path: Path, export: Export
) -> None:
    out, points = tmp_path / f"a.{kind}", table(reported)
    said = export(reported[1], out)
    assert f"{len(points)} points of roof" in said
    assert "actor 2: post" in said
    if kind == "las":
        import laspy

        cloud = laspy.read(out)
        at_m = np.stack([cloud.x, cloud.y, cloud.z], axis=1)
        rest = {"time": cloud.gps_time, "actor": cloud.actor, "ring": cloud.ring, "intensity": cloud.signal}
        assert (np.asarray(cloud.return_number) == points["echo"] + 1).all()
        assert (np.asarray(cloud.return_number) <= np.asarray(cloud.number_of_returns)).all()
    elif kind == "pcd":
        from pypcd4 import PointCloud

        found = PointCloud.from_path(out)
        at_m = found.numpy(("x", "y", "z"))
        rest = {name: found.numpy((name,))[:, 0] for name in ("time", "actor", "ring", "intensity")}
    else:
        from trimesh.exchange.load import load

        vertices = load(out).metadata["_ply_raw"]["vertex"]["data"]
        at_m = np.stack([vertices[name] for name in "xyz"], axis=1).reshape(-1, 3)
        rest = {name: vertices[name].ravel() for name in ("time", "actor", "ring", "intensity")}
        head = out.read_bytes().partition(b"end_header")[0].decode()
        assert "property int ring\n" in head  # Open3D passes over ushort
        assert "property int sensor\n" in head
    assert at_m == pytest.approx(np.stack([points[name] for name in "xyz"], axis=1), abs=1e-4)
    assert np.asarray(rest["time"]) == pytest.approx(points["time"], abs=1e-6)
    assert (np.asarray(rest["actor"]) == points["actor"]).all()
    assert (np.asarray(rest["ring"]) == points["ring"]).all()
    assert np.asarray(rest["intensity"]) == pytest.approx(points["intensity"], rel=1e-6)


def test_a_part_of_the_time_and_nothing_at_all_are_files_too(
    reported: tuple[Verdict, Path, RecordedRun], tmp_path: Path, export: Export
) -> None:
    some = export(reported[1], tmp_path / "a.ply", "--from", "0.2", "--until", "0.3", "--json")
    points = table(reported)
    inside = np.count_nonzero((points["time"] >= 0.2) & (points["time"] < 0.3))
    assert f'"points": {inside}' in some
    for kind in ("las", "pcd", "ply"):
        assert "0 points" in export(reported[1], tmp_path / f"b.{kind}", "--from", "5")
    assert not list(tmp_path.glob(".*"))


def test_a_decoder_of_another_author_reads_the_capture(
    reported: tuple[Verdict, Path, RecordedRun], tmp_path: Path
) -> None:
    import velodyne_decoder as stranger

    out = tmp_path / "a.pcap"
    packets = [one for one in reported[2].sent["roof", 0].payloads if len(one.data) == 1206]
    assert len(packets) > 300
    wire = WireOf("roof", 0, "datagram", "udp:127.0.0.1:2368?listen=127.0.0.2:2369", packets)
    assert pcap.write(out, [wire]) == len(packets)
    read = [cloud for _, cloud in stranger.read_pcap(str(out), as_pcl_structs=False)]
    said = np.frombuffer(b"".join(one.data for one in packets), PACKET)["blocks"]["channels"]["distance"]
    words = int(np.count_nonzero(said))
    assert sum(map(len, read)) == pytest.approx(words, rel=0.01)  # it drops what is nearer than it believes in


def test_frames_have_the_addresses_of_their_links_and_checksums_that_hold() -> None:
    import dpkt

    assert pcap.places_of("udp:127.0.0.1:2368?listen=127.0.0.2:2369") == (("127.0.0.2", 2369), ("127.0.0.1", 2368))
    assert pcap.places_of("udp:239.0.0.1:7") == (("127.0.0.1", 0), ("239.0.0.1", 7))
    frame = dpkt.ethernet.Ethernet(pcap.frame(("10.1.2.3", 7), ("10.1.2.255", 8), b"abc"))
    packet = frame.data
    assert (packet.src, packet.dst) == (bytes((10, 1, 2, 3)), bytes((10, 1, 2, 255)))
    assert (packet.data.sport, packet.data.dport, packet.data.data) == (7, 8, b"abc")
    told_sum, packet.sum = packet.sum, 0
    assert dpkt.ip.IP(bytes(packet)).sum == told_sum
    assert dpkt.pcap.Reader(io.BytesIO(pcap.capture([]))).datalink() == 1


@pytest.mark.parametrize(
    ("more", "said"),
    [
        (("--to", "a.xyz"), "want a file that ends in .pcd, .ply, .las, .pcap"),
        (("--to", "/no/such/a.las"), "want a file in an existing folder"),
        (("--to", "a.las", "--sensor", "x"), "sensor 'x'; want roof"),
        (("--to", "a.las", "--from", "3", "--until", "2"), "want an instant after --from 3"),
        (("--to", "a.pcap", "--first"), "want it without --from, --until and --first"),
        (("--to", "a.pcap", "--sensor", "x"), "no datagrams were sent"),
    ],
)
def test_what_cannot_be_is_refused(
    more: tuple[str, ...], said: str, reported: tuple[Verdict, Path, RecordedRun], capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["export", str(reported[1]), *more]) == 2
    assert said in " ".join(capsys.readouterr().err.split())
    assert not Path(more[1]).exists()
