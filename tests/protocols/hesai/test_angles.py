"""Directions, places and motion that a stranger's decoder finds, against those that the world was asked for."""

from __future__ import annotations

import math
import struct

import numpy as np
import pytest

from protocols.hesai import calibration
from protocols.hesai.models import MODELS
from protocols.scan import Scan, ScanPlan
from tests.protocols.hesai import reader
from tests.protocols.hesai.rig import Rig, clouds
from tests.protocols.hesai.test_packets import SPANS, angles, beams, hesai_azimuth

CENTRES_MM = {
    "hesai-xt32": (-13.0, 31.5), "hesai-xt32m2x": (-13.0, 30.5), "hesai-pandar128e3x": (-12.0, 43.56),
    "hesai-ot128": (-10.0, 45.0), "hesai-pandar40p": (-12.0, 38.73), "hesai-qt64": (-7.2, 29.8),
}  # fmt: skip
"Of the maker's drivers: to the right and along the beam."


@pytest.mark.parametrize("name", sorted(MODELS))
def test_the_served_file_with_azimuth_and_instant_gives_every_beam_that_was_measured(name: str) -> None:
    rig = Rig(name)
    table, asked = angles(rig, name), len(rig.plans)
    packets = [reader.decode(one.payload) for one in clouds(rig.run(0.06))]
    ahead = 90.0 if name == "hesai-at128" else 0.0
    plans = rig.plans[max(0, asked - 20) :]
    true = np.concatenate([np.stack((hesai_azimuth(one, ahead), one.elevation_rad * SPANS), 1) for one in plans])
    true = true[np.argsort(true[:, 1])]
    instants, degree_ns = MODELS[name].instants(False), MODELS[name].rpm[0] / 60.0 * 360.0 * 1e-9
    rounds = 0.0101 if name != "hesai-at128" else 1e-4
    for packet in packets[5:-5:9]:
        for point in packet.points[:: 7 if len(packet.points) > 60 else 3]:
            late = instants[packet.state(point.block), point.channel] * degree_ns
            azimuth, elevation = table.direction(point.azimuth_deg, point.channel, late)
            same = slice(*np.searchsorted(true[:, 1], (elevation - 5e-4, elevation + 5e-4)))
            apart = np.abs((true[same, 0] - azimuth + 180.0) % 360.0 - 180.0)
            assert apart.min() < 0.5 * rounds + 5e-4


@pytest.mark.parametrize("name", sorted(CENTRES_MM))
def test_a_driver_that_corrects_for_the_optical_centre_sees_a_plane_wall_as_one(name: str) -> None:
    """And one that does not sees points of the wall up to the centre's offset beside it."""
    away = 2.0

    def world(plan: ScanPlan) -> Scan:
        origin, way = beams(plan)
        scan = Scan.empty(plan)
        with np.errstate(divide="ignore"):
            range_m = (away - origin[:, 0]) / way[:, 0]
        scan.range_m[:, 0] = np.where((range_m > 0.0) & (range_m < 5.0), range_m, np.nan)
        scan.intensity[:, 0] = 100.0
        return scan

    rig = Rig(name)
    rig.world = world
    table = angles(rig, name)
    right, along = (0.001 * one for one in CENTRES_MM[name])
    instants, degree_ns = MODELS[name].instants(False), MODELS[name].rpm[0] / 60.0 * 360.0 * 1e-9
    checked = 0
    for sent in clouds(rig.run(0.02)):
        packet = reader.decode(sent.payload)
        for point in packet.points[::5]:
            late = instants[packet.state(point.block), point.channel] * degree_ns
            azimuth, elevation = (math.radians(one) for one in table.direction(point.azimuth_deg, point.channel, late))
            head = math.radians(point.azimuth_deg + late)
            ox, oy = (
                right * math.cos(head) + along * math.sin(head),
                along * math.cos(head) - right * math.sin(head),
            )
            way = np.array((math.sin(azimuth), math.cos(azimuth), math.tan(elevation))) * math.cos(elevation)
            lead = ox * way[0] + oy * way[1]
            on = -lead + math.sqrt(lead**2 - ox**2 - oy**2 + point.range_m**2)
            assert oy + on * way[1] == pytest.approx(away, abs=MODELS[name].unit_mm / 2000.0 + 1e-3)
            checked += 1
    assert checked > 100


def test_the_adjustments_of_an_at128_are_those_of_the_published_unit_at_its_marks() -> None:
    file = reader.Mirrors(calibration.served(MODELS["hesai-at128"]))
    at = [file.adjusted(0, 0, file.starts[0] + since) for since in (12.0, 45.0, 78.0)]
    assert at[0] == pytest.approx(0.52, abs=0.03)
    assert abs(at[1]) < 0.02
    assert at[2] == pytest.approx(-0.94, abs=0.05)
    assert file.adjusted(1, 0, 20.0 + 45.0) == pytest.approx(0.04, abs=0.011)
    assert file.adjusted(1, 0, 20.0 + 12.0) == pytest.approx(0.12, abs=0.02)
    assert file.adjusted(0, 5, 20.0 + 100.0) == 0.0
    assert {file.adjusted(1, 0, start + 45.0) for start in file.starts} > {file.adjusted(1, 0, 65.0)}, "unlike mirrors"


def test_the_inertial_unit_of_an_ot128_feels_what_its_mount_does() -> None:
    rig = Rig("hesai-ot128", {"range_deg": [0, 40]})
    rig.session.feel(lambda at_ns: (np.array((2.0, 3.0, 9.80665)), np.array((0.0, 0.0, 0.5))))
    imu = reader.decode(clouds(rig.run(0.1))[-1].payload).imu
    assert imu[1:3] == (122, 305)
    force = np.array(imu[4:7]) * imu[1] / 1e6 * 9.80665
    rate = np.array(imu[7:10]) * imu[2] / 1e5
    assert force == pytest.approx([-3.0, 2.0, 9.80665], abs=1e-3), "x to the right, y ahead"
    assert rate == pytest.approx([0.0, 0.0, math.degrees(0.5)], abs=2e-3)


def test_at_rest_it_feels_gravity() -> None:
    rig = Rig("hesai-pandar128e3x", {"range_deg": [0, 40]})
    packets = [reader.decode(one.payload) for one in clouds(rig.run(0.2))]
    assert packets[-1].imu[6] * 122e-6 == pytest.approx(1.0, abs=2e-4)
    ticks = [one.imu[3] for one in packets]
    assert 0 < ticks[-1] - ticks[0] < 0.2 / 25e-6 + 1


def test_a_firing_without_return_stays_without() -> None:
    rig = Rig("hesai-xt32")
    rig.world = Scan.empty
    assert not reader.decode(clouds(rig.run(0.05))[3].payload).points


def test_words_of_a_damaged_file_are_seen_by_its_hash() -> None:
    whole = calibration.served(MODELS["hesai-at128"])
    reader.Mirrors(whole)
    with pytest.raises(AssertionError):
        reader.Mirrors(calibration.damaged(whole))
    assert struct.unpack_from("<3I", whole, 16) == (256000, 1792000, 3328000)


@pytest.mark.parametrize("name", ["hesai-xt32", "hesai-at128"])
def test_a_whole_file_of_another_unit_is_served_as_a_fault(name: str) -> None:
    rig = Rig(name, {"standby": True})
    own = angles(rig, name)
    rig.session.impair(rig.now_ns, "wrong calibration served", 0.5)
    other = angles(rig, name)
    for channel in (0, 17, 31):
        before, after = (one.direction(65.0, channel, 0.0) for one in (own, other))
        assert (after[0], after[1]) == pytest.approx((before[0], before[1] + 0.5), abs=1e-4)
    rig.session.impair(rig.now_ns, "wrong calibration served", 0.0)
    assert angles(rig, name).direction(65.0, 3, 0.0) == own.direction(65.0, 3, 0.0)
