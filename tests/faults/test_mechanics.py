"""Faults of motor, mirror, encoder and mount as hosts read them, by closed forms of where the beams go."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest

from protocols.lms2xx.telegrams import open_frame, read_values
from tests.faults.runs import BEGIN_S, END_S, GROUND, Run, at, heals, ranges, run
from tests.protocols.ld.reader import read_frames, read_profile

DOWN_DEG = 10.0
"The sensor looks down on flat ground from one metre."


def on_ground(pitch_deg: float) -> float:
    """Range straight ahead."""
    return 1.0 / math.sin(math.radians(DOWN_DEG + pitch_deg))


@pytest.fixture(scope="module")
def ground() -> Run:
    return run(world=GROUND, pitch_deg=DOWN_DEG)


def test_the_ground_is_where_it_should_be(ground: Run) -> None:
    post = ranges(ground.part(BEGIN_S, END_S), 0.0)
    assert post == pytest.approx(2.9 / math.cos(math.radians(DOWN_DEG)), abs=0.02)  # the post in front
    beside = ranges(ground.part(BEGIN_S, END_S), 8.0)
    assert beside == pytest.approx(on_ground(0.0) / math.cos(math.radians(8.0)), abs=0.02)


def test_a_nodding_mirror_reads_the_ground_near_and_far(ground: Run) -> None:
    faulty = run("do: mirror_wobble, elevation_deg: 2.0, hz: 7.0", world=GROUND, pitch_deg=DOWN_DEG)
    seen = ranges(faulty.part(BEGIN_S, END_S), 8.0) * math.cos(math.radians(8.0))
    assert seen.min() == pytest.approx(on_ground(2.0), rel=0.02)
    assert seen.max() == pytest.approx(on_ground(-2.0), rel=0.02)
    beam = at(faulty.part(BEGIN_S, END_S)[0], 8.0)
    offset_s = (0.5 + 8.0 / 360.0 - 0.25) * 40e-3 / 3.0  # a beam at wire angle 98 deg is fired 98/360 of a turn later
    for sweep, (at_ns, scan) in faulty.scans.items():
        since_s = at_ns * 1e-9 - BEGIN_S
        if 0.0 <= since_s < END_S - BEGIN_S - 1e-6:
            elevation = 2.0 * math.sin(2.0 * math.pi * 7.0 * (since_s + offset_s))
            expected = on_ground(-elevation) / math.cos(math.radians(8.0))
            assert scan.range_m[beam] == pytest.approx(expected, rel=5e-3), sweep
    assert heals(faulty, ground)


def test_a_mirror_that_stands_gives_every_beam_one_range_and_the_lms_tells() -> None:
    faulty, healthy = run("do: mirror_stuck, at_deg: 20.0"), run()
    for a, b in faulty.pairs(healthy):
        assert np.ptp(a.range_m) < 0.002
        assert a.range_m[0] == pytest.approx(b.range_m[at(b, 20.0)], abs=0.005)
    assert heals(faulty, healthy)
    status = {one.start_ns: one.data[-3] for one in faulty.payloads if one.sweep is not None}
    assert {byte for at_ns, byte in status.items() if BEGIN_S + 0.03 < at_ns * 1e-9 < END_S} == {0x13}
    assert {byte for at_ns, byte in status.items() if END_S + 0.05 < at_ns * 1e-9} == {0x10}


def test_a_mirror_that_stands_anywhere_stands_where_the_seed_says() -> None:
    first, again = run("do: mirror_stuck"), run("do: mirror_stuck, told: true")
    assert first.sha256 == again.sha256
    held = first.part(BEGIN_S, END_S)
    assert all(np.ptp(scan.range_m) < 0.002 for scan in held)


def test_an_ld_whose_mirror_stands_is_in_error_and_sends_nothing() -> None:
    faulty = run("do: mirror_stuck", on="top")
    assert faulty.part(0.0, BEGIN_S)
    assert not [one for one in faulty.payloads if one.sweep is not None and one.start_ns * 1e-9 > BEGIN_S + 0.06]


@pytest.mark.parametrize("degrees", [2.0, -3.0])
def test_a_moved_encoder_turns_the_picture(degrees: float) -> None:
    faulty, healthy = run(f"do: encoder_offset, azimuth_deg: {degrees}"), run()
    steps = round(degrees)
    for a, b in faulty.pairs(healthy):
        mine, theirs = (a.range_m[:-steps], b.range_m[steps:]) if steps > 0 else (a.range_m[-steps:], b.range_m[:steps])
        assert np.allclose(mine, theirs, atol=0.0021)
    assert heals(faulty, healthy)


def test_a_slipping_encoder_turns_it_again_and_again() -> None:
    faulty, healthy = run("do: encoder_slip, jump_deg: 1.0, every_s: 0.05"), run()
    edge = [int(np.argmax(scan.range_m < 3.1)) for scan in faulty.part(BEGIN_S, END_S)]
    before = int(np.argmax(healthy.part(BEGIN_S, END_S)[0].range_m < 3.1))
    slips = np.array([before - one for one in edge])
    assert slips[-1] >= 2
    assert np.all(np.diff(slips) >= 0)
    assert heals(faulty, healthy)


def test_a_blow_tilts_the_plane_of_the_scan(ground: Run) -> None:
    faulty = run("do: mount_tilt, pitch_deg: 3.0", world=GROUND, pitch_deg=DOWN_DEG)
    # the beam at 8 deg: its direction, turned down by 3 deg about the sensor's own y axis
    azimuth, own = math.radians(8.0), math.radians(3.0)
    x, z = math.cos(azimuth) * math.cos(own), -math.cos(azimuth) * math.sin(own)
    down = math.radians(DOWN_DEG)
    sinks = x * math.sin(down) - z * math.cos(down)
    assert ranges(faulty.part(BEGIN_S, END_S), 8.0) == pytest.approx(1.0 / sinks, rel=5e-3)
    assert heals(faulty, ground)


def test_a_blow_swings_before_it_comes_to_rest(ground: Run) -> None:
    fault = "do: mount_tilt, pitch_deg: 2.0, settles_s: 0.05, swings_hz: 12"
    seen = ranges(run(fault, world=GROUND, pitch_deg=DOWN_DEG).part(BEGIN_S, END_S), 8.0)
    still = on_ground(2.0) / math.cos(math.radians(8.0))
    assert np.ptp(seen[:6]) > 0.2
    assert seen[-1] == pytest.approx(still, rel=0.01)


def test_a_moved_sensor_sees_the_wall_nearer() -> None:
    faulty, healthy = run("do: mount_shift, x_m: 0.5, y_m: 0.1"), run()
    for a, b in faulty.pairs(healthy):
        for degrees in (-30.0, 30.0):
            nearer = b.range_m[at(b, degrees)] - 0.5 / math.cos(math.radians(degrees))
            assert a.range_m[at(a, degrees)] == pytest.approx(nearer, abs=0.003)
    assert heals(faulty, healthy)


def test_a_shaking_mount_shakes_ranges_on_slanted_surfaces(ground: Run) -> None:
    faulty = run("do: vibration, pitch_deg: 0.5, hz: 31", world=GROUND, pitch_deg=DOWN_DEG)
    seen = ranges(faulty.part(BEGIN_S, END_S), 8.0) * math.cos(math.radians(8.0))
    assert on_ground(0.55) < seen.min() < on_ground(0.2)
    assert on_ground(-0.2) < seen.max() < on_ground(-0.55)
    assert heals(faulty, ground)


# ------------------------------------------------------------------------------- motor


@pytest.mark.parametrize("percent", [-4.0, 2.0, 10.0])
def test_the_lms_scans_at_the_speed_of_its_motor(percent: float) -> None:
    faulty = run(f"do: motor_speed, percent: {percent}")
    begins = sorted(at_ns for at_ns, _ in faulty.scans.values())
    spans = [(b - a, a * 1e-9) for a, b in itertools.pairwise(begins)]
    nominal = 4e7 / 3.0
    held = [span for span, at_s in spans if BEGIN_S + 0.03 < at_s < END_S - 0.04]
    # at 100 deg in steps of 1 deg a scan is one turn
    assert np.mean(held) == pytest.approx(nominal / (1.0 + 0.01 * percent), rel=1e-6)
    after = [span for span, at_s in spans if at_s > END_S + 0.04]
    assert np.mean(after) == pytest.approx(nominal, rel=1e-6)
    # the index counts turns, whatever time they take
    values = [
        read_values(found) for one in faulty.payloads if one.sweep is not None and (found := open_frame(one.data))
    ]
    indices = [one.indices[0] for one in values if one is not None and one.indices is not None]
    assert len(indices) > 40
    sweeps = [one.sweep for one in faulty.payloads if one.sweep is not None]
    assert [(b - a) & 255 for a, b in itertools.pairwise(indices)] == [
        (b - a) & 255 for a, b in itertools.pairwise(sweeps) if a is not None and b is not None
    ]
    reported = abs(percent) > 3.0
    status = {one.data[-3] for one in faulty.payloads if one.sweep is not None and 0.6 < one.start_ns * 1e-9 < 0.78}
    assert status == {0x13 if reported else 0x10}


def test_the_ld_tells_its_motor_in_every_profile_and_its_stamps_show_it() -> None:
    faulty = run("do: motor_speed, percent: -10.0", on="top")
    spans, states = {}, {}
    for one in faulty.payloads:
        if one.sweep is not None:
            profile = read_profile(read_frames(one.data)[0])
            begin_s = faulty.scans[one.sweep][0] * 1e-9
            sector = profile.sectors[0]
            assert sector.start_ms is not None
            assert sector.end_ms is not None
            spans[begin_s] = (sector.end_ms - sector.start_ms) & 0xFFFF
            states[one.start_ns * 1e-9] = profile.status
    arc = 179 / 180  # the last direction of a full turn in steps of 2 deg
    held = [span for at_s, span in spans.items() if BEGIN_S + 0.06 < at_s < END_S - 0.06]
    assert held
    assert all(abs(span - arc * 50.0 / 0.9) <= 1.0 for span in held)
    assert all(abs(span - arc * 50.0) <= 1.0 for at_s, span in spans.items() if at_s > END_S + 0.01)
    assert {state for at_s, state in states.items() if BEGIN_S + 0.01 < at_s < END_S} == {0x43}  # measuring, too slow
    assert {state for at_s, state in states.items() if at_s > END_S + 0.01} == {0x03}
    begins = sorted(at_ns for at_ns, _ in faulty.scans.values())
    sweeps = sorted(faulty.scans)
    assert sweeps == list(range(sweeps[0], sweeps[0] + len(sweeps)))  # no revolution is lost
    late = [b - a for a, b in itertools.pairwise(begins) if BEGIN_S + 0.06 < a * 1e-9 < END_S - 0.06]
    assert late == pytest.approx([50e6 / 0.9] * len(late), abs=2.0)
