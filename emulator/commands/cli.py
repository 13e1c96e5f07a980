"""The command line: reads arguments, prints, and turns errors into exit codes. The only place that prints.

Exit codes: 0 held, or stopped as asked; 1 an expectation failed; 2 cannot run: bad scenario, spec or arguments;
3 a link could not be opened or was lost; 4 the run went on but its recording ended early; 5 a sensor fell silent, or
scans do not add up. Parts are imported by the command that needs them.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from emulator import __version__
from emulator.commands.campaign import campaign
from emulator.commands.common import (
    CANNOT_RUN,
    FAILED,
    LINK_LOST,
    LONGEST_S,
    OK,
    Finite,
    complain,
    complain_of_use,
    links_of,
    load_scenario,
    scenario_options,
)
from emulator.commands.ctl import control_of, ctl
from emulator.commands.doctor import doctor
from emulator.commands.endings import Ending
from emulator.commands.explain import explain
from emulator.commands.export import export
from emulator.commands.fmu import fmu
from emulator.commands.fuzz import fuzz
from emulator.commands.look import demo, look
from emulator.commands.probe import probe
from emulator.commands.recordings import diff, field_formats, recorder_for, replay
from emulator.commands.report import report
from emulator.commands.soak import soak
from emulator.commands.study import study
from emulator.commands.test import test
from emulator.commands.transcript import transcript as print_transcript
from emulator.commands.view import view
from emulator.errors import EmulatorError, LinkError, ScenarioError
from emulator.output.lines import note, say
from emulator.output.sanitizing import guard
from emulator.process.driver import FEED, driver_environment, end_driver, how_it_ended, start_driver
from emulator.runtime.own_daemon import leashed

if TYPE_CHECKING:
    from emulator.faults.events import FaultEvent
    from emulator.instrument.instrument import Instrument
    from emulator.process.clock import Clock
    from emulator.process.incidents import Incident, Incidents
    from emulator.recording.osi_out import OsiOut
    from emulator.recording.transcript import Transcript
    from emulator.recording.writer import Recorder
    from emulator.runtime.daemon import Daemon
    from emulator.runtime.lockstep import LockstepServer
    from emulator.runtime.virtual_daemon import VirtualDaemon
    from emulator.scenario.scenario import Scenario


def entry() -> None:
    """Entry point of the installed command."""
    guard()
    sys.exit(main(sys.argv[1:]))


def main(argv: Sequence[str]) -> int:
    """Run one command and return its exit code; bad input gives a message, never a traceback."""
    try:
        result = commands.main(args=list(argv), prog_name="lidaremu", standalone_mode=False, obj=tuple(argv))
    except click.exceptions.Exit as stop:
        return stop.exit_code
    except click.Abort:
        return CANNOT_RUN
    except click.ClickException as error:
        complain_of_use(error)
        return CANNOT_RUN
    except EmulatorError as error:
        complain(error)
        return error.exit_code
    except BrokenPipeError:  # the reader of our output has gone, as with `| head`
        sys.stdout = open(os.devnull, "w")
        return OK
    return result if isinstance(result, int) else OK


@click.group(context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 110})
@click.version_option(__version__, prog_name="lidaremu")
def commands() -> None:
    """Software that behaves on the wire exactly like a real lidar."""


# ---------------------------------------------------------------- scenarios


@commands.command()
@click.argument("scenarios", nargs=-1, required=True, metavar="SCENARIO...")
@scenario_options
@click.option("--json", "as_json", is_flag=True, help="One JSON object per scenario.")
def check(
    scenarios: Sequence[str], overrides: Sequence[str], seed: int | None, links: Sequence[str], as_json: bool
) -> int:
    """Validate scenario files, their meshes and their devices' settings."""
    from emulator.measuring.measuring import Measures, warnings_of
    from emulator.runtime.assembly import measures_of
    from emulator.world import scene

    code = OK
    for name in scenarios:
        try:
            loaded = _rehearsed(name, overrides, seed, links)
            world = scene.build(loaded)
            warnings = warnings_of(Measures(measures_of(loaded, world), world.warnings))
        except EmulatorError as error:
            code = max(code, error.exit_code)
            if as_json:
                say(json.dumps({"scenario": name, "ok": False, "faults": list(error.lines)}))
            else:
                complain(error, head="")
            continue
        triangles = sum(len(body.faces) for body in world.bodies)
        if as_json:
            counts = {"actors": len(world.actors), "triangles": triangles}
            say(json.dumps({"scenario": name, "ok": True, **counts, "warnings": warnings}))
        else:
            for text in warnings:
                note(f"{name}: warning: {text}")
            say(f"{name}: ok: {len(loaded.sensors)} sensors, {len(world.actors)} actors, {triangles} triangles")
    return code


def _rehearsed(name: str, overrides: Sequence[str], seed: int | None, links: Sequence[str]) -> Scenario:
    """The scenario; `ScenarioError` with its own faults and those of its expectations together."""
    from emulator.judging.expectations import understand
    from emulator.judging.trial import rehearse
    from emulator.scenario.scenario import examine, in_file_order

    found, reported = examine(name, overrides, seed, links_of(links))
    if found is not None and not reported:
        rehearse(found)
        return found
    if found is not None:
        try:
            understand(found)
        except ScenarioError as error:
            reported += error.lines
    raise ScenarioError.of(in_file_order(reported))


# ---------------------------------------------------------------- run


@commands.command(context_settings={"ignore_unknown_options": False})
@click.argument("scenario")
@click.argument("command", nargs=-1, type=click.UNPROCESSED)
@scenario_options
@click.option("--duration", type=Finite(0.0, LONGEST_S), metavar="S", help="Stop after this many seconds.")
@click.option("--loop/--no-loop", "loop", default=None, help="Restart the world every `duration_s`, forever.")
@click.option("--workers", type=click.IntRange(min=1), help="Number of measuring processes (default: as many as help).")
@click.option(
    "--clock",
    type=click.Choice(["real", "virtual"]),
    default="real",
    help="Clock of the run; virtual: as fast as hosts read.",
)
@click.option("--speed", type=Finite(0.001, 1e9), metavar="X", help="Run a virtual clock at X times real time.")
@click.option("--no-wait", is_flag=True, help="Let virtual time advance without a connected host.")
@click.option(
    "--answer-wait",
    type=Finite(0.0, LONGEST_S),
    metavar="S",
    help="Real time for which virtual time stands for a host's answer when nothing is due (default: 0.1).",
)
@click.option("--realtime", is_flag=True, help="Real-time scheduling (SCHED_FIFO) for the sender, where permitted.")
@click.option("--control", type=click.Path(path_type=Path), metavar="PATH", help="Control socket.")
@click.option(
    "--record", type=click.Path(file_okay=False, path_type=Path), metavar="DIR", help="Record the run into DIR."
)
@click.option("--json", "as_json", is_flag=True, help="One JSON object per line on standard output.")
@click.option(
    "--until-eof",
    is_flag=True,
    help="Stop at the end of standard input, that is when the program that holds it open ends.",
)
@click.option("--restart", is_flag=True, help="Restart the daemon with the same links whenever it dies.")
@click.option("--own-folder", type=click.Path(path_type=Path), hidden=True, help="See emulator.runtime.own_daemon.")
@click.option("--shim", is_flag=True, help="Give COMMAND the preload shim: custom divisors, modem lines, SocketCAN.")
def run(
    scenario: str,
    command: Sequence[str],
    overrides: Sequence[str],
    seed: int | None,
    links: Sequence[str],
    duration: float | None,
    loop: bool | None,
    workers: int | None,
    clock: str,
    speed: float | None,
    no_wait: bool,
    answer_wait: float | None,
    realtime: bool,
    control: Path | None,
    record: Path | None,
    as_json: bool,
    until_eof: bool,
    restart: bool,
    own_folder: Path | None,
    shim: bool,
) -> int:
    """Open every link of SCENARIO and answer hosts until SIGINT, SIGTERM or --duration.

    After `--` a COMMAND may follow: it is started once every link accepts a host, with the path or address of each
    sensor's first link in the variable LIDAREMU_<SENSOR>, and the run ends with it. With --json its standard output
    goes to standard error. What COMMAND prints is passed on as it is.
    """
    if shim and not command:
        raise click.UsageError("--shim needs the command of a driver: lidaremu run SCENARIO --shim -- ./driver ARGS")
    if restart:
        return keep_running(command, until_eof, record)
    from emulator.process.sd_notify import Notifier

    if until_eof and (command or sys.stdin is None):
        raise click.UsageError("--until-eof and a COMMAND cannot be combined: both read the standard input")
    notifier = Notifier.of_environment(os.environ)  # neither workers nor a driver speak for us
    leash = click.get_current_context().with_resource(leashed(until_eof, own_folder))
    environment = dict(os.environ)
    sockets = None
    if shim:
        from emulator.transports.can_sockets import CanSockets
        from emulator.transports.shim import shim_environment

        environment = shim_environment(environment)
        sockets = click.get_current_context().with_resource(closing(CanSockets()))
    if loop is not None:
        overrides = (*overrides, f"loop={str(loop).lower()}")
    loaded = load_scenario(scenario, overrides, seed, links)
    ending = Ending.of(loaded, duration)

    from emulator.instrument.ledger import check_accounts
    from emulator.process.clock import SystemClock
    from emulator.process.waiting import be_realtime
    from emulator.runtime import assembly
    from emulator.runtime.virtual_daemon import VirtualDaemon
    from protocols.session import LinkKind

    real = SystemClock()
    daemon: Daemon | VirtualDaemon
    if clock == "virtual" or speed is not None:
        daemon, instruments = assembly.start_virtual(loaded, speed, workers, sockets)
    else:
        daemon, instruments = assembly.start(loaded, real, workers, sockets)
    daemon.on_failure = note
    daemon.notifier = notifier
    daemon.incidents.listeners.append(incident_teller(as_json))
    if daemon.faults is not None:
        daemon.faults.listeners.append(fault_teller(as_json))
    if isinstance(daemon, VirtualDaemon):
        daemon.waits_for_hosts, daemon.reports_alone = not no_wait, True
        if answer_wait is not None:
            daemon.answer_ns = round(answer_wait * 1e9)
    if realtime and (refused := be_realtime()):
        note(f"--realtime: {refused}; normal scheduling is used")
    transcript = watched(instruments) if isinstance(daemon, VirtualDaemon) else None
    server = None
    recorder: Recorder | None = None
    lockstep: LockstepServer | None = None
    osi: OsiOut | None = None
    driver: subprocess.Popen[bytes] | None = None
    now_ns = (lambda: daemon.now_ns) if isinstance(daemon, VirtualDaemon) else real.now_ns
    try:
        feed_url = None if daemon.feeding is None else daemon.feeding.open()
        lockstep = lockstep_of(daemon)
        feed_url = feed_url if lockstep is None else lockstep.url
        recorder = recorder_for(loaded, instruments, record, daemon, now_ns)
        newest = None if lockstep is None else lockstep.newest
        osi = field_formats(loaded, instruments, recorder, daemon.feeding, note, newest)
        with daemon.signals():
            real.restart()
            if leash is not None:
                leash.watch(lambda: daemon.stop("the standard input has ended"), daemon.call)
            server = control_of(daemon, instruments, real, loaded, recorder, control, ending.until_ns)
            daemon.power_on()
            if daemon.feeding is not None and recorder is not None:
                daemon.feeding.on_update = recorder.feed
            announce_ready(loaded, instruments, as_json, server.url, ending, feed_url)
            kinds = {link.kind for one in instruments for link in one.links}
            if isinstance(daemon, VirtualDaemon) and LinkKind.CAN in kinds:
                note("CAN time stamps are virtual: seconds since the start of the run")
            if command:
                linked = [(item.sensor, item.links[0].url) for item in instruments if item.links]
                environment = driver_environment(environment, linked)
                environment |= {} if feed_url is None else {FEED: feed_url}
                environment |= {} if sockets is None else sockets.environment()
                driver = start_driver(command, environment, as_json)
            daemon.run(ending.until_ns, None if driver is None else lambda: driver.poll() is None)
            ended_ns = now_of(daemon, real)
            check_accounts(instruments, daemon.incidents, ended_ns)
    finally:
        if server is not None:
            server.close()
        if lockstep is not None:
            lockstep.close()
        daemon.close()
        if recorder is not None:
            recorder.close()
        if osi is not None:
            osi.close()
        driver_code = None if driver is None else end_driver(driver)
    recorded = None if recorder is None else recorder.state()
    if daemon.feeding is not None:
        for line in (
            daemon.feeding.lines() if not as_json else [json.dumps({"event": "feed"} | daemon.feeding.report())]
        ):
            say(line)
    digest: dict[str, object] = {}
    if transcript is not None and isinstance(daemon, VirtualDaemon):
        digest = {"sha256": transcript.sha256(), "late_answers": daemon.late_answers}
    announce_end(instruments, as_json, digest, daemon.incidents, recorded, daemon.why, ended_ns * 1e-9)
    for cause, count in daemon.failures.items():
        note(f"{count} scans could not be measured: {cause}")
    if not as_json and isinstance(daemon, VirtualDaemon) and daemon.late_text:
        say(daemon.late_text)
    if driver_code not in (None, 0):
        note(f"{command[0]} ended with {how_it_ended(driver_code)}")
    if daemon.lost_links:
        return LINK_LOST
    if driver_code not in (None, 0):
        return FAILED
    return daemon.incidents.exit_code


def lockstep_of(daemon: Daemon | VirtualDaemon) -> LockstepServer | None:
    """Who listens for a feeder that moves time; None: nobody does."""
    from emulator.runtime.lockstep import LockstepServer
    from emulator.runtime.virtual_daemon import VirtualDaemon

    if daemon.feeding is None or not daemon.feeding.live.lockstep:
        return None
    if not isinstance(daemon, VirtualDaemon):
        raise LinkError(f"{daemon.feeding.live.feed}: moves time, which is real; want --clock virtual or --speed")
    return LockstepServer(daemon, daemon.feeding)


def keep_running(command: Sequence[str], until_eof: bool, record: Path | None) -> int:
    """A guardian instead of a run: the same words start daemons until one ends in order."""
    if command or until_eof:
        raise click.UsageError("--restart cannot be combined with a COMMAND or --until-eof")
    from emulator.process.clock import SystemClock
    from emulator.runtime import guardian

    keeper = guardian.Keeper(click.get_current_context().find_root().obj, record)
    try:
        with keeper.signals():
            return guardian.guard(keeper.serve, keeper.pause, note, SystemClock())
    finally:
        keeper.close()


def now_of(daemon: Daemon | VirtualDaemon, clock: Clock) -> int:
    """The instant of a run, on the clock that it runs by."""
    from emulator.runtime.virtual_daemon import VirtualDaemon

    return daemon.now_ns if isinstance(daemon, VirtualDaemon) else clock.now_ns()


def fault_teller(as_json: bool) -> Callable[[str, FaultEvent], None]:
    """Reports each fault that it begins and ends; single hits are recorded and counted."""

    def tell(sensor: str, event: FaultEvent) -> None:
        if event.what == "hit":
            return
        if as_json:
            row = {"event": "fault", "what": event.what, "on": sensor, "do": event.name, "number": event.number}
            say(json.dumps(row | {"at_s": event.at_ns * 1e-9} | ({"detail": event.detail} if event.detail else {})))
        else:
            ended = f"ends: {event.detail}" if event.what == "end" else "begins"
            note(f"{event.at_ns * 1e-9:.3f} s: {sensor}: fault {event.number}, {event.name}, {ended}")

    return tell


def announce_ready(
    scenario: Scenario,
    instruments: Sequence[Instrument],
    as_json: bool,
    control: str,
    ending: Ending,
    feed: str | None = None,
) -> None:
    """Say where hosts can connect, every link accepts one by now, and how long."""
    from emulator.scenario.vehicle_options import NAME as VEHICLE_BUS
    from emulator.sensors.spec import name_of

    models = {sensor.id: name_of(sensor.model) for sensor in scenario.sensors} | {VEHICLE_BUS: "the ego's own motion"}
    if as_json:
        sensors = [
            {"id": item.sensor, "model": models[item.sensor], "links": [link.url for link in item.links]}
            for item in instruments
        ]
        fed = {} if feed is None else {"feed": feed}
        say(json.dumps({"event": "ready", "sensors": sensors, "control": control} | fed | ending.as_json()))
        return
    for item in instruments:
        for link in item.links:
            say(f"ready: {item.sensor} ({models[item.sensor]}) on {link.url}")
    if feed is not None:
        say(f"ready: poses on {feed}")
    say(ending.reported())


def watched(instruments: Sequence[Instrument]) -> Transcript:
    """The digest of a run's wire bytes with their virtual times, as `test` reports it."""
    from emulator.recording.transcript import Transcript

    transcript = Transcript([one.sensor for one in instruments])
    for instrument in instruments:
        instrument.watch(transcript)
    return transcript


def incident_teller(as_json: bool) -> Callable[[Incident], None]:
    """Reports each incident when it happens."""

    def tell(incident: Incident) -> None:
        if as_json:
            say(json.dumps({"event": "incident"} | incident.as_json()))
        else:
            note(f"{incident.at_ns * 1e-9:.3f} s: {incident.on}: {incident.kind}: {incident.text}")

    return tell


LATE_US = 1_000
"Of a packet's instant, by which its send may be late."


def lateness_of(late: Mapping[str, Any]) -> str:
    """What is said of the lateness of a sensor's sends; `late` as of `summary`, of one send at least."""
    text = (
        f"lateness of {late['sends']} sends: median {late['median']:.0f} us,"
        f" p99 {late['p99']:.0f} us, worst {late['worst']:.0f} us"
    )
    beyond = late["sends"] - sum(count for edge, count in late["histogram"] if 0 < edge <= LATE_US)
    return text if 100 * beyond <= late["sends"] else f"{text}; {beyond} of them later than {LATE_US / 1000:g} ms"


def announce_end(
    instruments: Sequence[Instrument],
    as_json: bool,
    digest: dict[str, object],
    incidents: Incidents,
    recording: Mapping[str, object] | None,
    why: str,
    ended_s: float,
) -> None:
    """Say why the run ended and what each sensor did: scans sent, dropped, rate, lateness of sends.

    `digest`: of a run in virtual time; of others empty.

    `recording`: how it stands with it, None when the run was not recorded.
    """
    from emulator.instrument.summary import summary
    from emulator.objects.metrics import reported

    totals = [summary(item) for item in instruments]
    if as_json:
        reported_of = {"recording": recording, "incidents": incidents.rows(), "incident_totals": incidents.totals()}
        ended = {"why": why, "ended_s": ended_s}
        say(json.dumps({"event": "stopped", **ended, "sensors": totals} | reported_of | digest))
        return
    say(f"ended after {ended_s:.3f} s: {why}")
    for total in totals:
        dropped = ", ".join(f"{count} {reason}" for reason, count in total["scans_dropped"].items()) or "none"
        rate = "-" if total["scans_per_s"] is None else f"{total['scans_per_s']:.3f}/s"
        if "vehicle_bus" not in total:
            say(f"{total['id']}: {total['scans_sent']} scans sent, {rate}; dropped: {dropped}")
        account = total["account"]
        if account["under_way"] or account["unaccounted"]:
            rest = f"{account['under_way']} in flight, {account['unaccounted']} unaccounted"
            say(f"{total['id']}: {account['asked']} scans requested: {rest}")
        late = total["lateness_us"]
        if late["sends"]:
            say(f"{total['id']}: {lateness_of(late)}")
        for link in total["links"]:
            if link["payloads_dropped"]:
                count = link["payloads_dropped"]
                say(f"{total['id']}: {count} payloads not sent: a host reads {link['url']} too slowly")
        ignored = ", ".join(f"{count} {reason}" for reason, count in total["input_dropped"].items())
        if ignored:
            garbled = sum(link["bytes_garbled"] for link in total["links"])
            probing = (
                f"; {garbled} bytes at another line speed than the host's, as when it tries speeds" if garbled else ""
            )
            say(f"{total['id']}: input dropped: {ignored}{probing}")
        for name, row in total.get("faults", {}).items():
            say(f"{total['id']}: fault {name}: begun {row['begun']} times, {row['hits']} hits")
        if "vehicle_bus" in total:
            account = total["vehicle_bus"]
            counts = ", ".join(f"{count} {name}" for name, count in account["frames"].items()) or "none"
            skipped = sum(account["skipped"].values())
            say(f"{total['id']}: frames: {counts}" + (f"; {skipped} skipped, a cycle late" if skipped else ""))
        if "objects" in total:
            for line in reported(total["objects"]):
                say(f"{total['id']}: {line}")
    for kind, count in incidents.totals().items():
        say(f"incidents: {count} {kind}")
    if recording is not None and recording["state"] == "ended":
        say(f"recording: ended at {recording['at_s']:.3f} s: {recording['why']}; {recording['folder']}")
    if digest:
        say(f"sha256 of all wire bytes with their virtual times: {digest['sha256']}")


# ---------------------------------------------------------------- what there is


LISTABLE = ("sensors", "scenarios", "materials", "links", "faults", "commands", "device")


@commands.command(name="list")
@click.argument("what", type=click.Choice(LISTABLE))
@click.argument("name", required=False, metavar="[FAMILY | MODEL | FAULT]")
@click.option("--json", "as_json", is_flag=True, help="One JSON object per line.")
def list_(what: str, name: str | None, as_json: bool) -> int:
    """Sensors, scenarios, materials, links, faults or the keys of a FAULT, the commands of a protocol FAMILY, or the
    `device:` keys of a MODEL.
    """
    from emulator.commands import catalogue

    try:
        rows = catalogue.rows(what, name)
    except KeyError as error:
        raise click.UsageError(str(error.args[0])) from None
    for row in rows:
        say(json.dumps(row) if as_json else "  ".join(str(value) for value in row.values() if value != ""))
    return OK


COMMANDS = (
    demo, look, print_transcript, probe, report, test, campaign, replay, diff, export, ctl, doctor, study, explain,
    view, fmu,
)  # fmt: skip
for command in COMMANDS:
    commands.add_command(command)

study.add_command(fuzz)
study.add_command(soak)

__all__ = ["CANNOT_RUN", "OK", "LinkError", "entry", "main"]
