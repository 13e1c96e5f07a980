"""The sender of a run in real time: what it looks after besides its sensors."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

from emulator.process.clock import ManualClock
from emulator.process.incidents import KINDS
from emulator.runtime.daemon import Daemon


def test_a_process_that_announces_no_more_is_an_incident_and_ends_no_run() -> None:
    told = ["signal 9; started again", ""]
    daemon = Daemon([], ManualClock())
    daemon.announcer = cast(Any, SimpleNamespace(look=lambda: told.pop(0), close=lambda: None))
    daemon._look_around(1_000_000_000)
    daemon._look_around(2_000_000_000)
    rows = daemon.incidents.rows()
    daemon.close()
    assert rows == [{"kind": "helper ended", "at_s": 1.0, "on": "mdns", "text": "signal 9; started again"}]
    assert KINDS["helper ended"].exit_code == 0
    assert told == []
