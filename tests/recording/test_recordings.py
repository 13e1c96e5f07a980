"""Recordings: everything of a run is in it, wherever it is cut, and others' tools and ours read it."""

from __future__ import annotations

import json
import struct
from dataclasses import replace
from pathlib import Path

import can
import numpy as np
import pytest
from mcap.reader import make_reader

from emulator.commands.cli import main
from emulator.instrument.observer import Payload
from emulator.judging.trial import Trial
from emulator.recording.can_logs import LoggedFrame, candump_line, read_candump, read_with_library, write_with_library
from emulator.recording.compare import differences
from emulator.recording.layout import decode_scan
from emulator.recording.reader import RecordedRun, WireOf, WirePayload, read_run, read_wire
from emulator.recording.transcript import Transcript
from emulator.recording.writer import RecordingError
from emulator.runtime.playback import ReplaySession, open_players
from emulator.scenario import scenario
from emulator.view.recorded import RecordedSource
from protocols.session import Address, DropReason, dropped_scans

CASE = """\
schema: 1
seed: 3
duration_s: 0.7
world:
  - {plane: {size_m: [6, 60]}, at_m: [8, 0, 1], pitch_deg: -90, material: white_plaster}
sensors:
  - {id: front, model: sick-lms291-s05, mount: {at_m: [0, 0, 1]}, device: {resolution_deg: 1, field_deg: 100}}
  - {id: top, model: sick-ld-lrs1000, mount: {at_m: [0, 0, 1]}, device: {delays: fast, step_deg: 2.0}}
"""


def record(folder: Path, seed: int = 3) -> Trial:
    trial = Trial(scenario.loads(CASE.replace("seed: 3", f"seed: {seed}"), Path("case.yaml")), record=folder)
    trial.finish()
    trial.close()
    return trial


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("recordings") / "run"
    record(path)
    return path


def test_every_byte_both_ways_is_in_the_recording_with_its_instants(folder: Path) -> None:
    run = read_run(folder)
    assert run.cut == ""
    front = run.sent["front", 0].payloads
    assert front[0].data == b"\x06"
    assert front[1].data[:7] == bytes.fromhex("02 80 03 00 A0 00 10")
    baud = 9600
    assert front[0].end_ns - front[0].start_ns == -(-10 * 10**9 // baud)
    assert front[-1].baud == 500_000
    heard = b"".join(one.data for one in run.received["front", 0].payloads)
    assert heard[:8] == bytes.fromhex("02 00 02 00 20 25 35 08")
    scans = [one for one in front if one.sweep is not None]
    assert [one.sweep for one in scans] == list(range(scans[0].sweep or 0, (scans[0].sweep or 0) + len(scans)))
    assert {sensor for sensor, _ in run.sent} == {"front", "top"}


def test_scans_carry_their_truth_and_events_their_reason(folder: Path) -> None:
    run = read_run(folder)
    scan = run.scans["front"][0]
    middle = int(np.argmin(np.abs(scan.azimuth_rad)))
    assert scan.range_m[middle, 0] == pytest.approx(8.0, abs=0.1)
    assert scan.actor[middle, 0] == 0
    kinds = {row["event"] for _, _, row in run.events}
    assert {"Restarted", "CommandHandled"} <= kinds


def test_scans_that_hosts_do_not_get_are_recorded_with_their_numbers(tmp_path: Path) -> None:
    trial = Trial(scenario.loads(CASE, Path("case.yaml")), record=tmp_path / "run")
    (dropped,) = dropped_scans(5, DropReason.LINE_BUSY, range(4, 10, 2), "B0", 3, Address(0, 7))
    trial.instruments[0].observers.event(dropped)
    trial.close()
    rows = [row for _, _, row in read_run(tmp_path / "run").events if row["event"] == "Dropped"]
    assert rows == [
        {"event": "Dropped", "at_ns": 5, "reason": "line slower than the scan rate", "detail": "B0", "count": 3,
         "sweeps": [4, 10, 2], "stream": 3, "address": [0, 7]}
    ]  # fmt: skip


def test_a_scan_shown_from_a_recording_has_the_instants_of_its_beams(folder: Path) -> None:
    run = read_run(folder)
    for sensor in ("front", "top"):
        assert len(run.offsets[sensor]) == len(run.scans[sensor])
        last = run.offsets[sensor][-1]
        assert last is not None
        shown = RecordedSource(folder)
        shown.order("seek", {"to_s": 1e-9 * run.scans[sensor][-1].start_ns})
        fire_s = shown.frame().scans[sensor].fire_s
        assert fire_s.tolist() == last.tolist()
        assert 0.0 < np.ptp(fire_s) < 0.2
    # an LMS291 turns at 75 Hz: 100 degrees of a turn
    assert run.offsets["front"][-1][-1] - run.offsets["front"][-1][0] == pytest.approx(100 / 360 / 75)  # type: ignore[index]


def test_a_strangers_reader_finds_the_same_messages(folder: Path) -> None:
    run = read_run(folder)
    with (folder / "run.mcap").open("rb") as file:
        found = [
            (message.log_time, message.data)
            for _, channel, message in make_reader(file).iter_messages(topics=["/front/0/tx"])
        ]
    assert found == [(one.start_ns, one.data) for one in run.sent["front", 0].payloads]


def test_the_scenario_as_run_lies_beside_and_runs_again_to_the_same_recording(folder: Path, tmp_path: Path) -> None:
    again = Trial(scenario.load(str(folder / "scenario.yaml")), record=tmp_path / "again")
    again.finish()
    again.close()
    assert differences(read_run(folder), read_run(tmp_path / "again")) == []


def test_a_recording_cut_anywhere_is_read_to_the_cut(folder: Path, tmp_path: Path) -> None:
    whole = (folder / "run.mcap").read_bytes()
    counts = []
    for size in range(4000, len(whole) - 2000, len(whole) // 40):
        cut = tmp_path / "cut.mcap"
        cut.write_bytes(whole[:size])
        run = read_run(cut)
        assert run.cut
        counts.append(sum(len(wire.payloads) for wire in run.sent.values()))
    assert counts == sorted(counts)
    assert counts[-1] > 30


def test_a_run_that_is_still_going_can_be_read(tmp_path: Path) -> None:
    trial = Trial(scenario.loads(CASE, Path("case.yaml")), record=tmp_path / "run")
    assert trial.recorder is not None
    trial.run.advance(600_000_000)
    trial.recorder.flush()  # as its thread does twice a second where there is one
    run = read_run(tmp_path / "run")
    assert run.cut == "the file ends within a record"
    wires = [*run.sent.values(), *run.received.values()]
    assert sum(len(wire.payloads) for wire in wires) == trial.transcript.payloads  # none waits in this process
    trial.close()


@pytest.mark.parametrize("data", [b"", b"\x89MCAP0\r\n", b"hello, no recording", b"\x89MCAP0\r\n" + b"\xff" * 99])
def test_what_is_no_recording_is_refused(tmp_path: Path, data: bytes) -> None:
    path = tmp_path / "x.mcap"
    path.write_bytes(data)
    with pytest.raises(RecordingError, match=r"x\.mcap"):
        read_run(path)
    assert main(["diff", str(path), str(path)]) == 2


def test_another_version_is_named(folder: Path, tmp_path: Path) -> None:
    path = tmp_path / "new.mcap"
    data = (folder / "run.mcap").read_bytes()
    assert data.count(b"\x06\0\0\0layout\x01\0\0\x001") == 1
    path.write_bytes(data.replace(b"\x06\0\0\0layout\x01\0\0\x001", b"\x06\0\0\0layout\x01\0\0\x009"))
    with pytest.raises(RecordingError, match="layout '9'; this version reads 1"):
        read_run(path)


def test_a_folder_with_a_recording_is_not_written_over(folder: Path) -> None:
    with pytest.raises(RecordingError, match="holds a recording already"):
        Trial(scenario.loads(CASE, Path("case.yaml")), record=folder)


def test_diff_names_the_first_byte_and_beam(folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    record(tmp_path / "other", seed=4)
    assert main(["diff", str(folder), str(folder)]) == 0
    assert "identical" in capsys.readouterr().out
    assert main(["diff", str(folder), str(tmp_path / "other"), "--json"]) == 1
    rows = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert any("byte" in row["what"] and row["where"].startswith("front, link 0, tx") for row in rows)
    assert any("beam" in row["what"] and "range_m" in row["what"] for row in rows)


def test_what_cannot_be_compared_or_sent_is_named(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["diff", str(folder), str(tmp_path / "nowhere")]) == 2
    assert "nowhere: no such file or folder" in capsys.readouterr().err
    assert main(["replay", str(folder / "scenario.yaml"), "--at-once"]) == 2
    assert "scenario.yaml: a scenario; want a recording" in capsys.readouterr().err


def test_diff_sees_an_instant_a_peer_a_missing_payload_and_an_object(folder: Path) -> None:
    one = WirePayload(10, 20, b"abc", 1, 9600)
    changes = {
        "ns at its first bit": [replace(one, start_ns=11)],
        "at its last": [replace(one, end_ns=21)],
        "baud": [replace(one, baud=19_200)],
        "bytes": [replace(one, data=b"abcd")],
        "byte 1: 62 and 58": [replace(one, data=b"aXc")],
        "1 and 0 payloads": [],
    }
    for reported, payloads in changes.items():
        runs = [RecordedRun(Path("x")), RecordedRun(Path("y"))]
        for run, sent in zip(runs, ([one], payloads), strict=True):
            run.sent["a", 0] = WireOf("a", 0, "serial", "pty:x", sent)
        found = differences(*runs)
        assert len(found) == 1
        assert reported in str(found[0])
    scan = read_run(folder).scans["front"][0]
    first, second = RecordedRun(Path("x")), RecordedRun(Path("y"))
    first.scans["a"] = [replace(scan, objects=({"track": 1, "actor": "car"},))]
    second.scans["a"] = [replace(scan, objects=({"track": 2, "actor": "car"},))]
    assert "object 0, track: 1 and 2" in str(differences(first, second)[0])


def test_scans_of_any_bytes_are_read_or_refused() -> None:
    for data in (b"", b"\0" * 27, struct.pack("<qqiII", 0, 0, 0, 2**31, 2**31), b"\0" * 28 + b"{"):
        with pytest.raises(ValueError, match=r"recorded scan|bytes for"):
            decode_scan(data)


# ---------------------------------------------------------------- others' formats

FRAMES = [
    LoggedFrame(1_000_000, 0x60A, bytes.fromhex("03FBF710"), "can0"),
    LoggedFrame(1_255_000, 0x60B, bytes(range(8)), "can0"),
    LoggedFrame(3_000_000_000, 0x1ABCDEF0 | 1 << 31, b"", "can0"),
]


def test_candump_lines_are_plain_and_read_back() -> None:
    text = "".join(map(candump_line, FRAMES))
    assert text.splitlines()[0] == "(0000000000.001000) can0 60A#03FBF710"
    assert list(read_candump(text.splitlines())) == FRAMES
    assert list(read_candump(["", "# x", "(1.5) can0 60A#R", "(1.5) can0 60A##100", "garbage"])) == []
    assert [one.data for one in read_candump(["(1.5) can0 60A#01 R"])] == [b"\x01"]


@pytest.mark.parametrize("suffix", [".blf", ".asc"])
def test_blf_and_asc_hold_the_same_frames(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"bus{suffix}"
    write_with_library([path], FRAMES)
    found = read_with_library(path)
    assert [(one.peer, one.data) for one in found] == [(one.peer, one.data) for one in FRAMES]
    gaps = np.diff([one.at_ns for one in found])
    assert gaps == pytest.approx(np.diff([one.at_ns for one in FRAMES]), abs=1500)
    with can.LogReader(path) as log:
        instants = [one.timestamp for one in log]  # since the start of the run, as in the other files
    assert instants == pytest.approx([1e-9 * one.at_ns for one in FRAMES], abs=1e-6)


def test_replay_keeps_the_time_between_links_from_round_to_round() -> None:
    def wire(sensor: str, *at_ms: int) -> WireOf:
        payloads = [WirePayload(at * 10**6, at * 10**6, bytes([at])) for at in at_ms]
        return WireOf(sensor, 0, "stream", f"loop:{sensor}", payloads)

    players = open_players([wire("early", 20, 30), wire("late", 90)], {}, gap_ns=5 * 10**6)
    sent = []
    for player in players:
        session = player.session
        assert isinstance(session, ReplaySession)
        session.loops = 2
        session.start(0)
        while (due_ns := session.next_deadline()) is not None:
            sent += [(due_ns // 10**6, one.payload[0]) for one in session.take_emissions(due_ns)]
    assert sorted(sent) == [(0, 20), (10, 30), (70, 90), (75, 20), (85, 30), (145, 90)]


def test_a_link_that_is_lost_ends_its_part_of_a_replay() -> None:
    wires = [WireOf("front", 0, "stream", "loop:front", [WirePayload(at, at, b"x") for at in (0, 10, 20)])]
    session = open_players(wires, {})[0].session
    assert isinstance(session, ReplaySession)
    session.loops = 0
    session.start(0)
    session.take_emissions(10)
    assert not session.finished
    session.give_up()
    assert session.finished
    assert session.progress == 1.0
    assert session.next_ns() is None
    assert session.take_emissions(10**9) == []


def test_diff_reads_logs_of_other_tools(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    other = [*FRAMES[:1], FRAMES[1]._replace(data=bytes(8)), *FRAMES[2:]]
    for ending in (".blf", ".asc"):
        one, two = tmp_path / f"one{ending}", tmp_path / f"two{ending}"
        write_with_library([one], FRAMES)
        write_with_library([two], other)
        assert main(["diff", str(one), str(one)]) == 0
        assert main(["diff", str(one), str(two)]) == 1
        assert "payload 1, byte 1: 01 and 00" in capsys.readouterr().out


def test_a_raw_serial_dump_takes_the_time_of_its_line(tmp_path: Path) -> None:
    path = tmp_path / "dump.bin"
    path.write_bytes(b"\x02\x80" * 480)
    wire = read_wire(path, baud=9600)[0]
    assert wire.kind == "serial"
    assert wire.payloads[0].end_ns == pytest.approx(1e9, rel=1e-3)
    assert wire.payloads[0].baud == 9600


def test_another_instant_is_another_transcript() -> None:
    digests = set()
    for start_ns, end_ns in ((0, 10), (1, 10), (0, 11)):
        transcript = Transcript(["a"])
        transcript.payload(Payload("a", 0, 0, b"x", start_ns, end_ns, True))
        digests.add(transcript.sha256())
    assert len(digests) == 3
