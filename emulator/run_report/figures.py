"""The figures of a run's report, each as a PNG.

Belongs here: what is drawn. Not: numbers (gather, errors, weather), words (page).
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from emulator.objects.metrics import DISTANCE_BINS_M
from emulator.run_report.errors import BIN_M, CURVE_BINS, CURVE_M, HALF_BINS, Errors, RangeTally
from emulator.run_report.gather import Gathered, Happening, LinkTally, ObjectTally, SensorTally
from emulator.run_report.weather import QUANTITIES, Step
from emulator.studies.drawing import COLOURS, figure, png, word
from protocols.scan import Floats

MOST_CURVES = 7
OFTEN = 10
"Sweeps that met an actor, below which its share says little."
LINEAR_MM = 100.0
"Errors up to it have a linear scale."
LEAST_LATE_MS = 1e-3
"Lateness below it is drawn as this: the scale is logarithmic."
SLOTS = 240
"Points of a curve over time."


def rates(sensors: Sequence[SensorTally], duration_s: float) -> bytes:
    """Scans per second over time."""
    made, (axes,) = figure(size=(9.0, 3.6))
    slot_s = max(1.0, duration_s / SLOTS)
    edges = np.arange(0.0, duration_s + slot_s, slot_s)
    for number, one in enumerate(sensors):
        sent = np.array(one.sent_ns, dtype=np.int64) * 1e-9
        counts, _ = np.histogram(sent, edges)
        share = np.minimum(edges[1:], max(duration_s, 1e-9)) - edges[:-1]
        whole = share > 0.5 * slot_s
        axes.stairs(
            (counts / np.maximum(share, 1e-9))[whole], edges[: int(whole.sum()) + 1],
            color=COLOURS[number % len(COLOURS)], label=one.sensor, linewidth=1.5, baseline=None,
        )  # fmt: skip
    axes.set_xlabel("time [s]")
    axes.set_ylabel(f"scans per second, over {slot_s:g} s")
    axes.set_ylim(bottom=0.0)
    axes.legend(frameon=False, ncols=4)
    return png(made)


def gaps(sensors: Sequence[SensorTally]) -> bytes:
    """Histogram of the time from scan to scan, a panel a sensor."""
    made, panels = figure(1, len(sensors), size=(9.0, 2.7 * len(sensors) + 0.4))
    for number, (axes, one) in enumerate(zip(panels, sensors, strict=True)):
        gap_ms = 1e3 * one.gaps_s
        middle = float(np.median(gap_ms))
        spread = max(float(np.percentile(np.abs(gap_ms - middle), 99.0)), 0.02 * middle, 1e-3)
        low, high = max(0.0, middle - 1.5 * spread), middle + 1.5 * spread
        beyond = int(np.count_nonzero((gap_ms < low) | (gap_ms > high)))
        axes.hist(
            gap_ms[(gap_ms >= low) & (gap_ms <= high)], 80, range=(low, high), color=COLOURS[number % len(COLOURS)]
        )
        axes.set_yscale("log")
        axes.set_ylim(bottom=0.7)
        axes.set_title(f"{one.sensor}: median {middle:.3f} ms" + (f"; {beyond} beyond" if beyond else ""), fontsize=10)
        axes.set_ylabel("gaps")
        axes.set_xlabel("from scan to scan [ms]")
    return png(made)


def echoes(one: SensorTally) -> bytes:
    """Beams with an echo over time: of each sweep, or means of as many as make a curve."""
    made, (axes,) = figure(size=(9.0, 3.0))
    t_s = np.array(one.sweep_ns, dtype=np.int64) * 1e-9
    points = np.array(one.points, dtype=np.float64)
    whole = len(t_s) // (10 * SLOTS) + 1
    length = len(t_s) // whole * whole
    shown = points[:length].reshape(-1, whole)
    axes.plot(t_s[:length:whole], shown.mean(axis=1), color=COLOURS[0], linewidth=1.2)
    if whole > 1:
        axes.fill_between(t_s[:length:whole], shown.min(axis=1), shown.max(axis=1), color=COLOURS[0], alpha=0.2)
    axes.set_ylim(bottom=0.0)
    axes.set_xlabel("time [s]")
    axes.set_ylabel("beams with an echo")
    return png(made)


def lateness(sensors: Sequence[SensorTally]) -> bytes:
    """How late sends were, as shares of all."""
    made, (axes,) = figure(size=(9.0, 3.4))
    for number, one in enumerate(sensors):
        rows = one.end["lateness_us"]["histogram"]
        edges = [float(edge) if edge else 2e6 for edge, _ in rows]
        counts = np.array([count for _, count in rows], dtype=np.float64)
        later = 100.0 * (1.0 - np.cumsum(counts) / counts.sum())
        later[later < 1e-6] = np.nan  # none: not on a logarithmic scale
        axes.plot(edges, later, "o-", color=COLOURS[number % len(COLOURS)], label=one.sensor, markersize=4)
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.set_xlabel("lateness [µs]")
    axes.set_ylabel("sends later than that [%]")
    axes.legend(frameon=False)
    return png(made)


def lateness_over_time(links: Sequence[tuple[str, LinkTally]], duration_s: float) -> bytes:
    """Median and worst lateness in each piece of the run, a panel a link."""
    made, panels = figure(1, len(links), size=(9.0, 2.4 * len(links) + 0.4))
    slot_s = max(0.1, duration_s / SLOTS)
    edges = np.arange(0.0, duration_s + 2.0 * slot_s, slot_s)
    for number, (axes, (name, link)) in enumerate(zip(panels, links, strict=True)):
        due_s = np.array(link.due_ns, dtype=np.int64) * 1e-9
        late_ms = np.maximum(np.array(link.late_ns, dtype=np.int64) * 1e-6, LEAST_LATE_MS)
        slots = np.clip(np.searchsorted(edges, due_s, "right") - 1, 0, len(edges) - 2)
        order = np.lexsort((late_ms, slots))
        slots, late_ms = slots[order], late_ms[order]
        firsts = np.flatnonzero(np.diff(slots, prepend=-1))
        counts = np.diff(np.append(firsts, len(slots)))
        middle_s = edges[slots[firsts]] + 0.5 * slot_s
        colour = COLOURS[number % len(COLOURS)]
        axes.vlines(middle_s, late_ms[firsts], late_ms[firsts + counts - 1], color=colour, alpha=0.3, linewidth=2.0)
        axes.plot(middle_s, late_ms[firsts + counts // 2], ".", color=colour, markersize=5, label="median")
        axes.plot(middle_s, late_ms[firsts + counts - 1], "_", color=colour, markersize=6, label="worst")
        axes.set_yscale("log")
        axes.set_xlim(0.0, max(duration_s, slot_s))
        axes.set_title(name, fontsize=10)
        axes.set_ylabel("lateness [ms]")
        axes.legend(frameon=False, ncols=2, fontsize=9)
    panels[-1].set_xlabel(f"time [s], in pieces of {slot_s:g} s")
    return png(made)


def error_histograms(shown: Sequence[tuple[str, Errors]]) -> bytes:
    """Errors of ranges, a panel a name."""
    columns = 2 if len(shown) > 1 else 1
    rows = math.ceil(len(shown) / columns)
    made, panels = figure(columns, rows, size=(9.0, 2.7 * rows + 0.3))
    centres = (np.arange(2 * HALF_BINS) - HALF_BINS + 0.5) * BIN_M
    for number, axes in enumerate(panels):
        if number >= len(shown):
            axes.set_visible(False)
            continue
        name, errors = shown[number]
        inner = errors.bins[1:-1]
        reach = _reach(errors.percentile_m(0.005), errors.percentile_m(0.995))
        merge = max(1, int(reach / BIN_M / 40.0))
        length = len(inner) // merge * merge
        middle = centres[:length].reshape(-1, merge).mean(axis=1)
        within = np.abs(middle) < reach + BIN_M * merge  # a bar takes long to draw, also where it is not seen
        axes.bar(
            1e3 * middle[within],
            inner[:length].reshape(-1, merge).sum(axis=1)[within],
            width=1e3 * BIN_M * merge,
            color=COLOURS[number % len(COLOURS)],
        )
        axes.set_xlim(-1e3 * reach, 1e3 * reach)
        axes.axvline(1e3 * errors.mean_m, color="#1b1f24", linewidth=1.0, linestyle=(0, (4, 3)))
        beyond = errors.count - int(inner[np.abs(centres) <= reach].sum())
        reported = f"; {beyond} beyond" if beyond else ""
        axes.set_title(f"{name}: {errors.count} echoes{reported}", fontsize=10)
        axes.set_xlabel("measured minus true range [mm]")
    return png(made)


def _reach(low_m: float, high_m: float) -> float:
    """Half width of a histogram that holds almost all, a round number of millimetres."""
    wanted = max(abs(low_m), abs(high_m), 0.01) * 1.2
    decade = 10.0 ** math.floor(math.log10(wanted))
    return min(
        1.0, next(factor * decade for factor in (1.0, 1.5, 2.0, 3.0, 5.0, 7.5, 10.0) if factor * decade >= wanted)
    )


def errors_by_distance(tally: RangeTally, actors: Sequence[int]) -> bytes:
    """Median and spread of the errors against distance; errors of a metre or more count as a metre."""
    from matplotlib.ticker import ScalarFormatter

    made, (axes,) = figure(size=(9.0, 3.8))
    ends = np.array([*DISTANCE_BINS_M[:-1], 250.0])
    middles = 0.5 * (ends + np.concatenate([[0.0], ends[:-1]]))
    shown = list(actors)[:MOST_CURVES]
    for number, actor in enumerate(shown):
        rows = [(index, tally.by_class[actor, index]) for index in range(len(ends)) if (actor, index) in tally.by_class]
        rows = [(index, errors) for index, errors in rows if errors.count > 1]
        shift = 1.0 + 0.02 * (number - 0.5 * len(shown))
        low, middle, high = (
            np.array([1e3 * errors.percentile_m(share) for _, errors in rows]) for share in (0.16, 0.5, 0.84)
        )
        axes.errorbar(
            [middles[index] * shift for index, _ in rows],
            middle,
            [middle - low, high - middle],
            fmt="o",
            markersize=4.5,
            capsize=3,
            color=COLOURS[number % len(COLOURS)],
            label=tally.actors[actor],
        )
    if max(map(abs, axes.get_ylim())) > 2.0 * LINEAR_MM:
        axes.set_yscale("symlog", linthresh=LINEAR_MM)
        axes.yaxis.set_major_formatter(ScalarFormatter())
    axes.set_xscale("log")
    axes.set_xticks(ends, [f"{end:g}" for end in ends])
    axes.minorticks_off()
    axes.set_xlabel("true range [m], middles of the classes between the ticks")
    axes.set_ylabel("error: median, 16 and 84 % [mm]")
    axes.legend(frameon=False, fontsize=9, loc="center left", bbox_to_anchor=(1.01, 0.5))
    return png(made)


def least_seen(tally: RangeTally, actors: Sequence[int]) -> list[int]:
    """Those of which a picture says most: met often enough, and seen in the smallest share of the sweeps."""
    if len(actors) <= MOST_CURVES:
        return list(actors)
    often = [one for one in actors if tally.could[one].sum() >= OFTEN]
    share = {one: tally.did[one].sum() / tally.could[one].sum() for one in often}
    return sorted(often, key=lambda one: float(share[one]))[:MOST_CURVES]


def detection(tally: RangeTally, actors: Sequence[int]) -> bytes:
    """Share of the sweeps with an echo, against distance; of many actors those that are seen least."""
    made, (axes,) = figure(size=(9.0, 3.8))
    middles = (np.arange(CURVE_BINS) + 0.5) * CURVE_M
    farthest = CURVE_M
    shown = least_seen(tally, actors)
    if len(shown) < len(actors):
        axes.set_title(f"the {len(shown)} of {len(actors)} actors that are seen in the smallest share", fontsize=9)
    for number, actor in enumerate(shown):
        could, did = tally.could[actor], tally.did[actor]
        held = could > 0
        farthest = max(farthest, float(middles[held].max(initial=0.0)) + 0.5 * CURVE_M)
        axes.plot(
            middles[held], 100.0 * did[held] / could[held], "o-", markersize=4, linewidth=1.3,
            color=COLOURS[number % len(COLOURS)], label=tally.actors[actor],
        )  # fmt: skip
    axes.set_xlim(0.0, farthest)
    axes.set_ylim(-3.0, 103.0)
    axes.set_xlabel("distance of the nearest point that a beam's axis meets [m]")
    axes.set_ylabel("sweeps with an echo of it [%]")
    axes.legend(frameon=False, fontsize=9, loc="center left", bbox_to_anchor=(1.01, 0.5))
    return png(made)


def objects(tally: ObjectTally) -> bytes:
    """Position error over time; what is listed, false and missed beneath."""
    made, (above, below) = figure(1, 2, size=(9.0, 5.2))
    t_s = np.array(tally.at_ns, dtype=np.int64) * 1e-9
    above.plot(t_s, np.array(tally.error_m), ".", markersize=4, color=COLOURS[0])
    above.set_ylabel("position error [m], rms of a list")
    above.set_ylim(bottom=0.0)
    for number, (name, counts) in enumerate(
        (("listed", tally.listed), ("missed", tally.missed), ("false", tally.false))
    ):
        below.step(t_s, np.array(counts), where="post", color=COLOURS[number], label=name, linewidth=1.4)
    for axes in (above, below):
        axes.set_xlim(0.0, float(t_s[-1]) * 1.01)
    below.set_ylabel("objects")
    below.set_xlabel("time [s]")
    below.legend(frameon=False, ncols=3)
    return png(made)


def weather(steps: Sequence[Step], end_s: float) -> bytes:
    """Each quantity over time, a panel each."""
    from matplotlib.ticker import LogLocator, NullFormatter, StrMethodFormatter

    heads = [row for row in QUANTITIES.values() if any(step.values[row[0]] is not None for step in steps)]
    made, panels = figure(1, len(heads), size=(9.0, 1.7 * len(heads) + 0.6))
    times = [*(step.t_s for step in steps), max(end_s, steps[-1].t_s)]
    for number, (axes, (head, _, words)) in enumerate(zip(panels, heads, strict=True)):
        values = [step.values[head] for step in steps]
        known = np.array([math.nan if value is None else value for value in [*values, values[-1]]], dtype=np.float64)
        axes.step(times, known, where="post", color=COLOURS[number % len(COLOURS)], linewidth=1.8)
        axes.set_ylabel(words, fontsize=8.5)
        axes.set_xlim(0.0, times[-1] or 1.0)
        axes.set_ylim(bottom=0.0)
        if "visibility" in head and np.nanmin(known) > 0.0:
            axes.set_yscale("log")
            axes.set_ylim(0.7 * np.nanmin(known), 1.5 * np.nanmax(known))
            axes.yaxis.set_major_locator(LogLocator(10.0, (1.0, 2.0, 5.0)))
            axes.yaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
            axes.yaxis.set_minor_formatter(NullFormatter())
    panels[-1].set_xlabel("time [s]")
    return png(made)


KINDS = ("fault", "order", "event", "restart", "mode")
MARKS = {"fault": "X", "order": "D", "event": "o", "restart": "^", "mode": "|"}


def time_line(run: Gathered, happenings: Sequence[Happening]) -> bytes:
    """What happened when, a row for each sensor and kind."""
    rows = sorted({(one.sensor != "run", one.sensor, KINDS.index(one.kind)) for one in happenings})
    made, (axes,) = figure(size=(9.0, 0.32 * len(rows) + 1.2))
    for height, (_, sensor, kind) in enumerate(rows):
        times = _times([one for one in happenings if (one.sensor, one.kind) == (sensor, KINDS[kind])])
        mark = MARKS[KINDS[kind]]
        axes.plot(times, np.full(len(times), height), mark, color=COLOURS[kind], markersize=8, linestyle="none")
        if KINDS[kind] == "fault":
            for begun, ended in fault_spans(happenings, sensor, run.duration_s):
                axes.plot([begun, ended], [height, height], color=COLOURS[kind], linewidth=5, alpha=0.35)
    axes.set_yticks(range(len(rows)), [word(f"{sensor}: {KINDS[kind]}s") for _, sensor, kind in rows])
    axes.set_ylim(len(rows) - 0.4, -0.6)
    axes.set_xlim(-0.02 * run.duration_s, 1.02 * run.duration_s)
    axes.set_xlabel("time [s]")
    return png(made)


def _times(happenings: Sequence[Happening]) -> Floats:
    return np.array([one.at_ns for one in happenings], dtype=np.float64) * 1e-9


def fault_spans(happenings: Sequence[Happening], sensor: str, end_s: float) -> list[tuple[float, float]]:
    """When faults began and ended; one that did not end lasts to the end."""
    begun: dict[object, float] = {}
    spans = []
    for one in happenings:
        if one.kind == "fault" and one.sensor == sensor:
            number = one.row.get("number")
            if one.row.get("what") == "begin":
                begun[number] = one.at_ns * 1e-9
            elif one.row.get("what") == "end" and number in begun:
                spans.append((begun.pop(number), one.at_ns * 1e-9))
    return spans + [(start, end_s) for start in begun.values()]
