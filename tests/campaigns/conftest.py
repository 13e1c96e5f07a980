"""A stand-in for the run of a case: verdict and numbers by a formula, without a sensor."""

from __future__ import annotations

import os
import signal
from collections.abc import Callable
from pathlib import Path

import pytest

from emulator.campaigns.campaign import Campaign, load
from emulator.campaigns.case import blank
from emulator.campaigns.naming import Case, Job
from emulator.campaigns.store import Row, Store

VISIBILITY = "weather.fog.visibility_m"
PLACE = "world[0].at_m[0]"


def stand_in(job: Job, case: Case, may_record: bool) -> Row:
    """Passes where visibility is above 100 m and 5 m a metre of distance; the quantity is smallest at (300, 9)."""
    values = case.columns(job)
    visibility, place = values.get(VISIBILITY, 200.0), values.get(PLACE, 8.0)
    row = blank(job, case) | {
        "verdict": "passed" if visibility > 100.0 + 5.0 * place else "failed",
        "quantities": {"near": (visibility - 300.0) ** 2 / 1e4 + (place - 9.0) ** 2},
        "sha256": case.name[::-1],
        "seconds": 0.001,
    }
    if visibility == 66.0:
        os.kill(os.getpid(), signal.SIGKILL)
    if visibility == 77.0:
        signal.pause()
    Store(Path(job.out)).write(row)
    return row


@pytest.fixture
def made(tmp_path: Path) -> Callable[[str], Campaign]:
    """A campaign of flat_wall with those lines."""

    def make(text: str) -> Campaign:
        path = tmp_path / "c.yaml"
        head = "scenario: flat_wall\nset: {duration_s: 0.2}\nquantities: {near: min(front.nearest_m)}\n"
        path.write_text(head + "expect: [{that: min(front.points) > 250}]\n" + text, encoding="utf-8")
        return load(path, tmp_path / "out")

    return make
