"""Announced devices are found by a browser of mDNS, and gone when their process ends."""

from __future__ import annotations

import queue
from typing import Any

from zeroconf import ServiceBrowser, ServiceStateChange, Zeroconf

from emulator.transports.announcing import Announcer
from protocols.session import Announcement

KIND = "_ouster-lidar._tcp"


def test_two_devices_are_found_with_their_addresses_and_taken_back() -> None:
    changes: queue.Queue[tuple[ServiceStateChange, str]] = queue.Queue()

    def changed(zeroconf: Any, service_type: str, name: str, state_change: ServiceStateChange) -> None:
        changes.put((state_change, name))

    listening = Zeroconf(interfaces=["127.0.0.1"])
    ServiceBrowser(listening, [f"{KIND}.local."], handlers=[changed])
    hosts = ("127.0.0.92", "127.0.0.93")
    announcer = Announcer([
        (host, Announcement(KIND, f"Ouster Sensor {host[-2:]}", f"os-{host[-2:]}", 80, {"sn": host[-2:]}))
        for host in hosts
    ])  # fmt: skip
    names = [f"Ouster Sensor {host[-2:]}.{KIND}.local." for host in hosts]
    seen = {changes.get(timeout=30) for _ in names}
    assert seen == {(ServiceStateChange.Added, name) for name in names}
    for name, host in zip(names, hosts, strict=True):
        info = listening.get_service_info(f"{KIND}.local.", name, 10_000)
        assert info is not None
        assert (info.parsed_addresses(), info.port, info.server) == ([host], 80, f"os-{host[-2:]}.local.")
    announcer.close()
    gone = set()
    while len(gone) < 2:
        change, name = changes.get(timeout=30)
        if change is ServiceStateChange.Removed:
            gone.add(name)
    listening.close()
