"""`lidaremu transcript`: the conversation of a recording as text."""

from __future__ import annotations

import json
from pathlib import Path

import click

from emulator.commands.common import OK
from emulator.errors import EmulatorError
from emulator.output.lines import note, say


@click.command()
@click.argument("recording", type=click.Path(path_type=Path))
@click.option("--sensor", help="Of this sensor alone.")
@click.option("--from", "from_s", type=float, default=0.0, metavar="S", help="From this instant of the run on.")
@click.option("--to", "to_s", type=float, default=float("inf"), metavar="S", help="Up to this instant.")
@click.option("--no-scans", is_flag=True, help="Leave out telegrams that carry scans.")
@click.option("--json", "as_json", is_flag=True, help="One JSON object per telegram, with all of its bytes.")
def transcript(recording: Path, sensor: str | None, from_s: float, to_s: float, no_scans: bool, as_json: bool) -> int:
    """Print what host and device said in a RECORDING of lidaremu, decoded, with times: the instant at which a
    telegram's first bit was due, who sent it, its bytes, what they say. A host's bytes have the instant at which they
    came in. Of a run in real time a second column has how many milliseconds later than due the telegram left, and the
    order is that in which telegrams left.
    """
    from emulator.hosts.describe import Speaker
    from emulator.recording.conversation import conversation
    from emulator.recording.reader import read_run
    from emulator.scenario import scenario
    from emulator.sensors.spec import load_spec

    run = read_run(recording)
    known = sorted({name for name, _ in (*run.sent, *run.received)})
    if sensor is not None and sensor not in known:
        raise click.BadParameter(f"{sensor!r}; want one of {', '.join(known) or 'none'}", param_hint="--sensor")
    several = len(known) > 1 and sensor is None
    speakers: dict[str, Speaker] = {}
    try:
        for one in scenario.loads(run.scenario, recording / "scenario.yaml").sensors:
            spec = load_spec(one.model)
            speakers[one.id] = Speaker(spec.family or "", dict(spec.device), dict(one.device))
    except EmulatorError as error:
        note(f"{recording}: the recorded scenario cannot be read, bytes are not decoded: {error.lines[0]}")
    found = conversation(
        run,
        lambda said: (
            sensor in (None, said.wire.sensor)
            and from_s <= said.payload.start_ns * 1e-9 <= to_s
            and not (no_scans and said.payload.sweep is not None)
        ),
    )
    late = any(one.actual_ns is not None for wire in run.sent.values() for one in wire.payloads)
    for said in found:
        speaker = speakers.get(said.wire.sensor, Speaker(""))
        say(json.dumps(said.as_json(speaker)) if as_json else said.reported(speaker, several, late))
    if run.cut:
        note(f"{recording}: truncated: {run.cut}")
    return OK
