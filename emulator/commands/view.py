"""`lidaremu view`: the live page in a browser."""

from __future__ import annotations

import json
import secrets
import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import click

from emulator.commands.common import LINK_LOST, LONGEST_S, OK, Finite
from emulator.errors import EmulatorError
from emulator.output.lines import note, say
from emulator.output.sanitizing import visible

if TYPE_CHECKING:
    from emulator.view.frames import Source

NEEDS = "the page needs more: pip install 'lidaremu[view]'"
MOST_REPORTED = 8
"Names that are reported; a browser that is refused tries again."


@click.command()
@click.argument("what", required=False, metavar="[CONTROL | RECORDING | SCENARIO]")
@click.option("--host", default="127.0.0.1", show_default=True, help="Address to listen on.")
@click.option(
    "--allow-host",
    "allowed",
    multiple=True,
    metavar="NAME[:PORT]",
    help="Accept a further host name, for a tunnel or a proxy (https://NAME).",
)
@click.option("--port", type=click.IntRange(0, 65535), default=0, help="Port; 0 (default): any free port.")
@click.option("--token", help="Access token, part of the address (default: a new random one).")
@click.option("--no-browser", is_flag=True, help="Only print the address.")
@click.option("--duration", type=Finite(0.0, LONGEST_S), metavar="S", help="Stop after this many seconds.")
@click.option("--json", "as_json", is_flag=True, help="One JSON object per line on standard output.")
def view(
    what: str | None,
    host: str,
    allowed: Sequence[str],
    port: int,
    token: str | None,
    no_browser: bool,
    duration: float | None,
    as_json: bool,
) -> int:
    """Show a run in the browser: scene, echoes, telegrams, with controls for weather, faults and time.

    CONTROL is the control socket of a running daemon (default: the only one). RECORDING is a folder or run.mcap
    of `--record`. SCENARIO is a file or built-in name: it is started with built-in hosts on its links, in real time.
    At its `duration_s` time stops, and the page stays; it can be restarted there.
    """
    if token is not None and (len(token) < 8 or not token.isascii() or not token.isalnum()):
        raise click.BadParameter(f"{token!r}; want 8 or more letters and digits", param_hint="--token")
    try:
        from emulator.view.access import LOCAL
        from emulator.view.local_server import be_free, open_server
        from emulator.view.page import Page
    except ModuleNotFoundError as error:
        raise EmulatorError(f"{error}; {NEEDS}") from None
    from emulator.runtime.own_daemon import ending_signals

    be_free(host, port)
    key = token or secrets.token_urlsafe(18).replace("-", "x").replace("_", "y")
    stopped = threading.Event()
    old = {number: signal.signal(number, lambda *_: stopped.set()) for number in ending_signals()}
    try:
        with ExitStack() as held:
            source = held.enter_context(opened(what))
            server = open_server(host, port, key, f"lidaremu: {visible(source.title)}", allowed, _refused())
            held.callback(server.stop)
            page = Page(server, source, note)
            held.callback(page.close)
            reached = {"0.0.0.0": "127.0.0.1", "::": "[::1]"}.get(host, f"[{host}]" if ":" in host else host)
            place = f"http://{reached}:{server.get_port()}"
            url = f"{place}/{key}/"
            say(json.dumps({"event": "ready", "url": url}) if as_json else f"see {url}")
            if host not in LOCAL:
                note(f"{host}: the page can be reached from the network by anyone with the token; it is not encrypted")
            if not no_browser:
                import webbrowser

                threading.Thread(target=webbrowser.open, args=(place + server.lock.ticket(),), daemon=True).start()
            if duration is not None:
                timer = threading.Timer(duration, stopped.set)
                timer.daemon = True
                timer.start()
            page.run(stopped)
            code = LINK_LOST if getattr(source, "failed", False) else OK
    finally:
        for number, action in old.items():
            signal.signal(number, action)
    return code


def _refused() -> Callable[[str], None]:
    """Reports a browser that has the token and comes by a name that was not opened; each name once."""
    reported: set[str] = set()

    def tell(host: str) -> None:
        if host not in reported and len(reported) < MOST_REPORTED:
            reported.add(host)
            note(f"refused: a browser asks for {host[:100]!r}, which is not an allowed host; see --allow-host")

    return tell


@contextmanager
def opened(what: str | None) -> Iterator[Source]:
    """The source meant by the command's argument."""
    from emulator.view.live import LiveSource, find

    path = None if what is None else Path(what.removeprefix("unix:"))
    if path is not None and (path.is_dir() or path.suffix == ".mcap"):
        from emulator.view.recorded import RecordedSource

        recorded = RecordedSource(path)
        if recorded.cut:
            note(f"{path}: truncated: {recorded.cut}; everything before that is shown")
        yield recorded
    elif path is None or path.is_socket() or str(what).startswith("unix:") or path.suffix == ".sock":
        yield LiveSource(find(path))
    else:
        from emulator.view.own import OwnSource

        own = OwnSource(str(what), note)
        try:
            yield own
        finally:
            own.close()
