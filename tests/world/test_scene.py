"""Scenarios and mesh files to bodies: axes, parts, materials, and what is refused."""

from __future__ import annotations

import json
import pickle
from pathlib import Path

import numpy as np
import pytest
import trimesh

from emulator.casting.raycast import Caster
from emulator.errors import SceneError
from emulator.scenario import scenario
from emulator.scenario.tables import Mount
from emulator.world import mesh_files, scene, triangles
from emulator.world.motion import Steady
from emulator.world.scene import Scene
from emulator.world.solids import Node, block, glb
from emulator.world.triangles import Geometry

HEAD = "schema: 1\n"
PLY = (
    b"ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n"
    b"element face 1\nproperty list uchar int vertex_indices\nend_header\n0 0 0\n1 0 inf\n0 1 0\n3 0 1 2\n"
)


def built(text: str, folder: Path) -> scene.Scene:
    return scene.build(scenario.loads(HEAD + text, folder / "test.yaml"))


def wedge() -> trimesh.Trimesh:
    """A closed solid without any symmetry: 2 forward, 1 left, 0.5 up."""
    corner = [[0, 0, 0], [2, 0, 0], [0, 1, 0], [0, 0, 0.5]]
    return trimesh.Trimesh(corner, [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]], process=False)


def load(path: Path, up: str | None = None, scale: float = 1.0) -> Geometry:
    return mesh_files.load(path, up, scale, "here")  # type: ignore[arg-type]


# ---------------------------------------------------------------- files


@pytest.mark.parametrize("suffix", ["obj", "stl", "ply"])
def test_formats_without_axes_are_taken_as_they_are(tmp_path: Path, suffix: str) -> None:
    exported = wedge().export(file_type=suffix)
    (tmp_path / f"w.{suffix}").write_bytes(exported.encode() if isinstance(exported, str) else exported)
    mesh = load(tmp_path / f"w.{suffix}")
    assert mesh.closed.all()
    np.testing.assert_allclose(mesh.vertices.max(axis=0), [2.0, 1.0, 0.5])
    np.testing.assert_allclose(load(tmp_path / f"w.{suffix}", "y").vertices.max(axis=0), [0.5, 2.0, 1.0])
    np.testing.assert_allclose(load(tmp_path / f"w.{suffix}", scale=0.01).vertices.max(axis=0), [0.02, 0.01, 0.005])


@pytest.mark.parametrize("suffix", ["glb", "gltf"])
def test_gltf_is_y_up_and_z_forward(tmp_path: Path, suffix: str) -> None:
    """glTF 2.0, 3.4: +y up, +z forward, -x right; so our x is its z, our y its x, our z its y."""
    turned = wedge()
    turned.vertices = turned.vertices[:, [1, 2, 0]]
    exported = turned.export(file_type=suffix)
    for name, content in exported.items() if isinstance(exported, dict) else [("w.glb", exported)]:
        (tmp_path / name.replace("model.gltf", "w.gltf")).write_bytes(content)
    mesh = load(tmp_path / f"w.{suffix}")
    np.testing.assert_allclose(mesh.vertices.max(axis=0), [2.0, 1.0, 0.5])
    assert mesh.closed.all()
    np.testing.assert_allclose(load(tmp_path / f"w.{suffix}", "z").vertices.max(axis=0), [1.0, 0.5, 2.0])


def test_nodes_place_turn_scale_and_mirror_their_meshes(tmp_path: Path) -> None:
    solid = block("steel", (0.0, 0.0, 0.0), (2.0, 1.0, 0.5))
    nodes = [Node("a", "crate"), Node("b", "crate", (10.0, 3.0, 1.0), 90.0, 2.0)]
    (tmp_path / "n.glb").write_bytes(glb({"crate": solid}, nodes))
    mesh = load(tmp_path / "n.glb")
    assert (mesh.parts, len(mesh.faces)) == (("steel",), 24)
    second = mesh.vertices[mesh.faces[12:]].reshape(-1, 3)
    np.testing.assert_allclose(second.min(axis=0), [8.0, 3.0, 1.0], atol=1e-6)
    np.testing.assert_allclose(second.max(axis=0), [10.0, 7.0, 2.0], atol=1e-6)

    stored = (tmp_path / "n.glb").read_bytes()
    length = int.from_bytes(stored[12:16], "little")
    document = json.loads(stored[20 : 20 + length])
    document["nodes"][1]["scale"] = [-2.0, 2.0, 2.0]
    text = json.dumps(document, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 4)
    rest = stored[20 + length :]
    head = b"glTF" + (2).to_bytes(4, "little") + (20 + len(text) + len(rest)).to_bytes(4, "little")
    (tmp_path / "m.glb").write_bytes(head + len(text).to_bytes(4, "little") + b"JSON" + text + rest)
    mirrored = load(tmp_path / "m.glb")
    assert mirrored.closed.all()
    outwards = mirrored.vertices[mirrored.faces[12:]].mean(axis=1)
    middle = (outwards.min(axis=0) + outwards.max(axis=0)) / 2.0
    assert (np.einsum("ij,ij->i", outwards - middle, mirrored.normals[12:]) > 0).all()


def test_primitives_with_materials_are_parts_by_the_materials_name(tmp_path: Path) -> None:
    lower, upper = block("paint", (0, 0, 0), (1, 1, 1)), block("glass", (0, 0, 1), (1, 1, 2))
    from emulator.world.solids import joined

    (tmp_path / "c.glb").write_bytes(glb({"car": joined([lower, upper])}))
    mesh = load(tmp_path / "c.glb")
    assert mesh.parts == ("paint", "glass")
    heights = mesh.vertices[mesh.faces].mean(axis=1)[:, 2]
    assert heights[mesh.face_part == 0].max() <= 1.0
    assert heights[mesh.face_part == 1].min() >= 1.0


def test_an_obj_file_has_its_materials_or_groups_as_parts(tmp_path: Path) -> None:
    (tmp_path / "m.mtl").write_text("newmtl red\nKd 1 0 0\nnewmtl glass\nKd 0 0 1\n")
    (tmp_path / "c.obj").write_text(
        "mtllib m.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nusemtl red\nf 1 2 3\nf 1 2 4\nusemtl glass\nf 2 3 4\n"
    )
    mesh = load(tmp_path / "c.obj")
    assert mesh.parts == ("red", "glass")
    assert mesh.face_part.tolist() == [0, 0, 1]
    corners = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\n"
    for word in "og":
        (tmp_path / "g.obj").write_text(f"{corners}{word} door\nf 1 2 3\n{word} frame\nf -4/1 -3/1/1 -1//2\n")
        assert load(tmp_path / "g.obj").parts == ("door", "frame")
    (tmp_path / "q.obj").write_text(f"{corners}f 1 2 \\\n 3 4 # a quad\n")
    assert load(tmp_path / "q.obj").faces.tolist() == [[0, 1, 2], [0, 2, 3]]
    assert load(tmp_path / "q.obj").parts == ("q",)


def test_an_stl_is_read_the_same_whatever_guesses_encodings_here(tmp_path: Path) -> None:
    corners = b"vertex 0 0 0\nvertex 1 0 0\nvertex 0 1 0\n"
    text = b"solid \xc3\xbc\nfacet normal 0 0 1\nouter loop\n" + corners + b"endloop\nendfacet\nendsolid\n"
    (tmp_path / "text.stl").write_bytes(text)
    triangle = np.array([0, 0, 1, 0, 0, 0, 1, 0, 0, 0, 1, 0], np.float32).tobytes() + b"\0\0"
    (tmp_path / "binary.stl").write_bytes(b"\xfcnot UTF-8".ljust(80) + b"\x01\0\0\0" + triangle)
    assert len(load(tmp_path / "text.stl").faces) == len(load(tmp_path / "binary.stl").faces) == 1
    (tmp_path / "latin.stl").write_bytes(text.replace(b"\xc3\xbc", b"\xfc"))
    with pytest.raises(SceneError, match="neither binary nor text in UTF-8"):
        load(tmp_path / "latin.stl")


@pytest.mark.parametrize(
    ("name", "content", "reported"),
    [
        ("a.glb", b"glTF\x02\0\0\0", "cannot be read"),
        ("a.glb", b"", "cannot be read"),
        ("a.gltf", b"{not json", "cannot be read"),
        ("a.stl", b"solid x\nfacet nonsense", ""),
        ("a.stl", b"solid garbage \x00\xff" * 30, "cannot be read (neither binary nor text in UTF-8)"),
        ("a.ply", b"ply\nformat ascii 1.0\nelement vertex 3\n", "cannot be read"),
        ("a.obj", b"v 0 0 0\nv 1 0 0\n", "no triangles"),
        ("a.obj", b"", ""),
        ("a.dae", b"", "want a mesh file ending in"),
        ("a.obj", b"v 0 0 0\nv 1 0 0\nv nan 1 0\nf 1 2 3\n", "triangle 0 has the vertex"),
        ("a.ply", PLY, "triangle 0 has the vertex"),
        ("a.obj", b"v 0 0 0\nf 1 2\n", "line 2: 'f 1 2': a face of fewer than three corners"),
        ("a.obj", b"v 0 0 0\nv 1 0 0\nf 1 2 3\n", "triangle 0 names vertex [0, 1, 2]; want 0..1"),
        ("a.obj", b"v 0 0 0\nf 1 -2 1\n", "no vertex -2"),
        ("a.obj", b"v 0 0\n", "line 1"),
        ("a.obj", bytes(range(256)), "no triangles"),
    ],
)  # fmt: skip
def test_a_broken_mesh_is_a_scene_error(tmp_path: Path, name: str, content: bytes, reported: str) -> None:
    (tmp_path / name).write_bytes(content)
    with pytest.raises(SceneError, match=r"^here: ") as caught:
        load(tmp_path / name)
    assert reported in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_shipped_mesh_cut_anywhere_is_a_scene_error(tmp_path: Path) -> None:
    whole = (Path(scenario.__file__).parents[2] / "scenarios" / "meshes" / "tree.glb").read_bytes()
    for length in range(0, len(whole) - 1, 501):
        (tmp_path / "cut.glb").write_bytes(whole[:length])
        with pytest.raises(SceneError):
            load(tmp_path / "cut.glb")


def test_a_missing_mesh_is_a_scene_error(tmp_path: Path) -> None:
    with pytest.raises(SceneError, match="no such file"):
        load(tmp_path / "none.glb")


# ---------------------------------------------------------------- scenarios


def test_actors_come_after_the_world_in_the_files_order(tmp_path: Path) -> None:
    world = built(
        "world: [{plane: {size_m: [4, 4]}, material: asphalt}, {box: {size_m: [1, 1, 1]}, material: brick}]\n"
        "actors:\n"
        "  - {id: ego}\n"
        "  - {id: car, class: car, shape: {box: {size_m: [4, 2, 1]}}, material: car_paint_grey,\n"
        "     motion: {at_m: [9, 0, 0]}}\n",
        tmp_path,
    )
    assert world.actors == ("world", "ego", "car")
    assert world.classes == ("unknown", "unknown", "car")
    assert [body.actor for body in world.bodies] == [0, 0, 2]
    assert world.materials == ("asphalt", "brick", "car_paint_grey")
    assert world.bodies[2].face_material.tolist() == [2] * 12
    np.testing.assert_array_equal(world.pose(2, np.array([0.0])).position_m, [[9, 0, 0]])
    np.testing.assert_array_equal(world.velocity(2, np.array([0.0, 1.0])), np.zeros((2, 3)))


def test_a_scene_survives_the_way_into_another_process(tmp_path: Path) -> None:
    text = "actors: [{id: a, shape: {sphere: {radius_m: 1}}, material: brick, motion: {velocity_m_s: [1, 0, 0]}}]\n"
    config = scenario.loads(HEAD + text, tmp_path / "x.yaml")
    again = pickle.loads(pickle.dumps(config))
    assert again == config
    copy = pickle.loads(pickle.dumps(scene.build(config)))
    assert copy.actors == ("world", "a")
    along = np.array([[1.0, 0.0, 0.0]])
    assert Caster(copy).first_hits(np.array([-5.0, 0.0, 1.0]), along, 1.0).range_m[0] == pytest.approx(5.0, abs=1e-2)


def test_equal_shapes_are_made_once(tmp_path: Path) -> None:
    text = "actors:\n" + "".join(
        f"  - {{id: a{k}, shape: {{mesh: builtin:car.glb}}, material: brick, motion: {{at_m: [{10 * k}, 0, 0]}}}}\n"
        for k in range(5)
    )
    world = built(text, tmp_path)
    assert len({id(body.geometry) for body in world.bodies}) == 1


def test_a_world_item_is_placed_and_turned(tmp_path: Path) -> None:
    text = "world: [{box: {size_m: [4, 2, 1]}, at_m: [10, 1, 0], yaw_deg: 90, material: brick}]\n"
    caster = Caster(built(text, tmp_path))
    hits = caster.first_hits(np.array([0.0, 1.0, 0.5]), np.array([[1.0, 0.0, 0.0]]), 0.0)
    assert hits.range_m[0] == pytest.approx(9.0, abs=1e-12)


def test_a_sensor_rides_on_its_actor(tmp_path: Path) -> None:
    text = (
        "actors: [{id: ego, motion: {at_m: [5, 0, 0], yaw_deg: 90, velocity_m_s: [0, 2, 0]}}]\n"
        "sensors:\n"
        "  - {id: s, model: sick-lms291-s05, mount: {actor: ego, at_m: [3, 0, 0.5], yaw_deg: -90}}\n"
        "  - {id: w, model: sick-lms291-s05, mount: {at_m: [1, 2, 3], pitch_deg: 90}}\n"
    )
    config = scenario.loads(HEAD + text, tmp_path / "x.yaml")
    world = scene.build(config)
    pose = world.sensor_pose(config.sensors[0].mount, np.array([0.0, 1.5]))
    np.testing.assert_allclose(pose.position_m, [[5.0, 3.0, 0.5], [5.0, 6.0, 0.5]], atol=1e-15)
    np.testing.assert_allclose(pose.rotation, np.broadcast_to(np.eye(3), (2, 3, 3)), atol=1e-15)
    fixed = world.sensor_pose(config.sensors[1].mount, np.array([7.0]))
    np.testing.assert_array_equal(fixed.position_m, [[1, 2, 3]])
    np.testing.assert_array_equal(fixed.rotation[0] @ [1.0, 0.0, 0.0], [0.0, 0.0, -1.0])


@pytest.mark.parametrize(
    ("tables", "reported"),
    [
        ("materials: {paint: brick}", "no material for glass; want `material` or `materials` for them"),
        ("", "no material for paint, glass"),
        ("materials: {paint: brick, glas: asphalt}", "materials.glas: no such part; want one of paint, glass"),
    ],
)
def test_parts_without_a_material_and_materials_without_a_part_are_named(
    tmp_path: Path, tables: str, reported: str
) -> None:
    from emulator.world.solids import joined

    parts = joined([block("paint", (0, 0, 0), (1, 1, 1)), block("glass", (0, 0, 1), (1, 1, 2))])
    (tmp_path / "c.glb").write_bytes(glb({"car": parts}))
    with pytest.raises(SceneError) as caught:
        built(f"actors:\n  - id: car\n    shape: {{mesh: c.glb}}\n    {tables}\n", tmp_path)
    assert reported in str(caught.value)
    assert str(caught.value).startswith(f"{tmp_path / 'test.yaml'}:")
    assert ": actors.car" in str(caught.value)


def test_parts_that_bear_a_materials_name_need_no_table(tmp_path: Path) -> None:
    (tmp_path / "c.glb").write_bytes(glb({"x": block("brick", (0, 0, 0), (1, 1, 1))}))
    assert built("world: [{mesh: c.glb}]\n", tmp_path).materials == ("brick",)
    own = "materials: {mine: {like: brick}}\nworld: [{mesh: d.glb}]\n"
    (tmp_path / "d.glb").write_bytes(glb({"x": block("mine", (0, 0, 0), (1, 1, 1))}))
    assert built(own, tmp_path).materials == ("mine",)


def test_every_broken_mesh_of_a_scenario_is_told_at_once(tmp_path: Path) -> None:
    (tmp_path / "a.obj").write_text("v 0 0 0\n")
    (tmp_path / "b.obj").write_text("v 0 0 0\nv 0 1 0\nv nan 0 0\nf 1 2 3\n")
    with pytest.raises(SceneError) as caught:
        built("world:\n  - {mesh: a.obj, material: brick}\n  - {mesh: b.obj, material: brick}\n", tmp_path)
    lines = str(caught.value).splitlines()
    assert [line.split(": ")[1] for line in lines] == ["world[0].mesh", "world[1].mesh"]
    assert lines[1].startswith(f"{tmp_path / 'test.yaml'}:4: world[1].mesh: b.obj: triangle 0 ")


def test_odd_meshes_are_warned_about(tmp_path: Path) -> None:
    (tmp_path / "m.mtl").write_text("newmtl red\nKd 1 0 0\nnewmtl blue\nKd 0 0 1\n")
    (tmp_path / "c.obj").write_text(
        "mtllib m.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nusemtl red\nf 1 2 3\nf 1 1 2\nusemtl blue\nf 1 2 3\n"
    )
    warnings = built("world: [{mesh: c.obj, material: brick}]\n", tmp_path).warnings
    assert any("1 triangles of zero area omitted" in one for one in warnings)
    assert any("1 triangles lie on one of another part" in one for one in warnings)


def test_more_triangles_than_fit_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(scene, "MOST_TRIANGLES", 1000)
    with pytest.raises(SceneError, match="12320 triangles in all; want at most 1000"):
        built("world: [{sphere: {radius_m: 1, segments: 112}, material: brick}]\n", tmp_path)


def test_a_primitive_may_be_named_in_a_table_of_materials(tmp_path: Path) -> None:
    world = built("world: [{box: {size_m: [1, 1, 1]}, materials: {surface: brick}}]\n", tmp_path)
    assert world.materials == ("brick",)


def test_smoothness_is_the_scenarios_choice(tmp_path: Path) -> None:
    world = built("world: [{cylinder: {radius_m: 1, height_m: 1, segments: 8}, material: brick}]\n", tmp_path)
    assert len(world.bodies[0].faces) == len(triangles.cylinder(1, 1, 8).faces) == 32


def test_a_sensor_on_a_car_has_a_pose_for_any_number_of_times() -> None:
    motions = (Steady(), Steady(velocity_m_s=(1.0, 0.0, 0.0), yaw_deg=90.0))
    world = Scene(("world", "car"), ("unknown", "car"), motions, (), ())
    for count in (0, 1, 3):
        pose = world.sensor_pose(Mount(actor="car", at_m=(0.5, 0.0, 1.0)), np.arange(float(count)))
        np.testing.assert_allclose(
            pose.position_m, [[t, 0.5, 1.0] for t in range(count)] or np.zeros((0, 3)), atol=1e-12
        )
        assert pose.rotation.shape == (count, 3, 3)
