"""What the benchmark of layers says of other casters: the same triangles, the same rays."""

from __future__ import annotations

import numpy as np
import pytest

from emulator.casting.raycast import Caster
from emulator.scenario import scenario
from emulator.world import scene
from tests.benchmarks.other_casts import OTHERS, agreeing, finer


def test_embreex_alone_meets_what_we_meet_and_triangles_cut_into_four_change_nothing() -> None:
    world = scene.build(scenario.load("velodyne_street"))
    fine = finer(world, 20_000)
    assert sum(len(body.faces) for body in fine.bodies) == 4 * sum(len(body.faces) for body in world.bodies)
    azimuth, up = np.meshgrid(np.radians(np.arange(0.0, 360.0, 1.7)), np.radians(np.arange(-24.5, 16.0, 2.0)))
    level = np.cos(up)
    direction = np.stack([level * np.cos(azimuth), level * np.sin(azimuth), np.sin(up)], axis=-1).reshape(-1, 3)
    origin_m, t_s = np.array([4.0, -1.75, 1.9]), 0.8
    origins_m = np.broadcast_to(origin_m, direction.shape).copy()
    ranges_m = [Caster(one).first_hits(origins_m, direction, t_s).range_m for one in (world, fine)]
    assert agreeing(*ranges_m) == 1.0
    cast, read = OTHERS["embreex"](fine, t_s, origin_m, direction)
    theirs_m = read(cast())
    assert 0.4 < np.isfinite(theirs_m).mean() < 0.9
    assert agreeing(ranges_m[0], theirs_m) == 1.0
    late, read = OTHERS["embreex"](fine, t_s + 0.1, origin_m, direction)
    assert agreeing(ranges_m[0], read(late())) < 1.0  # cars and people have gone on


def test_two_that_meet_nothing_agree_and_one_that_does_not() -> None:
    ours_m = np.array([5.0, np.nan, np.nan, 5.0])
    assert agreeing(ours_m, np.array([5.0009, np.inf, 5.0, np.inf])) == pytest.approx(0.5)
