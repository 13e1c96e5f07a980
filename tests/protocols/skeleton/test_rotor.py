"""The free rotor: its closed forms against sums over small steps, and turns that share out all samples."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest

from protocols.skeleton.instants import SECOND_NS, Raster
from protocols.skeleton.rotor import Rotor, Turns

ROTORS = {
    "steady": Rotor(5_000, 0.4, 10.0, 10.0, 0.3),
    "spins up": Rotor(5_000, 0.4, 10.0, 0.0, 0.3),
    "slows down": Rotor(5_000, 3.9, 5.0, 12.0, 0.5),
    "wobbles": Rotor(5_000, 0.4, 7.0, 7.0, 0.3, 0.05),
    "spins up and wobbles": Rotor(5_000, 0.4, 7.0, 0.0, 0.3, 0.2),
}


@pytest.mark.parametrize("rotor", ROTORS.values(), ids=list(ROTORS))
def test_the_angle_is_the_sum_of_the_speed(rotor: Rotor) -> None:
    at_ns = rotor.at_ns + (np.arange(200_000) + 0.5) * 1e4
    summed = rotor.turns + sum(rotor.speed_hz(int(one)) for one in at_ns) * 1e-5
    assert rotor.turned(rotor.at_ns + 2 * SECOND_NS) == pytest.approx(summed, abs=1e-6)
    assert rotor.turned_at(np.array([2.0]))[0] == pytest.approx(rotor.turned(rotor.at_ns + 2 * SECOND_NS), abs=1e-12)


@pytest.mark.parametrize("rotor", ROTORS.values(), ids=list(ROTORS))
@pytest.mark.parametrize("turns", [4.0, 4.5, 100.0, 1e6])
def test_the_instant_of_a_turn_is_the_inverse(rotor: Rotor, turns: float) -> None:
    assert rotor.turned(rotor.instant_of(turns)) == pytest.approx(turns, abs=1e-7)
    assert rotor.instant_of(rotor.turns - 1.0) == rotor.at_ns


def test_a_change_of_speed_goes_on_from_angle_and_speed() -> None:
    rotor = ROTORS["wobbles"]
    at_ns = 1_234_567_890
    other = rotor.driven(at_ns, 12.0)
    assert other.turned(at_ns) == rotor.turned(at_ns)
    assert other.speed_hz(at_ns) == pytest.approx(rotor.speed_hz(at_ns), rel=1e-12)
    assert other.speed_hz(at_ns + 10 * SECOND_NS) == pytest.approx(12.0, rel=0.06)


@pytest.mark.parametrize("rotor", ROTORS.values(), ids=list(ROTORS))
@pytest.mark.parametrize(("group", "since"), [(1, 0), (1, 777), (12, 0), (12, 777)])
def test_every_sample_belongs_to_one_turn(rotor: Rotor, group: int, since: int) -> None:
    turns = Turns(rotor, Raster(rotor.at_ns, Fraction(SECOND_NS, 4500)), since, group)
    numbers = range(turns.first, turns.first + 60)
    firsts = [turns.sample(number) for number in numbers]
    assert firsts[0] == since
    assert firsts == sorted(set(firsts))
    assert all((first - since) % group == 0 for first in firsts)
    for number, first in zip(numbers[1:], firsts[1:], strict=True):
        turned = rotor.turned(turns.samples.at(first))
        step = rotor.speed_hz(turns.samples.at(first)) / 4500
        assert number - 1e-9 <= turned < number + 1.1 * step * group, "the first whole group behind the zero mark"
    for number in numbers:
        assert turns.first_from(turns.at(number)) == number
        assert turns.first_from(turns.at(number) + 1) == number + 1
    assert turns.first_from(0) == turns.first


def test_samples_a_turn_follow_the_speed() -> None:
    for hz, count in ((5.0, 900), (10.0, 450), (13.0, 346)):
        turns = Turns(replace(ROTORS["steady"], hz=hz, from_hz=hz), Raster(5_000, Fraction(SECOND_NS, 4500)))
        assert abs(turns.sample(11) - turns.sample(10) - count) <= 1
        assert turns.period_ns == pytest.approx(1e9 / hz)
