"""Drops and flakes of the world that stand in the beams of a sweep.

Belongs here: what `world_particles.in_beams` does with arrays: a tree of neighbouring beams, boxes about its parts,
their cells and particles, the beams that these are in. Not: the law of the particles (physics.particle_light).

A cell is made once for all beams of a part, wherever in it they are: layers that lie close together share it.
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
OF_A_LEAF = 8
"Beams of a leaf of the tree at the most."
RUN = 64
"Beams of a run by which two orders are compared."
FAST_M_S = 8.0
"Velocity at which beams of other instants count as beside each other in the order of the tree."
BLOCK = 64
"Steps of the table of least sizes that are looked up at once."
DEEPEST = 8 * 12
"Nodes that wait to be looked at: fewer than eight of each digit."
WIDE = 1.01
"Margin of places by which nodes are passed over."


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
def spread(number):
    """The lowest ten bits, each with two zeros before it."""
    number = (number | (number << 16)) & 0x030000FF
    number = (number | (number << 8)) & 0x0300F00F
    number = (number | (number << 4)) & 0x030C30C3
    return (number | (number << 2)) & 0x09249249


@compiled()
def by_direction(axis):
    """Numbers along a Morton curve of the beams' directions (n,), and the order in which they rise."""
    n, widest = len(axis), 1e-9
    low = np.zeros(3)
    for k in range(3):
        least = most = axis[0, k]
        for i in range(1, n):
            least, most = min(least, axis[i, k]), max(most, axis[i, k])
        low[k], widest = least, max(widest, most - least)
    scale = 1023.0 / widest
    key, order, other = np.empty(n, np.int64), np.arange(n), np.empty(n, np.int64)
    for i in range(n):
        key[i] = (
            spread(int((axis[i, 0] - low[0]) * scale))
            | (spread(int((axis[i, 1] - low[1]) * scale)) << 1)
            | (spread(int((axis[i, 2] - low[2]) * scale)) << 2)
        )
    begin = np.empty(1025, np.int64)
    for shift in (0, 10, 20):
        begin[:] = 0
        for i in range(n):
            begin[((key[i] >> shift) & 1023) + 1] += 1
        for k in range(1024):
            begin[k + 1] += begin[k]
        for place in range(n):
            digit = (key[order[place]] >> shift) & 1023
            other[begin[digit]] = order[place]
            begin[digit] += 1
        order, other = other, order
    return key, order


@compiled()
def branches(key, order):
    """A tree of beams whose numbers have the same first digits (nodes, 4): its first beam in `order`, one more than
    its last, its first node and one more than its last; no nodes: a leaf. Nodes stand before those in them.
    """
    n = len(order)
    nodes, shift = np.empty((2 * n + 1, 4), np.int64), np.empty(2 * n + 1, np.int64)
    nodes[0, 0], nodes[0, 1], shift[0], count, node = 0, n, 27, 1, 0
    while node < count:
        first, end, bits = nodes[node, 0], nodes[node, 1], shift[node]
        nodes[node, 2] = nodes[node, 3] = count
        if end - first > OF_A_LEAF:
            while bits >= 0 and key[order[first]] >> bits == key[order[end - 1]] >> bits:
                bits -= 3
            if bits >= 0:
                begin = first
                for place in range(first + 1, end + 1):
                    if place == end or key[order[place]] >> bits != key[order[begin]] >> bits:
                        nodes[count, 0], nodes[count, 1], shift[count] = begin, place, bits - 3
                        begin, count = place, count + 1
            else:  # the same direction: halves of their order, which is that of their instants
                middle = (first + end) // 2
                nodes[count, 0], nodes[count, 1], shift[count] = first, middle, -3
                nodes[count + 1, 0], nodes[count + 1, 1], shift[count + 1] = middle, end, -3
                count += 2
            nodes[node, 3] = count
        node += 1
    return nodes[:count].copy()


@compiled()
def bounds(nodes, order, centre, t_s, axis, until_m):
    """Of the beams of each node: least and largest centre, instant and direction (2, nodes, 7), farthest surface."""
    low, high, until = np.empty((len(nodes), 7)), np.empty((len(nodes), 7)), np.empty(len(nodes))
    for node in range(len(nodes) - 1, -1, -1):
        low[node], high[node], until[node] = math.inf, -math.inf, -math.inf
        first, end = nodes[node, 2], nodes[node, 3]
        for child in range(first, end):
            for k in range(7):
                low[node, k], high[node, k] = min(low[node, k], low[child, k]), max(high[node, k], high[child, k])
            until[node] = max(until[node], until[child])
        for place in range(nodes[node, 0], nodes[node, 1] if first == end else nodes[node, 0]):
            i = order[place]
            for k in range(3):
                low[node, k], high[node, k] = min(low[node, k], centre[i, k]), max(high[node, k], centre[i, k])
                low[node, 4 + k] = min(low[node, 4 + k], axis[i, k])
                high[node, 4 + k] = max(high[node, 4 + k], axis[i, k])
            low[node, 3], high[node, 3] = min(low[node, 3], t_s[i]), max(high[node, 3], t_s[i])
            until[node] = max(until[node], until_m[i])
    return low, high, until


@compiled()
def apart(order, centre, t_s, axis, range_m):
    """Sum of the widths of runs of beams in this order, at a range."""
    low, high, total = np.empty(7), np.empty(7), 0.0
    for begin in range(0, len(order), RUN):
        low[:], high[:] = math.inf, -math.inf
        for place in range(begin, min(begin + RUN, len(order))):
            i = order[place]
            for k in range(3):
                low[k], high[k] = min(low[k], centre[i, k]), max(high[k], centre[i, k])
                low[4 + k], high[4 + k] = min(low[4 + k], axis[i, k]), max(high[4 + k], axis[i, k])
            low[3], high[3] = min(low[3], t_s[i]), max(high[3], t_s[i])
        for k in range(7):
            total += (1.0 if k < 3 else FAST_M_S if k == 3 else range_m) * (high[k] - low[k])
    return total


@compiled()
def tree(centre, t_s, axis, until_m, range_m):
    """Order of the beams, tree and bounds: by their directions, or as they come where neighbours lie closer so."""
    key, order = by_direction(axis)
    same = np.arange(len(axis))
    if apart(same, centre, t_s, axis, range_m) < apart(order, centre, t_s, axis, range_m):
        key, order = same, same
    nodes = branches(key, order)
    low, high, until = bounds(nodes, order, centre, t_s, axis, until_m)
    return order, nodes, low, high, until


@compiled()
def packed(order, centre, t_s, axis, until_m):
    """Beams in this order (n, 8): centre, instant, direction, first surface: what is read together lies together."""
    rows = np.empty((len(order), 8))
    for place in range(len(order)):
        i = order[place]
        for k in range(3):
            rows[place, k], rows[place, 4 + k] = centre[i, k], axis[i, k]
        rows[place, 3], rows[place, 7] = t_s[i], until_m[i]
    return rows


@compiled()
def of_class(velocity, low, high, cone):
    """Nodes as lines in the frame of a class (nodes, 9): middle of origins (3), unit vector (3), its length before, and
    how far beams are off at their begins and more by their ranges.
    """
    vx, vy, vz = velocity
    for node in range(len(cone)):
        t, late = 0.5 * (low[node, 3] + high[node, 3]), 0.5 * (high[node, 3] - low[node, 3])
        wx, wy, wz = late * abs(vx), late * abs(vy), late * abs(vz)
        wx, wy = wx + 0.5 * (high[node, 0] - low[node, 0]), wy + 0.5 * (high[node, 1] - low[node, 1])
        wz += 0.5 * (high[node, 2] - low[node, 2])
        cone[node, 0] = 0.5 * (low[node, 0] + high[node, 0]) - t * vx
        cone[node, 1] = 0.5 * (low[node, 1] + high[node, 1]) - t * vy
        cone[node, 2] = 0.5 * (low[node, 2] + high[node, 2]) - t * vz
        cone[node, 7] = math.sqrt(wx * wx + wy * wy + wz * wz)


@compiled()
def directions(low, high, cone):
    """The same of all classes."""
    for node in range(len(cone)):
        turns = length = 0.0
        for k in range(3):
            turn = 0.5 * (high[node, 4 + k] - low[node, 4 + k])
            cone[node, 3 + k] = 0.5 * (low[node, 4 + k] + high[node, 4 + k])
            turns, length = turns + turn * turn, length + cone[node, 3 + k] ** 2
        length = math.sqrt(length)
        for k in range(3):
            cone[node, 3 + k] /= max(length, 1e-300)
        cone[node, 6], cone[node, 8] = length, math.sqrt(turns)


@compiled()
def cells_about(k, node, low, high, velocity, near_m, far_m, wide, cell):
    """First cell, and one more than the last, in one direction, about beams of a node between two ranges."""
    moved, other = low[node, 3] * velocity, high[node, 3] * velocity
    least, most = low[node, k] - max(moved, other), high[node, k] - min(moved, other)
    least += min(near_m * low[node, 4 + k], far_m * low[node, 4 + k]) - wide
    most += max(near_m * high[node, 4 + k], far_m * high[node, 4 + k]) + wide
    return math.floor(least / cell), math.floor(most / cell) + 1


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
def least_between(near_m, far_m, least_from, block_m, least):
    """The least of a table in blocks of range."""
    k0 = min(max(int((near_m - least_from) / block_m), 0), len(least) - 1)
    k1 = min(max(int((far_m - least_from) / block_m), 0), len(least) - 1)
    found = least[k0]
    for k in range(k0 + 1, k1 + 1):
        found = min(found, least[k])
    return found


@compiled()
def in_box(
    box, part, nodes, order, cone, until, near_m, far_m, reach_m, law, velocity, key_word, poisson, cell_m,
    beams, across, shape, least_mm, least_from, least_step, needed, stack, total, out_beam,
    out_range, out_size,
):  # fmt: skip
    """Particles of one class in a box of cells about the beams of a node between two ranges; how many there are then.

    `law` : least size, slope, share, largest size; `shape` : of a beam, see `falling`; `needed` : uniform numbers that
    a particle must have to be large enough, in blocks of range.
    """
    room, zero, block_m = len(out_beam), np.uint64(0), BLOCK * least_step
    low_mm, slope_mm, lost, largest_mm = law
    tan_x, tan_y, exit_m, gaussian = shape
    low_x, low_y, low_z, high_x, high_y, high_z = box
    cx, cy, cz = cell_m
    vx, vy, vz = velocity
    too_small = least_between(near_m, far_m, least_from, block_m, needed)
    if too_small >= 1.0:
        return total
    beyond = WIDE * reach_m
    mx, my, mz, ux, uy, uz = cone[part, 0], cone[part, 1], cone[part, 2], cone[part, 3], cone[part, 4], cone[part, 5]
    begin_off = cone[part, 7]
    # cells whose middles are no nearer hold nothing of these beams
    room_off = beyond + begin_off + far_m * cone[part, 8] + 0.5 * WIDE * math.sqrt(cx * cx + cy * cy + cz * cz)
    short, long_ = near_m * cone[part, 6] - room_off, far_m * cone[part, 6] + room_off
    for ix in range(low_x, high_x):
        word_x = mixed((np.uint64(ix) * _X) ^ key_word)
        to_x = (ix + 0.5) * cx - mx
        for iy in range(low_y, high_y):
            word_y = mixed(word_x + np.uint64(iy) * _Y)
            to_y = (iy + 0.5) * cy - my
            flat, ahead = to_x * to_x + to_y * to_y, to_x * ux + to_y * uy
            for iz in range(low_z, high_z):
                to_z = (iz + 0.5) * cz - mz
                along = ahead + to_z * uz
                if not (short < along < long_) or flat + to_z * to_z - along * along > room_off * room_off:
                    continue
                word = mixed(word_y + np.uint64(iz) * _Z)
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
                    r = math.sqrt((px - mx) ** 2 + (py - my) ** 2 + (pz - mz) ** 2)
                    # beams that it is in have their feet between these
                    nearest, farthest = max(r - begin_off - beyond, near_m), min(r + begin_off + beyond, far_m)
                    if nearest > farthest:
                        continue
                    if uniform < least_between(nearest, farthest, least_from, block_m, needed):
                        continue
                    stack[0], deep = part, 1
                    d = -1.0
                    while deep:
                        deep -= 1
                        first, stop = nodes[stack[deep], 2], nodes[stack[deep], 3]
                        for node in range(first, stop):
                            bx, by, bz = px - cone[node, 0], py - cone[node, 1], pz - cone[node, 2]
                            along = bx * cone[node, 3] + by * cone[node, 4] + bz * cone[node, 5]
                            slack = beyond + cone[node, 7] + farthest * cone[node, 8]
                            off = bx * bx + by * by + bz * bz - along * along
                            if off <= slack * slack and along > -slack and until[node] > nearest:
                                stack[deep] = node
                                deep += 1
                        if first < stop:
                            continue
                        for place in range(nodes[stack[deep], 0], nodes[stack[deep], 1]):
                            tx = px - (beams[place, 0] - beams[place, 3] * vx)
                            ty = py - (beams[place, 1] - beams[place, 3] * vy)
                            tz = pz - (beams[place, 2] - beams[place, 3] * vz)
                            ax, ay, az = beams[place, 4], beams[place, 5], beams[place, 6]
                            r = tx * ax + ty * ay + tz * az
                            if not (near_m <= r < far_m and r < beams[place, 7]):
                                continue
                            tx, ty, tz = tx - r * ax, ty - r * ay, tz - r * az
                            square = tx * tx + ty * ty + tz * tz
                            if square > beyond * beyond:
                                continue
                            wide = tan_x * r + exit_m
                            i = order[place]
                            if len(across) == 0:
                                square = square / max(wide * wide, 1e-300)
                            else:
                                sx, sy, sz = across[i, 0], across[i, 1], across[i, 2]
                                u = (tx * sx + ty * sy + tz * sz) / max(wide, 1e-150)
                                v = tx * (ay * sz - az * sy) + ty * (az * sx - ax * sz) + tz * (ax * sy - ay * sx)
                                v /= max(tan_y * r + exit_m, 1e-150)
                                square = u * u + v * v
                            if not gaussian and square >= 1.0:
                                continue
                            if d < 0.0:
                                d = largest_mm
                                if slope_mm > 0.0:
                                    d = min(low_mm - math.log1p(-uniform * lost) / slope_mm, largest_mm)
                            s = d * math.exp(-min(square, 500.0)) if gaussian else d
                            if s < least_mm[min(max(int((r - least_from) / least_step), 0), len(least_mm) - 1)]:
                                continue
                            if total < room:
                                out_beam[total], out_range[total], out_size[total] = i, r, s
                            total += 1
    return total


@compiled(
    INTS, ROWS, INTS, FLOATS, FLOATS, FLOATS, FLOAT, FLOAT, FLOATS, ROWS, ROWS, ROWS, FLOATS, FLOATS, FLOAT, FLOAT,
    FLOAT, FLOAT, FLAG, FLOATS, FLOAT, FLOAT, OUT_INTS, OUT_FLOATS, OUT_FLOATS,
)  # fmt: skip
def falling(
    keys, classes, reaches, reach_range, reach_wide, poisson, slope_mm, largest_mm, limits, centre, axis, across, t_s,
    until_m, covered_m, tan_x, tan_y, exit_m, gaussian, least_mm, least_from, least_step, out_beam, out_range, out_size,
):  # fmt: skip
    """Number of particles found, see `world_particles.in_beams`; written are as many as there is room for; -1: they are
    in too many cells.

    `classes` : (c, 7) least size, share, number per m^3, width of a cell, velocity; `reaches` : (c + 1,) where the
    tables of each begin in `reach_range`, `reach_wide`; `limits` : octave, most cells, flatness, cells that
    a part spans, slack.
    """
    total, seen = 0, 0.0
    octave, most_cells, flat, span, slack = limits
    farthest = 0.0
    for c in range(len(keys)):
        if reaches[c + 1] - reaches[c] > 1:
            farthest = max(farthest, reach_range[reaches[c + 1] - 1])
    order, nodes, low, high, until = tree(centre, t_s, axis, until_m, 0.5 * farthest)
    beams = packed(order, centre, t_s, axis, until_m)
    cone, stack, parts = np.empty((len(nodes), 9)), np.empty(DEEPEST, np.int64), np.empty(DEEPEST, np.int64)
    directions(low, high, cone)
    blocks = (len(least_mm) + BLOCK - 1) // BLOCK
    least, needed = np.empty(blocks), np.empty(blocks)
    for block in range(blocks):
        least[block] = math.inf
        for k in range(block * BLOCK, min((block + 1) * BLOCK, len(least_mm))):
            least[block] = min(least[block], least_mm[k])
    shape = (tan_x, tan_y, exit_m, gaussian)
    for c in range(len(keys)):
        low_mm, lost, number, width = classes[c, 0], classes[c, 1], classes[c, 2], classes[c, 3]
        table = slice(reaches[c], reaches[c + 1])
        if table.stop - table.start < 2 or number <= 0.0:
            continue
        range_m, wide_m = reach_range[table], reach_wide[table]
        velocity = classes[c, 4], classes[c, 5], classes[c, 6]
        of_class(velocity, low, high, cone)
        for block in range(blocks):
            needed[block] = 0.0
            if slope_mm > 0.0 and least[block] > low_mm:
                needed[block] = -math.expm1(-slope_mm * (least[block] - low_mm)) / lost * (1.0 - 1e-12)
            elif least[block] > largest_mm:
                needed[block] = 1.0
        cell_m, step_m = (width, width, width / flat), span * width
        begin, end = range_m[0], range_m[-1]
        while octave * end > max(begin, covered_m):
            end *= octave
        while end > begin:
            near = max(octave * end, begin)
            if near < begin + 2.0 * step_m:
                near = begin
            steps = max(1, math.ceil((end - near) / step_m))
            parts[0], left = 0, 1
            while left:
                left -= 1
                part = parts[left]
                if until[part] <= near:
                    continue
                first, stop = nodes[part, 2], nodes[part, 3]
                if first < stop and 2.0 * (cone[part, 7] + end * cone[part, 8]) > step_m:
                    for child in range(first, stop):
                        parts[left] = child
                        left += 1
                    continue
                for step in range(steps):
                    near_m = near + step * (end - near) / steps
                    far_m = near + (step + 1) * (end - near) / steps if step + 1 < steps else end
                    if near_m >= until[part]:
                        break
                    reach_m = 0.0
                    for k in range(5):
                        reach_m = max(reach_m, between(near_m + 0.25 * k * (far_m - near_m), range_m, wide_m))
                    reach_m += slack
                    low_x, high_x = cells_about(0, part, low, high, velocity[0], near_m, far_m, reach_m, cell_m[0])
                    low_y, high_y = cells_about(1, part, low, high, velocity[1], near_m, far_m, reach_m, cell_m[1])
                    low_z, high_z = cells_about(2, part, low, high, velocity[2], near_m, far_m, reach_m, cell_m[2])
                    seen += float(high_x - low_x) * float(high_y - low_y) * float(high_z - low_z)
                    if seen > most_cells:
                        return -1
                    total = in_box(
                        (low_x, low_y, low_z, high_x, high_y, high_z), part, nodes, order, cone, until, near_m,
                        far_m, reach_m, (low_mm, slope_mm, lost, largest_mm), velocity,
                        np.uint64(keys[c]), poisson, cell_m, beams, across, shape, least_mm,
                        least_from, least_step, needed, stack, total, out_beam, out_range, out_size,
                    )  # fmt: skip
            end = near
    return total
