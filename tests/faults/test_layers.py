"""Faults of single layers of a rotating sensor, by closed form, and lost packets of it."""

from __future__ import annotations

import functools
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from emulator.errors import ScenarioError
from emulator.hosts.scans import HostCloud
from emulator.hosts.velodyne import TurnReader
from emulator.judging.trial import Trial
from emulator.scenario import scenario
from protocols.velodyne.codec import DATA_BYTES
from tests.faults.runs import Sent

BEGIN_S, END_S, DISTANCE_M = 0.5, 0.8, 8.0
TEXT = """\
schema: 1
seed: 3
duration_s: 1.1
world:
  - {plane: {size_m: [20, 80]}, at_m: [8, 0, 1], pitch_deg: -90, material: white_plaster}
actors:
  - {id: post, shape: {box: {size_m: [0.2, 0.4, 8]}}, material: white_plaster, motion: {at_m: [4, 0, -3]}}
sensors:
  - id: roof
    model: velodyne-vlp-16
    mount: {at_m: [0, 0, 1]}
    physics: {noise: false, rule: axis, sub_beams: 1}
    device: {boot_s: 0, spin_up_s: 0, fov_deg: [330, 30], rpm: 1200}
"""


@dataclass(frozen=True, eq=False)
class Seen:
    """A run as a host reads it."""

    clouds: tuple[tuple[float, HostCloud], ...]
    "Turns and when they began to come. [s]"
    hits: int
    dropped: int
    stamps_us: tuple[int, ...]

    def part(self, from_s: float, to_s: float) -> list[HostCloud]:
        """Turns wholly within that time."""
        return [cloud for at_s, cloud in self.clouds if from_s <= at_s - 0.07 and at_s < to_s]


@functools.lru_cache(maxsize=8)
def run(fault: str = "", model: str = "velodyne-vlp-16") -> Seen:
    text = TEXT.replace("velodyne-vlp-16", model)
    if fault:
        when = "" if "at_" in fault else f", at_s: {BEGIN_S}, for_s: {END_S - BEGIN_S:.1f}"
        text += f"faults:\n  - {{on: roof{when}, do: {fault}}}\n"
    sent = Sent()
    trial = Trial(scenario.loads(text, Path("case.yaml")), watchers=[sent])
    trial.finish()
    trial.close()
    reader, clouds, stamps = TurnReader(), [], []
    for one in sent.payloads:
        if len(one.data) == DATA_BYTES:
            stamps.append(int.from_bytes(one.data[1200:1204], "little"))
            for scan in reader.feed(one.data):
                assert scan.cloud is not None
                clouds.append((one.start_ns * 1e-9, scan.cloud))
    (instrument,) = trial.instruments
    rows = trial.faults.rows()
    hits = int(str(rows[0]["hits"])) if rows else 0
    return Seen(tuple(clouds), hits, instrument.stats.scans_dropped.total(), tuple(stamps))


def same(one: HostCloud, other: HostCloud) -> bool:
    return np.array_equal(one.range_m, other.range_m) and np.array_equal(one.azimuth_rad, other.azimuth_rad)


def heals(faulty: Seen) -> bool:
    """Before it begins and after its end a host reads what it would have read without it."""
    pairs = [
        pair
        for span in ((0.0, BEGIN_S), (END_S, 2.0))
        for pair in zip(faulty.part(*span), run().part(*span), strict=True)
    ]
    return len(pairs) > 8 and all(same(*pair) for pair in pairs)


def layer(cloud: HostCloud, elevation_deg: float) -> np.ndarray:
    return np.abs(np.degrees(cloud.elevation_rad) - elevation_deg) < 0.1


def wall_m(cloud: HostCloud) -> np.ndarray:
    """Range of the wall in the direction of each return."""
    return DISTANCE_M / np.cos(cloud.azimuth_rad) / np.cos(cloud.elevation_rad)


@pytest.mark.parametrize(("near_deg", "dead_deg"), [(0.0, -1.0), (-7.2, -7.0), (90.0, 15.0)])
def test_a_dead_laser_is_missing_and_only_that_one(near_deg: float, dead_deg: float) -> None:
    faulty = run(f"dead_layers, elevation_deg: {near_deg}")
    assert faulty.hits > 0
    parts = faulty.part(BEGIN_S, END_S)
    assert len(parts) >= 3
    for cloud in parts:
        assert not layer(cloud, dead_deg).any()
        assert len(np.unique(cloud.elevation_rad)) == 15
    assert heals(faulty)


def test_so_many_lasers_are_dead_as_are_said() -> None:
    for cloud in run("dead_layers, elevation_deg: 15, layers: 4").part(BEGIN_S, END_S):
        assert np.degrees(cloud.elevation_rad.max()) == pytest.approx(7.0)


def post_deg(clouds: list[HostCloud], elevation_deg: float) -> float:
    """Where a layer has the middle of the post; in all turns, as a packet over azimuth 0 belongs to one of two."""
    mine = [one.azimuth_rad[layer(one, elevation_deg) & (one.range_m < 5.0)] for one in clouds]
    return float(np.degrees(np.concatenate(mine)).mean())


def test_a_laser_that_looks_elsewhere_shows_the_world_turned_in_its_layer() -> None:
    faulty = run("layer_offset, elevation_deg: 3, azimuth_deg: 2.0")
    assert post_deg(faulty.part(BEGIN_S, END_S), 3.0) == pytest.approx(-2.0, abs=0.3)
    assert post_deg(faulty.part(BEGIN_S, END_S), 5.0) == pytest.approx(0.0, abs=0.3)
    assert heals(faulty)


def test_a_laser_that_looks_higher_has_the_range_of_there() -> None:
    for cloud in run("layer_offset, elevation_deg: 15, azimuth_deg: 0, up_deg: 10").part(BEGIN_S, END_S):
        mine = layer(cloud, 15.0) & (np.abs(np.degrees(cloud.azimuth_rad)) > 5.0)
        expected = DISTANCE_M / np.cos(cloud.azimuth_rad[mine]) / np.cos(np.radians(25.0))
        assert cloud.range_m[mine] == pytest.approx(expected, abs=0.003)
        rest = ~layer(cloud, 15.0) & (np.abs(np.degrees(cloud.azimuth_rad)) > 5.0)
        assert cloud.range_m[rest] == pytest.approx(wall_m(cloud)[rest], abs=0.003)


def test_with_the_calibration_of_another_unit_each_layer_has_an_error_of_its_own() -> None:
    faulty = run("wrong_calibration, sigma_m: 0.2")
    errors = []
    for cloud in faulty.part(BEGIN_S, END_S):
        off = np.abs(np.degrees(cloud.azimuth_rad)) > 5.0
        away = cloud.range_m - wall_m(cloud)
        errors.append([away[off & layer(cloud, -15.0 + 2.0 * at)].mean() for at in range(16)])
        assert max(np.ptp(away[off & layer(cloud, -15.0 + 2.0 * at)]) for at in range(16)) < 0.006
    assert np.ptp(np.array(errors), axis=0).max() < 0.003  # it stays
    assert 0.1 < np.std(errors[0]) < 0.4
    assert heals(faulty)


def test_a_lost_packet_is_one_packet_and_the_time_goes_on() -> None:
    faulty, healthy = run("drop_telegram, at_telegram: 100"), run()
    lost = sorted(set(healthy.stamps_us) - set(faulty.stamps_us))
    assert len(lost) == 1
    assert set(faulty.stamps_us) < set(healthy.stamps_us)
    assert len(healthy.stamps_us) - len(faulty.stamps_us) == 1


def test_an_offset_of_nothing_is_refused() -> None:
    text = TEXT + "faults:\n  - {on: roof, at_s: 0, do: layer_offset, azimuth_deg: 0}\n"
    with pytest.raises(ScenarioError, match="nothing moves; want azimuth_deg or up_deg other than 0"):
        Trial(scenario.loads(text, Path("case.yaml")))
