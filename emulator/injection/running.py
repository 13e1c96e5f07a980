"""One fault of a run: when it begins and ends, what it has hit and taken away.

Belongs here: triggers, durations, counters. Not: what a fault does (the layers), all faults of a sensor or run (run).
"""

from __future__ import annotations

from collections import Counter
from typing import Protocol

from emulator.config.expressions import parse
from emulator.faults.acts import Act, Gear
from emulator.faults.events import MOST_HITS_REPORTED, FaultEvent
from emulator.faults.reading import Fault
from emulator.injection.late import LateTelegrams
from emulator.instrument.instrument import Instrument
from emulator.measuring.conditions import ActiveFault, Setting
from emulator.transports.link import Received
from protocols.session import CommandHandled, Emission


class Run(Protocol):
    """All faults of a run."""

    seed: int

    def install(self, fault: ActiveFault) -> None:
        """From now on plans go with it."""

    def close_measured(self, number: int, now_ns: int) -> None:
        """It holds until now at most."""


class Owner(Protocol):
    """The faults of one sensor."""

    settling: bool
    scan_labels: set[str]
    late: LateTelegrams

    @property
    def run(self) -> Run:
        """The run that they belong to."""

    @property
    def instrument(self) -> Instrument:
        """The sensor."""

    def tell(self, event: FaultEvent) -> None:
        """Something has happened."""

    def add(self, one: Running) -> None:
        """One more."""

    def forget(self, one: Running) -> None:
        """A fault that is over goes out of the list; its counts stay."""


class Running:
    """One fault of a run and its account."""

    def __init__(self, number: int, fault: Fault, of: Owner, seed: int, at_ns: int) -> None:
        instrument = of.instrument
        self.number, self.fault, self.of = number, fault, of
        self.state = "waiting"
        "waiting | active | over"
        self.from_ns = at_ns
        "Nothing begins before."
        self.seen = 0
        "Telegrams that it counts, since `from_ns`."
        self.hits = 0
        self.begun = 0
        self.taken: Counter[str] = Counter()
        self.until_ns: int | None = None
        self._left: int | None = None
        "Telegrams until its end."
        self._one_hit = False
        self._wanted_ns: list[int] = []
        "Instants at which an expression lets it begin."
        self._unwanted_ns: int | None = None
        self._true = False
        common, kind = fault.common, fault.kind
        self.sends_or_hears = "hear" if "from_host" in (common.direction, *kind.directions[:1]) else "send"
        indices = range(len(instrument.links)) if common.link is None else [common.link]
        if kind.links:
            indices = [index for index in indices if instrument.links[index].kind in kind.links]
        self.indices = tuple(index for index in indices if index < len(instrument.links))
        self.partial = len(self.indices) < len(instrument.links)
        gear = Gear(instrument, self.indices, seed, number, kind.name, self)
        gear.direction = "from_host" if self.sends_or_hears == "hear" else "to_host"
        self._gear = gear
        self._of_telegrams = common.of or kind.of
        self.act: Act | None = None if kind.act is None else kind.act(fault.keys, gear)
        does = Act if self.act is None else type(self.act)
        self.releases = does.release is not Act.release
        self._wakes = does.next_ns is not Act.next_ns
        self._by_time = fault.moment is None or (kind.measured and fault.moment == "probability")
        sees = self.sends_or_hears == "send" and does.seen is not Act.seen
        self._looks_on = sees or fault.moment in ("at_telegram", "every", "probability")
        "Wants to see telegrams while it waits."
        self.tree = None if common.when is None else parse(common.when)
        if fault.moment is None and kind.measured:
            self._install(self.from_ns, self._end_of(self.from_ns))

    @property
    def can_act(self) -> bool:
        """Whether it can still do something."""
        return self.state != "over" or (self.act is not None and (self.act.busy or self.act.next_ns() is not None))

    @property
    def _rests(self) -> bool:
        """Whether it waits for its trigger alone."""
        return self.state == "waiting" and not self._wakes and not self._wanted_ns and self._unwanted_ns is None

    @property
    def passes(self) -> bool:
        """Whether telegrams are nothing to it just now."""
        if self.state == "active" or (self.state == "waiting" and self._looks_on):
            return False
        return self.act is None or not self.act.busy

    # accounts

    def hit(self, now_ns: int, detail: str = "") -> None:
        """It has hit one thing more."""
        self.hits += 1
        if self.hits <= MOST_HITS_REPORTED:
            self.of.tell(FaultEvent(now_ns, self.number, self.fault.kind.name, "hit", detail))

    def took(self, what: str, count: int = 1) -> None:
        """So much of `what` went no further because of it."""
        self.taken[what] += count

    def row(self) -> dict[str, object]:
        """For whoever asks."""
        return {
            "number": self.number,
            "on": self.fault.sensor,
            "do": self.fault.kind.name,
            "state": self.state,
            "begun": self.begun,
            "hits": self.hits,
            "taken": dict(self.taken),
            "until_s": None if self.until_ns is None else self.until_ns * 1e-9,
        }

    # beginning and end

    def _end_of(self, now_ns: int) -> int | None:
        common, kind = self.fault.common, self.fault.kind
        span_s = common.for_s
        if kind.lasts == "own" and kind.own_s is not None:
            span_s = kind.own_s(self.fault.keys)
        return None if span_s is None else now_ns + round(span_s * 1e9)

    def begin(self, now_ns: int) -> None:
        """It begins now."""
        common, kind = self.fault.common, self.fault.kind
        if self.state == "active" and self.act is not None and kind.lasts != "telegrams":
            return  # it holds already
        self.begun += 1
        self.state = "active"
        self.until_ns = self._end_of(now_ns)
        self._left = common.for_telegrams
        self._one_hit = kind.lasts == "telegrams" and self.until_ns is None and self._left is None
        if self.begun == 1 or self._reported_singly():
            self.of.tell(FaultEvent(now_ns, self.number, kind.name, "begin"))
        if kind.measured and self.fault.moment is not None and common.probability is None:
            self._install(now_ns, self.until_ns)
        if self.act is not None:
            self.act.begin(now_ns)

    def end(self, now_ns: int, for_good: bool = False) -> None:
        """It ends now; for good when it is cleared or used up."""
        was = self.state
        if was == "active":
            if self.act is not None:
                self.act.end(now_ns)
            if self.fault.kind.measured:
                self.of.run.close_measured(self.number, now_ns)
        if self.state != "over":
            self.state = "over" if for_good or not self._again() else "waiting"
        self.of.settling = self.of.settling or self.state == "over"
        if was != "over" and self.begun and (self.state == "over" or (was == "active" and self._reported_singly())):
            self.of.tell(FaultEvent(now_ns, self.number, self.fault.kind.name, "end", f"{self.hits} hits"))
        if self.state == "over" and self.fault.kind.measured:
            self.of.run.close_measured(self.number, now_ns)
        self.until_ns = self._left = None

    def _reported_singly(self) -> bool:
        """Whether each beginning and end is reported: not of one that hits a telegram now and then; its hits are."""
        return not self._one_hit and self.begun <= MOST_HITS_REPORTED

    def _again(self) -> bool:
        """Whether it can begin once more."""
        if self._used_up() or self.fault.moment in (None, "at_telegram"):
            return False
        return True

    def _used_up(self) -> bool:
        count = self.fault.common.count
        done = self.hits if self.fault.kind.lasts == "telegrams" else self.begun
        return count is not None and done >= count

    def _install(self, from_ns: int, until_ns: int | None) -> None:
        settings: list[tuple[str, Setting]] = [
            (name, value) for name, value in self.fault.keys.model_dump().items() if value is not None
        ]
        chance = self.fault.common.probability
        self.of.run.install(
            ActiveFault(
                self.fault.sensor,
                self.fault.kind.name,
                self.number,
                from_ns,
                until_ns,
                tuple(settings),
                1.0 if chance is None else chance,
                self.of.run.seed,
            )
        )

    def advance(self, now_ns: int) -> None:
        """Begin and end what is due."""
        if self._rests and (not self._by_time or self.from_ns > now_ns):
            return
        if self.state == "active" and self.until_ns is not None and self.until_ns <= now_ns:
            self.end(self.until_ns if self.act is None else now_ns)
        if self._unwanted_ns is not None and self._unwanted_ns <= now_ns:
            self._unwanted_ns = None
            if self.state == "active":
                self.end(now_ns)
        if self.state != "waiting":
            self._wanted_ns = [at_ns for at_ns in self._wanted_ns if at_ns > now_ns]
            return
        if self._by_time and self.from_ns <= now_ns:
            if self.fault.moment == "probability":
                self._install(self.from_ns, self._end_of(self.from_ns))
            self.begin(now_ns)
        elif self._wanted_ns and self._wanted_ns[0] <= now_ns:
            self._wanted_ns.pop(0)
            self.begin(now_ns)

    def next_ns(self) -> int | None:
        """When `advance` or `release` has something to do."""
        if self._rests:
            return self.from_ns if self._by_time else None
        times = [] if self.act is None else [self.act.next_ns()]
        if self.state == "active":
            times.append(self.until_ns)
        elif self.state == "waiting":
            times += [self.from_ns] if self._by_time else self._wanted_ns[:1]
        times.append(self._unwanted_ns)
        return min((time for time in times if time is not None), default=None)

    # what it sees

    def _counts(self, emission: Emission) -> bool:
        if not emission.payload:
            return False
        if self._of_telegrams != "all":
            # on CAN the first frame of a scan alone has its sweep: the others are known by their label
            of_scan = emission.sweep is not None or emission.label in self.of.scan_labels
            if of_scan is not (self._of_telegrams == "scans"):
                return False
        return self.fault.common.label is None or emission.label == self.fault.common.label

    def notice(self, now_ns: int) -> None:
        """One more of what it counts."""
        common = self.fault.common
        if self.state == "over" or now_ns < self.from_ns or self.fault.moment is None:
            return
        self.seen += 1
        if self.state != "waiting":
            return
        if common.at_telegram is not None:
            begins = self.seen == common.at_telegram
        elif common.every is not None:
            begins = self.seen % common.every == 0
        elif common.probability is not None and not self.fault.kind.measured:
            begins = self._gear.happens(common.probability)
        else:
            begins = False
        if begins:
            self.begin(now_ns)

    def sends(self, emission: Emission, now_ns: int, first: bool) -> list[Emission]:
        """What leaves instead of that telegram."""
        if self.act is None or self.sends_or_hears == "hear":
            if self.act is not None and self.state == "active":
                out = self.act.send(emission, now_ns)
                return [emission] if out is None else out
            if first and self._counts(emission):
                self.notice(now_ns)
            return [emission]
        if not self._counts(emission):
            return [emission]
        if first:
            self.notice(now_ns)
        if self.state != "active" and not self.act.busy:
            self.act.seen(emission)
            return [emission]
        held = self.state == "active"
        out = self.act.send(emission, now_ns)
        if held:
            self._passed(now_ns)
        return [emission] if out is None else out

    def hears(self, received: Received, index: int, now_ns: int) -> list[Received]:
        """What the device gets instead of that."""
        if self.state == "over" or self.act is None:
            return [received]
        if received.data and self.sends_or_hears == "hear":
            self.notice(now_ns)
        if self.state != "active":
            return [received]
        out = self.act.hear(received, index, now_ns)
        if received.data and self.sends_or_hears == "hear":
            self._passed(now_ns)
        return [received] if out is None else out

    def _passed(self, now_ns: int) -> None:
        """A telegram has passed while it held."""
        if self._left is not None:
            self._left -= 1
        if self.fault.kind.lasts == "telegrams" and self._used_up():
            self.end(now_ns, for_good=True)
        elif self._left == 0 or (self._one_hit and self._occasion_over()):
            self.end(now_ns)

    def _occasion_over(self) -> bool:
        """Of a fault that hits single telegrams and has no duration."""
        if self.fault.common.count is not None and self.fault.moment in (None, "at_telegram"):
            return self._used_up()
        return self.hits >= self.begun

    def commanded(self, event: CommandHandled) -> None:
        """A host's command has been taken."""
        wanted = self.fault.common.on_command
        if wanted is None or self.state != "waiting" or event.at_ns < self.from_ns:
            return
        said, asked = " ".join(event.command.lower().split()), " ".join(wanted.lower().split())
        if f" {asked} " in f" {said} ":
            self.begin(event.at_ns)

    def judged(self, value: bool, at_ns: int) -> None:
        """Its expression over a scan that has ended, or will have by then."""
        if at_ns < self.from_ns:
            return
        if value and not self._true:
            self._wanted_ns.append(at_ns)
            self.of.instrument.poked = True
        common = self.fault.common
        lasting = common.for_s or common.for_telegrams
        if not value and self._true and lasting is None and self.fault.kind.lasts == "state":
            self._unwanted_ns = at_ns
            self.of.instrument.poked = True
        self._true = value
