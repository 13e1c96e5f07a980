"""Drops and flakes as places in the world: the same for every beam, sensor and sweep that looks there.

Here: which particles stand in a cell of the world, made again from the cell's numbers whenever they are wanted, and
which of them stand in which beams. Not here: how bright they are (particle_light).

Particles of a class of sizes share one velocity, so they rest in a frame that moves with it. In this frame cells are
boxes of one size, with a Poisson number of particles at independent places; all numbers come of a hash of seed, class
and cell. A beam is a line in this frame wherever the sensor is and whenever it fires: what falls, drifts or comes
nearer needs nothing of its own.
"""

from __future__ import annotations

import hashlib
import math
from dataclasses import dataclass
from types import ModuleType

import numpy as np
from numpy.typing import NDArray
from scipy import special

from emulator.compiled.pair import by_loops
from emulator.physics.arrays import Floats, Ints, indexes, ramp
from emulator.physics.particle_light import ParticleLight, Sizes

Words = NDArray[np.uint64]
_Found = tuple[Ints, Floats, Floats]
_Tables = tuple[Ints, Floats, Ints, Floats, Floats]
EDGES_MM = (0.0, 0.35, 0.7, 1.1, 1.6, 2.2, 3.0, 4.0)
"Sizes at which classes begin: the velocities within a class differ by a seventh at most where drops are seen."
A_CELL = 1.0
"Mean number of particles in a cell: fewer cost cells, more cost particles beside the beams."
FLAT = 4.0
"Width of a cell over its height: most scans are level."
BUCKET = 4.0
"With numpy arrays: neighbouring beams that are looked at together span this many cells."
PART = 8.0
"By loops: neighbours in all directions that are looked at together span this many."
WIDEST_RAD = 0.5
"With numpy arrays: and this angle at the most: what is near their chord is near them."
OCTAVE = 0.4
"Ratio of the ranges between which beams keep their neighbours."
MOST_PAIRS = 3_000_000
"""Cells that may be looked at in a sweep: a second or so. Beyond it particles are drawn for each beam alone.
Loops share cells between layers, so they reach it later."""
MOST_BOXES = 500_000
"With numpy arrays, of a class between two ranges: more hold more cells than may be looked at."
BOXES_KEPT = 400_000
"Held from one sweep to the next: 40 MB."
SLACK_M = 1e-5
"Beams that are nearer to their places of an earlier sweep, from the first one, are looked for in the same boxes."
AT_ONCE = 200_000
"Cells that are held together."
SHORTER = 0.5
"With numpy arrays: share of the way from beam to beam below which another order is worth it."
STEP = np.uint64(0x9E3779B97F4A7C15)


@dataclass(frozen=True, eq=False)
class Lines:
    """Beams in the world at their instants."""

    centre_m: Floats
    "(n, 3)"
    axis: Floats
    "(n, 3) unit vectors."
    across: Floats | None
    "(n, 3) direction of the beam's x radius; None: round."
    t_s: Floats
    far_m: Floats
    "(n,) first surface."
    own_axis: Floats | None = None
    "(n, 3) in the sensor's frame: with numpy arrays beams are looked at by its layers; None: as they come."

    def taken(self, order: Ints) -> Lines:
        """The same beams in another order, and to be looked at in it."""
        across = None if self.across is None else self.across[order]
        return Lines(self.centre_m[order], self.axis[order], across, self.t_s[order], self.far_m[order])


@dataclass(frozen=True)
class _Class:
    """Particles of like size and one velocity."""

    low_mm: float
    high_mm: float
    number_m3: float
    slope_mm: float
    velocity_m_s: tuple[float, float, float]
    key: int

    @property
    def share(self) -> float:
        """Of those larger than the least size."""
        return -math.expm1(-self.slope_mm * (self.high_mm - self.low_mm)) if self.high_mm < math.inf else 1.0

    @property
    def width_m(self) -> float:
        """Of a cell."""
        return float((FLAT * A_CELL / self.number_m3) ** (1.0 / 3.0)) if self.number_m3 > 0.0 else math.inf

    @property
    def signed_key(self) -> int:
        """The key as a number of 64 bits with a sign."""
        return self.key - 2**64 if self.key >= 2**63 else self.key

    def sizes(self, uniform: Floats, largest_mm: float) -> Floats:
        """Diameters by uniform numbers."""
        if self.slope_mm == 0.0:
            return np.full(len(uniform), self.high_mm)
        return np.minimum(self.low_mm - np.log1p(-uniform * self.share) / self.slope_mm, largest_mm)


def _in_beams_by_loops(loops: ModuleType, world: WorldParticles, light: ParticleLight, lines: Lines) -> _Found | None:
    if not len(lines.axis):
        return _none()
    optics, (least, begin_m, step_m) = light.optics, light.least_table
    across = np.zeros((0, 3)) if lines.across is None else lines.across
    limits = np.array([OCTAVE, MOST_PAIRS, FLAT, PART, SLACK_M])
    keys, classes, *reaches = world.tables(light)
    room = 1024 + 8 * len(lines.axis)
    while True:
        beam, range_m, size = np.zeros(room, np.int64), np.zeros(room), np.zeros(room)
        number = loops.falling(
            keys, classes, *reaches, _POISSON, world.sizes.slope_mm, light.sizes.largest_mm, limits,
            lines.centre_m, lines.axis, across, lines.t_s, lines.far_m, _covered(lines.far_m), optics.tan_x,
            optics.tan_y, optics.exit_radius_m, optics.gaussian, least, begin_m, step_m, beam, range_m, size,
        )  # fmt: skip
        if number < 0:
            return None
        if number <= room:
            kept = indexes(size[:number] >= light.least_mm(range_m[:number]))
            return beam[kept], range_m[kept], size[kept]
        room = number


class WorldParticles:
    """All particles of one kind in the world."""

    def __init__(
        self, seed: int, term: str, sizes: Sizes, fall_m_s: Floats | float, wind_m_s: tuple[float, float, float]
    ) -> None:
        """`fall_m_s` : of `class_middles(sizes)`, or of all."""
        edges = (*EDGES_MM, math.inf) if sizes.slope_mm > 0.0 else (0.0, sizes.largest_mm)
        falls = np.broadcast_to(np.asarray(fall_m_s, np.float64), (len(edges) - 1,))
        self.sizes = sizes
        self._classes: list[_Class] = []
        self._kept: list[_Fans] = []
        self._tables: tuple[ParticleLight, _Tables] | None = None
        for number, (low, high, fall) in enumerate(zip(edges[:-1], edges[1:], falls, strict=True)):
            digest = hashlib.blake2b(f"{seed}\0world\0{term}\0{number}".encode(), digest_size=8).digest()
            density = sizes.number_m3 * (math.exp(-sizes.slope_mm * low) - math.exp(-sizes.slope_mm * high))
            if sizes.slope_mm == 0.0:
                density = sizes.number_m3
            velocity = (wind_m_s[0], wind_m_s[1], wind_m_s[2] - float(fall))
            self._classes.append(_Class(low, high, density, sizes.slope_mm, velocity, int.from_bytes(digest, "little")))

    @by_loops(_in_beams_by_loops, "falling")
    def in_beams(self, light: ParticleLight, lines: Lines) -> _Found | None:
        """Beam, range and effective size in mm of all particles that are to be drawn; None: too many cells."""
        if not len(lines.axis):
            return _none()
        order = None if lines.own_axis is None else by_layers(lines.own_axis)
        if order is not None:
            lines = lines.taken(order)
        fans, searches = self._fans(light, lines), []
        left: float = MOST_PAIRS
        for one in self._classes:
            search = _Search(one, fans, light, lines)
            left -= search.pairs
            if left < 0:
                return None
            searches.append(search)
        beam, range_m, size = _joined([search.found() for search in searches])
        kept = indexes(size >= light.least_mm(range_m))
        beam = beam[kept]
        return beam if order is None else order[beam], range_m[kept], size[kept]

    def tables(self, light: ParticleLight) -> _Tables:
        """Keys of all classes; least size, share, number, width of cells and velocity; how far they are seen."""
        known = self._tables
        if known is None or known[0] is not light:
            reaches = [light.reach(min(one.high_mm, light.sizes.largest_mm)) for one in self._classes]
            rows = [(one.low_mm, one.share, one.number_m3, one.width_m, *one.velocity_m_s) for one in self._classes]
            begins = np.cumsum([0, *(len(range_m) for range_m, _ in reaches)])
            range_m, wide_m = (np.concatenate(column) for column in zip(*reaches, strict=True))
            known = (
                light,
                (np.array([one.signed_key for one in self._classes]), np.array(rows), begins, range_m, wide_m),
            )
            self._tables = known
        return known[1]

    def _fans(self, light: ParticleLight, lines: Lines) -> _Fans:
        """Where to look: as in an earlier sweep whose beams stood to each other in the same way."""
        known = next((one for one in self._kept if one.fit(light, lines)), None)
        if known is None:
            known = _Fans(light, lines)
            self._kept = [*self._kept, known]
            while len(self._kept) > 1 and sum(one.boxes for one in self._kept) > BOXES_KEPT:
                self._kept.pop(0)
        return known


def class_middles(sizes: Sizes) -> Floats:
    """Diameter of each class of sizes by which its light moves: the mean, weighed with D^4. [mm]"""
    if sizes.slope_mm == 0.0:
        return np.array([sizes.largest_mm])
    edges = np.array([*EDGES_MM, np.inf])
    five, six = (special.gammainc(k, sizes.slope_mm * edges) for k in (5.0, 6.0))
    weight = np.diff(five)
    mean = np.where(weight > 1e-12, 5.0 * np.diff(six) / (sizes.slope_mm * np.maximum(weight, 1e-300)), 0.0)
    return np.clip(mean, edges[:-1], np.minimum(edges[1:], sizes.largest_mm))


@dataclass(frozen=True, eq=False)
class _Boxes:
    """Parts of buckets of neighbouring beams between two ranges."""

    bucket: Ints
    near_m: Floats
    far_m: Floats
    reach_m: Floats
    "How far from the axis a particle may be."
    low: Floats | Ints
    "(b, 3) lower corner, from the first beam's origin, or first cell."
    size: Floats | Ints
    "(b, 3) upper corner, or number of cells."


class _Octave:
    """Beams between two ranges, in buckets of neighbours."""

    def __init__(self, origin: Floats, axis: Floats, near_m: float, end_m: float, span_m: float) -> None:
        self.moved = np.concatenate([[0.0], np.linalg.norm(np.diff(origin, axis=0), axis=1).cumsum()])
        turned = np.concatenate([[0.0], np.linalg.norm(np.diff(axis, axis=0), axis=1).cumsum()])
        self.along = self.moved + end_m * turned
        number = np.floor(self.along / min(span_m, WIDEST_RAD * end_m))
        self.first = np.concatenate([[0], np.flatnonzero(np.diff(number)) + 1])
        self.last = np.append(self.first[1:], len(origin)) - 1
        low, high = np.minimum.reduceat, np.maximum.reduceat
        self.box = low(origin, self.first), high(origin, self.first), low(axis, self.first), high(axis, self.first)
        self.near_m, self.end_m = near_m, end_m

    def boxes(self, step_m: float, reach: tuple[Floats, Floats]) -> _Boxes:
        """`reach` : ranges, and how far from the axis there."""
        steps = max(1, math.ceil((self.end_m - self.near_m) / step_m))
        edges = np.linspace(self.near_m, self.end_m, steps + 1)
        bucket, k = (part.ravel() for part in np.indices((len(self.first), steps)))
        near, far = edges[k], edges[k + 1]
        fine = np.linspace(edges[:-1], edges[1:], 5)
        wide = np.interp(fine, *reach).max(axis=0)[k] + SLACK_M
        low_o, high_o, low_d, high_d = (part[bucket] for part in self.box)
        a, b = near[:, None], far[:, None]
        low = low_o + np.minimum(a * low_d, b * low_d) - wide[:, None]
        high = high_o + np.maximum(a * high_d, b * high_d) + wide[:, None]
        return _Boxes(np.asarray(bucket, np.int64), near, far, wide, low, high)


class _Fan:
    """Where particles of one class may be seen: boxes about buckets of beams, from the first beam's origin.

    Places of beams count through all octaves: those of the k-th are k n to k n + n - 1.
    """

    def __init__(self, of: _Class, light: ParticleLight, origin: Floats, axis: Floats, far_m: float) -> None:
        self.too_many = self.none = False
        range_m, reach = light.reach(min(of.high_mm, light.sizes.largest_mm))
        if len(range_m) < 2 or of.number_m3 <= 0.0:
            self.none = True
            return
        width = of.width_m
        self.cell_m = np.array([width, width, width / FLAT])
        begin, end = float(range_m[0]), float(range_m[-1])
        while OCTAVE * end > max(begin, far_m):
            end *= OCTAVE
        octaves: list[_Octave] = []
        boxes: list[_Boxes] = []
        while end > begin:
            near = max(OCTAVE * end, begin)
            if near < begin + 2.0 * BUCKET * width:
                near = begin
            octave = _Octave(origin, axis, near, end, BUCKET * width)
            if len(octave.first) * (end - near) > MOST_BOXES * BUCKET * width:
                self.too_many = True
                return
            octaves.append(octave)
            boxes.append(octave.boxes(BUCKET * width, (range_m, reach)))
            end = near
        self.beams, n = len(axis), np.arange(len(octaves)) * len(axis)
        apart = max(float(one.along[-1]) for one in octaves) + 1.0
        self.along = np.concatenate([one.along + k * apart for k, one in enumerate(octaves)])
        self.moved = np.concatenate([one.moved for one in octaves])
        self.first = np.concatenate([one.first + k for one, k in zip(octaves, n, strict=True)])
        self.last = np.concatenate([one.last + k for one, k in zip(octaves, n, strict=True)])
        self.end_m = np.concatenate([np.full(len(one.first), one.end_m) for one in octaves])
        before = np.cumsum([0, *(len(one.first) for one in octaves)])
        bucket = np.concatenate([one.bucket + k for one, k in zip(boxes, before, strict=False)])
        near_m, far, wide, low, high = (
            np.concatenate([getattr(one, name) for one in boxes])
            for name in ("near_m", "far_m", "reach_m", "low", "size")
        )
        self.boxes = _Boxes(bucket, near_m, far, wide, low, high)
        with np.errstate(over="ignore"):
            self.cells = np.minimum(((high - low) / self.cell_m + 1.0).prod(axis=1), 1e15)

    def now(self, origin: Floats, far_m: Floats) -> tuple[_Boxes, float]:
        """Boxes that beams reach, in cells, and about how many these are."""
        until = np.maximum.reduceat(np.tile(far_m, len(self.along) // self.beams), self.first)
        some = indexes(self.boxes.near_m < until[self.boxes.bucket])
        part = self.boxes
        low = np.floor((part.low[some] + origin) / self.cell_m).astype(np.int64)
        size = np.floor((part.size[some] + origin) / self.cell_m).astype(np.int64) - low + 1
        return (
            _Boxes(part.bucket[some], part.near_m[some], part.far_m[some], part.reach_m[some], low, size),
            float(self.cells[some].sum()),
        )


class _Fans:
    """Those of all classes, for beams that stand to each other in one way."""

    def __init__(self, light: ParticleLight, lines: Lines) -> None:
        self._light, self._axis, self._far_m = light, lines.axis, _covered(lines.far_m)
        self._late, self._off = lines.t_s - lines.t_s[0], lines.centre_m - lines.centre_m[0]
        self._of: dict[int, _Fan] = {}

    def fit(self, light: ParticleLight, lines: Lines) -> bool:
        """Beams stand so: no box that holds a particle of theirs is missing."""
        if light is not self._light or len(lines.axis) != len(self._axis):
            return False
        return (
            (lines.axis is self._axis or np.array_equal(lines.axis, self._axis))
            and bool(np.abs(lines.t_s - lines.t_s[0] - self._late).max() < 1e-9)
            and bool(np.abs(lines.centre_m - lines.centre_m[0] - self._off).max() < 0.1 * SLACK_M)
            and _covered(lines.far_m) == self._far_m
        )

    def of(self, one: _Class) -> _Fan:
        """That of a class."""
        if one.key not in self._of:
            origin = self._off - self._late[:, None] * np.array(one.velocity_m_s)
            self._of[one.key] = _Fan(one, self._light, origin, self._axis, self._far_m)
        return self._of[one.key]

    @property
    def boxes(self) -> int:
        """How many are held."""
        return sum(len(one.cells) for one in self._of.values() if not (one.none or one.too_many))


class _Search:
    """Particles of one class in the beams of a sweep."""

    def __init__(self, of: _Class, fans: _Fans, light: ParticleLight, lines: Lines) -> None:
        self.of, self.light, self.lines = of, light, lines
        self.fan, self.pairs = fans.of(of), 0.0
        if self.fan.too_many:
            self.pairs = math.inf
        elif not self.fan.none:
            self.origin = lines.centre_m - lines.t_s[:, None] * np.array(of.velocity_m_s)
            self.boxes, self.pairs = self.fan.now(self.origin[0], lines.far_m)

    def found(self) -> tuple[Ints, Floats, Floats]:
        """Beam, range, effective size; a few more than are to be drawn."""
        return in_boxes(self) if self.pairs else _none()

    def of_some(self, chosen: Ints, count: Ints) -> tuple[Ints, Floats, Floats]:
        """Those in some of the boxes, of `count` cells each."""
        boxes = self.boxes
        box = chosen.repeat(count)
        at, size = ramp(count), np.asarray(boxes.size[box], np.int64)
        cell = np.asarray(boxes.low[box], np.int64)
        cell[:, 0] += at % size[:, 0]
        cell[:, 1] += at // size[:, 0] % size[:, 1]
        cell[:, 2] += at // (size[:, 0] * size[:, 1])
        word = cell_words(np.uint64(self.of.key), cell)
        number = np.searchsorted(_POISSON, unit(mixed(word + STEP)), side="right")
        some = indexes(number > 0)
        number = number[some]
        owner = some.repeat(number)
        word = mixed(word[owner] + (2 * ramp(number) + 2).astype(np.uint64) * STEP)
        place = (cell[owner] + three(word)) * self.fan.cell_m
        kept, beams = self._near(box[owner], place)
        place, word = place[kept], word[kept]
        first, number = beams
        beam = first.repeat(number) + ramp(number)
        row = np.arange(len(kept)).repeat(number)
        box = box[owner[kept]][row]
        return self._inside(beam, place[row], word[row], boxes.near_m[box], boxes.far_m[box])

    def _near(self, box: Ints, place: Floats) -> tuple[Ints, tuple[Ints, Ints]]:
        """Particles near the fan of a bucket's beams, and the beams that they may be in: the first, how many."""
        fan, bucket = self.fan, self.boxes.bucket[box]
        start, stop = fan.first[bucket], fan.last[bucket]
        octave = start - start % fan.beams
        first, last = start - octave, stop - octave
        axis, origin, reach = self.lines.axis, self.origin, self.boxes.reach_m[box]
        middle = (first + last) // 2
        to = place - origin[middle]
        r = np.sqrt(np.einsum("ij,ij->i", to, to))
        begin = origin[first] + r[:, None] * axis[first]
        chord = origin[last] + r[:, None] * axis[last] - begin
        square = np.einsum("ij,ij->i", chord, chord)
        part = np.einsum("ij,ij->i", place - begin, chord) / np.maximum(square, 1e-300)
        part = np.clip(part, 0.0, 1.0)
        off = place - begin - part[:, None] * chord
        length, moved = fan.along[stop] - fan.along[start], fan.moved[stop] - fan.moved[start]
        scale = np.clip(r / fan.end_m[bucket], 1e-3, 1.0)
        bent = np.sqrt(np.maximum((scale * length + moved) ** 2 - square, 0.0))
        slack = reach + 0.5 * bent + moved
        kept = indexes(np.einsum("ij,ij->i", off, off) <= slack * slack)
        start, stop, scale = start[kept], stop[kept], scale[kept]
        window = (reach[kept] + bent[kept] + 3.0 * moved[kept]) / scale
        at = fan.along[start] + part[kept] * length[kept]
        low = np.maximum(fan.along.searchsorted(at - window, side="left"), start)
        high = np.minimum(fan.along.searchsorted(at + window, side="right"), stop + 1)
        return kept, (low - octave[kept], np.maximum(high - low, 0))

    def _inside(self, beam: Ints, place: Floats, word: Words, near: Floats, far: Floats) -> tuple[Ints, Floats, Floats]:
        lines, optics = self.lines, self.light.optics
        axis = lines.axis[beam]
        to = place - self.origin[beam]
        r = np.einsum("ij,ij->i", to, axis)
        kept = indexes((r >= near) & (r < far) & (r < lines.far_m[beam]))
        beam, r, axis, word = beam[kept], r[kept], axis[kept], word[kept]
        off = to[kept] - r[:, None] * axis
        if lines.across is None:
            width = optics.tan_x * r + optics.exit_radius_m
            square = np.einsum("ij,ij->i", off, off) / np.maximum(width * width, 1e-300)
        else:
            across = lines.across[beam]
            x = np.einsum("ij,ij->i", off, across)
            y = np.einsum("ij,ij->i", off, np.cross(axis, across))
            square = (x / np.maximum(optics.tan_x * r + optics.exit_radius_m, 1e-150)) ** 2
            square = square + (y / np.maximum(optics.tan_y * r + optics.exit_radius_m, 1e-150)) ** 2
        size = self.of.sizes(unit(mixed(word + STEP)), self.light.sizes.largest_mm)
        if optics.gaussian:
            size = size * np.exp(-np.minimum(square, 500.0))
        else:
            size = np.where(square < 1.0, size, 0.0)
        kept = indexes(size > 0.0)
        return beam[kept], r[kept], size[kept]


def _covered(far_m: Floats) -> float:
    """A power of `OCTAVE` beyond all of these ranges."""
    return float(OCTAVE ** math.floor(math.log(max(float(far_m.max()), 1e-3)) / math.log(OCTAVE)))


def _none() -> tuple[Ints, Floats, Floats]:
    return np.zeros(0, np.int64), np.zeros(0), np.zeros(0)


def _joined(found: list[tuple[Ints, Floats, Floats]]) -> tuple[Ints, Floats, Floats]:
    beam, range_m, size = (np.concatenate(column) for column in zip(_none(), *found, strict=True))
    return beam, range_m, size


def in_boxes(search: _Search) -> tuple[Ints, Floats, Floats]:
    """Beam, range and effective size of the particles in the boxes of a search."""
    found = []
    count = search.boxes.size.prod(axis=1)
    total = count.cumsum()
    begin = 0
    while begin < len(count):
        before = total[begin - 1] if begin else 0
        end = max(int(total.searchsorted(before + AT_ONCE, side="right")), begin + 1)
        found.append(search.of_some(np.arange(begin, end), count[begin:end]))
        begin = end
    return _joined(found)


def by_layers(own_axis: Floats) -> Ints | None:
    """Order of beams (n, 3) in which neighbours lie beside each other, where lasers that fire in turn look far apart.

    None: as they come.
    """
    if len(own_axis) < 2 or float(np.ptp(own_axis[:, 2])) < 1e-6:  # one layer
        return None
    order = np.argsort(np.round(own_axis[:, 2], 6), kind="stable")
    return order if _way(own_axis[order]) < SHORTER * _way(own_axis) else None


def _way(axis: Floats) -> float:
    """Sum of the angles from beam to beam, nearly."""
    return float(np.sqrt((np.diff(axis, axis=0) ** 2).sum(axis=1)).sum())


# ------------------------------------------------------------------------------- numbers of a cell
_POISSON = np.asarray(special.pdtr(np.arange(24), A_CELL), np.float64)
_PRIMES = np.array([0x9E3779B97F4A7C15, 0xC2B2AE3D27D4EB4F, 0x165667B19E3779F9], np.uint64)


def mixed(word: Words) -> Words:
    """The last steps of splitmix64: every bit of the result depends on every bit given."""
    word = (word ^ (word >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    word = (word ^ (word >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return np.asarray(word ^ (word >> np.uint64(31)))


def cell_words(key: np.uint64, cell: Ints) -> Words:
    words = cell.astype(np.uint64) * _PRIMES
    word = mixed(words[:, 0] ^ key)
    word = mixed(word + words[:, 1])
    return mixed(word + words[:, 2])


def unit(word: Words) -> Floats:
    return ((word >> np.uint64(11)).astype(np.float64) + 0.5) * 2.0**-53


def three(word: Words) -> Floats:
    """(k, 3) uniform numbers of 21 bits each: places in a cell to less than a micrometre."""
    mask = np.uint64(2**21 - 1)
    parts = [(word >> np.uint64(shift)) & mask for shift in (0, 21, 42)]
    return np.stack([(part.astype(np.float64) + 0.5) * 2.0**-21 for part in parts], axis=1)
