"""Single drops and flakes in the beams of a sweep, where a medium is too thin to be a continuum.

Belongs here: which of rain and snow are particles for a sensor, and the drawing of those that are seen. Not: spectra
and thinning (physics.precipitation), extinction by them (air).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from emulator.physics import atmosphere, precipitation
from emulator.physics.arrays import Floats, Ints, group_starts, ramp
from emulator.physics.hidden import Hidden
from emulator.physics.particle_light import Optics, ParticleLight, Sizes
from emulator.physics.random_streams import RandomStreams
from emulator.physics.softprofile import SoftProfile
from emulator.physics.subechoes import SubEchoes
from emulator.physics.world_particles import Lines, WorldParticles, class_middles
from emulator.scenario.weather import Rain, Snow
from emulator.sensing.model import SensorModel
from emulator.sensing.rays import Rays

Wind = tuple[float, float, float]
CALM: Wind = (0.0, 0.0, 0.0)
SNOW_FALL_M_S = 1.0
"Flakes of all sizes: 0.5 to 1.5 m/s (Locatelli and Hobbs 1974)."
RARE = 1e-3
"Mean number of particles a sweep below which none is drawn."
TYPICAL_M = 10.0
"Where the pulse cell is taken that decides between particles and continuum."
SMALLEST_COUNTED_MM = 0.5
LEAST_K_M2 = 1e-40
"System constant below which no particle is seen: the filter keeps all light out, and sizes would overflow."
MOST_A_BEAM = 3000.0
"Particles seen alone by one beam from which they are a continuum."
DRAWN = {0.1: 0.01, 0.2: 0.04, 0.4: 0.08, 1.0: 1.0}
"""Shares of the level from which a particle is drawn, and the share of the beams that answer by particles which is
wrong then. The largest of which too few beams answer for that to count; else the first that leaves few enough."""
MOST_LEFT = 0.2
"Such a share at the most, where few answer: shadows of larger particles flicker."
WRONG = 0.004
"Share of all beams that may be wrong for it."
FAINTEST_SHADOW = 1e-3
"Mean loss there and back by the drawn particles from which their shadows are looked at."
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
    wind_m_s: tuple[float, float, float] = (0.0, 0.0, 0.0)

    @property
    def fall_m_s(self) -> Floats | float:
        """Speed at which each class of sizes falls."""
        return SNOW_FALL_M_S if self.term == "snow" else atmosphere.fall_speed_atlas(class_middles(self.sizes))

    @property
    def sizes(self) -> Sizes:
        """How many there are of which size."""
        if self.spectrum is not None:
            return Sizes.of_spectrum(self.spectrum)
        return Sizes(self.number_m3, 0.0, self.diameter_mm, self.kappa_sr)


def rain_particles(rain: Rain | None, model: SensorModel, wind: Wind = CALM) -> Particles | None:
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
    return _singly(replace(made, wind_m_s=wind), model, rain.echoes)


def snow_particles(snow: Snow | None, model: SensorModel, wind: Wind = CALM) -> Particles | None:
    """Snow as particles, or None where there is none or it is a continuum."""
    if snow is None or snow.rate_mm_h == 0.0 or not model.weather_echoes or snow.echoes in ("off", "continuum"):
        return None
    made = Particles("snow", precipitation.snow_spectrum(snow.rate_mm_h, snow.flake_reflectance / 4.0))
    return _singly(replace(made, wind_m_s=wind), model, snow.echoes)


def _singly(particles: Particles, model: SensorModel, echoes: str) -> Particles | None:
    """The particles, where they are to be drawn one by one; a `ValueError` where that is asked and cannot be."""
    if model.k_m2 < LEAST_K_M2:
        return None
    drawn = echoes == "drops" or _sparse(particles, model)
    if drawn and (mean := float(light_of(particles, model, 0.0, 1.0, 1.0).mean(np.array(np.inf)))) > MOST_A_BEAM:
        if echoes == "drops":
            reported = f"weather.{particles.term}.echoes: drops, {mean:.3g} of them seen in a beam"
            raise ValueError(f"{reported}; want continuum or auto from {MOST_A_BEAM:g} on")
        return None
    return particles if drawn else None


def light_of(
    particles: Particles, model: SensorModel, extinction_per_m: float, gain: float, share: float,
    hidden: Hidden | None = None,
) -> ParticleLight:  # fmt: skip
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
        hidden,
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


@dataclass(frozen=True, eq=False)
class Drawn:
    """Particles of one kind in the beams of a sweep."""

    light: ParticleLight
    echoes: SubEchoes
    beam: Ints
    "(k,) ascending"
    range_m: Floats
    "(k,) ascending within a beam"
    lost: Floats
    "(k,) logarithm of the share of the beam that passes, one way."

    @classmethod
    def of(cls, light: ParticleLight, beam: Ints, range_m: Floats, size_mm: Floats) -> Drawn:
        """From their effective sizes."""
        order = np.lexsort((range_m, beam))
        beam, range_m, size_mm = beam[order], range_m[order], size_mm[order]
        amplitude = light.unit(range_m) * size_mm**2 * light.lift(range_m)
        lost = np.log1p(-light.kept_out(range_m, size_mm))
        return cls(light, SubEchoes.of(beam, range_m, amplitude), beam, range_m, lost)

    def shades(self, nearest_m: Floats) -> bool:
        """Surfaces stand where the mean shadow is dark enough to be looked at."""
        behind = nearest_m[np.isfinite(nearest_m)]
        return float(self.light.mean_shadow(behind).max(initial=0.0)) >= FAINTEST_SHADOW

    def shade(self, found: SubEchoes) -> SubEchoes:
        """What stands behind, in the shadows of these particles; on the average it keeps all its light.

        The extinction holds their mean already: where they are few or none, what is behind is a little brighter.
        """
        exponent = self.light.mean_shadow(found.range_m)
        beams = self.beam[group_starts(self.beam)]
        first = found.beam.searchsorted(beams)
        count = found.beam.searchsorted(beams, side="right") - first
        at = first.repeat(count) + ramp(count)
        beam, range_m = found.beam[at], found.range_m[at]
        length = float(max(range_m.max(initial=0.0), self.range_m.max(initial=0.0))) + 1.0
        place = (self.beam * length + self.range_m).searchsorted(beam * length + range_m)
        lost = np.concatenate([[0.0], self.lost.cumsum()])
        exponent[at] += 2.0 * (lost[place] - lost[self.beam.searchsorted(beam)])
        return replace(found, amplitude=found.amplitude * np.exp(exponent))


class Falling:
    """What falls, as one sensor sees it."""

    def __init__(self, model: SensorModel) -> None:
        self._model = model

        @lru_cache(maxsize=32)
        def light(
            particles: Particles, extinction_per_m: float, gain: float, soft: SoftProfile | None = None
        ) -> ParticleLight:
            beam = np.array(np.inf)

            def drawn(share: float) -> ParticleLight:
                return light_of(particles, model, extinction_per_m, gain, share, hidden)

            hidden = Hidden.under(soft, model.threshold, model.near_gate_m) if hides(model) else None
            alone = float(drawn(1.0).mean(beam))
            for share, wrong in reversed(DRAWN.items()):
                if model.leave_out.particles and share <= MOST_LEFT and wrong * alone <= WRONG:
                    return drawn(share)
            for share in DRAWN:
                made = drawn(share)
                if float(made.mean(beam)) <= MOST_DRAWN:
                    break
            return made

        self.light = light

        @lru_cache(maxsize=32)
        def undrawn(particles: tuple[Particles, ...], extinction_per_m: float, gain: float, soft: SoftProfile) -> float:
            return sum(light(one, extinction_per_m, gain, soft).backscatter_hidden for one in particles)

        self.undrawn = undrawn
        "Mean backscatter of those that a medium hides; 0 where it hides none. [1/(m sr)]"

        @lru_cache(maxsize=32)
        def world(particles: Particles, seed: int) -> WorldParticles:
            return WorldParticles(seed, particles.term, particles.sizes, particles.fall_m_s, particles.wind_m_s)

        self._world = world

    def mean_drawn(
        self, particles: Particles, far_m: Floats, extinction_per_m: float, gain: float = 1.0,
        soft: SoftProfile | None = None,
    ) -> Floats:  # fmt: skip
        """(n,) mean numbers of those drawn, up to each beam's first surface, `far_m` (n,)."""
        return self.light(particles, extinction_per_m, gain, soft).mean(far_m)

    def mean_field(
        self, particles: Particles, extinction_per_m: float, gain: float = 1.0, soft: SoftProfile | None = None
    ) -> tuple[float, float]:
        """Share of the level from which particles are drawn, and the largest that the mean light of the others has."""
        light = self.light(particles, extinction_per_m, gain, soft)
        r = np.geomspace(max(light.optics.overlap_start_m, 1e-3), max(light.end_m, 1.0), 256)
        return light.share, float(np.max(light.rest(r) / light.optics.level(r)))

    def hidden(
        self, particles: Particles, extinction_per_m: float, gain: float, soft: SoftProfile | None
    ) -> tuple[float, float, float]:
        """Mean number in a beam of those that are not drawn because a medium hides them; how far the medium does; and
        rms of their light over the medium's return there, at the most."""
        light = self.light(particles, extinction_per_m, gain, soft)
        if light.optics.hidden is None:
            return 0.0, 0.0, 0.0
        open_ = light_of(particles, self._model, extinction_per_m, gain, light.share)
        return float(open_.mean(np.array(np.inf)) - light.mean(np.array(np.inf))), *light.flicker_hidden

    def shadow_left_out(self, particles: Particles, far_m: Floats, extinction_per_m: float, gain: float = 1.0) -> float:
        """Spread, over its mean, of the light of the farthest surface (both ways) by particles that are not drawn."""
        behind = far_m[np.isfinite(far_m)]
        if not len(behind):
            return 0.0
        return 2.0 * self.light(particles, extinction_per_m, gain).shadow_left_out(float(behind.max()))

    def seen(
        self, particles: Particles, rays: Rays, t_s: Floats, rotation: Floats, far_m: Floats, extinction_per_m: float,
        sweep: int, draws: RandomStreams, gain: float = 1.0, soft: SoftProfile | None = None,
    ) -> Drawn | None:  # fmt: skip
        """The particles that may be seen, alone or together, up to each beam's first surface, `far_m` (n,)."""
        light = self.light(particles, extinction_per_m, gain, soft)
        mean = light.mean(far_m)
        if not bool(mean.any()) or (float(mean.sum()) < RARE and self._model.leave_out.particles):
            return None
        far = np.minimum(far_m, self._model.gate_m)
        lines = Lines(rays.centre_m, rays.axis, self._across(rays, rotation), t_s, far, rays.own_axis)
        found = self._world(particles, draws.seed).in_beams(light, lines)
        if found is None:
            found = self._each_alone(particles, light, far_m, mean, sweep, draws)
        beam, range_m, size_mm = found
        return Drawn.of(light, beam, range_m, size_mm)

    def _across(self, rays: Rays, rotation: Floats) -> Floats | None:
        """(n, 3) directions of the beams' x radius in the world; None: the beam is round."""
        beam = self._model.beam
        if beam.half_angle_x_rad == beam.half_angle_y_rad:
            return None
        x, y, z = rays.own_axis.T
        level = np.maximum(np.hypot(x, y), 1e-12)
        aside, ahead = -y / level, x / level
        level_x, level_y = math.cos(beam.roll_rad) * aside, math.cos(beam.roll_rad) * ahead
        up_x, up_y, up_z = (math.sin(beam.roll_rad) * up for up in (-z * ahead, z * aside, x * ahead - y * aside))
        own_x, own_y = level_x + up_x, level_y + up_y
        rows = [row[:, 0] * own_x + row[:, 1] * own_y + row[:, 2] * up_z for row in rotation.swapaxes(0, 1)]
        return np.stack(rows, axis=1)

    def _each_alone(
        self, particles: Particles, light: ParticleLight, far_m: Floats, mean: Floats, sweep: int, draws: RandomStreams
    ) -> tuple[Ints, Floats, Floats]:
        """The same law with particles of its own for each beam, where the world has too many."""
        count = draws.poisson(particles.term, sweep, mean)
        uniform = _numbers(draws, particles.term, sweep, count)
        beam = np.arange(len(count)).repeat(count)
        range_m = light.ranges(far_m[beam], uniform[:, 0])
        return beam, range_m, light.drawn_sizes(range_m, uniform[:, 1])


def hides(model: SensorModel) -> bool:
    """A medium's return may hide particles from this sensor's receiver: it looks for maxima and rises of the light."""
    return model.leave_out.particles and model.leave_out.soft_table and model.photons is None and model.response is None


def _numbers(draws: RandomStreams, term: str, sweep: int, count: Ints) -> Floats:
    """Two uniform numbers for each particle; those of a beam do not depend on how many the others have."""
    most = int(count.max(initial=0))
    table = np.stack([draws.uniform(f"{term} {k}", sweep, len(count), 2) for k in range(most)] or [np.zeros((0, 2))])
    taken = np.arange(most)[None, :] < count[:, None]
    return np.asarray(np.moveaxis(table, 0, 1)[taken]) if most else np.zeros((0, 2))
