"""Strips of smooth surfaces against pulses summed over half ellipses, planes by integration, and single pulses."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from emulator.compiled import switch
from emulator.sensing import strips
from emulator.sensing.measure import Measure
from emulator.world import triangles
from emulator.world.motion import Steady
from protocols.scan import ScanPlan
from tests.compiled.both import both
from tests.sensing.error_budget.scenes import body, measure_of
from tests.sensing.test_probing import of_bodies

Columns = np.ndarray[Any, np.dtype[np.float64]]


def wave(count: int, lead: float, at: Columns) -> Columns:
    """Sum of sin^2 pulses of FWHM 1 whose ranges are those of so many strips, by the distance from their mean."""
    place, share = strips.nodes(count)
    rise = at[:, None] + lead * place
    return np.asarray((share * np.where((rise > 0.0) & (rise < 2.0), np.sin(0.5 * math.pi * rise) ** 2, 0.0)).sum(1))


def first_at(level: Columns, signal: Columns, at: Columns) -> Columns:
    """Where it first reaches levels."""
    highest, own = np.unique(np.maximum.accumulate(signal), return_index=True)
    return np.interp(level, highest, at[own])


@pytest.mark.parametrize("count", strips.COUNTS)
def test_strips_are_the_gauss_rule_of_a_half_ellipse(count: int) -> None:
    """Its moments: of order 2 k the Catalan number over 4^k."""
    place, share = strips.nodes(count)
    assert (np.diff(place) < 0.0).all()
    for k in range(min(count, 12)):
        moment = math.comb(2 * k, k) / (k + 1) / 4.0**k
        assert math.fsum(share * place ** (2 * k)) == pytest.approx(moment, rel=1e-12)
        assert math.fsum(share * place ** (2 * k + 1)) == pytest.approx(0.0, abs=1e-14)


@pytest.mark.parametrize(("column", "count"), list(enumerate(strips.COUNTS)))
def test_crossings_shift_by_no_more_than_the_table_says(column: int, count: int) -> None:
    """Of 300 levels up to 0.9 of the top, leads from 4 thousandths of the FWHM to the longest allowed."""
    longest = count / strips.WIDE
    for lead in np.geomspace(0.004, longest, 12):
        at = np.unique(
            np.concatenate([-lead + np.geomspace(1e-5, 2.0 * lead + 2.0, 4000), np.linspace(-lead, 1, 3000)])
        )
        whole = wave(400, lead, at)
        top = int(whole.argmax())
        level = np.geomspace(3e-5, 0.9 * whole[top], 200)
        shift = np.abs(
            first_at(level, wave(count, lead, at), at) - first_at(level, whole[: top + 1], at[: top + 1])
        ) / lead  # fmt: skip
        foot = level / (0.5 * math.pi * lead) ** 2
        for row, least in enumerate(strips.FEET):
            most = math.inf if row == 0 else strips.FEET[row - 1]
            here = shift[(foot >= least) & (foot < most)]
            assert here.max(initial=0.0) <= strips.SHIFT[row, column] + 2e-5, (lead, row)


def test_a_short_lead_is_one_strip_a_long_one_many_and_the_longest_none() -> None:
    numbers = 0.75, 2.0, (1.5 / math.pi) ** 2 * 2.0, 2.5e-4
    lead = np.array([0.0, 1e-4, 0.01, 0.05, 0.3, 1.0, 2.5])
    found = strips.counts(lead, np.full(7, 70.0), numbers)
    assert found[0] == found[1] == 1
    assert found[-1] == 0
    assert (np.diff(found[:-1]) >= 0).all()
    assert found[-2] == strips.COUNTS[-1]


def ground(model: str, **options: Any) -> Measure:
    """A road below the sensor, as far as one sees."""
    road = body(0, triangles.plane(3000.0, 3000.0), 0, Steady(at_m=(0.0, 0.0, -1.9)))
    return measure_of(of_bodies(road), model, noise=False, weather_echoes=False, **options)


def downward(elevation_deg: Columns) -> ScanPlan:
    """Beams ahead."""
    n = len(elevation_deg)
    fired = np.linspace(0.0, 1e-3, n)
    return ScanPlan(
        0, 0, 0, np.full(n, 0.1), np.radians(elevation_deg), fired, 1e-3, max_range_m=200.0, max_echoes=4,
        wants_intensity=True,
    )  # fmt: skip


def integrated(measure: Measure, elevation_rad: float) -> float:
    """Range read by a sensor above a road, by integration over 61 x 240 places of its disc, written apart."""
    model = measure.model
    beam, pulse = model.beam, model.pulse
    edge, weight = np.polynomial.legendre.leggauss(61)
    radius = np.sqrt(0.5 * (edge + 1.0))[:, None]
    angle = np.linspace(0.0, 2.0 * np.pi, 240, endpoint=False)[None]
    share = np.broadcast_to(0.5 * weight[:, None] / 240.0, (61, 240)).ravel()
    u, v = (radius * np.cos(angle)).ravel(), (radius * np.sin(angle)).ravel()
    x, y = math.tan(beam.half_angle_x_rad) * u, math.tan(beam.half_angle_y_rad) * v
    down = -(math.sin(elevation_rad) + y * math.cos(elevation_rad)) / np.sqrt(1.0 + x * x + y * y)
    height = 1.9 + beam.exit_radius_m * v * math.cos(elevation_rad)
    r = height / down
    table = measure._dry.table
    back = table.back(np.zeros(len(r), np.int64), down)
    amplitude = share * model.k_m2 * back / (r * r + model.aperture_radius_m**2)
    amplitude *= np.exp(-2.0 * measure.air.at(0.0).extinction_per_m * r)
    order = np.argsort(r)
    r, amplitude = r[order], amplitude[order]

    def signal(at: float) -> float:
        rise = 0.5 * math.pi * (at - r + pulse.fwhm_m) / pulse.fwhm_m
        return float((amplitude * np.where((rise > 0.0) & (rise < math.pi), np.sin(rise) ** 2, 0.0)).sum())

    places = np.linspace(r[0] - pulse.fwhm_m, r[-1] + pulse.fwhm_m, 100)
    heights = np.array([signal(at) for at in places])
    top = float(heights.max())
    if top < model.threshold:
        return math.nan
    last = int(np.argmax(heights >= model.threshold))
    low, high = float(places[last - 1]), float(places[last])
    for _ in range(50):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if signal(middle) < model.threshold else (low, middle)
    walk = pulse.fwhm_m - 2.0 * pulse.fwhm_m / math.pi * math.asin(math.sqrt(model.threshold / top))
    return high + walk if model.walk_table else high


@pytest.mark.parametrize("model", ["ouster-os1-128", "velodyne-vls-128", "velodyne-vlp-16", "hesai-ot128"])
def test_a_road_is_as_far_as_by_integration(model: str) -> None:
    """From steep to grazing, within the half step that is allowed for what is not flat and a quarter for strips."""
    measure = ground(model)
    elevation = -np.array([25.0, 20.0, 15.0, 10.0, 8.0, 6.0, 5.0, 4.0, 3.0, 2.0])
    plan = downward(elevation)
    scan, view = measure(plan), measure.view(plan)
    found = [integrated(measure, math.radians(one)) for one in elevation]
    seen = np.isfinite(scan.range_m[:, 0])
    assert np.count_nonzero(seen) >= 6
    np.testing.assert_array_equal(seen, np.isfinite(found))
    assert view.plain is not None
    chosen = seen & view.plain
    assert np.count_nonzero(chosen) >= 6
    off = np.abs(scan.range_m[chosen, 0] - np.array(found)[chosen])
    assert off.max() <= 0.25 * measure.model.lsb_m + 1e-5, off


def test_steep_ground_costs_no_bundle() -> None:
    """Where the nearest edge of a spot of 7 cm is timed, nine rays are as good as many."""
    plan = downward(-np.linspace(10.0, 20.0, 64))
    view = ground("ouster-os1-128").view(plan)
    assert view.cast == 9 * 64
    assert view.plain is not None
    assert view.plain.all()
    assert len(view.seen.echoes) > 2 * 64


def test_loops_and_arrays_make_the_same_strips() -> None:
    pytest.importorskip("numba")
    plan = downward(-np.linspace(1.0, 25.0, 200))
    made = both(lambda: ground("ouster-os1-128").view(plan).seen.echoes)
    assert len(made[0]) == len(made[1]) > 200
    np.testing.assert_array_equal(made[0].beam, made[1].beam)
    np.testing.assert_allclose(made[0].range_m, made[1].range_m, rtol=1e-9)
    np.testing.assert_allclose(made[0].amplitude, made[1].amplitude, rtol=1e-8)


def test_strips_of_a_beam_come_the_nearest_first() -> None:
    with switch.switched(False):
        found = ground("hesai-ot128").view(downward(-np.linspace(1.0, 25.0, 200))).seen.echoes
    same = found.beam[1:] == found.beam[:-1]
    assert (np.diff(found.range_m)[same] > 0.0).all()
