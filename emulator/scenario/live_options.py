"""The table `live:` of a scenario: who moves the world, and how what comes becomes poses.

Belongs here: its keys and what may be in them. Not: feeds themselves (live), references to actors (checks).
"""

from __future__ import annotations

import ipaddress
import re
from dataclasses import dataclass
from typing import Annotated, Literal

from pydantic import Field, field_validator, model_validator

from emulator.config.tables import DescribedTable
from emulator.scenario.tables import Category, Id, Shape

URL_FEEDS = {"json-udp": 47100, "json-tcp": 47100, "osi-udp": 48198, "osi-tcp": 48199, "lockstep": 47101}
"Feeds from the network -> the port where none is said."
FILE_FEEDS = ("osi-trace", "osi-mcap", "json-file", "recording")
WANT_FEED = (
    "json-udp://HOST:PORT, json-tcp://HOST:PORT, osi-udp://HOST:PORT, osi-tcp://HOST:PORT,"
    " lockstep://HOST:PORT, lockstep:unix:PATH,"
    " osi-trace:FILE, osi-mcap:FILE, json-file:FILE, recording:FOLDER or control"
)
MOST_POOL = 500
MOST_STATICS = 2000
CATEGORIES: dict[str, Category] = {
    "car": "car", "van": "car", "truck": "truck", "bus": "truck", "trailer": "truck", "tram": "truck",
    "train": "truck", "work_machine": "truck", "motorcycle": "motorcycle", "scooter": "motorcycle",
    "bicycle": "bicycle", "micromobility": "bicycle", "pedestrian": "pedestrian", "wheelchair": "pedestrian",
    "wide": "wide", "point": "point",
}  # fmt: skip
"The feeder's classes -> those of object lists; every other one is unknown."


@dataclass(frozen=True)
class FeedPlace:
    """Where a feed comes from."""

    kind: str
    "`json-udp`, `json-tcp`, `osi-udp`, `osi-tcp`, `lockstep`, `osi-trace`, `osi-mcap`, `json-file`, `control`"
    host: str = ""
    port: int = 0
    path: str = ""

    @property
    def is_file(self) -> bool:
        return self.kind in FILE_FEEDS

    @property
    def is_loopback(self) -> bool:
        """Nobody beyond this machine can send to it."""
        return not self.host or self.host == "localhost" or ipaddress.ip_address(self.host).is_loopback


def place_of(feed: str) -> FeedPlace:
    """What a feed's text means; `ValueError` with what is wanted."""
    wrong = ValueError(f"{feed!r}; want {WANT_FEED}")
    if feed == "control":
        return FeedPlace("control")
    kind, colon, rest = feed.partition(":")
    if kind in FILE_FEEDS and rest:
        return FeedPlace(kind, path=rest)
    if kind == "lockstep" and rest.startswith("unix:") and len(rest) > len("unix:"):
        return FeedPlace("lockstep", path=rest[len("unix:") :])
    if kind not in URL_FEEDS or not colon or not rest.startswith("//"):
        raise wrong
    found = re.fullmatch(r"(?:\[(?P<six>[0-9a-fA-F:.]+)\]|(?P<host>[^:/\[\]]+))(?::(?P<port>[0-9]{1,5}))?", rest[2:])
    if found is None:
        raise wrong
    host = found["six"] or found["host"]
    if host != "localhost":
        try:
            ipaddress.ip_address(host)
        except ValueError:
            raise ValueError(f"{feed!r}: {host!r}; want an address, or localhost") from None
    port = int(found["port"]) if found["port"] else URL_FEEDS[kind]
    if port > 65535:
        raise ValueError(f"{feed!r}: port {port}; want 0 to 65535")
    return FeedPlace(kind, host, port)


class SpawnShape(DescribedTable):
    """What an actor of one class looks like that is not in the scenario; scaled to the size that the feeder says."""

    mesh: str | None = None
    "A mesh file, or `builtin:NAME`; None: its box."
    up: Literal["y", "z"] | None = None
    scale: Annotated[float, Field(gt=0.0, le=1e6)] = 1.0
    material: str | None = None
    "Of all parts that `materials` does not name."
    class_: Category | None = Field(default=None, alias="class")
    "For object lists; None: the feeder's class, as far as lists have it."
    materials: dict[str, str] = Field(default_factory=dict)

    @model_validator(mode="after")
    def _of_mesh(self) -> SpawnShape:
        if self.mesh is None and (self.up is not None or self.scale != 1.0 or self.materials):
            raise ValueError("up, scale or materials without a mesh; want them beside mesh")
        return self

    def shape(self) -> Shape | None:
        """As a scenario's own; None: a box."""
        return None if self.mesh is None else Shape(mesh=self.mesh, up=self.up, scale=self.scale)


class LiveActors(DescribedTable):
    """Actors of the feed that are not in the scenario."""

    spawn: bool = False
    "Let them come."
    pool: Annotated[int, Field(ge=1, le=MOST_POOL)] = 32
    "So many of them at once; the others are counted and not there."
    statics: Annotated[int, Field(ge=0, le=MOST_STATICS)] = 0
    "So many stationary ones of the feed stand in the scene, beside the pool; the others are counted and not there."
    classes: dict[str, SpawnShape] = Field(default_factory=dict)
    "The feeder's class -> what it looks like; every other class is a box."
    models: dict[str, str] = Field(default_factory=dict)
    "The feeder's model reference, without folder and ending -> the class whose shape it has."
    unknown: Literal["box", "none"] = "box"
    "Of a class that is not in `classes`: its box, or nothing."
    material: str = "car_paint_grey"
    "Of boxes."
    fed: tuple[Id, ...] | None = None
    "Actors of the scenario that the feed may move; None: all."


class LiveClock(DescribedTable):
    """How the feeder's time becomes the run's."""

    map: Literal["offset", "arrival", "lockstep"] = "offset"
    "offset: by the least delayed samples; arrival: a sample holds when it comes; lockstep: the feeder's time is ours."
    max_offset_s: Annotated[float, Field(ge=1e-3, le=3600.0)] = 0.05
    "Samples further off than this, for half a second, are of a clock that has stepped."
    delay_s: Annotated[float, Field(ge=0.0, le=10.0)] | None = None
    "Poses are used so much later, to be interpolated; None: as nearly all samples need, 2 to 250 ms."


class LiveSilence(DescribedTable):
    """What is done when the feed is silent."""

    after_s: Annotated[float, Field(gt=0.0, le=3600.0)] = 0.5
    "So long after the newest sample; until then actors go on as they moved."
    then: Literal["hold", "stop", "remove"] = "hold"
    "hold: they stay there; stop: the run ends with exit code 3; remove: they are not there."


class LiveOptions(DescribedTable):
    """A world that somebody else moves."""

    feed: str
    "Where poses come from."
    ego: Id | None = None
    "The actor that is the feeder's host vehicle."
    host: str | None = None
    "Id or entity name of the feeder's host vehicle where it is not said: esmini does in its first message alone."
    bind: dict[str, Id] = Field(default_factory=dict)
    "What the feeder calls an actor (its id, `entity:NAME`, `host`) -> its id here; equal ids need nothing."
    actors: LiveActors = Field(default_factory=LiveActors)
    clock: LiveClock = Field(default_factory=LiveClock)
    between: Literal["interpolate", "extrapolate", "hold"] = "interpolate"
    "Poses between two samples."
    silent: LiveSilence = Field(default_factory=LiveSilence)
    latency_s: Annotated[float, Field(ge=0.0, le=10.0)] = 0.0
    "Poses are used so much later, for feeders that send ahead."
    jump_m_s: Annotated[float, Field(gt=0.0, le=1e6)] = 10.0
    "Faster than three times the stated speed and this beside it is a jump, which is not interpolated."
    mount: Literal["rear_axle", "origin"] = "rear_axle"
    "What sensors are mounted by on an actor whose feeder reports its rear axle (OSI does)."
    beyond_loopback: bool = False
    "A feed may be sent from other machines, to the address that `feed` names."

    @field_validator("feed")
    @classmethod
    def _known_feed(cls, feed: str) -> str:
        place_of(feed)
        return feed

    @model_validator(mode="after")
    def _together(self) -> LiveOptions:
        place = self.place
        if not place.is_loopback and not self.beyond_loopback:
            raise ValueError(f"{self.feed!r}; want an address of this machine alone, or beyond_loopback: true")
        if self.clock.map == "lockstep" and place.kind not in ("lockstep", "control", "json-file", "recording"):
            raise ValueError(f"clock.map lockstep with {self.feed!r}; want a feed lockstep://HOST:PORT")
        return self

    @property
    def place(self) -> FeedPlace:
        """Where it comes from."""
        return place_of(self.feed)

    @property
    def categories(self) -> dict[str, Category]:
        """The feeder's classes, those of the scenario among them -> classes of object lists."""
        own = {name: one.class_ for name, one in self.actors.classes.items() if one.class_ is not None}
        return {**CATEGORIES, **own}

    @property
    def slots(self) -> tuple[str, ...]:
        """Names of the actors that others become."""
        return (*self.spawn_slots, *self.static_slots)

    @property
    def spawn_slots(self) -> tuple[str, ...]:
        """Of those, for whatever moves."""
        return tuple(f"live_{number:03d}" for number in range(self.actors.pool)) if self.actors.spawn else ()

    @property
    def static_slots(self) -> tuple[str, ...]:
        """And for what stands."""
        return tuple(f"static_{number:04d}" for number in range(self.actors.statics))

    @property
    def lockstep(self) -> bool:
        """Time moves as far as the feeder says."""
        return self.place.kind == "lockstep"
