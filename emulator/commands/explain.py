"""`lidaremu explain SCENARIO`: the error budget of every sensor: terms kept or left out, bounds, savings."""

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
@click.option("--why", is_flag=True, help="Add to each term when it is decided, the reason, and its switch.")
@click.option("--full", is_flag=True, help="Compute every term: all rules off.")
@click.option("--quick", is_flag=True, help="Do not measure what single rules save.")
@click.option("--json", "as_json", is_flag=True, help="One JSON object per sensor.")
def explain(
    scenario: str,
    overrides: Sequence[str],
    seed: int | None,
    links: Sequence[str],
    why: bool,
    full: bool,
    quick: bool,
    as_json: bool,
) -> int:
    """Print one line per model term: kept or left out, value, bound, and what leaving it out saves.

    A term is left out only while its value is below its bound. `exact`: nothing is approximated. `not present`: the
    scene has nothing of the kind. Saved rays and milliseconds are per sweep on one core, measured with that rule
    switched alone. In brackets: what leaving out a kept term would save. The sweep is the one that the device makes
    once a host has requested scans.
    """
    from emulator.casting import raycast
    from emulator.judging import plans
    from emulator.runtime import assembly
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
        note(f"{loaded.label('sensors')}: no sensor of this scenario measures with beams: nothing to explain")
    with bar("explain") as progress:
        for number, sensor in enumerate(seeing):
            spec = load_spec(sensor.model)
            plan = actual.get(sensor.id)
            assumed = "" if plan is not None else " (default sweep: no host requests scans)"
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
                    "plan": "usual" if assumed else "actual", "rays_per_beam": mine.rays, "sweep_ms": mine.ms,
                    "full_rays_per_beam": None if whole is None else whole.rays,
                    "full_sweep_ms": None if whole is None else whole.ms, "terms": rows,
                }))  # fmt: skip
                continue
            say(f"{sensor.id} ({sensor.model}): {len(plan)} beams per sweep{assumed}; {_cost(mine)}" + _against(whole))
            _print_table(rows, why)
    for number, sensor in enumerate(() if as_json else loaded.sensors):
        if reason := assembly.why_one_at_a_time(loaded, number):
            say(f"{sensor.id} ({sensor.model}): measured by one process at a time: {reason}")
    return OK


def _cost(cost: Cost) -> str:
    return f"{cost.rays:.2f} rays per beam, {cost.ms:.2f} ms per sweep"


def _against(whole: Cost | None) -> str:
    return "" if whole is None else f"; all rules off: {whole.rays:.2f} rays, {whole.ms:.2f} ms"


HEADER = ("term", "decision", "value", "bound", "unit", "saved: rays per beam", "ms per sweep")
RIGHT = (2, 3, 5, 6)
"Columns of numbers."


def _print_table(rows: Sequence[dict[str, Any]], why: bool) -> None:
    """One line per term under a header; with `why` the reasons of a term below it."""
    lines = [HEADER, *map(_cells, rows)]
    widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
    for row, cells in zip([None, *rows], lines, strict=True):
        padded = (
            cell.rjust(width) if at in RIGHT else cell.ljust(width)
            for at, (cell, width) in enumerate(zip(cells, widths, strict=True))
        )  # fmt: skip
        say("  " + "  ".join(padded).rstrip())
        if why and row is not None:
            say(f"      why: {row['why']}")
            say(f"      decided: {row['when']}; saves: {row['saves']}{_margin(row)}; switch: {row['switch']}")


def _cells(row: dict[str, Any]) -> tuple[str, ...]:
    decision = "not present" if row["idle"] else "left out" if row["left_out"] else "kept"
    numbers = ("exact", "-", "-") if row["exact"] else (f"{row['value']:.3g}", f"{row['bound']:.3g}", row["unit"])
    if row["ms_saved"] is None:
        return (row["term"], decision, *numbers, "-", "-")
    saved = f"{row['rays_saved']:.2f}", f"{row['ms_saved']:.2f}"
    return (row["term"], decision, *numbers, *(saved if row["left_out"] else (f"({one})" for one in saved)))


def _margin(row: dict[str, Any]) -> str:
    return "" if row["exact"] or row["margin"] is None else f"; margin: {row['margin']:.3g}"
