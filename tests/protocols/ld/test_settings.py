"""The `device` table: every key, its default, and what is said to a wrong one."""

from __future__ import annotations

from typing import Any

import pytest

from protocols.errors import DeviceSettingError
from protocols.ld import FAMILY
from protocols.ld.models import MODELS
from protocols.ld.sectors import Function, MeasureError, Sector, check, initialised
from protocols.ld.settings import KEYS
from tests.protocols.ld.rig import FACTS

GOOD: dict[str, list[Any]] = {
    "motor_hz": [5, 10],
    "step_deg": [0.125, 1, 1.5, 0.1875, 360],
    "sectors": [None, "full", [{"from_deg": 0, "to_deg": 300}], [{"from_deg": 350, "to_deg": 10}],
                [{"from_deg": 0, "to_deg": 360}], [{"stop_deg": 359.5, "function": "normal"}]],
    "sensor_id": [1, 254],
    "baud": [4800, 115200],
    "parity": ["none", "odd"],
    "stop_bits": [1, 2],
    "can_kbit_s": [10, 1000],
    "can_host_id": [0, 2047],
    "can_host_mask": [0, 2047],
    "can_sensor_id": [0, 1793],
    "ip": ["10.0.0.1"],
    "netmask": ["255.0.0.0"],
    "gateway": ["10.0.0.254"],
    "near_field_suppression": [True],
    "identity": [{}, {"sensor_name": "x", "application_version": ""}],
    "delays": ["real", "fast"],
    "spin_up_s": [None, 0, 4.5, 60],
    "start": ["running", "cold"],
    "services": ["strict", "liberal"],
    "mode": [None, "idle", "rotate", "measure"],
    "udp_format": [0, 0x3FFF],
    "zero_deg": [-360, 90.5],
    "clock_ms": [0, 2**32 - 1],
    "clock_ppm": [-100_000, 5],
}  # fmt: skip

BAD: dict[str, list[Any]] = {
    "motor_hz": [4, 11, 21, 10.0, "10", True, None],
    "step_deg": [0, 0.0625, 0.1, 7, -1, "1", float("nan"), float("inf"), True],
    "sectors": [[], "half", 3, [{"from_deg": 0}], [{"from_deg": 300, "to_deg": 10}, {"from_deg": 20, "to_deg": 30}],
                [{"from_deg": 0, "to_deg": 361}], [{"from_deg": -1, "to_deg": 10}], [{"from_deg": 0.03, "to_deg": 10}],
                [{"from_deg": index, "to_deg": index} for index in range(0, 50, 10)],
                [{"stop_deg": 360, "function": "normal"}], [{"stop_deg": 10, "function": "dummy"}],
                [{"stop_deg": 10, "function": 3}], [3], [None],
                [{"stop_deg": index, "function": "none"} for index in range(9)]],
    "sensor_id": [0, 255],
    "baud": [300, 115201, "9600"],
    "parity": ["mark", 0],
    "stop_bits": [0, 1.5, True],
    "can_kbit_s": [800],
    "can_host_id": [2048],
    "can_host_mask": [-1],
    "can_sensor_id": [1794],
    "ip": ["10.0.0", "10.0.0.256", "10.0.0.x", 10, "10.0.0.1.2", "1.2.3.²"],
    "netmask": [255],
    "gateway": [None],
    "near_field_suppression": [1, "on"],
    "identity": [{"name": "x"}, {"sensor_name": "thirteen char"}, {"sensor_name": 7}, {"sensor_name": "é"}, []],
    "delays": ["slow", 1],
    "spin_up_s": [-1, 61, "1", True],
    "start": ["warm"],
    "services": ["lax", True],
    "mode": ["sleep", 1],
    "udp_format": [0x4000, -1],
    "zero_deg": [361, float("nan"), None],
    "clock_ms": [-1, 2**32, 1.5],
    "clock_ppm": [100_001],
}  # fmt: skip


def test_every_key_is_tried_with_good_and_bad_values() -> None:
    names = {key.name for key in KEYS}
    assert set(GOOD) == names
    assert set(BAD) == names
    assert FAMILY.device_keys() is KEYS
    assert len(names) == len(KEYS)


@pytest.mark.parametrize(("key", "value"), [(key, value) for key, values in GOOD.items() for value in values])
def test_a_value_that_is_allowed_is_taken(key: str, value: Any) -> None:
    FAMILY.new_session({key: value}, FACTS)


@pytest.mark.parametrize(("key", "value"), [(key, value) for key, values in BAD.items() for value in values])
def test_a_value_that_is_not_allowed_is_told_with_what_is(key: str, value: Any) -> None:
    with pytest.raises(DeviceSettingError) as reported:
        FAMILY.new_session({key: value}, FACTS)
    assert reported.value.key == key
    assert reported.value.found is value
    (known,) = [entry for entry in KEYS if entry.name == key]
    assert reported.value.allowed == known.allowed


def test_the_default_table_is_itself_allowed_and_measures_a_full_circle() -> None:
    session = FAMILY.new_session({key.name: key.default for key in KEYS}, FACTS)
    device = session.device
    assert device.config == FAMILY.new_session({}, FACTS).device.config
    assert check(device.sectors, device.configured_hz, 8) is MeasureError.OK
    assert initialised(device.sectors) == (Sector(Function.NORMAL, 5752),)


def test_an_unknown_key_is_told_with_the_nearest_one() -> None:
    with pytest.raises(DeviceSettingError, match="`motor_hz`"):
        FAMILY.new_session({"motor_Hz": 10}, FACTS)
    with pytest.raises(DeviceSettingError, match="one of: motor_hz, step_deg"):
        FAMILY.new_session({"colour": 10}, FACTS)
    with pytest.raises(DeviceSettingError):
        FAMILY.new_session({7: 10}, FACTS)  # type: ignore[dict-item]


def test_a_device_that_shall_measure_must_be_able_to() -> None:
    with pytest.raises(DeviceSettingError, match="MEAN_PULSE"):
        FAMILY.new_session({"mode": "measure", "step_deg": 0.25}, FACTS)
    FAMILY.new_session({"mode": "idle", "step_deg": 0.25}, FACTS)  # a host may be tried with it


@pytest.mark.parametrize(
    ("sectors", "stops"),
    [
        ([{"from_deg": 0, "to_deg": 300}], [(3, 4800), (1, 5752)]),
        ([{"from_deg": 90, "to_deg": 270}], [(3, 4320), (1, 1432)]),
        ([{"from_deg": 0, "to_deg": 360}], [(3, 5752)]),
        ([{"from_deg": 0, "to_deg": 359.5}], [(3, 5752)]),
        ([{"from_deg": 10, "to_deg": 20}, {"from_deg": 350, "to_deg": 5}], [(3, 320), (1, 5592), (3, 80), (1, 152)]),
        ([{"stop_deg": 44.5, "function": "none"}, {"stop_deg": 315, "function": "reference"},
          {"stop_deg": 359.5, "function": "none"}], [(1, 712), (4, 5040), (1, 5752)]),
    ],
)  # fmt: skip
def test_arcs_and_tables_become_the_devices_sectors(sectors: list, stops: list[tuple[int, int]]) -> None:
    device = FAMILY.new_session({"sectors": sectors}, FACTS).device
    assert [(sector.function, sector.stop) for sector in initialised(device.sectors)] == stops
    assert check(device.sectors, 10, 8) is MeasureError.OK


@pytest.mark.parametrize("facts", [{}, {"model": "sick-ld-lrs9"}, {"model": 7}, {**FACTS, "colour": 1}])
def test_facts_that_name_no_model_are_refused(facts: dict[str, Any]) -> None:
    with pytest.raises(DeviceSettingError):
        FAMILY.new_session({}, facts)


def test_every_model_makes_a_session_and_its_name_fits() -> None:
    for name, model in MODELS.items():
        assert FAMILY.new_session({}, {"model": name}).device.model is model
        assert len(model.sensor_name) <= 12


def test_the_family_tells_that_tcp_is_its_own_link() -> None:
    assert (FAMILY.name, FAMILY.tcp_is_line) == ("ld", False)
