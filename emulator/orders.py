"""What a running daemon can be told to do: the methods of the control socket and of `lidaremu ctl`."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from emulator.clock import Clock
from emulator.control import BAD_PARAMS, REFUSED, Method, OrderError
from emulator.daemon import Daemon, summary
from emulator.instrument import Instrument
from emulator.metrics import prometheus
from emulator.virtual_daemon import VirtualDaemon

LONGEST_STEP_S = 3600.0
MOST_SCANS = 100_000


def _taken(params: Mapping[str, Any], **allowed: tuple[float, float]) -> dict[str, float]:
    """Numbers by name within their bounds; `OrderError` names what is allowed."""
    told = ", ".join(f"{name}: {low:g} to {high:g}" for name, (low, high) in allowed.items()) or "nothing"
    found = {}
    for name, value in params.items():
        low, high = allowed.get(name, (1.0, 0.0))
        if isinstance(value, bool) or not isinstance(value, int | float) or not low <= value <= high:
            raise OrderError(BAD_PARAMS, f"{name}: {value!r}; want {told}")
        found[name] = float(value)
    return found


class Orders:
    """The methods of one run."""

    def __init__(
        self,
        daemon: Daemon | VirtualDaemon,
        instruments: Sequence[Instrument],
        clock: Clock,
        note: Callable[[int, dict[str, object]], None] = lambda now_ns, row: None,
    ) -> None:
        """`note` is told of every order that changes something."""
        self._daemon = daemon
        self._instruments = tuple(instruments)
        self._clock = clock
        self._note = note

    def methods(self) -> dict[str, Method]:
        """Name -> method."""
        return {
            "status": self.status,
            "metrics": self.metrics,
            "pause": self.pause,
            "resume": self.resume,
            "step": self.step,
            "speed": self.speed,
            "stop": self.stop,
        }

    def _now_ns(self) -> int:
        return self._daemon.now_ns if isinstance(self._daemon, VirtualDaemon) else self._clock.now_ns()

    def _virtual(self, what: str) -> VirtualDaemon:
        if not isinstance(self._daemon, VirtualDaemon):
            raise OrderError(REFUSED, f"{what}: real time goes on; want a run with --clock virtual or --speed")
        return self._daemon

    def _did(self, what: str, **more: object) -> dict[str, object]:
        self._note(self._now_ns(), {"event": "Order", "order": what} | more)
        return {"now_s": self._now_ns() * 1e-9}

    def status(self, params: Mapping[str, Any]) -> object:
        """Clock, time, and what each sensor did so far."""
        _taken(params)
        virtual = isinstance(self._daemon, VirtualDaemon)
        return {
            "clock": "virtual" if virtual else "real",
            "now_s": self._now_ns() * 1e-9,
            "paused": self._daemon.paused if isinstance(self._daemon, VirtualDaemon) else False,
            "sensors": [summary(one) for one in self._instruments],
        }

    def metrics(self, params: Mapping[str, Any]) -> object:
        """Counters and the histogram of lateness as Prometheus text."""
        _taken(params)
        return prometheus(self._instruments)

    def pause(self, params: Mapping[str, Any]) -> object:
        """Virtual time stands."""
        _taken(params)
        self._virtual("pause").paused = True
        return self._did("pause")

    def resume(self, params: Mapping[str, Any]) -> object:
        """Virtual time goes on."""
        _taken(params)
        daemon = self._virtual("resume")
        daemon.paused = False
        daemon.rebase(daemon.speed)
        return self._did("resume")

    def step(self, params: Mapping[str, Any]) -> object:
        """Virtual time moves by so many scans, or so many seconds; one scan if nothing is said."""
        wanted = _taken(params, scans=(1, MOST_SCANS), seconds=(0, LONGEST_STEP_S))
        daemon = self._virtual("step")
        daemon.paused = True
        if "seconds" in wanted:
            daemon.advance(daemon.now_ns + round(wanted["seconds"] * 1e9))
        scans = int(wanted.get("scans", 0 if "seconds" in wanted else 1))
        sent = daemon.run_of.step_scans(scans, daemon.now_ns + 10_000_000_000) if scans else 0
        return self._did("step", **wanted) | {"scans": sent}

    def speed(self, params: Mapping[str, Any]) -> object:
        """Virtual seconds a real one; `x` 0: as fast as hosts read."""
        wanted = _taken(params, x=(0, 1e6))
        daemon = self._virtual("speed")
        daemon.rebase(wanted.get("x", 0.0) or None)
        return self._did("speed", **wanted)

    def stop(self, params: Mapping[str, Any]) -> object:
        """End the run as SIGTERM does."""
        _taken(params)
        self._daemon.stop()
        return self._did("stop")
