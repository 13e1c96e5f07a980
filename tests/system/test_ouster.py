"""ouster-sdk 0.16 and the daemon: two Ousters on one host, other profile and mode, points, standby and back.

The SDK takes host names without ports: the HTTP interface has to be on port 80, which needs root or a low first
unprivileged port (docs/ouster.md).
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.system.conftest import RunningDaemon

pytestmark = pytest.mark.timeout(240)
HOSTS = "127.0.0.72", "127.0.0.73"
WALL_M = 6.0
TEXT = """\
schema: 1
seed: 3
world:
  - {box: {size_m: [0.5, 40, 40]}, at_m: [6.25, 0, -20], material: concrete}
sensors:
""" + "".join(
    f"""\
  - id: os{index}
    model: {model}
    mount: {{at_m: [0, 0, 0]}}
    physics: {{noise: false, rule: axis}}
    device: {{serial_number: {1001 + index}, boot_s: 0, init_s: 0.2, spin_up_s: 0.1, config: {{
      lidar_mode: 512x10, azimuth_window: [176000, 184000]}}}}
    links: ["udp:127.0.0.1:{7672 + 10 * index}?listen={host}:0", "udp:127.0.0.1:{7673 + 10 * index}?listen={host}:0",
            "tcp:{host}:80"]
"""
    for index, (host, model) in enumerate(zip(HOSTS, ("ouster-os0-32", "ouster-os1-32"), strict=True))
)


def frame_of(source: Any) -> Any:
    """The first whole frame out of many: the machine may be busy otherwise."""
    for _, found in zip(range(400), source, strict=False):
        scan = found[0]
        if scan is not None and scan.complete():
            return scan
    raise AssertionError("no whole frame")


def worst_m(core: Any, scan: Any) -> float:
    """How far points are from the wall."""
    seen = scan.field(core.ChanField.RANGE) > 0
    assert seen.sum() > 150
    return float(np.abs(core.XYZLut(scan.sensor_info)(scan)[seen][:, 0] - WALL_M).max())


def test_the_makers_sdk_drives_two_sensors(daemon: Callable[..., RunningDaemon], tmp_path: Path) -> None:
    from ouster import sdk
    from ouster.sdk import core, sensor

    (tmp_path / "two.yaml").write_text(TEXT, encoding="utf-8")
    running = daemon("two.yaml")
    for host, columns, profile in zip(
        HOSTS, (512, 1024), ("RNG19_RFL8_SIG16_NIR16", "RNG19_RFL8_SIG16_NIR16_DUAL"), strict=True
    ):
        config = sensor.get_config(host)
        if columns == 1024:
            config.lidar_mode = core.LidarMode._1024x10
            config.udp_profile_lidar = core.UDPProfileLidar.from_string(profile)
            sensor.set_config(host, config, False)
        source = sdk.open_source(host)
        scan = frame_of(source)
        info = scan.sensor_info
        assert (info.sn, info.format.columns_per_frame) == (1001 + HOSTS.index(host), columns)
        assert str(info.format.udp_profile_lidar) == profile
        assert worst_m(core, scan) < 0.003
        source.close()

    config = sensor.get_config(HOSTS[0])
    config.operating_mode = core.OperatingMode.OPERATING_STANDBY
    sensor.set_config(HOSTS[0], config, False)
    assert sensor.get_config(HOSTS[0]).operating_mode == core.OperatingMode.OPERATING_STANDBY
    source = sdk.open_source(HOSTS[0])  # it sets NORMAL by itself
    assert worst_m(core, frame_of(source)) < 0.003
    source.close()
    config.azimuth_window = (1, 1)
    with pytest.raises(Exception, match="azimuth_window"):
        sensor.set_config(HOSTS[0], config, False)
    assert running.stop() == 0
