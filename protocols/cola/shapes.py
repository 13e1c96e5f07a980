"""Beams of a scan, those of them in a telegram, and telegrams that are not sent, at the settings of a moment.

Belongs here: geometry and choice by the variables that hosts write. Not: instants (session), echoes (filters).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import numpy as np

from protocols.cola import filters
from protocols.cola.layouts import WIDEST_STEP, Angles, Content
from protocols.cola.models import Pair
from protocols.cola.settings import Settings
from protocols.skeleton.sweeps import Sweep

TICK_NS = Fraction(1000)


@dataclass(frozen=True)
class Shape:
    """One turn of the mirror at the present settings."""

    sweep: Sweep
    sent: slice
    "Of the beams measured, those in a telegram."
    start: int
    step: int
    "Of these, as the telegram has it."


@dataclass(frozen=True)
class Setup:
    """Variables and scan configuration of a device."""

    settings: Settings
    values: Mapping[str, Any]
    pair: Pair

    @property
    def content(self) -> Content:
        """LMDscandatacfg."""
        return Content(*self.values["LMDscandatacfg"])

    @property
    def scale(self) -> float:
        """LMDscandatascalefactor: millimetres of a distance count."""
        found: float = self.values.get("LMDscandatascalefactor", [1.0])[0]
        return found

    def filters(self) -> filters.Filters:
        """How the filters are set."""
        values = self.values
        usual = [filters.ALL if self.content.channels & 0b11110 else filters.FIRST]
        particle, threshold = values["LFPparticle"]
        mean, angles = values.get("LFPmeanfilter", [0, 1, 0]), values.get("LFPangleRangeFilter", [0])
        return filters.Filters(
            echo=values.get("FREchoFilter", usual)[0],
            fog=self.settings.fog,
            edge_m=self.settings.edge_m if self.settings.model.series == "mrs" else 0.0,
            angles=Angles(*angles) if angles[0] else None,
            particle_m=threshold / 1000.0 if particle else None,
            median=values.get("LFPmedianfilter", [0])[0] == 1,
            mean=mean[1] if mean[0] else 1,
        )

    def encoders(self, since_power_ns: int) -> tuple[tuple[int, int], ...]:
        """Position in ticks and speed in mm/s; an encoder of one channel has no sign."""
        mode = self.values.get("LICencset", [0])[0]
        if not self.content.encoder or not mode:
            return ()
        speed = abs(self.settings.encoder_mm_s) if mode == 1 else self.settings.encoder_mm_s
        per_tick_mm = self.values["LICencres"][0]
        ticks = math.floor(speed * since_power_ns * 1e-9 / per_tick_mm)
        return ((ticks & 0xFFFFFFFF, round(abs(speed)) & 0xFFFF),)

    def echoes(self) -> tuple[int, ...]:
        """Echoes in a telegram, the first is 0."""
        count = self.settings.model.echoes if self.filters().echo == filters.ALL else 1
        return tuple(echo for echo in range(count) if self.content.channels >> echo & 1)

    def place(self, number: int) -> tuple[int, int]:
        """Turn of an interlaced sequence, and layer, of the sweep of that number."""
        model = self.settings.model
        return number // model.layers % len(model.starts(self.pair)), number % model.layers

    def shape(self, turn: int, layer: int, whole: bool) -> Shape:
        """The sweep of that turn and layer; `whole`: the field is measured beyond what telegrams have."""
        model, coarse = self.settings.model, self.settings.model.coarse(self.pair)
        start = model.starts(self.pair)[turn]
        count = model.points(self.pair) if model.series == "mrs" else int((model.stop - start) / coarse) + 1
        ((step, first, last),) = self.values["LMPoutputRange"][0]
        low, high = (min(max(round((edge - start) / coarse), 0), count - 1) for edge in (first, last))
        # a TiM thins its points out by the step written here; an LMS ignores it, as drivers write an old one
        every = min(max(1, round(step / coarse)), int(WIDEST_STEP // coarse)) if model.series == "tim" else 1
        sent, beams = slice(low, high + 1, every), np.arange(count)
        if not whole:
            beams, sent = beams[sent], slice(None)
        filtered = self.filters()
        plain = filtered.echo == filters.FIRST and not filtered.fog
        beam_ns = model.beam_ns(self.pair)
        sweep = Sweep(
            azimuth_rad=np.radians((start + beams * float(coarse)) / 1e4 - 90.0),
            elevation_rad=np.full(len(beams), np.radians(-model.layers_cdeg[layer] / 100.0)),
            fire_offset_s=beams.astype(np.float64) * (1e-9 * float(beam_ns)),
            duration_s=1e-9 * count * float(beam_ns),
            max_range_m=65.535 * self.scale,
            max_echoes=1 if plain else model.echoes,
            wants_intensity=bool(self.content.remission & 1) or filtered.fog,
        )
        return Shape(sweep, sent, round(start + low * coarse), round(coarse * every))

    def kept_back(self, number: int) -> bool:
        """A telegram that is not sent: of a layer switched off, or between those that the output interval leaves."""
        layers, on = self.settings.model.layers, self.settings.model.layers_on(self.values)
        return number % layers not in on or number // layers % self.content.interval != 0

    def skipped(self, number: int) -> int:
        """How many sweeps from that number on have no telegram."""
        layers, interval = self.settings.model.layers, self.content.interval
        behind = -(number // layers) % interval
        found = number if not behind else (number // layers + behind) * layers
        while self.kept_back(found):  # layers that are switched off
            found += 1 if (found + 1) % layers else 1 + (interval - 1) * layers
        return found - number
