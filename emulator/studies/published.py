"""Study `published`: what was printed, beside what the product computes.

Belongs here: the order of the chapters, the summary. Each chapter is in its own module.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial

from emulator.studies import braking, figures, further, points, ranges
from emulator.studies.braking import Driving
from emulator.studies.effort import Effort
from emulator.studies.report import Report, Section

NAME = "published"
TITLE = "Published figures and tables, recomputed"
TOLERANCE_PERCENT = 10.0
"Of every row of table 2."


def chapters(driving: Driving, effort: Effort) -> dict[str, Callable[[], Section]]:
    """Title for the progress bar -> what makes the chapter."""
    return {
        "table 2": partial(ranges.table_2, effort),
        "figure 3": partial(figures.figure_3, effort),
        "figure 4": partial(figures.figure_4, effort),
        "figure 5": partial(figures.figure_5, effort),
        "figure 6": partial(points.figure_6, effort),
        "application": partial(braking.application, driving, effort),
        "further values": partial(further.values, effort),
    }


def run(driving: Driving, effort: Effort, steps: Callable[[list[str]], Iterator[str]] = iter) -> Report:
    """The whole report; `steps` yields the names of the chapters as they begin, for a progress bar."""
    made = chapters(driving, effort)
    sections = tuple(made[name]() for name in steps(list(made)))
    report = Report(NAME, TITLE, (), sections)
    worst = worst_of_table_2(report)
    return Report(
        NAME,
        TITLE,
        (
            'The base paper is Hadj-Bachir and de Souza 2019, "LIDAR sensor simulation in adverse weather '
            'condition for driving assistance development" (hal-01998668). Every number here is made twice where '
            "that is possible: by a closed form, and through the path that an emulated sensor takes (scenario, "
            "mesh, ray caster, sub-beams, receiver).",
            f"Table 2: all seven rows with one receiver, largest deviation {worst:.1f} %; six adjustable "
            "numbers stand behind them, see there. Further values, of other sources: each with its deviation, what it "
            "proves, and a verdict.",
            "Could not be had: the curves of figures 3 to 6, and the experiment behind figure 6 (Garcia et al. 2009).",
        ),
        sections,
    )


def worst_of_table_2(report: Report) -> float:
    """Largest deviation of a measured row from its print. [%]"""
    return max(abs(value) for value in report.table("table_2").numbers("measured_off_percent"))


def agreed(report: Report) -> tuple[int, int]:
    """How many of the further values agree with their print, and of how many."""
    verdicts = report.table("further_values").column("verdict")
    return sum(one == "agrees" for one in verdicts), len(verdicts)
