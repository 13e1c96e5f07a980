"""Faults of the ego's own frames on CAN: what a stack that reads the bus sees of each."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import pytest

from emulator.errors import ScenarioError
from emulator.faults.catalogue import kinds
from emulator.faults.kinds import ON_VEHICLE
from emulator.instrument.observer import Payload
from emulator.scenario.scenario import loads
from tests.instrument.test_vehicle_bus import BUS, DBC, DRIVE, Frames, heard

MOTION, STEERING = (DBC.get_message_by_name(name).frame_id for name in ("VehicleMotion", "VehicleSteering"))
WAY = "waypoints: [{t_s: 0, at_m: [0, 0, 0]}, {t_s: 0.5, at_m: [1, 0, 0]}, {t_s: 1, at_m: [6, 0, 0]}]"
DRIVE_ON = DRIVE.replace("velocity_m_s: [10, 0, 0]", WAY)
"2 m/s, then 10 m/s."
MORE = {
    "delay_telegram": "delay_s: 0.05, for_s: 0.2",
    "reorder_telegrams": "for_s: 0.2",
    "wrong_dlc": "data_bytes: 3, for_s: 0.2",
    "missing_message": "label: VehicleMotion, for_s: 0.2",
    "invalid_signal": "signal: Speed, for_s: 0.2",
    "bus_off": "for_s: 0.2",
    "error_passive": "for_s: 0.2",
    "stale_scan": "for_s: 0.4",
}


def drive(fault: str) -> Frames:
    return heard(loads(f"{DRIVE_ON}{BUS}faults:\n  - {{on: vehicle_bus, {fault}}}\n", Path("x.yaml")))[0]


@cache
def without() -> Frames:
    return heard(loads(DRIVE_ON + BUS, Path("x.yaml")))[0]


def between(frames: list[Payload], begin_s: float, end_s: float) -> list[bytes]:
    return [one.data for one in frames if begin_s <= one.start_ns * 1e-9 < end_s]


@pytest.mark.parametrize("name", ON_VEHICLE)
def test_every_kind_shows_while_it_lasts_and_not_afterwards(name: str) -> None:
    assert name in kinds()
    plain = without()
    frames = drive(f"do: {name}, at_s: 0.3, {MORE.get(name, 'for_s: 0.2')}")
    rows = {
        peer: [(round(one.start_ns * 1e-6), one.data) for one in found] for peer, found in sorted(frames.of.items())
    }
    own = {peer: [(round(one.start_ns * 1e-6), one.data) for one in found] for peer, found in sorted(plain.of.items())}
    if name != "babbling_node":  # its frames are a stranger's; those of the vehicle wait at most a frame's time
        assert rows != own
    for peer in (MOTION, STEERING):
        assert between(frames.of[peer], 0.0, 0.29) == between(plain.of[peer], 0.0, 0.29)
        assert between(frames.of[peer], 0.8, 1.0) == between(plain.of[peer], 0.8, 1.0), "counters as without it"


def test_values_stand_still_and_counters_go_on() -> None:
    told = drive("do: stale_scan, at_s: 0.3, for_s: 0.4").decoded("VehicleMotion")
    speed = [row["Speed"] for row in told]
    assert speed[29] == speed[65] == pytest.approx(7.2, abs=0.1), "that of before the fault"
    assert speed[75] == pytest.approx(36.0, abs=0.1)
    assert [row["Counter"] for row in told] == [number % 16 for number in range(len(told))]


def test_a_counter_that_jumps_is_alone_wrong() -> None:
    told = drive("do: wrong_counter, change: 3, at_s: 0.3, for_s: 0.1").decoded("VehicleMotion")
    away = [(int(row["Counter"]) - number) % 16 for number, row in enumerate(told)]
    assert set(away[31:39]) == {3}
    assert set(away[:29] + away[42:]) == {0}
    assert {row["SpeedValid"] for row in told} == {1}


def test_a_signal_has_the_value_that_it_must_not_have() -> None:
    told = drive("do: invalid_signal, signal: SpeedValid, raw: 0, at_s: 0.3, for_s: 0.1").decoded("VehicleMotion")
    assert {row["SpeedValid"] for row in told[31:39]} == {0}
    assert {row["SpeedValid"] for row in told[:29] + told[42:]} == {1}


@pytest.mark.parametrize(
    ("fault", "why"),
    [
        ("do: dirty_window", "vehicle_bus is no sensor; want drop_telegram"),
        ("do: e2e_counter", "vehicle_bus is no sensor; want drop_telegram"),
        ("do: missing_message, label: VehicleMotio", "message 'VehicleMotio'; want VehicleMotion"),
        ("do: invalid_signal, signal: Sped", "signal 'Sped'; want"),
        ("do: wrong_counter, label: VehicleSteering", "VehicleSteering has no counter; want VehicleMotion"),
    ],
)
def test_what_cannot_be_is_refused_by_name(fault: str, why: str) -> None:
    with pytest.raises(ScenarioError) as found:
        loads(f"{DRIVE}{BUS}faults:\n  - {{on: vehicle_bus, at_s: 0.1, {fault}}}\n", Path("x.yaml"))
    assert why in str(found.value)
    assert "x.yaml:" in str(found.value)


def test_without_a_vehicle_bus_there_is_none_to_have_faults() -> None:
    with pytest.raises(ScenarioError, match=r"faults\[0\]\.on: 'vehicle_bus'"):
        loads(f"{DRIVE}faults:\n  - {{on: vehicle_bus, at_s: 0.1, do: hang}}\n", Path("x.yaml"))
