"""Facts of a run: a YAML file -> a frozen `Scenario`, every error reported as `file:line: key: found; want allowed`.

Belongs here: the model of the whole file; loading, dumping, the published JSON Schema. Not: the tables of its world
(tables), meshes (scene), facts of a sensor model (spec), a device's own settings (its family checks them), the
weather's table (weather), references between tables (checks).
"""

from __future__ import annotations

import io
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from importlib.resources import files
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import ConfigDict, Field, PrivateAttr, ValidationError
from ruamel.yaml import YAML

from emulator.config import overrides as changes
from emulator.config import yaml_lines
from emulator.config.names import nearest
from emulator.config.tables import DescribedTable, Positive, Table
from emulator.config.yaml_source import fault_lines
from emulator.errors import ScenarioError
from emulator.faults.config import Common
from emulator.scenario import checks
from emulator.scenario.clock_options import ClockOptions
from emulator.scenario.emitters import MOST_EMITTERS, Emitter
from emulator.scenario.live_options import LiveOptions
from emulator.scenario.object_options import ObjectOptions
from emulator.scenario.tables import Actor, Id, Mount, Shape, WorldItem, long_as
from emulator.scenario.vehicle_options import BUILTIN as BUILTIN_DBC
from emulator.scenario.vehicle_options import VehicleBus, dbc_path
from emulator.scenario.weather import WeatherConfig
from emulator.sensors.physics_options import PhysicsOptions
from emulator.sensors.spec import is_file

MOST_ACTORS = 10_000
MOST_SENSORS = 256
MOST_KEPT = 1 << 16
"Characters of an entry whose YAML is kept for the next scenario."


class SensorConfig(DescribedTable):
    """One emulated sensor."""

    id: Id
    model: str
    "See `lidaremu list sensors`; or a spec file of one's own, ending in .yaml, relative to this file."
    mount: Mount = Field(default_factory=Mount)
    device: dict[str, Any] = Field(default_factory=dict)
    "What a real one keeps over power-off; the model's protocol family knows the keys."
    clock: ClockOptions | None = None
    "How wrong its time is, and where its counters begin; None: exact."
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


class Expectation(Table):
    """What must hold at the end of a test run; its other keys depend on `that`."""

    model_config = ConfigDict(extra="allow")

    that: str
    within: Annotated[tuple[float, float], long_as(2)] | None = None


OsiPlace = Annotated[str, Field(pattern=r"^osi-(udp://.+:\d+|trace:.+|mcap:.+\.mcap)$")]


class Record(DescribedTable):
    """What a run keeps."""

    wire: bool = False
    "Bytes both ways."
    truth: bool = False
    "What each echo was."
    foxglove: bool = False
    "Point clouds, laser scans and boxes beside it, for viewers; see docs/live_world.md."
    osi: Annotated[tuple[OsiPlace, ...], Field(max_length=8)] = ()
    "Where OSI SensorData of every scan goes: osi-udp://HOST:PORT, osi-trace:FILE, osi-mcap:FILE."


class Scenario(DescribedTable):
    """Everything that a run is made of."""

    schema_: Literal[1] = Field(alias="schema")
    seed: Annotated[int, Field(ge=0, lt=2**63)] = 0
    "Of every random draw."
    duration_s: Positive | None = None
    "None: until it is stopped."
    loop: bool = False
    "Motion, shapes and weather begin again after every `duration_s`, and `run` goes on until it is stopped."
    world: Annotated[tuple[WorldItem, ...], Field(max_length=MOST_ACTORS)] = ()
    actors: Annotated[tuple[Actor, ...], Field(max_length=MOST_ACTORS)] = ()
    weather: WeatherConfig = Field(default_factory=WeatherConfig)
    materials: dict[str, dict[str, Any]] = Field(default_factory=dict)
    "Materials of this file beside those that come with the package."
    sensors: Annotated[tuple[SensorConfig, ...], Field(max_length=MOST_SENSORS)] = ()
    emitters: Annotated[tuple[Emitter, ...], Field(max_length=MOST_EMITTERS)] = ()
    "Lidars whose pulses the sensors receive, see docs/senses.md."
    faults: Annotated[tuple[Common, ...], Field(max_length=1000)] = ()
    "Injected faults, see docs/faults.md."
    expect: tuple[Expectation, ...] = ()
    live: LiveOptions | None = None
    "Who moves the world while it runs, see docs/live_world.md; None: this file alone."
    vehicle_bus: VehicleBus | None = None
    "The ego's own motion on CAN, see docs/live_world.md; None: it is not sent."
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

    @property
    def round_s(self) -> float | None:
        """After so long the world begins again; None: never."""
        return self.duration_s if self.loop else None

    def resolve(self, mesh: str) -> Path:
        """Where a mesh of this scenario lies."""
        return checks.mesh_path(mesh, self.folder)

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
        raise ScenarioError(f"{name}: no such file or built-in scenario; want {nearest(name, names)}")
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
    return _judged(read_source(path_or_builtin_name), overrides, seed, links)


def examine(
    path_or_builtin_name: str,
    overrides: Sequence[str] = (),
    seed: int | None = None,
    links: Mapping[str, Sequence[str]] | None = None,
) -> tuple[Scenario | None, list[str]]:
    """As `load`, but faults do not end it: the scenario, None when it cannot be read, and a line a fault."""
    return _examined(read_source(path_or_builtin_name), overrides, seed, links)


def loads(text: str, path: Path, overrides: Sequence[str] = ()) -> Scenario:
    """The same from a text, as if it stood in `path`."""
    return _judged(yaml_lines.parse(text, path, ScenarioError), overrides, None, None)


def read_source(path_or_builtin_name: str) -> yaml_lines.Source:
    """The plain data of a file or a built-in name, not judged yet; raises `ScenarioError`."""
    path = _path_of(path_or_builtin_name)
    return yaml_lines.parse(yaml_lines.read_text(path, ScenarioError), path, ScenarioError)


def from_source(source: yaml_lines.Source) -> Scenario:
    """The scenario of plain data, judged as `load` does."""
    return _judged(source, (), None, None)


def _judged(
    source: yaml_lines.Source,
    overrides: Sequence[str],
    seed: int | None,
    links: Mapping[str, Sequence[str]] | None,
) -> Scenario:
    scenario, reported = _examined(source, overrides, seed, links)
    if scenario is None or reported:
        raise ScenarioError.of(reported)
    return scenario


def _examined(
    source: yaml_lines.Source,
    overrides: Sequence[str],
    seed: int | None,
    links: Mapping[str, Sequence[str]] | None,
) -> tuple[Scenario | None, list[str]]:
    if source.data is None:
        raise ScenarioError(f"{source.path}:1: file: empty; want a scenario, beginning with schema: 1")
    source = changes.changed(source, overrides, seed, links)
    _find_models(source)
    reported, scenario = list(source.faults), None
    try:
        scenario = Scenario.model_validate(_frozen(source.data))
        scenario._source = source
    except ValidationError as exc:
        reported += fault_lines(source, Scenario, exc)
    reported += checks.faults(source)
    return scenario, in_file_order(reported)


def _find_models(source: yaml_lines.Source) -> None:
    """Spec files of the scenario's own are known by their absolute paths from here on."""
    sensors = source.data.get("sensors") if isinstance(source.data, dict) else None
    for sensor in sensors if isinstance(sensors, list) else ():
        if isinstance(sensor, dict) and isinstance(sensor.get("model"), str) and is_file(sensor["model"]):
            sensor["model"] = str((source.path.parent / sensor["model"]).absolute())


def in_file_order(reported: Sequence[str]) -> list[str]:
    """Faults by line, one for each key: what comes first in `told` explains what follows from it."""
    first: dict[tuple[str, ...], str] = {}
    for text in reported:
        first.setdefault(tuple(text.split(": ", 2)[:2]), text)

    def line(text: str) -> tuple[str, int]:
        file, _, number = text.partition(": ")[0].rpartition(":")
        return (file, int(number)) if number.isdecimal() and len(number) < 10 else ("", 0)

    return sorted(first.values(), key=line)


def _frozen(data: Any) -> Any:
    """Lists as tuples, which the strict models take."""
    if isinstance(data, dict):
        return {key: _frozen(value) for key, value in data.items()}
    return tuple(_frozen(value) for value in data) if isinstance(data, list) else data


# ---------------------------------------------------------------- messages


def dump(scenario: Scenario) -> str:
    """The scenario as YAML with every default filled in; meshes by absolute path, so that it can lie anywhere."""
    data = scenario.model_dump(mode="json", by_alias=True, exclude_none=True)
    for item, entry in zip(scenario.world, data["world"], strict=True):
        _full_shape(scenario, item, entry)
    for actor, entry in zip(scenario.actors, data["actors"], strict=True):
        if actor.shape is not None:
            _full_shape(scenario, actor.shape, entry["shape"])
        motion = entry["motion"]
        kept = {"waypoints", "loop"} if actor.motion.waypoints else set(motion) - {"waypoints", "loop"}
        entry["motion"] = {key: value for key, value in motion.items() if key in kept}
    if scenario.live is not None:
        place = scenario.live.place
        if place.is_file:
            data["live"]["feed"] = f"{place.kind}:{(scenario.folder / place.path).resolve()}"
        for entry in data["live"]["actors"]["classes"].values():
            if entry.get("mesh"):
                entry["mesh"] = _full_mesh(scenario, entry["mesh"])
    if scenario.vehicle_bus is not None and not scenario.vehicle_bus.dbc.startswith(BUILTIN_DBC):
        data["vehicle_bus"]["dbc"] = str(dbc_path(scenario.vehicle_bus.dbc, scenario.folder).resolve())
    for change, entry in zip(scenario.weather.changes, data["weather"].get("changes", ()), strict=True):
        for key in set(entry) - change.model_fields_set:
            del entry[key]  # what a change does not name goes on
        entry.update({key: None for key in change.model_fields_set if getattr(change, key) is None})
    entries = [_Entry(key, repr(value), value) for key, value in data.items()]
    return "".join([(_written if len(one.text) < MOST_KEPT else _written.__wrapped__)(one) for one in entries])


@dataclass(frozen=True)
class _Entry:
    """A key of a scenario and its value."""

    key: str
    text: str
    value: Any = field(compare=False)


@lru_cache(maxsize=64)
def _written(entry: _Entry) -> str:
    """As YAML. Kept: thousands of scenarios of a campaign differ in one entry or two, and writing takes long."""
    yaml = YAML(typ="safe", pure=True)
    yaml.default_flow_style = None if isinstance(entry.value, dict | list) else False
    yaml.sort_base_mapping_type_on_output = False  # type: ignore[assignment]
    yaml.width = 120
    out = io.StringIO()
    yaml.dump({entry.key: entry.value}, out)
    return out.getvalue()


def _full_shape(scenario: Scenario, shape: Shape, entry: dict[str, Any]) -> None:
    if shape.frames is not None:
        entry["frames"]["meshes"] = [_full_mesh(scenario, mesh) for mesh in shape.frames.meshes]
    elif shape.mesh is not None:
        entry["mesh"] = _full_mesh(scenario, shape.mesh)
    else:
        entry.pop("scale", None)


def _full_mesh(scenario: Scenario, mesh: str) -> str:
    if mesh.startswith(checks.BUILTIN):
        return mesh
    path = scenario.resolve(mesh).resolve()
    own = checks.mesh_path(checks.BUILTIN + path.name, Path())
    return checks.BUILTIN + path.name if path == own.resolve() else str(path)


def json_schema() -> dict[str, Any]:
    """JSON Schema (2020-12) of a scenario file, for editors; references between tables are checked by `load` alone."""
    schema = Scenario.model_json_schema(by_alias=True)
    schema["title"] = "lidaremu scenario"
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **schema}


def write_schema(path: Path) -> None:
    """Write the published schema: after a change of a model."""
    path.write_text(json.dumps(json_schema(), indent=1) + "\n", encoding="utf-8")
