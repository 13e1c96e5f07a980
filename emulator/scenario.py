"""Facts of a run: a YAML file -> a frozen `Scenario`, every fault told as `file:line: key: found; want allowed`.

Belongs here: the models of the file; loading, dumping, the published JSON Schema. Not: meshes (scene), facts of a
sensor model (spec), a device's own settings (its family checks them), the weather's table (weather), references
between tables (scenario_checks).
"""

from __future__ import annotations

import io
import json
from collections.abc import Mapping, Sequence
from importlib.resources import files
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    PrivateAttr,
    ValidationError,
    model_validator,
)
from ruamel.yaml import YAML

from emulator import overrides as changes
from emulator import scenario_checks, yaml_lines
from emulator.errors import ScenarioError
from emulator.object_options import ObjectOptions
from emulator.physics_options import PhysicsOptions
from emulator.weather import WeatherConfig
from emulator.yaml_source import fault_lines

MOST_ACTORS = 10_000
MOST_SENSORS = 256
MOST_WAYPOINTS = 100_000
MOST_M = 1e9
"Of a coordinate or length: float64 tells 1e-7 m apart there, beyond it ever less."
LEAST_M = 1e-9
"Of a length: smaller things than a wavelength do not reflect as surfaces."
MOST_M_S = 1e5
"Of an actor: the motion during the light's way there and back, 0.17 m at this speed and 250 m, is left out."


def _long_as(count: int) -> BeforeValidator:
    """Tells a list of another length in one line instead of one a missing number."""

    def check(value: Any) -> Any:
        if isinstance(value, tuple) and len(value) != count:
            raise ValueError(f"{len(value)} values; want a list of {count} numbers")
        return value

    return BeforeValidator(check)


def _not_tiny(length_m: float) -> float:
    if length_m < LEAST_M:
        raise ValueError(f"{length_m}; want a number >= {LEAST_M}")
    return length_m


Coordinate = Annotated[float, Field(ge=-MOST_M, le=MOST_M)]
Length = Annotated[float, Field(gt=0.0, le=MOST_M), AfterValidator(_not_tiny)]
Speed = Annotated[float, Field(ge=-MOST_M_S, le=MOST_M_S)]
Angle = Annotated[float, Field(ge=-1e6, le=1e6)]
Vector = Annotated[tuple[Coordinate, Coordinate, Coordinate], _long_as(3)]
Velocity = Annotated[tuple[Speed, Speed, Speed], _long_as(3)]
Positive = Annotated[float, Field(gt=0.0)]
Id = Annotated[str, Field(pattern=r"^[A-Za-z_][A-Za-z0-9_-]{0,63}$")]

SHAPES = ("mesh", "plane", "box", "cylinder", "sphere")


class _Table(BaseModel):
    model_config = ConfigDict(
        extra="forbid", frozen=True, strict=True, allow_inf_nan=False, use_attribute_docstrings=True
    )


class Plane(_Table):
    """A rectangle centred on its origin, normal +z, seen from both sides."""

    size_m: Annotated[tuple[Length, Length], _long_as(2)]
    "Along x, along y."


class Box(_Table):
    """A closed box; its origin is the centre of its base."""

    size_m: Annotated[tuple[Length, Length, Length], _long_as(3)]
    "Along x, y, z."


class Cylinder(_Table):
    """A closed upright cylinder; its origin is the centre of its base."""

    radius_m: Length
    height_m: Length
    segments: Annotated[int, Field(ge=3, le=4096)] = 64
    "Flat faces around; their edges lie on the circle."


class Sphere(_Table):
    """A closed sphere that stands on its origin."""

    radius_m: Length
    segments: Annotated[int, Field(ge=4, le=2048)] = 64
    "Meridians; half as many rings. The corners lie on the sphere."


class Shape(_Table):
    """Exactly one of a mesh file and the primitives."""

    mesh: str | None = None
    "GLB, glTF, OBJ, PLY or STL; relative to this file, or `builtin:NAME`."
    plane: Plane | None = None
    box: Box | None = None
    cylinder: Cylinder | None = None
    sphere: Sphere | None = None
    up: Literal["y", "z"] | None = None
    """Axis of the mesh file that points up. y: +z points forward, as glTF defines it; z: +x points forward.
    By default y for glTF and GLB, z for the others."""
    scale: Annotated[float, Field(gt=0.0, le=1e6)] = 1.0
    "Metres per unit of the mesh file."

    @model_validator(mode="after")
    def _one_kind(self) -> Shape:
        given = [kind for kind in SHAPES if getattr(self, kind) is not None]
        if len(given) != 1:
            raise ValueError(f"{' and '.join(given) or 'no shape'}; want exactly one of {', '.join(SHAPES)}")
        if self.mesh is None and self.model_fields_set & {"up", "scale"}:
            raise ValueError(f"{given[0]} with up or scale; want these for a mesh only")
        return self

    @property
    def kind(self) -> str:
        """`mesh`, `plane`, `box`, `cylinder` or `sphere`."""
        return next(kind for kind in SHAPES if getattr(self, kind) is not None)


class WorldItem(Shape):
    """A piece of the world that never moves."""

    at_m: Vector = (0.0, 0.0, 0.0)
    yaw_deg: Angle = 0.0
    pitch_deg: Angle = 0.0
    roll_deg: Angle = 0.0
    material: str | None = None
    "Of all parts that `materials` does not name. A part that bears the name of a material needs neither."
    materials: dict[str, str] = Field(default_factory=dict)
    "Part of the mesh (its material's or object's name in the file) -> material."


class Waypoint(_Table):
    """Where something is at a time."""

    t_s: Annotated[float, Field(ge=-1e9, le=1e9)]
    at_m: Vector
    yaw_deg: Angle = 0.0
    pitch_deg: Angle = 0.0
    roll_deg: Angle = 0.0


class MotionConfig(_Table):
    """Either a start with constant velocity, or waypoints."""

    at_m: Vector = (0.0, 0.0, 0.0)
    yaw_deg: Angle = 0.0
    pitch_deg: Angle = 0.0
    roll_deg: Angle = 0.0
    velocity_m_s: Velocity = (0.0, 0.0, 0.0)
    "In the world's frame; it does not turn with the actor."
    yaw_rate_deg_s: Angle = 0.0
    waypoints: Annotated[tuple[Waypoint, ...], Field(max_length=MOST_WAYPOINTS)] = ()
    "Straight lines between them, turning the shortest way; before the first and after the last it stands still."
    loop: bool = False
    "From the last waypoint on it begins again at the first."


Category = Literal["car", "truck", "motorcycle", "bicycle", "pedestrian", "wide", "point", "unknown"]


class Actor(_Table):
    """Something that can move and that sensors can be mounted on."""

    id: Id
    shape: Shape | None = None
    "None: it is not seen."
    material: str | None = None
    "Of all parts that `materials` does not name. A part that bears the name of a material needs neither."
    materials: dict[str, str] = Field(default_factory=dict)
    "Part of the mesh (its material's or object's name in the file) -> material."
    class_: Category = Field(default="unknown", alias="class")
    "For object lists."
    motion: MotionConfig = Field(default_factory=MotionConfig)


class Mount(_Table):
    """Where a sensor's optical centre is, on an actor or in the world."""

    actor: str | None = None
    "None: the world."
    at_m: Vector = (0.0, 0.0, 0.0)
    yaw_deg: Angle = 0.0
    pitch_deg: Angle = 0.0
    roll_deg: Angle = 0.0


class SensorConfig(_Table):
    """One emulated sensor."""

    id: Id
    model: str
    "See `lidaremu list sensors`."
    mount: Mount = Field(default_factory=Mount)
    device: dict[str, Any] = Field(default_factory=dict)
    "What a real one keeps over power-off; the model's protocol family knows the keys."
    mode: Literal["operational", "seed"] = "operational"
    "seed: the deterministic model of the base paper, for its figures."
    physics: PhysicsOptions = Field(default_factory=PhysicsOptions)
    "How its beams are computed; what is left out is taken from the model."
    links: Annotated[tuple[str, ...], Field(max_length=64)] = ()
    "See `lidaremu list links`."
    from_: tuple[str, ...] = Field(default=(), alias="from")
    "Sensors from whose scans it makes its objects."
    objects: ObjectOptions = Field(default_factory=ObjectOptions)
    "How it makes them; of models that list objects."


class Fault(BaseModel):
    """Something that goes wrong on purpose; its other keys depend on `do`."""

    model_config = ConfigDict(extra="allow", frozen=True, strict=True, allow_inf_nan=False)

    on: str
    do: str
    at_s: Annotated[float, Field(ge=0.0)] | None = None


class Expectation(BaseModel):
    """What must hold at the end of a test run; its other keys depend on `that`."""

    model_config = ConfigDict(extra="allow", frozen=True, strict=True, allow_inf_nan=False)

    that: str
    within: Annotated[tuple[float, float], _long_as(2)] | None = None


class Record(_Table):
    """What a run keeps."""

    wire: bool = False
    "Bytes both ways."
    truth: bool = False
    "What each echo was."


class Scenario(_Table):
    """Everything that a run is made of."""

    schema_: Literal[1] = Field(alias="schema")
    seed: Annotated[int, Field(ge=0, lt=2**63)] = 0
    "Of every random draw."
    duration_s: Positive | None = None
    "None: until it is stopped."
    world: Annotated[tuple[WorldItem, ...], Field(max_length=MOST_ACTORS)] = ()
    actors: Annotated[tuple[Actor, ...], Field(max_length=MOST_ACTORS)] = ()
    weather: WeatherConfig = Field(default_factory=WeatherConfig)
    materials: dict[str, dict[str, Any]] = Field(default_factory=dict)
    "Materials of this file beside those that come with the package."
    sensors: Annotated[tuple[SensorConfig, ...], Field(max_length=MOST_SENSORS)] = ()
    faults: tuple[Fault, ...] = ()
    expect: tuple[Expectation, ...] = ()
    record: Record = Field(default_factory=Record)

    _source: yaml_lines.Source = PrivateAttr()

    @property
    def source(self) -> Path:
        """The file it came from."""
        return self._source.path

    @property
    def folder(self) -> Path:
        """The folder that relative paths start from."""
        return self._source.path.parent

    @property
    def known_materials(self) -> frozenset[str]:
        """Names of all materials, the file's own included."""
        from emulator.physics.materials import known_materials

        return frozenset((*self.materials, *known_materials()))

    def resolve(self, mesh: str) -> Path:
        """Where a mesh of this scenario lies."""
        return scenario_checks.mesh_path(mesh, self.folder)

    def label(self, key: str) -> str:
        """`file:line: dotted.key`, the beginning of a message about that key (`sensors.0.device.unit`)."""
        loc = tuple(int(part) if part.isdecimal() else part for part in key.split("."))
        return f"{self._source.place(loc)}: {self._source.dotted(loc)}"

    def fault(self, key: str, found: object, allowed: str) -> ScenarioError:
        """An error that names file, line and key."""
        return ScenarioError(f"{self.label(key)}: {found!r}; want {allowed}")


# ---------------------------------------------------------------- names


def builtin_names() -> list[str]:
    """Names of the scenarios that come with the package."""
    return sorted(entry.name[:-5] for entry in files("scenarios").iterdir() if entry.name.endswith(".yaml"))


def builtin_summary(name: str) -> str:
    """First sentence of a built-in scenario's first comment."""
    text = (files("scenarios") / f"{name}.yaml").read_text(encoding="utf-8")
    lines = []
    for line in text.splitlines():
        if not line.startswith("#"):
            break
        lines.append(line[1:].strip())
    sentence, stop, _ = " ".join(lines).partition(". ")
    return sentence + stop.strip()


def _path_of(name: str) -> Path:
    path = Path(name)
    names = builtin_names()
    if name in names and not path.is_file():
        return Path(str(files("scenarios") / f"{name}.yaml"))
    if not path.exists() and path.suffix not in (".yaml", ".yml"):
        raise ScenarioError(f"{name}: no such file or built-in scenario; want {scenario_checks.nearest(name, names)}")
    return path


# ---------------------------------------------------------------- loading


def load(
    path_or_builtin_name: str,
    overrides: Sequence[str] = (),
    seed: int | None = None,
    links: Mapping[str, Sequence[str]] | None = None,
) -> Scenario:
    """The scenario of a file or a built-in name, changed and judged.

    Parameters
    ----------
    path_or_builtin_name : a path wins over a built-in name.
    overrides : `a.b=value` each, through lists by number or id, value in YAML.
    seed : replaces the file's.
    links : sensor -> the links it gets instead of the file's.

    Raises
    ------
    ScenarioError : one line a fault, all of them.
    """
    path = _path_of(path_or_builtin_name)
    return _judged(
        yaml_lines.parse(yaml_lines.read_text(path, ScenarioError), path, ScenarioError), overrides, seed, links
    )


def loads(text: str, path: Path, overrides: Sequence[str] = ()) -> Scenario:
    """The same from a text, as if it stood in `path`."""
    return _judged(yaml_lines.parse(text, path, ScenarioError), overrides, None, None)


def _judged(
    source: yaml_lines.Source,
    overrides: Sequence[str],
    seed: int | None,
    links: Mapping[str, Sequence[str]] | None,
) -> Scenario:
    if source.data is None:
        raise ScenarioError(f"{source.path}:1: file: empty; want a scenario, beginning with schema: 1")
    source = changes.changed(source, overrides, seed, links)
    told = list(source.faults)
    try:
        scenario = Scenario.model_validate(_frozen(source.data))
    except ValidationError as exc:
        told += fault_lines(source, Scenario, exc)
    told += scenario_checks.faults(source)
    if told:
        raise ScenarioError("\n".join(_in_file_order(told)))
    scenario._source = source
    return scenario


def _in_file_order(told: Sequence[str]) -> list[str]:
    """Faults by line, one for each key: what comes first in `told` explains what follows from it."""
    first: dict[tuple[str, ...], str] = {}
    for text in told:
        first.setdefault(tuple(text.split(": ", 2)[:2]), text)

    def line(text: str) -> tuple[str, int]:
        file, _, number = text.partition(": ")[0].rpartition(":")
        return (file, int(number)) if number.isdecimal() else ("", 0)

    return sorted(first.values(), key=line)


def _frozen(data: Any) -> Any:
    """Lists as tuples, which the strict models take."""
    if isinstance(data, dict):
        return {key: _frozen(value) for key, value in data.items()}
    return tuple(_frozen(value) for value in data) if isinstance(data, list) else data


# ---------------------------------------------------------------- telling


def dump(scenario: Scenario) -> str:
    """The scenario as YAML with every default filled in; meshes by absolute path, so that it can lie anywhere."""
    data = scenario.model_dump(mode="json", by_alias=True, exclude_none=True)
    for item, entry in zip(scenario.world, data["world"], strict=True):
        _told_shape(scenario, item, entry)
    for actor, entry in zip(scenario.actors, data["actors"], strict=True):
        if actor.shape is not None:
            _told_shape(scenario, actor.shape, entry["shape"])
        motion = entry["motion"]
        kept = {"waypoints", "loop"} if actor.motion.waypoints else set(motion) - {"waypoints", "loop"}
        entry["motion"] = {key: value for key, value in motion.items() if key in kept}
    for change, entry in zip(scenario.weather.changes, data["weather"].get("changes", ()), strict=True):
        for key in set(entry) - change.model_fields_set:
            del entry[key]  # what a change does not name goes on
        entry.update({key: None for key in change.model_fields_set if getattr(change, key) is None})
    yaml = YAML(typ="safe", pure=True)
    yaml.default_flow_style = None
    yaml.sort_base_mapping_type_on_output = False  # type: ignore[assignment]
    yaml.width = 120
    out = io.StringIO()
    yaml.dump(data, out)
    return out.getvalue()


def _told_shape(scenario: Scenario, shape: Shape, entry: dict[str, Any]) -> None:
    if shape.mesh is None:
        entry.pop("scale", None)
    elif not shape.mesh.startswith(scenario_checks.BUILTIN):
        path = scenario.resolve(shape.mesh).resolve()
        own = scenario_checks.mesh_path(scenario_checks.BUILTIN + path.name, Path())
        entry["mesh"] = scenario_checks.BUILTIN + path.name if path == own.resolve() else str(path)


def json_schema() -> dict[str, Any]:
    """JSON Schema (2020-12) of a scenario file, for editors; references between tables are checked by `load` alone."""
    schema = Scenario.model_json_schema(by_alias=True)
    schema["title"] = "lidaremu scenario"
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **schema}


def write_schema(path: Path) -> None:
    """Write the published schema: after a change of a model."""
    path.write_text(json.dumps(json_schema(), indent=1) + "\n", encoding="utf-8")
