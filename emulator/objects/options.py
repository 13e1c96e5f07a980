"""What a scenario may choose about object lists. Every default has its reason beside it.

Belongs here: numbers of the tracker. Not: their checks against a file (the scenario's loader has them).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any, Literal


@dataclass(frozen=True)
class TrackerOptions:
    """How objects are made of echoes."""

    segmentation: Literal["cluster", "actor"] = "cluster"
    "cluster: echoes that lie near each other; actor: ideal, echoes of one actor."
    classify: Literal["size", "actor"] = "size"
    "By the size seen so far, or by the actor's class."
    classes: Mapping[str, str] = field(default_factory=lambda: MappingProxyType({}))
    "Class of each actor, for `classify: actor`."
    gap_m: float = 0.6
    "Echoes nearer to each other than this belong together: wider than a car's wheel arch, narrower than a door opens."
    gap_per_m: float = 0.015
    "Added for each metre of range: two steps of a half-degree scanner are 0.0175 rad."
    min_points: int = 2
    "A single echo is no object: fog and rain give those."
    max_size_m: float = 20.0
    "Longer things are walls and guard rails, not road users."
    height_m: tuple[float, float] = (float("-inf"), float("inf"))
    "Echoes outside of this band, in the listing sensor's frame, are ground or bridges."
    coast_s: float = 0.5
    "An object that has not been seen for longer than this is gone."
    confirm_hits: int = 2
    "Scans in which an object must be seen before it is listed."
    position_noise_m: float = 0.1
    "Standard deviation of a box's centre, beside half the distance between beams."
    acceleration_m_s2: float = 3.0
    "White acceleration of the motion model: brisk driving."
    first_speed_m_s: float = 10.0
    "Standard deviation of the speed of what has been seen once."
    gate: float = 16.0
    "Squared Mahalanobis distance beyond which an echo group is another object: 99.97 % of two normal deviates."
    seen_if_there: float = 0.9
    "Probability that a free-standing object gives enough echoes in a scan."
    seen_if_hidden: float = 0.2
    "The same when something stands before it."
    seen_if_not_there: float = 0.2
    "Probability that an echo group appears where no object is."
    first_existence: float = 0.6
    white_range_m: float = 100.0
    "Range at which a white surface just reaches the threshold: turns intensities into reflectances."
    contour_points: int = 60
    "An outline has at most this many points."


OF_FORMAT: Mapping[str, Mapping[str, Any]] = MappingProxyType(
    # a ranging module reports at once what comes back; it neither confirms nor remembers
    {name: MappingProxyType({"confirm_hits": 1, "coast_s": 0.0}) for name in ("leddar_vu8", "leddar_m16")}
)
"Where a format's own default differs from the tracker's."


def options_of(given: Mapping[str, Any], classes: Mapping[str, str], format_name: str = "") -> TrackerOptions:
    """What a scenario's `objects:` table gives, over the format's own defaults; `classes` of the scene's actors."""
    chosen = {**OF_FORMAT.get(format_name, {}), **given}
    if "classification" in chosen:
        chosen["classify"] = chosen.pop("classification")
    return TrackerOptions(**chosen, classes=MappingProxyType(classes))
