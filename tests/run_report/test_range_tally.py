"""Sums of range errors and detections: by hand on a few beams, and in closed form on many."""

from __future__ import annotations

import math

import numpy as np
import pytest

from emulator.run_report.errors import BIN_M, HALF_BINS, Errors, RangeTally, known


def test_errors_have_the_moments_of_their_numbers_however_they_come() -> None:
    rng = np.random.default_rng(1)
    error = rng.normal(0.02, 0.05, 10_000)
    whole, parts = Errors(), Errors()
    whole.add(error)
    for part in np.array_split(error, 7):
        parts.add(part)
    parts.add(np.zeros(0))
    for found in (whole, parts):
        assert found.count == 10_000
        assert found.mean_m == pytest.approx(error.mean(), rel=1e-12)
        assert found.sigma_m == pytest.approx(error.std(ddof=1), rel=1e-9)
        assert found.rms_m == pytest.approx(math.sqrt(np.square(error).mean()), rel=1e-12)
        assert (found.least_m, found.most_m) == (error.min(), error.max())
        for share in (0.16, 0.5, 0.84):
            assert found.percentile_m(share) == pytest.approx(np.quantile(error, share), abs=1.01 * BIN_M)
    np.testing.assert_array_equal(whole.bins, parts.bins)
    assert whole.bins.sum() == 10_000


def test_errors_of_metres_are_counted_at_the_ends() -> None:
    found = Errors()
    found.add(np.array([-7.0, -0.0005, 0.0005, 3.0]))
    assert (found.bins[0], found.bins[HALF_BINS], found.bins[HALF_BINS + 1], found.bins[-1]) == (1, 1, 1, 1)
    assert (found.least_m, found.most_m) == (-7.0, 3.0)


def test_without_errors_there_are_no_numbers() -> None:
    found = Errors()
    assert all(math.isnan(value) for value in (found.mean_m, found.sigma_m, found.rms_m, found.percentile_m(0.5)))
    assert known(found.mean_m) is None
    assert known(math.inf) is None


def test_each_beam_falls_into_its_place() -> None:
    """Two sweeps of five beams, two echoes each; actors: 0 world, 1 car, 2 dog."""
    nan = np.nan
    true_m = np.array([10.0, 25.0, 25.0, 25.0, nan, 10.0, 45.0, 45.0, 45.0, nan])
    true_actor = np.array([0, 1, 1, 1, -1, 0, 1, 1, 2, -1], np.int32)
    echoes = [
        (10.1, nan), (24.0, 24.9), (25.2, nan), (3.0, nan), (7.0, nan),
        (nan, nan), (nan, nan), (44.0, nan), (nan, nan), (nan, nan),
    ]  # fmt: skip
    hit = [(0, -1), (0, 1), (1, -1), (-1, -1), (0, -1), (-1, -1), (-1, -1), (2, -1), (-1, -1), (-1, -1)]
    tally = RangeTally(("world", "car", "dog"))
    sweep = np.repeat([0, 1], 5)
    tally.add(np.array([1.0, 2.0]), np.array(echoes), np.array(hit, np.int32), true_m, true_actor, sweep)
    assert (tally.sweeps, tally.beside) == (2, 1)
    world, car, dog = (tally.aimed[number] for number in range(3))
    assert (world.beams, world.seen, world.other, world.air, world.missed) == (2, 1, 0, 0, 1)
    assert (car.beams, car.seen, car.other, car.air, car.missed) == (5, 2, 1, 1, 1)
    assert (dog.beams, dog.seen, dog.missed) == (1, 0, 1)
    assert tally.by_actor[1].mean_m == pytest.approx(
        0.5 * (-0.1 + 0.2)
    )  # the second echo of the second beam is the car's
    assert tally.by_class[1, 2].count == 2  # 20 to 40 m
    assert tally.aimed_by_class[1, 3].beams == 2
    together = tally.by_distance()
    assert {index: errors.count for index, errors in together.items()} == {1: 1, 2: 2}
    assert together[2].mean_m == pytest.approx(0.05)
    assert together[1].bins.sum() == 1
    assert (tally.could[1].sum(), tally.did[1].sum()) == (2, 1)
    assert (tally.could[2].sum(), tally.did[2].sum()) == (1, 1)  # an echo of the dog beside it, at 44 m
    assert (tally.could[1][5], tally.could[1][9]) == (1, 1)  # 25 m: 25 to 30; 45 m: 45 to 50
    assert (tally.farthest_m[1], tally.farthest_at_s[1]) == (25.2, 1.0)
