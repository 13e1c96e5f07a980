"""Point clouds out of a recording: every echo of a time as rows of one table, with the truth about each.

Belongs here: rows, frames, layers. Not: the formats that they are written in (cloud_files).
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from emulator.recording.folder import RecordingError
from emulator.recording.layout import RecordedScan
from emulator.recording.reader import RecordedRun
from emulator.recording.whereabouts import Whereabouts
from emulator.scenario import scenario as scenario_file
from emulator.world.feed_record import Played
from protocols.scan import Floats

POINT = np.dtype(
    [
        ("x", "<f8"),
        ("y", "<f8"),
        ("z", "<f8"),
        ("time", "<f8"),
        ("intensity", "<f4"),
        ("actor", "<i4"),
        ("sensor", "<u2"),
        ("ring", "<u2"),
        ("echo", "u1"),
    ]
)
"""Position in the frame [m]; instant of the beam in the run [s]; peak over the detection threshold; index of the actor
hit, 0 world, -1 none; number of the sensor in the scenario; layer, 0 the lowest; echo of the beam, 0 the nearest."""
MOST_POINTS = 100_000_000
"5 GB of memory at their widest; more is refused with a shorter time to ask for."
MOST_LAYERS = 1024
"A sensor with more elevations has no layers, as one whose beams draw a rosette: its points are all in layer 0."
SAME_LAYER_RAD = 1e-5
"Elevations are recorded as float32: those nearer to each other are one layer."
Points = NDArray[np.void]


def where_of(run: RecordedRun) -> Whereabouts:
    """Poses of the recorded scenario, of a fed one too. Raises `RecordingError`, `ScenarioError`."""
    if not run.scenario:
        raise RecordingError(f"{run.path}: no scenario in it; it is truncated within its first bytes")
    loaded = scenario_file.loads(run.scenario, run.path.parent / "scenario.yaml")
    return Whereabouts(loaded, None if loaded.live is None else Played(loaded, run.path).world)


def layers(scans: list[RecordedScan]) -> Floats:
    """Elevations of a sensor's layers, from the lowest; none of a sensor without layers. [rad]"""
    found = np.zeros(0)
    for scan in scans:
        if scan.elevation_rad is not None:
            found = np.unique(np.concatenate((found, scan.elevation_rad)))
            found = found[np.diff(found, prepend=-np.inf) > SAME_LAYER_RAD]
            if len(found) > MOST_LAYERS:
                return np.zeros(0)
    return found


def points_of(
    run: RecordedRun, sensor: str, number: int, where: Whereabouts | None, from_s: float, to_s: float, first_only: bool
) -> Points:
    """Echoes of a sensor's beams that fired from `from_s` to before `to_s`, in order of the sweeps.

    `where`: in the world, by the sensor's pose at each beam's own instant; None: in the sensor's frame. Raises
    `RecordingError` when they are too many.
    """
    scans = run.scans.get(sensor, [])
    heights, parts, total = layers(scans), [np.zeros(0, POINT)], 0
    offsets = run.offsets.get(sensor, [])
    for place, scan in enumerate(scans):
        fire_s = offsets[place] if place < len(offsets) else None
        rows = _rows(scan, heights, fire_s, first_only)
        rows = rows[(rows["time"] >= from_s) & (rows["time"] < to_s)]
        if not len(rows):
            continue
        rows["sensor"] = number
        if where is not None:
            own = np.stack([rows["x"], rows["y"], rows["z"]], axis=1)
            rows["x"], rows["y"], rows["z"] = where.sensor(sensor, rows["time"]).to_world(own).T
        parts.append(rows)
        total += len(rows)
        if total > MOST_POINTS:
            raise RecordingError(
                f"{run.path}: more than {MOST_POINTS} points; want a shorter time, see --from and --until"
            )
    return np.concatenate(parts)


def _rows(scan: RecordedScan, heights: Floats, fire_s: Floats | None, first_only: bool) -> Points:
    ranges = scan.range_m[:, :1] if first_only else scan.range_m
    beam, echo = np.nonzero(np.isfinite(ranges))
    elevation = np.zeros(len(scan.azimuth_rad)) if scan.elevation_rad is None else scan.elevation_rad
    rows = np.zeros(len(beam), POINT)
    rows["x"], rows["y"], rows["z"] = scan.points(beam, ranges[beam, echo]).T
    rows["time"] = scan.start_ns * 1e-9 + (0.0 if fire_s is None else fire_s[beam])
    rows["intensity"], rows["actor"] = scan.intensity[beam, echo], scan.actor[beam, echo]
    ring = np.searchsorted(heights, elevation[beam] + 0.5 * SAME_LAYER_RAD, side="right") - 1
    rows["ring"], rows["echo"] = np.clip(ring, 0, 0xFFFF), np.minimum(echo, 255)
    return rows


def chosen(run: RecordedRun, sensor: str | None) -> list[str]:
    """Sensors that have scans in a recording, or the one asked for. Raises `RecordingError`."""
    known = sorted(name for name, scans in run.scans.items() if scans)
    if sensor is None:
        if not known:
            raise RecordingError(f"{run.path}: no scans in it; want a recording with record.truth")
        return known
    if sensor not in known:
        raise RecordingError(f"{run.path}: sensor {sensor!r}; want {', '.join(known) or 'a recording with scans'}")
    return [sensor]


def check_file(path: Path, kinds: tuple[str, ...]) -> None:
    """Raise `RecordingError` for a file that cannot be: before the work."""
    if path.suffix.lower() not in kinds:
        raise RecordingError(f"{path}: {path.suffix or 'no suffix'}; want a file that ends in {', '.join(kinds)}")
    if path.is_dir() or not path.absolute().parent.is_dir():
        raise RecordingError(f"{path}; want a file in an existing folder")
