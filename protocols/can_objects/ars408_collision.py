"""Continental ARS408-21: collision detection, up to eight rectangles that warn when an object stays in them.

Belongs here: 0x400 and 0x401, the warnings of each list, 0x408 and 0x402. Not: the object list itself.
The public sources give layouts and no timing: we send 0x408 and one 0x402 a region behind each list, and at once as
the answer to a configuration.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from protocols.can_objects.layout import Layout
from protocols.can_objects.session import Frame
from protocols.can_objects.table import ObjectTable

NO_WARNING, OBJECT_WARNING, DEACTIVATED = 0, 1, 3


@dataclass(frozen=True)
class Region:
    """A rectangle between two corners."""

    active: bool = False
    x1_m: float = 0.0
    y1_m: float = 0.0
    x2_m: float = 0.0
    y2_m: float = 0.0
    objects: int = 0
    "Objects that warn in it, by the last list."

    def holds(self, table: ObjectTable) -> NDArray[np.bool_]:
        """Which objects have their centre in it."""
        x_low, x_high = sorted((self.x1_m, self.x2_m))
        y_low, y_high = sorted((self.y1_m, self.y2_m))
        inside = (table.x_m >= x_low) & (table.x_m <= x_high) & (table.y_m >= y_low) & (table.y_m <= y_high)
        return np.asarray(inside)


class CollisionDetection:
    """Regions, and since when each object has been in each."""

    def __init__(self, layout: Layout) -> None:
        self._layout = layout
        self.clear()

    def clear(self) -> None:
        """Off, without regions."""
        self.active = False
        self._min_time_s = 0.0
        self._regions: dict[int, Region] = {}
        self._since_ns: dict[tuple[int, int], int] = {}

    def configure(self, data: bytes) -> None:
        """Take one 0x400."""
        values = self._layout.decode("CollisionConfig", data)
        self.active = bool(values["Activate"])
        if values["MinTimeValid"]:
            self._min_time_s = values["MinDetectTime"]
        if values["WarningReset"]:
            self._since_ns.clear()
            self._regions = {key: replace(region, objects=0) for key, region in self._regions.items()}
        if values["ClearRegions"]:
            self._regions.clear()
            self._since_ns.clear()

    def set_region(self, data: bytes) -> None:
        """Take one 0x401."""
        values = self._layout.decode("CollisionRegionConfig", data)
        key = int(values["RegionId"])
        region = replace(self._regions.get(key, Region()), active=bool(values["Activate"]), objects=0)
        if values["CoordinatesValid"]:
            region = replace(region, x1_m=values["P1X"], y1_m=values["P1Y"], x2_m=values["P2X"], y2_m=values["P2Y"])
        self._regions[key] = region

    def warnings(self, table: ObjectTable, measured_ns: int) -> NDArray[np.int64]:
        """RegionBits of every object: bit k when it has been in region k for the minimum time."""
        bits = np.zeros(len(table), dtype=np.int64)
        since: dict[tuple[int, int], int] = {}
        for key, region in self._regions.items():
            if not region.active:
                continue
            warned = 0
            for row in np.flatnonzero(region.holds(table)).tolist():
                entry = (key, int(table.track[row]))
                since[entry] = self._since_ns.get(entry, measured_ns)
                if measured_ns - since[entry] >= round(self._min_time_s * 1e9):
                    bits[row] |= 1 << key
                    warned += 1
            self._regions[key] = replace(region, objects=warned)
        self._since_ns = since
        return bits

    def relay_bits(self) -> int:
        """Regions that warn at present."""
        return sum(1 << key for key, region in self._regions.items() if region.active and region.objects)

    def state(self, shift: int, counter: int) -> list[Frame]:
        """0x408 and one 0x402 for every configured region."""
        message = self._layout["CollisionState"]
        active = sum(1 for region in self._regions.values() if region.active)
        payload = message.frame(
            raw={"Active": int(self.active), "NumRegions": active, "MeasCounter": counter},
            MinDetectTime=self._min_time_s,
        )
        frames = [Frame(message.identifier + shift, payload, "CollisionState")]
        message = self._layout["CollisionRegionState"]
        for key, region in sorted(self._regions.items()):
            level = DEACTIVATED if not region.active else OBJECT_WARNING if region.objects else NO_WARNING
            payload = message.frame(
                raw={"RegionId": key, "WarningLevel": level, "NumObjects": region.objects},
                P1X=region.x1_m,
                P1Y=region.y1_m,
                P2X=region.x2_m,
                P2Y=region.y2_m,
            )
            frames.append(Frame(message.identifier + shift, payload, "CollisionRegionState"))
        return frames
