"""Devices announced by mDNS and DNS-SD, so that drivers find them without an address: the extra `mdns` (zeroconf).

Belongs here: what is announced, and the process that does it. Not: what a device says of itself (the families).

It is a process of its own, so that its threads do not delay what sensors send. It ends, and takes back what it has
announced, when its input ends: also when the run is killed.

    python -m emulator.transports.announcing < a line of JSON, a list of services
"""

from __future__ import annotations

import contextlib
import json
import os
import subprocess
import sys
from collections.abc import Mapping, Sequence
from importlib.util import find_spec
from ipaddress import ip_address
from typing import Any

from emulator.errors import LinkError
from emulator.output.lines import note
from emulator.process.driver import how_it_ended
from protocols.session import Announcement

ENDS_S = 5.0
"After which one that does not end is killed."
MOST_STARTS = 4
"In one run: one that ends again and again is left so."


class Announcer:
    """Announces as long as it is open."""

    command = (sys.executable, "-m", "emulator.transports.announcing")

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
        self._rows = json.dumps(rows) + "\n"
        self._starts = 0
        self._process: subprocess.Popen[str] | None = None
        try:
            self._start()
        except OSError as error:
            raise LinkError(f"mdns: true: its process does not start: {error.strerror}") from None

    @property
    def pid(self) -> int | None:
        """Of the process; None: there is none any more."""
        return None if self._process is None else self._process.pid

    def _start(self) -> None:
        self._starts += 1
        self._process = subprocess.Popen(self.command, stdin=subprocess.PIPE, start_new_session=True, text=True)
        assert self._process.stdin is not None
        with contextlib.suppress(BrokenPipeError):  # it has ended already: `look` finds it so
            self._process.stdin.write(self._rows)
            self._process.stdin.flush()

    def look(self) -> str:
        """Whether the process has ended or stands still, in words; another is begun then, a few times; empty: neither.

        Costs one system call, so it may be asked in the sender.
        """
        if self._process is None:
            return ""
        found = os.waitid(os.P_PID, self._process.pid, os.WEXITED | os.WSTOPPED | os.WNOHANG | os.WNOWAIT)
        if found is None:
            return ""
        self._process.kill()
        code = self._process.wait()
        how = "stopped" if found.si_code == os.CLD_STOPPED else how_it_ended(code)
        self._release()
        if self._starts >= MOST_STARTS:
            return f"{how}; devices are announced no more"
        try:
            self._start()
        except OSError as error:
            return f"{how}; devices are announced no more: {error.strerror}"
        return f"{how}; started again"

    def _release(self) -> None:
        if self._process is not None and self._process.stdin is not None:
            with contextlib.suppress(OSError):  # what it had not read
                self._process.stdin.close()
        self._process = None

    def close(self) -> None:
        """Take it back."""
        process = self._process
        if process is None:
            return
        self._release()
        try:
            process.wait(ENDS_S)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
            note(f"mdns: killed, as it did not end within {ENDS_S:.0f} s: browsers show the devices until they expire")


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
    """Announce until the input ends; what cannot be announced is reported, and the rest goes on."""
    from zeroconf import Error, Zeroconf

    opened, code = [], 0
    for interface, infos in services(json.loads(sys.stdin.readline())).items():
        try:
            opened.append(Zeroconf(interfaces=[interface]))
        except (OSError, Error) as error:
            note(f"mdns: {interface}: {error}; nothing is announced there")
            code = 2
            continue
        for info in infos:
            try:
                opened[-1].register_service(info)
            except (OSError, Error) as error:
                note(f"mdns: {info.name} on {interface}: {type(error).__name__} {error}")
                code = 2
    sys.stdin.read()
    for one in opened:
        one.close()
    return code


if __name__ == "__main__":
    sys.exit(main())
