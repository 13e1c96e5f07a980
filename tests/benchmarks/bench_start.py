"""`python -m tests.benchmarks.bench_start [STARTS]`: how long `lidaremu run street` takes to `ready`; its cost.

Three machines: one that has compiled nothing yet, one that has compiled everything, one without loops. Each start
is ended at `ready`; the first kind has a cache of its own each time, the second the one of this machine.
"""

from __future__ import annotations

import json
import os
import resource
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
KINDS = ("nothing compiled yet", "everything compiled", "LIDAREMU_COMPILED=0")


def start(kind: str) -> tuple[float, float]:
    """Wall time to `ready`, and processor time of all processes until they have ended. [s]"""
    with tempfile.TemporaryDirectory() as folder:
        environment = dict(os.environ) | {"PYTHONPATH": str(ROOT), "LIDAREMU_COMPILED": "1"}
        if kind == KINDS[0]:
            environment |= {"NUMBA_CACHE_DIR": f"{folder}/numba", "XDG_CACHE_HOME": f"{folder}/cache"}
        elif kind == KINDS[2]:
            environment["LIDAREMU_COMPILED"] = "0"
        before, began_s = resource.getrusage(resource.RUSAGE_CHILDREN), time.monotonic()
        with subprocess.Popen(
            [sys.executable, "-m", "emulator", "run", "street", "--json", "--link", "front=pty:./front"],
            cwd=folder, env=environment, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True,
        ) as process:  # fmt: skip
            assert process.stdout is not None
            ready = json.loads(process.stdout.readline())
            took_s = time.monotonic() - began_s
            assert ready["event"] == "ready"
            process.terminate()
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return took_s, after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def main(starts: int) -> None:
    """The table."""
    start(KINDS[1])  # compiled from here on, or being compiled: see the second row
    sys.stdout.write(f"load {os.getloadavg()[0]:.1f}; to `ready`, least, median and most of {starts}\n")
    for kind in KINDS:
        found = [start(kind) for _ in range(starts)]
        rows = [f"{min(one):.1f} / {statistics.median(one):.1f} / {max(one):.1f} s" for one in zip(*found, strict=True)]
        sys.stdout.write(f"{kind:22} wall {rows[0]}, processors {rows[1]}\n")


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 3)
