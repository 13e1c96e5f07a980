"""`lidaremu explain SCENARIO`: what is computed for every sensor, what is left out, and why that cannot be seen."""

from __future__ import annotations

import json
from collections.abc import Sequence

import click

from emulator.commands.common import OK, load_scenario, say, scenario_options


@click.command()
@click.argument("scenario")
@scenario_options
@click.option("--full", is_flag=True, help="With every rule switched off.")
@click.option("--json", "as_json", is_flag=True, help="One JSON object a sensor.")
def explain(
    scenario: str, overrides: Sequence[str], seed: int | None, links: Sequence[str], full: bool, as_json: bool
) -> int:
    """Print each term that a scene may not need: kept or left out, its bound, the margin, what it saves.

    Rays and milliseconds are those of one sweep as the model usually makes it, on this machine.
    """
    from emulator import needs, raycast, scene, sensing
    from emulator.spec import load_spec

    loaded = load_scenario(scenario, overrides, seed, links)
    if full:
        sensors = tuple(
            sensor.model_copy(update={"physics": sensor.physics.model_copy(update={"full": True})})
            for sensor in loaded.sensors
        )
        loaded = loaded.model_copy(update={"sensors": sensors})
    world = scene.build(loaded)
    caster = raycast.Caster(world)
    for sensor in loaded.sensors:
        spec = load_spec(sensor.model)
        if spec.sees != "beams":
            continue
        measure = sensing.build(loaded, world, caster, sensor.id)
        plan = needs.usual_plan(spec)
        rows, (rays, took_ms) = needs.explained(measure, plan), needs.cost(measure, plan)
        if as_json:
            say(json.dumps({"sensor": sensor.id, "model": sensor.model, "beams": len(plan),
                            "rays_per_beam": rays, "sweep_ms": took_ms, "terms": rows}))  # fmt: skip
            continue
        say(f"{sensor.id} ({sensor.model}): {len(plan)} beams, {rays:.2f} rays a beam, {took_ms:.2f} ms a sweep")
        for row in rows:
            state = "left out" if row["left_out"] else "kept"
            bound = "" if row["bound"] is None else f"  {row['value']:.3g} of {row['bound']:.3g}"
            margin = "" if row["margin"] is None else f", margin {row['margin']:.3g}"
            say(f"  {row['term']:26s} {state:9s}{bound}{margin}")
            say(f"      {row['why']}; saves {row['saves']}; switch: {row['switch']}")
    return OK
