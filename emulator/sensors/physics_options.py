"""The `physics:` table of a sensor in a scenario: how its beams are computed in this run.

Everything left out is taken from the model's spec. Facts of the model stay in the spec; weather in `weather`.
"""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator

from emulator.config.tables import NotNegative, Positive, Table

BundleRule = Literal["axis", "laguerre", "spiral", "grid", "adaptive"]
Profile = Literal["gauss", "tophat"]
PulseShape = Literal["sin2", "gauss"]
DetectionMethod = Literal["leading_edge", "constant_fraction", "peak", "centroid"]
BundlePruning = Literal["auto", "always", "never"]
EchoChoice = Literal["first", "strongest", "last", "all"]
ResponseShape = Literal["single_pole", "gauss"]
ClipPlace = Literal["before", "after"]
RatedAt = Literal["input", "output"]
DeadTimeLaw = Literal["non_paralysable", "paralysable"]

Amplitude = Annotated[float, Field(ge=1e-3, le=1e12)]
"In rms noise. Beyond these ends no receiver is, and their squares keep their digits."
Gate = Annotated[float, Field(ge=1e-3, le=1e6)]
"Farther, noise alone makes so many echoes a beam that they are no scan any more."
Divergence = Annotated[float, Field(ge=0.0, le=20.0)]
Probes = Literal[0] | Annotated[int, Field(ge=4, le=64)]
"Of a beam, around its axis; four are the fewest that tell a plane from an edge."
CornerMHz = Annotated[float, Field(ge=1e-3, le=1e6)]
TimeConstantNs = Annotated[float, Field(ge=0.01, le=1e6)]
TailShare = Annotated[float, Field(ge=0.0, le=0.5)]


class WindscreenOptions(Table):
    """A laminated pane in front of the sensor, every beam through it both ways."""

    rake_deg: Annotated[float, Field(ge=0.0, lt=90.0)] = 60.0
    "Between a beam along the sensor's x axis and the pane's normal, which leans back."
    internal_transmission: Annotated[float, Field(gt=0.0, le=1.0)] = 0.8
    "One way: 0.8 clear to 0.3 heat-absorbing at 905 nm."
    index: Annotated[float, Field(ge=1.0, le=4.0)] = 1.5


class PhotonOptions(Table):
    """A receiver that counts photons: a histogram of first photons over many shots, or of photon pairs."""

    shots: Annotated[int, Field(ge=1, le=10_000_000)] = 1000
    "Pulses a beam."
    quantum_efficiency: Annotated[float, Field(gt=0.0, le=1.0)] = 0.3
    dark_count_hz: Annotated[float, Field(ge=0.0, le=1e11)] = 1000.0
    bin_ns: Annotated[float, Field(ge=1e-3, le=1000.0)] = 1.0
    pair_rate_hz: Annotated[float, Field(gt=0.0, le=1e11)] | None = None
    "Photon pairs instead of pulses: so many a second, each idler kept at home as the clock of its counterpart."
    idler_efficiency: Annotated[float, Field(gt=0.0, le=1.0)] = 0.5
    integration_ms: Annotated[float, Field(gt=0.0, le=1e5)] = 10.0
    "Pairs: time for which coincidences of a beam are collected."
    dead_time_ns: Annotated[float, Field(gt=0.0, le=1e6)] | None = None
    "After a count a cell is blind for so long, then counts again; None: the first photon of a pulse is its only one."
    dead_time_law: DeadTimeLaw = "non_paralysable"
    "paralysable: a photon within the dead time, not counted itself, begins it again (passive quenching)."
    cells: Annotated[int, Field(ge=1, le=100_000)] = 1
    "Of a silicon photomultiplier, each with its own dead time; the light falls on all alike. 1: one SPAD."
    afterpulse_probability: Annotated[float, Field(ge=0.0, le=0.9)] = 0.0
    "That a count fills a trap, whose carrier makes another count when it is released after the dead time."
    trap_time_ns: Annotated[float, Field(gt=0.0, le=1e6)] = 50.0
    "Mean time of its release."

    @model_validator(mode="after")
    def _dead_time(self) -> PhotonOptions:
        if self.dead_time_ns is None:
            named = "dead_time_law", "cells", "afterpulse_probability", "trap_time_ns"
            given = [key for key in named if getattr(self, key) != type(self).model_fields[key].default]
            if given:
                raise ValueError(f"{given[0]} without dead_time_ns; want both")
        return self


class LeaveOut(Table):
    """Switches of single rules of the error budget; bounds: `error_budget`. `full` switches all off."""

    clear_air: bool = True
    "No extinction where all that is met is too near for it to be seen."
    closed_form: BundlePruning = "auto"
    "One ray for beams that see one plane; `auto`: where that saves time."
    plane_moments: bool = True
    "Such a beam's echo from the moments of a tilted plane, where they hold; else by its bundle's ranges to the plane."
    narrow_beams: bool = True
    "Probes instead of a bundle for beams of a sensor with `probes` that see one smooth surface."
    resting: bool = True
    "What a sensor at rest meets of resting bodies is found once."
    far_objects: bool = True
    "Nothing is cast on what lies out of reach."
    background_light: bool = True
    "No background whose shot noise cannot be seen."
    noise_echoes: bool = True
    "No draws of noise echoes that are rarer than one in a million sweeps."
    backscatter: bool = True
    "No return of a medium too faint to be an echo, but where it would shift another echo."
    soft_table: bool = True
    "The return of a medium is tabulated once for a state of the weather, not in every sweep."
    particles: bool = True
    "No draws of drops or flakes of which less than one in a thousand sweeps shows one."
    waveform: bool = True
    "Clusters of reflections shorter than half a pulse are timed in closed form, without a sampled waveform."
    second_rays: bool = True
    "Rays are not continued behind mirrors and glass where nothing could come back."
    faint: bool = True
    "Reflections below a thousandth of the threshold are dropped, up to a hundredth of it in a beam."

    @classmethod
    def nothing(cls) -> LeaveOut:
        """Every rule off."""
        return cls.model_validate({name: "never" if name == "closed_form" else False for name in cls.model_fields})


ELECTRONICS = ("response", "corner_mhz", "clips", "rated_at", "coupling_ns", "tail_share", "tail_ns")
"Keys of the receiver's electronics."


class PhysicsOptions(Table):
    """Choices of a run; None: as the model's spec has it."""

    rule: BundleRule | None = None
    sub_beams: Annotated[int, Field(ge=1, le=65536)] | None = None
    probes: Probes | None = None
    "Rays around the axis of each beam that are cast before its bundle, for a top-hat; 0: none."
    depth: Annotated[int, Field(ge=0, le=8)] = 4
    "Levels of splitting of rule `adaptive`."
    profile: Profile | None = None
    divergence_deg: Divergence | tuple[Divergence, Divergence] | None = None
    "Full angle, or in and across the scan plane."
    roll_deg: float | None = None
    sidelobe_share: Annotated[float, Field(ge=0.0, le=0.5)] | None = None
    "Of the emitted light, in a wide Gaussian around the beam; 0: none."
    sidelobe_mrad: Annotated[float, Field(gt=0.0, le=300.0)] | None = None
    "Full angle of it, 1/e^2."
    bloom_share: Annotated[float, Field(ge=0.0, le=0.5)] | None = None
    "Of an echo that saturates, on a detector right beside its own that listens at the time; 0: none."
    bloom_mrad: Annotated[float, Field(gt=0.0, le=1000.0)] | None = None
    "Angle between beams at which it has fallen to 1/e^2."
    exit_diameter_mm: Annotated[float, Field(ge=0.0, le=1e4)] | None = None
    pulse: PulseShape | None = None
    pulse_fwhm_ns: Annotated[float, Field(ge=0.01, le=1e5)] | None = None
    baseline_mm: Annotated[float, Field(ge=0.0, le=1e4)] | None = None
    "From emitter to receiver: over the range the angle at which retroreflective sheeting is observed."
    wavelength_nm: Annotated[float, Field(ge=300.0, le=3000.0)] | None = None
    filter_offset_nm: Annotated[float, Field(ge=-3000.0, le=3000.0)] | None = None
    "Laser line off the centre of the receiver's filter, by temperature for instance: 0.3 nm/K."
    system_constant_m2: Annotated[float, Field(ge=1e-30, le=1e30)] | None = None
    threshold_to_noise: Amplitude | None = None
    false_alarms_per_gate: Annotated[float, Field(gt=0.0, lt=1.0)] | None = None
    "Sets the threshold from the mean count of noise echoes a beam."
    detection: DetectionMethod | None = None
    walk_table: bool | None = None
    echoes: EchoChoice | None = None
    max_echoes: Annotated[int, Field(ge=1, le=64)] | None = None
    bin_ns: Positive | None = None
    "Step of a sampled waveform; None: 1 ns, finer for pulses under 4 ns."
    range_noise_mm: Annotated[float, Field(ge=0.0, le=1e6)] | None = None
    systematic_mm: Annotated[float, Field(ge=-1e6, le=1e6)] | None = None
    near_gate_m: Annotated[float, Field(ge=0.0, le=1e6)] | None = None
    gate_m: Gate | None = None
    floor_reflectance: Annotated[float, Field(gt=0.0, le=1e4)] | Literal["off"] | None = None
    "Near by, what is darker than a plate of it is overlooked; a retroreflector is as bright as one of some thousand."
    recovery_ns: NotNegative | None = None
    full_scale_snr: Amplitude | Literal["off"] | None = None
    response: ResponseShape | Literal["off"] | None = None
    "Electronics of the receiver: pulses shaped and noise correlated by this filter; off: an ideal receiver."
    corner_mhz: CornerMHz | None = None
    "Half-power frequency of `response`; None: bandwidth_mhz."
    clips: ClipPlace | None = None
    "Whether the full scale limits the current before the filter or the voltage after it."
    rated_at: RatedAt | None = None
    "output: an echo keeps its rated peak behind the filter; input: it is lower by what the filter takes."
    coupling_ns: TimeConstantNs | None = None
    "Time constant of an AC coupling, after a bright echo the signal is below zero; None: none."
    tail_share: TailShare | None = None
    "Share of an echo's charge that comes late."
    tail_ns: TimeConstantNs | None = None
    noise: bool = True
    "Draw noise of amplitude and range (mode operational)."
    false_alarms: bool = True
    background: bool = True
    weather_echoes: bool = True
    "Backscatter of fog, rain, snow, dust, spray."
    bounces: Annotated[int, Field(ge=0, le=2)] = 2
    "Rays continued at mirrors and through glass."
    windscreen: WindscreenOptions | None = None
    photons: PhotonOptions | None = None
    "Count photons instead of timing an analogue signal."
    leave_out: LeaveOut = LeaveOut()
    plain_radii: Annotated[float, Field(ge=0.5, le=5.0)] = 2.63
    "Beam radii within which a beam must see one plane to be cast as one ray; 1e-6 of the power lies outside of 2.63."
    full: bool = False
    "Compute every term, also those that a bound shows to be invisible."

    @model_validator(mode="after")
    def _one_threshold(self) -> PhysicsOptions:
        if self.threshold_to_noise is not None and self.false_alarms_per_gate is not None:
            raise ValueError("threshold_to_noise and false_alarms_per_gate; want one of them")
        if self.response == "off" or self.photons is not None:
            given = [key for key in ELECTRONICS if getattr(self, key) is not None and getattr(self, key) != "off"]
            if given:
                why = "photons" if self.photons is not None else "response off"
                raise ValueError(f"{', '.join(given)} beside {why}; want one of them")
        if self.gate_m is not None and self.near_gate_m is not None and self.near_gate_m >= self.gate_m:
            raise ValueError(f"near_gate_m {self.near_gate_m} not before gate_m {self.gate_m}; want it smaller")
        return self
