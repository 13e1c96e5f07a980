"""The receiver of one sensor: sub-echoes and media in, the scan that the device reports out.

Belongs here: the sensor's detector and its random numbers, false alarms, the scan. Not: how echoes are found
(physics.detection), background light (daylight).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from emulator.physics import noise
from emulator.physics.arrays import Bools, Floats
from emulator.physics.constants import SPEED_OF_LIGHT_M_S
from emulator.physics.detection import Signals, detect, signals_of
from emulator.physics.detector import Detector, Echoes
from emulator.physics.random_streams import Normals, RandomStreams
from emulator.physics.shaped import Shaped
from emulator.physics.softprofile import SoftProfile
from emulator.physics.subechoes import Kept, SubEchoes
from emulator.sensing.blooming import bloomed
from emulator.sensing.daylight import NIGHT, Daylight
from emulator.sensing.faint import looked_at
from emulator.sensing.model import SensorModel
from emulator.sensing.receiving import NoiseEchoes, Readings, readings
from protocols.scan import DAZZLED, SATURATED, Scan, ScanPlan

NUMBERS_A_BEAM = 4
"Random numbers a beam for the noise at its echoes; the fifth echo shares that of the first."
RARE = 1e-6
"Mean count of noise echoes a sweep below which none is drawn."


@dataclass(frozen=True, eq=False)
class _Known:
    """Sub-echoes of an earlier sweep and what became of them before any noise: a sensor at rest may see them again."""

    given: SubEchoes
    soft: SoftProfile | None
    noise: Floats | None
    signals: Signals

    def serves(self, given: SubEchoes, soft: SoftProfile | None, noise: Floats | None, wanted: Bools) -> bool:
        """The same sub-echoes come again, in the beams that are wanted in the same light."""
        if self.given is not given or self.soft is not soft or len(self.signals.rms) != len(wanted):
            return False
        if self.noise is None or noise is None:
            return self.noise is noise
        return self.noise is noise or bool(np.array_equal(self.noise[wanted], noise[wanted]))


@dataclass(frozen=True, eq=False)
class _Given:
    """What the beams of a sweep are received with, or some of them."""

    detector: Detector
    soft: SoftProfile | None
    noise: Floats | None
    "(n,) over that of the dark receiver; None: 1 everywhere."
    dazzled: Bools | None
    normals: Normals | None
    timing: Normals | None
    spreads: Normals | None
    "Of ranges."
    noise_echoes: NoiseEchoes | None


@lru_cache(maxsize=16)
def _with_echoes(detector: Detector, most: int) -> Detector:
    return replace(detector, max_echoes=most)


class Receiver:
    """Turns what the light brings back into scans."""

    def __init__(self, model: SensorModel, draws: RandomStreams) -> None:
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
            sampled=not model.leave_out.waveform,
            follows_noise=True,
            floor_m2=model.floor_m2,
            bandwidth_hz=model.receiver.bandwidth_hz,
            near_gate_m=model.near_gate_m,
            far_gate_m=model.gate_m,
        )
        self._known: _Known | None = None
        gate_m = max(model.gate_m - model.near_gate_m, 0.0)
        self._false_alarms = float(noise.false_alarm_rice(model.threshold, model.receiver.bandwidth_hz, gate_m))
        self._shaped: Shaped | None = None
        if model.response is not None:
            bin_s = 2.0 * model.bin_m / SPEED_OF_LIGHT_M_S
            gate_s = 2.0 * gate_m / SPEED_OF_LIGHT_M_S
            self._false_alarms = float(model.response.crossings_hz(model.threshold, bin_s)) * gate_s
            self._shaped = Shaped(self._detector, model.response, draws.word("waveform noise"))

    @property
    def bin_m(self) -> float:
        """Step of its waveforms, on which media are tabulated."""
        return self._detector.bin_m

    @property
    def detector(self) -> Detector:
        """How it makes echoes of sub-echoes."""
        return self._detector

    @property
    def keeps_beams_apart(self) -> bool:
        """What a beam reports depends on nothing that others see, nor on how many there are."""
        return self._model.bloom_share == 0.0 and self._shaped is None

    def noise_echoes_of(self, beams: int) -> float:
        """Mean count of noise echoes of a sweep of so many beams."""
        return self._false_alarms * beams

    def receive(
        self,
        plan: ScanPlan,
        found: SubEchoes,
        soft: SoftProfile | None = None,
        daylight: Daylight = NIGHT,
        kept: Kept | None = None,
    ) -> Scan:
        """The scan of a sweep; `kept`: sub-echoes of beams of which none are in `found`."""
        if self._model.bloom_share > 0.0:
            found, kept = bloomed(found if kept is None else kept.whole(found), plan, self._model), None
        given = self._given(plan, daylight, soft)
        ambient_w = daylight.power_w if plan.wants_ambient else None
        made = self._readings(plan, given, found, kept)
        return Scan(plan, made.range_m, made.intensity, made.flags, made.actor, ambient_w=ambient_w)

    def _given(self, plan: ScanPlan, daylight: Daylight, soft: SoftProfile | None) -> _Given:
        model, detector, n = self._model, self._detector, len(plan)
        if plan.max_echoes < detector.max_echoes:
            detector = _with_echoes(detector, plan.max_echoes)
        normals = timing = spreads = None
        if model.noise and self._shaped is None:
            normals = self._draws.normals("receiver", plan.sweep, n, NUMBERS_A_BEAM)
            if model.method != "leading_edge":
                timing = self._draws.normals("timing", plan.sweep, n, NUMBERS_A_BEAM)
        if model.noise and model.range_noise_m > 0.0:
            spreads = self._draws.normals("range", plan.sweep, n, detector.max_echoes)
        noise_echoes = self._noise_echoes(plan, daylight.noise) if model.false_alarms else None
        return _Given(detector, soft, daylight.noise, daylight.dazzled, normals, timing, spreads, noise_echoes)

    def _readings(self, plan: ScanPlan, given: _Given, found: SubEchoes, kept: Kept | None) -> Readings:
        """Of all beams: where no earlier sweep is known, in one pass."""
        model, n = self._model, len(plan)
        if self._shaped is not None:
            looked = looked_at(found if kept is None else kept.whole(found), given.soft, model)
            echoes = self._shaped.detect(
                looked, n, given.detector, sweep=plan.sweep, noisy=model.noise, noise=given.noise, soft=given.soft,
                dazzled=given.dazzled, noise_echoes=given.noise_echoes,
            )  # fmt: skip
            return self._read_off(plan, given, echoes)
        if kept is None or bool(kept.changed.any()):
            made = self._read_at_once(n, given, found, None if kept is None else ~kept.changed)
            if made is not None and kept is None:
                return made
            if made is not None and kept is not None:
                # what is known of all beams is as quick as of those that rest
                known = self._again(kept.found, ~kept.changed, given.soft, given.noise)
                resting = self._read_off(plan, given, self._detected(given, kept.found, n, (known,)))
                return resting.replaced(kept.changed, made)
        signals = self._signals(found, kept, n, given.soft, given.noise)
        return self._read_off(plan, given, self._detected(given, found, n, signals))

    def _read_at_once(self, beams: int, given: _Given, found: SubEchoes, without: Bools | None) -> Readings | None:
        """Of all beams but some, by compiled loops; None: with numpy arrays, step by step."""
        model = self._model
        if found.spread_m is not None or model.triangulation is not None:
            return None
        return readings(
            lambda: looked_at(found, given.soft, model), beams, given.detector, given.soft, given.noise, given.dazzled,
            given.normals, given.spreads, given.noise_echoes, model.systematic_m, model.range_noise_m, without,
        )  # fmt: skip

    def _detected(self, given: _Given, found: SubEchoes, beams: int, signals: tuple[Signals, ...]) -> Echoes:
        return detect(
            found, beams, given.detector, normals=given.normals, timing=given.timing, soft=given.soft,
            dazzled=given.dazzled, noise_echoes=given.noise_echoes, signals=signals,
        )  # fmt: skip

    def _signals(
        self, found: SubEchoes, kept: Kept | None, beams: int, soft: SoftProfile | None, noise: Floats | None
    ) -> tuple[Signals, ...]:
        """The signals of a sweep; of sub-echoes that come again those that are known."""
        if kept is None:
            return (self._again(found, np.ones(beams, bool), soft, noise),)
        resting = self._again(kept.found, ~kept.changed, soft, noise)
        if not bool(kept.changed.any()):
            return (resting,)
        return resting.of_beams(~kept.changed), self._made(found, beams, soft, noise).of_beams(kept.changed)

    def _again(self, given: SubEchoes, wanted: Bools, soft: SoftProfile | None, noise: Floats | None) -> Signals:
        known = self._known
        if known is not None and known.serves(given, soft, noise, wanted):
            return known.signals
        signals = self._made(given, len(wanted), soft, noise)
        if self._model.leave_out.resting:
            self._known = _Known(given, soft, noise, signals)
        return signals

    def _made(self, found: SubEchoes, beams: int, soft: SoftProfile | None, noise: Floats | None) -> Signals:
        found, rms = looked_at(found, soft, self._model), 1.0 if noise is None else noise
        return signals_of(found, beams, self._detector, noisy=self._model.noise, noise=rms, soft=soft)

    def _noise_echoes(self, plan: ScanPlan, rms: Floats | None) -> NoiseEchoes | None:
        """Crossings of the threshold by noise alone: anywhere in the gate."""
        n, model = len(plan), self._model
        if self.noise_echoes_of(n) < RARE and model.leave_out.noise_echoes:
            return None
        count = self._draws.poisson("false alarms", plan.sweep, np.full(n, self._false_alarms))
        if not bool(count.any()):
            return None
        beam = np.arange(n).repeat(count)
        most = int(count.max())
        place = np.arange(len(beam)) - (count.cumsum() - count).repeat(count)
        where = self._draws.uniform("false alarm ranges", plan.sweep, most, n)[place, beam]
        height = self._draws.uniform("false alarm heights", plan.sweep, most, n)[place, beam]
        range_m = model.near_gate_m + where * (model.gate_m - model.near_gate_m)
        amplitude = noise.noise_echo_amplitude(model.threshold, height)
        if rms is not None:
            amplitude = amplitude * rms[beam]
        if model.floor_m2 > 0.0:
            kept = amplitude * range_m**2 >= model.floor_m2
            beam, range_m, amplitude = beam[kept], range_m[kept], amplitude[kept]
        return beam, range_m, amplitude

    def _read_off(self, plan: ScanPlan, given: _Given, echoes: Echoes) -> Readings:
        """What the device makes of echoes; of a sensor that triangulates those of all beams."""
        model, (n, columns) = self._model, echoes.range_m.shape
        range_m, amplitude = echoes.range_m, echoes.amplitude
        rms = 1.0 if given.noise is None else given.noise[:, None]
        if model.triangulation is not None and not model.seed_mode:
            spots = self._draws.normal("spot", plan.sweep, n, columns) if model.noise else 0.0
            range_m = model.triangulation.measured(range_m, amplitude / rms, spots)
            amplitude = np.where(np.isnan(range_m), np.nan, amplitude)
        if model.systematic_m:
            range_m = range_m + model.systematic_m
        if given.spreads is not None:
            seen = np.isfinite(range_m)
            range_m = range_m.copy()
            range_m[seen] = np.maximum(range_m[seen] + model.range_noise_m * given.spreads[seen], 0.0)
        flags: NDArray[np.uint8] = np.zeros(n, np.uint8)
        if bool(echoes.saturated.any()):
            flags[echoes.saturated.any(axis=1)] |= SATURATED
        if given.dazzled is not None:
            flags[given.dazzled] |= DAZZLED
        intensity = np.maximum(amplitude / (model.threshold * rms), 1.0)
        return Readings(range_m, intensity, echoes.source.astype(np.int32), flags)
