"""Rounding to the telegram: section 6.5 of the project's physics specification, through sessions of both families.

Every case enters as a range in metres and is read back from the bytes that the session sends.
"""

from __future__ import annotations

import itertools
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from protocols.lms2xx.telegrams import read_values
from protocols.scan import DAZZLED, Scan, ScanPlan
from tests.protocols.ld.reader import request
from tests.protocols.ld.rig import measuring, profiles
from tests.protocols.lms2xx.rig import Rig
from tests.sensing.rig import QUIET, build, plate

UNITS = {"mm": 1000, "cm": 100, "dm": 10}
"Counts a metre of the LMS2xx's units."
MODES = {"8m-fields-a-b-dazzle": 13, "16m-fields-a-b": 14, "32m-field-a": 15}
"Measuring mode -> bits of a distance; the words from 2^bits - 8 - 1 on are special (sicktoolbox, Robotics Library)."


def ranges_as(range_m: Any, flags: int = 0) -> Any:
    """A world in which beam j has the j-th of these ranges, the last ones none."""

    def measure(plan: ScanPlan) -> Scan:
        scan = Scan.empty(plan)
        known = np.resize(np.asarray(range_m, np.float64), min(len(plan), len(range_m)))
        scan.range_m[: len(known), 0] = known
        scan.intensity[: len(known), 0] = np.where(np.isnan(known), np.nan, 50.0)
        scan.flags[: len(known)] = flags
        return scan

    return measure


def lms_words(range_m: Any, unit: str, mode: str = "32m-field-a", flags: int = 0) -> list[int]:
    """Value words of an LMS291 that measures these ranges, in the order of its beams."""
    rig = Rig.on(measure=ranges_as(range_m, flags), unit=unit, measuring_mode=mode)
    rig.ask("30 01")
    telegram = rig.await_reply(0xB0, 3.0)
    assert telegram is not None
    values = read_values(telegram)
    assert values is not None
    words = [int(word) for word in values.values[: len(range_m)]]
    if mode != "32m-field-a":
        return words
    for word, x in zip(words, range_m, strict=True):
        assert bool(word & 0x8000) == (x < 0.05) or abs(x - 0.05) < 1e-12, "within the factory's field of 50 mm"
    return [word & 0x7FFF for word in words]


def ld_words(range_m: Any) -> list[int]:
    """Distance words of an LD-LRS1000's profile."""
    rig = measuring({"step_deg": 1}, world=ranges_as(range_m))
    rig.put(request(0x0301, 1, 0x0100))
    rig.run(1_000_000_000)
    (profile,) = profiles(rig, points=[360])
    return profile.sectors[0].distances[: len(range_m)]


def below(x: float) -> float:
    return float(np.nextafter(x, 0.0))


@pytest.mark.parametrize("unit", list(UNITS))
def test_an_lms_rounds_half_up_to_its_unit(unit: str) -> None:
    counts = [0, 1, 7, 100, 813, 2999]
    # halves of a count, written so that range x counts is exactly the half in float64, and the number just below
    halves = [(n + 0.5) / UNITS[unit] for n in counts]
    exact = [
        h if h * UNITS[unit] == n + 0.5 else float(np.nextafter(h, 9e9)) for n, h in zip(counts, halves, strict=True)
    ]
    under = [x for h in halves if (x := below(below(h))) * UNITS[unit] < round(h * UNITS[unit] - 0.5) + 0.5]
    assert lms_words(exact, unit) == [n + 1 for n in counts]
    assert len(under) == len(counts)
    assert lms_words(under, unit) == counts
    whole = [n / UNITS[unit] for n in counts]
    assert lms_words(whole, unit) == counts


def test_an_ld_rounds_half_up_to_a_256th_of_a_metre() -> None:
    counts = [256, 257, 2560, 63_999]
    assert ld_words([(n + 0.5) / 256 for n in counts]) == [n + 1 for n in counts]
    assert ld_words([below((n + 0.5) / 256) for n in counts]) == counts
    assert ld_words([n / 256 for n in counts]) == counts


@pytest.mark.parametrize(("unit", "mode"), list(itertools.product(UNITS, MODES)))
def test_an_lms_range_beyond_the_format_is_the_word_for_no_echo_and_never_wraps(unit: str, mode: str) -> None:
    bits = MODES[mode]
    largest, far = 2**bits - 10, 2**bits - 9  # 8182 and 1FF7 in 13 bits
    edge = largest / UNITS[unit]
    beyond = [(largest + 1) / UNITS[unit], (2**bits + 5) / UNITS[unit], (65536 + 5) / UNITS[unit], 1e6, 1e12, 1e300]
    words = lms_words([edge, *beyond, np.nan, np.inf], unit, mode)
    assert words[0] == largest
    assert words[1:] == [far] * 8


def test_an_ld_range_beyond_the_format_is_the_word_for_no_echo_and_never_wraps() -> None:
    """250 m is the model's range (sicktoolbox_wrapper), 65535/256 m the wire's."""
    words = ld_words([249.0, 65536 / 256, 65540 / 256, 512.5, 1e6, 1e12, 1e300, np.nan, np.inf])
    assert words == [249 * 256] + [0] * 8


@pytest.mark.parametrize(("range_m", "unit", "word"), [
    (1.2345, "cm", 123),  # 1235 mm first would make it 124
    (4.4949, "cm", 449),
    (12.3449999, "dm", 123),  # by way of 12.345 m and 12.35 m it would be 124
    (0.0149999, "cm", 1),
])  # fmt: skip
def test_a_word_is_worked_out_from_the_unrounded_range_only_once(range_m: float, unit: str, word: int) -> None:
    assert lms_words([range_m], unit) == [word]


def test_a_dazzled_beam_has_its_own_word_whatever_its_range() -> None:
    assert lms_words([5.0, np.nan, 1e300], "mm", "32m-field-a", DAZZLED) == [0x7FFE] * 3


@pytest.mark.parametrize("family", ["lms", "ld"])
def test_an_empty_scene_is_sent_as_no_echo_in_every_beam(tmp_path: Path, family: str) -> None:
    """Section 6.3, empty scene: through scenario, sensing and session."""
    model = {"lms": "sick-lms291-s05", "ld": "sick-ld-lrs1000"}[family]
    measure = build(tmp_path, model=model, physics={"false_alarms": False})
    if family == "lms":
        rig = Rig.on(measure=measure, unit="cm")
        rig.ask("30 01")
        telegram = rig.await_reply(0xB0, 3.0)
        assert telegram is not None
        values = read_values(telegram)
        assert values is not None
        assert values.values.tolist() == [0x1FF7] * 361
    else:
        rig_ld = measuring({"step_deg": 1}, world=measure)
        rig_ld.put(request(0x0301, 1, 0x0500))
        rig_ld.run(1_000_000_000)
        (profile,) = profiles(rig_ld, points=[360])
        assert profile.sectors[0].distances == [0] * 360
        assert profile.sectors[0].echoes == [0] * 360


@pytest.mark.parametrize("range_m", [1.0, 7.8125, 12.3456, 31.0])
def test_a_measured_wall_is_rounded_from_its_own_float64_range(tmp_path: Path, range_m: float) -> None:
    physics = {**QUIET, "rule": "axis"}
    measure = build(tmp_path, [plate(range_m, "white")], model="sick-lms291-s05", physics=physics)
    for unit, counts in UNITS.items():
        rig = Rig.on(measure=measure, unit=unit, measuring_mode="32m-field-a", resolution_deg=1)
        rig.ask("30 01")
        telegram = rig.await_reply(0xB0, 3.0)
        assert telegram is not None
        values = read_values(telegram)
        assert values is not None
        scan = measure(rig.plans[-1])
        found = np.floor(scan.range_m[:, 0] * counts + 0.5)
        want = np.where(found <= 2**15 - 10, found, 2**15 - 9)
        np.testing.assert_array_equal(values.values[70:111], want[70:111])
