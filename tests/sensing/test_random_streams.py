"""Random numbers keyed by what they are for."""

from __future__ import annotations

import numpy as np
import pytest

from emulator.physics.random_streams import RandomStreams


def test_a_draw_does_not_depend_on_what_was_drawn_before() -> None:
    draws = RandomStreams(7, "front")
    late = draws.normal("noise", 5, 361)
    draws.uniform("rain", 5, 1000)
    draws.normal("noise", 4, 10)
    assert np.array_equal(late, draws.normal("noise", 5, 361))


def test_element_j_is_the_same_for_every_number_of_beams() -> None:
    draws = RandomStreams(7, "front")
    assert np.array_equal(draws.normal("noise", 5, 361)[:10], draws.normal("noise", 5, 10))


@pytest.mark.parametrize(
    "other",
    [
        (RandomStreams(8, "front"), "noise", 5),
        (RandomStreams(7, "rear"), "noise", 5),
        (RandomStreams(7, "front"), "rain", 5),
        (RandomStreams(7, "front"), "noise", 6),
    ],
)
def test_seed_sensor_term_and_sweep_each_change_the_numbers(other: tuple[RandomStreams, str, int]) -> None:
    draws, term, sweep = other
    assert not np.any(RandomStreams(7, "front").uniform("noise", 5, 64) == draws.uniform(term, sweep, 64))


def test_names_that_join_to_the_same_text_do_not_share_numbers() -> None:
    assert not np.array_equal(RandomStreams(1, "ab").uniform("c", 0, 4), RandomStreams(1, "a").uniform("bc", 0, 4))


def test_first_numbers_of_a_known_key_stay_what_they_are() -> None:
    # Stored output of our own: detects that recordings would no longer repeat.
    assert RandomStreams(7, "front").uniform("noise", 0, 2)[:, 0].tolist() == STORED


def test_normal_numbers_have_mean_zero_and_variance_one() -> None:
    values = RandomStreams(1, "a").normal("noise", 0, 100_000)
    assert abs(values.mean()) < 4 / np.sqrt(100_000)
    assert abs(values.var() - 1) < 4 * np.sqrt(2 / 100_000)
    assert np.all(np.isfinite(values))


@pytest.mark.parametrize("mean", [0.0, 1e-3, 0.143, 3.0, 40.0, 5e3])
def test_poisson_counts_have_their_mean_and_variance(mean: float) -> None:
    counts = RandomStreams(1, "a").poisson("rain", 0, np.full(40_000, mean))
    error = np.sqrt(mean / counts.size)
    assert abs(counts.mean() - mean) <= 4 * error
    assert abs(counts.var() - mean) <= 6 * (mean + np.sqrt(mean)) / np.sqrt(counts.size) + 1e-12


def test_poisson_counts_of_one_beam_do_not_depend_on_its_neighbours() -> None:
    draws = RandomStreams(1, "a")
    assert draws.poisson("rain", 0, np.array([0.5, 0.1]))[0] == draws.poisson("rain", 0, np.array([0.5]))[0]


STORED = [0.8804587462906448, 0.2870831661017606]
