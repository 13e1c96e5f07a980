"""The receiver of one sensor: sub-echoes and media in, the scan that the device reports out.

Belongs here: the sensor's detector and its random numbers, false alarms, the scan. Not: how echoes are found
(physics.detection), background light (daylight).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from emulator.draws import Draws
from emulator.physics import noise
from emulator.physics.arrays import Floats, Ints
from emulator.physics.constants import SPEED_OF_LIGHT_M_S
from emulator.physics.detection import detect
from emulator.physics.detector import Detector, Echoes
from emulator.physics.softprofile import SoftProfile
from emulator.physics.subechoes import SubEchoes
from emulator.sensing.daylight import NIGHT, Daylight
from emulator.sensing.model import SensorModel
from protocols.scan import DAZZLED, SATURATED, Scan, ScanPlan

NUMBERS_A_BEAM = 4
"Random numbers a beam for the noise at its echoes; the fifth echo shares that of the first."
RARE = 1e-6
"Mean count of noise echoes a sweep below which none is drawn."


class Receiver:
    """Turns what the light brings back into scans."""

    def __init__(self, model: SensorModel, draws: Draws) -> None:
        self.draws = draws
        self._model, self._draws = model, draws
        self._detector = Detector(
            pulse=model.pulse,
            threshold=model.threshold,
            method=model.method,
            walk_table=model.walk_table,
            keep=model.echoes,
            max_echoes=model.max_echoes,
            resolution_m=model.lsb_m,
            bin_s=2.0 * model.bin_m / SPEED_OF_LIGHT_M_S,
            full_scale=model.full_scale,
            recovery_s=2.0 * model.recovery_m / SPEED_OF_LIGHT_M_S,
            shot_factor=0.0 if model.seed_mode else model.signal_shot,
            floor_m2=model.floor_m2,
            near_gate_m=model.near_gate_m,
            far_gate_m=model.gate_m,
        )
        gate_m = max(model.gate_m - model.near_gate_m, 0.0)
        self._false_alarms = float(noise.false_alarm_rice(model.threshold, model.receiver.bandwidth_hz, gate_m))

    @property
    def bin_m(self) -> float:
        """Step of its waveforms, on which media are tabulated."""
        return self._detector.bin_m

    def receive(
        self, plan: ScanPlan, found: SubEchoes, soft: SoftProfile | None = None, daylight: Daylight = NIGHT
    ) -> Scan:
        """The scan of a sweep."""
        model, n = self._model, len(plan)
        detector = self._detector
        if plan.max_echoes < detector.max_echoes:
            detector = replace(detector, max_echoes=plan.max_echoes)
        if daylight.noise is not None:
            # the threshold follows the noise: amplitudes over each beam's own
            found = replace(found, amplitude=found.amplitude / daylight.noise[found.beam])
        normals = self._draws.normal("receiver", plan.sweep, n, NUMBERS_A_BEAM) if model.noise else None
        echoes = detect(
            found,
            n,
            detector,
            normals=normals,
            soft=soft,
            dazzled=daylight.dazzled,
            noise_echoes=self._noise_echoes(plan) if model.false_alarms else None,
        )
        return self._scan(plan, echoes, daylight)

    def _noise_echoes(self, plan: ScanPlan) -> tuple[Ints, Floats, Floats] | None:
        """Crossings of the threshold by noise alone: anywhere in the gate."""
        n, model = len(plan), self._model
        if self._false_alarms * n < RARE and not model.full:
            return None
        count = self._draws.poisson("false alarms", plan.sweep, np.full(n, self._false_alarms))
        if not bool(np.any(count)):
            return None
        beam = np.repeat(np.arange(n), count)
        most = int(count.max())
        place = np.arange(len(beam)) - np.repeat(np.cumsum(count) - count, count)
        where = self._draws.uniform("false alarm ranges", plan.sweep, most, n)[place, beam]
        height = self._draws.uniform("false alarm heights", plan.sweep, most, n)[place, beam]
        range_m = model.near_gate_m + where * (model.gate_m - model.near_gate_m)
        amplitude = noise.noise_echo_amplitude(model.threshold, height)
        if model.floor_m2 > 0.0:
            kept = amplitude * range_m**2 >= model.floor_m2
            beam, range_m, amplitude = beam[kept], range_m[kept], amplitude[kept]
        return beam, range_m, amplitude

    def _scan(self, plan: ScanPlan, echoes: Echoes, daylight: Daylight) -> Scan:
        model, n = self._model, len(plan)
        range_m = echoes.range_m
        if model.systematic_m:
            range_m = range_m + model.systematic_m
        if model.noise and model.range_noise_m > 0.0:
            spread = self._draws.normal("range", plan.sweep, n, range_m.shape[1])
            range_m = np.maximum(range_m + model.range_noise_m * spread, 0.0)
        flags: NDArray[np.uint8] = np.zeros(n, np.uint8)
        if bool(np.any(echoes.saturated)):
            flags[np.any(echoes.saturated, axis=1)] |= SATURATED
        if daylight.dazzled is not None:
            flags[daylight.dazzled] |= DAZZLED
        intensity = np.maximum(echoes.amplitude / model.threshold, 1.0)
        return Scan(plan, range_m, intensity, flags, echoes.source.astype(np.int32))
