"""Exported runs sent again by `lidaremu replay`, and decoded by hosts of ours: the same scans come out."""

from __future__ import annotations

import contextlib
import json
import os
import select
import socket
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import serial

from emulator.hosts.ld import UspFraming, read_profile
from emulator.hosts.lms2xx import TelegramReader
from emulator.judging.trial import Trial
from emulator.recording.reader import RecordedRun, read_run
from emulator.scenario import scenario
from protocols.ld.telegrams import words_of
from protocols.lms2xx.telegrams import read_values
from tests.system.conftest import TIME_LIMIT_S
from tests.system.nursery import begun

CASE = """\
schema: 1
duration_s: 1.5
world:
  - {plane: {size_m: [6, 60]}, at_m: [8, 0, 1], yaw_deg: 20, pitch_deg: -90, material: white_plaster}
sensors:
  - {id: front, model: sick-lms291-s05, mount: {at_m: [0, 0, 1]}}
  - {id: top, model: sick-ld-lrs1000, mount: {at_m: [0, 0, 1]}, device: {delays: fast, step_deg: 1.0}}
"""


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> RecordedRun:
    """A recorded run; beside its folder `dump.bin` of the LMS's line, and `top.pcapng` of the LD's socket."""
    folder = tmp_path_factory.mktemp("run") / "rec"
    trial = Trial(scenario.loads(CASE, Path("case.yaml")), record=folder)
    trial.finish()
    trial.close()
    found = read_run(folder)
    (folder / "dump.bin").write_bytes(b"".join(one.data for one in found.sent["front", 0].payloads))
    return found


def lms_scans(data: bytes) -> list[tuple[int, ...]]:
    reader = TelegramReader()
    reader.feed(data)
    found = []
    while (telegram := reader.take()) is not None:
        values = read_values(telegram)
        if values is not None:
            found.append(tuple(values.values.tolist()))
    assert reader.errors == 0
    return found


def ld_scans(data: bytes) -> list[tuple[float, ...]]:
    framing = UspFraming()
    profiles = [read_profile(words_of(message)) for message in framing.feed(data)]
    assert framing.errors == 0
    return [tuple(np.nan_to_num(one.range_m).tolist()) for one in profiles if one is not None and len(one.range_m)]


@contextlib.contextmanager
def replaying(folder: Path, *arguments: str) -> Iterator[tuple[subprocess.Popen[str], str]]:
    """The command, and the link of the sensor that its first `--link` names, else of the first sensor."""
    named = arguments[arguments.index("--link") + 1].partition("=")[0] if "--link" in arguments else None
    with begun("replay", *arguments, "--json", cwd=folder, stdin=subprocess.PIPE) as process:
        assert process.stdout is not None
        first = process.stdout.readline()
        assert first, process.communicate()[1]
        try:
            rows = json.loads(first)["sensors"]  # in the order in which they were heard of
            yield process, next(row["links"][0] for row in rows if named in (None, row["id"]))
        finally:
            process.kill()


def heard(url: str) -> bytes:
    """Everything that a host reads until the other end goes."""
    scheme, _, place = url.partition(":")
    got = b""
    if scheme == "tcp":
        host, _, port = place.rpartition(":")
        with socket.create_connection((host, int(port)), timeout=TIME_LIMIT_S) as line:
            while data := line.recv(4096):
                got += data
        return got
    with serial.Serial(place, 500_000) as port_, contextlib.suppress(OSError):
        while select.select([port_], [], [], TIME_LIMIT_S)[0] and (data := os.read(port_.fd, 4096)):
            got += data  # the terminal goes when all has been read
    return got


def last_line(process: subprocess.Popen[str]) -> dict[str, object]:
    out, errors = process.communicate(timeout=TIME_LIMIT_S)
    assert process.returncode == 0, errors
    found: dict[str, object] = json.loads(out.splitlines()[-1])
    return found


@pytest.mark.parametrize(
    ("link", "arguments"),
    [
        ("pty:./line?speed=ignore", []),
        ("pty:./line?speed=ignore", ["--speed", "2", "--loop", "2"]),
        ("tcp:127.0.0.1:0", ["--speed", "0.5"]),
        ("tcp:127.0.0.1:0", ["--speed", "20", "--loop", "3"]),
    ],
)
def test_a_serial_dump_is_heard_scan_by_scan(run: RecordedRun, tmp_path: Path, link: str, arguments: list[str]) -> None:
    dump = run.path.parent / "dump.bin"
    scans = lms_scans(dump.read_bytes())
    rounds = int(arguments[3]) if "--loop" in arguments else 1
    assert len(scans) > 40
    began = time.monotonic()
    with replaying(tmp_path, str(dump), "--baud", "500000", "--link", f"dump={link}", *arguments) as (process, url):
        got = heard(url)
        end = last_line(process)
    assert end["rounds"] == rounds
    assert len(got) + int(str(end["bytes_lost"])) == rounds * dump.stat().st_size
    if link.startswith("tcp:") or not end["bytes_lost"]:  # a terminal holds 20 kB: less than a busy machine may want
        assert lms_scans(got) == rounds * scans
    assert end["payloads"] == rounds * len(run.sent["front", 0].payloads)
    if not arguments:
        assert time.monotonic() - began > dump.stat().st_size * 10 / 500_000


@pytest.mark.parametrize("arguments", [[], ["--speed", "0.5"], ["--speed", "10", "--loop", "2"]])
def test_a_capture_of_an_ld_is_heard_profile_by_profile_with_its_gaps(
    run: RecordedRun, tmp_path: Path, arguments: list[str]
) -> None:
    wire = run.sent["top", 0]
    profiles = ld_scans(b"".join(one.data for one in wire.payloads))
    speed = float(arguments[1]) if arguments else 1.0
    rounds = 2 if "--loop" in arguments else 1
    assert len(profiles) > 5
    began = time.monotonic()
    with replaying(tmp_path, str(run.path.parent / "top.pcapng"), "--link", "top=tcp:127.0.0.1:0", *arguments) as (
        process,
        url,
    ):
        assert ld_scans(heard(url)) == rounds * profiles
        end = last_line(process)
    assert (end["rounds"], end["bytes_lost"]) == (rounds, 0)
    gaps = end["gap_error_us"]
    assert isinstance(gaps, dict)
    assert 0.0 <= gaps["median"] < 20_000
    span_s = (wire.payloads[-1].start_ns - wire.payloads[0].start_ns) * 1e-9
    assert time.monotonic() - began > span_s / speed


def test_stepped_each_line_sends_one_telegram_to_its_last_byte(run: RecordedRun, tmp_path: Path) -> None:
    sent = run.sent["front", 0].payloads
    for source in (str(run.path.parent), str(run.path.parent / "dump.bin")):
        name = "front" if source.endswith("rec") else "dump"
        link = f"{name}=pty:./{name}?speed=ignore"
        others = ["--link", "top=tcp:127.0.0.1:0"] if name == "front" else []
        arguments = ["--stepped", "--baud", "500000", "--link", link, *others]
        with replaying(tmp_path, source, *arguments) as (process, url):
            assert process.stdin is not None
            with serial.Serial(url.partition(":")[2], 500_000, timeout=0.05) as port:
                got = port.read(4096)
                assert got == b""
                lines = 0
                while len(got) < sum(len(one.data) for one in sent[:9]):
                    before = len(got)
                    process.stdin.write("\n")
                    process.stdin.flush()
                    lines += 1
                    ends = {sum(len(one.data) for one in sent[:count]) for count in range(len(sent))}
                    began = time.monotonic()
                    while time.monotonic() - began < 0.4 and len(got) == before:
                        got += port.read(4096)
                    while time.monotonic() - began < 10.0 and len(got) not in ends:  # it has begun
                        got += port.read(4096)
                    got += port.read(4096)
                    assert len(got) in ends  # whole payloads, and at most one: the other lines were the LD's
                    assert sum(before < end <= len(got) for end in ends) <= 1
                    assert lines < 60
            assert b"".join(one.data for one in sent).startswith(got)
            process.stdin.close()
            process.stdin = None
            end = last_line(process)
            assert end["payloads"] == lines
            assert end["gap_error_us"] == {}
