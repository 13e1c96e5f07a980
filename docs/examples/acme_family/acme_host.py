"""Hosts in virtual time for `lidaremu test`, of the ACME X2 and the S4; one of the X2 that `lidaremu look` draws with.

Belongs here: what a driver does. It shares the codec with the device, and nothing else.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator

import numpy as np
from acme_lidar import AZIMUTH_RAD, BAUD, decode_scan
from acme_spin import COLUMNS, COLUMNS_A_PACKET, ELEVATION_DEG, PACKET, STEP_M

from emulator.errors import LinkError
from emulator.hosts.lines import Line
from emulator.hosts.scans import HostScan
from emulator.hosts.scripted import HostEnd

AGAIN_NS = 1_000_000_000
"A device that is silent for so long is asked again: it may have been switched off and on."


class Reader:
    """Lines of scans out of bytes in any chunking."""

    def __init__(self) -> None:
        self._held = b""
        self.count = self.errors = 0

    def feed(self, data: bytes) -> Iterator[HostScan]:
        """Scans that are whole by now."""
        *lines, self._held = (self._held + data).split(b"\n")
        for line in lines:
            if not line.startswith(b"S "):
                continue
            found = decode_scan(line)
            if found is None:
                self.errors += 1
                continue
            yield HostScan(self.count, AZIMUTH_RAD, found[1], f"scan {found[0]}")
            self.count += 1


class AcmeHost:
    """A connected host; `emulator.hosts.scans.Host`."""

    title = "ACME X2"

    def __init__(self, line: Line) -> None:
        self._line, self._reader = line, Reader()
        line.set_baud(BAUD)
        until, heard = time.monotonic() + 3.0, b""
        while b"OK ID" not in heard:  # a device that boots hears nothing: ask again
            if time.monotonic() > until:
                raise LinkError("no ACME X2 answers ID")
            line.write(b"\nID\n")
            heard += line.read(0.2)
        line.write(b"START\n")

    @property
    def errors(self) -> int:
        """Damaged scans so far."""
        return self._reader.errors

    def scans(self, timeout_s: float) -> Iterator[HostScan | None]:
        """Scans as they arrive; None when none came for `timeout_s`."""
        while True:
            data = self._line.read(timeout_s)
            yield from self._reader.feed(data)
            if not data:
                yield None

    def close(self) -> None:
        """Stop the stream and hang up."""
        try:
            self._line.write(b"STOP\n")
        except LinkError:
            pass  # it has gone already
        self._line.close()


class AcmeScript:
    """A host in virtual time; `step` says when it wants to be called again."""

    def __init__(self, line: HostEnd, on_scan: Callable[[int, HostScan], None]) -> None:
        self._line, self._on_scan, self._reader = line, on_scan, Reader()
        self._again_ns = 0
        line.baud = BAUD

    def step(self, now_ns: int) -> int | None:
        """Read, decode, ask again when nothing came."""
        for scan in self._reader.feed(self._line.read()):
            self._on_scan(now_ns, scan)
            self._again_ns = now_ns + AGAIN_NS
        if now_ns >= self._again_ns:
            self._line.write(b"START\n", now_ns)
            self._again_ns = now_ns + AGAIN_NS
        return self._again_ns


class SpinScript:
    """Listens to an ACME S4 in virtual time: whole turns of the layer at the horizon."""

    def __init__(self, line: HostEnd, on_scan: Callable[[int, HostScan], None]) -> None:
        self._line, self._on_scan = line, on_scan
        self._held, self._turn, self._count = b"", np.zeros(0, PACKET), 0

    def step(self, now_ns: int) -> int | None:
        """Read and decode; it asks for nothing."""
        self._held += self._line.read()
        whole = len(self._held) // PACKET.itemsize
        for packet in np.frombuffer(self._held, PACKET, whole):
            if len(self._turn) and self._turn[0]["turn"] != packet["turn"]:
                self._turn = self._turn[:0]  # some of it were lost
            self._turn = np.append(self._turn, packet)
            if len(self._turn) == COLUMNS // COLUMNS_A_PACKET:
                self._on_scan(now_ns, self._decoded())
                self._turn, self._count = self._turn[:0], self._count + 1
        self._held = self._held[whole * PACKET.itemsize :]
        return None

    def _decoded(self) -> HostScan:
        columns = self._turn["columns"].ravel()
        beams = columns["beams"][:, int(np.argmin(np.abs(ELEVATION_DEG)))]
        azimuth_rad = -np.radians(columns["azimuth_cdeg"] / 100.0)
        range_m = np.where(beams["range"] > 0, beams["range"] * STEP_M, np.nan)
        return HostScan(
            self._count, (azimuth_rad + np.pi) % (2 * np.pi) - np.pi, range_m, f"turn {self._turn[0]['turn']}"
        )
