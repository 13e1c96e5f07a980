"""Which beams of a sweep look at one plane and nothing else.

Belongs here: edges of the scene against the cones of beams. Not: the edges themselves (outlines), and what such beams
bring back (closed).

A beam is plain when no edge comes into its cone of k beam radii before or at the plane that its axis meets: then that
surface covers the whole cone, and what lies behind is hidden. Only surfaces that pass through each other escape this
test; where pieces of meshes are near enough for that, rays at k radii must meet the same plane.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from emulator.physics.arrays import Bools, Floats, Ints, clamped, indexes, ramp
from emulator.sensing.model import SensorModel
from emulator.world.batched_poses import BatchedPoses
from emulator.world.broad_phase import BroadPhase
from emulator.world.fed import Fed
from emulator.world.motion import Pose
from emulator.world.outlines import Outlines

CLEARLY_BEHIND_M = 1e-3
"An edge nearer to the plane than this may be the plane's own."
MOST_EDGES = 1_000_000
"Beyond it a test of edges costs more than it saves."
HIDDEN = 6
"So many times as many pairs may be thought of, if most turn out to lie behind what the beams meet."
MOST_PAIRS = 2_000_000
"Pairs of an edge and a beam; beyond it every beam keeps its bundle."


@dataclass(frozen=True, eq=False)
class Sights:
    """The beams' axes in the world."""

    centre_m: Floats
    "(n, 3)"
    axis: Floats
    "(n, 3)"
    rotation: Floats
    "(3, 3) of the sensor in the middle of the sweep."
    t_s: Floats


@dataclass(frozen=True, eq=False)
class Crossings:
    """Edges inside of beams' cones: from where to where, seen from the beam's origin."""

    beam: Ints
    enter_m: Floats
    "(k, 3)"
    leave_m: Floats
    slack_m: Floats
    "(k,) how far off they may be."

    def joined(self, other: Crossings) -> Crossings:
        """Both."""
        return Crossings(
            np.concatenate([self.beam, other.beam]),
            np.concatenate([self.enter_m, other.enter_m]),
            np.concatenate([self.leave_m, other.leave_m]),
            np.concatenate([self.slack_m, other.slack_m]),
        )

    def uncovered(self, beams: int, range_m: Floats, normal: Floats, axis: Floats) -> Bools:
        """(n,) beams with an edge that is not clearly behind the plane that their axis meets; NaN: it meets none."""
        b = self.beam
        met = np.isfinite(range_m[b])
        n = normal[b]
        level = np.where(met, range_m[b], 0.0) * np.einsum("ij,ij->i", n, axis[b])
        far = np.maximum(np.einsum("ij,ij->i", n, self.enter_m), np.einsum("ij,ij->i", n, self.leave_m))
        open_ = ~met | (far - level > -(CLEARLY_BEHIND_M + self.slack_m))
        found = np.zeros(beams, bool)
        found[b[open_]] = True
        return found


@dataclass(frozen=True, eq=False)
class _Edges:
    """Edges in the world in the middle of a sweep."""

    start_m: Floats
    end_m: Floats
    velocity: Floats
    "(e, 3)"
    slack_m: Floats
    "(e,)"


@dataclass(frozen=True, eq=False)
class _Near:
    """Moving bodies that can come within reach during a second."""

    movers: Ints
    "(b,) indexes into all that move."
    batched: BatchedPoses
    rows: Ints
    "(e,) their edges."
    owner: Ints
    "(e,) index of each edge's body in `movers`."
    fed: Ints
    "Which of `movers` somebody else moves."


class Edges:
    """The edges of a scene for one sensor; those that never move are found once for a sensor at rest."""

    def __init__(self, outlines: Outlines, model: SensorModel, radii: float) -> None:
        self.outlines = outlines
        self._spread = radii * math.tan(max(model.beam.half_angle_x_rad, model.beam.half_angle_y_rad))
        self._pupil_m = radii * model.beam.exit_radius_m
        bodies = outlines.bodies
        moving = np.array([not body.motion.still for body in bodies], bool)
        self._movers = indexes(moving)
        self._radius = np.array([bodies[k].radius_m for k in self._movers])
        self._centre = np.array([bodies[k].centre_m for k in self._movers]).reshape(-1, 3)
        self._arm = np.linalg.norm(self._centre, axis=1) + self._radius
        rows = np.arange(len(outlines))
        own = moving[outlines.body] if len(rows) else np.zeros(0, bool)
        self._own_start, self._own_end = outlines.start_m[own], outlines.end_m[own]
        number = np.full(len(bodies) + 1, -1, np.int64)
        number[self._movers] = np.arange(len(self._movers))
        self._owner = number[outlines.body[own]]
        self._broad_phase = BroadPhase([bodies[k].motion for k in self._movers], self._arm)
        self._near: _Near | None = None
        start, end = outlines.start_m[~own].copy(), outlines.end_m[~own].copy()
        still = outlines.body[~own]
        for index in np.unique(still):
            pose, here = bodies[index].motion.pose(np.zeros(1)), still == index
            start[here] = start[here] @ pose.rotation[0].T + pose.position_m[0]
            end[here] = end[here] @ pose.rotation[0].T + pose.position_m[0]
        nothing = np.zeros((len(start), 3))
        self._still = _Edges(start, end, nothing, np.zeros(len(start)))
        self._known: tuple[bytes, Crossings | None] | None = None

    @property
    def too_many(self) -> bool:
        return len(self.outlines) > MOST_EDGES

    def crossings(
        self, sights: Sights, reach_m: float, at_rest: bool, most_pairs: int, cover_m: Floats
    ) -> Crossings | None:
        """Edges inside of the beams' cones; None where more than so many pairs would have to be looked at.

        Edges of what moves may be left out where they are farther than `cover_m` (n,): hidden.
        """
        still = self._of_still(sights, reach_m, at_rest, most_pairs, cover_m)
        if still is None or not len(self._movers):
            return still
        found = self._cross(self._of_movers(sights, reach_m), sights, reach_m, most_pairs, cover_m)
        return None if found is None else still.joined(found)

    def _of_still(
        self, sights: Sights, reach_m: float, at_rest: bool, most_pairs: int, cover_m: Floats
    ) -> Crossings | None:
        if not at_rest:
            return self._cross(self._still, sights, reach_m, most_pairs, cover_m)
        key = sights.axis.tobytes() + np.float64(reach_m).tobytes()
        if self._known is None or self._known[0] != key:
            self._known = key, self._cross(self._still, sights, reach_m, MOST_PAIRS)
        return self._known[1]

    def _of_movers(self, sights: Sights, reach_m: float) -> _Edges:
        """Edges of the moving bodies that come within reach."""
        begin, end = float(sights.t_s.min()), float(sights.t_s.max())
        middle = 0.5 * (begin + end)
        known = self._near_movers(sights, reach_m, begin, end)
        movers, batched = known.movers, known.batched
        now = batched.during(begin, end)
        at = (now.at + (middle - now.since) * now.velocity).T
        velocity, turned = now.velocity.T.copy(), now.turned.transpose(2, 0, 1).copy()
        slack = np.zeros(len(at))
        curved = indexes(~now.straight)
        fed = np.intersect1d(known.fed, curved)
        if len(fed):
            self._as_fed(known, fed, sights, reach_m, at, velocity, turned, slack)
            curved = np.setdiff1d(curved, fed)
        for k in curved:
            pose = batched.motions[k].pose(np.append(sights.t_s, middle))
            at[k], velocity[k], turned[k] = pose.position_m[-1], 0.0, pose.rotation[-1]
            moved = float(np.linalg.norm(pose.position_m - at[k], axis=1).max())
            bent = float(np.linalg.norm(pose.rotation - turned[k], axis=(1, 2)).max())
            slack[k] = moved + bent * self._arm[movers[k]]
        eye = sights.centre_m[len(sights.centre_m) // 2]
        swept = np.linalg.norm(velocity, axis=1) * (end - begin) + slack
        place = at + np.einsum("bij,bj->bi", turned, self._centre[movers])
        near = np.linalg.norm(place - eye, axis=1) - self._radius[movers] - swept <= reach_m
        chosen = near[known.owner]
        rows, owner = known.rows[chosen], known.owner[chosen]
        start = np.einsum("eij,ej->ei", turned[owner], self._own_start[rows]) + at[owner]
        stop = np.einsum("eij,ej->ei", turned[owner], self._own_end[rows]) + at[owner]
        return _Edges(start, stop, velocity[owner], slack[owner])

    def _as_fed(
        self, known: _Near, fed: Ints, sights: Sights, reach_m: float,
        at: Floats, velocity: Floats, turned: Floats, slack: Floats,
    ) -> None:  # fmt: skip
        """Fed bodies as if they moved straight, and how far off that is."""
        motions = [motion for number in fed if isinstance(motion := known.batched.motions[number], Fed)]
        found = motions[0].now.placings(sights.t_s)
        if found is None:
            slack[fed] = np.inf
            return
        placings = found[0]
        place, radius = placings.around(motions)
        arm = self._arm[known.movers[fed]]
        eye = sights.centre_m[len(sights.centre_m) // 2]
        near = np.linalg.norm(place.T - eye, axis=1) - radius - arm <= reach_m
        at[fed] = place.T
        slack[fed[~near]] = radius[~near]  # out of reach all the same
        fed, arm = fed[near], arm[near]
        if not len(fed):
            return
        rows = placings.rows([motion for motion, chosen in zip(motions, near, strict=True) if chosen])
        path, turn = placings.at[:, rows], placings.turned[:, :, rows]
        since = placings.t_s - 0.5 * (float(sights.t_s.min()) + float(sights.t_s.max()))
        span = since[-1] - since[0]
        drift = (path[:, :, -1] - path[:, :, 0]) / (span if span > 0.0 else 1.0)
        middle = path[:, :, 0] - drift * since[0]
        off = path - middle[:, :, None] - drift[:, :, None] * since
        other = turn - turn[:, :, :, len(since) // 2, None]
        bent = np.sqrt(np.einsum("ijbn,ijbn->bn", other, other).max(axis=1))
        at[fed], velocity[fed] = middle.T, drift.T
        turned[fed] = turn[:, :, :, len(since) // 2].transpose(2, 0, 1)
        slack[fed] = np.sqrt(np.einsum("ibn,ibn->bn", off, off).max(axis=1)) + bent * arm

    def _near_movers(self, sights: Sights, reach_m: float, begin_s: float, end_s: float) -> _Near:
        low, high = sights.centre_m.min(axis=0), sights.centre_m.max(axis=0)
        which = self._broad_phase.within(low, high, reach_m, begin_s, end_s)
        if self._near is None or self._near.movers is not which:
            number = np.full(len(self._movers), -1, np.int64)
            number[which] = np.arange(len(which))
            rows = indexes(number[self._owner] >= 0)
            batched = BatchedPoses([self.outlines.bodies[self._movers[k]].motion for k in which])
            fed = indexes(np.array([isinstance(motion, Fed) for motion in batched.motions], bool))
            self._near = _Near(which, batched, rows, number[self._owner[rows]], fed)
        return self._near

    def _cross(
        self, edges: _Edges, sights: Sights, reach_m: float, most_pairs: int, cover_m: Floats | None = None
    ) -> Crossings | None:
        """Crossings of these edges: first those near the scan, then each with the beams that it may meet."""
        n = len(sights.axis)
        middle = 0.5 * (float(sights.t_s.min()) + float(sights.t_s.max()))
        eye = sights.centre_m[n // 2]
        wander = float(np.linalg.norm(sights.centre_m - eye, axis=1).max())
        duration = float(np.ptp(sights.t_s))
        start, end = edges.start_m - eye, edges.end_m - eye
        blur = edges.slack_m + np.sqrt(np.einsum("ij,ij->i", edges.velocity, edges.velocity)) * duration + wander
        low, high, nearest, kept = self._azimuths(start @ sights.rotation, end @ sights.rotation, blur, sights, reach_m)
        direction = sights.axis @ sights.rotation
        azimuth = np.arctan2(direction[:, 1], direction[:, 0])
        order = np.argsort(azimuth, kind="stable")
        turns = np.concatenate([azimuth[order] + turn for turn in (-2.0 * np.pi, 0.0, 2.0 * np.pi)])
        first, last = turns.searchsorted(low), turns.searchsorted(high, side="right")
        count = np.minimum(last - first, n)
        if int(count.sum()) > (MOST_PAIRS if cover_m is None else HIDDEN * most_pairs):
            return None
        row = kept.repeat(count)
        beam = order[(first.repeat(count) + ramp(count)) % n]
        if cover_m is not None:
            seen = indexes(nearest.repeat(count) <= cover_m[beam])
            row, beam = row[seen], beam[seen]
        if len(row) > most_pairs:
            return None
        late = (sights.t_s[beam] - middle)[:, None] * edges.velocity[row] - (sights.centre_m[beam] - eye)
        return self._inside(start[row] + late, end[row] + late, edges.slack_m[row], beam, sights.axis)

    def _azimuths(
        self, start: Floats, end: Floats, blur: Floats, sights: Sights, reach_m: float
    ) -> tuple[Floats, Floats, Floats, Ints]:
        """Azimuths in the sensor's frame between which each edge may meet a beam, its least distance, its number."""
        direction = sights.axis @ sights.rotation
        elevation = np.arcsin(clamped(direction[:, 2], -1.0, 1.0))
        half = math.atan(self._spread) + 1e-6
        upper, lower = float(elevation.max()) + half, float(elevation.min()) - half
        margin = blur + self._pupil_m + 1e-6
        limit = 1.5
        rise = math.tan(min(max(upper, 0.0), limit)) if upper < limit else np.inf
        fall = math.tan(min(max(-lower, 0.0), limit)) if lower > -limit else np.inf
        kept = np.arange(len(start))
        if math.isfinite(rise) and math.isfinite(fall):
            far0, far1 = np.hypot(start[:, 0], start[:, 1]), np.hypot(end[:, 0], end[:, 1])
            over = margin * (1.0 + rise)
            above = (start[:, 2] > rise * far0 + over) & (end[:, 2] > rise * far1 + over)
            under = margin * (1.0 + fall)
            below = (start[:, 2] < -fall * far0 - under) & (end[:, 2] < -fall * far1 - under)
            kept = indexes(~above & ~below)
        start, end, margin = start[kept], end[kept], margin[kept]
        along = end - start
        nearest = _distance(start, along)
        within = nearest - margin <= reach_m * math.hypot(1.0, self._spread)
        kept, start, along, margin = kept[within], start[within], along[within], margin[within]
        level = _distance(start[:, :2], along[:, :2])
        first = np.arctan2(start[:, 1], start[:, 0])
        turn = np.arctan2(
            start[:, 0] * along[:, 1] - start[:, 1] * along[:, 0],
            start[:, 0] * (start[:, 0] + along[:, 0]) + start[:, 1] * (start[:, 1] + along[:, 1]),
        )
        steep = math.cos(min(max(abs(upper), abs(lower)), 0.5 * np.pi))
        wide = math.asin(min(1.0, math.sin(half) / max(steep, 1e-12)))
        around = (level <= margin * 1.001) | (wide > 1.5)
        room = wide + np.arcsin(np.minimum(margin / np.maximum(level, 1e-12), 1.0)) + 1e-9
        low = np.where(around, -np.pi, first + np.minimum(turn, 0.0) - room)
        high = np.where(around, np.pi, first + np.maximum(turn, 0.0) + room)
        return low, high, nearest[within] - margin, kept

    def _inside(self, start: Floats, end: Floats, slack: Floats, beam: Ints, axis: Floats) -> Crossings:
        """The part of each edge that lies in its beam's cone: where |across|^2 <= (pupil + spread x along)^2."""
        f, along = axis[beam], end - start
        a_f, b_f = np.einsum("ij,ij->i", start, f), np.einsum("ij,ij->i", along, f)
        foot, side = start - a_f[:, None] * f, along - b_f[:, None] * f
        width, grow = self._pupil_m + slack + self._spread * a_f, self._spread * b_f
        a = np.einsum("ij,ij->i", side, side) - grow * grow
        b = np.einsum("ij,ij->i", foot, side) - width * grow
        c = np.einsum("ij,ij->i", foot, foot) - width * width
        safe = np.where(b_f == 0.0, 1.0, b_f)
        # from a little behind the pupil on, so that nothing that touches it is missed
        zero = (-1e-6 - slack - a_f) / safe
        low = np.where(b_f > 0.0, np.maximum(zero, 0.0), 0.0)
        high = np.where(b_f < 0.0, np.minimum(zero, 1.0), 1.0)
        ahead = (low <= high) & ((b_f != 0.0) | (a_f >= -1e-6 - slack))
        inner = b * b - a * c
        across = a > 0.0
        root = np.sqrt(np.maximum(inner, 0.0))
        divisor = np.where(across, a, 1.0)
        low_in = np.where(across, np.maximum(low, (-b - root) / divisor), low)
        high_in = np.where(across, np.minimum(high, (-b + root) / divisor), high)
        ends = np.minimum((a * low + 2.0 * b) * low + c, (a * high + 2.0 * b) * high + c)
        touched = indexes(ahead & np.where(across, (inner >= 0.0) & (low_in <= high_in), ends <= 0.0))
        begin, way = start[touched], along[touched]
        return Crossings(
            beam[touched],
            begin + low_in[touched, None] * way,
            begin + high_in[touched, None] * way,
            slack[touched],
        )


def _distance(start: Floats, along: Floats) -> Floats:
    """Least distance of segments from the origin."""
    square = np.einsum("ij,ij->i", along, along)
    part = clamped(-np.einsum("ij,ij->i", start, along) / np.where(square > 0.0, square, 1.0), 0.0, 1.0)
    place = start + part[:, None] * along
    return np.asarray(np.sqrt(np.einsum("ij,ij->i", place, place)))


class Pieces:
    """Boxes of the connected pieces of a scene: only where two are near can surfaces pass through each other."""

    def __init__(self, outlines: Outlines) -> None:
        self._outlines = outlines
        self._middle = 0.5 * (outlines.low_m + outlines.high_m)
        self._half = 0.5 * (outlines.high_m - outlines.low_m)
        self._still = np.array([body.motion.still for body in outlines.bodies], bool)[outlines.piece_body]
        self._centre, self._extent = np.zeros_like(self._middle), np.zeros_like(self._middle)
        self._slack = np.zeros(len(self._middle))
        moving = indexes(~self._still)
        self._moving = np.unique(outlines.piece_body[moving])
        order = np.argsort(outlines.piece_body[moving], kind="stable")
        self._pieces = moving[order]
        self._first = outlines.piece_body[self._pieces].searchsorted(np.append(self._moving, len(outlines.bodies)))
        bodies = [outlines.bodies[k] for k in self._moving]
        arm = np.array([float(np.linalg.norm(body.centre_m)) + body.radius_m for body in bodies], np.float64)
        self._broad_phase = BroadPhase([body.motion for body in bodies], arm)
        self._place(indexes(self._still), np.zeros(1))

    def _place(self, pieces: Ints, t_s: Floats) -> None:
        owner = self._outlines.piece_body[pieces]
        for index in np.unique(owner):
            mine = pieces[owner == index]
            pose = self._outlines.bodies[index].motion.pose(t_s)
            k = len(t_s) // 2
            rotation, position = pose.rotation[k], pose.position_m[k]
            self._centre[mine] = self._middle[mine] @ rotation.T + position
            self._extent[mine] = self._half[mine] @ np.abs(rotation).T
            arm = np.linalg.norm(np.abs(self._middle[mine]) + self._half[mine], axis=1)
            moved = float(np.linalg.norm(pose.position_m - position, axis=1).max())
            bent = float(np.linalg.norm(pose.rotation - rotation, axis=(1, 2)).max())
            self._slack[mine] = moved + bent * arm

    def doubtful(self, body: Ints, face: Ints, point_m: Floats, reach_m: Floats, t_s: Floats) -> Bools:
        """(h,) hits within `reach_m` of another piece's box than the one they are on."""
        doubt = np.zeros(len(body), bool)
        if not len(body) or (len(self._middle) < 2 and not bool(self._outlines.piece_crosses.any())):
            return doubt
        own = self._outlines.piece_of(body, face)
        low = (point_m - reach_m[:, None]).min(axis=0)
        high = (point_m + reach_m[:, None]).max(axis=0)
        if len(self._moving):
            near = self._near_movers(low, high, t_s)
            self._place(near, t_s)
            pieces = np.concatenate([indexes(self._still), near])
        else:
            pieces = np.arange(len(self._middle))
        room = self._extent[pieces] + self._slack[pieces][:, None]
        overlap = ((self._centre[pieces] - room <= high) & (self._centre[pieces] + room >= low)).all(axis=1)
        for piece in pieces[overlap]:
            extent = self._extent[piece] + self._slack[piece] + 1e-6
            inside = (np.abs(point_m - self._centre[piece]) <= extent + reach_m[:, None]).all(axis=1)
            doubt |= inside & ((own != piece) | self._outlines.piece_crosses[piece])
        return doubt

    def _near_movers(self, low: Floats, high: Floats, t_s: Floats) -> Ints:
        kept = []
        for k in self._broad_phase.within(low, high, 0.0, float(t_s.min()), float(t_s.max())):
            body = self._outlines.bodies[self._moving[k]]
            pose = body.motion.pose(t_s[:1])
            place = pose.to_world(body.centre_m)[0]
            room = body.radius_m + body.motion.speed_bound_m_s * float(np.ptp(t_s))
            if bool(((place - room <= high) & (place + room >= low)).all()):
                kept.append(self._pieces[self._first[k] : self._first[k + 1]])
        return np.concatenate([np.zeros(0, np.int64), *kept])


def sights_of(pose: Pose, axis: Floats, t_s: Floats) -> Sights:
    """Axes in the world of beams with these poses of their sensor."""
    return Sights(pose.position_m, axis, pose.rotation[len(t_s) // 2], t_s)
