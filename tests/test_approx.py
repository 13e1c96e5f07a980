"""Arrays that are equal in one step are those that pytest finds equal element by element."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.approx import within

VALUES = st.sampled_from(
    [0.0, -0.0, 1e-12, 2e-12, 1.0, 1.0 + 1e-6, 1.0 + 2e-6, -1.0, 5, 7.5, 1e6, 1e6 + 1.0, np.inf, -np.inf, np.nan]
)
KINDS = st.sampled_from([np.float64, np.float32, np.bool_, object])
TOLERANCES = st.fixed_dictionaries(
    {}, optional={"rel": st.sampled_from([0.0, 1e-6, 0.5]), "abs": st.sampled_from([0, 1e-12, 1e-6, 1.0])}
)


@given(st.lists(st.tuples(VALUES, VALUES), max_size=3), KINDS, KINDS, TOLERANCES, st.booleans())
def test_what_is_within_is_equal_for_pytest_and_almost_all_that_is_equal_is_within(
    pairs: list[tuple[float, float]], kind: Any, other: Any, tolerance: dict[str, float], nan_ok: bool
) -> None:
    with np.errstate(all="ignore"):
        actual = np.array([one for one, _ in pairs], object).astype(kind)
        expected = np.array([one for _, one in pairs], object).astype(other)
    for wanted in (expected, *expected[:1].tolist()):
        approx: Any = pytest.approx(wanted, **tolerance, nan_ok=nan_ok)
        with np.errstate(all="ignore"):
            equal = approx.by_elements(actual)
        found = within(approx, actual)
        assert equal or not found
        if kind is other is np.float64 and len(actual) and not np.isnan(actual).any():
            assert found == equal


@pytest.mark.parametrize(("actual", "expected"), [([1.0, 2.0], [1.0, 2.1]), ([1.0], [1.0, 1.0]), ([np.nan], [np.nan])])
def test_what_is_not_within_is_not_equal_and_pytest_says_why(actual: list[float], expected: list[float]) -> None:
    assert np.array(actual) != pytest.approx(np.array(expected))
    with pytest.raises(AssertionError, match=r"comparison failed|different shapes"):
        assert np.array(actual) == pytest.approx(np.array(expected))


def test_arrays_against_arrays_and_against_one_number() -> None:
    many = np.linspace(1.0, 2.0, 100_000)
    assert within(pytest.approx(many), many * (1.0 + 0.9e-6))
    assert not within(pytest.approx(many), many * (1.0 + 1.1e-6))
    assert within(pytest.approx(1.5, abs=0.5), many)
    assert not within(pytest.approx(1.5, abs=0.49), many)
    assert not within(pytest.approx(True), np.array([True]))
    assert within(pytest.approx(np.array([2, 3])), np.array([2, 3], np.uint8))
    assert not within(pytest.approx(np.array([2, 3])), np.array([2, 4], np.uint8))
    assert not within(pytest.approx(np.array([2**60])), np.array([2**60])), "float64 does not hold it: left to pytest"
