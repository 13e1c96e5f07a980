"""CAN sockets of drivers under the preload shim: can-utils, python-can, a C++ driver, and every call by itself.

The bus runs here, in the test's own time; programs run beside it and are waited for by what they say.
"""

from __future__ import annotations

import os
import select
import shutil
import socket
import subprocess
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path

import pytest

from emulator.errors import LinkError
from emulator.transports.can_link import CanLink, CanPorts
from emulator.transports.can_sockets import FIRST_INDEX, CanSockets, Options, ready_filter
from emulator.transports.link import Received
from emulator.transports.schemes import open_link
from emulator.transports.shim import find_compiler, shim_environment
from protocols.can_frame import EXTENDED

HERE = Path(__file__).parent
MS = 1_000_000
SECOND = 1_000_000_000
EPOCH_NS = 1_700_000_000 * SECOND
LOOKS = 6000
"Of 5 ms at most: a program that has not answered by then never will."

pytestmark = pytest.mark.skipif(find_compiler(os.environ) is None, reason="no C compiler here")
needs_can_utils = pytest.mark.skipif(shutil.which("candump") is None, reason="can-utils is not installed")

SHELL = """
import errno, fcntl, os, select, socket, struct, sys, threading
from socket import *
def frame(i, data=b"", n=None): return struct.pack("=IB3x8s", i, len(data) if n is None else n, data)
def plain(f): return struct.unpack("=I", f[:4])[0], f[8:8 + f[4]]
def bound(name="can0", **options):
    s = socket(AF_CAN, SOCK_RAW, CAN_RAW)
    s.bind((name,))
    return s
def error(call, *given):
    try:
        return call(*given)
    except OSError as problem:
        return errno.errorcode.get(problem.errno, str(problem))
print("ready", flush=True)
for line in sys.stdin:
    try:
        try:
            print(repr(eval(line)), flush=True)
        except SyntaxError:
            exec(line)
            print("None", flush=True)
    except Exception as problem:
        print(repr(problem), flush=True)
"""
"A driver that does what it is told, a line of Python at a time."


@pytest.fixture(scope="module")
def shimmed(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """An environment with the shim, built in a cache of its own."""
    return shim_environment({**os.environ, "XDG_CACHE_HOME": str(tmp_path_factory.mktemp("cache"))})


class Rig:
    """Buses can0 and can1, and programs under the shim."""

    def __init__(self, environment: dict[str, str]) -> None:
        self.sockets = CanSockets()
        self.ports = CanPorts(self.sockets, lambda ns: EPOCH_NS + ns)
        self.links = [self.open(f"can:socketcan:can{k}") for k in range(2)]
        self.link = self.links[0]
        self.environment = {**environment, **self.sockets.environment()}
        self.now_ns = SECOND
        self.programs: list[subprocess.Popen[bytes]] = []
        self.heard: list[list[Received]] = [[], []]

    def open(self, url: str) -> CanLink:
        link = open_link(url, can_ports=self.ports)
        assert isinstance(link, CanLink)
        return link

    def step(self, wait_s: float = 0.0) -> None:
        filenos = [number for link in self.links for number in link.filenos()]
        select.select(filenos, [], [], wait_s)
        for link, heard in zip(self.links, self.heard, strict=True):
            heard += link.receive(self.now_ns)
            link.flush(self.now_ns)
        self.now_ns += MS // 10

    def start(self, *command: str) -> subprocess.Popen[bytes]:
        program = subprocess.Popen(
            command,
            env=self.environment,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            bufsize=0,
        )
        self.programs.append(program)
        return program

    def line(self, program: subprocess.Popen[bytes]) -> str:
        """Its next line; time and the bus go on meanwhile."""
        assert program.stdout is not None
        text = b""
        for _ in range(LOOKS):
            self.step()
            while not text.endswith(b"\n") and select.select([program.stdout], [], [], 0.005)[0]:
                letter = program.stdout.read(1)
                if not letter:
                    raise AssertionError(f"ended after {text!r}: {program.stderr and program.stderr.read()!r}")
                text += letter
            if text.endswith(b"\n"):
                return text.decode().strip()
        raise AssertionError(f"said {text!r} and no more")

    def run(self, *command: str) -> tuple[int, str]:
        """A program to its end: exit code and all it said, the shim's own line taken away."""
        program = self.start(*command)
        for _ in range(LOOKS):
            self.step(0.005)
            if program.poll() is not None:
                break
        out, errors = program.communicate(timeout=10)
        for _ in range(5):
            self.step()
            self.now_ns += MS
        lines = [line for line in (out + errors).decode().splitlines() if "lidaremu shim" not in line]
        return program.returncode, "\n".join(lines)

    def send(self, data: bytes, peer: int = 0x60A, bus: int = 0) -> None:
        self.links[bus].send(data, self.now_ns, peer)

    def hear(self, count: int, bus: int = 0) -> list[Received]:
        for _ in range(LOOKS):
            if len(self.heard[bus]) >= count:
                break
            self.step(0.001)
        return self.heard[bus]

    def settle(self) -> None:
        """All that is on its way arrives."""
        for _ in range(20):
            self.step()
            self.now_ns += MS

    def close(self) -> None:
        for program in self.programs:
            if program.poll() is None:
                program.kill()
            program.communicate()
        for link in self.links:
            link.close()
        self.sockets.close()


@pytest.fixture
def rig(shimmed: dict[str, str]) -> Iterator[Rig]:
    made = Rig(shimmed)
    yield made
    made.close()


class Shell:
    """A program that does a line of Python at a time."""

    def __init__(self, rig: Rig) -> None:
        self.rig = rig
        self.program = rig.start(sys.executable, "-S", "-c", SHELL)
        assert rig.line(self.program) == "ready"

    def __call__(self, text: str) -> object:
        assert self.program.stdin is not None
        self.program.stdin.write(text.encode() + b"\n")
        answer = self.rig.line(self.program)
        try:
            return eval(answer)
        except (SyntaxError, NameError):
            return answer


@pytest.fixture
def do(rig: Rig) -> Shell:
    return Shell(rig)


# ---------------------------------------------------------------- programs as they are


@needs_can_utils
def test_candump_shows_what_the_sensor_sends_with_the_time_of_its_last_bit(rig: Rig) -> None:
    candump = rig.start("candump", "-L", "-n", "3", "can0")
    while not rig.link.has_host():
        rig.step(0.005)
    at_ns = rig.now_ns
    rig.send(bytes.fromhex("03FBF710"))
    rig.send(b"", 0x12345 | EXTENDED)
    rig.send(bytes(8), 0x60B)
    lines = [rig.line(candump) for _ in range(3)]
    assert [line.partition(" ")[2] for line in lines] == ["can0 60A#03FBF710", "can0 00012345#", "can0 60B#" + "00" * 8]
    stamp = float(lines[0][1:].partition(")")[0])
    assert stamp == pytest.approx((EPOCH_NS + at_ns) / SECOND + 83 * 2e-6, abs=20e-6)
    rig.settle()
    assert candump.wait(10) == 0


@needs_can_utils
def test_cansend_reaches_the_sensor_though_it_ends_at_once(rig: Rig) -> None:
    assert rig.run("cansend", "can0", "200#B91F4000088C0100") == (0, "")
    assert rig.run("cansend", "can1", "1F334455#11") == (0, "")
    assert rig.hear(1) == [Received(0x200, bytes.fromhex("B91F4000088C0100"))]
    assert rig.hear(1, 1) == [Received(0x1F334455 | EXTENDED, b"\x11")]


@needs_can_utils
def test_what_cansend_must_refuse_it_refuses_as_on_a_classical_bus(rig: Rig) -> None:
    assert rig.run("cansend", "can0", "123##1AABB")[1] == "CAN interface is not CAN FD capable - sorry."
    assert rig.run("cansend", "can0", "123#R") == (1, "write: Operation not supported")
    code, said = rig.run("cansend", "can7", "123#00")
    assert code == 1
    assert "No such device" in said


@needs_can_utils
def test_cangen_floods_at_the_bit_rate_and_loses_nothing(rig: Rig) -> None:
    cangen = rig.start("cangen", "can0", "-g", "0", "-n", "500", "-I", "300", "-L", "8", "-D", "i")
    frames = rig.hear(500)
    assert [int.from_bytes(frame.data, "little") for frame in frames] == list(range(500))
    assert cangen.wait(10) == 0


@needs_can_utils
def test_candump_any_shows_every_bus_filters_and_whose_frame_it_is(rig: Rig) -> None:
    candump = rig.start("candump", "-x", "any,600:700,200:7FF")
    while not all(link.has_host() for link in rig.links):
        rig.step(0.005)
    rig.send(b"\1")
    assert rig.line(candump).split() == ["can0", "RX", "-", "-", "60A", "[1]", "01"]
    rig.send(b"\2", 0x123)
    rig.send(b"\3", 0x6FF, bus=1)
    assert rig.line(candump).split() == ["can1", "RX", "-", "-", "6FF", "[1]", "03"]
    rig.run("cansend", "can0", "200#04")
    assert rig.line(candump).split() == ["can0", "TX", "-", "-", "200", "[1]", "04"]


@needs_can_utils
def test_candump_shows_error_frames_of_the_sensor_s_controller(rig: Rig) -> None:
    candump = rig.start("candump", "-L", "can0,0:0,#FFFFFFFF")
    while not rig.link.has_host():
        rig.step(0.005)
    rig.link.disturb(32)
    rig.send(bytes(8))
    seen = [rig.line(candump).split()[2] for _ in range(3)]
    assert seen == ["20000004#0020000000000000", "20000040#0000000000000000", "20000100#0000000000000000"]


@pytest.fixture(scope="module")
def driver(tmp_path_factory: pytest.TempPathFactory) -> str:
    """The C++ driver, built."""
    if shutil.which("g++") is None:
        pytest.skip("no g++ here")
    program = tmp_path_factory.mktemp("driver") / "ros_driver"
    flags = ["-O2", "-D_FORTIFY_SOURCE=2", "-Wall", "-Wextra", "-Werror"]
    source = HERE / "data" / "ros_driver.cpp"
    subprocess.run(["g++", *flags, "-o", program, source, "-lpthread"], check=True, timeout=120)
    return str(program)


@pytest.mark.parametrize("way", ["poll", "epoll"])
def test_a_driver_in_the_style_of_ros_reads_lists_and_answers(rig: Rig, driver: str, way: str) -> None:
    program = rig.start(driver, "can0", "600", way)
    assert rig.line(program) == "ready"
    begun_ns = rig.now_ns
    for k in range(600):
        rig.send(k.to_bytes(8, "big"))
    lines = [rig.line(program).split() for _ in range(600)]
    assert [(one[0], int(one[2], 16)) for one in lines] == [("60A", k) for k in range(600)]
    times = [float(one[3]) for one in lines]
    assert times == sorted(times)
    assert times[0] == pytest.approx((EPOCH_NS + begun_ns) / SECOND, abs=1e-3)
    assert rig.hear(1) == [Received(0x200, b"\xb9\x00")]
    assert program.wait(10) == 0


def test_python_can_s_own_socketcan_interface_works_unmodified(rig: Rig) -> None:
    program = rig.start(
        sys.executable,
        "-c",
        "import can\n"
        "bus = can.Bus(interface='socketcan', channel='can0', can_filters=[{'can_id': 0x60A, 'can_mask': 0x7FF}])\n"
        "print('ready', flush=True)\n"
        "m = bus.recv(60)\n"
        "print(hex(m.arbitration_id), m.data.hex(), round(m.timestamp), m.is_rx, m.channel, flush=True)\n"
        "bus.send(can.Message(arbitration_id=0x1ABCDE, data=b'x', is_extended_id=True))\n"
        "bus.shutdown()\n",
    )
    assert rig.line(program) == "ready"
    rig.send(b"no", 0x60B)
    rig.send(b"yes")
    assert rig.line(program) == f"0x60a {b'yes'.hex()} {EPOCH_NS // SECOND + 1} True can0"
    assert rig.hear(1) == [Received(0x1ABCDE | EXTENDED, b"x")]


# ---------------------------------------------------------------- call by call


def test_reads_of_every_kind_give_a_frame_and_an_address(rig: Rig, do: Shell) -> None:
    do("s = bound()")
    for k in range(8):
        rig.send(bytes([k]))
    rig.settle()
    assert do("plain(os.read(s.fileno(), 16))") == (0x60A, b"\0")
    assert do("plain(s.recv(72))") == (0x60A, b"\1")
    assert do("len(s.recv(72, MSG_PEEK))") == 16
    assert do("(lambda r: (plain(r[0]), r[1]))(s.recvfrom(16))") == ((0x60A, b"\2"), ("can0",))
    assert do("(lambda a, b: (os.readv(s.fileno(), [a, b]), bytes(b)))(bytearray(8), bytearray(8))") == (
        16,
        b"\3" + bytes(7),
    )
    assert do("(lambda r: (len(r[0]), int(r[2] & MSG_TRUNC), r[3]))(s.recvmsg(5))") == (5, socket.MSG_TRUNC, ("can0",))
    assert do("fcntl.ioctl(s, 0x541B, b'0000')") == (16).to_bytes(4, "little")  # FIONREAD
    do("s.setsockopt(SOL_SOCKET, SO_TIMESTAMPNS if 'SO_TIMESTAMPNS' in dir() else 35, 1)")
    assert do("(lambda r: [(c[0], c[1], struct.unpack('qq', c[2])[0]) for c in r[1]])(s.recvmsg(16, 64))") == [
        (socket.SOL_SOCKET, 35, EPOCH_NS // SECOND + 1)
    ]
    assert do("s.getsockname()") == ("can0",)


def test_non_blocking_use_time_outs_and_select_are_the_kernel_s(rig: Rig, do: Shell) -> None:
    do("s = bound()")
    do("s.setblocking(False)")
    assert do("error(s.recv, 16)") == "EAGAIN"
    assert do("select.select([s], [s], [], 0)[0]") == []
    assert do("len(select.select([s], [s], [], 0)[1])") == 1
    rig.send(b"a")
    rig.settle()
    assert do("len(select.select([s], [], [], 0)[0])") == 1
    assert do("plain(s.recv(16))") == (0x60A, b"a")
    do("s.setblocking(True)")
    do("s.setsockopt(SOL_SOCKET, SO_RCVTIMEO, struct.pack('qq', 0, 20000))")
    assert do("error(s.recv, 16)") == "EAGAIN"


def test_an_unbound_socket_hears_nothing_and_may_send_by_address(rig: Rig, do: Shell) -> None:
    do("s = socket(AF_CAN, SOCK_RAW, CAN_RAW)")
    assert do("error(s.send, frame(1))") == "ENXIO"
    assert do("s.sendto(frame(0x123, b'x'), ('can1',))") == 16
    assert rig.hear(1, 1) == [Received(0x123, b"x")]
    rig.send(b"a")
    rig.send(b"a", bus=1)
    rig.settle()
    do("s.setblocking(False)")
    assert do("error(s.recv, 16)") == "EAGAIN"
    do("s.bind(('can0',))")
    rig.send(b"b")
    rig.settle()
    assert do("plain(s.recv(16))") == (0x60A, b"b")


def test_filters_hold_from_when_the_call_returns(rig: Rig, do: Shell) -> None:
    do("s = bound()")
    do("s.setblocking(False)")
    do("s.setsockopt(SOL_CAN_RAW, CAN_RAW_FILTER, struct.pack('=IIII', 0x60A, 0x7FF, 0x20000123, 0x7FF))")
    do("s.setsockopt(SOL_CAN_RAW, CAN_RAW_JOIN_FILTERS, 1)")
    for peer in (0x123, 0x60A, 0x60B, 0x60A | EXTENDED):
        rig.send(b"", peer)
    rig.settle()
    assert do("plain(s.recv(16))") == (0x60A, b"")
    assert do("plain(s.recv(16))") == (0x60A | EXTENDED, b"")  # its mask leaves bit 31 out
    assert do("error(s.recv, 16)") == "EAGAIN"
    do("s.setsockopt(SOL_CAN_RAW, CAN_RAW_JOIN_FILTERS, 0)")
    for peer in (0x123, 0x60B):
        rig.send(b"", peer)
    rig.settle()
    assert do("plain(s.recv(16))") == (0x60B, b"")
    assert do("error(s.recv, 16)") == "EAGAIN"
    do("s.setsockopt(SOL_CAN_RAW, CAN_RAW_FILTER, None, 0)")
    rig.send(b"", 0x60A)
    rig.settle()
    assert do("error(s.recv, 16)") == "EAGAIN"
    assert do("s.getsockopt(SOL_CAN_RAW, CAN_RAW_FILTER, 64)") == b""


def test_loop_back_and_own_frames_are_as_the_socket_wants(rig: Rig, do: Shell) -> None:
    do("a, b = bound(), bound('can0')")
    do("a.setblocking(False), b.setblocking(False)")
    other = Shell(rig)
    other("s = bound()")
    do("a.send(frame(1))")
    rig.settle()
    assert do("(lambda r: (plain(r[0]), int(r[2])))(b.recvmsg(16))") == ((1, b""), socket.MSG_DONTROUTE)
    assert other("plain(s.recv(16))") == (1, b"")
    assert do("error(a.recv, 16)") == "EAGAIN"
    do("a.setsockopt(SOL_CAN_RAW, CAN_RAW_RECV_OWN_MSGS, 1)")
    do("a.send(frame(2))")
    rig.settle()
    own = socket.MSG_DONTROUTE | socket.MSG_CONFIRM
    assert do("(lambda r: (plain(r[0]), int(r[2])))(a.recvmsg(16))") == ((2, b""), own)
    do("b.recv(16)")
    do("a.setsockopt(SOL_CAN_RAW, CAN_RAW_LOOPBACK, 0)")
    do("a.send(frame(3))")
    rig.settle()
    assert do("[error(one.recv, 16) for one in (a, b)]") == ["EAGAIN", "EAGAIN"]
    assert [frame.peer for frame in rig.heard[0]] == [1, 2, 3]


def test_copies_of_a_descriptor_share_the_socket_until_the_last_is_closed(rig: Rig, do: Shell) -> None:
    do("s = bound()")
    do("t = os.dup(s.fileno())")
    do("u = fcntl.fcntl(t, fcntl.F_DUPFD_CLOEXEC, 50)")
    do("os.dup2(u, 77)")
    do("s.close(), os.close(t), os.close(u)")
    rig.send(b"a")
    rig.settle()
    assert do("plain(os.read(77, 72))") == (0x60A, b"a")
    assert rig.link.has_host()
    do("os.close(77)")
    rig.settle()
    assert not rig.link.has_host()


def test_a_forked_child_sends_on_its_parent_s_socket(rig: Rig) -> None:
    program = (
        "import os, socket, struct\n"
        "s = socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW)\n"
        "s.bind(('can0',))\n"
        "if os.fork() == 0:\n"
        "    s.send(struct.pack('=IB3x8s', 0x11, 0, b'')), s.close(), os._exit(0)\n"
        "os.wait()\n"
        "s.send(struct.pack('=IB3x8s', 0x12, 0, b''))\n"
    )
    assert rig.run(sys.executable, "-c", program) == (0, "")
    assert [frame.peer for frame in rig.hear(2)] == [0x11, 0x12]


def test_a_child_of_vfork_that_closes_everything_leaves_the_parent_its_socket(rig: Rig, do: Shell) -> None:
    do("s = bound()")
    do("import subprocess")
    assert do("subprocess.run(['true'], close_fds=True).returncode") == 0
    assert do("s.send(frame(7))") == 16
    assert do("error(s.send, b'short')") == "EINVAL"
    assert rig.hear(1) == [Received(7, b"")]


def test_a_number_that_is_somebody_else_s_by_now_is_no_can_socket(rig: Rig, do: Shell) -> None:
    do("s = bound()")
    do("n = s.fileno()")
    do("os.closerange(n, n + 1)")  # close_range of the kernel: no close of the C library
    do("r, w = os.pipe()")
    assert do("n in (r, w) and os.write(w, b'plain')") == 5
    assert do("os.read(r, 5)") == b"plain"
    do("s.detach()")


@pytest.mark.parametrize(
    ("call", "error"),
    [
        ("socket(AF_CAN, SOCK_DGRAM, CAN_BCM)", "EPROTONOSUPPORT"),
        ("socket(AF_CAN, SOCK_DGRAM, CAN_ISOTP)", "EPROTONOSUPPORT"),
        ("socket(AF_CAN, SOCK_DGRAM, CAN_J1939)", "EPROTONOSUPPORT"),
        ("socket(AF_CAN, SOCK_DGRAM, CAN_RAW)", "EPROTOTYPE"),
        ("socket(AF_CAN, SOCK_RAW, 99)", "EINVAL"),
        ("bound().send(frame(1)[:15])", "EINVAL"),
        ("bound().send(bytes(72))", "EINVAL"),
        ("bound().send(frame(1, b'', 9))", "EINVAL"),
        ("bound().send(frame(1 | 1 << 30))", "ENOTSUP"),
        ("bound().sendto(frame(1), ('lo',))", "ENXIO"),
        ("bound('lo')", "ENODEV"),
        ("bound('can7')", "ENODEV"),
        ("bound().setsockopt(SOL_CAN_RAW, 7, 1)", "ENOPROTOOPT"),
        ("bound().setsockopt(SOL_CAN_RAW, CAN_RAW_FILTER, bytes(7))", "EINVAL"),
        ("bound().connect(('can0',))", "ENOTSUP"),
        ("bound().getpeername()", "ENOTSUP"),
        ("fcntl.ioctl(bound(), 0x8906, bytes(16))", "ENOENT"),
    ],
)
def test_what_is_not_carried_fails_as_the_kernel_would(do: Shell, call: str, error: str) -> None:
    assert do(f"error(lambda: {call})") == error


def test_fd_frames_may_be_asked_for_and_find_a_classical_interface(do: Shell) -> None:
    do("s = bound()")
    do("s.setsockopt(SOL_CAN_RAW, CAN_RAW_FD_FRAMES, 1)")
    assert do("error(s.send, bytes(72))") == "EMSGSIZE"
    assert do("s.send(frame(1))") == 16
    assert do("struct.unpack('=i', fcntl.ioctl(s, 0x8921, b'can0' + bytes(36))[16:20])") == (16,)  # SIOCGIFMTU


def test_interfaces_have_names_and_numbers_and_the_kernel_s_own_stay(do: Shell) -> None:
    assert do("[if_nametoindex(name) for name in ('can0', 'can1', 'lo')]") == [FIRST_INDEX, FIRST_INDEX + 1, 1]
    assert do(f"if_indextoname({FIRST_INDEX + 1})") == "can1"
    assert do("error(if_nametoindex, 'can7')") == "no interface with this name"


def test_when_the_emulator_ends_the_interface_is_down(rig: Rig, do: Shell) -> None:
    do("s = bound()")
    rig.links[0].close()
    rig.links = rig.links[1:]
    rig.heard = rig.heard[1:]
    assert do("error(s.recv, 16)") == "ENETDOWN"
    assert do("error(s.send, frame(1))") == "ENETDOWN"


def test_a_program_that_does_not_read_loses_frames_and_is_told_how_many(rig: Rig, do: Shell) -> None:
    do("s = bound()")
    do("s.setsockopt(SOL_SOCKET, 40, 1)")  # SO_RXQ_OVFL
    sent = 0
    while rig.link.stats.payloads_dropped == 0:
        for _ in range(200):
            rig.send(sent.to_bytes(8, "big"))
            sent += 1
        rig.now_ns += 100 * MS
        rig.step()
        assert sent < 20_000
    do("seen = []")
    do("s.setblocking(False)")
    dropped = rig.link.stats.payloads_dropped
    total = 0
    while total < sent - dropped:
        do(
            "while select.select([s], [], [], 0)[0]: r = s.recvmsg(16, 64); "
            "seen.append((r[0][8:], struct.unpack('=I', r[1][0][2])[0]))"
        )
        count = do("len(seen)")
        assert isinstance(count, int)
        total = count
    assert do("[int.from_bytes(one[0], 'big') for one in seen] == list(range(len(seen)))") is True
    rig.send(b"after")
    rig.settle()
    assert do("(lambda r: (r[0][8:13], struct.unpack('=I', r[1][0][2])[0]))(s.recvmsg(16, 64))") == (b"after", dropped)


def test_frames_a_program_had_written_leave_though_it_is_killed(rig: Rig, do: Shell) -> None:
    do("s = bound()")
    do("[s.send(frame(k)) for k in range(200)] and None")
    do.program.kill()
    assert [frame.peer for frame in rig.hear(200)] == list(range(200))
    rig.settle()
    assert not rig.link.has_host()


# ---------------------------------------------------------------- without programs


def test_a_name_twice_or_none_is_refused(rig: Rig) -> None:
    with pytest.raises(LinkError, match="another bus of this run is called can0"):
        rig.open("socketcand:127.0.0.1:0/can0")
    with pytest.raises(LinkError, match="cannot be the name of a CAN interface"):
        rig.open("can:socketcan:a-name-that-is-too-long")


def test_a_socketcand_bus_is_an_interface_too(rig: Rig) -> None:
    link = rig.open("socketcand:127.0.0.1:0/can5")
    rig.links.append(link)
    rig.heard.append([])
    rig.environment |= rig.sockets.environment()
    fresh = Shell(rig)
    fresh("s = bound('can5')")
    rig.send(b"x", bus=2)
    rig.settle()
    assert fresh("plain(s.recv(16))") == (0x60A, b"x")
    fresh("s.send(frame(9))")
    assert rig.hear(1, 2) == [Received(9, b"")]


PEERS = (0x101, 0x123, 0x201, 0x123 | EXTENDED, 0x1FFFFFFF | EXTENDED)


@pytest.mark.parametrize(
    ("filters", "flags", "passes"),
    [
        ([(0, 0)], 0, PEERS),
        ([(0x123, 0x7FF)], 0, [0x123, 0x123 | EXTENDED]),
        ([(0x123, 0x7FF | EXTENDED)], 0, [0x123]),
        ([(0x123 | EXTENDED, 0x1FFFFFFF | EXTENDED)], 0, [0x123 | EXTENDED]),
        ([(0x923, 0x1FFFFFFF | EXTENDED)], 0, [0x123]),  # the kernel leaves eleven bits of a standard filter
        ([(0x20000123, 0x7FF)], 0, [0x101, 0x201, 0x1FFFFFFF | EXTENDED]),
        ([(0x100, 0x700), (0x200, 0x700)], 0, [0x101, 0x123, 0x201, 0x123 | EXTENDED]),
        ([(0x100, 0x700), (0x103, 0x703)], 4, [0x123, 0x123 | EXTENDED]),
        ([], 0, []),
        ([], 4, []),
    ],
)
def test_filters_compare_as_the_kernel_does(
    filters: Sequence[tuple[int, int]], flags: int, passes: Sequence[int]
) -> None:
    options = Options(flags, 0, tuple(ready_filter(*one) for one in filters))
    for peer in (
        0,
        0x101,
        0x123,
        0x124,
        0x1FF,
        0x201,
        0x7FF,
        0x123 | EXTENDED,
        0x124 | EXTENDED,
        0x1FFFFFFF | EXTENDED,
    ):
        if peer in passes:
            assert options.hears(peer), hex(peer)
    refused = {0x300, 0x300 | EXTENDED} if filters not in ([(0, 0)], [(0x20000123, 0x7FF)]) else set()
    assert not any(options.hears(peer) for peer in refused)


@pytest.mark.parametrize("packet", [b"x", bytes(32), b"LCAN" + bytes(28), bytes(4000)])
def test_a_stranger_on_the_socket_is_shown_the_door(rig: Rig, packet: bytes) -> None:
    with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as stranger:
        stranger.connect(f"\0{rig.sockets.name}")
        stranger.send(packet)
        rig.settle()
        stranger.setblocking(False)
        assert stranger.recv(100) == b""
    assert not rig.link.has_host()
