"""SICK LD-MRS S01 / Ibeo LUX: the `device:` table of a scenario.

Belongs here: its keys, ranges and defaults, as parameters where the device has one. Not: what the values do.
"""

from __future__ import annotations

from dataclasses import dataclass

from protocols.can_objects import ldmrs_parameters as p
from protocols.can_objects.settings import CommonSettings
from protocols.skeleton.keys import DeviceKeys

NO_VIEW_ESTIMATE = 0xFF

STREAMING = ("start", "command")


@dataclass(frozen=True)
class Settings:
    """The scenario's `device:` table."""

    common: CommonSettings
    parameters: dict[int, int]
    starts_measuring: bool
    temperature_c: int
    view_percent: int
    blind: int
    without_ego: str
    ego_timeout_ns: int
    counts_objects_only: bool
    class_in_reserved: bool
    ntp_start: int | None
    errors: tuple[int, int]
    warnings: tuple[int, int]

    @classmethod
    def read(cls, keys: DeviceKeys) -> Settings:
        """Check a table; raises `DeviceSettingError`."""
        common = CommonSettings.read(keys, 500_000, (1_000_000, 500_000, 250_000, 125_000))
        frequency_hz = keys.number_of("scan_frequency_hz", "parameter 0x1102", 12.5, (12.5, 25.0, 50.0))
        priority = keys.choice(
            "priority",
            "parameter 0x1015: which objects are listed when not all fit",
            "radial",
            ("radial", "look_ahead"),
        )
        velocities = keys.choice("velocities", "parameter 0x1016, bit 0", "absolute", ("absolute", "relative"))
        boxes = keys.choice("boxes", "parameter 0x1016, bit 1", "object", ("object", "axis_aligned"))
        density = keys.choice("contour", "parameter 0x1014", "high", ("closest", "low", "high"))
        settings = cls(
            common=common,
            parameters={
                p.BASE_ID: keys.integer(
                    "base_id", "parameter 0x1010: first of the sixteen identifiers", 0x500, 0, 0x7F0
                ),
                p.BITRATE_KBIT: common.bitrate // 1000,
                p.OUTPUT_DISABLE: keys.integer(
                    "output_disable", "parameter 0x1012: bit 5 warnings, bit 6 objects on CAN", 0x80, 0, 0xFFFE
                ),
                p.MAX_OBJECTS: keys.integer("max_objects", "parameter 0x1013", 65, 0, 65),
                p.CONTOUR_DENSITY: ("closest", "low", "high").index(density),
                p.PRIORITY: ("radial", "look_ahead").index(priority),
                p.OPTIONS: int(velocities == "relative") + 2 * int(boxes == "axis_aligned"),
                p.MIN_AGE: keys.integer("min_age_scans", "parameter 0x1017", 0, 0, 0xFFFF),
                p.MAX_PREDICTION_AGE: keys.integer("max_prediction_scans", "parameter 0x1018", 0xFFFF, 0, 0xFFFF),
                p.SCAN_FREQUENCY: round(frequency_hz * p.FREQUENCY_UNITS),
                p.MOUNT_X: keys.integer("mount_x_cm", "parameter 0x1200", 0, -32768, 32767),
                p.MOUNT_Y: keys.integer("mount_y_cm", "parameter 0x1201", 0, -32768, 32767),
                p.MOUNT_YAW: round(
                    keys.number("mount_yaw_deg", "parameter 0x1203", 0.0, -180.0, 180.0) * p.TICKS_PER_DEG
                ),
            },
            starts_measuring=keys.choice(
                "streaming", "whether it measures at power-on or after the start command", "start", STREAMING
            )
            == "start",
            temperature_c=keys.integer("temperature_c", "in every header; a warning beyond -30 and 115", 34, -127, 127),
            view_percent=keys.integer(
                "view_percent", "visibility in every header; 255: no estimate", 100, 0, NO_VIEW_ESTIMATE
            ),
            blind=keys.integer("blind", "in every header", 0, 0, 255),
            without_ego=keys.choice(
                "without_ego", "what velocities are while the host sends no motion", "invalid", ("invalid", "relative")
            ),
            ego_timeout_ns=round(
                keys.number("ego_timeout_ms", "ego motion older than this is missing", 500.0, 1.0, 60_000.0) * 1e6
            ),
            counts_objects_only=keys.choice(
                "count_messages", "what NumMessages of the trailer counts", "all", ("all", "objects")
            )
            == "objects",
            class_in_reserved=keys.flag(
                "class_in_reserved", "class, certainty and class age in the reserved bytes of base+4", False
            ),
            ntp_start=None
            if (
                ntp := keys.integer(
                    "ntp_start_s", "NTP time at power-on; -1: none until a host sets it", -1, -1, 0xFFFFFFFF
                )
            )
            < 0
            else ntp,
            errors=_pair(keys, "error_registers", "both error registers of base+0xF"),
            warnings=_pair(keys, "warning_registers", "bits set in both warning registers beside those of the state"),
        )
        keys.finish()
        return settings


def _pair(keys: DeviceKeys, key: str, meaning: str) -> tuple[int, int]:
    first, second = keys.integers(key, meaning, (0, 0), 0, 0xFFFF)
    return first, second
