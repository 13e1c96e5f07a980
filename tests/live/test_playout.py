"""The feeder's clock: envelope, drift, play-out delay, steps, restarts."""

from __future__ import annotations

import numpy as np
import pytest

from emulator.live.playout import PlayoutClock

MS, S = 1_000_000, 1_000_000_000


@pytest.mark.parametrize("ppm", [200, -200, 0, 450])
@pytest.mark.parametrize("seed", range(3))
def test_drift_and_5_ms_of_jitter_are_taken_out(ppm: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    clock = PlayoutClock(delay_ns=0)
    before = None
    for k in range(6000):
        true_ns = 10 * k * MS
        stamp = round(true_ns * (1 + ppm * 1e-6)) + 77 * S
        arrival = true_ns + round(rng.exponential(5 * MS))
        arrival = arrival if before is None else max(arrival, before[0])  # one socket keeps their order
        found = clock.map(stamp, arrival)
        assert found.event == ""
        offset = clock.offset_ns
        if before is not None and k > 20:
            assert abs(offset - before[1]) <= 1e-3 * (arrival - before[0]) + 1e-3
        before = arrival, offset
        if true_ns > 10 * S:
            assert abs(found.run_ns - true_ns) < 0.3 * MS
    assert clock.drift_ppm == pytest.approx(-ppm, abs=20)


def test_the_delay_is_what_nearly_all_samples_need() -> None:
    rng = np.random.default_rng(4)
    clock = PlayoutClock()
    late = 0
    for k in range(4000):
        arrival = 10 * k * MS + round(rng.uniform(0, 4 * MS))
        found = clock.map(10 * k * MS, arrival)
        late += k > 1000 and found.run_ns < arrival
    assert clock.delay_ns == pytest.approx(14 * MS, rel=0.05)
    assert late == 0


def test_a_perfect_feed_has_no_offset_left() -> None:
    clock = PlayoutClock(delay_ns=0)
    for k in range(100):
        assert clock.map(5 * S + 10 * k * MS, 10 * k * MS).run_ns == pytest.approx(10 * k * MS, abs=1)


def test_the_feeders_latency_is_added() -> None:
    clock = PlayoutClock(delay_ns=0, latency_ns=30 * MS)
    assert clock.map(0, 0).run_ns == 30 * MS


def test_a_restart_at_zero_is_seen_at_once() -> None:
    clock = PlayoutClock(delay_ns=0)
    for k in range(100):
        clock.map(100 * S + 10 * k * MS, 10 * k * MS)
    found = clock.map(0, 1000 * MS)
    assert (found.event, found.run_ns) == ("restart", 1000 * MS)
    assert clock.map(10 * MS, 1010 * MS).event == ""


@pytest.mark.parametrize("step_s", [0.5, -0.5, 3600.0])
def test_a_step_of_the_clock_is_believed_after_half_a_second(step_s: float) -> None:
    clock = PlayoutClock(delay_ns=0)
    for k in range(200):
        clock.map(10 * k * MS, 10 * k * MS)
    events = []
    for k in range(200, 400):
        found = clock.map(10 * k * MS + round(step_s * S), 10 * k * MS)
        events += [(k, found.event)] if found.event else []
    assert [event for _, event in events] == ["step"]
    assert events[0][0] <= 252
    assert found.run_ns == pytest.approx(10 * 399 * MS, abs=1)


def test_a_feed_faster_than_real_time_is_played_by_its_stamps() -> None:
    clock = PlayoutClock(delay_ns=0)
    for k in range(2000):  # twenty times as fast
        found = clock.map(20 * k * MS, k * MS)
        assert found.event == ""
    assert found.run_ns == pytest.approx(20 * 1999 * MS, abs=400 * MS), "the first samples settle the offset"


def test_one_late_sample_moves_nothing() -> None:
    clock = PlayoutClock(delay_ns=0)
    for k in range(500):
        late = 200 * MS if k == 300 else 0
        found = clock.map(10 * k * MS, 10 * k * MS + late)
        assert found.run_ns == pytest.approx(10 * k * MS, abs=1)
