"""What holds for all tests of studies: figures of few dots, which take a fifth of the time."""

from __future__ import annotations

from collections.abc import Iterator

import pytest


@pytest.fixture(scope="session", autouse=True)
def _coarse() -> Iterator[None]:
    """Before anything that tests of a file share is made."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("emulator.studies.drawing.DPI", 30)
        yield
