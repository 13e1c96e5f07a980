"""Where echoes of the sampled waveform lie by each method of timing, and what they are made of.

Here: leading edge, constant fraction and centroid on maxima found by `candidates`; sources of echoes. Not here: single
clusters, which have closed forms, and noise.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from types import ModuleType

import numpy as np

from emulator.compiled.pair import OTHERWISE, by_loops
from emulator.physics.arrays import Bools, Floats, Ints, clamped, floats, indexes, ramp
from emulator.physics.candidates import FAINT, Candidates
from emulator.physics.constants import SPEED_OF_LIGHT_M_S
from emulator.physics.detector import BASE_OF_ECHO, BASE_OF_THRESHOLD, Detector
from emulator.physics.softprofile import STRAIGHT_M
from emulator.physics.subechoes import NO_SOURCE
from emulator.physics.waveform import Waveform

EXACT_M = 1e-7
"Crossings between the samples are found to this."
MOST_STEPS = 20
"Of Newton's."
GOLDEN = 0.5 * (math.sqrt(5.0) - 1.0)
VALLEY_STEPS = 20
"Each leaves so much of two bins: to 1e-4 of them in all, where a valley is flat."


def _edges_by_loops(loops: ModuleType, wave: Waveform, found: Candidates, level: Floats, otherwise: Floats) -> Floats:
    if wave.pulse.shape != "sin2":
        return OTHERWISE
    what = found.index, found.window, found.begin, found.centre_m, found.amplitude, level, otherwise
    return floats(loops.edges(*wave.flat, *what, FAINT, EXACT_M, MOST_STEPS))


def rising_edges(wave: Waveform, found: Candidates, level: Floats, otherwise: Floats) -> Floats:
    """First crossing of each echo's level between its begin and its maximum, exact between the samples.

    An echo that rises from a valley above its level never crosses it: it keeps the place that a single echo with this
    maximum would have.
    """
    crossing = edges(wave, found, level, otherwise)
    return crossing if wave.medium is None else _bent(wave, found, level, crossing)


def _bent_by_loops(loops: ModuleType, wave: Waveform, found: Candidates, level: Floats, crossing: Floats) -> Floats:
    if wave.pulse.shape != "sin2":
        return OTHERWISE
    if not len(level):
        return crossing
    what = found.index, found.window, found.begin, found.centre_m, found.amplitude, level, crossing
    limits = FAINT, STRAIGHT_M, EXACT_M, GOLDEN, VALLEY_STEPS
    return floats(loops.bent(*wave.flat, *wave.air, *what, *limits))


@by_loops(_bent_by_loops, "bent")
def _bent(wave: Waveform, found: Candidates, level: Floats, crossing: Floats) -> Floats:
    """The same crossings where the medium is not as straight between two samples as they were found with."""
    first, count = wave.start[found.window], wave.count[found.window]
    if wave.pulse.shape != "sin2" or not len(first):
        return crossing
    local = np.floor(crossing / wave.bin_m).astype(np.int64) - wave.first_bin[found.window]
    on = (local >= 0) & (local < count - 1)
    # a crossing at a sample is that of the piece before
    at = first + np.minimum(np.maximum(local, 1), count - 3)
    soft = wave.soft
    bend = np.abs(np.diff(soft[at - 1 + np.arange(4)[:, None]], 2, axis=0)).max(axis=0)
    rises = np.maximum(wave.value[at + 1] - wave.value[at], 0.0)
    # the maximum between two samples reaches the level, the samples do not
    top = (crossing == found.centre_m) & (soft[found.index] > FAINT * found.amplitude) & (level < found.amplitude)
    some = indexes(on & (top | (0.125 * bend * wave.bin_m > STRAIGHT_M * rises)))
    crossing = _out_of_valleys(wave, found, level, crossing)
    if not len(some):
        return crossing
    window, x, wanted = found.window[some], crossing[some], np.sqrt(level[some])
    steps = np.maximum(local[some], 0)
    lo = wave.bin_m * (wave.first_bin[window] + steps).astype(np.float64)
    hi = lo + wave.bin_m

    def over(place: Floats, which: Ints) -> Floats:
        return np.sqrt(wave.exact_at(place, window[which])) - wanted[which]

    every = np.arange(len(some))
    lo = np.where((x - lo < EXACT_M) & (steps > 0), lo - wave.bin_m, lo)
    hi = np.where(found.centre_m[some] > lo, np.minimum(hi, found.centre_m[some]), hi)
    f_lo, f_hi = over(lo, every), over(hi, every)
    usable = (f_lo < 0.0) & (f_hi > 0.0)
    new = crossing.copy()
    new[some] = np.where(usable, _crossing(over, lo, hi, f_lo, f_hi, usable), x)
    return new


def _out_of_valleys(wave: Waveform, found: Candidates, level: Floats, crossing: Floats) -> Floats:
    """The same crossings where an echo rises from a valley whose samples are over its level.

    Where the valley itself is below, it is crossed behind. Where it is not, an echo keeps the place of a single one
    only if the valley is a whole noise unit above: in between the place goes from the one to the other. With a step
    there, 1e-3 of noise would decide on a tenth of a pulse.
    """
    at = indexes(
        (wave.value[found.begin] >= level) & (wave.soft[found.begin] > FAINT * level) & (found.index > found.begin)
    )
    if not len(at):
        return crossing
    window, wanted = found.window[at], np.sqrt(level[at])
    count = found.index[at] - found.begin[at] + 1
    piece = wave.value[found.begin[at].repeat(count) + ramp(count)]
    lowest_of = np.minimum.reduceat(piece, count.cumsum() - count)
    of = indexes(piece == lowest_of.repeat(count))[::-1]
    deepest = np.zeros(len(at), np.int64)
    deepest[np.arange(len(at)).repeat(count)[of]] = found.begin[at].repeat(count)[of] + ramp(count)[of]
    middle = wave.position(deepest, window)
    first = wave.bin_m * wave.first_bin[window].astype(np.float64)
    low, high = np.maximum(middle - wave.bin_m, first), middle + wave.bin_m
    for _ in range(VALLEY_STEPS):  # golden section
        one, other = high - GOLDEN * (high - low), low + GOLDEN * (high - low)
        left = wave.exact_at(one, window) <= wave.exact_at(other, window)
        low, high = np.where(left, low, one), np.where(left, other, high)
    lowest, end = 0.5 * (low + high), found.centre_m[at]

    def over(place: Floats, which: Ints) -> Floats:
        return np.sqrt(wave.exact_at(place, window[which])) - wanted[which]

    every = np.arange(len(at))
    f_lo, f_hi = over(lowest, every), over(end, every)
    usable = (f_lo < 0.0) & (f_hi > 0.0) & (end > lowest)
    above = clamped((f_lo + wanted) ** 2 - level[at], 0.0, 1.0)
    single = np.where(f_lo < 0.0, crossing[at], lowest + above * (crossing[at] - lowest))
    new = crossing.copy()
    new[at] = np.where(usable, _crossing(over, lowest, end, f_lo, f_hi, usable), single)
    return new


@by_loops(_edges_by_loops, "edges")
def edges(wave: Waveform, found: Candidates, level: Floats, otherwise: Floats) -> Floats:
    """The same with a medium that is linear between the samples."""
    count = found.index - found.begin + 1
    flat = found.begin.repeat(count) + ramp(count)
    owner = np.arange(count.size).repeat(count)
    over = indexes(wave.value[flat] >= level[owner])
    first = found.index.copy()
    hit = np.zeros(count.size, np.bool_)
    first[owner[over[::-1]]] = flat[over[::-1]]
    hit[owner[over]] = True
    top = ~hit  # the maximum between two samples reaches the level, the samples do not
    hi = wave.position(first, found.window)
    before = np.maximum(first - 1, wave.start[found.window])
    before[top & (found.centre_m > hi)] += 1
    usable = (hit & (first > found.begin)) | (top & (found.index > found.begin))
    lo = wave.position(before, found.window)
    hi = np.where(top, np.maximum(found.centre_m, lo), hi)
    root = np.sqrt(level)
    f_lo = np.sqrt(wave.value[before]) - root
    # a maximum that is mostly a cosine is exact, and rises as one; that of a medium is a parabola's
    exact = top & (wave.soft[first] <= FAINT * found.amplitude)
    highest = np.where(exact, found.amplitude, wave.value[first])
    f_hi = np.maximum(np.sqrt(np.maximum(highest, level)) - root, 0.0)
    window = found.window
    if wave.pulse.shape == "sin2":
        rising = indexes(usable & (f_lo < 0.0) & (f_hi > 0.0) & (hi > lo))
        low = wave.soft[before[rising]]
        soft = low, (wave.soft[before[rising] + 1] - low) / wave.bin_m
        x = hi
        x[rising] = _between_samples(wave, lo[rising], hi[rising], level[rising], window[rising], soft)
    else:

        def over_level(x: Floats, at: Ints) -> Floats:
            return np.sqrt(wave.at(x, window[at])) - root[at]

        x = _crossing(over_level, lo, hi, f_lo, f_hi, usable)
    return np.where(usable, x, otherwise)


def _between_samples(
    wave: Waveform, lo: Floats, hi: Floats, level: Floats, window: Ints, soft: tuple[Floats, Floats]
) -> Floats:
    """First crossings of sin^2 pulses between a sample below the level and the next one, or a maximum before it.

    Between the instants at which pulses begin or end the sum is one cosine, and the medium, `soft`, is linear, from its
    value at the first on by its slope: Newton's steps from where the cosine rises through what the medium leaves it in
    the middle.
    """
    slope = soft[1]
    constant = soft[0] - slope * lo
    begun, ended = wave.under_way(lo, window)
    more_begun, more_ended = wave.under_way(hi, window)
    lo, hi = _without_kinks(wave, lo, hi, level, window, begun, more_begun - begun, ended, more_ended - ended)
    begun, ended = wave.under_way(0.5 * (lo + hi), window)
    (even,), (real, imaginary) = wave.terms(begun, ended)
    even += constant
    k, origin = wave.pulse.wave_number, wave.bin_m * wave.first_bin[window]

    def value(x: Floats) -> tuple[Floats, Floats]:
        turn = k * (x - origin)
        cosine, sine = np.cos(turn), np.sin(turn)
        return even + slope * x + cosine * real + sine * imaginary, slope + k * (cosine * imaginary - sine * real)

    swing, middle = np.hypot(real, imaginary), 0.5 * (lo + hi)
    # from the trough on, whose angle keeps its digits; its turn is the one that is nearest
    left = level - even - slope * middle
    share = np.where(np.abs(left) < swing, 0.5 + 0.5 * left / np.maximum(swing, np.abs(left)), left > 0.0)
    rise = 2.0 * np.arcsin(np.sqrt(clamped(share, 0.0, 1.0))) - np.pi
    x = origin + (np.arctan2(imaginary, real) + rise) / k
    x = clamped(x + 2.0 * np.pi / k * np.rint((middle - x) * k / (2.0 * np.pi)), lo, hi)
    for _ in range(MOST_STEPS):
        is_now, rises = value(x)
        new = clamped(np.where(rises > 0.0, x + (level - is_now) / np.where(rises > 0.0, rises, 1.0), x), lo, hi)
        done = bool((np.abs(new - x) < EXACT_M).all())
        x = new
        if done:
            break
    return floats(x)


def _without_kinks(
    wave: Waveform, lo: Floats, hi: Floats, level: Floats, window: Ints,
    begun: Ints, begin: Ints, ended: Ints, end: Ints,
) -> tuple[Floats, Floats]:  # fmt: skip
    """The same brackets, narrowed until no pulse begins or ends in them: `begin` and `end` many do, from these on."""
    half = wave.pulse.half_support_m
    number = np.arange(lo.size)
    owner = np.concatenate([number.repeat(begin), number.repeat(end)])
    starts = wave.sub_range[begun.repeat(begin) + ramp(begin)] - half
    place = np.concatenate([starts, wave.sub_range[ended.repeat(end) + ramp(end)] + half])
    order = np.lexsort((place, owner))
    owner, place = owner[order], clamped(place[order], lo[owner[order]], hi[owner[order]])
    over = wave.at(place, window[owner]) >= level[owner]
    lo, hi = lo.copy(), hi.copy()
    at = indexes(over)[::-1]
    hi[owner[at]] = place[at]  # the first of each
    at = indexes(~over & (place < hi[owner]))
    lo[owner[at]] = place[at]  # the last of each
    return lo, hi


def _crossing(
    rises: Callable[[Floats, Ints], Floats], lo: Floats, hi: Floats, f_lo: Floats, f_hi: Floats, wanted: Bools
) -> Floats:
    """Zeros of functions that rise from f_lo < 0 at lo to f_hi >= 0 at hi, to `EXACT_M`.

    False position, the value at the stale end lessened as the new one reports (Anderson and Bjorck), a bisection where
    three steps have not halved the bracket; only those not there yet are evaluated. Where there is no bracket the upper
    end is returned.
    """
    x = hi.copy()
    live = indexes(wanted & (f_lo < 0.0) & (f_hi > 0.0) & (hi > lo))
    a, b, fa, fb = lo[live], hi[live], f_lo[live], f_hi[live]
    side, before = np.zeros(live.size, np.int64), np.full(live.size, np.inf)
    slope = (fb - fa) / (b - a)
    for step in range(60):
        if live.size == 0:
            break
        width = b - a
        mid = np.minimum(np.maximum(a - fa * width / (fb - fa), a), b)
        if step % 3 == 2:
            mid = np.where(width > 0.5 * before, 0.5 * (a + b), mid)
            before = width
        f = rises(mid, live)
        x[live] = mid
        up = f >= 0.0
        old = np.where(up, fb, fa)
        less = 1.0 - f / old
        less = np.where(less > 0.0, less, 0.5)
        fa = np.where(up, np.where(side == 1, less * fa, fa), f)
        fb = np.where(up, f, np.where(side == -1, less * fb, fb))
        # the slope from the nearer end shows how far it still is
        moved = mid - np.where(up, b, a)
        slope = np.where(moved != 0.0, (f - old) / np.where(moved != 0.0, moved, 1.0), slope)
        a, b = np.where(up, a, mid), np.where(up, mid, b)
        side = np.where(up, 1, -1)
        more = (b - a > EXACT_M) & (np.abs(f) > 0.1 * EXACT_M * slope) & (fa < 0.0) & (fb > 0.0)
        if not bool(more.all()):
            live, a, b, fa, fb, side = live[more], a[more], b[more], fa[more], fb[more], side[more]
            before, slope = before[more], slope[more]
    return x


def _ends(wave: Waveform, found: Candidates) -> Ints:
    """Sample at which the next echo of the window begins, or the window's last."""
    end = wave.start[found.window] + wave.count[found.window] - 1
    inside = indexes(found.window[1:] == found.window[:-1])
    end[inside] = found.begin[inside + 1]
    return end


def centroids(wave: Waveform, found: Candidates, detector: Detector, threshold: Floats) -> Floats:
    """First moment of the clipped signal v between the valleys on both sides of each echo, each with v^5/(v^2 + b^2)^2.

    The base b is half the threshold (n,) of the beam, and at most a tenth of the echo: without one, what the air sends
    back before a far wall weighs by its distance; a sharp one would show the bins.
    """
    begin, end = found.begin, _ends(wave, found)
    count = end - begin + 1
    flat = begin.repeat(count) + ramp(count)
    edge = count.cumsum() - count
    height = np.minimum(found.amplitude, detector.full_scale)
    base = np.minimum(BASE_OF_THRESHOLD * threshold[found.beam], BASE_OF_ECHO * height)
    value = np.minimum(wave.value[flat], detector.full_scale)
    value *= (value / np.maximum(np.hypot(value, base.repeat(count)), 1e-300)) ** 4
    offset = (flat - found.index.repeat(count)).astype(np.float64)
    total = np.add.reduceat(value, edge)
    moment = np.add.reduceat(value * offset, edge)
    return wave.position(found.index, found.window) + wave.bin_m * moment / np.where(total > 0.0, total, 1.0)


def fractions(wave: Waveform, found: Candidates, detector: Detector, threshold: Floats) -> Floats:
    """Constant fraction: where the delayed signal overtakes the attenuated one, less the lead of a single echo.

    `threshold` : (n,) of each beam.
    """
    delay = 0.5 * SPEED_OF_LIGHT_M_S * detector.cfd_delay_s
    f = detector.fraction

    def balance(x: Floats, window: Ints) -> Floats:
        late = np.minimum(wave.at(x - delay, window), detector.full_scale)
        return f * np.minimum(wave.at(x, window), detector.full_scale) - late

    begin = found.begin
    end = np.maximum(_ends(wave, found), begin + 2)
    last = wave.start[found.window] + wave.count[found.window] - 1
    end = np.minimum(end + int(np.ceil(delay / wave.bin_m)), last)
    count = end - begin + 1
    owner = np.arange(count.size).repeat(count)
    flat = begin.repeat(count) + ramp(count)
    window = found.window[owner]
    y = balance(wave.position(flat, window), window)
    falls = np.zeros(flat.size, np.bool_)
    falls[:-1] = (y[:-1] > 0.0) & (y[1:] <= 0.0) & (owner[1:] == owner[:-1])
    # armed by the threshold: the zero belongs to the rise that reached it
    armed = np.minimum(wave.value[found.index], threshold[found.beam]) * 0.5
    value = np.minimum(wave.value[flat], detector.full_scale)
    falls &= (value >= armed[owner]) | (flat >= found.index[owner])
    at = indexes(falls)
    place = np.full(count.size, -1, np.int64)
    place[owner[at[::-1]]] = at[::-1]
    ok = place >= 0
    i = np.where(ok, place, 0)
    j = np.minimum(i + 1, flat.size - 1)
    lo, hi = wave.position(flat[i], found.window), wave.position(flat[j], found.window)
    f_lo, f_hi = y[i], y[j]
    x = _crossing(lambda x, at: -balance(x, found.window[at]), lo, hi, -f_lo, -f_hi, ok)
    return np.where(ok, x - detector.cfd_lead_m, found.centre_m)


def sources(wave: Waveform, found: Candidates) -> Ints:
    """Source of the sub-echo nearest to the maximum among those that stand under it; -1 where a medium is higher."""
    if found.beam.size == 0:
        return np.zeros(0, np.int64)
    start = wave.sub_first[found.window]
    source = wave.sub_source[start]
    medium = wave.soft_at(found.centre_m, found.window) if wave.soft.size else np.zeros(len(source))
    changes = np.concatenate(([0], (wave.sub_source[1:] != wave.sub_source[:-1]).cumsum()))
    mixed = changes[start] != changes[start + wave.sub_count[found.window] - 1]
    at = indexes(mixed | (medium > found.amplitude - medium))  # of the others there is nothing to choose
    if not len(at):
        return source
    count, centre = wave.sub_count[found.window[at]], found.centre_m[at]
    member = start[at].repeat(count) + ramp(count)
    pull = wave.sub_amplitude[member] * wave.pulse.profile(centre.repeat(count) - wave.sub_range[member])
    best = np.maximum.reduceat(pull, count.cumsum() - count)
    strongest = indexes(pull == best.repeat(count))[::-1]
    source[at.repeat(count)[strongest]] = wave.sub_source[member[strongest]]
    hidden = medium[at] > np.maximum(found.amplitude[at] - medium[at], best)
    source[at[hidden]] = NO_SOURCE
    return source
