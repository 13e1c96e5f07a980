"""Beams from which short clusters come back, or nothing: from sub-echoes to what is reported, in one pass.

Belongs here: what `signals_of`, `_measure` and `report` of `physics.detection` and `Receiver` do with arrays, of such
beams. All others are left: long clusters, a medium that is near the threshold under one. Beams are done some at a
time, so that all of their numbers stay in the processor's cache: what takes long is computed for several at once.
"""

# mypy: disable-error-code="no-untyped-def"
from __future__ import annotations

import math

import numpy as np

from emulator.compiled.arithmetic import arc_sine_of_root, short_cos_sin
from emulator.compiled.clusters import cross
from emulator.compiled.echoes import tall
from emulator.compiled.jit import FLAGS, FLOATS, INT, INTS, LONG_ROWS, OUT_FLAGS, compiled
from emulator.compiled.media import (
    MEDIUM,
    cross_in_air,
    left_open,
    lifted_in_air,
    out_of_valley,
    returned,
    stands_out,
    stopped,
)  # fmt: skip
from emulator.compiled.normal import normals, unit

DAZZLED, SATURATED = 1, 2
"As in `protocols.scan`."
MOST, MOST_ECHOES = 1024, 16
"Sub-echoes and echoes of a beam."
HELD, ECHOES_HELD = 4096, 256
"Sub-echoes and echoes that are done together."
FIRST, STRONGEST, LAST = 0, 1, 2
"Which of several echoes are reported."
SURE = 1e-6
"So much lower than its limit a normal number is taken for one that an echo of the medium is seen by."


@compiled()
def _own_chance(height, dark, least, full_scale, shot_factor, noisy):
    """Chance from which on a medium's own echo may be seen; 2: never."""
    missing = least - min(height, full_scale)
    if not noisy:
        return 0.0 if missing <= 0.0 else 2.0
    # of the normal number at which it is just seen
    z = missing / np.sqrt(dark * dark + shot_factor * height) - SURE
    return 0.5 * math.erfc(-z / math.sqrt(2.0))


@compiled()
def on_line(x, places, values, otherwise):
    """Linear between places, `otherwise` behind the last."""
    if x > places[-1]:
        return otherwise
    at = min(max(np.searchsorted(places, x, side="right") - 1, 0), len(places) - 2)
    step = places[at + 1] - places[at]
    share = min(max((x - places[at]) / step, 0.0), 1.0) if step > 0.0 else 0.0
    return values[at] + share * (values[at + 1] - values[at])


@compiled()
def _last_begun(level, at, size, begun):
    """The last sub-echo of a cluster whose pulse begins before a level is reached."""
    end = at + size
    while at + 1 < end and begun[at + 1] < level:  # the sum rises while they begin
        at += 1
    return at


# ------------------------------------------------------------------------------- several echoes at once
@compiled()
def _turned(angle, count, real, imaginary):
    for i in range(count):
        real[i], imaginary[i] = short_cos_sin(angle[i])


@compiled()
def _levels(height, z, dark, least, count, full_scale, shot_factor, level):
    """What is crossed; where it is, the signal is as high as the threshold, however high it rises."""
    for i in range(count):
        shot = shot_factor * min(height[i], least[i])
        here = least[i] - z[i] * np.sqrt(dark[i] * dark[i] + shot)
        level[i] = min(max(here, 0.02 * least[i]), max(min(height[i], full_scale), 1e-12))


@compiled()
def _polar(swing, turn, count):
    """Lengths and angles, 0 to half a turn, of numbers given by their real and imaginary parts, in place."""
    for i in range(count):
        x, y = swing[i], turn[i]
        length = np.sqrt(x * x + y * y)
        sum_ = length + abs(x)
        share = y / (2.0 * max(length, 1e-300)) * (y / max(sum_, 1e-300))
        angle = 2.0 * arc_sine_of_root(share, sum_ / (2.0 * max(length, 1e-300)))
        swing[i], turn[i] = length, angle if x >= 0.0 else np.pi - angle


@compiled()
def _crossings(level, total, swing, turn, start_m, count, half_m, wave_number, crossing):
    """By the angle from the trough, which keeps its digits for a level far below the maximum."""
    for i in range(count):
        share = (2.0 * level[i] - total[i] + swing[i]) / (2.0 * swing[i])
        rest = (swing[i] + total[i] - 2.0 * level[i]) / (2.0 * swing[i])
        rise = arc_sine_of_root(min(max(share, 0.0), 1.0), min(max(rest, 0.0), 1.0))
        crossing[i] = start_m[i] - half_m + (turn[i] + 2.0 * rise) / wave_number


@compiled()
def _leads(height, least, count, full_scale, fwhm_m, lead):
    """See `Pulse.lead`, of a sin^2 pulse."""
    for i in range(count):
        shown = max(min(height[i], full_scale), least[i])
        lead[i] = fwhm_m - 2.0 * fwhm_m / np.pi * arc_sine_of_root(least[i] / shown, (shown - least[i]) / shown)


@compiled()
def columns_of(found_m, found, clipped, seen, keep, columns, blind_m, order, column):
    """The column of each echo of a beam, negative of those that are not reported: as `detection._chosen`."""
    for i in range(seen):  # by range
        at = i
        while at > 0 and found_m[order[at - 1]] > found_m[i]:
            order[at] = order[at - 1]
            at -= 1
        order[at] = i
    kept, until_m = 0, -np.inf
    for place in range(seen):  # those that come while the receiver recovers are lost
        i = order[place]
        column[i] = -1
        if not until_m > found_m[i]:
            order[kept] = i
            kept += 1
        if blind_m > 0.0 and clipped[i]:
            until_m = max(until_m, found_m[i] + blind_m)
    made = 0
    for place in range(kept):
        i, at = order[place], place
        if keep == LAST:
            at -= max(kept - columns, 0)
        elif keep == STRONGEST:
            higher = 0
            for p in range(kept):
                j = order[p]
                higher += found[j] > found[i] or (found[j] == found[i] and p < place)
            at = made if higher < columns else -1
            made += higher < columns
        column[i] = at if at < columns else -1


@compiled(
    INTS, FLOATS, FLOATS, INTS, OUT_FLAGS, FLAGS, FLOATS, LONG_ROWS, LONG_ROWS, INT, INTS, FLOATS, FLOATS,
    FLOATS, FLOATS, FLOATS, INT, FLOATS, FLOATS, *MEDIUM,
)  # fmt: skip
def received(
    beam, range_m, amplitude, source, left, dazzled, rms, chances, spreads, columns, noise_beam, noise_m, noise_height,
    free, rise, rise_m, keep, law, blocked, edged, first, bin_m, turning, ends, knots, cubics, cells, cell,
):  # fmt: skip
    """What n beams report: range and intensity (n, columns), actor, and flags (n,). Beams that need more are `left`.

    `left` : (n,) written to; `dazzled` : (n,), (0,): none; `rms` : (n,), or (1,) for all; `chances`, `spreads` : (n, .)
    random words for the noise at echoes and of ranges, (0, 0): no noise; `noise_...` : false alarms by beams; `free` :
    returns of a medium by bins; `rise`, `rise_m` : up to its maximum; `keep` : which of several echoes are reported;
    `law` : numbers of the sensor and the medium, see `sensing.receiving`; `edged` and behind : `SoftProfile.flat`.
    """
    longest_m, half_m, wave_number, threshold, full_scale, shot_factor = law[0], law[1], law[2], law[3], law[4], law[5]
    floor_m2, fwhm_m, walk_table, offset_m, near_gate_m, far_gate_m = law[6], law[7], law[8], law[9], law[10], law[11]
    systematic_m, range_noise_m, doubt_m, sigmas, least_share = law[12], law[13], law[14], law[15], law[16]
    faint, slight, until_m, alone_m, peak_m, own_peak = law[17], law[18], law[19], law[20], law[21], law[22]
    own_m, own_height, exact_m, near_top, passes = law[23], law[24], law[25], law[26], int(law[27])
    blind_m, valley_passes = law[28], int(law[32])
    n, count, alarms = len(left), len(beam), len(noise_beam)
    ranges, intensity = np.full((n, columns), np.nan), np.full((n, columns), np.nan)
    actor, flags = np.full((n, columns), -1, np.int32), np.zeros(n, np.uint8)
    noisy, spread, blinding = len(chances) > 0, len(spreads) > 0, len(dazzled) > 0
    numbers = chances.shape[1]
    # of sub-echoes
    angle, begun, total = np.empty(HELD), np.empty(HELD + 1), np.empty(HELD + 1)
    real, imaginary = np.empty(HELD + 1), np.empty(HELD + 1)  # the last: of a pulse that is alone
    begun[HELD] = imaginary[HELD] = 0.0
    # of a medium: sums of each echo, of one more than its sub-echoes; they begin with 0
    stops = np.zeros((4, HELD + 2 * ECHOES_HELD))
    # of echoes; the second half of some are the same again with a medium under them
    begin_of, at_of, size_of = np.empty((3, ECHOES_HELD), np.int64)
    centre, height, under, dark_of, least_of = np.empty((5, ECHOES_HELD))
    chance_of, z, work, works = np.empty((4, ECHOES_HELD))
    lead = np.full(ECHOES_HELD, fwhm_m - offset_m)
    start_of, level, sum_of, swing, turn, crossing = np.empty((6, 2 * ECHOES_HELD))
    doubted, head_of = np.empty((2, ECHOES_HELD), np.int64)
    shift_of, over_of, open_of = np.empty((3, ECHOES_HELD))
    in_air, summed = np.empty((2, ECHOES_HELD), np.bool_)
    # of beams
    held, first_of, made_of, alarm_of, alarms_of = np.empty((5, ECHOES_HELD), np.int64)
    own_of = np.empty(ECHOES_HELD, np.bool_)
    rank, order, column_at = np.empty((3, MOST_ECHOES), np.int64)
    found_m, found, origin = np.empty(MOST_ECHOES), np.empty(MOST_ECHOES), np.empty(MOST_ECHOES, np.int64)
    clipped = np.empty(MOST_ECHOES, np.bool_)
    row_of, column_of = np.empty((2, ECHOES_HELD), np.int64)
    own_tall = tall(own_m, own_height, floor_m2)
    dark, least, hears, limit = -1.0, 0.0, False, 2.0
    b = k = alarm = 0
    while b < n:
        beams = echoes = subs = 0
        # clusters of some beams
        while b < n and echoes <= ECHOES_HELD - MOST_ECHOES and beams < ECHOES_HELD and subs <= HELD - MOST:
            begin, first_alarm = k, alarm
            while k < count and beam[k] == b:
                k += 1
            while alarm < alarms and noise_beam[alarm] == b:
                alarm += 1
            b += 1
            if left[b - 1]:
                continue
            if blinding and dazzled[b - 1]:
                flags[b - 1] = DAZZLED
                continue
            here = rms[b - 1] if len(rms) > 1 else rms[0]
            if here != dark:
                dark, least = here, threshold * here
                hears = own_peak >= max(least - sigmas * dark, 0.02 * least)
                limit = _own_chance(own_height, dark, least, full_scale, shot_factor, noisy) if own_tall else 2.0
            if begin == k and first_alarm == alarm:  # of most beams without a surface nothing is seen
                if not hears or (unit(chances[b - 1, 0]) if noisy else 0.5) < limit:
                    continue
            made, j, at = 0, begin, subs
            good = k - begin <= MOST
            while j < k and good:
                end = j + 1
                while end < k and range_m[end] - range_m[end - 1] <= 2.0 * half_m:
                    end += 1
                one = echoes + made
                begin_of[one], at_of[one], size_of[one] = j, at, end - j
                if end - j > 1:
                    good = range_m[end - 1] - range_m[j] < longest_m
                    for i in range(end - j):
                        angle[at + i] = wave_number * (range_m[j + i] - range_m[j]) if good else 0.0
                    at += end - j
                good = good and made + 2 < MOST_ECHOES
                made, j = made + 1, end
            if not good:
                left[b - 1] = True
                continue
            own_of[beams] = hears
            if hears:  # it takes one of these numbers, and is looked at where that may do
                most = 0.0
                for i in range(made + 1):
                    most = max(most, unit(chances[b - 1, i % numbers]) if noisy else 0.5)
                if most >= limit:
                    size_of[echoes + made], own_of[beams] = 0, False
                    made += 1
            held[beams], first_of[beams], made_of[beams] = b - 1, echoes, made
            alarm_of[beams], alarms_of[beams] = first_alarm, alarm
            for i in range(echoes, echoes + made):
                dark_of[i], least_of[i] = dark, least
            beams, echoes, subs = beams + 1, echoes + made, at
        _turned(angle, subs, real, imaginary)
        # place and height of their maxima, what a medium has under them, and the random numbers
        for one in range(beams):
            row, begin, end = held[one], first_of[one], first_of[one] + made_of[one]
            good = True
            for i in range(begin, end):
                size, j, at = size_of[i], begin_of[i], at_of[i]
                under[i], turn[i], start_of[i], in_air[i], shift_of[i], over_of[i] = 0.0, 0.0, own_m, False, 0.0, 0.0
                summed[i] = False
                centre[i], height[i], sum_of[i], swing[i] = own_m, own_height, own_height, own_height
                if size == 0:
                    continue
                start_of[i] = centre[i] = range_m[j]
                head_of[i] = begin_of[begin]
                a = amplitude[j]
                if size == 1:
                    height[i] = sum_of[i] = swing[i] = a
                else:
                    a = x = y = 0.0
                    for p in range(size):
                        strength, cosine, sine = amplitude[j + p], real[at + p], imaginary[at + p]
                        a += strength
                        x += strength * cosine
                        y += strength * sine
                        total[at + p], real[at + p], imaginary[at + p] = a, x, y
                        # a pulse begins half a turn of the cosine before its centre
                        begun[at + p] = 0.5 * (a - cosine * x - sine * y)
                    height[i] = 0.5 * (a + np.sqrt(x * x + y * y))
                    if floor_m2 > 0.0 or start_of[i] - half_m < until_m:
                        centre[i] += np.arctan2(y, x) / wave_number
                front_m = start_of[i] - half_m
                if front_m < until_m or front_m < alone_m:
                    below = returned(max(front_m, peak_m), free, first, bin_m)
                    good = good and front_m >= alone_m and until_m < np.inf and height[i] > 0.0
                    if not below < faint * threshold:
                        length_m = range_m[j + size - 1] - range_m[j]
                        good = good and stands_out(a, length_m, below, dark_of[i], front_m, free, first, bin_m, law)
                    over_of[i] = below
                    under[i] = below
                    if good and below > slight * height[i]:
                        under[i], in_air[i] = 0.0, True
                        summed[i], sums_at = True, at + 2 * i
                        stops[:, sums_at] = 0.0
                        stopped(range_m, blocked, j, size, stops, sums_at, knots, cubics, cells, cell)
                        open_of[i] = left_open(blocked, head_of[i], j)
                        centre[i], height[i], shift_of[i] = lifted_in_air(
                            centre[i], height[i], 2.0 * height[i] - a, size, sums_at, open_of[i], stops, edged, first,
                            bin_m, wave_number, ends,
                        )  # fmt: skip
                good = good and height[i] > 0.0
            if not good:
                left[row] = True
                made_of[one] = 0
                under[begin:end], over_of[begin:end], in_air[begin:end] = 0.0, 0.0, False
            # by height; those under the floor last
            for i in range(begin, end):
                mine = -height[i] if tall(centre[i], height[i], floor_m2) else 0.0
                rank[i - begin] = own_of[one] and mine > (-own_height if own_tall else 0.0)
                for p in range(begin, i):
                    other = -height[p] if tall(centre[p], height[p], floor_m2) else 0.0
                    if mine < other:
                        rank[p - begin] += 1
                    else:
                        rank[i - begin] += 1
            for i in range(begin, end):
                chance_of[i] = unit(chances[row, rank[i - begin] % numbers]) if noisy else 0.5
        normals(chance_of, echoes, z, work, works)
        _levels(height, z, dark_of, least_of, echoes, full_scale, shot_factor, level)
        doubts = 0
        for i in range(echoes):
            if size_of[i] > 1:
                at = _last_begun(level[i], at_of[i], size_of[i], begun)
                sum_of[i] = total[at]
                if at == at_of[i]:
                    swing[i] = total[at]
                else:
                    swing[i], turn[i] = real[at], imaginary[at]
            if under[i] > 0.0:
                other = echoes + doubts
                doubted[doubts], level[other] = i, max(level[i] - under[i], least_share * level[i])
                start_of[other], sum_of[other], swing[other], turn[other] = start_of[i], height[i], height[i], 0.0
                if size_of[i] > 1:
                    at = _last_begun(level[other], at_of[i], size_of[i], begun)
                    sum_of[other] = swing[other] = total[at]
                    if at > at_of[i]:
                        swing[other], turn[other] = real[at], imaginary[at]
                doubts += 1
        _polar(swing, turn, echoes + doubts)
        _crossings(level, sum_of, swing, turn, start_of, echoes + doubts, half_m, wave_number, crossing)
        for i in range(doubts):
            if crossing[doubted[i]] - crossing[echoes + i] > doubt_m:
                in_air[doubted[i]] = True
        for i in range(echoes):
            valley = level[i] < over_of[i]
            if not (in_air[i] or valley):
                continue
            j, at, size = begin_of[i], at_of[i], size_of[i]
            sums_at = at + 2 * i
            if not summed[i]:
                stops[:, sums_at] = 0.0
                stopped(range_m, blocked, j, size, stops, sums_at, knots, cubics, cells, cell)
                open_of[i] = left_open(blocked, head_of[i], j)
            open_ = open_of[i]
            if size == 1:
                at = HELD
                total[at] = real[at] = amplitude[j]
            place_m, last = cross(level[i], at, size, start_of[i], begun, total, real, imaginary, half_m, wave_number)
            if in_air[i]:
                crossing[i] = cross_in_air(
                    level[i], place_m, last, at - 1 - sums_at, sums_at, open_, stops, edged, first, bin_m, wave_number,
                    ends, at, size, start_of[i], begun, total, real, imaginary, half_m, least_share, exact_m, passes,
                )  # fmt: skip
            if valley:
                crossing[i] = out_of_valley(
                    level[i], crossing[i], centre[i], height[i], sums_at, open_, stops, edged, first, bin_m,
                    wave_number, ends, at, size, start_of[i], begun, total, real, imaginary, half_m, valley_passes,
                )  # fmt: skip
            if shift_of[i] > 0.0:  # near a maximum, see `Cosines.crossing`
                before_m = np.sqrt(4.0 * max(height[i] - level[i], 0.0) / height[i]) / wave_number
                if before_m < near_top * shift_of[i]:
                    crossing[i] = centre[i] - before_m
        if walk_table > 0.0:
            _leads(height, least_of, echoes, full_scale, fwhm_m, lead)
        # which of them are seen, and reported
        reports = 0
        for one in range(beams):
            row, begin, end, good, seen = held[one], first_of[one], first_of[one] + made_of[one], True, 0
            if left[row]:
                continue
            for i in range(begin, end):
                dark, least = dark_of[i], least_of[i]
                noise = z[i] * np.sqrt(dark * dark + shot_factor * height[i])
                if not min(height[i], full_scale) >= least - noise or not tall(centre[i], height[i], floor_m2):
                    continue
                read_m = crossing[i]
                origin[seen] = -1
                if size_of[i] == 0:
                    read_m = on_line(level[i], rise, rise_m, own_m)
                else:
                    best = begin_of[i]
                    for j in range(best + 1, best + size_of[i]):  # the first of equals
                        if amplitude[j] > amplitude[best]:
                            best = j
                    origin[seen] = source[best]
                found_m[seen] = max(read_m + lead[i], 0.0)  # a touching target is at 0, whatever the noise
                found[seen] = min(max(height[i] + noise, least), max(full_scale, least))
                clipped[seen] = height[i] >= full_scale
                seen += near_gate_m <= found_m[seen] <= far_gate_m
            least = threshold * (rms[row] if len(rms) > 1 else rms[0])
            for j in range(alarm_of[one], alarms_of[one]):
                good = good and seen < MOST_ECHOES - 1
                if good:
                    found_m[seen], found[seen] = noise_m[j], max(noise_height[j], least)
                    origin[seen], clipped[seen] = -1, False
                    seen += near_gate_m <= found_m[seen] <= far_gate_m
            if not good or reports + seen > ECHOES_HELD:
                left[row] = True
                continue
            column_at[0] = 0 if columns else -1
            if seen > 1:
                columns_of(found_m, found, clipped, seen, keep, columns, blind_m, order, column_at)
            for i in range(seen):
                column = column_at[i]
                if column < 0:
                    continue
                if clipped[i]:
                    flags[row] = SATURATED
                ranges[row, column], intensity[row, column] = found_m[i] + systematic_m, max(found[i] / least, 1.0)
                actor[row, column] = origin[i]
                row_of[reports], column_of[reports] = row, column
                reports += 1
        dark = -1.0
        if spread:
            for i in range(reports):
                chance_of[i] = unit(spreads[row_of[i], column_of[i]])
            normals(chance_of, reports, z, work, works)
            for i in range(reports):
                row, column = row_of[i], column_of[i]
                ranges[row, column] = max(ranges[row, column] + range_noise_m * z[i], 0.0)
    return ranges, intensity, actor, flags
