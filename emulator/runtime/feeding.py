"""A feed in a run: what comes is put on the run's time and kept, and each sweep gets the poses that it needs.

Belongs here: the feed of a scenario, when a sweep is measured, what of the feed is reported. Not: formats and tracks
(live), lock-step (lockstep), who measures (measuring).

In real time a sweep is asked for when all poses that its beams want are known, or when it must be begun to be sent in
time, whichever is first; of one that is measured in slices the same holds for each of them. In virtual time it is asked
for at its end: all that was reported by then is known.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Future
from pathlib import Path

import numpy as np

from emulator.errors import LinkError
from emulator.instrument.instrument import Instrument
from emulator.live.files import Reported, read
from emulator.live.playout import PlayoutClock
from emulator.live.receivers import (
    Decoder,
    JsonDatagrams,
    OsiDatagrams,
    OsiMessages,
    Receiver,
    line_in,
    message_in,
)
from emulator.live.samples import Update
from emulator.live.tracks import NOTHING, World
from emulator.process.clock import utc_ns
from emulator.runtime.slicing import Slicing
from emulator.scenario.live_options import LiveOptions
from emulator.scenario.scenario import Scenario
from emulator.world.feed_record import book_of
from protocols.scan import ScanPlan

MOST_ASKED = 64
BEFORE_S, LISTS_S = 0.005, 1.0
"So long before a sweep poses are handed over; before a list of objects, which looks at sweeps of other sensors."
MOST_PENDING = 2000
"Updates that the run has not got round to."
KINDS = ("osi-trace", "osi-mcap", "json-file", "recording")


class Feeding:
    """The feed of one run."""

    def __init__(
        self,
        scenario: Scenario,
        live: LiveOptions,
        instruments: Sequence[Instrument],
        real_ns: Callable[[], int] | None,
    ) -> None:
        """`real_ns`: the run's clock; None: it is virtual. `EmulatorError` where a file cannot be read."""
        self.live = live
        self._real_ns = real_ns
        self._instruments = {one.sensor: one for one in instruments}
        self.book = book_of(scenario)
        delay_ns = None if live.clock.delay_s is None else round(live.clock.delay_s * 1e9)
        self._clock = PlayoutClock(delay_ns, round(live.latency_s * 1e9), round(live.clock.max_offset_s * 1e9))
        self._maps = live.clock.map
        self.call: Callable[[Callable[[], object]], Future[object]] | None = None
        "Has something done between two steps of the run."
        self._pending = 0
        self._receiver: Receiver | None = None
        self._waiting: dict[str, int] = {}
        "Sensors whose sweep waits for poses -> its last beam."
        self._asked_ns: dict[str, dict[int, tuple[int, int]]] = {}
        "By sensor: the beginnings of sweeps, when each or its last slice was asked for, and how many slices it has."
        self._due_ns: dict[str, tuple[tuple[int, int], int]] = {}
        "By sensor: the beginning of the sweep that it wants next, which slice, and when that is to be asked for."
        self._slicing: defaultdict[str, Slicing] = defaultdict(Slicing)
        self._chosen: dict[str, tuple[int, int]] = {}
        "By sensor: the beginning of the sweep that was looked at last, and in how many slices it is measured."
        self.has_slices: Callable[[str, ScanPlan], bool] = lambda sensor, plan: False
        "Whether whoever measures can do so in slices."
        self.on_update: Callable[[int, dict[str, object]], None] | None = None
        "Informed of everything that is used of the feed: for a recording."
        self._file: Iterator[Reported] | None = None
        self._next: Reported | None = None
        place = live.place
        if place.is_file:
            self._file = read(place.kind, Path(scenario.folder / place.path))
            self._next = next(self._file, None)

    # ------------------------------------------------------------ what comes

    def open(self) -> str | None:
        """Begin to receive; where, for whoever feeds. `LinkError` where the address cannot be had."""
        place = self.live.place
        if place.kind not in ("json-udp", "json-tcp", "osi-udp", "osi-tcp"):
            return None
        counts = self.book.counts
        decoders: dict[str, Decoder] = {"osi-udp": OsiDatagrams(counts), "osi-tcp": OsiMessages()}
        decoder = decoders.get(place.kind, JsonDatagrams())
        tcp = {"json-tcp": line_in, "osi-tcp": message_in}.get(place.kind)
        host = "127.0.0.1" if place.host == "localhost" else place.host
        now_ns = self._real_ns or (lambda: 0)
        try:
            self._receiver = Receiver(
                host, place.port, tcp, decoder, now_ns, self._from_outside, self._refused, counts,
                None if self._real_ns is None else utc_ns,
            )  # fmt: skip
        except OSError as error:
            raise LinkError(f"{self.live.feed}: {error.strerror or error}; want a free address") from None
        self._receiver.start()
        reported = f"[{host}]" if ":" in host else host
        return f"{place.kind}://{reported}:{self._receiver.port}"

    def close(self) -> None:
        """Receive no more."""
        if self._receiver is not None:
            self._receiver.close()
            self._receiver = None

    def _from_outside(self, update: Update, arrival_ns: int) -> None:
        """Of the receiver's thread."""
        if self.call is None or self._pending >= MOST_PENDING:
            self.book.counts["overrun"] += 1
            return
        self._pending += 1

        def take() -> None:
            self._pending -= 1
            self.take(update, arrival_ns if self._real_ns is not None else self._virtual_ns())

        self.call(take)

    def _refused(self, why: str, arrival_ns: int) -> None:
        if self.call is not None:
            self.call(lambda: self.book.refuse(why, arrival_ns * 1e-9))

    def _virtual_ns(self) -> int:
        return max((one.ledger.now_ns for one in self._instruments.values()), default=0)

    def take(self, update: Update, now_ns: int, again: bool = False) -> bool:
        """One update; whether it is used."""
        run_ns = self.run_ns(update, now_ns)
        used = self.book.take(update, run_ns, again)
        if used:
            if self.on_update is not None:
                self.on_update(now_ns, report_row(now_ns, run_ns, update, again))
            self._wake(run_ns)
        return used

    def run_ns(self, update: Update, now_ns: int) -> int:
        """The run's instant at which an update holds."""
        if self._real_ns is None or self.live.place.is_file:
            return now_ns if update.t_ns is None else update.t_ns
        if update.t_ns is None or self._maps == "arrival":
            return now_ns + round(self.live.latency_s * 1e9)
        mapped = self._clock.map(update.t_ns, now_ns)
        if mapped.event:
            self.book.restart(now_ns * 1e-9, mapped.event)
        return mapped.run_ns

    def _wake(self, newest_ns: int) -> None:
        for sensor, last_ns in list(self._waiting.items()):
            if last_ns <= newest_ns:
                del self._waiting[sensor]
                self._instruments[sensor].poked = True

    # ------------------------------------------------------------ what is asked

    def ask_ns(self, sensor: str, plan: ScanPlan, earliest_ns: int) -> int:
        """When that sweep is to be measured, or its first slice."""
        if self._real_ns is None:
            return plan.start_ns + round(plan.duration_s * 1e9)
        if self._file is not None:
            return earliest_ns
        return max(earliest_ns, self.slice_ns(sensor, plan, 0, self.slices(sensor, plan)))

    def slices(self, sensor: str, plan: ScanPlan) -> int:
        """In how many slices that sweep is measured; 1: whole."""
        if self._real_ns is None or self._file is not None or not len(plan):
            return 1
        start_ns, of = self._chosen.get(sensor, (-1, 1))
        if start_ns != plan.start_ns:
            of = self._slicing[sensor].choose(plan, self.has_slices(sensor, plan))
            self._chosen[sensor] = plan.start_ns, of
        return of

    def slice_ns(self, sensor: str, plan: ScanPlan, number: int, of: int) -> int:
        """When that slice is to be measured; long ago: all poses that its beams want are known."""
        assert self._real_ns is not None
        slicing, end_ns = self._slicing[sensor], plan.start_ns + round(plan.duration_s * 1e9)
        last_ns = end_ns if not len(plan) else _last_ns(plan) if of == 1 else slicing.last_ns(plan, number)
        due_ns = end_ns - slicing.before_end_ns(number, of)
        if self.book.newest_s * 1e9 >= last_ns:
            self._waiting.pop(sensor, None)
            if number == 0:
                return 0
            # behind the slice before it, of which it is taken that it is as long as others
            asked_ns, _ = self._asked_ns.get(sensor, {}).get(plan.start_ns, (0, of))
            due_ns = min(due_ns, asked_ns + round(slicing.lead.mean_ns))
        else:
            self._waiting[sensor] = last_ns
        if due_ns > self._real_ns():
            self._due_ns[sensor] = (plan.start_ns, number), due_ns
        return due_ns

    def knows(self, plan: ScanPlan) -> bool:
        """Whether all poses that its beams want are known: nothing newer comes for them."""
        if self._real_ns is None or not len(plan):
            return False
        return self._file is not None or self.book.newest_s * 1e9 >= _last_ns(plan)

    def came(self, sensor: str, plan: ScanPlan, now_ns: int) -> None:
        """Its scan has come."""
        asked_ns, of = self._asked_ns.get(sensor, {}).pop(plan.start_ns, (None, 1))
        if asked_ns is not None and self._real_ns is not None:
            took = float(now_ns - asked_ns)
            self.book.ages.took.add_one(took * 1e-9)
            self._slicing[sensor].add(took, of)

    def world(self, sensor: str, plan: ScanPlan, now_ns: int, number: int = 0, of: int = 1) -> World:
        """What its beams need, or those of one of `of` slices, as it is known now."""
        begin_s = plan.start_ns * 1e-9
        end_s = begin_s + plan.duration_s
        if self._file is not None:
            self._pull(now_ns if self._real_ns is None else plan.start_ns + round(plan.duration_s * 1e9))
        if self._real_ns is not None:
            asked = self._asked_ns.setdefault(sensor, {})
            which, due_ns = self._due_ns.pop(sensor, ((-1, 0), now_ns))
            # what the sender comes late to ask for it is part of what measuring takes
            asked[plan.start_ns] = min(now_ns, due_ns) if which == (plan.start_ns, number) else now_ns, of
            if len(asked) > MOST_ASKED:
                del asked[min(asked)]
        self._waiting.pop(sensor, None)
        if len(plan):
            beams_s = begin_s + plan.fire_offset_s
            if of > 1:
                beams_s = beams_s[self._slicing[sensor].beams(plan, number)]
            delay_s = 0.0 if self._real_ns is None else self._clock.delay_ns * 1e-9
            self.book.asked(beams_s, delay_s)
            if self._real_ns is not None and np.isfinite(self.book.newest_s):
                now_s = now_ns * 1e-9
                self.book.ages.begun(now_s - (self.book.newest_s - delay_s), beams_s - now_s)
        return self.book.world(begin_s - (BEFORE_S if len(plan) else LISTS_S), end_s + BEFORE_S)

    def world_around(self, actor: str, at_ns: int, before_s: float = BEFORE_S) -> World:
        """What is known of one actor around an instant, which is now; from `before_s` before it on."""
        if self._real_ns is None and at_ns <= 0:
            # at the start nothing is reported yet, whether a feeder came before or after the first frame
            return NOTHING
        if self._file is not None:
            self._pull(at_ns)
        return self.book.world(at_ns * 1e-9 - before_s, at_ns * 1e-9 + BEFORE_S, actor)

    def _pull(self, until_ns: int) -> None:
        """Take what a file reports that was known before that instant."""
        while self._next is not None and self._next.known_ns < until_ns:
            reported = self._next
            assert self._file is not None
            self._next = next(self._file, None)
            used = self.book.take(reported.update, reported.run_ns, reported.again)
            if used and self.on_update is not None:
                self.on_update(
                    max(0, reported.known_ns),
                    report_row(reported.known_ns, reported.run_ns, reported.update, reported.again),
                )

    # ------------------------------------------------------------ what is reported

    def look(self, now_ns: int) -> str:
        """Why the run is to end: its feed is silent; empty: it goes on."""
        silence = self.live.silent
        if silence.then != "stop" or not np.isfinite(self.book.newest_s):
            return ""
        silent_s = now_ns * 1e-9 - self.book.newest_s
        return f"no poses for {silent_s:.3g} s" if silent_s > silence.after_s else ""

    def report(self) -> dict[str, object]:
        """Counts, ages, errors of extrapolation, the feeder's clock."""
        reported: dict[str, object] = {"feed": self.live.feed, **_counts(self.book.counts), **self.book.ages.report()}
        reported["actors"] = len(self.book.actors())
        if self._real_ns is not None:
            reported["in_slices"] = self._in_slices
        if self._real_ns is not None and self._maps == "offset":
            reported |= {
                "offset_ms": round(self._clock.offset_ns * 1e-6, 3),
                "delay_ms": round(self._clock.delay_ns * 1e-6, 3),
                "drift_ppm": round(self._clock.drift_ppm, 1),
            }
        reported["last_event"] = self.book.events[-1][1] if self.book.events else None
        return reported

    @property
    def _in_slices(self) -> int:
        return sum(one.in_slices for one in self._slicing.values())

    def lines(self) -> list[str]:
        """The same for people."""
        report, ages = self.report(), self.book.ages
        wrong = ", ".join(f"{count} {name}" for name, count in _counts(self.book.counts).items() if name != "received")
        found = [f"feed: {self.book.counts['received']} updates received; {wrong or 'nothing wrong'}"]
        if isinstance(age := report["age_ms"], Mapping):
            share = 100.0 * ages.extrapolated / max(1, ages.beams)
            found.append(
                f"feed: age of poses at the beams: median {age['median']:.1f} ms, p99 {age['p99']:.1f} ms, worst"
                f" {age['worst']:.1f} ms; {share:.1f} % of {ages.beams} beams extrapolated"
            )
        if ages.took.count:
            newest, ahead, took = (1e3 * one.share(0.5) for one in (ages.newest, ages.ahead, ages.took))
            found.append(
                f"feed: the newest sample is {newest:.1f} ms old when a sweep is begun, {ahead:.1f} ms before the beam"
                f" (medians); measuring takes {took:.1f} ms, p99 {1e3 * ages.took.share(0.99):.1f} ms; play-out delay"
                f" {1e-6 * self._clock.delay_ns:.1f} ms"
                + (f"; {self._in_slices} of {ages.took.count} sweeps in slices of time" if self._in_slices else "")
            )
        if isinstance(off := report["error_mm"], Mapping) and isinstance(turn := report["error_mrad"], Mapping):
            found.append(
                f"feed: extrapolation wrong by {off['median']:.2f} mm at the median, {off['worst']:.2f} mm at worst;"
                f" {turn['worst']:.2f} mrad at worst"
            )
        return found


def _last_ns(plan: ScanPlan) -> int:
    """When the last of its beams fires."""
    return plan.start_ns + round(1e9 * float(plan.fire_offset_s.max()))


def report_row(now_ns: int, run_ns: int, update: Update, again: bool) -> dict[str, object]:
    """An update as a recording has it."""
    from emulator.live.json_lines import as_json

    row: dict[str, object] = {"known_ns": now_ns, "run_ns": run_ns, "update": as_json(update)}
    return row | ({"again": True} if again else {})


def _counts(counts: Counter[str]) -> dict[str, int]:
    return {name: count for name, count in sorted(counts.items()) if count}
