"""A Hesai between requests: power, standby, faults, where its packets, GPS packets and fault messages go, and when.

Belongs here: what changes with time. Not: what a request says (commands), a slice's firings (slices), bytes (codec).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from fractions import Fraction

import numpy as np

from protocols.device_clock import DeviceStamp
from protocols.hesai import codec
from protocols.hesai.models import Model
from protocols.hesai.motor import Rotor, Source
from protocols.hesai.settings import SLICE_NS, Build, Settings
from protocols.hesai.slices import Slice, Slices, words
from protocols.scan import Floats, Scan
from protocols.session import Address, Emission
from protocols.skeleton import nmea
from protocols.skeleton.instants import SECOND_NS, earliest
from protocols.skeleton.outbox import Outgoing
from protocols.skeleton.packets import MOST_KEPT, PacketSession
from protocols.skeleton.sweeps import SHARES, Telegram

TICK_NS = Fraction(1000)
SPEED_RAMP_NS, STOP_NS, BACK_NS = 5 * SECOND_NS, 5 * SECOND_NS, 10 * SECOND_NS
"From speed to speed, into standby and out of it: guesses of the specification."
FAULT_NS = 100_000_000
"From fault message to fault message; a guess too."
CLOSE_NS = 100_000_000
"From the reply to a reboot until connections are closed."
HOT_NS = 60 * SECOND_NS
"From the flag of high temperature until it stops."
SLOWEST_HZ = 4.0
"A turn takes no longer than that while it fires."
DIRTY, BLOCKED = 0.9, 0.5
"Transmission of the window below which it is reported as dirty, and as blocked; ours."
NORMAL, WARNING, DEGRADED, TO_STOP, UNTRUSTED = 1, 2, 4, 5, 6
"States of functional safety."
CODE_WINDOW, CODE_HOT, CODE_MOTOR = 0x0101, 0x0201, 0x0301
"Fault codes; the maker's list is not public, these are ours."


class HesaiDevice(PacketSession[Slice]):
    """The device without its requests."""

    FORESEES = True
    clock_tick_ns = TICK_NS
    clock_bits = 63
    first_count = 1
    count_bits = 32

    def __init__(self, model: Model, settings: Settings, build: Build) -> None:
        self.model, self.settings, self.build = model, settings, build
        self._used = settings
        "Slices are those of these settings."
        self.source = Source(build.utc_ns, build.ptp, build.pps, build.nmea, settings.by_ptp)
        super().__init__(build.boot_ns, self._slice_ns)
        self.rotor = Rotor(0)
        self.power_ons = 0
        self.on_ns = 0
        "When it was switched on, or has restarted."
        self._spin_up_ns = build.spin_up_ns
        self._factor = 1.0
        "Of the motor's speed over that set."
        self._sends = False
        "It sends a point cloud, if there is anybody to send it to."
        self._renew_ns: int | None = None
        "When changed settings take effect, or it begins to fire: a slice."
        self._ready_at_ns = 0
        "When it may fire."
        self._pulse_ns: int | None = None
        "Newest full second to which the phase has been held."
        self._sequence = 1
        self._numbered: dict[int, int] = {}
        "Number of the first packet of slices that have been measured."
        self._slices = Slices(model)
        self.calibration = 0
        "1: its file is refused, 2: damaged."
        self.wrong_deg = 0.0
        "Added to elevations in the file."
        self._felt: Callable[[int], tuple[Floats, Floats] | None] = lambda at_ns: None
        self.transmission, self.hot, self._hot_ns, self._hot_over = 1.0, False, 0, False

    # time

    def keep_time(self, true_ns: Callable[[int], int], own_ns: Callable[[int], int]) -> None:
        """Full seconds come at those of the run, not at those of a quartz of its own."""
        self.source.true_ns, self.source.own_ns = true_ns, own_ns

    def reported(self, at_ns: int) -> DeviceStamp:
        """Date and time, as in a packet."""
        shown_ns, since_ns = self.source.shown_ns(self.clock, at_ns)
        return DeviceStamp(at_ns, shown_ns - since_ns, shown_ns // 1000, float(TICK_NS), self.clock_bits)

    def feel(self, motion: Callable[[int], tuple[Floats, Floats]]) -> None:
        """What the inertial unit of 128 lasers feels."""
        self._felt = motion

    @property
    def _packet_ns(self) -> Fraction:
        return self.model.firings(self._used.mode) * self.model.firing_ns(self._used.high)

    @property
    def _packets(self) -> int:
        return self.build.slice_packets or max(2, math.ceil(SLICE_NS / self._packet_ns))

    @property
    def _slice_ns(self) -> Fraction:
        return self._packets * self._packet_ns

    # power

    def power_on(self, now_ns: int) -> None:
        """Settings survive; time, counters and the motor begin again."""
        self._boot_ns, self._spin_up_ns = self.build.boot_ns, self.build.spin_up_ns
        super().power_on(now_ns)

    def _reset(self, now_ns: int) -> None:
        self._outbox.withdraw(lambda sent: sent.emissions[0].label == "data")  # those of a slice that had begun, too
        self.on_ns, self.power_ons = now_ns, self.power_ons + 1
        self._used = self.settings
        self._nominal_ns = self._slice_ns
        self.source.powered_on(now_ns)
        self.rotor = Rotor(now_ns)
        self._listeners, self._renew_ns, self._pulse_ns, self._sends = [], None, None, False
        self._sequence = 1
        self._hot_over = False
        self._hot_ns = now_ns
        self._numbered.clear()
        self._slices.clear()

    def _start(self, now_ns: int) -> None:
        self._wake(now_ns, self._spin_up_ns)
        self._boot_ns, self._spin_up_ns = self.build.boot_ns, self.build.spin_up_ns
        if len(self._links) > 1:
            first_ns = self.source.after(now_ns)
            self._timers.add(first_ns, SECOND_NS, self._tell_gps)
        if len(self._links) > 2 and self.model.layout.fine:
            self._timers.add(now_ns, FAULT_NS, self._tell_fault)

    def _wake(self, now_ns: int, ramp_ns: int) -> None:
        self._ready_at_ns = now_ns + (0 if self.settings.standby else ramp_ns)
        self._drive(now_ns, ramp_ns)
        self._renew_ns = self._ready_at_ns

    def _drive(self, now_ns: int, ramp_ns: int) -> None:
        sign = -1.0 if self.settings.backwards else 1.0
        stands = self.settings.standby or self._hot_over
        self._pulse_ns = None
        self.rotor.drive(now_ns, 0.0 if stands else sign * self._factor * self.settings.rpm / 60.0, ramp_ns)

    def _next_instant(self) -> int | None:
        own = (self._renew_ns, self._overheats_ns) if self._running else ()
        return earliest((super()._next_instant(), *own))

    @property
    def _overheats_ns(self) -> int | None:
        return self._hot_ns + HOT_NS if self.hot and not self._hot_over else None

    def _happen(self, now_ns: int) -> None:
        if self._running and self._renew_ns is not None and self._renew_ns <= now_ns:
            self._renew(now_ns)
        elif self._running and self._overheats_ns is not None and self._overheats_ns <= now_ns:
            self._hot_over = True
            self.change(now_ns, self.settings, STOP_NS)
        else:
            super()._happen(now_ns)

    def change(self, now_ns: int, settings: Settings, ramp_ns: int = SPEED_RAMP_NS) -> None:
        """Other settings: they take effect with the next slice, the motor's at once."""
        before, self.settings = self.settings, settings
        self.source.switch(now_ns, by_ptp=settings.by_ptp)
        if not self._running:
            return
        if before.standby and not settings.standby:
            self._wake(now_ns, BACK_NS)
            return
        if settings.standby and not before.standby:
            self._drive(now_ns, STOP_NS)
        elif (before.rpm, before.backwards) != (settings.rpm, settings.backwards) or before == settings:
            self._drive(now_ns, ramp_ns)
        elif (before.sync, before.sync_deg) != (settings.sync, settings.sync_deg) and self.rotor.is_steady(now_ns):
            self._drive(now_ns, 0)
        self._renew_ns = max(self._ready_at_ns, self._raster.at(self._raster.first_from(now_ns + 1)))

    def _restart(self, at_ns: int) -> None:
        super()._restart(at_ns + CLOSE_NS)

    def quick_restart(self) -> None:
        """The next restart takes five seconds."""
        self._boot_ns = min(self.build.boot_ns, SECOND_NS)
        self._spin_up_ns = min(self.build.spin_up_ns, 4 * SECOND_NS)

    @property
    def fires(self) -> bool:
        """Whether it is to send a point cloud."""
        return not (self._used.standby or self._hot_over or self._factor == 0.0)

    def _renew(self, now_ns: int) -> None:
        """From here on slices are those of the present settings, or there are none."""
        self._used, self._renew_ns = self.settings, None
        self._made.clear()
        self._slices.clear()
        for address in list(self._hosts):
            self._unsubscribe(now_ns, address)
        self._change(now_ns, self._slice_ns)
        later = [number for number in self._numbered if number >= self._next]  # measured, and withdrawn
        self._sequence = self._numbered[min(later)] if later else self._sequence
        self._numbered = {number: first for number, first in self._numbered.items() if number < self._next}
        self._sends = self.fires
        for address in self._targets if self._sends else ():
            self._subscribe(now_ns, address)

    def _withdraw(self, now_ns: int, whose: Callable[[Outgoing], bool]) -> None:
        """Only slices that are still to begin: of the last one packets may leave a little later than it ends."""
        first = self._raster.first_from(now_ns)
        super()._withdraw(now_ns, lambda sent: (sent.emissions[0].sweep or 0) >= first and whose(sent))

    # where packets go

    @property
    def _targets(self) -> list[Address]:
        return self._links[:1] + self._listeners

    def _place(self, settings: Settings, which: int) -> tuple[str, int] | None:
        """Where a host has sent the point cloud (1) or GPS packets (2) to; None: where the link says."""
        there = settings.destination
        return None if there is None else (there[0], int(there[which]))

    def _goes_to(self, to: Address | None) -> tuple[str, int] | None:
        return None if to in self._listeners else self._place(self._used, 1)

    def _sending(self) -> bool:
        return self._sends

    # faults

    def impair(self, now_ns: int, what: str, degree: float) -> bool:
        """Motor, window, temperature, and what it hears of PTP and GPS."""
        self.advance(now_ns)
        if what == "no pps":
            self.source.switch(now_ns, pps=degree == 0.0 and self.build.pps)
        elif what == "no ptp":
            self.source.switch(now_ns, ptp=degree == 0.0 and self.build.ptp)
        elif what == "window":
            self.transmission = degree
        elif what == "heat":
            self.hot, self._hot_ns = degree != 0.0, now_ns
            if not self.hot and self._hot_over:
                self._hot_over = False
                if self._running:
                    self._wake(now_ns, BACK_NS)
        elif what in ("motor speed", "motor stopped"):
            stopped = what == "motor stopped"
            self._factor = float(degree == 0.0) if stopped else round(degree * SHARES) / SHARES
            self.change(now_ns, self.settings, 0)
        else:
            return False
        return True

    @property
    def dirt(self) -> int:
        """Of the window: 0 clean, 1 passable, 3 blocked."""
        return 3 if self.transmission < BLOCKED else int(self.transmission < DIRTY)

    @property
    def health(self) -> tuple[int, tuple[int, ...]]:
        """State of functional safety, and fault codes."""
        found = [(WARNING, CODE_WINDOW)] if self.dirt == 1 else [(DEGRADED, CODE_WINDOW)] if self.dirt else []
        found += [(TO_STOP, CODE_HOT)] if self.hot else []
        found += [(UNTRUSTED, CODE_MOTOR)] if abs(self._factor - 1.0) > 0.1 else []
        return max((one[0] for one in found), default=NORMAL), tuple(one[1] for one in found)

    # slices

    def _make(self, number: int) -> Slice:
        self._hold_phase(self._raster.at(number + 1))
        return self._slices.make(number, self._raster, self._packets, self._used, self.rotor)

    def _hold_phase(self, until_ns: int) -> None:
        """Corrections of the phase at the full seconds before an instant."""
        if not self._used.sync or not self.source.there:
            return
        pulse_ns = self.source.after(self._now_ns if self._pulse_ns is None else self._pulse_ns)
        while pulse_ns < until_ns:
            hz = self._factor * self._used.rpm / 60.0 * (-1.0 if self._used.backwards else 1.0)
            if self.source.locked(pulse_ns) and self.rotor.is_steady(pulse_ns) and hz:
                self.rotor.correct(pulse_ns, hz, self._used.sync_deg / 360.0)
            self._pulse_ns = pulse_ns
            pulse_ns = self.source.after(pulse_ns)

    def _is_settled(self, number: int) -> bool:
        if not self._used.sync or not self.source.there:
            return True
        partial = not self._used.sees_all or self.model.calibrated == "at128"
        further = math.ceil(SECOND_NS / SLOWEST_HZ / self._raster.period_ns) if partial else 0
        pulse_ns = self.source.after(self._now_ns if self._pulse_ns is None else self._pulse_ns)
        return pulse_ns >= self._raster.at(number + further + 1)

    # packets

    def _telegrams(self, scan: Scan) -> Iterator[Telegram]:
        piece, model, used = self._slice(scan.plan.sweep), self.model, self._used
        distance, reflectivity = words(scan, piece, model, used.mode)
        safe = "safety" in model.layout.places
        if used.blockage and model.number == 42:
            silent = (distance == 0) & np.repeat(piece.fires.reshape(*piece.sees.shape, -1), self._echoes, axis=1)
            distance[silent] = codec.BLOCKED if self.dirt > 1 else codec.NOTHING
        if safe and self.health[0] >= UNTRUSTED:
            distance[:], reflectivity[:] = 0, 0
        sent = np.flatnonzero(piece.sees.any(axis=1))
        block_ns = piece.block_ns[sent]
        stamp_ns = np.rint(block_ns[:, 0 if model.stamps_first else -1] - model.stamp_ns).astype(np.int64)
        reported = [self.reported(int(at)) for at in stamp_ns]
        while len(self._numbered) >= MOST_KEPT:
            self._numbered.pop(next(iter(self._numbered)))
        self._numbered[scan.plan.sweep] = self._sequence
        packets = codec.encode(
            model,
            codec.Packets(
                np.repeat(piece.angle[sent], self._echoes, axis=1),
                distance[sent],
                reflectivity[sent],
                np.array([1000 * one.ticks for one in reported], np.int64),
                self._sequence + np.arange(len(sent)),
                used.mode,
                self.speed_rpm(scan.plan.start_ns),
                np.repeat(piece.states[sent], self._echoes, axis=1),
                0 if used.high else 2,
                codec.safety(stamp_ns, *self.health) if safe else None,
                felt=self._felt(scan.plan.start_ns) if safe else None,
                felt_ns=1000 * reported[0].ticks if reported else 0,
                shutdown=self.hot,
                signed=self.build.signed,
                fourth=63 if model.layout.fine else 0xFF,
            ),
        )
        self._sequence += len(sent)
        done_ns = np.nanmax(model.instants(used.high)) + block_ns[:, -1]
        done_ns = np.maximum(done_ns, stamp_ns).astype(np.int64) - scan.plan.start_ns
        for at, packet in enumerate(packets):
            yield Telegram(int(done_ns[at]), packet, "data", reported[at])

    @property
    def _echoes(self) -> int:
        return self.model.returns(self._used.mode)[2]

    def speed_rpm(self, at_ns: int) -> int:
        """Of the motor, measured; backwards it is below 0 on an AT128."""
        rpm = round(60.0 * self.rotor.speed_hz(at_ns))
        return rpm if self.model.layout.fine else abs(rpm)

    # what is sent besides

    def sentence(self, now_ns: int) -> bytes:
        """$GPRMC or $GPGGA of the second; empty without a receiver."""
        if not self.source.nmea:
            return b""
        form = nmea.gpgga if self.build.gpgga else nmea.gprmc
        return form(self.source.utc(now_ns) // SECOND_NS * SECOND_NS, *self.build.place_deg)

    def _tell_gps(self, now_ns: int) -> None:
        if self.settings.by_ptp:
            return
        shown_ns = 1000 * self.reported(now_ns).ticks
        good = b"1" if self.build.gpgga else b"A"
        wide, status = self.model.number in (25, 38), good if self.source.nmea else b"\0"
        us = 0 if wide else shown_ns // 1000 % 1_000_000
        payload = codec.encode_gps(
            shown_ns, us, self.sentence(now_ns), status, self.source.pps and self.source.locked(now_ns), wide
        )
        place = self._place(self.settings, 2)
        self._outbox.send(Emission(now_ns, payload, self._links[1], label="gps", place=place))

    def _tell_fault(self, now_ns: int) -> None:
        state, codes = self.health
        operate = 4 if self._used.standby else 5 if self._hot_over else 2
        payload = codec.encode_fault(
            1000 * self.reported(now_ns).ticks, operate, state, codes, now_ns // FAULT_NS,
            self.dirt, self.hot,
        )  # fmt: skip
        self._outbox.send(Emission(now_ns, payload, self._links[2], label="fault"))
