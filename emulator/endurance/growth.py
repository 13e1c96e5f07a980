"""Whether a process grows: resident memory, live blocks of the allocator, descriptors, and their slopes over a run."""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

PAGE = os.sysconf("SC_PAGESIZE")
DAY_S = 86_400.0


@dataclass(frozen=True)
class Sample:
    """One look at a process."""

    at_s: float
    "Of the run: virtual or real seconds."
    rss_bytes: int
    descriptors: int
    blocks: int = 0
    "Live blocks of Python's allocator; 0: another process, not known."


def look(at_s: float, pid: int | None = None) -> Sample:
    """This process, or another one of this user."""
    folder = f"/proc/{'self' if pid is None else pid}"
    with open(f"{folder}/statm", encoding="ascii") as statm:
        rss = int(statm.read().split()[1]) * PAGE
    blocks = sys.getallocatedblocks() if pid is None else 0
    return Sample(at_s, rss, len(os.listdir(f"{folder}/fd")), blocks)


def cpu_s(pid: int) -> float:
    """Seconds of CPU that a process has taken so far."""
    with open(f"/proc/{pid}/stat", encoding="ascii") as stat:
        fields = stat.read().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def slope_per_day(samples: Sequence[Sample], values: Sequence[float]) -> float:
    """Slope of a least-squares line over the second half, a day; caches have filled by then."""
    half = len(samples) // 2
    if len(samples) - half < 3:
        return 0.0
    times = np.array([sample.at_s for sample in samples[half:]])
    return float(np.polyfit(times - times[0], np.asarray(values[half:], dtype=np.float64), 1)[0] * DAY_S)


@dataclass
class Growth:
    """Samples of one run, and the verdict."""

    samples: list[Sample] = field(default_factory=list)
    descriptors_left: int | None = None
    "How many more are open after the last host has gone than before the first came; None: hosts never all go."

    def rise(self, values: Sequence[float]) -> float:
        """From the middle of the run to its end, medians of an eighth of the samples each."""
        width = max(1, len(values) // 8)
        middle = len(values) // 2
        return float(np.median(values[-width:]) - np.median(values[middle : middle + width]))

    def reported(self) -> dict[str, Any]:
        """Figures for the report."""
        rss = [sample.rss_bytes / 1e6 for sample in self.samples]
        blocks = [float(sample.blocks) for sample in self.samples]
        files = [sample.descriptors for sample in self.samples]
        found: dict[str, Any] = {
            "samples": len(self.samples),
            "rss_mb_start": round(rss[0], 2),
            "rss_mb_middle": round(rss[len(rss) // 2], 2),
            "rss_mb_end": round(rss[-1], 2),
            "rss_mb_peak": round(max(rss), 2),
            "rss_mb_rise_second_half": round(self.rise(rss), 3),
            "rss_mb_per_day": round(slope_per_day(self.samples, rss), 2),
            "descriptors_start": files[0],
            "descriptors_most_first_quarter": max(files[: len(files) // 4 + 1]),
            "descriptors_least_last_quarter": min(files[-(len(files) // 4 + 1) :]),
            "descriptors_peak": max(files),
        }
        if self.descriptors_left is not None:
            found["descriptors_left"] = self.descriptors_left
        if any(blocks):
            found["blocks_end"] = int(blocks[-1])
            found["blocks_rise_second_half"] = round(self.rise(blocks))
            found["blocks_per_day"] = round(slope_per_day(self.samples, blocks))
        return found
