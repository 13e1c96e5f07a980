"""`lidaremu explain`: every rule is told, with its switch, and what is told is what is done."""

from __future__ import annotations

import json

import pytest

from emulator import needs, triangles
from emulator.cli import main
from emulator.motion import Steady
from emulator.physics_options import PhysicsOptions
from emulator.scene import Scene
from tests.needs.scenes import body, measure_of, plan


def wall(x_m: float = 20.0, material: str = "asphalt") -> Scene:
    made = body(0, triangles.box(1.0, 100.0, 100.0), 0, Steady(at_m=(x_m, 0.0, -50.0)))
    return Scene(("world",), ("unknown",), (Steady(),), (material,), (made,))


def told(scene: Scene, model: str = "sick-ld-lrs1000", **options: object) -> dict[str, dict[str, object]]:
    return {row["term"]: row for row in needs.explained(measure_of(scene, model, **options), plan())}


def test_every_rule_is_told_for_every_sensor_with_and_without_full(capsys: pytest.CaptureFixture[str]) -> None:
    for more in ((), ("--full",), ("--quick",)):
        assert main(["explain", "flat_wall", "--json", *more]) == 0
        lines = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
        assert all([row["term"] for row in line["terms"]] == [rule.name for rule in needs.RULES] for line in lines)
        assert all(line["rays_per_beam"] >= 0.0 and line["sweep_ms"] > 0.0 for line in lines)


def test_explain_in_words_measures_what_rules_save(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["explain", "flat_wall"]) == 0
    text = capsys.readouterr().out
    assert "bundles of plain beams" in text
    assert "every rule off: 61.00 rays a beam" in text
    assert "saves 61.00 rays a beam" in text


def test_the_plan_is_that_of_the_device_in_the_scenario(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["explain", "standard", "--quick", "--json"]) == 0
    found = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert [(line["beams"], line["plan"]) for line in found] == [(1440, "actual"), (361, "actual")]
    assert found[0]["rays_per_beam"] < 6.1


def test_every_switch_is_a_key_of_physics() -> None:
    for rule in needs.RULES:
        if rule.switch != "-":
            node: object = PhysicsOptions()
            for key in rule.switch.split("."):
                assert hasattr(node, key)
                node = getattr(node, key)


def test_plain_beams_are_told_with_their_share_and_kept_with_full() -> None:
    assert told(wall())["bundles of plain beams"]["left_out"]
    assert not told(wall(), full=True)["bundles of plain beams"]["left_out"]


def test_surfaces_out_of_reach_are_left_out_and_are_not_seen_either_way() -> None:
    assert told(wall())["surfaces out of reach"]["left_out"]
    far = wall(400.0)
    assert not measure_of(far, "sick-ld-lrs1000")(plan()).actor.max() >= 0
    assert not measure_of(far, "sick-ld-lrs1000", full=True)(plan()).actor.max() >= 0
    assert not told(far, full=True)["surfaces out of reach"]["left_out"]


def test_background_light_and_noise_echoes_are_told_with_bound_and_margin() -> None:
    found = told(wall(), threshold_to_noise=12.0)
    assert found["background light"]["left_out"]
    assert found["noise echoes"]["left_out"]
    assert not told(wall(), threshold_to_noise=4.0)["noise echoes"]["left_out"]


def test_backscatter_of_clear_air_is_out_behind_a_gate_and_in_where_it_could_be_seen() -> None:
    assert told(wall(), near_gate_m=20.0)["backscatter of the air"]["left_out"]
    assert not told(wall(), full=True)["backscatter of the air"]["left_out"]


def test_second_rays_are_kept_where_there_is_glass() -> None:
    assert told(wall())["second rays"]["left_out"]
    assert not told(wall(material="window_glass"))["second rays"]["left_out"]
