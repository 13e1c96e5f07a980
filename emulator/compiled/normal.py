"""Normal numbers of random words, of many at once: in steps without branches, each over a whole array.

Belongs here: the inverse of the normal distribution's function, after M. J. Wichura, AS 241, Applied Statistics 37 (3),
477-484 (1988), as `statistics.NormalDist` has it. Its results are those of `scipy.special.ndtri` to rounding.
"""

# mypy: disable-error-code="no-untyped-def"
from __future__ import annotations

import numpy as np

from emulator.compiled.jit import compiled

_MIDDLE = 0.425
_ROOT_2, _LN_2_HIGH, _LN_2_LOW = 2.0**0.5, 6.93147180369123816490e-01, 1.90821492927058770002e-10
_ONE, _WHOLE, _FRACTION = np.uint64(0x3FF0000000000000), np.uint64(0x4330000000000000), np.uint64(2**52 - 1)
"Bits of 1 and of 2^52, and those behind the binary point."


@compiled()
def unit(word):
    """The number in (0, 1) that a random word stands for, as `physics.random_streams` has it."""
    return (np.float64(word >> np.uint64(11)) + 0.5) * 2.0**-53


@compiled()
def _central(r):
    above = 2.50908092873012267270e3 * r + 3.34305755835881281050e4
    above = (above * r + 6.72657709270087008530e4) * r + 4.59219539315498714570e4
    above = (above * r + 1.37316937655094611250e4) * r + 1.97159095030655144270e3
    above = (above * r + 1.33141667891784377450e2) * r + 3.38713287279636660800e0
    below = 5.22649527885285456100e3 * r + 2.87290857357219426740e4
    below = (below * r + 3.93078958000927106100e4) * r + 2.12137943015865958670e4
    below = (below * r + 5.39419602142475110770e3) * r + 6.87187007492057908300e2
    return above / ((below * r + 4.23133307016009112520e1) * r + 1.0)


@compiled()
def _tail(r):
    above = 7.74545014278341407640e-4 * r + 2.27238449892691845833e-2
    above = (above * r + 2.41780725177450611770e-1) * r + 1.27045825245236838258e0
    above = (above * r + 3.64784832476320460504e0) * r + 5.76949722146069140550e0
    above = (above * r + 4.63033784615654529590e0) * r + 1.42343711074968357734e0
    below = 1.05075007164441684324e-9 * r + 5.47593808499534494600e-4
    below = (below * r + 1.51986665636164571966e-2) * r + 1.48103976427480074590e-1
    below = (below * r + 6.89767334985100004550e-1) * r + 1.67638483018380384940e0
    return above / ((below * r + 2.05319162663775882187e0) * r + 1.0)


@compiled()
def _end(r):
    above = 2.01033439929228813265e-7 * r + 2.71155556874348757815e-5
    above = (above * r + 1.24266094738807843860e-3) * r + 2.65321895265761230930e-2
    above = (above * r + 2.96560571828504891230e-1) * r + 1.78482653991729133580e0
    above = (above * r + 5.46378491116411436990e0) * r + 6.65790464350110377720e0
    below = 2.04426310338993978564e-15 * r + 1.42151175831644588870e-7
    below = (below * r + 1.84631831751005468180e-5) * r + 7.86869131145613259100e-4
    below = (below * r + 1.48753612908506148525e-2) * r + 1.36929880922735805310e-1
    return above / ((below * r + 5.99832206555887937690e-1) * r + 1.0)


@compiled()
def normals(chance, count, out, low, power):
    """Put the normal numbers that are exceeded with one less these chances (count,) into `out`; two more for work."""
    for i in range(count):
        low[i] = min(chance[i], 1.0 - chance[i])
    # logarithms: of 1 to 2 after the powers of 2
    bits, powers = low.view(np.uint64), power.view(np.uint64)
    for i in range(count):
        powers[i] = (bits[i] >> np.uint64(52)) | _WHOLE
        bits[i] = (bits[i] & _FRACTION) | _ONE
    for i in range(count):
        m, e = low[i], power[i] - (2.0**52 + 1023.0)
        high = m > _ROOT_2
        f, e = (0.5 * m if high else m) - 1.0, e + 1.0 if high else e
        s, half = f / (2.0 + f), 0.5 * f * f
        z = s * s
        series = z * 1.479819860511658591e-1 + 1.531383769920937332e-1
        series = (series * z + 1.818357216161805012e-1) * z + 2.222219843214978396e-1
        series = (series * z + 2.857142874366239149e-1) * z + 3.999999999940941908e-1
        series = (series * z + 6.666666666666735130e-1) * z
        log = e * _LN_2_HIGH - ((half - (s * (half + series) + e * _LN_2_LOW)) - f)
        low[i] = np.sqrt(-log)
    for i in range(count):
        q = chance[i] - 0.5
        far = _tail(low[i] - 1.6)
        near = q * _central(0.180625 - q * q)
        far = -far if q < 0.0 else far
        out[i] = near if abs(q) <= _MIDDLE else far
    for i in range(count):
        if low[i] > 5.0:
            far = _end(low[i] - 5.0)
            out[i] = -far if chance[i] < 0.5 else far
