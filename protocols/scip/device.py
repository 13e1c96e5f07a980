"""A SCIP device between commands: motor, laser, measurements under way, and the sweeps and blocks that follow.

Belongs here: states and times. Not: what a command says (commands), how values are written (codec).
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass
from fractions import Fraction

import numpy as np

from protocols.scan import Scan, ScanPlan
from protocols.scip import codec
from protocols.scip.codec import Form
from protocols.scip.models import Model
from protocols.scip.settings import Settings
from protocols.session import Address, DropReason, Emission
from protocols.skeleton.instants import SECOND_NS, Raster
from protocols.skeleton.one_client import OneClientSession
from protocols.skeleton.outbox import Outgoing
from protocols.skeleton.receiving import Fault
from protocols.skeleton.serial_lines import SerialLines
from protocols.skeleton.sweeps import SHARES, Sweep, Telegram

MOST_ECHOES = 3
TICK_NS = Fraction(1_000_000)
STAMP_BITS = 24
EVALUATION_NS = 500_000
"From the last step of a sweep to the first byte of its block."
VERIFY_NS = 2 * SECOND_NS
"A motor that is not at speed again by then is a fault."
SPEED_TOLERANCE = 0.1
"Of the motor; beyond it no scan is sent."
UNSTABLE = {"SCIP 2.0": "21", "SCIP 2.2": "0M"}
RESUMED = "98"
SCIP1_LAST = 768
"G of SCIP 1.1 also has steps outside of the field, without valid values (Player's urglaser asks for 0 to 768)."


@dataclass(eq=False)
class Job:
    """A measuring command that is carried out."""

    address: Address | None
    head: bytes
    "Command up to the count."
    tail: bytes
    "Behind the count: `;` and the host's text."
    form: Form
    first: int
    last: int
    cluster: int
    skip: int
    left: int | None
    "Scans still to be sent; None: until stopped."
    since_ns: int
    continuous: bool
    scip1: bool = False
    due_turn: int = 0
    "It takes no scan before this turn of the motor."
    over_ns: int = 0
    "When its last block is due."

    @property
    def wants(self) -> bool:
        """Whether it needs more scans."""
        return self.left is None or self.left > 0


@dataclass(eq=False)
class Block(Outgoing):
    """A scan on its way to a host."""

    job: Job | None = None
    turn: int = 0
    "Of the motor, in which the scan was measured."


class ScipDevice(OneClientSession):
    """The device without its commands."""

    clock_tick_ns = TICK_NS
    clock_bits = STAMP_BITS

    def __init__(self, model: Model, settings: Settings) -> None:
        self.model, self.settings = model, settings
        self.period_ns = model.period_ms * 1_000_000
        # hokuyolx, reboot(): a device of SCIP 2.2 waits until its speed is stable, then it is in standby
        boots_turning = model.protocol != "SCIP 2.0"
        super().__init__(max(settings.boot_ns, settings.spin_up_ns * boots_turning), self.period_ns)
        self.REPLY_NS = settings.reply_ns  # type: ignore[misc]
        self.steps = np.arange(model.first, model.last + 1)
        self._azimuth_rad = np.asarray((self.steps - model.front) * (2.0 * math.pi / model.steps), np.float64)
        self.jobs: list[Job] = []
        self.laser = self.scip1 = self.in_time_mode = self.sleeps = self.faulty = False
        self.baud = settings.baud
        self.gain = 1.0
        self.slower = 0
        "Steps of `CR` below the nominal speed."
        self.reboot_ns: int | None = None
        "When the first `RB` came."
        self._mirror = Raster(0, self.period_ns)
        "Turns of the motor; sweeps are every (skip + 1)-th of them."
        self._speed_ns = 0
        "When the motor is at speed."
        self._lit_ns = 0
        "When the laser can measure."
        self._verifying = self._timers.alarm(self.fail)
        "Set while the motor is not at speed and may come back to it."
        self._factor, self._blocked = 1.0, False
        "Faults of the motor: on its speed, and whether it stands."
        self._lines = SerialLines()

    # states

    def is_stable(self, now_ns: int) -> bool:
        """Whether the motor is at speed."""
        return now_ns >= self._speed_ns and not self._verifies and not self.sleeps

    def state(self, now_ns: int) -> tuple[str, str]:
        """Code and name, as %ST and MESM have them (hokuyolx, statuses.py)."""
        if self.faulty:
            return "900", "Error detected"
        if self.sleeps:
            return "005", "Sleep"
        self.jobs = [job for job in self.jobs if job.wants or job.over_ns > now_ns]
        if self.in_time_mode:
            code, name = 2, "Time adjustment"
        elif any(job.continuous for job in self.jobs):
            code, name = 4, "Multi scan"
        else:
            code, name = (3, "Single scan") if self.laser else (0, "Idle")
        return f"{code + (0 if self.is_stable(now_ns) else 100):03d}", name

    def _reset(self, now_ns: int) -> None:
        if self.settings.port == "rs232":
            self._outbox.send(Emission(now_ns, b"", line_speed=self.settings.baud, label="power-on"))
        self.scip1, self.faulty = self.settings.scip1, self.settings.faulty
        self.baud, self.gain, self.slower, self.reboot_ns = self.settings.baud, 1.0, 0, None
        self.laser = self.scip1  # SCIP 1.1 begins with the laser on
        self.in_time_mode = self.sleeps = False
        self.jobs.clear()
        self._lines = SerialLines()
        self._lit_ns, self._speed_ns = now_ns, now_ns + self.settings.spin_up_ns
        self._mirror = Raster(now_ns, self._turn_ns())

    def _turn_ns(self) -> Fraction:
        return self.period_ns * 100 / (100 - self.slower) * self._slowed

    def _start(self, now_ns: int) -> None:
        self._mirror = Raster(now_ns, self._turn_ns())
        self._monitor(now_ns)
        super()._start(now_ns)

    # measurements

    def begin(self, job: Job) -> None:
        """Carry out a measuring command; one that runs until stopped replaces another."""
        if job.continuous:
            self._drop([one for one in self.jobs if one.continuous], job.since_ns)
        self.light(job.since_ns)
        self.jobs.append(job)
        self._renew(job.since_ns)

    def light(self, now_ns: int) -> None:
        """The laser is on."""
        if not self.laser:
            self.laser, self._lit_ns = True, now_ns + self.settings.laser_on_ns

    def stop(self, now_ns: int) -> None:
        """End all measurements; the laser is off."""
        self._drop(self.jobs, now_ns)
        self.laser = False

    def turn_at(self, now_ns: int, slower: int) -> None:
        """Another speed of the motor."""
        self.slower = slower
        self._mirror = self._mirror.going_on(self._mirror.first_from(now_ns), self._turn_ns())
        self._renew(now_ns)

    def sleep(self, now_ns: int) -> None:
        """The motor stops."""
        self.stop(now_ns)
        self.sleeps = True

    def wake(self, now_ns: int) -> None:
        """The motor starts again."""
        if self.sleeps:
            self.sleeps, self._speed_ns = False, now_ns + self.settings.spin_up_ns

    def fail(self, now_ns: int) -> None:
        """A fault: laser off, running measurements end with its status."""
        self._notify(now_ns, self.model.errors["abnormal"])
        self.stop(now_ns)
        self.faulty, self._verifying.at_ns = True, None

    def _drop(self, jobs: list[Job], now_ns: int) -> None:
        gone = set(map(id, jobs))
        self._withdraw(now_ns, lambda block: isinstance(block, Block) and id(block.job) in gone)
        self.jobs = [job for job in self.jobs if id(job) not in gone]
        self._subscribe_jobs()

    def _unsubscribe(self, now_ns: int, address: Address | None) -> None:
        self._drop([job for job in self.jobs if job.address == address], now_ns)

    def _subscribe_jobs(self) -> None:
        self._hosts = {job.address: job.since_ns for job in self.jobs if job.wants and not self._verifies}
        if not self._hosts:
            self._wanted.renew()

    def _withdrawn(self, sent: Outgoing) -> None:
        if isinstance(sent, Block) and sent.job is not None:
            sent.job.left = None if sent.job.left is None else sent.job.left + 1
            sent.job.due_turn = min(sent.job.due_turn, sent.turn)

    def _renew(self, now_ns: int) -> None:
        """A new stream of sweeps, for the jobs that there are now; sweeps that have begun are still sent."""
        self._withdraw(now_ns, lambda block: block.emissions[0].due_ns - self._after_ns() >= now_ns)
        self._wanted.renew()
        self._stream += 1
        self._pace(self._mirror.first_from(max(now_ns, self._lit_ns, self._speed_ns)))
        self._subscribe_jobs()

    def _pace(self, first: int) -> None:
        """Sweep from turn `first` on, as often as the measurement that skips the fewest turns takes a scan."""
        first = max(first, min((job.due_turn for job in self.jobs if job.wants), default=first))
        self._raster = Raster(self._mirror.at(first), self._mirror.period_ns * self._stride(), self._next)

    def _stride(self) -> int:
        return 1 + min((job.skip for job in self.jobs if job.wants), default=0)

    def _after_ns(self) -> int:
        """From the start of a sweep to its block."""
        return math.ceil(self._turn_ns() * self.model.last / self.model.steps) + EVALUATION_NS

    def _sweep(self, number: int) -> Sweep:
        turn_s = 1e-9 * float(self._turn_ns() / self._slowed)
        jobs = [job for job in self.jobs if job.wants]
        offset_s = np.asarray(self.steps * (turn_s / self.model.steps), np.float64)
        return Sweep(
            azimuth_rad=self._azimuth_rad,
            elevation_rad=np.zeros(len(self.steps)),
            fire_offset_s=offset_s,
            duration_s=turn_s * self.model.last / self.model.steps,
            max_range_m=self.model.most_mm / 1000.0,
            max_echoes=max((job.form.echoes for job in jobs), default=1),
            gain=self.gain,
            wants_intensity=any(job.form.intensity for job in jobs),
        )

    def _telegrams(self, scan: Scan) -> list[Telegram]:
        return []  # each measurement has its own: `submit`

    def next_plan(self) -> ScanPlan | None:
        """The next sweep, the same until its scan is submitted; None while nothing is measured."""
        return None if self.faulty or self.sleeps or self._verifies else super().next_plan()

    def submit(self, scan: Scan) -> None:
        """Take the scan of `next_plan`; `ScanRefused` for any other."""
        self._accepted(scan)
        plan = scan.plan
        numbers = range(plan.sweep, plan.sweep + 1)
        stride = self._stride()
        turn = self._mirror.first_from(plan.start_ns - int(self._mirror.period_ns) // 2)
        takers = [job for job in self.jobs if job.wants and job.since_ns <= plan.start_ns and job.due_turn <= turn]
        if not takers:
            self._events.unsent(self._now_ns, DropReason.STALE, numbers, "no measurement", plan.stream)
            return
        values = codec.words_of(scan, self.model.limits)
        due_ns = plan.start_ns + self._after_ns()
        carried: set[Address | None] = set()
        for job in takers:
            job.due_turn = turn + 1 + job.skip
            if job.continuous and not self._lines.is_free(job.address, due_ns):
                self._events.unsent(self._now_ns, DropReason.LINE_BUSY, numbers, "", plan.stream, job.address)
                continue
            sweep = None if job.address in carried else plan.sweep
            carried.add(job.address)
            job.left = None if job.left is None else job.left - 1
            job.over_ns = due_ns
            stamp = self.clock.reported(plan.start_ns, TICK_NS, STAMP_BITS)
            data = self.scan_block(job, stamp.ticks, *values)
            emission = Emission(
                due_ns, data, job.address, sweep, None, job.head[:2].decode(), stamp, int(sweep is not None)
            )
            self._outbox.put(Block(job.address, deque((emission,)), is_scan=True, job=job, turn=turn))
            if self.settings.port == "rs232":
                self._lines.occupy(job.address, due_ns, len(data), self.baud)
        if self._stride() != stride:  # the measurements that are left skip more turns
            self._pace(turn + 1)
        self._subscribe_jobs()

    def scan_block(self, job: Job, ticks: int, distance: codec.Words, strength: codec.Words) -> bytes:
        """The block of one scan."""
        first, last, most = job.first - self.model.first, job.last - self.model.first, len(distance)
        if first < 0 or last >= most:  # SCIP 1.1 alone: steps outside of the field are not valid
            around = ((max(0, -first), max(0, last + 1 - most)), (0, 0))
            distance, strength = np.pad(distance, around), np.pad(strength, around)
            first, last = max(0, first), last - min(0, first)
        part = slice(first, last + 1)
        values = codec.merged(distance[part], strength[part], job.cluster, self.model.least_mm)
        data = codec.encode_values(*values, job.form)
        if job.scip1:
            return job.head + b"\n0\n" + codec.blocks(data, sums=False) + b"\n"
        stamp = codec.summed(codec.encode_number(ticks, codec.STAMP_CHARS))
        if not job.continuous:
            return job.head + job.tail + b"\n" + codec.summed(b"00") + stamp + codec.blocks(data) + b"\n"
        return self._head(job) + codec.summed(b"99") + stamp + codec.blocks(data) + b"\n"

    def _head(self, job: Job) -> bytes:
        """The echo before a block of a stream, with the number of scans still to come."""
        return job.head + b"%02d" % (job.left or 0) + job.tail + b"\n"

    def _notify(self, now_ns: int, status: str) -> None:
        """A block without data for each measurement."""
        for job in [job for job in self.jobs if job.wants]:
            head = self._head(job) if job.continuous else job.head + job.tail + b"\n"
            said = job.head + b"\nE\n\n" if job.scip1 else head + codec.summed(status.encode()) + b"\n"
            self._outbox.send(Emission(now_ns + self.REPLY_NS, said, job.address, label=status))

    # the motor

    @property
    def _verifies(self) -> bool:
        return self._verifying.at_ns is not None

    def _set_factor(self, now_ns: int, factor: float) -> None:
        self._factor, self._slowed = factor, 1 / Fraction(round(factor * SHARES), SHARES)
        self.turn_at(now_ns, self.slower)
        self._monitor(now_ns)

    def _block(self, now_ns: int, blocked: bool) -> bool:
        self._blocked = blocked
        self._monitor(now_ns)
        return True

    def _monitor(self, now_ns: int) -> None:
        right = not self._blocked and abs(self._factor - 1.0) <= SPEED_TOLERANCE
        if not self._running or self.faulty or right != self._verifies:
            return
        if right:
            self._verifying.at_ns = None
            if self.model.protocol == "SCIP 2.0":
                self._notify(now_ns, RESUMED)
            self._renew(now_ns)
            return
        self._withdraw(now_ns, lambda block: True)
        self._notify(now_ns, UNSTABLE[self.model.protocol])
        self._verifying.at_ns = now_ns + VERIFY_NS
        self._subscribe_jobs()

    def other_speed(self, baud: int, sent: bytes, now_ns: int, address: Address) -> None:
        """Framing errors: the line that was being received is given up, so that the next one is understood."""
        for fault in self._connections.of(address).receiver.end():
            if isinstance(fault, Fault):
                self._events.drop(now_ns, fault.reason, "framing errors", fault.count)
