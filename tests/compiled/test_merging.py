"""Sub-echoes of two sources put together: the same by arrays, by loops, and one by one."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from emulator.physics.subechoes import SubEchoes
from tests.compiled.both import both
from tests.draws import cases

pytest.importorskip("numba")

BEAMS = 7


def drawn(rng: np.random.Generator, count: int, beams: np.ndarray, spread: bool) -> SubEchoes:
    """So many of some beams, with ranges that are often equal."""
    return SubEchoes.of(
        rng.choice(beams, count),
        rng.integers(1, 6, count).astype(float),
        rng.uniform(0.1, 2.0, count),
        rng.uniform(0.0, 1.0, count),
        rng.integers(-1, 4, count),
        rng.uniform(0.0, 0.5, count) if spread else None,
    )


def rows(echoes: SubEchoes) -> list[tuple[float, ...]]:
    """One by one; a point has no spread."""
    spread = np.zeros(len(echoes)) if echoes.spread_m is None else echoes.spread_m
    columns = echoes.beam, echoes.range_m, echoes.amplitude, echoes.blocked, echoes.source, spread
    return [tuple(float(column[k]) for column in columns) for k in range(len(echoes))]


@given(
    seed=st.integers(0, 100_000), counts=st.tuples(*3 * [st.integers(0, 30)]), spreads=st.tuples(*3 * [st.booleans()])
)
@settings(max_examples=cases(60), deadline=None)
def test_sources_are_joined_in_order_those_of_the_first_before_their_equals(
    seed: int, counts: tuple[int, int, int], spreads: tuple[bool, bool, bool]
) -> None:
    rng = np.random.default_rng(seed)
    parts = [drawn(rng, count, np.arange(BEAMS), spread) for count, spread in zip(counts, spreads, strict=True)]
    one, other = both(lambda: SubEchoes.joined(*parts))
    wanted = sorted((row for part in parts for row in rows(part)), key=lambda row: row[:2])  # a stable sort
    assert rows(one) == rows(other) == wanted
    assert (one.spread_m is None) == (other.spread_m is None)


@given(seed=st.integers(0, 100_000), counts=st.tuples(st.integers(0, 40), st.integers(0, 20)), spread=st.booleans())
@settings(max_examples=cases(60), deadline=None)
def test_beams_get_other_echoes_instead_of_their_own(seed: int, counts: tuple[int, int], spread: bool) -> None:
    rng = np.random.default_rng(seed)
    beams = rng.random(BEAMS) < 0.5
    beams[0] = True
    own = drawn(rng, counts[0], np.arange(BEAMS), spread)
    others = drawn(rng, counts[1], np.flatnonzero(beams), False)
    one, other = both(lambda: own.replaced(beams, others))
    kept = [row for row in rows(own) if not beams[int(row[0])]]
    assert rows(one) == rows(other) == sorted([*kept, *rows(others)], key=lambda row: row[:2])
