"""One case: the scenario with its values, run in virtual time, judged, its numbers taken, its row written.

Belongs here: what is done for one case in whatever process. Not: a driver's run (driven), processes (engines).
"""

from __future__ import annotations

import errno
import math
import shutil
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache, lru_cache
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from emulator.campaigns.driven import Hung, drive
from emulator.campaigns.naming import OF_DRIVER, Case, Job
from emulator.campaigns.store import Row, Store
from emulator.config.expressions import ExpressionError, evaluate, parse
from emulator.errors import EmulatorError
from emulator.judging.expectations import Judgement, Run
from emulator.judging.trial import Trial
from emulator.process.clock import SystemClock
from emulator.runtime.assembly import SameScene
from emulator.scenario.scenario import Scenario

FULL = (errno.ENOSPC, errno.EDQUOT)


class DiskFull(EmulatorError):
    """Nothing more can be written: the campaign stops, and goes on from here when there is room."""


@dataclass(frozen=True)
class Found:
    """What a run has shown."""

    judgements: tuple[Judgement, ...]
    sha256: str
    quantities: dict[str, float | None]
    warnings: tuple[str, ...] = ()
    fault: str = ""
    "Why its driver's run failed beyond the judgements."


def run_case(job: Job, case: Case, may_record: bool = True) -> Row:
    """Run it and write its row; the row. Raises `DiskFull` alone."""
    store = _store(str(job.out))
    clock = SystemClock()
    row = blank(job, case)
    aside = store.aside(case.name)
    # a driver's run cannot be had again to the bit by whoever asks later: it is recorded at once
    at_once = may_record and (job.record == "all" or (job.record == "failed" and bool(job.driver)))
    try:
        loaded = job.changed(case.point, case.seed)
        found = _once(job, case, loaded, aside if at_once else None)
        held = all(item.held for item in found.judgements) and not found.fault
        row |= {"verdict": "passed" if held else "failed", "sha256": found.sha256}
        row["expect"] = {item.name: item.held for item in found.judgements}
        row["quantities"] = found.quantities
        reported = [f"{item.name}: {item.reported}" for item in found.judgements if not item.held]
        row["fault"] = "\n".join([*reported, *([found.fault] if found.fault else [])])
        row["warnings"] = list(found.warnings)
        row["seconds"] = round(clock.now_ns() * 1e-9, 6)
        if not held and may_record and job.record == "failed" and not at_once:
            again = _once(job, case, loaded, aside)
            row["warnings"] = list(again.warnings)
            if again.sha256 != found.sha256:
                row["verdict"], row["fault"] = "error", f"run again: sha256 {again.sha256}, not {found.sha256}"
        if aside.is_dir() and (job.record == "all" or not held):
            row["recording_bytes"] = store.keep_recording(aside, case.name)
    except Hung as error:
        row |= {"verdict": "hung", "fault": str(error), "seconds": round(clock.now_ns() * 1e-9, 6)}
    except EmulatorError as error:
        row |= {"verdict": "error", "fault": str(error), "seconds": round(clock.now_ns() * 1e-9, 6)}
    except OSError as error:
        if error.errno in FULL:
            raise DiskFull(f"{job.out}: {error.strerror}; {case.name[:12]} is not done") from None
        row |= {"verdict": "error", "fault": f"{type(error).__name__}: {error}"}
    except Exception as error:  # a fault of ours in one case must not cost the others
        row |= {"verdict": "error", "fault": f"{type(error).__name__}: {error}"}
    finally:
        shutil.rmtree(aside, ignore_errors=True)
    try:
        store.write(row)
    except OSError as error:
        raise DiskFull(f"{job.out}: {error.strerror}; {case.name[:12]} is not done") from None
    return row


def blank(job: Job, case: Case) -> Row:
    """A row with nothing found yet."""
    return {
        "name": case.name,
        "verdict": "error",
        "seed": case.seed,
        "number": case.number,
        "repeat": case.repeat,
        "factors": case.columns(job),
        "expect": {},
        "quantities": {},
        "seconds": 0.0,
        "sha256": "",
        "fault": "",
        "warnings": [],
        "recording_bytes": 0,
        "version": job.version,
    }


@lru_cache(maxsize=4)
def _store(root: str) -> Store:
    """One for each process: it keeps the file that its rows are appended to."""
    return Store(Path(root))


@cache
def _same_scene() -> SameScene:
    """One for each process: cases have most in common."""
    return SameScene()


def _once(job: Job, case: Case, loaded: Scenario, record: Path | None) -> Found:
    if job.driver:
        done = drive(loaded, job.driver, job.seconds, record, case.columns(job))
        numbers = _numbers(job.quantities, done.run, done.result)
        return Found(done.judged, done.sha256, numbers, done.warnings, done.fault)
    trial = Trial(loaded, record=record, measures=_same_scene())
    try:
        verdict = trial.finish()
        assert trial.outcome is not None
        numbers = _numbers(job.quantities, trial.outcome)
    finally:
        trial.close()
    ended = () if trial.recorder is None or not trial.recorder.failure else (f"recording: {trial.recorder.failure}",)
    return Found(verdict.judgements, verdict.sha256, numbers, (*verdict.warnings, *ended))


def _numbers(
    quantities: Sequence[tuple[str, str]], run: Run, result: Mapping[str, float] = MappingProxyType({})
) -> dict[str, float | None]:
    found: dict[str, float | None] = {}
    for name, text in quantities:
        if text.startswith(OF_DRIVER):
            number = result.get(text.removeprefix(OF_DRIVER), math.nan)
            found[name] = number if math.isfinite(number) else None
            continue
        try:
            value: Any = np.asarray(evaluate(parse(text), run.lookup()))
        except ExpressionError as error:
            raise EmulatorError(f"quantities.{name}: {text!r}: {error}") from None
        if value.ndim:
            raise EmulatorError(f"quantities.{name}: {text!r}: a series; want one number, as max({text})")
        number = float(value)
        found[name] = number if math.isfinite(number) else None
    return found
