"""Whole studies draw figures of few dots: drawn just so, in a fraction of the time."""

from __future__ import annotations

from collections.abc import Iterator

import pytest


@pytest.fixture(scope="session", autouse=True)
def _coarse() -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr("emulator.studies.drawing.DPI", 30)
        yield
