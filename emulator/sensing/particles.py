"""Single drops and flakes in the beams of a sweep, where a medium is too thin to be a continuum.

Belongs here: which of rain and snow are particles for a sensor, and the drawing of those that are seen. Not: spectra
and thinning (physics.precipitation), extinction by them (air).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from emulator.physics import atmosphere, precipitation
from emulator.physics.arrays import Floats, Ints
from emulator.physics.particle_light import Optics, ParticleLight, Sizes
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
DRAWN = (0.05, 0.1, 0.2, 0.4, 1.0)
"""Shares of the level from which a particle is drawn: the first that leaves few enough in a beam. A cut of 0.1 is good
to 1 % of the beams that answer, one of 0.3 to 3 %."""
MOST_DRAWN = 60.0
"Particles drawn in one beam at the most, where the share may still grow."


@dataclass(frozen=True)
class Particles:
    """What falls, for one sensor: a size spectrum, or one size."""

    term: str
    "Name of its random numbers."
    spectrum: precipitation.Spectrum | None
    diameter_mm: float = 0.0
    number_m3: float = 0.0
    kappa_sr: float = 0.0

    @property
    def sizes(self) -> Sizes:
        """How many there are of which size."""
        if self.spectrum is not None:
            return Sizes.of_spectrum(self.spectrum)
        return Sizes(self.number_m3, 0.0, self.diameter_mm, self.kappa_sr)


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
    if drawn and (mean := float(light_of(particles, model, 0.0, 1.0, 1.0).mean(np.array(np.inf)))) > MOST_A_BEAM:
        if echoes == "drops":
            told = f"weather.{particles.term}.echoes: drops, {mean:.3g} of them seen in a beam"
            raise ValueError(f"{told}; want continuum or auto from {MOST_A_BEAM:g} on")
        return None
    return particles if drawn else None


def light_of(
    particles: Particles, model: SensorModel, extinction_per_m: float, gain: float, share: float
) -> ParticleLight:
    """The law of these particles in one beam, of those drawn that send back this share of the level."""
    beam = model.beam
    optics = Optics(
        beam.profile == "gauss",
        math.tan(beam.half_angle_x_rad),
        math.tan(beam.half_angle_y_rad),
        beam.exit_radius_m,
        model.k_m2 * gain,
        model.overlap_start_m,
        model.overlap_full_m,
        model.threshold,
        model.floor_m2,
        0.0 if beam.is_ray else model.gate_m,
        model.pulse,
    )
    return ParticleLight(particles.sizes, optics, extinction_per_m, share)


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


class Falling:
    """What falls, as one sensor sees it."""

    def __init__(self, model: SensorModel) -> None:
        self._model = model

        @lru_cache(maxsize=32)
        def light(particles: Particles, extinction_per_m: float, gain: float) -> ParticleLight:
            beam = np.array(np.inf)
            for share in DRAWN:
                made = light_of(particles, model, extinction_per_m, gain, share)
                if float(made.mean(beam)) <= MOST_DRAWN:
                    break
            return made

        self.light = light

    def mean_drawn(self, particles: Particles, far_m: Floats, extinction_per_m: float, gain: float = 1.0) -> Floats:
        """(n,) mean numbers of those drawn, up to each beam's first surface, `far_m` (n,)."""
        return self.light(particles, extinction_per_m, gain).mean(far_m)

    def seen(
        self,
        particles: Particles,
        far_m: Floats,
        extinction_per_m: float,
        sweep: int,
        draws: RandomStreams,
        gain: float = 1.0,
    ) -> SubEchoes | None:
        """Sub-echoes of the particles that may be seen, alone or together, up to each beam's first surface."""
        light = self.light(particles, extinction_per_m, gain)
        mean = light.mean(far_m)
        if not bool(mean.any()) or (float(mean.sum()) < RARE and self._model.leave_out.particles):
            return None
        count = draws.poisson(particles.term, sweep, mean)
        if not bool(count.any()):
            return None
        uniform = _numbers(draws, particles.term, sweep, count)
        beam = np.arange(len(count)).repeat(count)
        range_m = light.ranges(far_m[beam], uniform[:, 0])
        size_mm = light.drawn_sizes(range_m, uniform[:, 1])
        amplitude = light.unit(range_m) * size_mm**2 * light.lift(range_m)
        return SubEchoes.of(beam, range_m, amplitude)


def _numbers(draws: RandomStreams, term: str, sweep: int, count: Ints) -> Floats:
    """Two uniform numbers for each particle; those of a beam do not depend on how many the others have."""
    most = int(count.max(initial=0))
    table = np.stack([draws.uniform(f"{term} {k}", sweep, len(count), 2) for k in range(most)] or [np.zeros((0, 2))])
    taken = np.arange(most)[None, :] < count[:, None]
    return np.asarray(np.moveaxis(table, 0, 1)[taken]) if most else np.zeros((0, 2))
