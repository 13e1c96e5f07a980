"""`python -m tests.benchmarks.bench_virtual [SCENARIO] [RUNS] [SECONDS]`: what a short run in virtual time costs.

Processor time in milliseconds of loading, set-up and run, the least of `RUNS` in this process, what is compiled or read
once left out; and steps per second of virtual time. `stepping` is the run with the scans of the run before it in place
of computed ones. Two states of the code are compared in turns, on a machine that does nothing else.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Mapping
from dataclasses import replace
from itertools import pairwise

from emulator.judging.trial import Trial
from emulator.measuring.conditions import NORMAL, Conditions
from emulator.measuring.measuring import InPlace, Measure
from emulator.runtime import assembly
from emulator.scenario import scenario
from protocols.scan import Scan, ScanPlan


class Kept:
    """Measures what it has not measured before."""

    def __init__(self, measures: Mapping[str, Measure]) -> None:
        self._inner = InPlace(measures)
        self._known: dict[tuple[str, int, int, int], list[Scan]] = {}
        self._done: dict[str, list[Scan]] = {}

    def request(self, sensor: str, plan: ScanPlan, conditions: Conditions = NORMAL) -> None:
        """The scan of a plan, from the first run that wanted it."""
        key = (sensor, plan.epoch, plan.sweep, plan.start_ns)
        if key not in self._known:
            self._inner.request(sensor, plan, conditions)
            self._known[key] = self._inner.collect(sensor)
        self._done.setdefault(sensor, []).extend(replace(scan, plan=plan) for scan in self._known[key])

    def collect(self, sensor: str) -> list[Scan]:
        """As of `Measuring`."""
        return self._done.pop(sensor, [])


def once(name: str, seconds: float, kept: Kept | None = None) -> tuple[tuple[float, ...], int, str]:
    """Milliseconds of loading, set-up and run; steps; digest."""
    steps = 0
    instants = [time.process_time()]
    loaded = scenario.load(name, [f"duration_s={seconds}"])
    instants.append(time.process_time())
    trial = Trial(loaded, measuring=kept)
    own_step = trial.run.step

    def step(until_ns: int) -> bool:
        nonlocal steps
        steps += 1
        return own_step(until_ns)

    trial.run.step = step  # type: ignore[method-assign]
    try:
        instants.append(time.process_time())
        verdict = trial.finish()
    finally:
        trial.close()
    instants.append(time.process_time())
    found = tuple(1e3 * (end - begin) for begin, end in pairwise(instants))
    return found, steps, verdict.sha256


def main(name: str, runs: int, seconds: float) -> None:
    """The table."""
    kept = Kept(assembly.build_measures(scenario.load(name)))
    once(name, seconds)
    once(name, seconds, kept)
    rows = [once(name, seconds) for _ in range(runs)]
    load_ms, trial_ms, run_ms = (min(times) for times in zip(*(row[0] for row in rows), strict=True))
    stepping_ms = min(once(name, seconds, kept)[0][2] for _ in range(runs))
    total_ms = min(sum(row[0]) for row in rows)
    sys.stdout.write(f"{name}, {seconds:g} s of virtual time, least of {runs}: {total_ms:.1f} ms\n")
    sys.stdout.write(f"load {load_ms:.1f}, set-up {trial_ms:.1f}, run {run_ms:.1f}, stepping alone {stepping_ms:.1f}\n")
    sys.stdout.write(f"{rows[0][1] / seconds:.0f} steps per virtual second, sha256 {rows[0][2][:12]}\n")


if __name__ == "__main__":
    given = sys.argv[1:] + ["flat_wall", "30", "1"][len(sys.argv) - 1 :]
    main(given[0], int(given[1]), float(given[2]))
