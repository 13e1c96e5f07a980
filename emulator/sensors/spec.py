"""Facts of a sensor model: `sensors/*.yaml` -> `SensorSpec`, every number with its source and evidence.

Belongs here: what a data sheet (or who measured it) says of a model. Not: what a run chooses (scenario), what the wire
protocol needs (the family checks the `device` table), and what follows from the facts (sensing).
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Annotated, Any, Generic, Literal, TypeVar

from pydantic import Field, ValidationError, model_validator

from emulator.config.tables import NotNegative, Positive, Table
from emulator.config.yaml_source import Loc, Source, fault_lines, read
from emulator.errors import SpecError
from emulator.sensors.physics_options import (
    ELECTRONICS,
    BundleRule,
    ClipPlace,
    CornerMHz,
    DetectionMethod,
    EchoChoice,
    Probes,
    Profile,
    PulseShape,
    RatedAt,
    ResponseShape,
    TailShare,
    TimeConstantNs,
)
from protocols import family
from protocols.errors import DeviceSettingError

Value = TypeVar("Value")

Share = Annotated[float, Field(gt=0.0, le=1.0)]
Divergence = Annotated[float, Field(ge=0.0, le=349.065850398866)]
"Full angle in mrad; 20 degrees is the limit of the tangent-plane bundle."

Evidence = Literal["seed", "read", "calc", "mem", "choice", "derived", "verified"]
"""seed: printed in the base paper; read: in a public document or source; calc: computed; mem: general knowledge, not
checked; choice: ours; derived: follows from others; verified: seen on a real driver or recording."""


class Fact(Table, Generic[Value]):
    """A value with where it comes from."""

    value: Value
    source: str = Field(min_length=1)
    evidence: Evidence


class OpticsSpec(Table):
    """The emitted beam."""

    wavelength_nm: Fact[Annotated[float, Field(ge=300.0, le=3000.0)]]
    line_width_nm: Fact[NotNegative] | None = None
    "Full width at half maximum of the laser line; None: a line far narrower than the filter."
    profile: Fact[Profile]
    divergence_x_mrad: Fact[Divergence]
    "Full angle in the scan plane: 1/e^2 of the irradiance (gauss), edge (tophat)."
    divergence_y_mrad: Fact[Divergence]
    "Across the scan plane."
    sidelobe_share: Fact[Annotated[float, Field(ge=0.0, le=0.5)]] | None = None
    "Of the emitted light, in a wide Gaussian around the beam; None: none."
    sidelobe_mrad: Fact[Annotated[float, Field(gt=0.0, le=300.0)]] | None = None
    "Full angle of it, 1/e^2."
    roll_deg: Fact[float] | None = None
    exit_diameter_mm: Fact[NotNegative] | None = None
    "Diameter of the beam at the window, by the same measure as the divergence."


class PulseSpec(Table):
    """The emitted pulse."""

    shape: Fact[PulseShape]
    fwhm_ns: Fact[Annotated[float, Field(ge=0.01, le=1e5)]]
    energy_uj: Fact[Positive] | None = None


class ReceiverSpec(Table):
    """Optics and electronics of the receiver. Either the system constant or the pulse energy must be known."""

    aperture_mm: Fact[Positive]
    "Diameter of the receiving lens."
    baseline_mm: Fact[NotNegative] | None = None
    "From emitter to receiver, for the angle at which sheeting is observed; None: two thirds of the lens's radius."
    efficiency: Fact[Share]
    "All receive losses: optics, filter at the laser line."
    system_constant_m2: Fact[Positive] | None = None
    "K = P0 a^2 eta / NEP: a white plate at R metres gives the signal to noise K / R^2."
    responsivity_a_w: Fact[Positive]
    gain: Fact[Annotated[float, Field(ge=1.0)]]
    ionisation_ratio: Fact[Annotated[float, Field(ge=0.0, le=1.0)]]
    "k of McIntyre's excess noise; without meaning at gain 1."
    bandwidth_mhz: Fact[Positive]
    amplifier_pa_rthz: Fact[NotNegative]
    dark_bulk_na: Fact[NotNegative]
    "Dark current that is multiplied."
    dark_surface_na: Fact[NotNegative]
    load_ohm: Fact[Positive] | None = None
    "None: its thermal noise is inside the amplifier's."
    field_of_view_mrad: Fact[Annotated[float, Field(gt=0.0, le=1000.0)]]
    "Full angle."
    filter_nm: Fact[Positive]
    "Width of the optical band."
    filter_offset_nm: Fact[float] | None = None
    "Centre of the laser line from that of the filter: 0.3 nm/K of drift, and the filter's shift with the angle."
    saturation_ma: Fact[Positive]
    "Photocurrent of background light from which the receiver is blind."
    adc_bits: Fact[Annotated[int, Field(ge=1, le=24)]] | None = None
    full_scale_snr: Fact[Positive] | None = None
    "Peak over noise at which the signal clips; None: never."
    recovery_ns: Fact[NotNegative] | None = None
    bloom_share: Fact[Annotated[float, Field(ge=0.0, le=0.5)]] | None = None
    "Of an echo that saturates, on a detector right beside its own that listens at the time; None: none."
    bloom_mrad: Fact[Annotated[float, Field(gt=0.0, le=1000.0)]] | None = None
    "Angle between beams at which it has fallen to 1/e^2."
    response: Fact[ResponseShape] | None = None
    "Low-pass of the electronics, which shapes pulses and correlates noise; None: an ideal receiver."
    corner_mhz: Fact[CornerMHz] | None = None
    "Its half-power frequency; None: bandwidth_mhz."
    clips: Fact[ClipPlace] | None = None
    "Whether the full scale limits the current before the filter or the voltage after it (None: after)."
    rated_at: Fact[RatedAt] | None = None
    "Where the system constant holds: behind the filter (None: output) or before it."
    coupling_ns: Fact[TimeConstantNs] | None = None
    "Time constant of an AC coupling; None: none."
    tail_share: Fact[TailShare] | None = None
    "Share of an echo's charge that comes late, with the time constant `tail_ns`."
    tail_ns: Fact[TimeConstantNs] | None = None
    overlap_start_m: Fact[Positive]
    "Where beam and field of view first meet."
    overlap_full_m: Fact[Positive]
    near_gate_m: Fact[NotNegative] | None = None
    "No echo is reported from nearer."
    gate_m: Fact[Positive]
    "No echo is reported from farther."
    floor_reflectance: Fact[Positive] | None = None
    """Sensitivity-time control: near by the threshold follows a target of this reflectance over 1/R^2, so that weaker
    echoes (fog in front of the window) stay below it. None: one threshold at all ranges."""


class DetectionSpec(Table):
    """How the receiver makes echoes of the signal."""

    threshold_to_noise: Fact[Positive]
    method: Fact[DetectionMethod]
    walk_table: Fact[bool]
    "The leading edge's walk is corrected with the measured peak."
    echoes: Fact[EchoChoice]
    max_echoes: Fact[Annotated[int, Field(ge=1, le=64)]]
    range_noise_mm: Fact[NotNegative]
    "Standard deviation added in quadrature to the receiver's own."
    systematic_mm: Fact[float]
    "Added to every range."
    lsb_mm: Fact[Positive]
    "Finest step of the reported range."


class TriangulationSpec(Table):
    """Optics of a sensor that triangulates; its errors are added to those of `detection`."""

    baseline_mm: Fact[Positive]
    "Between laser and lens."
    focal_px: Fact[Positive]
    "Of the lens, in pixels of the imager."
    subpixel_px: Fact[NotNegative]
    "Standard deviation of the place found for a bright spot; as a range d^2 subpixel / (focal baseline)."
    spot_px: Fact[NotNegative] | None = None
    "Width of the spot, over the signal to noise an error too: faint targets scatter more. None: none."
    step_px: Fact[NotNegative] | None = None
    "Quantisation of the place. None: none."
    imager_px: Fact[Positive] | None = None
    "Where the imager ends, from the vanishing point: nearer targets give no echo. None: it does not."


class BundleSpec(Table):
    """What sensing does unless a scenario says otherwise."""

    rule: Fact[BundleRule]
    sub_beams: Fact[Annotated[int, Field(ge=1, le=65536)]]
    probes: Fact[Probes] | None = None
    "Rays around the axis of each beam that are cast first; None: the whole bundle."


class BeamTable(Table):
    """Beam directions and firing instants of a sensor without a protocol family that plans them."""

    azimuth_deg: Fact[list[float]]
    "One layer's directions, in the order of firing."
    elevation_deg: Fact[list[float]]
    "Layers, each fired along the whole of `azimuth_deg`."
    fire_us: Fact[list[float]]
    "Instants of a sweep's beams, all of them, layer by layer; or one number: the time from beam to beam."
    period_ms: Fact[Positive]

    @model_validator(mode="after")
    def _shapes(self) -> BeamTable:
        beams = len(self.azimuth_deg.value) * len(self.elevation_deg.value)
        if beams == 0:
            raise ValueError("no beam; want at least one azimuth_deg and one elevation_deg")
        if len(self.fire_us.value) not in (1, beams):
            raise ValueError(f"fire_us has {len(self.fire_us.value)} values; want 1 or {beams}")
        return self


class GeometrySpec(Table):
    """How the device scans. For a family these facts are reported, not used: the family's own table plans the
    sweeps."""

    field_deg: Fact[Positive]
    steps_deg: Fact[list[Positive]]
    turn_hz: Fact[list[Positive]]
    direction: Fact[Literal["counter-clockwise", "clockwise", "none"]]


class SensorSpec(Table):
    """All facts of one model."""

    schema_: Literal[1] = Field(alias="schema")
    model: str
    title: str
    sees: Literal["beams", "objects"]
    "beams: it measures itself. objects: its list is made from the scans of other sensors."
    family: str | None
    "Key of `protocols.FAMILIES`; None: no conversation of its own, a table of beams for studies."
    device: dict[str, Any] = Field(default_factory=dict)
    "Facts handed to the family, which checks them."
    optics: OpticsSpec | None = None
    pulse: PulseSpec | None = None
    receiver: ReceiverSpec | None = None
    detection: DetectionSpec | None = None
    triangulation: TriangulationSpec | None = None
    "None: it measures time of flight."
    bundle: BundleSpec | None = None
    geometry: GeometrySpec | None = None
    beams: BeamTable | None = None

    @model_validator(mode="after")
    def _complete(self) -> SensorSpec:
        parts = ("optics", "pulse", "receiver", "detection", "bundle")
        if self.sees == "beams":
            missing = [name for name in parts if getattr(self, name) is None]
            if missing:
                raise ValueError(f"a sensor with beams needs {', '.join(missing)}")
            if self.family is None and self.beams is None:
                raise ValueError("neither family nor beams; want one of them")
        else:
            given = [name for name in (*parts, "beams") if getattr(self, name) is not None]
            if given:
                raise ValueError(f"{', '.join(given)}: a sensor that lists objects has none")
        receiver, pulse = self.receiver, self.pulse
        if receiver is not None and pulse is not None:
            if (receiver.system_constant_m2 is None) == (pulse.energy_uj is None):
                raise ValueError("want either receiver.system_constant_m2 or pulse.energy_uj, the other follows")
            given = [key for key in ELECTRONICS if getattr(receiver, key) is not None]
            if given and receiver.response is None:
                raise ValueError(f"receiver.{given[0]} without receiver.response; want both")
            if receiver.overlap_full_m.value < receiver.overlap_start_m.value:
                raise ValueError("receiver.overlap_full_m lies before receiver.overlap_start_m")
        return self


@cache
def list_models() -> tuple[str, ...]:
    """Names of all models shipped, sorted."""
    return tuple(sorted(path.stem for path in _folder().glob("*.yaml")))


def is_file(model: str) -> bool:
    """Whether a scenario's `model` is a spec file of its own rather than the name of a shipped one."""
    return model.endswith((".yaml", ".yml"))


def name_of(model: str) -> str:
    """The model's name, whichever it is."""
    return Path(model).stem if is_file(model) else model


@cache
def load_spec(model: str) -> SensorSpec:
    """Facts of a shipped model, or of the file at an absolute path; `SpecError` names the nearest known one."""
    import difflib

    if is_file(model):
        return load_spec_file(Path(model))
    path = _folder() / f"{model}.yaml"
    if model not in list_models():
        near = difflib.get_close_matches(model, list_models(), n=1)
        hint = f"did you mean {near[0]}? " if near else ""
        raise SpecError(f"model: {model!r}; {hint}want one of {', '.join(list_models())}")
    return load_spec_file(path)


def load_spec_file(path: Path) -> SensorSpec:
    """Facts from a spec file; `extends: MODEL` takes what it does not say from MODEL, beside it or shipped."""
    source = _with_parents(path, ())
    try:
        spec = SensorSpec.model_validate(source.data)
    except ValidationError as exc:
        raise SpecError.of(fault_lines(source, SensorSpec, exc)) from exc
    if spec.model != path.stem:
        raise SpecError(f"{source.place(('model',))}: model: {spec.model!r}; want the file's name, {path.stem!r}")
    _check_device(spec, source)
    return spec


def _check_device(spec: SensorSpec, source: Source) -> None:
    """The table that the family gets, by a family that checks it: its faults with their line in the file."""
    try:
        check = getattr(None if spec.family is None else family(spec.family), "check_facts", None)
    except KeyError:
        return  # another package's; who makes a session says so
    if check is None:
        return
    try:
        check(spec.device)
    except DeviceSettingError as error:
        loc: Loc = ("device", *error.key.split("."))
        while loc and loc not in source.places:
            loc = loc[:-1]
        raise SpecError(f"{source.place(loc)}: device.{error.key}: {error.found!r}; want {error.allowed}") from None


def _folder() -> Path:
    return Path(str(files("emulator.sensors")))


def _with_parents(path: Path, below: tuple[Path, ...]) -> Source:
    source = read(path, SpecError)
    if not isinstance(source.data, dict):
        raise SpecError(f"{path}:1: file: {source.data!r}; want keys with values")
    parent = source.data.pop("extends", None)
    if parent is None:
        return source
    place = source.place(("extends",))
    beside = {one.stem: one for one in path.parent.glob("*.yaml") if one != path}
    known = {one.stem: one for one in _folder().glob("*.yaml")} | (beside if path.parent != _folder() else {})
    if not isinstance(parent, str) or parent not in known:
        raise SpecError(f"{place}: extends: {parent!r}; want one of {', '.join(sorted(known))}")
    base_path = known[parent]
    if base_path in (*below, path):
        raise SpecError(f"{place}: extends: {parent!r}; want a model that does not extend this one")
    base = _with_parents(base_path, (*below, path))
    places = dict(base.places)
    data = _overlay(base.data, source.data, (), places, source.places)
    return Source(path, data, places | {(): (path, 1)})


def _overlay(
    base: Any, over: Any, loc: Loc, places: dict[Loc, tuple[Path, int]], new: Mapping[Loc, tuple[Path, int]]
) -> Any:
    """`base` with what `over` says; a fact (a table with `value`) is replaced whole."""
    if isinstance(base, dict) and isinstance(over, dict) and "value" not in over:
        out = dict(base)
        for key, value in over.items():
            out[key] = _overlay(base.get(key), value, (*loc, key), places, new)
        return out
    for old in [path for path in places if path[: len(loc)] == loc]:
        del places[old]
    places.update({path: at for path, at in new.items() if path[: len(loc)] == loc})
    return over
