"""What a scene does not need: every term that may be left out, its bound, how far it is from it, and what that saves.

Belongs here: the table, and asking one sensor's measuring function for its numbers. Not: the bounds themselves, which
stand where the term is computed. All of them end with `physics.full`; those with a key of their own also one by one.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from emulator.clock import SystemClock
from emulator.sensing import Measure
from emulator.sensing.daylight import largest_diffuse_w, unseen_w
from emulator.sensing.paths import reach_of
from emulator.sensing.receiver import RARE
from emulator.sensing.soft import UNSEEN
from emulator.spec import SensorSpec
from protocols.scan import ScanPlan


@dataclass(frozen=True)
class Finding:
    """One rule for one sensor in one scene."""

    left_out: bool
    value: float | None
    "What is compared with the bound; None: nothing is."
    bound: float | None
    saves: str

    @property
    def margin(self) -> float | None:
        """Bound over value: above 1 the term cannot be seen."""
        if self.value is None or self.bound is None:
            return None
        return self.bound / self.value if self.value > 0.0 else math.inf


@dataclass(frozen=True)
class Rule:
    """One row of the table."""

    name: str
    switch: str
    "Key below `physics` that has the term computed; - : exact, nothing to switch."
    when: str
    "How often it is decided."
    why: str
    find: Callable[[Measure, ScanPlan], Finding]


def _closed_form(measure: Measure, plan: ScanPlan) -> Finding:
    view = measure.view(plan)
    whole = len(plan) * len(measure._bundles.of(plan).share)
    if view.plain is None:
        return Finding(False, None, None, "0 rays: a test of edges would cost more than it saves")
    share = float(np.mean(view.plain))
    saved = f"{whole - view.cast} of {whole} rays, {share:.0%} of the beams plain"
    return Finding(share > 0.0, math.exp(-2.0 * measure.model.plain_radii**2), 1e-3, saved)


def _far_objects(measure: Measure, plan: ScanPlan) -> Finding:
    air = measure.air.at(1e-9 * plan.start_ns)
    reach = reach_of(measure.model, plan.max_range_m)
    return Finding(measure.model.spare_far and air.sun is None, None, None, f"all surfaces beyond {reach:.0f} m")


def _soft(measure: Measure, plan: ScanPlan) -> Finding:
    model, air, soft = measure.model, measure.air.at(1e-9 * plan.start_ns), measure._soft
    start_m = max(model.overlap_start_m, model.near_gate_m)
    value = soft._bound(air.everywhere.backscatter_per_m_sr, air.everywhere.extinction_per_m, start_m) * plan.gain
    kept = soft.uneven(air) or soft.everywhere(air, plan.gain) is not None
    saves, bound = "the medium's waveform in every beam", UNSEEN * model.threshold
    if not kept and value >= bound:  # decided by the medium's own wave against the threshold at each range
        return Finding(True, None, None, saves)
    return Finding(not kept, value, bound, saves)


def _sun(measure: Measure, plan: ScanPlan) -> Finding:
    sun, model = measure.air.at(1e-9 * plan.start_ns).sun, measure.model
    if sun is None:
        return Finding(True, 0.0, unseen_w(model), "noise of every beam, one ray to the sun")
    value = largest_diffuse_w(sun, model)
    return Finding(value <= unseen_w(model) and not model.full, value, unseen_w(model), "noise of every beam")


def _false_alarms(measure: Measure, plan: ScanPlan) -> Finding:
    value = float(getattr(measure._receiver, "_false_alarms", 0.0)) * len(plan)
    out = not measure.model.false_alarms or (value < RARE and not measure.model.full)
    return Finding(out, value, RARE, "draws of a sweep")


def _particles(measure: Measure, plan: ScanPlan) -> Finding:
    return Finding(not measure.air.at(1e-9 * plan.start_ns).particles, None, None, "drops or flakes of every beam")


def _bounces(measure: Measure, plan: ScanPlan) -> Finding:
    return Finding(not (measure._dry.sends_on and measure.model.bounces > 0), None, None, "second rays and their air")


def _exact(saves: str) -> Callable[[Measure, ScanPlan], Finding]:
    return lambda measure, plan: Finding(True, None, None, saves)


def _kept(reason: str) -> Callable[[Measure, ScanPlan], Finding]:
    return lambda measure, plan: Finding(False, None, None, reason)


RULES: tuple[Rule, ...] = (
    Rule("clear-air extinction", "-", "never", "one exponential an echo is not worth a rule", _kept("nothing")),
    Rule("bundles of plain beams", "leave_out.closed_form", "per sweep; once for what rests",
         "no edge within plain_radii: exp(-2 k^2) of the power lies outside", _closed_form),
    Rule("rebuilding of structures", "-", "never needed", "rays are moved, in float64", _exact("every build")),
    Rule("surfaces out of reach", "leave_out.far_objects", "per sweep",
         "nothing beyond the gate and a pulse is an echo; in daylight it is background", _far_objects),
    Rule("background light", "full", "per sweep", "shot noise below 2e-3 of the square of the noise", _sun),
    Rule("noise echoes", "false_alarms", "per sweep", "mean count of a sweep below 1e-6", _false_alarms),
    Rule("backscatter of the air", "weather_echoes", "once per state of the weather",
         "rigorous bound of its waveform below a tenth of the threshold", _soft),
    Rule("falling particles", "weather_echoes", "per state of the weather", "none falls, or none reaches the threshold",
         _particles),
    Rule("second rays", "bounces", "once per scene, then per ray", "no surface mirrors or transmits 1 %", _bounces),
    Rule("poses within a sweep", "-", "never", "every beam has its own instant", _kept("nothing")),
)  # fmt: skip


def explained(measure: Measure, plan: ScanPlan) -> list[dict[str, Any]]:
    """Every rule for this sensor: name, switch, left out or kept, value, bound, margin, what it saves."""
    found = []
    for rule in RULES:
        finding = rule.find(measure, plan)
        row = {"term": rule.name, "switch": rule.switch, "when": rule.when, "why": rule.why, **asdict(finding)}
        margin = finding.margin
        found.append({**row, "margin": margin if margin is None or math.isfinite(margin) else None})
    return found


def cost(measure: Measure, plan: ScanPlan, repeats: int = 5) -> tuple[float, float]:
    """Rays a beam and milliseconds of one sweep in the long run, here and now."""
    measure(plan)
    clock, times = SystemClock(), []
    for number in range(1, repeats + 1):
        begin_ns = clock.now_ns()
        measure(replace(plan, sweep=number))
        times.append(1e-9 * (clock.now_ns() - begin_ns))
    return measure.view(plan).cast / len(plan), 1e3 * min(times)


def usual_plan(spec: SensorSpec) -> ScanPlan:
    """A sweep such as this model makes: its own table, or half a degree over 180 degrees, an eighth over 360."""
    from emulator.sensing.table import table_plan

    if spec.beams is not None:
        return table_plan(spec, 0)
    step, field, period = (0.125, 360.0, 0.1) if spec.family == "ld" else (0.5, 180.0, 2.0 / 75.0)
    n = round(field / step) + (field < 360.0)
    index = np.arange(n)
    azimuth = np.radians(index * step - 0.5 * field)
    far = math.inf if spec.receiver is None else spec.receiver.gate_m.value
    return ScanPlan(0, 0, 0, azimuth, np.zeros(n), index * period / n, period, max_range_m=far, wants_intensity=True)
