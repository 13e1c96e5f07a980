"""What sensing must know of one sensor, in SI units: the spec, the choices of the scenario, and what follows of them.

Belongs here: merging spec and options, system constant, baseline noise, threshold. Not: anything of a scene or a scan.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np

from emulator.physics import background, noise, radiometry
from emulator.physics.arrays import Floats
from emulator.physics.beams import BeamShape
from emulator.physics.constants import SPEED_OF_LIGHT_M_S
from emulator.physics.pulse import Pulse
from emulator.physics.response import Response
from emulator.physics.triangulation import Triangulation
from emulator.sensors.physics_options import (
    ELECTRONICS,
    BundlePruning,
    BundleRule,
    DetectionMethod,
    EchoChoice,
    LeaveOut,
    PhotonOptions,
    PhysicsOptions,
    Profile,
    WindscreenOptions,
)
from emulator.sensors.spec import (
    DetectionSpec,
    Fact,
    OpticsSpec,
    PulseSpec,
    ReceiverSpec,
    SensorSpec,
    TriangulationSpec,
)

Value = TypeVar("Value")

RECEIVER_TEMPERATURE_K = 293.15
FINEST_BIN_SHARE = 16
"Bins of a sampled pulse's FWHM at the least: a parabola then finds its peak to 1e-4 of it."
COAXIAL = 2.0 / 3.0
"Of the lens's radius: mean distance of its points from an emitter in its middle."
MOST_BINS = 256
"Bins of it by default at the most: a parabola finds the peak to 1e-8 of it, 15 um of a pulse of 10 us."
FINEST_CHOSEN = 65536
"Bins of it that may be asked for: more would only fill the memory."
MOST_TABLED = 3_000_000
"Bins of a gate over which the return of the air is tabulated: so many take ten seconds."


@dataclass(frozen=True)
class Receiver:
    """Detector and amplifier, for the noise of background light."""

    responsivity_a_w: float
    gain: float
    ionisation_ratio: float
    dark_bulk_a: float
    dark_surface_a: float
    amplifier_a_rthz: float
    load_ohm: float
    bandwidth_hz: float
    adc_noise_a: float
    field_of_view_rad: float
    "Full angle."
    filter_nm: float
    saturation_a: float
    baseline_a: float
    "Rms noise without signal and background."

    def noise_a(self, background_w: float) -> float:
        """Rms noise current with this background on the detector. [A]"""
        return float(
            noise.noise_current(
                0.0,
                background_w,
                self.responsivity_a_w,
                self.gain,
                self.ionisation_ratio,
                self.dark_bulk_a,
                self.dark_surface_a,
                self.amplifier_a_rthz,
                self.load_ohm,
                RECEIVER_TEMPERATURE_K,
                self.bandwidth_hz,
                self.adc_noise_a,
            )
        )


@dataclass(frozen=True)
class SensorModel:
    """One sensor of a run. Amplitudes are in rms noise of the dark receiver."""

    seed_mode: bool
    wavelength_m: float
    beam: BeamShape
    sidelobe_share: float
    "Of the emitted light; 0: none."
    sidelobe_rad: float
    "Full angle."
    bloom_share: float
    "Of a saturating echo, on the detector of a neighbour; 0: none."
    bloom_rad: float
    rule: BundleRule
    sub_beams: int
    probes: int
    "Rays around the axis of each beam that are cast before its bundle; 0: none."
    depth: int
    pulse: Pulse
    k_m2: float
    "Amplitude of an ideal white plate at 1 m."
    peak_w: float
    aperture_radius_m: float
    baseline_m: float
    "Between emitter and receiver."
    efficiency: float
    receiver: Receiver
    signal_shot: float
    "s in noise^2 = 1 + s amplitude: shot noise of the echo itself."
    overlap_start_m: float
    overlap_full_m: float
    near_gate_m: float
    gate_m: float
    threshold: float
    floor_m2: float
    "Near by the threshold is floor_m2 / (R^2 + a^2), where that is more; 0: one threshold at all ranges."
    method: DetectionMethod
    walk_table: bool
    echoes: EchoChoice
    max_echoes: int
    bin_m: float
    "Step of a sampled waveform in apparent range."
    lsb_m: float
    range_noise_m: float
    systematic_m: float
    triangulation: Triangulation | None
    "None: time of flight."
    full_scale: float
    recovery_m: float
    noise: bool
    false_alarms: bool
    background: bool
    weather_echoes: bool
    bounces: int
    windscreen: WindscreenOptions | None
    photons: PhotonOptions | None
    response: Response | None
    "The receiver's electronics; None: an ideal receiver."
    leave_out: LeaveOut
    "Which rules may leave out what cannot be seen."
    plain_radii: float
    "Beam radii around the axis of a plain beam within which nothing but its plane may be."

    @property
    def prune_bundles(self) -> BundlePruning:
        """Beams that see one plane are cast as one ray."""
        return self.leave_out.closed_form

    @property
    def prune_far(self) -> bool:
        """What lies out of reach is not cast on."""
        return self.leave_out.far_objects

    def least_amplitude(self, range_m: Floats) -> Floats:
        """Of an echo that is reported from there: a noise rms above the threshold, and not below the floor."""
        return np.maximum(self.threshold + 1.0, self.floor_m2 / np.maximum(range_m, 1e-3) ** 2)

    def unseen_under(self, amplitude: Floats) -> Floats:
        """What may be missing under echoes of this amplitude without shifting their crossing by half a step.

        To first order, where three noise rms have lowered the threshold to a fifth; half of it, as the foot of an echo
        of many ranges is flatter than that of one. A Gaussian pulse rises by its logarithm there; other methods than
        the leading edge weigh all of the pulse, and what lies a pulse from it.
        """
        level = 0.2 * self.threshold
        if self.method != "leading_edge":
            return 0.05 * self.lsb_m / self.pulse.fwhm_m * amplitude
        if self.pulse.shape == "gauss":
            return 0.25 * self.lsb_m / self.pulse.sigma_m * level * np.sqrt(2.0 * np.log(amplitude / level))
        return 0.25 * self.lsb_m * math.pi / self.pulse.fwhm_m * np.sqrt(level * (amplitude - level))

    @property
    def unseen_amplitude(self) -> float:
        """The same under the faintest of them."""
        return float(self.unseen_under(np.array([self.threshold + 1.0]))[0])

    @property
    def clear_depth(self) -> float:
        """Two-way optical depth that shifts no crossing by half a step, and no amplitude by a thousandth.

        The threshold being at most 0.9 of the amplitude.
        """
        x = 0.9
        walk_m = self.pulse.fwhm_m / math.pi * math.sqrt(x / (1.0 - x))
        return min(1e-3, 0.5 * self.lsb_m / walk_m)

    @property
    def divergence_rad(self) -> float:
        """The larger full angle."""
        return 2.0 * max(self.beam.half_angle_x_rad, self.beam.half_angle_y_rad)

    @property
    def nep_w(self) -> float:
        """Optical power of amplitude 1: that whose signal current is the rms noise of the dark receiver."""
        receiver = self.receiver
        return float(noise.noise_equivalent_power(receiver.baseline_a, receiver.responsivity_a_w, receiver.gain))

    @property
    def pulse_energy_j(self) -> float:
        """Energy of the emitted pulse."""
        return self.peak_w / float(self.pulse.peak_power(1.0))


def sensor_model(spec: SensorSpec, options: PhysicsOptions, mode: str) -> SensorModel:
    """Spec and options as one; options win. `mode` is `operational` or `seed`."""
    optics, pulse_spec, receiver = _need(spec.optics), _need(spec.pulse), _need(spec.receiver)
    detection, bundle = _need(spec.detection), _need(spec.bundle)
    seed = mode == "seed"
    pulse = Pulse(1e-9 * _or(options.pulse_fwhm_ns, pulse_spec.fwhm_ns), _or(options.pulse, pulse_spec.shape))
    profile = _or(options.profile, optics.profile)
    detector = _receiver(receiver, options, pulse)
    nep_w = float(noise.noise_equivalent_power(detector.baseline_a, detector.responsivity_a_w, detector.gain))
    aperture_m, efficiency = 0.5e-3 * receiver.aperture_mm.value, receiver.efficiency.value
    k_m2, peak_w = _power(receiver, pulse_spec, options, pulse, aperture_m, efficiency, nep_w)
    passed = _filter_share(optics, receiver, options)
    k_m2, efficiency = k_m2 * passed, efficiency * passed
    gate_m = _or(options.gate_m, receiver.gate_m)
    near_gate_m = _or(options.near_gate_m, receiver.near_gate_m, 0.0)
    if near_gate_m >= gate_m:
        raise ValueError(f"near_gate_m {near_gate_m:g} not before gate_m {gate_m:g}; want it smaller")
    response = None if seed else _response(receiver, options, detector.bandwidth_hz)
    bin_s = _bin_s(options.bin_ns, pulse) if response is None else _fine_bin_s(options.bin_ns, pulse, response)
    threshold = 1.0 if seed else _threshold(options, detection, detector, gate_m, response, bin_s)
    floor = receiver.floor_reflectance.value if receiver.floor_reflectance is not None else 0.0
    if options.floor_reflectance is not None:
        floor = 0.0 if options.floor_reflectance == "off" else options.floor_reflectance
    full_scale = receiver.full_scale_snr.value if receiver.full_scale_snr is not None else math.inf
    if options.full_scale_snr is not None:
        full_scale = math.inf if options.full_scale_snr == "off" else options.full_scale_snr
    sidelobe = _or(options.sidelobe_share, optics.sidelobe_share, 0.0)
    bloom = _or(options.bloom_share, receiver.bloom_share, 0.0)
    if sidelobe > 0.0 and (_or(options.rule, bundle.rule) == "adaptive" or profile != "gauss"):
        raise ValueError("sidelobe_share with rule adaptive or a top-hat; want another rule, profile gauss, or 0")
    if bloom > 0.0 and not math.isfinite(full_scale):
        raise ValueError("bloom_share without full_scale_snr; want both")
    if options.weather_echoes and not seed and options.photons is None:
        _require_short(gate_m, 0.5 * SPEED_OF_LIGHT_M_S * bin_s)
    return SensorModel(
        seed_mode=seed,
        wavelength_m=1e-9 * _or(options.wavelength_nm, optics.wavelength_nm),
        beam=_beam(optics, options, profile),
        sidelobe_share=sidelobe,
        sidelobe_rad=1e-3 * _wide("sidelobe", sidelobe, options.sidelobe_mrad, optics.sidelobe_mrad),
        bloom_share=bloom,
        bloom_rad=1e-3 * _wide("bloom", bloom, options.bloom_mrad, receiver.bloom_mrad),
        rule=_or(options.rule, bundle.rule),
        sub_beams=_or(options.sub_beams, bundle.sub_beams),
        probes=_or(options.probes, bundle.probes, 0),
        depth=options.depth,
        pulse=pulse,
        k_m2=k_m2,
        peak_w=peak_w,
        aperture_radius_m=aperture_m,
        baseline_m=1e-3 * _or(options.baseline_mm, receiver.baseline_mm, 1e3 * COAXIAL * aperture_m),
        efficiency=efficiency,
        receiver=detector,
        signal_shot=float(
            noise.signal_shot_factor(
                detector.gain, detector.ionisation_ratio, detector.bandwidth_hz, detector.baseline_a
            )
        ),
        overlap_start_m=receiver.overlap_start_m.value,
        overlap_full_m=receiver.overlap_full_m.value,
        near_gate_m=near_gate_m,
        gate_m=gate_m,
        threshold=threshold,
        floor_m2=0.0 if seed else floor * k_m2,
        method=_or(options.detection, detection.method),
        walk_table=_or(options.walk_table, detection.walk_table),
        echoes=_or(options.echoes, detection.echoes),
        max_echoes=_or(options.max_echoes, detection.max_echoes),
        bin_m=0.5 * SPEED_OF_LIGHT_M_S * bin_s,
        lsb_m=1e-3 * detection.lsb_mm.value,
        range_noise_m=1e-3 * _or(options.range_noise_mm, detection.range_noise_mm),
        systematic_m=1e-3 * _or(options.systematic_mm, detection.systematic_mm),
        triangulation=_triangulation(spec.triangulation),
        full_scale=full_scale,
        recovery_m=0.5e-9 * SPEED_OF_LIGHT_M_S * _or(options.recovery_ns, receiver.recovery_ns, 0.0),
        noise=options.noise and not seed,
        false_alarms=options.false_alarms and options.noise and not seed,
        background=options.background,
        weather_echoes=options.weather_echoes and not seed,
        bounces=options.bounces,
        windscreen=options.windscreen,
        photons=options.photons,
        response=response,
        leave_out=LeaveOut.nothing() if options.full else options.leave_out,
        plain_radii=options.plain_radii,
    )


def _wide(name: str, share: float, chosen: float | None, fact: Fact[float] | None) -> float:
    """An angle that must be known where there is a share."""
    if share > 0.0 and chosen is None and fact is None:
        raise ValueError(f"{name}_share without {name}_mrad; want both")
    return _or(chosen, fact, 1.0)


def _triangulation(spec: TriangulationSpec | None) -> Triangulation | None:
    if spec is None:
        return None
    return Triangulation(
        baseline_m=1e-3 * spec.baseline_mm.value,
        focal_px=spec.focal_px.value,
        subpixel_px=spec.subpixel_px.value,
        spot_px=_or(None, spec.spot_px, 0.0),
        step_px=_or(None, spec.step_px, 0.0),
        imager_px=_or(None, spec.imager_px, math.inf),
    )


def _need(part: Value | None) -> Value:
    if part is None:
        raise ValueError("this model lists objects; it has no beams")
    return part


def _or(choice: Value | None, fact: Fact[Value] | None, default: Value | None = None) -> Value:
    if choice is not None:
        return choice
    if fact is not None:
        return fact.value
    if default is None:
        raise ValueError("not set, and the model has no value")
    return default


def _bin_s(chosen_ns: float | None, pulse: Pulse) -> float:
    """Step of a sampled waveform in time."""
    if chosen_ns is None:
        return min(max(1e-9, pulse.fwhm_s / MOST_BINS), pulse.fwhm_s / FINEST_BIN_SHARE)
    if 1e-9 * chosen_ns < pulse.fwhm_s / FINEST_CHOSEN:
        raise ValueError(f"bin_ns: {chosen_ns}; want at least {1e9 * pulse.fwhm_s / FINEST_CHOSEN:.3g}")
    if 1e-9 * chosen_ns > 1.001 * pulse.fwhm_s:
        raise ValueError(f"bin_ns: {chosen_ns}; want at most the pulse's FWHM, {1e9 * pulse.fwhm_s:.4g}")
    return 1e-9 * chosen_ns


def _fine_bin_s(chosen_ns: float | None, pulse: Pulse, response: Response) -> float:
    """The step at which a receiver with electronics samples its signal and its noise."""
    if chosen_ns is not None:
        return _bin_s(chosen_ns, pulse)
    shortest = response.pole_s if response.shape == "single_pole" else 2.0 * response.sigma_s
    return max(min(_bin_s(None, pulse), 0.5 * shortest), pulse.fwhm_s / MOST_BINS)


def _response(spec: ReceiverSpec, options: PhysicsOptions, bandwidth_hz: float) -> Response | None:
    """The electronics of spec and options as one."""
    if options.response == "off" or options.photons is not None:
        return None
    if options.response is None and spec.response is None:
        given = [key for key in ELECTRONICS if getattr(options, key) is not None]
        if given:
            raise ValueError(f"{given[0]} without response; want response: single_pole or gauss")
        return None
    share = _or(options.tail_share, spec.tail_share, 0.0)
    return Response(
        _or(options.response, spec.response),
        1e6 * _or(options.corner_mhz, spec.corner_mhz, 1e-6 * bandwidth_hz),
        _or(options.clips, spec.clips, "after"),
        _or(options.rated_at, spec.rated_at, "output"),
        1e-9 * _or(options.coupling_ns, spec.coupling_ns, math.inf),
        share,
        1e-9 * _or(options.tail_ns, spec.tail_ns, 10.0),
    )


def _require_short(gate_m: float, bin_m: float) -> None:
    if gate_m > 1.001 * MOST_TABLED * bin_m:
        raise ValueError(
            f"gate_m {gate_m:g} has {gate_m / bin_m:.4g} steps of the sampled waveform,"
            f" {2e9 * bin_m / SPEED_OF_LIGHT_M_S:.4g} ns each; want at most {MOST_TABLED}: gate_m to"
            f" {MOST_TABLED * bin_m:.4g}, a longer pulse_fwhm_ns or bin_ns, or weather_echoes: false"
        )


def _beam(optics: OpticsSpec, options: PhysicsOptions, profile: Profile) -> BeamShape:
    x_rad, y_rad = 0.5e-3 * optics.divergence_x_mrad.value, 0.5e-3 * optics.divergence_y_mrad.value
    if options.divergence_deg is not None:
        both = options.divergence_deg
        x_deg, y_deg = both if isinstance(both, tuple) else (both, both)
        x_rad, y_rad = math.radians(0.5 * x_deg), math.radians(0.5 * y_deg)
    exit_mm = _or(options.exit_diameter_mm, optics.exit_diameter_mm, 0.0)
    return BeamShape(x_rad, y_rad, profile, math.radians(_or(options.roll_deg, optics.roll_deg, 0.0)), 0.5e-3 * exit_mm)


def _receiver(spec: ReceiverSpec, options: PhysicsOptions, pulse: Pulse) -> Receiver:
    bandwidth_hz = 1e6 * spec.bandwidth_mhz.value
    if options.pulse_fwhm_ns is not None:
        bandwidth_hz = float(noise.noise_bandwidth(pulse.fwhm_s))
    dark = Receiver(
        responsivity_a_w=spec.responsivity_a_w.value,
        gain=spec.gain.value,
        ionisation_ratio=spec.ionisation_ratio.value,
        dark_bulk_a=1e-9 * spec.dark_bulk_na.value,
        dark_surface_a=1e-9 * spec.dark_surface_na.value,
        amplifier_a_rthz=1e-12 * spec.amplifier_pa_rthz.value,
        load_ohm=spec.load_ohm.value if spec.load_ohm is not None else math.inf,
        bandwidth_hz=bandwidth_hz,
        adc_noise_a=0.0,
        field_of_view_rad=1e-3 * spec.field_of_view_mrad.value,
        filter_nm=spec.filter_nm.value,
        saturation_a=1e-3 * spec.saturation_ma.value,
        baseline_a=1.0,
    )
    baseline_a = dark.noise_a(0.0)
    if spec.adc_bits is not None and spec.full_scale_snr is not None:
        step = float(noise.adc_noise(spec.full_scale_snr.value * baseline_a, spec.adc_bits.value))
        baseline_a = math.hypot(baseline_a, step)
        return replace(dark, adc_noise_a=step, baseline_a=baseline_a)
    return replace(dark, baseline_a=baseline_a)


def _power(
    receiver: ReceiverSpec,
    pulse_spec: PulseSpec,
    options: PhysicsOptions,
    pulse: Pulse,
    aperture_m: float,
    efficiency: float,
    nep_w: float,
) -> tuple[float, float]:
    """System constant and peak power, each from the other."""
    k_m2 = options.system_constant_m2
    if k_m2 is None and receiver.system_constant_m2 is not None:
        k_m2 = receiver.system_constant_m2.value
    if k_m2 is not None:
        return k_m2, k_m2 * nep_w / (aperture_m**2 * efficiency)
    peak_w = float(pulse.peak_power(1e-6 * _need(pulse_spec.energy_uj).value))
    return float(radiometry.system_constant(peak_w, aperture_m, efficiency, nep_w)), peak_w


def _filter_share(optics: OpticsSpec, receiver: ReceiverSpec, options: PhysicsOptions) -> float:
    """Share of the laser line that passes the filter, over what passes when it is centred."""
    offset_m = 1e-9 * _or(options.filter_offset_nm, receiver.filter_offset_nm, 0.0)
    if offset_m == 0.0:
        return 1.0
    line_m = 1e-9 * (optics.line_width_nm.value if optics.line_width_nm is not None else 0.0)
    band_m = 1e-9 * receiver.filter_nm.value
    centred = background.filter_line_share(line_m, band_m, 0.0)
    return float(background.filter_line_share(line_m, band_m, offset_m) / centred)


def _threshold(
    options: PhysicsOptions, detection: DetectionSpec, receiver: Receiver, gate_m: float, response: Response | None,
    bin_s: float,
) -> float:  # fmt: skip
    wanted = options.false_alarms_per_gate
    if wanted is not None and response is not None:
        hertz = wanted * SPEED_OF_LIGHT_M_S / (2.0 * gate_m)
        low, high = 0.0, 40.0
        for _ in range(60):
            middle = 0.5 * (low + high)
            often = float(response.crossings_hz(middle, bin_s)) > hertz
            low, high = (middle, high) if often else (low, middle)
        return max(high, 1e-3)
    if options.false_alarms_per_gate is not None:
        return float(noise.tnr_for_false_alarms(options.false_alarms_per_gate, receiver.bandwidth_hz, gate_m))
    return _or(options.threshold_to_noise, detection.threshold_to_noise)
