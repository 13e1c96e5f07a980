"""Devices that refuse requests or logins, or restart, in virtual time; and for whom these faults exist."""

from __future__ import annotations

from pathlib import Path

import pytest

from emulator.errors import ScenarioError
from emulator.faults.catalogue import fits, kinds
from emulator.judging.trial import Trial
from emulator.scenario import scenario
from emulator.transports.loopback import LoopLink
from protocols.skeleton.cola_frames import frame
from protocols.skeleton.cola_values import ASCII

TEXT = """\
schema: 1
seed: 1
duration_s: 3.0
world:
  - {plane: {size_m: [6, 60]}, at_m: [5, 0, 1], pitch_deg: -90, material: white_plaster}
sensors:
  - {id: one, model: MODEL, mount: {at_m: [0, 0, 1]}, physics: {noise: false, rule: axis, sub_beams: 1}}
faults:
  - {on: one, do: DO, at_s: 0.0, for_s: 1.2}
"""


def trial(do: str, model: str = "sick-tim551") -> Trial:
    return Trial(scenario.loads(TEXT.replace("DO", do).replace("MODEL", model), Path("refusing.yaml")))


def test_a_busy_device_gives_no_scan_until_the_fault_ends_and_counts_what_it_refused() -> None:
    made = trial("device_busy")
    made.run.advance(1_150_000_000)
    (instrument,) = made.instruments
    assert instrument.stats.scans_sent == 0
    assert instrument.stats.input_dropped["device busy with earlier requests"] > 0
    made.run.advance(3_000_000_000 + 1_500_000_000)
    assert instrument.stats.scans_sent > 0
    made.close()


OUSTER = "http_unavailable", "lost_columns", "shot_limiting", "thermal_shutdown"
HESAI = "ptc_error", "overheating", "calibration_file"


@pytest.mark.parametrize(
    ("do", "who"),
    [
        ("device_busy", "cola"), ("refuse_login", "cola"), ("no_pps", "velodyne, hesai"), ("no_ptp", "hesai, ouster"),
        ("calibration_served_wrong", "hesai, ouster"),
        *((do, "ouster") for do in OUSTER), *((do, "hesai") for do in HESAI),
    ],
)  # fmt: skip
def test_only_families_that_state_it_have_the_fault(do: str, who: str) -> None:
    assert fits(kinds()[do]) == who
    with pytest.raises(ScenarioError, match=f"want a sensor of {who.replace(', ', ' or ')}"):
        trial(do, "sick-lms291-s05")


def test_a_restart_at_a_hosts_request_sends_its_reply_and_ends_the_connections() -> None:
    made = trial("device_busy")
    made.faults.clear(1, 0)
    (instrument,) = made.instruments
    link = instrument.links[0]
    assert isinstance(link, LoopLink)
    host = link.connect()
    made.run.advance(4_000_000_000)
    assert host.connected
    for text in (b"sMN SetAccessMode 3 F4724744", b"sMN mSCreboot"):
        host.write(frame(ASCII, text), made.run.clock.now_ns())
        made.run.advance(made.run.clock.now_ns() + 500_000_000)
    assert host.read().endswith(b"\x02sAN mSCreboot\x03")
    assert not host.connected
    assert instrument.stats.restarts == 2
    sent = instrument.stats.scans_sent
    made.run.advance(made.run.clock.now_ns() + 6_000_000_000)
    assert instrument.stats.scans_sent > sent, "the built-in host has connected again"
    made.close()


def test_a_login_is_refused_until_the_fault_ends() -> None:
    text = TEXT.replace("DO", "refuse_login").replace("MODEL", "sick-tim551").replace("at_s: 0.0", "at_s: 4.0")
    made = Trial(scenario.loads(text.replace("duration_s: 3.0", "duration_s: 9.0"), Path("refusing.yaml")))
    (instrument,) = made.instruments
    link = instrument.links[0]
    assert isinstance(link, LoopLink)
    host = link.connect()
    found = []
    for until_s in (4.5, 6.0):  # within the fault, and after it
        made.run.advance(round(until_s * 1e9))
        host.read()
        host.write(frame(ASCII, b"sMN SetAccessMode 3 F4724744"), made.run.clock.now_ns())
        made.run.advance(made.run.clock.now_ns() + 500_000_000)
        found += [part for part in host.read().split(b"\x02") if b"SetAccessMode" in part]
    assert found == [b"sAN SetAccessMode 0\x03", b"sAN SetAccessMode 1\x03"]
    made.close()


def test_pulses_that_do_not_come_unlock_the_clock_of_a_velodyne_until_the_fault_ends() -> None:
    text = TEXT.replace("DO", "no_pps").replace("MODEL", "velodyne-vlp-16").replace("at_s: 0.0", "at_s: 4.0")
    text = text.replace("sub_beams: 1}}", "sub_beams: 1}, device: {boot_s: 0, fov_deg: [0, 1], pps: true, nmea: true}}")
    made = Trial(scenario.loads(text.replace("duration_s: 3.0", "duration_s: 10.0"), Path("case.yaml")))
    (instrument,) = made.instruments
    states = []
    for until_s in (3.9, 5.1, 9.5):  # before the fault, within it, after it
        made.run.advance(round(until_s * 1e9))
        states.append(instrument.session.gps.state(made.run.clock.now_ns()))  # type: ignore[attr-defined]
    assert states == [2, 0, 2]
    made.close()


@pytest.mark.parametrize("do", OUSTER)
def test_an_ouster_is_impaired_until_the_fault_ends(do: str) -> None:
    made = trial(do, "ouster-os1-32")
    (instrument,) = made.instruments
    session = instrument.session
    made.run.advance(600_000_000)
    if do == "no_ptp":
        assert list(instrument.impairments["no ptp"].values()) == [1.0]
    else:
        assert next(iter(session.impaired.values())) > 0.0  # type: ignore[attr-defined]
    made.run.advance(1_400_000_000)
    assert session.impaired == {}  # type: ignore[attr-defined]
    made.close()
