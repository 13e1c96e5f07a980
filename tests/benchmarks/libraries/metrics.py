"""Prometheus text of a run: the library's writer in place of ours, and what its import does to a thread that sends."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from emulator.instrument.instrument import Instrument
from emulator.judging.trial import Trial
from emulator.process.incidents import Incidents
from emulator.runtime import metrics
from emulator.runtime.liveness import Liveness
from emulator.scenario import scenario
from tests.benchmarks.libraries.measure import ROOT, Row, added, failing, import_cost, lines, per_s, version_of
from tests.runtime.test_metrics import CASE

TESTS = ("tests/runtime/test_metrics.py", "tests/runtime/test_liveness.py")
Found = tuple[str, str, str, list[tuple[str, dict[str, str], float]]]
SENDS = "import emulator.commands.cli, emulator.runtime.assembly, emulator.runtime.daemon, emulator.runtime.orders"


def _families(instruments: Sequence[Instrument], incidents: Incidents, liveness: Liveness | None) -> Iterator[Found]:
    """The facts alone: name, type, help, samples. They are ours whoever writes them."""
    if liveness is not None:
        silent = [("", {"sensor": one.sensor}, liveness.silent_s(one.sensor)) for one in instruments]
        yield (
            "lidaremu_sensor_silent_seconds",
            "gauge",
            "How long scans that a host waits for have been missing.",
            silent,
        )
    kinds = [("_total", {"kind": kind, "on": on}, n) for (kind, on), n in sorted(dict(incidents.counts).items())]
    yield "lidaremu_incidents", "counter", "What befell processes, files and links of the run, by kind.", kinds
    sent = [("_total", {"sensor": one.sensor}, one.stats.scans_sent) for one in instruments]
    yield "lidaremu_scans_sent", "counter", "Scans handed to the links.", sent
    states = ("asked", "sent", "withdrawn", "under_way", "unaccounted")
    account = [
        ("", {"sensor": one.sensor, "state": state}, one.ledger.account()[state])
        for one in instruments for state in states
    ]  # fmt: skip
    meaning = "Scans that hosts are entitled to, by where they are; unaccounted has to be 0."
    yield "lidaremu_scans_account", "gauge", meaning, account
    for what, meaning in (("scans", "Scans given up"), ("input", "Input not taken")):
        dropped = [
            ("_total", {"sensor": one.sensor, "reason": reason}, count)
            for one in instruments for reason, count in sorted(getattr(one.stats, f"{what}_dropped").items())
        ]  # fmt: skip
        yield f"lidaremu_{what}_dropped", "counter", f"{meaning}, by reason.", dropped
    hits = [
        ("_total", {"sensor": one.sensor, "fault": name}, row["hits"])
        for one in instruments if one.faults is not None for name, row in one.faults.counts().items()
    ]  # fmt: skip
    yield "lidaremu_fault_hits", "counter", "What faults have hit, by name.", hits
    octets = [
        ("_total", {"sensor": one.sensor, "link": str(index), "direction": way}, getattr(link.stats, f"bytes_{way}"))
        for one in instruments for index, link in enumerate(one.links) for way in ("in", "out", "lost")
    ]  # fmt: skip
    yield "lidaremu_link_bytes", "counter", "Bytes by direction; lost: nobody read them.", octets
    late: list[tuple[str, dict[str, str], float]] = []
    for one in instruments:
        total = 0
        for edge_us, count in one.stats.lateness.histogram():
            total += count
            late.append(("_bucket", {"sensor": one.sensor, "le": f"{edge_us * 1e-6:g}" if edge_us else "+Inf"}, total))
        late += [
            ("_sum", {"sensor": one.sensor}, one.stats.lateness.sum_ns * 1e-9),
            ("_count", {"sensor": one.sensor}, total),
        ]
    yield "lidaremu_lateness_seconds", "histogram", "Actual minus scheduled instant of each send.", late


def by_prometheus_client(
    instruments: Sequence[Instrument], incidents: Incidents | None = None, liveness: Liveness | None = None
) -> str:
    from prometheus_client import generate_latest
    from prometheus_client.core import Metric

    class Registry:
        def collect(self) -> Iterator[Any]:
            for name, kind, meaning, samples in _families(instruments, incidents or Incidents(), liveness):
                made = Metric(name, meaning, kind)
                for suffix, labels, value in samples:
                    made.add_sample(name + suffix, labels, value)
                yield made

    return str(generate_latest(Registry()).decode())  # type: ignore[arg-type]


def put_in(name: str) -> None:
    """Write with the library instead of ourselves."""
    metrics.prometheus = by_prometheus_client


_STALL = """
import sys, threading, time
sys.path[:0] = {path!r}
{before}
from emulator.runtime.daemon import SWITCH_S
sys.setswitchinterval(SWITCH_S)
def work():
    {work}
thread = threading.Thread(target=work)
gaps, last = [], time.perf_counter()
thread.start()
while thread.is_alive() or len(gaps) < 100:
    time.sleep(0.0002)
    now = time.perf_counter()
    gaps.append(now - last)
    last = now
print(1e3 * max(gaps))
"""


def stall(work: str) -> str:
    """How long a thread that wakes every 0.2 ms is held up while another does `work`: median of three runs."""
    code = _STALL.format(path=sys.path, before=SENDS, work=work)
    reported = sorted(
        float(subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=ROOT).stdout)
        for _ in range(3)
    )
    return f"{reported[1]:.1f} ms"


def rows(tests: bool = False) -> list[Row]:
    """Ours, then the library: sixteen sensors."""
    one = CASE.splitlines()[-1]
    many = "\n".join(one.replace("front", f"s{number}") for number in range(16))
    trial = Trial(scenario.loads(CASE.replace(one, many), Path("case.yaml")))
    trial.finish()
    render = {"text of 16 sensors": f"{1e3 / per_s(lambda: metrics.prometheus(trial.instruments)):.2f} ms"}
    idle = {"sender held up, nobody asks": stall("pass")}
    found = [Row("ours", {"lines in all": str(lines(metrics))} | render | idle)]
    version = version_of("prometheus_client")
    if version is None:
        return [*found, Row("prometheus_client")]
    cost = {"install": added("prometheus_client"), "import": import_cost("prometheus_client", SENDS)}
    cost["lines in all"] = str(lines(by_prometheus_client, _families))
    cost["text of 16 sensors"] = f"{1e3 / per_s(lambda: by_prometheus_client(trial.instruments)):.2f} ms"
    cost["same text once sorted"] = str(
        _sorted(metrics.prometheus(trial.instruments)) == _sorted(by_prometheus_client(trial.instruments))
    )
    cost["sender held up by its import"] = stall("import prometheus_client")
    if tests:
        cost["our tests that fail with it"] = failing(TESTS, "metrics:prometheus_client")
    return [*found, Row(f"prometheus_client {version}", cost)]


def _sorted(text: str) -> set[tuple[str, ...]]:
    """Lines as sets of labels and a number, so that order and `5` for `5.0` make no difference."""
    found = set()
    for line in text.splitlines():
        head, _, value = line.rpartition(" ")
        name, _, labels = head.rstrip("}").partition("{")
        if line[:1] != "#":
            found.add((name, *sorted(labels.split(",")), f"{float(value):.9g}"))
    return found
