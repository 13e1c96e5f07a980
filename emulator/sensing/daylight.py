"""Light that is not ours on the detector of every beam: sunlit surfaces, sky, the sun itself; noise and dazzle from it.

Belongs here: which of them a beam looks at. Not: their formulas (physics.background, physics.noise).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from emulator.physics import background, geometry, noise
from emulator.physics.arrays import Bools, Floats, clamped
from emulator.physics.constants import ELEMENTARY_CHARGE_C, SKY_RADIANCE_W_M2_SR_NM, SUN_TABLE_TOTAL_W_M2
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


def unseen_w(model: SensorModel) -> float:
    """Largest background that does not show in the noise. [W]"""
    receiver = model.receiver
    excess = float(noise.excess_noise(receiver.gain, receiver.ionisation_ratio))
    shot = 2.0 * ELEMENTARY_CHARGE_C * receiver.responsivity_a_w * receiver.gain**2 * excess * receiver.bandwidth_hz
    return _unseen_share(model) * receiver.baseline_a**2 / shot


def _unseen_share(model: SensorModel) -> float:
    """Share of the square of the noise that shifts no crossing by half a step.

    The threshold follows the noise, and three rms of it shift the level. A crossing that is nearer than `TOP` to its
    maximum is moved farther by any change.
    """
    slope = math.pi / model.pulse.fwhm_m * math.sqrt(model.threshold * TOP)
    return min(INVISIBLE, model.lsb_m * slope / (model.threshold + 3.0))


def largest_diffuse_w(sun: Sun, model: SensorModel) -> float:
    """Background of a white surface facing the sun, which no surface or sky exceeds. [W]"""
    irradiance = background.solar_ground(model.wavelength_m, sun.total_w_m2) * sun.cloud_factor
    half = 0.5 * model.receiver.field_of_view_rad
    white = background.background_surface(
        irradiance, _band_m(model), 1.0, 0.0, model.aperture_radius_m, half, model.efficiency
    )
    return max(float(white), _sky_w(sun, model))


def surfaces_show(sun: Sun | None, model: SensorModel) -> bool:
    """Light of sunlit surfaces or of the sky may show in the noise, so that it matters what is out of reach."""
    return sun is not None and _shines(sun, model) and largest_diffuse_w(sun, model) > _limit_w(model)


def _shines(sun: Sun, model: SensorModel) -> bool:
    return model.background and sun.total_w_m2 != 0.0 and sun.elevation_deg > 0.0


def _limit_w(model: SensorModel) -> float:
    return unseen_w(model) if model.leave_out.background_light and model.photons is None else 0.0


def _band_m(model: SensorModel) -> float:
    return 1e-9 * model.receiver.filter_nm


def _sky_w(sun: Sun, model: SensorModel) -> float:
    radiance = SKY_RADIANCE_W_M2_SR_NM * sun.total_w_m2 / SUN_TABLE_TOTAL_W_M2 * sun.cloud_factor
    half = 0.5 * model.receiver.field_of_view_rad
    power = background.background_sky(
        radiance * model.receiver.filter_nm, model.aperture_radius_m, half, model.efficiency
    )
    return float(power)


def daylight(
    sun: Sun | None, rays: Rays, found: Seen, surfaces: Surfaces, caster: Caster, model: SensorModel
) -> Daylight:
    """Background of every beam, from what its first sub-beam looks at."""
    if sun is None or not _shines(sun, model):
        return NIGHT
    towards = _direction(sun)
    limit_w = _limit_w(model)
    power = np.zeros(len(rays.axis))
    if surfaces_show(sun, model):
        power += _diffuse_w(sun, towards, found, surfaces, model)
    direct = _sun_w(sun, towards, rays, model)
    if bool((direct > limit_w).any()):
        power += np.where(_in_the_sun(rays, towards, caster), direct, 0.0)
    if not bool((power > limit_w).any()):
        return NIGHT
    return of_power(power, model)


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
    azimuth, elevation = math.radians(sun.azimuth_deg), math.radians(sun.elevation_deg)
    level = math.cos(elevation)
    return np.array([level * math.cos(azimuth), level * math.sin(azimuth), math.sin(elevation)])


def _diffuse_w(sun: Sun, towards: Floats, found: Seen, surfaces: Surfaces, model: SensorModel) -> Floats:
    irradiance = background.solar_ground(model.wavelength_m, sun.total_w_m2) * sun.cloud_factor
    half = 0.5 * model.receiver.field_of_view_rad
    met = found.axis_material >= 0
    rho = np.zeros(len(met))
    rho[met] = surfaces.table.rho[found.axis_material[met]]
    incidence = np.arccos(clamped(found.axis_normal @ towards, -1.0, 1.0))
    lit = background.background_surface(
        irradiance, _band_m(model), rho, incidence, model.aperture_radius_m, half, model.efficiency
    )
    return np.where(met, lit, _sky_w(sun, model))


def _sun_w(sun: Sun, towards: Floats, rays: Rays, model: SensorModel) -> Floats:
    irradiance = background.solar_ground(model.wavelength_m, sun.total_w_m2, direct=True) * sun.cloud_factor
    half = 0.5 * model.receiver.field_of_view_rad
    angle = geometry.angle_between(rays.axis, towards)
    return background.background_sun(
        irradiance, _band_m(model), model.aperture_radius_m, half, model.efficiency, angle
    )  # fmt: skip


def _in_the_sun(rays: Rays, towards: Floats, caster: Caster) -> bool:
    """Nothing stands between the sensor and the sun; one ray for the sweep."""
    hits = caster.first_hits(rays.centre_m[:1], towards[None, :], rays.t_s[:1])
    return bool(np.isnan(hits.range_m[0]))
