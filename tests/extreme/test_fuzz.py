"""Scenarios drawn at random from what is allowed, with values at and near the ends of it, through `measure`.

Not rows of the specification: they look for what its rows forgot. Whatever is allowed gives numbers or no echo, in the
contract's shapes, the same twice to the last bit; whatever is not is refused by name.
"""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st

from emulator.casting import raycast
from emulator.errors import EmulatorError
from emulator.scenario import scenario
from emulator.sensing.measure import Measure
from emulator.sensing.measure import build as build_measure
from emulator.world import scene
from protocols.scan import DAZZLED, SATURATED, Scan, ScanPlan
from tests.draws import cases
from tests.sensing.rig import grey, plan

PHASES = [Phase.explicit, Phase.generate]
"No shrinking: it builds thousands of scenes and outlasts the test's time limit; the example as drawn says enough."

MODERATE = settings(
    max_examples=cases(40), derandomize=True, deadline=None, phases=PHASES, suppress_health_check=list(HealthCheck)
)


def ends(low: float, high: float) -> st.SearchStrategy[float]:
    """Numbers over all magnitudes between two, the ends among them."""
    floor = low if low > 0.0 else min(high, 1e-12)
    spread = st.floats(math.log10(floor), math.log10(high)).map(lambda x: min(max(10.0**x, low), high))
    return st.one_of(st.just(low), st.just(high), spread)


def either_sign(high: float) -> st.SearchStrategy[float]:
    return st.tuples(st.sampled_from([-1.0, 1.0]), ends(0.0, high)).map(lambda pair: pair[0] * pair[1])


ANGLE = st.one_of(st.sampled_from([0.0, 90.0, -90.0, 180.0, 1e-300, 89.9999]), st.floats(-360.0, 360.0))
PLACE = st.tuples(st.floats(-30.0, 60.0), st.floats(-30.0, 30.0), st.floats(-3.0, 3.0)).map(list)
MATERIAL = st.sampled_from(["white", "black", "shiny", "pane", "mirror", "sheet", "rough"])
MATERIALS = {
    "white": grey(1.0),
    "black": grey(0.0),
    "shiny": {"rho": 0.1, "model": "coated", "roughness": 0.02},
    "pane": {"rho": 0.02, "model": "glass", "index": 1.5},
    "mirror": {"rho": 0.0, "model": "mirror", "specular": 1.0},
    "sheet": {"rho": 0.1, "model": "retro", "retro_cd_lx_m2": 700.0},
    "rough": {"rho": 0.5, "model": "oren_nayar", "slope_rad": 0.5},
}
SHAPE = st.one_of(
    st.fixed_dictionaries(
        {"plane": st.fixed_dictionaries({"size_m": st.lists(ends(1e-9, 1e9), min_size=2, max_size=2)})}
    ),
    st.fixed_dictionaries(
        {"box": st.fixed_dictionaries({"size_m": st.lists(ends(1e-9, 1e4), min_size=3, max_size=3)})}
    ),
    st.fixed_dictionaries(
        {"sphere": st.fixed_dictionaries({"radius_m": ends(1e-9, 1e6), "segments": st.integers(4, 24)})}
    ),
    st.fixed_dictionaries(
        {
            "cylinder": st.fixed_dictionaries(
                {"radius_m": ends(1e-9, 1e6), "height_m": ends(1e-9, 1e6), "segments": st.integers(3, 24)}
            )
        }
    ),
)
TURNED = {"yaw_deg": ANGLE, "pitch_deg": ANGLE, "roll_deg": ANGLE}
ITEM = st.tuples(SHAPE, st.fixed_dictionaries({"at_m": PLACE, "material": MATERIAL, **TURNED})).map(
    lambda pair: {**pair[0], **pair[1]}
)
STEADY = st.fixed_dictionaries(
    {
        "at_m": PLACE,
        **TURNED,
        "velocity_m_s": st.lists(either_sign(1e5), min_size=3, max_size=3),
        "yaw_rate_deg_s": either_sign(1e6),
    }
)
WAYPOINTS = st.tuples(
    st.lists(ends(1e-9, 1e6), min_size=1, max_size=4, unique=True).map(sorted), st.lists(PLACE, min_size=4, max_size=4)
).map(lambda drawn: {"waypoints": [{"t_s": t, "at_m": at} for t, at in zip(*drawn, strict=False)]})
ACTOR = st.fixed_dictionaries({"shape": SHAPE, "material": MATERIAL, "motion": st.one_of(STEADY, WAYPOINTS)})
SEEN = st.fixed_dictionaries({"visibility_m": ends(1e-3, 1e9)})
WEATHER = st.fixed_dictionaries(
    {},
    optional={
        "visibility_m": ends(1e-3, 1e12),
        "fog": SEEN,
        "dust": SEEN,
        "smoke": SEEN,
        "rain": st.fixed_dictionaries({"rate_mm_h": ends(0.0, 300.0), "wets": st.booleans()}),
        "snow": st.fixed_dictionaries({"rate_mm_h": ends(0.0, 300.0)}),
        "sun": st.fixed_dictionaries({"azimuth_deg": ANGLE, "elevation_deg": st.floats(-90.0, 90.0)}),
        "plumes": st.lists(
            st.fixed_dictionaries(
                {"at_m": PLACE, "size_m": st.just([5.0, 5.0, 5.0]), "extinction_per_m": ends(1e-9, 1e3)}
            ),
            max_size=2,
        ),
    },
)
PHYSICS = st.fixed_dictionaries(
    {"sub_beams": st.integers(1, 40), "depth": st.integers(0, 2)},
    optional={
        "rule": st.sampled_from(["axis", "laguerre", "spiral", "grid", "adaptive"]),
        "profile": st.sampled_from(["gauss", "tophat"]),
        "divergence_deg": ends(0.0, 20.0),
        "roll_deg": ANGLE,
        "exit_diameter_mm": ends(0.0, 1e4),
        "pulse": st.just("sin2"),
        "pulse_fwhm_ns": ends(0.5, 1e3),
        "system_constant_m2": ends(1e-30, 1e30),
        "threshold_to_noise": ends(2.0, 1e12),
        "detection": st.sampled_from(["leading_edge", "constant_fraction", "peak", "centroid"]),
        "walk_table": st.booleans(),
        "echoes": st.sampled_from(["first", "strongest", "last", "all"]),
        "max_echoes": st.integers(1, 8),
        "range_noise_mm": ends(0.0, 1e6),
        "systematic_mm": either_sign(1e6),
        "near_gate_m": ends(0.0, 0.05),
        "gate_m": ends(0.1, 1e4),
        "full_scale_snr": ends(1e-3, 1e12),
        "recovery_ns": ends(0.0, 1e6),
        "floor_reflectance": ends(1e-12, 1e4),
        "noise": st.booleans(),
        "background": st.booleans(),
        "weather_echoes": st.booleans(),
        "bounces": st.integers(0, 2),
        "full": st.booleans(),
    },
)
MODEL = st.sampled_from(["paper-905nm", "sick-lms291-s05", "sick-ld-lrs1000"])


def loaded(text: dict[str, Any], folder: Path) -> Measure:
    """The measuring function of the sensor of this scenario."""
    config = scenario.loads(json.dumps(text), folder / "drawn.yaml")
    world = scene.build(config)
    return build_measure(config, world, raycast.Caster(world), "front")


def keeps_the_contract(scan: Scan, wanted: ScanPlan) -> None:
    """Shapes, types and what may stand where, as `protocols.scan` says."""
    n = len(wanted)
    k = scan.range_m.shape[1]
    assert k >= 1
    for array, shape, kind in (
        (scan.range_m, (n, k), np.float64),
        (scan.intensity, (n, k), np.float64),
        (scan.actor, (n, k), np.int32),
        (scan.flags, (n,), np.uint8),
    ):
        assert array.shape == shape
        assert array.dtype == kind
    seen = ~np.isnan(scan.range_m)
    assert np.array_equal(seen, ~np.isnan(scan.intensity))
    assert np.isfinite(scan.range_m[seen]).all()
    assert np.isfinite(scan.intensity[seen]).all()
    assert (scan.intensity[seen] >= 1.0).all()
    assert (scan.actor[~seen] == -1).all()
    assert not (scan.flags & ~np.uint8(DAZZLED | SATURATED)).any()
    assert not seen[(scan.flags & DAZZLED) != 0].any()
    assert (seen[:, :-1] >= seen[:, 1:]).all()  # no gap between echoes


def reported(error: EmulatorError, *places: str) -> None:
    """A refusal says where, and what is wanted."""
    assert any(place in str(error) for place in places), str(error)
    assert "want" in str(error)


def same(one: Scan, two: Scan) -> bool:
    return all(
        getattr(one, name).tobytes() == getattr(two, name).tobytes()
        for name in ("range_m", "intensity", "flags", "actor")
    )


@MODERATE
@given(
    world=st.lists(ITEM, max_size=4),
    actors=st.lists(ACTOR, max_size=2),
    weather=WEATHER,
    physics=PHYSICS,
    model=MODEL,
    mode=st.sampled_from(["operational", "operational", "seed"]),
    mount=st.fixed_dictionaries({"at_m": PLACE, **TURNED}),
    offset_m=st.sampled_from([0.0, 0.0, 5e6, -1e7]),
    azimuth_deg=st.lists(st.floats(-180.0, 180.0).map(lambda x: round(x, 9)), min_size=1, max_size=12),
    start_s=ends(0.0, 1e5),
    seed=st.integers(0, 2**62),
)
def test_whatever_is_allowed_keeps_the_contract_and_comes_twice_the_same(
    tmp_path: Path, world: Any, actors: Any, weather: Any, physics: Any, model: str, mode: str, mount: Any,
    offset_m: float, azimuth_deg: list[float], start_s: float, seed: int,
) -> None:  # fmt: skip
    for item in [
        *world,
        mount,
        *(point for one in actors for point in one["motion"].get("waypoints", [one["motion"]])),
    ]:
        item["at_m"] = [item["at_m"][0] + offset_m, item["at_m"][1] - offset_m, item["at_m"][2]]
    for number, one in enumerate(actors):
        one["id"] = f"actor{number}"
    text = {
        "schema": 1, "seed": seed, "world": world, "actors": actors, "weather": weather, "materials": MATERIALS,
        "sensors": [{"id": "front", "model": model, "mode": mode, "physics": physics, "mount": mount}],
    }  # fmt: skip
    fire = np.linspace(0.0, 0.013, len(azimuth_deg))
    wanted = plan(azimuth_deg, start_s=start_s, fire_s=fire, sweep=seed % 1000)
    try:
        measure = loaded(text, tmp_path)
    except EmulatorError as error:
        reported(error, "drawn.yaml:1: sensors.front.physics: ", "no area")  # allowed alone and not together
        return
    scan = measure(wanted)
    keeps_the_contract(scan, wanted)
    assert same(scan, measure(wanted))
    assert same(scan, loaded(text, tmp_path)(wanted))


@MODERATE
@given(
    range_m=st.one_of(ends(1e-9, 300.0), st.just(0.9), st.just(1.0)),
    tilt_deg=st.one_of(ends(1e-300, 89.999), st.just(0.0)),
    weather=WEATHER,
    physics=PHYSICS,
    seed=st.integers(0, 1000),
)
def test_a_plate_at_any_range_and_tilt_keeps_the_contract(
    tmp_path: Path, range_m: float, tilt_deg: float, weather: Any, physics: Any, seed: int
) -> None:
    wall = {"plane": {"size_m": [20.0, 100.0]}, "at_m": [range_m, 0.0, 0.0], "pitch_deg": -90.0, "yaw_deg": tilt_deg,
            "material": "white"}  # fmt: skip
    text = {
        "schema": 1, "seed": seed, "world": [wall], "weather": weather, "materials": MATERIALS,
        "sensors": [{"id": "front", "model": "paper-905nm", "physics": physics}],
    }  # fmt: skip
    wanted = plan([-45.0, -1e-9, 0.0, 1e-30, 45.0, 179.0])
    try:
        measure = loaded(text, tmp_path)
    except EmulatorError as error:
        reported(error, "drawn.yaml:1: sensors.front.physics: ")
        return
    scan = measure(wanted)
    keeps_the_contract(scan, wanted)
    assert same(scan, measure(wanted))


@settings(
    max_examples=cases(30), derandomize=True, deadline=None, phases=PHASES, suppress_health_check=list(HealthCheck)
)
@given(
    keys=st.dictionaries(
        st.sampled_from(sorted(json.loads(json.dumps(scenario.json_schema()))["$defs"]["PhysicsOptions"]["properties"])),
        st.one_of(
            st.floats(allow_nan=True, allow_infinity=True), st.integers(-(2**70), 2**70), st.booleans(), st.none(),
            st.text(max_size=4), st.lists(st.floats(), max_size=3),
        ),
        min_size=1, max_size=3,
    )
)  # fmt: skip
def test_any_value_of_a_choice_is_taken_or_refused_by_name(tmp_path: Path, keys: dict[str, Any]) -> None:
    keys.setdefault("sub_beams", 4)
    text = {
        "schema": 1, "materials": MATERIALS,
        "world": [{"plane": {"size_m": [9.0, 9.0]}, "at_m": [9.0, 0.0, 0.0], "pitch_deg": -90.0, "material": "white"}],
        "sensors": [{"id": "front", "model": "paper-905nm", "physics": keys}],
    }  # fmt: skip
    source = json.dumps(text).replace("-Infinity", "-.inf").replace("Infinity", ".inf").replace("NaN", ".nan")
    wanted = plan([0.0, 60.0])
    try:
        config = scenario.loads(source, tmp_path / "drawn.yaml")
        world = scene.build(config)
        measure = build_measure(config, world, raycast.Caster(world), "front")
    except EmulatorError as error:
        reported(error, "drawn.yaml:1: sensors.front.physics")
        return
    keeps_the_contract(measure(wanted), wanted)


@pytest.mark.parametrize("count", [0, 1, 2, 1000])
def test_a_plan_of_any_length_is_a_scan_of_that_length(tmp_path: Path, count: int) -> None:
    text = {"schema": 1, "materials": MATERIALS, "weather": {"fog": {"visibility_m": 50.0}, "sun": {}},
            "world": [{"sphere": {"radius_m": 9.0}, "material": "white"}],
            "sensors": [{"id": "front", "model": "sick-lms291-s05"}]}  # fmt: skip
    wanted = plan(np.linspace(-180.0, 180.0, count))
    scan = loaded(text, tmp_path)(wanted)
    if count == 0:
        assert scan.range_m.shape == (0, 1)
    keeps_the_contract(scan, wanted)


# ------------------------------------------------------------------------------- what was found, kept
@pytest.mark.parametrize("gate_m", [20.0, 1e4])
@pytest.mark.parametrize("method", ["leading_edge", "peak", "centroid", "constant_fraction"])
def test_a_medium_that_clips_beyond_its_window_is_measured(tmp_path: Path, gate_m: float, method: str) -> None:
    """Haze so strong under so good a receiver that the signal stays at its full scale where the window ends."""
    physics = {"rule": "axis", "system_constant_m2": 1e27,
               "full_scale_snr": 1e12, "threshold_to_noise": 20.0,
               "noise": False, "floor_reflectance": "off",
               "gate_m": gate_m, "pulse_fwhm_ns": 0.5, "detection": method}  # fmt: skip
    weather = {"fog": {"visibility_m": 1e9}, "smoke": {"visibility_m": 23.0}}
    text = {"schema": 1, "materials": MATERIALS, "weather": weather,
            "sensors": [{"id": "front", "model": "sick-lms291-s05", "physics": physics}]}  # fmt: skip
    wanted = plan([0.0, 10.0])
    scan = loaded(text, tmp_path)(wanted)
    keeps_the_contract(scan, wanted)
    assert (scan.flags & SATURATED).all()


@pytest.mark.parametrize("falling", ["rain", "snow"])
def test_more_single_drops_than_can_be_drawn_are_a_continuum_or_refused(tmp_path: Path, falling: str) -> None:
    physics = {"system_constant_m2": 1e30, "divergence_deg": 1.0}
    text: dict[str, Any] = {
        "schema": 1, "materials": MATERIALS, "weather": {falling: {"rate_mm_h": 1e-3}},
        "sensors": [{"id": "front", "model": "paper-905nm", "physics": physics}],
    }  # fmt: skip
    wanted = plan([0.0, 1.0])
    scan = loaded(text, tmp_path)(wanted)
    keeps_the_contract(scan, wanted)
    text["weather"][falling]["echoes"] = "drops"
    with pytest.raises(EmulatorError, match=rf"{falling}.echoes: drops, .* seen in a beam; want continuum or auto"):
        loaded(text, tmp_path)
