"""`lidaremu explain`: every rule is reported, with its switch, and the report is what a sweep does."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest

from emulator.casting import raycast
from emulator.commands.cli import main
from emulator.physics.subechoes import SubEchoes
from emulator.scenario import scenario
from emulator.scenario.weather import WeatherConfig
from emulator.sensing import closed, error_budget, particles, receiver
from emulator.sensing.faint import looked_at
from emulator.sensing.measure import build as build_measure
from emulator.sensors.physics_options import PhysicsOptions
from emulator.sensors.spec import load_spec
from emulator.world import scene, triangles
from emulator.world.motion import Steady
from emulator.world.scene import Scene
from tests.sensing.error_budget.scenes import body, measure_of, plan

HAZE = WeatherConfig.model_validate({"visibility_m": 2000.0})


def wall(x_m: float = 20.0, material: str = "asphalt", yaw_deg: float = 0.0) -> Scene:
    made = body(0, triangles.box(1.0, 100.0, 100.0), 0, Steady(at_m=(x_m, 0.0, -50.0), yaw_deg=yaw_deg))
    return Scene(("world",), ("unknown",), (Steady(),), (material,), (made,))


def reported(
    world: Scene, model: str = "sick-ld-lrs1000", weather: WeatherConfig | None = None, **options: object
) -> dict[str, dict[str, object]]:
    return {row["term"]: row for row in error_budget.explained(measure_of(world, model, weather, **options), plan())}


def numbers(row: dict[str, object]) -> tuple[float, float]:
    value, bound = row["value"], row["bound"]
    assert isinstance(value, float)
    assert isinstance(bound, float)
    return value, bound


def test_every_rule_is_told_for_every_sensor_with_and_without_full(capsys: pytest.CaptureFixture[str]) -> None:
    for more in ((), ("--full",), ("--quick",)):
        assert main(["explain", "flat_wall", "--json", *more]) == 0
        lines = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
        assert all(
            [row["term"] for row in line["terms"]] == [rule.name for rule in error_budget.RULES] for line in lines
        )
        assert all(line["rays_per_beam"] >= 0.0 and line["sweep_ms"] > 0.0 for line in lines)


def test_explain_in_words_measures_what_rules_save(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["explain", "flat_wall"]) == 0
    text = capsys.readouterr().out
    assert "footprint sub-rays" in text
    assert "; all rules off: 61.00 rays, " in text
    (line,) = [line for line in text.splitlines() if line.startswith("  ray casts on static bodies ")]
    assert "left out" in line
    assert line.split()[-2] == "61.00"


def test_the_plan_is_that_of_the_device_in_the_scenario(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["explain", "standard", "--quick", "--json"]) == 0
    found = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert [(line["beams"], line["plan"]) for line in found] == [(1440, "actual"), (361, "actual")]
    assert found[0]["rays_per_beam"] < 6.1


def test_every_switch_is_a_key_of_physics() -> None:
    for rule in error_budget.RULES:
        if rule.switch != "-":
            node: object = PhysicsOptions()
            for key in rule.switch.split("."):
                assert hasattr(node, key)
                node = getattr(node, key)


def test_plain_beams_are_told_with_their_share_and_kept_with_full() -> None:
    assert reported(wall())["footprint sub-rays"]["left_out"]
    assert not reported(wall(), full=True)["footprint sub-rays"]["left_out"]


def test_surfaces_out_of_reach_are_left_out_and_are_not_seen_either_way() -> None:
    assert reported(wall())["surfaces beyond the gate"]["left_out"]
    far = wall(400.0)
    assert not measure_of(far, "sick-ld-lrs1000")(plan()).actor.max() >= 0
    assert not measure_of(far, "sick-ld-lrs1000", full=True)(plan()).actor.max() >= 0
    assert not reported(far, full=True)["surfaces beyond the gate"]["left_out"]


def test_background_light_and_noise_echoes_are_told_with_bound_and_margin() -> None:
    found = reported(wall(), threshold_to_noise=12.0)
    assert found["background light"]["left_out"]
    assert found["noise false alarms"]["left_out"]
    assert not reported(wall(), threshold_to_noise=4.0)["noise false alarms"]["left_out"]


def test_backscatter_of_clear_air_is_out_behind_a_gate_and_in_where_it_could_be_seen() -> None:
    assert reported(wall(), near_gate_m=20.0)["atmospheric backscatter"]["left_out"]
    assert not reported(wall(), full=True)["atmospheric backscatter"]["left_out"]


def test_second_rays_are_kept_where_there_is_glass() -> None:
    assert reported(wall())["secondary rays"]["left_out"]
    assert not reported(wall(material="window_glass"))["secondary rays"]["left_out"]


# ------------------------------------------------------------------------------- what is told is what is done
@pytest.mark.parametrize("visibility_m", [2000.0, 1e6])
def test_as_many_faint_reflections_are_told_as_the_receiver_drops(
    visibility_m: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A black wall within what fog is followed to stops the fog's light, so its reflections stay; in clear air not."""
    text = f"""{{"schema": 1, "materials": {{"black": {{"rho": 1.0e-7, "model": "lambert"}}}},
        "weather": {{"visibility_m": {visibility_m}}},
        "world": [{{"box": {{"size_m": [0.2, 60, 30]}}, "at_m": [30, 0, -15], "material": "black"}},
                  {{"box": {{"size_m": [0.2, 600, 30]}}, "at_m": [-20, 0, -15], "material": "concrete"}}],
        "sensors": [{{"id": "s", "model": "sick-ld-lrs1000"}}]}}"""
    loaded = scenario.loads(text, Path("faint.yaml"))
    world = scene.build(loaded)
    measure = build_measure(loaded, world, raycast.Caster(world), "s")
    beams = error_budget.usual_plan(load_spec("sick-ld-lrs1000"))
    dropped = []

    def seen(found: SubEchoes, *more: object) -> SubEchoes:
        kept = looked_at(found, *more)  # type: ignore[arg-type]
        dropped.append((len(found) - len(kept), len(found)))
        return kept

    monkeypatch.setattr(receiver, "looked_at", seen)
    measure(beams)
    row = {row["term"]: row for row in error_budget.explained(measure, beams)}["weak reflections"]
    gone = sum(pair[0] for pair in dropped)
    assert str(row["saves"]).startswith(f"{gone} of {sum(pair[1] for pair in dropped)} reflections")
    assert row["left_out"] == (gone > 0) == (visibility_m > 1e4)


@pytest.mark.parametrize("rain", [{}, {"drop_radius_mm": 1.0}])
def test_rain_that_is_seen_less_than_once_in_a_thousand_sweeps_is_told_as_left_out(rain: dict[str, float]) -> None:
    for rate_mm_h, left_out in ((1e-7, True), (20.0, False)):
        weather = WeatherConfig.model_validate({"rain": {"rate_mm_h": rate_mm_h, "echoes": "drops", **rain}})
        row = reported(wall(), "sick-lms291-s05", weather, floor_reflectance="off")["precipitation particles"]
        value, bound = numbers(row)
        assert row["left_out"] is left_out
        assert not row["idle"]
        assert (0.0 < value < bound) is left_out
        assert bound == particles.RARE
    assert reported(wall())["precipitation particles"]["idle"]


def test_the_mean_number_of_drops_that_is_told_is_that_of_those_drawn() -> None:
    weather = WeatherConfig.model_validate({"rain": {"rate_mm_h": 100.0, "echoes": "drops"}})
    measure = measure_of(wall(), "sick-lms291-s05", weather, floor_reflectance="off")
    row = {row["term"]: row for row in error_budget.explained(measure, plan())}["precipitation particles"]
    # so far apart that all have fallen by; neighbouring beams see the same ones, so that counts scatter more
    views = [measure.view(replace(plan(sweep=k), start_ns=20_000_000_000 * k)) for k in range(300)]
    drawn = [len(view.echoes) - len(view.seen.echoes) for view in views]
    mean, _ = numbers(row)
    assert abs(sum(drawn) / 300 - mean) < 4.0 * (4.0 * mean / 300) ** 0.5
    assert mean > 0.1


EXACT = {"acceleration-structure rebuild", "ray casts on static bodies", "backscatter tables", "outputs not requested"}
"Left out without anything to compare."


@pytest.mark.parametrize("weather", [{}, {"visibility_m": 500.0}, {"rain": {"rate_mm_h": 5.0}}])
@pytest.mark.parametrize("options", [{}, {"full": True}, {"pulse": "gauss"}, {"detection": "peak"}])
def test_whatever_is_left_out_has_a_value_and_a_bound_or_is_exact(
    weather: dict[str, object], options: dict[str, object]
) -> None:
    for material in ("asphalt", "window_glass"):
        chosen = WeatherConfig.model_validate(weather)
        for name, row in reported(wall(30.0, material), "sick-ld-lrs1000", chosen, **options).items():
            assert row["exact"] == (row["value"] is None) == (row["bound"] is None)
            if row["left_out"] and not row["idle"]:
                assert row["exact"] == (name in EXACT)
                assert row["exact"] or row["unit"]


def test_plane_moments_are_told_by_the_largest_shift_of_beams_that_have_their_echo_from_them(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    spare_room, step_m = {"closed_form": "always"}, measure_of(wall(), "sick-ld-lrs1000").model.lsb_m
    row = reported(wall(), leave_out=spare_room)["sub-ray ranges on planes"]
    value, bound = numbers(row)
    assert row["left_out"]
    assert 0.0 < value <= bound == pytest.approx(closed.SHIFT_LSB * step_m)
    monkeypatch.setattr(closed, "SHIFT_LSB", 0.5 * value / step_m)
    fewer, _ = numbers(reported(wall(), leave_out=spare_room)["sub-ray ranges on planes"])
    assert 0.0 < fewer <= 0.5 * value


def test_clusters_are_told_by_the_longest_that_is_not_sampled() -> None:
    straight, steep = (reported(wall(yaw_deg=yaw))["waveform sampling"] for yaw in (0.0, 60.0))
    (short, bound), (long, _) = numbers(straight), numbers(steep)
    assert 0.0 < short < bound
    assert 0.0 < long <= bound
    assert bound == pytest.approx(measure_of(wall(), "sick-ld-lrs1000").model.pulse.half_support_m)


def test_backscatter_that_is_followed_is_told_by_what_is_left_out_of_it() -> None:
    """The largest share of its bound lies where it is left out first, so it is just below."""
    row = reported(wall(), weather=HAZE)["atmospheric backscatter"]
    value, bound = numbers(row)
    assert row["left_out"]
    assert "nearer, it shifts surface echoes" in str(row["saves"])
    assert 0.9 * bound < value <= bound
    whole = reported(wall(), weather=HAZE, pulse="gauss")["atmospheric backscatter"]
    value, bound = numbers(whole)
    assert not whole["left_out"]
    assert value > bound
    shown = reported(wall(), "sick-lms291-s05", WeatherConfig.model_validate({"visibility_m": 10.0}),
                 floor_reflectance="off")["atmospheric backscatter"]  # fmt: skip
    value, bound = numbers(shown)
    assert not shown["left_out"]
    assert value > bound


def test_second_rays_are_told_by_the_best_surface_behind() -> None:
    near = reported(wall(material="window_glass"))["secondary rays"]
    value, bound = numbers(near)
    assert not near["left_out"]
    assert value > bound
    some = str(near["saves"]).split()
    assert int(some[0]) < int(some[2])
    weak = reported(wall(material="window_glass"), system_constant_m2=1.0)["secondary rays"]
    value, bound = numbers(weak)
    assert weak["left_out"]
    assert not weak["idle"]
    assert 0.0 < value < bound
    count = str(weak["saves"]).split()
    assert count[0] == count[2] != "0"


def test_surfaces_out_of_reach_are_told_with_the_last_range_of_an_echo() -> None:
    value, bound = numbers(reported(wall())["surfaces beyond the gate"])
    assert plan().max_range_m < value < bound


def test_surfaces_out_of_reach_are_told_as_kept_where_one_more_ray_for_their_light_costs_more() -> None:
    sun = WeatherConfig.model_validate({"sun": {"azimuth_deg": 180.0, "elevation_deg": 30.0}})
    for x_m, left_out in ((20.0, True), (400.0, False)):
        row = reported(wall(x_m), "sick-lms291-s05", sun)["surfaces beyond the gate"]
        assert row["left_out"] is left_out
        assert str(row["saves"]).startswith("0 rays") is not left_out


def test_plain_beams_are_counted_not_rounded_up_to_all() -> None:
    """Of 720 beams two see the edges of a wall."""
    made = body(0, triangles.box(1.0, 100.0, 100.0), 0, Steady(at_m=(20.0, 0.0, -50.0)))
    world = Scene(("world",), ("unknown",), (Steady(),), ("asphalt",), (made,))
    measure = measure_of(world, "sick-ld-lrs1000", leave_out={"closed_form": "always"})
    beams = plan(720, 179.75)
    row = {row["term"]: row for row in error_budget.explained(measure, beams)}["footprint sub-rays"]
    plain = measure.view(beams).plain
    assert plain is not None
    assert 716 <= plain.sum() < 720
    assert str(row["saves"]).endswith(f"; {plain.sum()} of 720 beams see a single plane")


def table(capsys: pytest.CaptureFixture[str], *more: str) -> tuple[str, list[str]]:
    assert main(["explain", "flat_wall", *more]) == 0
    head, *lines = capsys.readouterr().out.splitlines()
    return head, lines


def test_by_default_a_term_is_one_line_in_columns_under_a_header(capsys: pytest.CaptureFixture[str]) -> None:
    head, (header, *lines) = table(capsys, "--quick")
    assert head.startswith("front (sick-lms291-s05): 361 beams per sweep; ")
    assert len(lines) == len(error_budget.RULES)
    at = {name: header.index(name) for name in ("term", "decision", "unit")}
    until = {name: header.index(name) + len(name) for name in ("value", "bound", "saved: rays per beam")}
    for rule, line in zip(error_budget.RULES, lines, strict=True):
        cells = line.split("  ")
        assert line[at["term"] : at["decision"]].strip() == rule.name
        assert line[at["decision"] :].startswith(("kept ", "left out ", "not present "))
        assert line[: until["value"]].endswith("exact") == line[: until["bound"]].endswith("-")
        assert line[until["value"] :].startswith("  ")
        assert line[: until["saved: rays per beam"]].endswith("-")
        assert all(len(cell) <= 30 for cell in cells)


def test_the_reasons_stand_under_why(capsys: pytest.CaptureFixture[str]) -> None:
    _, short = table(capsys, "--quick")
    _, (_, *lines) = table(capsys, "--quick", "--why")
    for number, rule in enumerate(error_budget.RULES):
        line, why, decided = lines[3 * number : 3 * number + 3]
        assert line.startswith(f"  {rule.name} ")
        assert why == f"      why: {rule.why}"
        assert decided.startswith(f"      decided: {rule.when}; saves: ")
        assert decided.endswith(f"; switch: {rule.switch}")
        assert not any(rule.why in one for one in short)


def test_what_a_kept_term_would_save_stands_in_brackets(capsys: pytest.CaptureFixture[str]) -> None:
    _, (_, *lines) = table(capsys)
    kept = [line for line in lines if " kept " in line]
    (line,) = [line for line in kept if line.startswith("  footprint sub-rays ")]
    assert all(cell.startswith("(") and cell.endswith(")") for cell in line.split()[-2:])
    assert not any("(" in line for line in lines if " left out " in line)


def test_a_scenario_without_a_sensor_that_sees_beams_says_so(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["explain", "flat_wall", "--set", "sensors=[]"]) == 0
    reported = capsys.readouterr()
    assert reported.out == ""
    assert "no sensor of this scenario measures with beams" in reported.err
