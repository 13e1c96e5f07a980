"""Where cases run: processes of this machine (Pebble), or workers of a Dask cluster. No engine of our own.

Belongs here: handing out cases and getting rows back, with those that crash or hang. Not: the case itself (case).
"""

from __future__ import annotations

import atexit
import itertools
import multiprocessing
import os
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, wait
from functools import cache, partial
from pathlib import Path
from typing import Any, Protocol

from emulator.campaigns.case import DiskFull, blank, run_case
from emulator.campaigns.forking import context
from emulator.campaigns.naming import Case, Job
from emulator.campaigns.store import Row, Store
from emulator.errors import EmulatorError

GRACE_S = 10.0
"After which a process that has not ended its own hung driver is ended itself."
AHEAD = 3
"Cases per process that wait in the pool."

Work = Callable[[Job, Case, bool], Row]


class Engine(Protocol):
    """Runs cases in any order."""

    def run(self, job: Job, cases: Iterable[Case], may_record: Callable[[], bool]) -> Iterator[Row]:
        """A row for each, as they come; raises `DiskFull` when nothing can be written."""

    def begin(self, work: Callable[[Path], None], path: Path) -> Callable[[], object]:
        """Have something else done, beside what is done here where it can be; what waits for its end."""

    def close(self) -> None:
        """Release all processes."""


class InPlace:
    """One after the other in this process: for tests, and with a debugger."""

    def __init__(self, work: Work = run_case) -> None:
        self._work = work

    def run(self, job: Job, cases: Iterable[Case], may_record: Callable[[], bool]) -> Iterator[Row]:
        """A row for each, in order."""
        for case in cases:
            yield self._work(job, case, may_record())

    def begin(self, work: Callable[[Path], None], path: Path) -> Callable[[], object]:
        """It is done by who waits for it."""
        return partial(work, path)

    def close(self) -> None:
        """Nothing to release."""


class Processes:
    """Processes of this machine, started once; one that crashes or hangs is replaced and its case counted."""

    def __init__(self, jobs: int | None = None, work: Work = run_case) -> None:
        try:
            from pebble import ProcessPool
        except ImportError:
            raise EmulatorError(
                "pebble is missing; campaigns need the extra: pip install 'lidaremu[campaign]'"
            ) from None
        self._jobs = jobs or len(os.sched_getaffinity(0))
        self._pool: Any = ProcessPool(max_workers=self._jobs, context=context(), initializer=_one_thread)
        self._work = work

    def run(self, job: Job, cases: Iterable[Case], may_record: Callable[[], bool]) -> Iterator[Row]:
        """A row for each, as they are done."""
        source = iter(cases)
        waiting: dict[Any, Case] = {}
        limit_s = job.seconds + (GRACE_S if job.driver else 0.0)
        while True:
            for case in itertools.islice(source, self._jobs * AHEAD - len(waiting)):
                future = self._pool.schedule(self._work, args=(job, case, may_record()), timeout=limit_s)
                waiting[future] = case
            if not waiting:
                return
            for future in wait(waiting, return_when=FIRST_COMPLETED).done:
                yield _row_of(job, waiting.pop(future), future)

    def begin(self, work: Callable[[Path], None], path: Path) -> Callable[[], object]:
        """In one of the processes."""
        from pebble import ProcessExpired

        future = self._pool.schedule(work, args=(path,))

        def end() -> None:
            try:
                future.result()
            except ProcessExpired as error:
                raise EmulatorError(f"{path}: its process ended with {_ending(error.exitcode)}") from None

        return end

    def use(self, work: Work) -> None:
        """Do this for each case from here on."""
        self._work = work

    def close(self) -> None:
        """End the processes, also in the middle of a case."""
        self._pool.stop()
        self._pool.join()


def _one_thread() -> None:
    """Cases run side by side: libraries that would start a thread a core only slow each other down."""
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ.setdefault(name, "1")


def _row_of(job: Job, case: Case, future: Future[Row]) -> Row:
    from pebble import ProcessExpired

    try:
        return future.result()
    except DiskFull:
        raise
    except TimeoutError:
        row = blank(job, case) | {
            "verdict": "hung",
            "fault": f"no end within {job.seconds:g} s",
            "seconds": job.seconds,
        }
    except ProcessExpired as error:
        row = blank(job, case) | {"verdict": "crashed", "fault": f"its process ended with {_ending(error.exitcode)}"}
    return lost(job, row)


def lost(job: Job, row: Row) -> Row:
    """Write the row of a case whose process could not; the row of one that had just written it is kept."""
    store = Store(Path(job.out))
    found = store.row(row["name"])
    if found is not None and found["verdict"] not in ("hung", "crashed"):
        return found
    try:
        store.write(row)
    except OSError as error:
        raise DiskFull(f"{job.out}: {error.strerror}; {row['name'][:12]} is not done") from None
    return row


def _ending(code: Any) -> str:
    return f"signal {-code}" if isinstance(code, int) and code < 0 else f"exit code {code}"


@cache
def _processes() -> Processes:
    """Of a worker of a cluster, which keeps them from case to case."""
    # Dask's nanny starts its worker as a daemon, which must leave no children behind: ours are ended at exit
    multiprocessing.current_process()._config["daemon"] = False  # type: ignore[attr-defined]
    made = Processes()
    atexit.register(made.close)
    return made


def own_pool(work: Work, job: Job, case: Case, may_record: bool) -> Row:
    """One case in another process of this machine, with the limit of its time; crashes and hangs become rows."""
    pool = _processes()
    pool.use(work)
    return next(pool.run(job, iter((case,)), lambda: may_record))
