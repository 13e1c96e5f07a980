"""Whether a beam's probes do for what it sees through a pane, and in it: the same smooth surfaces by every probe.

Belongs here: what continued rays meet, by the way that they took, and what of it is smooth. Not: their paths (paths),
surfaces that are met first (probing).
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from emulator.physics.arrays import Bools, Floats, Ints, indexes
from emulator.sensing import strips
from emulator.sensing.model import SensorModel

MOST_STRIPS = 2
"Of surfaces whose probes stand for as many: these are right to the third degree in the place on the disc, as two are."


@dataclass(eq=False)
class Ways:
    """What rays met that go on from panes and mirrors, bounce by bounce."""

    beam: list[Ints] = field(default_factory=list)
    way: list[Ints] = field(default_factory=list)
    "Which branches were taken; those of one beam that took the same have the same number."
    whole: list[Floats] = field(default_factory=list)
    "(2, m) length of the whole way and amplitude; infinite: nothing was met within reach."
    what: list[NDArray[np.int32]] = field(default_factory=list)
    "(2, m) material and actor."

    def note(self, beam: Ints, way: Ints, hits: Any, met: Ints, length_m: Floats, light: Floats) -> None:
        """Those of one bounce; lengths and amplitudes are of those that have `met` something within reach."""
        whole, what = np.full((2, len(beam)), np.inf), np.full((2, len(beam)), -1, np.int32)
        whole[0, met], whole[1, met] = length_m, light
        what[:, met] = hits.material[met], hits.actor[met]
        self.beam.append(beam)
        self.way.append(way)
        self.whole.append(whole)
        self.what.append(what)

    def smooth(self, first_m: Floats, light: Floats, places: Floats, step_m: float, model: SensorModel) -> Bools:
        """(n,) beams whose probes do; ranges (n, k) of the panes, amplitudes (n,) of these, places (3, k)."""
        n, k = first_m.shape
        good, whose, lengths, lights = np.ones(n, bool), [np.arange(n)], [first_m], [light]
        for beam, way, sizes, what in zip(self.beam, self.way, self.whole, self.what, strict=True):
            number = beam * (way.max(initial=0) + 1) + way
            order = np.argsort(number, kind="stable")
            number, beam = number[order], beam[order]
            start = indexes(np.concatenate([[True], number[1:] != number[:-1]])[: len(beam)])
            whole = np.diff(start, append=len(beam)) == k
            good[beam[start[~whole]]] = False
            start = start[whole]
            rays, of = order[start[:, None] + np.arange(k)], beam[start]
            kinds, length = what[:, rays], sizes[0][rays]
            same = (kinds == kinds[:, :, :1]).all(axis=2).all(axis=0)
            good[of[~same]] = False
            seen = indexes(same & np.isfinite(length[:, 0]))
            if len(seen):
                whose.append(of[seen])
                lengths.append(length[seen])
                lights.append(sizes[1][rays[seen]].sum(axis=1))
        fine = _even(np.concatenate(lengths), np.concatenate(lights), places, step_m, model)
        good[np.concatenate(whose)[~fine]] = False
        return good


def _even(range_m: Floats, light: Floats, places: Floats, step_m: float, model: SensorModel) -> Bools:
    """(n,) ranges (n, k) of one smooth surface, of which a few strips would do."""
    inverse = places[0] / range_m
    slopes = (inverse @ places[1:].T) / float((places[1] * places[1]).sum())
    away = range_m - places[0] / (inverse.mean(axis=1, keepdims=True) + slopes @ places[1:])
    lead = np.maximum(range_m[:, 0] - range_m.min(axis=1), 0.0)
    count = strips.counts(lead, light, strips.law(model))
    return np.asarray((np.abs(away).max(axis=1, initial=0.0) <= step_m) & (count > 0) & (count <= MOST_STRIPS))
