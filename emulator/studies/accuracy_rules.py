"""Rules for a beam's sub-beams on targets whose answer is known: bare numpy, no mesh and no ray caster.

Random edges and wires across a Gaussian beam, tilted planes, composed scenes. Belongs here: rules by name, targets,
errors. Not: the product's own path (accuracy_path), how the errors are shown (accuracy).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from emulator.physics import adaptive, beams, radiometry, tilted
from emulator.physics.arrays import Floats, Ints
from emulator.physics.beams import Bundle

WIRE = 0.1
"Width of a wire in radii of the beam."
SMOOTH_HALF_ANGLE_RAD = 0.5 * 12.913e-3
SMOOTH_TILT_RAD = math.radians(80.0)
PIECE = 1 << 16
"Nodes that are held against all targets at once."
REFERENCE = 1 << 20
"Sub-beams of a reference without closed form."


def _square(count: int) -> int:
    return max(1, round(math.sqrt(count)))


FIXED: dict[str, Callable[[int, np.random.Generator], Bundle]] = {
    "spiral": lambda n, rng: beams.spiral(n),
    "gauss_legendre": lambda n, rng: beams.gauss_legendre(*product(n)),
    "sobol": lambda n, rng: beams.sobol(n),
    "halton": lambda n, rng: beams.halton(n),
    "grid": lambda n, rng: beams.grid(_square(n)),
    "rings": lambda n, rng: beams.rings(*product(n)),
    "laguerre": lambda n, rng: beams.laguerre(*product(n)),
    "hermite": lambda n, rng: beams.hermite(_square(n)),
    "monte_carlo": lambda n, rng: beams.from_square(rng.random(n), rng.random(n)),
}
"Every fixed rule with about so many sub-beams."
TITLES = {
    "spiral": "spiral",
    "gauss_legendre": "Gauss-Legendre x trapezoid",
    "sobol": "Sobol",
    "halton": "Halton",
    "grid": "grid",
    "rings": "rings",
    "laguerre": "Gauss-Laguerre",
    "hermite": "Gauss-Hermite",
    "monte_carlo": "Monte Carlo",
    "adaptive": "adaptive",
}


def product(count: int) -> tuple[int, int]:
    """Rings and angles of a product rule with about `count` nodes."""
    rings = _square(count)
    return rings, max(1, round(count / rings))


# ------------------------------------------------------------------------------- edges and wires
@dataclass(frozen=True, eq=False)
class Strips:
    """Strips across a beam: u cos(turn) + v sin(turn) between `low` and `high`, all in radii of the beam."""

    turn_rad: Floats
    low: Floats
    high: Floats

    def __len__(self) -> int:
        return len(self.turn_rad)

    @property
    def share(self) -> Floats:
        """What of the beam's power falls on each: closed form."""
        one = np.ones(len(self))
        below = np.where(np.isneginf(self.low), 0.0, radiometry.fill_edge(np.maximum(self.low, -40.0), one))
        edge = radiometry.fill_edge(self.high, one) - below
        wire = radiometry.fill_strip(np.maximum(self.low, -40.0), self.high, one)
        return np.where(np.isneginf(self.low), edge, wire)

    def holds(self, u: Floats, v: Floats) -> np.ndarray[tuple[int, ...], np.dtype[np.bool_]]:
        """(nodes, strips) which nodes lie on which."""
        across = u[:, None] * np.cos(self.turn_rad) + v[:, None] * np.sin(self.turn_rad)
        return np.asarray((across > self.low) & (across <= self.high))


def edges(count: int, rng: np.random.Generator) -> Strips:
    """Half planes with random turns, their edges evenly within one radius of the axis."""
    return Strips(_turns(count, rng), np.full(count, -np.inf), rng.uniform(-1.0, 1.0, count))


def wires(count: int, rng: np.random.Generator, width: float = WIRE) -> Strips:
    """Thin strips, the same."""
    low = rng.uniform(-1.0, 1.0, count) - 0.5 * width
    return Strips(_turns(count, rng), low, low + width)


def _turns(count: int, rng: np.random.Generator) -> Floats:
    return 2.0 * np.pi * rng.random(count)


def shares(nodes: Bundle, strips: Strips) -> Floats:
    """Share of the beam on each strip as the nodes find it."""
    total = np.zeros(len(strips))
    for first in range(0, len(nodes), PIECE):
        piece = slice(first, first + PIECE)
        total += nodes.share[piece] @ strips.holds(nodes.u[piece], nodes.v[piece])
    return total


def rms(error: Floats) -> float:
    """Root of the mean square."""
    return float(np.sqrt(np.mean(np.square(error))))


def fixed_error(rule: str, count: int, strips: Strips, rng: np.random.Generator) -> tuple[int, float]:
    """Sub-beams, and RMS error of the share over all strips."""
    nodes = FIXED[rule](count, rng)
    return len(nodes), rms(shares(nodes, strips) - strips.share)


def adaptive_error(depth: int, strips: Strips, level: int = 3, thrifty: bool = True) -> tuple[float, float]:
    """Mean of sub-beams cast, and RMS error of the share; 4^level cells, split `depth` times where neighbours differ.

    `thrifty`: only cells whose share is worth it, as `adaptive.worthwhile` says.
    """
    cells = adaptive.start(len(strips), level)
    cast = len(cells)
    label = _label(cells, strips)
    for _ in range(depth):
        chosen = adaptive.differing(cells, label)
        if thrifty:
            chosen = adaptive.worthwhile(cells, chosen)
        if not bool(np.any(chosen)):
            break
        cells = adaptive.split(cells, chosen)
        cast += 4 * int(np.count_nonzero(chosen))
        label = _label(cells, strips)
    found = np.bincount(cells.beam, cells.shares() * label, len(strips))
    return cast / len(strips), rms(found - strips.share)


def _label(cells: adaptive.Cells, strips: Strips) -> Ints:
    u, v = cells.nodes()
    turn = strips.turn_rad[cells.beam]
    across = u * np.cos(turn) + v * np.sin(turn)
    return np.asarray((across > strips.low[cells.beam]) & (across <= strips.high[cells.beam])).astype(np.int64)


# ------------------------------------------------------------------------------- smooth planes
def plane_error(rule: str, count: int, planes: int, rng: np.random.Generator) -> tuple[int, float]:
    """Sub-beams, and RMS relative error of the energy of planes tilted by 80 degrees any way in a beam of 12.9 mrad."""
    nodes = FIXED[rule](count, rng)
    t, slope = math.tan(SMOOTH_HALF_ANGLE_RAD), math.tan(SMOOTH_TILT_RAD)
    turn = _turns(planes, rng)
    u, v = t * nodes.u, t * nodes.v
    across = u[:, None] * np.cos(turn) + v[:, None] * np.sin(turn)
    off = (1.0 + u * u + v * v) ** -1.5
    found = (nodes.share * off) @ np.maximum(1.0 - slope * across, 0.0) ** 3
    wanted = float(tilted.tilted_plane_energy(SMOOTH_HALF_ANGLE_RAD, SMOOTH_TILT_RAD))
    return len(nodes), rms(found / wanted - 1.0)


# ------------------------------------------------------------------------------- composed scenes
@dataclass(frozen=True, eq=False)
class Layers:
    """A wire before a half plane before a tilted wall, for n beams; nothing has a closed form where they cover each
    other. Ranges in m, the first two face-on."""

    wire: Strips
    edge: Strips
    wall_turn_rad: Floats
    "Direction into which the wall recedes."
    half_angle_rad: float = 2.5e-3
    ranges_m: tuple[float, float, float] = (20.0, 20.7, 22.0)
    rho: tuple[float, float, float] = (0.6, 0.3, 0.8)
    wall_tilt_rad: float = math.radians(60.0)

    def __len__(self) -> int:
        return len(self.wire)

    def seen(self, u: Floats, v: Floats) -> tuple[Floats, Floats]:
        """(nodes, n) energy over that of a face-on white plate at 1 m, and range. [1, m]"""
        t = math.tan(self.half_angle_rad)
        x, y = t * u[:, None], t * v[:, None]
        off = 1.0 + x * x + y * y
        slope = math.tan(self.wall_tilt_rad)
        lean = 1.0 - slope * (x * np.cos(self.wall_turn_rad) + y * np.sin(self.wall_turn_rad))
        on_wire, on_edge = self.wire.holds(u, v), self.edge.holds(u, v)
        depth = np.where(on_wire, self.ranges_m[0], np.where(on_edge, self.ranges_m[1], self.ranges_m[2] / lean))
        cosine = np.where(on_wire | on_edge, 1.0, lean / math.hypot(1.0, slope)) / np.sqrt(off)
        rho = np.where(on_wire, self.rho[0], np.where(on_edge, self.rho[1], self.rho[2]))
        range_m = depth * np.sqrt(off)
        return rho * cosine / range_m**2, range_m

    def energy(self, nodes: Bundle) -> tuple[Floats, Floats]:
        """Energy and energy-weighted mean range of each beam. [1, m]"""
        total, moment = np.zeros(len(self)), np.zeros(len(self))
        for first in range(0, len(nodes), PIECE):
            piece = slice(first, first + PIECE)
            energy, range_m = self.seen(nodes.u[piece], nodes.v[piece])
            total += nodes.share[piece] @ energy
            moment += nodes.share[piece] @ (energy * range_m)
        return total, moment / total


def layers(count: int, rng: np.random.Generator) -> Layers:
    """Random ones."""
    return Layers(wires(count, rng, 3.0 * WIRE), edges(count, rng), _turns(count, rng))


def layers_error(
    rule: str, count: int, scenes: Layers, reference: tuple[Floats, Floats], rng: np.random.Generator
) -> tuple[int, float, float]:
    """Sub-beams, RMS relative error of the energy, RMS error of the mean range. [1, 1, m]"""
    nodes = FIXED[rule](count, rng)
    energy, range_m = scenes.energy(nodes)
    return len(nodes), rms(energy / reference[0] - 1.0), rms(range_m - reference[1])


# ------------------------------------------------------------------------------- orders
def slope(x: Sequence[float], y: Sequence[float]) -> float:
    """Least-squares slope of log y over log x through the last three points where y is over 0; NaN for fewer."""
    pairs = [(a, b) for a, b in zip(x, y, strict=True) if a > 0.0 and b > 0.0][-3:]
    if len(pairs) < 3:
        return math.nan
    logs = np.log(np.asarray(pairs, dtype=np.float64))
    return float(np.polyfit(logs[:, 0], logs[:, 1], 1)[0])


def needed(x: Sequence[float], y: Sequence[float], allowed: float) -> float | None:
    """Least x at which y has come down to `allowed` for good, between points by the straight line in logarithms."""
    over = [index for index, value in enumerate(y) if value > allowed]
    if not over:
        return x[0]
    last = over[-1]
    if last + 1 == len(y):
        return None
    if y[last + 1] <= 0.0:
        return x[last + 1]
    part = math.log(y[last] / allowed) / math.log(y[last] / y[last + 1])
    return float(x[last] * (x[last + 1] / x[last]) ** part)
