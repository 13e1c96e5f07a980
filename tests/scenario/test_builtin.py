"""The scenarios that come with the package: they load, build, and show what they say."""

from __future__ import annotations

import numpy as np
import pytest

from emulator.casting.raycast import Caster, Hits
from emulator.scenario.scenario import builtin_names, builtin_summary, load
from emulator.world import scene


def look(name: str, t_s: float, beams: int = 361) -> tuple[scene.Scene, Hits, np.ndarray]:
    """What the first sensor of a scenario meets in one planar sweep at a time."""
    config = load(name)
    world = scene.build(config)
    pose = world.sensor_pose(config.sensors[0].mount, np.array([t_s]))
    azimuth = np.radians(np.linspace(-90.0, 90.0, beams))
    direction = np.column_stack([np.cos(azimuth), np.sin(azimuth), 0.0 * azimuth]) @ pose.rotation[0].T
    return world, Caster(world).first_hits(pose.position_m[0], direction, t_s), azimuth


def test_at_least_four_ship_and_each_says_in_a_sentence_what_it_shows() -> None:
    assert {"flat_wall", "crossing_car", "street", "gltf_yard", "two_sensors"} <= set(builtin_names())
    for name in builtin_names():
        assert builtin_summary(name).endswith(".")
        assert 20 < len(builtin_summary(name)) < 200


@pytest.mark.parametrize("name", builtin_names())
def test_every_one_builds_without_a_warning_and_has_a_link_a_sensor(name: str) -> None:
    config = load(name)
    world = scene.build(config)
    assert world.warnings == ()
    assert all(sensor.links for sensor in config.sensors)
    links = [link for sensor in config.sensors for link in sensor.links if not link.endswith(":0")]
    assert len(set(links)) == len(links)


def test_the_flat_wall_is_where_it_says() -> None:
    _, hits, azimuth = look("flat_wall", 3.0)
    seen = np.abs(np.tan(azimuth)) * 8.0 < 30.0
    np.testing.assert_allclose(hits.range_m[seen], 8.0 / np.cos(azimuth[seen]), rtol=1e-14)
    assert np.isnan(hits.range_m[~seen]).all()


def test_the_crossing_car_crosses() -> None:
    for time, middle in ((0.0, -20.0), (2.0, 0.0), (3.0, 10.0), (12.0, 0.0), (13.0, 10.0)):
        world, hits, azimuth = look("crossing_car", time)
        car = hits.actor == world.index["car"]
        y = hits.range_m[car] * np.sin(azimuth[car])
        assert y.mean() == pytest.approx(middle, abs=2.3)
        assert (hits.range_m[car] * np.cos(azimuth[car])).min() == pytest.approx(12.0 - 0.88, abs=0.1)


def test_the_street_has_its_actors_and_the_scanner_sees_many_of_them() -> None:
    world, hits, _ = look("street", 1.0)
    assert len(world.actors) >= 21
    assert len({id(body.geometry) for body in world.bodies}) >= 8
    assert len(set(hits.actor.tolist()) - {-1, 0}) >= 6
    assert world.actors[1] == "ego"
    assert not (hits.actor == 1).any()


def test_road_users_of_the_street_do_not_drive_through_each_other() -> None:
    config = load("street")
    world = scene.build(config)
    moving = [body for body in world.bodies if not body.motion.still]
    users = [body for body in world.bodies if body.actor and world.classes[body.actor] not in ("unknown",)]
    for time in np.arange(0.0, config.duration_s or 10.0, 0.25):
        boxes = {}
        for body in users:
            pose = body.motion.pose(np.array([time]))
            corners = body.vertices @ pose.rotation[0].T + pose.position_m[0]
            boxes[id(body)] = (corners.min(axis=0), corners.max(axis=0))
        for one in moving:
            for other in users:
                if one is other or id(one) not in boxes:
                    continue
                (low, high), (other_low, other_high) = boxes[id(one)], boxes[id(other)]
                apart = (low > other_high).any() or (high < other_low).any()
                assert apart, (time, world.actors[one.actor], world.actors[other.actor])


def test_the_yard_comes_from_one_file_with_several_materials() -> None:
    config = load("gltf_yard")
    assert [item.mesh for item in config.world] == ["meshes/yard.glb"]
    world, hits, _ = look("gltf_yard", 4.0)
    assert len({world.materials[index] for index in hits.material if index >= 0}) >= 3
    assert (hits.actor == world.index["forklift"]).any()


def test_two_sensors_look_ahead_and_back_from_a_moving_vehicle() -> None:
    config = load("two_sensors")
    world = scene.build(config)
    caster = Caster(world)
    ahead = []
    for sensor in config.sensors:
        pose = world.sensor_pose(sensor.mount, np.array([4.0]))
        forward = pose.rotation[0][:, 0]
        ahead.append(float(caster.first_hits(pose.position_m[0], forward[None], 4.0).range_m[0]))
    assert ahead == pytest.approx([189.9 - 20.5, 20.0 - 0.5 + 9.9], abs=1e-9)


def test_the_cola_yard_has_three_scanners_of_today_and_each_sees_what_moves() -> None:
    config = load("cola_yard")
    assert [sensor.model for sensor in config.sensors] == ["sick-lms111", "sick-tim571", "sick-mrs1104"]
    world = scene.build(config)
    seen = set()
    for sensor in config.sensors:
        pose = world.sensor_pose(sensor.mount, np.array([4.0]))
        azimuth = np.radians(np.arange(-90.0, 90.0, 0.5))
        direction = np.column_stack([np.cos(azimuth), np.sin(azimuth), 0.0 * azimuth]) @ pose.rotation[0].T
        hits = Caster(world).first_hits(pose.position_m[0], direction, 4.0)
        seen |= {world.actors[index] for index in hits.actor if index > 0}
    assert {"fork_lift", "car", "worker"} <= seen


def test_the_desk_scanners_see_the_person_and_the_robot_does_not_see_itself() -> None:
    config = load("desk_scanners")
    assert [sensor.model for sensor in config.sensors] == ["ldrobot-ld19", "ydlidar-x4"]
    world = scene.build(config)
    for sensor in config.sensors:
        pose = world.sensor_pose(sensor.mount, np.array([3.5]))
        azimuth = np.radians(np.arange(-180.0, 180.0, 0.5))
        direction = np.column_stack([np.cos(azimuth), np.sin(azimuth), 0.0 * azimuth]) @ pose.rotation[0].T
        hits = Caster(world).first_hits(pose.position_m[0], direction, 3.5)
        assert {world.actors[index] for index in hits.actor if index > 0} == {"person"}
        assert np.isfinite(hits.range_m).all(), "a room on all sides"


def test_the_hokuyo_room_has_two_scanners_and_each_sees_the_person() -> None:
    config = load("hokuyo_room")
    assert [sensor.model for sensor in config.sensors] == ["hokuyo-utm-30lx", "hokuyo-urg-04lx"]
    world = scene.build(config)
    for sensor in config.sensors:
        pose = world.sensor_pose(sensor.mount, np.array([4.5]))
        azimuth = np.radians(np.arange(-120.0, 120.0, 0.5))
        direction = np.column_stack([np.cos(azimuth), np.sin(azimuth), 0.0 * azimuth]) @ pose.rotation[0].T
        hits = Caster(world).first_hits(pose.position_m[0], direction, 4.5)
        assert "person" in {world.actors[index] for index in hits.actor if index > 0}


def test_the_rplidar_room_has_two_scanners_and_each_sees_the_person() -> None:
    config = load("rplidar_room")
    assert [sensor.model for sensor in config.sensors] == ["rplidar-a1m8", "rplidar-s2m1"]
    world = scene.build(config)
    for sensor in config.sensors:
        pose = world.sensor_pose(sensor.mount, np.array([4.5]))
        azimuth = np.radians(np.arange(-180.0, 180.0, 0.5))
        direction = np.column_stack([np.cos(azimuth), np.sin(azimuth), 0.0 * azimuth]) @ pose.rotation[0].T
        hits = Caster(world).first_hits(pose.position_m[0], direction, 4.5)
        assert "person" in {world.actors[index] for index in hits.actor if index > 0}
