"""Every model and return mode in virtual time, judged by a decoder written from the specification, and by hydra4."""

from __future__ import annotations

import math
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from protocols.hesai.codec import moment
from protocols.hesai.models import MODELS
from protocols.scan import Scan, ScanPlan
from tests.protocols.hesai import reader
from tests.protocols.hesai.rig import SECOND, Rig, clouds

SPANS = 180.0 / math.pi
EVERY = [(name, mode) for name, model in MODELS.items() for mode in model.modes]


def hesai_azimuth(plan: ScanPlan, ahead: float) -> np.ndarray:
    """In the maker's frame: clockwise from y, that is ahead; of an AT128 90 degrees are."""
    return (ahead - plan.azimuth_rad * SPANS) % 360.0


def beams(plan: ScanPlan) -> tuple[np.ndarray, np.ndarray]:
    """Where beams begin, and which way they go."""
    level = np.cos(plan.elevation_rad)
    way = (np.cos(plan.azimuth_rad) * level, np.sin(plan.azimuth_rad) * level, np.sin(plan.elevation_rad))
    return np.zeros((len(plan), 3)) if plan.origin_m is None else plan.origin_m, np.stack(way, axis=1)


def along(plan: ScanPlan, away_m: np.ndarray) -> np.ndarray:
    """Range of the point of each beam that is so far from the axis' origin, which is what packets tell."""
    origin, way = beams(plan)
    lead = np.sum(origin * way, axis=1)
    return -lead + np.sqrt(lead**2 - np.sum(origin**2, axis=1) + away_m**2)


def slope(ahead: float, echoes: int = 1, offset: tuple[float, ...] = (0.0, 3.0, 6.0)) -> Callable[[ScanPlan], Scan]:
    """5 m and 1 cm a degree of azimuth; the second echo is 3 m behind, and the strongest."""

    def world(plan: ScanPlan) -> Scan:
        scan = Scan.empty(plan, 3)
        for echo in range(echoes):
            scan.range_m[:, echo] = along(plan, 5.0 + 0.01 * hesai_azimuth(plan, ahead) + offset[echo])
            scan.intensity[:, echo] = (100.0, 300.0, 200.0)[echo]
        return scan

    return world


def angles(rig: Rig, name: str) -> reader.Angles:
    file = rig.ok(0x05)
    return reader.Mirrors(file) if name == "hesai-at128" else reader.Channels(file)


@pytest.mark.parametrize(("name", "mode"), EVERY)
def test_points_of_every_model_and_mode_lie_on_the_scene(name: str, mode: int) -> None:
    model = MODELS[name]
    ahead = 90.0 if name == "hesai-at128" else 0.0
    rig = Rig(name)
    rig.world = slope(ahead, 3)
    rig.ok(0x1E, bytes((mode,)))
    table = angles(rig, name)
    sent = clouds(rig.run(0.05))[20:]
    assert len(sent) >= 25
    packets = [reader.decode(one.payload) for one in sent[:60]]
    assert {one.mode for one in packets} == {model.returns(mode)[1]}
    assert {one.rpm for one in packets} == {model.rpm[0]}
    assert [one.sequence for one in packets] == list(range(packets[0].sequence, packets[0].sequence + len(packets)))
    instants, degree_ns = model.instants(False), model.rpm[0] / 60.0 * 360.0 * 1e-9
    worst, picked = 0.0, packets[:: max(1, len(packets) // 5)]
    orders: set[tuple[int, ...]] = set()
    for packet in picked:
        echoes: dict[tuple[int, int], list[int]] = {}
        for point in packet.points:
            state = packet.state(point.block)
            late_deg = instants[state, point.channel] * degree_ns
            azimuth = table.direction(point.azimuth_deg, point.channel, late_deg)[0]
            over = point.range_m - (5.0 + 0.01 * azimuth)
            echo = round(over / 3.0)
            worst = max(worst, abs(over - 3.0 * echo))
            echoes.setdefault((point.block // packet.echoes, point.channel), []).append(echo)
        orders |= {tuple(one) for one in echoes.values()}
    assert worst < model.unit_mm / 2000.0 + 3e-4, "half a unit, and angles as the wire rounds them"
    order = {
        "last": (2,), "strongest": (1,), "first": (0,), "triple": (0, 2, 1), "first_strongest": (0, 1),
        "dual": (1, 2) if name in ("hesai-xt32", "hesai-xt32m2x") else (2, 1),
        "last_first": (0, 2) if name == "hesai-qt64" else (2, 0),
    }[model.returns(mode)[0]]  # fmt: skip
    assert orders == {order}


@pytest.mark.parametrize("name", sorted(MODELS))
def test_points_carry_the_instant_at_which_they_were_measured(name: str) -> None:
    rig = Rig(name, {"clock_source": "ptp"})
    rig.session.source.powered_on(-4 * SECOND)  # it has followed its source long enough
    first = len(rig.plans)
    packets = [reader.decode(one.payload) for one in clouds(rig.run(0.06))]
    fired = np.sort(
        np.concatenate([1e-9 * one.start_ns + one.fire_offset_s for one in rig.plans[max(0, first - 60) :]])
    )
    utc = rig.session.build.utc_ns * 1e-9
    instants = MODELS[name].instants(False)
    for packet in packets[3:-3:7]:
        for point in packet.points[::17]:
            state = packet.state(point.block)
            at = point.at_s - utc + 1e-9 * instants[state, point.channel]
            near = fired[np.searchsorted(fired, at) + np.array((-1, 0))]
            assert np.abs(near - at).min() < 1.6e-6, "stamps are whole microseconds"


def test_one_echo_is_sent_twice_and_none_as_zero() -> None:
    rig = Rig("hesai-ot128", {"returns": "dual"})
    rig.world = slope(0.0, 1)
    packet = reader.decode(clouds(rig.run(0.1))[5].payload)
    by_block = [{one.channel: one.range_m for one in packet.points if one.block == b} for b in (0, 1)]
    assert by_block[0] == by_block[1]
    assert len(by_block[0]) == 128
    rig = Rig("hesai-ot128", {"returns": "dual"})
    rig.world = lambda plan: Scan.empty(plan, 2)
    assert not reader.decode(clouds(rig.run(0.1))[5].payload).points


@pytest.mark.parametrize("name", ["hesai-pandar128e3x", "hesai-ot128"])
def test_in_high_resolution_half_of_the_outer_lasers_fire_in_each_of_two_alternating_states(name: str) -> None:
    rig = Rig(name, {"high_resolution": True})
    packets = [reader.decode(one.payload) for one in clouds(rig.run(0.1))]
    assert len(packets) == pytest.approx(1800, abs=100)
    assert {one.operation for one in packets} == {0}
    packet = packets[10]
    assert {packet.state_word >> 14 & 3, packet.state_word >> 12 & 3} == {0, 1}
    fired = [{one.channel for one in packet.points if one.block == b} for b in (0, 1)]
    assert fired[0] & fired[1] >= set(range(25, 88)), "the inner lasers fire every time"
    assert fired[0] | fired[1] == set(range(128))
    assert (packet.azimuths[1] - packet.azimuths[0]) % 360 == pytest.approx(0.1, abs=1e-6)
    assert rig.ok(0x28) == b"\1"


def test_functional_safety_counts_every_five_milliseconds_and_names_faults_by_turns() -> None:
    rig = Rig("hesai-ot128")
    packets = [reader.decode(one.payload) for one in clouds(rig.run(0.1))]
    counts = [one.safety[1] & 7 for one in packets]
    changes = [after - before for before, after in pairwise(counts) if after != before]
    assert set(changes) <= {1, -7}
    assert len(changes) == pytest.approx(20, abs=2)
    assert {one.safety[1] >> 5 for one in packets} == {1}
    rig.session.impair(rig.now_ns, "window", 0.8)
    rig.session.impair(rig.now_ns, "heat", 1.0)
    later = [reader.decode(one.payload) for one in clouds(rig.run(0.5))[-400:]]
    assert {one.safety[1] >> 5 for one in later} == {5}, "before it stops"
    assert {one.safety[2] for one in later} == {0x21, 0x22}
    assert len({one.safety[3:5] for one in later}) == 2


def test_an_at128_sends_625_packets_a_mirror_and_nothing_between() -> None:
    rig = Rig("hesai-at128")
    sent = clouds(rig.run(0.5))
    due = np.array([one.due_ns for one in sent]) * 1e-6
    gaps = np.flatnonzero(np.diff(due) > 1.0)
    assert len(gaps) >= 3
    assert set(np.diff(gaps)) == {625}
    assert np.diff(due)[gaps] == pytest.approx(47.9 + 0.083, abs=0.1)
    assert np.delete(np.diff(due), gaps).max() < 0.2


GRIDS = [
    ("hesai-xt32", 0.18, 2500), ("hesai-xt32m2x", 0.18, 10_000 / 3), ("hesai-qt64", 0.6, 1500),
    ("hesai-pandar40p", 0.2, 1800), ("hesai-ot128", 0.2, 9000),
]  # fmt: skip


@pytest.mark.parametrize(("name", "step", "rate"), GRIDS)
def test_azimuths_lie_on_the_grid_at_the_rate_of_the_model(name: str, step: float, rate: float) -> None:
    rig = Rig(name)
    sent = clouds(rig.run(0.4))
    assert len(sent) == pytest.approx(0.4 * rate, rel=0.02)
    azimuths = np.array([reader.decode(one.payload).azimuths for one in sent[:: len(sent) // 40]])
    if name != "hesai-pandar40p":
        places = azimuths / step
        assert np.abs(places - np.rint(places)).max() < 1e-6
    assert np.diff(azimuths, axis=1) % 360.0 == pytest.approx(step, abs=0.011)


@pytest.mark.parametrize("name", ["hesai-xt32", "hesai-ot128"])
def test_hydra4_reads_the_same_points_out_of_our_packets(name: str, tmp_path: Path) -> None:
    from hydra4 import decoders

    rig = Rig(name)
    rig.world = slope(0.0)
    file = tmp_path / "calibration.csv"
    file.write_bytes(rig.ok(0x05))
    made = {"hesai-xt32": decoders.PandarXT32, "hesai-ot128": decoders.PandarOT128}[name](file, 0.1, 200.0)
    late = MODELS[name].instants(False) * 3.6e-6  # degrees that the rotor has turned when a laser fires
    for sent in clouds(rig.run(0.1))[5::50]:
        states = reader.decode(sent.payload).state_word
        for at, block in enumerate(made(SimpleNamespace(data=sent.payload))):
            assert len(block.points) == MODELS[name].lasers
            for x, y, z, _, ring, _, _ in block.points:
                azimuth = math.degrees(math.atan2(x, y)) + late[states >> (14 - 2 * at) & 3, ring]
                assert math.hypot(x, y, z) == pytest.approx(5.0 + 0.01 * (azimuth % 360.0), abs=2.3e-3)
                assert math.degrees(math.asin(z / math.hypot(x, y, z))) == pytest.approx(
                    MODELS[name].elevation_deg[ring], abs=1e-3
                )


@pytest.mark.parametrize("device", [{}, {"returns": "dual"}, {"high_resolution": True}, {"signature": True}])
def test_hydra4_gives_points_of_an_ot128_the_instants_at_which_they_were_measured(
    device: dict[str, object], tmp_path: Path
) -> None:
    from hydra4 import decoders

    rig = Rig("hesai-ot128", {"clock_source": "ptp"} | device)
    rig.session.source.powered_on(-4 * SECOND)  # it has followed its source long enough
    rig.world = slope(0.0)
    file = tmp_path / "calibration.csv"
    file.write_bytes(rig.ok(0x05))
    read = decoders.PandarOT128(file, 0.1, 200.0)
    sent = clouds(rig.run(0.05))
    plans = rig.plans
    fired = np.concatenate([1e-9 * one.start_ns + one.fire_offset_s for one in plans])
    elevation = np.degrees(np.concatenate([one.elevation_rad for one in plans]))
    begins = (
        moment(rig.session.build.utc_ns).replace(tzinfo=None).timestamp()
    )  # a time of day without a zone, as its own
    for one in sent[30:-30:20]:
        for block in read(SimpleNamespace(data=one.payload)):
            for *_, ring, _, at_s in block.points[::9]:
                own = np.sort(fired[np.abs(elevation - MODELS["hesai-ot128"].elevation_deg[ring]) < 1e-6])
                assert np.abs(own - (at_s - begins)).min() < 1.6e-6, "stamps are whole microseconds"
