"""How well a list of objects fits the truth: precision, recall, and errors of place, size and speed.

Belongs here: judging lists, for reports and expectations. Not: making them (`emulator.objects`); nothing here is seen
by a device or its host.

A detection is judged by the actor that most of its echoes come from. The nearest detection of an actor is its match
when it lies within the gate; further ones of the same actor, and those of no known actor, are false. An actor counts as
there to be seen when the share of its beams that reach it is at least `least_share`.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from protocols.scan import DetectedObject, Floats, Scan

if TYPE_CHECKING:  # the process that sends judges too, and must not load the tracker's libraries
    from emulator.objects.points import View

GATE_M = 2.0
"Distance beyond half the object's diagonal at which a detection is another thing."
LEAST_SHARE = 0.1
DISTANCE_BINS_M = (10.0, 20.0, 40.0, 60.0, 100.0, 150.0, math.inf)
"Upper ends of the distance classes."


@dataclass(frozen=True)
class TruthObject:
    """An actor as it is at the time of a list, in the frame of the sensor that lists objects."""

    actor: str
    position_m: tuple[float, float, float]
    "Centre of its box."
    velocity_m_s: tuple[float, float, float]
    "Relative to the sensor."
    size_m: tuple[float, float, float]
    "Length, width, height."
    yaw_rad: float = 0.0
    visible_share: float = 1.0
    "Of the beams that point at its box, those whose echo it is, 0..1."

    @property
    def distance_m(self) -> float:
        """Horizontal distance of the centre."""
        return math.hypot(self.position_m[0], self.position_m[1])


@dataclass(frozen=True, eq=False)
class ListedScan(Scan):
    """A list of objects with the truth beside it; no session looks at that."""

    truth: tuple[TruthObject, ...] = ()


@dataclass(frozen=True)
class Judgement:
    """One list against the truth."""

    matched: tuple[tuple[DetectedObject, TruthObject], ...]
    false: tuple[DetectedObject, ...]
    missed: tuple[TruthObject, ...]
    hidden: tuple[TruthObject, ...]
    "Not listed, and not to be seen either."


@dataclass(frozen=True)
class Score:
    """Figures over many lists; NaN where there was nothing to judge."""

    seen: int
    "Detections that matched."
    false: int
    missed: int
    position_m: float
    "Root mean square of the distance between the centres."
    size_m: float
    "Mean absolute error of length and width."
    speed_m_s: float
    "Root mean square of the difference of the velocities in the plane."

    @property
    def precision(self) -> float:
        """Share of the detections that are real."""
        return self.seen / (self.seen + self.false) if self.seen + self.false else math.nan

    @property
    def recall(self) -> float:
        """Share of the objects to be seen that were listed."""
        return self.seen / (self.seen + self.missed) if self.seen + self.missed else math.nan


@dataclass
class _Sums:
    seen: int = 0
    false: int = 0
    missed: int = 0
    position: float = 0.0
    size: float = 0.0
    speed: float = 0.0

    def score(self) -> Score:
        def mean(total: float) -> float:
            return total / self.seen if self.seen else math.nan

        return Score(
            self.seen,
            self.false,
            self.missed,
            math.sqrt(mean(self.position)),
            mean(self.size),
            math.sqrt(mean(self.speed)),
        )


@dataclass
class ObjectScore:
    """Adds up lists: in all, for each actor, for each class of distance."""

    least_share: float = LEAST_SHARE
    gate_m: float = GATE_M
    lists: int = 0
    _total: _Sums = field(default_factory=_Sums)
    _actors: dict[str, _Sums] = field(default_factory=dict)
    _distances: dict[float, _Sums] = field(default_factory=dict)
    _pairs: dict[tuple[str, float], _Sums] = field(default_factory=dict)

    def add(self, objects: Sequence[DetectedObject], truths: Sequence[TruthObject]) -> Judgement:
        """Judge one list and count it."""
        self.lists += 1
        judged = judge(objects, truths, self.least_share, self.gate_m)
        for found, truth in judged.matched:
            place = _squared(found.position_m, truth.position_m)
            speed = _squared(found.velocity_m_s, truth.velocity_m_s)
            size = 0.5 * sum(abs(found.size_m[k] - truth.size_m[k]) for k in (0, 1))
            for sums in self._rows(truth.actor, truth.distance_m):
                sums.seen += 1
                sums.position += place
                sums.speed += speed
                sums.size += size
        for truth in judged.missed:
            for sums in self._rows(truth.actor, truth.distance_m):
                sums.missed += 1
        for found in judged.false:
            for sums in self._rows(found.actor, math.hypot(found.position_m[0], found.position_m[1])):
                sums.false += 1
        return judged

    @property
    def total(self) -> Score:
        """Over everything."""
        return self._total.score()

    @property
    def by_actor(self) -> Mapping[str, Score]:
        """For each actor."""
        return {actor: sums.score() for actor, sums in sorted(self._actors.items())}

    @property
    def by_distance_m(self) -> Mapping[float, Score]:
        """For each class of distance, by its upper end."""
        return {end: sums.score() for end, sums in sorted(self._distances.items())}

    @property
    def by_actor_and_distance_m(self) -> Mapping[tuple[str, float], Score]:
        """For each actor in each class of distance that it was in."""
        return {pair: sums.score() for pair, sums in sorted(self._pairs.items())}

    def as_json(self) -> dict[str, Any]:
        """All figures, ready for JSON; null where there is none, and as the end of the farthest class."""
        return {
            "lists": self.lists,
            "total": _figures(self.total),
            "by_actor": {actor: _figures(score) for actor, score in self.by_actor.items()},
            "by_distance": [{"up_to_m": _known(end), **_figures(score)} for end, score in self.by_distance_m.items()],
            "by_actor_and_distance": [
                {"actor": actor, "up_to_m": _known(end), **_figures(score)}
                for (actor, end), score in self.by_actor_and_distance_m.items()
            ],
        }

    def _rows(self, actor: str | None, distance_m: float) -> list[_Sums]:
        end = next(end for end in DISTANCE_BINS_M if distance_m < end)
        rows = [self._total, self._distances.setdefault(end, _Sums())]
        if actor is not None:
            rows.append(self._actors.setdefault(actor, _Sums()))
            rows.append(self._pairs.setdefault((actor, end), _Sums()))
        return rows


def _known(value: float) -> float | None:
    return round(value, 4) if math.isfinite(value) else None


def _figures(score: Score) -> dict[str, Any]:
    return {
        "seen": score.seen,
        "false": score.false,
        "missed": score.missed,
        "precision": _known(score.precision),
        "recall": _known(score.recall),
        "position_m": _known(score.position_m),
        "size_m": _known(score.size_m),
        "speed_m_s": _known(score.speed_m_s),
    }


def reported(figures: Mapping[str, Any]) -> Iterator[str]:
    """`ObjectScore.as_json` as a table: each object by class of distance, each object, each class of distance, all."""
    yield f"{figures['lists']} lists  precision recall place [m] size [m] speed [m/s]  seen false missed"
    rows = [(f"{row['actor']}, {_up_to(row)}", row) for row in figures["by_actor_and_distance"]]
    rows += list(figures["by_actor"].items())
    rows += [(_up_to(row), row) for row in figures["by_distance"]]
    for name, row in [*rows, ("all", figures["total"])]:
        cells = [f"{row[key]:9.3f}" if row[key] is not None else "        -" for key in _CELLS]
        yield f"  {name:28s}{''.join(cells)} {row['seen']:6d} {row['false']:5d} {row['missed']:6d}"


def _up_to(row: Mapping[str, Any]) -> str:
    return "beyond" if row["up_to_m"] is None else f"up to {row['up_to_m']:g} m"


_CELLS = ("precision", "recall", "position_m", "size_m", "speed_m_s")


def judge(
    objects: Sequence[DetectedObject],
    truths: Sequence[TruthObject],
    least_share: float = LEAST_SHARE,
    gate_m: float = GATE_M,
) -> Judgement:
    """Which detections are which actors, which are false, and which actors are missing."""
    by_actor = {truth.actor: truth for truth in truths}
    nearest: dict[str, DetectedObject] = {}
    false: list[DetectedObject] = []
    for found in sorted(objects, key=lambda found: _apart(found, by_actor)):
        if not math.isfinite(_apart(found, by_actor)) or found.actor is None or found.actor in nearest:
            false.append(found)
            continue
        truth = by_actor[found.actor]
        if _apart(found, by_actor) <= gate_m + 0.5 * math.hypot(truth.size_m[0], truth.size_m[1]):
            nearest[found.actor] = found
        else:
            false.append(found)
    absent = [truth for truth in truths if truth.actor not in nearest]
    return Judgement(
        matched=tuple((found, by_actor[actor]) for actor, found in nearest.items()),
        false=tuple(false),
        missed=tuple(truth for truth in absent if truth.visible_share >= least_share),
        hidden=tuple(truth for truth in absent if truth.visible_share < least_share),
    )


def visible_share(view: View, truth: TruthObject, actor: int) -> float:
    """Share of the beams pointing at an actor's box that have an echo of it; 0 when none points there.

    `actor` is its number in `Scan.actor`. The box's outline is taken as a rectangle of angles, so beams past its
    corners count as pointing at it: a free-standing object reaches 1 only when seen squarely.
    """
    plan = view.scan.plan
    c, s = math.cos(truth.yaw_rad), math.sin(truth.yaw_rad)
    half = 0.5 * np.asarray(truth.size_m)
    signs = np.array([(i, j, k) for i in (-1, 1) for j in (-1, 1) for k in (-1, 1)], dtype=np.float64)
    turned = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    corners = (np.asarray(truth.position_m) + (signs * half) @ turned.T - view.position_m) @ view.rotation
    middle = math.atan2(corners[:, 1].mean(), corners[:, 0].mean())
    azimuth = _wrapped(np.arctan2(corners[:, 1], corners[:, 0]) - middle)
    elevation = np.arctan2(corners[:, 2], np.hypot(corners[:, 0], corners[:, 1]))
    off = _wrapped(plan.azimuth_rad - middle)
    at_it = (off >= azimuth.min()) & (off <= azimuth.max())
    if truth.size_m[2] > 0.0:
        at_it &= (plan.elevation_rad >= elevation.min()) & (plan.elevation_rad <= elevation.max())
    if not at_it.any():
        return 0.0
    return float((view.scan.actor[at_it] == actor).any(axis=1).mean())


def _wrapped(angle: Floats) -> Floats:
    return np.asarray((angle + math.pi) % (2.0 * math.pi) - math.pi)


def _apart(found: DetectedObject, truths: Mapping[str, TruthObject]) -> float:
    truth = truths.get(found.actor) if found.actor is not None else None
    return math.inf if truth is None else math.sqrt(_squared(found.position_m, truth.position_m))


def _squared(one: Sequence[float], other: Sequence[float]) -> float:
    """Squared distance in the plane."""
    return (one[0] - other[0]) ** 2 + (one[1] - other[1]) ** 2
