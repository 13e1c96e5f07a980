"""docs/control.md: every method is there, and every example is what a run answers."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import pytest

from emulator.process.clock import ManualClock
from emulator.runtime import assembly
from emulator.runtime.control import Later
from emulator.runtime.orders import Orders
from emulator.scenario import scenario

PAGE = (Path(__file__).resolve().parents[2] / "docs" / "control.md").read_text(encoding="utf-8")
CASE = """\
schema: 1
actors: [{id: car}]
live: {feed: control}
sensors:
  - {id: front, model: sick-lms291-s05, links: ["loop:front"]}
"""


def sections() -> dict[str, str]:
    """Methods of the page and what stands below their names."""
    parts = re.split(r"^### (.+)$", PAGE.partition("## Methods")[2], flags=re.MULTILINE)
    return {
        name: text
        for names, text in zip(parts[1::2], parts[2::2], strict=True)
        for name in re.findall(r"`(\w+)`", names)
    }


def examples() -> list[tuple[dict[str, Any], Any]]:
    """Requests of the page with the results below them."""
    lines = [line.strip() for line in PAGE.partition("## Methods")[2].splitlines()]
    return [
        (json.loads(line), json.loads(lines[place + 1]))
        for place, line in enumerate(lines)
        if line.startswith('{"method"')
    ]


@pytest.fixture
def orders() -> Any:
    daemon, instruments = assembly.start_virtual(loaded := scenario.loads(CASE, Path("case.yaml")))
    made = Orders(daemon, instruments, ManualClock(), loaded)
    daemon.power_on()
    yield made
    daemon.close()


def test_the_page_has_every_method_and_no_other(orders: Orders) -> None:
    assert set(sections()) == set(orders.methods())
    assert {request["method"] for request, _ in examples()} == set(orders.methods())


def test_every_example_is_answered_like_that(orders: Orders) -> None:
    methods = orders.methods()
    for request, reported in examples():
        found = methods[request["method"]](request.get("params", {}))
        found = found.make() if isinstance(found, Later) else found
        assert type(found) is type(reported), request
        if isinstance(reported, dict):
            assert set(reported) == set(found) - {"why", "feed"}, request  # no host is here that would read
    assert json.loads(json.dumps(found)) == found
