"""An Ouster in a scene of closed form: where beams begin, near-infrared of the sun, from the scenario to a scan."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from emulator.runtime import assembly
from emulator.scenario import scenario
from protocols.scan import Scan
from tests.protocols.ouster.rig import Rig

TEXT = """
schema: 1
seed: 3
world:
  - {box: {size_m: [0.5, 400, 400]}, at_m: [10.25, 0, -200], material: white_plaster}
WEATHER
sensors:
  - {id: top, model: MODEL, physics: {noise: false, rule: axis}, links: ["udp:127.0.0.1:7502"]}
"""


def measured(model: str, weather: str = "", elevation_deg: float = 30.0) -> Scan:
    """One slice that looks ahead."""
    text = TEXT.replace("MODEL", model)
    config = scenario.loads(text.replace("WEATHER", weather.replace("ELEVATION", str(elevation_deg))), Path("x.yaml"))
    measure = assembly.build_measures(config)["top"]
    rig = Rig({"config": {"lidar_mode": "512x10", "azimuth_window": [176_000, 184_000]}}, model)
    rig.run(0.1)
    plan = next(one for one in rig.plans if len(one))
    return measure(plan)


@pytest.mark.parametrize("model", ["ouster-os0-32", "ouster-os2-128"])
def test_ranges_count_from_where_beams_begin(model: str) -> None:
    scan = measured(model)
    plan = scan.plan
    assert plan.origin_m is not None
    assert np.linalg.norm(plan.origin_m, axis=1).min() > 0.013
    forward = np.cos(plan.azimuth_rad) * np.cos(plan.elevation_rad)
    expected = (10.0 - plan.origin_m[:, 0]) / forward
    near = expected < 20.0
    assert near.sum() > 100
    assert np.abs(scan.range_m[near, 0] - expected[near]).max() < 0.003


SUN = "weather: {sun: {total_w_m2: 1370, azimuth_deg: 180, elevation_deg: ELEVATION}}"


def test_ambient_light_is_that_of_the_lit_wall() -> None:
    assert measured("ouster-os1-32").ambient_w is None  # without a sun
    low, high = (measured("ouster-os1-32", SUN, deg).ambient_w for deg in (20.0, 70.0))
    assert low is not None
    assert high is not None
    wall = slice(None)
    assert (low[wall] > 0.0).all()
    assert np.ptp(low[wall]) < 1e-3 * low[wall].max()  # one plane in one light
    assert low[wall].mean() > 1.3 * high[wall].mean()  # the sun stands behind the sensor: low it meets the wall square
