"""Names and texts are text on the page, wherever they come from."""

from __future__ import annotations

from html.parser import HTMLParser
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

pytest.importorskip("viser", reason="extra `view` is not installed")
from emulator.hosts.describe import Described
from emulator.view import drawing, sky
from emulator.view.frames import Frame, ShownLink, ShownScan, ShownSensor, ShownTelegram
from emulator.view.page import legend

EVIL = "<img src=x onerror='alert(1)'>\"`[x](javascript:alert(1))\x1b\u202e&lt;"
KNOWN = {"div", "b", "small", "br", "span", "table", "tr", "th", "td", "i", "svg", "circle", "path", "text"}


class Elements(HTMLParser):
    def __init__(self) -> None:
        super().__init__(convert_charrefs=True)
        self.names: set[str] = set()
        self.keys: set[str] = set()
        self.text = ""

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.names.add(tag)
        self.keys |= {key for key, _ in attrs}

    def handle_data(self, data: str) -> None:
        self.text += data


def scan(**more: Any) -> ShownScan:
    one = np.zeros((1, 1))
    return ShownScan(0.0, 0, np.zeros(1), np.zeros(1), np.zeros(1), one + 5.0, one + 1.0, one.astype(np.int32), **more)


def made() -> dict[str, str]:
    """Every text that the page puts into itself as HTML, of hostile parts."""
    link = ShownLink(EVIL, EVIL, True, 1, 2, 3)
    sensor = ShownSensor(1, 2.0, 3.0, 4.0, {EVIL: 1}, {EVIL: 2}, 0, (link,))
    row = ShownTelegram(1, 0, 0, True, 0.0, EVIL.encode(), EVIL)
    fault = {"state": EVIL, "until_s": 1.0, "hits": 1, "number": EVIL, "on": EVIL, "do": EVIL}
    world: Any = SimpleNamespace(actors=[EVIL])
    return {
        "ended": drawing.state(
            Frame(0.0, True, False, 1.0, {EVIL: scan()}, {EVIL: sensor}, ended=EVIL), {EVIL: EVIL}, {}
        ),
        "stands": drawing.state(Frame(0.0, True, False, 1.0, stands=EVIL), {}, {}),
        "list": drawing.telegram_list([row]),
        "fields": drawing.telegram_fields(row, [Described(EVIL, EVIL, EVIL)]),
        "notes": drawing.notes([EVIL]),
        "legend": legend("actor", world, scan()),
        "faults": sky.faults_of([fault]),
    }


@pytest.mark.parametrize("name", list(made()))
def test_hostile_text_is_text(name: str) -> None:
    seen = Elements()
    seen.feed(made()[name])
    assert seen.names <= KNOWN
    assert not any(key.startswith("on") or key in ("src", "href") for key in seen.keys)
    assert "<img src=x onerror='alert(1)'>" in seen.text
    assert r"\x1b\u202e&lt;" in seen.text


def test_weather_is_told_in_numbers_and_our_own_words() -> None:
    seen = Elements()
    seen.feed(sky.reported({"fog": {"mor_m": 50.0}, EVIL: {"x": EVIL}}))
    assert seen.names == {"div"}
    assert seen.text == "fog 50 m"
