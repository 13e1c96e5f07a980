"""The base paper's figure 6: how many points an LMS291 and an LD-LRS1000 find on a grey car over distance.

Measured with the package's car mesh through the whole path, mean over the position of the beam grid, beside the closed
form for a plate of the car's width. Belongs here: counting. Not: the closed form (physics.counting).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from emulator.physics import counting, radiometry
from emulator.physics.arrays import Bools, Floats
from emulator.physics.materials import material
from emulator.sensing.model import SensorModel
from emulator.studies import drawing
from emulator.studies.effort import Effort
from emulator.studies.report import Column, Picture, Section, Table, Value, percent
from emulator.studies.stage import TARGET, Stage, Target, plate

if TYPE_CHECKING:
    from matplotlib.axes import Axes

GREY_RHO = material("car_paint_grey").reflectance(905.0)
CAR_MATERIALS = {
    "body": "car_paint_grey",
    "glass": "windscreen",
    "bumper": "bumper_plastic",
    "tyre": "tyre_rubber",
    "plate": "number_plate",
}
REAR_M, MOUNT_M = 2.25, 0.5
"From the mesh's origin to its rear bumper; height of a sensor in another car's bumper."
WITHIN_PERCENT = 10.0
FACING_COSINE = 0.5
"What is turned from the sensor by less than 60 degrees faces it."
NEAR_M = 12.0
"Nearer than this a beam still counts with a hundredth of its power outside the edge: more sub-beams."
NEAR_SUB_BEAMS, SUB_BEAMS = 256, 128
PLATE_HEIGHT_M = 4.0
STEP_M, HALF_VIEW_M = 2e-3, 1.5
"Steps and extent of an outline."


@dataclass(frozen=True)
class Scanner:
    """One of the two sensors of the figure."""

    model: str
    title: str
    step_deg: float
    ranges_m: tuple[float, ...]

    @property
    def step_rad(self) -> float:
        """Between neighbouring beams."""
        return math.radians(self.step_deg)


LMS291 = Scanner(
    "sick-lms291-s05", "SICK LMS291, 0.5 deg", 0.5,
    (4.0, 5.0, 7.5, 10.0, 12.5, 15.0, 20.0, 25.0, 30.0, 35.0, 40.0, 45.0, 50.0, 60.0, 70.0, 80.0),
)  # fmt: skip
LD_LRS = Scanner(
    "sick-ld-lrs1000", "SICK LD-LRS1000, 0.25 deg", 0.25,
    (5.0, 7.5, 10.0, 15.0, 20.0, 30.0, 40.0, 50.0, 65.0, 80.0, 100.0, 120.0, 150.0, 200.0, 240.0),
)  # fmt: skip


@dataclass(frozen=True, eq=False)
class Outline:
    """What a mesh shows the sensor at the height of the scan."""

    cosines: Floats
    "(n,) of the incidence, every `STEP_M` across, 0 beside the mesh."

    @property
    def silhouette_m(self) -> float:
        """All of its width."""
        return STEP_M * int(np.count_nonzero(self.cosines > 0.0))

    @property
    def width_m(self) -> float:
        """Width of what faces the sensor."""
        return STEP_M * int(np.count_nonzero(self.cosines >= FACING_COSINE))

    @property
    def cosine(self) -> float:
        """Mean over `width_m`."""
        return float(self.cosines[self.cosines >= FACING_COSINE].mean())


def grey_car(height_m: float = MOUNT_M, rho: float | None = None) -> Target:
    """The car mesh seen from behind; with `rho` a Lambert surface all over, else of its own materials."""
    shape = {"mesh": "builtin:car.glb"}
    return Target(shape, REAR_M, -height_m, rho=rho, materials={} if rho is not None else CAR_MATERIALS)


def outline(stage: Stage) -> Outline:
    """The target as parallel rays at the sensor's height find it."""
    y = np.arange(-HALF_VIEW_M, HALF_VIEW_M, STEP_M)
    n, zero = len(y), np.zeros(len(y))
    hits = stage.caster.first_hits(np.stack([zero, y, zero], axis=1), np.tile([1.0, 0.0, 0.0], (n, 1)), zero + 50.0)
    return Outline(np.where(hits.actor == TARGET, -hits.normal[:, 0], 0.0))


def stage_of(target: Target, scanner: Scanner, range_m: float, noise: bool = False) -> Stage:
    """The scanner and a target, with the sub-beams that the range asks for."""
    physics: dict[str, object] = {"noise": noise}
    if not noise:
        physics["sub_beams"] = NEAR_SUB_BEAMS if range_m < NEAR_M else SUB_BEAMS
    return Stage(target, scanner.model, physics=physics)


def mean_points(stage: Stage, scanner: Scanner, range_m: float, half_width_m: float, phases: int) -> float:
    """Mean number of points on the target over equally spaced positions of the beam grid."""
    beam = stage.measure.model.beam
    reach = half_width_m + 2.6 * float(np.max(beam.radius_m(np.array([range_m]))))
    count = math.ceil(math.atan2(reach, range_m) / scanner.step_rad) + 1
    grid = np.arange(-count, count + 1)
    shift = (np.arange(phases) + 0.5) / phases
    azimuth = scanner.step_rad * (grid + shift[:, None]).ravel()
    return int(np.count_nonzero(on_target(stage, range_m, azimuth))) / phases


def on_target(stage: Stage, range_m: float, azimuth_rad: Floats) -> Bools:
    """Which beams bring a point on the target."""
    scan = stage.scan(np.full(len(azimuth_rad), range_m), azimuth_rad)
    return np.asarray(np.isfinite(scan.range_m[:, 0]) & (scan.actor[:, 0] == TARGET))


def needed_share(model: SensorModel, extinction_per_m: float, rho: float, range_m: Floats) -> Floats:
    """Share of a beam that must fall on a plate for the threshold, the floor near by included; inf: none is enough."""
    full = radiometry.max_range_extended(model.k_m2, rho, extinction_per_m, model.threshold)
    share = counting.needed_share(range_m, full, extinction_per_m)
    near = model.floor_m2 / (model.k_m2 * rho) * np.exp(2.0 * extinction_per_m * range_m)
    return np.where(range_m > model.gate_m, np.inf, np.maximum(share, near))


def expected_points(
    model: SensorModel, extinction_per_m: float, scanner: Scanner, width_m: float, rho: float, range_m: Floats
) -> Floats:
    """Closed form for a flat plate: a beam counts while the share of it on the plate suffices for the threshold."""
    share = needed_share(model, extinction_per_m, rho, range_m)
    edge = counting.edge_extension(np.asarray(model.beam.radius_m(range_m)[0]), share)
    return np.where(share >= 1.0, 0.0, counting.beams_on_target(width_m, edge, range_m, scanner.step_rad))


def figure_6(effort: Effort) -> Section:
    """Points on a grey car over distance, for both sensors."""
    made, both = drawing.figure(2, size=(12.0, 5.2))
    tables, texts = [], []
    for axes, scanner in zip(both, (LMS291, LD_LRS), strict=True):
        car = outline(stage_of(grey_car(rho=GREY_RHO), scanner, 50.0))
        table = count(scanner, car, effort)
        tables.append(table)
        draw(axes, scanner, car, table)
        texts.append(reported(scanner, table))
    falls = all(bool(np.all(np.diff(table.numbers("mesh_one_grey")) <= 0.0)) for table in tables)
    return Section(
        "Figure 6: points on a grey car",
        (
            f"The car mesh of the package from behind, the sensor {MOUNT_M} m above the road, mean over "
            f"{effort.phases} positions of the beam grid. \"Mesh, one grey\" is the mesh with a Lambert surface of "
            f"the grey paint ({GREY_RHO:.2f}) all over, without noise; \"mesh, own materials\" has coated paint, "
            "dark bumper, glass, tyres and a retroreflecting number plate, and the sensor's noise. The closed form "
            f"is for a plate as wide as what of the mesh faces the sensor (within 60 degrees: {car.width_m:.2f} m of "
            f"{car.silhouette_m:.2f} m) and as bright (mean cosine {car.cosine:.3f}).",
            *texts,
            "Calibrated: each sensor's constant K, by its rated range at 10 %. From memory or chosen: the "
            "divergence of the LD-LRS1000 (uncertain by a factor of 2), the reflectance of grey paint (0.10 to "
            "0.35). What follows is the law of distance, the cut-off and the number of points.",
            "Published data that could not be had: the experiment that the paper compares with (Garcia et al. 2009, "
            "ITS World Congress) was searched for and not found, and the curves of figure 6 are not in the text "
            "that we have. So \"close to the experiment\" cannot be checked here; the printed statement that points "
            f"fall with distance {'holds' if falls else 'does not hold'} in every row of the mesh of one grey.",
        ),
        (
            Picture(
                "figure_6", "Points on a grey car", drawing.png(made),
                "Line: closed form for a plate. Marks: measured through the path. One scan holds a whole number of "
                "points next to the mean.",
            ),
        ),
        tuple(tables),
    )  # fmt: skip


def count(scanner: Scanner, car: Outline, effort: Effort) -> Table:
    """The table of one sensor."""
    rho = GREY_RHO * car.cosine
    rows: list[tuple[Value, ...]] = []
    flat, one_grey = plate(car.width_m, PLATE_HEIGHT_M, rho), grey_car(rho=GREY_RHO)
    own = stage_of(grey_car(), scanner, 0.0, noise=True)
    stages = {near: (stage_of(flat, scanner, near), stage_of(one_grey, scanner, near)) for near in (0.0, NEAR_M)}
    for range_m in scanner.ranges_m[:: effort.every]:
        flat_stage, mesh_stage = stages[0.0 if range_m < NEAR_M else NEAR_M]
        model, alpha = flat_stage.measure.model, flat_stage.extinction_per_m
        formula = float(expected_points(model, alpha, scanner, car.width_m, rho, np.array([range_m]))[0])
        half = 0.5 * car.silhouette_m
        found = [mean_points(stage, scanner, range_m, half, effort.phases) for stage in (flat_stage, mesh_stage, own)]
        off = percent(found[1], formula) if formula > 2.0 else None
        rows.append((range_m, formula, found[0], found[0] - formula, found[1], off, found[2]))
    return Table(
        "figure_6_" + scanner.model.replace("-", "_"),
        f"Mean number of points, {scanner.title}",
        (
            Column("range_m", "distance (m)", ".1f"),
            Column("closed_form", "plate, closed form"),
            Column("plate", "plate, measured"),
            Column("plate_off", "difference (points)", "+.2f"),
            Column("mesh_one_grey", "mesh, one grey"),
            Column("mesh_off_percent", "off closed form (%)", "+.1f"),
            Column("mesh_own_materials", "mesh, own materials"),
        ),
        tuple(rows),
        "Deviations in per cent where the closed form has more than two points.",
    )


def draw(axes: Axes, scanner: Scanner, car: Outline, table: Table) -> None:
    """One panel."""
    model = stage_of(plate(1.0, 1.0, 1.0), scanner, NEAR_M)
    far = scanner.ranges_m[-1]
    line = np.linspace(scanner.ranges_m[0], far, 800)
    rho = GREY_RHO * car.cosine
    formula = expected_points(model.measure.model, model.extinction_per_m, scanner, car.width_m, rho, line)
    drawing.curve(axes, line, np.where(formula > 0.0, formula, np.nan), 0, "plate, closed form")
    at = np.asarray(table.numbers("range_m"))
    for number, (key, title, mark) in enumerate(
        (
            ("plate", "plate", "s"),
            ("mesh_one_grey", "mesh, one grey", "o"),
            ("mesh_own_materials", "mesh, own materials", "^"),
        )
    ):
        found = np.asarray(table.numbers(key))
        drawing.measured(axes, at, np.where(found > 0.05, found, np.nan), number, title, mark)
    axes.set(xscale="log", yscale="log", xlabel="distance (m)", ylabel="mean number of points", title=scanner.title)
    axes.set_ylim(0.4, 120)
    ticks = [tick for tick in (5, 10, 20, 50, 100, 200) if tick <= far]
    axes.set_xticks(ticks, [str(tick) for tick in ticks])
    axes.set_yticks([1, 2, 5, 10, 20, 50, 100], ["1", "2", "5", "10", "20", "50", "100"])
    axes.minorticks_off()
    axes.legend(frameon=False, fontsize=9)


def reported(scanner: Scanner, table: Table) -> str:
    """What the table of one sensor says, in words."""
    enough = [row for row in table.rows if float(row[1] or 0.0) > 2.0]
    plate_off = max(abs(float(row[3] or 0.0)) for row in enough)
    whole = [row for row in enough if abs(float(row[5] or 0.0)) <= WITHIN_PERCENT]
    beyond = [f"{row[0]:g} m ({row[5]:+.1f} %)" for row in enough if row not in whole]
    mesh_off = max(abs(float(row[5] or 0.0)) for row in whole)
    exceptions = ""
    if beyond:
        exceptions = (
            f", but for {' and '.join(beyond)}: near the cut-off a beam must fall on the rear as a whole, and part "
            "of it meets the rounding beside, the slope above or the road clearance below, which a plate does not have"
        )
    return (
        f"{scanner.title}: where more than two points are expected, the plate measured differs from its closed form "
        f"by at most {plate_off:.2f} points. The mesh lies within {mesh_off:.1f} % of the plate{exceptions}."
    )
