"""Tables of a scenario file that make its world: shapes, what carries them, how they move, where a sensor is mounted.

Belongs here: models of these tables and what a number in them may be. Not: the file as a whole (scenario), references
between tables (checks), meshes (scene).
"""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BeforeValidator, Field, model_validator

from emulator.config.tables import MOST_M, Coordinate, DescribedTable

MOST_FRAMES = 1000
MOST_WAYPOINTS = 100_000
LEAST_M = 1e-9
"Of a length: smaller things than a wavelength do not reflect as surfaces."
MOST_M_S = 1e5
"Of an actor: the motion during the light's way there and back, 0.17 m at this speed and 250 m, is left out."


def long_as(count: int) -> BeforeValidator:
    """Reports a list of another length in one line instead of one a missing number."""

    def check(value: Any) -> Any:
        if isinstance(value, tuple) and len(value) != count:
            raise ValueError(f"{len(value)} values; want a list of {count} numbers")
        return value

    return BeforeValidator(check)


def _not_tiny(length_m: float) -> float:
    if length_m < LEAST_M:
        raise ValueError(f"{length_m}; want a number >= {LEAST_M}")
    return length_m


Length = Annotated[float, Field(gt=0.0, le=MOST_M), AfterValidator(_not_tiny)]
Speed = Annotated[float, Field(ge=-MOST_M_S, le=MOST_M_S)]
Angle = Annotated[float, Field(ge=-1e6, le=1e6)]
Vector = Annotated[tuple[Coordinate, Coordinate, Coordinate], long_as(3)]
Velocity = Annotated[tuple[Speed, Speed, Speed], long_as(3)]
Id = Annotated[str, Field(pattern=r"^[A-Za-z_][A-Za-z0-9_-]{0,63}$")]

SHAPES = ("mesh", "frames", "plane", "box", "cylinder", "sphere")


class Plane(DescribedTable):
    """A rectangle centred on its origin, normal +z, seen from both sides."""

    size_m: Annotated[tuple[Length, Length], long_as(2)]
    "Along x, along y."


class Box(DescribedTable):
    """A closed box; its origin is the centre of its base."""

    size_m: Annotated[tuple[Length, Length, Length], long_as(3)]
    "Along x, y, z."


class Cylinder(DescribedTable):
    """A closed upright cylinder; its origin is the centre of its base."""

    radius_m: Length
    height_m: Length
    segments: Annotated[int, Field(ge=3, le=4096)] = 64
    "Flat faces around; their edges lie on the circle."


class Sphere(DescribedTable):
    """A closed sphere that stands on its origin."""

    radius_m: Length
    segments: Annotated[int, Field(ge=4, le=2048)] = 64
    "Meridians; half as many rings. The corners lie on the sphere."


class FramesConfig(DescribedTable):
    """A mesh that changes its shape: a file a frame, the same triangles in each, vertices in straight lines between."""

    meshes: Annotated[tuple[str, ...], Field(min_length=2, max_length=MOST_FRAMES)]
    "Files as for `mesh`, in their order; one may come several times."
    period_s: Annotated[float, Field(ge=1e-3, le=1e6)]
    "With `loop` from the first frame until it comes again; else from the first to the last."
    at_s: Annotated[float, Field(ge=-1e9, le=1e9)] = 0.0
    "When the first frame is seen."
    loop: bool = True
    "After the last frame the first again. false: the first until `at_s`, the last for ever."


class Shape(DescribedTable):
    """Exactly one of a mesh file, frames of a mesh, and the primitives."""

    mesh: str | None = None
    "GLB, glTF, OBJ, PLY or STL; relative to this file, or `builtin:NAME`."
    frames: FramesConfig | None = None
    "A mesh that changes its shape."
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
        if self.mesh is None and self.frames is None and self.model_fields_set & {"up", "scale"}:
            raise ValueError(f"{given[0]} with up or scale; want these for mesh or frames only")
        return self

    @property
    def kind(self) -> str:
        """`mesh`, `frames`, `plane`, `box`, `cylinder` or `sphere`."""
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


class Waypoint(DescribedTable):
    """Where something is at a time."""

    t_s: Annotated[float, Field(ge=-1e9, le=1e9)]
    at_m: Vector
    yaw_deg: Angle = 0.0
    pitch_deg: Angle = 0.0
    roll_deg: Angle = 0.0


class MotionConfig(DescribedTable):
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


class Actor(DescribedTable):
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


class Mount(DescribedTable):
    """Where a sensor's optical centre is, on an actor or in the world."""

    actor: str | None = None
    "None: the world."
    at_m: Vector = (0.0, 0.0, 0.0)
    yaw_deg: Angle = 0.0
    pitch_deg: Angle = 0.0
    roll_deg: Angle = 0.0
