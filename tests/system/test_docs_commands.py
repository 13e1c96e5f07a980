"""Every command of the pages runs as it stands, in an empty folder; those that cannot have their reason here.

Commands without end get a short one; those that talk to a running sensor find one; figures have few dots. What reads
another's files runs with it in one process, one after the other, as a reader would type them: one of `THREADS` each.
Whether their words are understood is tests/docs/test_commands.py.
"""

from __future__ import annotations

import json
import os
import re
import shutil
import stat
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path

import pytest

from emulator.transports.shim import find_compiler
from tests.docs import reading
from tests.system.conftest import favoured
from tests.system.nursery import SWITCH

pytestmark = pytest.mark.timeout(900)  # processes, one after the other, perhaps on a busy machine
ROOT = Path(__file__).resolve().parents[2]
NOT_RUN = {
    r"serial:/dev/|slcan:/dev/|192\.168\.": "an adapter, a device on a network",
    r"can:socketcan:": "a kernel module, or the shim: test_can_sockets.py",
    r"^lidaremu view": "a browser: test_view.py",
    r"tcp:0\.0\.0\.0:": "listens beyond this machine",
    r"acme|wall\.yaml": "the example has to be installed: test_examples_build.py",
    r"^python3? -m venv|^pip install|^\.venv/bin/pip|^\. \.venv": "installs: test_wheel.py",
    r"^bash \.ci/": "runs these tests",
    r"^docker ": "containers",
    r"-- python client\.py ": "needs a client of others: test_rplidar.py",
    r"-- candump ": "never ends, and needs can-utils: test_can_clients.py",
    r"^python -m can\.": "never end: test_can_clients.py",
    r"^python -m tests\.": "measures for minutes; the module is there: tests/docs/test_pages.py",
}
CODES = {r"visibility_m=-20": 2, r"^lidaremu test step_out.yaml --set": 1, "^lidaremu campaign .* --out detection$": 1}
"What ends otherwise than well, as its page says."
TALKS = re.compile(r"^lidaremu (?:look|ctl) ")
THREADS = {
    "campaign": r"^lidaremu campaign",
    "demo": r"^lidaremu demo",
    "run": r"^lidaremu run (?!velodyne)(?!.*--record)",
    "step_out": r"step_out|one_file",
    "record": "",
}
"Name and pattern: a command is of the first that fits; what reads what another has written is of the same."
CHILD = """
import json, sys
from emulator.commands.cli import main
from emulator.studies import drawing
drawing.DPI = 30
for words in json.loads(sys.argv[1]):
    print(json.dumps({"words": words}), flush=True)
    code = main(words)
    print(json.dumps({"code": code}), flush=True)
"""
SENSORS = """\
schema: 1
world:
  - {plane: {size_m: [6, 60]}, at_m: [8, 0, 1], pitch_deg: -90, material: white_plaster}
actors:
  - {id: car, shape: {box: {size_m: [4, 2, 1.5]}}, class: car, material: car_paint_white, motion: {at_m: [6, 1, 0]}}
sensors:
  - {id: front, model: sick-lms291-s05, mount: {at_m: [0, 0, 1]}, links: ["pty:./lms291"]}
  - {id: top, model: sick-ld-lrs1000, device: {step_deg: 1, delays: fast}, links: ["tcp:127.0.0.1:0"]}
  - {id: radar, model: can-ars408, from: [front], links: ["socketcand:127.0.0.1:0/can0"]}
  - {id: gate, model: sick-lms111, mount: {at_m: [0, 0, 1]}, device: {ready_s: 1}, links: ["tcp:127.0.0.1:0"]}
  - {id: robot, model: hokuyo-utm-30lx, mount: {at_m: [0, 0, 1]}, links: ["tcp:127.0.0.1:0"]}
  - {id: roof, model: velodyne-vlp-16, mount: {at_m: [0, 0, 1]}, device: {boot_s: 0, fov_deg: [350, 10]}, links: [
       "tcp:127.0.0.1:0"]}
  - {id: corner, model: hesai-xt32, mount: {at_m: [0, 0, 1]}, device: {boot_s: 0, spin_up_s: 0, range_deg: [350, 10]},
     links: ["tcp:127.0.0.1:0"]}
  - {id: os1, model: ouster-os1-32, mount: {at_m: [0, 0, 1]}, device: {boot_s: 0, init_s: 0, spin_up_s: 0, config: {
       lidar_mode: 512x10, azimuth_window: [150000, 210000]}}, links: ["tcp:127.0.0.1:0"]}
  - {id: a1, model: rplidar-a1m8, mount: {at_m: [0, 0, 1]}, links: ["pty:./rplidar_a1"]}
  - {id: ld19, model: ldrobot-ld19, mount: {at_m: [0, 0, 1]}, links: ["pty:./ld19"]}
  - {id: x4, model: ydlidar-x4, mount: {at_m: [0, 0, 1]}, links: ["pty:./x4"]}
"""


def typed() -> list[str]:
    """Whole commands of all pages, each once, in the order in which they are read."""
    return list(dict.fromkeys(one.text for one in reading.all_commands() if not one.is_form))


def runnable() -> list[str]:
    return [text for text in typed() if not any(re.search(pattern, text) for pattern in NOT_RUN)]


def shortened(text: str) -> str:
    """The same with an end: nobody waits a minute for a page."""
    head, separator, driver = text.partition(" -- ")
    if head.startswith("lidaremu campaign"):
        return f"{head} --points 4"
    if head.startswith(("lidaremu run", "lidaremu demo")) and not (separator and "--duration" not in head):
        head = re.sub(r" --duration \S+", "", head) + (" --duration 1.5" if "demo" in head else " --duration 0.5")
        head = head.replace("run bumper", "run bumper --link ld=tcp:127.0.0.1:0")  # its own port may be another's
        head = re.sub(r" --link ld=\S*49152", "", head).replace(":29536/", ":0/")
    if head.startswith("lidaremu look") and "--scans" not in head:
        head += " --scans 2"
    return head + separator + driver


def words_of(text: str) -> list[str]:
    return reading.Command("", shortened(text), False).words[1:]


@pytest.fixture
def folder(tmp_path: Path) -> Iterator[Path]:
    """What the pages' reader has: the examples, and a driver that ends at once. Short, as sockets' paths must be."""
    made = Path(tempfile.mkdtemp(prefix="docs", dir="/tmp"))
    for path in (ROOT / "docs/examples").glob("*.yaml"):
        shutil.copy(path, made)
    shutil.copytree(ROOT / "docs/examples/campaign", made / "docs/examples/campaign")
    for name in ("driver", "my_driver"):
        (made / name).write_text('#!/bin/sh\ntest -n "$LIDAREMU_FRONT"\n', encoding="utf-8")
        (made / name).chmod(stat.S_IRWXU)
    (made / "sensors.yaml").write_text(SENSORS, encoding="utf-8")
    yield made
    shutil.rmtree(made)


def environment(folder: Path) -> dict[str, str]:
    return os.environ | {"PYTHONPATH": str(ROOT), "XDG_RUNTIME_DIR": str(folder), "TERM": "dumb", "NO_COLOR": "1"}


def run_all(commands: Sequence[Sequence[str]], folder: Path) -> list[int]:
    """Exit codes, in order."""
    child = [sys.executable, "-c", CHILD, json.dumps(commands)]
    done = subprocess.run(
        child,
        cwd=folder,
        env=environment(folder),
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        timeout=800,
    )
    codes = [json.loads(line)["code"] for line in done.stdout.splitlines() if line.startswith('{"code"')]
    assert len(codes) == len(commands), done.stdout[-3000:]
    assert done.returncode == 0, done.stdout[-3000:]
    return codes


def expected(text: str) -> int:
    return next((code for pattern, code in CODES.items() if re.search(pattern, text)), 0)


def test_every_reason_is_needed() -> None:
    for pattern, reason in NOT_RUN.items():
        assert any(re.search(pattern, one.text) for one in reading.all_commands()), reason


def test_commands_of_ours_alone_are_run() -> None:
    assert all(text.startswith("lidaremu ") for text in runnable())


def thread_of(text: str) -> str:
    return next(name for name, pattern in THREADS.items() if re.search(pattern, text))


@pytest.mark.parametrize("thread", THREADS)
def test_commands_run(thread: str, folder: Path) -> None:
    wanted = [text for text in runnable() if not TALKS.search(text)]
    if find_compiler(os.environ) is None:
        wanted = [text for text in wanted if "--shim" not in text]
    assert len(wanted) > 20
    wanted = [text for text in wanted if thread_of(text) == thread]
    assert wanted
    codes = run_all([words_of(text) for text in wanted], folder)
    assert dict(zip(wanted, codes, strict=True)) == {text: expected(text) for text in wanted}


def test_commands_that_talk_to_a_sensor_run(folder: Path) -> None:
    wanted = [text for text in runnable() if TALKS.search(text)]
    wanted.sort(key=lambda text: text == "lidaremu ctl stop")
    assert len(wanted) > 8
    command = [*favoured(), sys.executable, "-m", "emulator", "run", "sensors.yaml", "--json", "--duration", "800"]
    more = {SWITCH: "1"}  # nine sensors: a third of the time
    with subprocess.Popen(
        command, cwd=folder, env=environment(folder) | more, stdout=subprocess.PIPE, text=True
    ) as daemon:
        try:
            assert daemon.stdout is not None
            links = [sensor["links"][0] for sensor in json.loads(daemon.stdout.readline())["sensors"]]
            here = [text.replace("tcp:127.0.0.1:49152", links[1]) for text in wanted]
            here = [text.replace("socketcand:127.0.0.1:29536/can0", links[2]) for text in here]
            here = [text.replace("tcp:127.0.0.1:2112", links[3]) for text in here]
            here = [text.replace("tcp:127.0.0.1:10940", links[4]) for text in here]
            here = [text.replace("tcp:127.0.0.1:8080 --family ouster", f"{links[7]} --family ouster") for text in here]
            here = [text.replace("tcp:127.0.0.1:8080", links[5]) for text in here]
            here = [text.replace("tcp:127.0.0.11:9347", links[6]) for text in here]
            codes = run_all([words_of(text) for text in here], folder)
            reported, _ = daemon.communicate(timeout=60)
        finally:
            if daemon.poll() is None:
                daemon.kill()
                daemon.communicate()
    assert dict(zip(wanted, codes, strict=True)) == dict.fromkeys(wanted, 0)
    assert daemon.returncode == 0, reported
