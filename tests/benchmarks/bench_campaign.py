"""`python -m tests.benchmarks.bench_campaign [CASES] [FOLDER]`: what planning, resuming and reporting many cases costs.

The directory is filled first, with rows of a stand-in for the run, written as those of a case are; a folder that is
given is kept, and what is there is not made again. Then, each in a process of its own: the names of all cases planned;
resumed, of which nothing is left to do; the table and the page; and all three as one command does them. Processor time
and wall time in seconds, and the most memory of the process.
"""

from __future__ import annotations

import multiprocessing
import resource
import shutil
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from emulator.campaigns import campaign as campaigns
from emulator.campaigns.campaign import Campaign, Runner, load
from emulator.campaigns.case import blank
from emulator.campaigns.engines import InPlace
from emulator.campaigns.naming import Case, Job
from emulator.campaigns.store import Row, Store

FILE = """scenario: flat_wall
set: {duration_s: 1}
quantities: {near: min(front.nearest_m)}
expect: [{that: min(front.points) > 250}]
factors:
  weather.fog.visibility_m: {range: [10, 1000], scale: log}
  "world[0].at_m[0]": {range: [2, 20]}
  weather.rain.rate_mm_h: {range: [0.1, 50]}
design: {lhs: CASES}
"""


def stand_in(job: Job, case: Case, may_record: bool) -> Row:
    """A row as that of a run, which is not done."""
    values = case.columns(job)
    seen = values["weather.fog.visibility_m"] > 5 * values["world[0].at_m[0]"]
    row = blank(job, case) | {"verdict": "passed" if seen else "failed", "sha256": case.name, "seconds": 0.04}
    row["quantities"] = {"near": values["world[0].at_m[0]"]}
    row["fault"] = "" if seen else "min(front.points) > 250: 0 > 250, at 0.013 s"
    return row


def never(job: Job, case: Case, may_record: bool) -> Row:
    """All is done."""
    raise AssertionError(case.name)


@contextmanager
def shown(what: str) -> Iterator[None]:
    """A line when it is done."""
    begun, wall = time.process_time(), time.perf_counter()
    yield
    cpu_s, wall_s = time.process_time() - begun, time.perf_counter() - wall
    most_mb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    sys.stdout.write(f"{what:24}{cpu_s:8.1f} s of a core{wall_s:8.1f} s{most_mb:8.0f} MB\n")
    sys.stdout.flush()


def loaded(folder: Path) -> tuple[Campaign, Store]:
    """As the command does."""
    campaigns.version = lambda: "benchmark"  # a folder that is kept serves several states of the code
    made = load(folder / "campaign.yaml", folder / "out")
    return made, Store(made.job.out)


def fill(folder: Path) -> None:
    """All rows that are not there."""
    campaign, store = loaded(folder)
    store.make()

    def work(job: Job, case: Case, may_record: bool) -> Row:
        row = stand_in(job, case, may_record)
        store.write(row)
        return row

    with shown("written"):
        Runner(campaign, store, InPlace(work)).run()


def plan(folder: Path) -> None:
    """Names of all cases."""
    campaign, _ = loaded(folder)
    with shown("planned"):
        assert len(campaign.names()) == campaign.count


def resume(folder: Path) -> Runner:
    """Nothing is left."""
    campaign, store = loaded(folder)
    with shown("resumed"):
        runner = Runner(campaign, store, InPlace(never))
        runner.run()
    assert runner.progress.before == campaign.count
    return runner


def report(folder: Path) -> None:
    """Table and page, as at the end of a command."""
    from emulator.campaigns.page import write_page
    from emulator.campaigns.table import gather

    runner = resume(folder)
    campaign, store = loaded(folder)
    with shown("table"):
        results, _ = gather(campaign, store.rows(runner.names()), store.root)
    with shown("page"):
        write_page(campaign, store, results, 0, None, 0)


def main(cases: int, folder: Path) -> None:
    """The lines."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "campaign.yaml").write_text(FILE.replace("CASES", str(cases)), encoding="utf-8")
    sys.stdout.write(f"{cases} cases\n")
    steps: list[tuple[str, Callable[[Path], object]]] = [("", fill), ("", plan), ("as one command:\n", report)]
    for head, step in steps:
        sys.stdout.write(head)
        sys.stdout.flush()
        process = multiprocessing.get_context("spawn").Process(target=step, args=(folder,))
        process.start()
        process.join()
        if process.exitcode:
            sys.exit(1)


if __name__ == "__main__":
    count = int(sys.argv[1]) if len(sys.argv) > 1 else 1_000_000
    if len(sys.argv) > 2:
        main(count, Path(sys.argv[2]))
    else:
        made = Path(tempfile.mkdtemp())
        try:
            main(count, made)
        finally:
            shutil.rmtree(made, ignore_errors=True)
