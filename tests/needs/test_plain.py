"""One ray for beams that see one plane: what is left out cannot be seen, and a wrong bound is."""

from __future__ import annotations

import numpy as np
import pytest

from emulator import raycast, scenario, scene, sensing, triangles
from emulator.motion import Steady
from emulator.outlines import outline, outlines_of
from emulator.physics_options import LeaveOut
from emulator.scene import Scene
from emulator.sensing.measure import Measure
from tests.needs.scenes import body, compared, measure_of, plan, random_scene, same

MODELS = ("sick-ld-lrs1000", "sick-lms291-s05", "paper-905nm")
SHIPPED = ("flat_wall", "street", "crossing_car", "two_sensors", "bumper", "gltf_yard")


def shares(seeds: range, **options: float) -> tuple[int, int, int, int]:
    """Beams, beams that differ, plain beams, plain beams that differ."""
    count = np.zeros(4, np.int64)
    for seed in seeds:
        equal, plain = compared(random_scene(seed), MODELS[seed % 3], plan(), **options)
        count += (len(equal), np.count_nonzero(~equal), np.count_nonzero(plain), np.count_nonzero(plain & ~equal))
    return int(count[0]), int(count[1]), int(count[2]), int(count[3])


@pytest.mark.parametrize("part", range(10))
def test_random_scenes_are_the_same_with_one_ray_for_plain_beams(part: int) -> None:
    beams, differ, plain, plain_differ = shares(range(100 * part, 100 * part + 100))
    assert plain > 0.2 * beams
    assert plain_differ == 0
    assert differ <= 1e-3 * beams


def test_a_bound_that_is_too_small_shows() -> None:
    _, _, _, differ = shares(range(60), plain_radii=0.5)
    assert differ > 0


def of_file(name: str, model: str, choice: str) -> Measure:
    loaded = scenario.load(name)
    config = next(sensor for sensor in loaded.sensors if sensor.model.startswith(("sick", "paper")))
    physics = config.physics.model_copy(update={"leave_out": LeaveOut.model_validate({"closed_form": choice})})
    config = config.model_copy(update={"physics": physics, "model": model, "device": {}})
    loaded = loaded.model_copy(update={"sensors": (config,)})
    world = scene.build(loaded)
    return sensing.build(loaded, world, raycast.Caster(world), config.id)


@pytest.mark.parametrize("name", SHIPPED)
@pytest.mark.parametrize("model", ["sick-ld-lrs1000", "sick-lms291-s05"])
def test_shipped_scenarios_are_the_same_with_one_ray_for_plain_beams(name: str, model: str) -> None:
    one, other = of_file(name, model, "always"), of_file(name, model, "never")
    for sweep in range(2):
        equal, plain = same(one, other, plan(361, 90.0, 0.1, sweep))
        assert bool(equal[plain].all())
        assert np.count_nonzero(~equal) <= 1e-3 * len(equal)


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
