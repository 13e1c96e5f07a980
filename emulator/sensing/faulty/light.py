"""What faults of light do to a sweep: what reaches the receiver, and the receiver itself.

Ranges, lost beams and false alarms follow from the same physics as in a healthy sensor. Not: keys and kinds (photon),
what the receiver's numbers become behind it (readings).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from emulator.physics import background, noise, radiometry
from emulator.physics.arrays import Floats
from emulator.physics.beams import axis_directions
from emulator.physics.geometry import angle_between
from emulator.physics.random_streams import RandomStreams
from emulator.physics.subechoes import SubEchoes
from emulator.sensing.faulty.held import Held
from emulator.sensing.model import SensorModel
from protocols.scan import ScanPlan


@dataclass(eq=False)
class Light:
    """What faults make of a sweep's light and of its receiver; each adds its part."""

    plan: ScanPlan
    model: SensorModel
    draws: RandomStreams
    passed: Floats = field(init=False)
    "(n,) factor on our own light, there and back."
    dimmed: Floats = field(init=False)
    "(n,) factor on light from outside, one way."
    glare_w: Floats = field(init=False)
    "(n,) light of other sources on the detector, before the window. [W]"
    extra: list[SubEchoes] = field(default_factory=list)
    "Echoes that are not of the scene; amplitudes in rms noise of the dark healthy receiver, all losses in."
    crosstalk: list[tuple[float, int]] = field(default_factory=list)
    "Share of the light that falls on the receiver of beams so far off."
    gain: float = 1.0
    "Factor on the detector's gain; the threshold stays."
    noise: float = 1.0
    "Factor on the rms noise of the dark receiver; the threshold stays."

    def __post_init__(self) -> None:
        n = len(self.plan)
        self.passed, self.dimmed, self.glare_w = np.ones(n), np.ones(n), np.zeros(n)

    def echoes(self, found: SubEchoes) -> SubEchoes:
        """What reaches the receiver of a sweep that would have brought back `found`."""
        echoes = replace(found, amplitude=found.amplitude * self.passed[found.beam])
        parts = [echoes, *self.extra]
        n = len(self.plan)
        for share, reach in self.crosstalk:
            for step in (*range(-reach, 0), *range(1, reach + 1)):
                beam = echoes.beam + step
                kept = (beam >= 0) & (beam < n)
                faded = echoes.amplitude[kept] * share ** abs(step)
                spread_m = None if echoes.spread_m is None else echoes.spread_m[kept]
                of = SubEchoes.of(beam[kept], echoes.range_m[kept], faded, None, echoes.source[kept], spread_m)
                parts.append(of)
        parts = [part for part in parts if len(part)]
        return SubEchoes.joined(*parts) if len(parts) > 1 else parts[0] if parts else echoes

    def receiver(self) -> SensorModel:
        """The sensor with this receiver; amplitude 1 is its own noise in the dark. The threshold stays where it was."""
        model = self.model
        if self.gain == 1.0 and self.noise == 1.0:
            return model
        healthy = model.receiver
        amplified = replace(healthy, gain=healthy.gain * self.gain)
        baseline_a = self.noise * amplified.noise_a(0.0)
        added_a = math.sqrt(max(baseline_a**2 - amplified.noise_a(0.0) ** 2, 0.0))
        worn = replace(amplified, baseline_a=baseline_a, adc_noise_a=math.hypot(healthy.adc_noise_a, added_a))
        ratio = baseline_a / healthy.baseline_a
        shot = noise.signal_shot_factor(worn.gain, worn.ionisation_ratio, worn.bandwidth_hz, worn.baseline_a)
        return replace(
            model,
            receiver=worn,
            threshold=model.threshold / ratio,
            floor_m2=model.floor_m2 / ratio,
            full_scale=max(model.full_scale / ratio, 1.001 * model.threshold / ratio),
            signal_shot=float(shot),
        )

    def scale(self, worn: SensorModel) -> float:
        """Factor from amplitudes of the healthy receiver to those of the worn one."""
        return self.gain * self.model.receiver.baseline_a / worn.receiver.baseline_a


def _dirty_window(one: Held, light: Light) -> None:
    keys, model = one.keys, light.model
    depth = keys.depth(light.plan.azimuth_rad, keys.edge_deg)
    once = 1.0 - (1.0 - keys.transmission) * depth
    overlap = float(radiometry.overlap(keys.window_m, model.overlap_start_m, model.overlap_full_m))
    near = model.k_m2 * light.plan.gain / (keys.window_m**2 + model.aperture_radius_m**2)
    amplitude = near * max(overlap, keys.stray) * keys.reflectance * (1.0 - once) * light.passed
    seen = np.flatnonzero(amplitude > 0.0)
    if len(seen):
        light.extra.append(SubEchoes.of(seen, np.full(len(seen), keys.window_m), amplitude[seen]))
    light.passed *= once**2
    light.dimmed *= once


def _wet_window(one: Held, light: Light) -> None:
    keys = one.keys
    # a place on the window is under no drop with chance 1 - coverage: Poisson drops around the whole turn
    count = round(-math.log(max(1.0 - keys.coverage, 1e-6)) * 360.0 / keys.drop_deg)
    state = int(one.since_s / keys.renews_s)
    middle = one.uniform(light.draws, "drops", state, max(count, 1))[:count, 0] * 360.0 - 180.0
    azimuth = np.degrees(light.plan.azimuth_rad)
    under = np.zeros(len(azimuth), bool)
    if count:
        order = np.sort(middle)
        around = np.concatenate([order[-1:] - 360.0, order, order[:1] + 360.0])
        at = np.clip(np.searchsorted(around, azimuth), 1, len(around) - 1)
        off = np.minimum(np.abs(azimuth - around[at]), np.abs(azimuth - around[at - 1]))
        under = off <= 0.5 * keys.drop_deg
    once = keys.film_transmission * np.where(under, keys.drop_transmission, 1.0)
    light.passed *= once**2
    light.dimmed *= once


def _dead_laser(one: Held, light: Light) -> None:
    light.passed[:] = 0.0


def _weak_laser(one: Held, light: Light) -> None:
    left = 1.0 if one.keys.halves_in_s is None else 0.5 ** (one.since_s / one.keys.halves_in_s)
    light.passed *= one.keys.power * left


def _blinding(one: Held, light: Light) -> None:
    keys, model, plan = one.keys, light.model, light.plan
    source = axis_directions(np.radians([keys.azimuth_deg]), np.radians([keys.elevation_deg]))[0]
    angle = angle_between(axis_directions(plan.azimuth_rad, plan.elevation_rad), source)
    light.glare_w += background.background_sun(
        keys.irradiance_w_m2,
        1.0,  # the irradiance is that within the filter
        model.aperture_radius_m,
        0.5 * model.receiver.field_of_view_rad,
        model.efficiency,
        angle,
        math.radians(0.5 * keys.width_deg),
    )


def _interference(one: Held, light: Light) -> None:
    keys, model, plan = one.keys, light.model, light.plan
    n = len(plan)
    mean = np.where(keys.holds(plan.azimuth_rad), keys.echoes_per_beam, 0.0)
    count = light.draws.poisson(one.term("count"), plan.sweep, mean)
    beam = np.repeat(np.arange(n), count)
    if not len(beam):
        return
    place = np.arange(len(beam)) - np.repeat(np.cumsum(count) - count, count)
    most = int(count.max())
    where = one.uniform(light.draws, "ranges", plan.sweep, most, n)[place, beam]
    height = one.uniform(light.draws, "heights", plan.sweep, most, n)[place, beam]
    range_m = model.near_gate_m + where * (model.gate_m - model.near_gate_m)
    amplitude = -np.log(height) * keys.strength * model.threshold * light.dimmed[beam]
    light.extra.append(SubEchoes.of(beam, range_m, amplitude))


def _crosstalk(one: Held, light: Light) -> None:
    light.crosstalk.append((one.keys.share, one.keys.reach))


def seen_share(beam_half_rad: float, field_half_rad: float, off_rad: float) -> float:
    """Share of a Gaussian beam inside a field of view off its axis, over that of one on its axis."""
    centred = float(radiometry.fill_disc_offset(field_half_rad, beam_half_rad, 0.0))
    return float(radiometry.fill_disc_offset(field_half_rad, beam_half_rad, off_rad)) / centred if centred else 0.0


def _misalignment(one: Held, light: Light) -> None:
    beam = light.model.beam
    half = math.sqrt(beam.half_angle_x_rad * beam.half_angle_y_rad)
    light.passed *= seen_share(half, 0.5 * light.model.receiver.field_of_view_rad, 1e-3 * one.keys.angle_mrad)


def _detector_gain(one: Held, light: Light) -> None:
    light.gain *= max(one.keys.factor * (1.0 + one.keys.per_s * one.since_s), 0.01)


def _receiver_noise(one: Held, light: Light) -> None:
    light.noise *= one.keys.factor


LIGHT: Mapping[str, Callable[[Held, Light], None]] = {
    "dirty_window": _dirty_window,
    "wet_window": _wet_window,
    "dead_laser": _dead_laser,
    "weak_laser": _weak_laser,
    "blinding": _blinding,
    "interference": _interference,
    "crosstalk": _crosstalk,
    "misalignment": _misalignment,
    "detector_gain": _detector_gain,
    "receiver_noise": _receiver_noise,
}
"Name -> what it adds to a sweep's light."
