"""What an object is by its size, and what size it has on the sides that nobody has seen.

Belongs here: the rules. Sizes seen are lower bounds: a scanner sees only the sides that face it. Not: boxes and tracks.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from emulator.objects.points import Floats

NAMES = ("unknown", "point", "pedestrian", "bicycle", "car", "truck", "wide")
UNKNOWN, POINT, PEDESTRIAN, BICYCLE, CAR, TRUCK, WIDE = range(len(NAMES))

POINT_M = 0.25
PEDESTRIAN_M = 1.0
"A stride with swinging arms."
TWO_WHEELER_M = (2.6, 0.9)
"Length and width: the longest motorcycle, the widest handlebar. A motorcycle is not distinguished from a bicycle."
CAR_M = (6.0, 2.3)
TRUCK_M = (20.0, 3.0)
REAR_FROM_M = 1.3
"Width from which something flat may be a car's rear or front."
FLAT_M = 0.7
"Depth of what is seen of a side that faces the sensor squarely."
TYPICAL_CAR_M, TYPICAL_TRUCK_M = (4.4, 1.8), (8.0, 2.5)
"Length and width that are assumed where they cannot be seen: a family car, a lorry."


def is_flat_across(long_m: Floats, short_m: Floats, across_sight: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Things of a vehicle's width and hardly any depth that face the sensor: a rear or a front."""
    return np.asarray(across_sight & (short_m < FLAT_M) & (long_m >= REAR_FROM_M) & (long_m < TRUCK_M[1]))


def assumed_sizes(
    length_m: Floats, width_m: Floats, length_known: NDArray[np.bool_], width_known: NDArray[np.bool_]
) -> tuple[Floats, Floats]:
    """Length and width with what has not been seen filled in by the usual vehicle with the other side."""
    car = (width_m >= REAR_FROM_M) & (width_m < CAR_M[1])
    truck = (width_m >= CAR_M[1]) & (width_m < TRUCK_M[1])
    least_length = np.where(car, TYPICAL_CAR_M[0], np.where(truck, TYPICAL_TRUCK_M[0], 0.0))
    car = (length_m >= TWO_WHEELER_M[0]) & (length_m < CAR_M[0])
    truck = (length_m >= CAR_M[0]) & (length_m < TRUCK_M[0])
    least_width = np.where(car, TYPICAL_CAR_M[1], np.where(truck, TYPICAL_TRUCK_M[1], 0.0))
    return (
        np.where(length_known, length_m, np.maximum(length_m, least_length)),
        np.where(width_known, width_m, np.maximum(width_m, least_width)),
    )


def by_size(length_m: Floats, width_m: Floats) -> NDArray[np.int64]:
    """(n,) index into `NAMES`."""
    long_m, short_m = np.maximum(length_m, width_m), np.minimum(length_m, width_m)
    rules = [
        (long_m < POINT_M, POINT),
        (long_m < PEDESTRIAN_M, PEDESTRIAN),
        ((long_m < TWO_WHEELER_M[0]) & (short_m < TWO_WHEELER_M[1]), BICYCLE),
        ((long_m < CAR_M[0]) & (short_m < CAR_M[1]), CAR),
        ((long_m < TRUCK_M[0]) & (short_m < TRUCK_M[1]), TRUCK),
    ]
    found = np.full(len(long_m), WIDE, dtype=np.int64)
    for condition, name in reversed(rules):
        found[condition] = name
    return found
