"""What a feeder has reported so far: tracks of all its actors, and the account of what was wrong with its samples.

Belongs here: order, duplicates, jumps, removal, reused ids, limits; the tracks that a sweep needs; how old its poses
are. Not: formats, sockets, the feeder's clock (playout). Nothing here reads a clock.
"""

from __future__ import annotations

import heapq
import math
from bisect import bisect_right
from collections import Counter, deque
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import chain

import numpy as np

from emulator.live.ages import Ages
from emulator.live.rotations import Floats, Quaternion, Vector
from emulator.live.samples import ActorSample, BadSample, Update, checked
from emulator.live.tracks import BLEND_S, WIDTH, Between, Sampled, World

MOST_KEPT = 10_000
"Samples of one actor; the oldest go, first those that no sweep can want."
NONE = (math.nan, math.nan, math.nan)
LONGEST_S = 10.0
"Nothing is asked for that lies so long before the newest sample."
KEEP_S = 2.0
"Samples so long past are not asked for any more."
JUMP_FACTOR, JUMP_M_S = 3.0, 10.0
"Faster than so many times the stated speed and this beside it is a jump."
FASTEST_M_S = 150.0
"Of an actor whose feeder states no velocities; faster is a jump."
LOOKED_AT = 512
"Updates among which the newest one used is looked for: the age of a pose."
MOST_LIVES = 8
"Lives of one id that are kept."
EGO_NAMES = ("ego", "hero")
"Of the host vehicle where the feeder has not said which one it is."
JUMP_RAD_S = 2.0 * math.pi
MOST_EVENTS = 1000
MOST_TOLD = 20
"Of one sort are reported; more are counted, so that a flood of one hides no other."
JUMP, RETURNS = 13, 14
"Columns of what is kept of a sample: its place, orientation, velocity, rate of turn, these; NaN where none was given."


@dataclass(frozen=True)
class Rules:
    """How samples become poses."""

    between: Between = "interpolate"
    silent_after_s: float = 0.5
    silent_then: str = "hold"
    "hold, stop, remove"
    jump_m_s: float = JUMP_M_S
    host: str | None = None
    "Id or entity name of the feeder's own vehicle, where the feeder has not said which one it is."
    guess_host: bool = False
    "Of a feed that may never say it: by its entity's name, else the smallest id."
    keep_all: bool = False
    "Nothing is forgotten: of a file."


@dataclass(eq=False)
class _Known:
    """One actor as it grows."""

    first: ActorSample
    t_s: list[float] = field(default_factory=list)
    rows: list[tuple[float, ...]] = field(default_factory=list)
    "As a `World` has it, without the instant."
    gone_s: float = np.inf
    forgot: bool = False
    "Its first samples are not kept any more."
    returned_s: float = -np.inf
    "When its feed last came back."
    shape: str = ""
    "As a pool of shapes calls it; empty: the scenario's own."


class Book:
    """The account of one feed."""

    def __init__(
        self,
        rules: Rules | None = None,
        names: Iterable[str] = (),
        bind: Mapping[str, str] | None = None,
        slots: Sequence[str] = (),
        static_slots: Sequence[str] = (),
        shape_of: Callable[[ActorSample], str] = lambda one: "box",
    ) -> None:
        """`names`: actors of the scenario. `bind`: what the feeder calls some of them -> their names.

        `slots`: names that actors get which are not in the scenario; they come with the shape that `shape_of` says.
        """
        self.rules = Rules() if rules is None else rules
        self._names = frozenset(names)
        self._bind = dict(bind or {})
        self._free = list(slots)
        heapq.heapify(self._free)
        self._free_static = list(static_slots)
        heapq.heapify(self._free_static)
        self._static_slots = frozenset(static_slots)
        self._slots = frozenset(slots) | self._static_slots
        self._slot_of: dict[str, str] = {}
        "What the feeder calls an actor that is not in the scenario -> its slot."
        self._shape_of = shape_of
        self._known: dict[str, list[_Known]] = {}
        "Lives of each actor: one that comes again has another."
        self.host: str | None = None
        "As the feeder calls its own vehicle."
        self.counts: Counter[str] = Counter()
        self.events: deque[tuple[float, str]] = deque(maxlen=MOST_EVENTS)
        "Instant and text, once each."
        self._reported: set[str] = set()
        self._told: Counter[str] = Counter()
        self.newest_s = -np.inf
        "Instant of the newest sample."
        self._times: deque[float] = deque(maxlen=LOOKED_AT)
        self._seq: int | None = None
        self.ages = Ages()
        self._asked_s = -np.inf
        self._fresh: set[str] = set()
        "Actors whose next sample is of another time than their last."
        self.on_event: Callable[[float, str], None] = lambda t_s, text: None

    # ------------------------------------------------------------ what comes

    def take(self, update: Update, run_ns: int, again: bool = False) -> bool:
        """One update that holds at `run_ns`; whether it is used. Never raises: what is wrong is counted and reported.

        `again`: what is informed of an actor for the second time at one instant replaces the first.
        """
        t_s = run_ns * 1e-9
        self.counts["received"] += 1
        try:
            checked(update)
        except BadSample as error:
            self.refuse(str(error), t_s)
            return False
        for key in update.unknown:
            self._tell(t_s, f"key {key!r} is not known and not used", sort="keys")
        if not self._in_order(update, t_s):
            return False
        if update.host is not None:
            self.host = update.host
        for one in update.actors:
            self.host = one.id if one.host else self.host
        if self.host is None and "host" in self._bind and update.actors:
            self._find_host(update.actors, t_s)
        present = set()
        for one in update.actors:
            name = self.name_of(one)
            if name is None:
                continue
            present.add(name)
            self._add(name, one, t_s, again)
        gone = [self._slot_of.get(one, self._bind.get(one, one)) for one in update.removed]
        if update.snapshot:
            gone += [name for name in self._known if name not in present and name not in self._static_slots]
        if any(one.static for one in update.actors):
            gone += [name for name in self._known if name not in present and name in self._static_slots]
        for name in gone:
            self._remove(name, t_s)
        self.newest_s = t_s
        if not self._times or self._times[-1] < t_s:
            self._times.append(t_s)
        return True

    def refuse(self, why: str, t_s: float) -> None:
        """An update that cannot be used."""
        self.counts["dropped"] += 1
        self._tell(t_s, f"an update is not used: {why}", why.partition(":")[0], "updates")

    def _in_order(self, update: Update, t_s: float) -> bool:
        if update.seq is not None:
            if self._seq is not None and update.seq > self._seq + 1:
                self.counts["lost"] += update.seq - self._seq - 1
            self._seq = update.seq if self._seq is None else max(self._seq, update.seq)
        if t_s < self.newest_s:
            self.counts["out of order"] += 1
            return False
        return True

    def _find_host(self, actors: Sequence[ActorSample], t_s: float) -> None:
        """The feeder's own vehicle where it has not been reported: esmini says it in its first message only."""
        wanted = () if self.rules.host is None else (self.rules.host, self.rules.host.removeprefix("entity:"))
        actors = [one for one in actors if not one.static]
        found = next((one for one in actors if one.id in wanted or one.name in wanted), None)
        found = found or next((one for one in actors if (one.name or "").lower() in EGO_NAMES), None)
        if found is None and self.rules.guess_host:
            known = {*self._bind, *self._names}
            free = [one for one in actors if not {one.id, one.name, f"entity:{one.name}"} & known]
            found = min(free, key=lambda one: (len(one.id), one.id), default=None)
            if found is not None:
                ego = self._bind["host"]
                self._tell(
                    t_s, f"no host_vehicle_id: {found.id!r}, the smallest id, is {ego!r}; want live.host", "host"
                )
        if found is not None:
            self.host = found.id

    def name_of(self, one: ActorSample) -> str | None:
        """Which actor of ours a sample is of; None: it is not wanted."""
        for word in (one.id, *(() if one.name is None else (f"entity:{one.name}", one.name))):
            if word in self._bind:
                return self._bind[word]
        if self.host is not None and one.id == self.host and "host" in self._bind:
            return self._bind["host"]
        for word in (one.id, one.name):
            if word is not None and word in self._names:
                return word
        if one.id in self._slot_of:
            return self._slot_of[one.id]
        if one.static:
            return self._static_slot(one)
        if not self._slots - self._static_slots:
            self.counts["not wanted"] += 1
            text = f"actor {one.id!r} is not in the scenario; want live.actors.spawn to let it come"
            self._tell(0.0, text, one.id, "actors")
            return None
        if not self._free:
            self.counts["too many actors"] += 1
            room = len(self._slots - self._static_slots)
            self._tell(0.0, f"more than {room} actors beside the scenario's: the others are not there", "many")
            return None
        self._slot_of[one.id] = heapq.heappop(self._free)
        return self._slot_of[one.id]

    def _static_slot(self, one: ActorSample) -> str | None:
        if not self._free_static:
            self.counts["static ones left out"] += 1
            some = len(self._static_slots)
            self._tell(0.0, f"more than {some} static ones; want live.actors.statics so large as all of them", "static")
            return None
        self._slot_of[one.id] = heapq.heappop(self._free_static)
        return self._slot_of[one.id]

    def _add(self, name: str, one: ActorSample, t_s: float, again: bool) -> None:
        lives = self._known.get(name)
        known = lives[-1] if lives else None
        if known is not None and known.gone_s > t_s and _other(known.first, one):
            slot = self._slot_of.get(one.id)
            self._remove(name, t_s)
            if slot is not None:
                self._slot_of[one.id] = heapq.heappop(self._free_static if one.static else self._free)
                name = self._slot_of[one.id]
                lives = self._known.get(name)
                known = lives[-1] if lives else None
        if known is None or known.gone_s <= t_s:
            known = _Known(one)
            if name in self._slots:
                known.shape = self._shape_of(one)
            self._known.setdefault(name, []).append(known)
            if not self.rules.keep_all:
                self._known[name] = self._known[name][-MOST_LIVES:]
            if not one.static:
                self._note(t_s, f"{_called(name, one)} comes")
        if known.t_s and t_s <= known.t_s[-1]:
            if not again or t_s < known.t_s[-1]:
                self.counts["duplicate"] += 1
                return
            del known.t_s[-1], known.rows[-1]
        jump, returns, turned = one.jump, False, _unit(one.quaternion)
        if known.t_s:
            step = t_s - known.t_s[-1]
            returns = not jump and step > self.rules.silent_after_s
            jump = jump or name in self._fresh or self._is_jump(known, one, turned, step)
            returns = returns and not jump
            if not jump:
                self._judge(known, one, turned, t_s)
            self.counts["jumps"] += jump
            if returns:
                self._tell(t_s, f"{name}: poses come again after {step:.3g} s", f"returns {name} {t_s}", "returns")
        self._fresh.discard(name)
        known.t_s.append(t_s)
        known.rows.append((*one.at_m, *turned, *(one.velocity_m_s or NONE), *(one.spin_rad_s or NONE), jump, returns))
        if returns:
            known.returned_s = t_s
        if not self.rules.keep_all and len(known.t_s) > 64:
            old = bisect_right(known.t_s, max(self._asked_s, t_s - LONGEST_S) - KEEP_S) - 2
            excess = max(old if old > 32 else 0, len(known.t_s) - MOST_KEPT)
            if excess > 0:
                del known.t_s[:excess], known.rows[:excess]
                known.forgot = True

    def _is_jump(self, known: _Known, one: ActorSample, turned: Quaternion, step: float) -> bool:
        x, y, z, w, i, j, k, *velocity = known.rows[-1][:10]
        if one.velocity_m_s is None or velocity[0] != velocity[0]:
            limit = self._usual(known)
        else:
            limit = JUMP_FACTOR * max(math.hypot(*velocity), math.hypot(*one.velocity_m_s)) + self.rules.jump_m_s
        to = one.at_m
        if math.hypot(to[0] - x, to[1] - y, to[2] - z) > limit * step:
            return True
        dot = abs(w * turned[0] + i * turned[1] + j * turned[2] + k * turned[3])
        if dot >= 1.0 or step > 0.5:  # no turn at all, or time for a whole one
            return False
        rate = 0.0 if one.spin_rad_s is None else math.hypot(*one.spin_rad_s)
        return 2.0 * math.acos(dot) > max(JUMP_RAD_S, 2.0 * rate) * step

    def _usual(self, known: _Known) -> float:
        """Speed that is no jump of an actor whose feeder states none: by its last step, jump or not. [m/s]"""
        if len(known.t_s) < 2:
            return FASTEST_M_S
        one, other = known.rows[-2:]
        way = math.hypot(other[0] - one[0], other[1] - one[1], other[2] - one[2])
        speed = way / (known.t_s[-1] - known.t_s[-2])
        return min(JUMP_FACTOR * speed + self.rules.jump_m_s, FASTEST_M_S)

    def _judge(self, known: _Known, one: ActorSample, turned: Quaternion, t_s: float) -> None:
        """How wrong beams were that were asked for beyond the newest sample, now that the truth has come."""
        if known.t_s[-1] >= self._asked_s:
            return
        ahead = self._ahead(known, t_s)
        if ahead is not None:
            x, y, z = one.at_m
            w, i, j, k = known.rows[-1][3:7]
            dot = abs(w * turned[0] + i * turned[1] + j * turned[2] + k * turned[3])
            off = math.hypot(ahead[0] - x, ahead[1] - y, ahead[2] - z)
            self.ages.truth_came(off, 2.0 * math.acos(min(1.0, dot)))
            return
        when = np.array([t_s])
        at, turned_to = self._of([("", known)], known.t_s[-1], np.inf, []).tracks[0][1].pose(when)
        off = float(np.sqrt(((at[0] - np.array(one.at_m)) ** 2).sum()))
        dot = abs(float(turned_to[0] @ np.array(turned)))
        self.ages.truth_came(off, 2.0 * float(np.arccos(min(1.0, dot))))

    def _ahead(self, known: _Known, t_s: float) -> Vector | None:
        """Where one is at constant velocity beyond its newest sample; None: there is more to it, see `Track.pose`.

        This is asked of each actor of each update in a run that is short of time.
        """
        last, since = known.rows[-1], t_s - known.t_s[-1]
        if len(known.rows) < 2 or self.rules.between == "hold" or last[RETURNS] or since > self.rules.silent_after_s:
            return None
        before, spin = known.rows[-2], last[10:13]
        if spin != (0.0, 0.0, 0.0) and (spin[0] == spin[0] or last[JUMP] or last[3:7] != before[3:7]):
            return None
        velocity = last[7:10]
        if velocity[0] != velocity[0]:
            if last[JUMP]:
                return None
            step = known.t_s[-1] - known.t_s[-2]
            velocity = ((last[0] - before[0]) / step, (last[1] - before[1]) / step, (last[2] - before[2]) / step)
        if known.returned_s > known.t_s[-1] - BLEND_S:
            return None
        return (last[0] + since * velocity[0], last[1] + since * velocity[1], last[2] + since * velocity[2])

    def _remove(self, name: str, t_s: float) -> None:
        lives = self._known.get(name)
        if not lives or lives[-1].gone_s <= t_s:
            return
        lives[-1].gone_s = t_s
        if not lives[-1].first.static:
            self._note(t_s, f"{_called(name, lives[-1].first)} goes")
        if lives[-1].first.id in self._slot_of:
            free = self._free_static if name in self._static_slots else self._free
            heapq.heappush(free, self._slot_of.pop(lives[-1].first.id))

    def restart(self, now_s: float, why: str) -> None:
        """The feeder's clock began again, or jumped: what is known holds until the next sample, which is a jump."""
        self.counts[why] += 1
        self._tell(now_s, f"the feeder's clock: {why}", f"{why} {now_s}", why)
        for name, lives in self._known.items():
            known = lives[-1]
            keep = max(1, bisect_right(known.t_s, now_s))
            del known.t_s[keep:], known.rows[keep:]
            if name in self._names:
                self._fresh.add(name)
            else:
                self._remove(name, max(now_s, known.t_s[-1]))
        self.newest_s = min(self.newest_s, now_s)
        self._times.clear()
        self._seq = None
        if why == "restart":
            self.host = None  # ids are other ones

    def _tell(self, t_s: float, text: str, key: str | None = None, sort: str = "") -> None:
        """Once; of one sort, the first ones."""
        key = text if key is None else key
        if key in self._reported or len(self._reported) >= MOST_EVENTS:
            return
        if sort:
            self._told[sort] += 1
            if self._told[sort] > MOST_TOLD:
                return
            text += "; others are counted" if self._told[sort] == MOST_TOLD else ""
        self._reported.add(key)
        self._note(t_s, text)

    def _note(self, t_s: float, text: str) -> None:
        self.events.append((t_s, text))
        self.on_event(t_s, text)

    # ------------------------------------------------------------ what is asked

    def _vanish_s(self, known: _Known) -> float:
        """So long after its newest sample it is not there."""
        ends = self.rules.silent_then == "remove" and not known.first.static
        return self.rules.silent_after_s if ends else np.inf

    def _of(self, lives: Iterable[tuple[str, _Known]], begin_s: float, end_s: float, gone: Iterable[str]) -> World:
        """What is needed of these from `begin_s` to `end_s`."""
        times: list[float] = []
        rows: list[tuple[float, ...]] = []
        rest, rules = [], self.rules
        for name, known in lives:
            when, one = known.t_s, known.first
            from_s = begin_s - BLEND_S if known.returned_s > begin_s - BLEND_S else begin_s
            first = max(0, bisect_right(when, from_s) - 2)
            until = min(len(when), bisect_right(when, end_s) + 1)
            times += when[first:until]
            rows += known.rows[first:until]
            words = (
                not known.forgot and first == 0,
                known.gone_s,
                rules.between,
                rules.silent_after_s,
                self._vanish_s(known) if until == len(when) else np.inf,
                one.reference,
                one.rear_m,
                one.size_m,
                known.shape,
                one.class_ or "",
            )
            rest.append((name, until - first, *words))
        samples = np.zeros((len(rows), WIDTH))
        if rows:
            kept = np.fromiter(chain.from_iterable(rows), np.float64, len(rows) * (WIDTH - 1))
            samples[:, 0], samples[:, 1:] = times, kept.reshape(len(rows), -1)
        return Sampled(samples, rest, frozenset(gone))

    def world(self, begin_s: float, end_s: float, only: str | None = None) -> World:
        """Everything that beams from `begin_s` to `end_s` need; or of one actor alone."""
        found: list[tuple[str, _Known]] = []
        gone = []
        wanted = self._known if only is None else {only: self._known[only]} if only in self._known else {}
        for name, lives in wanted.items():
            before = len(found)
            for known in lives:
                ends_s = min(known.gone_s, known.t_s[-1] + self._vanish_s(known))
                if begin_s < ends_s and (end_s >= known.t_s[0] or known.forgot):
                    found.append((name, known))
            if len(found) == before and lives[0].t_s[0] <= begin_s:
                gone.append(name)
        return self._of(found, begin_s, end_s, gone)

    def asked(self, beams_s: Floats, delay_s: float = 0.0) -> None:
        """A sweep with beams at these instants uses what is known by now."""
        if not len(beams_s) or not self._times:
            return
        self._asked_s = max(self._asked_s, float(beams_s.max()))
        known = np.asarray(self._times)
        used = np.minimum(np.searchsorted(known, beams_s, side="left"), len(known) - 1)
        self.ages.note(beams_s - (known[used] - delay_s), beams_s > known[-1])

    @property
    def silent_s(self) -> float:
        """How long the newest sample has held, at the newest beam that was asked for. [s]"""
        return max(0.0, self._asked_s - self.newest_s)

    def actors(self) -> list[str]:
        """Names of the actors that are there."""
        return [name for name, lives in self._known.items() if lives[-1].gone_s == np.inf]

    def first_of(self, name: str) -> ActorSample:
        """How an actor was described when it came."""
        return self._known[name][-1].first


def _other(one: ActorSample, now: ActorSample) -> bool:
    """Whether the same id is something else now."""
    sizes = one.size_m is not None and now.size_m is not None
    resized = sizes and max(abs(a - b) for a, b in zip(one.size_m or (), now.size_m or (), strict=True)) > 0.01
    return resized or (now.class_ is not None and one.class_ is not None and now.class_ != one.class_)


def _called(name: str, one: ActorSample) -> str:
    """An actor as the feeder and the scenario call it."""
    return name if name == one.id else f"{one.id} ({name})"


def _unit(quaternion: Quaternion) -> Quaternion:
    w, x, y, z = quaternion
    norm = math.sqrt(w * w + x * x + y * y + z * z)
    return (w / norm, x / norm, y / norm, z / norm) if norm > 0.0 else (1.0, 0.0, 0.0, 0.0)
