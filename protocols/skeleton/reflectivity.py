"""Calibrated reflectivities: words that say how bright a surface is, wherever it stands.

Belongs here: the scale of a white plate, of retro-reflectors beyond it, and rounding to words. Not: which word a
family reserves.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from protocols.scan import Floats

RETRO = 1000.0
"Reflectivity over that of a white plate that is reported as 255; ours, makers calibrate with retro-reflectors."
LOG_RETRO = math.log(RETRO)
MAGIC = 1.5 * 2.0**52
"Added to a number of doubles, it rounds it to even; the low bits are that number, or 0 of NaN."


def whole(values: Floats) -> NDArray[np.uint32]:
    """The nearest whole numbers of values from 0 below 2^32, of NaN 0; the values are changed."""
    values += MAGIC
    return values.view(np.uint64).astype(np.uint32)


def calibrated(range_m: Floats, intensity: Floats, white_m2: float, white: float) -> NDArray[np.uint32]:
    """Up to `white` as a diffuse plate seen straight, by the logarithm beyond up to 255; 0: no echo, NaN.

    intensity over the threshold; its decrease with the distance is removed, that with air and incidence is not.
    white_m2: signal of a white plate at 1 m over the detection threshold.
    """
    bright = (white / white_m2) * intensity
    bright *= range_m
    bright *= range_m
    beyond = (bright > white).nonzero()
    if len(beyond[0]):
        brighter = np.log(bright[beyond] / white) / LOG_RETRO
        bright[beyond] = np.minimum(np.maximum(white + (255.0 - white) * brighter, white + 1.0), 255.0)
    return whole(bright)
