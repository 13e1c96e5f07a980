"""Datagrams of a fast lidar on their way out: how late they leave, what is lost, what sendmmsg would gain.

    python -m tests.benchmarks.bench_sending [SECONDS]

`Daemon` with a sensor that sends 6254 packets of 1248 bytes a second (a VLS-128) to a socket of this machine, each due
at its own instant, alone and beside a second sensor that sends 75 telegrams a second; nothing is measured. Lateness is
what the links report. `drops`: payloads that the socket had no room for. Then a datagram by `send` for each, and by
`sendmmsg` (through ctypes) for 2, 4 and 8 that are due together: processor time of each.
"""

from __future__ import annotations

import ctypes
import socket
import sys
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT))

from emulator.instrument.instrument import Instrument  # noqa: E402
from emulator.measuring.measuring import InPlace  # noqa: E402
from emulator.process.clock import SystemClock  # noqa: E402
from emulator.runtime.daemon import Daemon  # noqa: E402
from emulator.transports.udp_sender import open_link_udp  # noqa: E402
from protocols.scan import Scan, ScanPlan  # noqa: E402
from protocols.session import Address, Emission, Event, Session  # noqa: E402

FAST_HZ, FAST_BYTES = 6254, 1248
OTHER_HZ, OTHER_BYTES = 75, 732


class Steady(Session):
    """Emits packets of a slice at a time, each due at its own instant; measures nothing."""

    def __init__(self, rate_hz: float, size: int, slice_ns: int = 5_000_000) -> None:
        self._period_ns, self._payload, self._slice_ns = 1e9 / rate_hz, bytes(size), slice_ns
        self._number, self._start_ns = 0, 0

    def power_on(self, now_ns: int) -> None:
        self._start_ns = now_ns

    def receive(self, data: bytes, now_ns: int, address: Address | None = None) -> None: ...

    def advance(self, now_ns: int) -> None: ...

    def _due_ns(self, number: int) -> int:
        return self._start_ns + round(number * self._period_ns)

    def next_deadline(self) -> int | None:
        return self._due_ns(self._number)

    def next_plan(self) -> ScanPlan | None:
        return None

    def submit(self, scan: Scan) -> None: ...

    def take_emissions(self, now_ns: int) -> list[Emission]:
        made = []
        while (due_ns := self._due_ns(self._number)) <= now_ns:
            made.append(Emission(due_ns, self._payload))
            self._number += 1
        return made

    def take_events(self) -> list[Event]:
        return []


def lateness(seconds: float, *rates: tuple[int, int]) -> None:
    """Print how late each sensor's datagrams leave."""
    hosts = [socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in rates]
    instruments = []
    for number, (host, (rate_hz, size)) in enumerate(zip(hosts, rates, strict=True)):
        host.bind(("127.0.0.1", 0))
        link = open_link_udp(f"udp:127.0.0.1:{host.getsockname()[1]}", serial_line=False)
        instruments.append(Instrument(f"{number}", Steady(rate_hz, size), [link], InPlace({})))
    clock = SystemClock()
    daemon = Daemon(instruments, clock)
    begin = time.process_time()
    daemon.power_on()
    daemon.run(clock.now_ns() + round(seconds * 1e9))
    share = (time.process_time() - begin) / seconds
    for one, (rate_hz, size) in zip(instruments, rates, strict=True):
        late = one.stats.lateness
        median, p99, worst = (1e-3 * late.percentile_ns(percent) for percent in (50.0, 99.0, 100.0))
        print(
            f"{rate_hz}/s of {size} bytes{' beside others' if len(rates) > 1 else ''}; late by: median"
            f" {median:.0f} us, p99 {p99:.0f} us, worst {worst:.0f} us;"
            f" drops {one.links[0].stats.payloads_dropped}; share of a core {share:.2f}",
            flush=True,
        )
    daemon.close()
    for host in hosts:
        host.close()


class _Iovec(ctypes.Structure):
    _fields_ = (("base", ctypes.c_char_p), ("size", ctypes.c_size_t))


class _Msghdr(ctypes.Structure):
    _fields_ = (
        ("name", ctypes.c_void_p), ("namelen", ctypes.c_uint), ("iov", ctypes.POINTER(_Iovec)),
        ("iovlen", ctypes.c_size_t), ("control", ctypes.c_void_p), ("controllen", ctypes.c_size_t),
        ("flags", ctypes.c_int),
    )  # fmt: skip


class _Mmsghdr(ctypes.Structure):
    _fields_ = (("hdr", _Msghdr), ("len", ctypes.c_uint))


def per_datagram_us(together: int, many: bool, rounds: int = 2000) -> float:
    """Processor time of a datagram to a connected socket, the best of five."""
    libc = ctypes.CDLL(None, use_errno=True)
    with (
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as host,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as out,
    ):
        host.bind(("127.0.0.1", 0))
        out.connect(host.getsockname())
        payloads = [bytes(FAST_BYTES) for _ in range(together)]
        best = float("inf")
        for _ in range(5):
            begin = time.process_time()
            for _ in range(rounds):
                if many:
                    iov = (_Iovec * together)(*[_Iovec(one, len(one)) for one in payloads])
                    table = (_Mmsghdr * together)()
                    for at in range(together):
                        table[at].hdr.iov = ctypes.pointer(iov[at])
                        table[at].hdr.iovlen = 1
                    libc.sendmmsg(out.fileno(), table, together, 0)
                else:
                    for one in payloads:
                        out.send(one)
            best = min(best, (time.process_time() - begin) / (rounds * together))
    return 1e6 * best


def main() -> None:
    seconds = float(sys.argv[1]) if len(sys.argv) > 1 else 5.0
    lateness(seconds, (FAST_HZ, FAST_BYTES))
    lateness(seconds, (OTHER_HZ, OTHER_BYTES))
    lateness(seconds, (FAST_HZ, FAST_BYTES), (OTHER_HZ, OTHER_BYTES))
    for together in (1, 2, 4, 8):
        print(
            f"{together} together: send {per_datagram_us(together, False):.1f} us a datagram, sendmmsg through ctypes"
            f" {per_datagram_us(together, True):.1f} us",
            flush=True,
        )


if __name__ == "__main__":
    main()
