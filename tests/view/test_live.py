"""What the page is told of a run: where its scenario ends."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import pytest

from emulator.process.clock import ManualClock
from emulator.runtime import assembly
from emulator.runtime.control import Later
from emulator.runtime.orders import Orders
from emulator.runtime.virtual_daemon import VirtualDaemon
from emulator.scenario import scenario
from emulator.view import drawing, live

CASE = """\
schema: 1
duration_s: 2
sensors:
  - {id: front, model: sick-lms291-s05, links: ["tcp:127.0.0.1:0"], device: {resolution_deg: 1, field_deg: 100}}
"""
SECOND = 10**9


@pytest.fixture
def daemon() -> Iterator[VirtualDaemon]:
    made, _ = assembly.start_virtual(scenario.loads(CASE, Path("case.yaml")))
    made.waits_for_hosts = False
    made.power_on()
    yield made
    made.close()


@pytest.fixture
def source(daemon: VirtualDaemon, monkeypatch: pytest.MonkeyPatch) -> live.LiveSource:
    orders = Orders(daemon, daemon.instruments, ManualClock(), scenario.loads(CASE, Path("case.yaml")))
    methods = orders.methods()

    def ask(path: Path, method: str, params: Mapping[str, Any]) -> Any:
        found = methods[method](params)
        return json.loads(json.dumps(found.make() if isinstance(found, Later) else found))

    monkeypatch.setattr(live, "ask", ask)
    return live.LiveSource(Path("control"))


def go(daemon: VirtualDaemon, until_ns: int) -> None:
    daemon.run(until_ns, lambda: not daemon.paused)


def test_time_stands_at_the_scenarios_end_and_goes_on_when_told_to(
    daemon: VirtualDaemon, source: live.LiveSource
) -> None:
    source.stand_at_end()
    go(daemon, SECOND)
    assert not source.frame().stands
    go(daemon, 9 * SECOND)
    assert daemon.now_ns == 2 * SECOND
    frame = source.frame()
    assert (frame.now_s, frame.paused, frame.ended) == (2.0, True, "")
    assert frame.stands == "The scenario ends at 2 s. Restart begins again, Resume continues beyond its end."
    text = drawing.state(frame, {}, {})
    assert frame.stands in text
    assert "ended" in text
    source.order("resume", {})
    go(daemon, 3 * SECOND)
    assert daemon.now_ns == 3 * SECOND
    source.order("pause", {})
    frame = source.frame()
    assert (frame.paused, frame.stands) == (True, "")
    assert "paused" in drawing.state(frame, {}, {})


def test_a_run_of_somebody_else_is_let_alone(daemon: VirtualDaemon, source: live.LiveSource) -> None:
    source.frame()
    go(daemon, 3 * SECOND)
    assert daemon.now_ns == 3 * SECOND
    assert not source.frame().stands


def test_a_pause_that_has_been_passed_holds_at_once(daemon: VirtualDaemon, source: live.LiveSource) -> None:
    go(daemon, SECOND)
    source.order("pause", {"at_s": 0.5})
    go(daemon, 2 * SECOND)
    assert daemon.paused
    assert daemon.now_ns == SECOND
