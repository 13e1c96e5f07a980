"""An LD device on real sockets and a real pseudo-terminal, in virtual time: hosts that are slow, or vanish, or both.

The kernel carries the bytes; the clock is stepped by the test, so nothing here waits for time to pass.
"""

from __future__ import annotations

import os
import select
import socket
import struct
import tty
from collections.abc import Iterator
from pathlib import Path

import pytest

from emulator.instrument.instrument import Instrument
from emulator.measuring.measuring import InPlace
from emulator.transports.schemes import open_link
from protocols.ld import FAMILY
from tests.protocols.ld.reader import package, read_frames, read_packages, read_profile, request, words
from tests.protocols.ld.rig import FACTS, MS, SECOND, ten_metres
from tests.system.conftest import TIME_LIMIT_S


class Bench:
    """One device on the links of its URLs."""

    def __init__(self, urls: list[str], **device: object) -> None:
        self.session = FAMILY.new_session({"delays": "fast", "mode": "measure", **device}, FACTS)
        self.links = [open_link(url, FAMILY.tcp_is_line) for url in urls]
        self.instrument = Instrument("ld", self.session, self.links, InPlace({"ld": ten_metres}))
        self.now_ns = 0
        self.instrument.power_on(0)

    def run(self, duration_ns: int) -> None:
        """Let time pass; input is looked for at every stop, and every two milliseconds at least."""
        until_ns = self.now_ns + duration_ns
        while self.now_ns < until_ns:
            wake_ns = self.instrument.step(self.now_ns)
            step_ns = 2 * MS if wake_ns is None else min(max(wake_ns - self.now_ns, 0), 2 * MS)
            self.now_ns = min(self.now_ns + step_ns, until_ns)
        self.instrument.step(self.now_ns)

    def connect(self) -> socket.socket:
        """A host on the TCP link."""
        host, port = self.links[0].url.removeprefix("tcp:").rsplit(":", 1)
        connection = socket.create_connection((host, int(port)), timeout=TIME_LIMIT_S)
        self.run(4 * MS)
        return connection


@pytest.fixture
def bench() -> Iterator[Bench]:
    made = Bench(["tcp:127.0.0.1:0"], motor_hz=5, step_deg=0.1875)
    yield made
    made.instrument.close()


def waiting(connection: socket.socket) -> bytes:
    """Everything that has come and not been read."""
    data = b""
    while select.select([connection], [], [], 0.01)[0]:
        chunk = connection.recv(1 << 20)
        if not chunk:
            break
        data += chunk
    return data


def test_a_host_that_reads_too_slowly_loses_whole_profiles_and_never_half_a_one(bench: Bench) -> None:
    slow, quick = bench.connect(), bench.connect()
    with slow, quick:
        slow.sendall(request(0x0301, 0, 0x3FFF))
        quick.sendall(request(0x0301, 0, 0x0001))
        bench.run(4 * MS)
        bench.run(40 * SECOND)
        assert bench.links[0].stats.payloads_dropped > 0
        data = waiting(slow)
        for _ in range(30):
            bench.run(200 * MS)
            data += waiting(slow)
        payloads = read_frames(data)  # nothing but whole frames with right checksums
        numbers = [read_profile(payload).sent for payload in payloads]
        assert {len(payload) for payload in payloads} == {len(payloads[0])}
        assert numbers == sorted(numbers)  # type: ignore[type-var]
        missed = (numbers[-1] or 0) - len(numbers)
        assert missed == bench.links[0].stats.payloads_dropped
        assert [read_profile(payload).sent for payload in read_frames(waiting(quick))] == list(
            range(1, (numbers[-1] or 0) + 1)
        )


def test_a_host_that_resets_in_the_middle_of_a_telegram_leaves_the_others_alone(bench: Bench) -> None:
    other = bench.connect()
    with other:
        other.sendall(request(0x0301, 0, 0x0001))
        for _ in range(5):
            rude = bench.connect()
            rude.sendall(request(0x0301, 0, 0x3DFF) + request(0x0102)[:7])
            bench.run(500 * MS)
            rude.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
            rude.close()
            bench.run(500 * MS)
        numbers = [read_profile(payload).sent for payload in read_frames(waiting(other))]
        assert numbers == list(range(1, len(numbers) + 1))
        assert len(numbers) in (24, 25)
        other.sendall(request(0x0302))
        bench.run(100 * MS)
        assert read_frames(waiting(other))[-1] == bytes.fromhex("83 02 00 00 00 03")


def test_a_host_that_closes_its_sending_half_is_still_answered(bench: Bench) -> None:
    host = bench.connect()
    with host:
        host.sendall(request(0x0102) + request(0x0205)[:4])
        host.shutdown(socket.SHUT_WR)
        bench.run(100 * MS)
        assert read_frames(waiting(host)) == [bytes.fromhex("81 02 00 00 00 03")]


def test_a_telegram_cut_anywhere_by_the_network_is_one_telegram(bench: Bench) -> None:
    host = bench.connect()
    host.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    with host:
        whole = request(0x0209, 1, 0)
        for cut in range(1, len(whole)):
            host.sendall(whole[:cut])
            bench.run(20 * MS)
            host.sendall(whole[cut:])
            bench.run(20 * MS)
            assert read_frames(waiting(host)) == [bytes.fromhex("82 09 00 01 00 00")]


def test_a_host_on_a_pseudo_terminal_reads_a_profile_of_many_packages(tmp_path: Path) -> None:
    path = tmp_path / "ld"
    made = Bench([f"pty:{path}"], step_deg=1)
    try:
        made.run(10 * MS)
        host = os.open(path, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
        tty.setraw(host)
        attributes = tty.tcgetattr(host)
        attributes[4] = attributes[5] = tty.B115200
        tty.tcsetattr(host, tty.TCSANOW, attributes)
        made.run(10 * MS)
        os.write(host, package(0x0010, 5, 0, 0x0301, 1, 0x0700, lower_case=True))
        data = b""
        for _ in range(800):
            made.run(MS)
            if select.select([host], [], [], 0)[0]:
                data += os.read(host, 4096)
        os.close(host)
        ((address, message),) = read_packages(data)
        assert (address, message[:3], len(message)) == (0x1000, [0x8301, 0x0700, 0x0101], 3 + 3 * 360)
        assert message[3::3] == [2560] * 360
        assert data.count(b"\x02") == 9
    finally:
        made.instrument.close()


def test_a_stack_that_only_listens_gets_profiles_by_datagram() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as host:
        host.bind(("127.0.0.1", 0))
        made = Bench([f"udp:127.0.0.1:{host.getsockname()[1]}?listen=127.0.0.1:0"], mode=None, step_deg=0.5)
        try:
            made.run(SECOND)
            host.settimeout(TIME_LIMIT_S)
            profiles = [read_profile(read_frames(host.recv(70_000))[0]) for _ in range(10)]
            assert [profile.sent for profile in profiles] == list(range(1, 11))
            assert {profile.form for profile in profiles} == {0x3DFF}
            listening = made.links[0].url.rsplit(":", 1)[1]
            host.sendto(request(0x0403, 0), ("127.0.0.1", int(listening)))
            made.run(SECOND)
            while (reply := read_frames(host.recv(70_000))[0])[:2] == b"\x83\x01":
                pass
            assert words(reply) == [0x8403, 0, 2]
        finally:
            made.instrument.close()
