"""What a scene does not need: every term that may be left out, its bound, how far it is from it, and what that spares.

Belongs here: the table, and asking one sensor's measuring function for its numbers. Not: the bounds themselves, which
stand where the term is computed, and what rules save here and now (savings). All of them end with `physics.full`.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from emulator.sensing import Measure
from emulator.sensing.daylight import largest_diffuse_w, surfaces_show, unseen_w
from emulator.sensing.faint import most_dropped, without_faint
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
    idle: bool = False
    "There is nothing here that the rule could leave out or keep."

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
    key: str | None
    "Key below `physics.leave_out`; None: nothing to switch, `why` says why."
    when: str
    "How often it is decided."
    why: str
    find: Callable[[Measure, ScanPlan], Finding]

    @property
    def switch(self) -> str:
        """Key below `physics`; - : none."""
        return "-" if self.key is None else f"leave_out.{self.key}"


def _clear_air(measure: Measure, plan: ScanPlan) -> Finding:
    view = measure.view(plan)
    if view.air.uneven or not len(view.echoes):
        return Finding(False, None, None, "an exponential an echo", idle=not len(view.echoes))
    depth = 2.0 * view.air.everywhere.extinction_per_m * float(view.echoes.range_m.max())
    bound = measure.model.clear_depth
    return Finding(measure.model.leave_out.clear_air and depth < bound, depth, bound, "an exponential an echo")


def _closed_form(measure: Measure, plan: ScanPlan) -> Finding:
    view = measure.view(plan)
    whole = len(plan) * len(measure._bundles.of(plan).share)
    if view.plain is None:
        return Finding(False, None, None, "0 rays: a test of edges would cost more than it saves")
    share = float(np.mean(view.plain))
    saved = f"{whole - view.cast} of {whole} rays, {share:.0%} of the beams plain"
    return Finding(share > 0.0, math.exp(-2.0 * measure.model.plain_radii**2), 1e-3, saved)


def _plane_moments(measure: Measure, plan: ScanPlan) -> Finding:
    view, sub_beams = measure.view(plan), len(measure._bundles.of(plan).share)
    if view.plain is None or not bool(np.any(view.plain)):
        return Finding(False, None, None, "0 beams", idle=True)
    single = np.bincount(view.seen.echoes.beam, minlength=len(plan)) == 1
    short = int(np.count_nonzero(view.plain & single)) if sub_beams > 1 else 0
    return Finding(short > 0, None, None, f"the bundle's ranges in {short} of {int(view.plain.sum())} plain beams")


def _resting(measure: Measure, plan: ScanPlan) -> Finding:
    idle, on = measure._still_pose is None, measure.model.leave_out.resting
    return Finding(on and not idle, None, None, "the casts on resting bodies of a sensor at rest", idle=idle)


def _far_objects(measure: Measure, plan: ScanPlan) -> Finding:
    air = measure.air.at(1e-9 * plan.start_ns)
    saves = f"all surfaces beyond {reach_of(measure.model, plan.max_range_m):.0f} m"
    if surfaces_show(air.sun, measure.model):
        saves += ", but for one ray of each beam that met nothing: background"
    return Finding(measure.model.leave_out.far_objects, None, None, saves)


def _soft(measure: Measure, plan: ScanPlan) -> Finding:
    model, air, soft = measure.model, measure.air.at(1e-9 * plan.start_ns), measure._soft
    start_m = max(model.overlap_start_m, model.near_gate_m)
    value = soft._bound(air.everywhere.backscatter_per_m_sr, air.everywhere.extinction_per_m, start_m) * plan.gain
    bound, saves = UNSEEN * model.threshold, "the medium's waveform in every beam"
    if not model.weather_echoes:
        return Finding(True, 0.0, bound, saves, idle=True)
    if soft.uneven(air):
        return Finding(False, value, bound, saves)
    made = soft.everywhere(air, plan.gain)
    if made is not None and (made.shows or math.isinf(made.until_m)):
        return Finding(False, value, bound, saves)
    if made is not None:
        saves = f"the medium's waveform beyond {made.until_m:.1f} m; before, it shifts echoes of surfaces"
    if value >= bound:  # decided by the medium's own wave against the threshold at each range
        return Finding(True, None, None, saves)
    return Finding(True, value, bound, saves)


def _soft_table(measure: Measure, plan: ScanPlan) -> Finding:
    air = measure.air.at(1e-9 * plan.start_ns)
    used = measure._soft.everywhere(air, plan.gain) is not None
    return Finding(used and measure.model.leave_out.soft_table, None, None, "a table a sweep", idle=not used)


def _sun(measure: Measure, plan: ScanPlan) -> Finding:
    sun, model = measure.air.at(1e-9 * plan.start_ns).sun, measure.model
    if sun is None:
        return Finding(True, 0.0, unseen_w(model), "noise of every beam, one ray to the sun", idle=True)
    value = largest_diffuse_w(sun, model)
    out = value <= unseen_w(model) and model.leave_out.background_light
    return Finding(out, value, unseen_w(model), "noise of every beam")


def _false_alarms(measure: Measure, plan: ScanPlan) -> Finding:
    value = float(getattr(measure._receiver, "_false_alarms", 0.0)) * len(plan)
    wanted = measure.model.false_alarms
    out = not wanted or (value < RARE and measure.model.leave_out.noise_echoes)
    return Finding(out, value, RARE, "draws of a sweep", idle=not wanted)


def _particles(measure: Measure, plan: ScanPlan) -> Finding:
    none = not measure.air.at(1e-9 * plan.start_ns).particles
    return Finding(none, None, None, "drops or flakes of every beam", idle=none)


def _waveform(measure: Measure, plan: ScanPlan) -> Finding:
    model = measure.model
    fits = model.pulse.shape == "sin2" and model.method == "leading_edge" and model.photons is None
    if not fits:
        return Finding(
            False, None, None, "nothing: only sin2 pulses under a leading edge have a closed form", idle=True
        )
    saves = "samples of every cluster shorter than half a pulse where a medium is faint, and of the medium alone"
    return Finding(model.leave_out.waveform, None, None, saves)


def _bounces(measure: Measure, plan: ScanPlan) -> Finding:
    none = not (measure._dry.sends_on and measure.model.bounces > 0)
    return Finding(none, None, None, "second rays and their air", idle=none)


def _faint(measure: Measure, plan: ScanPlan) -> Finding:
    echoes, threshold = measure.view(plan).echoes, measure.model.threshold
    bound = most_dropped(measure.model)
    kept = without_faint(echoes, threshold, bound)
    gone = len(echoes) - len(kept)
    lost = np.bincount(echoes.beam, echoes.amplitude) if len(echoes) else np.zeros(1)
    left = np.bincount(kept.beam, kept.amplitude, len(lost)) if len(kept) else np.zeros(len(lost))
    saves = f"{gone} of {len(echoes)} reflections" if gone else "0 reflections: too few are faint to be worth it"
    value = float(np.max(lost - left)) if gone else 0.0
    return Finding(gone > 0 and measure.model.leave_out.faint, value, bound, saves)


def _exact(saves: str) -> Callable[[Measure, ScanPlan], Finding]:
    return lambda measure, plan: Finding(True, None, None, saves)


def _kept(reason: str) -> Callable[[Measure, ScanPlan], Finding]:
    return lambda measure, plan: Finding(False, None, None, reason)


RULES: tuple[Rule, ...] = (
    Rule("clear-air extinction", "clear_air", "per sweep", "depth there and back shifts no range by half a step",
         _clear_air),
    Rule("bundles of plain beams", "closed_form", "per sweep; once for what rests",
         "no edge within plain_radii: exp(-2 k^2) of the power lies outside", _closed_form),
    Rule("bundle ranges on planes", "plane_moments", "per beam",
         "mean, energy and spread of a tilted plane shift no range by a quarter of a step", _plane_moments),
    Rule("rebuilding of structures", None, "never needed", "rays are moved, in float64", _exact("every build")),
    Rule("casts on what rests", "resting", "once for a sensor at rest", "the same rays meet the same, bit by bit",
         _resting),
    Rule("surfaces out of reach", "far_objects", "per sweep",
         "nothing beyond the gate and a pulse is an echo; in daylight it is background", _far_objects),
    Rule("background light", "background_light", "per sweep", "shot noise below 2e-3 of the square of the noise", _sun),
    Rule("noise echoes", "noise_echoes", "per sweep", "mean count of a sweep below 1e-6", _false_alarms),
    Rule("backscatter of the air", "backscatter", "once per state of the weather",
         "its waveform's bound is below a tenth of the threshold; followed where it shifts a crossing", _soft),
    Rule("tables of the medium", "soft_table", "once per state of the weather", "exact in air that is even everywhere",
         _soft_table),
    Rule("falling particles", "particles", "per state of the weather, draws per sweep",
         "none falls, or fewer than 1e-3 a sweep reach the threshold", _particles),
    Rule("sampled waveforms", "waveform", "per cluster of reflections", "shorter than half a pulse: sums of cosines",
         _waveform),
    Rule("second rays", "second_rays", "once per scene, then per ray",
         "no surface mirrors or transmits 1 %, or the best one behind returns below 5 % of the threshold", _bounces),
    Rule("poses within a sweep", None, "never", "one pose for all would spare nothing: rays are moved all the same",
         _kept("nothing")),
    Rule("faint reflections", "faint", "per sweep",
         "each below 1e-3 of the threshold, those of a beam together below 1e-2 and half a step", _faint),
    Rule("what nobody asked for", None, "never computed",
         "waveforms are sampled where timed, echoes listed up to the plan's number; recordings hold the rest",
         _exact("lists of echoes, waveforms")),
)  # fmt: skip
"In the order of section 8 of the physics."


def explained(measure: Measure, plan: ScanPlan) -> list[dict[str, Any]]:
    """Every rule for this sensor: name, switch, left out or kept, value, bound, margin, what it saves."""
    found = []
    for rule in RULES:
        finding = rule.find(measure, plan)
        row = {"term": rule.name, "switch": rule.switch, "when": rule.when, "why": rule.why, **asdict(finding)}
        margin = finding.margin
        found.append({**row, "margin": margin if margin is None or math.isfinite(margin) else None})
    return found


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
