"""The worked examples of families: their bytes and their conversations, without a process or a port."""

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


@pytest.fixture
def spin(monkeypatch: pytest.MonkeyPatch) -> Iterator[ModuleType]:
    monkeypatch.syspath_prepend(FOLDER)
    import acme_spin

    yield acme_spin
    for name in ("acme_lidar", "acme_spin", "acme_host"):
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


def turned(spin: ModuleType, range_m: float, **device: Any) -> list[Any]:
    """Datagrams of the first turn, undecoded."""
    session = spin.FAMILY.new_session(device, {})
    session.power_on(0)
    session.advance(spin.BOOT_NS)
    measured(session, range_m)
    return list(session.take_emissions(spin.BOOT_NS + SECOND))


def test_a_turn_is_fifteen_datagrams_each_when_its_last_column_has_fired(spin: ModuleType) -> None:
    sent = turned(spin, 8.0)
    assert [one.sweep for one in sent] == [0] + [None] * 14
    assert {len(one.payload) for one in sent} == {2 + 2 + 4 + 12 * (2 + 4 * 3)}
    column_ns = 100_000_000 / 180
    for number, one in enumerate(sent):
        fired_ns = spin.BOOT_NS + (12 * number + 11) * column_ns + 3 * 2_000
        assert 0.0 <= one.due_ns - fired_ns < 2.0


def test_a_datagram_is_these_bytes(spin: ModuleType) -> None:
    first, second = (one.payload for one in turned(spin, 8.0)[:2])
    head = b"S4" + bytes.fromhex("0000 80841E00")  # turn 0, two seconds since power-on
    assert first[:8] == head
    assert first[8:22] == bytes.fromhex("0000 D00700 D00700 D00700 D00700")  # 0 degrees, 2000 times 4 mm, no strength
    assert first[22:24] == bytes.fromhex("C800")  # two degrees clockwise
    assert int.from_bytes(second[4:8], "little") == 2_000_000 + 6_666
    far = turned(spin, 200.1)[0].payload
    assert far[10:13] == bytes(3)


def test_it_hears_nothing_and_tells_of_it(spin: ModuleType) -> None:
    session = spin.FAMILY.new_session({"turn_hz": 20}, {})
    session.power_on(0)
    session.receive(b"hello", spin.BOOT_NS)
    reported = [(one.reason, one.count) for one in session.take_events() if isinstance(one, Dropped)]
    assert reported == [(DropReason.UNKNOWN_COMMAND, 5)]
    assert session.next_plan().period_ns == 50_000_000
    with pytest.raises(DeviceSettingError, match=r"turn_hz: 7; want 5 \| 10 \| 20"):
        spin.FAMILY.new_session({"turn_hz": 7}, {})
    assert [key.name for key in spin.FAMILY.device_keys()] == ["turn_hz"]


@pytest.mark.parametrize("chunk", [1, 175, 176, 4000])
def test_a_host_reads_whole_turns_of_the_level_layer_in_any_chunking(spin: ModuleType, chunk: int) -> None:
    import acme_host

    data = b"".join(one.payload for one in turned(spin, 8.0))
    read: list[Any] = []

    class Line:
        held: list[bytes] = [data[at : at + chunk] for at in range(0, len(data), chunk)]  # noqa: RUF012

        def read(self) -> bytes:
            return self.held.pop(0)

    script = acme_host.SpinScript(Line(), lambda now_ns, scan: read.append(scan))
    for _ in range(len(Line.held)):
        script.step(0)
    (scan,) = read
    assert len(scan.range_m) == 180
    np.testing.assert_allclose(scan.range_m, 8.0)
    np.testing.assert_allclose(scan.azimuth_rad[:3], np.radians([0.0, -2.0, -4.0]), atol=1e-12)
