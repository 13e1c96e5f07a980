"""lds2d (PyPI) as a judge of bytes: its drivers on a transport in memory."""

from __future__ import annotations

from typing import Any

import numpy as np
from lds2d import Lidar


class Bytes:
    """A transport that ends."""

    def __init__(self, data: bytes) -> None:
        self._data = data
        self.written = b""

    def read(self, size: int) -> bytes:
        if not self._data:
            raise EOFError
        found, self._data = self._data[:size], self._data[size:]
        return found

    def write(self, data: bytes) -> int:
        self.written += data
        return len(data)

    def close(self) -> None:
        pass


def turns(model: str, data: bytes) -> list[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Angles in degrees, distances in mm (0: none) and qualities of each turn; the first and the last are not whole."""
    lidar: Any = Lidar.open(model, transport=Bytes(data))
    found = []
    try:
        for scan in lidar.scans():
            points = [(one.angle_deg, one.dist_mm, one.quality) for one in scan]
            found.append(tuple(np.array(column) for column in zip(*points, strict=True)))
    except EOFError:
        pass
    return found[1:]  # type: ignore[return-value]
