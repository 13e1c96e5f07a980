"""Objects over time: place, speed, size, heading, birth, occlusion, coasting, death; in a flat world of boxes."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from emulator.objects import kalman
from emulator.objects.classes import assumed_sizes, by_size
from emulator.objects.options import TrackerOptions
from emulator.objects.points import SensorMotion, View
from emulator.objects.tracker import ObjectTracker, believed, completed, wrapped
from protocols.scan import DetectedObject, Scan
from tests.draws import cases
from tests.objects.flatland import Box, look, plan_of

CYCLE_S = 0.08
ACTORS = ("world", "a", "b", "c", "d")


def follow(
    boxes: Sequence[Box] | Callable[[float], Sequence[Box]],
    seconds: float,
    options: TrackerOptions | None = None,
    *,
    noise_m: float = 0.02,
    motion: Callable[[float], SensorMotion] | None = None,
    beams: int = 721,
) -> list[tuple[float, tuple[DetectedObject, ...]]]:
    """Lists of a tracker that looks at a moving world."""
    rng = np.random.default_rng(7)
    tracker = ObjectTracker(options, ACTORS)
    lists = []
    for k in range(round(seconds / CYCLE_S)):
        t_s = k * CYCLE_S
        now = boxes(t_s) if callable(boxes) else boxes
        pose = motion(t_s) if motion else None
        view = look(now, t_s, noise_m=noise_m, rng=rng, motion=pose, beams=beams)
        lists.append((t_s, tracker.update([view], t_s, pose)))
    return lists


def only(objects: Sequence[DetectedObject]) -> DetectedObject:
    assert len(objects) == 1
    return objects[0]


@pytest.mark.parametrize(
    ("box", "category"),
    [
        (Box(1, 30.0, 4.0, vx_m_s=-5.0, yaw_rad=math.pi), "car"),
        (Box(1, 12.0, -9.0, vy_m_s=4.0, yaw_rad=math.pi / 2), "car"),
        (Box(1, 12.0, 6.0, vx_m_s=8.0), "car"),
        (Box(1, 15.0, 2.0, length_m=0.5, width_m=0.5, vy_m_s=-1.2), "pedestrian"),
        (Box(1, 12.0, -8.0, length_m=1.8, width_m=0.6, vx_m_s=5.0), "bicycle"),
        (Box(1, 20.0, 10.0, length_m=12.0, width_m=2.5, vx_m_s=-3.0, yaw_rad=math.pi), "truck"),
    ],
)
@pytest.mark.parametrize("segmentation", ["cluster", "actor"])
def test_one_road_user_is_followed_where_it_is_with_its_speed(box: Box, category: str, segmentation: str) -> None:
    options = TrackerOptions(segmentation=segmentation)  # type: ignore[arg-type]
    lists = follow([box], 2.0, options)
    for t_s, objects in lists[12:]:
        found, truth = only(objects), box.at(t_s)
        assert found.position_m[:2] == pytest.approx((truth.x_m, truth.y_m), abs=0.4)
        assert found.velocity_m_s[:2] == pytest.approx((box.vx_m_s, box.vy_m_s), abs=0.7)
        assert found.size_m[:2] == pytest.approx((box.length_m, box.width_m), abs=0.35)
        assert found.category == category
        assert found.actor == "a"
    if box.length_m > 1.0:
        assert math.cos(found.yaw_rad - math.atan2(box.vy_m_s, box.vx_m_s)) > math.cos(math.radians(5))
    assert len({only(objects).track for _, objects in lists[1:]}) == 1


def test_an_object_is_listed_from_its_second_scan_on_with_its_age_and_belief() -> None:
    lists = follow([Box(1, 20.0, 3.0)], 0.8)
    assert [len(objects) for _, objects in lists[:3]] == [0, 1, 1]
    ages = [only(objects).age_s for _, objects in lists[1:]]
    assert ages == pytest.approx([CYCLE_S * k for k in range(1, len(lists))])
    beliefs = [only(objects).existence for _, objects in lists[1:]]
    assert all(b >= a for a, b in itertools.pairwise(beliefs))
    assert beliefs[0] == pytest.approx(0.6 * 0.9 / (0.6 * 0.9 + 0.4 * 0.2))
    assert beliefs[-1] > 0.999


@pytest.mark.parametrize("coast_s", [0.2, 0.5, 1.0])
def test_an_object_that_no_beam_sees_any_more_disappears_after_the_coasting_time(coast_s: float) -> None:
    box = Box(1, 30.0, 3.0, vx_m_s=-5.0)
    lists = follow(lambda t_s: [box] if t_s < 1.0 else [], 3.0, TrackerOptions(coast_s=coast_s))
    last_seen_s = max(t_s for t_s, objects in lists if objects and objects[0].coasting_s == 0.0)
    for t_s, objects in lists[2:]:
        unseen_s = t_s - last_seen_s
        if unseen_s <= 0.0:
            assert only(objects).coasting_s == 0.0
        elif unseen_s <= coast_s:
            found = only(objects)
            assert found.coasting_s == pytest.approx(unseen_s)
            assert found.position_m[0] == pytest.approx(box.at(t_s).x_m, abs=0.5)
            assert found.contour_m == ()
        else:
            assert objects == ()
    beliefs = [objects[0].existence for t_s, objects in lists if objects and t_s >= last_seen_s]
    assert all(b < a for a, b in itertools.pairwise(beliefs))
    spreads = [objects[0].position_std_m[0] for t_s, objects in lists if objects and t_s >= last_seen_s]
    assert all(b > a for a, b in itertools.pairwise(spreads))


def test_a_hidden_object_is_believed_in_longer_than_one_that_should_be_seen() -> None:
    target = Box(1, 40.0, 0.0)
    screen = Box(2, 20.0, 0.0, length_m=0.5, width_m=6.0)

    def belief(shown: Callable[[float], list[Box]]) -> float:
        lists = follow(shown, 1.4, TrackerOptions(coast_s=1.0))
        return next(o.existence for o in lists[-1][1] if o.actor == "a")

    hidden = belief(lambda t_s: [target] if t_s < 1.0 else [target, screen])
    vanished = belief(lambda t_s: [target] if t_s < 1.0 else [])
    assert hidden > 0.9
    assert vanished < 0.5


def test_an_object_that_passes_behind_another_keeps_its_number() -> None:
    target = Box(1, 30.0, -6.0, length_m=1.8, width_m=0.6, vy_m_s=6.0, yaw_rad=math.pi / 2)
    pillar = Box(2, 15.0, 0.0, length_m=1.2, width_m=1.6)
    lists = follow([target, pillar], 2.0, TrackerOptions(coast_s=1.0))
    numbers = {o.track for _, objects in lists[3:] for o in objects if o.actor == "a"}
    assert len(numbers) == 1
    assert any(o.coasting_s > 0.0 for _, objects in lists for o in objects if o.actor == "a")
    found = next(o for o in lists[-1][1] if o.actor == "a")
    assert found.coasting_s == 0.0
    assert found.position_m[1] == pytest.approx(target.at(lists[-1][0]).y_m, abs=0.4)


def test_two_that_cross_keep_their_numbers() -> None:
    one = Box(1, 20.0, -5.0, length_m=0.6, width_m=0.6, vy_m_s=3.0)
    other = Box(2, 24.0, 5.0, length_m=0.6, width_m=0.6, vy_m_s=-3.0)
    lists = follow([one, other], 3.2, TrackerOptions(coast_s=1.0))
    for actor in ("a", "b"):
        assert len({o.track for _, objects in lists[3:] for o in objects if o.actor == actor}) == 1


def test_only_the_rear_is_seen_and_a_car_is_assumed_behind_it() -> None:
    car = Box(1, 25.0, 0.0, vx_m_s=2.0)
    t_s, objects = follow([car], 1.6)[-1]
    found = only(objects)
    assert found.category == "car"
    assert found.size_m[:2] == pytest.approx((4.4, 1.8), abs=0.2)
    assert found.position_m[:2] == pytest.approx((car.at(t_s).x_m, 0.0), abs=0.3)
    assert abs(math.sin(found.yaw_rad)) < 0.1


def test_a_parked_car_seen_from_the_rear_heads_away_and_not_across() -> None:
    found = only(follow([Box(1, 20.0, 0.0)], 0.8)[-1][1])
    assert abs(math.sin(found.yaw_rad)) < 0.1
    assert math.hypot(*found.velocity_m_s[:2]) < 0.3


def test_sizes_grow_to_what_is_seen_and_boxes_that_are_known_better_do_not_seem_to_move() -> None:
    # its front first; as it comes nearer its side comes into view
    long_car = Box(1, 40.0, 5.0, length_m=5.6, width_m=2.0, vx_m_s=-9.0, yaw_rad=math.pi)
    lists = follow([long_car], 3.2)
    for _, objects in lists[8:]:
        assert only(objects).velocity_m_s[0] == pytest.approx(-9.0, abs=1.2)
    assert only(lists[-1][1]).size_m[0] == pytest.approx(5.6, abs=0.4)


def test_with_its_own_motion_known_a_sensor_sees_standing_things_stand() -> None:
    def pose(t_s: float) -> SensorMotion:
        return SensorMotion(x_m=10.0 * t_s, y_m=0.2, yaw_rad=0.05, vx_m_s=10.0)

    lists = follow([Box(1, 40.0, 4.0, yaw_rad=0.3)], 2.0, motion=pose)
    for t_s, objects in lists[12:]:
        found, here = only(objects), pose(t_s)
        c, s = math.cos(0.05), math.sin(0.05)
        dx, dy = 40.0 - here.x_m, 4.0 - here.y_m
        assert found.position_m[:2] == pytest.approx((c * dx + s * dy, c * dy - s * dx), abs=0.3)
        assert found.velocity_m_s[:2] == pytest.approx((-10.0 * c, 10.0 * s), abs=0.6)
        assert found.yaw_rad == pytest.approx(0.25, abs=0.06)


def test_a_turning_sensor_sees_a_standing_thing_swing_round() -> None:
    def pose(t_s: float) -> SensorMotion:
        return SensorMotion(yaw_rad=0.2 * t_s, yaw_rate_rad_s=0.2)

    _, objects = follow([Box(1, 20.0, 5.0)], 1.6, motion=pose)[-1]
    found = only(objects)
    x, y, _ = found.position_m
    assert found.velocity_m_s[:2] == pytest.approx((0.2 * y, -0.2 * x), abs=0.4)


def test_a_list_without_a_scan_only_moves_on() -> None:
    box = Box(1, 20.0, 3.0, vx_m_s=-4.0)
    tracker = ObjectTracker(actors=ACTORS)
    for k in range(20):
        tracker.update([look([box], k * CYCLE_S)], k * CYCLE_S)
    before = only(tracker.update([look([box], 1.6)], 1.6))
    after = only(tracker.update([], 1.7))
    assert after.position_m[0] == pytest.approx(before.position_m[0] - 0.4, abs=0.05)
    assert after.existence == before.existence
    assert after.coasting_s == pytest.approx(0.1)


def test_echoes_of_an_earlier_instant_are_brought_to_the_time_of_the_list() -> None:
    box = Box(1, 30.0, 3.0, vx_m_s=-10.0)
    tracker = ObjectTracker(actors=ACTORS)
    for k in range(25):
        view = look([box], k * CYCLE_S)
        late = tracker.update([view], k * CYCLE_S + 0.05)
    found = only(late)
    assert found.position_m[0] == pytest.approx(box.at(24 * CYCLE_S + 0.05).x_m, abs=0.2)


def test_two_sensors_see_one_object_as_one() -> None:
    box = Box(1, 20.0, 0.0, yaw_rad=0.4)
    tracker = ObjectTracker(actors=ACTORS)
    objects: tuple[DetectedObject, ...] = ()
    for k in range(6):
        t_s = k * CYCLE_S
        right = look([replace(box, y_m=box.y_m + 0.8)], t_s)
        views = [look([box], t_s), View(right.scan, np.array([0.0, -0.8, 0.0]))]
        objects = tracker.update(views, t_s)
    assert only(objects).position_m[:2] == pytest.approx((20.0, 0.0), abs=0.25)


def test_classes_can_be_the_actors_own() -> None:
    options = TrackerOptions(classify="actor", classes={"a": "motorcycle"})
    lists = follow([Box(1, 20.0, 3.0), Box(2, 20.0, -5.0)], 0.4, options)
    assert {o.actor: o.category for o in lists[-1][1]} == {"a": "motorcycle", "b": "unknown"}


def test_the_outline_lies_on_the_object_in_the_order_of_azimuth_and_is_bounded() -> None:
    box = Box(1, 10.0, 2.0, yaw_rad=0.5)
    found = only(follow([box], 0.4, TrackerOptions(contour_points=20), noise_m=0.0)[-1][1])
    azimuth = [math.atan2(y, x) for x, y in found.contour_m]
    assert azimuth == sorted(azimuth)
    assert len(azimuth) == 20
    c, s = math.cos(0.5), math.sin(0.5)
    for x, y in found.contour_m:
        along, across = c * (x - 10) + s * (y - 2), c * (y - 2) - s * (x - 10)
        assert max(abs(along) / 2.2, abs(across) / 0.9) == pytest.approx(1.0, abs=0.01)


def test_reflectance_follows_the_intensity_over_the_range() -> None:
    found = only(follow([Box(1, 20.0, 3.0)], 0.4)[-1][1])
    assert found.reflectance == pytest.approx(1.0, abs=0.02)  # the flat world is white, and reaches 100 m


def test_time_must_not_run_backwards() -> None:
    tracker = ObjectTracker()
    tracker.update([], 1.0)
    with pytest.raises(ValueError, match=r"list at 0.9 s after one at 1.0 s"):
        tracker.update([], 0.9)


def test_after_clear_nothing_is_known_and_numbers_go_on() -> None:
    tracker = ObjectTracker(actors=ACTORS)
    box = Box(1, 20.0, 3.0)
    for k in range(3):
        first = tracker.update([look([box], k * CYCLE_S)], k * CYCLE_S)
    tracker.clear()
    assert tracker.update([look([box], 0.0)], 0.0) == ()
    again = tracker.update([look([box], CYCLE_S)], CYCLE_S)
    assert only(again).track > only(first).track


def test_the_same_scans_give_the_same_objects() -> None:
    boxes = [Box(1, 30.0, 4.0, vx_m_s=-5.0), Box(2, 15.0, -6.0, vy_m_s=2.0)]
    assert follow(boxes, 1.0) == follow(boxes, 1.0)


@settings(max_examples=cases(25))
@given(
    st.lists(
        st.tuples(
            st.floats(3, 60),
            st.floats(-20, 20),
            st.floats(0.1, 15),
            st.floats(0.1, 3),
            st.floats(-3.1, 3.1),
            st.floats(-20, 20),
        ),
        max_size=6,
    ),
    st.sampled_from(["cluster", "actor"]),
)
def test_whatever_stands_around_every_object_is_finite_and_numbered_once(
    world: list[tuple[float, float, float, float, float, float]], segmentation: str
) -> None:
    boxes = [
        Box(k + 1, x, y, length, width, yaw, speed, 0.0) for k, (x, y, length, width, yaw, speed) in enumerate(world)
    ]
    options = TrackerOptions(segmentation=segmentation)  # type: ignore[arg-type]
    for _, objects in follow(boxes, 0.8, options, beams=181):
        assert len({o.track for o in objects}) == len(objects)
        for found in objects:
            numbers = [
                *found.position_m,
                *found.velocity_m_s,
                *found.size_m,
                found.yaw_rad,
                *found.position_std_m,
                *found.velocity_std_m_s,
            ]
            assert all(math.isfinite(number) for number in numbers)
            assert min(found.size_m) >= 0.0
            assert 0.0 < found.existence < 1.0
            assert -math.pi <= found.yaw_rad < math.pi


def test_a_beam_without_echoes_or_without_beams_is_a_legal_scan() -> None:
    tracker = ObjectTracker()
    assert tracker.update([View(Scan.empty(plan_of(0, 1.0, 0.0)))], 0.0) == ()
    assert tracker.update([View(Scan.empty(plan_of(1, 1.0, 0.0)))], 0.1) == ()


# The filter against closed forms


def test_what_was_seen_a_while_ago_is_filtered_as_what_it_was_then() -> None:
    state, covariance = np.zeros((1, 4)), np.diag([0.01, 0.01, 100.0, 100.0])[None]
    for k in range(1, 60):
        state, covariance = kalman.predict(state, covariance, 0.1, 0.0)
        place, since_s = np.array([[3.0 * (0.1 * k - 0.07), 0.0]]), np.array([0.07])
        state, covariance = kalman.update(state, covariance, place, np.array([0.01]), since_s)
    assert state[0] == pytest.approx([3.0 * 5.9, 0.0, 3.0, 0.0], abs=1e-2)


def test_the_filter_finds_the_speed_of_what_moves_straight() -> None:
    state, covariance = np.zeros((1, 4)), np.diag([0.01, 0.01, 100.0, 100.0])[None]
    for k in range(1, 60):
        state, covariance = kalman.predict(state, covariance, 0.1, 0.0)
        state, covariance = kalman.update(
            state, covariance, np.array([[0.3 * k, -0.1 * k]]), np.array([0.01]), np.zeros(1)
        )
    assert state[0] == pytest.approx([0.3 * 59, -5.9, 3.0, -1.0], abs=1e-3)


def test_without_motion_noise_the_spread_is_that_of_a_straight_line_through_all_points() -> None:
    # variance of the end of a regression line through n points: s^2 (4 n - 2) / (n (n + 1)), and of its slope
    # 12 s^2 / (dt^2 n (n^2 - 1))
    n, dt_s, variance = 40, 0.1, 0.04
    state, covariance = np.zeros((1, 4)), np.diag([1e8, 1e8, 1e8, 1e8])[None]
    for k in range(n):
        if k:
            state, covariance = kalman.predict(state, covariance, dt_s, 0.0)
        state, covariance = kalman.update(state, covariance, np.zeros((1, 2)), np.array([variance]), np.zeros(1))
    assert covariance[0, 0, 0] == pytest.approx(variance * (4 * n - 2) / (n * (n + 1)), rel=1e-3)
    assert covariance[0, 2, 2] == pytest.approx(12 * variance / (dt_s**2 * n * (n**2 - 1)), rel=1e-3)


@given(st.floats(0.001, 2.0), st.floats(0.0, 10.0), st.integers(1, 20))
def test_the_covariance_stays_symmetric_and_positive(dt_s: float, acceleration: float, steps: int) -> None:
    state, covariance = np.zeros((1, 4)), np.diag([0.1, 0.2, 100.0, 50.0])[None]
    for _ in range(steps):
        state, covariance = kalman.predict(state, covariance, dt_s, acceleration)
        state, covariance = kalman.update(state, covariance, np.ones((1, 2)), np.array([0.01]), np.array([0.05]))
    assert covariance[0] == pytest.approx(covariance[0].T, abs=1e-9)
    assert np.linalg.eigvalsh(covariance[0]).min() > 0.0


def test_distances_are_those_of_the_inverse_covariance() -> None:
    rng = np.random.default_rng(2)
    root = rng.normal(size=(3, 4, 4))
    covariance = root @ root.transpose(0, 2, 1)
    state, place, variance = rng.normal(size=(3, 4)), rng.normal(size=(3, 5, 2)), rng.uniform(0.1, 1.0, 5)
    since = rng.uniform(0.0, 0.2, 5)
    found = kalman.distances(state, covariance, place, variance, since)
    for row in range(3):
        for column in range(5):
            model = np.hstack([np.eye(2), -since[column] * np.eye(2)])
            spread = model @ covariance[row] @ model.T + variance[column] * np.eye(2)
            apart = place[row, column] - model @ state[row]
            assert found[row, column] == pytest.approx(apart @ np.linalg.inv(spread) @ apart)


@given(st.floats(0.01, 0.99), st.floats(0.1, 0.99))
def test_seeing_strengthens_belief_and_missing_weakens_it(existence: float, there: float) -> None:
    before, at = np.array([existence]), np.array([there])
    seen, missed = believed(before, at, 0.05, seen=True)[0], believed(before, at, 0.05, seen=False)[0]
    assert seen > existence > missed
    # the two, weighted by how probable they are, are what was believed before
    probability = existence * there + (1 - existence) * 0.05
    assert seen * probability + missed * (1 - probability) == pytest.approx(existence, abs=1e-4)


def test_a_side_is_completed_away_from_the_sensor() -> None:
    low, high = np.array([5.0, -7.0, -1.0, 5.0]), np.array([6.0, -6.0, 2.0, 9.0])
    free = np.zeros(4, dtype=np.bool_)
    assert completed(low, high, np.full(4, 3.0), free, free) == pytest.approx([6.5, -7.5, 0.5, 7.0])


def test_a_side_of_which_one_end_is_hidden_is_completed_from_the_other() -> None:
    low, high, size = np.full(4, 5.0), np.full(4, 6.0), np.full(4, 3.0)
    hidden_low, hidden_high = np.array([False, True, False, True]), np.array([False, False, True, True])
    assert completed(low, high, size, hidden_low, hidden_high) == pytest.approx([6.5, 4.5, 6.5, 5.5])


def test_angles_are_wrapped_to_a_turn() -> None:
    assert wrapped(np.array([0.0, math.pi, -math.pi, 7.0])) == pytest.approx(
        [0.0, -math.pi, -math.pi, 7.0 - 2 * math.pi]
    )


def test_classes_by_size() -> None:
    length = np.array([0.2, 0.6, 1.8, 4.4, 12.0, 5.0, 25.0])
    width = np.array([0.1, 0.5, 0.6, 1.8, 2.5, 4.0, 2.0])
    names = ["point", "pedestrian", "bicycle", "car", "truck", "wide", "wide"]
    from emulator.objects.classes import NAMES

    assert [NAMES[code] for code in by_size(length, width)] == names


def test_only_sides_that_were_not_seen_are_assumed() -> None:
    length, width = np.array([0.1, 0.1, 0.1, 4.6, 0.5]), np.array([1.8, 2.5, 0.5, 0.1, 0.5])
    unknown, known = np.zeros(5, dtype=np.bool_), np.ones(5, dtype=np.bool_)
    assert assumed_sizes(length, width, unknown, unknown)[0] == pytest.approx([4.4, 8.0, 0.1, 4.6, 0.5])
    assert assumed_sizes(length, width, unknown, unknown)[1] == pytest.approx([1.8, 2.5, 0.5, 1.8, 0.5])
    assert assumed_sizes(length, width, known, known)[0] == pytest.approx(length)
