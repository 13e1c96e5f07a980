"""Bundles of sub-beams: where the power of a beam goes, as nodes and shares, and the directions of a whole scan.

Here: the rules by name, elliptical beams with roll and exit aperture, unit vectors (n, m, 3). Not here: splitting cells
after a look at the scene (adaptive) and what the sub-beams hit.

Nodes are kept in units of the beam's own half angle: (u, v) = (tan beta_x / tan theta_x, tan beta_y / tan theta_y), so
one bundle serves every beam of a sensor. Gaussian: power density 2/pi exp(-2 (u^2 + v^2)); top-hat: 1/pi inside the
unit circle.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy import special

from emulator.physics.arrays import Floats, Values, floats

Profile = Literal["gauss", "tophat"]
MAX_DIVERGENCE_RAD = math.radians(20.0)
"Full angle up to which the flat angular coordinates are offered."
NO_WIDTH = 1e-100
"Half angles in rad and radii in m below this are none: the squares of smaller ones are no numbers."
GOLDEN_ANGLE_RAD = math.pi * (3.0 - math.sqrt(5.0))
_GRID_HALF_WIDTH = 2.0
"Where the outermost cells of `grid` would end if they were not extended to infinity, in beam radii."


@dataclass(frozen=True, eq=False)
class Bundle:
    """m nodes (u, v) in units of the half angle, and their shares of the power, which sum to 1."""

    u: Floats
    v: Floats
    share: Floats

    def __len__(self) -> int:
        return len(self.share)


@dataclass(frozen=True)
class BeamShape:
    """Angular shape of a beam: half angles (1/e^2 or edge), roll about the axis, radius at the exit window."""

    half_angle_x_rad: float
    "Across: along growing azimuth when roll is 0."
    half_angle_y_rad: float
    "Upwards when roll is 0."
    profile: Profile = "gauss"
    roll_rad: float = 0.0
    exit_radius_m: float = 0.0

    def __post_init__(self) -> None:
        for name in ("half_angle_x_rad", "half_angle_y_rad"):
            value = getattr(self, name)
            if not (math.isfinite(value) and 0.0 <= 2.0 * value <= MAX_DIVERGENCE_RAD):
                raise ValueError(f"{name}: {value}; want a half angle from 0 to {MAX_DIVERGENCE_RAD / 2.0:.6f} rad")
        if self.profile not in ("gauss", "tophat"):
            raise ValueError(f"profile: {self.profile!r}; want gauss or tophat")
        if not math.isfinite(self.roll_rad):
            raise ValueError(f"roll_rad: {self.roll_rad}; want a finite number")
        if not (math.isfinite(self.exit_radius_m) and self.exit_radius_m >= 0.0):
            raise ValueError(f"exit_radius_m: {self.exit_radius_m}; want a number >= 0")

    @classmethod
    def round(cls, divergence_rad: float, profile: Profile = "gauss", exit_radius_m: float = 0.0) -> BeamShape:
        """A round beam of this full divergence."""
        return cls(0.5 * divergence_rad, 0.5 * divergence_rad, profile, 0.0, exit_radius_m)

    @property
    def is_ray(self) -> bool:
        """True when the beam has neither angle nor width: one axis ray is all there is."""
        return max(self.half_angle_x_rad, self.half_angle_y_rad, self.exit_radius_m) < NO_WIDTH

    def radius_m(self, range_m: Values) -> tuple[Floats, Floats]:
        """Radii (across, up) of the footprint at this range: theta R + w0."""
        r = floats(range_m)
        return (
            math.tan(self.half_angle_x_rad) * r + self.exit_radius_m,
            math.tan(self.half_angle_y_rad) * r + self.exit_radius_m,
        )


# ------------------------------------------------------------------------------- rules
def axis() -> Bundle:
    """One ray along the axis: right for one plane over the whole footprint, with the corrections of `tilted`."""
    return Bundle(np.zeros(1), np.zeros(1), np.ones(1))


def spiral(count: int, profile: Profile = "gauss") -> Bundle:
    """Golden-angle spiral of equal shares: the best fixed rule for surfaces with edges."""
    k = np.arange(_counted(count), dtype=np.float64)
    return _polar((k + 0.5) / count, k * GOLDEN_ANGLE_RAD, np.ones(count), profile)


def laguerre(radial: int, angles: int, profile: Profile = "gauss") -> Bundle:
    """Gauss-Laguerre in 2 r^2/w^2 times equal angles: exact to rounding on smooth surfaces.

    For the top-hat, Gauss-Legendre in r^2/w^2.
    """
    if profile == "gauss":
        t, weight = special.roots_laguerre(_counted(radial))
        radius = np.sqrt(0.5 * t)
    else:
        x, weight = special.roots_legendre(_counted(radial))
        radius = np.sqrt(0.5 * (x + 1.0))
    phi = 2.0 * np.pi * np.arange(_counted(angles)) / angles
    u = radius[:, None] * np.cos(phi)
    v = radius[:, None] * np.sin(phi)
    return _bundle(u.ravel(), v.ravel(), np.repeat(weight, angles))


def gauss_legendre(radial: int, angles: int, profile: Profile = "gauss") -> Bundle:
    """Gauss-Legendre in the share inside a radius, times the trapezoidal rule in angle, alternate rings staggered."""
    x, weight = special.roots_legendre(_counted(radial))
    return _rings(0.5 * (x + 1.0), weight, _counted(angles), profile)


def rings(radial: int, angles: int, profile: Profile = "gauss") -> Bundle:
    """Rings of equal share times equal angles, alternate rings staggered."""
    return _rings((np.arange(_counted(radial)) + 0.5) / radial, np.ones(radial), _counted(angles), profile)


def hermite(across: int) -> Bundle:
    """Gauss-Hermite squared; Gaussian beams only."""
    x, weight = special.roots_hermite(_counted(across))
    u, v = np.meshgrid(x / np.sqrt(2.0), x / np.sqrt(2.0), indexing="ij")
    return _bundle(u.ravel(), v.ravel(), np.outer(weight, weight).ravel())


def grid(across: int, profile: Profile = "gauss") -> Bundle:
    """Square grid whose shares are the exact power in each cell, the outermost extended to infinity.

    Top-hat: cells over the square about the circle, shares exact, cells outside dropped.
    """
    n = _counted(across)
    if profile == "gauss":
        edges = np.linspace(-_GRID_HALF_WIDTH, _GRID_HALF_WIDTH, n + 1)
        centre = 0.5 * (edges[1:] + edges[:-1])
        cumulative = special.ndtr(2.0 * edges)
        cumulative[0], cumulative[-1] = 0.0, 1.0
        one = np.diff(cumulative)
        u, v = np.meshgrid(centre, centre, indexing="ij")
        return _bundle(u.ravel(), v.ravel(), np.outer(one, one).ravel())
    edges = np.linspace(-1.0, 1.0, n + 1)
    centre = 0.5 * (edges[1:] + edges[:-1])
    corner = disc_area(edges[:, None], edges[None, :])
    area = np.maximum(np.diff(np.diff(corner, axis=0), axis=1), 0.0)
    u, v = np.meshgrid(centre, centre, indexing="ij")
    kept = area.ravel() > 1e-15
    return _bundle(u.ravel()[kept], v.ravel()[kept], area.ravel()[kept])


def sobol(count: int, profile: Profile = "gauss") -> Bundle:
    """Two-dimensional Sobol points, shifted by half a step, mapped to the beam with equal shares."""
    k = np.arange(_counted(count), dtype=np.uint64)
    first, second = np.zeros(count), np.zeros(count)
    bits_1, bits_2 = np.zeros(count, np.uint64), np.zeros(count, np.uint64)
    m = 1
    for bit in range(32):
        on = ((k >> np.uint64(bit)) & np.uint64(1)) == 1
        bits_1 = np.where(on, bits_1 ^ np.uint64(1 << (31 - bit)), bits_1)
        bits_2 = np.where(on, bits_2 ^ np.uint64(m << (31 - bit)), bits_2)
        m = (m << 1) ^ m  # direction numbers of the primitive polynomial x + 1
    first = (bits_1.astype(np.float64) / 2.0**32 + 0.5 / count) % 1.0
    second = (bits_2.astype(np.float64) / 2.0**32 + 0.5 / count) % 1.0
    return from_square(first, second, profile)


def halton(count: int, profile: Profile = "gauss") -> Bundle:
    """Halton points of bases 2 and 3, shifted by half a step, mapped to the beam with equal shares."""
    k = np.arange(_counted(count))
    shift = 0.5 / count
    return from_square((_radical_inverse(k, 2) + shift) % 1.0, (_radical_inverse(k, 3) + shift) % 1.0, profile)


def from_square(p: Floats, q: Floats, profile: Profile = "gauss") -> Bundle:
    """Points of the unit square as equal shares of the beam: p is the share inside the radius, q the turn.

    Uniform random points give the Monte Carlo rule.
    """
    return _polar(floats(p), 2.0 * np.pi * floats(q), np.ones(len(p)), profile)


def _near_square(count: int) -> tuple[int, int]:
    radial = max(1, math.isqrt(count))
    return radial, -(-count // radial)


RULES: dict[str, Callable[[int, Profile], Bundle]] = {
    "axis": lambda count, profile: axis(),
    "laguerre": lambda count, profile: laguerre(*_near_square(count), profile),
    "spiral": spiral,
    "grid": lambda count, profile: grid(math.isqrt(count - 1) + 1, profile),
    "sobol": sobol,
    "halton": halton,
    "gauss_legendre": lambda count, profile: gauss_legendre(*_near_square(count), profile),
    "rings": lambda count, profile: rings(*_near_square(count), profile),
}
"Fixed rules by the name used in specs and scenarios; a product rule rounds the count up to its next product."


def bundle(rule: str, count: int, profile: Profile = "gauss") -> Bundle:
    """The bundle of a rule by name with about `count` sub-beams, never fewer (`axis`: one)."""
    if rule not in RULES:
        raise ValueError(f"rule: {rule!r}; want one of {', '.join(RULES)} or adaptive")
    return RULES[rule](_counted(count), profile)


PACKET = 16
"Rays that are searched for together, see `compiled.packets`."


def together(nodes: Bundle) -> Bundle:
    """The same nodes in an order in which neighbours follow each other: rows of squares of `PACKET` of them.

    Rays of a packet that lie close together take half the time of a spiral's.
    """
    packets = -(-len(nodes) // PACKET)
    rows = np.array_split(np.argsort(nodes.v, kind="stable"), max(1, round(math.sqrt(packets))))
    order = np.concatenate([row[np.argsort(nodes.u[row], kind="stable")] for row in rows])
    return Bundle(nodes.u[order], nodes.v[order], nodes.share[order])


# ------------------------------------------------------------------------------- directions of a scan
def beam_phase(index: Values | np.ndarray[tuple[int, ...], np.dtype[np.int64]]) -> Floats:
    """Turn of each beam's bundle about its axis, a hash of the beam's index times 2 pi, the same in every run."""
    z = (np.asarray(index, dtype=np.uint64) + np.uint64(1)) * np.uint64(0x9E3779B97F4A7C15)
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)  # the mixer of SplitMix64
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    z = z ^ (z >> np.uint64(31))
    return 2.0 * np.pi * ((z >> np.uint64(11)).astype(np.float64) / 2.0**53)


def axis_directions(azimuth_rad: Floats, elevation_rad: Floats) -> Floats:
    """Unit vectors (n, 3) of beam axes in the sensor's frame: x forward, y left, z up."""
    az, el = np.broadcast_arrays(floats(azimuth_rad), floats(elevation_rad))
    return np.stack([np.cos(el) * np.cos(az), np.cos(el) * np.sin(az), np.sin(el)], axis=-1)


def spread(
    nodes: Bundle, shape: BeamShape, azimuth_rad: Floats, elevation_rad: Floats, phase_rad: Floats | None = None
) -> tuple[Floats, Floats]:
    """Directions of all sub-beams of a scan, and where each starts.

    Parameters
    ----------
    nodes : bundle of m sub-beams
    shape : half angles, roll and exit radius of every beam
    azimuth_rad, elevation_rad : (n,) axes in the sensor's frame. [rad]
    phase_rad : (n,) turn of the bundle about each axis, `beam_phase` of the beams' indexes by default. [rad]

    Returns
    -------
    direction : (n, m, 3) unit vectors
    origin_m : (n, m, 3) start on the exit pupil relative to the sensor's optical centre; zero for a beam without width.
        A virtual apex w0/theta behind the pupil makes the beam a linear cone; ranges count from the pupil. [m]
    """
    az, el = np.broadcast_arrays(floats(azimuth_rad), floats(elevation_rad))
    turn = beam_phase(np.arange(az.size)) if phase_rad is None else np.broadcast_to(floats(phase_rad), az.shape)
    ca, sa, ce, se = np.cos(az), np.sin(az), np.cos(el), np.sin(el)
    forward, left, up = (ce * ca, ce * sa, se), (-sa, ca), (-se * ca, -se * sa, ce)
    ct, st = np.cos(turn)[:, None], np.sin(turn)[:, None]
    u = ct * nodes.u - st * nodes.v
    v = st * nodes.u + ct * nodes.v
    cr, sr = math.cos(shape.roll_rad), math.sin(shape.roll_rad)
    tx, ty = _tangent(shape.half_angle_x_rad), _tangent(shape.half_angle_y_rad)
    across, upward = cr * tx * u - sr * ty * v, sr * tx * u + cr * ty * v
    length = np.sqrt(1.0 + across * across + upward * upward)
    # each coordinate is one long row: a third of the time of vectors in rows, and the same numbers
    direction, start = np.zeros((3, *u.shape)), np.zeros((3, *u.shape))
    for number, into in enumerate(direction):
        into += forward[number][:, None]
        if number < len(left):
            into += across * left[number][:, None]
        into += upward * up[number][:, None]
        into /= length
    w0 = shape.exit_radius_m
    if w0 >= NO_WIDTH:
        x, y = w0 * (cr * u - sr * v), w0 * (sr * u + cr * v)
        for number, into in enumerate(start):
            if number < len(left):
                into += x * left[number][:, None]
            into += y * up[number][:, None]
    return direction.transpose(1, 2, 0), start.transpose(1, 2, 0)


# ------------------------------------------------------------------------------- helpers
def _tangent(half_angle_rad: float) -> float:
    return math.tan(half_angle_rad) if half_angle_rad >= NO_WIDTH else 0.0


def _counted(count: int) -> int:
    if count < 1:
        raise ValueError(f"count: {count}; want at least 1 sub-beam")
    return count


def _bundle(u: Floats, v: Floats, weight: Floats) -> Bundle:
    """Shares divided by their sum; what rounding leaves goes to the largest, so that the exact sum is 1."""
    share = floats(weight) / math.fsum(weight)
    share[int(np.argmax(share))] += 1.0 - math.fsum(share)
    return Bundle(floats(u), floats(v), share)


def radius_of_share(p: Floats, profile: Profile) -> Floats:
    """Radius, in half angles, inside which the share p of the power lies."""
    if profile == "gauss":
        return np.sqrt(-0.5 * np.log1p(-p))
    return np.sqrt(p)


def _polar(p: Floats, phi: Floats, weight: Floats, profile: Profile) -> Bundle:
    radius = radius_of_share(p, profile)
    return _bundle(radius * np.cos(phi), radius * np.sin(phi), weight)


def _rings(p: Floats, weight: Floats, angles: int, profile: Profile) -> Bundle:
    stagger = 0.5 * (np.arange(len(p)) % 2)[:, None]
    phi = 2.0 * np.pi * (np.arange(angles) + stagger) / angles
    return _polar(np.repeat(p, angles), phi.ravel(), np.repeat(weight, angles), profile)


def _radical_inverse(k: np.ndarray[tuple[int, ...], np.dtype[np.int64]], base: int) -> Floats:
    value, scale, rest = np.zeros(k.shape), 1.0, k.copy()
    while bool(np.any(rest)):
        scale /= base
        value = value + scale * (rest % base)
        rest = rest // base
    return value


def disc_area(x: Floats, y: Floats) -> Floats:
    """Area of the unit disc with abscissa below x and ordinate below y, for -1 <= x, y <= 1."""
    x, y = np.broadcast_arrays(x, y)
    end = np.sqrt(np.maximum(1.0 - y * y, 0.0))

    def under(t: Floats) -> Floats:  # integral of sqrt(1 - t^2) from 0
        return 0.5 * (t * np.sqrt(np.maximum(1.0 - t * t, 0.0)) + np.arcsin(np.clip(t, -1.0, 1.0)))

    inner = np.clip(x, -end, end)
    middle = y * (inner + end) + under(inner) - under(-end)
    left = 2.0 * (under(np.minimum(x, -end)) - under(np.full_like(end, -1.0)))
    right = 2.0 * np.maximum(under(np.maximum(x, end)) - under(end), 0.0)
    return np.where(y >= 0.0, left + middle + right, middle)
