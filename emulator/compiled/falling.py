"""Drops and flakes of the world that stand in the beams of a sweep.

Belongs here: what `world_particles.in_beams` does with arrays: boxes about buckets of beams, their cells and particles,
the beams that these are in. Not: the law of the particles (physics.particle_light).
"""

# mypy: disable-error-code="no-untyped-def"
from __future__ import annotations

import math

import numpy as np

from emulator.compiled.jit import FLAG, FLOAT, FLOATS, INTS, OUT_FLOATS, OUT_INTS, ROWS, compiled

_STEP = np.uint64(0x9E3779B97F4A7C15)
_X, _Y, _Z = np.uint64(0x9E3779B97F4A7C15), np.uint64(0xC2B2AE3D27D4EB4F), np.uint64(0x165667B19E3779F9)
_M1, _M2 = np.uint64(0xBF58476D1CE4E5B9), np.uint64(0x94D049BB133111EB)
_30, _27, _31, _11, _21, _42 = (np.uint64(k) for k in (30, 27, 31, 11, 21, 42))
_MASK, _TWO = np.uint64(2**21 - 1), np.uint64(2)


@compiled()
def mixed(word):
    """`world_particles.mixed`."""
    word = (word ^ (word >> _30)) * _M1
    word = (word ^ (word >> _27)) * _M2
    return word ^ (word >> _31)


@compiled()
def unit(word):
    """A uniform number of a word."""
    return (np.float64(word >> _11) + 0.5) * 2.0**-53


@compiled()
def beside_beam(px, py, pz, origin, axis, i):
    """Square of the distance of a place from a beam's line."""
    tx, ty, tz = px - origin[i, 0], py - origin[i, 1], pz - origin[i, 2]
    r = tx * axis[i, 0] + ty * axis[i, 1] + tz * axis[i, 2]
    return tx * tx + ty * ty + tz * tz - r * r


@compiled()
def first_near(px, py, pz, origin, axis, first, last, moved, turned, lever, beyond):
    """First beam whose line comes nearer to a place than `beyond`; one more than the last: none.

    From beam to beam the distance from a foot not beyond `lever` changes by no more than the way from the one to the
    other there: as many are passed over as cannot make up for it.
    """
    i = first
    while i <= last:
        square = beside_beam(px, py, pz, origin, axis, i)
        if square <= beyond * beyond:
            return i
        goal = moved[i] + lever * turned[i] + math.sqrt(square) - beyond
        low, high = i + 1, last + 1
        while low < high:
            at = (low + high) // 2
            if moved[at] + lever * turned[at] < goal:
                low = at + 1
            else:
                high = at
        i = low
    return i


@compiled()
def last_near(px, py, pz, origin, axis, first, last, moved, turned, lever, beyond):
    """The last of them, from the last on back to the first, which is one."""
    i = last
    while i > first:
        square = beside_beam(px, py, pz, origin, axis, i)
        if square <= beyond * beyond:
            return i
        goal = moved[i] + lever * turned[i] - math.sqrt(square) + beyond
        low, high = first - 1, i - 1
        while low < high:
            at = (low + high + 1) // 2
            if moved[at] + lever * turned[at] > goal:
                high = at - 1
            else:
                low = at
        i = low
    return first


@compiled()
def bulge(origin, axis, f, g):
    """How far beams from f to g are beside the face between these two: at their begins, and more by their ranges."""
    aside = bend = 0.0
    ax, ay, az = axis[f, 0], axis[f, 1], axis[f, 2]
    ex, ey, ez = axis[g, 0] - ax, axis[g, 1] - ay, axis[g, 2] - az
    ox, oy, oz = origin[f, 0], origin[f, 1], origin[f, 2]
    sx, sy, sz = origin[g, 0] - ox, origin[g, 1] - oy, origin[g, 2] - oz
    square = max(ex * ex + ey * ey + ez * ez, 1e-300)
    for i in range(f + 1, g):
        x, y, z = axis[i, 0] - ax, axis[i, 1] - ay, axis[i, 2] - az
        part = min(max((x * ex + y * ey + z * ez) / square, 0.0), 1.0)
        x, y, z = x - part * ex, y - part * ey, z - part * ez
        bend = max(bend, x * x + y * y + z * z)
        x, y, z = origin[i, 0] - ox - part * sx, origin[i, 1] - oy - part * sy, origin[i, 2] - oz - part * sz
        aside = max(aside, x * x + y * y + z * z)
    return math.sqrt(aside), math.sqrt(bend)


@compiled()
def row(px, py, low_y, high_y):
    """Least and largest x of the hull of four points between two y; the least is larger where nothing is there."""
    low, high = math.inf, -math.inf
    for i in range(3):
        for j in range(i + 1, 4):
            ax, ay, bx, by = px[i], py[i], px[j], py[j]
            if ay > by:
                ax, ay, bx, by = bx, by, ax, ay
            if by < low_y or ay > high_y:
                continue
            slope = (bx - ax) / max(by - ay, 1e-300)
            begin = ax if ay >= low_y else ax + slope * (low_y - ay)
            end = bx if by <= high_y else ax + slope * (high_y - ay)
            low, high = min(low, begin, end), max(high, begin, end)
    return low, high


@compiled()
def in_box(
    box, f, g, near_m, far_m, reach_m, shift, aside, bend, key_word, poisson, low_mm, slope_mm, lost, largest_mm,
    cell_m, origin, axis, across, until_m, moved, turned, tan_x, tan_y, exit_m, gaussian, least_mm, least_from,
    least_step, total, out_beam, out_range, out_size,
):  # fmt: skip
    """Particles of one class in a box of cells about beams from f to g between two ranges; how many there are then."""
    room, zero = len(out_beam), np.uint64(0)
    low_x, low_y, low_z, high_x, high_y, high_z = box
    cx, cy, cz = cell_m
    m = (f + g) // 2
    k0 = min(max(int((near_m - least_from) / least_step), 0), len(least_mm) - 1)
    k1 = min(max(int((far_m - least_from) / least_step), 0), len(least_mm) - 1)
    least_here = least_mm[k0]
    for k in range(k0, k1 + 1):
        least_here = min(least_here, least_mm[k])
    too_small = 0.0  # uniform numbers below give smaller ones
    if slope_mm > 0.0 and least_here > low_mm:
        too_small = -math.expm1(-slope_mm * (least_here - low_mm)) / lost * (1.0 - 1e-12)
        if too_small >= 1.0:
            return total
    corner_x = corners(0, origin, axis, f, g, near_m, far_m)
    corner_y = corners(1, origin, axis, f, g, near_m, far_m)
    corner_z = corners(2, origin, axis, f, g, near_m, far_m)
    beyond = 1.01 * reach_m
    beside = 1.01 * (reach_m + aside + far_m * bend)
    for iz in range(low_z, high_z):
        # what of the fan is as high as these cells
        below, above = iz * cz - beside, (iz + 1) * cz + beside
        fan_low, fan_high = row(corner_x, corner_z, below, above)
        if fan_low > fan_high:
            continue
        deep_low, deep_high = row(corner_y, corner_z, below, above)
        iy_low = max(low_y, math.floor((deep_low - beside) / cy))
        iy_high = min(high_y, math.floor((deep_high + beside) / cy) + 1)
        for iy in range(iy_low, iy_high):
            row_low, row_high = row(corner_x, corner_y, iy * cy - beside, (iy + 1) * cy + beside)
            if row_low > row_high:
                continue
            row_low, row_high = max(row_low, fan_low), min(row_high, fan_high)
            ix_low = max(low_x, math.floor((row_low - beside) / cx))
            ix_high = min(high_x, math.floor((row_high + beside) / cx) + 1)
            for ix in range(ix_low, ix_high):
                word = mixed((np.uint64(ix) * _X) ^ key_word)
                word = mixed(word + np.uint64(iy) * _Y)
                word = mixed(word + np.uint64(iz) * _Z)
                chance = unit(mixed(word + _STEP))
                number = 0
                while number < len(poisson) and poisson[number] <= chance:
                    number += 1
                turn = zero
                for _ in range(number):
                    turn += _TWO
                    own = mixed(word + turn * _STEP)
                    uniform = unit(mixed(own + _STEP))
                    if uniform < too_small:
                        continue
                    px = (ix + (np.float64(own & _MASK) + 0.5) * 2.0**-21) * cx
                    py = (iy + (np.float64((own >> _21) & _MASK) + 0.5) * 2.0**-21) * cy
                    pz = (iz + (np.float64((own >> _42) & _MASK) + 0.5) * 2.0**-21) * cz
                    bx, by, bz = px - origin[m, 0], py - origin[m, 1], pz - origin[m, 2]
                    r = math.sqrt(bx * bx + by * by + bz * bz)
                    bx, by, bz = (
                        origin[f, 0] + r * axis[f, 0],
                        origin[f, 1] + r * axis[f, 1],
                        origin[f, 2] + r * axis[f, 2],
                    )
                    ex, ey, ez = (
                        origin[g, 0] + r * axis[g, 0] - bx,
                        origin[g, 1] + r * axis[g, 1] - by,
                        origin[g, 2] + r * axis[g, 2] - bz,
                    )
                    square = ex * ex + ey * ey + ez * ez
                    part = ((px - bx) * ex + (py - by) * ey + (pz - bz) * ez) / max(square, 1e-300)
                    part = min(max(part, 0.0), 1.0)
                    ox, oy, oz = px - bx - part * ex, py - by - part * ey, pz - bz - part * ez
                    off = ox * ox + oy * oy + oz * oz
                    # a beam that it is in may have its foot as much farther or nearer as beams begin apart
                    slack = beside + 1.01 * (shift + reach_m)
                    if off > slack * slack:
                        continue
                    d = largest_mm
                    if slope_mm > 0.0:
                        d = min(low_mm - math.log1p(-uniform * lost) / slope_mm, largest_mm)
                    # beams that it is in have their feet so far from here at the most
                    foot = shift + reach_m
                    k0 = min(max(int((max(r - foot, near_m) - least_from) / least_step), 0), len(least_mm) - 1)
                    k1 = min(max(int((min(r + foot, far_m) - least_from) / least_step), 0), len(least_mm) - 1)
                    bright = False
                    for k in range(k0, k1 + 1):
                        if d >= least_mm[k]:
                            bright = True
                            break
                    if not bright:
                        continue
                    lever = min(far_m, r + shift)
                    i = first_near(px, py, pz, origin, axis, f, g, moved, turned, lever, beyond)
                    if i > g:
                        continue
                    until = last_near(px, py, pz, origin, axis, i, g, moved, turned, lever, beyond)
                    while i <= until:
                        tx, ty, tz = px - origin[i, 0], py - origin[i, 1], pz - origin[i, 2]
                        ax, ay, az = axis[i, 0], axis[i, 1], axis[i, 2]
                        r = tx * ax + ty * ay + tz * az
                        i += 1
                        if not (near_m <= r < far_m and r < until_m[i - 1]):
                            continue
                        tx, ty, tz = tx - r * ax, ty - r * ay, tz - r * az
                        wide = tan_x * r + exit_m
                        if len(across) == 0:
                            square = (tx * tx + ty * ty + tz * tz) / max(wide * wide, 1e-300)
                        else:
                            sx, sy, sz = across[i - 1, 0], across[i - 1, 1], across[i - 1, 2]
                            u = (tx * sx + ty * sy + tz * sz) / max(wide, 1e-150)
                            v = (tx * (ay * sz - az * sy) + ty * (az * sx - ax * sz) + tz * (ax * sy - ay * sx)) / max(
                                tan_y * r + exit_m, 1e-150
                            )
                            square = u * u + v * v
                        s = d * math.exp(-min(square, 500.0))
                        if not gaussian:
                            s = d if square < 1.0 else 0.0
                        if s < least_mm[min(max(int((r - least_from) / least_step), 0), len(least_mm) - 1)]:
                            continue
                        if total < room:
                            out_beam[total], out_range[total], out_size[total] = i - 1, r, s
                        total += 1
    return total


@compiled()
def corners(k, origin, axis, f, g, near_m, far_m):
    """A coordinate of the four corners of the face between beams f and g and two ranges."""
    return (
        origin[f, k] + near_m * axis[f, k], origin[g, k] + near_m * axis[g, k],
        origin[f, k] + far_m * axis[f, k], origin[g, k] + far_m * axis[g, k],
    )  # fmt: skip


@compiled()
def cells_about(k, low_o, high_o, low_d, high_d, near_m, far_m, wide, cell):
    """First cell, and one more than the last, in one direction, about beams within these limits."""
    low = low_o[k] + min(near_m * low_d[k], far_m * low_d[k]) - wide
    high = high_o[k] + max(near_m * high_d[k], far_m * high_d[k]) + wide
    return math.floor(low / cell), math.floor(high / cell) + 1


@compiled()
def between(place, x, y):
    """`np.interp` of one number."""
    if place <= x[0]:
        return y[0]
    low, high = 0, len(x) - 1
    if place >= x[high]:
        return y[high]
    while high - low > 1:
        middle = (low + high) // 2
        if x[middle] <= place:
            low = middle
        else:
            high = middle
    return y[low] + (place - x[low]) * (y[high] - y[low]) / (x[high] - x[low])


@compiled()
def ways(rows, out):
    """Running sums of the ways from row to row."""
    for i in range(1, len(rows)):
        x, y, z = rows[i, 0] - rows[i - 1, 0], rows[i, 1] - rows[i - 1, 1], rows[i, 2] - rows[i - 1, 2]
        out[i] = out[i - 1] + math.sqrt(x * x + y * y + z * z)


@compiled(
    INTS, ROWS, INTS, FLOATS, FLOATS, FLOATS, FLOAT, FLOAT, FLOATS, ROWS, ROWS, ROWS, FLOATS, FLOATS, FLOAT, FLOAT,
    FLOAT, FLOAT, FLAG, FLOATS, FLOAT, FLOAT, FLOATS, OUT_INTS, OUT_FLOATS, OUT_FLOATS,
)  # fmt: skip
def falling(
    keys, classes, reaches, reach_range, reach_wide, poisson, slope_mm, largest_mm, limits, centre, axis, across, t_s,
    until_m, covered_m, tan_x, tan_y, exit_m, gaussian, least_mm, least_from, least_step, beam_limits, out_beam,
    out_range, out_size,
):  # fmt: skip
    """Number of particles found, see `world_particles.in_beams`; written are as many as there is room for; -1: they are
    in too many cells.

    `classes` : (c, 7) least size, share, number per m^3, width of a cell, velocity; `reaches` : (c + 1,) where the
    tables of each begin in `reach_range`, `reach_wide`; `limits` : octave, most boxes, most cells, flatness; and
    `beam_limits` : cells that a bucket spans, its widest angle, slack.
    """
    n, total, seen = len(axis), 0, 0.0
    octave, most_boxes, most_cells, flat = limits
    span, widest, slack = beam_limits
    origin, moved, turned = np.zeros((n, 3)), np.zeros(n), np.zeros(n)
    low_o, high_o, low_d, high_d = np.zeros(3), np.zeros(3), np.zeros(3), np.zeros(3)
    ways(axis, turned)
    for c in range(len(keys)):
        low_mm, lost, number, width = classes[c, 0], classes[c, 1], classes[c, 2], classes[c, 3]
        table = slice(reaches[c], reaches[c + 1])
        if table.stop - table.start < 2 or number <= 0.0:
            continue
        range_m, wide_m = reach_range[table], reach_wide[table]
        for i in range(n):
            for k in range(3):
                origin[i, k] = centre[i, k] - t_s[i] * classes[c, 4 + k]
        ways(origin, moved)
        cell_m, step_m = (width, width, width / flat), span * width
        begin, end = range_m[0], range_m[-1]
        while octave * end > max(begin, covered_m):
            end *= octave
        while end > begin:
            near = max(octave * end, begin)
            if near < begin + 2.0 * step_m:
                near = begin
            bucket_m = min(step_m, widest * end)
            steps = max(1, math.ceil((end - near) / step_m))
            buckets, f = 0, 0
            while f < n:
                place = math.floor((moved[f] + end * turned[f]) / bucket_m)
                g = f
                while g + 1 < n and math.floor((moved[g + 1] + end * turned[g + 1]) / bucket_m) == place:
                    g += 1
                buckets += 1
                if buckets * (end - near) > most_boxes * step_m:
                    return -1
                until = until_m[f]
                for i in range(f, g + 1):
                    until = max(until, until_m[i])
                if near < until:
                    for k in range(3):
                        low_o[k] = high_o[k] = origin[f, k]
                        low_d[k] = high_d[k] = axis[f, k]
                        for i in range(f + 1, g + 1):
                            low_o[k], high_o[k] = min(low_o[k], origin[i, k]), max(high_o[k], origin[i, k])
                            low_d[k], high_d[k] = min(low_d[k], axis[i, k]), max(high_d[k], axis[i, k])
                    aside, bend = bulge(origin, axis, f, g)
                for step in range(steps if near < until else 0):
                    near_m = near + step * (end - near) / steps
                    far_m = near + (step + 1) * (end - near) / steps if step + 1 < steps else end
                    if near_m >= until:
                        break
                    reach_m = 0.0
                    for k in range(5):
                        reach_m = max(reach_m, between(near_m + 0.25 * k * (far_m - near_m), range_m, wide_m))
                    reach_m += slack
                    low_x, high_x = cells_about(0, low_o, high_o, low_d, high_d, near_m, far_m, reach_m, cell_m[0])
                    low_y, high_y = cells_about(1, low_o, high_o, low_d, high_d, near_m, far_m, reach_m, cell_m[1])
                    low_z, high_z = cells_about(2, low_o, high_o, low_d, high_d, near_m, far_m, reach_m, cell_m[2])
                    seen += float(high_x - low_x) * float(high_y - low_y) * float(high_z - low_z)
                    if seen > most_cells:
                        return -1
                    total = in_box(
                        (low_x, low_y, low_z, high_x, high_y, high_z), f, g, near_m, far_m, reach_m,
                        moved[g] - moved[f], aside, bend, np.uint64(keys[c]), poisson, low_mm, slope_mm, lost,
                        largest_mm, cell_m, origin, axis, across, until_m, moved, turned, tan_x, tan_y, exit_m,
                        gaussian, least_mm, least_from, least_step, total, out_beam, out_range, out_size,
                    )  # fmt: skip
                f = g + 1
            end = near
    return total
