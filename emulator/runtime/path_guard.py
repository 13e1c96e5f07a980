"""The places in the file system by which hosts find a run's links, looked after while it runs.

Belongs here: when to look. A change in a place's folder is reported by inotify, where the kernel has that; besides, and
where it has not, every place is looked at once a second. Not: what is restored (`transports.stable_path`).
"""

from __future__ import annotations

import contextlib
import os
from collections.abc import Sequence

from emulator.instrument.instrument import Instrument
from emulator.process.incidents import Incidents
from emulator.transports.inotify import FolderWatch

LOOK_NS = 1_000_000_000
AGAIN_NS = 100_000_000
"After a change the next look comes so soon; until then a folder in which much happens wakes nobody."


class PathGuard:
    """Links that hosts find by a path; nothing is done, and no descriptor taken, where there are none."""

    def __init__(self, instruments: Sequence[Instrument], incidents: Incidents) -> None:
        self._links = [(one.sensor, link) for one in instruments for link in one.links if link.path is not None]
        self._incidents = incidents
        self._next_ns = 0
        self._watch: FolderWatch | None = None
        if self._links:
            with contextlib.suppress(OSError):  # no inotify left: a look once a second
                self._watch = FolderWatch()

    def fileno(self) -> int:
        """Readable when something has changed in one of the folders; -1 where that is not reported."""
        return -1 if self._watch is None else self._watch.fileno()

    def next_ns(self) -> int | None:
        """When to look next if nothing is reported; None: never."""
        return self._next_ns if self._links else None

    def changed(self, now_ns: int, at_ns: int | None = None) -> None:
        """The descriptor is readable."""
        if self._watch is not None:
            self._watch.drain()
            self._look(now_ns, at_ns)
            self._next_ns = min(self._next_ns, now_ns + AGAIN_NS)

    def look(self, now_ns: int, at_ns: int | None = None) -> None:
        """Look at every place, if it is time for that.

        `now_ns`: of a clock that never stands; `at_ns`: the run's instant, where its time is another.
        """
        if not self._links or now_ns < self._next_ns:
            return
        self._next_ns = now_ns + LOOK_NS
        if self._watch is not None:
            self._watch.drain()  # and armed before the look: nothing is missed between the two
            for folder in {os.path.dirname(link.path) for _, link in self._links if link.path is not None}:
                self._watch.arm(folder)
        self._look(now_ns, at_ns)

    def _look(self, now_ns: int, at_ns: int | None) -> None:
        for sensor, link in self._links:
            for one in link.tend(now_ns):
                self._incidents.note(one.kind, now_ns if at_ns is None else at_ns, sensor, one.text)

    def close(self) -> None:
        """Let go of the descriptor; may be called twice."""
        self._links = []
        if self._watch is not None:
            self._watch.close()
            self._watch = None
