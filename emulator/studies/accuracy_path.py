"""The same targets through the product: scenario, mesh files, embreex, sub-beams, receiver.

Hundreds of beams of one sensor look every way, each at its own random edge and wall. Rules that a scenario can choose
run through `Measure.view`; the others give their nodes to the same functions that it calls. Belongs here: such scenes,
rays counted and time taken. Not: bare numpy (accuracy_rules), settings other than the rule (accuracy_knobs).
"""

from __future__ import annotations

import json
import math
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from emulator.casting import raycast
from emulator.physics import beams, noise
from emulator.physics.arrays import Floats
from emulator.physics.beams import Bundle
from emulator.physics.subechoes import SubEchoes, cluster
from emulator.physics.waveform import sample
from emulator.process.clock import CpuClock
from emulator.scenario import scenario
from emulator.scenario.scenario import Scenario
from emulator.sensing.measure import Measure
from emulator.sensing.measure import build as build_measure
from emulator.sensing.paths import trace
from emulator.sensing.rays import Bundles, Rays, cast_rays
from emulator.sensing.receiver import Receiver
from emulator.sensing.view import View
from emulator.studies.accuracy_rules import FIXED, Strips, edges, rms
from emulator.world import scene
from emulator.world.motion import Pose
from protocols.scan import Scan, ScanPlan

PRODUCT = ("spiral", "laguerre", "grid", "adaptive")
"Rules that a scenario can choose."
SENSOR = "lidar"
HALF_ANGLE_RAD = 2.5e-3
NEAR_M, FAR_M = 20.0, 20.7
"Face-on planes: the part of the beam beside the near one falls on the far one. Their pulses overlap."
NEAR_RHO, FAR_RHO = 0.5, 0.5
REFLECTING = ((NEAR_M, NEAR_RHO), (FAR_M, FAR_RHO))
BEYOND = 4.0
"Planes reach this far from the axis, in radii of the beam; 1e-14 of the power goes beside."
FULL_SNR = 10.0
"Peak over noise when the whole beam falls on the near plane: half of it is at the threshold of 5."
THRESHOLD = 5.0


SWEEPS = 2
"A repeat is timed so often; the faster one counts, what else the machine did in the other does not."


class CountingCaster(raycast.Caster):
    """Casts, and counts the rays."""

    rays = 0

    def first_hits(self, origin_m: Floats, *rest: Any, **more: Any) -> Any:
        """First surface on each ray."""
        self.rays += len(origin_m)
        return super().first_hits(origin_m, *rest, **more)


@dataclass(frozen=True)
class Errors:
    """Of all beams of one group, root mean square."""

    energy: float
    "Of the near plane's echo, over that of a plane that takes the whole beam."
    range_m: float
    detection: float
    "Of the probability that the near plane's echo is found at a threshold of 5 rms noise."
    waveform: float
    "Largest deviation over the peak of the pulse."


@dataclass(frozen=True)
class Run:
    """One rule with one number of sub-beams."""

    rule: str
    count: int
    rays: float
    "A beam."
    seconds: tuple[float, ...]
    "A beam, one for each repeat."
    errors: tuple[Errors, ...]
    "One for each repeat."


class Edges:
    """`groups` times `beams` random edges around one sensor."""

    def __init__(self, groups: int, beams_a_group: int, seed: int = 1) -> None:
        n = groups * beams_a_group
        self.groups, self.beams_a_group = groups, beams_a_group
        self.strips: Strips = edges(n, np.random.default_rng(seed))
        k = np.arange(n) + 0.5
        self.elevation_rad = np.arcsin(1.0 - 2.0 * k / n)
        self.azimuth_rad = np.mod(k * beams.GOLDEN_ANGLE_RAD, 2.0 * np.pi)
        self._folder = tempfile.TemporaryDirectory()
        folder = Path(self._folder.name)
        radius = math.tan(HALF_ANGLE_RAD)
        write_quads(folder / "near.obj", self._quads(NEAR_M, self.strips.high * radius))
        write_quads(folder / "far.obj", self._quads(FAR_M, np.full(n, BEYOND * radius)))
        self._path = folder / "edges.yaml"
        self._stage: tuple[Scenario, scene.Scene, CountingCaster] | None = None

    def close(self) -> None:
        """Remove the mesh files."""
        self._folder.cleanup()

    def __enter__(self) -> Edges:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _quads(self, range_m: float, limit: Floats) -> Floats:
        """(n, 4, 3) corners of planes across each beam, up to `limit` along each edge's turn."""
        ca, sa, ce, se = (f(a) for a in (self.azimuth_rad, self.elevation_rad) for f in (np.cos, np.sin))
        forward = np.stack([ce * ca, ce * sa, se], axis=1)
        left = np.stack([-sa, ca, np.zeros_like(ca)], axis=1)
        up = np.stack([-se * ca, -se * sa, ce], axis=1)
        c, s = np.cos(self.strips.turn_rad)[:, None], np.sin(self.strips.turn_rad)[:, None]
        along, across = -s * left + c * up, c * left + s * up
        far = BEYOND * math.tan(HALF_ANGLE_RAD)
        begin = np.full(len(limit), -far)
        corners = [
            forward + x[:, None] * across + y * along
            for x, y in (
                (begin, -far),
                (limit, -far),
                (limit, far),
                (begin, far),
            )
        ]
        return range_m * np.stack(corners, axis=1)

    def build(self, physics: dict[str, Any]) -> tuple[Measure, CountingCaster]:
        """The measuring function of the sensor among the edges; scene and caster are the same for all."""
        if self._stage is None:
            loaded = self._load()
            world = scene.build(loaded)
            self._stage = loaded, world, CountingCaster(world)
        loaded, world, caster = self._stage
        sensors = tuple(
            one.model_copy(update={"physics": one.physics.model_copy(update=physics)}) for one in loaded.sensors
        )
        return build_measure(loaded.model_copy(update={"sensors": sensors}), world, caster, SENSOR), caster

    def _load(self) -> Scenario:
        still = {"at_m": [0.0, 0.0, 0.0]}
        text = {
            "schema": 1,
            "seed": 1,
            "actors": [
                {"id": name, "shape": {"mesh": f"{name}.obj", "up": "z"}, "motion": still, "material": name}
                for name in ("near", "far")
            ],
            "materials": {
                "near": {"rho": NEAR_RHO, "model": "lambert"},
                "far": {"rho": FAR_RHO, "model": "lambert"},
            },
            "sensors": [
                {
                    "id": SENSOR,
                    "model": "paper-905nm",
                    "physics": {
                        "divergence_deg": math.degrees(2.0 * HALF_ANGLE_RAD),
                        "exit_diameter_mm": 0.0,
                        "noise": False,
                        "full": True,
                        "full_scale_snr": "off",
                        "floor_reflectance": "off",
                        "near_gate_m": 0.0,
                        "detection": "peak",
                        "pulse": "sin2",
                        "threshold_to_noise": 0.02,
                        "background": False,
                    },
                }
            ],
        }
        self._path.write_text(json.dumps(text), encoding="utf-8")  # JSON is YAML
        return scenario.load(str(self._path))

    def plan(self, group: int) -> ScanPlan:
        """A sweep over one group of beams."""
        at = self._at(group)
        zero = np.zeros(self.beams_a_group)
        return ScanPlan(0, group, 0, self.azimuth_rad[at], self.elevation_rad[at], zero, max_echoes=1)

    def _at(self, group: int) -> slice:
        return slice(group * self.beams_a_group, (group + 1) * self.beams_a_group)

    def run(self, rule: str, count: int) -> Run:
        """Measure all groups with one rule; `count`: sub-beams, or rounds of splitting of rule `adaptive`."""
        return self.in_turns([(rule, count)])[0]

    def in_turns(
        self, settings: Sequence[tuple[str, int]], begun: Callable[[int], object] = lambda group: None
    ) -> list[Run]:
        """The same of several (rule, count), which take turns with each group: all of them see the same machine.

        Each begins with a sweep that is not timed, and another one is first each time.
        """
        parts: dict[tuple[str, int], list[tuple[float, float, Errors]]] = {one: [] for one in settings}
        for group in range(self.groups):
            begun(group)
            first = group * len(settings) // self.groups
            turn = [*settings[first:], *settings[:first]]
            for one in turn if group % 2 == 0 else turn[::-1]:
                parts[one].append(self._group(*one, group))
        return [
            Run(
                rule,
                count,
                float(np.mean([one[0] for one in found])),
                *zip(*((s, e) for _, s, e in found), strict=True),
            )
            for (rule, count), found in ((one, parts[one]) for one in settings)
        ]

    def _group(self, rule: str, count: int, group: int) -> tuple[float, float, Errors]:
        """Rays and seconds a beam, and errors, of one group."""
        chosen = {"rule": "adaptive", "depth": count} if rule == "adaptive" else {"rule": rule, "sub_beams": count}
        measure, caster = self.build(chosen if rule in PRODUCT else {"rule": "axis"})
        view = None if rule in PRODUCT else measure.view(self.plan(0))  # for its air and surfaces
        plan = self.plan(group)
        rays = (
            None if view is None else rays_of(FIXED[rule](count, np.random.default_rng([count, group])), measure, plan)
        )
        _sweep(measure, caster, plan, view, rays)  # rays are kept from sweep to sweep, so the first is not timed
        caster.rays, taken = 0, []
        for _ in range(SWEEPS):
            clock = CpuClock()
            echoes, scan = _sweep(measure, caster, plan, view, rays)
            taken.append(1e-9 * clock.now_ns() / self.beams_a_group)
        found = self.errors(measure, group, plan, echoes, scan)
        return caster.rays / SWEEPS / self.beams_a_group, min(taken), found

    def errors(self, measure: Measure, group: int, plan: ScanPlan, echoes: SubEchoes, scan: Scan) -> Errors:
        """Against the two echoes of the closed form, given to the same receiver."""
        share = self.strips.share[self._at(group)]
        n, model = len(share), measure.model
        alpha = measure.air.at(0.0).everywhere.extinction_per_m
        whole = [
            model.k_m2 * rho * math.exp(-2.0 * alpha * r) / (r * r + model.aperture_radius_m**2)
            for r, rho in REFLECTING
        ]
        mine = echoes.source == 1
        near = np.bincount(echoes.beam[mine], echoes.amplitude[mine], n) / whole[0]
        # the mean of sec over the beam: planes are a little farther away from the axis
        bulge = 1.0 + 0.25 * math.tan(HALF_ANGLE_RAD) ** 2
        exact = SubEchoes.of(
            np.repeat(np.arange(n), 2),
            np.tile([bulge * NEAR_M, bulge * FAR_M], n),
            np.stack([share * whole[0], (1.0 - share) * whole[1]], axis=1).ravel(),
            source=np.tile([1, 2], n),
        )
        wanted = receive(measure, plan, exact)
        p_wanted, p_found = (noise.detection_probability(THRESHOLD, FULL_SNR * s) for s in (share, near))
        x = np.linspace(bulge * NEAR_M - model.pulse.half_support_m, bulge * FAR_M + model.pulse.half_support_m, 96)
        w_wanted, w_found = (wave(one, n, measure, x) for one in (exact, echoes))
        deviation = np.max(np.abs(w_found - w_wanted), axis=1) / np.max(w_wanted, axis=1)
        return Errors(
            rms(near - share), rms(scan.range_m[:, 0] - wanted.range_m[:, 0]), rms(p_found - p_wanted), rms(deviation)
        )


def _sweep(
    measure: Measure, caster: CountingCaster, plan: ScanPlan, view: View | None, rays: Rays | None
) -> tuple[SubEchoes, Scan]:
    if view is None or rays is None:
        echoes = measure.view(plan).echoes
    else:
        echoes = trace(rays, caster, view.surfaces, view.air, measure.model).echoes
    return echoes, receive(measure, plan, echoes)


def rays_of(nodes: Bundle, measure: Measure, plan: ScanPlan) -> Rays:
    """The nodes of any rule as rays of every beam of a plan, the sensor at rest at the origin."""
    n, m = len(plan), len(nodes)
    direction, _ = beams.spread(nodes, measure.model.beam, plan.azimuth_rad, plan.elevation_rad)
    middle = int(np.argmin(nodes.u**2 + nodes.v**2))
    bundles = Bundles(
        axis=beams.axis_directions(plan.azimuth_rad, plan.elevation_rad),
        direction=direction,
        start_m=None,
        share=nodes.share,
        beam=np.repeat(np.arange(n), m),
        flat_share=np.tile(nodes.share, n),
        nearest_axis=np.arange(n) * m + middle,
    )
    at_rest = Pose(np.zeros((n, 3)), np.broadcast_to(np.eye(3), (n, 3, 3)))
    return cast_rays(bundles, at_rest, plan.fire_offset_s)


def receive(measure: Measure, plan: ScanPlan, echoes: SubEchoes) -> Scan:
    """What the sensor's receiver makes of echoes."""
    return Receiver(measure.model, measure.draws).receive(plan, echoes)


def wave(echoes: SubEchoes, beams_: int, measure: Measure, x_m: Floats) -> Floats:
    """(n, x) the waveform that the product makes of the echoes of n beams, all in one cluster each."""
    model = measure.model
    clusters = cluster(echoes, 4.0 * model.pulse.half_support_m, 0.0)
    chosen = np.ones(len(clusters), np.bool_)
    made = sample(clusters, chosen, model.pulse, model.bin_m, None, np.ones(len(clusters)))
    found = np.zeros((beams_, len(x_m)))
    window = np.repeat(np.arange(len(made.beam)), len(x_m))
    found[made.beam] = made.surfaces_at(np.tile(x_m, len(made.beam)), window).reshape(-1, len(x_m))
    return found


def write_quads(path: Path, corners: Floats) -> None:
    """Squares as an OBJ file."""
    lines = [f"v {x:.17g} {y:.17g} {z:.17g}" for x, y, z in corners.reshape(-1, 3)]
    lines += [f"f {4 * i + 1} {4 * i + 2} {4 * i + 3} {4 * i + 4}" for i in range(len(corners))]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
