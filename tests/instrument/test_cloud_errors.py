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
