"""When datagrams of a feed have come: by the kernel's stamp, however late they are read."""

from __future__ import annotations

import socket
import struct
import sys

import pytest

from emulator.live.receivers import MOST_UNREAD_NS, STAMP_ROOM, STAMPS, unread_ns

NOW_NS = 1_800_000_000_123_456_789


def stamp(ns: int) -> tuple[int, int, bytes]:
    """As the kernel gives one: struct timespec, see socket(7)."""
    return socket.SOL_SOCKET, STAMPS or 0, struct.pack("@qq", *divmod(ns, 1_000_000_000))


@pytest.mark.skipif(STAMPS is None, reason="stamps of Linux")
@pytest.mark.parametrize("waited_ns", [0, 1, 2_345_678, MOST_UNREAD_NS])
def test_a_datagram_has_waited_since_its_stamp(waited_ns: int) -> None:
    other = socket.SOL_SOCKET, socket.SCM_RIGHTS, b"\0" * 16
    assert unread_ns([other, stamp(NOW_NS - waited_ns)], NOW_NS) == waited_ns


@pytest.mark.parametrize("waited_ns", [-1, -3_600_000_000_000, MOST_UNREAD_NS + 1])
def test_a_clock_that_was_set_says_nothing(waited_ns: int) -> None:
    assert unread_ns([stamp(NOW_NS - waited_ns)], NOW_NS) == 0


def test_without_a_stamp_it_has_just_come() -> None:
    assert unread_ns([], NOW_NS) == 0
    assert unread_ns([(socket.SOL_SOCKET, STAMPS or 0, b"\0" * 8)], NOW_NS) == 0


@pytest.mark.skipif(sys.platform != "linux", reason="stamps of Linux")
def test_the_kernel_stamps_what_comes() -> None:
    there, here = (socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(2))
    with there, here:
        here.bind(("127.0.0.1", 0))
        here.setsockopt(socket.SOL_SOCKET, STAMPS or 0, 1)
        there.sendto(b"x", here.getsockname())
        data, ancillary, _, _ = here.recvmsg(100, STAMP_ROOM)
    assert data == b"x"
    assert [kind for _, kind, _ in ancillary] == [STAMPS]
    seconds, nanoseconds = struct.unpack("@qq", ancillary[0][2])
    assert unread_ns(ancillary, 1_000_000_000 * seconds + nanoseconds + 7) == 7
