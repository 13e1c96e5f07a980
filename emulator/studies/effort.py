"""How much work a study puts into its numbers."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Effort:
    """Counts that trade run time for accuracy."""

    wire_sub_beams: int = 4096
    "Sub-beams where a target is thinner than the beam: 1.5 % of its share at a tenth of the beam's radius."
    curve_points: int = 24
    "Ranges of a curve that are measured through the whole path."
    phases: int = 100
    "Equally spaced positions of the beam grid over which points are averaged: each edge is right to one of them."
    every: int = 1
    "Of the ranges of figure 6 and of the rows of the weather tables, only each n-th is measured."


FULL = Effort()
QUICK = Effort(wire_sub_beams=1024, curve_points=8, phases=20, every=3)
