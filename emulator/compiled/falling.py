"""Drops and flakes of the world that stand in the beams of a sweep.

Belongs here: the loop over boxes, their cells and particles. Not: which boxes (physics.world_particles).
"""

# mypy: disable-error-code="no-untyped-def"
from __future__ import annotations

import math

import numpy as np

from emulator.compiled.jit import FLAG, FLOAT, FLOATS, INT, INT_ROWS, INTS, OUT_FLOATS, OUT_INTS, ROWS, compiled

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
def first_near(px, py, pz, origin, axis, first, last, along, moved, octave, lever, beyond):
    """First beam whose line comes nearer to a place than `beyond`; one more than the last: none.

    From beam to beam the distance from a foot at `lever` of the octave's end changes by no more than the way from the
    one to the other there: as many are passed over as cannot make up for it.
    """
    i = first
    while i <= last:
        square = beside_beam(px, py, pz, origin, axis, i)
        if square <= beyond * beyond:
            return i
        at = octave + i
        goal = moved[at] + lever * (along[at] - moved[at]) + math.sqrt(square) - beyond
        low, high = i + 1, last + 1
        while low < high:
            at = octave + (low + high) // 2
            if moved[at] + lever * (along[at] - moved[at]) < goal:
                low = at - octave + 1
            else:
                high = at - octave
        i = low
    return i


@compiled()
def last_near(px, py, pz, origin, axis, first, last, along, moved, octave, lever, beyond):
    """The last of them, from the last on back to the first, which is one."""
    i = last
    while i > first:
        square = beside_beam(px, py, pz, origin, axis, i)
        if square <= beyond * beyond:
            return i
        at = octave + i
        goal = moved[at] + lever * (along[at] - moved[at]) - math.sqrt(square) + beyond
        low, high = first - 1, i - 1
        while low < high:
            at = octave + (low + high + 1) // 2
            if moved[at] + lever * (along[at] - moved[at]) > goal:
                high = at - octave - 1
            else:
                low = at - octave
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


@compiled(
    INT, FLOATS, FLOAT, FLOAT, FLOAT, FLOAT, FLOATS, INTS, FLOATS, FLOATS, FLOATS, INT_ROWS, INT_ROWS, INTS, INTS,
    FLOATS, FLOATS, FLOATS, ROWS, ROWS, ROWS, FLOATS, FLOAT, FLOAT, FLOAT, FLAG, FLOATS, FLOAT, FLOAT, OUT_INTS,
    OUT_FLOATS, OUT_FLOATS,
)  # fmt: skip
def falling(
    key, poisson, low_mm, slope_mm, lost, largest_mm, cell_m, bucket, near_m, far_m, reach_m, low, size, first, last,
    along, moved, end_m, origin, axis, across, until_m, tan_x, tan_y, exit_m, gaussian, least_mm, least_from,
    least_step, out_beam, out_range, out_size,
):  # fmt: skip
    """Number of particles found, see `world_particles.in_boxes`; written are as many as there is room for."""
    total, room = 0, len(out_beam)
    corner_x, corner_y, corner_z = np.zeros(4), np.zeros(4), np.zeros(4)
    zero, before, aside, bend = np.uint64(0), -1, 0.0, 0.0
    key_word = np.uint64(key)
    cx, cy, cz = cell_m[0], cell_m[1], cell_m[2]
    for b in range(len(bucket)):
        start, stop, end = first[bucket[b]], last[bucket[b]], end_m[bucket[b]]
        octave = start - start % len(axis)
        f, g = start - octave, stop - octave
        m = (f + g) // 2
        length, shift = along[stop] - along[start], moved[stop] - moved[start]
        k0 = min(max(int((near_m[b] - least_from) / least_step), 0), len(least_mm) - 1)
        k1 = min(max(int((far_m[b] - least_from) / least_step), 0), len(least_mm) - 1)
        least_here = least_mm[k0]
        for k in range(k0, k1 + 1):
            least_here = min(least_here, least_mm[k])
        too_small = 0.0  # uniform numbers below give smaller ones
        if slope_mm > 0.0 and least_here > low_mm:
            too_small = -math.expm1(-slope_mm * (least_here - low_mm)) / lost * (1.0 - 1e-12)
        if bucket[b] != before:
            before = bucket[b]
            aside, bend = bulge(origin, axis, f, g)
        for k in range(2):
            r = far_m[b] if k else near_m[b]
            for j in range(2):
                i = g if j else f
                corner_x[2 * k + j] = origin[i, 0] + r * axis[i, 0]
                corner_y[2 * k + j] = origin[i, 1] + r * axis[i, 1]
                corner_z[2 * k + j] = origin[i, 2] + r * axis[i, 2]
        beyond = 1.01 * reach_m[b]
        beside = 1.01 * (reach_m[b] + aside + far_m[b] * bend)
        for iz in range(low[b, 2], low[b, 2] + size[b, 2]):
            # what of the fan is as high as these cells
            below, above = iz * cz - beside, (iz + 1) * cz + beside
            x_low, x_high = row(corner_x, corner_z, below, above)
            if x_low > x_high:
                continue
            y_low, y_high = row(corner_y, corner_z, below, above)
            iy_low = max(low[b, 1], math.floor((y_low - beside) / cy))
            iy_high = min(low[b, 1] + size[b, 1], math.floor((y_high + beside) / cy) + 1)
            for iy in range(iy_low, iy_high):
                row_low, row_high = row(corner_x, corner_y, iy * cy - beside, (iy + 1) * cy + beside)
                if row_low > row_high:
                    continue
                row_low, row_high = max(row_low, x_low), min(row_high, x_high)
                ix_low = max(low[b, 0], math.floor((row_low - beside) / cx))
                ix_high = min(low[b, 0] + size[b, 0], math.floor((row_high + beside) / cx) + 1)
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
                        slack = beside + 1.01 * (shift + reach_m[b])
                        if off > slack * slack:
                            continue
                        d = largest_mm
                        if slope_mm > 0.0:
                            d = min(low_mm - math.log1p(-uniform * lost) / slope_mm, largest_mm)
                        if d < least_here:
                            continue
                        lever = min(far_m[b], r + shift) / end
                        i = first_near(px, py, pz, origin, axis, f, g, along, moved, octave, lever, beyond)
                        if i > g:
                            continue
                        until = last_near(px, py, pz, origin, axis, i, g, along, moved, octave, lever, beyond)
                        while i <= until:
                            tx, ty, tz = px - origin[i, 0], py - origin[i, 1], pz - origin[i, 2]
                            ax, ay, az = axis[i, 0], axis[i, 1], axis[i, 2]
                            r = tx * ax + ty * ay + tz * az
                            i += 1
                            if not (near_m[b] <= r < far_m[b] and r < until_m[i - 1]):
                                continue
                            tx, ty, tz = tx - r * ax, ty - r * ay, tz - r * az
                            wide = tan_x * r + exit_m
                            if len(across) == 0:
                                square = (tx * tx + ty * ty + tz * tz) / max(wide * wide, 1e-300)
                            else:
                                sx, sy, sz = across[i - 1, 0], across[i - 1, 1], across[i - 1, 2]
                                u = (tx * sx + ty * sy + tz * sz) / max(wide, 1e-150)
                                v = (
                                    tx * (ay * sz - az * sy) + ty * (az * sx - ax * sz) + tz * (ax * sy - ay * sx)
                                ) / max(tan_y * r + exit_m, 1e-150)
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
