"""Orders with values that are none: refused with what is allowed, and nothing changes."""

from __future__ import annotations

import signal
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from emulator.process.clock import ManualClock
from emulator.runtime import assembly
from emulator.runtime.control import BAD_PARAMS, OrderError
from emulator.runtime.orders import Orders
from emulator.runtime.virtual_daemon import VirtualDaemon
from emulator.scenario import scenario

CASE = """\
schema: 1
sensors:
  - {id: front, model: sick-lms291-s05, links: ["tcp:127.0.0.1:0"], device: {resolution_deg: 1, field_deg: 100}}
"""


@pytest.fixture
def daemon() -> Iterator[VirtualDaemon]:
    made, _ = assembly.start_virtual(scenario.loads(CASE, Path("case.yaml")))
    yield made
    made.close()


@pytest.fixture
def orders(daemon: VirtualDaemon) -> Orders:
    made = scenario.loads(CASE, Path("case.yaml"))
    found = Orders(daemon, daemon.instruments, ManualClock(), made)
    daemon.power_on()
    return found


@pytest.mark.parametrize(
    ("method", "params", "reported"),
    [
        ("speed", {"x": 1e-300}, "want 0, or 0.001 to 1e\\+06"),
        ("speed", {"x": 1e7}, "0 to 1e\\+06"),
        ("speed", {"x": float("nan")}, "nan"),
        ("pause", {"at_s": -1}, "at_s: 0 to 1e\\+09"),
        ("pause", {"at_s": float("nan")}, "nan"),
        ("step", {"scans": 1.5}, "whole number"),
        ("step", {"bytes": 2.5}, "whole number"),
        ("step", {"bytes": True}, "True"),
        ("step", {"seconds": 1e400}, "inf"),
        ("step", {"scans": 10**60}, "100000"),
        ("scans", {"sensor": ["front"]}, "sensor: \\['front'\\]; want one of front"),
        ("telegrams", {"sensor": {}}, "want one of front"),
    ],
)
def test_a_value_that_is_none_is_refused_with_what_is_allowed(
    orders: Orders, daemon: VirtualDaemon, method: str, params: dict[str, Any], reported: str
) -> None:
    before = daemon.speed, daemon.paused, daemon.pause_at_ns, daemon.now_ns
    with pytest.raises(OrderError, match=reported) as refused:
        orders.methods()[method](params)
    assert refused.value.code == BAD_PARAMS
    assert (daemon.speed, daemon.paused, daemon.pause_at_ns, daemon.now_ns) == before


@pytest.mark.parametrize("x", [0.001, 1, 1e6])
def test_a_speed_within_its_limits_holds_until_the_next(orders: Orders, daemon: VirtualDaemon, x: float) -> None:
    orders.methods()["speed"]({"x": x})
    assert daemon.speed == x
    orders.methods()["speed"]({"x": 0})
    assert daemon.speed is None


def test_a_run_knows_why_it_was_ended_the_first_reason_counts(orders: Orders, daemon: VirtualDaemon) -> None:
    orders.stop({})
    daemon.stop("signal SIGTERM")
    assert daemon.why == "ordered: ctl stop"


def test_a_signal_is_told_by_its_name(daemon: VirtualDaemon) -> None:
    with daemon.signals():
        signal.raise_signal(signal.SIGTERM)
    assert daemon.why == "signal SIGTERM"


def test_the_end_of_its_command_is_a_reason(daemon: VirtualDaemon) -> None:
    daemon.run(None, lambda: False)
    assert daemon.why == "its command has ended"


def test_status_names_the_scenario_and_when_it_ends(orders: Orders) -> None:
    orders.until_ns = 12_000_000_000
    status = orders.status({})
    assert isinstance(status, dict)
    assert (status["scenario"], status["ends_at_s"]) == ("case", 12.0)


@pytest.mark.parametrize("what", ["scans", "bytes"])
def test_a_step_without_a_host_says_why_nothing_came(orders: Orders, what: str) -> None:
    reported = orders.step({what: 1})
    assert isinstance(reported, dict)
    if what == "scans":
        assert reported["scans"] == 0
        assert reported["why"] == "0 scans within 10 virtual s; front: no host is connected"
    else:
        assert reported["bytes"] or "no host is connected" in reported["why"]
