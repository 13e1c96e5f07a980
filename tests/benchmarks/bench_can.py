"""Object lists: time to pack a list of 100 objects and to queue its frames on a link.

Run it: `python -m tests.benchmarks.bench_can`.
Aim: 2 ms for a list of 100 objects encoded and queued (ARS408 with quality and extended frames, 301 frames). Times are
medians of processor time, so that a busy machine does not count.
"""

from __future__ import annotations

import time
from dataclasses import replace
from typing import Any

from emulator.transports.schemes import open_link
from protocols.can_objects import FORMATS
from protocols.scan import Scan
from tests.protocols.can_objects.rig import MS, crowd, start

ROUNDS = 200


def measure(name: str, device: dict[str, Any]) -> tuple[int, float, float]:
    """Frames of a list; median milliseconds to encode one, and to encode and queue one."""
    rig = start({"format": name, **device})
    rig.session.advance(rig.now_ns)
    link = open_link("can:virtual:bench")
    objects = crowd(100)
    encoded, queued, frames = [], [], 0
    now_ns = rig.now_ns
    for _ in range(ROUNDS):
        plan = rig.session.next_plan()
        assert plan is not None
        now_ns = max(now_ns, plan.start_ns)
        scan = replace(Scan.empty(plan), objects=objects)
        begin_s = time.process_time()
        rig.session.submit(scan)
        emissions = rig.session.take_emissions(now_ns + 110 * MS)
        middle_s = time.process_time()
        for emission in emissions:
            assert emission.address is not None
            link.send(emission.payload, emission.due_ns, emission.address.peer)
        encoded.append(middle_s - begin_s)
        queued.append(time.process_time() - begin_s)
        frames = len(emissions)
        now_ns += 110 * MS
        link.clear()
    link.close()
    middle = ROUNDS // 2
    return frames, 1e3 * sorted(encoded)[middle], 1e3 * sorted(queued)[middle]


def main() -> None:
    """Print one line a format."""
    options: dict[str, dict[str, Any]] = {
        "ars408": {"cycle_ms": 110},
        "ldmrs": {"scan_frequency_hz": 12.5},
        "esr": {"radiate": "always", "cycle_ms": 110},
        "leddar_vu8": {"streaming": "start", "cycle_ms": 110},
        "leddar_m16": {"streaming": "start"},
    }
    for name in FORMATS:
        frames, encoded_ms, queued_ms = measure(name, options[name])
        times = f"encoded {encoded_ms:.2f} ms, encoded and queued {queued_ms:.2f} ms"
        print(f"{name:11s} 100 objects, {frames:3d} frames: {times}")


if __name__ == "__main__":
    main()
