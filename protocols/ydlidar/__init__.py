"""YDLIDAR's scanners: X2, X4, G4, TG15, T-mini.

Reading order: `codec` (packets, replies, the slanted line), `models` (facts, keys of `device:`), `session`.
"""

from __future__ import annotations

from protocols.session import Emission, LinkKind
from protocols.skeleton.descriptors import DescriptorFraming
from protocols.skeleton.family import ModelFamily
from protocols.skeleton.requests import coverage
from protocols.wire import Wire
from protocols.ydlidar.codec import HEAD
from protocols.ydlidar.models import MODELS, read
from protocols.ydlidar.session import COMMANDS, YdlidarSession


class YdlidarFraming(DescriptorFraming):
    """One packet, or one reply, per emission."""

    def bad_check(self, one: Emission) -> bytes | None:
        """A packet with a wrong checksum; replies have none."""
        data = one.payload
        return data[:8] + bytes((data[8] ^ 0x55,)) + data[9:] if data[:2] == HEAD else None


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
