"""Faults of the time that devices tell, as hosts read it in profiles, lists and indices."""

from __future__ import annotations

import itertools
from pathlib import Path

import numpy as np
import pytest

from emulator.errors import ScenarioError
from emulator.judging.trial import Trial
from emulator.scenario import scenario
from protocols.lms2xx.telegrams import open_frame, read_values
from tests.faults.runs import BEGIN_S, END_S, WALL, Run, heals, run, text_of
from tests.protocols.ld.reader import read_frames, read_profile


def stamps(one: Run) -> dict[float, int]:
    """Clock that each profile of an LD tells [ms], by the true beginning of its revolution [s]."""
    found = {}
    for payload in one.payloads:
        if payload.sweep is not None:
            profile = read_profile(read_frames(payload.data)[0])
            start_ms = profile.sectors[0].start_ms
            assert start_ms is not None
            found[one.scans[payload.sweep][0] * 1e-9] = start_ms
    return found


def errors_ms(one: Run, from_s: float, to_s: float) -> np.ndarray:
    """Told minus true, 16 bit as a host sees it."""
    rows = [(reported - round(at_s * 1e3)) for at_s, reported in stamps(one).items() if from_s <= at_s < to_s]
    return (np.array(rows) + 32768) % 65536 - 32768


@pytest.fixture(scope="module")
def top() -> Run:
    return run(on="top")


def test_a_clock_that_jumps_stays_where_it_jumped(top: Run) -> None:
    faulty = run("do: clock_step, by_s: -3.5", on="top")
    assert np.all(np.abs(errors_ms(faulty, 0.0, BEGIN_S)) <= 1)
    assert np.all(np.abs(errors_ms(faulty, BEGIN_S, 2.0) + 3500) <= 1)
    assert heals(faulty, top)  # ranges know nothing of it


def test_a_clock_that_jumps_may_return(top: Run) -> None:
    faulty = run("do: clock_step, by_s: 10.0, returns: true", on="top")
    assert np.all(np.abs(errors_ms(faulty, BEGIN_S, END_S) - 10_000) <= 1)
    after = {at_s: reported for at_s, reported in stamps(faulty).items() if at_s >= END_S}
    assert after
    assert after == {at_s: reported for at_s, reported in stamps(top).items() if at_s >= END_S}


def test_a_clock_that_stands_tells_one_time_and_goes_on_from_there(top: Run) -> None:
    faulty = run("do: clock_stop", on="top")
    held = [reported for at_s, reported in stamps(faulty).items() if BEGIN_S <= at_s < END_S]
    assert set(held) == {round(BEGIN_S * 1e3)}
    assert len(held) > 4
    assert np.all(np.abs(errors_ms(faulty, END_S, 2.0) + round((END_S - BEGIN_S) * 1e3)) <= 1)
    assert heals(faulty, top)


@pytest.mark.parametrize(("to_s", "shown_ms"), [("", 0), (", to_s: 65.5", 65_500)])
def test_a_clock_may_begin_again_while_the_device_goes_on(to_s: str, shown_ms: int, top: Run) -> None:
    faulty = run(f"do: clock_reset{to_s}", on="top")
    assert np.all(np.abs((errors_ms(faulty, BEGIN_S, 2.0) + 500 - shown_ms + 32768) % 65536 - 32768) <= 1)
    assert heals(faulty, top)


def test_a_drift_of_the_stamps_is_gained_while_it_lasts_and_kept(top: Run) -> None:
    faulty = run("do: clock_drift, ppm: 100000, drives: stamps", on="top")
    for at_s, reported in stamps(faulty).items():
        gained = 0.1 * min(max(at_s - BEGIN_S, 0.0), END_S - BEGIN_S)
        assert reported == pytest.approx((at_s + gained) * 1e3, abs=1.0)
    assert [at_ns for at_ns, _ in faulty.scans.values()] == [at_ns for at_ns, _ in top.scans.values()]
    assert heals(faulty, top)


def test_a_quartz_that_drifts_takes_the_schedule_with_it() -> None:
    faulty = run("do: clock_drift, ppm: 50000", on="top")
    ends = sorted(payload.start_ns for payload in faulty.payloads if payload.sweep is not None)
    spans = [(b - a, a * 1e-9) for a, b in itertools.pairwise(ends)]
    held = [span for span, at_s in spans if BEGIN_S < at_s < END_S - 0.06]
    assert held == pytest.approx([50e6 / 1.05] * 5, abs=2.0)
    assert [span for span, at_s in spans if at_s > END_S] == pytest.approx([50e6] * 5, abs=2.0)
    # by its own clock it is right: stamps step by the nominal 50 ms
    reported = list(stamps(faulty).values())
    assert {(b - a) & 0xFFFF for a, b in itertools.pairwise(reported)} <= {49, 50, 51}
    assert sum((b - a) & 0xFFFF for a, b in itertools.pairwise(reported)) == pytest.approx(
        50 * (len(reported) - 1), abs=2
    )


def test_the_index_of_an_lms_stands_and_jumps_with_its_clock() -> None:
    def indices(one: Run) -> dict[float, int]:
        found = {}
        for payload in one.payloads:
            telegram = open_frame(payload.data) if payload.sweep is not None else None
            values = None if telegram is None else read_values(telegram)
            if values is not None and values.indices is not None:
                found[payload.start_ns * 1e-9] = values.indices[0]
        return found

    healthy, stands = indices(run()), indices(run("do: clock_stop"))
    held = {index for at_s, index in stands.items() if BEGIN_S + 0.03 < at_s < END_S}
    assert len(held) == 1
    jumps = indices(run("do: clock_step, by_s: 0.4"))  # thirty turns
    late = [at_s for at_s in jumps if at_s > BEGIN_S + 0.03]
    assert all((jumps[at_s] - healthy[at_s]) & 255 == 30 for at_s in late)


def test_a_radar_without_stamps_has_no_clock_to_go_wrong() -> None:
    text = text_of("top", WALL, True, 0.0, "") + "  - {id: radar, model: can-ars408, from: [top]}\n"
    with pytest.raises(ScenarioError, match="can-ars408 reports no time; want a device that reports a time"):
        scenario.loads(text + "faults:\n  - {on: radar, do: clock_stop, at_s: 0.5}\n", Path("case.yaml"))


@pytest.mark.parametrize(
    "fault", ["clock_step", "clock_stop", "clock_reset", "clock_drift", "motor_speed", "range_offset", "dirty_window"]
)
def test_a_run_counts_what_its_faults_have_hit(fault: str) -> None:
    hits = run(f"do: {fault}", on="top").hits
    assert hits[0] >= 1


@pytest.mark.parametrize(("power_cycle", "lost_s"), [("begins_again", 0.6), ("runs_on", 0.0)])
def test_a_power_cut_takes_the_time_unless_a_battery_keeps_it(power_cycle: str, lost_s: float) -> None:
    text = text_of("top", WALL, True, 0.0, "").replace("duration_s: 1.1", "duration_s: 4.0")
    text = text.replace("id: top,", f"id: top, clock: {{offset_s: 3.0, power_cycle: {power_cycle}}},")
    text = text.replace("delays: fast,", "delays: fast, mode: measure,")
    text += "faults:\n  - {on: top, at_s: 0.4, do: power_cycle, off_s: 0.2}\nexpect:\n"
    text += "  - {that: top.clock_error_s, within: [2.999, 3.001], to_s: 0.4}\n"
    text += f"  - {{that: top.clock_error_s, within: [{2.999 - lost_s}, {3.001 - lost_s}], from_s: 0.7}}\n"
    trial = Trial(scenario.loads(text, Path("case.yaml")))
    verdict = trial.finish()
    trial.close()
    assert verdict.held, [(one.name, one.found) for one in verdict.judgements]
    assert len(trial.series.sensors["top"].reported) > 8
    assert max(one.true_ns for one in trial.series.sensors["top"].reported.values()) > 0.7e9
