"""One sensor's measuring function: a plan of a sweep in, a scan out.

Belongs here: the order of the steps. Each step is in its own module.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from emulator.casting.detail import detailed
from emulator.errors import ScenarioError
from emulator.measuring.conditions import NORMAL, ActiveFault, Conditions
from emulator.measuring.parts import PartOfScan, beams_of, rows_of, slice_of
from emulator.physics import atmosphere
from emulator.physics.arrays import Floats, Ints, indexes
from emulator.physics.materials import Material, SurfaceTable, material, material_from_mapping, with_levels
from emulator.physics.random_streams import RandomStreams
from emulator.scenario.weather import WeatherConfig
from emulator.sensing.adapt import adaptive_rays
from emulator.sensing.air import Air, AirNow
from emulator.sensing.bright import BrightEdges
from emulator.sensing.bright import wanted as bright_wanted
from emulator.sensing.contracts import FacedCaster
from emulator.sensing.daylight import NIGHT, Daylight, Shadows, daylight, shines, surfaces_show
from emulator.sensing.model import SensorModel, sensor_model
from emulator.sensing.others import Others, others_of
from emulator.sensing.particles import Falling
from emulator.sensing.paths import Seen, Surfaces, reach_of, returned
from emulator.sensing.photon_receiver import PhotonReceiver
from emulator.sensing.probing import Probing
from emulator.sensing.probing import wanted as probes_wanted
from emulator.sensing.pruning import Pruned, Pruning, wanted
from emulator.sensing.rays import KEPT_PLANS, RAYS_KEPT, BundleCache, Bundles, Rays, cast_rays, part_of, rays_of
from emulator.sensing.receiver import Receiver
from emulator.sensing.resting import Resting, with_others
from emulator.sensing.soft import SoftTargets
from emulator.sensing.view import View
from emulator.sensors.spec import load_spec
from emulator.world.motion import Pose
from protocols.scan import Scan, ScanPlan

if TYPE_CHECKING:
    from emulator.scenario.scenario import Scenario
    from emulator.scenario.tables import Mount
    from emulator.sensing.faulty.sweeps import FaultySweeps
    from emulator.world.scene import Scene


MANY_BEYOND = 0.05
"Share of beams for which one more ray in daylight costs more than casting all as far."
FEW_MOVERS = 32
"With more moving bodies out of reach it does not."
DEEP = 5.0
"Optical depth beyond which single scattering is an estimate."


@dataclass(frozen=True, eq=False)
class _Again:
    """What came back in a sweep in which nothing moved, and all that it depended on."""

    bundles: Bundles
    air: AirNow
    gain: float
    max_range_m: float
    view: View

    def serves(self, plan: ScanPlan, bundles: BundleCache, air: AirNow) -> bool:
        """The same comes back again."""
        if air is not self.air or plan.gain != self.gain or plan.max_range_m != self.max_range_m:
            return False
        return plan.origin_m is None and bundles.of(plan) is self.bundles


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
        beside: bool = False,
        others: Others | None = None,
    ) -> None:
        """`beside`: the sensor is where `shift_m` says, which may be elsewhere in each sweep."""
        self.shift_m: Floats | None = None
        self._faulty: FaultySweeps | None = None
        self._beside: Measure | None = None
        self.model = model
        self.draws = receiver.draws
        self.air = air
        "Of the present conditions."
        self._own_air = air
        self._weather: WeatherConfig | None = None
        "The state that `air` was made from; None: the scenario's own."
        self._refused: dict[str, None] = {}
        self._scene, self._mount = scene, mount
        self._caster, self.others = caster, others
        self._dry, self._wet = surfaces
        self._bundles = BundleCache(model)
        self._receiver = receiver
        self._deepest = 0.0
        self._shadows = Shadows()
        self._looks_far = False
        "In daylight all rays look out of reach at once: one more for each beam that met nothing would cost more."
        self._at_rest: tuple[Resting, ...] = ()
        "Of a sensor that does not move: the latest last."
        self._again: _Again | None = None
        self._parts: dict[tuple[int, int, bool], tuple[Bundles, Ints, Bundles]] = {}
        "Of sweeps that are measured in parts: the bundles of the latest, the beams of its part and their bundles."
        self._falling = Falling(model)
        self._soft = SoftTargets(model, receiver.bin_m, self._falling.undrawn)
        still = (mount.actor is None or scene.motions[scene.index[mount.actor]].still) and not beside
        self._still_pose = scene.sensor_pose(mount, np.zeros(1)) if still else None
        self._bright: BrightEdges | None = None
        if bright_wanted(model, scene, self._dry):
            self._bright = BrightEdges(scene, model, caster, self._dry, still)
        # made here, so that the first sweep of a run is not late
        with np.errstate(under="ignore"):  # edges shorter than any that light can tell from none
            self._pruning = Pruning(scene, model, caster, still) if wanted(model, scene) else None
        self._probing: Probing | None = None
        if probes_wanted(model):
            probing = Probing(scene, model, caster, self._bundles, self._dry)
            self._probing = None if probing.too_bright else probing

    @property
    def warnings(self) -> tuple[str, ...]:
        """What was computed outside the range in which its law is known to hold, one line each."""
        return (*self.air.warnings, *self._refused, *atmosphere.deep_path_warning(self._deepest))

    def __call__(self, plan: ScanPlan, conditions: Conditions = NORMAL) -> Scan:
        """Measure one sweep."""
        if len(plan) == 0:
            return Scan.empty(plan)
        turned_ns = self._scene.turned_ns(plan.start_ns)
        if turned_ns:  # a sweep is of the round in which it begins, to its end
            local = self._under(replace(plan, start_ns=plan.start_ns - turned_ns), conditions, plan)
            return replace(local, plan=plan)
        return self._under(plan, conditions, plan)

    def _under(self, local: ScanPlan, conditions: Conditions, plan: ScanPlan) -> Scan:
        """One sweep; `local` is the plan in the scene's own time. What was ordered holds by the run's."""
        self._turn_air(plan, conditions)
        faults = conditions.of(self.draws.sensor, plan.start_ns) if conditions.faults else ()
        with np.errstate(under="ignore"):  # what underflows here is no light, or no length
            return self._under_faults(local, faults) if faults else self._measured(local)

    def _turn_air(self, plan: ScanPlan, conditions: Conditions) -> None:
        """To the weather that holds for a sweep."""
        if conditions.weather is not self._weather:
            first_s = float(1e-9 * plan.start_ns + plan.fire_offset_s[0])
            self._change_air(None if conditions.weather is None else conditions.weather.at(first_s))

    def _under_faults(self, plan: ScanPlan, faults: tuple[ActiveFault, ...]) -> Scan:
        if self._faulty is None:
            from emulator.sensing.faulty.sweeps import FaultySweeps

            self._faulty = FaultySweeps(self.model, self.draws, self._soft, self._receiver)
        return self._faulty.measured(plan, faults, self._look)

    def _look(self, plan: ScanPlan, shift_m: Floats | None) -> tuple[View, Daylight]:
        """What comes back in a sweep, and the daylight in it; the sensor may be beside its place, in its own frame."""
        if shift_m is not None:
            if self._beside is None:  # of what is kept for a sensor at rest nothing holds there
                parts = self._scene, self._mount, self._caster, (self._dry, self._wet), self.air, self._receiver
                self._beside = Measure(self.model, *parts, beside=True, others=self.others)
            self._beside.air, self._beside.shift_m = self.air, shift_m
            return self._beside._look(plan, None)
        view = self._view(plan)
        return view, daylight(
            view.air.sun, view.rays, view.seen, view.surfaces, self._caster, self.model, self._shadows,
            plan.wants_ambient,
        )  # fmt: skip

    def refuses(self, weather: WeatherConfig) -> str:
        """Why this sensor cannot compute such weather; empty: it can."""
        try:
            Air(weather, self.model, self._scene)
        except ValueError as error:
            return str(error)
        return ""

    def _change_air(self, weather: WeatherConfig | None) -> None:
        """Other weather for this sweep; one that this sensor cannot compute is reported, the scenario's own holds."""
        if weather != self._weather:
            self.air = self._own_air
            if weather is not None:
                try:
                    self.air = Air(weather, self.model, self._scene)
                except ValueError as error:
                    self._refused[f"changed weather is not used: {error}"] = None
        self._weather = weather

    def part(
        self, plan: ScanPlan, conditions: Conditions, number: int, of: int, in_time: bool = False
    ) -> PartOfScan | None:
        """Some beams of one sweep, see `parts`, or one slice; None: this one is not measured in parts.

        Each beam has what it has in the whole sweep, to the rounding of float64.
        """
        turned_ns = self._scene.turned_ns(plan.start_ns)
        local = replace(plan, start_ns=plan.start_ns - turned_ns) if turned_ns else plan
        if not self._has_parts(local) or conditions.of(self.draws.sensor, plan.start_ns):
            return None
        self._turn_air(plan, conditions)
        air = self.air.at(float(1e-9 * local.start_ns + local.fire_offset_s[0]))
        if (
            air.particles
            or air.volumes
            or self._soft.uneven(air)
            or (air.sun is not None and shines(air.sun, self.model))
        ):
            return None
        with np.errstate(under="ignore"):
            at = slice_of(plan, number, of) if in_time else beams_of(len(plan), number, of)
            return rows_of(self._part_measured(local, air, at, (number, of, in_time)), at)

    def _has_parts(self, plan: ScanPlan) -> bool:
        """No beam of it depends on others, nor on how many there are; and nothing is kept from sweep to sweep."""
        if self._still_pose is not None or self._probing is not None or self.others is not None:
            return False
        if plan.origin_m is not None or self.model.rule == "adaptive":
            return False
        if not isinstance(self._receiver, Receiver) or not self._receiver.keeps_beams_apart:
            return False
        return self._pruning is None or not self._pruning.pays(len(plan), self._bundles.sub_beams)

    def _part_measured(self, plan: ScanPlan, air: AirNow, at: Ints, part: tuple[int, int, bool]) -> Scan:
        """A scan of all beams, of which those of other parts see nothing."""
        bundles = self._bundles.of(plan)
        kept = self._parts.get(part)
        if kept is None or kept[0] is not bundles or not np.array_equal(kept[1], at):
            self._parts[part] = kept = bundles, at, part_of(bundles, at)
        angles = plan.azimuth_rad[at], plan.elevation_rad[at], plan.fire_offset_s[at]
        some = replace(plan, azimuth_rad=angles[0], elevation_rad=angles[1], fire_offset_s=angles[2])
        view = self._view(some, kept[2], air)
        found = view.echoes
        return self._received(plan, replace(view, found=replace(found, beam=at[found.beam]), kept=None), NIGHT)

    def _measured(self, plan: ScanPlan) -> Scan:
        return self._received(plan, *self._look(plan, None))

    def _received(self, plan: ScanPlan, view: View, light: Daylight) -> Scan:
        """What the receiver makes of what comes back."""
        soft = self._soft.everywhere(view.air, plan.gain)
        if isinstance(self._receiver, Receiver):
            scan = self._receiver.receive(plan, view.found, soft, light, view.kept)
        else:
            scan = self._receiver.receive(plan, view.echoes, soft, light)
        alpha = view.air.everywhere.extinction_per_m
        if alpha * self.model.gate_m > DEEP:
            far_m = float(np.max(scan.range_m[scan.actor >= 0], initial=0.0))
            self._deepest = max(self._deepest, alpha * far_m)
        return scan

    def view(self, plan: ScanPlan) -> View:
        """Everything that comes back in a sweep of at least one beam, before the receiver."""
        with np.errstate(under="ignore"):
            view = self._view(plan)
        if self._again is not None and view is self._again.view:
            view = replace(view, rays=view.rays.at(1e-9 * plan.start_ns + plan.fire_offset_s))
        return view

    def _view(self, plan: ScanPlan, bundles: Bundles | None = None, air: AirNow | None = None) -> View:
        """The same; where nothing moves the one of an earlier sweep, with that one's instants.

        `bundles`, `air`: of a part of a sweep, see `part`.
        """
        t_s = 1e-9 * plan.start_ns + plan.fire_offset_s
        air, gain = self.air.at(float(t_s[0])) if air is None else air, plan.gain
        again = self._again
        if again is not None and again.serves(plan, self._bundles, air):
            return again.view
        pose = self._pose(t_s, plan.origin_m)
        if air.volumes and self.model.prune_far:
            place, reach = pose.position_m, reach_of(self.model, plan.max_range_m)
            low, high = place.min(axis=0), place.max(axis=0)
            air = self.air.near(air, low, high, reach, float(t_s.min()), float(t_s.max()))
        surfaces = self._wet if air.wet else self._dry
        rays_saved = None if bundles is not None else self._pruned_by_bundles(plan, pose, t_s, surfaces, air)
        if rays_saved is not None:
            rays, seen = rays_saved.rays, rays_saved.seen
        elif self.model.rule == "adaptive" and not self.model.beam.is_ray:
            rays, cells = adaptive_rays(plan, pose, t_s, self._caster, self.model)
            seen = returned(cells, rays, self._caster, surfaces, air, self.model, gain, plan.max_range_m)
        else:
            rays, resting = self._rays(plan, pose, t_s, bundles)
            show = surfaces_show(air.sun, self.model)
            far = reach_of(self.model, plan.max_range_m) if self.model.prune_far else np.inf
            if show and self._looks_far:
                far = np.inf
            what = surfaces, air, self.model, gain, plan.max_range_m
            if resting is not None:
                seen = resting.seen(rays, self._caster, far, *what)
            else:
                hits = self._caster.first_hits(
                    rays.origin_m, rays.direction, rays.t_s, max_range_m=far, aimed=rays.steady, order=rays.order
                )
                seen = returned(hits, rays, self._caster, *what)
            if far < np.inf and show:
                seen = self._background(seen, rays, far)
        tails = None
        if self._bright is not None:
            spread = self._bundles.of(plan) if bundles is None else bundles
            seen, tails = self._bright.put_into(seen, spread, pose, t_s, surfaces, air, gain, plan.max_range_m)
        drops = []
        soft = self._soft.everywhere(air, gain) if air.particles else None
        for particles in air.particles:
            falling = self._falling.seen(
                particles, rays, t_s, pose.rotation, seen.nearest_m, air.extinction_per_m, plan.sweep, self.draws, gain,
                soft,
            )  # fmt: skip
            if falling is None:
                continue
            drops += [falling.echoes]
            if falling.shades(seen.nearest_m):
                seen = replace(seen, found=falling.shade(seen.echoes), kept=None)
        if self._soft.uneven(air):
            drawn = self._soft.points(air, rays, seen.echoes, t_s, gain)
            drops += [] if drawn is None else [drawn]
        if self.others is not None and self.others.found:
            dimmed = air.everywhere.extinction_per_m
            drops += self.others.echoes(rays, t_s, self._caster, surfaces, dimmed, gain, plan.max_range_m)
        found, kept = with_others(seen, drops)
        if rays_saved is not None:
            return View(rays, seen, found, air, surfaces, rays_saved.cast, rays_saved.plain, kept, tails)
        view = View(rays, seen, found, air, surfaces, len(rays.beam), None, kept, tails)
        if self._comes_again(plan, seen, air):
            self._again = _Again(self._bundles.of(plan), air, gain, plan.max_range_m, view)
        return view

    def _comes_again(self, plan: ScanPlan, seen: Seen, air: AirNow) -> bool:
        """Neither the sensor nor anything else moves, and nothing is drawn: the next sweep sees the same."""
        if self._caster.moves or plan.origin_m is not None or self._bright is not None or self.others is not None:
            return False
        if air.particles or air.volumes or surfaces_show(air.sun, self.model):
            return False
        return seen.kept is not None and not bool(seen.kept.changed.any())

    def _pruned_by_bundles(
        self, plan: ScanPlan, pose: Pose, t_s: Floats, surfaces: Surfaces, air: AirNow
    ) -> Pruned | None:
        """The sweep with bundles only where they are needed; None where finding out costs more than it saves."""
        if self._probing is not None:
            return self._probing.sweep(plan, pose, t_s, surfaces, air)
        if self._pruning is None or (self._scene.fed is not None and self._scene.fed.has_spawned):
            return None
        if not self._pruning.pays(len(plan), self._bundles.sub_beams):
            return None
        return self._pruning.sweep(plan, self._bundles.of(plan), pose, t_s, surfaces, air)

    def _rays(
        self, plan: ScanPlan, pose: Pose, t_s: Floats, bundles: Bundles | None = None
    ) -> tuple[Rays, Resting | None]:
        """Rays of fixed bundles; a sensor at rest casts the same ones as long as the plan's angles stay."""
        bundles = self._bundles.of(plan) if bundles is None else bundles
        if self._still_pose is None:
            spread, steady = self._bundles.turned(bundles, pose.rotation)
            return rays_of(spread, pose.position_m, t_s, steady, ordered=self._bundles.again), None
        known = next((one for one in self._at_rest if one.bundles is bundles), None)
        if known is None:
            known = Resting(bundles, cast_rays(bundles, pose, t_s))
            kept = [*self._at_rest, known]
            while len(kept) > KEPT_PLANS or (len(kept) > 1 and sum(len(one.rays.beam) for one in kept) > RAYS_KEPT):
                kept.pop(0)
            self._at_rest = tuple(kept)
        return known.rays.at(t_s), known if self.model.leave_out.resting else None

    def _background(self, seen: Seen, rays: Rays, far: float) -> Seen:
        """A surface out of reach is still background in daylight: one ray finds it for beams that met nothing."""
        beams = indexes(seen.axis_material < 0)
        if not len(beams):
            return seen
        at = rays.nearest_axis[beams]
        beyond = self._caster.may_lie_beyond(rays.origin_m[at], rays.direction[at], rays.t_s[at], far)
        if not bool(beyond.any()):
            return seen
        beams, at = beams[beyond], at[beyond]
        self._looks_far = len(beams) > MANY_BEYOND * len(seen.axis_material) and self._caster.movers <= FEW_MOVERS
        hits = self._caster.first_hits(rays.origin_m[at], rays.direction[at], rays.t_s[at])
        material, axis_m, normal = seen.axis_material.copy(), seen.axis_m.copy(), seen.axis_normal.copy()
        material[beams], axis_m[beams], normal[beams] = hits.material, hits.range_m, hits.normal
        return replace(seen, axis_material=material, axis_m=axis_m, axis_normal=normal)

    def _pose(self, t_s: Floats, origin_m: Floats | None = None) -> Pose:
        """Where beams begin at their instants; `origin_m` (n, 3) in the sensor's frame."""
        still = self._still_pose
        if still is None:
            pose = self._scene.sensor_pose(self._mount, t_s)
            if self.shift_m is not None:
                pose = Pose(pose.position_m + pose.rotation @ self.shift_m, pose.rotation)
        else:
            n = len(t_s)
            pose = Pose(np.broadcast_to(still.position_m, (n, 3)), np.broadcast_to(still.rotation, (n, 3, 3)))
        return pose if origin_m is None else Pose(pose.to_world(origin_m), pose.rotation)


def build(scenario: Scenario, scene: Scene, caster: FacedCaster, sensor_id: str) -> Measure:
    """The measuring function of one sensor of a scenario.

    Parameters
    ----------
    scenario : the run
    scene : its bodies and motions
    caster : first hits on that scene, see raycast; leaves are put into it here
    sensor_id : which of its sensors; one that sees beams
    """
    index = next(number for number, one in enumerate(scenario.sensors) if one.id == sensor_id)
    config = scenario.sensors[index]
    extra = {name: material_from_mapping(name, entry) for name, entry in scenario.materials.items()}
    try:
        model = sensor_model(load_spec(config.model), config.physics, config.mode)
        surfaces = surface_table(scene, extra, model), surface_table(scene, extra, model, wet=True)
        draws = RandomStreams(scenario.seed, sensor_id)
        receiver = PhotonReceiver(model, model.photons, draws) if model.photons is not None else Receiver(model, draws)
        air = Air(scenario.weather, model, scene)
        others = others_of(scenario, scene, sensor_id, model) if scenario.emitters else None
    except ValueError as error:  # numbers that are right alone but not together
        raise ScenarioError(f"{scenario.label(f'sensors.{index}.physics')}: {error}") from error
    seeing = detailed(caster, scene, scenario)
    return Measure(model, scene, config.mount, seeing, surfaces, air, receiver, others=others)


def surface_table(scene: Scene, extra: Mapping[str, Material], model: SensorModel, wet: bool = False) -> Surfaces:
    """Reflection of the scene's materials at the sensor's wavelength, and which bodies are glass all through."""
    find = partial(material, extra=extra)
    every, _ = with_levels([find(name) for name in scene.materials])
    table = SurfaceTable.of(every, 1e9 * model.wavelength_m, wet, model.baseline_m)
    glass = np.array([one.model == "glass" for one in table.materials], bool)
    solid = [bool(body.geometry.closed.all() and glass[body.face_material].all()) for body in scene.bodies]
    return Surfaces.of(table, np.array(solid, bool) if any(solid) else None)
