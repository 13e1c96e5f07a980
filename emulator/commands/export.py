"""`lidaremu export`: point clouds of a recording for other tools."""

from __future__ import annotations

import json
from pathlib import Path

import click
import numpy as np

from emulator import __version__
from emulator.commands.common import OK, Finite
from emulator.output.lines import note, say


@click.command()
@click.argument("recording", type=click.Path(path_type=Path))
@click.option(
    "--to",
    "out",
    required=True,
    type=click.Path(path_type=Path),
    metavar="FILE",
    help="Ends in .pcd, .ply, .las or .pcap.",
)
@click.option("--sensor", metavar="ID", help="Of this sensor alone.")
@click.option(
    "--frame",
    type=click.Choice(("world", "sensor")),
    default="world",
    show_default=True,
    help="world: by the pose of the sensor at the instant of each beam; sensor: as the sensor sees them.",
)
@click.option("--from", "from_s", type=Finite(0.0, 1e9), default=0.0, metavar="S", help="From this instant of the run.")
@click.option("--until", "until_s", type=Finite(0.0, 1e9), default=1e9, metavar="S", help="Before this instant.")
@click.option("--first", "first_only", is_flag=True, help="Only the nearest echo of each beam.")
@click.option("--json", "as_json", is_flag=True, help="One JSON object.")
def export(
    recording: Path,
    out: Path,
    sensor: str | None,
    frame: str,
    from_s: float,
    until_s: float,
    first_only: bool,
    as_json: bool,
) -> int:
    """Write the measured points of a RECORDING of lidaremu to a file: PCD, PLY or LAS. Columns: x, y, z [m], time in
    the run [s], intensity (peak over the detection threshold), actor (ground truth: its index, 0 world, -1 none),
    sensor, ring (layer, 0 the lowest), echo (0 the nearest). Ranges are those measured, before the device rounds them.

    A .pcap has the datagrams as they were sent, in Ethernet frames, for players and decoders that read no pcapng.
    """
    from emulator.recording import cloud_files, clouds, pcap
    from emulator.recording.reader import read_run

    if from_s >= until_s:
        raise click.BadParameter(f"{until_s:g}; want an instant after --from {from_s:g}", param_hint="--until")
    clouds.check_file(out, (*cloud_files.WRITERS, ".pcap"))
    run = read_run(recording)
    if run.cut:
        note(f"{recording}: truncated: {run.cut}; points before that are written")
    if out.suffix.lower() == ".pcap":
        if (from_s, until_s, first_only) != (0.0, 1e9, False):
            raise click.UsageError("a .pcap has all datagrams; want it without --from, --until and --first")
        count = pcap.write(out, [one for one in run.sent.values() if sensor in (None, one.sensor)])
        say(json.dumps({"file": str(out), "datagrams": count}) if as_json else f"{out}: {count} datagrams")
        return OK
    names = clouds.chosen(run, sensor)
    if frame == "sensor" and len(names) > 1:
        raise click.BadParameter(f"none; want one of {', '.join(names)} with --frame sensor", param_hint="--sensor")
    where = clouds.where_of(run)
    poses = where if frame == "world" else None
    parts = []
    for name in names:
        if any(one is None for one in run.offsets.get(name, [])):
            note(f"{recording}: {name}: no firing times of beams in some scans; their points have the scan's instant")
        number = where.sensors.index(name)
        parts.append(clouds.points_of(run, name, number, poses, from_s, until_s, first_only))
    points = np.concatenate(parts)
    cloud_files.write(out, points, f"lidaremu {__version__}")
    actors = {int(index): where.scene.actors[index] for index in np.unique(points["actor"]) if index >= 0}
    if as_json:
        sensors = {where.sensors.index(name): name for name in names}
        say(json.dumps({"file": str(out), "points": len(points), "actors": actors, "sensors": sensors}))
        return OK
    say(f"{out}: {len(points)} points of {', '.join(names)}")
    for index, name in actors.items():
        say(f"  actor {index}: {name}, {int(np.count_nonzero(points['actor'] == index))} points")
    return OK
