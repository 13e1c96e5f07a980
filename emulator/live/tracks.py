"""Where fed actors are at any instant: interpolated between samples, extrapolated beyond them, held when they end.

Belongs here: pure functions of samples and instants. Not: which samples are kept (book), whose motion it is (world).

A track goes with the plan of a sweep to whoever measures it, so that a sweep depends on nothing but what it was given.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
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

    def is_there(self, begin_s: float, end_s: float) -> bool:
        """It is, all the time."""
        return end_s < self.lasts_s and (not self.begins or begin_s >= float(self.t_s[0]))

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
        return together([self], t_s)

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


def together(tracks: Sequence[Track], t_s: Floats) -> tuple[Floats, Floats]:
    """Poses of several tracks, of one rule `between`, at the same n instants, one after the other: (m n, 3), (m n, 4).

    Without the way back of a feed that returns.
    """
    knots = {name: np.concatenate([getattr(track, name) for track in tracks]) for name in COLUMNS}
    sizes = np.array([len(track.t_s) for track in tracks])
    firsts = np.cumsum(sizes) - sizes
    count = len(t_s)
    index = np.concatenate([np.searchsorted(track.t_s, t_s, side="right") - 1 for track in tracks])
    index = np.maximum(index, 0) + firsts.repeat(count)
    last = (firsts + sizes - 1).repeat(count)
    times, at_m, jump = np.tile(t_s, len(tracks)), knots["at_m"], knots["jump"]
    when = knots["t_s"]
    after = np.minimum(index + 1, last)
    inside = (index < last) & (times > when[index])
    frozen = inside & jump[after]
    stays = frozen | (inside & knots["returns"][after])
    between = tracks[0].between
    inside = inside & ~stays if between == "interpolate" else np.zeros(len(times), bool)
    at, quaternion = at_m[index], knots["quaternion"][index]
    rows = np.flatnonzero(inside)
    if len(rows):
        before, beyond = index[rows], after[rows]
        span = when[beyond] - when[before]
        share = (times[rows] - when[before]) / span
        velocity = knots["velocity_m_s"]
        at[rows] = hermite(at_m[before], at_m[beyond], velocity[before], velocity[beyond], span, share)
        turns = np.flatnonzero((knots["quaternion"][before] != knots["quaternion"][beyond]).any(axis=1))
        if len(turns):
            there = rows[turns]
            quaternion[there] = slerp(quaternion[there], knots["quaternion"][beyond[turns]], share[turns])
    rows = np.flatnonzero(~inside & ~frozen & (times > when[index])) if between != "hold" else rows[:0]
    if len(rows):
        used, inverse = np.unique(index[rows], return_inverse=True)
        velocity, spin = _twists(knots, used, np.isin(used, firsts))
        hold_s = np.array([track.hold_after_s for track in tracks]).repeat(count)[rows]
        span = np.minimum(times[rows] - when[index[rows]], hold_s)
        at[rows] += travelled(velocity[inverse], spin[inverse], span)
        quaternion[rows] = product(of_vector(span[:, None] * spin[inverse]), quaternion[rows])
    return at, quaternion


def _twists(
    knots: Mapping[str, NDArray[Any]], used: NDArray[np.int64], first: NDArray[np.bool_]
) -> tuple[Floats, Floats]:
    """Velocities and angular velocities at samples: as given, else from each and the one before, else 0."""
    before = np.maximum(used - 1, 0)
    known = ~first & ~knots["jump"][used] & ~knots["returns"][used]
    step = np.where(known, knots["t_s"][used] - knots["t_s"][before], 1.0)[:, None]
    moved = np.where(known[:, None], (knots["at_m"][used] - knots["at_m"][before]) / step, 0.0)
    turn = to_vector(product(knots["quaternion"][used], conjugate(knots["quaternion"][before])))
    turned = np.where(known[:, None], turn / step, 0.0)
    velocity, spin = knots["velocity_m_s"][used], knots["spin_rad_s"][used]
    return np.where(np.isnan(velocity), moved, velocity), np.where(np.isnan(spin), turned, spin)


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
        interpolated = np.array([one == "interpolate" for one in self.rest[2 + _REST.index("between")]])
        return natures_of(self.columns, self.rest[1], interpolated)

    @cached_property
    def straight_s(self) -> tuple[Floats, Floats]:
        """(m,) from when, and until when, each of at least one track is straight, where it is."""
        begins, gone_s, _, hold_s, vanish_s, *_ = self.rest[2:]
        known = self.natures
        lasts_s = np.minimum(gone_s, known.last_s + vanish_s)
        beyond = known.last_s + np.where(known.known_last, hold_s, 0.0)
        begin_s = np.where(known.rests & ~np.array(begins), -np.inf, known.first_s)
        return begin_s, np.where(known.rests, lasts_s, np.minimum(beyond, lasts_s))

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
