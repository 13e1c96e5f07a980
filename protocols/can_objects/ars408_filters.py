"""Continental ARS408-21: the sixteen filters that a host sets with 0x202, and the answers 0x203 and 0x204.

Belongs here: criteria and their answer frames. Not: sorting and the limit of the list (the session's).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from protocols.can_objects.ars408_lists import class_codes, probability_codes
from protocols.can_objects.layout import Layout
from protocols.can_objects.session import Frame
from protocols.can_objects.table import Floats, ObjectTable

NUMBER, DISTANCE, AZIMUTH, RADIAL_ONCOMING, RADIAL_DEPARTING, RCS, LIFETIME, AREA = range(8)
EXISTENCE, LATERAL, LONGITUDINAL, LEFT_TO_RIGHT, ONCOMING, RIGHT_TO_LEFT, DEPARTING, CLASS = range(8, 16)

FOR_CLUSTERS = frozenset({NUMBER, DISTANCE, AZIMUTH, RADIAL_ONCOMING, RADIAL_DEPARTING, RCS})
"Criteria that a cluster has; the others belong to objects alone."

NOT_VALID = "Valid is 0: nothing changed"


@dataclass(frozen=True)
class Filter:
    """One criterion: objects outside of [low, high] are removed from the list."""

    low: float
    high: float


class FilterBank:
    """Active filters by (for objects, index)."""

    def __init__(self, layout: Layout, swap_lateral: bool) -> None:
        self._layout = layout
        self._swap_lateral = swap_lateral
        self._active: dict[tuple[bool, int], Filter] = {}

    def clear(self) -> None:
        """No filter is active."""
        self._active.clear()

    def set(self, data: bytes) -> str | None:
        """Take one 0x202; None if accepted, otherwise the reason."""
        values = self._layout.decode("FilterConfig", data)
        if not values["Valid"]:
            return NOT_VALID
        index, for_objects = int(values["Index"]), bool(values["ForObjects"])
        if not for_objects and index not in FOR_CLUSTERS:
            return f"filter {index} is not for clusters"
        if not values["Active"]:
            self._active.pop((for_objects, index), None)
            return None
        low_name, high_name = self._layout.alternatives("FilterConfig")[index]
        self._active[for_objects, index] = Filter(values[low_name], values[high_name])
        return None

    def answer(self, shift: int) -> list[Frame]:
        """0x203 and one 0x204 for every active filter: clusters before objects, by index."""
        count = sum(1 for for_objects, _ in self._active if not for_objects)
        header = self._layout["FilterStateHeader"]
        payload = header.frame(raw={"NumClusterFilters": count, "NumObjectFilters": len(self._active) - count})
        frames = [Frame(header.identifier + shift, payload, "FilterStateHeader")]
        identifier = self._layout.identifier("FilterState") + shift
        for (for_objects, index), criterion in sorted(self._active.items()):
            low_name, high_name = self._layout.alternatives("FilterState")[index]
            values = {
                "Active": 1,
                "Index": index,
                "ForObjects": int(for_objects),
                low_name: criterion.low,
                high_name: criterion.high,
            }
            frames.append(Frame(identifier, self._layout.encode("FilterState", values), "FilterState"))
        return frames

    def number(self, for_objects: bool) -> int | None:
        """Length of the list that the number filter allows, None without it."""
        criterion = self._active.get((for_objects, NUMBER))
        return None if criterion is None else int(criterion.high)

    def mask(self, table: ObjectTable, for_objects: bool, rcs_dbm2: float) -> NDArray[np.bool_]:
        """Which objects pass every active filter but the number filter."""
        keep = np.ones(len(table), dtype=np.bool_)
        for (of_objects, index), criterion in self._active.items():
            if of_objects != for_objects or index == NUMBER:
                continue
            if index == CLASS:
                keep &= (int(criterion.high) >> class_codes(table) & 1).astype(np.bool_)
                continue
            values, concerned = self._quantity(table, index, rcs_dbm2)
            slack = 1e-9  # of the decoded limits, which are decimal fractions
            inside = (values >= criterion.low - slack) & (values <= criterion.high + slack)
            keep &= inside | ~concerned
        return keep

    def _quantity(self, table: ObjectTable, index: int, rcs_dbm2: float) -> tuple[Floats, NDArray[np.bool_]]:
        """Value that a criterion looks at, and the objects it looks at (speed filters know a direction)."""
        everyone = np.ones(len(table), dtype=np.bool_)
        if self._swap_lateral and index in (LEFT_TO_RIGHT, RIGHT_TO_LEFT):
            index = LEFT_TO_RIGHT + RIGHT_TO_LEFT - index
        radial = table.range_rate_m_s
        directed: dict[int, tuple[Floats, NDArray[np.bool_]]] = {
            RADIAL_ONCOMING: (-radial, radial < 0.0),
            RADIAL_DEPARTING: (radial, radial > 0.0),
            ONCOMING: (-table.vx_m_s, table.vx_m_s < 0.0),
            DEPARTING: (table.vx_m_s, table.vx_m_s > 0.0),
            LEFT_TO_RIGHT: (-table.vy_m_s, table.vy_m_s < 0.0),
            RIGHT_TO_LEFT: (table.vy_m_s, table.vy_m_s > 0.0),
        }
        if index in directed:
            return directed[index]
        plain: dict[int, Floats] = {
            DISTANCE: table.range_m,
            AZIMUTH: np.degrees(table.azimuth_rad),
            RCS: np.full(len(table), rcs_dbm2),
            LIFETIME: table.age_s,
            AREA: table.length_m * table.width_m,
            EXISTENCE: probability_codes(table.existence).astype(np.float64),
            LATERAL: table.y_m,
            LONGITUDINAL: table.x_m,
        }
        return plain[index], everyone
