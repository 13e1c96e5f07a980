"""Sweeps of one sensor in several processes at once: which process takes which, and what is measured ahead.

Belongs here: the choice of work for a process that is free, sweeps in parts, sweeps measured before they are asked for,
a second try of one that stands still. Not: processes (supervision); when a sweep is asked for, and in which order
(instrument).

Each sensor has one process as its own. One that remembers nothing from sweep to sweep is *shared*: a process that is
free takes what waits for another. What is asked for goes before what is measured ahead, own work before that of others;
where the process of another is gone or stands still, whichever begins first.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace

from emulator.measuring.homes import Home, Question, Sweep
from emulator.measuring.parts import FEWEST_BEAMS, Divided
from emulator.process import time_limits
from protocols.scan import ScanPlan

LENT_NS = 20_000_000
"A process with sensors of its own is lent to others for sweeps as short as that: an LMS2xx, the tightest, waits 40 ms."
AWAY_NS = 100_000_000
"The same while the process of the other sensor is gone, or stands still."
QUEUED_NS = 20_000_000
"""Sweeps as short as that wait in pipes: of them the way to the sender and back is a large share, and what is in a pipe
is not held up for long, as no other process can take it."""
BEHIND = 2
"Short sweeps of a sensor that are begun behind one in hand: one waits in the pipe, one takes its place after it."
AGAIN_NS = 50_000_000
AGAIN_TIMES = 4
"After so long, and so many times as long as the longest of the last, a sweep is also given to a process that is free."

WHOLE_FOR = 64
"Sweeps until it is tried again whether one can be measured in parts: other weather may have come, or faults have gone."


class Shared:
    """Sensors that any process may measure."""

    def __init__(self, sensors: Sequence[str]) -> None:
        self.sensors = frozenset(sensors)
        self._early: dict[str, list[Sweep]] = {}
        "Measured ahead and not asked for yet, by sensor."
        self._whole: dict[str, int] = {}
        "Sensors whose sweeps are not measured in parts, and for how many further ones."
        self._sliced: dict[str, Divided] = {}
        "Sensor -> its sweep that is measured in slices."
        self.latest: dict[str, Sweep] = {}
        "The sweep measured last, whichever process did it: a new process is tried with it."

    # what is measured ahead

    def begin(self, work: Sweep) -> None:
        """One is measured ahead."""
        self._early.setdefault(work.sensor, []).append(work)

    def claimed(self, sensor: str, early: ScanPlan, plan: ScanPlan) -> Sweep | None:
        """What was measured ahead for `early` is asked for, as `plan`; None: it is not there any more."""
        for work in self._early.get(sensor, ()):
            if work.plan is early:
                self._early[sensor].remove(work)
                work.ahead, work.asked_as = False, plan
                return work
        return None

    def forget(self, work: Sweep) -> None:
        """It will not be asked for, or cannot be had."""
        if work in self._early.get(work.sensor, ()):
            self._early[work.sensor].remove(work)

    def of_plans(self, sensor: str, plans: Sequence[ScanPlan]) -> list[Sweep]:
        """Those measured ahead for these plans."""
        return [work for work in self._early.get(sensor, ()) if any(work.plan is plan for plan in plans)]

    # who takes what

    def spare(self, sensor: str, homes: Sequence[Home], behind: bool) -> int:
        """How many more of its sweeps would be begun at once; `behind`: or right behind one of its own."""
        if sensor not in self.sensors:
            return 0
        busy = [one for home in homes for one in (home.in_hand, home.behind) if one is not None]
        usual_ns = self._usual_ns(sensor, homes)
        free = sum(
            home.state == "ready" and home.in_hand is None and self._is_lent(home, sensor, usual_ns, homes)
            for home in homes
        )
        if behind and all(isinstance(one, Sweep) and one.sensor == sensor for one in busy):
            # while a result is on its way its process has the next; of long sweeps one process has none ahead: it loses
            # little, and what comes late is another sweep by then
            most = BEHIND if 0 < usual_ns <= QUEUED_NS else min(1, len(homes) - 1)
            free += sum(max(0, most - (home.behind is not None)) for home in homes if home.in_hand is not None)
        return max(0, free - sum(home.waiting for home in homes))

    def parts(self, work: Sweep, homes: Sequence[Home]) -> list[Sweep]:
        """A sweep as it is owed: in as many parts as processes would begin one at once, if it is wanted at once.

        What moves by the scenario's file alone is measured ahead instead, whole sweeps side by side.
        """
        sensor, plan = work.sensor, work.plan
        if work.conditions.world is None or len(plan) < FEWEST_BEAMS or self._is_whole(sensor):
            return [work]
        of = self.spare(sensor, homes, behind=False)
        if of < 2:
            return [work]
        divided = Divided(plan, of)
        return [Sweep(sensor, plan, work.conditions, part=number, divided=divided) for number in range(of)]

    def has_slices(self, sensor: str, plan: ScanPlan, homes: Sequence[Home]) -> bool:
        """Whether a sweep may be measured in slices of time: by a process that has nothing else to do.

        Where several are free, all its parts are measured at once instead.
        """
        mine = len(homes) == 1 and homes[0].sensors == (sensor,) and sensor in self.sensors
        return mine and len(plan) >= FEWEST_BEAMS and not self._whole.get(sensor, 0)

    def slice_of(self, work: Sweep, number: int, of: int) -> Sweep | None:
        """One slice of a sweep, the first one first; None: that sweep has come meanwhile, or was given up."""
        if number == 0:
            self._sliced[work.sensor] = Divided(work.plan, of, in_time=True)
        divided = self._sliced.get(work.sensor)
        if divided is None or divided.plan is not work.plan or divided.is_over:
            return None
        return replace(work, part=number, divided=divided)

    def _is_whole(self, sensor: str) -> bool:
        """Whether its sweeps could not be measured in parts lately."""
        left = self._whole.get(sensor, 0)
        if left:
            self._whole[sensor] = left - 1
        return left > 0

    def undivided(self, sensor: str) -> None:
        """One of its sweeps could not."""
        self._whole[sensor] = WHOLE_FOR

    def next_of(
        self,
        home: Home,
        homes: Sequence[Home],
        pauses: Callable[[str], bool],
        fits: Callable[[Sweep | Question], bool] = lambda work: True,
    ) -> Sweep | Question | None:
        """What a process that is free does next; it is among what its home owes then."""
        for work, owner in self._candidates(home, homes):
            if (isinstance(work, Sweep) and pauses(work.sensor)) or not fits(work):
                continue
            if owner is not home:
                owner.owed.remove(work)
                home.owed.append(work)
            return work
        return None

    def next_behind(self, home: Home, homes: Sequence[Home], pauses: Callable[[str], bool]) -> Sweep | None:
        """What waits in the pipe of a process behind the sweep in its hands, as `next_of`: nothing where either may
        take long, nor before a question; of other processes' sweeps only where it has none of its own.

        Nor a shared one behind a sensor that remembers: that such a process stands still is noticed late, and another
        could measure it.
        """

        def is_short(sensor: str) -> bool:
            return not home.pace[sensor].fresh and 0 < home.pace[sensor].usual_ns <= QUEUED_NS

        first = home.in_hand
        if not isinstance(first, Sweep) or first.given_up or _is_stuck(home) or not is_short(first.sensor):
            return None
        held = first.sensor not in self.sensors and len(homes) > 1

        def fits(work: Sweep | Question) -> bool:
            if isinstance(work, Question) or (home.sensors and work.sensor not in home.sensors):
                return False
            return is_short(work.sensor) and not (held and work.sensor in self.sensors)

        if not any(one.waiting for one in homes) or any(isinstance(one, Question) for one in home.owed):
            return None
        work = self.next_of(home, homes, pauses, fits)
        assert not isinstance(work, Question)
        return work

    def _candidates(self, home: Home, homes: Sequence[Home]) -> Iterator[tuple[Sweep | Question, Home]]:
        busy = [one for one in homes if one is not home and (one.in_hand is not None or one.state != "ready")]
        owners = (home, *busy) if self.sensors else (home,)
        away = [one for one in busy if one.state != "ready" or _is_stuck(one)] if self.sensors else []

        def rank(found: tuple[Sweep | Question, Home]) -> tuple[int, int]:
            work, owner = found
            if isinstance(work, Question):
                return 0, 0
            return (1, work.plan.start_ns) if owner is home or owner in away else (2, 0)

        for ahead in (False, True):
            found: list[tuple[Sweep | Question, Home]] = []
            for owner in owners:
                for work in owner.owed:
                    if owner.holds(work) or (isinstance(work, Sweep) and work.ahead) != ahead:
                        continue
                    if owner is home or self._may_move(work, home, homes):
                        found.append((work, owner))
            yield from sorted(found, key=rank) if away else found  # own work that never ends must not keep theirs out

    def _may_move(self, work: Sweep | Question, home: Home, homes: Sequence[Home]) -> bool:
        if not isinstance(work, Sweep) or work.given_up or work.sensor not in self.sensors:
            return False
        return self._is_lent(home, work.sensor, self._usual_ns(work.sensor, homes), homes)

    @staticmethod
    def _usual_ns(sensor: str, homes: Sequence[Home]) -> int:
        """What a sweep of it takes; 0: not known."""
        return min((home.pace[sensor].usual_ns for home in homes if home.pace[sensor].usual_ns), default=0)

    @staticmethod
    def _is_lent(home: Home, sensor: str, usual_ns: int, homes: Sequence[Home]) -> bool:
        if sensor in home.sensors or all(home.pace[own].fresh for own in home.sensors):
            return True
        away = any(sensor in one.sensors and (one.state != "ready" or _is_stuck(one)) for one in homes)
        return 0 < usual_ns <= (AWAY_NS if away else LENT_NS)

    def warms_up(self, home: Home, work: Sweep, homes: Sequence[Home]) -> Sweep | None:
        """What a process measures for nobody before its first sweep of a sensor that others measure meanwhile."""
        latest = self.latest.get(work.sensor)
        if latest is None or work.sensor not in self.sensors or not home.pace[work.sensor].fresh:
            return None
        if not any(one.state == "ready" and not one.pace[work.sensor].fresh for one in homes):
            return None
        return Sweep(latest.sensor, latest.plan, latest.conditions, given_up=True)

    # what stands still

    def again(self, home: Home, homes: Sequence[Home], now_ns: int) -> list[Sweep]:
        """What a process has that takes too long, once more for others: the sweep in hand if one of them is free, and
        then the one that waits behind it."""
        found = []
        work = home.in_hand
        if isinstance(work, Sweep) and not work.given_up and work.sensor in self.sensors:
            if self._takes_too_long(home, work, homes, now_ns):
                found.append(self._second(work))
        if home.behind is not None and not home.behind.given_up and home.behind.sensor in self.sensors:
            if _is_stuck(home) and any(one.state == "ready" and not _is_stuck(one) for one in homes):
                found.append(self._second(home.behind))
        return found

    def _takes_too_long(self, home: Home, work: Sweep, homes: Sequence[Home], now_ns: int) -> bool:
        pace = home.pace[work.sensor]
        most_ns = time_limits.IDLE_NS if pace.fresh else max(AGAIN_NS, AGAIN_TIMES * pace.longest_ns)
        if now_ns - home.since_ns <= most_ns:
            return False
        work.again = work.given_up = True  # the process counts as away while it is looked who may take it
        usual_ns = self._usual_ns(work.sensor, homes)
        free = [one for one in homes if one.state == "ready" and one.in_hand is None]
        found = any(self._is_lent(one, work.sensor, usual_ns, homes) for one in free)
        work.again = work.given_up = found
        return found

    def _second(self, work: Sweep) -> Sweep:
        """The same sweep for another process; what comes of the first is thrown away."""
        work.again = work.given_up = True
        second = Sweep(work.sensor, work.plan, work.conditions, work.tries, ahead=work.ahead, asked_as=work.asked_as)
        second.part, second.divided = work.part, work.divided
        if work.ahead:
            self.forget(work)
            self.begin(second)
        return second


def _is_stuck(home: Home) -> bool:
    """What it has in hand has been given to another too, or given up: it takes too long."""
    work = home.in_hand
    return isinstance(work, Sweep) and (work.again or (work.given_up and not work.ahead))
