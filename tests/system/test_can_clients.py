"""Stock python-can in other processes reads a hundred object lists: every frame, in order, and its log files open.

The sensor runs here on the real clock; the readers are `python -m can.logger` and a few lines around `can.Bus`, as a
user would write them.
"""

from __future__ import annotations

import os
import select
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import partial
from importlib.resources import files
from pathlib import Path

import can
import pytest

from emulator.errors import LinkError
from emulator.instrument.instrument import Instrument
from emulator.measuring.conditions import NORMAL, Conditions
from emulator.process.clock import SystemClock
from emulator.transports.schemes import open_link
from emulator.transports.shim import find_compiler
from protocols.can_objects import FAMILY
from protocols.scan import DetectedObject, Scan, ScanPlan
from tests.system.nursery import ran

LISTS = 100
CYCLE_MS = 20
SECOND = 1_000_000_000

OBJECTS = 8
LIST_FRAMES = LISTS * (1 + 3 * OBJECTS)

READER = """
import sys, can
bus, wanted = can.Bus(**eval(sys.argv[1])), int(sys.argv[2])
print("ready", flush=True)
while wanted and (message := bus.recv(60.0)) is not None:
    print(f"{message.arbitration_id:X} {bytes(message.data).hex()}")
    wanted -= 0x60A <= message.arbitration_id <= 0x60D
print("end", flush=True)
bus.shutdown()
"""
"Prints every frame until it has seen so many frames of lists."

Record = tuple[int, bytes]


@dataclass
class Sensor:
    """A sensor on the real clock in a thread of its own; told to, it sends lists until so many have gone.

    A machine that halts this thread for a second costs lists, as it costs a real daemon's. They are no client's loss.
    """

    url: str
    sent: list[Record] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.link = open_link(self.url)
        device = {"format": "ars408", "cycle_ms": CYCLE_MS, "boot_ms": 0}
        self.instrument = Instrument("sensor", FAMILY.new_session(device, {}), [self.link], self, look_ahead_ns=0)
        self._plans: list[ScanPlan] = []
        self._lists = 0
        self._clock = SystemClock()
        self._go = threading.Event()
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._serve)
        send = self.link.send

        def recording(payload: bytes, due_ns: int, peer: int | None = None, line_speed: int | None = None) -> None:
            assert peer is not None
            refused = self.link.stats.payloads_dropped
            send(payload, due_ns, peer, line_speed)
            if self.link.stats.payloads_dropped == refused:
                self.sent.append((peer, payload))

        self.link.send = recording  # type: ignore[method-assign]
        self._thread.start()

    def go(self) -> None:
        """Switch the sensor on."""
        self._go.set()

    def close(self) -> None:
        self._stop.set()
        self._thread.join()
        self.instrument.close()

    def request(self, sensor: str, plan: ScanPlan, conditions: Conditions = NORMAL) -> None:
        self._plans.append(plan)

    def collect(self, sensor: str) -> list[Scan]:
        plans, self._plans = self._plans, []
        scans = []
        for plan in plans:
            if list_frames(self.sent) < LIST_FRAMES:
                scans.append(replace(Scan.empty(plan), objects=tuple(objects(self._lists))))
                self._lists += 1
        return scans

    def _serve(self) -> None:
        powered = False
        while not self._stop.is_set():
            now_ns = self._clock.now_ns()
            if self._go.is_set() and not powered:
                powered = True
                self.instrument.power_on(now_ns)
            wake = self.instrument.step(now_ns) if powered else self.link.flush(now_ns)
            if not powered:
                self.link.receive(now_ns)
            limit_ns = now_ns + 20_000_000
            wait_ns = (limit_ns if wake is None else min(wake, limit_ns)) - self._clock.now_ns()
            select.select(self.link.filenos(), [], [], max(0, wait_ns) / SECOND)


def objects(number: int) -> list[DetectedObject]:
    """Objects that change from list to list."""
    return [
        DetectedObject(
            track=k,
            position_m=(5.0 + 7.0 * k + 0.2 * number, -4.0 + k, 0.0),
            velocity_m_s=(0.25 * k, -0.25 * number / 10, 0.0),
            size_m=(4.4, 1.8, 1.5),
            yaw_rad=0.0,
            category="car",
        )
        for k in range(OBJECTS)
    ]


@contextmanager
def sensor(url: str) -> Iterator[Sensor]:
    made = Sensor(url)
    try:
        yield made
    finally:
        made.close()


@contextmanager
def process(*arguments: str) -> Iterator[subprocess.Popen[str]]:
    environment = {**os.environ, "PYTHONUNBUFFERED": "1"}
    started = subprocess.Popen(
        [sys.executable, *arguments], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True, env=environment,
        preexec_fn=partial(signal.signal, signal.SIGINT, signal.SIG_DFL),  # what runs in the background ignores it
    )  # fmt: skip
    try:
        yield started
    finally:
        if started.poll() is None:
            started.kill()
        started.communicate()


def wait_for(reader: subprocess.Popen[str], text: str) -> None:
    assert reader.stdout is not None
    for line in reader.stdout:
        if text in line:
            return
    raise AssertionError(f"ended before it said {text!r}")


def until(holds: Callable[[], bool]) -> None:
    end = time.monotonic() + 60.0
    while not holds():
        assert time.monotonic() < end, "not in time"
        time.sleep(0.01)


def frames(output: str) -> list[Record]:
    lines = [line.split(" ") for line in output.splitlines() if line and line != "end"]
    return [(int(identifier, 16), bytes.fromhex(data)) for identifier, data in lines]


def list_frames(records: Sequence[Record]) -> int:
    return sum(0x60A <= peer <= 0x60D for peer, _ in records)


def socketcand_bus(url: str) -> dict[str, object]:
    address, _, channel = url.partition(":")[2].partition("/")
    host, _, port = address.rpartition(":")
    return {"interface": "socketcand", "host": host, "port": int(port), "channel": channel}


def test_every_frame_of_a_hundred_lists_reaches_readers_and_loggers_over_socketcand(tmp_path: Path) -> None:
    logs = [tmp_path / f"run.{kind}" for kind in ("blf", "asc", "log")]
    with sensor("socketcand:127.0.0.1:0/can0") as device:
        bus = socketcand_bus(device.link.url)
        logger = ["-m", "can.logger", "-i", "socketcand", "-c", "can0", "-f"]
        keywords = ["--bus-kwargs", f"host={bus['host']}", f"port={bus['port']}"]
        with (
            process("-c", READER, repr(bus), str(LIST_FRAMES)) as reader,
            process(*logger, str(logs[0]), *keywords) as blf,
            process(*logger, str(logs[1]), *keywords) as asc,
            process(*logger, str(logs[2]), *keywords) as candump,
        ):
            wait_for(reader, "ready")
            for one in (blf, asc, candump):
                wait_for(one, "Can Logger")
            device.go()
            seen = frames(reader.communicate(timeout=120)[0])
            time.sleep(0.5)  # the loggers may be behind the reader
            for one in (blf, asc, candump):
                one.send_signal(signal.SIGINT)
                one.wait(timeout=60)
        sent = list(device.sent)
    assert list_frames(seen) == LIST_FRAMES
    assert seen == sent[: len(seen)]
    for path in logs:
        with can.LogReader(path) as opened:
            stored = [(message.arbitration_id, bytes(message.data)) for message in opened if not message.is_error_frame]
        assert stored[: len(seen)] == seen, path.suffix


def test_every_frame_of_a_hundred_lists_reaches_a_reader_over_slcan(tmp_path: Path) -> None:
    with sensor(f"slcan:{tmp_path / 'adapter'}") as device:
        bus = {"interface": "slcan", "channel": str(tmp_path / "adapter"), "bitrate": 500_000, "sleep_after_open": 0.1}
        with process("-c", READER, repr(bus), str(LIST_FRAMES)) as reader:
            wait_for(reader, "ready")
            until(lambda: device.link._port.outlet._open)  # the client has written its commands and waits for no answer
            device.go()
            seen = frames(reader.communicate(timeout=120)[0])
        sent = list(device.sent)
    assert list_frames(seen) == LIST_FRAMES
    assert seen == sent[: len(seen)]


def test_cantools_on_the_command_line_decodes_the_log_of_a_run(tmp_path: Path) -> None:
    log = tmp_path / "run.log"
    with can.CanutilsLogWriter(log) as writer:
        for k in range(3):
            data = bytes.fromhex("075013F67DA00099")
            writer.on_message_received(
                can.Message(timestamp=k, arbitration_id=0x60B, data=data, is_extended_id=False, channel="can0")
            )
    text = "".join(line.removesuffix(" R\n") + "\n" for line in log.read_text().splitlines(keepends=True))
    layout = str(files("protocols.can_objects").joinpath("ars408.dbc"))
    result = subprocess.run(
        [sys.executable, "-m", "cantools", "decode", "--single-line", layout],
        input=text,
        capture_output=True,
        text=True,
        check=True,
    )
    assert result.stdout.count("ObjGeneral(ObjId: 7, DistLong: 12.39999") == 3
    assert result.stdout.count("DynProp: moving, Rcs: 12.5 dBm2)") == 3


@pytest.mark.skipif(shutil.which("candump") is None, reason="can-utils is not installed")
@pytest.mark.skipif(find_compiler(os.environ) is None, reason="no C compiler here")
def test_candump_reads_a_run_without_a_kernel_module_and_the_wall_clock(tmp_path: Path) -> None:
    words = ["run", "fog_objects", "--link", "radar=socketcand:127.0.0.1:0/can0"]
    words += ["--link", f"scanner=pty:{tmp_path / 'scanner'}", "--duration", "30", "--json", "--shim"]
    begun = time.time()
    done = ran(*words, "--", "candump", "-L", "-n", "3", "can0", cwd=tmp_path, seconds=100)
    lines = [line.split(" ") for line in done.stderr.splitlines() if line.startswith("(")]
    assert [line[1] for line in lines] == ["can0"] * 3, done.stderr
    assert all(begun - 1 < float(line[0].strip("()")) < time.time() + 1 for line in lines)
    assert done.returncode == 0


def test_a_socketcan_interface_is_used_where_the_machine_has_one() -> None:
    try:
        link = open_link("can:socketcan:vcan0")
    except LinkError as error:
        pytest.skip(f"no SocketCAN here: {error}")
    host = can.Bus(interface="socketcan", channel="vcan0")
    try:
        link.send(b"abc", 0, 0x123)
        link.flush(SECOND)
        message = host.recv(1.0)
        assert message is not None
        assert (message.arbitration_id, bytes(message.data)) == (0x123, b"abc")
    finally:
        host.shutdown()
        link.close()
