"""Poses between and beyond samples: closed forms, limits, symmetries."""

from __future__ import annotations

import pickle

import numpy as np
import pytest

from emulator.live.book import Book, Rules
from emulator.live.rotations import Floats, from_angles, of_vector, product, slerp, to_vector, travelled, turned
from emulator.live.samples import ActorSample, Update
from emulator.live.tracks import COLUMNS, Track, World, columns_of, hermite, look_at


def fed(
    rows: list[tuple[float, tuple[float, float, float]]],
    velocity: tuple[float, float, float] | None = None,
    rules: Rules | None = None,
    yaw_rad: list[float] | None = None,
) -> Book:
    book = Book(rules, names=["car"])
    for number, (t_s, at_m) in enumerate(rows):
        turn = from_angles(0.0 if yaw_rad is None else yaw_rad[number])
        book.take(Update(None, (ActorSample("car", at_m, turn, velocity),)), round(t_s * 1e9))
    return book


def track(book: Book, begin_s: float = 0.0, end_s: float = 10.0) -> Track:
    ((name, found),) = book.world(begin_s, end_s).tracks
    assert name == "car"
    return found


def test_a_cubic_is_interpolated_exactly() -> None:
    def at(t: Floats) -> Floats:
        return np.stack([1 + 2 * t - 3 * t**2 + 0.7 * t**3, t**3, 5 - t], axis=-1)

    def velocity(t: Floats) -> Floats:
        return np.stack([2 - 6 * t + 2.1 * t**2, 3 * t**2, -np.ones_like(t)], axis=-1)

    t0, t1 = np.array([0.3]), np.array([0.8])
    for share in np.linspace(0, 1, 11):
        found = hermite(at(t0), at(t1), velocity(t0), velocity(t1), t1 - t0, np.array([share]))
        assert found == pytest.approx(at(t0 + share * (t1 - t0)), rel=1e-13, abs=1e-13)


def test_without_velocities_the_way_is_straight() -> None:
    found = track(fed([(0.0, (0, 0, 0)), (0.1, (1, 2, 0))])).pose(np.array([0.025]))[0]
    assert found == pytest.approx(np.array([[0.25, 0.5, 0.0]]))


def test_yaw_from_359_to_1_degree_turns_by_two() -> None:
    book = fed([(0.0, (0, 0, 0)), (0.1, (0, 0, 0))], yaw_rad=[np.radians(359), np.radians(1)])
    _, quaternion = track(book).pose(np.array([0.05]))
    assert turned(quaternion, np.array([[1.0, 0, 0]])) == pytest.approx(np.array([[1.0, 0, 0]]), abs=1e-12)


def test_slerp_turns_evenly_the_short_way_whatever_the_signs() -> None:
    rng = np.random.default_rng(1)
    for _ in range(100):
        one, two = (of_vector(rng.normal(size=(1, 3))) for _ in range(2))
        third = slerp(one, two, np.array([1 / 3]))
        steps = [product(b, a * [1, -1, -1, -1]) for a, b in ((one, third), (third, two), (one, two))]
        angles = [np.linalg.norm(to_vector(step)) for step in steps]
        assert angles[0] == pytest.approx(angles[2] / 3, abs=1e-12)
        assert angles[1] == pytest.approx(angles[2] * 2 / 3, abs=1e-12)
        assert np.abs(np.sum(third * slerp(one, -two, np.array([1 / 3])))) == pytest.approx(1.0)


def test_constant_twist_is_a_circle() -> None:
    spin, velocity = np.array([[0, 0, 0.7]]), np.array([[5.0, 0, 0]])
    for span in (1e-9, 1e-5, 0.1, 3.0, 20.0):
        angle, radius = 0.7 * span, 5.0 / 0.7
        want = [radius * np.sin(angle), radius * (1 - np.cos(angle)), 0.0]
        assert travelled(velocity, spin, np.array([span]))[0] == pytest.approx(want, rel=1e-8, abs=1e-12)


def test_extrapolation_goes_on_with_the_twist_and_then_holds() -> None:
    book = fed([(0.0, (0, 0, 0))], velocity=(10, 0, 0))
    found = track(book).pose(np.array([0.05, 0.5, 3.0]))[0]
    assert found[:, 0] == pytest.approx([0.5, 5.0, 5.0])


def test_without_velocity_the_last_two_samples_tell_it() -> None:
    book = fed([(0.0, (0, 0, 0)), (0.1, (1, 0, 0))], yaw_rad=[0.0, 0.02])
    at, quaternion = track(book).pose(np.array([0.2]))
    # it turns by 0.2 rad/s meanwhile: 10 m/s for 0.1 s on a circle
    assert at[0] == pytest.approx([1 + 10 / 0.2 * np.sin(0.02), 10 / 0.2 * (1 - np.cos(0.02)), 0.0])
    assert to_vector(quaternion)[0] == pytest.approx([0, 0, 0.04])


def test_a_teleport_is_not_interpolated_through() -> None:
    book = fed([(0.0, (0, 0, 0)), (0.1, (0.1, 0, 0)), (0.2, (50, 0, 0)), (0.3, (50.1, 0, 0))], velocity=(1, 0, 0))
    found = track(book).pose(np.array([0.15, 0.1999, 0.2, 0.25]))[0][:, 0]
    assert found == pytest.approx([0.1, 0.1, 50.0, 50.05])
    assert book.counts["jumps"] == 1


def test_a_turn_faster_than_a_turn_a_second_is_a_jump_unless_it_is_stated() -> None:
    book = fed([(0.0, (0, 0, 0)), (0.1, (0, 0, 0))], yaw_rad=[0.0, 1.0])
    assert book.counts["jumps"] == 1
    spun = Book(names=["car"])
    for t_s, yaw in ((0.0, 0.0), (0.1, 1.0)):
        sample = ActorSample("car", (0, 0, 0), from_angles(yaw), spin_rad_s=(0.0, 0.0, 10.0))
        spun.take(Update(None, (sample,)), round(t_s * 1e9))
    assert spun.counts["jumps"] == 0


def test_a_fast_actor_without_stated_velocities_does_not_jump_at_every_sample() -> None:
    book = fed([(0.02 * k, (0.6 * k, 0, 0)) for k in range(50)])
    assert book.counts["jumps"] == 0


def test_the_measured_cut_in_is_met_within_two_millimetres() -> None:
    """25 m/s, braking up to 10 m/s2 with a jerk, and a lane change: fed at 20 Hz."""

    def at(t: float) -> tuple[float, float, float]:
        brake = max(0.0, t - 1.0)
        return 25 * t - brake**3 * 10 / 6, 3.5 / (1 + np.exp(-4 * (t - 1.2))), 0.0

    def velocity(t: float) -> tuple[float, float, float]:
        step = 1e-5
        one, two = np.array(at(t - step)), np.array(at(t + step))
        return tuple((two - one) / (2 * step))

    book = Book(names=["car"])
    for k in range(41):
        t = 0.05 * k
        book.take(Update(None, (ActorSample("car", at(t), velocity_m_s=velocity(t)),)), round(t * 1e9))
    when = np.linspace(0.0, 2.0, 2001)[:-1]
    found = track(book, 0.0, 2.0).pose(when)[0]
    truth = np.array([at(t) for t in when])
    assert np.abs(found - truth).max() < 2e-3


def test_what_a_sweep_is_given_does_not_depend_on_how_much_else_is_known() -> None:
    rng = np.random.default_rng(3)
    rows = [(0.01 * k, tuple(rng.normal(size=3) * 0.01 + [0.2 * k, 0, 0])) for k in range(200)]
    book = fed(rows, velocity=(20, 0, 0))
    when = np.linspace(0.95, 1.0, 17)
    part, whole = track(book, 0.95, 1.0), track(book, 0.0, 2.0)
    assert len(part.t_s) < 15
    for one, other in zip(part.pose(when), whole.pose(when), strict=True):
        assert np.array_equal(one, other)


def test_a_feed_that_returns_is_blended_back() -> None:
    book = fed([(0.0, (0, 0, 0)), (0.1, (1, 0, 0)), (2.0, (10, 0, 0)), (2.1, (11, 0, 0))], velocity=(10, 0, 0))
    book2 = fed([(0.0, (0, 0, 0)), (0.1, (1, 0, 0)), (2.0, (6.5, 0, 0)), (2.1, (7.5, 0, 0))], velocity=(10, 0, 0))
    assert book.counts["jumps"] == book2.counts["jumps"] == 0
    found = track(book, 0.0, 3.0)
    x = found.pose(np.linspace(1.9, 2.4, 501))[0][:, 0]
    assert x[0] == pytest.approx(6.0)  # 0.5 s of 10 m/s, then held
    assert np.diff(x).max() < 0.08, "no step"
    assert x[-1] == pytest.approx(14.0)


def test_hold_and_extrapolate_use_the_older_sample_alone() -> None:
    rows = [(0.0, (0.0, 0, 0)), (0.1, (2.0, 0, 0))]
    held = track(fed(rows, (10, 0, 0), Rules("hold")))
    went = track(fed(rows, (10, 0, 0), Rules("extrapolate")))
    assert held.pose(np.array([0.05]))[0][0, 0] == 0.0
    assert went.pose(np.array([0.05]))[0][0, 0] == pytest.approx(0.5)


def test_removed_when_silent_if_the_scenario_says_so() -> None:
    book = fed([(0.0, (0, 0, 0))], rules=Rules(silent_after_s=0.2, silent_then="remove"))
    assert track(book, 0.1, 0.3).there(np.array([0.1, 0.19, 0.21])).tolist() == [True, True, False]
    assert book.world(0.5, 0.6).tracks == ()
    assert book.world(0.5, 0.6).gone == {"car"}


def test_the_speed_bound_holds() -> None:
    rng = np.random.default_rng(5)
    for _ in range(50):
        book = Book(names=["car"])
        for k in range(4):
            sample = ActorSample("car", tuple(rng.normal(size=3)), velocity_m_s=tuple(rng.normal(size=3) * 20))
            book.take(Update(None, (sample,)), k * 100_000_000)
        found = track(book)
        when = np.linspace(0, 0.6, 3001)
        x = found.pose(when)[0]
        fastest = np.linalg.norm(np.diff(x, axis=0), axis=1).max() / (when[1] - when[0])
        assert fastest <= found.speed_bound() * (1 + 1e-6)


def test_a_world_arrives_in_another_process_as_it_was() -> None:
    book = fed([(0.0, (0, 0, 0)), (0.1, (1, 2, 0)), (0.2, (90, 0, 0))], velocity=(1.0, 2.0, 0.0))
    book.take(Update(None, (), removed=("car",)), 300_000_000)
    book.take(Update(None, (ActorSample("car", (5, 0, 0), jump=True),)), 400_000_000)
    known = book.world(0.0, 10.0)
    for world in (known, World(known.tracks, known.gone), book.world(0.35, 0.36), World()):
        found = pickle.loads(pickle.dumps(world))
        assert found.gone == world.gone
        assert [name for name, _ in found.tracks] == [name for name, _ in world.tracks]
        for (_, one), (_, other) in zip(found.tracks, world.tracks, strict=True):
            for name, value in vars(other).items():
                if name in COLUMNS:
                    np.testing.assert_array_equal(getattr(one, name), value)
                    assert getattr(one, name).dtype == value.dtype
                else:
                    assert getattr(one, name) == value
    assert len(book.world(0.0, 10.0).tracks) == 2


def test_what_tracks_of_one_world_are_is_what_each_of_them_is_alone() -> None:
    rng = np.random.default_rng(5)
    book = Book(Rules(), names=[f"car {k}" for k in range(6)])
    turns = np.outer(np.arange(8), [0.0, 0.0, 0.0, 0.2, 0.0, 0.0])
    for step in range(8):
        t_s = 0.01 * step
        ways = [
            (0.0, 0.0, 0.0),
            (8.0 * t_s, 0.0, 0.0),
            (t_s, 2.0 * t_s, 0.0),
            (0.0, 0.0, 0.0),
            tuple(rng.normal(size=3)),
        ]
        speeds = [(0.0, 0.0, 0.0), (8.0, 0.0, 0.0), None, (0.0, 0.0, 0.0), (0.1, 0.0, 0.0)]
        actors = [
            ActorSample(f"car {k}", way, from_angles(turns[step, k]), speed)
            for k, (way, speed) in enumerate(zip(ways, speeds, strict=True))
        ]
        book.take(Update(None, tuple(actors)), round(t_s * 1e9))
    world = book.world(0.0, 0.1)
    tracks = [one for _, one in world.tracks]
    alone = [one.nature for _, one in book.world(0.0, 0.1).tracks]  # each by itself
    look_at(tracks, world.columns)
    for one, other in zip(tracks, alone, strict=True):
        mine = one.nature
        assert (mine.comes_back, mine.turns, mine.rests) == (other.comes_back, other.turns, other.rests)
        assert (mine.straight_m_s is None) == (other.straight_m_s is None)
        assert mine.straight_m_s is None or np.array_equal(mine.straight_m_s, other.straight_m_s)
    assert [(one.turns, one.rests, one.straight_m_s is not None) for one in tracks] == [
        (False, True, True), (False, False, True), (False, False, True), (True, False, False), (False, False, False),
    ]  # fmt: skip
    assert tracks[1].straight_m_s == pytest.approx([8.0, 0.0, 0.0])
    for kept, made in zip(world.columns, columns_of(tracks), strict=True):
        assert np.array_equal(kept, made, equal_nan=True)
    there = pickle.loads(pickle.dumps(world))
    for kept, made in zip(there.columns, columns_of([one for _, one in there.tracks]), strict=True):
        assert np.array_equal(kept, made, equal_nan=True)


def test_what_a_sweep_was_given_stays_whatever_comes_before_it_is_looked_at() -> None:
    book = fed([(0.0, (0, 0, 0)), (0.1, (1, 0, 0))])
    given = book.world(0.0, 10.0)
    book.take(Update(None, (ActorSample("car", (9, 0, 0)),)), 200_000_000)
    book.take(Update(None, (), removed=("car",)), 300_000_000)
    ((_, found),) = given.tracks
    assert found.at_m[:, 0].tolist() == [0.0, 1.0]
    assert found.gone_s == np.inf
