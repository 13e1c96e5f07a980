"""A running scenario inside a test: real links on free places, virtual time in a thread of its own.

The pytest fixture `lidaremu` gives these out; other test frameworks use `Rig` directly:

    with Rig("crossing_car", tmp_path, ["weather.fog.visibility_m=50"]) as rig:
        host = MyDriver(rig["front"].path, baud=38400)
        rig.advance(seconds=2)
"""

from __future__ import annotations

import socket
import threading
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any, TypeVar

from emulator.config.expressions import Value, evaluate, names, parse
from emulator.hosts.families import BUILT_IN, free_link
from emulator.injection.run import FaultRun
from emulator.instrument.instrument import Instrument
from emulator.instrument.ledger import check_accounts
from emulator.instrument.series import SeriesWatcher
from emulator.judging.expectations import Judgements, Run, understand, verdicts
from emulator.judging.trial import note_verdict
from emulator.live.json_lines import update_of
from emulator.recording.transcript import Transcript
from emulator.recording.writer import Recorder
from emulator.recording.writing import VIRTUAL
from emulator.runtime import assembly
from emulator.runtime.lockstep import LockstepServer
from emulator.scenario import scenario
from emulator.scenario.quantities import check_name
from emulator.sensors.spec import load_spec
from emulator.transports.urls import parse_url

TIME_LIMIT_S = 120.0
"Real seconds that a call may take before the test fails."

Found = TypeVar("Found")


@dataclass(frozen=True)
class RigSensor:
    """Where one sensor is found."""

    id: str
    urls: tuple[str, ...]

    @property
    def url(self) -> str:
        """Its first link."""
        return self.urls[0]

    @property
    def path(self) -> str:
        """Path of the first link on a pseudo-terminal."""
        found = [url for url in self.urls if url.partition(":")[0] in ("pty", "slcan")]
        if not found:
            raise LookupError(f"{self.id} has no pseudo-terminal but {', '.join(self.urls)}")
        return parse_url(found[0]).target

    @property
    def port(self) -> int:
        """Port of the first link that listens."""
        found = [url for url in self.urls if url.partition(":")[0] in ("tcp", "socketcand")]
        if not found:
            raise LookupError(f"{self.id} listens on no port but has {', '.join(self.urls)}")
        return int(parse_url(found[0]).target.partition("/")[0].rpartition(":")[2])


def free_links(loaded: scenario.Scenario, folder: Path) -> dict[str, list[str]]:
    """Links like the scenario's own on free ports and in `folder`; by family where it has none.

    Servers of CAN stay as many as they were: two ports are two buses, whatever their channels are called.
    """
    replaced: dict[str, list[str]] = {}
    servers: dict[str, int] = {}
    for index, sensor in enumerate(loaded.sensors):
        family = load_spec(sensor.model).family
        usual = free_link(family, sensor.id, folder) if family in BUILT_IN else None
        links = sensor.links or (() if usual is None else (usual,))
        replaced[sensor.id] = [_freed(url, folder, f"{index}-{number}", servers) for number, url in enumerate(links)]
    return replaced


def _free_port() -> int:
    with socket.socket() as asked:
        asked.bind(("127.0.0.1", 0))
        port: int = asked.getsockname()[1]
        return port


def _freed(url: str, folder: Path, name: str, servers: dict[str, int]) -> str:
    scheme, _, rest = url.partition(":")
    target, mark, options = rest.partition("?")
    if scheme in ("pty", "slcan"):
        target = str(folder / f"{scheme}-{name}")
    elif scheme == "tcp":
        target = "127.0.0.1:0"
    elif scheme == "socketcand":
        server, _, channel = target.partition("/")
        if server not in servers:  # the kernel chooses for the first; of several, 0 would be the same one
            servers[server] = _free_port() if servers else 0
        target = f"127.0.0.1:{servers[server]}/{channel}"
    return f"{scheme}:{target}{mark}{options}"


class Rig:
    """A scenario that runs while the `with` block does."""

    def __init__(
        self,
        name: str,
        folder: Path,
        overrides: Sequence[str] = (),
        seed: int | None = None,
        links: Mapping[str, str | Sequence[str]] | None = None,
        speed: float | None = None,
    ) -> None:
        """`folder`: where pseudo-terminals are linked. `links`: instead of free places of the scenario's own kinds."""
        first = scenario.load(name, overrides, seed)
        given = {sensor: [urls] if isinstance(urls, str) else list(urls) for sensor, urls in (links or {}).items()}
        replaced = {**free_links(first, folder), **given}
        self.scenario = scenario.load(name, overrides, seed, replaced)
        self.folder = folder
        self.recording = folder / "recording"
        "Everything of the run, for `lidaremu replay` and `diff`."
        self.on_verdict: Callable[[str], None] = lambda text: None
        "Informed of a verdict that is not good, or has warnings."
        self._speed = speed
        self._trouble: BaseException | None = None
        self._thread: threading.Thread | None = None

    def __enter__(self) -> Rig:
        self._expected = understand(self.scenario)
        self._daemon, self.instruments = assembly.start_virtual(self.scenario, self._speed)
        self._daemon.idles = False
        feeding = self._daemon.feeding
        self.feed_url = None if feeding is None else feeding.open()
        "Where poses are received, or who moves time in lock-step."
        self._lockstep = None if feeding is None or not feeding.live.lockstep else LockstepServer(self._daemon, feeding)
        if self._lockstep is not None:
            self.feed_url = self._lockstep.url
        ids = [sensor.id for sensor in self.scenario.sensors]
        self._transcript, self._series = Transcript(ids), SeriesWatcher(ids)
        for instrument in self.instruments:
            instrument.watch(self._transcript)
            instrument.watch(self._series)
        self.sensors = {
            one.sensor: RigSensor(one.sensor, tuple(link.url for link in one.links)) for one in self.instruments
        }
        self._recorder = Recorder(
            self.recording,
            self.scenario,
            self.instruments,
            incidents=self._daemon.incidents,
            now_ns=lambda: self._daemon.now_ns,
            manner=VIRTUAL,
        )
        if self._daemon.feeding is not None:
            self._daemon.feeding.on_update = self._recorder.feed
        self._daemon.power_on()
        self._thread = threading.Thread(target=self._serve, name="lidaremu-rig", daemon=True)
        self._thread.start()
        return self

    def _serve(self) -> None:
        try:
            self._daemon.run()
        except BaseException as error:
            self._trouble = error

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()
        if self._trouble is not None and error is None:
            raise RuntimeError("the run ended by itself") from self._trouble
        if self._recorder.failure and error is None:
            raise RuntimeError(f"{self._recorder.folder}: the recording ended early: {self._recorder.failure}")
        if (cut := self._daemon.incidents.exit_code) and error is None:
            reported = "; ".join(f"{row['on']}: {row['kind']}: {row['text']}" for row in self._daemon.incidents.rows())
            raise RuntimeError(f"the run had incidents (exit code {cut}): {reported}")
        if self._daemon.lost_links and error is None:
            raise RuntimeError(f"links were lost: {'; '.join(self._daemon.lost_links)}")

    def close(self) -> None:
        """End the run and release its links; may be called twice."""
        if self._thread is not None:
            if self._lockstep is not None:
                self._lockstep.close()
            self._daemon.stop()
            self._thread.join(TIME_LIMIT_S)
            self._thread = None
            check_accounts(self.instruments, self._daemon.incidents, self._daemon.now_ns)
            self._daemon.close()
            self._recorder.close()

    def __getitem__(self, sensor: str) -> RigSensor:
        if sensor not in self.sensors:
            raise KeyError(f"{sensor}; the scenario has {', '.join(self.sensors)}")
        return self.sensors[sensor]

    def _in_run(self, action: Callable[[], Found]) -> Found:
        if self._thread is None or not self._thread.is_alive():
            raise RuntimeError("the run has ended") from self._trouble
        found: Any = self._daemon.call(action).result(TIME_LIMIT_S)
        return found  # type: ignore[no-any-return]

    @property
    def now_s(self) -> float:
        """Virtual time since power-on. [s]"""
        return self._daemon.now_ns * 1e-9

    def advance(self, seconds: float) -> None:
        """Let so much virtual time pass; what hosts do not read meanwhile is kept for them."""
        span_ns = round(seconds * 1e9)
        self._in_run(lambda: self._daemon.advance(self._daemon.now_ns + span_ns))

    def step_scans(self, count: int = 1, sensor: str | None = None, at_most_s: float = 60.0) -> int:
        """Let time pass until so many more scans have been sent; how many it were."""
        run = self._daemon.run_of
        return self._in_run(lambda: run.step_scans(count, self._daemon.now_ns + round(at_most_s * 1e9), sensor))

    def pause(self) -> None:
        """Time moves by `advance` and `step_scans` alone, even while hosts wait."""
        self._daemon.paused = True

    def resume(self) -> None:
        """Time moves by itself again while a host waits and something is due."""
        self._daemon.paused = False
        self._in_run(lambda: None)

    def move(self, actor: str, at_m: Sequence[float], reference: str = "origin", **keys: Any) -> None:
        """Where an actor is now, in a scenario with `live:`; the other keys are those of docs/live_world.md.

        Beams up to now have seen it where it was on its way here; later ones go on from here with `velocity_m_s` and
        `turn_rate_deg_s`, without them as it moved between the last two calls. `BadSample` names what is wrong.
        """
        self.poses([{"id": actor, "at_m": list(at_m), "reference": reference, **keys}])

    def poses(self, actors: Sequence[Mapping[str, Any]], removed: Sequence[str] = (), snapshot: bool = False) -> None:
        """Where several actors are at this one instant; `removed` are gone, with `snapshot` all others too."""
        feeding = self._daemon.feeding
        if feeding is None:
            raise LookupError("this scenario has no live: table; want one with feed: control")
        update = update_of({"actors": list(actors), "removed": list(removed), "snapshot": snapshot})
        self._in_run(lambda: feeding.take(update, self._daemon.now_ns, again=True))

    def feed(self) -> dict[str, object]:
        """What came of the feed so far: counts, age of poses at the beams, errors of extrapolation."""
        feeding = self._daemon.feeding
        return {} if feeding is None else self._in_run(feeding.report)

    def fault(self, on: str, do: str, **keys: Any) -> int:
        """Let something go wrong, from now on or by the triggers of docs/faults.md; its number.

        `FaultError` names what is wrong and what is allowed.
        """
        faults = self._faults()
        return self._in_run(lambda: faults.add({"on": on, "do": do, **keys}, self._daemon.now_ns))

    def clear_fault(self, number: int) -> dict[str, object]:
        """End a fault for good; what it did."""
        faults = self._faults()
        return self._in_run(lambda: faults.clear(number, self._daemon.now_ns))

    def faults(self) -> list[dict[str, object]]:
        """All faults so far: number, state, hits, what they took away."""
        return self._in_run(self._faults().rows)

    def _faults(self) -> FaultRun:
        assert self._daemon.faults is not None
        return self._daemon.faults

    def sha256(self) -> str:
        """Digest of all wire bytes so far with their virtual times."""
        return self._in_run(self._transcript.sha256)

    def _actors(self) -> tuple[str, ...]:
        return ("world", *(actor.id for actor in self.scenario.actors))

    def _by_name(self) -> dict[str, Instrument]:
        return {one.sensor: one for one in self.instruments}

    def value(self, expression: str) -> Value:
        """An expression of the expectations' language over the run so far."""
        tree = parse(expression)
        for name in names(tree):
            check_name(name, list(self.sensors), self._actors())
        now_ns = self._daemon.now_ns
        run = Run(self.scenario, self._series, self._by_name(), now_ns)
        return self._in_run(lambda: evaluate(tree, run.lookup()))

    def judge(self) -> Judgements:
        """The scenario's own expectations over the run so far: false when one fails, `str()` of it says why.

        A sensor that is silent although hosts are owed scans is among its `warnings`. The recording has the last one.
        """
        run = Run(self.scenario, self._series, self._by_name(), self._daemon.now_ns)

        def found() -> Judgements:
            judged = verdicts(self._expected, run)
            note_verdict(self._recorder, judged, run.end_ns)
            return judged

        judged = self._in_run(found)
        if not judged or judged.warnings:
            self.on_verdict(str(judged))
        return judged
