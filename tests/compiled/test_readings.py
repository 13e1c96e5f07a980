"""All beams of a sweep in one call, with drops, long clusters and media: what arrays report, step by step."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from emulator.compiled import switch
from emulator.physics.detection import detect
from emulator.physics.detector import Detector
from emulator.physics.pulse import Pulse
from emulator.physics.random_streams import RandomStreams
from emulator.physics.softprofile import SoftProfile
from emulator.physics.subechoes import SubEchoes
from emulator.sensing.receiving import readings
from protocols.scan import DAZZLED, SATURATED

N = 600
PULSE = Pulse(6e-9, "sin2")
BIN_S = PULSE.fwhm_s / 16.0
PLAIN = Detector(PULSE, 5.0, method="leading_edge", walk_table=True, keep="all", max_echoes=4, resolution_m=0.004,
                 bin_s=BIN_S, full_scale=np.inf, shot_factor=0.02, follows_noise=True, far_gate_m=80.0)  # fmt: skip
DETECTORS = {
    "all": PLAIN,
    "last, no walk table": replace(PLAIN, keep="last", max_echoes=1, walk_table=False),
    "strongest, clipped, recovers": replace(PLAIN, keep="strongest", max_echoes=2, full_scale=400.0, recovery_s=2e-8),
    "floor, near gate": replace(PLAIN, floor_m2=60.0, near_gate_m=1.0),
    "clips in the medium": replace(PLAIN, full_scale=50.0),
}
MEDIA = ("none", "thin", "fog", "followed to its end", "no echo of its own")


def medium(name: str) -> SoftProfile | None:
    """A homogeneous one from half a metre on."""
    if name == "none":
        return None
    backscatter = {"thin": 2e-6, "no echo of its own": 8e-7}.get(name, 2e-4)
    found = SoftProfile.of_medium(PULSE, PLAIN.bin_m, 4e6, 0.006, backscatter, 0.5, 1.5, 80.0)
    assert found is not None
    if name == "no echo of its own":
        return replace(found, shows=False, high_m=6.0, until_m=30.0)
    return found if name == "followed to its end" else replace(found, until_m=45.0)


def scan(rng: np.random.Generator) -> SubEchoes:
    """Walls, edges, slanted grounds, drops near and far, and beams without anything."""
    parts = []
    for beam in range(N):
        kind = beam % 6
        if kind in (0, 1, 2, 5):  # a wall, two of them, a slanted ground
            begin, size = rng.uniform(1.0, 60.0), int(rng.integers(1, 12))
            wide = (0.02, 0.6, 3.0, 0.1)[kind % 4]
            r = begin + rng.uniform(0.0, wide, size)
            part = rng.uniform(0.0, 1.0, size) * rng.choice([5.0, 60.0, 2000.0]) / size
            parts.append((np.full(size, beam), r, part, np.full(size, 0.95 / size), np.full(size, kind)))
        for _ in range(int(rng.integers(0, 4)) if kind != 3 else 0):
            r, strength = np.array([rng.uniform(0.6, 12.0)]), rng.uniform(0.2, 80.0, 1)
            parts.append((np.array([beam]), r, strength, np.zeros(1), np.full(1, -1)))
    beam, r, amplitude, blocked, source = (np.concatenate(column) for column in zip(*parts, strict=True))
    return SubEchoes.of(beam, r, amplitude, blocked, source)


@pytest.mark.parametrize("noisy", [False, True])
@pytest.mark.parametrize("air", MEDIA)
@pytest.mark.parametrize("name", DETECTORS)
def test_beams_report_in_one_call_what_arrays_find_step_by_step(name: str, air: str, noisy: bool) -> None:
    pytest.importorskip("numba")
    rng = np.random.default_rng(7)
    found, detector, soft = scan(rng), DETECTORS[name], medium(air)
    rms, dazzled = rng.uniform(1.0, 2.0, N), rng.random(N) < 0.05
    normals = RandomStreams(1, "one").normals("receiver", 0, N, 4) if noisy else None
    at = np.sort(rng.integers(0, N, 40))
    alarms = at, rng.uniform(0.0, 90.0, 40), rng.uniform(5.0, 9.0, 40)
    with switch.switched(True):
        made = readings(lambda: found, N, detector, soft, rms, dazzled, normals, None, alarms, 0.25, 0.0)
    assert made is not None
    with switch.switched(False):
        wanted = detect(found, N, detector, normals=normals, noise=rms, soft=soft, dazzled=dazzled, noise_echoes=alarms)
    np.testing.assert_array_equal(np.isnan(made.range_m), np.isnan(wanted.range_m))
    assert np.isfinite(wanted.range_m).sum() > 200
    np.testing.assert_allclose(made.range_m, wanted.range_m + 0.25, rtol=0.0, atol=1e-8)
    high = np.maximum(wanted.amplitude / (detector.threshold * rms[:, None]), 1.0)
    np.testing.assert_allclose(made.intensity, high, rtol=1e-8)
    np.testing.assert_array_equal(made.actor, wanted.source)
    flags = np.where(wanted.saturated.any(axis=1), SATURATED, 0) | np.where(dazzled, DAZZLED, 0)
    np.testing.assert_array_equal(made.flags, flags)
