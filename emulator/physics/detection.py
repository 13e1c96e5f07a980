"""From sub-echoes to the echoes that the receiver reports: threshold, method of timing, several echoes, saturation.

Here: `detect`, which does a whole scan at once. Not here: the power of a sub-echo (radiometry), the
size of the noise (noise), the rounding to a wire's units (the codecs).

Amplitudes are in units of the receiver's nominal rms noise. One normal number an echo stands for the noise at its
crossing, the signal's own shot noise there included: it shifts the threshold. So an echo of amplitude SNR is seen with
probability Q(TNR - SNR) exactly, and the range scatters as the slope of the edge says, bounded where that formula has
its pole.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from types import ModuleType
from typing import Any, Protocol

import numpy as np

from emulator.compiled.pair import OTHERWISE, by_loops
from emulator.physics.arrays import Bools, Floats, Ints, Values, clamped, floats, group_starts, indexes, ramp
from emulator.physics.candidates import Candidates, single_candidates, wave_candidates
from emulator.physics.constants import SPEED_OF_LIGHT_M_S
from emulator.physics.cosines import Cosines, split_cosines
from emulator.physics.detector import Detector, Echoes
from emulator.physics.ownecho import OwnEchoes
from emulator.physics.pulse import stretch_peak_gauss, stretch_peak_sin2
from emulator.physics.softprofile import MARK, SoftProfile
from emulator.physics.subechoes import NO_SOURCE, Clusters, SubEchoes, cluster, unfold_spread
from emulator.physics.timing import centroids, fractions, rising_edges, sources
from emulator.physics.waveform import Waveform, sample

SIGMAS = 6.0
"Echoes this many noise rms below the threshold are not worth a draw: 1e-9."


class Numbers(Protocol):
    """An array of numbers, or whoever makes those that are asked for."""

    @property
    def shape(self) -> tuple[int, ...]: ...
    def __getitem__(self, at: Any, /) -> Any: ...


@dataclass(frozen=True, eq=False)
class Found:
    """Echoes before the choice of which to report; flat arrays."""

    beam: Ints
    range_m: Floats
    amplitude: Floats
    saturated: Bools
    source: Ints

    @classmethod
    def joined(cls, parts: list[Found]) -> Found:
        """All echoes of parts."""
        if len(parts) == 1:
            return parts[0]
        return cls(*(np.concatenate(column) for column in zip(*(vars(part).values() for part in parts), strict=True)))

    @classmethod
    def none(cls) -> Found:
        n = np.zeros(0, np.int64)
        return cls(n, np.zeros(0), np.zeros(0), np.zeros(0, np.bool_), n)


@dataclass(frozen=True, eq=False)
class _Joined:
    """Echoes (k,) before the receiver's noise."""

    beam: Ints
    centre_m: Floats
    height: Floats
    source: Ints
    ranks: dict[tuple[float, int], Ints] = field(default_factory=dict)
    "Places in their beams, by the floor and the count of random numbers."


@dataclass(frozen=True, eq=False)
class Signals:
    """What the receiver sees before its noise: what has a closed form, and sampled clusters with their maxima."""

    cosines: Cosines
    own: OwnEchoes
    single: Candidates
    mixed: Candidates
    wave: Waveform
    clusters: Clusters
    rms: Floats
    "(n,) noise of each beam over the nominal one."
    threshold: Floats
    "(n,)"

    @cached_property
    def joined(self) -> _Joined:
        """All echoes one behind the other."""
        cosines, own, single, mixed = self.cosines, self.own, self.single, self.mixed
        alone = np.ones(own.beam.size)
        none = np.full(own.beam.size, NO_SOURCE)
        return _Joined(
            np.concatenate([cosines.beam, own.beam, single.beam, mixed.beam]),
            np.concatenate([cosines.centre_m, own.centre_m * alone, single.centre_m, mixed.centre_m]),
            np.concatenate([cosines.height, own.height * alone, single.amplitude, mixed.amplitude]),
            np.concatenate([cosines.source, none, self.clusters.source[single.index], sources(self.wave, mixed)]),
        )

    def of_beams(self, wanted: Bools) -> Signals:
        """Those in the beams (n,) that are wanted."""
        cosines, own = self.cosines, self.own
        return replace(
            self,
            cosines=cosines.chosen(wanted[cosines.beam]),
            own=replace(own, beam=own.beam[wanted[own.beam]]),
            single=self.single.of_beams(wanted),
            mixed=self.mixed.of_beams(wanted),
        )


def signals_of(
    echoes: SubEchoes, beams: int, detector: Detector, *, noisy: bool, noise: Values = 1.0, soft: SoftProfile | None
) -> Signals:
    """The signals of a scan; `noisy`: `detect` will be given `normals`. The rest as there."""
    rms = np.full(beams, noise, np.float64) if isinstance(noise, float) else floats(noise)
    with np.errstate(under="ignore"):
        threshold = detector.thresholds(rms)
        least = np.maximum(threshold - (SIGMAS * rms if noisy else 0.0), 0.02 * threshold)
        cosines = Cosines.none()
        # beams in which the medium's own maximum is worth a look, and those of them that are sampled for it
        shows = np.zeros(beams, np.bool_) if soft is None or not soft.shows else soft.peak >= least
        marked = shows
        if not detector.sampled and detector.closed_form and (soft is None or soft.peak < detector.full_scale):
            cosines, echoes = split_cosines(echoes, detector, soft, rms)
            left = np.zeros(beams, np.bool_)
            left[echoes.beam] = True
            marked = shows & left
        if soft is not None and not soft.shows:
            # too low for an echo of its own, it may still be what a surface's echo is first crossed by
            head = group_starts(echoes.beam)
            early = echoes.range_m[head] - detector.pulse.half_support_m < soft.high_m
            marked = np.zeros(beams, np.bool_)
            marked[echoes.beam[head[early]]] = True
        own = OwnEchoes.of(soft, shows & ~marked)
        clusters, chosen, clear = _clusters_of(echoes, threshold, detector, soft, marked)
        single = single_candidates(clusters, ~chosen, least)
        wave = sample(clusters, chosen, detector.pulse, detector.bin_m, soft, clear)
        mixed = wave_candidates(wave, least, rms, threshold, detector)
        return Signals(cosines, own, single, mixed, wave, clusters, rms, threshold)


def detect(
    echoes: SubEchoes,
    beams: int,
    detector: Detector,
    *,
    normals: Numbers | None = None,
    timing: Numbers | None = None,
    noise: Values = 1.0,
    soft: SoftProfile | None = None,
    dazzled: Bools | None = None,
    noise_echoes: tuple[Ints, Floats, Floats] | None = None,
    signals: Sequence[Signals] = (),
) -> Echoes:
    """Echoes that the receiver reports for every beam of a scan.

    Parameters
    ----------
    echoes : sub-echoes of the scan, amplitudes in nominal noise units
    beams : number n of beams
    detector : threshold, method, choice of echoes
    normals : (n, e) standard normal numbers; the i-th highest echo of a beam takes number i modulo e. None: no noise
    timing : the same for the places of maxima, centroids and fractions, whose noise is another than that of heights;
        None: the same numbers
    noise : scalar or (n,) rms noise of each beam over the nominal one (sun in view)
    soft : homogeneous medium that scatters back, on this detector's bins
    dazzled : (n,) beams that report nothing
    noise_echoes : (beam, range_m, amplitude) of false alarms to add
    signals : `signals_of` the same, where they are known already, in parts of different beams; their noise holds then

    Returns
    -------
    Echoes of n beams, `detector.max_echoes` columns.
    """
    with np.errstate(under="ignore"):
        if not signals:
            signals = (signals_of(echoes, beams, detector, noisy=normals is not None, noise=noise, soft=soft),)
        found = Found.joined([_measure(part, detector, normals, timing) for part in signals])
    if noise_echoes is not None and noise_echoes[0].size:
        beam, r, amplitude = noise_echoes
        k = beam.size
        found = Found(
            np.concatenate([found.beam, beam]),
            np.concatenate([found.range_m, r]),
            np.concatenate([found.amplitude, np.maximum(amplitude, signals[0].threshold[beam])]),
            np.concatenate([found.saturated, np.zeros(k, np.bool_)]),
            np.concatenate([found.source, np.full(k, NO_SOURCE, np.int64)]),
        )
    return report(found, beams, detector, dazzled)


# ------------------------------------------------------------------------------- clusters: closed form or sampled
def _clusters_of(
    echoes: SubEchoes, threshold: Floats, detector: Detector, soft: SoftProfile | None, marked: Bools
) -> tuple[Clusters, Bools, Floats]:
    """Clusters of the scan, which of them need a waveform, and the share of the beam that reaches each."""
    pulse = detector.pulse
    echoes = _plane_echoes(echoes, detector, threshold)
    if soft is not None and (soft.pulse.shape != "sin2" or bool(marked.any())):
        echoes = SubEchoes.joined(echoes, _soft_marks(echoes, soft, marked))
    clusters = cluster(echoes, 2.0 * pulse.half_support_m, detector.resolution_m)
    first = clusters.first
    before = clusters.blocked.cumsum() - clusters.blocked
    beam = clusters.beam[first]
    head = clusters.beam.searchsorted(beam, side="left")
    clear = clamped(1.0 - (before[first] - before[head]), 0.0, 1.0) if first.size else np.zeros(0)
    chosen = clusters.count > (0 if detector.sampled else 1)
    if detector.method in ("constant_fraction", "centroid"):
        # a clipped pulse moves these two, so it is sampled
        chosen = chosen | (
            np.maximum.reduceat(clusters.amplitude, first) > detector.full_scale if first.size else chosen
        )
    if soft is not None and first.size:
        start = clusters.range_m[first] - pulse.half_support_m
        chosen = chosen | (clear * soft.wave(np.maximum(start, soft.peak_m)) > 1e-3)
    return clusters, chosen, clear


def _plane_echoes(echoes: SubEchoes, detector: Detector, threshold: Floats) -> SubEchoes:
    """Whole tilted planes: a small spread only lowers the peak, a large one is unfolded into points."""
    if echoes.spread_m is None:
        return echoes
    pulse, spread = detector.pulse, echoes.spread_m
    x = clamped(threshold[echoes.beam] / np.maximum(echoes.amplitude, 1e-12), 1e-4, 0.9)
    shift = spread**2 * np.pi / (4.0 * pulse.fwhm_m * np.sqrt(x * (1.0 - x)))
    wide = (shift > 0.25 * detector.resolution_m) | (spread > 0.05 * pulse.fwhm_m)
    stretch = stretch_peak_sin2 if pulse.shape == "sin2" else stretch_peak_gauss
    lowered = np.where(wide, 1.0, stretch(pulse.fwhm_s, np.where(wide, 0.0, spread)))
    flat = SubEchoes(
        echoes.beam, echoes.range_m, echoes.amplitude * lowered, echoes.blocked, echoes.source, echoes.spread_m
    )
    return unfold_spread(flat, wide)


def _soft_marks(echoes: SubEchoes, soft: SoftProfile, marked: Bools) -> SubEchoes:
    """Markers that have the medium's maximum sampled in these beams; for a Gaussian pulse the medium itself, in all."""
    beams = len(marked)
    if soft.pulse.shape == "sin2":
        r = np.array([min(soft.start_m, soft.peak_m), soft.peak_m])
        beam = indexes(marked)
        return SubEchoes.of(beam.repeat(2), np.tile(r, beam.size), np.full(2 * beam.size, MARK))
    node, piece = soft.nodes()
    first = echoes.beam.searchsorted(np.arange(beams))
    passed = np.concatenate([[0.0], echoes.blocked.cumsum()])
    length = float(max(soft.end_m, echoes.range_m.max(initial=0.0))) + 1.0
    key = echoes.beam * length + echoes.range_m
    at = key.searchsorted((np.arange(beams) * length)[:, None] + node, side="left")
    clear = clamped(1.0 - (passed[at] - passed[first][:, None]), 0.0, 1.0)
    return SubEchoes.of(np.arange(beams).repeat(node.size), np.tile(node, beams), (clear * piece).ravel())


# ------------------------------------------------------------------------------- seen, and where
def _measure_by_loops(
    loops: ModuleType, signals: Signals, detector: Detector, normals: Numbers | None, timing: Numbers | None
) -> Found:
    """On a leading edge of sin^2 pulses."""
    if not detector.closed_form:
        return OTHERWISE
    rms, cosines, own, mixed = signals.rms, signals.cosines, signals.own, signals.mixed
    joined = signals.joined
    beam, centre, height = joined.beam, joined.centre_m, joined.height
    if beam.size == 0:
        return Found.none()
    i = cosines.beam.size
    j = i + own.beam.size
    k = j + signals.single.beam.size
    shape = detector.full_scale, detector.shot_factor
    z = np.zeros(beam.size)
    if normals is not None:
        by = detector.floor_m2, normals.shape[1]
        if by not in joined.ranks:
            joined.ranks[by] = loops.ranks(beam, centre, height, rms.size, *by)
        z = normals[beam, joined.ranks[by]]
    lead_m = detector.pulse.fwhm_m
    level, seen, crossing = loops.levels(
        beam, centre, height, z, rms, signals.threshold, *shape, detector.floor_m2, lead_m, j
    )
    if i:
        crossing[:i] = cosines.crossing(level[:i])
    if j > i:
        crossing[i:j] = own.crossing(level[i:j])
    if mixed.beam.size:
        crossing[k:] = rising_edges(signals.wave, mixed, level[k:], crossing[k:])
    (of, source), (range_m, amplitude), clipped = loops.readings(
        beam, height, z, crossing, joined.source, seen, rms, signals.threshold, *shape, lead_m, detector.walk_table,
        detector.offset_m,
    )  # fmt: skip
    return Found(of, range_m, amplitude, clipped, source)


@by_loops(_measure_by_loops, "ranks", "levels", "readings")
def _measure(signals: Signals, detector: Detector, normals: Numbers | None, timing: Numbers | None) -> Found:
    rms, cosines, own, single, mixed = signals.rms, signals.cosines, signals.own, signals.single, signals.mixed
    wave, clusters = signals.wave, signals.clusters
    beam = np.concatenate([cosines.beam, own.beam, single.beam, mixed.beam])
    if beam.size == 0:
        return Found.none()
    alone = np.ones(own.beam.size)
    centre = np.concatenate([cosines.centre_m, own.centre_m * alone, single.centre_m, mixed.centre_m])
    height = np.concatenate([cosines.height, own.height * alone, single.amplitude, mixed.amplitude])
    dark, threshold = rms[beam], signals.threshold[beam]
    noise = np.sqrt(dark**2 + detector.shot_factor * height)
    tall = height * np.maximum(centre, 1e-3) ** 2 >= detector.floor_m2
    z = np.zeros(beam.size)
    if normals is not None:
        # by height: an echo that is too faint to be seen, computed or left out, takes no other's number
        order = np.lexsort((np.where(tall, -height, 0.0), beam))
        rank = np.zeros(beam.size, np.int64)
        sizes = np.bincount(beam, minlength=rms.size)
        rank[order] = ramp(sizes)
        z = normals[beam, rank % normals.shape[1]]
    late = z
    if timing is not None and normals is not None:
        late = timing[beam, rank % timing.shape[1]]
    clipped = height >= detector.full_scale
    shown = np.minimum(height, detector.full_scale)
    level = threshold - z * noise
    seen = (shown >= level) & tall
    if not bool(seen.any()):
        return Found.none()
    if detector.shot_factor > 0.0:  # at the crossing the signal is as high as the threshold, however high it rises
        level = threshold - z * np.sqrt(dark**2 + detector.shot_factor * np.minimum(height, threshold))
    level = clamped(level, 0.02 * threshold, np.maximum(shown, 1e-12))
    i = cosines.beam.size
    j = i + own.beam.size
    k = j + single.beam.size
    if detector.method == "leading_edge":
        crossing = centre - detector.pulse.lead(np.maximum(height / level, 1.0))
        if i:
            crossing[:i] = cosines.crossing(level[:i])
        if j > i:
            crossing[i:j] = own.crossing(level[i:j])
        if mixed.beam.size:
            crossing[k:] = rising_edges(wave, mixed, level[k:], crossing[k:])
        if detector.walk_table:
            range_m = crossing + detector.pulse.lead(np.maximum(shown / threshold, 1.0))
        else:
            range_m = crossing + detector.pulse.start_lead_m - detector.offset_m
    else:
        range_m = centre.copy()
        if mixed.beam.size and detector.method == "centroid":
            range_m[k:] = centroids(wave, mixed, detector, signals.threshold)
        elif mixed.beam.size and detector.method == "constant_fraction":
            range_m[k:] = fractions(wave, mixed, detector, signals.threshold)
        far = 0.5 * detector.pulse.fwhm_m
        range_m = range_m + clamped(late * detector.sigma_m(shown, noise, threshold), -far, far) - detector.offset_m
    source = np.full(beam.size, NO_SOURCE, np.int64)
    source[:i] = cosines.source
    source[j:k] = clusters.source[single.index]
    source[k:] = sources(wave, mixed)
    amplitude = clamped(height + z * noise, threshold, np.maximum(detector.full_scale, threshold))
    range_m = np.maximum(range_m, 0.0)  # a touching target is at 0, whatever the noise
    return Found(beam[seen], range_m[seen], amplitude[seen], clipped[seen], source[seen])


# ------------------------------------------------------------------------------- choice


def report(found: Found, beams: int, detector: Detector, dazzled: Bools | None) -> Echoes:
    """The echoes of each beam that the device reports, in the order of their ranges."""
    k = detector.max_echoes
    kept = (found.range_m >= detector.near_gate_m) & (found.range_m <= detector.far_gate_m) & np.isfinite(found.range_m)
    if dazzled is not None:
        kept &= ~dazzled[found.beam]
    result = Echoes(
        np.full((beams, k), np.nan),
        np.full((beams, k), np.nan),
        np.zeros((beams, k), np.bool_),
        np.full((beams, k), NO_SOURCE, np.int64),
    )
    at = indexes(kept) if k else indexes(kept)[:0]
    alone = np.bincount(found.beam[at], minlength=beams)[found.beam[at]] == 1
    _put(result, found, at[alone], 0)
    if not bool(alone.all()):
        _put(result, found, *_chosen(found, at[~alone], beams, detector))
    return result


def _put(result: Echoes, found: Found, at: Ints, column: Ints | int) -> None:
    """Some of what was found into columns of the result."""
    row = found.beam[at]
    result.range_m[row, column] = found.range_m[at]
    result.amplitude[row, column] = found.amplitude[at]
    result.saturated[row, column] = found.saturated[at]
    result.source[row, column] = found.source[at]


def _chosen(found: Found, order: Ints, beams: int, detector: Detector) -> tuple[Ints, Ints]:
    """Of several echoes of a beam those that are reported, and the column of each."""
    k, blind_m = detector.max_echoes, 0.5 * SPEED_OF_LIGHT_M_S * detector.recovery_s
    order = order[np.lexsort((found.range_m[order], found.beam[order]))]
    beam, range_m, amplitude = found.beam[order], found.range_m[order], found.amplitude[order]
    saturated = found.saturated[order]
    if detector.recovery_s > 0.0 and bool(saturated.any()):
        blind = _blinded(beam, range_m, saturated, blind_m)
        order, beam, range_m, amplitude = order[~blind], beam[~blind], range_m[~blind], amplitude[~blind]
    sizes = np.bincount(beam, minlength=beams)
    rank = ramp(sizes)
    column = rank
    if detector.keep == "last":
        column = rank - np.maximum(sizes - k, 0)[beam]
    elif detector.keep == "strongest" and beam.size:
        by_height = np.lexsort((range_m, -amplitude, beam))
        place = np.zeros(beam.size, np.int64)
        place[by_height] = rank
        strong = place < k
        column = np.full(beam.size, -1, np.int64)
        column[strong] = ramp(np.bincount(beam[strong], minlength=beams))
    shown = (column >= 0) & (column < k)
    return order[shown], column[shown]


def _blinded(beam: Ints, range_m: Floats, saturated: Bools, reach_m: float) -> Bools:
    """Echoes that come while the receiver recovers from an earlier clipped one of the same beam."""
    length = float(range_m.max(initial=0.0)) + reach_m + 1.0
    until = np.where(saturated, range_m + reach_m, -np.inf) + beam * length
    latest = np.maximum.accumulate(until)
    before = np.concatenate([[-np.inf], latest[:-1]])
    return np.asarray(before > range_m + beam * length)
