"""Facts of a run: a YAML file -> a frozen `Scenario`, every fault told as `file:line: key: found; want allowed`.

Belongs here: the models of the file, and loading it. Not: meshes (scene), facts of a sensor model (spec), a device's
own settings (its family checks them), what a weather means (weather).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from importlib.resources import files
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, PrivateAttr, ValidationError, model_validator

from emulator.errors import ScenarioError
from emulator.yaml_source import Source, fault_lines, read

Vector = tuple[float, float, float]
Positive = Annotated[float, Field(gt=0.0)]
Id = Annotated[str, Field(pattern=r"^[A-Za-z_][A-Za-z0-9_-]*$")]


class _Table(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False, validate_by_name=False)


class Box(_Table):
    """A closed box; its origin is the centre of its base."""

    size_m: tuple[Positive, Positive, Positive]


class Cylinder(_Table):
    """A closed upright cylinder; its origin is the centre of its base."""

    radius_m: Positive
    height_m: Positive
    segments: Annotated[int, Field(ge=3, le=4096)] = 64


class Sphere(_Table):
    """A closed sphere standing on its origin."""

    radius_m: Positive
    segments: Annotated[int, Field(ge=4, le=2048)] = 64


class Plane(_Table):
    """A rectangle centred on its origin, normal +z, seen from both sides."""

    size_m: tuple[Positive, Positive]


class Shape(_Table):
    """Exactly one of a mesh file and the primitives."""

    mesh: str | None = None
    plane: Plane | None = None
    box: Box | None = None
    cylinder: Cylinder | None = None
    sphere: Sphere | None = None
    up: Literal["y", "z"] | None = None
    scale: Positive = 1.0

    @model_validator(mode="after")
    def _one_kind(self) -> Shape:
        kinds = ("mesh", "plane", "box", "cylinder", "sphere")
        given = [kind for kind in kinds if getattr(self, kind) is not None]
        if len(given) != 1:
            raise ValueError(f"{' and '.join(given) or 'no shape'}; want exactly one of {', '.join(kinds)}")
        return self

    @property
    def kind(self) -> str:
        """`mesh`, `plane`, `box`, `cylinder` or `sphere`."""
        return next(kind for kind in ("mesh", "plane", "box", "cylinder", "sphere") if getattr(self, kind) is not None)


class WorldItem(Shape):
    """A piece of the world that never moves."""

    at_m: Vector = (0.0, 0.0, 0.0)
    yaw_deg: float = 0.0
    pitch_deg: float = 0.0
    roll_deg: float = 0.0
    material: str | None = None
    materials: dict[str, str] = Field(default_factory=dict)


class Waypoint(_Table):
    """Where something is at a time."""

    t_s: float
    at_m: Vector
    yaw_deg: float = 0.0
    pitch_deg: float = 0.0
    roll_deg: float = 0.0


class MotionConfig(_Table):
    """Either a start with constant velocity, or waypoints."""

    at_m: Vector = (0.0, 0.0, 0.0)
    yaw_deg: float = 0.0
    pitch_deg: float = 0.0
    roll_deg: float = 0.0
    velocity_m_s: Vector = (0.0, 0.0, 0.0)
    yaw_rate_deg_s: float = 0.0
    waypoints: tuple[Waypoint, ...] = ()
    loop: bool = False


Category = Literal["car", "truck", "motorcycle", "bicycle", "pedestrian", "wide", "point", "unknown"]


class Actor(_Table):
    """Something that can move and that sensors can be mounted on."""

    id: Id
    shape: Shape | None = None
    material: str | None = None
    materials: dict[str, str] = Field(default_factory=dict)
    class_: Category = Field(default="unknown", alias="class")
    motion: MotionConfig = MotionConfig()


class Mount(_Table):
    """Where a sensor's optical centre is, on an actor or in the world."""

    actor: str | None = None
    at_m: Vector = (0.0, 0.0, 0.0)
    yaw_deg: float = 0.0
    pitch_deg: float = 0.0
    roll_deg: float = 0.0


class SensorConfig(_Table):
    """One emulated sensor."""

    id: Id
    model: str
    mount: Mount = Mount()
    device: dict[str, Any] = Field(default_factory=dict)
    mode: Literal["operational", "seed"] = "operational"
    links: tuple[str, ...] = ()
    from_: tuple[str, ...] = Field(default=(), alias="from")


class Scenario(_Table):
    """Everything that a run is made of."""

    schema_: Literal[1] = Field(alias="schema")
    seed: Annotated[int, Field(ge=0, lt=2**63)] = 0
    duration_s: Positive | None = None
    world: tuple[WorldItem, ...] = ()
    actors: tuple[Actor, ...] = ()
    weather: Any = None
    materials: dict[str, dict[str, Any]] = Field(default_factory=dict)
    sensors: tuple[SensorConfig, ...] = ()
    faults: tuple[dict[str, Any], ...] = ()
    expect: tuple[dict[str, Any], ...] = ()
    record: dict[str, bool] = Field(default_factory=dict)

    _source: Source = PrivateAttr()

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
        return frozenset(self.materials)

    def resolve(self, name: str) -> Path:
        """A path of the file: relative ones start at its folder."""
        return self.folder / name

    def label(self, dotted: str) -> str:
        """`file:line: dotted.key`, the beginning of a message about that key."""
        loc = tuple(int(part) if part.isdigit() else part for part in dotted.split("."))
        return f"{self._source.place(loc)}: {dotted}"

    def fault(self, dotted: str, found: object, allowed: str) -> ScenarioError:
        """An error that names file, line and key."""
        loc = tuple(int(part) if part.isdigit() else part for part in dotted.split("."))
        return ScenarioError(f"{self._source.place(loc)}: {dotted}: {found!r}; want {allowed}")


def builtin_names() -> list[str]:
    """Names of the scenarios that come with the package."""
    return sorted(entry.name[:-5] for entry in files("scenarios").iterdir() if entry.name.endswith(".yaml"))


def load(
    path_or_builtin_name: str,
    overrides: Sequence[str] = (),
    seed: int | None = None,
    links: Mapping[str, Sequence[str]] | None = None,
) -> Scenario:
    """Load a scenario from a path or a built-in name."""
    path = Path(path_or_builtin_name)
    if path_or_builtin_name in builtin_names() and not path.is_file():
        path = Path(str(files("scenarios") / f"{path_or_builtin_name}.yaml"))
    source = read(path, ScenarioError)
    try:
        scenario = Scenario.model_validate(_frozen(source.data))
    except ValidationError as exc:
        raise ScenarioError("\n".join(fault_lines(source, Scenario, exc))) from None
    scenario._source = source
    return scenario


def _frozen(data: Any) -> Any:
    if isinstance(data, dict):
        return {key: _frozen(value) for key, value in data.items()}
    if isinstance(data, list):
        return tuple(_frozen(value) for value in data)
    return data
