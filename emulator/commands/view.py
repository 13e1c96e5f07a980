"""`lidaremu view`: the live page in a browser."""

from __future__ import annotations

import json
import secrets
import signal
import subprocess
import sys
import tempfile
import threading
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import click

from emulator.commands.common import LONGEST_S, OK, Finite, note, say
from emulator.errors import EmulatorError

if TYPE_CHECKING:
    from emulator.view.frames import Source

NEEDS = "the page needs more: pip install 'lidaremu[view]'"
STOPPED_S = 10.0
LONG_S = 1e8
"A daemon of our own goes on until the page is closed: at the scenario's end its time stands."


@click.command()
@click.argument("what", required=False, metavar="[CONTROL | RECORDING | SCENARIO]")
@click.option("--host", default="127.0.0.1", show_default=True, help="Address to listen on.")
@click.option("--port", type=click.IntRange(0, 65535), default=0, help="Port; 0: any that is free (default).")
@click.option("--token", help="Without it nobody comes in (default: a new one).")
@click.option("--no-browser", is_flag=True, help="Only say where the page is.")
@click.option("--duration", type=Finite(0.0, LONGEST_S), metavar="S", help="Stop after this many seconds.")
@click.option("--json", "as_json", is_flag=True, help="One JSON object a line on standard output.")
def view(
    what: str | None,
    host: str,
    port: int,
    token: str | None,
    no_browser: bool,
    duration: float | None,
    as_json: bool,
) -> int:
    """See a run in the browser: scene, echoes, telegrams; weather, faults and time at hand.

    CONTROL is a running daemon's control socket (left out: the only daemon that runs), RECORDING a folder or run.mcap
    of `--record`, SCENARIO a file or built-in name: it is started with hosts of ours on its links, at real time's pace;
    where it ends by its `duration_s` time stands, and the page stays.
    """
    if token is not None and (len(token) < 8 or not token.isascii() or not token.isalnum()):
        raise click.BadParameter(f"{token!r}; want 8 or more letters and digits", param_hint="--token")
    try:
        from emulator.view.door import LOCAL, be_free, open_server
        from emulator.view.page import Page
    except ModuleNotFoundError as error:
        raise EmulatorError(f"{error}; {NEEDS}") from None

    be_free(host, port)
    key = token or secrets.token_urlsafe(18).replace("-", "x").replace("_", "y")
    stopped = threading.Event()
    old = {number: signal.signal(number, lambda *_: stopped.set()) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        with ExitStack() as held:
            source = held.enter_context(opened(what))
            server = open_server(host, port, key, f"lidaremu: {source.title}")
            held.callback(server.stop)
            page = Page(server, source)
            held.callback(page.close)
            reached = {"0.0.0.0": "127.0.0.1", "::": "[::1]"}.get(host, f"[{host}]" if ":" in host else host)
            url = f"http://{reached}:{server.get_port()}/?token={key}"
            say(json.dumps({"event": "ready", "url": url}) if as_json else f"see {url}")
            if host not in LOCAL:
                note(f"{host}: the page is open to the network, to who has the token; it is not encrypted")
            if not no_browser:
                import webbrowser

                threading.Thread(target=webbrowser.open, args=(url,), daemon=True).start()
            if duration is not None:
                timer = threading.Timer(duration, stopped.set)
                timer.daemon = True
                timer.start()
            page.run(stopped)
    finally:
        for number, action in old.items():
            signal.signal(number, action)
    return OK


@contextmanager
def opened(what: str | None) -> Iterator[Source]:
    """The source meant by the command's argument."""
    from emulator.view.live import LiveSource, find

    path = None if what is None else Path(what.removeprefix("unix:"))
    if path is not None and (path.is_dir() or path.suffix == ".mcap"):
        from emulator.view.recorded import RecordedSource

        recorded = RecordedSource(path)
        if recorded.cut:
            note(f"{path}: cut: {recorded.cut}; what is before is shown")
        yield recorded
    elif path is None or path.is_socket() or str(what).startswith("unix:") or path.suffix == ".sock":
        yield LiveSource(find(path))
    else:
        with own_daemon(str(what)) as control:
            source = LiveSource(control)
            source.stand_at_end()
            yield source


@contextmanager
def own_daemon(scenario: str) -> Iterator[Path]:
    """A daemon on a scenario at real time's pace, with hosts of ours on its links; its control socket."""
    from emulator.view.guests import Guests, free_links

    with tempfile.TemporaryDirectory(prefix="lidaremu-") as folder:
        links = [f"--link={text}" for text in free_links(scenario, Path(folder))]
        command = [sys.executable, "-m", "emulator", "run", scenario, "--json", "--speed", "1"]
        command += [f"--duration={LONG_S}", *links]
        daemon = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        try:
            assert daemon.stdout is not None
            first = daemon.stdout.readline()
            if not first:
                raise EmulatorError(f"the daemon did not start (exit code {daemon.wait()})")
            ready = json.loads(first)
            guests = Guests(ready["sensors"], note)
            yield Path(ready["control"].removeprefix("unix:"))
            guests.close()
        finally:
            daemon.terminate()
            try:
                daemon.communicate(timeout=STOPPED_S)
            except subprocess.TimeoutExpired:
                daemon.kill()
                daemon.communicate()
