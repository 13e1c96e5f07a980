"""The page of a run's report: chapters, tables and words around what was gathered.

Belongs here: what is reported, and in which order. Not: counting (gather), drawing (figures), HTML (studies.report).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import partial

import numpy as np

from emulator import __version__
from emulator.run_report import figures, sight
from emulator.run_report.against_truth import objects, ranges, stem
from emulator.run_report.errors import known
from emulator.run_report.expected import chapter
from emulator.run_report.gather import Gathered, SensorTally, late_us
from emulator.run_report.weather import QUANTITIES, Step, steps
from emulator.studies.report import Column, Fact, Picture, Report, Section, Table, Value, rows_of

MOST_ROWS = 300
"Rows of the time line on the page."


def report_of(run: Gathered, tell: Callable[[float], None] = lambda share: None) -> Report:
    """Everything as one report; `tell` gets the share that is drawn."""
    sensors = list(run.sensors.values())
    sending = [one for one in sensors if len(one.sent_ns) > 2]
    parts: list[Callable[[], Iterable[Section | None]]] = [
        lambda: [chapter(run)],
        lambda: [_overview(sensors)],
        lambda: [_rates(run, sending)],
        lambda: [_lateness_and_drops(sensors, run.duration_s)],
        *(partial(_echoes, one) for one in sensors if len(one.points)),
        *(partial(ranges, one) for one in sensors),
        *(partial(objects, one) for one in sensors if one.objects is not None),
        lambda: [_weather(run)],
        lambda: [_time_line(run)],
        lambda: [_commands(sensors)],
    ]
    sections: list[Section] = []
    for number, part in enumerate(parts):
        tell(number / len(parts))
        sections += [section for section in part() if section is not None]
    tell(1.0)
    title = f"Run {run.path.resolve().name}"
    return Report(
        "report", title, tuple(_summary(run)), tuple(sections), _closing(run), tuple(_lead(run)), tuple(_facts(run))
    )


def _lead(run: Gathered) -> Iterator[Picture]:
    """The scene with the sensors' points; nothing where it cannot be built again, or no beams are recorded."""
    if run.scene is None or run.scenario is None or not run.sight.shown:
        return
    if run.sight.lead in {one.id for one in run.scenario.sensors}:
        names = ", ".join(f"`{name}`" for name in run.sight.shown)
        reported = (
            f"The recorded scene at {run.sight.at_s:.3f} s with one sweep of {names}; the triangle is the first sensor."
        )
        yield Picture(
            "scene", "The scene with the sensors' points", sight.draw(run.sight, run.scene, run.scenario), reported
        )


def _facts(run: Gathered) -> Iterator[Fact]:
    """What is asked first."""
    rows = run.verdict.get("expect")
    if isinstance(rows, list) and rows:
        held = sum(isinstance(row, dict) and row.get("passed") is True for row in rows)
        yield Fact("expectations held", f"{held} of {len(rows)}", "good" if held == len(rows) else "bad")
    sensors = run.sensors.values()
    yield Fact("recorded", _seconds(run.duration_s))
    yield Fact("scans sent", f"{sum(len(one.sent_ns) for one in sensors)}")
    dropped = sum(sum(one.scans_dropped.values()) for one in sensors)
    yield Fact("scans dropped", f"{dropped}", "bad" if dropped else "")
    late = [np.array(link.late_ns, dtype=np.int64) for one in sensors for link in one.links.values() if link.late_ns]
    if late:
        yield Fact("lateness, 99 %", f"{float(np.percentile(np.concatenate(late), 99.0)) * 1e-6:.3g} ms")
    silent = [one.sensor for one in sensors if one.silent_s]
    if silent:
        yield Fact("silent at the end", ", ".join(silent), "bad")


def _closing(run: Gathered) -> str:
    return f"lidaremu {__version__}, report of {run.path.name}, recorded by version {run.version or 'unknown'}."


def _summary(run: Gathered) -> Iterator[str]:
    sent = sum(len(one.sent_ns) for one in run.sensors.values())
    yield (
        f"{_seconds(run.duration_s)} recorded, {len(run.sensors)} sensor{'s' * (len(run.sensors) != 1)},"
        f" {sent} scans sent; seed {run.scenario.seed if run.scenario else 'unknown'}."
    )
    dropped = sum(sum(one.scans_dropped.values()) for one in run.sensors.values())
    ignored = sum(sum(one.input_dropped.values()) for one in run.sensors.values())
    notes = len(run.orders)
    yield f"{dropped} scans dropped, {ignored} pieces of input not taken, {notes} orders and notes of the run."
    yield from run.remarks


def _seconds(value: float) -> str:
    if value < 120.0:
        return f"{value:.3f} s"
    minutes, rest = divmod(value, 60.0)
    hours, minutes = divmod(int(minutes), 60)
    return f"{hours} h {minutes} min {rest:.1f} s" if hours else f"{minutes} min {rest:.1f} s"


# ---------------------------------------------------------------- sending


def _overview(sensors: Sequence[SensorTally]) -> Section:
    columns = (
        Column("sensor", "Sensor"),
        Column("model", "Model"),
        Column("scans_sent", "Scans sent", "d"),
        Column("scans_measured", "Scans recorded", "d"),
        Column("scans_per_s", "Scans per second", ".3f"),
        Column("silent_s", "Silent at the end [s]", ".3f"),
        Column("scans_dropped", "Scans dropped", "d"),
        Column("input_dropped", "Input not taken", "d"),
        Column("restarts", "Restarts", "d"),
        Column("bytes_out", "Bytes out", "d"),
        Column("bytes_in", "Bytes in", "d"),
    )
    rows = [
        (
            one.sensor, one.model, len(one.sent_ns), one.measured, known(one.rate_hz), one.silent_s,
            sum(one.scans_dropped.values()), sum(one.input_dropped.values()), one.restarts,
            sum(link.bytes_out for link in one.links.values()), sum(link.bytes_in for link in one.links.values()),
        )
        for one in sensors
    ]  # fmt: skip
    links = Table(
        "links",
        "Links",
        (
            Column("sensor", "Sensor"),
            Column("link", "Link", "d"),
            Column("url", "As opened"),
            Column("kind", "Kind"),
            Column("payloads_out", "Payloads out", "d"),
            Column("replies", "Of these without a scan", "d"),
            Column("bytes_out", "Bytes out", "d"),
            Column("payloads_in", "Pieces in", "d"),
            Column("bytes_in", "Bytes in", "d"),
            Column("peers", "Peers or identifiers", "d"),
        ),
        rows_of(
            [
                (
                    one.sensor,
                    number,
                    link.url,
                    link.kind,
                    link.sent,
                    link.replies,
                    link.bytes_out,
                    link.received,
                    link.bytes_in,
                    len(link.peers),
                )
                for one in sensors
                for number, link in sorted(one.links.items())
            ]
        ),
        "On CAN each frame is a payload; the first frame of a list carries its scan.",
    )
    tables = (Table("overview", "Sensors", columns, rows_of(rows)), links)
    return Section("Sensors", tables=tables if links.rows else tables[:1])


def _rates(run: Gathered, sensors: Sequence[SensorTally]) -> Section | None:
    if not sensors:
        return Section("Rates and jitter", ("No sensor sent three scans or more.",))
    columns = (
        Column("sensor", "Sensor"),
        Column("gaps", "Gaps", "d"),
        Column("mean_ms", "Mean [ms]", ".4f"),
        Column("median_ms", "Median [ms]", ".4f"),
        Column("sigma_ms", "Sigma [ms]", ".4f"),
        Column("shortest_ms", "Shortest [ms]", ".4f"),
        Column("p1_ms", "1 % [ms]", ".4f"),
        Column("p99_ms", "99 % [ms]", ".4f"),
        Column("longest_ms", "Longest [ms]", ".4f"),
        Column("longest_at_s", "at [s]", ".3f"),
    )
    rows: list[tuple[Value, ...]] = []
    for one in sensors:
        gap_ms = 1e3 * one.gaps_s
        low, high = np.percentile(gap_ms, (1.0, 99.0))
        worst = int(gap_ms.argmax())
        rows.append(
            (
                one.sensor,
                len(gap_ms),
                float(gap_ms.mean()),
                float(np.median(gap_ms)),
                float(gap_ms.std()),
                float(gap_ms.min()),
                float(low),
                float(high),
                float(gap_ms[worst]),
                one.sent_ns[worst] * 1e-9,
            )
        )
    return Section(
        "Rates and jitter",
        (
            "Instants are those at which the first bit of a scan is due on the sensor's first link, to the nanosecond;"
            " how late scans left in a real-time run is shown under lateness.",
        ),
        (
            Picture("rates", "Scans per second over time", figures.rates(sensors, run.duration_s), "Rate over time."),
            Picture("gaps", "Histogram of gaps", figures.gaps(sensors), "Time from scan to scan; counts logarithmic."),
        ),
        (Table("gaps", "From scan to scan", columns, rows_of(rows)),),
    )


def _echoes(one: SensorTally) -> Iterator[Section]:
    points = np.array(one.points, dtype=np.float64)
    spread = f"{points.mean():.1f} on average, {points.min():.0f} to {points.max():.0f}"
    reported = f"{len(points)} sweeps; beams with an echo: {spread}."
    picture = Picture(f"{stem(one.sensor)}_echoes", "Beams with an echo", figures.echoes(one), "Over time.")
    yield Section(f"{one.sensor}: echoes", (reported,), (picture,))


def _lateness_and_drops(sensors: Sequence[SensorTally], duration_s: float) -> Section:
    reported = [one for one in sensors if one.end.get("lateness_us", {}).get("sends")]
    columns = (
        Column("sensor", "Sensor"),
        Column("sends", "Sends", "d"),
        Column("median_us", "Median [µs]", ".1f"),
        Column("p99_us", "99 % [µs]", ".1f"),
        Column("worst_us", "Worst [µs]", ".1f"),
    )
    late = [one.end["lateness_us"] for one in reported]
    rows = [
        (one.sensor, row["sends"], row["median"], row["p99"], row["worst"])
        for one, row in zip(reported, late, strict=True)
    ]
    drops = [
        (one.sensor, what, reason, count)
        for one in sensors
        for what, counts in (("scan", one.scans_dropped), ("input", one.input_dropped))
        for reason, count in sorted(counts.items(), key=lambda row: -row[1])
    ]
    details = [
        (one.sensor, reason, detail, count)
        for one in sensors
        for (reason, detail), count in one.drop_details.most_common(40)
        if detail
    ]
    tables = (
        [Table("lateness", "Lateness: actual minus due instant of each send", columns, rows_of(rows))] if rows else []
    )
    if drops:
        heads = (
            Column("sensor", "Sensor"),
            Column("what", "What"),
            Column("reason", "Reason"),
            Column("count", "Count", "d"),
        )
        tables.append(
            Table("drops", "Dropped", heads, rows_of(drops), "Input is counted in bytes or telegrams, as it came.")
        )
    if details:
        heads = (
            Column("sensor", "Sensor"),
            Column("reason", "Reason"),
            Column("detail", "Detail"),
            Column("count", "Count", "d"),
        )
        tables.append(Table("drop_details", "Of these, the most frequent", heads, rows_of(details)))
    links = [
        (f"{one.sensor}, link {number}", one.sensor, number, link)
        for one in sensors
        for number, link in sorted(one.links.items())
        if link.late_ns
    ]
    if links:
        link_heads = (Column("sensor", "Sensor"), Column("link", "Link", "d"), *columns[1:])
        reported_links = [(sensor, number, *late_us(link)) for _, sensor, number, link in links]
        words = (
            "From the recorded instants: when the last bit of a payload was due, and when it had left at the latest."
        )
        tables.insert(0, Table("lateness_by_link", "Lateness by link", link_heads, rows_of(reported_links), words))
    text = [] if rows or links else ["Lateness is not in this recording."]
    text += [] if drops else ["Nothing was dropped."]
    pictures: tuple[Picture, ...] = ()
    if any(one.end["lateness_us"]["worst"] for one in reported):
        picture = figures.lateness(reported)
        pictures = (
            Picture(
                "lateness",
                "Lateness",
                picture,
                "Share of sends that were later; in virtual time, the grouping of bytes alone.",
            ),
        )
    if links:
        picture = figures.lateness_over_time([(name, link) for name, _, _, link in links], duration_s)
        words = "Median and worst lateness over time; shaded from the least to the worst."
        pictures = (Picture("lateness_over_time", "Lateness over time", picture, words), *pictures)
    return Section("Lateness and drops", tuple(text), pictures, tuple(tables))


# ---------------------------------------------------------------- what happened


def _weather(run: Gathered) -> Section | None:
    if run.scenario is None:
        return None
    found = steps(run.scenario, run.orders, run.duration_s)
    if not any(value is not None for step in found for value in step.values.values()):
        return Section("Weather", ("Clear air and no sun all the time.",))
    sky = () if any(step.values["sun_w_m2"] for step in found) else ("No sun all the time.",)
    shown = [row for row in QUANTITIES.values() if any(step.values[row[0]] is not None for step in found)]
    columns = (
        Column("t_s", "From [s]", ".3f"),
        Column("by", "By"),
        *(Column(head, words, "g") for head, _, words in shown),
    )
    rows = [(step.t_s, _by(step), *(step.values[head] for head, _, _ in shown)) for step in found]
    return Section(
        "Weather",
        sky,
        pictures=(Picture("weather", "Weather over time", figures.weather(found, run.duration_s)),),
        tables=(Table("weather_steps", "Weather", columns, rows_of(rows)),),
    )


def _by(step: Step) -> str:
    return "order" if step.ordered else "scenario"


def _time_line(run: Gathered) -> Section:
    if not run.happenings:
        return Section("Faults, orders and restarts", ("Nothing happened.",))
    shown = sorted(run.happenings, key=lambda one: one.at_ns)
    rows = [(one.at_ns * 1e-9, one.sensor, one.kind, one.text) for one in shown]
    columns = (
        Column("t_s", "At [s]", ".6f"),
        Column("sensor", "Sensor"),
        Column("kind", "Kind"),
        Column("what", "What"),
    )
    tables = [Table("time_line", "In order of time", columns, rows_of(rows[:MOST_ROWS]))]
    faults = [
        (one.sensor, number, fault.name, _at_s(fault.begun_ns), _at_s(fault.ended_ns), fault.hits)
        for one in run.sensors.values()
        for number, fault in sorted(one.faults.items())
    ]
    if faults:
        heads = (
            Column("sensor", "Sensor"),
            Column("number", "Number", "d"),
            Column("fault", "Fault"),
            Column("begun_s", "Begun at [s]", ".3f"),
            Column("ended_s", "Ended at [s]", ".3f"),
            Column("hits", "Hits", "d"),
        )
        tables.insert(0, Table("faults", "Faults", heads, rows_of(faults[:MOST_ROWS]), "A hit: it changed something."))
    left = len(rows) - MOST_ROWS + run.happenings_left_out
    return Section(
        "Faults, orders and restarts",
        (f"{left} later ones are left out of the table.",) if left > 0 else (),
        (Picture("time_line", "Time line", figures.time_line(run, shown), "What happened when."),)
        if run.duration_s > 0.0
        else (),
        tuple(tables),
    )


def _at_s(at_ns: int | None) -> float | None:
    return None if at_ns is None else at_ns * 1e-9


def _commands(sensors: Sequence[SensorTally]) -> Section:
    rows = [
        (one.sensor, command, outcome, tally.count, tally.first_ns * 1e-9, tally.last_ns * 1e-9)
        for one in sensors
        for (command, outcome), tally in sorted(one.commands.items(), key=lambda row: row[1].first_ns)
    ]
    if not rows:
        return Section("Commands and replies", ("No host gave a command.",))
    columns = (
        Column("sensor", "Sensor"),
        Column("command", "Command"),
        Column("outcome", "Answered"),
        Column("count", "Times", "d"),
        Column("first_s", "First at [s]", ".3f"),
        Column("last_s", "Last at [s]", ".3f"),
    )
    replies = ", ".join(f"{one.sensor} {sum(link.replies for link in one.links.values())}" for one in sensors)
    return Section(
        "Commands and replies",
        (f"Payloads that carry no scan (on CAN: frames that do not begin one): {replies}.",),
        tables=(Table("commands", "Commands", columns, rows_of(rows[:MOST_ROWS])),),
    )
