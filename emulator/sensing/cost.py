"""What each rule of leaving out saves here and now: rays and milliseconds, measured with the rule on and off.

Belongs here: switching rules of one sensor and timing its sweeps, alternately with the scenario's own setting, so that
both see the same machine. Not: the rules (error_budget).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from statistics import median
from typing import Any

from emulator.casting.raycast import Caster
from emulator.process.clock import CpuClock
from emulator.scenario.scenario import Scenario
from emulator.sensing.error_budget import RULES
from emulator.sensing.measure import Measure
from emulator.sensing.measure import build as build_measure
from emulator.sensors.physics_options import LeaveOut
from emulator.world.scene import Scene
from protocols.scan import ScanPlan

REPEATS = 7
ENOUGH_S = 1.0
"Sweeps of a pair are repeated no longer than this, but thrice at the least."


@dataclass(frozen=True)
class Cost:
    """Of one sweep in the long run: what is known from the sweep before costs nothing."""

    rays: float
    "Cast, a beam."
    ms: float
    "Of one core, median."


class Bench:
    """One sensor of a scenario with other physics than its own; scene and caster stay."""

    def __init__(self, scenario: Scenario, scene: Scene, caster: Caster, sensor: str, plan: ScanPlan) -> None:
        self._scenario, self._scene, self._caster, self._plan = scenario, scene, caster, plan
        self._sensor = sensor

    def measure(self, leave_out: LeaveOut | None = None, **physics: Any) -> Measure:
        """The sensor with these rules and other choices."""
        sensors = []
        for one in self._scenario.sensors:
            if one.id == self._sensor:
                rules = one.physics.leave_out if leave_out is None else leave_out
                chosen = one.physics.model_copy(update={"leave_out": rules, **physics})
                one = one.model_copy(update={"physics": chosen})
            sensors.append(one)
        chosen_scenario = self._scenario.model_copy(update={"sensors": tuple(sensors)})
        return build_measure(chosen_scenario, self._scene, self._caster, self._sensor)

    def costs(self, *measures: Measure, repeats: int = REPEATS) -> list[Cost]:
        """Of sweeps that take turns."""
        clock, counters = CpuClock(), self._caster.counters
        for one in measures:
            one(self._later(0))
        rays: list[list[int]] = [[] for _ in measures]
        times: list[list[int]] = [[] for _ in measures]
        begin_ns = clock.now_ns()
        for sweep in range(1, repeats + 1):
            if sweep > 3 and clock.now_ns() - begin_ns > 1e9 * ENOUGH_S:
                break
            for number, one in enumerate(measures):
                before, since_ns = counters.cast, clock.now_ns()
                one(self._later(sweep))
                times[number].append(clock.now_ns() - since_ns)
                rays[number].append(counters.cast - before)
        n = len(self._plan)
        return [Cost(median(r) / n, 1e-6 * median(t)) for r, t in zip(rays, times, strict=True)]

    def _later(self, sweep: int) -> ScanPlan:
        plan = self._plan
        after_ns = round(1e9 * max(plan.duration_s, 0.01)) * sweep
        return replace(plan, sweep=plan.sweep + sweep, start_ns=plan.start_ns + after_ns)


def switched(own: LeaveOut, key: str, on: bool) -> LeaveOut:
    """These rules with one of them on or off."""
    return own.model_copy(update={key: ("always" if on else "never") if key == "closed_form" else on})


def rules_alone(bench: Bench) -> dict[str, Measure]:
    """The sensor with one rule on and every other one off, by the rule's key."""
    none = LeaveOut.nothing()
    return {f"{key} alone": bench.measure(switched(none, key, True)) for key in LeaveOut.model_fields}


def saved(
    bench: Bench, own: Measure, rows: list[dict[str, Any]], progress: Callable[[float], None] = lambda share: None
) -> tuple[Cost, Cost, Mapping[str, Cost]]:
    """Cost of a sweep, with every rule off, and what single rules save; `progress` gets the share that is done.

    `rows`: of `error_budget.explained`; idle rows, and rows without a switch, are not timed. What a rule saves is the
    cost without it less the cost with it: a rule that is kept because it does not pay comes out below zero.
    """
    rules = own.model.leave_out
    found: dict[str, Cost] = {}
    for number, (rule, row) in enumerate(zip(RULES, rows, strict=True)):
        progress(number / (len(RULES) + 1))
        if rule.key is None or row["idle"] or not (row["left_out"] or rule.key == "closed_form"):
            continue
        on = bool(row["left_out"])
        if rule.key == "closed_form" and not on and rules.closed_form == "always":
            continue
        other = bench.measure(switched(rules, rule.key, not on))
        mine, others = bench.costs(own, other)
        with_it, without = (mine, others) if on else (others, mine)
        found[rule.name] = Cost(without.rays - with_it.rays, without.ms - with_it.ms)
    mine, whole = bench.costs(own, bench.measure(full=True))
    return mine, whole, found
