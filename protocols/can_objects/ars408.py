"""Continental ARS408-21: a radar's object and cluster lists on a 500 kbit/s bus, sensor ids 0 to 7.

Belongs here: configuration, state, ego motion, and what goes into a list. Codes and frames of the lists are in
`ars408_lists`, filters in `ars408_filters`, collision regions in `ars408_collision`.
Sources: see the head of `ars408.dbc`; times from the recording named there.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np

from protocols.can_objects.ars408_collision import CollisionDetection
from protocols.can_objects.ars408_filters import NOT_VALID, FilterBank
from protocols.can_objects.ars408_lists import MAX_CLUSTERS, MotionHistory, cluster_list, object_list
from protocols.can_objects.identities import Identities
from protocols.can_objects.session import CanObjectSession, Frame, HostMessage
from protocols.can_objects.settings import CommonSettings
from protocols.can_objects.table import ObjectTable
from protocols.session import DropReason
from protocols.skeleton.instants import SECOND_NS
from protocols.skeleton.keys import DeviceKeys

OUTPUTS = ("none", "objects", "clusters")
SORTS = ("unsorted", "range", "rcs")
POWERS = ("full", "minus_3_db", "minus_6_db", "minus_9_db")
THRESHOLDS = ("standard", "high_sensitivity")
COUNTRIES = ("international", "power_reduced")
ERRORS = {
    "voltage": "ErrVoltage",
    "temporary": "ErrTemporary",
    "temperature": "ErrTemperature",
    "interference": "Interference",
    "persistent": "ErrPersistent",
}
MAX_OBJECTS = 100
EGO_RESERVED_DIRECTION = 3


@dataclass(frozen=True)
class Configuration:
    """What 0x200 changes and 0x201 reports; retained over power cycles once stored."""

    sensor_id: int
    max_distance_m: float
    output: int
    power: int
    quality: bool
    extended: bool
    sort: int
    control_relay: bool
    rcs_threshold: int


@dataclass(frozen=True)
class Settings:
    """The scenario's `device:` table."""

    common: CommonSettings
    configuration: Configuration
    cycle_ns: int
    max_objects: int
    counter_step: int
    interface_version: int
    version: tuple[int, ...]
    country: int
    extended_range: bool
    rcs_dbm2: float
    ego_timeout_ns: int
    standing_m_s: float
    errors: tuple[str, ...]
    swap_lateral: bool

    @classmethod
    def read(cls, keys: DeviceKeys) -> Settings:
        """Check a table; raises `DeviceSettingError`."""
        settings = cls(
            common=CommonSettings.read(keys, 500_000, (500_000,)),
            configuration=Configuration(
                sensor_id=keys.integer("sensor_id", "every identifier but 0x008 moves by 0x10 times this", 0, 0, 7),
                max_distance_m=float(
                    keys.integer("max_distance_m", "farther objects are not listed; steps of 2 m", 250, 0, 2046)
                )
                // 2
                * 2,
                output=OUTPUTS.index(keys.choice("output", "what lists hold at power-on", "objects", OUTPUTS)),
                power=POWERS.index(keys.choice("power", "reported in 0x201; without effect", "full", POWERS)),
                quality=keys.flag("quality", "0x60C or 0x702 in every list", True),
                extended=keys.flag("extended", "0x60D in every list", True),
                sort=SORTS.index(keys.choice("sort", "order of a list", "range", SORTS)),
                control_relay=keys.flag("control_relay", "0x008 once a second", False),
                rcs_threshold=THRESHOLDS.index(
                    keys.choice("rcs_threshold", "reported in 0x201; without effect", "standard", THRESHOLDS)
                ),
            ),
            cycle_ns=round(
                keys.number("cycle_ms", "from list to list; longer when the bus is full", 75.0, 5.0, 10_000.0) * 1e6
            ),
            max_objects=keys.integer("max_objects", "the nearest are listed", MAX_OBJECTS, 0, MAX_OBJECTS),
            counter_step=keys.integer("counter_step", "by how much MeasCounter grows from list to list", 2, 0, 65_535),
            interface_version=keys.integer("interface_version", "in every header", 1, 0, 15),
            version=keys.integers("version", "major, minor, patch of 0x700", (4, 30, 2), 0, 255),
            country=COUNTRIES.index(keys.choice("country", "in 0x700", "international", COUNTRIES)),
            extended_range=keys.flag("extended_range", "in 0x700", False),
            rcs_dbm2=keys.number("rcs_dbm2", "cross section of every object", 0.0, -64.0, 63.5),
            ego_timeout_ns=round(
                keys.number(
                    "ego_timeout_ms",
                    "time without 0x300 or 0x301 after which MotionInput reports what is missing",
                    500.0,
                    1.0,
                    60_000.0,
                )
                * 1e6
            ),
            standing_m_s=keys.number("standing_m_s", "slower objects stand", 0.6, 0.0, 10.0),
            errors=keys.words("errors", "fault bits of 0x201 that are set", tuple(ERRORS)),
            swap_lateral=keys.choice(
                "lateral_filters", "whose direction filters 11 and 13 have", "maker", ("maker", "tier4")
            )
            == "tier4",
        )
        keys.finish()
        return settings


class Ars408Session(CanObjectSession):
    """One ARS408-21."""

    LAYOUT_FILE: ClassVar[str] = "ars408.dbc"
    count_bits = 16

    def __init__(self, settings: Settings) -> None:
        self._settings = settings
        self._stored = settings.configuration
        self._configuration = settings.configuration
        super().__init__(settings.common)
        self._filters = FilterBank(self._layout, settings.swap_lateral)
        self._collision = CollisionDetection(self._layout)
        self._ids = Identities(256)
        self._motion = MotionHistory(settings.standing_m_s)
        self._reset(0)

    def _shift(self) -> int:
        return 0x10 * self._configuration.sensor_id

    def _reset(self, now_ns: int) -> None:
        self._configuration = self._stored
        self._nvm_written = False
        self._counter = self.first_count
        self._speed: tuple[int, float] | None = None
        self._yaw_rate: tuple[int, float] | None = None
        self._filters.clear()
        self._collision.clear()
        self._ids.clear()
        self._motion.clear()

    def _start(self, now_ns: int) -> None:
        # consumers wait for 0x201 before they take a list, so it comes first
        self._send_state(now_ns)
        self._timers.add(now_ns + SECOND_NS, SECOND_NS, self._send_state)

    def _cycle_ns(self) -> int:
        return self._settings.cycle_ns

    def _lists_wanted(self) -> bool:
        return self._configuration.output != OUTPUTS.index("none")

    # Lists

    def _encode_list(self, table: ObjectTable, now_ns: int, measured_ns: int) -> list[Frame]:
        configuration, settings = self._configuration, self._settings
        counter = self._counter
        self._counter = (counter + settings.counter_step) & 0xFFFF
        table = table.take(np.argsort(table.range_m, kind="stable"))
        numbers, new = self._ids.assign(table.track.tolist())
        dynamics = self._motion.codes(table, self._ego(self._speed, now_ns), self._ego(self._yaw_rate, now_ns))
        ids = np.array([-1 if number is None else number for number in numbers], dtype=np.int64)
        for_objects = configuration.output == OUTPUTS.index("objects")
        keep = (table.range_m <= configuration.max_distance_m) & (ids >= 0)
        keep &= self._filters.mask(table, for_objects, settings.rcs_dbm2)
        if not for_objects:
            keep &= table.coasting_s <= 0.0  # a cluster is an echo, not a track
        limit = settings.max_objects if for_objects else MAX_CLUSTERS
        number = self._filters.number(for_objects)
        # range ascending; all objects have one cross section, so "by RCS" keeps that order too
        chosen = np.flatnonzero(keep)[: limit if number is None else min(limit, number)]
        if configuration.sort == SORTS.index("unsorted"):
            chosen = chosen[np.argsort(ids[chosen], kind="stable")]
        table = table.take(chosen)
        if not for_objects:
            return cluster_list(
                self._layout,
                self._shift(),
                table,
                dynamics[chosen],
                counter=counter,
                interface_version=settings.interface_version,
                rcs_dbm2=settings.rcs_dbm2,
                quality=configuration.quality,
            )
        warnings = self._collision.warnings(table, measured_ns) if self._collision.active else None
        frames = object_list(
            self._layout,
            self._shift(),
            table,
            ids[chosen],
            np.array(new, dtype=np.bool_)[chosen],
            dynamics[chosen],
            counter=counter,
            interface_version=settings.interface_version,
            rcs_dbm2=settings.rcs_dbm2,
            quality=configuration.quality,
            extended=configuration.extended,
            region_bits=warnings,
        )
        if self._collision.active:
            frames += self._collision.state(self._shift(), counter)
        return frames

    def _ego(self, seen: tuple[int, float] | None, now_ns: int) -> float | None:
        """An ego value while it is fresh."""
        return None if seen is None or now_ns - seen[0] > self._settings.ego_timeout_ns else seen[1]

    # State

    def _send_state(self, now_ns: int) -> None:
        self._send_cyclic([self._state_frame(now_ns), self._version_frame()], now_ns)
        if self._configuration.control_relay:
            message = self._layout["RelayControl"]
            payload = message.frame(raw={"RegionBits": self._collision.relay_bits()})
            self._send_cyclic([Frame(message.identifier, payload, "RelayControl")], now_ns)  # never shifted

    def _state_frame(self, now_ns: int) -> Frame:
        configuration = self._configuration
        speed_missing = self._ego(self._speed, now_ns) is None
        yaw_rate_missing = self._ego(self._yaw_rate, now_ns) is None
        raw = {
            "NvmReadOk": 1,
            "NvmWriteOk": int(self._nvm_written),
            "Power": configuration.power,
            "SensorId": configuration.sensor_id,
            "SortIndex": configuration.sort,
            "CtrlRelay": int(configuration.control_relay),
            "OutputType": configuration.output,
            "SendQuality": int(configuration.quality),
            "SendExtended": int(configuration.extended),
            "MotionInput": int(speed_missing) + 2 * int(yaw_rate_missing),
            "RcsThreshold": configuration.rcs_threshold,
        }
        raw |= {ERRORS[name]: 1 for name in self._settings.errors}
        return self._frame("SensorState", raw, MaxDistance=configuration.max_distance_m)

    def _version_frame(self) -> Frame:
        major, minor, patch = self._settings.version
        raw = {
            "Major": major,
            "Minor": minor,
            "Patch": patch,
            "CountryCode": self._settings.country,
            "ExtendedRange": int(self._settings.extended_range),
        }
        return self._frame("SensorVersion", raw)

    # Host messages

    def _configure(self, data: bytes, now_ns: int, link: int) -> None:
        values = self._layout.decode("SensorConfig", data)
        asked: dict[str, Any] = {}
        refused: list[str] = []
        for signal, key, count in (
            ("SensorId", "sensor_id", 8),
            ("OutputType", "output", len(OUTPUTS)),
            ("Power", "power", len(POWERS)),
            ("SortIndex", "sort", len(SORTS)),
            ("RcsThreshold", "rcs_threshold", len(THRESHOLDS)),
        ):
            if values[f"Set_{signal}"]:
                if int(values[signal]) < count:
                    asked[key] = int(values[signal])
                else:
                    refused.append(f"{signal} {int(values[signal])}")
        for signal, key in (("SendQuality", "quality"), ("SendExtended", "extended"), ("CtrlRelay", "control_relay")):
            if values[f"Set_{signal}"]:
                asked[key] = bool(values[signal])
        if values["Set_MaxDistance"]:
            if values["MaxDistance"]:
                asked["max_distance_m"] = float(values["MaxDistance"])
            else:  # no source says what a sensor makes of 0; a list that is empty for ever would be no test of a host
                refused.append("MaxDistance 0")
        before = self._configuration
        self._configuration = replace(before, **asked)
        if refused:
            reported = f"SensorConfig: not settled: {', '.join(refused)}; left as it was"
            self._drop(now_ns, DropReason.BAD_ARGUMENT, reported)
        if values["Set_StoreNvm"] and values["StoreNvm"]:
            self._stored = self._configuration
            self._nvm_written = True
        if self._configuration.sensor_id != before.sensor_id:
            self._rebuild_dispatch()
        if self._configuration.output != before.output:
            self._restart_raster(now_ns)
            self._ids.clear()
            self._mode(now_ns, f"output {OUTPUTS[self._configuration.output]}")
        self._handled(now_ns, "SensorConfig", f"left out: {', '.join(refused)}" if refused else "done")
        self._send_reply([self._state_frame(now_ns)], now_ns)

    def _set_filter(self, data: bytes, now_ns: int, link: int) -> None:
        refusal = self._filters.set(data)
        if refusal is not None and refusal != NOT_VALID:
            self._drop(now_ns, DropReason.BAD_ARGUMENT, f"FilterConfig: {refusal}")
        self._handled(now_ns, "FilterConfig", refusal or "done")
        self._send_reply(self._filters.answer(self._shift()), now_ns, link)

    def _take_speed(self, data: bytes, now_ns: int, link: int) -> None:
        values = self._layout.decode("EgoSpeed", data)
        direction = int(values["Direction"])
        if direction == EGO_RESERVED_DIRECTION:
            # some drivers send this message in the other byte order: odd values are no fault
            self._drop(now_ns, DropReason.BAD_ARGUMENT, "EgoSpeed: reserved direction 3; taken as forward")
        sign = (0.0, 1.0, -1.0, 1.0)[direction]
        self._speed = (now_ns, sign * values["Speed"])

    def _take_yaw_rate(self, data: bytes, now_ns: int, link: int) -> None:
        self._yaw_rate = (now_ns, math.radians(self._layout.decode("EgoYawRate", data)["YawRate"]))

    def _configure_collision(self, data: bytes, now_ns: int, link: int) -> None:
        self._collision.configure(data)
        self._handled(now_ns, "CollisionConfig")
        self._send_reply(self._collision.state(self._shift(), self._counter), now_ns, link)

    def _configure_region(self, data: bytes, now_ns: int, link: int) -> None:
        self._collision.set_region(data)
        self._handled(now_ns, "CollisionRegionConfig")
        self._send_reply(self._collision.state(self._shift(), self._counter), now_ns, link)

    HOST_MESSAGES: ClassVar[tuple[HostMessage, ...]] = (
        HostMessage("SensorConfig", _configure, 8, "maker's DBC, Apollo conti_radar", note="answered with 0x201"),
        HostMessage("FilterConfig", _set_filter, 5, "maker's DBC, tier4", note="answered with 0x203 and 0x204"),
        HostMessage("EgoSpeed", _take_speed, 2, "Apollo conti_radar"),
        HostMessage("EgoYawRate", _take_yaw_rate, 2, "Apollo conti_radar"),
        HostMessage(
            "CollisionConfig", _configure_collision, 2, "maker's DBC", note="answered with 0x408 and 0x402; time ours"
        ),
        HostMessage("CollisionRegionConfig", _configure_region, 8, "maker's DBC", note="answered with 0x408 and 0x402"),
    )


SENT = (
    ("ObjListHeader", "recording", "opens every list"),
    ("ObjGeneral", "recording", ""),
    ("ObjQuality", "recording", "states 0, 4 and 5 (deleted, merged) are never sent: none in the recording"),
    ("ObjExtended", "recording", ""),
    ("ObjWarning", "maker's DBC", "while collision detection is active"),
    ("SensorState", "recording", "once a second and after 0x200"),
    ("SensorVersion", "recording", "once a second"),
    ("ClusterListHeader", "maker's DBC", "near scan up to 70 m"),
    ("ClusterGeneral", "maker's DBC", "one cluster an object that was seen, at its nearest point"),
    ("ClusterQuality", "maker's DBC", "always unambiguous and valid"),
    ("FilterStateHeader", "maker's DBC", "answer to 0x202"),
    ("FilterState", "maker's DBC", "one for each active filter"),
    ("CollisionState", "maker's DBC", "behind each list while active; time ours"),
    ("CollisionRegionState", "maker's DBC", "behind each list while active; time ours"),
    ("RelayControl", "maker's DBC", "once a second while relay control is on"),
)
"Messages of the device: name in the DBC, source, note."


SESSION = Ars408Session
