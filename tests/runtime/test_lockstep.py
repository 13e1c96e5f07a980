"""Lock-step: the same lines give the same bytes, whoever measures, and from a recording; wrong lines are told."""

from __future__ import annotations

import json
import os
import select
import tty
from collections.abc import Callable
from pathlib import Path
from threading import Event, Thread, current_thread

import pytest
from click.testing import CliRunner

from emulator.commands.recordings import replay
from emulator.errors import LinkError
from emulator.judging.rig import Rig
from emulator.judging.trial import Trial
from emulator.live.client import Lockstep
from emulator.live.json_lines import update_of
from emulator.runtime import lockstep
from emulator.scenario.scenario import load
from protocols.lms2xx.telegrams import request

SCENE = """
schema: 1
seed: 3
duration_s: 0.6
world:
  - {box: {size_m: [1, 60, 3]}, at_m: [40, 0, 0], material: white_plaster}
actors:
  - {id: ego, motion: {at_m: [0, 0, 0]}}
  - {id: car, shape: {box: {size_m: [4, 2, 1.5]}}, material: car_paint_grey, class: car, motion: {at_m: [20, 0, 0]}}
sensors:
  - {id: front, model: sick-lms291-s05, mount: {actor: ego, at_m: [0, 0, 0.6]}, links: ["pty:./front"]}
live: {feed: "FEED", ego: ego, actors: {spawn: true, pool: 4}}
"""


@pytest.fixture
def scene(tmp_path: Path) -> Callable[[str], str]:
    def make(feed: str) -> str:
        path = tmp_path / f"scene{abs(hash(feed))}.yaml"
        path.write_text(SCENE.replace("FEED", feed))
        return str(path)

    return make


def actors(t: float) -> list[dict[str, object]]:
    found: list[dict[str, object]] = [
        {"id": "ego", "at_m": [5 * t, 0, 0], "reference": "origin", "velocity_m_s": [5, 0, 0]},
        {"id": "car", "at_m": [20 - 20 * t * t, 0.5, 0], "reference": "origin", "velocity_m_s": [-40 * t, 0, 0]},
    ]
    if 0.2 < t < 0.45:
        found.append({"id": "walker", "at_m": [8, -3 + 4 * t, 0.9], "size_m": [0.5, 0.6, 1.8], "class": "pedestrian"})
    return found


def stepped(path: str, step_s: float, workers: int = 0, record: Path | None = None) -> tuple[str, list[float]]:
    trial = Trial(load(path), workers, record=record)
    assert trial.feeding is not None
    seen: list[float] = []
    try:
        for k in range(1, round(0.6 / step_s) + 1):
            t = k * step_s
            update = update_of({"t_s": t, "actors": actors(t), "snapshot": True})
            trial.feeding.take(update, trial.run.clock.now_ns(), again=True)
            trial.run.advance(round(t * 1e9))
        digest = trial.finish().sha256
        assert trial.instruments[0].stats.scans_sent > 5
    finally:
        trial.close()
    return digest, seen


def test_the_same_feed_gives_the_same_bytes_for_any_workers_and_from_its_recording(
    scene: Callable[[str], str], tmp_path: Path
) -> None:
    path = scene("control")
    digest, _ = stepped(path, 0.01, record=tmp_path / "run")
    assert stepped(path, 0.01)[0] == digest
    for workers in (1, 2, 3):  # of which each has its part of every sweep
        assert stepped(path, 0.01, workers)[0] == digest
    again = Trial(load(path, [f"live.feed=recording:{tmp_path / 'run'}"]))
    try:
        assert again.finish().sha256 == digest
    finally:
        again.close()
    reported = CliRunner().invoke(replay, [str(tmp_path / "run"), "--world", "--json"], standalone_mode=False)
    assert json.loads(reported.output)["sha256"] == digest
    still = Trial(load(path))
    try:
        assert still.finish().sha256 != digest, "the feed is seen"
    finally:
        still.close()


def test_a_feeder_moves_time_and_learns_what_was_sent(scene: Callable[[str], str], tmp_path: Path) -> None:
    with Rig(scene("lockstep://127.0.0.1:0"), tmp_path) as rig:
        assert rig.feed_url is not None
        with Lockstep(rig.feed_url) as world:
            assert (world.t_s, world.sensors) == (0.0, ["front"])
            done = world.step(0.05, actors(0.05), seq=1)
            assert (done["t_s"], done["seq"], done["sent"]) == (0.05, 1, {"front": 0})
            assert rig.now_s == pytest.approx(0.05)
            world.ask({"op": "update", "t_s": 0.06, "actors": actors(0.06)})
            assert rig.now_s == pytest.approx(0.05)
            world.step(0.06)
        assert rig.now_s == pytest.approx(0.06), "time stands when the feeder has gone"


@pytest.mark.parametrize(
    ("line", "why"),
    [
        (b"[]", "want an object"),
        (b"{nonsense", "line:"),
        (b'{"op": "dance"}', "want one of hello"),
        (b'{"op": "step"}', "t_s: none"),
        (b'{"op": "step", "t_s": 0.01}', "is past"),
        (b'{"op": "step", "t_s": 11}', "at most 10 s"),
        (b'{"op": "step", "t_s": NaN}', "t_s"),
        (b'{"op": "step", "t_s": 1, "actors": [{"id": 1}]}', "at_m: none"),
        (b'{"op": "step", "t_s": 1, "osi": -1}', "osi"),
        (b'{"op": "step", "t_s": 1, "want": ["truth"]}', "want: ['truth']; want ['osi']"),
        (b'{"op": "step", "t_s": 1, "want": {"osi": 1}}', "want ['osi']"),
        (b'{"op": "step", "t_s": 1, "osi": 0, "osi_type": ["SensorView"]}', "want one of GroundTruth, SensorView"),
        (b'{"op": "step", "t_s": 1, "osi": 0, "osi_type": "SensorView"}', "global_ground_truth: none"),
        (b'{"op": "hello", "protocol": 2}', "want 1"),
    ],
)
def test_a_wrong_line_is_told_and_changes_nothing(
    line: bytes, why: str, scene: Callable[[str], str], tmp_path: Path
) -> None:
    with Rig(scene("lockstep://127.0.0.1:0"), tmp_path) as rig, Lockstep(str(rig.feed_url)) as world:
        world.step(0.02)
        world._socket.sendall(line + b"\n")
        answer = json.loads(world._file.readline())
        assert answer["op"] == "error"
        assert why in answer["why"]
        assert rig.now_s == pytest.approx(0.02)
        world.step(0.03)


@pytest.mark.parametrize("talks", [True, False])
def test_the_end_waits_for_no_look(
    talks: bool, scene: Callable[[str], str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    limits: list[object] = []
    real = select.poll

    class Poll:
        def __init__(self) -> None:
            self.poll_ = real()
            self.register = self.poll_.register

        def poll(self, *limit: object) -> object:
            if current_thread().name == "lidaremu-lockstep":
                limits.extend(limit)
            return self.poll_.poll(*limit)

    monkeypatch.setattr(lockstep.select, "poll", Poll)
    monkeypatch.delattr(lockstep.select, "select")  # nor that one, which has a limit in each use of it here
    with Rig(scene("lockstep://127.0.0.1:0"), tmp_path) as rig:
        server = rig._lockstep
        assert server is not None
        if talks:
            world = Lockstep(str(rig.feed_url))
            world.step(0.02)
        server.close()
        assert not server._thread.is_alive()
        if talks:
            world.close()
        rig._lockstep = None
    assert limits == []


def test_nobody_listens_where_nobody_runs() -> None:
    with pytest.raises(LinkError, match="want"):
        Lockstep("json-udp://127.0.0.1:1")


def test_a_run_with_an_outside_host_is_replayed_with_what_that_host_said(
    scene: Callable[[str], str], tmp_path: Path
) -> None:
    over = Event()

    def read(port: int) -> None:
        while not over.is_set():
            if select.select([port], [], [], 0.05)[0]:
                os.read(port, 65536)

    with Rig(scene("lockstep://127.0.0.1:0"), tmp_path) as rig, Lockstep(str(rig.feed_url)) as world:
        port = os.open(rig["front"].path, os.O_RDWR | os.O_NOCTTY)
        tty.setraw(port)
        reader = Thread(target=read, args=(port,))
        reader.start()
        try:
            for k in range(1, 61):
                if k == 10:  # a continuous stream at 9600 Bd, which no built-in host asks for so
                    os.write(port, request(b"\x20\x24"))
                    while not rig.instruments[0].links[0].stats.bytes_in:
                        world.step(rig.now_s + 0.001)
                t_s = min(round(rig.now_s + 0.01, 9), 0.6)
                if t_s > rig.now_s:
                    world.step(t_s, actors(t_s))
        finally:
            over.set()
            reader.join()
            os.close(port)
        digest = rig._transcript.sha256()
        assert rig.instruments[0].stats.scans_sent > 0
    reported = CliRunner().invoke(replay, [str(rig.recording), "--world", "--json"], standalone_mode=False)
    assert json.loads(reported.output)["sha256"] == digest
