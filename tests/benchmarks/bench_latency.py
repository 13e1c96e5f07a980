"""Real time in a fed street: age of poses at the beams and lateness, beside the same run without a feed.

Run it on an idle machine: `python -m tests.benchmarks.bench_latency [SECONDS]`.
An LMS291 at 37.5 Hz (0.5 degrees) sends to a host that reads its pseudo-terminal; all actors of the street are fed at
100 Hz by JSON lines over UDP, from a process of its own. Aim on two idle cores: age 10 ms at the median, no scan
dropped, lateness as without a feed.

Its `feed:` lines say where the age comes from. A beam of a sweep that is begun before it fires is as old as the newest
sample then (half a period of the feed, and its way), and as long as the sweep is begun before the beam: what measuring
takes, a margin, and how far the beam is before the sweep's end. A beam whose poses are all known when its sweep is
begun waits for nothing: the play-out delay less what its sample is ahead of it, half a period at the median. A sweep in
slices of time is begun twice: "measuring takes" is of the last slice then.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from tests.benchmarks.bench_live import STREET, lines

PORT = 47117


def scenario(folder: Path, fed: bool, seconds: float) -> Path:
    """The street with such a sensor, and a feed if wanted."""
    text = STREET.read_text()
    text = text.replace("loop: true", "loop: false").replace("meshes/", f"{STREET.parent}/meshes/")
    text = text.replace("duration_s: 12", f"duration_s: {seconds:g}")
    text = text[: text.index("sensors:")] + SENSOR
    if fed:
        text += f"live: {{feed: 'json-udp://127.0.0.1:{PORT}', ego: ego}}\n"
    path = folder / ("fed.yaml" if fed else "unfed.yaml")
    path.write_text(text)
    return path


SENSOR = """sensors:
  - id: front
    model: sick-lms291-s05
    mount: {actor: ego, at_m: [3.6, 0, 0.6]}
    device: {resolution_deg: 0.5, unit: cm, baud: 500000}
    links: ["pty:./lms291"]
"""


def feed(seconds: float) -> None:
    """Tell all actors of the street 100 times a second. Run in a process of its own."""
    from emulator.live.client import Feeder
    from emulator.scenario.scenario import load

    street = load(str(STREET))
    # made before: a simulator on these cores would be another thing to measure
    updates = [lines(street, len(street.actors), 0, number / 100) for number in range(round(100 * seconds))]
    with Feeder(f"json-udp://127.0.0.1:{PORT}") as feeder:
        begin = time.monotonic()
        for number, update in enumerate(updates):
            t_s = number / 100
            time.sleep(max(0.0, begin + t_s - time.monotonic()))
            feeder.send(update, t_s)


def read(folder: Path, seconds: float) -> int:
    """Ask for continuous scans as a driver does; bytes that came."""
    import serial

    from protocols.lms2xx.telegrams import request

    with serial.Serial(str(folder / "lms291"), 500000, timeout=0.5) as port:
        port.write(request(b"\x20\x24"))
        came, until = 0, time.monotonic() + seconds
        while time.monotonic() < until:
            came += len(port.read(4096))
    return came


def once(fed: bool, seconds: float) -> None:
    """One run, and what it says at its end."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        command = [sys.executable, "-m", "emulator", "run", str(scenario(folder, fed, seconds + 3))]
        environment = {**os.environ, "PYTHONPATH": str(Path(__file__).parents[2])}
        daemon = subprocess.Popen(
            command, cwd=folder, env=environment, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
        )
        feeder = None
        try:
            while not (folder / "lms291").exists() and daemon.poll() is None:
                time.sleep(0.1)
            if fed:
                one = [sys.executable, "-m", "tests.benchmarks.bench_latency", "feed", str(seconds + 6)]
                feeder = subprocess.Popen(one, env=environment)
            came = read(folder, seconds) if daemon.poll() is None else 0
            said = daemon.communicate(timeout=seconds + 60)[0]
        finally:
            daemon.kill()
            if feeder is not None:
                feeder.kill()
        print(f"## {'fed at 100 Hz' if fed else 'without a feed'}: {came} bytes came in {seconds:g} s\n{said}")


def main() -> None:
    """Both runs, one after the other."""
    if sys.argv[1:2] == ["feed"]:
        feed(float(sys.argv[2]))
        return
    seconds = float(sys.argv[1]) if len(sys.argv) > 1 else 30.0
    for fed in (False, True):
        once(fed, seconds)


if __name__ == "__main__":
    main()
