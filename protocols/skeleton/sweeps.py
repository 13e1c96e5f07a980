"""A device that measures one sweep after the other and sends each to its subscribers.

    power_on    no input or output for `boot_ns`; then sweeps are numbered from the end of the boot, at a fixed period
    _subscribe  a host gets scans from the next sweep on
    next_plan   the next sweep, while there are subscribers; those that ended unmeasured are skipped and reported
    submit      one or more telegrams, each at its own instant, to all subscribers at the start of the sweep

A family defines the directions (`_sweep`) and the bytes (`_telegrams`). Belongs here: numbers and instants of sweeps,
subscribers, scan accounting. Not: lines slower than the sweeps, and sweeps skipped for them.
"""

from __future__ import annotations

from abc import abstractmethod
from collections import deque
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from fractions import Fraction
from typing import ClassVar, NamedTuple

from protocols.device_clock import DeviceStamp
from protocols.scan import Floats, Scan, ScanPlan
from protocols.session import Address, DropReason, Emission
from protocols.skeleton.instants import Numbered, Raster, Timers, earliest
from protocols.skeleton.outbox import Outgoing
from protocols.skeleton.session import TimedSession
from protocols.skeleton.wanted import Wanted

SLICES_KEPT = 40
"Slices that a family remembers from its plan to its packets: of those measured at once, and one before."
SHARES = 1 << 20
"Resolution of a motor's speed, as a fraction of the nominal one; finer than any motor."


@dataclass(frozen=True, eq=False)
class Sweep:
    """What a device measures in one sweep, at its nominal speed."""

    azimuth_rad: Floats
    "(n,)"
    elevation_rad: Floats
    "(n,)"
    fire_offset_s: Floats
    "(n,) after the sweep's beginning."
    duration_s: float
    "Until the device can have evaluated it."
    max_range_m: float = float("inf")
    max_echoes: int = 1
    gain: float = 1.0
    wants_intensity: bool = False
    turn: int | None = None
    "Of a slice: the turn in which it begins."
    origin_m: Floats | None = None
    "(n, 3) where beams begin; None: in the sensor's origin."
    wants_ambient: bool = False


class Telegram(NamedTuple):
    """One of the telegrams that carry a sweep."""

    after_ns: int
    "When its first byte is sent, after the sweep's beginning."
    payload: bytes
    label: str = ""
    reported: DeviceStamp | None = None
    link: int | None = None
    "Sent to this link only; None: to the subscribers."


class SweepSession(TimedSession):
    """Base class of a device that measures sweeps."""

    FORESEES: ClassVar[bool] = False
    "Computing a sweep beforehand changes nothing, neither in it nor in those after it."
    LINE_SPEED: ClassVar[int | None] = None
    "Speed of its serial line at power-on, in baud."

    def __init__(self, boot_ns: int, period_ns: Fraction) -> None:
        super().__init__()
        self._boot_ns = boot_ns
        self._nominal_ns = period_ns
        self._timers = Timers()
        self._wanted: Wanted[Sweep] = Wanted()
        self._hosts: dict[Address | None, int] = {}
        "Subscribers, and since when; None: every link."
        self._ready_ns: int | None = None
        "When the boot ends; None: never switched on."
        self._running = False
        self._slowed = Fraction(1)
        "Duration of a turn over the nominal one."
        self._raster = Raster(0, period_ns)
        self._next = 0
        "Number of the sweep to be measured next."
        self._foreseen: deque[tuple[int, int]] = deque(maxlen=SLICES_KEPT)
        "Epoch and number of sweeps that are measured before they are wanted, ascending."
        self._stream = 0
        self._restart_ns: int | None = None

    # what a family fills in

    @abstractmethod
    def _sweep(self, number: int) -> Sweep:
        """The sweep of that number, at the present settings."""

    @abstractmethod
    def _telegrams(self, scan: Scan) -> Iterable[Telegram]:
        """The telegrams of a scan, in the order of sending; none if it has too few samples for one."""

    def _schedule(self) -> Numbered:
        """When each sweep begins."""
        return self._raster

    def _reset(self, now_ns: int) -> None:
        """Reset volatile settings to those after power-on."""

    def _start(self, now_ns: int) -> None:
        """Called at the end of the boot: first subscribers, and timers."""

    def _goes_to(self, to: Address | None) -> tuple[str, int] | None:
        """Address and port that a subscriber's datagrams are sent to; None: those of its link."""
        return None

    def _passed_over(self, number: int) -> int:
        """How many sweeps from that number on the device keeps to itself; they need not be measured."""
        return 0

    def _is_settled(self, number: int) -> bool:
        """Whether it, or the next that is not skipped, can be computed now: nothing that may still come, as a pulse
        that the phase is held to, acts before its end."""
        return True

    # power

    def power_on(self, now_ns: int) -> None:
        """Reset everything volatile; no input or output until the end of the boot."""
        self._now_ns = now_ns
        self._outbox.clear()
        self._boot(now_ns)

    def _boot(self, now_ns: int) -> None:
        if self.LINE_SPEED is not None:  # no bytes: the speed alone
            self._outbox.send(Emission(now_ns, b"", line_speed=self.LINE_SPEED, label="power-on"))
        self._timers.clear()
        self._hosts.clear()
        self._wanted.renew()
        self._running, self._ready_ns, self._restart_ns = False, now_ns + self._boot_ns, None
        self._next = 0
        self._stream += 1
        self.clock = self.clock.powered_on(now_ns)
        self._events.restarted(now_ns)
        self._reset(now_ns)

    def _restart(self, at_ns: int) -> None:
        """Restart at a future instant, as after a reset requested by a host."""
        self._restart_ns = at_ns

    @property
    def is_up(self) -> bool:
        """Whether the boot is over."""
        return self._running

    # time

    def _next_instant(self) -> int | None:
        if not self._running:
            return self._ready_ns
        timers_ns = self._timers.next_ns()
        return timers_ns if self._restart_ns is None else earliest((timers_ns, self._restart_ns))

    def _happen(self, now_ns: int) -> None:
        if not self._running:
            self._running = True
            self._raster = Raster(now_ns, self._nominal_ns * self._slowed)
            self._start(now_ns)
        elif self._restart_ns is not None and self._restart_ns <= now_ns:
            self._withdraw_all(now_ns)
            self._outbox.withdraw(lambda sent: not sent.begun and sent.emissions[0].due_ns > now_ns)
            self._boot(now_ns)
        else:
            self._timers.run(now_ns)

    # hosts

    def _subscribe(self, now_ns: int, address: Address | None) -> None:
        """Send scans to a host from the next sweep on; no effect if it is subscribed. None: every link."""
        if not self._hosts:
            self._stream += 1
            self._next = max(self._next, self._schedule().first_from(now_ns))
        self._hosts.setdefault(address, now_ns)

    def _unsubscribe(self, now_ns: int, address: Address | None) -> None:
        """End the scans of a host: telegrams that have not begun are withdrawn."""
        if self._hosts.pop(address, None) is None:
            return
        self._withdraw(now_ns, lambda sent: sent.to == address)
        if not self._hosts:
            self._wanted.renew()

    def _withdraw_all(self, now_ns: int) -> None:
        """Remove all subscribers."""
        for address in list(self._hosts):
            self._unsubscribe(now_ns, address)

    def _withdraw(self, now_ns: int, whose: Callable[[Outgoing], bool]) -> None:
        gone = self._outbox.withdraw(lambda sent: sent.is_scan and not sent.begun and whose(sent))
        for sent in reversed(gone):
            self._withdrawn(sent)
            if (sweep := sent.emissions[0].sweep) is not None:
                self._events.unsent(now_ns, DropReason.STALE, range(sweep, sweep + 1), "on its way", None, sent.to)

    def _withdrawn(self, sent: Outgoing) -> None:
        """A scan will not be sent."""

    def _cut(self, now_ns: int) -> None:
        """Further telegrams of scans whose first one has been sent are not sent."""
        self._outbox.withdraw(lambda sent: sent.is_scan and sent.begun)

    def _change(self, now_ns: int, period_ns: Fraction | None = None) -> None:
        """A setting that scans depend on has changed: earlier scans are refused and withdrawn; a new stream begins.

        `period_ns`: period of sweeps, from the next one on.
        """
        self._withdraw(now_ns, lambda sent: True)
        self._wanted.renew()
        self._stream += 1
        self._nominal_ns = self._nominal_ns if period_ns is None else period_ns
        self._next = max(self._raster.first, self._raster.first_from(now_ns))
        self._raster = self._raster.going_on(self._next, self._nominal_ns * self._slowed)

    def impair(self, now_ns: int, what: str, degree: float) -> bool:
        """The motor: its speed is `degree` times the nominal one; or it is blocked (1), or free (0), if that shows."""
        self.advance(now_ns)
        if what == "motor speed" and degree > 0.0:
            self._set_factor(now_ns, degree)
            return True
        return what == "motor stopped" and self._block(now_ns, degree != 0.0)

    def _set_factor(self, now_ns: int, factor: float) -> None:
        """The motor's speed is so many times the nominal one."""
        self._slowed = 1 / Fraction(round(factor * SHARES), SHARES)
        if self._running:
            self._change(now_ns)

    def _block(self, now_ns: int, blocked: bool) -> bool:
        """The motor cannot turn, or can again; False: this device has no answer to that."""
        return False

    # sweeps

    def next_plan(self) -> ScanPlan | None:
        """The next sweep, the same until its scan is submitted."""
        if not self._running or not self._hosts:
            return None
        plan = self._wanted.plan
        return self._choose() if plan is None else plan

    def _choose(self) -> ScanPlan:
        while self._foreseen and self._foreseen[0] < (self._wanted.epoch, self._next):
            self._foreseen.popleft()
        ended = self._first_not_ended(self._next)
        if self._foreseen:
            ended = min(ended, self._foreseen[0][1])
        if ended > self._next:  # not measured in time: never silently
            late = range(self._next, ended)
            self._events.unsent(self._now_ns, DropReason.LATE, late, "not measured in time", self._stream)
            self._next = ended
        if passed := self._passed_over(self._next):
            numbers = range(self._next, self._next + passed)
            self._events.unsent(self._now_ns, DropReason.KEPT, numbers, "", self._stream)
            self._next += passed
        return self._wanted.ask(*self._planned(self._next))

    def _first_not_ended(self, number: int) -> int:
        duration_ns = round(1e9 * float(self._slowed) * self._sweep(number).duration_s)
        return max(number, self._schedule().first_from(self._now_ns - duration_ns))

    def _planned(self, number: int) -> tuple[ScanPlan, Sweep]:
        raster, slowed, sweep = self._schedule(), float(self._slowed), self._sweep(number)
        plan = ScanPlan(
            epoch=self._wanted.epoch,
            sweep=number,
            start_ns=raster.at(number),
            azimuth_rad=sweep.azimuth_rad,
            elevation_rad=sweep.elevation_rad,
            fire_offset_s=sweep.fire_offset_s if slowed == 1.0 else sweep.fire_offset_s * slowed,
            duration_s=sweep.duration_s * slowed,
            max_echoes=sweep.max_echoes,
            max_range_m=sweep.max_range_m,
            gain=sweep.gain,
            wants_intensity=sweep.wants_intensity,
            turn=sweep.turn,
            origin_m=sweep.origin_m,
            wants_ambient=sweep.wants_ambient,
            stream=self._stream,
            period_ns=round(raster.period_ns),
        )
        return plan, sweep

    def plan_after(self, plan: ScanPlan) -> ScanPlan | None:
        """A later sweep of the present settings, where the family foresees them."""
        number = plan.sweep + 1
        if not self.FORESEES or self._wanted.plan is None or not self._is_settled(number):
            return None
        number = self._first_not_ended(number)
        return self._planned(number + self._passed_over(number))[0]

    def begun(self, plan: ScanPlan) -> None:
        """It is wanted even when it has ended."""
        self._foreseen.append((plan.epoch, plan.sweep))

    def submit(self, scan: Scan) -> None:
        """Take the scan of `next_plan`; `ScanRefused` for any other."""
        takers, plan = self._accepted(scan), scan.plan
        if not takers:
            self._events.unsent(self._now_ns, DropReason.STALE, plan.sweep, "no subscriber", plan.stream)
            return
        telegrams = list(self._telegrams(scan))
        if not telegrams:
            self._events.unsent(self._now_ns, DropReason.KEPT, plan.sweep, "too few samples", plan.stream)
            return
        for address in takers:
            self._outbox.put(Outgoing(address, deque(self._emissions(plan, telegrams, address)), is_scan=True))

    def _accepted(self, scan: Scan) -> list[Address | None]:
        """It is the scan of the requested plan, else `ScanRefused`: who has subscribed before the sweep began."""
        plan = scan.plan
        self._wanted.expect(plan, len(scan.range_m))
        self._wanted.forget()
        self._next = plan.sweep + 1
        return [address for address, since_ns in self._hosts.items() if since_ns <= plan.start_ns]

    def _emissions(self, plan: ScanPlan, telegrams: Iterable[Telegram], to: Address | None) -> Iterable[Emission]:
        """The first one carries the sweep, the others (`scans` 0) are further parts."""
        sweep: int | None = plan.sweep
        slowed, place, start_ns, scans = self._slowed, self._goes_to(to), plan.start_ns, 1
        steady = slowed.numerator == slowed.denominator  # a product of fractions for each packet takes long
        for after_ns, payload, label, reported, link in telegrams:
            due_ns = start_ns + round(after_ns if steady else after_ns * slowed)
            where = to if link is None else Address(link, 0)
            yield Emission(due_ns, payload, where, sweep, None, label, reported, scans, None, False, place)
            sweep, scans = None, 0

    def missed(self, plan: ScanPlan, now_ns: int) -> bool:
        """Sweeps that have ended are skipped; the present one is requested again."""
        self.advance(now_ns)
        self._wanted.expect(plan)
        self._wanted.renew()
        return True
