"""The daemon of a real-time soak, as a process of its own: the usual parts.

    python -m emulator.endurance.real_daemon SCENARIO CONTROL_SOCKET

Prints `ready` as `lidaremu run --json` does, and at the end the account of every scan.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from functools import partial
from pathlib import Path

from emulator.instrument.ledger import check_accounts
from emulator.instrument.summary import summary
from emulator.measuring.supervision import Workers
from emulator.output.lines import note, say
from emulator.process.clock import SystemClock
from emulator.runtime import assembly
from emulator.runtime.control import ControlServer
from emulator.runtime.daemon import Daemon
from emulator.runtime.orders import Orders
from emulator.scenario import scenario


def main(argv: Sequence[str]) -> int:
    """Run until SIGTERM."""
    loaded = scenario.load(argv[0])
    clock = SystemClock()
    names = [sensor.id for sensor in loaded.sensors]
    sessions = assembly.new_sessions(loaded)
    workers = Workers(partial(assembly.build_measures, loaded), names, 1, clock)
    instruments = assembly.open_instruments(loaded, sessions, workers)
    daemon = Daemon(instruments, clock, workers)
    daemon.on_failure = note
    server = ControlServer(Path(argv[1]), Orders(daemon, instruments, clock, loaded).methods(), daemon)
    try:
        with daemon.signals():
            clock.restart()
            daemon.power_on()
            ready = [{"id": one.sensor, "links": [link.url for link in one.links]} for one in instruments]
            say(json.dumps({"event": "ready", "sensors": ready, "control": server.url}))
            daemon.run()
            check_accounts(instruments, daemon.incidents, clock.now_ns())
    finally:
        server.close()
        daemon.close()
    totals = [summary(one) | {"measured_again": one.ledger.again} for one in instruments]
    ends = {"incidents": daemon.incidents.totals(), "silent": daemon.liveness.silent}
    say(json.dumps({"event": "stopped", "sensors": totals, "failures": dict(daemon.failures)} | ends))
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
