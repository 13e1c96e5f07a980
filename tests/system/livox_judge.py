"""A process with the maker's Livox-SDK2 (py-livox2) that prints each packet of points as the SDK hands it over.

    python livox_judge.py HOST_PORT LIDAR_IP

`ready` when it listens; then a JSON object for each packet, until standard input ends. No discovery: the SDK takes
points from every address that its configuration names.
"""

from __future__ import annotations

import json
import os
import sys
import tempfile
from pathlib import Path
from typing import Any

import livox_sdk


def main() -> None:
    port, lidar = int(sys.argv[1]), sys.argv[2]
    names = ("cmd_data_port", "push_msg_port", "point_data_port", "imu_data_port", "log_data_port")
    theirs = {name: 56_100 + 100 * place for place, name in enumerate(names)}
    ours = {name: port + place for place, name in enumerate(names[:2] + names[3:], 1)} | {names[2]: port}
    host = {"lidar_ip": [lidar], "host_ip": "127.0.0.1"} | ours
    told = os.fdopen(os.dup(1), "w", buffering=1)
    os.dup2(2, 1)  # the SDK writes its log to standard output

    def points(packet: Any) -> None:
        row = {"points": packet.dot_num, "interval": packet.time_interval, "stamp_ns": packet.ts}
        print(json.dumps(row | {"data": packet.get_pts_data().hex()}), file=told)

    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "sdk.json"
        path.write_text(json.dumps({"MID360": {"lidar_net_info": theirs, "host_net_info": [host]}}))
        if not livox_sdk.LivoxLidarSdkInit(str(path)):
            sys.exit("the SDK does not start")
        livox_sdk.SetLivoxLidarPointCloudCallBack(points)
        print("ready", file=told)
        sys.stdin.read()
        livox_sdk.LivoxLidarSdkUninit()


if __name__ == "__main__":
    main()
