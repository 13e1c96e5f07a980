"""Datagrams of a Velodyne as `look` reads them: two sensors on one port, multicast, addresses that are none."""

from __future__ import annotations

import socket

import numpy as np
import pytest

from emulator.errors import EmulatorError
from emulator.hosts.lines import DatagramLine, open_line
from emulator.hosts.velodyne import VelodyneHost
from emulator.transports.schemes import open_link
from tests.protocols.velodyne.rig import Rig, packets


@pytest.fixture
def port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as asked:
        asked.bind(("127.0.0.1", 0))
        number = int(asked.getsockname()[1])
    return number


@pytest.mark.parametrize(("sender", "range_m"), [("127.0.0.2", 10.0), ("127.0.0.3", 4.0)])
def test_two_sensors_on_one_port_are_distinguished_by_their_address(sender: str, range_m: float, port: int) -> None:
    line = open_line(f"udp:127.0.0.1:{port}?from={sender}", 0)
    near = Rig({"rpm": 1200})
    near.world = lambda plan: _nearer(plan)
    payloads = [[one.payload for one in packets(rig.run(0.104))] for rig in (Rig({"rpm": 1200}), near)]
    links = [open_link(f"udp:127.0.0.1:{port}?listen={host}:0") for host in ("127.0.0.2", "127.0.0.3")]
    for pair in zip(*payloads, strict=True):
        for link, payload in zip(links, pair, strict=True):
            link.send(payload, 0)
            link.flush(0)
    host = VelodyneHost(line, None)
    scan = next(one for one in host.scans(1.0) if one is not None)
    assert scan.cloud is not None
    assert set(np.round(scan.cloud.range_m, 3)) == {range_m}
    assert host.errors == 0
    host.close()
    for link in links:
        link.close()


def _nearer(plan):  # type: ignore[no-untyped-def]
    from tests.protocols.velodyne.rig import wall

    scan = wall(plan)
    scan.range_m[:, 0] = 4.0
    return scan


@pytest.mark.parametrize(
    ("bound", "target"), [("127.0.0.1", "127.0.0.1"), ("0.0.0.0", "127.255.255.255"), ("239.1.2.3", "239.1.2.3")]
)
def test_unicast_broadcast_and_multicast_arrive(bound: str, target: str, port: int) -> None:
    line = open_line(f"udp:{bound}:{port}", 0)
    link = open_link(f"udp:{target}:{port}?listen=0")
    payload = packets(Rig().run(0.05))[0].payload
    link.send(payload, 0)
    link.flush(0)
    assert line.read(2.0) == payload
    link.close()
    line.close()


@pytest.mark.parametrize(
    ("url", "said"),
    [
        ("udp:127.0.0.1:0", "want udp:ADDRESS:PORT, a port of 1..65535"),
        ("udp:roof:2368", "address 'roof'; want four numbers"),
        ("udp:127.0.0.1:2368?from=", "address ''; want four numbers"),
        ("udp:127.0.0.1:2368?to=1.2.3.4", "want udp:ADDRESS:PORT[?]from=ADDRESS"),
        ("udp:192.0.2.1:2368", "cannot listen on 192.0.2.1:2368"),
    ],
)
def test_what_is_no_place_to_listen_is_refused(url: str, said: str) -> None:
    with pytest.raises(EmulatorError, match=said):
        open_line(url, 0)


def test_nothing_is_sent_on_it(port: int) -> None:
    line = DatagramLine("127.0.0.1", port, None)
    line.write(b"x")
    assert line.read(0.0) == b""
    line.close()
