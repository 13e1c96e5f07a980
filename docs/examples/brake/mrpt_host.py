"""MRPT's driver of a SICK LMS2xx as the host: tests/system/mrpt/mrpt_host.cpp, which prints every scan as a line."""

from __future__ import annotations

import math
import os
import subprocess
from pathlib import Path

BAUD, SECONDS, SCANS = 500_000, 600, 100_000_000
STARTS = 3
"MRPT's driver gives up when a set-up takes too long; whoever uses it starts it again."


class MrptHost:
    """Starts the program and hands out the scans that it prints, as `LmsHost` does."""

    def __init__(self, program: Path, port: str, field_deg: int, step_deg: float) -> None:
        """`program`: built by `cmake -S tests/system/mrpt -B FOLDER && cmake --build FOLDER`."""
        words = [str(program), port, str(BAUD), "0", str(field_deg), str(round(100 * step_deg))]
        self._words = [*words, str(SCANS), str(SECONDS)]
        self._starts = 0
        self.count = 0
        "Scans so far."
        self._begin()

    def _begin(self) -> None:
        self._starts += 1
        self.line = subprocess.Popen(self._words, stdout=subprocess.PIPE)
        assert self.line.stdout is not None
        os.set_blocking(self.line.stdout.fileno(), False)
        self.held = b""

    def start(self) -> None:
        """The driver asks for the stream itself."""

    def close(self) -> None:
        """End it."""
        self.line.kill()
        self.line.wait()

    def scans(self) -> list[list[tuple[float, float]]]:
        """What has come since the last call: of each scan x ahead and y to the left of every echo. [m]"""
        assert self.line.stdout is not None
        self.held += self.line.stdout.read() or b""
        *lines, self.held = self.held.split(b"\n")
        if self.line.poll() is not None:
            if self.count or self._starts == STARTS:
                raise SystemExit(f"mrpt_host has ended: {lines}")
            self._begin()
        found = [self.points(line.split()) for line in lines if line.startswith(b"scan ")]
        self.count += len(found)
        return found

    def points(self, words: list[bytes]) -> list[tuple[float, float]]:
        """Of one line: aperture, its sense and the ranges, -1 where there is none."""
        aperture, to_left, ranges = float(words[2]), words[3] == b"1", [float(word) for word in words[5:]]
        step = (aperture if to_left else -aperture) / max(1, len(ranges) - 1)
        first = -step * (len(ranges) - 1) / 2
        polar = [(metres, first + index * step) for index, metres in enumerate(ranges) if metres >= 0]
        return [(metres * math.cos(angle), metres * math.sin(angle)) for metres, angle in polar]
