"""Counters of single photons that are blind after a count: dead time, afterpulses, many cells.

Here: closed forms for steady light, and histograms of pulses by a chain over the bins. Not here: the first photon of a
pulse alone (photons).

References
----------
G. F. Knoll, Radiation Detection and Measurement, 4th ed., ch. 4.VII: both laws of dead time. J. W. Mueller, Nucl.
Instrum. Methods 112 (1973) 47: spread of the counts. S. Cova et al., IEEE Electron Device Lett. 12 (1991) 685: trapping
and afterpulses of avalanche diodes.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from emulator.physics.arrays import Floats, Values, exp_or_zero, floats

Take = Callable[[Floats, Floats], Floats]


def rate_non_paralysable(rate_hz: Values, dead_s: Values) -> Floats:
    """Counts a second when each blinds for the dead time: r/(1 + r d)."""
    return floats(rate_hz) / (1.0 + floats(rate_hz) * dead_s)


def rate_paralysable(rate_hz: Values, dead_s: Values) -> Floats:
    """Counts a second when every photon prolongs the dead time: r exp(-r d); at most 1/(e d)."""
    return floats(rate_hz) * exp_or_zero(-floats(rate_hz) * dead_s)


def afterpulse_after_dead_time(probability: Values, dead_s: Values, trap_s: Values) -> Floats:
    """Probability that a trap is filled and releases its carrier only after the dead time: p exp(-d/T)."""
    return floats(probability) * exp_or_zero(-floats(dead_s) / trap_s)


def rate_with_afterpulses(rate_hz: Values, dead_s: Values, probability: Values, trap_s: Values) -> Floats:
    """Counts a second with dead time and afterpulses: x/(1 + x d), x = r/(1 - p exp(-d/T))."""
    x = floats(rate_hz) / (1.0 - afterpulse_after_dead_time(probability, dead_s, trap_s))
    return rate_non_paralysable(x, dead_s)


def fano_non_paralysable(rate_hz: Values, dead_s: Values) -> Floats:
    """Variance over mean of the counts of a long gate: 1/(1 + r d)^2."""
    return (1.0 + floats(rate_hz) * dead_s) ** -2.0


def cells_fired(photoelectrons: Values, cells: Values) -> Floats:
    """Mean cells that a short flash fires: N (1 - exp(-n/N))."""
    return -floats(cells) * np.expm1(-floats(photoelectrons) / cells)


@dataclass(frozen=True)
class DeadTime:
    """Cells that are blind after a count; lengths in bins."""

    dead_bins: float
    paralysable: bool = False
    cells: int = 1
    afterpulse: float = 0.0
    "That a count fills a trap."
    trap_bins: float = 1.0

    @cached_property
    def lasts(self) -> tuple[tuple[int, float], ...]:
        """For how many whole bins behind its own a count blinds, with chances: it may lie anywhere in its bin.

        A bin that is partly blind is so with that chance, so that the mean blind time is exact.
        """

        def area(u: float) -> float:
            return 0.0 if u <= 0.0 else 0.5 * u * u if u <= 1.0 else u - 0.5

        most = int(np.ceil(self.dead_bins)) + 1
        blind = [1.0] + [area(self.dead_bins - k + 1.0) - area(self.dead_bins - k) for k in range(1, most + 1)] + [0.0]
        chances = [(k, blind[k] - blind[k + 1]) for k in range(most + 1)]
        return tuple((k, chance) for k, chance in chances if chance > 1e-12)

    def histogram(self, mean_counts: Floats, shots: int, generator: np.random.Generator | None) -> Floats:
        """Counts of all shots and cells in each bin, drawn, or their mean where there is no generator.

        Parameters
        ----------
        mean_counts : (beams, bins) mean photoelectrons of the bins of one gate, of all cells together
        shots : pulses a beam

        Notes
        -----
        Cells of all shots are alike, so the chain follows how many are ready, blind until a bin, or carry a filled
        trap: exact but for what happens twice within a bin. A cell begins its gate ready.
        """
        take: Take = (lambda n, p: n * p) if generator is None else _drawn(generator)
        beams, bins = mean_counts.shape
        longest = max(k for k, _ in self.lasts)
        plain = np.zeros((longest + 1, beams))  # [i modulo its length]: blind cells, ready again after bin i
        trapped = np.zeros((longest + 1, beams))
        ready, loaded = np.full(beams, float(shots * self.cells)), np.zeros(beams)
        late = float(np.exp(-self.dead_bins / self.trap_bins)) if self.afterpulse > 0.0 else 0.0
        frees = -float(np.expm1(-1.0 / self.trap_bins)) if self.afterpulse > 0.0 else 0.0
        counts = np.zeros((beams, bins))
        chance = -np.expm1(-mean_counts / self.cells)
        for i in range(bins):
            p = chance[:, i]
            hit, seen = take(ready, p), take(loaded, p)
            freed = take(loaded - seen, np.full(beams, frees)) if frees > 0.0 else np.zeros(beams)
            ready, loaded = ready - hit, loaded - seen - freed
            counts[:, i] = hit + seen + freed
            if frees > 0.0:
                # a trap filled now, or one that was not yet empty, outlasts the dead time
                fresh = take(hit + freed, np.full(beams, self.afterpulse * late))
                kept = 1.0 - (1.0 - self.afterpulse * late) * (1.0 - late)
                again = take(seen, np.full(beams, kept))
            else:
                fresh = again = np.zeros(beams)
            gone, held = counts[:, i] - fresh - again, fresh + again
            if self.paralysable and (plain.any() or trapped.any()):
                once_more = take(plain, np.broadcast_to(p, plain.shape))
                anew_held = take(trapped, np.broadcast_to(p, trapped.shape))
                plain, trapped = plain - once_more, trapped - anew_held
                gone, held = gone + once_more.sum(axis=0), held + anew_held.sum(axis=0)
            now = i % (longest + 1)
            ready, loaded = ready + plain[now], loaded + trapped[now]
            plain[now] = trapped[now] = 0.0
            left, left_held, rest = gone, held, 1.0
            for k, share in self.lasts:
                last = k == longest
                part = left if last else take(left, np.full(beams, share / rest))
                part_held = left_held if last else take(left_held, np.full(beams, share / rest))
                left, left_held, rest = left - part, left_held - part_held, rest - share
                if k == 0:
                    ready, loaded = ready + part, loaded + part_held
                else:
                    then = (i + k) % (longest + 1)
                    plain[then] += part
                    trapped[then] += part_held
        return counts


def _drawn(generator: np.random.Generator) -> Take:
    def take(of: Floats, chance: Floats) -> Floats:
        return generator.binomial(np.rint(of).astype(np.int64), np.clip(chance, 0.0, 1.0)).astype(np.float64)

    return take
