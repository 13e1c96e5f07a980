"""What is said of triangle meshes: finite, closed, wound outwards; and the primitives' closed forms."""

from __future__ import annotations

import math

import numpy as np
import pytest

from emulator.errors import SceneError
from emulator.world import triangles
from emulator.world.triangles import Geometry, checked


def volume(mesh: Geometry) -> float:
    a, b, c = (mesh.vertices[mesh.faces[:, k]] for k in range(3))
    return float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6.0)


def area(mesh: Geometry) -> float:
    a, b, c = (mesh.vertices[mesh.faces[:, k]] for k in range(3))
    return float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2.0)


def raw(mesh: Geometry) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    return mesh.vertices.copy(), mesh.faces.astype(np.int64), np.zeros(len(mesh.faces), np.int32)


@pytest.mark.parametrize(
    ("mesh", "size", "low"),
    [
        (triangles.box(4.0, 2.0, 1.5), 12.0, (-2.0, -1.0, 0.0)),
        (triangles.cylinder(0.5, 2.0, 64), 2.0 * 32 * 0.25 * math.sin(2 * math.pi / 64), (-0.5, -0.5, 0.0)),
        (triangles.sphere(1.5, 256), 4 / 3 * math.pi * 1.5**3 * 0.9997, (-1.5, -1.5, 0.0)),
    ],
)
def test_primitives_are_closed_stand_on_their_origin_and_face_outwards(mesh: Geometry, size: float, low: tuple) -> None:
    assert mesh.closed.all()
    assert volume(mesh) == pytest.approx(size, rel=1e-4)
    np.testing.assert_allclose(mesh.vertices.min(axis=0), low, atol=1e-12)
    outwards = mesh.vertices[mesh.faces].mean(axis=1) - mesh.centre
    assert (np.einsum("ij,ij->i", outwards, mesh.normals) > 0).all()
    assert mesh.radius == pytest.approx(np.linalg.norm(mesh.vertices - mesh.centre, axis=1).max())


def test_a_plane_is_centred_open_and_looks_up() -> None:
    mesh = triangles.plane(6.0, 4.0)
    assert area(mesh) == 24.0
    assert not mesh.closed.any()
    np.testing.assert_array_equal(mesh.normals, [[0, 0, 1]] * 2)
    np.testing.assert_array_equal(mesh.vertices.mean(axis=0), [0, 0, 0])


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_a_vertex_that_is_not_finite_is_refused_with_the_number_of_its_triangle(bad: float) -> None:
    vertices, faces, part = raw(triangles.box(1, 1, 1))
    vertices[faces[7, 1]] = [0.0, bad, 0.0]
    first = int(np.flatnonzero((faces == faces[7, 1]).any(axis=1))[0])
    with pytest.raises(SceneError, match=rf"here: triangle {first} has the vertex .*{bad}.*; want finite numbers"):
        checked(vertices, faces, part, ("a",), "here")


def test_a_vertex_without_a_triangle_may_be_anything() -> None:
    vertices, faces, part = raw(triangles.box(1, 1, 1))
    mesh = checked(np.vstack([vertices, [[math.nan] * 3]]), faces, part, ("a",), "here")
    assert math.isfinite(mesh.radius)


def test_an_empty_mesh_is_refused() -> None:
    with pytest.raises(SceneError, match="here: no triangles"):
        checked(np.zeros((3, 3)), np.zeros((0, 3), int), np.zeros(0), ("a",), "here")


def test_an_index_beyond_the_vertices_is_refused() -> None:
    with pytest.raises(SceneError, match=r"here: triangle 1 names vertex \[0, 1, 3\]; want 0\.\.2"):
        checked(np.eye(3), np.array([[0, 1, 2], [0, 1, 3]]), np.zeros(2), ("a",), "here")


def test_triangles_of_no_area_are_left_out_and_counted() -> None:
    vertices, faces, part = raw(triangles.box(1, 1, 1))
    flat = [[0, 0, 1], [2, 2, 2], [0, 1, 1]]
    mesh = checked(vertices, np.vstack([faces, flat]), np.concatenate([part, [0, 0, 0]]), ("a",), "here")
    assert (mesh.dropped, len(mesh.faces)) == (3, 12)
    assert mesh.closed.all()
    with pytest.raises(SceneError, match="all 3 triangles have no area"):
        checked(vertices, np.array(flat), np.zeros(3), ("a",), "here")


def test_a_mesh_wound_inwards_is_turned() -> None:
    vertices, faces, part = raw(triangles.sphere(1.0, 16))
    mesh = checked(vertices, faces[:, ::-1], part, ("a",), "here")
    assert mesh.closed.all()
    assert volume(mesh) > 0
    outwards = mesh.vertices[mesh.faces].mean(axis=1) - mesh.centre
    assert (np.einsum("ij,ij->i", outwards, mesh.normals) > 0).all()


def test_a_cavity_keeps_facing_its_own_inside() -> None:
    vertices, faces, part = raw(triangles.box(4, 4, 4))
    inner, inner_faces, inner_part = raw(triangles.box(1, 1, 1))
    both = np.vstack([vertices, inner + np.array([0.0, 0.0, 1.0])])
    mesh = checked(
        both, np.vstack([faces, inner_faces[:, ::-1] + len(vertices)]), np.concatenate([part, inner_part]), ("a",), "x"
    )
    assert mesh.closed.all()
    assert volume(mesh) == pytest.approx(63.0)


def test_a_hole_makes_only_its_own_shell_open() -> None:
    vertices, faces, part = raw(triangles.box(1, 1, 1))
    far = vertices + np.array([5.0, 0.0, 0.0])
    mesh = checked(
        np.vstack([vertices, far]), np.vstack([faces[1:], faces + 8]), np.concatenate([part[1:], part]), ("a",), "x"
    )
    assert mesh.closed.tolist() == [False] * 11 + [True] * 12


def test_shells_that_share_an_edge_are_both_closed() -> None:
    vertices, faces, part = raw(triangles.box(1, 1, 1))
    other = vertices + np.array([1.0, 1.0, 0.0])
    mesh = checked(np.vstack([vertices, other]), np.vstack([faces, faces + 8]), np.concatenate([part] * 2), ("a",), "x")
    assert mesh.closed.all()


def test_vertices_repeated_for_every_triangle_are_recognised_as_one() -> None:
    vertices, faces, part = raw(triangles.sphere(1.0, 12))
    soup = vertices[faces].reshape(-1, 3)
    assert checked(soup, np.arange(len(soup)).reshape(-1, 3), part, ("a",), "x").closed.all()


def test_coplanar_twins_of_different_parts_are_counted() -> None:
    vertices, faces, part = raw(triangles.box(1, 1, 1))
    twice = np.vstack([faces, faces[:2][:, [1, 2, 0]]])
    assert checked(vertices, twice, np.concatenate([part, [1, 1]]), ("a", "b"), "x").coplanar == 2
    assert checked(vertices, twice, np.concatenate([part, [0, 0]]), ("a", "b"), "x").coplanar == 0


def test_utm_coordinates_leave_the_shape_as_it_is() -> None:
    vertices, faces, part = raw(triangles.box(2, 2, 2))
    mesh = checked(vertices + np.array([5e6, 5e5, 100.0]), faces, part, ("a",), "x")
    np.testing.assert_array_equal(mesh.normals, triangles.box(2, 2, 2).normals)
    assert mesh.radius == pytest.approx(math.sqrt(3.0), rel=1e-9)
