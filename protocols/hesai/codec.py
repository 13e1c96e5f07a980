"""Hesai's datagrams: point-cloud packets of all models, many at once as arrays; GPS packets and fault messages.

Belongs here: bytes, rounding, checks, and the words for no return. Not: when a laser fires and where it looks (models,
device). Arrays of P packets, B blocks of a packet, L lasers, E echoes of a firing. Little-endian, but for what is
marked.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta

import numpy as np
from numpy.typing import NDArray

from protocols.checksums import crc32_mpeg2
from protocols.hesai.models import MODELS, Model
from protocols.scan import Floats, Scan

Words = NDArray[np.int64]
TURN_CDEG = 36_000
FINE = 256
"Parts of 0.01 deg in an azimuth here, and on the wire of an AT128."
FACTORY = 0x42
GPS_BYTES, FAULT_BYTES = 512, 99
BLOCKED, NOTHING = 1, 3
"Distances of an OT128 that watches for blockage: a target at the window; fired, and nothing received."
REFRESH_NS = 5_000_000
"Of the functional safety's message."
SIGNED = 8
"Flag of a header."
IMU_TICK_NS = 25_000


@dataclass(frozen=True, eq=False)
class Packets:
    """What P packets say."""

    azimuth: Words
    "(P, B) of the rotor or the mirror, 1/256 of 0.01 deg."
    distance: Words
    "(P, B, L) in the model's unit; 0: no return."
    reflectivity: Words
    "(P, B, L) percent, up to 255."
    utc_ns: Words
    "(P,) since 1970, of the time stamp."
    sequence: Words
    "(P,)"
    mode: int
    "Its code, as in the configuration."
    rpm: int
    states: Words | None = None
    "(P, B)"
    operation: int = 0
    safety: NDArray[np.uint8] | None = None
    "(P, 17)"
    felt: tuple[Floats, Floats] | None = None
    "Specific force and rate (3,) in the sensor's frame, ISO 8855; None: at rest and level. [m/s^2, rad/s]"
    felt_ns: int = 0
    "When, by the device's clock."
    shutdown: bool = False
    signed: bool = False
    "With a signature, of zeros; models of 128 lasers."
    fourth: int = 0xFF
    "Fourth byte of a channel: reserved, background or confidence."


def encode(model: Model, said: Packets) -> list[bytes]:
    """Point-cloud packets."""
    layout, (_, code, echoes) = model.layout, model.returns(said.mode)
    packets = np.zeros(len(said.sequence), model.dtype)
    if layout.head:
        head = bytearray(layout.head)
        head[8], head[10] = layout.first_block if echoes == 1 else 1, echoes
        head[11] |= said.signed * SIGNED
        packets["head"] = np.void(bytes(head))
    blocks = packets["blocks"]
    if layout.mark:
        blocks["mark"] = np.void(layout.mark)
    if layout.fine:
        blocks["azimuth"], blocks["fine"] = said.azimuth // FINE % TURN_CDEG, said.azimuth % FINE
    else:
        blocks["azimuth"] = (said.azimuth + FINE // 2) // FINE % TURN_CDEG
    blocks["channels"]["distance"] = said.distance
    blocks["channels"]["reflectivity"] = said.reflectivity
    if "fourth" in (layout.channel.names or ()):
        blocks["channels"]["fourth"] = said.fourth
    told = {
        "mode": code, "rpm": said.rpm, "factory": FACTORY, "utc": _calendar(said.utc_ns, layout.year),
        "us": said.utc_ns // 1000 % 1_000_000, "sequence": said.sequence & 0xFFFFFFFF, "shutdown": said.shutdown,
        "operation": said.operation, "safety": said.safety,
        "states": None if said.states is None else (said.states << (14 - 2 * np.arange(layout.blocks))).sum(axis=1),
        "imu": _imu(said) if "imu" in layout.places else None,
    }  # fmt: skip
    for name in layout.places:
        if told[name] is not None:
            packets[name] = told[name]
    data = bytearray(packets.tobytes())
    view = memoryview(data)
    for first in range(0, len(data), layout.size):
        for begin, end in layout.checks:
            check = crc32_mpeg2(view[first + begin : first + end])
            data[first + end : first + end + 4] = check.to_bytes(4, "little")
    signature = bytes(32) if said.signed else b""
    return [bytes(view[first : first + layout.size]) + signature for first in range(0, len(data), layout.size)]


def _calendar(utc_ns: Words, year: int) -> NDArray[np.uint8]:
    """(P, 6) date and time; of each second once."""
    seconds, places = np.unique(utc_ns // 1_000_000_000, return_inverse=True)
    if year == 0:
        rows = [b"\0" + int(one).to_bytes(5, "big") for one in seconds]
    else:
        rows = [bytes((when.year - year & 0xFF, *when.timetuple()[1:6])) for when in map(moment, seconds * 10**9)]
    found: NDArray[np.uint8] = np.frombuffer(b"".join(rows), np.uint8).reshape(-1, 6)[places]
    return found


def moment(utc_ns: int) -> datetime:
    """A time since 1970."""
    return datetime(1970, 1, 1, tzinfo=UTC) + timedelta(microseconds=int(utc_ns) // 1000)


IMU = np.dtype([("temperature", "<i2"), ("units", "<u2", 2), ("ticks", "<u4"), ("force", "<i2", 3), ("rate", "<i2", 3)])
IMU_UNITS = 122, 305
"Micro-g and 1e-5 deg/s of a count."
IMU_CDEG = 3500
"Its temperature, 0.01 C."
G = 9.80665


def _imu(said: Packets) -> NDArray[np.uint8]:
    """(22,) of the unit in the sensor; without noise, as no figures are published."""
    found = np.zeros(1, IMU)
    force, rate = said.felt if said.felt is not None else (np.array((0.0, 0.0, G)), np.zeros(3))
    found["temperature"], found["units"], found["ticks"] = IMU_CDEG, IMU_UNITS, said.felt_ns // IMU_TICK_NS % (1 << 32)
    for name, value, unit in (
        ("force", force / G, 1e-6 * IMU_UNITS[0]),
        ("rate", np.degrees(rate), 1e-5 * IMU_UNITS[1]),
    ):
        turned = np.array((-value[1], value[0], value[2]))  # the maker's x is to the right, y ahead
        found[name] = np.clip(np.rint(turned / unit), -0x8000, 0x7FFF)
    return found.view(np.uint8)


def safety(own_ns: Words, state: int, codes: Sequence[int] = (), past: bool = False) -> NDArray[np.uint8]:
    """(P, 17) functional safety at instants of the device: every 5 ms the next message, with the next fault code."""
    refreshes, places = np.unique(own_ns // REFRESH_NS, return_inverse=True)
    rows = b"".join(_safety(int(one), state, codes, past) for one in refreshes)
    found: NDArray[np.uint8] = np.frombuffer(rows, np.uint8).reshape(-1, 17)[places]
    return found


def _safety(refresh: int, state: int, codes: Sequence[int], past: bool) -> bytes:
    index = refresh % len(codes) if codes else 0
    kind = (2 if past else 1) if codes else 0
    body = bytes((state << 5 | kind << 3 | refresh & 7, len(codes) << 4 | (index + 1 if codes else 0)))
    body += (codes[index] if codes else 0).to_bytes(2, "little") + bytes(8)
    return b"\x01" + body + crc32_mpeg2(body).to_bytes(4, "little")


def returns(scan: Scan, picks: tuple[str, ...]) -> tuple[Floats, Floats]:
    """Range and intensity (E, n) of these returns: `first`, `last`, `strongest`; NaN: none.

    Where both of a pair are one echo, the strongest is the second strongest instead, or the same again if there is
    only one.
    """
    there, beams = ~np.isnan(scan.range_m), np.arange(len(scan.range_m))
    power = np.where(there, scan.intensity, -1.0) if "strongest" in picks else there
    found: dict[str, Words] = {}
    for pick in sorted(picks):  # the strongest after the other one of a pair
        place = np.zeros(len(beams), np.int64)
        if pick == "strongest" and len(picks) == 2:
            other, several = next(iter(found.values())), np.count_nonzero(there, axis=1) > 1
            alone = several & (np.argmax(power, axis=1) == other)
            power[beams[alone], other[alone]] = -1.0
        for echo in range(there.shape[1]):  # by columns: the few echoes of many beams
            if pick == "strongest":
                better = power[:, echo] > power[beams, place]
            else:
                better = there[:, echo] & (True if pick == "last" else ~there[beams, place])
            place[better] = echo
        found[pick] = place
    places = np.stack([found[one] for one in picks])
    return scan.range_m[beams, places], scan.intensity[beams, places]


def distances(range_m: Floats, unit_mm: int) -> Words:
    """Words of ranges; what the wire cannot say is no return."""
    words = np.rint(range_m * (1000.0 / unit_mm))
    return np.where((words > 0.0) & (words <= 0xFFFF), words, 0.0).astype(np.int64)


def reflectivities(range_m: Floats, intensity: Floats, white_m2: float) -> Words:
    """Percent of a diffuse white plate seen straight, linear, up to 255; 0: none.

    intensity over the threshold; its decrease with the distance is removed, that with air and incidence is not.
    """
    percent = np.nan_to_num(100.0 * intensity * range_m * range_m / white_m2, nan=0.0)
    return np.rint(np.clip(percent, 0.0, 255.0)).astype(np.int64)


@dataclass(frozen=True, eq=False)
class Read:
    """What packets of one sensor say, for a host."""

    model: Model
    mode: int
    azimuth_deg: Floats
    "(P, B)"
    distance: Words
    "(P, B, L)"
    reflectivity: Words
    us: Words
    "(P,)"
    sequence: Words
    "(P,)"
    rpm: int
    states: Words
    "(P, B)"
    high: bool


def decode(data: bytes) -> Read | None:
    """Whole packets of one sensor in one mode, one after the other; None: unknown, damaged or mixed."""
    model = model_of_packet(data)
    if model is None or len(data) % model.layout.size:
        return None
    packets = np.frombuffer(data, model.dtype)
    codes = {model.returns(mode)[1]: mode for mode in model.modes}
    layout, mode = model.layout, codes.get(int(packets["mode"][0]))
    if mode is None or (packets["mode"] != packets["mode"][0]).any() or (packets["factory"] != FACTORY).any():
        return None
    if layout.head and (packets["head"] != packets["head"][0]).any():
        return None
    blocks = packets["blocks"]
    azimuth = blocks["azimuth"] / 100.0 + (blocks["fine"] / (100.0 * FINE) if layout.fine else 0.0)
    channels = blocks["channels"]
    states, high = np.zeros(azimuth.shape, np.int64), False
    if "states" in layout.places:
        states = packets["states"].astype(np.int64)[:, None] >> (14 - 2 * np.arange(layout.blocks)) & 3
        high = int(packets["operation"][0]) == 0
        states %= len(model.high_ns if high else model.laser_ns)
    return Read(
        model,
        mode,
        np.asarray(azimuth, np.float64),
        channels["distance"].astype(np.int64),
        channels["reflectivity"].astype(np.int64),
        packets["us"].astype(np.int64),
        packets["sequence"].astype(np.int64),
        int(packets["rpm"][0]),
        states,
        high,
    )


def size_of_packet(data: bytes) -> int | None:
    """Bytes of the packet that begins so; None: none does."""
    model = model_of_packet(data)
    if model is None or (model.layout.head and data[6:8] != model.layout.head[6:8]):
        return None
    return model.layout.size + (32 if "safety" in model.layout.places and data[11] & SIGNED else 0)


def model_of_packet(data: bytes) -> Model | None:
    """The model that sends packets which begin so; None: none."""
    if data[:2] == b"\xff\xee" and data[124:126] == b"\xff\xee":
        return MODELS["hesai-pandar40p"]
    for model in MODELS.values():
        head = model.layout.head
        if head and data[:4] == head[:4] and data[6:8] == head[6:8] and (data[4] >= 128) == (head[4] >= 128):
            return model
    return None


def encode_gps(utc_ns: int, us: int, sentence: bytes, status: bytes, locked: bool, wide: bool) -> bytes:
    """A GPS packet. `wide`: 100 bytes for the sentence, as models of the XT have."""
    when = f"{moment(utc_ns):%y%m%d%H%M%S}"
    date, time = when[:6], when[6:]
    text = "".join(date[at : at + 2][::-1] for at in (0, 2, 4)) + "".join(time[at : at + 2][::-1] for at in (4, 2, 0))
    data = b"\xff\xee" + text.encode() + us.to_bytes(4, "little") + sentence.ljust(100 if wide else 84, b"\0")
    return data.ljust(506, b"\xdf") + status[:1].ljust(1, b"\0") + bytes((locked,)) + bytes(4)


def encode_fault(
    utc_ns: int, operate: int, state: int, codes: Sequence[int], counter: int, dirt: int, hot: bool
) -> bytes:
    """A fault message of an AT128, with the next fault code; `dirt` of the lens: 0 clean, 1 passable, 3 blocked."""
    at = counter % len(codes) if codes else 0
    body = b"\xcd\xdc\x04\0\0" + (utc_ns // 10**9 & 0xFFFFFFFF).to_bytes(4, "big")
    body += (utc_ns // 1000 % 10**6).to_bytes(4, "big")
    body += bytes((operate, state, bool(codes), counter & 0xFF, len(codes), at + 1 if codes else 0))
    body += (codes[at] if codes else 0).to_bytes(4, "big")
    areas = sum(dirt << 2 * at for at in range(8)).to_bytes(2, "little")
    body += b"\x01" + (350).to_bytes(2, "little") + areas * 12 + bytes(8) + bytes((0, hot)) + bytes(3)
    return body + crc32_mpeg2(body[2:]).to_bytes(4, "little") + bytes(32)
