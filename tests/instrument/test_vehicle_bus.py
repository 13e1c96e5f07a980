"""The ego's own motion on CAN, read back by cantools from the same DBC file."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from pathlib import Path

import cantools
import pytest

from emulator.errors import ScenarioError
from emulator.instrument.observer import Observer, Payload
from emulator.instrument.vehicle_bus import VehicleSession
from emulator.judging.trial import Trial
from emulator.live.json_lines import update_of
from emulator.recording.reader import read_run
from emulator.scenario.scenario import Scenario, dump, load, loads
from emulator.scenario.vehicle_options import dbc_path
from emulator.world.ego import EgoMotion
from protocols.can_objects.layout import database_of

DBC = cantools.database.load_file(str(dbc_path("builtin:vehicle.dbc", Path())))
BUS = """
vehicle_bus:
  link: "socketcand:127.0.0.1:29536/can0"
  dbc: "builtin:vehicle.dbc"
  actor: ego
  wheelbase_m: 2.7
  steering_ratio: 16
  messages:
    VehicleMotion:
      signals: {Speed: speed_km_h, YawRate: yaw_rate_deg_s, Direction: direction, SpeedValid: 1, Counter: counter}
    VehicleSteering: {signals: {WheelAngle: steering_deg, SteeringWheelAngle: steering_wheel_deg}}
"""
DRIVE = "schema: 1\nduration_s: 1\nactors:\n  - {id: ego, motion: {velocity_m_s: [10, 0, 0]}}\n"


class Frames(Observer):
    """What the vehicle sent: instants and bytes by message."""

    def __init__(self, sensor: str = "vehicle_bus") -> None:
        self.sensor = sensor
        self.of: dict[int, list[Payload]] = {}

    def payload(self, payload: Payload) -> None:
        if payload.sensor == self.sensor and payload.sent:
            self.of.setdefault(payload.peer, []).append(payload)

    def decoded(self, name: str) -> list[dict[str, float]]:
        number = DBC.get_message_by_name(name).frame_id
        return [dict(DBC.decode_message(number, one.data, decode_choices=False)) for one in self.of[number]]


def heard(scenario: Scenario, workers: int = 0, record: Path | None = None) -> tuple[Frames, Trial]:
    frames = Frames()
    trial = Trial(scenario, workers, [frames], record)
    try:
        trial.finish()
    finally:
        trial.close()
    return frames, trial


def circle(folder: Path, speed: float, radius: float, seconds: float = 1.0) -> Scenario:
    """An ego that a feed moves on a circle to the left; backwards with a negative speed."""
    rows = []
    for number in range(round(seconds * 100) + 1):
        turn = speed / radius * number * 0.01
        rows.append(
            {
                "t_s": number * 0.01,
                "actors": [
                    {
                        "id": "ego",
                        "reference": "origin",
                        "at_m": [radius * math.sin(turn), radius * (1.0 - math.cos(turn)), 0.0],
                        "yaw_deg": math.degrees(turn),
                        "velocity_m_s": [speed * math.cos(turn), speed * math.sin(turn), 0.0],
                        "turn_rate_deg_s": math.degrees(speed / radius),
                    }
                ],
            }
        )
    (folder / "way.jsonl").write_text("".join(json.dumps(row) + "\n" for row in rows))
    text = DRIVE.replace("[10, 0, 0]", "[0, 0, 0]").replace("duration_s: 1", f"duration_s: {seconds}")
    return loads(text + "live: {feed: 'json-file:way.jsonl', ego: ego}" + BUS, folder / "circle.yaml")


def test_a_decoder_reads_the_true_speed_at_the_cycle_of_the_dbc_file() -> None:
    frames, _ = heard(loads(DRIVE + BUS, Path("drive.yaml")))
    motion, steering = frames.decoded("VehicleMotion"), frames.decoded("VehicleSteering")
    assert all(abs(one["Speed"] - 36.0) <= 0.005 for one in motion)
    assert {(one["YawRate"], one["Direction"], one["SpeedValid"]) for one in motion} == {(0.0, 1, 1)}
    assert [one["Counter"] for one in motion] == [number % 16 for number in range(100)] + [4][: len(motion) - 100]
    assert len(steering) in (50, 51)
    assert [one.start_ns for one in frames.of[257]] == [number * 10_000_000 for number in range(len(motion))]


@pytest.mark.parametrize("speed", [15.0, -3.0])
def test_a_fed_ego_on_a_circle_tells_its_turn_and_the_angle_of_its_wheels(tmp_path: Path, speed: float) -> None:
    frames, _ = heard(circle(tmp_path, speed, 30.0))
    wheel = math.degrees(math.atan(2.7 / 30.0))
    for one in frames.decoded("VehicleMotion")[2:]:
        assert one["Speed"] == pytest.approx(3.6 * speed, abs=0.02)
        assert one["YawRate"] == pytest.approx(math.degrees(speed / 30.0), abs=0.02)
        assert one["Direction"] == (1 if speed > 0 else 2)
    for one in frames.decoded("VehicleSteering")[2:]:
        assert one["WheelAngle"] == pytest.approx(wheel, abs=0.01)
        assert one["SteeringWheelAngle"] == pytest.approx(16.0 * wheel, abs=0.1)


def test_workers_and_a_recording_change_nothing_and_the_recording_has_it(tmp_path: Path) -> None:
    scenario = load("vehicle_bus", ["duration_s=0.3"])
    _, one = heard(scenario)
    _, two = heard(scenario, workers=1, record=tmp_path / "rec")
    assert one.transcript.sha256() == two.transcript.sha256()
    found = read_run(tmp_path / "rec").sent["vehicle_bus", 0].payloads
    assert {row.peer for row in found} == {257, 258}
    assert len(found) >= 45
    assert list((tmp_path / "rec").glob("*.log"))


def test_a_fed_ego_gives_the_same_frames_again_from_its_recording(tmp_path: Path) -> None:
    feed = "live: {feed: FEED, ego: ego}"
    digests = []
    for where in ("control", f"recording:{tmp_path / 'rec'}"):
        text = DRIVE.replace("duration_s: 1", "duration_s: 0.2") + feed.replace("FEED", json.dumps(where)) + BUS
        trial = Trial(loads(text, tmp_path / "fed.yaml"), record=None if digests else tmp_path / "rec")
        assert trial.feeding is not None
        for number in range(1 if digests else 0, 1 if digests else 21):
            at = {"id": "ego", "reference": "origin", "at_m": [0.5 * (number * 0.01) ** 2, 0, 0], "yaw_deg": number}
            trial.feeding.take(update_of({"t_s": number * 0.01, "actors": [at]}), trial.run.clock.now_ns(), again=True)
            trial.run.advance(number * 10_000_000)
        digests.append(trial.finish().sha256)
        trial.close()
    assert digests[0] == digests[1]


def test_a_radar_on_the_same_bus_takes_the_ego_motion_from_it() -> None:
    text = """
schema: 1
duration_s: 2
world: [{box: {size_m: [1, 1, 1]}, at_m: [20, 0, 0.5], material: concrete}]
actors: [{id: ego, motion: {velocity_m_s: [5, 0, 0]}}]
sensors:
  - {id: eye, model: sick-lms291-s05, mount: {actor: ego, at_m: [0, 0, 0.6]}, links: ["pty:./eye"]}
  - {id: radar, model: can-ars408, mount: {actor: ego}, from: [eye], links: ["socketcand:127.0.0.1:29536/can0"]}
"""
    bus = """
vehicle_bus:
  link: "socketcand:127.0.0.1:29536/can0"
  dbc: "builtin:ars408.dbc"
  actor: ego
  messages:
    EgoSpeed: {signals: {Speed: speed_abs_m_s, Direction: direction}}
    EgoYawRate: {signals: {YawRate: yaw_rate_deg_s}}
"""
    missing = []
    layout = cantools.database.load_file(str(dbc_path("builtin:ars408.dbc", Path())))
    for more in ("", bus):
        frames = Frames("radar")
        trial = Trial(loads(text + more, Path("radar.yaml")), watchers=[frames])
        trial.finish()
        trial.close()
        state = layout.decode_message("SensorState", frames.of[0x201][-1].data, decode_choices=False)
        missing.append(state["MotionInput"])
    assert missing[0] != 0
    assert missing[1] == 0


def test_a_value_beyond_its_signal_is_sent_as_the_limit_and_told_once() -> None:
    frames, trial = heard(loads(DRIVE.replace("[10, 0, 0]", "[80, 0, 0]") + BUS, Path("fast.yaml")))
    assert {one["Speed"] for one in frames.decoded("VehicleMotion")} == {250.0}
    assert trial.incidents.rows() == [
        {
            "kind": "signal limited",
            "at_s": 0.0,
            "on": "vehicle_bus",
            "text": "VehicleMotion.Speed: 288 is beyond the signal's limits; 250 is sent",
        }
    ]
    assert trial.incidents.exit_code == 0


def session(text: str) -> VehicleSession:
    scenario = loads(text, Path("late.yaml"))
    assert scenario.vehicle_bus is not None
    database = database_of(dbc_path(scenario.vehicle_bus.dbc, scenario.folder))
    return VehicleSession(scenario.vehicle_bus, database, EgoMotion(scenario, "ego"))


def test_a_process_that_did_not_run_sends_no_burst_and_counts_what_it_skipped() -> None:
    found = session(DRIVE + BUS)
    found.power_on(0)
    assert [one.due_ns for one in found.take_emissions(0)] == [0, 0]
    late = found.take_emissions(1_000_000_000)
    assert [(one.label, one.due_ns) for one in late] == [("VehicleMotion", 10**9), ("VehicleSteering", 10**9)]
    assert found.account() == {
        "frames": {"VehicleMotion": 2, "VehicleSteering": 2},
        "skipped": {"VehicleMotion": 99, "VehicleSteering": 49},
        "limited": {},
    }
    assert found.next_deadline() == 1_010_000_000


def test_where_it_stands_the_wheels_stay_as_they_were_and_a_jump_is_not_told() -> None:
    way = (
        "schema: 1\nduration_s: 4\nactors:\n  - id: ego\n    motion:\n      waypoints:\n"
        "        - {t_s: 0, at_m: [0, 0, 0]}\n        - {t_s: 1, at_m: [5, 0, 0], yaw_deg: 30}\n"
        "        - {t_s: 2, at_m: [5, 0, 0], yaw_deg: 30}\n        - {t_s: 2.001, at_m: [900, 0, 0], yaw_deg: 30}\n"
    )
    ego = EgoMotion(loads(way + BUS, Path("way.yaml")), "ego")
    moving = ego.at(10_000_000)
    assert moving.steering_rad(2.7) > 0.1
    standing = ego.at(1_500_000_000)
    assert (standing.speed_m_s, standing.yaw_rate_rad_s) == (0.0, 0.0)
    assert standing.steering_rad(2.7) == moving.steering_rad(2.7)
    assert ego.at(2_000_500_000) == standing
    assert ego.at(3_000_000_000).speed_m_s == 0.0


def test_an_absolute_place_of_the_dbc_file_goes_into_what_is_dumped(tmp_path: Path) -> None:
    (tmp_path / "own.dbc").write_text(dbc_path("builtin:vehicle.dbc", Path()).read_text())
    scenario = loads(DRIVE + BUS.replace("builtin:vehicle.dbc", "own.dbc"), tmp_path / "own.yaml")
    assert f"dbc: {tmp_path / 'own.dbc'}" in dump(scenario)


E2E = """VERSION ""
BU_: A
BO_ 5 Plain: 8 A
 SG_ Speed : 0|16@1+ (0.01,0) [0|0] "m/s" A
 SG_ Count : 16|4@1+ (1,0) [0|15] "" A
 SG_ Real : 32|32@1- (1,0) [0|0] "" A
BO_ 6 Safe: 8 A
 SG_ Speed : 0|16@1+ (0.01,0) [0|0] "m/s" A
BO_ 7 Summed: 8 A
 SG_ Speed : 0|16@1+ (0.01,0) [0|0] "m/s" A
 SG_ Crc : 56|8@1+ (1,0) [0|0] "" A
BO_ 8 Chosen: 8 A
 SG_ M M : 0|2@1+ (1,0) [0|0] "" A
 SG_ Speed m0 : 8|16@1+ (0.01,0) [0|0] "m/s" A
BO_ 9 Long: 16 A
 SG_ Speed : 0|16@1+ (0.01,0) [0|0] "m/s" A
BA_DEF_ BO_ "E2EDataId" INT 0 65535;
BA_DEF_ SG_ "SigType" ENUM "Default","MessageCounter","MessageChecksum";
BA_DEF_DEF_ "E2EDataId" 0;
BA_DEF_DEF_ "SigType" "Default";
BA_ "E2EDataId" BO_ 6 77;
BA_ "SigType" SG_ 5 Count 1;
BA_ "SigType" SG_ 7 Crc 2;
SIG_VALTYPE_ 5 Real : 1;
"""


@pytest.mark.parametrize(
    ("changes", "reported"),
    [
        ([("actor: ego", "actor: eko")], ["vehicle_bus.actor: 'eko'; want one of ego"]),
        ([("socketcand:127.0.0.1:29536/can0", "pty:./can")], ["vehicle_bus.link: 'pty:./can'; want a link of socket"]),
        ([("socketcand:127.0.0.1:29536/can0", "socketcand:nowhere")], ["vehicle_bus.link: "]),
        (
            [("builtin:vehicle.dbc", "builtin:vehicel.dbc")],
            ["vehicle_bus.dbc: 'builtin:vehicel.dbc': no such file; want"],
        ),
        ([("builtin:vehicle.dbc", "none.dbc")], ["vehicle_bus.dbc: 'none.dbc': no such file; want a DBC file"]),
        ([("builtin:vehicle.dbc", "bad.dbc")], ["vehicle_bus.dbc: 'bad.dbc': "]),
        (
            [("VehicleMotion:", "VehicleMotoin:")],
            ["vehicle_bus.messages.VehicleMotoin: 'VehicleMotoin': not in builtin"],
        ),
        ([("Speed: speed_km_h", "Sped: speed_km_h")], ["signals.Sped: 'Sped': not in VehicleMotion; want Speed"]),
        ([("speed_km_h", "speed_kmh")], ["signals.Speed: 'speed_kmh'; want a number, or speed_km_h"]),
        ([("SpeedValid: 1", "SpeedValid: 2")], ["signals.SpeedValid: 2; want -1e-06 to 1, the limits of SpeedValid"]),
        ([("wheelbase_m: 2.7", "")], ["signals.WheelAngle: steering_deg without vehicle_bus.wheelbase_m"]),
        (
            [("steering_ratio: 16", "")],
            ["signals.SteeringWheelAngle: steering_wheel_deg without vehicle_bus.steering_"],
        ),
        ([("link:", "lnk: 3\n  link:")], ["vehicle_bus.lnk"]),
        (
            [("can0", "can0?bitrate=10000")],
            ["vehicle_bus.messages: 18650 bit/s at most", "no more than the bus carries: 10000 bit/s"],
        ),
    ],
)
def test_check_tells_file_line_and_key(
    changes: Sequence[tuple[str, str]], reported: Sequence[str], tmp_path: Path
) -> None:
    (tmp_path / "bad.dbc").write_bytes(b"VERSION \xff\x00 BO_ x")
    text = BUS
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    with pytest.raises(ScenarioError) as caught:
        loads(DRIVE + text, tmp_path / "bus.yaml")
    assert all(one in str(caught.value) for one in reported), str(caught.value)
    assert all(line.startswith(f"{tmp_path / 'bus.yaml'}:") for line in caught.value.lines)


@pytest.mark.parametrize(
    ("message", "reported"),
    [
        ("Plain: {signals: {Speed: speed_m_s, Count: counter}}", "cycle_ms: missing, and Plain has no GenMsgCycleTime"),
        (
            "Plain: {cycle_ms: 10, signals: {Speed: speed_m_s}}",
            "Count is a message counter (SigType); want Count: counter",
        ),
        ("Plain: {cycle_ms: 10, signals: {Real: speed_m_s, Count: counter}}", "Real is a floating-point signal"),
        ("Plain: {cycle_ms: 10, signals: {Speed: counter, Count: counter}}", "counter in Speed, which is scaled"),
        ("Plain: {cycle_ms: 0.2, signals: {Count: counter}}", "cycle_ms: 0.2"),
        ("Plain: {cycle_ms: 10, signals: {}}", "signals"),
        ("Safe: {cycle_ms: 10, signals: {Speed: speed_m_s}}", "Safe is protected end to end: E2EDataId"),
        ("Summed: {cycle_ms: 10, signals: {Speed: speed_m_s}}", "Summed.Crc is a checksum (SigType)"),
        ("Chosen: {cycle_ms: 10, signals: {Speed: speed_m_s}}", "Chosen is multiplexed"),
        ("Long: {cycle_ms: 10, signals: {Speed: speed_m_s}}", "Long has 16 bytes"),
    ],
)
def test_what_a_dbc_file_asks_for_and_is_not_sent_is_refused_by_name(
    message: str, reported: str, tmp_path: Path
) -> None:
    (tmp_path / "own.dbc").write_text(E2E)
    text = f"vehicle_bus:\n  link: 'slcan:./can'\n  dbc: own.dbc\n  actor: ego\n  messages:\n    {message}\n"
    with pytest.raises(ScenarioError) as caught:
        loads(DRIVE + text, tmp_path / "bus.yaml")
    assert reported in str(caught.value)
    good = text.replace(message, "Plain: {cycle_ms: 10, signals: {Speed: speed_m_s, Count: counter}}")
    assert loads(DRIVE + good, tmp_path / "bus.yaml").vehicle_bus is not None


def test_a_sensor_cannot_have_its_name_nor_a_stream_its_port() -> None:
    sensor = "sensors: [{id: %s, model: hokuyo-ust-10lx, links: ['tcp:127.0.0.1:29536']}]\n"
    with pytest.raises(ScenarioError, match=r"sensors\.vehicle_bus\.id: 'vehicle_bus'; want another id"):
        loads(DRIVE + sensor % "vehicle_bus" + BUS.replace("29536", "29537"), Path("name.yaml"))
    with pytest.raises(ScenarioError, match=r"vehicle_bus\.link: .* is also a link of eye"):
        loads(DRIVE + sensor % "eye" + BUS, Path("port.yaml"))
