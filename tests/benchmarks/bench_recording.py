"""What recording costs: a run in virtual time with and without it, best of five each.

    python tests/benchmarks/bench_recording.py
"""

from __future__ import annotations

import tempfile
import time
from pathlib import Path

from emulator import scenario
from emulator.trial import Trial


def seconds(record: bool) -> float:
    with tempfile.TemporaryDirectory() as folder:
        trial = Trial(
            scenario.load("crossing_car", ["duration_s=6"]), record=Path(folder) / "run" if record else None
        )
        start = time.process_time()
        trial.finish()
        trial.close()
        return time.process_time() - start


def main() -> None:
    seconds(False)
    plain = min(seconds(False) for _ in range(5))
    recorded = min(seconds(True) for _ in range(5))
    print(f"plain {plain:.3f} s, recorded {recorded:.3f} s of processor time: {100 * (recorded / plain - 1):+.1f} %")


if __name__ == "__main__":
    main()
