"""A feeder in Python: poses by UDP, TCP or the control socket's line, or in lock-step.

Belongs here: what a program that moves the world needs, with the standard library alone. Not: our own end (receivers).

    with Feeder("json-udp://127.0.0.1:47100") as feeder:
        feeder.move("car", [12.0, 0.0, 0.0], velocity_m_s=[5.0, 0.0, 0.0], t_s=0.01)

    with Lockstep("lockstep://127.0.0.1:47101") as world:
        done = world.step(0.01, [{"id": "car", "at_m": [12.0, 0.0, 0.0], "reference": "origin"}])
"""

from __future__ import annotations

import json
import socket
from collections.abc import Mapping, Sequence
from types import TracebackType
from typing import Any

from emulator.errors import LinkError

TIME_LIMIT_S = 60.0
"For an answer: a step may be of ten seconds, which take a busy machine longer than that."


def encoded(
    actors: Sequence[Mapping[str, object]],
    t_s: float | None = None,
    seq: int | None = None,
    removed: Sequence[str] = (),
    snapshot: bool = False,
) -> bytes:
    """One update as a line, without its end."""
    data: dict[str, object] = {} if t_s is None else {"t_s": t_s}
    data |= {} if seq is None else {"seq": seq}
    data |= {"removed": list(removed)} if removed else {}
    data |= {"snapshot": True} if snapshot else {}
    return json.dumps(data | {"actors": [dict(one) for one in actors]}, separators=(",", ":"), allow_nan=False).encode()


def _address(url: str, kinds: Sequence[str]) -> tuple[str, str, int, str]:
    """Kind, host, port and path."""
    kind, _, rest = url.partition(":")
    if kind in kinds and rest.startswith("unix:"):
        return kind, "", 0, rest[len("unix:") :]
    host, colon, port = rest.removeprefix("//").rpartition(":")
    if kind not in kinds or not rest.startswith("//") or not colon or not port.isdecimal():
        raise LinkError(f"{url}: no feed; want {' or '.join(f'{one}://HOST:PORT' for one in kinds)}")
    return kind, host.strip("[]"), int(port), ""


def _connected(host: str, port: int, path: str) -> socket.socket:
    try:
        if path:
            found = socket.socket(socket.AF_UNIX)
            found.settimeout(TIME_LIMIT_S)
            found.connect(path)
            return found
        found = socket.create_connection((host, port), TIME_LIMIT_S)
        found.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        return found
    except OSError as error:
        raise LinkError(f"{path or f'{host}:{port}'}: {error.strerror or error}; want a run that listens") from None


class Feeder:
    """Sends updates; nothing comes back."""

    def __init__(self, url: str) -> None:
        """`json-udp://HOST:PORT` or `json-tcp://HOST:PORT`, as `ready` reports it."""
        self._kind, host, port, _ = _address(url, ("json-udp", "json-tcp"))
        self._seq = 0
        if self._kind == "json-tcp":
            self._socket = _connected(host, port, "")
        else:
            self._socket = socket.socket(socket.AF_INET6 if ":" in host else socket.AF_INET, socket.SOCK_DGRAM)
            self._socket.connect((host, port))

    def move(
        self, actor: str, at_m: Sequence[float], t_s: float | None = None, reference: str = "origin", **keys: Any
    ) -> None:
        """Where one actor is at `t_s` of the feeder's clock; None: now."""
        self.send([{"id": actor, "at_m": list(at_m), "reference": reference, **keys}], t_s)

    def send(
        self,
        actors: Sequence[Mapping[str, object]],
        t_s: float | None = None,
        removed: Sequence[str] = (),
        snapshot: bool = False,
    ) -> None:
        """Several actors at one instant, by the keys of docs/live_world.md."""
        data = encoded(actors, t_s, self._seq, removed, snapshot)
        self._seq += 1
        try:
            self._socket.sendall(data if self._kind == "json-udp" else data + b"\n")
        except ConnectionRefusedError:
            pass  # of an earlier datagram: nobody listens yet

    def close(self) -> None:
        """Send no more."""
        self._socket.close()

    def __enter__(self) -> Feeder:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


class Lockstep:
    """Moves virtual time step by step."""

    def __init__(self, url: str) -> None:
        """`lockstep://HOST:PORT` or `lockstep:unix:PATH`, as `ready` reports it."""
        _, host, port, path = _address(url, ("lockstep",))
        self._socket = _connected(host, port, path)
        self._file = self._socket.makefile("rb")
        hello = self.ask({"op": "hello", "protocol": 1})
        self.t_s = float(str(hello["t_s"]))
        "Virtual time. [s]"
        self.sensors = [str(one) for one in hello["sensors"]]  # type: ignore[attr-defined]

    def ask(self, request: Mapping[str, object], more: bytes = b"") -> dict[str, object]:
        """Any request; `LinkError` where it is refused or the run has gone."""
        try:
            self._socket.sendall(json.dumps(dict(request), allow_nan=False).encode() + b"\n" + more)
            line = self._file.readline()
        except OSError as error:
            raise LinkError(f"lock-step: {error.strerror or error}") from None
        if not line:
            raise LinkError("lock-step: the run has ended")
        answer: dict[str, object] = json.loads(line)
        if answer.get("op") == "error":
            raise LinkError(f"lock-step: {answer.get('why')}")
        return answer

    def step(self, t_s: float, actors: Sequence[Mapping[str, object]] = (), **keys: Any) -> dict[str, object]:
        """Time moves to `t_s`, where actors are as reported; `sent`: scans of each sensor, `next_s`: what is due
        next."""
        done = self.ask({"op": "step", "t_s": t_s, "actors": [dict(one) for one in actors], **keys})
        self.t_s = t_s
        return done

    def step_osi(self, t_s: float, ground_truth: bytes) -> dict[str, object]:
        """The same with a serialised GroundTruth."""
        done = self.ask({"op": "step", "t_s": t_s, "osi": len(ground_truth)}, ground_truth)
        self.t_s = t_s
        return done

    def close(self) -> None:
        """Leave; time stands."""
        self._file.close()
        self._socket.close()

    def __enter__(self) -> Lockstep:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()
