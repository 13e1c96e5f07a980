"""A sensor with a pattern in virtual time: instants, slices, packets, and what is refused."""

from __future__ import annotations

from fractions import Fraction
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from emulator.errors import SpecError
from emulator.hosts.livox import FrameReader
from emulator.sensors.spec import load_spec, load_spec_file
from protocols.errors import DeviceSettingError
from protocols.livox import FAMILY
from protocols.livox.codec import MOST_POINTS, Read, decode
from protocols.livox.device import SLICE_NS, Frames, PatternSession, cut
from protocols.livox.patterns import Raster
from protocols.livox.settings import facts_of
from protocols.scan import Scan, ScanPlan
from protocols.session import Address, Dropped, DropReason, Emission, LinkKind

MS = 1_000_000
NAMES = ("solid-state-raster", "solid-state-rosette", "solid-state-lissajous")


def fact(**value: Any) -> dict[str, Any]:
    return {"pattern": {"value": value, "source": "here", "evidence": "choice"}}


def ranges(plan: ScanPlan) -> np.ndarray:
    """A wall 8 m ahead; nothing to the far left."""
    found = 8.0 / (np.cos(plan.azimuth_rad) * np.cos(plan.elevation_rad))
    return np.where(plan.azimuth_rad < np.radians(15.0), found, np.nan)


class Rig:
    """One session, switched on at 0."""

    def __init__(self, facts: dict[str, Any], **device: Any) -> None:
        self.session: PatternSession = FAMILY.new_session({"boot_s": 0.0} | device, facts)
        self.plans: list[ScanPlan] = []
        self.session.connected(0, Address(0, 0), LinkKind.DATAGRAM)
        self.session.power_on(0)

    def run(self, until_ns: int) -> list[Emission]:
        session = self.session
        session.advance(0)
        while (plan := session.next_plan()) is not None and plan.start_ns < until_ns:
            self.plans.append(plan)
            scan = Scan.empty(plan)
            scan.range_m[:, 0] = ranges(plan)
            scan.intensity[:, 0] = np.where(np.isnan(scan.range_m[:, 0]), np.nan, 3.0)
            session.submit(scan)
        return session.take_emissions(until_ns)


def facts_for(name: str) -> dict[str, Any]:
    return dict(load_spec(name).device)


def decoded(emission: Emission) -> Read:
    read = decode(emission.payload)
    assert read is not None
    return read


@pytest.mark.parametrize("name", NAMES)
def test_packets_tell_each_beam_at_its_own_instant_and_leave_when_the_last_has_fired(name: str) -> None:
    rig = Rig(facts_for(name))
    sent = rig.run(300 * MS)
    reads = [decoded(one) for one in sent]
    frames = np.concatenate([np.full(len(plan), plan.turn) for plan in rig.plans])
    fires_ns = np.concatenate([plan.start_ns + 1e9 * plan.fire_offset_s for plan in rig.plans])
    truth = np.concatenate([ranges(plan) for plan in rig.plans])
    azimuth = np.concatenate([plan.azimuth_rad for plan in rig.plans])
    elevation = np.concatenate([plan.elevation_rad for plan in rig.plans])
    first = 0
    for emission, read in zip(sent, reads, strict=True):
        n = len(read.xyz_m)
        beams = slice(first, first + n)
        assert n <= MOST_POINTS
        assert read.stamp_ns == pytest.approx(fires_ns[first], abs=1.0)
        assert read.interval_ns == pytest.approx(fires_ns[first + n - 1] - fires_ns[first], abs=51.0)
        assert emission.due_ns == pytest.approx(fires_ns[first + n - 1], abs=2.0)
        assert np.ptp(np.diff(fires_ns[beams])) < 1.0, "no gap within a packet"
        assert set(frames[beams]) == {read.frame}
        seen = ~np.isnan(truth[beams])
        assert not read.xyz_m[~seen].any()
        expected = truth[beams, None] * np.stack(
            [
                np.cos(elevation[beams]) * np.cos(azimuth[beams]),
                np.cos(elevation[beams]) * np.sin(azimuth[beams]),
                np.sin(elevation[beams]),
            ],
            axis=1,
        )
        assert np.abs(read.xyz_m - expected)[seen].max(initial=0.0) <= 0.0005001
        first += n
    assert first == len(truth)


@pytest.mark.parametrize("name", NAMES)
def test_frames_follow_each_other_and_packets_are_counted_within_them(name: str) -> None:
    pattern, _ = facts_of(facts_for(name))
    rig = Rig(facts_for(name))
    reads = [decoded(one) for one in rig.run(400 * MS)]
    assert [read.frame for read in reads] == sorted(read.frame for read in reads)
    for frame in range(4):
        mine = [read for read in reads if read.frame == frame]
        assert [read.count for read in mine] == list(range(len(mine)))
        assert sum(len(read.xyz_m) for read in mine) == pattern.points
        assert mine[0].stamp_ns == frame * 100 * MS
    assert all(plan.duration_s < 1e-9 * SLICE_NS for plan in rig.plans)
    assert [plan.sweep for plan in rig.plans] == list(range(len(rig.plans)))


def test_a_host_reads_frames_of_points() -> None:
    rig = Rig(facts_for("solid-state-raster"))
    data = b"".join(one.payload for one in rig.run(300 * MS))
    reader = FrameReader()
    scans = [scan for at in range(0, len(data), 777) for scan in reader.feed(data[at : at + 777])]
    assert (len(scans), reader.errors) == (2, 0)
    cloud = scans[1].cloud
    assert cloud is not None
    assert not cloud.layered
    np.testing.assert_allclose(cloud.range_m * np.cos(cloud.azimuth_rad) * np.cos(cloud.elevation_rad), 8.0, atol=6e-4)
    assert np.degrees(cloud.azimuth_rad).max() == pytest.approx(15.0, abs=0.2)
    assert len(scans[1].range_m) == len(cloud.range_m) * 6 // 64, "rows within a degree of the horizon"


def test_a_row_is_cut_evenly_and_no_packet_spans_a_flyback() -> None:
    raster = Raster(Fraction(100_000), 3, 200, (20.0, 2.0), Fraction(1, 100))
    packets = [packet for one in cut(raster, 0) for packet in one]
    edges = [0, 66, 133, 200, 266, 333, 400, 466, 533, 600]
    assert packets == list(pairwise(edges))
    assert [len(one) for one in cut(raster, 2)] == [2, 2, 2, 2, 1]


def test_slow_points_fit_the_field_of_the_interval() -> None:
    rig = Rig(fact(lissajous={"points_per_s": 1000, "field_deg": [20, 10], "hz": [50, 40]}))
    reads = [decoded(one) for one in rig.run(300 * MS)]
    assert {len(read.xyz_m) for read in reads} <= {6, 7}
    assert all(read.interval_ns == MS * (len(read.xyz_m) - 1) for read in reads)


@pytest.mark.parametrize("begin_ns", [(0,), (0, 5, 9)])
def test_slices_are_numbered_over_all_frames(begin_ns: tuple[int, ...]) -> None:
    frames = Frames(100, Fraction(100, 3), begin_ns)
    instants = [frames.at(number) for number in range(40)]
    assert instants == sorted(instants)
    for one, other in pairwise(instants):
        for instant in range(one + 1, other + 1):
            assert instants[frames.first_from(instant)] == other
    assert frames.first_from(100) == 0
    assert frames.first_from(0) <= 0


def test_a_sweep_that_is_late_is_reported_and_the_next_one_asked_for() -> None:
    rig = Rig(facts_for("solid-state-rosette"))
    rig.run(20 * MS)
    rig.session.advance(60 * MS)
    rig.session.take_events()
    plan = rig.session.next_plan()
    assert plan is not None
    assert rig.session.missed(plan, 60 * MS)
    plan = rig.session.next_plan()
    assert plan is not None
    assert plan.start_ns + 1e9 * plan.duration_s > 60 * MS - 1
    late = [one for one in rig.session.take_events() if isinstance(one, Dropped)]
    assert {one.reason for one in late} == {DropReason.LATE}
    assert sum(one.count for one in late) == plan.sweep - rig.plans[-1].sweep - 1


def test_input_is_ignored_and_no_motor_can_be_impaired() -> None:
    rig = Rig(facts_for("solid-state-lissajous"))
    rig.run(20 * MS)
    rig.session.take_events()
    rig.session.receive(b"\xaa\x00", 20 * MS)
    assert [one.reason for one in rig.session.take_events() if isinstance(one, Dropped)] == [DropReason.UNKNOWN_COMMAND]
    assert not rig.session.impair(20 * MS, "motor speed", 0.5)


GOOD: dict[str, dict[str, Any]] = {
    "raster": {"rows": 4, "columns": 50, "field_deg": [10, 5]},
    "rosette": {"index": [1.5, 1.5], "wedge_deg": [10, 10], "hz": [100, -60]},
    "lissajous": {"field_deg": [10, 5], "hz": [100, 60]},
}


def without(kind: str, key: str) -> dict[str, Any]:
    return {name: value for name, value in GOOD[kind].items() if name != key}


@pytest.mark.parametrize(
    ("facts", "key"),
    [
        ({}, "pattern"),
        ({"lasers": 3}, "lasers"),
        ({"white_m2": 0}, "white_m2"),
        ({"pattern": []}, "pattern"),
        ({"pattern": {"value": {"raster": GOOD["raster"]}}}, "pattern.source"),
        ({"pattern": {"value": {"raster": GOOD["raster"]}, "source": "x"}}, "pattern.evidence"),
        ({"pattern": {"source": "x", "evidence": "choice"}}, "pattern.value"),
        ({"pattern": fact()["pattern"] | {"more": 1}}, "pattern.more"),
        (fact(spiral={}), "pattern.value"),
        (fact(raster=GOOD["raster"], rosette=GOOD["rosette"]), "pattern.value"),
        (fact(raster=3), "pattern.value.raster"),
        *((fact(**{kind: without(kind, key)}), f"pattern.value.{kind}.{key}") for kind in GOOD for key in GOOD[kind]),
        *((fact(**{kind: GOOD[kind] | {"more": 1}}), f"pattern.value.{kind}.more") for kind in GOOD),
        (fact(raster=GOOD["raster"] | {"rows": 0}), "pattern.value.raster.rows"),
        (fact(raster=GOOD["raster"] | {"rows": 9999, "columns": 9999, "points_per_s": 5e6}), "pattern.value.raster"),
        (fact(raster=GOOD["raster"] | {"field_deg": [10]}), "pattern.value.raster.field_deg"),
        (fact(raster=GOOD["raster"] | {"field_deg": [10, float("nan")]}), "pattern.value.raster.field_deg"),
        (fact(raster=GOOD["raster"] | {"field_deg": [10, 181]}), "pattern.value.raster.field_deg"),
        (fact(raster=GOOD["raster"] | {"flyback_us": -1}), "pattern.value.raster.flyback_us"),
        (fact(raster=GOOD["raster"] | {"rows": 1, "columns": 1}), "pattern.value.raster"),
        (fact(raster=GOOD["raster"] | {"points_per_s": True}), "pattern.value.raster.points_per_s"),
        (fact(raster=GOOD["raster"] | {"both_ways": 1}), "pattern.value.raster.both_ways"),
        (fact(lissajous=GOOD["lissajous"] | {"hz": [100, 0]}), "pattern.value.lissajous.hz"),
        (fact(lissajous=GOOD["lissajous"] | {"hz": [100.01, 60]}), "pattern.value.lissajous"),
        (fact(lissajous=GOOD["lissajous"] | {"frame_ms": 0}), "pattern.value.lissajous.frame_ms"),
        (fact(lissajous=GOOD["lissajous"] | {"phase_deg": "x"}), "pattern.value.lissajous.phase_deg"),
        (fact(rosette=GOOD["rosette"] | {"wedge_deg": [45, 1]}), "pattern.value.rosette.wedge_deg"),
        (fact(rosette=GOOD["rosette"] | {"index": [0.9, 1.5]}), "pattern.value.rosette.index"),
    ],
)  # fmt: skip
def test_a_pattern_that_cannot_be_is_refused_with_its_key(facts: dict[str, Any], key: str) -> None:
    with pytest.raises(DeviceSettingError) as refused:
        facts_of(facts)
    assert refused.value.key == key


@pytest.mark.parametrize("kind", GOOD)
def test_the_least_that_a_pattern_needs_is_accepted(kind: str) -> None:
    pattern, _ = facts_of(fact(**{kind: GOOD[kind]}))
    assert pattern.points > 0


def test_a_pattern_replaces_that_of_the_parent_and_is_refused_with_its_line(tmp_path: Path) -> None:
    path = tmp_path / "acme.yaml"
    text = (
        "model: acme\nextends: solid-state-rosette\ndevice:\n  pattern:\n    source: here\n    evidence: choice\n"
        "    value:\n      raster:\n        rows: ROWS\n        columns: 50\n        field_deg: [10, 5]\n"
    )
    path.write_text(text.replace("ROWS", "4"))
    pattern, _ = facts_of(load_spec_file(path).device)
    assert isinstance(pattern, Raster)
    path.write_text(text.replace("ROWS", "-4"))
    with pytest.raises(SpecError, match=r"acme.yaml:9: device.pattern.value.raster.rows: -4; want an integer"):
        load_spec_file(path)
