"""Turns out of samples with measured angles, for hosts of scanners whose rotor turns freely.

Belongs here: where one turn ends and the next begins. Not: packets.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from emulator.hosts.scans import HostScan
from protocols.scan import Floats

MOST = 40_000
"Samples after which a turn without an end is given up; the slowest and densest have 7200."


class TurnAssembler:
    """A turn ends where the angle passes the front mark; the first one, begun anywhere, is not delivered."""

    def __init__(self, count: int = 0) -> None:
        self.count = count
        "Turns delivered."
        self._parts: list[tuple[Floats, Floats, Floats | None]] = []
        self._last_deg = -1.0
        self._whole = False

    def add(
        self, angle_deg: Floats, range_m: Floats, intensity: Floats | None, true_deg: Floats | None = None
    ) -> Iterator[HostScan]:
        """Samples in the order of measuring, clockwise angles as the device reports them; turns that they complete.

        `true_deg`: directions, where they are not the angles of the rotor.
        """
        if not len(angle_deg):
            return
        wrapped = angle_deg % 360.0
        true_deg = angle_deg if true_deg is None else true_deg
        before = np.concatenate([[self._last_deg], wrapped[:-1]])
        ends = np.flatnonzero(wrapped < before - 180.0)
        self._last_deg = float(wrapped[-1])
        begin = 0
        for end in [*ends.tolist(), None]:
            part = slice(begin, end)
            self._parts.append((true_deg[part], range_m[part], None if intensity is None else intensity[part]))
            if end is None:
                break
            if self._whole and (scan := self._made()) is not None:
                yield scan
            self._parts, self._whole, begin = [], True, end
        if sum(len(one[0]) for one in self._parts) > MOST:
            self._parts, self._whole = [], False

    def _made(self) -> HostScan | None:
        angle = np.concatenate([one[0] for one in self._parts])
        if not len(angle):
            return None
        range_m = np.concatenate([one[1] for one in self._parts])
        levels = [one[2] for one in self._parts if one[2] is not None]
        strength = np.where(np.isnan(range_m), np.nan, np.concatenate(levels)) if levels else None
        azimuth = np.radians((180.0 - angle) % 360.0 - 180.0)
        self.count += 1
        return HostScan(self.count - 1, np.asarray(azimuth, np.float64), range_m, f"{len(angle)} samples", strength)
