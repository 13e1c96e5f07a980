"""`lidaremu probe`: which sensor is behind a port."""

from __future__ import annotations

import json
import sys
from dataclasses import asdict

import click

from emulator.commands.common import OK
from emulator.output.lines import note, say


@click.command()
@click.argument("link")
@click.option("--json", "as_json", is_flag=True, help="One JSON object.")
def probe(link: str, as_json: bool) -> int:
    """Find out which sensor is behind LINK: families and line speeds are tried in turn, and what answers says its name.

    LINK is pty:PATH, serial:DEVICE, tcp:HOST:PORT, socketcand:HOST:PORT/CHANNEL, slcan:PATH or can:INTERFACE:CHANNEL.
    Real devices too: line speed, settings and mode are left as they were, but a stream that was on is stopped.
    Up to 20 s without a reply; then exit code 3.
    """
    from emulator.looking import probe as probing

    found = probing.probe(link, note if sys.stderr.isatty() else lambda text: None)
    say(json.dumps({"link": link} | asdict(found)) if as_json else f"{link}: {found.reported()}")
    return OK
