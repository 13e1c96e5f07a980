"""`lidaremu campaign`: many runs by a design, resumed, sharded, reported."""

from __future__ import annotations

import json
import re
import shlex
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from importlib import import_module
from pathlib import Path
from threading import Thread
from typing import TYPE_CHECKING, Any

import click

from emulator.commands.common import CANNOT_RUN, FAILED, OK, bar
from emulator.errors import EmulatorError
from emulator.output.lines import note, say

if TYPE_CHECKING:
    from emulator.campaigns.campaign import Campaign, Progress, Runner, Shard
    from emulator.campaigns.engines import Engine
    from emulator.campaigns.store import Store


@click.command()
@click.argument("file", type=click.Path(dir_okay=False, path_type=Path))
@click.option(
    "--out",
    type=click.Path(file_okay=False, path_type=Path),
    required=True,
    metavar="DIR",
    help="Folder of the campaign; what is done there is not run again.",
)
@click.option("--jobs", type=click.IntRange(min=1, max=4096), help="Number of processes (default: cores).")
@click.option("--points", type=click.IntRange(min=1), metavar="N", help="Replace the number of points of the design.")
@click.option(
    "--driver",
    metavar="COMMAND",
    help="Run this host against each case, on its own links, given in LIDAREMU_<SENSOR>, in virtual time.",
)
@click.option("--shard", metavar="I/N", help="Run only part I of N.")
@click.option("--resume", is_flag=True, help="Continue a campaign that was begun: an error where there is none.")
@click.option("--retry", is_flag=True, help="Run those again that ended in an error, crashed or hung.")
@click.option("--rerun", is_flag=True, help="Run all again in a folder that was begun with another version.")
@click.option("--status", is_flag=True, help="Only tell how far it is.")
@click.option("--case", metavar="NAME", help="Only write the scenario of this case into the folder.")
@click.option("--dask", metavar="ADDRESS", help="Run on the workers of this Dask scheduler.")
@click.option(
    "--slurm",
    type=click.IntRange(min=1, max=100_000),
    metavar="N",
    help="Only write a job script for an array of N tasks.",
)
@click.option("--report/--no-report", default=True, help="Write results and page at the end.")
@click.option(
    "--case-reports",
    type=click.IntRange(min=0),
    default=4,
    show_default=True,
    metavar="N",
    help="Number of recorded cases of which a whole report is made.",
)
@click.option(
    "--junitxml", type=click.Path(dir_okay=False, path_type=Path), metavar="FILE", help="Write a JUnit XML report."
)
@click.option("--json", "as_json", is_flag=True, help="Print the result as one JSON object.")
def campaign(
    file: Path,
    out: Path,
    jobs: int | None,
    points: int | None,
    driver: str | None,
    shard: str | None,
    resume: bool,
    retry: bool,
    rerun: bool,
    status: bool,
    case: str | None,
    dask: str | None,
    slurm: int | None,
    report: bool,
    case_reports: int,
    junitxml: Path | None,
    as_json: bool,
) -> int:
    """Run many cases of one scenario: factors and a design of FILE, in virtual time, each case once.

    Stopped or killed at any time, the same command does what is left.
    """
    from emulator.campaigns.forking import begun_early

    with begun_early(not (status or case or dask or slurm)):
        from emulator.campaigns.campaign import Runner, load, write_scenario
        from emulator.campaigns.store import Store

        part = _shard(shard)
        words = _words(driver)
        loaded = load(file, out, words, points)
        store = Store(out.absolute())
        if (resume or status or case) and store.manifest() is None:
            raise EmulatorError(f"--out: {out}: no campaign was begun here; want a folder that has one")
        if case is not None:
            say(str(write_scenario(loaded, store, _whole_name(store, case), out / f"case-{case[:12]}.yaml")))
            return OK
        if status:
            return _status(loaded, store, part, as_json)
        store.make()
        if slurm is not None:
            return _write_slurm(file, out, slurm, jobs or 1, words, points, loaded)
        if rerun:
            store.forget_version()
        if store.begin(loaded.job.version, str(file), loaded.job.digest) and not as_json:
            note(f"{file}: changed since the last time: cases that are the same are not run again")
        store.tidy()
        engine = _engine(jobs, dask)
        try:
            # a search imports for itself what it needs, in this thread
            with _shown(loaded.count) as tell, _imported_beside(report and loaded.plan is not None):
                runner = Runner(loaded, store, engine, part, retry, tell)
                outcome = runner.run()
            return _end(loaded, store, runner, outcome, part, report, case_reports, junitxml, as_json, engine)
        finally:
            engine.close()


@contextmanager
def _imported_beside(wanted: bool) -> Iterator[None]:
    """What the page is drawn with, imported while the cases run elsewhere; what is missing is reported later."""

    def work() -> None:
        for name in ("emulator.campaigns.page", "matplotlib.backends.backend_agg", "SALib.analyze.rbd_fast"):
            with suppress(ImportError):
                import_module(name)

    thread = Thread(target=work, daemon=True)
    if wanted:
        thread.start()
    yield
    if wanted:
        thread.join()


def _end(
    loaded: Campaign,
    store: Store,
    runner: Runner,
    outcome: dict[str, Any] | None,
    part: Shard,
    report: bool,
    case_reports: int,
    junitxml: Path | None,
    as_json: bool,
    engine: Engine,
) -> int:
    from emulator.campaigns.store import BROKEN
    from emulator.campaigns.table import gather, write_junit

    names = runner.names()
    wanted = names if part.of == 1 else {name for name in names if part.has(name)}
    if report or junitxml is not None:
        results, table = gather(loaded, store.rows(wanted), store.root)
        counts, missing = results.counts(), len(wanted) - len(results)
        files = [str(table)]
        if junitxml is not None:
            write_junit(loaded, results, missing, junitxml)
        if report:
            files += _page(loaded, store, results, missing, outcome, case_reports, engine)
    else:
        counts, files, missing = dict(runner.progress.verdicts), [], 0
    row = {
        "cases": sum(counts.values()), "run": runner.progress.now, "missing": missing, **counts, "outcome": outcome,
        "files": files,
    }  # fmt: skip
    if as_json:
        say(json.dumps(row))
    else:
        reported = ", ".join(f"{count} {verdict}" for verdict, count in counts.items() if count) or "nothing to run"
        say(f"{sum(counts.values())} cases, {runner.progress.now} run now: {reported}")
        for line in _reported(outcome):
            say(line)
        for path in files:
            say(path)
    if any(counts.get(one) for one in BROKEN) or missing:
        return CANNOT_RUN
    return FAILED if counts.get("failed") and loaded.file.design.kind not in ("boundary", "worst") else OK


def _page(
    loaded: Campaign, store: Store, results: Any, missing: int, outcome: Any, runs: int, engine: Engine
) -> list[str]:
    from emulator.studies.report import need_extra

    try:
        need_extra()
    except EmulatorError as error:
        note(f"no page: {error}")
        return []
    from emulator.campaigns.page import write_page

    return [str(write_page(loaded, store, results, missing, outcome, runs, engine.begin))]


def _reported(outcome: dict[str, Any] | None) -> Iterator[str]:
    if outcome is None:
        return
    if outcome["design"] == "monte_carlo":
        state = "reached" if outcome["reached"] else "NOT reached"
        yield (
            f"{outcome['of']}: {outcome['estimate']:.6g}, {outcome['low']:.6g} to {outcome['high']:.6g} with"
            f" {100 * outcome['confidence']:g} % confidence; precision {state} after {outcome['points']} points"
        )
    elif outcome["design"] == "worst":
        if outcome["case"] is None:
            yield f"{outcome['of']}: no case has a value"
        else:
            yield f"{outcome['of']}: {outcome['find']} {outcome['value']:.6g}; {outcome['scenario']}"
    else:
        for row in outcome.get("found", ()):
            others = ", ".join(f"{key}={value}" for key, value in row["factors"].items())
            head = f"{others}: " if others else ""
            yield f"{head}{outcome['of']} {row['low']:.6g} to {row['high']:.6g}: {row['state']}"


def _shard(text: str | None) -> Shard:
    from emulator.campaigns.campaign import Shard

    if text is None:
        return Shard()
    found = re.fullmatch(r"(\d{1,6})/(\d{1,6})", text)
    if found is None or not 1 <= int(found[1]) <= int(found[2]):
        raise click.BadParameter(f"{text!r}; want I/N with I from 1 to N, as 2/8", param_hint="--shard")
    return Shard(int(found[1]), int(found[2]))


def _words(driver: str | None) -> tuple[str, ...]:
    if driver is None:
        return ()
    try:
        words = tuple(shlex.split(driver))
    except ValueError as error:
        raise click.BadParameter(f"{driver!r}: {error}; want a command", param_hint="--driver") from None
    if not words:
        raise click.BadParameter("empty; want a command", param_hint="--driver")
    return words


def _whole_name(store: Store, case: str) -> str:
    found = [one for one in store.names() if one.startswith(case)]
    if len(found) != 1 or len(case) < 4:
        raise EmulatorError(f"--case {case}: {len(found)} cases; want the name of one, or at least its first 4 letters")
    return found[0]


def _engine(jobs: int | None, dask: str | None) -> Engine:
    if dask is not None:
        from emulator.campaigns.cluster import Cluster

        return Cluster(dask)
    from emulator.campaigns.engines import Processes

    return Processes(jobs)


def _status(loaded: Campaign, store: Store, part: Shard, as_json: bool) -> int:
    from emulator.campaigns.table import gather_counts

    wanted = None if loaded.plan is None else {one for one in loaded.names() if part.has(one)}
    counts = gather_counts(store, wanted)
    done = sum(counts.values())
    planned = None if wanted is None else len(wanted)
    recorded = store.recorded_bytes()
    row = {"planned": planned, "done": done, **counts, "recordings_bytes": recorded}
    if as_json:
        say(json.dumps(row))
    else:
        left = "" if planned is None else f" of {planned}"
        say(
            f"{done}{left} cases done: " + (", ".join(f"{n} {verdict}" for verdict, n in counts.items() if n) or "none")
        )
        say(f"recordings: {recorded / 1e6:.1f} MB of {loaded.file.limits.disk_mb:g} MB")
    return OK


def _write_slurm(
    file: Path, out: Path, tasks: int, cores: int, words: tuple[str, ...], points: int | None, loaded: Campaign
) -> int:
    from emulator.campaigns.slurm import script

    if loaded.plan is None:
        kind = loaded.file.design.kind
        raise EmulatorError(f"--slurm: design {kind} looks at results as they come; want points known before")
    more = [*(["--driver", shlex.join(words)] if words else []), *(["--points", str(points)] if points else [])]
    path = out / "campaign.sbatch"
    try:
        path.write_text(script(file, out, tasks, cores, more), encoding="utf-8")
    except OSError as error:
        raise EmulatorError(f"{path}: cannot be written: {error.strerror}") from None
    say(f"{path}: hand it in with: sbatch {path}")
    return OK


@contextmanager
def _shown(planned: int | None) -> Iterator[Any]:
    """A bar with rate and remaining time on a terminal."""
    from emulator.process.clock import SystemClock

    clock = SystemClock()
    with bar("campaign") as progress:

        def tell(at: Progress) -> None:
            done, of = at.before + at.now, at.planned or planned
            if of:
                progress(min(done / of, 1.0), _rate(at.now, of - done, clock.now_ns() * 1e-9))

        yield tell


def _rate(done: int, left: int, seconds: float) -> str:
    rate = done / seconds if seconds > 0 else 0.0
    return f"{rate:.1f} cases/s" + (f", {max(left, 0) / rate:.0f} s left" if rate else "")
