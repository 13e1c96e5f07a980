"""Cost of each step of the physics for one LMS291 scan: 361 beams of 61 sub-beams. It prints and judges nothing.

python tests/benchmarks/bench_physics.py [repeats]
"""

from __future__ import annotations

import statistics
import sys
import time
from collections.abc import Callable
from typing import TypeVar

import numpy as np

from emulator.physics import atmosphere, beams
from emulator.physics.detection import detect
from emulator.physics.detector import Detector
from emulator.physics.materials import SurfaceTable, known_materials, material
from emulator.physics.pulse import Pulse
from emulator.physics.radiometry import received_power
from emulator.physics.softprofile import SoftProfile
from emulator.physics.subechoes import SubEchoes

BEAMS, SUB_BEAMS, K = 361, 61, 45_000.0
Result = TypeVar("Result")


def timed(name: str, work: Callable[[], Result], repeats: int) -> Result:
    """Run once to warm up, then print the median and the least of the repeats."""
    result = work()
    spent = []
    for _ in range(repeats):
        start = time.perf_counter()
        work()
        spent.append(1e3 * (time.perf_counter() - start))
    median = statistics.median(spent)
    print(f"{name:44s} {median:8.2f} ms  least {min(spent):8.2f}  {1e3 * median / BEAMS:7.2f} us a beam")
    return result


def main(repeats: int) -> None:
    rng = np.random.default_rng(3)
    nodes = beams.spiral(SUB_BEAMS)
    shape = beams.BeamShape.round(12.913e-3, exit_radius_m=0.005)
    azimuth, level = np.radians(np.arange(BEAMS) * 0.5 - 90.0), np.zeros(BEAMS)
    direction, _ = timed("directions of all sub-beams", lambda: beams.spread(nodes, shape, azimuth, level), repeats)

    # a curved wall with forty slanted posts before it, every tenth sub-beam without a hit
    phi = np.arctan2(direction[..., 1], direction[..., 0])
    r = 12.0 / np.maximum(np.cos(phi), 0.15)
    for _ in range(40):
        centre, width, distance = rng.uniform(-1.5, 1.5), rng.uniform(0.01, 0.1), rng.uniform(2.0, 11.0)
        r = np.where((abs(phi - centre) < width) & (distance < r), distance * (1.0 + 0.3 * (phi - centre)), r)
    hit = rng.random(r.shape) > 0.1
    table = SurfaceTable.of([material(name) for name in known_materials()], 905.0)
    index, cosine = rng.integers(0, len(table.materials), r.shape), np.full(r.shape, 0.8)
    back = timed("reflectance of all hits, 41 materials", lambda: table.back(index, cosine), repeats)
    power = timed(
        "range equation of all hits",
        lambda: received_power(30.0, nodes.share, back, r, 9e-5 * r, 0.02, 0.5),
        repeats,
    )
    amplitude = np.where(hit, power / power.max() * 1e4, 0.0)
    ranges, share = np.where(hit, r, np.nan), np.broadcast_to(nodes.share, r.shape)
    echoes = timed("sorting the sub-echoes", lambda: SubEchoes.from_grid(ranges, amplitude, share), repeats)
    normals = rng.normal(size=(BEAMS, 8))
    for fwhm_ns in (4.0, 16.0):
        for method in ("leading_edge", "constant_fraction", "peak", "centroid"):
            detector = Detector(Pulse(fwhm_ns * 1e-9), 5.0, method, full_scale=20_000.0)  # type: ignore[arg-type]
            timed(
                f"detection, {method}, {fwhm_ns:g} ns",
                lambda detector=detector: detect(echoes, BEAMS, detector, normals=normals),  # type: ignore[misc]
                repeats,
            )
    gauss = Detector(Pulse(4e-9, "gauss"), 5.0)
    timed("detection, leading_edge, Gaussian 4 ns", lambda: detect(echoes, BEAMS, gauss, normals=normals), repeats)

    detector = Detector(Pulse(4e-9), 5.0)
    alpha = float(atmosphere.fog_kim(200.0, 905e-9))

    def fog() -> SoftProfile | None:
        return SoftProfile.of_medium(detector.pulse, detector.bin_m, np.pi * K, alpha, alpha / 18.8, 0.05, 1.0, 80.0)

    soft = timed("tables of fog, once a weather", fog, repeats)
    timed("detection in fog of 200 m", lambda: detect(echoes, BEAMS, detector, normals=normals, soft=soft), repeats)


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 20)
