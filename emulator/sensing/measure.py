"""One sensor's measuring function: a plan of a sweep in, a scan out.

Belongs here: the order of the steps. Each step is in its own module.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from emulator.draws import Draws
from emulator.errors import ScenarioError
from emulator.motion import Pose
from emulator.physics import atmosphere
from emulator.physics.arrays import Floats
from emulator.physics.materials import Material, SurfaceTable, material, material_from_mapping
from emulator.physics.subechoes import SubEchoes
from emulator.sensing.adapt import adaptive_rays
from emulator.sensing.air import Air, AirNow
from emulator.sensing.daylight import daylight
from emulator.sensing.model import SensorModel, sensor_model
from emulator.sensing.particles import seen_particles
from emulator.sensing.paths import FacedCaster, Seen, Surfaces, reach_of, returned
from emulator.sensing.photon_receiver import PhotonReceiver
from emulator.sensing.rays import BundleCache, Bundles, Rays, cast_rays
from emulator.sensing.receiver import Receiver
from emulator.sensing.soft import SoftTargets
from emulator.sensing.sparing import Spared, Sparing, wanted
from emulator.spec import load_spec
from protocols.scan import Scan, ScanPlan

if TYPE_CHECKING:
    from emulator.scenario import Mount, Scenario
    from emulator.scene import Scene


DEEP = 5.0
"Optical depth beyond which single scattering is an estimate."


@dataclass(frozen=True, eq=False)
class View:
    """One sweep before the receiver: for the receiver, and for studies of accuracy."""

    rays: Rays
    seen: Seen
    "Surfaces alone."
    echoes: SubEchoes
    "Surfaces, particles and uneven media."
    air: AirNow
    surfaces: Surfaces
    cast: int
    "First rays cast: those of all bundles, where none was spared."
    plain: NDArray[np.bool_] | None = None
    "(n,) beams of which one plane is seen, or nothing, and that had no bundle; None: not asked for."


class Measure:
    """Measures the sweeps of one sensor. The same plan always gives the same scan, in whatever order they come."""

    def __init__(
        self,
        model: SensorModel,
        scene: Scene,
        mount: Mount,
        caster: FacedCaster,
        surfaces: tuple[Surfaces, Surfaces],
        air: Air,
        receiver: Receiver | PhotonReceiver,
    ) -> None:
        self.model = model
        self.draws = receiver.draws
        self.air = air
        self._scene, self._mount = scene, mount
        self._caster = caster
        self._dry, self._wet = surfaces
        self._bundles = BundleCache(model)
        self._receiver = receiver
        self._deepest = 0.0
        self._last: tuple[Bundles, Rays] | None = None
        self._soft = SoftTargets(model, receiver.bin_m)
        still = mount.actor is None or scene.motions[scene.index[mount.actor]].still
        self._still_pose = scene.sensor_pose(mount, np.zeros(1)) if still else None
        # made here, so that the first sweep of a run is not late
        with np.errstate(under="ignore"):  # edges shorter than any that light can tell from none
            self._sparing = Sparing(scene, model, caster, still) if wanted(model, scene) else None

    @property
    def warnings(self) -> tuple[str, ...]:
        """What was computed outside the range in which its law is known to hold, one line each."""
        return self.air.warnings + atmosphere.deep_path_warning(self._deepest)

    def __call__(self, plan: ScanPlan) -> Scan:
        """Measure one sweep."""
        if len(plan) == 0:
            return Scan.empty(plan)
        with np.errstate(under="ignore"):  # what underflows here is no light, or no length
            return self._measured(plan)

    def _measured(self, plan: ScanPlan) -> Scan:
        view = self._view(plan)
        light = daylight(view.air.sun, view.rays, view.seen, view.surfaces, self._caster, self.model)
        scan = self._receiver.receive(plan, view.echoes, self._soft.everywhere(view.air, plan.gain), light)
        alpha = view.air.everywhere.extinction_per_m
        if alpha * self.model.gate_m > DEEP:
            far_m = float(np.max(scan.range_m[scan.actor >= 0], initial=0.0))
            self._deepest = max(self._deepest, alpha * far_m)
        return scan

    def view(self, plan: ScanPlan) -> View:
        """Everything that comes back in a sweep of at least one beam, before the receiver."""
        with np.errstate(under="ignore"):
            return self._view(plan)

    def _view(self, plan: ScanPlan) -> View:
        t_s = 1e-9 * plan.start_ns + plan.fire_offset_s
        pose = self._pose(t_s)
        air, gain = self.air.at(float(t_s[0])), plan.gain
        surfaces = self._wet if air.wet else self._dry
        spared = self._spared(plan, pose, t_s, surfaces, air)
        if spared is not None:
            rays, seen = spared.rays, spared.seen
        elif self.model.rule == "adaptive" and not self.model.beam.is_ray:
            rays, cells = adaptive_rays(plan, pose, t_s, self._caster, self.model)
            seen = returned(cells, rays, self._caster, surfaces, air, self.model, gain, plan.max_range_m)
        else:
            rays = self._rays(plan, pose, t_s)
            # a surface out of reach is still background in daylight
            far = reach_of(self.model, plan.max_range_m) if self.model.spare_far and air.sun is None else np.inf
            hits = self._caster.first_hits(rays.origin_m, rays.direction, rays.t_s, max_range_m=far)
            seen = returned(hits, rays, self._caster, surfaces, air, self.model, gain, plan.max_range_m)
        parts = [seen.echoes]
        for particles in air.particles:
            drawn = seen_particles(
                particles,
                seen.nearest_m,
                air.everywhere.extinction_per_m,
                plan.sweep,
                self.model,
                self.draws,
                gain,
            )
            parts += [] if drawn is None else [drawn]
        if self._soft.uneven(air):
            drawn = self._soft.points(air, rays, seen.echoes, t_s, gain)
            parts += [] if drawn is None else [drawn]
        echoes = SubEchoes.joined(*parts) if len(parts) > 1 else seen.echoes
        if spared is not None:
            return View(rays, seen, echoes, air, surfaces, spared.cast, spared.plain)
        return View(rays, seen, echoes, air, surfaces, len(rays.beam))

    def _spared(self, plan: ScanPlan, pose: Pose, t_s: Floats, surfaces: Surfaces, air: AirNow) -> Spared | None:
        """The sweep with bundles only where they are needed; None where finding out costs more than it saves."""
        if self._sparing is None:
            return None
        bundles = self._bundles.of(plan)
        if not self._sparing.pays(len(plan), bundles.sub_beams):
            return None
        return self._sparing.sweep(plan, bundles, pose, t_s, surfaces, air)

    def _rays(self, plan: ScanPlan, pose: Pose, t_s: Floats) -> Rays:
        """Rays of fixed bundles; a sensor at rest casts the same ones as long as the plan's angles stay."""
        bundles = self._bundles.of(plan)
        if self._still_pose is None:
            return cast_rays(bundles, pose, t_s)
        if self._last is None or self._last[0] is not bundles:
            self._last = bundles, cast_rays(bundles, pose, t_s)
        return self._last[1].at(t_s)

    def _pose(self, t_s: Floats) -> Pose:
        still = self._still_pose
        if still is None:
            return self._scene.sensor_pose(self._mount, t_s)
        n = len(t_s)
        return Pose(np.broadcast_to(still.position_m, (n, 3)), np.broadcast_to(still.rotation, (n, 3, 3)))


def build(scenario: Scenario, scene: Scene, caster: FacedCaster, sensor_id: str) -> Measure:
    """The measuring function of one sensor of a scenario.

    Parameters
    ----------
    scenario : the run
    scene : its bodies and motions
    caster : first hits on that scene, see raycast
    sensor_id : which of its sensors; one that sees beams
    """
    index = next(number for number, one in enumerate(scenario.sensors) if one.id == sensor_id)
    config = scenario.sensors[index]
    extra = {name: material_from_mapping(name, entry) for name, entry in scenario.materials.items()}
    try:
        model = sensor_model(load_spec(config.model), config.physics, config.mode)
        surfaces = surface_table(scene.materials, extra, model), surface_table(scene.materials, extra, model, wet=True)
        draws = Draws(scenario.seed, sensor_id)
        receiver = PhotonReceiver(model, model.photons, draws) if model.photons is not None else Receiver(model, draws)
        air = Air(scenario.weather, model, scene)
    except ValueError as error:  # numbers that are right alone but not together
        raise ScenarioError(f"{scenario.label(f'sensors.{index}.physics')}: {error}") from error
    return Measure(model, scene, config.mount, caster, surfaces, air, receiver)


def surface_table(
    names: tuple[str, ...], extra: Mapping[str, Material], model: SensorModel, wet: bool = False
) -> Surfaces:
    """Reflection of the scene's materials at the sensor's wavelength."""
    find = partial(material, extra=extra)
    return Surfaces.of(SurfaceTable.of([find(name) for name in names], 1e9 * model.wavelength_m, wet))
