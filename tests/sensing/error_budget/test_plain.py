"""One ray for beams that see one plane: what is left out cannot be seen, and a wrong bound is."""

from __future__ import annotations

from functools import cache, lru_cache
from typing import Any

import numpy as np
import pytest

from emulator.casting import raycast
from emulator.scenario import scenario
from emulator.sensing.measure import Measure
from emulator.sensing.measure import build as build_measure
from emulator.sensors.physics_options import LeaveOut
from emulator.world import scene, triangles
from emulator.world.motion import Steady
from emulator.world.outlines import outline, outlines_of
from emulator.world.scene import Scene
from tests.draws import cases
from tests.sensing.error_budget.scenes import (
    MODELS,
    Tally,
    body,
    compared,
    full_against_pruned,
    measure_of,
    plan,
    random_scene,
    same,
    tally,
)

SHIPPED = scenario.builtin_names()


@pytest.mark.parametrize("part", range(5))
def test_random_scenes_in_random_weather_are_the_same_full_and_pruned(part: int) -> None:
    """`cases` of sixty; `python -m tests.sensing.error_budget.many` compares a thousand."""
    found = sum((full_against_pruned(seed) for seed in range(12 * part, 12 * part + cases(12))), Tally())
    assert found.plain > 0.2 * found.beams
    assert found.plain_differ == 0
    assert found.differ <= 1e-3 * found.beams


def test_a_bound_that_is_too_small_shows() -> None:
    found = (tally(*compared(random_scene(seed), MODELS[seed % 3], plan(), plain_radii=0.5)) for seed in range(30))
    assert any(one.plain_differ for one in found)


shipped = cache(scenario.load)


@lru_cache(maxsize=2)
def world_of(name: str) -> Scene:
    """The same for every sensor, and read only."""
    return scene.build(shipped(name))


def of_file(name: str, model: str, **physics_: Any) -> Measure:
    loaded = shipped(name)
    makers = ("sick", "paper", "hokuyo", "velodyne", "ouster", "hesai", "rplidar", "ldrobot", "ydlidar", "solid-state")
    config = next(sensor for sensor in loaded.sensors if sensor.model.startswith(makers))
    physics = config.physics.model_copy(update=physics_)
    config = config.model_copy(update={"physics": physics, "model": model, "device": {}})
    loaded = loaded.model_copy(update={"sensors": (config,)})
    world = world_of(name)
    return build_measure(loaded, world, raycast.Caster(world), config.id)


@pytest.mark.parametrize("model", ["sick-ld-lrs1000", "sick-lms291-s05"])
@pytest.mark.parametrize("name", SHIPPED)
def test_shipped_scenarios_are_the_same_full_and_pruned(name: str, model: str) -> None:
    choice = "auto" if model == "sick-lms291-s05" else "always"
    one = of_file(name, model, leave_out=LeaveOut.model_validate({"closed_form": choice}))
    other = of_file(name, model, full=True)
    found = sum((tally(*same(one, other, plan(361, 90.0, 0.1, sweep))) for sweep in range(2)), Tally())
    assert found.plain_differ == 0
    assert found.differ <= 1e-3 * found.beams + 1.0


def test_a_wall_costs_one_ray_a_beam_and_none_once_it_is_known() -> None:
    wall = body(0, triangles.box(1.0, 100.0, 100.0), 0, Steady(at_m=(20.0, 0.0, -50.0)))
    world = Scene(("world",), ("unknown",), (Steady(),), ("asphalt",), (wall,))
    measure = measure_of(world, "sick-ld-lrs1000")
    assert measure.view(plan()).cast == len(plan())
    assert measure.view(plan(sweep=1)).cast == 0
    whole = measure_of(world, "sick-ld-lrs1000", full=True)
    assert whole.view(plan()).cast == 61 * len(plan())


def test_only_edges_that_bend_end_or_change_material_count() -> None:
    box = triangles.box(1.0, 2.0, 3.0)
    found = outline(box, np.zeros(len(box.faces), np.int32))
    assert len(found.start_m) == 12  # not the diagonals
    assert len(found.low_m) == 1
    plate = triangles.plane(1.0, 1.0)
    assert len(outline(plate, np.zeros(2, np.int32)).start_m) == 4
    assert len(outline(plate, np.array([0, 1], np.int32)).start_m) == 5


def test_surfaces_that_pass_through_each_other_without_an_edge_in_the_beam_are_found() -> None:
    """Two plates cross on the axis of the beam: no edge is near, only their boxes are."""
    one = body(0, triangles.plane(40.0, 40.0), 0, Steady(at_m=(20.0, 0.0, 0.0), yaw_deg=30.0, pitch_deg=-90.0))
    two = body(0, triangles.plane(40.0, 40.0), 0, Steady(at_m=(20.0, 0.0, 0.0), yaw_deg=-30.0, pitch_deg=-90.0))
    world = Scene(("world",), ("unknown",), (Steady(),), ("asphalt",), (one, two))
    at_axis = plan(3, 0.02, 0.0)
    equal, plain = compared(world, "sick-ld-lrs1000", at_axis)
    assert not bool(plain[1])
    assert bool(equal.all())


def test_what_lies_hidden_behind_a_wall_does_not_make_a_beam_mixed() -> None:
    wall = body(0, triangles.box(1.0, 100.0, 100.0), 0, Steady(at_m=(20.0, 0.0, -50.0)))
    posts = [body(0, triangles.cylinder(0.1, 4.0, 12), 0, Steady(at_m=(30.0, 0.5 * y, -2.0))) for y in range(-40, 41)]
    world = Scene(("world",), ("unknown",), (Steady(),), ("asphalt",), (wall, *posts))
    assert len(outlines_of(world)) > 81 * 24
    equal, plain = compared(world, "sick-ld-lrs1000", plan())
    assert bool(plain.all())
    assert bool(equal.all())
