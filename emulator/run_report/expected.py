"""The chapter of a run's report on its expectations: what was wanted and found, and a picture around each failure.

Belongs here: what is shown of a verdict. Not: judging (`judging.expectations`), other chapters.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from emulator.run_report.figures import fault_spans
from emulator.run_report.gather import Gathered, SensorTally
from emulator.studies.drawing import COLOURS, figure, png, word
from emulator.studies.report import Column, Picture, Section, Table, Value, rows_of

AROUND_S = 0.5
"Shown before and after the time of a failure, at least."
MOST_PICTURES = 12


def chapter(run: Gathered) -> Section | None:
    """None where the recording holds no verdict and its scenario expects nothing."""
    rows = _rows(run)
    if not rows:
        if run.scenario is None or not run.scenario.expect:
            return None
        reported = f"{len(run.scenario.expect)} expectations are in the scenario; this run was not judged."
        return Section("Expectations", (reported,))
    failed = [row for row in rows if not row.get("held")]
    text = f"failed: {len(failed)} of {len(rows)} expectations" if failed else f"passed: all {len(rows)} expectations"
    columns = (
        Column("expected", "Expected"),
        Column("verdict", "Verdict"),
        Column("found", "Found"),
        Column("wanted", "Wanted"),
        Column("at_s", "At [s]", ".3f"),
        Column("until_s", "until [s]", ".3f"),
        Column("value", "Value then", ".6g"),
        Column("active", "Active then"),
    )
    table = [
        (
            str(row.get("name", "")), "held" if row.get("held") else "failed", str(row.get("found", "")),
            str(row.get("wanted", "")), _number(row, "at_s"), _number(row, "until_s"), _number(row, "value"),
            ", ".join(map(str, row.get("active", ()))),
        )
        for row in sorted(rows, key=lambda row: bool(row.get("held")))
    ]  # fmt: skip
    return Section(
        "Expectations",
        (text + ".",),
        tuple(_pictures(run, failed)),
        (Table("expected", "What was expected", columns, rows_of(table)),),
    )


def _rows(run: Gathered) -> list[Mapping[str, Any]]:
    found = run.verdict.get("expect", ())
    return [row for row in found if isinstance(row, Mapping)] if isinstance(found, Sequence) else []


def _number(row: Mapping[str, Any], key: str) -> Value:
    value = row.get(key)
    return float(value) if isinstance(value, int | float) and not isinstance(value, bool) else None


def _pictures(run: Gathered, failed: Sequence[Mapping[str, Any]]) -> Iterator[Picture]:
    shown = [row for row in failed if isinstance(_number(row, "at_s"), float)]
    for number, row in enumerate(shown[:MOST_PICTURES], 1):
        name = str(row.get("name", ""))
        title = f"Around the failure of: {name}"
        active = ", ".join(map(str, row.get("active", ()))) or "nothing else"
        reported = f"Grey: from {row['at_s']:.3f} s" + (
            f" to {row['until_s']:.3f} s" if _number(row, "until_s") else ""
        )
        yield Picture(f"expectation_{number}", title, _picture(run, row), f"{reported}. Active then: {active}.")


def _sensors(run: Gathered, row: Mapping[str, Any]) -> list[SensorTally]:
    """The one that broke the expectation; all where that is not known."""
    named = [one for one in run.sensors.values() if one.sensor == row.get("sensor")]
    return (named or list(run.sensors.values()))[:4]


def _picture(run: Gathered, row: Mapping[str, Any]) -> bytes:
    """Scans that left, echoes of sweeps, and faults, around a time."""
    from_s = float(row["at_s"])
    to_s = float(row.get("until_s") or from_s)
    around_s = max(AROUND_S, 0.5 * (to_s - from_s))
    sensors = _sensors(run, row)
    made, panels = figure(1, len(sensors), size=(9.0, 2.4 * len(sensors) + 0.5))
    for number, (axes, one) in enumerate(zip(panels, sensors, strict=True)):
        axes.axvspan(from_s, max(to_s, from_s + 0.002 * around_s), color="0.8")
        colour = COLOURS[number % len(COLOURS)]
        swept, sent = (np.array(times, dtype=np.int64) * 1e-9 for times in (one.sweep_ns, one.sent_ns))
        points = np.array(one.points, dtype=np.float64)
        near = (swept >= from_s - around_s) & (swept <= to_s + around_s)
        height = float(points[near].max()) if near.any() else 0.0
        axes.plot(swept[near], points[near], ".-", color=colour, label="beams with an echo")
        left = sent[(sent >= from_s - around_s) & (sent <= to_s + around_s)]
        below = -0.12 * max(height, 1.0)
        axes.plot(left, np.full(len(left), below), "|", color="black", markersize=9, label="scan leaves")
        for begun, ended in fault_spans(run.happenings, one.sensor, run.end_s):
            if ended >= from_s - around_s and begun <= to_s + around_s:
                axes.axvspan(begun, max(ended, begun + 0.002 * around_s), color="tab:red", alpha=0.15)
        axes.set_xlim(from_s - around_s, to_s + around_s)
        axes.set_ylim(bottom=2.0 * below)
        axes.set_title(word(f"{one.sensor} (red: a fault is active)"), fontsize=10)
        axes.set_xlabel("time [s]")
        axes.legend(frameon=False, fontsize=8, loc="upper right")
    return png(made)
