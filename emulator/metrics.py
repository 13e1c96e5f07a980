"""Lateness as a histogram, and a run's counters as Prometheus text (exposition format 0.0.4)."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from emulator.instrument import Instrument

EDGES_US = (10, 20, 50, 100, 200, 500, 1_000, 1_500, 2_000, 5_000, 10_000, 20_000, 50_000, 100_000, 1_000_000)
"Upper edges. 50 us and 1.5 ms are what an idle machine is asked to hold: median and 99 of 100."


def histogram(lateness_ns: Sequence[int]) -> list[tuple[int, int]]:
    """(upper edge in us, sends up to it and beyond the edge before); what is later than the last edge has edge 0."""
    late_us = np.asarray(lateness_ns, dtype=np.float64) * 1e-3
    places = np.searchsorted(EDGES_US, late_us, side="left")
    counts = np.bincount(places, minlength=len(EDGES_US) + 1)
    return [*zip(EDGES_US, map(int, counts[:-1]), strict=True), (0, int(counts[-1]))]


def prometheus(instruments: Sequence[Instrument]) -> str:
    """Counters and the histogram of every sensor."""
    return "\n".join(_lines(instruments)) + "\n"


def _label(text: str) -> str:
    return text.replace("\\", r"\\").replace('"', r"\"").replace("\n", r"\n")


def _lines(instruments: Sequence[Instrument]) -> Iterator[str]:
    yield "# HELP lidaremu_scans_sent_total Scans handed to the links."
    yield "# TYPE lidaremu_scans_sent_total counter"
    for one in instruments:
        yield f'lidaremu_scans_sent_total{{sensor="{_label(one.sensor)}"}} {one.stats.scans_sent}'
    yield "# HELP lidaremu_scans_dropped_total Scans given up, by reason."
    yield "# TYPE lidaremu_scans_dropped_total counter"
    for one in instruments:
        for reason, count in sorted(one.stats.scans_dropped.items()):
            labels = f'sensor="{_label(one.sensor)}",reason="{_label(reason)}"'
            yield f"lidaremu_scans_dropped_total{{{labels}}} {count}"
    yield "# HELP lidaremu_input_dropped_total Input not taken, by reason."
    yield "# TYPE lidaremu_input_dropped_total counter"
    for one in instruments:
        for reason, count in sorted(one.stats.input_dropped.items()):
            labels = f'sensor="{_label(one.sensor)}",reason="{_label(reason)}"'
            yield f"lidaremu_input_dropped_total{{{labels}}} {count}"
    yield "# HELP lidaremu_link_bytes_total Bytes by direction; lost: nobody read them."
    yield "# TYPE lidaremu_link_bytes_total counter"
    for one in instruments:
        for index, link in enumerate(one.links):
            counts = {"in": link.stats.bytes_in, "out": link.stats.bytes_out, "lost": link.stats.bytes_lost}
            for direction, count in counts.items():
                labels = f'sensor="{_label(one.sensor)}",link="{index}",direction="{direction}"'
                yield f"lidaremu_link_bytes_total{{{labels}}} {count}"
    yield "# HELP lidaremu_lateness_seconds Actual minus scheduled instant of each send."
    yield "# TYPE lidaremu_lateness_seconds histogram"
    for one in instruments:
        label, total = _label(one.sensor), 0
        for edge_us, count in histogram(one.stats.lateness_ns):
            total += count
            edge = f"{edge_us * 1e-6:g}" if edge_us else "+Inf"
            yield f'lidaremu_lateness_seconds_bucket{{sensor="{label}",le="{edge}"}} {total}'
        yield f'lidaremu_lateness_seconds_sum{{sensor="{label}"}} {sum(one.stats.lateness_ns) * 1e-9:.9f}'
        yield f'lidaremu_lateness_seconds_count{{sensor="{label}"}} {total}'
