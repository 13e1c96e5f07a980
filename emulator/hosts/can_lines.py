"""The host's end of a CAN bus: a socketcand client, a serial adapter (slcan), or any interface of python-can.

Belongs here: opening, frames in and out. Not: what frames mean.
"""

from __future__ import annotations

import logging
import os
import socket
from typing import Any, NamedTuple

from emulator.errors import EmulatorError, LinkError
from emulator.hosts.lines import GONE, LineClosed
from emulator.transports.can_link import BITRATE
from emulator.transports.urls import host_and_port, option_value, parse_url
from protocols.can_frame import EXTENDED, MAX_STANDARD_ID

SCHEMES = ("socketcand", "slcan", "can")
GREETING_S = 10.0
"A socketcand server greets at once; python-can's client would wait for ever."


class Frame(NamedTuple):
    """One frame on the bus; `identifier` with `EXTENDED` for 29 bits."""

    identifier: int
    data: bytes


class CanLine:
    """Frames out, frames in."""

    def __init__(self, bus: Any, url: str) -> None:
        self._bus = bus
        self._url = url

    def read(self, timeout_s: float) -> Frame | None:
        """The next data frame; None when none came in time. Raises `LinkError` when the bus is lost."""
        import can

        try:
            message = self._bus.recv(max(0.0, timeout_s))
        except (can.CanError, OSError, ValueError) as error:
            raise LineClosed(f"{self._url}: {GONE} ({error})") from None
        if message is None or message.is_error_frame or message.is_remote_frame or message.is_fd:
            return None
        return Frame(message.arbitration_id | (EXTENDED if message.is_extended_id else 0), bytes(message.data))

    def write(self, frame: Frame) -> None:
        """Send one frame of 11 bits. Raises `LinkError`."""
        import can

        extended = frame.identifier > MAX_STANDARD_ID
        try:
            self._bus.send(
                can.Message(arbitration_id=frame.identifier, data=frame.data, is_extended_id=extended), timeout=1.0
            )
        except (can.CanError, OSError, ValueError) as error:
            raise LinkError(f"{self._url}: cannot send: {error}") from None

    def close(self) -> None:
        """Leave the bus."""
        self._bus.shutdown()


def open_can(url: str) -> CanLine:
    """Join the bus of `socketcand:HOST:PORT/CHANNEL`, `slcan:PATH` or `can:INTERFACE:CHANNEL?KEY=VALUE`.

    Raises `LinkError` when it cannot be opened, `EmulatorError` when the text is none of these.
    """
    import can
    from can.interfaces import VALID_INTERFACES

    try:
        parts = parse_url(url)
        options: dict[str, Any] = {key: option_value(text) for key, text in parts.options.items()}
        if parts.scheme == "socketcand":
            address, slash, channel = parts.target.partition("/")
            if not slash or not channel:
                raise ValueError(f"{url!r}; want socketcand:HOST:PORT/CHANNEL")
            place = dict(zip(("host", "port"), host_and_port(url, address, 1), strict=True))
            options = {"interface": "socketcand", "channel": channel} | place
        elif parts.scheme == "slcan":
            options = {"bitrate": BITRATE, "sleep_after_open": 0.2} | options
            options |= {"interface": "slcan", "channel": os.path.realpath(parts.target)}
        elif parts.scheme == "can":
            interface, colon, channel = parts.target.partition(":")
            if interface not in VALID_INTERFACES or not colon or not channel:
                known = ", ".join(sorted(VALID_INTERFACES))
                raise ValueError(f"{url!r}; want can:INTERFACE:CHANNEL, INTERFACE one of {known}")
            options = {"interface": interface, "channel": channel} | options
        else:
            raise ValueError(f"{url!r}; want {', '.join(f'{one}:...' for one in SCHEMES)}")
    except ValueError as error:
        raise EmulatorError(str(error)) from None
    logging.getLogger("can").setLevel(logging.CRITICAL)  # it warns of every frame that comes in two pieces
    if parts.scheme == "socketcand":
        _greeted(url, options["host"], options["port"])
    try:
        return CanLine(can.Bus(**options), url)
    except (can.CanError, OSError, ImportError, NotImplementedError, TypeError, ValueError) as error:
        raise LinkError(f"{url}: cannot be opened: {error}") from None


def _greeted(url: str, host: str, port: int) -> None:
    """`LinkError` unless a socketcand server greets there."""
    try:
        with socket.create_connection((host, port), timeout=GREETING_S) as line:
            heard = line.recv(64)
    except TimeoutError:
        raise LinkError(f"{url}: no greeting within {GREETING_S:g} s; is it a socketcand server?") from None
    except (OSError, UnicodeError) as error:
        raise LinkError(f"{url}: cannot connect: {getattr(error, 'strerror', None) or error}") from None
    if not heard.lstrip().startswith(b"<"):
        raise LinkError(f"{url}: received {heard[:16]!r}; want the greeting of a socketcand server, < hi >")
