"""A process that serves one link as the daemon does: `link_process.py URL BAUD echo|stream`, until SIGTERM.

Says the link's URL on standard output when a host can connect. `echo` gives back what it hears; `stream` sends a
telegram of 732 bytes every 26.67 ms, its number in the first two bytes.
"""

from __future__ import annotations

import select
import signal
import sys

from emulator.process.clock import SystemClock
from emulator.transports.link import Link
from emulator.transports.schemes import open_link

SCAN_NS = 80_000_000 // 3


def serve(link: Link, what: str) -> None:
    clock = SystemClock()
    number = 0
    while True:
        now_ns = clock.now_ns()
        for event in link.receive(now_ns):
            if what == "echo" and event.data:
                link.send(event.data, now_ns)
        while what == "stream" and number * SCAN_NS <= now_ns:
            link.send(number.to_bytes(2, "big") + bytes(730), number * SCAN_NS)
            number += 1
        wakes = [link.flush(now_ns), number * SCAN_NS if what == "stream" else None]
        due = [wake for wake in wakes if wake is not None]
        select.select(link.filenos(), [], [], max(0.0, (min(due) - clock.now_ns()) * 1e-9) if due else None)


def main() -> None:
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(0))
    url, baud, what = sys.argv[1:4]
    link = open_link(url)
    link.set_speed(int(baud))
    sys.stdout.write(link.url + "\n")
    sys.stdout.flush()
    serve(link, what)  # the path goes by itself at exit


if __name__ == "__main__":
    main()
