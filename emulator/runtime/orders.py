"""Orders to a running daemon: the methods of the control socket and of `lidaremu ctl`.

docs/control.md has every method with an example; a test holds the page to `Orders.methods`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Future, wait
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from emulator.instrument.instrument import Instrument
from emulator.instrument.summary import summary
from emulator.live.json_lines import update_of
from emulator.live.samples import BadSample
from emulator.measuring.measuring import Judges
from emulator.process.clock import Clock
from emulator.runtime.control import BAD_PARAMS, REFUSED, Later, Method, OrderError
from emulator.runtime.daemon import Daemon
from emulator.runtime.metrics import prometheus
from emulator.runtime.snapshots import Snapshots
from emulator.runtime.virtual import ByteSteps
from emulator.runtime.virtual_daemon import VirtualDaemon

if TYPE_CHECKING:
    from emulator.injection.run import FaultRun
    from emulator.scenario.scenario import Scenario
    from emulator.scenario.weather import WeatherConfig

LONGEST_STEP_S = 3600.0
LONGEST_S = 1e9
SLOWEST, FASTEST = 1e-3, 1e6
"Virtual seconds a real one."
JUDGED_S = 2.0
"Real time for which an answer about weather waits for what those who measure say of it."
MOST_SCANS = 100_000
MOST_BYTES = 10_000_000
NOTHING_MORE_NS = 10_000_000_000
"A step by scans or bytes goes no further than this where none comes."


def _taken(params: Mapping[str, Any], **allowed: tuple[float, float]) -> dict[str, float]:
    """Numbers by name within their bounds; `OrderError` names what is allowed."""
    reported = ", ".join(f"{name}: {low:g} to {high:g}" for name, (low, high) in allowed.items()) or "nothing"
    found = {}
    for name, value in params.items():
        low, high = allowed.get(name, (1.0, 0.0))
        if isinstance(value, bool) or not isinstance(value, int | float) or not low <= value <= high:
            raise OrderError(BAD_PARAMS, f"{name}: {value!r}; want {reported}")
        found[name] = float(value)
    return found


class Orders:
    """The methods of one run."""

    def __init__(
        self,
        daemon: Daemon | VirtualDaemon,
        instruments: Sequence[Instrument],
        clock: Clock,
        scenario: Scenario,
        note: Callable[[int, dict[str, object]], None] = lambda now_ns, row: None,
    ) -> None:
        """`note` is informed of every order that changes something. To be made before the devices are switched on."""
        self._recording: Callable[[], dict[str, object] | None] = lambda: None
        self.until_ns: int | None = None
        "When the run ends by itself; None: it goes on until it is stopped."
        self._daemon = daemon
        self._instruments = tuple(instruments)
        self._clock = clock
        self._note = note
        self._scenario = scenario
        self._weather = scenario.weather
        self._snapshots = Snapshots(daemon, instruments, clock, scenario)
        self._byte_steps: dict[tuple[str, int], ByteSteps] = {}
        if isinstance(daemon, VirtualDaemon):
            for one in instruments:
                for link in range(len(one.links)):
                    steps = self._byte_steps[one.sensor, link] = ByteSteps(daemon.run_of, one.sensor, link)
                    one.watch(steps)

    def record(self, note: Callable[[int, dict[str, object]], None], state: Callable[[], dict[str, object]]) -> None:
        """The run is recorded: `note` is informed of orders, `state` shows how it stands with the recording."""
        self._note, self._recording = note, state

    def methods(self) -> dict[str, Method]:
        """Name -> method."""
        return {
            "status": self.status,
            "metrics": self.metrics,
            "weather": self.weather_judged,
            "poses": self.poses,
            "pause": self.pause,
            "resume": self.resume,
            "step": self.step,
            "speed": self.speed,
            "stop": self.stop,
            "fault": self.fault,
            "fault_clear": self.fault_clear,
            "faults": self.faults,
        } | self._snapshots.methods()

    def _now_ns(self) -> int:
        return self._daemon.now_ns if isinstance(self._daemon, VirtualDaemon) else self._clock.now_ns()

    def _virtual(self, what: str) -> VirtualDaemon:
        if not isinstance(self._daemon, VirtualDaemon):
            raise OrderError(REFUSED, f"{what}: not possible in real time; want a run with --clock virtual or --speed")
        return self._daemon

    def _did(self, what: str, **more: object) -> dict[str, object]:
        self._note(self._now_ns(), {"event": "Order", "order": what} | more)
        return {"now_s": self._now_ns() * 1e-9}

    def _read_ledgers(self) -> None:
        """Sensors that wait for a scan have not been stepped: what has passed meanwhile is on account too."""
        for one in self._instruments:
            one.ledger.now_ns = max(one.ledger.now_ns, self._now_ns())

    def status(self, params: Mapping[str, Any]) -> object:
        """Clock, time, and what each sensor did so far."""
        _taken(params)
        self._read_ledgers()
        virtual = isinstance(self._daemon, VirtualDaemon)
        return {
            "scenario": str(self._scenario.source.stem),
            "ends_at_s": None if self.until_ns is None else self.until_ns * 1e-9,
            "clock": "virtual" if virtual else "real",
            "now_s": self._now_ns() * 1e-9,
            "paused": self._daemon.paused if isinstance(self._daemon, VirtualDaemon) else False,
            "sensors": [
                summary(one) | {"silent_s": self._daemon.liveness.silent_s(one.sensor)} for one in self._instruments
            ],
            "workers": self._daemon.worker_rows(),
            "recording": self._recording(),
            "incidents": self._daemon.incidents.rows(),
            "incident_totals": self._daemon.incidents.totals(),
        } | ({} if self._daemon.feeding is None else {"feed": self._daemon.feeding.report()})

    def metrics(self, params: Mapping[str, Any]) -> object:
        """Counters and the histogram of lateness as Prometheus text."""
        _taken(params)
        self._read_ledgers()
        return prometheus(self._instruments, self._daemon.incidents, self._daemon.liveness)

    def weather(self, params: Mapping[str, Any]) -> dict[str, Any]:
        """Tables of `weather:` laid over what holds, from the next sweep asked for on; without any: what holds."""
        from emulator.scenario.live_weather import changed, state_of

        now_ns = self._now_ns()
        if not params:
            return {"now_s": now_ns * 1e-9, "weather": state_of(self._weather_of_round(now_ns), now_ns * 1e-9)}
        # one instant for all sensors, after every sweep that is measured already: the same run can be had from a file
        from_ns = max([now_ns, *(one.asked_ns + 1 for one in self._instruments)])
        found = changed(self._weather_of_round(from_ns), params, from_ns, [actor.id for actor in self._scenario.actors])
        self._weather = found.weather
        for one in self._instruments:
            one.conditions = replace(one.conditions, weather=found.weather)
        from_s = found.entry["t_s"]
        state = state_of(self._weather, from_s)
        # one reading of the clock: `from_s` is never before the `now_s` that stands beside it
        return self._did("weather", change=found.entry) | {"now_s": now_ns * 1e-9, "from_s": from_s, "weather": state}

    def poses(self, params: Mapping[str, Any]) -> object:
        """Where actors are, by the keys of a line of the JSON feed; without any: what came of the feed."""
        feeding, now_ns = self._daemon.feeding, self._now_ns()
        if feeding is None:
            raise OrderError(REFUSED, "poses: the world of this run moves by its file; want a scenario with live:")
        if not params:
            return {"now_s": now_ns * 1e-9, "feed": feeding.report()}
        try:
            update = update_of(params)
        except BadSample as error:
            raise OrderError(BAD_PARAMS, str(error)) from None
        before = feeding.book.counts.copy()
        used = feeding.take(update, now_ns, again=True)
        wrong = feeding.book.counts - before
        wrong.pop("received", None)
        return {"now_s": now_ns * 1e-9, "used": used, "wrong": dict(wrong)}

    def _weather_of_round(self, at_ns: int) -> WeatherConfig:
        """Of a scenario that begins again: the changes of this round; an order ends them with it."""
        if self._scenario.round_s is None or self._weather is not self._scenario.weather:
            return self._weather
        return self._weather.later(at_ns // round(self._scenario.round_s * 1e9) * self._scenario.round_s)

    def weather_judged(self, params: Mapping[str, Any]) -> object:
        """The same; beside it the sensors that cannot compute such weather, and go on with the scenario's own."""
        reported: dict[str, Any] = self.weather(params)
        asked: list[Future[dict[str, str]]] = []
        for measuring in {id(one.measuring): one.measuring for one in self._instruments}.values():
            if params and isinstance(measuring, Judges):
                asked += measuring.judge(self._weather)

        def whole() -> object:
            done, _ = wait(asked, JUDGED_S)
            refused = {sensor: why for one in done for sensor, why in one.result().items()}
            return reported | ({"not_computed": refused} if refused else {})

        return Later(whole) if asked else reported

    def pause(self, params: Mapping[str, Any]) -> object:
        """Virtual time stands, now or as soon as it is `at_s`."""
        wanted = _taken(params, at_s=(0.0, LONGEST_S))
        daemon = self._virtual("pause")
        if wanted:
            daemon.pause_at_ns = round(wanted["at_s"] * 1e9)
        else:
            daemon.paused = True
        return self._did("pause", **wanted)

    def resume(self, params: Mapping[str, Any]) -> object:
        """Virtual time goes on."""
        _taken(params)
        daemon = self._virtual("resume")
        daemon.paused = False
        daemon.rebase(daemon.speed)
        return self._did("resume")

    def step(self, params: Mapping[str, Any]) -> object:
        """Virtual time moves by so many scans, bytes or seconds, or to an instant; one scan if nothing is said."""
        daemon = self._virtual("step")
        numbers = {name: value for name, value in params.items() if name not in ("sensor", "link")}
        now_s = daemon.now_ns * 1e-9
        wanted = _taken(
            numbers,
            scans=(1, MOST_SCANS),
            bytes=(1, MOST_BYTES),
            seconds=(0, LONGEST_STEP_S),
            to_s=(now_s, now_s + LONGEST_STEP_S),
        )
        for name in ("scans", "bytes"):
            if not float(wanted.get(name, 0)).is_integer():
                raise OrderError(BAD_PARAMS, f"{name}: {wanted[name]:g}; want a whole number")
        if len(wanted) > 1:
            raise OrderError(BAD_PARAMS, f"{' and '.join(wanted)}; want one of scans, bytes, seconds, to_s")
        what, count = next(iter(wanted.items()), ("scans", 1.0))
        sensor, link = self._place(params, what)
        daemon.paused = True
        before_ns, done = daemon.now_ns, 0
        if what == "seconds":
            daemon.advance(before_ns + round(count * 1e9))
        elif what == "to_s":
            daemon.advance(max(before_ns, round(count * 1e9)))
        elif what == "scans":
            done = daemon.run_of.step_scans(int(count), before_ns + NOTHING_MORE_NS, sensor)
        else:
            done = self._byte_steps[sensor or "", link].step(int(count), before_ns + NOTHING_MORE_NS)
        reported: dict[str, object] = {what: done} if what in ("scans", "bytes") else {}
        named = {name: params[name] for name in ("sensor", "link") if name in params}
        if done < count and reported:
            reported["why"] = self._why_nothing(what, done, sensor)
        return self._did("step", **(wanted or {"scans": 1.0}), **named) | reported

    def _why_nothing(self, what: str, done: int, sensor: str | None) -> str:
        """Why a step ended before all its scans or bytes had come, in words."""
        reasons = []
        for one in self._instruments:
            if sensor in (None, one.sensor):
                if not any(link.has_host() for link in one.links):
                    reasons.append(f"{one.sensor}: no host is connected")
                elif not one.stats.scans_sent:
                    reasons.append(f"{one.sensor}: no host has asked for scans yet")
                else:
                    reasons.append(f"{one.sensor}: its device has sent all that was asked for")
        return f"{done} {what} within {NOTHING_MORE_NS * 1e-9:g} virtual s; {'; '.join(reasons)}"

    def _place(self, params: Mapping[str, Any], what: str) -> tuple[str | None, int]:
        """Whose scans or bytes are counted: of all sensors or one; bytes of one link, by default the very first."""
        sensor, link = params.get("sensor"), params.get("link", 0)
        known = [one.sensor for one in self._instruments]
        if ("sensor" in params and what not in ("scans", "bytes")) or ("link" in params and what != "bytes"):
            raise OrderError(
                BAD_PARAMS, f"sensor or link beside {what}; want sensor for scans and bytes, link for bytes"
            )
        if sensor is not None and sensor not in known:
            raise OrderError(BAD_PARAMS, f"sensor: {sensor!r}; want one of {', '.join(known)}")
        if what != "bytes":
            return sensor, 0
        sensor = sensor if sensor is not None else known[0]
        links = sum(name == sensor for name, _ in self._byte_steps)
        if isinstance(link, bool) or not isinstance(link, int) or not 0 <= link < links:
            raise OrderError(BAD_PARAMS, f"link: {link!r}; {sensor} has {links}, counted from 0")
        return sensor, link

    def speed(self, params: Mapping[str, Any]) -> object:
        """Virtual seconds a real one; `x` 0: as fast as hosts read."""
        wanted = _taken(params, x=(0, FASTEST))
        if 0 < wanted.get("x", 0) < SLOWEST:
            raise OrderError(BAD_PARAMS, f"x: {wanted['x']:g}; want 0, or {SLOWEST:g} to {FASTEST:g}")
        daemon = self._virtual("speed")
        daemon.rebase(wanted.get("x", 0.0) or None)
        return self._did("speed", **wanted)

    def fault(self, params: Mapping[str, Any]) -> object:
        """One more fault, by the keys of a scenario's `faults:`; without a trigger it begins at once. Its number."""
        from emulator.faults.reading import FaultError

        try:
            number = self._faults().add(params, self._now_ns())
        except FaultError as error:
            raise OrderError(BAD_PARAMS, str(error)) from None
        return self._did("fault", **params) | {"number": number}

    def fault_clear(self, params: Mapping[str, Any]) -> object:
        """End the fault of that `number` for good, or all; what they did."""
        from emulator.faults.reading import FaultError

        run = self._faults()
        number = params.get("number")
        if set(params) - {"number"} or (number is not None and type(number) is not int):
            raise OrderError(BAD_PARAMS, f"{dict(params)}; want number: that of a fault, or nothing for all")
        numbers = [int(str(row["number"])) for row in run.rows()] if number is None else [number]
        try:
            rows = [run.clear(one, self._now_ns()) for one in numbers]
        except FaultError as error:
            raise OrderError(BAD_PARAMS, str(error)) from None
        return self._did("fault_clear", **params) | {"faults": rows}

    def faults(self, params: Mapping[str, Any]) -> object:
        """All faults of the run: number, sensor, name, state, how often begun, hits, what they took away."""
        _taken(params)
        return {"now_s": self._now_ns() * 1e-9, "faults": self._faults().rows()}

    def _faults(self) -> FaultRun:
        if self._daemon.faults is None:
            raise OrderError(REFUSED, "faults: not possible in this run; want a run of a scenario")
        return self._daemon.faults

    def stop(self, params: Mapping[str, Any]) -> object:
        """End the run as SIGTERM does."""
        _taken(params)
        self._daemon.stop("ordered: ctl stop")
        return self._did("stop")
