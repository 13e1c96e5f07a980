"""A case with an unmodified host: its own links in its own folder, the driver as a process, virtual time.

Belongs here: one such run. Not: what is made of it (case).
"""

from __future__ import annotations

import os
import tempfile
from collections.abc import Sequence
from pathlib import Path

from emulator.config import overrides
from emulator.errors import EmulatorError
from emulator.instrument.ledger import check_accounts
from emulator.instrument.series import SeriesWatcher
from emulator.judging.expectations import Judgement, Run, understand, verdicts
from emulator.judging.rig import free_links
from emulator.judging.trial import DEFAULT_S
from emulator.process.clock import SystemClock
from emulator.process.driver import driver_environment, end_driver, how_it_ended, start_driver
from emulator.recording.transcript import Transcript
from emulator.recording.writer import Recorder
from emulator.recording.writing import VIRTUAL
from emulator.runtime import assembly
from emulator.scenario import scenario as scenarios
from emulator.scenario.scenario import Scenario


class Hung(EmulatorError):
    """The driver did not come to its end in time."""


def drive(
    loaded: Scenario, command: Sequence[str], seconds: float, record: Path | None
) -> tuple[Run, tuple[Judgement, ...], str, tuple[str, ...], str]:
    """Run until the driver ends or the scenario's time is over; outcome, judgements, sha256, warnings, fault.

    `seconds`: real time that it may take. [s] Raises `EmulatorError` when it cannot run.
    """
    with tempfile.TemporaryDirectory(prefix="lidaremu-case-") as folder:
        links = free_links(loaded, Path(folder))
        source = overrides.changed(loaded._source, (), None, links)
        linked = scenarios.from_source(source)
        expected = understand(linked)
        daemon, instruments = assembly.start_virtual(linked)
        ids = [sensor.id for sensor in linked.sensors]
        transcript, series = Transcript(ids), SeriesWatcher(ids)
        for instrument in instruments:
            instrument.watch(transcript)
            instrument.watch(series)
        recorder = driver = None
        clock = SystemClock()
        end_ns = round((linked.duration_s or DEFAULT_S) * 1e9)
        late = False

        def going() -> bool:
            nonlocal late
            late = clock.now_ns() > seconds * 1e9
            return not late and (driver is None or driver.poll() is None)

        try:
            feed = None if daemon.feeding is None else daemon.feeding.open()
            if record is not None:
                now = lambda: daemon.now_ns  # noqa: E731
                recorder = Recorder(record, linked, instruments, incidents=daemon.incidents, now_ns=now, manner=VIRTUAL)
            daemon.power_on()
            pairs = [(one.sensor, one.links[0].url) for one in instruments if one.links]
            environment = driver_environment(os.environ, pairs) | ({} if feed is None else {"LIDAREMU_FEED": feed})
            driver = start_driver(command, environment, True)
            daemon.run(end_ns, going)
            ended_ns = daemon.now_ns
            code = driver.poll()
            check_accounts(instruments, daemon.incidents, ended_ns)
            run = Run(linked, series, {one.sensor: one for one in instruments}, ended_ns)
            judged = verdicts(expected, run)
        finally:
            daemon.close()
            if recorder is not None:
                recorder.close()
            if driver is not None:
                end_driver(driver)
        if late:
            raise Hung(f"no end within {seconds:g} s")
        fault = "" if code in (None, 0) else f"{command[0]} ended with {how_it_ended(int(code or 0))}"
        if daemon.lost_links:
            fault = "; ".join(filter(None, (fault, *daemon.lost_links)))
        return run, tuple(judged), transcript.sha256(), judged.warnings, fault
