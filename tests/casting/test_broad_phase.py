"""Moving bodies out of reach: none that comes into it is missed, however fast; the others cost nothing."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from emulator.casting import moving_cast
from emulator.casting.raycast import Caster
from emulator.world import broad_phase, triangles
from emulator.world.broad_phase import BroadPhase
from emulator.world.motion import Motion, Steady, Waypoints
from tests.casting.builders import fan, random_rays, scene_of
from tests.draws import cases

FASTEST = 1e5


def random_motion(rng: np.random.Generator) -> Motion:
    """Still, steady up to the limit of a scenario, turning, or along waypoints, with and without a jump at the end."""
    scale, speed = 10.0 ** rng.uniform(0.0, 4.0), 10.0 ** rng.uniform(-1.0, 5.0)
    at = rng.normal(size=3) * scale
    kind = int(rng.integers(4))
    if kind == 0:
        return Steady(tuple(at))
    if kind == 1:
        way = rng.normal(size=3)
        way *= min(speed, FASTEST) / np.linalg.norm(way)
        back = at - way * rng.uniform(-3.0, 3.0)
        return Steady(tuple(back), velocity_m_s=tuple(way), yaw_rate_deg_s=float(rng.choice([0.0, 200.0])))
    count = int(rng.integers(1, 6))
    t_s = np.cumsum(rng.uniform(0.01, 2.0, count)) - 2.0
    places = rng.normal(size=(count, 3)) * scale
    return Waypoints.through(list(t_s), [tuple(p) for p in places], [(0.0, 0.0, 0.0)] * count, bool(kind == 3))


@given(seed=st.integers(0, 10**9))
@settings(max_examples=cases(25), deadline=None)
def test_whatever_comes_into_reach_is_among_the_chosen(seed: int) -> None:
    rng = np.random.default_rng(seed)
    motions = [random_motion(rng) for _ in range(60)]
    radius = rng.uniform(0.0, 20.0, 60)
    found = BroadPhase(motions, radius)
    for _ in range(4):
        low = rng.normal(size=3) * 50.0
        high = low + rng.uniform(0.0, 40.0, 3)
        begin = float(rng.uniform(-1.5, 4.0))
        end = begin + float(rng.choice([0.0, 0.013, 1.7]))
        reach = float(rng.choice([0.0, 80.0, 2000.0]))
        chosen = found.within(low, high, reach, begin, end)
        times = np.linspace(begin, end, 400)
        for index, motion in enumerate(motions):
            place = motion.position(times)
            off = np.linalg.norm(np.maximum(np.maximum(low - place, place - high), 0.0), axis=1)
            if off.min() - radius[index] <= reach:
                assert index in chosen
        assert list(chosen) == sorted(set(chosen))


@given(seed=st.integers(0, 10**9))
@settings(max_examples=cases(10), deadline=None)
def test_a_scan_meets_what_it_meets_without_the_choice(seed: int) -> None:
    rng = np.random.default_rng(seed)
    ball, box = triangles.sphere(2.0, 12), triangles.box(4.0, 2.0, 1.5)
    shapes = [([ball, box][k % 2], random_motion(rng)) for k in range(40)]
    caster, whole = (Caster(scene_of(*shapes)) for _ in range(2))
    origin, direction = random_rays(800, seed, 2.0)
    with pytest.MonkeyPatch.context() as patch:
        for t_s in (-0.5, 0.3, 0.999, 2.0):
            times = t_s + np.linspace(0.0, 0.1, 800)
            eye = origin + rng.normal(size=3) * 30.0  # the sensor moves, too
            patch.setattr(broad_phase, "FEW", 4)
            got = caster.first_hits(eye, direction, times, max_range_m=90.0)
            patch.setattr(broad_phase, "FEW", 10**9)
            want = whole.first_hits(eye, direction, times, max_range_m=90.0)
            np.testing.assert_array_equal(got.range_m, want.range_m)
            np.testing.assert_array_equal(got.body, want.body)


def test_a_body_at_the_greatest_speed_is_met_at_its_instant() -> None:
    far = [(triangles.box(1.0, 1.0, 1.0), Steady((500.0 + 10.0 * k, 0.0, 0.0), velocity_m_s=(0.0, 1.0, 0.0)))
           for k in range(30)]  # fmt: skip
    # across the beam at 30 m at the instant 0.5005 s, 50 km away half a second before
    bullet = (triangles.box(1.0, 20.0, 4.0), Steady((30.0, -50_050.0, -2.0), velocity_m_s=(0.0, FASTEST, 0.0)))
    caster = Caster(scene_of(*far, bullet))
    direction = np.broadcast_to([1.0, 0.0, 0.0], (201, 3))
    times = np.linspace(0.5, 0.501, 201)
    hits = caster.first_hits(np.zeros((201, 3)), direction, times, max_range_m=80.0)
    met = times[np.isfinite(hits.range_m)]
    assert met.min() == pytest.approx(0.5005 - 1e-4, abs=6e-6)
    assert met.max() == pytest.approx(0.5005 + 1e-4, abs=6e-6)
    np.testing.assert_allclose(hits.range_m[np.isfinite(hits.range_m)], 29.5, atol=1e-9)


def test_far_bodies_are_looked_at_once_a_second(monkeypatch: pytest.MonkeyPatch) -> None:
    box = triangles.box(4.0, 2.0, 1.5)
    far = [(box, Steady((3000.0, 5.0 * k, 0.0), velocity_m_s=(0.0, 5.0, 0.0))) for k in range(2000)]
    caster = Caster(scene_of((triangles.plane(60.0, 60.0), Steady((9.0, 0.0, 0.0), pitch_deg=-90.0)), *far))
    choices, asked = [], []
    real = BroadPhase._chosen
    monkeypatch.setattr(BroadPhase, "_chosen", lambda self, *rest: choices.append(1) or real(self, *rest))
    monkeypatch.setattr(moving_cast, "may_meet", lambda *rest: asked.append(1) or (np.zeros(0, int),) * 2)
    for k in range(75):
        caster.first_hits(np.zeros(3), fan(361), 5.0 + k / 75.0 + np.linspace(0.0, 0.006, 361), max_range_m=90.0)
    assert len(choices) <= 2
    assert not asked


def test_equal_choices_are_the_same_array() -> None:
    motions = [Steady((100.0 * k, 0.0, 0.0), velocity_m_s=(1.0, 0.0, 0.0)) for k in range(50)]
    found = BroadPhase(motions, np.ones(50))
    eye = np.zeros(3)
    first = found.within(eye, eye, 250.0, 0.1, 0.2)
    assert found.within(eye + 3.0, eye + 3.0, 250.0, 0.5, 0.6) is first
    assert found.within(eye, eye, 247.3, 0.1, 0.2) is first  # what is left of it behind a mirror
    assert list(found.within(eye, eye, 250.0, 90.1, 90.2)) == [0, 1, 2]
    assert found.within(eye, eye, np.inf, 0.1, 0.2).size == 50
