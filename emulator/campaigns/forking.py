"""The process that a campaign's processes are forked from: begun early, with what all cases need imported once.

Belongs here: what is light enough to be imported before anything else. Not: the processes themselves (engines).
"""

from __future__ import annotations

import multiprocessing
import os
import signal
from collections.abc import Iterator
from contextlib import contextmanager
from multiprocessing import forkserver
from multiprocessing.context import ForkServerContext

PRELOAD = ["emulator.campaigns.case", "emulator.casting.raycast", "emulator.campaigns.preloaded"]


def context() -> ForkServerContext:
    """For processes that have imported `PRELOAD` when they begin."""
    found = multiprocessing.get_context("forkserver")
    found.set_forkserver_preload(PRELOAD)
    return found


@contextmanager
def begun_early(wanted: bool) -> Iterator[None]:
    """Let the imports run beside what this process does first; `wanted`: it will need processes.

    On an error that process is ended, which would go on importing and hold our output open.
    """
    before = _number()
    if wanted:
        context()
        forkserver.ensure_running()
    number = _number()
    try:
        yield
    except BaseException:
        if number is not None and number != before:
            os.kill(number, signal.SIGTERM)
            os.waitid(os.P_PID, number, os.WEXITED | os.WNOWAIT)  # multiprocessing itself takes its exit code
        raise


def _number() -> int | None:
    """Its process; multiprocessing has no public name for it."""
    return getattr(forkserver._forkserver, "_forkserver_pid", None)
