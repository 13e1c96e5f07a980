"""How many LMS291 at 0.5 degrees, 37.5 scans a second each, this machine serves in fog and rain, and how steadily.

    python tests/benchmarks/bench_sensors.py [SECONDS [WORKERS]]

First the processor time of one scan, which bears a machine with other work on it, and how many sensors a core could
measure. Then starts the daemon with 16 sensors, and fewer until none drops a scan; hosts read on pseudo-terminals at
500 kBd. SECONDS 0: the first alone.
"""

from __future__ import annotations

import json
import os
import select
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT))

from tests.system.hosts import LmsHost  # noqa: E402

SCENE = """\
schema: 1
world:
  - {plane: {size_m: [80, 60]}, at_m: [30, 0, 0], material: asphalt}
  - {box: {size_m: [0.3, 50, 4]}, at_m: [30, 0, 0], material: concrete}
actors:
  - id: car
    class: car
    shape: {box: {size_m: [4.5, 1.8, 1.5]}}
    material: car_paint_grey
    motion:
      loop: true
      waypoints: [{t_s: 0, at_m: [12, -20, 0]}, {t_s: 4, at_m: [12, 20, 0]}, {t_s: 8, at_m: [12, -20, 0]}]
weather: {fog: {visibility_m: 200}, rain: {rate_mm_h: 10}}
sensors:
"""
SENSOR = (
    "  - {{id: s{0}, model: sick-lms291-s05, mount: {{at_m: [0, {1}, 0.6]}},"
    " device: {{resolution_deg: 0.5, field_deg: 180, unit: cm}}, links: ['pty:./s{0}']}}\n"
)


def scan_ms() -> float:
    """Median processor time of a scan of the first sensor."""
    from emulator.judging.trial import Trial
    from emulator.runtime import assembly
    from emulator.scenario import scenario

    loaded = scenario.loads(SCENE + SENSOR.format(0, 0.0), Path("many.yaml"), ["duration_s=1"])
    plans = []
    trial = Trial(loaded)
    measure = trial.instruments[0]._measuring.request
    trial.instruments[0]._measuring.request = lambda sensor, plan, *more: (
        plans.append(plan) or measure(sensor, plan, *more)
    )
    trial.finish()
    trial.close()
    function = assembly.build_measures(loaded)["s0"]
    took = []
    for plan in plans[-25:] * 2:
        start = time.process_time()
        function(plan)
        took.append(time.process_time() - start)
    return 1e3 * sorted(took)[len(took) // 2]


def run(count: int, seconds: float, folder: Path, workers: str | None) -> list[dict[str, object]]:
    """What `count` sensors did."""
    path = folder / "many.yaml"
    path.write_text(SCENE + "".join(SENSOR.format(index, 0.3 * index) for index in range(count)), encoding="utf-8")
    daemon = subprocess.Popen(
        [sys.executable, "-m", "emulator", "run", str(path), "--json", *(["--workers", workers] if workers else [])],
        stdout=subprocess.PIPE,
        text=True,
        cwd=folder,
        env=dict(os.environ) | {"PYTHONPATH": str(ROOT)},
    )
    assert daemon.stdout is not None
    daemon.stdout.readline()
    hosts = [LmsHost(str(folder / f"s{index}")) for index in range(count)]
    for host in hosts:
        host.set_baud(500_000)
    for host in hosts:
        host.stream()
    files = [host.port.fileno() for host in hosts]
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        for number in select.select(files, [], [], 0.1)[0]:
            os.read(number, 65_536)
        time.sleep(0.005)
    daemon.send_signal(signal.SIGTERM)
    out, _ = daemon.communicate(timeout=30.0)
    for host in hosts:
        host.port.close()
    return next(json.loads(line)["sensors"] for line in out.splitlines() if "stopped" in line)


def main() -> None:
    seconds = float(sys.argv[1]) if len(sys.argv) > 1 else 10.0
    workers = sys.argv[2] if len(sys.argv) > 2 else None
    cost_ms = scan_ms()
    rate = 1e3 / cost_ms
    print(f"{cost_ms:.2f} ms of processor time a scan: a core measures {rate:.0f} scans/s, {rate / 37.5:.1f} sensors")
    if not seconds:
        return
    for count in (16, 12, 8, 6, 4, 3, 2, 1):
        with tempfile.TemporaryDirectory() as folder:
            rows = run(count, seconds, Path(folder), workers)
        sent = sum(row["scans_sent"] for row in rows)
        dropped = sum(sum(row["scans_dropped"].values()) for row in rows)
        medians = sorted(row["lateness_us"]["median"] or 0 for row in rows)
        p99 = max(row["lateness_us"]["p99"] or 0 for row in rows)
        print(
            f"{count:2d} sensors: {sent} scans sent ({sent / seconds / count:.1f}/s each), {dropped} dropped;"
            f" lateness median {medians[len(medians) // 2]:.0f} us, p99 of the worst {p99:.0f} us",
            flush=True,
        )
        if dropped <= 0.01 * sent:
            print(f"{count} sensors are served whole")
            return


if __name__ == "__main__":
    main()
