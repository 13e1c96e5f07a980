"""Specific force and rate at a mount against closed forms."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from emulator.runtime import assembly
from emulator.scenario import scenario
from emulator.world.felt import G_M_S2, MountMotion

TEXT = """\
schema: 1
actors:
  - {id: ego, motion: MOTION}
sensors:
  - {id: one, model: ouster-os1-32, mount: {actor: ego, MOUNT}}
"""


def felt(motion: str, mount: str = "at_m: [0, 0, 1]", at_s: float = 1.0) -> tuple[np.ndarray, np.ndarray]:
    made = scenario.loads(TEXT.replace("MOTION", motion).replace("MOUNT", mount), Path("felt.yaml"))
    return MountMotion(made, 0).at(round(1e9 * at_s))


def test_a_level_sensor_that_drives_straight_feels_gravity_alone() -> None:
    force, rate = felt("{at_m: [0, 0, 0], velocity_m_s: [20, 3, 0]}")
    assert force == pytest.approx([0.0, 0.0, G_M_S2], abs=1e-5)
    assert rate == pytest.approx([0.0, 0.0, 0.0], abs=1e-9)


def test_a_tilted_sensor_feels_gravity_in_its_own_frame() -> None:
    force, _ = felt("{at_m: [0, 0, 0]}", "pitch_deg: 90")
    assert force == pytest.approx([-G_M_S2, 0.0, 0.0], abs=1e-6)  # its nose is down: what holds it pushes back


def test_a_sensor_on_a_turning_arm_feels_its_centripetal_force_and_the_rate() -> None:
    omega, arm_m = np.radians(90.0), 2.0
    force, rate = felt("{at_m: [5, 0, 0], yaw_rate_deg_s: 90}", f"at_m: [{arm_m}, 0, 0], yaw_deg: 90")
    # towards the axis: behind the arm, and to the left of a sensor that looks along the way
    assert force == pytest.approx([0.0, omega**2 * arm_m, G_M_S2], rel=1e-4, abs=1e-4)
    assert rate == pytest.approx([0.0, 0.0, omega], rel=1e-6, abs=1e-9)


def test_the_device_is_told_of_it() -> None:
    made = scenario.loads(TEXT.replace("MOTION", "{at_m: [0, 0, 0]}").replace("MOUNT", "roll_deg: 180"), Path("x.yaml"))
    session = assembly.new_session(made, 0)
    assert session._felt(0)[0] == pytest.approx([0.0, 0.0, -G_M_S2])  # type: ignore[attr-defined]
