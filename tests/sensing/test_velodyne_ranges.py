"""A Velodyne in a scene of closed form, from the scenario to its bytes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from emulator.runtime import assembly
from emulator.scenario import scenario
from protocols.scan import Scan, ScanPlan
from protocols.velodyne import codec
from protocols.velodyne.models import MODELS
from tests.protocols.velodyne.rig import Rig, firings, packets

TEXT = """
schema: 1
seed: 3
world:
  - {plane: {size_m: [400, 400]}, at_m: [0, 0, 0], material: white_plaster}
sensors:
  - {id: top, model: MODEL, mount: {at_m: [0, 0, 2]}, links: ["udp:127.0.0.1:2368"]}
"""


SLICES = 8
"Are measured: the others of the look-ahead would say the same."


@pytest.mark.parametrize("name", ["velodyne-vlp-16", "velodyne-vls-128"])
def test_the_ground_is_two_metres_below_every_laser_that_looks_down(name: str) -> None:
    config = scenario.loads(
        TEXT.replace("MODEL", name),
        Path("x.yaml"),
    )
    measure = assembly.build_measures(config)["top"]
    rig = Rig({"slice_packets": 2}, name)
    measured = 0

    def first_slices(plan: ScanPlan) -> Scan:
        nonlocal measured
        measured += 1
        return measure(plan) if measured <= SLICES else Scan.empty(plan)

    rig.world = first_slices
    look_ahead_once = packets(rig.run(0.005))[: 2 * SLICES]
    said = firings(look_ahead_once)
    model = MODELS[name]
    elevation = np.radians(np.asarray(model.elevation_deg))
    down = elevation < np.radians(-9.5)  # flatter, the edge of the footprint is met clearly before its middle
    range_m = said.distance[0].reshape(-1, model.lasers)[:, down] * model.unit_mm / 1000.0
    expected = 2.0 / np.sin(-elevation[down])
    error = range_m - expected
    assert (range_m > 0.0).mean() > 0.99
    assert np.abs(np.median(error, axis=0)).max() < 0.04
    assert error[range_m > 0.0].std() < 0.03
    assert (said.distance[0].reshape(-1, model.lasers)[:, elevation > 0.0] > 0).mean() < 1e-3  # noise
    assert (said.reflectivity[said.distance > 0] <= 100).all()
    assert codec.DATA_BYTES == len(look_ahead_once[0].payload)
