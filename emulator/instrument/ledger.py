"""The account of one sensor's scans, each slot by its number: asked for, sent, dropped, withdrawn, under way.

    asked = sent + dropped, by reason + withdrawn + under way        what is missing is `unaccounted` and must be 0

A slot is a scan that hosts are entitled to: a turn of a mirror (as many as a scan takes) while its values are streamed,
a revolution of a subscribed profile, a cycle of an object list, an answer that was asked for. Slots are known by the
numbers of the sweeps that a session wants measured: within one stream (`ScanPlan.stream`) a number that is passed over
is a slot too, and the session must say why (`Dropped`). A scan that goes to several hosts, distinguished by their
addresses, is a slot for each of them. What passes by the clock while a sweep is not measured counts as too late.

Belongs here: the numbers and their sums. Not: who measures and sends (`instrument`), how sums are shown.
"""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Protocol

from protocols.scan import ScanPlan
from protocols.session import Dropped, DropReason, Emission

if TYPE_CHECKING:
    from emulator.process.incidents import Incidents

SENT = "sent"
WITHDRAWN = DropReason.STALE.value
LATE = DropReason.LATE.value
HELD_REASONS = (DropReason.STALE.value, DropReason.LINE_BUSY.value, DropReason.HOST_SLOW.value)
"Of drops without numbers: they take what was measured; others what was passed over."

STREAMS_KEPT = 16
"A device has one stream, and perhaps a scan that was asked for; older ones are kept for what of them still leaves."
SETTLED_KEPT = 64
"Slots whose end is remembered: a scan may go to another host, or be measured again after all."
MOST_OPEN = 256
"Slots of one stream that may be under way; of more, the oldest have been lost."
GIVEN_UP_NS = 10_000_000_000
"What was measured for a stream that has ended, and has not left for so long, is withdrawn."


@dataclass
class _Slot:
    """One that has been asked for and has not ended."""

    key: tuple[int, int]
    "Epoch and sweep of the newest plan for it."
    end_ns: int
    "When its sweep is over."
    measuring: bool = True


@dataclass
class _Settled:
    """Slots that have ended alike."""

    numbers: range
    outcome: str
    of_host: bool
    "For one of several hosts; others may still get the scan."
    provisional: bool = False
    "Until the session reports why: it may have nobody to tell any more."


@dataclass
class _Stream:
    """Numbers from `first` on, up to `front`: open, passed over, or settled."""

    name: object
    "Its number, or the epoch of its plans where the session gives no numbers."
    stride: int
    first: int
    front: int
    ended: bool = False
    "What is asked for from now on under that name is another stream."
    open: dict[int, _Slot] = field(default_factory=dict)
    passed: list[tuple[range, int]] = field(default_factory=list)
    """Numbers that were passed over and not reported; the number behind them, with which it is to
    be reported."""
    settled: deque[_Settled] = field(default_factory=lambda: deque(maxlen=SETTLED_KEPT))
    ahead: int = 0
    "Slots reported without a number before their number was passed over."
    assumed: int = 0
    "Slots found to be late by the clock, which the session may still tell of."
    last: tuple[int, int] | None = None
    "Number and beginning of the sweep asked for last."
    period_ns: float = 0.0
    "From slot to slot; 0: not known, or no other follows by itself."

    def late_by(self, now_ns: int) -> int:
        """Slots that have passed by the clock since the sweep that is still not measured."""
        if self.last is None or self.period_ns <= 0.0:
            return 0
        number, _ = self.last
        slot = self.open.get(number)
        if slot is None or not slot.measuring:
            return 0
        behind = (self.front - number) // self.stride - 1
        return max(0, int((now_ns - slot.end_ns) / self.period_ns) - behind)

    def find(self, number: int) -> _Settled | None:
        """How a number has ended, as far as that is remembered."""
        return next((one for one in reversed(self.settled) if number in one.numbers), None)

    def waits(self) -> int:
        """Slots that were passed over and whose turn to be reported has not come."""
        return sum(len(numbers) for numbers, behind in self.passed if behind in self.open)


class Ledger:
    """Of one sensor."""

    def __init__(self) -> None:
        self.plans = True
        "False of a replay: it plans nothing, and what leaves is what was asked for."
        self.asked = 0
        self.sent = 0
        self.withdrawn = 0
        self.again = 0
        "Sweeps that were measured a second time, since the settings had changed meanwhile: the same slots."
        self.dropped: Counter[str] = Counter()
        self.now_ns = 0
        "Up to when slots have come, by the clock of the run."
        self._streams: list[_Stream] = []
        "The newest last."
        self._current: _Stream | None = None

    # ---------------------------------------------------------------- sums

    def account(self) -> dict[str, Any]:
        """The sums by now, ready for JSON."""
        dropped, asked, withdrawn, under_way = Counter(self.dropped), self.asked, self.withdrawn, 0
        for stream in self._streams:
            under_way += len(stream.open) + stream.waits()
            if stream is not self._current:
                given_up = sum(self._given_up(slot) for slot in stream.open.values())
                under_way, withdrawn = under_way - given_up, withdrawn + given_up
        if self._current is not None and (late := self._current.late_by(self.now_ns)):
            dropped[LATE] += late
            asked += late
        return {
            "asked": asked,
            "sent": self.sent,
            "dropped": {reason: count for reason, count in sorted(dropped.items()) if count},
            "withdrawn": withdrawn,
            "under_way": under_way,
            "unaccounted": asked - self.sent - dropped.total() - withdrawn - under_way,
        }

    def scans_dropped(self) -> Counter[str]:
        """Slots by the reason for which hosts did not get them, those withdrawn among them."""
        account = self.account()
        return Counter(account["dropped"]) + Counter({WITHDRAWN: account["withdrawn"]})

    def _given_up(self, slot: _Slot) -> bool:
        return not slot.measuring and slot.end_ns < self.now_ns - GIVEN_UP_NS

    def _count(self, outcome: str, count: int) -> None:
        if outcome == SENT:
            self.sent += count
        elif outcome == WITHDRAWN:
            self.withdrawn += count
        else:
            self.dropped[outcome] += count

    # ---------------------------------------------------------------- what is asked for

    def ask(self, plan: ScanPlan) -> None:
        """A sweep is asked for."""
        number, name = plan.sweep, _name(plan)
        stream = next((one for one in reversed(self._streams) if one.name == name and not one.ended), None)
        if stream is None:
            stream = _Stream(name, plan.stride, number, number)
            self._streams.append(stream)
            self._forget_streams()
        if stream is not self._current:
            self._leave()
            self._current = stream
            self._streams.remove(stream)
            self._streams.append(stream)
        if number >= stream.front:
            gap = range(stream.front, number, stream.stride)
            known = min(stream.ahead, len(gap))
            stream.ahead -= known
            if gap := gap[known:]:
                self.asked += len(gap)
                stream.passed.append((gap, number))
                del stream.passed[:-MOST_OPEN]
            self.asked += 1
            stream.front = number + stream.stride
        elif not self._reopen(stream, number):
            self.asked += 1
        end_ns = plan.start_ns + round(1e9 * plan.duration_s)
        stream.open[number] = _Slot((plan.epoch, number), end_ns)
        if len(stream.open) > MOST_OPEN:
            del stream.open[min(stream.open)]
        if plan.period_ns is not None:
            stream.period_ns = plan.period_ns
        elif stream.last is not None and number > stream.last[0]:
            scans = (number - stream.last[0]) / stream.stride
            stream.period_ns = (plan.start_ns - stream.last[1]) / scans
        stream.last = number, plan.start_ns

    def wants(self, plan: ScanPlan | None) -> None:
        """What the session wants measured now; None: nothing more for the time being."""
        current = self._current
        if current is not None and (plan is None or _name(plan) != current.name):
            self._leave()
            # without numbers of its own, what comes after a rest may be another stream: nobody was owed what is between
            current.ended = isinstance(current.name, tuple)
            self._current = None

    def _reopen(self, stream: _Stream, number: int) -> bool:
        """Whether the number has been on account already: it is under way once more."""
        if number in stream.open:
            self.again += 1
            return True
        if self._take_passed(stream, range(number, number + 1), number):
            return True
        settled = stream.find(number)
        if settled is None or settled.outcome == SENT:
            return False
        self._count(settled.outcome, -1)
        self._unsettle(stream, settled, number)
        self.again += 1
        return True

    def _unsettle(self, stream: _Stream, settled: _Settled, number: int) -> None:
        numbers, stride = settled.numbers, stream.stride
        place = stream.settled.index(settled)
        del stream.settled[place]
        for rest in (range(numbers.start, number, stride), range(number + stride, numbers.stop, stride)):
            if rest:
                stream.settled.append(_Settled(rest, settled.outcome, settled.of_host))

    def _leave(self) -> None:
        """The stream ends, or rests: what has passed meanwhile by the clock was too late."""
        stream = self._current
        if stream is not None and (late := stream.late_by(self.now_ns)):
            numbers = range(stream.front, stream.front + late * stream.stride, stream.stride)
            stream.front = numbers.stop
            stream.assumed += late
            self.asked += late
            self._count(LATE, late)
            stream.settled.append(_Settled(numbers, LATE, False))

    def _forget_streams(self) -> None:
        while len(self._streams) > STREAMS_KEPT:
            old = self._streams.pop(0)
            # what was measured for it and has not left is withdrawn; what was never measured has been lost
            self.withdrawn += sum(not slot.measuring for slot in old.open.values())

    # ---------------------------------------------------------------- how it ends

    def take(self, plan: ScanPlan) -> None:
        """The session has taken the scan of a plan."""
        stream = self._of_plan(plan)
        if stream is None:
            return
        if plan.sweep not in stream.open:
            if not self._reopen(stream, plan.sweep):
                self.asked += 1
            stream.open[plan.sweep] = _Slot((plan.epoch, plan.sweep), plan.start_ns + round(1e9 * plan.duration_s))
        stream.open[plan.sweep].measuring = False

    def missed(self, plan: ScanPlan) -> None:
        """The scan of a plan never comes, and the session knows: it reports why, or wants it once more."""
        stream = self._of_plan(plan)
        slot = None if stream is None else stream.open.get(plan.sweep)
        if stream is not None and slot is not None and slot.key == (plan.epoch, plan.sweep):
            self._settle(stream, plan.sweep, LATE)
            stream.settled[-1].provisional = True

    def refuse(self, plan: ScanPlan, reason: str = WITHDRAWN) -> None:
        """The scan of a plan is not wanted any more, or never comes; unless its slot was asked for again."""
        stream = self._of_plan(plan)
        slot = None if stream is None else stream.open.get(plan.sweep)
        if stream is not None and slot is not None and slot.key == (plan.epoch, plan.sweep):
            self._settle(stream, plan.sweep, reason)

    def send(self, emission: Emission, outcome: str = SENT) -> None:
        """A telegram with a scan leaves, or is taken by what `outcome` says."""
        assert emission.sweep is not None
        stream = self._of_sweep(emission.sweep)
        if stream is None:
            self.asked += 0 if self.plans else emission.scans
            self._count(outcome, emission.scans)  # nobody has asked for it
            return
        stride = stream.stride
        last = stream.open.get(emission.sweep)
        for number in range(emission.sweep, emission.sweep + emission.scans * stride, stride):
            if number in stream.open:
                self._settle(stream, number, outcome, emission.address is not None)
                continue
            settled = stream.find(number)
            if settled is not None and settled.outcome != SENT and not settled.of_host:  # it leaves after all
                self._count(settled.outcome, -1)
                self._unsettle(stream, settled, number)
            elif not self._take_passed(stream, range(number, number + 1), number):
                self.asked += 1  # another host's
            self._count(outcome, 1)
            stream.settled.append(_Settled(range(number, number + 1), outcome, emission.address is not None))
        if last is not None:
            self._overtake(stream, emission.sweep, last.end_ns)

    def _overtake(self, stream: _Stream, number: int, end_ns: int) -> None:
        """A scan has left: earlier ones that have not are missing, and must be reported."""
        for one in [one for one, slot in stream.open.items() if one < number and not slot.measuring]:
            del stream.open[one]
            stream.passed.append((range(one, one + 1), number))
        if len(self._streams) == 1:
            return
        for other in self._streams:
            if other is not stream:
                gone = [one for one, slot in other.open.items() if slot.end_ns < end_ns and not slot.measuring]
                for one in gone:
                    self._settle(other, one, WITHDRAWN)

    def take_back(self, emission: Emission, reason: str) -> bool:
        """A scan that was sent has got lost on its way out; False: it is not known to have been sent."""
        assert emission.sweep is not None
        stream = self._of_sweep(emission.sweep)
        settled = None if stream is None else stream.find(emission.sweep)
        if stream is None or settled is None or settled.outcome != SENT:
            return False
        numbers = range(emission.sweep, emission.sweep + emission.scans * stream.stride, stream.stride)
        for number in numbers:
            if (one := stream.find(number)) is not None and one.outcome == SENT:
                one.outcome = reason
                self._count(SENT, -1)
                self._count(reason, 1)
        return True

    def tell(self, event: Dropped) -> None:
        """The session has said that scans go no further, and why."""
        reason, numbers = event.reason.value, event.sweeps
        if numbers is None:
            self._tell_count(reason, event.count)
            return
        if not numbers:
            return
        stream = self._of_sweep(numbers.start)
        if event.stream is not None:
            stream = next((one for one in reversed(self._streams) if one.name == event.stream), stream)
        stream = stream or self._newest()
        if stream is None:
            self.asked += len(numbers)
            self._count(reason, len(numbers))
            return
        self._tell_numbers(stream, numbers, reason, event.address is not None)

    def _take_provisional(self, stream: _Stream, numbers: range) -> None:
        """What was put down as late until the session reports is open again: now it does."""
        for settled in [one for one in stream.settled if one.provisional and one.numbers.start in numbers]:
            number = settled.numbers.start
            self._count(settled.outcome, -1)
            self._unsettle(stream, settled, number)
            stream.open[number] = _Slot((-1, number), 0, measuring=False)

    def _tell_numbers(self, stream: _Stream, numbers: range, reason: str, of_host: bool) -> None:
        self._take_provisional(stream, numbers)
        before = len(range(numbers.start, min(numbers.stop, stream.first), numbers.step))
        beyond = range(max(numbers.start, stream.front), numbers.stop, numbers.step)
        if before:
            stream.first = numbers.start
        if beyond:
            if hole := range(stream.front, beyond.start, stream.stride):
                self.asked += len(hole)
                stream.passed.append((hole, beyond.start))
            stream.front = beyond[-1] + stream.stride
        open_ = [number for number in stream.open if number in numbers]
        for number in open_:
            self._settle(stream, number, reason, of_host)
        passed = self._take_passed(stream, numbers, numbers.stop)
        others = 0
        if of_host:  # what has ended already ended for another host
            others = len(numbers) - before - len(beyond) - len(open_) - passed
        new = before + len(beyond) + others
        self.asked += new
        self._count(reason, new + passed)
        stream.settled.append(_Settled(numbers, reason, of_host))

    def _tell_count(self, reason: str, count: int) -> None:
        """Without numbers: the oldest that are missing, else the oldest that were measured, else those to come."""
        if reason in HELD_REASONS:
            count -= self._tell_held(reason, count)
        for stream in self._streams:
            while count and stream.passed:
                numbers, behind = stream.passed[0]
                taken = numbers[:count]
                stream.passed[0] = (numbers[count:], behind)
                if not stream.passed[0][0]:
                    del stream.passed[0]
                count -= len(taken)
                self._count(reason, len(taken))
                stream.settled.append(_Settled(taken, reason, False))
            if reason == LATE:
                known = min(count, stream.assumed)
                stream.assumed -= known
                count -= known
        if count:
            self.asked += count
            self._count(reason, count)
            newest = self._newest()
            if newest is not None and reason not in HELD_REASONS:
                newest.ahead += count

    def _tell_held(self, reason: str, count: int) -> int:
        done = 0
        for stream in self._streams:
            for number in sorted(number for number, slot in stream.open.items() if not slot.measuring):
                if done < count:
                    self._settle(stream, number, reason)
                    done += 1
        return done

    def restart(self) -> None:
        """The device has started again: what it had not sent is withdrawn."""
        self._leave()
        self._end_streams(WITHDRAWN)

    def cut(self, reason: str) -> None:
        """The device has no power: it forgets all that it has not sent."""
        self._leave()
        self._end_streams(reason)

    def _end_streams(self, outcome: str) -> None:
        self._current = None
        for stream in self._streams:
            stream.ended = True
            waiting = [(numbers, behind) for numbers, behind in stream.passed if behind in stream.open]
            stream.passed = [one for one in stream.passed if one not in waiting]
            for numbers, _ in waiting:
                self._count(outcome, len(numbers))
                stream.settled.append(_Settled(numbers, outcome, False))
            for number in list(stream.open):
                self._settle(stream, number, outcome)

    # ---------------------------------------------------------------- own

    def _newest(self) -> _Stream | None:
        return self._streams[-1] if self._streams else None

    def _of_plan(self, plan: ScanPlan) -> _Stream | None:
        """The stream of a plan that was asked for."""
        found = [one for one in reversed(self._streams) if one.name == _name(plan)]
        return next((one for one in found if one.first <= plan.sweep < one.front), None)

    def _of_sweep(self, sweep: int) -> _Stream | None:
        """The newest stream in which that number is under way, else in which it has ended."""
        newest_first = self._streams[::-1]
        return next((one for one in newest_first if sweep in one.open), None) or next(
            (one for one in newest_first if one.first <= sweep < one.front), None
        )

    def _settle(self, stream: _Stream, number: int, outcome: str, of_host: bool = False) -> None:
        del stream.open[number]
        self._count(outcome, 1)
        stream.settled.append(_Settled(range(number, number + 1), outcome, of_host))

    @staticmethod
    def _take_passed(stream: _Stream, numbers: range, teller: int | None = None) -> int:
        """Take numbers out of those that were passed over; how many there were. `teller`: now behind those before."""
        taken, kept = 0, []
        for missing, behind in stream.passed:
            below = len(range(missing.start, min(missing.stop, numbers.start), missing.step))
            within = len(range(missing.start, min(missing.stop, numbers.stop), missing.step)) - below
            taken += within
            if not within:
                kept.append((missing, behind))
                continue
            kept.append((missing[:below], behind if teller is None else teller))
            kept.append((missing[below + within :], behind))
        stream.passed = [one for one in kept if one[0]]
        return taken


def _name(plan: ScanPlan) -> object:
    return ("epoch", plan.epoch) if plan.stream is None else plan.stream


class HasLedger(Protocol):
    """A sensor with its account."""

    @property
    def sensor(self) -> str:
        """Its name in the scenario."""

    @property
    def ledger(self) -> Ledger:
        """The account of its scans."""


def check_accounts(instruments: Iterable[HasLedger], incidents: Incidents, now_ns: int) -> None:
    """At the end of a run: an incident for each sensor whose scans do not add up."""
    for instrument in instruments:
        instrument.ledger.now_ns = max(now_ns, instrument.ledger.now_ns)
        if reported := faults_of(instrument.ledger.account()):
            incidents.note("scans unaccounted", now_ns, instrument.sensor, reported)


def faults_of(account: dict[str, Any]) -> str:
    """What is wrong with an account in words; empty: it adds up."""
    missing = account["unaccounted"]
    if not missing:
        return ""
    dropped = sum(account["dropped"].values())
    ended = f"{account['sent']} sent, {dropped} dropped, {account['withdrawn']} withdrawn"
    return f"{missing} of {account['asked']} scans are unaccounted for: {ended}, {account['under_way']} in flight"
