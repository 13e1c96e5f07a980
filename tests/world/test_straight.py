"""A fed motion that is straight is met as a straight line, and is where its track says."""

from __future__ import annotations

import numpy as np
import pytest

from emulator.live.book import Book, Rules
from emulator.live.json_lines import update_of
from emulator.world.batched_poses import BatchedPoses
from emulator.world.fed import Fed, FedNow
from emulator.world.motion import Steady

MOVES: dict[str, tuple[bool, list[dict[str, object]]]] = {
    "rests": (True, [{"at_m": [3, 4, 1], "yaw_deg": 40} for _ in range(6)]),
    "rests, stated": (True, [{"at_m": [3, 4, 1], "velocity_m_s": [0, 0, 0]} for _ in range(6)]),
    "even": (True, [{"at_m": [9 * k / 100, 0, 0], "velocity_m_s": [9, 0, 0], "yaw_deg": 30} for k in range(6)]),
    "even, not stated": (True, [{"at_m": [9 * k / 100, -k / 100, 0]} for k in range(6)]),
    "one sample": (True, [{"at_m": [1, 2, 3], "velocity_m_s": [9, 0, 1]}]),
    "brakes": (False, [{"at_m": [0.09 * k - 0.002 * k * k, 0, 0]} for k in range(6)]),
    "speeds that are not its way": (False, [{"at_m": [0.09 * k, 0, 0], "velocity_m_s": [8, 0, 0]} for k in range(6)]),
    "turns": (False, [{"at_m": [0.09 * k, 0, 0], "yaw_deg": 0.1 * k} for k in range(6)]),
    "turns, stated": (False, [{"at_m": [0.09 * k, 0, 0], "turn_rate_deg_s": 1} for k in range(6)]),
    "jumps": (False, [{"at_m": [0.09 * k, 0, 0], "jump": k == 3} for k in range(6)]),
}


def fed(rows: list[dict[str, object]], begin_s: float, end_s: float, **rules: object) -> Fed:
    book = Book(Rules(**rules), names=["car"])  # type: ignore[arg-type]
    for k, row in enumerate(rows):
        book.take(update_of({"actors": [{"id": "car", "reference": "origin", **row}]}), 10_000_000 * k)
    now = FedNow()
    now.use(book.world(begin_s, end_s))
    return Fed(now, "car", Steady((7.0, 0.0, 0.0), velocity_m_s=(1.0, 0.0, 0.0)), None)


@pytest.mark.parametrize("name", MOVES)
@pytest.mark.parametrize(("begin_s", "end_s"), [(0.012, 0.038), (0.03, 0.07), (-0.01, 0.02), (0.2, 0.9)])
def test_a_straight_motion_is_where_its_track_is(name: str, begin_s: float, end_s: float) -> None:
    """Between samples, beyond the newest, past the time of which it is held, and before the first."""
    is_straight, rows = MOVES[name]
    motion = fed(rows, begin_s, end_s)
    times = np.linspace(begin_s, end_s, 23)
    one = motion.straight
    assert (one is not None) is is_straight or begin_s == 0.2, "then two samples are all it has"
    place, turned = motion.found(times)
    holds = np.array([one is not None and one.holds(float(t), float(t)) for t in times])
    if one is not None:
        assert one.position(times)[holds] == pytest.approx(place[holds], abs=3e-9)
        assert turned[holds] == pytest.approx(np.broadcast_to(one.rotation, turned[holds].shape), abs=1e-15)
        until = 0.01 * (len(rows) - 1)
        assert holds[(times >= 0.0) & (times < until)].all()
    pose = motion.pose(times)
    assert pose.position_m == pytest.approx(place, abs=3e-9)
    assert pose.rotation == pytest.approx(turned, abs=1e-15)


def test_what_a_sweep_shows_of_fed_motions_is_of_that_sweep_alone() -> None:
    """A choice of what may come near is kept over many sweeps: it knows nothing of where one has them."""
    motion = fed(MOVES["even"][1], 0.012, 0.038)
    many = BatchedPoses([Steady((1.0, 0.0, 0.0)), motion])
    assert many.during(0.012, 0.038).straight.tolist() == [True, True]
    assert many.during(0.012, 0.038).at[:, 1].tolist() == pytest.approx([0.0, 0.0, 0.0], abs=0.02)
    assert many.during(0.012, 5.0).straight.tolist() == [True, False]
    assert many.lasting(0.012, 0.038).straight.tolist() == [True, False]
    other = fed([{"at_m": [70.0, 0, 0]} for _ in range(6)], 0.012, 0.038)
    motion.now.use(other.now.world)
    assert many.during(0.012, 0.038).at[:, 1].tolist() == [70.0, 0.0, 0.0]


def test_an_actor_of_which_nothing_has_come_moves_as_the_file_says() -> None:
    motion = fed([], 0.0, 0.1)
    one = motion.straight
    assert one is not None
    assert one.position(np.array([2.0]))[0].tolist() == [9.0, 0.0, 0.0]


@pytest.mark.parametrize("stated", [True, False])
@pytest.mark.parametrize("off_m", [1e-6, 3e-5, 1e-3])
def test_what_is_nearly_straight_is_where_its_track_is_to_a_tenth_of_a_millimetre(stated: bool, off_m: float) -> None:
    """Positions that were rounded, or stamped by a clock that is followed; beyond the last sample nothing is off."""
    found = []
    for seed in range(60):
        rng = np.random.default_rng(seed)
        speed = rng.uniform(-15.0, 15.0, 2)
        rows = [
            {"at_m": [*(0.01 * k * speed + rng.uniform(-off_m, off_m, 2)).tolist(), 0.0]}
            | ({"velocity_m_s": [*speed.tolist(), 0.0]} if stated else {})
            for k in range(6)
        ]
        motion = fed(rows, 0.012, 0.038)
        times = np.linspace(0.012, 0.0399, 40)
        one, place = motion.straight, motion.found(times)[0]
        found.append(one is not None)
        if one is not None:
            assert one.position(times) == pytest.approx(place, abs=1.3e-4)
            assert motion.pose(times).position_m == pytest.approx(one.position(times), abs=1e-12)
            if stated:
                late = motion.found(np.array([0.3]))[0]
                assert one.position(np.array([0.3])) == pytest.approx(late, abs=1e-9)
    assert all(found) if off_m < 1e-4 else not any(found)
