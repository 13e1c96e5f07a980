"""The free rotor: its closed forms against sums over small steps, and turns that share out all samples."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest

from protocols.skeleton.instants import SECOND_NS, Raster
from protocols.skeleton.rotor import LOAD_TURNS, LoadedRotor, Rotor, Turns

ROTORS = {
    "steady": Rotor(5_000, 0.4, 10.0, 10.0, 0.3),
    "spins up": Rotor(5_000, 0.4, 10.0, 0.0, 0.3),
    "slows down": Rotor(5_000, 3.9, 5.0, 12.0, 0.5),
    "wobbles": Rotor(5_000, 0.4, 7.0, 7.0, 0.3, 0.05),
    "spins up and wobbles": Rotor(5_000, 0.4, 7.0, 0.0, 0.3, 0.2),
}
LOADED = {
    "loaded": LoadedRotor(5_000, 0.4, 7.0, 7.0, 0.3, load=0.05),
    "loaded, spins up": LoadedRotor(5_000, 0.4, 7.0, 0.0, 0.3, load=0.02),
}
ALL = ROTORS | LOADED


@pytest.mark.parametrize("rotor", ROTORS.values(), ids=list(ROTORS))
def test_the_angle_is_the_sum_of_the_speed(rotor: Rotor) -> None:
    at_ns = rotor.at_ns + (np.arange(200_000) + 0.5) * 1e4
    summed = rotor.turns + sum(rotor.speed_hz(int(one)) for one in at_ns) * 1e-5
    assert rotor.turned(rotor.at_ns + 2 * SECOND_NS) == pytest.approx(summed, abs=1e-6)
    assert rotor.turned_at(np.array([2.0]))[0] == pytest.approx(rotor.turned(rotor.at_ns + 2 * SECOND_NS), abs=1e-12)


@pytest.mark.parametrize("rotor", ALL.values(), ids=list(ALL))
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


@pytest.mark.parametrize("rotor", ALL.values(), ids=list(ALL))
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


def test_a_load_swings_once_in_its_turns_and_is_carried_over_a_change_of_speed() -> None:
    rotor = LOADED["loaded"]
    since_s = np.linspace(0.0, 3.0, 5000)
    even = replace(rotor, load=0.0).turned_at(since_s)
    swing = rotor.turned_at(since_s) - even
    assert swing == pytest.approx(
        rotor.load * LOAD_TURNS / (2 * np.pi) * np.sin(2 * np.pi * even / LOAD_TURNS), abs=1e-9
    )
    at_ns = rotor.at_ns + 1_234_567_890
    assert rotor.turned(at_ns) == pytest.approx(rotor.turned_at(np.array([1.23456789]))[0], abs=1e-9)
    other = rotor.driven(at_ns, 0.0)
    assert other.turned(at_ns) == pytest.approx(rotor.turned(at_ns), abs=1e-12)
    assert other.speed_hz(at_ns + 10 * SECOND_NS) == pytest.approx(0.0, abs=1e-9)


def test_a_rotor_has_settled_when_it_is_near_its_speed() -> None:
    rotor = ROTORS["spins up"]
    assert rotor.speed_hz(rotor.settled_ns(0.05)) == pytest.approx(9.5, rel=1e-6)
    assert ROTORS["steady"].settled_ns(0.05) == ROTORS["steady"].at_ns


def test_turns_are_numbered_on_and_those_of_a_standing_rotor_have_a_fixed_length() -> None:
    rotor = LOADED["loaded"]
    samples = Raster(rotor.at_ns, Fraction(SECOND_NS, 1000))
    made, on = Turns(rotor, samples, 3456), Turns(rotor, samples, 3456, numbered=7)
    for ahead in range(5):
        assert on.sample(7 + ahead) == made.sample(made.first + ahead)
    assert on.first_from(made.at(made.first + 3)) == 10
    standing = Turns(rotor.driven(rotor.at_ns, 0.0), samples, 10, numbered=7, part=25)
    assert [standing.sample(number) for number in (7, 8, 9)] == [10, 35, 60]
    assert standing.period_ns == 25_000_000
    for instant_ns in (0, standing.at(7), standing.at(8) - 1, standing.at(8), standing.at(8) + 1):
        number = standing.first_from(instant_ns)
        assert standing.at(number) >= instant_ns
        assert number == 7 or standing.at(number - 1) < instant_ns
