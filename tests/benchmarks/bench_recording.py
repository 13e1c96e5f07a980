"""What recording costs: processor time, in two ways that bear a machine with other work on it.

    python tests/benchmarks/bench_recording.py [TURNS]

Within: the time that the recorder's own methods take in a run, summed. In turns: whole runs plain, recorded, recorded,
plain, so that a drift of the machine falls on both; the median of the turns' differences with its quartiles. Both for
the process that sends alone, its scans measured elsewhere, as `run --record` has it (told as a share of one core), and
for a whole run in virtual time, measuring included, as `test --record` has it.
"""

from __future__ import annotations

import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from emulator.judging.trial import Trial
from emulator.recording.writer import Recorder
from emulator.scenario import scenario

SECONDS = 6.0
METHODS = ("scan", "payload", "event", "reported", "close")


def timed(method: Callable[..., Any], spent_ns: list[int]) -> Callable[..., Any]:
    def run(self: Recorder, *arguments: Any) -> Any:
        start = time.process_time_ns()
        found = method(self, *arguments)
        spent_ns.append(time.process_time_ns() - start)
        return found

    return run


def spent_s(record: bool, workers: int) -> float:
    """Processor time of this process, user and kernel, without that of workers."""
    with tempfile.TemporaryDirectory() as folder:
        loaded = scenario.load("crossing_car", [f"duration_s={SECONDS}"])
        trial = Trial(loaded, workers, record=Path(folder) / "run" if record else None)
        start = time.process_time()
        trial.finish()
        trial.close()
        return time.process_time() - start


def within_s(workers: int) -> tuple[float, float]:
    """Processor time of the recorder's methods, and of all else."""
    spent_ns: list[int] = []
    before = {name: getattr(Recorder, name) for name in METHODS}
    for name, method in before.items():
        setattr(Recorder, name, timed(method, spent_ns))
    whole = spent_s(True, workers)
    for name, method in before.items():
        setattr(Recorder, name, method)
    return sum(spent_ns) * 1e-9, whole - sum(spent_ns) * 1e-9


def main() -> None:
    turns = int(sys.argv[1]) if len(sys.argv) > 1 else 5
    for workers, what in ((1, "the sender alone"), (0, "the whole run, measuring included")):
        within_s(workers)
        own, rest = np.median([within_s(workers) for _ in range(turns)], axis=0)
        more = []
        for _ in range(turns):
            found = [spent_s(record, workers) for record in (False, True, True, False)]
            more.append((found[1] + found[2] - found[0] - found[3]) / 2)
        low, middle, high = np.percentile(more, [25, 50, 75])
        print(
            f"{what}: {rest:.3f} s of processor time for {SECONDS:g} s; recording within {1e3 * own:.0f} ms, in turns"
            f" {1e3 * middle:.0f} ({1e3 * low:.0f} to {1e3 * high:.0f}) ms: {100 * own / rest:.1f} % of it,"
            f" {100 * own / SECONDS:.2f} % of a core in real time"
        )


if __name__ == "__main__":
    main()
