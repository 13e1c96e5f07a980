"""`lidaremu explain SCENARIO`: what is computed for every sensor, what is left out, and why that cannot be seen."""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import click

from emulator.commands.common import OK, bar, load_scenario, part_of, scenario_options
from emulator.output.lines import note, say

if TYPE_CHECKING:
    from emulator.sensing.cost import Cost


@click.command()
@click.argument("scenario")
@scenario_options
@click.option("--full", is_flag=True, help="With every rule switched off.")
@click.option("--quick", is_flag=True, help="Without times: no sweep with a single rule switched off.")
@click.option("--json", "as_json", is_flag=True, help="One JSON object a sensor.")
def explain(
    scenario: str,
    overrides: Sequence[str],
    seed: int | None,
    links: Sequence[str],
    full: bool,
    quick: bool,
    as_json: bool,
) -> int:
    """Print each term that a scene may not need: kept or left out, its bound, the margin, what it saves.

    Rays and milliseconds are those of one sweep of one core, as the device makes it once a host has asked for scans,
    measured here: with each rule switched alone, and with all of them off.
    """
    from emulator.casting import raycast
    from emulator.judging import plans
    from emulator.sensing import cost, error_budget
    from emulator.sensors.spec import load_spec
    from emulator.world import scene

    loaded = load_scenario(scenario, overrides, seed, links)
    if full:
        sensors = tuple(
            sensor.model_copy(update={"physics": sensor.physics.model_copy(update={"full": True})})
            for sensor in loaded.sensors
        )
        loaded = loaded.model_copy(update={"sensors": sensors})
    world = scene.build(loaded)
    actual = plans.plans_of(loaded)
    seeing = [sensor for sensor in loaded.sensors if load_spec(sensor.model).sees == "beams"]
    if not seeing:
        note(f"{loaded.label('sensors')}: no sensor here sees beams: there is nothing to explain")
    with bar("explain") as progress:
        for number, sensor in enumerate(seeing):
            spec = load_spec(sensor.model)
            plan = actual.get(sensor.id)
            told = "" if plan is not None else " (a usual one: no host has asked for scans)"
            plan = error_budget.usual_plan(spec) if plan is None else plan
            bench = cost.Bench(loaded, world, raycast.Caster(world), sensor.id, plan)
            measure = bench.measure()
            rows = error_budget.explained(measure, plan)
            each: dict[str, Cost] = {}
            whole: Cost | None = None
            if quick or full:
                (mine,) = bench.costs(measure)
            else:
                mine, whole, single = cost.saved(bench, measure, rows, part_of(progress, number, len(seeing)))
                each = dict(single)
            for row in rows:
                saved = each.get(row["term"])
                row["rays_saved"], row["ms_saved"] = (None, None) if saved is None else (saved.rays, saved.ms)
            if as_json:
                say(json.dumps({
                    "sensor": sensor.id, "model": sensor.model, "beams": len(plan),
                    "plan": "usual" if told else "actual", "rays_per_beam": mine.rays, "sweep_ms": mine.ms,
                    "full_rays_per_beam": None if whole is None else whole.rays,
                    "full_sweep_ms": None if whole is None else whole.ms, "terms": rows,
                }))  # fmt: skip
                continue
            say(f"{sensor.id} ({sensor.model}): {len(plan)} beams a sweep{told}")
            say(f"  {mine.rays:.2f} rays a beam, {mine.ms:.2f} ms a sweep" + _against(whole))
            for row in rows:
                _tell(row)
    return OK


def _against(whole: Cost | None) -> str:
    return "" if whole is None else f"; every rule off: {whole.rays:.2f} rays a beam, {whole.ms:.2f} ms"


def _tell(row: dict[str, Any]) -> None:
    state = "not there" if row["idle"] else "left out" if row["left_out"] else "kept"
    say(f"  {row['term']:24s} {state:9s}  {_numbers(row)}")
    saved = ""
    if row["ms_saved"] is not None:
        would = "saves" if row["left_out"] else "would save"
        saved = f"; {would} {row['rays_saved']:.2f} rays a beam, {row['ms_saved']:.2f} ms"
    say(f"      {row['when']}: {row['why']}")
    say(f"      spares {row['saves']}{saved}; switch: {row['switch']}")


def _numbers(row: dict[str, Any]) -> str:
    """What is compared and how far it is from its bound; `exact` where nothing need be."""
    if row["exact"]:
        return "exact"
    margin = "inf" if row["margin"] is None else f"{row['margin']:.3g}"
    return f"{row['value']:.3g} of {row['bound']:.3g} {row['unit']}, margin {margin}"
