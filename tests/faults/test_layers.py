"""Faults of single layers of a rotating sensor, by closed form, and lost packets of it."""

from __future__ import annotations

import functools
from pathlib import Path

import numpy as np
import pytest

from emulator.errors import ScenarioError
from emulator.hosts.scans import HostCloud, HostScan
from emulator.judging.trial import Trial
from emulator.scenario import scenario

BEGIN_S, END_S, DISTANCE_M = 0.5, 0.8, 8.0
TEXT = """\
schema: 1
seed: 3
duration_s: 1.1
world:
  - {plane: {size_m: [20, 80]}, at_m: [8, 0, 1], pitch_deg: -90, material: white_plaster}
actors:
  - {id: post, shape: {box: {size_m: [0.2, 0.4, 8]}}, material: white_plaster, motion: {at_m: [4, 0, -3]}}
sensors:
  - id: roof
    model: velodyne-vlp-16
    mount: {at_m: [0, 0, 1]}
    physics: {noise: false, rule: axis, sub_beams: 1}
    device: {boot_s: 0, spin_up_s: 0, fov_deg: [330, 30], rpm: 1200}
faults:
"""


@functools.lru_cache(maxsize=8)
def run(fault: str = "") -> tuple[tuple[tuple[float, HostCloud], ...], int, int]:
    """Clouds with the instants at which they were read, hits, and scans that the fault has cost."""
    kept: list[tuple[float, HostCloud]] = []
    head = f"on: roof, at_s: {BEGIN_S}, for_s: {END_S - BEGIN_S:.1f}"
    text = TEXT + (f"  - {{{head}, do: {fault}}}\n" if fault else "")
    trial = Trial(scenario.loads(text.removesuffix("faults:\n"), Path("case.yaml")))
    plain = trial.series.host_read

    def read(sensor: str, at_ns: int, scan: HostScan) -> None:
        assert scan.cloud is not None
        kept.append((at_ns * 1e-9, scan.cloud))
        plain(sensor, at_ns, scan)

    trial.series.host_read = read  # type: ignore[method-assign]
    trial.close()
    again = Trial(scenario.loads(text.removesuffix("faults:\n"), Path("case.yaml")))
    object.__setattr__(again.series, "host_read", read)
    again.finish()
    again.close()
    rows = again.faults.rows()
    return tuple(kept), int(str(rows[0]["hits"])) if rows else 0, len(kept)
