"""Whole scans by arrays and by compiled loops: random scenes, every shipped scenario, every example."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from emulator.casting import raycast
from emulator.judging import examples, plans
from emulator.scenario import scenario
from emulator.scenario.tables import Mount
from emulator.sensing import error_budget
from emulator.sensing.measure import Measure
from emulator.sensing.measure import build as build_measure
from emulator.sensors.physics_options import LeaveOut
from emulator.sensors.spec import load_spec
from emulator.world import scene
from emulator.world.motion import Waypoints
from protocols.scan import Scan, ScanPlan
from tests.compiled.both import both, differing
from tests.draws import DEEP
from tests.sensing.error_budget import scenes
from tests.sensing.rig import build, plate

pytest.importorskip("numba")

TIED = {110: 1}
"Seeds with rays that meet the edge of two triangles: either may be told."


def random_sweeps(seed: int, drives: bool, **options: object) -> list[Scan]:
    """Two sweeps of a random scene in random weather, from rest or from one of its moving bodies."""
    world, weather, model = scenes.random_scene(seed), scenes.random_weather(seed), scenes.MODELS[seed % 3]
    if seed % 4 == 1:  # some of the bodies turn, stop and jump
        t_s, at = (0.0, 0.015, 0.0151, 0.2), np.array(world.motions[-1].position(np.zeros(1))[0])
        places = [tuple(at + step) for step in ((0, 0, 0), (0.3, 0.1, 0), (0.3, 0.4, 0), (2.0, 0.4, 0.1))]
        path = Waypoints.through(t_s, places, [(0, 0, 0), (20, 0, 0), (20, 5, 0), (90, 0, 3)], seed % 8 == 1)
        *others, last = world.bodies
        bodies = (*others, dataclasses.replace(last, motion=path))
        world = dataclasses.replace(world, motions=(*world.motions[:-1], path), bodies=bodies)
    measure = scenes.measure_of(world, model, weather, **options)
    mover = next((k for k, motion in enumerate(world.motions) if not motion.still), None)
    if drives and mover is not None:
        mount = Mount(actor=world.actors[mover], at_m=(0.0, 0.0, 3.0))
        assert isinstance(measure._caster, raycast.Caster)
        parts = measure._caster, (measure._dry, measure._wet), measure.air, measure._receiver
        measure = Measure(measure.model, world, mount, *parts)
    return [measure(scenes.plan(sweep=sweep)) for sweep in range(2)]


@pytest.mark.parametrize("drives", [False, True])
@pytest.mark.parametrize("seed", [*range(40), 110] if DEEP else [*range(24), 110])
def test_random_scenes_are_measured_alike(seed: int, drives: bool) -> None:
    if not DEEP and seed < 24 and drives != (seed // 4 % 2 == 1):
        return  # half of them from rest, half driving; of both each kind of scene, weather and model
    if drives and all(motion.still for motion in scenes.random_scene(seed).motions):
        return  # nothing to drive on: the same as from rest
    for options in ({"leave_out": LeaveOut(closed_form="auto")}, {"full": True}):
        for one, other in zip(*both(lambda: random_sweeps(seed, drives, **options)), strict=True):  # noqa: B023
            assert len(differing(one, other)) <= TIED.get(seed, 0)


@pytest.mark.parametrize("model", scenes.MODELS)
@pytest.mark.parametrize("full", [False, True])
def test_what_comes_back_from_near_and_from_beyond_reach_is_the_same(tmp_path: Path, model: str, full: bool) -> None:
    """Walls where the field of view does not yet hold the beam, and where no echo is looked for."""
    walls = [plate(x, "car_paint_silver", 0.1 * x) for x in (0.05, 0.2, 0.6, 1.5, 3.0, 40.0, 900.0)]
    walls = [{**wall, "at_m": [wall["at_m"][0], 0.5 * (k - 3) * wall["at_m"][0], 0.0]} for k, wall in enumerate(walls)]
    made = both(lambda: build(tmp_path, walls, model=model, physics={"full": full}).view(scenes.plan(241, 70.0)))
    one, other = (view.echoes for view in made)
    assert 0.0 < one.range_m.min() < 0.3
    for name in ("beam", "source"):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name), err_msg=name)
    for name in ("range_m", "amplitude", "blocked"):
        np.testing.assert_allclose(getattr(one, name), getattr(other, name), rtol=1e-9, err_msg=name)
    np.testing.assert_allclose(made[0].seen.nearest_m, made[1].seen.nearest_m, rtol=1e-9)


@pytest.mark.parametrize("name", scenario.builtin_names())
def test_shipped_scenarios_are_measured_alike(name: str) -> None:
    compare(scenario.load(name))


@pytest.mark.parametrize("name", sorted(dict(examples.texts()))[::4])
def test_examples_are_measured_alike(name: str) -> None:
    compare(scenario.loads(dict(examples.texts())[name], Path("case.yaml")))


def compare(loaded: scenario.Scenario) -> None:
    """All sensors of a scenario that see beams, three sweeps each as their devices make them."""
    world, actual = scene.build(loaded), plans.plans_of(loaded)

    def sweeps(sensor: str, plan: ScanPlan) -> list[Scan]:
        measure = build_measure(loaded, world, raycast.Caster(world), sensor)
        times = [plan.start_ns + k * 70_000_000 for k in range(3)]
        return [measure(dataclasses.replace(plan, sweep=k, start_ns=time)) for k, time in enumerate(times)]

    for config in loaded.sensors:
        spec = load_spec(config.model)
        if spec.sees != "beams":
            continue
        plan = actual.get(config.id) or error_budget.usual_plan(spec)
        for one, other in zip(*both(lambda: sweeps(config.id, plan)), strict=True):  # noqa: B023
            assert not len(differing(one, other)), config.id
