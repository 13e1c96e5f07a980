"""Fuzzing of every parser of untrusted input: each parser in a process of its own, seeded, within bounds.

Belongs here: the table of parsers, the loop, what counts as a fault, and saving it. Not: what the parsers are fed with
(mutations, fuzz_*), coverage-guided search (fuzz_guided).

A fault is an exception other than a refusal by name, an input that takes longer than `SLOW_S` of CPU, memory over
`MOST_MEMORY`, or the end of the process.
"""

from __future__ import annotations

import contextlib
import hashlib
import mmap
import multiprocessing
import os
import resource
import signal
import traceback
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import partial
from multiprocessing.connection import Connection
from pathlib import Path
from types import FrameType
from typing import Any

import numpy as np

from emulator.endurance import fuzz_files, fuzz_hosts, fuzz_sessions
from emulator.endurance.mutations import LONGEST, minimised, mutated
from protocols.session import LinkKind

SLOW_S = 2.0
"CPU seconds that one input of at most 64 kB may take."
HANG_S = 10
MOST_MEMORY = 3 << 30
"Address space of a process that fuzzes."
MOST_FAULTS = 20
"Different faults of one parser after which it is left alone."


@dataclass(frozen=True)
class Parser:
    """Something that reads what others wrote."""

    name: str
    make: Callable[[], Callable[[bytes], None]]
    seeds: Callable[[], Sequence[bytes]]
    words: tuple[bytes, ...] = ()


def _session(name: str, model: str, kind: LinkKind, seeds: Sequence[bytes]) -> Parser:
    return Parser(name, lambda: fuzz_sessions.conversation(model, kind), lambda: seeds)


def _mesh(suffix: str, words: tuple[bytes, ...] = ()) -> Parser:
    return Parser(f"mesh{suffix}", lambda: fuzz_files.meshes(suffix), lambda: fuzz_files.mesh_seeds(suffix), words)


def _recording(suffix: str) -> Parser:
    return Parser(
        f"recording{suffix}", lambda: fuzz_files.recordings(suffix), lambda: fuzz_files.recording_seeds(suffix)
    )


YAML_WORDS = (
    b"&a ",
    b"*a",
    b"!!int ",
    b"<<: *a\n",
    b"? ",
    b"- ",
    b"{",
    b"[",
    b"\n  ",
    b"|\n",
    b"'",
    b'"',
    b"\t",
    b"---\n",
)
SCENARIO_WORDS = (*YAML_WORDS, b"mesh: /etc/passwd", b"at_m: [1e308, .nan, 0]", b"sensors:\n", b"id: front", b"- {}\n")
GLTF_WORDS = (b'"uri":"../../etc/passwd"', b'"byteLength":4294967295', b'"count":1e9', b'"children":[0]', b'"mesh":0')
PLY_WORDS = (b"property list uchar int x\n", b"element vertex 4294967295\n", b"element face 0\n", b"end_header\n")
CAN_WORDS = (b"< send ", b"< open ", b" >", b"< rawmode >", b"FFFFFFFF", b"< bcmmode >", b"< isotpmode >")
SLCAN_WORDS = (b"\r", b"\a", b"t7FF8", b"TFFFFFFFF0", b"S9", b"sFFFF", b"O\r", b"Z1\r")
ORDER_WORDS = (b'"params"', b"[[[[", b'"method": "stop"', b"1e999", b"NaN", b'"weather"', b'"fault"', b"{}", b"\\u0000")

PARSERS = (
    _session("lms2xx", "sick-lms291-s05", LinkKind.SERIAL, fuzz_sessions.LMS),
    _session("ld-tcp", "sick-ld-lrs1000", LinkKind.STREAM, fuzz_sessions.LD_STREAM),
    _session("ld-udp", "sick-ld-lrs1000", LinkKind.DATAGRAM, fuzz_sessions.LD_STREAM),
    _session("ld-serial", "sick-ld-lrs1000", LinkKind.SERIAL, fuzz_sessions.LD_SERIAL),
    _session("ld-can", "sick-ld-oem1000", LinkKind.CAN, fuzz_sessions.LD_CAN),
    _session("cola", "sick-lms511", LinkKind.STREAM, fuzz_sessions.COLA),
    _session("cola-mrs", "sick-mrs1104", LinkKind.STREAM, fuzz_sessions.COLA),
    _session("cola-serial", "sick-lms111", LinkKind.SERIAL, fuzz_sessions.COLA),
    _session("can-ars408", "can-ars408", LinkKind.CAN, fuzz_sessions.CAN_OBJECTS),
    _session("can-ldmrs", "can-ldmrs", LinkKind.CAN, fuzz_sessions.CAN_OBJECTS),
    _session("can-esr", "can-esr", LinkKind.CAN, fuzz_sessions.CAN_OBJECTS),
    _session("can-vu8", "can-leddar-vu8", LinkKind.CAN, fuzz_sessions.CAN_OBJECTS),
    _session("can-m16", "can-leddar-m16", LinkKind.CAN, fuzz_sessions.CAN_OBJECTS),
    _session("scip-tcp", "hokuyo-ust-10lx", LinkKind.STREAM, fuzz_sessions.SCIP),
    _session("scip-serial", "hokuyo-urg-04lx", LinkKind.SERIAL, fuzz_sessions.SCIP),
    _session("velodyne", "velodyne-vlp-16", LinkKind.STREAM, fuzz_sessions.VELODYNE),
    _session("hesai-xt32", "hesai-xt32", LinkKind.STREAM, fuzz_sessions.HESAI),
    _session("hesai-ot128", "hesai-ot128", LinkKind.STREAM, fuzz_sessions.HESAI),
    Parser("host-hesai", fuzz_hosts.hesai_reader, lambda: fuzz_hosts.HESAI_SEEDS),
    _session("ouster", "ouster-os0-32", LinkKind.STREAM, fuzz_sessions.OUSTER),
    _session("rplidar-serial", "rplidar-a1m8", LinkKind.SERIAL, fuzz_sessions.RPLIDAR),
    _session("rplidar-udp", "rplidar-s2m1", LinkKind.DATAGRAM, fuzz_sessions.RPLIDAR),
    _session("ldrobot", "ldrobot-ld19", LinkKind.SERIAL, fuzz_sessions.LDROBOT),
    _session("ydlidar-x4", "ydlidar-x4", LinkKind.SERIAL, fuzz_sessions.YDLIDAR),
    _session("ydlidar-g4", "ydlidar-g4", LinkKind.SERIAL, fuzz_sessions.YDLIDAR),
    Parser("host-ldrobot", fuzz_hosts.ldrobot_reader, lambda: fuzz_hosts.LDROBOT_SEEDS),
    Parser("host-ydlidar", fuzz_hosts.ydlidar_reader, lambda: fuzz_hosts.YDLIDAR_SEEDS),
    Parser("socketcand", fuzz_hosts.socketcand, lambda: fuzz_hosts.CAN_SEEDS, CAN_WORDS),
    Parser("slcan", fuzz_hosts.slcan, lambda: fuzz_hosts.SLCAN_SEEDS, SLCAN_WORDS),
    Parser("control", fuzz_hosts.control, lambda: fuzz_hosts.ORDER_SEEDS, ORDER_WORDS),
    Parser("links", fuzz_hosts.links, lambda: fuzz_hosts.URL_SEEDS),
    Parser("host-lms2xx", fuzz_hosts.telegram_reader, lambda: fuzz_hosts.READER_SEEDS),
    Parser("yaml", fuzz_files.yaml, lambda: fuzz_files.YAMLS, YAML_WORDS),
    Parser("scenario", fuzz_files.scenarios, fuzz_files.scenario_seeds, SCENARIO_WORDS),
    Parser(
        "expressions", fuzz_files.expressions, lambda: fuzz_files.EXPRESSIONS, (b"(", b"not ", b"**", b"max(", b'"')
    ),
    _mesh(".glb", GLTF_WORDS),
    _mesh(".gltf", GLTF_WORDS),
    _mesh(".obj", (b"f -1 -2 -3\n", b"v nan nan nan\n", b"f 1 2 99999999999\n", b"usemtl ")),
    _mesh(".ply", PLY_WORDS),
    _mesh(".stl", (b"solid ", b"facet normal 0 0 0\n", b"outer loop\n", b"vertex 1e999 0 0\n", b"endsolid\n")),
    *(_recording(suffix) for suffix in (".mcap", ".pcapng", ".pcap", ".blf", ".asc", ".log", ".raw")),
)
"Everything that reads what an untrusted party wrote."


@dataclass(frozen=True)
class Fault:
    """An input that a parser did not bear."""

    parser: str
    data: bytes
    kind: str
    "Name of the exception and where it came from; `slow`, `hung`, or how the process ended."
    detail: str


@dataclass
class Outcome:
    """What one parser has shown."""

    parser: str
    cases: int = 0
    seconds: float = 0.0
    peak_mb: float = 0.0
    slowest_ms: float = 0.0
    faults: list[Fault] = field(default_factory=list)


class Hung(BaseException):
    """An input has taken too long; no handler of ordinary exceptions stops it."""


def _on_alarm(_number: int, _frame: FrameType | None) -> None:
    raise Hung


def _cpu_s() -> float:
    used = resource.getrusage(resource.RUSAGE_SELF)
    return used.ru_utime + used.ru_stime


def attempt(run: Callable[[bytes], None], data: bytes) -> tuple[str, str] | None:
    """Kind and detail of the fault that this input makes, None when there is none."""
    began = _cpu_s()
    signal.setitimer(signal.ITIMER_PROF, HANG_S)
    try:
        run(data)
    except Hung:
        return "hung", f"more than {HANG_S} s of CPU"
    except Exception as error:
        frames = traceback.extract_tb(error.__traceback__)
        ours = next(
            (one for one in reversed(frames) if "/emulator/" in one.filename or "/protocols/" in one.filename), None
        )
        place = "" if ours is None else f"{Path(ours.filename).name}:{ours.name}"
        return f"{type(error).__name__} in {place}", traceback.format_exc()
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)
    took = _cpu_s() - began
    return ("slow", f"{took:.1f} s of CPU") if took > SLOW_S else None


def cases(parser: Parser, seed: int) -> Iterator[bytes]:
    """Inputs without end: the good examples first, then their mutations."""
    seeds = list(parser.seeds())
    yield from seeds
    rng = np.random.default_rng([seed, *parser.name.encode()])
    while True:
        yield mutated(seeds, parser.words, rng)


def fuzz_here(parser: Parser, seconds: float, seed: int, now: mmap.mmap | None = None) -> Outcome:
    """In this process, for so many seconds of CPU. `now`: where an input is written down before it is tried."""
    outcome, known = Outcome(parser.name), set()
    signal.signal(signal.SIGPROF, _on_alarm)
    run = parser.make()
    began = _cpu_s()
    for data in cases(parser, seed):
        if now is not None:
            now[:8] = len(data).to_bytes(8, "little")
            now[8 : 8 + len(data)] = data
        start = _cpu_s()
        found = attempt(run, data)
        end = _cpu_s()
        outcome.cases += 1
        outcome.slowest_ms = max(outcome.slowest_ms, 1e3 * (end - start))
        if found is not None and found[0] not in known:
            known.add(found[0])
            kind = found[0]
            small = data if kind in ("slow", "hung") else minimised(data, partial(_same, run, kind))
            outcome.faults.append(Fault(parser.name, small, kind, found[1]))
        if end - began >= seconds or len(known) >= MOST_FAULTS:
            break
    outcome.seconds = _cpu_s() - began
    outcome.peak_mb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    return outcome


def _same(run: Callable[[bytes], None], kind: str, data: bytes) -> bool:
    found = attempt(run, data)
    return found is not None and found[0] == kind


def _child(parser: Parser, seconds: float, seed: int, shared: mmap.mmap, answer: Connection) -> None:
    resource.setrlimit(resource.RLIMIT_AS, (MOST_MEMORY, MOST_MEMORY))
    with open(os.devnull, "w") as nowhere:
        os.dup2(nowhere.fileno(), 1)
        os.dup2(nowhere.fileno(), 2)
    answer.send(fuzz_here(parser, seconds, seed, shared))


def fuzz(parser: Parser, seconds: float, seed: int) -> Outcome:
    """In a process of its own, so that even its end is only a fault."""
    shared = mmap.mmap(-1, LONGEST + 8)
    context = multiprocessing.get_context("fork")
    ours, theirs = context.Pipe()
    process = context.Process(target=_child, args=(parser, seconds, seed, shared, theirs), daemon=True)
    process.start()
    theirs.close()
    try:
        with contextlib.suppress(EOFError):
            outcome: Outcome = ours.recv()
            return outcome
        process.join()
        size = int.from_bytes(shared[:8], "little")
        code = process.exitcode or 0
        kind = f"ended by signal {-code}" if code < 0 else f"ended with code {code}"
        return Outcome(parser.name, faults=[Fault(parser.name, bytes(shared[8 : 8 + size]), kind, kind)])
    finally:
        ours.close()
        process.join(5.0)
        if process.is_alive():
            process.kill()


def save(fault: Fault, folder: Path) -> Path:
    """Write an input and what it did into a folder; the path of the input."""
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / f"{fault.parser}-{hashlib.sha256(fault.data).hexdigest()[:12]}.bin"
    path.write_bytes(fault.data)
    path.with_suffix(".txt").write_text(f"{fault.kind}\n{fault.detail}\n", encoding="utf-8")
    return path


def reported(outcome: Outcome) -> dict[str, Any]:
    """One parser's row, ready for JSON."""
    return {
        "parser": outcome.parser,
        "cases": outcome.cases,
        "cpu_s": round(outcome.seconds, 2),
        "cases_per_s": round(outcome.cases / outcome.seconds) if outcome.seconds else 0,
        "slowest_ms": round(outcome.slowest_ms, 1),
        "peak_mb": round(outcome.peak_mb, 1),
        "faults": [fault.kind for fault in outcome.faults],
    }
