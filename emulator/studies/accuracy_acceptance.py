"""The numbers that the study `accuracy` must meet, beside what it found; errors and rays, never times.

Belongs here: the list. Not: how the errors come about.
"""

from __future__ import annotations

import math

import numpy as np

from emulator.physics import tilted
from emulator.studies import accuracy_rules as rules
from emulator.studies.accuracy_path import Run
from emulator.studies.report import Column, Table, Value

DEFAULT = 61
"Sub-beams of the sensors' specs."
TILTS_DEG = (0.0, 30.0, 60.0, 80.0, 85.0)
THRIFTY_RAYS = 1000.0
WIDE_RAD, SEED_RAD = 0.5 * 12.913e-3, math.radians(0.035)
"Half angles of the LMS291 and of the base paper's beam."

Curves = dict[str, dict[str, list[tuple[float, tuple[float, ...]]]]]
"Target -> rule -> (rays, error of each repeat)."


def plane_errors(half_angle_rad: float) -> tuple[float, float, float]:
    """Largest error of the closed form up to 85 degrees: energy, mean range over R, spread relative."""
    tilt = np.radians(TILTS_DEG)
    exact = tilted.tilted_plane_moments(half_angle_rad, tilt)
    near = tilted.tilted_plane_expansion(half_angle_rad, np.tan(tilt))
    spread = np.abs(near[2][1:] / exact[2][1:] - 1.0)  # face-on there is none to second order
    return (
        float(np.max(np.abs(near[0] / exact[0] - 1.0))),
        float(np.max(np.abs(near[1] - exact[1]))),
        float(np.max(spread)),
    )


def acceptance(curves: Curves, runs: dict[str, list[Run]], bins: Table, fog: Table, points: Table) -> Table:
    """Each number with what is allowed and what was found."""

    def middle(target: str, rule: str, rays: float) -> float:
        return float(np.median(next(errors for n, errors in curves[target][rule] if n == rays)))

    edge = [(rays, float(np.median(errors))) for rays, errors in curves["edge"]["spiral"]]
    fitted = rules.slope([n for n, _ in edge], [e for _, e in edge])
    thrifty = [float(np.median(errors)) for rays, errors in curves["edge"]["adaptive"] if rays <= THRIFTY_RAYS]
    default = next(one for one in runs["spiral"] if one.count == DEFAULT)
    energy = float(np.median([one.energy for one in default.errors]))
    split = [
        float(np.median([one.energy for one in run.errors])) for run in runs["adaptive"] if run.rays <= THRIFTY_RAYS
    ]
    detection = float(np.median([one.detection for one in default.errors]))
    at_1_ns = next(row for row in bins.rows if row[0] == 1.0)
    twelve = next(row for row in fog.rows if row[0] == 12)
    plate = next(row for row in points.rows if row[:2] == ("spiral", DEFAULT))
    wide, seed = plane_errors(WIDE_RAD), plane_errors(SEED_RAD)
    rows: list[tuple[Value, ...]] = [
        _row("plane to 85 deg, 12.9 mrad: energy", wide[0], 1e-6),
        _row("plane to 85 deg, 12.9 mrad: mean range over R", wide[1], 1e-6),
        _row("plane to 85 deg, 12.9 mrad: spread", wide[2], 1e-2),
        _row("plane to 85 deg, 1.2 mrad: energy", seed[0], 1e-10),
        _row("plane to 85 deg, 1.2 mrad: mean range over R", seed[1], 1e-10),
        _row("plane to 85 deg, 1.2 mrad: spread", seed[2], 1e-4),
        _row("random edge, spiral 61", middle("edge", "spiral", 61.0), 2.0e-2),
        _row("random edge, spiral 256", middle("edge", "spiral", 256.0), 6e-3),
        _row("random edge, spiral 1024", middle("edge", "spiral", 1024.0), 2.2e-3),
        _row("random edge, spiral: slope off -0.75", abs(fitted + 0.75), 0.1),
        _row("random edge through the product, spiral 61", energy, 2.0e-2),
        _row("wire of a tenth of the radius, spiral 1024", middle("wire", "spiral", 1024.0), 6e-2),
        _row("random edge, adaptive (cells that are worth it), at most 1000 rays", min(thrifty), 5e-4),
        _row("random edge through the product, adaptive, at most 1000 rays", min(split), 5e-4),
        _row("waveform, 1 ns: peak (mm)", float(at_1_ns[3] or 0.0), 0.2),
        _row("waveform, 1 ns: leading edge (mm)", float(at_1_ns[4] or 0.0), 4.0),
        _row("fog, 12 nodes", max(float(value or 0.0) for value in twelve[1:]), 1e-10),
        _row("detection on mixed beams, spiral 61", detection, 0.03),
        _row("points on a plate of 1.75 m, spiral 61", float(plate[2] or 0.0), 0.1),
    ]
    return Table(
        "accuracy_acceptance",
        "What must hold",
        (
            Column("item", "item"),
            Column("found", "found", ".1e"),
            Column("allowed", "allowed", ".1e"),
            Column("held", "held", ""),
        ),
        tuple(rows),
        "Root mean square errors, median of the repeats; planes, pulses and fog: largest. The same numbers are tests.",
    )


def _row(item: str, found: float, allowed: float) -> tuple[Value, ...]:
    return item, found, allowed, found <= allowed
