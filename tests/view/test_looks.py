"""Echoes as points, colours, boxes, polar plot, sliders: by closed forms."""

from __future__ import annotations

import math
import re
from pathlib import Path

import numpy as np
import pytest

from emulator.scenario import scenario
from emulator.scenario.tables import Mount
from emulator.view import drawing, points, sky, solids
from emulator.view.frames import Frame, ShownLink, ShownScan, ShownSensor, ShownTelegram
from emulator.world import scene

WORLD = """
schema: 1
world: [{plane: {size_m: [40, 40]}, material: asphalt}]
actors:
  - {id: ego, motion: {velocity_m_s: [10, 0, 0]}}
  - {id: post, shape: {box: {size_m: [1, 2, 3]}}, material: concrete, motion: {at_m: [10, 0, 0]}}
sensors:
  - {id: front, model: sick-lms291-s05, mount: {actor: ego, at_m: [0, 0, 1], yaw_deg: 90}, links: ["loop:front"]}
"""


@pytest.fixture(scope="module")
def world() -> scene.Scene:
    return scene.build(scenario.loads(WORLD, Path("world.yaml")))


@pytest.fixture(scope="module")
def mount() -> Mount:
    return scenario.loads(WORLD, Path("world.yaml")).sensors[0].mount


def scan(**changes: object) -> ShownScan:
    whole = {
        "start_s": 2.0,
        "sweep": 1,
        "azimuth_rad": np.radians([0.0, 90.0, 0.0]),
        "elevation_rad": np.radians([0.0, 0.0, 30.0]),
        "fire_s": np.array([0.0, 0.5, 0.0]),
        "range_m": np.array([[5.0], [4.0], [2.0]]),
        "intensity": np.array([[1.0], [3000.0], [np.nan]]),
        "actor": np.array([[0], [2], [-1]], np.int32),
    }
    return ShownScan(**(whole | changes))  # type: ignore[arg-type]


def test_echoes_lie_where_the_moving_sensor_saw_them(world: scene.Scene, mount: Mount) -> None:
    found = points.cloud(world, mount, scan(), "actor")
    high, far = 2.0 * math.sin(math.radians(30)), 2.0 * math.cos(math.radians(30))
    expected = [[20.0, 5.0, 1.0], [25.0 - 4.0, 0.0, 1.0], [20.0, far, 1.0 + high]]
    np.testing.assert_allclose(found.points_m, expected, atol=1e-12)
    np.testing.assert_allclose(found.origins_m[:, 0], [20.0, 25.0, 20.0])
    assert found.colours[2].tolist() == [255, 255, 255]
    assert tuple(found.colours[1]) == points.actor_colour(2)
    assert points.beams(found).shape == (3, 2, 3)


def test_beams_are_drawn_from_where_each_begins(world: scene.Scene, mount: Mount) -> None:
    origin = np.array([[0.0, 0.028, 0.0], [0.0, 0.0, 0.1], [0.0, 0.0, 0.0]])
    plain, found = (points.cloud(world, mount, scan(origin_m=one), "actor") for one in (None, origin))
    for at, begins in (("points_m", plain.points_m), ("origins_m", plain.origins_m)):
        moved = np.linalg.norm(getattr(found, at) - begins, axis=1)
        np.testing.assert_allclose(moved, [0.028, 0.1, 0.0], atol=1e-12)
    np.testing.assert_array_equal(points.beams(found)[:, 0], found.origins_m)
    above = drawing.polar(scan(origin_m=10.0 * origin), "actor", 8.0)
    assert above != drawing.polar(scan(), "actor", 8.0)
    assert above == drawing.polar(scan(origin_m=10.0 * origin * (1.0, 1.0, 0.0)), "actor", 8.0), "seen from above"


def test_no_echo_is_no_point(world: scene.Scene, mount: Mount) -> None:
    found = points.cloud(world, mount, scan(range_m=np.full((3, 1), np.nan)), "intensity")
    assert len(found.points_m) == len(found.colours) == len(points.beams(found)) == 0


def test_beams_are_thinned_out() -> None:
    many = np.zeros((1000, 3))
    assert len(points.beams(points.Cloud(many, many, many.astype(np.uint8)))) <= points.MOST_BEAMS


@pytest.mark.parametrize("colouring", points.COLOURINGS)
def test_colours_go_from_faint_to_strong(colouring: str) -> None:
    near, strength = np.array([1.0, 50.0]), np.array([points.STRONGEST * 10, points.WEAKEST / 10])
    bright, dark = points.colours_of(colouring, near, strength, np.array([1, 0], np.int32)).astype(int)
    assert bright.sum() > dark.sum() if colouring != "actor" else not (bright == dark).all()


def test_a_box_of_an_object_has_its_size_where_it_is(world: scene.Scene, mount: Mount) -> None:
    item = {"position_m": (10.0, 2.0, 0.5), "size_m": (4.0, 2.0, 1.0), "yaw_rad": math.pi / 2}
    edges = points.boxes(world, mount, scan(objects=(item,)))
    assert edges.shape == (12, 2, 3)
    low, high = edges.reshape(-1, 3).min(axis=0), edges.reshape(-1, 3).max(axis=0)
    # sensor at (20, 0, 1), turned left: its x is the world's y; the box is turned once more
    np.testing.assert_allclose((low + high) / 2, [18.0, 10.0, 1.5], atol=1e-9)
    np.testing.assert_allclose(high - low, [4.0, 2.0, 1.0], atol=1e-9)


def test_pieces_of_the_scene_have_their_triangles_once(world: scene.Scene) -> None:
    found = list(solids.pieces(world))
    assert sum(len(one.faces) for one in found) == sum(len(body.faces) for body in world.bodies)
    assert all(one.faces.max() < len(one.vertices_m) for one in found)
    assert len({one.name for one in found}) == len(found)


def test_the_polar_plot_has_ahead_above_and_left_on_the_left() -> None:
    text = drawing.polar(scan(range_m=np.array([[8.0], [4.0], [np.nan]])), "intensity")
    moves = [tuple(map(float, pair)) for pair in re.findall(r"M(-?[\d.]+) (-?[\d.]+)h0", text)]
    scale = (drawing.SIZE / 2 - 14) / 8
    assert sorted(moves) == [
        (pytest.approx(-4 * scale, abs=0.06), pytest.approx(0.0)),
        (0.0, pytest.approx(-8 * scale, abs=0.06)),
    ]
    assert "8 m" in text
    assert drawing.polar(None, "intensity").count("<circle") == drawing.RINGS


@pytest.mark.parametrize(
    ("far", "radius"), [(0.0, 8.0), (1.0, 1.0), (1.1, 2.0), (9.0, 10.0), (79.0, 80.0), (81.0, 100.0)]
)
def test_rings_are_round_numbers(far: float, radius: float) -> None:
    assert drawing.nice_radius(far) == radius


def test_names_cannot_break_out_of_the_page() -> None:
    link = ShownLink("pty:/<script>", "serial", True, 1, 20_000, 3)
    sensor = ShownSensor(5, 37.5, 80.0, 25_000.0, {"<b>": 2}, {}, 1, (link,))
    frame = Frame(1.5, True, False, 1.0, sensors={"<i>": sensor}, ended="<u>")
    text = drawing.state(frame, {"<i>": "<m>"}, {"<i>": 7})
    assert not re.search(r"<(script|b>:|i>|u>|m>)", text.replace("<b>7</b>", "").replace("<b>&lt;i&gt;</b>", ""))
    assert 'data-points="7"' in text
    assert "25.0 ms" in text
    row = ShownTelegram(1, 0, 0x60B, True, 1.0, b"\x02" * 60, "<x>")
    assert "&lt;x&gt;" in drawing.telegram_list([row])
    assert "60B" in drawing.telegram_list([row])
    assert "<x>" not in drawing.telegram_fields(row, [drawing.Described("<x>", "<x>", "<x>")])


def test_the_weather_is_told_in_words() -> None:
    text = sky.reported({"fog": {"visibility_m": 50.0}, "rain": {"rate_mm_h": 10.0}, "sun": {"elevation_deg": 20.0}})
    assert "fog 50 m, rain 10 mm/h, sun 20 deg high" in text
    assert "clear, no sun" in sky.reported({})


def test_names_of_sensors_beside_each_other_stand_apart() -> None:
    pytest.importorskip("viser", reason="extra `view` is not installed")
    from emulator.view.page import name_heights

    places = {"top": (0, 0, 1.5), "front": (3, 0, 0.5), "radar": (3, 0.1, 0.6), "far": (500, 0, 0.5)}
    mounts = {name: Mount(at_m=at) for name, at in places.items()}
    heights = name_heights(mounts, 1.0, {})
    assert heights["front"] == heights["far"] == 0.0
    shown = sorted(places[name][2] + heights[name] for name in ("top", "front", "radar"))
    assert np.diff(shown).min() >= 1.0 - 1e-12


def test_the_polar_plot_draws_the_boxes_of_an_object_list() -> None:
    item = {"track": 7, "position_m": (10.0, 4.0, 0.5), "size_m": (4.0, 2.0, 1.0), "yaw_rad": math.pi / 2}
    text = drawing.polar(scan(range_m=np.full((3, 1), np.nan), objects=(item,)), "intensity")
    path = re.search(r'view-object" d="M([^Z]+)Z"', text)
    assert path is not None
    corners = np.array([[float(one) for one in pair.split()] for pair in path[1].split("L")])
    scale = (drawing.SIZE / 2 - 14) / 20  # rings to 20 m, as the object is 10.8 m away
    # it is turned to the left: its length lies across
    np.testing.assert_allclose(
        [corners.min(axis=0), corners.max(axis=0)], np.array([[-6, -11], [-2, -9]]) * scale, atol=0.06
    )
    assert ">7</text>" in text
    frame = Frame(1.5, True, False, 1.0, {"radar": scan(objects=(item,))}, {"radar": ShownSensor()})
    assert "<b>1</b> objects" in drawing.state(frame, {}, {}, lists={"radar"})
