"""Cases on the workers of a Dask cluster, which somebody else has started: on Slurm, Kubernetes or by hand.

Belongs here: handing cases to a scheduler. Not: the cluster. Workers must see the folder of the campaign.
"""

from __future__ import annotations

import importlib
import itertools
from collections.abc import Callable, Iterable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

from emulator.campaigns.case import DiskFull, blank, run_case
from emulator.campaigns.engines import Work, lost
from emulator.campaigns.naming import Case, Job
from emulator.campaigns.store import Row
from emulator.errors import EmulatorError

AHEAD = 4
"Cases per thread of the cluster that wait there."
LEAST_AHEAD = 8
TIME_LIMIT_S = 30
"For a scheduler to answer."


class Cluster:
    """The workers of one scheduler; they may come and go, a case whose worker dies is run by another."""

    def __init__(self, address: str, work: Work = run_case) -> None:
        try:
            distributed: Any = importlib.import_module("distributed")
        except ImportError:
            raise EmulatorError(
                "distributed is missing; --dask needs the extra: pip install 'lidaremu[dask]'"
            ) from None
        try:
            self._client = distributed.Client(address, timeout=TIME_LIMIT_S, set_as_default=False)
        except (OSError, ValueError, TimeoutError) as error:
            raise EmulatorError(
                f"--dask {address}: {error}; want the address of a scheduler, as tcp://HOST:8786"
            ) from None
        self._address, self._work = address, work

    def run(self, job: Job, cases: Iterable[Case], may_record: Callable[[], bool]) -> Iterator[Row]:
        """A row for each, as they are done."""
        distributed: Any = importlib.import_module("distributed")
        comm: Any = importlib.import_module("distributed.comm")

        source, client = iter(cases), self._client
        waiting: dict[str, Case] = {}
        work = partial(timed, self._work)

        def more() -> list[Any]:
            threads = sum(client.nthreads().values())
            room = max(AHEAD * threads, LEAST_AHEAD) - len(waiting)
            futures = []
            for case in itertools.islice(source, max(room, 0)):
                waiting[case.name] = case
                futures.append(client.submit(work, job, case, may_record(), key=f"case-{case.name}", pure=False))
            return futures

        try:
            done = distributed.as_completed(more(), loop=client.loop)
            for future in done:
                case = waiting.pop(future.key.removeprefix("case-"))
                try:
                    yield future.result()
                except DiskFull:
                    raise
                except distributed.KilledWorker as error:
                    text = f"its worker died, {error.allowed_failures + 1} times"
                    yield lost(job, blank(job, case) | {"verdict": "crashed", "fault": text})
                for future_ in more():
                    done.add(future_)
        except (OSError, comm.CommClosedError, distributed.CancelledError) as error:
            raise EmulatorError(
                f"--dask {self._address}: the scheduler was lost ({error}); the same command goes on from there"
            ) from None

    def begin(self, work: Callable[[Path], None], path: Path) -> Callable[[], object]:
        """Here, by who waits for it."""
        return partial(work, path)

    def close(self) -> None:
        """Leave the cluster; what waits there is withdrawn."""
        self._client.close()


def timed(work: Work, job: Job, case: Case, may_record: bool) -> Row:
    """The case in a process of its worker's, so that a hang costs one case: Dask itself has no limit for a task."""
    from emulator.campaigns.engines import own_pool

    return own_pool(work, job, case, may_record)
