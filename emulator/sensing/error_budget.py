"""Error budget of a scene: every term that may be left out, its value, its bound, and what leaving it out saves.

Belongs here: the table, and asking one sensor's measuring function for its numbers. Not: the bounds themselves, which
stand where the term is computed, and what rules save here and now (cost). All of them end with `physics.full`.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from scipy.special import ndtr

from emulator.physics.arrays import Floats
from emulator.physics.cosines import SHORT, split_cosines
from emulator.physics.radiometry import overlap
from emulator.physics.softprofile import SoftProfile
from emulator.physics.subechoes import SubEchoes
from emulator.sensing import strips
from emulator.sensing.closed import LEAN_LSB, SHIFT_LSB
from emulator.sensing.daylight import largest_diffuse_w, largest_near_sun_w, surfaces_show, unseen_w
from emulator.sensing.faint import looked_at, most_dropped
from emulator.sensing.measure import Measure
from emulator.sensing.model import SensorModel
from emulator.sensing.particles import RARE as RAREST_PARTICLES
from emulator.sensing.paths import UNSEEN as BEHIND
from emulator.sensing.paths import best_behind, reach_of
from emulator.sensing.probing import MOST_BEHIND, most_missed
from emulator.sensing.rays import cast_rays
from emulator.sensing.receiver import RARE, Receiver
from emulator.sensing.sheets import bright_of
from emulator.sensing.soft import UNSEEN, SoftTargets
from emulator.sensors.spec import SensorSpec
from protocols import family
from protocols.scan import ScanPlan
from protocols.session import Address, LinkKind


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
    unit: str = ""
    "Of value and bound."

    @property
    def exact(self) -> bool:
        """Nothing is compared: all is computed, or what is left out adds nothing at all."""
        return self.value is None

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
    found = view.seen.echoes
    if view.air.uneven or not len(found):
        return Finding(False, None, None, "one exponential per echo", idle=not len(found))
    depth = 2.0 * view.air.everywhere.extinction_per_m * float(found.range_m.max())
    bound = measure.model.clear_depth
    out = measure.model.leave_out.clear_air and depth < bound
    return Finding(out, depth, bound, "one exponential per echo", unit="optical depth")


def _closed_form(measure: Measure, plan: ScanPlan) -> Finding:
    view, model = measure.view(plan), measure.model
    whole = len(plan) * measure._bundles.sub_beams
    if measure._probing is not None:
        return Finding(False, None, None, "0 rays: narrow beams have probes", idle=True)
    outside = math.exp(-2.0 * model.plain_radii**2) if model.beam.profile == "gauss" else 0.0
    if view.plain is None:
        saved = "0 rays: the edge test would cost more than it saves"
        return Finding(False, outside, 1e-3, saved, unit="of power")
    plain = int(np.count_nonzero(view.plain))
    saved = f"{whole - view.cast} of {whole} rays; {plain} of {len(plan)} beams see a single plane"
    return Finding(plain > 0, outside, 1e-3, saved, unit="of power")


def _narrow_beams(measure: Measure, plan: ScanPlan) -> Finding:
    """What of the light may lie behind a straight edge that no probe meets."""
    model = measure.model
    edge, strip = most_missed(model.probes) if model.probes else (0.0, 0.0)
    if measure._probing is None:
        return Finding(False, None, None, "0 rays: no probes in the spec, or a beam without edge", idle=True)
    view = measure.view(plan)
    assert view.plain is not None
    whole, plain = len(plan) * measure._bundles.sub_beams, int(np.count_nonzero(view.plain))
    saves = (
        f"{whole - view.cast} of {whole} rays; {plain} of {len(plan)} beams see one smooth surface; "
        f"crossings within {1e3 * strips.SHIFT_LSB * model.lsb_m:.2g} mm; "
        f"a strip of at most {100.0 * strip:.0f} % of the light may slip between {model.probes} probes"
    )
    return Finding(True, edge, MOST_BEHIND, saves, unit="of power")


def _tail(measure: Measure, plan: ScanPlan) -> Finding:
    """What surfaces without rays of their own may bring back from outside the bundle, where that is most."""
    view, model, unit = measure.view(plan), measure.model, "of the threshold"
    bundles = measure._bundles.of(plan)
    if model.beam.is_ray or model.beam.profile != "gauss" or model.rule in ("axis", "adaptive"):
        return Finding(False, None, None, "nothing: the beam has no tail, or its bundle has no edge", idle=True)
    table, met_m = view.surfaces.table, view.seen.nearest_m
    ordinary = table.largest[~bright_of(table)]
    met_m = np.maximum(met_m[np.isfinite(met_m)], model.near_gate_m)
    edge = float(ndtr(-2.0 * measure._bundles.radius)) * float(ordinary.max(initial=0.0)) * plan.gain
    light = edge * model.k_m2 * overlap(met_m, model.overlap_start_m, model.overlap_full_m)
    light /= met_m**2 + model.aperture_radius_m**2
    value = float((light / (model.least_amplitude(met_m) - 1.0)).max(initial=0.0))
    tails = view.tails
    if tails is None or not len(tails.beams):
        rest = len(plan) * bundles.sub_beams
        return Finding(True, value, 1.0, f"rays beyond {measure._bundles.radius:.2f} radii of {rest}", unit=unit)
    names = ", ".join(m.name for m, bright in zip(table.materials, bright_of(table), strict=True) if bright)
    saves = f"rays beyond {measure._bundles.radius:.2f} radii, but {tails.rays} for the edges of {names}"
    return Finding(False, value, 1.0, f"{saves} in {len(tails.beams)} of {len(plan)} beams", unit=unit)


def _plane_moments(measure: Measure, plan: ScanPlan) -> Finding:
    view, step_m = measure.view(plan), measure.model.lsb_m
    t_s = 1e-9 * plan.start_ns + plan.fire_offset_s
    with np.errstate(under="ignore"):
        rays_saved = measure._pruned_by_bundles(plan, measure._pose(t_s, plan.origin_m), t_s, view.surfaces, view.air)
    if rays_saved is None or not bool(rays_saved.plain.any()):
        return Finding(False, None, None, "0 beams", idle=True)
    shifts, plain = rays_saved.shifts, int(rays_saved.plain.sum())
    short = int(np.count_nonzero(np.isfinite(shifts.crossing_m)))
    saves = f"sub-ray ranges in {short} of {plain} single-plane beams"
    if not short:
        return Finding(False, None, None, saves)
    of_lean = float(np.nanmax(shifts.lean_m)), LEAN_LSB * step_m
    of_crossing = float(np.nanmax(shifts.crossing_m)), SHIFT_LSB * step_m
    value, bound = max(of_lean, of_crossing, key=lambda pair: pair[0] / pair[1])
    return Finding(True, value, bound, saves, unit="m")


def _resting(measure: Measure, plan: ScanPlan) -> Finding:
    idle, on = measure._still_pose is None, measure.model.leave_out.resting
    return Finding(on and not idle, None, None, "ray casts from a static sensor to static bodies", idle=idle)


def _far_objects(measure: Measure, plan: ScanPlan) -> Finding:
    air, model = measure.air.at(1e-9 * plan.start_ns), measure.model
    reach_m = reach_of(model, plan.max_range_m)
    met_m = measure.view(plan).seen.nearest_m
    saves = f"all surfaces beyond {reach_m:.0f} m"
    if bool(np.isfinite(met_m).any()):
        saves += f" (farthest first hit: {float(np.max(met_m[np.isfinite(met_m)])):.1f} m)"
    out = model.leave_out.far_objects
    if surfaces_show(air.sun, model):
        saves += ", except one background ray for each beam without a hit"
        if out and measure._looks_far:
            out, saves = False, "0 rays: in daylight a background ray for each beam without a hit would cost more"
    # what begins within the gate is an echo; a pulse that comes two half supports later does not reach into it
    last_m = min(model.gate_m, plan.max_range_m) + 2.0 * model.pulse.half_support_m
    return Finding(out, last_m, reach_m, saves, unit="m")


def _soft(measure: Measure, plan: ScanPlan) -> Finding:
    model, air, soft = measure.model, measure.air.at(1e-9 * plan.start_ns), measure._soft
    least, saves = UNSEEN * model.threshold, "the medium's waveform of every beam"
    if not model.weather_echoes:
        return Finding(True, 0.0, least, saves, idle=True, unit="rms noise")
    start_m = max(model.overlap_start_m, model.near_gate_m)
    if soft.uneven(air):
        value = max(soft._bound(one.medium.backscatter_per_m_sr, 0.0, start_m) for one in air.volumes)
        return Finding(False, value, least, saves, unit="rms noise")
    value = soft._bound(air.everywhere.backscatter_per_m_sr, air.everywhere.extinction_per_m, start_m) * plan.gain
    made = soft.everywhere(air, plan.gain)
    if made is None and value < min(least, model.unseen_amplitude):
        return Finding(True, value, min(least, model.unseen_amplitude), saves, unit="rms noise")
    # decided by the medium's own wave, at each range
    whole = SoftTargets(_keeping_media(model), measure._receiver.bin_m).everywhere(air, plan.gain)
    if whole is None:  # no light of it comes within the gate
        return Finding(made is None, value, least, saves, unit="rms noise")
    if model.photons is not None or (made is not None and made.shows):
        value, bound = _nearest_to_showing(whole, model)
        return Finding(made is None, value, bound, saves, unit="rms noise")
    followed = made is not None and made.until_m == math.inf
    until_m = -math.inf if made is None or followed else made.until_m
    if until_m > -math.inf:
        saves = f"the medium's waveform beyond {until_m:.1f} m; nearer, it shifts surface echoes"
    value, bound = _nearest_to_shifting(whole, until_m, model)
    return Finding(not followed, value, bound, saves, unit="rms noise")


def _keeping_media(model: SensorModel) -> SensorModel:
    return replace(model, leave_out=model.leave_out.model_copy(update={"backscatter": False}))


def _nearest_to_showing(whole: SoftProfile, model: SensorModel) -> tuple[float, float]:
    """Return of a medium and what it is compared with, where it comes nearest to an echo of its own."""
    x_m = np.append(_ranges_of(whole), whole.peak_m)
    return _worst(whole.wave(x_m), UNSEEN * np.maximum(model.threshold, model.floor_m2 / np.maximum(x_m, 1e-3) ** 2))


def _nearest_to_shifting(whole: SoftProfile, beyond_m: float, model: SensorModel) -> tuple[float, float]:
    """The same where it comes nearest to shifting another echo by half a step, behind a range and the near gate."""
    x_m = _ranges_of(whole)
    x_m = x_m[(x_m > beyond_m) & (x_m > model.near_gate_m - whole.pulse.half_support_m)]
    if not len(x_m):
        return 0.0, model.unseen_amplitude
    return _worst(whole.wave(x_m), model.unseen_under(model.least_amplitude(x_m)))


def _ranges_of(whole: SoftProfile) -> Floats:
    return whole.bin_m * np.arange(whole.first, whole.first + len(whole.upper), dtype=np.float64)


def _worst(value: Floats, bound: Floats) -> tuple[float, float]:
    at = int(np.argmax(value / bound))
    return float(value[at]), float(bound[at])


def _soft_table(measure: Measure, plan: ScanPlan) -> Finding:
    air = measure.air.at(1e-9 * plan.start_ns)
    used = measure._soft.everywhere(air, plan.gain) is not None
    return Finding(used and measure.model.leave_out.soft_table, None, None, "one table per sweep", idle=not used)


def _sun(measure: Measure, plan: ScanPlan) -> Finding:
    sun, model, unit = measure.air.at(1e-9 * plan.start_ns).sun, measure.model, "W"
    if sun is None:
        saves = "background noise of every beam, one ray to the sun"
        return Finding(True, 0.0, unseen_w(model), saves, idle=True, unit=unit)
    value = largest_diffuse_w(sun, model)
    out = value <= unseen_w(model) and model.leave_out.background_light
    saves = "background noise of every beam, a ray to the sun from each lit surface"
    return Finding(out, value, unseen_w(model), saves, unit=unit)


def _sun_in_view(measure: Measure, plan: ScanPlan) -> Finding:
    sun, model = measure.air.at(1e-9 * plan.start_ns).sun, measure.model
    bound, saves = unseen_w(model), "rays to the sun's disc, stray light and aureole of the beams near it"
    if sun is None:
        return Finding(True, 0.0, bound, saves, idle=True, unit="W")
    value = largest_near_sun_w(sun, measure.view(plan).rays, model)
    return Finding(value <= bound and model.leave_out.background_light, value, bound, saves, unit="W")


def _others(measure: Measure, plan: ScanPlan) -> Finding:
    others, unit = measure.others, "per sweep"
    if others is None:
        return Finding(True, 0.0, RARE, "pulses of every emitter in every gate", idle=True, unit=unit)
    saves = f"pulses of {', '.join(one.id for one in others.found) or 'no emitter'} in every gate"
    if others.elsewhere:
        saves += f"; left out: {', '.join(others.elsewhere)}, stopped by the optical filter"
    return Finding(not others.found, others.pulses_of(len(plan)), RARE, saves, unit=unit)


def _false_alarms(measure: Measure, plan: ScanPlan) -> Finding:
    receiver, unit = measure._receiver, "per sweep"
    if not isinstance(receiver, Receiver) or not measure.model.false_alarms:
        return Finding(True, 0.0, RARE, "random draws of a sweep", idle=True, unit=unit)
    value = receiver.noise_echoes_of(len(plan))
    return Finding(
        value < RARE and measure.model.leave_out.noise_echoes, value, RARE, "random draws of a sweep", unit=unit
    )


def _particles(measure: Measure, plan: ScanPlan) -> Finding:
    view, model, saves = measure.view(plan), measure.model, "drops or flakes of every beam"
    if not view.air.particles:
        return Finding(True, 0.0, RAREST_PARTICLES, saves, idle=True, unit="per sweep")
    # of rain and of snow each is decided by itself
    where = view.seen.nearest_m, view.air.extinction_per_m, plan.gain
    soft = _medium(measure, plan)
    value = max(float(measure._falling.mean_drawn(one, *where, soft).sum()) for one in view.air.particles)
    out = value < RAREST_PARTICLES and model.leave_out.particles
    for one in view.air.particles:
        share, mean = measure._falling.mean_field(one, *where[1:], soft)
        saves += f"; {one.term} below {share:g} of the level enters as its mean, at most {mean:.2g} of the level"
        number, until_m, rms = measure._falling.hidden(one, *where[1:], soft)
        if number > 0.0:
            saves += f"; the medium's return hides {number:.2g} more of each beam up to {until_m:.1f} m, "
            saves += f"their light is {100.0 * rms:.2g} % rms of it"
        left = measure._falling.shadow_left_out(one, *where)
        if left > 0.0:
            saves += f", and casts no flickering shadow: {100.0 * left:.2g} % rms of what stands behind"
    return Finding(out, value, RAREST_PARTICLES, saves, unit="per sweep")


def _leaves(measure: Measure, plan: ScanPlan) -> Finding:
    """Leaves are met by rays: between them, in wide beams, only so many are looked at."""
    table, caster = measure._dry.table, measure._caster
    if caster.bare is caster or not bool(table.leafy.any()):
        return Finding(True, None, None, "rays that go on behind the faces of crowns", idle=True)
    rays = measure._bundles.of(plan).sub_beams
    least_mm = 1e3 * min(one.foliage.cell_m for one in table.materials if one.foliage is not None)
    saves = f"nothing; leaves in cells of {least_mm:.3g} mm and more, met by {rays} rays of each beam"
    return Finding(False, 0.5 / math.sqrt(rays), 1.0, saves, unit="of a beam, rms")


def _waveform(measure: Measure, plan: ScanPlan) -> Finding:
    model, receiver, unit = measure.model, measure._receiver, "m"
    bound = SHORT * model.pulse.half_support_m
    if not isinstance(receiver, Receiver) or not receiver.detector.closed_form:
        return Finding(
            False, None, None, "nothing: only sin2 pulses with leading-edge detection have a closed form", idle=True
        )
    detector, soft, parts = receiver.detector, _medium(measure, plan), _looked_at(measure, plan)
    every, closed, longest = 0, 0, 0.0
    for found in parts:
        short, _ = split_cosines(found, detector, soft)
        every, closed = every + len(found), closed + int(short.size.sum())
        if len(short):
            longest = max(longest, float(np.max(found.range_m[short.start + short.size - 1] - short.first_m)))
    out = model.leave_out.waveform and (soft is None or soft.peak < detector.full_scale)
    saves = f"waveform samples for {closed} of {every} reflections, and for a medium without a surface echo"
    return Finding(out, longest, bound, saves, unit=unit)


def _electronics(measure: Measure, plan: ScanPlan) -> Finding:
    there = measure.model.response is not None
    return Finding(not there, None, None, "sampling all windows, noise in them", idle=not there)


def _bounces(measure: Measure, plan: ScanPlan) -> Finding:
    model, view = measure.model, measure.view(plan)
    bound, unit = BEHIND * model.threshold, "rms noise"
    if not (view.surfaces.sends_on and model.bounces > 0):
        return Finding(True, 0.0, bound, "secondary rays and their air path", idle=True, unit=unit)
    t_s = 1e-9 * plan.start_ns + plan.fire_offset_s
    with np.errstate(under="ignore"):
        # of the axes alone nothing goes on: beams that are plain see no mirror and no pane
        pose = measure._pose(t_s, plan.origin_m)
        rays = view.rays if view.plain is None else cast_rays(measure._bundles.of(plan), pose, t_s)
        hits = measure._caster.first_hits(rays.origin_m, rays.direction, rays.t_s)
        best = best_behind(hits, rays, view.surfaces, view.air, model, plan.gain, plan.max_range_m)
    gone = int(np.count_nonzero(best <= bound)) if model.leave_out.second_rays else 0
    value = float(best.max(initial=0.0))
    saves = f"{gone} of {len(best)} secondary rays and their air path"
    return Finding(gone == len(best), value, bound, saves, idle=not len(best), unit=unit)


def _faint(measure: Measure, plan: ScanPlan) -> Finding:
    model, bound, unit = measure.model, most_dropped(measure.model), "rms noise"
    if not isinstance(measure._receiver, Receiver):
        return Finding(False, None, None, "nothing: a photon-counting receiver counts all of them", idle=True)
    soft, every, gone, value = _medium(measure, plan), 0, 0, 0.0
    for given in _given(measure, plan):
        kept = looked_at(given, soft, model)
        every, gone = every + len(given), gone + len(given) - len(kept)
        lost = np.bincount(given.beam, given.amplitude, len(plan)) - np.bincount(kept.beam, kept.amplitude, len(plan))
        value = max(value, float(lost.max(initial=0.0))) if len(kept) < len(given) else value
    saves = f"{gone} of {every} reflections"
    if not gone and soft is not None and soft.until_m == math.inf:
        saves += ": backscatter is computed everywhere, and these surfaces end it"
    elif not gone and model.leave_out.faint:
        behind = "" if soft is None or soft.until_m == -math.inf else f" behind {soft.until_m:.1f} m of a medium"
        saves += f": too few are below the limit{behind} to repay the test"
    return Finding(gone > 0, value, bound, saves, unit=unit)


def _medium(measure: Measure, plan: ScanPlan) -> SoftProfile | None:
    """The medium that the receiver is given."""
    return measure._soft.everywhere(measure.view(plan).air, plan.gain)


def _given(measure: Measure, plan: ScanPlan) -> list[SubEchoes]:
    """Reflections that the receiver is given: of beams that see what they saw before, and of all others."""
    view = measure.view(plan)
    if view.kept is None:
        return [view.found]
    return [view.kept.found, *([view.found] if bool(view.kept.changed.any()) else [])]


def _looked_at(measure: Measure, plan: ScanPlan) -> list[SubEchoes]:
    """The same without the faint ones."""
    return [looked_at(found, _medium(measure, plan), measure.model) for found in _given(measure, plan)]


def _exact(saves: str) -> Callable[[Measure, ScanPlan], Finding]:
    return lambda measure, plan: Finding(True, None, None, saves)


def _kept(reason: str) -> Callable[[Measure, ScanPlan], Finding]:
    return lambda measure, plan: Finding(False, None, None, reason)


RULES: tuple[Rule, ...] = (
    Rule("clear-air extinction", "clear_air", "once per sweep",
         "two-way optical depth changes the reported range by less than half a quantization step", _clear_air),
    Rule("footprint sub-rays", "closed_form", "once per sweep; once for static beams",
         "no edge within plain_radii beam radii: exp(-2 k^2) of the power lies outside", _closed_form),
    Rule("sub-rays of narrow beams", "narrow_beams", "once per beam",
         "axis and probes meet one material on one plane within half a quantization step, no retro-reflector is near; "
         "strips of it, computed, shift a crossing by a quarter of a step at the most, and where probes see the same "
         "through a pane and in it they do themselves; value: the largest share of the light behind a straight edge "
         "that no probe meets", _narrow_beams),
    Rule("tail of the beam", None, "once per sweep",
         "edges of ordinary surfaces beyond the bundle's outermost ray stay below the threshold; those of surfaces "
         "with an equivalent reflectance from 10 on get rays of their own, with every rule off as well", _tail),
    Rule("sub-ray ranges on planes", "plane_moments", "once per beam",
         "mean, energy and variance over a tilted plane change no range by a quarter of a quantization step, and no "
         "threshold crossing by an eighth", _plane_moments),
    Rule("acceleration-structure rebuild", None, "never needed", "rays are transformed instead, in float64",
         _exact("every rebuild")),
    Rule("ray casts on static bodies", "resting", "once for a static sensor",
         "the same rays have the same hits, bit for bit", _resting),
    Rule("surfaces beyond the gate", "far_objects", "once per sweep",
         "farther than the range gate and one pulse no echo forms; in daylight such a surface is background",
         _far_objects),
    Rule("background light", "background_light", "once per sweep",
         "its shot noise adds less than 2e-3 to the noise variance, and shifts no threshold crossing by half a "
         "quantization step", _sun),
    Rule("sun in view", "background_light", "once per sweep",
         "the same for the disc, the aureole and the stray light of the sun in the beam that gets most of them",
         _sun_in_view),
    Rule("pulses of other lidars", None, "once per sweep",
         "no emitter within the optical filter; of a pulse that arrives in a gate, below a hundredth of the threshold",
         _others),
    Rule("noise false alarms", "noise_echoes", "once per sweep", "mean count per sweep below 1e-6", _false_alarms),
    Rule("atmospheric backscatter", "backscatter", "once per state of the weather",
         "its return is below a tenth of the threshold; it is computed where it shifts a threshold crossing by half a "
         "quantization step", _soft),
    Rule("backscatter tables", "soft_table", "once per state of the weather", "exact in homogeneous air", _soft_table),
    Rule("precipitation particles", "particles", "once per state of the weather, draws per sweep",
         "no precipitation, or fewer than 1e-3 particles per sweep exceed the threshold", _particles),
    Rule("leaves", None, "once for a static sensor, else per sweep",
         "each ray meets leaves with the gap probability exactly; where leaves are smaller than the distance of the "
         "rays of a beam, its share in the gaps flickers more than it should, at most as independent rays do", _leaves),
    Rule("waveform sampling", "waveform", "once per cluster of reflections",
         "a cluster shorter than half a pulse is a closed-form sum of cosines; longer clusters are sampled", _waveform),
    Rule("receiver electronics", None, "once per sensor",
         "shaped pulses, correlated noise, clipping, tail and undershoot exist with physics.response only; they are "
         "computed with numpy arrays in every window with light near the threshold, with fast as well", _electronics),
    Rule("secondary rays", "second_rays", "once per scene, then per ray",
         "no surface reflects specularly or transmits 1 %, or the best surface behind returns less than 5 % of the "
         "threshold", _bounces),
    Rule("motion within a sweep", None, "never", "one pose for all rays would save nothing: each ray is transformed "
         "in either case", _kept("nothing")),
    Rule("weak reflections", "faint", "once per sweep",
         "each below 1e-3 of the threshold; those of one beam together below 1e-2 of it and half a quantization step",
         _faint),
    Rule("outputs not requested", None, "never computed",
         "waveforms are sampled only for timing, echoes are listed up to the number in the plan; recordings hold the "
         "rest", _exact("lists of echoes, waveforms")),
)  # fmt: skip
"In the order of section 8 of the physics."


def explained(measure: Measure, plan: ScanPlan) -> list[dict[str, Any]]:
    """Every rule for this sensor: name, switch, left out or kept, value, bound, margin, what leaving it out saves."""
    found = []
    for rule in RULES:
        finding = rule.find(measure, plan)
        row = {"term": rule.name, "switch": rule.switch, "when": rule.when, "why": rule.why, **asdict(finding)}
        margin = finding.margin
        margin = margin if margin is None or math.isfinite(margin) else None
        found.append({**row, "exact": finding.exact, "margin": margin})
    return found


def usual_plan(spec: SensorSpec) -> ScanPlan:
    """A sweep such as this model makes: its own table, a slice, half a degree over 180 degrees, an eighth over 360."""
    from emulator.sensing.table import table_plan

    if spec.beams is not None:
        return table_plan(spec, 0)
    if spec.family in ("velodyne", "ouster", "hesai", "livox"):
        return first_plan(spec)
    usual = {
        "ld": (0.125, 360.0, 0.1),
        "scip": (0.25, 270.0, 0.025),
        "rplidar": (0.3, 360.0, 1.0 / 7.0),
        "ldrobot": (0.8, 360.0, 0.1),
        "ydlidar": (0.504, 360.0, 1.0 / 7.0),
    }
    step, field, period = usual.get(spec.family or "", (0.5, 180.0, 2.0 / 75.0))
    n = round(field / step) + (field < 360.0)
    index = np.arange(n)
    azimuth = np.radians(index * step - 0.5 * field)
    far = math.inf if spec.receiver is None else spec.receiver.gate_m.value
    return ScanPlan(0, 0, 0, azimuth, np.zeros(n), index * period / n, period, max_range_m=far, wants_intensity=True)


def first_plan(spec: SensorSpec) -> ScanPlan:
    """The first sweep that a device of this model asks for, with its motor at speed."""
    waits = [
        "boot_s",
        *(["spin_up_s"] if spec.family != "livox" else []),
        *(["init_s"] if spec.family == "ouster" else []),
    ]
    session = family(spec.family or "").new_session(dict.fromkeys(waits, 0.0), spec.device)
    session.connected(0, Address(0, 0), LinkKind.DATAGRAM)
    session.power_on(0)
    session.advance(0)
    plan = session.next_plan()
    assert plan is not None
    return plan
