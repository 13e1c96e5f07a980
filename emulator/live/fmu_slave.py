"""What runs in an FMU: a client of lock-step, which starts the run and moves its time with the master's steps.

Belongs here: variables of FMI 2.0, OSMP's pointers, the conversation. Not: how an FMU is packed (commands/fmu).

This file is copied into the FMU, and runs in whatever Python its master embeds: the standard library and pythonfmu,
which is in the FMU too, are all it imports.
"""

from __future__ import annotations

import contextlib
import ctypes
import json
import os
import shlex
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element, SubElement

from pythonfmu.enums import Fmi2Causality, Fmi2Status, Fmi2Variability
from pythonfmu.fmi2slave import Fmi2Slave
from pythonfmu.variables import Boolean, Integer, Real, String

CONFIG = "lidaremu.json"
OSMP = "net.pmsf.osmp"
OSMP_XMLNS = "http://xsd.pmsf.net/OSISensorModelPackaging"
OSMP_VERSION, OSI_VERSION = "1.6.0", "3.8.0"
MIME = "application/x-open-simulation-interface"
TIME_LIMIT_S = 300.0
"For a run that begins: it may compile its loops first."
LEAVE_S, END_S = 120.0, 20.0
"For a run to end in order, its recording written; and for one that has to be made to."
ENDED_S = 2.0
"For a run that has closed the line: its exit code comes after that."
LOOK_S = 0.02
MOST_BYTES = 64 << 20
MOST_SAID = 2000
"Characters of what a run said last."
LONGEST_PATH = 107
"Of a Unix socket, in bytes."
KEPT = 2
"Generations of output buffers: one is valid until the second next step begins."
MASTERS_OWN = ("LD_PRELOAD", "PYTHONHOME")
"Variables that are for the Python that the master embeds, not for the run's."
POSE = ("x_m", "y_m", "z_m", "yaw_deg", "pitch_deg", "roll_deg")
VELOCITY = ("vx_m_s", "vy_m_s", "vz_m_s")
TURN = "turn_rate_deg_s"


class _Failed(RuntimeError):
    """Reported to the master; the FMU is of no more use."""


class _Run:
    """The run beside the master, and the line to it."""

    def __init__(self, words: list[str]) -> None:
        """`_Failed` with what the run said where it cannot begin; nothing of it is left then."""
        self._words = words
        self._folder: Path | None = None
        self._files: list[Any] = []
        self._process: subprocess.Popen[bytes] | None = None
        self._socket: socket.socket | None = None
        try:
            self._begin()
        except (OSError, ValueError) as error:
            more = "" if self._process is None else f"; it {self._how()}: {self._said()}"
            self._tidy()
            raise _Failed(f"the run cannot be driven: {error}{more}") from None
        except BaseException:
            self._tidy()
            raise

    def _begin(self) -> None:
        prefix = "lidaremu-fmu-"
        room = LONGEST_PATH - len(os.fsencode(tempfile.gettempdir())) > len(f"{prefix}????????/lockstep/")
        self._folder = Path(tempfile.mkdtemp(prefix=prefix, dir=None if room else "/tmp"))
        place = self._folder / "lockstep"
        words = [*self._words, "--set", f"live.feed=lockstep:unix:{place}"]
        own = {name: text for name, text in os.environ.items() if name not in MASTERS_OWN}
        out, err = self._files = [(self._folder / name).open("wb") for name in ("out", "err")]
        try:
            self._process = subprocess.Popen(
                words, stdin=subprocess.PIPE, stdout=out, stderr=err, env=own, start_new_session=True
            )
        except OSError as error:
            raise _Failed(
                f"{words[0]}: {error.strerror}; want lidaremu installed, or its command in `lidaremu`"
            ) from None
        self.ready = self._ready(self._process)
        self._socket = socket.socket(socket.AF_UNIX)
        self._socket.connect(str(place))
        self._file = self._socket.makefile("rb")
        self._files.append(self._file)
        self.hello = self.ask({"op": "hello", "protocol": 1})[0]

    def _ready(self, process: subprocess.Popen[bytes]) -> dict[str, Any]:
        for _ in range(round(TIME_LIMIT_S / LOOK_S)):
            has_ended = process.poll() is not None  # before the look: what it said last is there then
            row = self._event("ready")
            if row is not None:
                return row
            if has_ended:
                raise _Failed(f"the run {self._how()} before it was ready: {self._said()}")
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(LOOK_S)
        raise _Failed(f"the run was not ready after {TIME_LIMIT_S:g} s: {self._said()}")

    def _how(self) -> str:
        """How it ended."""
        assert self._process is not None
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._process.wait(ENDED_S)
        code = self._process.returncode
        if code is None:
            return "goes on, and says no more"
        return f"ended with exit code {code}" if code >= 0 else f"was ended by {signal.Signals(-code).name}"

    def _event(self, name: str) -> dict[str, Any] | None:
        for line in self._text("out").splitlines():
            with contextlib.suppress(ValueError):
                row = json.loads(line)
                if isinstance(row, dict) and row.get("event") == name:
                    return row
        return None

    def _text(self, name: str) -> str:
        assert self._folder is not None
        try:
            return (self._folder / name).read_text(encoding="utf-8", errors="replace")
        except OSError:  # somebody has cleared up there
            return ""

    def _said(self) -> str:
        text = self._text("err").strip() or self._text("out").strip()
        return text[-MOST_SAID:] or f"it said nothing; the command was {shlex.join(self._words)}"

    def ask(self, request: dict[str, object], more: bytes = b"") -> tuple[dict[str, Any], dict[str, bytes]]:
        """The answer, and the messages behind it by sensor."""
        assert self._socket is not None
        try:
            self._socket.sendall(json.dumps(request, allow_nan=False).encode() + b"\n" + more)
            line = self._file.readline()
            answer = json.loads(line) if line else None
            messages = {name: self._exactly(size) for name, size in (answer or {}).get("osi", {}).items()}
        except (OSError, ValueError) as error:
            raise _Failed(f"lock-step: {error}; the run {self._how()}: {self._said()}") from None
        if answer is None:
            raise _Failed(f"the run {self._how()}: {self._said()}")
        if answer.get("op") == "error":
            raise _Failed(f"lock-step: {answer.get('why')}")
        return answer, messages

    def _exactly(self, size: int) -> bytes:
        data = self._file.read(size)
        if len(data) != size:
            raise ValueError(f"{len(data)} of {size} bytes")
        return data

    def close(self) -> dict[str, Any]:
        """End the run; its last event."""
        try:
            return self._end()
        finally:
            self._tidy()

    def _end(self) -> dict[str, Any]:
        assert self._process is not None
        with contextlib.suppress(_Failed):
            self.ask({"op": "bye"})
        if self._process.poll() is None:
            # not the end of its input: from there a run has ten seconds, and a busy machine needs more for a recording
            self._process.terminate()
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._process.wait(LEAVE_S)
        self._stop(self._process)
        return self._event("stopped") or {}

    def _stop(self, process: subprocess.Popen[bytes]) -> None:
        if process.poll() is None:
            process.terminate()
        try:
            process.wait(END_S)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()

    def _tidy(self) -> None:
        """Nothing is left of it: no process, no open file, no folder."""
        for one in (*self._files, self._socket):
            if one is not None:
                one.close()
        if self._process is not None:
            self._stop(self._process)
            if self._process.stdin is not None:
                self._process.stdin.close()
        if self._folder is not None:
            shutil.rmtree(self._folder, ignore_errors=True)


class _Pointer:
    """One binary value as OSMP has it: two halves of an address and a size, each as a signed 32-bit number."""

    def __init__(self) -> None:
        self.lo = self.hi = self.size = 0
        self._kept: list[Any] = []

    def take(self) -> bytes:
        """What the master points to; empty: nothing."""
        address = (self.hi & 0xFFFFFFFF) << 32 | self.lo & 0xFFFFFFFF
        if not address or not self.size:
            return b""
        if not 0 < self.size <= MOST_BYTES:
            raise _Failed(f"OSMPSensorViewIn.size: {self.size}; want 0 to {MOST_BYTES}")
        return ctypes.string_at(address, self.size)

    def show(self, message: bytes | None) -> None:
        """Point to a message; None: to nothing."""
        buffer = None if not message else ctypes.create_string_buffer(message, len(message))
        self._kept = [*self._kept, buffer][-KEPT:]
        address = 0 if buffer is None else ctypes.addressof(buffer)
        self.lo, self.hi = _signed(address & 0xFFFFFFFF), _signed(address >> 32)
        self.size = 0 if message is None else len(message)


def _signed(half: int) -> int:
    return half - (1 << 32) if half >= 1 << 31 else half


def named(name: str) -> str:
    """As a part of a structured name of FMI."""
    return name if name.isidentifier() and name.isascii() else f"'{name}'"


class Lidaremu(Fmi2Slave):  # type: ignore[misc]
    """Sensors of one scenario; inputs are poses, or an OSI SensorView, outputs are counts and OSI SensorData."""

    author = "lidaremu"
    license = "MIT"

    def __init__(self, **kwargs: Any) -> None:
        super().__init__(**kwargs)
        self._config = json.loads((Path(self.resources) / CONFIG).read_text(encoding="utf-8"))
        self.modelName = self._config["name"]
        self.description = self._config["description"]
        self._run: _Run | None = None
        self._reported = ""
        "What went to standard error last."
        self._start_s = 0.0
        self._poses: dict[str, dict[str, float]] = {name: dict(pose) for name, pose in self._config["actors"].items()}
        self._set: dict[str, set[str]] = {name: set() for name in self._poses}
        "Inputs of each actor that the master has given."
        self._sent = dict.fromkeys(self._config["sensors"], 0)
        self._in_step = dict.fromkeys(self._config["sensors"], 0)
        self._links = dict.fromkeys(self._config["sensors"], "")
        self._view = _Pointer()
        self._data = {name: _Pointer() for name in self._config["sensors"]}
        self._valid, self._next_s, self._sha256 = False, 0.0, ""
        self._given: dict[str, Any] = {"lidaremu": "", "record": "", "speed": 0.0}
        self._osmp: dict[str, tuple[str, str, str]] = {}
        "Variable -> binary variable, role, type."
        self._register()

    # ------------------------------------------------------------ variables

    def _register(self) -> None:
        for name in self._poses:
            for key in (*POSE, *VELOCITY, TURN):
                self._add(Real, f"{named(name)}.{key}", "input", *self._pose_ends(name, key))
        self._add_pointer("OSMPSensorViewIn", "SensorView", self._view, "input")
        for number, name in enumerate(self._config["sensors"]):
            suffix = f"[{number + 1}]" if len(self._data) > 1 else ""
            self._add_pointer(f"OSMPSensorDataOut{suffix}", "SensorData", self._data[name], "output")
            self._add(Integer, f"{named(name)}.scans", "output", partial(self._sent.__getitem__, name))
            self._add(Integer, f"{named(name)}.scans_in_step", "output", partial(self._in_step.__getitem__, name))
            self._add(String, f"{named(name)}.links", "output", partial(self._links.__getitem__, name))
        self._add(Boolean, "valid", "output", lambda: self._valid)
        self._add(Real, "next_s", "output", lambda: self._next_s)
        self._add(String, "sha256", "output", lambda: self._sha256)
        for key, kind in (("lidaremu", String), ("record", String), ("speed", Real)):
            self._add(
                kind, key, "parameter", partial(self._given.__getitem__, key), partial(self._given.__setitem__, key)
            )

    def _pose_ends(self, name: str, key: str) -> tuple[Callable[[], float], Callable[[float], None]]:
        def put(value: float) -> None:
            self._poses[name][key] = value
            self._set[name].add(key)

        return lambda: self._poses[name].get(key, 0.0), put

    def _add_pointer(self, base: str, kind: str, pointer: _Pointer, causality: str) -> None:
        for role, key in (("base.lo", "lo"), ("base.hi", "hi"), ("size", "size")):
            name = f"{base}.{role}"
            self._osmp[name] = base, role, kind
            put = None if causality == "output" else partial(setattr, pointer, key)
            self._add(Integer, name, causality, partial(getattr, pointer, key), put)

    def _add(
        self, kind: Any, name: str, causality: str, get: Callable[[], Any], put: Callable[[Any], None] | None = None
    ) -> None:
        variability = {"parameter": "fixed", "output": "discrete"}.get(causality)
        variability = variability or ("continuous" if kind is Real else "discrete")
        self.register_variable(
            kind(
                name,
                causality=Fmi2Causality[causality],
                variability=Fmi2Variability[variability],
                getter=get,
                setter=put or (lambda value: None),
            ),
            nested=False,
        )

    def to_xml(self, model_options: dict[str, str] | None = None) -> Element:
        """The model description, with the annotations of OSMP."""
        root: Element = super().to_xml(model_options or {})
        variables = root.find("ModelVariables")
        assert variables is not None
        vendor = Element("VendorAnnotations")
        tool = SubElement(vendor, "Tool", name=OSMP)
        SubElement(tool, "osmp:osmp", {"xmlns:osmp": OSMP_XMLNS, "version": OSMP_VERSION, "osi-version": OSI_VERSION})
        root.insert(list(root).index(variables), vendor)
        structure = root.find("ModelStructure")
        assert structure is not None
        first = SubElement(structure, "InitialUnknowns")
        for number, variable in enumerate(variables):
            if variable.get("causality") == "output":
                SubElement(first, "Unknown", index=str(number + 1))
            if variable.get("name") in self._osmp:
                base, role, kind = self._osmp[str(variable.get("name"))]
                tool = SubElement(SubElement(variable, "Annotations"), "Tool", name=OSMP)
                mime = f"{MIME}; type={kind}; version={OSI_VERSION}"
                words = {"xmlns:osmp": OSMP_XMLNS, "name": base, "role": role, "mime-type": mime}
                SubElement(tool, "osmp:osmp-binary-variable", words)
        return root

    # ------------------------------------------------------------ life

    def setup_experiment(self, start_time: float, stop_time: float | None, tolerance: float | None) -> None:
        """The run's time begins at the master's `start_time`."""
        self._start_s = start_time

    def exit_initialization_mode(self) -> None:
        """The run begins; its links accept hosts when this returns."""
        words = shlex.split(self._given["lidaremu"] or os.environ.get("LIDAREMU", "")) or self._config["command"]
        words = [*words, "run", str(Path(self.resources) / self._config["scenario"]), "--clock", "virtual", "--no-wait"]
        words += ["--json", "--until-eof", "--duration", str(self._config["longest_s"])]
        words += ["--record", self._given["record"]] if self._given["record"] else []
        words += ["--speed", repr(self._given["speed"])] if self._given["speed"] > 0.0 else []
        try:
            self._run = _Run(words)
        except _Failed as error:
            self._say(str(error))
            raise  # pythonfmu logs it as fatal
        for row in self._run.ready["sensors"]:
            self._links[row["id"]] = " ".join(row["links"])

    def _say(self, why: str) -> None:
        """To standard error, once: pythonfmu drops its log where the master has logging off, and does not tell that."""
        if why == self._reported or sys.stderr is None:
            return
        self._reported = why
        with contextlib.suppress(OSError, ValueError):
            text = "".join(one if one.isprintable() or one == "\n" else ascii(one)[1:-1] for one in why)
            sys.stderr.write(f"lidaremu: FMU {self.instance_name}: {text}\n")
            sys.stderr.flush()

    def do_step(self, current_time: float, step_size: float) -> bool:
        """Time moves to the end of the step, where actors are as the inputs say."""
        try:
            self._step(round((current_time + step_size - self._start_s) * 1e9))
        except (_Failed, ValueError) as error:
            self.log(str(error), Fmi2Status.error)
            self._say(str(error))
            self._valid = False
            return False
        return True

    def _step(self, t_ns: int) -> None:
        if self._run is None:
            raise _Failed("no run; want fmi2ExitInitializationMode before the first step")
        view = self._view.take()
        actors = self._actors()
        request: dict[str, object] = {"op": "step", "t_ns": t_ns, "want": ["osi"]}
        if view:
            if actors:
                self._run.ask({"op": "update", "t_ns": t_ns, "actors": actors})
            done, messages = self._run.ask(request | {"osi": len(view), "osi_type": "SensorView"}, view)
        else:
            done, messages = self._run.ask(request | {"actors": actors})
        for name in self._sent:
            self._in_step[name] = int(done["sent"].get(name, 0))
            self._sent[name] += self._in_step[name]
            self._data[name].show(messages.get(name))
        self._next_s = -1.0 if done["next_s"] is None else float(done["next_s"]) + self._start_s
        self._valid = True

    def _actors(self) -> list[dict[str, object]]:
        """Actors of which the master has given anything."""
        found = []
        for name, given in self._set.items():
            if not given:
                continue
            pose = self._poses[name]
            row: dict[str, object] = {
                "id": name,
                "reference": "origin",
                "at_m": [pose["x_m"], pose["y_m"], pose["z_m"]],
                "yaw_deg": pose["yaw_deg"],
                "pitch_deg": pose["pitch_deg"],
                "roll_deg": pose["roll_deg"],
            }
            if given & set(VELOCITY):
                row["velocity_m_s"] = [pose.get(key, 0.0) for key in VELOCITY]
            if TURN in given:
                row["turn_rate_deg_s"] = pose[TURN]
            found.append(row)
        return found

    def terminate(self) -> None:
        """The run ends; `sha256` is that of its bytes."""
        if self._run is not None:
            run, self._run = self._run, None
            self._sha256 = str(run.close().get("sha256", ""))

    def __del__(self) -> None:
        with contextlib.suppress(Exception):
            self.terminate()
