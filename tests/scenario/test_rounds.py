"""A scenario that begins again: the second round looks as the first did, devices and times go on."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from emulator.commands.endings import Ending
from emulator.errors import ScenarioError
from emulator.judging.trial import Trial
from emulator.process.clock import ManualClock
from emulator.run_report.weather import steps
from emulator.runtime import assembly
from emulator.runtime.orders import Orders
from emulator.scenario import scenario
from emulator.world import scene
from tests.sensing.rig import plan as plan_of

CASE = """\
schema: 1
seed: 3
duration_s: 2
loop: true
world:
  - {plane: {size_m: [6, 60]}, at_m: [20, 0, 1], pitch_deg: -90, material: white_plaster}
actors:
  - id: box
    shape: {box: {size_m: [1, 1, 2]}}
    material: white_plaster
    motion: {at_m: [4, 0, 0], velocity_m_s: [5, 0, 0]}
weather:
  changes: [{t_s: 1.0, fog: {visibility_m: 30}}]
sensors:
  - {id: front, model: sick-lms291-s05, mount: {at_m: [0, 0, 1]}, links: ["loop:front"]}
"""


AZIMUTHS = tuple(range(-90, 91))


def load(text: str = CASE) -> scenario.Scenario:
    return scenario.loads(text, Path("case.yaml"))


@pytest.mark.parametrize("rounds", [1, 2, 1000])
def test_a_later_round_is_measured_as_the_first_but_for_its_noise(rounds: int) -> None:
    measure = assembly.build_measures(load())["front"]
    for begin_s in (0.0, 0.5, 1.5, 1.99):
        plan = plan_of(AZIMUTHS, start_s=begin_s)
        first = measure(plan)
        later = replace(plan, start_ns=plan.start_ns + rounds * 2_000_000_000)
        again = measure(later)
        np.testing.assert_array_equal(first.range_m, again.range_m)  # of one sweep number: the same draws too
        assert again.plan is later


def test_without_loop_the_box_is_gone() -> None:
    measure = assembly.build_measures(load(CASE.replace("loop: true", "loop: false")))["front"]
    plan = plan_of(AZIMUTHS, start_s=0.5)
    beam = len(plan) // 2
    assert measure(plan).range_m[beam, 0] == pytest.approx(6.0, abs=0.2)
    assert not measure(replace(plan, start_ns=2_500_000_000)).range_m[beam, 0] < 15.0


def test_the_first_round_is_sent_to_the_last_bit_as_without_loop() -> None:
    digests = set()
    for text in (CASE, CASE.replace("loop: true", "loop: false")):
        trial = Trial(load(text))
        try:
            digests.add(trial.finish().sha256)
        finally:
            trial.close()
    assert len(digests) == 1


def test_times_of_the_scene_are_those_of_its_round() -> None:
    world = scene.build(load())
    assert world.local_s(1.25) == 1.25
    assert world.local_s(-0.5) == -0.5
    assert world.local_s(2_000_000.75) == pytest.approx(0.75, abs=1e-8)
    assert world.turned_ns(3_999_999_999) == 2_000_000_000


def test_objects_and_their_truth_begin_again() -> None:
    text = CASE + "  - {id: radar, model: can-ars408, from: [front], links: ['loop:can']}\n"
    measure = assembly.build_measures(load(text))["radar"]
    plan = plan_of(AZIMUTHS, start_s=0.5)
    there = measure(plan).truth[0].position_m[0]  # type: ignore[attr-defined]
    again = measure(replace(plan, sweep=9, start_ns=4_500_000_000)).truth[0].position_m[0]  # type: ignore[attr-defined]
    assert there == pytest.approx(again, abs=1e-9)


def test_a_loop_wants_to_know_how_long_a_round_is() -> None:
    with pytest.raises(ScenarioError, match=r"case\.yaml:\d+: loop: True; want duration_s beside it"):
        load(CASE.replace("duration_s: 2\n", ""))


def test_weather_told_and_ordered_is_that_of_the_round() -> None:
    daemon, _ = assembly.start_virtual(load())
    try:
        orders = Orders(daemon, daemon.instruments, ManualClock(), load())
        daemon.power_on()
        daemon.advance(4_500_000_000)
        assert "fog" not in orders.weather({})["weather"]
        reported = orders.weather({"rain": {"rate_mm_h": 5}})["weather"]
        assert "fog" not in reported
        assert [round(change["t_s"], 6) for change in reported["changes"]] == [5.0]
        daemon.advance(5_200_000_000)
        assert orders.weather({})["weather"]["fog"]["visibility_m"] == 30
    finally:
        daemon.close()


def test_the_report_knows_the_weather_of_every_round() -> None:
    found = steps(load(), [], 5.5)
    assert [(step.t_s, any(step.values.values())) for step in found] == [
        (0.0, False), (1.0, True), (2.0, False), (3.0, True), (4.0, False), (5.0, True),
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("text", "duration_s", "until_ns", "reported"),
    [
        (CASE, None, None, "runs until it is stopped; the world begins again every 2 s"),
        (CASE, 5.0, 5_000_000_000, "ends after 5 s (--duration); the world begins again every 2 s"),
        (
            CASE.replace("loop: true", "loop: false"),
            None,
            2_000_000_000,
            "ends after 2 s (duration_s of the scenario); --loop begins the world again instead",
        ),
        (CASE.replace("loop: true\n", "").replace("duration_s: 2\n", ""), None, None, "runs until it is stopped"),
    ],
)
def test_a_run_says_when_it_will_end(text: str, duration_s: float | None, until_ns: int | None, reported: str) -> None:
    ending = Ending.of(load(text), duration_s)
    assert ending.until_ns == until_ns
    assert ending.reported() == reported
    assert ending.as_json()["ends_at_s"] == (None if until_ns is None else until_ns * 1e-9)


@pytest.mark.parametrize("name", ["bumper", "fog_objects", "street", "standard"])
def test_a_late_driver_finds_shipped_scenarios_as_the_first_one_did(name: str) -> None:
    config = scenario.load(name)
    assert Ending.of(config, None).at_s is None
    world = scene.build(config)
    assert world.local_s(1000 * config.duration_s + 1.0) == pytest.approx(1.0, abs=1e-6)  # type: ignore[operator]
