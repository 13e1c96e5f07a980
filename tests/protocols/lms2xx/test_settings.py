"""The `device:` table: what is taken, and how a wrong key or value is told."""

from __future__ import annotations

from typing import Any

import pytest

from protocols.errors import DeviceSettingError
from protocols.lms2xx import FAMILY
from protocols.lms2xx.models import MODELS, model_of
from protocols.lms2xx.settings import KEYS, read

S05, S14, INDOOR = (MODELS[f"sick-lms{name}"] for name in ("291-s05", "291-s14", "200-30106"))


@pytest.mark.parametrize("model", MODELS)
def test_every_model_has_a_type_text_of_21_characters_that_names_it(model: str) -> None:
    session = FAMILY.new_session({}, {"model": model})
    text = session.device.type_text.decode("ascii")
    _, family, kind = model.split("-")
    assert len(text) == 21
    assert text.startswith(f"{family.upper()};{kind.upper()}")
    assert len(session.device.configuration) == MODELS[model].config_bytes


def test_the_type_text_does_not_depend_on_the_unit() -> None:
    for unit in ("cm", "mm"):
        session = FAMILY.new_session({"unit": unit}, {"model": "sick-lms200-30106"})
        assert session.device.type_text == b"LMS200;301063;V02.10 "


def test_indoor_models_count_in_mm_at_delivery_and_the_others_in_cm() -> None:
    units = {
        name: FAMILY.new_session({}, {"model": name}).device.unit for name in ("sick-lms220-30106", "sick-lms291-s05")
    }
    assert units == {"sick-lms220-30106": 1, "sick-lms291-s05": 0}


@pytest.mark.parametrize(
    ("firmware", "count"), [("V02.09", 32), ("V02.10", 34), ("X01.09", 32), ("X01.10", 34), ("S01.00", 34)]
)
def test_older_firmware_has_a_shorter_block(firmware: str, count: int) -> None:
    device = FAMILY.new_session({"firmware": firmware}, {"model": "sick-lms200-30106"}).device
    assert len(device.configuration) == count
    assert device.type_text == f"LMS200;301063;{firmware} ".encode()


@pytest.mark.parametrize("firmware", ["V2.10", "W02.10", "V02.10 ", "", 2, None, True])
def test_a_firmware_that_is_none_is_refused(firmware: object) -> None:
    with pytest.raises(DeviceSettingError, match="firmware"):
        FAMILY.new_session({"firmware": firmware}, {"model": "sick-lms200-30106"})


def test_real_delays_bring_the_device_s_own_gap() -> None:
    assert read({"delays": "real"}, S05).strict_gap
    assert not read({"delays": "real", "strict_gap": False}, S05).strict_gap
    assert not read({"delays": {"ack_s": 0.03}}, S05).strict_gap


def test_an_empty_table_is_the_device_as_delivered() -> None:
    found = read({}, S05)
    assert (found.variant.field_deg, found.variant.step_cdeg) == (180, 50)
    assert (found.startup_baud, found.permanent_baud, found.address) == (9600, False, 0)
    assert found.password == b"SICK_LMS"
    assert found.configuration.hex(" ").startswith("00 00 46 00 00 00 00 00 00 02 02 02 00 00 0a 0a 50 64")
    assert found.starts_running


def test_every_key_can_be_set() -> None:
    table: dict[str, Any] = {
        "resolution_deg": 0.25,
        "field_deg": 100,
        "unit": "mm",
        "measuring_mode": "32m-field-a",
        "sensitivity": "high",
        "availability": 5,
        "real_time_indices": True,
        "configuration": "01 02 46",
        "firmware": "X01.27",
        "interrupt": "finish",
        "address": 3,
        "password": "PASSWORD",
        "baud": 500_000,
        "serial_number": "12345678",
        "errors": [{"code": 18, "severity": 2}, {"code": 6, "present": False}],
        "operating_hours": 2468,
        "switch_ons": 76,
        "severity": 1,
        "restart_input": True,
        "implausible": True,
        "pollution": True,
        "delays": {"ack_s": 0.03},
        "boot_s": 5,
        "start": "cold",
        "strict_gap": True,
        "gap_s": 0.01,
    }
    assert set(table) == {key.name for key in KEYS}
    found = read(table, S05)
    assert found.configuration[:7].hex(" ") == "01 02 46 03 07 06 01"
    assert found.errors == ((2, 18), (3 | 0x80, 6))
    assert found.status_bits == 0xE1
    assert (found.delays.ack_s, found.delays.data_s, found.delays.boot_s) == (0.03, 0.005, 5.0)
    assert (found.gap_ns, found.strict_gap, found.starts_running) == (10_000_000, True, False)
    assert found.permanent_baud


def test_the_field_follows_the_step_where_only_one_is_given() -> None:
    assert read({"resolution_deg": 0.25}, S05).variant.field_deg == 100
    assert read({"resolution_deg": 1}, S05).variant.field_deg == 180
    assert read({}, S14).variant.field_deg == 90


@pytest.mark.parametrize(
    ("table", "key"),
    [
        ({"colour": "blue"}, "colour"),
        ({1: 2}, "1"),
        ({"unit": "inch"}, "unit"),
        ({"unit": 1}, "unit"),
        ({"resolution_deg": 0.3}, "resolution_deg"),
        ({"resolution_deg": True}, "resolution_deg"),
        ({"resolution_deg": 0.25, "field_deg": 180}, "field_deg"),
        ({"field_deg": 90}, "field_deg"),
        ({"field_deg": True}, "field_deg"),
        ({"measuring_mode": 7}, "measuring_mode"),
        ({"measuring_mode": True}, "measuring_mode"),
        ({"sensitivity": "extreme"}, "sensitivity"),
        ({"availability": 8}, "availability"),
        ({"real_time_indices": 1}, "real_time_indices"),
        ({"configuration": "xyz"}, "configuration"),
        ({"configuration": ""}, "configuration"),
        ({"configuration": "00" * 35}, "configuration"),
        ({"configuration": "00 00 46 00 00 77"}, "configuration"),
        ({"address": 128}, "address"),
        ({"address": True}, "address"),
        ({"password": "SHORT"}, "password"),
        ({"password": "ÄÖÜÄÖÜÄÖ"}, "password"),
        ({"baud": 115200}, "baud"),
        ({"baud": "9600"}, "baud"),
        ({"serial_number": "123456789"}, "serial_number"),
        ({"errors": "none"}, "errors"),
        ({"errors": [{"severity": 1}]}, "errors.0"),
        ({"errors": [{"code": 300}]}, "errors.0.code"),
        ({"errors": [{"code": 3, "present": 2}]}, "errors.0.present"),
        ({"operating_hours": -1}, "operating_hours"),
        ({"operating_hours": float("nan")}, "operating_hours"),
        ({"switch_ons": 70_000}, "switch_ons"),
        ({"severity": 5}, "severity"),
        ({"delays": "slow"}, "delays"),
        ({"delays": {"tea_s": 1}}, "delays.tea_s"),
        ({"delays": {"ack_s": "soon"}}, "delays.ack_s"),
        ({"boot_s": -1}, "boot_s"),
        ({"start": "warm"}, "start"),
        ({"gap_s": 0}, "gap_s"),
    ],
)
def test_a_wrong_key_or_value_is_named_with_what_is_allowed(table: dict[str, Any], key: str) -> None:
    with pytest.raises(DeviceSettingError) as caught:
        read(table, S05)
    assert caught.value.key == key
    assert caught.value.allowed


@pytest.mark.parametrize(
    ("model", "table"),
    [(INDOOR, {"sensitivity": "high"}), (S14, {"resolution_deg": 1}), (S14, {"field_deg": 180})],
)
def test_a_key_that_this_model_does_not_have_is_refused(model: Any, table: dict[str, Any]) -> None:
    with pytest.raises(DeviceSettingError):
        read(table, model)


@pytest.mark.parametrize(
    "facts",
    [
        {},
        {"model": "sick-lms999"},
        {"model": "sick-lms291-s05", "wheels": 4},
        {"model": "sick-lms291-s05", "type_text": "LMS"},
        {"model": "sick-lms291-s05", "config_bytes": 33},
    ],
)
def test_facts_of_an_unknown_model_are_refused(facts: dict[str, Any]) -> None:
    with pytest.raises(DeviceSettingError):
        model_of(facts)


def test_facts_may_override_a_model() -> None:
    facts = {"model": "sick-lms291-s05", "config_bytes": 32, "type_text": "LMS291;S05   ;X01.20 "}
    session = FAMILY.new_session({}, facts)
    assert len(session.device.configuration) == 32
    assert session.device.type_text.endswith(b"X01.20 ")


def test_the_keys_are_listed_with_default_and_meaning() -> None:
    for key in FAMILY.device_keys():
        assert key.allowed
        assert key.default
        assert key.meaning
