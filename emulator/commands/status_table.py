"""`lidaremu ctl status` for people: a few lines and a row a sensor, of the daemon's own answer.

Belongs here: words and columns. Not: what is asked (orders), who prints (ctl).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

HEAD = ("sensor", "scans", "rate", "dropped", "replies", "late p99", "silent", "link", "in", "out")


def lines_of(status: Mapping[str, Any]) -> list[str]:
    """A run's status, to be read in a terminal."""
    manner = f"{status['clock']} clock{', paused' if status.get('paused') else ''}"
    end_s = status.get("ends_at_s")
    end = "" if end_s is None else f", ends at {end_s:g} s"
    reported = [f"{status.get('scenario', 'run')}: {status['now_s']:.1f} s, {manner}{end}", ""]
    rows: list[Sequence[str]] = [HEAD]
    for sensor in status["sensors"]:
        rows += _rows(sensor)
    widths = [max(len(row[column]) for row in rows) for column in range(len(HEAD))]
    for row in rows:
        cells = (text.ljust(width) for text, width in zip(row, widths, strict=True))
        reported.append("  ".join(cells).rstrip())
    for sensor in status["sensors"]:
        reasons = {"dropped": sensor.get("scans_dropped"), "input not taken": sensor.get("input_dropped")}
        for what, found in reasons.items():
            if found:
                reported.append(f"{sensor['id']}: {what}: " + ", ".join(f"{n} {why}" for why, n in found.items()))
        for name, row in sensor.get("faults", {}).items():
            reported.append(f"{sensor['id']}: fault {name}: begun {row['begun']} times, {row['hits']} hits")
    workers = status.get("workers") or []
    if workers:
        reported.append(
            "workers: " + ", ".join(f"{one['worker']} {one['state']} (pid {one['pid']})" for one in workers)
        )
    recording = status.get("recording")
    if recording:
        reported.append(f"recording: {recording['state']}, {recording['folder']}")
    for kind, count in (status.get("incident_totals") or {}).items():
        reported.append(f"incidents: {count} {kind}")
    return reported


def _rows(sensor: Mapping[str, Any]) -> list[Sequence[str]]:
    """One for the sensor with its first link, one for each other link."""
    late = (sensor.get("lateness_us") or {}).get("p99")
    rate, silent = sensor.get("scans_per_s"), sensor.get("silent_s") or 0.0
    head = (
        str(sensor["id"]),
        str(sensor["scans_sent"]),
        "-" if rate is None else f"{rate:.2f}/s",
        str(sum((sensor.get("scans_dropped") or {}).values())),
        str(sensor.get("replies_sent", "-")),
        "-" if late is None else f"{late / 1000:.2f} ms",
        f"{silent:.1f} s" if silent else "-",
    )
    links = [(str(one["url"]), _bytes(one["bytes_in"]), _bytes(one["bytes_out"])) for one in sensor.get("links") or ()]
    links = links or [("-", "-", "-")]
    return [(*head, *links[0]), *(("",) * len(head) + one for one in links[1:])]


def _bytes(count: int) -> str:
    return f"{count} B" if count < 10_000 else f"{count / 1e3:.1f} kB" if count < 1e7 else f"{count / 1e6:.1f} MB"
