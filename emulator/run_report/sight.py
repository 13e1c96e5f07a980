"""The picture that a run's report begins with: the recorded scene, and in it the points of one sweep of each sensor.

Belongs here: which sweeps, the camera, light and dots. Not: the page's own 3D scene (view), figures (figures).

The scene is cast as by a camera above and behind the first sensor; points are where the sensors measured them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from emulator.recording.layout import RecordedScan
from emulator.run_report.truth import Truth
from emulator.scenario.scenario import Scenario
from emulator.studies import drawing
from protocols.scan import Floats, Ints

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

WIDE, HIGH = 9.6, 4.4
"Of the picture. [inches, as figures are]"
HALF_VIEW = math.tan(math.radians(29.0))
LIGHT = np.array([-0.42, 0.35, 0.84])
SKY = np.array([[26, 40, 54], [13, 19, 26]], np.float64) / 255.0
"At the horizon and above."
WORLD, WEATHER = np.array([0.36, 0.41, 0.46]), np.array([1.0, 1.0, 1.0])
ACTORS = np.array(
    [[239, 120, 100], [86, 160, 235], [240, 190, 70], [110, 190, 120], [186, 120, 205], [60, 195, 210]], np.float64
) / 255.0  # fmt: skip
DOTS = np.array([[77, 230, 190], [255, 202, 40], [120, 190, 255], [255, 138, 150]], np.float64) / 255.0
"Of the points of each sensor in turn."
NEAR_M, FAR_M = 6.0, 22.0
"Between which the camera's distance follows the points."


@dataclass
class Sight:
    """The sweeps that show most: of the first sensor with beams that with the most echoes of actors, and of the others
    what was newest then."""

    lead: str = ""
    shown: dict[str, tuple[RecordedScan, Floats | None]] = field(default_factory=dict)
    _newest: dict[str, tuple[RecordedScan, Floats | None]] = field(default_factory=dict)
    _best: tuple[int, int] = (-1, -1)

    def add(self, sensor: str, scan: RecordedScan, offsets_s: Floats | None) -> None:
        """One more sweep."""
        if not len(scan.azimuth_rad):
            return
        self.lead = self.lead or sensor
        self._newest[sensor] = scan, offsets_s
        echoes = np.isfinite(scan.range_m)
        score = int(np.count_nonzero(echoes & (scan.actor > 0))), int(np.count_nonzero(echoes))
        if sensor == self.lead and score >= self._best:
            self._best, self.shown = score, dict(self._newest)

    @property
    def at_s(self) -> float:
        """When the first sensor's sweep began."""
        return self.shown[self.lead][0].start_ns * 1e-9


def points_of(truth: Truth, scenario: Scenario, sensor: str, scan: RecordedScan, offsets_s: Floats | None) -> Floats:
    """(e, 3) echoes of a sweep in the world, each beam at its own instant where that is recorded."""
    beam, echo = np.nonzero(np.isfinite(scan.range_m))
    n = len(scan.azimuth_rad)
    fire_s = offsets_s if offsets_s is not None and len(offsets_s) == n else np.zeros(n)
    mount = next(one.mount for one in scenario.sensors if one.id == sensor)
    start_s = truth.scene.local_s(scan.start_ns * 1e-9)
    truth.place(start_s, start_s + float(fire_s.max(initial=0.0)), scan.start_ns * 1e-9 - start_s)
    pose = truth.scene.sensor_pose(mount, start_s + fire_s[beam])
    return np.asarray(pose.to_world(scan.points(beam, scan.range_m[beam, echo])))


def draw(sight: Sight, truth: Truth, scenario: Scenario) -> bytes:
    """The picture as PNG."""
    scene = truth.scene
    known = {one.id: one.mount for one in scenario.sensors}
    t_s = float(scene.local_s(sight.at_s))
    clouds = {name: points_of(truth, scenario, name, *found) for name, found in sight.shown.items() if name in known}
    truth.place(t_s, t_s, sight.at_s - t_s)
    pose = scene.sensor_pose(known[sight.lead], np.array([t_s]))
    here = pose.position_m[0]
    all_points = np.concatenate(list(clouds.values())) if clouds else np.zeros((0, 3))
    reach = np.linalg.norm(all_points - here, axis=1) if len(all_points) else np.array([NEAR_M])
    far_m = float(np.clip(np.median(reach), NEAR_M, FAR_M))
    ahead = pose.rotation[0][:, 0] * (1.0, 1.0, 0.0)
    ahead = ahead / max(1e-6, float(np.linalg.norm(ahead)))
    eye = here - 0.85 * far_m * ahead + np.array([0.0, 0.0, 0.5 * far_m])
    axes = _looking(here + 0.55 * far_m * ahead - eye)
    columns, rows = round(WIDE * drawing.DPI), round(HIGH * drawing.DPI)
    made, axis = _canvas(columns, rows)
    axis.imshow(
        _cast(truth, eye, axes, t_s, columns, rows, far_m), extent=(0, columns, rows, 0), interpolation="bilinear"
    )
    for number, (name, points) in enumerate(clouds.items()):
        x, y, depth = _projected(points[_seen(truth, eye, points, t_s)], eye, axes, columns, rows)
        sizes = np.clip(9.0 * far_m / np.maximum(depth, 1.0), 2.5, 20.0)
        axis.scatter(x, y, s=sizes, color=DOTS[number % len(DOTS)], linewidths=0.0, label=name)
    x, y, _ = _projected(here[None, :], eye, axes, columns, rows)
    axis.scatter(x, y, s=60.0, marker="^", color="white", edgecolors="black", linewidths=0.6)
    if clouds:
        axis.legend(
            loc="lower left", frameon=False, labelcolor="white", fontsize=9, markerscale=2.0, ncols=4, handletextpad=0.2
        )
    return drawing.png(made)


def _canvas(columns: int, rows: int) -> tuple[Figure, Axes]:
    """A figure that one picture fills."""
    from matplotlib.figure import Figure

    made = Figure(figsize=(WIDE, HIGH))
    axis = made.add_axes((0.0, 0.0, 1.0, 1.0))
    axis.set_axis_off()
    axis.set_xlim(0, columns)
    axis.set_ylim(rows, 0)
    return made, axis


def _looking(direction: Floats) -> Floats:
    """Right, up and forward, (3, 3), of a camera that looks that way."""
    forward = direction / np.linalg.norm(direction)
    right = np.cross(forward, (0.0, 0.0, 1.0))
    right = right / max(1e-9, float(np.linalg.norm(right)))
    return np.stack([right, np.cross(right, forward), forward])


def _cast(truth: Truth, eye: Floats, axes: Floats, t_s: float, columns: int, rows: int, far_m: float) -> Floats:
    """(rows, columns, 3) of the scene in daylight that fades into the sky."""
    across = (np.arange(columns) + 0.5 - 0.5 * columns) / (0.5 * columns) * HALF_VIEW
    down = (np.arange(rows) + 0.5 - 0.5 * rows) / (0.5 * columns) * HALF_VIEW
    x, y = np.meshgrid(across, -down)
    direction = x[..., None] * axes[0] + y[..., None] * axes[1] + axes[2]
    direction = (direction / np.linalg.norm(direction, axis=-1, keepdims=True)).reshape(-1, 3)
    hits = truth.first(eye, direction, t_s)
    sky = SKY[0] + (SKY[1] - SKY[0]) * np.clip(direction[:, 2:] * 3.0, 0.0, 1.0)
    light = LIGHT / np.linalg.norm(LIGHT)
    shade = 0.38 + 0.62 * np.clip(hits.normal @ light, 0.0, 1.0)
    coloured = _colours(hits.actor) * shade[:, None]
    range_m = np.nan_to_num(hits.range_m, nan=np.inf)
    fade = np.exp(-np.square(range_m / (9.0 * far_m)))[:, None]
    seen = np.where(hits.actor[:, None] < 0, sky, sky + (coloured - sky) * fade)
    return np.asarray(seen.reshape(rows, columns, 3))


def _colours(actor: Ints) -> Floats:
    return np.where((actor <= 0)[:, None], WORLD, ACTORS[(np.maximum(actor, 1) - 1) % len(ACTORS)])


def _seen(truth: Truth, eye: Floats, points: Floats, t_s: float) -> Ints:
    """Indexes of the points that nothing hides from the camera."""
    if not len(points):
        return np.zeros(0, np.int32)
    away = points - eye
    range_m = np.linalg.norm(away, axis=1)
    hits = truth.first(eye, away / range_m[:, None], t_s)
    nearest = np.nan_to_num(hits.range_m, nan=np.inf)
    return np.flatnonzero(nearest > range_m - 0.3 - 0.01 * range_m).astype(np.int32)


def _projected(points: Floats, eye: Floats, axes: Floats, columns: int, rows: int) -> tuple[Floats, Floats, Floats]:
    """Column, row and distance of points before the camera."""
    own = (points - eye) @ axes.T
    own = own[own[:, 2] > 0.1]
    scale = 0.5 * columns / HALF_VIEW
    return 0.5 * columns + own[:, 0] / own[:, 2] * scale, 0.5 * rows - own[:, 1] / own[:, 2] * scale, own[:, 2]
