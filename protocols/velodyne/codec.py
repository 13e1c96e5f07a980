"""Velodyne's datagrams: data packets of 1206 bytes and position packets of 512, many at once as arrays.

Belongs here: bytes, rounding, and the words for no return. Not: when a laser fires and where it looks (models, device).
Little-endian. Arrays of P packets, K firings of a packet, L lasers, E echoes of a laser (dual mode: last, strongest).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from protocols.scan import Floats, Scan
from protocols.velodyne.models import BLOCKS, CHANNELS, MODELS, MODES, Mode, Model

Words = NDArray[np.int64]
DATA_BYTES, POSITION_BYTES = 1206, 512
HOUR_US = 3_600_000_000
TURN_CDEG = 36_000
BANKS = np.array((0xEEFF, 0xDDFF, 0xCCFF, 0xBBFF), np.uint16)
"Flag of a block, by the 32 lasers that it has."
WHITE = 100.0
"Reflectivity of a white plate; beyond are retro-reflectors."
CHANNEL = np.dtype([("distance", "<u2"), ("reflectivity", "u1")])
BLOCK = np.dtype([("flag", "<u2"), ("azimuth", "<u2"), ("channels", CHANNEL, CHANNELS)])
PACKET = np.dtype([("blocks", BLOCK, BLOCKS), ("stamp", "<u4"), ("mode", "u1"), ("product", "u1")])
SENTENCE_AT, SENTENCE_BYTES = 206, 128
POSITION = np.dtype(
    {
        "names": ["top", "bottom", "stamp", "pps", "sentence"],
        "formats": ["u1", "u1", "<u4", "u1", f"S{SENTENCE_BYTES}"],
        "offsets": [187, 188, 198, 202, SENTENCE_AT],
        "itemsize": POSITION_BYTES,
    }
)


@dataclass(frozen=True, eq=False)
class Firings:
    """What P packets say."""

    azimuth_cdeg: Words
    "(P, K) of the head when a firing begins; not of every firing on the wire: decoded, those between are interpolated."
    stamp_us: Words
    "(P,) past the hour"
    distance: Words
    "(E, P, K, L) in the model's unit, 0: no return"
    reflectivity: Words
    "(E, P, K, L) 0..100 diffuse, 101..255 retro-reflector"


def encode(model: Model, mode: Mode, firings: Firings) -> NDArray[np.void]:
    """Data packets (P,), the whole slice at once."""
    echoes, count, _, lasers = firings.distance.shape
    groups = firings.distance.shape[2] * lasers // CHANNELS
    used = groups * echoes  # all 12 blocks, but for a VLS-128 in dual mode, that fills 8
    first = np.arange(groups) * CHANNELS // lasers
    packets = np.zeros(count, PACKET)
    blocks = packets["blocks"]
    # unused blocks have the azimuth of the first: velodyne_decoder derives the rate of rotation from the last block
    blocks["azimuth"] = firings.azimuth_cdeg[:, :1] % TURN_CDEG
    blocks["azimuth"][:, :used] = np.repeat(firings.azimuth_cdeg[:, first] % TURN_CDEG, echoes, axis=1)
    blocks["flag"][:, :used] = np.repeat(BANKS[np.arange(groups) * CHANNELS % lasers // CHANNELS], echoes)
    channels = blocks["channels"]
    for name in ("distance", "reflectivity"):
        values = getattr(firings, name).reshape(echoes, count, groups, CHANNELS)
        channels[name][:, :used] = np.moveaxis(values, 0, 2).reshape(count, used, CHANNELS)
    packets["stamp"], packets["mode"], packets["product"] = firings.stamp_us % HOUR_US, MODES[mode], model.product
    return packets


def decode(packets: NDArray[np.void], own: Model | None = None) -> tuple[Model, Mode, Firings] | None:
    """What data packets of one sensor in one mode say; None: unknown model, mode, or mixed.

    `own`: a model with lasers of its own, where it is known that it sends them.
    """
    models = {one.product: one for one in MODELS.values()} | ({} if own is None else {own.product: own})
    modes = {code: name for name, code in MODES.items()}
    kinds = np.unique(packets[["product", "mode"]]) if len(packets) else packets
    if len(kinds) != 1 or int(kinds["product"][0]) not in models or int(kinds["mode"][0]) not in modes:
        return None
    model, mode = models[int(kinds["product"][0])], modes[int(kinds["mode"][0])]
    echoes, count, firings = 1 + (mode == "dual"), len(packets), model.firings(mode)
    groups = firings * model.lasers // CHANNELS
    blocks = packets["blocks"][:, : groups * echoes]
    shape = (count, groups, echoes, CHANNELS)
    values = [
        np.moveaxis(blocks["channels"][name].reshape(shape), 2, 0).reshape(echoes, count, firings, model.lasers)
        for name in ("distance", "reflectivity")
    ]
    heads = blocks["azimuth"][:, ::echoes].astype(np.int64)
    each, between = max(1, model.lasers // CHANNELS), max(1, CHANNELS // model.lasers)
    azimuth = np.repeat(heads[:, ::each], between, axis=1)
    if between > 1 and heads.shape[1] > 1:  # a VLP-16 tells every second firing
        step = (heads[:, -1:] - heads[:, :1]) % TURN_CDEG / (heads.shape[1] - 1)
        azimuth[:, 1::2] += np.rint(step / 2).astype(np.int64)
    return (
        model,
        mode,
        Firings(azimuth % TURN_CDEG, packets["stamp"].astype(np.int64), *(one.astype(np.int64) for one in values)),
    )


def returns(scan: Scan, mode: Mode) -> tuple[Floats, Floats]:
    """Range and intensity (E, n) of the returns that a mode reports; NaN: none. Dual: last, strongest.

    Where both are one echo, the second is the second strongest, or the same again if there is only one.
    """
    range_m, strength = scan.range_m, scan.intensity
    if mode != "dual":
        chosen = _best(range_m, None if mode == "last" else strength, None)[None]
    else:
        strongest, last = _best(range_m, strength, None), _best(range_m, None, None)
        second = _best(range_m, strength, strongest)
        second = np.where(np.isnan(range_m[np.arange(len(range_m)), second]), strongest, second)
        chosen = np.stack((last, np.where(strongest == last, second, strongest)))
    beams = np.arange(len(range_m))
    return range_m[beams, chosen], strength[beams, chosen]


def _best(range_m: Floats, strength: Floats | None, without: Words | None) -> Words:
    """Which echo of each beam is the strongest (the last one: no `strength`), or the first where there is none."""
    echoes = np.arange(range_m.shape[1])
    value = np.broadcast_to(echoes, range_m.shape) if strength is None else np.where(np.isnan(strength), 0.0, strength)
    none = np.isnan(range_m)
    if without is not None:
        none |= without[:, None] == echoes
    found: Words = np.where(none, -1.0, value).argmax(axis=1)
    return found


def distances(range_m: Floats, unit_mm: int) -> Words:
    """Words of ranges; what the wire cannot say is no return."""
    words = np.rint(range_m * (1000.0 / unit_mm))
    return np.where((words > 0.0) & (words <= 0xFFFF), words, 0.0).astype(np.int64)  # false for NaN


def encode_position(stamp_us: int, pps: int, sentence: bytes, top_c: int = 0, bottom_c: int = 0) -> bytes:
    """A position packet; temperatures are 0 on older firmware."""
    packet = np.zeros(1, POSITION)
    packet["stamp"], packet["pps"], packet["sentence"] = stamp_us % HOUR_US, pps, sentence
    packet["top"], packet["bottom"] = top_c, bottom_c
    return packet.tobytes()
