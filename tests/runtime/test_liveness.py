"""Which silence is told, and which is asked for."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from emulator.judging.trial import Trial
from emulator.measuring.measuring import InPlace
from emulator.runtime.metrics import prometheus
from emulator.scenario import scenario
from protocols.lms2xx.telegrams import request
from protocols.scan import Scan, ScanPlan
from tests.measuring.process_rig import SECOND, Rig

CASE = """\
schema: 1
duration_s: 20
world:
  - {box: {size_m: [0.3, 50, 4]}, at_m: [10, 0, 0], material: concrete}
sensors:
  - {id: front, model: MODEL, device: {delays: fast, start: running}, physics: {rule: axis, sub_beams: 1}}
"""


@pytest.fixture
def run() -> Iterator[Rig]:
    made = Rig("front", "left", workers=2)
    yield made
    made.close()


def test_silence_is_told_once_counted_and_shown_until_it_ends(run: Rig) -> None:
    run.stream()
    assert run.daemon.liveness.silent_s("front") < 0.2
    run.processes[0].stopped = True
    run.advance(1.9)
    assert run.kinds() == []
    run.advance(0.5)
    assert [(row["kind"], row["on"]) for row in run.daemon.incidents.rows()] == [("sensor silent", "front")]
    run.advance(1.0)
    assert run.kinds() == ["sensor silent"]
    assert run.daemon.liveness.silent == ("front",)
    assert 2.5 < run.daemon.liveness.silent_s("front") < 3.6
    text = prometheus(run.instruments, run.daemon.incidents, run.daemon.liveness)
    shown = dict(line.rsplit(" ", 1) for line in text.splitlines() if not line.startswith("#"))
    assert float(shown['lidaremu_sensor_silent_seconds{sensor="front"}']) > 2.5
    assert float(shown['lidaremu_sensor_silent_seconds{sensor="left"}']) < 0.2
    assert shown['lidaremu_incidents_total{kind="sensor silent",on="front"}'] == "1"
    assert run.daemon.incidents.exit_code == 5
    run.processes[0].stopped = False
    run.advance(0.5)
    assert run.kinds() == ["sensor silent", "sensor back"]
    assert run.daemon.liveness.silent == ()


def test_a_host_that_stops_the_stream_wants_silence(run: Rig) -> None:
    run.stream()
    run.ends[0].write(request(b"\x20\x25"), run.clock.now_ns())
    run.advance(6.0)
    assert run.kinds() == []
    assert run.daemon.liveness.silent_s("front") == 0.0


def test_a_host_that_stops_the_stream_of_a_dead_sensor_ends_its_silence(run: Rig) -> None:
    run.stream()
    run.processes[0].stopped = True
    run.advance(1.0)
    run.ends[0].write(request(b"\x20\x25"), run.clock.now_ns())
    run.advance(3.5)
    assert "sensor silent" not in run.kinds()


def test_a_sensor_without_power_is_not_missed(run: Rig) -> None:
    run.stream()
    run.processes[0].stopped = True
    run.advance(0.5)
    run.instruments[0].power_off(run.clock.now_ns())
    run.advance(4.0)
    assert run.kinds() == []


def test_time_in_which_the_sender_was_stopped_is_not_silence(run: Rig) -> None:
    run.stream()
    run.processes[0].stopped = True
    run.advance(1.0)
    run.sleep(30.0)
    run.advance(0.5)
    run.processes[0].stopped = False
    run.advance(1.0)
    assert run.kinds() == []


FAULTS = {
    "power": "{at_s: 2, on: front, do: power_cycle, off_s: 5}",
    "hang": "{at_s: 2, on: front, do: hang, for_s: 5}",
    "unplugged": "{at_s: 2, on: front, do: unplug, for_s: 5}",
    "slow": "{at_s: 2, on: front, do: slow_link, bytes_per_s: 20, for_s: 5}",
    "dropped": "{at_s: 2, on: front, do: drop_telegram, for_s: 5}",
    "mirror": "{at_s: 2, on: front, do: mirror_stuck, told: true, for_s: 5}",
}


@pytest.mark.parametrize(
    ("model", "fault"),
    [
        (model, fault)
        for model in ("sick-lms291-s05", "sick-ld-lrs1000", "can-ars408")
        for fault in (*FAULTS, "none")
        if (model, fault) not in {("can-ars408", "mirror"), ("can-ars408", "slow")}  # it has no such part
    ],
)
def test_silence_on_purpose_is_not_told(model: str, fault: str) -> None:
    text = CASE.replace("MODEL", model)
    if model == "can-ars408":
        text = text[: text.index("  - {id: front")] + (
            "  - {id: eye, model: sick-lms291-s05, device: {delays: fast}, physics: {rule: axis, sub_beams: 1}}\n"
            "  - {id: front, model: can-ars408, from: [eye]}\n"
        )
    long_s = 10  # of it five in silence
    if model == "sick-ld-lrs1000":
        text, long_s = text.replace("start: running", "step_deg: 4, motor_hz: 5"), 13  # its motor takes longer
    text = text.replace("duration_s: 20", f"duration_s: {long_s}")
    if fault != "none":
        text += f"faults:\n  - {FAULTS[fault]}\n"
    case = scenario.loads(text, Path("case.yaml"))
    trial = Trial(case, measuring=InPlace({one.id: lambda plan, *_: Scan.empty(plan) for one in case.sensors}))
    try:
        verdict = trial.finish()
    finally:
        trial.close()
    assert verdict.incidents == ()
    assert verdict.sensors[-1]["scans_sent"] > 5


class NotReading:
    """Whoever measures and never answers."""

    def request(self, sensor: str, plan: ScanPlan, conditions: object = None) -> None:
        pass

    def collect(self, sensor: str) -> list[Scan]:
        return []


def test_in_virtual_time_a_scan_that_never_comes_is_told() -> None:
    case = scenario.loads(CASE.replace("MODEL", "sick-lms291-s05"), Path("case.yaml"))
    trial = Trial(case, measuring=NotReading())
    try:
        verdict = trial.finish()
    finally:
        trial.close()
    assert [row["kind"] for row in verdict.incidents] == ["sensor silent"]
    assert verdict.exit_code == 5
    assert trial.liveness.silent_s("front") > 10


def test_a_sensor_that_takes_long_for_a_sweep_is_slow_and_not_silent(run: Rig) -> None:
    run.stream()
    run.takes_ns = round(1.8 * SECOND)
    run.advance(10.0)
    assert run.kinds() == []
