"""Pictures and vertex colours on meshes: reflectance and normals by texel, through whole scans; refusals."""

from __future__ import annotations

import base64
import io
import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from emulator.compiled import switch
from emulator.errors import ScenarioError, SceneError
from tests.sensing.rig import QUIET, build, plan, plate

Image = pytest.importorskip("PIL.Image")
GREY = np.array([[0, 64], [128, 255]], np.uint8)
"Upper row first."


def png(picture: np.ndarray, mode: str | None = None) -> str:
    data = io.BytesIO()
    image = Image.fromarray(picture)
    (image.convert(mode) if mode else image).save(data, "PNG")
    return "data:image/png;base64," + base64.b64encode(data.getvalue()).decode()


def quad(folder: Path, *, changes: dict[str, Any] | None = None, **parts: Any) -> Path:
    """A square of 2 m in the plane x = 5, seen from the origin: u to the right, v downwards; `parts` as below."""
    # in glTF's axes: (y, z, x) of ours; corners: upper left, upper right, lower right, lower left as seen
    corners = np.array([[1, 1, 5], [-1, 1, 5], [-1, -1, 5], [1, -1, 5]], np.float32)
    uv = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], np.float32) * parts.get("repeat", 1.0)
    index = np.array([0, 2, 1, 0, 3, 2], np.uint16)
    colour = np.asarray(parts.get("colour", np.ones((4, 3))), np.float32)
    pieces, views, offset = [corners, uv, colour, index], [], 0
    for piece in pieces:
        views.append({"buffer": 0, "byteOffset": offset, "byteLength": piece.nbytes})
        offset += piece.nbytes
    data = b"".join(piece.tobytes() for piece in pieces)
    kinds = [("VEC3", 5126, 4), ("VEC2", 5126, 4), ("VEC3", 5126, 4), ("SCALAR", 5123, 6)]
    attributes = {"POSITION": 0}
    attributes |= {"TEXCOORD_0": 1} if parts.get("uv", True) else {}
    attributes |= {"COLOR_0": 2} if "colour" in parts else {}
    images = [{"uri": one} for one in (parts.get("picture"), parts.get("normal")) if one is not None]
    material: dict[str, Any] = {"name": "poster", "pbrMetallicRoughness": {}}
    if "picture" in parts:
        material["pbrMetallicRoughness"]["baseColorTexture"] = {"index": 0}
    if "normal" in parts:
        material["normalTexture"] = {"index": len(images) - 1}
    tree = {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": attributes, "indices": 3, "material": 0}]}],
        "materials": [material],
        "textures": [{"source": number} for number in range(len(images))],
        "images": images,
        "accessors": [
            {"bufferView": k, "type": kind, "componentType": component, "count": count}
            for k, (kind, component, count) in enumerate(kinds)
        ],
        "bufferViews": views,
        "buffers": [{"byteLength": len(data), "uri": "data:;base64," + base64.b64encode(data).decode()}],
        **(changes or {}),
    }
    path = folder / "poster.gltf"
    path.write_text(json.dumps(tree), encoding="utf-8")
    return path


def poster(folder: Path, maps: dict[str, Any], mesh: str = "poster.gltf", **more: Any) -> Any:
    material = {"rho": 0.5, "maps": maps}
    world = [{"mesh": mesh, "material": "poster"}, *more.pop("others", [])]
    return build(folder, world, materials={"poster": material}, physics={**QUIET, **more.pop("physics", {})}, **more)


def light(measure: Any, azimuth_deg: float, elevation_deg: float) -> float:
    """Amplitude over that of a white plate at the place."""
    white = build_white(measure)
    at = plan((azimuth_deg,), elevation_deg=elevation_deg)
    return float(measure.view(at).echoes.amplitude.sum() / white.view(at).echoes.amplitude.sum())


def build_white(measure: Any) -> Any:
    folder = Path(measure.folder)
    return build(folder / "white", [plate(5.0, "white")], physics=QUIET)


def linear(value: float) -> float:
    value /= 255.0
    return value / 12.92 if value <= 0.04045 else ((value + 0.055) / 1.055) ** 2.4


@pytest.fixture(name="at")
def _at(tmp_path: Path) -> Path:
    (tmp_path / "white").mkdir()
    return tmp_path


def made(folder: Path, maps: dict[str, Any], **more: Any) -> Any:
    found = poster(folder, maps, **more)
    found.folder = folder
    return found


@pytest.mark.parametrize(
    "physics", [{}, {"full": True}, {"rule": "adaptive"}, {"leave_out": {"closed_form": "always"}}]
)
def test_every_texel_reflects_by_its_luminance(at: Path, physics: dict[str, Any]) -> None:
    quad(at, picture=png(GREY))
    measure = made(at, {"reflectance": [0.1, 0.9]}, physics=physics)
    for (row, column), value in np.ndenumerate(GREY):  # left is +y: positive azimuth
        found = light(measure, 5.0 * (1 - 2 * column), 5.0 * (1 - 2 * row))
        assert found == pytest.approx(0.1 + 0.8 * linear(float(value)), abs=0.8 / 510 + 1e-3), (row, column)


def test_colours_count_by_their_luminance_and_pictures_repeat(at: Path) -> None:
    red_green = np.array([[[255, 0, 0], [0, 255, 0]]], np.uint8)
    quad(at, picture=png(red_green), repeat=2.0)
    measure = made(at, {"reflectance": [0.0, 1.0]})
    found = [light(measure, azimuth, 3.0) for azimuth in (8.0, 3.0, -3.0, -8.0)]
    assert found == pytest.approx([0.2126, 0.7152, 0.2126, 0.7152], abs=0.004)


def test_a_beam_on_two_texels_has_the_light_of_both(at: Path) -> None:
    quad(at, picture=png(np.array([[0, 255]], np.uint8)))
    measure = made(at, {"reflectance": [0.0, 1.0]}, model="sick-lms291-s05")
    one = measure.view(plan((0.0,))).echoes.amplitude.sum()
    bright = measure.view(plan((-6.0,))).echoes.amplitude.sum()
    assert one / bright == pytest.approx(0.5, abs=0.04)


def test_vertex_colours_are_interpolated(at: Path) -> None:
    quad(at, colour=[[0, 0, 0], [1, 1, 1], [1, 1, 1], [0, 0, 0]])
    measure = made(at, {"reflectance": [0.0, 1.0]})
    for y in (-0.8, 0.0, 0.5):
        found = light(measure, math.degrees(math.atan2(y, 5.0)), 0.01)
        assert found == pytest.approx(0.5 - 0.5 * y, abs=0.004)


@pytest.mark.parametrize("suffix", ["obj", "ply"])
def test_vertex_colours_of_obj_and_ply(at: Path, suffix: str) -> None:
    corners = [(5, 1, 1), (5, -1, 1), (5, -1, -1), (5, 1, -1)]
    if suffix == "obj":
        lines = [f"v {x} {y} {z} 0.5 0.5 0.5" for x, y, z in corners] + ["f 1 3 2", "f 1 4 3"]
    else:
        head = ["ply", "format ascii 1.0", "element vertex 4", *(f"property float {c}" for c in "xyz")]
        head += [f"property uchar {c}" for c in ("red", "green", "blue")]
        lines = [*head, "element face 2", "property list uchar int vertex_indices", "end_header"]
        lines += [f"{x} {y} {z} 128 128 128" for x, y, z in corners] + ["3 0 2 1", "3 0 3 2"]
    (at / f"poster.{suffix}").write_text("\n".join(lines) + "\n", encoding="utf-8")
    measure = made(at, {"reflectance": [0.2, 0.8]}, mesh=f"poster.{suffix}")
    assert light(measure, 3.0, 2.0) == pytest.approx(0.2 + 0.6 * 0.2145, abs=0.004)


@pytest.mark.parametrize(("x", "y"), [(0.6, 0.0), (0.0, 0.6), (-0.6, 0.0), (0.0, -0.6)])
def test_normals_lean_to_the_right_and_upwards_of_the_picture(at: Path, x: float, y: float) -> None:
    """Cosine of a beam with a normal that leans 37 degrees."""
    texel = np.rint((np.array([[[x, y, 0.8]]]) + 1.0) * 127.5).astype(np.uint8)
    quad(at, picture=png(np.full((1, 1), 255, np.uint8)), normal=png(texel))
    measure = made(at, {"reflectance": [0.0, 1.0], "normals": True})
    for azimuth, elevation in ((0.02, 0.01), (9.0, 6.0), (-9.0, -6.0)):
        a, e = math.radians(azimuth), math.radians(elevation)
        ray = np.array([math.cos(e) * math.cos(a), math.cos(e) * math.sin(a), math.sin(e)])
        normal = np.array([-0.8, -x, y])  # the picture's right is our -y
        # the white plate has its own cosine
        assert light(measure, azimuth, elevation) == pytest.approx(-(ray @ normal) / ray[0], rel=0.012)


def test_maps_move_with_their_body_and_are_seen_by_a_sensor_at_rest(at: Path) -> None:
    quad(at, picture=png(np.array([[0, 255]], np.uint8)))
    actor = {"id": "van", "class": "car", "shape": {"mesh": "poster.gltf"}, "material": "poster"}
    actor |= {"motion": {"at_m": [0, 0, 0], "velocity_m_s": [0.0, 0.5, 0.0]}}
    made_ = []
    for on in (False, True):
        with switch.switched(on):
            measure = build(at, [plate(9.0, "dark")], actors=[actor], physics=QUIET, materials={
                "poster": {"rho": 0.5, "maps": {"reflectance": [0.1, 0.9]}}})  # fmt: skip
            made_.append([
                measure.view(plan((1.0,), elevation_deg=0.5, start_s=t)).echoes.amplitude.sum() for t in (0.0, 1.0)
            ])  # fmt: skip
    assert made_[0] == pytest.approx(made_[1], rel=1e-9)
    assert made_[0][1] / made_[0][0] == pytest.approx(9.0, rel=0.02)  # black, then white as it has moved to the left


def test_a_material_without_maps_reads_no_pictures(at: Path) -> None:
    quad(at, picture="missing.png")
    build(at, [{"mesh": "poster.gltf", "material": "half"}])


BAD: dict[str, tuple[dict[str, Any], dict[str, Any]]] = {
    "picture 'missing.png': no such file": ({"picture": "missing.png"}, {"reflectance": [0, 1]}),
    "part poster has a baseColorTexture and no texture coordinates": (
        {"picture": png(GREY), "uv": False}, {"reflectance": [0, 1]},
    ),
    "part poster has neither a baseColorTexture nor vertex colours": ({}, {"reflectance": [0, 1]}),
    "part poster has no normalTexture": ({"picture": png(GREY)}, {"normals": True}),
    "a normal map of colours L; want RGB, RGBA, 8 bit each": ({"normal": png(GREY)}, {"normals": True}),
    "of colours I;16; want RGB": ({"picture": png(np.zeros((2, 2), np.uint16))}, {"reflectance": [0, 1]}),
    "not a picture that can be read; want a PNG or JPEG": (
        {"picture": "data:image/png;base64,AAAA"}, {"reflectance": [0, 1]},
    ),
    "want a file in the folder of the mesh": ({"picture": "../a.png"}, {"reflectance": [0, 1]}),
    "textures 0; want one of 0": (
        {"picture": png(GREY), "changes": {"textures": []}}, {"reflectance": [0, 1]},
    ),
}  # fmt: skip


@pytest.mark.parametrize("reported", BAD)
def test_meshes_without_what_is_wanted_are_refused(at: Path, reported: str) -> None:
    parts, maps = BAD[reported]
    quad(at, **parts)
    with pytest.raises(SceneError, match=r"scene.yaml:\d+: world.0..mesh: ") as caught:
        poster(at, maps)
    assert reported in str(caught.value)


def test_too_many_pixels_are_refused_before_they_are_read(at: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    quad(at, picture=png(np.zeros((300, 300), np.uint8)))
    monkeypatch.setenv("LIDAREMU_MESH_LIMITS", "pixels=50000")
    with pytest.raises(SceneError, match=r"300 x 300 pixels; want at most 50000 in all its pictures"):
        poster(at, {"reflectance": [0, 1]})


@pytest.mark.parametrize("how", [{"material": "poster"}, {"materials": {"poster": "poster"}}])
def test_shapes_that_change_have_no_maps(at: Path, how: dict[str, Any]) -> None:
    quad(at, picture=png(GREY))
    shape = {"frames": {"meshes": ["poster.gltf", "poster.gltf"], "period_s": 1.0}}
    materials = {"poster": {"rho": 0.5, "maps": {"reflectance": [0, 1]}}}
    with pytest.raises(SceneError, match=r"actors\.a\.shape\.frames: poster has maps; want a material without them"):
        build(at, actors=[{"id": "a", "shape": shape, **how}], materials=materials)


def test_primitives_have_no_maps(at: Path) -> None:
    with pytest.raises(SceneError, match="neither pictures nor vertex colours"):
        build(at, [plate(5.0, "poster")], materials={"poster": {"rho": 0.5, "maps": {"reflectance": [0, 1]}}})


@pytest.mark.parametrize(
    ("maps", "reported"),
    [
        ({"reflectance": [0.1]}, "maps.reflectance: [0.1]; want two numbers"),
        ({"reflectance": [0.1, 2]}, "maps.reflectance: 2; want a number from 0 to 1"),
        ({"normals": "yes"}, "maps.normals: 'yes'; want true or false"),
        ({}, "maps: {}; want a mapping"),
    ],
)
def test_bad_keys_are_refused(at: Path, maps: dict[str, Any], reported: str) -> None:
    with pytest.raises(ScenarioError, match=r"scene.yaml:\d+: ") as caught:
        poster(at, maps)
    assert reported in str(caught.value)
