"""A real port's code path over a pseudo-terminal pair: the port is the slave, the test holds the master."""

from __future__ import annotations

import os
import select
import termios
from collections.abc import Iterator

import pytest

from emulator.errors import LinkError
from emulator.transports import serial_port
from emulator.transports.schemes import open_link
from emulator.transports.serial_port import RETRY_NS, SerialPort
from emulator.transports.tty_modes import read_modes

MS = 1_000_000


class Pair:
    def __init__(self) -> None:
        self.master, slave = os.openpty()
        self.path = os.ttyname(slave)
        os.set_blocking(self.master, False)
        link = open_link(f"serial:{self.path}?baud=9600")
        assert isinstance(link, SerialPort)
        self.link = link
        os.close(slave)

    def read(self, count: int) -> bytes:
        data = b""
        while len(data) < count and select.select([self.master], [], [], 1.0)[0]:
            data += os.read(self.master, 65_536)
        return data

    def speed(self) -> int:
        return read_modes(self.master).sends_baud


@pytest.fixture
def pair() -> Iterator[Pair]:
    pair = Pair()
    yield pair
    pair.link.close()
    os.close(pair.master)


def test_a_payload_is_handed_over_whole_when_due(pair: Pair) -> None:
    pair.link.send(b"telegram", 5)
    assert pair.link.flush(4) == 5
    assert pair.link.flush(5) is None
    assert pair.read(8) == b"telegram"


def test_the_speed_changes_when_the_last_bit_is_through(pair: Pair) -> None:
    pair.link.send(bytes(96), 0, line_speed=500_000)
    pair.link.send(b"after", 0)
    assert pair.link.flush(0) == 100 * MS
    assert pair.speed() == 9600
    assert pair.link.flush(100 * MS - 1) == 100 * MS
    assert pair.read(96) == bytes(96)
    assert pair.link.flush(100 * MS) is None
    assert pair.speed() == 500_000
    assert pair.read(5) == b"after"


def test_the_transmitter_is_asked_where_it_can_be(pair: Pair, monkeypatch: pytest.MonkeyPatch) -> None:
    empty = [False]
    monkeypatch.setattr(SerialPort, "_transmitter_empty", lambda self: empty[0])
    pair.link.send(b"x", 0, line_speed=38_400)
    pair.link.flush(0)
    assert pair.link.flush(50 * MS) == 50 * MS + RETRY_NS
    assert pair.speed() == 9600
    empty[0] = True
    assert pair.link.flush(52 * MS) is None
    assert pair.speed() == 38_400


def test_a_driver_that_still_holds_bytes_is_waited_for(pair: Pair, monkeypatch: pytest.MonkeyPatch) -> None:
    held = [3]
    monkeypatch.setattr(serial_port, "waiting_output", lambda fd: held[0])
    pair.link.send(b"x", 0, line_speed=38_400)
    pair.link.flush(0)
    assert pair.link.flush(50 * MS) == 50 * MS + RETRY_NS
    held[0] = 0
    pair.link.flush(52 * MS)
    assert pair.speed() == 38_400


def test_any_speed_the_system_takes_is_set(pair: Pair) -> None:
    pair.link.set_speed(123_457)
    assert pair.speed() == 123_457
    pair.link.set_speed(None)
    assert pair.speed() == 123_457


def test_a_driver_that_takes_nothing_more_is_tried_again(pair: Pair) -> None:
    pair.link.send(bytes(100_000), 0)
    pair.link.send(b"end", 0)
    assert pair.link.flush(0) == RETRY_NS
    data = b""
    now_ns = 0
    while len(data) < 100_003:
        data += pair.read(1)
        now_ns += RETRY_NS
        pair.link.flush(now_ns)
    assert data == bytes(100_000) + b"end"


@pytest.mark.parametrize("noticed_by", ["receive", "flush"])
def test_an_adapter_that_is_pulled_out_is_told_once(noticed_by: str) -> None:
    pair = Pair()
    os.close(pair.master)
    if noticed_by == "flush":
        pair.link.send(b"x", 0)
        assert pair.link.flush(7) == 7
    assert select.select(pair.link.filenos(), [], [], 0)[0] or noticed_by == "flush"
    with pytest.raises(LinkError, match=rf"serial:{pair.path}: lost: "):
        pair.link.receive(0)
    assert pair.link.filenos() == ()
    assert pair.link.receive(1) == []
    pair.link.send(b"x", 1)
    assert pair.link.flush(2) is None
    pair.link.set_speed(9600)
    pair.link.close()
    pair.link.close()


def test_a_port_that_refuses_a_speed_is_lost(pair: Pair, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object) -> None:
        raise termios.error(22, "Invalid argument")

    monkeypatch.setattr("serial.serialposix.termios.tcsetattr", refuse)
    pair.link.send(b"x", 0, line_speed=38_400)
    pair.link.flush(0)
    assert pair.link.flush(10 * MS) == 10 * MS
    with pytest.raises(LinkError, match="Invalid argument"):
        pair.link.receive(10 * MS)


def test_nothing_to_read_is_not_a_loss(pair: Pair) -> None:
    assert pair.link.receive(0) == []
    os.write(pair.master, b"host")
    select.select(pair.link.filenos(), [], [], 1.0)
    assert pair.link.receive(0)[0].data == b"host"


@pytest.mark.parametrize(
    ("device", "cause"), [("/dev/no-such-port", "No such file"), ("/etc/hostname", "cannot be opened")]
)
def test_a_port_that_cannot_be_opened_is_said_so_with_those_there_are(device: str, cause: str) -> None:
    with pytest.raises(LinkError, match=cause) as refusal:
        open_link(f"serial:{device}")
    assert "ports of this machine: " in str(refusal.value)
    assert refusal.value.exit_code == 3


def test_a_port_in_use_is_refused(pair: Pair) -> None:
    with pytest.raises(LinkError, match="cannot be opened"):
        open_link(f"serial:{pair.path}")
