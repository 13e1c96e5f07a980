"""Metadata of an Ouster: JSON objects that drivers make points with.

Belongs here: what each object has, by firmware. Not: where it is asked for (api).
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from protocols.ouster.codec import PROFILES
from protocols.ouster.config import IMU_NEW, MODES, RATE_HZ, Firmware, Values, column_window, profile_of
from protocols.ouster.models import IMU_MM, LIDAR_Z_MM, Unit

STAMPS = {(3, 2): "20250512120000", (3, 1): "20230815120000", (3, 0): "20230209044733"}
SHIFT_1024 = {1: 12, 2: 6}
"Constant in the pixel shifts of firmware to 2.3, at 1024 columns; OS0 has columns / 32."


def image(version: str) -> str:
    """Name of the firmware, from which drivers take the dialect."""
    major, minor, _ = version.split(".")
    known = (int(major), int(minor))
    line = "bootes" if known >= (3, 0) else "ares"
    return f"ousteros-image-prod-{line}-v{version}+{STAMPS.get(known, '20220801120000')}"


def sensor_info(unit: Unit, version: str, init_id: int, status: str) -> dict[str, Any]:
    """Who it is, and in which state."""
    major, minor, _ = version.split(".")
    firmware = int(major), int(minor)
    found: dict[str, Any] = {
        "build_date": "2023-02-09T04:49:03Z",
        "build_rev": f"v{version}",
        "image_rev": image(version),
        "initialization_id": init_id,
        "prod_line": unit.model.product(unit.beams),
        "prod_pn": unit.model.part,
        "prod_sn": str(unit.serial),
        "status": status,
    }
    if firmware <= (2, 3):
        found |= {"base_pn": "", "base_sn": "", "proto_rev": ""}
    if firmware <= (2, 1):
        del found["initialization_id"]
    return found


def beam_intrinsics(unit: Unit, firmware: Firmware) -> dict[str, Any]:
    """Angles of the beams and where they begin."""
    found: dict[str, Any] = {
        "beam_altitude_angles": unit.elevation_deg.tolist(),
        "beam_azimuth_angles": unit.azimuth_deg.tolist(),
        "lidar_origin_to_beam_origin_mm": unit.model.offset_mm,
    }
    if firmware >= (2, 4):
        found["beam_to_lidar_transform"] = [1, 0, 0, unit.model.offset_mm, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]
    return found


def imu_intrinsics() -> dict[str, Any]:
    """Where the inertial unit is."""
    x, y, z = IMU_MM
    return {"imu_to_sensor_transform": [1, 0, 0, x, 0, 1, 0, y, 0, 0, 1, z, 0, 0, 0, 1]}


def lidar_intrinsics(config: Values) -> dict[str, Any]:
    """From the lidar's frame to the sensor's: half a turn, and more where its column 0 is turned."""
    angle = np.radians(180.0 + config.get("lidar_frame_azimuth_offset", 0) / 1000.0)
    c, s = round(float(np.cos(angle)), 15), round(float(np.sin(angle)), 15) + 0.0
    return {"lidar_to_sensor_transform": [c, 0.0 - s, 0, 0, s, c, 0, 0, 0, 0, 1, LIDAR_Z_MM, 0, 0, 0, 1]}


def lidar_data_format(unit: Unit, config: Values, firmware: Firmware) -> dict[str, Any]:
    """How packets are cut."""
    columns, fps = MODES[config["lidar_mode"]]
    shift = np.rint(unit.azimuth_deg * columns / 360.0).astype(int)
    if firmware <= (2, 3):
        kind = unit.model.kind
        shift = shift + (columns // 32 if kind == 0 else SHIFT_1024[kind] * columns // 1024)
        shift = shift - min(0, int(shift.min()))
    found: dict[str, Any] = {
        "column_window": column_window(config),
        "columns_per_frame": columns,
        "columns_per_packet": 16,
        "pixel_shift_by_row": shift.tolist(),
        "pixels_per_column": unit.rows,
    }
    if firmware >= (2, 2):
        found |= {"udp_profile_imu": config["udp_profile_imu"], "udp_profile_lidar": profile_of(config)}
    if firmware >= (3, 1):
        found["fps"] = fps
    if firmware >= (3, 2):
        # the profile has that header whatever the parameter says; drivers read packets by what is here
        found["header_type"] = "FUSA" if PROFILES[profile_of(config)].fusa else config["header_type"]
    return found


def imu_records(config: Values) -> int:
    """Measurements in a packet of the new profile."""
    return RATE_HZ // (MODES[config["lidar_mode"]][1] * int(config.get("imu_packets_per_frame", 8)))


def imu_data_format(config: Values) -> dict[str, Any]:
    """Of the new IMU packets; of others nothing is in them."""
    new = config["udp_profile_imu"] == IMU_NEW
    return {
        "imu_measurements_per_packet": imu_records(config) if new else 0,
        "imu_packets_per_frame": config["imu_packets_per_frame"] if new else 0,
    }


CALIBRATION = {"reflectivity": {"timestamp": "2023-06-08T11:05:15", "valid": True}}


def parts(unit: Unit, version: str, init_id: int, status: str, config: Values) -> Mapping[str, Any]:
    """All objects by the names that `sensor/metadata` has them under."""
    major, minor, _ = version.split(".")
    firmware = int(major), int(minor)
    found = {
        "sensor_info": sensor_info(unit, version, init_id, status),
        "beam_intrinsics": beam_intrinsics(unit, firmware),
        "imu_intrinsics": imu_intrinsics(),
        "lidar_intrinsics": lidar_intrinsics(config),
        "lidar_data_format": lidar_data_format(unit, config, firmware),
        "calibration_status": CALIBRATION,
        "config_params": dict(config),
    }
    if firmware >= (3, 2):
        found["imu_data_format"] = imu_data_format(config)
    return found
