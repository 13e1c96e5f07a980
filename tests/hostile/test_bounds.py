"""What a flood may cost: bytes a step, rates, and parsers that bear anything; files are data and never code."""

from __future__ import annotations

import ast
import contextlib
import re
import socket
import tracemalloc
from itertools import islice
from pathlib import Path

import numpy as np
import pytest

from emulator.endurance.fuzz import PARSERS, Parser, attempt, cases
from emulator.endurance.mutations import LONGEST, minimised, mutated
from emulator.sensors.spec import load_spec
from emulator.transports.intake import LINE_BURST, LINE_BYTES_S, STREAM_BURST, STREAM_BYTES_S, Intake
from emulator.transports.link import Received
from emulator.transports.schemes import open_link
from emulator.transports.tcp_hosts import MAX_HOSTS
from protocols import family
from protocols.can_frame import EXTENDED, frame_bits
from protocols.can_objects.session import MOST_REPLIES, CanObjectSession
from protocols.session import Address, Dropped, DropReason, LinkKind

ROOT = Path(__file__).resolve().parents[2]
SECOND_NS = 1_000_000_000


@pytest.mark.parametrize(("rate", "burst"), [(LINE_BYTES_S, LINE_BURST), (STREAM_BYTES_S, STREAM_BURST)])
def test_an_intake_holds_its_rate_whatever_the_steps(rate: int, burst: int) -> None:
    for step_ns in (10_000, 999_983, 20_000_000):
        intake, taken = Intake(rate, burst), 0
        for now_ns in range(0, SECOND_NS, step_ns):
            room = intake.room(now_ns)
            assert 0 <= room <= burst
            intake.take(room)
            taken += room
        assert 0.85 * min(rate, burst * SECOND_NS / step_ns) <= taken <= rate + burst


def test_an_empty_intake_says_when_it_opens_and_keeps_its_word() -> None:
    intake = Intake(1000, 100)
    assert intake.next_ns() is None
    intake.take(intake.room(0))
    assert intake.closed
    wake = intake.next_ns()
    assert wake == 25_000_000
    assert intake.room(wake - 1_000_000) == 0
    assert intake.room(wake) == 25
    assert not intake.closed


def test_one_datagram_may_overdraw_and_is_paid_back() -> None:
    intake = Intake(1000, 100)
    intake.take(1100)
    assert intake.next_ns() == 1_025_000_000


def test_who_floods_a_port_for_long_makes_room_for_who_wants_to_come() -> None:
    link = open_link("tcp:127.0.0.1:0", serial_line=False)
    address = ("127.0.0.1", int(link.url.rpartition(":")[2]))
    floods = [socket.create_connection(address) for _ in range(MAX_HOSTS)]
    seen: list[Received] = []

    def flooded(from_s: int, to_s: int) -> None:
        for now_ns in range(from_s * SECOND_NS, to_s * SECOND_NS, SECOND_NS // 10):
            for flood in floods[:-1]:
                with contextlib.suppress(BlockingIOError):
                    flood.send(b"\xaa" * 65_536)
            with contextlib.suppress(BlockingIOError):
                floods[-1].send(b"a request")
            seen.extend(link.receive(now_ns))

    try:
        for flood in floods:
            flood.setblocking(False)
        flooded(0, 9)
        assert sum(one.opened for one in seen) == MAX_HOSTS
        early = socket.create_connection(address)
        seen.extend(link.receive(9 * SECOND_NS))
        assert sum(one.opened for one in seen) == MAX_HOSTS, "who floods for a moment stays"
        for flood in floods[:-1]:
            flood.close()  # what they wrote is still read
        floods[:-1] = []
        flooded(9, 12)
        late = socket.create_connection(address)
        seen.extend(link.receive(12 * SECOND_NS))
        (gone,) = [one.peer for one in seen if one.closed]
        assert [one.peer for one in seen if one.opened][MAX_HOSTS:] == [MAX_HOSTS + 1]
        assert gone != MAX_HOSTS, "who asks now and then stays"
        assert link.stats.hosts_refused == 2
        early.close()
        late.close()
    finally:
        for flood in floods:
            flood.close()
        link.close()


def test_identifiers_of_a_flood_of_frames_do_not_pile_up() -> None:
    frame_bits(0x100, b"")
    tracemalloc.start()
    for peer in range(8192):
        frame_bits(peer | EXTENDED, b"")
    grown = tracemalloc.get_traced_memory()[0]
    tracemalloc.stop()
    assert grown < 128_000


def test_a_flood_of_commands_on_a_bus_does_not_pile_up_replies() -> None:
    spec = load_spec("can-ars408")
    assert spec.family is not None
    session = family(spec.family).new_session({}, spec.device)
    assert isinstance(session, CanObjectSession)
    session.connected(0, Address(0, 0), LinkKind.CAN)
    session.power_on(0)
    now_ns = 30 * SECOND_NS
    for _ in range(2000):
        now_ns += 250_000
        session.receive(bytes.fromhex("0e00000000000000"), now_ns, Address(0, 0x401))
        session.take_emissions(now_ns)
        assert len(session._bus.replies) <= MOST_REPLIES
    busy = [event for event in session.take_events() if isinstance(event, Dropped) and event.reason is DropReason.BUSY]
    assert busy


CASES = dict.fromkeys(("can-ars408", "can-ldmrs", "can-esr", "scenario", "ld-udp"), 12)
CASES |= dict.fromkeys(("ldrobot", "velodyne", "ydlidar-x4", "ydlidar-g4"), 25)
"Of parsers that play a whole device: each case takes as long as many of others."


@pytest.mark.parametrize("parser", PARSERS, ids=lambda parser: parser.name)
def test_a_parser_bears_anything(parser: Parser) -> None:
    """The short one of CI; `lidaremu study fuzz` is the long one."""
    run = parser.make()
    for data in islice(cases(parser, 3), CASES.get(parser.name, 100)):
        assert attempt(run, data) is None, data


def test_mutations_come_from_the_seed_alone_and_keep_their_length() -> None:
    seeds = (b"hello world" * 10_000, b"x")
    one, two = ([mutated(seeds, (b"word",), np.random.default_rng(seed)) for _ in range(1)] for seed in (4, 4))
    assert one == two
    rng = np.random.default_rng(1)
    assert max(len(mutated(seeds, (), rng)) for _ in range(50)) <= LONGEST


def test_a_fault_is_made_as_small_as_it_can_be() -> None:
    assert minimised(b"a lot of noise, then BAD and more", lambda data: b"BAD" in data) == b"BAD"


FORBIDDEN_CALLS = {"eval", "exec", "compile", "__import__"}
FORBIDDEN_MODULES = {"pickle", "marshal", "shelve", "dill", "cloudpickle"}
SHELL = {"system", "popen"}
NAMES = re.compile(
    "|".join((*FORBIDDEN_CALLS, *FORBIDDEN_MODULES, *SHELL, "shell", "allow_pickle", r"\bnp\.load\b", r"numpy\.load"))
)
"Without one of these words no file does any of it: it need not be parsed."


def test_files_are_data_and_never_code() -> None:
    """No source of the product evaluates a text, unpickles, or asks a shell; YAML is read as events alone."""
    found = []
    for path in [*ROOT.glob("emulator/**/*.py"), *ROOT.glob("protocols/**/*.py")]:
        source = path.read_text()
        for node in ast.walk(ast.parse(source)) if NAMES.search(source) else ():
            names: set[str] = set()
            if isinstance(node, ast.Import):
                names = {alias.name.partition(".")[0] for alias in node.names} & FORBIDDEN_MODULES
            elif isinstance(node, ast.ImportFrom):
                names = {str(node.module).partition(".")[0]} & FORBIDDEN_MODULES
            elif isinstance(node, ast.Call):
                function = node.func
                if isinstance(function, ast.Name):
                    names = {function.id} & FORBIDDEN_CALLS
                elif isinstance(function, ast.Attribute) and isinstance(function.value, ast.Name):
                    names = {function.attr} & SHELL if function.value.id == "os" else set()
                    if function.value.id in ("np", "numpy") and function.attr == "load":
                        names = {"numpy.load"}
                names |= {"shell=True" for word in node.keywords if word.arg == "shell"}
                names |= {"allow_pickle" for word in node.keywords if word.arg == "allow_pickle"}
            found += [f"{path.relative_to(ROOT)}:{node.lineno}: {name}" for name in names]
    assert found == []


def test_yaml_is_parsed_by_one_module_alone() -> None:
    users = {
        str(path.relative_to(ROOT))
        for path in ROOT.glob("emulator/**/*.py")
        if "ruamel.yaml" in path.read_text() and "import" in path.read_text()
    }
    readers = {name for name in users if "YAML(" in (ROOT / name).read_text()}
    assert all('typ="safe"' in (ROOT / name).read_text() for name in readers), readers
