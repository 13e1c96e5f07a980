"""A telegram that a request cuts off: what leaves on the line, what is recorded, and what is read again."""

from __future__ import annotations

from pathlib import Path

import pytest

from emulator.instrument.observer import Observer
from emulator.judging.trial import Trial
from emulator.recording.reader import read_run
from emulator.scenario import scenario
from emulator.transports.loopback import LoopLink

CASE = """\
schema: 1
duration_s: 4
world:
  - {plane: {size_m: [6, 60]}, at_m: [8, 0, 1], pitch_deg: -90, material: white_plaster}
sensors:
  - {id: front, model: sick-lms291-s05, mount: {at_m: [0, 0, 1]}, device: {interrupt: INTERRUPT}}
"""
START, STATUS = bytes.fromhex("02 00 02 00 20 24 34 08"), bytes.fromhex("02 00 01 00 31 15 12")
REPLY = bytes.fromhex("06 02 80 9A 00 B1")


@pytest.mark.parametrize("interrupt", ["abort", "finish"])
def test_a_host_reads_and_a_recording_tells_what_left_of_a_cut_telegram(
    interrupt: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Trial, "_host_of", lambda *args: None)
    trial = Trial(scenario.loads(CASE.replace("INTERRUPT", interrupt), Path("case.yaml")), record=tmp_path / "run")
    link = trial.instruments[0].links[0]
    assert isinstance(link, LoopLink)
    cuts: list[int] = []
    watcher = Observer()
    watcher.cut = lambda sensor, index, end_ns: cuts.append(end_ns)  # type: ignore[method-assign]
    trial.instruments[0].watch(watcher)
    host = link.connect(0, 9600)
    host.write(START, 0)
    trial.run.advance(500_000_000)
    asked_ns = host.write(STATUS, trial.run.clock.now_ns())
    trial.run.advance(asked_ns + 250_000_000)
    at_ns = trial.run.clock.now_ns()
    trial.close()
    read = host.read()
    recorded = read_run(tmp_path / "run").sent["front", 0].payloads
    whole = b"".join(one.data for one in recorded if one.end_ns <= at_ns)
    if interrupt == "finish":
        assert not cuts
        assert REPLY not in read
        assert read.startswith(whole)
        return
    assert read == whole
    assert REPLY in read
    short = next(one for one in recorded if one.data[4:5] == b"\xb0" and len(one.data) < 732)
    assert [short.end_ns] == cuts
    ack = recorded[recorded.index(short) + 1]
    assert ack.data == b"\x06"
    assert ack.start_ns >= short.end_ns
    assert ack.end_ns - asked_ns <= 60_000_000
