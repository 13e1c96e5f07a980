"""The numbers of a run's report as one JSON object; null where there is none.

Belongs here: names of keys. Not: counting (gather, errors).
"""

from __future__ import annotations

from typing import Any

import numpy as np

from emulator.objects.metrics import DISTANCE_BINS_M
from emulator.run_report.errors import Aimed, Errors, RangeTally, known
from emulator.run_report.gather import Gathered, LinkTally, SensorTally, late_us
from emulator.run_report.weather import steps


def summary_of(run: Gathered) -> dict[str, Any]:
    """Everything that has a number."""
    weather = [] if run.scenario is None else steps(run.scenario, run.orders, run.duration_s)
    return {
        "recording": str(run.path),
        "version": run.version,
        "duration_s": run.duration_s,
        "cut": run.cut,
        "remarks": list(run.remarks),
        "expect": run.verdict.get("expect", []),
        "sensors": [_sensor(one) for one in run.sensors.values()],
        "weather": [{"t_s": step.t_s, "ordered": step.ordered, **step.values} for step in weather],
        "time_line": [
            {"at_s": one.at_ns * 1e-9, "sensor": one.sensor, "kind": one.kind, "what": one.text}
            for one in run.happenings
        ],
    }


def _sensor(one: SensorTally) -> dict[str, Any]:
    gaps = one.gaps_s
    row: dict[str, Any] = {
        "id": one.sensor,
        "model": one.model,
        "scans_sent": len(one.sent_ns),
        "scans_recorded": one.measured,
        "scans_per_s": known(one.rate_hz),
        "silent_s": one.silent_s,
        "gap_s": {
            "mean": float(gaps.mean()), "sigma": float(gaps.std()), "median": float(np.median(gaps)),
            "shortest": float(gaps.min()), "longest": float(gaps.max()),
        } if len(gaps) else None,
        "scans_dropped": dict(one.scans_dropped),
        "input_dropped": dict(one.input_dropped),
        "restarts": one.restarts,
        "replies": sum(link.replies for link in one.links.values()),
        "commands": [
            {"command": command, "outcome": outcome, "count": tally.count}
            for (command, outcome), tally in one.commands.items()
        ],
        "faults": [
            {"number": number, "name": fault.name, "hits": fault.hits} for number, fault in sorted(one.faults.items())
        ],
        "lateness_us": one.end.get("lateness_us"),
        "links": [_link(number, link) for number, link in sorted(one.links.items())],
    }  # fmt: skip
    if one.truth is not None and one.truth.tally.sweeps:
        row["ranges"] = _ranges(one.truth.tally)
    if one.objects is not None:
        row["objects"] = one.objects.score.as_json()
    return row


def _link(number: int, link: LinkTally) -> dict[str, Any]:
    row: dict[str, Any] = {"link": number, "url": link.url, "payloads_out": link.sent, "payloads_in": link.received}
    if not link.late_ns:
        return row | {"lateness_us": None}
    count, median, p99, worst = late_us(link)
    return row | {"lateness_us": {"payloads": count, "median": median, "p99": p99, "worst": worst}}


def _ranges(tally: RangeTally) -> dict[str, Any]:
    return {
        "sweeps": tally.sweeps,
        "beside": tally.beside,
        "actors": [
            {
                "actor": tally.actors[number],
                **_aimed(tally.aimed[number]),
                **_errors(tally.by_actor[number]),
                "farthest_m": tally.farthest_m.get(number),
                "sweeps_met": int(tally.could[number].sum()),
                "sweeps_seen": int(tally.did[number].sum()),
                "by_distance": [
                    {
                        "up_to_m": known(float(DISTANCE_BINS_M[index])),
                        **_aimed(tally.aimed_by_class[number, index]),
                        **_errors(tally.by_class[number, index]),
                    }
                    for index in range(len(DISTANCE_BINS_M))
                    if (number, index) in tally.by_class
                ],
            }
            for number in sorted(tally.aimed)
        ],
    }


def _aimed(aimed: Aimed) -> dict[str, int]:
    return {
        "beams": aimed.beams, "seen": aimed.seen, "other": aimed.other, "air": aimed.air, "missed": aimed.missed,
    }  # fmt: skip


def _errors(errors: Errors) -> dict[str, float | None]:
    return {"mean_m": known(errors.mean_m), "sigma_m": known(errors.sigma_m), "rms_m": known(errors.rms_m)}
