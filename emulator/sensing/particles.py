"""Single drops and flakes in the beams of a sweep, where a medium is too thin to be a continuum.

Belongs here: which of rain and snow are particles for a sensor, and the drawing of those that are seen. Not: spectra
and thinning (physics.precipitation), extinction by them (air).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from emulator.physics import atmosphere, precipitation
from emulator.physics.arrays import Floats, Ints
from emulator.physics.beams import NO_WIDTH
from emulator.physics.random_streams import RandomStreams
from emulator.physics.subechoes import SubEchoes
from emulator.scenario.weather import Rain, Snow
from emulator.sensing.model import SensorModel

RARE = 1e-3
"Mean number of particles a sweep below which none is drawn."
TYPICAL_M = 10.0
"Where the pulse cell is taken that decides between particles and continuum."
SMALLEST_COUNTED_MM = 0.5
LEAST_K_M2 = 1e-40
"System constant below which no particle is seen: the filter keeps all light out, and sizes would overflow."
MOST_A_BEAM = 3000.0
"Particles seen alone by one beam from which they are a continuum."


@dataclass(frozen=True)
class Particles:
    """What falls, for one sensor: a size spectrum, or one size."""

    term: str
    "Name of its random numbers."
    spectrum: precipitation.Spectrum | None
    diameter_mm: float = 0.0
    number_m3: float = 0.0
    kappa_sr: float = 0.0


def rain_particles(rain: Rain | None, model: SensorModel) -> Particles | None:
    """Rain as particles, or None where there is none or it is a continuum."""
    if rain is None or rain.rate_mm_h == 0.0 or not model.weather_echoes or rain.echoes in ("off", "continuum"):
        return None
    kappa = rain.backscatter_per_d2_sr
    if rain.drop_radius_mm is not None:
        diameter_mm = 2.0 * rain.drop_radius_mm
        volume_m3 = math.pi / 6.0 * (1e-3 * diameter_mm) ** 3
        density = rain.rate_mm_h / 3.6e6 / (volume_m3 * float(atmosphere.fall_speed_atlas(diameter_mm)))
        made = Particles("rain", None, diameter_mm, density, kappa)
    else:
        made = Particles("rain", precipitation.rain_spectrum(rain.rate_mm_h, kappa))
    return _singly(made, model, rain.echoes)


def snow_particles(snow: Snow | None, model: SensorModel) -> Particles | None:
    """Snow as particles, or None where there is none or it is a continuum."""
    if snow is None or snow.rate_mm_h == 0.0 or not model.weather_echoes or snow.echoes in ("off", "continuum"):
        return None
    made = Particles("snow", precipitation.snow_spectrum(snow.rate_mm_h, snow.flake_reflectance / 4.0))
    return _singly(made, model, snow.echoes)


def _singly(particles: Particles, model: SensorModel, echoes: str) -> Particles | None:
    """The particles, where they are to be drawn one by one; a `ValueError` where that is asked and cannot be."""
    if model.k_m2 < LEAST_K_M2:
        return None
    drawn = echoes == "drops" or _sparse(particles, model)
    if drawn and (mean := _mean_of_a_beam(particles, model)) > MOST_A_BEAM:
        if echoes == "drops":
            told = f"weather.{particles.term}.echoes: drops, {mean:.3g} of them seen in a beam"
            raise ValueError(f"{told}; want continuum or auto from {MOST_A_BEAM:g} on")
        return None
    return particles if drawn else None


def _mean_of_a_beam(particles: Particles, model: SensorModel) -> float:
    """Mean number of particles that alone are seen by one beam that nothing stops."""
    half_angle, near_m = _cone_of(model)
    if half_angle == 0.0 or near_m >= model.gate_m:
        return 0.0
    scale = _scale(particles, half_angle, model)
    if particles.spectrum is None:
        end = max(min(model.gate_m, math.sqrt(particles.diameter_mm / scale)), near_m)
        return particles.number_m3 * math.pi * half_angle**2 * (end**3 - near_m**3) / 3.0
    return float(precipitation.detectable_mean(particles.spectrum, scale, half_angle, near_m, model.gate_m))


def _cone_of(model: SensorModel) -> tuple[float, float]:
    """Half angle of the beam, and where its particles begin to be seen."""
    half_angle = math.sqrt(model.beam.half_angle_x_rad * model.beam.half_angle_y_rad)
    return (half_angle if half_angle >= NO_WIDTH else 0.0), max(model.overlap_start_m, model.near_gate_m)


def _scale(particles: Particles, half_angle: float, model: SensorModel, gain: float = 1.0) -> float:
    kappa = particles.kappa_sr if particles.spectrum is None else particles.spectrum.kappa_sr
    return float(
        precipitation.detectable_scale(
            half_angle,
            kappa,
            model.peak_w,
            math.pi * model.aperture_radius_m**2,
            model.efficiency,
            model.threshold / gain * model.nep_w,
        )
    )


def _sparse(particles: Particles, model: SensorModel) -> bool:
    """Few enough in a pulse cell that they are seen one by one."""
    radius = math.sqrt(math.prod(float(r) for r in model.beam.radius_m(TYPICAL_M)))
    if particles.spectrum is not None:
        count = float(
            precipitation.particles_per_cell(particles.spectrum, SMALLEST_COUNTED_MM, radius, model.pulse.fwhm_s)
        )
    else:
        count = particles.number_m3 * math.pi * radius**2 * model.pulse.fwhm_m
    return count <= precipitation.CONTINUUM_PER_CELL


def seen_particles(
    particles: Particles,
    far_m: Floats,
    extinction_per_m: float,
    sweep: int,
    model: SensorModel,
    draws: RandomStreams,
    gain: float = 1.0,
) -> SubEchoes | None:
    """Sub-echoes of the particles that alone reach the threshold, up to each beam's first surface, `far_m` (n,)."""
    half_angle, near_m = _cone_of(model)
    mean = mean_seen(particles, far_m, model, gain)
    if not bool(mean.any()) or (float(mean.sum()) < RARE and model.leave_out.particles):
        return None
    nep_w = model.nep_w
    area_m2 = math.pi * model.aperture_radius_m**2
    kappa = particles.kappa_sr if particles.spectrum is None else particles.spectrum.kappa_sr
    scale = _scale(particles, half_angle, model, gain)
    far = np.minimum(far_m, model.gate_m)
    count = draws.poisson(particles.term, sweep, mean)
    if particles.spectrum is None:
        end = _last_of_one_size(particles, scale, near_m, far)
        beam, range_m, diameter_mm = _one_size(particles, near_m, end, sweep, draws, count)
    else:
        uniform = _numbers(draws, particles.term, sweep, count)
        beam, range_m, diameter_mm = precipitation.detectable_particles(
            particles.spectrum, np.full(len(far), scale), half_angle, near_m, far, count, uniform
        )
    if len(beam) == 0:
        return None
    power_w = precipitation.particle_power(
        diameter_mm, kappa, range_m, half_angle, extinction_per_m * range_m, model.peak_w, area_m2, model.efficiency
    )
    # near the window the beam is wider than its cone
    cone = half_angle * range_m
    power_w = power_w * (cone / (cone + model.beam.exit_radius_m)) ** 2
    return SubEchoes.of(beam, range_m, gain * power_w / nep_w)


def mean_seen(particles: Particles, far_m: Floats, model: SensorModel, gain: float = 1.0) -> Floats:
    """(n,) mean numbers of those that alone reach the threshold, up to each beam's first surface, `far_m` (n,)."""
    half_angle, near_m = _cone_of(model)
    if half_angle == 0.0 or near_m >= model.gate_m:
        return np.zeros(len(far_m))
    scale, far = _scale(particles, half_angle, model, gain), np.minimum(far_m, model.gate_m)
    if particles.spectrum is None:
        end = _last_of_one_size(particles, scale, near_m, far)
        return np.asarray(particles.number_m3 * math.pi * half_angle**2 * (end**3 - near_m**3) / 3.0)
    return np.asarray(precipitation.detectable_mean(particles.spectrum, scale, half_angle, near_m, far))


def _last_of_one_size(particles: Particles, scale: float, near_m: float, far: Floats) -> Floats:
    return np.maximum(np.minimum(far, math.sqrt(particles.diameter_mm / scale)), near_m)


def _one_size(
    particles: Particles, near_m: float, end: Floats, sweep: int, draws: RandomStreams, count: Ints
) -> tuple[Ints, Floats, Floats]:
    if not bool(count.any()):
        return np.zeros(0, np.int64), np.zeros(0), np.zeros(0)
    uniform = _numbers(draws, particles.term, sweep, count)[:, 0]
    beam = np.arange(len(end)).repeat(count)
    range_m = np.cbrt(near_m**3 + uniform * (end[beam] ** 3 - near_m**3))
    return beam, range_m, np.full(len(beam), particles.diameter_mm)


def _numbers(draws: RandomStreams, term: str, sweep: int, count: Ints) -> Floats:
    """Two uniform numbers for each particle; those of a beam do not depend on how many the others have."""
    most = int(count.max(initial=0))
    table = np.stack([draws.uniform(f"{term} {k}", sweep, len(count), 2) for k in range(most)] or [np.zeros((0, 2))])
    taken = np.arange(most)[None, :] < count[:, None]
    return np.asarray(np.moveaxis(table, 0, 1)[taken]) if most else np.zeros((0, 2))
