"""We are a serial CAN adapter (LAWICEL, slcan) on a pseudo-terminal; the host's program opens it like a real one.

Belongs here: the adapter's commands and frames as text. Not: the bus behind it (`can_wire`), and how the terminal gets
its name (`pseudo_terminal`).
Source: LAWICEL CAN232/CANUSB manual; python-can's slcan client. What an adapter of that family has and this one does
not (acceptance filters `M` and `m`, polling `P` and `A`, `X`, `Q`, `W`) is refused with BEL.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence

from emulator.transports.can_link import BITRATE, HIGHEST_BITRATE, LOWEST_BITRATE, CanPort, CanPorts, Outlet
from emulator.transports.can_wire import CanWire, Carried
from emulator.transports.intake import CAN_BURST, STREAM_BYTES_S
from emulator.transports.link import Link, LinkIncident
from emulator.transports.pseudo_terminal import PseudoTerminal
from emulator.transports.urls import parse_url
from protocols.can_frame import EXTENDED, MAX_DATA_BYTES, MAX_EXTENDED_ID, MAX_STANDARD_ID, split_identifier

CR, BEL = b"\r", b"\a"
RATES = {
    b"S0": 10_000,
    b"S1": 20_000,
    b"S2": 50_000,
    b"S3": 100_000,
    b"S4": 125_000,
    b"S5": 250_000,
    b"S6": 500_000,
    b"S7": 800_000,
    b"S8": 1_000_000,
}
CLOCK_HZ = 8_000_000
"Of the adapter's SJA1000: half its crystal's 16 MHz."
VERSION, SERIAL_NUMBER = b"V1013", b"NA001"
FLAG_BUS_ERROR, FLAG_OVERRUN = 0x80, 0x08
"Bits of the status flags `F`."
LONGEST_COMMAND = 64
TIMESTAMP_MS = 60_000
BACKLOG_LIMIT = 65_536
"Bytes that wait for the host; while as many do, frames are dropped whole, as an adapter's full buffer does."
RETRY_NS = 1_000_000


def check_link_slcan(url: str) -> None:
    """Judge the text of an `slcan:` link; raises ValueError."""
    parts = parse_url(url)
    parts.allow("bitrate")
    parts.number("bitrate", BITRATE, LOWEST_BITRATE, HIGHEST_BITRATE)


def open_link_slcan(url: str, *, can_ports: CanPorts | None = None, can_bitrate: int | None = None) -> Link:
    """A sensor on the bus behind the adapter of `slcan:PATH[?bitrate=...]`; raises LinkError.

    `can_ports`: the buses of the run; sensors that give the same path share one.
    """
    parts = parse_url(url)
    bitrate = parts.number("bitrate", can_bitrate or BITRATE, LOWEST_BITRATE, HIGHEST_BITRATE)
    ports = can_ports if can_ports is not None else CanPorts()
    return ports.link(f"slcan:{parts.target}", lambda: (CanWire(bitrate), Adapter(parts.target)))


class Terminal(PseudoTerminal):
    """A pseudo-terminal that keeps what the host has not room for, so that no frame is cut."""

    INTAKE = STREAM_BYTES_S, CAN_BURST

    def __init__(self, path: str) -> None:
        self._rest = bytearray()
        super().__init__(path, "ignore")

    @property
    def backlog(self) -> int:
        """Bytes that wait for the host."""
        return len(self._rest)

    def say(self, text: bytes) -> None:
        """Send at once, or as soon as there is room."""
        if self.host_present:
            self._write(text)

    def flush(self, now_ns: int) -> int | None:
        wake = super().flush(now_ns)
        if not self.host_present:
            self.stats.bytes_lost += len(self._rest)
            self._rest.clear()
        elif self._rest:
            self._write(b"")
        if self._rest:
            return now_ns + RETRY_NS if wake is None else min(wake, now_ns + RETRY_NS)
        return wake

    def _write(self, data: bytes) -> None:
        self._rest += data
        while self._rest:
            try:
                written = os.write(self._master, self._rest[:4096])
            except BlockingIOError:
                return
            except OSError:  # the host has gone in this instant
                self._rest.clear()
                return
            self.stats.bytes_out += written
            del self._rest[:written]


class Adapter(Outlet):
    """The adapter: a node of the bus, and its serial side."""

    def __init__(self, path: str) -> None:
        super().__init__()
        self._terminal = Terminal(path)
        self._port: CanPort | None = None
        self._text = bytearray()
        self._wake_ns: int | None = None
        self._power_up()

    def _power_up(self) -> None:
        self._open = False
        self._listen_only = False
        self._timestamps = False
        self._bitrate: int | None = None
        "None: the host has not chosen; the adapter then takes the bus's."
        self._flags = 0

    def attached(self, port: CanPort) -> None:
        self._port = port
        self._node = port.wire.join("adapter")

    @property
    def url(self) -> str:
        return f"slcan:{self._terminal.url.partition(':')[2]}"

    @property
    def path(self) -> str | None:
        return self._terminal.path

    def tend(self, now_ns: int) -> list[LinkIncident]:
        return self._terminal.tend(now_ns)

    def filenos(self) -> tuple[int, ...]:
        return self._terminal.filenos()

    def poll(self, now_ns: int) -> None:
        heard = b"".join(received.data for received in self._terminal.receive(now_ns))
        self._wake_ns = self._terminal.flush(now_ns)
        if not self._terminal.host_present:
            # as an adapter on USB does when its port is closed: the next host starts afresh
            self._power_up()
            self._text.clear()
            return
        self.hear(heard, now_ns)

    def hear(self, text: bytes, now_ns: int) -> None:
        """Obey what the host has written, as far as commands are complete."""
        *commands, rest = (bytes(self._text) + text).split(CR)
        self._text[:] = rest
        answers = b"".join([self._obey(command, now_ns) for command in commands])
        if self._terminal.backlog >= BACKLOG_LIMIT:
            self._flags |= FLAG_OVERRUN  # whoever asks and never reads has no answer
        elif answers:
            self._terminal.say(answers)
        if len(self._text) > LONGEST_COMMAND:
            self._text.clear()
            self._refuse()
            self._terminal.say(BEL)

    def next_ns(self) -> int | None:
        return self._wake_ns

    def deliver(self, carried: Sequence[Carried], now_ns: int) -> bool:
        if not self._open or not self._terminal.host_present:
            return False
        if not self._same_rate():
            self._flags |= FLAG_BUS_ERROR
            return False
        texts = [self._frame_text(frame) for frame in carried if frame.node is not self._node]
        if self._terminal.backlog >= BACKLOG_LIMIT:
            self._flags |= FLAG_OVERRUN
            if self._port is not None:
                self._port.links[0].stats.payloads_dropped += len(texts)
        elif texts:
            self._terminal.say(b"".join(texts))
        return True

    def held(self) -> int:
        return self._terminal.backlog + self._terminal.held()

    def has_host(self) -> bool:
        return self._terminal.has_host()

    def close(self) -> None:
        self._terminal.close()

    def _same_rate(self) -> bool:
        return self._port is not None and self._bitrate in (None, self._port.wire.bitrate)

    def _frame_text(self, frame: Carried) -> bytes:
        identifier, extended = split_identifier(frame.peer)
        head = f"T{identifier:08X}" if extended else f"t{identifier:03X}"
        stamp = f"{frame.end_ns // 1_000_000 % TIMESTAMP_MS:04X}" if self._timestamps else ""
        return f"{head}{len(frame.data)}{frame.data.hex().upper()}{stamp}\r".encode()

    def _refuse(self) -> bytes:
        self.counters.malformed += 1
        return BEL

    def _obey(self, command: bytes, now_ns: int) -> bytes:
        """The answer to one command."""
        if not command:  # clients send empty ones to end what a predecessor began
            return CR
        plain = self._plain_answer(command)
        if plain is not None:
            return plain
        if command[:1] in b"tTrR":
            return self._transmit(command, now_ns)
        if command[:1] in b"Ss" and not self._open:
            return self._set_rate(command)
        return self._refuse()

    def _plain_answer(self, command: bytes) -> bytes | None:
        """The answer to a command without operands, None when it is none of them."""
        actions: dict[bytes, Callable[[], bytes]] = {
            b"O": lambda: self._set_open(listen_only=False),
            b"L": lambda: self._set_open(listen_only=True),
            b"C": self._set_closed,
            b"V": lambda: VERSION + CR,
            b"v": lambda: VERSION + CR,
            b"N": lambda: SERIAL_NUMBER + CR,
            b"F": self._take_flags,
            b"Z0": lambda: self._set_timestamps(False),
            b"Z1": lambda: self._set_timestamps(True),
        }
        action = actions.get(command)
        return None if action is None else action()

    def _set_open(self, listen_only: bool) -> bytes:
        # a second open is harmless: stock clients send it twice
        if not self._open:
            self._open, self._listen_only = True, listen_only
        return CR

    def _set_closed(self) -> bytes:
        self._open = False
        return CR

    def _set_timestamps(self, wanted: bool) -> bytes:
        self._timestamps = wanted
        return CR

    def _take_flags(self) -> bytes:
        flags, self._flags = self._flags, 0
        return f"F{flags:02X}\r".encode()

    def _set_rate(self, command: bytes) -> bytes:
        if command in RATES:
            self._bitrate = RATES[command]
            return CR
        registers = _hex(command[1:], 4) if command[:1] == b"s" and len(command) == 5 else None
        if registers is None:
            return self._refuse()
        prescaler = (registers >> 8 & 0x3F) + 1
        quanta = 3 + (registers & 0xF) + (registers >> 4 & 0x7)
        self._bitrate = CLOCK_HZ // (prescaler * quanta)
        return CR

    def _transmit(self, command: bytes, now_ns: int) -> bytes:
        extended, remote = command[:1] in b"TR", command[:1] in b"rR"
        digits = 8 if extended else 3
        identifier = _hex(command[1 : 1 + digits], digits)
        length = _hex(command[1 + digits : 2 + digits], 1)
        if identifier is None or length is None or length > MAX_DATA_BYTES:
            return self._refuse()
        if identifier > (MAX_EXTENDED_ID if extended else MAX_STANDARD_ID):
            return self._refuse()
        rest = command[2 + digits :]
        data = _hex(rest, 2 * length) if length and not remote else 0
        if data is None or len(rest) != (0 if remote else 2 * length):
            return self._refuse()
        if not self._open or self._listen_only:
            return self._refuse()
        accepted = b"Z\r" if extended else b"z\r"
        if not self._same_rate():
            self._flags |= FLAG_BUS_ERROR
            self.counters.host_drops += 1
            return accepted  # the adapter took it; it never gets through
        if remote:  # no sensor here answers remote frames
            return accepted
        if self._port is None or not self._port.wire.put(
            self._node, identifier | (EXTENDED if extended else 0), data.to_bytes(length, "big"), now_ns
        ):
            self.counters.host_drops += 1
            return BEL
        self.counters.host_frames += 1
        return accepted


def _hex(text: bytes, digits: int) -> int | None:
    """The number that exactly so many hexadecimal digits are."""
    if len(text) != digits or not text.isalnum():
        return None
    try:
        return int(text, 16)
    except ValueError:
        return None
