"""From groups of echoes to objects with a life: association, size and heading over time, birth, coasting, death.

Belongs here: one tracker, asked once a list. Filter equations are in `kalman`, grouping in `segments`, classes in
`classes`. Tracks are kept in the world's frame when the motion of the listing sensor is known, so that what stands has
no speed and what is not seen stays where it was; without it the sensor's frame is taken to stand still.
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import deepcopy
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from emulator.objects import classes, kalman
from emulator.objects.options import TrackerOptions
from emulator.objects.points import Floats, Integers, Points, SensorMotion, View, joined, points_of
from emulator.objects.segments import Groups, segment
from emulator.objects.tracks import Tracks
from protocols.scan import DetectedObject

FAR = 1e6
"Cost of a pair that is none."
HEADING_SPEED_M_S = 1.5
"From this speed on the direction of motion shows which side is the front."
ABSORB_M = 0.3
"A group whose centre lies in a track's box, or this near to it, is a piece of that object."
YAW_DRIFT_RAD_S = np.radians(20.0)
"A car in a tight bend."
CORNER_M, LINE_M = 0.4, 1.0
"Least second side of an L-shape; least length of a side that shows a direction."
YAW_NOISE_RAD = {"corner": np.radians(4.0), "line": np.radians(10.0), "blob": np.radians(80.0)}
GROW, SHRINK = 0.5, 0.05
"Share of the difference by which a remembered size follows one scan's."
MOST_CERTAIN = 0.9999
OBLIQUE = np.sin(np.radians(15.0))
"From this angle on a side is seen well enough to measure it."
ONE_TURN = 2.0 * np.pi


def wrapped(angle: Floats) -> Floats:
    """Angle in [-pi, pi)."""
    return np.asarray((angle + np.pi) % ONE_TURN - np.pi)


@dataclass(frozen=True)
class Snapshot:
    """What a tracker knew after a list."""

    tracks: Tracks
    next_number: int
    t_s: float | None


class ObjectTracker:
    """Objects of one listing sensor over time."""

    def __init__(self, options: TrackerOptions | None = None, actors: Sequence[str] = ()) -> None:
        """`actors`: names by number, for the truth kept beside each object and for `classify: actor`."""
        self.options = options or TrackerOptions()
        self._actors = tuple(actors)
        self._tracks = Tracks.none()
        self._next_number = 1
        self._t_s: float | None = None

    def clear(self) -> None:
        """Forget every object; numbers go on."""
        self._tracks = Tracks.none()
        self._t_s = None

    def snapshot(self) -> Snapshot:
        """What is known at present."""
        return Snapshot(deepcopy(self._tracks), self._next_number, self._t_s)

    def restore(self, snapshot: Snapshot) -> None:
        """Go back to what was known then; numbers given since are given again."""
        self._tracks, self._next_number, self._t_s = deepcopy(snapshot.tracks), snapshot.next_number, snapshot.t_s

    def update(
        self, scans: Sequence[View], t_s: float, motion: SensorMotion | None = None
    ) -> tuple[DetectedObject, ...]:
        """Objects at `t_s`, by number, from the scans since the last call.

        Parameters
        ----------
        scans : scans of one or more sensors; empty: nothing was measured, objects only move on.
        t_s : time of the list; never earlier than the call before.
        motion : pose and motion of the listing sensor at `t_s`; None: it stands at the origin.
        """
        if self._t_s is not None and t_s < self._t_s:
            raise ValueError(f"list at {t_s} s after one at {self._t_s} s")
        motion = motion or SensorMotion()
        tracks, options = self._tracks, self.options
        dt_s = 0.0 if self._t_s is None else t_s - self._t_s
        self._t_s = t_s
        tracks.state, tracks.covariance = kalman.predict(
            tracks.state, tracks.covariance, dt_s, options.acceleration_m_s2
        )
        tracks.yaw_variance = tracks.yaw_variance + (YAW_DRIFT_RAD_S * dt_s) ** 2
        tracks.group = np.full(len(tracks), -1, dtype=np.int64)
        groups: Groups | None = None
        if scans:
            points = motion.straightened(joined([points_of(view, options.height_m) for view in scans]), t_s)
            groups = segment(points, options)
            rows, columns = self._associate(groups, t_s, motion)
            self._miss(np.setdiff1d(np.arange(len(tracks)), rows), points, motion)
            self._see(rows, columns, groups, t_s, motion)
            self._give_birth(np.setdiff1d(np.arange(len(groups)), columns), groups, t_s, motion)
        alive = t_s - tracks.seen_s <= options.coast_s + 1e-9
        # what has not been confirmed must be seen without a gap
        alive &= (tracks.hits >= options.confirm_hits) | (tracks.group >= 0) | (not scans)
        tracks.keep(alive)
        return self._objects(groups, t_s, motion)

    # Association

    def _associate(self, groups: Groups, t_s: float, motion: SensorMotion) -> tuple[Integers, Integers]:
        """Tracks and the groups that they are seen as."""
        tracks, options = self._tracks, self.options
        none = np.zeros(0, dtype=np.int64)
        if not len(tracks) or not len(groups):
            return none, none
        if options.segmentation == "actor":
            same = tracks.actor[:, None] == groups.actor[None, :]
            rows, columns = np.nonzero(same)
            return rows.astype(np.int64), columns.astype(np.int64)
        length, width = self._sizes()
        place = completed_places(length[:, None], width[:, None], tracks.yaw_rad[:, None], groups, slice(None), motion)
        cost = kalman.distances(tracks.state, tracks.covariance, place, self._place_variance(groups), t_s - groups.t_s)
        cost = np.where(cost <= options.gate, cost, FAR)
        rows, columns = linear_sum_assignment(cost)
        taken = cost[rows, columns] < FAR
        return rows[taken].astype(np.int64), columns[taken].astype(np.int64)

    def _sizes(self) -> tuple[Floats, Floats]:
        """Length and width of every track, what has never been seen assumed."""
        tracks = self._tracks
        return classes.assumed_sizes(tracks.length_m, tracks.width_m, tracks.length_known, tracks.width_known)

    def _place_variance(self, groups: Groups) -> Floats:
        return np.asarray(self.options.position_noise_m**2 + (0.5 * groups.spacing_m) ** 2)

    # One scan

    def _see(self, rows: Integers, columns: Integers, groups: Groups, t_s: float, motion: SensorMotion) -> None:
        """Tracks that were seen: heading, size, place, existence."""
        if not len(rows):
            return
        tracks, options = self._tracks, self.options
        length, width = self._sizes()
        before = completed_places(length[rows], width[rows], tracks.yaw_rad[rows], groups, columns, motion)
        self._turn(rows, columns, groups, motion)
        odd = is_quarter_turned(tracks.yaw_rad[rows], groups, columns, motion)
        along, across = groups.along_m[columns], groups.across_m[columns]
        corner = np.minimum(along, across) >= CORNER_M
        corner &= ~(groups.hidden_left[columns] | groups.hidden_right[columns])
        tracks.length_m[rows] = grown(tracks.length_m[rows], np.where(odd, across, along), corner)
        tracks.width_m[rows] = grown(tracks.width_m[rows], np.where(odd, along, across), corner)
        length_seen, width_seen = sides_seen(tracks.yaw_rad[rows], groups, columns, motion)
        tracks.length_known[rows] |= length_seen
        tracks.width_known[rows] |= width_seen
        length, width = self._sizes()
        place = completed_places(length[rows], width[rows], tracks.yaw_rad[rows], groups, columns, motion)
        # a box that is known better has its middle elsewhere, but has not moved
        tracks.state[rows, :2] += place - before
        tracks.state[rows], tracks.covariance[rows] = kalman.update(
            tracks.state[rows],
            tracks.covariance[rows],
            place,
            self._place_variance(groups)[columns],
            t_s - groups.t_s[columns],
        )
        tracks.low_m[rows] = np.minimum(tracks.low_m[rows], groups.low_m[columns])
        tracks.high_m[rows] = np.maximum(tracks.high_m[rows], groups.high_m[columns])
        tracks.reflectance[rows] = groups.reflectance[columns]
        tracks.actor[rows] = groups.actor[columns]
        tracks.group[rows] = columns
        tracks.hits[rows] += 1
        tracks.seen_s[rows] = t_s
        tracks.existence[rows] = believed(
            tracks.existence[rows], np.full(len(rows), options.seen_if_there), options.seen_if_not_there, seen=True
        )

    def _turn(self, rows: Integers, columns: Integers, groups: Groups, motion: SensorMotion) -> None:
        """Headings: the side of the rectangle that is nearest to the direction of motion, or to the heading before."""
        tracks = self._tracks
        velocity = tracks.state[rows, 2:]
        speed = np.hypot(velocity[:, 0], velocity[:, 1])
        sure = speed > np.maximum(HEADING_SPEED_M_S, 2.0 * np.sqrt(tracks.covariance[rows, 2, 2]))
        wanted = np.where(sure, np.arctan2(velocity[:, 1], velocity[:, 0]), tracks.yaw_rad[rows])
        measured = groups.yaw_rad[columns] + motion.yaw_rad
        measured = measured + np.round((wanted - measured) / (0.5 * np.pi)) * 0.5 * np.pi
        shape = np.minimum(groups.along_m[columns], groups.across_m[columns])
        longest = np.maximum(groups.along_m[columns], groups.across_m[columns])
        noise = np.where(
            shape >= CORNER_M,
            YAW_NOISE_RAD["corner"],
            np.where(longest >= LINE_M, YAW_NOISE_RAD["line"], YAW_NOISE_RAD["blob"]),
        )
        # small things have no direction of their own: they look where they go
        blob = longest < LINE_M
        measured = np.where(blob & sure, wanted, measured)
        noise = np.where(blob & sure, YAW_NOISE_RAD["line"], noise)
        quarters = np.round(wrapped(measured - tracks.yaw_rad[rows]) / (0.5 * np.pi))
        swap = (quarters.astype(np.int64) % 2).astype(np.bool_)
        length, width = tracks.length_m[rows], tracks.width_m[rows]
        tracks.length_m[rows], tracks.width_m[rows] = np.where(swap, width, length), np.where(swap, length, width)
        known, other = tracks.length_known[rows], tracks.width_known[rows]
        tracks.length_known[rows], tracks.width_known[rows] = np.where(swap, other, known), np.where(swap, known, other)
        yaw = tracks.yaw_rad[rows] + quarters * 0.5 * np.pi
        variance = tracks.yaw_variance[rows]
        gain = variance / (variance + noise**2)
        tracks.yaw_rad[rows] = wrapped(yaw + gain * wrapped(measured - yaw))
        tracks.yaw_variance[rows] = (1.0 - gain) * variance

    def _miss(self, rows: Integers, points: Points, motion: SensorMotion) -> None:
        """Tracks that were not seen: less believed in, less so when something stands before them."""
        if not len(rows):
            return
        tracks, options = self._tracks, self.options
        x, y = motion.to_sensor(tracks.state[rows, 0], tracks.state[rows, 1])
        radius = 0.5 * np.hypot(*(size[rows] for size in self._sizes()))
        there = np.array(
            [
                options.seen_if_hidden if is_hidden(points, *place) else options.seen_if_there
                for place in zip(x.tolist(), y.tolist(), radius.tolist(), strict=True)
            ]
        )
        tracks.existence[rows] = believed(tracks.existence[rows], there, options.seen_if_not_there, seen=False)

    def _give_birth(self, columns: Integers, groups: Groups, t_s: float, motion: SensorMotion) -> None:
        """New tracks for groups that are no piece of a known object."""
        tracks, options = self._tracks, self.options
        if len(tracks) and len(columns) and options.segmentation != "actor":
            columns = columns[~self._is_piece(columns, groups, motion)]
        k = len(columns)
        if not k:
            return
        along, across, yaw = groups.along_m[columns], groups.across_m[columns], groups.yaw_rad[columns]
        turned = across > along
        yaw = np.where(turned, yaw + 0.5 * np.pi, yaw)
        long_m, short_m = np.maximum(along, across), np.minimum(along, across)
        sight = np.arctan2(groups.y_m[columns], groups.x_m[columns])
        across_sight = np.abs(np.cos(yaw - sight)) < 0.5
        rear = classes.is_flat_across(long_m, short_m, across_sight)
        yaw = np.where(rear, yaw - 0.5 * np.pi, yaw)
        yaw = wrapped(yaw + np.where(np.cos(yaw) < 0.0, np.pi, 0.0))
        length, width = np.where(rear, short_m, long_m), np.where(rear, long_m, short_m)
        heading = wrapped(yaw + motion.yaw_rad)
        length_known, width_known = sides_seen(heading, groups, columns, motion)
        sizes = classes.assumed_sizes(length, width, length_known, width_known)
        place = completed_places(*sizes, heading, groups, columns, motion)
        variance = self._place_variance(groups)[columns]
        covariance = np.zeros((k, 4, 4))
        covariance[:, 0, 0] = covariance[:, 1, 1] = variance
        covariance[:, 2, 2] = covariance[:, 3, 3] = options.first_speed_m_s**2
        tracks.add(
            Tracks(
                number=np.arange(self._next_number, self._next_number + k, dtype=np.int64),
                state=np.concatenate([place, np.zeros((k, 2))], axis=1),
                covariance=covariance,
                yaw_rad=heading,
                yaw_variance=np.full(k, YAW_NOISE_RAD["blob"] ** 2),
                length_m=length,
                width_m=width,
                length_known=length_known,
                width_known=width_known,
                low_m=groups.low_m[columns],
                high_m=groups.high_m[columns],
                existence=np.full(k, options.first_existence),
                hits=np.ones(k, dtype=np.int64),
                born_s=np.full(k, t_s),
                seen_s=np.full(k, t_s),
                reflectance=groups.reflectance[columns],
                actor=groups.actor[columns],
                group=columns,
            )
        )
        self._next_number += k

    def _is_piece(self, columns: Integers, groups: Groups, motion: SensorMotion) -> NDArray[np.bool_]:
        """Whether a group's centre lies in the box of a track that was seen in this scan."""
        tracks = self._tracks
        x, y = motion.to_world(groups.x_m[columns], groups.y_m[columns])
        dx, dy = x[None, :] - tracks.state[:, 0, None], y[None, :] - tracks.state[:, 1, None]
        c, s = np.cos(tracks.yaw_rad)[:, None], np.sin(tracks.yaw_rad)[:, None]
        length, width = self._sizes()
        inside = np.abs(c * dx + s * dy) <= 0.5 * length[:, None] + ABSORB_M
        inside &= np.abs(c * dy - s * dx) <= 0.5 * width[:, None] + ABSORB_M
        inside &= (tracks.group >= 0)[:, None]
        return np.asarray(inside.any(axis=0))

    # Output

    def _objects(self, groups: Groups | None, t_s: float, motion: SensorMotion) -> tuple[DetectedObject, ...]:
        tracks, options = self._tracks, self.options
        listed = np.flatnonzero(tracks.hits >= options.confirm_hits)
        x, y = motion.to_sensor(tracks.state[:, 0], tracks.state[:, 1])
        vx, vy = motion.relative_velocity(*tracks.state.T)
        yaw = wrapped(tracks.yaw_rad - motion.yaw_rad)
        c, sine = np.cos(motion.yaw_rad), np.sin(motion.yaw_rad)
        turn = np.array([[c, sine], [-sine, c]])
        place_std = np.sqrt(np.einsum("ij,njk,ik->ni", turn, tracks.covariance[:, :2, :2], turn))
        speed_std = np.sqrt(np.einsum("ij,njk,ik->ni", turn, tracks.covariance[:, 2:, 2:], turn))
        length, width = self._sizes()
        category = self._categories()
        out = []
        for row in listed.tolist():
            group = int(tracks.group[row])
            out.append(
                DetectedObject(
                    track=int(tracks.number[row]),
                    position_m=(float(x[row]), float(y[row]), float(0.5 * (tracks.low_m[row] + tracks.high_m[row]))),
                    velocity_m_s=(float(vx[row]), float(vy[row]), 0.0),
                    size_m=(
                        float(length[row]),
                        float(width[row]),
                        float(tracks.high_m[row] - tracks.low_m[row]),
                    ),
                    yaw_rad=float(yaw[row]),
                    category=category[row],
                    age_s=float(t_s - tracks.born_s[row]),
                    existence=float(tracks.existence[row]),
                    position_std_m=(float(place_std[row, 0]), float(place_std[row, 1])),
                    velocity_std_m_s=(float(speed_std[row, 0]), float(speed_std[row, 1])),
                    reflectance=float(tracks.reflectance[row]),
                    actor=self._name(int(tracks.actor[row])),
                    coasting_s=float(max(0.0, t_s - tracks.seen_s[row])),
                    yaw_std_rad=float(np.sqrt(tracks.yaw_variance[row])),
                    contour_m=() if groups is None or group < 0 else outline(groups, group, options.contour_points),
                )
            )
        return tuple(out)

    def _categories(self) -> list[str]:
        tracks, options = self._tracks, self.options
        if options.classify == "actor":
            names = [self._name(number) for number in tracks.actor.tolist()]
            return [options.classes.get(name, "unknown") if name is not None else "unknown" for name in names]
        return [classes.NAMES[code] for code in classes.by_size(*self._sizes()).tolist()]

    def _name(self, actor: int) -> str | None:
        return self._actors[actor] if 0 <= actor < len(self._actors) else None


def completed(
    low: Floats, high: Floats, size: Floats, hidden_low: NDArray[np.bool_], hidden_high: NDArray[np.bool_]
) -> Floats:
    """Middle of a side of known size of which [low, high] is seen, along an axis through the sensor at 0.

    The nearer end is the one that is really there, the farther one may be out of sight; unless something stands before
    one of the ends: then the other one counts.
    """
    size = np.maximum(size, high - low)
    from_low, from_high, middle = low + 0.5 * size, high - 0.5 * size, 0.5 * (low + high)
    free = np.where(low > 0.0, from_low, np.where(high < 0.0, from_high, middle))
    one = np.where(hidden_low, from_high, from_low)
    return np.asarray(np.where(hidden_low & hidden_high, middle, np.where(hidden_low | hidden_high, one, free)))


def is_quarter_turned(
    yaw_rad: Floats, groups: Groups, columns: Integers | slice, motion: SensorMotion
) -> NDArray[np.bool_]:
    """Whether a group's `along` is the width of an object of that heading."""
    quarters = np.round((yaw_rad - motion.yaw_rad - groups.yaw_rad[columns]) / (0.5 * np.pi))
    return np.asarray((quarters.astype(np.int64) % 2).astype(np.bool_))


def sides_seen(
    yaw_rad: Floats, groups: Groups, columns: Integers, motion: SensorMotion
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Whether the length and the width of objects of that heading are seen at an angle that allows to measure them."""
    sight = np.arctan2(groups.y_m[columns], groups.x_m[columns]) + motion.yaw_rad - yaw_rad
    return np.abs(np.sin(sight)) >= OBLIQUE, np.abs(np.cos(sight)) >= OBLIQUE


def completed_places(
    length_m: Floats,
    width_m: Floats,
    yaw_rad: Floats,
    groups: Groups,
    columns: Integers | slice,
    motion: SensorMotion,
) -> Floats:
    """(..., 2) centre in the world that groups have as the box of objects of known size and heading."""
    odd = is_quarter_turned(yaw_rad, groups, columns, motion)
    yaw, x, y = groups.yaw_rad[columns], groups.x_m[columns], groups.y_m[columns]
    left, right = groups.hidden_left[columns], groups.hidden_right[columns]
    c, s = np.cos(yaw), np.sin(yaw)
    off_sight = yaw - np.arctan2(y, x)
    sides = []
    for middle, half, size, towards_left in (
        (c * x + s * y, 0.5 * groups.along_m[columns], np.where(odd, width_m, length_m), np.sin(off_sight)),
        (c * y - s * x, 0.5 * groups.across_m[columns], np.where(odd, length_m, width_m), np.cos(off_sight)),
    ):
        # which end of this side is the one that something hides; of a side along the line of sight neither is
        hidden_high = np.where(towards_left > 0.0, left, right) & (np.abs(towards_left) > 0.5)
        hidden_low = np.where(towards_left > 0.0, right, left) & (np.abs(towards_left) > 0.5)
        sides.append(completed(middle - half, middle + half, size, hidden_low, hidden_high))
    a, b = sides
    return np.stack(motion.to_world(c * a - s * b, s * a + c * b), axis=-1)


def grown(size: Floats, seen: Floats, corner: NDArray[np.bool_]) -> Floats:
    """Size after a look: half way up to what is seen, slowly down where two sides are seen."""
    step = np.where(seen > size, GROW, np.where(corner, SHRINK, 0.0))
    return np.asarray(size + step * (seen - size))


def is_hidden(points: Points, x_m: float, y_m: float, radius_m: float) -> bool:
    """Whether echoes nearer than an object cover at least half of the angle that it takes."""
    distance = float(np.hypot(x_m, y_m))
    if distance <= radius_m or not len(points):
        return False
    half = float(np.arcsin(min(1.0, radius_m / distance)))
    off = wrapped(np.arctan2(points.y_m, points.x_m) - np.arctan2(y_m, x_m))
    before = (np.abs(off) <= half) & (np.hypot(points.x_m, points.y_m) < distance - radius_m)
    covered = np.unique(np.floor((off[before] + half) / (half / 4.0)))
    return len(covered) >= 4


def believed(existence: Floats, there: Floats, not_there: float, seen: bool) -> Floats:
    """Probability of existence after a scan, by Bayes' rule."""
    if_there = there if seen else 1.0 - there
    if_not = not_there if seen else 1.0 - not_there
    odds = existence * if_there
    return np.minimum(odds / (odds + (1.0 - existence) * if_not), MOST_CERTAIN)


def outline(groups: Groups, number: int, most: int) -> tuple[tuple[float, float], ...]:
    """Points of a group in the order of azimuth, evenly thinned."""
    start, end = int(groups.first[number]), int(groups.first[number + 1])
    index = np.arange(start, end)
    if len(index) > most:
        index = index[np.linspace(0, len(index) - 1, most).round().astype(np.int64)]
    return tuple(zip(groups.points.x_m[index].tolist(), groups.points.y_m[index].tolist(), strict=True))
