"""Clouds that a host read against slices that were measured: layer by layer, whichever echo was sent."""

from __future__ import annotations

import numpy as np
import pytest

from emulator.hosts.scans import HostCloud
from emulator.instrument.cloud_errors import largest
from emulator.instrument.series import MATCH_RAD, Measured
from protocols.scan import Floats

AZIMUTH, LAYERS = np.radians(np.arange(0.0, 20.0, 0.2)), np.radians([-3.0, 0.0, 2.0])


def slice_of(range_m: Floats, away_deg: float = 0.0) -> Measured:
    """`range_m` (3 layers, 100, k)."""
    n = range_m[..., 0].size
    azimuth = np.tile(AZIMUTH + np.radians(away_deg), 3)
    flat = range_m.reshape(n, -1)
    heights = np.repeat(LAYERS, len(AZIMUTH))
    return Measured(0, azimuth, flat[:, 0], np.zeros(n, np.int32), (), (), elevation_rad=heights, all_m=flat)


def cloud_of(range_m: Floats) -> HostCloud:
    heights = np.repeat(LAYERS, len(AZIMUTH))
    azimuth = np.tile(AZIMUTH, 3) + np.radians(0.004)  # as rounded on the wire
    return HostCloud(np.pi - (np.pi - azimuth) % (2 * np.pi), heights, range_m.ravel(), np.ones(range_m.size))


def ranges(echoes: int = 1) -> Floats:
    """Another range for each layer, beam and echo."""
    own = 5.0 + np.arange(3)[:, None, None] + 0.001 * np.arange(len(AZIMUTH))[None, :, None]
    return own + 10.0 * np.arange(echoes)


@pytest.mark.parametrize("layer", [0, 1, 2])
def test_an_error_of_one_beam_of_any_layer_is_found(layer: int) -> None:
    read = ranges()[..., 0].copy()
    assert largest(cloud_of(read), [slice_of(ranges())], MATCH_RAD) == pytest.approx(0.0, abs=1e-9)
    read[layer, 7] += 0.3
    assert largest(cloud_of(read), [slice_of(ranges())], MATCH_RAD) == pytest.approx(0.3)


def test_the_echo_that_was_sent_is_the_one_compared() -> None:
    assert largest(cloud_of(ranges(2)[..., 1]), [slice_of(ranges(2))], MATCH_RAD) == pytest.approx(0.0, abs=1e-9)
    assert largest(cloud_of(ranges()[..., 0] + 4.0), [slice_of(ranges(2))], MATCH_RAD) == pytest.approx(4.0)


def test_the_newest_slice_may_be_of_the_next_turn() -> None:
    moved = slice_of(ranges() + 1.0, away_deg=0.005)
    assert largest(cloud_of(ranges()[..., 0]), [slice_of(ranges()), moved], MATCH_RAD) == pytest.approx(0.0, abs=1e-9)


def test_of_beams_with_nearly_the_same_azimuth_the_nearest_range_is_the_one_compared() -> None:
    """Mirrors of a sensor differ: slices of two of them may be among those compared."""
    others = [slice_of(ranges() + 1.0, away_deg=at) for at in (0.003, 0.005)]
    newest = slice_of(ranges(), away_deg=9.0)
    assert largest(cloud_of(ranges()[..., 0]), [*others, slice_of(ranges()), newest], MATCH_RAD) == pytest.approx(0.0)


def test_beams_that_match_none_have_no_error() -> None:
    assert np.isnan(largest(cloud_of(ranges()[..., 0]), [slice_of(ranges(), away_deg=0.1)], MATCH_RAD))
    assert np.isnan(largest(cloud_of(ranges()[..., 0]), [], MATCH_RAD))


def points_of(seed: int, n: int = 400) -> tuple[Floats, Floats, Floats]:
    """Azimuth, elevation and range of points anywhere."""
    draw = np.random.default_rng(seed)
    return draw.uniform(-0.3, 0.3, n), draw.uniform(-0.2, 0.2, n), draw.uniform(5.0, 40.0, n)


def measured_of(azimuth: Floats, elevation: Floats, range_m: Floats) -> Measured:
    actor = np.zeros(len(range_m), np.int32)
    return Measured(0, azimuth, range_m, actor, (), (), elevation_rad=elevation, all_m=range_m[:, None])


@pytest.mark.parametrize("wrong", [0.0, 0.2])
def test_points_without_layers_are_compared_with_the_nearest_one_of_all_slices(wrong: float) -> None:
    azimuth, elevation, range_m = points_of(1)
    azimuth = azimuth + np.radians(0.03) * 5.0 / range_m  # millimetres of x and y are more nearby
    halves = [measured_of(*(part[half] for part in points_of(1))) for half in (slice(0, 200), slice(200, 400))]
    halves[0].range_m[7] = halves[0].echoes[7] = np.nan
    keep = np.arange(400) != 7
    read = range_m.copy()
    read[33] += wrong
    cloud = HostCloud(azimuth[keep], elevation[keep], read[keep], np.ones(399), layered=False)
    assert largest(cloud, halves, MATCH_RAD) == pytest.approx(max(wrong, 5.0 * np.radians(0.03)), rel=0.03)


def test_points_without_layers_of_beams_without_echoes_have_no_error() -> None:
    azimuth, elevation, range_m = points_of(2)
    nothing = measured_of(azimuth, elevation, np.full(400, np.nan))
    assert np.isnan(largest(HostCloud(azimuth, elevation, range_m, range_m, layered=False), [nothing], MATCH_RAD))
