"""A pseudo-terminal that behaves like a serial port with a device behind it. Linux only.

The host opens PATH, a symbolic link to the slave; we hold the master alone. That keeps the terminal and its settings
alive between hosts, and the kernel reports exactly (POLLHUP) whether anybody has the slave open:

- nobody: bytes that leave are lost, as on a real line; a host that comes later finds nothing stale;
- a host that does not read: the kernel's buffer (about 20 kB) fills up, further bytes are lost, like a UART's overrun;
- the host's speed is read from its terminal settings at each look; at another speed than the device's both ends get
  framing garbage (`uart`).

Named limits: the kernel forces eight data bits and no parity on a pseudo-terminal, so those are not seen; there is no
break, and modem lines only for drivers under the preload shim, which leaves word of DTR and RTS in the settings;
TCIOFLUSH by the host also takes what we have not read yet; a host that closes and another that opens within the same
instant cannot be distinguished from one that stays.
"""

from __future__ import annotations

import atexit
import contextlib
import errno
import fcntl
import os
import select
import sys
import termios

from emulator.errors import LinkError
from emulator.transports.inotify import OpenWatch
from emulator.transports.intake import LINE_BURST, LINE_BYTES_S, Intake
from emulator.transports.link import Link, LinkIncident, Received
from emulator.transports.pacing import Left, PacedLine
from emulator.transports.stable_path import StablePath
from emulator.transports.tty_modes import TtyModes, forget_lines, read_lines, read_modes, set_raw
from emulator.transports.uart import Receiver, resample, same_speed
from emulator.transports.urls import parse_url
from protocols.session import LinkKind

TIOCGPTPEER = 0x5441
"linux/asm-generic/ioctls.h: opens the slave of a master without its path."

SPEED_RULES = ("strict", "custom_divisor", "ignore")
"""strict: the host must have the device's speed. custom_divisor: a host at 38 400 also hears a device at 500 000, as
drivers set it by TIOCSSERIAL and a divisor. ignore: any speed of the host will do."""

POLL_NS = 10_000_000
"How often a closed slave is looked at where the kernel has no inotify left."


def check_link_pty(url: str) -> None:
    """Judge the text of a `pty:` link; raises ValueError."""
    parts = parse_url(url)
    parts.allow("speed")
    parts.choice("speed", SPEED_RULES)


def open_link_pty(url: str) -> PseudoTerminal:
    """Make the pseudo-terminal that `pty:PATH[?speed=...]` names; raises LinkError."""
    parts = parse_url(url)
    return PseudoTerminal(parts.target, parts.choice("speed", SPEED_RULES))


class PseudoTerminal(Link):
    """One serial line, its host on a pseudo-terminal."""

    kind = LinkKind.SERIAL
    INTAKE = LINE_BYTES_S, LINE_BURST

    def __init__(self, path: str, speed_rule: str = "strict") -> None:
        super().__init__()
        self._rule = speed_rule
        self._line = PacedLine()
        self._to_host: Receiver | None = None
        self._watch: OpenWatch | None = None
        self._poll = self._reported = select.poll()
        self._path = path
        self._pulled = 0
        "How often the plug was pulled and not put in again."
        self._make()
        self._open = False
        self._lines: tuple[bool, bool] | None = None
        self._lines_reported: list[Received] = []
        self._input_waits = False
        self._intake = Intake(*self.INTAKE)
        self._kept = b""
        "Under a virtual clock: what the terminal had no room for."
        atexit.register(self.close)

    def _make(self) -> None:
        """Make a terminal and the link to it."""
        path = self._path
        try:
            self._master, slave = os.openpty()
        except OSError as error:
            raise LinkError(f"pty:{path}: no pseudo-terminal: {error.strerror}") from None
        try:
            os.set_blocking(self._master, False)
            self.slave_path = os.ttyname(slave)
            set_raw(slave)
            with contextlib.suppress(OSError):  # too many inotify instances: we look every POLL_NS instead
                self._watch = OpenWatch(self.slave_path)
            self._place = StablePath(path, self.slave_path)
        except BaseException:
            os.close(self._master)
            self._master = -1
            if self._watch is not None:
                self._watch.close()
            raise
        finally:
            os.close(slave)
        self._poll, self._reported = select.poll(), select.poll()
        self._poll.register(self._master, select.POLLIN)
        if self._watch is not None:
            self._poll.register(self._watch.fileno(), select.POLLIN)
            self._reported.register(self._watch.fileno(), select.POLLIN)

    def unplug(self) -> None:
        self._pulled += 1
        if self._master < 0:
            return
        self._place.remove()
        if self._watch is not None:
            self._watch.close()
            self._watch = None
        os.close(self._master)  # the host's end is hung up
        self._master = -1
        self._open = self._input_waits = False
        self.stats.bytes_lost += len(self._kept)
        self._kept = b""

    def plug(self) -> None:
        if self._pulled == 1:
            self._make()
        self._pulled = max(0, self._pulled - 1)

    @property
    def url(self) -> str:
        return f"pty:{self._place.path}"

    @property
    def path(self) -> str | None:
        return self._place.path

    def tend(self, now_ns: int) -> list[LinkIncident]:
        return self._place.tend(now_ns) if self._master >= 0 else []

    @property
    def host_present(self) -> bool:
        """Somebody had the slave open when we looked last."""
        return self._open

    def host_modes(self) -> TtyModes:
        """The terminal settings of the host."""
        return read_modes(self._master)

    def filenos(self) -> tuple[int, ...]:
        if self._master < 0:
            return ()
        watch = () if self._watch is None else (self._watch.fileno(),)
        # a master without a host is readable for ever (POLLHUP), and so is one of which nothing is taken at present
        return (self._master, *watch) if self._open and not self._intake.closed else watch

    def receive(self, now_ns: int) -> list[Received]:
        if self._master < 0:
            return []
        self._look()
        self._let_leave(now_ns, looked=True)
        reported, self._lines_reported = self._lines_reported, []
        data = self._read(self._intake.room(now_ns)) if self._input_waits else b""
        if not data:
            return reported
        self._intake.take(len(data))
        self.stats.bytes_in += len(data)
        modes = self.host_modes()
        device, foreign = self._line.speed, None
        if device is not None and not self._hear_each_other(modes.sends_baud, device):
            self.stats.bytes_garbled += len(data)
            foreign = modes.sends_baud, data
            data = resample(data, modes.sends_baud, device).values.tobytes() if modes.sends_baud else b""
        return [*reported, Received(0, data, foreign=foreign)] if data else reported

    def _read(self, most: int) -> bytes:
        chunks, size = [], 0
        while size < most:
            try:
                chunk = os.read(self._master, most - size)
            except BlockingIOError:
                break
            except OSError as error:
                if error.errno != errno.EIO:  # EIO: no host
                    raise
                break
            chunks.append(chunk)
            size += len(chunk)
        return b"".join(chunks)

    def _hear_each_other(self, host_baud: int, device_baud: int) -> bool:
        if self._rule == "ignore" or same_speed(host_baud, device_baud):
            return True
        return self._rule == "custom_divisor" and (host_baud, device_baud) == (38_400, 500_000)

    def send(self, payload: bytes, due_ns: int, peer: int | None = None, line_speed: int | None = None) -> None:
        if (self._master >= 0 or self._pulled) and not self._line.put(payload, due_ns, line_speed):
            self.stats.payloads_dropped += 1

    def cut(self, now_ns: int) -> None:
        self._line.cut(now_ns)

    def flush(self, now_ns: int) -> int | None:
        if self._master < 0:
            return self._flush_unplugged(now_ns) if self._pulled else None
        self._let_leave(now_ns)
        wakes = [self._line.next_ns(now_ns), self._intake.next_ns() if self._input_waits else None]
        if self._watch is None and not self._open:
            wakes.append(now_ns + POLL_NS)
        return min((wake for wake in wakes if wake is not None), default=None)

    def _let_leave(self, now_ns: int, looked: bool = False) -> None:
        """Write what has left the line; `looked`: whether a host is there is known."""
        left = self._line.take(now_ns)
        if not looked and (left or self._kept or self._may_have_changed()):
            self._look()
        if self._kept:
            kept, self._kept = self._kept, b""
            self._write(kept)
        if left:
            self._write(b"".join(self._as_heard(left)))
            for item in left:
                if item.ends:
                    self.stats.note_left(item.last_ns, now_ns)

    def _flush_unplugged(self, now_ns: int) -> int | None:
        """The device goes on speaking, at its own speed, to nobody."""
        self.stats.bytes_lost += sum(len(item.data) for item in self._line.take(now_ns))
        return self._line.next_ns(now_ns)

    def _may_have_changed(self) -> bool:
        """Whether somebody opened or closed it; a look at a flooded terminal waits for the kernel's own thread."""
        return self._watch is None or bool(self._reported.poll(0))

    def _look(self) -> None:
        """See whether a host is there. What the last one left unread goes with it, as a port's buffer does."""
        events = dict(self._poll.poll(0))
        if self._watch is not None and self._watch.fileno() in events:
            self._watch.drain()
            events = dict(self._poll.poll(0))  # an open that was drained just now must not be missed
            self._look_at_lines()
        state = events.get(self._master, 0)
        was_open, self._open = self._open, not state & select.POLLHUP
        self._input_waits = bool(state & select.POLLIN)
        if was_open and not self._open:
            self._kept = b""
            self._forget_unread()
            if self._lines is not None and self._lines != (False, False):  # a port that is closed lets both fall
                self._lines_reported.append(Received(0, lines=(False, False)))
            self._lines = None

    def _look_at_lines(self) -> None:
        """A host under the preload shim may have set DTR or RTS."""
        lines = read_lines(self._master)
        if lines is not None and lines != self._lines:
            self._lines = lines
            self._lines_reported.append(Received(0, lines=lines))

    def _forget_unread(self) -> None:
        """Empty what the terminal holds and what is on its way there; only a slave descriptor reaches both."""
        with contextlib.suppress(OSError, termios.error):
            slave = fcntl.ioctl(self._master, TIOCGPTPEER, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK | os.O_CLOEXEC)
            try:
                termios.tcflush(slave, termios.TCIFLUSH)
                if self._lines is not None:
                    forget_lines(slave)
            finally:
                os.close(slave)

    def _as_heard(self, left: list[Left]) -> list[bytes]:
        """The bytes as the host's UART takes them from the line."""
        if not self._open:
            self.stats.bytes_lost += sum(len(item.data) for item in left)
            return []
        modes = self.host_modes()
        return [self._heard(item, modes) for item in left]

    def _heard(self, item: Left, modes: TtyModes) -> bytes:
        host_baud = modes.receives_baud
        if item.speed is None or self._hear_each_other(host_baud, item.speed):
            return item.data
        self.stats.bytes_garbled += len(item.data)
        if not host_baud:  # hung up (B0)
            return b""
        if self._to_host is None or item.starts or self._to_host.speeds != (item.speed, host_baud):
            self._to_host = Receiver(item.speed, host_baud)
        sampled = self._to_host.feed(item.data, idle_after=item.ends)
        return sampled.as_tty(modes.ignore_break, modes.ignore_errors, modes.zero_errors)

    def held(self) -> int:
        """What the terminal holds for the host, and what waits behind it."""
        if self._master < 0 or not self._open:
            return 0
        unread = 0
        with contextlib.suppress(OSError):
            slave = fcntl.ioctl(self._master, TIOCGPTPEER, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK | os.O_CLOEXEC)
            try:
                answer = fcntl.ioctl(slave, termios.FIONREAD, b"\0" * 4)
            finally:
                os.close(slave)
            unread = int.from_bytes(answer, sys.byteorder)
        if self._watch is not None:
            self._watch.drain()  # our own opening is no host's; `flush` looks whether one is there in any case
        return unread + len(self._kept)

    def has_host(self) -> bool:
        return self._open

    def _write(self, data: bytes) -> None:
        if self._kept:
            self._kept += data
            return
        while data:
            try:
                written = os.write(self._master, data)
            except BlockingIOError:
                written = 0
            self.stats.bytes_out += written
            data = data[written:]
            if not written and self.hold:
                self._kept = data
                return
            if not written:
                self.stats.bytes_lost += len(data)
                return

    @property
    def speed(self) -> int | None:
        return self._line.speed

    def set_speed(self, baud: int | None) -> None:
        self._line.set_speed(baud)

    def clear(self) -> int:
        return self._line.clear()

    def close(self) -> None:
        self._pulled = 0
        if self._master < 0:
            return
        atexit.unregister(self.close)
        self._place.remove()
        if self._watch is not None:
            self._watch.close()
        os.close(self._master)
        self._master = -1
