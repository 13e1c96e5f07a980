"""Replies changed on their way: one thing is wrong, and all sums beside it are right."""

from __future__ import annotations

import pytest

from protocols.scip.framing import ScipFraming
from protocols.session import Emission
from tests.protocols.scip.rig import MS, Rig, read

FRAMING = ScipFraming()


@pytest.fixture
def scans() -> list[Emission]:
    rig = Rig()
    rig.put("MD0000003001000\n")
    rig.run(200 * MS)
    return rig.sent


def test_a_wrong_sum_and_nothing_else(scans: list[Emission]) -> None:
    changed = FRAMING.bad_check(scans[1])
    assert changed is not None
    assert sum(one != other for one, other in zip(changed, scans[1].payload, strict=True)) == 1
    with pytest.raises(AssertionError):
        read(changed)


def test_a_reply_whose_only_sum_is_that_of_its_status(scans: list[Emission]) -> None:
    changed = FRAMING.bad_check(scans[0])
    assert changed == b"MD0000003001000\n00Q\n\n"


def test_another_status(scans: list[Emission]) -> None:
    changed = FRAMING.with_type(scans[1], 0x50)
    assert changed is not None
    assert [one.status for one in read(changed)] == ["50"]


def test_another_time_stamp_wraps(scans: list[Emission]) -> None:
    (before,) = read(scans[1].payload)
    for change in (1000, -(before.stamp + 1)):
        changed = FRAMING.with_counter(scans[1], change)
        assert changed is not None
        (after,) = read(changed)
        assert after.stamp == (before.stamp + change) % 2**24
        assert after.data == before.data
    assert FRAMING.with_counter(scans[0], 1) is None


def test_a_stale_scan_has_old_data_and_a_new_stamp(scans: list[Emission]) -> None:
    old = scans[1].payload.replace(b"0?X", b"0?Y")
    changed = FRAMING.stale(Emission(0, old, reported=scans[1].reported), scans[3])
    assert changed is not None
    lines = changed.split(b"\n")
    assert lines[2] == scans[3].payload.split(b"\n")[2]
    assert lines[3] == old.split(b"\n")[3]
    assert FRAMING.stale(scans[0], scans[3]) is None


def test_a_request_is_refused() -> None:
    rig = Rig()
    data = FRAMING.to_be_refused(b"BM\n")
    assert data is not None
    assert FRAMING.is_whole(data)
    assert not FRAMING.is_whole(b"BM")
    rig.put(data.decode())
    rig.run(2 * MS)
    assert [one.status for one in rig.take()] == ["0E"]
    assert not rig.session.laser
