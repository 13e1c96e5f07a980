"""What a medium adds under pulses: its integrals at surfaces, its return, and crossings of short clusters in it.

Belongs here: what `SoftProfile` and crossings over `AirUnder` do with arrays. Not: how tables are made (softprofile).
"""

# mypy: disable-error-code="no-untyped-def"
from __future__ import annotations

import numpy as np

from emulator.compiled.arithmetic import cos_sin
from emulator.compiled.clusters import cross
from emulator.compiled.jit import FLOAT, FLOATS, INT, INTS, ROWS, compiled

MEDIUM = (ROWS, INT, FLOAT, FLOAT, FLOATS, FLOATS, ROWS, INTS, FLOAT)
"`SoftProfile.flat`: edged, first, bin_m, wave_number, ends, knots, cubics, cells, cell."


@compiled()
def cell_of(range_m, knots, cells, cell):
    """The knot before a range, and how far behind it that is."""
    r = min(max(range_m, knots[0]), knots[-1])
    i = cells[min(max(int((r - knots[0]) * (1.0 / cell)), 0), len(cells) - 1)]
    while i < len(knots) - 2 and knots[i + 1] <= r:
        i += 1
    return i, r - knots[i]


@compiled()
def cubic(which, i, t, cubics):
    """A (0), real (1) or imaginary part (2) of B, so far behind a knot: what is read together lies together."""
    return ((cubics[i, 9 + which] * t + cubics[i, 6 + which]) * t + cubics[i, 3 + which]) * t + cubics[i, which]


@compiled()
def bounds(number, edged, first, bin_m, wave_number, ends):
    """`upper` and `lower` at a bin, see `SoftProfile.tables`."""
    last = edged.shape[1] - 1
    if number >= first + last:
        turn = wave_number * bin_m * number
        whole = ends[0] + np.cos(turn) * ends[1] - np.sin(turn) * ends[2]
        return whole, whole
    at = min(max(number - (first - 1), 0), last)
    return edged[0, at], edged[1, at]


@compiled()
def stopped(range_m, blocked, start, count, sums, at, knots, cubics, cells, cell):
    """Set `AirUnder.sums` of one cluster behind `at`."""
    for k in range(start, start + count):
        share = blocked[k]
        sums[0, at + 1] = sums[0, at] + share
        i, t = cell_of(range_m[k], knots, cells, cell)
        for part in range(3):
            sums[1 + part, at + 1] = sums[1 + part, at] + share * cubic(part, i, t, cubics)
        at += 1


@compiled()
def left_open(blocked, first, start):
    """Share of the beam that the sub-echoes from `first` to `start` leave."""
    passed = 0.0
    for k in range(first, start):
        passed += blocked[k]
    return min(max(1.0 - passed, 0.0), 1.0)


@compiled()
def returned(x_m, free, first, bin_m):
    """A medium's return at an apparent range, linear between bins, 0 beyond them."""
    place = x_m / bin_m - first
    at = int(np.floor(place))
    if at < 0 or at >= len(free) - 1:
        return 0.0
    return free[at] + (place - at) * (free[at + 1] - free[at])


@compiled(*MEDIUM, FLOATS, FLOATS, INTS, INTS)
def ended_under(edged, first, bin_m, wave_number, ends, knots, cubics, cells, cell, range_m, blocked, start, count):
    """(4, m + 1) `AirUnder.sums` of clusters of `count` sub-echoes from `start` on."""
    m = 0
    for c in range(len(count)):
        m += count[c]
    sums = np.zeros((4, m + 1))
    at = 0
    for c in range(len(count)):
        stopped(range_m, blocked, start[c], count[c], sums, at, knots, cubics, cells, cell)
        at += count[c]
    return sums


@compiled()
def _at_bin(number, now, begins, open_, sums, edged, first, bin_m, wave_number, ends):
    """See `AirUnder.at`, at a bin."""
    still = max(open_ - (sums[0, now] - sums[0, begins]), 0.0)
    a, real, imaginary = sums[1, now] - sums[1, begins], sums[2, now] - sums[2, begins], sums[3, now] - sums[3, begins]
    upper, lower = bounds(number, edged, first, bin_m, wave_number, ends)
    cosine, sine = cos_sin(wave_number * bin_m * number)
    return max(0.5 * (still * upper + a + cosine * real - sine * imaginary - open_ * lower), 0.0)


@compiled()
def part_under(x_m, last, before, begins, open_, sums, edged, first, bin_m, wave_number, ends):
    """See `AirUnder.at`."""
    now, number = last - before, int(np.floor(x_m / bin_m))
    near = _at_bin(number, now, begins, open_, sums, edged, first, bin_m, wave_number, ends)
    far = _at_bin(number + 1, now, begins, open_, sums, edged, first, bin_m, wave_number, ends)
    return near + (x_m / bin_m - number) * (far - near)


@compiled()
def lifted_in_air(centre, height, swing, size, open_, sums, edged, first, bin_m, wave_number, ends):
    """Place and height of a cluster's maximum with a medium under it, and how far it shifts it: `cosines._lifted`.

    `swing` : its |C|.
    """
    number = int(np.floor(centre / bin_m))
    share = centre / bin_m - number
    one = _at_bin(number - 1, size, 0, open_, sums, edged, first, bin_m, wave_number, ends)
    two = _at_bin(number, size, 0, open_, sums, edged, first, bin_m, wave_number, ends)
    three = _at_bin(number + 1, size, 0, open_, sums, edged, first, bin_m, wave_number, ends)
    four = _at_bin(number + 2, size, 0, open_, sums, edged, first, bin_m, wave_number, ends)
    before, here, behind = one + share * (two - one), two + share * (three - two), three + share * (four - three)
    slope, curve = 0.5 * (behind - before) / bin_m, (behind - 2.0 * here + before) / (bin_m * bin_m)
    bend = 0.5 * wave_number * wave_number * swing - curve
    shift = slope / bend if bend > 0.0 else 0.0
    shift = shift if abs(shift) <= bin_m else 0.0
    return centre + shift, height + here + 0.5 * slope * shift, abs(shift)


@compiled()
def cross_in_air(
    level, crossing, last, before, begins, open_, sums, edged, first, bin_m, wave_number, ends,
    start, size, first_m, begun, total, real, imaginary, half_m, least, exact_m, passes,
):  # fmt: skip
    """The crossing of one cluster, see `crossed_under`."""
    known, of = 0, -1
    near = far = 0.0
    for _ in range(passes):
        number = int(np.floor(crossing / bin_m))
        if number != known or last != of:  # mostly it moves within a bin
            near = _at_bin(number, last - before, begins, open_, sums, edged, first, bin_m, wave_number, ends)
            far = _at_bin(number + 1, last - before, begins, open_, sums, edged, first, bin_m, wave_number, ends)
            known, of = number, last
        air = near + (crossing / bin_m - number) * (far - near)
        was = crossing
        left = max(level - air, least * level)
        crossing, last = cross(left, start, size, first_m, begun, total, real, imaginary, half_m, wave_number)
        if not abs(crossing - was) > exact_m:
            break
    return crossing


@compiled()
def stands_out(together, length_m, air, dark, begin_m, free, first, bin_m, law):
    """A cluster is so much higher than the medium before it that it has a closed form, see `cosines._near`.

    `together` : sum of its amplitudes; `length_m` : from first to last; `air` : the medium where it begins; `law` : see
    `sensing.receiving`.
    """
    if not (together < law[4] and begin_m >= law[30]):
        return False
    swing = together
    if length_m > 0.0:
        swing *= np.cos(0.5 * law[2] * min(length_m, law[1]))
    apart = returned(max(begin_m - bin_m, law[21]), free, first, bin_m) + dark
    return swing >= law[29] * air and swing >= apart and law[31] >= apart


@compiled()
def out_of_valley(
    level, crossing, centre, height, open_, sums, edged, first, bin_m, wave_number, ends,
    start, size, first_m, begun, total, real, imaginary, half_m, passes,
):  # fmt: skip
    """The crossing of one cluster that begins where the medium may be over the level: `Cosines._out_of_valleys`.

    `open_`, `sums` : of the cluster alone; the rest as for `cross_in_air`.
    """
    begin_m, before = first_m - half_m, start - 1
    place, rise, at = begin_m, 0.0, start
    for _ in range(passes):
        air = part_under(place, at, before, 0, open_, sums, edged, first, bin_m, wave_number, ends)
        behind = part_under(place + bin_m, at, before, 0, open_, sums, edged, first, bin_m, wave_number, ends)
        fall, at = max((air - behind) / bin_m, 0.0), start
        while True:
            swing = np.sqrt(real[at] * real[at] + imaginary[at] * imaginary[at])
            steep, steepest = 2.0 * fall, wave_number * swing
            rises = steep < steepest
            angle = np.arcsin(steep / steepest if rises else 1.0)
            place = begin_m + (np.arctan2(imaginary[at], real[at]) + angle) / wave_number
            rise = 0.5 * (total[at] - swing) + swing * np.sin(0.5 * angle) ** 2
            if at + 1 >= start + size or (rises and not begun[at + 1] < rise):
                break
            at += 1
    air = part_under(place, at, before, 0, open_, sums, edged, first, bin_m, wave_number, ends)
    above = min(max(air + rise - level, 0.0), 1.0)
    if not above > 0.0:
        return crossing
    single = centre - (half_m - 2.0 / wave_number * np.arcsin(np.sqrt(min(max(level / height, 0.0), 1.0))))
    return place + above * (single - place)


@compiled(
    *MEDIUM, FLOATS, INTS, INTS, FLOATS, FLOATS, FLOATS, FLOATS, FLOATS, FLOAT,
    INTS, INTS, FLOATS, ROWS, FLOATS, INTS, FLOAT, FLOAT, INT,
)  # fmt: skip
def crossed_under(
    edged, first, bin_m, wave_number, ends, knots, cubics, cells, cell,
    level, start, size, first_m, begun, total, real, imaginary, half_m,
    before, begins, open_, sums, crossing, last, least, exact_m, passes,
):  # fmt: skip
    """Where clusters with a medium under them first reach a level: looked for again from `crossing` and `last` on until
    they move by less than `exact_m`."""
    found = crossing.copy()
    for c in range(len(level)):
        found[c] = cross_in_air(
            level[c], found[c], last[c], before[c], begins[c], open_[c], sums, edged, first, bin_m, wave_number, ends,
            start[c], size[c], first_m[c], begun, total, real, imaginary, half_m, least, exact_m, passes,
        )  # fmt: skip
    return found
