"""Objects from echoes: time of segmentation and tracking for a scan of 2880 points.

Run it: `python -m tests.benchmarks.bench_objects`.
Aim: 10 ms. Times are of the processor, so that a busy machine does not count.
"""

from __future__ import annotations

import math
import time

import numpy as np

from emulator.objects.options import TrackerOptions
from emulator.objects.points import View
from emulator.objects.tracker import ObjectTracker
from tests.objects.flatland import Box, look

BEAMS = 2880
SCANS = 60


def street() -> list[Box]:
    """Forty vehicles between house fronts, so that every beam meets something."""
    cars = [
        Box(1 + k, 6.0 + (k * 7) % 60, -12.0 + (k * 11) % 25, yaw_rad=0.3 * k, vx_m_s=k % 5 - 2.0) for k in range(40)
    ]
    fronts = [(0.0, 18.0, 160.0, 0.5), (0.0, -18.0, 160.0, 0.5), (75.0, 0.0, 0.5, 40.0), (-75.0, 0.0, 0.5, 40.0)]
    return cars + [Box(0, *front) for front in fronts]


def scans(rng: np.random.Generator) -> list[View]:
    return [
        look(street(), 0.08 * k, beams=BEAMS, field_rad=2 * math.pi, reach_m=200.0, noise_m=0.02, rng=rng)
        for k in range(SCANS)
    ]


def main() -> None:
    """Print one line a way of segmentation."""
    views = scans(np.random.default_rng(1))
    points = int(np.isfinite(views[0].scan.range_m).sum())
    for segmentation in ("cluster", "actor"):
        tracker = ObjectTracker(TrackerOptions(segmentation=segmentation))  # type: ignore[arg-type]
        times, listed = [], 0
        for k, view in enumerate(views):
            begin_s = time.process_time()
            listed = len(tracker.update([view], 0.08 * k))
            times.append(time.process_time() - begin_s)
        middle, worst = 1e3 * float(np.median(times)), 1e3 * max(times)
        print(f"{segmentation:8s} {points} points, {listed} objects: {middle:.1f} ms, at worst {worst:.1f} ms")


if __name__ == "__main__":
    main()
