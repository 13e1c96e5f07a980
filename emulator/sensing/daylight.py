"""Light that is not ours on the detector of every beam: sunlit surfaces, sky, the sun itself; noise and dazzle from it.

Belongs here: which of them a beam looks at. Not: their formulas (physics.background, physics.noise).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np

from emulator.physics import background, geometry, noise, sunlight
from emulator.physics.arrays import Bools, Floats, Ints, clamped, indexes
from emulator.physics.constants import ELEMENTARY_CHARGE_C, SUN_HALF_ANGLE_RAD
from emulator.sensing.contracts import Caster
from emulator.sensing.model import RECEIVER_TEMPERATURE_K, SensorModel
from emulator.sensing.paths import Seen, Surfaces
from emulator.sensing.rays import Rays

if TYPE_CHECKING:
    from emulator.scenario.weather import Sun

TOP = 1e-3
"In noise rms: crossings so near to the maximum of an echo are not looked after."
INVISIBLE = 2e-3
"Background whose shot noise adds less than this to the square of the noise is not seen."
POINTS = 61
"Over the sun's disc, or the part of it that a narrow field of view looks at: what hides it counts in sixtieths."
INSTANTS = 8
"Of a sweep of a moving sensor at which it is found out whether it stands in the sun."


@dataclass(frozen=True, eq=False)
class Daylight:
    """What background light does to each beam of a sweep."""

    noise: Floats | None
    "(n,) rms noise over that of the dark receiver; None: 1 everywhere."
    dazzled: Bools | None
    "(n,); None: no beam."
    power_w: Floats | None = None
    "(n,) background on the detector; None: too little to be seen."


NIGHT = Daylight(None, None)
ANGLE_RAD = 1e-6
"An angle from its cosine is not wrong by more, far from 0."
LIFT_M, LIFT_PER_M = 1e-3, 1e-4
"Above its surface begins a ray to the sun: at the sensor, and for each metre from it."


class Shadows:
    """Which surfaces that beams look at stand in the sun; where nothing moves, those of the last sweep."""

    def __init__(self) -> None:
        self._kept: tuple[Sun, Surfaces, Floats, float, Floats] | None = None

    def share(
        self, sun: Sun, rays: Rays, found: Seen, lit_w: Floats, limit_w: float, surfaces: Surfaces, caster: Caster
    ) -> Floats:
        """(n,) share of the sun's light that reaches each surface; 1 where its background `lit_w` is unseen anyhow.

        One ray to the middle of the disc. What it meets hides the sun, but for panes, which pass their share.
        """
        kept, moves = self._kept, bool(getattr(caster, "moves", True))
        if kept is not None and not moves:
            same = kept[0] is sun and kept[1] is surfaces and kept[2] is found.axis_m and kept[3] == limit_w
            if same and bool((rays.centre_m == rays.centre_m[0]).all()):
                return kept[4]
        share = np.ones(len(lit_w))
        at = indexes((lit_w > limit_w) & np.isfinite(found.axis_m))
        if len(at):
            ray, far = rays.nearest_axis[at], found.axis_m[at]
            lift = LIFT_M + LIFT_PER_M * far
            place = rays.origin_m[ray] + far[:, None] * rays.direction[ray] + lift[:, None] * found.axis_normal[at]
            towards = np.broadcast_to(_direction(sun), place.shape).copy()
            hits = caster.first_hits(place, towards, rays.t_s[ray])
            dark = indexes(np.isfinite(hits.range_m))
            share[at[dark]] = surfaces.table.transmission(hits.material[dark].astype(np.int64), hits.cosine[dark])
        self._kept = None if moves else (sun, surfaces, found.axis_m, limit_w, share)
        return share


def unseen_w(model: SensorModel) -> float:
    """Largest background that does not show in the noise. [W]"""
    receiver = model.receiver
    shot = _shot_a2_w(receiver.gain, receiver.ionisation_ratio, receiver.responsivity_a_w, receiver.bandwidth_hz)
    return _unseen_share(model) * receiver.baseline_a**2 / shot


@lru_cache(maxsize=64)
def _shot_a2_w(gain: float, ionisation_ratio: float, responsivity_a_w: float, bandwidth_hz: float) -> float:
    """Square of the shot noise of background light, over its power."""
    excess = float(noise.excess_noise(gain, ionisation_ratio))
    return 2.0 * ELEMENTARY_CHARGE_C * responsivity_a_w * gain**2 * excess * bandwidth_hz


def _unseen_share(model: SensorModel) -> float:
    """Share of the square of the noise that shifts no crossing by half a step.

    The threshold follows the noise, and three rms of it shift the level. A crossing that is nearer than `TOP` to its
    maximum is moved farther by any change.
    """
    slope = math.pi / model.pulse.fwhm_m * math.sqrt(model.threshold * TOP)
    return min(INVISIBLE, model.lsb_m * slope / (model.threshold + 3.0))


@dataclass(frozen=True)
class _Sky:
    """Light of the sun and the sky at the ground, clouds in. Per m of wavelength."""

    direct: float
    "On a plane that faces the sun, as far as its disc is above the horizon. [W/m^2/m]"
    whole: float
    "The same from a whole disc."
    radiance: float
    "Of the sky away from the sun. [W/m^2/sr/m]"
    ratio: float
    "Circumsolar ratio; 0: no aureole."


@lru_cache(maxsize=64)
def _clear_sky(sun: Sun, wavelength_m: float) -> _Sky:
    h, beta = sun.elevation_deg, sun.beta
    share = float(sunlight.disc_share(h))
    whole = 0.0
    if share > 0.0:
        whole = sun.cloud_factor * float(sunlight.direct_normal(h, beta, wavelength_m, sun.total_w_m2))
    radiance = sun.cloud_factor * sunlight.sky_radiance(h, beta, wavelength_m, sun.total_w_m2)
    ratio = sun.circumsolar_ratio
    if ratio is None:
        ratio = sunlight.circumsolar_ratio(h, beta, wavelength_m)
    return _Sky(share * whole, whole, radiance, ratio)


def largest_diffuse_w(sun: Sun, model: SensorModel) -> float:
    """Background of a white surface facing sun and sky, which no surface or sky exceeds. [W]"""
    if not shines(sun, model):
        return 0.0
    sky = _clear_sky(sun, model.wavelength_m)
    white = sunlight.lit_radiance(sky.direct, sky.radiance, 1.0, 1.0, 1.0)
    return _filling_w(max(float(white), sky.radiance), model)


def surfaces_show(sun: Sun | None, model: SensorModel) -> bool:
    """Light of sunlit surfaces or of the sky may show in the noise, so that it matters what is out of reach."""
    return sun is not None and shines(sun, model) and largest_diffuse_w(sun, model) > _limit_w(model)


def shines(sun: Sun, model: SensorModel) -> bool:
    """There is sunlight that this sensor may take notice of."""
    lit = sun.total_w_m2 != 0.0 and sun.cloud_factor != 0.0 and sun.elevation_deg > sunlight.NIGHT_DEG
    return model.background and lit


def _limit_w(model: SensorModel) -> float:
    return unseen_w(model) if model.leave_out.background_light and model.photons is None else 0.0


def _filling_w(radiance: float, model: SensorModel) -> float:
    """Background from a radiance, per m of wavelength, all over the field of view. [W]"""
    half = 0.5 * model.receiver.field_of_view_rad
    within = 1e-9 * model.receiver.filter_nm * radiance
    return float(background.background_sky(within, model.aperture_radius_m, half, model.efficiency))


def daylight(
    sun: Sun | None, rays: Rays, found: Seen, surfaces: Surfaces, caster: Caster, model: SensorModel,
    shadows: Shadows | None = None, reported: bool = False,
) -> Daylight:  # fmt: skip
    """Background of every beam, from what its first sub-beam looks at.

    `shadows` : those of the sweep before; `reported`: however little it is.
    """
    if sun is None or not shines(sun, model):
        return NIGHT
    limit_w = 0.0 if reported else _limit_w(model)
    power = np.zeros(len(rays.axis))
    if reported or surfaces_show(sun, model):
        power += _diffuse_w(sun, rays, found, surfaces, caster, model, shadows or Shadows(), limit_w)
    power += _SunInView(sun, rays, model).power_w(found, caster, limit_w)
    if not bool((power > limit_w).any()):
        return NIGHT
    return of_power(power, model)


def largest_near_sun_w(sun: Sun, rays: Rays, model: SensorModel) -> float:
    """Largest background of any beam from the sun's disc, its aureole and stray light, if nothing hides them. [W]"""
    return _SunInView(sun, rays, model).largest_w() if shines(sun, model) else 0.0


def of_power(power: Floats, model: SensorModel) -> Daylight:
    """What so much background (n,) on the detector does to each beam. [W]"""
    receiver = model.receiver
    current = noise.noise_current(
        0.0,
        power,
        receiver.responsivity_a_w,
        receiver.gain,
        receiver.ionisation_ratio,
        receiver.dark_bulk_a,
        receiver.dark_surface_a,
        receiver.amplifier_a_rthz,
        receiver.load_ohm,
        RECEIVER_TEMPERATURE_K,
        receiver.bandwidth_hz,
        receiver.adc_noise_a,
    )
    blind = background.dazzled(power, receiver.responsivity_a_w, receiver.gain, receiver.saturation_a)
    return Daylight(current / receiver.baseline_a, blind if bool(blind.any()) else None, power)


def _direction(sun: Sun) -> Floats:
    """Unit vector to the middle of the disc."""
    azimuth, elevation = math.radians(sun.azimuth_deg), math.radians(sun.elevation_deg)
    level = math.cos(elevation)
    return np.array([level * math.cos(azimuth), level * math.sin(azimuth), math.sin(elevation)])


def _diffuse_w(
    sun: Sun, rays: Rays, found: Seen, surfaces: Surfaces, caster: Caster, model: SensorModel, shadows: Shadows,
    limit_w: float,
) -> Floats:  # fmt: skip
    sky = _clear_sky(sun, model.wavelength_m)
    met = found.axis_material >= 0
    rho = np.zeros(len(met))
    rho[met] = surfaces.table.rho[found.axis_material[met]]
    per_radiance, cosine = _filling_w(1.0, model), found.axis_normal @ _direction(sun)
    lit = per_radiance * sunlight.lit_radiance(sky.direct, 0.0, rho, cosine, 0.0)
    under_sky = per_radiance * sunlight.lit_radiance(0.0, sky.radiance, rho, 0.0, found.axis_normal[:, 2])
    if bool((lit > 0.0).any()):
        lit = lit * shadows.share(sun, rays, found, lit, limit_w, surfaces, caster)
    return np.where(met, lit + under_sky, per_radiance * sky.radiance)


class _SunInView:
    """The sun's disc, its aureole and its stray light in the beams of a sweep."""

    def __init__(self, sun: Sun, rays: Rays, model: SensorModel) -> None:
        self._sky = _clear_sky(sun, model.wavelength_m)
        self._rays, self._towards = rays, _direction(sun)
        self._half, self._sun_rad = 0.5 * model.receiver.field_of_view_rad, math.radians(sun.elevation_deg)
        area = math.pi * model.aperture_radius_m**2
        self._per_irradiance = 1e-9 * model.receiver.filter_nm * area * model.efficiency

    def power_w(self, found: Seen, caster: Caster, limit_w: float) -> Floats:
        """(n,) background of it behind what hides it; what is below the limit may be left out. [W]"""
        power = np.zeros(len(self._rays.axis))
        if self._most_w() <= limit_w:
            return power
        if self._far_from_all(limit_w):
            return power
        angle = geometry.angle_between(self._rays.axis, self._towards)
        disc, stray, aureole = self._disc_w(angle), self._stray_w(angle), self._aureole_w(angle)
        if not bool((np.maximum(disc, stray) + aureole > limit_w).any()):
            return power
        seen = indexes(disc > 0.0)
        if len(seen):
            disc[seen] *= self._open_disc(seen, caster)
        if bool((stray > limit_w).any()):
            stray *= self._sensor_in_the_sun(caster)
        power += np.maximum(disc, stray)
        around = indexes((aureole > 0.0) & (found.axis_material < 0))
        if len(around):  # a surface out of reach hides it all the same
            rays = self._rays
            hits = caster.first_hits(rays.centre_m[around], rays.axis[around], rays.t_s[rays.nearest_axis[around]])
            power[around] += np.where(np.isnan(hits.range_m), aureole[around], 0.0)
        return power

    def largest_w(self) -> float:
        """Of any beam, if nothing hides it."""
        angle = geometry.angle_between(self._rays.axis, self._towards)
        power = np.maximum(self._disc_w(angle), self._stray_w(angle)) + self._aureole_w(angle)
        return float(np.max(power, initial=0.0))

    def _far_from_all(self, limit_w: float) -> bool:
        """No field of view reaches the aureole, and what strays into that of the nearest beam is below the limit."""
        cosine = float((self._rays.axis @ self._towards).max(initial=-1.0))
        angle = math.acos(min(cosine, 1.0)) - ANGLE_RAD
        if not angle > self._half + max(SUN_HALF_ANGLE_RAD, sunlight.AUREOLE_RAD):
            return False
        return float(self._stray_w(np.array(angle))) <= limit_w

    def _most_w(self) -> float:
        """More than any beam may get."""
        share = 1.0 if self._half > SUN_HALF_ANGLE_RAD else max((self._half / SUN_HALF_ANGLE_RAD) ** 2, 1e-4)
        return self._per_irradiance * self._sky.whole * (share + self._sky.ratio / max(1.0 - self._sky.ratio, 1e-3))

    def _disc_w(self, angle: Floats) -> Floats:
        """What of the disc is in the field of view and above the horizon."""
        share = np.zeros(len(angle))
        near = indexes(angle < self._half + SUN_HALF_ANGLE_RAD)
        if len(near) and self._sky.direct > 0.0:
            if self._sun_rad >= SUN_HALF_ANGLE_RAD:
                share[near] = background.sun_share(self._half, SUN_HALF_ANGLE_RAD, angle[near])
            else:
                upward = np.arcsin(clamped(self._rays.axis[near, 2], -1.0, 1.0))
                share[near] = sunlight.disc_seen(self._half, upward, self._sun_rad, angle[near])
        return self._per_irradiance * self._sky.whole * share

    def _stray_w(self, angle: Floats) -> Floats:
        return self._per_irradiance * self._sky.direct * np.minimum(background.stray_light(angle, self._half), 1.0)

    def _aureole_w(self, angle: Floats) -> Floats:
        power = np.zeros(len(angle))
        near = indexes(angle < self._half + sunlight.AUREOLE_RAD)
        if len(near) and self._sky.direct > 0.0 and self._sky.ratio > 0.0:
            upward = np.arcsin(clamped(self._rays.axis[near, 2], -1.0, 1.0))
            seen = sunlight.aureole_seen(self._half, angle[near], self._sky.ratio)
            power[near] = self._per_irradiance * self._sky.direct * seen * sunlight.above_horizon(self._half, upward)
        return power

    def _open_disc(self, beams: Ints, caster: Caster) -> Floats:
        """Share of what each beam sees of the disc that nothing hides: points over the smaller of field and disc."""
        axis, narrow = self._rays.axis[beams], self._half < SUN_HALF_ANGLE_RAD
        if narrow:
            points = _around(axis, self._half)
            counts = _within(points, np.broadcast_to(self._towards, axis.shape), SUN_HALF_ANGLE_RAD)
        else:
            points = np.broadcast_to(_around(self._towards[None, :], SUN_HALF_ANGLE_RAD), (len(beams), POINTS, 3))
            counts = _within(points, axis, self._half)
        counts = counts & (points[:, :, 2] >= 0.0)
        at = np.nonzero(counts)
        rays = self._rays
        hits = caster.first_hits(rays.centre_m[beams][at[0]], points[at], rays.t_s[rays.nearest_axis[beams]][at[0]])
        free = np.bincount(at[0], np.isnan(hits.range_m), len(beams))
        of = np.count_nonzero(counts, axis=1)
        return np.where(of > 0, free / np.maximum(of, 1), 1.0)

    def _sensor_in_the_sun(self, caster: Caster) -> Floats:
        """(n,) share of the disc above the horizon that nothing hides from the sensor, at some instants of a sweep."""
        rays, n = self._rays, len(self._rays.axis)
        still = bool((rays.centre_m == rays.centre_m[0]).all())
        of = np.zeros(n, np.int64) if still else np.arange(n) * INSTANTS // n
        at = np.unique(of, return_index=True)[1]
        points = _around(self._towards[None, :], SUN_HALF_ANGLE_RAD)[0]
        points = points[points[:, 2] >= 0.0]
        if not len(points):
            return np.ones(n)
        t_s = rays.t_s[rays.nearest_axis[at]]
        hits = caster.first_hits(
            rays.centre_m[at].repeat(len(points), axis=0), np.tile(points, (len(at), 1)), t_s.repeat(len(points))
        )
        share = np.isnan(hits.range_m).reshape(len(at), len(points)).mean(axis=1)
        return np.asarray(share[np.searchsorted(of[at], of)])


def _around(centre: Floats, half_rad: float) -> Floats:
    """(n, POINTS, 3) directions of equal shares of a disc around directions (n, 3): a sunflower's."""
    number = np.arange(POINTS)
    radius = math.tan(half_rad) * np.sqrt((number + 0.5) / POINTS)
    turn = number * math.pi * (3.0 - math.sqrt(5.0))
    aside = np.cross(centre, np.where(np.abs(centre[:, 2:]) < 0.9, [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]))
    aside /= np.linalg.norm(aside, axis=1, keepdims=True)
    over = np.cross(aside, centre)
    x, y = radius * np.cos(turn), radius * np.sin(turn)
    found = centre[:, None, :] + x[:, None] * aside[:, None, :] + y[:, None] * over[:, None, :]
    return np.asarray(found / np.linalg.norm(found, axis=2, keepdims=True))


def _within(points: Floats, centre: Floats, half_rad: float) -> Bools:
    return np.asarray(np.linalg.norm(points - centre[:, None, :], axis=2) <= 2.0 * math.sin(0.5 * half_rad))
