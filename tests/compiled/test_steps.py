"""Each step by arrays and by compiled loops, on cases of its own."""

from __future__ import annotations

import ctypes
import threading
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from emulator.casting import embree, raycast
from emulator.casting.hits import Hits
from emulator.casting.raycast import Caster
from emulator.casting.structures import Content
from emulator.compiled import switch
from emulator.physics.cosines import split_cosines
from emulator.physics.detection import detect
from emulator.physics.detector import Detector, Echoes
from emulator.physics.pulse import Pulse
from emulator.physics.softprofile import SoftProfile
from emulator.physics.subechoes import SubEchoes
from emulator.world import triangles
from emulator.world.batched_poses import Cones, may_meet
from emulator.world.motion import Steady, Waypoints
from tests.casting.test_raycast import WALL, fan, moving_shapes, random_rays, scene_of
from tests.compiled.both import RANGE_M, both
from tests.draws import cases

pytest.importorskip("numba")

FEW = settings(max_examples=cases(60))
SOLIDS = triangles.box(1.0, 2.0, 1.0), triangles.sphere(1.8, 8)


# ------------------------------------------------------------------------------- rays
def same_hits(one: Hits, other: Hits, tied: int = 0) -> None:
    """But for rays that meet an edge of two triangles, of which either may be told."""
    differ = (one.body != other.body) | (one.face != other.face)
    assert np.count_nonzero(differ) <= tied
    for name in ("range_m", "actor", "material", "normal", "inner", "cosine"):
        a, b = (getattr(hits, name)[~differ] for hits in (one, other))
        np.testing.assert_allclose(a, b, rtol=1e-12, atol=1e-12, err_msg=name)
    np.testing.assert_allclose(one.range_m, other.range_m, atol=1e-5)


@given(seed=st.integers(0, 100_000))
@FEW
def test_rays_meet_the_same(seed: int) -> None:
    rng = np.random.default_rng(seed)
    shapes = [(triangles.plane(80.0, 80.0), Steady((0.0, 0.0, -3.0)))] if rng.random() < 0.5 else []
    for k in range(int(rng.integers(0, 90))):
        velocity = rng.normal(size=3) * float(rng.choice([0.0, 20.0]))
        # beyond 1000 m resting bodies are another group
        at = rng.normal(size=3) * float(rng.choice([6.0, 6.0, 1500.0]))
        turning = float(rng.choice([0.0, 90.0]))
        shapes.append((SOLIDS[k % 2], Steady(tuple(at), *rng.uniform(-90, 90, 3), tuple(velocity), turning)))
    origin, direction = random_rays(int(rng.choice([1, 3, 500, 9000])), seed, 0.5)
    times = float(rng.uniform(-1.0, 1.0)) + np.linspace(0.0, 0.1, len(origin))
    options = {"max_range_m": float(rng.choice([np.inf, 7.0])), "tnear_m": float(rng.choice([0.0, 1.0]))}
    hits = both(lambda: Caster(scene_of(*shapes)).first_hits(origin, direction, times, **options))
    same_hits(*hits, tied=2)


@pytest.mark.parametrize("far_m", [3.0, 0.3, 1000.1])
def test_what_lies_just_at_the_end_of_a_ray_is_met(far_m: float) -> None:
    """Of one kind of structure and of two: Embree leaves out what is just at the end, or the end rounds before it."""
    ground = (triangles.plane(80.0, 80.0), Steady((0.0, 0.0, -far_m)))
    direction = np.tile([0.0, 0.0, -1.0], (16, 1))
    for shapes in ([ground], [ground, (triangles.sphere(1.0, 8), Steady((20.0, 0.0, -far_m)))]):
        for hits in both(lambda: Caster(scene_of(*shapes)).first_hits(np.zeros(3), direction, 0.0, max_range_m=far_m)):  # noqa: B023
            np.testing.assert_allclose(hits.range_m, far_m, atol=1e-9)


def test_bodies_that_turn_stop_and_jump_are_met_alike() -> None:
    direction, times = fan(721, 170.0, -2.0), np.linspace(0.02, 0.16, 721)
    same_hits(*both(lambda: Caster(scene_of(*moving_shapes())).first_hits(np.zeros(3), direction, times)))


def test_bodies_between_waypoints_are_met_alike() -> None:
    path = Waypoints.through((1.0, 3.0), [(6.0, -4.0, -0.5), (6.0, 4.0, -0.5)], [(10.0, 0.0, 0.0)] * 2)
    direction, times = fan(721, 120.0, 1.0), np.linspace(1.9, 2.0, 721)
    shapes = [(triangles.box(1.0, 2.0, 1.0), path), (triangles.box(1.0, 2.0, 1.0), WALL)]
    one, other = both(lambda: Caster(scene_of(*shapes)).first_hits(np.zeros(3), direction, times))
    assert np.count_nonzero(one.body == 0) > 50
    same_hits(one, other)


def test_many_shapes_in_several_structures_are_met_alike() -> None:
    shapes = [
        (triangles.sphere(0.5 + 0.01 * k, 6), Steady((8.0 + k % 9, k - 50.0, -0.5), velocity_m_s=(0.0, 2.0, 0.0)))
        for k in range(100)
    ]
    direction, times = fan(3001, 120.0, -0.7), np.linspace(0.0, 0.1, 3001)
    one, other = both(lambda: Caster(scene_of(*shapes)).first_hits(np.zeros(3), direction, times))
    assert len(np.unique(one.body)) > 30
    same_hits(one, other)


def test_a_ground_in_a_group_of_its_own_lies_behind_what_stands_on_it() -> None:
    boxes = [(triangles.box(1.0, 2.0, 1.0), Steady((4.0 + k, 2.5 * k - 10.0, -2.0))) for k in range(9)]
    ground = (triangles.plane(6000.0, 6000.0), Steady((1500.0, 0.0, -2.0)))
    for shapes in ([*boxes, ground], [ground, *boxes]):
        one, other = both(lambda: Caster(scene_of(*shapes)).first_hits(np.zeros(3), fan(2001, 120.0, -9.0), 0.0))  # noqa: B023
        assert 1 < len(np.unique(one.body)) < 11
        same_hits(one, other)


def test_counts_of_casts_are_the_same() -> None:
    def counted() -> tuple[int, int, int, int]:
        caster = Caster(scene_of(*moving_shapes(), (triangles.plane(60.0, 60.0), WALL)))
        caster.first_hits(np.zeros(3), fan(721, 170.0, -2.0), np.linspace(0.02, 0.16, 721))
        counters = caster.counters
        return counters.rays, counters.cast, counters.suspicious, counters.leaks

    one, other = both(counted)
    assert one == other
    assert one[1] > 721


def test_behind_what_is_met_nothing_is_searched_for() -> None:
    """By loops: each ray of a fan meets the first of nine boxes that drive one behind the other."""

    def counted() -> tuple[Hits, int]:
        row = [(triangles.box(1.0, 2.0, 1.0), Steady((6.0 + 3.0 * k, 0.0, -0.5), velocity_m_s=(5.0, 0.0, 0.0)))
               for k in range(9)]  # fmt: skip
        caster = Caster(scene_of(*row))
        hits = caster.first_hits(np.zeros(3), fan(400, 3.0, 0.0), np.linspace(0.0, 0.01, 400))
        return hits, caster.counters.cast

    (one, arrays), (other, loops) = both(counted)
    same_hits(one, other)
    assert set(one.body) == {0}
    assert arrays == 9 * 400
    assert loops < 2 * 400


def test_bodies_that_turn_among_such_that_drive_are_met_alike_in_any_order() -> None:
    """Both kinds come in turn: rays on the first are done together, on the others one by one."""
    shapes = [
        (triangles.box(1.0, 2.0, 1.0), Steady((7.0 + 0.6 * k, k - 6.0, -0.5), velocity_m_s=(0.0, 3.0, 0.0),
                                              yaw_rate_deg_s=90.0 * (k % 2)))
        for k in range(12)
    ]  # fmt: skip
    direction, times = fan(3001, 90.0, -1.0), np.linspace(0.0, 0.1, 3001)
    for order in (shapes, shapes[::-1]):
        one, other = both(lambda: Caster(scene_of(*order)).first_hits(np.zeros(3), direction, times))  # noqa: B023
        assert len(np.unique(one.body)) > 10
        same_hits(one, other)


@pytest.mark.parametrize("width", [4, 8, 16])
def test_packets_of_every_width_meet_the_same(width: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Narrower ones are for processors with shorter registers."""
    from emulator.compiled import packets

    library = packets.library()
    assert library is not None
    function = ctypes.cast(getattr(library.call, f"rtcIntersect{width}"), ctypes.c_void_p).value
    monkeypatch.setattr(library, "width", width)
    monkeypatch.setattr(library, "function", function)
    origin, direction = random_rays(4001, 3, 0.5)
    shapes = [*moving_shapes(), (triangles.sphere(3.0, 60), Steady((4.0, 3.0, -3.0)))]
    one, other = both(lambda: Caster(scene_of(*shapes)).first_hits(origin, direction, 0.05))
    assert np.count_nonzero(one.body >= 0) > 500
    same_hits(one, other, tied=2)


@pytest.mark.parametrize("bad", [np.nan, np.inf, 1e300])
def test_a_ray_that_is_no_ray_meets_nothing_and_spoils_no_neighbour(bad: float) -> None:
    structure = embree.structure(Content(*box_at_the_origin()))
    origin = np.tile(np.array([[-5.0, 0.1, 0.2]], np.float32), (40, 1))
    ray = np.tile(np.array([[1.0, 0.0, 0.0]], np.float32), (40, 1))
    with np.errstate(over="ignore"):
        origin[7, 1], ray[21, 2] = np.float32(bad), np.float32(bad)
    triangle, distance = embree.run(structure, origin, ray, np.full(40, 100.0, np.float32))
    wrong = np.isin(np.arange(40), (7, 21))
    assert (triangle[wrong] == -1).all()
    assert (triangle[~wrong] >= 0).all()
    np.testing.assert_allclose(distance[~wrong], 4.5, atol=1e-5)


def test_rays_end_where_they_are_told() -> None:
    structure = embree.structure(Content(*box_at_the_origin()))
    origin = np.tile(np.array([[-5.0, 0.1, 0.2]], np.float32), (3, 1))
    ray = np.tile(np.array([[1.0, 0.0, 0.0]], np.float32), (3, 1))
    triangle, _ = embree.run(structure, origin, ray, np.array([4.4, 4.6, 1e30], np.float32))
    assert (triangle >= 0).tolist() == [False, True, True]


@pytest.mark.parametrize("far_group", [False, True])
def test_what_is_met_does_not_depend_on_the_order_of_the_search(far_group: bool) -> None:
    """Of one group of resting bodies and of two, more rays than a block has."""
    shapes = [*moving_shapes(), (triangles.plane(60.0, 60.0), WALL)]
    if far_group:
        shapes.append((triangles.sphere(40.0, 9), Steady((1500.0, 0.0, 0.0))))
    origin, direction = random_rays(raycast.BLOCK + 3000, 5, 0.5)
    parts = [np.random.default_rng(1).permutation(n) for n in (raycast.BLOCK, 3000)]
    order = np.concatenate([parts[0], raycast.BLOCK + parts[1]])
    one, other = (
        Caster(scene_of(*shapes)).first_hits(origin, direction, 0.05, max_range_m=2000.0, order=given)
        for given in (None, order)
    )
    assert np.count_nonzero(one.body >= 0) > 5000
    for name in vars(Hits.misses(0)):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name), err_msg=name)
    rays = np.array([7, 30, raycast.BLOCK + 9])
    np.testing.assert_array_equal(one.normals(rays), one.normal[rays])


def box_at_the_origin() -> tuple[np.ndarray, np.ndarray]:
    shape = triangles.box(1.0, 1.0, 1.0)
    return (shape.vertices - shape.centre).astype(np.float32), shape.faces.astype(np.int32)


def test_threads_may_cast_at_the_same_time() -> None:
    caster, direction = Caster(scene_of(*moving_shapes())), fan(5001, 170.0, -2.0)
    wanted = caster.first_hits(np.zeros(3), direction, 0.1)
    found: list[Hits] = []
    threads = [
        threading.Thread(target=lambda: found.append(caster.first_hits(np.zeros(3), direction, 0.1))) for _ in range(8)
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(found) == 8
    for hits in found:
        np.testing.assert_array_equal(hits.range_m, wanted.range_m)


@given(seed=st.integers(0, 100_000), spheres=st.integers(1, 40), kept=st.booleans())
@FEW
def test_pairs_that_may_meet_are_the_same(seed: int, spheres: int, kept: bool) -> None:
    rng = np.random.default_rng(seed)
    _, direction = random_rays(3000, seed, 0.1)
    centre, reach = rng.normal(size=(3, spheres)) * 10.0, rng.uniform(0.1, 12.0, spheres)
    known = np.where(rng.random(3000) < 0.3, np.inf, rng.uniform(0.0, 30.0, 3000))
    box, ray = (np.full(3, -0.1), np.full(3, 0.1)), np.ascontiguousarray(direction.T)
    cones = (lambda: Cones.of(ray)) if kept else None
    found = both(lambda: may_meet(centre, reach, box, ray, 25.0, known, cones))
    one, other = (set(zip(which.tolist(), rays.tolist(), strict=True)) for which, rays in found)
    assert not (one - other) or len(one) > 4096  # above that arrays look at them once more


# ------------------------------------------------------------------------------- echoes
PULSE = Pulse(16e-9)


def medium(extinction_per_m: float, bin_m: float, until_m: float) -> SoftProfile | None:
    return SoftProfile.of_medium(PULSE, bin_m, 4e5, extinction_per_m, extinction_per_m / 18.8, 0.3, 3.0, until_m)


def light(seed: int, beams: int = 40) -> SubEchoes:
    """Beams of one surface, of slopes, of several surfaces; near and far, faint and blinding."""
    rng = np.random.default_rng(seed)
    parts = []
    for beam in range(beams):
        for _ in range(int(rng.integers(0, 4))):
            count = int(rng.integers(1, 62))
            spread = float(rng.choice([0.0, 0.001, 0.3, 1.5, 6.0, 20.0]))
            near = float(rng.uniform(0.0, rng.choice([1.0, 40.0, 40.0])))
            r = near + spread * rng.random(count)
            share = rng.random(count) / count / 3.0
            a = float(10.0 ** rng.uniform(-1.0, 5.0) * (rng.random() > 0.05)) * share
            parts.append((np.full(count, beam), r, a, share, rng.integers(0, 5, count)))
    if not parts:
        return SubEchoes.none()
    return SubEchoes.of(*(np.concatenate(column) for column in zip(*parts, strict=True)))


def same_echoes(one: Echoes, other: Echoes) -> None:
    np.testing.assert_allclose(one.range_m, other.range_m, atol=RANGE_M)
    np.testing.assert_allclose(one.amplitude, other.amplitude, rtol=1e-6)
    np.testing.assert_array_equal(one.saturated, other.saturated)
    np.testing.assert_array_equal(one.source, other.source)


@given(
    seed=st.integers(0, 100_000),
    extinction=st.sampled_from([0.0, 2e-4, 0.005, 0.05]),
    sampled=st.booleans(),
    method=st.sampled_from(["leading_edge", "leading_edge", "peak", "centroid", "constant_fraction"]),
    noisy=st.booleans(),
    full_scale=st.sampled_from([np.inf, 50.0]),
)
@settings(max_examples=cases(250))
def test_echoes_are_the_same(
    seed: int, extinction: float, sampled: bool, method: str, noisy: bool, full_scale: float
) -> None:
    detector = Detector(
        PULSE, 5.0, method, sampled=sampled, full_scale=full_scale, max_echoes=4, shot_factor=0.01 * (seed % 2),  # type: ignore[arg-type]
    )  # fmt: skip
    found, beams = light(seed), 40
    # surfaces also stand behind where its tables end
    soft = medium(extinction, detector.bin_m, 12.0 if seed % 7 < 3 else 100.0) if extinction else None
    if soft is not None and seed % 3:
        soft = replace(soft, until_m=8.0, shows=bool(seed % 2), high_m=3.0)
    rng = np.random.default_rng(seed)
    normals = rng.normal(size=(beams, 4)) if noisy else None
    rms = rng.uniform(1.0, 1.5, beams) if seed % 5 == 0 else 1.0
    same_echoes(*both(lambda: detect(found, beams, detector, normals=normals, noise=rms, soft=soft)))


@given(
    seed=st.integers(0, 100_000),
    keep=st.sampled_from(["first", "strongest", "last", "all"]),
    max_echoes=st.integers(1, 5),
    recovery_s=st.sampled_from([0.0, 2e-8, 2e-7]),
    full_scale=st.sampled_from([np.inf, 50.0, 5.5]),
    floor_m2=st.sampled_from([0.0, 900.0]),
    gate=st.sampled_from([(0.0, np.inf), (3.0, 30.0)]),
    offset_m=st.sampled_from([None, 0.0, 0.7]),
    columns=st.sampled_from([0, 1, 3]),
    follows_noise=st.booleans(),
    bright=st.booleans(),
    false=st.booleans(),
)
@settings(max_examples=cases(200))
def test_what_is_reported_is_the_same(
    seed: int, keep: str, max_echoes: int, recovery_s: float, full_scale: float, floor_m2: float,
    gate: tuple[float, float], offset_m: float | None, columns: int, follows_noise: bool, bright: bool, false: bool,
) -> None:  # fmt: skip
    """Equal echoes, blinding ones and what comes after them, dazzled beams, noise, what touches the sensor."""
    rng, beams = np.random.default_rng(seed), 40
    detector = Detector(
        PULSE, 5.0, sampled=bool(seed % 2), keep=keep, max_echoes=max_echoes, recovery_s=recovery_s,  # type: ignore[arg-type]
        full_scale=full_scale, floor_m2=floor_m2, near_gate_m=gate[0], far_gate_m=gate[1],
        walk_table=offset_m is None, offset_m=offset_m or 0.0, shot_factor=0.02 * (seed % 3),
        follows_noise=follows_noise,
    )  # fmt: skip
    found = light(seed)
    if seed % 4 == 0 and len(found):  # all at one of few ranges, all as bright
        near = found.range_m.copy()
        parts = found.beam, np.round(near / 7.0) * 7.0, np.full(len(near), 400.0 / 61.0), found.blocked, found.source
        found = SubEchoes.of(*parts)
    options: dict[str, object] = {
        "normals": rng.normal(size=(beams, columns)) * 3.0 if columns else None,
        "noise": rng.uniform(1.0, 4.0, beams) if bright else 1.0,
        "dazzled": rng.random(beams) < 0.2 if bright else None,
        "soft": medium(0.02, detector.bin_m, 100.0) if seed % 5 == 0 else None,
    }
    if false:
        at = np.sort(rng.integers(0, beams, 30))
        options["noise_echoes"] = at, rng.uniform(0.0, 60.0, 30), rng.uniform(5.0, 6.0, 30)
    same_echoes(*both(lambda: detect(found, beams, detector, **options)))  # type: ignore[arg-type]


@pytest.mark.parametrize("keep", ["first", "strongest", "last"])
def test_thousands_of_echoes_in_a_beam_take_no_square_of_them(keep: str) -> None:
    """They are noise, in no order; a beam of 200 000 would take minutes if each were compared with each."""
    rng, count = np.random.default_rng(5), 200_000
    detector = Detector(PULSE, 5.0, keep=keep, max_echoes=3)  # type: ignore[arg-type]
    noise = (
        np.zeros(count, np.int64),
        np.round(rng.uniform(0.0, 60.0, count), 3),
        np.round(rng.uniform(5.0, 9.0, count), 4),
    )
    same_echoes(*both(lambda: detect(SubEchoes.none(), 1, detector, noise_echoes=noise)))


@given(seed=st.integers(0, 100_000))
@FEW
def test_short_clusters_are_the_same(seed: int) -> None:
    detector, found = Detector(PULSE, 5.0), light(seed)
    (one, rest), (other, left) = both(lambda: split_cosines(found, detector))
    assert len(rest) == len(left)
    for name in ("beam", "source", "start", "size"):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name), err_msg=name)
    for name in ("centre_m", "height", "first_m"):
        # arrays add up all clusters one after another, and lose digits of faint ones behind bright ones
        np.testing.assert_allclose(getattr(one, name), getattr(other, name), rtol=1e-6, err_msg=name)
    crossings: list[Callable[[], np.ndarray]] = [lambda c=c: c.crossing(0.3 * c.height) for c in (one, other)]  # type: ignore[misc]
    with switch.switched(False):
        arrays = crossings[0]()
    np.testing.assert_allclose(crossings[1](), arrays, atol=RANGE_M)


def test_what_both_must_know_stands_twice_alike() -> None:
    from emulator.compiled import arithmetic, casting
    from emulator.physics import arrays

    assert (casting.LONGEST, casting.LONGER) == (raycast.LONGEST, raycast.LONGER)
    assert (arithmetic._COS, arithmetic._SIN) == (arrays._COS, arrays._SIN)
