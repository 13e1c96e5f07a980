"""All compiled functions, by name. Nothing else belongs here."""

from emulator.compiled.casting import reported, resting, unwritten
from emulator.compiled.clusters import crossed, joined, split, sums
from emulator.compiled.echoes import levels, ranks, readings
from emulator.compiled.falling import falling
from emulator.compiled.hazy import bent, lifted
from emulator.compiled.leaves import leaves
from emulator.compiled.maxima import edges, maxima
from emulator.compiled.media import crossed_under, ended_under
from emulator.compiled.merging import merged
from emulator.compiled.moving import cones, moving, near, pairs
from emulator.compiled.narrow import narrow
from emulator.compiled.packets import Packets, library
from emulator.compiled.receiving import received
from emulator.compiled.remaining import remaining
from emulator.compiled.sheets import beside
from emulator.compiled.strips import strips
from emulator.compiled.surfaces import in_order, special, strengths
from emulator.compiled.tails import bundled, on_rings, shares
from emulator.compiled.tracing import traced
from emulator.compiled.waves import sampled

__all__ = [
    "Packets",
    "bent",
    "beside",
    "bundled",
    "cones",
    "crossed",
    "crossed_under",
    "edges",
    "ended_under",
    "falling",
    "in_order",
    "joined",
    "leaves",
    "levels",
    "library",
    "lifted",
    "maxima",
    "merged",
    "moving",
    "narrow",
    "near",
    "on_rings",
    "pairs",
    "ranks",
    "readings",
    "received",
    "remaining",
    "reported",
    "resting",
    "sampled",
    "shares",
    "special",
    "split",
    "strengths",
    "strips",
    "sums",
    "traced",
    "unwritten",
]
