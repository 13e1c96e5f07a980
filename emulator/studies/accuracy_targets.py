"""Targets that are hard for a bundle: a bright edge, a wire, flakes, wide beams; and scenes beside their mirror images.

Belongs here: cost against error there, rule by rule, with numpy arrays and by compiled loops. Not: random edges of
ordinary
surfaces (accuracy_rules, accuracy_path).
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from emulator.compiled import switch
from emulator.physics import beams
from emulator.physics.arrays import Floats
from emulator.physics.beams import Bundle
from emulator.process.clock import CpuClock
from emulator.scenario import scenario
from emulator.sensing.measure import build as build_measure
from emulator.studies import accuracy_rules as rules
from emulator.studies.accuracy_path import SENSOR, CountingCaster
from emulator.studies.report import Column, Table, Value
from emulator.studies.stage import ACROSS
from emulator.world import scene
from protocols.scan import ScanPlan

RULES: tuple[dict[str, Any], ...] = (
    {"rule": "spiral", "sub_beams": 16},
    {"rule": "spiral", "sub_beams": 61},
    {"rule": "spiral", "sub_beams": 256},
    {"rule": "spiral", "sub_beams": 1024},
    {"rule": "grid", "sub_beams": 64},
    {"rule": "laguerre", "sub_beams": 64},
    {"rule": "adaptive", "depth": 4},
)
REFERENCE = {"rule": "spiral", "sub_beams": 1 << 14}
RANGE_M, WALL_M = 20.0, 30.0
NEAR_M = 25.0
"What lies nearer belongs to the target, and not to the wall behind it."
LIT = 0.1
"Share of the largest echo from which on a beam counts as lit by the target: errors are over the mean of those."


@dataclass(frozen=True)
class Hard:
    """A scene ahead of a sensor, and where its beams look."""

    name: str
    world: tuple[dict[str, Any], ...]
    half_width_rad: float
    "Beams lie evenly over this angle to both sides."
    physics: Mapping[str, Any]
    weather: Mapping[str, Any]
    model: str = "sick-lms291-s05"
    elevation_rad: float = 0.0


def _plate(at_m: float, width_m: float, material: str, height_m: float = 50.0, yaw_deg: float = 7.0) -> dict[str, Any]:
    return {
        "plane": {"size_m": [height_m, width_m]}, "at_m": [at_m, 0.0, 0.0], "material": material, **ACROSS,
        "yaw_deg": yaw_deg,
    }  # fmt: skip


def targets() -> tuple[Hard, ...]:
    """What a bundle is tried on."""
    wall = _plate(WALL_M, 100.0, "grey", yaw_deg=0.0)
    found = [
        Hard("a retroreflector's edge", (_plate(RANGE_M, 0.6, "retro_sheeting"),), 0.04, {}, {}),
        Hard("a wire of 10 mm before a wall", (_plate(RANGE_M, 0.01, "grey"), wall), 0.01, {}, {}),
        Hard("snow of 2 mm/h before a wall", (wall,), 0.5, {}, {"snow": {"rate_mm_h": 2.0, "kind": "dry"}}),
    ]
    for degrees in (0.1, 0.2, 0.4):
        beam = {"divergence_deg": degrees, "exit_diameter_mm": 0.0}
        plates = (_plate(RANGE_M, 0.3, "grey", 0.3), wall)
        found.append(
            Hard(f"3-D beam of {degrees:g} degrees, corner of a plate", plates, 0.012, beam, {}, elevation_rad=7.0e-3)
        )
    return tuple(found)


@dataclass
class Timed:
    """One rule on one target."""

    rays: float
    error: float
    missed: float
    seconds: dict[bool, list[float]]
    "With numpy arrays (False) and by loops (True), one for each turn."


def hard(count: int, turns: int) -> Table:
    """Cost against error: `count` beams on each target, all rules in `turns` turns."""
    forms = (False, True) if switch.kernels() is not None else (False,)
    rows: list[tuple[Value, ...]] = []
    for target in targets():
        for chosen, one in measured(target, count, turns, forms).items():
            cells: list[Value] = []
            for form in (False, True):
                us = 1e6 * np.asarray(one.seconds.get(form, []))
                cells += [float(np.median(us)), float(us.min()), float(us.max())] if len(us) else [None] * 3
            rows.append((target.name, chosen, one.rays, one.error, one.missed, *cells))
    return Table(
        "accuracy_hard",
        "Hard targets: cost against error",
        (
            Column("target", "target"),
            Column("rule", "rule"),
            Column("rays", "rays/beam", ".0f"),
            Column("error", "energy, RMS over that of a lit beam", ".1e"),
            Column("missed", "echoes missed or added (%)", ".1f"),
            *(
                Column(f"{name}_{key}", f"{name}: {title}", ".1f")
                for name in ("arrays", "loops")
                for key, title in (("us", "us/beam"), ("least", "least"), ("largest", "largest"))
            ),
        ),
        tuple(rows),
        f"{count} beams across each target; the reference is a spiral of {REFERENCE['sub_beams']} sub-beams. Every "
        f"term computed, without noise. CPU time, {turns} turns after one sweep that is not timed. Flakes are "
        "particles of the world, the same for every rule: the rule decides what of their light and of the wall's is "
        "seen. Bright edges have rays of their own besides those of the rule.",
    )


def measured(target: Hard, count: int, turns: int, forms: tuple[bool, ...]) -> dict[str, Timed]:
    """Every rule on one target, in turns."""
    plan = _plan(target, count)
    wanted, seen = _found(target, REFERENCE, plan)[:2]
    lit = wanted > LIT * wanted.max()
    scale = float(np.mean(wanted[lit])) if lit.any() else 1.0
    made: dict[str, Timed] = {}
    for turn in range(turns):
        for chosen in RULES if turn % 2 == 0 else RULES[::-1]:
            name = " ".join(str(value) for value in chosen.values())
            for form in forms if turn % 2 == 0 else forms[::-1]:
                with switch.switched(form):
                    energy, there, rays, seconds = _found(target, chosen, plan)
                error = rules.rms(energy - wanted) / scale
                missed = 100.0 * float(np.mean(there != seen))
                one = made.setdefault(name, Timed(rays, error, missed, {form: [] for form in forms}))
                one.seconds[form].append(seconds)
    return {name: made[name] for name in (" ".join(str(v) for v in one.values()) for one in RULES)}


def _plan(target: Hard, count: int) -> ScanPlan:
    azimuth = target.half_width_rad * np.linspace(-1.0, 1.0, count)
    zero = np.zeros(count)
    return ScanPlan(0, 0, 0, azimuth, zero + target.elevation_rad, zero, max_echoes=4)


def _found(target: Hard, chosen: Mapping[str, Any], plan: ScanPlan) -> tuple[Floats, Any, float, float]:
    """Energy of each beam from before the wall, whether it has an echo there, rays and seconds a beam."""
    text = {
        "schema": 1,
        "seed": 1,
        "world": list(target.world),
        "materials": {"grey": {"rho": 0.5, "model": "lambert"}},
        "weather": dict(target.weather),
        "sensors": [
            {
                "id": SENSOR,
                "model": target.model,
                "physics": {"noise": False, "full": True, "background": False, **target.physics, **chosen},
            }
        ],
    }
    loaded = scenario.loads(json.dumps(text), Path("study.yaml"))  # JSON is YAML
    world = scene.build(loaded)
    caster = CountingCaster(world)
    measure = build_measure(loaded, world, caster, SENSOR)
    measure(plan)  # rays are kept from sweep to sweep, so the first is not timed
    caster.rays, clock = 0, CpuClock()
    scan = measure(replace(plan))
    seconds = 1e-9 * clock.now_ns() / len(plan)
    rays = caster.rays / len(plan)
    echoes = measure.view(plan).echoes
    near = echoes.range_m < NEAR_M
    energy = np.bincount(echoes.beam[near], (echoes.amplitude * np.square(echoes.range_m))[near], len(plan))
    with np.errstate(invalid="ignore"):
        seen = (scan.range_m < NEAR_M).any(axis=1)
    return np.asarray(energy, np.float64), seen, rays, seconds


# ------------------------------------------------------------------------------- mirror images
def mirror_pairs(count: int) -> Bundle:
    """A spiral over the half of a Gaussian beam at u > 0, and its mirror image."""
    half = beams.spiral((count + 1) // 2)
    radius = np.hypot(half.u, half.v)
    turn = 0.5 * np.mod(np.arange(len(half)) * beams.GOLDEN_ANGLE_RAD, 2.0 * math.pi) - 0.5 * math.pi
    u, v = radius * np.cos(turn), radius * np.sin(turn)
    return Bundle(np.concatenate([u, -u]), np.concatenate([v, v]), np.concatenate([half.share, half.share]) / 2.0)


def mirrored(scenes: int) -> Table:
    """The spiral and a bundle of mirrored pairs: errors, and how far a scene's ranges lie from its mirror image's."""
    rows: list[tuple[Value, ...]] = []
    strips = rules.edges(4000, np.random.default_rng(3))
    layers = rules.layers(200 * max(scenes, 1), np.random.default_rng(4))
    other = replace(
        layers, wire=_mirror(layers.wire), edge=_mirror(layers.edge), wall_turn_rad=math.pi - layers.wall_turn_rad
    )
    for count in (16, 61, 256, 1024):
        for name, nodes in (("spiral", beams.spiral(count)), ("mirrored pairs", mirror_pairs(count))):
            error = rules.rms(rules.shares(nodes, strips) - strips.share)
            apart = 1e3 * (layers.energy(nodes)[1] - other.energy(nodes)[1])
            rows.append((name, len(nodes), error, rules.rms(apart), float(np.max(np.abs(apart)))))
    return Table(
        "accuracy_mirror",
        "Scenes beside their mirror images",
        (
            Column("rule", "bundle"),
            Column("rays", "sub-beams", "d"),
            Column("error", "random edge", ".1e"),
            Column("rms_mm", "range, scene less mirror image, RMS (mm)", ".2f"),
            Column("largest_mm", "largest (mm)", ".1f"),
        ),
        tuple(rows),
        "Bare numpy. Mean range of a wire before an edge before a tilted wall, 2 m deep; in the mirror image left and "
        "right are exchanged. No scenario can choose the pairs: they err by more at edges.",
    )


def _mirror(strips: rules.Strips) -> rules.Strips:
    return replace(strips, turn_rad=math.pi - strips.turn_rad)
