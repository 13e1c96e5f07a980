"""The emulated serial adapter: commands and frames as text, a host that dies, and the stock client."""

from __future__ import annotations

import contextlib
import os
import select
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from emulator.transports.can_link import CanLink
from emulator.transports.link import Received
from emulator.transports.schemes import open_link
from emulator.transports.slcan import BACKLOG_LIMIT
from protocols.can_frame import EXTENDED
from tests.draws import cases

MS = 1_000_000
SECOND = 1_000_000_000

CONFIG = Received(0x200, bytes.fromhex("B91F4000088C0100"))


class Rig:
    """A link and whoever has its terminal open; time is the test's own."""

    def __init__(self, path: Path) -> None:
        link = open_link(f"slcan:{path}")
        assert isinstance(link, CanLink)
        self.link = link
        self.path = path
        self.now_ns = SECOND
        self.fd = -1

    def open(self) -> None:
        self.fd = os.open(self.path, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
        self.step()

    def hang_up(self) -> None:
        os.close(self.fd)
        self.fd = -1
        self.step()

    def step(self) -> list[Received]:
        select.select(self.link.filenos(), [], [], 0.002)
        got = self.link.receive(self.now_ns)
        self.link.flush(self.now_ns)
        return got

    def say(self, text: str) -> None:
        os.write(self.fd, text.encode())

    def read(self) -> str:
        """What has arrived, waiting a moment for the kernel."""
        text = ""
        for _ in range(200):
            self.step()
            if not select.select([self.fd], [], [], 0.005)[0]:
                if text:
                    break
                continue
            text += os.read(self.fd, 65536).decode()
        return text

    def ask(self, text: str) -> str:
        self.say(text)
        return self.read()

    def hear(self, count: int = 1) -> list[Received]:
        got: list[Received] = []
        for _ in range(1000 if count else 5):
            got += self.step()
            if len(got) >= count > 0:
                break
            self.now_ns += MS
        return got

    def close(self) -> None:
        if self.fd >= 0:
            os.close(self.fd)
        self.link.close()


@pytest.fixture
def rig(tmp_path: Path) -> Iterator[Rig]:
    made = Rig(tmp_path / "adapter")
    made.open()
    yield made
    made.close()


@pytest.mark.parametrize(
    ("said", "answer"),
    [
        ("\r", "\r"),
        ("C\r", "\r"),
        ("S6\r", "\r"),
        ("S9\r", "\a"),
        ("s031C\r", "\r"),
        ("s03\r", "\a"),
        ("O\r", "\r"),
        ("L\r", "\r"),
        ("V\r", "V1013\r"),
        ("v\r", "V1013\r"),
        ("N\r", "NA001\r"),
        ("F\r", "F00\r"),
        ("Z1\r", "\r"),
        ("Z2\r", "\a"),
        ("M00000000\r", "\a"),
        ("X1\r", "\a"),
        ("hello\r", "\a"),
        ("t2000\r", "\a"),  # the channel is closed
        ("x" * 100, "\a"),
    ],
)
def test_each_command_has_its_answer(rig: Rig, said: str, answer: str) -> None:
    assert rig.ask(said) == answer


@pytest.mark.parametrize(
    ("said", "answer"),
    [
        ("t2008B91F4000088C0100\r", "z\r"),
        ("T000002008B91F4000088C0100\r", "Z\r"),
        ("t2000\r", "z\r"),
        ("r2002\r", "z\r"),
        ("R000002002\r", "Z\r"),
        ("t8000\r", "\a"),
        ("T200000000\r", "\a"),
        ("t2009\r", "\a"),
        ("t2002B9\r", "\a"),
        ("t2001B91\r", "\a"),
        ("t20\r", "\a"),
        ("t200\r", "\a"),
        ("t2001XY\r", "\a"),
        ("t-011FF\r", "\a"),
        ("r20021122\r", "\a"),
        ("S5\r", "\a"),  # not while it is open
    ],
)
def test_an_open_channel_takes_frames_and_refuses_what_is_none(rig: Rig, said: str, answer: str) -> None:
    assert rig.ask("O\r") == "\r"
    assert rig.ask(said) == answer


@pytest.mark.parametrize("chunked", [False, True])
def test_the_worked_configuration_reaches_the_sensor(rig: Rig, chunked: bool) -> None:
    rig.ask("S6\rO\r")
    text = "t2008B91F4000088C0100\r"
    for piece in text if chunked else [text * 2]:
        rig.say(piece)
    assert rig.hear(1 if chunked else 2) == [CONFIG] * (1 if chunked else 2)


def test_the_worked_header_reaches_the_host_and_time_stamps_when_wanted(rig: Rig) -> None:
    rig.ask("O\r")
    rig.link.send(bytes.fromhex("03FBF710"), rig.now_ns, 0x60A)
    rig.now_ns += 2 * MS
    assert rig.read() == "t60A403FBF710\r"
    rig.ask("Z1\r")
    rig.link.send(b"", 61 * SECOND, 0x1ABCDEF | EXTENDED)
    rig.now_ns = 61 * SECOND + 2 * MS
    assert rig.read() == "T01ABCDEF003E8\r"  # 61.000 s: 1000 ms after the minute


def test_the_start_and_end_of_the_stock_client_is_understood(rig: Rig) -> None:
    assert rig.ask("C\rS6\r\rO\rO\r") == "\r" * 5
    rig.link.send(b"a", rig.now_ns, 0x100)
    rig.now_ns += 2 * MS
    assert rig.read() == "t100161\r"  # once
    assert rig.ask("C\r") == "\r"
    rig.link.send(b"a", rig.now_ns, 0x100)
    rig.now_ns += 2 * MS
    assert rig.ask("N\r") == "NA001\r"


def test_an_adapter_that_only_listens_sends_nothing(rig: Rig) -> None:
    rig.ask("L\r")
    assert rig.ask("t2000\r") == "\a"
    rig.link.send(b"a", rig.now_ns, 0x100)
    rig.now_ns += 2 * MS
    assert rig.read() == "t100161\r"


@pytest.mark.parametrize(("rate", "hears"), [("S6", True), ("S5", False), ("s001C", True), ("s011C", False)])
def test_at_another_bit_rate_nothing_passes_and_the_flags_show_a_bus_error(rig: Rig, rate: str, hears: bool) -> None:
    # timing registers of an SJA1000: 8 MHz / (1 * 16) = 500 kbit/s with 00 1C, half of it with 01 1C
    assert rig.ask(f"{rate}\rO\r") == "\r\r"
    rig.link.send(b"a", rig.now_ns, 0x100)
    rig.now_ns += 2 * MS
    rig.step()
    assert rig.ask("F\r") == ("t100161\rF00\r" if hears else "F80\r")
    rig.say("t2000\r")
    assert len(rig.hear(int(hears))) == int(hears)


def test_a_host_that_dies_without_closing_leaves_the_sensor_running_and_the_next_one_a_clean_adapter(rig: Rig) -> None:
    rig.ask("O\r")
    rig.hang_up()
    for k in range(5000):
        rig.link.send(k.to_bytes(8, "big"), rig.now_ns, 0x100)
        rig.now_ns += MS
        rig.link.flush(rig.now_ns)
    assert rig.link.stats.bytes_lost > 30_000
    rig.open()
    assert rig.ask("N\r") == "NA001\r"
    assert rig.ask("t2000\r") == "\a"  # the channel is closed again
    assert rig.ask("O\r") == "\r"


def test_a_host_that_does_not_read_loses_whole_frames_and_none_while_the_buffer_has_room(rig: Rig) -> None:
    rig.ask("O\r")
    for k in range(6000):
        rig.link.send(k.to_bytes(8, "big"), rig.now_ns, 0x100)
        rig.now_ns += MS
        rig.link.flush(rig.now_ns)
    assert rig.link.stats.payloads_dropped > 0
    lines = rig.read().split("\r")
    assert all(len(text) == 21 and text.startswith("t1008") for text in lines[:-1])
    numbers = [int(text[5:], 16) for text in lines[:-1]]
    assert numbers[:2000] == list(range(2000))
    assert rig.ask("F\r") == "F08\r"


def test_a_host_that_asks_without_end_and_never_reads_does_not_fill_the_memory(rig: Rig) -> None:
    for _ in range(100):
        with contextlib.suppress(BlockingIOError):
            os.write(rig.fd, b"V\r" * 2000)
        rig.step()
        rig.now_ns += SECOND
    assert rig.link.held() < BACKLOG_LIMIT + 20_000
    while text := rig.read():
        assert set(text.split("\r")) == {"V1013", ""}
        rig.now_ns += SECOND
    assert rig.ask("F\r") == "F08\r", "some answers did not fit"


@settings(max_examples=cases(40), suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(said=st.lists(st.text("CSOLVvNFZtTrR0123456789ABCDEFxyz", max_size=20), max_size=4))
def test_any_text_is_answered_line_by_line(rig: Rig, said: list[str]) -> None:
    rig.ask("C\r")
    answers = rig.ask("".join(text + "\r" for text in said)) if said else ""
    assert answers.count("\r") + answers.count("\a") == len(said)


def test_the_stock_client_sends_and_receives(rig: Rig) -> None:
    import threading

    import can

    os.close(rig.fd)
    rig.fd = -1
    stop = threading.Event()

    def serve() -> None:
        while not stop.is_set():
            heard.extend(rig.step())
            rig.now_ns += MS

    heard: list[Any] = []
    server = threading.Thread(target=serve)
    server.start()
    bus = can.Bus(interface="slcan", channel=str(rig.path), bitrate=500_000, sleep_after_open=0)
    try:
        bus.send(can.Message(arbitration_id=0x200, data=CONFIG.data, is_extended_id=False))
        while not heard:
            pass
        assert heard == [CONFIG]
        stop.set()
        server.join()
        for k in range(200):
            rig.link.send(bytes([k]), rig.now_ns, 0x60B)
        rig.now_ns += 100 * MS
        rig.step()
        seen = []
        while len(seen) < 200:
            message = bus.recv(1.0)
            assert message is not None
            seen.append(message.data[0])
        assert seen == list(range(200))
    finally:
        stop.set()
        server.join()
        bus.shutdown()
