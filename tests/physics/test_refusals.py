"""What physics refuses by name, and what it makes of nothing."""

from __future__ import annotations

import math

import numpy as np
import pytest

from emulator.physics import arrays
from emulator.physics.beams import BeamShape
from emulator.physics.photons import correlation_range
from emulator.physics.subechoes import SubEchoes


@pytest.mark.parametrize(
    ("keys", "reported"),
    [
        ({"half_angle_x_rad": -1e-3}, "half_angle_x_rad: -0.001; want a half angle"),
        ({"half_angle_y_rad": math.nan}, "half_angle_y_rad: nan; want a half angle"),
        ({"profile": "square"}, "profile: 'square'; want gauss or tophat"),
        ({"roll_rad": math.inf}, "roll_rad: inf; want a finite number"),
        ({"exit_radius_m": -1.0}, "exit_radius_m: -1.0; want a number >= 0"),
    ],
)
def test_a_beam_that_cannot_be_is_refused_by_name(keys: dict[str, object], reported: str) -> None:
    with pytest.raises(ValueError, match=reported):
        BeamShape(**({"half_angle_x_rad": 1e-3, "half_angle_y_rad": 1e-3} | keys))  # type: ignore[arg-type]


def test_numbers_outside_their_range_are_told_with_the_first_one() -> None:
    with pytest.raises(ValueError, match=r"x: 0\.0; want a number > 0"):
        arrays.require_positive("x", [1.0, 0.0, -1.0])
    with pytest.raises(ValueError, match=r"x: -1\.0; want a number >= 0"):
        arrays.require_not_negative("x", [0.0, -1.0])
    with pytest.raises(ValueError, match=r"x: 1\.5; want a number from 0 to 1"):
        arrays.require_share("x", [0.0, 1.5])


def test_nothing_has_no_groups() -> None:
    assert arrays.group_starts(np.zeros(0, np.int64)).tolist() == []
    assert arrays.group_starts(np.array([2, 2, 5])).tolist() == [0, 2]


def test_a_histogram_that_is_largest_at_its_ends_has_its_range_there() -> None:
    pulse = np.array([1.0])
    assert correlation_range(np.array([9.0, 1.0, 0.0]), pulse, 0.5) == 0.0
    assert correlation_range(np.array([0.0, 1.0, 9.0]), pulse, 0.5) == 1.0
    assert correlation_range(np.array([0.0, 4.0, 8.0, 4.0]), pulse, 0.5) == 1.0
    assert correlation_range(np.array([5.0, 5.0, 5.0]), pulse, 0.5) == 0.0


def test_sub_echoes_of_a_table_may_do_without_source_and_blocked() -> None:
    found = SubEchoes.from_grid(np.array([[3.0, np.nan], [5.0, 4.0]]), np.array([[1.0, 2.0], [3.0, 4.0]]))
    assert found.beam.tolist() == [0, 1, 1]
    assert found.range_m.tolist() == [3.0, 4.0, 5.0]
    assert found.amplitude.tolist() == [1.0, 4.0, 3.0]
    assert found.spread_m is None
    with_spread = SubEchoes.of(np.zeros(1, np.int64), np.array([7.0]), np.ones(1), spread_m=np.array([0.5]))
    joined = SubEchoes.joined(found, with_spread)
    assert joined.spread_m is not None
    assert joined.spread_m.tolist() == [0.0, 0.5, 0.0, 0.0]
