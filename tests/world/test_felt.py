"""Specific force and rate at a mount against closed forms."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from emulator.live.json_lines import update_of
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


FED = """\
schema: 1
actors: [{id: ego}]
sensors: [{id: one, model: ouster-os1-32, mount: {actor: ego, at_m: [2, 0, 1]}, links: ["pty:./one"]}]
live: {feed: control}
"""


def fed(step_ms: int, until_ms: int) -> tuple[Any, Any]:
    """A session of which a feed moves the mount on a circle of 10 m, 0.5 rad/s; and the feed."""
    made = scenario.loads(FED, Path("fed.yaml"))
    session = assembly.new_session(made, 0)
    ledger = SimpleNamespace(now_ns=0)
    feeding = assembly.feeding_of(made, [SimpleNamespace(sensor="one", session=session, ledger=ledger)], None)  # type: ignore[list-item]
    for t_ms in range(0, until_ms + 1, step_ms):
        angle = 0.5e-3 * t_ms
        at_m = [10.0 * np.cos(angle), 10.0 * np.sin(angle), 0.0]
        one = {"id": "ego", "at_m": at_m, "yaw_deg": np.degrees(angle) + 90.0}
        assert feeding is not None
        feeding.take(update_of({"t_ns": t_ms * 1_000_000, "actors": [one]}), t_ms * 1_000_000)
    return session, feeding


@pytest.mark.parametrize(("step_ms", "late_ms"), [(10, 0), (20, 7), (20, 90), (50, 30)])
def test_a_mount_that_a_feed_moves_feels_that_motion_up_to_its_newest_sample(step_ms: int, late_ms: int) -> None:
    session, _ = fed(step_ms, 1000)
    force, rate = session._felt((1000 + late_ms) * 1_000_000)
    assert rate == pytest.approx([0.0, 0.0, 0.5], abs=0.01)
    assert force == pytest.approx([-(0.5**2) * 2.0, 0.5**2 * 10.0, G_M_S2], abs=0.1)


def test_a_jump_of_the_feed_is_not_felt_nor_what_it_knows_nothing_of() -> None:
    session, feeding = fed(20, 1000)
    assert session._felt(5_000_000_000)[0] == pytest.approx([0.0, 0.0, G_M_S2], abs=1e-6)  # it holds what it has
    one = {"id": "ego", "at_m": [500.0, 0.0, 0.0], "yaw_deg": 0.0}
    feeding.take(update_of({"t_ns": 1_020_000_000, "actors": [one]}), 1_020_000_000)
    assert np.abs(session._felt(1_020_000_000)[0]).max() < 20.0
