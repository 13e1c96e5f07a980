"""`lidaremu look` and `lidaremu demo`: options, and what is printed where."""

from __future__ import annotations

import sys
from pathlib import Path

import click

from emulator.commands.common import LONGEST_S, Finite
from emulator.errors import EmulatorError
from emulator.hosts.families import is_on_can, names
from emulator.output.lines import note, say


@click.command()
@click.argument("link")
@click.option("--family", "family_name", default="lms2xx", show_default=True, help=f"Protocol: {names()}.")
@click.option("--model", metavar="NAME", help="Format of object lists, for example can-ars408 (default: detected).")
@click.option("--extended", is_flag=True, help="Also request class, size and existence from an ARS408 (not stored).")
@click.option("--baud", type=int, default=38_400, show_default=True, help="Line speed to request (serial).")
@click.option("--listen", is_flag=True, help="Send no request: start at --baud and show what arrives.")
@click.option("--scans", type=click.IntRange(min=1), help="Stop after N scans or lists.")
@click.option("--duration", type=Finite(0.0, LONGEST_S), metavar="S", help="Stop after this many seconds.")
@click.option("--png", type=click.Path(dir_okay=False, path_type=Path), help="Draw the last scan into FILE.")
@click.option("--csv", type=click.Path(dir_okay=False, path_type=Path), help="Write the points of every scan to FILE.")
@click.option("--json", "as_json", is_flag=True, help="One JSON object per scan on standard output; nothing is drawn.")
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

    LINK is pty:PATH, serial:DEVICE, tcp:HOST:PORT or, to listen, udp:ADDRESS:PORT; with --family can_objects also
    socketcand:HOST:PORT/CHANNEL, slcan:PATH or can:INTERFACE:CHANNEL. On a terminal it draws until q is pressed;
    elsewhere it prints a line a second. With --png alone one scan is taken. Where scans come without replies, as
    from lidaremu replay, it listens; when the other end closes the line it says so and ends.
    """
    from emulator.looking.look import Wanted, connect, run_look
    from emulator.looking.look_files import require_matplotlib
    from emulator.looking.screen import drawable

    if not is_on_can(family_name) and (model is not None or extended):
        raise click.UsageError("--model and --extended apply only to --family can_objects")
    if png is not None:
        require_matplotlib()
        if scans is None and duration is None:
            scans = 1
        if not png.absolute().parent.is_dir():
            raise EmulatorError(f"{png}: no such folder")
    live = drawable() and png is None and not as_json
    if sys.stderr.isatty():
        note(f"{'listening to' if listen else 'requesting scans from'} {link} ({family_name})")
    host = connect(link, family_name, baud, model, extended, listen)
    return run_look(host, link, Wanted(scans, duration, png, csv, as_json, live, lines=True), say)


@click.command()
@click.option(
    "--scenario",
    metavar="NAME",
    help="Name of a built-in scenario, or a path (default: one with a sensor of the family).",
)
@click.option("--sensor", help="Sensor to show (default: the first of the family).")
@click.option("--family", "family_name", metavar="F", help=f"{names()}; default lms2xx.")
@click.option(
    "--duration", type=Finite(0.0, LONGEST_S), default=None, metavar="S", help="Stop after this many seconds."
)
@click.option("--baud", type=int, default=500_000, show_default=True, help="Line speed that the host requests.")
def demo(scenario: str | None, sensor: str | None, family_name: str | None, duration: float | None, baud: int) -> int:
    """A built-in scenario with a built-in host on the other end, drawn live in the terminal.

    Where standard output is no terminal it ends by itself after a few seconds.
    """
    from emulator.looking.demo import run_demo

    return run_demo(scenario, sensor, family_name, duration, baud, say)
