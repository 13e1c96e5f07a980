"""Calibrated reflectivities: words that say how bright a surface is, wherever it stands.

Belongs here: the scale of a white plate, and of retro-reflectors beyond it. Not: which word a family reserves.
"""

from __future__ import annotations

import numpy as np

from protocols.scan import Floats

RETRO = 1000.0
"Reflectivity over that of a white plate that is reported as 255; ours, makers calibrate with retro-reflectors."


def calibrated(range_m: Floats, intensity: Floats, white_m2: float, white: float) -> Floats:
    """Whole words: up to `white` as a diffuse plate seen straight, by the logarithm beyond up to 255; 0: no echo.

    intensity over the threshold; its decrease with the distance is removed, that with air and incidence is not.
    white_m2: signal of a white plate at 1 m over the detection threshold.
    """
    share = np.nan_to_num(intensity * range_m * range_m / white_m2, nan=0.0)
    bright = white + (255.0 - white) * np.log(np.maximum(share, 1.0)) / np.log(RETRO)
    return np.asarray(np.rint(np.where(share <= 1.0, white * share, np.clip(bright, white + 1.0, 255.0))))
