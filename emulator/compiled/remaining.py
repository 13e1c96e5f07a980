"""Beams that the pass over short clusters leaves: from sub-echoes to what is reported, in one call.

Belongs here: what `signals_of`, `_measure` and `report` of `physics.detection` and `Receiver` do with arrays around the
steps that are compiled for themselves, of beams with long clusters, drops, and a medium near the threshold under them.
Not: these steps (clusters, waves, maxima, hazy, echoes), nor beams with nothing but short clusters (receiving).
"""

# mypy: disable-error-code="no-untyped-def"
from __future__ import annotations

import numpy as np

from emulator.compiled import clusters, echoes, hazy, maxima, waves
from emulator.compiled.clusters import cross
from emulator.compiled.echoes import grouped
from emulator.compiled.jit import (
    FLAG,
    FLAGS,
    FLOATS,
    INT,
    INTS,
    LONG_ROWS,
    OUT_BYTES,
    OUT_FLAGS,
    OUT_ROWS,
    OUT_WORD_ROWS,
    compiled,
)  # fmt: skip
from emulator.compiled.maxima import medium_at
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
from emulator.compiled.receiving import DAZZLED, SATURATED, columns_of, on_line

split, sums, joined = clusters.split.made, clusters.sums.made, clusters.joined.made
sampled, highest, edges = waves.sampled.made, maxima.maxima.made, maxima.edges.made
lifted, bent = hazy.lifted.made, hazy.bent.made
ranks, levels, readings = echoes.ranks.made, echoes.levels.made, echoes.readings.made
NO_SOURCE = -1


@compiled()
def _of_beams(wanted, beam, range_m, amplitude, source, blocked):
    """The sub-echoes of some beams."""
    count = 0
    for k in range(len(beam)):
        count += wanted[beam[k]]
    of, tag, sizes = np.empty(count, np.int64), np.empty(count, np.int64), np.empty((3, count))
    at = 0
    for k in range(len(beam)):
        if wanted[beam[k]]:
            of[at], tag[at] = beam[k], source[k]
            sizes[0, at], sizes[1, at], sizes[2, at] = range_m[k], amplitude[k], blocked[k]
            at += 1
    return of, tag, sizes


@compiled()
def _closed(whole, first_m, short, range_m, amplitude, dark, free, first, bin_m, law):
    """`cosines._near`: takes those of the short clusters out that are sampled. Which begin where a medium shows, and
    its bound under these over the threshold."""
    half_m, threshold, faint, until_m, alone_m, peak_m = law[1], law[3], law[17], law[19], law[20], law[21]
    count = len(short)
    near, share = np.zeros(count, np.bool_), np.zeros(count)
    c = 0
    while c < count:
        end, last, hazed = c, -1, False
        while end < count and whole[0, end] == whole[0, c]:
            begin_m = first_m[end] - half_m
            if begin_m < max(until_m, alone_m):
                together = 0.0
                for k in range(whole[1, end], whole[1, end] + whole[2, end]):
                    together += amplitude[k]
                air = returned(max(begin_m, peak_m), free, first, bin_m)
                near[end], share[end] = True, air / threshold
                kept = short[end] and begin_m >= alone_m
                if kept and not share[end] < faint:
                    length_m = range_m[whole[1, end] + whole[2, end] - 1] - first_m[end]
                    kept = stands_out(together, length_m, air, dark[whole[0, end]], begin_m, free, first, bin_m, law)
                short[end] = kept
                hazed = hazed or not kept
            if not short[end]:
                last = end
            end += 1
        if hazed:
            for one in range(c, last + 1):
                short[one] = False
        c = end
    return near, share


@compiled()
def _marked(left, rest, of, tag, sizes, shows, all_marked, shown, high_m, half_m, marks_m, mark):
    """Sub-echoes that are sampled, with marks that have a medium's own maximum sampled; beams that have it closed."""
    count, n = len(rest), len(left)
    room = count + 2 * n
    beam, source, range_m = np.empty(room, np.int64), np.empty(room, np.int64), np.empty((3, room))
    own = np.zeros(n, np.bool_)
    at = made = 0
    for b in range(n):
        if not left[b]:
            continue
        marked = all_marked and shows[b]
        if at < count and of[rest[at]] == b:
            marked = shows[b] if shown else sizes[0, rest[at]] - half_m < high_m
        own[b] = shows[b] and not marked
        placed = 0 if marked else 2
        while True:
            ends = at == count or of[rest[at]] != b
            if ends and placed == 2:
                break
            if placed < 2 and (ends or sizes[0, rest[at]] > marks_m[placed]):
                beam[made], source[made] = b, NO_SOURCE
                range_m[0, made], range_m[1, made], range_m[2, made] = marks_m[placed], mark, 0.0
                placed += 1
            else:
                k = rest[at]
                beam[made], source[made] = b, tag[k]
                for part in range(3):
                    range_m[part, made] = sizes[part, k]
                at += 1
            made += 1
    return beam[:made].copy(), source[:made].copy(), range_m[:, :made].copy(), own


@compiled()
def _clear(beam, blocked, range_m, first, count, hazy_, free, medium_first, bin_m, half_m, peak_m):
    """Share of the beam that reaches each cluster, and which are sampled."""
    clusters_ = len(first)
    clear, chosen = np.empty(clusters_), np.empty(clusters_, np.bool_)
    passed = 0.0
    for c in range(clusters_):
        k = first[c]
        if c == 0 or beam[k] != beam[first[c - 1]]:
            passed = 0.0
        clear[c] = min(max(1.0 - passed, 0.0), 1.0)
        chosen[c] = count[c] > 1
        if hazy_ and not chosen[c]:
            chosen[c] = clear[c] * returned(max(range_m[k] - half_m, peak_m), free, medium_first, bin_m) > 1e-3
        for j in range(k, k + count[c]):
            passed += blocked[j]
    return clear, chosen


@compiled()
def _clipped(value, start, count, first_bin, peak, window, step_m, limit, centre, height):
    """`candidates._clip`."""
    for i in range(len(peak)):
        p, w = peak[i], window[i]
        if value[p] < limit:
            continue
        last = start[w] + count[w] - 1
        after, before = p + 1, p - 1
        while after < last and value[after] >= limit:
            after += 1
        after = min(after, last)
        up = before + (limit - value[before]) / max(value[before + 1] - value[before], 1e-300)
        down = after - max(limit - value[after], 0.0) / max(value[after - 1] - value[after], 1e-300)
        centre[i] = step_m * (0.5 * (up + down) - start[w] + first_bin[w])
        height[i] = max(height[i], limit)


@compiled()
def _source_of(
    centre, height, w, step_m, half_m, wave_number, first_bin, start, count, part, sub_first, sub_count, sub_range,
    sub_amplitude, sub_source,
):  # fmt: skip
    """`timing.sources` of one maximum."""
    head, tail = sub_first[w], sub_first[w] + sub_count[w]
    medium, source, same = medium_at(centre, w, step_m, first_bin, start, count, part), sub_source[head], True
    for k in range(head + 1, tail):
        same = same and sub_source[k] == source
    if same and not medium > height - medium:
        return source
    best = -1.0
    for k in range(head, tail):
        off, pull = centre - sub_range[k], 0.0
        if abs(off) < half_m:
            pull = sub_amplitude[k] * 0.5 * (1.0 + np.cos(wave_number * off))
        if pull > best:  # the first of equals
            best, source = pull, sub_source[k]
    return NO_SOURCE if medium > max(height - medium, best) else source


@compiled()
def _cosine_crossings(
    level, centre, height, reported, first_m, running, near, share, shift, of, sizes, crossing, law, stops,
    edged, first, bin_m, turning, ends, knots, cubics, cells, cell,
):  # fmt: skip
    """`Cosines.crossing`, of those with a medium under them."""
    half_m, wave_number, threshold, doubt_m, least_share, exact_m, near_top, passes = (
        law[1], law[2], law[3], law[14], law[16], law[25], law[26], int(law[27]),
    )  # fmt: skip
    begun, total, real, imaginary = running[0], running[1], running[2], running[3]
    head = 0
    for i in range(reported.shape[1]):
        start, size = reported[2, i], reported[3, i]
        crossing[i], last = cross(level[i], start, size, first_m[i], begun, total, real, imaginary, half_m, wave_number)
        if i == 0 or reported[0, i] != reported[0, i - 1]:
            head = np.searchsorted(of, reported[0, i])
        if near[i]:
            most = share[i] * threshold
            aired = shift[i] >= 0.0  # else it is so faint that it is looked at only where it may do something
            if not aired:
                rest = max(level[i] - most, least_share * level[i])
                place_m, _ = cross(rest, start, size, first_m[i], begun, total, real, imaginary, half_m, wave_number)
                aired = crossing[i] - place_m > doubt_m
            valley = level[i] < most
            if aired or valley:
                stopped(sizes[0], sizes[2], start, size, stops, 0, knots, cubics, cells, cell)
                open_ = left_open(sizes[2], head, start)
            if aired:
                crossing[i] = cross_in_air(
                    level[i], crossing[i], last, start - 1, 0, open_, stops, edged, first, bin_m, wave_number, ends,
                    start, size, first_m[i], begun, total, real, imaginary, half_m, least_share, exact_m, passes,
                )  # fmt: skip
            if valley:
                crossing[i] = out_of_valley(
                    level[i], crossing[i], centre[i], height[i], 0, open_, stops, edged, first, bin_m, wave_number,
                    ends, start, size, first_m[i], begun, total, real, imaginary, half_m, int(law[32]),
                )  # fmt: skip
        if shift[i] > 0.0:  # near a maximum, see `Cosines.crossing`
            before_m = np.sqrt(4.0 * max(height[i] - level[i], 0.0) / height[i]) / wave_number
            if before_m < near_top * shift[i]:
                crossing[i] = centre[i] - before_m


@compiled()
def _reported(
    left, found, sizes, clipped, least, noise_beam, noise_m, noise_height, columns, spreads, keep, law,
    ranges, intensity, actor, flags,
):  # fmt: skip
    """Choose among the echoes found, and write what is reported of these beams."""
    near_gate_m, far_gate_m, systematic_m, range_noise_m, blind_m = law[10], law[11], law[12], law[13], law[28]
    n, alarms = len(left), len(noise_beam)
    order, begin = grouped(found[0], n)
    most = 1
    for b in range(n):
        most = max(most, begin[b + 1] - begin[b])
    most += alarms
    found_m, amplitude, clips = np.empty(most), np.empty(most), np.empty(most, np.bool_)
    source, place, column_at = np.empty((3, most), np.int64)
    count = len(order) + alarms
    row_of, column_of = np.empty(count, np.int64), np.empty(count, np.int64)
    reports = alarm = 0
    for b in range(n):
        while alarm < alarms and noise_beam[alarm] < b:
            alarm += 1
        if not left[b]:
            continue
        seen = 0
        for k in range(begin[b], begin[b + 1]):
            i = order[k]
            found_m[seen], amplitude[seen], clips[seen], source[seen] = (
                sizes[0, i],
                sizes[1, i],
                clipped[i],
                found[1, i],
            )
            seen += near_gate_m <= sizes[0, i] <= far_gate_m
        while alarm < alarms and noise_beam[alarm] == b:
            found_m[seen], amplitude[seen] = noise_m[alarm], max(noise_height[alarm], least[b])
            clips[seen], source[seen] = False, NO_SOURCE
            seen += near_gate_m <= noise_m[alarm] <= far_gate_m
            alarm += 1
        column_at[0] = 0 if columns else -1
        if seen > 1:
            columns_of(found_m, amplitude, clips, seen, keep, columns, blind_m, place, column_at)
        for i in range(seen):
            column = column_at[i]
            if column < 0:
                continue
            if clips[i]:
                flags[b] |= SATURATED
            ranges[b, column], intensity[b, column] = found_m[i] + systematic_m, max(amplitude[i] / least[b], 1.0)
            actor[b, column] = source[i]
            row_of[reports], column_of[reports] = b, column
            reports += 1
    if len(spreads) > 0:
        chance, z, work, works = np.empty((4, max(reports, 1)))
        for i in range(reports):
            chance[i] = unit(spreads[row_of[i], column_of[i]])
        normals(chance, reports, z, work, works)
        for i in range(reports):
            row, column = row_of[i], column_of[i]
            ranges[row, column] = max(ranges[row, column] + range_noise_m * z[i], 0.0)


@compiled(
    INTS, FLOATS, FLOATS, INTS, FLOATS, OUT_FLAGS, FLAGS, FLOATS, LONG_ROWS, LONG_ROWS, INT, INTS, FLOATS, FLOATS,
    FLOATS, FLOATS, FLOATS, INT, FLOATS, FLOATS, FLOATS, FLAG, *MEDIUM, OUT_ROWS, OUT_ROWS, OUT_WORD_ROWS,
    OUT_BYTES,
)  # fmt: skip
def remaining(
    beam, range_m, amplitude, source, blocked, left, dazzled, rms, chances, spreads, columns, noise_beam, noise_m,
    noise_height, free, rise, rise_m, keep, law, more, closer, hazy_, edged, first, bin_m, turning, ends, knots, cubics,
    cells, cell, ranges, intensity, actor, flags,
):  # fmt: skip
    """Write what the beams report that are `left`; see `received` for what is given.

    `more` : further numbers of the sensor and the medium, see `sensing.receiving`; `closer` : steps of parabolas;
    `hazy_` : there is a medium; `ranges` and behind : (n, columns) and (n,), as `received` gives them.
    """
    half_m, wave_number, threshold, full_scale, shot_factor = law[1], law[2], law[3], law[4], law[5]
    floor_m2, fwhm_m, walk_table, offset_m, peak_m, own_peak = law[6], law[7], law[8], law[9], law[21], law[22]
    sigmas, slight, until_m, own_m, own_height = law[15], law[18], law[19], law[23], law[24]
    shown, high_m, end_m, marks_m, step_m, resolution_m = more[0] > 0.0, more[1], more[2], more[3:5], more[5], more[6]
    closes, faint, exact_m, steps, straight_m = more[7] > 0.0, more[8], more[9], int(more[10]), more[11]
    golden, valley_steps, mark = more[12], int(more[13]), more[14]
    n, noisy = len(left), len(chances) > 0
    dark, least, looked, shows = np.empty(n), np.empty(n), np.empty(n), np.zeros(n, np.bool_)
    for b in range(n):
        dark[b] = rms[b] if len(rms) > 1 else rms[0]
        least[b] = threshold * dark[b]
        looked[b] = max(least[b] - sigmas * dark[b], 0.02 * least[b])
        shows[b] = shown and own_peak >= looked[b]
        if left[b] and len(dazzled) > 0 and dazzled[b]:
            left[b], flags[b] = False, DAZZLED
    of, tag, sizes = _of_beams(left, beam, range_m, amplitude, source, blocked)
    # clusters in closed form
    whole, first_m, short = split(of, sizes[0], sizes[1], 2.0 * half_m, law[0] if closes else -1.0)
    near_all, share_all = np.zeros(len(short), np.bool_), np.zeros(len(short))
    if hazy_ and closes:
        near_all, share_all = _closed(whole, first_m, short, sizes[0], sizes[1], dark, free, first, bin_m, law)
    running, cosines, maximum, rest = sums(sizes[0], sizes[1], tag, whole, short, wave_number)
    centre_c, height_c, begin_c = maximum[0], maximum[1], maximum[2]
    closed = cosines.shape[1]
    near, share, shift = np.zeros(closed, np.bool_), np.zeros(closed), np.zeros(closed)
    most = 1
    for c in range(len(short)):
        most = max(most, whole[2, c])
    stops = np.zeros((4, most + 1))
    i = head = 0
    for c in range(len(short)):
        if c == 0 or whole[0, c] != whole[0, c - 1]:
            head = whole[1, c]
        if not short[c]:
            continue
        near[i], share[i] = near_all[c], share_all[c]
        if near[i]:
            if share[i] * threshold <= slight * height_c[i] and until_m < np.inf:
                shift[i] = -1.0
            else:
                start, size = cosines[2, i], cosines[3, i]
                stopped(sizes[0], sizes[2], start, size, stops, 0, knots, cubics, cells, cell)
                open_ = left_open(sizes[2], head, start)
                swing = 2.0 * height_c[i] - running[1, start + size - 1]
                centre_c[i], height_c[i], shift[i] = lifted_in_air(
                    centre_c[i], height_c[i], swing, size, 0, open_, stops, edged, first, bin_m, wave_number, ends
                )
        i += 1
    # what is sampled
    of_s, tag_s, sizes_s, own = _marked(
        left, rest, of, tag, sizes, shows, not closes, shown, high_m if hazy_ else -np.inf, half_m, marks_m, mark
    )
    joint, place, groups = joined(of_s, sizes_s[0], sizes_s[1], sizes_s[2], tag_s, 2.0 * half_m, 0.25 * resolution_m)
    clear, chosen = _clear(
        joint[0], place[2], place[0], groups[0], groups[1], hazy_, free, first, bin_m, half_m, peak_m
    )
    grid, wave, sub, sub_source, series = sampled(
        edged, first, bin_m, turning, ends, knots, cubics, cells, cell, hazy_, end_m, half_m, step_m, wave_number,
        chosen, clear, groups[0], groups[1], joint[0], place[0], place[1], place[2], joint[1],
    )  # fmt: skip
    first_bin, start_w, count_w, sub_first, sub_count = grid[1], grid[2], grid[3], grid[4], grid[5]
    value, part, sub_range, sub_amplitude = wave[0], wave[1], sub[0], sub[1]
    peak, window, centre_w, height_w, begin_w = highest(
        step_m, half_m, wave_number, hazy_, first_bin, start_w, count_w, value, part, sub_first, sub_count, sub_range,
        series[0], series[1], series[2], grid[0], looked, dark, least, full_scale, faint,
    )  # fmt: skip
    sub_blocked, clear_w, air = np.zeros(len(sub_range)), np.zeros(len(first_bin)), np.zeros((4, len(sub_range) + 1))
    if hazy_:
        w = 0
        for c in range(len(chosen)):
            if chosen[c]:
                clear_w[w] = clear[c]
                for k in range(sub_count[w]):
                    sub_blocked[sub_first[w] + k] = place[2, groups[0, c] + k]
                w += 1
        stopped(sub_range, sub_blocked, 0, len(sub_range), air, 0, knots, cubics, cells, cell)
        lifted(
            step_m, half_m, wave_number, hazy_, first_bin, start_w, count_w, value, part, sub_first, sub_count,
            sub_range, series[0], series[1], series[2], edged, first, bin_m, turning, ends, knots, cubics, cells, cell,
            clear_w, air, peak, window, centre_w, height_w, faint, closer,
        )  # fmt: skip
    _clipped(value, start_w, count_w, first_bin, peak, window, step_m, full_scale, centre_w, height_w)
    # all echoes: clusters in closed form, the medium's own, single sub-echoes, maxima of samples
    alone = owns = 0
    for c in range(len(chosen)):
        k = groups[0, c]
        alone += not chosen[c] and place[1, k] >= looked[joint[0, k]]
    for b in range(n):
        owns += own[b]
    own_at, single_at = closed, closed + owns
    mixed_at = single_at + alone
    count = mixed_at + len(peak)
    echo_beam, origin = np.empty(count, np.int64), np.full(count, NO_SOURCE)
    centre, height = np.empty(count), np.empty(count)
    for i in range(closed):
        echo_beam[i], origin[i], centre[i], height[i] = cosines[0, i], cosines[1, i], centre_c[i], height_c[i]
    at = own_at
    for b in range(n):
        if own[b]:
            echo_beam[at], centre[at], height[at] = b, own_m, own_height
            at += 1
    for c in range(len(chosen)):
        k = groups[0, c]
        if not chosen[c] and place[1, k] >= looked[joint[0, k]]:
            echo_beam[at], origin[at], centre[at], height[at] = joint[0, k], joint[1, k], place[0, k], place[1, k]
            at += 1
    for i in range(len(peak)):
        echo_beam[at + i], centre[at + i], height[at + i] = grid[0, window[i]], centre_w[i], height_w[i]
    z = np.zeros(count)
    if noisy:
        rank = ranks(echo_beam, centre, height, n, floor_m2, chances.shape[1])
        chance, work, works = np.empty((3, max(count, 1)))
        for i in range(count):
            chance[i] = unit(chances[echo_beam[i], rank[i]])
        normals(chance, count, z, work, works)
    level, seen, crossing = levels(
        echo_beam, centre, height, z, dark, least, full_scale, shot_factor, floor_m2, fwhm_m, single_at
    )
    _cosine_crossings(
        level, centre, height, cosines, begin_c, running, near, share, shift, of, sizes, crossing, law, stops,
        edged, first, bin_m, turning, ends, knots, cubics, cells, cell,
    )  # fmt: skip
    for i in range(own_at, single_at):
        crossing[i] = on_line(level[i], rise, rise_m, own_m)
    if len(peak):
        wanted, found = level[mixed_at:].copy(), crossing[mixed_at:].copy()
        found = edges(
            step_m, half_m, wave_number, hazy_, first_bin, start_w, count_w, value, part, sub_first, sub_count,
            sub_range, series[0], series[1], series[2], peak, window, begin_w, centre_w, height_w, wanted, found, faint,
            exact_m, steps,
        )  # fmt: skip
        if hazy_:
            found = bent(
                step_m, half_m, wave_number, hazy_, first_bin, start_w, count_w, value, part, sub_first, sub_count,
                sub_range, series[0], series[1], series[2], edged, first, bin_m, turning, ends, knots, cubics, cells,
                cell, clear_w, air, peak, window, begin_w, centre_w, height_w, wanted, found, faint, straight_m,
                exact_m, golden, valley_steps,
            )  # fmt: skip
        crossing[mixed_at:] = found
        for i in range(len(peak)):
            if seen[mixed_at + i]:
                origin[mixed_at + i] = _source_of(
                    centre_w[i], height_w[i], window[i], step_m, half_m, wave_number, first_bin, start_w, count_w, part,
                    sub_first, sub_count, sub_range, sub_amplitude, sub_source,
                )  # fmt: skip
    read, read_sizes, clipped = readings(
        echo_beam, height, z, crossing, origin, seen, dark, least, full_scale, shot_factor, fwhm_m, walk_table > 0.0,
        offset_m,
    )  # fmt: skip
    _reported(
        left, read, read_sizes, clipped, least, noise_beam, noise_m, noise_height, columns, spreads, keep, law,
        ranges, intensity, actor, flags,
    )  # fmt: skip
