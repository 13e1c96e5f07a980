"""`lidaremu report`: one page about a recording."""

from __future__ import annotations

import json
from pathlib import Path

import click

from emulator.commands.common import OK, bar, part_of
from emulator.errors import EmulatorError
from emulator.output.lines import say


@click.command()
@click.argument("recording", metavar="RUN", type=click.Path(path_type=Path))
@click.option("--out", type=click.Path(dir_okay=False, path_type=Path), metavar="FILE", help="Output page [RUN.html].")
@click.option(
    "--figures", type=click.Path(file_okay=False, path_type=Path), metavar="DIR", help="Also write PNG and CSV files."
)
@click.option(
    "--no-truth", is_flag=True, help="Omit the comparison of ranges with the truth, which takes the most time."
)
@click.option("--json", "as_json", is_flag=True, help="Print the figures as one JSON object on standard output.")
def report(recording: Path, out: Path | None, figures: Path | None, no_truth: bool, as_json: bool) -> int:
    """One HTML page about the recording RUN, a folder or its run.mcap: rates, drops, ranges against truth, detection,
    objects, weather, faults. It needs nothing else: figures are inside.
    """
    from emulator.studies import report as form

    form.need_extra()
    whole = recording.resolve()
    page = out or Path(f"{whole.parent.name if whole.name == 'run.mcap' else whole.name}.html")
    if page.is_dir() or not page.absolute().parent.is_dir():
        raise EmulatorError(f"--out: {page}; want a file in an existing folder")
    if figures is not None:
        form.prepare(figures)
    from emulator.run_report.gather import gather
    from emulator.run_report.page import report_of
    from emulator.run_report.summary import summary_of

    with bar(recording.name) as tell:
        reading = part_of(tell, 0, 2)
        run = gather(recording, not no_truth, lambda at: reading(at.done / at.total if at.total else 0.0))
        made = report_of(run, part_of(tell, 1, 2))
    try:
        page.write_text(form.page(made), encoding="utf-8")
    except OSError as error:
        raise EmulatorError(f"{page}: cannot be written: {error.strerror}") from None
    written = [page, *([] if figures is None else form.write_parts(made, figures))]
    if as_json:
        say(json.dumps(summary_of(run) | {"files": [str(path) for path in written]}))
        return OK
    for line in made.summary:
        say(line)
    say(f"{page}: {len(made.sections)} chapters" + (f"; {len(written) - 1} files in {figures}" if figures else ""))
    return OK
