"""docs/scoreboard.md from the results that are kept beside it."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "docs" / "scoreboard.md"
RESULTS = ROOT / "docs" / "scoreboard.json"

HEAD = """\
# Scoreboard

Made by the tests: `python -m tests.scoreboard` runs faults, coverage, fuzzing and a soak and writes this page;
`python -m tests.scoreboard soak --soak-hours 24 --soak-real-s 600` and `python -m tests.scoreboard mutants` take
longer. A part that is not run keeps its last result.
"""


def page(results: dict[str, Any]) -> str:
    """The whole page."""
    makers = {"faults": _faults, "fuzz": _fuzz, "soak": _soak, "coverage": _coverage, "mutants": _mutants}
    parts = [HEAD.rstrip()]
    for name, make in makers.items():
        if name in results:
            parts.append("\n".join(make(results[name])))
    return "\n\n".join(parts) + "\n"


def _table(head: list[str], rows: list[list[object]]) -> Iterator[str]:
    yield "| " + " | ".join(head) + " |"
    yield "|" + "---|" * len(head)
    for row in rows:
        yield "| " + " | ".join(str(one) for one in row) + " |"


def _faults(found: dict[str, Any]) -> Iterator[str]:
    yield "## Faults"
    yield ""
    yield (
        f"{found['tests']} tests, {found['failed']} failed. Tried: it began in a test that passed. Seen: it hit"
        " something there, and the test found it on the wire. Recovered: it ended, and the wire was clean again."
    )
    yield ""
    rows = found["faults"]
    layers = list(dict.fromkeys(row["layer"] for row in rows.values()))
    lines: list[list[object]] = []
    for layer in [*layers, None]:
        kept = {name: row for name, row in rows.items() if layer in (row["layer"], None)}
        counts = [sum(row[what] for row in kept.values()) for what in ("begin", "hit", "end")]
        missing = [name for name, row in kept.items() if not (row["begin"] and row["hit"] and row["end"])]
        lines.append([layer or "all", len(kept), *counts, ", ".join(missing) if layer and missing else "-"])
    yield from _table(["Layer", "Faults", "Tried", "Seen", "Recovered", "Not all three"], lines)


def _fuzz(found: dict[str, Any]) -> Iterator[str]:
    rows = found["parsers"]
    yield "## Fuzzing"
    yield ""
    cases, seconds = sum(row["cases"] for row in rows), sum(row["cpu_s"] for row in rows)
    faults = sum(len(row["faults"]) for row in rows)
    yield (
        f"{cases} cases in {seconds:.0f} s of CPU, {faults} faults (`lidaremu study fuzz --seed {found['seed']}`,"
        f" engine {found['engine']})."
    )
    yield ""
    yield from _table(
        ["Parser", "Cases", "CPU s", "Slowest ms", "Peak MB", "Faults"],
        [
            [row["parser"], row["cases"], row["cpu_s"], row["slowest_ms"], row["peak_mb"], len(row["faults"])]
            for row in rows
        ],
    )


def _soak(found: dict[str, Any]) -> Iterator[str]:
    yield "## Soak"
    yield ""
    lines: list[list[object]] = []
    for kind, one in found.items():
        sensors, memory = one["sensors"].values(), one["memory"]
        lines.append(
            [
                f"{one['simulated_s']:.0f} s, {kind}",
                f"{one['wall_s']:.0f}",
                sum(row["asked"] for row in sensors),
                sum(row["sent"] for row in sensors),
                sum(sum(row["dropped"].values()) for row in sensors),
                sum(row["unaccounted"] for row in sensors),
                sum(sum(book["visits"].values()) for book in one["hosts"].values()),
                f"{memory['rss_mb_rise_second_half']:+}",
                memory["descriptors_peak"],
                "held" if one["held"] else "not held: " + "; ".join(one["faults"]),
            ]
        )
    head = ["Time", "Took s", "Scans asked", "Sent", "Dropped by reason", "Unaccounted", "Visits", "MB in second half"]
    yield from _table([*head, "Descriptors", "Verdict"], lines)


def _coverage(found: dict[str, Any]) -> Iterator[str]:
    yield "## Coverage"
    yield ""
    yield from _table(
        ["Place", "Lines", "Reached", "Branches", "Reached"],
        [[f"`{name}`", row["lines"], f"{row['lines_percent']} %", row["branches"], f"{row['branches_percent']} %"]
         for name, row in found.items()],
    )  # fmt: skip


def _mutants(found: dict[str, Any]) -> Iterator[str]:
    yield "## Mutants of the codecs"
    yield ""
    judged = found["killed"] + found["timeout"] + found["survived"] + found["no_tests"]
    caught = found["killed"] + found["timeout"]
    left = "" if judged == found["total"] else f" {found['total'] - judged} were not judged: the run was cut short."
    yield (
        f"`bash .ci/mutants` (mutmut): {found['total']} mutants of framing, checksums, value words, profiles, packages,"
        f" segments and CAN layouts; {caught} caught, {found['survived']} survived, {found['no_tests']} without a test:"
        f" {100.0 * caught / judged:.1f} %. Some cannot be told from the code, such as `big` left out of `to_bytes`."
        f"{left}"
    )
