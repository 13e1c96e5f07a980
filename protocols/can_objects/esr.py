"""Delphi ESR: 64 radar tracks, one identifier each, every 50 ms while a host keeps the radar on.

Belongs here: the whole format. Bits from `esr.dbc`; cycle and conditions from public drivers
(`delphi_esr` of AutonomouStuff and of Apollo). The radar radiates while 0x4F1 says so and 0x4F0 arrives; otherwise its
cycle goes on with empty tracks.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from fractions import Fraction
from typing import Any, ClassVar

import numpy as np

from protocols.can_objects.identities import Identities
from protocols.can_objects.session import CanObjectSession, Frame, HostMessage
from protocols.can_objects.settings import CommonSettings
from protocols.can_objects.table import ObjectTable
from protocols.skeleton.keys import DeviceKeys

TRACKS = 64
TRACKS_PER_GROUP = 7
GROUPS = 10
NO_TARGET, NEW, NEW_UPDATED, UPDATED, COASTED = 0, 1, 2, 3, 4
NEW_COASTED = 7
YOUNG_LISTS = 3
"Lists for which a track counts as new; ours."
MEDIUM_RANGE_M = 60.0
LONG_HALF_ANGLE_RAD = math.radians(10.0)
MAX_RANGE_M = 204.7
SLOW_M_S, FAST_M_S = 1.0, 3.0
"Speeds over ground from which a track is called movable; ours."
TICK_NS = Fraction(2_000_000)
"Of DspTimestamp, 7 bits: wraps every 256 ms."
ANALOGUE = 11
"Supplies, temperatures and the like as A/D counts, in the order of 0x5E4 and 0x5E5; no scale is public."
FAULTS = 8
"Bytes of active and of past faults; no public source says what their bits mean."
RADIATE_OFF, RADIATE_ON = 1, 2
"SystemPowerMode of 0x5E5."
IN_PATH_M = 1.75
"Half width of the lane for the path ids of Status4; ours."


@dataclass(frozen=True)
class Settings:
    """The scenario's `device:` table."""

    common: CommonSettings
    cycle_ns: int
    radiates_always: bool
    host_timeout_ns: int
    temperature_c: int
    power_db: float
    serial_number: int
    analogue: tuple[int, ...]
    active_faults: tuple[int, ...]
    past_faults: tuple[int, ...]

    @classmethod
    def read(cls, keys: DeviceKeys) -> Settings:
        """Check a table; raises `DeviceSettingError`."""
        settings = cls(
            common=CommonSettings.read(keys, 500_000, (500_000,)),
            cycle_ns=round(keys.number("cycle_ms", "from cycle to cycle", 50.0, 20.0, 10_000.0) * 1e6),
            radiates_always=keys.choice(
                "radiate", "tracks only while a host commands it, or always", "command", ("command", "always")
            )
            == "always",
            host_timeout_ns=round(
                keys.number("host_timeout_ms", "host messages older than this are missing", 500.0, 20.0, 60_000.0) * 1e6
            ),
            temperature_c=keys.integer("temperature_c", "in Status2", 30, -128, 127),
            power_db=keys.number("power_db", "power of every track in 0x540", 0.0, -10.0, 21.0),
            serial_number=keys.integer("serial_number", "in Status3, its third byte in Status9", 1, 0, 0xFFFFFF),
            analogue=keys.integers("analogue", "A/D counts of Status5 and Status6", (128,) * ANALOGUE, 0, 255),
            active_faults=keys.integers("active_faults", "bytes of Status7", (0,) * FAULTS, 0, 255),
            past_faults=keys.integers("past_faults", "bytes of Status8", (0,) * FAULTS, 0, 255),
        )
        keys.finish()
        return settings


class EsrSession(CanObjectSession):
    """One Delphi ESR."""

    LAYOUT_FILE: ClassVar[str] = "esr.dbc"
    clock_tick_ns = TICK_NS
    clock_bits = 7
    count_bits = 16

    def __init__(self, settings: Settings) -> None:
        self._settings = settings
        super().__init__(settings.common)
        self._slots = Identities(TRACKS)
        self._reset(0)

    def _shift(self) -> int:
        return 0

    def _reset(self, now_ns: int) -> None:
        self._slots.clear()
        self._lists_of: dict[int, int] = {}
        self._fastest_of: dict[int, float] = {}
        self._cycle = self.first_count
        self.clock = self.clock.powered_on(now_ns)
        self._vehicle: tuple[int, dict[str, float]] | None = None
        self._order: tuple[int, dict[str, float]] | None = None

    def _start(self, now_ns: int) -> None:
        """Nothing leaves before the first cycle."""

    def _cycle_ns(self) -> int:
        return self._settings.cycle_ns

    def _lists_wanted(self) -> bool:
        return True

    def _encode_list(self, table: ObjectTable, now_ns: int, measured_ns: int) -> list[Frame]:
        radiating = self._radiating(now_ns)
        vehicle = self._fresh(self._vehicle, now_ns)
        order = self._fresh(self._order, now_ns) or {}
        limit = int(order.get("MaximumTracks", TRACKS - 1)) + 1
        table = table.take(np.argsort(table.range_m, kind="stable"))
        table = table.take(table.range_m <= MAX_RANGE_M)
        table = table.take(np.arange(min(len(table), limit) if radiating else 0))
        slots, _ = self._slots.assign(table.track.tolist())
        ids = np.array([-1 if slot is None else slot for slot in slots], dtype=np.int64)
        table, ids = table.take(ids >= 0), ids[ids >= 0]
        speed = 0.0 if vehicle is None else self._speed(vehicle)
        ground_x = table.vx_m_s + speed
        ground = np.hypot(ground_x, table.vy_m_s)
        fastest = self._remember(table, ground)
        frames = self._status(now_ns, radiating, vehicle, order)
        moving, standing = self._in_path(table, ground)
        frames += [self._path_ids(ids, moving, standing), *self._tracks(table, ids, ground_x, vehicle is not None)]
        frames += self._motion_power(ids, ground, fastest)
        frames += [self._frame(name, {"SerialNumber": 1}) for name in ("Validation1", "Validation2")]
        frames += self._health(radiating, table, ids, moving)
        self._cycle += 1
        return frames

    def _tracks(
        self, table: ObjectTable, ids: np.ndarray[Any, np.dtype[np.int64]], ground_x: Any, ego_known: bool
    ) -> list[Frame]:
        azimuth = table.azimuth_rad
        lists = np.array([self._lists_of[track] for track in table.track.tolist()], dtype=np.int64)
        young = lists <= YOUNG_LISTS
        measured = np.where(lists == 1, NEW, np.where(young, NEW_UPDATED, UPDATED))
        medium = table.range_m <= MEDIUM_RANGE_M
        long_range = np.abs(azimuth) <= LONG_HALF_ANGLE_RAD
        rolling = self._cycle & 1
        payloads = self._layout["Track_01"].frames(  # all 64 have one layout; a test compares them
            len(table),
            {
                "Oncoming": ((ground_x < -SLOW_M_S) & ego_known).astype(np.int64),
                "Status": np.where(table.coasting_s > 0.0, np.where(young, NEW_COASTED, COASTED), measured),
                "RollingCount": rolling,
                "MedRangeMode": np.where(medium & long_range, 3, np.where(medium, 1, 2)),
            },
            LatRate=table.vy_m_s,
            Angle=-np.degrees(azimuth),  # clockwise positive
            Range=table.range_m,
            RangeAccel=table.ax_m_s2 * np.cos(azimuth) + table.ay_m_s2 * np.sin(azimuth),
            Width=table.width_m,
            RangeRate=table.range_rate_m_s,
        )
        by_slot = dict(zip(ids.tolist(), payloads, strict=True))
        empty = self._layout["Track_01"].frame({"RollingCount": rolling})
        first = self._layout.identifier("Track_01")
        return [Frame(first + slot, by_slot.get(slot, empty), f"Track_{slot + 1:02d}") for slot in range(TRACKS)]

    def _motion_power(self, ids: Any, ground: Any, fastest: Any) -> list[Frame]:
        """0x540: ten groups of seven tracks, the last one with a single track."""
        places = GROUPS * TRACKS_PER_GROUP
        present = np.zeros(places, dtype=np.int64)
        present[ids] = 1
        moving, slow, fast = np.zeros((3, places), dtype=np.int64)
        moving[ids], slow[ids], fast[ids] = ground >= SLOW_M_S, fastest >= SLOW_M_S, fastest >= FAST_M_S
        power = np.where(present, self._settings.power_db, -10.0)  # raw 0 without a track
        raw: dict[str, Any] = {"Group": np.arange(GROUPS), "RollingCount": self._cycle & 1}
        physical = {}
        for place in range(TRACKS_PER_GROUP):
            of_place = slice(place, None, TRACKS_PER_GROUP)
            physical[f"Power{place + 1}"] = power[of_place]
            raw |= {
                f"Moving{place + 1}": moving[of_place],
                f"MovableSlow{place + 1}": slow[of_place],
                f"MovableFast{place + 1}": fast[of_place],
            }
        message = self._layout["TrackMotionPower"]
        payloads = message.frames(GROUPS, raw, **physical)
        return [Frame(message.identifier, payload, "TrackMotionPower") for payload in payloads]

    def _status(
        self, now_ns: int, radiating: bool, vehicle: Mapping[str, float] | None, order: Mapping[str, float]
    ) -> list[Frame]:
        rolling = self._cycle & 3
        self._reported = self.clock.reported(now_ns, TICK_NS, 7)
        ego = vehicle or {}
        first = self._frame(
            "Status1",
            {"RollingCount1": rolling, "CommError": int(vehicle is None), "ScanIndex": self._cycle & 0xFFFF},
            DspTimestamp=self._reported.ticks * 2,
            CurveRadius=ego.get("CurveRadius", 0.0),
            YawRate=ego.get("YawRate", 0.0),
            Speed=ego.get("Speed", 0.0),
        )
        second = self._frame(
            "Status2",
            {
                "RollingCount2": rolling,
                "TransceiverOn": int(radiating),
                "RawDataMode": int(order.get("RawDataEnable", 0)),
                "GroupingMode": int(order.get("GroupingMode", 0)),
                "SteeringAngleAck": int(ego.get("SteerAngle", 0)),
            },
            MaxTracksAck=order.get("MaximumTracks", TRACKS - 1) + 1,
            Temperature=self._settings.temperature_c,
            SpeedCompFactor=1.0,
        )
        third = self._frame("Status3", {"SerialNumber": self._settings.serial_number})
        return [first, second, third]

    def _in_path(self, table: ObjectTable, ground: Any) -> tuple[Any, Any]:
        """Positions of the moving and of the standing tracks straight ahead, nearest first."""
        ahead = (np.abs(table.y_m) <= IN_PATH_M) & (table.x_m > 0.0)
        return np.flatnonzero(ahead & (ground >= SLOW_M_S)), np.flatnonzero(ahead & (ground < SLOW_M_S))

    def _path_ids(self, ids: Any, moving: Any, standing: Any) -> Frame:
        """0x4E3: the nearest moving and the nearest standing track straight ahead, 0 for none."""
        move, stat = _number(ids, moving, 0), _number(ids, standing, 0)
        raw = {f"PathId{name}Move": move for name in ("Acc", "Cmbb", "Fcw")}
        raw |= {f"PathId{name}Stat": stat for name in ("Acc", "Cmbb", "Fcw")}
        return self._frame("Status4", raw | {"RollingCount3": self._cycle & 3, "RangeModes": 3})

    def _health(self, radiating: bool, table: ObjectTable, ids: Any, moving: Any) -> list[Frame]:
        """0x5E4 to 0x5E8: voltages, power, faults, and the second and third track ahead. Hosts publish on 0x5E5."""
        counts = iter(self._settings.analogue)
        fifth = self._frame("Status5", {name: next(counts) for name in self._layout["Status5"].signals})
        raw = {name: next(counts) for name in ("Supply1V8", "SupplyN5V", "WaveDiff")}
        sixth = self._frame("Status6", raw | {"SystemPowerMode": RADIATE_ON if radiating else RADIATE_OFF})
        faults = [
            self._frame(name, dict(zip(self._layout[name].signals, found, strict=True)))
            for name, found in (("Status7", self._settings.active_faults), ("Status8", self._settings.past_faults))
        ]
        raw = {
            "SerialNumber3": self._settings.serial_number >> 16,
            "PathIdAcc2": _number(ids, moving, 1),
            "PathIdAcc3": _number(ids, moving, 2),
        }
        # of the nearest moving track ahead; positive to the right as the angles are
        offset = -float(table.y_m[moving[0]]) if moving.size else 0.0
        return [fifth, sixth, *faults, self._frame("Status9", raw, FilteredOffsetAccCipv=offset)]

    def _remember(self, table: ObjectTable, ground: Any) -> Any:
        """Count the lists of each track and keep its highest speed; the speeds, in the table's order."""
        tracks = table.track.tolist()
        self._lists_of = {track: self._lists_of.get(track, 0) + 1 for track in tracks}
        self._fastest_of = {
            track: max(self._fastest_of.get(track, 0.0), float(speed))
            for track, speed in zip(tracks, ground, strict=True)
        }
        return np.array([self._fastest_of[track] for track in tracks])

    def _radiating(self, now_ns: int) -> bool:
        if self._settings.radiates_always:
            return True
        order = self._fresh(self._order, now_ns)
        return order is not None and bool(order["Radiate"]) and self._fresh(self._vehicle, now_ns) is not None

    def _fresh(self, seen: tuple[int, dict[str, float]] | None, now_ns: int) -> dict[str, float] | None:
        return None if seen is None or now_ns - seen[0] > self._settings.host_timeout_ns else seen[1]

    @staticmethod
    def _speed(vehicle: Mapping[str, float]) -> float:
        return -vehicle["Speed"] if vehicle["SpeedReverse"] else vehicle["Speed"]

    # Host messages

    def _take_vehicle(self, data: bytes, now_ns: int, link: int) -> None:
        self._vehicle = (now_ns, self._layout.decode("EgoMotion1", data))

    def _take_order(self, data: bytes, now_ns: int, link: int) -> None:
        before = self._fresh(self._order, now_ns)
        self._order = (now_ns, self._layout.decode("SensorCommand", data))
        if before is None or before["Radiate"] != self._order[1]["Radiate"]:
            state = "on" if self._order[1]["Radiate"] else "off"
            self._handled(now_ns, "SensorCommand", f"radiate {state}")
            self._mode(now_ns, f"radiate {state}")

    HOST_MESSAGES: ClassVar[tuple[HostMessage, ...]] = (
        HostMessage("EgoMotion1", _take_vehicle, 8, "opendbc ESR.dbc"),
        HostMessage("SensorCommand", _take_order, 8, "opendbc ESR.dbc", note="radiate and the number of tracks"),
    )


def _number(ids: Any, positions: Any, place: int) -> int:
    """Number, from 1 on, of the track in that place of some; 0 when there are fewer."""
    return int(ids[positions[place]]) + 1 if len(positions) > place else 0


SENT = (
    ("Status1", "opendbc ESR.dbc", ""),
    ("Status2", "opendbc ESR.dbc", ""),
    ("Status3", "opendbc ESR.dbc", "versions 0"),
    ("Status4", "opendbc ESR.dbc", "one path id for ACC, CMbB and FCW"),
    ("Track_01", "opendbc ESR.dbc", "0x500 to 0x53F, every cycle"),
    ("TrackMotionPower", "Apollo delphi_esr", "ten groups"),
    ("Validation1", "opendbc ESR.dbc", "no content"),
    ("Validation2", "opendbc ESR.dbc", "no content"),
    ("Status5", "Apollo delphi_esr", "A/D counts; no scale is public"),
    ("Status6", "Apollo delphi_esr", "power mode; A/D counts; no misalignment. Apollo publishes on it"),
    ("Status7", "Apollo delphi_esr", "active faults as the scenario has them; no public source has their meaning"),
    ("Status8", "Apollo delphi_esr", "past faults, likewise"),
    ("Status9", "Apollo delphi_esr", "second and third track ahead, offset of the first; the rest 0"),
)
"Messages of the device: name in the DBC, source, note."


SESSION = EsrSession
