"""Functions of one number that a processor computes for several at once, which those of the C library are not.

Belongs here: elementary functions without branches or calls. Not: loops.
"""

# mypy: disable-error-code="no-untyped-def"
from __future__ import annotations

import math

import numpy as np

from emulator.compiled.jit import compiled

_EXP = tuple(1.0 / math.factorial(n) for n in range(14))
_COS = tuple((-1.0) ** n / math.factorial(2 * n) for n in range(11))
_SIN = tuple((-1.0) ** n / math.factorial(2 * n + 1) for n in range(11))
_HALVES = np.where(np.arange(900) <= 829, 0.5 ** np.arange(900.0), 0.0)
"Powers of a half; below 1e-250, see `physics.arrays.LOG_NOTHING`, nothing."
_LN_2_HIGH, _LN_2_LOW = 6.93147180369123816490e-01, 1.90821492927058770002e-10
"Their sum is the logarithm of 2; the first has bits left for a whole factor."


@compiled()
def exp(exponent):
    """e to numbers up to 0, wrong by 3e-16; 0 below 1e-250."""
    exponent = exponent if exponent >= -600.0 else -600.0
    whole = np.floor(exponent / (_LN_2_HIGH + _LN_2_LOW) + 0.5)
    rest = (exponent - whole * _LN_2_HIGH) - whole * _LN_2_LOW
    total = _EXP[13]
    for n in range(12, -1, -1):
        total = total * rest + _EXP[n]
    return total * _HALVES[int(-whole)]


@compiled()
def faded(depth):
    """e to -depth, for numbers one at a time: little depths have two short chains of terms; wrong by 3e-16."""
    if depth > 0.0625:
        return exp(-depth)
    square = depth * depth
    even = ((_EXP[8] * square + _EXP[6]) * square + _EXP[4]) * square + _EXP[2]
    odd = (_EXP[7] * square + _EXP[5]) * square + _EXP[3]
    return 1.0 - depth * (1.0 + odd * square) + even * square


@compiled()
def short_cos_sin(angle):
    """Cosine and sine of angles up to half a turn, as `physics.arrays.cos_sin` has them."""
    half = 0.5 * angle
    square = half * half
    # written out: of a loop over the terms those over angles are not made to take several at once
    sine, cosine = _SIN[10], _COS[10]
    sine, cosine = sine * square + _SIN[9], cosine * square + _COS[9]
    sine, cosine = sine * square + _SIN[8], cosine * square + _COS[8]
    sine, cosine = sine * square + _SIN[7], cosine * square + _COS[7]
    sine, cosine = sine * square + _SIN[6], cosine * square + _COS[6]
    sine, cosine = sine * square + _SIN[5], cosine * square + _COS[5]
    sine, cosine = sine * square + _SIN[4], cosine * square + _COS[4]
    sine, cosine = sine * square + _SIN[3], cosine * square + _COS[3]
    sine, cosine = sine * square + _SIN[2], cosine * square + _COS[2]
    sine, cosine = sine * square + _SIN[1], cosine * square + _COS[1]
    sine, cosine = sine * square + _SIN[0], cosine * square + _COS[0]
    sine *= half
    return 1.0 - 2.0 * sine * sine, 2.0 * sine * cosine


@compiled()
def cos_sin(angle):
    """The same of any angle, wrong by 2e-15 and by the rounding of the angle."""
    turns = angle * (0.5 / np.pi)
    return short_cos_sin(2.0 * np.pi * (turns - np.rint(turns)))


@compiled()
def _arc(square):
    """(arcsine of x) / x - 1 by x^2 up to a quarter: Sun's fdlibm, e_asin.c."""
    above = (3.47933107596021167570e-05 * square + 7.91534994289814532176e-04) * square - 4.00555345006794114027e-02
    above = ((above * square + 2.01212532134862925881e-01) * square - 3.25565818622400915405e-01) * square
    below = (7.70381505559019352791e-02 * square - 6.88283971605453293030e-01) * square + 2.02094576023350569471e00
    return square * (above + 1.66666666666666657415e-01) / ((below * square - 2.40339491173441421878e00) * square + 1.0)


@compiled()
def arc_sine_of_root(square, rest):
    """Arcsine of the root of a number from 0 to 1, of which `rest` is missing to 1; wrong by 4e-16."""
    root = np.sqrt(square)
    near_1 = square > 0.25
    half = 0.5 * rest / (1.0 + root) if near_1 else square
    x = np.sqrt(half) if near_1 else root
    found = x + x * _arc(half)
    return 0.5 * np.pi - 2.0 * found if near_1 else found
