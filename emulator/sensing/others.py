"""Pulses of other lidars in the gate of a sensor: false echoes that move, as the two do not run on one clock.

Belongs here: which pulse arrives in which beam, on what way, and how strong. Two ways: straight into the receiver, and
from a surface that it looks at. Not: other light (daylight), false echoes at random places (the fault `interference`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from emulator.errors import SpecError
from emulator.physics import background, radiometry
from emulator.physics.arrays import Bools, Floats, Ints, indexes
from emulator.physics.constants import SPEED_OF_LIGHT_M_S
from emulator.physics.geometry import angle_between
from emulator.physics.subechoes import SubEchoes
from emulator.scenario.emitters import Emitter
from emulator.scenario.scenario import Scenario
from emulator.scenario.tables import Mount
from emulator.sensing.contracts import Caster
from emulator.sensing.model import SensorModel, sensor_model
from emulator.sensing.paths import Surfaces
from emulator.sensing.rays import Rays
from emulator.sensors.physics_options import PhysicsOptions
from emulator.sensors.spec import load_spec
from emulator.world.scene import Scene

UNSEEN = 1e-2
"Share of the threshold below which a pulse is not followed."
TAIL = 2.5
"Radii of a beam beyond which none of its light is followed."
LEAST_LINE = 1e-6
"Share of the laser's line within the filter below which the two have different wavelengths."
FALLBACK_TURN_HZ, FALLBACK_STEP_DEG = 10.0, 0.5
"Of a model whose facts have neither."
TOUCH_M = 1e-3
"Two rays that end so near to each other end at the same point."


@dataclass(frozen=True)
class Other:
    """One other lidar, in SI units."""

    id: str
    mount: Mount
    model: SensorModel
    turn_rad_s: float
    start_rad: float
    field_rad: float
    period_s: float
    phase_s: float
    passes: float
    "Share of its light that passes our filter."

    def azimuth_rad(self, t_s: Floats) -> Floats:
        """Where its beam points, in its own frame, -pi to pi."""
        turned = self.start_rad + self.turn_rad_s * t_s
        return np.asarray(np.mod(turned + math.pi, 2.0 * math.pi) - math.pi)

    def pulses(self, from_s: Floats, to_s: Floats) -> tuple[Ints, Floats]:
        """Its pulses in windows (n,): the window of each (k,), and when it leaves (k,)."""
        first = np.ceil((from_s - self.phase_s) / self.period_s)
        count = np.maximum(np.floor((to_s - self.phase_s) / self.period_s) - first + 1.0, 0.0).astype(np.int64)
        window = np.arange(len(first)).repeat(count)
        place = np.arange(len(window)) - (count.cumsum() - count).repeat(count)
        t_s = self.phase_s + (first[window] + place) * self.period_s
        fires = np.abs(self.azimuth_rad(t_s)) <= 0.5 * self.field_rad
        return window[fires], t_s[fires]

    @property
    def half_rad(self) -> float:
        """Half angle of its beam."""
        return math.sqrt(self.model.beam.half_angle_x_rad * self.model.beam.half_angle_y_rad)

    def width_m(self, range_m: Floats) -> Floats:
        """Radius of its beam."""
        return self.half_rad * range_m + self.model.beam.exit_radius_m


class Others:
    """All other lidars that one sensor may receive."""

    def __init__(self, found: tuple[Other, ...], elsewhere: tuple[str, ...], scene: Scene, model: SensorModel) -> None:
        """`elsewhere`: those whose wavelength our filter stops."""
        self.found, self.elsewhere = found, elsewhere
        self._scene, self._model = scene, model
        self._white = model.k_m2 / model.peak_w
        "Amplitude of a white plate at 1 m that another laser lights with 1 W."

    def pulses_of(self, beams: int) -> float:
        """Mean number of pulses, from anywhere, that leave during the gates of so many beams."""
        gate_s = 2.0 * (self._model.gate_m - self._model.near_gate_m) / SPEED_OF_LIGHT_M_S
        return sum(beams * gate_s / one.period_s * one.field_rad / (2.0 * math.pi) for one in self.found)

    def echoes(
        self, rays: Rays, t_s: Floats, caster: Caster, surfaces: Surfaces, extinction_per_m: float, gain: float,
        farthest_m: float,
    ) -> list[SubEchoes]:  # fmt: skip
        """What of their pulses comes into the gates of a sweep, amplitudes in rms noise of the dark receiver."""
        model = self._model
        far_m = min(model.gate_m, farthest_m)
        parts = []
        for one in self.found:
            start = self._scene.sensor_pose(one.mount, t_s[:1]).position_m[0]
            apart_m = float(np.max(np.linalg.norm(rays.centre_m - start, axis=1)))
            longest_m = apart_m + 2.0 * far_m  # by way of a surface as far as we look
            earliest = (2.0 * model.near_gate_m - longest_m) / SPEED_OF_LIGHT_M_S
            beam, left_s = one.pulses(t_s + earliest, t_s + 2.0 * far_m / SPEED_OF_LIGHT_M_S)
            if not len(beam):
                continue
            pose = self._scene.sensor_pose(one.mount, left_s)
            azimuth = one.azimuth_rad(left_s)
            aim = np.stack([np.cos(azimuth), np.sin(azimuth), np.zeros(len(azimuth))], axis=1)
            light = _Pulses(beam, left_s, pose.position_m, np.einsum("kij,kj->ki", pose.rotation, aim))
            for way_m, amplitude in (
                self._straight(one, light, rays, caster, extinction_per_m),
                self._by_surfaces(one, light, rays, caster, surfaces, extinction_per_m, far_m),
            ):
                seen_m = 0.5 * (SPEED_OF_LIGHT_M_S * (left_s - t_s[beam]) + way_m)
                amplitude = amplitude * gain
                kept = (amplitude > UNSEEN * model.threshold) & (seen_m >= model.near_gate_m) & (seen_m <= far_m)
                if bool(kept.any()):
                    parts.append(SubEchoes.of(beam[kept], seen_m[kept], amplitude[kept]))
        return parts

    def _straight(
        self, one: Other, light: _Pulses, rays: Rays, caster: Caster, extinction_per_m: float
    ) -> tuple[Floats, Floats]:
        """Length of the way and amplitude of each pulse that shines at the sensor itself."""
        model, back = self._model, light.position_m - rays.centre_m[light.beam]
        way_m = np.linalg.norm(back, axis=1)
        amplitude = np.zeros(len(way_m))
        along = -np.einsum("ij,ij->i", light.aim, back)
        aside = np.linalg.norm(np.cross(light.aim, back), axis=1)
        near = indexes((along > TOUCH_M) & (aside < TAIL * one.width_m(along) + model.aperture_radius_m))
        if not len(near):
            return way_m, amplitude
        d, to = way_m[near], back[near] / way_m[near, None]
        half = 0.5 * model.receiver.field_of_view_rad
        off = angle_between(rays.axis[light.beam[near]], to)
        share = np.where(off <= half, 1.0, np.minimum(background.stray_light(off, half), 1.0))
        # of the beam's light on our aperture; a white plate sends pi a^2/(pi R^2) of it there
        on_us = radiometry.fill_disc_offset(model.aperture_radius_m, one.width_m(along[near]), aside[near])
        amplitude[near] = self._white * one.model.peak_w * one.passes * on_us / model.aperture_radius_m**2 * share
        amplitude[near] *= np.exp(-extinction_per_m * d)
        bright = near[amplitude[near] > UNSEEN * model.threshold]
        if len(bright):
            clear = self._clear(light.at(bright), rays, back[bright], way_m[bright], caster)
            amplitude[bright[~clear]] = 0.0
        return way_m, amplitude

    def _by_surfaces(
        self, one: Other, light: _Pulses, rays: Rays, caster: Caster, surfaces: Surfaces, extinction_per_m: float,
        far_m: float,
    ) -> tuple[Floats, Floats]:  # fmt: skip
        """The same of each pulse whose spot on a surface we look at."""
        model = self._model
        hits = caster.first_hits(light.position_m, light.aim, light.left_s)
        way_m, amplitude = np.zeros(len(light.beam)), np.zeros(len(light.beam))
        met = indexes(hits.material >= 0)
        if not len(met):
            return way_m, amplitude
        out_m, place = hits.range_m[met], light.beam[met]
        spot = light.position_m[met] + out_m[:, None] * light.aim[met]
        to = spot - rays.centre_m[place]
        r = np.maximum(np.linalg.norm(to, axis=1), TOUCH_M)
        normal = hits.normal[met]
        cosine = -np.einsum("ij,ij->i", normal, to) / r
        lit = -np.einsum("ij,ij->i", normal, light.aim[met])
        half, width = 0.5 * model.receiver.field_of_view_rad, one.width_m(out_m)
        off = angle_between(rays.axis[place], to / r[:, None])
        good = (cosine * lit > 0.0) & (r < far_m) & (r * off < half * r + TAIL * width)
        met, out_m, to, r, cosine, off, width = (x[good] for x in (met, out_m, to, r, cosine, off, width))
        if not len(met):
            return way_m, amplitude
        share = radiometry.fill_disc_offset(half * r, width, r * off)
        rho = surfaces.table.rho[hits.material[met]]
        strength = self._white * one.model.peak_w * one.passes * share * rho * np.abs(cosine)
        strength *= radiometry.overlap(r, model.overlap_start_m, model.overlap_full_m)
        strength *= np.exp(-extinction_per_m * (out_m + r)) / (r**2 + model.aperture_radius_m**2)
        bright = strength > UNSEEN * model.threshold
        bright[bright] = self._clear(light.at(met[bright]), rays, to[bright], r[bright], caster)
        way_m[met], amplitude[met] = out_m + r, np.where(bright, strength, 0.0)
        return way_m, amplitude

    def _clear(self, light: _Pulses, rays: Rays, to: Floats, far_m: Floats, caster: Caster) -> Bools:
        """Nothing stands between the sensor and a point at `to` from it."""
        if not len(far_m):
            return np.zeros(0, bool)
        hits = caster.first_hits(rays.centre_m[light.beam], to / far_m[:, None], light.left_s)
        return np.asarray(~(hits.range_m < far_m - TOUCH_M - 1e-4 * far_m))


@dataclass(frozen=True, eq=False)
class _Pulses:
    """Pulses (k,) on their way to beams."""

    beam: Ints
    left_s: Floats
    position_m: Floats
    aim: Floats

    def at(self, which: Ints | Bools) -> _Pulses:
        return _Pulses(self.beam[which], self.left_s[which], self.position_m[which], self.aim[which])


def others_of(scenario: Scenario, scene: Scene, sensor: str, model: SensorModel) -> Others | None:
    """The other lidars of a scenario for one of its sensors; None: there is none. `ValueError` names what is wrong."""
    found, elsewhere = [], []
    for config in scenario.emitters:
        if config.sensor == sensor:
            continue
        one = _other(config, scenario, model)
        if one.passes < LEAST_LINE:
            elsewhere.append(one.id)
        else:
            found.append(one)
    return Others(tuple(found), tuple(elsewhere), scene, model) if found or elsewhere else None


def _other(config: Emitter, scenario: Scenario, ours: SensorModel) -> Other:
    mount, options, mode = config.mount or Mount(), PhysicsOptions(), "operational"
    name = config.model or ""
    if config.sensor is not None:
        of = next(sensor for sensor in scenario.sensors if sensor.id == config.sensor)
        mount, options, mode, name = of.mount, of.physics, of.mode, of.model
    try:
        spec = load_spec(name)
    except SpecError as error:
        raise ValueError(str(error)) from error
    model = sensor_model(spec, options, mode)
    geometry = spec.geometry
    turn_hz = config.turn_hz
    if turn_hz is None:
        turn_hz = max(geometry.turn_hz.value) if geometry is not None else FALLBACK_TURN_HZ
    step_deg = max(geometry.steps_deg.value) if geometry is not None else FALLBACK_STEP_DEG
    pulse_hz = config.pulse_hz
    if pulse_hz is None:
        pulse_hz = (turn_hz or FALLBACK_TURN_HZ) * 360.0 / step_deg
    field_deg = config.field_deg
    if field_deg is None:
        field_deg = geometry.field_deg.value if geometry is not None else 360.0
    clockwise = geometry is not None and geometry.direction.value == "clockwise"
    line_m = 1e-9 * (spec.optics.line_width_nm.value if spec.optics and spec.optics.line_width_nm else 0.0)
    band_m = 1e-9 * ours.receiver.filter_nm
    rate = 1.0 + 1e-6 * config.clock_ppm
    return Other(
        id=config.id,
        mount=mount,
        model=model,
        turn_rad_s=2.0 * math.pi * turn_hz * rate * (-1.0 if clockwise else 1.0),
        start_rad=math.radians(config.start_deg),
        field_rad=math.radians(field_deg) if turn_hz else 2.0 * math.pi,
        period_s=1.0 / (pulse_hz * rate),
        phase_s=1e-6 * config.phase_us,
        passes=float(background.filter_line_share(line_m, band_m, model.wavelength_m - ours.wavelength_m)),
    )
