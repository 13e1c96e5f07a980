"""An FMU of a scenario, driven by FMPy: the same bytes as the same poses by lock-step, and OSI both ways."""

from __future__ import annotations

import ctypes
import json
import struct
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import fmpy
import pytest
from fmpy.fmi1 import FMICallException
from fmpy.fmi2 import FMU2Slave
from fmpy.validation import validate_fmu

from emulator.live.client import Lockstep
from emulator.recording import protowire as wire
from tests.system.nursery import begun, ran

SCENE = """
schema: 1
seed: 3
world:
  - {box: {size_m: [1, 60, 3]}, at_m: [60, 0, 0], material: white_plaster}
actors:
  - {id: ego}
  - {id: car, shape: {box: {size_m: [4, 2, 1.5]}}, material: car_paint_grey, class: car, motion: {at_m: [20, 0, 0]}}
sensors:
  - {id: eye, model: sick-lms291-s05, mount: {actor: ego, at_m: [0, 0, 0.6]}, links: ["pty:./eye"]}
  - {id: radar, model: can-ars408, mount: {actor: ego, at_m: [0, 0, 0.6]}, from: [eye],
     links: ["socketcand:127.0.0.1:0/can0"]}
live: {feed: control, ego: ego}
vehicle_bus:
  link: "socketcand:127.0.0.1:0/can0"
  dbc: "builtin:ars408.dbc"
  actor: ego
  messages:
    EgoSpeed: {signals: {Speed: speed_abs_m_s, Direction: direction}}
    EgoYawRate: {signals: {YawRate: yaw_rate_deg_s}}
"""
STEPS, STEP_S = 20, 0.05


def car_at(number: int) -> float:
    return 20.0 - 0.1 * number


@pytest.fixture(scope="module")
def packed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("fmu")
    (folder / "loop.yaml").write_text(SCENE)
    made = ran("fmu", "loop.yaml", "--out", "loop.fmu", cwd=folder)
    assert made.returncode == 0, made.stderr
    return folder / "loop.fmu"


@contextmanager
def driven(path: Path, folder: Path, logging: bool = True, **strings: str) -> Iterator[SimpleNamespace]:
    about = fmpy.read_model_description(str(path))
    of = {one.name: one.valueReference for one in about.modelVariables}
    unzipped = fmpy.extract(str(path), str(folder / "unzipped"))
    slave = FMU2Slave(
        guid=about.guid, unzipDirectory=unzipped, modelIdentifier=about.coSimulation.modelIdentifier, instanceName="one"
    )
    slave.instantiate(loggingOn=logging)
    slave.setupExperiment(startTime=0.0)
    slave.enterInitializationMode()
    for name, text in strings.items():
        slave.setString([of[name]], [text])
    slave.exitInitializationMode()
    found = SimpleNamespace(slave=slave, of=of, sha256="")
    try:
        yield found
    finally:
        slave.terminate()
        found.sha256 = slave.getString([of["sha256"]])[0].decode()
        slave.freeInstance()


def message_of(found: SimpleNamespace, base: str) -> bytes:
    lo, hi, size = found.slave.getInteger([found.of[f"{base}.{role}"] for role in ("base.lo", "base.hi", "size")])
    return ctypes.string_at((hi & 0xFFFFFFFF) << 32 | lo & 0xFFFFFFFF, size) if size else b""


def by_lockstep(folder: Path, osi: bool) -> tuple[str, int]:
    (folder / "loop.yaml").write_text(SCENE)
    words = ["run", "loop.yaml", "--clock", "virtual", "--no-wait"]
    words += ["--set", "live.feed=lockstep://127.0.0.1:0", "--json", "--until-eof", "--duration", "1e9"]
    sent = 0
    with begun(*words, stdin=subprocess.PIPE, stderr=None, cwd=folder) as run:
        assert run.stdout is not None
        assert run.stdin is not None
        with Lockstep(json.loads(run.stdout.readline())["feed"]) as world:
            for number in range(1, STEPS + 1):
                t_s = round(number * STEP_S, 9)
                if osi:
                    done: dict[str, Any] = world.step_osi(t_s, ground_truth(t_s, number))
                else:
                    ego = {"id": "ego", "at_m": [0.02 * number, 0, 0], "reference": "origin"}
                    car = {"id": "car", "at_m": [car_at(number), 0, 0], "reference": "origin"}
                    done = world.step(t_s, [ego, car])
                sent += done["sent"]["radar"]
        run.stdin.close()
        rows = [json.loads(line) for line in run.stdout]
    return next(row["sha256"] for row in rows if row["event"] == "stopped"), sent


def ground_truth(t_s: float, number: int) -> bytes:
    def moving(key: int, name: str, x: float) -> bytes:
        base = wire.piece(1, wire.doubles((4.0, 2.0, 1.5))) + wire.piece(2, wire.doubles((x, 0.0, 0.75)))
        base += wire.piece(3, wire.doubles((0.0, 0.0, 0.0)))
        entity = wire.piece(10, wire.piece(3, b"entity_name:" + name.encode()))
        return wire.piece(5, wire.piece(1, wire.whole(1, key)) + wire.piece(2, base) + wire.whole(3, 2) + entity)

    head = wire.piece(2, wire.instant(round(t_s * 1e9))) + wire.piece(3, wire.whole(1, 7))
    return head + moving(7, "ego", 0.0) + moving(9, "car", car_at(number) - 6.0)


def test_the_description_holds_by_fmpy_and_names_osmp(packed: Path) -> None:
    assert validate_fmu(str(packed)) == []
    about = fmpy.read_model_description(str(packed))
    names = {one.name for one in about.modelVariables}
    assert about.fmiVersion == "2.0"
    assert {"car.x_m", "OSMPSensorViewIn.base.lo", "OSMPSensorDataOut[2].size", "radar.scans", "sha256"} <= names
    assert fmpy.supported_platforms(str(packed)) == ["linux64"]


def test_poses_by_fmi_give_the_bytes_of_lock_step_and_osi_comes_out(packed: Path, tmp_path: Path) -> None:
    seen = []
    with driven(packed, tmp_path, record=str(tmp_path / "rec")) as found:
        for number in range(1, STEPS + 1):
            found.slave.setReal([found.of["ego.x_m"], found.of["car.x_m"]], [0.02 * number, car_at(number)])
            found.slave.doStep((number - 1) * STEP_S, STEP_S)
            if message := message_of(found, "OSMPSensorDataOut[2]"):
                seen.append(message)
        sent = found.slave.getInteger([found.of["radar.scans"]])[0]
        assert found.slave.getBoolean([found.of["valid"]]) == [True]
        assert b"socketcand" in found.slave.getString([found.of["radar.links"]])[0]
    digest, other = by_lockstep(tmp_path, osi=False)
    assert (found.sha256, sent) == (digest, other)
    assert sent >= 6
    assert (tmp_path / "rec" / "run.mcap").is_file()
    betterosi = pytest.importorskip("betterosi")
    last = betterosi.SensorData.from_binary(seen[-1])
    assert any(abs(one.base.position.x - 16.4) < 2.5 for one in last.moving_object)


def test_a_sensor_view_by_its_pointer_gives_the_bytes_of_its_ground_truth(packed: Path, tmp_path: Path) -> None:
    seen = b""
    with driven(packed, tmp_path) as found:
        for number in range(1, STEPS + 1):
            view = wire.piece(7, ground_truth(round(number * STEP_S, 9), number))
            buffer = ctypes.create_string_buffer(view, len(view))
            address = ctypes.addressof(buffer)
            halves = struct.unpack("<ii", struct.pack("<Q", address))
            names = ("OSMPSensorViewIn.base.lo", "OSMPSensorViewIn.base.hi", "OSMPSensorViewIn.size")
            found.slave.setInteger([found.of[name] for name in names], [*halves, len(view)])
            found.slave.doStep((number - 1) * STEP_S, STEP_S)
            seen = message_of(found, "OSMPSensorDataOut[2]") or seen
    betterosi = pytest.importorskip("betterosi")
    ahead = [one.base.position.x for one in betterosi.SensorData.from_binary(seen).moving_object]
    assert any(abs(x - 12.4) < 1.5 for x in ahead), ahead  # the car, 2 m of it behind its face; it stood at 20 m
    assert found.sha256 == by_lockstep(tmp_path, osi=True)[0]


def test_a_wrong_command_and_a_wrong_pose_are_errors_of_the_fmu_not_of_its_master(
    packed: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    for name, logging in (("one", True), ("silent", False)):
        with pytest.raises(FMICallException), driven(packed, tmp_path / name, logging, lidaremu="/none/lidaremu"):
            pass
        shown, errors = capfd.readouterr()
        assert ("[FATAL]" in shown and "/none/lidaremu: No such file" in shown) == logging
        assert "lidaremu: FMU one: /none/lidaremu: No such file or directory; want lidaremu installed" in errors
    with driven(packed, tmp_path / "two") as found:
        found.slave.setReal([found.of["car.x_m"]], [1e12])
        with pytest.raises(FMICallException):
            found.slave.doStep(0.0, STEP_S)
        found.slave.setReal([found.of["car.x_m"]], [10.0])
        found.slave.doStep(0.0, STEP_S)
