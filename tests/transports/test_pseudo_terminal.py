"""What only a pseudo-terminal has: the host's speed, a host's absence, overruns, a name in the file system."""

from __future__ import annotations

import contextlib
import os
import select
import struct
import termios
from collections.abc import Iterator
from fcntl import ioctl
from pathlib import Path

import pytest
import serial

from emulator.errors import LinkError
from emulator.transports import pseudo_terminal
from emulator.transports.intake import LINE_BURST, LINE_BYTES_S
from emulator.transports.pseudo_terminal import POLL_NS, PseudoTerminal
from emulator.transports.schemes import open_link
from emulator.transports.uart import resample

MS = 1_000_000
TELEGRAM = bytes.fromhex("0200020020243408")
"Start of the LMS2xx stream, from the telegram listing through the drivers."


@contextlib.contextmanager
def opened(url: str, device_baud: int | None = None) -> Iterator[PseudoTerminal]:
    link = open_link(url)
    assert isinstance(link, PseudoTerminal)
    link.set_speed(device_baud)
    try:
        yield link
    finally:
        link.close()


@contextlib.contextmanager
def host_at(path: Path, baud: int = 9600) -> Iterator[serial.Serial]:
    with serial.Serial(str(path), baud, timeout=0) as host:
        yield host


@pytest.fixture
def port(tmp_path: Path) -> Path:
    return tmp_path / "front"


def take(link: PseudoTerminal, now_ns: int = 0) -> bytes:
    select.select(link.filenos(), [], [], 1.0)
    return b"".join(event.data for event in link.receive(now_ns))


def heard(end: serial.Serial, count: int) -> bytes:
    """`count` bytes, and whatever came with them: the kernel hands them over a moment after the write."""
    data = b""
    while len(data) < count and select.select([end.fileno()], [], [], 1.0)[0]:
        data += end.read(65_536)
    return data


def test_a_host_finds_it_raw_at_9600_and_not_exclusive(port: Path) -> None:
    with opened(f"pty:{port}"):
        fd = os.open(port, os.O_RDWR | os.O_NOCTTY)
        other = os.open(port, os.O_RDWR | os.O_NOCTTY)
        iflag, oflag, cflag, lflag, ispeed, ospeed, _ = termios.tcgetattr(fd)
        assert (iflag, oflag, lflag) == (0, 0, 0)
        assert (ispeed, ospeed) == (termios.B9600, termios.B9600)
        assert cflag & termios.CS8 == termios.CS8
        os.close(fd)
        os.close(other)


def test_its_settings_outlive_a_host(port: Path) -> None:
    with opened(f"pty:{port}") as link:
        with host_at(port, 38_400):
            pass
        link.receive(0)
        assert link.host_modes().sends_baud == 38_400


@pytest.mark.parametrize("baud", [9600, 38_400, 500_000, 123_457])
def test_the_hosts_speed_is_known_whatever_it_is(port: Path, baud: int) -> None:
    with opened(f"pty:{port}") as link, host_at(port, baud):
        modes = link.host_modes()
        assert (modes.sends_baud, modes.receives_baud) == (baud, baud)


@pytest.mark.parametrize(("device", "host"), [(9600, 9600), (500_000, 500_000), (38_400, 38_500)])
def test_at_the_same_speed_both_understand_each_other(port: Path, device: int, host: int) -> None:
    with opened(f"pty:{port}", device) as link, host_at(port, host) as end:
        end.write(TELEGRAM)
        assert take(link) == TELEGRAM
        link.send(TELEGRAM, 0)
        link.flush(100 * MS)
        assert heard(end, len(TELEGRAM)) == TELEGRAM
        assert link.stats.bytes_garbled == 0


@pytest.mark.parametrize(("device", "host"), [(9600, 38_400), (38_400, 9600), (500_000, 38_400), (9600, 500_000)])
def test_at_another_speed_both_get_what_a_uart_would(port: Path, device: int, host: int) -> None:
    with opened(f"pty:{port}", device) as link, host_at(port, host) as end:
        end.write(TELEGRAM)
        assert take(link) == resample(TELEGRAM, host, device).values.tobytes()
        link.send(TELEGRAM, 0)
        for step in range(330):  # in pieces: garbage is the same
            link.flush(step * 300_000)
        garbage = resample(TELEGRAM, device, host).values.tobytes()
        assert heard(end, len(garbage)) == garbage
        assert link.stats.bytes_garbled == 2 * len(TELEGRAM)


def test_what_a_host_sent_at_another_speed_is_known_beside_what_was_heard(port: Path) -> None:
    with opened(f"pty:{port}", 460_800) as link, host_at(port, 512_000) as end:
        end.write(b"\x41" * 64)
        (received,) = link.receive(0)
        assert received.foreign == (512_000, b"\x41" * 64)
        assert received.data == resample(b"\x41" * 64, 512_000, 460_800).values.tobytes()
    with opened(f"pty:{port}", 460_800) as link, host_at(port, 460_800) as end:
        end.write(b"\x41")
        assert link.receive(0)[0].foreign is None


def test_a_host_with_inpck_reads_framing_errors_as_zero(port: Path) -> None:
    with opened(f"pty:{port}", 9600) as link, host_at(port, 19_200) as end:
        modes = termios.tcgetattr(end.fileno())
        modes[0] |= termios.INPCK
        termios.tcsetattr(end.fileno(), termios.TCSANOW, modes)
        link.send(b"\x55", 0)
        link.flush(100 * MS)
        assert heard(end, 2) == b"\x00\xe6"


def test_a_look_for_input_is_one_look(port: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with opened(f"pty:{port}") as link, host_at(port) as host:
        host.write(b"asked")
        looks: list[str] = []
        look, may_have_changed = link._look, link._may_have_changed
        monkeypatch.setattr(link, "_look", lambda: looks.append("_look") or look())
        monkeypatch.setattr(link, "_may_have_changed", lambda: looks.append("changed") or may_have_changed())
        link.send(b"said", 0)
        assert take(link, 1_000_000_000) == b"asked"
        assert looks == ["_look"]
        assert heard(host, 4) == b"said"


def test_a_host_that_hangs_up_hears_and_says_nothing(port: Path) -> None:
    with opened(f"pty:{port}", 9600) as link, host_at(port) as end:
        modes = termios.tcgetattr(end.fileno())
        modes[2] &= ~0o010017
        modes[4] = modes[5] = termios.B0
        termios.tcsetattr(end.fileno(), termios.TCSANOW, modes)
        end.write(TELEGRAM)
        assert take(link) == b""
        link.send(TELEGRAM, 0)
        link.flush(100 * MS)
        assert end.read(100) == b""


def test_a_host_that_follows_the_device_to_a_new_speed_goes_on(port: Path) -> None:
    with opened(f"pty:{port}", 9600) as link, host_at(port) as end:
        link.send(b"A0", 0, line_speed=500_000)
        assert link.flush(3 * MS) is None
        assert heard(end, 2) == b"A0"
        end.baudrate = 500_000
        end.write(TELEGRAM)
        assert take(link, 3 * MS) == TELEGRAM


def test_with_custom_divisor_a_host_at_38400_also_hears_500000(port: Path) -> None:
    with opened(f"pty:{port}?speed=custom_divisor", 500_000) as link, host_at(port, 38_400) as end:
        end.write(TELEGRAM)
        assert take(link) == TELEGRAM
        link.set_speed(9600)
        end.write(TELEGRAM)
        assert take(link) != TELEGRAM


def test_with_ignore_any_speed_will_do(port: Path) -> None:
    with opened(f"pty:{port}?speed=ignore", 500_000) as link, host_at(port, 9600) as end:
        end.write(TELEGRAM)
        assert take(link) == TELEGRAM


def test_nothing_is_kept_for_a_host_that_comes_later(port: Path) -> None:
    with opened(f"pty:{port}", 500_000) as link:
        for number in range(100):
            link.send(bytes(732), number * 20 * MS)
            link.flush((number + 1) * 20 * MS)
        assert link.stats.bytes_lost == 73_200
        assert not link.host_present
        with host_at(port, 500_000) as end:
            link.flush(2000 * MS)
            assert link.host_present
            assert end.read(10) == b""


def test_what_a_host_did_not_read_goes_when_it_leaves(port: Path) -> None:
    with opened(f"pty:{port}", 500_000) as link:
        with host_at(port, 500_000) as end:
            link.send(bytes(10_000), 0)  # more than the terminal itself holds: the rest waits on its way there
            link.flush(300 * MS)
            select.select([end.fileno()], [], [], 1.0)
            assert end.in_waiting > 0
        select.select(link.filenos(), [], [], 1.0)
        link.receive(301 * MS)
        with host_at(port, 500_000) as end:
            link.send(b"fresh", 302 * MS)
            link.flush(303 * MS)
            assert heard(end, 5) == b"fresh"


def test_what_a_host_wrote_before_it_left_still_comes_in(port: Path) -> None:
    with opened(f"pty:{port}", 9600) as link:
        with host_at(port) as end:
            end.write(TELEGRAM)
        assert take(link) == TELEGRAM


def test_a_host_that_stays_open_and_does_not_read_loses_bytes_and_blocks_nobody(port: Path) -> None:
    with opened(f"pty:{port}", 500_000) as link, host_at(port, 500_000) as end:
        sent = 0
        for number in range(200):
            link.send(bytes(732), number * 20 * MS)
            sent += 732
            link.flush((number + 1) * 20 * MS)
        stats = link.stats
        assert stats.bytes_out + stats.bytes_lost == sent
        assert 4000 <= stats.bytes_out <= 80_000
        assert len(heard(end, stats.bytes_out)) == stats.bytes_out
        link.send(b"fresh", 5000 * MS)
        link.flush(5001 * MS)
        assert heard(end, 5) == b"fresh"


def test_a_host_that_flushes_loses_what_had_left_and_no_more(port: Path) -> None:
    with opened(f"pty:{port}", 9600) as link, host_at(port) as end:
        link.send(b"ABCDEFGH", 0)
        link.flush(5 * MS)
        select.select([end.fileno()], [], [], 1.0)
        termios.tcflush(end.fileno(), termios.TCIOFLUSH)
        link.flush(100 * MS)
        assert heard(end, 4) == b"EFGH"


def test_whoever_waits_is_woken_by_a_host_that_opens_and_never_spins_without_one(port: Path) -> None:
    with opened(f"pty:{port}", 9600) as link:
        link.receive(0)
        assert select.select(link.filenos(), [], [], 0)[0] == []
        with host_at(port) as end:
            assert select.select(link.filenos(), [], [], 1.0)[0]
            assert link.receive(0) == []
            assert select.select(link.filenos(), [], [], 0)[0] == []
            end.write(b"x")
            assert select.select(link.filenos(), [], [], 1.0)[0]
            assert take(link) == b"x"
        assert select.select(link.filenos(), [], [], 1.0)[0]
        for _ in range(3):  # our own flush of the terminal is an open and a close, too
            link.receive(0)
        assert select.select(link.filenos(), [], [], 0)[0] == []


def test_two_hosts_that_open_in_one_instant_count_as_long_as_one_stays(port: Path) -> None:
    with opened(f"pty:{port}", None) as link:
        one, other = (os.open(port, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK) for _ in range(2))
        link.receive(0)
        os.close(one)
        link.send(b"still heard", 0)
        link.flush(0)
        assert link.host_present
        select.select([other], [], [], 1.0)
        assert os.read(other, 100) == b"still heard"
        os.close(other)


def test_without_inotify_it_looks_every_so_often(port: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def none_left(_path: str) -> None:
        raise OSError(24, "Too many open files")

    monkeypatch.setattr(pseudo_terminal, "OpenWatch", none_left)
    with opened(f"pty:{port}", 9600) as link:
        assert link.filenos() == ()
        assert link.flush(5) == 5 + POLL_NS
        with host_at(port) as end:
            assert link.flush(6) is None
            end.write(b"x")
            assert take(link) == b"x"
        assert link.flush(7) == 7 + POLL_NS


def test_two_links_do_not_share_a_path_and_the_loser_leaves_nothing(port: Path) -> None:
    with opened(f"pty:{port}"):
        before = len(os.listdir("/proc/self/fd"))
        with pytest.raises(LinkError, match="in use by a running emulator"):
            open_link(f"pty:{port}")
        assert len(os.listdir("/proc/self/fd")) == before
    assert os.listdir(port.parent) == []


def test_the_path_is_stable_and_goes_with_the_link(port: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(port.parent)
    with opened("pty:./front") as link:
        assert link.url == f"pty:{port}"
        assert os.path.realpath(port) == link.slave_path
        monkeypatch.chdir("/")
    assert os.listdir(port.parent) == []


def test_a_flood_is_taken_in_bounded_pieces(port: Path) -> None:
    with opened(f"pty:{port}", None) as link, host_at(port) as end:
        sent = got = 0
        for number in range(300):
            with contextlib.suppress(BlockingIOError):
                sent += os.write(end.fileno(), bytes(4096))
            data = b"".join(event.data for event in link.receive(number * 1_000_000))
            assert len(data) <= LINE_BURST
            got += len(data)
        assert 0.9 * 0.3 * LINE_BYTES_S < got < 0.3 * LINE_BYTES_S + LINE_BURST
        assert link.filenos() == () or len(link.filenos()) < 2  # what waits does not wake us
        while got < sent:
            number += 1
            got += sum(len(event.data) for event in link.receive(number * 1_000_000))
        assert got == sent


def test_the_struct_of_the_kernel_is_what_we_think_it_is(port: Path) -> None:
    with opened(f"pty:{port}"), host_at(port, 57_600) as end:
        raw = ioctl(end.fileno(), 0x802C542A, bytes(44))
        assert struct.unpack_from("=2I", raw, 36) == (57_600, 57_600)
