"""Lock-step: a feeder moves virtual time, and learns of each step what was sent.

Belongs here: the conversation, one JSON object per line over TCP or a Unix socket. Not: what poses become
(feeding), how
time moves (virtual). docs/live_world.md has the requests and answers.

One feeder at a time. Nothing here is of a wall clock: the same lines give the same bytes at any pace.
"""

from __future__ import annotations

import contextlib
import json
import os
import select
import socket
import threading
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Protocol, TypeVar

from emulator.errors import EmulatorError, LinkError
from emulator.live.json_lines import MOST_BYTES, update_of
from emulator.live.osi import ground_truth, sensor_view
from emulator.live.samples import BadSample, Update
from emulator.process.clock import SystemClock
from emulator.recording.osi_out import Newest
from emulator.runtime.feeding import Feeding
from emulator.runtime.virtual_daemon import VirtualDaemon
from emulator.scenario.vehicle_options import NAME as VEHICLE_BUS

PROTOCOL = 1
LONGEST_STEP_S = 10.0
MOST_OSI = 64 << 20
READ_BYTES = 1 << 16
LOOK_S = 0.25
OPS = ("hello", "update", "step", "bye")
APART = ("op", "protocol", "osi", "osi_type", "want")
"Keys of a request that are none of an update."
READERS = {"GroundTruth": ground_truth, "SensorView": sensor_view}

Found = TypeVar("Found")


class InRun(Protocol):
    """Has something done in the run's own thread."""

    def __call__(self, action: Callable[[], Found], /) -> Found: ...


class WrongRequest(ValueError):
    """What a feeder is answered; nothing has changed."""


class Conversation:
    """Requests to answers, in the thread that `call` leaves."""

    def __init__(self, daemon: VirtualDaemon, feeding: Feeding, call: InRun) -> None:
        self._daemon, self._feeding, self._call = daemon, feeding, call
        self.is_over = False
        self.newest = Newest()
        "OSI SensorData of each sensor, of the present step."
        self.more = b""
        "What follows the last answer's line."

    def answer(self, request: object, osi: bytes | None = None) -> dict[str, object]:
        """Of one request; never raises for what a feeder says."""
        self.more = b""
        try:
            return self._answered(request, osi)
        except (WrongRequest, BadSample) as error:
            return {"op": "error", "why": str(error)}
        except (EmulatorError, RuntimeError) as error:
            self.is_over = True
            return {"op": "error", "why": str(error) or "the run has ended"}

    def _answered(self, request: object, osi: bytes | None) -> dict[str, object]:
        if not isinstance(request, Mapping):
            raise WrongRequest(f"line: {type(request).__name__}; want an object")
        op = request.get("op")
        if op == "hello":
            if request.get("protocol", PROTOCOL) != PROTOCOL:
                raise WrongRequest(f"protocol: {request['protocol']!r:.40}; want {PROTOCOL}")
            sensors = [one.sensor for one in self._daemon.instruments if one.sensor != VEHICLE_BUS]
            return {"op": "hello", "protocol": PROTOCOL, "t_s": self._now_s(), "sensors": sensors}
        if op == "bye":
            self.is_over = True
            return {"op": "bye"}
        if op not in ("update", "step"):
            raise WrongRequest(f"op: {op!r:.40}; want one of {', '.join(OPS)}")
        want = request.get("want", [])
        if want not in ([], ["osi"]):
            raise WrongRequest(f"want: {want!r:.40}; want ['osi']")
        kind = request.get("osi_type", "GroundTruth")
        if not isinstance(kind, str) or kind not in READERS:
            raise WrongRequest(f"osi_type: {kind!r:.40}; want one of {', '.join(READERS)}")
        if osi is None:
            update = update_of({key: value for key, value in request.items() if key not in APART})
        else:
            found = READERS[kind](osi)
            given = update_of({key: request[key] for key in ("t_s", "t_ns", "seq") if key in request})
            update = Update(given.t_ns, found.actors, snapshot=True, seq=given.seq, host=found.host)
        now_ns = self._daemon.now_ns
        t_ns = now_ns if update.t_ns is None and op == "update" else update.t_ns
        if t_ns is None:
            raise WrongRequest("t_s: none; want the time to step to")
        if t_ns < now_ns:
            raise WrongRequest(f"t_s: {t_ns * 1e-9:.9g} is past; want {now_ns * 1e-9:.9g} or later")
        if t_ns - now_ns > LONGEST_STEP_S * 1e9:
            raise WrongRequest(f"t_s: a step of {(t_ns - now_ns) * 1e-9:.9g} s; want at most {LONGEST_STEP_S:g} s")
        seq = {} if update.seq is None else {"seq": update.seq}
        if op == "update":
            self._take(update, t_ns)
            return {"op": "ok", "t_s": t_ns * 1e-9} | seq
        self.newest.is_wanted = self.newest.is_wanted or bool(want)
        done = self._step(update, t_ns)
        if want:
            messages = dict(self.newest.messages)
            done["osi"] = {name: len(message) for name, message in messages.items()}
            self.more = b"".join(messages.values())
        return {"op": "done", "t_s": t_ns * 1e-9} | seq | done

    def _now_s(self) -> float:
        return self._daemon.now_ns * 1e-9

    def _take(self, update: Update, t_ns: int) -> None:
        stamped = replace(update, t_ns=t_ns)
        self._call(lambda: self._feeding.take(stamped, self._daemon.now_ns, again=True))

    def _step(self, update: Update, t_ns: int) -> dict[str, object]:
        stamped = replace(update, t_ns=t_ns)
        instruments = [one for one in self._daemon.instruments if one.sensor != VEHICLE_BUS]

        def step() -> dict[str, object]:
            self.newest.messages.clear()
            before = {one.sensor: one.stats.scans_sent for one in instruments}
            if stamped.actors or stamped.removed or stamped.snapshot:
                self._feeding.take(stamped, self._daemon.now_ns, again=True)
            self._daemon.advance(t_ns)
            sent = {one.sensor: one.stats.scans_sent - before[one.sensor] for one in instruments}
            run = self._daemon.run_of
            run.touch()
            while (wake := run.next_wake()) is not None and wake <= t_ns and run.step(t_ns):
                pass
            return {"sent": sent, "next_s": None if wake is None else wake * 1e-9}

        return self._call(step)


class LockstepServer:
    """Listens for a feeder, in a thread of its own."""

    def __init__(self, daemon: VirtualDaemon, feeding: Feeding) -> None:
        """Time stands from here on; `LinkError` where the address cannot be had."""
        self._daemon = daemon
        self._talk = Conversation(daemon, feeding, self._in_run)
        self._pace = daemon.speed
        self._real = SystemClock()
        self._path: Path | None = None
        place = feeding.live.place
        daemon.paused, daemon.idles = True, False
        try:
            if place.path:
                self._path = Path(place.path)
                self._socket = socket.socket(socket.AF_UNIX)
                if self._path.is_socket():
                    self._path.unlink()
                self._socket.bind(place.path)
                os.chmod(place.path, 0o600)
                self.url = f"lockstep:unix:{place.path}"
            else:
                host = "127.0.0.1" if place.host == "localhost" else place.host
                self._socket = socket.socket(socket.AF_INET6 if ":" in host else socket.AF_INET)
                self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
                self._socket.bind((host, place.port))
                reported = f"[{host}]" if ":" in host else host
                self.url = f"lockstep://{reported}:{self._socket.getsockname()[1]}"
            self._socket.listen(4)
        except OSError as error:
            self._socket.close()
            raise LinkError(f"{feeding.live.feed}: {error.strerror or error}; want a free address") from None
        self._over = threading.Event()
        self._bell, self._ring = os.pipe()
        "Readable once all is over."
        self._thread = threading.Thread(target=self._serve, name="lidaremu-lockstep", daemon=True)
        self._thread.start()

    @property
    def newest(self) -> Newest:
        """Where the newest OSI SensorData of each sensor is put, for feeders that want it."""
        return self._talk.newest

    def close(self) -> None:
        """Listen no more."""
        self._over.set()
        os.close(self._ring)
        self._thread.join(2.0)
        if not self._thread.is_alive():  # it may still hang in a feeder that does not read
            os.close(self._bell)
        self._socket.close()
        if self._path is not None:
            with contextlib.suppress(OSError):
                self._path.unlink()

    def _in_run(self, action: Callable[[], Found]) -> Found:
        future = self._daemon.call(action)
        while not self._over.is_set():
            with contextlib.suppress(TimeoutError):
                return future.result(LOOK_S)  # type: ignore[return-value]
        raise RuntimeError("the run has ended")

    def _serve(self) -> None:
        while not self._over.is_set():
            if not self._readable(self._socket):
                continue
            with contextlib.suppress(OSError):
                found, _ = self._socket.accept()
                with found:
                    self._talk.is_over = False
                    self._converse(found)

    def _converse(self, feeder: socket.socket) -> None:
        if feeder.family != socket.AF_UNIX:
            feeder.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        began_ns, began_s = self._real.now_ns(), self._daemon.now_ns * 1e-9
        held = bytearray()
        while not self._talk.is_over and (line := self._line(feeder, held)) is not None:
            if not line.strip():
                continue
            osi = None
            try:
                request = json.loads(line)
                size = request.get("osi") if isinstance(request, dict) else None
                if size is not None:
                    if type(size) is not int or not 0 <= size <= MOST_OSI:
                        raise ValueError(f"osi: {size!r:.40}; want the number of bytes that follow")
                    osi = self._exactly(feeder, held, size)
            except (ValueError, RecursionError) as error:
                answer: dict[str, object] = {"op": "error", "why": f"line: {error}"}
            else:
                answer = self._talk.answer(request, osi)
            if self._pace is not None and answer["op"] == "done":
                late_s = (self._daemon.now_ns * 1e-9 - began_s) / self._pace
                self._over.wait(max(0.0, late_s - (self._real.now_ns() - began_ns) * 1e-9))
            feeder.sendall(json.dumps(answer).encode() + b"\n" + self._talk.more)

    def _readable(self, found: socket.socket) -> bool:
        """Whether something is there, or it has gone; waits for that or for the end of all."""
        waiting = select.poll()
        for one in (found.fileno(), self._bell):
            waiting.register(one, select.POLLIN)
        return any(number != self._bell for number, _ in waiting.poll())

    def _line(self, feeder: socket.socket, held: bytearray) -> bytes | None:
        """None: the feeder has gone, or sends no lines."""
        while (end := held.find(b"\n")) < 0:
            if len(held) > MOST_BYTES:
                feeder.sendall(b'{"op": "error", "why": "line: too long"}\n')
                return None
            if not self._more(feeder, held):
                return None
        line = bytes(held[:end])
        del held[: end + 1]
        return line

    def _exactly(self, feeder: socket.socket, held: bytearray, size: int) -> bytes:
        while len(held) < size:
            if not self._more(feeder, held):
                raise ValueError(f"osi: {len(held)} of {size} bytes")
        data = bytes(held[:size])
        del held[:size]
        return data

    def _more(self, feeder: socket.socket, held: bytearray) -> bool:
        while not self._over.is_set():
            if self._readable(feeder):
                data = feeder.recv(READ_BYTES)
                held += data
                return bool(data)
        return False
