"""Leaves against closed forms, published figures, and discs that are thrown into space one by one."""

from __future__ import annotations

import math

import numpy as np
import pytest

from emulator.compiled import switch
from emulator.physics import foliage
from emulator.physics.foliage import LAWS, Law, Walks

DEGREES = (0.0, 20.0, 40.0, 57.5, 75.0, 90.0)
DENSITY = {
    "spherical": lambda a: np.sin(a),
    "uniform": lambda a: np.full_like(a, 2.0 / np.pi),
    "planophile": lambda a: 2.0 / np.pi * (1.0 + np.cos(2.0 * a)),
    "erectophile": lambda a: 2.0 / np.pi * (1.0 - np.cos(2.0 * a)),
    "plagiophile": lambda a: 2.0 / np.pi * (1.0 - np.cos(4.0 * a)),
    "extremophile": lambda a: 2.0 / np.pi * (1.0 + np.cos(4.0 * a)),
}
"Goel and Strebel 1984, table 1."


def leaves_thrown(law: str, count: int, rng: np.random.Generator) -> np.ndarray:
    """Normals (count, 3), by rejection."""
    found = np.zeros((0, 3))
    while len(found) < count:
        a = rng.uniform(0.0, 0.5 * np.pi, 4 * count)
        a = a[rng.uniform(0.0, 1.5, 4 * count) < DENSITY[law](a)]
        turn = rng.uniform(0.0, 2.0 * np.pi, len(a))
        found = np.concatenate([found, np.stack([np.sin(a) * np.cos(turn), np.sin(a) * np.sin(turn), np.cos(a)], 1)])
    return found[:count]


def ray_at(degrees: float) -> np.ndarray:
    return np.array([math.sin(math.radians(degrees)), 0.0, -math.cos(math.radians(degrees))])


def walks(rays: int, law: Law, degrees: float, density: float, path_m: float, seed: int = 1) -> Walks:
    """Parallel rays far apart."""
    rng = np.random.default_rng(seed)
    along = np.broadcast_to(ray_at(degrees), (rays, 3)).copy()
    rate = density * foliage.projection(law, along[:, 2])
    end = np.full(rays, path_m)
    return Walks(
        rng.uniform(-300.0, 300.0, (rays, 3)), along, np.zeros(rays), end, rate, 0.036, foliage.key_of(seed, 0)
    )


@pytest.mark.parametrize("law", LAWS)
def test_g_is_the_mean_projection_of_leaves_thrown_one_by_one(law: str) -> None:
    normal = leaves_thrown(law, 200_000, np.random.default_rng(7))
    for degrees in DEGREES:
        seen = np.abs(normal @ ray_at(degrees))
        bound = 4.0 * seen.std() / math.sqrt(len(seen))
        assert foliage.projection(law, np.cos(np.radians(degrees))) == pytest.approx(seen.mean(), abs=bound)


def test_g_has_the_published_values() -> None:
    """De Wit's four laws from above in closed form; 57.5 degrees, where all are near one half (Warren Wilson 1963)."""
    above = {"planophile": 8.0, "erectophile": 4.0, "plagiophile": 32.0 / 5.0, "extremophile": 28.0 / 5.0}
    for law, factor in above.items():
        assert float(foliage.projection(law, np.array(1.0))) == pytest.approx(factor / (3.0 * math.pi), rel=1e-5)
    assert float(foliage.projection("spherical", np.array(0.3))) == 0.5
    for law in ("spherical", "uniform", "planophile", "erectophile", "plagiophile"):
        assert float(foliage.projection(law, np.cos(np.radians(57.5)))) == pytest.approx(0.5, abs=0.022)


@pytest.mark.parametrize("ratio", [0.3, 1.0, 2.0, 5.0])
def test_ellipsoidal_leaves_have_campbells_extinction(ratio: float) -> None:
    """Campbell and Norman 1998, eq. 15.4, whose constants are a fit good to half a per cent."""
    for degrees in (0.0, 30.0, 60.0, 80.0):
        tangent = math.tan(math.radians(degrees))
        k = math.sqrt(ratio**2 + tangent**2) / (ratio + 1.774 * (ratio + 1.182) ** -0.733)
        cosine = math.cos(math.radians(degrees))
        assert float(foliage.projection(ratio, np.array(cosine))) == pytest.approx(k * cosine, rel=0.008)


@pytest.mark.parametrize("law", [*LAWS, 2.5])
def test_densities_of_inclinations_have_integral_one(law: Law) -> None:
    a = (np.arange(5000) + 0.5) * 0.5 * math.pi / 5000
    assert foliage.density_of(law, a).sum() * 0.5 * math.pi / 5000 == pytest.approx(1.0, rel=1e-5)


@pytest.mark.parametrize(("law", "degrees"), [("spherical", 10.0), ("planophile", 60.0), ("erectophile", 30.0)])
def test_the_gap_and_where_rays_end_are_those_of_discs_in_space(law: str, degrees: float) -> None:
    rng = np.random.default_rng(3)
    density, path_m, radius, half, rays = 2.0, 1.0, 0.03, 1.2, 1500
    along = ray_at(degrees)
    number = rng.poisson(density / (math.pi * radius**2) * (2.0 * half) ** 3)
    place, normal = rng.uniform(-half, half, (number, 3)), leaves_thrown(law, number, rng)
    start = rng.uniform(-0.65, 0.65, (rays, 3)) - 0.5 * path_m * along
    end = np.full(rays, np.inf)
    across = np.array([[0.0, 1.0, 0.0], [-along[2], 0.0, along[0]]])
    seen, from_here = across @ place.T, start @ across.T
    for one, start_one in enumerate(start):
        # no disc is met whose centre is farther from the ray than its radius
        near = np.flatnonzero(np.square(seen - from_here[one][:, None]).sum(axis=0) < radius**2)
        r = np.einsum("ij,ij->i", place[near] - start_one, normal[near]) / (normal[near] @ along)
        off = start_one + r[:, None] * along - place[near]
        met = (r > 0.0) & (r < path_m) & (np.einsum("ij,ij->i", off, off) < radius**2)
        end[one] = r[met].min(initial=np.inf)
    g = float(foliage.projection(law, along[2]))
    made, _ = foliage.first_leaves(walks(200_000, law, degrees, density, path_m))
    free = math.exp(-g * density * path_m)
    assert np.isnan(made).mean() == pytest.approx(free, abs=4.0 * math.sqrt(free / 200_000))
    assert np.isinf(end).mean() == pytest.approx(np.isnan(made).mean(), abs=0.05)
    for share in (0.2, 0.4):
        assert np.quantile(end, share) == pytest.approx(
            np.nanquantile(np.where(np.isnan(made), 99.0, made), share), rel=0.2
        )


@pytest.mark.parametrize("degrees", [0.0, 35.0, 90.0])
def test_leaves_are_met_with_beers_law(degrees: float) -> None:
    """Along an axis of the cells as well, and independent of their size."""
    made, word = foliage.first_leaves(walks(200_000, "spherical", degrees, 3.0, 4.0))
    met = ~np.isnan(made)
    depth = 1.5 * np.sort(made[met])
    law = -np.expm1(-depth) / -math.expm1(-6.0)
    assert np.abs(law - (np.arange(len(depth)) + 0.5) / len(depth)).max() < 1.95 / math.sqrt(len(depth))  # Kolmogorov
    assert len(np.unique(word[met])) > 0.99 * met.sum()


@pytest.mark.parametrize("law", ["spherical", "planophile", "erectophile"])
@pytest.mark.parametrize("degrees", [5.0, 70.0])
def test_leaves_that_are_met_face_the_ray_as_often_as_they_look_broad(law: str, degrees: float) -> None:
    made, word = foliage.first_leaves(walks(60_000, law, degrees, 3.0, 4.0))
    word = word[~np.isnan(made)]
    along = np.broadcast_to(ray_at(degrees), (len(word), 3))
    cosine = -np.einsum("ij,ij->i", foliage.leaf_normals(law, word, along), along)
    thrown = np.abs(leaves_thrown(law, 200_000, np.random.default_rng(5)) @ ray_at(degrees))
    assert cosine.min() > 0.0
    assert cosine.mean() == pytest.approx((thrown**2).mean() / thrown.mean(), rel=0.01)
    assert (cosine**2).mean() == pytest.approx((thrown**3).mean() / thrown.mean(), rel=0.015)


def test_wide_beams_flicker_as_behind_discs() -> None:
    """Share of a beam of 12 cm that passes 0.6 m of spherical leaves of 4 cm: its spread over 1500 places."""
    rng = np.random.default_rng(11)
    density, path_m, radius, wide, sub = 2.5, 0.6, 0.02, 0.12, 8
    grid = (np.arange(sub) + 0.5) / sub * wide
    y, z = (part.ravel() for part in np.meshgrid(grid, grid))
    shares = []
    for _ in range(1500):
        room = np.array([path_m, wide + 0.1, wide + 0.1])
        number = rng.poisson(density / (math.pi * radius**2) * room.prod())
        place = rng.uniform(0.0, 1.0, (number, 3)) * room - [0.0, 0.05, 0.05]
        normal = leaves_thrown("spherical", number, rng)
        with np.errstate(divide="ignore"):
            x = ((place * normal).sum(1)[:, None] - normal[:, 1:2] * y - normal[:, 2:] * z) / normal[:, :1]
        off = (x - place[:, :1]) ** 2 + (y - place[:, 1:2]) ** 2 + (z - place[:, 2:]) ** 2
        shares.append(1.0 - (off < radius**2).any(axis=0).mean())
    leaf = foliage.Foliage(density, "spherical", 2.0 * radius)
    origin = rng.uniform(-500.0, 500.0, (1500, 1, 3)) + np.stack([np.zeros_like(y), y, z], 1)
    origin = origin.reshape(-1, 3)
    along = np.broadcast_to([1.0, 0.0, 0.0], origin.shape).copy()
    flat = np.zeros(len(origin))
    rays = Walks(origin, along, flat, flat + path_m, flat + 0.5 * density, leaf.cell_m, foliage.key_of(1, 0))
    ours = np.isnan(foliage.first_leaves(rays)[0]).reshape(1500, -1).mean(axis=1)
    assert np.mean(shares) == pytest.approx(math.exp(-0.75), abs=0.02)
    assert ours.mean() == pytest.approx(math.exp(-0.75), abs=0.02)
    assert ours.std() == pytest.approx(np.std(shares), rel=0.12)


def test_loops_meet_the_same_leaves() -> None:
    pytest.importorskip("numba")
    rng = np.random.default_rng(2)
    along = rng.normal(size=(3000, 3))
    along[:300, 0] = 0.0
    along[300:400, 1:] = 0.0
    along /= np.linalg.norm(along, axis=1)[:, None]
    begin = rng.uniform(-1.0, 1.0, 3000)
    end, rate = begin + rng.uniform(-0.2, 3.0, 3000), rng.uniform(0.0, 2.0, 3000)
    rate[::10] = 0.0
    given = Walks(rng.uniform(-5.0, 5.0, (3000, 3)), along, begin, end, rate, 0.05, foliage.key_of(5, 3))
    made = []
    for on in (False, True):
        with switch.switched(on):
            made.append(foliage.first_leaves(given))
    np.testing.assert_allclose(made[0][0], made[1][0], rtol=1e-12)
    np.testing.assert_array_equal(made[0][1], made[1][1])
    assert 500 < np.isfinite(made[0][0]).sum() < 2600
