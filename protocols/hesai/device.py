"""A Hesai between requests: slices of its turn, the packets that they leave in, GPS packets, fault messages, standby.

A slice is a few packets: it is measured as a whole, and its packets leave each at its own instant. Belongs here: what
fires when, and where packets go. Not: what a request says (commands), bytes (codec).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from fractions import Fraction

import numpy as np
from numpy.typing import NDArray

from protocols.device_clock import DeviceStamp
from protocols.hesai import calibration, codec
from protocols.hesai.models import Model
from protocols.hesai.motor import NEAR, Rotor, Source
from protocols.hesai.settings import SLICE_NS, Build, Settings
from protocols.scan import Floats, Scan
from protocols.session import Address, DropReason, Emission, LinkKind
from protocols.skeleton.instants import SECOND_NS, earliest
from protocols.skeleton.outbox import Outgoing
from protocols.skeleton.requests import RequestSession
from protocols.skeleton.sweeps import SHARES, SLICES_KEPT, Sweep, Telegram

TICK_NS = Fraction(1000)
SPEED_RAMP_NS, STOP_NS, BACK_NS = 5 * SECOND_NS, 5 * SECOND_NS, 10 * SECOND_NS
"From speed to speed, into standby and out of it: guesses of the specification."
FAULT_NS = 100_000_000
"From fault message to fault message; a guess too."
HOT_NS = 60 * SECOND_NS
"From the flag of high temperature until it stops."
MOST_ECHOES = 4
"Of a beam, out of which the returns are chosen."
NEXT_STEP = 0.8
"Of a step: so far the grid may be from where it would be nearest."
MOST_KEPT = 1000
"Slices outside of the range that are skipped at once; a turn has less."
SLOWEST_HZ = 4.0
"A turn takes no longer than that while it fires."
DIRTY, BLOCKED = 0.9, 0.5
"Transmission of the window below which it is reported as dirty, and as blocked; ours."
NORMAL, WARNING, DEGRADED, UNTRUSTED = 1, 2, 4, 6
"States of functional safety."
CODE_WINDOW, CODE_HOT, CODE_MOTOR = 0x0101, 0x0201, 0x0301
"Fault codes; the maker's list is not public, these are ours."


@dataclass(frozen=True, eq=False)
class Slice:
    """What a slice measures; F firings of L lasers."""

    block_ns: NDArray[np.int64]
    "(F,) instant of each firing's block."
    angle: codec.Words
    "(F,) of the rotor or the encoder then, 1/256 of 0.01 deg."
    sees: NDArray[np.bool_]
    "(F,) whether it is in the range."
    fires: NDArray[np.bool_]
    "(F, L)"
    states: codec.Words
    "(F,)"
    sweep: Sweep


class HesaiDevice(RequestSession):
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
        self._links: list[Address] = []
        "Datagram links: point cloud, GPS packets, fault messages."
        self._listeners: list[Address] = []
        "Where the point cloud goes besides: hosts that asked on a connection."
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
        self._made: dict[tuple[int, int], Slice] = {}
        self._grid: dict[int, int] = {}
        "Step of the first firing of slices, where the angle triggers."
        self.calibration = 0
        "1: its file is refused, 2: damaged."
        self.transmission, self.hot, self._hot_ns, self._hot_over = 1.0, False, 0, False

    # time

    def keep_time(self, true_ns: Callable[[int], int], own_ns: Callable[[int], int]) -> None:
        """Full seconds come at those of the run, not at those of a quartz of its own."""
        self.source.true_ns, self.source.own_ns = true_ns, own_ns

    def reported(self, at_ns: int) -> DeviceStamp:
        """Date and time, as in a packet."""
        shown_ns, since_ns = self.source.shown_ns(self.clock, at_ns)
        return DeviceStamp(at_ns, shown_ns - since_ns, shown_ns // 1000, float(TICK_NS), self.clock_bits)

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

    def connected(self, now_ns: int, address: Address, kind: LinkKind) -> None:
        """A link is open, or a client has connected."""
        super().connected(now_ns, address, kind)
        if kind is LinkKind.DATAGRAM and address not in self._links:
            self._links.append(address)

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
        self._made.clear()
        self._grid.clear()

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
        self._grid.clear()
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

    def listen(self, now_ns: int, address: Address) -> None:
        """Send the point cloud on a connection too."""
        if address not in self._listeners:
            self._listeners.append(address)
            if self._sends:
                self._subscribe(now_ns, address)

    def disconnected(self, now_ns: int, address: Address) -> None:
        """A client has disconnected."""
        super().disconnected(now_ns, address)
        self._listeners = [one for one in self._listeners if one != address]

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
        found += [(WARNING, CODE_HOT)] if self.hot else []
        found += [(UNTRUSTED, CODE_MOTOR)] if abs(self._factor - 1.0) > 0.1 else []
        return max((one[0] for one in found), default=NORMAL), tuple(one[1] for one in found)

    # slices

    def _slice(self, number: int) -> Slice:
        key = self._stream, number
        if (made := self._made.get(key)) is None:
            while len(self._made) >= SLICES_KEPT:
                self._made.pop(next(iter(self._made)))
            made = self._made[key] = self._make(number)
        return made

    def _make(self, number: int) -> Slice:
        model, settings = self.model, self._used
        start_ns, period = self._raster.at(number), model.firing_ns(settings.high)
        count = self._packets * model.firings(settings.mode)
        self._hold_phase(start_ns + round(self._raster.period_ns))
        lead_ns = model.lead_ns + int(period / 2) + 1
        block_ns = start_ns + lead_ns + np.rint(np.arange(count) * float(period)).astype(np.int64)
        block_ns, turns = self._triggered(number, block_ns, float(period))
        angle = np.rint(codec.FINE * codec.TURN_CDEG * turns).astype(np.int64) % (codec.FINE * codec.TURN_CDEG)
        states = model.states(number * count + np.arange(count), settings.high)
        laser_ns = model.instants(settings.high)[states]
        sees = self._seen(angle)
        fires = sees[:, None] & ~np.isnan(laser_ns)
        fire_ns = block_ns[:, None] + np.rint(np.nan_to_num(laser_ns)).astype(np.int64)
        at_turns = self.rotor.turns(fire_ns)
        azimuth, elevation = calibration.directions(model, at_turns, turns[:, None])
        sweep = Sweep(
            azimuth[fires],
            elevation[fires],
            np.asarray(1e-9 * (fire_ns[fires] - start_ns), np.float64),
            1e-9 * (int(self._raster.period_ns) + 2 * lead_ns),
            max_range_m=0xFFFF * model.unit_mm / 1000.0,
            max_echoes=MOST_ECHOES,
            wants_intensity=True,
            turn=self.rotor.turn(start_ns),
        )
        return Slice(block_ns, angle, sees, fires, states, sweep)

    def _triggered(
        self, number: int, block_ns: NDArray[np.int64], period_ns: float
    ) -> tuple[NDArray[np.int64], Floats]:
        """Instants of blocks, and turns of the rotor then: triggered by the angle, on a grid of whole steps."""
        turns, count = self.rotor.turns(block_ns), len(block_ns)
        first_ns, last_ns = int(block_ns[0]), int(block_ns[-1])
        hz = self.rotor.speed_hz(first_ns)
        steady = self.rotor.is_steady(first_ns) and self.rotor.is_steady(last_ns)
        if not self.model.grid or self._used.trigger or not hz or not steady:
            return block_ns, turns
        nominal = math.copysign(self._used.rpm / 60.0, hz)
        step = (nominal if abs(hz / nominal - 1.0) < NEAR else hz) * 1e-9 * period_ns
        at = float(turns[0]) / step
        # on from the slice before, as long as that is near: no doubt where half a step has passed
        place = self._grid[number - 1] + count if number - 1 in self._grid else round(at)
        self._grid[number] = place = place if abs(at - place) < NEXT_STEP else round(at)
        while len(self._grid) > MOST_KEPT:
            self._grid.pop(next(iter(self._grid)))
        on_grid = (place + np.arange(count)) * step
        behind = (on_grid - turns + 0.5) % 1.0 - 0.5  # a knot in the slice: turns are counted anew
        return block_ns + np.rint(1e9 * behind / hz).astype(np.int64), np.asarray(on_grid, np.float64)

    def _seen(self, angle: codec.Words) -> NDArray[np.bool_]:
        """Firings of the range; of an AT128 those within a mirror's window."""
        degrees = angle / (100.0 * codec.FINE)
        if self.model.calibrated == "at128":
            since = np.asarray(calibration.after_start(degrees + 1e-9))
            low, high = calibration.WINDOW_DEG
            return np.asarray((since >= low) & (since < high))
        if self._used.sees_all:
            return np.full(len(angle), True)
        seen = np.full(len(angle), False)
        for first, last in self._used.range_ddeg:
            seen |= (degrees * 10.0 - first) % 3600.0 <= (last - first) % 3600
        return seen

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

    def _sweep(self, number: int) -> Sweep:
        return self._slice(number).sweep

    def _passed_over(self, number: int) -> int:
        passed = 0
        partial = not self._used.sees_all or self.model.calibrated == "at128"
        while partial and passed < MOST_KEPT and not self._slice(number + passed).sees.any():
            passed += 1
        return passed

    # packets

    def _telegrams(self, scan: Scan) -> Iterator[Telegram]:
        piece, model, used = self._slice(scan.plan.sweep), self.model, self._used
        name, _, echoes = model.returns(used.mode)
        range_m, intensity = codec.returns(scan, name, model.swapped)
        words = [codec.distances(range_m, model.unit_mm), codec.reflectivities(range_m, intensity, model.white_m2)]
        if used.blockage and model.number == 42:
            words[0][words[0] == 0] = codec.BLOCKED if self.dirt > 1 else codec.NOTHING
        if self.health[0] >= UNTRUSTED and model.layout.safety is not None:
            words[0][:] = 0
        count, firings, blocks = self._packets, model.firings(used.mode), model.layout.blocks
        fields = []
        for part in words:
            whole = np.zeros((echoes, *piece.fires.shape), np.int64)
            whole[:, piece.fires] = part
            fields.append(np.moveaxis(whole, 0, 1).reshape(count, blocks, model.lasers))
        sent = np.flatnonzero(piece.sees.reshape(count, firings).any(axis=1))
        last = np.arange(count) * firings + (0 if model.stamps_first else firings - 1)
        stamp_ns = np.rint(piece.block_ns[last] - model.stamp_ns).astype(np.int64)[sent]
        reported = [self.reported(int(at)) for at in stamp_ns]
        self._numbered[scan.plan.sweep] = self._sequence
        while len(self._numbered) > MOST_KEPT:
            self._numbered.pop(next(iter(self._numbered)))
        packets = codec.encode(
            model,
            codec.Packets(
                np.repeat(piece.angle.reshape(count, firings), echoes, axis=1)[sent],
                fields[0][sent],
                fields[1][sent],
                np.array([1000 * one.ticks for one in reported], np.int64),
                self._sequence + np.arange(len(sent)),
                used.mode,
                self.speed_rpm(scan.plan.start_ns),
                np.repeat(piece.states.reshape(count, firings), echoes, axis=1)[sent],
                0 if used.high else 2,
                codec.safety(stamp_ns, *self.health) if model.layout.safety is not None else None,
                shutdown=self.hot,
                signed=self.build.signed,
                fourth=63 if model.layout.fine else 0xFF,
            ),
        )
        self._sequence += len(sent)
        done_ns = np.nanmax(model.instants(used.high)) + piece.block_ns.reshape(count, firings)[sent, -1]
        done_ns = np.maximum(done_ns, stamp_ns).astype(np.int64) - scan.plan.start_ns
        for at, packet in enumerate(packets):
            yield Telegram(int(done_ns[at]), packet, "data", reported[at])

    def speed_rpm(self, at_ns: int) -> int:
        """Of the motor, measured; backwards it is below 0 on an AT128."""
        rpm = round(60.0 * self.rotor.speed_hz(at_ns))
        return rpm if self.model.layout.fine else abs(rpm)

    # what is sent besides

    def sentence(self, now_ns: int) -> bytes:
        """$GPRMC of the second; empty without a receiver."""
        if not self.source.nmea:
            return b""
        return codec.gprmc(self.source.utc(now_ns) // SECOND_NS * SECOND_NS, *self.build.place_deg)

    def _tell_gps(self, now_ns: int) -> None:
        if self.settings.by_ptp:
            return
        shown_ns = 1000 * self.reported(now_ns).ticks
        wide, status = self.model.number in (25, 38), b"A" if self.source.nmea else b"\0"
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
            1000 * self.reported(now_ns).ticks, operate, state, codes[0] if codes else 0, now_ns // FAULT_NS,
            self.dirt, self.hot,
        )  # fmt: skip
        self._outbox.send(Emission(now_ns, payload, self._links[2], label="fault"))

    def receive(self, data: bytes, now_ns: int, address: Address | None = None) -> None:
        """Requests come on connections; datagrams are ignored. Never raises."""
        if data and self._connections.kind(address) is LinkKind.DATAGRAM:
            self.advance(now_ns)
            self._events.drop(now_ns, DropReason.UNKNOWN_COMMAND, "it takes no datagrams", len(data))
            return
        super().receive(data, now_ns, address)
