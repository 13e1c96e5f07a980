"""What is recorded of a run in real time: when each payload was due, and when it had left."""

from __future__ import annotations

import json
import socket
from collections.abc import Callable
from itertools import cycle
from pathlib import Path

import numpy as np
import pytest

from emulator.commands.cli import main
from emulator.instrument.instrument import Instrument
from emulator.instrument.observer import Observer, Payload
from emulator.judging.trial import Trial
from emulator.measuring.measuring import InPlace
from emulator.process.clock import ManualClock
from emulator.recording.captures import read_segments
from emulator.recording.compare import differences
from emulator.recording.departures import MOST_WAITING, Departures
from emulator.recording.reader import read_run
from emulator.recording.writer import Recorder
from emulator.recording.writing import IN_STEP, LIVE, VIRTUAL, Manner
from emulator.runtime import assembly
from emulator.runtime.daemon import Daemon
from emulator.scenario import scenario
from emulator.transports.link import Link
from emulator.transports.loopback import LoopLink
from emulator.transports.tcp_server import open_link_tcp

CASE = """\
schema: 1
duration_s: 1
world:
  - {plane: {size_m: [6, 60]}, at_m: [8, 0, 1], pitch_deg: -90, material: white_plaster}
sensors:
  - {id: front, model: sick-lms291-s05, mount: {at_m: [0, 0, 1]}, links: ["loop:front"]}
"""
STATUS = bytes.fromhex("02 00 01 00 31 15 12")
STREAM = bytes.fromhex("02 00 02 00 20 24 34 08")
MS = 1_000_000
LATE_MS = (0, 2, 7, 67)


class Oversleeping:
    """A waiter whose machine is busy: it wakes late, in turn by each of `LATE_MS`, and takes no time for it."""

    def __init__(self, clock: ManualClock) -> None:
        self._clock = clock
        self._late_ms = cycle(LATE_MS)

    def until(self, deadline_ns: int | None, rehearse: Callable[[int], object]) -> bool:
        assert deadline_ns is not None
        self._clock.set(max(self._clock.now_ns(), deadline_ns + next(self._late_ms) * MS))
        return True

    def doze(self, until_ns: int) -> bool:
        self._clock.set(max(self._clock.now_ns(), until_ns))
        return True


class Left(Observer):
    """Keeps what is told."""

    def __init__(self) -> None:
        self.found: list[tuple[int, int, int]] = []

    def departed(self, sensor: str, link: int, due_ns: int, actual_ns: int) -> None:
        self.found.append((link, due_ns, actual_ns))


def late_run(folder: Path) -> Left:
    """Two seconds of a sensor on a line in memory and on a port, by a daemon that oversleeps."""
    loaded = scenario.loads(CASE, Path("case.yaml"))
    clock = ManualClock()
    line, port = LoopLink("front"), open_link_tcp("tcp:127.0.0.1:0", serial_line=True)
    links: list[Link] = [line, port]
    (session,) = assembly.new_sessions(loaded)
    instrument = Instrument("front", session, links, InPlace(assembly.build_measures(loaded)))
    manner = Manner(None, late=True)
    recorder = Recorder(folder, loaded, [instrument], now_ns=clock.now_ns, manner=manner)
    left = Left()
    instrument.watch(left)
    daemon = Daemon([instrument], clock)
    daemon.waiter = Oversleeping(clock)  # type: ignore[assignment]
    host = line.connect()
    for number in range(12):
        host.write(STATUS, 500 * MS + number * 60 * MS)
    host.write(STREAM, 1300 * MS)
    address = port.url.removeprefix("tcp:").rpartition(":")
    with socket.create_connection((address[0], int(address[2]))) as guest:
        guest.sendall(STATUS)
        daemon.power_on()
        daemon.run(until_ns=2_000 * MS)
        daemon.close()
        recorder.close()
    return left


@pytest.fixture(scope="module")
def late(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Left]:
    folder = tmp_path_factory.mktemp("late") / "run"
    return folder, late_run(folder)


def test_a_link_that_is_made_late_has_both_instants_of_every_payload(late: tuple[Path, Left]) -> None:
    folder, left = late
    run = read_run(folder)
    assert run.cut == ""
    recorded = [(0, one.end_ns, one.actual_ns) for one in run.sent["front", 0].payloads if one.actual_ns is not None]
    reported = [row for row in left.found if row[0] == 0]
    assert recorded == reported
    assert len(recorded) >= len(run.sent["front", 0].payloads) - 2  # of the end's last telegrams none has left
    assert len(recorded) > 15
    assert max(one.late_ns for one in run.sent["front", 0].payloads) > 60 * MS
    asked = [one.start_ns for one in run.received["front", 0].payloads]
    sent = [one for one in run.sent["front", 0].payloads if one.start_ns > asked[0] and one.actual_ns is not None]
    replies = [one for one in sent if one.data == b"\x06"]
    assert len(replies) > 3
    assert all((one.actual_ns or 0) >= one.end_ns for one in sent)
    distances = {(one.actual_ns or 0) - max(at for at in asked if at <= one.start_ns) for one in replies}
    assert len(distances) > 3
    assert {one.late_ns for one in replies} - {0}


def test_a_capture_has_the_instants_at_which_packets_left(late: tuple[Path, Left]) -> None:
    folder, _ = late
    run = read_run(folder)
    sent = run.sent["front", 1].payloads
    assert any(one.late_ns for one in sent)
    stamps = [
        item.at_ns
        for item in read_segments((folder / "front.pcapng").read_bytes())
        if item.data and item.source[1] != 1024
    ]
    assert sorted(stamps) == stamps
    known = [one for one in sent if one.actual_ns is not None]
    assert len(known) > 5
    ends = [0, *(one.actual_ns or 0 for one in known)]
    began = [max(one.start_ns + one.late_ns, end) for one, end in zip(known, ends, strict=False)]
    assert set(stamps) >= set(began)
    assert {one.start_ns for one in known} - set(stamps)


def test_report_and_transcript_show_both_and_diff_compares_what_was_due(
    late: tuple[Path, Left], capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    folder, _ = late
    arguments = ["report", str(folder), "--no-truth", "--json", "--out", str(tmp_path / "r.html")]
    assert main([*arguments, "--figures", str(tmp_path / "figures")]) == 0
    row = json.loads(capsys.readouterr().out)["sensors"][0]
    values = [one.late_ns * 1e-3 for one in read_run(folder).sent["front", 0].payloads if one.actual_ns is not None]
    reported = row["links"][0]["lateness_us"]
    assert reported["payloads"] == len(values)
    assert (reported["median"], reported["worst"]) == (pytest.approx(np.median(values)), pytest.approx(max(values)))
    assert reported["p99"] == pytest.approx(np.percentile(values, 99))
    page = (tmp_path / "r.html").read_text()
    assert "Lateness by link" in page
    assert "Lateness over time" in page
    assert (tmp_path / "figures" / "lateness_over_time.png").exists()
    assert main(["transcript", str(folder), "--no-scans"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert any(line.split()[1].startswith("+6") and line.split()[2] == "ms" for line in lines)
    left = [float(line.split()[0]) + (1e-3 * float(line.split()[1]) if "ms " in line else 0.0) for line in lines]
    assert left == sorted(left)
    assert main(["transcript", str(folder), "--json"]) == 0
    rows = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert any(one["left_s"] is not None and one["left_s"] > one["end_s"] + 0.06 for one in rows)
    assert all(one["left_s"] is None for one in rows if one["from"] == "host")
    assert differences(read_run(folder), read_run(folder)) == []


def test_in_virtual_time_nothing_more_is_recorded_and_a_late_recording_has_the_same_wire(tmp_path: Path) -> None:
    found = {}
    for name, manner in (("usual", IN_STEP), ("late", Manner(None, late=True))):
        loaded = scenario.loads(CASE, Path("case.yaml"))
        trial = Trial(loaded)
        recorder = Recorder(tmp_path / name, loaded, trial.instruments, manner=manner)
        trial.finish()
        recorder.close()
        trial.close()
        found[name] = read_run(tmp_path / name)
    assert differences(found["usual"], found["late"]) == []
    assert all(one.actual_ns is None for one in found["usual"].sent["front", 0].payloads)
    assert b"lidaremu.Left" not in (tmp_path / "usual" / "run.mcap").read_bytes()
    assert (VIRTUAL.late, IN_STEP.late, LIVE.late) == (False, False, True)


def test_links_keep_no_departures_that_nobody_records() -> None:
    trial = Trial(scenario.loads(CASE, Path("case.yaml")))
    trial.finish()
    assert all(link.stats.departures is None for link in trial.instruments[0].links)
    trial.close()


def payload(number: int, end_ns: int) -> Payload:
    return Payload("front", 0, 0, bytes([number]), end_ns - 5, end_ns, True)


def test_what_a_link_gives_up_is_passed_over_and_nothing_is_lost_or_waits_for_ever() -> None:
    departures = Departures()
    for number, end_ns in enumerate((10, 20, 30)):
        assert list(departures.hand(end_ns, payload(number, end_ns))) == []
    assert departures.leave(11, 12) == []  # a part of none of them
    gone = departures.leave(20, 26)
    assert [(one.data, at_ns) for one, at_ns in gone] == [(b"\0", 5), (b"\1", 21)]
    assert departures.leave(10, 99) == []  # passed over
    departures.cut(28)
    assert [(one.data, at_ns) for one, at_ns in departures.leave(28, 28)] == [(b"\2", 26)]
    rows = departures.take()
    assert rows is not None
    assert rows.tolist() == [(1, 20, 26), (2, 28, 28)]
    assert departures.take() is None
    early = [one for number in range(MOST_WAITING + 3) for one in departures.hand(10 + number, payload(7, 10 + number))]
    assert [at_ns for _, at_ns in early] == [28, 28, 28]  # none begins before those that have left
    assert len(departures.end()) == MOST_WAITING
    assert departures.end() == []
