"""`lidaremu demo`: the daemon on a built-in scenario, and a host of ours on the other end of its line."""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

from emulator import scenario as scenario_file
from emulator.errors import EmulatorError
from emulator.look import HOSTS, connect, watch
from emulator.spec import load_spec
from protocols import family as protocol_family

DEFAULT_S = 20.0
"How long the demo lasts when nobody says."


def run_demo(name: str, sensor: str | None, duration_s: float | None, baud: int, say: Callable[[str], None]) -> int:
    """Start the daemon as a process of its own, look through one sensor, stop it; the exit code."""
    loaded = scenario_file.load(name)
    ids = [item.id for item in loaded.sensors]
    chosen = sensor or ids[0]
    if chosen not in ids:
        raise EmulatorError(f"sensor {chosen!r}; {name} has {', '.join(ids)}")
    family = load_spec(loaded.sensors[ids.index(chosen)].model).family or "none"
    with tempfile.TemporaryDirectory(prefix="lidaremu-") as folder:
        urls = {item: f"pty:{Path(folder) / item}" for item in ids}
        if family in HOSTS and not protocol_family(family).tcp_is_line:
            urls[chosen] = "tcp:127.0.0.1:0"  # the device's own network interface is quicker than its serial line
        links = [f"--link={item}={url}" for item, url in urls.items()]
        daemon = subprocess.Popen(
            [sys.executable, "-m", "emulator", "run", name, "--json", *links], stdout=subprocess.PIPE, text=True
        )
        try:
            assert daemon.stdout is not None
            first = daemon.stdout.readline()
            if not first:
                raise EmulatorError(f"the daemon did not start (exit code {daemon.wait()})")
            ready = json.loads(first)
            say(f"daemon: {name}: " + ", ".join(item["links"][0] for item in ready["sensors"]))
            place = next(item["links"][0] for item in ready["sensors"] if item["id"] == chosen)
            host = connect(place, family, baud)
            try:
                watch(host, None, duration_s or DEFAULT_S, None, say, live=sys.stdout.isatty())
            except KeyboardInterrupt:
                pass
            finally:
                host.close()
        finally:
            daemon.terminate()
            rest, _ = daemon.communicate(timeout=10.0)
        for line in rest.splitlines():
            event = json.loads(line)
            if event.get("event") == "stopped":
                total = next(item for item in event["sensors"] if item["id"] == chosen)
                late = total["lateness_us"]
                say(
                    f"{chosen}: {total['scans_sent']} scans sent, {total['scans_per_s']}/s;"
                    f" lateness median {late['median']} us, p99 {late['p99']} us"
                )
    return 0
