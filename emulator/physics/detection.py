"""From sub-echoes to the echoes that the receiver reports: threshold, method of timing, several echoes, saturation.

Here: `detect`, which does a whole scan at once, and its settings. Not here: the power of a sub-echo (radiometry), the
size of the noise (noise), the rounding to a wire's units (the codecs).

Amplitudes are in units of the receiver's nominal rms noise. One normal number an echo stands for the noise at its
crossing: it shifts the threshold. So an echo of amplitude SNR is seen with probability Q(TNR - SNR) exactly, and the
range scatters as the slope of the edge says, bounded where that formula has its pole.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from emulator.physics.arrays import Bools, Floats, Ints, Values, floats, ramp
from emulator.physics.constants import SPEED_OF_LIGHT_M_S
from emulator.physics.pulse import Pulse, cfd_gauss, cfd_sin2, stretch_peak_gauss, stretch_peak_sin2
from emulator.physics.softprofile import MARK, SoftProfile
from emulator.physics.subechoes import NO_SOURCE, Clusters, SubEchoes, cluster, unfold_spread
from emulator.physics.waveform import Waveform, sample

Method = Literal["leading_edge", "constant_fraction", "peak", "centroid"]
Keep = Literal["first", "strongest", "last", "all"]
_SIGMAS = 6.0
"Echoes this many noise rms below the threshold are not worth a draw: 1e-9."


@dataclass(frozen=True)
class Detector:
    """How the receiver turns its signal into echoes. Lengths in m of apparent range, amplitudes in noise units."""

    pulse: Pulse
    threshold: float
    "TNR: threshold over the nominal rms noise."
    method: Method = "leading_edge"
    walk_table: bool = True
    "Leading edge: subtract the walk of a single echo of the measured height; wrong for mixed echoes, as in sensors."
    keep: Keep = "first"
    max_echoes: int = 1
    resolution_m: float = 0.01
    "Least step of the reported range; sub-echoes within a quarter of it are one."
    bin_s: float | None = None
    "Step of the sampled waveform; None: a sixteenth of the pulse's FWHM, 1 ns for 16 ns."
    full_scale: float = float("inf")
    "Amplitude at which the signal clips."
    recovery_s: float = 0.0
    "Time for which a clipped echo leaves the receiver blind."
    offset_m: float = 0.0
    "Subtracted from every range: calibration of a leading edge without walk table."
    fraction: float = 0.5
    "Constant fraction."
    delay_s: float | None = None
    "Constant fraction; None: half the FWHM."
    shot_factor: float = 0.0
    "Signal shot noise: (noise at an echo)^2 = noise^2 + shot_factor * amplitude, see `noise.signal_shot_factor`."
    floor_m2: float = 0.0
    "Echoes fainter than floor_m2/R^2 are dropped: fog correction by a least reflectance, K times rho."
    near_gate_m: float = 0.0
    far_gate_m: float = float("inf")

    def __post_init__(self) -> None:
        if not (np.isfinite(self.threshold) and self.threshold > 0.0):
            raise ValueError(f"threshold: {self.threshold}; want a number > 0")
        if self.method not in ("leading_edge", "constant_fraction", "peak", "centroid"):
            raise ValueError(f"method: {self.method!r}; want leading_edge, constant_fraction, peak or centroid")
        if self.keep not in ("first", "strongest", "last", "all"):
            raise ValueError(f"keep: {self.keep!r}; want first, strongest, last or all")
        if self.max_echoes < 1:
            raise ValueError(f"max_echoes: {self.max_echoes}; want at least 1")
        if self.full_scale <= self.threshold:
            raise ValueError(f"full_scale: {self.full_scale}; want more than the threshold, {self.threshold}")
        if not 0.0 < self.fraction < 1.0:
            raise ValueError(f"fraction: {self.fraction}; want a number between 0 and 1")
        if not 0.0 < self.cfd_delay_s < 2.0 * self.pulse.fwhm_s:
            raise ValueError(f"delay_s: {self.delay_s}; want a number between 0 and {2.0 * self.pulse.fwhm_s}")

    @property
    def bin_m(self) -> float:
        """Step of the sampled waveform in apparent range."""
        return self.pulse.fwhm_m / 16.0 if self.bin_s is None else 0.5 * SPEED_OF_LIGHT_M_S * self.bin_s

    @property
    def cfd_delay_s(self) -> float:
        """Delay of the constant fraction."""
        return 0.5 * self.pulse.fwhm_s if self.delay_s is None else self.delay_s

    @property
    def cfd_lead_m(self) -> float:
        """Where the constant-fraction zero of a single echo lies, from the centre of its pulse."""
        timing = cfd_sin2 if self.pulse.shape == "sin2" else cfd_gauss
        zero_s = float(timing(self.pulse.fwhm_s, self.fraction, self.cfd_delay_s))
        return 0.5 * SPEED_OF_LIGHT_M_S * zero_s - self.pulse.start_lead_m

    def sigma_m(self, amplitude: Values, noise: Values = 1.0) -> Floats:
        """Range noise of the method for single echoes; for the leading edge `detect` shifts the threshold instead."""
        snr = np.maximum(floats(amplitude) / noise, 1e-9)
        tau = self.pulse.fwhm_s
        c = SPEED_OF_LIGHT_M_S
        if self.method == "constant_fraction":
            lead, delay, h = self.cfd_lead_m, 0.5 * c * self.cfd_delay_s, 1e-6 * self.pulse.fwhm_m
            x = np.array([lead - h, lead + h])
            y = self.fraction * self.pulse.profile(x) - self.pulse.profile(x - delay)
            slope = abs(float(y[1] - y[0])) / (2.0 * h)
            return floats(np.sqrt(1.0 + self.fraction**2) / (slope * snr))
        if self.pulse.shape == "sin2":
            return c * tau / np.pi / snr  # Cramer-Rao bound with B = 1/(2 FWHM)
        sigma = self.pulse.sigma_m
        return floats(sigma * np.sqrt(2.0 * sigma / (np.sqrt(np.pi) * self.pulse.fwhm_m)) / snr)


@dataclass(frozen=True, eq=False)
class Echoes:
    """Reported echoes of n beams, up to k each, nearest first, NaN where there is none."""

    range_m: Floats
    "(n, k)"
    amplitude: Floats
    "(n, k) measured peak in noise units, at least the threshold"
    saturated: Bools
    "(n, k)"
    source: Ints
    "(n, k) source of the sub-echo that the echo is mostly made of; -1 medium, noise or none"

    @property
    def count(self) -> Ints:
        """(n,) echoes of each beam."""
        return np.asarray(np.count_nonzero(np.isfinite(self.range_m), axis=1), np.int64)


@dataclass(frozen=True, eq=False)
class _Found:
    """Echoes before the choice of which to report; flat arrays."""

    beam: Ints
    range_m: Floats
    amplitude: Floats
    saturated: Bools
    source: Ints

    @classmethod
    def none(cls) -> _Found:
        n = np.zeros(0, np.int64)
        return cls(n, np.zeros(0), np.zeros(0), np.zeros(0, np.bool_), n)


def detect(
    echoes: SubEchoes,
    beams: int,
    detector: Detector,
    *,
    normals: Floats | None = None,
    noise: Values = 1.0,
    soft: SoftProfile | None = None,
    dazzled: Bools | None = None,
    noise_echoes: tuple[Ints, Floats, Floats] | None = None,
) -> Echoes:
    """Echoes that the receiver reports for every beam of a scan.

    Parameters
    ----------
    echoes : sub-echoes of the scan, amplitudes in nominal noise units
    beams : number n of beams
    detector : threshold, method, choice of echoes
    normals : (n, e) standard normal numbers; echo number i of a beam takes number i modulo e. None: no noise is drawn
    noise : scalar or (n,) rms noise of each beam over the nominal one (sun in view)
    soft : homogeneous medium that scatters back, on this detector's bins
    dazzled : (n,) beams that report nothing
    noise_echoes : (beam, range_m, amplitude) of false alarms to add

    Returns
    -------
    Echoes of n beams, `detector.max_echoes` columns.
    """
    rms = np.broadcast_to(floats(noise), (beams,))
    with np.errstate(under="ignore"):
        clusters, chosen, clear = _clusters_of(echoes, beams, detector, soft)
        least = detector.threshold - (_SIGMAS * rms if normals is not None else 0.0 * rms)
        least = np.maximum(least, 0.02 * detector.threshold)
        single = _single_candidates(clusters, ~chosen, least)
        wave = sample(clusters, chosen, detector.pulse, detector.bin_m, soft, clear)
        mixed = _wave_candidates(wave, least, detector)
        found = _measure(single, mixed, wave, clusters, detector, normals, rms)
    if noise_echoes is not None and noise_echoes[0].size:
        beam, r, amplitude = noise_echoes
        k = beam.size
        found = _Found(
            np.concatenate([found.beam, beam]),
            np.concatenate([found.range_m, r]),
            np.concatenate([found.amplitude, np.maximum(amplitude, detector.threshold)]),
            np.concatenate([found.saturated, np.zeros(k, np.bool_)]),
            np.concatenate([found.source, np.full(k, NO_SOURCE, np.int64)]),
        )
    return _report(found, beams, detector, dazzled)


# ------------------------------------------------------------------------------- clusters: closed form or sampled
def _clusters_of(
    echoes: SubEchoes, beams: int, detector: Detector, soft: SoftProfile | None
) -> tuple[Clusters, Bools, Floats]:
    """Clusters of the scan, which of them need a waveform, and the share of the beam that reaches each."""
    pulse = detector.pulse
    echoes = _plane_echoes(echoes, detector)
    if soft is not None:
        echoes = SubEchoes.joined(echoes, _soft_marks(echoes, beams, soft))
    clusters = cluster(echoes, 2.0 * pulse.half_support_m, detector.resolution_m)
    first = clusters.first
    before = np.cumsum(clusters.blocked) - clusters.blocked
    beam = clusters.beam[first]
    head = np.searchsorted(clusters.beam, beam, side="left")
    clear = np.clip(1.0 - (before[first] - before[head]), 0.0, 1.0) if first.size else np.zeros(0)
    chosen = clusters.count > 1
    if detector.method in ("constant_fraction", "centroid"):
        # a clipped pulse moves these two, so it is sampled
        chosen = chosen | (
            np.maximum.reduceat(clusters.amplitude, first) > detector.full_scale if first.size else chosen
        )
    if soft is not None and first.size:
        start = clusters.range_m[first] - pulse.half_support_m
        chosen = chosen | (clear * soft.wave(np.maximum(start, soft.peak_m)) > 0.01)
    return clusters, chosen, clear


def _plane_echoes(echoes: SubEchoes, detector: Detector) -> SubEchoes:
    """Whole tilted planes: a small spread only lowers the peak, a large one is unfolded into points."""
    if echoes.spread_m is None:
        return echoes
    pulse, spread = detector.pulse, echoes.spread_m
    x = np.clip(detector.threshold / np.maximum(echoes.amplitude, 1e-12), 1e-4, 0.9)
    shift = spread**2 * np.pi / (4.0 * pulse.fwhm_m * np.sqrt(x * (1.0 - x)))
    wide = (shift > 0.25 * detector.resolution_m) | (spread > 0.05 * pulse.fwhm_m)
    stretch = stretch_peak_sin2 if pulse.shape == "sin2" else stretch_peak_gauss
    lowered = np.where(wide, 1.0, stretch(pulse.fwhm_s, np.where(wide, 0.0, spread)))
    flat = SubEchoes(
        echoes.beam, echoes.range_m, echoes.amplitude * lowered, echoes.blocked, echoes.source, echoes.spread_m
    )
    return unfold_spread(flat, wide)


def _soft_marks(echoes: SubEchoes, beams: int, soft: SoftProfile) -> SubEchoes:
    """Markers that have the medium's maximum sampled in every beam; for a Gaussian pulse the medium itself."""
    if soft.pulse.shape == "sin2":
        r = np.array([min(soft.start_m, soft.peak_m), soft.peak_m])
        r, strength = np.tile(r, beams), np.full(2 * beams, MARK)
    else:
        node, piece = soft.nodes()
        order = np.searchsorted(echoes.beam, np.arange(beams + 1))
        passed = np.concatenate([[0.0], np.cumsum(echoes.blocked)])
        length = float(max(soft.end_m, echoes.range_m.max(initial=0.0))) + 1.0
        key = echoes.beam * length + echoes.range_m
        at = np.searchsorted(key, (np.arange(beams) * length)[:, None] + node, side="left")
        clear = np.clip(1.0 - (passed[at] - passed[order[:-1]][:, None]), 0.0, 1.0)
        r, strength = np.tile(node, beams), (clear * piece).ravel()
    count = r.size // beams if beams else 0
    beam = np.repeat(np.arange(beams), count)
    return SubEchoes.of(beam, r, strength)


# ------------------------------------------------------------------------------- candidates
@dataclass(frozen=True, eq=False)
class _Candidates:
    beam: Ints
    centre_m: Floats
    "Place of the maximum, apparent range from the centre of the pulse."
    amplitude: Floats
    "Height before clipping."
    index: Ints
    "Cluster (single) or flat sample of the maximum (mixed)."
    window: Ints
    "Mixed: window; single: -1."
    begin: Ints
    "Mixed: sample from which the rise of this echo is looked for."


def _single_candidates(clusters: Clusters, chosen: Bools, least: Floats) -> _Candidates:
    at = np.flatnonzero(chosen)
    sub = clusters.first[at]
    beam = clusters.beam[sub]
    seen = clusters.amplitude[sub] >= least[beam]
    at, sub, beam = at[seen], sub[seen], beam[seen]
    minus = np.full(at.size, -1, np.int64)
    return _Candidates(beam, clusters.range_m[sub], clusters.amplitude[sub], sub, minus, minus)


def _wave_candidates(wave: Waveform, least: Floats, detector: Detector) -> _Candidates:
    """Maxima of the clipped waveform, joined where no valley separates them."""
    n = wave.value.size
    none = np.zeros(0, np.int64)
    if n == 0:
        return _Candidates(none, np.zeros(0), np.zeros(0), none, none, none)
    value = np.minimum(wave.value, detector.full_scale)
    top = np.zeros(n, np.bool_)
    top[1:-1] = (value[1:-1] > value[:-2]) & (value[1:-1] >= value[2:])
    top[wave.start] = False
    top[wave.start + wave.count - 1] = False
    peak = np.flatnonzero(top)
    window = np.searchsorted(wave.start, peak, side="right") - 1
    beam = wave.beam[window]
    seen = value[peak] >= 0.99 * least[beam]
    peak, window, beam = peak[seen], window[seen], beam[seen]
    while peak.size > 1:
        valley = np.minimum.reduceat(value, peak)[:-1]  # between a maximum and the next
        lower = np.minimum(value[peak[1:]], value[peak[:-1]])
        apart = (lower - valley >= 1.0) | ((lower >= detector.threshold) & (valley < detector.threshold))
        apart |= beam[1:] != beam[:-1]
        if bool(np.all(apart)):
            break
        second = value[peak[1:]] <= value[peak[:-1]]
        lost = np.zeros(peak.size, np.bool_)
        lost[1:] |= ~apart & second
        lost[:-1] |= ~apart & ~second
        peak, window, beam = peak[~lost], window[~lost], beam[~lost]
    if peak.size == 0:
        return _Candidates(none, np.zeros(0), np.zeros(0), none, none, none)
    centre, height = _parabola(wave, value, peak, window, detector)
    begin = wave.start[window]
    inside = np.flatnonzero(window[1:] == window[:-1])
    if inside.size:  # from the lowest sample since the last maximum of the window on
        count = peak[inside + 1] - peak[inside]
        flat = np.repeat(peak[inside], count) + ramp(count)
        edge = np.cumsum(count) - count
        lowest = np.minimum.reduceat(value[flat], edge)
        at = np.flatnonzero(value[flat] == np.repeat(lowest, count))
        owner = np.repeat(np.arange(inside.size), count)[at]
        place = np.zeros(inside.size, np.int64)
        place[owner] = flat[at]  # the last of equals
        begin[inside + 1] = place
    return _Candidates(beam, centre, height, peak, window, begin)


def _parabola(wave: Waveform, value: Floats, peak: Ints, window: Ints, detector: Detector) -> tuple[Floats, Floats]:
    """Place and height of maxima by a parabola through three samples; of a clipped one the middle of its run."""
    left, mid, right = wave.value[peak - 1], wave.value[peak], wave.value[peak + 1]
    if detector.pulse.shape == "gauss":
        tiny = 1e-9 * mid
        left, mid, right = (np.log(np.maximum(v, tiny)) for v in (left, mid, right))
    curve = left - 2.0 * mid + right
    shift = np.where(curve < 0.0, 0.5 * (left - right) / np.where(curve < 0.0, curve, -1.0), 0.0)
    shift = np.clip(shift, -0.5, 0.5)
    height = mid - 0.25 * (left - right) * shift
    if detector.pulse.shape == "gauss":
        height = np.exp(height)
    centre = wave.position(peak, window) + shift * wave.bin_m
    clipped = value[peak] >= detector.full_scale
    if bool(np.any(clipped)):
        below = np.flatnonzero(value < detector.full_scale)
        after = below[np.searchsorted(below, peak[clipped], side="right")]
        before = peak[clipped] - 1
        v = wave.value
        limit = detector.full_scale
        up = before + (limit - v[before]) / np.maximum(v[before + 1] - v[before], 1e-300)
        down = after - (limit - v[after]) / np.maximum(v[after - 1] - v[after], 1e-300)
        start, first = wave.start[window[clipped]], wave.first_bin[window[clipped]]
        centre[clipped] = wave.bin_m * (0.5 * (up + down) - start + first)
        height[clipped] = np.maximum(height[clipped], limit)
    return centre, height


# ------------------------------------------------------------------------------- timing
def _measure(
    single: _Candidates,
    mixed: _Candidates,
    wave: Waveform,
    clusters: Clusters,
    detector: Detector,
    normals: Floats | None,
    rms: Floats,
) -> _Found:
    beam = np.concatenate([single.beam, mixed.beam])
    if beam.size == 0:
        return _Found.none()
    centre = np.concatenate([single.centre_m, mixed.centre_m])
    height = np.concatenate([single.amplitude, mixed.amplitude])
    noise = np.sqrt(rms[beam] ** 2 + detector.shot_factor * height)
    z = np.zeros(beam.size)
    if normals is not None:
        order = np.lexsort((centre, beam))
        rank = np.zeros(beam.size, np.int64)
        sizes = np.bincount(beam, minlength=rms.size)
        rank[order] = ramp(sizes)
        z = normals[beam, rank % normals.shape[1]]
    clipped = height >= detector.full_scale
    shown = np.minimum(height, detector.full_scale)
    level = detector.threshold - z * noise
    seen = (shown >= level) & (height * np.maximum(centre, 1e-3) ** 2 >= detector.floor_m2)
    if not bool(np.any(seen)):
        return _Found.none()
    level = np.clip(level, 0.02 * detector.threshold, np.maximum(shown, 1e-12))
    k = single.beam.size
    if detector.method == "leading_edge":
        crossing = centre - detector.pulse.lead(np.maximum(height / level, 1.0))
        if mixed.beam.size:
            crossing[k:] = _edges(wave, mixed, level[k:], crossing[k:])
        if detector.walk_table:
            range_m = crossing + detector.pulse.lead(np.maximum(shown / detector.threshold, 1.0))
        else:
            range_m = crossing + detector.pulse.start_lead_m - detector.offset_m
    else:
        range_m = centre.copy()
        if mixed.beam.size and detector.method == "centroid":
            range_m[k:] = _centroids(wave, mixed, detector)
        elif mixed.beam.size and detector.method == "constant_fraction":
            range_m[k:] = _fractions(wave, mixed, detector)
        far = 0.5 * detector.pulse.fwhm_m
        range_m = range_m + np.clip(z * detector.sigma_m(shown, noise), -far, far) - detector.offset_m
    source = np.full(beam.size, NO_SOURCE, np.int64)
    source[:k] = clusters.source[single.index]
    source[k:] = _sources(wave, mixed)
    amplitude = np.clip(height + z * noise, detector.threshold, max(detector.full_scale, detector.threshold))
    return _Found(beam[seen], range_m[seen], amplitude[seen], clipped[seen], source[seen])


def _edges(wave: Waveform, found: _Candidates, level: Floats, otherwise: Floats) -> Floats:
    """First crossing of each echo's level between its begin and its maximum, exact to 1e-6 of a bin.

    An echo that rises from a valley above its level never crosses it: it keeps the place that a single echo with this
    maximum would have.
    """
    count = found.index - found.begin + 1
    flat = np.repeat(found.begin, count) + ramp(count)
    owner = np.repeat(np.arange(count.size), count)
    over = np.flatnonzero(wave.value[flat] >= level[owner])
    first = found.index.copy()
    hit = np.zeros(count.size, np.bool_)
    first[owner[over[::-1]]] = flat[over[::-1]]
    hit[owner[over]] = True
    top = ~hit  # the maximum between two samples reaches the level, the samples do not
    before = np.maximum(first - 1, wave.start[found.window])
    usable = (hit & (first > found.begin)) | (top & (found.index > found.begin))
    lo, hi = wave.position(before, found.window), wave.position(first, found.window)
    hi = np.where(top, np.maximum(found.centre_m, lo), hi)
    root = np.sqrt(level)
    f_lo = np.sqrt(wave.value[before]) - root
    f_hi = np.maximum(np.sqrt(np.maximum(wave.value[first], level)) - root, 0.0)
    window = found.window
    x = hi
    for _ in range(6):  # false position on the root of the signal, which is nearly straight; the stale end is halved
        span = np.where(f_hi - f_lo > 0.0, f_hi - f_lo, 1.0)
        x = np.clip(lo - f_lo * (hi - lo) / span, lo, hi)
        f = np.sqrt(wave.at(x, window)) - root
        up = f >= 0.0
        f_lo = np.where(up, 0.5 * f_lo, f)
        f_hi = np.where(up, f, 0.5 * f_hi)
        lo, hi = np.where(up, lo, x), np.where(up, x, hi)
        if float(np.max(np.where(usable, np.abs(f), 0.0) / root, initial=0.0)) < 1e-7:
            break
    return np.where(usable, x, otherwise)


def _ends(wave: Waveform, found: _Candidates) -> Ints:
    """Sample at which the next echo of the window begins, or the window's last."""
    end = wave.start[found.window] + wave.count[found.window] - 1
    inside = np.flatnonzero(found.window[1:] == found.window[:-1])
    end[inside] = found.begin[inside + 1]
    return end


def _centroids(wave: Waveform, found: _Candidates, detector: Detector) -> Floats:
    """First moment of the clipped signal between the valleys on both sides of each echo."""
    begin, end = found.begin, _ends(wave, found)
    count = end - begin + 1
    flat = np.repeat(begin, count) + ramp(count)
    edge = np.cumsum(count) - count
    value = np.minimum(wave.value[flat], detector.full_scale)
    offset = (flat - np.repeat(found.index, count)).astype(np.float64)
    total = np.add.reduceat(value, edge)
    moment = np.add.reduceat(value * offset, edge)
    return wave.position(found.index, found.window) + wave.bin_m * moment / np.where(total > 0.0, total, 1.0)


def _fractions(wave: Waveform, found: _Candidates, detector: Detector) -> Floats:
    """Constant fraction: where the delayed signal overtakes the attenuated one, less the lead of a single echo."""
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
    owner = np.repeat(np.arange(count.size), count)
    flat = np.repeat(begin, count) + ramp(count)
    window = found.window[owner]
    y = balance(wave.position(flat, window), window)
    falls = np.zeros(flat.size, np.bool_)
    falls[:-1] = (y[:-1] > 0.0) & (y[1:] <= 0.0) & (owner[1:] == owner[:-1])
    # armed by the threshold: the zero belongs to the rise that reached it
    armed = np.minimum(wave.value[found.index], detector.threshold) * 0.5
    value = np.minimum(wave.value[flat], detector.full_scale)
    falls &= (value >= armed[owner]) | (flat >= found.index[owner])
    at = np.flatnonzero(falls)
    place = np.full(count.size, -1, np.int64)
    place[owner[at[::-1]]] = at[::-1]
    ok = place >= 0
    i = np.where(ok, place, 0)
    j = np.minimum(i + 1, flat.size - 1)
    lo, hi = wave.position(flat[i], found.window), wave.position(flat[j], found.window)
    f_lo, f_hi = y[i], y[j]
    x = hi
    for _ in range(6):
        span = np.where(f_lo - f_hi > 0.0, f_lo - f_hi, 1.0)
        x = np.clip(lo + f_lo * (hi - lo) / span, np.minimum(lo, hi), np.maximum(lo, hi))
        v = balance(x, found.window)
        up = v > 0.0
        f_hi = np.where(up, 0.5 * f_hi, v)
        f_lo = np.where(up, v, 0.5 * f_lo)
        lo, hi = np.where(up, x, lo), np.where(up, hi, x)
    return np.where(ok, x - detector.cfd_lead_m, found.centre_m)


def _sources(wave: Waveform, found: _Candidates) -> Ints:
    """Source of the sub-echo nearest to the maximum among those that stand under it; -1 where a medium is higher."""
    if found.beam.size == 0:
        return np.zeros(0, np.int64)
    count = wave.sub_count[found.window]
    member = np.repeat(wave.sub_first[found.window], count) + ramp(count)
    owner = np.repeat(np.arange(count.size), count)
    pull = wave.sub_amplitude[member] * wave.pulse.profile(found.centre_m[owner] - wave.sub_range[member])
    best = np.maximum.reduceat(pull, np.cumsum(count) - count)
    at = np.flatnonzero(pull == best[owner])
    source = np.full(count.size, NO_SOURCE, np.int64)
    source[owner[at[::-1]]] = wave.sub_source[member[at[::-1]]]
    if wave.soft.size:
        medium = wave.soft_at(found.centre_m, found.window)
        source = np.where(medium > np.maximum(found.amplitude - medium, best), NO_SOURCE, source)
    return source


# ------------------------------------------------------------------------------- choice
def _report(found: _Found, beams: int, detector: Detector, dazzled: Bools | None) -> Echoes:
    k = detector.max_echoes
    kept = (found.range_m >= detector.near_gate_m) & (found.range_m <= detector.far_gate_m) & np.isfinite(found.range_m)
    if dazzled is not None:
        kept &= ~dazzled[found.beam]
    order = np.flatnonzero(kept)
    order = order[np.lexsort((found.range_m[order], found.beam[order]))]
    beam, range_m, amplitude = found.beam[order], found.range_m[order], found.amplitude[order]
    saturated = found.saturated[order]
    if detector.recovery_s > 0.0 and bool(np.any(saturated)):
        blind = _blinded(beam, range_m, saturated, 0.5 * SPEED_OF_LIGHT_M_S * detector.recovery_s)
        order, beam, range_m, amplitude = order[~blind], beam[~blind], range_m[~blind], amplitude[~blind]
        saturated = saturated[~blind]
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
    result = Echoes(
        np.full((beams, k), np.nan),
        np.full((beams, k), np.nan),
        np.zeros((beams, k), np.bool_),
        np.full((beams, k), NO_SOURCE, np.int64),
    )
    row, col, at = beam[shown], column[shown], order[shown]
    result.range_m[row, col] = found.range_m[at]
    result.amplitude[row, col] = found.amplitude[at]
    result.saturated[row, col] = found.saturated[at]
    result.source[row, col] = found.source[at]
    return result


def _blinded(beam: Ints, range_m: Floats, saturated: Bools, reach_m: float) -> Bools:
    """Echoes that come while the receiver recovers from an earlier clipped one of the same beam."""
    length = float(range_m.max(initial=0.0)) + reach_m + 1.0
    until = np.where(saturated, range_m + reach_m, -np.inf) + beam * length
    latest = np.maximum.accumulate(until)
    before = np.concatenate([[-np.inf], latest[:-1]])
    return np.asarray(before > range_m + beam * length)
