"""`lidaremu ctl`: orders to a running daemon."""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import click

from emulator.commands.common import OK
from emulator.commands.status_table import lines_of
from emulator.errors import EmulatorError, LinkError
from emulator.output.lines import note, say
from emulator.runtime.order_words import parameters_of

ASKED_S = 3.0
"For the name of a daemon's scenario."

if TYPE_CHECKING:
    from emulator.instrument.instrument import Instrument
    from emulator.process.clock import Clock
    from emulator.recording.writer import Recorder
    from emulator.runtime.control import ControlServer
    from emulator.runtime.daemon import Daemon
    from emulator.runtime.virtual_daemon import VirtualDaemon
    from emulator.scenario.scenario import Scenario


def control_of(
    daemon: Daemon | VirtualDaemon,
    instruments: Sequence[Instrument],
    clock: Clock,
    scenario: Scenario,
    recorder: Recorder | None,
    path: Path | None,
    until_ns: int | None = None,
) -> ControlServer:
    """The control socket of a run, at `path` or at a place of its own."""
    from emulator.runtime.control import ControlServer, new_path
    from emulator.runtime.orders import Orders
    from emulator.runtime.virtual_daemon import VirtualDaemon

    orders = Orders(daemon, instruments, clock, scenario)
    orders.until_ns = until_ns
    if recorder is not None:
        orders.record(recorder.note, recorder.state)

    def on_incident(kind: str, text: str) -> None:
        """Reported by the control's thread; noted, and printed, by the run's."""

        def note() -> None:
            at_ns = daemon.now_ns if isinstance(daemon, VirtualDaemon) else clock.now_ns()
            daemon.incidents.note(kind, at_ns, "control", text)

        daemon.call(note)

    limited = not isinstance(daemon, VirtualDaemon)
    return ControlServer(path or new_path(), orders.methods(), daemon, on_incident, limited)


@click.command()
@click.argument("order", metavar="METHOD")
@click.argument("parameters", nargs=-1, metavar="[NAME=VALUE]...")
@click.option(
    "--socket", "--control", "path", type=click.Path(path_type=Path),
    help="Control socket, as reported in `ready` (default: the only running daemon).",
)  # fmt: skip
@click.option("--json", "as_json", is_flag=True, help="Print JSON on a terminal too, as elsewhere.")
def ctl(order: str, parameters: tuple[str, ...], path: Path | None, as_json: bool) -> int:
    """Send an order to a running daemon.

    Always: status, metrics, stop; weather [fog.visibility_m=50] [rain.rate_mm_h=10] [snow=null], without values: the
    weather in effect. With a virtual clock: pause, resume, step [scans=N | bytes=N] [sensor=ID], step seconds=S,
    step to_s=S, speed x=X (0: as fast as hosts read). With `live:` in the scenario: poses actors=[...].
    For viewers: glance, scans, telegrams, scene. All methods are in docs/control.md.

    \b
    fault SENSOR NAME [KEY=VALUE]...   begins a fault, immediately without a trigger; prints its number
    fault clear [N]                    ends that fault, or all
    fault list                         lists all faults of this run (also: faults)

    A VALUE is JSON, or a plain word; a dot in NAME enters a table. On a terminal `status` is a table;
    in a pipe or a file every answer is a line of JSON.
    """
    from emulator.runtime import control

    order, parameters = fault_order(parameters) if order == "fault" else (order, parameters)
    params = parameters_of(parameters)
    if path is None:
        found = control.running()
        if len(found) != 1:
            if not found:
                raise LinkError(
                    "no daemon of this user is running at the usual place; want lidaremu run SCENARIO first, "
                    "or --socket PATH of one with --control PATH"
                )
            reported = "; ".join(f"{scenario_of(one)} at {one}" for one in found)
            raise LinkError(f"which daemon? {reported}; want --socket PATH")
        path = found[0]
    result = control.ask(Path(str(path).removeprefix("unix:")), order, params)
    if isinstance(result, dict) and "why" in result:
        note(str(result["why"]))
    if order == "status" and isinstance(result, dict) and sys.stdout.isatty() and not as_json:
        for line in lines_of(result):
            say(line)
        return OK
    for line in result.rstrip().split("\n") if isinstance(result, str) else [json.dumps(result)]:
        say(line)
    return OK


def scenario_of(path: Path) -> str:
    """Name of the scenario that a daemon runs, by its control socket; what is known of it where it does not answer."""
    from emulator.runtime import control

    try:
        status = control.ask(path, "status", {}, ASKED_S)
    except EmulatorError:
        return "a daemon that does not answer"
    return str(status.get("scenario", "an older daemon")) if isinstance(status, dict) else "an older daemon"


def fault_order(words: Sequence[str]) -> tuple[str, tuple[str, ...]]:
    """Method and parameters of `fault SENSOR NAME KEY=VALUE...`, `fault clear [N]` and `fault list`."""
    plain = [word for word in words if "=" not in word]
    rest = tuple(word for word in words if "=" in word)
    if plain in ([], ["list"]):
        return ("fault", rest) if rest else ("faults", ())
    if plain[0] == "clear":
        return "fault_clear", (*rest, *(f"number={word}" for word in plain[1:]))
    if len(plain) != 2:
        raise click.BadParameter(f"{' '.join(plain)!r}; want SENSOR NAME, clear [N] or list", param_hint="fault")
    return "fault", (f"on={json.dumps(plain[0])}", f"do={json.dumps(plain[1])}", *rest)
