"""What a sensor did in a run, as reported in the last JSON line, at the end of a recording and in a test's verdict."""

from __future__ import annotations

from typing import Any

from emulator.instrument.instrument import Instrument
from emulator.instrument.vehicle_bus import VehicleSession


def summary(instrument: Instrument) -> dict[str, Any]:
    """What a sensor did, ready for JSON; rates are NaN-free (None where there is none)."""
    stats = instrument.stats
    late = stats.lateness

    def number(value: float) -> float | None:
        return None if value != value else round(value, 4)

    judged = {} if stats.objects is None else {"objects": stats.objects.as_json()}
    if instrument.faults is not None:
        judged["faults"] = instrument.faults.counts()
    if isinstance(instrument.session, VehicleSession):
        judged["vehicle_bus"] = instrument.session.account()
    return {
        "id": instrument.sensor,
        "scans_sent": stats.scans_sent,
        "scans_measured": stats.scans_measured,
        "scans_per_s": number(stats.rate_hz),
        "silent_s": number(stats.silent_s),
        "scans_dropped": dict(stats.scans_dropped),
        "account": stats.ledger.account(),
        "replies_sent": stats.replies_sent,
        "input_dropped": dict(stats.input_dropped),
        "restarts": stats.restarts,
        "lateness_us": {
            "sends": late.count,
            "median": number(late.percentile_ns(50) * 1e-3),
            "p99": number(late.percentile_ns(99) * 1e-3),
            "worst": number(late.worst_ns * 1e-3 if late.count else float("nan")),
            "histogram": [list(row) for row in late.histogram() if row[1]],
        },
        "links": [
            {
                "url": link.url,
                "bytes_in": link.stats.bytes_in,
                "bytes_out": link.stats.bytes_out,
                "bytes_lost": link.stats.bytes_lost,
                "bytes_garbled": link.stats.bytes_garbled,
                "payloads_dropped": link.stats.payloads_dropped,
                "hosts_refused": link.stats.hosts_refused,
            }
            for link in instrument.links
        ],
    } | judged
