"""What leaving out saves in the standard scene: each rule alone and all together, at rest and driving; far actors.

python -m tests.benchmarks.bench_error_budget. Prints; never fails. Times are CPU time of one core.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import scenarios
from emulator.casting import raycast
from emulator.judging.plans import plans_of
from emulator.scenario import scenario
from emulator.sensing.cost import Bench, Cost, rules_alone
from emulator.sensing.measure import Measure
from emulator.sensors.physics_options import LeaveOut
from emulator.sensors.spec import load_spec
from emulator.world import scene

HOME = Path(scenarios.__file__).parent / "standard.yaml"


def reported(name: str, cost: Cost, whole: Cost | None = None) -> None:
    share = (
        "" if whole is None else f"  {cost.rays / whole.rays:6.1%} of the rays, {cost.ms / whole.ms:6.1%} of the time"
    )
    sys.stdout.write(f"  {name:34s} {cost.rays:6.2f} rays a beam, {cost.ms:7.2f} ms{share}\n")
    sys.stdout.flush()


def rules_of(bench: Bench) -> None:
    """Everything off, each rule alone, all together, and other choices for plain beams."""
    full = bench.measure(full=True)

    def against(name: str, measure: Measure) -> None:
        whole, mine = bench.costs(full, measure)
        reported(name, mine, whole)

    reported("every rule off", bench.costs(full)[0])
    for name, measure in rules_alone(bench).items():
        against(name, measure)
    against("all (as they come)", bench.measure(LeaveOut()))
    for radii in (2.63, 1.5):
        rules = LeaveOut(closed_form="always")
        against(f"all, closed_form always, k {radii}", bench.measure(rules, plain_radii=radii))


def standard(driving: bool) -> list[tuple[str, Bench]]:
    """The sensors of the standard scene, at rest or on a car of 10 m/s."""
    loaded = scenario.load("standard")
    plans = plans_of(loaded)
    if driving:
        raw = {"id": "ego", "class": "car", "motion": {"velocity_m_s": (10.0, 0.0, 0.0)}}
        ego = type(loaded.actors[0]).model_validate(raw)
        sensors = tuple(
            one.model_copy(update={"mount": one.mount.model_copy(update={"actor": "ego"})}) for one in loaded.sensors
        )
        loaded = loaded.model_copy(update={"actors": (*loaded.actors, ego), "sensors": sensors})
    world = scene.build(loaded)
    return [(s.model, Bench(loaded, world, raycast.Caster(world), s.id, plans[s.id])) for s in loaded.sensors]


def far_actors(far: int) -> tuple[Bench, Measure]:
    """A road and so many moving boxes beyond 2 km."""
    actors: list[dict[str, Any]] = []
    for k in range(far):
        at = [2000.0 + k % 100 * 10.0, float(k // 100 * 10.0), 0.0]
        motion = {"at_m": at, "velocity_m_s": [0.0, 5.0, 0.0]}
        actors.append({"id": f"far{k}", "shape": {"box": {"size_m": [4.0, 2.0, 1.5]}}, "material": "asphalt",
                       "motion": motion})  # fmt: skip
    near = {"id": "near", "shape": {"box": {"size_m": [4.0, 2.0, 1.5]}}, "material": "asphalt",
            "motion": {"at_m": [10.0, 0.0, 0.0], "velocity_m_s": [0.1, 0.0, 0.0]}}  # fmt: skip
    sensor = {"id": "front", "model": "sick-lms291-s05", "mount": {"at_m": [0.0, 0.0, 0.6]}}
    text = {"schema": 1, "world": [{"plane": {"size_m": [300, 300]}, "material": "asphalt"}],
            "actors": [near, *actors], "sensors": [sensor]}  # fmt: skip
    loaded = scenario.loads(json.dumps(text), HOME)
    world = scene.build(loaded)
    from emulator.sensing.error_budget import usual_plan

    bench = Bench(loaded, world, raycast.Caster(world), "front", usual_plan(load_spec("sick-lms291-s05")))
    return bench, bench.measure()


def main() -> None:
    """Print it all."""
    for driving in (False, True):
        for model, bench in standard(driving):
            sys.stdout.write(f"{model} in the standard scene, {'on a car of 10 m/s' if driving else 'at rest'}\n")
            rules_of(bench)
    for far in (0, 10, 100, 1000, 9_900):
        bench, measure = far_actors(far)
        reported(f"LMS291, {far} far actors", bench.costs(measure)[0])


if __name__ == "__main__":
    main()
