"""Stages for studies: one target that recedes from a lidar, measured through scenario, scene, ray caster and receiver.

The target leaves at 1 m/s and every beam of a sweep fires when it stands at a wanted range, so one sweep holds a whole
curve over distance. Belongs here: such scenes. Not: which targets and weathers a study wants.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from emulator.casting import raycast
from emulator.physics.arrays import Bools, Floats
from emulator.scenario import scenario
from emulator.sensing.measure import Measure
from emulator.sensing.measure import build as build_measure
from emulator.world import scene
from protocols.scan import Scan, ScanPlan

SENSOR, TARGET = "lidar", 1
"Name of the sensor; index of the target among the scene's actors."
ACROSS = {"pitch_deg": -90.0}
"Turns a plane, whose normal is z, to face along x."
CELLS = 64
"Ranges a pass when the largest one is looked for."
FINENESS = 4e-4
"To this share of itself."
NO_RANGE_M = 0.3
"A target not seen at this range is not seen at all."


@dataclass(frozen=True)
class Target:
    """Something to be seen, in words of a scenario. Its nearest point lies `front_m` before its origin."""

    shape: Mapping[str, Any]
    front_m: float = 0.0
    height_m: float = 0.0
    "Of its origin over the beam."
    turned: Mapping[str, float] = field(default_factory=dict)
    rho: float | None = None
    "Lambert surface all over; None: `materials`."
    materials: Mapping[str, str] = field(default_factory=dict)

    def actor(self) -> dict[str, Any]:
        """As an actor at range 0 at time 0, leaving at 1 m/s."""
        surface: dict[str, Any] = {"materials": dict(self.materials)} if self.rho is None else {"material": "target"}
        motion = {"at_m": [self.front_m, 0.0, self.height_m], "velocity_m_s": [1.0, 0.0, 0.0], **self.turned}
        return {"id": "target", "shape": dict(self.shape), "motion": motion, **surface}


def plate(width_m: float, height_m: float, rho: float, incidence_deg: float = 0.0) -> Target:
    """A Lambert plate across the beam, turned by the incidence."""
    turned = {**ACROSS, "yaw_deg": incidence_deg} if incidence_deg else ACROSS
    return Target({"plane": {"size_m": [height_m, width_m]}}, turned=turned, rho=rho)


def tube(diameter_m: float, length_m: float, rho: float) -> Target:
    """An upright Lambert tube."""
    radius = 0.5 * diameter_m
    shape = {"cylinder": {"radius_m": radius, "height_m": length_m, "segments": 256}}
    return Target(shape, radius, -0.5 * length_m, rho=rho)


def ball(diameter_m: float, rho: float) -> Target:
    """A Lambert sphere."""
    radius = 0.5 * diameter_m
    return Target({"sphere": {"radius_m": radius, "segments": 128}}, radius, -radius, rho=rho)


class Stage:
    """One target, one sensor, one weather."""

    def __init__(
        self,
        target: Target,
        model: str,
        *,
        mode: str = "operational",
        weather: Mapping[str, Any] | None = None,
        physics: Mapping[str, Any] | None = None,
    ) -> None:
        text = {
            "schema": 1,
            "seed": 1,
            "actors": [target.actor()],
            "materials": {} if target.rho is None else {"target": {"rho": target.rho, "model": "lambert"}},
            "weather": dict(weather or {}),
            "sensors": [{"id": SENSOR, "model": model, "mode": mode, "physics": dict(physics or {})}],
        }
        loaded = scenario.loads(json.dumps(text), Path("study.yaml"))  # JSON is YAML
        world = scene.build(loaded)
        self.caster = raycast.Caster(world)
        self.measure: Measure = build_measure(loaded, world, self.caster, SENSOR)

    @property
    def extinction_per_m(self) -> float:
        """Of the air."""
        return self.measure.air.at(0.0).everywhere.extinction_per_m

    def scan(self, range_m: Floats, azimuth_rad: Floats | None = None, sweep: int = 0, gain: float = 1.0) -> Scan:
        """A sweep whose beam i fires when the target's front stands at `range_m[i]`."""
        n = len(range_m)
        zero = np.zeros(n)
        return self.measure(
            ScanPlan(
                epoch=0,
                sweep=sweep,
                start_ns=0,
                azimuth_rad=zero if azimuth_rad is None else azimuth_rad,
                elevation_rad=zero,
                fire_offset_s=np.asarray(range_m, dtype=np.float64),
                max_echoes=1,
                gain=gain,
            )
        )

    def snr(self, range_m: Floats) -> Floats:
        """Peak over noise of the target's echo; NaN where none is reported."""
        scan = self.scan(range_m)
        mine = scan.actor[:, 0] == TARGET
        return np.where(mine, scan.intensity[:, 0] * self.measure.model.threshold, np.nan)

    def seen(self, range_m: Floats, gain: float = 1.0) -> Bools:
        """Whether the target is reported at each range."""
        scan = self.scan(range_m, gain=gain)
        return np.asarray(np.isfinite(scan.range_m[:, 0]) & (scan.actor[:, 0] == TARGET))

    def farthest_m(self, about_m: float, gain: float = 1.0) -> float:
        """Largest range at which the target is reported, looked for around `about_m`; 0: at none.

        The share of ranges at which it is seen stands for the edge: where sub-beams hit a thin target now and then,
        that is the range of even odds.
        """
        low, high = 0.87 * about_m, 1.12 * about_m
        found = self._edge_m(low, high, gain)
        while found is None:
            if low < NO_RANGE_M:
                return 0.0
            ends = self.seen(np.array([low, high], dtype=np.float64), gain)
            if ends[0] and not ends[1]:  # the window holds it, but a flake before the first cell or after the last
                return self._window(low, high, gain)[0]
            low, high = (low if ends[0] else 0.5 * low), (1.25 * high if ends[1] else high)
            if high > 2.0 * self.measure.model.gate_m:
                return self.measure.model.gate_m
            found = self._edge_m(low, high, gain)
        edge_m, step = found
        while step > FINENESS * edge_m:
            finer = self._edge_m(edge_m - 2.1 * step, edge_m + 1.9 * step, gain)
            if finer is None:  # seen now and then over more than the window
                break
            edge_m, step = finer
        return edge_m

    def _edge_m(self, low_m: float, high_m: float, gain: float) -> tuple[float, float] | None:
        """Where it is no longer seen, and how finely that is known; None where the window does not hold that range."""
        edge_m, step, seen = self._window(low_m, high_m, gain)
        return (edge_m, step) if seen[0] and not seen[-1] else None

    def _window(self, low_m: float, high_m: float, gain: float) -> tuple[float, float, Bools]:
        """The range of even odds in a window, whatever its ends show; the width of its cells, and where it is seen."""
        step = (high_m - low_m) / CELLS
        seen = self.seen(low_m + step * np.arange(0.5, CELLS, dtype=np.float64), gain)
        return low_m + step * int(np.count_nonzero(seen)), step, seen
