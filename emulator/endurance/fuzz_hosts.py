"""Fuzzing of what stands between hosts and devices: socketcand's and slcan's text, control orders, links' texts, host
programs' own readers of telegrams."""

from __future__ import annotations

import atexit
import shutil
import tempfile
from collections.abc import Callable
from concurrent.futures import Future
from pathlib import Path

from emulator.endurance.scene import soak_text
from emulator.hosts import hesai, ldrobot, ydlidar
from emulator.hosts.lms2xx import TelegramReader
from emulator.hosts.turns import TurnAssembler
from emulator.instrument.instrument import Instrument
from emulator.measuring.measuring import InPlace
from emulator.process.clock import SystemClock
from emulator.runtime.assembly import new_sessions
from emulator.runtime.control import ControlServer
from emulator.runtime.orders import Orders
from emulator.runtime.virtual_daemon import VirtualDaemon
from emulator.scenario import scenario
from emulator.transports.can_link import BITRATE, CanPort
from emulator.transports.can_wire import CanWire
from emulator.transports.schemes import check_url, open_link
from emulator.transports.slcan import Adapter
from emulator.transports.socketcand import Client, SocketcandServer
from protocols.lms2xx.telegrams import read_values, request

SECOND_NS = 1_000_000_000
CAN_SEEDS = (
    b"< open can0 >< rawmode >< send 123 2 11 22 >",
    b"< open can0 >< rawmode >< send 1234ABCD 8 1 2 3 4 5 6 7 8 >< echo >",
    b"< echo >< open nothing >< send 7FF 0 >",
)
SLCAN_SEEDS = (
    b"C\rS6\rO\rt1232AABB\r",
    b"V\rN\rF\rZ1\rL\rT000012348AABBCCDDEEFF0011\r",
    b"s031C\rO\rr1230\rM00000000\r",
)
ORDER_SEEDS = (
    b'{"jsonrpc": "2.0", "id": 1, "method": "status"}',
    b'{"jsonrpc": "2.0", "id": "x", "method": "step", "params": {"scans": 1}}',
    b'{"jsonrpc": "2.0", "method": "speed", "params": {"x": 2.0}}',
    b'{"id": 3, "method": "step", "params": {"seconds": 0.001}}',
    b'{"id": 4, "method": "pause"}',
)
HESAI_SEEDS = tuple(
    b"HTTP/1.1 200 OK\r\n\r\n" + 2 * packet
    for packet in (
        bytes.fromhex("eeff060100002008010401010000").ljust(1062, b"\0")
        + b"\x38X\2~\1\2\3\4\5".ljust(13, b"\0")
        + b"B\7\0\0\0",
        bytes.fromhex("eeff010481008002000401070000").ljust(817, b"\0")
        + b"\x38".ljust(13, b"\0")
        + b"B".ljust(31, b"\0"),
        bytes.fromhex("eeff040300008002000401090000").ljust(1070, b"\0") + b"\x38B".ljust(48, b"\0"),
        (b"\xff\xee".ljust(124, b"\0") * 10).ljust(1254, b"\0") + b"\x38B".ljust(12, b"\0"),
    )
)
URL_SEEDS = (
    b"pty:./front?speed=strict", b"serial:/dev/ttyUSB0?baud=9600&parity=N&stop=1", b"tcp:127.0.0.1:0",
    b"udp:239.1.1.1:5000?listen=127.0.0.1:0&ttl=1&interface=127.0.0.1", b"socketcand:[::1]:0/can0?bitrate=500000",
    b"slcan:./can?bitrate=250000", b"can:virtual:x?gap_us=3", b"loop:front",
)  # fmt: skip


def socketcand() -> Callable[[bytes], None]:
    """What one client says, in two pieces."""
    server = SocketcandServer("socketcand:127.0.0.1:0/can0", "127.0.0.1", 0)
    atexit.register(server.close)
    channel = server.channel("can0")
    port = CanPort(CanWire(BITRATE), channel)
    now_ns = 0

    def run(data: bytes) -> None:
        nonlocal now_ns
        client = Client(1)
        for part in (data[: len(data) // 2], data[len(data) // 2 :]):
            client.text += part
            server._understand(client, now_ns)
            port.run(now_ns)
            now_ns += SECOND_NS
        if len(client.text) > 1 << 20:
            raise AssertionError(f"{len(client.text)} bytes of a client's text are kept")
        if client.node is not None:
            channel.leave(client.node)

    return run


def slcan() -> Callable[[bytes], None]:
    """What a host writes to the adapter."""
    folder = Path(tempfile.mkdtemp(prefix="lidaremu-fuzz-"))
    adapter = Adapter(str(folder / "can"))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    atexit.register(adapter.close)
    port = CanPort(CanWire(BITRATE), adapter)
    now_ns = 0

    def run(data: bytes) -> None:
        nonlocal now_ns
        for part in (data[: len(data) // 2], data[len(data) // 2 :]):
            adapter.hear(part, now_ns)
            port.wire.take(now_ns)
            now_ns += SECOND_NS

    return run


class _AtOnce:
    """A run that does at once what it is reported."""

    def call(self, action: Callable[[], object]) -> Future[object]:
        done: Future[object] = Future()
        try:
            done.set_result(action())
        except Exception as error:
            done.set_exception(error)
        return done


def control() -> Callable[[bytes], None]:
    """One line of a client, to a run on a virtual clock with every method there is."""
    loaded = scenario.loads(soak_text(1, objects="loop:objects"), Path("fuzz.yaml"))
    session = new_sessions(loaded)[0]
    instrument = Instrument("front", session, [open_link("loop:front")], InPlace({}))
    daemon = VirtualDaemon([instrument])
    daemon.power_on()
    orders = Orders(daemon, [instrument], SystemClock(), loaded)
    folder = Path(tempfile.mkdtemp(prefix="lidaremu-fuzz-"))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    server = ControlServer(folder / "control.sock", orders.methods(), _AtOnce())
    atexit.register(server.close)

    def run(data: bytes) -> None:
        server.answer(data.replace(b"\n", b" "))

    return run


def links() -> Callable[[bytes], None]:
    """The text of a link, as scenarios and `--link` give it."""

    def run(data: bytes) -> None:
        try:
            check_url(data.decode("utf-8", "replace"))
        except ValueError as error:
            if "want" not in str(error) and ";" not in str(error):
                raise AssertionError(f"a refusal that does not say what is wanted: {error}") from None

    return run


def telegram_reader() -> Callable[[bytes], None]:
    """What a device says to our own host programs."""

    def run(data: bytes) -> None:
        reader = TelegramReader()
        reader.feed(data)
        while (telegram := reader.take()) is not None:
            read_values(telegram)

    return run


def ldrobot_reader() -> Callable[[bytes], None]:
    """The same of packets without end."""

    def run(data: bytes) -> None:
        turns = TurnAssembler()
        for packet in ldrobot.PacketReader().feed(data):
            list(turns.add(packet.angle_deg, packet.range_m, packet.intensity))

    return run


def hesai_reader() -> Callable[[bytes], None]:
    """The same of packets of any model."""

    def run(data: bytes) -> None:
        reader = hesai.TurnReader()
        for at in range(0, len(data), 700):
            for _ in reader.feed(data[at : at + 700]):
                pass

    return run


def ydlidar_reader() -> Callable[[bytes], None]:
    """The same of packets and replies, of any width of samples."""

    def run(data: bytes) -> None:
        turns, view = TurnAssembler(), ydlidar.View()
        for item in ydlidar.StreamReader().feed(data):
            if isinstance(item, bytes):
                view = ydlidar.View.of(item) or view
            else:
                list(view.add(turns, item))

    return run


LDROBOT_SEEDS = (
    bytes.fromhex("542C6808AB7EE000E4DC00E2D900E5D500E3D300E4D000E9CD00E4CA00E2C700E9C500E5C200E5C000E5BE823A1A50"),
)
YDLIDAR_SEEDS = (
    bytes.fromhex("AA558D0141004100875BA00F AA550004013281 33FF4FA00FCC0FB91F0000 A55A0500004081"),
    bytes.fromhex(
        "A55A14000000040605010302000204000101050000000000010203 AA550004013281 33E14F64A00F5ACC0F21B81F000000"
    ),
)
READER_SEEDS = (
    request(b"\x20\x24"),
    b"\x02\x80\x03\x00\xa0\x00\x10\x16\x0a",
    b"\x02\x81\x0a\x00\xb0\x02\x00\x01\x02\x10",
)
