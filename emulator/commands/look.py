"""`lidaremu look` and `lidaremu demo`: options, and what is printed where."""

from __future__ import annotations

import sys
from pathlib import Path

import click

from emulator.commands.common import LONGEST_S, Finite
from emulator.errors import EmulatorError
from emulator.output.lines import note, say


@click.command()
@click.argument("link")
@click.option(
    "--family", "family_name", default="lms2xx", show_default=True, help="Protocol: lms2xx, ld or can_objects."
)
@click.option("--model", metavar="NAME", help="Format of object lists, as can-ars408 (default: recognised).")
@click.option("--extended", is_flag=True, help="Ask an ARS408 for class, size and existence too (not stored).")
@click.option("--baud", type=int, default=38_400, show_default=True, help="Line speed to ask for (serial).")
@click.option("--listen", is_flag=True, help="Ask for nothing: begin at --baud and show what comes.")
@click.option("--scans", type=click.IntRange(min=1), help="Stop after so many scans or lists.")
@click.option("--duration", type=Finite(0.0, LONGEST_S), metavar="S", help="Stop after so many seconds.")
@click.option("--png", type=click.Path(dir_okay=False, path_type=Path), help="Draw the last scan into FILE.")
@click.option("--csv", type=click.Path(dir_okay=False, path_type=Path), help="Write every scan's points to FILE.")
@click.option("--json", "as_json", is_flag=True, help="One JSON object a scan on standard output; nothing is drawn.")
def look(
    link: str,
    family_name: str,
    model: str | None,
    extended: bool,
    baud: int,
    listen: bool,
    scans: int | None,
    duration: float | None,
    png: Path | None,
    csv: Path | None,
    as_json: bool,
) -> int:
    """Connect to LINK as a host, decode and draw. Real devices too.

    LINK is pty:PATH, serial:DEVICE or tcp:HOST:PORT; with --family can_objects also socketcand:HOST:PORT/CHANNEL,
    slcan:PATH or can:INTERFACE:CHANNEL. On a terminal it draws until q is pressed; elsewhere it prints a line a second.
    With --png alone one scan is taken. Where scans come and nobody answers, as from lidaremu replay, it listens;
    when the other end closes the line it says so and ends.
    """
    from emulator.looking.look import CAN_FAMILY, Wanted, connect, run_look
    from emulator.looking.look_files import require_matplotlib
    from emulator.looking.screen import drawable

    if family_name != CAN_FAMILY and (model is not None or extended):
        raise click.UsageError(f"--model and --extended belong to --family {CAN_FAMILY}")
    if png is not None:
        require_matplotlib()
        if scans is None and duration is None:
            scans = 1
        if not png.absolute().parent.is_dir():
            raise EmulatorError(f"{png}: no such folder")
    live = drawable() and png is None and not as_json
    if sys.stderr.isatty():
        note(f"{'listening to' if listen else 'asking'} {link} for scans ({family_name})")
    host = connect(link, family_name, baud, model, extended, listen)
    return run_look(host, link, Wanted(scans, duration, png, csv, as_json, live, lines=True), say)


@click.command()
@click.option("--scenario", metavar="NAME", help="Built-in name or path (default: one that shows the family).")
@click.option("--sensor", help="Which of its sensors to look through (default: the first of the family).")
@click.option("--family", "family_name", metavar="F", help="lms2xx (default), ld or can_objects.")
@click.option("--duration", type=Finite(0.0, LONGEST_S), default=None, metavar="S", help="Stop after so long.")
@click.option("--baud", type=int, default=500_000, show_default=True, help="Line speed the host asks for.")
def demo(scenario: str | None, sensor: str | None, family_name: str | None, duration: float | None, baud: int) -> int:
    """A built-in scenario with a built-in host on the other end, drawn live in the terminal.

    Where standard output is no terminal it ends by itself after a few seconds.
    """
    from emulator.looking.demo import run_demo

    return run_demo(scenario, sensor, family_name, duration, baud, say)
