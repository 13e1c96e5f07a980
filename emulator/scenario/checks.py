"""What a scenario's models cannot see alone: names that refer to something, files that must be there.

Belongs here: checks across tables, on the file's plain data, so that they tell their faults beside those of the models
even when these failed. A value of the wrong type is left to the models. Not: meshes' contents (scene).
"""

from __future__ import annotations

import contextlib
import difflib
import math
import os
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from typing import Any

from emulator.config.names import nearest
from emulator.config.yaml_lines import Loc, Source
from emulator.faults.kinds import VEHICLE as VEHICLE_BUS

MESH_SUFFIXES = (".glb", ".gltf", ".obj", ".ply", ".stl")
BUILTIN = "builtin:"
"Before the name of a mesh that comes with the package."

Found = tuple[Loc, str, str]
"Path, what was found, what is wanted."


def faults(source: Source) -> list[str]:
    """One line a fault, in no particular order."""
    if not isinstance(source.data, dict):
        return []
    data = source.data
    checks: tuple[Callable[[dict[str, Any], Path], Iterable[Found]], ...] = (
        _numbers,
        _loop,
        _unique_ids,
        _shapes,
        _material_names,
        _own_materials,
        _motions,
        _mounts,
        _models,
        _links,
        _names_of_actors_and_sensors,
        _live,
        _emitters,
        _vehicle_bus,
        _faults,
    )
    return [source.fault(*found) for check in checks for found in check(data, source.path.parent)]


def mesh_path(name: str, folder: Path) -> Path:
    """Where a mesh lies: `builtin:car.glb` in the package, everything else relative to `folder`."""
    if name.startswith(BUILTIN):
        return Path(str(files("scenarios") / "meshes")) / name[len(BUILTIN) :]
    return folder / name


def builtin_meshes() -> tuple[str, ...]:
    """Names of the meshes that come with the package."""
    folder = files("scenarios") / "meshes"
    return tuple(sorted(entry.name for entry in folder.iterdir() if entry.name.endswith(MESH_SUFFIXES)))


def _loop(data: Mapping[str, Any], folder: Path) -> Iterator[Found]:
    if data.get("loop") is True and data.get("duration_s") is None:
        yield ("loop",), "True", "duration_s beside it: how long a round lasts"


def _tables(data: Mapping[str, Any], key: str) -> Iterator[tuple[Loc, dict[str, Any]]]:
    entries = data.get(key)
    for number, entry in enumerate(entries if isinstance(entries, list) else ()):
        if isinstance(entry, dict):
            yield (key, number), entry


def _table(entry: Mapping[str, Any], key: str) -> dict[str, Any]:
    value = entry.get(key)
    return value if isinstance(value, dict) else {}


def _ids(data: Mapping[str, Any], key: str) -> list[str]:
    return [entry["id"] for _, entry in _tables(data, key) if isinstance(entry.get("id"), str)]


# ---------------------------------------------------------------- the checks


def _numbers(data: dict[str, Any], folder: Path) -> Iterator[Found]:
    """Numbers that are not finite, wherever they are: in tables without a model too."""
    waiting: list[tuple[Loc, Any]] = [((), data)]
    while waiting:
        loc, value = waiting.pop()
        if isinstance(value, dict):
            waiting += [((*loc, key), below) for key, below in value.items()]
        elif isinstance(value, list):
            waiting += [((*loc, number), below) for number, below in enumerate(value)]
        elif isinstance(value, float) and not math.isfinite(value):
            yield loc, str(value), "a finite number"


def _unique_ids(data: dict[str, Any], folder: Path) -> Iterator[Found]:
    for key in ("actors", "sensors", "emitters"):
        seen: dict[str, Loc] = {}
        for loc, entry in _tables(data, key):
            name = entry.get("id")
            if not isinstance(name, str):
                continue
            if key == "actors" and name == "world":
                yield (*loc, "id"), "'world' is reserved for everything that does not move", "another id"
            if name in seen:
                yield (*loc, "id"), f"{name!r} is also the id of number {seen[name][1]}", "unique ids"
            seen.setdefault(name, loc)


def _live(data: dict[str, Any], folder: Path) -> Iterator[Found]:
    """Actors and files that `live:` names."""
    live, known = _table(data, "live"), _ids(data, "actors")
    names: list[tuple[Loc, object]] = [(("live", "ego"), live.get("ego"))]
    names += [(("live", "bind", key), value) for key, value in _table(live, "bind").items()]
    fed = _table(live, "actors").get("fed")
    names += [
        (("live", "actors", "fed", number), one) for number, one in enumerate(fed if isinstance(fed, list) else ())
    ]
    for loc, name in names:
        if isinstance(name, str) and name not in known:
            yield loc, f"no actor {name!r}", nearest(name, known) if known else "an actor of this scenario"
    classes = _table(_table(live, "actors"), "classes")
    for key, entry in classes.items():
        mesh = entry.get("mesh") if isinstance(entry, dict) else None
        if isinstance(mesh, str) and not mesh_path(mesh, folder).is_file():
            yield ("live", "actors", "classes", key, "mesh"), f"no file {mesh!r}", "a mesh file, or builtin:NAME"
    for key, value in _table(_table(live, "actors"), "models").items():
        if isinstance(value, str) and value not in classes:
            yield ("live", "actors", "models", key), repr(value), f"one of classes: {', '.join(classes) or 'none'}"
    feed = live.get("feed")
    kind, _, path = feed.partition(":") if isinstance(feed, str) else ("", "", "")
    if kind == "recording" and path and not (folder / path / "run.mcap").is_file():
        yield ("live", "feed"), f"no recording {path!r}", "a folder with run.mcap, relative to this file"
    if kind in ("osi-trace", "osi-mcap", "json-file") and path and not (folder / path).is_file():
        yield ("live", "feed"), f"no file {path!r}", "a file, relative to this one"


def _shapes(data: dict[str, Any], folder: Path) -> Iterator[Found]:
    places = [(loc, entry) for loc, entry in _tables(data, "world")]
    places += [((*loc, "shape"), _table(entry, "shape")) for loc, entry in _tables(data, "actors")]
    named: list[tuple[Loc, object]] = []
    for loc, shape in places:
        named.append(((*loc, "mesh"), shape.get("mesh")))
        frames = _table(shape, "frames").get("meshes")
        for number, mesh in enumerate(frames if isinstance(frames, list) else []):
            named.append(((*loc, "frames", "meshes", number), mesh))
    for loc, mesh in named:
        if not isinstance(mesh, str):
            continue
        if not mesh.lower().endswith(MESH_SUFFIXES):
            yield loc, repr(mesh), f"a mesh file ending in {', '.join(MESH_SUFFIXES)}"
        elif mesh.startswith(BUILTIN):
            if mesh[len(BUILTIN) :] not in builtin_meshes():
                yield loc, repr(mesh), nearest(mesh, [BUILTIN + name for name in builtin_meshes()])
        elif not _is_file(folder / mesh):
            found = "not a regular file" if os.path.lexists(folder / mesh.partition("\0")[0]) else "no such file"
            yield loc, f"{mesh!r}: {found} in {folder}", "a mesh file"


def _is_file(path: Path) -> bool:
    try:
        return path.is_file()
    except (OSError, ValueError):
        return False


def _material_names(data: dict[str, Any], folder: Path) -> Iterator[Found]:
    from emulator.physics.materials import known_materials

    known = [*_table(data, "materials"), *known_materials()]
    for key in ("world", "actors"):
        for loc, entry in _tables(data, key):
            named = [((*loc, "material"), entry.get("material"))]
            named += [((*loc, "materials", part), name) for part, name in _table(entry, "materials").items()]
            for place, name in named:
                if isinstance(name, str) and name not in known:
                    yield place, repr(name), f"a material: {nearest(name, known)}"
                elif name is not None and key == "actors" and entry.get("shape") is None:
                    yield place, "the actor has no shape that it could cover", "a shape, or no material"


def _own_materials(data: dict[str, Any], folder: Path) -> Iterator[Found]:
    from emulator.physics.materials import MaterialError, material_from_mapping

    for name, entry in _table(data, "materials").items():
        try:
            material_from_mapping(name, entry)
        except MaterialError as error:
            yield tuple(error.key.split(".")), str(error.found), error.allowed


def _motions(data: dict[str, Any], folder: Path) -> Iterator[Found]:
    for loc, actor in _tables(data, "actors"):
        motion = _table(actor, "motion")
        points = motion.get("waypoints")
        if points is None:
            if motion.get("loop") is not None:
                yield (*loc, "motion", "loop"), "without waypoints", "waypoints to loop over"
            continue
        for key in sorted(set(motion) - {"waypoints", "loop"}):
            yield (*loc, "motion", key), "beside waypoints", "either waypoints, or a start with a velocity"
        if not isinstance(points, list):
            continue
        if not points or (motion.get("loop") is True and len(points) < 2):
            yield (*loc, "motion", "waypoints"), f"{len(points)} of them", "at least one, two for a loop"
        before = None
        for number, point in enumerate(points):
            time = point.get("t_s") if isinstance(point, dict) else None
            if isinstance(time, bool) or not isinstance(time, int | float):
                continue
            if before is not None and time <= before:
                yield (*loc, "motion", "waypoints", number, "t_s"), f"{time} after {before}", "rising times"
            before = time


def _nearest_models(name: str, models: Sequence[str]) -> str:
    """The models whose names are most like that one: letters and figures count, or a part of it."""

    def bare(text: str) -> str:
        return "".join(sign for sign in text.lower() if sign.isalnum())

    wanted = bare(name)
    within = [one for one in models if wanted and (wanted in bare(one) or bare(one) in wanted)]
    ranked = sorted(models, key=lambda one: -max(
        difflib.SequenceMatcher(None, wanted, bare(part)).ratio() for part in (one, one.partition("-")[2] or one)
    ))  # fmt: skip
    near = list(dict.fromkeys([*sorted(within, key=ranked.index), *ranked]))[:5]
    return f"{', '.join(near)} or another of the {len(models)} there are"


def _mounts(data: dict[str, Any], folder: Path) -> Iterator[Found]:
    actors = _ids(data, "actors")
    for loc, sensor in (*_tables(data, "sensors"), *_tables(data, "emitters")):
        actor = _table(sensor, "mount").get("actor")
        if isinstance(actor, str) and actor not in actors:
            yield (*loc, "mount", "actor"), repr(actor), f"{nearest(actor, actors)}; leave it out for the world"


def _models(data: dict[str, Any], folder: Path) -> Iterator[Found]:
    from emulator.errors import SpecError
    from emulator.sensors.spec import is_file, list_models, load_spec
    from protocols import families

    names = _ids(data, "sensors")
    models = list_models()
    sees = {}
    for loc, sensor in _tables(data, "sensors"):
        model = sensor.get("model")
        if not isinstance(model, str):
            continue
        if is_file(model):
            if not _is_file(Path(model)):
                yield (*loc, "model"), f"{model!r}: no such file", "a spec file, or the name of a shipped model"
                continue
        elif model not in models:
            yield (*loc, "model"), repr(model), f"{_nearest_models(model, models)}; see `lidaremu list sensors`"
            continue
        try:
            spec = load_spec(model)
        except SpecError as error:
            yield (*loc, "model"), "; ".join(error.lines), "a spec file without faults"
            continue
        sees[str(sensor.get("id"))] = spec.sees
        if spec.family is None and sensor.get("links"):
            yield (*loc, "links"), f"{model} has no wire protocol", "no links"
        if spec.family is not None and spec.family not in families():
            yield (*loc, "model"), f"{model} speaks {spec.family}, which is not installed", nearest("", families())
        sources = sensor.get("from")
        if spec.sees == "beams" and sensor.get("objects"):
            yield (*loc, "objects"), f"{model} lists no objects", "this key left out"
        if spec.sees == "beams" and sources:
            yield (*loc, "from"), f"{model} measures itself", "this key left out"
        elif spec.sees == "objects" and not sources:
            yield (*loc, "from"), "missing", f"the sensors that {model} makes its objects from: {', '.join(names)}"
    for loc, sensor in _tables(data, "sensors"):
        sources, own = sensor.get("from"), sensor.get("id")
        others = [name for name in names if name != own]
        if not isinstance(sources, list) or (isinstance(own, str) and sees.get(own) == "beams"):
            continue
        for number, name in enumerate(sources):
            if isinstance(name, str) and name not in others:
                yield (*loc, "from", number), repr(name), nearest(name, others)
            elif isinstance(name, str) and sees.get(name) == "objects":
                yield (*loc, "from", number), f"{name!r} lists objects itself", "a sensor that measures"


def _links(data: dict[str, Any], folder: Path) -> Iterator[Found]:
    from emulator.transports.schemes import check_url

    taken: list[tuple[_Place, str]] = []
    families = _families(data)
    for loc, sensor in _tables(data, "sensors"):
        links = sensor.get("links")
        for number, url in enumerate(links if isinstance(links, list) else ()):
            if not isinstance(url, str):
                continue
            try:
                check_url(url)
            except ValueError as error:
                found, _, want = str(error).partition("; want ")
                yield (*loc, "links", number), found, want or "a link, see lidaremu list links"
                continue
            except ModuleNotFoundError:
                yield (*loc, "links", number), f"{url!r}: links of this kind are not supported", "another kind"
                continue
            if (wrong := _unspoken(families.get(str(sensor.get("model"))), url)) is not None:
                yield (*loc, "links", number), *wrong
            for place in _places(url):
                holder = next((who for other, who in taken if other.clashes(place)), None)
                if holder is not None:
                    yield (*loc, "links", number), f"{url!r} is also a link of {holder}", "a link used only once"
                    break
            taken += [(place, str(sensor.get("id"))) for place in _places(url)]


def _vehicle_bus(data: dict[str, Any], folder: Path) -> Iterator[Found]:
    from emulator.scenario.vehicle_options import NAME, faults

    yield from faults(data, folder)
    url = _table(data, NAME).get("link")
    if not isinstance(url, str) or url.partition(":")[0] not in CAN_SCHEMES:
        return
    with contextlib.suppress(ValueError, ModuleNotFoundError):
        own = _places(url)
        for _, sensor in _tables(data, "sensors"):
            links = sensor.get("links")
            for other in links if isinstance(links, list) else ():
                clash = isinstance(other, str) and _clash(own, other)
                if clash:
                    found = f"{url!r} is also a link of {sensor.get('id')}"
                    yield (NAME, "link"), found, "the CAN bus of a sensor, or a link used only once"


def _clash(own: Sequence[_Place], url: str) -> bool:
    try:
        return any(one.clashes(place) for one in own for place in _places(url))
    except ValueError:
        return False


CAN_SCHEMES = ("socketcand", "slcan", "can")
EVERY_HOST = ("*", "0.0.0.0", "::", "")


@dataclass(frozen=True)
class _Place:
    """What a link holds of the machine."""

    kind: str
    "path | tcp | udp | text"
    name: str
    "The path; host of a port."
    port: int = 0
    bus: str = ""
    "Sensors on one CAN bus, or on buses of one server, share the place."

    def clashes(self, other: _Place) -> bool:
        if (self.kind, self.port) != (other.kind, other.port) or (self.bus and self.bus == other.bus):
            return False
        same = self.name == other.name
        return same or (self.kind in ("tcp", "udp") and any(one.name in EVERY_HOST for one in (self, other)))


def _places(url: str) -> list[_Place]:
    from emulator.transports.urls import host_and_port, parse_url

    parts = parse_url(url)
    if parts.scheme in ("pty", "slcan", "serial"):
        path = os.path.realpath(os.path.dirname(parts.target) or ".") + "/" + os.path.basename(parts.target)
        path = os.path.realpath(parts.target) if parts.scheme == "serial" else path
        return [_Place("path", path, bus=path if parts.scheme == "slcan" else "")]
    if parts.scheme in ("tcp", "socketcand"):
        host, port = host_and_port(url, parts.target.partition("/")[0])
        bus = f"socketcand {host}:{port}" if parts.scheme == "socketcand" else ""
        return [_Place("tcp", host, port, bus)] if port else []
    if parts.scheme != "udp":
        return []
    listen = parts.options.get("listen")
    if listen is None:
        return [_Place("text", url.partition("?")[0])]
    host, port = host_and_port(url, listen if ":" in listen else f":{listen}")
    return [_Place("text", url.partition("?")[0]), *([_Place("udp", host, port)] if port else [])]


def _unspoken(family: str | None, url: str) -> tuple[str, str] | None:
    """Why a family does not speak on a link, and what it speaks on; None: it does, or that is not known here."""
    from emulator.transports.schemes import LINK_SCHEMES
    from protocols.session import LinkKind
    from protocols.wire import wire_of

    scheme = url.partition(":")[0]
    wire = wire_of(family)
    spoken: tuple[str, ...]
    if wire is not None and wire.on_can_only and scheme not in (*CAN_SCHEMES, "loop"):
        spoken = CAN_SCHEMES
    elif wire is not None and LinkKind.CAN not in wire.links and scheme in CAN_SCHEMES:
        spoken = tuple(one for one in LINK_SCHEMES if one not in (*CAN_SCHEMES, "loop"))
    else:
        return None
    return f"{url!r}: {family} is not spoken on {scheme}", f"a link of {', '.join(spoken)}"


def _families(data: dict[str, Any]) -> dict[str, str]:
    """Model -> family, of the models that can be loaded."""
    from emulator.errors import SpecError
    from emulator.sensors.spec import is_file, list_models, load_spec

    found = {}
    known = list_models()
    for _, sensor in _tables(data, "sensors"):
        model = sensor.get("model")
        if not isinstance(model, str) or not (model in known or (is_file(model) and _is_file(Path(model)))):
            continue
        with contextlib.suppress(SpecError):
            found[model] = load_spec(model).family or ""
    return found


def _names_of_actors_and_sensors(data: dict[str, Any], folder: Path) -> Iterator[Found]:
    sensors, actors = _ids(data, "sensors"), _ids(data, "actors")
    senders = [*sensors, VEHICLE_BUS] if _table(data, VEHICLE_BUS) else sensors
    for loc, fault in _tables(data, "faults"):
        name = fault.get("on")
        if isinstance(name, str) and name not in senders:
            yield (*loc, "on"), repr(name), nearest(name, senders)
    weather = _table(data, "weather")
    yield from names_in_weather(weather, ("weather",), actors)
    for loc, entry in _tables(weather, "changes"):
        yield from names_in_weather(entry, ("weather", *loc), actors)


def names_in_weather(state: Mapping[str, Any], place: Loc, actors: Sequence[str]) -> Iterator[Found]:
    """Actors that a weather's table names and that are not there."""
    behind = _table(state, "spray").get("behind")
    for number, name in enumerate(behind if isinstance(behind, list) else ()):
        if isinstance(name, str) and name not in actors:
            yield (*place, "spray", "behind", number), repr(name), nearest(name, actors)


def _can_load(model: object) -> bool:
    from emulator.errors import SpecError
    from emulator.sensors.spec import load_spec

    try:
        return isinstance(model, str) and bool(load_spec(model))
    except SpecError:
        return False


def _emitters(data: dict[str, Any], folder: Path) -> Iterator[Found]:
    """Sensors and models that emit: only what sees beams sends light."""
    from emulator.errors import SpecError
    from emulator.sensors.spec import list_models, load_spec

    sensors = {entry["id"]: entry for _, entry in _tables(data, "sensors") if isinstance(entry.get("id"), str)}
    for loc, entry in _tables(data, "emitters"):
        for key in ("sensor", "model"):
            name = entry.get(key)
            if not isinstance(name, str):
                continue
            if key == "sensor" and name not in sensors:
                yield (*loc, key), repr(name), nearest(name, list(sensors)) if sensors else "a sensor of this file"
                continue
            if key == "model" and name not in list_models():
                yield (*loc, key), repr(name), f"a shipped model: {nearest(name, list_models())}"
                continue
            model = sensors[name].get("model") if key == "sensor" else name
            try:
                beams = load_spec(model).sees == "beams" if isinstance(model, str) else True
            except SpecError:
                continue  # reported at the sensor
            if not beams:
                yield (*loc, key), f"{name!r} lists objects", "one that sends beams"


def _faults(data: dict[str, Any], folder: Path) -> Iterator[Found]:
    if not data.get("faults"):
        return
    from emulator.faults.reading import problems, target_of
    from emulator.scenario.quantities import check_expression
    from emulator.scenario.vehicle_options import vehicle_target

    sensors, actors = _ids(data, "sensors"), ["world", *_ids(data, "actors")]
    targets = {}
    for _, sensor in _tables(data, "sensors"):
        if _can_load(sensor.get("model")):
            links = sensor.get("links")
            urls = [url for url in links if isinstance(url, str)] if isinstance(links, list) else []
            name = str(sensor.get("id"))
            targets[name] = target_of(name, sensor["model"], urls, _table(sensor, "device"), actors[1:])
    if vehicle := _table(data, VEHICLE_BUS):
        targets[VEHICLE_BUS] = vehicle_target(vehicle, folder)
    for loc, entry in _tables(data, "faults"):
        reported = problems(
            entry, targets.get(str(entry.get("on"))), lambda text: check_expression(text, sensors, actors)
        )
        for key, found, want in reported:
            yield (*loc, *key), found, want
