"""A sweep in parts: each beam has what it has in the whole sweep."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from emulator.measuring.conditions import NORMAL, ActiveFault, Conditions
from emulator.measuring.parts import PartOfScan, beams_of, joined, slice_of
from emulator.sensing.measure import Measure
from protocols.lms2xx.variants import STANDARD, comb
from protocols.scan import ScanPlan
from tests.sensing.rig import build, plan, plate

FAN_DEG = np.linspace(-90.0, 90.0, 361)
FIRE_S = np.linspace(0.0, 0.02, 361)
DRIVES = {"id": "ego", "motion": {"at_m": [0, 0, 0], "velocity_m_s": [12, 0, 0]}}
BOX = {"box": {"size_m": [4, 1.8, 1.5]}}


def street(folder: Path, **words: Any) -> Measure:
    """Walls, cars, a pane, and sheeting near and far, before a sensor that drives."""
    signs = [
        {**plate(x, "retro_sheeting", width_m=0.4, y_m=y, height_m=0.4)}
        for x, y in ((6.0, -1.2), (15.0, 3.0), (30.0, -4.0), (55.0, 2.0))
    ]
    cars = [
        {"id": f"car_{k}", "shape": BOX, "material": "car_paint_grey",
         "motion": {"at_m": [9.0 + 7.0 * k, 5.0 - 2.7 * k, 0.0], "velocity_m_s": [-10.0, 0.3 * k, 0], "yaw_deg": 9 * k}}
        for k in range(5)
    ]  # fmt: skip
    world = [plate(60.0, "white_plaster"), plate(12.0, "window_glass", width_m=3.0, y_m=-6.0, height_m=3.0), *signs]
    words = {"model": "sick-lms291-s05", "mount": {"actor": "ego"}, "actors": [DRIVES, *cars]} | words
    return build(folder, world, **words)


def sweep(number: int) -> ScanPlan:
    return plan(FAN_DEG, sweep=number, start_s=number / 37.5, fire_s=FIRE_S, max_echoes=1)


@pytest.mark.parametrize("of", [2, 3, 7])
def test_parts_together_are_the_whole_sweep(tmp_path: Path, of: int) -> None:
    whole, parted, echoes = street(tmp_path), street(tmp_path), 0
    for number in range(12):
        wanted = sweep(number)
        expected = whole(wanted)
        parts = [parted.part(wanted, NORMAL, k, of) for k in reversed(range(of))]
        found = joined(wanted, [one for one in parts if isinstance(one, PartOfScan)])
        np.testing.assert_allclose(found.range_m, expected.range_m, rtol=1e-10)
        # heights are differences of sums over a sweep, to the rounding of its sheeting
        np.testing.assert_allclose(found.intensity, expected.intensity, rtol=1e-8)
        assert np.array_equal(found.flags, expected.flags)
        assert np.array_equal(found.actor, expected.actor)
        echoes += int(np.isfinite(found.range_m).sum())
    assert echoes > 12 * 100


@pytest.mark.parametrize("of", [2, 3])
def test_slices_together_are_the_whole_sweep(tmp_path: Path, of: int) -> None:
    whole, sliced, beams = street(tmp_path), street(tmp_path), comb(STANDARD, None)
    for number in range(6):
        wanted = replace(sweep(number), fire_offset_s=beams.fire_offset_s)
        parts = [sliced.part(wanted, NORMAL, k, of, True) for k in range(of)]
        found, expected = joined(wanted, [one for one in parts if one is not None]), whole(wanted)
        np.testing.assert_allclose(found.range_m, expected.range_m, rtol=1e-10)
        np.testing.assert_allclose(found.intensity, expected.intensity, rtol=1e-8)
        assert np.array_equal(found.actor, expected.actor)
        assert np.isfinite(found.range_m).sum() > 100


@pytest.mark.parametrize(
    "words",
    [
        {"mount": {}},
        {"weather": {"rain": {"rate_mm_h": 20.0}}},
        {"weather": {"sun": {"elevation_deg": 20.0, "azimuth_deg": 30.0}}},
        {"model": "velodyne-vlp-16"},
        {"physics": {"photons": {"shots": 100}}},
        {"physics": {"rule": "adaptive"}},
        {"physics": {"bloom_share": 0.01, "bloom_mrad": 20.0}},
    ],
    ids=["at rest", "rain", "sun", "probed beams", "photons", "adaptive", "blooming"],
)
def test_where_beams_depend_on_others_or_are_kept_there_are_no_parts(tmp_path: Path, words: dict[str, Any]) -> None:
    assert street(tmp_path, **words).part(sweep(0), NORMAL, 0, 2) is None


def test_nor_under_a_fault_of_what_is_measured(tmp_path: Path) -> None:
    fault = ActiveFault("front", "dead_beams", 0, 0)
    measure = street(tmp_path)
    assert measure.part(sweep(0), Conditions(faults=(fault,)), 0, 2) is None
    assert measure.part(sweep(0), NORMAL, 0, 2) is not None


@pytest.mark.parametrize(("count", "of"), [(361, 2), (361, 3), (5, 7), (1, 1)])
def test_every_beam_is_in_one_part(count: int, of: int) -> None:
    assert np.concatenate([beams_of(count, k, of) for k in range(of)]).tolist() == list(range(count))


def test_a_slice_ends_at_the_pause_between_two_turns() -> None:
    """An LMS291 interlaces two turns: every second beam fires in the second one, 6.7 ms after the last of the first."""
    fire_s = comb(STANDARD, None).fire_offset_s
    wanted = replace(sweep(0), fire_offset_s=fire_s)
    first, second = (slice_of(wanted, k, 2) for k in range(2))
    assert (first.tolist(), second.tolist()) == (list(range(0, 361, 2)), list(range(1, 361, 2)))
    assert fire_s[second].min() - fire_s[first].max() > 0.0066


@pytest.mark.parametrize(("count", "of"), [(361, 2), (361, 3), (64, 4), (5, 7), (1, 1)])
def test_every_beam_is_in_one_slice_and_none_fires_before_one_of_the_slice_before(count: int, of: int) -> None:
    fire_s = 1e-4 * np.random.default_rng(count).permutation(count).astype(np.float64)
    wanted = replace(plan(np.zeros(count)), fire_offset_s=fire_s)
    found = [slice_of(wanted, k, of) for k in range(of)]
    assert np.sort(np.concatenate(found)).tolist() == list(range(count))
    assert np.concatenate([np.sort(fire_s[at]) for at in found]).tolist() == sorted(fire_s.tolist())
    assert max(map(len, found)) - min(map(len, found)) <= 1, "where all pauses are as long it is an even division"
