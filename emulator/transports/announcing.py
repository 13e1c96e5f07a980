"""Devices announced by mDNS and DNS-SD, so that drivers find them without an address: the extra `mdns` (zeroconf).

Belongs here: what is announced, and the process that does it. Not: what a device says of itself (the families).

It is a process of its own, so that its threads do not delay what sensors send. It ends, and takes back what it has
announced, when its input ends: also when the run is killed.

    python -m emulator.transports.announcing < a line of JSON, a list of services
"""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Mapping, Sequence
from importlib.util import find_spec
from ipaddress import ip_address
from typing import Any

from emulator.errors import LinkError
from emulator.output.lines import note
from protocols.session import Announcement

ENDS_S = 5.0
"After which one that does not end is killed."


class Announcer:
    """Announces as long as it is open."""

    def __init__(self, found: Sequence[tuple[str, Announcement]]) -> None:
        """Each with the address that it is at; `LinkError` without the library, or for an address that is none."""
        if find_spec("zeroconf") is None:
            raise LinkError("zeroconf is missing; mdns: true needs the extra: pip install 'lidaremu[mdns]'")
        rows = []
        for host, one in found:
            try:
                anywhere = ip_address(host).is_unspecified
            except ValueError:
                anywhere = True
            if anywhere:
                raise LinkError(f"mdns: true with a TCP link at {host}; want one at the address of an interface")
            rows.append({"address": host, "kind": one.kind, "name": one.name, "host": one.host, "port": one.port}
                        | {"text": dict(one.text)})  # fmt: skip
        command = [sys.executable, "-m", "emulator.transports.announcing"]
        self._process = subprocess.Popen(command, stdin=subprocess.PIPE, start_new_session=True, text=True)
        assert self._process.stdin is not None
        self._process.stdin.write(json.dumps(rows) + "\n")
        self._process.stdin.flush()

    def close(self) -> None:
        """Take it back."""
        assert self._process.stdin is not None
        self._process.stdin.close()
        try:
            self._process.wait(ENDS_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()


def services(rows: Sequence[Mapping[str, Any]]) -> dict[str, list[Any]]:
    """What zeroconf registers: interface -> its services."""
    from zeroconf import ServiceInfo

    found: dict[str, list[Any]] = {}
    for row in rows:
        address = ip_address(row["address"])
        interface = "127.0.0.1" if address.is_loopback and address.version == 4 else str(address)
        kind = f"{row['kind']}.local."
        info = ServiceInfo(
            kind, f"{row['name']}.{kind}", port=row["port"], addresses=[address.packed], properties=row["text"],
            server=f"{row['host']}.local.",
        )  # fmt: skip
        found.setdefault(interface, []).append(info)
    return found


def main() -> int:
    """Announce until the input ends."""
    from zeroconf import Error, Zeroconf

    opened, code = [], 0
    for interface, infos in services(json.loads(sys.stdin.readline())).items():
        opened.append(Zeroconf(interfaces=[interface]))
        for info in infos:
            try:
                opened[-1].register_service(info)
            except Error as error:
                note(f"mdns: {info.name} on {interface}: {type(error).__name__} {error}")
                code = 2
    sys.stdin.read()
    for one in opened:
        one.close()
    return code


if __name__ == "__main__":
    sys.exit(main())
