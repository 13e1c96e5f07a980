"""Weather as it is seen in the scene: the sky by the sun, haze by visibility, rain and snow. Arrays and colours.

Belongs here: what it looks like. Not: sliders and words (sky), handles of viser (page).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from emulator.view.frames import Floats
from emulator.view.sky import visibility_m

Colour = tuple[int, int, int]
NIGHT = np.array([[30, 38, 48], [13, 17, 23]], np.float64)
"At the horizon and above, without a sun: the page's own colours."
DUSK = np.array([[176, 112, 78], [40, 52, 84]], np.float64)
DAY = np.array([[150, 172, 192], [62, 100, 150]], np.float64)
MIST = np.array([128, 136, 142], np.float64)
"Of thick fog by day; at night a third of it."
HIGH_DEG = 15.0
"From this height of the sun on it is day."
ROWS = 96
SUN_M = 600.0
"Where its disc stands."
DROPS_A_MM, MOST_DROPS = 14.0, 500
FLAKES_A_MM, MOST_FLAKES = 60.0, 900
FALL_M_S = {"rain": 7.0, "snow": 1.2}


def sun_of(weather: Mapping[str, Any]) -> tuple[float, float] | None:
    """Height and direction of the sun; None without one. [degrees]"""
    sun = weather.get("sun")
    return None if not sun else (float(sun.get("elevation_deg", 45.0)), float(sun.get("azimuth_deg", 180.0)))


def sky(weather: Mapping[str, Any]) -> tuple[Colour, Colour]:
    """Colours at the horizon and above."""
    sun = sun_of(weather)
    if sun is None:
        found, light = NIGHT, 0.33
    else:
        share = float(np.clip(sun[0] / HIGH_DEG, 0.0, 1.0))
        found, light = DUSK + (DAY - DUSK) * share, 0.6 + 0.4 * share
    seen_m = visibility_m(weather)
    if seen_m is not None:
        thick = float(np.clip(1.0 - math.log10(max(seen_m, 1.0) / 100.0) / 2.0, 0.0, 1.0))  # 10 km none, 100 m all
        found = found + (MIST * light - found) * thick
    low, high = np.round(found).astype(int).tolist()
    return (low[0], low[1], low[2]), (high[0], high[1], high[2])


def backdrop(weather: Mapping[str, Any]) -> NDArray[np.uint8]:
    """(rows, columns, 3) picture behind the scene."""
    low, high = (np.array(one, np.float64) for one in sky(weather))
    share = np.linspace(1.0, 0.0, ROWS)[:, None, None] ** 1.5
    return np.broadcast_to(low + (high - low) * share, (ROWS, ROWS, 3)).astype(np.uint8)


def haze_m(weather: Mapping[str, Any], look_m: float) -> tuple[float, float] | None:
    """Distances from the camera between which things fade away, as it first stands `look_m` off; None: not at all.

    They are gone at the visibility, counted from the scene: in fog of 10 m its middle can still be seen.
    """
    seen_m = visibility_m(weather)
    return None if seen_m is None or seen_m > 50.0 * look_m else (0.5 * look_m, look_m + seen_m)


def sun_m(weather: Mapping[str, Any]) -> Floats | None:
    """(3,) place of the sun's disc around the scene; None without a sun."""
    sun = sun_of(weather)
    if sun is None:
        return None
    up, round_ = math.radians(sun[0]), math.radians(sun[1])
    flat = math.cos(up)
    return SUN_M * np.array([flat * math.cos(round_), flat * math.sin(round_), math.sin(up)])


def rate_mm_h(weather: Mapping[str, Any], name: str) -> float:
    """Of rain or snow; 0 without."""
    return float((weather.get(name) or {}).get("rate_mm_h", 0.0) or 0.0)


def drops(weather: Mapping[str, Any], now_s: float, reach_m: float) -> Floats:
    """(n, 2, 3) strokes of rain around the scene's middle at that instant; the more the more it rains."""
    count = min(MOST_DROPS, math.ceil(DROPS_A_MM * rate_mm_h(weather, "rain")))
    tops = _falling(count, now_s, reach_m, FALL_M_S["rain"])
    return np.stack([tops, tops - (0.0, 0.0, 0.035 * reach_m)], axis=1)


def flakes(weather: Mapping[str, Any], now_s: float, reach_m: float) -> Floats:
    """(n, 3) flakes of snow."""
    count = min(MOST_FLAKES, math.ceil(FLAKES_A_MM * rate_mm_h(weather, "snow")))
    return _falling(count, now_s, reach_m, FALL_M_S["snow"])


def _falling(count: int, now_s: float, reach_m: float, speed_m_s: float) -> Floats:
    """Places in a box of twice `reach_m`; each falls, and comes again above."""
    places = np.random.default_rng(7).random((count, 3))
    high_m = 0.9 * reach_m
    places[:, 2] = (places[:, 2] - speed_m_s * now_s / high_m) % 1.0
    return places * (2.0 * reach_m, 2.0 * reach_m, high_m) - (reach_m, reach_m, 0.0)
