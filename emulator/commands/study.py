"""`lidaremu study NAME`: the options of every study. The parts of a study are imported when it is asked for."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import click

from emulator.commands.common import FAILED, OK, Finite
from emulator.output.lines import note, say
from emulator.output.sanitizing import raw, visible
from emulator.process.clock import SystemClock

MOST_SPEEDS = 50


@click.group()
def study() -> None:
    """Recompute, compare and draw: writes a report (HTML, PNG, CSV)."""


out_option = click.option(
    "--out",
    required=True,
    type=click.Path(file_okay=False, path_type=Path),
    metavar="DIR",
    help="Folder of the report; created if missing.",
)
quick_option = click.option("--quick", is_flag=True, help="Fewer points and ranges; half a minute instead of minutes.")
json_option = click.option("--json", "as_json", is_flag=True, help="One JSON object on standard output.")


def progress(names: list[str]) -> Iterator[str]:
    """The names one by one: a bar on standard error, or where that is no terminal a line for each that is done."""
    from rich.console import Console
    from rich.markup import escape
    from rich.progress import MofNCompleteColumn, Progress, TimeElapsedColumn

    console, clock = Console(file=raw(sys.stderr)), SystemClock()
    with Progress(
        *Progress.get_default_columns()[:3], MofNCompleteColumn(), TimeElapsedColumn(),
        console=console, transient=True, disable=not console.is_terminal,
    ) as bar:  # fmt: skip
        task = bar.add_task("", total=len(names))
        for done, name in enumerate(names, start=1):
            bar.update(task, description=escape(visible(name)))
            begun_ns = clock.now_ns()
            yield name
            if not console.is_terminal:
                note(f"{name}: {1e-9 * (clock.now_ns() - begun_ns):.1f} s, {done} of {len(names)}")
            bar.advance(task)


if TYPE_CHECKING:
    SpeedsType = click.ParamType[tuple[float, ...]]
else:  # not generic before click 8.2
    SpeedsType = click.ParamType


class Speeds(SpeedsType):
    """Speeds by commas."""

    name = "speeds"

    def convert(
        self, value: str | tuple[float, ...], param: click.Parameter | None, ctx: click.Context | None
    ) -> tuple[float, ...]:
        """Numbers of `30,50,80`, rising."""
        if not isinstance(value, str):
            return value
        try:
            speeds = tuple(sorted({float(part) for part in value.split(",")}))
        except ValueError:
            speeds = ()
        if not speeds or len(speeds) > MOST_SPEEDS or not all(0.0 < speed <= 500.0 for speed in speeds):
            self.fail(f"{value!r}; want up to {MOST_SPEEDS} numbers over 0 and up to 500, by commas", param, ctx)
        return speeds


FRICTION = Finite(0.01, 2.0)


@study.command()
@out_option
@quick_option
@json_option
@click.option(
    "--speeds",
    type=Speeds(),
    default="30,40,50,60,70,80,90,100,110,120,130",
    show_default=True,
    metavar="KM_H,...",
    help="Speeds of the application.",
)
@click.option("--reaction-s", type=Finite(0.0, 10.0), default=1.0, show_default=True, help="Reaction time.")
@click.option("--friction-dry", type=FRICTION, default=0.75, show_default=True, help="On dry road, 0.7 to 0.8.")
@click.option("--friction-wet", type=FRICTION, default=0.40, show_default=True, help="On wet road, in rain.")
@click.option("--friction-snow", type=FRICTION, default=0.30, show_default=True, help="On snow.")
def published(
    out: Path,
    quick: bool,
    as_json: bool,
    speeds: tuple[float, ...],
    reaction_s: float,
    friction_dry: float,
    friction_wet: float,
    friction_snow: float,
) -> int:
    """Figures and tables of papers and data sheets, recomputed beside what was printed."""
    from emulator.studies import report
    from emulator.studies.effort import FULL, QUICK

    report.need_extra()
    report.prepare(out)
    from emulator.studies import published as whole
    from emulator.studies.braking import Driving

    clock = SystemClock()
    driving = Driving(speeds, reaction_s, friction_dry, friction_wet, friction_snow)
    made = whole.run(driving, QUICK if quick else FULL, progress)
    written = report.write(made, out)
    worst = whole.worst_of_table_2(made)
    held = worst <= whole.TOLERANCE_PERCENT
    if as_json:
        reported = {
            "study": "published",
            "held": held,
            "table_2_worst_percent": round(worst, 3),
            "seconds": round(1e-9 * clock.now_ns(), 1),
            "files": [str(path) for path in written],
        }
        say(json.dumps(reported))
    else:
        seconds, (agreed, values) = 1e-9 * clock.now_ns(), whole.agreed(made)
        say(
            f"{written[0]}: {len(written)} files in {seconds:.0f} s; table 2 within {worst:.1f} % in every row; "
            f"{agreed} of {values} other values agree, the reasons of the rest are on the page"
        )
    return OK if held else FAILED


@study.command()
@out_option
@click.option("--quick", is_flag=True, help="Fewer sub-beams and targets; under a minute instead of minutes.")
@json_option
def accuracy(out: Path, quick: bool, as_json: bool) -> int:
    """Error against run time and rays, for every rule and setting; what the defaults cost."""
    from emulator.studies import report

    report.need_extra()
    report.prepare(out)
    from emulator.studies import accuracy as whole

    clock = SystemClock()
    made = whole.run(whole.QUICK if quick else whole.FULL, progress)
    written = report.write(made, out)
    rows = made.table("accuracy_acceptance").rows
    missed = [str(row[0]) for row in rows if not row[3]]
    if as_json:
        reported = {
            "study": "accuracy",
            "held": not missed,
            "missed": missed,
            "seconds": round(1e-9 * clock.now_ns(), 1),
            "files": [str(path) for path in written],
        }
        say(json.dumps(reported))
    else:
        seconds = 1e-9 * clock.now_ns()
        met = f"{len(rows) - len(missed)} of {len(rows)} numbers met"
        say(f"{written[0]}: {len(written)} files in {seconds:.0f} s; {met}")
        for item in missed:
            say(f"missed: {item}")
        say(made.summary[1])
    return FAILED if missed else OK
