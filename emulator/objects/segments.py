"""Which echoes belong together, and the box around each group.

Belongs here: grouping by distance (SciPy's k-d tree and graph components) or by actor, and rectangles fitted to
L-shapes. Not: what a group was in the scan before.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from emulator.objects.options import TrackerOptions
from emulator.objects.points import Floats, Integers, Points

CELLS_PER_GAP = 8
"Echoes are joined in cells of an eighth of the gap first: where they are dense, pairs would be many."
FIT_STEP_RAD = math.radians(2.0)
FIT_POINTS = 60
"Points of a group that the rectangle is fitted to; more change nothing and cost time."
EDGE_M, EDGE_BEAMS = 0.7, 2
"Something in one of the next two beams that is so much nearer hides the end of a group."
FIT_FLOOR_M = 0.05
"Nearer to an edge than this a point counts as on it: the range noise."


@dataclass(frozen=True, eq=False)
class Groups:
    """k groups of echoes, and the rectangle around each."""

    x_m: Floats
    "(k,) centre."
    y_m: Floats
    along_m: Floats
    "(k,) extent along `yaw_rad`."
    across_m: Floats
    yaw_rad: Floats
    "(k,) direction of one side, in [0, pi / 2)."
    low_m: Floats
    "(k,) lowest and highest echo."
    high_m: Floats
    t_s: Floats
    "(k,) mean instant of the echoes."
    spacing_m: Floats
    "(k,) distance between neighbouring beams there."
    hidden_right: NDArray[np.bool_]
    "(k,) its end of lowest azimuth is the edge of something nearer, and so not its own; likewise on the left."
    hidden_left: NDArray[np.bool_]
    reflectance: Floats
    actor: Integers
    "(k,) truth: the actor that most echoes are of, -1 for none."
    first: Integers
    "(k + 1,) where the points of each group begin in `points`."
    points: Points
    "All grouped points, group by group, each in the order of azimuth."

    def __len__(self) -> int:
        return len(self.x_m)


def cluster_labels(points: Points, gap_m: float, gap_per_m: float) -> Integers:
    """(n,) number of the cluster of each point: points nearer to each other than the gap at their range are linked.

    The range is cut into bands in each of which the gap doubles at most; a k-d tree finds the pairs of a band, and
    connected components join the bands.
    """
    n = len(points)
    place = np.stack([points.x_m, points.y_m], axis=-1)
    wanted_gap = gap_m + gap_per_m * points.range_m
    band = np.floor(np.log2(wanted_gap / gap_m)).astype(np.int64) if n else np.zeros(0, dtype=np.int64)
    rows: list[Integers] = []
    columns: list[Integers] = []
    for number in np.unique(band).tolist():
        inside = band == number
        gap = float(wanted_gap[inside].max())
        # with what lies next to it in the neighbouring bands
        near = np.flatnonzero(np.abs(band - number) <= 1)
        cell = np.floor(place[near] / (gap / CELLS_PER_GAP)).astype(np.int64)
        key = cell[:, 0] * (1 << 32) + cell[:, 1]
        _, leader, member = np.unique(key, return_index=True, return_inverse=True)
        rows.append(near)
        columns.append(near[leader[member]])
        pairs = cKDTree(place[near[leader]]).query_pairs(gap, output_type="ndarray")
        touches = inside[near[leader[pairs]]].any(axis=1)
        rows.append(near[leader[pairs[touches, 0]]])
        columns.append(near[leader[pairs[touches, 1]]])
    if not n:
        return np.zeros(0, dtype=np.int64)
    row, column = np.concatenate(rows), np.concatenate(columns)
    graph = coo_matrix((np.ones(len(row), dtype=np.int8), (row, column)), shape=(n, n))
    return np.asarray(connected_components(graph, directed=False)[1], dtype=np.int64)


def segment(points: Points, options: TrackerOptions) -> Groups:
    """Groups of echoes that may be road users: enough points, not too long."""
    everything = points
    if options.segmentation == "actor":
        points = points.take(points.actor > 0)  # 0 is the world, -1 weather
        labels = points.actor
    else:
        labels = cluster_labels(points, options.gap_m, options.gap_per_m)
    _, labels, counts = np.unique(labels, return_inverse=True, return_counts=True)
    enough = counts >= options.min_points
    keep = enough[labels] if len(labels) else np.zeros(0, dtype=np.bool_)
    points, labels = points.take(keep), labels[keep]
    order = np.lexsort((np.arctan2(points.y_m, points.x_m), labels))
    points, labels = points.take(order), labels[order]
    first = np.concatenate([np.flatnonzero(np.diff(labels, prepend=-1)), [len(labels)]]).astype(np.int64)
    groups = _boxed(points, first, everything, options)
    fits = (np.hypot(groups.along_m, groups.across_m) <= options.max_size_m) | (options.segmentation == "actor")
    return groups if fits.all() else _kept(groups, fits)


def _boxed(points: Points, first: Integers, everything: Points, options: TrackerOptions) -> Groups:
    starts, counts = first[:-1], np.diff(first)
    k = len(starts)
    if not k:
        none = np.zeros(0)
        no, number = np.zeros(0, dtype=np.bool_), np.zeros(0, dtype=np.int64)
        return Groups(*(none,) * 9, no, no, none, number, np.zeros(1, dtype=np.int64), points)
    yaw = fit_yaw(points.x_m, points.y_m, first)
    c, s = np.cos(yaw).repeat(counts), np.sin(yaw).repeat(counts)
    along, across = points.x_m * c + points.y_m * s, points.y_m * c - points.x_m * s
    along_low, along_high = np.minimum.reduceat(along, starts), np.maximum.reduceat(along, starts)
    across_low, across_high = np.minimum.reduceat(across, starts), np.maximum.reduceat(across, starts)
    middle_along, middle_across = 0.5 * (along_low + along_high), 0.5 * (across_low + across_high)
    spacing = np.add.reduceat(points.range_m * points.step_rad, starts) / counts
    # of a side that is w wide, beams a step apart hit w less one step on average
    x_m = middle_along * np.cos(yaw) - middle_across * np.sin(yaw)
    y_m = middle_along * np.sin(yaw) + middle_across * np.cos(yaw)
    off_sight = yaw - np.arctan2(y_m, x_m)
    reflectance = points.intensity * (points.range_m / options.white_range_m) ** 2
    return Groups(
        x_m=x_m,
        y_m=y_m,
        along_m=along_high - along_low + spacing * np.abs(np.sin(off_sight)),
        across_m=across_high - across_low + spacing * np.abs(np.cos(off_sight)),
        yaw_rad=yaw,
        low_m=np.minimum.reduceat(points.z_m, starts),
        high_m=np.maximum.reduceat(points.z_m, starts),
        t_s=np.add.reduceat(points.t_s, starts) / counts,
        spacing_m=spacing,
        hidden_right=_behind_an_edge(points, starts, everything, -1),
        hidden_left=_behind_an_edge(points, first[1:] - 1, everything, 1),
        reflectance=np.add.reduceat(np.nan_to_num(reflectance), starts) / counts,
        actor=_majority(points.actor, first),
        first=first,
        points=points,
    )


def fit_yaw(x_m: Floats, y_m: Floats, first: Integers) -> Floats:
    """(k,) direction in [0, pi / 2) of the rectangle that the points of each group lie on the edges of.

    Search over angles with the closeness criterion: each point votes with the inverse of its distance to the nearest
    edge of the rectangle that just holds the group.

    References
    ----------
    .. [1] X. Zhang et al., "Efficient L-shape fitting for vehicle detection using laser scanners", IEEE IV 2017.
    """
    chosen = np.concatenate(
        [
            np.linspace(start, end - 1, min(end - start, FIT_POINTS)).round().astype(np.int64)
            for start, end in zip(first[:-1].tolist(), first[1:].tolist(), strict=True)
        ]
    )
    counts = np.minimum(np.diff(first), FIT_POINTS)
    starts = np.concatenate([[0], np.cumsum(counts)[:-1]])
    angle = np.arange(0.0, 0.5 * np.pi - 1e-9, FIT_STEP_RAD)
    c, s = np.cos(angle)[:, None], np.sin(angle)[:, None]
    x, y = x_m[chosen][None, :], y_m[chosen][None, :]
    distance = np.minimum(_to_edge(c * x + s * y, starts, counts), _to_edge(c * y - s * x, starts, counts))
    votes = np.add.reduceat(1.0 / np.maximum(distance, FIT_FLOOR_M), starts, axis=1)
    return np.asarray(angle[votes.argmax(axis=0)])


def _to_edge(value: Floats, starts: Integers, counts: Integers) -> Floats:
    """Distance of each value to the nearer end of its group's span, (a, n)."""
    low = np.repeat(np.minimum.reduceat(value, starts, axis=1), counts, axis=1)
    high = np.repeat(np.maximum.reduceat(value, starts, axis=1), counts, axis=1)
    return np.asarray(np.minimum(value - low, high - value))


def _behind_an_edge(points: Points, ends: Integers, everything: Points, side: int) -> NDArray[np.bool_]:
    """Whether the beams next to the end points of groups, to the right (-1) or left (1), met something nearer."""
    azimuth = np.arctan2(everything.y_m, everything.x_m)
    order = np.argsort(azimuth, kind="stable")
    azimuth, distance = azimuth[order], np.hypot(everything.x_m, everything.y_m)[order]
    x, y, step = points.x_m[ends], points.y_m[ends], points.step_rad[ends]
    here, reach = np.arctan2(y, x), np.hypot(x, y) - EDGE_M
    hidden = np.zeros(len(ends), dtype=np.bool_)
    for beams in range(1, EDGE_BEAMS + 1):
        wanted = here + side * beams * step
        near = np.searchsorted(azimuth, wanted - 0.5 * step)
        found = np.minimum(near, len(azimuth) - 1)
        hidden |= (near < len(azimuth)) & (azimuth[found] <= wanted + 0.5 * step) & (distance[found] < reach)
    return hidden


def _majority(actor: Integers, first: Integers) -> Integers:
    """The actor of most points of each group, the lowest number when two are equal, -1 where weather leads."""
    k = len(first) - 1
    group = np.repeat(np.arange(k), np.diff(first))
    votes = np.zeros((k, int(actor.max(initial=-1)) + 2), dtype=np.int64)
    np.add.at(votes, (group, actor + 1), 1)
    return np.asarray(votes.argmax(axis=1) - 1, dtype=np.int64)


def _kept(groups: Groups, keep: NDArray[np.bool_]) -> Groups:
    counts = np.diff(groups.first)
    values = {
        name: getattr(groups, name)[keep]
        for name in (
            *("x_m", "y_m", "along_m", "across_m", "yaw_rad", "low_m", "high_m", "t_s", "spacing_m"),
            *("hidden_right", "hidden_left", "reflectance", "actor"),
        )
    }
    first = np.concatenate([[0], np.cumsum(counts[keep])]).astype(np.int64)
    return Groups(**values, first=first, points=groups.points.take(np.repeat(keep, counts)))
