"""The page of a campaign, and a page for each case that it leads to.

Belongs here: what is reported, and in which order. Not: drawing (figures), HTML (studies.report).
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from emulator.campaigns import figures
from emulator.campaigns.campaign import Campaign
from emulator.campaigns.searching import wilson
from emulator.campaigns.sensitivity import MOST_POINTS, indices
from emulator.campaigns.store import Row, Store
from emulator.campaigns.table import VERDICTS, Results, shown_value
from emulator.errors import EmulatorError
from emulator.studies import report as form
from emulator.studies.report import Column, Fact, Link, Picture, Report, Section, Table, Value

Begin = Callable[[Callable[[Path], None], Path], Callable[[], object]]
"Has something done, and gives what waits for its end."

MOST_MAPS = 3
MOST_CURVES = 6
MOST_PANELS = 9
MOST_ROWS = 12
PAGES = "pages"
"Folder of the cases' own pages, beside the campaign's."


def write_page(
    campaign: Campaign,
    store: Store,
    results: Results,
    missing: int,
    outcome: Mapping[str, Any] | None,
    runs: int,
    begin: Begin = partial,
) -> Path:
    """Write `report.html` and the pages of the cases it leads to; `runs`: of so many recordings a whole report.

    `begin`: has one of those made beside the page.
    """
    linked: dict[str, None] = {}
    under_way: list[Callable[[], object]] = []

    def link(case: int) -> str:
        name = results.names[case].decode()
        if name not in linked:
            linked[name] = None
            if len(under_way) < runs and store.recording(name).is_dir():
                under_way.append(begin(write_run_report, store.recording(name)))
        return f"{PAGES}/{name}.html"

    out = store.root
    path = out / "report.html"
    try:
        made = report_of(campaign, results, missing, outcome, link)
        (out / PAGES).mkdir(exist_ok=True)
        for name in linked:
            row = store.row(name)
            if row is not None:
                page = form.page(case_page(campaign, store, row))
                store.put(out / PAGES / f"{name}.html", page)
        for end in under_way:
            end()
        store.put(path, form.page(made))
    except OSError as error:
        raise EmulatorError(f"{path}: cannot be written: {error.strerror}") from None
    return path


def write_run_report(folder: Path) -> None:
    """The report of a recording, where there is none yet. Raises `OSError`."""
    from emulator.run_report.gather import gather
    from emulator.run_report.page import report_of as run_report_of

    page = folder / "report.html"
    if not page.is_file():
        page.write_text(form.page(run_report_of(gather(folder, True, lambda at: None))), encoding="utf-8")


def report_of(
    campaign: Campaign, results: Results, missing: int, outcome: Mapping[str, Any] | None, link: Callable[[int], str]
) -> Report:
    """Everything as one report; `link` gives the page of a case by its place in the results."""
    varied = [one for one in results.factors if len(figures.distinct(results, one)) > 1]
    judged = bool(campaign.expect) or bool(campaign.job.driver)
    values = [*(["pass"] if judged else []), *results.quantities]
    known = [one for one in values if not np.isnan(results.value(one)).all()] if len(results) else []
    effects = {of: indices(campaign, results, of) for of in known[:MOST_CURVES]}
    sections = [
        *_outcome(outcome),
        *_maps(results, varied, judged, effects, link),
        *_curves(results, varied, known),
        *_sensitivity(campaign, effects),
        *_expectations(results),
        *_lists(campaign, results, link),
    ]
    design = campaign.file.design.kind
    summary = (
        f"`{campaign.path.name}`: {len(results)} cases of `{campaign.file.scenario}`, design {design}, seed"
        f" {campaign.file.seed}, version {campaign.job.version}.",
        *((f"{missing} cases are not done: what follows is of the others.",) if missing else ()),
    )
    closing = "All rows with factors, verdicts, quantities, seconds and sha256 are in results.parquet or results.csv."
    return Report(
        "report",
        f"Campaign {campaign.path.stem}",
        summary,
        tuple(sections),
        closing,
        (),
        tuple(_facts(results, judged)),
    )


def _facts(results: Results, judged: bool) -> Iterator[Fact]:
    counts = results.counts()
    yield Fact("cases", f"{len(results)}")
    if judged and counts["passed"] + counts["failed"]:
        share = wilson(counts["passed"], counts["passed"] + counts["failed"])
        yield Fact(f"passed, 95 %: {100 * share.low:.1f} to {100 * share.high:.1f} %", f"{100 * share.estimate:.1f} %")
        yield Fact("failed", f"{counts['failed']}")
    broken = sum(counts[one] for one in VERDICTS[2:])
    yield Fact("error, crashed or hung", f"{broken}", "bad" if broken else "good")
    yield Fact("computing", f"{results.seconds.sum():.0f} s")


def _outcome(outcome: Mapping[str, Any] | None) -> Iterator[Section]:
    if outcome is None:
        return
    if outcome["design"] == "monte_carlo":
        state = "reached" if outcome["reached"] else "not reached"
        of = "The pass rate" if outcome["of"] == "pass" else f"The mean of `{outcome['of']}`"
        text = (
            f"{of} is {outcome['estimate']:.6g}, with {100 * outcome['confidence']:g} % confidence between"
            f" {outcome['low']:.6g} and {outcome['high']:.6g}, after {outcome['points']} points: precision {state}."
        )
        yield Section("Precision", (text,))
    elif outcome["design"] == "worst" and outcome["case"] is not None:
        shown = ", ".join(f"{key} = {value}" for key, value in outcome["factors"].items())
        word = "smallest" if outcome["find"] == "min" else "largest"
        text = f"The {word} `{outcome['of']}` found is {outcome['value']:.6g}, at {shown}."
        yield Section(
            "Worst case found",
            (text, "`worst.yaml` is its scenario: `lidaremu test worst.yaml` runs it to the same bytes."),
        )
    elif outcome["design"] == "boundary" and outcome.get("found"):
        rows = outcome["found"]
        others = list(rows[0]["factors"])
        columns = (
            *(Column(one, one, ".6g") for one in others),
            Column("low", "from", ".6g"),
            Column("high", "to", ".6g"),
            Column("state", "verdict"),
        )
        table = Table(
            "boundary", f"Between which values of {outcome['of']} the verdict changes", columns,
            tuple(
                (*(_cell(row["factors"][one]) for one in others), row["low"], row["high"], row["state"]) for row in rows
            ),
        )  # fmt: skip
        yield Section("Boundary", (), (), (table,))


def _cell(value: Any) -> Value:
    return value if isinstance(value, str | int | float) else str(value)


def _maps(
    results: Results, varied: Sequence[str], judged: bool, effects: Mapping[str, Any], link: Callable[[int], str]
) -> Iterator[Section]:
    if not judged or len(varied) < 2 or not len(results):
        return
    order = list(varied)
    if effects.get("pass"):
        rank = {one.factor: one.first for one in effects["pass"]}
        order.sort(key=lambda one: -rank.get(one, 0.0))
    pairs = list(itertools.combinations(order, 2))[:MOST_MAPS]
    pictures = tuple(figures.verdict_map(results, across, up, link) for across, up in pairs)
    yield Section("Pass and fail", (), pictures)


def _curves(results: Results, varied: Sequence[str], known: Sequence[str]) -> Iterator[Section]:
    if varied and known:
        pictures = [figures.curves(results, of, varied[:MOST_PANELS]) for of in known[:MOST_CURVES]]
        yield Section("Over each factor", (), tuple(pictures))


def _sensitivity(campaign: Campaign, effects: Mapping[str, Any]) -> Iterator[Section]:
    pictures: list[Picture] = [figures.sensitivity(found, of) for of, found in effects.items() if found]
    if not pictures:
        return
    if campaign.file.design.kind == "saltelli":
        text = "Sobol indices from Saltelli's design: first order, of a factor alone; total, with all interactions."
    else:
        text = (
            f"First-order Sobol indices by RBD-FAST, from at most {MOST_POINTS} points spread over the design."
            " Total ones need the design `saltelli`."
        )
    yield Section("Sensitivity", (text,), tuple(pictures))


def _expectations(results: Results) -> Iterator[Section]:
    if not results.expect:
        return
    rows = []
    for name, counts in results.expect.items():
        share = wilson(counts[True], counts[True] + counts[False])
        rows.append((name, counts[True], counts[False], 100 * share.low, 100 * share.high))
    columns = (
        Column("expectation", "expectation"), Column("held", "held", "d"), Column("failed", "failed", "d"),
        Column("low_percent", "held, 95 % from (%)", ".1f"), Column("high_percent", "to (%)", ".1f"),
    )  # fmt: skip
    yield Section("Expectations", (), (), (Table("expectations", "How often each held", columns, tuple(rows)),))


def _lists(campaign: Campaign, results: Results, link: Callable[[int], str]) -> Iterator[Section]:
    if not len(results):
        return
    broken = np.flatnonzero(results.verdict >= 2)[:MOST_ROWS]
    slow = np.argsort(-results.seconds, kind="stable")[:MOST_ROWS]
    failed = np.flatnonzero(results.verdict == 1)[:MOST_ROWS]
    tables = []
    for name, title, cases in (
        ("broken", "Cases that did not come to their end", broken),
        ("failed", "The first failed cases", failed),
        ("slowest", "Slowest cases", slow),
    ):
        if len(cases):
            tables.append(_table(results, name, title, cases.tolist(), link))
    flaky = _flakiest(results)
    if campaign.file.repeats > 1 and flaky:
        numbers, places = np.unique(results.number, return_index=True)
        first = {number: int(places[np.searchsorted(numbers, number)]) for number, _ in flaky}
        rows: list[tuple[Any, ...]] = [
            (
                Link(results.names[first[number]].decode()[:12], link(first[number])),
                *_values(results, first[number]),
                100 * share,
            )
            for number, share in flaky
        ]
        columns = (
            Column("case", "case"),
            *(Column(one, one) for one in results.factors),
            Column("passed_percent", "passed (%)", ".0f"),
        )
        tables.append(Table("flakiest", "Flakiest points: some repeats pass, some fail", columns, tuple(rows)))
    if tables:
        yield Section("Cases", (), (), tuple(tables))


def _flakiest(results: Results) -> list[tuple[int, float]]:
    known = ~np.isnan(results.passed)
    numbers, at = np.unique(results.number[known], return_inverse=True)
    share = np.bincount(at, weights=results.passed[known]) / np.bincount(at) if len(numbers) else np.zeros(0)
    order = np.argsort(np.abs(share - 0.5), kind="stable")[:MOST_ROWS]
    return [(int(numbers[one]), float(share[one])) for one in order if 0.0 < share[one] < 1.0]


def _values(results: Results, case: int) -> tuple[str, ...]:
    return tuple(shown_value(results, one, case) for one in results.factors)


def _table(results: Results, name: str, title: str, cases: Sequence[int], link: Callable[[int], str]) -> Table:
    rows: list[tuple[Any, ...]] = []
    for case in cases:
        full = results.names[case].decode()
        reported = results.reported.get(full, "").partition("\n")[0]
        reported = reported if len(reported) <= 120 else reported[:117] + "..."
        rows.append(
            (
                Link(full[:12], link(case)),
                *_values(results, case),
                VERDICTS[int(results.verdict[case])],
                float(results.seconds[case]),
                reported,
            )
        )
    columns = (
        Column("case", "case"), *(Column(one, one) for one in results.factors), Column("verdict", "verdict"),
        Column("seconds", "computing (s)", ".3f"), Column("why", "why"),
    )  # fmt: skip
    return Table(name, title, columns, tuple(rows))


def case_page(campaign: Campaign, store: Store, row: Row) -> Report:
    """What one case has shown, and how it is run again."""
    name = row["name"]
    columns = (Column("key", "key"), Column("value", "value", ".9g"))
    factors = Table(
        "factors",
        "Factors",
        columns,
        (("seed", row["seed"]), *((key, _cell(value)) for key, value in row["factors"].items())),
    )
    numbers = Table("quantities", "Quantities", columns, tuple(row["quantities"].items()))
    verdicts = Table(
        "expect",
        "Expectations",
        columns,
        tuple((key, "held" if held else "failed") for key, held in row["expect"].items()),
    )
    again = f"lidaremu campaign {campaign.path.name} --out {store.root.name} --case {name}"
    text = [f"`{again}` writes its scenario; `lidaremu test` runs it to sha256 `{row['sha256'] or '-'}`."]
    text += [f"Warning: {one}" for one in row["warnings"]]
    tables: tuple[Table, ...] = tuple(one for one in (factors, verdicts, numbers) if one.rows)
    folder = store.recording(name)
    if folder.is_dir():
        place = f"../recordings/{name[:2]}/{name}"
        cells: list[tuple[Value, ...]] = [("recording", Link("run.mcap", f"{place}/run.mcap"))]
        cells.append(("report of the run", Link("report.html", f"{place}/report.html")))
        tables = (
            *tables,
            Table(
                "recording",
                "Recording",
                columns,
                tuple(cells),
                "`lidaremu report` makes the report where it is not there yet.",
            ),
        )
    summary = (
        f"Campaign `{campaign.path.name}`, point {row['number']}, repeat {row['repeat']}.",
        *row["fault"].split("\n"),
    )
    tone = "good" if row["verdict"] == "passed" else "bad"
    facts = (Fact("verdict", row["verdict"], tone), Fact("computing", f"{row['seconds']:.3f} s"))
    return Report(
        "case",
        f"Case {name[:12]}",
        summary,
        (Section("What it was", tuple(text), (), tables),),
        f"lidaremu {row['version']}",
        (),
        facts,
    )
