"""Drops and flakes in the whole path of a beam, against independent computations of the same numbers.

Of the cases of `particle_cases` those that differ in kind; `python -m tests.benchmarks.particle_oracles` runs all.
`one_particle_at_a_time` is a Monte Carlo that imports nothing of the product.
"""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from emulator.compiled import switch
from emulator.physics import world_particles
from emulator.physics.random_streams import RandomStreams
from emulator.physics.world_particles import Lines, WorldParticles, by_layers
from emulator.sensing.measure import Measure
from tests.sensing import particle_cases as cases
from tests.sensing.one_particle_at_a_time import Rig, first_echoes
from tests.sensing.particle_cases import Case, firsts, named, particle_light, sensor
from tests.sensing.rig import build, plan

Floats = NDArray[np.float64]


@pytest.mark.parametrize("case", named("particles_alone", "floor", "snow 5")[::7], ids=lambda case: case["name"])
def test_the_law_that_is_drawn_from_gives_what_one_particle_alone_does(case: Case) -> None:
    for row in cases.alone(case):
        assert row.ours == pytest.approx(row.oracle, rel=0.004, abs=1e-6), row.what


SUMS = [
    ("sick-ld-lrs1000 w0 10 mm gauss floor 0.004, dry snow 5", 4),
    ("sick-ld-lrs1000 w0 10 mm gauss floor 0.004, rain 20", 1),
    ("sick-ld-lrs1000 w0 10 mm gauss floor 0, rain 20", 8),
    ("sick-ld-lrs1000 w0 20 mm gauss floor 0.004, dry snow 5", 3),
    ("sick-ld-lrs1000 w0 10 mm tophat floor 0.004, dry snow 5", 4),
    ("sick-lms291-s05 w0 5 mm gauss floor 0.004, dry snow 5", 8),
    ("sick-lms291-s05 w0 5 mm gauss floor 0, rain 50", 8),
    ("sick-lms200-30106 w0 5 mm gauss floor 0, dry snow 5", 6),
    ("paper-905nm w0 0 mm gauss floor 0, dry snow 5", 5),
]
"Window, floor, profile, drops and flakes, sums that are far from single particles: each once; sweeps."


@pytest.mark.parametrize(("name", "sweeps"), SUMS)
def test_as_many_beams_answer_by_particles_as_an_independent_sum_of_their_light_says(name: str, sweeps: int) -> None:
    case = named("particles_sum", name)[0]
    share, *middle = cases.summed(case, sweeps)
    assert share.ours == pytest.approx(share.oracle, abs=4.0 * share.sigma + 0.01 * share.oracle)
    for row in middle:
        # what is reported of several flakes together is up to 0.3 of the pulse nearer than their maximum
        pulse_m = 0.5 * 299792458.0 * case["setup"]["parameters"]["tau"]
        assert row.ours == pytest.approx(row.oracle, abs=0.3 * pulse_m + 4.0 * row.sigma)


def test_one_particle_at_a_time_agrees_with_the_cases_and_with_the_product() -> None:
    name, sweeps = SUMS[2]
    case = named("particles_sum", name)[0]
    beams, p = 1500, case["expected"]["probability"]
    reported = first_echoes(Rig.of(case["setup"]), beams, case["expected"]["to_m"], seed=3)
    assert np.isfinite(reported).mean() == pytest.approx(p, abs=4.0 * math.sqrt(p * (1.0 - p) / beams))
    found = cases._answers(case["name"], sweeps, True, None)
    both = np.sqrt(p * (1.0 - p) * (1.0 / beams + 1.0 / len(found)))
    assert np.isfinite(found).mean() == pytest.approx(np.isfinite(reported).mean(), abs=4.0 * both + 0.01 * p)
    for share in (25.0, 75.0):
        mine, other = np.nanpercentile(found, share), np.nanpercentile(reported, share)
        assert mine == pytest.approx(other, rel=0.1, abs=0.2)


@pytest.mark.parametrize(("name", "sweeps"), [("lrs1000 floor 0, rain 20", 8), ("lms200-30106 floor 0, dry snow 5", 8)])
def test_noise_lifts_particles_over_the_threshold(name: str, sweeps: int) -> None:
    case = named("particles_noise", name)[0]
    for row in cases.lifted(case, sweeps, 1500):
        assert row.ours == pytest.approx(row.oracle, abs=4.0 * row.sigma), row.what
    noisy, quiet = (cases._answers(case["name"], sweeps, noise, 0.0) for noise in (True, False))
    assert np.isfinite(noisy).sum() > np.isfinite(quiet).sum()


@pytest.mark.parametrize(
    ("diameter_mm", "share"), [(0.0, 0.21), (20.0, 0.48)], ids=["no aperture", "aperture of 20 mm"]
)
def test_a_wider_window_makes_no_fewer_beams_of_an_ld_answer_in_rain(diameter_mm: float, share: float) -> None:
    """Of a beam alone, as the issue has it; together they are more."""
    case = {"setup": {**named("particles_sum", "lrs1000 w0 10 mm gauss floor 0, rain 50")[0]["setup"]}}
    measure = sensor(case, exit_diameter_mm=diameter_mm)
    found = np.isfinite(firsts(measure, 6)).mean()
    assert share - 0.03 < found < 1.45 * share


def test_the_near_gate_and_the_overlap_hold_for_drops_too(tmp_path: Path) -> None:
    rain = {"rain": {"rate_mm_h": 10.0}}
    physics = {
        "exit_diameter_mm": 0.0, "near_gate_m": 0.3, "noise": False, "floor_reflectance": "off", "rule": "axis",
        "echoes": "first",
    }  # fmt: skip
    measure = build(tmp_path, weather=rain, physics=physics, model="sick-lms291-s05")
    found = np.isfinite(firsts(measure, 20)).mean()
    assert found == pytest.approx(0.022, abs=0.007)


def test_a_sweep_of_particles_is_the_same_whenever_it_is_computed() -> None:
    case = named("particles_sum", "lrs1000 w0 10 mm gauss floor 0.004, dry snow 5")[0]
    one, other = sensor(case), sensor(case)
    plans = [plan(np.arange(50.0), sweep=k, start_s=0.1 * k) for k in range(3)]
    forwards = [one(each).range_m for each in plans]
    backwards = [other(each).range_m for each in reversed(plans)]
    for mine, others in zip(forwards, reversed(backwards), strict=True):
        np.testing.assert_array_equal(mine, others)


def test_the_number_of_other_beams_changes_no_particle() -> None:
    case = named("particles_sum", "lms291-s05 w0 5 mm gauss floor 0.004, dry snow 5")[0]
    measure = sensor(case)
    few, many = measure(plan(np.arange(10.0))).range_m, measure(plan(np.arange(100.0))).range_m
    np.testing.assert_array_equal(few, many[:10])
    assert RandomStreams(1, "front") == measure.draws


# ------------------------------------------------------------------------------- places in the world
@pytest.mark.parametrize(
    "name",
    ["lms291-s05 gauss floor 0.004 0.25 deg 0 ms", "lms291-s05 tophat floor 0.004 0.5 deg",
     "lrs1000 gauss floor 0.004 0.125 deg"],
)  # fmt: skip
def test_neighbouring_beams_see_the_same_flakes_by_the_overlap_of_their_footprints(name: str) -> None:
    (row,) = cases.neighbours(named("pair", name)[0], 8)
    assert row.ours == pytest.approx(row.oracle, abs=0.06)


@pytest.mark.parametrize(
    ("name", "late_s", "sweeps"),
    [("lms291-s05 at 5 m, wind 0 m/s, rain 20", "0.005", 8), ("lms291-s05 at 5 m, wind 0 m/s, rain 20", "0.0133333", 8),
     ("lms291-s05 at 5 m, wind 0 m/s, dry snow 5", "0.0133333", 8), ("lrs1000 at 5 m, wind 10 m/s", "0.001", 30)],
)  # fmt: skip
def test_the_next_sweep_sees_what_fell_or_was_blown_on(name: str, late_s: str, sweeps: int) -> None:
    (row,) = cases.later(named("time", name)[0], late_s, sweeps)
    assert row.ours == pytest.approx(row.oracle, abs=0.09)


@pytest.mark.parametrize(
    ("kind", "name", "sweeps"),
    [("pair", "lms291-s05 gauss floor 0.004 0.25 deg 0 ms", 8), ("pair", "lrs1000 gauss floor 0.004 0.125", 3),
     ("pair", "lms291-s05 gauss floor 0 0.25 deg 0 ms, rain 20", 8), ("time_detection", "lms291-s05 after 0.01", 8)],
)  # fmt: skip
def test_what_one_particle_alone_makes_two_beams_answer_has_its_closed_form(kind: str, name: str, sweeps: int) -> None:
    for row in cases.both_answer(named(kind, name)[0], sweeps):
        assert row.ours == pytest.approx(row.oracle, abs=4.0 * row.sigma), row.what


def test_two_sensors_and_one_that_drives_see_the_same_flakes(tmp_path: Path) -> None:
    case = named("pair", "lms291-s05 gauss floor 0.004 0.25 deg 0 ms")[0]
    setup = case["setup"]
    physics = {"noise": False, "floor_reflectance": "off", "rule": "axis"}
    own, other = (
        build(tmp_path, weather=setup["weather"], physics=physics, model=model, mount={"at_m": [x, 0.0, 1.0]})
        for model, x in (("sick-lms291-s05", 0.0), ("sick-lms200-30106", -0.5))
    )
    assert own.draws.seed == other.draws.seed
    found, missed = 0, 0
    for start_s in np.arange(20.0):
        one, two = (m.view(plan([0.0], start_s=start_s)).echoes for m in (own, other))
        # the second stands half a metre behind the first and looks along the same line, with a tenth of the light
        bright = one.range_m[(one.amplitude > 8.0) & (one.range_m > 1.0)]
        near = [np.abs(two.range_m - (r + 0.5)).min(initial=9.0) < 2e-3 for r in bright]
        found, missed = found + sum(near), missed + len(near) - sum(near)
    assert found > 15
    assert missed < 0.2 * found


def test_shadows_make_what_stands_behind_flicker_about_its_mean() -> None:
    case = named("transmission_cone", "ld-lrs1000", "rain 50")[0]
    mean, spread = cases.shadows(case, 3, threshold_to_noise=0.3, floor_reflectance="off")
    assert mean.ours == pytest.approx(mean.oracle, abs=4.0 * mean.sigma)
    # those too small to be drawn are missing, and the disc is small against the beam
    assert 0.75 * spread.oracle < spread.ours < 1.1 * spread.oracle


@pytest.mark.parametrize("case", named("transmission_cone"), ids=lambda case: case["name"])
def test_the_flicker_of_particles_that_are_not_drawn_is_bounded(case: Case) -> None:
    """If none is drawn it is that of the case, but for discs that are not small against the beam."""
    measure, path_m = sensor(case), case["setup"]["path_m"]
    light = particle_light(measure)
    none = dataclasses.replace(light, share=1e30).shadow_left_out(path_m)
    assert none == pytest.approx(case["expected"]["relative_std"], rel=0.03)
    assert light.shadow_left_out(path_m) < none
    now = measure.air.at(0.0)
    reported = measure._falling.shadow_left_out(
        now.particles[0], np.array([0.5 * path_m, path_m, np.inf]), now.extinction_per_m
    )
    assert reported == pytest.approx(2.0 * light.shadow_left_out(path_m))


# ------------------------------------------------------------------------------- every way to the same particles
def fan(moved_m_s: float, turns: int = 4) -> Lines:
    """Beams of a scanner that drives and turns; neighbours of a sweep of interlaced turns are 13 ms apart."""
    n = 160
    at = 0.004 * np.arange(n)
    late = (np.arange(n) % turns) / 75.0 + at / (2.0 * math.pi * 75.0)
    heading = at + 0.4 * late
    axis = np.stack([np.cos(heading), np.sin(heading), 0.01 * np.sin(9.0 * at)], axis=1)
    centre = np.stack([3.0 + moved_m_s * late, np.full(n, -2.0), 1.0 + 0.2 * late], axis=1)
    axis /= np.linalg.norm(axis, axis=1)[:, None]
    return Lines(centre, axis, None, 5.0 + late, np.full(n, 12.0))


def one_by_one(of: WorldParticles, light: Any, lines: Lines) -> list[tuple[int, float, float]]:
    """Particles of each beam, looked for without its neighbours."""
    found = []
    for k in range(0, len(lines.axis), 4):
        part = {f.name: getattr(lines, f.name) for f in dataclasses.fields(lines) if getattr(lines, f.name) is not None}
        drawn = of.in_beams(light, Lines(**{"across": None, **{name: a[k : k + 1] for name, a in part.items()}}))
        assert drawn is not None
        found += [(k, float(r), float(s)) for _, r, s in zip(*drawn, strict=True)]
    return sorted(found)


@pytest.mark.parametrize(
    ("name", "speed_m_s"), [("0.004, dry snow 5", 0.0), ("0.004, dry snow 5", 50.0), ("0, rain 50", 10.0)]
)
def test_beams_of_a_sensor_that_drives_see_what_each_of_them_sees_alone(name: str, speed_m_s: float) -> None:
    measure = sensor(named("particles_sum", f"lms291-s05 w0 5 mm gauss floor {name}")[0])
    now, lines = measure.air.at(0.0), fan(speed_m_s)
    light = dataclasses.replace(particle_light(measure), share=0.1)
    of = WorldParticles(1, "snow", light.sizes, now.particles[0].fall_m_s, (2.0, -1.0, 0.0))
    drawn = of.in_beams(light, lines)
    assert drawn is not None
    together = sorted((int(b), float(r), float(s)) for b, r, s in zip(*drawn, strict=True) if b % 4 == 0)
    assert len(together) > 20
    np.testing.assert_allclose(together, one_by_one(of, light, lines), rtol=1e-9)


def lasers(each: int = 40) -> Lines:
    """Eight layers of which neighbours fire far apart, as in a Velodyne."""
    elevation = np.radians(np.tile([-15.0, 1.0, -13.0, 3.0, -11.0, 5.0, -9.0, 7.0], each))
    azimuth = 0.0035 * np.arange(each).repeat(8)
    level = np.cos(elevation)
    axis = np.stack([level * np.cos(azimuth), level * np.sin(azimuth), np.sin(elevation)], axis=1)
    late = 2.3e-6 * np.arange(8 * each)
    centre = np.stack([3.0 + 20.0 * late, np.full(8 * each, -2.0), np.full(8 * each, 4.0)], axis=1)
    return Lines(centre, axis, None, 5.0 + late, np.full(8 * each, 12.0))


@pytest.mark.parametrize("sorted_", [False, True])
def test_lasers_that_look_far_apart_see_what_each_of_them_sees_alone(sorted_: bool) -> None:
    measure = sensor(named("particles_sum", "lms291-s05 w0 5 mm gauss floor 0.004, dry snow 5")[0])
    now, light, lines = measure.air.at(0.0), particle_light(measure), lasers()
    if sorted_:
        lines = dataclasses.replace(lines, own_axis=lines.axis)
    of = WorldParticles(1, "snow", light.sizes, now.particles[0].fall_m_s, (2.0, -1.0, 0.0))
    drawn = of.in_beams(light, lines)
    assert drawn is not None
    together = sorted((int(b), float(r), float(s)) for b, r, s in zip(*drawn, strict=True) if b % 4 == 0)
    assert len(together) > 20
    np.testing.assert_allclose(together, one_by_one(of, light, lines), rtol=1e-9)


def test_beams_are_looked_at_by_layers_where_these_are_fired_by_turns() -> None:
    axis = lasers().axis
    order = by_layers(axis)
    assert order is not None
    layer = np.round(axis[order, 2], 6)
    assert np.count_nonzero(np.diff(layer)) == 7
    assert by_layers(axis[order]) is None
    assert by_layers(fan(0.0).axis) is None
    assert by_layers(axis[:1]) is None


def test_a_sweep_that_was_seen_from_elsewhere_changes_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    """Boxes are kept from sweep to sweep for beams that stand to each other as before, wherever they are."""
    measure = sensor(named("particles_sum", "lms291-s05 w0 5 mm gauss floor 0.004, dry snow 5")[0])
    light, sizes = particle_light(measure), particle_light(measure).sizes
    lines = fan(10.0)
    with switch.switched(False):  # loops keep none
        known, fresh = (WorldParticles(1, "snow", sizes, 1.0, (0.0, 0.0, 0.0)) for _ in range(2))
        walls = np.linspace(3.0, 12.0, 160)
        moved = dataclasses.replace(
            lines, centre_m=lines.centre_m + np.array([7.3, -1.1, 0.4]), t_s=lines.t_s + 3.7, far_m=walls
        )
        known.in_beams(light, lines)
        one = known.in_beams(light, moved)
        assert len(known._kept) == 1
        other = fresh.in_beams(light, moved)
        assert one is not None
        assert other is not None
        assert len(one[0]) > 300
        for mine, others in zip(one, other, strict=True):
            np.testing.assert_array_equal(mine, others)
        turned = dataclasses.replace(moved, axis=np.ascontiguousarray(moved.axis[::-1]))
        known.in_beams(light, turned)
        assert len(known._kept) == 2
        monkeypatch.setattr(world_particles, "BOXES_KEPT", 10)
        known.in_beams(light, dataclasses.replace(turned, t_s=turned.t_s[::-1].copy()))
        assert len(known._kept) == 1


@pytest.mark.parametrize("parts", [("lms291-s05 w0 5 mm gauss floor 0.004, dry snow 5",), ("tophat", "dry snow 5")])
def test_arrays_and_loops_find_the_same_particles(monkeypatch: pytest.MonkeyPatch, parts: tuple[str, ...]) -> None:
    measure = sensor(named("particles_sum", *parts)[0], divergence_deg=[0.6, 0.3], roll_deg=20.0)
    sweep = plan(np.arange(40.0), start_s=3.0, fire_s=0.01 * np.arange(40.0))
    one = measure.view(sweep).echoes
    monkeypatch.setattr(WorldParticles.in_beams.pair, "on", False)  # type: ignore[attr-defined]
    other = measure.view(sweep).echoes
    assert len(one) > 100
    np.testing.assert_array_equal(one.beam, other.beam)
    np.testing.assert_allclose(one.range_m, other.range_m, rtol=1e-12)
    np.testing.assert_allclose(one.amplitude, other.amplitude, rtol=1e-9)


def test_where_the_world_has_too_many_each_beam_draws_its_own_by_the_same_law(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    case = named("particles_sum", "lms291-s05 w0 5 mm gauss floor 0, dry snow 5")[0]
    monkeypatch.setattr(world_particles, "MOST_PAIRS", 100)
    measure = sensor(case)
    found = np.isfinite(firsts(measure, 10))
    assert found.mean() == pytest.approx(case["expected"]["probability"], abs=0.025)


def test_the_mean_of_the_lost_light_is_that_of_the_particles_one_by_one() -> None:
    case = named("transmission_cone", "lms291-s05 w0 5 mm, dry snow")[0]
    measure = sensor(case, floor_reflectance="off")
    now = measure.air.at(0.0)
    light = particle_light(measure)
    lost = []
    for sweep in range(10):
        seen = measure._falling.seen(
            now.particles[0],
            *_rays(measure, sweep),
            np.full(cases.BEAMS, 20.0),
            now.extinction_per_m,
            sweep,
            measure.draws,
        )
        assert seen is not None
        kept = np.exp(2.0 * np.bincount(seen.beam, seen.lost, minlength=cases.BEAMS))
        lost.append(kept)
    together = np.concatenate(lost)
    error = together.std() / math.sqrt(len(together))
    assert together.mean() == pytest.approx(math.exp(-float(light.mean_shadow(np.array(20.0)))), abs=5.0 * error)


def _rays(measure: Measure, sweep: int) -> tuple[Any, Floats, Floats]:
    n = cases.BEAMS
    view = measure.view(plan(np.arange(float(n)), sweep=sweep, start_s=9.0 * sweep))
    return view.rays, np.full(n, 9.0 * sweep), np.broadcast_to(np.eye(3), (n, 3, 3))


def wandering(seed: int) -> Lines:
    """Oval beams that turn to and fro, some twice the same way, of a sensor that is thrown about."""
    rng = np.random.default_rng(seed)
    n = 300
    heading, rise = (rng.normal(0.0, 0.02, n) * (rng.random(n) < 0.9)).cumsum(), rng.normal(0.0, 0.004, n).cumsum()
    axis = np.stack([np.cos(rise) * np.cos(heading), np.cos(rise) * np.sin(heading), np.sin(rise)], axis=1)
    across = np.cross(axis, [0.0, 0.0, 1.0])
    late = 2e-4 * np.arange(n)
    centre = np.array([3.0, -2.0, 1.0]) + (rng.normal(size=3) * 30.0) * late[:, None] + 0.02 * rng.normal(size=(n, 3))
    across /= np.linalg.norm(across, axis=1)[:, None]
    return Lines(centre, axis, across if seed % 2 else None, 5.0 + late, rng.uniform(2.0, 12.0, n))


def close_layers() -> Lines:
    """Layers as close as the columns, which fire one after another on a sensor that drives; walls between."""
    azimuth, elevation = (part.ravel() for part in np.meshgrid(np.arange(40) * 0.008, np.arange(32) * 0.008 - 0.12))
    level = np.cos(elevation)
    axis = np.stack([level * np.cos(azimuth), level * np.sin(azimuth), np.sin(elevation)], axis=1)
    late = azimuth / (2.0 * math.pi * 10.0)
    centre = np.array([3.0, -2.0, 4.0]) + late[:, None] * np.array([20.0, 3.0, 0.0])
    return Lines(centre, axis, None, 5.0 + late, np.where(elevation < 0.0, 4.0, 12.0))


def stare(speed_m_s: float, count: int = 400) -> Lines:
    """Beams that all look the same way, of a sensor that drives across."""
    t_s = np.linspace(0.0, 0.4, count)
    centre = speed_m_s * t_s[:, None] * np.array([0.0, 1.0, 0.0])
    return Lines(centre, np.tile([1.0, 0.0, 0.0], (count, 1)), None, 5.0 + t_s, np.full(count, 8.0))


@pytest.mark.parametrize(
    "lines", [close_layers(), stare(0.0), stare(15.0)], ids=["layers", "one way", "one way, driving"]
)
def test_loops_find_the_particles_of_beams_that_lie_close_that_arrays_find(lines: Lines) -> None:
    pytest.importorskip("numba")
    light = particle_light(sensor(named("particles_sum", "lms291-s05 w0 5 mm gauss floor 0.004, dry snow 5")[0]))
    of, found = WorldParticles(3, "snow", light.sizes, 1.0, (2.0, -1.0, 0.0)), []
    for loops in (False, True):
        with switch.switched(loops):
            drawn = of.in_beams(light, lines)
        assert drawn is not None
        order = np.lexsort(drawn[1::-1])
        found.append([column[order] for column in drawn])
    assert len(found[0][0]) > 1000
    np.testing.assert_array_equal(found[0][0], found[1][0])
    np.testing.assert_allclose(found[0][1:], found[1][1:], rtol=1e-9)


@pytest.mark.parametrize("seed", range(6))
def test_loops_pass_over_no_beam_that_a_particle_is_in(seed: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Nor over a cell: arrays look at all cells of a box, and at all beams near a particle."""
    pytest.importorskip("numba")
    parts = ("tophat", "dry snow 5") if seed % 2 else ("lms291-s05 w0 5 mm gauss floor 0.004, dry snow 5",)
    light, lines = particle_light(sensor(named("particles_sum", *parts)[0])), wandering(seed)
    of = WorldParticles(seed, "snow", light.sizes, 1.0, (2.0, -1.0, 0.0))
    found = []
    for loops in (False, True):
        with switch.switched(loops):
            assert (switch.kernels() is not None) == loops
            drawn = of.in_beams(light, lines)
        assert drawn is not None
        order = np.lexsort(drawn[1::-1])
        found.append([column[order] for column in drawn])
    assert len(found[0][0]) > 100
    np.testing.assert_array_equal(found[0][0], found[1][0])
    np.testing.assert_allclose(found[0][1:], found[1][1:], rtol=1e-9)
    monkeypatch.setattr(world_particles, "MOST_PAIRS", 1000)
    for loops in (False, True):
        with switch.switched(loops):
            assert of.in_beams(light, lines) is None
