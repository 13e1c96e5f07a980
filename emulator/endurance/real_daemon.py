"""The daemon of a real-time soak, as a process of its own: the usual parts with a ledger in between.

    python -m emulator.endurance.real_daemon SCENARIO CONTROL_SOCKET

Prints `ready` as `lidaremu run --json` does, and at the end the account of every scan.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from functools import partial
from pathlib import Path

from emulator import assembly, scenario
from emulator.clock import SystemClock
from emulator.commands.common import note, say
from emulator.control import ControlServer
from emulator.daemon import Daemon, summary
from emulator.endurance.ledger import Ledger, LedgerMeasuring, LedgerSession
from emulator.measuring import Workers
from emulator.orders import Orders


def main(argv: Sequence[str]) -> int:
    """Run until SIGTERM."""
    loaded = scenario.load(argv[0])
    clock = SystemClock()
    names = [sensor.id for sensor in loaded.sensors]
    ledgers = {name: Ledger() for name in names}
    sessions = [
        LedgerSession(session, ledgers[name])
        for name, session in zip(names, assembly.new_sessions(loaded), strict=True)
    ]
    workers = Workers(partial(assembly.build_measures, loaded), names, 1)
    instruments = assembly.open_instruments(loaded, sessions, LedgerMeasuring(workers, ledgers))
    daemon = Daemon(instruments, clock, workers)
    daemon.on_failure = note
    daemon.watch_workers()
    server = ControlServer(Path(argv[1]), Orders(daemon, instruments, clock, loaded).methods(), daemon)
    try:
        with daemon.signals():
            clock.restart()
            daemon.power_on()
            ready = [{"id": one.sensor, "links": [link.url for link in one.links]} for one in instruments]
            say(json.dumps({"event": "ready", "sensors": ready, "control": server.url}))
            daemon.run()
    finally:
        server.close()
        daemon.close()
    totals = [summary(one) | {"account": ledgers[one.sensor].account(one.stats.scans_dropped)} for one in instruments]
    say(json.dumps({"event": "stopped", "sensors": totals, "failures": dict(daemon.failures)}))
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
