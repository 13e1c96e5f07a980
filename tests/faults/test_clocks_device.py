"""Devices' own time: what is told on the wire at wraps, after drift, steps and restarts, and the truth beside it."""

from __future__ import annotations

import itertools
import json
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from emulator.errors import ScenarioError
from emulator.judging.trial import Trial, run_trial
from emulator.objects.sweeps import sweeps_of
from emulator.recording.reader import read_run
from emulator.runtime import assembly
from emulator.scenario import scenario
from emulator.sensors.spec import load_spec
from protocols import family
from protocols.can_objects.layout import load as load_layout
from protocols.device_clock import Change, DeviceClock
from protocols.lms2xx.telegrams import open_frame, read_values, request
from protocols.quartz import Quartz
from protocols.session import LinkKind
from tests.draws import cases
from tests.faults.devices import SECOND, Device, device
from tests.protocols.ld.reader import read_frames, read_profile
from tests.protocols.ld.reader import request as ld_request

MS = 1_000_000
LD = {"delays": "fast", "mode": "measure", "motor_hz": 10, "sectors": [{"from_deg": 0, "to_deg": 90}], "step_deg": 5}
"Profiles of nineteen points, ten a second, from 20 ms on."
MS_TICK = Fraction(MS)


# ------------------------------------------------------------------------------- the value


def test_a_clock_shows_what_happened_to_it_until_then_and_no_more() -> None:
    clock = DeviceClock(5 * SECOND).powered_on(SECOND)
    assert clock.shown_ns(3 * SECOND) == 7 * SECOND
    clock = clock.stepped(4 * SECOND, -SECOND // 2).stopped(6 * SECOND).going(8 * SECOND)
    assert [clock.shown_ns(t * SECOND) / SECOND for t in (3, 4, 5, 6, 7, 8, 9)] == [7, 7.5, 8.5, 9.5, 9.5, 9.5, 10.5]
    later = clock.set_to(10 * SECOND, 0)
    assert (later.shown_ns(9 * SECOND), later.shown_ns(11 * SECOND)) == (clock.shown_ns(9 * SECOND), SECOND)


def test_drift_over_a_day_is_exact_to_the_nanosecond() -> None:
    clock = DeviceClock().powered_on(0).at_rate(0, 50_000)
    assert clock.shown_ns(86_400 * SECOND) == 86_400 * SECOND + 86_400 * 50_000
    assert clock.shown_ns(1) == 1


@pytest.mark.parametrize("bits", [7, 8, 16, 32, 64])
def test_ticks_wrap_at_the_wires_width(bits: int) -> None:
    clock = DeviceClock(((1 << bits) - 1) * MS).powered_on(0)
    assert [clock.ticks(t * MS, MS_TICK, bits) for t in (0, 1, 2)] == [(1 << bits) - 1, 0, 1]


def test_a_clock_that_is_set_for_ever_keeps_its_time_and_little_memory() -> None:
    clock = DeviceClock().powered_on(0)
    for second in range(5000):
        clock = clock.stepped(second * SECOND, 1)
    assert clock.shown_ns(5000 * SECOND) == 5000 * SECOND + 5000
    assert len(clock.changes) <= 512


changes = st.lists(
    st.tuples(
        st.integers(0, 100 * SECOND),
        st.sampled_from(["step", "set", "rate", "stop", "go"]),
        st.integers(-(10**8), 10**8),
    ),
    max_size=12,
)


@settings(max_examples=cases(60), deadline=None)
@given(changes, st.integers(0, 100 * SECOND))
def test_the_order_in_which_changes_become_known_does_not_matter(rows: list[tuple[int, Any, int]], at: int) -> None:
    rows = list({row[0]: row for row in rows}.values())
    first = second = DeviceClock(7)
    for row in rows:
        first = first.changed(Change(*row))
    for row in sorted(rows):
        second = second.changed(Change(*row))
    assert first.shown_ns(at) == second.shown_ns(at)


@settings(max_examples=cases(100), deadline=None)
@given(
    st.lists(st.tuples(st.integers(1, 50 * SECOND), st.integers(-(10**8), 10**8)), max_size=6),
    st.integers(0, 400 * SECOND),
)
@example(rows=[(1, -1), (1, 0)], own=1)
def test_the_runs_instant_is_the_first_at_which_the_devices_has_come(rows: list[tuple[int, int]], own: int) -> None:
    quartz, at = Quartz(), 0
    for pause, ppb in rows:
        at += pause
        quartz = quartz.at_rate(at, ppb)
    true = quartz.true_ns(own)
    assert quartz.own_ns(true) >= own
    assert true == 0 or quartz.own_ns(true - 1) < own


# ------------------------------------------------------------------------------- LD


def profiles(sent: list[Any]) -> list[Any]:
    found = [one for one in sent if one.sweep is not None]
    return [read_profile(payload) for one in found for payload in read_frames(one.payload)]


def test_the_ld_stamps_wrap_on_the_wire_and_the_truth_goes_on() -> None:
    made = device("ld", LD, start_ticks=2**32 - 250)
    found = profiles(made.run(1.0))
    starts = [one.sectors[0].start_ms for one in found]
    assert any(later < earlier for earlier, later in itertools.pairwise(starts))
    assert {(later - earlier) & 0xFFFF for earlier, later in itertools.pairwise(starts)} == {100}
    reported = [one.reported for one in made.sent if one.sweep is not None and one.reported is not None]
    assert [one.ticks for one in reported] == starts
    assert {one.device_ns - one.true_ns for one in reported} == {(2**32 - 250) * MS}


def clock_of(made: Device) -> int:
    """As a host asks for it (GET_SYNC_CLOCK)."""
    made.put(ld_request(0x0205))
    answers = [one for one in made.run(made.now_ns / SECOND + 0.1) if one.sweep is None and one.payload]
    (payload,) = read_frames(answers[-1].payload)
    assert payload[:2] == b"\x82\x05"
    return int.from_bytes(payload[2:], "big")


def test_an_hours_drift_of_the_stamps_alone_leaves_the_schedule() -> None:
    made = device("ld", LD | {"mode": "idle"}, drift_ppm=50.0, drives="stamps")
    made.run(3600.0)
    assert clock_of(made) == 3_600_180 & 0xFFFF
    paced = device("ld", LD, drift_ppm=50.0, drives="stamps")
    paced.run(1.0)
    assert {b.start_ns - a.start_ns for a, b in itertools.pairwise(paced.plans)} == {100 * MS}


def test_a_quartz_paces_the_head_and_what_it_tells() -> None:
    made, exact = device("ld", LD, drift_ppm=1000.0), device("ld", LD)
    made.run(10.0)
    exact.run(10.0)
    spans = [later.start_ns - earlier.start_ns for earlier, later in itertools.pairwise(made.plans)]
    assert np.mean(spans) == pytest.approx(1e8 / 1.001, abs=20)
    assert made.plans[5].fire_offset_s == pytest.approx(exact.plans[5].fire_offset_s / 1.001, rel=1e-12)
    # by its own clock it is right: a host sees a head that turns in exactly 100 ms
    starts = [one.sectors[0].start_ms for one in profiles(made.sent)]
    assert {(later - earlier) & 0xFFFF for earlier, later in itertools.pairwise(starts)} == {100}
    reported = [one.reported for one in made.sent if one.reported is not None][-1]
    assert (reported.device_ns - reported.true_ns) * 1e-9 == pytest.approx(reported.true_ns * 1e-9 * 1e-3, abs=1e-8)


def test_an_hour_on_a_drifting_quartz_is_exact() -> None:
    made = device("ld", LD | {"mode": "idle"}, drift_ppm=50.0)
    made.run(3600.0)
    made.put(ld_request(0x0205))
    (answer,) = [one for one in made.run(3600.1) if one.payload]
    own_ns = 3600 * SECOND + 3600 * 50_000  # and the answer 1 ms of its own time later
    assert answer.due_ns == -(-(own_ns + MS) * 10**9 // (10**9 + 50_000))


def test_steps_of_the_file_and_of_the_host_add_up() -> None:
    made = device("ld", LD | {"mode": "idle"}, offset_s=2.0, steps=({"t_s": 5.0, "by_s": -0.5},))
    made.run(4.0)
    assert clock_of(made) == 6000
    made.run(6.0)
    assert clock_of(made) == 7500
    made.put(ld_request(0x0203, 1000))  # SET_TIME_ABSOLUTE
    made.run(7.0)
    assert clock_of(made) == 1900  # it was set at 6.1 s


@pytest.mark.parametrize(("power_cycle", "shown"), [("begins_again", 5000), ("runs_on", 8000)])
def test_after_power_loss_it_begins_again_or_has_run_on(power_cycle: str, shown: int) -> None:
    made = device("ld", LD | {"mode": "idle"}, offset_s=4.0, power_cycle=power_cycle)
    made.run(3.0)
    made.session.power_on(3 * SECOND)
    made.run(4.0)
    assert clock_of(made) == shown


def test_counters_begin_where_they_are_told_and_wrap() -> None:
    made = device("ld", LD, start_count=65_534)
    counts = [one.counter for one in profiles(made.run(1.0))]
    first = made.plans[0].sweep
    assert counts[:4] == [(65_534 + first + k) & 0xFFFF for k in range(4)]
    assert 0 in counts


# ------------------------------------------------------------------------------- LMS2xx


def indices(made: Device, until_s: float) -> list[tuple[int, int]]:
    found = [open_frame(one.payload) for one in made.run(until_s) if one.sweep is not None]
    return [read_values(one).indices for one in found if one is not None]  # type: ignore[union-attr, misc]


def lms(**clock: Any) -> Device:
    made = device("lms2xx", {"real_time_indices": True, "baud": 500_000}, **clock)
    made.put(request(b"\x20\x24"))
    return made


def test_the_lms_indices_begin_where_they_are_told_and_wrap() -> None:
    plain, moved = indices(lms(), 1.0), indices(lms(start_ticks=200, start_count=250), 1.0)
    assert [((scan + 200) & 255, (count + 250) & 255) for scan, count in plain] == moved
    assert any(later < earlier for (earlier, _), (later, _) in itertools.pairwise(moved))


def test_the_lms_scans_at_the_pace_of_its_quartz() -> None:
    fast = lms(drift_ppm=10_000.0)
    times = [one.due_ns for one in fast.run(20.0) if one.sweep is not None]
    assert (len(times) - 1) / (times[-1] - times[0]) * SECOND == pytest.approx(37.5 * 1.01, rel=1e-6)
    # the index counts turns: steps of two, as ever
    assert {(b - a) & 255 for (a, _), (b, _) in itertools.pairwise(indices(lms(drift_ppm=10_000.0), 1.0))} == {2}


# ------------------------------------------------------------------------------- object lists


def decoded(made: Device, until_s: float, layout: str, name: str) -> list[dict[str, float]]:
    table = load_layout(layout)
    return [table.decode(name, one.payload) for one in made.run(until_s) if one.label == name]


def ntp(rows: list[dict[str, float]]) -> list[float]:
    return [row["NtpSeconds"] + row["NtpFraction"] / 2**32 for row in rows]


def test_the_ldmrs_tells_its_own_time_over_the_end_of_the_ntp_era() -> None:
    made = device("can_objects", {"format": "ldmrs"}, start_ticks=(2**32 - 1) << 32)
    stamps = ntp(decoded(made, 1.6, "ldmrs.dbc", "ListTime"))
    assert stamps[0] == pytest.approx(2**32 - 0.5)  # booted 0.5 s after power-on
    assert stamps[7] == pytest.approx(0.06, abs=1e-6)  # 80 ms a list
    assert all((b - a) % 2**32 == pytest.approx(0.08, abs=1e-6) for a, b in itertools.pairwise(stamps))


def test_a_hosts_ntp_time_survives_until_power_is_lost() -> None:
    made = device("can_objects", {"format": "ldmrs"}, drift_ppm=100.0, drives="stamps")
    made.run(1.0)
    for text in ("30 00 00 00 78 56 34 12", "31 00 00 00 00 00 00 80"):
        made.put(bytes.fromhex(text), 0x50A)
    after = decoded(made, 11.0, "ldmrs.dbc", "ListTime")
    instants = [one.reported.true_ns for one in made.sent if one.reported is not None][-len(after) :]
    reported = dict(zip(instants, ntp(after), strict=True))
    late = [t for t in instants if t > SECOND]
    assert reported[late[-1]] == pytest.approx(0x12345678 + 0.5 + (late[-1] / SECOND - 1.0) * 1.0001, abs=1e-6)
    made.session.power_on(11 * SECOND)
    assert ntp(decoded(made, 11.6, "ldmrs.dbc", "ListTime"))[0] == pytest.approx(0.5, abs=1e-3)


def test_the_esr_wraps_its_stamp_every_quarter_of_a_second_and_its_index() -> None:
    made = device("can_objects", {"format": "esr"}, start_count=65_530, start_ticks=100)
    rows = decoded(made, 1.5, "esr.dbc", "Status1")
    assert [row["ScanIndex"] for row in rows[:8]] == [65_530, 65_531, 65_532, 65_533, 65_534, 65_535, 0, 1]
    times = [one.reported for one in made.sent if one.reported is not None]
    assert [row["DspTimestamp"] for row in rows] == [one.ticks * 2 for one in times]
    assert {(b - a) % 256 for a, b in itertools.pairwise(row["DspTimestamp"] for row in rows)} == {50.0}


def test_the_ars408_counts_over_its_wrap_and_the_vu8_over_its_own() -> None:
    counts = decoded(
        device("can_objects", {"format": "ars408"}, start_count=65_532), 1.0, "ars408.dbc", "ObjListHeader"
    )
    assert [row["MeasCounter"] for row in counts[:4]] == [65_532, 65_534, 0, 2]
    vu8 = device("can_objects", {"format": "leddar_vu8", "streaming": "start"}, start_ticks=2**32 - 550)
    stamps = [row["Timestamp"] for row in decoded(vu8, 0.7, "leddar_vu8.dbc", "DetectionCount")]
    assert stamps[:3] == [2**32 - 50, 2**32 - 10, 30]


# ------------------------------------------------------------------------------- scenarios, recordings, expectations

CASE = """\
schema: 1
seed: 3
duration_s: 2.0
world:
  - {plane: {size_m: [6, 60]}, at_m: [8, 0, 1], pitch_deg: -90, material: white_plaster}
sensors:
  - id: top
    model: sick-ld-lrs1000
    mount: {at_m: [0, 0, 1]}
    device: {delays: fast, step_deg: 5.0}
    clock: CLOCK
"""


def case(clock: str) -> scenario.Scenario:
    return scenario.loads(CASE.replace("CLOCK", clock), Path("case.yaml"))


@pytest.mark.parametrize(
    ("clock", "reported"),
    [
        ("{drift: 5}", "case.yaml:11: sensors.top.clock.drift: unknown key; did you mean drift_ppm?"),
        ("{drift_ppm: 200000}", "sensors.top.clock.drift_ppm: 200000"),
        ("{start_ticks: 4294967296}", "sensors.top.clock.start_ticks: 4294967296; want 0..4294967295, 32 bits"),
        ("{start_count: 65536}", "sensors.top.clock.start_count: 65536"),
    ],
)
def test_a_clock_that_cannot_be_is_told_with_its_line(clock: str, reported: str) -> None:
    with pytest.raises(ScenarioError) as error:
        Trial(case(clock))
    assert reported in str(error.value)


def test_a_device_without_time_refuses_a_time() -> None:
    text = CASE.replace("CLOCK", "{}") + ("  - {id: radar, model: can-ars408, from: [top], clock: {offset_s: 3.0}}\n")
    with pytest.raises(ScenarioError, match=r"sensors\.radar\.clock\.offset_s: 3\.0; want no such key"):
        Trial(scenario.loads(text, Path("case.yaml")))


def test_the_recording_has_the_truth_beside_what_was_told(tmp_path: Path) -> None:
    trial = Trial(case("{drift_ppm: 500, offset_s: 3.2, steps: [{t_s: 1.0, by_s: -0.5}]}"), record=tmp_path / "run")
    trial.finish()
    trial.close()
    rows = read_run(tmp_path / "run").clocks["top"]
    assert len({sweep for sweep, _ in rows}) == len(rows) > 10
    for _, reported in rows:
        seconds = reported.true_ns * 1e-9
        expected = 3.2 + seconds * 500e-6 - (0.5 if seconds > 1.0 else 0.0)
        assert (reported.device_ns - reported.true_ns) * 1e-9 == pytest.approx(expected, abs=2e-9)
        assert reported.ticks == reported.device_ns // MS & 0xFFFF
    schemas = (tmp_path / "run" / "run.mcap").read_bytes()
    assert b"lidaremu.Clock" in schemas


def test_expectations_see_the_error_of_the_clock() -> None:
    text = CASE.replace("CLOCK", "{offset_s: 0.25}") + (
        "expect:\n  - {that: top.clock_error_s, within: [0.2499, 0.2501]}\n"
        "  - {that: mean(top.clock_ticks), within: [250, 2250]}\n"
    )
    verdict = run_trial(scenario.loads(text, Path("case.yaml")))
    assert verdict.held, [(one.name, one.found) for one in verdict.judgements]


def test_a_clock_table_survives_the_dump() -> None:
    first = case("{drift_ppm: 5, steps: [{t_s: 1, by_s: 0.5}]}")
    again = scenario.loads(scenario.dump(first), Path("again.yaml"))
    assert again.sensors[0].clock == first.sensors[0].clock
    assert json.loads(json.dumps(scenario.json_schema()))["$defs"]["ClockOptions"]


def test_a_source_on_a_quartz_of_its_own_is_looked_at_when_it_scans() -> None:
    text = CASE.replace("CLOCK", "{drift_ppm: 1000}") + "  - {id: radar, model: can-ars408, from: [top]}\n"
    trial = Trial(scenario.loads(text, Path("case.yaml")))
    trial.finish()
    sweeps = assembly.new_session(trial.scenario, 0)
    source = sweeps_of(load_spec("sick-ld-lrs1000"), sweeps)
    hour_ns = 3600 * SECOND
    found = [source.newest(hour_ns + k * 7 * MS) for k in range(40)]
    starts = sorted({one.start_ns for one in found if one is not None})
    assert len(starts) >= 3
    # revolutions of 100 ms by its own time, each to the nanosecond even after an hour
    own = [Quartz().at_rate(0, 1_000_000).own_ns(start) for start in starts]
    assert all(abs((b - a) - 100 * MS) <= 1 for a, b in itertools.pairwise(own))
    assert trial.series.sensors["radar"].measured
    trial.close()


def test_frames_of_a_device_on_a_quartz_of_its_own_can_be_changed() -> None:
    made = device("can_objects", {"format": "ldmrs"}, drift_ppm=100.0)
    framing = family("can_objects").framing(made.session, LinkKind.CAN)  # type: ignore[attr-defined]
    assert framing is not None


def test_an_ld_with_a_stuck_mirror_cannot_measure_after_a_restart_either() -> None:
    made = device("ld", LD)
    made.run(0.5)
    made.session.impair(SECOND // 2, "motor stopped", 1.0)
    made.session.power_on(SECOND)
    assert not profiles(made.run(3.0))
    made.session.impair(3 * SECOND, "motor stopped", 0.0)
    made.session.power_on(3 * SECOND)
    assert profiles(made.run(5.0))
