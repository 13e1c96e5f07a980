"""The `device:` table: every key of every format, refused values, unknown keys; the coverage table; lazy loading."""

from __future__ import annotations

import subprocess
import sys
from typing import Any

import pytest

from protocols.can_objects import FAMILY, FORMATS
from protocols.can_objects.layout import load
from protocols.errors import DeviceSettingError, ScanRefused
from protocols.scan import Scan
from protocols.session import MAX_EVENTS, Address, Restarted
from tests.protocols.can_objects.rig import crowd, start

WRONG: list[tuple[str, str, Any]] = [
    ("ars408", "sensor_id", 8),
    ("ars408", "sensor_id", -1),
    ("ars408", "sensor_id", True),
    ("ars408", "sensor_id", "0"),
    ("ars408", "cycle_ms", 0),
    ("ars408", "cycle_ms", float("nan")),
    ("ars408", "max_objects", 101),
    ("ars408", "output", "both"),
    ("ars408", "quality", 1),
    ("ars408", "sort", 1),
    ("ars408", "max_distance_m", 2047),
    ("ars408", "power", "half"),
    ("ars408", "rcs_threshold", "low"),
    ("ars408", "version", [4, 30]),
    ("ars408", "version", 4),
    ("ars408", "errors", ["heat"]),
    ("ars408", "errors", "voltage"),
    ("ars408", "bitrate", 250_000),
    ("ars408", "boot_ms", -1),
    ("ars408", "evaluation_ms", "5"),
    ("ars408", "lateral_filters", "apollo"),
    ("ars408", "base_id", 0x500),
    ("ldmrs", "base_id", 0x7F1),
    ("ldmrs", "max_objects", 66),
    ("ldmrs", "scan_frequency_hz", 12),
    ("ldmrs", "scan_frequency_hz", "12.5"),
    ("ldmrs", "bitrate", 800_000),
    ("ldmrs", "priority", "nearest"),
    ("ldmrs", "contour", 2),
    ("ldmrs", "output_disable", 0xFFFF),
    ("ldmrs", "warning_registers", [0]),
    ("ldmrs", "sensor_id", 0),
    ("esr", "radiate", True),
    ("esr", "cycle_ms", 10),
    ("leddar_vu8", "segments", 8),
    ("leddar_vu8", "serial_number", "x" * 33),
    ("leddar_vu8", "tx_base_id", 0x79F),
    ("leddar_vu8", "bitrate", 800_000),
    ("leddar_vu8", "rx_base_id", 0x751),
    ("leddar_m16", "kind", "m8"),
    ("leddar_m16", "software_part", "x" * 17),
    ("leddar_m16", "cycle_ms", 40),
    ("esr", "analogue", [0] * 8),
    ("esr", "active_faults", [256] * 8),
    ("leddar_vu8", "field_deg", 0),
]


@pytest.mark.parametrize(("name", "key", "value"), WRONG)
def test_a_wrong_value_is_refused_by_its_key(name: str, key: str, value: Any) -> None:
    with pytest.raises(DeviceSettingError) as caught:
        FAMILY.new_session({key: value}, {"format": name})
    assert caught.value.key == key
    assert caught.value.allowed


@pytest.mark.parametrize("name", FORMATS)
def test_an_unknown_key_is_refused_with_the_known_ones(name: str) -> None:
    with pytest.raises(DeviceSettingError, match=r"colour.*known: .*bitrate.*boot_ms"):
        FAMILY.new_session({"format": name, "colour": "red"}, {})


@pytest.mark.parametrize("name", FORMATS)
def test_every_key_is_listed_with_what_is_allowed_its_default_and_its_meaning(name: str) -> None:
    keys = FAMILY.keys_of_model({"format": name})
    assert {"bitrate", "boot_ms", "evaluation_ms", "e2e"} <= {key.name for key in keys}
    assert len({key.name for key in keys}) == len(keys)
    assert all(key.allowed and key.default and key.meaning for key in keys)
    for key in keys:
        with pytest.raises(DeviceSettingError) as caught:
            FAMILY.new_session({key.name: object()}, {"format": name})
        assert (caught.value.key, caught.value.allowed) == (key.name, key.allowed)


@pytest.mark.parametrize("found", [None, "ars", 408, ["ars408"]])
def test_a_format_must_be_named(found: Any) -> None:
    table = {} if found is None else {"format": found}
    with pytest.raises(DeviceSettingError, match=r"ars408 \| ldmrs \| esr \| leddar_vu8 \| leddar_m16"):
        FAMILY.new_session(table, {})


def test_the_scenario_wins_over_the_model() -> None:
    facts = {"format": "ars408", "sensor_id": 3}
    session = FAMILY.new_session({"sensor_id": 5}, facts)
    session.power_on(0)
    assert {e.address.peer & 0xF0 for e in session.take_emissions(600_000_000) if e.address} == {0x50}


def test_every_message_of_every_layout_is_in_the_coverage_table() -> None:
    rows = FAMILY.commands()
    listed = {row.code for row in rows}
    for name in FORMATS:
        for message in load(f"{name}.dbc")._database.messages:
            if not (message.name.startswith("Track_") and message.name != "Track_01"):
                assert f"{name} 0x{message.frame_id:03X}" in listed
    assert {row.status for row in rows} == {"done"}
    assert all(row.source for row in rows)
    assert len(listed) == len(rows)


def test_cantools_is_loaded_only_when_a_device_is_made() -> None:
    code = (
        "import sys, protocols; protocols.family('can_objects'); print('cantools' in sys.modules, 'e2e' in sys.modules)"
    )
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert result.stdout.split() == ["False", "False"]


@pytest.mark.parametrize("name", FORMATS)
def test_a_scan_of_an_older_plan_is_refused(name: str) -> None:
    device: dict[str, Any] = {"format": name}
    if name.startswith("leddar"):
        device["streaming"] = "start"
    rig = start(device, crowd(1))
    rig.session.advance(rig.now_ns)
    plan = rig.session.next_plan()
    assert plan is not None
    rig.session.submit(Scan.empty(plan))
    with pytest.raises(ScanRefused):
        rig.session.submit(Scan.empty(plan))
    fresh = rig.session.next_plan()
    assert fresh is not None
    rig.session.power_on(rig.now_ns)
    with pytest.raises(ScanRefused):
        rig.session.submit(Scan.empty(fresh))
    rig.session.advance(rig.now_ns + 600_000_000)
    with pytest.raises(ScanRefused):
        rig.session.submit(Scan.empty(fresh))


@pytest.mark.parametrize("name", FORMATS)
def test_events_that_nobody_takes_do_not_fill_the_memory(name: str) -> None:
    session = start({"format": name}).session
    for now_ns in range(MAX_EVENTS + 500):
        session.receive(b"\xff" * 8, now_ns, Address(0, 0x7F0 + now_ns % 3))
    session.power_on(10**9)
    events = session.take_events()
    assert len(events) == MAX_EVENTS
    assert events[-1] == Restarted(10**9)
    assert session.take_events() == []
