"""Lock-step in a street: processor time of a sweep and of a second, with nobody, some and all of its actors fed.

Run it: `python -m tests.benchmarks.bench_live [SECONDS]`.
Aim: a virtual LMS291 and a street with 20 fed actors, steps of 10 ms, five times faster than real time with the extra
`fast`. Times are of the processor, so that a busy machine does not count; those of several processes are of the wall
clock, in turns with one process, and want as many idle cores.
"""

# ruff: noqa: E402
from __future__ import annotations

import os
import re

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

import sys
import time
from pathlib import Path

import numpy as np

from emulator.judging.trial import Trial
from emulator.live.json_lines import update_of
from emulator.scenario.scenario import Scenario, load, loads
from emulator.world.scene import motion_of

STREET = Path(__file__).parents[2] / "scenarios" / "street.yaml"
STEP_S = 0.01
TURN = 20
"Steps."
SPAWNED = "{pool: 8, classes: {car: {mesh: 'builtin:car.glb', material: car_paint_grey}}, fed: [%s]}"


def street(fed: int, spawned: int = 0, alone: bool = False) -> Scenario:
    """The street, of whose actors so many are fed and beside which so many cars come; `alone`: it has no others."""
    names = [actor.id for actor in load(str(STREET)).actors][:fed]
    if not names:
        return load(str(STREET))
    text = STREET.read_text().replace("loop: true", "loop: false")
    actors = SPAWNED % ", ".join(names) + "\n"
    if spawned:
        actors = actors.replace("{pool", "{spawn: true, pool")
    if alone:
        first, others = (
            text.index("actors:\n"),
            [part.start() for part in re.finditer(r"^  - id: ", text, re.MULTILINE)],
        )
        of_actors = [place for place in others if first < place < text.index("sensors:")]
        if len(of_actors) > fed:
            text = text[: of_actors[fed]] + text[text.index("sensors:") :]
    live = f"\nlive: {{feed: control, ego: ego, actors: {actors.strip()}}}\n"
    return loads(text + live, STREET.with_name("fed.yaml"))


def lines(scenario: Scenario, fed: int, spawned: int, t_s: float) -> list[dict[str, object]]:
    """What a feeder tells: the file's own motions, and cars that come towards the ego."""
    found: list[dict[str, object]] = []
    for actor in scenario.actors[:fed]:
        motion, when = motion_of(actor.motion), np.array([t_s])
        yaw = actor.motion.yaw_deg
        found.append(
            {
                "id": actor.id,
                "at_m": motion.position(when)[0].tolist(),
                "yaw_deg": yaw,
                "velocity_m_s": motion.velocity(when)[0].tolist(),
                "reference": "origin",
            }
        )
    for number in range(spawned):
        at = [40.0 + 15.0 * number - 9.0 * t_s, 1.75, 0.75]
        found.append(
            {
                "id": f"car {number}",
                "class": "car",
                "size_m": [4.4, 1.8, 1.5],
                "at_m": at,
                "yaw_deg": 180.0,
                "velocity_m_s": [-9.0, 0, 0],
            }
        )
    return found


def stepped(fed: int, spawned: int, seconds: float, alone: bool = False) -> tuple[float, int]:
    """Processor time and sweeps of so many seconds."""
    trial = Trial(street(fed, spawned, alone))
    try:
        steps = round(seconds / STEP_S)
        reported = [lines(trial.scenario, fed, spawned, STEP_S * k) for k in range(steps + 1)]
        for k in range(20):  # everything has been met once
            _step(trial, k, reported[k])
        before, begin_s = trial.instruments[0].stats.scans_measured, time.process_time()
        for k in range(20, steps + 1):
            _step(trial, k, reported[k])
        took_s = time.process_time() - begin_s
        return took_s / (seconds - 0.2), trial.instruments[0].stats.scans_measured - before
    finally:
        trial.close()


def _step(trial: Trial, k: int, actors: list[dict[str, object]]) -> None:
    if trial.feeding is not None:
        trial.feeding.take(update_of({"t_s": STEP_S * k, "actors": actors}), trial.run.clock.now_ns(), again=True)
    trial.run.advance(round(STEP_S * k * 1e9))


def in_parts(fed: int, seconds: float, processes: int) -> str:
    """The same sweeps in place and by so many processes, in turns of some steps, so that both have the same machine.

    Processor time of the sender and of the busiest process come one after the other: what a step takes on idle cores.
    """
    trials = [Trial(street(fed)), Trial(street(fed), processes)]
    wall, own, busiest = [0.0, 0.0], [0.0, 0.0], 0.0
    try:
        assert trials[1]._workers is not None
        pids = [int(str(row["pid"])) for row in trials[1]._workers.rows()]
        steps = round(seconds / STEP_S)
        reported = [lines(trials[0].scenario, fed, 0, STEP_S * k) for k in range(steps + 1)]
        for begin in range(0, steps + 1, TURN):
            for number, trial in enumerate(trials):
                began, used, before = time.monotonic(), time.process_time(), [_on_cpu_s(pid) for pid in pids]
                for k in range(begin, min(begin + TURN, steps + 1)):
                    _step(trial, k, reported[k])
                if begin:  # everything has been met once
                    wall[number] += time.monotonic() - began
                    own[number] += time.process_time() - used
                    busiest += max(_on_cpu_s(pid) - then for pid, then in zip(pids, before, strict=True))
        same = trials[0].transcript.sha256() == trials[1].transcript.sha256()
        return (
            f"sender {own[1] / own[0]:.2f} and busiest process {busiest / own[0]:.2f} of the processor time in place,"
            f" wall {wall[1] / wall[0]:.2f}; {'the same bytes' if same else 'OTHER BYTES'}"
        )
    finally:
        for trial in trials:
            trial.close()


def _on_cpu_s(pid: int) -> float:
    """proc(5): `schedstat`."""
    return int(Path(f"/proc/{pid}/schedstat").read_text().split()[0]) * 1e-9


def main() -> None:
    """Print one line a scene, then what several processes make of it."""
    seconds = float(sys.argv[1]) if len(sys.argv) > 1 else 2.0
    for name, fed, spawned, alone in (
        ("nobody fed", 0, 0, False),
        ("20 fed", 20, 0, False),
        ("20 fed, no others", 20, 0, True),
        ("16 fed, 4 spawned", 16, 4, False),
        ("all 36 fed", 36, 0, False),
    ):
        share, sweeps = stepped(fed, spawned, seconds, alone)
        each_ms = 1e3 * share * (seconds - 0.2) / max(1, sweeps)
        print(f"{name:18s} {each_ms:6.1f} ms a sweep, {1.0 / share:5.1f} times faster than real time")
    for processes in (1, 2, 3):
        print(f"20 fed, {processes} measuring processes: {in_parts(20, seconds, processes)}")


if __name__ == "__main__":
    main()
