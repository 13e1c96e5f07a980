"""All compiled functions, by name. Nothing else belongs here."""

from emulator.compiled.casting import inner, resting, told
from emulator.compiled.clusters import crossed, joined, split, sums
from emulator.compiled.maxima import edges, maxima
from emulator.compiled.media import crossed_under, ended_under, under
from emulator.compiled.moving import extent, keep_nearer, moving, pairs
from emulator.compiled.packets import Packets, library
from emulator.compiled.surfaces import in_order, keys, lit, repeated
from emulator.compiled.waves import sampled

__all__ = [
    "Packets",
    "crossed",
    "crossed_under",
    "edges",
    "ended_under",
    "extent",
    "in_order",
    "inner",
    "joined",
    "keep_nearer",
    "keys",
    "library",
    "lit",
    "maxima",
    "moving",
    "pairs",
    "repeated",
    "resting",
    "sampled",
    "split",
    "sums",
    "told",
    "under",
]
