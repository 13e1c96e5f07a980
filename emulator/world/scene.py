"""The world of a run: rigid bodies with mesh, materials and motion; their poses and the sensors' at given times.

Belongs here: scenario -> bodies, poses. Not: reading mesh files (mesh_files), casting rays (raycast), what a material
reflects (physics).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property, lru_cache

import numpy as np

from emulator.config.budgets import MESH
from emulator.errors import SceneError
from emulator.physics.foliage import LARGEST_WALK, Foliage
from emulator.physics.materials import Maps, material_from_mapping
from emulator.scenario.checks import BUILTIN
from emulator.scenario.live_options import SpawnShape
from emulator.scenario.scenario import Scenario
from emulator.scenario.tables import Actor, FramesConfig, MotionConfig, Mount, Shape, WorldItem
from emulator.scenario.tables import Box as BoxShape
from emulator.world import mesh_files, mesh_maps, triangles
from emulator.world.coplanar import coplanar_triangles
from emulator.world.fed import Box, Fed, FedNow
from emulator.world.mesh_frames import Frames
from emulator.world.mesh_maps import Wanted
from emulator.world.motion import Floats, Motion, Pose, Steady, Vector, Waypoints
from emulator.world.reading_apart import Reader
from emulator.world.triangles import Geometry, Ints

MOST_TRIANGLES = 20_000_000
"Of all different shapes together, unless one file may have more; 1e7 build in about a minute and 2 GB."
MOST_COPLANAR_REPORTED = 5
"Pairs of bodies that lie on each other; of more only their number."
BOX = Shape(box=BoxShape(size_m=(1.0, 1.0, 1.0)))
"Of an actor that nothing else is known of, scaled to its size."
WORLD = 0
"Index of the actor that everything of the scenario's `world` belongs to."


@dataclass(frozen=True, eq=False)
class Body:
    """One rigid mesh with its materials and its motion."""

    actor: int
    geometry: Geometry
    part_material: Ints
    "(p,) index into `Scene.materials` of each part."
    motion: Motion
    frames: Frames | None = None
    "How its shape changes; `geometry` is then its first frame, in the sphere of all."

    @property
    def still(self) -> bool:
        """Never moves, turns or changes."""
        return self.motion.still and self.frames is None

    @property
    def vertices(self) -> Floats:
        """(v, 3) about the body's own origin; those of the first frame of a shape that changes."""
        return self.geometry.vertices

    @property
    def faces(self) -> Ints:
        """(f, 3)"""
        return self.geometry.faces

    @property
    def face_material(self) -> Ints:
        """(f,) index into `Scene.materials`."""
        return self.part_material[self.geometry.face_part]

    @property
    def centre_m(self) -> Floats:
        """Centre of the bounding sphere about the body's origin."""
        return self.geometry.centre

    @property
    def radius_m(self) -> float:
        """Radius of the bounding sphere."""
        return self.geometry.radius


@dataclass(frozen=True, eq=False)
class Scene:
    """Everything that beams can meet, and where it is at any time."""

    actors: tuple[str, ...]
    "Names; index 0 is `world`, then the scenario's actors in its order."
    classes: tuple[str, ...]
    "Category of each actor, for object lists; `unknown` where the scenario gives none."
    motions: tuple[Motion, ...]
    materials: tuple[str, ...]
    bodies: tuple[Body, ...]
    warnings: tuple[str, ...] = ()
    "What was odd about the meshes, one line each."
    round_s: float | None = None
    "After so long it begins again; None: never. Motions know nothing of it: who asks for a pose asks with `local_s`."
    fed: FedNow | None = None
    "What the present sweep knows of actors that somebody else moves; None: nobody does."
    pool: int = 0
    "So many of the last actors are those that a feed may bring."

    def class_of(self, name: str) -> str:
        """For object lists; of an actor that a feed has brought as the present sweep has it."""
        number = self.index.get(name)
        if number is None:
            return "unknown"
        found = self.classes[number]
        return self.fed.category(name) if self.fed is not None and self.is_of_pool(number) else found

    def is_of_pool(self, actor: int) -> bool:
        """It is none of the scenario's: a place in the pool of a feed."""
        return actor >= len(self.classes) - self.pool

    def local_s(self, t_s: float) -> float:
        """The scene's own time at `t_s` of the run; the first round is the run's time to the last bit."""
        return t_s - 1e-9 * self.turned_ns(round(t_s * 1e9))

    def turned_ns(self, at_ns: int) -> int:
        """What the rounds have taken that are finished at that instant."""
        if self.round_s is None or at_ns < 0:
            return 0
        round_ns = round(self.round_s * 1e9)
        return at_ns // round_ns * round_ns

    @cached_property
    def index(self) -> dict[str, int]:
        """Name of an actor -> its index."""
        return {name: number for number, name in enumerate(self.actors)}

    def pose(self, actor: int, t_s: Floats) -> Pose:
        """Pose of an actor at times (n,)."""
        return self.motions[actor].pose(t_s)

    def velocity(self, actor: int, t_s: Floats) -> Floats:
        """Velocity of an actor's origin in the world at times (n,): (n, 3). [m/s]"""
        return self.motions[actor].velocity(np.atleast_1d(np.asarray(t_s, dtype=np.float64)))

    def sensor_pose(self, mount: Mount, t_s: Floats) -> Pose:
        """Optical centre and axes of a sensor at times (n,)."""
        times = np.atleast_1d(np.asarray(t_s, dtype=np.float64))
        place = _mounted(mount.at_m, mount.yaw_deg, mount.pitch_deg, mount.roll_deg)
        if mount.actor is None:
            return place.pose(times)
        carrier = self.motions[self.index[mount.actor]]
        if isinstance(carrier, Fed) and (one := carrier.straight_at(times)) is not None:
            there = _own(place).after(Pose(np.zeros((1, 3)), one.rotation[None]))
            position = one.position(times) + there.position_m[0]
            return Pose(position, np.broadcast_to(there.rotation[0], (len(times), 3, 3)))
        if carrier.turns:
            return place.pose(times).after(carrier.pose(times))
        offset_m, rotation = _carried(place, carrier)
        return Pose(carrier.position(times) + offset_m, np.broadcast_to(rotation, (len(times), 3, 3)))


@lru_cache(maxsize=64)
def _mounted(at_m: Vector, yaw_deg: float, pitch_deg: float, roll_deg: float) -> Steady:
    """A sensor's place on what carries it."""
    return Steady(at_m, yaw_deg, pitch_deg, roll_deg)


@lru_cache(maxsize=64)
def _own(place: Steady) -> Pose:
    """The same as a pose, at one instant."""
    return place.pose(np.zeros(1))


@lru_cache(maxsize=64)
def _carried(place: Steady, carrier: Motion) -> tuple[Floats, Floats]:
    """Offset (3,) in the world and orientation (3, 3) of what sits there on something that does not turn."""
    pose = place.pose(np.zeros(1)).after(Pose(np.zeros((1, 3)), carrier.pose(np.zeros(1)).rotation))
    return pose.position_m[0].copy(), pose.rotation[0].copy()


def build(scenario: Scenario) -> Scene:
    """Load the meshes of a scenario and place its bodies; `SceneError` with one line a fault."""
    motions: list[Motion] = [Steady()]
    with Reader() as reader:
        builder = _Builder(scenario, reader)
        for number, item in enumerate(scenario.world):
            placed = Steady(item.at_m, item.yaw_deg, item.pitch_deg, item.roll_deg)
            builder.add(WORLD, item, item, placed, f"world.{number}")
        fed = None if scenario.live is None else FedNow(categories=scenario.live.categories)
        for number, actor in enumerate(scenario.actors):
            motions.append(motion_of(actor.motion))
            if actor.shape is not None:
                builder.add(number + 1, actor.shape, actor, motions[-1], f"actors.{number}")
        if fed is not None:
            builder.feed(fed, motions)
    if builder.total > builder.most:
        builder.faults.append(f"{scenario.source}: {builder.total} triangles in all; want at most {builder.most}")
    if builder.faults:
        raise SceneError.of(builder.faults)
    builder.report_coplanar()
    slots = () if scenario.live is None else scenario.live.slots
    return Scene(
        ("world", *(actor.id for actor in scenario.actors), *slots),
        ("unknown", *(actor.class_ for actor in scenario.actors), *("unknown" for _ in slots)),
        tuple(motions),
        tuple(builder.materials),
        tuple(builder.bodies),
        tuple(builder.warnings),
        scenario.round_s,
        fed,
        len(slots),
    )


def motion_of(config: MotionConfig) -> Motion:
    """The motion that a scenario describes."""
    if config.waypoints:
        return Waypoints.through(
            [point.t_s for point in config.waypoints],
            [point.at_m for point in config.waypoints],
            [(point.yaw_deg, point.pitch_deg, point.roll_deg) for point in config.waypoints],
            config.loop,
        )
    return Steady(
        config.at_m, config.yaw_deg, config.pitch_deg, config.roll_deg, config.velocity_m_s, config.yaw_rate_deg_s
    )


class _Builder:
    """Collects bodies; meshes of the same file and primitives of the same size are made once."""

    def __init__(self, scenario: Scenario, reader: Reader) -> None:
        self._scenario, self._reader = scenario, reader
        one = reader.budget.triangles
        self.most = max(MOST_TRIANGLES, one) if one > MESH.triangles else MOST_TRIANGLES
        "Triangles in all; once there are more nothing else is made."
        self.total = 0
        self.made: dict[str, Geometry] = {}
        self.frames: dict[int, Frames] = {}
        self.materials: dict[str, int] = {}
        self.bodies: list[Body] = []
        self.places: list[str] = []
        "Of each body, in the scenario."
        self.faults: list[str] = []
        self.warnings: list[str] = []
        found = {name: material_from_mapping(name, entry) for name, entry in scenario.materials.items()}
        self._leaves: dict[str, Foliage] = {k: one.foliage for k, one in found.items() if one.foliage is not None}
        self._maps: dict[str, Maps] = {k: one.maps for k, one in found.items() if one.maps is not None}

    def add(self, actor: int, shape: Shape, owner: Actor | WorldItem | SpawnShape, motion: Motion, dotted: str) -> None:
        if self.total > self.most:
            return
        below = f"{dotted}.shape" if isinstance(owner, Actor) else dotted
        try:
            where = self._scenario.label(f"{below}.{shape.kind}")
            geometry = self._geometry(shape, where, self._wanted(owner) if self._maps else None)
            names = self._part_materials(geometry, owner, dotted)
            self._check_leaves(geometry, names, where)
            self._check_maps(geometry, names, where)
        except SceneError as error:
            self.faults.extend(error.lines)
            return
        numbers = [self.materials.setdefault(name, len(self.materials)) for name in names]
        frames = self.frames.get(id(geometry))
        self.bodies.append(Body(actor, geometry, np.array(numbers, np.int32), motion, frames))
        self.places.append(dotted)

    def feed(self, now: FedNow, motions: list[Motion]) -> None:
        """Actors that a feed may move, and those that it may bring."""
        live = self._scenario.live
        assert live is not None
        for number, actor in enumerate(self._scenario.actors):
            if live.actors.fed is not None and actor.id not in live.actors.fed:
                continue
            mine = [place for place, body in enumerate(self.bodies) if body.actor == number + 1]
            vertices = [self.bodies[place].vertices for place in mine if len(self.bodies[place].vertices)]
            box = Box.around(np.concatenate(vertices)) if vertices else None
            own = motions[number + 1]
            motions[number + 1] = Fed(now, actor.id, own, box, mount=live.mount)
            for place in mine:
                self.bodies[place] = replace(self.bodies[place], motion=Fed(now, actor.id, own, box))
        shapes: dict[str, tuple[Shape, SpawnShape, str]] = {}
        for name, entry in live.actors.classes.items() if live.slots else ():
            shape = entry.shape() or BOX
            owner = (
                entry if entry.material or entry.mesh else entry.model_copy(update={"material": live.actors.material})
            )
            shapes[name] = shape, owner, f"live.actors.classes.{name}"
        if live.slots and live.actors.unknown == "box":
            shapes["box"] = BOX, SpawnShape(material=live.actors.material), "live.actors"
        for number, slot in enumerate(live.slots):
            motions.append(Fed(now, slot, None, None, mount=live.mount))
            for name, (shape, owner, dotted) in shapes.items():
                before = len(self.bodies)
                self.add(len(self._scenario.actors) + 1 + number, shape, owner, Steady(), dotted)
                for place in range(before, len(self.bodies)):
                    body = self.bodies[place]
                    motion = Fed(now, slot, None, Box.around(body.vertices), shape=name)
                    self.bodies[place] = replace(body, motion=motion)
            if self.faults:
                return  # the others would be reported the same

    def report_coplanar(self) -> None:
        """Warn of resting bodies that lie on each other with other materials."""
        found = sorted(coplanar_triangles(self.bodies).items())
        for (one, two), count in found[:MOST_COPLANAR_REPORTED]:
            where, other = (self._scenario.label(self.places[body]) for body in (two, one))
            self.warnings.append(
                f"{where}: {count} triangles lie on those of {other.rpartition(': ')[2]}, of another material; which"
                " is seen is arbitrary"
            )
        if len(found) > MOST_COPLANAR_REPORTED:
            rest = len(found) - MOST_COPLANAR_REPORTED
            self.warnings.append(f"{self._scenario.source}: {rest} more pairs of bodies have coplanar triangles")

    def _wanted(self, owner: Actor | WorldItem | SpawnShape) -> Wanted | None:
        """Parts whose material looks at their colours or normals."""
        mapped = {part for part, name in owner.materials.items() if name in self._maps}
        if owner.material in self._maps:
            return Wanted(True, tuple(part for part in owner.materials if part not in mapped))
        if owner.material is None:
            mapped |= {name for name in self._maps if name not in owner.materials}
        return Wanted(False, tuple(sorted(mapped))) if mapped else None

    def _check_maps(self, geometry: Geometry, names: list[str], where: str) -> None:
        for part, name in enumerate(names):
            maps = self._maps.get(name)
            if maps is None:
                continue
            if id(geometry) in self.frames:
                raise SceneError(f"{where}: {name} has maps; want a material without them on a shape of frames")
            mine = geometry.faces[geometry.face_part == part]
            normals, colours = maps.normals, maps.reflectance is not None
            reported = mesh_maps.check(
                geometry.maps, part, geometry.parts[part], mine.astype(np.int64), colours, normals
            )
            if reported:
                raise SceneError(f"{where}: part {reported}")

    def _geometry(self, shape: Shape, where: str, wanted: Wanted | None) -> Geometry:
        key = shape.model_dump_json(include={"mesh", "plane", "box", "cylinder", "sphere", "frames", "up", "scale"})
        if wanted is not None and shape.mesh is not None:
            key += repr(wanted)
        if key not in self.made:
            self.made[key] = geometry = self._make(shape, where, wanted)
            frames = self.frames.get(id(geometry))
            self.total += len(geometry.faces) * (1 if frames is None else len(frames.vertices))
            if geometry.dropped:
                self.warnings.append(f"{where}: {geometry.dropped} triangles of zero area omitted")
            if geometry.coplanar:
                self.warnings.append(
                    f"{where}: {geometry.coplanar} triangles lie on one of another part; which one is hit is arbitrary"
                )
        return self.made[key]

    def _make(self, shape: Shape, where: str, wanted: Wanted | None) -> Geometry:
        if shape.mesh is not None:
            return self._load(shape.mesh, shape, where, wanted)
        if shape.frames is not None:
            return self._make_frames(shape, shape.frames, where)
        if shape.plane is not None:
            return triangles.plane(*shape.plane.size_m)
        if shape.box is not None:
            return triangles.box(*shape.box.size_m)
        if shape.cylinder is not None:
            return triangles.cylinder(shape.cylinder.radius_m, shape.cylinder.height_m, shape.cylinder.segments)
        assert shape.sphere is not None
        return triangles.sphere(shape.sphere.radius_m, shape.sphere.segments)

    def _load(self, name: str, shape: Shape, where: str, wanted: Wanted | None = None) -> Geometry:
        """A mesh of the package is read here, any other file in a process of its own."""
        path = self._scenario.resolve(name)
        if name.startswith(BUILTIN):
            return mesh_files.load(path, shape.up, shape.scale, where, wanted=wanted)
        return self._reader.read(path, shape.up, shape.scale, where, wanted)

    def _make_frames(self, shape: Shape, config: FramesConfig, where: str) -> Geometry:
        """The first frame with the sphere of all; every other one must be the same mesh with its vertices moved."""
        made: list[Geometry] = []
        loaded: dict[str, Geometry] = {}
        for number, name in enumerate(config.meshes):
            if name not in loaded:
                loaded[name] = self._load(name, shape, f"{where}.meshes.{number}")
            one = loaded[name]
            many = self.total + (number + 1) * len(one.faces)
            if many > self.most:
                raise SceneError(f"{where}.meshes.{number}: {many} triangles in all; want at most {self.most}")
            first = made[0] if made else one
            reported = f"{where}.meshes.{number}: {name}"
            if len(one.vertices) != len(first.vertices) or len(one.faces) != len(first.faces):
                found = f"{len(one.faces)} triangles on {len(one.vertices)} vertices"
                want = f"{len(first.faces)} on {len(first.vertices)} as in the first frame"
                raise SceneError(f"{reported}: {found}; want {want}")
            if not np.array_equal(one.faces, first.faces) or not np.array_equal(one.face_part, first.face_part):
                raise SceneError(f"{reported}: other triangles; want those of the first frame, only vertices moved")
            if one.parts != first.parts and len(first.parts) > 1:  # a mesh of one part may bear its file's name
                raise SceneError(f"{reported}: parts {', '.join(one.parts)}; want {', '.join(first.parts)}")
            made.append(one)
        first = made[0]
        frames = Frames(
            np.stack([one.vertices for one in made]), first.faces, config.period_s, config.at_s, config.loop
        )
        low, high = frames.box
        centre = low + (high - low) / 2.0
        away = frames.vertices[:, np.unique(first.faces)] - centre
        radius = float(np.sqrt((away * away).sum(axis=2).max()))
        geometry = replace(first, centre=centre, radius=radius)
        self.frames[id(geometry)] = frames
        return geometry

    def _check_leaves(self, geometry: Geometry, names: list[str], where: str) -> None:
        """Leaves fill a body: it is closed, and not so large that a ray passes cells without end."""
        for part, name in enumerate(names):
            leaves = self._leaves.get(name)
            if leaves is None:
                continue
            mine = geometry.face_part == part
            if len(mine) and not geometry.closed[mine].all():
                reported = (
                    f"{int((mine & ~geometry.closed).sum())} of {int(mine.sum())} triangles of {geometry.parts[part]}"
                )
                raise SceneError(f"{where}: {reported} enclose nothing for the leaves of {name}; want a closed body")
            cells = 2.0 * geometry.radius / leaves.cell_m
            if cells > LARGEST_WALK:
                least = 2.0 * geometry.radius / LARGEST_WALK / leaves.cell_m * leaves.leaf_size_m
                raise SceneError(
                    f"{where}: {cells:.3g} leaves of {name} beside each other; want foliage.leaf_size_m of at least"
                    f" {least:.2g} m, or a smaller body"
                )

    def _part_materials(self, geometry: Geometry, owner: Actor | WorldItem | SpawnShape, dotted: str) -> list[str]:
        """Material of each part: its own entry, else `material`, else a part that bears a material's name."""
        allowed = ", ".join(geometry.parts)
        for part in owner.materials:
            if part not in geometry.parts:
                where = self._scenario.label(f"{dotted}.materials.{part}")
                raise SceneError(f"{where}: no such part; want one of {allowed}")
        known = self._scenario.known_materials
        names = [
            owner.materials.get(part, owner.material or (part if part in known else None)) for part in geometry.parts
        ]
        missing = [part for part, name in zip(geometry.parts, names, strict=True) if name is None]
        if missing:
            where = self._scenario.label(dotted)
            raise SceneError(f"{where}: no material for {', '.join(missing)}; want `material` or `materials` for them")
        return [name for name in names if name is not None]
