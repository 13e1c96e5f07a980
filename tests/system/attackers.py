"""One attacker of one link, as a process: `python -m tests.system.attackers KIND SECONDS PLACE CONNECTIONS`.

It shares no code with the product. Kinds: `line` and `adapter` (of a path), `stream` and `bus` (of a port), `deaf` (of
a port: clients of a bus that write and never read), `datagrams` (of a port), `control` and `deaf-control` (of a path).
Each writes as fast as it is read from, comes again when it is hung up on, and prints what it has written.
"""

from __future__ import annotations

import contextlib
import json
import os
import random
import select
import socket
import sys
import time

LD = bytes.fromhex("02555350000000020101") + b"\0"
LMS = (bytes.fromhex("020001003131") + b"\x12", b"\x02\x00" * 8, bytes.fromhex("0200020020243408"))
SEND = b"< send 123 8 1 2 3 4 5 6 7 8 >"
ASKED = [
    b'{"jsonrpc": "2.0", "id": 1, "method": "%s"}\n' % name
    for name in (b"status", b"scans", b"telegrams", b"scene", b"metrics", b"glance", b"faults", b"weather")
]
PIECE = 8192


def words(kind: str) -> tuple[bytes, ...]:
    return {
        "line": LMS,
        "stream": (LD, LMS[0], b"\x02USP", b"\x02U"),
        "adapter": (b"t12380011223344556677\r", b"S6\rO\r", b"V\r", b"\r", b"T"),
        "bus": (SEND, b"< send 123 8 1 2 >", b"< x >", b"<"),
        "deaf": (SEND,),
        "datagrams": (LD, b"\x02USP"),
        "control": tuple(ASKED),
        "deaf-control": tuple(ASKED),
    }[kind]


def connect(kind: str, place: str) -> int:
    """A descriptor to write to."""
    if kind in ("line", "adapter"):
        return os.open(place, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
    if kind.endswith("control"):
        end = socket.socket(socket.AF_UNIX)
        end.connect(place)
    elif kind == "datagrams":
        end = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        end.connect(("127.0.0.1", int(place)))
    else:
        end = socket.create_connection(("127.0.0.1", int(place)))
    if kind in ("bus", "deaf"):
        end.sendall(b"< open can0 >< rawmode >")
    end.setblocking(False)
    return end.detach()


def attack(kind: str, seconds: float, place: str, ends: int) -> dict[str, object]:
    rng = random.Random(place)
    numbers = {}
    for _ in range(ends):
        with contextlib.suppress(OSError):  # one more than there is room for
            numbers[connect(kind, place)] = b""
    written = came = 0
    end = time.monotonic() + seconds
    began_s = time.process_time()
    reads = not kind.startswith("deaf")
    poller = select.epoll()
    for number in numbers:
        poller.register(number, select.EPOLLOUT | (select.EPOLLIN if reads else 0))
    while time.monotonic() < end:
        for number, mask in poller.poll(0.1):
            if mask & select.EPOLLIN and reads:
                with contextlib.suppress(OSError):
                    os.read(number, 1 << 16)
            if mask & (select.EPOLLERR | select.EPOLLHUP):
                poller.unregister(number)
                os.close(number)
                del numbers[number]
                with contextlib.suppress(OSError):
                    fresh = connect(kind, place)
                    numbers[fresh] = b""
                    came += 1
                    poller.register(fresh, select.EPOLLOUT | (select.EPOLLIN if reads else 0))
                continue
            if mask & select.EPOLLOUT:
                data = numbers[number]
                if not data:
                    word = rng.choice(words(kind))
                    data = rng.randbytes(PIECE) if rng.random() < 0.2 else word * (PIECE // len(word))
                    if kind == "datagrams":
                        data = data[:1000]
                with contextlib.suppress(OSError):
                    count = os.write(number, data)
                    written += count
                    data = b"" if kind == "datagrams" else data[count:]
                numbers[number] = data
        if not numbers:
            time.sleep(0.05)
            with contextlib.suppress(OSError):
                fresh = connect(kind, place)
                numbers[fresh] = b""
                poller.register(fresh, select.EPOLLOUT | (select.EPOLLIN if reads else 0))
        if kind == "datagrams":
            time.sleep(0.0005)  # nothing makes its sender wait
    cpu_s = round(time.process_time() - began_s, 2)
    return {"kind": kind, "place": place, "written": written, "came_again": came, "cpu_s": cpu_s}


if __name__ == "__main__":
    sys.stdout.write(json.dumps(attack(sys.argv[1], float(sys.argv[2]), sys.argv[3], int(sys.argv[4]))) + "\n")
