"""sd_notify(3): reports to systemd that the run is ready, what it does, that it lives, that it ends.

Belongs here: the words and the socket. Not: when they are said (daemon, virtual_daemon). Our own, since what
there is as a wheel (systemd-watchdog 1.0) counts by the wall clock, so that a clock set back ends the service, and
waits on its socket; cysystemd needs libsystemd. Without NOTIFY_SOCKET nothing is said at all.
"""

from __future__ import annotations

import contextlib
import os
import socket
from collections.abc import MutableMapping

VARIABLES = ("NOTIFY_SOCKET", "WATCHDOG_USEC", "WATCHDOG_PID")


class Notifier:
    """Whoever started this process, if it listens."""

    def __init__(self, address: str = "", watchdog_us: int = 0) -> None:
        """`address`: a path, or a name behind `@`. `watchdog_us`: silence after which the service is ended; 0: none."""
        self._address = "\0" + address[1:] if address.startswith("@") else address
        self._socket: socket.socket | None = None
        if address.startswith(("/", "@")) and hasattr(socket, "AF_UNIX"):
            self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC)
            self._socket.setblocking(False)
        self._every_ns = watchdog_us * 1000 // 2 if self._socket is not None else 0
        self._next_ns: int | None = None
        self._status = ""

    @classmethod
    def of_environment(cls, environment: MutableMapping[str, str]) -> Notifier:
        """As systemd gives it; it is taken out of the environment, so that a child does not speak for us."""
        address, usec, pid = (environment.pop(name, "") for name in VARIABLES)
        is_ours = not pid or pid == str(os.getpid())
        return cls(address, int(usec) if usec.isdecimal() and usec.isascii() and len(usec) < 19 and is_ours else 0)

    def ready(self) -> None:
        """Every link accepts a host."""
        self._say("READY=1")

    def stopping(self) -> None:
        """The run ends."""
        self._say("STOPPING=1")

    def alive(self, now_ns: int, status: str) -> None:
        """The sender has come round again, at `now_ns` of a monotonic clock: at half of the watchdog's time, and when
        `status` is another."""
        if self._socket is None:
            return
        if self._every_ns and (self._next_ns is None or now_ns >= self._next_ns):
            self._next_ns = now_ns + self._every_ns
            self._say("WATCHDOG=1")
        if status != self._status:
            self._status = status
            self._say(f"STATUS={status}")

    def _say(self, words: str) -> None:
        if self._socket is not None:
            with contextlib.suppress(OSError):  # nobody listens any more, or not fast enough: the next one will do
                self._socket.sendto(words.encode(), self._address)

    @property
    def wake_ns(self) -> int | None:
        """So often `alive` has to be called; None: whenever there is time."""
        return self._every_ns or None

    def close(self) -> None:
        """Say nothing more."""
        if self._socket is not None:
            self._socket.close()
            self._socket = None
