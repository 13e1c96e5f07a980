"""Which curves a figure draws where there are more than it can show."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np

from emulator.run_report.figures import MOST_CURVES, least_seen


def test_of_many_actors_those_that_are_seen_least_are_drawn() -> None:
    could = {actor: np.array([20, 20]) for actor in range(20)}
    did = {actor: np.array([20, 20]) for actor in range(20)}
    for actor in (3, 17, 19):
        did[actor] = np.array([20, actor])
    could[5], did[5] = np.array([1, 0]), np.array([0, 0])  # met once only: says little
    tally = SimpleNamespace(could=could, did=did)
    drawn = least_seen(tally, range(20))  # type: ignore[arg-type]
    assert drawn[:3] == [3, 17, 19]
    assert len(drawn) == MOST_CURVES
    assert 5 not in drawn
    few = list(range(4, 8))
    assert least_seen(tally, few) == few  # type: ignore[arg-type]
