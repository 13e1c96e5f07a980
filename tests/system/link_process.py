"""A process that serves one link as the daemon does: `link_process.py URL BAUD echo|stream`.

Says the link's URL on standard output when a host can connect. `echo` gives back what it hears; `stream` sends a telegram
of 732 bytes every 26.67 ms, its number in the first two bytes, and counts.
"""

from __future__ import annotations

import json
import select
import signal
import sys

from emulator.clock import SystemClock
from emulator.transports import open_link

SCAN_NS = 80_000_000 // 3


def main() -> None:
    url, baud, what = sys.argv[1:4]
    link = open_link(url)
    link.set_speed(int(baud))
    clock = SystemClock()
    running = [True]
    signal.signal(signal.SIGTERM, lambda *_: running.clear())
    sys.stdout.write(link.url + "\n")
    sys.stdout.flush()
    number = 0
    while running:
        now_ns = clock.now_ns()
        for event in link.receive(now_ns):
            if what == "echo" and event.data:
                link.send(event.data, now_ns)
        while what == "stream" and number * SCAN_NS <= now_ns:
            link.send(number.to_bytes(2, "big") + bytes(730), number * SCAN_NS)
            number += 1
        wake = link.flush(now_ns)
        if what == "stream":
            wake = min(number * SCAN_NS, wake or number * SCAN_NS)
        timeout_s = None if wake is None else max(0.0, (wake - clock.now_ns()) * 1e-9)
        select.select(link.filenos(), [], [], timeout_s)
    late = sorted(link.stats.lateness_ns)
    link.close()
    sys.stdout.write(json.dumps({"sent": number, "late_us": [late[len(late) // 2] / 1e3, late[-1] / 1e3] if late else []}))


if __name__ == "__main__":
    main()
