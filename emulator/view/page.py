"""What the user sees and presses: scene, echoes and panels in viser, kept up to date from a source.

Belongs here: handles of viser and what pressing them does. Not: how things look in detail (points, solids, drawing),
where they come from (live, recorded).
"""

from __future__ import annotations

import contextlib
import math
import threading
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import viser

from emulator.errors import EmulatorError
from emulator.hosts.describe import Speaker, describe
from emulator.output.sanitizing import html, visible
from emulator.scenario.live_weather import state_of
from emulator.scenario.tables import Mount
from emulator.sensors.spec import load_spec
from emulator.view import air, drawing, points, solids
from emulator.view.controls import Controls
from emulator.view.frames import Floats, Frame, Ints, ShownScan, ShownTelegram, Source
from emulator.view.local_server import PANEL
from emulator.world import scene as scenes
from emulator.world.fed import Fed
from emulator.world.feed_record import Played

FRAME_S = 0.125
"Between two looks at the source."
POINT_M = 0.15
SLOW = 4
"Text is made again every so many looks."
NAME_SHARE = 0.07
"Between the names of sensors one above the other, of the distance from which the page first looks."
NEWEST = "newest"
NO_LINES = np.zeros((1, 2, 3))


class Page:
    """One page on one source; all browsers see the same."""

    def __init__(
        self, server: viser.ViserServer, source: Source, tell: Callable[[str], None] = lambda text: None
    ) -> None:
        """`tell` gets what whoever has started the page should know."""
        self._server = server
        self._tell = tell
        self._ended = ""
        self._source = source
        self._scenario = source.scenario
        self._world = scenes.build(self._scenario)
        self._played: Played | None = getattr(source, "played", None)
        "Who moved the world, of a recording."
        self._mounts = {one.id: one.mount for one in self._scenario.sensors}
        self._models = {one.id: one.model for one in self._scenario.sensors}
        self._speakers = {one.id: speaker_of(one.model, one.device) for one in self._scenario.sensors}
        self._lists = {one.id for one in self._scenario.sensors if one.from_}
        self._recorded = source.length_s is not None
        self._looks = 0
        self._shaped_s = -math.inf
        self._drawn: dict[str, tuple[ShownScan, str, bool, bool]] = {}
        self._said: dict[str, str] = {}
        self._bodies: dict[int, Any] = {}
        self._pieces: dict[int, list[Any]] = {}
        "Meshes of each body."
        self._changing: list[tuple[int, Ints, Any]] = []
        "Body, rows of its vertices, mesh: of bodies that change their shape."
        self._sensors: dict[str, Any] = {}
        self._clouds: dict[str, Any] = {}
        self._lines: dict[str, Any] = {}
        self._boxes: dict[str, Any] = {}
        self._count: dict[str, int] = {}
        self._choice = threading.Lock()
        self._build_panels()  # before the scene: what is made first is there first
        self._build_scene()

    # ------------------------------------------------------------ once

    def _build_scene(self) -> None:
        scene = self._server.scene
        scene.set_up_direction("+z")
        scene.configure_default_lights(enabled=True, cast_shadow=False)
        self._root = scene.add_frame("/world", show_axes=False)
        low, high = np.full(3, np.inf), np.full(3, -np.inf)
        for number, body in enumerate(self._world.bodies):
            actor = self._world.actors[body.actor]
            self._bodies[number] = scene.add_frame(f"/world/scene/{actor}/{number}", show_axes=False)
            if body.motion.may_come:
                continue
            pose = body.motion.pose(np.zeros(1))
            corners = pose.position_m + pose.rotation[0] @ np.zeros(3)
            low, high = np.minimum(low, corners[0] - body.radius_m), np.maximum(high, corners[0] + body.radius_m)
        for piece in solids.pieces(self._world):
            actor = self._world.actors[piece.actor]
            handle = scene.add_mesh_simple(
                f"/world/scene/{actor}/{piece.body}/{piece.name}",
                piece.vertices_m.astype(np.float32),
                piece.faces,
                color=piece.colour,
                opacity=0.35 if piece.see_through else None,
                flat_shading=True,
                side="double",
            )
            self._pieces.setdefault(piece.body, []).append(handle)
            if piece.used is not None and self._world.bodies[piece.body].frames is not None:
                self._changing.append((piece.body, piece.used, handle))
        named: set[int] = set()
        tops: dict[str, float] = {}
        self._names: dict[int, tuple[Any, float]] = {}
        "Body that bears its actor's name -> the name, and its height with nothing beside it."
        for number, body in enumerate(self._world.bodies):
            if body.actor != scenes.WORLD and body.actor not in named:
                named.add(body.actor)
                top = float(body.vertices[:, 2].max()) + 0.3
                actor = self._world.actors[body.actor]
                tops.setdefault(actor, top)
                label = scene.add_label(f"/world/scene/{actor}/{number}/name", actor, position=(0.0, 0.0, top))
                self._names[number] = label, top
        far_m = self._far_m = view_m(low, high)
        empty, black = np.zeros((1, 3), np.float32), np.zeros((1, 3), np.uint8)
        names_m = name_heights(self._mounts, NAME_SHARE * far_m, tops)
        for name in self._mounts:
            self._sensors[name] = scene.add_frame(f"/world/sensors/{name}", axes_length=0.5, axes_radius=0.02)
            scene.add_label(f"/world/sensors/{name}/name", name, position=(0.0, 0.0, names_m[name]))
            self._clouds[name] = scene.add_point_cloud(
                f"/world/echoes/{name}",
                empty,
                black,
                point_size=POINT_M,
                point_shape="circle",
                point_shading="flat",
                precision="float32",
                visible=False,
            )
            self._lines[name] = scene.add_line_segments(
                f"/world/beams/{name}",
                NO_LINES.astype(np.float32),
                (70, 105, 98),
                thickness=1.0,
                thickness_units="screen",
            )
            self._boxes[name] = scene.add_line_segments(
                f"/world/objects/{name}",
                NO_LINES.astype(np.float32),
                (255, 64, 129),
                thickness=2.5,
                thickness_units="screen",
            )
        self._look_from_behind(far_m)
        self._build_air(far_m)

    def _build_air(self, far_m: float) -> None:
        scene = self._server.scene
        self._air: tuple[Any, ...] = ()
        self._sun = scene.add_icosphere(
            "/world/air/sun", radius=0.03 * air.SUN_M, color=(255, 236, 179), flat_shading=True, visible=False,
            cast_shadow=False,
        )  # fmt: skip
        self._rain = scene.add_line_segments(
            "/world/air/rain", NO_LINES.astype(np.float32), (150, 176, 200), thickness=1.2, thickness_units="screen",
            visible=False,
        )  # fmt: skip
        self._snow = scene.add_point_cloud(
            "/world/air/snow", np.zeros((1, 3), np.float32), np.full((1, 3), 235, np.uint8), point_size=0.004 * far_m,
            point_shape="circle", point_shading="flat", precision="float32", visible=False,
        )  # fmt: skip
        mount = next(iter(self._mounts.values()))
        self._middle_m = self._world.sensor_pose(mount, np.zeros(1)).position_m[0] * (1.0, 1.0, 0.0)

    def _draw_air(self, frame: Frame) -> None:
        """Sky, haze, rain and snow; only what has changed is sent."""
        weather = self._weather_at(frame.now_s)
        haze = air.haze_m(weather, self._far_m)
        look = (air.sky(weather), haze)
        if self._air != look:
            self._air = look
            self._server.scene.set_background_image(air.backdrop(weather), format="png")
            near_m, far_m = haze or (1.0, 5000.0)
            self._server.scene.configure_fog(near_m, far_m, color=look[0][0], enabled=haze is not None)
        at = air.sun_m(weather)
        if at is not None and not np.allclose(self._sun.position, at + self._middle_m):
            self._sun.position = at + self._middle_m
        if self._sun.visible != (at is not None):
            self._sun.visible = at is not None
        rain, snow = (fall(weather, frame.now_s, self._far_m) for fall in (air.drops, air.flakes))
        _draw_lines(self._rain, rain + self._middle_m if len(rain) else None)
        if len(snow):
            self._snow.points = (snow + self._middle_m).astype(np.float32)
            self._snow.colors = np.full((len(snow), 3), 235, np.uint8)
        if self._snow.visible != bool(len(snow)):
            self._snow.visible = bool(len(snow))

    def _weather_at(self, now_s: float) -> Mapping[str, Any]:
        """A daemon's as it reports it; of a recording the scenario's, without what was ordered in the run."""
        return state_of(self._scenario.weather, self._world.local_s(now_s)) if self._recorded else self.controls.weather

    def _rides(self, name: str) -> bool:
        """Whether a sensor is on something that moves."""
        actor = self._mounts[name].actor
        return actor is not None and not self._world.motions[self._world.index[actor]].still

    def _look_from_behind(self, far: float) -> None:
        """From behind and above the first sensor."""
        mount = next(iter(self._mounts.values()))
        pose = self._world.sensor_pose(mount, np.zeros(1))
        ahead = pose.rotation[0][:, 0] * (1.0, 1.0, 0.0)
        ahead = ahead / max(1e-6, float(np.linalg.norm(ahead)))
        camera = self._server.initial_camera
        camera.up = (0.0, 0.0, 1.0)
        camera.position = pose.position_m[0] - 0.55 * far * ahead + np.array([0.0, 0.0, 0.6 * far])
        camera.look_at = pose.position_m[0] + 0.7 * far * ahead
        camera.far = 5000.0

    def _build_panels(self) -> None:
        gui = self._server.gui
        gui.configure_theme(dark_mode=True, show_logo=False, show_share_button=False, brand_color=(38, 166, 154))
        gui.set_panel_label(PANEL + visible(self._source.title))
        gui.main_panel.dock_right()
        names = list(self._mounts)
        self._state = gui.add_html("")
        self.controls = Controls(self._server, self._source)
        with gui.add_folder("Show"):
            self._size = gui.add_slider("Point size", 0.02, 0.5, 0.01, POINT_M)
            self._beams = gui.add_checkbox("Beams", True)
            self._objects = gui.add_checkbox("Object boxes", True)
            self._meshes = gui.add_checkbox("Scene", True)
            moves = any(self._rides(name) for name in names)
            self._follow = gui.add_checkbox(
                "Follow the sensor",
                self._rides(names[0]),
                visible=moves,
                hint="Keep the camera fixed relative to the chosen sensor",
            )
        with gui.add_folder("What happened"):
            self._notes = gui.add_html("")
        side = gui.add_panel()
        with side.add_tab("Sensor"):
            self._sensor = gui.add_dropdown("Sensor", names, hint="Sensor of the polar plot and the telegrams")
            self._colouring = gui.add_dropdown("Colour by", points.COLOURINGS)
            self._polar = gui.add_html("")
            self._legend = gui.add_html("")
            self._list = gui.add_html("")
            self._frozen = gui.add_checkbox("Hold", False, hint="Keep these telegrams while time advances")
            self._which: Any = gui.add_dropdown("Telegram", (NEWEST,))
            self._fields = gui.add_html("")
        side.dock_left()
        side.set_width(330)

        @self._meshes.on_update
        def _(_event: Any) -> None:
            for handle in self._bodies.values():
                handle.visible = self._meshes.value

    # ------------------------------------------------------------ again and again

    def run(self, stopped: threading.Event, keeps_waiting: Callable[[], bool] = lambda: True) -> None:
        """Until `stopped`, or `patience` ends."""
        while not stopped.wait(FRAME_S) and keeps_waiting():
            self.look()

    def close(self) -> None:
        """Before the server is stopped: what orders still answer goes nowhere."""
        self.controls.over = True

    def look(self) -> None:
        """One look at the source: what has changed is drawn."""
        frame = self._source.frame()
        if not frame.ended:
            self._ended = ""
        elif not self._ended:
            self._ended = frame.ended
            self._tell(f"{frame.ended}; the page shows the last state")
        with self._server.atomic():
            self._move(frame)
            for name, scan in frame.scans.items():
                self._draw(name, scan)
            for name in set(self._clouds) - set(frame.scans):
                self._clear(name)
            self._draw_air(frame)
            self._say("polar", self._polar, drawing.polar(frame.scans.get(self._sensor.value), self._colouring.value))
            if self._looks % SLOW == 0:
                self._write(frame)
        if self._looks % SLOW == 0:
            self._part_names()
            self.controls.follow(frame)
        self._looks += 1

    def _place(self, begin_s: float, end_s: float) -> None:
        """Fed actors are where they were then, of the scene's own time."""
        if self._played is not None and self._world.fed is not None:
            self._world.fed.use(self._played.world(begin_s, end_s))

    def _move(self, frame: Frame) -> None:
        """Bodies and sensors stand where they stood when the newest scan was measured."""
        newest = max((scan.start_s for scan in frame.scans.values()), default=-math.inf)
        t_s = self._world.local_s(newest if abs(newest - frame.now_s) < 1.0 else frame.now_s)
        times = np.array([t_s])
        self._place(t_s, t_s)
        for number, body in enumerate(self._world.bodies):
            if self._looks == 0 or not body.motion.still:
                pose = body.motion.pose(times)
                self._bodies[number].position = pose.position_m[0]
                self._bodies[number].wxyz = points.quaternion(pose.rotation[0])
            if isinstance(body.motion, Fed) and body.motion.may_come:
                self._bodies[number].visible = body.motion.there
                for piece in self._pieces.get(number, ()):
                    piece.scale = body.motion.scale
        if t_s != self._shaped_s:
            self._shaped_s = t_s
            for number, used, mesh in self._changing:
                frames = self._world.bodies[number].frames
                if frames is not None:
                    mesh.vertices = frames.at(t_s)[used].astype(np.float32)
        chosen = self._mounts[self._sensor.value]
        moved = np.zeros(3)
        if self._follow.value:
            self._place(0.0, t_s)
            pose = self._world.sensor_pose(chosen, np.array([0.0, t_s]))
            self._place(t_s, t_s)
            moved = pose.position_m[0] - pose.position_m[1]
        if not np.allclose(moved, self._root.position):
            self._root.position = moved
        for name, mount in self._mounts.items():
            if self._looks == 0 or mount.actor is not None:
                pose = self._world.sensor_pose(mount, times)
                self._sensors[name].position = pose.position_m[0]
                self._sensors[name].wxyz = points.quaternion(pose.rotation[0])

    def _part_names(self) -> None:
        """Names of actors that have come together stand one above the other."""
        bodies = list(self._names)
        at = np.array([self._bodies[number].position for number in bodies]).reshape(-1, 3)
        at[:, 2] += [top for _, top in self._names.values()]
        for number, raised in zip(bodies, stacked(at, NAME_SHARE * self._far_m), strict=True):
            name, top = self._names[number]
            if abs(name.position[2] - top - raised) > 1e-3:
                name.position = (0.0, 0.0, top + raised)

    def _draw(self, name: str, scan: ShownScan) -> None:
        wanted = (scan, self._colouring.value, self._beams.value, self._objects.value)
        size = self._size.value
        if self._clouds[name].point_size != size:
            self._clouds[name].point_size = size
        if self._drawn.get(name) == wanted:
            return
        self._drawn[name] = wanted
        start_s = self._world.local_s(scan.start_s)
        self._place(start_s, start_s + float(scan.fire_s.max(initial=0.0)))
        found = points.cloud(self._world, self._mounts[name], scan, self._colouring.value)
        self._count[name] = len(found.points_m)
        handle = self._clouds[name]
        if len(found.points_m):
            handle.points, handle.colors = found.points_m.astype(np.float32), found.colours
        handle.visible = bool(len(found.points_m))
        lines = points.beams(found) if self._beams.value and len(found.points_m) else None
        _draw_lines(self._lines[name], lines)
        boxes = points.boxes(self._world, self._mounts[name], scan) if scan.objects and self._objects.value else None
        _draw_lines(self._boxes[name], boxes)

    def _clear(self, name: str) -> None:
        if self._drawn.pop(name, None) is not None:
            self._count[name] = 0
            self._clouds[name].visible = False
            _draw_lines(self._lines[name], None)
            _draw_lines(self._boxes[name], None)

    def _say(self, key: str, handle: Any, text: str) -> None:
        if self._said.get(key) != text:
            self._said[key] = text
            handle.content = drawing.inset(text)

    def _write(self, frame: Frame) -> None:
        self._say("state", self._state, drawing.state(frame, self._models, self._count, self._recorded, self._lists))
        self._say("notes", self._notes, drawing.notes(frame.notes))
        scan = frame.scans.get(self._sensor.value)
        self._say("legend", self._legend, legend(self._colouring.value, self._world, scan))
        if self._frozen.value:
            return
        sensor = self._sensor.value
        rows = frame.telegrams.get(sensor, ())
        self._say("list", self._list, drawing.telegram_list(rows))
        kinds = {kind_of(row): row for row in rows}
        options = (NEWEST, *sorted(kinds))
        if tuple(self._which.options) != options:
            kept = self._which.value
            self._which.options = options
            self._which.value = kept if kept in options else NEWEST
        row = kinds.get(self._which.value) or (rows[-1] if rows else None)
        fields = (
            describe(self._speakers[sensor], row.data, _kind(frame, sensor, row), row.peer, row.sent) if row else []
        )
        self._say("fields", self._fields, drawing.telegram_fields(row, fields))


def view_m(low: Floats, high: Floats) -> float:
    """How far away the page first looks from, by the ends of a scene. [m]"""
    return 20.0 if not np.isfinite(low).all() else float(np.clip(0.35 * np.linalg.norm(high - low), 6.0, 22.0))


def name_heights(mounts: Mapping[str, Mount], apart_m: float, tops: Mapping[str, float]) -> dict[str, float]:
    """Height of each sensor's name above its sensor, so that names of sensors beside each other do not meet. [m]

    `tops`: height of the name of each actor that has one; those of the sensors that ride on it stand above.
    """
    heights: dict[str, float] = {}
    placed: list[tuple[str | None, Floats]] = [(actor, np.array([0.0, 0.0, top])) for actor, top in tops.items()]
    for name, mount in sorted(mounts.items(), key=lambda item: item[1].at_m[2]):
        at = np.array(mount.at_m, dtype=np.float64)
        top = at[2]
        for actor, other in placed:
            if actor == mount.actor and np.linalg.norm(other[:2] - at[:2]) < 4.0 * apart_m:
                top = max(top, float(other[2]) + apart_m)
        placed.append((mount.actor, np.array([at[0], at[1], top])))
        heights[name] = float(top - at[2])
    return heights


def stacked(at_m: Floats, apart_m: float) -> Floats:
    """(n,) how much higher each of the names at (n, 3) stands, so that those beside each other do not meet. [m]"""
    raised = np.zeros(len(at_m))
    placed: list[int] = []
    for one in np.lexsort((np.arange(len(at_m)), at_m[:, 2])).tolist():
        beside = [two for two in placed if np.linalg.norm(at_m[one, :2] - at_m[two, :2]) < 4.0 * apart_m]
        for two in sorted(beside, key=lambda two: float(at_m[two, 2] + raised[two])):
            if abs(at_m[one, 2] + raised[one] - at_m[two, 2] - raised[two]) < apart_m:
                raised[one] = at_m[two, 2] + raised[two] + apart_m - at_m[one, 2]
        placed.append(one)
    return raised


def _draw_lines(handle: Any, lines: Floats | None) -> None:
    shown = lines is not None and len(lines) > 0
    if shown:
        handle.points = np.asarray(lines, np.float32)
    if handle.visible != shown:
        handle.visible = shown


def _kind(frame: Frame, sensor: str, row: ShownTelegram) -> str:
    links = frame.sensors[sensor].links if sensor in frame.sensors else ()
    return links[row.link].kind if row.link < len(links) else "serial"


def kind_of(row: ShownTelegram) -> str:
    """What telegrams are chosen by."""
    way = "" if row.sent else "from host "
    return f"{way}{row.label or (f'{row.peer & 0x1FFFFFFF:X}' if row.peer else 'bytes')}"


def speaker_of(model: str, device: Mapping[str, Any]) -> Speaker:
    """Who speaks on a sensor's links; a model that is not known speaks nothing that is."""
    with contextlib.suppress(EmulatorError):
        spec = load_spec(model)
        return Speaker(spec.family or "", dict(spec.device), dict(device))
    return Speaker("", {}, dict(device))


def legend(colouring: str, world: scenes.Scene, scan: ShownScan | None) -> str:
    """What the colours mean."""
    if colouring != "actor":
        ends = ("at the threshold", f"{points.STRONGEST:g} x") if colouring == "intensity" else ("far", "near")
        sample = np.geomspace(points.WEAKEST, points.STRONGEST, 9)
        stops = points.colours_of("intensity", sample, sample, np.zeros(9, np.int32))
        ramp = ",".join(f"rgb({r},{g},{b})" for r, g, b in stops.tolist())
        return (
            f'<div style="display:flex;gap:6px;align-items:center;font-size:11px">{ends[0]}<div style="flex:1;'
            f'height:8px;border-radius:4px;background:linear-gradient(to right,{ramp})"></div>{ends[1]}</div>'
        )
    seen = [] if scan is None else sorted(set(scan.actor[np.isfinite(scan.range_m)].tolist()))
    rows = []
    for actor in seen:
        red, green, blue = points.actor_colour(actor) if actor >= 0 else (255, 255, 255)
        name = world.actors[actor] if 0 <= actor < len(world.actors) else "air"
        rows.append(f'<span style="color:rgb({red},{green},{blue})">●</span> {html(name)}')
    return f'<div style="font-size:11px">{" &nbsp; ".join(rows)}</div>'
