"""`lidaremu replay` and `lidaremu diff`: recordings sent again, and compared."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import threading
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import click

from emulator.commands.common import FAILED, LINK_LOST, OK, Finite, bar
from emulator.errors import EmulatorError
from emulator.output.lines import note, say
from emulator.process.driver import driver_environment, end_driver, how_it_ended, start_driver

if TYPE_CHECKING:
    from emulator.instrument.instrument import Instrument
    from emulator.instrument.observer import Observer
    from emulator.recording.osi_out import Newest, OsiOut
    from emulator.recording.writer import Recorder
    from emulator.runtime.daemon import Daemon, Lateness
    from emulator.runtime.feeding import Feeding
    from emulator.runtime.virtual_daemon import VirtualDaemon
    from emulator.scenario.scenario import Scenario
    from emulator.transports.link import Link


DRAWN_NS = 1_000_000_000
"Between two drawings of the bar, which keep the sender for a millisecond."


def recorder_for(
    scenario: Scenario,
    instruments: Sequence[Instrument],
    folder: Path | None,
    daemon: Daemon | VirtualDaemon,
    now_ns: Callable[[], int],
) -> Recorder | None:
    """The recorder that `--record` or the scenario asks for; a scenario's own goes to `NAME-recording` here."""
    wanted = scenario.record
    if folder is None and not (wanted.wire or wanted.truth):
        return None
    from emulator.recording.writer import Recorder
    from emulator.recording.writing import LIVE, VIRTUAL
    from emulator.runtime.virtual_daemon import VirtualDaemon

    own = Path(f"{scenario.source.stem}-recording")
    truth = folder is not None or wanted.truth
    manner = VIRTUAL if isinstance(daemon, VirtualDaemon) else LIVE
    return Recorder(folder or own, scenario, instruments, truth, daemon.incidents, now_ns, manner)


def field_formats(
    scenario: Scenario,
    instruments: Sequence[Instrument],
    recorder: Recorder | None,
    feeding: Feeding | None,
    tell: Callable[[str], None],
    newest: Newest | None = None,
) -> OsiOut | None:
    """`record.foxglove` and `record.osi`: formats that other tools read; what must be closed at the end.

    `newest`: gets the newest OSI message of each sensor; None: nobody takes them out.
    """
    wanted = scenario.record
    if not (wanted.osi or newest is not None or (wanted.foxglove and recorder is not None)):
        return None
    from emulator.recording.foxglove import FoxgloveChannels
    from emulator.recording.osi_out import OsiOut, opened
    from emulator.recording.whereabouts import Whereabouts

    where = Whereabouts(scenario, None if feeding is None else feeding.book.world)
    observers: list[Observer] = []
    if wanted.foxglove and recorder is not None:
        observers.append(FoxgloveChannels(recorder, where))
    osi = None
    if wanted.osi or newest is not None:
        osi = OsiOut(where, [opened(url) for url in wanted.osi], tell)
        osi.newest = osi.newest if newest is None else newest
    observers += [] if osi is None else [osi]
    for instrument in instruments:
        for observer in observers:
            instrument.watch(observer)
    return osi


WIRE_PORT = click.option(
    "--port",
    type=click.IntRange(1, 65535),
    default=49152,
    show_default=True,
    help="TCP or UDP port of the device in a capture.",
)
WIRE_BAUD = click.option(
    "--baud", type=click.IntRange(min=50), default=38400, show_default=True, help="Line speed of a raw serial dump."
)
"Of files that others have recorded."


def replay_world(recording: Path, as_json: bool) -> int:
    """A fed run again without its feeder, with what its hosts said, or with built-in ones; prints its digest."""
    from emulator.judging.trial import run_trial
    from emulator.live.files import read
    from emulator.recording.reader import read_run
    from emulator.scenario.scenario import load

    if not (recording / "scenario.yaml").is_file():
        raise EmulatorError(f"{recording}: no scenario.yaml; want a folder of lidaremu run --record")
    reported = list(read("recording", recording.absolute()))
    if not reported:
        raise EmulatorError(f"{recording}: no feed; want a recording of a scenario with live:")
    changes = [f"live.feed={json.dumps(f'recording:{recording.absolute()}')}"]
    loaded = load(str(recording / "scenario.yaml"), changes)
    if loaded.duration_s is None:
        last_s = max(max(one.run_ns for one in reported) * 1e-9, 1e-3)
        loaded = load(str(recording / "scenario.yaml"), [*changes, f"duration_s={last_s!r}"])
    heard = {
        sensor: wire.payloads
        for (sensor, _), wire in read_run(recording).received.items()
        if wire.kind in ("serial", "stream") and not wire.url.startswith("loop:")
    }
    if heard:  # nobody decodes what the recorded hosts got
        loaded = loaded.model_copy(update={"expect": ()})
    verdict = run_trial(loaded, heard=heard)
    row = {"updates": len(reported), "duration_s": verdict.duration_s, "sha256": verdict.sha256, "held": verdict.held}
    if as_json:
        say(json.dumps({"event": "world", **row}))
    else:
        say(f"{len(reported)} updates, {verdict.duration_s:g} s")
        for one in verdict.judgements:
            say(str(one))
        say(f"sha256 of all wire bytes with their virtual times: {verdict.sha256}")
    return OK if verdict.held else FAILED


@click.command()
@click.argument("recording", type=click.Path(path_type=Path))
@click.argument("command", nargs=-1, type=click.UNPROCESSED)
@click.option(
    "--link", "links", multiple=True, metavar="SENSOR=URL", help="Send to this link instead of the recorded one."
)
@click.option("--speed", type=Finite(0.001, 1e9), default=1.0, metavar="X", help="Speed factor; 1: as recorded.")
@click.option("--stepped", is_flag=True, help="Send one payload for each line on standard input.")
@click.option("--loop", "loops", type=click.IntRange(min=0), default=1, help="Number of repetitions; 0: forever.")
@WIRE_PORT
@WIRE_BAUD
@click.option("--at-once", is_flag=True, help="Do not wait for a host.")
@click.option("--world", is_flag=True, help="Run the scenario again with the recorded feed, in virtual time.")
@click.option("--json", "as_json", is_flag=True, help="One JSON object per line.")
def replay(
    recording: Path,
    command: Sequence[str],
    links: Sequence[str],
    speed: float,
    stepped: bool,
    loops: int,
    port: int,
    baud: int,
    at_once: bool,
    world: bool,
    as_json: bool,
) -> int:
    """Send a RECORDING again, with its own gaps or scaled: a folder or .mcap of lidaremu, .pcap, .pcapng, .blf, .asc,
    candump .log, or the raw bytes of a serial line. Gaps of a recording of lidaremu are those between the instants at
    which payloads were due, not how late a run in real time sent them.

    After `--` a COMMAND may follow, as of lidaremu run: it is started once every link accepts a host, gets its links in
    LIDAREMU_<SENSOR>, and the replay ends with it or at the recording's end.
    """
    if world:
        if command or stepped or links:
            raise click.UsageError("--world runs with built-in hosts; want it without COMMAND, --stepped and --link")
        return replay_world(recording, as_json)
    if stepped and command:
        raise click.UsageError("--stepped and a COMMAND both read the standard input; want one of them")
    from emulator.recording.reader import is_ours, read_run, read_wire
    from emulator.runtime.daemon import Lateness
    from emulator.runtime.playback import GapErrors, ReplaySession, open_players, step
    from emulator.runtime.virtual_daemon import VirtualDaemon

    if recording.suffix in (".yaml", ".yml"):  # any other bytes may be those of a line
        raise EmulatorError(f"{recording}: a scenario; want a recording, see lidaremu run --record")
    wires = read_wire(recording, port, baud)
    if is_ours(recording):
        cut = read_run(recording).cut
        if cut:
            note(f"{recording}: truncated: {cut}; everything before that is sent")
    if not wires:
        raise EmulatorError(f"{recording}: contains no data sent by a sensor")
    replaced = {}
    for text in links:
        sensor, separator, url = text.partition("=")
        known = sorted({wire.sensor for wire in wires})
        if not separator or sensor not in known:
            raise click.BadParameter(f"{text!r}; want SENSOR=URL with one of {', '.join(known)}", param_hint="--link")
        replaced[sensor] = url
    players = open_players(wires, replaced)
    sessions = [player.session for player in players if isinstance(player.session, ReplaySession)]
    for session in sessions:
        session.loops, session.allowed = loops, 0 if stepped else None
    daemon = VirtualDaemon(players, speed=speed)
    daemon.on_failure = note
    daemon.incidents.listeners.append(lambda one: note(f"{one.on}: {one.kind}: {one.text}"))
    daemon.paused = stepped
    errors = GapErrors(daemon)
    for player in players:
        player.watch(errors)
    driver: subprocess.Popen[bytes] | None = None
    driver_code: int | None = None
    try:
        with daemon.signals(), bar(recording.name) as progress:
            daemon.power_on()
            _announce(players, as_json)
            if command:
                reported = [(player.sensor, player.links[0].url) for player in players]
                driver = start_driver(command, driver_environment(os.environ, reported), as_json)
            started, drawn_ns = False, 0

            def going() -> bool:
                nonlocal started, drawn_ns
                if driver is not None and driver.poll() is not None:
                    return False
                if started and daemon.now_ns >= drawn_ns + speed * DRAWN_NS:
                    drawn_ns = daemon.now_ns
                    progress(min(session.progress for session in sessions))
                if not started and (at_once or any(link.has_host() for link in daemon.links)):
                    started = True
                    daemon.rebase(speed)
                    for session in sessions:
                        session.start(daemon.now_ns)
                    daemon.run_of.touch()
                for player, session in zip(players, sessions, strict=True):
                    if player.sensor in daemon.run_of.lost:
                        session.give_up()
                served = [player for player in players if player.sensor not in daemon.run_of.lost]
                busy = any(player.links[0].flush(daemon.now_ns) is not None for player in served)
                return not all(session.finished for session in sessions) or busy

            if stepped:
                one_more = partial(step, daemon, sessions, errors)
                threading.Thread(target=_step_by_lines, args=(daemon, one_more), daemon=True).start()
            daemon.run(while_true=going)
            daemon.drain()
    finally:
        daemon.close()
        driver_code = None if driver is None else end_driver(driver)
    _tell_end(Lateness.of(errors.late_ns), max(session.rounds for session in sessions), daemon.links, stepped, as_json)
    if daemon.lost_links:
        return LINK_LOST
    if driver_code not in (None, 0):
        note(f"{command[0]} ended with {how_it_ended(driver_code or 0)}")
        return FAILED
    return OK


def _tell_end(late: Lateness, rounds: int, links: Sequence[Link], stepped: bool, as_json: bool) -> None:
    """What was sent, how well the gaps were kept where it was not the user who made them, and what nobody read."""
    kept = late.count > 0 and not stepped
    lost = sum(link.stats.bytes_lost for link in links)
    if as_json:
        gaps = {"median": late.median_us, "p99": late.p99_us} if kept else {}
        row = {"event": "stopped", "payloads": late.count, "rounds": rounds, "gap_error_us": gaps, "bytes_lost": lost}
        say(json.dumps(row))
    elif not late.count:
        say("nothing was sent")
    else:
        reported = f"; gap error: median {late.median_us:.0f} us, p99 {late.p99_us:.0f} us" if kept else ""
        say(f"{late.count} payloads sent{reported}")
        if lost:
            say(f"{lost} bytes lost: no host was connected, or it did not read")


def _announce(players: Sequence[Instrument], as_json: bool) -> None:
    if as_json:
        rows = [{"id": one.sensor, "links": [link.url for link in one.links]} for one in players]
        say(json.dumps({"event": "ready", "sensors": rows, "control": None}))
        return
    for one in players:
        say(f"ready: {one.sensor} on {one.links[0].url}")


def _step_by_lines(daemon: VirtualDaemon, one_more: Callable[[], None]) -> None:
    """Each line that the user enters sends one more payload; the end of input ends the run."""
    for _ in sys.stdin:
        daemon.call(one_more)
    daemon.call(daemon.stop)


@click.command()
@click.argument("first", type=click.Path(path_type=Path))
@click.argument("second", type=click.Path(path_type=Path))
@WIRE_PORT
@WIRE_BAUD
@click.option("--json", "as_json", is_flag=True, help="One JSON object per difference.")
def diff(first: Path, second: Path, port: int, baud: int, as_json: bool) -> int:
    """Compare two recordings: the first byte, instant, beam or object of each link and sensor that differs. Instants
    are those at which payloads were due, not how late a run in real time sent them (see lidaremu report).

    Give two recordings of lidaremu (folder or .mcap), or two files of .pcap, .pcapng, .blf, .asc, .log, serial dump.
    Times of such files are compared to a microsecond, relative to their first payload.
    """
    from emulator.recording.compare import differences
    from emulator.recording.reader import is_ours, read_run, read_strange

    for path in (first, second):
        if not path.exists():
            raise EmulatorError(f"{path}: no such file or folder; want a recording")
    if is_ours(first) != is_ours(second):
        raise EmulatorError(f"{first}, {second}: one of lidaremu and one of another tool; want two of the same kind")
    read = read_run if is_ours(first) else partial(read_strange, port=port, baud=baud)
    runs = [read(first), read(second)]
    for run in runs:
        if run.cut:
            note(f"{run.path}: truncated: {run.cut}")
    found = differences(*runs)
    for item in found:
        say(json.dumps({"at_ns": item.at_ns, "where": item.where, "what": item.what}) if as_json else str(item))
    if not found and not as_json:
        payloads = sum(len(wire.payloads) for wire in runs[0].sent.values())
        say(f"identical: {payloads} payloads sent, {sum(map(len, runs[0].scans.values()))} scans")
    return FAILED if found else OK
