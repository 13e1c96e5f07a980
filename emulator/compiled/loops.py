"""All compiled functions, by name. Nothing else belongs here."""

from emulator.compiled.casting import inner, resting, told, unwritten
from emulator.compiled.clusters import crossed, joined, split, sums
from emulator.compiled.echoes import FIRST, LAST, STRONGEST, levels, ranks, readings, reported
from emulator.compiled.falling import falling
from emulator.compiled.maxima import edges, maxima, sources
from emulator.compiled.media import crossed_under, ended_under, under
from emulator.compiled.moving import keep_nearer, moving, near, pairs, whereabouts
from emulator.compiled.packets import Packets, library
from emulator.compiled.surfaces import in_order, repeated, special, strengths
from emulator.compiled.waves import sampled

__all__ = [
    "FIRST",
    "LAST",
    "STRONGEST",
    "Packets",
    "crossed",
    "crossed_under",
    "edges",
    "ended_under",
    "falling",
    "in_order",
    "inner",
    "joined",
    "keep_nearer",
    "levels",
    "library",
    "maxima",
    "moving",
    "near",
    "pairs",
    "ranks",
    "readings",
    "repeated",
    "reported",
    "resting",
    "sampled",
    "sources",
    "special",
    "split",
    "strengths",
    "sums",
    "told",
    "under",
    "unwritten",
    "whereabouts",
]
