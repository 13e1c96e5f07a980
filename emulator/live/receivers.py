"""Sockets that a feed comes through, in a thread of their own: datagrams, lines, and how much of them is taken.

Belongs here: bytes to updates, limits of size and rate, what was lost on the way. Not: formats (json_lines, osi), what
is done with an update (book), lock-step (runtime).
"""

from __future__ import annotations

import contextlib
import select
import socket
import struct
import sys
import threading
from collections import Counter
from collections.abc import Callable, Iterable
from typing import Protocol

from emulator.live import json_lines
from emulator.live.esmini import Assembly
from emulator.live.osi import ground_truth
from emulator.live.samples import BadSample, Update

MOST_RATE = 5000
"Updates a second; what comes beyond is counted and not read."
MOST_CONNECTIONS = 8
MOST_AT_ONCE = 64
"Datagrams between two looks at the time."
RECEIVE_BYTES = 8 << 20
"Asked of the kernel for datagrams; it gives `net.core.rmem_max` at most."
READ_BYTES = 1 << 16
WAIT_S = 0.25
STAMPS = 35 if sys.platform == "linux" else None
"SO_TIMESTAMPNS: the kernel says when a datagram came, as CLOCK_REALTIME has it; Python has no name for it."
STAMP_ROOM = socket.CMSG_SPACE(16) if STAMPS is not None else 0
MOST_UNREAD_NS = 1_000_000_000
"A datagram that is said to have waited longer has not: the computer's clock was set."

Take = Callable[[Update, int], None]
Refuse = Callable[[str, int], None]
Cut = Callable[[bytearray], bytes | None]
MOST_OSI = 16 << 20
"Bytes of one message of a stream; so much is held of each connection."


class Decoder(Protocol):
    """Datagrams of one format to updates."""

    def __call__(self, data: bytes, peer: object, now_ns: int) -> Update | None:
        """None: the message goes on in further datagrams. `BadSample`: it cannot be used."""


class JsonDatagrams:
    """One datagram, one update."""

    def __call__(self, data: bytes, peer: object, now_ns: int) -> Update | None:
        return json_lines.decoded(data)


class OsiDatagrams:
    """esmini's: one message in several datagrams."""

    def __init__(self, counts: Counter[str]) -> None:
        self._assembly = Assembly(counts)

    def __call__(self, data: bytes, peer: object, now_ns: int) -> Update | None:
        whole = self._assembly.take(data, peer, now_ns)
        return None if whole is None else ground_truth(whole)


class OsiMessages:
    """One whole message."""

    def __call__(self, data: bytes, peer: object, now_ns: int) -> Update | None:
        return ground_truth(data)


def line_in(held: bytearray) -> bytes | None:
    """The next line of a stream, taken from it; None: its end has not come. `BadSample`: none can come."""
    end = held.find(b"\n")
    if end < 0:
        if len(held) > json_lines.MOST_BYTES:
            raise BadSample(f"line: over {json_lines.MOST_BYTES} bytes without its end; want shorter ones")
        return None
    line = bytes(held[:end])
    del held[: end + 1]
    return line


def message_in(held: bytearray) -> bytes | None:
    """The same of messages, each after its length in four bytes, little-endian, as in an OSI trace."""
    if len(held) < 4:
        return None
    size = int.from_bytes(held[:4], "little")
    if not 0 < size <= MOST_OSI:
        raise BadSample(f"message: of {size} bytes; want 1 to {MOST_OSI} after a length of 4 bytes, little-endian")
    if len(held) < 4 + size:
        return None
    message = bytes(held[4 : 4 + size])
    del held[: 4 + size]
    return message


def unread_ns(ancillary: Iterable[tuple[int, int, bytes]], now_ns: int) -> int:
    """How long a datagram has waited to be read, by the kernel's stamp of its arrival; 0: it has none that can be.

    `ancillary` : as `socket.recvmsg` has it; `now_ns` : CLOCK_REALTIME.
    """
    for level, kind, data in ancillary:
        if level == socket.SOL_SOCKET and kind == STAMPS and len(data) == 16:
            seconds, nanoseconds = struct.unpack("@qq", data)
            waited = now_ns - (1_000_000_000 * seconds + nanoseconds)
            return waited if 0 <= waited <= MOST_UNREAD_NS else 0
    return 0


class Budget:
    """So many updates a second, in bursts of a tenth."""

    def __init__(self, rate: int = MOST_RATE) -> None:
        self._rate, self._left, self._at_ns = rate, float(rate) / 10.0, 0

    def has_room(self, now_ns: int) -> bool:
        """Whether one more may be read."""
        gained = (now_ns - self._at_ns) * 1e-9 * self._rate
        self._left, self._at_ns = min(self._rate / 10.0, self._left + max(0.0, gained)), now_ns
        if self._left < 1.0:
            return False
        self._left -= 1.0
        return True


class Receiver:
    """A socket and its thread; `take` and `refuse` are called in it."""

    def __init__(
        self, host: str, port: int, tcp: Cut | None, decoder: Decoder, clock_ns: Callable[[], int], take: Take,
        refuse: Refuse, counts: Counter[str] | None = None, utc_ns: Callable[[], int] | None = None,
    ) -> None:  # fmt: skip
        """`tcp`: how a stream is cut into messages; None: datagrams. `utc_ns`: the clock of the kernel's stamps; None:
        datagrams come when they are read. `OSError` where the address cannot be had.
        """
        self.counts = Counter() if counts is None else counts
        self._decoder, self._clock_ns, self._take, self._refuse = decoder, clock_ns, take, refuse
        self._budget, self._utc_ns = Budget(), utc_ns
        family = socket.AF_INET6 if ":" in host else socket.AF_INET
        self._socket = socket.socket(family, socket.SOCK_STREAM if tcp else socket.SOCK_DGRAM)
        self._tcp = tcp
        try:
            if tcp:
                self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            else:
                self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, RECEIVE_BYTES)
                if STAMPS is not None and utc_ns is not None:
                    with contextlib.suppress(OSError):  # then it has come when it is read
                        self._socket.setsockopt(socket.SOL_SOCKET, STAMPS, 1)
            self._socket.bind((host, port))
            if tcp:
                self._socket.listen(MOST_CONNECTIONS)
        except BaseException:
            self._socket.close()
            raise
        self._socket.setblocking(False)
        self.port: int = self._socket.getsockname()[1]
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._tcp_loop if tcp else self._udp_loop, daemon=True)

    def start(self) -> None:
        """Begin to read."""
        self._thread.start()

    def close(self) -> None:
        """Read no more."""
        self._over.set()
        if self._thread.is_alive():
            self._thread.join(2.0)
        self._socket.close()

    def _one(self, data: bytes, peer: object, unread_ns: int = 0) -> None:
        """`unread_ns`: it came so long ago: this thread waits for others of the process."""
        now_ns = self._clock_ns()
        now_ns -= min(unread_ns, now_ns)
        if not self._budget.has_room(now_ns):
            self.counts["too many updates"] += 1
            return
        try:
            update = self._decoder(data, peer, now_ns)
        except BadSample as error:
            self._refuse(str(error), now_ns)
            return
        if update is not None:
            self._take(update, now_ns)

    def _udp_loop(self) -> None:
        while not self._over.is_set():
            if not select.select([self._socket], [], [], WAIT_S)[0]:
                continue
            for _ in range(MOST_AT_ONCE):
                try:
                    data, ancillary, _, peer = self._socket.recvmsg(READ_BYTES, STAMP_ROOM)
                except OSError:
                    break
                self.counts["datagrams"] += 1
                self._one(data, peer, 0 if self._utc_ns is None else unread_ns(ancillary, self._utc_ns()))

    def _tcp_loop(self) -> None:
        held: dict[socket.socket, bytearray] = {}
        try:
            while not self._over.is_set():
                ready, _, _ = select.select([self._socket, *held], [], [], WAIT_S)
                for one in ready:
                    if one is self._socket:
                        self._accept(held)
                    elif not self._read(one, held[one]):
                        one.close()
                        del held[one]
        finally:
            for one in held:
                one.close()

    def _accept(self, held: dict[socket.socket, bytearray]) -> None:
        with contextlib.suppress(OSError):
            found, _ = self._socket.accept()
            if len(held) >= MOST_CONNECTIONS:
                self.counts["connections refused"] += 1
                found.close()
                return
            found.setblocking(False)
            held[found] = bytearray()

    def _read(self, one: socket.socket, held: bytearray) -> bool:
        try:
            data = one.recv(READ_BYTES)
        except BlockingIOError:
            return True
        except OSError:
            return False
        if not data:
            return False
        held += data
        assert self._tcp is not None
        try:
            while (message := self._tcp(held)) is not None:
                if message.strip():
                    self._one(message, id(one))
        except BadSample as error:
            self._refuse(str(error), self._clock_ns())
            return False
        return True
