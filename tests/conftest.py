"""What holds for all tests: property tests draw the same cases every time, none has a limit by the clock, arrays
are compared in one step, what the collection of tests made is not walked again by the garbage collector, and at the end
of each test every scan of every sensor that it ran is on account."""

from __future__ import annotations

import gc
from collections.abc import Generator, Iterator
from typing import Any

import pytest
from hypothesis import settings

from emulator.instrument.instrument import Instrument
from emulator.instrument.ledger import faults_of
from tests import approx
from tests.draws import cases

approx.install()
settings.register_profile("lidaremu", deadline=None, derandomize=True, max_examples=cases(100))
settings.load_profile("lidaremu")


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Generator[None, object, object]:
    """Modules and items live as long as the process: each full collection of garbage walked all of them."""
    gc.disable()
    try:
        return (yield)
    finally:
        gc.enable()
        gc.collect()
        gc.freeze()


@pytest.fixture(autouse=True)
def _every_scan_is_on_account(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Whatever a test runs to whatever end; `@pytest.mark.unaccounted` for one that loses scans on purpose."""
    made: list[Instrument] = []
    begin = Instrument.__init__

    def noted(self: Instrument, *given: Any, **named: Any) -> None:
        begin(self, *given, **named)
        made.append(self)

    monkeypatch.setattr(Instrument, "__init__", noted)
    yield
    if request.node.get_closest_marker("unaccounted") is None:
        reported = {one.sensor: text for one in made if (text := faults_of(one.ledger.account()))}
        assert not reported, f"scans that are nowhere: {reported}"
