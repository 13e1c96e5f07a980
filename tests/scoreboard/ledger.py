"""A pytest plug-in: which faults began, hit something and ended in tests that passed."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from emulator.faults.catalogue import kinds
from emulator.faults.events import FaultEvent
from emulator.injection.run import SensorFaults


class Ledger:
    """Counts the events of the faults in each test, and keeps them when it has passed."""

    def __init__(self, out: Path) -> None:
        self._out = out
        self._now: set[tuple[str, str]] = set()
        self._kept: set[tuple[str, str]] = set()
        self._tests = 0
        self._failed = 0

    def note(self, event: FaultEvent) -> None:
        """Something happened to a fault in the present test."""
        self._now.add((event.name, event.what))

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_makereport(self, item: pytest.Item, call: Any) -> Iterator[None]:
        report: Any = yield
        if report.when == "call":
            self._tests += 1
            self._failed += report.failed
            if report.passed:
                self._kept |= self._now
        if report.when == "teardown":
            self._now = set()
        return report

    def pytest_sessionfinish(self) -> None:
        rows = {
            name: {"layer": kind.layer} | {what: (name, what) in self._kept for what in ("begin", "hit", "end")}
            for name, kind in kinds().items()
        }
        reported = {"tests": self._tests, "failed": self._failed, "faults": rows}
        self._out.write_text(json.dumps(reported), encoding="utf-8")


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--fault-ledger", type=Path)


def pytest_configure(config: pytest.Config) -> None:
    out = config.getoption("--fault-ledger")
    if out is None:
        return
    ledger = Ledger(out)
    config.pluginmanager.register(ledger, "fault-ledger")
    plain = SensorFaults.tell

    def tell(self: SensorFaults, event: FaultEvent) -> None:
        ledger.note(event)
        plain(self, event)

    SensorFaults.tell = tell  # type: ignore[method-assign]
