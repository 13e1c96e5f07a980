"""A Velodyne between requests: slices of its turn, the packets that they leave in, the dark ones, position packets.

A slice is a few packets: it is measured as a whole, and its packets leave each at its own instant. Belongs here: what
fires when, and where packets go. Not: what a request says (session), bytes (codec).
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from fractions import Fraction

import numpy as np
from numpy.typing import NDArray

from protocols.device_clock import DeviceStamp
from protocols.scan import Scan
from protocols.session import Address, Emission
from protocols.skeleton.instants import SECOND_NS, earliest
from protocols.skeleton.nmea import gprmc
from protocols.skeleton.outbox import Outgoing
from protocols.skeleton.packets import MOST_ECHOES, PacketSession
from protocols.skeleton.reflectivity import calibrated
from protocols.skeleton.sweeps import SHARES, Sweep, Telegram
from protocols.velodyne import codec
from protocols.velodyne.models import Model
from protocols.velodyne.motor import LOCKED_TURNS, SAFE_HZ, Gps, Motor
from protocols.velodyne.settings import SLICE_NS, Build, Settings

TICK_NS = Fraction(1000)
POSITION_NS = 293 * 1_327_104 // 57
"From position packet to position packet: 57 for 293 data packets in a public capture of a VLP-16 (MRPT)."


@dataclass(frozen=True, eq=False)
class Slice:
    """What a slice measures; F firings of L lasers."""

    heads_cdeg: codec.Words
    "(F,) azimuth of the head when a firing begins."
    sees: NDArray[np.bool_]
    "(F,) whether it is in the field of view."
    sweep: Sweep


class VelodyneDevice(PacketSession[Slice]):
    """The device without its requests."""

    FORESEES = True
    clock_tick_ns = TICK_NS
    clock_bits = 32

    def __init__(self, model: Model, settings: Settings, build: Build) -> None:
        self.model, self.settings, self.build = model, settings, build
        "As set; slices are those of `_used`."
        self.saved = self._used = settings
        self.gps = Gps(build.utc_ns, build.pps, build.nmea)
        super().__init__(build.boot_ns, self._slice_ns)
        self.motor = Motor(0, settings.rpm / 60.0, 0)
        self._factor = 1.0
        "Of the motor's speed over that set."
        self._renew_ns: int | None = None
        "When changed settings take effect: the next slice."
        self._pulse_ns: int | None = None
        "Newest pulse to which the phase has been held."
        self._dark_ns: int | None = None
        "When the next slice without firing begins; None: it fires."

    # time

    def keep_time(self, true_ns: Callable[[int], int], own_ns: Callable[[int], int]) -> None:
        """Pulses come at the run's seconds, not at those of a quartz of its own."""
        self.gps.true_ns, self.gps.own_ns = true_ns, own_ns

    def reported(self, at_ns: int) -> DeviceStamp:
        """Time past the hour, as in a packet."""
        shown_ns, since_ns = self.gps.shown_ns(self.clock, at_ns)
        return DeviceStamp(
            at_ns, shown_ns - since_ns, shown_ns // 1000 % codec.HOUR_US, float(TICK_NS), self.clock_bits
        )

    @property
    def _packets(self) -> int:
        return self.build.slice_packets or max(2, -(-SLICE_NS // self.model.packet_ns(self._used.mode)))

    @property
    def _slice_ns(self) -> Fraction:
        return Fraction(self._packets * self.model.packet_ns(self._used.mode))

    # power

    def _reset(self, now_ns: int) -> None:
        super()._reset(now_ns)
        self._outbox.withdraw(lambda sent: sent.emissions[0].label == "data")  # those of a slice that had begun, too
        self.settings = self._used = self.saved
        self._nominal_ns = self._slice_ns
        self.gps.powered_on(now_ns)
        self.motor = Motor(now_ns, self._factor * self.settings.rpm / 60.0, self.build.spin_up_ns)
        self._renew_ns = self._dark_ns = self._pulse_ns = None

    def _start(self, now_ns: int) -> None:
        self._renew(now_ns)
        if self._links[1::2]:
            self._timers.add(now_ns, POSITION_NS, self._tell_position)

    def _next_instant(self) -> int | None:
        other_ns = super()._next_instant()
        return earliest((other_ns, self._renew_ns, self._dark_ns)) if self._running else other_ns

    def _happen(self, now_ns: int) -> None:
        if self._running and self._renew_ns is not None and self._renew_ns <= now_ns:
            self._renew(now_ns)
        elif self._running and self._dark_ns is not None and self._dark_ns <= now_ns:
            self._send_dark(self._dark_ns)
        else:
            super()._happen(now_ns)

    @property
    def fires(self) -> bool:
        """Whether lasers fire."""
        return self._running and self._dark_ns is None

    def phase_locked(self, now_ns: int) -> bool:
        """Whether the head was where the phase lock wants it at the newest pulse."""
        if not self._used.phase_lock or not self.gps.locked(now_ns):
            return False
        away = self.motor.behind(self.gps.last(now_ns)[0], self._used.phase_cdeg / codec.TURN_CDEG)
        return abs(away) <= LOCKED_TURNS

    def change(self, now_ns: int, settings: Settings | None = None) -> None:
        """Other settings, or another motor: it takes effect with the next slice."""
        self.settings = self.settings if settings is None else settings
        if self._running:
            self._renew_ns = self._raster.at(self._raster.first_from(now_ns + 1))
        else:
            self._steer(now_ns)

    def _steer(self, now_ns: int) -> None:
        self.motor.forget_after(now_ns)
        self._pulse_ns = None
        self.motor.set_speed(now_ns, self._factor * self.settings.rpm / 60.0)

    def _renew(self, now_ns: int) -> None:
        """From here on slices are those of the present settings, with or without lasers."""
        self._used = self.settings
        self._made.clear()
        self._steer(now_ns)
        for address in list(self._hosts):
            self._unsubscribe(now_ns, address)
        self._change(now_ns, self._slice_ns)
        fires = self._used.laser and self.motor.speed_hz(now_ns) >= SAFE_HZ
        self._dark_ns = None if fires else self._raster.at(self._next)
        for address in self._targets if fires else ():
            self._subscribe(now_ns, address)
        self._renew_ns = self.motor.passes_ns(now_ns)

    @property
    def _targets(self) -> list[Address]:
        return self._links[::2] + self._listeners

    def _sending(self) -> bool:
        return self._dark_ns is None

    def impair(self, now_ns: int, what: str, degree: float) -> bool:
        """The motor's speed (a factor), a motor that is stopped (1), pulses of the GPS that do not come (1)."""
        self.advance(now_ns)
        if what == "no pps":
            self.gps.switch(now_ns, degree == 0.0 and self.build.pps)
        elif what in ("motor speed", "motor stopped"):
            stopped = what == "motor stopped"
            self._factor = float(degree == 0.0) if stopped else round(degree * SHARES) / SHARES
        else:
            return False
        self.change(now_ns)
        return True

    # slices

    def _make(self, number: int) -> Slice:
        model, settings = self.model, self._used
        start_ns, length_ns = self._raster.at(number), round(self._raster.period_ns)
        self._hold_phase(start_ns + length_ns)
        offset_ns = model.fired_ns(length_ns)
        turns = self.motor.turns(start_ns + offset_ns)
        heads = np.rint(codec.TURN_CDEG * turns[:, 0]).astype(np.int64) % codec.TURN_CDEG
        first, last = settings.fov
        sees = (
            np.full(len(heads), True)
            if settings.sees_all
            else (heads - 100 * first) % 36_000 <= (last - first) % 360 * 100
        )
        azimuth, elevation = model.directions(turns[sees])
        sweep = Sweep(
            azimuth.ravel(),
            elevation.ravel(),
            np.multiply(1e-9, offset_ns[sees].ravel(), dtype=np.float64),
            1e-9 * length_ns,
            max_range_m=0xFFFF * model.unit_mm / 1000.0,
            max_echoes=MOST_ECHOES,
            wants_intensity=True,
            turn=self.motor.turn(start_ns),
        )
        return Slice(heads, sees, sweep)

    def _hold_phase(self, until_ns: int) -> None:
        """Corrections of the phase at the pulses before an instant."""
        if not self._used.phase_lock or not self.gps.pulses:
            return
        pulse_ns = self.gps.after(self._now_ns if self._pulse_ns is None else self._pulse_ns)
        while pulse_ns < until_ns:
            if self.gps.locked(pulse_ns) and self.motor.is_steady(pulse_ns):
                self.motor.correct(pulse_ns, self._used.phase_cdeg / codec.TURN_CDEG)
            self._pulse_ns = pulse_ns
            pulse_ns = self.gps.after(pulse_ns)

    def _is_settled(self, number: int) -> bool:
        if not self._used.phase_lock or not self.gps.pulses:
            return True
        further = 0 if self._used.sees_all else math.ceil(SECOND_NS / SAFE_HZ / self._raster.period_ns)
        pulse_ns = self.gps.after(self._now_ns if self._pulse_ns is None else self._pulse_ns)
        return pulse_ns >= self._raster.at(number + further + 1)

    def _telegrams(self, scan: Scan) -> Iterator[Telegram]:
        piece = self._slice(scan.plan.sweep)
        range_m, intensity = codec.returns(scan, self._used.mode)
        shape = (len(range_m), len(piece.heads_cdeg), self.model.lasers)
        words = [
            codec.distances(range_m, self.model.unit_mm),
            calibrated(range_m, intensity, self.model.white_m2, codec.WHITE).astype(np.int64),
        ]
        if not piece.sees.all():
            for index, part in enumerate(words):
                words[index] = np.zeros(shape, np.int64)
                words[index][:, piece.sees] = part.reshape(len(part), -1, self.model.lasers)
        yield from self._data(scan.plan.start_ns, piece, *words)

    def _data(
        self, start_ns: int, piece: Slice, distance: codec.Words, reflectivity: codec.Words
    ) -> Iterator[Telegram]:
        """The packets of a slice: each leaves when its last laser has fired, those that see nothing do not."""
        count = self._packets
        packet_ns = self.model.packet_ns(self._used.mode)
        reported = [self.reported(start_ns + at * packet_ns + self.model.stamp_ns) for at in range(count)]
        shape = (-1, count, len(piece.heads_cdeg) // count, self.model.lasers)
        firings = codec.Firings(
            piece.heads_cdeg.reshape(shape[1:3]),
            np.array([one.ticks for one in reported]),
            distance.reshape(shape),
            reflectivity.reshape(shape),
        )
        data = codec.encode(self.model, self._used.mode, firings).tobytes()
        for at in np.flatnonzero(piece.sees.reshape(shape[1:3]).any(axis=1)).tolist():
            packet = data[at * codec.DATA_BYTES : (at + 1) * codec.DATA_BYTES]
            yield Telegram((at + 1) * packet_ns, packet, "data", reported[at])

    def _send_dark(self, now_ns: int) -> None:
        """A slice without a laser: packets leave all the same, without returns."""
        number = self._raster.first_from(now_ns)
        piece, start_ns = self._slice(number), self._raster.at(number)
        echoes = 1 + (self._used.mode == "dual")
        nothing = np.zeros(echoes * len(piece.heads_cdeg) * self.model.lasers, np.int64)
        for after_ns, payload, label, _, _ in self._data(start_ns, piece, nothing, nothing):
            for address in self._targets:
                self._outbox.put(
                    Outgoing(address, deque((Emission(start_ns + after_ns, payload, address, label=label),)))
                )
        self._dark_ns = self._raster.at(number + 1)

    def sentence(self, now_ns: int) -> bytes:
        """$GPRMC of the second; empty without a receiver."""
        if not self.build.nmea:
            return b""
        return gprmc(self.gps.utc(now_ns) // SECOND_NS * SECOND_NS, *self.build.place_deg)

    def _tell_position(self, now_ns: int) -> None:
        stamp = self.reported(now_ns).ticks
        payload = codec.encode_position(stamp, self.gps.state(now_ns), self.sentence(now_ns))
        for address in self._links[1::2]:
            self._outbox.send(Emission(now_ns, payload, address, label="position"))
