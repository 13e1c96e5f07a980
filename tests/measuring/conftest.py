"""Daemons with played measuring processes, closed after the test."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from tests.measuring.process_rig import Make, Rig


@pytest.fixture
def rig() -> Iterator[Make]:
    made: list[Rig] = []

    def make(*sensors: str, **words: object) -> Rig:
        made.append(Rig(*sensors, **words))  # type: ignore[arg-type]
        return made[-1]

    yield make
    for one in made:
        one.close()
