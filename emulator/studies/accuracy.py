"""Study `accuracy`: what accuracy costs, error against run time and against rays, rule by rule.

Belongs here: the order of the work, tables, what follows for rule and number of sub-beams. Not: the errors themselves
(accuracy_rules, accuracy_path, accuracy_knobs), drawing (accuracy_pictures).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from emulator.studies import accuracy_knobs as knobs
from emulator.studies import accuracy_leaving as leaving
from emulator.studies import accuracy_narrow as narrow
from emulator.studies import accuracy_pictures as pictures
from emulator.studies import accuracy_rules as rules
from emulator.studies import accuracy_targets as targets
from emulator.studies.accuracy_acceptance import DEFAULT, Curves, acceptance
from emulator.studies.accuracy_path import PRODUCT, Edges, Run
from emulator.studies.accuracy_rules import FIXED, TITLES
from emulator.studies.report import Column, Report, Section, Table, Value

NAME = "accuracy"
TITLE = "Error against run time"
REPEATS = 10
ALLOWED = (5e-2, 2e-2, 1e-2, 5e-3, 2e-3, 1e-3)
"Errors of a share for which a rule is recommended."
HOLDS = 0.9
"Share of the turns in which a rule must take the least time to be recommended for it."
TIE = 1.15
"Rules whose numbers of sub-beams differ by less than the place of the edges makes them differ count as equal."


@dataclass(frozen=True)
class Effort:
    """How much is computed."""

    counts: tuple[int, ...]
    "Sub-beams, bare numpy."
    targets: int
    "Edges, wires, planes a repeat."
    scenes: int
    "Composed scenes a repeat."
    path_counts: tuple[int, ...]
    "Sub-beams through the product."
    path_beams: int
    "Edges a repeat through the product."
    depths: tuple[int, ...]
    "Rounds of splitting."
    sweeps: int
    phases: int
    point_counts: tuple[int, ...]
    scenarios: tuple[str, ...] = ("flat_wall", "street", "bumper")
    "Measured with all terms and with what is not seen left out."
    alone: tuple[str, ...] = ("standard",)
    "Measured with each rule of leaving out alone."
    repeats: int = 3
    "Sweeps of each of these."
    hard_beams: int = 100
    hard_turns: int = 5
    "Targets that are hard for a bundle: beams, and how often all rules take turns on them."
    narrow_beams: int = 600
    "Beams of sensors with narrow beams, in each scene."


FULL = Effort(
    (16, 32, 61, 128, 256, 512, 1024, 4096, 16384), 400, 6, (16, 32, 61, 128, 256, 512, 1024, 4096), 100,
    (0, 1, 2, 3, 4, 5, 6), 20, 100, (8, 16, 32, 61, 128, 256, 512), alone=("standard", "street", "bumper"),
    repeats=7,
)  # fmt: skip
QUICK = Effort(
    (16, 61, 256, 1024, 4096), 150, 2, (16, 61, 256, 1024), 40, (0, 1, 2, 3, 4, 5), 6, 50, (16, 61, 256),
    scenarios=("flat_wall", "bumper"), narrow_beams=200,
)  # fmt: skip


TARGETS = {
    "edge": "share of the power on a half plane",
    "wire": "share on a wire of a tenth of the beam's radius, relative to the mean",
    "plane": "energy of a plane at 80 degrees, 12.9 mrad, relative",
    "composed": "energy of wire, edge and tilted wall together, relative",
    "composed_range": "mean range of the same (m)",
}


def run(effort: Effort, steps: Callable[[list[str]], Iterator[str]] = iter) -> Report:
    """The whole report; `steps` yields the names of the parts as they begin, for a progress bar."""
    names = [*(f"numpy: {TITLES[rule]}" for rule in (*FIXED, "adaptive")), "composed scenes: reference"]
    names += [f"product: turn {turn + 1} of {REPEATS}" for turn in range(REPEATS)] + ["hard targets", "mirror"]
    names += ["bins and fog", "instants", "threads", "leaving out", "each rule of leaving out"]
    names += ["narrow beams", "points", "drawing"]
    progress = steps(names)
    curves: Curves = {target: {} for target in TARGETS}
    for rule in (*FIXED, "adaptive"):
        next(progress)
        simple(rule, effort, curves)
    next(progress)
    composed(effort, curves)
    with Edges(REPEATS, effort.path_beams) as scene:
        settings = [(rule, n) for rule in FIXED for n in effort.path_counts] + [("adaptive", n) for n in effort.depths]
        made = scene.in_turns(settings, lambda _: next(progress))
    runs = {rule: [one for one in made if one.rule == rule] for rule in (*FIXED, "adaptive")}
    next(progress)
    hard = targets.hard(effort.hard_beams, effort.hard_turns)
    next(progress)
    mirrored = targets.mirrored(effort.scenes)
    next(progress)
    bins, fog = knobs.bins(), knobs.fog()
    next(progress)
    instants = knobs.steps()
    next(progress)
    threads = knobs.threads(effort.sweeps)
    next(progress)
    left_out = leaving.pruning(effort.scenarios, effort.sweeps)
    next(progress)
    each = leaving.each_rule(effort.alone, effort.repeats)
    next(progress)
    probed = narrow.narrow(effort.narrow_beams, effort.repeats)
    next(progress)
    points = knobs.point_counts(("spiral", "grid", "laguerre"), effort.point_counts, effort.phases)
    next(progress)
    held = acceptance(curves, runs, bins, fog, points)
    advised = advice(curves, runs)
    sections = (
        Section(
            "What to choose",
            chosen_text(curves, runs, advised),
            (pictures.default(runs),),
            (advised, held),
        ),
        Section(
            "Rules on known answers",
            (
                "Bare numpy in float64, no mesh and no ray caster: half planes and wires at random places within one "
                "radius of the axis and random turns, planes tilted by 80 degrees, and scenes in which a wire hides an "
                f"edge and both hide a tilted wall. {REPEATS} repeats with other targets; the median, and the least "
                'and largest as a band. References: closed forms; for composed scenes 2^20 sub-beams. "adaptive" '
                "splits only cells that are worth it (physics.adaptive.worthwhile).",
                "On smooth surfaces Gauss rules are exact to rounding from 16 sub-beams on, and useless at edges; the "
                "rules that spread points evenly are the other way round. A single plane needs no bundle at all: its "
                "closed form is right to 1e-6.",
            ),
            (pictures.by_rays(curves),),
            (curve_table(curves), slope_table(curves, runs)),
        ),
        Section(
            "Through the product",
            (
                f"{REPEATS} times {effort.path_beams} beams of one sensor, each at its own random edge: a plane at 20 "
                "m before another at 20.7 m, so the pulses overlap. Scenario, mesh files, embreex, sub-beams, "
                "receiver; every term computed (`full: true`). Rules that a scenario can choose (spiral, laguerre, "
                "grid, adaptive) run through the measuring function itself, the others give their nodes to the "
                "functions that it calls. Range: peak of the summed pulse, against the two echoes of the closed "
                "form in the "
                "same receiver. Detection: probability that the near echo is found at a threshold of 5 rms noise, "
                "full beam 10. Time is CPU time of sub-beams, cast, echoes and "
                "receiver on one core of this machine; all rules take turns, each after a sweep that is not timed.",
            ),
            (pictures.quantities(runs), pictures.efficiency(runs)),
            (path_table(runs), turns_table(runs)),
        ),
        Section(
            "Hard targets, and mirrored scenes",
            (
                "Targets at which a bundle errs by more than at an ordinary edge, each with the rules that a scenario "
                "can choose, with numpy arrays and with compiled loops.",
                "The spiral turns one way, so a scene and its mirror image have other errors: of opposite chirality, "
                "of the same size. A bundle that is its own mirror image is no better for it: its nodes come in pairs, "
                "and at edges of any direction it errs by more.",
            ),
            (),
            (hard, mirrored),
        ),
        Section(
            "Other settings",
            ("What is not the rule: sampling, fog, motion, threads, and points counted on a plate.",),
            (pictures.settings(bins, fog, instants, points),),
            (bins, fog, instants, threads, points),
        ),
        Section(
            "Leaving out",
            (
                "What a scene does not need is not computed; bounds and switches: `lidaremu explain`. Here is what "
                "each rule saves in rays and time, alone and all together, and that scans stay what they were.",
                "Narrow beams of sensors of many layers have probes, not bundles, where they see smooth surfaces.",
            ),
            (pictures.leaving_out(each),),
            (each, left_out, probed),
        ),
    )
    report = Report(NAME, TITLE, summary(curves, runs, held), sections)
    for _ in progress:
        raise AssertionError("a part without a name")
    return report


# ------------------------------------------------------------------------------- the work
def simple(rule: str, effort: Effort, curves: Curves) -> None:
    """Edges, wires and planes."""
    for target in ("edge", "wire") if rule == "adaptive" else ("edge", "wire", "plane"):
        curve = []
        for count in effort.depths if rule == "adaptive" else effort.counts:
            cast: list[float] = []
            errors: list[float] = []
            for repeat in range(REPEATS):
                rng = np.random.default_rng([repeat, 7])
                if target == "plane":
                    made, error = rules.plane_error(rule, count, effort.targets // 8, rng)
                else:
                    strips = (rules.edges if target == "edge" else rules.wires)(effort.targets, rng)
                    if rule == "adaptive":
                        split, error = rules.adaptive_error(count, strips)
                        cast.append(split)
                    else:
                        made, error = rules.fixed_error(rule, count, strips, rng)
                    error /= 1.0 if target == "edge" else float(np.mean(strips.share))
                errors.append(error)
                if rule != "adaptive":
                    cast.append(float(made))
            curve.append((float(np.mean(cast)), tuple(errors)))
        curves[target][rule] = curve


def composed(effort: Effort, curves: Curves) -> None:
    """Composed scenes, all rules on the same ones."""
    made = [rules.layers(effort.scenes, np.random.default_rng([repeat, 11])) for repeat in range(REPEATS)]
    nodes = FIXED["spiral"](rules.REFERENCE, np.random.default_rng(0))
    exact = [scene.energy(nodes) for scene in made]
    for rule in FIXED:
        energy, range_m = [], []
        for count in [one for one in effort.counts if one <= 4096]:
            rng = np.random.default_rng(count)
            found = [rules.layers_error(rule, count, *pair, rng) for pair in zip(made, exact, strict=True)]
            rays = float(found[0][0])
            energy.append((rays, tuple(one[1] for one in found)))
            range_m.append((rays, tuple(one[2] for one in found)))
        curves["composed"][rule], curves["composed_range"][rule] = energy, range_m


# ------------------------------------------------------------------------------- tables
def median_curve(curves: Curves, target: str, rule: str) -> tuple[list[float], list[float]]:
    """Rays and median errors."""
    curve = curves[target][rule]
    return [rays for rays, _ in curve], [float(np.median(errors)) for _, errors in curve]


def curve_table(curves: Curves) -> Table:
    """Every error in bare numpy."""
    rows: list[tuple[Value, ...]] = []
    for target, of in curves.items():
        for rule, curve in of.items():
            for rays, errors in curve:
                rows.append((target, rule, rays, float(np.median(errors)), min(errors), max(errors)))
    return Table(
        "accuracy_rules",
        "Errors by rule and rays",
        (
            Column("target", "target"),
            Column("rule", "rule"),
            Column("rays", "rays/beam", ".0f"),
            Column("error", "error", ".1e"),
            Column("least", "least", ".1e"),
            Column("largest", "largest", ".1e"),
        ),
        tuple(rows),
        "; ".join(f"{name}: {text}" for name, text in TARGETS.items())
        + f". Root mean square; median, least and largest of {REPEATS} repeats.",
    )


def path_table(runs: dict[str, list[Run]]) -> Table:
    """Every error and time through the product."""
    rows: list[tuple[Value, ...]] = []
    for rule, of in runs.items():
        for one in of:
            seconds, energy = np.asarray(one.seconds), np.asarray([e.energy for e in one.errors])
            rest = [float(np.median([getattr(e, name) for e in one.errors])) for name in OTHER]
            middle, time_s = float(np.median(energy)), float(np.median(seconds))
            rows.append((rule, one.count, one.rays, 1e6 * time_s, 1e6 * float(seconds.min()),
                         1e6 * float(seconds.max()), middle, float(energy.min()), float(energy.max()), *rest,
                         1.0 / (middle**2 * time_s)))  # fmt: skip
    return Table(
        "accuracy_path",
        "Errors and times through the product",
        (
            Column("rule", "rule"),
            Column("count", "sub-beams or rounds", "d"),
            Column("rays", "rays/beam", ".0f"),
            Column("us", "us/beam", ".1f"),
            Column("us_least", "least", ".1f"),
            Column("us_largest", "largest", ".1f"),
            Column("energy", "energy", ".1e"),
            Column("energy_least", "least", ".1e"),
            Column("energy_largest", "largest", ".1e"),
            Column("range_m", "range (m)", ".1e"),
            Column("detection", "detection", ".1e"),
            Column("waveform", "waveform", ".1e"),
            Column("efficiency", "1/(error^2 time) (1/s)", ".1e"),
        ),
        tuple(rows),
        f"Median, least and largest of {REPEATS} repeats. Rule adaptive: rounds of splitting from 64 cells.",
    )


OTHER = ("range_m", "detection", "waveform")


def slope_table(curves: Curves, runs: dict[str, list[Run]]) -> Table:
    """Orders: least squares over the last three points in logarithms."""
    rows: list[tuple[Value, ...]] = []
    for rule, of in runs.items():
        fitted: list[Value] = []
        for target in TARGETS:
            here = curves[target].get(rule)
            fitted.append(
                _number(rules.slope(*median_curve(curves, target, rule))) if here and target != "plane" else None
            )
        rays, energy = product_curve(of)
        fitted.append(_number(rules.slope(rays, energy)))
        fitted.append(_number(rules.slope([float(np.median(one.seconds)) for one in of], energy)))
        rows.append((TITLES[rule], *fitted))
    return Table(
        "accuracy_slopes",
        "Fitted orders over the last three points",
        (
            Column("rule", "rule"),
            *(Column(target, target.replace("_", " "), ".2f") for target in TARGETS),
            Column("product_rays", "product, by rays", ".2f"),
            Column("product_time", "product, by time", ".2f"),
        ),
        tuple(rows),
        "Planes have no order: Gauss rules are at rounding from the start, see the table above.",
    )


def _number(value: float) -> float | None:
    return value if np.isfinite(value) else None


def advice(curves: Curves, runs: dict[str, list[Run]]) -> Table:
    """Rule and number of sub-beams for an allowed error of the share on an edge."""
    rows: list[tuple[Value, ...]] = []
    for allowed in ALLOWED:
        found: dict[str, float] = {}
        for rule in (*FIXED, "adaptive"):
            curve = product_curve(runs[rule]) if rule == "adaptive" else median_curve(curves, "edge", rule)
            rays = rules.needed(*curve, allowed)
            if rays is not None:
                found[rule] = rays
        spiral = found.get("spiral")
        first = min(found, key=lambda name: found[name]) if found else None
        if first is None:
            rows.append((allowed, *(None,) * 9))
            continue
        # equal within what the place of the edges does: the spiral, which has any number and no direction of its own
        named = "spiral" if spiral is not None and spiral <= TIE * found[first] else first
        times = {name: time for name in PRODUCT if (time := _time_for(runs[name], allowed)) is not None}
        fastest, won = in_every_turn(runs, allowed)
        untimed = "; ".join(_untimed(name, runs[name], found.get(name)) for name in PRODUCT if name not in times)
        spread = [one for turn in range(REPEATS) if fastest and (one := _time_in(runs[fastest], allowed, turn))]
        rows.append((allowed, TITLES[named], found[named], spiral, found.get("adaptive"),
                     TITLES[fastest] if fastest else None, won, *(
                         1e6 * float(one(spread)) if spread else None for one in (np.median, np.min, np.max)
                     ), untimed or None))  # fmt: skip
    return Table(
        "accuracy_advice",
        "Rule and sub-beams for an allowed error of the share on an edge",
        (
            Column("allowed", "allowed (RMS)", ".0e"),
            Column("rule", "fewest rays"),
            Column("rays", "rays/beam", ".0f"),
            Column("spiral", "spiral needs", ".0f"),
            Column("adaptive", "adaptive needs", ".0f"),
            Column("fastest", "least time in the product in repeated turns, of rules run so far"),
            Column("won", "turns", ""),
            Column("us", "us/beam", ".1f"),
            Column("us_least", "least", ".1f"),
            Column("us_largest", "largest", ".1f"),
            Column("untimed", "not run so far"),
        ),
        tuple(rows),
        "Between computed points by straight lines in logarithms. A rule that needs at most 15 % fewer rays than the "
        "spiral counts as equal to it (adaptive: as the product splits, edges of its own scene): "
        "the spiral takes any number and favours no direction. An error under that of "
        "the smallest number tried is given with that number. Thin wires need more: see the curves. Times are compared "
        "among rules that were run through the product down to that error; the others may take less, and are listed: "
        "about what they would take with the rays that they need in bare numpy, at the time a ray of their last run.",
    )


def in_every_turn(runs: dict[str, list[Run]], allowed: float) -> tuple[str | None, str | None]:
    """The rule that takes the least time for an error, and in how many turns it does; None where that changes.

    Every turn has its own edges and sees its own moment of the machine. What wins in fewer than `HOLDS` of them is not
    recommended, but reported.
    """
    winners = []
    for turn in range(len(runs["spiral"][0].seconds)):
        times = {name: one for name in PRODUCT if (one := _time_in(runs[name], allowed, turn)) is not None}
        if times:
            winners.append(min(times, key=lambda name: times[name]))
    if not winners:
        return None, None
    count = {name: winners.count(name) for name in PRODUCT if name in winners}
    best = max(count, key=lambda name: count[name])
    if count[best] >= HOLDS * len(winners):
        return best, f"{count[best]} of {len(winners)}"
    return None, "; ".join(f"{TITLES[name]} in {n} of {len(winners)}" for name, n in count.items())


def _time_in(of: list[Run], allowed: float, turn: int) -> float | None:
    """Seconds a beam for an error, by the times of one turn and the errors of all."""
    errors = product_curve(of)[1]
    return rules.needed([one.seconds[turn] for one in of], errors, allowed)


def turns_table(runs: dict[str, list[Run]]) -> Table:
    """Times over that of the default in the same turn."""
    base = np.asarray(default_run(runs).seconds)
    rows: list[tuple[Value, ...]] = []
    for rule, of in runs.items():
        for one in of:
            ratio = np.asarray(one.seconds) / base
            rows.append((rule, one.count, float(np.median(ratio)), float(ratio.min()), float(ratio.max())))
    return Table(
        "accuracy_turns",
        "Times over that of the default in the same turn",
        (
            Column("rule", "rule"),
            Column("count", "sub-beams or rounds", "d"),
            Column("ratio", "ratio", ".2f"),
            Column("least", "least", ".2f"),
            Column("largest", "largest", ".2f"),
        ),
        tuple(rows),
        "Rules and numbers take turns, so what else the machine does falls on all of them alike: ratios repeat where "
        "times do not.",
    )


def _untimed(name: str, of: list[Run], rays: float | None) -> str:
    """A rule that was not run down to an error, and about what it would take with so many rays."""
    last = of[-1]
    if rays is None or rays <= last.rays:
        return TITLES[name]
    return f"{TITLES[name]}: about {1e6 * float(np.median(last.seconds)) * rays / last.rays:.0f} us"


def product_curve(of: list[Run]) -> tuple[list[float], list[float]]:
    """Rays and median errors of the energy through the product."""
    return [one.rays for one in of], [float(np.median([e.energy for e in one.errors])) for one in of]


def _time_for(of: list[Run], allowed: float) -> float | None:
    return rules.needed([float(np.median(one.seconds)) for one in of], product_curve(of)[1], allowed)


# ------------------------------------------------------------------------------- words
def default_run(runs: dict[str, list[Run]]) -> Run:
    """What the product does when nothing is chosen."""
    return next(one for one in runs["spiral"] if one.count == DEFAULT)


def default_text(curves: Curves, runs: dict[str, list[Run]]) -> str:
    """What the default costs and how wrong it can be."""
    one = default_run(runs)
    us = 1e6 * float(np.median(one.seconds))
    energy, range_mm, detection, wave = (
        scale * float(np.median([getattr(e, name) for e in one.errors]))
        for name, scale in (("energy", 100.0), ("range_m", 1e3), ("detection", 1.0), ("waveform", 100.0))
    )
    rays, errors = median_curve(curves, "wire", "spiral")
    wire = 100.0 * errors[rays.index(float(DEFAULT))]
    return (
        f"The default, {DEFAULT} sub-beams on a spiral, costs {us:.0f} us per beam here when all of them are cast, "
        f"{1e-3 * 361 * us:.1f} ms for a sweep of 361 beams. At a random edge the echo is then off by {energy:.1f} % "
        f"of the beam's power, the range between two planes 0.7 m apart by {range_mm:.0f} mm, the probability of "
        f"detection by {detection:.3f} and the waveform by {wave:.1f} % of its peak (root mean square). A wire of a "
        f"tenth of the beam's radius is off by {wire:.0f} % of its echo."
    )


def chosen_text(curves: Curves, runs: dict[str, list[Run]], advised: Table) -> tuple[str, ...]:
    """Chapter one."""
    row = next(one for one in advised.rows if one[0] == 2e-2)
    spiral, best = float(row[3] or 0.0), float(row[2] or 0.0)
    follows = (
        f"Allowed is an error of 2 % of the power on an edge: it shifts a probability of detection at twice the "
        f"threshold by 0.03 at most on average. The fewest rays for that are {best:.0f} ({row[1]}); the spiral needs "
        f"{spiral:.0f}, and {DEFAULT} leave a margin. Rings with every other one turned and Gauss-Legendre rings lie "
        "within a few per cent of the spiral, which takes any number and favours no direction. So the product's "
        f"defaults follow: rule spiral, {DEFAULT} sub-beams (LMS2xx, LD-LRS1000); 256 where a sensor has "
        f"few beams. `adaptive` needs fewer rays for small errors on edges, but more time a ray: {overtakes(runs)}. "
        "A wire between its first cells is missed. `laguerre` is for smooth surfaces only."
    )
    split = [(rays, error) for rays, error in zip(*product_curve(runs["adaptive"]), strict=True) if rays <= 1000.0][-1]
    cells = (
        f"Through the product `adaptive` reaches {split[1]:.1e} with {split[0]:.0f} rays at a "
        "random edge: only cells whose share is worth it are split. Walls at a slant are where a bundle errs without "
        "any edge: see the table of terms left out."
    )
    return follows, cells


def overtakes(runs: dict[str, list[Run]]) -> str:
    """From which error on `adaptive` takes less time than the spiral does, extended by its order."""
    spiral, split = (
        np.log(
            [(float(np.median([e.energy for e in one.errors])), float(np.median(one.seconds))) for one in runs[rule]]
        )
        for rule in ("spiral", "adaptive")
    )
    order = np.polyfit(spiral[-3:, 0], spiral[-3:, 1], 1)
    faster = [error for error, seconds in split if seconds < np.polyval(order, error)]
    if not faster:
        return "the spiral is faster at every error that was run"
    return f"it is the faster one from {math.exp(faster[0]):.0e} on, where the spiral's time is extended by its order"


def summary(curves: Curves, runs: dict[str, list[Run]], held: Table) -> tuple[str, ...]:
    """Head of the page."""
    met = sum(1 for value in held.column("held") if value)
    return (
        "How wrong a simulated echo is, against what it costs in rays and in time: for every rule that spreads a "
        "beam's power over sub-beams, on answers that are known.",
        default_text(curves, runs),
        f"Acceptance: {met} of {len(held.rows)} numbers met.",
    )
