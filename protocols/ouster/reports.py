"""What an Ouster reports of itself beside its metadata: telemetry, its times, its network.

Belongs here: contents. Not: the requests that ask for them (api), metadata, alerts.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from protocols.ouster import config
from protocols.ouster.device import OusterDevice
from protocols.skeleton.instants import SECOND_NS


def telemetry(device: OusterDevice, now_ns: int) -> dict[str, Any]:
    """Values are fixed, but for the clock and the phase lock."""
    hot = 95 if device.impaired.get("thermal shutdown") else 80 if device.impaired.get("shot limiting") else 48
    return {
        "input_current_ma": 644 if device.status == "RUNNING" else 210,
        "input_voltage_mv": 23_624,
        "internal_temperature_deg_c": hot,
        "phase_lock_status": device.phase_status(now_ns),
        "timestamp_ns": device.stamp(now_ns),
    }


def time_sensor(device: OusterDevice, now_ns: int) -> dict[str, Any]:
    """What its clock follows."""
    used, sources = device.active, device.sources
    shown = {mode: device.time(now_ns, mode)[0] for mode in (config.OSCILLATOR, config.PTP, config.PULSE)}
    hears = sources.sentences and used["multipurpose_io_mode"] == "INPUT_NMEA_UART"
    pulses, sentence = sources.pulses_seen(now_ns), device.sentence(now_ns).decode() if hears else ""
    decoding = {
        "date_decoded_count": pulses if hears else 0, "last_read_message": sentence, "not_valid_count": 0,
        "utc_decoded_count": pulses if hears else 0,
    }  # fmt: skip
    checks = {"bit_count": 1, "bit_count_unfiltered": 0, "char_count": len(sentence), "start_char_count": int(hears)}
    out = {"angle_deg": "angle", "frequency_hz": "frequency", "pulse_width_ms": "pulse_width"}
    mode = used["multipurpose_io_mode"]
    return {
        "multipurpose_io": {
            "mode": mode,
            "nmea": {
                "baud_rate": used["nmea_baud_rate"],
                "diagnostics": {"decoding": decoding, "io_checks": checks},
                "ignore_valid_char": used["nmea_ignore_valid_char"],
                "leap_seconds": used["nmea_leap_seconds"],
                "locked": int(hears and pulses > 0),
                "polarity": used["nmea_in_polarity"],
            },
            "sync_pulse_out": {name: used[f"sync_pulse_out_{key}"] for name, key in out.items()}
            | {"mode": mode if mode.startswith("OUTPUT") else "OFF", "polarity": used["sync_pulse_out_polarity"]},
        },
        "sync_pulse_in": {
            "diagnostics": {
                "count": pulses, "count_unfiltered": pulses, "last_period_nsec": SECOND_NS if pulses > 1 else 0,
            },
            "locked": int(pulses > 0),
            "polarity": used["sync_pulse_in_polarity"],
        },
        "timestamp": {
            "mode": used["timestamp_mode"],
            "time": shown[used["timestamp_mode"]] / SECOND_NS,
            "time_options": {
                "internal_osc": shown[config.OSCILLATOR] // SECOND_NS,
                "ptp_1588": shown[config.PTP] // SECOND_NS,
                "sync_pulse_in": shown[config.PULSE] // SECOND_NS,
            },
        },
    }  # fmt: skip


def time_ptp(device: OusterDevice, now_ns: int) -> dict[str, Any]:
    """Data sets of the PTP client."""
    slave = device.sources.follows_ptp(now_ns)
    own, master = f"bc0fa7.fffe.{device.unit.serial % (1 << 24):06x}", "001747.fffe.700001"
    return {
        "current_data_set": {
            "mean_path_delay": 42_000.0 if slave else 0.0, "offset_from_master": 15.0 if slave else 0.0,
            "steps_removed": int(slave),
        },
        "parent_data_set": {
            "grandmaster_identity": master if slave else own, "parent_port_identity": f"{master if slave else own}-1",
            "gm_clock_class": 6 if slave else 255, "grandmaster_priority1": 128, "grandmaster_priority2": 128,
        },
        "port_data_set": {"port_identity": f"{own}-1", "port_state": "SLAVE" if slave else "LISTENING"},
        "profile": device.ptp_profile,
        "time_properties_data_set": {
            "current_utc_offset": 37, "current_utc_offset_valid": int(slave), "ptp_timescale": 1,
            "time_traceable": int(slave),
        },
        "time_status_np": {
            "gm_identity": master if slave else own, "gm_present": slave, "master_offset": 15 if slave else 0,
            "ingress_time": device.sources.utc(now_ns) if slave else 0,
        },
    }  # fmt: skip


def time_system(device: OusterDevice, now_ns: int) -> dict[str, Any]:
    """Of the operating system."""
    return {
        "monotonic": device.clock.shown_ns(now_ns) / SECOND_NS,
        "realtime": device.sources.utc(now_ns) / SECOND_NS,
        "tracking": {
            "frequency": -7.0, "last_offset": 5.9e-06, "leap_status": "normal",
            "ref_time_utc": device.sources.utc(now_ns) // SECOND_NS, "reference_id": "70747000",
            "remote_host": "ptp" if device.sources.ptp else "", "residual_frequency": 0.0, "rms_offset": 6e-06,
            "root_delay": 1e-09, "root_dispersion": 4.5e-05, "skew": 0.0, "stratum": 1,
            "system_time_offset": -1.6e-06, "update_interval": 2.0,
        },
    }  # fmt: skip


TIMES: Mapping[str, Callable[[Any, int], dict[str, Any]]] = {
    "ptp": time_ptp, "sensor": time_sensor, "system": time_system,
}  # fmt: skip


def network(device: OusterDevice) -> dict[str, Any]:
    """The address is the one that a host has called, as that of the links; an override is stored."""
    mac = f"bc0fa7{device.unit.serial % (1 << 24):06x}"
    called = device.called or "127.0.0.1"
    own = device.override or f"{called}/{8 if called.startswith('127.') else 24}"
    return {
        "carrier": True,
        "duplex": "full",
        "ethaddr": ":".join(mac[at : at + 2] for at in range(0, 12, 2)),
        "hostname": f"os-{device.unit.serial}",
        "ipv4": {"addr": own, "link_local": "169.254.1.2/16", "override": device.override},
        "ipv6": {"addr": None, "link_local": f"fe80::be0f:a7ff:fe{mac[6:8]}:{mac[8:]}/64", "override": None},
        "speed": 1000,
    }
