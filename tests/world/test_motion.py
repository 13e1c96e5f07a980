"""Rotations by the definitions of ISO 8855, motions by closed forms."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from emulator.world.batched_poses import BatchedPoses
from emulator.world.motion import Motion, Pose, Steady, Waypoints, matrix_of, quaternion_of, rotation_matrix
from tests.draws import cases

angle = st.floats(-400.0, 400.0)


@pytest.mark.parametrize(
    ("angles", "body", "world"),
    [
        ((90, 0, 0), (1, 0, 0), (0, 1, 0)),  # yaw: from x towards y
        ((0, 90, 0), (0, 0, 1), (1, 0, 0)),  # pitch: from z towards x
        ((0, 90, 0), (1, 0, 0), (0, 0, -1)),  # so that the nose goes down
        ((0, 0, 90), (0, 1, 0), (0, 0, 1)),  # roll: from y towards z
        ((90, 90, 0), (1, 0, 0), (0, 0, -1)),  # pitch about the turned y axis
        ((90, 0, 90), (0, 1, 0), (0, 0, 1)),  # roll about the turned x axis
        ((90, 90, 90), (0, 0, 1), (1, 0, 0)),
        ((-270, 0, 0), (1, 0, 0), (0, 1, 0)),
        ((180, 0, 0), (0, 1, 0), (0, -1, 0)),
    ],
)
def test_axes_turn_as_iso_8855_says(angles: tuple[float, float, float], body: tuple, world: tuple) -> None:
    np.testing.assert_array_equal(rotation_matrix(*angles) @ np.array(body, float), np.array(world, float))


@given(yaw=angle, pitch=angle, roll=angle)
@settings(max_examples=cases(50))
def test_rotations_keep_lengths_and_handedness_and_survive_quaternions(yaw: float, pitch: float, roll: float) -> None:
    rotation = rotation_matrix(yaw, pitch, roll)
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-14)
    assert np.linalg.det(rotation) == pytest.approx(1.0)
    np.testing.assert_allclose(matrix_of(quaternion_of(rotation)[None])[0], rotation, atol=1e-14)


def test_constant_velocity_is_in_the_worlds_frame() -> None:
    motion = Steady((1.0, 2.0, 3.0), yaw_deg=90.0, velocity_m_s=(10.0, 0.0, -1.0))
    pose = motion.pose(np.array([-1.0, 0.0, 2.5]))
    np.testing.assert_array_equal(pose.position_m, [[-9.0, 2.0, 4.0], [1.0, 2.0, 3.0], [26.0, 2.0, 0.5]])
    np.testing.assert_array_equal(pose.rotation[2] @ [1.0, 0.0, 0.0], [0.0, 1.0, 0.0])
    np.testing.assert_array_equal(motion.velocity(np.zeros(2)), [[10.0, 0.0, -1.0]] * 2)
    assert not motion.still
    assert Steady((5.0, 5.0, 5.0), 30.0).still


def test_a_yaw_rate_turns_about_the_worlds_z_axis() -> None:
    motion = Steady(yaw_deg=10.0, pitch_deg=20.0, yaw_rate_deg_s=40.0)
    got = motion.pose(np.array([0.0, 2.0])).rotation
    np.testing.assert_allclose(got[1], rotation_matrix(90.0, 20.0, 0.0), atol=1e-15)
    assert motion.turns
    assert not motion.still


def path(loop: bool = False) -> Waypoints:
    return Waypoints.through(
        [1.0, 2.0, 4.0],
        [(0.0, 0.0, 0.0), (10.0, 0.0, 0.0), (10.0, 8.0, 2.0)],
        [(170.0, 0.0, 0.0), (-170.0, 0.0, 0.0), (-170.0, 30.0, 0.0)],
        loop,
    )


def test_between_waypoints_it_moves_straight_and_before_and_after_it_stands() -> None:
    times = np.array([-5.0, 1.0, 1.25, 2.0, 3.0, 4.0, 99.0])
    want = [[0, 0, 0], [0, 0, 0], [2.5, 0, 0], [10, 0, 0], [10, 4, 1], [10, 8, 2], [10, 8, 2]]
    np.testing.assert_allclose(path().position(times), want, atol=1e-15)
    velocity = [[0, 0, 0], [10, 0, 0], [10, 0, 0], [0, 4, 1], [0, 4, 1], [0, 0, 0], [0, 0, 0]]
    np.testing.assert_array_equal(path().velocity(times), velocity)
    assert path().speed_bound_m_s == 10.0


def test_angles_go_the_shortest_way_at_a_constant_rate() -> None:
    times = np.array([1.0, 1.25, 1.5, 2.0])
    for rotation, yaw in zip(path().pose(times).rotation, (170.0, 175.0, 180.0, 190.0), strict=True):
        np.testing.assert_allclose(rotation, rotation_matrix(yaw), atol=1e-14)
    np.testing.assert_allclose(path().pose(np.array([3.0])).rotation[0], rotation_matrix(-170.0, 15.0), atol=1e-14)


def test_a_loop_begins_again_and_reaches_back() -> None:
    times = np.array([1.25, 4.25, 7.25, 301.25, -1.75])
    np.testing.assert_allclose(path(loop=True).position(times), [[2.5, 0, 0]] * 5, atol=1e-12)
    assert path(loop=True).speed_bound_m_s == math.inf
    closed = Waypoints.through([0, 1, 2], [(0, 0, 0), (3, 4, 0), (0, 0, 0)], [(0, 0, 0)] * 3, loop=True)
    assert closed.speed_bound_m_s == 5.0


def test_one_waypoint_is_a_place() -> None:
    motion = Waypoints.through([3.0], [(1.0, 2.0, 3.0)], [(40.0, 0.0, 0.0)], loop=True)
    assert motion.still
    np.testing.assert_array_equal(motion.position(np.array([0.0, 9.0])), [[1, 2, 3]] * 2)


@given(t=st.floats(-20, 20), small=st.floats(1e-9, 1e-3))
@settings(max_examples=cases(40))
def test_velocity_is_the_change_of_position(t: float, small: float) -> None:
    motion = path()
    step = motion.position(np.array([t, t + small]))
    if np.searchsorted(motion.t_s, t, "right") == np.searchsorted(motion.t_s, t + small, "right"):
        np.testing.assert_allclose((step[1] - step[0]) / small, motion.velocity(np.array([t]))[0], atol=1e-5)


def test_a_pose_within_a_pose_is_carried_along() -> None:
    outer = Steady((10.0, 0.0, 0.0), yaw_deg=90.0).pose(np.zeros(1))
    inner = Steady((2.0, 0.0, 0.5), yaw_deg=90.0).pose(np.zeros(1)).after(outer)
    np.testing.assert_allclose(inner.position_m, [[10.0, 2.0, 0.5]])
    np.testing.assert_array_equal(inner.rotation[0] @ [1.0, 0.0, 0.0], [-1.0, 0.0, 0.0])
    np.testing.assert_array_equal(Pose(np.zeros((1, 3)), np.eye(3)[None]).to_world(np.ones(3)), [[1.0, 1.0, 1.0]])


# ---------------------------------------------------------------- many at once


@pytest.mark.parametrize(("poses", "points"), [(1, 5), (5, 5), (5, 1), (1, 0), (3, 3)])
def test_one_pose_takes_many_points_and_many_poses_one(poses: int, points: int) -> None:
    rng = np.random.default_rng(poses)
    place, point, turn = rng.normal(size=(poses, 3)), rng.normal(size=(points, 3)), rotation_matrix(30.0, 20.0, 10.0)
    fixed = Pose(place, np.broadcast_to(turn, (poses, 3, 3))).to_world(point)
    each = Pose(place, np.broadcast_to(turn, (poses, 3, 3)).copy()).to_world(point)
    assert fixed.shape == each.shape == (points if poses == 1 else poses, 3)
    np.testing.assert_allclose(fixed, each, atol=1e-15)


def motions() -> list[Motion]:
    return [
        Steady((1.0, 2.0, 3.0), 30.0, velocity_m_s=(1.0, 0.0, 2.0)),
        path(),
        path(loop=True),
        Steady(yaw_rate_deg_s=10.0),
        Waypoints.through([0.0, 3.0], [(0, 0, 0), (3, 0, 0)], [(20, 0, 0)] * 2, loop=True),
        Waypoints.through([0.5], [(4, 4, 4)], [(0, 0, 0)]),
    ]


@given(begin=st.floats(-10.0, 40.0), span=st.sampled_from([0.0, 1e-6, 0.0133, 0.7]), asked=st.floats(0.0, 1.0))
@settings(max_examples=cases(80))
def test_straight_stretches_tell_the_same_places_as_the_motions(begin: float, span: float, asked: float) -> None:
    batched = BatchedPoses(motions())
    batched.during(begin - 0.001, begin)  # what it remembers must not matter
    found = batched.during(begin, begin + span)
    t = begin + asked * span
    for number, motion in enumerate(motions()):
        if found.straight[number]:
            place = found.at[:, number] + (t - found.since[number]) * found.velocity[:, number]
            np.testing.assert_allclose(place, motion.position(np.array([t]))[0], atol=1e-11)
            np.testing.assert_allclose(found.turned[:, :, number], motion.pose(np.array([t])).rotation[0], atol=1e-12)
    assert found.straight[0]
    assert not found.straight[3]
    fresh = BatchedPoses(motions()).during(begin, begin + span)
    np.testing.assert_array_equal(found.since, fresh.since)
    np.testing.assert_array_equal(found.straight, fresh.straight)


def test_a_time_over_a_waypoint_is_not_straight() -> None:
    assert not BatchedPoses(motions()).during(1.99, 2.01).straight[1]
    assert BatchedPoses([path(loop=True), path()]).during(4.5, 4.6).straight.tolist() == [False, True]
    assert not BatchedPoses([motions()[4]]).during(2.99, 3.01).straight[0]
    assert BatchedPoses([motions()[4]]).during(2.9, 2.95).straight[0]
