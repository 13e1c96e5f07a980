"""YDLIDAR's scanners: X2, X4, G4, TG15, T-mini.

Reading order: `codec` (packets, replies, the slanted line), `models` (facts, keys of `device:`), `session`.
"""

from __future__ import annotations

from protocols.framing import Framing
from protocols.session import Emission, LinkKind
from protocols.skeleton.family import ModelFamily
from protocols.skeleton.requests import coverage
from protocols.wire import Wire
from protocols.ydlidar.codec import HEAD, REPLY
from protocols.ydlidar.models import MODELS, read
from protocols.ydlidar.session import COMMANDS, YdlidarSession


class YdlidarFraming(Framing):
    """One packet, or one reply, per emission."""

    def bad_check(self, one: Emission) -> bytes | None:
        """A packet with a wrong checksum; replies have none."""
        data = one.payload
        return data[:8] + bytes((data[8] ^ 0x55,)) + data[9:] if data[:2] == HEAD else None

    def with_type(self, one: Emission, code: int) -> bytes | None:
        """A reply of another type."""
        data = one.payload
        return data[:6] + bytes((code & 0xFF,)) + data[7:] if data[:2] == REPLY else None

    def to_be_refused(self, data: bytes) -> bytes | None:
        """A command that no device has."""
        return data[:1] + b"\x7f" + data[2:]

    def is_whole(self, data: bytes) -> bool:
        return len(data) >= 2


SCAN = (b"\xa5\x60",)
"Asked to scan; an X2 needs nothing."
FAMILY = ModelFamily(
    name="ydlidar",
    models=MODELS,
    usual="ydlidar-x4",
    build=lambda keys, model: YdlidarSession(model, read(keys, model)),
    rows=coverage(COMMANDS),
    wire=Wire((LinkKind.SERIAL,), lambda kind: YdlidarFraming(), LinkKind.SERIAL, SCAN),
    tcp_is_line=True,
)
