"""Narrow beams: what probes, strips and panes cost, and by how much they and the full bundle differ from a dense one.

Belongs here: this table, and the scenes of it. Not: the rule (sensing.probing), rules of wide beams (accuracy_leaving).
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from emulator.physics.arrays import Floats
from emulator.process.clock import CpuClock
from emulator.scenario import scenario
from emulator.scenario.scenario import Scenario
from emulator.sensing.measure import Measure
from emulator.studies.accuracy_knobs import built
from emulator.studies.report import Column, Table, Value
from emulator.studies.stage import ACROSS
from protocols.scan import Scan, ScanPlan

MODELS = "velodyne-vlp-16", "velodyne-vls-128", "ouster-os1-128"
DENSE = 1000
"Sub-beams of the reference."
TIMED = 5
"Times as many beams are in a sweep that is timed."
FORMS: Mapping[str, tuple[bool, dict[str, Any]]] = {
    "rule": (True, {}),
    "bundle": (False, {}),
    "dense": (False, {"sub_beams": DENSE}),
}
"Whether the rule is on, and other choices."


def _plate(at_m: tuple[float, float, float], size_m: tuple[float, float], material: str, yaw_deg: float = 0.0) -> Any:
    """An upright plate of this height and width."""
    return {"plane": {"size_m": list(size_m)}, "at_m": list(at_m), "material": material, **ACROSS, "yaw_deg": yaw_deg}


_WALL = _plate((30.0, 0.0, 0.0), (80.0, 80.0), "brick")
WORLDS: Mapping[str, tuple[Any, ...]] = {
    "edges of a wall": tuple(
        _plate((20.0 + 0.7 * k, -4.0 + 1.3 * k, 0.3 * k - 1.0), (1.5, 0.6), "concrete", 11.0 * k) for k in range(7)
    ),
    "wires before a wall": tuple(
        _plate((15.0, -4.0 + 1.1 * k, 0.0), (8.0, 0.004 * (k + 1)), "concrete", 3.0) for k in range(8)
    ),
    "edges of retro-reflectors": tuple(
        _plate((12.0 + k, -4.0 + 1.6 * k, 0.1 * k), (0.5, 0.3), "retro_sheeting", 9.0) for k in range(6)
    ),
    "panes": tuple(_plate((9.0 + k, -4.0 + 1.8 * k, 0.0), (1.4, 1.5), "window_glass", 5.0 + 9.0 * k) for k in range(5)),
    "sides at grazing incidence": tuple(
        _plate((14.0 + k, -3.5 + 1.7 * k, 0.2), (1.5, 9.0), "car_paint_silver", 80.0 + 1.5 * k) for k in range(5)
    ),
}  # fmt: skip
"Before a wall of brick and above a road."
SHIPPED = "velodyne_street", "hedge"


@dataclass(frozen=True)
class Compared:
    """One way of measuring against the dense bundle."""

    moved: float
    "Share of the beams, per cent, whose nearest or strongest range moves by more than the bound, or is not there."
    strength: float
    "Largest change of a strength where no range moves."


def cases() -> dict[str, Scenario]:
    """Scenes, each with one sensor."""
    found = {name: _told(world) for name, world in WORLDS.items()}
    return {**{name: scenario.load(name) for name in SHIPPED}, **found}


def _told(world: tuple[Any, ...]) -> Scenario:
    road = {"plane": {"size_m": [120, 60]}, "at_m": [30, 0, -1.7], "material": "asphalt"}
    sensor = {"id": "eye", "model": MODELS[0]}
    text = {"schema": 1, "seed": 1, "world": [*world, _WALL, road], "sensors": [sensor]}
    return scenario.loads(json.dumps(text), Path("study.yaml"))  # JSON is YAML


def narrow(beams: int, repeats: int) -> Table:
    """Every scene with every model."""
    rows: list[tuple[Value, ...]] = []
    for name, loaded in cases().items():
        for model in MODELS:
            rows.append((name, model, *_row(loaded, model, beams, repeats)))
    return Table(
        "accuracy_narrow",
        "Narrow beams: probes, strips and panes against bundles",
        (
            Column("scene", "scene"),
            Column("model", "model"),
            Column("rays_full", "rays/beam, bundle", ".1f"),
            Column("rays", "rays/beam, rule", ".1f"),
            Column("time", "time, rule over bundle", ".2f"),
            Column("smooth_percent", "without bundle (%)", ".1f"),
            Column("moved_full_percent", "bundle: moved (%)", ".2f"),
            Column("moved_percent", "rule: moved (%)", ".2f"),
            Column("moved_smooth_percent", "of those without bundle: moved (%)", ".2f"),
            Column("strength_full", "bundle: strength", ".1e"),
            Column("strength", "rule: strength", ".1e"),
            Column("strength_smooth", "of those without bundle: strength", ".1e"),
        ),
        tuple(rows),
        f"{beams} beams ahead, without noise; the reference is a bundle of {DENSE}. Moved: of the ranges reported one "
        "is elsewhere by more than a step, missing or added; strength: largest relative change where none is. Without "
        "bundle: what the rule computes from probes alone. CPU time of one core, of sweeps of "
        f"{TIMED * beams} beams in turns, the best.",
    )


def _row(loaded: Scenario, model: str, beams: int, repeats: int) -> tuple[Value, ...]:
    sensor, plan = loaded.sensors[0], _ahead(beams)
    changed = sensor.model_copy(update={"model": model, "device": {}})
    loaded = loaded.model_copy(update={"sensors": (changed,)})
    made = {name: _of(loaded, changed.id, *form) for name, form in FORMS.items()}
    scans = {name: one(replace(plan)) for name, one in made.items()}
    seconds: dict[str, list[float]] = {"rule": [], "bundle": []}
    for _ in range(repeats):
        for name, spent in seconds.items():
            clock = CpuClock()
            made[name](_ahead(TIMED * beams))
            spent.append(1e-9 * clock.now_ns())
    view = made["rule"].view(plan)
    assert view.plain is not None
    step_m = made["rule"].model.lsb_m
    rule, bundle = (compared(scans[name], scans["dense"], step_m) for name in ("rule", "bundle"))
    smooth = compared(scans["rule"], scans["dense"], step_m, view.plain)
    return (
        float(made["bundle"].view(plan).cast / len(plan)), view.cast / len(plan),
        min(seconds["rule"]) / min(seconds["bundle"]), 100.0 * float(view.plain.mean()),
        bundle.moved, rule.moved, smooth.moved, bundle.strength, rule.strength, smooth.strength,
    )  # fmt: skip


def _of(loaded: Scenario, sensor: str, on: bool, physics: dict[str, Any]) -> Measure:
    chosen = next(one for one in loaded.sensors if one.id == sensor).physics
    # a sensor at rest would know its rays from the last sweep
    left_out = chosen.leave_out.model_copy(update={"narrow_beams": on, "resting": False, "closed_form": "never"})
    return built(loaded, sensor, {**physics, "leave_out": left_out})[0]


def compared(found: Scan, wanted: Scan, step_m: float, beams: np.ndarray[Any, Any] | None = None) -> Compared:
    """What one scan says beside another; of some of the beams alone."""
    some = np.ones(len(found.range_m), bool) if beams is None else beams
    if not bool(some.any()):
        return Compared(0.0, 0.0)
    columns = min(found.range_m.shape[1], wanted.range_m.shape[1])
    one, other = (np.sort(scan.range_m[some, :columns], axis=1) for scan in (found, wanted))
    with np.errstate(invalid="ignore"):
        near = (np.isnan(one) & np.isnan(other)) | (np.abs(one - other) <= step_m)
    still = near.all(axis=1)
    strong = [_strongest(scan.intensity[some][still]) for scan in (found, wanted)]
    change = np.abs(strong[0] / strong[1] - 1.0)
    return Compared(100.0 * float(np.mean(~still)), float(np.nanmax(change, initial=0.0)))


def _strongest(intensity: Floats) -> Floats:
    return np.asarray(np.fmax.reduce(intensity, axis=1))


def _ahead(beams: int) -> ScanPlan:
    """Layers of what lies ahead, at angles that favour no grid."""
    each = np.arange(beams)
    azimuth = np.radians(-24.0 + 48.0 * np.mod(each * 0.6180339887, 1.0))
    elevation = np.radians(-11.0 + 15.0 * (each + 0.5) / beams)
    fired = 0.02 * each / beams
    return ScanPlan(
        0, 0, 0, azimuth, elevation, fired, 0.02, max_range_m=130.0, max_echoes=4, wants_intensity=True
    )  # fmt: skip
