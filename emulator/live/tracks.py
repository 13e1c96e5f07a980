"""Where fed actors are at any instant: interpolated between samples, extrapolated beyond them, held when they end.

Belongs here: pure functions of samples and instants. Not: which samples are kept (book), whose motion it is (world).

A track goes with the plan of a sweep to whoever measures it, so that a sweep depends on nothing but what it was given.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from emulator.live.natures import Columns, Nature, Natures, natures_of
from emulator.live.rotations import (
    Floats,
    Vector,
    conjugate,
    of_vector,
    product,
    slerp,
    to_vector,
    travelled,
)

Between = Literal["interpolate", "extrapolate", "hold"]
BLEND_S = 0.2
"Over so long an actor comes back to its track when its feed returns."
FEW_SAMPLES = 32
"Of a track: more are searched, fewer compared with all instants at once."


@dataclass(eq=False)
class Track:
    """Samples of one actor, ascending in time: k of them, of which n instants are asked.

    Nobody changes one; frozen, it takes three times as long to make, and each sweep has one of each actor.
    """

    t_s: Floats
    "(k,) in the run's time."
    at_m: Floats
    "(k, 3)"
    quaternion: Floats
    "(k, 4) w x y z."
    velocity_m_s: Floats
    "(k, 3) NaN where the feeder gave none."
    spin_rad_s: Floats
    "(k, 3) NaN where the feeder gave none."
    jump: NDArray[np.bool_]
    "(k,) not reached from the sample before: the actor stays there until this one's instant."
    returns: NDArray[np.bool_]
    "(k,) the feed had been silent: from here on the actor comes back to its track over `BLEND_S`."
    begins: bool = True
    "Before the first sample the actor is not fed; False: earlier samples were left out."
    gone_s: float = np.inf
    "From then on it is not there."
    between: Between = "interpolate"
    hold_after_s: float = 0.5
    "Extrapolated for at most so long, then held."
    vanish_after_s: float = np.inf
    "So long after the newest sample it is not there."
    reference: str = "box_centre"
    rear_m: Vector | None = None
    size_m: Vector | None = None
    shape: str = ""
    "Which of a pool's shapes it has, scaled to `size_m`; empty: the scenario's own."
    class_: str = ""
    "As the feeder reports it; empty: not at all."

    @property
    def last_s(self) -> float:
        """Instant of the newest sample."""
        return float(self.t_s[-1])

    @property
    def lasts_s(self) -> float:
        """It is there until then."""
        return min(self.gone_s, self.last_s + self.vanish_after_s)

    @cached_property
    def nature(self) -> Nature:
        """What kind of motion it is; of many tracks `look_at` finds that at once."""
        return natures_of_tracks([self]).each()[0]

    @property
    def comes_back(self) -> bool:
        """Its feed had been silent before one of these samples."""
        return self.nature.comes_back

    @property
    def turns(self) -> bool:
        """It may be turned otherwise at some instant than at another."""
        return self.nature.turns

    @property
    def rests(self) -> bool:
        """It neither moves nor turns."""
        return self.nature.rests

    @property
    def straight_m_s(self) -> Floats | None:
        """(3,) its velocity where it moves straight and evenly and does not turn; None: it does otherwise."""
        return self.nature.straight_m_s

    @property
    def straight_s(self) -> tuple[float, float]:
        """From when, and until when, `straight_m_s` holds."""
        if self.rests:
            return float(self.t_s[0]) if self.begins else -np.inf, self.lasts_s
        beyond = 0.0 if math.isnan(self.velocity_m_s[-1, 0]) else self.hold_after_s
        return float(self.t_s[0]), min(self.last_s + beyond, self.lasts_s)

    def there(self, t_s: Floats) -> NDArray[np.bool_]:
        """(n,) whether it is there."""
        until = t_s < self.lasts_s
        return until & (t_s >= self.t_s[0]) if self.begins else until

    def pose(self, t_s: Floats) -> tuple[Floats, Floats]:
        """Positions (n, 3) of the reference point and orientations (n, 4) at instants (n,)."""
        at, quaternion = self._on_track(t_s)
        if not self.comes_back:
            return at, quaternion
        back = np.flatnonzero(self.returns)
        latest = np.searchsorted(self.t_s[back], t_s, side="right") - 1
        since = t_s - self.t_s[back[np.maximum(latest, 0)]]
        blending = np.flatnonzero((latest >= 0) & (since < BLEND_S))
        for number in blending:
            k = int(back[latest[number]])
            if k == 0 or self.jump[k]:
                continue
            held = replace(self, **{name: getattr(self, name)[:k] for name in COLUMNS})
            instant = self.t_s[k : k + 1]
            off, turn = held._on_track(instant)
            left = 1.0 - _smooth(since[number] / BLEND_S)
            at[number] += left * (off[0] - self.at_m[k])
            away = to_vector(product(turn, conjugate(self.quaternion[k : k + 1])))
            quaternion[number] = product(of_vector(left * away), quaternion[number : number + 1])[0]
        return at, quaternion

    def _on_track(self, t_s: Floats) -> tuple[Floats, Floats]:
        return together(self._knots, t_s)

    @property
    def _knots(self) -> Knots:
        columns = tuple(getattr(self, name) for name in COLUMNS)
        firsts, sizes = np.zeros(1, np.int64), np.array([len(self.t_s)])
        return Knots(columns, firsts, sizes, np.array([self.hold_after_s]), self.between)

    def velocity(self, t_s: Floats) -> Floats:
        """(n, 3) in the world. [m/s]"""
        step = 1e-4
        return np.asarray((self.pose(t_s + step)[0] - self.pose(t_s - step)[0]) / (2.0 * step))

    def speed_bound(self) -> float:
        """It is never faster within its samples and what is extrapolated from them; of the reference point. [m/s]"""
        given = self.velocity_m_s[~np.isnan(self.velocity_m_s[:, 0])]
        fastest = float(np.sqrt((given * given).sum(axis=1).max(initial=0.0)))
        if len(self.t_s) > 1:
            step = np.diff(self.t_s)
            move = np.diff(self.at_m, axis=0) / step[:, None]
            # of the cubic: 1.5 times the chord and a quarter of each end's velocity at most, see `hermite`
            chord = float(np.sqrt((move * move).sum(axis=1).max()))
            fastest = max(1.5 * chord + 1.0 * fastest, fastest)
            if self.returns.any():
                return np.inf
            if self.jump[1:].any():
                return np.inf
        return fastest


COLUMNS = ("t_s", "at_m", "quaternion", "velocity_m_s", "spin_rad_s", "jump", "returns")


def look_at(tracks: Sequence[Track], columns: Columns | None = None) -> None:
    """Find out at once what kind of motion each of them is; `columns`: those of `columns_of`, where they are known."""
    if fresh := [track for track in tracks if "nature" not in vars(track)]:
        _note(fresh, natures_of_tracks(fresh, columns if len(fresh) == len(tracks) else None))


def _note(tracks: Sequence[Track], natures: Natures) -> None:
    for track, nature in zip(tracks, natures.each(), strict=True):
        vars(track)["nature"] = nature  # where cached_property keeps it


def columns_of(tracks: Sequence[Track]) -> Columns:
    """All their samples, one after the other, by `COLUMNS`."""
    return tuple(np.concatenate([getattr(track, name) for track in tracks]) for name in COLUMNS)


def natures_of_tracks(tracks: Sequence[Track], columns: Columns | None = None) -> Natures:
    """What kind of motion each is; `columns` as in `look_at`."""
    interpolated = np.array([track.between == "interpolate" for track in tracks])
    return natures_of(
        columns_of(tracks) if columns is None else columns, [len(track.t_s) for track in tracks], interpolated
    )


@dataclass(frozen=True, eq=False)
class Knots:
    """Samples of m tracks of one rule."""

    columns: Columns
    "As `COLUMNS`; there may be others among them."
    firsts: NDArray[np.int64]
    "(m,) where the samples of each begin."
    sizes: NDArray[np.int64]
    "(m,) how many they are."
    hold_s: Floats
    "(m,) `hold_after_s` of each."
    between: Between

    def latest(self, t_s: Floats) -> NDArray[np.int64]:
        """(m, n) the latest sample of each at instants (n,); before its first one that."""
        when = self.columns[0]
        if int(self.sizes.max()) > FEW_SAMPLES:
            samples = zip(self.firsts.tolist(), self.sizes.tolist(), strict=True)
            passed = np.array([when[first : first + size].searchsorted(t_s, side="right") for first, size in samples])
        else:
            starts = self.sizes.cumsum() - self.sizes
            rows = np.arange(int(self.sizes.sum())) + (self.firsts - starts).repeat(self.sizes)
            passed = np.add.reduceat(when[rows][:, None] <= t_s, starts, axis=0, dtype=np.int64)
        return np.asarray(np.maximum(passed - 1, 0) + self.firsts[:, None])


def together(knots: Knots, t_s: Floats) -> tuple[Floats, Floats]:
    """Poses of m tracks at the same n instants, one after the other: (m n, 3), (m n, 4).

    Without the way back of a feed that returns.
    """
    when, at_m, turned, velocity, _, jump, returns = knots.columns
    count = len(t_s)
    index = knots.latest(t_s).ravel()
    last = (knots.firsts + knots.sizes - 1).repeat(count)
    times = np.tile(t_s, len(knots.firsts))
    late = times > when[index]
    inside = (index < last) & late
    after = np.minimum(index + 1, last)
    frozen = inside & jump[after]
    inside = inside & ~(frozen | returns[after]) if knots.between == "interpolate" else np.zeros(len(times), bool)
    at, quaternion = at_m[index], turned[index]
    rows = np.flatnonzero(inside)
    if len(rows):
        before, beyond = index[rows], after[rows]
        span = when[beyond] - when[before]
        share = (times[rows] - when[before]) / span
        at[rows] = hermite(at_m[before], at_m[beyond], velocity[before], velocity[beyond], span, share)
        turns = np.flatnonzero((turned[before] != turned[beyond]).any(axis=1))
        if len(turns):
            there = rows[turns]
            quaternion[there] = slerp(quaternion[there], turned[beyond[turns]], share[turns])
    rows = np.flatnonzero(~inside & ~frozen & late) if knots.between != "hold" else rows[:0]
    if len(rows):
        used, inverse = np.unique(index[rows], return_inverse=True)
        speed, spin = _twists(knots.columns, used, np.isin(used, knots.firsts))
        span = np.minimum(times[rows] - when[index[rows]], knots.hold_s.repeat(count)[rows])
        at[rows] += travelled(speed[inverse], spin[inverse], span)
        if spin.any():
            quaternion[rows] = product(of_vector(span[:, None] * spin[inverse]), quaternion[rows])
    return at, quaternion


def _twists(columns: Columns, used: NDArray[np.int64], first: NDArray[np.bool_]) -> tuple[Floats, Floats]:
    """Velocities and angular velocities at samples: as given, else from each and the one before, else 0."""
    when, at_m, turned, velocity, spin, jump, returns = columns
    before = np.maximum(used - 1, 0)
    known = ~first & ~jump[used] & ~returns[used]
    step = np.where(known, when[used] - when[before], 1.0)[:, None]
    moved = np.where(known[:, None], (at_m[used] - at_m[before]) / step, 0.0)
    turn = to_vector(product(turned[used], conjugate(turned[before])))
    turning = np.where(known[:, None], turn / step, 0.0)
    return (
        np.where(np.isnan(velocity[used]), moved, velocity[used]),
        np.where(np.isnan(spin[used]), turning, spin[used]),
    )


def _smooth(share: float) -> float:
    return share * share * (3.0 - 2.0 * share)


def hermite(p0: Floats, p1: Floats, v0: Floats, v1: Floats, span_s: Floats, share: Floats) -> Floats:
    """Cubic from p0 to p1 (n, 3) with velocities v0 and v1 at its ends; where one is NaN, the straight line.

    Parameters
    ----------
    span_s, share : (n,) from one end to the other, and how much of it has passed, 0 to 1. [s], [-]
    """
    u = share[:, None]
    line = p0 + u * (p1 - p0)
    free = u * (1.0 - u)
    bend = free * ((1.0 - u) * (span_s[:, None] * v0 - (p1 - p0)) - u * (span_s[:, None] * v1 - (p1 - p0)))
    known = ~np.isnan(v0[:, :1]) & ~np.isnan(v1[:, :1])
    return np.asarray(np.where(known, line + bend, line))


@dataclass(frozen=True, eq=False)
class World:
    """All fed actors during one sweep."""

    tracks: tuple[tuple[str, Track], ...] = ()
    gone: frozenset[str] = frozenset()
    "Actors that the feeder has taken away."

    def earlier(self, by_s: float) -> World:
        """The same so much before. [s]"""
        moved = [(name, replace(one, t_s=one.t_s - by_s, gone_s=one.gone_s - by_s)) for name, one in self.tracks]
        return World(tuple(moved), self.gone)

    @cached_property
    def columns(self) -> Columns:
        """All samples of at least one track, one after the other, by `COLUMNS`."""
        return columns_of([track for _, track in self.tracks])

    @cached_property
    def rest(self) -> tuple[tuple[Any, ...], ...]:
        """Of all tracks: their names, how many samples each has, their other fields in the order of `Track`."""
        return tuple(zip(*self._packed[1], strict=True)) or ((),) * (2 + len(_REST))

    @property
    def names(self) -> tuple[str, ...]:
        """Whose track each is."""
        return self.rest[0]

    @cached_property
    def described(self) -> tuple[Described, ...]:
        """What each reports of its actor."""
        return tuple(zip(*self.rest[2 + _REST.index("reference") :], strict=True))

    @cached_property
    def natures(self) -> Natures:
        """What kind of motion each of at least one track is."""
        interpolated = self._column("between") == "interpolate"
        return natures_of(self.columns, self.rest[1], interpolated)

    @cached_property
    def straight_s(self) -> tuple[Floats, Floats]:
        """(m,) from when, and until when, each of at least one track is straight, where it is."""
        known, (from_s, lasts_s) = self.natures, self.there_s
        beyond = known.last_s + np.where(known.known_last, self._column("hold_after_s"), 0.0)
        begin_s = np.where(known.rests, from_s, known.first_s)
        return begin_s, np.where(known.rests, lasts_s, np.minimum(beyond, lasts_s))

    @cached_property
    def there_s(self) -> tuple[Floats, Floats]:
        """(m,) from when, and until when, each of at least one track is there."""
        known = self.natures
        lasts_s = np.minimum(self._column("gone_s"), known.last_s + self._column("vanish_after_s"))
        return np.where(self._column("begins"), known.first_s, -np.inf), lasts_s

    def _column(self, word: str) -> NDArray[Any]:
        return np.array(self.rest[2 + _REST.index(word)])

    def is_whole(self, number: int, begin_s: float, end_s: float) -> bool:
        """That track is there all the time, and its feed does not return in it."""
        from_s, until_s = self.there_s
        return bool(from_s[number] <= begin_s and end_s < until_s[number] and not self.natures.comes_back[number])

    @cached_property
    def knots(self) -> Knots:
        """Samples of at least one track."""
        sizes = np.array(self.rest[1])
        between = self.rest[2 + _REST.index("between")][0]
        return Knots(self.columns, sizes.cumsum() - sizes, sizes, self._column("hold_after_s"), between)

    def knots_of(self, numbers: NDArray[np.int64]) -> Knots:
        """The same of some of them."""
        every = self.knots
        return Knots(every.columns, every.firsts[numbers], every.sizes[numbers], every.hold_s[numbers], every.between)

    def look(self) -> None:
        """Find out at once what kind of motion each track is."""
        if self.tracks and "nature" not in vars(self.tracks[0][1]):
            _note([track for _, track in self.tracks], self.natures)

    @cached_property
    def _packed(self) -> Packed:
        """As it goes to other processes: all samples in one array, made once for all of them."""
        samples = np.zeros((sum(len(track.t_s) for _, track in self.tracks), WIDTH))
        if self.tracks:
            for place, known in zip(PLACES, self.columns, strict=True):
                samples[:, place] = known
        rest = [(name, len(track.t_s), *(getattr(track, word) for word in _REST)) for name, track in self.tracks]
        return samples, rest, self.gone

    def __reduce__(self) -> tuple[Callable[..., World], Packed]:
        return Sampled, self._packed


Packed = tuple[Floats, list[tuple[Any, ...]], frozenset[str]]
PLACES: tuple[int | slice, ...] = (0, slice(1, 4), slice(4, 8), slice(8, 11), slice(11, 14), 14, 15)
"Of `COLUMNS` in a sample."
WIDTH = 16
Described = tuple[str, "Vector | None", "Vector | None", str, str]
"Of an actor: which point of it is reported, `rear_m`, `size_m`, its shape, its class."
_REST = tuple(one.name for one in fields(Track) if one.name not in COLUMNS)


class Sampled(World):
    """The same of samples in one array; its tracks are made when they are asked for."""

    def __init__(self, samples: Floats, rest: list[tuple[Any, ...]], gone: frozenset[str]) -> None:
        """`samples`: (n, `WIDTH`) of all tracks. `rest`: of each its name, how many are its own, its other fields."""
        vars(self).update(_packed=(samples, rest, gone), gone=gone)

    @cached_property
    def columns(self) -> Columns:
        """All samples, one after the other, by `COLUMNS`."""
        samples, _, _ = self._packed
        t_s, at, turned, velocity, spin, jump, returns = (np.ascontiguousarray(samples[:, place]) for place in PLACES)
        return t_s, at, turned, velocity, spin, jump > 0.0, returns > 0.0

    @cached_property
    def tracks(self) -> tuple[tuple[str, Track], ...]:
        """Each with its actor's name."""
        _, rest, _ = self._packed
        t_s, at, turned, velocity, spin, jump, returns = self.columns
        found, begin = [], 0
        for name, count, *words in rest:
            my = slice(begin, begin + count)
            begin += count
            known = t_s[my], at[my], turned[my], velocity[my], spin[my], jump[my], returns[my]
            found.append((name, Track(*known, *words)))
        return tuple(found)


NOTHING = World()
