"""The installed pytest plug-in in a driver's repository: a failed test keeps its recording, a good one does not."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

from emulator.recording.reader import read_run

TESTS = """\
import serial

def test_good(lidaremu):
    with lidaremu("flat_wall") as rig:
        rig.advance(seconds=0.1)

def test_bad(lidaremu):
    with lidaremu("flat_wall", seed=5, sensors__front__device__resolution_deg=1) as rig:
        with serial.Serial(rig["front"].path, 9600, timeout=1) as port:
            port.write(bytes.fromhex("0200020020253508"))
            assert port.read(1) == b"\\x06"
            rig.advance(seconds=0.1)
            assert False, "on purpose"
"""


def test_a_failed_tests_recording_is_kept_and_named(tmp_path: Path) -> None:
    (tmp_path / "test_driver.py").write_text(TESTS, encoding="utf-8")
    done = subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "--basetemp", str(tmp_path / "base")],
        capture_output=True,
        text=True,
        cwd=tmp_path,
        timeout=240,
        check=False,
    )
    assert "1 failed, 1 passed" in done.stdout, done.stdout + done.stderr
    named = re.search(r"lidaremu recordings -+\n(\S+)", done.stdout)
    assert named is not None, done.stdout
    run = read_run(Path(named[1]))
    assert b"".join(one.data for one in run.received["front", 0].payloads)[:2] == b"\x02\x00"
    assert "seed: 5" in run.scenario
    kept = sorted(path.parent.name for path in (tmp_path / "base").rglob("run.mcap"))
    assert len(kept) == 1
