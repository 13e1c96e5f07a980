"""Shares of a Gaussian beam on polygons, against the normal law and against random rays."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from emulator.physics import polygons
from tests.draws import cases

Floats = NDArray[np.float64]


def _phi(x: float) -> float:
    return 0.5 * math.erfc(-x / math.sqrt(2.0))


@pytest.mark.parametrize("offset", [-1.0, 0.0, 0.7, 1.0, 1.5, 2.0, 2.5, 3.0])
@pytest.mark.parametrize("turn", [0.0, 0.4, 2.2])
def test_a_half_plane_is_the_normal_law(offset: float, turn: float) -> None:
    """Also of triangles that reach around the axis; the middle is that of the tail."""
    c, s = math.cos(turn), math.sin(turn)
    corner = np.array([[offset, -90.0], [offset + 90.0, 0.0], [offset, 90.0]]) @ np.array([[c, s], [-s, c]])
    share, middle = polygons.gaussian_share(np.stack([corner, corner[::-1]]))
    assert share == pytest.approx(np.full(2, _phi(-2.0 * offset)), rel=1e-7)
    mean = 0.5 * math.exp(-2.0 * offset**2) / math.sqrt(2.0 * math.pi) / _phi(-2.0 * offset)
    assert middle == pytest.approx(np.tile([mean * c, mean * s], (2, 1)), rel=1e-6, abs=1e-9)


@settings(max_examples=cases(60), deadline=None)
@given(st.lists(st.integers(-250, 250), min_size=6, max_size=6))
def test_a_triangle_gets_the_rays_that_fall_on_it(numbers: list[int]) -> None:
    corner = 0.01 * np.reshape(numbers, (1, 3, 2))
    way = corner[0, 1:] - corner[0, 0]
    assume(abs(way[0, 0] * way[1, 1] - way[0, 1] * way[1, 0]) > 1e-3)
    rays = 0.5 * np.random.default_rng(3).standard_normal((200_000, 2))
    inside = polygons.within(corner, rays[None])[0]
    share, middle = polygons.gaussian_share(corner)
    assert share[0] == pytest.approx(inside.mean(), abs=5.0 * math.sqrt((share[0] + 1e-5) / len(rays)))
    if inside.sum() > 100:
        assert middle[0] == pytest.approx(rays[inside].mean(axis=0), abs=5.0 / math.sqrt(inside.sum()))


def test_the_least_distance_is_that_of_the_nearest_place() -> None:
    triangles = [[1.0, -1.0, 1.0, 1.0, 3.0, 0.0], [-1.0, -1.0, 1.0, -1.0, 0.0, 2.0], [2.0, 2.0, 3.0, 2.0, 2.0, 3.0]]
    assert polygons.offset_of(np.reshape(triangles, (3, 3, 2))) == pytest.approx([1.0, 0.0, math.sqrt(8.0)])


@settings(max_examples=cases(25), deadline=None)
@given(st.lists(st.integers(-100, 100), min_size=9, max_size=9))
def test_what_reaches_behind_the_pupil_keeps_its_light(numbers: list[int]) -> None:
    """Each ray of a beam on its own (Moeller and Trumbore)."""
    corner = np.reshape(numbers, (3, 3)) * [0.004, 0.004, 0.12] + [0.0, 0.0, 8.0]
    side, other = corner[1] - corner[0], corner[2] - corner[0]
    normal = np.cross(side, other)
    if abs(normal @ corner[0]) < 1e-3 * np.linalg.norm(normal) or np.linalg.norm(normal) < 1e-3:
        return  # seen from its edge
    if corner[:, 2].max() <= 0.0:
        return
    grow, w0, rays = np.array([0.012, 0.008]), 0.0, 200_000
    uv = 0.5 * np.random.default_rng(5).standard_normal((rays, 2))
    ray, start = np.column_stack([uv * grow, np.ones(rays)]), np.column_stack([uv * w0, np.zeros(rays)])
    p = np.cross(ray, other)
    determinant = p @ side
    a = np.einsum("ij,ij->i", start - corner[0], p) / determinant
    q = np.cross(start - corner[0], side)
    b, distance = np.einsum("ij,ij->i", ray, q) / determinant, (q @ other) / determinant
    expected = float(np.mean((a >= 0.0) & (b >= 0.0) & (a + b <= 1.0) & (distance > 0.0)))
    own = polygons.before_pupil(corner[None])
    share, _ = polygons.gaussian_share(own[:, :, :2] / (grow * own[:, :, 2:] + w0))
    assert share[0] == pytest.approx(expected, abs=0.005 * expected + 5.0 * math.sqrt((expected + 1e-5) / rays))
