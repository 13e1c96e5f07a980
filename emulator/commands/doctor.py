"""`lidaremu doctor`: what this machine allows."""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from dataclasses import asdict
from typing import TYPE_CHECKING

import click

from emulator.commands.common import OK
from emulator.output.lines import say

if TYPE_CHECKING:
    from emulator.transports.probes import Probe


@click.command()
@click.option(
    "--seconds", type=click.FloatRange(0.1, 600.0), default=3.0, show_default=True, help="Duration of the timer test."
)
@click.option("--serial", "device", metavar="DEVICE", help="Measure this adapter only; bytes are written to it.")
@click.option("--json", "as_json", is_flag=True, help="One JSON object per line.")
def doctor(seconds: float, device: str | None, as_json: bool) -> int:
    """What this machine allows: pseudo-terminals and their speeds, multicast, SocketCAN, adapters, timers, loops.

    With --serial: what one adapter does, that is its latency timer, the speeds it accepts, its real throughput and,
    where TXD and RXD are bridged, the round-trip time of a byte. Disconnect the sensor first: it would receive it all.
    """
    if device is not None:
        from emulator.process.clock import SystemClock
        from emulator.transports.adapter_probe import probe_adapter

        return _tell(probe_adapter(device, SystemClock()), as_json)
    from emulator.compiled import switch
    from emulator.process.waiting import realtime_allowed
    from emulator.runtime.pacing_trial import measure
    from emulator.transports.probes import Probe, probe_links

    cores = len(os.sched_getaffinity(0))
    probes = [Probe("processor cores", cores > 1, f"{cores}: one sends, {max(1, cores - 1)} measure")]
    probes.append(Probe("compiled loops", *switch.why()))
    probes += probe_links(os.environ)
    found = measure(seconds)
    ours, other = found.ours, found.asyncio_sleep
    steady = ours.median_us <= 50.0 and ours.p99_us <= 1500.0
    detail = (
        f"{ours.count} deadlines at 75 Hz: median {ours.median_us:.0f} us, p99 {ours.p99_us:.0f} us, worst"
        f" {ours.worst_us:.0f} us; asyncio.sleep at the same time: {other.median_us:.0f}, {other.p99_us:.0f},"
        f" {other.worst_us:.0f}; wanted on an idle machine: median 50, p99 1500; {100 * found.awake_share:.1f} % of a"
        " core spent awake for it"
    )
    probes.append(Probe("timers", steady, detail))
    refused = realtime_allowed()
    first = found.realtime
    detail = (
        f"run --realtime: median {first.median_us:.0f} us, p99 {first.p99_us:.0f} us, worst {first.worst_us:.0f} us"
    )
    probes.append(Probe("real-time scheduling", not refused, refused or detail))
    return _tell(probes, as_json)


def _tell(probes: Sequence[Probe], as_json: bool) -> int:
    """A line each."""
    for probe in probes:
        if as_json:
            say(json.dumps(asdict(probe)))
        else:
            say(f"{'yes' if probe.works else 'no ':3}  {probe.name}: {probe.detail}")
    return OK
