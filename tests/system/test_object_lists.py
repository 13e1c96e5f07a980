"""The whole chain with stock clients: echoes of a scenario, object lists, a CAN bus, another process with python-can.

`lidaremu run` is started as a user would; readers are a few lines around `can.Bus`; cantools decodes what they saw.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Callable, Sequence
from importlib.resources import files
from pathlib import Path
from typing import Any

import cantools
import pytest

from tests.protocols.can_objects.test_ars408_filters import command

READER = """
import sys, can, json
bus, wanted, tell = can.Bus(**json.loads(sys.argv[1])), int(sys.argv[2]), json.loads(sys.argv[3])
print("ready", flush=True)
while (message := bus.recv(60.0)) is not None:
    print(f"{message.arbitration_id:X} {bytes(message.data).hex()}", flush=True)
    if message.arbitration_id == 0x60A:
        wanted -= 1
        if wanted == 0:
            break
        if tell and wanted == tell[0]:
            bus.send(can.Message(arbitration_id=tell[1], data=bytes.fromhex(tell[2]), is_extended_id=False))
bus.shutdown()
"""
"Prints every frame until it has seen so many lists; sends a frame when so many are left."

YARD = """\
schema: 1
actors:
  - {id: near, class: car, shape: {box: {size_m: [4, 2, 2]}}, material: white_plaster, motion: {at_m: [12, 2, 0]}}
  - {id: middle, class: car, shape: {box: {size_m: [4, 2, 2]}}, material: white_plaster, motion: {at_m: [20, -3, 0]}}
  - {id: far, class: car, shape: {box: {size_m: [4, 2, 2]}}, material: white_plaster, motion: {at_m: [30, 0.5, 0]}}
sensors:
  - {id: scanner, model: sick-lms291-s05, mount: {at_m: [0, 0, 1]}, device: {field_deg: 100}, links: ["pty:./lms"]}
  - {id: one, model: can-ars408, from: [scanner], mount: {at_m: [0, 0, 1]}, links: ["BUS"]}
"""
MORE = """\
  - {id: two, model: can-ars408, from: [scanner], mount: {at_m: [0, 0, 1]}, device: {sensor_id: 1}, links: ["BUS"]}
  - {id: three, model: can-ldmrs, from: [scanner], mount: {at_m: [0, 0, 1]}, links: ["BUS"]}
"""
Frames = list[tuple[int, bytes]]


def socketcand_bus(url: str) -> dict[str, object]:
    address, _, channel = url.partition(":")[2].partition("/")
    host, _, port = address.rpartition(":")
    return {"interface": "socketcand", "host": host, "port": int(port), "channel": channel}


def reader(bus: dict[str, object], lists: int, tell: Sequence[object] = ()) -> subprocess.Popen[str]:
    arguments = [sys.executable, "-c", READER, json.dumps(bus), str(lists), json.dumps(list(tell))]
    environment = dict(os.environ) | {"PYTHONUNBUFFERED": "1"}
    return subprocess.Popen(arguments, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True, env=environment)


def frames(process: subprocess.Popen[str]) -> Frames:
    output, _ = process.communicate(timeout=120)
    return [frame(line) for line in output.splitlines() if line != "ready"]


def frame(line: str) -> tuple[int, bytes]:
    identifier, _, data = line.partition(" ")
    return int(identifier, 16), bytes.fromhex(data)


def layout(name: str) -> Any:
    return cantools.database.load_file(str(files("protocols.can_objects").joinpath(name)))


def lists_of(seen: Frames, shift: int = 0) -> list[list[dict[str, Any]]]:
    """Whole lists of one ARS408: the objects of each, as cantools decodes them."""
    database, found = layout("ars408.dbc"), []
    wanted = []
    for peer, data in seen:
        if peer == 0x60A + shift:
            found.append([])
            wanted.append(database.decode_message(0x60A, data)["NumObjects"])
        elif peer == 0x60B + shift and found:
            found[-1].append(database.decode_message(0x60B, data, decode_choices=False))
    assert [len(rows) for rows in found[:-1]] == wanted[:-1]
    return found[:-1]


def test_a_stock_client_sees_the_road_users_of_the_built_in_scenario(daemon: Callable[..., Any]) -> None:
    running = daemon(
        "fog_objects", "--link", "radar=socketcand:127.0.0.1:0/can0", "--set", "weather.changes=[]"
    )  # whenever the host comes, there is no fog yet
    seen = frames(reader(socketcand_bus(running.link("radar")), 30))
    database = layout("ars408.dbc")
    for peer, data in seen:
        database.decode_message(peer, data)
    last = sorted((row["DistLong"], row["DistLat"]) for row in lists_of(seen)[-1])
    for x, y in ((8.3, -2.1), (16.4, 2.6), (42.4, 1.8)):
        assert min(abs(a - x) + abs(b - y) for a, b in last) < 2.6
    assert running.stop() == 0
    figures = running.end["radar"]["objects"]
    assert figures["lists"] >= 30
    assert figures["total"]["recall"] > 0.8
    assert {"cyclist", "courier", "car", "lorry"} <= set(figures["by_actor"])


def test_sensors_share_a_bus_and_a_filter_of_one_host_holds_from_the_next_list(
    daemon: Callable[..., Any], tmp_path: Path
) -> None:
    scenario = tmp_path / "yard.yaml"
    scenario.write_text((YARD + MORE).replace("BUS", "socketcand:127.0.0.1:0/can0"), encoding="utf-8")
    running = daemon(str(scenario))
    assert len({running.link(name) for name in ("one", "two", "three")}) == 1
    bus = socketcand_bus(running.link("one"))
    identifier, _, data = command(0, 0, 1).partition(" ")
    other = reader(bus, 10_000)
    assert other.stdout is not None
    assert other.stdout.readline() == "ready\n"
    said = int(identifier, 16), data.replace(" ", "")
    mine, theirs = frames(reader(bus, 40, (32, *said))), []
    with other:
        for line in other.stdout:  # it hears what the host says, and the answer
            theirs.append(frame(line))
            if theirs[-1][0] == 0x203 and (0x202, bytes.fromhex(data)) in theirs:
                break
            if len(theirs) % 4000 == 0:  # so busy a machine that it has read too slowly and lost them: said again
                frames(reader(bus, 3, (2, *said)))
        other.terminate()
    counts = [len(rows) for rows in lists_of(mine)]
    # the list in which the device answered was in flight, at the latest the one after the next obeys
    answered = next(index for index, (peer, _) in enumerate(mine) if peer == 0x203)
    before = sum(peer == 0x60A for peer, _ in mine[:answered])
    assert before >= 8
    assert set(counts[3 : before - 1]) == {3}  # an object is listed when it has been seen twice
    assert len(counts) > before + 1
    assert set(counts[before + 1 :]) == {1}
    assert {len(rows) for rows in lists_of(mine, 0x10)[3:]} == {3}
    assert (0x202, bytes.fromhex(data)) in theirs
    assert 0x203 in {peer for peer, _ in theirs}
    ldmrs = layout("ldmrs.dbc")
    ours = [(peer, data) for peer, data in mine if 0x500 <= peer <= 0x50F]
    assert {ldmrs.get_message_by_frame_id(peer).name for peer, _ in ours} >= {"ListHeader", "ObjTrack1", "ListTrailer"}
    for peer, data in ours:
        ldmrs.decode_message(peer, data)
    assert running.stop() == 0


def test_a_stock_client_sees_the_lists_over_an_slcan_adapter(daemon: Callable[..., Any], tmp_path: Path) -> None:
    scenario = tmp_path / "yard.yaml"
    scenario.write_text(YARD.replace("BUS", "slcan:./adapter"), encoding="utf-8")
    running = daemon(str(scenario))
    bus = {"interface": "slcan", "channel": str(tmp_path / "adapter"), "bitrate": 500_000, "sleep_after_open": 0.1}
    seen = frames(reader(bus, 12))
    complete = lists_of(seen[next(k for k, (peer, _) in enumerate(seen) if peer == 0x60A) :])
    assert len(complete) >= 10
    for rows in complete[3:]:
        assert sorted(row["DistLong"] for row in rows) == pytest.approx([12.0, 20.0, 30.0], abs=2.2)
    assert running.stop() == 0
