"""From a scenario to running parts: measuring functions in the workers, instruments in the sender."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import TYPE_CHECKING

from emulator.compiled import build, switch
from emulator.errors import LinkError
from emulator.injection.run import FaultRun
from emulator.instrument.device_clock import with_clock
from emulator.instrument.instrument import Instrument, Measuring
from emulator.instrument.vehicle_bus import VehicleSession
from emulator.measuring.measuring import InPlace, Measure, Measures
from emulator.measuring.supervision import Workers, worker_count
from emulator.process.clock import Clock, wall_ns
from emulator.process.incidents import Incidents
from emulator.runtime.daemon import Daemon
from emulator.runtime.feeding import Feeding
from emulator.runtime.virtual_daemon import VirtualDaemon
from emulator.scenario.scenario import Scenario
from emulator.sensors.spec import load_spec
from emulator.transports.announcing import Announcer
from emulator.transports.can_link import CanPorts
from emulator.transports.link import Link
from emulator.transports.loopback import Loops
from emulator.transports.schemes import open_link
from emulator.transports.urls import host_and_port, parse_url
from emulator.world.felt import BEFORE_S, MountMotion
from protocols import family
from protocols.can_objects.layout import database_of
from protocols.errors import DeviceSettingError
from protocols.session import Address, Family, LinkKind, Session
from protocols.timebase import inside

BEAMS_A_PROCESS = 200_000.0
"Beams per second that one core measures of a street with footprints, about (docs/velodyne.md)."
MOST_PARTS = 4
"Of a sweep: with more the part in the middle of the fan takes hardly less time."
MOST_STEPS = 5000
"Of a session, until it asks for its first slice."

if TYPE_CHECKING:
    from emulator.casting.raycast import Caster
    from emulator.transports.can_sockets import CanSockets
    from emulator.world.scene import Scene


def build_measures(scenario: Scenario) -> Mapping[str, Measure]:
    """Scene and measuring function of every sensor; imports the ray caster, so it runs where scans are measured."""
    from emulator.world import scene

    world = scene.build(scenario)
    measures = measures_of(scenario, world)
    if world.fed is not None:
        from emulator.sensing.placed import Placed

        measures = {name: Placed(measure, world.fed, world.turned_ns) for name, measure in measures.items()}
    return Measures(measures, world.warnings)


class SameScene:
    """`build_measures` for one scenario after the other: the scene is built again where it is another."""

    def __init__(self) -> None:
        self._of: tuple[object, ...] = ()
        self._made: tuple[Scene, Caster] | None = None

    def __call__(self, scenario: Scenario) -> Mapping[str, Measure]:
        """As `build_measures`."""
        from emulator.casting import raycast
        from emulator.world import scene

        if scenario.live is not None:  # its world is moved by one run
            return build_measures(scenario)
        of = scenario.source, scenario.world, scenario.actors, scenario.materials, scenario.round_s
        if self._made is None or of != self._of:
            world = scene.build(scenario)
            self._of, self._made = of, (world, raycast.Caster(world))
        world, caster = self._made
        return Measures(measures_of(scenario, world, caster), world.warnings)


def measures_of(scenario: Scenario, world: Scene, caster: Caster | None = None) -> Mapping[str, Measure]:
    """The measuring function of every sensor in that scene; a `physics:` table that cannot be is reported here.

    `caster`: of this scene, where there is one already; what it keeps depends on nothing else.
    """
    from emulator.casting import raycast
    from emulator.sensing.measure import build as build_measure

    caster = raycast.Caster(world) if caster is None else caster
    seeing = [sensor.id for sensor in scenario.sensors if load_spec(sensor.model).sees == "beams"]
    measures: dict[str, Measure] = {name: build_measure(scenario, world, caster, name) for name in seeing}
    return measures if len(seeing) == len(scenario.sensors) else measures | _object_measures(scenario, world, measures)


def _object_measures(scenario: Scenario, world: Scene, measures: Mapping[str, Measure]) -> dict[str, Measure]:
    """Measuring functions of the sensors that list objects; each drives its sources with sessions of its own."""
    from emulator.objects import measure

    index_of = {sensor.id: index for index, sensor in enumerate(scenario.sensors)}
    made: dict[str, Measure] = {}
    for sensor in scenario.sensors:
        if sensor.id not in measures:
            spoken = [name for name in sensor.from_ if load_spec(scenario.sensors[index_of[name]].model).family]
            sessions = {name: new_session(scenario, index_of[name]) for name in spoken}
            made[sensor.id] = measure.build(scenario, world, measures, sessions, sensor.id)
    return made


def shared_sensors(scenario: Scenario) -> list[str]:
    """Sensors that remember nothing from sweep to sweep: several processes may measure one of them."""
    return [sensor.id for sensor in scenario.sensors if load_spec(sensor.model).sees == "beams"]


def why_one_at_a_time(scenario: Scenario, index: int) -> str:
    """Why no two processes measure that sensor at once; empty: they do."""
    spec = load_spec(scenario.sensors[index].model)
    if spec.sees != "beams":
        return "it remembers the tracks of its objects"
    if spec.family is None:
        return ""
    session, _ = inside(new_session(scenario, index), 0)
    foresees = getattr(session, "FORESEES", type(session).plan_after is not Session.plan_after)
    return "" if foresees else "its protocol does not tell the next sweep"


def useful_processes(scenario: Scenario) -> int:
    """How many measuring processes the sensors can keep busy: one each, and more where one alone is not enough."""
    return sum(
        max(1, math.ceil(beams_per_s(scenario, index) / BEAMS_A_PROCESS)) for index in range(len(scenario.sensors))
    )


def fed_processes(scenario: Scenario) -> int:
    """Measuring processes among which a sweep of a world that somebody else moves is divided, in real time.

    They measure at the same time, as late as a sweep can be sent, and rest until the next one. One core is left to the
    sender: where two processes had both of two, poses were twice as old as with one.
    """
    moving = [one.id for one in scenario.sensors if one.mount.actor is not None]
    if scenario.live is None or not set(moving) & set(shared_sensors(scenario)):
        return 1
    return max(1, min(len(os.sched_getaffinity(0)) - 1, MOST_PARTS))


def beams_per_s(scenario: Scenario, index: int) -> float:
    """Of a sensor that measures without being asked, as its first slice has them; of others 0."""
    if load_spec(scenario.sensors[index].model).sees != "beams":
        return 0.0
    session = new_session(scenario, index)
    session.connected(0, Address(0, 0), LinkKind.DATAGRAM)
    session.power_on(0)
    for _ in range(MOST_STEPS):
        if (plan := session.next_plan()) is not None:
            return len(plan) / plan.duration_s if plan.duration_s else 0.0
        if (deadline_ns := session.next_deadline()) is None:
            return 0.0
        session.advance(deadline_ns)
        session.take_emissions(deadline_ns)
    return 0.0


def family_of(scenario: Scenario, index: int) -> Family:
    """The protocol family of a sensor; `ScenarioError` for a model without a wire protocol."""
    name = load_spec(scenario.sensors[index].model).family
    if name is None:
        raise scenario.fault(
            f"sensors.{index}.model", scenario.sensors[index].model, "a model with a wire protocol (see `list sensors`)"
        )
    return family(name)


def new_session(scenario: Scenario, index: int) -> Session:
    """The conversation of one sensor, switched off; `ScenarioError` when its `device` table does not fit the model."""
    sensor = scenario.sensors[index]
    try:
        session = family_of(scenario, index).new_session(sensor.device, load_spec(sensor.model).device)
    except DeviceSettingError as error:
        raise scenario.fault(f"sensors.{index}.device.{error.key}", error.found, error.allowed) from None
    session.feel(MountMotion(scenario, index).at)
    try:
        return with_clock(session, sensor.clock)
    except DeviceSettingError as error:
        raise scenario.fault(f"sensors.{index}.clock.{error.key}", error.found, error.allowed) from None


def new_sessions(scenario: Scenario) -> list[Session]:
    """The conversations of all sensors, in the scenario's order."""
    return [new_session(scenario, index) for index in range(len(scenario.sensors))]


def open_instruments(
    scenario: Scenario,
    sessions: Sequence[Session],
    measuring: Measuring,
    loops: Loops | None = None,
    can_ports: CanPorts | None = None,
) -> list[Instrument]:
    """Open every link of every sensor; when one cannot be opened, the others are closed again.

    `loops` holds the host's end of every `loop:NAME`; `can_ports` the buses. Behind the sensors comes who sends the
    ego's own motion, if there is one.
    """
    opened: list[Link] = []
    can_ports = CanPorts() if can_ports is None else can_ports
    instruments = []
    try:
        for index, (sensor, session) in enumerate(zip(scenario.sensors, sessions, strict=True)):
            tcp_is_line = family_of(scenario, index).tcp_is_line
            links = []
            for url in sensor.links:
                bitrate = session.can_bitrate
                links.append(open_link(url, tcp_is_line, loops=loops, can_ports=can_ports, can_bitrate=bitrate))
                opened.append(links[-1])
            instruments.append(Instrument(sensor.id, session, links, measuring))
            instruments[-1].family = family_of(scenario, index)
        instruments += open_vehicle(scenario, measuring, lambda url: open_link(url, can_ports=can_ports))
    except BaseException:
        for link in opened:
            link.close()
        raise
    return instruments


def open_vehicle(scenario: Scenario, measuring: Measuring, link: Callable[[str], Link]) -> list[Instrument]:
    """Who sends the ego's own motion on CAN: one, or nobody. `link` opens a link."""
    options = scenario.vehicle_bus
    if options is None:
        return []
    from emulator.scenario.vehicle_options import NAME, dbc_path
    from emulator.world.ego import EgoMotion

    try:
        database = database_of(dbc_path(options.dbc, scenario.folder))
    except (OSError, ValueError) as error:
        raise scenario.fault("vehicle_bus.dbc", f"{options.dbc}: {error}", "a DBC file that can be read") from None
    session = VehicleSession(options, database, EgoMotion(scenario, options.actor))
    return [Instrument(NAME, session, [link(options.link)], measuring)]


def feeding_of(
    scenario: Scenario, instruments: Sequence[Instrument], real_ns: Callable[[], int] | None
) -> Feeding | None:
    """Who moves the world of these instruments; None: the scenario alone. `real_ns`: None in virtual time."""
    if scenario.live is None:
        return None
    feeding, only = Feeding(scenario, scenario.live, instruments, real_ns), scenario.live.actors.fed
    index_of = {sensor.id: index for index, sensor in enumerate(scenario.sensors)}
    for one in instruments:
        session = one.session
        if not isinstance(session, VehicleSession):
            one.feed = feeding
            motion = MountMotion(scenario, index_of[one.sensor])
            if motion.actor is not None and (only is None or motion.actor in (*only, *scenario.live.slots)):
                motion.feed(partial(feeding.world_around, before_s=BEFORE_S))
                session.feel(motion.at)
        elif only is None or session.ego.actor in only:
            session.ego.feed(feeding.world_around)
    return feeding


def tell_vehicle(instruments: Sequence[Instrument], incidents: Incidents) -> None:
    """What the sender of the ego's motion has to tell goes to the incidents of the run."""
    for one in instruments:
        if isinstance(one.session, VehicleSession):
            one.session.on_limited = partial(incidents.note, "signal limited")


def start(
    scenario: Scenario, clock: Clock, workers: int | None = None, sockets: CanSockets | None = None
) -> tuple[Daemon, list[Instrument]]:
    """Everything of a real-time run, devices still switched off: workers first, links after them.

    Compiled loops that are wanted and not there yet are built beside it; until then its workers compute with numpy
    arrays.
    `sockets`: gives drivers under the preload shim an interface for each CAN bus.
    """
    sessions = new_sessions(scenario)
    names = [sensor.id for sensor in scenario.sensors]
    count = workers or max(worker_count(useful_processes(scenario)), fed_processes(scenario))
    build_loops = build.Builder if switch.wanted() and build.wanted() else None
    shared = shared_sensors(scenario)
    measuring = Workers(partial(build_measures, scenario), names, count, clock, build_loops=build_loops, shared=shared)
    ports = CanPorts(sockets, partial(wall_ns, clock))
    try:
        instruments = open_instruments(scenario, sessions, measuring, can_ports=ports)
    except BaseException:
        measuring.close()
        raise
    daemon = Daemon(instruments, clock, measuring)
    daemon.faults = FaultRun(scenario, instruments)
    daemon.feeding = feeding_of(scenario, instruments, clock.now_ns)
    tell_vehicle(instruments, daemon.incidents)
    if daemon.feeding is not None:
        daemon.feeding.call = daemon.call
        daemon.feeding.has_slices = measuring.has_slices
    try:
        daemon.announcer = announcer_of(instruments)
    except BaseException:
        daemon.close()
        raise
    return daemon, instruments


def announcer_of(instruments: Sequence[Instrument]) -> Announcer | None:
    """Who announces the devices that want it, at their first TCP links; None: nobody does."""
    found = []
    for one in instruments:
        if (announced := one.session.announced) is None:
            continue
        urls = [link.url for link in one.links if link.url.startswith("tcp:")]
        if not urls:
            raise LinkError(f"{one.sensor}: mdns: true without a TCP link; want one, as tcp:127.0.0.2:80")
        found.append((host_and_port(urls[0], parse_url(urls[0]).target)[0], announced))
    return Announcer(found) if found else None


def start_virtual(
    scenario: Scenario,
    speed: float | None = None,
    workers: int | None = None,
    sockets: CanSockets | None = None,
) -> tuple[VirtualDaemon, list[Instrument]]:
    """Everything of a run on a virtual clock, devices still switched off; without `workers` it measures in place.

    `sockets` as of `start`.
    """
    sessions = new_sessions(scenario)
    names = [sensor.id for sensor in scenario.sensors]
    measures = partial(build_measures, scenario)
    pool = Workers(measures, names, workers, shared=shared_sensors(scenario)) if workers else None
    try:
        measuring = InPlace(measures()) if pool is None else pool
        instruments = open_instruments(scenario, sessions, measuring, can_ports=CanPorts(sockets))
    except BaseException:
        if pool is not None:
            pool.close()
        raise
    daemon = VirtualDaemon(instruments, pool, speed, warnings=measuring.warnings)
    daemon.faults = FaultRun(scenario, instruments)
    daemon.feeding = feeding_of(scenario, instruments, None)
    tell_vehicle(instruments, daemon.incidents)
    if daemon.feeding is not None:
        daemon.feeding.call = daemon.call
    return daemon, instruments
