"""One sensor's measuring function: a plan of a sweep in, a scan out.

Belongs here: the order of the steps. Each step is in its own module: rays, paths, air, echoes, receiver.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from emulator.draws import Draws
from emulator.motion import Pose
from emulator.physics.arrays import Floats
from emulator.physics.materials import Material, SurfaceTable, material, material_from_mapping
from emulator.physics_options import PhysicsOptions
from emulator.sensing import receiver
from emulator.sensing.air import Air
from emulator.sensing.model import SensorModel, sensor_model
from emulator.sensing.paths import Caster, trace
from emulator.sensing.rays import BundleCache, cast_rays
from emulator.spec import load_spec
from protocols.scan import Scan, ScanPlan

if TYPE_CHECKING:
    from emulator.scenario import Mount, Scenario
    from emulator.scene import Scene


class Measure:
    """Measures the sweeps of one sensor. The same plan always gives the same scan, in whatever order they come."""

    def __init__(
        self,
        model: SensorModel,
        scene: Scene,
        mount: Mount,
        caster: Caster,
        surfaces: SurfaceTable,
        air: Air,
        draws: Draws,
    ) -> None:
        self.model = model
        self.draws = draws
        self.air = air
        self._scene, self._mount = scene, mount
        self._caster = caster
        self._surfaces = surfaces
        self._bundles = BundleCache(model)
        still = mount.actor is None or scene.motions[scene.index[mount.actor]].still
        self._still_pose = scene.sensor_pose(mount, np.zeros(1)) if still else None

    @property
    def warnings(self) -> tuple[str, ...]:
        """What was computed outside the range in which its law is known to hold, one line each."""
        return self.air.warnings

    def __call__(self, plan: ScanPlan) -> Scan:
        """Measure one sweep."""
        if len(plan) == 0:
            return Scan.empty(plan)
        t_s = 1e-9 * plan.start_ns + plan.fire_offset_s
        bundles = self._bundles.of(plan)
        rays = cast_rays(bundles, self._pose(t_s), t_s)
        air = self.air.at(float(t_s[0]))
        found = trace(rays, bundles, self._caster, self._surfaces, air, self.model, plan.gain, plan.max_range_m)
        return receiver.receive(plan, found, self.model, self.draws)

    def _pose(self, t_s: Floats) -> Pose:
        still = self._still_pose
        if still is None:
            return self._scene.sensor_pose(self._mount, t_s)
        n = len(t_s)
        return Pose(np.broadcast_to(still.position_m, (n, 3)), np.broadcast_to(still.rotation, (n, 3, 3)))


def build(scenario: Scenario, scene: Scene, caster: Caster, sensor_id: str) -> Measure:
    """The measuring function of one sensor of a scenario.

    Parameters
    ----------
    scenario : the run
    scene : its bodies and motions
    caster : first hits on that scene, see raycast
    sensor_id : which of its sensors; one that sees beams
    """
    config = next(one for one in scenario.sensors if one.id == sensor_id)
    options = getattr(config, "physics", None) or PhysicsOptions()
    model = sensor_model(load_spec(config.model), options, config.mode)
    extra = {name: material_from_mapping(name, entry) for name, entry in scenario.materials.items()}
    surfaces = surface_table(scene.materials, extra, model)
    return Measure(
        model,
        scene,
        config.mount,
        caster,
        surfaces,
        Air(scenario.weather, model, scene),
        Draws(scenario.seed, sensor_id),
    )


def surface_table(names: tuple[str, ...], extra: Mapping[str, Material], model: SensorModel) -> SurfaceTable:
    """Reflection of the scene's materials at the sensor's wavelength."""
    find = partial(material, extra=extra)
    return SurfaceTable.of([find(name) for name in names], 1e9 * model.wavelength_m)
