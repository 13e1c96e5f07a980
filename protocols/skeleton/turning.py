"""A device whose rotor turns freely and whose samples come at a fixed rate: turns of unequal length, measured angles.

    _spin       another speed; it takes effect with the turn that has not begun, as the motor follows slowly
    _stall      the rotor stands: nothing is measured until it turns again, at speed
    _subscribe  the stream begins in the middle of a turn, as soon as the motor is at speed

Belongs here: rotor, samples, and which of them make a sweep. Not: packets and commands.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from fractions import Fraction

from protocols.scan import Floats, ScanPlan
from protocols.session import Address
from protocols.skeleton.instants import SECOND_NS, Raster
from protocols.skeleton.rotor import Rotor, Turns
from protocols.skeleton.sweeps import Sweep, SweepSession

REACHED = 4.0
"The motor counts as at speed after so many time constants: 2 % are left."
SHARES = 1 << 20
"Resolution of a factor on the speed."


@dataclass(frozen=True, eq=False)
class Motor:
    """The motor of a model."""

    hz: float
    "Speed at power-on."
    spin_up_ns: int
    "From standstill until it is at speed."
    wobble: float
    start_turn: float = 0.4
    "Where the rotor stands at power-on, in turns."


@dataclass(frozen=True, eq=False)
class Samples:
    """What falls into one turn."""

    first: int
    "Number of the first sample."
    angle_deg: Floats
    "(n,) clockwise from the front mark, ascending; may pass 360 where packets are not cut."
    after_s: Floats
    "(n,) after the turn's first sample."
    hz: float
    "Speed at its beginning."
    is_whole: bool
    "It begins with the passing of zero; not where a stream begins."
    end_s: float
    "When the next turn begins."


class TurningSession(SweepSession):
    """Base class; before another one that is a `SweepSession` too."""

    GROUP = 1
    "Samples that a packet always has."

    def __init__(self, boot_ns: int, motor: Motor, rate_hz: int) -> None:
        super().__init__(boot_ns, Fraction(SECOND_NS) / Fraction(motor.hz))
        self._motor = motor
        self._rate_hz = rate_hz
        self._hz = motor.hz
        "Controlled speed without faults."
        self._factor = 1.0
        self._speed_ns = 0
        "When the motor is at speed."
        self._stalled = False
        self._cache: tuple[int, Turns, Samples] | None = None
        self._turns = self._standing(0)

    def _standing(self, now_ns: int) -> Turns:
        """The rotor begins to turn."""
        settle_s = max(1e-3, self._motor.spin_up_ns / SECOND_NS / REACHED)
        rotor = Rotor(now_ns, self._motor.start_turn, self._hz, 0.0, settle_s, self._motor.wobble)
        return Turns(rotor, Raster(now_ns, Fraction(SECOND_NS, self._rate_hz)), 0, self.GROUP)

    # what a family fills in

    def _sweep_of(self, samples: Samples) -> Sweep:
        """Directions and limits of these samples."""
        raise NotImplementedError

    # the rotor

    def _schedule(self) -> Turns:
        return self._turns

    def _boot(self, now_ns: int) -> None:
        self._cache, self._hz = None, self._motor.hz
        super()._boot(now_ns)
        self._turns, self._speed_ns = self._standing(now_ns), now_ns + self._motor.spin_up_ns
        self._drive()

    def _drive(self) -> None:
        """The controlled speed from the beginning of the rotor's curve on."""
        hz = self._hz * self._factor
        self._turns = replace(self._turns, rotor=replace(self._turns.rotor, hz=hz))

    def _start_motor(self, now_ns: int) -> None:
        """From standstill; samples are numbered on."""
        turns, motor = self._turns, self._motor
        angle = turns.rotor.turned(now_ns)
        since = turns.samples.first_from(now_ns)
        rotor = replace(turns.rotor, at_ns=now_ns, turns=angle, from_hz=0.0)
        self._turns, self._speed_ns = replace(turns, rotor=rotor, since=since), now_ns + motor.spin_up_ns
        self._drive()

    def _subscribe(self, now_ns: int, address: Address | None) -> None:
        """Send to a host as soon as the motor is at speed, from the middle of a turn on."""
        if not self._hosts:
            self._begin(max(now_ns, self._speed_ns))
        super()._subscribe(now_ns, address)

    def _begin(self, at_ns: int) -> None:
        self._turns = replace(self._turns, since=self._turns.samples.first_from(at_ns))
        self._next = max(self._next, self._turns.first)

    def _unsubscribe(self, now_ns: int, address: Address | None) -> None:
        """End the scans of a host with the packet that is being sent."""
        self._cut(now_ns)
        super()._unsubscribe(now_ns, address)

    def _spin(self, now_ns: int, hz: float | None = None, rate_hz: int | None = None) -> None:
        """Another controlled speed or rate of samples, from the next turn on."""
        self._hz = self._hz if hz is None else hz
        self._change(now_ns)
        turns = self._turns
        at_ns = now_ns
        if self._hosts and not self._stalled:
            turns = replace(turns, since=turns.sample(self._next))
            at_ns = max(now_ns, turns.samples.at(turns.since))
        samples = turns.samples
        if rate_hz is not None:
            self._rate_hz = rate_hz
            index = max(turns.since, samples.first_from(at_ns))
            samples = samples.going_on(index, Fraction(SECOND_NS, rate_hz))
        rotor = turns.rotor.driven(at_ns, self._hz * self._factor)
        self._turns = replace(turns, rotor=rotor, samples=samples)

    def _change(self, now_ns: int, period_ns: Fraction | None = None) -> None:
        self._withdraw(now_ns, lambda sent: True)
        self._wanted.renew()
        self._stream += 1
        self._next = self._turns.first_from(now_ns)

    def _stall(self, now_ns: int, stands: bool) -> None:
        """The rotor is blocked, or free again."""
        if stands == self._stalled:
            return
        self._stalled = stands
        if not self._running:
            return
        self._change(now_ns)
        if stands:
            self._cut(now_ns)
            return
        self._start_motor(now_ns)
        if self._hosts:
            self._begin(self._speed_ns)

    def _set_factor(self, now_ns: int, factor: float) -> None:
        self._factor = round(factor * SHARES) / SHARES
        if self._running:
            self._spin(now_ns)

    def _block(self, now_ns: int, blocked: bool) -> bool:
        self._stall(now_ns, blocked)
        return True

    # sweeps

    def next_plan(self) -> ScanPlan | None:
        """The next turn; None while the rotor stands or no host listens."""
        return None if self._stalled else super().next_plan()

    def _samples(self, number: int) -> Samples:
        """The samples of a turn."""
        turns = self._turns
        if self._cache is None or self._cache[:2] != (number, turns):
            self._cache = (number, turns, self._fallen_into(number))
        return self._cache[2]

    def _fallen_into(self, number: int) -> Samples:
        turns = self._turns
        first, period_s = turns.sample(number), float(turns.samples.period_ns) / SECOND_NS
        after_s, turned = turns.turned(number)
        hz = turns.rotor.speed_hz(turns.at(number))
        whole = bool(turned[0] - number < hz * period_s * self.GROUP)
        return Samples(first, 360.0 * (turned - number), after_s, hz, whole, len(after_s) * period_s)

    def _sweep(self, number: int) -> Sweep:
        return self._sweep_of(self._samples(number))
