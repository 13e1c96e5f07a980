"""The caster against closed forms, and against triangles met in float64 one by one."""

from __future__ import annotations

import threading
import tracemalloc

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from emulator.casting import moving_cast, raycast, structures
from emulator.casting.hits import Aim
from emulator.casting.raycast import BLOCK, Caster, Hits
from emulator.world import triangles
from emulator.world.motion import Steady, Waypoints, rotation_matrix
from emulator.world.triangles import Geometry, checked
from tests.casting.builders import brute_force, bumpy_wall, fan, random_rays, scene_of
from tests.draws import cases

WALL = Steady(at_m=(8.0, 0.0, 0.0), pitch_deg=-90.0)


def cast(caster: Caster, direction: np.ndarray, origin: object = (0.0, 0.0, 0.0), t: object = 0.0) -> Hits:
    return caster.first_hits(np.asarray(origin, dtype=np.float64), direction, np.asarray(t, dtype=np.float64))


# ---------------------------------------------------------------- closed forms


def test_a_plane_across_the_axis_is_met_at_its_distance_over_the_cosine() -> None:
    caster = Caster(scene_of((triangles.plane(6.0, 60.0), WALL)))
    azimuth = np.radians(np.linspace(-90.0, 90.0, 361))
    hits = cast(caster, fan(361))
    seen = np.abs(np.tan(azimuth)) * 8.0 < 30.0
    np.testing.assert_allclose(hits.range_m[seen], 8.0 / np.cos(azimuth[seen]), rtol=1e-15)
    assert np.isnan(hits.range_m[~seen]).all()
    assert (hits.actor[seen] == 1).all()
    for name in ("body", "actor", "face", "material"):
        assert (getattr(hits, name)[~seen] == -1).all()
    np.testing.assert_allclose(hits.normal[seen], np.broadcast_to([-1.0, 0.0, 0.0], (seen.sum(), 3)), atol=1e-15)
    assert not hits.normal[~seen].any()
    assert not hits.inner.any()


def test_a_plane_is_seen_from_both_sides_with_the_normal_on_the_rays_side() -> None:
    caster = Caster(scene_of((triangles.plane(2.0, 2.0), Steady())))
    hits = cast(caster, np.array([[0.0, 0.0, -1.0], [0.0, 0.0, 1.0]]), [[0.1, 0.2, 3.0], [0.1, 0.2, -4.0]])
    np.testing.assert_array_equal(hits.range_m, [3.0, 4.0])
    np.testing.assert_array_equal(hits.normal, [[0.0, 0.0, 1.0], [0.0, 0.0, -1.0]])
    assert not hits.inner.any()


@pytest.mark.parametrize("incidence_deg", [0.0, 60.0, 89.0, 89.99])
def test_grazing_rays_meet_a_road_where_they_should(incidence_deg: float) -> None:
    caster = Caster(scene_of((triangles.plane(8000.0, 100.0), Steady())))
    sine, cosine = np.sin(np.radians(incidence_deg)), np.cos(np.radians(incidence_deg))
    hits = cast(caster, np.array([[sine, 0.0, -cosine]]), [[0.0, 0.0, 0.5]])
    assert hits.range_m[0] == pytest.approx(0.5 / cosine, rel=4e-16)


def test_a_sphere_is_met_within_the_error_of_its_facets() -> None:
    segments = 256
    caster = Caster(scene_of((triangles.sphere(2.0, segments), Steady(at_m=(10.0, 0.0, -2.0)))))
    direction = fan(301, 20.0)
    across = 10.0 * direction[:, 1]
    hits = cast(caster, direction)
    inside = np.abs(across) < 1.9
    want = 10.0 * direction[:, 0] - np.sqrt(4.0 - across**2)
    sagitta = 2.0 * (1.0 - np.cos(np.pi / segments))
    error = hits.range_m[inside] - want[inside]
    assert (error > -1e-9).all()
    assert (error < 2.0 * sagitta / np.sqrt(1.0 - (1.9 / 2.0) ** 2)).all()
    assert np.isnan(hits.range_m[np.abs(across) > 2.0]).all()


@given(
    yaw=st.floats(-180, 180), pitch=st.floats(-90, 90), roll=st.floats(-180, 180), seed=st.integers(0, 10_000),
    moving=st.booleans(),
)  # fmt: skip
@settings(max_examples=cases(60), deadline=None)
def test_a_turned_box_is_met_where_its_slabs_are(
    yaw: float, pitch: float, roll: float, seed: int, moving: bool
) -> None:
    size = np.array([4.5, 1.8, 1.5])
    at = np.array([12.0, -3.0, 1.0])
    velocity = (7.0, -2.0, 0.5) if moving else (0.0, 0.0, 0.0)
    caster = Caster(scene_of((triangles.box(*size), Steady(tuple(at), yaw, pitch, roll, velocity))))
    rng = np.random.default_rng(seed)
    times = rng.uniform(0.0, 0.5, 200)
    target = at + rng.normal(size=(200, 3)) + times[:, None] * np.asarray(velocity)
    direction = target / np.linalg.norm(target, axis=1)[:, None]
    hits = cast(caster, direction, t=times)

    rotation = rotation_matrix(yaw, pitch, roll)
    origin = -(at + times[:, None] * np.asarray(velocity)) @ rotation
    ray = direction @ rotation
    low, high = np.array([-size[0] / 2, -size[1] / 2, 0.0]), np.array([size[0] / 2, size[1] / 2, size[2]])
    with np.errstate(divide="ignore"):
        near, far = (low - origin) / ray, (high - origin) / ray
    enter, leave = np.minimum(near, far).max(axis=1), np.maximum(near, far).min(axis=1)
    met = leave > enter
    clear = np.abs(leave - enter) > 1e-4  # a ray along an edge may pass on either side
    np.testing.assert_array_equal(~np.isnan(hits.range_m[clear]), met[clear])
    both = met & ~np.isnan(hits.range_m)
    np.testing.assert_allclose(hits.range_m[both], enter[both], rtol=0, atol=1e-12)


# ---------------------------------------------------------------- coordinates


def rays_at_the_wall(count: int, seed: int, distance_m: float) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    origin = np.round(rng.uniform(-1.0, 1.0, (count, 3)) * 4096.0) / 4096.0 - [distance_m, 0.0, 0.0]
    target = np.column_stack([np.zeros(count), rng.uniform(-5.0, 5.0, (count, 2))])
    direction = target - origin
    return origin, direction / np.linalg.norm(direction, axis=1)[:, None]


@pytest.mark.parametrize("offset_m", [0.0, 1e2, 1e3, 1e4, 1e5, 5e5, 5e6])
@pytest.mark.parametrize("how", ["placed", "in the mesh", "moving"])
def test_coordinates_far_from_the_origin_cost_no_digit(offset_m: float, how: str) -> None:
    """Irregular wall, physics.md 6.2: distance of the plain float32 cast is 0.4 m wrong at 5e6 m."""
    points, faces = bumpy_wall(3)
    offset = np.array([offset_m, -offset_m, offset_m / 4.0])
    vertices = points + offset if how == "in the mesh" else points
    geometry = checked(vertices, faces, np.zeros(len(faces)), ("wall",), "wall")
    at = (0.0, 0.0, 0.0) if how == "in the mesh" else tuple(offset)
    velocity = (4.0, 2.0, -1.0) if how == "moving" else (0.0, 0.0, 0.0)
    caster = Caster(scene_of((geometry, Steady(at, velocity_m_s=velocity))))
    for distance_m in (10.0, 200.0):
        origin, direction = rays_at_the_wall(600, 5, distance_m)
        truth, triangle = brute_force(points[faces], origin, direction)
        shift = np.multiply(velocity, 0.5)
        hits = cast(caster, direction, origin + offset + shift, 0.5)
        np.testing.assert_allclose(hits.range_m, truth, rtol=0.0, atol=1e-9)
        assert (hits.face != triangle).mean() <= 2e-3  # rays through an edge


@pytest.mark.parametrize("velocity", [(0.0, 0.0, 0.0), (3.0, 1.0, 0.0)])
def test_a_mesh_with_utm_coordinates_may_be_turned(velocity: tuple[float, float, float]) -> None:
    points, faces = bumpy_wall(8)
    offset = np.array([5e5, 5e6, 100.0])
    geometry = checked(points + offset, faces, np.zeros(len(faces)), ("wall",), "wall")
    rotation = rotation_matrix(30.0)
    at = -(rotation @ offset)
    rest = np.asarray(rotation.astype(np.longdouble) @ offset.astype(np.longdouble) + at, dtype=np.float64)
    caster = Caster(scene_of((geometry, Steady(tuple(at), 30.0, velocity_m_s=velocity))))
    local, ray = rays_at_the_wall(600, 9, 10.0)
    truth, _ = brute_force(points[faces], local, ray)
    hits = cast(caster, ray @ rotation.T, local @ rotation.T + rest)
    np.testing.assert_allclose(hits.range_m, truth, rtol=0.0, atol=2e-9)  # one digit of 5e6 m is 9e-10


def test_groups_of_resting_bodies_kilometres_apart_keep_their_digits() -> None:
    points, faces = bumpy_wall(4)
    geometry = checked(points, faces, np.zeros(len(faces)), ("wall",), "wall")
    places = [(5e6, 0.0, 0.0), (5e6 + 4096.0, 0.0, 0.0), (5e6, 65536.0, 0.0)]
    caster = Caster(scene_of(*((geometry, Steady(at_m=place)) for place in places)))
    origin, direction = rays_at_the_wall(300, 6, 10.0)
    truth, _ = brute_force(points[faces], origin, direction)
    for number, place in enumerate(places):
        hits = cast(caster, direction, origin + place)
        np.testing.assert_allclose(hits.range_m, truth, rtol=0.0, atol=1e-9)
        assert (hits.body == number).all()
    # over the first group's border and through to the second one
    hits = cast(caster, np.array([[1.0, 0.0, 0.0]]), [[5e6 + 20.0, 0.3, 0.2]])
    assert hits.body[0] == 1
    assert hits.range_m[0] == pytest.approx(4096.0 - 20.0, abs=0.5)


def test_the_sensor_outside_the_sphere_of_the_scene_sees_as_sharply() -> None:
    points, faces = bumpy_wall(5)
    geometry = checked(points, faces, np.zeros(len(faces)), ("wall",), "wall")
    caster = Caster(scene_of((geometry, Steady())))
    origin, direction = rays_at_the_wall(400, 7, 5000.0)
    truth, triangle = brute_force(points[faces], origin, direction)
    hits = cast(caster, direction, origin)
    np.testing.assert_allclose(hits.range_m, truth, rtol=0.0, atol=1e-9)
    assert (hits.face != triangle).mean() <= 5e-3


# ---------------------------------------------------------------- motion


def test_a_receding_plate_is_met_where_it_is_at_each_rays_own_time() -> None:
    """LMS291: 361 beams in half a turn of 13.3 ms; one pose for all would be 0.667 m wrong."""
    wall = Steady(at_m=(20.0, 0.0, 0.0), pitch_deg=-90.0, velocity_m_s=(100.0, 0.0, 0.0))
    caster = Caster(scene_of((triangles.plane(40.0, 2000.0), wall)))
    direction = fan(361, 120.0)
    times = 4.0 + np.arange(361) * 0.01333 / 720.0
    hits = cast(caster, direction, t=times)
    np.testing.assert_allclose(hits.range_m, (20.0 + 100.0 * times) / direction[:, 0], rtol=1e-14)


def moving_shapes() -> list[tuple[Geometry, object]]:
    return [
        (triangles.box(4.0, 2.0, 1.5), Steady((9.0, 2.0, -0.5), 30.0, 5.0, -3.0, (8.0, -3.0, 0.2))),
        (triangles.sphere(1.0, 24), Steady((6.0, -3.0, -1.0), yaw_rate_deg_s=360.0, velocity_m_s=(0.0, 5.0, 0.0))),
        (
            triangles.cylinder(0.5, 3.0, 20),
            Waypoints.through(
                [0.0, 0.1, 0.3], [(5.0, 5.0, -1.0), (5.0, 3.0, -1.0), (7.0, 3.0, -1.0)],
                [(0.0, 0.0, 0.0), (90.0, 20.0, 0.0), (200.0, 0.0, 45.0)],
            ),
        ),
        (
            triangles.box(1.0, 1.0, 3.0),
            Waypoints.through(
                [0.0, 0.07], [(4.0, -1.0, -1.0), (4.0, 1.0, -1.0)], [(0.0, 0.0, 0.0)] * 2, loop=True
            ),
        ),
        (triangles.plane(30.0, 30.0), Steady((0.0, 0.0, -1.0))),
    ]  # fmt: skip


def test_rays_moved_into_a_bodys_frame_meet_what_a_rebuilt_scene_has() -> None:
    shapes = moving_shapes()
    caster = Caster(scene_of(*shapes))
    direction = fan(150, 170.0, -2.0)
    for time in (0.0, 0.033, 0.0999, 0.1, 0.25, 0.31):
        rebuilt = []
        for geometry, motion in shapes:
            pose = motion.pose(np.array([time]))
            vertices = geometry.vertices @ pose.rotation[0].T + pose.position_m[0]
            rebuilt.append((checked(vertices, geometry.faces, geometry.face_part, geometry.parts, "x"), Steady()))
        moved = cast(caster, direction, t=time)
        truth = cast(Caster(scene_of(*rebuilt)), direction, t=time)
        same = moved.face == truth.face
        assert same.mean() > 0.98
        np.testing.assert_array_equal(np.isnan(moved.range_m), np.isnan(truth.range_m))
        np.testing.assert_allclose(moved.range_m[same], truth.range_m[same], rtol=0.0, atol=1e-9)
        np.testing.assert_allclose(moved.normal[same], truth.normal[same], rtol=0.0, atol=1e-9)
        np.testing.assert_array_equal(moved.actor[same], truth.actor[same])


def test_each_ray_has_its_own_time_whatever_moves_meanwhile() -> None:
    caster = Caster(scene_of(*moving_shapes()))
    direction = fan(721, 170.0, -2.0)
    times = np.linspace(0.02, 0.16, 721)  # over waypoints, a turn and a jump
    together = cast(caster, direction, t=times)
    for index in range(0, 721, 13):
        alone = cast(caster, direction[index : index + 1], t=times[index])
        assert together.body[index] == alone.body[0]
        np.testing.assert_allclose(together.range_m[index], alone.range_m[0], rtol=1e-14)


def test_what_rests_is_met_alike_merged_or_in_its_own_slot(monkeypatch: pytest.MonkeyPatch) -> None:
    box, ball = triangles.box(2.0, 1.0, 1.0), triangles.sphere(0.7, 20)
    shapes = [(box, Steady((6.0 + k, 2.0 * k - 4.0, -0.4), 20.0 * k)) for k in range(5)]
    shapes += [(ball, Steady((4.0, 1.0 * k - 2.0, -0.7))) for k in range(4)]
    merged = Caster(scene_of(*shapes))
    monkeypatch.setattr(structures, "MOST_MERGED", 0)
    slots = Caster(scene_of(*shapes))
    direction = fan(1000)
    one, other = cast(merged, direction), cast(slots, direction)
    np.testing.assert_array_equal(one.body, other.body)
    np.testing.assert_allclose(one.range_m, other.range_m, rtol=0.0, atol=1e-12)


@given(seed=st.integers(0, 100_000))
@settings(max_examples=cases(10), deadline=None)
def test_leaving_out_what_no_ray_can_touch_changes_nothing(seed: int) -> None:
    rng = np.random.default_rng(seed)
    shapes = []
    for _ in range(int(rng.integers(3, 60))):
        geometry = [triangles.box(1.0, 2.0, 1.0), triangles.sphere(0.8, 8), triangles.cylinder(0.3, 2.0, 6)]
        at, velocity = rng.normal(size=3) * 30.0, rng.normal(size=3) * 20.0
        motion = Steady(tuple(at), *rng.uniform(-90, 90, 3), tuple(velocity), float(rng.choice([0.0, 300.0])))
        shapes.append((geometry[int(rng.integers(3))], motion))
    scene = scene_of(*shapes)
    caster = Caster(scene)
    count = int(rng.integers(1, 150))
    origin, direction = random_rays(count, seed, float(rng.choice([0.0, 0.5, 20.0])))
    if rng.random() < 0.5:
        direction = direction[np.argsort(np.arctan2(direction[:, 1], direction[:, 0]))]
    times = rng.uniform(0.0, 1.0) + np.linspace(0.0, float(rng.choice([0.0, 0.02, 1.0])), count)
    hits = caster.first_hits(origin, direction, times)
    nearest = np.full(count, np.inf)
    for geometry, motion in shapes:
        pose = motion.pose(times)
        local = np.einsum("nji,nj->ni", pose.rotation, origin - pose.position_m)
        ray = np.einsum("nji,nj->ni", pose.rotation, direction)
        nearest = np.minimum(nearest, brute_force(geometry.vertices[geometry.faces], local, ray)[0])
    found = np.where(np.isnan(hits.range_m), 1e9, hits.range_m)
    differ = np.abs(found - np.minimum(nearest, 1e9)) > 1e-9
    assert differ.sum() <= 1, np.flatnonzero(differ)  # a ray along a silhouette


# ---------------------------------------------------------------- delicate rays


@pytest.mark.parametrize(
    "motion", [Steady(), Steady((0.3, 0.2, 0.1), 30.0, 10.0, 5.0), Steady((0.3, 0.2, 0.1), 30.0, 0.0, 0.0, (1.0, 0, 0))]
)
def test_rays_aimed_at_shared_edges_do_not_slip_into_a_closed_mesh(motion: Steady) -> None:
    ball = triangles.sphere(1.0, 64)
    caster = Caster(scene_of((ball, motion)))
    rng = np.random.default_rng(11)
    pose = motion.pose(np.zeros(1))
    vertices = ball.vertices @ pose.rotation[0].T + pose.position_m[0]
    face, corner, share = rng.integers(0, len(ball.faces), 60_000), rng.integers(0, 3, 60_000), rng.random(60_000)
    a = vertices[ball.faces[face, corner]]
    b = vertices[ball.faces[face, (corner + 1) % 3]]
    target = a + share[:, None] * (b - a)
    middle = vertices.mean(axis=0)
    outwards = (target - middle) / np.linalg.norm(target - middle, axis=1)[:, None]
    origin = target + 20.0 * outwards + rng.normal(size=(60_000, 3)) * 4.0  # from above the edge, not across it
    way = np.linalg.norm(target - origin, axis=1)
    hits = caster.first_hits(origin, (target - origin) / way[:, None], 0.0)
    assert caster.counters.leaks <= 1e-3 * 60_000  # before the second cast; 8 % without embree's robust flag
    assert np.isnan(hits.range_m).mean() <= 1e-4
    assert hits.inner.mean() <= 1e-4
    assert (np.abs(hits.range_m - way) > 1e-6).mean() <= 1e-4


@pytest.mark.parametrize("inside", [None, [-1], [1]])
def test_a_ray_that_slipped_between_triangles_is_cast_again(
    monkeypatch: pytest.MonkeyPatch, inside: list[int] | None
) -> None:
    caster = Caster(scene_of((triangles.box(2.0, 2.0, 2.0), Steady((5.0, 0.0, -1.0)))))
    real = Caster._nearest
    calls = []

    def slips_once(self: Caster, origin: np.ndarray, aim: Aim, times: np.ndarray, far: float) -> object:
        calls.append(aim.ray)
        shifted = origin + 3.0 * aim.ray if len(calls) == 1 else origin  # begins behind the front: meets the far side
        found = real(self, shifted, aim, times, far)
        if len(calls) == 1:
            found.range_m += 3.0
            found.range_m += 2.0 * (found.range_m < 4.5)
        return found

    monkeypatch.setattr(Caster, "_nearest", slips_once)
    direction = np.array([[1.0, 0.01, 0.02]]) / np.sqrt(1.0005)
    monkeypatch.setattr(Caster, "_is_inner", lambda self, found: np.full(len(found.range_m), len(calls) == 1))
    known = None if inside is None else np.array(inside)
    hits = caster.first_hits(np.zeros(3), direction, 0.0, inside=known)
    assert caster.counters.leaks == 1
    assert hits.range_m[0] == pytest.approx(4.0 / direction[0, 0], abs=1e-12)
    assert not hits.inner[0]
    assert np.arccos(np.clip((calls[0] * calls[1]).sum(), -1, 1)) == pytest.approx(1e-6, rel=1e-2)


def test_a_sensor_inside_an_object_sees_its_inner_faces() -> None:
    caster = Caster(scene_of((triangles.box(6.0, 4.0, 3.0), Steady())))
    _, direction = random_rays(2000, 13)
    hits = cast(caster, direction, [0.5, -0.5, 1.0])
    with np.errstate(divide="ignore"):
        want = np.maximum(([3.0, 2.0, 3.0] - np.array([0.5, -0.5, 1.0])) / direction,
                          ([-3.0, -2.0, 0.0] - np.array([0.5, -0.5, 1.0])) / direction).min(axis=1)  # fmt: skip
    np.testing.assert_allclose(hits.range_m, want, rtol=1e-12)
    assert hits.inner.all()
    assert caster.counters.leaks == 0
    assert (np.einsum("ij,ij->i", hits.normal, direction) < 0.0).all()


def test_rays_known_to_begin_in_a_body_are_cast_once_where_they_meet_its_inside() -> None:
    scene = scene_of((triangles.box(6.0, 4.0, 3.0), Steady()), (triangles.box(1.0, 1.0, 1.0), Steady((20.0, 0.0, 0.0))))
    _, direction = random_rays(2 * BLOCK, 13)
    found = []
    for inside, times in (
        (None, 2),
        (np.full(2 * BLOCK, -1), 2),
        (np.full(2 * BLOCK, 1), 2),
        (np.zeros(2 * BLOCK, int), 1),
    ):
        caster = Caster(scene)
        found.append(caster.first_hits(np.array([0.5, -0.5, 1.0]), direction, 0.0, inside=inside))
        assert caster.counters.cast == times * len(direction)
    for name in ("range_m", "body", "normal", "inner", "cosine"):
        for other in found[1:]:
            np.testing.assert_array_equal(getattr(other, name), getattr(found[0], name))
    assert found[0].inner.all()


def test_bodies_of_some_rays_are_those_of_the_hits() -> None:
    caster = Caster(
        scene_of((triangles.box(2.0, 2.0, 2.0), Steady((5.0, 0.0, -1.0))), (triangles.plane(6.0, 60.0), WALL))
    )
    direction = np.tile(fan(361), (200, 1))  # of more blocks than one
    hits = caster.first_hits(np.zeros(3), direction, 0.0, max_range_m=20.0)
    rays = np.arange(len(direction))[::-7]
    assert set(hits.body) == {-1, 0, 1}
    np.testing.assert_array_equal(hits.bodies(rays), hits.body[rays])


@pytest.mark.parametrize("half_width_m", [1e-3, 1e-5, 1e-7])
def test_a_sliver_is_hit_by_the_share_of_rays_that_it_fills(half_width_m: float) -> None:
    w = half_width_m
    vertices = np.array([[100.0, -w, -1.0], [100.0, w, -1.0], [100.0, 0.0, 1.0]])
    caster = Caster(scene_of((checked(vertices, np.array([[0, 1, 2]]), np.zeros(1), ("wire",), "wire"), Steady())))
    rng = np.random.default_rng(17)
    target = np.column_stack([np.full(40_000, 100.0), rng.uniform(-2 * w, 2 * w, 40_000), rng.uniform(-1, 1, 40_000)])
    origin = np.column_stack([np.zeros(40_000), target[:, 1], target[:, 2]])  # parallel rays
    hits = caster.first_hits(origin, np.broadcast_to([1.0, 0.0, 0.0], (40_000, 3)), 0.0)
    assert (hits.body == 0).mean() == pytest.approx(0.25, abs=0.01)
    np.testing.assert_allclose(hits.range_m[hits.body == 0], 100.0, rtol=1e-9)


def test_a_plane_that_cannot_be_trusted_leaves_the_casters_own_distance() -> None:
    caster = Caster(scene_of((triangles.plane(6.0, 60.0), WALL)))
    caster._table.plane[:, 3] += 5.0
    hits = cast(caster, fan(3, 2.0))
    np.testing.assert_allclose(hits.range_m, 8.0 / fan(3, 2.0)[:, 0], rtol=1e-6)
    assert caster.counters.suspicious == 3


# ---------------------------------------------------------------- the interface


def test_an_empty_scene_gives_misses_only() -> None:
    hits = cast(Caster(scene_of()), fan(11))
    assert np.isnan(hits.range_m).all()
    assert (hits.body == -1).all()
    assert len(hits) == 11


def test_no_ray_is_a_legal_cast() -> None:
    hits = Caster(scene_of((triangles.plane(6.0, 60.0), WALL))).first_hits(np.zeros((0, 3)), np.zeros((0, 3)), 0.0)
    assert len(hits) == 0
    assert hits.normal.shape == (0, 3)


def test_parts_of_a_mesh_have_their_own_materials() -> None:
    vertices = np.array([[5.0, -1.0, -1.0], [5.0, 1.0, -1.0], [5.0, 1.0, 1.0], [5.0, -1.0, 1.0]])
    faces = np.array([[0, 1, 2], [0, 2, 3]])
    geometry = checked(vertices, faces, np.array([1, 0]), ("upper", "lower"), "x")
    for motion in (Steady(), Steady(velocity_m_s=(0.0, 0.0, 1e-9))):
        scene = scene_of((triangles.plane(1.0, 1.0), Steady((0.0, 0.0, -9.0))), (geometry, motion))
        direction = np.array([[5.0, 0.5, -0.5], [5.0, -0.5, 0.5]])
        hits = cast(Caster(scene), direction / np.linalg.norm(direction, axis=1)[:, None])
        assert [scene.materials[index] for index in hits.material] == ["lower", "upper"]
        np.testing.assert_array_equal(hits.face, [0, 1])
        np.testing.assert_array_equal(hits.actor, [2, 2])


def test_nearer_hits_than_tnear_are_passed_by() -> None:
    walls = [(triangles.plane(6.0, 6.0), Steady((x, 0.0, 0.0), pitch_deg=-90.0)) for x in (2.0, 4.0, 6.0)]
    caster = Caster(scene_of(*walls))
    direction = np.broadcast_to([1.0, 0.0, 0.0], (3, 3))
    hits = caster.first_hits(np.zeros(3), direction, 0.0, tnear_m=np.array([0.0, 2.5, 4.5]))
    np.testing.assert_allclose(hits.range_m, [2.0, 4.0, 6.0], rtol=1e-15)


def test_hits_beyond_the_longest_range_are_misses() -> None:
    walls = [(triangles.plane(6.0, 6.0), Steady((4.0, 0.0, 0.0), pitch_deg=-90.0))]
    walls += [(triangles.plane(6.0, 6.0), Steady((5.0, 0.0, 0.0), pitch_deg=-90.0, velocity_m_s=(0.0, 0.1, 0.0)))]
    caster = Caster(scene_of(*walls))
    along = np.array([[1.0, 0.0, 0.0]])
    assert caster.first_hits(np.zeros(3), along, 0.0, max_range_m=4.5).range_m[0] == 4.0
    assert np.isnan(caster.first_hits(np.zeros(3), along, 0.0, max_range_m=3.9).range_m[0])
    moved = caster.first_hits(np.zeros(3), along, 0.0, bodies=[1], max_range_m=4.5)
    assert moved.body[0] == -1


def test_a_subset_of_bodies_hides_nothing_else() -> None:
    walls = [(triangles.plane(6.0, 6.0), Steady((x, 0.0, 0.0), pitch_deg=-90.0)) for x in (2.0, 4.0, 6.0)]
    caster = Caster(scene_of(*walls))
    along = np.array([[1.0, 0.0, 0.0]])
    for body, want in ((0, 2.0), (1, 4.0), (2, 6.0)):
        hits = caster.first_hits(np.zeros(3), along, 0.0, bodies=[body])
        assert (hits.range_m[0], hits.body[0], hits.actor[0]) == (want, body, body + 1)
    assert np.isnan(caster.first_hits(np.zeros(3), along, 0.0, bodies=[]).range_m[0])


def test_the_same_cast_gives_the_same_bits_in_any_company() -> None:
    caster = Caster(scene_of(*moving_shapes()))
    direction = np.tile(fan(501, 170.0, -2.0), (140, 1))
    assert len(direction) > 2 * BLOCK
    whole = cast(caster, direction, t=0.03)
    again = cast(caster, direction, t=0.03)
    part = cast(caster, direction[:501], t=0.03)
    for name in ("range_m", "body", "face", "normal"):
        np.testing.assert_array_equal(getattr(whole, name), getattr(again, name))
        np.testing.assert_array_equal(getattr(whole, name)[:501], getattr(part, name))
        np.testing.assert_array_equal(getattr(whole, name)[-501:], getattr(part, name))


def test_threads_may_share_a_caster() -> None:
    caster = Caster(scene_of(*moving_shapes()))
    direction = fan(2000, 170.0, -2.0)
    want = [cast(caster, direction, t=0.01 * k).range_m for k in range(6)]
    got: list[np.ndarray | None] = [None] * 6

    def run(k: int) -> None:
        got[k] = cast(caster, direction, t=0.01 * k).range_m

    threads = [threading.Thread(target=run, args=(k,)) for k in range(6)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    for one, other in zip(want, got, strict=True):
        np.testing.assert_array_equal(one, other)


# ---------------------------------------------------------------- rays that come again


def crowd(seed: int) -> tuple[Caster, Caster, np.ndarray, np.ndarray, float]:
    """Two casters of the same random bodies, some of which move, rays among them, and how far these look."""
    rng = np.random.default_rng(seed)
    shapes = [(triangles.plane(80.0, 80.0), Steady((0.0, 0.0, -3.0)))] if rng.random() < 0.5 else []
    for k in range(int(rng.integers(1, 30))):
        geometry = [triangles.box(1.0, 2.0, 1.0), triangles.sphere(1.8, 8)][k % 2]
        at, velocity = rng.normal(size=3) * 6.0, rng.normal(size=3) * float(rng.choice([0.0, 20.0]))
        shapes.append((geometry, Steady(tuple(at), *rng.uniform(-90, 90, 3), tuple(velocity))))
    caster, fresh = (Caster(scene_of(*shapes)) for _ in range(2))
    origin, direction = random_rays(int(rng.choice([3, 500, 9000])), seed, 0.5)
    far = float(rng.choice([np.inf, 7.0]))
    return caster, fresh, origin, direction, far


@given(seed=st.integers(0, 100_000))
@settings(max_examples=cases(10), deadline=None)
def test_rays_that_come_again_meet_bit_by_bit_what_they_would_meet_anew(seed: int) -> None:
    caster, fresh, origin, direction, far = crowd(seed)
    for t_s in (0.0, 0.3, 0.3, 0.6):
        times = t_s + np.linspace(0.0, 0.1, len(origin))
        got = caster.first_hits(origin, direction, times, max_range_m=far, again=True)
        want = fresh.first_hits(origin, direction, times, max_range_m=far)
        for name in vars(Hits.misses(0)):
            np.testing.assert_array_equal(getattr(got, name), getattr(want, name), err_msg=name)


def test_rays_that_come_again_are_cast_on_nothing_that_rests() -> None:
    car = (triangles.box(4.0, 2.0, 1.5), Steady((5.0, -20.0, -0.7), velocity_m_s=(0.0, 10.0, 0.0)))
    caster = Caster(scene_of((triangles.plane(60.0, 60.0), WALL), car))
    direction, origin = fan(720, 120.0), np.zeros((720, 3))
    far_away = [caster.first_hits(origin, direction, t_s, again=True) for t_s in (-1.0, -0.9)]
    assert caster.counters.cast == 720
    assert far_away[0] is far_away[1]
    with pytest.raises(ValueError, match="read-only"):
        far_away[0].range_m[0] = 0.0
    near = caster.first_hits(origin, direction, 2.0, again=True)
    assert 720 < caster.counters.cast < 1200
    assert set(near.actor) == {1, 2}


@given(seed=st.integers(0, 100_000))
@settings(max_examples=cases(10), deadline=None)
def test_directions_that_come_again_from_elsewhere_meet_what_new_ones_would(seed: int) -> None:
    caster, fresh, origin, direction, far = crowd(seed)
    for t_s in (0.0, 0.3, 0.6):
        times = t_s + np.linspace(0.0, 0.1, len(origin))
        got = caster.first_hits(origin + t_s, direction, times, max_range_m=far, aimed=True)
        want = fresh.first_hits(origin + t_s, direction, times, max_range_m=far)
        for name in vars(Hits.misses(0)):
            np.testing.assert_array_equal(getattr(got, name), getattr(want, name), err_msg=name)


def test_directions_kept_are_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(raycast, "FAN_RAYS_KEPT", 1000)
    caster = Caster(scene_of((triangles.plane(60.0, 60.0), WALL)))
    for k in range(9):
        caster.first_hits(np.zeros((300, 3)), fan(300, 100.0 + k), 0.0, aimed=True)
    assert sum(len(direction) for direction, _ in caster._aimed) == 900


def test_bodies_behind_a_wall_are_not_looked_at_ray_by_ray(monkeypatch: pytest.MonkeyPatch) -> None:
    moving = {"velocity_m_s": (0.0, 0.001, 0.0)}
    shapes = [(triangles.sphere(2.0, 8), Steady((x, 0.0, -2.0), **moving)) for x in (5.0, 30.0)]
    caster = Caster(scene_of((triangles.plane(60.0, 60.0), WALL), *shapes))
    looked: list[int] = []
    real = moving_cast.may_meet
    monkeypatch.setattr(moving_cast, "may_meet", lambda *rest: looked.extend(
        np.unique((found := real(*rest))[0])) or found)  # fmt: skip
    hits = cast(caster, fan(2000, 60.0))
    assert set(hits.actor) == {1, 2}
    assert looked == [0]


def test_rays_kept_are_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(raycast, "FAN_RAYS_KEPT", 1000)
    caster = Caster(scene_of((triangles.plane(60.0, 60.0), WALL)))
    for k in range(9):
        caster.first_hits(np.zeros((300, 3)), fan(300, 100.0 + k), 0.0, again=True)
    assert sum(len(fan_.direction) for fan_ in caster._fans) == 900


@pytest.mark.parametrize(("form", "name"), [("again", "_fans"), ("aimed", "_aimed")])
def test_fans_kept_are_bounded_also_where_they_are_small(form: str, name: str) -> None:
    """A rotor that turns freely never casts the same fan again."""
    caster = Caster(scene_of((triangles.plane(60.0, 60.0), WALL)))
    for k in range(raycast.FANS_KEPT + 5):
        caster.first_hits(np.zeros((30, 3)), fan(30, 100.0 + 0.1 * k), 0.0, **{form: True})
    assert len(getattr(caster, name)) == raycast.FANS_KEPT


# ---------------------------------------------------------------- cost


def test_equal_moving_bodies_are_stored_once() -> None:
    ball = triangles.sphere(1.0, 64)
    shapes = [(ball, Steady((10.0 * k, 0.0, 0.0), velocity_m_s=(1.0, 0.0, 0.0))) for k in range(1000)]
    caster = Caster(scene_of(*shapes))
    assert len(caster._table) == len(ball.faces)
    hits = cast(caster, np.array([[0.0, 0.0, -1.0]]), [[5000.0 + 2.0, 0.0, 9.0]], t=2.0)
    assert hits.actor[0] == 501


def test_a_cast_needs_no_more_memory_than_a_few_numbers_a_ray() -> None:
    caster = Caster(scene_of(*moving_shapes()))
    direction = np.tile(fan(501, 170.0, -2.0), (60, 1))
    cast(caster, direction)
    tracemalloc.start()
    cast(caster, direction)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 15e6  # 30 060 rays: 57 bytes of hits each, the rest by blocks


def test_another_caster_clears_no_memory_that_is_kept() -> None:
    scene = scene_of((triangles.plane(60.0, 60.0), WALL))
    Caster(scene)
    tracemalloc.start()
    Caster(scene)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 1e6
