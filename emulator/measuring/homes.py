"""What one worker owes, the state of the process that it is at present, and of the one that will take its place.

Belongs here: the data. Not: when any of it changes (supervision).
"""

from __future__ import annotations

from collections import defaultdict, deque
from collections.abc import Sequence
from concurrent.futures import Future
from dataclasses import dataclass, field

from emulator.measuring.conditions import Conditions
from emulator.measuring.parts import Divided
from emulator.measuring.worker import Handle, Pipe
from emulator.process.time_limits import Pace, Stillness
from emulator.scenario.weather import WeatherConfig
from protocols.scan import Scan, ScanPlan


@dataclass(eq=False)
class Sweep:
    """One sweep that a worker owes."""

    sensor: str
    plan: ScanPlan
    conditions: Conditions
    tries: int = 0
    "Workers that have ended while they measured it."
    given_up: bool = False
    "Its device knows that it will not come; whatever comes of it is thrown away."
    again: bool = False
    "Another process has been given it too: this one stands still."
    ahead: bool = False
    "It is measured before it is asked for."
    asked_as: ScanPlan | None = None
    "The device's own plan, if it was measured ahead for one of the same sweep."
    scan: Scan | None = None
    "Of one measured ahead: it waits here."
    part: int = 0
    divided: Divided | None = None
    "The sweep of which this is that part; None: it is all of it."

    @property
    def is_awaited(self) -> bool:
        """Somebody waits for it."""
        return not (self.ahead or self.given_up)

    @property
    def end_ns(self) -> int:
        """When its device could have sent it."""
        return self.plan.start_ns + round(self.plan.duration_s * 1e9)

    def as_sent(self) -> tuple[object, ...]:
        if self.divided is None:
            return self.sensor, self.plan, self.conditions
        return self.sensor, self.plan, self.conditions, (self.part, self.divided.of, self.divided.in_time)


@dataclass(eq=False)
class Question:
    """Whether some sensors can compute such weather; stands among the sweeps that a worker owes."""

    sensors: tuple[str, ...]
    weather: WeatherConfig
    answer: Future[dict[str, str]] = field(default_factory=Future)
    is_awaited = True

    def as_sent(self) -> tuple[object, ...]:
        return self.sensors, None, self.weather


@dataclass(eq=False)
class Handover(Question):
    """What a process remembers, asked for its successor; the first of those owed once that is warm."""

    sensors: tuple[str, ...] = ()
    weather: WeatherConfig = field(default_factory=WeatherConfig)

    def as_sent(self) -> tuple[object, ...]:
        return None, None, None


@dataclass(eq=False)
class Successor:
    """A process with compiled loops that gets ready beside the one that measures, to take its place."""

    handle: Handle
    pipe: Pipe
    fileno: int
    since_ns: int
    "Running time at which it was started, or has answered last."
    form: str = ""
    "Once it is ready."
    unanswered: int = 0
    "Sweeps that it measures for nobody: the first in a process takes longer."

    @property
    def is_warm(self) -> bool:
        return bool(self.form) and not self.unanswered


@dataclass
class Blame:
    """A sensor whose sweeps end workers, one after the other: it pauses, the others of its worker go on."""

    deaths: int = 0
    until_ns: int = 0


class Home:
    """One worker and its successors."""

    def __init__(self, number: int, sensors: Sequence[str]) -> None:
        self.number = number
        self.sensors = tuple(sensors)
        self.state = "dead"
        "starting | ready | ending | dead"
        self.handle: Handle | None = None
        self.pipe: Pipe | None = None
        self.fileno = -1
        self.form = ""
        "Arrays or loops, as the process reports."
        self.successor: Successor | None = None
        self.latest: dict[str, Sweep] = {}
        "Sensor -> the sweep that was measured last: a successor is tried with it."
        self.owed: deque[Sweep | Question] = deque()
        self.in_hand: Sweep | Question | None = None
        "The first of those owed that has been handed over: what the process works at, and is judged by."
        self.behind: Sweep | None = None
        "A short sweep that waits in its pipe behind the one in hand: the process goes on without the sender."
        self.since_ns = 0
        "Running time at which its state, or the work in hand, began."
        self.ready_ns = 0
        "Running time at which the present process was ready, if it was."
        self.was_ready = False
        self.retry_ns = 0
        self.failures = 0
        "Processes that have ended in a row and were not sound."
        self.starts = 0
        self.measured = 0
        "Sweeps, of all its processes."
        self.lost = False
        "It has been reported that none can be started."
        self.why = ""
        "Why the last one has ended."
        self.stillness = Stillness(0)
        self.pace: defaultdict[str, Pace] = defaultdict(Pace)

    @property
    def name(self) -> str:
        """As reported in incidents."""
        return f"worker {self.number}"

    def holds(self, work: Sweep | Question) -> bool:
        """Whether its process has that, in hand or in the pipe: nobody can take it back."""
        return work is self.in_hand or work is self.behind

    @property
    def waiting(self) -> int:
        """How much of what it owes no process has yet."""
        return len(self.owed) - (self.in_hand is not None) - (self.behind is not None)
