"""Groups of echoes and their boxes, on scans of a flat world and on points with known answers."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from emulator.objects.options import TrackerOptions
from emulator.objects.points import Points, SensorMotion, View, beam_step_rad, joined, points_of
from emulator.objects.segments import cluster_labels, fit_yaw, segment
from protocols.scan import Scan
from tests.draws import cases
from tests.objects.flatland import Box, look, plan_of

EVERYWHERE = (float("-inf"), float("inf"))


def points_at(places: list[tuple[float, float]]) -> Points:
    x, y = np.array(places, dtype=np.float64).reshape(-1, 2).T
    n = len(x)
    return Points(x, y, np.zeros(n), np.hypot(x, y), np.zeros(n), np.ones(n), np.ones(n, dtype=np.int64), np.zeros(n))


def chained(places: list[tuple[float, float]], gap_m: float) -> list[int]:
    """Clusters by hand: a point joins every point nearer than the gap."""
    labels = list(range(len(places)))
    for i, (ax, ay) in enumerate(places):
        for j, (bx, by) in enumerate(places[:i]):
            if math.hypot(ax - bx, ay - by) <= gap_m:
                old, new = labels[i], labels[j]
                labels = [new if label == old else label for label in labels]
    return labels


def same_partition(one: list[int], other: list[int]) -> bool:
    return all((one[i] == one[j]) == (other[i] == other[j]) for i in range(len(one)) for j in range(i))


@settings(max_examples=cases(50))
@given(st.lists(st.tuples(st.integers(-8, 8), st.integers(-8, 8)), max_size=25))
def test_points_on_a_grid_are_clustered_as_by_hand(cells: list[tuple[int, int]]) -> None:
    # one metre apart and a gap of 1.2 m: neither the grid's diagonal nor the cells' rounding decides
    places = [(float(x), float(y)) for x, y in cells]
    found = cluster_labels(points_at(places), 1.2, 0.0).tolist()
    assert same_partition(found, chained(places, 1.2))


def test_the_gap_grows_with_the_range() -> None:
    places = [(5.0, 0.0), (5.0, 1.0), (80.0, 0.0), (80.0, 1.0)]
    labels = cluster_labels(points_at(places), 0.6, 0.015).tolist()
    assert labels[0] != labels[1]
    assert labels[2] == labels[3]


def test_a_wall_from_near_to_far_is_one_cluster_across_the_bands() -> None:
    places = [(0.3 * k, 2.0) for k in range(1, 300)]
    assert len(set(cluster_labels(points_at(places), 0.6, 0.015).tolist())) == 1


def test_the_order_of_the_points_does_not_matter() -> None:
    rng = np.random.default_rng(1)
    places = [(float(x), float(y)) for x, y in rng.uniform(-20, 20, (200, 2))]
    order = rng.permutation(200)
    plain = cluster_labels(points_at(places), 0.8, 0.02).tolist()
    mixed = cluster_labels(points_at([places[k] for k in order]), 0.8, 0.02).tolist()
    back = [0] * 200
    for position, k in enumerate(order):
        back[k] = mixed[position]
    assert same_partition(plain, back)


@pytest.mark.parametrize("yaw_deg", range(0, 180, 12))
def test_the_box_of_a_car_is_where_the_car_is(yaw_deg: int) -> None:
    car = Box(1, 15.0, 3.0, yaw_rad=math.radians(yaw_deg))
    groups = segment(points_of(look([car], 0.0), EVERYWHERE), TrackerOptions())
    assert len(groups) == 1
    off = (math.degrees(groups.yaw_rad[0]) - yaw_deg + 45) % 90 - 45
    sizes = sorted([groups.along_m[0], groups.across_m[0]])
    sight_deg = math.degrees(math.atan2(3.0, 15.0))
    squarely = abs((yaw_deg - sight_deg + 45) % 90 - 45)
    if squarely > 15.0:  # two sides are seen
        assert abs(off) <= 2.0
        assert sizes == pytest.approx([1.8, 4.4], abs=0.25)
        assert (groups.x_m[0], groups.y_m[0]) == pytest.approx((15.0, 3.0), abs=0.15)
    else:
        assert abs(off) <= 8.0


def test_rectangles_are_fitted_group_by_group() -> None:
    rng = np.random.default_rng(3)
    angles = np.radians([10.0, 35.0, 70.0])
    x, y, first = [], [], [0]
    for angle in angles:
        along = np.concatenate([np.linspace(0, 4, 30), np.zeros(15)])
        across = np.concatenate([np.zeros(30), np.linspace(0, 2, 15)])
        x.append(20 + along * np.cos(angle) - across * np.sin(angle) + rng.normal(0, 0.01, 45))
        y.append(5 + along * np.sin(angle) + across * np.cos(angle) + rng.normal(0, 0.01, 45))
        first.append(first[-1] + 45)
    found = fit_yaw(np.concatenate(x), np.concatenate(y), np.array(first))
    assert np.degrees(found) == pytest.approx([10.0, 35.0, 70.0], abs=2.0)


def test_single_echoes_and_long_walls_are_no_objects() -> None:
    boxes = [Box(1, 20.0, 0.0), Box(2, 30.0, 12.0, length_m=40.0, width_m=0.2)]
    view = look(boxes, 0.0)
    view.scan.range_m[0, 0] = 3.0  # a drop of rain
    groups = segment(points_of(view, EVERYWHERE), TrackerOptions())
    assert groups.actor.tolist() == [1]


def test_the_ideal_segmentation_goes_by_actor_whatever_the_gap() -> None:
    boxes = [Box(1, 20.0, 0.0), Box(2, 20.0, 2.0), Box(3, 40.0, 12.0, length_m=30.0)]
    groups = segment(points_of(look(boxes, 0.0), EVERYWHERE), TrackerOptions(segmentation="actor"))
    assert groups.actor.tolist() == [1, 2, 3]
    near = segment(points_of(look(boxes[:2], 0.0), EVERYWHERE), TrackerOptions())
    assert len(near) == 1  # 0.2 m apart: by distance they are one


def test_the_world_and_the_weather_are_no_actors() -> None:
    view = look([Box(0, 20.0, 0.0), Box(1, 20.0, 8.0)], 0.0)
    view.scan.range_m[:20, 0], view.scan.actor[:20, 0] = 2.0, -1
    groups = segment(points_of(view, EVERYWHERE), TrackerOptions(segmentation="actor"))
    assert groups.actor.tolist() == [1]


def test_points_lie_where_the_beams_hit_also_for_turned_and_raised_sensors() -> None:
    plan = plan_of(1, 0.0, 0.0)
    plan.azimuth_rad[0], plan.elevation_rad[0] = math.radians(30), math.radians(-10)
    scan = Scan.empty(plan)
    scan.range_m[0, 0], scan.actor[0, 0] = 10.0, 4
    turn = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    point = points_of(View(scan, np.array([1.0, 2.0, 3.0]), turn), EVERYWHERE)
    flat = 10.0 * math.cos(math.radians(10))
    assert (point.x_m[0], point.y_m[0], point.z_m[0]) == pytest.approx(
        (1.0 - flat * 0.5, 2.0 + flat * math.cos(math.radians(30)), 3.0 - 10.0 * math.sin(math.radians(10)))
    )
    assert point.actor[0] == 4


def test_the_height_band_leaves_the_ground_out() -> None:
    plan = plan_of(3, 0.2, 0.0)
    plan.elevation_rad[:] = [-0.2, 0.0, 0.2]
    scan = Scan.empty(plan)
    scan.range_m[:, 0] = 10.0
    assert len(points_of(View(scan), (-1.0, 1.0))) == 1


def test_the_motion_of_the_sensor_is_taken_out_of_a_slow_scan() -> None:
    # a wall straight ahead, seen while driving towards it at 10 m/s for 0.1 s, turning at 0.3 rad/s
    motion = SensorMotion(x_m=5.0, y_m=1.0, yaw_rad=0.4, vx_m_s=10.0, vy_m_s=-2.0, yaw_rate_rad_s=0.3)
    post = np.array([30.0, 12.0])
    times = np.linspace(0.0, 0.1, 11)
    seen = []
    for t in times:
        back = t - 0.1
        yaw = motion.yaw_rad + motion.yaw_rate_rad_s * back
        dx = post[0] - motion.x_m - motion.vx_m_s * back
        dy = post[1] - motion.y_m - motion.vy_m_s * back
        seen.append((math.cos(yaw) * dx + math.sin(yaw) * dy, math.cos(yaw) * dy - math.sin(yaw) * dx))
    raw = points_at(seen)
    points = Points(raw.x_m, raw.y_m, raw.z_m, raw.range_m, times, raw.intensity, raw.actor, raw.step_rad)
    straight = motion.straightened(points, 0.1)
    assert straight.x_m == pytest.approx(np.full(11, seen[-1][0]), abs=1e-9)
    assert straight.y_m == pytest.approx(np.full(11, seen[-1][1]), abs=1e-9)


def test_nothing_seen_is_no_group_in_either_way() -> None:
    empty = points_of(View(Scan.empty(plan_of(10, 1.0, 0.0))), EVERYWHERE)
    assert len(segment(empty, TrackerOptions())) == 0
    assert len(segment(empty, TrackerOptions(segmentation="actor"))) == 0
    assert len(joined([])) == 0
    assert beam_step_rad(np.zeros(1)) == 0.0
