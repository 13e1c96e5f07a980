"""Leaves of crowns and hedges: how much of them a ray sees, and where it meets the first.

Belongs here: leaf angle distributions, Ross's projection G, cells that hold leaves, walks of rays through them. Not:
which bodies are full of leaves (materials), where rays enter and leave them (casting.detail).

Leaves are small, and independent of each other: a path s through a density of L m2/m3 is free with the probability
exp(-G L s) (Nilson 1971). They are bound to their body: its space is cut into cells about as large as a leaf, and each
cell has an exponential number of its own, from a hash. A ray that has seen so much leaf area within the cell meets its
leaf there. So every ray by itself has the law to the last digit, whichever way it goes; and rays through the same cells
meet the same leaves: neighbouring beams, beams of another sensor, and those of the next sweep.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import lru_cache
from types import MappingProxyType, ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from emulator.compiled.pair import by_loops
from emulator.physics.arrays import Floats, Ints, floats, indexes
from emulator.physics.world_particles import STEP, Words, cell_words, mixed, three, unit

Law = str | float
"Of leaf inclinations: a name of `LAWS`, or Campbell's ratio of axes."
LAWS: Mapping[str, Callable[[Floats], Floats]] = MappingProxyType(
    {
        "spherical": np.sin,
        "uniform": np.ones_like,
        "planophile": lambda a: 1.0 + np.cos(2.0 * a),
        "erectophile": lambda a: 1.0 - np.cos(2.0 * a),
        "plagiophile": lambda a: 1.0 - np.cos(4.0 * a),
        "extremophile": lambda a: 1.0 + np.cos(4.0 * a),
    }
)
"Density over the inclination of leaves, 0 lying to pi/2 standing, up to a factor: de Wit 1965; Goel and Strebel 1984."
RATIOS = (0.01, 100.0)
"Campbell's ratio of axes, least and largest."
NODES = 2048
"Of the integral over inclinations."
ANGLES = 721
"Zenith angles for which G is tabulated: an eighth of a degree; linear between them it is good to 1e-5."
MOST_DRAWS = 200
"Leaves that are tried for one that the ray sees; G is 5e-3 at the least where 37 % are left."
LARGEST_WALK = 20_000
"Cells across a body: a body that has more wants larger leaves."


@dataclass(frozen=True)
class Foliage:
    """What a body is full of."""

    leaf_area_density_m2_m3: float
    "One-sided area of the leaves in a cubic metre."
    leaf_angle: Law = "spherical"
    leaf_size_m: float = 0.05
    "Diameter of a disc of the leaf's area."

    @property
    def cell_m(self) -> float:
        """Edge of a cell in which all rays meet the same leaf.

        That of a square of two thirds of the leaf's area: then the shares of wide beams that leaves stop vary from
        place to place as with discs of that size, whose mean square shadow over its mean is 2/3 of the area where they
        point to all sides alike.
        """
        return math.sqrt(2.0 / 3.0 * math.pi / 4.0) * self.leaf_size_m


# ---------------------------------------------------------------- angles


def density_of(law: Law, inclination_rad: Floats) -> Floats:
    """Density of leaf inclinations, of integral 1 over 0 to pi/2. [1/rad]

    References
    ----------
    .. [1] Campbell 1990, Agric. For. Meteorol. 49, 173: for ratios chi of the axes of an ellipsoid.
    """
    a = floats(inclination_rad)
    return np.asarray(_raw(law, a) / _raw(law, _nodes()).sum() * NODES / (0.5 * math.pi))


def _raw(law: Law, a: Floats) -> Floats:
    if isinstance(law, str):
        return np.asarray(LAWS[law](a), np.float64)
    return np.asarray(np.sin(a) / (np.cos(a) ** 2 + law * law * np.sin(a) ** 2) ** 2)


def _nodes() -> Floats:
    return (np.arange(NODES, dtype=np.float64) + 0.5) * (0.5 * math.pi / NODES)


def projection(law: Law, cosine: Floats) -> Floats:
    """Ross's G: mean projected share of leaf area along a ray with this cosine to the body's upright axis.

    Parameters
    ----------
    law : of leaf inclinations; azimuths are uniform
    cosine : any shape, -1 to 1

    Returns
    -------
    g : same shape, 0 to 1; 1/2 for spherical

    References
    ----------
    .. [1] Warren Wilson 1960, New Phytol. 59, 1, eq. for A(theta, alpha); Ross 1981, The Radiation Regime, ch. 2.
    """
    angle = np.arccos(np.minimum(np.abs(floats(cosine)), 1.0)) * ((ANGLES - 1) / (0.5 * math.pi))
    table = projections(law)
    low = np.minimum(angle.astype(np.int64), ANGLES - 2)
    part = angle - low
    return np.asarray(table[low] * (1.0 - part) + table[low + 1] * part)


@lru_cache(maxsize=64)
def projections(law: Law) -> Floats:
    """(`ANGLES`,) G at zenith angles from 0 to pi/2; read-only."""
    if law == "spherical":
        found = np.full(ANGLES, 0.5)
    else:
        theta = np.linspace(0.0, 0.5 * math.pi, ANGLES)[:, None]
        found = _areas(theta, _nodes()) @ density_of(law, _nodes()) * (0.5 * math.pi / NODES)
    found.flags.writeable = False
    return found


def _areas(theta: Floats, inclination: Floats) -> Floats:
    """Projected share of leaves of one inclination and all azimuths."""
    level = np.cos(theta) * np.cos(inclination)
    steep = np.sin(theta) * np.sin(inclination)
    psi = np.arccos(np.minimum(level / np.maximum(steep, 1e-300), 1.0))
    root = np.sqrt(np.maximum(steep * steep - level * level, 0.0))
    return np.asarray(level * (1.0 - 2.0 / math.pi * psi) + 2.0 / math.pi * root)


@lru_cache(maxsize=64)
def _quantiles(law: Law) -> Floats:
    """Inclinations up to which 0, 1/4096, .. of the leaves are."""
    edges = np.linspace(0.0, 0.5 * math.pi, NODES + 1)
    whole = np.concatenate([[0.0], density_of(law, _nodes()).cumsum()])
    whole += np.linspace(0.0, 1e-9, len(whole))
    return np.asarray(np.interp(np.linspace(0.0, 1.0, 4097), whole / whole[-1], edges))


def leaf_normals(law: Law, word: Words, along: Floats) -> Floats:
    """Normals (k, 3) of the leaves that rays meet in the cells of these numbers, in the body's frame, facing the rays.

    Of all leaves a ray meets those more often that it sees broad: their chance goes with the cosine.
    """
    found = np.zeros((len(word), 3))
    left = np.arange(len(word))
    table = _quantiles(law)
    for draw in range(MOST_DRAWS):
        if not len(left):
            break
        number = mixed(word[left] + np.uint64((2 * draw + 2) * int(STEP) % 2**64))
        uniform = three(number)
        a = np.interp(uniform[:, 0], np.linspace(0.0, 1.0, len(table)), table)
        turn = 2.0 * math.pi * uniform[:, 1]
        normal = np.stack([np.sin(a) * np.cos(turn), np.sin(a) * np.sin(turn), np.cos(a)], axis=1)
        cosine = np.einsum("ij,ij->i", normal, along[left])
        found[left] = np.where(cosine > 0.0, -1.0, 1.0)[:, None] * normal
        left = left[uniform[:, 2] >= np.abs(cosine)]
    return found


# ---------------------------------------------------------------- walks


def key_of(seed: int, body: int) -> np.uint64:
    """Where the numbers of a body's cells begin."""
    digest = hashlib.blake2b(f"{seed}\0leaves\0{body}".encode(), digest_size=8).digest()
    return np.uint64(int.from_bytes(digest, "little"))


def offset_of(key: np.uint64) -> Floats:
    """(3,) share of a cell by which a body's cells are moved: no border lies where axes and edges do."""
    return np.asarray(three(mixed(np.array([key ^ STEP])))[0])


@dataclass(frozen=True, eq=False)
class Walks:
    """Stretches of m rays through bodies full of leaves, in the bodies' frames."""

    origin_m: Floats
    "(m, 3)"
    along: Floats
    "(m, 3) unit vectors."
    begin_m: Floats
    end_m: Floats
    rate_m: Floats
    "(m,) G times density: leaf area seen along a metre."
    cell_m: float
    key: np.uint64
    "Of the body."


def _first_leaves_by_loops(loops: ModuleType, walks: Walks) -> tuple[Floats, Words]:
    stop, word = np.full(len(walks.end_m), np.nan), np.zeros(len(walks.end_m), np.int64)
    loops.leaves(
        int(walks.key.astype(np.int64)), offset_of(walks.key), walks.cell_m, walks.origin_m, walks.along,
        walks.begin_m, walks.end_m, walks.rate_m, stop, word,
    )  # fmt: skip
    return stop, word.view(np.uint64)


@by_loops(_first_leaves_by_loops, "leaves")
def first_leaves(walks: Walks) -> tuple[Floats, Words]:
    """(m,) where each ray meets its first leaf, NaN for none, and the numbers of the cells that hold them."""
    stop, words = np.full(len(walks.end_m), np.nan), np.zeros(len(walks.end_m), np.uint64)
    rays = indexes((walks.end_m > walks.begin_m) & (walks.rate_m > 0.0))
    at, end, rate = walks.begin_m[rays], walks.end_m[rays], walks.rate_m[rays]
    along = walks.along[rays]
    start = (walks.origin_m[rays] + at[:, None] * along) / walks.cell_m + offset_of(walks.key)
    cell = np.floor(start).astype(np.int64)
    step = np.where(along > 0.0, 1, -1)
    with np.errstate(divide="ignore"):
        pace = np.where(along == 0.0, np.inf, walks.cell_m / np.abs(along))
    ahead = np.where(along > 0.0, cell + 1.0 - start, start - cell)
    with np.errstate(invalid="ignore"):
        border = np.where(along == 0.0, np.inf, at[:, None] + ahead * pace)
    while len(rays):
        axis = border.argmin(axis=1)
        row = np.arange(len(rays))
        until = np.minimum(border[row, axis], end)
        word = cell_words(walks.key, cell)
        place = at + _exponential(word) / rate
        hit = place < until
        stop[rays[hit]], words[rays[hit]] = place[hit], word[hit]
        at = np.maximum(at, until)
        cell[row, axis] += step[row, axis]
        border[row, axis] += pace[row, axis]
        on = indexes(~hit & (until < end))
        if len(on) < len(rays):
            rays, at, end, rate, cell, step, pace, border = _taken(on, rays, at, end, rate, cell, step, pace, border)
    return stop, words


def _taken(on: Ints, *columns: NDArray[Any]) -> tuple[NDArray[Any], ...]:
    return tuple(column[on] for column in columns)


def _exponential(word: Words) -> Floats:
    """The leaf area that a ray sees in a cell before it meets a leaf."""
    return np.asarray(-np.log1p(-unit(mixed(word + STEP))))
