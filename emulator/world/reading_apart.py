"""Untrusted mesh files, read in a separate process with limits on its memory and processor time.

Belongs here: that process, what it is asked and answers, and what is said when it ends. Not: the reading (mesh_files)
and the limits (budgets).

The process is forked, so that it costs milliseconds; it is asked for one file after the other by a line of JSON, and
answers with a line of JSON and plain arrays of numbers, which are judged before they are taken: nothing it says is
run. Whatever ends it, a fault of a library or a limit of the kernel, costs that file, and is reported in one line.
Where
there is no fork, files are read in place; where the kernel keeps no limit of memory (macOS), the limits of `budgets` on
what a file may ask for are the only ones.
"""

from __future__ import annotations

import contextlib
import ctypes
import faulthandler
import json
import os
import resource
import signal
import socket
import sys
import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, NoReturn

import numpy as np
from numpy.typing import NDArray

from emulator.config.budgets import MeshBudget, mesh_budget, raised
from emulator.errors import SceneError
from emulator.world import mesh_files
from emulator.world.mesh_maps import MeshMaps, Wanted, parts_read, parts_told
from emulator.world.triangles import Geometry

MOST_HEAD = 64_000_000
"Bytes of the line in front of the arrays: names of parts, or what is wrong."
TIME_LIMIT, TIME_LIMIT_S = 20, 60.0
"A process that waits for its disk, or for other programs, is given so many times its processor time, or that."
PR_SET_PDEATHSIG = 1
"linux/prctl.h."
SHAPES: tuple[tuple[str, type, int], ...] = (
    ("vertices", np.float64, 3),
    ("faces", np.int32, 3),
    ("face_part", np.int32, 1),
    ("normals", np.float64, 3),
    ("closed", np.bool_, 1),
)
"Arrays of a `Geometry`: name, kind, columns. The first has a row a vertex, the others one a triangle."


@dataclass(frozen=True)
class Spent:
    """What a process had used when it ended."""

    cpu_s: float
    peak_bytes: int
    "Its largest resident size, that which it began with included."


class Reader:
    """Reads untrusted mesh files; to be closed, or used in a `with`. The process starts with the first file."""

    def __init__(self, budget: MeshBudget | None = None) -> None:
        self.budget = mesh_budget() if budget is None else budget
        self.spent: list[Spent] = []
        "Of each process that has ended, in their order."
        self._pid = 0
        self._line: socket.socket | None = None

    def __enter__(self) -> Reader:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def read(
        self, path: Path, up: Literal["y", "z"] | None, scale: float, where: str, wanted: Wanted | None = None
    ) -> Geometry:
        """As `mesh_files.load`, elsewhere."""
        if not hasattr(os, "fork"):
            return mesh_files.load(path, up, scale, where, self.budget, wanted)
        if self._line is None:
            self._start()
        place = f"{where}: {path.name}"
        try:
            asked = {"path": str(path), "up": up, "scale": scale, "where": where}
            maps = None if wanted is None else [wanted.every, *wanted.parts]
            return self._ask({**asked, "wanted": maps}, place)
        except TimeoutError:
            self.close()
            reported = f"not read within {self._time_limit_s:g} s; want a file on a disk that answers {raised('cpu_s')}"
            raise SceneError(f"{place}: {reported}") from None
        except SceneError:
            raise
        except (EOFError, OSError):
            raise SceneError(f"{place}: {self._obituary(self.close())}") from None
        except BaseException:
            self.close()
            raise

    def close(self) -> int:
        """End the process, if there is one; its wait status, that of its own end where it has ended by itself."""
        if self._line is None:
            return 0
        self._line.close()
        self._line = None
        with contextlib.suppress(ProcessLookupError):
            os.kill(self._pid, signal.SIGKILL)
        try:
            _, status, used = os.wait4(self._pid, 0)
        except ChildProcessError:  # whoever has started us wants to know of no child
            return 0
        unit = 1 if sys.platform == "darwin" else 1024
        self.spent.append(Spent(used.ru_utime + used.ru_stime, used.ru_maxrss * unit))
        return status

    def _start(self) -> None:
        ours, theirs = socket.socketpair()
        parent = os.getpid()
        with warnings.catch_warnings():
            # Python 3.12 warns of forks beside threads: the child uses no lock that numpy and libc do not mend
            warnings.simplefilter("ignore", DeprecationWarning)
            pid = os.fork()
        if not pid:
            _child(theirs, parent, self.budget)
        theirs.close()
        self._pid, self._line = pid, ours
        ours.settimeout(self._time_limit_s)

    @property
    def _time_limit_s(self) -> float:
        return max(TIME_LIMIT_S, float(TIME_LIMIT * self.budget.cpu_s))

    def _ask(self, request: dict[str, Any], place: str) -> Geometry:
        assert self._line is not None
        self._line.sendall(json.dumps(request).encode() + b"\n")
        size = int.from_bytes(self._take(8).tobytes(), "little")
        if size > MOST_HEAD:
            raise EOFError
        try:
            head = json.loads(self._take(size).tobytes())
            if head["ok"] is not True:
                if head["ok"] is None:  # out of memory: what is left of it is not worth keeping
                    self.close()
                raise SceneError(str(head["reported"]))
            return self._geometry(head)
        except (ValueError, LookupError, TypeError, RecursionError) as error:
            if isinstance(error, SceneError):
                raise
            self.close()
            raise SceneError(f"{place}: invalid answer of the reading process; want a file in that format") from None

    def _geometry(self, head: dict[str, Any]) -> Geometry:
        """The answer as a shape; `ValueError` for one that is none."""
        vertices, faces = int(head["vertices"]), int(head["faces"])
        parts = tuple(str(name) for name in head["parts"])
        centre = np.array([float(one) for one in head["centre"]])
        if not (0 < vertices <= self.budget.vertices and 0 < faces <= self.budget.triangles and len(centre) == 3):
            raise ValueError("sizes")
        found: dict[str, NDArray[Any]] = {}
        for name, kind, columns in SHAPES:
            rows = vertices if name == "vertices" else faces
            data = self._take(rows * columns * np.dtype(kind).itemsize)
            found[name] = data.view(kind).reshape((rows, 3) if columns == 3 else (rows,))
        for name, most in (("faces", vertices), ("face_part", len(parts))):
            if found[name].min() < 0 or found[name].max() >= most:
                raise ValueError(name)
        counts = int(head["dropped"]), int(head["coplanar"])
        maps = None if head["maps"] is None else self._maps(head["maps"], vertices, len(parts))
        return Geometry(parts=parts, centre=centre, radius=float(head["radius"]), dropped=counts[0], coplanar=counts[1],
                        maps=maps, **found)  # fmt: skip

    def _maps(self, head: dict[str, Any], vertices: int, parts: int) -> MeshMaps:
        sizes = [(int(height), int(width)) for height, width in head["pictures"]]
        if any(min(one) < 1 for one in sizes) or sum(h * w for h, w in sizes) > self.budget.pixels:
            raise ValueError("pictures")
        uv, normal_uv, colour = (self._take(8 * vertices * k).view(np.float64).reshape(-1, k) for k in (2, 2, 3))
        pictures = tuple(self._take(3 * h * w).reshape(h, w, 3) for h, w in sizes)
        reported = parts_read(head["parts"], len(pictures))
        if len(reported) != parts:
            raise ValueError("parts")
        return MeshMaps(uv, normal_uv, colour, pictures, reported)

    def _take(self, size: int) -> NDArray[np.uint8]:
        """So many bytes of the answer; `EOFError` when the other end has gone."""
        assert self._line is not None
        data = np.zeros(size, np.uint8)
        room = memoryview(data.data)
        at = 0
        while at < size:
            count = self._line.recv_into(room[at:])
            if not count:
                raise EOFError
            at += count
        return data

    def _obituary(self, status: int) -> str:
        budget = self.budget
        if not os.WIFSIGNALED(status):
            return f"the reading process ended with code {os.waitstatus_to_exitcode(status)}; want a sound file"
        number = os.WTERMSIG(status)
        if number == signal.SIGXCPU:
            return f"more than {budget.cpu_s} s of processor time; want at most {budget.cpu_s} s {raised('cpu_s')}"
        name = signal.Signals(number).name if number in signal.valid_signals() else str(number)
        why = " (out of memory?)" if number == signal.SIGKILL else ""
        memory = f"at most {budget.memory_bytes} bytes of memory {raised('memory_bytes')}"
        return f"the reading process was terminated by {name}{why}; want a sound file that needs {memory}"


# ---------------------------------------------------------------- the process that reads


def _child(line: socket.socket, parent: int, budget: MeshBudget) -> NoReturn:
    """Body of the process: limits first, then one file after the other, until nobody asks."""
    code = 1
    try:
        _alone(line.fileno(), parent)
        _limit_memory(budget.memory_bytes)
        with line.makefile("rb") as asked:
            for text in asked:
                _limit_time(budget.cpu_s)
                _answer(line, json.loads(text), budget)
        code = 0
    except BaseException:  # nothing of the parent's may run here: no handler, no `finally`, no report of a test
        pass
    finally:
        os._exit(code)


def _alone(keep: int, parent: int) -> None:
    """No signal handler, no descriptor of the parent's but one, no output, no dump, and no life after its parent's."""
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGXCPU, signal.SIGALRM):
        signal.signal(number, signal.SIG_DFL)
    faulthandler.disable()
    signal.setitimer(signal.ITIMER_REAL, 0.0)
    with contextlib.suppress(OSError, AttributeError):
        ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, int(signal.SIGKILL), 0, 0, 0)
    if os.getppid() != parent:  # it has ended meanwhile
        os._exit(1)
    with contextlib.suppress(OSError):  # where memory is short, the kernel takes this process first
        Path("/proc/self/oom_score_adj").write_text("1000")
    nothing = os.open(os.devnull, os.O_RDWR)
    for kept in (0, 1, 2):
        os.dup2(nothing, kept)
    for name in os.listdir("/proc/self/fd") if os.path.isdir("/proc/self/fd") else map(str, range(3, 1024)):
        if int(name) > 2 and int(name) != keep:
            with contextlib.suppress(OSError):
                os.close(int(name))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))


def _limit_memory(most: int) -> None:
    """Of what is here above what the parent had; named in the head of this file where the kernel keeps none."""
    with contextlib.suppress(OSError, ValueError):
        pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[0])
        _lower(resource.RLIMIT_AS, pages * resource.getpagesize() + most)


def _limit_time(seconds: int) -> None:
    """From now on, for the next file."""
    used = resource.getrusage(resource.RUSAGE_SELF)
    with contextlib.suppress(OSError, ValueError):
        _lower(resource.RLIMIT_CPU, int(used.ru_utime + used.ru_stime) + 1 + seconds)


def _lower(what: int, soft: int) -> None:
    hard = resource.getrlimit(what)[1]
    resource.setrlimit(what, (soft if hard == resource.RLIM_INFINITY else min(soft, hard), hard))


def _answer(line: socket.socket, asked: dict[str, Any], budget: MeshBudget) -> None:
    try:
        maps = asked["wanted"]
        wanted = None if maps is None else Wanted(bool(maps[0]), tuple(maps[1:]))
        found = mesh_files.load(Path(asked["path"]), asked["up"], asked["scale"], asked["where"], budget, wanted)
    except SceneError as error:
        short = isinstance(error.__context__, MemoryError)
        _send(line, {"ok": None if short else False, "reported": str(error)})
        return
    head: dict[str, Any] = {
        "vertices": len(found.vertices),
        "faces": len(found.faces),
        "parts": found.parts,
        "radius": found.radius,
    }
    head |= {"centre": found.centre.tolist(), "dropped": found.dropped, "coplanar": found.coplanar}
    more: list[NDArray[Any]] = []
    head["maps"] = None
    if found.maps is not None:
        sizes = [one.shape[:2] for one in found.maps.pictures]
        head["maps"] = {"pictures": sizes, "parts": parts_told(found.maps.parts)}
        more = [found.maps.uv, found.maps.normal_uv, found.maps.colour, *found.maps.pictures]
    _send(line, {"ok": True} | head)
    for array in [*(np.asarray(getattr(found, name), kind) for name, kind, _ in SHAPES), *more]:
        line.sendall(np.ascontiguousarray(array).data.cast("B"))


def _send(line: socket.socket, head: dict[str, Any]) -> None:
    text = json.dumps(head).encode()
    line.sendall(len(text).to_bytes(8, "little") + text)
