"""An Ouster between requests: its states, slices of its frames, the packets that they leave in, IMU packets.

A slice is a few packets: it is measured as a whole, and its packets leave each at its own instant. Belongs here: what
fires when, and where packets go. Not: what a request says (api), bytes (codec).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from fractions import Fraction
from functools import lru_cache
from ipaddress import ip_address
from typing import Any

import numpy as np

from protocols.device_clock import DeviceStamp
from protocols.ouster import alerts, codec, config, metadata
from protocols.ouster.clocks import Sources
from protocols.ouster.imu import Felt, G, at_rest, measured
from protocols.ouster.models import Unit
from protocols.ouster.settings import Build
from protocols.ouster.slices import Slice, columns_of, lost, slice_of
from protocols.scan import Floats, Scan
from protocols.session import Address, Emission, LinkKind
from protocols.skeleton.instants import SECOND_NS, Raster, earliest
from protocols.skeleton.nmea import gprmc
from protocols.skeleton.packets import PacketSession
from protocols.skeleton.sweeps import Telegram

SLICE_NS = 5_000_000
"How long a slice is at least."
IMU_NS = 10_000_000
"From packet to packet of the LEGACY profile."
IMU_LATENCY_NS = 2_000_000
RANGE_RATE = 0.465
"Half the columns a second: a range 17.5 per cent longer, and so the light by this power of the rate."
STANDARD_RATE = 10_240
"Columns a second at which the optics of the spec hold."
COUNTDOWN_NS = 30 * SECOND_NS
"Of warnings before laser power is reduced, and before the shutdown."
PHASE_STEP_NS = 20_000_000
"By which the phase lock moves a frame in a second, at most."
STEADY = 1e-3
"A clock that differs by more from the run's within a slice has been set."
FAILED_S = 30
"So long off, the phase lock has failed; no source."
ARRIVED_NS = 2 * SECOND_NS
"Without a refusal so long, packets arrive again; hosts say it once a second at least."
PHASE_OFF_NS = 1_000_000
"Farther off, it is not locked."


@lru_cache(maxsize=8)
def packets_of(columns: int, fps: int) -> int:
    """Of a slice: a power of two, which a frame consists of."""
    return 1 << max(0, math.ceil(math.log2(SLICE_NS * columns * fps / (codec.COLUMNS * SECOND_NS))))


@lru_cache(maxsize=8)
def instants(packets: int, packet_ns: float) -> tuple[codec.Words, int, tuple[int, ...], tuple[int, ...]]:
    """Of a slice, after its start: when its columns begin (C,), when it ends, when its packets begin and end. [ns]"""
    after_ns = np.rint(np.arange(packets * codec.COLUMNS + 1) * (packet_ns / codec.COLUMNS)).astype(np.int64)
    ends_ns = tuple(round(one * packet_ns) for one in range(1, packets + 1))
    return after_ns[:-1], int(after_ns[-1]), tuple(after_ns[: -1 : codec.COLUMNS].tolist()), ends_ns


@lru_cache(maxsize=64)
def numeric(place: str) -> str:
    """Address of a destination; empty: it is a name, or nothing."""
    place = "127.0.0.1" if place == "localhost" else place
    try:
        ip_address(place.partition("%")[0])
    except ValueError:
        return ""
    return place


class OusterDevice(PacketSession[Slice]):
    """The device without its requests."""

    FORESEES = True
    minds_delivery = True
    clock_tick_ns = Fraction(1)
    clock_bits = 64

    def __init__(self, unit: Unit, build: Build) -> None:
        self.unit, self.build, self.firmware = unit, build, build.firmware
        self.factory = dict(build.config)
        self.persisted = dict(self.factory)
        self.active = dict(self.factory)
        self.staged = dict(self.factory)
        self.user_data: tuple[str, bool] = ("", False)
        "Text, and whether it stays when the configuration is deleted."
        self.override: str | None = None
        "Static address that a host has set; stored."
        self.ptp_profile = "default"
        self.called = ""
        "Own address, as the last request named it."
        self.status = "INITIALIZING"
        self.init_id = 0
        self.alerts = alerts.Alerts()
        self.sources = Sources(build.utc_ns, build.ptp, build.ptp_lock_ns, build.pulses, build.sentences)
        self._links_at: dict[int, tuple[str, int]] = {}
        "Where they send by themselves, as far as known."
        self.peers: dict[Address, str] = {}
        "From where TCP clients connect."
        self._until_ns: int | None = None
        "When the present state ends by itself."
        self._begun = 0
        "Number of the first slice of the first frame."
        self._felt: Felt = at_rest
        self._lost_s = 0
        "Since when the phase lock is off."
        self._samples = 0
        "Measurements of the IMU since power-on."
        self._lives = 0
        self.impaired: dict[str, float] = {}
        self._undelivered_ns: dict[int, int] = {}
        "Alerts of packets that did not arrive, and when the last one did not."
        self._room: tuple[Any, Any] = None, None
        "What packets are of, and where they are written."
        self._head: tuple[Any, codec.Head] = None, codec.Head(unit.serial, 0)
        "What headers say, and what makes them."
        self._hot_ns: dict[str, int] = {}
        "Since when it warns of what is in `impaired`."
        super().__init__(build.boot_ns, self._slice_ns)

    # time

    def keep_time(self, true_ns: Callable[[int], int], own_ns: Callable[[int], int]) -> None:
        """Pulses and PTP are the run's, not those of a quartz of its own."""
        self.sources.true_ns, self.sources.own_ns = true_ns, own_ns

    def feel(self, motion: Felt) -> None:
        """What its inertial unit feels."""
        self._felt = motion

    def time(self, at_ns: int, mode: str | None = None) -> tuple[int, int]:
        """Time on its clock, and what that shows when the run begins. [ns]"""
        used, leap = self.active, self.active["nmea_leap_seconds"]
        nmea = used["multipurpose_io_mode"] == "INPUT_NMEA_UART"
        return self.sources.shown_ns(mode or used["timestamp_mode"], nmea, leap, self.clock, at_ns)

    def stamp(self, at_ns: int) -> int:
        """As in packets: in steps of its timer, but for PTP."""
        return self.time(at_ns)[0] // self._tick_ns * self._tick_ns

    @property
    def _tick_ns(self) -> int:
        """Step of its timer, as stamps have it."""
        return 1 if self.active["timestamp_mode"] == config.PTP else 8 if self.firmware >= (3, 0) else 10

    def reported(self, at_ns: int) -> DeviceStamp:
        """The stamp of a packet's first column."""
        shown_ns, since_ns = self.time(at_ns)
        return DeviceStamp(at_ns, shown_ns - since_ns, self.stamp(at_ns), 1.0, self.clock_bits)

    # what follows from the configuration

    @property
    def mode(self) -> tuple[int, int]:
        """Columns of a frame, frames a second."""
        return config.MODES[self.active["lidar_mode"]]

    @property
    def profile(self) -> codec.Profile:
        """Of lidar packets."""
        return codec.PROFILES[config.profile_of(self.active)]

    @property
    def fusa(self) -> bool:
        """Whether headers are those for functional safety."""
        return self.profile.fusa or self.active.get("header_type") == "FUSA"

    @property
    def _packets(self) -> int:
        return packets_of(*self.mode)

    @property
    def _slice_ns(self) -> Fraction:
        return Fraction(self._packets * codec.COLUMNS * SECOND_NS, self.mode[0] * self.mode[1])

    @property
    def _per_frame(self) -> int:
        return self.mode[0] // (self._packets * codec.COLUMNS)

    def parts(self) -> Any:
        """Metadata, by name."""
        found = dict(metadata.parts(self.unit, self.build.version, self.init_id, self.status, self.active))
        if wrong := self.impaired.get("wrong calibration served"):
            beams = dict(found["beam_intrinsics"])
            beams["beam_altitude_angles"] = [round(one + wrong, 2) for one in beams["beam_altitude_angles"]]
            found["beam_intrinsics"] = beams
        return found

    def head(self, at_ns: int) -> codec.Head:
        """Of a packet that is sent then; the same object as long as it says the same."""
        limits, shuts = self._left_s("shot limiting", at_ns), self._left_s("thermal shutdown", at_ns)
        share = self.impaired.get("shot limiting", 0.0)
        limiting = 0 if limits is None else 1 if limits else min(9, 2 + int(share * 10.0 + 1e-9))
        says = self.init_id, self.fusa, self.alerts.flags, shuts or 0, limits or 0, int(shuts is not None), limiting
        if says != self._head[0]:
            self._head = says, codec.Head(self.unit.serial, self.init_id, self.firmware, *says[1:])
        return self._head[1]

    def _left_s(self, name: str, at_ns: int) -> int | None:
        """Seconds until something takes effect of which it warns; None: nothing is the matter."""
        if name not in self._hot_ns:
            return None
        return max(0, math.ceil((self._hot_ns[name] + COUNTDOWN_NS - at_ns) / SECOND_NS))

    def _gain(self, at_ns: int) -> float:
        """Light of an echo, over that at the standard rate of columns."""
        rate = self.mode[0] * self.mode[1]
        limited = self._left_s("shot limiting", at_ns) == 0
        power = 1.0 - self.impaired.get("shot limiting", 0.0) if limited else 1.0
        return float(self.active.get("signal_multiplier", 1) * (STANDARD_RATE / rate) ** RANGE_RATE * power)

    # power and states

    def placed(self, address: Address, host: str, port: int) -> None:
        """Where a link sends by itself is the destination until a host says otherwise."""
        self._links_at[address.link] = host, port
        self.peers[address] = host

    def connected(self, now_ns: int, address: Address, kind: LinkKind) -> None:
        """A link is open, or a client has connected."""
        known = len(self._links)
        super().connected(now_ns, address, kind)
        if len(self._links) > known:
            host, port = self._links_at.get(address.link, ("127.0.0.1", 7501 + len(self._links)))
            if len(self._links) <= 2:
                self._deliver(len(self._links) == 1, host, port)

    def _deliver(self, lidar: bool, host: str, port: int) -> None:
        """The destination of a link is that of the configuration the device comes with."""
        found: dict[str, Any] = {"udp_port_lidar" if lidar else "udp_port_imu": port}
        if lidar:
            found |= {name: host for name in ("udp_dest", "udp_ip") if name in self.factory}
        found = {name: value for name, value in found.items() if name not in self.build.given}
        for one in (self.factory, self.persisted, self.active, self.staged):
            one |= found

    def disconnected(self, now_ns: int, address: Address) -> None:
        """A client has disconnected."""
        super().disconnected(now_ns, address)
        self.peers.pop(address, None)

    def _reset(self, now_ns: int) -> None:
        super()._reset(now_ns)
        self.active, self.staged = dict(self.persisted), dict(self.persisted)
        self._nominal_ns = self._slice_ns
        self.alerts, self.sources.on_ns = alerts.Alerts(), now_ns
        self._undelivered_ns.clear()
        self._until_ns, self._samples = None, 0
        self._begin(now_ns)

    def _begin(self, now_ns: int) -> None:
        self._lives += 1
        # a life's number, spread over 24 bits; 0 means "not checked"
        self.init_id = 1 + (self.unit.serial + 7_919_113 * self._lives) % ((1 << 24) - 1)
        self._enter(now_ns, "INITIALIZING")

    def _enter(self, now_ns: int, status: str) -> None:
        self.status = status
        self._events.mode(now_ns, status)

    def _start(self, now_ns: int) -> None:
        self._until_ns = now_ns + self.build.init_ns + self.build.spin_up_ns

    def reinitialise(self, now_ns: int) -> None:
        """Staged becomes active; streams stop until it is initialised."""
        motor = any(self.staged.get(name) != self.active.get(name) for name in config.MOTOR)
        motor |= self.status == "ERROR"
        self.active = dict(self.staged)
        self._silence(now_ns)
        self._hot_ns.pop("thermal shutdown", None)
        self._begin(now_ns)
        self._until_ns = now_ns + self.build.init_ns + (self.build.spin_up_ns if motor else 0)

    def _silence(self, now_ns: int) -> None:
        self._timers.clear()
        self._withdraw_all(now_ns)
        self._outbox.withdraw(lambda sent: sent.emissions[0].label in ("imu", "lidar"))
        self._change(now_ns, self._slice_ns)
        self._made.clear()

    def _next_instant(self) -> int | None:
        own = (self._until_ns,) if self._running else ()
        return earliest((super()._next_instant(), *own))

    def _happen(self, now_ns: int) -> None:
        if self._running and self._until_ns is not None and self._until_ns <= now_ns:
            self._until_ns = None
            self._go_on(now_ns)
        else:
            super()._happen(now_ns)

    def _go_on(self, now_ns: int) -> None:
        """The state that has ended is followed by the next one."""
        if self.status == "INITIALIZING" and self._lives == 1 and self.build.warm_up_ns:
            self._enter(now_ns, "WARMUP")
            self._until_ns = now_ns + self.build.warm_up_ns
        elif self.active["operating_mode"] == "STANDBY":
            self._enter(now_ns, "STANDBY")
        else:
            self._run(now_ns)

    def _run(self, now_ns: int) -> None:
        self._enter(now_ns, "RUNNING")
        zero_ns = now_ns
        if self.active["phase_lock_enable"] and self.locked(now_ns):
            zero_ns += self._ahead_ns(now_ns)
        self._change(now_ns, self._slice_ns)
        self._begun = self._next
        self._raster = Raster(zero_ns, self._nominal_ns * self._slowed, self._begun)
        self._made.clear()
        for address in (*self._lidar_links(), *self._listeners):
            self._subscribe(now_ns, address)
        if self._imu_links():
            self._begin_imu(zero_ns)
        self._timers.add(now_ns + SECOND_NS, SECOND_NS, self._each_second)

    def _sending(self) -> bool:
        return self.status == "RUNNING"

    # where packets go

    def _goes(self, lidar: bool) -> tuple[str, int] | None:
        """Address and port; None: nowhere."""
        wanted, port = self.active["udp_dest"], self.active["udp_port_lidar" if lidar else "udp_port_imu"]
        if not wanted:
            return None
        place = numeric(wanted)
        if self.alerts.is_active(alerts.NO_NAME) == bool(place):
            self.alerts.set(alerts.NO_NAME, not place, self.sources.utc(self._now_ns), "" if place else wanted)
        return (place, port) if place and port else None

    def _lidar_links(self) -> list[Address]:
        return self._links[::2] if self._goes(True) else []

    def _imu_links(self) -> list[Address]:
        if self.active.get("udp_profile_imu") == config.OFF or not self._goes(False):
            return []
        return self._links[1::2] or self._links[:1]

    def _place(self, address: Address, lidar: bool) -> tuple[str, int] | None:
        """Where a link sends; None: as it does by itself. Further pairs of links keep their own places."""
        goes = self._goes(lidar)
        if address not in self._links[:2] or goes == self._links_at.get(address.link):
            return None
        return goes

    def undelivered(self, now_ns: int, address: Address, refused: bool) -> None:
        """A packet has met a closed port, or could not be sent: an alert, until none has for a while."""
        if address not in self._links:
            return
        lidar = self._links.index(address) % 2 == 0
        number, goes = alerts.UNDELIVERED[lidar, refused], self._goes(lidar) or ("", 0)
        self._undelivered_ns[number] = now_ns
        self.alerts.set(number, True, self.sources.utc(now_ns), f"{goes[0]}:{goes[1]}")

    # slices

    def _make(self, number: int) -> Slice:
        columns = self._packets * codec.COLUMNS
        frame, part = divmod(number - self._begun, self._per_frame)
        numbers, column_s = part * columns + np.arange(columns), 1.0 / (self.mode[0] * self.mode[1])
        return slice_of(self.unit, self.active, frame, numbers, column_s, self._gain(self._raster.at(number)))

    def _telegrams(self, scan: Scan) -> Iterator[Telegram]:
        piece, start_ns = self._slice(scan.plan.sweep), scan.plan.start_ns
        profile, used, share = self.profile, self.active, self.impaired.get("lost columns", 0.0)
        (columns, fps), tick_ns = self.mode, self._tick_ns
        packets, packet_ns = packets_of(columns, fps), codec.COLUMNS * SECOND_NS / (columns * fps)
        seen = piece.valid & ~lost(piece, share, self.unit.serial) if share else piece.valid
        firsts_ns, shown_ns, since_ns = self._shown(start_ns, packets, packet_ns)
        stamps = shown_ns - shown_ns % tick_ns
        said = columns_of(scan, piece, seen, stamps, self.unit, profile, used, self.firmware >= (3, 2))
        if (key := (profile.name, packets, columns)) != self._room[0]:
            self._room = key, codec.Room(profile, self.unit.rows, packets, columns)
        head = self.head(start_ns)
        made = codec.encode(self._room[1], head, piece.frame % (1 << 32 if head.fusa else 1 << 16), said)
        sent: Any = piece.valid.reshape(packets, -1).any(axis=1).tolist() if not piece.whole else [True] * packets
        shows_ns, ends_ns = shown_ns[:: codec.COLUMNS].tolist(), instants(packets, packet_ns)[3]
        for packet in range(packets):
            if sent[packet]:
                shows = shows_ns[packet]
                at_ns, ticks = start_ns + firsts_ns[packet], shows - shows % tick_ns
                stamp = DeviceStamp(at_ns, shows - since_ns, ticks, 1.0, self.clock_bits)
                yield Telegram(ends_ns[packet] + self.build.latency_ns, made[packet], "lidar", stamp)

    def _shown(self, start_ns: int, packets: int, packet_ns: float) -> tuple[tuple[int, ...], codec.Words, int]:
        """When a slice's packets begin after its start, and (C,) what the clock shows as its columns do: a line, unless
        it is set. And what it shows when the run begins.
        """
        slowed = self._slowed.numerator / self._slowed.denominator
        after_ns, length_ns, firsts_ns, _ = instants(packets, slowed * packet_ns)
        begun_ns, since_ns = self.time(start_ns)
        passed_ns = self.time(start_ns + length_ns)[0] - begun_ns
        if abs(passed_ns - length_ns) <= STEADY * length_ns:
            after = after_ns if passed_ns == length_ns else after_ns * passed_ns // length_ns
            return firsts_ns, begun_ns + after, since_ns
        return firsts_ns, np.array([self.time(start_ns + at)[0] for at in after_ns.tolist()]), since_ns

    def _goes_to(self, to: Address | None) -> tuple[str, int] | None:
        return None if to is None or to in self._listeners else self._place(to, True)

    # phase lock

    def locked(self, now_ns: int) -> bool:
        """Whether its time comes from outside, which the phase lock needs."""
        return self.sources.locked(self.active["timestamp_mode"], now_ns)

    def _ahead_ns(self, now_ns: int) -> int:
        """Until column 0 is to pass next, by the phase lock."""
        frame_ns = SECOND_NS // self.mode[1]
        wanted_ns = int(self.active["phase_lock_offset"]) * frame_ns // config.TURN_MDEG
        return (wanted_ns - self.time(now_ns)[0]) % frame_ns

    def phase_status(self, now_ns: int) -> str:
        """As telemetry has it."""
        if not self.active["phase_lock_enable"]:
            return "DISABLED"
        return "LOCKED" if self.locked(now_ns) and abs(self._off_ns()) <= PHASE_OFF_NS else "LOST"

    def _off_ns(self) -> int:
        """How late the next frame's column 0 is wanted."""
        whole = -(-(self._next + 1 - self._begun) // self._per_frame)
        begins_ns = self._raster.at(self._begun + whole * self._per_frame)
        frame_ns = SECOND_NS // self.mode[1]
        return (self._ahead_ns(begins_ns) + frame_ns // 2) % frame_ns - frame_ns // 2

    def _each_second(self, now_ns: int) -> None:
        """The phase lock corrects the frames not measured yet; what the device warns of takes effect."""
        for number, last_ns in tuple(self._undelivered_ns.items()):
            if now_ns - last_ns > ARRIVED_NS:
                del self._undelivered_ns[number]
                self.alerts.set(number, False, self.sources.utc(now_ns))
        for name in tuple(self._hot_ns):
            if self._left_s(name, now_ns) == 0:
                self._too_hot(now_ns, name)
        if self.status != "RUNNING" or not self.active["phase_lock_enable"]:
            return
        lost = self.phase_status(now_ns) == "LOST"
        self._lost_s = self._lost_s + 1 if lost else 0
        self.alerts.set(alerts.PHASE, lost, self.sources.utc(now_ns))
        self.alerts.set(alerts.PHASE_FAILED, self._lost_s >= FAILED_S, self.sources.utc(now_ns))
        if self.locked(now_ns) and (off_ns := self._off_ns()):
            number = self._next + 1
            shift_ns = min(max(off_ns, -PHASE_STEP_NS), PHASE_STEP_NS)
            at_ns = self._raster.at(number) + shift_ns
            if at_ns > now_ns:
                self._raster = Raster(at_ns, self._raster.period_ns, number)

    # faults

    def impair(self, now_ns: int, what: str, degree: float) -> bool:
        """Besides the motor's speed: see `Wire.impaired` of the family."""
        self.advance(now_ns)
        if what == "no ptp":
            self.sources.lose_ptp(now_ns, self.clock, degree > 0.0)
            return True
        if what not in ("unavailable", "shot limiting", "thermal shutdown", "lost columns", "wrong calibration served"):
            return super().impair(now_ns, what, degree)
        if degree:
            self.impaired[what] = degree
        else:
            self.impaired.pop(what, None)
        if what in ("shot limiting", "thermal shutdown"):
            number = alerts.HOT if what == "shot limiting" else alerts.TOO_HOT
            self.alerts.set(number, degree > 0.0, self.sources.utc(now_ns))
            if degree:
                self._hot_ns.setdefault(what, now_ns)
            else:
                self._hot_ns.pop(what, None)
                self._made.clear()
        return True

    def _too_hot(self, now_ns: int, name: str) -> None:
        if name == "shot limiting":
            self._made.clear()
        elif self.status == "RUNNING":
            self._silence(now_ns)
            self._enter(now_ns, "ERROR")

    # inertial unit

    def _begin_imu(self, from_ns: int) -> None:
        if self.active.get("udp_profile_imu", config.IMU_LEGACY) == config.IMU_LEGACY:
            self._timers.add(from_ns, IMU_NS, self._tell_imu)
            return
        period_ns = SECOND_NS // (self.mode[1] * self.active["imu_packets_per_frame"])
        self._timers.add(from_ns + period_ns, period_ns, lambda at_ns: self._tell_imus(at_ns, from_ns, period_ns))

    def _measure_imu(self, at_ns: int, rate_hz: float) -> Floats:
        self._samples += 1
        ranges = self.active.get("accel_fsr", "NORMAL"), self.active.get("gyro_fsr", "NORMAL")
        return measured(self._felt, at_ns, self.build.errors, self._samples, rate_hz, ranges)

    def _tell_imu(self, now_ns: int) -> None:
        values = self._measure_imu(now_ns, 100.0)
        gyro_ns = now_ns + 214_400 + (222_400 if self.firmware < (3, 0) else 215_000)
        stamps = self.clock.shown_ns(now_ns), self.stamp(now_ns + 214_400), self.stamp(gyro_ns)
        self._send_imu(now_ns, codec.IMU_LEGACY.pack(*stamps, *values.tolist()))

    def _tell_imus(self, now_ns: int, from_ns: int, period_ns: int) -> None:
        """A packet of measurements up to now; the last one at the last column of its part of the frame."""
        count, (columns, fps) = metadata.imu_records(self.active), self.mode
        records = np.zeros(count, codec.IMU_RECORD)
        packet = (now_ns - from_ns) // period_ns - 1
        frame, part = divmod(packet, self.active["imu_packets_per_frame"])
        step_ns = SECOND_NS // config.RATE_HZ
        for at in range(count):
            taken_ns = now_ns - (count - 1 - at) * step_ns
            values = self._measure_imu(taken_ns, config.RATE_HZ)
            number = columns * (part * count + at + 1) // (config.RATE_HZ // fps) - 1
            records[at] = (self.stamp(taken_ns), number, 1, values[:3] * G, np.radians(values[3:]))
        nmea_ns, sentence = 0, b""
        if self.build.sentences and self.active["multipurpose_io_mode"] == "INPUT_NMEA_UART":
            nmea_ns, sentence = self.time(now_ns)[0] // SECOND_NS * SECOND_NS, self.sentence(now_ns)
        data = codec.encode_imu(self.head(now_ns), frame, nmea_ns, sentence, records)
        self._send_imu(now_ns, data)

    def sentence(self, now_ns: int) -> bytes:
        """$GPRMC of the second, without its line end; empty without a receiver."""
        if not self.build.sentences:
            return b""
        return gprmc(self.sources.utc(now_ns) // SECOND_NS * SECOND_NS, *self.build.place_deg).strip()

    def _send_imu(self, now_ns: int, data: bytes) -> None:
        for address in self._imu_links():
            due_ns = now_ns + IMU_LATENCY_NS
            self._outbox.send(Emission(due_ns, data, address, label="imu", place=self._place(address, False)))
