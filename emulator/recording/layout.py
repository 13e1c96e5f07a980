"""What stands in `run.mcap`: names of channels and schemas, and scans as bytes. Written and read here alone.

Wire      topic /SENSOR/LINK/tx or rx, the bytes as they are; log time: first bit, publish time: last bit;
          channel metadata: sensor, link, kind, url, direction, peer, baud; sequence: sweep + 1 of a scan, else 0
Scans     topic /SENSOR/scan, see `SCAN_LAYOUT`
Clocks    topic /SENSOR/clock, JSON: sweep, true_ns (of the run), device_ns (as the device's clock shows it, not
          wrapped), ticks (as on the wire), tick_ns, bits; of devices that tell a time
Beams     topic /SENSOR/beams, float64 little-endian: instant of each beam after the sweep's start, in seconds; before
          the first sweep that has them, and again when they have changed
Origins   topic /SENSOR/origins, float32 little-endian, x, y, z of each beam: where it begins, in the sensor's frame, in
          metres; before a sweep of other ones than the sweep before; of devices whose beams begin in the origin, none
Events    topic /SENSOR/event, JSON
Metadata  `lidaremu`: version of this layout and of the package; attachment `scenario.yaml`; at the end of a run
          `lidaremu.end`: sensor -> JSON, its counters and lateness
"""

from __future__ import annotations

import json
import struct
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from emulator.config.budgets import loads_json
from emulator.objects.metrics import ListedScan
from protocols.scan import DetectedObject, Floats, Ints, Scan, points_of

VERSION = 1
FILE_NAME = "run.mcap"
META_NAME = "lidaremu"
WIRE_ENCODING, SCAN_ENCODING, EVENT_ENCODING = "x-lidaremu-wire", "x-lidaremu-scan", "json"
CLOCK_ENCODING = "x-lidaremu-clock"
BEAMS_ENCODING = "x-lidaremu-beams"
ORIGINS_ENCODING = "x-lidaremu-origins"
END_NAME = "lidaremu.end"

SCAN_LAYOUT = """lidaremu scan, version 1, little-endian:
int64 start_ns, int64 sweep, int32 epoch, uint32 n (beams), uint32 k (echoes a beam);
float32 azimuth_rad[n], elevation_rad[n], range_m[n][k], intensity[n][k] (NaN: no echo); int32 actor[n][k]
(index of the actor hit, 0 world, -1 none); uint8 flags[n] (1 dazzled, 2 saturated); rest: JSON list of objects,
of a sensor that lists objects {"objects": [...], "truth": [...]}."""

LEFT_ENCODING = "x-lidaremu-left"
LEFT_LAYOUT = """lidaremu departures, version 1, topic /SENSOR/LINK/left, of runs in real time alone; little-endian,
for each payload: uint64 number (of the messages of /SENSOR/LINK/tx in the order of the file, from 0, whatever their
channel), int64 due_ns (when its last bit should have left), int64 actual_ns (when it had left, at the latest). Log time
and publish time of /SENSOR/LINK/tx are when its first and last bit are due."""
LEFT = np.dtype([("number", "<u8"), ("due_ns", "<i8"), ("actual_ns", "<i8")])

_HEAD = struct.Struct("<qqiII")


@dataclass(frozen=True, eq=False)
class RecordedScan:
    """A scan with its truth, as recorded."""

    start_ns: int
    sweep: int
    epoch: int
    azimuth_rad: Floats
    range_m: Floats
    "(n, k)"
    intensity: Floats
    actor: Ints
    objects: tuple[dict[str, object], ...]
    truth: tuple[dict[str, object], ...] = ()
    "Of a sensor that lists objects: every actor with its pose, speed and visible share."
    elevation_rad: Floats | None = None
    "(n,)"
    origin_m: Floats | None = None
    "(n, 3) where beams begin; None: in the sensor's origin. Ranges count from there."

    def points(self, beam: NDArray[np.integer[Any]], range_m: Floats) -> Floats:
        """(e, 3) where these beams end after so much, in the sensor's frame."""
        elevation = np.zeros_like(self.azimuth_rad) if self.elevation_rad is None else self.elevation_rad
        origin = None if self.origin_m is None else self.origin_m[beam]
        return points_of(self.azimuth_rad[beam], elevation[beam], range_m, origin)

    def begun_at(self, origin_m: Floats | None) -> RecordedScan:
        """With the origins that were recorded for it; those of another number of beams are none of it."""
        return self if origin_m is None or len(origin_m) != len(self.azimuth_rad) else replace(self, origin_m=origin_m)


def encode_scan(scan: Scan) -> bytes:
    """A scan as the data of one message."""
    plan = scan.plan
    n, k = scan.range_m.shape
    parts = [
        _HEAD.pack(plan.start_ns, plan.sweep, plan.epoch, n, k),
        plan.azimuth_rad.astype("<f4").tobytes(),
        plan.elevation_rad.astype("<f4").tobytes(),
        scan.range_m.astype("<f4").tobytes(),
        scan.intensity.astype("<f4").tobytes(),
        scan.actor.astype("<i4").tobytes(),
        scan.flags.astype(np.uint8).tobytes(),
        _objects(scan),
    ]
    return b"".join(parts)


def encode_origins(origin_m: Floats | None) -> bytes:
    """Origins of beams as the data of one message; empty: all in the sensor's."""
    return b"" if origin_m is None else origin_m.astype("<f4").tobytes()


def decode_origins(data: bytes) -> Floats | None:
    """Those of one message; `ValueError` when it is none."""
    return np.frombuffer(data, "<f4").astype(np.float64).reshape(-1, 3) if data else None


def _objects(scan: Scan) -> bytes:
    listed = [_object(item) for item in scan.objects]
    if isinstance(scan, ListedScan):
        return json.dumps({"objects": listed, "truth": [asdict(item) for item in scan.truth]}).encode()
    return json.dumps(listed).encode() if listed else b"[]"


def _object(item: DetectedObject) -> dict[str, object]:
    return {
        "track": item.track,
        "actor": item.actor,
        "category": item.category,
        "position_m": item.position_m,
        "velocity_m_s": item.velocity_m_s,
        "size_m": item.size_m,
        "yaw_rad": item.yaw_rad,
        "age_s": item.age_s,
        "existence": item.existence,
        "coasting_s": item.coasting_s,
    }


def decode_scan(data: bytes) -> RecordedScan:
    """The scan of one message; `ValueError` when it is none."""
    try:
        start_ns, sweep, epoch, n, k = _HEAD.unpack_from(data)
        if len(data) < _HEAD.size + n * (9 + 12 * k):
            raise ValueError(f"{len(data)} bytes for {n} beams of {k} echoes")
        at = _HEAD.size
        fields = []
        for count, kind in ((n, "<f4"), (n, "<f4"), (n * k, "<f4"), (n * k, "<f4"), (n * k, "<i4")):
            fields.append(np.frombuffer(data, kind, count, at))
            at += 4 * count
        rest = loads_json(data[at + n :])
    except (struct.error, UnicodeDecodeError, json.JSONDecodeError) as error:
        raise ValueError(f"not a recorded scan: {error}") from None
    objects, truth = (rest.get("objects", ()), rest.get("truth", ())) if isinstance(rest, dict) else (rest, ())
    with np.errstate(invalid="ignore"):  # damaged bytes may be a NaN that signals
        azimuth, elevation, range_m, intensity = (field.astype(np.float64) for field in fields[:4])
    actor = fields[4].astype(np.int32).reshape(n, k)
    ranges, peaks = range_m.reshape(n, k), intensity.reshape(n, k)
    return RecordedScan(start_ns, sweep, epoch, azimuth, ranges, peaks, actor, tuple(objects), tuple(truth), elevation)
