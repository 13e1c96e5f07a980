"""Replies and groups changed on their way: one thing is wrong, and nothing beside it."""

from __future__ import annotations

import zlib

import pytest

from protocols.rplidar.framing import RplidarFraming
from protocols.session import Emission
from tests.protocols.rplidar.rig import SECOND, Rig, points_of, request

FRAMING = RplidarFraming()


def sent_of(mode: int) -> list[Emission]:
    rig = Rig("rplidar-s2m1", {"extra_modes": True})
    rig.put(request(0x82, bytes([mode, 0, 0, 0, 0])) if mode else request(0x20))
    rig.run(SECOND)
    return rig.sent


@pytest.mark.parametrize(("mode", "kind"), [(1, 0x85), (2, 0x86)])
def test_a_capsule_with_a_wrong_sum_and_nothing_else(mode: int, kind: int) -> None:
    head, *capsules = sent_of(mode)
    assert FRAMING.bad_check(head) is None, "a descriptor has no sum"
    for one in capsules[:2]:
        changed = FRAMING.bad_check(one)
        assert changed is not None
        assert changed[1:] == one.payload[1:]
        with pytest.raises(AssertionError):
            points_of(kind, changed + one.payload)


def test_an_hq_block_with_a_wrong_crc_and_nodes_without_one() -> None:
    one = sent_of(3)[1]
    changed = FRAMING.bad_check(one)
    assert changed is not None
    assert changed[:777] == one.payload[:777]
    assert int.from_bytes(changed[777:], "little") != zlib.crc32(changed[:777] + bytes(3))
    assert FRAMING.bad_check(sent_of(0)[1]) is None


def test_another_type_in_the_descriptor() -> None:
    head, capsule, *_ = sent_of(1)
    assert FRAMING.with_type(head, 0x92) == head.payload[:6] + b"\x92"
    assert FRAMING.with_type(capsule, 0x92) is None


def test_a_refused_request_is_not_answered() -> None:
    rig = Rig()
    data = FRAMING.to_be_refused(request(0x50))
    assert data is not None
    assert FRAMING.is_whole(data)
    assert not FRAMING.is_whole(b"\xa5")
    assert rig.ask(data) == b""
