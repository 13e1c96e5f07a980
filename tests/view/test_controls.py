"""Sliders follow the daemon, and never take back what the user has just done."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

pytest.importorskip("viser", reason="extra `view` is not installed")

from emulator.view.controls import Controls


def test_a_slider_that_the_user_has_moved_waits_for_its_order() -> None:
    controls = Controls.__new__(Controls)
    controls._settled = {}
    slider = SimpleNamespace(value=0.0)
    controls._set("seek", slider, 3.0)
    controls._set("seek", slider, 10.0)
    assert slider.value == 10.0
    slider.value = 0.0  # the user's, as the server writes it down; the order is made of it a little later
    controls._set("seek", slider, 10.0)
    assert slider.value == 0.0
    assert controls._settle(slider) == 0.0
    controls._set("seek", slider, 0.5)
    assert slider.value == 0.5
