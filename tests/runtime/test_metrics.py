"""Lateness histogram and Prometheus text; Prometheus' own client library reads the text back."""

from __future__ import annotations

import math
import tracemalloc
from pathlib import Path

import numpy as np
import pytest
from prometheus_client import Metric
from prometheus_client.parser import text_string_to_metric_families

from emulator.judging.trial import Trial
from emulator.process.incidents import Incidents
from emulator.process.lateness import EDGES_US, RECENT, LatenessLog
from emulator.runtime.metrics import prometheus
from emulator.scenario import scenario

CASE = """\
schema: 1
duration_s: 0.5
world:
  - {plane: {size_m: [6, 60]}, at_m: [8, 0, 1], pitch_deg: -90, material: white_plaster}
sensors:
  - {id: front, model: sick-lms291-s05, mount: {at_m: [0, 0, 1]}, device: {resolution_deg: 1, field_deg: 100}}
"""


def test_every_send_is_in_exactly_one_bin() -> None:
    late_ns = [0, 10_000, 10_001, 49_000, 1_500_000, 1_500_001, 2_000_000_000]
    log = LatenessLog()
    log.extend(late_ns)
    rows = log.histogram()
    assert [edge for edge, _ in rows] == [*EDGES_US, 0]
    counts = dict(rows)
    assert sum(counts.values()) == len(late_ns)
    assert (counts[10], counts[20], counts[50], counts[1_500], counts[2_000], counts[0]) == (2, 1, 1, 1, 1, 1)
    assert sum(count for _, count in LatenessLog().histogram()) == 0


def test_percentiles_of_a_long_run_need_no_list_of_it() -> None:
    random = np.random.default_rng(3)
    late_ns = np.rint(np.exp(random.normal(11.0, 2.0, 100_000))).astype(np.int64)
    log = LatenessLog()
    log.extend(late_ns.tolist())
    for percent in (0.5, 50.0, 99.0, 99.99):
        assert log.percentile_ns(percent) == pytest.approx(
            np.percentile(late_ns, percent, method="inverted_cdf"), 0.005
        )
    assert (log.count, log.sum_ns, log.worst_ns) == (100_000, late_ns.sum(), late_ns.max())
    assert log.percentile_ns(100.0) == pytest.approx(log.worst_ns, 0.005)
    assert np.array_equal(log.latest_ns(), late_ns[-RECENT:])
    assert np.array_equal(log.latest_ns(300), late_ns[-300:])
    assert sum(count for _, count in log.histogram()) == log.count  # counters of a run never go back
    assert len(log._classes) < 4000
    small = LatenessLog()
    small.extend([-5, 0, 1, 200, 255])
    assert small.latest_ns().tolist() == [0, 0, 1, 200, 255]
    assert small.latest_ns(2).tolist() == [200, 255]
    assert [small.percentile_ns(percent) for percent in (20, 60, 80, 100)] == [0.0, 1.0, 200.0, 255.0]
    assert np.isnan(LatenessLog().percentile_ns(50.0))


def test_a_log_takes_no_more_memory_in_its_last_hour_than_in_its_first() -> None:
    log = LatenessLog()
    log.extend([10_000_000])
    tracemalloc.start()
    log.extend(range(10_000_000, 10_000_000 + RECENT))
    grown = tracemalloc.get_traced_memory()[0]
    tracemalloc.stop()
    assert grown < 10_000  # a list of them takes 2.4 MB


def families(text: str) -> dict[str, Metric]:
    """By name; each comes once, with what it is and a help."""
    found = list(text_string_to_metric_families(text))
    assert len({one.name for one in found}) == len(found)
    assert all(one.type != "unknown" and one.documentation for one in found)
    return {one.name: one for one in found}


def test_prometheus_text_follows_the_format_and_its_buckets_add_up() -> None:
    trial = Trial(scenario.loads(CASE, Path("case.yaml")))
    trial.finish()
    text = prometheus(trial.instruments)
    assert text.endswith("\n")
    found = families(text)
    late = found["lidaremu_lateness_seconds"]
    assert late.type == "histogram"
    buckets = [sample for sample in late.samples if sample.name.endswith("_bucket")]
    counts = [sample.value for sample in buckets]
    assert counts == sorted(counts)
    edges = [float(sample.labels["le"]) for sample in buckets]
    assert edges == pytest.approx([*(edge * 1e-6 for edge in EDGES_US), math.inf])
    (count,) = [sample.value for sample in late.samples if sample.name.endswith("_count")]
    assert count == counts[-1]
    (sent,) = found["lidaremu_scans_sent"].samples
    assert (sent.name, sent.labels, sent.value) == (
        "lidaremu_scans_sent_total",
        {"sensor": "front"},
        trial.instruments[0].stats.scans_sent,
    )


@pytest.mark.parametrize("where", ['a "quoted" file', r"back\slash\n", "two\nlines", "trailing\\", '{a="b"} 3'])
def test_a_foreign_name_is_a_label_and_nothing_else(where: str) -> None:
    incidents = Incidents()
    incidents.note("recording ended", 0, where, "disk full")
    (sample,) = families(prometheus([], incidents))["lidaremu_incidents"].samples
    assert sample.labels == {"kind": "recording ended", "on": where}
    assert sample.value == 1.0
