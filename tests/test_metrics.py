"""Lateness histogram and Prometheus text; the text is read back by a reader written from the format's description."""

from __future__ import annotations

import re
from pathlib import Path

from emulator import scenario
from emulator.metrics import EDGES_US, histogram, prometheus
from emulator.trial import Trial

CASE = """\
schema: 1
duration_s: 0.5
world:
  - {plane: {size_m: [6, 60]}, at_m: [8, 0, 1], pitch_deg: -90, material: white_plaster}
sensors:
  - {id: front, model: sick-lms291-s05, mount: {at_m: [0, 0, 1]}, device: {resolution_deg: 1, field_deg: 100}}
"""
SAMPLE = re.compile(r'([a-z_]+)(?:\{((?:[a-z]+="(?:[^"\\]|\\.)*",?)*)\})? (\S+)\Z')


def test_every_send_is_in_exactly_one_bin() -> None:
    late_ns = [0, 10_000, 10_001, 49_000, 1_500_000, 1_500_001, 2_000_000_000]
    rows = histogram(late_ns)
    assert [edge for edge, _ in rows] == [*EDGES_US, 0]
    counts = dict(rows)
    assert sum(counts.values()) == len(late_ns)
    assert (counts[10], counts[20], counts[50], counts[1_500], counts[2_000], counts[0]) == (2, 1, 1, 1, 1, 1)
    assert sum(count for _, count in histogram([])) == 0


def test_prometheus_text_follows_the_format_and_its_buckets_add_up() -> None:
    trial = Trial(scenario.loads(CASE, Path("case.yaml")))
    trial.finish()
    text = prometheus(trial.instruments)
    assert text.endswith("\n")
    samples: dict[str, list[tuple[str, float]]] = {}
    for line in text.splitlines():
        if not line.startswith("#"):
            match = SAMPLE.match(line)
            assert match is not None, line
            samples.setdefault(match[1], []).append((match[2] or "", float(match[3])))
    buckets = [value for _, value in samples["lidaremu_lateness_seconds_bucket"]]
    assert buckets == sorted(buckets)
    assert samples["lidaremu_lateness_seconds_count"][0][1] == buckets[-1]
    assert 'le="+Inf"' in samples["lidaremu_lateness_seconds_bucket"][-1][0]
    assert samples["lidaremu_scans_sent_total"] == [('sensor="front"', float(trial.instruments[0].stats.scans_sent))]
