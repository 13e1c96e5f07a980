"""Chapters of a run's report that compare with the truth: ranges, detection, objects.

Belongs here: tables, words and figures of one sensor. Not: the other chapters (page), counting (errors, gather).
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import numpy as np

from emulator.objects.metrics import DISTANCE_BINS_M, Score
from emulator.run_report import figures
from emulator.run_report.errors import BIN_M, CURVE_M, HALF_BINS, Errors, RangeTally, known
from emulator.run_report.gather import SensorTally
from emulator.studies.report import Column, Picture, Section, Table, Value, rows_of

MOST_PANELS = 12
"Actors with a histogram of their own: those with the most echoes."


def _actors(tally: RangeTally) -> list[int]:
    """Those that a beam met, the one with the most echoes first."""
    return sorted(tally.aimed, key=lambda number: -tally.by_actor[number].count if number in tally.by_actor else 0)


def ranges(one: SensorTally) -> Iterator[Section]:
    if one.truth is None or not one.truth.tally.sweeps:
        return
    tally = one.truth.tally
    actors = _actors(tally)
    if not actors:
        yield Section(f"{one.sensor}: ranges", (f"{tally.sweeps} sweeps; no beam's axis met anything.",))
        return
    measured = [number for number in actors if tally.by_actor[number].count]
    rows = [
        (tally.actors[number], *_aimed_row(tally, number), *_error_row(tally.by_actor[number])) for number in actors
    ]
    classes = [
        (
            tally.actors[number], known(float(DISTANCE_BINS_M[index])), *_aimed_row(tally, number, index),
            *_error_row(tally.by_class[number, index]),
        )
        for number in actors
        for index in range(len(DISTANCE_BINS_M))
        if (number, index) in tally.by_class
    ]  # fmt: skip
    aimed = (
        Column("beams", "Beams", "d"),
        Column("seen", "Seen", "d"),
        Column("other", "Other thing", "d"),
        Column("air", "Weather, noise", "d"),
        Column("missed", "No echo", "d"),
    )
    error = (
        Column("mean_mm", "Mean [mm]", ".2f"),
        Column("sigma_mm", "Sigma [mm]", ".2f"),
        Column("rms_mm", "Rms [mm]", ".2f"),
        Column("median_mm", "Median [mm]", ".0f"),
        Column("least_mm", "Least [mm]", ".1f"),
        Column("most_mm", "Most [mm]", ".1f"),
    )
    pictures = []
    if measured:
        name = stem(one.sensor)
        shown = min(len(measured), figures.MOST_CURVES)
        pictures = [
            Picture(
                f"{name}_errors",
                "Range errors",
                figures.error_histograms([(tally.actors[one], tally.by_actor[one]) for one in measured[:MOST_PANELS]]),
                "Measured minus true range, by actor; dashed: the mean.",
            ),
            Picture(
                f"{name}_errors_in_classes",
                "Range errors in classes of distance",
                figures.error_histograms([(_up_to(index), errors) for index, errors in tally.by_distance().items()]),
                "The same of all actors together, in classes of distance.",
            ),
            Picture(
                f"{name}_errors_by_distance",
                "Range errors by distance",
                figures.errors_by_distance(tally, measured),
                f"Median and the middle 68 % in each class of distance; the {shown} actors with the most echoes.",
            ),
        ]
    yield Section(
        f"{one.sensor}: ranges against truth",
        (
            "True ranges are computed for this report: the axis of each beam, without width, is cast into the recorded"
            " scene at the beam's own instant; the first surface counts, panes too. An error is the range of the first"
            " echo of the same actor minus that. A beam has a width: where it meets an edge or a slanted surface the"
            " error holds what lies beside its axis.",
            f"{tally.sweeps} sweeps; {tally.beside} echoes of beams whose axis meets nothing.",
        ),
        tuple(pictures),
        (
            Table(f"{stem(one.sensor)}_ranges", "By actor", (Column("actor", "Actor"), *aimed, *error), rows_of(rows)),
            Table(
                f"{stem(one.sensor)}_ranges_by_distance",
                "By actor and distance",
                (Column("actor", "Actor"), Column("up_to_m", "Up to [m]", "g"), *aimed, *error),
                rows_of(classes),
                "No number under `up to`: beyond the last class.",
            ),
        ),
        (_histograms(one.sensor, tally),),
    )
    yield _detection(one.sensor, tally, actors)


def _up_to(index: int) -> str:
    low, high = (0.0, *DISTANCE_BINS_M)[index], DISTANCE_BINS_M[index]
    return f"{low:g} to {high:g} m" if math.isfinite(high) else f"beyond {low:g} m"


def _histograms(sensor: str, tally: RangeTally) -> Table:
    """Counts of the histograms, as a file."""
    columns = (
        Column("actor", "Actor"),
        Column("up_to_m", "Up to [m]", "g"),
        Column("error_from_mm", "Error from [mm]", "g"),
        Column("error_to_mm", "to [mm]", "g"),
        Column("count", "Count", "d"),
    )
    last = 2 * HALF_BINS + 1
    rows: list[tuple[Value, ...]] = [
        (
            tally.actors[number],
            known(float(DISTANCE_BINS_M[index])),
            None if place == 0 else round(1e3 * BIN_M * (place - 1 - HALF_BINS), 3),
            None if place == last else round(1e3 * BIN_M * (place - HALF_BINS), 3),
            int(errors.bins[place]),
        )
        for (number, index), errors in sorted(tally.by_class.items())
        for place in np.flatnonzero(errors.bins).tolist()
    ]
    return Table(f"{stem(sensor)}_error_histograms", "Histograms of errors", columns, tuple(rows))


def _aimed_row(tally: RangeTally, number: int, index: int | None = None) -> tuple[Value, ...]:
    aimed = tally.aimed[number] if index is None else tally.aimed_by_class[number, index]
    return aimed.beams, aimed.seen, aimed.other, aimed.air, aimed.missed


def _error_row(errors: Errors) -> tuple[Value, ...]:
    values = errors.mean_m, errors.sigma_m, errors.rms_m, errors.percentile_m(0.5), errors.least_m, errors.most_m
    return tuple(known(1e3 * value) for value in values)


def _detection(sensor: str, tally: RangeTally, actors: Sequence[int]) -> Section:
    shown = [number for number in actors if number != 0 and number in tally.could] or [
        number for number in actors if number in tally.could
    ]
    rows: list[tuple[Value, ...]] = []
    for number in (number for number in actors if number in tally.could):
        could, did = tally.could[number], tally.did[number]
        half = [index for index in np.flatnonzero(could) if did[index] >= 0.5 * could[index]]
        rows.append(
            (
                tally.actors[number],
                int(could.sum()),
                int(did.sum()),
                known(float(did.sum() / max(1, could.sum()))),
                known(tally.farthest_m.get(number, math.nan)),
                known(tally.farthest_at_s.get(number, math.nan)),
                CURVE_M * (max(half) + 1.0) if half else None,
            )
        )
    curve = [
        (tally.actors[number], CURVE_M * (index + 1.0), int(tally.could[number][index]), int(tally.did[number][index]))
        for number in actors
        if number in tally.could
        for index in np.flatnonzero(tally.could[number]).tolist()
    ]
    picture = Picture(
        f"{stem(sensor)}_detection",
        "Detection against distance",
        figures.detection(tally, shown),
        f"Of the sweeps in which a beam's axis met the actor, those with an echo of it; classes of {CURVE_M:g} m.",
    )
    return Section(
        f"{sensor}: detection range",
        ("`world` is everything that never moves.",),
        (picture,),
        (
            Table(
                f"{stem(sensor)}_detection",
                "Farthest echo and share of sweeps",
                (
                    Column("actor", "Actor"),
                    Column("sweeps_met", "Sweeps that met it", "d"),
                    Column("sweeps_seen", "with an echo", "d"),
                    Column("share", "Share", ".3f"),
                    Column("farthest_m", "Farthest echo [m]", ".2f"),
                    Column("farthest_at_s", "at [s]", ".2f"),
                    Column("half_m", "Half of the sweeps up to [m]", "g"),
                ),
                rows_of(rows),
            ),
            Table(
                f"{stem(sensor)}_detection_by_distance",
                "By distance",
                (
                    Column("actor", "Actor"),
                    Column("up_to_m", "Up to [m]", "g"),
                    Column("sweeps_met", "Sweeps that met it", "d"),
                    Column("sweeps_seen", "with an echo", "d"),
                ),
                rows_of(curve),
            ),
        ),
    )


def stem(sensor: str) -> str:
    """A sensor's name as part of a file's."""
    return "".join(letter if letter.isalnum() or letter in "-_" else "_" for letter in sensor)


def objects(one: SensorTally) -> Iterator[Section]:
    tally = one.objects
    if tally is None:
        return
    score = tally.score
    if not score.lists:
        yield Section(f"{one.sensor}: objects", (f"{tally.lists} lists, all empty, nothing to be seen.",))
        return
    rows = [("all", None, *_score_row(score.total))]
    rows += [(actor, None, *_score_row(row)) for actor, row in score.by_actor.items()]
    rows += [("all", known(end), *_score_row(row)) for end, row in score.by_distance_m.items()]
    rows += [(actor, known(end), *_score_row(row)) for (actor, end), row in score.by_actor_and_distance_m.items()]
    columns = (
        Column("actor", "Actor"),
        Column("up_to_m", "Up to [m]", "g"),
        Column("precision", "Precision", ".4f"),
        Column("recall", "Recall", ".4f"),
        Column("position_m", "Place [m]", ".3f"),
        Column("size_m", "Size [m]", ".3f"),
        Column("speed_m_s", "Speed [m/s]", ".3f"),
        Column("seen", "Seen", "d"),
        Column("false", "False", "d"),
        Column("missed", "Missed", "d"),
    )
    yield Section(
        f"{one.sensor}: objects against truth",
        (
            f"{score.lists} lists. An actor counts as missed when at least a tenth of the beams towards it reach it and"
            " it is not listed; an object is false when it is no actor's, or too far from its own.",
        ),
        (
            Picture(
                f"{stem(one.sensor)}_objects",
                "Objects over time",
                figures.objects(tally),
                "Above: distance of the objects' centres from the truth. Below: listed, missed, false.",
            ),
        ),
        (Table(f"{stem(one.sensor)}_objects", "Precision, recall, errors", columns, rows_of(rows)),),
    )


def _score_row(score: Score) -> tuple[Value, ...]:
    numbers = score.precision, score.recall, score.position_m, score.size_m, score.speed_m_s
    return *(known(value) for value in numbers), score.seen, score.false, score.missed
