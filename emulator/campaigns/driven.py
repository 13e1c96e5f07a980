"""A case with an unmodified host: its own links in its own folder, the driver as a process, virtual time.

Belongs here: one such run. Not: what is made of it (case).
"""

from __future__ import annotations

import json
import os
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from emulator.config import overrides
from emulator.errors import EmulatorError
from emulator.instrument.ledger import check_accounts
from emulator.instrument.series import SeriesWatcher
from emulator.judging.expectations import Judgement, Run, understand, verdicts
from emulator.judging.rig import free_links
from emulator.judging.trial import DEFAULT_S
from emulator.process.clock import SystemClock
from emulator.process.driver import FEED, driver_environment, end_driver, how_it_ended, start_driver
from emulator.recording.transcript import Transcript
from emulator.recording.writer import Recorder
from emulator.recording.writing import VIRTUAL
from emulator.runtime import assembly
from emulator.runtime.lockstep import LockstepServer
from emulator.scenario import scenario as scenarios
from emulator.scenario.scenario import Scenario

FACTORS, RESULT = "LIDAREMU_FACTORS", "LIDAREMU_RESULT"
"Variables of a driver: values of its case as one JSON object; the file for numbers of its own, as one JSON object."
LONGEST_RESULT = 1 << 16


class Hung(EmulatorError):
    """The driver did not come to its end in time."""


class Driven(NamedTuple):
    """What a driver's run has shown."""

    run: Run
    judged: tuple[Judgement, ...]
    sha256: str
    warnings: tuple[str, ...]
    fault: str
    result: dict[str, float]
    "Numbers of its own."


def drive(
    loaded: Scenario, command: Sequence[str], seconds: float, record: Path | None, factors: Mapping[str, Any]
) -> Driven:
    """Run until the driver ends or the scenario's time is over.

    `seconds`: real time that it may take. [s] Raises `EmulatorError` when it cannot run, or leaves no such result.
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
        recorder = driver = lockstep = None
        clock = SystemClock()
        end_ns = round((linked.duration_s or DEFAULT_S) * 1e9)
        late = False

        def going() -> bool:
            nonlocal late
            late = clock.now_ns() > seconds * 1e9
            return not late and (driver is None or driver.poll() is None)

        try:
            feed = None if daemon.feeding is None else daemon.feeding.open()
            if daemon.feeding is not None and daemon.feeding.live.lockstep:
                lockstep = LockstepServer(daemon, daemon.feeding)
                feed = lockstep.url
            if record is not None:
                now = lambda: daemon.now_ns  # noqa: E731
                recorder = Recorder(record, linked, instruments, incidents=daemon.incidents, now_ns=now, manner=VIRTUAL)
            daemon.power_on()
            pairs = [(one.sensor, one.links[0].url) for one in instruments if one.links]
            environment = driver_environment(os.environ, pairs) | ({} if feed is None else {FEED: feed})
            environment |= {FACTORS: json.dumps(dict(factors)), RESULT: str(Path(folder) / "result.json")}
            driver = start_driver(command, environment, True)
            daemon.run(end_ns, going)
            ended_ns = daemon.now_ns
            code = driver.poll()
            check_accounts(instruments, daemon.incidents, ended_ns)
            run = Run(linked, series, {one.sensor: one for one in instruments}, ended_ns)
            judged = verdicts(expected, run)
        finally:
            if lockstep is not None:
                lockstep.close()
            daemon.close()
            if recorder is not None:
                recorder.close()
            if driver is not None:
                end_driver(driver)
        if late:
            raise Hung(f"no end within {seconds:g} s")
        result = result_of(Path(folder) / "result.json")
        fault = "" if code in (None, 0) else f"{command[0]} ended with {how_it_ended(int(code or 0))}"
        if daemon.lost_links:
            fault = "; ".join(filter(None, (fault, *daemon.lost_links)))
        warnings = (*judged.warnings, *([daemon.late_text] if daemon.late_text else []))
        if recorder is not None and recorder.failure:
            warnings = (*warnings, f"recording: {recorder.failure}")
        return Driven(run, tuple(judged), transcript.sha256(), warnings, fault, result)


def result_of(path: Path) -> dict[str, float]:
    """Numbers that a driver has left; none without the file. Raises `EmulatorError`."""
    try:
        with path.open("rb") as file:
            data = file.read(LONGEST_RESULT + 1)
    except FileNotFoundError:
        return {}
    except OSError as error:
        raise EmulatorError(f"{RESULT}: {error.strerror}; want a file") from None
    try:
        found = json.loads(data) if len(data) <= LONGEST_RESULT else None
    except ValueError as error:
        raise EmulatorError(f"{RESULT}: {error}; want one JSON object of numbers") from None
    if not isinstance(found, dict):
        raise EmulatorError(f"{RESULT}: {len(data)} bytes; want one JSON object of at most {LONGEST_RESULT}")
    for name, value in found.items():
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise EmulatorError(f"{RESULT}: {name}: {value!r}; want a number")
    return {name: float(value) for name, value in found.items()}
