"""A device that serves one TCP client at a time; the others wait, as in the backlog of its socket.

Belongs here: whose bytes are taken when. Not: other links, which need no turn, and what the bytes mean.
"""

from __future__ import annotations

from fractions import Fraction
from typing import ClassVar

from protocols.session import Address, DropReason, LinkKind
from protocols.skeleton.requests import RequestSession

HELD_BYTES = 1024
"""Input kept of a client that waits for the boot, when a real device is not on the network yet and the client's
connection is not made, or for the end of the one connection that a device serves."""


class OneClientSession(RequestSession):
    """Base class; clients are served in the order of their connections."""

    IS_SERVER: ClassVar[bool] = True
    "It is on the network itself, once it has booted; False: it is a line behind a server that is always up."

    def __init__(self, boot_ns: int, period_ns: Fraction) -> None:
        super().__init__(boot_ns, period_ns)
        self._client: Address | None = None
        self._waiting: dict[Address, bytes] = {}

    def _start(self, now_ns: int) -> None:
        self._serve_next(now_ns)

    def connected(self, now_ns: int, address: Address, kind: LinkKind) -> None:
        """A link is open, or a client has connected: during the boot, and while another is served, it waits."""
        super().connected(now_ns, address, kind)
        if kind is LinkKind.STREAM:
            self._waiting[address] = b""
            self._serve_next(now_ns)

    def disconnected(self, now_ns: int, address: Address) -> None:
        """A client has disconnected: its measurements end, the next one is served."""
        super().disconnected(now_ns, address)
        self._waiting.pop(address, None)
        if address == self._client:
            self._client = None
            self._serve_next(now_ns)

    def _serve_next(self, now_ns: int) -> None:
        is_up = self._running or not self.IS_SERVER
        if self._client is None and is_up and self._waiting:
            self._client = next(iter(self._waiting))
            self.receive(self._waiting.pop(self._client), now_ns, self._client)

    def receive(self, data: bytes, now_ns: int, address: Address | None = None) -> None:
        """Bytes of a host, in any chunking; those of a waiting client are kept. Never raises."""
        if address is None or address not in self._waiting:
            super().receive(data, now_ns, address)
            return
        held = self._waiting[address]
        self._waiting[address] = (held + data)[:HELD_BYTES]
        if lost := len(held) + len(data) - len(self._waiting[address]):
            self.advance(now_ns)
            self._events.drop(now_ns, DropReason.BUSY, "another client is served", lost)
