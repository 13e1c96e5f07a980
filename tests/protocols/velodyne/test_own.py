"""Lasers of a sensor of one's own: what fires when, what a host is told of them, and what is refused."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from emulator.errors import SpecError
from emulator.hosts.velodyne import TurnReader
from emulator.sensors.spec import load_spec_file
from protocols.errors import DeviceSettingError
from protocols.velodyne import FAMILY, codec
from protocols.velodyne.models import MODES, Mode
from protocols.velodyne.own import LASERS, read, reported
from tests.protocols.velodyne.rig import WEB, Rig, packets


def table(count: int, **more: Any) -> dict[str, Any]:
    lasers = {
        "source": "here",
        "evidence": "choice",
        "elevation_deg": np.linspace(-40.0, 10.0, count).tolist(),
        "azimuth_offset_deg": [(-1.0) ** at for at in range(count)],
        "cycle_us": 100.0,
        "unit_mm": 5,
    }
    return {"model": "velodyne-hdl-32e", "lasers": lasers | more}


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("count", LASERS)
def test_lasers_are_asked_for_as_the_table_says_and_a_host_reads_them(count: int, mode: Mode) -> None:
    facts = table(count)
    rig = Rig(session=FAMILY.new_session({"boot_s": 0.0, "spin_up_s": 0.0, "returns": mode}, facts))
    head = rig.ask(b"GET /packets HTTP/1.1\r\n\r\n")
    rig.run(0.25)
    plan = rig.plans[3]
    assert np.degrees(plan.elevation_rad[:count]) == pytest.approx(facts["lasers"]["elevation_deg"])
    assert 1e6 * np.diff(plan.fire_offset_s[:count]) == pytest.approx(100.0 / count, abs=1e-2)
    assert 1e6 * (plan.fire_offset_s[count] - plan.fire_offset_s[0]) == pytest.approx(100.0)
    reader = TurnReader()
    clouds = list(reader.feed(head + b"".join(one.payload for one in packets(rig.sent, WEB))))
    assert reader.errors == 0
    cloud = clouds[1].cloud
    assert cloud is not None
    assert sorted(np.unique(np.degrees(cloud.elevation_rad).round(6))) == pytest.approx(
        sorted(facts["lasers"]["elevation_deg"]), abs=1e-5
    )
    assert set(cloud.range_m) == {10.0}
    mine = plan.azimuth_rad[: 2 * count] % (2 * np.pi)
    there = np.sort(cloud.azimuth_rad % (2 * np.pi))
    at = np.clip(np.searchsorted(there, mine), 1, len(there) - 1)
    off = np.minimum(np.abs(there[at - 1] - mine), np.abs(there[at] - mine))  # to the nearest one
    assert np.degrees(off).max() < 0.05


def test_a_model_of_the_maker_is_not_told() -> None:
    assert reported(FAMILY.model_of({"model": "velodyne-vls-128"})) == b""
    own = FAMILY.model_of(table(64))
    again = read(b"HTTP/1.1 200 OK\r\n" + reported(own))
    assert again is not None
    assert again.elevation_deg == own.elevation_deg
    assert again.laser_ns == own.laser_ns
    assert (again.offset_deg, again.cycle_ns, again.unit_mm) == (own.offset_deg, own.cycle_ns, own.unit_mm)
    assert codec.decode(np.zeros(0, codec.PACKET), again) is None


@pytest.mark.parametrize("head", [b"", b"X-Lasers: {", b"X-Lasers: []", b'X-Lasers: {"model": 1, "lasers": 2}'])
def test_nonsense_in_a_head_is_no_model(head: bytes) -> None:
    assert read(head) is None


@pytest.mark.parametrize(
    ("facts", "key"),
    [
        ({"model": "velodyne-64"}, "model"),
        ({"model": []}, "model"),
        ({"layers": 3}, "layers"),
        ({"lasers": 3}, "lasers"),
        (table(16, ring=3), "lasers.ring"),
        (table(16, source=""), "lasers.source"),
        (table(24), "lasers.elevation_deg"),
        (table(16, elevation_deg=["x"] * 16), "lasers.elevation_deg"),
        (table(16, elevation_deg=[float("nan")] * 16), "lasers.elevation_deg"),
        (table(16, elevation_deg=[91.0] * 16), "lasers.elevation_deg"),
        (table(16, elevation_deg=5), "lasers.elevation_deg"),
        (table(16, azimuth_offset_deg=[1.0]), "lasers.azimuth_offset_deg"),
        (table(16, fire_us=[100.0] * 16), "lasers.fire_us"),
        (table(16, fire_us=[-1.0] * 16), "lasers.fire_us"),
        (table(16, cycle_us=0), "lasers.cycle_us"),
        (table(16, cycle_us=True), "lasers.cycle_us"),
        (table(16, unit_mm=3), "lasers.unit_mm"),
    ],
)
def test_what_no_packet_can_carry_is_refused_with_its_key(facts: dict[str, Any], key: str) -> None:
    with pytest.raises(DeviceSettingError) as told_error:
        FAMILY.model_of(facts)
    assert told_error.value.key == key


def test_a_fault_in_the_file_is_told_with_its_line(tmp_path: Path) -> None:
    path = tmp_path / "acme.yaml"
    path.write_text(
        "schema: 1\nmodel: acme\nextends: velodyne-vlp-16\ndevice:\n  lasers:\n    source: here\n    evidence: choice\n"
        "    elevation_deg: [0]\n"
    )
    with pytest.raises(SpecError, match=r"acme.yaml:8: device.lasers.elevation_deg: '1 values'; want 16, 32, 64, 128"):
        load_spec_file(path)
