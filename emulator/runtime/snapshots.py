"""What a running daemon shows to who looks: latest scans with truth, last telegrams, links, the scenario as run.

Methods of the control socket, asked again and again; docs/control.md has them. Nothing is kept, and no instrument is
watched, before somebody asks and `KEEP_S` after the last time. What is kept are references; they are turned into text
in the control's own thread. Not: what is made of it (view), orders that change something (orders).
"""

from __future__ import annotations

import base64
from collections import Counter, deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from emulator.instrument.instrument import Instrument
from emulator.instrument.observer import Observer, Payload
from emulator.objects.metrics import ListedScan
from emulator.process.clock import Clock
from emulator.runtime.control import BAD_PARAMS, Later, Method, OrderError
from emulator.runtime.virtual_daemon import VirtualDaemon
from protocols.scan import Scan
from protocols.session import Dropped

if TYPE_CHECKING:
    from emulator.runtime.daemon import Daemon
    from emulator.scenario.scenario import Scenario

KEEP_S = 10.0
"Since it was asked last: longer than any page that is still open lets pass."
MOST_POINTS = 6000
"Beams times echoes in one answer, of all sensors together: 190 kB of text; the control hangs up at 262 kB."
MOST_BEAMS = 500_000
"Kept of a turn: a VLS-128 at 300 revolutions a minute has 480 000."
MOST_PAYLOADS = 64
"Kept for each sensor."
MOST_EVENTS = 16
MOST_BYTES = 50_000
"Of telegrams in one answer."
LATEST_SENDS = 256
"Of which the lateness is reported."
PIECE = 30_000
"Letters of the scenario in one answer; JSON makes at most six of one."
MOST_OBJECTS = 256
SHORT = {"azimuth_rad": "<f4", "elevation_rad": "<f4", "fire_s": "<f4"}
"Arrays of n, and their type on the wire; base64."
LONG = {"range_m": "<f4", "intensity": "<f4", "actor": "<i2"}
"Arrays of n by k."
ORIGIN = "<f4"
"Of `origin_m`, n by 3: where beams begin; of a sensor whose beams begin in its origin there is none."


@dataclass
class _Seen:
    """Of one sensor."""

    parts: deque[Scan] = field(default_factory=deque)
    "The newest scan; of a sensor that measures in slices those of the last turn, newest last."
    begun: tuple[tuple[int, int], ...] = ()
    "Number and first instant of the newest turns, at most two."
    beams: int = 0
    "Of `parts`."
    scans: int = 0
    "Scans so far."
    payloads: deque[tuple[int, Payload]] = field(default_factory=lambda: deque(maxlen=MOST_PAYLOADS))
    count: int = 0
    "Payloads so far."
    events: deque[tuple[int, str]] = field(default_factory=lambda: deque(maxlen=MOST_EVENTS))

    def take(self, scan: Scan) -> None:
        """The newest scan, or the newest slice: slices stay until the sensor has come round."""
        turn, start_ns, parts = scan.plan.turn, scan.plan.start_ns, self.parts
        self.scans += 1
        if turn is None or (self.begun and turn < self.begun[-1][0]):  # a new life counts anew
            parts.clear()
            self.begun, self.beams = (), 0
        parts.append(scan)
        self.beams += len(scan.plan)
        if turn is None:
            return
        if not self.begun or turn > self.begun[-1][0]:
            self.begun = (*self.begun[-1:], (turn, start_ns))
        (since, since_ns), (until, until_ns) = self.begun[0], self.begun[-1]
        turn_ns = (until_ns - since_ns) // max(1, until - since)
        while len(parts) > 1 and (
            self.beams > MOST_BEAMS or (turn_ns and parts[0].plan.start_ns <= start_ns - turn_ns)
        ):
            self.beams -= len(parts.popleft().plan)


class _Keeper(Observer):
    """Keeps the newest of everything while somebody looks, and leaves by itself."""

    def __init__(self, forgotten: Callable[[], bool]) -> None:
        self.of: dict[str, _Seen] = {}
        self._forgotten = forgotten

    def scan(self, sensor: str, scan: Scan) -> None:
        if not self._forgotten():
            self.of.setdefault(sensor, _Seen()).take(scan)

    def payload(self, payload: Payload) -> None:
        if not self._forgotten():
            seen = self.of.setdefault(payload.sensor, _Seen())
            seen.count += 1
            seen.payloads.append((seen.count, payload))

    def event(self, sensor: str, event: Any) -> None:
        reported = f"{event.reason.value} {event.detail}".rstrip() if isinstance(event, Dropped) else ""
        row = (event.at_ns, f"{type(event).__name__}: {reported}".rstrip(": "))
        self.of.setdefault(sensor, _Seen()).events.append(row)


class Snapshots:
    """The methods that show one run."""

    def __init__(
        self, daemon: Daemon | VirtualDaemon, instruments: Sequence[Instrument], clock: Clock, scenario: Scenario
    ) -> None:
        self._daemon = daemon
        self._instruments = {one.sensor: one for one in instruments}
        self._clock = clock
        self._scenario = scenario
        self._text: str | None = None
        self._keeper: _Keeper | None = None
        self._asked_ns = 0
        self._before = 0
        "Generations of keepers: counts of an earlier one mean nothing to the next."

    def methods(self) -> dict[str, Method]:
        """Name -> method."""
        return {"glance": self.glance, "scans": self.scans, "telegrams": self.telegrams, "scene": self.scene}

    # ------------------------------------------------------------ methods

    def glance(self, params: Mapping[str, Any]) -> object:
        """Time, links, counts, and the lateness of the last sends: `status` for who asks several times per second."""
        self._known(params)
        virtual = self._daemon if isinstance(self._daemon, VirtualDaemon) else None
        return {
            "clock": "real" if virtual is None else "virtual",
            "now_s": self._now_ns() * 1e-9,
            "paused": virtual is not None and virtual.paused,
            "speed": 1.0 if virtual is None else virtual.speed,
            "sensors": {name: _glance(one) for name, one in self._instruments.items()},
        }

    def scans(self, params: Mapping[str, Any]) -> object:
        """The latest scan, or turn of slices, of each sensor, as measured, unless `since` has its number already."""
        chosen = self._chosen(params)
        keeper = self._look()
        since = _table(params, "since")
        found = {}
        for name in chosen:
            seen = keeper.of.get(name)
            if seen is not None and seen.parts and since.get(name, -1) != seen.scans:
                known = since.get(name, -1)
                missed = max(0, seen.scans - known - len(seen.parts)) if 0 < known <= seen.scans else 0
                found[name] = (tuple(seen.parts), seen.scans, missed)
        room = MOST_POINTS // max(1, len(found))
        head = {"now_s": self._now_ns() * 1e-9, "keeper": self._before}
        return Later(lambda: head | {"scans": {name: _scan(*one, room) for name, one in found.items()}})

    def telegrams(self, params: Mapping[str, Any]) -> object:
        """The last payloads of each sensor, both ways, newest last; `since`: number of the last one known."""
        chosen = self._chosen(params, "count")
        count = params.get("count", 16)
        if isinstance(count, bool) or not isinstance(count, int) or not 1 <= count <= MOST_PAYLOADS:
            raise OrderError(BAD_PARAMS, f"count: {count!r}; want 1 to {MOST_PAYLOADS}")
        keeper = self._look()
        since = _table(params, "since")
        rows: dict[str, list[tuple[int, Payload]]] = {}
        totals, events = {}, {}
        for name in chosen:
            seen = keeper.of.get(name, _Seen())
            known = since.get(name, 0)
            fresh = [one for one in seen.payloads if one[0] > known or known > seen.count]
            rows[name], totals[name] = fresh[-count:], seen.count
            events[name] = [{"at_s": at_ns * 1e-9, "event": text} for at_ns, text in seen.events]
        room = MOST_BYTES // max(1, len(chosen))
        head = {"now_s": self._now_ns() * 1e-9, "keeper": self._before, "events": events}
        return Later(lambda: head | {"telegrams": {name: _telegrams(rows[name], totals[name], room) for name in rows}})

    def scene(self, params: Mapping[str, Any]) -> object:
        """The scenario as run, every default filled in, as YAML from letter `at` on; `next`: where it goes on."""
        at = params.get("at", 0)
        if set(params) - {"at"} or isinstance(at, bool) or not isinstance(at, int) or at < 0:
            raise OrderError(BAD_PARAMS, f"{dict(params)}; want at: a whole number from 0")

        def text() -> object:
            if self._text is None:
                from emulator.scenario.scenario import dump

                self._text = dump(self._scenario)
            end = at + PIECE
            return {
                "source": str(self._scenario.source),
                "yaml": self._text[at:end],
                "next": end if end < len(self._text) else None,
            }

        return Later(text)

    # ------------------------------------------------------------ helpers

    def _now_ns(self) -> int:
        return self._daemon.now_ns if isinstance(self._daemon, VirtualDaemon) else self._clock.now_ns()

    def _known(self, params: Mapping[str, Any], *names: str) -> None:
        for name in set(params) - set(names):
            raise OrderError(BAD_PARAMS, f"{name}: {params[name]!r}; want {', '.join(names) or 'nothing'}")

    def _chosen(self, params: Mapping[str, Any], *names: str) -> list[str]:
        self._known(params, "sensor", "since", *names)
        sensor = params.get("sensor")
        if sensor is None:
            return list(self._instruments)
        if not isinstance(sensor, str) or sensor not in self._instruments:
            raise OrderError(BAD_PARAMS, f"sensor: {sensor!r}; want one of {', '.join(self._instruments)}")
        return [sensor]

    def _look(self) -> _Keeper:
        """Begin to watch, or go on."""
        self._asked_ns = self._clock.now_ns()
        if self._keeper is None:
            self._keeper = _Keeper(self._forgotten)
            self._before += 1
            for one in self._instruments.values():
                one.watch(self._keeper)
        return self._keeper

    def _forgotten(self) -> bool:
        """Whether nobody has asked for so long that watching ends; called by the keeper itself."""
        if self._keeper is None or self._clock.now_ns() - self._asked_ns < KEEP_S * 1e9:
            return False
        for one in self._instruments.values():
            one.unwatch(self._keeper)
        self._keeper = None
        return True


def _table(params: Mapping[str, Any], key: str) -> Mapping[str, int]:
    found = params.get(key, {})
    if not isinstance(found, dict) or any(isinstance(one, bool) or not isinstance(one, int) for one in found.values()):
        raise OrderError(BAD_PARAMS, f"{key}: {found!r}; want a table of sensors and numbers")
    return found


def _glance(one: Instrument) -> dict[str, object]:
    stats = one.stats
    late = sorted(stats.lateness.latest_ns(LATEST_SENDS).tolist())
    rate = stats.rate_hz
    return {
        "scans_sent": stats.scans_sent,
        "scans_measured": stats.scans_measured,
        "scans_per_s": None if rate != rate else round(rate, 4),
        "replies_sent": stats.replies_sent,
        "restarts": stats.restarts,
        "dropped": _most(stats.scans_dropped),
        "input_dropped": _most(stats.input_dropped),
        "lateness_us": {"sends": len(late), "median": late[len(late) // 2] * 1e-3, "worst": late[-1] * 1e-3}
        if late
        else None,
        "links": [
            {
                "url": link.url,
                "kind": link.kind.value,
                "host": link.has_host(),
                "bytes_in": link.stats.bytes_in,
                "bytes_out": link.stats.bytes_out,
                "bytes_lost": link.stats.bytes_lost,
            }
            for link in one.links
        ],
    }


def _most(counts: Counter[str]) -> dict[str, int]:
    return dict(counts.most_common(16))


def _bytes(kinds: Mapping[str, str]) -> int:
    return sum(np.dtype(kind).itemsize for kind in kinds.values())


def spacing(points: int, room: int) -> int:
    """Every how many beams one is shown, so that there are no more points than `room`.

    Not a multiple of 2 or 5: those of slices are numbered by laser, and would be of a few lasers alone.
    """
    every = max(1, -(-points // max(1, room)))
    while every > 1 and (every % 2 == 0 or every % 5 == 0):
        every += 1
    return every


def _scan(parts: Sequence[Scan], number: int, missed: int, room: int) -> dict[str, object]:
    """A scan, or slices one after another, as text; of more points than `room` every n-th beam."""
    first, last = parts[0].plan, parts[-1]
    counts = [len(one.plan) for one in parts]
    n, k = sum(counts), max(one.range_m.shape[1] for one in parts)
    begins = first.origin_m is not None
    every = max(1, -(-n * (k + begins) // max(1, room)))
    if last.plan.turn is not None:
        while k > 1 and not any(np.isfinite(one.range_m[:, k - 1 :]).any() for one in parts):
            k -= 1  # a device of four echoes has seldom more than two
        taken = _bytes(SHORT) + k * _bytes(LONG) + 3 * begins * np.dtype(ORIGIN).itemsize
        every = spacing(n * taken, room * (_bytes(SHORT) + _bytes(LONG)))
    found: dict[str, object] = {
        "number": number,
        "missed": missed,
        "sweep": last.plan.sweep,
        "start_s": first.start_ns * 1e-9,
        "beams": n,
        "echoes": k,
        "every": every,
    }
    kept: dict[str, list[Any]] = {name: [] for name in (*SHORT, *LONG, *(["origin_m"] if begins else []))}
    before = 0
    for one, count in zip(parts, counts, strict=True):
        plan, here = one.plan, slice(-before % every, None, every)
        before += count
        arrays: dict[str, Any] = {
            "azimuth_rad": plan.azimuth_rad,
            "elevation_rad": plan.elevation_rad,
            "fire_s": plan.fire_offset_s,
            "range_m": one.range_m,
            "intensity": one.intensity,
            "actor": one.actor,
        }
        for name, values in arrays.items():
            kept[name].append(values[here] if name in SHORT else values[here, :k])
        if begins:
            kept["origin_m"].append((np.zeros((count, 3)) if plan.origin_m is None else plan.origin_m)[here])
        kept["fire_s"][-1] = kept["fire_s"][-1] + 1e-9 * (plan.start_ns - first.start_ns)
        if (width := one.range_m.shape[1]) < k:
            for name in LONG:
                nothing = -1 if name == "actor" else np.nan
                kept[name][-1] = np.pad(kept[name][-1], ((0, 0), (0, k - width)), constant_values=nothing)
    for name, values in kept.items():
        kind = ORIGIN if name == "origin_m" else (SHORT | LONG)[name]
        found[name] = base64.b64encode(np.concatenate(values).astype(kind).tobytes()).decode()
    found["objects"] = [_object(item) for item in last.objects[:MOST_OBJECTS]]
    if isinstance(last, ListedScan):
        found["truth"] = [asdict(item) for item in last.truth[:MOST_OBJECTS]]
    return found


def _object(item: Any) -> dict[str, object]:
    names = ("track", "actor", "category", "position_m", "velocity_m_s", "size_m", "yaw_rad", "existence")
    return {name: getattr(item, name) for name in names}


def _telegrams(rows: Sequence[tuple[int, Payload]], total: int, room: int) -> dict[str, object]:
    reported: list[dict[str, object]] = []
    for number, one in reversed(rows):
        room -= len(one.data)
        if room < 0 and reported:
            break
        reported.append(
            {
                "number": number,
                "link": one.link,
                "peer": one.peer,
                "sent": one.sent,
                "label": one.label,
                "sweep": one.sweep,
                "first_bit_s": one.start_ns * 1e-9,
                "last_bit_s": one.end_ns * 1e-9,
                "bytes": len(one.data),
                "data": one.data[:MOST_BYTES].hex(),
            }
        )
    return {"number": total, "payloads": reported[::-1]}
