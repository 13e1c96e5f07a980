"""The worked example of a family: its bytes and its conversation, without a process or a port."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from protocols.errors import DeviceSettingError, ScanRefused
from protocols.scan import Scan
from protocols.session import Dropped, DropReason, Session

FOLDER = Path(__file__).resolve().parents[2] / "docs/examples/acme_family"
SECOND = 1_000_000_000


@pytest.fixture
def acme(monkeypatch: pytest.MonkeyPatch) -> Iterator[ModuleType]:
    monkeypatch.syspath_prepend(FOLDER)
    import acme_lidar

    yield acme_lidar
    for name in ("acme_lidar", "acme_host"):
        sys.modules.pop(name, None)


def awake(acme: ModuleType) -> Session:
    session: Session = acme.FAMILY.new_session({}, {})
    session.power_on(0)
    assert [one.line_speed for one in session.take_emissions(0)] == [115_200]
    session.take_events()
    return session


def said(session: Session, now_ns: int) -> bytes:
    session.advance(now_ns)
    return b"".join(one.payload for one in session.take_emissions(now_ns))


def measured(session: Session, range_m: float) -> None:
    plan = session.next_plan()
    assert plan is not None
    scan = Scan.empty(plan)
    scan.range_m[:, 0] = range_m
    session.submit(scan)


def test_a_line_of_a_scan_is_this_and_reads_back(acme: ModuleType) -> None:
    ranges = np.full(91, np.nan)
    ranges[:3] = (8.0, 8.004, 700.0)
    line = acme.encode_scan(17, ranges)
    body = b"S 17 800 800 " + b"0 " * 89
    check = 0
    for byte in body:
        check ^= byte
    assert line == body + f"*{check:02X}\n".encode()
    number, back = acme.decode_scan(line)
    assert number == 17
    np.testing.assert_allclose(back[:2], 8.0)
    assert np.all(np.isnan(back[2:]))
    assert acme.decode_scan(line.replace(b"800", b"801", 1)) is None


@pytest.mark.parametrize("chunk", [1, 3, 64])
def test_requests_are_answered_in_any_chunking(acme: ModuleType, chunk: int) -> None:
    session, data = awake(acme), b"ID\r\n\nFOO\nSTART\nSTOP\n"
    for at in range(0, len(data), chunk):
        session.receive(data[at : at + chunk], SECOND)
    assert said(session, SECOND) == b""
    assert said(session, SECOND + 1_000_000) == b"OK ID ACME X2 0001\nERR\nOK START\nOK STOP\n"
    dropped = [one.reason for one in session.take_events() if isinstance(one, Dropped)]
    assert dropped == [DropReason.UNKNOWN_COMMAND]


def test_a_line_without_end_is_given_up_and_counted(acme: ModuleType) -> None:
    session = awake(acme)
    session.receive(b"x" * 1000 + b"\nID\n", SECOND)
    assert said(session, SECOND * 2).endswith(b"OK ID ACME X2 0001\n")
    counts: dict[Any, int] = {}
    for one in session.take_events():
        if isinstance(one, Dropped):
            counts[one.reason] = counts.get(one.reason, 0) + one.count
    assert sum(counts.values()) == 1001
    assert counts[DropReason.OVERLONG] == 960


def test_scans_leave_at_the_end_of_their_sweeps_until_stopped(acme: ModuleType) -> None:
    session = awake(acme)
    assert session.next_plan() is None
    session.receive(b"START\n", SECOND + 1)
    plan = session.next_plan()
    assert plan is not None
    assert plan.start_ns == 1_100_000_000
    measured(session, 8.0)
    assert said(session, 1_149_999_999) == b"OK START\n"
    assert acme.decode_scan(said(session, 1_150_000_000))[0] == plan.sweep
    measured(session, 8.0)
    stale = session.next_plan()
    session.receive(b"STOP\n", 1_200_000_000)
    assert said(session, 2 * SECOND) == b"OK STOP\n"
    assert stale is not None
    with pytest.raises(ScanRefused):
        session.submit(Scan.empty(stale))


def test_sweeps_that_passed_while_one_was_measured_are_counted(acme: ModuleType) -> None:
    session = awake(acme)
    session.receive(b"START\n", SECOND)
    assert session.next_plan() is not None
    said(session, 2 * SECOND)  # nothing was measured for a second
    measured(session, 8.0)
    following = session.next_plan()
    (late,) = [one for one in session.take_events() if isinstance(one, Dropped)]
    assert following is not None
    assert (late.reason, late.count) == (DropReason.LATE, 9)
    assert following.start_ns == 2 * SECOND


def test_a_key_that_the_device_lacks_is_refused(acme: ModuleType) -> None:
    with pytest.raises(DeviceSettingError, match="colour: 'red'; want no such key; known: serial_number"):
        acme.FAMILY.new_session({"colour": "red"}, {})
