"""`lidaremu ctl`: orders to a running daemon."""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import click

from emulator.commands.common import OK, say
from emulator.errors import LinkError

if TYPE_CHECKING:
    from emulator.clock import Clock
    from emulator.control import ControlServer
    from emulator.daemon import Daemon
    from emulator.instrument import Instrument
    from emulator.recording.writer import Recorder
    from emulator.virtual_daemon import VirtualDaemon

ORDERS = ("status", "metrics", "pause", "resume", "step", "speed", "stop")


def control_of(
    daemon: Daemon | VirtualDaemon,
    instruments: Sequence[Instrument],
    clock: Clock,
    recorder: Recorder | None,
    path: Path | None,
) -> ControlServer:
    """The control socket of a run, at `path` or at a place of its own."""
    from emulator.control import ControlServer, default_folder
    from emulator.orders import Orders

    orders = Orders(daemon, instruments, clock, *(() if recorder is None else (recorder.note,)))
    return ControlServer(path or default_folder() / f"{os.getpid()}.sock", orders.methods(), daemon)


@click.command()
@click.argument("order", type=click.Choice(ORDERS))
@click.argument("parameters", nargs=-1, metavar="[NAME=VALUE]...")
@click.option("--socket", "path", type=click.Path(path_type=Path), help="As told in `ready`; default: the only daemon.")
def ctl(order: str, parameters: tuple[str, ...], path: Path | None) -> int:
    """Tell a running daemon: status, metrics, stop, and on a virtual clock pause, resume, step [scans=N | seconds=S],
    speed x=X (0: as fast as hosts read).
    """
    from emulator import control

    params = {}
    for text in parameters:
        name, separator, value = text.partition("=")
        try:
            params[name] = json.loads(value)
        except ValueError:
            separator = ""
        if not separator:
            raise click.BadParameter(f"{text!r}; want NAME=NUMBER", param_hint="NAME=VALUE")
    if path is None:
        found = control.running()
        if len(found) != 1:
            told = "; ".join(map(str, found)) or "none runs"
            raise LinkError(f"which daemon? {told}; want --socket PATH")
        path = found[0]
    result = control.ask(Path(str(path).removeprefix("unix:")), order, params)
    say(result.rstrip() if isinstance(result, str) else json.dumps(result))
    return OK
